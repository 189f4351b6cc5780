"""What devices that run a user's program tell of it; a start without one loads none of this."""

from dataclasses import dataclass

from axistwin.kernel.effects import Trace


@dataclass(frozen=True, slots=True)
class ProgramStarted(Trace):
    """The user's program runs from its beginning."""

    def __str__(self) -> str:
        return "its program starts"


@dataclass(frozen=True, slots=True)
class ProgramStopped(Trace):
    """The user's program was stopped, or has stopped itself."""

    def __str__(self) -> str:
        return "its program has stopped"


@dataclass(frozen=True, slots=True)
class StrayReturn(Trace):
    """The user's program came to its end, which it must not."""

    def __str__(self) -> str:
        return "its program has stopped: run came to its end"


@dataclass(frozen=True, slots=True)
class ProgramFailed(Trace):
    """The user's program raised an exception; ``error`` says where and why."""

    error: str

    def __str__(self) -> str:
        return f"its program has stopped with an error: {self.error}"
