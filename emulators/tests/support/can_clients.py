"""What the tests of the CAN ports share: any frame, and a client's end on a pty or on TCP."""

import os
import pty
import selectors
import socket
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Any

import can
from hypothesis import strategies as st

from axistwin.ports.dialect import CanDialect
from axistwin.wire.can_frame import EXTENDED_MAX, STANDARD_MAX, CanFrame

TIMEOUT_S = 20.0
"""For what must come; nothing waits that long unless it fails."""


@st.composite
def frames(draw: st.DrawFn) -> CanFrame:
    """Any frame, remote and extended ones included."""
    is_extended = draw(st.booleans())
    identifier = draw(st.integers(0, EXTENDED_MAX if is_extended else STANDARD_MAX))
    if draw(st.booleans()):
        return CanFrame(identifier, b"", is_extended, True, draw(st.integers(0, 8)))
    return CanFrame(identifier, draw(st.binary(max_size=8)), is_extended)


def message(frame: CanFrame) -> can.Message:
    """``frame`` as python-can's."""
    return can.Message(
        arbitration_id=frame.identifier,
        data=None if frame.is_remote else frame.data,
        dlc=frame.length,
        is_extended_id=frame.is_extended,
        is_remote_frame=frame.is_remote,
    )


def frame_of(received: can.Message | None) -> CanFrame:
    """python-can's message as ours."""
    assert received is not None, "nothing was received"
    data = b"" if received.is_remote_frame else bytes(received.data)
    return CanFrame(
        received.arbitration_id,
        data,
        received.is_extended_id,
        received.is_remote_frame,
        received.dlc,
    )


class ServedDialect:
    """A dialect with a client at its other end; ``frames`` are those that it gave to the bus."""

    def __init__(self, dialect: CanDialect, reader: int) -> None:
        self.dialect = dialect
        self.frames: SimpleQueue[CanFrame] = SimpleQueue()
        self._fd = reader
        self._lock = threading.Lock()
        self._stop, self._wake = os.pipe()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def next_frame(self) -> CanFrame:
        """The next frame that the client sends."""
        return self.frames.get(timeout=TIMEOUT_S)

    def deliver(self, frame: CanFrame, time_ns: int = 0) -> None:
        """Let the client hear ``frame``."""
        with self._lock:
            os.write(self._fd, self.dialect.deliver(frame, time_ns))

    def start(self) -> None:
        """Greet the client and listen to it."""
        os.write(self._fd, self.dialect.greeting())
        self._thread.start()

    def stop(self) -> None:
        """End; the descriptor stays the caller's."""
        os.write(self._wake, b"x")
        self._thread.join(TIMEOUT_S)
        assert not self._thread.is_alive()
        os.close(self._stop)
        os.close(self._wake)

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._fd, selectors.EVENT_READ)
            selector.register(self._stop, selectors.EVENT_READ)
            while True:
                ready = [key.fd for key, _ in selector.select()]
                if self._stop in ready or not self._serve():
                    return

    def _serve(self) -> bool:
        data = os.read(self._fd, 4096)
        with self._lock:
            for out in self.dialect.receive(data, 0):
                if isinstance(out, CanFrame):
                    self.dialect.sent()
                    self.frames.put(out)
                else:
                    os.write(self._fd, out)
        return bool(data) and not self.dialect.is_closing


@contextmanager
def on_pty(dialect: CanDialect) -> Iterator[tuple[ServedDialect, str]]:
    """``dialect`` behind a pty, and its name."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    served = ServedDialect(dialect, master)
    served.start()
    try:
        yield served, os.ttyname(slave)
    finally:
        served.stop()
        os.close(master)
        os.close(slave)


class Accepted(list[ServedDialect]):
    """Who has come; who asks for the first waits for it."""

    def __init__(self) -> None:
        super().__init__()
        self.is_filled = threading.Event()

    def __getitem__(self, index: Any) -> Any:
        assert self.is_filled.wait(TIMEOUT_S)
        return super().__getitem__(index)


@contextmanager
def on_tcp(dialect: CanDialect) -> Iterator[tuple[list[ServedDialect], int]]:
    """``dialect`` on the loopback for one client."""
    served = Accepted()
    connections: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def accept() -> None:
            connection, _ = server.accept()
            connections.append(connection)
            served.append(ServedDialect(dialect, connection.fileno()))
            served.is_filled.set()
            served[0].start()

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        try:
            yield served, server.getsockname()[1]
        finally:
            thread.join(TIMEOUT_S)
            for one in served:
                one.stop()
            for connection in connections:
                connection.close()
