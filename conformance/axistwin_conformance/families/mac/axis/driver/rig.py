"""What the checks do that work inputs, supply and shaft beside the line.

A rig's act happens somewhere in a window (`TimeWindow`), of no width for the twin's, of seconds for
a person's.  Motions under which something is worked are slow and have an end of their own, so that
nobody at the rig can be too late for the envelope; endless ones are left to an exact rig.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

from axistwin_conformance.families.mac.axis.driver.client import QUIET_S, AxisClient, Part
from axistwin_conformance.families.mac.axis.driver.judge import AxisJudge
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST, AxisLimits
from axistwin_conformance.families.mac.axis.driver.motion import (
    AxisMotion,
    segment_parameter,
    velocity,
)
from axistwin_conformance.families.mac.axis.driver.readings import AxisReadings
from axistwin_conformance.families.mac.axis.driver.status import AxisStatus
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind, signed
from axistwin_conformance.families.mac.axis.model.forecast import Forecast, Segment, TimeWindow
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS, TICKS_PER_SECOND

WORKED: Final = ("motion", "stored", "rig")  # the safety of a check that moves and works a rig
EXACT_REACH: Final = 300  # increments
EXACT_PERIOD: Final = 0x2000  # 1.024 ms per increment: a step is longer than a reply is late
OVER_VOLTAGE, UNDER_VOLTAGE = 0x40, 0x20  # the warnings in dd
HARD_POSITIVE, HARD_NEGATIVE = 0x08, 0x04  # bits of ff
SOFTWARE_STOPS: Final = 0x08  # bit of 03h
OFF_S: Final = 1.0
AT_ONCE: Final = "needs a rig that acts at once"
# How to learn which way a command counts down, where the run has not: its switch, index and
# parameter for a few increments at the slowest speed.
COUNTING_DOWN: Final[Mapping[str, tuple[str, int, int]]] = {
    "15h": ("vel_f6_direction", 0x15, velocity(-1, SLOWEST)),
    "16h": ("segment_signed", 0x16, segment_parameter(-5, SLOWEST)),
}


@dataclass(frozen=True, slots=True)
class MotionCommand:
    """A command that moves the axis: how to begin it and what then to expect."""

    name: str
    begin: Callable[[AxisRig, int, int], Forecast]
    is_endless: bool = False


class AxisRig:
    """One module and the rig around it."""

    def __init__(
        self,
        client: AxisClient,
        judge: AxisJudge,
        readings: AxisReadings,
        limits: AxisLimits,
        status: AxisStatus,
        motion: AxisMotion,
    ) -> None:
        self._client, self._limits, self._status = client, limits, status
        self.judge, self.readings, self.motion = judge, readings, motion
        self._session = client.session
        self.start = 0

    @property
    def slow_period(self) -> int:
        """The period of motions under which the rig does something: they last long enough."""
        if not self._session.rig.is_exact:
            return SLOWEST
        period = max(EXACT_PERIOD, EXACT_PERIOD * EXACT_REACH // max(1, self.reach))
        return self._limits.unhurried(min(SLOWEST, period))

    def lasting(self, increments: int, seconds: float) -> int:
        """The pace, or a slower one with which so many increments take so long."""
        if not self._session.rig.is_exact:
            return self.slow_period
        period = round(seconds * TICKS_PER_SECOND / max(1, increments))
        if period > SLOWEST:
            room = round(seconds * TICKS_PER_SECOND / SLOWEST) + 1
            self._limits.needs_travel(2 * room, f"a motion that takes {seconds:.1f} s")
        return max(self.slow_period, min(period, SLOWEST))

    @property
    def reach(self) -> int:
        """How far such a motion leads."""
        return (
            min(EXACT_REACH, self._limits.room())
            if self._session.rig.is_exact
            else self._limits.room()
        )

    @property
    def motion_commands(self) -> tuple[MotionCommand, ...]:
        """The commands to move by; without end only where the rig acts at once."""
        return tuple(
            command
            for command in MOTION_COMMANDS
            if self._session.rig.is_exact or not command.is_endless
        )

    def can_go(self, command: MotionCommand, direction: int) -> bool:
        """False where the device's readings of AMB-07 and -38 leave no way to count down."""
        counting = COUNTING_DOWN.get(command.name)
        if direction > 0 or counting is None:
            return True
        switch, index, parameter = counting
        return self.readings.known(switch, lambda: self._goes_up(index, parameter)) != 1

    def _goes_up(self, index: int, parameter: int) -> int:
        """Whether the command, meant to count down, counts up: 0 or 1."""
        client = self._client
        start = client.position()
        client.command(index, parameter)
        client.wait(10 * SLOWEST * TICK_NS / 1e9)
        client.command(0x18)
        return int(client.position() > start)

    def begin(self, period: int | None = None, coefficient: int = 0) -> int:
        """Bring everything to rest; give the place.  No stop bits, no reference."""
        if self.readings.known("ff_lifetime") == 2:  # only a restart clears ff on this device
            self.restart()
        self.start = self.motion.ready(self.slow_period if period is None else period, coefficient)
        return self.start

    def enable_stops(self, mode: int) -> None:
        """Send 03h; the software stops it enables are put where no motion from `start` comes,
        wherever a device has them (MACS-AMB-25)."""
        reach = max(self.reach, self._limits.room()) + self._limits.braking(self.motion.period)
        for index, direction in ((0x09, 1), (0x0A, -1)) if mode & SOFTWARE_STOPS else ():
            place = signed(self._client.parameter(index))
            if (place - self.start) * direction <= reach:
                self.judge.accepted(index, self.start + 2 * direction * reach)
        self.judge.accepted(0x03, mode)

    def has_tolerance(self) -> bool:
        """Whether this device knows 1Ch (MACS-AMB-09); asked with what is set already."""
        return not self.readings.known("cmd_1c_supported", self._refuses_tolerance)

    def _refuses_tolerance(self) -> int:
        kind = self._client.command(0x1C, self._client.parameter(0x1C)).kind
        return int(kind is ReplyKind.REFUSED)

    def restart(self) -> None:
        """00h, and wait until it surely listens again (MACS-CMD-00-02)."""
        self.motion.at_rest()
        self._client.command(0x00)
        self.motion.wait_awake()

    def awake(self, requirement: Part = None) -> None:
        """Wait for the end of the deafness, then judge that it answers."""
        self.motion.wait_awake()
        self.judge.alive(requirement)

    @property
    def away_s(self) -> float:
        """How long a power cycle takes, until the module surely answers again."""
        return OFF_S + self.motion.awake_surely_s + QUIET_S

    def power_cycle(self, requirement: Part = None) -> TimeWindow:
        """Cut the supply and apply it again; judge the silence between.  Give when it was cut."""
        cut = TimeWindow(*self._session.rig.work("power", False))
        self.judge.must(ReplyKind.SILENCE, self._client.within(QUIET_S, 0x20), requirement)
        self._client.wait(OFF_S)
        self._session.rig.work("power", True)
        self.awake(requirement)
        return cut

    # --- what the answers say --------------------------------------------------------------------

    def contact(self, name: str, active: bool) -> TimeWindow:
        """Work a contact, and see in 27h that it was: otherwise nothing follows from what happens,
        and least of all from nothing happening."""
        act = self.worked(name, active)
        if self._status.inputs()[name] is not active:
            state = "closed" if active else "open"
            self._session.inconclusive(
                None, f"the {name} contact should be {state}, but 27h shows it otherwise"
            )
        return act

    def worked(self, name: str, active: bool) -> TimeWindow:
        """Work a contact; where the envelope counts, the counter is read before and after: an edge
        may clear it, and how far the axis may have come meanwhile is lost to the envelope."""
        if not self._session.envelope.is_guarded:
            return TimeWindow(*self._session.rig.work(name, active))
        self._client.ask(0x20)
        act = TimeWindow(*self._session.rig.work(name, active))
        self._client.ask(0x20)
        return act

    def judge_stop_bit(self, bit: int, requirement: Part) -> None:
        """ff shows that stop alone, where the CAN manual has it or shifted by one (AMB-12)."""
        ff = self._status.stopped_on()
        outcome: int | str = {bit: 0, bit << 1: 1}.get(ff, f"ff {ff:02X} instead of {bit:02X}")
        if ff == 0 and self.readings.known("ff_lifetime") == 1:
            return  # on this device the bit lives only as long as the stop acts
        self.judge.reading("status_ff_layout", outcome, requirement)

    # --- judging ---------------------------------------------------------------------------------

    def rest(self) -> int:
        """The place of an axis that has stopped, seen twice to be the same."""
        self.motion.run_out()
        self._client.wait(0.1)
        place = self._client.position()
        self._client.wait(0.2)
        again = self._client.position()
        self._session.step(again == place, f"at rest at {place}", f"then at {again}")
        return place

    def judge_place(
        self, place: int, cut: Forecast, direction: int, requirement: Part, coasts: bool = False
    ) -> None:
        """The axis has ended where a motion cut short in a window may end.

        `coasts`: nothing brakes it and nobody says how far it rolls, but its target it must miss.
        """
        lowest, highest = cut.final
        beyond = 1 + self._limits.braking(self.motion.period)
        if coasts:
            beyond = max(beyond, abs(self.start + direction * self.reach - highest) - 1)
        if direction > 0:
            highest += beyond
        else:
            lowest -= beyond
        self._session.expect(
            lowest <= place <= highest, requirement, f"at rest in {lowest}..{highest}", place
        )

    def in_time(self, forecast: Forecast, act: TimeWindow) -> None:
        """Give up if the motion was over before the rig had done its part."""
        end = forecast.end
        if end is not None and act.latest_ns >= end.earliest_ns:
            if (
                self._session.rig.is_exact
            ):  # with the same distance in proportion it would have been
                start_ns = min(timeline.start_ns for timeline in forecast.timelines)
                lasts_ns, here = end.earliest_ns - start_ns, self._session.envelope.max_travel
                # One without a single step tells nothing: twice the room, to be asked again.
                share = (act.latest_ns - start_ns) / lasts_ns if lasts_ns else 2.0
                travel = round(here * share) + 1
                self._limits.needs_travel(travel, "the motion was over before the rig had acted")
            self._session.inconclusive(
                None, "the motion was over before the rig had acted: allow it a longer --max-travel"
            )

    @contextmanager
    def reference_enabled(self, enabled: int = 1) -> Iterator[None]:
        """07h 1, and 07h 0 whatever happens: no answer tells that it is enabled."""
        self.judge.accepted(0x07, enabled)
        try:
            yield
        except BaseException:
            self._client.command(0x18)  # first of all
            raise
        finally:
            self._client.command(0x07, 0)

    @contextmanager
    def own_origin(self) -> Iterator[Origin]:
        """Count from 0 here; afterwards drive to the counter's old zero and clear it there."""
        if abs(self.start) > self._limits.room() // 2:
            self._session.skip("the counter's origin could not be put back: it is too far away")
        origin = Origin(-self.start)
        self.judge.accepted(0x0B)
        yield origin
        self.motion.at_rest()
        self._client.wait(0.05)
        home = origin.old_zero - origin.shift
        end = self.motion.go_plainly(home).end
        assert end is not None
        self._client.wait_until(end.latest_ns)
        self._client.wait(0.2)
        self._client.command(0x18)
        self._client.command(0x0B)


@dataclass(slots=True)
class Origin:
    """Where the counter's zero was before the check, and how far zeroing has shifted it since, give
    or take `doubt`."""

    old_zero: int
    shift: int = 0
    doubt: int = 2


def _move(rig: AxisRig, start: int, distance: int) -> Forecast:
    exchange = rig.judge.accepted(0x13, start + distance)
    return rig.motion.to_position(exchange, start, start + distance)


def _turn(rig: AxisRig, start: int, distance: int) -> Forecast:
    direction, motion = (1 if distance > 0 else -1), rig.motion
    exchange = rig.judge.accepted(0x15, velocity(direction, motion.period))
    return motion.to_velocity(exchange, start, direction, motion.period)


def _interpolate(rig: AxisRig, start: int, distance: int) -> Forecast:
    """Two segments; only one where stops do not drop the second (MACS-AMB-51)."""
    count = 1 if rig.readings.known("abort_flush") else 2
    steps = distance // count
    return rig.motion.feed(start, *[Segment(steps, rig.motion.period)] * count)


MOTION_COMMANDS: Final = (
    MotionCommand("13h", _move),
    MotionCommand("16h", _interpolate),
    MotionCommand("15h", _turn, is_endless=True),
)
