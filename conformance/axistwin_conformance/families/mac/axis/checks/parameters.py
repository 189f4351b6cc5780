"""Parameters at rest: stored, read back, and refused outside their ranges (CMD-02 .. CMD-1C)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.base.errors import counted
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind, signed
from axistwin_conformance.families.mac.axis.model.forecast import Forecast
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS
from axistwin_conformance.families.mac.axis.probes.parameters import (
    catchup_low_byte,
    excessive_torque,
    torques_at_the_edges,
    zero_catchup,
    zero_period_0d,
)
from axistwin_conformance.families.mac.axis.probes.stops import overshoot_return
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.axis.words import NAMES

ORDER = 100  # of this module in a run; see `Family.modules`

POSITION_EDGES: Final = (0, 1, 0xFFFFFFFF, 0x12345678, 0xFFFFFC18, 0x3FFFFFFF, 0xC0000000)
BYTE_EDGES: Final = (0x00, 0x01, 0x7F, 0x80, 0xA5, 0xFF)


def reads_back(
    driver: AxisDriver,
    index: int,
    cases: Iterable[tuple[int, int]],
    mask: int,
    requirement: str | tuple[str, ...],
) -> None:
    """Judge that each parameter is accepted and that its query then shows the wanted field."""
    query = PARAMETERS[index].query
    for parameter, wanted in cases:
        driver.judge.accepted(index, parameter, requirement=requirement)
        value = driver.client.value(query)
        driver.session.expect(
            value & mask == wanted,
            requirement,
            *_field_words(index, wanted, value, mask),
        )


def _field_words(index: int, wanted: int, value: int, mask: int) -> tuple[str, str]:
    """What a query should show after a command, and what it shows: the parameter, or if that is
    right, the digits."""
    field = PARAMETERS[index]
    read = [
        signed(field.read(one)) if field.is_signed else field.read(one) for one in (wanted, value)
    ]
    if read[0] == read[1]:
        due = f"{wanted & mask:08X} in the digits {mask:08X} of the answer to {field.query:02X}h"
        return due, f"{value & mask:08X}"
    return f"{NAMES[field.name]} {read[0]}", f"{NAMES[field.name]} {read[1]}"


@check("MACS-CMD-09-01", "MACS-Q-22-01", "MACS-FRAME-05", safety="stored")
def the_superior_stop_reads_back(session: Session) -> None:
    """09h stores a signed 32-bit number, 22h reads it back as eight digits."""
    reads_back(
        driver_of(session),
        0x09,
        ((edge, edge) for edge in POSITION_EDGES),
        0xFFFFFFFF,
        ("MACS-CMD-09-01", "MACS-Q-22-01", "MACS-FRAME-05"),
    )


@check("MACS-CMD-0A-01", "MACS-Q-23-01", "MACS-FRAME-05", safety="stored")
def the_inferior_stop_reads_back(session: Session) -> None:
    """0Ah stores a signed 32-bit number, 23h reads it back, and 22h is not touched."""
    driver = driver_of(session)
    superior = driver.client.value(0x22)
    reads_back(
        driver,
        0x0A,
        ((edge, edge) for edge in POSITION_EDGES),
        0xFFFFFFFF,
        ("MACS-CMD-0A-01", "MACS-Q-23-01", "MACS-FRAME-05"),
    )
    again = driver.client.value(0x22)
    session.expect(
        again == superior,
        "MACS-CMD-0A-01",
        f"the superior software stop still {superior:08X}",
        f"{again:08X}",
    )


@check("MACS-CMD-02-01", "MACS-Q-26-01", safety="stored")
def torque_at_rest_reads_back(session: Session) -> None:
    """02h sets nominal (0) or half torque (1) at rest; nibble K of 26h tells."""
    driver = driver_of(session)
    reads_back(
        driver,
        0x02,
        ((1, 0x1000), (0, 0), (1, 0x1000), (0, 0)),
        0xF000,
        ("MACS-CMD-02-01", "MACS-Q-26-01"),
    )


@check("MACS-CMD-02-03", safety=("motion", "stored"))
def in_standby_the_axis_stays_within_one_increment(session: Session) -> None:
    """With half torque at rest the counter stays within 1 of the target; 18h ends the swinging."""
    driver = driver_of(session)
    start = driver.motion.ready()
    driver.judge.accepted(0x02, 1)
    target = start + 50
    forecast = driver.motion.go(target)
    end = forecast.end
    assert end is not None
    driver.client.wait_until(end.latest_ns + 20_000_000)
    places = set()
    for _ in range(10):
        place = driver.client.position()
        session.expect(abs(place - target) <= 1, None, f"{target} ± 1", place)
        places.add(place)
        driver.client.wait(0.01)
    swing = "it swings" if len(places) > 1 else "it does not swing: 18h has nothing to end"
    session.info(None, f"in standby {swing}")
    driver.judge.accepted(0x18)
    first, second = driver.client.position(), driver.client.position()
    session.expect(first == second, None, f"standing still at {first}", second)


@check("MACS-CMD-03-01", "MACS-Q-26-01", "MACS-CMD-07-01", safety="stored")
def the_stops_mode_reads_back(session: Session) -> None:
    """03h takes 0, 1, 8 and 9; nibble m of 26h tells; nibble K stays.  07h changes none of them."""
    driver = driver_of(session)
    driver.client.command(0x02, 0)
    reads_back(
        driver,
        0x03,
        ((d, d << 8) for d in (1, 8, 9, 0, 9, 8, 1, 0)),
        0xFF00,
        ("MACS-CMD-03-01", "MACS-Q-26-01"),
    )
    for mode in (9, 0):
        driver.judge.accepted(0x03, mode)
        before = driver.client.value(0x26)
        for value in (1, 0):
            driver.judge.accepted(0x07, value, requirement="MACS-CMD-07-01")
            after = driver.client.value(0x26)
            wanted, seen = f"26h still {before:08X} after 07h {value:02X}", f"{after:08X}"
            session.expect(after == before, "MACS-CMD-07-01", wanted, seen)


@check("MACS-CMD-0C-01", "MACS-Q-26-01", safety="stored")
def the_torque_limit_reads_back(session: Session) -> None:
    """0Ch takes 00h..Imax; byte 2 of 26h tells."""
    driver = driver_of(session)
    imax = driver.client.imax
    values = (1, imax // 2, imax - 1, 0x40)
    reads_back(
        driver,
        0x0C,
        ((value, value << 16) for value in values),
        0xFF0000,
        ("MACS-CMD-0C-01", "MACS-Q-26-01"),
    )


@check("MACS-CMD-0C-01", "MACS-CMD-0C-02", safety="stored")
def the_torque_limit_ends_at_imax(session: Session) -> None:
    """0Ch takes Imax itself, refuses more, and keeps what it had."""
    driver = driver_of(session)
    imax = driver.client.imax
    driver.judge.reading("torque_range", torques_at_the_edges(driver, imax), "MACS-CMD-0C-01")
    for value in (imax + 1, imax + 0x21, 0xFF):
        if imax < value <= 0xFF:
            driver.judge.reading(
                "torque_over", excessive_torque(driver, imax, value), "MACS-CMD-0C-02"
            )


@check("MACS-FRAME-06", safety="stored")
def digits_printed_x_have_no_effect_in_commands(session: Session) -> None:
    """Leading digits that the manual prints x are ignored: 0Ch ABCDEF40 stores 40."""
    driver = driver_of(session)
    for index, parameter in (
        (0x0C, 0xABCDEF40),
        (0x0D, 0xFFFFF777),
        (0x0F, 0xFEDCBA03),
        (0x03, 0x12345608),
        (0x03, 0xFFFFFF00),
    ):
        stored = PARAMETERS[index]
        wanted = stored.shown(stored.taken(parameter))
        kind = driver.client.command(index, parameter).kind
        field = driver.client.value(stored.query) & stored.mask
        outcome: int | str = f"{index:02X}h {parameter:08X}: {kind.value}, then {field:08X}"
        if kind is ReplyKind.ACCEPTED and field == wanted:
            outcome = 0
        elif kind is ReplyKind.REFUSED:
            outcome = 1
        driver.judge.reading("dont_care_digits", outcome, "MACS-FRAME-06")


@check("MACS-CMD-0D-01", "MACS-Q-25-01", safety="stored")
def the_period_reads_back(session: Session) -> None:
    """0Dh stores a 16-bit period; the low word of 25h tells, the catch-up byte stays."""
    driver = driver_of(session)
    driver.limits.needs_speed(SLOWEST)
    rest = driver.client.value(0x25) & 0xFFFF0000
    values = (0x0320, 0x1234, 0xFFFF, 0x0100, 0x8000)
    cases = ((value, rest | value) for value in values if value >= driver.limits.fastest)
    reads_back(driver, 0x0D, cases, 0xFFFFFFFF, ("MACS-CMD-0D-01", "MACS-Q-25-01"))


@check("MACS-CMD-0D-03", "MACS-CMD-0D-01", safety="stored")
def a_period_of_zero_is_no_period(session: Session) -> None:
    """0Dh 0000 is refused, or taken as the shortest period."""
    driver = driver_of(session)
    driver.judge.accepted(0x0D, driver.limits.slowed(0x0777), requirement="MACS-CMD-0D-01")
    driver.judge.again(zero_period_0d, "MACS-CMD-0D-03")


@check("MACS-CMD-0E-01", "MACS-Q-25-01", safety="stored")
def the_catch_up_speed_reads_back(session: Session) -> None:
    """0Eh takes its value from the third parameter byte; 25h shows it first, then 00."""
    driver = driver_of(session)
    low = driver.client.value(0x25) & 0xFFFF
    cases = ((value << 8, value << 24 | low) for value in (0x01, 0x05, 0x80, 0xFF, 0x14))
    reads_back(driver, 0x0E, cases, 0xFFFFFFFF, ("MACS-CMD-0E-01", "MACS-Q-25-01"))
    driver.judge.again(catchup_low_byte, "MACS-CMD-0E-01")
    for low_byte in (0xAA, 0xFF):  # whatever a device does with it, 25h has no place for it
        driver.client.command(0x0E, 0x0500 | low_byte)
        zero = driver.client.value(0x25) >> 16 & 0xFF
        session.expect(not zero, "MACS-Q-25-01", "rr 00 vvvv", f"{zero:02X} in place of 00")
    driver.judge.again(zero_catchup, "MACS-CMD-0E-01")


@check("MACS-CMD-0E-01", safety=MOVES, level="full")
def a_target_left_behind_is_returned_to(session: Session) -> None:
    """0Bh puts the target of a move behind the axis: it comes back at the pace of 0Eh, or in a new
    profile."""
    driver_of(session).judge.again(overshoot_return, "MACS-CMD-0E-01")


@check("MACS-CMD-0F-01", "MACS-Q-26-01", safety="stored")
def the_ramp_coefficient_reads_back(session: Session) -> None:
    """0Fh takes 00h..FFh; the first byte of 26h tells, the others stay."""
    driver = driver_of(session)
    rest = driver.client.value(0x26) & 0x00FFFFFF
    cases = ((value, value << 24 | rest) for value in BYTE_EDGES)
    reads_back(driver, 0x0F, cases, 0xFFFFFFFF, ("MACS-CMD-0F-01", "MACS-Q-26-01"))


@check("MACS-CMD-1C-01", "MACS-Q-26-01", safety="stored")
def the_tolerance_reads_back(session: Session) -> None:
    """1Ch takes 00h..FFh; the last byte of 26h tells.  An older release may not have it."""
    driver = driver_of(session)
    if driver.client.command(0x1C, 1).kind is ReplyKind.REFUSED:
        driver.judge.reading("cmd_1c_supported", 1, "MACS-CMD-1C-01")
        return
    driver.judge.reading("cmd_1c_supported", 0, "MACS-CMD-1C-01")
    rest = driver.client.value(0x26) & 0xFFFFFF00
    reads_back(
        driver,
        0x1C,
        ((value, rest | value) for value in BYTE_EDGES),
        0xFFFFFFFF,
        ("MACS-CMD-1C-01", "MACS-Q-26-01"),
    )


# For each parameter a value, and another one to which it is then set: each unlike all beside it.
UNLIKE: Final = {
    0x1C: (0x9A, 0xBC),
    0x0F: (0x56, 0x78),
    0x0E: (0x12, 0x34),
    0x0D: (0xFEDC, 0xEDCB),
    0x0C: (0x2F, 0x3E),
    0x0A: (0x89ABCDEF, 0x9ABCDEF0),
    0x09: (0x12345678, 0x23456789),
    0x03: (9, 8),
    0x02: (1, 0),
}


@check(*(f"MACS-CMD-{index:02X}-01" for index in sorted(UNLIKE)), safety="stored", level="full")
def setting_one_parameter_leaves_the_others(session: Session) -> None:
    """With every parameter unlike what it is from the factory, each is set anew: its query shows
    the new value, and the queries show the old ones of all others."""
    driver = driver_of(session)
    driver.limits.needs_speed(SLOWEST)
    wanted, left_out = dict[int, int](), set[int]()
    for number in range(2):
        for index, values in UNLIKE.items():
            value = max(values[number], driver.limits.fastest if index == 0x0D else 0)
            name, sent = f"MACS-CMD-{index:02X}-01", PARAMETERS[index].parameter(value)
            exchange = driver.client.command(index, sent)
            if index == 0x1C and exchange.kind is ReplyKind.REFUSED:
                left_out.add(index)  # an older release (MACS-AMB-09)
                continue
            driver.judge.must(ReplyKind.ACCEPTED, exchange, name)
            wanted[index] = value
            if len(wanted) + len(left_out) == len(UNLIKE):
                found = _beside(driver, *left_out)
                session.expect(found == wanted, name, *_differing(wanted, found))
    driver.client.command(0x03, 0)


@check(*(f"MACS-CMD-{index:02X}-01" for index in sorted(UNLIKE)), safety=MOVES, level="full")
def parameters_are_set_without_power(session: Session) -> None:
    """After 1Ah every parameter is set as ever: read at once, and with the power on again."""
    driver = driver_of(session)
    driver.motion.ready()
    driver.client.command(0x1A)
    wanted = driver.client.parameters()
    for index, (value, _) in UNLIKE.items():
        value = max(value, driver.limits.fastest if index == 0x0D else 0)
        name, sent = f"MACS-CMD-{index:02X}-01", PARAMETERS[index].parameter(value)
        exchange = driver.client.command(index, sent)
        if index != 0x1C or exchange.kind is not ReplyKind.REFUSED:  # see MACS-AMB-09
            driver.judge.must(ReplyKind.ACCEPTED, exchange, name)
            wanted[index] = value
    for powers in (False, True):
        if powers:
            driver.client.command(0x19)
        found = driver.client.parameters()
        for index in UNLIKE:
            due, seen = ({index: values[index]} for values in (wanted, found))
            name = f"MACS-CMD-{index:02X}-01"
            session.expect(due == seen, name, *_differing(due, seen))
    driver.client.command(0x03, 0)


@check("MACS-CMD-XX-02", "MACS-REPLY-05", safety="stored")
def values_outside_the_printed_sets_are_refused(session: Session) -> None:
    """02h, 03h and 07h refuse values that the manual does not print, and keep what they had."""
    driver = driver_of(session)
    for index, values, kept in (
        (0x02, (0x02, 0x03, 0x0D, 0x10, 0x80, 0xFF), 1),
        (0x03, (0x02, 0x03, 0x04, 0x07, 0x0A, 0x10, 0x81, 0xFF), 9),
        (0x07, (0x02, 0x03, 0x10, 0xFF), 0),
    ):
        mask = PARAMETERS[index].mask if index in PARAMETERS else 0
        had = PARAMETERS[index].shown(kept) if index in PARAMETERS else 0
        others = _beside(driver, index)
        for value in values:
            driver.client.command(index, kept)
            kind = driver.client.command(index, value).kind
            field = driver.client.value(0x26) & mask
            outcome: int | str = f"{index:02X}h {value:02X}: {kind.value}, then {field:04X}"
            if kind is ReplyKind.REFUSED:
                session.expect(field == had, "MACS-REPLY-05", f"{had:04X} as before", outcome)
                outcome = 0
            elif kind is ReplyKind.ACCEPTED:
                outcome = _lenient(driver, index, value, field)
            driver.judge.reading("param_range_policy", outcome, "MACS-CMD-XX-02")
            session.expect(True, "MACS-REPLY-05", "", "")
        after = _beside(driver, index)
        driver.client.command(index, 0)
        session.expect(after == others, "MACS-REPLY-05", *_differing(others, after))


def _beside(driver: AxisDriver, *indices: int) -> dict[int, int]:
    """All parameters but those of these commands."""
    found = driver.client.parameters()
    return {index: value for index, value in found.items() if index not in indices}


def _differing(wanted: dict[int, int], found: dict[int, int]) -> tuple[str, str]:
    """The parameters that are not as they should be: how they should, and how they are."""
    wrong = [index for index, value in wanted.items() if found[index] != value]
    due, seen = (
        ", ".join(f"{NAMES[PARAMETERS[index].name]} {values[index]:X}h" for index in wrong)
        for values in (wanted, found)
    )
    return due, seen


def _lenient(driver: AxisDriver, index: int, value: int, field: int) -> int | str:
    """Whether an accepted value outside the set was masked to, or clamped into, the set."""
    mask = {0x02: 0x01, 0x03: 0x09, 0x07: 0x01}[index]
    members = {0x02: (0, 1), 0x03: (0, 1, 8, 9), 0x07: (0, 1)}[index]
    shown = {0x02: field >> 12, 0x03: field >> 8, 0x07: None}[index]
    known = max(1, driver.readings.known("param_range_policy"))
    if shown is None:
        return known  # nothing reads 07h back
    clamped = (max(member for member in members if member <= value), members[-1])
    fitting = [1] if shown == value & mask else []
    fitting += [2] if shown in clamped else []
    if fitting:
        return known if known in fitting else fitting[0]
    return f"{index:02X}h {value:02X} accepted as {shown:X}"


@check("MACS-CMD-07-01")
def the_reference_input_can_be_enabled_and_disabled(session: Session) -> None:
    """07h takes 1 and 0.  What the input then does needs somebody to work it."""
    driver = driver_of(session)
    for parameter in (1, 0, 1, 0):
        exchange = driver.client.command(0x07, parameter)
        session.expect(
            exchange.kind is ReplyKind.ACCEPTED, "MACS-CMD-07-01", "accepted", exchange.reply
        )


@check("MACS-CMD-0B-01", safety=("motion", "stored"), level="full")
def the_counter_is_cleared_where_the_axis_stands(session: Session) -> None:
    """0Bh sets the position to 0 without moving the shaft; later targets count from there."""
    driver = driver_of(session)
    start = driver.motion.ready(0x0800)
    away = _step_off(driver, start)
    driver.judge.accepted(0x0B)
    place = driver.client.position()
    moved, cleared = driver.client.named(0x13), driver.client.named(0x0B)
    seen = Observation(
        f"after {moved} (go to position {away}), once the axis stood there, and {cleared} (position"
        f" counter reset), {REQUEST} read {counted(place, 'increment')}",
        value=str(place),
        wanted="0 increments",
        causes=(f"{moved} (", f"{cleared} ("),
    )
    session.expect(place == 0, None, 0, seen)
    is_busy = driver.status.is_busy()
    session.expect(not is_busy, None, f"not busy, at rest behind {cleared}", "busy")
    driver.judge.accepted(0x0F, 0)  # nor locked
    again = driver.client.position()
    session.expect(again == 0, None, "at rest at 0", again)
    driver.motion.finish(driver.motion.go(90))
    driver.motion.finish(driver.motion.go(0))
    _put_origin_back(driver, away)


@check("MACS-CMD-0B-02", "MACS-CMD-0B-01", "MACS-STATE-01", safety=MOVES, level="full")
def the_counter_is_cleared_in_velocity_motion(session: Session) -> None:
    """0Bh in velocity motion, or amid segments, is accepted, clears the counter, and the motion
    goes on as it was, and as locked."""
    driver = driver_of(session)
    start = driver.motion.ready(SLOWEST)
    _step_off(driver, start)
    forecast = driver.motion.turn(1, SLOWEST)
    driver.client.wait(0.3)
    exchange = driver.judge.accepted(0x0B)
    moved = forecast.bounds(exchange.taken)
    driver.client.wait(0.2)
    sample = driver.client.sample()
    lowest, highest = forecast.bounds(sample.taken)
    session.expect(
        lowest - moved[1] <= sample.position <= highest - moved[0],
        ("MACS-CMD-0B-01", "MACS-CMD-0B-02"),
        f"{lowest - moved[1]}..{highest - moved[0]} increments, counted from the place of 0Bh",
        sample.position,
    )
    judge_still_locked(driver, forecast)
    driver.judge.accepted(0x18)
    _put_origin_back(driver, moved[0])  # to one increment: nobody knows the instant of 0Bh better
    _judge_cleared_in_segments(driver)


def _judge_cleared_in_segments(driver: AxisDriver) -> None:
    """Segments that wait run to their end, counted from the place of 0Bh."""
    start = driver.motion.ready(SLOWEST)
    segment = driver.limits.segment(30, SLOWEST)
    forecast = driver.motion.feed(start, *[segment] * 3)
    exchange = driver.judge.accepted(0x0B)
    lowest, highest = forecast.bounds(exchange.taken)
    judge_still_locked(driver, forecast)
    whole = 3 * segment.steps
    driver.client.wait(0.1 + driver.motion.lasting_s(whole))
    place, ends = driver.client.position(), start + whole
    driver.session.expect(
        ends - highest <= place <= ends - lowest,
        "MACS-CMD-0B-02",
        f"{ends - highest}..{ends - lowest} at the end of three segments",
        place,
    )
    _put_origin_back(driver, ends - place)


def judge_still_locked(driver: AxisDriver, forecast: Forecast) -> None:
    """In the middle of a motion what it locks is refused, as far as this device locks it."""
    values = {0x02: 1, 0x0D: driver.motion.period, 0x0F: driver.motion.coefficient}
    for index, value in values.items():
        exchange = driver.client.command(index, value)
        driver.motion.taken_in_time(exchange, forecast.steady_until_ns, "the motion")
        if index == 0x02 or driver.readings.known("motion_lock_set") == 0:
            driver.judge.must(ReplyKind.REFUSED, exchange, "MACS-STATE-01")


def _step_off(driver: AxisDriver, start: int) -> int:
    """Stand a little beside counter 0, so that clearing shows; give the place."""
    away = start + 37
    driver.motion.finish(driver.motion.go(away))
    return away


def _put_origin_back(driver: AxisDriver, here: int) -> None:
    """Clear the counter where it was 0 before; `here`: what the place that is 0 now was then."""
    if abs(here) > driver.limits.room():
        driver.session.note(f"the counter's origin is now at {here} of the old one")
        return
    driver.motion.finish(driver.motion.go(-here))
    driver.client.command(0x0B)
