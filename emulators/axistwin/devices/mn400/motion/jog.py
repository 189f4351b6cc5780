"""Taps of the jog buttons: whole steps out of fractions that add up (MN4-JOG-02 to -04)."""

from dataclasses import dataclass
from fractions import Fraction

from axistwin.devices.mn400.motion.rules import MotionRules


@dataclass(frozen=True, slots=True)
class JogTaps:
    """What taps owe one axis, in steps: exact, signed, and kept when the resolution changes."""

    owed: Fraction = Fraction()

    def tap(
        self, steps_per_inch: int, resolution: int, direction: int, rules: MotionRules
    ) -> tuple[int, "JogTaps"]:
        """(steps to make now, what is owed then) for a tap in ``direction``, +1 or -1."""
        owed = self.owed + direction * Fraction(steps_per_inch, resolution)
        if rules.tap_rounding == "nearest":
            size = (abs(owed) + Fraction(1, 2)) // 1
        else:
            size = abs(owed) // 1
        steps = size if owed > 0 else -size
        return steps, JogTaps(owed - steps)
