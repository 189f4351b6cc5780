"""Motion that external pulses pace, and motion by taps of a jog input."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import ceil, floor


def threaded(displacement: int, pulses: int, total: int) -> tuple[int, int]:
    """Where an axis may be after so many of the pulses of a threading move (MN4-THR-01).

    `pulses`: those behind the offset; more than `total` have no effect (MN4-THR-04).
    """
    share = Fraction(min(max(pulses, 0), total) * abs(displacement), total)
    low, high = floor(share), ceil(share)
    return (low, high) if displacement >= 0 else (-high, -low)


def can_be_threaded(displacements: Sequence[int], total: int) -> bool:
    """True if no axis needs more than one step per pulse (MN4-THR-05)."""
    return all(abs(one) <= total for one in displacements)


def tapped(taps: int, steps_per_unit: int, resolution: int) -> tuple[int, int]:
    """Where so many taps in one direction may have brought an axis (MN4-JOG-03): within a step of
    their exact sum, and on it where that is whole."""
    total = Fraction(taps * steps_per_unit, resolution)
    return floor(total), ceil(total)
