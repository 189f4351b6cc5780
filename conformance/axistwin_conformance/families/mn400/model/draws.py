"""Commands drawn by grammar: mostly sound, sometimes wrong in one place.

A few bytes are a command, and any bytes are one: a drawn sequence can be recorded, cut and played
again (see `sequences`).  The first byte picks the command out of those that are allowed, the second
what is done to it, the others its parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import Final

from axistwin_conformance.families.mn400.boundaries import (
    MALFORMED,
    SPELLINGS,
    WRAPPED_NARROW,
    WRAPPED_WIDE,
    sound_values,
    typed,
)
from axistwin_conformance.families.mn400.grammar import (
    COMMANDS,
    UNASSIGNED,
    CommandRule,
    Omission,
    ParameterRule,
)

DRAW_BYTES: Final = 10  # one drawn command: which, what is wrong, and eight for its parameters
DISPLACEMENTS: Final = "A+MT"  # what is drawn of these is steps, and bounded by the envelope
# What a byte does to a sound text; most do nothing.
FAULTS: Final = ("omit", "cut", "extra", "edge", "wrap", "malformed", "unknown", "space")
SOUND_SHARE: Final = 160  # of 256 second bytes leave the text sound


def drawn(data: bytes, letters: Sequence[str], reach: int) -> str:
    """The text that these bytes stand for (`DRAW_BYTES` of them, missing ones are 0).

    `letters`: the commands that may be drawn.  `reach`: the most steps of a displacement, either
    way; a text that is wrong may name more, for no board carries it out.
    """
    data = data.ljust(DRAW_BYTES, b"\0")
    rule = COMMANDS[letters[data[0] % len(letters)]]
    letter = rule.letter.lower() if data[0] >= 128 else rule.letter
    values = _values(rule, data[2:], reach)
    if data[1] < SOUND_SHARE:
        return _shortened(letter, values, data[1])
    fault = FAULTS[data[1] % len(FAULTS)]
    return _spoilt(rule, letter, values, fault, data[2:])


def drawn_at_random(random: Random, letters: Sequence[str], reach: int) -> str:
    """A text for a source of randomness."""
    return drawn(random.randbytes(DRAW_BYTES), letters, reach)


def _values(rule: CommandRule, data: bytes, reach: int) -> tuple[int | None, ...]:
    """Parameters that are in range, from a byte each."""
    if rule.letter in "A+":
        return _circle(rule, data, reach)
    drawn_values = [
        _value(rule, one, data[index % len(data)], reach)
        for index, one in enumerate(rule.parameters)
    ]
    if rule.letter == "P" and drawn_values[0] == drawn_values[1]:
        drawn_values[1] = (drawn_values[1] or 0) % 4 + 1
    if rule.letter == "F" and None not in drawn_values[:2]:
        drawn_values[:2] = sorted(one or 0 for one in drawn_values[:2])
    if rule.letter == "T":
        drawn_values[4] = max(4 * reach, 1)
    return tuple(drawn_values)


def _value(rule: CommandRule, parameter: ParameterRule, byte: int, reach: int) -> int | None:
    """One parameter: near an end of its range or anywhere in it; a displacement is within reach."""
    if parameter.omission is not Omission.REQUIRED and byte % 8 == 7:
        return None
    low, high = parameter.low, parameter.high
    if rule.letter in DISPLACEMENTS and parameter.omission is Omission.NOTHING:
        low, high = max(low, -reach), min(high, reach)
    if rule.letter in "DX":
        choices = (-1, 1) if rule.letter == "D" else (1, 2, 4)
        return choices[byte % len(choices)]
    if rule.letter in "VFY":
        low = max(low, 2)
    near = (low, high, min(low + 1, high), max(high - 1, low))
    return near[byte % 4] if byte % 8 < 4 and byte < 64 else low + (high - low) * byte // 255


def _circle(rule: CommandRule, data: bytes, reach: int) -> tuple[int | None, ...]:
    """An arc whose radii agree: a quarter, a half, three quarters or all of a circle."""
    radius = max(1, min(reach // 2, 1 + data[0]))
    centre = ((radius, 0), (0, radius), (-radius, 0), (0, -radius))[data[1] % 4]
    x, y = centre
    end = ((2 * x, 2 * y), (x - y, y + x), (x + y, y - x), (0, 0))[data[2] % 4]
    arc = (*centre, *end, 1 if data[3] % 2 else -1)
    if rule.letter == "A":
        return arc
    return (*arc, data[4] * reach // 255 * (1 if data[5] % 2 else -1), data[6] % 3)


def _shortened(letter: str, values: tuple[int | None, ...], byte: int) -> str:
    """As typed; sometimes without the commas of what is left out at the end."""
    if byte % 2:
        while values and values[-1] is None:
            values = values[:-1]
    return typed(letter, values)


def _spoilt(
    rule: CommandRule, letter: str, values: tuple[int | None, ...], fault: str, data: bytes
) -> str:
    """A text with one fault; some of these are no fault to a lenient board."""
    texts: list[int | str | None] = [*values]
    place = data[0] % len(texts) if texts else 0
    if fault == "unknown":
        return typed(UNASSIGNED[data[0] % len(UNASSIGNED)], values)
    if fault == "extra" or not texts:
        return typed(letter, (*sound_values(rule), data[1]))
    if fault == "cut":
        return typed(letter, values[:place])
    if fault == "space":
        texts[place] = f" {texts[place] or 0}"
        return typed(letter, tuple(texts))
    parameter = rule.parameters[place]
    wrapped = WRAPPED_WIDE if parameter.is_wide else WRAPPED_NARROW
    choices: dict[str, Sequence[int | str | None]] = {
        "omit": (None,),
        "edge": (parameter.low - 1, parameter.high + 1, *(text for text, _ in SPELLINGS)),
        "wrap": wrapped,
        "malformed": MALFORMED,
    }
    texts[place] = choices[fault][data[1] % len(choices[fault])]
    return typed(letter, tuple(texts))
