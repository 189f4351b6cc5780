"""Motion of a twin in virtual time that gets commands, as ``send`` gives them or a recording has.

Rules
-----
1. The messages are played twice: first to learn when axes move, then with samples of all axes,
   evenly over that time.  Time is virtual, so both runs are the same.
2. The host's half of a recording is sent at the recorded times.  Where the twin replies otherwise
   than recorded, the recorded device may have moved otherwise, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from axistwin.cli.plot.track import MARGIN, MotionTrack
from axistwin.cli.replay.host_port import HostPort, TwinSetup
from axistwin.devices.controls import AxisReadout
from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.wire.can_frame import CanFrame

SAMPLES: Final = 4000
"""More than a picture has columns."""

PATIENCE_NS: Final = 2 * NS_PER_S
"""For a reply."""

GAP_NS: Final = 20 * NS_PER_MS
"""A silence that ends a reply."""

_STEP_NS: Final = NS_PER_MS
_LAST_NS: Final = 100 * NS_PER_MS
"""In which the last message arrives and is obeyed."""

_RECHECK_NS: Final = NS_PER_S
"""Longest time after which the run looks again whether an axis still moves."""


@dataclass(frozen=True, slots=True)
class HostMessage:
    """What a host sends: bytes, a frame, or in place of it a pause in seconds.

    at_ns: when, counted from the first message; None: after the reply to the one before.
    waits: not before all axes stand.
    """

    content: bytes | CanFrame | float
    at_ns: Nanos | None = None
    waits: bool = False


@dataclass(slots=True)
class PlayedMotion:
    """How it went: the reply to each message, when axes moved first and last, and the samples.

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
    setup: TwinSetup, view: AxisReadout, messages: Sequence[HostMessage], limit_s: float
) -> tuple[PlayedMotion, MotionTrack]:
    """How a twin moves that gets ``messages``, at most ``limit_s`` behind the last (rule 1)."""

    def play(grid: range | None) -> PlayedMotion:
        port = setup.open()
        with port.simulation:
            return _MotionPlayer(port, view, grid).play(messages, round(limit_s * NS_PER_S))

    first = play(None)
    begin_ns = first.until_ns if first.from_ns is None else first.from_ns
    step_ns = max(1, (first.until_ns - begin_ns) // SAMPLES)
    behind_ns = max(1, round(MARGIN * (first.until_ns - begin_ns)))
    done = play(range(begin_ns, first.until_ns + behind_ns + step_ns, step_ns))
    times_s = [time_ns / NS_PER_S for time_ns in done.times_ns]
    return done, MotionTrack(view.names, view.unit, times_s, done.positions, done.rates)


class _MotionPlayer:
    """Sends the messages, and samples the axes at the times of ``grid``."""

    def __init__(self, port: HostPort, view: AxisReadout, grid: range | None) -> None:
        self._port = port
        self._simulation = port.simulation
        controls = port.simulation.twins[0].controls
        self._moves, self._place = controls["is_moving"], controls[view.position]
        self._rate = controls[view.rate]
        self._grid = iter(grid or ())
        self._sample_ns = next(self._grid, None)
        self._stood_at = self._position()
        self._sent_ns = self._now_ns()
        self.played = PlayedMotion()

    def play(self, messages: Sequence[HostMessage], limit_ns: Nanos) -> PlayedMotion:
        """Send all, and let the axes come to rest, which may take up to ``limit_ns``."""
        origin_ns, played = self._now_ns(), self.played
        for message in messages:
            if message.waits:
                self._rest(limit_ns)
            elif message.at_ns is not None:
                self._pass_until(origin_ns + message.at_ns)
            self._note_motion()
            self._sent_ns = self._now_ns()
            self._send(message)
        self._pass_until(self._now_ns() + _LAST_NS)
        self._note_motion()
        self._rest(limit_ns)
        self._note_motion()
        self._receive()
        played.until_ns, played.is_cut = self._now_ns(), self._is_moving()
        while self._sample_ns is not None:
            self._pass_until(self._sample_ns)
        return played

    def _now_ns(self) -> Nanos:
        return self._simulation.sync()

    def _is_moving(self) -> bool:
        return bool(self._moves.value)

    def _position(self) -> tuple[int, ...]:
        return _as_row(self._place.value)

    def _note_motion(self) -> None:
        """Whether the last message is the first one that moves an axis."""
        if self.played.from_ns is None and (
            self._is_moving() or self._position() != self._stood_at
        ):
            self.played.from_ns = self._sent_ns

    def _receive(self) -> bool:
        """Whether more of a reply has come."""
        received = self._port.received()
        if self.played.replies:
            self.played.replies[-1] = self._port.joined([*self.played.replies[-1], *received])
        return bool(received)

    def _send(self, message: HostMessage) -> None:
        """Send one message, and wait for the reply, unless the clock decides (rule 2)."""
        self._receive()
        self.played.replies.append([])
        content, port = message.content, self._port
        if isinstance(content, float):
            self._pass_until(self._now_ns() + round(content * NS_PER_S))
            return
        port.send(content)
        if message.at_ns is not None:
            return
        until_ns = self._now_ns() + PATIENCE_NS
        while self._now_ns() < until_ns and not port.is_complete(content, self.played.replies[-1]):
            self._pass_until(self._now_ns() + _STEP_NS)
            if self._receive():
                until_ns = self._now_ns() + GAP_NS

    def _rest(self, limit_ns: Nanos) -> None:
        """Until all axes stand, or for so long."""
        end_ns = self._now_ns() + limit_ns
        while self._is_moving() and (now := self._now_ns()) < end_ns:
            due_ns = self._simulation.next_event_ns() or end_ns
            self._pass_until(min(max(due_ns, now + 1), now + _RECHECK_NS, end_ns))

    def _pass_until(self, until_ns: Nanos) -> None:
        """Let time pass, and take the samples that are due."""
        while self._sample_ns is not None and self._sample_ns <= until_ns:
            self._simulation.advance_to(self._sample_ns)
            self.played.times_ns.append(self._sample_ns)
            self.played.positions.append(self._position())
            self.played.rates.append(_as_row(self._rate.value))
            self._sample_ns = next(self._grid, None)
        self._simulation.advance_to(until_ns)


def _as_row(value: Any) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, list | tuple) else (value,)
