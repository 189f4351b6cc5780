"""Where the program ``axistwin`` begins: nothing is loaded yet, and Ctrl-C is heeded already."""

import sys
from collections.abc import Sequence
from typing import NoReturn

EXIT_INTERRUPTED = 130


def main(args: Sequence[str] | None = None) -> NoReturn:
    """Run the program with ``args`` (None: those of the command line) and exit."""
    try:
        from axistwin.cli import program
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    program.main(args)
    raise AssertionError("the program exits")
