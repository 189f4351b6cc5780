"""What a run knows of the kind of device and of the one before it, beside what the wire shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Identity:
    """Who is there, as the probe found it: a line for people, named values for reports."""

    summary: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Model:
    """One model of a family; `facts` are what its checks must know of it (scalings, ranges)."""

    name: str
    title: str
    facts: Any = None


PROGRAM_EXTENT = 256  # addresses of the bench program: its counters, and its block from 128 on
PROGRAM_FLAGS = 4  # in a row


@dataclass(frozen=True, slots=True)
class ScratchArea:
    """What of a controller is the suite's to use: addresses of variables, numbers of user flags,
    and where the bench program is (its first flag, its first address); None: it is not there."""

    variables: range = range(0)
    flags: range = range(0)
    program: tuple[int, int] | None = None

    @property
    def met(self) -> frozenset[str]:
        """The needs (of `NEEDS`) that they meet."""
        has = {"variables": self.variables, "flags": self.flags, "program": self.program}
        return frozenset(name for name, ground in has.items() if ground)

    @property
    def named(self) -> dict[str, str]:
        """Each by the name of its option, as it is typed there."""
        spans = {"variables": self.variables, "flags": self.flags}
        named = {name: f"{span[0]}-{span[-1]}" for name, span in spans.items() if span}
        if self.program is not None:
            named["bench-program"] = "{}:{}".format(*self.program)
        return named

    @property
    def of_program(self) -> tuple[range, range]:
        """The variables and the flags that are the bench program's; none without it."""
        if self.program is None:
            return range(0), range(0)
        flag, address = self.program
        return range(address, address + PROGRAM_EXTENT), range(flag, flag + PROGRAM_FLAGS)


NO_SCRATCH = ScratchArea()
