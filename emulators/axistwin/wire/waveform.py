"""What stands on the pair: transmissions as levels over time.

Theory
------
A line rests at *mark*; a driver pulls it to *space*.  Where several drive at once, space wins, so
the level at an instant is space if any driver says space.  A transmission is a stretch of
characters back to back from one start, or a break (space for a duration).

::

    mark  ____       _____ ___ ___________     one character: start bit (space), data bits,
    space     |_____|     |   |                lowest first, parity if any, stop bit (mark)
              start   d0    d1  ...   stop

Levels are compared in *fine* time, 2**-40 ns, because a bit of most rates is no whole number of
nanoseconds.  Each edge is rounded up to it once, from the start of its stretch: nothing adds up,
and converting back to nanoseconds gives exactly what ``LineFormat.span_ns`` gives.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache

from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.wire.framing import LineFormat

FINE_BITS = 40
FINE_PER_S = NS_PER_S << FINE_BITS

# Levels of a character by half bit (bit h of the integer: mark in half bit h), and its falling
# edges in half bits from its start.
Shape = tuple[int, tuple[int, ...]]


def parity_bit(parity: str, value: int) -> int:
    """The parity bit that belongs to ``value`` under ``parity`` (E O M S)."""
    odd = value.bit_count() & 1
    return {"E": odd, "O": odd ^ 1, "M": 1, "S": 0}[parity]


def _shape(line_format: LineFormat, value: int) -> Shape:
    bits = [0] + [value >> place & 1 for place in range(line_format.data_bits)]
    if line_format.parity != "N":
        bits.append(parity_bit(line_format.parity, value & ((1 << line_format.data_bits) - 1)))
    levels = sum(3 << 2 * place for place, bit in enumerate(bits) if bit)
    levels |= ((1 << line_format.stop_half_bits) - 1) << 2 * len(bits)
    falls = [0] + [2 * n for n in range(1, len(bits)) if bits[n - 1] > bits[n]]
    return levels, tuple(falls)


@lru_cache(maxsize=32)
def shapes(line_format: LineFormat) -> tuple[Shape, ...]:
    """The shape of each of the 256 bytes in ``line_format``."""
    return tuple(_shape(line_format, value) for value in range(256))


class Transmission:
    """One station driving the line: characters back to back, or a break.

    Bytes are numbered from the start of the stretch for as long as it lasts; only those that some
    receiver may still need are kept.  ``heard`` is the first byte not yet handed over.
    """

    __slots__ = (
        "_first_kept",
        "_kept",
        "count",
        "end_ns",
        "format",
        "heard",
        "is_broken",
        "start_ns",
        "station",
    )

    def __init__(
        self, station: int, start_ns: Nanos, line_format: LineFormat, data: bytes = b""
    ) -> None:
        self.station = station
        self.start_ns = start_ns
        self.end_ns = start_ns
        self.format = line_format
        self.count = 0
        self.heard = 0
        self.is_broken = False  # a break, or cut in the middle of a character
        self._kept = bytearray()
        self._first_kept = 0
        self.extend(data)

    def extend(self, data: bytes) -> None:
        """Append characters to the stretch; bits beyond the format's data bits are not sent."""
        if self.format.data_bits < 8:
            mask = (1 << self.format.data_bits) - 1
            data = bytes(value & mask for value in data)
        self._kept += data
        self.count += len(data)
        self.end_ns = self.start_ns + self.format.span_ns(self.count)

    def data(self, first: int, last: int) -> bytes:
        """The bytes numbered ``first`` up to but not including ``last``."""
        return bytes(self._kept[first - self._first_kept : last - self._first_kept])

    def forget_before(self, index: int) -> None:
        """Free the memory of the bytes before ``index``, now and then."""
        surplus = min(index, self.count) - self._first_kept
        if surplus >= 4096:
            del self._kept[:surplus]
            self._first_kept += surplus

    @property
    def kept(self) -> int:
        """How many bytes are held in memory."""
        return len(self._kept)

    def complete_by(self, time_ns: Nanos) -> int:
        """How many bytes have arrived entirely at ``time_ns``."""
        if time_ns >= self.end_ns:
            return self.count
        return self.format.characters_within(time_ns - self.start_ns)

    def begun_by(self, time_ns: Nanos) -> int:
        """How many bytes have begun before ``time_ns`` (one beginning just then has not)."""
        if time_ns <= self.start_ns:
            return 0
        return min(self.count, self.format.characters_within(time_ns - 1 - self.start_ns) + 1)

    def cut(self, time_ns: Nanos) -> None:
        """Stop driving at ``time_ns``, in the middle of a character if need be."""
        complete = self.complete_by(time_ns)
        self.count = self.begun_by(time_ns)
        self.is_broken = self.is_broken or self.count > complete
        self.end_ns = min(self.end_ns, time_ns)

    def stop_after(self, count: int) -> None:
        """Drop the characters behind the first ``count``."""
        self.count = count
        self.end_ns = self.start_ns + self.format.span_ns(count)
        del self._kept[count - self._first_kept :]

    @property
    def free_ns(self) -> Nanos:
        """When the station may send again: after a break the line first rests for one bit."""
        if self.is_broken and not self.count:
            return self.end_ns + NS_PER_S // self.format.baud
        return self.end_ns

    # -- levels, in fine time --

    @property
    def fine_end(self) -> int:
        """When the driver lets go."""
        return self.end_ns << FINE_BITS if self.is_broken else self.edge(self.count, 0)

    def edge(self, index: int, half_bit: int) -> int:
        """When ``half_bit`` of byte ``index`` begins."""
        half_bits = index * self.format.half_bits_per_byte + half_bit
        return (self.start_ns << FINE_BITS) - (-half_bits * FINE_PER_S // (2 * self.format.baud))

    def is_space(self, fine: int) -> bool:
        """Whether this driver pulls the line to space at ``fine``."""
        elapsed = fine - (self.start_ns << FINE_BITS)
        if elapsed < 0 or (self.is_broken and fine >= self.end_ns << FINE_BITS):
            return False
        index, half_bit = divmod(
            elapsed * 2 * self.format.baud // FINE_PER_S, self.format.half_bits_per_byte
        )
        if index >= self.count:
            return self.is_broken and not self.count
        levels, _ = shapes(self.format)[self._kept[index - self._first_kept]]
        return not levels >> half_bit & 1

    def drives(self, fine: int) -> bool:
        """Whether the driver is on at ``fine``."""
        return self.start_ns << FINE_BITS <= fine < self.fine_end

    def last_sample(self, index: int) -> int:
        """The middle of the first stop bit of the byte before ``index``: search starts there."""
        line_format = self.format
        if index == 0:
            return self.start_ns << FINE_BITS
        return self.edge(index - 1, line_format.half_bits_per_byte - line_format.stop_half_bits + 1)

    def falls(self, fine: int) -> Iterator[int]:
        """The times from ``fine`` on at which this driver goes from mark to space, in order."""
        start = self.start_ns << FINE_BITS
        if self.is_broken and not self.count:
            if start >= fine:
                yield start
            return
        elapsed = max(0, fine - start)
        first = elapsed * 2 * self.format.baud // (FINE_PER_S * self.format.half_bits_per_byte)
        table = shapes(self.format)
        end = self.fine_end
        for index in range(first, self.count):
            for half_bit in table[self._kept[index - self._first_kept]][1]:
                edge = self.edge(index, half_bit)
                if fine <= edge < end:
                    yield edge


def make_break(
    station: int, start_ns: Nanos, duration_ns: Nanos, line_format: LineFormat
) -> Transmission:
    """A break: the line at space for ``duration_ns``."""
    transmission = Transmission(station, start_ns, line_format)
    transmission.end_ns = start_ns + duration_ns
    transmission.is_broken = True
    return transmission


def is_space(line: Sequence[Transmission], station: int, fine: int) -> bool:
    """The level at ``station``'s receiver, which is off (mark) while the station itself drives."""
    space = False
    for transmission in line:
        if transmission.station == station:
            if transmission.drives(fine):
                return False
        elif not space:
            space = transmission.is_space(fine)
    return space


def next_fall(line: Sequence[Transmission], station: int, fine: int) -> int | None:
    """When ``station``'s receiver next sees mark go to space, at ``fine`` or later.

    None if no known transmission does that.
    """
    own = [each for each in line if each.station == station]
    others = [each for each in line if each.station != station]
    while True:
        for transmission in own:
            if transmission.drives(fine):
                fine = transmission.fine_end
                if is_space(line, station, fine):
                    return fine  # the receiver comes back on in the middle of somebody's space
        fall = _earliest_fall(others, fine)
        for transmission in own:
            release = transmission.fine_end
            is_first = fine < release and (fall is None or release < fall)
            if is_first and is_space(line, station, release):
                return release
        if fall is None or not any(each.drives(fall) for each in own):
            return fall
        fine = fall


def _earliest_fall(others: Sequence[Transmission], fine: int) -> int | None:
    """The earliest falling edge of the combined levels of ``others``."""
    earliest: int | None = None
    for transmission in others:
        for fall in transmission.falls(fine):
            if earliest is not None and fall >= earliest:
                break
            if not any(each.is_space(fall - 1) for each in others):
                earliest = fall
                break
    return earliest
