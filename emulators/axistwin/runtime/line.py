"""One line in any kind of time: the owner of a network, its clock, its storage and its transcript.

Rules
-----
1. Whoever looks, pushes time first: every method runs the network up to the clock's present time.
2. What the devices want stored is written, in their order, before a byte that came after it can be
   read.  When it cannot be written, nothing can be read any more: the error is raised, again and
   again, since an acknowledgement would be a lie.
3. Before bytes are given to the host while an axis moves, its position is saved too: whatever the
   host was told outlives a kill.
4. Any thread may call anything.  ``on_change`` tells the one that keeps an alarm when the next
   event may have come nearer.
"""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from axistwin.devices.base import MotionSerialDevice
from axistwin.errors import StateError
from axistwin.kernel.effects import Effect, Store, Trace
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.runtime.clock import Clock
from axistwin.runtime.network import SerialNetwork
from axistwin.runtime.storage import Slot, Stores
from axistwin.runtime.transcript import Transcript
from axistwin.runtime.twin import Twin
from axistwin.wire.framing import LineFormat

if TYPE_CHECKING:
    from types import TracebackType

_FOREVER = 1 << 62

Subscriber: TypeAlias = Callable[[Twin, Trace], None]


@dataclass(frozen=True, slots=True)
class Station:
    """A device on the line: what it is called (``mac23:0``), its model, and its memory."""

    name: str
    model: str
    device: MotionSerialDevice
    slot: Slot


class Line:
    """The devices of ``stations`` on one line, which belongs to this object from now on.

    explain: turns bytes of the line into words for the transcript.
    Every method raises StateError once the storage has failed.
    """

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
        self.clock = clock
        self.transcript = Transcript()
        self._network = network
        self._storage = storage
        self._stations = tuple(stations)
        self._explain = explain
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._on_change: Callable[[], None] | None = None
        self._subscribers: list[Subscriber] = []
        self._failure: StateError | None = None
        self._seen_bytes = 0
        self._wakes = 0
        self._sleepers = 0
        self._is_closed = False
        self.twins = [Twin(self, index, station) for index, station in enumerate(self._stations)]

    # -- time ---------------------------------------------------------------------------------

    @property
    def is_virtual(self) -> bool:
        """Whether time passes only by ``advance`` and ``wait``."""
        return self.clock.is_virtual

    @property
    def is_volatile(self) -> bool:
        """Whether the cells are forgotten at the end of the process."""
        return self._storage.is_volatile

    def sync(self) -> Nanos:
        """Do all that is due by the clock's present time; returns that time."""
        now = self.clock.now_ns()
        if now == self._network.settled_ns and self._failure is None:
            return now  # by far the most common, and no reason to wait for another thread
        with self._lock:
            return self._sync()

    def _sync(self) -> Nanos:
        """``sync`` by who has the lock."""
        if self._failure is not None:
            raise self._failure
        now = self._now_ns()
        if now != self._network.settled_ns:
            self._network.run_until(now)
            self._settle()
        return now

    def _now_ns(self) -> Nanos:
        """The clock's present time, which the network may be ahead of."""
        now = self.clock.now_ns()
        if now == self._network.settled_ns:
            return now
        reached = self._network.now_ns
        return now if now > reached else reached

    def _settle(self) -> None:
        """Perform what the network's parts want done, before any byte is readable."""
        network = self._network
        if network.has_effects:
            self._perform(network.take_effects())
        available = network.host_available
        if available > self._seen_bytes and not self._storage.is_volatile:
            self.save_moving()
        self._seen_bytes = available

    @property
    def is_moving(self) -> bool:
        """Whether an axis moves: ``save_moving`` is then worth calling from time to time."""
        with self._lock:
            now = self._network.now_ns
            return any(station.device.is_moving(now) for station in self._stations)

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

    def advance(self, duration_ns: Nanos) -> Nanos:
        """Let ``duration_ns`` pass, which takes real time unless it is virtual."""
        return self.advance_to(self.sync() + duration_ns)

    def advance_to(self, until_ns: Nanos) -> Nanos:
        """Let time pass until ``until_ns``; returns the present time, which may be later."""
        while True:
            now = self.wait(until_ns, count=None)
            if now >= until_ns:
                return now

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
                if not clock.is_virtual:
                    self._sleep(_earliest(network.next_event(missing), until_ns))
                    continue
                reached_ns = network.run_until_heard(count or _FOREVER, until_ns)
                if reached_ns == now:  # for ever
                    return now
                clock.advance_to(reached_ns)

    def _sleep(self, due: Nanos | None) -> None:
        """Wait for ``due``, or for a change."""
        self._sleepers += 1
        try:
            self._changed.wait(None if due is None else self.clock.delay_s(due))
        finally:
            self._sleepers -= 1

    def wake(self) -> None:
        """Make every ``wait`` under way return; from any thread."""
        with self._changed:
            self._wakes += 1
            self._changed.notify_all()

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
        return self._stations[0].device.line_format

    @property
    def rate_mismatch(self) -> tuple[int, tuple[int, ...]] | None:
        """The host's rate and the devices', if none of them understands it; else None."""
        network = self._network
        if network.is_host_understood:
            return None
        return network.host_format.baud, network.device_bauds

    def _rate_note(self) -> str:
        """What the transcript says of bytes sent now; nothing if the rates agree."""
        mismatch = self.rate_mismatch
        if mismatch is None:
            return ""
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

        Only in virtual time, where nobody looks on; the outcome is the same.  Returns when it was
        sent, what was received (None: that is still to be waited for), and the time reached.  None
        instead: nothing was done, not even sent.
        """
        looked_at = self._on_change is not None or self._subscribers or not self.is_volatile
        if looked_at or not self.clock.is_virtual:
            return None
        with self._lock:
            now, network = self._sync(), self._network
            if not network.is_free_for_host:
                return None
            self.transcript.add(now, "host", data)
            answer = network.host_ask(data, size, now + patience_ns)
            if answer is None:
                return now, None, now
            reached_ns = network.now_ns
            self.clock.advance_to(reached_ns)
            if network.has_effects:
                self._perform(network.take_effects())
            self.transcript.add(reached_ns, "device", answer)
            return now, answer, reached_ns

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

    def purge_output(self) -> None:
        """Drop what the host's end has still to send."""
        with self.changing():
            self._network.host_purge_output()

    # -- others who take part -----------------------------------------------------------------

    def on_change(self, callback: Callable[[], None] | None) -> None:
        """Call ``callback`` from now on whenever ``next_event_ns`` may have come nearer.

        It is called in the thread that caused the change and must not wait.
        """
        self._on_change = callback

    def subscribe(self, subscriber: Subscriber) -> Callable[[], None]:
        """Give every trace of a device to ``subscriber``; call what is returned to end that."""
        with self._lock:
            self._subscribers.append(subscriber)

        def unsubscribe() -> None:
            with self._lock:
                self._subscribers.remove(subscriber)

        return unsubscribe

    def render_transcript(self) -> str:
        """The transcript with every frame in words."""
        with self._lock:
            return self.transcript.render(self._explain)

    def save_moving(self) -> None:
        """Save, not durably, what has changed by itself: the positions of axes that move."""
        with self._lock:
            now = self._network.now_ns
            for station in self._stations:
                if station.device.is_moving(now):
                    self._save_changed(station, now, durable=False)

    def close(self) -> None:
        """Save everything and let go of the storage.  Raises StateError if that fails."""
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
            try:
                if self._failure is None:
                    now = self.sync()
                    for station in self._stations:
                        self._save_changed(station, now, durable=True)
            finally:
                self._storage.close()
                if self._failure is None:
                    self._failure = StateError("the line is closed; build a new one")
            self.wake()

    def __enter__(self) -> "Line":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: "TracebackType | None",
    ) -> None:
        self.close()

    # -- for the twins ------------------------------------------------------------------------

    @contextmanager
    def present(self) -> Iterator[Nanos]:
        """The line at its present time, which stands still in the block."""
        with self._lock:
            yield self.sync()

    @contextmanager
    def changing(self) -> Iterator[Nanos]:
        """The line at its present time, to be changed from outside by what is in the block."""
        with self._changed:
            yield self.sync()
            self.sync()
            self._tell()

    def act(self, index: int, action: Callable[[Nanos], Sequence[Effect]]) -> None:
        """Have ``action`` do something to device ``index`` now, and perform its effects."""
        with self.changing() as now:
            self._network.perform(index, action(now))
            self._save_changed(self._stations[index], now, durable=False)  # a hand moves shafts

    def set_power(self, index: int, on: bool) -> None:
        """Apply or cut the supply of device ``index`` now; what it kept by itself is on disk."""
        with self.changing() as now:
            if on:
                self._network.power_on(index)
            else:
                self._network.power_off(index)
                self._save_changed(self._stations[index], now, durable=False)

    def _tell(self) -> None:
        """Something new may be due: tell those who wait for time or keep an alarm."""
        if self._sleepers:
            self._changed.notify_all()
        if self._on_change is not None:
            self._on_change()

    def _perform(self, effects: Sequence[tuple[int, Store | Trace]]) -> None:
        for index, effect in effects:
            if isinstance(effect, Store):
                self._save(self._stations[index], dict(effect.cells), durable=effect.durable)
            else:
                for subscriber in tuple(self._subscribers):
                    subscriber(self.twins[index], effect)

    def _save_changed(self, station: Station, now: Nanos, *, durable: bool) -> None:
        saved = station.slot.cells
        cells = station.device.cells(now)
        changed = {name: value for name, value in cells.items() if saved.get(name) != value}
        if changed or durable:
            self._save(station, changed, durable=durable)

    def _save(self, station: Station, cells: Mapping[str, int], *, durable: bool) -> None:
        try:
            station.slot.save(cells, durable=durable)
        except StateError as error:
            self._failure = error
            raise


def listening(bauds: Sequence[int]) -> str:
    """At which rates the modules of a line listen, in words."""
    rates = " and ".join(map(str, bauds))
    return f"the module{'s listen' if len(bauds) > 1 else ' listens'} at {rates}"


def _earliest(first: Nanos | None, second: Nanos | None) -> Nanos | None:
    if first is None or second is None:
        return first if second is None else second
    return min(first, second)
