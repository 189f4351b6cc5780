"""What ``axistwin run`` tells: ready lines and events on stdout, warnings on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, cast

import click

from axistwin.cli.output import discard_stdout

if TYPE_CHECKING:
    from axistwin.runtime.any_twin import AnyTwin
    from axistwin.runtime.serving.base_server import Endpoint


def warn(message: str) -> None:
    """One line for people."""
    click.echo(f"axistwin: {message}", err=True)


def _wrong_rate(event: Mapping[str, object]) -> str:
    from axistwin.runtime.line import listening

    bauds = cast("Sequence[int]", event["module_bauds"])
    return f"a client sends at {event['baud']}, {listening(bauds)}: set its rate"


# Events that people are told too, and in which words.
_TOLD: Mapping[str, Callable[[Mapping[str, object]], str]] = {
    "wrong_rate": _wrong_rate,
    "client_mistake": lambda event: str(event["message"]),
    "overrun": lambda event: (
        "it does not read as fast as frames come and loses some from now on; nobody else does"
    ),
}


class Reporter:
    """Events on stdout: ready lines for people, or everything as JSON for programs."""

    def __init__(self, as_json: bool) -> None:
        self._as_json = as_json
        self.has_lost = False

    def lose(self, message: str, event: Mapping[str, object] | None = None) -> None:
        """Say that something asked for cannot be done any more; the exit status tells it too."""
        self.has_lost = True
        warn(message)
        if event is not None:
            self.event(event)

    def ready(self, twins: Sequence[AnyTwin], ports: Sequence[Endpoint]) -> None:
        """One event per device: clients can connect."""
        endpoints = [{"endpoint": port.kind, "url": port.url} for port in ports]
        for twin in twins:
            device = f"{twin.model}:{twin.address}"  # which may have been changed and stored
            if self._as_json:
                self.event(
                    {"event": "ready", "device": device, **endpoints[0], "endpoints": endpoints}
                )
            else:
                where = " ".join(f"{port.kind}={port.describe()}" for port in ports)
                self._say(f"ready {device} {where}")

    def event(self, event: Mapping[str, object]) -> None:
        """Tell one event; people are only told when clients can connect, and what goes wrong."""
        in_words = _TOLD.get(str(event["event"]))
        if in_words is not None:
            warn(f"{event['url']}: {in_words(event)}")
        if self._as_json:
            now = datetime.now().astimezone().isoformat(timespec="milliseconds")
            self._say(json.dumps({"event": event["event"], "time": now, **event}))

    def _say(self, text: str) -> None:
        """Whoever started us may have stopped listening, which is no reason to end."""
        try:
            sys.stdout.write(text + "\n")
            sys.stdout.flush()
        except OSError as error:
            discard_stdout()
            if not isinstance(error, BrokenPipeError):
                self.lose(
                    f"standard output cannot be written ({error.strerror}); nothing more is told "
                    "there, the modules go on"
                )
