"""What ``axistwin run`` tells: ready lines and events on stdout, warnings on stderr.

Whoever does not read what is told stops nobody: from a bound on it is dropped, and counted.
"""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, cast

import click

from axistwin.cli.run.outlet import Outlet

if TYPE_CHECKING:
    from axistwin.runtime.serving.base_server import Endpoint


ROOM_BYTES = 64 * 1024
"""What waits for a reader of stdout or stderr, on top of what the kernel keeps."""

_FAREWELL_S = 1.0
"""How long the rest of what is told may take at the end."""


def warn(message: str) -> None:
    """One line for people, of the start; later ones go through the ``Reporter``."""
    click.echo(f"axistwin: {message}", err=True)


def _wrong_rate(event: Mapping[str, object]) -> str:
    from axistwin.runtime.line import listening

    bauds = cast("Sequence[int]", event["module_bauds"])
    return f"a client sends at {event['baud']}, {listening(bauds)}: set its rate"


# Events that people are told too, and in which words.
_TOLD: Mapping[str, Callable[[Mapping[str, object]], str]] = {
    "wrong_rate": _wrong_rate,
    "line_failed": lambda event: (
        f"has failed and is not served any more, others are: {event['error']}"
    ),
    "client_mistake": lambda event: str(event["message"]),
    "overrun": lambda event: (
        "it does not read as fast as frames come and loses some from now on; nobody else does"
    ),
}


class Reporter:
    """Events on stdout: ready lines for people, or everything as JSON for programs.

    From any thread, and without waiting.  descriptor: where, if not on stdout.
    """

    def __init__(self, as_json: bool, descriptor: int = 1) -> None:
        self._as_json = as_json
        self._lock = threading.Lock()
        self._stdout = Outlet(descriptor, ROOM_BYTES, self._lose_stdout)
        self._stderr = Outlet(2, ROOM_BYTES, lambda error: None)
        self._dropped = 0
        self.has_lost = False

    def lose(self, message: str, event: Mapping[str, object] | None = None) -> None:
        """Say that something asked for cannot be done any more; the exit status tells it too."""
        self.has_lost = True
        self.warn(message)
        if event is not None:
            self.event(event)

    def warn(self, message: str) -> None:
        """One line for people; dropped if they have not read many others."""
        self._stderr.put(_encoded(f"axistwin: {message}\n", sys.stderr.encoding))

    def ready(
        self, devices: Sequence[str], ports: Sequence[Endpoint], control: str | None = None
    ) -> None:
        """One event per device of a line, by its name: clients can connect.

        A reader who is behind is waited for, unless one has been in vain.  control: the URL of the
        control API.
        """
        for index, device in enumerate(devices):
            own = [port for port in ports if getattr(port, "device_index", None) in (None, index)]
            endpoints = [{"endpoint": port.kind, "url": port.url} for port in own]
            if self._as_json:
                event = {"device": device, **endpoints[0], "endpoints": endpoints}
                more = {} if control is None else {"control": control}
                self.event({"event": "ready", **event, **more}, self._patience_s())
            else:
                where = " ".join(f"{port.kind}={port.describe()}" for port in own)
                where += "" if control is None else f" control={control}"
                text = _encoded(f"ready {device} {where}\n", sys.stdout.encoding)
                self._dropped += not self._stdout.put(text, self._patience_s())

    def event(self, event: Mapping[str, object], patience_s: float = 0.0) -> None:
        """Tell one event; people are only told when clients can connect, and what goes wrong.

        patience_s: how long to wait for a reader who is behind before it is dropped.
        """
        in_words = _TOLD.get(str(event["event"]))
        if in_words is not None:
            self.warn(f"{event.get('url') or event['line']}: {in_words(event)}")
        if self._as_json:
            self._tell(event, patience_s)

    def close(self) -> None:
        """Tell what is left, as far as somebody reads it."""
        self._stdout.close(_FAREWELL_S)
        self._stderr.close(_FAREWELL_S)

    def stopped(self) -> None:
        """The run ends."""
        self.event({"event": "stopped"}, _FAREWELL_S)

    def _patience_s(self) -> float:
        return 0.0 if self._dropped else _FAREWELL_S

    def _tell(self, event: Mapping[str, object], patience_s: float) -> None:
        with self._lock:
            if self._dropped:
                loss = {"event": "events_dropped", "count": self._dropped}
                self._dropped *= not self._put(loss, patience_s)
            if self._dropped or not self._put(event, patience_s):
                self._dropped += 1

    def _put(self, event: Mapping[str, object], patience_s: float) -> bool:
        now = datetime.now().astimezone().isoformat(timespec="milliseconds")
        text = json.dumps({"event": event["event"], "time": now, **event})
        return self._stdout.put(text.encode("ascii") + b"\n", patience_s)

    def _lose_stdout(self, error: OSError) -> None:
        """Whoever started us may have stopped listening, which is no reason to end."""
        if not isinstance(error, BrokenPipeError):
            self.lose(
                f"standard output cannot be written ({error.strerror}); nothing more is told "
                "there, the modules go on"
            )


def _encoded(text: str, encoding: str) -> bytes:
    """``text`` for a reader; names of files that are no text come out as they are."""
    try:
        return text.encode(encoding, "surrogateescape")
    except UnicodeEncodeError:
        return text.encode(encoding, "backslashreplace")
