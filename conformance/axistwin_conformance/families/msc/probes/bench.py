"""Which readings a unit follows in what may disturb a controller in use: unknown names, bodies of a
wrong size, places that do not exist; and in what somebody has to bring about by hand."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import (
    BLOCK_VALUES,
    COMMA,
    IMPOSSIBLE_NAME,
    MAX_BODY,
    NAK,
    RQSTAT,
    VALUE_BYTES,
)
from axistwin_conformance.families.msc.driver import SAFE_STRIDE, Bench
from axistwin_conformance.families.msc.probes.link import lone_stx
from axistwin_conformance.families.msc.probes.writes import MARK, OTHER
from axistwin_conformance.families.msc.probing import (
    Answer,
    Drawn,
    answer_now,
    answer_to,
    drawn_by,
    glance_s,
    odd_packet,
    variable,
)

ORDER = 30  # of this module in a run; see `Family.modules`

BENCH: Final = ("bench",)
WORKED: Final = ("stored", "rig")
WITH_VARIABLES: Final = ("bench", "variables")
BEYOND: Final = 256  # of a flag number
LAST: Final = 0xFFFC  # the last address of a value there can be
SIZES: Final = tuple(1 << bit for bit in range(15, 9, -1))  # of a data area that wraps
SLOW_BAUD: Final = 4800
# At half the rate its start bit and four zeros are ten bits of ours: one 00h without a stop bit.
STOPLESS: Final = b"\xf0"
INPUT: Final = 0  # in the twin's flag map
ERROR_BIT: Final = 12
LOADING_BIT: Final = 10
UNKNOWN: Final = {"nak": Drawn.NAK, "ack_ignore": Drawn.ACK, "silent": Drawn.SILENCE}


# --- bodies ---------------------------------------------------------------------------------------


@probe(safety="rig", needs=BENCH)
def unknown_command(bench: Bench) -> Outcome:
    """A name no command can have."""
    drawn = drawn_by(bench, odd_packet(bench, codec.body(IMPOSSIBLE_NAME)))
    readings = list(UNKNOWN.values())
    return readings.index(drawn) if drawn in readings else drawn.value


def _as_unknown(bench: Bench) -> Drawn:
    return UNKNOWN[bench.session.reading("unknown_command")]


@probe(safety="rig", needs=BENCH)
def rflags_unsupported(bench: Bench) -> Outcome:
    """RFLAGS to a model that does not have it."""
    if bench.has_rflags:
        bench.session.skip("this model has RFLAGS")
    return _unknown_or_acked(bench, codec.RFLAGS)


@probe(safety="rig", needs=BENCH)
def empty_body(bench: Bench) -> Outcome:
    """A packet of length 0."""
    return _unknown_or_acked(bench, b"")


def _unknown_or_acked(bench: Bench, body: bytes) -> Outcome:
    drawn, usual = drawn_by(bench, odd_packet(bench, body)), _as_unknown(bench)
    if drawn is Drawn.ACK:
        return (0, 1) if usual is Drawn.ACK else 1
    return 0 if drawn is usual else drawn.value


@probe(safety="rig", needs=BENCH)
def malformed_body(bench: Bench) -> Outcome:
    """RQSTAT with one byte too many."""
    drawn = drawn_by(bench, odd_packet(bench, RQSTAT + b"\x00"))
    return {Drawn.NAK: 0, Drawn.ACK: 1, Drawn.REPLY: 2}.get(drawn, drawn.value)


@probe(safety="rig", needs=BENCH)
def comma(bench: Bench) -> Outcome:
    """RQSTAT without its comma."""
    return _refused_or_served(bench, RQSTAT.removesuffix(COMMA))


@probe(safety="rig", needs=BENCH)
def case_sensitive(bench: Bench) -> Outcome:
    """RQSTAT in lower case."""
    return _refused_or_served(bench, RQSTAT.lower())


def _refused_or_served(bench: Bench, body: bytes) -> Outcome:
    drawn = drawn_by(bench, odd_packet(bench, body))
    if drawn is Drawn.REPLY:
        return 1
    return 0 if drawn is _as_unknown(bench) else drawn.value


@probe(safety="rig", needs=BENCH)
def overlength(bench: Bench) -> Outcome:
    """A header that announces 241 bytes, and what comes before, after and long after the rest."""
    body, heard_as = _too_long(bench)
    whole = odd_packet(bench, body + bytes(MAX_BODY + 1 - len(body)))
    spare_s = max(0.0, bench.packet_timeout_s - len(whole) * bench.target.byte_ns / 1e9) / 3
    at_once_s = min(glance_s(bench), spare_s)
    bench.target.drain()
    bench.talk.send(whole[: codec.HEADER_BYTES])
    if bench.talk.hear(1, at_once_s + codec.HEADER_BYTES * bench.target.byte_ns / 1e9) == NAK:
        return 1
    rest = whole[codec.HEADER_BYTES :]
    bench.talk.send(rest)
    drawn, _ = answer_now(bench, len(rest) * bench.target.byte_ns / 1e9 + at_once_s)
    if drawn is Drawn.SILENCE:
        if bench.talk.hear(1, bench.packet_timeout_s + glance_s(bench)) == NAK:
            return 2
        return 3 if heard_as is Drawn.SILENCE else "no NAK at all"
    if drawn is Drawn.NAK:
        return (0, 3) if heard_as is Drawn.NAK else 0
    return 3 if drawn is heard_as else drawn.value


def _too_long(bench: Bench) -> tuple[bytes, Drawn]:
    """The beginning of a body, and what a unit that takes too long a one draws it for: something
    else than a NAK, if there is any."""
    malformed = bench.session.reading("malformed_body")
    if malformed != "nak":
        return RQSTAT, Drawn.REPLY if malformed == "lenient" else Drawn.ACK
    return codec.body(IMPOSSIBLE_NAME), _as_unknown(bench)


@probe(safety="rig", needs=BENCH)
def uart_error(bench: Bench) -> Outcome:
    """RQSTAT with a character without a stop bit in its block number."""
    if bench.target.description.startswith("socket:"):
        bench.session.skip("a plain socket carries bytes, not the shape of a character")
    raw, own = bench.talk.request(RQSTAT), bench.target.baud
    place = codec.HEADER_BYTES - 1
    bench.target.drain()
    bench.talk.send(raw[:place])
    bench.target.wait((place + 1) * bench.target.byte_ns / 1e9)
    try:
        bench.target.baud = SLOW_BAUD
        bench.talk.send(STOPLESS)
        bench.target.wait(2 * bench.target.byte_ns / 1e9)
    finally:
        bench.target.baud = own
    rest = raw[place + 1 :]
    bench.talk.send(rest)
    first = bench.talk.hear(1, bench.talk.limit_s(len(rest)))
    if first == NAK:
        return 0
    if not first:
        late = bench.talk.hear(1, bench.packet_timeout_s + glance_s(bench))
        bench.talk.settle()
        return 2 if late == NAK else "no NAK"
    bench.talk.settle()
    return 1


@probe(safety="rig", needs=BENCH, switch="timeout_before_unit")
def timeout_before_unit_on_rs485(bench: Bench) -> Outcome:
    """A lone 02h on RS-485."""
    if not bench.is_rs485:
        bench.session.skip("a unit 1 alone may be on RS-232")
    return 2 if lone_stx(bench) else (0, 1)


def _asked(bench: Bench, body: bytes) -> Answer:
    """What a sound packet draws that may well be refused: once, for that is no noise."""
    return answer_to(bench, bench.talk.request(body))


# --- places ---------------------------------------------------------------------------------------


@probe(safety=WORKED, needs=WITH_VARIABLES)
def data_misaligned(bench: Bench) -> Outcome:
    """DREAD of A+1 between two known values."""
    if bench.stride == 1:
        bench.session.skip("every address is a variable's own")
    address, values = variable(bench), (MARK, OTHER)
    for number, value in enumerate(values):
        bench.write(address + number * bench.stride, value)
    drawn, reply = _asked(bench, codec.dread(address + 1))
    if reply is None:
        return 1 if drawn is Drawn.NAK else drawn.value
    within = VALUE_BYTES // bench.stride  # of the bytes of both: where A+1 begins
    overlapping = b"".join(map(codec.i32, values))[within : within + VALUE_BYTES]
    value = reply.values[0]
    return {int.from_bytes(overlapping, "big", signed=True): 0, MARK: 2}.get(value, f"{value:X}h")


@probe(safety=WORKED, needs=WITH_VARIABLES)
def data_out_of_range(bench: Bench) -> Outcome:
    """DREAD of FFFCh, and of where a named variable would be found again."""
    drawn, reply = _asked(bench, codec.dread(LAST))
    if reply is None:
        return 0 if drawn is Drawn.NAK else drawn.value
    if _wrapped_size(bench):
        return 2
    if reply.values[0]:
        bench.session.skip("it has a value at FFFCh")
    if not bench.target.is_builtin:
        return 0, 1  # it may have a variable there, and that hold 0: nobody has named it
    bench.write(LAST, MARK)
    is_kept = _has(bench, LAST, MARK)
    bench.write(LAST, 0)
    if is_kept:
        bench.session.skip("its data area goes on to FFFCh")
    return 1


def _wrapped_size(bench: Bench) -> int:
    """The size of the data area, where addresses behind it begin again; 0 if they do not."""
    address = variable(bench)
    bench.write(address, MARK)
    found = [size for size in SIZES if _has(bench, address + size, MARK)]
    return min(found, default=0)


def _has(bench: Bench, address: int, value: int) -> bool:
    _, reply = _asked(bench, codec.dread(address))
    return reply is not None and reply.values[0] == value


def _is_refused(bench: Bench, address: int) -> bool:
    return _asked(bench, codec.dread(address))[0] is Drawn.NAK


def _end(bench: Bench) -> int:
    """The first address behind the data area; 0 if nothing shows it."""
    reading = bench.session.reading("data_out_of_range")
    if reading != "nak":
        return _wrapped_size(bench) if reading == "wrap" else SIZES[0]
    likely = SIZES[0]
    if _is_refused(bench, likely) and not _is_refused(bench, likely - SAFE_STRIDE):
        return likely
    low, high = variable(bench), LAST
    if not _is_refused(bench, high):
        return 0
    while high - low > SAFE_STRIDE:
        middle = (low + high) // 2 // SAFE_STRIDE * SAFE_STRIDE
        if _is_refused(bench, middle):
            high = middle
        else:
            low = middle
    return high


@probe(safety=WORKED, needs=WITH_VARIABLES)
def block_overrun(bench: Bench) -> Outcome:
    """BREAD of the last value of the data area and what follows, beside its first ones."""
    end = _end(bench)
    if not end:
        bench.session.skip("the end of the data area does not show")
    drawn, reply = _asked(bench, codec.bread(end - SAFE_STRIDE))
    if reply is None:
        return 0 if drawn is Drawn.NAK else drawn.value
    values = reply.values
    inside = SAFE_STRIDE // bench.stride
    if len(values) < BLOCK_VALUES:
        return 1
    first = bench.read(0)
    if not first:  # only on a twin: no operator names the beginning of somebody's program
        bench.write(0, MARK)
        values = bench.query(codec.bread(end - SAFE_STRIDE)).values
        first = bench.read(0)
        bench.write(0, 0)
    if values[inside] == first:
        return 2
    return f"{values[inside:]} behind the end" if any(values[inside:]) else 1


@probe(safety="rig", needs=BENCH)
def flag_out_of_range(bench: Bench) -> Outcome:
    """RFLAG of 256 and a flag that is on."""
    states = bench.flags()
    on = sorted(codec.flags_on(states)) if states is not None else []
    return _beyond(bench, on[0] if on else None)


@probe(safety=WORKED, needs=("bench", "flags"), switch="flag_out_of_range")
def flag_out_of_range_of_a_set_flag(bench: Bench) -> Outcome:
    """RFLAG of 256 and a flag that was set."""
    number = bench.flags_free[0]
    bench.set_flag(number)
    try:
        return _beyond(bench, number)
    finally:
        bench.clear_flag(number)


def _beyond(bench: Bench, on: int | None) -> Outcome:
    drawn, reply = _asked(bench, codec.rflag(BEYOND + (on or 0)))
    if reply is None:
        return 0 if drawn is Drawn.NAK else drawn.value
    if reply.numbers == (1,):
        return 2
    return (1, 2) if on is None else 1


@probe(safety=WORKED, needs=("bench", "rig:program"))
def flag_write_readonly(bench: Bench) -> Outcome:
    """SFLAG of an input, and RFLAG of it while no program scans it."""
    rig = bench.session.rig
    if bench.flag(INPUT):
        bench.session.skip("the input is on")
    rig.run_program(False)
    try:
        drawn, _ = _asked(bench, codec.sflag(INPUT))
        is_on = bench.flag(INPUT)
        if is_on:
            _asked(bench, codec.cflag(INPUT))
    finally:
        rig.run_program(True)
    if drawn is Drawn.NAK:
        return 1
    return drawn.value if drawn is Drawn.SILENCE else 2 * is_on


# --- states ---------------------------------------------------------------------------------------


@probe(safety="rig", needs=("rig:status",))
def status_latch(bench: Bench) -> Outcome:
    """RQSTAT twice, while an error is brought about."""
    bench.session.rig.set_status(ERROR_BIT, True)
    first, second = (bench.status() >> ERROR_BIT & 1 for _ in range(2))
    bench.session.rig.set_status(ERROR_BIT, False)
    return int(not second) if first else f"bit {ERROR_BIT} does not show"


@probe(safety="rig", needs=("rig:program",))
def stopped_access(bench: Bench) -> Outcome:
    """DREAD while the macroprogram is stopped."""
    bench.session.rig.run_program(False)
    try:
        return _read_or_refused(bench)
    finally:
        bench.session.rig.run_program(True)


@probe(safety="rig", needs=("rig:status",))
def loading_access(bench: Bench) -> Outcome:
    """DREAD while a program load is in progress."""
    bench.session.rig.set_status(LOADING_BIT, True)
    try:
        return _read_or_refused(bench)
    finally:
        bench.session.rig.set_status(LOADING_BIT, False)


def _read_or_refused(bench: Bench) -> Outcome:
    address = next((address for address in bench.variables if address % SAFE_STRIDE == 0), 0)
    drawn, _ = _asked(bench, codec.dread(address))
    return {Drawn.REPLY: 0, Drawn.NAK: 1}.get(drawn, drawn.value)
