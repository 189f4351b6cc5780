"""External pulses at a constant rate, in closed form."""

from dataclasses import dataclass

from axistwin.kernel.time import NS_PER_S, Nanos

PER_MILLIHERTZ = 1000 * NS_PER_S


@dataclass(frozen=True, slots=True)
class PulseTrain:
    """Pulses of a spindle's encoder from ``origin_ns`` on; the n-th comes n periods later."""

    rate_millihertz: int
    """Pulses in 1000 s, at least 1."""
    pulses_per_turn: int = 0
    """Each so many-th pulse is an index pulse, too; 0: there are none."""
    origin_ns: Nanos = 0

    def __post_init__(self) -> None:
        assert self.rate_millihertz >= 1, f"a rate of {self.rate_millihertz} mHz"
        assert self.pulses_per_turn >= 0, f"{self.pulses_per_turn} pulses in a turn"

    def time_of(self, n: int) -> Nanos:
        """When the ``n``-th pulse [>= 1] comes, to the nearest nanosecond."""
        rate = self.rate_millihertz
        return self.origin_ns + (2 * n * PER_MILLIHERTZ + rate) // (2 * rate)

    def count_at(self, now_ns: Nanos) -> int:
        """How many pulses have come up to and including ``now_ns``."""
        elapsed_ns = now_ns - self.origin_ns
        if elapsed_ns < 0:
            return 0
        return (self.rate_millihertz * (2 * elapsed_ns + 1) - 1) // (2 * PER_MILLIHERTZ)

    def index_after(self, n: int) -> int | None:
        """The first pulse behind the ``n``-th that is an index pulse."""
        turn = self.pulses_per_turn
        return (n // turn + 1) * turn if turn else None
