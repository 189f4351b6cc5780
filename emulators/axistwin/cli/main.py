"""Where the program ``axistwin`` begins: nothing is loaded yet, and Ctrl-C works already."""

from collections.abc import Sequence
from typing import NoReturn

from axistwin import _starting


def main(args: Sequence[str] | None = None) -> NoReturn:
    """Run the program with ``args`` (None: those of the command line) and exit."""
    is_installed = _starting.install_signal_handler()
    try:
        from axistwin.cli import program

        program.main(args)
    except KeyboardInterrupt:  # of somebody else's handler
        raise SystemExit(_starting.EXIT_INTERRUPTED) from None
    finally:
        _starting.command_ends()
        if is_installed and not _starting.is_program():
            _starting.restore_signal_handler()
    raise AssertionError("the program exits")
