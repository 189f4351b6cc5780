"""``axistwin`` run by tests: in this process, or as a process of its own."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import IO, Any

from click.testing import CliRunner, Result

from axistwin.cli.program import main

TIMEOUT_S = 30.0


def invoke(*arguments: str) -> Result:
    """The program run in this process."""
    return CliRunner().invoke(main, arguments)


def talk(link: str, model: str, *texts: str) -> Result:
    """``axistwin send``, with the patience that a busy machine needs."""
    return invoke("send", link, "--model", model, "--timeout", f"{TIMEOUT_S}", *texts)


def assert_one_clear_line(result: Result, *parts: str) -> None:
    """Exit status 2, and one line on stderr that has all ``parts``."""
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("axistwin: ")
    for part in parts:
        assert part in lines[0]


class Daemon:
    """``axistwin run``, or another command that serves, as a process of its own in ``folder``."""

    def __init__(
        self,
        folder: Path,
        *arguments: str,
        environment: dict[str, str] | None = None,
        program: tuple[str, ...] = ("-m", "axistwin"),
        command: str = "run",
        stdout: int | IO[str] = subprocess.PIPE,
    ):
        self.folder = folder
        self.process = subprocess.Popen(
            [sys.executable, *program, command, *arguments],
            cwd=folder,
            env={**os.environ, **(environment or {})},
            stdout=stdout,
            stderr=subprocess.PIPE,
            text=True,
        )

    def line(self) -> str:
        """The next line on stdout."""
        assert self.process.stdout is not None
        return self.process.stdout.readline().rstrip("\n")

    def event(self) -> dict[str, Any]:
        """The next line as JSON."""
        event = json.loads(self.line())
        assert isinstance(event, dict)
        age = datetime.now().astimezone() - datetime.fromisoformat(event.pop("time"))
        assert abs(age.total_seconds()) < TIMEOUT_S
        return event

    def end(self, number: signal.Signals = signal.SIGTERM) -> tuple[int, str, str]:
        """Status, rest of stdout, and stderr after a signal."""
        self.process.send_signal(number)
        out, err = self.process.communicate(timeout=TIMEOUT_S)
        return self.process.returncode, out, err


@contextlib.contextmanager
def daemon(folder: Path, *arguments: str, **options: Any) -> Iterator[Daemon]:
    """A daemon that is gone afterwards, whatever happens."""
    daemon = Daemon(folder, *arguments, **options)
    try:
        yield daemon
    finally:
        if daemon.process.poll() is None:
            daemon.process.kill()
        daemon.process.communicate()
