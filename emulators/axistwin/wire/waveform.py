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

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from functools import lru_cache
from math import gcd
from typing import NamedTuple

from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.wire.framing import LineFormat

FINE_BITS = 40
FINE_PER_S = NS_PER_S << FINE_BITS

_GRID_BYTES = 32
"""Of usual rates the edges repeat after few characters: those of so many are known beforehand."""


def parity_bit(parity: str, value: int) -> int:
    """The parity bit that belongs to ``value`` under ``parity`` (E O M S)."""
    odd = value.bit_count() & 1
    return {"E": odd, "O": odd ^ 1, "M": 1, "S": 0}[parity]


def _runs(line_format: LineFormat, value: int) -> tuple[int, ...]:
    """Where the level of a character changes, in half bits from its start: space, mark, ..."""
    bits = [1, 0] + [value >> place & 1 for place in range(line_format.data_bits)]
    if line_format.parity != "N":
        bits.append(parity_bit(line_format.parity, value & ((1 << line_format.data_bits) - 1)))
    bits.append(1)
    return tuple(2 * (n - 1) for n in range(1, len(bits)) if bits[n] != bits[n - 1])


@lru_cache(maxsize=32)
def _runs_of_bytes(line_format: LineFormat) -> tuple[tuple[int, ...], ...]:
    return tuple(_runs(line_format, value) for value in range(256))


def _fine_edge(line_format: LineFormat, half_bit: int) -> int:
    """When ``half_bit`` of a stretch begins, from its start."""
    return -(-half_bit * FINE_PER_S // (2 * line_format.baud))


@lru_cache(maxsize=32)
def _grid(line_format: LineFormat) -> tuple[int, int, tuple[int, ...]]:
    """After how many characters edges fall on the same fraction, how long that is, the edges of it.

    No edges where that is too many.
    """
    length, doubled = line_format.half_bits_per_byte, 2 * line_format.baud
    period = doubled // gcd(doubled, FINE_PER_S * length)
    count = period * length if period <= _GRID_BYTES else 0
    edges = tuple(_fine_edge(line_format, half_bit) for half_bit in range(count))
    return period, period * length * FINE_PER_S // doubled, edges


class WavePiece(NamedTuple):
    """Part of a transmission: characters from number ``first`` on, or a break without any.

    The times are relative, to whatever its user likes; ``end_ns`` is when a driver lets go that
    does not finish its character, else None.
    """

    start_ns: Nanos
    end_ns: Nanos | None
    format: LineFormat
    first: int
    data: bytes
    is_break: bool

    @property
    def fine_end(self) -> int:
        """When the driver lets go, if it does so in this piece."""
        if self.end_ns is not None:
            return self.end_ns << FINE_BITS
        half_bits = (self.first + len(self.data)) * self.format.half_bits_per_byte
        return (self.start_ns << FINE_BITS) + _fine_edge(self.format, half_bits)

    def changes(self) -> list[int]:
        """When it pulls to space, lets go, pulls, ..., in fine time."""
        start, length = self.start_ns << FINE_BITS, self.format.half_bits_per_byte
        if self.is_break:
            return [start, self.fine_end]
        runs, changes = _runs_of_bytes(self.format), []
        period, step, grid = _grid(self.format)
        for index, value in enumerate(self.data, self.first):
            if grid:
                rounds, rest = divmod(index, period)
                origin, at = start + rounds * step, rest * length
                changes += [origin + grid[at + each] for each in runs[value]]
            else:
                at = index * length
                changes += [start + _fine_edge(self.format, at + each) for each in runs[value]]
        return changes if self.end_ns is None else _before(changes, self.fine_end)


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
        return (self.start_ns << FINE_BITS) + _fine_edge(self.format, half_bits)

    def piece(self, base_ns: Nanos, begin: int, until: int) -> WavePiece:
        """What there is to look at between two fine times; ``base_ns`` is where its time begins."""
        origin, per_byte = self.start_ns << FINE_BITS, FINE_PER_S * self.format.half_bits_per_byte
        doubled = 2 * self.format.baud
        first = max(0, begin - origin) * doubled // per_byte
        last = min(self.count, (until - origin) * doubled // per_byte + 1)
        return WavePiece(
            self.start_ns - base_ns,
            self.end_ns - base_ns if self.is_broken else None,
            self.format,
            first,
            self.data(first, last) if first < last else b"",
            self.is_broken and not self.count,
        )

    def last_sample(self, index: int) -> int:
        """The middle of the first stop bit of the byte before ``index``: search starts there."""
        line_format = self.format
        if index == 0:
            return self.start_ns << FINE_BITS
        return self.edge(index - 1, line_format.half_bits_per_byte - line_format.stop_half_bits + 1)


def make_break(
    station: int, start_ns: Nanos, duration_ns: Nanos, line_format: LineFormat
) -> Transmission:
    """A break: the line at space for ``duration_ns``."""
    transmission = Transmission(station, start_ns, line_format)
    transmission.end_ns = start_ns + duration_ns
    transmission.is_broken = True
    return transmission


def level_changes(own: Iterable[WavePiece], others: Sequence[WavePiece]) -> list[int]:
    """When a receiver sees mark become space, space mark, ..., in ascending fine time.

    Of ``others`` space wins; while one of ``own`` drives, the receiver is off and sees mark.
    """
    if len(others) == 1:
        changes = others[0].changes()
    else:
        changes = []
        spaces: list[tuple[int, int]] = []
        for piece in others:
            edges = piece.changes()
            spaces += zip(edges[::2], edges[1::2], strict=True)
        for fall, rise in sorted(spaces):
            if not changes or fall > changes[-1]:
                changes += (fall, rise)
            elif rise > changes[-1]:
                changes[-1] = rise
    for piece in own:
        begin, end = piece.start_ns << FINE_BITS, piece.fine_end
        behind = bisect_right(changes, end)
        back_on = [end] if behind & 1 else []  # in the middle of somebody's space
        changes = _before(changes, begin) + back_on + changes[behind:]
    return changes


def _before(changes: list[int], end: int) -> list[int]:
    """``changes`` of a level that is mark from ``end`` on."""
    count = bisect_left(changes, end)
    return [*changes[:count], end] if count & 1 else changes[:count]
