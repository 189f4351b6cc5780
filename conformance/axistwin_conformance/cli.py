"""The command `axistwin conform`: judge a device, or the built-in twin of it.

Exit status: 0 conforms; 1 does not; 2 wrong usage, nothing was judged, or a report or the output
could not be written; 3 unreachable or not the model named; 4 nothing failed but something stayed
inconclusive; 130 interrupted; 141 nobody reads the output any more (`| head`).
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from axistwin_conformance.base import interrupts
from axistwin_conformance.base.classes import FULL, LEVELS
from axistwin_conformance.base.errors import UsageError, with_article
from axistwin_conformance.cli_types import SectionedCommand, Word, WordPath, refuse_lost
from axistwin_conformance.core.option_types import Address, Count
from axistwin_conformance.families.catalog import families, family_options
from axistwin_conformance.options import make_options as make_options
from axistwin_conformance.options import parse_allowed as parse_allowed
from axistwin_conformance.options import usable_cores

if TYPE_CHECKING:
    from axistwin_conformance.base.events import Event, Listener
    from axistwin_conformance.engine.run import Engine
    from axistwin_conformance.report.folder import ReportFolder

EXTRA = ("hypothesis", "jinja2", "rich")  # by these names a clone and a wheel both find them
VERDICTS = (0, 1, 4)
UNWRITTEN = 2  # a verdict that is missing where it was asked for is none
UNWRITABLE = (errno.EPIPE, errno.ENOSPC, errno.EIO, errno.EFBIG, errno.EDQUOT)
UNHEARD = 141  # what a shell tells of a program that a closed pipe has ended: 128 + SIGPIPE
MOST_BAUD = 16_000_000  # beyond what any adapter does
MOST_JOBS = 1024
MOST_SOAK_S = 366 * 24 * 3600.0


class Duration(click.ParamType[float]):
    """A duration: 2h, 30m, 45s; a number alone means hours.  Its value is in seconds."""

    name = "duration"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Read it; nothing, less than nothing and more than a year are mistakes."""
        from axistwin_conformance.engine.plan import UNITS

        match = re.fullmatch(r"(\d{1,9}(?:\.\d{1,9})?)([hms]?)", str(value).strip().lower())
        seconds = float(match[1]) * UNITS[match[2] or "h"] if match else 0.0
        if not 0 < seconds <= MOST_SOAK_S:
            self.fail(f"{value!r} is no duration: write 2h, 30m or 45s", param, ctx)
        return seconds


class Mistake(click.ClickException):
    """A wrong word on the command line, told in one line; `ctx` tells whose help to look at."""

    exit_code = 2

    def __init__(self, message: str, ctx: click.Context) -> None:
        super().__init__(message)
        self.ctx = ctx


class OutputLost(BaseException):
    """Standard output takes nothing any more: the run ends as by an interrupt, and is put back."""

    def __init__(self, error: OSError) -> None:
        super().__init__(error)
        self.error = error


SECTIONS = {
    "port": "Device",
    "dry_run": "What may happen to the device",
    "level": "What is judged",
    "report": "Output",
}  # each begins with this option

Function = TypeVar("Function", bound=Callable[..., Any])


def _family_options(function: Function) -> Function:
    """The options that belong to families, those of all of them in one order."""
    for option in reversed(family_options()):
        named = click.option(
            f"--{option.name}", type=option.kind, metavar=option.metavar, help=option.help
        )
        function = named(function)
    return function


@click.command(
    cls=SectionedCommand,
    sections=SECTIONS,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.argument("model", required=False)
@click.argument("ids", nargs=-1, type=Word(), metavar="[ID]...")
@click.option(
    "--port",
    type=Word(),
    metavar="URL",
    help="Port of a device on a serial line: a name such as /dev/ttyUSB0, or a URL of pyserial."
    " Without --port, --can and --hid, the built-in twin is judged.",
)
@click.option(
    "--can",
    type=Word(),
    metavar="INTERFACE:CHANNEL",
    help="Bus of a device on CAN: interface and channel of python-can, such as socketcan:can0 or"
    " slcan:/dev/ttyACM0; further options of the interface as ?NAME=VALUE&...",
)
@click.option(
    "--hid",
    type=Word(),
    metavar="PATH",
    help="USB port of a device that has one: its node, such as /dev/hidraw0. Judges what is said"
    " of USB.",
)
@click.option("--address", type=Address(), help="Address of the device on its line or bus.")
@click.option(
    "--neighbour",
    "neighbours",
    type=Address(),
    multiple=True,
    help="Address of another module of this kind on the line or bus; repeatable.",
)
@click.option("--baud", type=Count(1, MOST_BAUD), help="Rate of the line.")
@click.option(
    "--bitrate",
    type=click.IntRange(10_000, 1_000_000),
    metavar="N",
    help="Rate of the bus in bit/s, for interfaces that set it. Default: as the interface is set.",
)
@click.option("--dry-run", is_flag=True, help="Show the plan, and send nothing.")
@click.option(
    "--allow",
    metavar="CLASS,...",
    help="Classes of checks to allow besides passive ones: motion, stored, negative, rig,"
    " destructive. Default: none on a port or a bus, all on the built-in twin.",
)
@_family_options
@click.option(
    "--rig",
    type=Word(),
    metavar="[twin|prompt|command|URL]",
    help="Rig that operates inputs, supply and shaft; URL: the control API of a running twin, such"
    " as http://127.0.0.1:8080, or https://. A device also needs --allow rig; a twin is its own"
    " rig.",
)
@click.option(
    "--rig-command",
    type=Word(),
    metavar="COMMAND",
    help="With --rig command: the command to run for each act; {verb}, {name} and {value} are"
    " filled in.",
)
@click.option(
    "--restore",
    type=WordPath(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Restore the device from the file that an earlier run named before it wrote anything;"
    " judge nothing. Default port and address: those of the file.",
)
@click.option(
    "--level",
    type=click.Choice(LEVELS),
    help=f"How much to run. Default: {FULL}. soak: full, then random sequences for --duration.",
)
@click.option(
    "--duration",
    type=Duration(),
    metavar="TIME",
    help="Length of a soak in real time: 45s, 30m, 2h; a number alone is hours. Default: 2h.",
)
@click.option(
    "--jobs",
    type=Count(1, MOST_JOBS),
    default=usable_cores,
    show_default="usable cores",
    metavar="N",
    help="Processes that play random sequences on the built-in twin. The findings do not depend on"
    " it.",
)
@click.option("-x", "--exitfirst", is_flag=True, help="End after the first check that fails.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="N",
    help="Seed of all random choices.",
)
@click.option(
    "--detect",
    "detect",
    type=WordPath(dir_okay=False, path_type=Path),
    metavar="OUT.toml",
    help="Write the profile of the device: its reading of each quirk. With neither ID nor --level,"
    " do only that.",
)
@click.option(
    "--profile",
    "profile",
    type=WordPath(dir_okay=False, path_type=Path),
    metavar="FILE.toml",
    help="Profile that the device must have; another reading is a failure.",
)
@click.option(
    "--replay",
    type=Word(),
    metavar="FILE|HEX",
    help="Repeat only the operations of a failure; exit status 0 if it does not occur again.",
)
@click.option(
    "--report",
    type=WordPath(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Write report.html, report.json, junit.xml, events.jsonl and the operations of failures"
    " to this folder.",
)
@click.option(
    "--compare",
    nargs=2,
    type=WordPath(path_type=Path),
    metavar="OLD NEW",
    help="Show the verdicts that changed between two reports (folders or report.json); run"
    " nothing.",
)
@click.option("--list", "is_list", is_flag=True, help="List requirements and checks; run nothing.")
@click.option("--json", "is_json", is_flag=True, help="Print one JSON object per event.")
@click.option("-v", "--verbose", is_flag=True, help="Show passes too, and whole transcripts.")
@click.pass_context
def conform(ctx: click.Context, /, **given: Any) -> None:  # fmt: skip
    """Judge MODEL against its manual, requirement by requirement.

    ID: a requirement, a prefix of several, a check, or a quirk.  Default: everything.

    \b
    the built-in twin, in virtual time
      axistwin conform mac23
      axistwin conform mac23 MACS-FRAME MACS-CMD-13-01
      axistwin conform mac23 --level soak --duration 8h
    a real device: show the plan; passive checks only; checks that move the axis
      axistwin conform mac23 --port /dev/ttyUSB0 --dry-run
      axistwin conform mac23 --port /dev/ttyUSB0
      axistwin conform mac23 --port /dev/ttyUSB0 --allow motion --max-travel 2000
      axistwin conform mac23-can --can socketcan:can0 --address 5
      axistwin conform msc-250 --port /dev/ttyUSB0 --variables 2048-3071
    its profile, for axistwin run --profile; its reading of one quirk
      axistwin conform mac23 --port ./mac23 --allow motion --detect unit.toml
      axistwin conform mac23 --port ./mac23 lowercase_hex
    one failure again; the verdicts that changed between two --report
      axistwin conform mac23 --replay out/operations/...
      axistwin conform --compare old new
    """
    try:
        refuse_lost(ctx)
        with _output():
            _speak_any_locale(is_json=given["is_json"])
            status = _conform(**given)
            sys.stdout.flush()
    except OutputLost as lost:
        if isinstance(lost.error, BrokenPipeError):
            ctx.exit(UNHEARD)
        click.echo(f"axistwin: cannot write the output: {lost.error.strerror}", err=True)
        ctx.exit(UNWRITTEN)
    except UsageError as error:
        raise Mistake(str(error), ctx) from error
    ctx.exit(status)


def _speak_any_locale(*, is_json: bool) -> None:
    """Let no character that a terminal's encoding lacks end a run: there it is a question mark.
    JSON is UTF-8 everywhere."""
    if not isinstance(sys.stdout, io.TextIOWrapper):
        return
    if is_json:
        sys.stdout.reconfigure(encoding="utf-8")
    else:
        sys.stdout.reconfigure(errors="replace")


@contextlib.contextmanager
def _output() -> Iterator[None]:
    """Tell a failure of standard output from every other one; nothing is written there then.

    Where there is none, as under `>&-`, nobody wants to be told: what is opened next must not take
    its place, or a device would be sent words."""
    if sys.stdout is None:
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - to the end
    try:
        yield
    except OutputLost:
        raise
    except OSError as error:
        if error.errno not in UNWRITABLE:
            raise
        with contextlib.suppress(OSError, ValueError):  # or the interpreter tries again at its end
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, sys.stdout.fileno())
            os.close(nowhere)
        raise OutputLost(error) from error


def _conform(
    *,
    is_list: bool,
    dry_run: bool,
    is_json: bool,
    verbose: bool,
    report: Path | None,
    detect: Path | None,
    compare: tuple[Path, Path] | None,
    restore: Path | None,
    **given: Any,
) -> int:
    try:
        if compare is not None:
            return _compare(*compare, is_json, given["model"])
        if given["model"] is None:
            known = sorted(name for family in families() for name in family.models)
            raise UsageError(f"name a MODEL to judge: {', '.join(known)}")
        from axistwin_conformance.engine.run import Engine

        given["report"] = "" if report is None else str(report)
        if restore is not None:
            return _put_back(restore, given)
        engine = Engine(make_options(is_detection=detect is not None, **given))
        if is_list or dry_run:
            return _show(engine, is_list, is_json)
        if detect is not None and not detect.parent.is_dir():  # before a long run, not after it
            raise UsageError(f"--detect {detect}: there is no folder {detect.parent}")
        with interrupts.heeded():
            status = _run(engine, is_json, report, is_verbose=verbose)
            if detect is not None:
                _write_profile(engine, detect, is_json)
        return status
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in EXTRA:
            raise
        raise UsageError(f"the suite needs {missing}: pip install {' '.join(EXTRA)}") from error


def _put_back(path: Path, given: dict[str, Any]) -> int:
    """Put back what a file says; the exit status."""
    from axistwin_conformance.base.events import Note
    from axistwin_conformance.engine.device import keeping
    from axistwin_conformance.engine.device.restoring import put_back
    from axistwin_conformance.families.catalog import find_family
    from axistwin_conformance.transport.kinds import TRANSPORT_KINDS

    if given["ids"] or given["replay"]:
        raise UsageError("--restore judges nothing: leave out --replay and every ID")
    kept = keeping.load(path, given["model"])
    if all(given[kind.option.removeprefix("--")] is None for kind in TRANSPORT_KINDS):
        option = kept.option or find_family(kept.model).transport_kind.option
        given[option.removeprefix("--")] = kept.endpoint
    given["address"] = kept.address if given["address"] is None else given["address"]
    with interrupts.heeded():
        return put_back(
            make_options(is_detection=False, **given), path,
            lambda event: click.echo(event.text) if isinstance(event, Note) else None,
        )  # fmt: skip


def _write_profile(engine: Engine, path: Path, is_json: bool) -> None:
    """Write what was detected; nothing where there was no device to ask."""
    from axistwin_conformance.core.profile import as_toml, write_profile

    detections = engine.detections
    if not detections:
        return
    options = engine.options
    heading = (
        f"Readings of {with_article(options.model)} as detected by\n"
        f"{options.command} --detect {shlex.quote(str(path))}\n"
        "What is a comment is the default, confirmed, or not known."
    )
    try:
        write_profile(path, as_toml(options.model, engine.ledger, detections, heading))
    except OSError as error:
        raise UsageError(f"cannot write the profile {path}: {error.strerror}") from error
    found = "" if options.is_only_detection else f": {engine.found}"  # there the run says it
    click.echo(f"profile: {path}{found}", err=is_json)


def _compare(old: Path, new: Path, is_json: bool, model: str | None) -> int:
    """Tell what changed between two reports; 1 if anything got worse."""
    from axistwin_conformance.report import compare, terminal
    from axistwin_conformance.report import json as report_json

    if model is not None:
        raise UsageError(f"--compare runs nothing: leave out {model!r}")
    before, after = report_json.load(old), report_json.load(new)
    found = compare.changes(before, after)
    notes = compare.circumstances(before, after)
    if is_json:
        click.echo(json.dumps(compare.as_object(found, notes), ensure_ascii=False))
    else:
        compare.print_changes(terminal.make_console(), found, notes)
    return int(any(item.is_worse for item in found))


def _show(engine: Engine, is_list: bool, is_json: bool) -> int:
    """Show requirements or the plan; runs nothing."""
    from axistwin_conformance.report import json as report_json
    from axistwin_conformance.report import terminal

    plan = engine.plan()
    if is_json:
        click.echo(report_json.overview(engine.ledger, plan, engine.options))
    elif is_list:
        checks = engine.family.checks()
        terminal.print_ledger(terminal.make_console(), engine.ledger, plan.requirements, checks)
    else:
        terminal.print_plan(terminal.make_console(), plan, engine.options)
    return 0


def _run(engine: Engine, is_json: bool, report: Path | None, *, is_verbose: bool) -> int:
    from axistwin_conformance.engine.eta import Eta, weigh
    from axistwin_conformance.report import json as report_json
    from axistwin_conformance.report import terminal
    from axistwin_conformance.report.folder import ReportFolder, past_seconds

    explain, spell = engine.family.explain, engine.family.transport_kind.spell
    folder, past = None, {}
    if report is not None:
        past = past_seconds(report, engine.options.url)
        with _report_trouble():  # before a long run, not after it
            folder = ReportFolder(report, explain, spell)
    with contextlib.ExitStack() as stack:
        shown: Listener
        if is_json:
            shown = report_json.JsonStream(sys.stdout, explain, spell)
        else:
            console = terminal.make_console()
            duration_s = engine.options.duration_s or 0.0
            pace = Eta(weigh(engine.plan()), past, afterwards_s=duration_s)
            shown = stack.enter_context(
                terminal.TerminalReport(
                    console,
                    engine.ledger,
                    explain,
                    pace,
                    engine.options.report,
                    spell,
                    is_verbose=is_verbose,
                )
            )
        readers = _Readers(folder, shown)
        result = engine.run(readers)
    status = result.exit_status
    if folder is not None and not _is_finished(folder, is_json) and status in VERDICTS:
        status = UNWRITTEN
    if readers.lost is not None:
        raise readers.lost
    return status


class _Readers:
    """Tells a run to its report and to the terminal: while one of them takes what it is told, the
    other may fail.  Where nobody reads any more, the run ends."""

    def __init__(self, folder: ReportFolder | None, terminal: Listener) -> None:
        self._folder, self._terminal = folder, terminal
        self.lost: OutputLost | None = None

    def __call__(self, event: Event) -> None:
        if self._folder is not None:
            before = set(self._folder.lost)
            with _report_trouble():
                self._folder(event)
            for path in self._folder.lost.keys() - before:
                from axistwin_conformance.base.events import Note

                self._tell(Note(f"cannot write {path}: {self._folder.lost[path]}; the run goes on"))
        self._tell(event)

    def _tell(self, event: Event) -> None:
        if self.lost is not None:
            return  # what is told while the device is put back has no reader any more
        try:
            with _output():
                self._terminal(event)
        except OutputLost as lost:
            self.lost = lost
            if self._folder is None or isinstance(lost.error, BrokenPipeError):
                raise


def _is_finished(folder: ReportFolder, is_json: bool) -> bool:
    """Write the rest of a report; tell where it is, and what of it could not be written."""
    whole = folder.finish()
    if whole:
        first, *others = whole
        names = ", ".join(path.name for path in others)
        beside = f" ({names} beside it)" if names else ""
        click.echo(f"report: {first}{beside}", err=is_json)
    for reason in dict.fromkeys(folder.lost.values()):
        paths = ", ".join(str(path) for path, why in folder.lost.items() if why == reason)
        remedy = "make room, or name another folder by --report"
        click.echo(f"axistwin: cannot write {paths}: {reason}; {remedy}", err=True)
    return not folder.lost


@contextlib.contextmanager
def _report_trouble() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(f"cannot write the report: {error.strerror}: {error.filename}") from error
