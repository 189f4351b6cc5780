"""The receiving half of a UART: what a station makes of the levels on the line.

Rules
-----
1. A character begins at a falling edge.  If the line is back at mark half a bit later, it was a
   glitch and the search goes on from there.
2. Each bit is sampled once, in its middle, counted from that edge at the receiver's own rate.
3. Data bits come lowest first; then the parity bit, if any; then one stop bit, which must be mark
   (a second stop bit is not looked at).
4. After the sample of the stop bit, good or bad, the search for the next falling edge begins.  A
   line that stays at space (a break) therefore gives one bad character, not many.
5. A character with a bad stop bit or bad parity is handed to a device as sampled, with word that it
   is bad.  The host's end gives NUL in its place, as a POSIX terminal does that checks its input
   (``INPCK`` without ``PARMRK``).
6. The byte counts as heard one whole character after its edge.

Two rates understand each other as long as the last sample, 9.5 bits after the edge in 8N1, still
falls into the right bit: about ±5 %.  No rate is compared with another anywhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from axistwin.kernel.time import Nanos
from axistwin.wire.framing import LineFormat
from axistwin.wire.waveform import (
    FINE_BITS,
    FINE_PER_S,
    Transmission,
    is_space,
    next_fall,
    parity_bit,
)

# An edge and a sample that coincide exactly may be rounded this far apart, in fine time.
ROUNDING = 2


@dataclass(frozen=True, slots=True)
class Character:
    """One character as sampled, or None as ``value`` for a glitch, which is none.

    ``edge`` and ``resume`` (where the search goes on) are fine times; it counts at ``done_ns``.
    ``is_bad``: stop bit or parity were wrong.
    """

    edge: int
    resume: int
    done_ns: Nanos
    value: int | None
    is_bad: bool = False


@lru_cache(maxsize=32)
def _sample_offsets(line_format: LineFormat) -> tuple[int, ...]:
    """The middle of start, data, parity and stop bit, in fine time from the edge."""
    bits = 1 + line_format.data_bits + (line_format.parity != "N") + 1
    # rounded up like the edges, so that a sample that falls on an edge sees the new level
    return tuple(-(-(2 * n + 1) * FINE_PER_S // (2 * line_format.baud)) for n in range(bits))


@lru_cache(maxsize=32)
def _character_span(line_format: LineFormat) -> int:
    return -(-line_format.half_bits_per_byte * FINE_PER_S // (2 * line_format.baud))


class UartReceiver:
    """One station's receiver.  It has consumed the line up to the fine time ``searched``."""

    __slots__ = ("_character", "_is_known", "format", "is_host", "searched", "station")

    def __init__(self, station: int, line_format: LineFormat, *, is_host: bool) -> None:
        self.station = station
        self.format = line_format
        self.is_host = is_host
        self.searched = 0
        self._character: Character | None = None
        self._is_known = False

    def search_from(self, fine: int) -> None:
        """Look for a falling edge at ``fine`` or later; what was under way is forgotten."""
        self.searched = fine
        self._is_known = False

    def invalidate(self) -> None:
        """Look again: the line ahead has changed."""
        self._is_known = False

    def take(self, character: Character) -> None:
        """Consume ``character`` and look for the next one."""
        self.search_from(character.resume)

    def pass_time(self, fine: int) -> None:
        """Nothing began before ``fine``: the line up to there is not needed any more."""
        is_idle = self._character is None or self._character.edge >= fine
        if self._is_known and is_idle and fine > self.searched:
            self.searched = fine

    def next_character(self, line: Sequence[Transmission]) -> Character | None:
        """The next character on ``line`` as it is known, or None if no edge is to come."""
        if not self._is_known:
            edge = next_fall(line, self.station, self.searched)
            self._character = None if edge is None else self._sample(line, edge)
            self._is_known = True
        return self._character

    def _sample(self, line: Sequence[Transmission], edge: int) -> Character:
        station = self.station
        offsets = _sample_offsets(self.format)
        if not is_space(line, station, edge + offsets[0]):
            resume = edge + offsets[0] - ROUNDING
            return Character(edge, resume, -(-resume >> FINE_BITS), None)
        value = 0
        for place in range(self.format.data_bits):
            if not is_space(line, station, edge + offsets[1 + place]):
                value |= 1 << place
        good = not is_space(line, station, edge + offsets[-1])
        if self.format.parity != "N":
            mark = not is_space(line, station, edge + offsets[-2])
            good = good and mark == bool(parity_bit(self.format.parity, value))
        resume = edge + offsets[-1] - ROUNDING
        done_ns = edge + _character_span(self.format) >> FINE_BITS
        if not good and self.is_host:
            value = 0
        return Character(edge, resume, done_ns, value, is_bad=not good)
