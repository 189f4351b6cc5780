"""Bytes of a line in words: what is a part of the protocol told as such, all else as hex."""

from collections.abc import Callable, Iterator


def in_words(data: bytes, part_at: Callable[[bytes, int, bool], tuple[str, int]]) -> Iterator[str]:
    """The parts in ``data`` one by one; stretches that are none as hex.

    part_at: the text and length of the part that begins there, length 0 if none does; its third
    argument tells whether the part before ends there.
    """
    at = junk = 0
    while at < len(data):
        text, length = part_at(data, at, at == junk)
        if length:
            if junk < at:
                yield spaced(data[junk:at])
            yield text
            junk = at + length
        at += length or 1
    if junk < len(data):
        yield spaced(data[junk:])


def missing(count: int, whole: int, of_what: str = "") -> str:
    """``3 of 6 bytes of the header are missing``."""
    return f"{count} of {whole} bytes{of_what} {'is' if count == 1 else 'are'} missing"


def incomplete(data: bytes, what: str) -> str:
    """The bytes of something that breaks off, and what is missing of it."""
    return f"{spaced(data)} [incomplete: {what}]"


def spaced(data: bytes) -> str:
    """As people read bytes: ``06 13 1A``."""
    return data.hex(" ").upper()
