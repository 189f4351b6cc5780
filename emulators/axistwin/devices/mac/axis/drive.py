"""The motor at work: set-point, shaft and counter of a MAC axis, and what ends a motion.

Theory
------
Exactly one of these has the shaft (``control``):

    Rest      nothing moves by itself; after 13h, 14h and 17h the place is held (ledger §5.5)
    Profile   a ``RampedMotion``: PO to a target, catch-up included, VE without end
    Segments  the ``Interpolator``: IN
    Brake     set-point and regulation are gone, the shaft runs out (18h, a stop)

Everything is closed form in time.  What happens by itself is one of two events, both computed the
moment something changes: the *end* of what runs, and a *stop* in its way.  (At rest there may be a
third: the shaft, coasting or pushed, stands still at last.)

Rules
-----
1. A motion starts from where the shaft really is.
2. A motion that begins blocked (``stops``) makes no step.  Stops are found on the way by asking
   when the counter reaches the first forbidden increment.
3. The end of a position motion is the end of "running" (MACS-AMB-27).
4. Segments that arrive during a profile wait for its end (MACS-AMB-31).
5. A position that is to be gone to after the segments (MACS-AMB-69) is given up with them, unless
   they end by themselves.
"""

from collections import deque
from collections.abc import Mapping
from fractions import Fraction
from typing import Final

from axistwin.devices.mac.axis.acceptance import State
from axistwin.devices.mac.axis.counter import Counter
from axistwin.devices.mac.axis.faults import Faults
from axistwin.devices.mac.axis.models import MacModel
from axistwin.devices.mac.axis.quirks import MacQuirks
from axistwin.devices.mac.axis.shaft_control import Brake, Profile, Rest, Segments, ShaftControl
from axistwin.devices.mac.axis.stops import Heading, Meeting, Stops
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.motion.inertia import Mechanics
from axistwin.motion.interpolator import Interpolator, Segment, Step, Underrun
from axistwin.motion.plant import Load, Plant
from axistwin.motion.ramp import (
    ChangeLaw,
    Ramp,
    RampedMotion,
    RampLaw,
    RampRules,
    Rounding,
    StopLaw,
    TriangleLaw,
    ramp_length,
    stop_pieces,
)
from axistwin.motion.trajectory import Piece, SetPoint, StepPhase

CATCH_UP_TICKS: Final = 1600
"""Ticks of one catch-up increment per unit of 0Eh: 200 µs (MACS-CMD-0E-01)."""

SWING_NS: Final = 50 * NS_PER_MS
"""Time between two steps of the swing in standby; no manual gives it (MACS-CMD-02-03)."""


class Drive:
    """Motor, shaft and counter.  ``values`` and ``faults`` are the axis', which keeps to them."""

    def __init__(
        self, model: MacModel, quirks: MacQuirks, values: Mapping[str, int], faults: Faults
    ) -> None:
        self._quirks = quirks
        self._faults = faults
        self._values = values
        self._torque_max_nm = model.torque_max_nm
        self._swings = quirks.standby_swing == "one" and quirks.position_source == "encoder"
        self._inertial = quirks.plant == "inertial"
        mechanics = Mechanics(model.increments_per_turn, model.rotor_inertia_kgcm2)
        self.plant = Plant(
            mechanics=mechanics if self._inertial else None,
            torque_nm=model.torque_max_nm,
        )
        self._loaded = self._inertial
        self.counter = Counter(self.plant, quirks)
        self.stops = Stops(quirks, values, self.counter)
        self._rules = RampRules(
            RampLaw(quirks.ramp_law),
            Rounding(quirks.period_rounding),
            TriangleLaw(quirks.triangle_law),
            ChangeLaw(quirks.vel_change_law),
            StopLaw(quirks.stop_ramp_law),
            StepPhase(quirks.step_phase),
        )
        self._last_ramp = Ramp(1, 0, self._rules)
        self.interpolator = Interpolator(
            counts_executing=quirks.fifo_counts_executing,
            underrun=Underrun(quirks.fifo_underrun),
            step_phase=StepPhase(quirks.step_phase),
        )
        brake = quirks.brake_increments
        self._brake_increments = None if brake == "plant" else int(brake)
        self.powered = False
        self._control: ShaftControl = Rest()
        """Who has the shaft."""
        self._position_mode = False
        self._old_target: int | None = None
        self._next: Nanos | None = None
        self._meeting: Meeting | None = None
        self._segments_wait = False
        self._accepted: deque[tuple[Segment, tuple[Piece, ...]]] = deque(maxlen=4)
        self.met_stop = 0
        """The bit of ff of a stop that has ended a motion; the axis clears it."""

    @property
    def kind(self) -> State | None:
        """PO, VE or IN while running; None at rest."""
        return self._control.kind

    # ---- counter -------------------------------------------------------------------------------

    def reading_at(self, now: Nanos) -> int:
        """The counter as it is read, the swing in standby included (MACS-Q-20-01)."""
        number = self.counter.at(now)
        return self.counter.fold(number + self._swing_at(now)) if self._swings else number

    def _swing_at(self, now: Nanos) -> int:
        """Where the shaft swings about the place that is held in standby (MACS-CMD-02-03)."""
        plant = self.plant
        still = self._swings and self.powered and self.kind is None and self._values["standby"]
        if not still or plant.position_at(now) != plant.target:
            return 0
        return (0, 1, 0, -1)[now // SWING_NS % 4]

    def zero(self, now: Nanos, *, keeps_remaining: bool) -> None:
        """Counter := 0; a 13h under way keeps its number or its way (MACS-AMB-52, -53)."""
        self.counter.set(now, 0)
        shaft = self._control
        if isinstance(shaft, Profile) and shaft.number is not None and not shaft.motion.stopping:
            motion, set_number = shaft.motion, self.counter.of_set_point(now)
            direction = motion.trajectory.direction
            if keeps_remaining:
                assert motion.target is not None, "a position motion has a target"
                remaining = motion.target - motion.trajectory.increments_at(now)
                shaft.number = set_number + direction * remaining
            elif motion.is_over(now):
                self._aim_anew(now, shaft, shaft.number)
            else:
                remaining = direction * (shaft.number - set_number)
                self._replan(now, shaft, motion.retarget(now, remaining))
        self.replan(now)

    def _aim_anew(self, now: Nanos, shaft: Profile, number: int) -> None:
        """The target of a profile that is over has moved (ledger §5.3)."""
        if self._quirks.overshoot_return == "catch_up":
            self.plant.aim(now, self.counter.place_of(number))
            return
        shaft.motion = self._move_to(now, number, now, shaft.motion.ramp)
        self.plant.follow(now, shaft.motion.trajectory, shaft.signed_target)

    def set_point_direction(self, now: Nanos) -> int:
        """Sign of the speed that a new one would take over; 0: the set-point rests."""
        shaft = self._control
        if isinstance(shaft, Segments):
            step = self.interpolator.step_in_progress(now)
            return step.direction if step else 0
        if not isinstance(shaft, Profile) or shaft.motion.is_over(now):
            return 0
        return shaft.motion.trajectory.direction

    def direction_at(self, now: Nanos) -> int:
        """Sign of the motion in progress, the catch-up included (ledger §4.1); 0: none."""
        return self.set_point_direction(now) or self._catch_up_direction(now)

    def _catch_up_direction(self, now: Nanos) -> int:
        """Sign of the way back to the target of a profile that is over; 0: there is none."""
        shaft, target = self._control, self.plant.target
        if not isinstance(shaft, Profile) or shaft.number is None or target is None:
            return 0
        if not shaft.motion.is_over(now):
            return 0
        position = self.plant.position_at(now)
        return (target > position) - (target < position)

    # ---- motions -------------------------------------------------------------------------------

    def go_to(self, now: Nanos, number: int, start_ns: Nanos) -> None:
        """13h, 14h: to counter ``number`` on the trapezoidal profile (MACS-CMD-13-01)."""
        motion = self._move_to(now, number, start_ns, self._ramp(self._values["period"]))
        self._begin(now, Profile(motion, number))

    def _move_to(self, now: Nanos, number: int, start_ns: Nanos, ramp: Ramp) -> RampedMotion:
        """The profile from where the counter is to ``number``."""
        distance = number - self.counter.at(now)
        return RampedMotion.to_target(start_ns, -1 if distance < 0 else 1, abs(distance), ramp)

    def go_to_after_segments(self, number: int) -> None:
        """13h, 14h: ``go_to`` when the segments, or the shaft, have run out (MACS-AMB-69)."""
        assert isinstance(self._control, Segments | Brake), "there is nothing to wait for"
        self._control.number_after = number

    def run_at(self, now: Nanos, period_ticks: int, direction: int, start_ns: Nanos) -> None:
        """15h with a speed: from rest, or out of whatever moves (MACS-CMD-15-01, -02)."""
        ramp, shaft = self._ramp(period_ticks), self._control
        step = self._end_segments(now) if isinstance(shaft, Segments) else None
        if step is not None:
            taken = RampedMotion.taking_over(step.start_ns, step.direction, step.period_ticks, ramp)
            self._begin(now, Profile(taken, None), taken.trajectory.displacement_at(now))
        elif isinstance(shaft, Profile) and not shaft.motion.is_over(now):
            shaft.number, self._position_mode = None, False
            self._replan(now, shaft, shaft.motion.change_speed(now, period_ticks))
            self.replan(now)
        else:
            self._begin(now, Profile(RampedMotion.endless(start_ns, direction, ramp), None))

    def offer(self, now: Nanos, segment: Segment, start_ns: Nanos) -> bool:
        """16h, 1Eh: store a segment, or refuse it (MACS-CMD-16-02); False: refused."""
        interpolator = self.interpolator
        self.plant.advance(now)
        interpolator.run(now)
        shaft = self._control
        waits = isinstance(shaft, Profile | Brake)
        if self.kind is not State.IN and self._quirks.interp_during_profile == "preempt":
            waits = False
        if not interpolator.has_room(now, released=not waits):
            return False
        if waits:
            self._segments_wait = True
            interpolator.hold()
            if isinstance(shaft, Brake):
                shaft.segments_follow = True
        elif not isinstance(shaft, Segments):
            self._begin_segments(now)
        descent = self._descent(segment)
        accepted = interpolator.offer(start_ns, segment, descent)
        assert accepted, "there was room"
        self._accepted.append((segment, descent))
        self.replan(now)
        return True

    def _descent(self, segment: Segment) -> tuple[Piece, ...]:
        """How the axis would slow down after ``segment`` (MACS-AMB-40, decelerate)."""
        if self._quirks.fifo_underrun != "decelerate":
            return ()
        aa = self._values["ramp"]
        return stop_pieces(ramp_length(aa), segment.period_ticks, aa, self._rules)

    def ramped_stop(self, now: Nanos) -> None:
        """17h, 15h 0000: ramp down; the place of rest is held (MACS-CMD-17-01).

        A catch-up has no ramp: it ends where the shaft is (ledger §4.1, §5.7).
        """
        shaft = self._control
        if not isinstance(shaft, Profile):
            return
        self._abandon_target(stays_busy=self._quirks.busy_after_17h)
        motion = shaft.motion
        if not motion.is_over(now):
            self._replan(now, shaft, motion.stop(now))
        elif shaft.number is not None:
            shaft.motion = RampedMotion.at_rest(now, motion.trajectory.direction, motion.ramp)
            self.plant.hold(now)
        self.replan(now)

    def drop_segments(self, now: Nanos) -> None:
        """Give up all segments at once; the next motion takes the shaft where it is."""
        self._end_segments(now)
        self._control = Rest()

    def stop_segments(self, now: Nanos, *, after_this_one: bool) -> None:
        """15h 0000 and 17h during segments, where they stop them (MACS-AMB-30, -32)."""
        if isinstance(self._control, Brake):
            self._control.number_after = None
            return
        self._control = Segments()  # and nothing after them
        if after_this_one:
            self.interpolator.drop_stored(now)
            self.replan(now)
            return
        step = self._end_segments(now)
        if step is None:
            self._finish(now)
            return
        ramp = self._ramp(step.period_ticks)
        taken = RampedMotion.taking_over(step.start_ns, step.direction, step.period_ticks, ramp)
        motion = taken.stop(now)
        self._begin(now, Profile(motion, None), motion.trajectory.displacement_at(now))

    def hard_stop(
        self, now: Nanos, *, keeps_segments: bool = False, is_standing: bool = False
    ) -> None:
        """18h, a stop: set-point frozen, regulation off, maximum braking (MACS-CMD-18-01).

        keeps_segments: what is stored waits for the next segment, or for the end of the next
        profile (MACS-AMB-51).  is_standing: the motion has not made a step yet.
        """
        self._abandon_target(stays_busy=self._quirks.busy_after_abort)
        kind, increments = self.kind, self._brake_increments
        if kind is None or (is_standing and increments is not None):
            increments = 0
        self.plant.brake(now, increments)
        self._take_segments(now, keeps_segments=keeps_segments)
        if kind is not None:
            self._control = Brake(kind)
        self.replan(now)

    def power_on(self, now: Nanos) -> None:
        """19h: holding torque (MACS-CMD-19-01); a coasting shaft is braked by it."""
        assert not self._faults.disjuncted, "the motor is powered in spite of a fault"
        self.powered = True
        self.apply_torque(now)
        if self._control == Rest(coasting=True):
            self.plant.brake(now)
        self.replan(now)

    def power_off(self, now: Nanos) -> None:
        """1Ah, a disjunction: no torque; the shaft coasts and is still counted (MACS-CMD-1A-01)."""
        self.plant.cut_power(now)
        self._take_segments(now, keeps_segments=False)
        self.powered = False
        self.counter.settled = True
        self._control = Rest(coasting=True)
        self.replan(now)

    def flush_waiting(self, now: Nanos) -> None:
        """Drop segments that wait for the end of a profile (MACS-AMB-77)."""
        if self._segments_wait:
            self._segments_wait = False
            self._end_segments(now)

    def _end_segments(self, now: Nanos) -> Step | None:
        """Drop all segments; the step that was in progress, if one was."""
        self.plant.advance(now)  # while the set-point still knows its past
        step = self.interpolator.step_in_progress(now)
        self.interpolator.flush(now)
        return step

    def _take_segments(self, now: Nanos, *, keeps_segments: bool) -> None:
        """The interpolator has lost the shaft: what is stored is dropped or waits."""
        interpolator = self.interpolator
        counted = self._quirks.fifo_counts_executing and interpolator.is_executing(now)
        stored = interpolator.stored_at(now) - counted
        interpolator.flush(now)
        self._segments_wait = keeps_segments and stored > 0
        if self._segments_wait:
            interpolator.hold()
            for segment, descent in list(self._accepted)[-stored:]:
                interpolator.offer(now, segment, descent)

    def _abandon_target(self, *, stays_busy: bool) -> None:
        """Give up what was aimed at; the axis ``stays_busy`` as long as it is not there, or is it
        no longer (MACS-AMB-51, -72)."""
        if not stays_busy:
            self._old_target = None
        elif self._position_mode and self.kind is State.PO and self._old_target is None:
            self._old_target = self.plant.target

    def _ramp(self, period_ticks: int) -> Ramp:
        """The ramp to full speed at that period, as 0Fh wants it; the last one is kept."""
        ramp = self._last_ramp
        if ramp.period_ticks != period_ticks or ramp.aa != self._values["ramp"]:
            ramp = self._last_ramp = Ramp(period_ticks, self._values["ramp"], self._rules)
        return ramp

    def _begin(self, now: Nanos, shaft: Profile, counted: int = 0) -> None:
        """Give the shaft to a profile; one that begins blocked makes no step (rule 2).

        counted: the signed steps of it that were counted before, by whom it takes over.
        """
        self._start(now, shaft)
        trajectory = shaft.motion.trajectory
        bit = self.stops.blocking_bit(now, trajectory.direction) if trajectory.pieces else 0
        if bit:
            self._stop_on(now, bit)
            return
        self.plant.follow(now, trajectory, shaft.signed_target, counted)
        self.replan(now)

    def _begin_segments(self, now: Nanos) -> None:
        """Give the shaft to the interpolator, with what waited; to be planned yet."""
        self._start(now, Segments())
        interpolator = self.interpolator
        self.plant.follow(now, interpolator, counted=interpolator.displacement_at(now))
        if self._segments_wait:
            self._segments_wait = False
            interpolator.release(now)

    def _start(self, now: Nanos, shaft: Profile | Segments) -> None:
        assert not self._faults.disjuncted, f"{shaft.kind.name} starts in spite of a fault"
        self._control = shaft
        self._position_mode = shaft.kind is State.PO
        self._old_target = None
        self.powered = True
        if self._quirks.ff_lifetime != "until_reset":
            self.stops.bits = 0
        self.apply_torque(now)

    def _replan(self, now: Nanos, shaft: Profile, motion: RampedMotion) -> None:
        """Go on with the running profile planned anew."""
        shaft.motion = motion
        self.plant.replace(now, motion.trajectory, shaft.signed_target)

    # ---- events --------------------------------------------------------------------------------

    def next_event(self) -> Nanos | None:
        """When a motion ends or meets a stop, or a shaft comes to rest, as things stand."""
        return self._next

    def run(self, now: Nanos) -> None:
        """Do what is due at ``now``."""
        if self.kind is None:
            self._control = Rest()
            self.counter.settled = True
            self.replan(now)
            return
        if self.stops.are_enabled and self._is_stopped(now):
            return
        end_ns = self._end_ns(now)
        if end_ns is not None and end_ns <= now:
            self._finish(now)
        else:
            self.replan(now)

    def _is_stopped(self, now: Nanos) -> bool:
        """Whether there is a stop that ends the motion at ``now``; it has, then."""
        heading = self._heading(now)
        if bit := self.stops.barring_bit(now, heading):
            self._bar(now, bit, heading.begun or 0)
        elif bit := self.stops.blocking_bit(now, heading.direction):
            self._stop_on(now, bit)
        elif bit := self.stops.met_bit(now, self._meeting):
            self._stop_on(now, bit, is_standing=self._has_turned(now))
        return bool(bit)

    def replan(self, now: Nanos) -> None:
        """Find the next event, now that an input, a parameter or a motion has changed."""
        self.counter.look_again()
        self._next = self._meeting = None
        if self.counter.is_frozen:
            return
        if self.kind is None:
            # Coasting, lagging behind, or coming back after a push: the counter ends somewhere.
            rest_ns = self.plant.rest_ns(now)
            self._next = rest_ns if rest_ns is not None and rest_ns > now else None
            return
        self._next = self._end_ns(now)
        meeting = self._meeting = self._next_meeting(now)
        if meeting is not None and (self._next is None or meeting.at_ns < self._next):
            self._next = meeting.at_ns

    def _end_ns(self, now: Nanos) -> Nanos | None:
        """When what runs is over, as things stand; None: never."""
        shaft = self._control
        if not isinstance(shaft, Profile):
            runs_out = isinstance(shaft, Brake)
            return self.plant.rest_ns(now) if runs_out else max(now, self.interpolator.end_ns)
        if shaft.motion.end_ns is None:
            return None
        end_ns = max(now, shaft.motion.end_ns)
        if shaft.number is None or self._returns_afresh(shaft.motion):
            return end_ns
        until = self._quirks.running_until
        if until == "profile":
            return end_ns
        return self.plant.settle_ns(end_ns, 0 if until == "exact" else self._values["tolerance"])

    def _returns_afresh(self, motion: RampedMotion) -> bool:
        return motion.overshoot > 0 and self._quirks.overshoot_return == "fresh_profile"

    def _finish(self, now: Nanos) -> None:
        """What ran is over: rest, the way back, or the segments that waited."""
        shaft = self._control
        if isinstance(shaft, Profile) and shaft.number is not None:
            back = shaft.motion.returning() if self._returns_afresh(shaft.motion) else None
            if back is not None:
                shaft.motion = back
                self.plant.follow(now, back.trajectory, shaft.signed_target)
                self.replan(now)
                return
        self._rest(now)
        number = shaft.number_after if isinstance(shaft, Segments | Brake) else None
        if number is not None:
            self.go_to(now, number, now)
        elif self._segments_wait and (not isinstance(shaft, Brake) or shaft.segments_follow):
            self._begin_segments(now)
            self.replan(now)

    def _rest(self, now: Nanos) -> None:
        self.plant.advance(now)
        self.interpolator.run(now)
        self._control = Rest()
        self.counter.settle(now)
        self.apply_torque(now)
        self.replan(now)

    # ---- stops ---------------------------------------------------------------------------------

    def _set_point(self) -> SetPoint | None:
        """What has the shaft; None at rest and while it runs out."""
        shaft = self._control
        if isinstance(shaft, Profile):
            return shaft.motion.trajectory
        return self.interpolator if isinstance(shaft, Segments) else None

    def _heading(self, now: Nanos) -> Heading:
        """Where the set-point, or the catch-up, is going at ``now``."""
        shaft, set_point = self._control, self._set_point()
        if set_point is None:
            return Heading(0)
        leg = set_point.leg_at(now)
        if not leg.direction:
            return Heading(self._catch_up_direction(now))
        if isinstance(shaft, Profile):
            sets_out = leg.start_ns >= now and not shaft.motion.trajectory.before
        else:
            sets_out = self.interpolator.sets_out_at(now)
        begun = set_point.displacement_at(now) - leg.displacement if sets_out else None
        return Heading(leg.direction, begun)

    def _next_meeting(self, now: Nanos) -> Meeting | None:
        """When a stop is met next, at the latest; None: never, as things stand."""
        if not self.stops.are_enabled or (set_point := self._set_point()) is None:
            return None
        return self.stops.next_meeting(now, self._heading(now), set_point)

    def _has_turned(self, now: Nanos) -> bool:
        """Whether the shaft does not go on beyond the stop it has met, and has no need to brake."""
        meeting = self._meeting
        return meeting is None or meeting.direction * self.plant.speed_at(now) <= 0

    def _stop_on(self, now: Nanos, bit: int, *, is_standing: bool = False) -> None:
        """End the motion at the stop of that ``bit`` of ff (ledger §4.3)."""
        self.stops.bits |= bit
        self.met_stop = bit
        keeps = not self._quirks.abort_flush
        self.hard_stop(now, keeps_segments=keeps, is_standing=is_standing)

    def _bar(self, now: Nanos, bit: int, begun: int) -> None:
        """Let a stretch that sets out now, on its step ``begun``, make no step (MACS-AMB-49)."""
        plant = self.plant
        place = plant.position_at(now) - (0 if plant.is_held_back(now) else begun)
        self._stop_on(now, bit, is_standing=True)
        plant.push(now, place - plant.position_at(now))
        self.replan(now)

    # ---- torque, load, busy --------------------------------------------------------------------

    def apply_torque(self, now: Nanos) -> None:
        """Let the motor give what 0Ch and standby allow (MACS-CMD-0C-01, -19-01)."""
        if self._loaded:
            self.plant.set_torque(now, self.torque_nm)
            self.counter.look_again()

    def torque_changed(self, now: Nanos) -> None:
        """0Ch, 02h: effective at once (MACS-CMD-0C-03)."""
        self.apply_torque(now)
        self.replan(now)

    @property
    def torque_nm(self) -> Fraction:
        """The torque limit in force, in Nm."""
        if not self.powered:
            return Fraction(0)
        part = Fraction(self._values["torque"], self._quirks.imax_value)
        halved = self.kind is None and self._values["standby"]
        return self._torque_max_nm * part / (2 if halved else 1)

    def apply_catch_up(self, now: Nanos) -> None:
        """0Eh: from the next catch-up increment on (MACS-CMD-0E-02); 0 acts as 1."""
        self.plant.set_catch_up(now, max(1, self._values["catchup"]) * CATCH_UP_TICKS)
        self.replan(now)

    def set_load(self, now: Nanos, load: Load) -> None:
        """What hangs on the shaft."""
        self._loaded = self._inertial or load != Load()
        self.plant.set_torque(now, self.torque_nm)
        self.plant.set_load(now, load)
        self.replan(now)

    def push(self, now: Nanos, increments: int) -> None:
        """Turn the shaft by hand."""
        self.plant.push(now, increments)
        self.replan(now)

    def is_busy(self, now: Nanos) -> bool:
        """Whether the axis does not follow (MACS-BUSY-01, -02)."""
        tolerance = self._values["tolerance"]
        if self._old_target is not None:
            return abs(self.plant.position_at(now) - self._old_target) > tolerance
        if self._position_mode:
            plant = self.plant
            if self._swings and abs(self._swing_at(now)) > tolerance:
                return True
            return plant.is_regulating and plant.is_busy(now, tolerance)
        # An ideal shaft without a load always has its set-point's speed.
        return self.kind is not None and self._loaded and self.plant.is_held_back(now)

    def is_moving(self, now: Nanos) -> bool:
        """Whether the counter changes by itself from ``now`` on."""
        if self.kind is not None:
            return True
        return self._next is not None and self._next > now  # when it comes to rest (``replan``)
