"""Standard output that cannot be written, and the exit status that tells of mistakes."""

import os
import sys

EXIT_USAGE = 2


def discard_stdout() -> None:
    """Send standard output nowhere from now on, what still waits to be written included."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def stdout_failure() -> str | None:
    """Why standard output cannot be written, which an empty line finds out; None if it can."""
    try:
        sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError as error:
        return error.strerror or str(error)
    return None
