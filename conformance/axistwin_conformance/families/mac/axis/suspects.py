"""Which commands may have moved an axis that ran away.

All that were sent since it was last seen where it should be; from then on, all that were sent
before it was seen to have moved again.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from axistwin_conformance.families.mac.axis.exchanges import COMMAND_NAMES

ON_BOTH_FACES: Final = frozenset(COMMAND_NAMES) - {0x08, 0x1B}
ACTING: Final = frozenset({0x0B, 0x10, 0x11, 0x13, 0x14, 0x15, 0x16, 0x17})
STEADY: Final = 2  # increments by which an axis that stands may swing


class Suspects:
    """Those of one line.  `indices`: of the commands."""

    def __init__(self) -> None:
        self.indices: set[int] = set()
        self._sent: dict[int, list[int]] = {}  # since it was last seen, by address
        self._counters: dict[int, int] = {}  # when last read, by address
        self._is_runaway = False

    def sent(self, addresses: Iterable[int], index: int) -> None:
        """A command has been sent to these axes."""
        for address in addresses:
            self._sent.setdefault(address, []).append(index)

    def foremost(self, address: int, begun_by: int) -> int:
        """Which of them is named: the one that has begun the last motion, or the last that should
        move the axis or its counter, or the last of all."""
        sent = [index for index in self._sent.get(address, []) if index in ON_BOTH_FACES]
        named = [index for index in sent if index in ACTING] or sent or [begun_by]
        return begun_by if begun_by in sent else named[-1]

    def seen(self, address: int, counter: int, *, is_doubtful: bool, is_runaway: bool) -> None:
        """The counter of an axis was read.

        `is_doubtful`: where it cannot be; `is_runaway`: an axis of the line was seen so twice.
        """
        has_moved = abs(counter - self._counters.get(address, counter)) > STEADY
        self._counters[address] = counter
        if is_runaway and (has_moved or not self._is_runaway):
            self.indices.update(self._sent.get(address, ()))
        if is_runaway or not is_doubtful:
            self._sent.pop(address, None)
        self._is_runaway = is_runaway
