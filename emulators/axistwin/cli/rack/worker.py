"""A worker: a process that serves some lines of a rack for its front (``front``).

Rules
-----
1. On its standard input it gets what to serve, a rack file as JSON in one line, at any time again.
   Where that ends the worker does too, be it that the front closes it or has gone.
2. On a pipe it tells the front, as JSON, what there is to tell: ``READY`` of a line,
   ``SERVED`` when all is as it was to be, ``WARNED`` for people, and events for programs.
3. Signals are the front's, which keeps them from its workers.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

from axistwin.cli.output import EXIT_USAGE
from axistwin.cli.rack.file import ControlSection, RackFile
from axistwin.cli.rack.running import RackRunner, make_control
from axistwin.cli.run.reporter import Reporter
from axistwin.cli.run.serving import HostedLines

if TYPE_CHECKING:
    from axistwin.runtime.serving.base_server import Endpoint

READY: Final = "worker_ready"
SERVED: Final = "worker_served"
WARNED: Final = "worker_warned"

PATIENCE_S: Final = 30.0
"""How long what the front has to know waits for a front that does not read."""

_CHUNK = 64 * 1024


class WorkerReporter(Reporter):
    """Tells the front, which tells the user."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(as_json=True, descriptor=descriptor)

    def warn(self, message: str) -> None:
        """One line for people."""
        self._tell({"event": WARNED, "message": message}, 0.0)

    def event(self, event: Mapping[str, object], patience_s: float = 0.0) -> None:
        """One event; the front has the words for it."""
        self._tell(event, patience_s)

    def ready(
        self, devices: Sequence[str], ports: Sequence[Endpoint], control: str | None = None
    ) -> None:
        """Clients can connect to these devices of a line."""
        told = [
            {
                "kind": port.kind,
                "url": port.url,
                "text": port.describe(),
                "device_index": getattr(port, "device_index", None),
            }
            for port in ports
        ]
        line = devices[0].partition("@")[2]
        self._tell({"event": READY, "line": line, "devices": devices, "ports": told}, PATIENCE_S)


class _Orders:
    """What the front wants to be served, as it comes."""

    def __init__(self, runner: RackRunner, lines: HostedLines, control_url: str | None) -> None:
        self._runner, self._lines, self._control_url = runner, lines, control_url
        self._begun = b""
        self._is_first = True

    def read(self) -> None:
        """Do what has come."""
        data = os.read(0, _CHUNK)
        if not data:
            self._lines.rack.request_stop()
        *orders, self._begun = (self._begun + data).split(b"\n")
        for order in orders:
            reloaded = self._runner.serve(RackFile.model_validate_json(order))
            if self._is_first:
                self._runner.warn_of_surprises()
                self._is_first = False
            event = {"event": SERVED, "control": self._control_url, **reloaded._asdict()}
            self._lines.reporter.event(event, PATIENCE_S)


def main(pipe: int, has_control: bool) -> int:
    """Serve what the front wants until it wants nothing more; tell it on ``pipe``."""
    os.set_inheritable(pipe, False)
    with contextlib.closing(WorkerReporter(pipe)) as reporter:
        with contextlib.closing(HostedLines(reporter)) as lines, contextlib.ExitStack() as beside:
            lines.rack.ends_with_last = False
            control = None
            if has_control:
                control = make_control(lines.rack, ControlSection(address="127.0.0.1:0"))
                beside.callback(control.close)
                control.open()
            orders = _Orders(RackRunner("", lines), lines, None if control is None else control.url)
            lines.rack.loop.add_reader(0, orders.read)
            lines.serve(control, lambda: None)
        return EXIT_USAGE if reporter.has_lost else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), has_control="--control" in sys.argv))
