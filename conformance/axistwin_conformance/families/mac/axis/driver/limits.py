"""What an axis may be asked for: the envelope of the run, and what its plant and its line allow."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.errors import OutsideEnvelope
from axistwin_conformance.families.mac.axis.driver.client import AxisClient
from axistwin_conformance.families.mac.axis.driver.readings import AxisReadings
from axistwin_conformance.families.mac.axis.model.forecast import Segment
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS, TICKS_PER_SECOND

GENTLE_BRAKING: Final = 1_000_000  # inc/s²: a tenth of what an unloaded MAC23 does (§5.4)
SLOWEST: Final = 0xFFFF
PLAIN_EXCHANGE_NS: Final = 15_000_000  # at 38400 baud, with nothing in between
MOST_ROOM: Final = 500_000  # increments: 100 s at the speed of the checks


class AxisLimits:
    """The limits of one axis: speeds, distances, how exactly it follows."""

    def __init__(self, client: AxisClient, readings: AxisReadings) -> None:
        self._client, self._readings = client, readings
        self._session, self._target = client.session, client.target

    def may(self, safety: str) -> bool:
        """True if the running check, or probe, has declared that it does such things."""
        check = self._session.check
        return check is not None and safety in check.safety

    @property
    def fastest(self) -> int:
        """The shortest period the envelope allows; one beyond SLOWEST allows no motion at all."""
        return max(1, -(-TICKS_PER_SECOND // self._session.envelope.max_speed))

    @property
    def can_move(self) -> bool:
        """False if the slowest motion there is would be too fast for the envelope."""
        return self.fastest <= SLOWEST or not self._session.envelope.is_guarded

    def needs_speed(self, period: int) -> None:
        """Leave the check, or the probe, if that period is too fast for the envelope."""
        if self._session.envelope.is_guarded and period < self.fastest:
            speed = -(-TICKS_PER_SECOND // period)
            slow = "no motion is slow enough" if period == SLOWEST else "it is a matter of speed"
            raise OutsideEnvelope(slow, "--max-speed", speed)

    def slowed(self, period: int) -> int:
        """That period, or the shortest the envelope allows."""
        self.needs_speed(SLOWEST)
        return max(period, self.fastest)

    def slowed_alike(self, *periods: int) -> list[int]:
        """These periods, all made longer by as much as the shortest has to be; none beyond
        SLOWEST."""
        fastest = self.slowed(min(periods))
        return [min(SLOWEST, -(-period * fastest // min(periods))) for period in periods]

    def needs_room(self, increments: int, reason: str) -> None:
        """Leave the check, or the probe, if nobody may go that far from where `ready` ends."""
        self.needs_travel(-(-increments * 8 // 7), reason)  # an eighth may be used up already

    def needs_travel(self, increments: int, reason: str) -> None:
        """Leave the check, or the probe, if so many increments are too many for the envelope."""
        envelope = self._session.envelope
        if envelope.is_guarded and increments > envelope.max_travel:
            raise OutsideEnvelope(reason, "--max-travel", increments)

    @property
    def home(self) -> int | None:
        """Where the run found the axis; None while nobody has looked."""
        memory = self._session.run.memory
        if memory is not None and self._client.address in memory.neighbours:
            memory = memory.neighbours[self._client.address]
        return None if memory is None else memory.position

    def room(self) -> int:
        """Increments a check may use up in one direction: half of the envelope, and never so many
        that ways take hours and end where the counter does."""
        return min(self._session.envelope.max_travel // 2, MOST_ROOM)

    def fits(self, *targets: int) -> bool:
        """True if these counters lie in the envelope, or nobody enforces one."""
        home, envelope = self.home or 0, self._session.envelope
        inside = all(abs(target - home) <= envelope.max_travel for target in targets)
        return inside or not envelope.is_guarded

    def gentle(self, period: int, seconds: float) -> int:
        """The period, or a slower one with which the axis stays inside for so long."""
        if not self._session.envelope.is_guarded:
            return max(period, self.fastest)
        self.needs_speed(SLOWEST)
        gentle = round(seconds * TICKS_PER_SECOND / max(1, self.room())) + 1
        if gentle > SLOWEST:
            travel = 2 * (round(seconds * TICKS_PER_SECOND / (SLOWEST - 1)) + 1)
            self.needs_travel(travel, f"the slowest endless motion, for {seconds:.1f} s")
        return min(SLOWEST, max(period, self.fastest, gentle))

    def unhurried(self, period: int, slowest: int = SLOWEST) -> int:
        """The period, or one that is as much slower as exchanges take longer here than on a plain
        line: what is seen of a motion is then as sharp."""
        return min(slowest, max(period, period * self._target.uncertainty_ns // PLAIN_EXCHANGE_NS))

    def outlasting(self, steps: int, period: int, exchanges: int = 3) -> int:
        """The period, or a slower one with which so many steps outlast so many exchanges here."""
        least_ns = exchanges * self._target.uncertainty_ns
        return min(SLOWEST, max(self.slowed(period), -(-least_ns // (steps * TICK_NS))))

    def steps_outlasting(self, period: int, exchanges: int = 3) -> int:
        """So many steps of that period outlast so many exchanges here."""
        return -(-exchanges * self._target.uncertainty_ns // (period * TICK_NS))

    def way_outlasting(self, least: int, period: int, exchanges: int) -> int:
        """So many increments, or as many more as outlast so many exchanges here and are in the
        envelope."""
        return max(least, min(self.steps_outlasting(period, exchanges), self.room()))

    def segment(
        self, steps: int, period: int, *, exchanges: int = 3, moves: bool = True
    ) -> Segment:
        """A segment of so many steps at that period, or slower, and then longer, so that it
        outlasts so many exchanges here."""
        period = self.outlasting(steps, period, exchanges)
        return Segment(self.way_outlasting(steps, period, exchanges), period, moves)

    def allowance(self, period: int) -> int:
        """Increments a real axis may trail or lead its set-point by; none in virtual time, where
        the built-in twin's plant is ideal."""
        if self._target.is_virtual and self.has_ideal_plant:
            return 0
        return 2 + TICKS_PER_SECOND // max(1, period) // 200  # 5 ms of motion

    @property
    def has_ideal_plant(self) -> bool:
        """True if the axis is always where its set-point is, as far as is known."""
        return not self._readings.guessed("plant")

    @property
    def brake_increments(self) -> str:
        """How many increments the axis runs on: a number, or as its plant brakes."""
        return self._session.run.readings.guess("brake_increments", "plant")

    def braking(self, period: int) -> int:
        """Increments a real axis may need to stop without ramp; none in virtual time, where the
        built-in twin's plant is ideal (§5.7)."""
        number = self.brake_increments
        if number.isdigit():
            return int(number)
        if self._target.is_virtual and self.has_ideal_plant:
            return 0
        speed = TICKS_PER_SECOND // max(1, period)
        return 2 + speed * speed // (2 * GENTLE_BRAKING)

    @property
    def may_run_on(self) -> bool:
        """True in a probe that comes before it is known how the plant brakes, where looking costs
        nothing: in virtual time, without noise."""
        check, run = self._session.check, self._session.run
        is_asked = check is not None and not check.requirements
        return is_asked and self._target.is_lossless and not run.readings.guess("plant", "")
