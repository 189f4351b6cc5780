"""A worker of a rack, as its front sees it: a process with a pipe to it, and one from it."""

from __future__ import annotations

import json
import os
import secrets
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from axistwin.control.front.workforce import Worker
from axistwin.control.token import TOKEN_VARIABLE
from axistwin.runtime.serving.loop import Loop

_CHUNK: Final = 64 * 1024

_KEPT_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What a terminal or systemd sends to all processes, and the front answers."""


class WorkerProcess:
    """Worker ``number``, in ``loop``.

    told: called with each event that it tells.  ended: called with its status, after the last one.
    """

    def __init__(
        self,
        number: int,
        loop: Loop,
        told: Callable[[WorkerProcess, dict[str, Any]], None],
        ended: Callable[[WorkerProcess, int], None],
        *,
        has_control: bool,
    ) -> None:
        self.number = number
        self.control_url: str | None = None
        self._loop, self._told, self._ended = loop, told, ended
        self._token = secrets.token_hex(16)
        self._output, told_at = os.pipe()
        try:
            self._process = self._begin(told_at, has_control)
        finally:
            os.close(told_at)
        assert self._process.stdin is not None
        self._input = self._process.stdin
        os.set_blocking(self._input.fileno(), False)
        os.set_blocking(self._output, False)
        self._life = os.pidfd_open(self._process.pid)
        self._waiting: deque[bytes] = deque()
        self._begun = b""
        loop.add_reader(self._output, self._read)
        loop.add_reader(self._life, self._look)

    def _begin(self, told_at: int, has_control: bool) -> subprocess.Popen[bytes]:
        environment = {**os.environ, TOKEN_VARIABLE: self._token}
        environment.pop("NOTIFY_SOCKET", None)  # the front speaks with systemd
        command = [sys.executable, "-P", "-m", "axistwin.cli.rack.worker", str(told_at)]
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _KEPT_SIGNALS)
        try:  # it keeps the mask that it is born with
            return subprocess.Popen(
                [*command, "--control"] if has_control else command,
                stdin=subprocess.PIPE,
                pass_fds=[told_at],
                env=environment,
                bufsize=0,
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    @property
    def worker(self) -> Worker | None:
        """Its control API, if there is one."""
        if self.control_url is None:
            return None
        return Worker(self.number, self.control_url.removeprefix("http://"), self._token)

    def tell(self, order: str) -> None:
        """Give it a line."""
        self._waiting.append(order.encode() + b"\n")
        self._write()

    def stop(self) -> None:
        """Let it end."""
        if not self._input.closed:
            self._loop.remove_writer(self._input)
            self._input.close()

    def kill(self) -> None:
        """End it."""
        self._process.kill()

    def _write(self) -> None:
        while self._waiting:
            data = self._waiting.popleft()
            try:
                written = os.write(self._input.fileno(), data)
            except BlockingIOError:
                written = 0
            except BrokenPipeError:  # it has ended, which is told soon
                self._waiting.clear()
                break
            if written < len(data):
                self._waiting.appendleft(data[written:])
                self._loop.add_writer(self._input, self._write)
                return
        self._loop.remove_writer(self._input)

    def _read(self) -> bool:
        """Take what it tells; whether there may be more."""
        try:
            data = os.read(self._output, _CHUNK)
        except BlockingIOError:
            return False
        if not data:
            self._loop.remove_reader(self._output)
            return False
        *lines, self._begun = (self._begun + data).split(b"\n")
        for line in lines:
            self._told(self, json.loads(line))
        return True

    def _look(self) -> None:
        """It has ended."""
        while self._read():
            pass
        self._loop.remove_reader(self._output)
        self._loop.remove_reader(self._life)
        self.stop()
        os.close(self._life)
        os.close(self._output)
        self._ended(self, self._process.wait())
