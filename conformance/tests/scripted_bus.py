"""Peers on a CAN bus for tests: one that follows a script in a thread, and a bus of no time."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable

import can

from axistwin_conformance.can_frame import Frame

Script = Callable[[Frame], Iterable[Frame]]
LISTEN_S = 0.05


def message_of(frame: Frame) -> can.Message:
    """A frame as python-can has it."""
    return can.Message(
        arbitration_id=frame.identifier,
        data=frame.data,
        dlc=frame.length,
        is_extended_id=frame.is_extended,
        is_remote_frame=frame.is_remote,
    )


def frame_of(message: can.Message) -> Frame:
    """The same the other way round."""
    if message.is_remote_frame:
        return Frame(message.arbitration_id, b"", message.is_extended_id, True, message.dlc)
    return Frame(message.arbitration_id, bytes(message.data), message.is_extended_id)


class ScriptedPeer:
    """A node on python-can's in-process bus that answers each frame as its script says."""

    def __init__(self, channel: str, script: Script) -> None:
        self.heard: list[Frame] = []
        self._script = script
        self._bus = can.Bus(channel, "virtual", ignore_config=True)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def say(self, frame: Frame) -> None:
        """Send unasked."""
        self._bus.send(message_of(frame))

    def close(self) -> None:
        """Leave the bus."""
        self._ends.set()
        self._thread.join()
        self._bus.shutdown()

    def _run(self) -> None:
        while not self._ends.is_set():
            message = self._bus.recv(LISTEN_S)
            if message is not None:
                self.heard.append(frame_of(message))
                for reply in self._script(self.heard[-1]):
                    self.say(reply)


class VirtualBus:
    """A bus in virtual time, with a script behind it: each reply is there `delay_ns` later.

    `schedule(at_ns, frame)`: what is said unasked.
    """

    def __init__(self, script: Script = lambda frame: (), delay_ns: int = 1_000_000) -> None:
        self.virtual_time_ns = 0
        self.sent: list[Frame] = []
        self.is_open = True
        self._script, self._delay_ns = script, delay_ns
        self._coming: deque[tuple[int, Frame]] = deque()

    def schedule(self, at_ns: int, frame: Frame) -> None:
        """Say a frame at that time."""
        self._coming = deque(sorted([*self._coming, (at_ns, frame)], key=lambda one: one[0]))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Take a frame; no time passes."""
        self.sent.append(frame_of(msg))
        for reply in self._script(self.sent[-1]):
            self.schedule(self.virtual_time_ns + self._delay_ns, reply)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Let time pass up to the next frame, or up to the time-out."""
        assert timeout is not None
        until_ns = self.virtual_time_ns + round(timeout * 1e9)
        if self._coming and self._coming[0][0] <= until_ns:
            at_ns, frame = self._coming.popleft()
            self.virtual_time_ns = max(self.virtual_time_ns, at_ns)
            return message_of(frame)
        self.virtual_time_ns = until_ns
        return None

    def shutdown(self) -> None:
        """Close."""
        self.is_open = False
