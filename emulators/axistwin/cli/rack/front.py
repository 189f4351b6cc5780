"""The front of a rack: the process that the user starts, where workers serve the lines.

Rules
-----
1. The front reads the file, tells everything on its outputs, and has the control API.  Workers
   (``worker``) serve the lines, which ``division`` has given them.
2. A worker that ends is told as the failure of its lines; the others go on.  As other lines that
   have failed they are served again at the next SIGHUP.  When all have failed the front ends.
3. At a reload first all lines end that are to end, and then others begin: a port may go from one
   worker to another.  A reload that is asked for meanwhile comes after it.
4. Workers end when the front does, however it ends: their standard input does.
"""

from __future__ import annotations

import contextlib
import signal
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from axistwin.cli.output import EXIT_USAGE
from axistwin.cli.rack.division import check_count, divide, part_of
from axistwin.cli.rack.file import RackFile, Section
from axistwin.cli.rack.process import WorkerProcess
from axistwin.cli.rack.running import (
    Reloaded,
    check,
    failure_of,
    make_control,
    raise_limit_of_files,
    read_again,
    report_reload,
    unchanged,
)
from axistwin.cli.rack.worker import READY, SERVED, WARNED
from axistwin.cli.run import systemd
from axistwin.cli.run.reporter import Reporter, warn
from axistwin.cli.run.serving import VOLATILE
from axistwin.control.front.workforce import WorkedLine, Workforce
from axistwin.errors import PortError
from axistwin.runtime.serving.loop import Callback, Loop

if TYPE_CHECKING:
    from axistwin.control.server import ControlServer

STOP_S = 30.0
"""How long workers may take to save and end, before they are killed."""


def check_front(path: str, count: int) -> RackFile:
    """What the file at ``path`` has; there is a line for each of ``count`` workers.

    Raises RackFileError and UsageError.
    """
    content = check(path).content
    check_count(path, content, count)
    return content


def perform_front(path: str, reporter: Reporter, count: int) -> int:
    """As ``perform_rack``, by ``count`` workers."""
    content = check_front(path, count)
    raise_limit_of_files()
    with contextlib.closing(reporter):
        with contextlib.closing(Loop()) as loop, contextlib.ExitStack() as beside:
            workforce = Workforce()
            control = None
            if content.control is not None:
                control = make_control(workforce, content.control)
                beside.callback(control.close)
                control.open()
            front = Front(path, content, count, reporter, loop, workforce, control)
            beside.callback(front.close)
            calls = {signal.SIGINT: front.stop, signal.SIGTERM: front.stop}
            loop.install_signal_handlers([], {**calls, signal.SIGHUP: front.reload})
            front.start()
            loop.run()
            if front.failure is not None:
                raise PortError(front.failure)
        reporter.stopped()
    return EXIT_USAGE if reporter.has_lost else 0


@dataclass(frozen=True, slots=True)
class ToldPort:
    """A port that a worker has open, as it has told."""

    kind: str
    url: str
    text: str
    device_index: int | None

    def describe(self) -> str:
        """For people."""
        return self.text

    def open(self) -> None:
        """The worker has."""

    def close(self) -> None:
        """The worker does."""


class Front:
    """See above.  ``failure``: why it ends by itself."""

    def __init__(
        self,
        path: str,
        content: RackFile,
        count: int,
        reporter: Reporter,
        loop: Loop,
        workforce: Workforce,
        control: ControlServer | None,
    ) -> None:
        self.failure: str | None = None
        self._path, self._content, self._count = path, content, count
        self._reporter, self._loop = reporter, loop
        self._workforce, self._control = workforce, control
        self._where = divide(content, count)
        self._processes: dict[int, WorkerProcess] = {}
        self._failed: dict[str, str] = {}
        """Why lines of the file are not served."""
        self._ready: dict[str, tuple[list[str], list[ToldPort]]] = {}
        """What is open since the last orders, and not told yet: devices and ports."""
        self._awaited: set[int] = set()
        self._then: Callback = lambda: None
        self._is_wanted_again = self._is_stopping = self._has_new_worker = False

    def start(self) -> None:
        """Have everything served."""
        if self._content.state is None:
            warn(f"{VOLATILE}; 'state' in the file keeps it")
        self._order(self._content, self._begin)

    def _begin(self) -> None:
        """All is served that can be."""
        added = self._take_ready()
        if not added:
            self._end_because(next(iter(self._failed.values())))
            return
        if self._control is not None:
            self._control.serve()
        self._report_ready(added)
        systemd.notify("READY=1")
        self._reload_if_wanted()

    # -- reload -------------------------------------------------------------------------------

    def reload(self) -> None:
        """Serve what the file has now, by rule 3."""
        if self._awaited or self._is_stopping:
            self._is_wanted_again = True
            return
        served = [name for name in self._workforce.lines if name not in self._failed]
        content = read_again(self._path, self._reporter, self._content, served)
        if content is None:
            return
        same = unchanged(content, self._content, served)
        removed = [name for name in self._workforce.lines if name not in same]
        added = [name for name in content.sections if name not in same]
        self._where = divide(content, self._count, {name: self._where[name] for name in same})
        self._content = content
        self._failed = {}
        reloaded = Reloaded(removed, added, same)
        self._order(part_of(content, set(same)), partial(self._add, reloaded))

    def _add(self, reloaded: Reloaded) -> None:
        """What was to end has."""
        lines = self._workforce.lines
        self._workforce.lines = {name: lines[name] for name in reloaded.unchanged if name in lines}
        before = set(self._processes)
        self._order(self._content, partial(self._end_reload, reloaded))
        self._has_new_worker = not before.issuperset(self._processes)

    def _end_reload(self, reloaded: Reloaded) -> None:
        added = self._take_ready()
        self._report_ready(added)
        report_reload(self._path, self._reporter, reloaded)
        if added and self._workforce.viewers is not None:
            lines = [self._workforce.lines[name] for name in added]
            self._workforce.viewers.lines_came(lines, by_new_worker=self._has_new_worker)
        self._reload_if_wanted()

    def _reload_if_wanted(self) -> None:
        if self._is_wanted_again:
            self._is_wanted_again = False
            self.reload()
        else:
            self._end_if_all_failed()

    # -- workers ------------------------------------------------------------------------------

    def _order(self, content: RackFile, then: Callback) -> None:
        """Have each worker serve its part of ``content``, and ``then`` go on."""
        parts: dict[int, set[str]] = {number: set() for number in self._processes}
        for name in content.sections:
            parts.setdefault(self._where[name], set()).add(name)
        self._awaited, self._then = set(parts), then
        for number, names in sorted(parts.items()):
            if number not in self._processes:
                self._processes[number] = WorkerProcess(
                    number,
                    self._loop,
                    self._told,
                    self._ended,
                    has_control=self._control is not None,
                )
            order = part_of(content, names).model_dump_json(by_alias=True, exclude={"control"})
            self._processes[number].tell(order)
        if not parts:
            self._loop.call_soon(then)

    def _told(self, process: WorkerProcess, event: dict[str, Any]) -> None:
        """A worker has told something."""
        kind = event["event"]
        if kind == READY:
            ports = [ToldPort(**each) for each in event["ports"]]
            self._ready[event["line"]] = event["devices"], ports
            self._failed.pop(event["line"], None)
        elif kind == SERVED:
            process.control_url = event["control"]
            self._settle(process.number)
        elif kind == WARNED:
            self._reporter.warn(event["message"])
        else:
            self._reporter.event(event)
            if kind == "line_failed":
                self._fail(event["line"], event["error"])

    def _settle(self, number: int) -> None:
        """The worker has done what it was to do, or has ended."""
        if number in self._awaited and not self._is_stopping:
            self._awaited.discard(number)
            if not self._awaited:
                self._then()

    def _ended(self, process: WorkerProcess, status: int) -> None:
        """A worker has ended; a negative status is the signal's."""
        del self._processes[process.number]
        self._reporter.has_lost |= status == EXIT_USAGE
        how = signal.Signals(-status).name if status < 0 else f"status {status}"
        if self._is_stopping:
            if status not in (0, EXIT_USAGE):
                self._reporter.lose(f"worker {process.number} has ended by itself ({how})")
            if not self._processes:
                self._loop.stop()
            return
        error = f"worker {process.number} has ended ({how}); SIGHUP begins it again"
        for name, section in self._content.sections.items():
            if self._where[name] == process.number:
                self._lose(section, error)
        self._settle(process.number)
        self._end_if_all_failed()

    def _lose(self, section: Section, error: str) -> None:
        """Its worker has ended, because of which it fails if it has not failed before."""
        name, has_failed = section.name, section.name in self._failed
        self._ready.pop(name, None)
        self._failed.setdefault(name, error)
        line = self._workforce.lines.get(name)
        if line is not None:
            line = replace(line, worker=None, failure=self._failed[name])
            self._workforce.lines = {**self._workforce.lines, name: line}
        if has_failed:
            return
        self._reporter.event(failure_of(section, error))
        if line is not None and self._workforce.viewers is not None:
            self._workforce.viewers.line_failed(line)

    def _fail(self, line: str, error: str) -> None:
        self._failed[line] = error
        self._end_if_all_failed()

    def _end_if_all_failed(self) -> None:
        names = self._workforce.lines
        if names and not self._awaited and all(name in self._failed for name in names):
            self._end_because(list(self._failed.values())[-1])

    def _end_because(self, error: str) -> None:
        if not self._is_stopping:
            self.failure = error
            self.stop()

    # -- lines --------------------------------------------------------------------------------

    def _take_ready(self) -> list[str]:
        """Have those in the control API that are open now; which, in the order of the file."""
        lines = dict(self._workforce.lines)
        for name, (devices, ports) in self._ready.items():
            process = self._processes[self._where[name]]
            endpoints = tuple((port.kind, port.url) for port in ports)
            lines[name] = WorkedLine(name, tuple(devices), endpoints, process.worker)
        names = self._content.sections
        self._workforce.lines = {name: lines[name] for name in names if name in lines}
        return [name for name in names if name in self._ready]

    def _report_ready(self, names: list[str]) -> None:
        url = None if self._control is None else self._control.url
        for name in names:
            self._reporter.ready(*self._ready[name], url)
        self._ready = {}

    # -- end ----------------------------------------------------------------------------------

    def stop(self) -> None:
        """End all workers, and then the loop; a second time, at once."""
        if self._is_stopping:
            self.close()
            return
        self._is_stopping = True
        systemd.notify("STOPPING=1")
        for process in self._processes.values():
            process.stop()
        if not self._processes:
            self._loop.stop()
        self._loop.call_later(STOP_S, self.close)

    def close(self) -> None:
        """End what has not ended."""
        for process in tuple(self._processes.values()):
            process.kill()
