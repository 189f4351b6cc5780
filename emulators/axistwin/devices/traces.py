"""What devices of more than one family tell of themselves; a family adds its own.

A trace changes nothing: it is for whoever looks on.
"""

from dataclasses import dataclass

from axistwin.kernel.effects import Trace


@dataclass(frozen=True, slots=True)
class StateChanged(Trace):
    """The device is in another ``state``, in the words or the code of its family."""

    state: str


@dataclass(frozen=True, slots=True)
class ProgramStarted(Trace):
    """The user's program runs from its beginning."""


@dataclass(frozen=True, slots=True)
class ProgramStopped(Trace):
    """The user's program was stopped, or has stopped itself."""


@dataclass(frozen=True, slots=True)
class StrayReturn(Trace):
    """The user's program came to its end, which it must not."""


@dataclass(frozen=True, slots=True)
class ProgramFailed(Trace):
    """The user's program raised an exception; ``error`` says where and why."""

    error: str
