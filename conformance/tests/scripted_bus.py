"""Peers on a CAN bus for tests: one that follows a script in a thread, and a bus of no time."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence

import can

from axistwin_conformance.transport.can_frame import Frame

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
        self._script, self.delay_ns = script, delay_ns
        self._coming: deque[tuple[int, Frame]] = deque()

    def schedule(self, at_ns: int, frame: Frame) -> None:
        """Say a frame at that time."""
        self._coming = deque(sorted([*self._coming, (at_ns, frame)], key=lambda one: one[0]))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Take a frame; no time passes."""
        self.sent.append(frame_of(msg))
        for reply in self._script(self.sent[-1]):
            self.schedule(self.virtual_time_ns + self.delay_ns, reply)

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


# --- on a bus in real time: a module that goes wrong, a bus that does -----------------------------

TICK_S = 0.001
Moment = Callable[[int, Frame, Frame | None], bool]  # how many before, this request, the one before


def after(count: int) -> Moment:
    """From the request of that number on."""
    return lambda asked, frame, before: asked >= count


def behind(index: int) -> Moment:
    """From the request on that follows the first download of that index."""
    return lambda asked, frame, before: (
        before is not None and before.data[:2] == bytes([0x23, index])
    )


class TurningModule:
    """The built-in twin on python-can's in-process bus up to a moment, then something else.

    `script`: its answers from then on.  `others`: sent all the time, by somebody else, `rate_hz`
    of them per second.
    """

    def __init__(
        self, channel: str, moment: Moment, script: Script, others: Sequence[Frame] = (),
        rate_hz: int = 0,
    ) -> None:  # fmt: skip
        self.turned_at: float | None = None  # time.monotonic() of that moment
        self.said_by_others = 0
        self._moment, self._script = moment, script
        self._others, self._rate_hz = others, rate_hz
        self._asked = 0
        self._before: Frame | None = None
        self._twin = can.Bus(f"mac23-can:1?time=real&bus={channel}", "axistwin", ignore_config=True)
        self._bus = can.Bus(channel, "virtual", ignore_config=True)
        self._far = can.Bus(channel, "virtual", ignore_config=True)  # where the others are
        self._ends = threading.Event()
        self._threads = [
            threading.Thread(target=self._serve, daemon=True),
            threading.Thread(target=self._chatter, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Leave the bus."""
        self._ends.set()
        for thread in self._threads:
            thread.join()
        for bus in (self._bus, self._far, self._twin):
            bus.shutdown()

    def _serve(self) -> None:
        while not self._ends.is_set():
            message = self._bus.recv(TICK_S)
            if message is not None and message.arbitration_id & 0x780 in (0x080, 0x600):
                self._hear(frame_of(message))
            while (reply := self._twin.recv(0)) is not None:
                if self.turned_at is None:
                    self._bus.send(reply)

    def _hear(self, frame: Frame) -> None:
        if self.turned_at is None and self._moment(self._asked, frame, self._before):
            self.turned_at = time.monotonic()
        self._asked, self._before = self._asked + 1, frame
        if self.turned_at is None:
            self._twin.send(message_of(frame))
        else:
            for reply in self._script(frame):
                self._bus.send(message_of(reply))

    def _chatter(self) -> None:
        begun_at = time.monotonic()
        while self._others and not self._ends.is_set():
            due = int((time.monotonic() - begun_at) * self._rate_hz)
            while self.said_by_others < due:
                frame = self._others[self.said_by_others % len(self._others)]
                self._far.send(message_of(frame))
                self.said_by_others += 1
            time.sleep(0.002)


class FailingBus:
    """A bus of python-can that fails from a moment on, as adapters do: `error` is raised by what
    `where` names; if `is_noisy`, frames are spoilt from then on, and error frames tell so."""

    def __init__(
        self, bus: can.BusABC, moment: Moment, error: Exception | None, where: tuple[str, ...],
        *, is_noisy: bool = False,
    ) -> None:  # fmt: skip
        self.turned_at: float | None = None
        self._bus, self._moment, self._error = bus, moment, error
        self._where, self._is_noisy = where, is_noisy
        self._asked = 0
        self._before: Frame | None = None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send it while all is well."""
        frame = frame_of(msg)
        if self.turned_at is None and self._moment(self._asked, frame, self._before):
            self.turned_at = time.monotonic()
        self._asked, self._before = self._asked + 1, frame
        self._fail("send")
        if self.turned_at is None or not self._is_noisy:
            self._bus.send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """What comes, or an error frame."""
        self._fail("recv")
        message = self._bus.recv(timeout)
        if message is None and timeout and self.turned_at is not None and self._is_noisy:
            return can.Message(is_error_frame=True, arbitration_id=0x08, data=bytes(8))
        return message

    def shutdown(self) -> None:
        """Close it."""
        self._bus.shutdown()

    def _fail(self, doing: str) -> None:
        if self.turned_at is not None and doing in self._where and self._error is not None:
            raise self._error
