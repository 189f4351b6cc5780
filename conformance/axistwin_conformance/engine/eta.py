"""How long a run still takes, guessed from its plan, from how it goes, and from an earlier run.

Checks differ in length by a factor of a thousand, so an earlier report of the same device is by far
the best guide.  Without one, checks count by what they may do: motion takes longer than a query.
The guess is scaled by how this run has gone so far.

A run that takes twice the most that any sound device was seen to need (`most_s`) is held up by the
device: it talks unasked, or answers nothing right.  Then it ends (`DeviceGuard.guard`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.core.settings import Envelope
from axistwin_conformance.engine.plan import Plan

# passive, motion, stored, negative, rig, destructive
WEIGHTS = (1.0, 6.0, 6.0, 6.0, 6.0, 8.0)
assert len(WEIGHTS) == len(SAFETY_CLASSES)
FULL_FACTOR = 2.0  # checks that only full runs do are the long ones
MOST_S_AT_ALL, MOST_S_PER_PROBE = 60.0, 2.0
PLAIN_TRIP_NS = 30_000_000  # an exchange on a line on which nothing takes longer than that
PLAIN_SPEED = 5000  # increments per second: that of the checks
HELD_UP = 2  # times as long as that is no device's right
HELD_UP_BY_NOISE = 4  # times as long again on a noisy line where things settle and none has failed
CHECKS_NEEDED, SECONDS_NEEDED = 5, 2.0  # before a guess without a past is worth telling


def weigh(plan: Plan) -> dict[str, float]:
    """Return the checks that will run with their weights."""
    return {check.name: _weight(check) for check in plan.to_run}


def _weight(check: Check) -> float:
    return WEIGHTS[check.danger] * (FULL_FACTOR if check.level == "full" else 1.0)


def most_s(plan: Plan, envelope: Envelope, trip_ns: int, weight_s: float) -> float:
    """The most that the checks and probes of a plan take on a real line, in s; `weight_s`: see
    `Model`."""
    usual_s = weight_s * sum(weigh(plan).values()) + MOST_S_PER_PROBE * len(plan.probes)
    slower = max(1.0, trip_ns / PLAIN_TRIP_NS)
    if envelope.is_guarded and plan.to_run:
        slower = max(slower, PLAIN_SPEED / max(1, envelope.max_speed))
    return MOST_S_AT_ALL + usual_s * slower


class Eta:
    """Watches checks begin and end; `past` gives the seconds a check took in an earlier run."""

    def __init__(
        self,
        weights: Mapping[str, float],
        past: Mapping[str, float] | None = None,
        clock: Callable[[], float] = time.monotonic,
        afterwards_s: float = 0.0,
    ) -> None:
        self._left = dict(weights)
        self._past = past or {}
        self._clock = clock
        self._done: list[tuple[str, float, float]] = []  # name, weight, seconds
        self._running = ""
        self._since = clock()
        self._afterwards_s = afterwards_s  # what comes after the checks takes so long, from then on
        self._ends: float | None = None

    def begin(self, name: str) -> None:
        """A check begins."""
        self._running, self._since = name, self._clock()

    def end(self, name: str, seconds: float) -> None:
        """A check has ended."""
        self._running = ""
        self._done.append((name, self._left.pop(name, 1.0), seconds))

    def soak(self, seconds: float) -> None:
        """The checks are over; what is left is known."""
        self._left.clear()
        self._ends = self._clock() + seconds

    @property
    def remaining_s(self) -> float | None:
        """Seconds the run still takes, from now on; None while nobody can say."""
        if self._ends is not None:
            return max(0.0, self._ends - self._clock())
        known = [
            (self._past[name], seconds) for name, _, seconds in self._done if name in self._past
        ]
        per_weight = self._per_weight()
        if per_weight is None and not any(name in self._past for name in self._left):
            return None
        factor = _ratio(known) if sum(past for past, _ in known) >= SECONDS_NEEDED else 1.0
        total = 0.0
        for name, weight in self._left.items():
            guess = self._past[name] * factor if name in self._past else weight * (per_weight or 0)
            passed = self._clock() - self._since if name == self._running else 0.0
            total += max(0.0, guess - passed)
        return total + self._afterwards_s

    def _per_weight(self) -> float | None:
        """Seconds per unit of weight: of this run, or of the past as long as this run is young."""
        seen = [(weight, seconds) for _, weight, seconds in self._done]
        if len(seen) >= CHECKS_NEEDED and sum(seconds for _, seconds in seen) >= SECONDS_NEEDED:
            return _ratio(seen)
        before = [
            (weight, self._past[name]) for name, weight in self._left.items() if name in self._past
        ]
        return _ratio(before) if before else None


def _ratio(pairs: Iterable[tuple[float, float]]) -> float:
    """The sum of the seconds over the sum of what was expected."""
    expected, seconds = map(sum, zip(*pairs, strict=True))
    return seconds / expected if expected else 1.0
