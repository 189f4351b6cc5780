"""One seed decides everything: named streams are derived from it, never from each other's use."""

from typing import Final

_MASK: Final = (1 << 64) - 1


def derive_seed(seed: int, name: str) -> int:
    """The seed (64 bit, unsigned) of the stream ``name`` under the run's ``seed``.

    Adding a stream does not shift the numbers another one draws.
    """
    import hashlib  # slow to load, and a lone device has nothing to derive

    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return int.from_bytes(digest[:8], "big")


class Draws:
    """Numbers drawn from the stream of ``seed``, the same ones on every machine (SplitMix64)."""

    def __init__(self, seed: int) -> None:
        self._state = seed & _MASK

    def below(self, limit: int) -> int:
        """A number from 0 up to but not including ``limit`` (>= 1, far below 2**64)."""
        self._state = (self._state + 0x9E3779B97F4A7C15) & _MASK
        mixed = self._state
        mixed = (mixed ^ mixed >> 30) * 0xBF58476D1CE4E5B9 & _MASK
        mixed = (mixed ^ mixed >> 27) * 0x94D049BB133111EB & _MASK
        return (mixed ^ mixed >> 31) % limit
