"""Asynchronous character framing: how long bytes take, and stretches of bytes on their way.

All times are derived from the start of a stretch, so that no rounding adds up: the end of byte i
is ``start + (i + 1) characters``, rounded down to a nanosecond once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from axistwin.kernel.time import NS_PER_S, Nanos

PARITIES = "NEOMS"

_SPANS = 32
"""Of so many lengths the time is known beforehand: those of frames, asked for all the time."""


@dataclass(frozen=True, slots=True)
class LineFormat:
    """Rate and framing of one station: 38400 8N1 and its kin.

    baud: bits per second, > 0.  data_bits: 5..8.  parity: one of N E O M S.
    stop_half_bits: 2, 3 or 4 (one, one and a half, two stop bits).
    """

    baud: int
    data_bits: int = 8
    parity: str = "N"
    stop_half_bits: int = 2
    # Length of one character, start and stop bits included, in half bits.
    half_bits_per_byte: int = field(init=False, repr=False, compare=False)
    _spans_ns: tuple[Nanos, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        assert self.baud > 0
        assert 5 <= self.data_bits <= 8
        assert self.parity in PARITIES
        assert self.stop_half_bits in (2, 3, 4)
        parity_half_bits = 0 if self.parity == "N" else 2
        length = 2 + 2 * self.data_bits + parity_half_bits + self.stop_half_bits
        object.__setattr__(self, "half_bits_per_byte", length)
        spans_ns = tuple(n * length * NS_PER_S // (2 * self.baud) for n in range(_SPANS))
        object.__setattr__(self, "_spans_ns", spans_ns)

    def span_ns(self, count: int) -> Nanos:
        """Time that ``count`` characters take back to back, in nanoseconds."""
        if 0 <= count < _SPANS:
            return self._spans_ns[count]
        return count * self.half_bits_per_byte * NS_PER_S // (2 * self.baud)

    def characters_within(self, elapsed_ns: Nanos) -> int:
        """How many characters are complete ``elapsed_ns`` after the first start bit began.

        The exact inverse of ``span_ns``: the largest n with ``span_ns(n) <= elapsed_ns``.
        """
        if elapsed_ns < 0:
            return 0
        return ((elapsed_ns + 1) * 2 * self.baud - 1) // (self.half_bits_per_byte * NS_PER_S)

    def __str__(self) -> str:
        stop = {2: "1", 3: "1.5", 4: "2"}[self.stop_half_bits]
        return f"{self.baud} {self.data_bits}{self.parity}{stop}"


class Chunk(NamedTuple):  # made for every stretch: a third of a frozen dataclass's time
    """Bytes that arrive back to back at one receiver, as its UART understood them.

    ``start_ns`` is the beginning of the first start bit of the stretch they belong to, of which
    ``skipped`` bytes were handed over earlier; ``format`` gives the spacing, or None on a line
    without pacing, where every byte arrives at ``start_ns``.  Receivers go by ``arrival_ns`` alone.
    ``times_ns`` are those of all bytes of the stretch from ``start_ns`` on, where there is no
    regular spacing.  ``errors`` are the indices, in ascending order, of those bytes whose stop bit
    was bad.  A device that does not drop them is handed such a byte in a chunk of its own.
    """

    start_ns: Nanos
    data: bytes
    format: LineFormat | None
    skipped: int = 0
    errors: tuple[int, ...] = ()
    times_ns: Sequence[Nanos] | None = None

    def arrival_ns(self, index: int) -> Nanos:
        """When byte ``index`` of ``data`` is complete at the receiver."""
        if self.format is None:
            return self.start_ns
        if self.times_ns is not None:
            return self.start_ns + self.times_ns[self.skipped + index]
        return self.start_ns + self.format.span_ns(self.skipped + index + 1)

    @property
    def end(self) -> int:
        """How many bytes of the stretch there are up to its last one."""
        return self.skipped + len(self.data)

    def first(self, count: int) -> "Chunk":
        """The first ``count`` bytes of it."""
        if count >= len(self.data):
            return self
        start_ns, data, line_format, skipped, errors, times_ns = self
        if errors:
            errors = tuple(each for each in errors if each < count)
        return Chunk(start_ns, data[:count], line_format, skipped, errors, times_ns)

    def without_errors(self) -> "Chunk":
        """The good bytes of it alone."""
        bad = set(self.errors)
        good = [place for place in range(len(self.data)) if place not in bad]
        times_ns = [self.arrival_ns(place) - self.start_ns for place in good]
        data = bytes(self.data[place] for place in good)
        return Chunk(self.start_ns, data, self.format, times_ns=times_ns)

    def with_nul(self) -> "Chunk":
        """As a POSIX terminal tells it that checks its input: NUL in the place of a bad byte."""
        if not self.errors:
            return self
        start_ns, data, line_format, skipped, errors, times_ns = self
        shown = bytearray(data)
        for place in errors:
            shown[place] = 0
        return Chunk(start_ns, bytes(shown), line_format, skipped, (), times_ns)
