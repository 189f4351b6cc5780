"""Asynchronous character framing: how long bytes take, and stretches of bytes on their way.

All times are derived from the start of a stretch, so that no rounding adds up: the end of byte i
is ``start + (i + 1) characters``, rounded down to a nanosecond once.
"""

from dataclasses import dataclass

from axistwin.kernel.time import NS_PER_S, Nanos

PARITIES = "NEOMS"


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

    def __post_init__(self) -> None:
        assert self.baud > 0
        assert 5 <= self.data_bits <= 8
        assert self.parity in PARITIES
        assert self.stop_half_bits in (2, 3, 4)

    @property
    def half_bits_per_byte(self) -> int:
        """Length of one character, start and stop bits included, in half bits."""
        return 2 + 2 * self.data_bits + (0 if self.parity == "N" else 2) + self.stop_half_bits

    def span_ns(self, count: int) -> Nanos:
        """Time that ``count`` characters take back to back, in nanoseconds."""
        return count * self.half_bits_per_byte * NS_PER_S // (2 * self.baud)

    def __str__(self) -> str:
        stop = {2: "1", 3: "1.5", 4: "2"}[self.stop_half_bits]
        return f"{self.baud} {self.data_bits}{self.parity}{stop}"


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes that arrive back to back at one receiver, as its UART understood them.

    ``start_ns`` is the beginning of the first start bit; ``format`` gives the spacing, or None on a
    line without pacing, where every byte arrives at ``start_ns``.
    """

    start_ns: Nanos
    data: bytes
    format: LineFormat | None

    def arrival_ns(self, index: int) -> Nanos:
        """When byte ``index`` is complete at the receiver."""
        if self.format is None:
            return self.start_ns
        return self.start_ns + self.format.span_ns(index + 1)
