"""The mutant zoo: twins with one planted firmware fault each, and the judge who has to find it.

A mutant says which requirements it breaks (its *claims*).  It is killed when a check that names a
claimed requirement fails it, on that requirement.  A crash, a time-out, an inconclusive check or a
named quirk is no kill; a fault that is another admissible reading of the manual is no mutant.
"""

from zoo import (
    aftermath,
    beginnings,
    commands,
    edges,
    effects,
    faults,
    framing,
    inputs,
    interpolation,
    leftovers,
    motion,
    persistence,
    phases,
    queries,
    replies,
    stops,
    sync,
)
from zoo.mutant import Mutant

FAMILIES = (
    framing, replies, commands, queries, motion, interpolation, stops, sync, persistence, inputs,
    faults, edges, effects, aftermath, phases, leftovers, beginnings,
)  # fmt: skip

ZOO: tuple[Mutant, ...] = tuple(
    one for family in FAMILIES for one in vars(family).values() if isinstance(one, Mutant)
)


def armed_by(mutants: tuple[Mutant, ...]) -> dict[str, tuple[str, ...]]:
    """Requirement → names of the mutants that claim it, both in the order of the alphabet."""
    claims = sorted({claim for one in mutants for claim in one.claims})
    return {
        claim: tuple(sorted(one.name for one in mutants if claim in one.claims)) for claim in claims
    }
