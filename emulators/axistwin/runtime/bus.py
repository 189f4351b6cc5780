"""One CAN bus in any kind of time: the simulation of a network of devices and host ports.

What holds for every simulation (time, storage, threads) is told in ``simulation``; here
are the ports, and what was on the bus.

- A port hears what is on the bus while it is attached, in one order with everybody else.
- Lifebeats go on for ever; at a speed at which they come faster than they can be computed, time
  passes as fast as it can.
- ``transcript``: the last frames with their times, whoever sent them; ``subscribe_frames`` gives
  all of them to a recording.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, TypeAlias

from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.runtime.can_network import Arrival, CanNetwork, ErrorReport
from axistwin.runtime.clock import Clock
from axistwin.runtime.simulation import Simulation, Station, earliest
from axistwin.runtime.storage import Stores
from axistwin.runtime.transcript import Message, MessageSubscriber
from axistwin.wire.can_bus import ControllerState
from axistwin.wire.can_frame import CanFrame

TRANSCRIPT_FRAMES: Final = 1000


class Passed(NamedTuple):
    """A frame that was complete at ``end_ns``; ``from_host``: a port sent it.

    senders: numbers of those who sent it, all at once: of devices, then of ports.
    """

    end_ns: Nanos
    frame: CanFrame
    from_host: bool
    senders: tuple[int, ...]


FrameSubscriber: TypeAlias = Callable[[Passed], None]


class Bus(Simulation[CanNetwork]):
    """The devices of ``stations`` on one bus, which belongs to this object from now on.

    explain: turns a frame into words for the transcript.
    Every method raises StateError once the storage has failed.
    """

    _noun = "bus"

    def __init__(
        self,
        network: CanNetwork,
        clock: Clock,
        storage: Stores,
        stations: Sequence[Station],
        *,
        explain: Callable[[CanFrame], str] | None = None,
    ) -> None:
        self.transcript: deque[Passed] = deque(maxlen=TRANSCRIPT_FRAMES)
        self._explain = explain
        self._frame_subscribers: list[FrameSubscriber] = []
        self._seen_arrivals = 0
        super().__init__(network, clock, storage, stations)

    @property
    def bitrate(self) -> int:
        """Bits per second."""
        return self._network.bitrate

    @property
    def is_paced(self) -> bool:
        """Whether frames take their time."""
        return self._network.is_paced

    # -- time ---------------------------------------------------------------------------------

    def _note_readable(self) -> bool:
        self._record()
        if self._network.long_span_ns:
            self.clock.keep_up(self._network.now_ns, self._network.long_span_ns)
        seen, self._seen_arrivals = self._seen_arrivals, self._network.arrivals_count
        return self._seen_arrivals > seen

    def _record(self) -> None:
        """Note what was on the bus, and tell those who record it."""
        devices = len(self._stations)
        for heard in self._network.take_heard():
            from_host = all(station >= devices for station in heard.senders)
            passed = Passed(heard.end_ns, heard.frame, from_host, heard.senders)
            self.transcript.append(passed)
            for subscriber in tuple(self._frame_subscribers):
                subscriber(passed)

    def next_event_ns(self) -> Nanos | None:
        """When ``sync`` should be called next; None: not before something changes."""
        with self._lock:
            return self._network.next_event()

    def _pass_time(self, until_ns: Nanos) -> Nanos:
        return self.wait(until_ns)

    def wait(
        self,
        until_ns: Nanos | None,
        port: int | None = None,
        *,
        stop: Callable[[], bool] = lambda: False,
    ) -> Nanos:
        """Let time pass until ``port`` has something to receive (None: whatever comes) or until.

        Returns the present time.  It may return earlier: after ``wake``, when ``stop()``, asked
        before every sleep, is true (set what it asks for and then call ``wake``), and in virtual
        time without ``until_ns`` when nothing will ever happen by itself.
        """
        network, clock = self._network, self.clock
        with self._changed:
            wakes = self._wakes
            while True:
                now = self._sync()
                if (
                    stop()
                    or self._wakes != wakes
                    or (until_ns is not None and now >= until_ns)
                    or (port is not None and network.host_has_news(port))
                ):
                    return now
                if clock.is_shared:
                    self._sleep(earliest(network.next_event(), until_ns))
                    continue
                if until_ns is None and network.next_event() is None:
                    return now
                clock.advance_to(network.run_until_heard(port, until_ns))

    # -- the ports ----------------------------------------------------------------------------

    def attach(
        self, *, hears_own: bool = False, hears_errors: bool = False, acknowledges: bool = True
    ) -> int:
        """A new port of a host, on the bus from now on; its number.

        hears_own: it gets its own frames too, when they have left.  hears_errors: see
        ``receive_all``.  acknowledges: see ``set_acknowledging``.
        """
        with self.changing():
            return self._network.attach(
                hears_own=hears_own, hears_errors=hears_errors, acknowledges=acknowledges
            )

    def set_acknowledging(self, port: int, *, acknowledges: bool) -> None:
        """Whether a port acknowledges the frames of others."""
        with self.changing():
            self._network.set_acknowledging(port, acknowledges=acknowledges)

    def detach(self, port: int) -> None:
        """Take a port off the bus; waits under way return."""
        with self.changing():
            self._network.detach(port)
        self.wake()

    def send(self, port: int, frame: CanFrame) -> None:
        """Send ``frame`` from ``port``, behind what it still has to send."""
        with self._lock:
            self._sync()
            self._network.host_send(port, frame)
            self._tell()

    def receive(self, port: int, limit: int | None = None) -> list[Arrival]:
        """Take what has arrived at ``port``, at most ``limit`` frames."""
        with self._lock:
            self._sync()
            return self._network.host_take(port, limit)

    def has_news(self, port: int) -> bool:
        """Whether ``receive_all`` would take something."""
        with self._lock:
            return self._network.host_has_news(port)

    def receive_all(self, port: int) -> tuple[list[Arrival], list[ErrorReport]]:
        """Take what has arrived at ``port``, and what its controller has to report.

        Reports are of failed frames, and of the controller's own states.  The clock is not looked
        at: all as it was at the last ``sync``, or whatever else pushed time.
        """
        with self._lock:
            if self._failure is not None:
                raise self._failure
            network = self._network
            if not network.host_has_news(port):
                return [], []
            return network.host_take(port), network.host_take_errors(port)

    def backlog(self, port: int) -> int:
        """How many frames ``port`` has still to send, one under way included.

        As ``receive_all``, without looking at the clock.
        """
        with self._lock:
            return self._network.host_backlog(port)

    def purge_output(self, port: int) -> None:
        """Forget what ``port`` has still to send; a frame under way is not tried again."""
        with self.changing():
            self._network.host_purge_output(port)

    def dropped(self, port: int) -> int:
        """How many frames were lost to ``port`` because it was not read."""
        with self._lock:
            return self._network.host_dropped(port)

    def controller(self, port: int) -> ControllerState:
        """State of the controller of ``port``: active, passive or off."""
        with self._lock:
            self._sync()
            return self._network.host_state(port)

    def counters(self, port: int) -> tuple[int, int]:
        """Transmit and receive error counter of the controller of ``port``."""
        with self._lock:
            self._sync()
            return self._network.host_counters(port)

    # -- what was on the bus ------------------------------------------------------------------

    def subscribe_frames(self, subscriber: FrameSubscriber) -> Callable[[], None]:
        """Give every frame from now on to ``subscriber``; call what is returned to end that.

        It is called in any thread, with the bus locked, and must not wait.
        """
        return self._added(self._frame_subscribers, subscriber)

    def subscribe_messages(self, subscriber: MessageSubscriber) -> Callable[[], None]:
        """Give every frame from now on to ``subscriber``; see the base."""
        return self.subscribe_frames(lambda passed: subscriber(_message(passed)))

    @property
    def messages(self) -> list[Message]:
        """The frames of the transcript."""
        with self._lock:
            return [_message(passed) for passed in self.transcript]

    def explain(self, content: CanFrame) -> str:
        """What a frame says; empty if nobody knows."""
        return self._explain(content) if self._explain else ""

    def render_transcript(self) -> str:
        """The last frames: time in ms, ``>`` from a host or ``<`` to it, frame, meaning."""
        with self._lock:
            return "\n".join(self._rendered(each) for each in self.transcript)

    def _rendered(self, passed: Passed) -> str:
        arrow = ">" if passed.from_host else "<"
        meaning = self._explain(passed.frame) if self._explain else ""
        time_ms = passed.end_ns / NS_PER_MS
        return f"{time_ms:12.3f} ms {arrow} {passed.frame!s:20}  {meaning}".rstrip()


def _message(passed: Passed) -> Message:
    return Message(passed.end_ns, "host" if passed.from_host else "device", passed.frame)
