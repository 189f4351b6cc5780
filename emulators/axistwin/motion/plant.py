"""The shaft against its set-point: what really turns, in closed form.

Theory (MACS ledger §5.4, §5.5)
-------------------------------
The set-point goes its way whatever the shaft does.  A shaft that is held back falls behind; free
again, it follows every step of the set-point with the lag it has.  Only in position mode is the
lag made up: once the profile is over, by one increment every catch-up period, and likewise at rest
for a shaft that was pushed.

    position      ____________________________ target
                 ╱               ┌──┘            catch-up: one increment per catch-up period
     set-point  ╱        ┌──────┘
               ╱  ┌─────╱ follows with a lag, after the profile's end it stands
     ─────────╱───┘ held

Two plants: the *ideal* one is where its set-point is unless the load holds it; the *inertial* one
needs torque and time to change its speed (``inertia``).

Rules
-----
1. The future is a row of spans, computed from the present state; asking changes nothing.
2. Everything that happens to the shaft is a method with a time; calls come in the order of time.
3. Plant coordinates are increments since the plant was built, never reset and never wrapped;
   zeroing and wrapping a counter is the device's matter.
4. The load holds the shaft when it is ``held`` or its torque is at least the drive's.
"""

from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, floor
from typing import NamedTuple

from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.motion.inertia import Chase, Mechanics, leg_speed
from axistwin.motion.spans import NO_SPEED, Arc, Following, Span, Stepping, Still
from axistwin.motion.trajectory import TICK_NS, Piece, SetPoint, Trajectory

_DENOMINATOR_BITS = 128


def exact_number(name: str, value: Fraction | float | str) -> Fraction:
    """``value`` as the decimal number it is written as; UsageError if it is negative or none."""
    try:
        number = Fraction(str(value)) if isinstance(value, float) else Fraction(value)
    except (ValueError, ZeroDivisionError):
        number = Fraction(-1)
    if number < 0:
        raise UsageError(f"{name} {value} is not allowed; give a number of at least 0")
    return number


@dataclass(frozen=True, slots=True)
class Load:
    """What hangs on the shaft: a torque against motion, an inertia, and whether it is held fast.

    Numbers of any kind are taken and kept as exact fractions.  Raises UsageError below 0.
    """

    torque_nm: Fraction | float = Fraction(0)
    inertia_kgcm2: Fraction | float = Fraction(0)
    held: bool = False

    def __post_init__(self) -> None:
        for name in ("torque_nm", "inertia_kgcm2"):
            object.__setattr__(self, name, exact_number(name, getattr(self, name)))

    @property
    def exact_torque_nm(self) -> Fraction:
        """The torque in Nm."""
        return Fraction(self.torque_nm)

    @property
    def exact_inertia_kgcm2(self) -> Fraction:
        """The inertia in kg·cm²."""
        return Fraction(self.inertia_kgcm2)


class _Shaft(NamedTuple):
    """The shaft at one instant.

    ``offset``: it makes the set-point's steps, this far from their count; None: it does not.
    ``step_due_ns``: when the catch-up increment in progress is complete.
    """

    now_ns: Nanos
    exact: Fraction
    speed: Fraction
    offset: int | None = None
    step_due_ns: Nanos | None = None


def _bounded(value: Fraction) -> Fraction:
    """``value``, with a long denominator rounded to 2**-128.

    Each order to brake squares the speed that the last one left; a row of them would not end.
    """
    if value.denominator.bit_length() <= _DENOMINATOR_BITS:
        return value
    return Fraction(round(value * (1 << _DENOMINATOR_BITS)), 1 << _DENOMINATOR_BITS)


class Plant:
    """One shaft.  Without ``mechanics`` it is ideal.

    ``catch_up_ticks`` (>= 1) is the time of one catch-up increment; what a parameter of 0 means is
    the device's to decide (MACS-AMB-47).  ``torque_nm`` is what the drive can give; an ideal shaft
    without any load needs none.
    """

    def __init__(
        self,
        *,
        position: int = 0,
        now_ns: Nanos = 0,
        mechanics: Mechanics | None = None,
        torque_nm: Fraction = Fraction(0),
        catch_up_ticks: int = 1600,
        load: Load | None = None,
    ) -> None:
        self._mechanics = mechanics
        self._torque_nm = torque_nm
        self._catch_up_ticks = catch_up_ticks
        self._load = load or Load()
        self._is_ideal = mechanics is None
        self._is_blocked = self._find_blocked()
        self._shaft = _Shaft(now_ns, Fraction(position), Fraction(0))
        self._set_point: SetPoint | None = None
        self._base = 0
        self._target: int | None = None
        self._run_out: Arc | None = None
        self._lone: Span | None = None  # see ``_span_at``

    # ---- what happens to the shaft ----

    def follow(
        self, now_ns: Nanos, set_point: SetPoint, target: int | None = None, counted: int = 0
    ) -> None:
        """Follow ``set_point`` from where the shaft is: a new motion, lags are forgotten.

        ``target``: position mode; the set-point's displacement at which to be in the end.
        ``counted``: the displacement at which it is taken over; a step that is counted at
        ``now_ns`` already (``StepPhase.START``) is still to be made, unless it is in here.
        """
        self.advance(now_ns)
        position = self.position_at(now_ns)
        self._base = position - counted
        shaft = self._shaft
        exact = shaft.exact if shaft.speed else Fraction(position)
        offset = self._base if self._is_ideal else None
        self._shaft = _Shaft(now_ns, exact, shaft.speed, offset)
        self._run_out = self._lone = None
        self._set_point = set_point
        self._target = None if target is None else self._base + target

    def replace(self, now_ns: Nanos, set_point: SetPoint, target: int | None = None) -> None:
        """Go on with ``set_point``, the running one planned anew; lags stay.

        Both count alike up to ``now_ns``; ``target`` as for ``follow``.
        """
        assert self._set_point is not None, "there is no set-point to replace"
        self.advance(now_ns)
        was, is_now = self._set_point.displacement_at(now_ns), set_point.displacement_at(now_ns)
        assert was == is_now, f"the set-point jumps from {was} to {is_now}"
        self._set_point, self._lone = set_point, None
        aim = None if target is None else self._base + target
        if aim != self._target:
            self._shaft = self._shaft._replace(step_due_ns=None)
        self._target = aim

    def aim(self, now_ns: Nanos, target: int) -> None:
        """Hold ``target`` (plant coordinates) instead; position mode, the set-point is over."""
        self.advance(now_ns)
        if target != self._target:
            self._shaft = self._shaft._replace(step_due_ns=None)
        self._target, self._lone = target, None

    def brake(self, now_ns: Nanos, increments: int | None = None) -> None:
        """Give up set-point and regulation and brake as hard as possible (MACS-CMD-18-01).

        The shaft rests ⌈v²/2a⌉ increments further on, at once if it is ideal; or after exactly
        ``increments`` (>= 0).  One that runs out already rests no later for it.
        """
        running_out = self._run_out
        self._let_run(now_ns, increments, self._slowing(self._torque_nm))
        if running_out is None or running_out.end_ns is None or running_out.end_ns <= now_ns:
            return
        anew = self._run_out
        if anew is not None and anew.direction * (anew.rest - running_out.rest) >= 0:
            self._run_out = running_out

    def hold(self, now_ns: Nanos) -> None:
        """Give up the set-point, brake as hard as possible, and hold the place of rest."""
        self._let_run(now_ns, None, self._slowing(self._torque_nm))
        shaft, run_out = self._shaft, self._run_out
        rest, rest_ns = _whole(shaft), now_ns
        if run_out is not None:
            assert run_out.end_ns is not None, "a run-out ends"
            rest, rest_ns = run_out.rest, run_out.end_ns
        self._set_point = Trajectory(rest_ns, 1, ())
        self._base = self._target = rest
        if run_out is None and self._is_ideal:
            self._shaft = shaft._replace(offset=rest)
        self._lone = None

    def cut_power(self, now_ns: Nanos) -> None:
        """Give up set-point and regulation; load and friction bring the shaft to rest."""
        self._let_run(now_ns, None, self._slowing(Fraction(0)))

    def push(self, now_ns: Nanos, increments: int) -> None:
        """Displace the shaft by hand; a catch-up step in progress begins anew."""
        self.advance(now_ns)
        shaft = self._shaft
        keeps = self._is_ideal and shaft.offset is not None
        offset = (shaft.offset or 0) + increments if keeps else None
        self._shaft = _Shaft(now_ns, shaft.exact + increments, shaft.speed, offset)
        self._lone = None
        if self._run_out is not None:
            self._run_out = replace(self._run_out, exact=self._run_out.exact + increments)

    def set_load(self, now_ns: Nanos, load: Load) -> None:
        """Hang another load on the shaft."""
        self._with_forces(now_ns, load, self._torque_nm)

    def set_torque(self, now_ns: Nanos, torque_nm: Fraction) -> None:
        """Let the drive give at most ``torque_nm``."""
        self._with_forces(now_ns, self._load, torque_nm)

    def set_catch_up(self, now_ns: Nanos, period_ticks: int) -> None:
        """Let catch-up increments take ``period_ticks``, from the next one on (MACS-CMD-0E-02)."""
        assert period_ticks >= 1, f"a catch-up period of {period_ticks} ticks"
        self.advance(now_ns)
        self._catch_up_ticks = period_ticks

    def advance(self, now_ns: Nanos) -> None:
        """Make ``now_ns`` the present: earlier times can no longer be asked for.

        Changes no answer about later ones.  To be called before the set-point forgets its past, or
        is given a new future: what the shaft was by then, it is, however often this is called.
        """
        if now_ns != self._shaft.now_ns:
            self._look_at_shaft(now_ns)

    def _look_at_shaft(self, now_ns: Nanos) -> None:
        span = self._span_at(now_ns)
        offset: int | None = None
        if type(span) is Following:
            exact, speed = span.state_at(now_ns)
            self._shaft = _Shaft(now_ns, exact, speed, span.offset)
            return
        if span is self._lone and not self._is_blocked:  # at rest where it is wanted
            self._shaft = _Shaft(now_ns, span.exact_at(now_ns), NO_SPEED, self._shaft.offset)
            return
        if self._set_point is not None and self._is_ideal:
            offset = span.position_at(now_ns) - self._set_point.displacement_at(now_ns)
        speed, step_due_ns = span.speed_at(now_ns), None
        if isinstance(span, Stepping):
            steps = span.trajectory
            speed = NO_SPEED
            step_due_ns = steps.end_of_increment_ns(steps.completed_at(now_ns) + 1)
        self._shaft = _Shaft(now_ns, span.exact_at(now_ns), speed, offset, step_due_ns)

    # ---- what can be asked, for the present and later ----

    @property
    def load(self) -> Load:
        """What hangs on the shaft."""
        return self._load

    @property
    def is_regulating(self) -> bool:
        """Whether a position is held: there is a target."""
        return self._target is not None

    @property
    def target(self) -> int | None:
        """Where position mode ends, in plant coordinates; None in any other mode."""
        return self._target

    def position_at(self, now_ns: Nanos) -> int:
        """The real position, in whole increments."""
        return self._span_at(now_ns).position_at(now_ns)

    def span_at(self, now_ns: Nanos) -> Span:
        """The stretch of one closed formula in which ``now_ns`` lies.

        Holds until its end, or until something happens to the shaft: for who asks often.
        """
        return self._span_at(now_ns)

    def set_point_at(self, now_ns: Nanos) -> int:
        """Where the shaft should be: its set-point; without one, where it is."""
        if self._set_point is None:
            return self.position_at(now_ns)
        end_ns = self._set_point.end_ns
        if self._target is not None and end_ns is not None and now_ns >= end_ns:
            return self._target
        return self._base + self._set_point.displacement_at(now_ns)

    def set_point_reach_ns(self, position: int, after_ns: Nanos) -> Nanos | None:
        """First time >= ``after_ns`` at which the set-point is at ``position``; None: never."""
        if self._set_point is None:
            return None
        return self._set_point.reach_ns(position - self._base, after_ns)

    def speed_at(self, now_ns: Nanos) -> Fraction:
        """The real signed speed in increments per nanosecond (between increments if ideal)."""
        return self._span_at(now_ns).speed_at(now_ns)

    def is_held_back(self, now_ns: Nanos) -> bool:
        """Whether the shaft is slower than its set-point, or turns the other way."""
        if self._set_point is None:
            return False
        wanted = leg_speed(self._set_point.leg_at(now_ns))
        direction = -1 if wanted < 0 else 1
        return wanted != 0 and direction * self.speed_at(now_ns) < abs(wanted)

    def is_busy(self, now_ns: Nanos, tolerance: int) -> bool:
        """Position mode: more than ``tolerance`` from the target; otherwise held back."""
        if self._target is None:
            return self.is_held_back(now_ns)
        return abs(self.position_at(now_ns) - self._target) > tolerance

    def reach_ns(self, position: int, after_ns: Nanos) -> Nanos | None:
        """First time >= ``after_ns`` at which the shaft is at ``position``, as things stand.

        None: never, unless something happens to it.
        """
        lone = self._simple_span_at(after_ns)
        if lone is not None:
            reached_ns, end_ns = lone.reach_ns(position, after_ns), lone.end_ns
            if end_ns is None or (reached_ns is not None and reached_ns < end_ns):
                return reached_ns
            last = self._simple_span_at(end_ns)
            if last is not None and last.end_ns is None:
                return last.reach_ns(position, end_ns)
        for span in self._spans_from(after_ns):
            reached_ns = span.reach_ns(position, max(after_ns, span.start_ns))
            if reached_ns is not None and (span.end_ns is None or reached_ns < span.end_ns):
                return reached_ns
        return None

    def settle_ns(self, after_ns: Nanos, tolerance: int) -> Nanos | None:
        """Since when (>= ``after_ns``) the shaft is within ``tolerance`` of its target for good.

        As things stand; None: never.  Position mode only.
        """
        assert self._target is not None, "only position mode has a target"
        lone = self._simple_span_at(after_ns)
        if type(lone) is Still:
            return after_ns if abs(lone.position - self._target) <= tolerance else None
        settled_ns: Nanos | None = None
        for span in self._spans_from(after_ns):
            start_ns = max(after_ns, span.start_ns)
            away = span.position_at(start_ns) - self._target
            if abs(away) > tolerance:
                edge = self._target + (tolerance if away > 0 else -tolerance)
                settled_ns = span.reach_ns(edge, start_ns)
                if settled_ns is not None and span.end_ns is not None:
                    settled_ns = settled_ns if settled_ns < span.end_ns else None
            elif settled_ns is None:
                settled_ns = start_ns
        return settled_ns

    def rest_ns(self, after_ns: Nanos) -> Nanos | None:
        """Since when (>= ``after_ns``) the shaft stands still for good, as things stand."""
        last = self._span_at(after_ns)
        if last.end_ns is not None:
            *_, last = self._spans_from(after_ns)
        return max(after_ns, last.start_ns) if isinstance(last, Still) else None

    # ---- inside ----

    def _spans(self) -> Iterator[Span]:
        """The future as things stand, from the present on; the last span has no end."""
        now_ns = self._shaft.now_ns
        if self._run_out is not None and self._run_out.end_ns is not None:
            rest_ns = self._run_out.end_ns
            if now_ns < rest_ns:
                yield self._run_out
                yield from self._at_rest(rest_ns, self._run_out.rest)
                return
        if self._set_point is None or self._is_blocked:
            yield Still(now_ns, None, _whole(self._shaft))
            return
        profile = self._ideal_profile if self._is_ideal else self._inertial_profile
        rest_at = yield from profile(self._set_point)
        if rest_at is not None:
            yield from self._after_profile(*rest_at)

    def _ideal_profile(
        self, set_point: SetPoint
    ) -> Generator[Span, None, tuple[Nanos, int] | None]:
        """Make every step of the set-point; returns when and where a profile with a target ends."""
        now_ns, offset = self._shaft.now_ns, self._shaft.offset
        assert offset is not None, "an ideal shaft always knows its lag"
        end_ns = set_point.end_ns if self._target is not None else None
        if end_ns is None:
            yield Following(now_ns, None, set_point, offset)
            return None
        if now_ns < end_ns:
            yield Following(now_ns, end_ns, set_point, offset)
        start_ns = max(now_ns, end_ns)
        return start_ns, offset + set_point.displacement_at(start_ns)

    def _inertial_profile(
        self, set_point: SetPoint
    ) -> Generator[Span, None, tuple[Nanos, int] | None]:
        """Run behind the set-point; returns when and where both have come to rest."""
        shaft = self._shaft
        chase = Chase(
            set_point,
            self._base,
            shaft.now_ns,
            shaft.exact,
            shaft.speed,
            shaft.offset is not None,
            self._speeding(),
            self._slowing(self._torque_nm),
        )
        rest = yield from chase.spans()
        return None if rest is None else (chase.now_ns, rest)

    def _at_rest(self, start_ns: Nanos, position: int) -> Iterator[Span]:
        """What follows a run-out: nothing, or the way back to the place that is held."""
        if self._is_blocked:
            yield Still(start_ns, None, position)
        else:
            yield from self._after_profile(start_ns, position)

    def _after_profile(self, start_ns: Nanos, position: int) -> Iterator[Span]:
        """Catch up with the target, if there is one, one increment every catch-up period."""
        if self._target is None or position == self._target:
            yield Still(start_ns, None, position)
            return
        period_ticks = self._catch_up_ticks
        first_ns = start_ns
        if self._shaft.step_due_ns is not None:
            first_ns = self._shaft.step_due_ns - period_ticks * TICK_NS
        missing = self._target - position
        pieces = (Piece(abs(missing), period_ticks),)
        steps = Trajectory(first_ns, 1 if missing > 0 else -1, pieces)
        assert steps.end_ns is not None, "a catch-up ends"
        yield Stepping(start_ns, steps.end_ns, steps, position)
        yield Still(steps.end_ns, None, self._target)

    def _spans_from(self, after_ns: Nanos) -> Iterator[Span]:
        """The spans that are not over at ``after_ns``."""
        assert after_ns >= self._shaft.now_ns, "the past is forgotten"
        return (s for s in self._spans() if s.end_ns is None or s.end_ns > after_ns)

    def _span_at(self, now_ns: Nanos) -> Span:
        """The span in which ``now_ns`` lies; a simple one is kept until it is another one.

        Time alone does not change it; whatever happens to the shaft drops it.
        """
        lone = self._lone
        if (
            lone is None
            or now_ns < lone.start_ns
            or (lone.end_ns is not None and now_ns >= lone.end_ns)
        ):
            lone = self._lone = self._simple_span_at(now_ns)
        return lone or next(self._spans_from(now_ns))

    def _simple_span_at(self, now_ns: Nanos) -> Span | None:
        """What ``_span_at`` finds where nothing is special, with less ado; else None."""
        set_point, shaft = self._set_point, self._shaft
        if self._run_out is not None or not self._is_ideal:
            return None
        if set_point is None or self._is_blocked:
            return Still(shaft.now_ns, None, _whole(shaft))
        offset = shaft.offset
        assert offset is not None, "an ideal shaft always knows its lag"
        if self._target is None:
            return Following(shaft.now_ns, None, set_point, offset)
        end_ns = set_point.end_ns
        if end_ns is None or now_ns < end_ns:
            return Following(shaft.now_ns, end_ns, set_point, offset)
        start_ns = max(shaft.now_ns, end_ns)
        if offset + set_point.displacement_at(start_ns) == self._target:
            return Still(start_ns, None, self._target)
        return None

    def _let_run(self, now_ns: Nanos, increments: int | None, slowing: Fraction) -> None:
        """Give up the set-point and come to rest after ``increments``, or at the rate given.

        An ideal shaft that is given no way rests at once.
        """
        if self._is_ideal and not increments:
            position = self.position_at(now_ns)
            self._set_point = self._target = self._run_out = self._lone = None
            self._shaft = _Shaft(now_ns, Fraction(position), NO_SPEED)
            return
        self.advance(now_ns)
        shaft, position = self._shaft, self.position_at(now_ns)
        if position != _whole(shaft):  # a set-point has begun a step at this very instant
            exact, speed = Fraction(position), self.speed_at(now_ns)
            shaft = shaft._replace(exact=exact, speed=speed)
        shaft = shaft._replace(exact=_bounded(shaft.exact), speed=_bounded(shaft.speed))
        self._set_point = self._target = self._run_out = self._lone = None
        if increments is None:
            increments = ceil(shaft.speed**2 / (2 * slowing))
        if shaft.speed == 0 or increments == 0:
            self._shaft = _Shaft(now_ns, Fraction(position), NO_SPEED)
            return
        direction = 1 if shaft.speed > 0 else -1
        way = position + direction * increments - shaft.exact
        rate = -(shaft.speed**2) / (2 * way)
        end_ns = now_ns + ceil(2 * way / shaft.speed)
        self._run_out = Arc(now_ns, end_ns, direction, shaft.exact, shaft.speed, rate)
        self._shaft = shaft._replace(offset=None)

    def _with_forces(self, now_ns: Nanos, load: Load, torque_nm: Fraction) -> None:
        """Change load and torque; what holds the shaft fast also ends its running out."""
        self.advance(now_ns)
        self._load, self._torque_nm, self._lone = load, torque_nm, None
        self._is_blocked = self._find_blocked()
        if load.held:
            self._run_out = None
            self._look_at_shaft(now_ns)  # it has no speed any more

    def _find_blocked(self) -> bool:
        """Whether the load keeps the drive from turning the shaft."""
        torque_nm = self._load.exact_torque_nm
        stalled = torque_nm > 0 and torque_nm >= self._torque_nm
        return self._load.held or stalled or (not self._is_ideal and not self._speeding())

    def _speeding(self) -> Fraction:
        """The rate at which an inertial shaft gains speed, in inc/ns²; 0 if it cannot."""
        assert self._mechanics is not None, "an ideal shaft has no rate"
        torque_nm = max(Fraction(0), self._torque_nm - self._load.exact_torque_nm)
        return self._mechanics.acceleration(torque_nm, self._load.exact_inertia_kgcm2)

    def _slowing(self, torque_nm: Fraction) -> Fraction:
        """The rate in inc/ns² at which the drive's ``torque_nm`` and the load slow the shaft down.

        Without any of them friction does, and at least at 1 inc/s².
        """
        if self._mechanics is None:
            return NO_SPEED
        total_nm = max(torque_nm + self._load.exact_torque_nm, self._mechanics.friction_nm)
        rate = self._mechanics.acceleration(total_nm, self._load.exact_inertia_kgcm2)
        return max(rate, Fraction(1, NS_PER_S**2))


def _whole(shaft: _Shaft) -> int:
    """The whole increments of a shaft's position, those complete in the direction it moves."""
    if shaft.exact.denominator == 1:
        return shaft.exact.numerator
    direction = -1 if shaft.speed < 0 else 1
    return direction * floor(direction * shaft.exact)
