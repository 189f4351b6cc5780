"""The half-duplex pair of ``serial_line.py`` with bytes that take no time.

For hosts that want answers as fast as they come; the devices' own times stay real.

Rules
-----
1. A transmission is heard entirely at the nanosecond it begins; nobody is deaf for any time, and
   the host never collides with anybody.  Of transmissions that begin together the host's is heard
   first, then by station.
2. Rates and framing still have to match: a listener in another format hears what its UART would
   have sampled from that transmission at its true rate.
3. Devices still answer on top of one another: the transmissions of devices that are known when the
   first of them begins, and that begin before it would have ended at its true rate, are sampled
   together as they would have overlapped, and heard together when the first begins.  (What is only
   sent as a consequence of hearing that cannot collide with it, nor can what the same one sends.)
4. A break brings no byte to anybody and takes no time: nothing of it is left.
"""

from bisect import insort
from collections import deque
from collections.abc import Sequence

from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import Nanos
from axistwin.wire.framing import Chunk, LineFormat
from axistwin.wire.serial_line import HOST, STRETCH_BYTES
from axistwin.wire.uart import UartReceiver
from axistwin.wire.waveform import FINE_BITS, Transmission


def _by_time(transmission: Transmission) -> tuple[Nanos, int]:
    return transmission.start_ns, transmission.station


class _Heard:
    """Bytes that are being handed over to ``stations``, all at ``time_ns``.

    errors: the places of the bad ones, in ascending order.
    """

    __slots__ = ("data", "errors", "offset", "stations", "time_ns")

    def __init__(
        self,
        time_ns: Nanos,
        data: bytes,
        stations: tuple[int, ...],
        errors: Sequence[int] = (),
    ) -> None:
        self.time_ns = time_ns
        self.data = data
        self.stations = stations
        self.errors = errors
        self.offset = 0

    def next_piece(self) -> tuple[bytes, tuple[int, ...]]:
        """What is handed over next, and the places in it that are bad."""
        start = self.offset
        end = min(len(self.data), start + STRETCH_BYTES)
        return self.data[start:end], tuple(
            place - start for place in self.errors if start <= place < end
        )


class InstantLine:
    """The pair without byte times.  Used like ``SerialLine``."""

    def __init__(self, formats: Sequence[LineFormat], now_ns: Nanos = 0) -> None:
        self.now_ns = now_ns
        self._formats = list(formats)
        self._is_on = [True] * len(formats)
        self._waiting: list[Transmission] = []
        self._heard: deque[_Heard] = deque()
        self._is_agreed = self._agree()

    def _agree(self) -> bool:
        """Whether everybody listens, in one format that changes no byte."""
        first = self._formats[0]
        return (
            first.data_bits == 8
            and all(self._is_on)
            and self._formats.count(first) == len(self._formats)
        )

    @property
    def is_silent(self) -> bool:
        """Whether nothing is on its way."""
        return not self._waiting and not self._heard

    @property
    def is_transparent(self) -> bool:
        """Whether bytes sent now would be heard now, by all others, as they are."""
        return self._is_agreed and not self._waiting and not self._heard

    def ahead_of_host(self) -> None:
        """Nobody has to wait for bytes here."""

    def forget(self) -> None:
        """There is nothing to be forgotten."""

    # -- what stations do --

    def format_of(self, station: int) -> LineFormat:
        """The format that ``station`` uses now."""
        return self._formats[station]

    def transmit(self, station: int, start_ns: Nanos, data: bytes) -> None:
        """Send ``data`` at ``start_ns``, behind what ``station`` sends before."""
        if not data or not self._is_on[station]:
            return
        start_ns = max(start_ns, self.now_ns)
        own = [each for each in self._waiting if each.station == station]
        if own:
            start_ns = max(start_ns, own[-1].start_ns)
            if start_ns == own[-1].start_ns and own[-1].format == self._formats[station]:
                own[-1].extend(data)
                return
        insort(
            self._waiting,
            Transmission(station, start_ns, self._formats[station], data),
            key=_by_time,
        )

    def send_break(self, station: int, start_ns: Nanos, duration_ns: Nanos) -> None:
        """A break leaves nothing on a line without times (rule 4)."""
        assert duration_ns > 0

    def set_format(self, station: int, line_format: LineFormat) -> None:
        """Use ``line_format`` for what is sent and heard from now on."""
        self._formats[station] = line_format
        self._is_agreed = self._agree()

    def switch_off(self, station: int) -> None:
        """Cut the supply of ``station``: it sends and hears nothing more."""
        self._is_on[station] = False
        self._is_agreed = False
        self.purge(station)

    def switch_on(self, station: int) -> None:
        """Supply ``station`` again: it listens from now on."""
        self._is_on[station] = True
        self._is_agreed = self._agree()

    def purge(self, station: int) -> None:
        """Drop what ``station`` has queued."""
        self._waiting = [each for each in self._waiting if each.station != station]

    def backlog(self, station: int) -> int:
        """How many bytes ``station`` has queued that are not sent yet."""
        return sum(each.count for each in self._waiting if each.station == station)

    def sent_ns(self, station: int) -> Nanos:
        """When all that ``station`` has queued is sent; now, if it is."""
        if not self._waiting:
            return self.now_ns
        starts = [each.start_ns for each in self._waiting if each.station == station]
        return max(self.now_ns, *starts) if starts else self.now_ns

    # -- what stations hear --

    def offer(self, limit_ns: Nanos) -> tuple[Chunk, tuple[int, ...]] | None:
        """The earliest bytes heard by ``limit_ns``, and the stations that hear them.

        None if there are none; time then stands at ``limit_ns``.
        """
        while not self._heard:
            if not self._waiting or self._waiting[0].start_ns > limit_ns:
                if limit_ns > self.now_ns:
                    self.now_ns = limit_ns
                return None
            self.now_ns = max(self.now_ns, self._waiting[0].start_ns)
            self._hear_next()
        heard = self._heard[0]
        data = heard.data
        errors: tuple[int, ...] = ()
        if heard.offset or heard.errors or len(data) > STRETCH_BYTES:
            data, errors = heard.next_piece()
        stations = heard.stations
        if not all(self._is_on[each] for each in stations):
            stations = tuple(each for each in stations if self._is_on[each])
        return Chunk(heard.time_ns, data, None, errors=errors), stations

    def accept(self, count: int) -> None:
        """Take the first ``count`` bytes (>= 1) of what was just offered."""
        heard = self._heard[0]
        heard.offset += count
        if heard.offset == len(heard.data):
            self._heard.popleft()

    def peek_stretch(self) -> tuple[Chunk, tuple[int, ...]] | None:
        """Nothing is worth a look ahead: all is heard at ``next_arrival``."""
        return None

    def next_arrival(self) -> Nanos | None:
        """When something is next heard by some receiver, as far as the line is known."""
        if self._heard:
            return self._heard[0].time_ns
        return self._waiting[0].start_ns if self._waiting else None

    def next_arrival_at(self, station: int) -> Nanos | None:
        """When ``station`` may next get a byte, as far as the line is known."""
        for transmission in self._waiting:
            if transmission.station != station:
                return transmission.start_ns
        return None

    @property
    def bytes_held(self) -> int:
        """How many bytes of transmissions are held."""
        held = sum(len(each.data) for each in self._heard)
        return held + sum(each.kept for each in self._waiting)

    @property
    def transmissions_held(self) -> int:
        """How many transmissions are held."""
        return len(self._waiting)

    def _hear_next(self) -> None:
        """Turn the earliest waiting transmission, and what it collides with, into bytes heard."""
        group = self._take_group()
        start_ns = group[0].start_ns
        alone = group[0] if len(group) == 1 else None
        in_step: list[int] = []
        sampled: list[_Heard] = []
        for station, line_format in enumerate(self._formats):
            if not self._is_on[station] or (alone is not None and alone.station == station):
                continue
            if alone is not None and alone.format == line_format:
                in_step.append(station)
                continue
            data, errors = _sample_all(group, station, line_format)
            if data:
                sampled.append(_Heard(start_ns, data, (station,), errors))
        if in_step and alone is not None:
            self._heard.append(_Heard(start_ns, alone.data(0, alone.count), tuple(in_step)))
        self._heard.extend(sampled)

    def _take_group(self) -> list[Transmission]:
        """The earliest transmission, and one of each other device that would overlap it."""
        group = [self._waiting.pop(0)]
        if group[0].station == HOST:
            return group
        end_ns = group[0].end_ns
        left = []
        for transmission in self._waiting:
            sending = {HOST, *(each.station for each in group)}
            if transmission.station not in sending and transmission.start_ns < end_ns:
                group.append(transmission)
                end_ns = max(end_ns, transmission.end_ns)
            else:
                left.append(transmission)
        self._waiting = left
        return group


def _sample_all(
    group: Sequence[Transmission], station: int, line_format: LineFormat
) -> tuple[bytes, list[int]]:
    """All that the receiver of ``station`` makes of ``group`` at its true rate, and what is bad."""
    receiver = UartReceiver((station,), line_format, group[0].start_ns << FINE_BITS)
    data, errors = bytearray(), []
    while receiver.next_done_ns(group) is not None:
        chunk = receiver.characters(NEVER)
        receiver.take(len(chunk.data))
        if station == HOST:
            chunk = chunk.with_nul()
        errors += [len(data) + each for each in chunk.errors]
        data += chunk.data
    return bytes(data), errors
