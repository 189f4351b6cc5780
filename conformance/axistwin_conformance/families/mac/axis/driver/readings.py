"""Which readings of the manual a device has shown, as far as known."""

from __future__ import annotations

from collections.abc import Callable

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.model.kinematics import (
    TICKS_PER_SECOND,
    Law,
    climb_and_cruise,
    ramp_increments,
)


class AxisReadings:
    """The readings of the device of one session."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def known(self, switch: str, look: Callable[[], int] | None = None) -> int:
        """The number of the reading this device follows, as far as known, asking by `look` if it
        has not shown itself yet; what fits no reading counts as the default here, and so does what
        this module's manual does not leave open."""
        run = self._session.run
        readings = run.ledger.ambiguity_of(switch).switches[switch]
        seen = run.readings.get(switch)
        if seen in readings:
            return readings.index(seen)
        if look is None or not run.ledger.asks(switch):
            return 0
        outcome = look()
        run.readings.setdefault(switch, readings[outcome])
        return outcome

    def may_be(self, switch: str, reading: str) -> bool:
        """Whether the device may follow that reading, if this module's manual leaves it open."""
        run = self._session.run
        is_asked = reading in run.ledger.ambiguity_of(switch).switches[switch]
        return is_asked and run.readings.get(switch, reading) == reading

    def is_open(self, switch: str) -> bool:
        """True if it was asked, and what the device did fits several readings."""
        run = self._session.run
        found = run.detections.get(switch)
        return found is not None and len(found.candidates) > 1 and switch not in run.readings

    def is_untold(self, switch: str) -> bool:
        """True if it was asked, or was to be, and nothing has told it."""
        run = self._session.run
        return switch in run.detections and switch not in run.readings

    def guessed(self, switch: str) -> int:
        """The same where a guess will do: see `Readings.guess`."""
        run = self._session.run
        readings = run.ledger.ambiguity_of(switch).switches[switch]
        seen = run.readings.guess(switch, readings[0])
        return readings.index(seen) if seen in readings else 0

    def law_of(self, coefficient: int, *, is_changed: bool = False) -> Law:
        """The readings that shape profiles of such a ramp, as this device has shown them; without
        a ramp only the instant counts at which steps do.  How a speed is changed under way takes
        long to find out: it is looked up only where one is (`is_changed`)."""
        seen = self._session.readings
        step = seen.get("step_phase", "either" if self.is_untold("step_phase") else "end")
        if not coefficient:
            return Law(step=step)
        return Law(
            ramp=seen.get("ramp_law", "equal_time"),
            change=seen.get("vel_change_law", "ramp_length") if is_changed else "ramp_length",
            stop=seen.get("stop_ramp_law", "climbed"),
            triangle=seen.get("triangle_law", "mirror"),
            step=step,
        )

    def climbing_s(self, period: int, coefficient: int) -> float:
        """The time from rest to full speed of `period`."""
        climb = climb_and_cruise(period, coefficient, self.law_of(coefficient))
        return climb.ticks_of(ramp_increments(coefficient)) / TICKS_PER_SECOND
