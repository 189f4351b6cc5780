"""Wires of their own for each direction: RS-232, or RS-485 with two pairs.

Rules
-----
1. The host drives one line, on which the devices listen; the devices drive the other, on which the
   host listens.  Each is a line as ``serial_line.py`` or ``instant_line.py`` tells.
2. So both ends may send at a time, nobody is deaf while it drives, and a device does not hear the
   others; devices that answer at once still collide.
3. Bytes of both lines are handed over in the order of time; at one nanosecond those for the host
   first.
"""

from collections.abc import Sequence

from axistwin.kernel.time import Nanos
from axistwin.wire.framing import Chunk, LineFormat
from axistwin.wire.instant_line import InstantLine
from axistwin.wire.serial_line import HOST, SerialLine

_FOR_HOST = (HOST,)


class DuplexLine:
    """Two lines, used like one ``SerialLine``; ``paced``: bytes take their time."""

    def __init__(
        self, formats: Sequence[LineFormat], now_ns: Nanos = 0, *, paced: bool = True
    ) -> None:
        kind = SerialLine if paced else InstantLine
        self._down: SerialLine | InstantLine = kind(formats, now_ns)
        self._up: SerialLine | InstantLine = kind(formats, now_ns)
        self._lines = (self._up, self._down)
        self._offered = self._down

    def _of(self, station: int) -> SerialLine | InstantLine:
        """The line that ``station`` drives."""
        return self._down if station == HOST else self._up

    @property
    def now_ns(self) -> Nanos:
        """The time up to which everything was handed over."""
        return max(self._down.now_ns, self._up.now_ns)

    @now_ns.setter
    def now_ns(self, now_ns: Nanos) -> None:
        self._down.now_ns = self._up.now_ns = now_ns

    @property
    def is_silent(self) -> bool:
        """Whether nobody sends, or is known to be about to."""
        return self._down.is_silent and self._up.is_silent

    @property
    def is_transparent(self) -> bool:
        """Whether bytes sent now would be heard now, as they are."""
        return self._down.is_transparent and self._up.is_transparent

    def ahead_of_host(self) -> tuple[Nanos, bytes, int] | None:
        """What the host still sends, or nothing, if no device does and all hear what is sent."""
        up = self._up.ahead_of_host()
        return None if up is None or up[1] else self._down.ahead_of_host()

    def forget(self) -> None:
        """Take off the line what ``ahead_of_host`` gave."""
        self._down.forget()

    # -- what stations do --

    def format_of(self, station: int) -> LineFormat:
        """The format that ``station`` uses now."""
        return self._down.format_of(station)

    def transmit(self, station: int, start_ns: Nanos, data: bytes) -> None:
        """Send ``data`` from ``start_ns`` on, or when ``station`` is done with what it sends."""
        self._of(station).transmit(station, start_ns, data)

    def send_break(self, station: int, start_ns: Nanos, duration_ns: Nanos) -> None:
        """Hold the line that ``station`` drives at space for ``duration_ns`` (> 0)."""
        self._of(station).send_break(station, start_ns, duration_ns)

    def set_format(self, station: int, line_format: LineFormat) -> None:
        """Use ``line_format`` from now on, in both directions."""
        for line in self._lines:
            line.set_format(station, line_format)

    def switch_off(self, station: int) -> None:
        """Cut the supply of ``station``."""
        for line in self._lines:
            line.switch_off(station)

    def switch_on(self, station: int) -> None:
        """Supply ``station`` again."""
        for line in self._lines:
            line.switch_on(station)

    def purge(self, station: int) -> None:
        """Drop what ``station`` has queued and not begun."""
        self._of(station).purge(station)

    def backlog(self, station: int) -> int:
        """How many bytes ``station`` has queued whose start bit has not begun."""
        return self._of(station).backlog(station)

    def sent_ns(self, station: int) -> Nanos:
        """When all that ``station`` has queued is on the line entirely; now, if it is."""
        return max(self.now_ns, self._of(station).sent_ns(station))

    # -- what stations hear --

    def offer(self, limit_ns: Nanos) -> tuple[Chunk, tuple[int, ...]] | None:
        """The earliest bytes complete by ``limit_ns``, and the stations that hear them.

        None if there are none; time then stands at ``limit_ns``.
        """
        if self._up.is_silent:  # by far the most common
            self._offered = self._down
            offer = self._down.offer(limit_ns)
            if offer is None and limit_ns > self._up.now_ns:
                self._up.now_ns = limit_ns
            return offer
        while True:
            line, until_ns = self._earlier(limit_ns)
            offer = line.offer(until_ns)
            if offer is None:
                if until_ns < limit_ns:
                    continue  # what was foretold was no byte
                rest = (self._down if line is self._up else self._up).offer(limit_ns)
                assert rest is None, "the later line was first"
                return None
            self._offered = line
            if line is self._down:
                return offer
            if HOST in offer[1]:
                return offer[0], _FOR_HOST
            line.accept(len(offer[0].data))

    def _earlier(self, limit_ns: Nanos) -> tuple[SerialLine | InstantLine, Nanos]:
        """The line to be heard next, and until when before the other one is."""
        up, down = self._up, self._down
        if down.is_silent:
            return up, limit_ns
        up_ns, down_ns = up.next_arrival(), down.next_arrival()
        if up_ns is None or (down_ns is not None and down_ns < up_ns):
            return down, limit_ns if up_ns is None else min(limit_ns, up_ns)
        return up, limit_ns if down_ns is None else min(limit_ns, down_ns)

    def accept(self, count: int) -> None:
        """Take the first ``count`` bytes (>= 1) of what was just offered."""
        self._offered.accept(count)

    def next_arrival(self) -> Nanos | None:
        """When something may next be complete at some receiver, as far as the line is known."""
        up_ns, down_ns = self._up.next_arrival(), self._down.next_arrival()
        if up_ns is None or down_ns is None:
            return down_ns if up_ns is None else up_ns
        return min(up_ns, down_ns)

    def next_arrival_at(self, station: int) -> Nanos | None:
        """When ``station`` next gets a byte, as far as the line is known."""
        return (self._up if station == HOST else self._down).next_arrival_at(station)

    def peek_stretch(self) -> tuple[Chunk, tuple[int, ...]] | None:
        """The bytes that are to be heard undisturbed, if only one line is in use."""
        if self._up.is_silent:
            return self._down.peek_stretch()
        if not self._down.is_silent:
            return None
        stretch = self._up.peek_stretch()
        return None if stretch is None else (stretch[0], _FOR_HOST)

    @property
    def bytes_held(self) -> int:
        """How many bytes of transmissions, past and to come, are held."""
        return self._down.bytes_held + self._up.bytes_held

    @property
    def transmissions_held(self) -> int:
        """How many transmissions, past and to come, are held."""
        return self._down.transmissions_held + self._up.transmissions_held
