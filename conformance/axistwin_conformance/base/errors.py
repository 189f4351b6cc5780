"""What can go wrong around a run, by whose doing it is.

    SuiteError
     ├─ UsageError    the person at the terminal: one line naming the value and the remedy, exit 2
     ├─ TargetError   the port: closed, vanished, stuck; becomes verdicts, never a traceback
     │   └─ TwinCrashed   the twin behind it fell over a mistake of its own
     ├─ RigError      the rig went wrong: what was being judged stays inconclusive
     ├─ CannotDo      the rig cannot do something: what was to be judged is not run
     └─ WrongDevice   somebody answers, but it is not the model named, exit 3

`OutsideEnvelope` is raised below checks for what they must not send; it was not sent, and what they
wanted to show with it is not run.

A mistake of the suite itself (an unknown requirement id, a check that never judges) is an ordinary
`AssertionError`, `TypeError` or `ValueError`: it is reported as an error of the check.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator


class SuiteError(Exception):
    """Base of everything the suite raises on purpose."""


class UsageError(SuiteError):
    """A wrong word on the command line; the text names it, the allowed ones and the remedy."""


class TargetError(SuiteError):
    """The port cannot be opened, is gone, or does not take bytes any more."""


class TwinCrashed(TargetError):  # noqa: N818 - a finding about the twin
    """A twin in this process raised an exception: a device that died in the middle of the run."""


class WrongDevice(SuiteError):  # noqa: N818 - a finding about the device, not an error of ours
    """Something answers, but not as the model named on the command line would."""


class OutsideEnvelope(AssertionError):  # noqa: N818 - names what was about to happen
    """The suite was about to ask an axis to leave the envelope, and was held back.

    `option`: the one that sets the bound in the way; `needed`: the least value of it that would do,
    None if nobody knows.
    """

    def __init__(self, text: str, option: str = "", needed: int | None = None) -> None:
        super().__init__(text)
        self.option, self.needed = option, needed

    @property
    def reason(self) -> str:
        """Why it was held back, after what would let it through if anybody knows."""
        if not self.option:
            return str(self)
        value = f" {self.needed}" if self.needed else ", nobody knows how much"
        return f"needs {'' if self.needed else 'more '}{self.option}{value}: {self}"


class RigError(SuiteError):
    """The rig did not do what it said it could, or could not be brought back to rest."""


class CannotDo(SuiteError):  # noqa: N818 - an answer of the rig, not an error
    """The rig cannot do what was asked; what was to be judged is not run."""


class AttemptVoid(SuiteError):  # noqa: N818 - a verdict on the attempt, not an error
    """The reply to something that must not be repeated was corrupted: the attempt is void."""


@contextlib.contextmanager
def interrupts_first() -> Iterator[None]:
    """Let an interrupt through although tidying up has raised something else in its place."""
    try:
        yield
    except Exception as error:
        cause: BaseException | None = error
        while cause is not None and not isinstance(cause, KeyboardInterrupt):
            cause = cause.__context__
        if cause is not None:
            raise KeyboardInterrupt from error
        raise


VOWELS = frozenset("aeiou")
SPOKEN_WITH_A_VOWEL = frozenset("aefhilmnorsx")  # letters whose names begin with one


def counted(count: int | str, word: str) -> str:
    """``1 check``, ``2 checks``."""
    return f"{count} {word}{'s'[: str(count) != '1']}"


def with_article(model: object) -> str:
    """``a mac23``, ``an msc-250``: read as a word if it has a vowel, else letter by letter."""
    name = str(model)
    word = name.partition("-")[0].rstrip("0123456789").lower()
    first_vowels = VOWELS if VOWELS & {*word} else SPOKEN_WITH_A_VOWEL
    return f"{'an' if word[:1] in first_vowels else 'a'} {name}"


def time_left(seconds: float) -> str:
    """A guess as rough as it is."""
    if seconds < 8:
        return "a few seconds left"
    if seconds < 55:
        return f"about {5 * round(seconds / 5)} s left"
    minutes = max(1, round(seconds / 60))
    return f"about {minutes} min left" if minutes < 100 else f"about {minutes / 60:.1f} h left"
