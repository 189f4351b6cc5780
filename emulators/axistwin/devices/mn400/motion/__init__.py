"""The motion of an MN400, planned in closed form and without any protocol.

The public interface
--------------------
A command becomes one immutable ``VectorMotion``.  It answers for every time, and every change
(``pause``, ``resume``, ...) returns the motion that follows.

    from axistwin.devices.mn400.motion import MotionRules, MoveSettings, SpeedProfile, straight

    rules = MotionRules.of(quirks)               # fields have the names of the ledger's switches
    settings = MoveSettings(
        rules,
        profile=SpeedProfile(1000, 5000, 10000),  # command F
        speed=2000,                               # command V; negative: external pulses
        multiplex=1,                              # command X
        lash=(0, 0, 0, 0),                        # command B
        lash_memory=(1, 1, 1, 1),                 # command D, then ``lash_memory_at``
        feed_permille=1000,                       # feed-rate pot
    )
    motion = straight(now_ns, settings, (1000, 0, -500, 0))

What makes a motion.  All distances are displacements in steps, axes count from 0:

    straight(now_ns, settings, displacement)                                            M
    arc(now_ns, settings, Plane(x, y, z), center, destination, clockwise)               A
    helix(now_ns, settings, plane, center, destination, clockwise, traverse, turns)     +
    contour(now_ns, settings, [ContourSegment(displacement, speed)], margin)      ( ... )
    thread(now_ns, settings, displacement, pulses, offset)                              T
    jog(now_ns, settings, axis, direction)       endless, at settings.speed; ``quit(ramped=True)``
    arc_is_round(settings.rules, center, destination)    False: PARA_ERROR (MN4-ARC-02, MN4-ARC-07)
    JogTaps().tap(steps_per_inch, resolution, direction, rules) -> (whole steps, JogTaps)

What a motion answers.  Times are ``Nanos``; None means never, as planned now.

    since_ns            the motion answers for times from here on (a change starts a new one)
    end_ns              when it is over; None while paused or without pulses
    total               commanded displacement of the four axes
    position_at(t)      commanded displacement so far; add it to the counters at the start, wrap
                        there (MN4-MOT-06).  Compensation counts only if rules.backlash_counts
    remaining_at(t)     total - position (N, net and signed);  path_left_at(t)  steps not taken
    made_at(t)          steps made in either direction, compensation included
    phantom_at(t)       ticks of multi-axis moves so far (E1, E2)
    rates_at(t)         steps per second of each axis, signed, compensation included
    headings_at(t)      direction (+1, 0, -1) of the next step of each axis; 0: none will come.
                        Known before the pulses are; 0 while it stands paused
    step_time_ns(axis, n)            time of the n-th commanded step, n >= 1
    steps(axis, from_ns, until_ns)   MotorSteps with from_ns < t <= until_ns, compensation included
    next_step(axis, after_ns, direction)   first MotorStep after that time in that direction:
                        a limit that is on halts the motion at this time (MN4-LIM-02)
    lash_memory_at(t)   directions for the next motion's ``lash_memory``
    is_over_at(t), is_paused, rest_ns      paused: since when it stands (PauseState), or None

What changes it.  All take ``now_ns`` >= since_ns and return a new motion.

    pause(now_ns)                    ramps down to start speed and stops, if rules.pause_decel
    resume(now_ns)                   also while it still slows down
    quit(now_ns, ramped=False)       Q, limits and shield; ramped: rules.quit_decel, limit_ramp
    halt_axis(now_ns, axis)          that axis stops at once, the others go on (limit_halts = axis)
    override(now_ns, feed_permille)  feed-rate or jog-speed pot, 0..1000
    index(now_ns)                    the threader's index pulse
    feed(now_ns, pulses)             pulses by hand; their steps are at now_ns in the new motion
    paced_by(now_ns, train | None)   pulses of a spindle; PulseTrain(rate_millihertz,
                                     pulses_per_turn, origin_ns): the index is each so-many-th
                                     pulse from origin_ns on, whenever the motion starts

Rules
-----
1. Time is an integer number of nanoseconds.  A step happens at the nanosecond nearest to its exact
   time; positions and step times agree at every nanosecond.
2. A query costs the same after a second and after an hour: O(log n) in the number of segments.
3. A plan costs O(n) in the number of segments; a change costs a plan of what remains.
4. ``steps`` are asked for up to now before the motion is changed.  After ``feed`` at t, ask the
   new motion for (t - 1, t].
5. With rules.step_phase = "start" a step may happen at the very start: ask for (start - 1, ...].
"""

from axistwin.devices.mn400.motion.arcs import Plane, arc, arc_is_round, helix
from axistwin.devices.mn400.motion.jog import JogTaps
from axistwin.devices.mn400.motion.motion import VectorMotion
from axistwin.devices.mn400.motion.moves import ContourSegment, contour, jog, straight, thread
from axistwin.devices.mn400.motion.paths import MotorStep
from axistwin.devices.mn400.motion.pulses import PulseTrain
from axistwin.devices.mn400.motion.rules import MotionRules, MoveSettings, SpeedProfile

__all__ = [
    "ContourSegment",
    "JogTaps",
    "MotionRules",
    "MotorStep",
    "MoveSettings",
    "Plane",
    "PulseTrain",
    "SpeedProfile",
    "VectorMotion",
    "arc",
    "arc_is_round",
    "contour",
    "helix",
    "jog",
    "straight",
    "thread",
]
