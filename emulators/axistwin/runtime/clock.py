"""Where a line's time comes from: moved by hand, or paced by a clock that runs by itself.

Both are the policy, not the mechanism: a line asks ``now_ns`` and runs its parts up to that.  Time
is never given twice: it stands or goes on, but never goes back.
"""

import math
import time
from collections.abc import Callable
from typing import TypeAlias

from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_S, Nanos

SPEED_MIN, SPEED_MAX = 1e-6, 1e6

ADVANCE_MAX_S = 1e12
"""The longest time that may be let pass at once, by hand: 30 000 years."""


def check_advance(seconds: float, mistake: type[Exception] = ValueError) -> None:
    """Raise ``mistake`` for a time that cannot be let pass by hand."""
    if not 0 <= seconds <= ADVANCE_MAX_S:
        raise mistake(f"advance: {seconds} s is out of range: 0..{ADVANCE_MAX_S:g} s")


class VirtualClock:
    """Stands still until it is moved."""

    is_virtual = True
    """Whether time passes only when ``advance_to`` says so."""

    @property
    def is_shared(self) -> bool:
        """Whether it moves while somebody waits, so that waiting is sleeping."""
        return False

    def __init__(self, start_ns: Nanos = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> Nanos:
        """The time it was moved to last."""
        return self._now_ns

    def advance_to(self, until_ns: Nanos) -> None:
        """Move to ``until_ns``, at once."""
        if until_ns > self._now_ns:
            self._now_ns = until_ns

    def delay_s(self, until_ns: Nanos) -> float:
        """Seconds to sleep until it is ``until_ns``: nobody needs to for virtual time."""
        return 0.0

    def keep_up(self, reached_ns: Nanos, span_ns: Nanos) -> None:
        """Virtual time waits for everybody."""


class PacedClock:
    """Runs ``speed`` times as fast as ``source``, from ``start_ns`` on.

    speed: 1e-6..1e6, may be changed at any time; the time goes on from where it is.
    source: a monotonic count of nanoseconds.
    """

    is_virtual = False
    is_shared = True

    def __init__(
        self,
        speed: float = 1.0,
        start_ns: Nanos = 0,
        source: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._source = source
        self._last_ns = start_ns
        # What it was when the source showed that; one value, for other threads look at it.
        self._base = (start_ns, source())
        self._speed = _checked_speed(speed)

    @property
    def speed(self) -> float:
        """How many times as fast as ``source``.  Raises UsageError when set out of range."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        checked = _checked_speed(speed)
        self._base = (self.now_ns(), self._source())
        self._speed = checked

    def now_ns(self) -> Nanos:
        """The present time, rounded down."""
        now = self._untold_ns()
        if now > self._last_ns:
            self._last_ns = now
        return self._last_ns

    def _untold_ns(self) -> Nanos:
        """The present time, which may be less than what was told."""
        base_ns, base_source_ns = self._base
        passed = self._source() - base_source_ns
        if self._speed != 1.0:
            passed = math.floor(passed * self._speed)
        return base_ns + passed

    def keep_up(self, reached_ns: Nanos, span_ns: Nanos) -> None:
        """Go on from ``reached_ns`` if more than ``span_ns`` has passed since.

        It took until now to compute that span: so time never runs away from whoever computes it.
        """
        if self._untold_ns() - reached_ns > span_ns:
            self._base = (max(reached_ns, self._last_ns), self._source())

    def advance_to(self, until_ns: Nanos) -> None:
        """This time cannot be moved, only waited for (see ``delay_s``)."""
        raise AssertionError("a paced clock moves by itself")

    def delay_s(self, until_ns: Nanos) -> float:
        """Seconds of ``source`` until ``until_ns``."""
        missing = until_ns - self.now_ns()
        return missing / self._speed / NS_PER_S if missing > 0 else 0.0


Clock: TypeAlias = VirtualClock | PacedClock
"""Tells the time of a line or bus."""


def _checked_speed(speed: float) -> float:
    if not (math.isfinite(speed) and SPEED_MIN <= speed <= SPEED_MAX):
        raise UsageError(
            f"speed {speed:g} is out of range: {SPEED_MIN:g}..{SPEED_MAX:g} times real time"
        )
    return float(speed)
