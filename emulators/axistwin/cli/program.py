"""The program ``axistwin``: its commands, and what a mistake looks like.

Commands are imported when they are used, so that ``axistwin run`` starts fast.  Other
distributions add commands through the entry point group ``axistwin.commands``.

Exit status: 0 done, 2 the user's mistake (one line on stderr), 70 a bug of ours (a traceback), 130
Ctrl-C.  Commands may define others.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NoReturn

import click

from axistwin import __version__, _starting
from axistwin.cli.extras import DISTRIBUTION, needed
from axistwin.cli.output import EXIT_USAGE, discard_stdout, stdout_failure
from axistwin.errors import AxistwinError, UsageError, nearest

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

EXIT_BUG = 70

COMMAND_GROUP = "axistwin.commands"

# Name: where it is, and its line in the list of commands (which then needs no import).
_OWN = {
    "run": (
        "axistwin.cli.run.command",
        "Run twins on a serial line or a CAN bus that any program can open.",
    ),
    "rack": (
        "axistwin.cli.rack.command",
        "Run the lines and buses of a file in one process.",
    ),
    "ctl": (
        "axistwin.cli.ctl",
        "Work inputs, supply, power and faults of a running daemon.",
    ),
    "watch": (
        "axistwin.cli.watch.command",
        "Show in a terminal what the devices of a running daemon do.",
    ),
    "send": (
        "axistwin.cli.send",
        "Send commands in words or bytes, and show the replies in words.",
    ),
    "decode": ("axistwin.cli.decode", "Show bytes of a line, or frames of a bus, in words."),
    "plot": (
        "axistwin.cli.plot.command",
        "Draw the motion of commands, of a recording, or of a device: path, position, rate.",
    ),
    "tap": (
        "axistwin.cli.tap.command",
        "Record what a program and a device on a serial port say to each other.",
    ),
    "replay": (
        "axistwin.cli.replay.command",
        "Compare a recording with what a twin would have said, and find the quirks.",
    ),
    "models": ("axistwin.cli.models", "List the models, or one model's quirks."),
    "doctor": (
        "axistwin.cli.doctor",
        "Check this machine, and show the remedy for what is missing.",
    ),
}


class _Program(click.Group):
    """Commands by name, imported late; errors as one line."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*_OWN, *sorted(point.name for point in _added())]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in _OWN:
            module = importlib.import_module(_OWN[cmd_name][0])
            command: click.Command = getattr(module, cmd_name)
            return command
        for point in _added():
            if point.name == cmd_name:
                return _load(point)
        return None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if not name.startswith("-") and self.get_command(ctx, name) is None:
            raise UsageError(f"no command {name!r}; {nearest(name, self.list_commands(ctx))}")
        found = super().resolve_command(ctx, args)
        ctx.meta[COMMAND_GROUP] = found
        if name in _OWN:  # others say themselves what Ctrl-C is to them once they have begun
            _starting.command_begins()
        return found

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except click.UsageError as error:
            # click's parser does not say whose option it is that has no value.
            if error.ctx is None and COMMAND_GROUP in ctx.meta:
                name, command, _ = ctx.meta[COMMAND_GROUP]
                error.ctx = click.Context(command, parent=ctx, info_name=name)
            raise

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        rows = [(name, text) for name, (_, text) in _OWN.items()]
        for point in _added():
            try:
                rows.append((point.name, _load(point).get_short_help_str(limit=72)))
            except UsageError as error:
                rows.append((point.name, f"not available: {error}"))
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def main(  # type: ignore[override]
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = "axistwin",
        **extra: Any,
    ) -> NoReturn:
        """Run the program and exit."""
        extra["standalone_mode"] = False
        try:
            status = super().main(args, prog_name, **extra)
            sys.exit(status if isinstance(status, int) else 0)
        except click.ClickException as error:
            _complain(_one_line(error))
            sys.exit(EXIT_USAGE)
        except AxistwinError as error:
            _complain(str(error))
            sys.exit(EXIT_USAGE)
        except (click.Abort, KeyboardInterrupt):
            sys.exit(_starting.EXIT_INTERRUPTED)
        except BrokenPipeError:  # the reader of our output, such as head, has seen enough
            sys.stderr.close()
            sys.exit(0)
        except Exception as error:
            reason = stdout_failure() if isinstance(error, OSError) else None
            if reason is not None:
                discard_stdout()
                _complain(f"standard output cannot be written ({reason}); choose another place")
                sys.exit(EXIT_USAGE)
            import traceback

            traceback.print_exc()
            _complain("this is a bug of axistwin's; the lines above say where")
            sys.exit(EXIT_BUG)


def _added() -> list[EntryPoint]:
    """Commands of other distributions."""
    from importlib.metadata import entry_points

    return list(entry_points(group=COMMAND_GROUP))


def _distribution(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else DISTRIBUTION


def _load(point: EntryPoint) -> click.Command:
    """Import an added command.  Raises UsageError with the remedy if that fails."""
    try:
        command = point.load()
    except ImportError as error:
        raise UsageError(
            f"command {point.name!r} cannot be loaded ({error}); install what it needs: "
            f"pip install {needed(error.name, _distribution(point))}"
        ) from error
    if not isinstance(command, click.Command):
        raise UsageError(f"command {point.name!r} ({point.value}) is not a click command")
    return command


def _one_line(error: click.ClickException) -> str:
    """What click has to say, and where the help is."""
    message = " ".join(error.format_message().split()).rstrip(".")
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "axistwin"
    return f"{message}; see '{command} --help'"


def _complain(message: str) -> None:
    click.echo(f"axistwin: {message}", err=True)


@click.command(
    "axistwin",
    cls=_Program,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    no_args_is_help=False,
)
@click.version_option(__version__, prog_name="axistwin", message="%(prog)s %(version)s")
def main() -> None:
    """Twins of motion controllers that behave as the real ones do, down to the wire.

    \b
    axistwin run mac23                 a MAC23 at ./mac23, for any serial program
    axistwin run mac23:0 mac34-1:5     two modules on one line
    axistwin run mac23-can             a MAC23 on vcan0, or an slcan adapter
    axistwin rack bench.toml           many lines and buses, one process
    axistwin ctl mac23 power cycle     work a run that has --control
    axistwin watch mac23               follow it in a terminal
    axistwin send ./mac23 'go to 125'  one command in words, and the reply
    axistwin decode mac23 capture.txt  recorded bytes in words
    axistwin plot mn400 M500,300       the motion of a command as a picture
    axistwin replay x.txt --against mac23   would a twin have said the same?
    axistwin models mac23              its quirks: what the manual leaves open
    axistwin conform mac23             a verdict per requirement of its manual
    """
