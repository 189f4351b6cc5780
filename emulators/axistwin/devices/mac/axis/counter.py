"""The position counter of a MAC axis: what 20h reads, 31 bits signed.

Rules
-----
1. Counter = shaft + origin, or set-point + origin (MACS-AMB-55).  Zeroing moves the origin, never
   the shaft (MACS-CMD-0B-01).
2. At the ends of its 31 bits it wraps, or stands until the shaft is back (MACS-AMB-54); a shaft
   that comes to rest beyond an end is taken to be at it.
3. Without supply it stands where it was, whatever the shaft does (MACS-Q-20-02).
"""

from typing import Final

from axistwin.devices.mac.axis.quirks import RANGE_MAX, RANGE_MIN, MacQuirks
from axistwin.kernel.time import Nanos
from axistwin.motion.plant import Plant
from axistwin.motion.spans import Span

_SPAN: Final = RANGE_MAX - RANGE_MIN + 1


class Counter:
    """What counts the increments of ``plant``.

    ``settled`` is set when the count has come to a place worth saving; whoever saves it clears it.
    """

    def __init__(self, plant: Plant, quirks: MacQuirks) -> None:
        self._plant = plant
        self._reads_encoder = quirks.position_source == "encoder"
        self._saturates = quirks.position_overflow == "saturate"
        self._origin = 0
        self._frozen: int | None = None
        self._span: Span | None = None
        self.settled = False

    def at(self, now: Nanos) -> int:
        """The count."""
        if self._frozen is not None:
            return self._frozen
        if not self._reads_encoder:
            return self.fold(self._plant.set_point_at(now) + self._origin)
        span = self._span
        if span is None or (span.end_ns is not None and now >= span.end_ns):
            span = self._span = self._plant.span_at(now)
        return self.fold(span.position_at(now) + self._origin)

    def of_set_point(self, now: Nanos) -> int:
        """What it would be with the shaft on its set-point, not folded."""
        return self._plant.set_point_at(now) + self._origin

    def place_of(self, number: int) -> int:
        """Where the plant is when the count is ``number``."""
        return number - self._origin

    def reach_ns(self, now: Nanos, number: int) -> Nanos | None:
        """When it is at ``number`` next, as things stand; None: never.

        For a number outside the range the time at which the count wraps, if it does.
        """
        if not self._saturates:
            ahead = max(RANGE_MIN - 1, min(RANGE_MAX + 1, number)) - self.at(now)
        elif RANGE_MIN <= number <= RANGE_MAX:
            ahead = number - self._unfolded(now)
        else:
            return None
        plant = self._plant
        if self._reads_encoder:
            return plant.reach_ns(plant.position_at(now) + ahead, now)
        return plant.set_point_reach_ns(plant.set_point_at(now) + ahead, now)

    def fold(self, number: int) -> int:
        """``number`` in 31 bits (rule 2)."""
        if RANGE_MIN <= number <= RANGE_MAX:
            return number
        if self._saturates:
            return max(RANGE_MIN, min(RANGE_MAX, number))
        return (number - RANGE_MIN) % _SPAN + RANGE_MIN

    def set(self, now: Nanos, number: int) -> None:
        """Let it be ``number`` without moving the shaft."""
        self._origin += number - self._unfolded(now)
        self.settled = True

    def settle(self, now: Nanos) -> None:
        """The shaft rests: an end of the range is where it stands (rule 2)."""
        if self._saturates:
            self._origin += self.at(now) - self._unfolded(now)
        self.settled = True

    @property
    def is_frozen(self) -> bool:
        """Whether there is no supply to count with."""
        return self._frozen is not None

    def freeze(self, now: Nanos) -> None:
        """The supply is gone: stand (rule 3)."""
        self._frozen = self.at(now)
        self.settled = False

    def thaw(self, now: Nanos) -> None:
        """The supply is back: count on from where it stood."""
        assert self._frozen is not None, "the counter was not frozen"
        number, self._frozen = self._frozen, None
        self._origin += number - self._unfolded(now)

    def look_again(self) -> None:
        """Something has happened to the shaft: what was expected of it holds no longer."""
        self._span = None

    def _unfolded(self, now: Nanos) -> int:
        plant = self._plant
        shaft = plant.position_at(now) if self._reads_encoder else plant.set_point_at(now)
        return shaft + self._origin
