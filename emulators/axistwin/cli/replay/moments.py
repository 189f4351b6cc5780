"""When a message came to the device, if not when it was recorded.

A device that moves tells another position each instant.  So what it told is compared with what the
twin tells to the same message a little earlier or later: the recorded times are those of whoever
recorded.

Rules
-----
1. The twin is tried at both sides of the recorded time, near ones first, up to ``reach_ns``.
2. Once the recorded numbers lie between what it told at two instants, the instant is looked for
   between these: where a straight line between them has the number, or in the middle.
3. Replies with other words than numbers are only tried (rule 1).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import chain, pairwise
from typing import Final, NamedTuple

from axistwin.kernel.time import Nanos

ROUNDS_MAX: Final = 24
"""How often a recording is said again to find the instants."""

_NEAR: Final = (8, 1)
"""Parts of ``reach_ns`` that are tried at either side."""

_NUMBER: Final = re.compile(r"(?<![\w.])-?\d+(?![\w.])")


class Words(NamedTuple):
    """What a reply says: its words without the numbers, and the numbers."""

    frame: str
    numbers: tuple[int, ...]


def words_of(text: str) -> Words:
    """``text`` taken apart."""
    numbers = tuple(int(digits[:20]) for digits in _NUMBER.findall(text))
    return Words(_NUMBER.sub("#", text), numbers)


class _Sample(NamedTuple):
    shift_ns: Nanos
    numbers: tuple[int, ...]


@dataclass(slots=True)
class Moment:
    """The search for the instant at which the twin says what is ``wanted``.

    shift_ns: by how much later than recorded the message is sent next.
    """

    wanted: Words
    reach_ns: Nanos
    shift_ns: Nanos = 0
    _samples: list[_Sample] = field(default_factory=list)
    _untried: list[Nanos] = field(init=False)

    def __post_init__(self) -> None:
        sides = ((self.reach_ns // part, -self.reach_ns // part) for part in _NEAR)
        self._untried = list(chain.from_iterable(sides))

    def note(self, shift_ns: Nanos, told: Words) -> None:
        """What was ``told`` to the message that was sent ``shift_ns`` later than recorded."""
        is_alike = told.frame == self.wanted.frame and told.numbers != self.wanted.numbers
        if is_alike and len(told.numbers) == len(self.wanted.numbers):
            self._samples.append(_Sample(shift_ns, told.numbers))

    def go_on(self) -> bool:
        """Choose what is tried next; False: nothing is left."""
        shift_ns = self._between()
        if shift_ns is None and self._untried:
            shift_ns = self._untried.pop(0)
        self.shift_ns = shift_ns or 0
        return shift_ns is not None

    def _between(self) -> Nanos | None:
        """Rule 2; None while the numbers do not lie between those of two samples."""
        samples = sorted(set(self._samples))
        for before, after in pairwise(samples):
            span_ns = after.shift_ns - before.shift_ns
            rows = list(zip(self.wanted.numbers, before.numbers, after.numbers, strict=True))
            if span_ns < 2 or not all(min(ends) <= wanted <= max(ends) for wanted, *ends in rows):
                continue
            wanted, low, high = max(rows, key=lambda row: abs(row[2] - row[1]))
            along_ns = span_ns * (wanted - low) // (high - low or 1)
            is_stuck = not 0 < along_ns < span_ns or len(self._samples) % 3 == 0
            return before.shift_ns + (span_ns // 2 if is_stuck else along_ns)
        return None
