"""One seed decides everything: named streams are derived from it, never from each other's use."""


def derive_seed(seed: int, name: str) -> int:
    """The seed (64 bit, unsigned) of the stream ``name`` under the run's ``seed``.

    Adding a stream does not shift the numbers another one draws.
    """
    import hashlib  # slow to load, and a lone device has nothing to derive

    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return int.from_bytes(digest[:8], "big")
