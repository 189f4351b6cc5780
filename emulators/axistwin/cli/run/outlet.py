"""A descriptor that is written in a thread of its own: whoever has something to tell never waits.

A pipe that nobody reads, a terminal that is held by Ctrl-S and a disk that hangs stop only the
thread.  What waits for them is bounded.
"""

import os
import select
import threading
from collections import deque
from collections.abc import Callable


class Outlet:
    """Writes to ``fd``, which stays the caller's, what is ``put``: ``room_bytes`` of it may wait.

    on_failure: called in the thread, once, when it cannot be written any more.
    """

    def __init__(self, fd: int, room_bytes: int, on_failure: Callable[[OSError], None]) -> None:
        self._fd = fd
        self._room_bytes = room_bytes
        self._on_failure = on_failure
        self._waiting: deque[bytes] = deque()
        self._changed = threading.Condition()
        self._is_closing = self._has_failed = False
        self._thread: threading.Thread | None = None

    def put(self, data: bytes, patience_s: float = 0.0) -> bool:
        """Write ``data`` soon; False: there is no room, not even so much later.

        Nothing happens after a failure.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self._has_failed or len(data) <= self._room_bytes, patience_s
            )
            if self._has_failed:
                return True
            if len(data) > self._room_bytes:
                return False
            self._room_bytes -= len(data)
            self._waiting.append(data)
            self._changed.notify_all()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="axistwin-out", daemon=True)
            self._thread.start()
        return True

    def close(self, patience_s: float) -> bool:
        """End when all is written, or so much later; whether it is."""
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(patience_s)
        return self._thread is None or not self._thread.is_alive()

    def _run(self) -> None:
        try:
            while data := self._next():
                self._write(data)
        except OSError as error:
            with self._changed:
                self._has_failed = True
                self._waiting.clear()
                self._changed.notify_all()
            self._on_failure(error)

    def _next(self) -> bytes:
        """What has to be written next; nothing at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_closing)
            if not self._waiting:
                return b""
            data = self._waiting.popleft()
            self._room_bytes += len(data)
            self._changed.notify_all()
            return data

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            try:
                rest = rest[os.write(self._fd, rest) :]
            except BlockingIOError:  # whoever shares the descriptor has set it so
                select.select([], [self._fd], [])
