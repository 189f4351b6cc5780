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

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from functools import lru_cache
from typing import Final, NamedTuple

from axistwin.kernel.time import Nanos
from axistwin.wire.framing import Chunk, LineFormat
from axistwin.wire.waveform import (
    FINE_BITS,
    FINE_PER_S,
    Transmission,
    WavePiece,
    level_changes,
    parity_bit,
)

# An edge and a sample that coincide exactly may be rounded this far apart, in fine time.
ROUNDING = 2

WINDOW_CHARACTERS = 64
"""How far a receiver looks ahead, in characters of its own: what it finds may be thrown away."""


@lru_cache(maxsize=32)
def sample_offsets(line_format: LineFormat) -> tuple[int, ...]:
    """The middle of start, data, parity and stop bit, in fine time from the edge."""
    bits = 1 + line_format.data_bits + (line_format.parity != "N") + 1
    # rounded up like the edges, so that a sample that falls on an edge sees the new level
    return tuple(-(-(2 * n + 1) * FINE_PER_S // (2 * line_format.baud)) for n in range(bits))


@lru_cache(maxsize=32)
def _character_span(line_format: LineFormat) -> int:
    return -(-line_format.half_bits_per_byte * FINE_PER_S // (2 * line_format.baud))


class Sampled(NamedTuple):
    """Characters as sampled, in order: where each begins, where the search goes on, its time.

    errors: the places of those whose stop bit or parity is wrong.  glitches: edges that begin no
    character, and where that is known.  rest: where there is more to be looked at, if not all was.
    """

    edges: list[int]
    resumes: list[int]
    dones_ns: list[Nanos]
    data: bytes
    errors: list[int]
    glitches: list[tuple[int, int]]
    rest: int | None


_SILENCE: Final = Sampled([], [], [], b"", [], [], None)


@lru_cache(maxsize=128)  # who polls says the same all the time, and is answered the same
def sample(
    line_format: LineFormat,
    begin: int,
    until: int | None,
    own: tuple[WavePiece, ...],
    others: tuple[WavePiece, ...],
) -> Sampled:
    """What a receiver gets that looks for an edge from the fine time ``begin`` on.

    until: how far it knows the line; None: to its end.  ``own`` are its own station's pieces.
    """
    changes = level_changes(own, others)
    offsets, span = sample_offsets(line_format), _character_span(line_format)
    first, last, count = offsets[0], offsets[-1], len(changes)
    masks = [(1 << place) - 1 for place in range(len(offsets) + 1)]
    edges, spaces, glitches = [], [], []
    limit = changes[-1] if changes else 0
    if until is not None:
        limit = until - last
    resume = begin
    at = bisect_left(changes, begin)
    at += at & 1
    while at < count and (edge := changes[at]) < limit:
        end = bisect_right(changes, edge + last, at)
        space = masks[-1] if end - at & 1 else 0  # bit n: whether sample n is space
        for change in changes[at:end]:
            space ^= masks[bisect_left(offsets, change - edge)]
        if space & 1:
            edges.append(edge)
            spaces.append(space)
            resume = edge + last - ROUNDING
        else:
            resume = edge + first - ROUNDING
            glitches.append((edge, resume))
        at = bisect_left(changes, resume, at)
        at += at & 1
    values, errors = _understood(line_format, spaces)
    return Sampled(
        edges,
        [edge + last - ROUNDING for edge in edges],
        [edge + span >> FINE_BITS for edge in edges],
        bytes(values),
        errors,
        glitches,
        None if until is None else max(limit, resume),
    )


def _understood(line_format: LineFormat, spaces: Sequence[int]) -> tuple[list[int], list[int]]:
    """The values of characters whose samples are space where a bit is set, and the bad ones."""
    data_mask = (1 << line_format.data_bits) - 1
    stop = 1 << len(sample_offsets(line_format)) - 1
    values = [~each >> 1 & data_mask for each in spaces]
    if line_format.parity == "N":
        return values, [place for place, each in enumerate(spaces) if each & stop]
    errors = []
    for place, (space, value) in enumerate(zip(spaces, values, strict=True)):
        mark = not space & stop >> 1
        if space & stop or mark != bool(parity_bit(line_format.parity, value)):
            errors.append(place)
    return values, errors


class UartReceiver:
    """The receiver of ``stations`` that hear the same; it has consumed all before ``searched``.

    Of several stations none drives the line.  Times are kept relative to ``_base_ns``.
    """

    __slots__ = ("_at", "_base_ns", "_glitches", "_sampled", "format", "searched", "stations")

    def __init__(
        self, stations: tuple[int, ...], line_format: LineFormat, searched: int = 0
    ) -> None:
        self.stations = stations
        self.format = line_format
        self.searched = searched
        self._sampled: Sampled | None = None
        self._base_ns: Nanos = 0
        self._at = 0
        self._glitches: list[tuple[int, int]] = []  # not known to be such yet; absolute

    def invalidate(self) -> None:
        """Look again: the line ahead has changed."""
        self._sampled = None
        self._glitches = []

    def next_edge(self, line: Sequence[Transmission]) -> int | None:
        """Where the next character on ``line`` may begin as it is known; None: nowhere."""
        sampled = self._look(line)
        edges = [edge for edge, _ in self._glitches[:1]]
        if sampled is not None:
            edges.append(sampled.edges[self._at] + (self._base_ns << FINE_BITS))
        return min(edges, default=None)

    def next_done_ns(self, line: Sequence[Transmission]) -> Nanos | None:
        """When the next character counts as heard; None: there is none."""
        sampled = self._look(line)
        return None if sampled is None else sampled.dones_ns[self._at] + self._base_ns

    def characters(self, limit_ns: Nanos) -> Chunk:
        """What counts as heard by ``limit_ns``; ``next_done_ns`` has said that there is some."""
        sampled, at, base_ns = self._sampled, self._at, self._base_ns
        assert sampled is not None
        end = bisect_right(sampled.dones_ns, limit_ns - base_ns, at)
        errors: tuple[int, ...] = ()
        if sampled.errors:
            first, behind = bisect_left(sampled.errors, at), bisect_left(sampled.errors, end)
            errors = tuple(each - at for each in sampled.errors[first:behind])
        data = sampled.data[at:end]
        return Chunk(base_ns, data, self.format, at, errors, sampled.dones_ns)

    def take(self, count: int) -> Nanos:
        """Consume so many characters; returns the time of the last."""
        sampled = self._sampled
        assert sampled is not None
        self._at += count
        self.searched = sampled.resumes[self._at - 1] + (self._base_ns << FINE_BITS)
        return sampled.dones_ns[self._at - 1] + self._base_ns

    def pass_time(self, now_ns: Nanos) -> None:
        """Nothing is to be taken before ``now_ns``: the line up to there is not needed any more."""
        sampled, fine = self._sampled, now_ns << FINE_BITS
        if sampled is None:
            return
        ahead = sampled.edges[self._at] if self._at < len(sampled.edges) else sampled.rest
        is_idle = ahead is None or ahead + (self._base_ns << FINE_BITS) >= fine
        if self._glitches:
            self._glitches = [each for each in self._glitches if each[1] > fine]
            is_idle = is_idle and not (self._glitches and self._glitches[0][0] < fine)
        if is_idle and fine > self.searched:
            self.searched = fine

    def _look(self, line: Sequence[Transmission]) -> Sampled | None:
        """Samples of which the next is number ``_at``; None if nothing is to come."""
        sampled, width = self._sampled, WINDOW_CHARACTERS * _character_span(self.format)
        begin = self.searched
        while sampled is None or self._at == len(sampled.edges):
            if sampled is not None:
                if sampled.rest is None:
                    return None
                begin = sampled.rest + (self._base_ns << FINE_BITS)
            self._sampled = sampled = self._sample(line, begin, width)
            self._at = 0
            origin = self._base_ns << FINE_BITS
            self._glitches += [(edge + origin, end + origin) for edge, end in sampled.glitches]
            width *= 2
        return sampled

    def _sample(self, line: Sequence[Transmission], begin: int, width: int) -> Sampled:
        """What comes on ``line`` from ``begin`` on, in a window of that ``width``."""
        station = self.stations[0]
        near = [each for each in line if each.fine_end >= begin]
        starts = [each.start_ns for each in near if each.station != station]
        if not starts:
            return _SILENCE
        self._base_ns = base_ns = min(starts)
        origin = base_ns << FINE_BITS
        until = max(begin, origin) + width
        own: list[WavePiece] = []
        others: list[WavePiece] = []
        for each in near:
            if each.start_ns << FINE_BITS < until:
                piece = each.piece(base_ns, begin, until)
                (own if each.station == station else others).append(piece)
        is_all = all(each.fine_end <= until for each in near)
        return sample(
            self.format,
            max(0, begin - origin),
            None if is_all else until - origin,
            tuple(own),
            tuple(others),
        )
