"""``axistwin rack``: the command line."""

from __future__ import annotations

from pathlib import Path

import click

from axistwin.cli.extras import needed
from axistwin.cli.output import EXIT_USAGE
from axistwin.errors import UsageError

_EXAMPLE = Path(__file__).with_name("example.toml")


@click.command(
    epilog="SIGHUP: serve what the file has now; what did not change goes on.  Ends on Ctrl-C or "
    "SIGTERM."
)
@click.argument("file", metavar="FILE.toml")
@click.option("--check", "is_check", is_flag=True, help="Only say what is wrong in FILE.")
@click.option("--init", "is_init", is_flag=True, help="Write an example to FILE, with comments.")
@click.option(
    "--workers",
    metavar="N",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Serve the lines by so many processes, where the rack outgrows a core.",
)
@click.option("--json", "as_json", is_flag=True, help="Events on stdout, one JSON object per line.")
def rack(file: str, is_check: bool, is_init: bool, workers: int, as_json: bool) -> int:
    """Run the lines and buses of a file in one process, or several behind one.

    When clients can connect, one line per device says so, as of 'axistwin run'.  A line that
    fails is reported, and the others go on.  Paths in the file begin in the working directory.

    \b
    axistwin rack --init bench.toml
    axistwin rack --check bench.toml
    axistwin rack bench.toml
    axistwin rack --workers 2 bench.toml
    """
    if is_init:
        return _write_example(file)
    try:
        from axistwin.cli.rack.file import RackFileError
        from axistwin.cli.rack.front import check_front, perform_front
        from axistwin.cli.rack.running import check, perform_rack
        from axistwin.cli.run.reporter import Reporter
    except ImportError as error:
        raise UsageError(
            f"rack: {error.name} is missing; install what it needs: pip install "
            f"{needed(error.name)}"
        ) from None
    try:
        if is_check:
            if workers > 1:
                check_front(file, workers)
            else:
                check(file)
            return 0
        if workers > 1:
            return perform_front(file, Reporter(as_json), workers)
        return perform_rack(file, Reporter(as_json))
    except RackFileError as error:
        for problem in error.problems:
            click.echo(problem, err=True)
        return EXIT_USAGE


def _write_example(file: str) -> int:
    text = _EXAMPLE.read_text("utf-8")
    try:
        with Path(file).open("x", encoding="utf-8") as example:
            example.write(text)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UsageError(f"rack {file}: cannot be written ({reason}); name a new file") from None
    click.echo(f"{file} is written; 'axistwin rack {file}' runs it")
    return 0
