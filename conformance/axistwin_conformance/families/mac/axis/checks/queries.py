"""What the queries tell (Q)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.facts import PLAUSIBLE_CELSIUS, facts_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.probes.sync import is_held

ORDER = 80  # of this module in a run; see `Family.modules`

PLAUSIBLE_VOLTS: Final = (5.0, 150.0)
# Bits of ff gg hh without a meaning in any layout of ff and hh (§5.9, MACS-AMB-12, MACS-AMB-13).
STATUS_RESERVED: Final = 0x00E0FF00
MEASURES_RESERVED: Final = 0x0000D79F  # bits of cc dd without a meaning
STOPPED_ON: Final = 0x000F0000
STATUS_READS: Final = 20
FAR: Final = 4800  # increments of a move that is polled, as far as there is room
POLLED_TICKS: Final = 20_000_000  # how long it takes: 2.5 s
SPARE_NS: Final = 150_000_000  # before its end, an exchange that begins may end after it


@check("MACS-Q-21-01", "MACS-Q-XX-03")
def the_status_of_a_sound_module_shows_no_fault(session: Session) -> None:
    """Answer 21h is dd ff gg hh; a module at rest that nothing ails has no fault or warning."""
    driver = driver_of(session)
    status, faults = driver.client.value(0x21), driver.client.face.faults << 24
    session.expect(
        not status & faults,
        "MACS-Q-21-01",
        "no fault and no warning in dd",
        f"dd {status >> 24:02X}",
    )
    reserved = STATUS_RESERVED | 0xFF000000 & ~faults
    _judge_reserved(driver, status & reserved, f"21h {status:08X}")


@check("MACS-Q-27-01", "MACS-Q-27-03", "MACS-Q-XX-03")
def measures_are_plausible_and_idle_is_not_busy(session: Session) -> None:
    """27h gives tt vv cc dd: a room's temperature, a drive's supply, and at rest cc bit 3 set."""
    driver = driver_of(session)
    value = driver.client.value(0x27)
    tt, vv, first, _ = value.to_bytes(4, "big")
    facts = facts_of(session)
    celsius, volts = facts.celsius(tt), facts.volts(vv)
    low, high = PLAUSIBLE_CELSIUS
    session.expect(
        low <= celsius <= high, "MACS-Q-27-01", f"{low:.0f}..{high:.0f} °C", f"{celsius:.1f} °C"
    )
    low, high = PLAUSIBLE_VOLTS
    session.expect(
        low <= volts <= high, "MACS-Q-27-01", f"{low:.0f}..{high:.0f} V", f"{volts:.1f} V"
    )
    session.info("MACS-Q-27-01", f"{celsius:.1f} °C, {volts:.1f} V")
    session.expect(bool(first & 0x08), "MACS-Q-27-03", "bit 3 of cc 1: not busy", f"cc {first:02X}")
    _judge_reserved(driver, value & MEASURES_RESERVED, f"27h {value:08X}")


def _judge_reserved(driver: AxisDriver, bits: int, what: str) -> None:
    """Reserved bits may hold anything (MACS-AMB-59); that they do is worth knowing."""
    driver.session.expect(True, "MACS-Q-XX-03", "any value", bits)
    if bits:
        driver.session.note(f"reserved bits set: {what}")
        held = driver.session.reading("reserved_bits")
        driver.session.quirk("MACS-Q-XX-03", "reserved_bits", "1" if held == "0" else held)


@check("MACS-Q-24-01")
def the_release_is_eight_digits_that_stay(session: Session) -> None:
    """24h identifies the release: the same eight digits every time; their format is open."""
    driver = driver_of(session)
    release = driver.client.value(0x24)
    again = driver.client.value(0x24)
    session.expect(again == release, None, f"release {release:08X} again", f"release {again:08X}")
    session.info(None, f"release {release:08X}")


@check("MACS-Q-20-01", "MACS-FRAME-05", "MACS-CMD-13-01", safety=("motion", "stored"), level="full")
def positions_are_signed_and_big_endian(session: Session) -> None:
    """Targets and positions are signed numbers, most significant first: a move ends at its absolute
    target on both sides of 0."""
    driver = driver_of(session)
    start = driver.motion.ready(0x0800)
    targets = [start - 1, start + 1, start + 300, start - 300]
    near_zero = abs(start) <= driver.limits.room()
    edges = [edge for edge in (0x8000, -0x8001, 0x10001) if abs(edge) < driver.limits.room()]
    targets += [-1, 1, 0x101, -0x101, 0x80, -0x100, *edges, 0] if near_zero else []
    for target in targets:
        driver.motion.finish(
            driver.motion.go(target), ("MACS-CMD-13-01", "MACS-Q-20-01", "MACS-FRAME-05")
        )


@check("MACS-Q-XX-01", "MACS-CMD-13-01", safety=("motion", "stored"), level="full")
def queries_disturb_nothing(session: Session) -> None:
    """Every query is answered at full rate during a move, which stays locked, and is on time though
    the counter is read all the while, and exact."""
    driver = driver_of(session)
    distance = min(FAR, driver.limits.room())
    start = driver.motion.ready(min(SLOWEST, POLLED_TICKS // distance))
    names = ("MACS-Q-XX-01", "MACS-CMD-13-01")
    forecast = driver.motion.go(start + distance)
    end = forecast.end
    assert end is not None
    for index in driver.client.face.answered:
        sent_ns = session.transport.now_ns
        driver.judge.must(ReplyKind.ANSWER, driver.client.ask(index), "MACS-Q-XX-01")
        answered_ns = session.transport.now_ns
        if answered_ns + (answered_ns - sent_ns) >= end.earliest_ns - SPARE_NS:
            continue  # so slow a device may take the next command behind the move
        locked = driver.client.command(0x13, start)
        if locked.taken.latest_ns >= end.earliest_ns - SPARE_NS:
            return  # it may have been right to take it, and move back
        driver.judge.must(ReplyKind.REFUSED, locked, "MACS-Q-XX-01")
    allowance = driver.limits.allowance(driver.motion.period)
    while session.transport.now_ns < end.earliest_ns - SPARE_NS:
        driver.motion.follow(forecast, names, allowance)
    driver.motion.finish(forecast, names)


@check("MACS-Q-XX-01", safety=("motion", "stored"), level="full")
def queries_are_answered_in_every_motion(session: Session) -> None:
    """Queries are answered at rest, armed, preloaded, in velocity and in interpolated motion."""
    driver = driver_of(session)
    start = driver.motion.ready(SLOWEST)
    preparations = (
        ((0x10, 0),),
        ((0x10, 0), (0x13, start + 40)),
        ((0x15, SLOWEST),),
        ((0x16, 0x0028FFFF),),
        ((0x1E, 0x0028FFFF),),
        ((0x1A, 0),),
    )
    for commands in preparations:
        for index, parameter in commands:
            driver.judge.accepted(index, parameter, requirement="MACS-Q-XX-01")
        for index in driver.client.face.answered:
            driver.judge.must(ReplyKind.ANSWER, driver.client.ask(index))
        if commands == ((0x10, 0),):
            place = driver.client.position()
            driver.judge.accepted(0x13, place + 40)
            session.expect(
                is_held(driver, place), None, f"rest at {place} until 11h", driver.client.position()
            )
        driver.motion.at_rest()


@check("MACS-Q-22-01", "MACS-Q-23-01", "MACS-Q-25-01", "MACS-Q-26-01")
def parameter_queries_are_steady(session: Session) -> None:
    """22h, 23h, 25h and 26h read the same again, and the zero byte of 25h is zero."""
    driver = driver_of(session)
    names = {0x22: "MACS-Q-22-01", 0x23: "MACS-Q-23-01", 0x25: "MACS-Q-25-01", 0x26: "MACS-Q-26-01"}
    for index, name in names.items():
        value, again = driver.client.value(index), driver.client.value(index)
        session.expect(again == value, name, f"{value:08X} again", f"{again:08X}")
    speeds = driver.client.value(0x25)
    session.expect(not speeds & 0x00FF0000, "MACS-Q-25-01", "rr 00 vvvv", f"{speeds:08X}")
    modes = driver.client.value(0x26) >> 8 & 0xFF
    session.expect(
        modes >> 4 in (0, 1) and modes & 0xF in (0, 1, 8, 9),
        "MACS-Q-26-01",
        "torque at rest (K) 0 or 1, stops mode (m) 0, 1, 8 or 9",
        f"K {modes >> 4:X}, m {modes & 0xF:X}",
    )


@check("MACS-Q-21-01")
def the_status_is_steady(session: Session) -> None:
    """Reading 21h clears nothing: faults and stops stay until a reset or the next motion."""
    driver = driver_of(session)
    known = driver.client.face.faults << 24 | STOPPED_ON
    first = driver.client.value(0x21) & known
    for _ in range(STATUS_READS if session.transport.is_virtual else 3):
        again = driver.client.value(0x21) & known
        session.expect(again == first, "MACS-Q-21-01", f"{first:08X}", f"{again:08X}")
