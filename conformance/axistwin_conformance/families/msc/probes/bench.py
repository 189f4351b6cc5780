"""Which readings a unit follows in what may disturb a controller in use: unknown names, bodies of a
wrong size, places that do not exist; and in what somebody has to bring about by hand."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.client import MARGIN_S
from axistwin_conformance.families.msc.codec import (
    BLOCK_VALUES,
    COMMA,
    IMPOSSIBLE_NAME,
    MAX_BODY,
    NAK,
    RQSTAT,
    VALUE_BYTES,
)
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.probes.link import lone_stx
from axistwin_conformance.families.msc.probes.writes import MARK, OTHER
from axistwin_conformance.families.msc.probing import (
    Answer,
    MscReplyKind,
    answer_now,
    answer_to,
    glance_s,
    odd_packet,
    reply_kind_of,
    variable,
)
from axistwin_conformance.families.msc.scratch import SAFE_STRIDE, first_outside

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
UNKNOWN: Final = {
    "nak": MscReplyKind.NAK,
    "ack_ignore": MscReplyKind.ACK,
    "silent": MscReplyKind.SILENCE,
}


# --- bodies ---------------------------------------------------------------------------------------


@probe(safety="rig", needs=BENCH)
def unknown_command(driver: MscDriver) -> Outcome:
    """A name no command can have."""
    drawn = reply_kind_of(driver, odd_packet(driver, codec.body(IMPOSSIBLE_NAME)))
    readings = list(UNKNOWN.values())
    return readings.index(drawn) if drawn in readings else drawn.value


def _as_unknown(driver: MscDriver) -> MscReplyKind:
    return UNKNOWN[driver.session.reading("unknown_command")]


@probe(safety="rig", needs=BENCH)
def rflags_unsupported(driver: MscDriver) -> Outcome:
    """RFLAGS to a model that does not have it."""
    if driver.has_rflags:
        driver.session.skip("this model has RFLAGS")
    return _unknown_or_acked(driver, codec.RFLAGS)


@probe(safety="rig", needs=BENCH)
def empty_body(driver: MscDriver) -> Outcome:
    """A packet of length 0."""
    return _unknown_or_acked(driver, b"")


def _unknown_or_acked(driver: MscDriver, body: bytes) -> Outcome:
    drawn, usual = reply_kind_of(driver, odd_packet(driver, body)), _as_unknown(driver)
    if drawn is MscReplyKind.ACK:
        return (0, 1) if usual is MscReplyKind.ACK else 1
    return 0 if drawn is usual else drawn.value


@probe(safety="rig", needs=BENCH)
def malformed_body(driver: MscDriver) -> Outcome:
    """RQSTAT with one byte too many."""
    drawn = reply_kind_of(driver, odd_packet(driver, RQSTAT + b"\x00"))
    return {MscReplyKind.NAK: 0, MscReplyKind.ACK: 1, MscReplyKind.REPLY: 2}.get(drawn, drawn.value)


@probe(safety="rig", needs=BENCH)
def comma(driver: MscDriver) -> Outcome:
    """RQSTAT without its comma."""
    return _refused_or_served(driver, RQSTAT.removesuffix(COMMA))


@probe(safety="rig", needs=BENCH)
def case_sensitive(driver: MscDriver) -> Outcome:
    """RQSTAT in lower case."""
    return _refused_or_served(driver, RQSTAT.lower())


def _refused_or_served(driver: MscDriver, body: bytes) -> Outcome:
    drawn = reply_kind_of(driver, odd_packet(driver, body))
    if drawn is MscReplyKind.REPLY:
        return 1
    return 0 if drawn is _as_unknown(driver) else drawn.value


@probe(safety="rig", needs=BENCH)
def overlength(driver: MscDriver) -> Outcome:
    """A header that announces 241 bytes, and what comes before, after and long after the rest."""
    body, received_as = _too_long(driver)
    whole = odd_packet(driver, body + bytes(MAX_BODY + 1 - len(body)))
    spare_s = (
        max(0.0, driver.client.packet_timeout_s - len(whole) * driver.target.byte_ns / 1e9) / 3
    )
    at_once_s = min(glance_s(driver), spare_s)
    if (
        at_once_s
        < (driver.link.latency_ns + 3 * driver.target.byte_ns + driver.link.spare_ns) / 1e9
    ):
        driver.session.skip("T1 runs out about when such a packet ends")
    driver.target.drain()
    driver.client.send(whole[: codec.HEADER_BYTES])
    if (
        driver.client.receive(1, at_once_s + codec.HEADER_BYTES * driver.target.byte_ns / 1e9)
        == NAK
    ):
        return 1
    rest = whole[codec.HEADER_BYTES :]
    driver.client.send(rest)
    drawn, _ = answer_now(driver, len(rest) * driver.target.byte_ns / 1e9 + at_once_s)
    if drawn is MscReplyKind.SILENCE:
        if driver.client.receive(1, driver.client.packet_timeout_s + glance_s(driver)) == NAK:
            return 2
        return 3 if received_as is MscReplyKind.SILENCE else "no NAK at all"
    if drawn is MscReplyKind.NAK:
        return (0, 3) if received_as is MscReplyKind.NAK else 0
    return 3 if drawn is received_as else drawn.value


def _too_long(driver: MscDriver) -> tuple[bytes, MscReplyKind]:
    """The beginning of a body, and what a unit that takes too long a one draws it for: something
    else than a NAK, if there is any."""
    malformed = driver.session.reading("malformed_body")
    if malformed != "nak":
        return RQSTAT, MscReplyKind.REPLY if malformed == "lenient" else MscReplyKind.ACK
    return codec.body(IMPOSSIBLE_NAME), _as_unknown(driver)


@probe(safety="rig", needs=BENCH)
def uart_error(driver: MscDriver) -> Outcome:
    """RQSTAT with a character without a stop bit in its block number."""
    if driver.target.description.startswith("socket:"):
        driver.session.skip("a plain socket carries bytes, not the shape of a character")
    raw, own = driver.client.request(RQSTAT), driver.target.baud
    place = codec.HEADER_BYTES - 1
    driver.target.drain()
    begun_ns = driver.target.now_ns
    driver.client.send(raw[:place])
    driver.target.wait((place + 1) * driver.target.byte_ns / 1e9)
    try:
        driver.target.baud = SLOW_BAUD
        driver.client.send(STOPLESS)
        driver.target.wait(2 * driver.target.byte_ns / 1e9)
    finally:
        driver.target.baud = own
    rest = raw[place + 1 :]
    driver.client.send(rest)
    limit_s = driver.client.limit_s(len(rest))
    first = driver.client.receive(1, limit_s)
    if first == NAK:
        # Of one that comes when T1 may have run out nobody can tell what it is for.
        seconds = (driver.target.now_ns - begun_ns) / 1e9
        return 0 if seconds + MARGIN_S < driver.client.packet_timeout_s else (0, 2)
    if not first:
        late = driver.client.receive(1, driver.client.packet_timeout_s + glance_s(driver))
        driver.client.wait_until_quiet()
        return 2 if late == NAK else "no NAK"
    driver.client.wait_until_quiet()
    return 1


@probe(safety="rig", needs=BENCH, switch="timeout_before_unit")
def timeout_before_unit_on_rs485(driver: MscDriver) -> Outcome:
    """A lone 02h on RS-485."""
    if not driver.link.is_rs485:
        driver.session.skip("a unit 1 alone may be on RS-232")
    return 2 if lone_stx(driver) else (0, 1)


def _ask(driver: MscDriver, body: bytes) -> Answer:
    """What a sound packet draws that may well be refused: once, for that is no noise."""
    return answer_to(driver, driver.client.request(body))


# --- places ---------------------------------------------------------------------------------------


@probe(safety=WORKED, needs=WITH_VARIABLES)
def data_misaligned(driver: MscDriver) -> Outcome:
    """DREAD of A+1 between two known values."""
    if driver.scratch.stride == 1:
        driver.session.skip("every address is a variable's own")
    address, values = variable(driver), (MARK, OTHER)
    if not driver.scratch.may_write(address, len(values)):
        driver.session.skip("needs 2 variables in a row (--variables FIRST-LAST)")
    for number, value in enumerate(values):
        driver.write(address + number * driver.scratch.stride, value)
    drawn, reply = _ask(driver, codec.dread(address + 1))
    if reply is None:
        return 1 if drawn is MscReplyKind.NAK else drawn.value
    within = VALUE_BYTES // driver.scratch.stride  # of the bytes of both: where A+1 begins
    overlapping = b"".join(map(codec.i32, values))[within : within + VALUE_BYTES]
    value = reply.values[0]
    return {int.from_bytes(overlapping, "big", signed=True): 0, MARK: 2}.get(value, f"{value:X}h")


@probe(safety=WORKED, needs=WITH_VARIABLES)
def data_out_of_range(driver: MscDriver) -> Outcome:
    """DREAD of FFFCh, and of where a named variable would be found again."""
    drawn, reply = _ask(driver, codec.dread(LAST))
    if reply is None:
        return 0 if drawn is MscReplyKind.NAK else drawn.value
    if _wrapped_size(driver):
        return 2
    if reply.values[0]:
        driver.session.skip("it has a value at FFFCh")
    if not driver.target.is_builtin:
        return 0, 1  # it may have a variable there, and that hold 0: nobody has named it
    if _keeps(driver, LAST):
        driver.session.skip("its data area goes on to FFFCh")
    return 1


def _wrapped_size(driver: MscDriver) -> int:
    """The size of the data area, where addresses behind it begin again; 0 if they do not."""
    address = variable(driver)
    driver.write(address, MARK)
    found = [size for size in SIZES if _has(driver, address + size, MARK)]
    return min(found, default=0)


def _has(driver: MscDriver, address: int, value: int) -> bool:
    _, reply = _ask(driver, codec.dread(address))
    return reply is not None and reply.values[0] == value


def _end(driver: MscDriver) -> int:
    """The first address behind the data area; 0 if nothing shows it."""
    reading = driver.session.reading("data_out_of_range")
    if reading == "wrap":
        return _wrapped_size(driver)
    if reading == "zero" and not driver.target.is_builtin:
        return 0  # what is read there may be a variable that is 0, and nobody has named it

    def is_outside(address: int) -> bool:
        if reading == "zero":
            return not _keeps(driver, address)
        return _ask(driver, codec.dread(address))[0] is MscReplyKind.NAK

    likely, stride = SIZES[0], driver.scratch.stride
    if is_outside(likely) and not is_outside(likely - stride):
        return likely
    if not is_outside(LAST):
        return 0
    return first_outside(is_outside, variable(driver), LAST, stride)


def _keeps(driver: MscDriver, address: int) -> bool:
    """Whether what is written there is read again; it is put back."""
    before = driver.read(address)
    mark = MARK if before != MARK else OTHER
    driver.write(address, mark)
    is_kept = _has(driver, address, mark)
    driver.write(address, before)
    return is_kept


@probe(safety=WORKED, needs=WITH_VARIABLES)
def block_overrun(driver: MscDriver) -> Outcome:
    """BREAD of the last value of the data area and what follows, beside its first ones."""
    end = _end(driver)
    if not end:
        driver.session.skip("the end of the data area does not show")
    drawn, reply = _ask(driver, codec.bread(end - SAFE_STRIDE))
    if reply is None:
        return 0 if drawn is MscReplyKind.NAK else drawn.value
    values = reply.values
    inside = SAFE_STRIDE // driver.scratch.stride
    if len(values) < BLOCK_VALUES:
        return 1
    first = driver.read(0)
    is_named = driver.link.is_twin or driver.scratch.may_write(0)
    if not first and not is_named:  # a wrap shows zeros as well, if only the first ones
        return 2 if any(values[inside:]) and not values[inside] else (1, 2)
    if not first:
        driver.write(0, MARK)
        values = driver.query(codec.bread(end - SAFE_STRIDE)).values
        first = driver.read(0)
        driver.write(0, 0)
    if values[inside] == first:
        return 2
    return f"{values[inside:]} behind the end" if any(values[inside:]) else 1


@probe(safety="rig", needs=BENCH)
def flag_out_of_range(driver: MscDriver) -> Outcome:
    """RFLAG of 256 and a flag that is on."""
    states = driver.flags()
    on = sorted(codec.flags_on(states)) if states is not None else []
    return _beyond(driver, on[0] if on else None)


@probe(safety=WORKED, needs=("bench", "flags"), switch="flag_out_of_range")
def flag_out_of_range_of_a_set_flag(driver: MscDriver) -> Outcome:
    """RFLAG of 256 and a flag that was set."""
    number = driver.scratch.flags[0]
    driver.set_flag(number)
    try:
        return _beyond(driver, number)
    finally:
        driver.clear_flag(number)


def _beyond(driver: MscDriver, on: int | None) -> Outcome:
    drawn, reply = _ask(driver, codec.rflag(BEYOND + (on or 0)))
    if reply is None:
        return 0 if drawn is MscReplyKind.NAK else drawn.value
    if reply.numbers == (1,):
        return 2
    return (1, 2) if on is None else 1


@probe(safety=WORKED, needs=("bench", "rig:program"))
def flag_write_readonly(driver: MscDriver) -> Outcome:
    """SFLAG of an input, and RFLAG of it while no program scans it."""
    rig = driver.session.rig
    if driver.flag(INPUT):
        driver.session.skip("the input is on")
    rig.work("program", False)
    try:
        drawn, _ = _ask(driver, codec.sflag(INPUT))
        is_on = driver.flag(INPUT)
        if is_on:
            _ask(driver, codec.cflag(INPUT))
    finally:
        rig.work("program", True)
    if drawn is MscReplyKind.NAK:
        return 1
    return drawn.value if drawn is MscReplyKind.SILENCE else 2 * is_on


# --- states ---------------------------------------------------------------------------------------


@probe(safety="rig", needs=("rig:status",))
def status_latch(driver: MscDriver) -> Outcome:
    """RQSTAT twice, while an error is brought about."""
    driver.session.rig.work("status", True, number=ERROR_BIT)
    first, second = (driver.status() >> ERROR_BIT & 1 for _ in range(2))
    driver.session.rig.work("status", False, number=ERROR_BIT)
    return int(not second) if first else f"bit {ERROR_BIT} does not show"


@probe(safety="rig", needs=("rig:program",))
def stopped_access(driver: MscDriver) -> Outcome:
    """DREAD while the macroprogram is stopped."""
    driver.session.rig.work("program", False)
    try:
        return _read_or_refused(driver)
    finally:
        driver.session.rig.work("program", True)


@probe(safety="rig", needs=("rig:status",))
def loading_access(driver: MscDriver) -> Outcome:
    """DREAD while a program load is in progress."""
    driver.session.rig.work("status", True, number=LOADING_BIT)
    try:
        return _read_or_refused(driver)
    finally:
        driver.session.rig.work("status", False, number=LOADING_BIT)


def _read_or_refused(driver: MscDriver) -> Outcome:
    address = next(
        (address for address in driver.scratch.variables if address % SAFE_STRIDE == 0), 0
    )
    drawn, _ = _ask(driver, codec.dread(address))
    return {MscReplyKind.REPLY: 0, MscReplyKind.NAK: 1}.get(drawn, drawn.value)
