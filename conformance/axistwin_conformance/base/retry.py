"""How often something is tried again before it is given up: the one place for these numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """How often to try; a family that needs other numbers replaces them.

    `exchange`: one exchange on a noisy line.  With one byte in 50 lost, an exchange of 42 bytes
    fails as often as not: 24 attempts leave 1 in 1 000 000 unsettled.  `presence`: to reach a
    device that always answers alike; with the reply time-out of 0.5 s that is longer than an axis
    is deaf after power-up.  `recovery`: to bring a device back to where it was found.  `sequence`:
    a list of operations that noise breaks off.  `alike`: how many results that agree are believed
    where noise may have changed any of them.
    """

    exchange: int = 24
    presence: int = 6
    recovery: int = 3
    sequence: int = 5
    alike: int = 3


RETRY: Final = RetryPolicy()
