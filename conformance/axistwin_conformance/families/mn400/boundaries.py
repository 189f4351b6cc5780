"""Texts at the edges of every command: what must be accepted just inside, and refused just outside.

The table is made from the rules of the commands, so that a parameter cannot be forgotten; what a
board of some reading must make of each text is `grammar.read_command`.  Beside the edges of ranges
there are those of arithmetic: values that a cast to 16 or 32 bits would let pass.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from axistwin_conformance.families.mn400.grammar import (
    COMMANDS,
    NARROW,
    WIDE,
    CommandRule,
    Omission,
    ParameterRule,
    rule_of,
)

# What 16 or 32 bits make a harmless number of, and what no number of bits holds.
WRAPPED_NARROW: Final = (
    NARROW + 1,
    -NARROW - 1,
    -NARROW - 2,
    1 << 16,
    (1 << 16) + 1,
    -(1 << 16) + 1,
)
WRAPPED_WIDE: Final = (
    3_000_000_000, 1 << 32, (1 << 32) + 1, -(1 << 32) + 1, 1 << 63, (1 << 64) + 1, 10**20 - 1,
)  # fmt: skip
# Parameters that are no decimal integers (MN4-PAR-02, MN4-PAR-03).
MALFORMED: Final = (
    "-", "--1", "1-2", "1-", "+1", "1.0", "1.", ".5", "1e3", "0x1", "1a", "a", " 1", "1 ", "1;",
    "1:", "\x7f",
)  # fmt: skip
# The same with control characters.  On a shared line a board may take such a frame for what another
# one has said (MN4-DROP-10): they are for a board that is alone.
CONTROLS: Final = ("\x001", "1\x0d", "\x04", "1\x1f2", "1\x00")
# Spellings of whole numbers that are accepted (MN4-PAR-08): the text, what it says.  None of these
# digits says in base 8 what it says in base 10.
SPELLINGS: Final = (("0", 0), ("-0", 0), ("000", 0), ("010", 10), ("-0017", -17), ("-00", 0))


def sound_values(rule: CommandRule) -> tuple[int, ...]:
    """Parameters that are in range, each and together; of motion as little as can be."""
    return _SOUND.get(rule.letter) or tuple(_inside(one) for one in rule.parameters)


_SOUND: Final = {
    "A": (-2, 0, -4, 0, 1), "+": (-2, 0, -4, 0, 1, 0, 0), "T": (0, 0, 0, 0, 1, 0),
    "P": (1, 3, 2), "D": (1, 1, 1, 1), "F": (1000, 5000, 10_000), "V": (2000,),
}  # fmt: skip


def _inside(parameter: ParameterRule) -> int:
    return 0 if parameter.low <= 0 <= parameter.high else parameter.low


def typed(letter: str, values: tuple[int | str | None, ...]) -> str:
    """A command as it is typed: None for a parameter that is left out."""
    return letter + ",".join("" if value is None else str(value) for value in values)


def edges(letter: str) -> tuple[str, ...]:
    """All texts of one command: ranges, widths, omissions, spellings, and what is malformed."""
    rule = rule_of(letter)
    assert rule is not None, "one of COMMANDS"
    found = [rule.letter, rule.letter.lower(), *_counts(rule)]
    for index, parameter in enumerate(rule.parameters):
        found += [typed(rule.letter, row) for row in _rows(rule, index, parameter)]
    return tuple(dict.fromkeys(found))


def _counts(rule: CommandRule) -> Iterator[str]:
    """Too many parameters and too few, and commas behind the last one."""
    values = sound_values(rule)
    for count in range(1, len(values) + 1):
        yield typed(rule.letter, values[:count])
        yield typed(rule.letter, (*values[:count], None))
    yield typed(rule.letter, (*values, 0))
    yield typed(rule.letter, (None,) * (len(values) + 2))
    yield f"{rule.letter}{','.join(['0'] * 40)}"


def _rows(
    rule: CommandRule, index: int, parameter: ParameterRule
) -> Iterator[tuple[int | str | None, ...]]:
    """One parameter at all its edges, the others as they should be."""
    sound = sound_values(rule)
    wrapped = WRAPPED_WIDE if parameter.is_wide else WRAPPED_NARROW
    ends = (parameter.low - 1, parameter.low, parameter.high, parameter.high + 1)
    between = range(parameter.low, min(parameter.high, parameter.low + 5) + 1)
    values: list[int | str | None] = [None, *ends, *between, 0, 1, -1, *wrapped, *WRAPPED_WIDE]
    values += [*MALFORMED, *(text for text, _ in SPELLINGS)]
    for value in values:
        yield (*sound[:index], value, *sound[index + 1 :])


def optional_parameters(letter: str) -> int:
    """How many parameters of a command may be left out."""
    return sum(one.omission is not Omission.REQUIRED for one in COMMANDS[letter].parameters)


# Positions that show which bounds a counter has (MN4-AMB-48): each reading refuses others.
COUNTER_BOUNDS: Final = (
    WIDE - 1, WIDE, WIDE + 1, -WIDE + 1, -WIDE, -WIDE - 1, -WIDE - 2,
    2_147_000_000, 2_147_000_001, -2_147_000_000, -2_147_000_001,
)  # fmt: skip
