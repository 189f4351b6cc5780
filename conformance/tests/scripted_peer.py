"""A device on a real pty that a test scripts: a sound one up to a moment, then something else."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import serial

from axistwin_conformance.transport.serial import TWIN_HANDLER

TICK_S = 0.002
CHUNK = 4096
Answers = Callable[[bytes], bytes]
Moment = Callable[["Peer", bytes], bool]  # is this request the first one that goes wrong?


def after(count: int) -> Moment:
    """From the request of that number on."""
    return lambda peer, data: peer.asked >= count


def at(index: int) -> Moment:
    """From the first frame with that index on, which is not answered well any more."""
    return lambda peer, data: data[6:8] == b"%02X" % index


def behind(index: int) -> Moment:
    """From the frame on that follows the first one with that index."""
    return lambda peer, data: peer.before[6:8] == b"%02X" % index


@dataclass
class Peer:
    """What sits at the far end of the pty.

    `answers`: its replies from `moment` on; None closes the port then.  `floods`: sent all the time
    from then on.  `spacing_s`: between the bytes of what the sound device says; `spoils`: what
    becomes of that on its way.
    """

    moment: Moment
    answers: Answers | None
    model: str = "mac23"
    floods: bytes = b""
    spacing_s: float = 0.0
    spoils: Answers = field(default=lambda data: data)
    spoilt: int = 0
    asked: int = 0
    before: bytes = b""
    turned_at: float | None = None  # time.monotonic() of that moment
    name: str = ""
    is_over: threading.Event = field(default_factory=threading.Event)
    _master: int = -1

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        """Serve the pty under `name`."""
        if TWIN_HANDLER not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append(TWIN_HANDLER)
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        port = serial.serial_for_url(f"axistwin://{self.model}:0?time=real", baudrate=38400)
        thread = threading.Thread(target=self._serve, args=(port,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            self.is_over.set()
            thread.join(10)
            port.close()
            self._close()

    def _serve(self, port: Any) -> None:
        while not self.is_over.is_set() and self._master >= 0:
            select.select([self._master], [], [], TICK_S)
            with contextlib.suppress(OSError):  # nobody has it open, or nothing is there
                self._hear(os.read(self._master, CHUNK), port)
            if self.turned_at is None:
                self._hand_on(port.read(port.in_waiting))
            elif self.floods:
                self._say(self.floods)
            time.sleep(TICK_S)

    def _hear(self, data: bytes, port: Any) -> None:
        if self.turned_at is None and self.moment(self, data):
            self.turned_at = time.monotonic()
        self.asked, self.before = self.asked + 1, data
        if self.turned_at is None:
            port.write(data)
        elif self.answers is None:
            self._close()
        else:
            self._say(self.answers(data))

    def _hand_on(self, data: bytes) -> None:
        arrives = self.spoils(data) if data else data
        self.spoilt += arrives != data
        self._say(arrives)

    def _say(self, data: bytes) -> None:
        pieces = [bytes([one]) for one in data] if self.spacing_s else [data] if data else []
        for piece in pieces:
            with contextlib.suppress(OSError):  # full: a flood is lost, as at a real UART
                os.write(self._master, piece)
            if self.spacing_s:
                time.sleep(self.spacing_s)

    def _close(self) -> None:
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
