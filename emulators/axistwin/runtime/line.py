"""One serial line in any kind of time: the simulation of a network, and what went over it.

What holds for every simulation (time, storage, threads) is told in ``simulation``; here
is the host's end.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, cast

from axistwin.devices.base import UsbDevice
from axistwin.devices.traces import report_text
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.runtime.clock import Clock
from axistwin.runtime.network import SerialNetwork
from axistwin.runtime.simulation import Simulation, Station, earliest
from axistwin.runtime.storage import Stores
from axistwin.runtime.transcript import Burst, Direction, Message, MessageSubscriber, Transcript
from axistwin.wire.framing import LineFormat

REPORTS_KEPT: Final = 200

_FOREVER = 1 << 62


class Line(Simulation[SerialNetwork]):
    """The devices of ``stations`` on one line, which belongs to this object from now on.

    explain: turns bytes of the line into words for the transcript.
    Every method raises StateError once the storage has failed.
    """

    _noun = "line"

    GRANULARITY_NS: Nanos = 20 * NS_PER_MS
    """How long bytes of an endless stretch may wait before a server is woken for them."""

    def __init__(
        self,
        network: SerialNetwork,
        clock: Clock,
        storage: Stores,
        stations: Sequence[Station],
        *,
        explain: Callable[[bytes], str] | None = None,
    ) -> None:
        self.transcript = Transcript()
        self._explain = explain
        self._seen_bytes = 0
        self._reports: deque[Message] = deque(maxlen=REPORTS_KEPT)
        self._report_subscribers: list[MessageSubscriber] = []
        super().__init__(network, clock, storage, stations)

    # -- time ---------------------------------------------------------------------------------

    def _note_readable(self) -> bool:
        seen, self._seen_bytes = self._seen_bytes, self._network.host_available
        return self._seen_bytes > seen

    def next_event_ns(self) -> Nanos | None:
        """When ``sync`` should be called next; None: not before something changes.

        Bytes for the host count when their stretch is complete, or after ``GRANULARITY_NS``.
        """
        with self._lock:
            network = self._network
            if network.is_silent:
                return network.next_wake()
            patience = network.host_format.characters_within(self.GRANULARITY_NS)
            return network.next_event(max(1, patience))

    def _pass_time(self, until_ns: Nanos) -> Nanos:
        return self.wait(until_ns, count=None)

    def wait(
        self,
        until_ns: Nanos | None,
        count: int | None = 1,
        *,
        stop: Callable[[], bool] = lambda: False,
    ) -> Nanos:
        """Let time pass until ``count`` bytes can be received (None: whatever comes) or until then.

        Returns the present time.  It may return earlier: after ``wake``, when ``stop()``, asked
        before every sleep, is true (set what it asks for and then call ``wake``), and in virtual
        time without ``until_ns`` when nothing will ever happen by itself.
        """
        network, clock = self._network, self.clock
        with self._changed:
            wakes = self._wakes
            while True:
                now = self._sync()
                missing = _FOREVER if count is None else count - network.host_available
                if (
                    missing <= 0
                    or self._wakes != wakes
                    or (until_ns is not None and now >= until_ns)
                    or stop()
                ):
                    return now
                if clock.is_shared:
                    self._sleep(earliest(network.next_event(missing), until_ns))
                    continue
                reached_ns = network.run_until_heard(count or _FOREVER, until_ns)
                if reached_ns == now:  # for ever
                    return now
                clock.advance_to(reached_ns)

    # -- the host's end -----------------------------------------------------------------------

    @property
    def host_format(self) -> LineFormat:
        """Rate and framing of the host's end; to be set at any time."""
        return self._network.host_format

    @host_format.setter
    def host_format(self, line_format: LineFormat) -> None:
        if line_format != self._network.host_format:
            with self.changing():
                self._network.host_format = line_format

    @property
    def device_format(self) -> LineFormat:
        """Rate and framing of the first device, as it is now."""
        return self._network.devices[0].line_format

    @property
    def rate_mismatch(self) -> tuple[int, tuple[int, ...]] | None:
        """The host's rate and the devices', if none of them understands it; else None."""
        network = self._network
        if network.is_host_understood:
            return None
        return network.host_format.baud, network.device_bauds

    def _rate_note(self) -> str:
        """What the transcript says of bytes sent now; nothing if the rates agree."""
        if self._network.is_host_understood:  # by far the most common
            return ""
        mismatch = self.rate_mismatch
        assert mismatch is not None
        return f"not understood: sent at {mismatch[0]}, {listening(mismatch[1])}"

    def send(self, data: bytes, backlog_max: int | None = None) -> int:
        """Send ``data`` from the host's end, behind what it still has to send.

        backlog_max: take only as many bytes as leave no more than this to be sent.
        Returns how many bytes were taken.
        """
        with self._lock:
            now = self._sync()
            if backlog_max is not None:
                data = data[: max(0, backlog_max - self._network.host_backlog)]
            self.transcript.add(now, "host", data, self._rate_note())
            self._network.host_send(data)
            self._tell()
            return len(data)

    def send_break(self, duration_ns: Nanos) -> None:
        """Hold the line in the space state from the host's end."""
        with self.changing():
            self._network.send_break(duration_ns)

    def receive(self, limit: int | None = None) -> bytes:
        """Take what has arrived at the host's end, at most ``limit`` bytes."""
        self.sync()
        if not self._network.host_available:
            return b""
        with self._lock:
            now = self._sync()
            data = self._network.host_take(limit)
            self._seen_bytes = self._network.host_available
            self.transcript.add(now, "device", data)
            return data

    def exchange(self, data: bytes) -> bytes:
        """``send`` and ``receive`` at the same time: for the one who keeps the alarm.

        It is not told by ``on_change``; whoever else waits is.
        """
        with self._lock:
            if self._failure is not None:
                raise self._failure
            network, now = self._network, self._now_ns()
            self.transcript.add(now, "host", data, self._rate_note())
            network.host_exchange(now, data)
            self._settle()
            if self._sleepers:
                self._changed.notify_all()
            if not self._seen_bytes:
                return b""
            answer = network.host_take()
            self._seen_bytes = 0
            self.transcript.add(now, "device", answer)
            return answer

    def ask(
        self, data: bytes, size: int, patience_ns: Nanos
    ) -> tuple[Nanos, bytes | None, Nanos] | None:
        """``send``, ``wait`` for ``size`` bytes, or so long, and ``receive``: all at once.

        Without ``data`` nothing is sent.
        Only in virtual time, where nobody looks on; the outcome is the same.  Returns when it was
        sent, what was received (None: that is still to be waited for), and the time reached.  None
        instead: nothing was done, not even sent.
        """
        if (
            self._on_change is not None
            or self._subscribers
            or self.clock.is_shared
            or not self._storage.is_volatile
        ):
            return None
        with self._lock:
            now, network = self.sync(), self._network
            answer = network.host_ask(data, size, now + patience_ns)
            began_ns = network.asked_ns
            if began_ns is None:
                return None
            if data:
                self.transcript.add(now, "host", data)
            if answer is None:
                return began_ns, None, now
            reached_ns = network.now_ns
            self.clock.advance_to(reached_ns)
            if network.has_effects:
                self._perform(network.take_effects())
            if answer:
                self.transcript.add(reached_ns, "device", answer)
            return began_ns, answer, reached_ns

    @property
    def upcoming(self) -> bytes:
        """What ``receive`` will give next, as far as that is certain; no time passes."""
        with self._lock:
            return self._network.host_upcoming

    @property
    def has_news(self) -> bool:
        """Whether ``receive`` would give something, even without looking at the clock."""
        return bool(self._network.host_available)

    @property
    def available(self) -> int:
        """How many bytes ``receive`` would give."""
        with self._lock:
            self.sync()
            return self._network.host_available

    @property
    def host_backlog(self) -> int:
        """How many bytes the host's end has still to send."""
        with self._lock:
            self.sync()
            return self._network.host_backlog

    @property
    def host_sent_ns(self) -> Nanos:
        """When the host's end will have sent everything."""
        with self._lock:
            self.sync()
            return self._network.host_sent_ns

    @property
    def host_busy_ns(self) -> Nanos:
        """How long the host's end still has to send, as it was at the last ``sync``."""
        with self._lock:
            return self._network.host_sent_ns - self._network.now_ns

    def purge_output(self) -> None:
        """Drop what the host's end has still to send."""
        with self.changing():
            self._network.host_purge_output()

    def usb_cable(self, index: int) -> "UsbCable":
        """The host's end of the cable to the USB port of device ``index``, which must have one."""
        return UsbCable(self, index, cast(UsbDevice, self._stations[index].device))

    # -- what was said ------------------------------------------------------------------------

    def subscribe_messages(self, subscriber: MessageSubscriber) -> Callable[[], None]:
        """Give every burst that is over from now on, and USB report, to ``subscriber``; see the
        base.
        """
        no_reports = self._added(self._report_subscribers, subscriber)
        with self._lock:
            unsubscribe = self.transcript.subscribe(lambda burst: subscriber(_message(burst)))

        def end() -> None:
            no_reports()
            with self._lock:
                unsubscribe()

        return end

    @property
    def messages(self) -> list[Message]:
        """The bursts of the transcript, and the last USB reports."""
        with self._lock:
            bursts = [_message(burst) for burst in self.transcript]
            if not self._reports:
                return bursts
            return sorted([*bursts, *self._reports], key=lambda message: message.time_ns)

    def keep_report(self, time_ns: Nanos, direction: Direction, report: bytes) -> None:
        """A host has sent a USB report, or read one."""
        content = report.rstrip(b"\0")
        message = Message(time_ns, direction, content, f"USB: {report_text(content)}")
        with self._lock:
            self._reports.append(message)
            for subscriber in tuple(self._report_subscribers):
                subscriber(message)

    def flush_messages(self, *, at_once: bool = False) -> None:
        """Have subscribers told of a burst to which nothing was added lately; see the base."""
        with self._lock:
            now = self.sync()
            if at_once:
                self.transcript.flush()
            else:
                self.transcript.flush_at(now)

    def explain(self, content: bytes) -> str:
        """What bytes of this line say; empty if nobody knows."""
        return self._explain(content) if self._explain else ""

    def render_transcript(self) -> str:
        """The transcript with every frame in words."""
        with self._lock:
            return self.transcript.render(self._explain)


def _message(burst: Burst) -> Message:
    return Message(burst.time_ns, burst.direction, bytes(burst.data), burst.note)


class UsbCable:
    """The host's end of the cable to ``device``, number ``index`` of ``line``: whole reports."""

    def __init__(self, line: Line, index: int, device: UsbDevice) -> None:
        self._line = line
        self._index = index
        self._device = device

    def send(self, report: bytes) -> None:
        """Let the device take an OUT report, without a report number, now."""
        self._line.note(f"USB > {report_text(report)}")
        self._line.keep_report(self._line.sync(), "host", report)
        self._line.act(self._index, lambda now: self._device.receive_report(now, report))

    @property
    def has_report(self) -> bool:
        """Whether ``receive`` would give something, even without looking at the clock."""
        return bool(self._device.reports)

    def receive(self) -> bytes | None:
        """Take the oldest IN report that has come by now."""
        with self._line.present() as now:
            reports = self._device.reports
            if not reports:
                return None
            self._line.keep_report(now, "device", reports[0])
            return reports.popleft()

    def wait(self, until_ns: Nanos | None, *, stop: Callable[[], bool]) -> Nanos:
        """``Line.wait`` until there is an IN report; returns the present time."""
        return self._line.wait(until_ns, None, stop=lambda: self.has_report or stop())


def listening(bauds: Sequence[int]) -> str:
    """At which rates the modules of a line listen, in words."""
    rates = " and ".join(map(str, bauds))
    return f"the module{'s listen' if len(bauds) > 1 else ' listens'} at {rates}"
