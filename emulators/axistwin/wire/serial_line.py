"""A half-duplex serial pair: one host, several devices, every station on the same two wires.

Rules
-----
1. Station 0 is the host, stations 1.. are the devices.  A station sends and listens in its own
   ``LineFormat``; characters go out in the format that holds when they are queued.
2. A station's transmissions follow one another; what is queued while it still sends continues the
   same stretch without a gap.
3. A station does not hear while it drives: its receiver is off and reads mark.
4. Everybody else hears all that is driven, space dominating, as sampled by its UART (``uart.py``).
5. Characters are handed over in the order of time; at one nanosecond in the order of stations.
   What was handed over is never taken back: the line ahead of ``now_ns`` may still change, the line
   behind it may not.
6. A station that is switched off stops driving at once, in the middle of a character if need be,
   and hears nothing until it is switched on.

Theory
------
*Clean*: one station drives at a time, all listeners were idle when it began and use its format.
Then sampling gives back the bytes as sent, each complete one character after its start bit, and
they are handed over in stretches without looking at a single bit.  *Disturbed*: as soon as
transmissions overlap, formats differ, or a receiver is switched in the middle of a character, the
receivers sample the combined levels, until all of them are back in step with a lone transmission in
their own format; stations that hear the same share a receiver.  Both ways give the same bytes at
the same nanosecond.

::

              overlap, break, other format, receiver switched
      CLEAN ----------------------------------------------------> DISTURBED
            <----------------------------------------------------
              next edge of each listener = a start bit of the one sender
"""

from bisect import insort
from collections.abc import Sequence

from axistwin.kernel.time import Nanos
from axistwin.wire.framing import Chunk, LineFormat
from axistwin.wire.uart import UartReceiver
from axistwin.wire.waveform import FINE_BITS, Transmission, make_break

HOST = 0

# How many bytes are offered at once: bounds the work that is thrown away when only few are taken.
STRETCH_BYTES = 2048


def _by_station(receiver: UartReceiver) -> int:
    return receiver.stations[0]


def _by_time(transmission: Transmission) -> tuple[Nanos, int]:
    return transmission.start_ns, transmission.station


class SerialLine:
    """The pair.  ``formats``: one per station, the host's first.

    Use: ``offer(limit_ns)`` gives the earliest bytes due by then and who hears them, ``accept(n)``
    consumes the first n of them; when nothing is offered, the line stands at ``limit_ns``.
    """

    def __init__(self, formats: Sequence[LineFormat], now_ns: Nanos = 0) -> None:
        self.now_ns = now_ns
        self._formats = list(formats)
        self._receivers: list[UartReceiver] = []  # while it is disturbed; by their first station
        self._is_on = [True] * len(formats)
        self._transmissions: list[Transmission] = []
        self._is_clean = True
        self._listeners = self._find_listeners()
        self._agreed: Transmission | None = None  # known to be in every listener's format
        self._is_common = self._find_common()
        self._sampled: UartReceiver | None = None

    def _find_listeners(self) -> tuple[tuple[int, ...], ...]:
        """Who listens while station n drives."""
        stations = range(len(self._is_on))
        return tuple(
            tuple(other for other in stations if other != station and self._is_on[other])
            for station in stations
        )

    def _find_common(self) -> bool:
        """Whether all stations have supply and understand each other."""
        return all(self._is_on) and all(each == self._formats[0] for each in self._formats)

    @property
    def is_silent(self) -> bool:
        """Whether nobody sends, or is known to be about to."""
        return not self._transmissions

    @property
    def is_transparent(self) -> bool:
        """Never: bytes take their time."""
        return False

    def ahead_of_host(self) -> tuple[Nanos, bytes, int] | None:
        """What the host still sends, or nothing, if nobody else does and all hear what is sent.

        As in a chunk: when the stretch began, the bytes, how many of it were handed over earlier.
        None: there is more to it.  ``forget`` leaves these bytes to who asked.
        """
        if not (self._is_common and self._is_clean):
            return None
        line = self._transmissions
        if not line:
            return self.now_ns, b"", 0
        current = line[0]
        if (
            len(line) > 1
            or current.station != HOST
            or current.is_broken
            or current.format != self._formats[0]
        ):
            return None
        heard = current.heard
        return current.start_ns, current.data(heard, current.count), heard

    def forget(self) -> None:
        """Take off the line what ``ahead_of_host`` gave."""
        self._transmissions.clear()

    # -- what stations do --

    def format_of(self, station: int) -> LineFormat:
        """The format that ``station`` uses now."""
        return self._formats[station]

    def transmit(self, station: int, start_ns: Nanos, data: bytes) -> None:
        """Send ``data`` from ``start_ns`` on, or when ``station`` is done with what it sends."""
        if not data or not self._is_on[station]:
            return
        start_ns = max(start_ns, self.now_ns)
        last = self._last_of(station)
        line_format = self._formats[station]
        if last is not None and start_ns < last.free_ns:
            if not last.is_broken and last.format == line_format:
                last.extend(data)
                self._line_changed()
                return
            start_ns = last.free_ns
        self._add(Transmission(station, start_ns, line_format, data))

    def send_break(self, station: int, start_ns: Nanos, duration_ns: Nanos) -> None:
        """Hold the line at space for ``duration_ns`` (> 0), queued like bytes."""
        assert duration_ns > 0
        if not self._is_on[station]:
            return
        last = self._last_of(station)
        start_ns = max(start_ns, self.now_ns, last.free_ns if last is not None else 0)
        self._add(make_break(station, start_ns, duration_ns, self._formats[station]))

    def set_format(self, station: int, line_format: LineFormat) -> None:
        """Use ``line_format`` from now on; a character on its way in is lost."""
        if line_format == self._formats[station]:
            return
        self._formats[station] = line_format
        self._restart_receiver(station)
        self._is_common = self._find_common()

    def switch_off(self, station: int) -> None:
        """Cut the supply of ``station``: it stops driving now, and hears nothing."""
        if not self._is_on[station]:
            return
        self._is_on[station] = self._is_common = False
        self._listeners = self._find_listeners()
        self._part(station)
        for transmission in self._of(station):
            transmission.cut(self.now_ns)
            if transmission.start_ns >= self.now_ns:
                self._transmissions.remove(transmission)
        self._line_changed()

    def switch_on(self, station: int) -> None:
        """Supply ``station`` again: it listens from now on."""
        if self._is_on[station]:
            return
        self._is_on[station] = True
        self._is_common = self._find_common()
        self._listeners = self._find_listeners()
        self._restart_receiver(station)

    def purge(self, station: int) -> None:
        """Drop what ``station`` has queued and not begun; the character on the line is finished."""
        for transmission in self._of(station):
            begun = transmission.begun_by(self.now_ns)
            if transmission.start_ns >= self.now_ns:
                self._transmissions.remove(transmission)
            elif not transmission.is_broken:
                transmission.stop_after(begun)
        self._line_changed()

    def backlog(self, station: int) -> int:
        """How many bytes ``station`` has queued whose start bit has not begun."""
        return sum(each.count - each.begun_by(self.now_ns) for each in self._of(station))

    def sent_ns(self, station: int) -> Nanos:
        """When all that ``station`` has queued is on the line entirely; now, if it is."""
        last = self._last_of(station)
        return self.now_ns if last is None else max(self.now_ns, last.free_ns)

    # -- what stations hear --

    def offer(self, limit_ns: Nanos) -> tuple[Chunk, tuple[int, ...]] | None:
        """The earliest bytes complete by ``limit_ns``, and the stations that hear them.

        None if there are none; time then stands at ``limit_ns``.
        """
        self._sampled = None
        while self._transmissions:
            if self._is_clean:
                current = self._transmissions[0]
                until_ns = self._undisturbed_until(current, limit_ns)
                heard = current.heard
                count = current.complete_by(until_ns) - heard
                if count > 0:
                    if count > STRETCH_BYTES:
                        count = STRETCH_BYTES
                    data = current.data(heard, heard + count)
                    chunk = Chunk(current.start_ns, data, current.format, heard)
                    return chunk, self._listeners[current.station]
                if until_ns >= limit_ns:
                    break
                self._disturb()
            sampled = self._sample_until(limit_ns)
            if sampled is not None:
                return sampled
            if not self._is_clean:
                break
        if limit_ns > self.now_ns:
            self.now_ns = limit_ns
        return None

    def accept(self, count: int) -> None:
        """Take the first ``count`` bytes (>= 1) of what was just offered."""
        if self._sampled is not None:
            receiver, self._sampled = self._sampled, None
            self._stand_at(receiver.take(count))
            return
        current = self._transmissions[0]
        current.heard += count
        if current.heard == current.count:
            self.now_ns = current.end_ns
            del self._transmissions[0]
        else:
            self.now_ns = current.start_ns + current.format.span_ns(current.heard)
            current.forget_before(current.heard)

    def next_arrival(self) -> Nanos | None:
        """When something is next complete at some receiver, as far as the line is known."""
        if not self._transmissions:
            return None
        if self._is_clean:
            current = self._transmissions[0]
            arrival_ns = current.start_ns + current.format.span_ns(current.heard + 1)
            if self._undisturbed_until(current, arrival_ns) == arrival_ns:
                return arrival_ns
            self._disturb()
        arrivals = [each.next_done_ns(self._transmissions) for each in self._receivers]
        return min((each for each in arrivals if each is not None), default=None)

    def next_arrival_at(self, station: int) -> Nanos | None:
        """When ``station`` next gets a byte, as far as the line is known."""
        line = self._transmissions
        if all(each.station == station for each in line):
            return None
        searched = 0
        if self._is_clean:
            current = line[0]
            arrival_ns = current.start_ns + current.format.span_ns(current.heard + 1)
            if (
                current.station != station
                and self._undisturbed_until(current, arrival_ns) == arrival_ns
            ):
                return arrival_ns
            searched = current.last_sample(current.heard)
        for receiver in self._receivers:
            if station in receiver.stations:
                searched = receiver.searched
        return UartReceiver((station,), self._formats[station], searched).next_done_ns(line)

    def peek_stretch(self) -> tuple[Chunk, tuple[int, ...]] | None:
        """The bytes that are to be heard undisturbed, as far as the line is known."""
        if not self._transmissions or not self._is_clean:
            return None
        current = self._transmissions[0]
        until_ns = self._undisturbed_until(current, current.end_ns)
        count = min(current.complete_by(until_ns) - current.heard, STRETCH_BYTES)
        if count <= 0:
            return None
        data = current.data(current.heard, current.heard + count)
        chunk = Chunk(current.start_ns, data, current.format, current.heard)
        return chunk, self._listeners[current.station]

    # -- memory in use, for tests and for those who watch over it --

    @property
    def bytes_held(self) -> int:
        """How many bytes of transmissions, past and to come, are held."""
        return sum(each.kept for each in self._transmissions)

    @property
    def transmissions_held(self) -> int:
        """How many transmissions, past and to come, are held."""
        return len(self._transmissions)

    # -- clean and disturbed --

    def _undisturbed_until(self, current: Transmission, limit_ns: Nanos) -> Nanos:
        """Up to when, at most ``limit_ns``, ``current`` is heard as sent."""
        if self._agreed is not current or current.is_broken:
            if current.is_broken or not self._is_agreed_on(current):
                return min(limit_ns, current.start_ns - 1)
            self._agreed = current
        if len(self._transmissions) > 1:
            clash_ns = self._transmissions[1].start_ns
            if clash_ns < current.end_ns and clash_ns < limit_ns:
                return clash_ns
        return limit_ns

    def _is_agreed_on(self, current: Transmission) -> bool:
        """Whether all who listen to ``current`` use its format."""
        formats, line_format = self._formats, current.format
        for listener in self._listeners[current.station]:
            own = formats[listener]
            if own is not line_format and own != line_format:
                return False
        return True

    def _disturb(self) -> None:
        """From the character under way on, let every receiver look at the bits."""
        current = self._transmissions[0]
        consumed = current.last_sample(current.heard)
        drivers = {each.station for each in self._transmissions}
        alike: dict[object, list[int]] = {}
        for station, line_format in enumerate(self._formats):
            if self._is_on[station]:
                is_alone = station == HOST or station in drivers
                alike.setdefault(station if is_alone else line_format, []).append(station)
        self._receivers = [
            UartReceiver(tuple(stations), self._formats[stations[0]], consumed)
            for stations in alike.values()
        ]
        self._is_clean = False

    def _part(self, station: int) -> None:
        """Let ``station`` have no part in anybody's receiver any more."""
        for receiver in self._receivers:
            if station in receiver.stations:
                receiver.stations = tuple(each for each in receiver.stations if each != station)
                if not receiver.stations:
                    self._receivers.remove(receiver)
                return

    def _add_receiver(self, receiver: UartReceiver) -> None:
        insort(self._receivers, receiver, key=_by_station)

    def _split(self, receiver: UartReceiver) -> None:
        """Give each of its stations a receiver of its own."""
        self._receivers.remove(receiver)
        for station in receiver.stations:
            self._add_receiver(UartReceiver((station,), receiver.format, receiver.searched))

    def _sample_until(self, limit_ns: Nanos) -> tuple[Chunk, tuple[int, ...]] | None:
        """The earliest characters sampled by ``limit_ns``; None too when the line came clean."""
        if self._come_clean():
            return None
        earliest = self._earliest_receiver(limit_ns)
        if earliest is None:
            self._stand_at(limit_ns)
            return None
        self._sampled, until_ns = earliest
        chunk, stations = self._sampled.characters(until_ns), self._sampled.stations
        return chunk.with_nul() if stations[0] == HOST else chunk, stations

    def _earliest_receiver(self, limit_ns: Nanos) -> tuple[UartReceiver, Nanos] | None:
        """Who gets the first characters by ``limit_ns``, and up to when no other gets any.

        Of equals it is the first station.
        """
        earliest: UartReceiver | None = None
        first_ns, until_ns = limit_ns + 1, limit_ns
        for receiver in self._receivers:
            done_ns = receiver.next_done_ns(self._transmissions)
            if done_ns is None or done_ns > until_ns:
                continue
            if earliest is None or done_ns < first_ns:
                if earliest is not None:
                    until_ns = first_ns - 1
                earliest, first_ns = receiver, done_ns
            elif receiver.stations[0] > earliest.stations[-1]:
                until_ns = done_ns
            elif done_ns > first_ns:
                until_ns = done_ns - 1
            else:
                self._split(earliest)
                return self._earliest_receiver(limit_ns)
        return None if earliest is None else (earliest, until_ns)

    def _stand_at(self, now_ns: Nanos) -> None:
        """Move to ``now_ns`` on a disturbed line, and forget what every receiver has consumed."""
        if now_ns > self.now_ns:
            self.now_ns = now_ns
        for receiver in self._receivers:
            receiver.pass_time(self.now_ns)
        fine = self.now_ns << FINE_BITS
        needed = min((each.searched for each in self._receivers), default=fine)
        self._transmissions = [each for each in self._transmissions if each.fine_end >= needed]
        for transmission in self._transmissions:
            transmission.forget_before(transmission.begun_by(needed >> FINE_BITS) - 1)

    def _come_clean(self) -> bool:
        """Whether all receivers are back in step with one undisturbed transmission, or at rest."""
        ahead = [each for each in self._transmissions if each.end_ns > self.now_ns]
        if ahead:
            if not self._is_in_step(ahead[0], ahead[1].start_ns if len(ahead) > 1 else None):
                return False
            ahead[0].heard = ahead[0].complete_by(self.now_ns)
        elif any(each.next_edge(self._transmissions) is not None for each in self._receivers):
            return False
        self._transmissions = ahead
        self._receivers = []
        self._is_clean = True
        self._agreed = None
        return True

    def _is_in_step(self, first: Transmission, clash_ns: Nanos | None) -> bool:
        """Whether every listener takes the next edge of ``first`` for the start bit that it is."""
        for receiver in self._receivers:
            if receiver.format != first.format and receiver.stations[0] != first.station:
                return False
        index = first.complete_by(self.now_ns)
        done_ns = first.start_ns + first.format.span_ns(index + 1)
        if first.is_broken or (clash_ns is not None and clash_ns < done_ns):
            return False
        boundary = first.edge(index, 0)
        if any(
            each.end_ns <= self.now_ns and each.fine_end > boundary for each in self._transmissions
        ):
            return False  # somebody has meddled with this character
        for receiver in self._receivers:
            edge = receiver.next_edge(self._transmissions)
            if first.station == receiver.stations[0]:
                if edge is not None and (clash_ns is None or edge < clash_ns << FINE_BITS):
                    return False
            elif edge != boundary:
                return False
        return True

    def _restart_receiver(self, station: int) -> None:
        """Let a receiver that was switched look for a new start bit."""
        self._agreed = None
        if self._is_clean and self._transmissions:
            current = self._transmissions[0]
            if current.start_ns < self.now_ns and current.station != station:
                self._disturb()
        if not self._is_clean and self._is_on[station]:
            self._part(station)
            fine = self.now_ns << FINE_BITS
            self._add_receiver(UartReceiver((station,), self._formats[station], fine))

    # -- the queue of transmissions --

    def _of(self, station: int) -> list[Transmission]:
        return [each for each in self._transmissions if each.station == station]

    def _last_of(self, station: int) -> Transmission | None:
        for transmission in reversed(self._transmissions):
            if transmission.station == station:
                return transmission
        return None

    def _add(self, transmission: Transmission) -> None:
        for receiver in self._receivers:
            if transmission.station in receiver.stations and len(receiver.stations) > 1:
                self._part(transmission.station)
                own = UartReceiver((transmission.station,), receiver.format, receiver.searched)
                self._add_receiver(own)
                break
        insort(self._transmissions, transmission, key=_by_time)
        self._line_changed()

    def _line_changed(self) -> None:
        """Levels ahead have changed."""
        if self._is_clean:
            line = self._transmissions
            if line and line[0].heard == line[0].count and not line[0].is_broken:
                del line[0]
        else:
            for receiver in self._receivers:
                receiver.invalidate()
