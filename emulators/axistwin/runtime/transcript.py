"""What was said on a line lately: bounded, in bursts, with times; readable when something fails.

Much is noted and hardly ever read.  So what is added is kept in pieces, which are put together to
bursts when somebody looks, or when there are many; most are forgotten before that.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.wire.can_frame import CanFrame

Direction: TypeAlias = Literal["host", "device"]

ARROWS: dict[Direction, str] = {"host": ">", "device": "<"}
_BURST_MAX = 256
_HEX_MAX = 32
_PIECES_MAX = 4096


@dataclass(slots=True)
class Burst:
    """Bytes in one direction without a pause: when its first came, and when its last.

    note: why nobody understood them, if that is known.
    """

    time_ns: Nanos
    direction: Direction
    data: bytes
    last_ns: Nanos
    note: str = ""


class Message(NamedTuple):
    """What went over a line or a bus in one piece: bytes without a pause, a frame, a USB report.

    time_ns: when a burst began, a frame was complete, or a host sent or read a report.  note: as of
    a burst.
    """

    time_ns: Nanos
    direction: Direction
    content: bytes | CanFrame
    note: str = ""


MessageSubscriber: TypeAlias = Callable[[Message], None]


class Transcript:
    """The last ``limit`` bursts, of at most 256 bytes each.

    pause_ns: a longer silence ends a burst.
    """

    def __init__(self, limit: int = 200, pause_ns: Nanos = 5 * NS_PER_MS) -> None:
        assert limit > 0
        self.pause_ns = pause_ns
        self._bursts: deque[Burst] = deque(maxlen=limit)
        self._is_open = False
        self._pieces: list[tuple[Nanos, Direction, bytes, str]] = []
        self._subscribers: list[Callable[[Burst], None]] = []

    def subscribe(self, subscriber: Callable[[Burst], None]) -> Callable[[], None]:
        """Give each burst from now on to ``subscriber`` when it is over: when the next begins, or
        at ``flush``.  Call what is returned to end that.
        """
        self.flush()
        self._subscribers.append(subscriber)
        return lambda: self._subscribers.remove(subscriber)

    def add(self, time_ns: Nanos, direction: Direction, data: bytes, note: str = "") -> None:
        """Keep ``data``; it joins the last burst unless that went the other way or is over.

        note: shown in place of the meaning.
        """
        if data:
            self._pieces.append((time_ns, direction, data, note))
            if self._subscribers or len(self._pieces) >= _PIECES_MAX:
                self._join_pieces()

    def _join_pieces(self) -> None:
        pieces, self._pieces = self._pieces, []
        first = 0 if self._subscribers else self._first_kept(pieces)
        if first:
            self._end_burst()
        for piece in pieces[first:]:
            self._join(*piece)

    def _first_kept(self, pieces: list[tuple[Nanos, Direction, bytes, str]]) -> int:
        """Which piece begins the oldest burst that is not pushed out by those behind it."""
        room = self._bursts.maxlen
        assert room is not None
        for index in range(len(pieces) - 1, 0, -1):
            if pieces[index][1] != pieces[index - 1][1]:  # a burst has one direction
                room -= 1
                if not room:
                    return index
        return 0

    def _join(self, time_ns: Nanos, direction: Direction, data: bytes, note: str) -> None:
        last = self._bursts[-1] if self._is_open else None
        if (
            last is not None
            and last.direction == direction
            and last.note == note
            and time_ns - last.last_ns <= self.pause_ns
            and len(last.data) + len(data) <= _BURST_MAX
        ):
            last.data += data
            last.last_ns = time_ns
            return
        for start in range(0, len(data), _BURST_MAX):
            self._end_burst()
            piece = data[start : start + _BURST_MAX]
            self._bursts.append(Burst(time_ns, direction, piece, time_ns, note))
            self._is_open = True

    def flush(self) -> None:
        """The last burst is over; what comes begins another."""
        self._join_pieces()
        self._end_burst()

    def flush_at(self, time_ns: Nanos) -> None:
        """``flush`` if nothing was added for ``pause_ns``."""
        self._join_pieces()
        if self._bursts and time_ns - self._bursts[-1].last_ns > self.pause_ns:
            self._end_burst()

    def _end_burst(self) -> None:
        if self._is_open:
            self._is_open = False
            for subscriber in tuple(self._subscribers):
                subscriber(self._bursts[-1])

    def clear(self) -> None:
        """Forget everything."""
        self._pieces.clear()
        self._bursts.clear()
        self._is_open = False

    def __len__(self) -> int:
        self._join_pieces()
        return len(self._bursts)

    def __iter__(self) -> Iterator[Burst]:
        self._join_pieces()
        return iter(tuple(self._bursts))

    def render(self, explain: Callable[[bytes], str] | None = None) -> str:
        """One line per burst: time in ms, ``>`` from the host or ``<`` to it, hex, meaning."""
        return "\n".join(render_burst(burst, explain) for burst in self)


def render_burst(burst: Burst, explain: Callable[[bytes], str] | None = None) -> str:
    """One line: time in ms, ``>`` from the host or ``<`` to it, hex, meaning."""
    data = burst.data
    shown = data[:_HEX_MAX].hex(" ").upper()
    if len(data) > _HEX_MAX:
        shown += f" … {len(data)} bytes"
    line = f"{burst.time_ns / NS_PER_MS:12.3f} ms {ARROWS[burst.direction]} {shown}"
    meaning = burst.note or (explain(data) if explain else "")
    return f"{line}  {meaning}".rstrip()
