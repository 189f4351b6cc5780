"""A line that sends everything back at once: what ``Server`` uses of ``Line``, to test ports."""

from collections.abc import Callable

from axistwin.kernel.time import Nanos
from axistwin.runtime.clock import PacedClock
from axistwin.runtime.transcript import Transcript
from axistwin.wire.framing import LineFormat

OWN_FORMAT = LineFormat(38400)


class EchoLine:
    """Sends back what it hears in its own format, and ``?`` per byte for any other.

    ``is_blocked``: keeps what is sent to it, as a line does that is slower than its host.
    """

    rate_mismatch = None
    twins = ()

    def __init__(self, line_format: LineFormat = OWN_FORMAT) -> None:
        self.own_format = line_format
        self.host_format = line_format
        self.formats: list[LineFormat] = []
        self.breaks: list[Nanos] = []
        self.clock = PacedClock()
        self.transcript = Transcript()
        self.is_volatile = True
        self.is_moving = False
        self.is_blocked = False
        self.heard = bytearray()
        self._queued = bytearray()
        self._answers = bytearray()
        self._callback: Callable[[], None] | None = None

    @property
    def device_format(self) -> LineFormat:
        """Its own."""
        return self.own_format

    @property
    def host_backlog(self) -> int:
        """Bytes kept."""
        return len(self._queued)

    @property
    def host_busy_ns(self) -> Nanos:
        """What the bytes kept would take."""
        return self.own_format.span_ns(len(self._queued))

    @property
    def has_news(self) -> bool:
        """Whether it has something to say."""
        return bool(self._answers)

    def next_event_ns(self) -> Nanos | None:
        """Nothing happens by itself."""
        return None

    def on_change(self, callback: Callable[[], None] | None) -> None:
        """Whom to tell."""
        self._callback = callback

    def subscribe_faults(self, subscriber: Callable[..., None]) -> Callable[[], None]:
        """Nothing goes wrong here."""
        return lambda: None

    def send(self, data: bytes) -> None:
        """Hear ``data``."""
        self.formats.append(self.host_format)
        right = self.host_format == self.own_format
        self._queued += data if right else b"?" * len(data)

    def receive(self) -> bytes:
        """Take what it has to say."""
        if not self.is_blocked:
            self.heard += self._queued
            self._answers += self._queued
            self._queued.clear()
        answers = bytes(self._answers)
        self._answers.clear()
        return answers

    def exchange(self, data: bytes) -> bytes:
        """Hear ``data``, and answer."""
        self.send(data)
        return self.receive()

    def purge_output(self) -> None:
        """Forget what was kept."""
        self._queued.clear()

    def send_break(self, duration_ns: Nanos) -> None:
        """Note it."""
        self.breaks.append(duration_ns)

    def speak(self, data: bytes) -> None:
        """Let a device send ``data``; from any thread."""
        self._answers += data
        assert self._callback is not None
        self._callback()

    def unblock(self) -> None:
        """Let what was kept go; from any thread."""
        self.is_blocked = False
        assert self._callback is not None
        self._callback()
