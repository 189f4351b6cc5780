"""What goes over the lines and buses of a rack, for whoever looks on.

Rules
-----
1. Only a line that somebody watches is listened to; the others keep their transcripts and nothing
   else.
2. Between two looks at most ``PENDING_MAX`` messages of a line are kept; older ones are dropped and
   counted.
3. A watcher is first given what the line's transcript has, then each message once.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Final, TypeAlias

from axistwin.runtime.serving.rack import AnyServer
from axistwin.runtime.transcript import Message

PENDING_MAX: Final = 256


@dataclass(frozen=True, slots=True)
class LineTraffic:
    """Messages of a line in their order; ``dropped``: how many are missing in front of them."""

    event: ClassVar[str] = "traffic"
    line: str
    messages: tuple[Message, ...]
    dropped: int


TrafficWatcher: TypeAlias = Callable[[LineTraffic], None]


class WatchedLine:
    """The line ``name``, served by ``server``, while somebody watches what goes over it."""

    def __init__(self, name: str, server: AnyServer) -> None:
        self.name = name
        self.server = server
        self.watchers: list[TrafficWatcher] = []
        self._pending: deque[Message] = deque(maxlen=PENDING_MAX)
        self._dropped = 0
        self.unsubscribe = server.simulation.subscribe_messages(self._take)

    def _take(self, message: Message) -> None:
        """A message is complete; in any thread, with the line locked."""
        self._dropped += len(self._pending) == PENDING_MAX
        self._pending.append(message)

    def join(self, watcher: TrafficWatcher) -> None:
        """Give ``watcher`` what was, and what comes."""
        with self.server.simulation.present():
            self.report(at_once=True)
            watcher(LineTraffic(self.name, tuple(self.server.simulation.messages), 0))
        self.watchers.append(watcher)

    def report(self, *, at_once: bool = False) -> None:
        """Give the watchers what came since the last look; ``at_once``: unfinished bursts too."""
        simulation = self.server.simulation
        with simulation.present():
            simulation.flush_messages(at_once=at_once)
            messages, self._pending = tuple(self._pending), deque(maxlen=PENDING_MAX)
            dropped, self._dropped = self._dropped, 0
        if messages:
            for watcher in tuple(self.watchers):
                watcher(LineTraffic(self.name, messages, dropped))
