"""Whether a twin says what was recorded: a recording is said to it again, exchange by exchange.

Rules
-----
1. The host's messages are sent at the recorded times, in virtual time.  A message is held back,
   at most by the window, while the twin has not said all that the recorded reply before it has.
2. Replies are compared byte by byte or frame by frame, and by the time of each recorded part, both
   counted from the message; these may differ by the window.
3. What the twin says up to the window before the host's next message, and the recording has right
   behind that, belongs there.
4. A recording may end at any time: what the twin says behind the end of it is not compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

from axistwin.cli.replay.capture import Exchange
from axistwin.cli.replay.host_port import HostPort, TwinSetup
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.wire.can_frame import CanFrame

WINDOW_NS: Final = 50 * NS_PER_MS
"""By how much times may differ: adapters and operating systems hold bytes back for so long."""


@dataclass(slots=True)
class _Told:
    """What the twin said: single bytes or frames with their times; ``sent_ns``: of the message."""

    sent_ns: Nanos
    units: list[Any] = field(default_factory=list)
    times_ns: list[Nanos] = field(default_factory=list)

    def add(self, now_ns: Nanos, parts: Sequence[bytes | CanFrame]) -> None:
        """Keep what came at ``now_ns``."""
        for unit in _units(parts):
            self.units.append(unit)
            self.times_ns.append(now_ns)


@dataclass(frozen=True, slots=True)
class Difference:
    """An exchange in which the twin says something else, or at another time.

    index: of the exchange.  told: by the twin.
    late_ns: how much later than recorded its first part comes that is out of time; 0: none is.
    """

    index: int
    exchange: Exchange
    told: tuple[bytes | CanFrame, ...]
    late_ns: Nanos

    @property
    def recorded(self) -> tuple[bytes | CanFrame, ...]:
        """The reply of the recording."""
        return _joined(_units([part.content for part in self.exchange.reply]))

    @property
    def is_content(self) -> bool:
        """Whether the twin says something else, not just at another time."""
        return self.recorded != self.told


def differences(
    setup: TwinSetup, exchanges: Sequence[Exchange], window_ns: Nanos = WINDOW_NS
) -> list[Difference]:
    """Where a new twin does not say what was recorded.  Raises UsageError."""
    port = setup.open()
    with port.simulation:
        told = _say_again(port, exchanges, window_ns)
    _hand_on_early_ones(exchanges, told, window_ns)
    found = []
    for index, (exchange, reply) in enumerate(zip(exchanges, told, strict=True)):
        recorded = _units([part.content for part in exchange.reply])
        units = reply.units
        if index == len(exchanges) - 1:  # rule 4
            units = units[: len(recorded)]
        late_ns = _late_ns(exchange, reply, window_ns)
        if units != recorded or late_ns:
            found.append(Difference(index, exchange, _joined(units), late_ns))
    return found


def _say_again(port: HostPort, exchanges: Sequence[Exchange], window_ns: Nanos) -> list[_Told]:
    """What the twin says to each message (rule 1)."""
    origin_ns = port.simulation.sync()
    told: list[_Told] = []
    for exchange, following in zip(exchanges, [*exchanges[1:], None], strict=True):
        reply = _Told(port.simulation.sync())
        told.append(reply)
        port.send(exchange.request.content)
        last_ns = max(part.at_ns for part in (exchange.request, *exchange.reply))
        _listen(port, origin_ns + (following.request.at_ns if following else last_ns), reply)
        wanted = len(_units([part.content for part in exchange.reply]))
        until_ns = port.simulation.sync() + window_ns
        _listen(port, until_ns, reply, wanted)
    return told


def _listen(port: HostPort, until_ns: Nanos, reply: _Told, wanted: int | None = None) -> None:
    """Take what comes until then, or until ``wanted`` bytes or frames are there."""
    simulation = port.simulation
    reply.add(simulation.sync(), port.received())
    while simulation.sync() < until_ns and (wanted is None or len(reply.units) < wanted):
        reply.add(port.listen(until_ns), port.received())


def _hand_on_early_ones(
    exchanges: Sequence[Exchange], told: Sequence[_Told], window_ns: Nanos
) -> None:
    """Rule 3."""
    for index, (reply, following) in enumerate(pairwise(told)):
        recorded = _units([part.content for part in exchanges[index].reply])
        begin = len(recorded)
        surplus = reply.units[begin:]
        expected = _units([part.content for part in exchanges[index + 1].reply])
        if (
            surplus
            and reply.units[:begin] == recorded
            and surplus == expected[: len(surplus)]
            and reply.times_ns[begin] >= following.sent_ns - window_ns
        ):
            following.units[:0], following.times_ns[:0] = surplus, reply.times_ns[begin:]
            del reply.units[begin:], reply.times_ns[begin:]


def _late_ns(exchange: Exchange, reply: _Told, window_ns: Nanos) -> Nanos:
    """How much too late, or early, the first part is that is out of time (rule 2)."""
    place = 0
    for part in exchange.reply:
        if place >= len(reply.units):
            break
        recorded_ns = part.at_ns - exchange.request.at_ns
        late_ns = reply.times_ns[place] - reply.sent_ns - recorded_ns
        if abs(late_ns) > window_ns:
            return late_ns
        place += len(_units([part.content]))
    return 0


def _units(parts: Sequence[bytes | CanFrame]) -> list[Any]:
    """Single bytes, as numbers, or frames."""
    units: list[Any] = []
    for part in parts:
        units += part if isinstance(part, bytes) else [part]
    return units


def _joined(units: Sequence[Any]) -> tuple[bytes | CanFrame, ...]:
    """Bytes together, frames one by one."""
    if units and isinstance(units[0], int):
        return (bytes(units),)
    return tuple(units)
