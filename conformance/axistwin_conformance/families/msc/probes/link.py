"""Which readings a unit follows, as far as questions show it that change nothing.

Each function asks the device one question of chapter 6 of the ledger (`probing`).  They run in the
order of `Family.probe_modules` and of their text: first the size of the reply to RQSTAT, by which
most of it is asked, and the two time-outs, on which every wait rests; then the rest of the link,
what is in replies, who is answered; last what is read of the variables.  Then follow the probes
that write (`probes_writes`), those for a bench (`probes_bench`), and those that have the bench
program work (`probes_program`).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.client import MOST_STRAYS
from axistwin_conformance.families.msc.codec import ACK, NAK, RQSTAT, STX
from axistwin_conformance.families.msc.driver import SAFE_BLOCK, Bench
from axistwin_conformance.families.msc.link import LIMITS
from axistwin_conformance.families.msc.probing import (
    COARSE_MS,
    LINE_SLACK_NS,
    LONGEST_S,
    MS,
    Drawn,
    answer_to,
    block_of_variables,
    default_of,
    down_to_the_last,
    drawn_by,
    glance_s,
    in_ms,
    is_waiting,
    refusals,
    repeat_at_once,
    running_program,
    unanswered,
)

ORDER = 10  # of this module in a run; see `Family.modules`

HEADER: Final = codec.HEADER_BYTES
NO_SUM: Final = 0x3030  # a wrong checksum for every short packet, and no byte of it begins anything
READS: Final = 3  # of a word that may change by itself
ERRORS: Final = 0xFB30  # the bits of the status word that tell an error
ABSENT: Final = (9, 11, 13)  # units to speak to that must not be there; their bytes mean nothing
SCANS_S: Final = 0.1  # in which a program that runs has counted
BLOCKS: Final = 8  # of named variables that are read until values differ


# --- what every other question rests on -----------------------------------------------------------


@probe()
def status_tail(bench: Bench) -> Outcome:
    """What follows SS in the reply to RQSTAT."""
    exchange = bench.ask(RQSTAT)
    size = len(exchange.reply.payload) - 2 if exchange.reply else -1
    return {6: 0, 4: 1}.get(size, str(exchange))


@probe()
def packet_timeout_mode(bench: Bench) -> Outcome:
    """The header of RQSTAT in a row, and begun slowly: the NAK comes so long after which byte."""
    straight_ns = _broken_off(bench)
    if straight_ns is None:
        return f"no NAK within {LONGEST_S:.0f} s of a header"
    byte_ns = bench.target.byte_ns
    pause_ns = straight_ns // 4
    raw = bench.talk.request(RQSTAT)
    begun_ns = bench.talk.send(raw[: HEADER - 1])
    bench.target.wait((pause_ns + HEADER * byte_ns) / 1e9)
    header_ns = bench.talk.send(raw[HEADER - 1 : HEADER])
    bench.target.wait(pause_ns / 1e9)
    last_ns = bench.talk.send(raw[HEADER : HEADER + 1])
    if bench.talk.hear(1, LONGEST_S) != NAK:
        return "a NAK to a header, and none to one that comes slowly"
    came_ns = bench.target.now_ns
    # How much later it came than the reading says: from the first byte, the last, the header's.
    straight = (straight_ns, straight_ns - (HEADER - 1) * byte_ns)
    late = [
        abs(came_ns - begun_ns - straight[0]),
        abs(came_ns - last_ns - straight[1]),
        abs(came_ns - header_ns - straight[1]),
    ]
    best = late.index(min(late))
    return best if late[best] < pause_ns // 4 else f"{(came_ns - last_ns) / MS:.0f} ms later"


@probe()
def packet_timeout_ms(bench: Bench) -> Outcome:
    """From the first byte of a header, or its last (packet_timeout_mode), to the NAK."""
    took_ns = _broken_off(bench)
    if took_ns is None:
        return f"no NAK within {LONGEST_S:.0f} s of a header"
    counted_from = 0 if bench.session.reading("packet_timeout_mode") == "total" else HEADER - 1
    own_ns = (counted_from + 2) * bench.target.byte_ns  # that byte and the NAK take their own time
    return in_ms(bench, took_ns - own_ns, "packet_timeout_ms", is_from_sending=True)


def _broken_off(bench: Bench) -> int | None:
    """How long after a header began its NAK was there (ns); None if none came."""
    raw = codec.packet(bench.unit, RQSTAT, checksum=NO_SUM)
    bench.target.drain()
    sent_ns = bench.talk.send(raw[:HEADER])
    heard = bench.talk.hear(1, LONGEST_S)
    came_ns = bench.target.now_ns
    if heard == NAK:
        return came_ns - sent_ns
    bench.talk.send(raw[HEADER:])  # or it would wait for ever
    bench.talk.listen(glance_s(bench))
    return None


@probe()
def reply_delay_ms(bench: Bench) -> Outcome:
    """From the end of the ACK to the beginning of RQSTAT's reply."""
    exchange = bench.ask(RQSTAT)
    if not exchange.is_acked or exchange.reply is None:
        return str(exchange)
    own_ns = len(exchange.reply.raw) * bench.target.byte_ns
    waited_ns = exchange.replied_ns - exchange.signed_ns - own_ns
    if waited_ns < -LINE_SLACK_NS:
        bench.session.skip("this line gives its bytes in bunches")
    return in_ms(bench, waited_ns, "reply_delay_ms")


@probe()
def retransmit_limit(bench: Bench) -> Outcome:
    """RQSTAT, its reply refused until it comes no more."""
    unanswered(bench)
    count = refusals(bench)
    readings = list(LIMITS.values())
    return readings.index(count) if count in readings else f"{count} repeats"


@probe()
def stray_nak(bench: Bench) -> Outcome:
    """15h after a finished RQSTAT."""
    bench.ask(RQSTAT)
    bench.talk.send(NAK)
    is_repeated = repeat_at_once(bench)
    bench.talk.send(ACK)
    return int(is_repeated)


@probe()
def ack_timeout_action(bench: Bench) -> Outcome:
    """RQSTAT, and no answer to its reply: what comes by itself, and what a NAK draws after that."""
    unanswered(bench)
    most, repeats, wait_s, since_ns = max(LIMITS.values()), 0, LONGEST_S, bench.target.now_ns
    while repeats <= most:
        again, strays = bench.talk.hear_packet(wait_s)
        if again is None and STX not in strays:
            break
        repeats += 1
        wait_s = 1.2 * (bench.target.now_ns - since_ns) / 1e9 + glance_s(bench)
        since_ns = bench.target.now_ns
    bench.talk.send(ACK)
    if repeats > most:
        return f"{repeats} repeats and more"
    if repeats:
        return 0
    down_to_the_last(bench)
    bench.target.wait(LONGEST_S)
    waits = is_waiting(bench)
    return (1, 2) if waits is None else 2 if waits else 1


@probe()
def ack_timeout_ms(bench: Bench) -> Outcome:
    """From the end of a reply nobody answers to its repeat, or to where a NAK draws none."""
    action = bench.session.readings.get("ack_timeout_action", "")
    if action in ("", "wait"):
        bench.session.skip("it waits for ever" if action else "it may wait for ever")
    if action == "abandon":
        return _given_up_after(bench)
    _, replied_ns = unanswered(bench)
    for _ in range(MOST_STRAYS):
        first = bench.talk.hear(1, LONGEST_S)
        if first in (b"", STX):
            break
    came_ns = bench.target.now_ns  # its other bytes may come in a bunch
    again = bench.talk.rest_of_packet()[0] if first == STX else None
    bench.talk.send(ACK)
    if again is None:
        return f"no repeat within {LONGEST_S:.0f} s"
    return in_ms(bench, came_ns - replied_ns - bench.target.byte_ns, "ack_timeout_ms")


def _given_up_after(bench: Bench) -> Outcome:
    """For how long a reply can be refused, found by refusing it at different times."""
    default_ms = default_of(bench, "ack_timeout_ms")
    low_ms, high_ms = 0, round(LONGEST_S * 1000)
    tried_ms = default_ms
    while high_ms - low_ms > (1 if bench.target.is_virtual else COARSE_MS):
        if _is_held_for(bench, tried_ms):
            low_ms = tried_ms
        else:
            high_ms = tried_ms
        tried_ms = default_ms - 1 if high_ms == default_ms > low_ms + 1 else (low_ms + high_ms) // 2
    return in_ms(bench, high_ms * MS, "ack_timeout_ms")


def _is_held_for(bench: Bench, after_ms: int) -> bool:
    """True if a NAK that is there half a ms after that time still draws the reply again."""
    over_ns = down_to_the_last(bench)
    due_ns = over_ns + after_ms * MS + MS // 2 - bench.target.byte_ns
    bench.target.wait(max(0, due_ns - bench.target.now_ns) / 1e9)
    return bool(is_waiting(bench))


# --- what a unit makes of bytes that are no packets -----------------------------------------------


@probe()
def noise_in_idle(bench: Bench) -> Outcome:
    """00 FF to an idle unit."""
    bench.talk.send(b"\x00\xff")
    heard = bench.talk.listen(glance_s(bench))
    if heard.strip(NAK) and not bench.session.neighbours:  # several at once garble each other
        return codec.explain(heard)
    return int(bool(heard))


@probe()
def stx_while_waiting(bench: Bench) -> Outcome:
    """02h instead of our answer to RQSTAT's reply, then the rest of an RFLAG."""
    unanswered(bench)
    other = bench.talk.request(codec.rflag(0))
    bench.talk.send(other[:1])
    if repeat_at_once(bench):
        bench.talk.send(ACK)
        return 1
    bench.talk.send(other[1:])
    sign = bench.talk.hear(1, bench.talk.limit_s(len(other)))
    reply, _ = bench.talk.hear_packet() if sign == ACK else (None, b"")
    bench.talk.send(ACK)
    if reply is not None and reply.name == "RFLAG":
        return 0
    bench.talk.settle()
    return 2


@probe()
def junk_while_waiting(bench: Bench) -> Outcome:
    """00h instead of our answer to RQSTAT's reply, and what comes then."""
    if bench.session.neighbours and bench.session.reading("noise_in_idle") == "nak":
        bench.session.skip("the neighbours refuse it, and their NAKs are heard")
    return _after_junk(bench)


def _after_junk(bench: Bench) -> Outcome:
    down_to_the_last(bench)
    bench.talk.send(b"\x00")
    if repeat_at_once(bench):
        bench.talk.send(ACK)
        return 1
    if bench.session.readings.get("ack_timeout_action") == "retransmit":
        again, _ = bench.talk.hear_packet(bench.ack_timeout_s + glance_s(bench))
        bench.talk.send(ACK)
        return 0 if again is not None else 2
    waits = is_waiting(bench)
    return (0, 2) if waits is None else 0 if waits else 2


@probe()
def rx_while_busy(bench: Bench) -> Outcome:
    """The 02h of a packet right behind another one, and the rest of it later: whether that is a
    packet."""
    bad = codec.packet(bench.unit, RQSTAT, checksum=NO_SUM)
    bench.target.drain()
    bench.talk.send(bad + bad[:1])  # the NAK to the first comes later than that: two wires suffice
    first = bench.talk.hear(1, bench.talk.limit_s(len(bad)))
    bench.talk.send(bad[1:2])
    early = bench.talk.listen(glance_s(bench))  # to a unit number that stands alone (MSC-AMB-30)
    bench.talk.send(bad[2:])
    late = bench.talk.hear(1, bench.talk.limit_s(len(bad)))
    bench.talk.settle()
    if first != NAK:
        return codec.explain(first + early + late) or "nothing"
    return int(bool(early) or late != NAK)


# --- what is in a reply ---------------------------------------------------------------------------


@probe()
def reply_block(bench: Bench) -> Outcome:
    """Blocks of the replies to RQSTAT under block 1234h, 4321h and twice 0."""
    asked = (0x1234, 0x4321, 0, 0)
    came = tuple(bench.query(RQSTAT, block).block for block in asked)
    if came == (0, 0, 0, 0):
        return 0
    if came == asked:
        return 1
    steps = {(after - before) & 0xFFFF for before, after in pairwise(came)}
    return 2 if steps == {1} else " ".join(f"{number:04X}h" for number in came)


@probe()
def status_spare(bench: Bench) -> Outcome:
    """FF and AAAA in three replies to RQSTAT."""
    return int(any(any(bench.query(RQSTAT).payload[2:]) for _ in range(READS)))


@probe(switch="status_latch")
def status_latch_as_found(bench: Bench) -> Outcome:
    """RQSTAT twice, while it tells an error."""
    first, second = (bench.status() & ERRORS for _ in range(2))
    if not first:
        bench.session.skip("it tells no error")
    return int(second != first)


# --- who is answered ------------------------------------------------------------------------------


@probe(needs=("alone",))
def rs232_unit_check(bench: Bench) -> Outcome:
    """RQSTAT with unit 2 on RS-232."""
    _only_on_rs232(bench)
    drawn = drawn_by(bench, codec.packet(2, RQSTAT))
    return {Drawn.SILENCE: 0, Drawn.NAK: 1, Drawn.REPLY: 2}.get(drawn, drawn.value)


@probe(needs=("alone",), switch="junk_while_waiting")
def junk_while_waiting_alone(bench: Bench) -> Outcome:
    """The same without neighbours."""
    return _after_junk(bench)


@probe(needs=("alone",))
def reply_unit(bench: Bench) -> Outcome:
    """The unit number in a reply to unit 9."""
    _only_on_rs232(bench)
    if bench.session.reading("rs232_unit_check") != "ignore":
        bench.session.skip("it answers its own number only")
    drawn, reply = answer_to(bench, codec.packet(ABSENT[0], RQSTAT))
    if reply is None:
        return drawn.value
    return {bench.unit: 0, ABSENT[0]: 1}.get(reply.unit, f"unit {reply.unit}")


@probe(needs=("alone",), switch="timeout_before_unit")
def timeout_before_unit_on_rs232(bench: Bench) -> Outcome:
    """A lone 02h on RS-232."""
    _only_on_rs232(bench)
    return (0, 2) if lone_stx(bench) else 1


def _only_on_rs232(bench: Bench) -> None:
    if bench.is_rs485:
        bench.session.skip("only a unit 1 alone can be on RS-232")


def lone_stx(bench: Bench) -> bool:
    """Send 02h and nothing more; whether anything comes once T1 is over.  Afterwards it is idle."""
    bench.target.drain()
    bench.talk.send(STX)
    heard = bench.talk.hear(1, bench.packet_timeout_s + glance_s(bench))
    if not heard:  # one that waits for ever gets the rest, refused by its checksum
        bench.talk.send(codec.packet(bench.unit, RQSTAT, checksum=NO_SUM)[1:])
    if heard != NAK:
        bench.talk.settle()
    return bool(heard)


@probe()
def invalid_unit(bench: Bench) -> Outcome:
    """RQSTAT with units 0, 16 and 255."""
    _only_where_units_are_told_apart(bench)
    drawn = {drawn_by(bench, codec.packet(unit, RQSTAT)) for unit in (0, 16, 255)}
    if len(drawn) > 1:
        return " or ".join(sorted(drawn))
    # One that obeys does so without a word.  Where several refuse at once, that may be garbled.
    kind = drawn.pop()
    if kind is Drawn.SILENCE:
        return 0, 2
    return 1 if kind in (Drawn.NAK, Drawn.OTHER) else kind.value


@probe()
def other_unit_framing(bench: Bench) -> Outcome:
    """A packet for a unit that is not there, with a whole RQSTAT for this one inside."""
    _only_where_units_are_told_apart(bench)
    taken = (bench.unit, *bench.session.neighbours)
    absent = next(unit for unit in ABSENT if unit not in taken)
    inside = bench.talk.request(RQSTAT)
    transport = codec.packet(
        absent, RQSTAT + inside, checksum=NO_SUM
    )  # nobody's, should it be there
    drawn = drawn_by(bench, transport)
    bench.talk.settle()
    return int(drawn is not Drawn.SILENCE)


def _only_where_units_are_told_apart(bench: Bench) -> None:
    if not bench.is_rs485 and bench.session.reading("rs232_unit_check") != "silent":
        bench.session.skip("on RS-232 it answers whatever number it is called by")


# --- what the variables show ----------------------------------------------------------------------


@probe(needs=("variables",))
def data_address_stride(bench: Bench) -> Outcome:
    """BREAD of A, and which of its values DREAD of A+4, or a multiple of 4 further, shows."""
    first, end = block_of_variables(bench), bench.variables.stop - SAFE_BLOCK + 1
    for address in range(first, end, SAFE_BLOCK)[:BLOCKS]:
        values = bench.read_block(address)
        for step in range(1, len(values) // 4):
            shown = (values[step], values[2 * step], values[4 * step])
            if len(set(shown)) < len(shown):
                continue
            value = bench.read(address + 4 * step)
            return shown.index(value) if value in shown else f"{value}, in none of its places"
    return bench.session.skip("the values of the named variables do not differ")


@probe(needs=("program",))
def retransmit_content(bench: Bench) -> Outcome:
    """DREAD of a variable that counts, its reply refused."""
    if bench.session.neighbours and bench.session.reading("stray_nak") == "resend_last":
        bench.session.skip("the neighbours send again too")
    return _counting_on(bench)


@probe(needs=("program", "alone"), switch="retransmit_content")
def retransmit_content_alone(bench: Bench) -> Outcome:
    """The same without neighbours."""
    return _counting_on(bench)


def _counting_on(bench: Bench) -> Outcome:
    program = running_program(bench)
    first, _ = unanswered(bench, codec.dread(program.address + 4))
    bench.target.wait(min(SCANS_S, bench.ack_timeout_s / 2))
    bench.talk.send(NAK)
    again, _ = bench.talk.hear_packet()
    bench.talk.send(ACK)
    if again is None:
        return "no repeat"
    return int(again.raw != first.raw)


# --- what nothing on the line shows ---------------------------------------------------------------


@probe()
def rs485_mode(bench: Bench) -> Outcome:
    """Two wires or four."""
    bench.session.skip("nothing that is said tells: look at the cable")


@probe()
def ack_order(bench: Bench) -> Outcome:
    """Whether a write is carried out before its ACK."""
    bench.session.skip("the next command is served after both: it takes an output and an eye on it")
