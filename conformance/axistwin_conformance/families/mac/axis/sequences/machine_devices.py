"""What the stateful machine drives, and what its preconditions see of it."""

from __future__ import annotations

from typing import Final, NamedTuple

from axistwin_conformance.families.mac.axis.model.forecast import TimeWindow
from axistwin_conformance.families.mac.axis.sequences.operations import WHAT
from axistwin_conformance.families.mac.axis.sequences.sequence import AxisSequence


class AxisView(NamedTuple):
    """What preconditions look at: the state of the model after the last step.

    `mode`: HD, PO, VE, IN, or several where the end of something was near.  `waiting`: segments
    stored and not begun, in the history that has most of them.  `has_stops`: 03h enables them.
    """

    mode: str = "HD"
    is_armed: bool = False
    is_held: bool = False  # a start is preloaded and waits for 11h
    waiting: int = 0
    has_stops: bool = False
    is_away: bool = False  # at rest at another counter than 0

    @property
    def is_free(self) -> bool:
        """At rest, where a motion starts at once."""
        return self.mode == "HD" and not self.is_armed

    @property
    def is_moving(self) -> bool:
        """Surely in motion."""
        return self.mode in ("PO", "VE", "IN")


class JudgedAxis:
    """A module on the line, held against the exact model."""

    def __init__(self, sequence: AxisSequence) -> None:
        self.sequence = sequence
        self.view = AxisView()

    def conclude(self) -> None:
        """Stop and compare everything readable."""
        self.sequence.conclude()

    def leave(self) -> None:
        """Leave the module as it was found."""
        self.sequence.leave()

    def operate(self, what: int, first: int, second: int, pause: int) -> None:
        """Do an operation and look at what the model makes of it."""
        self.sequence.operate(what, first, second, pause)
        model, now_ns = self.sequence.model, self.sequence.client.target.now_ns
        forecast, has_stops = model.forecast, model.parameters.limits is not None
        is_held = model.preloaded is not None
        if now_ns >= forecast.over_ns:
            is_away = forecast.timelines[0].final != 0
            self.view = AxisView("HD", model.is_armed, is_held, 0, has_stops, is_away)
            return
        modes = forecast.modes(TimeWindow(now_ns, now_ns))
        mode = next(iter(modes)) if len(modes) == 1 else "several"
        waiting = max(
            [timeline.waiting(now_ns) for timeline in forecast.timelines if timeline.segments],
            default=0,
        )
        self.view = AxisView(mode, model.is_armed, is_held, waiting, has_stops)


class Trivial:
    """A device that computes nothing: a table says what state an operation leads to.

    What a run with it costs is what Hypothesis and the rules cost: the limit for any device.
    """

    _FREE: Final = AxisView(is_away=True)
    _AFTER: Final = {
        "move": AxisView("PO"), "move to 0": AxisView("PO"), "nudge": AxisView("PO"),
        "move to a stop": AxisView("PO", has_stops=True), "turn": AxisView("VE"),
        "move beside": AxisView("PO"), "turn at any speed": AxisView("VE"),
        "segment": AxisView("IN", waiting=1), "virtual segment": AxisView("IN", waiting=3),
        "arm": AxisView("HD", is_armed=True), "enable the stops": AxisView("HD", has_stops=True),
        "stop": _FREE, "ramped stop": _FREE, "turn at speed 0": _FREE, "trigger": AxisView("PO"),
        "wait for an instant": _FREE, "power off": _FREE, "restart": _FREE,
        "clear the counter": AxisView(),
    }  # fmt: skip
    _HELD: Final = AxisView("HD", is_armed=True, is_held=True)

    def __init__(self) -> None:
        names = {number: name for name, number in WHAT.items()}
        self._after = {number: self._AFTER.get(name) for number, name in names.items()}
        self.view = self._FREE

    def operate(self, what: int, first: int, second: int, pause: int) -> None:
        """Go where the table says; an operation that it does not name changes nothing."""
        after = self._after[what]
        if after is not None:
            is_held = self.view.is_armed and after.is_moving and what != WHAT["trigger"]
            self.view = self._HELD if is_held else after

    def conclude(self) -> None:
        """There is nothing to compare."""

    def leave(self) -> None:
        """There is nothing to put back."""
