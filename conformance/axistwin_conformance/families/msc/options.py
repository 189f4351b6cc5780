"""The options of a controller: the variables, the flags and the program that the suite may use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import click

from axistwin_conformance.base.check import declare_needs
from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.core.option_types import Address, Span
from axistwin_conformance.core.settings import FamilyOption, FamilyOptions, Settings

ADDRESSES: Final = 1 << 16  # of a controller
PROGRAM_STEP: Final = 128  # addresses: where blocks begin that are apart in every reading
PROGRAM_EXTENT: Final = 256  # addresses of the bench program: its counters, its block from 128 on
PROGRAM_FLAGS: Final = 4  # in a row
NOTHING_NAMED: Final = ": {a_model} has no variables and no flags to be named"


class ProgramPlace(click.ParamType[tuple[int, int]]):
    """FLAG:ADDRESS, where the bench program begins."""

    name = "place"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """Read it; the program has four flags, and variables behind its address."""
        flag, colon, address = str(value).partition(":")
        if not colon:
            self.fail(f"{value!r} is no FLAG:ADDRESS, such as 240:6144", param, ctx)
        first, place = (Address().convert(text, param, ctx) for text in (flag, address))
        if not (0 <= first <= 252 and 0 <= place <= 0xFFFF):
            self.fail(f"{value!r} is out of range: 0-252 and 0-65535", param, ctx)
        return first, place


@dataclass(frozen=True, slots=True)
class ScratchArea(Settings):
    """What of a controller is the suite's to use: addresses of variables, numbers of user flags,
    and where the bench program is (its first flag, its first address); None: it is not there."""

    variables: range = range(0)
    flags: range = range(0)
    program: tuple[int, int] | None = None

    @property
    def met(self) -> frozenset[str]:
        """The needs that they meet."""
        has = {"variables": self.variables, "flags": self.flags, "program": self.program}
        return frozenset(name for name, area in has.items() if area)

    @property
    def withheld(self) -> Mapping[str, str]:
        """A program that nobody has named may be the one that works the machine: no rig stops or
        starts it."""
        return {"program": "program"} if self.program is None else {}

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

    def words(self, *, is_builtin: bool) -> list[str]:
        """The options that name them again; nothing for what the built-in twin has by itself."""
        if is_builtin and self == TWIN_SCRATCH:
            return []
        return [word for name, text in self.named.items() for word in (f"--{name}", text)]

    def within(self, safety: str) -> str:
        """What of the controller is used, where no axis is driven and no EEPROM written."""
        if safety == "motion":
            at = "nothing" if self.program is None else "flag {}, address {}".format(*self.program)
            return f"no axis is driven; the bench program works at {at} (--bench-program)"
        if safety == "stored":
            spans = {"variables": self.variables, "flags": self.flags}
            named = [
                f"{name} {span[0]} to {span[-1]} (--{name})" for name, span in spans.items() if span
            ]
            return f"read first and put back; {', '.join(named) or 'no variables and no flags'}"
        return ""


NO_SCRATCH: Final = ScratchArea()
TWIN_SCRATCH: Final = ScratchArea(range(1024, 5120), range(128, 192), (240, 6144))


class MscOptions(FamilyOptions):
    """What the suite may use: as named, else what the built-in twin has."""

    declared: ClassVar = (
        FamilyOption(
            "variables",
            Span(0xFFFF),
            "FIRST-LAST",
            "MSC: addresses of its data area that nothing else uses; written only with --allow"
            " stored, and restored.",
            200,
            NOTHING_NAMED,
        ),
        FamilyOption(
            "flags",
            Span(0xFF),
            "FIRST-LAST",
            "MSC: user flags that nothing else uses; set only with --allow stored, and restored.",
            210,
            NOTHING_NAMED,
        ),
        FamilyOption(
            "bench-program",
            ProgramPlace(),
            "FLAG:ADDRESS",
            "MSC: first flag and address of the bench program that runs in it.",
            220,
            NOTHING_NAMED,
        ),
    )
    needs: ClassVar = {
        "variables": "needs variables to use as it likes (--variables FIRST-LAST)",
        "flags": "needs user flags to use as it likes (--flags FIRST-LAST)",
        "program": "needs the bench program in the controller (--bench-program FLAG:ADDRESS)",
    }

    def settings(self, given: Mapping[str, Any], *, is_builtin: bool, is_twin: bool) -> ScratchArea:
        """What was named, else what the built-in twin has; raises UsageError for a bench program
        that cannot be there, or that shares what it has."""
        own = TWIN_SCRATCH if is_builtin else NO_SCRATCH
        named = {name: area for name, area in given.items() if area is not None}
        scratch = ScratchArea(
            named.get("variables", own.variables),
            named.get("flags", own.flags),
            named.get("bench_program", own.program),
        )
        if scratch.program is not None:
            _check_program(scratch, *scratch.program)
        return scratch


def _check_program(scratch: ScratchArea, flag: int, address: int) -> None:
    option = f"--bench-program {flag}:{address}"
    if address % PROGRAM_STEP:
        raise UsageError(f"{option}: its ADDRESS is a multiple of {PROGRAM_STEP}")
    variables, flags = scratch.of_program
    if variables[-1] >= ADDRESSES:
        raise UsageError(
            f"{option} has {len(variables)} addresses, the last of them {variables[-1]}: its"
            f" ADDRESS is {ADDRESSES - len(variables)} at most"
        )
    areas = {"--variables": (variables, scratch.variables), "--flags": (flags, scratch.flags)}
    for other, (own, named) in areas.items():
        if named and own.start < named.stop and named.start < own.stop:
            raise UsageError(
                f"{option} has {own[0]}-{own[-1]} to itself: {other} {named[0]}-{named[-1]} must"
                " not reach into it"
            )


OPTIONS: Final = MscOptions()
declare_needs(OPTIONS.needs)
