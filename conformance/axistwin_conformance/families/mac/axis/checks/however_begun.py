"""A motion is locked, told by 27h and ended by 17h and 18h whichever command began it, either way,
and goes on whatever is free meanwhile (STATE-01, BUSY-01, CMD-17, CMD-18)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.checks.acceptance import (
    LONG_STEPS,
    judge_locked,
    slowly,
)
from axistwin_conformance.families.mac.axis.checks.velocity import judge_follows
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import Forecast
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS
from axistwin_conformance.families.mac.axis.probes.sync import back
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 112  # of this module in a run; see `Family.modules`

EXCHANGES: Final = 10  # in a motion, until it is stopped
STANDS_S: Final = 0.05
FREE_EXCHANGES: Final = 20  # in a motion, while what is free is tried
STOP_NAMES: Final = {0x17: "MACS-CMD-17-01", 0x18: "MACS-CMD-18-01"}


@dataclass(frozen=True, slots=True)
class Beginning:
    """The commands that begin a motion, the way it goes, and the stop that then ends it."""

    commands: tuple[int, ...]
    direction: int
    stop: int

    @property
    def words(self) -> str:
        """The motion in words."""
        way = "upwards" if self.direction > 0 else "downwards"
        return f"{' '.join(f'{index:02X}h' for index in self.commands)} {way}"


# Each kind of motion both ways, and both stops for each that 17h ends; some from an unpowered axis.
BEGINNINGS: Final = (
    Beginning((0x13,), 1, 0x17),
    Beginning((0x13,), -1, 0x18),
    Beginning((0x1A, 0x14), 1, 0x17),
    Beginning((0x14,), -1, 0x18),
    Beginning((0x10, 0x13, 0x11), 1, 0x18),
    Beginning((0x10, 0x13, 0x11), -1, 0x17),
    Beginning((0x10, 0x14, 0x11), 1, 0x17),
    Beginning((0x10, 0x14, 0x11), -1, 0x18),
    Beginning((0x10, 0x15, 0x11), 1, 0x17),
    Beginning((0x1A, 0x10, 0x15, 0x11), -1, 0x18),
    Beginning((0x15, 0x15), 1, 0x18),
    Beginning((0x15, 0x15), -1, 0x17),
    Beginning((0x16,), 1, 0x18),
    Beginning((0x1A, 0x16), -1, 0x18),
    Beginning((0x1A, 0x1E), 1, 0x18),
    Beginning((0x1E,), -1, 0x18),
)
NAMES: Final = ("MACS-STATE-01", "MACS-BUSY-01", *STOP_NAMES.values())


@check(*NAMES, safety=MOVES, level="full")
def a_motion_is_one_however_it_began(session: Session) -> None:
    """Begun by 13h, 14h, 15h, 16h, 1Eh or 11h, either way, powered or not: what any motion locks is
    refused, 27h shows a move busy and nothing else, and 17h or 18h ends it for good."""
    driver = driver_of(session)
    _needs_time(driver, EXCHANGES)
    for beginning in BEGINNINGS:
        _judge_begun(driver, beginning)


def _needs_time(driver: AxisDriver, exchanges: int) -> None:
    """Leave the check where no motion inside the envelope outlasts so many exchanges."""
    steps = driver.limits.steps_outlasting(slowly(driver), exchanges)
    driver.limits.needs_room(steps, f"a motion that outlasts {exchanges} exchanges on this line")


def _judge_begun(driver: AxisDriver, beginning: Beginning) -> None:
    """Begin one of these motions, and judge lock, busy and stop."""
    session, period, sign = driver.session, slowly(driver), beginning.direction
    way = driver.limits.way_outlasting(LONG_STEPS, period, EXCHANGES)
    if 0x14 in beginning.commands:
        place = driver.motion.ready()
        if abs(place) > driver.limits.room() or not driver.limits.fits(-sign * way):
            return
        driver.motion.finish(driver.motion.go(-sign * way))
        driver.motion.set_plain(period)
    else:
        driver.motion.ready(period)
    start = driver.client.position()
    target = {0x13: start + sign * way, 0x14: 0}
    steps = segment_parameter(sign * way if sign > 0 else back(driver, way), period)
    turns = iter((velocity(sign, period), velocity(sign, period // 2 + SLOWEST // 2)))
    sent_ns, ends = 0, list[int]()
    for index in beginning.commands:
        parameter = steps if index in (0x16, 0x1E) else target.get(index, 0)
        exchange = driver.judge.accepted(index, next(turns) if index == 0x15 else parameter)
        sent_ns = exchange.taken.earliest_ns
        ends += [target[index]] if index in target else []
    over_ns = sent_ns + way * period * TICK_NS
    for index, parameter in ((0x02, 1), (0x13, start)):
        judge_locked(driver, over_ns, index, parameter)
    _judge_told(driver, beginning, ends)
    name = STOP_NAMES[beginning.stop]
    stop = driver.judge.accepted(beginning.stop, requirement=name)
    driver.motion.taken_in_time(stop, over_ns, "the motion")
    driver.motion.run_out()
    driver.client.wait(STANDS_S)
    place = driver.client.position()
    driver.client.wait(STANDS_S)
    again = driver.client.position()
    words = f"at rest at {place}: {beginning.stop:02X}h has ended {beginning.words}"
    session.expect(again == place, name, words, again)


def _judge_told(driver: AxisDriver, beginning: Beginning, ends: list[int]) -> None:
    """Busy is what is on its way to a target that it is far from, and nothing else."""
    if not ends:
        judge_follows(driver, beginning.words, "MACS-BUSY-01")
        return
    is_busy, place = driver.status.is_busy(), driver.client.position()
    left = abs(ends[-1] - place)
    if left > 1 + driver.limits.allowance(driver.motion.period):
        wanted = f"busy, {left} increments to go, by {beginning.words}"
        driver.session.expect(is_busy, "MACS-BUSY-01", wanted, "not busy")


# What is free in motion, with another value than it has where it is a parameter that may be; what
# arms comes last.
FREE: Final = (0x07, 0x0C, 0x0E, 0x1C, 0x19, 0x11, 0x10)
FREE_NAMES: Final = {
    0x07: "MACS-CMD-07-01",
    0x0C: "MACS-STATE-01",  # that the motor then pulls harder is another matter (MACS-CMD-0C-03)
    0x0E: "MACS-CMD-0E-02",
    0x1C: "MACS-CMD-1C-01",
    0x19: "MACS-CMD-19-01",
    0x11: "MACS-CMD-11-02",
    0x10: "MACS-CMD-10-01",
}


@check(*dict.fromkeys(FREE_NAMES.values()), safety=MOVES, level="full")
def what_is_free_in_motion_disturbs_none(session: Session) -> None:
    """07h, 0Ch, 0Eh, 10h, 11h, 19h and 1Ch amid a move, a turn and segments: the values are taken,
    and the motion goes on as it was, as locked as it was, and ends where it was to."""
    driver = driver_of(session)
    _needs_time(driver, FREE_EXCHANGES)
    for kind in (0x13, 0x15, 0x16):
        start = driver.motion.ready(slowly(driver))
        own = driver.client.parameters()
        forecast = _begun(driver, kind, start)
        values = {0x0C: own[0x0C] - 1 if own[0x0C] > 1 else 2, 0x0E: own[0x0E] ^ 1, 0x1C: 0xFF}
        for index in FREE:
            parameter = PARAMETERS[index].parameter(values[index]) if index in values else 0
            is_taken = driver.client.command(index, parameter).kind is ReplyKind.ACCEPTED
            if not is_taken:
                values.pop(index, None)
            _judge_undisturbed(driver, forecast, index)
        found = driver.client.parameters()
        for index, value in values.items():
            wanted, seen = f"{driver.client.named(index)} {value:X}h taken", f"{found[index]:X}h"
            session.expect(found[index] == value, FREE_NAMES[index], wanted, seen)
        if forecast.end is not None:
            driver.motion.finish(forecast, tuple(FREE_NAMES.values()))
        driver.motion.disarm()
        for index in values:
            driver.client.command(index, PARAMETERS[index].parameter(own[index]))


def _begun(driver: AxisDriver, kind: int, start: int) -> Forecast:
    """Begin a motion of that kind that outlasts what is then sent; what to expect of it."""
    period = driver.motion.period
    if kind == 0x15:
        return driver.motion.turn(-1, period)
    if kind == 0x13:
        way = driver.limits.way_outlasting(60, period, FREE_EXCHANGES)
        return driver.motion.go(start - way)
    segment = driver.limits.segment(30, period, exchanges=FREE_EXCHANGES // 2)
    return driver.motion.feed(start, segment, segment, segment)


def _judge_undisturbed(driver: AxisDriver, forecast: Forecast, index: int) -> None:
    """Judge that the motion is locked, and where it was to be by then."""
    judge_locked(driver, forecast.steady_until_ns, 0x02, 1)
    allowance = driver.limits.allowance(driver.motion.period)
    driver.motion.follow(forecast, FREE_NAMES[index], allowance)
