"""The mutant zoo of the MAC23 on CAN: the faults of its own face, and those of the shared axis.

What a mutant is, and how one is judged, is the same as on the serial line: see `zoo`.  Faults of
the axis are planted once, there; here they are judged over the bus (`zoo_can.axis`).
"""

from zoo.mutant import Mutant

from zoo_can import identifiers, messages, procedure, silence, sync, transfers, undisturbed
from zoo_can.axis import axis_mutants

FAMILIES = (identifiers, transfers, undisturbed, messages, silence, sync, procedure)

OWN: tuple[Mutant, ...] = tuple(
    one for family in FAMILIES for one in vars(family).values() if isinstance(one, Mutant)
)
ZOO: tuple[Mutant, ...] = (*OWN, *axis_mutants())
