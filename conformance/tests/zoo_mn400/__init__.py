"""The mutant zoo of the MN400: twins with one planted firmware fault each.

What a mutant is, and how one is judged, is the same as for the MAC modules: see `zoo`.
"""

from zoo.mutant import Mutant

from zoo_mn400 import (
    boards,
    contexts,
    effects,
    frames,
    full_store,
    leftovers,
    long_paths,
    motion,
    parameters,
    rig,
    runs,
    side_effects,
    states,
    stored,
)

FAMILIES = (
    frames, parameters, states, effects, side_effects, leftovers, long_paths, motion, contexts, rig,
    stored, full_store, runs, boards,
)  # fmt: skip

ZOO: tuple[Mutant, ...] = tuple(
    one for family in FAMILIES for one in vars(family).values() if isinstance(one, Mutant)
)
"""Faults in the order of the ledger."""
