"""Asynchronous character framing: how long bytes take, and stretches of bytes on their way.

All times are derived from the start of a stretch, so that no rounding adds up: the end of byte i
is ``start + (i + 1) characters``, rounded down to a nanosecond once.
"""

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
    ``errors`` are the indices of those bytes whose stop bit was bad.  A device is handed such a
    byte in a chunk of its own.
    """

    start_ns: Nanos
    data: bytes
    format: LineFormat | None
    skipped: int = 0
    errors: tuple[int, ...] = ()

    def arrival_ns(self, index: int) -> Nanos:
        """When byte ``index`` of ``data`` is complete at the receiver."""
        if self.format is None:
            return self.start_ns
        return self.start_ns + self.format.span_ns(self.skipped + index + 1)
