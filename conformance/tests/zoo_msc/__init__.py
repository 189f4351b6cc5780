"""The mutant zoo of the MSC controllers: twins with one planted firmware fault each.

What a mutant is, and how one is judged, is the same as for the MAC modules: see `zoo`.
"""

from zoo.mutant import Mutant

from zoo_msc import (
    commands,
    contents,
    data,
    flags,
    forms,
    host_repeats,
    leftovers,
    line,
    link,
    packets,
    succession,
)

FAMILIES = (
    line, packets, link, host_repeats, commands, data, flags, forms, contents, leftovers,
    succession,
)  # fmt: skip

ZOO: tuple[Mutant, ...] = tuple(
    one for family in FAMILIES for one in vars(family).values() if isinstance(one, Mutant)
)
