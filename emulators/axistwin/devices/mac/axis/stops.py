"""The end-stops of a MAC axis: which way is barred, and when a stop is met.

Rules
-----
1. A direction is blocked by its hardware stop (a level) or beyond its software stop, as far as 03h
   enables them; the other one is free (MACS-STOP-01, -02, MACS-AMB-48).
2. Software stops look at the counter, whatever moves the axis (MACS-STOP-03).
3. Who goes beyond a software stop has met it, wherever the set-point goes from there, if anywhere:
   the last increment of a motion counts like any other (MACS-CMD-09-02, ledger §4.3).
4. ff of 21h tells which stop ended the last motion, or which act now (MACS-AMB-50).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from axistwin.devices.mac.axis.counter import Counter
from axistwin.devices.mac.axis.quirks import MacQuirks
from axistwin.kernel.effects import Trace
from axistwin.kernel.time import Nanos
from axistwin.motion.trajectory import SetPoint

HARDWARE, SOFTWARE = 0x01, 0x08  # bits of 03h (MACS-CMD-03-01)

# Bits of ff by cause and direction, in the CAN manual's map (ledger §5.9).
HARD_BITS: Final = {1: 0x08, -1: 0x04}
SOFT_BITS: Final = {1: 0x02, -1: 0x01}

STOP_NAMES: Final = {0x08: "hardware +", 0x04: "hardware -", 0x02: "software +", 0x01: "software -"}
"""What a bit of ff means."""


@dataclass(frozen=True, slots=True)
class StopMet(Trace):
    """A motion was ended by ``stop``, one of ``STOP_NAMES``."""

    stop: str

    def __str__(self) -> str:
        return f"its motion was ended by a stop: {self.stop}"


class Heading(NamedTuple):
    """Where a motion is going: +1, -1, or 0 nowhere.

    begun: of one that sets out at this instant, the signed step that is counted already although
    it only begins (``step_phase``); None for any other.
    """

    direction: int
    begun: int | None = None


class Meeting(NamedTuple):
    """When a stop may be met, and of which ``direction`` if it surely is; 0: look again then."""

    at_ns: Nanos
    direction: int = 0


class Stops:
    """Both kinds of stops in both directions.  ``values`` are the parameters in use.

    inputs: which hardware stops are active, by direction.  bits: ff, the stops that were met.
    """

    def __init__(self, quirks: MacQuirks, values: Mapping[str, int], counter: Counter) -> None:
        self._values = values
        self._counter = counter
        self._beyond = 1 if quirks.soft_stop_compare == "strict" else 0
        self._blocks_both = quirks.soft_stop_blocks == "both"
        self._is_live = quirks.ff_lifetime == "live"
        self.inputs: dict[int, bool] = {1: False, -1: False}
        self.bits = 0

    @property
    def are_enabled(self) -> bool:
        """Whether any stop is."""
        return bool(self._values["stops"])

    def is_blocked_hard(self, direction: int) -> bool:
        """Whether the hardware stop of ``direction`` is active and enabled."""
        return bool(self._values["stops"] & HARDWARE) and self.inputs[direction]

    def blocking_bit(self, now: Nanos, direction: int, begun: int = 0) -> int:
        """The bit of ff for what blocks ``direction`` at ``now``; 0: free, or nowhere to go.

        begun: the signed step that is part of the count, and is only to be begun.
        """
        if not direction or not self._values["stops"]:
            return 0
        if self.is_blocked_hard(direction):
            return HARD_BITS[direction]
        for way in (1, -1) if self._blocks_both else (direction,):
            if self._is_beyond(now, way, begun):
                return SOFT_BITS[way]
        return 0

    def barring_bit(self, now: Nanos, heading: Heading) -> int:
        """The bit of ff for what lets a motion that sets out now make no step; 0: none."""
        if heading.begun is None:
            return 0
        return self.blocking_bit(now, heading.direction, heading.begun)

    def next_meeting(self, now: Nanos, heading: Heading, set_point: SetPoint) -> Meeting | None:
        """When ``set_point``, which is ``heading`` somewhere, may meet a stop; None: never."""
        if self.barring_bit(now, heading) or self.blocking_bit(now, heading.direction):
            return Meeting(now)
        out, back = self._next_of(now, 1, set_point), self._next_of(now, -1, set_point)
        if out is None or back is None:
            return out or back
        if out.at_ns == back.at_ns:  # that which is known to be met
            return out if out.direction else back
        return out if out.at_ns < back.at_ns else back

    def met_bit(self, now: Nanos, meeting: Meeting | None) -> int:
        """The bit of ff for the software stop that is met at ``now``, as was foreseen; 0: none."""
        if meeting is None or meeting.at_ns != now or not meeting.direction:
            return 0
        way = meeting.direction
        return SOFT_BITS[way] if self._is_beyond(now, way) else 0  # it may have wrapped

    def _next_of(self, now: Nanos, direction: int, set_point: SetPoint) -> Meeting | None:
        """When the stop of ``direction``, in which nothing is going the barred way, may be met."""
        if self.blocking_bit(now, direction):
            start_ns = set_point.heads_ns(direction, now)
            if start_ns is None:
                start_ns = set_point.end_ns
            return None if start_ns is None or start_ns <= now else Meeting(start_ns)
        if not self._values["stops"] & SOFTWARE:
            return None
        reached_ns = self._counter.reach_ns(now, self._first_forbidden(direction))
        return None if reached_ns is None else Meeting(reached_ns, direction)

    def bits_at(self, now: Nanos) -> int:
        """ff as it is read."""
        if not self._is_live:
            return self.bits
        hard = sum(bit for way, bit in HARD_BITS.items() if self.is_blocked_hard(way))
        return hard | sum(bit for way, bit in SOFT_BITS.items() if self._is_beyond(now, way))

    def _is_beyond(self, now: Nanos, direction: int, begun: int = 0) -> bool:
        """Whether the counter, less ``begun``, is beyond the enabled software stop."""
        if not self._values["stops"] & SOFTWARE:
            return False
        return direction * (self._counter.at(now) - begun - self._first_forbidden(direction)) >= 0

    def _first_forbidden(self, direction: int) -> int:
        """The first count on which the software stop acts."""
        name = "superior_stop" if direction > 0 else "inferior_stop"
        return self._values[name] + direction * self._beyond
