"""Motion that external pulses pace, and motion by taps of a jog input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor
from typing import Final

TURN: Final = 2000
"""Pulses of a spindle's encoder from one index to the next: what a rig that turns one provides."""


@dataclass(frozen=True, slots=True)
class Spindle:
    """A spindle that turns steadily.

    rate: pulses per second; error: the share by which that may be off.  since: the first and the
    last moment (s) at which it may have begun, with no pulse before.
    """

    rate: int
    since: tuple[Fraction, Fraction]
    error: Fraction = Fraction(0)

    def pulses(self, between: tuple[Fraction, Fraction]) -> tuple[int, int]:
        """How many have come, at least and at most, at a moment between these two (s)."""
        low = floor(self.rate * (1 - self.error) * (between[0] - self.since[1])) - 1
        high = ceil(self.rate * (1 + self.error) * (between[1] - self.since[0])) + 1
        return max(0, low), max(0, high)


def threaded(displacement: int, pulses: int, total: int) -> tuple[int, int]:
    """Where an axis may be after so many of the pulses of a threading move (MN4-THR-01).

    `pulses`: those behind the offset; more than `total` have no effect (MN4-THR-04).
    """
    share = Fraction(min(max(pulses, 0), total) * abs(displacement), total)
    low, high = floor(share), ceil(share)
    return (low, high) if displacement >= 0 else (-high, -low)


def threaded_between(displacement: int, pulses: tuple[int, int], total: int) -> tuple[int, int]:
    """The same after so many pulses, at least and at most."""
    windows = [threaded(displacement, one, total) for one in pulses]
    return min(low for low, _ in windows), max(high for _, high in windows)


def pulses_of(steps: int, displacement: int, total: int) -> tuple[int, int]:
    """How many pulses a threading move of a positive displacement has had, at least and at most,
    if it has made so many steps."""
    share = Fraction(total, displacement)
    return max(0, floor((steps - 1) * share)), min(total, ceil((steps + 1) * share))


def can_be_threaded(displacements: Sequence[int], total: int) -> bool:
    """True if no axis needs more than one step per pulse (MN4-THR-05)."""
    return all(abs(one) <= total for one in displacements)


def tapped(taps: int, steps_per_unit: int, resolution: int) -> tuple[int, int]:
    """Where so many taps in one direction may have brought an axis (MN4-JOG-03): within a step of
    their exact sum, and on it where that is whole."""
    total = Fraction(taps * steps_per_unit, resolution)
    return floor(total), ceil(total)
