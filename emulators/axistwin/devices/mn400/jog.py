"""Jog mode: taps and continuous motion of the axes by the inputs of the panel (ledger §5.10).

Rules
-----
1. A press makes the steps of a tap at once; fractions are kept for the next one (MN4-JOG-03).  What
   is still pressed ``jog_hold_ms`` later moves until it is released (MN4-JOG-05), then slows down.
2. Each axis moves by itself; of an axis' two inputs the one that was pressed first counts.
3. A limit stops its axis, the open shield all of them (MN4-JOG-08); neither changes the exit code.
"""

from dataclasses import dataclass

from axistwin.devices.mn400.inputs import Inputs
from axistwin.devices.mn400.motion import JogTaps, MoveSettings, VectorMotion, jog, straight
from axistwin.devices.mn400.mover import Mover
from axistwin.devices.mn400.orders import AXES, ZERO, Four, added
from axistwin.devices.mn400.quirks import Mn400Quirks
from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import NS_PER_MS, Nanos


@dataclass(slots=True)
class JogPress:
    """An axis that is pressed, or still moves.  hold_ns: when a tap becomes continuous."""

    direction: int
    hold_ns: Nanos
    motion: VectorMotion | None


class Jogger:
    """Jog mode of one board, off."""

    def __init__(self, quirks: Mn400Quirks, inputs: Inputs, mover: Mover) -> None:
        self._quirks = quirks
        self._inputs = inputs
        self._mover = mover
        self.reset()

    def reset(self) -> None:
        """As at power-up."""
        self.is_on = False
        self._taps = [JogTaps() for _ in range(AXES)]
        self._presses: dict[int, JogPress] = {}

    # -- what can be seen --

    def moved_at(self, now: Nanos) -> Four:
        """Steps of the motions that are under way, which the counters do not have yet."""
        moved = ZERO
        for press in self._presses.values():
            if press.motion is not None:
                moved = added(moved, press.motion.position_at(now))
        return moved

    def made_at(self, now: Nanos) -> Four:
        """Pulses at the step outputs of the motions that are under way."""
        made = ZERO
        for motion in self.motions():
            made = added(made, motion.made_at(now))
        return made

    def motions(self) -> list[VectorMotion]:
        """The motions that are under way."""
        return [press.motion for press in self._presses.values() if press.motion is not None]

    # -- time --

    def next_event(self) -> Nanos:
        """When a motion ends, or a tap becomes continuous."""
        if not self._presses:
            return NEVER
        return min(self._due(press) for press in self._presses.values())

    def _due(self, press: JogPress) -> Nanos:
        if press.motion is None:
            return press.hold_ns
        return NEVER if press.motion.end_ns is None else press.motion.end_ns

    def wake(self, now: Nanos) -> None:
        """Do what is due by ``now``."""
        while (due := self.next_event()) <= now:
            for axis, press in list(self._presses.items()):
                if self._due(press) == due:
                    self._follow(due, axis, press)

    def _follow(self, now: Nanos, axis: int, press: JogPress) -> None:
        """A tap is over, or what is pressed has been for long."""
        if press.motion is not None:
            self._count(now, press)
        if press.hold_ns == NEVER:
            del self._presses[axis]
        elif press.hold_ns <= now:
            press.hold_ns = NEVER
            press.motion = jog(now, self._settings(), axis, press.direction)

    def _count(self, now: Nanos, press: JogPress) -> None:
        """A motion is over: the counters have its steps."""
        motion = press.motion
        assert motion is not None
        self._mover.count(now, motion)
        press.motion = None

    def _settings(self) -> MoveSettings:
        """Of a motion at jog speed, without compensation counted apart."""
        settings, mover = self._mover.settings, self._mover
        return MoveSettings(
            mover.rules,
            profile=settings.profile,
            speed=settings.jog_speed,
            multiplex=1,
            lash=settings.lash,
            lash_memory=mover.memory_at(0),
            feed_permille=self._inputs.jog_pot_permille,
        )

    # -- the panel --

    def press(self, now: Nanos, axis: int, direction: int) -> None:
        """A jog input goes on (rule 1)."""
        inputs = self._inputs
        is_free = axis not in self._presses and not inputs.blocks(axis, direction)
        if not self.is_on or not is_free or inputs.is_shield_open:
            return
        settings = self._mover.settings
        resolution = settings.taps[inputs.tap_resolution]
        steps, self._taps[axis] = self._taps[axis].tap(
            settings.spi, resolution, direction, self._mover.rules
        )
        distance = [0] * AXES
        distance[axis] = steps
        first, second, third, fourth = distance
        motion = straight(now, self._settings(), (first, second, third, fourth)) if steps else None
        hold_ns = now + self._quirks.jog_hold_ms * NS_PER_MS
        self._presses[axis] = JogPress(direction, hold_ns, motion)

    def release(self, now: Nanos, axis: int, direction: int) -> None:
        """A jog input goes off: what moves continuously slows down."""
        press = self._presses.get(axis)
        if press is None or press.direction != direction:
            return
        if press.motion is None:
            del self._presses[axis]
        elif press.hold_ns == NEVER:
            press.motion = press.motion.quit(now, ramped=True)
        press.hold_ns = NEVER
        self.wake(now)

    def stop(self, now: Nanos, *, is_ramped: bool = False) -> None:
        """Stop all axes."""
        for axis in list(self._presses):
            self._stop_axis(now, axis, is_ramped=is_ramped)
        self.wake(now)

    def _stop_axis(self, now: Nanos, axis: int, *, is_ramped: bool = False) -> None:
        press = self._presses[axis]
        press.hold_ns = NEVER
        if press.motion is None:
            del self._presses[axis]
        else:
            press.motion = press.motion.quit(now, ramped=is_ramped)

    def look(self, now: Nanos) -> None:
        """A limit or the shield has changed (rule 3)."""
        for axis, press in list(self._presses.items()):
            if self._inputs.is_shield_open or self._inputs.blocks(axis, press.direction):
                self._stop_axis(now, axis)
        self.wake(now)

    def pot_changed(self, now: Nanos) -> None:
        """The jog-speed potentiometer was turned."""
        for press in self._presses.values():
            if press.motion is not None:
                press.motion = press.motion.override(now, self._inputs.jog_pot_permille)
