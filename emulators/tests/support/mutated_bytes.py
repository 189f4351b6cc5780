"""What a line may make of bytes that were meant well."""

import random


def mutated(frame: bytes, rng: random.Random) -> bytes:
    """``frame`` with none to three bytes changed, dropped, doubled or inserted."""
    data = bytearray(frame)
    for _ in range(rng.randint(0, 3)):
        place = rng.randrange(len(data))
        kind = rng.randrange(4)
        if kind == 0:
            data[place] = rng.randrange(256)
        elif kind == 1:
            del data[place]
        elif kind == 2:
            data.insert(place, data[place])
        else:
            data.insert(place, rng.randrange(256))
    return bytes(data)
