"""A rack that runs: its lines are built, served, and follow the file on SIGHUP."""

from __future__ import annotations

import contextlib
import resource
import signal
from collections.abc import Collection
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from axistwin.cli.output import EXIT_USAGE
from axistwin.cli.rack.file import (
    BusSection,
    ControlSection,
    LineSection,
    Problems,
    RackFile,
    RackFileError,
    RackText,
    Section,
)
from axistwin.cli.rack.positions import KeyPath
from axistwin.cli.run.can import CanRun
from axistwin.cli.run.reporter import Reporter, warn
from axistwin.cli.run.serial import SerialRun
from axistwin.cli.run.serving import VOLATILE, HostedLines, Run, Shared, make_control_server
from axistwin.errors import AxistwinError, PortError, UsageError
from axistwin.runtime.serving.rack import Rack
from axistwin.runtime.simulation import Simulation

if TYPE_CHECKING:
    from axistwin.control.front.workforce import Workforce
    from axistwin.control.server import ControlServer


def check(path: str) -> RackText:
    """The file at ``path``, which has no mistakes.

    All is built once, without ports, files and memory.  Raises RackFileError.
    """
    text = RackText(path)
    text.refuse(_problems_of_building(text.content, ()))
    return text


def perform_rack(path: str, reporter: Reporter) -> int:
    """Serve what the file at ``path`` has until a signal ends it; the exit status.

    Raises RackFileError; and PortError and StateError, if no line can be served.
    """
    content = check(path).content
    raise_limit_of_files()
    with contextlib.closing(reporter):
        with contextlib.closing(HostedLines(reporter)) as lines, contextlib.ExitStack() as beside:
            runner = RackRunner(path, lines)
            lines.rack.loop.install_signal_handlers(
                [signal.SIGINT, signal.SIGTERM], {signal.SIGHUP: runner.reload}
            )
            runner.start(content)
            control = None
            if content.control is not None:
                control = make_control(lines.rack, content.control)
                beside.callback(control.close)
                control.open()
            if content.state is None:
                warn(f"{VOLATILE}; 'state' in the file keeps it")

            def on_ready() -> None:
                runner.begin(None if control is None else control.url)

            lines.serve(control, on_ready)
        reporter.stopped()
    return EXIT_USAGE if reporter.has_lost else 0


class Reloaded(NamedTuple):
    """The lines that were removed and added, by name, and those that went on."""

    removed: list[str]
    added: list[str]
    unchanged: list[str]


def unchanged(content: RackFile, before: RackFile, served: Collection[str]) -> list[str]:
    """The lines of ``content`` that go on: those ``served`` that are as they were ``before``."""
    return [
        name
        for name, section in content.sections.items()
        if name in served and section == before.sections.get(name) and content.state == before.state
    ]


def read_again(
    path: str, reporter: Reporter, before: RackFile, served: Collection[str]
) -> RackFile | None:
    """What the file has now; None, and it is reported, if that is a mistake."""
    try:
        text = RackText(path)
        content = text.content
        text.refuse(_problems_of_building(content, unchanged(content, before, served)))
    except UsageError as error:
        problems = error.problems if isinstance(error, RackFileError) else [str(error)]
        for problem in problems:
            reporter.warn(problem)
        reporter.warn(f"{path}: not reloaded, everything goes on as it was")
        reporter.event({"event": "reload_failed", "file": path, "problems": problems})
        return None
    if content.control != before.control:
        reporter.warn(f"{path}: [control] has changed, which takes a new start")
    return content


def report_reload(path: str, reporter: Reporter, reloaded: Reloaded) -> None:
    """Tell that it is done."""
    reporter.warn(
        f"{path}: reloaded; removed: {', '.join(reloaded.removed) or 'none'}; "
        f"added: {', '.join(reloaded.added) or 'none'}; unchanged: {len(reloaded.unchanged)}"
    )
    reporter.event({"event": "reloaded", **reloaded._asdict()})


class RackRunner:
    """Keeps the ``lines`` as the file at ``path`` has them."""

    def __init__(self, path: str, lines: HostedLines) -> None:
        self._path = path
        self._lines = lines
        self._content = RackFile()
        self._control_url: str | None = None

    def start(self, content: RackFile) -> None:
        """Build and open all; a line that fails is reported.  Raises its error if all do."""
        self._content = content
        failures = []
        for section in content.sections.values():
            try:
                self._open(section)
            except AxistwinError as error:
                failures.append(error)
                self._report_failure(section, error)
        if not self._lines.rack.lines:
            raise failures[0]
        self.warn_of_surprises()

    def warn_of_surprises(self) -> None:
        """Say what the user may not expect of the lines, which are open."""
        for name in self._lines.rack.lines:
            run = make_run(self._content.sections[name], None)
            self._lines.warn_of_surprises(run, name)

    def begin(self, control_url: str | None) -> None:
        """Clients can connect."""
        self._control_url = control_url
        for name in self._lines.rack.lines:
            self._report_ready(name)

    def reload(self) -> None:
        """Serve what the file has now.  What did not change goes on; a mistake changes nothing."""
        reporter = self._lines.reporter
        content = read_again(self._path, reporter, self._content, self._served)
        if content is not None:
            report_reload(self._path, reporter, self.serve(content))

    def serve(self, content: RackFile) -> Reloaded:
        """Serve ``content``, which has no mistakes; what did not change goes on."""
        same = unchanged(content, self._content, self._served)
        self._content = content
        removed = [name for name in self._lines.rack.lines if name not in same]
        for name in removed:
            self._remove(name)
        added = [name for name in content.sections if name not in same]
        for name in added:
            self._add(content.sections[name])
        return Reloaded(removed, added, same)

    @property
    def _served(self) -> Collection[str]:
        lines = self._lines.rack.lines
        return [name for name, server in lines.items() if server.failure is None]

    def _open(self, section: Section) -> None:
        """Build it and claim its ports.  Raises AxistwinError; nothing is left then."""
        run = make_run(section, self._content.state)
        self._lines.add(run, section.name, partial(_set_initial, section))
        try:
            self._lines.rack.lines[section.name].open()
        except PortError:
            self._lines.remove(section.name)
            raise

    def _add(self, section: Section) -> None:
        """Open and serve it while the rack runs; a failure is reported."""
        try:
            self._open(section)
        except AxistwinError as error:
            self._report_failure(section, error)
            return
        self._lines.rack.begin(section.name)
        self._report_ready(section.name)

    def _remove(self, name: str) -> None:
        try:
            self._lines.remove(name)
        except AxistwinError as error:  # its memory could not be saved
            self._lines.reporter.lose(f"{name}: {error}")

    def _report_ready(self, name: str) -> None:
        server = self._lines.rack.lines[name]
        if server.failure is None:
            devices = [device.name for device in self._lines.rack.on_line(name)]
            self._lines.reporter.ready(devices, server.ports, self._control_url)

    def _report_failure(self, section: Section, error: AxistwinError) -> None:
        reporter = self._lines.reporter
        reporter.has_lost = True
        reporter.event(failure_of(section, str(error)))


def failure_of(section: Section, error: str) -> dict[str, object]:
    """The event that it is not served because of ``error``."""
    devices = [f"{spec}@{section.name}" for spec in section.specs]
    return {"event": "line_failed", "line": section.name, "devices": devices, "error": error}


def make_control(served: Rack | Workforce, control: ControlSection) -> ControlServer:
    """What the table asks for, not open yet.  Raises UsageError."""
    return make_control_server(
        served, control.address, control.token_file, control.certificate, control.key
    )


def make_run(section: Section, state: str | None) -> Run[Any]:
    """What ``axistwin run`` would make of it; ``state``: the folder that has a folder for each.

    Raises UsageError.
    """
    shared = Shared(
        state=None if state is None else f"{state}/{section.name}",
        profile=section.profile,
        quirks=tuple(f"{name}={value}" for name, value in section.quirks.items()),
        speed=section.speed,
        no_pacing=not section.pacing,
        cold=section.cold,
        seed=section.seed,
        capture=section.capture,
    )
    if isinstance(section, BusSection):
        return CanRun(
            section.specs,
            shared,
            can=tuple(section.can),
            slcan=tuple(section.slcan),
            slcan_tcp=tuple(section.slcan_tcp),
            socketcand=tuple(section.socketcand),
            bitrate=section.bitrate,
        )
    assert isinstance(section, LineSection)
    return SerialRun(
        section.specs,
        shared,
        links=tuple(section.pty),
        tcp=tuple(section.tcp),
        rfc2217=tuple(section.rfc2217),
        hid=section.hid,
        baud=section.baud,
        programs=tuple(section.program),
    )


def _set_initial(section: Section, simulation: Simulation[Any]) -> None:
    """Set inputs, loads, faults and whatever the file has for the start.  Raises UsageError."""
    for place, error in _set_each(section, simulation):
        raise UsageError(f"{'.'.join(map(str, place))}: {error}")


def _collect_initial(
    section: Section, found: list[tuple[KeyPath, str]], simulation: Simulation[Any]
) -> None:
    """Set it, and add to ``found`` what cannot be."""
    found.extend(_set_each(section, simulation))


def _set_each(section: Section, simulation: Simulation[Any]) -> Problems:
    """Set it, and tell what cannot be."""
    for number, fault in enumerate(section.faults):
        try:
            simulation.faults.add(**fault.model_dump())
        except UsageError as error:
            yield ("faults", number), str(error)
    twins = dict(zip(section.devices, simulation.twins, strict=True))
    for device, controls in section.initial.items():
        for name, value in controls.items():
            try:
                twins[device].controls[name].set(value)
            except UsageError as error:
                yield ("initial", device, name), str(error)


def _problems_of_building(content: RackFile, same: Collection[str]) -> Problems:
    """What shows only when it is built: all but the ``same``."""
    with contextlib.closing(HostedLines(Reporter(as_json=False))) as lines:
        for place, section in content.placed():
            if section.name in same:
                continue
            found: list[tuple[KeyPath, str]] = []
            try:
                run = make_run(section.model_copy(update={"capture": None}), None)
                lines.add(run, section.name, partial(_collect_initial, section, found))
                lines.remove(section.name)
            except AxistwinError as error:
                yield _place_in(place, section, str(error)), str(error)
            for inner, told in found:
                yield (*place, *inner), told
    if content.control is not None:
        with contextlib.closing(Rack()) as rack:
            try:
                make_control(rack, content.control)
            except UsageError as error:
                yield ("control",), str(error)


def _place_in(place: KeyPath, section: Section, message: str) -> KeyPath:
    """Where ``message`` belongs: it begins with the option that it is about, if it is about one."""
    fields = type(section).model_fields
    key = message.split()[0].strip(":").removeprefix("--")
    return (*place, key) if key.replace("-", "_") in fields else place


def raise_limit_of_files() -> None:
    """Several descriptors are open for each line: allow as many as may be."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
