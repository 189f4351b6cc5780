"""Whose fault it is stands in the type.

Wire faults are device behaviour and never exceptions.  Our own bugs are assertions.  What is left
is a user's mistake or a file or port that cannot be used: one clear line, naming the value, what
is allowed, and the remedy.
"""

from collections.abc import Iterable

_LISTED_MAX = 12
_OFFERED_MAX = 3
_PREFIX_MIN = 3
_CLOSE_MIN = 0.75
"""As ``difflib`` measures it: two letters swapped in four still are, two of six exchanged not."""

_SPELT_WITH_VOWEL = ("msc",)
"""What names begin with that is read letter by letter, the first one with a vowel in front."""


class AxistwinError(Exception):
    """Base of all errors meant for the user's eyes; the message is one complete line."""


class UsageError(AxistwinError):
    """The user asked for something that does not exist or is out of range (exit status 2)."""


class UnknownNameError(UsageError, KeyError):
    """The user named what there is not; also a mapping's mistake."""

    __str__ = UsageError.__str__


class StateError(AxistwinError):
    """A state file cannot be read, is torn, or belongs to something else (exit status 2)."""


class PortError(AxistwinError):
    """A port, link or address cannot be opened (exit status 2)."""


def nearest(name: str, known: Iterable[str], lister: str = "") -> str:
    """The remedy for a misspelt ``name``: the nearest known ones, else the list of all.

    lister: the command that lists them, named instead of more than a few.
    """
    names = sorted(known)
    hint = suggestion(name, names)
    if hint:
        return hint
    if lister and len(names) > _LISTED_MAX:
        return f"see '{lister}'"
    return f"known: {', '.join(names)}"


def suggestion(name: str, known: Iterable[str]) -> str:
    """``did you mean`` those of ``known`` that begin with or resemble ``name``; "" for none."""
    import difflib

    folded = {each.lower(): each for each in known}
    wanted = name.lower()
    close = [each for each in folded if len(wanted) >= _PREFIX_MIN and each.startswith(wanted)]
    if wanted in folded:
        close = [wanted]
    elif len(close) > _OFFERED_MAX:
        close = []
    elif not close:
        close = difflib.get_close_matches(wanted, folded, n=_OFFERED_MAX, cutoff=_CLOSE_MIN)
        ratios = [difflib.SequenceMatcher(None, each, wanted).ratio() for each in close]
        close = sorted(
            each for each, ratio in zip(close, ratios, strict=True) if ratio == ratios[0]
        )
    return f"did you mean {' or '.join(folded[each] for each in close)}?" if close else ""


def with_article(name: str) -> str:
    """``a mac23``, ``an msc-250``."""
    return f"{'an' if name.startswith(_SPELT_WITH_VOWEL) else 'a'} {name}"
