"""One seed decides everything: named streams are derived from it, never from each other's use."""

import hashlib


def derive_seed(seed: int, name: str) -> int:
    """The seed (64 bit, unsigned) of the stream ``name`` under the run's ``seed``.

    Adding a stream does not shift the numbers another one draws.
    """
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return int.from_bytes(digest[:8], "big")
