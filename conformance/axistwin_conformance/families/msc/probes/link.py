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
from axistwin_conformance.families.msc.codec import ACK, MOST_STRAYS, NAK, RQSTAT, STX
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import DRAWN, DUE, LIMITS
from axistwin_conformance.families.msc.probing import (
    COARSE_MS,
    LINE_SLACK_NS,
    MS,
    MscReplyKind,
    answer_to,
    block_of_variables,
    default_of,
    down_to_the_last,
    glance_s,
    in_ms,
    is_waiting,
    longest_s,
    look_s,
    refusals,
    repeat_at_once,
    repeat_to_nak,
    reply_kind_of,
    running_program,
    unanswered,
)
from axistwin_conformance.families.msc.scratch import SAFE_BLOCK

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
def status_tail(driver: MscDriver) -> Outcome:
    """What follows SS in the reply to RQSTAT."""
    exchange = driver.ask(RQSTAT)
    size = len(exchange.reply.payload) - 2 if exchange.reply else -1
    return {6: 0, 4: 1}.get(size, str(exchange))


@probe()
def packet_timeout_mode(driver: MscDriver) -> Outcome:
    """The header of RQSTAT in a row, and begun slowly: the NAK comes so long after which byte."""
    straight_ns = _broken_off(driver)
    if straight_ns is None:
        return f"no NAK within {longest_s(driver):.0f} s of a header"
    byte_ns = driver.target.byte_ns
    pause_ns = straight_ns // 4
    raw = driver.client.request(RQSTAT)
    begun_ns = driver.client.send(raw[: HEADER - 1])
    driver.target.wait((pause_ns + HEADER * byte_ns) / 1e9)
    header_ns = driver.client.send(raw[HEADER - 1 : HEADER])
    driver.target.wait(pause_ns / 1e9)
    last_ns = driver.client.send(raw[HEADER : HEADER + 1])
    if driver.client.receive(1, longest_s(driver)) != NAK:
        return "a NAK to a header, and none to one that comes slowly"
    came_ns = driver.target.now_ns
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
def packet_timeout_ms(driver: MscDriver) -> Outcome:
    """From the first byte of a header, or its last (packet_timeout_mode), to the NAK."""
    took_ns = _broken_off(driver)
    if took_ns is None:
        return f"no NAK within {longest_s(driver):.0f} s of a header"
    counted_from = 0 if driver.session.reading("packet_timeout_mode") == "total" else HEADER - 1
    own_ns = (counted_from + 2) * driver.target.byte_ns  # that byte and the NAK take their own time
    return in_ms(driver, took_ns - own_ns, "packet_timeout_ms", is_from_sending=True)


def _broken_off(driver: MscDriver) -> int | None:
    """How long after a header began its NAK was there (ns); None if none came."""
    raw = codec.packet(driver.unit, RQSTAT, checksum=NO_SUM)
    driver.target.drain()
    sent_ns = driver.client.send(raw[:HEADER])
    received = driver.client.receive(1, longest_s(driver))
    came_ns = driver.target.now_ns
    if received == NAK:
        return came_ns - sent_ns
    driver.client.send(raw[HEADER:])  # or it would wait for ever
    driver.client.listen(glance_s(driver))
    return None


@probe()
def reply_delay_ms(driver: MscDriver) -> Outcome:
    """From the end of the ACK to the beginning of RQSTAT's reply."""
    exchange = driver.ask(RQSTAT)
    if not exchange.is_acked or exchange.reply is None:
        return str(exchange)
    own_ns = len(exchange.reply.raw) * driver.target.byte_ns
    waited_ns = exchange.replied_ns - exchange.signed_ns - own_ns
    if waited_ns < -LINE_SLACK_NS:
        driver.session.skip("this line gives its bytes in bunches")
    return in_ms(driver, waited_ns, "reply_delay_ms")


@probe()
def retransmit_limit(driver: MscDriver) -> Outcome:
    """RQSTAT, its reply refused until it comes no more."""
    unanswered(driver)
    count = refusals(driver)
    readings = list(LIMITS.values())
    return readings.index(count) if count in readings else f"{count} repeats"


@probe()
def stray_nak(driver: MscDriver) -> Outcome:
    """15h after a finished RQSTAT."""
    driver.ask(RQSTAT)
    is_repeated = repeat_to_nak(driver)
    driver.client.send(ACK)
    return int(is_repeated)


@probe()
def ack_timeout_action(driver: MscDriver) -> Outcome:
    """RQSTAT, and no answer to its reply: what comes by itself, and what a NAK draws after that."""
    unanswered(driver)
    most, repeats, wait_s, since_ns = (
        max(LIMITS.values()),
        0,
        longest_s(driver),
        driver.target.now_ns,
    )
    while repeats <= most:
        again, strays = driver.client.receive_packet(wait_s)
        if again is None and STX not in strays:
            break
        repeats += 1
        wait_s = 1.2 * (driver.target.now_ns - since_ns) / 1e9 + glance_s(driver)
        since_ns = driver.target.now_ns
    driver.client.send(ACK)
    if repeats > most:
        return f"{repeats} repeats and more"
    if repeats:
        return 0
    down_to_the_last(driver)
    driver.target.wait(longest_s(driver))
    waits = is_waiting(driver)
    return (1, 2) if waits is None else 2 if waits else 1


@probe()
def ack_timeout_ms(driver: MscDriver) -> Outcome:
    """From the end of a reply nobody answers to its repeat, or to where a NAK draws none."""
    action = driver.session.readings.get("ack_timeout_action", "")
    if action in ("", "wait"):
        driver.session.skip("it waits for ever" if action else "it may wait for ever")
    if action == "abandon":
        return _given_up_after(driver)
    _, replied_ns = unanswered(driver)
    for _ in range(MOST_STRAYS):
        first = driver.client.receive(1, longest_s(driver))
        if first in (b"", STX):
            break
    came_ns = driver.target.now_ns  # its other bytes may come in a bunch
    again = driver.client.rest_of_packet()[0] if first == STX else None
    driver.client.send(ACK)
    if again is None:
        return f"no repeat within {longest_s(driver):.0f} s"
    return in_ms(driver, came_ns - replied_ns - driver.target.byte_ns, "ack_timeout_ms")


def _given_up_after(driver: MscDriver) -> Outcome:
    """For how long a reply can be refused, found by refusing it at different times."""
    default_ms = default_of(driver, "ack_timeout_ms")
    low_ms, high_ms = 0, round(longest_s(driver) * 1000)
    tried_ms = default_ms
    while high_ms - low_ms > (1 if driver.target.is_virtual else COARSE_MS):
        if _is_held_for(driver, tried_ms):
            low_ms = tried_ms
        else:
            high_ms = tried_ms
        tried_ms = default_ms - 1 if high_ms == default_ms > low_ms + 1 else (low_ms + high_ms) // 2
    return in_ms(driver, high_ms * MS, "ack_timeout_ms")


def _is_held_for(driver: MscDriver, after_ms: int) -> bool:
    """True if a NAK that is there half a ms after that time still draws the reply again."""
    over_ns = down_to_the_last(driver)
    due_ns = over_ns + after_ms * MS + MS // 2 - driver.target.byte_ns
    driver.target.wait(max(0, due_ns - driver.target.now_ns) / 1e9)
    return bool(is_waiting(driver))


# --- what a unit makes of bytes that are no packets -----------------------------------------------


@probe()
def noise_in_idle(driver: MscDriver) -> Outcome:
    """00 FF to an idle unit."""
    received = driver.link.drawn_by(b"\x00\xff")
    if received.strip(NAK) and not driver.session.neighbours:  # several at once garble each other
        return codec.explain(received)
    return int(bool(received))


@probe()
def stx_while_waiting(driver: MscDriver) -> Outcome:
    """02h instead of our answer to RQSTAT's reply, then the rest of an RFLAG."""
    if driver.link.is_slow:
        return _stx_to_a_slow_unit(driver)
    other = driver.client.request(codec.rflag(0))
    own_s = len(other) * driver.target.byte_ns / 1e9
    if driver.client.packet_timeout_s < look_s(driver) + own_s:
        driver.session.skip("T1 runs out before the rest of the packet is sent")
    unanswered(driver)
    driver.client.send(other[:1])
    if repeat_at_once(driver):
        _end_repeat(driver)
        return 1
    driver.client.send(other[1:])
    sign = driver.client.receive(1, driver.client.limit_s(len(other)))
    reply, _ = driver.client.receive_packet() if sign == ACK else (None, b"")
    driver.client.send(ACK)
    if reply is not None and reply.name == "RFLAG":
        return 0
    driver.client.wait_until_quiet()
    return 2


def _stx_to_a_slow_unit(driver: MscDriver) -> Outcome:
    """The same without a pause, in which T1 or T2 would run out; then 02h alone."""
    driver.link.measure_if_slow()
    unanswered(driver)
    kind, reply = answer_to(driver, driver.client.request(codec.rflag(0)))
    if kind is MscReplyKind.REPLY and reply is not None and reply.name == "RFLAG":
        return 0
    driver.client.wait_until_quiet()
    _, over_ns = unanswered(driver)
    driver.client.send(STX)
    came = driver.link.drawn_again(over_ns)
    _end_repeat(driver)
    return tuple({DRAWN: 1, DUE: 2}[cause] for cause in came.causes) or (1 if came.strays else 2)


def _end_repeat(driver: MscDriver) -> None:
    """Acknowledge it, and wait out what a neighbour takes 02h for: the beginning of a packet."""
    driver.client.send(ACK)
    driver.client.wait_until_quiet()


@probe()
def junk_while_waiting(driver: MscDriver) -> Outcome:
    """00h instead of our answer to RQSTAT's reply, and what comes then."""
    if driver.session.neighbours and driver.session.reading("noise_in_idle") == "nak":
        driver.session.skip("the neighbours refuse it, and their NAKs are heard")
    return _after_junk(driver)


def _after_junk(driver: MscDriver) -> Outcome:
    driver.link.measure_if_slow()
    over_ns = down_to_the_last(driver)
    driver.client.send(b"\x00")
    came = driver.link.drawn_again(over_ns)
    if came.strays:  # of several units that talk at once nothing can be read
        driver.client.listen(glance_s(driver))
    if came.causes or came.strays.strip(ACK + NAK):
        driver.client.send(ACK)
        return tuple({DRAWN: 1, DUE: 0}[cause] for cause in came.causes) or 1
    if came.is_over:
        return 2 if driver.session.reading("ack_timeout_action") == "retransmit" else (0, 2)
    waits = _waits_still(driver)
    return (0, 2) if waits is None else 0 if waits else 2


def _waits_still(driver: MscDriver) -> bool | None:
    """Whether a unit with one repeat left sends it, by itself or to a NAK; None: this tells
    nothing.  Afterwards it is idle."""
    if driver.session.readings.get("ack_timeout_action") == "retransmit":
        again, _ = driver.client.receive_packet(driver.client.ack_timeout_s + glance_s(driver))
        driver.client.send(ACK)
        return again is not None
    return is_waiting(driver)


@probe()
def rx_while_busy(driver: MscDriver) -> Outcome:
    """The 02h of a packet right behind another one, and the rest of it later: whether that is a
    packet."""
    bad = codec.packet(driver.unit, RQSTAT, checksum=NO_SUM)
    if driver.client.packet_timeout_s < 2 * glance_s(driver):
        driver.session.skip("T1 runs out before the unit has surely answered")
    driver.target.drain()
    driver.client.send(
        bad + bad[:1]
    )  # the NAK to the first comes later than that: two wires suffice
    first = driver.client.receive(1, driver.client.limit_s(len(bad)))
    driver.client.send(bad[1:2])
    early = driver.client.listen(
        glance_s(driver)
    )  # to a unit number that stands alone (MSC-AMB-30)
    driver.client.send(bad[2:])
    late = driver.client.receive(1, driver.client.limit_s(len(bad)))
    driver.client.wait_until_quiet()
    if first != NAK:
        if driver.link.is_rs485 and driver.link.latency_ns < driver.target.byte_ns:
            driver.session.skip("on two wires its answer to the first packet meets the second")
        return codec.explain(first + early + late) or "nothing"
    return int(bool(early) or late != NAK)


@probe(needs=("alone",), switch="rx_while_busy")
def rx_while_busy_alone(driver: MscDriver) -> Outcome:
    """Two RQSTATs with wrong checksums, one right behind the other."""
    bad = codec.packet(driver.unit, RQSTAT, checksum=NO_SUM)
    received = driver.link.drawn_by_both(bad, bad)
    driver.client.wait_until_quiet()
    if received not in (NAK, NAK + NAK) and not driver.link.hears_while_it_talks():
        driver.session.skip("on two wires its answer to the first packet meets the second")
    if received and not received.strip(NAK) and driver.session.reading("noise_in_idle") == "nak":
        return (0, 1)  # what is left of a packet that was lost in part is refused too
    signs = {NAK + NAK: 0, NAK: 1}
    return signs.get(received, codec.explain(received) or "nothing")


# --- what is in a reply ---------------------------------------------------------------------------


@probe()
def reply_block(driver: MscDriver) -> Outcome:
    """Blocks of the replies to RQSTAT under block 1234h, 4321h and twice 0."""
    blocks = (0x1234, 0x4321, 0, 0)
    came = tuple(driver.query(RQSTAT, block).block for block in blocks)
    if came == (0, 0, 0, 0):
        return 0
    if came == blocks:
        return 1
    steps = {(after - before) & 0xFFFF for before, after in pairwise(came)}
    return 2 if steps == {1} else " ".join(f"{number:04X}h" for number in came)


@probe()
def status_spare(driver: MscDriver) -> Outcome:
    """FF and AAAA in three replies to RQSTAT."""
    return int(any(any(driver.query(RQSTAT).payload[2:]) for _ in range(READS)))


@probe(switch="status_latch")
def status_latch_as_found(driver: MscDriver) -> Outcome:
    """RQSTAT twice, while it tells an error."""
    first, second = (driver.status() & ERRORS for _ in range(2))
    if not first:
        driver.session.skip("it tells no error")
    return int(second != first)


# --- who is answered ------------------------------------------------------------------------------


@probe(needs=("alone",))
def rs232_unit_check(driver: MscDriver) -> Outcome:
    """RQSTAT with unit 2 on RS-232."""
    _only_on_rs232(driver)
    drawn = _drawn_by_number(driver, 2)
    return {MscReplyKind.SILENCE: 0, MscReplyKind.NAK: 1, MscReplyKind.REPLY: 2}.get(
        drawn, drawn.value
    )


@probe(needs=("alone",), switch="junk_while_waiting")
def junk_while_waiting_alone(driver: MscDriver) -> Outcome:
    """The same without neighbours."""
    return _after_junk(driver)


@probe(needs=("alone",))
def reply_unit(driver: MscDriver) -> Outcome:
    """The unit number in a reply to unit 9."""
    _only_on_rs232(driver)
    if driver.session.reading("rs232_unit_check") != "ignore":
        driver.session.skip("it answers its own number only")
    drawn, reply = answer_to(driver, codec.packet(ABSENT[0], RQSTAT))
    if reply is None:
        return drawn.value
    return {driver.unit: 0, ABSENT[0]: 1}.get(reply.unit, f"unit {reply.unit}")


@probe(needs=("alone",), switch="timeout_before_unit")
def timeout_before_unit_on_rs232(driver: MscDriver) -> Outcome:
    """A lone 02h on RS-232."""
    _only_on_rs232(driver)
    if lone_stx(driver):
        return (0, 2)
    return 1 if driver.link.is_surely_rs232() else (0, 1)


def _drawn_by_number(driver: MscDriver, unit: int) -> MscReplyKind:
    """What the number of a packet draws, be it not this unit's.

    A NAK and more is nothing that the number has drawn: who hunts for 02h behind it may refuse each
    byte on the way as noise (MSC-AMB-14, -30).
    """
    drawn = reply_kind_of(driver, codec.packet(unit, RQSTAT))
    if drawn is MscReplyKind.NAK and driver.client.listen(glance_s(driver)):
        return MscReplyKind.SILENCE
    return drawn


def _only_on_rs232(driver: MscDriver) -> None:
    if driver.link.is_rs485:
        driver.session.skip("only a unit 1 alone can be on RS-232")


def lone_stx(driver: MscDriver) -> bool:
    """Send 02h and nothing more; whether anything comes once T1 is over.  Afterwards it is idle."""
    driver.target.drain()
    driver.client.send(STX)
    received = driver.client.receive(1, driver.client.packet_timeout_s + glance_s(driver))
    if not received:  # one that waits for ever gets the rest, refused by its checksum
        driver.client.send(codec.packet(driver.unit, RQSTAT, checksum=NO_SUM)[1:])
    if received != NAK:
        driver.client.wait_until_quiet()
    return bool(received)


@probe()
def invalid_unit(driver: MscDriver) -> Outcome:
    """RQSTAT with units 0, 16 and 255."""
    _only_where_units_are_told_apart(driver)
    drawn = {_drawn_by_number(driver, unit) for unit in (0, 16, 255)}
    if len(drawn) > 1:
        return " or ".join(sorted(drawn))
    # One that obeys does so without a word.  Where several refuse at once, that may be garbled.
    kind = drawn.pop()
    if kind is MscReplyKind.SILENCE:
        return 0, 2
    return 1 if kind in (MscReplyKind.NAK, MscReplyKind.OTHER) else kind.value


@probe()
def other_unit_framing(driver: MscDriver) -> Outcome:
    """A packet for a unit that is not there, with a whole RQSTAT for this one inside."""
    _only_where_units_are_told_apart(driver)
    inside = driver.client.request(RQSTAT)
    transport = _for_nobody(driver, RQSTAT + inside)
    drawn = reply_kind_of(driver, transport)
    driver.client.wait_until_quiet()
    return int(drawn is not MscReplyKind.SILENCE)


@probe()
def pending_reply_on_stx(driver: MscDriver) -> Outcome:
    """RQSTAT, its reply left unanswered, a packet for a unit that is not there, and what comes
    then."""
    _only_where_units_are_told_apart(driver)
    for switch, seen in (("stx_while_waiting", "serve"), ("other_unit_framing", "skip_by_length")):
        if driver.session.reading(switch) != seen:
            driver.session.skip(f"this device has {switch}={driver.session.reading(switch)}")
    raw = _for_nobody(driver, RQSTAT)
    if (
        driver.client.ack_timeout_s * 1e9
        < 4 * len(raw) * driver.target.byte_ns + driver.target.line_ns
    ):
        driver.session.skip("T2 is too short to send a packet amid the wait")
    down_to_the_last(driver)
    driver.client.send(raw)
    waits = _waits_still(driver)
    return (0, 1) if waits is None else int(waits)


def _for_nobody(driver: MscDriver, body: bytes) -> bytes:
    """A packet for a unit that is not there, and nobody's by its checksum, should it be there."""
    taken = (driver.unit, *driver.session.neighbours)
    absent = next(unit for unit in ABSENT if unit not in taken)
    return codec.packet(absent, body, checksum=NO_SUM)


def _only_where_units_are_told_apart(driver: MscDriver) -> None:
    if not driver.link.is_rs485 and driver.session.reading("rs232_unit_check") != "silent":
        driver.session.skip("on RS-232 it answers whatever number it is called by")


# --- what the variables show ----------------------------------------------------------------------


@probe(needs=("variables",))
def data_address_stride(driver: MscDriver) -> Outcome:
    """BREAD of A, and which of its values DREAD of A+4, or a multiple of 4 further, shows."""
    first, end = block_of_variables(driver), driver.scratch.variables.stop - SAFE_BLOCK + 1
    for address in range(first, end, SAFE_BLOCK)[:BLOCKS]:
        values = driver.read_block(address)
        for step in range(1, len(values) // 4):
            shown = (values[step], values[2 * step], values[4 * step])
            if len(set(shown)) < len(shown):
                continue
            value = driver.read(address + 4 * step)
            return shown.index(value) if value in shown else f"{value}, in none of its places"
    return driver.session.skip("the values of the named variables do not differ")


@probe(needs=("program",))
def retransmit_content(driver: MscDriver) -> Outcome:
    """DREAD of a variable that counts, its reply refused."""
    if driver.session.neighbours and driver.session.reading("stray_nak") == "resend_last":
        driver.session.skip("the neighbours send again too")
    return _counting_on(driver)


@probe(needs=("program", "alone"), switch="retransmit_content")
def retransmit_content_alone(driver: MscDriver) -> Outcome:
    """The same without neighbours."""
    return _counting_on(driver)


def _counting_on(driver: MscDriver) -> Outcome:
    program = running_program(driver)
    first, _ = unanswered(driver, codec.dread(program.address + 4))
    driver.target.wait(min(SCANS_S, driver.client.ack_timeout_s / 2))
    driver.client.send(NAK)
    again, _ = driver.client.receive_packet()
    driver.client.send(ACK)
    if again is None:
        return "no repeat"
    return int(again.raw != first.raw)


# --- what nothing on the line shows ---------------------------------------------------------------


@probe()
def rs485_mode(driver: MscDriver) -> Outcome:
    """Two wires or four."""
    driver.session.skip("nothing that is said tells: look at the cable")


@probe()
def ack_order(driver: MscDriver) -> Outcome:
    """Whether a write is carried out before its ACK."""
    driver.session.skip(
        "the next command is served after both: it takes an output and an eye on it"
    )
