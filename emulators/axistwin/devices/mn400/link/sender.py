"""What a board sends on one of its ports, message after message.

Rules
-----
1. Messages leave in the order in which they were given, none before its time, none before the
   one in front of it has left (MN4-PKT-08).
2. A message whose content is known is handed to the line at once; one that depends on the moment
   (a read-out, the rate of the line) is made when its moment has come (MN4-RSP-15).
3. A board keeps its last message, to send it again (MN4-CMD-RTX-01).
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import Nanos


class Reply(NamedTuple):
    """A status packet, or with a ``value`` a data packet, of the board with number ``address``."""

    address: int
    command: int
    code: int = 0
    value: str | None = None


SendMessage: TypeAlias = Callable[[Nanos, Reply], Nanos | None]
"""Sends a message at a time, and tells when it has left; None: the port does not send it."""


class ReplyPart(NamedTuple):
    """A message of a reply, or what gives it (or nothing) in its moment.

    wait_ns: how long after the one before.
    """

    message: Reply | Callable[[Nanos], Reply | None]
    wait_ns: Nanos = 0


class ReplySender:
    """The sending half of a port.  is_ahead: what is known may be sent before its time."""

    def __init__(self, send: SendMessage, *, is_ahead: bool) -> None:
        self._send_message = send
        self._is_ahead = is_ahead
        self.parts: deque[tuple[Nanos, ReplyPart]] = deque()
        """What is still to be sent, and when at the earliest."""
        self._free_ns: Nanos = 0
        self._not_before: Nanos = 0
        self.last: Reply | None = None

    def reset(self, now: Nanos) -> None:
        """Drop what is to be sent, and forget what was sent."""
        self.parts.clear()
        self._free_ns = self._not_before = now
        self.last = None

    @property
    def is_silent(self) -> bool:
        """Whether nothing waits to be sent; the last bytes may still be on their way."""
        return not self.parts

    @property
    def free_ns(self) -> Nanos:
        """When the last message has left."""
        return self._free_ns

    def send(self, start_ns: Nanos, parts: Sequence[ReplyPart]) -> None:
        """Send ``parts``, the first one at ``start_ns`` at the earliest."""
        for part in parts:
            self.parts.append((start_ns, part))

    def next_event(self) -> Nanos:
        """When the next part is to be made."""
        if not self.parts:
            return NEVER
        earliest_ns, part = self.parts[0]
        return max(earliest_ns, self._free_ns + part.wait_ns, self._not_before)

    def run(self, now: Nanos) -> None:
        """Send what can be sent at ``now``."""
        has_sent = False
        parts = self.parts
        while parts:
            start_ns, (given, wait_ns) = parts[0]
            if self._free_ns + wait_ns > start_ns:
                start_ns = self._free_ns + wait_ns
            message: Reply | None
            if isinstance(given, Reply):
                if start_ns > now and not self._is_ahead:
                    return
                message = given
            elif start_ns > now or self._not_before > now:
                return
            elif has_sent:  # the rate may change: not within the call that sends the one before
                self._not_before = now + 1
                return
            else:
                message = given(start_ns)
            parts.popleft()
            self._free_ns = start_ns
            left_ns = None if message is None else self._send_message(start_ns, message)
            if left_ns is not None:
                self._free_ns, self.last, has_sent = left_ns, message, True
