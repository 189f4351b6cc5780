"""Ctrl-C while the program starts and ends: status 130 and no word, at whatever line it comes.

The program is loaded for some tenths of a second, in which nothing is open and nothing is to be put
back.  KeyboardInterrupt is no good there: what it comes amid tells it as a mistake of the module
that is being imported, or drops it.  So Ctrl-C ends the process by itself, until a command begins.
Then it is KeyboardInterrupt again, except where a module is being imported.  When nothing is left
to do but to take the interpreter apart, Ctrl-C does nothing: it would end the process by the
signal, not with a status.

A program that only imports this package keeps its Ctrl-C as it is.  What is imported here is there
already: ``signal``, which is not, takes time in which Ctrl-C would not work.
"""

import _signal  # type: ignore[import-not-found]
import atexit
import os
import sys

TYPE_CHECKING = False  # as typing has it
if TYPE_CHECKING:
    from types import FrameType

EXIT_INTERRUPTED = 130
PROGRAMS = ("axistwin", "-m")  # sys.argv[0]; the last one while `python -m axistwin` is being found
IMPORTING = "<frozen importlib"  # the file of what imports

_has_begun = False


def is_program() -> bool:
    """True if this process is the program ``axistwin``, and not one that imports its package."""
    name: str = (getattr(sys, "argv", None) or [""])[0]
    return name.rpartition("/")[2] in PROGRAMS


def install_signal_handler() -> bool:
    """Take Ctrl-C over; False if somebody has already, or this is not the main thread."""
    try:
        if _signal.getsignal(_signal.SIGINT) is not _signal.default_int_handler:
            return False
        _signal.signal(_signal.SIGINT, _end_or_interrupt)
    except ValueError:
        return False
    atexit.register(_ignore)  # the first of all, and so done last
    return True


def restore_signal_handler() -> None:
    """Undo ``install_signal_handler``, for a process that goes on."""
    atexit.unregister(_ignore)
    _signal.signal(_signal.SIGINT, _signal.default_int_handler)


def command_begins() -> None:
    """From now on something may be open: Ctrl-C is an exception."""
    global _has_begun  # noqa: PLW0603 - as there is one process
    _has_begun = True


def command_ends() -> None:
    """Everything is closed again."""
    global _has_begun  # noqa: PLW0603
    _has_begun = False


def end() -> None:
    """End the process as Ctrl-C does."""
    os._exit(EXIT_INTERRUPTED)


def _ignore() -> None:
    try:
        if sys.stdout is not None:
            sys.stdout.flush()  # as long as Ctrl-C ends a write that nobody reads
    except (OSError, ValueError):
        pass  # the interpreter tries again, and tells
    _signal.signal(_signal.SIGINT, _signal.SIG_IGN)


def _end_or_interrupt(number: int, frame: "FrameType | None") -> None:
    if _has_begun and not _is_importing(frame):
        raise KeyboardInterrupt
    try:
        sys.stdout.flush()
    finally:  # also amid a write, or where nobody reads
        end()


def _is_importing(frame: "FrameType | None") -> bool:
    """True if a module is being imported there: it takes exceptions for mistakes of its own."""
    while frame is not None:
        if frame.f_code.co_filename.startswith(IMPORTING):
            return True
        frame = frame.f_back
    return False
