"""What was said on a line lately: bounded, in bursts, with times; readable when something fails."""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

from axistwin.kernel.time import NS_PER_MS, Nanos

Direction: TypeAlias = Literal["host", "device"]

_ARROWS: dict[Direction, str] = {"host": ">", "device": "<"}
_PAUSE_NS: Nanos = 5 * NS_PER_MS
_BURST_MAX = 256
_HEX_MAX = 32


@dataclass(slots=True)
class Burst:
    """Bytes in one direction without a pause: when its first came, and when its last."""

    time_ns: Nanos
    direction: Direction
    data: bytes
    last_ns: Nanos


class Transcript:
    """The last ``limit`` bursts, of at most 256 bytes each.

    on_burst: called with each burst when it is over, that is, when the next begins or at ``flush``.
    """

    def __init__(self, limit: int = 200) -> None:
        assert limit > 0
        self._bursts: deque[Burst] = deque(maxlen=limit)
        self._is_open = False
        self.on_burst: Callable[[Burst], None] | None = None

    def add(self, time_ns: Nanos, direction: Direction, data: bytes) -> None:
        """Note ``data``; it joins the last burst unless that went the other way or is over."""
        if not data:
            return
        last = self._bursts[-1] if self._is_open else None
        if (
            last is not None
            and last.direction == direction
            and time_ns - last.last_ns <= _PAUSE_NS
            and len(last.data) + len(data) <= _BURST_MAX
        ):
            last.data += data
            last.last_ns = time_ns
            return
        for start in range(0, len(data), _BURST_MAX):
            self.flush()
            piece = data[start : start + _BURST_MAX]
            self._bursts.append(Burst(time_ns, direction, piece, time_ns))
            self._is_open = True

    def flush(self) -> None:
        """The last burst is over; what comes begins another."""
        if self._is_open:
            self._is_open = False
            if self.on_burst is not None:
                self.on_burst(self._bursts[-1])

    def clear(self) -> None:
        """Forget everything."""
        self._bursts.clear()
        self._is_open = False

    def __len__(self) -> int:
        return len(self._bursts)

    def __iter__(self) -> Iterator[Burst]:
        return iter(tuple(self._bursts))

    def render(self, explain: Callable[[bytes], str] | None = None) -> str:
        """One line per burst: time in ms, ``>`` from the host or ``<`` to it, hex, meaning."""
        return "\n".join(render_burst(burst, explain) for burst in self)


def render_burst(burst: Burst, explain: Callable[[bytes], str] | None = None) -> str:
    """One line: time in ms, ``>`` from the host or ``<`` to it, hex, meaning."""
    data = burst.data
    shown = data[:_HEX_MAX].hex(" ")
    if len(data) > _HEX_MAX:
        shown += f" … {len(data)} bytes"
    line = f"{burst.time_ns / NS_PER_MS:12.3f} ms {_ARROWS[burst.direction]} {shown}"
    return f"{line}  {explain(data)}".rstrip() if explain else line
