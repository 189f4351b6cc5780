"""What a device was seen to make of the manual's open questions, and who looks that up.

Checks, models and guards look readings up one by one, by the name of the switch; the names are
noted, so that a run knows on which questions a check depends.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class Readings(dict[str, str]):
    """Switch → the reading seen.  Copying them all looks none up.

    `looked_up`: the switches that were asked for, known or not, since it was cleared last.
    `guessed`: those whose reading was of so little account that a guess would do.
    """

    def __init__(self, known: Mapping[str, str] | None = None) -> None:
        super().__init__(known or {})
        self.looked_up: set[str] = set()
        self.guessed: set[str] = set()

    def __getitem__(self, switch: str) -> str:
        self.looked_up.add(switch)
        return super().__getitem__(switch)

    def __contains__(self, switch: object) -> bool:
        self.looked_up.add(str(switch))
        return super().__contains__(switch)

    def guess(self, switch: str, default: str) -> str:
        """The reading seen, or that: a guess, which is looked into before a failure is believed."""
        self.guessed.add(switch)
        return super().get(switch, default)

    def get(self, switch: str, default: Any = None) -> Any:
        """The reading seen, or that."""
        self.looked_up.add(switch)
        return super().get(switch, default)
