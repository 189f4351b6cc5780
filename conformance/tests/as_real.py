"""The built-in twin as the suite meets a real device: a port it knows nothing of, in a time that it
takes for the real one, though it is virtual and an hour of it takes seconds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import serial

from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.plan import Options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport

PORT = "/dev/ttyUSB0"


class RealTarget(SerialTransport):
    """A target in virtual time of which nobody but itself knows that it is."""

    def __init__(self, port: Any, description: str) -> None:
        self._at_work = 1
        super().__init__(port, description)
        self.is_lossless = False
        self._at_work = 0

    @contextmanager
    def _working(self) -> Iterator[None]:
        self._at_work += 1
        try:
            yield
        finally:
            self._at_work -= 1

    @property
    def is_virtual(self) -> bool:
        """True where it makes time pass, False to everybody else."""
        return self._at_work > 0

    @is_virtual.setter
    def is_virtual(self, value: bool) -> None:
        """What the port is, is known."""

    @property
    def now_ns(self) -> int:
        """The twin's clock."""
        with self._working():
            return super().now_ns

    def receive(self, count: int, timeout_s: float) -> bytes:
        """See `SerialTransport`."""
        with self._working():
            return super().receive(count, timeout_s)

    def wait(self, seconds: float) -> float:
        """See `SerialTransport`."""
        with self._working():
            return super().wait(seconds)

    def _read(self, count: int, left_ns: int) -> bool:
        with self._working():
            return super()._read(count, left_ns)


def real_options(*words: str, **given: Any) -> Options:
    """What is asked of a MAC23 on a real port that may move and be written to."""
    asked = {"level": "quick", "allow": "motion,stored", **given}
    return make_options(model="mac23", port=PORT, ids=words, **asked)


def judge_as_real(
    options: Options, query: str = "", port: Callable[[Any], Any] = lambda port: port
) -> Result:
    """Judge a twin made with these words in its URL as if it were a real device."""
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    url = options.family.twin_url(options.model, options.address, options.neighbours) + query

    def open_real(neighbours: tuple[int, ...]) -> SerialTransport:
        return RealTarget(port(serial.serial_for_url(url, baudrate=38400)), PORT)

    return Engine(options, open_real).run(lambda event: None)
