"""Whose fault it is stands in the type.

Wire faults are device behaviour and never exceptions.  Our own bugs are assertions.  What is left
is a user's mistake or a file or port that cannot be used: one clear line, naming the value, what
is allowed, and the remedy.
"""

from collections.abc import Iterable


class AxistwinError(Exception):
    """Base of all errors meant for the user's eyes; the message is one complete line."""


class UsageError(AxistwinError):
    """The user asked for something that does not exist or is out of range (exit status 2)."""


class StateError(AxistwinError):
    """A state file cannot be read, is torn, or belongs to something else (exit status 2)."""


class PortError(AxistwinError):
    """A port, link or address cannot be opened (exit status 2)."""


def nearest(name: str, known: Iterable[str]) -> str:
    """The remedy for a misspelt ``name``: the nearest known one, else the list of all."""
    import difflib

    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"did you mean {close[0]}?" if close else f"known: {', '.join(names)}"
