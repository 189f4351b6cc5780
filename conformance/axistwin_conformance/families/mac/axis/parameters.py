"""The parameters an axis stores: which command sets each of them, and where a query shows it.

The one map of them: what reads, sets, saves or judges parameters takes them from here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from axistwin_conformance.families.mac.axis.exchanges import signed


def _any(value: int, imax: int) -> bool:
    return True


@dataclass(frozen=True, slots=True)
class AxisParameter:
    """One stored parameter.

    `index`: of the command that sets it.  `query`, `shift`, `bits`: the field of the answer that
    shows it.  `raised`: how far left the value stands in the command.  `is_valid`: whether a value
    may be set, given Imax (the readings "refuse" of AMB-10, -46, -60).
    """

    index: int
    name: str
    query: int
    shift: int
    bits: int
    raised: int = 0
    is_signed: bool = False
    is_valid: Callable[[int, int], bool] = _any

    @property
    def mask(self) -> int:
        """The bits of the answer that show it."""
        return (1 << self.bits) - 1 << self.shift

    def read(self, answer: int) -> int:
        """The value that an answer to its query shows, unsigned."""
        return (answer & self.mask) >> self.shift

    def shown(self, value: int) -> int:
        """The bits of the answer for a value."""
        return value << self.shift & self.mask

    def parameter(self, value: int) -> int:
        """The parameter of the command that sets a value."""
        return value << self.raised

    def taken(self, parameter: int) -> int:
        """The value that a command with this parameter sets."""
        bits = max(8, self.bits)
        value = parameter >> self.raised & (1 << bits) - 1
        return signed(value) if self.is_signed else value


PARAMETERS: Final[Mapping[int, AxisParameter]] = {
    parameter.index: parameter
    for parameter in (
        AxisParameter(0x02, "standby", 0x26, 12, 4, is_valid=lambda value, _: value in (0, 1)),
        AxisParameter(0x03, "stops", 0x26, 8, 4, is_valid=lambda value, _: value in (0, 1, 8, 9)),
        AxisParameter(0x09, "superior", 0x22, 0, 32, is_signed=True),
        AxisParameter(0x0A, "inferior", 0x23, 0, 32, is_signed=True),
        AxisParameter(0x0C, "torque", 0x26, 16, 8, is_valid=lambda value, imax: value <= imax),
        AxisParameter(0x0D, "period", 0x25, 0, 16, is_valid=lambda value, _: value > 0),
        AxisParameter(0x0E, "catch_up", 0x25, 24, 8, raised=8),
        AxisParameter(0x0F, "coefficient", 0x26, 24, 8),
        AxisParameter(0x1C, "tolerance", 0x26, 0, 8),
    )
}
PARAMETER_QUERIES: Final = (0x22, 0x23, 0x25, 0x26)
READ_ORDER: Final = (0x25, 0x26, 0x22, 0x23)  # in which they are asked for all at once
SHOWN_BY: Final[Mapping[int, tuple[AxisParameter, ...]]] = {
    query: tuple(part for part in PARAMETERS.values() if part.query == query)
    for query in PARAMETER_QUERIES
}


def values_of(answers: Mapping[int, int]) -> dict[int, int]:
    """The values that the answers to these queries show, by the index of the command."""
    return {
        index: parameter.read(answers[parameter.query])
        for index, parameter in PARAMETERS.items()
        if parameter.query in answers
    }


def settings_of(
    values: Mapping[int, int], indices: Iterable[int] = tuple(PARAMETERS)
) -> dict[int, int]:
    """The commands that set these values: index and parameter."""
    return {index: PARAMETERS[index].parameter(values[index]) for index in indices}
