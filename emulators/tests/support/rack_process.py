"""``axistwin rack`` run by tests, as a process of its own, with events."""

import json
import signal
from pathlib import Path
from typing import Any

import psutil
from daemon_process import Daemon, daemon, invoke


def line_of(name: str, devices: str | list[str] = "mac23", **more: object) -> str:
    """A [[line]] with a pty called as itself."""
    keys = {"name": name, "devices": devices, "pty": f"./{name}", **more}
    return "[[line]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in keys.items())


def serve(folder: Path, text: str, workers: int = 1) -> Any:
    """A rack of ``text``, with events."""
    (folder / "rack.toml").write_text(text)
    options = ("--json", *(("--workers", str(workers)) if workers > 1 else ()))
    return daemon(folder, "rack.toml", *options, command="rack")


def ready(rack: Daemon, count: int) -> dict[str, dict[str, Any]]:
    """The ready events of so many devices."""
    events = [rack.event() for _ in range(count)]
    assert [event["event"] for event in events] == ["ready"] * count, events
    return {event["device"]: event for event in events}


def next_event(rack: Daemon, kind: str) -> dict[str, Any]:
    """The next one of that kind."""
    while (event := rack.event())["event"] != kind:
        pass
    return event


def workers_of(rack: Daemon) -> list[psutil.Process]:
    """In the order of their numbers, as far as none has been begun again."""
    return sorted(psutil.Process(rack.process.pid).children(), key=lambda each: each.pid)


def answers(link: Path, model: str = "mac23") -> bool:
    """Whether a ``model`` says where it is, when asked there."""
    return invoke("send", str(link), "--model", model, "position?").exit_code == 0


def reload(rack: Daemon, folder: Path, text: str) -> dict[str, Any]:
    """Replace the file and say so; what is reported at the end of it."""
    (folder / "rack.toml").write_text(text)
    rack.process.send_signal(signal.SIGHUP)
    while True:
        event = rack.event()
        if event["event"].startswith("reload"):
            return event
