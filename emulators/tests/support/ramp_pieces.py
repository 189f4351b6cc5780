"""Whole profiles as pieces, to be compared with the formulas of the ledger."""

from axistwin.motion.ramp import DEFAULT_RULES, Ramp, RampRules, joined, plan, plan_endless
from axistwin.motion.trajectory import Piece, merged


def climb_pieces(period_ticks: int, aa: int, rules: RampRules = DEFAULT_RULES) -> tuple[Piece, ...]:
    """The whole ramp from rest to full speed: the N increments of table A."""
    ramp = Ramp(period_ticks, aa, rules)
    return merged(ramp.climb(0, ramp.length))


def position_pieces(
    distance: int, period_ticks: int, aa: int, rules: RampRules = DEFAULT_RULES
) -> tuple[Piece, ...]:
    """T(i) of a move by ``distance`` (>= 0) from rest to rest (ledger §5.3)."""
    assert distance >= 0, f"distance {distance} is negative; the sign belongs to the direction"
    return joined(plan(Ramp(period_ticks, aa, rules), 0, distance))


def velocity_pieces(
    period_ticks: int, aa: int, rules: RampRules = DEFAULT_RULES
) -> tuple[Piece, ...]:
    """T(i) of an endless motion from rest (ledger §5.7)."""
    return joined(plan_endless(Ramp(period_ticks, aa, rules)))
