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
5. A reply is also the same if the twin says it to a message that comes a little earlier or later,
   by a tenth of the window at most: a position in motion.  No message comes before the reply in
   front of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Final, TypeAlias

from axistwin.cli.replay.capture import Exchange
from axistwin.cli.replay.host_port import HostPort, TwinSetup
from axistwin.cli.replay.moments import ROUNDS_MAX, Moment, Words, words_of
from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.wire.can_frame import CanFrame

WINDOW_NS: Final = 50 * NS_PER_MS
"""By how much times may differ: adapters and operating systems hold bytes back for so long."""

MESSAGE_PART: Final = 10
"""Of the window, for the time of a message: nobody waits for the rest of it, as for a reply's."""

PATIENCE_NS: Final = NS_PER_S
"""For the last reply: a recording does not say how long it took."""


@dataclass(slots=True)
class _Told:
    """What the twin said: single bytes or frames with their times.

    sent_ns: when the message was sent.  due_ns: when it was to be, as recorded.
    """

    sent_ns: Nanos
    due_ns: Nanos
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


SameSoon: TypeAlias = dict[tuple[int, tuple[bytes | CanFrame, ...]], bool]
"""By exchange and what the twin says to it: whether rule 5 makes it the same."""


def differences(
    setup: TwinSetup,
    exchanges: Sequence[Exchange],
    window_ns: Nanos = WINDOW_NS,
    known: SameSoon | None = None,
) -> list[Difference]:
    """Where a new twin does not say what was recorded.  Raises UsageError.

    known: by rule 5, of another twin; what is found of this one is added.
    """
    known = {} if known is None else known
    found = list(_compared(exchanges, _say_again(setup, exchanges, window_ns), window_ns))
    moments = {}
    for each in found:
        key, wanted = (each.index, each.told), _words(setup, each.recorded)
        if key not in known:
            known[key] = False
            if not each.late_ns and wanted != _words(setup, each.told):
                moments[each.index] = Moment(wanted, window_ns // MESSAGE_PART)
    same = _find_moments(setup, exchanges, window_ns, moments)
    known.update({(each.index, each.told): True for each in found if each.index in same})
    return [each for each in found if not known[each.index, each.told]]


def _find_moments(
    setup: TwinSetup, exchanges: Sequence[Exchange], window_ns: Nanos, moments: dict[int, Moment]
) -> set[int]:
    """Those of the exchanges with ``moments`` that are the same by rule 5."""
    same: set[int] = set()
    for _ in range(ROUNDS_MAX):
        tried = [index for index, moment in moments.items() if index not in same and moment.go_on()]
        if not tried:
            break
        shifts = {index: moment.shift_ns for index, moment in moments.items()}
        told = _say_again(setup, exchanges, window_ns, shifts)
        differing = {each.index: each for each in _compared(exchanges, told, window_ns)}
        for index in tried:
            shift_ns = told[index].sent_ns - told[index].due_ns
            if index in differing:
                moments[index].note(shift_ns, _words(setup, differing[index].told))
            elif abs(shift_ns) <= window_ns // MESSAGE_PART:
                same.add(index)
    return same


def _compared(
    exchanges: Sequence[Exchange], told: Sequence[_Told], window_ns: Nanos
) -> Iterator[Difference]:
    """Where ``told`` is not what was recorded (rules 2 to 4)."""
    _hand_on_early_ones(exchanges, told, window_ns)
    for index, (exchange, reply) in enumerate(zip(exchanges, told, strict=True)):
        recorded = _units([part.content for part in exchange.reply])
        units = reply.units
        if index == len(exchanges) - 1:  # rule 4
            units = units[: len(recorded)]
        late_ns = _late_ns(exchange, reply, window_ns)
        if units != recorded or late_ns:
            yield Difference(index, exchange, _joined(units), late_ns)


def _say_again(
    setup: TwinSetup,
    exchanges: Sequence[Exchange],
    window_ns: Nanos,
    shifts_ns: Mapping[int, Nanos] = MappingProxyType({}),
) -> list[_Told]:
    """What a new twin says to each message (rule 1), ``shifts_ns`` later by exchange."""
    port = setup.open()
    told: list[_Told] = []
    with port.simulation:
        origin_ns = port.simulation.sync()
        for index, exchange in enumerate(exchanges):
            due_ns = origin_ns + exchange.request.at_ns
            if told:
                wanted = len(_units([part.content for part in exchanges[index - 1].reply]))
                _listen(port, due_ns + shifts_ns.get(index, 0), told[-1])
                _listen(port, port.simulation.sync() + window_ns, told[-1], wanted)
            told.append(_Told(port.simulation.sync(), due_ns))
            port.send(exchange.request.content)
        last = exchanges[-1]
        last_ns = max(part.at_ns for part in (last.request, *last.reply))
        _listen(port, origin_ns + last_ns, told[-1])
        wanted = len(_units([part.content for part in last.reply]))
        _listen(port, port.simulation.sync() + max(window_ns, PATIENCE_NS), told[-1], wanted)
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


def _words(setup: TwinSetup, parts: Sequence[bytes | CanFrame]) -> Words:
    """What they mean."""
    return words_of("; ".join(map(setup.model.explain, parts)))
