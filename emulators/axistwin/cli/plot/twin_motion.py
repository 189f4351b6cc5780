"""Motion of a twin in virtual time that is told commands, as ``send`` does or a recording has it.

Rules
-----
1. What is said is played twice: once to learn when axes move, then with as many looks at them as a
   picture shows, evenly over that time.  Both are the same, since time is virtual.
2. Of a recording, the host's half is said at the times that it has.  The twin's replies are
   compared with the recorded ones: where they differ, the device of the recording may have moved
   otherwise than the twin.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from axistwin import catalog
from axistwin.cli.plot.track import MARGIN, MotionTrack
from axistwin.devices.controls import AxisView
from axistwin.devices.family import Model, Value
from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.runtime.bus import Bus
from axistwin.runtime.clock import VirtualClock
from axistwin.runtime.line import Line
from axistwin.wire.can_frame import CanFrame

LOOKS: Final = 4000
"""More than a picture has columns."""

PATIENCE_NS: Final = 2 * NS_PER_S
"""For a reply."""

GAP_NS: Final = 20 * NS_PER_MS
"""A silence that ends a reply."""

_STEP_NS: Final = NS_PER_MS
_LAST_NS: Final = 100 * NS_PER_MS
"""In which what was said last is heard and obeyed."""

_LOOK_AGAIN_NS: Final = NS_PER_S
"""Longest time until it is looked again whether an axis still moves."""


@dataclass(frozen=True, slots=True)
class TwinSetup:
    """Which twin is told something.  controls: how they are worked before, by name."""

    model: Model
    address: int
    quirks: Mapping[str, Value]
    controls: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Saying:
    """What a host says: bytes, a frame, or a pause in seconds.

    at_ns: when, from the first one on; None: when the reply to the one before has come.
    waits: not before all axes stand.  recorded: the reply that a recording has.
    """

    content: bytes | CanFrame | float
    at_ns: Nanos | None = None
    waits: bool = False
    recorded: tuple[bytes | CanFrame, ...] = ()


@dataclass(slots=True)
class PlayedMotion:
    """How it went: what was replied to each saying, when axes moved first and last, and the looks.

    is_cut: an axis was still moving at the end of the time that was allowed.
    """

    replies: list[list[Any]] = field(default_factory=list)
    from_ns: Nanos | None = None
    until_ns: Nanos = 0
    is_cut: bool = False
    times_ns: list[Nanos] = field(default_factory=list)
    positions: list[tuple[int, ...]] = field(default_factory=list)
    rates: list[tuple[float, ...]] = field(default_factory=list)


def moved_twin(
    setup: TwinSetup, view: AxisView, sayings: Sequence[Saying], limit_s: float
) -> tuple[PlayedMotion, MotionTrack]:
    """What a twin does that is told ``sayings``, at most ``limit_s`` behind the last (rule 1)."""

    def play(grid: range | None) -> PlayedMotion:
        talk = (_OnBus if setup.model.carrier == "can" else _OnLine)(setup)
        with talk.simulation:
            for name, value in setup.controls.items():
                talk.simulation.twins[0].controls[name].set(value)
            return _Player(talk, view, grid).play(sayings, round(limit_s * NS_PER_S))

    first = play(None)
    begin_ns = first.until_ns if first.from_ns is None else first.from_ns
    step_ns = max(1, (first.until_ns - begin_ns) // LOOKS)
    behind_ns = max(1, round(MARGIN * (first.until_ns - begin_ns)))
    done = play(range(begin_ns, first.until_ns + behind_ns + step_ns, step_ns))
    times_s = [time_ns / NS_PER_S for time_ns in done.times_ns]
    return done, MotionTrack(view.names, view.unit, times_s, done.positions, done.rates)


class _Talk(ABC):
    """The host's end of a line or bus with one twin."""

    simulation: Line | Bus

    @abstractmethod
    def send(self, content: Any) -> None:
        """Say it."""

    @abstractmethod
    def received(self) -> list[Any]:
        """What has come since last time."""

    def joined(self, parts: list[Any]) -> list[Any]:
        """What was heard in pieces as what it is."""
        return parts

    @abstractmethod
    def is_complete(self, content: Any, reply: list[Any]) -> bool:
        """Whether ``reply`` is all that ``content`` is answered; False where only silence tells."""


class _OnLine(_Talk):
    """Bytes; the host follows the rate of the twin."""

    def __init__(self, setup: TwinSetup) -> None:
        spec = catalog.DeviceSpec(setup.model.name, setup.address)
        self._family = setup.model.family
        self._line = catalog.build_line([spec], quirks=setup.quirks, clock=VirtualClock())
        self.simulation = self._line

    def send(self, content: bytes) -> None:
        """Say it at the rate that is understood."""
        self._line.host_format = self._line.device_format
        self._line.send(content)

    def received(self) -> list[bytes]:
        """All bytes that have come."""
        data = self._line.receive()
        return [data] if data else []

    def joined(self, parts: list[bytes]) -> list[bytes]:
        """Bytes of one reply are one."""
        return [b"".join(parts)] if parts else []

    def is_complete(self, content: bytes, reply: list[bytes]) -> bool:
        """As the family knows it."""
        return self._family.is_whole(b"".join(reply))


class _OnBus(_Talk):
    """Frames."""

    def __init__(self, setup: TwinSetup) -> None:
        spec = catalog.DeviceSpec(setup.model.name, setup.address)
        self._family = setup.model.family
        self._bus = catalog.build_bus([spec], quirks=setup.quirks, clock=VirtualClock())
        self.simulation = self._bus
        self._port = self._bus.attach()

    def send(self, content: CanFrame) -> None:
        """Queue it."""
        self._bus.send(self._port, content)

    def received(self) -> list[CanFrame]:
        """The frames."""
        return [arrival.frame for arrival in self._bus.receive(self._port)]

    def is_complete(self, content: CanFrame, reply: list[CanFrame]) -> bool:
        """One frame that answers it."""
        return any(self._family.is_reply(content, frame) for frame in reply)


class _Player:
    """Says what is to be said, and looks at the axes at the times of ``grid``."""

    def __init__(self, talk: _Talk, view: AxisView, grid: range | None) -> None:
        self._talk = talk
        self._simulation = talk.simulation
        controls = talk.simulation.twins[0].controls
        self._moves, self._place = controls["is_moving"], controls[view.position]
        self._rate = controls[view.rate]
        self._grid = iter(grid or ())
        self._look_ns = next(self._grid, None)
        self._stood_at = self._position()
        self._said_ns = self._now_ns()
        self.played = PlayedMotion()

    def play(self, sayings: Sequence[Saying], limit_ns: Nanos) -> PlayedMotion:
        """Say all, and let the axes come to rest, which may take up to ``limit_ns``."""
        origin_ns, played = self._now_ns(), self.played
        for saying in sayings:
            if saying.waits:
                self._rest(limit_ns)
            elif saying.at_ns is not None:
                self._pass_until(origin_ns + saying.at_ns)
            self._note_motion()
            self._said_ns = self._now_ns()
            self._say(saying)
        self._pass_until(self._now_ns() + _LAST_NS)
        self._note_motion()
        self._rest(limit_ns)
        self._note_motion()
        self._hear()
        played.until_ns, played.is_cut = self._now_ns(), self._is_moving()
        while self._look_ns is not None:
            self._pass_until(self._look_ns)
        return played

    def _now_ns(self) -> Nanos:
        return self._simulation.sync()

    def _is_moving(self) -> bool:
        return bool(self._moves.value)

    def _position(self) -> tuple[int, ...]:
        return _as_row(self._place.value)

    def _note_motion(self) -> None:
        """What was said last has moved an axis, or does: it is the first that did."""
        if self.played.from_ns is None and (
            self._is_moving() or self._position() != self._stood_at
        ):
            self.played.from_ns = self._said_ns

    def _hear(self) -> bool:
        """Whether more of a reply has come."""
        heard = self._talk.received()
        if self.played.replies:
            self.played.replies[-1] = self._talk.joined([*self.played.replies[-1], *heard])
        return bool(heard)

    def _say(self, saying: Saying) -> None:
        """Say one thing, and hear the reply, unless it is said by the clock (rule 2)."""
        self._hear()
        self.played.replies.append([])
        content, talk = saying.content, self._talk
        if isinstance(content, float):
            self._pass_until(self._now_ns() + round(content * NS_PER_S))
            return
        talk.send(content)
        if saying.at_ns is not None:
            return
        until_ns = self._now_ns() + PATIENCE_NS
        while self._now_ns() < until_ns and not talk.is_complete(content, self.played.replies[-1]):
            self._pass_until(self._now_ns() + _STEP_NS)
            if self._hear():
                until_ns = self._now_ns() + GAP_NS

    def _rest(self, limit_ns: Nanos) -> None:
        """Until all axes stand, or for so long."""
        end_ns = self._now_ns() + limit_ns
        while self._is_moving() and (now := self._now_ns()) < end_ns:
            due_ns = self._simulation.next_event_ns() or end_ns
            self._pass_until(min(max(due_ns, now + 1), now + _LOOK_AGAIN_NS, end_ns))

    def _pass_until(self, until_ns: Nanos) -> None:
        """Let time pass, and look meanwhile."""
        while self._look_ns is not None and self._look_ns <= until_ns:
            self._simulation.advance_to(self._look_ns)
            self.played.times_ns.append(self._look_ns)
            self.played.positions.append(self._position())
            self.played.rates.append(_as_row(self._rate.value))
            self._look_ns = next(self._grid, None)
        self._simulation.advance_to(until_ns)


def _as_row(value: Any) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, list | tuple) else (value,)
