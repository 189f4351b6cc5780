"""A shaft that is held or turned: whose position 20h tells, busy, catch-up, the lock (BUSY-01,
BUSY-02, CMD-0E, CMD-1A-02, CMD-18-01, STATE-01).

A held axis falls behind its set-point, which goes on.  Let go, it catches up by one increment every
VV·200 µs; the phase of the first one is open, so a prediction spans one increment.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.motion import SLOWEST, Sample, segment
from axistwin_conformance.families.mac.axis.driver.rig import (
    AT_ONCE,
    WORKED,
    RigBench,
    rig_bench_of,
)
from axistwin_conformance.families.mac.axis.exchanges import Kind
from axistwin_conformance.families.mac.axis.model.forecast import Window
from axistwin_conformance.families.mac.axis.model.kinematics import CATCH_UP_UNIT_TICKS, TICK_NS

ORDER = 240  # of this module in a run; see `Family.modules`

HOLD: Final = ("rig:hold",)
TURN: Final = ("rig:turn",)
LAG: Final = 40  # increments by which a held axis is left behind
TOLERANCE: Final = 10
SLOW_CATCH_UP: Final = 0x32  # 10 ms per increment: readings tell single increments
EASY_CATCH_UP: Final = 0xFF  # 51 ms per increment, for a bench on which time is real
PROFILE: Final = 2  # the reading of MACS-AMB-27 by which a motion is over with its profile
RESENT: Final = 8  # times: an EEPROM bears only so many writes
LAG_SHOWS_S: Final = 0.3
LONGEST_SEGMENT: Final = 0x7FFF  # increments: DDDD is signed


def _catch_up_ns(coefficient: int) -> int:
    """VV·200 µs per increment; 0 acts as 1 (MACS-AMB-47)."""
    return max(1, coefficient) * CATCH_UP_UNIT_TICKS * TICK_NS


def _fastest_catch_up(bench: RigBench, wanted: int) -> int:
    """That VV, or the fastest that stays within the envelope; a shaft let go knows no other."""
    if not bench.session.envelope.is_guarded:
        return wanted
    return max(wanted, -(-bench.fastest // CATCH_UP_UNIT_TICKS))


def _left_behind(bench: RigBench, catch_up: int, tolerance: int = 0, lag: int = LAG) -> int:
    """Hold the shaft, order a move, let its profile end; give the target."""
    start = bench.begin(0x0640)
    bench.accepted(0x0E, catch_up << 8)
    bench.command(0x1C, tolerance)
    bench.rig.hold_shaft(True)
    end = bench.go(start + lag).end
    assert end is not None
    bench.wait_until(end.latest_ns)
    bench.wait(0.1)
    return start + lag


def _source(bench: RigBench) -> bool:
    """Judge whose position 20h tells (MACS-AMB-55); True if that of the shaft itself."""
    place = bench.position()
    slack = bench.allowance(bench.period)
    outcome: int | str = f"position {place} of an axis held at {bench.start}"
    if abs(place - bench.start) <= slack:
        outcome = 0
    elif place == bench.start + LAG:
        outcome = 1
    bench.reading("position_source", outcome, "MACS-Q-20-01")
    return outcome == 0


@check("MACS-BUSY-01", "MACS-Q-27-03", "MACS-Q-20-01", "MACS-STATE-01", "MACS-CMD-1C-01",
       safety=WORKED, needs=HOLD)  # fmt: skip
def a_held_axis_is_busy_until_it_is_near_its_target(session: Session) -> None:
    """Held back, a move stays busy and locked; let go, it ends within tolerance, then exactly."""
    bench = rig_bench_of(session)
    if not bench.has_tolerance():
        session.skip("1Ch is not supported: no tolerance to judge by")
    catch_up = SLOW_CATCH_UP if bench.rig.is_exact else EASY_CATCH_UP
    target = _left_behind(bench, catch_up, TOLERANCE)
    busy = ("MACS-BUSY-01", "MACS-Q-27-03")
    session.expect(bench.is_busy(), busy, "busy while held", "not busy")
    is_shaft = _source(bench)
    locks = [_is_locked(bench)]
    let_go = Window(*bench.rig.hold_shaft(False))
    near_ns = (LAG - TOLERANCE // 2) * _catch_up_ns(catch_up)
    if not is_shaft:
        bench.wait_until(let_go.latest_ns + LAG * _catch_up_ns(catch_up) + 100_000_000)
        session.expect(not bench.is_busy(), busy, "not busy in the end", "busy")
        session.not_run(
            ("MACS-STATE-01", "MACS-CMD-1C-01"), "20h tells the set-point, not where the shaft is"
        )
        return
    _judge_busy(bench, target, let_go.latest_ns + near_ns, busy)
    locks.append(_is_locked(bench))
    bench.wait_until(let_go.latest_ns + (LAG + 5) * _catch_up_ns(catch_up))
    place = bench.position()
    session.expect(place == target, "MACS-BUSY-01", f"at last exactly {target}", place)
    session.expect(not bench.is_busy(), busy, "not busy", "busy")
    locks.append(_is_locked(bench))
    readings = ([True, False, False], [True, True, False], [False, False, False])
    told = f"locked while held, near, there: {locks}"
    outcome = readings.index(locks) if locks in readings else told
    bench.reading("running_until", outcome, "MACS-STATE-01")


def _is_locked(bench: RigBench) -> bool:
    """Whether 02h is refused, which every reading locks, with what is set already."""
    return bench.command(0x02, 0).kind is Kind.REFUSED


def _judge_busy(bench: RigBench, target: int, until_ns: int, requirement: tuple[str, str]) -> None:
    """On the way to a target, busy means more than the tolerance away, to one increment."""
    while bench.target.now_ns < until_ns:
        before = bench.position()
        is_busy = bench.is_busy()
        after = bench.position()
        places = range(min(before, after), max(before, after) + 1)
        admissible = {target - place > TOLERANCE for place in places}
        bench.session.expect(
            is_busy in admissible, (*requirement, "MACS-CMD-1C-01"),
            f"busy only with more than {TOLERANCE} of {target - before} left", is_busy,
        )  # fmt: skip


@check("MACS-CMD-0E-01", "MACS-CMD-0E-02", "MACS-BUSY-01", safety=WORKED, needs=HOLD)
def a_held_axis_catches_up_at_its_own_speed(session: Session) -> None:
    """Let go, one increment follows every VV·200 µs, whatever 0Dh; 0Eh counts under way too."""
    bench = rig_bench_of(session)
    speeds = (SLOW_CATCH_UP, EASY_CATCH_UP, 0x10, 1, 0)
    for catch_up in speeds if bench.rig.is_exact else (EASY_CATCH_UP,):
        if max(1, catch_up) < _fastest_catch_up(bench, 1):
            continue
        if catch_up == 0 and bench.command(0x0E, 0).kind is Kind.REFUSED:
            bench.reading("zero_catchup", 1, "MACS-CMD-0E-01")
            continue
        target = _left_behind(bench, catch_up)
        if bench.position() == target:
            session.skip("20h tells the set-point: nothing to see of the shaft (MACS-AMB-55)")
        let_go = Window(*bench.rig.hold_shaft(False))
        _follow_catch_up(bench, let_go, bench.start, target, catch_up, "MACS-CMD-0E-01")
        place = bench.rest()
        session.expect(place == target, ("MACS-CMD-0E-01", "MACS-BUSY-01"), target, place)
    _change_under_way(bench)
    if bench.rig.is_exact:
        _sent_again_under_way(bench)


def _follow_catch_up(
    bench: RigBench, since: Window, begin: int, target: int, catch_up: int, requirement: str
) -> None:
    """Read the counter until the end is due, each reading within the increment of the phase."""
    step_ns = _catch_up_ns(catch_up)
    way = 1 if target > begin else -1
    slack = 0 if bench.rig.is_exact else 1 + bench.allowance(bench.period)
    end_ns = since.latest_ns + (abs(target - begin) + 2) * step_ns
    while bench.target.now_ns < end_ns:
        sample = bench.sample()
        least, most = _caught_up(sample, since, step_ns, abs(target - begin))
        done = (sample.position - begin) * way
        bench.session.expect(
            least - slack <= done <= most + slack, requirement,
            f"{least}..{most} increments of {step_ns / 1e6:g} ms caught up", done,
        )  # fmt: skip
        bench.wait(step_ns / 2e9 if bench.rig.is_exact else 0.05)


def _caught_up(sample: Sample, since: Window, step_ns: int, lag: int) -> tuple[int, int]:
    least = (sample.taken.earliest_ns - since.latest_ns) // step_ns
    most = (sample.taken.latest_ns - since.earliest_ns) // step_ns + 1
    return max(0, min(lag, least)), min(lag, most)


@check("MACS-CMD-0E-01", "MACS-BUSY-01", "MACS-Q-20-01", safety=WORKED, needs=HOLD, level="full")
def a_move_held_for_a_while_makes_up_for_it_at_its_end(session: Session) -> None:
    """Held in the midst of a move the shaft stands where it was; let go, it follows with its lag,
    which is made up after the profile, one increment every VV·200 µs."""
    bench = rig_bench_of(session)
    if not bench.rig.is_exact or bench.known("position_source"):
        session.skip(f"{AT_ONCE}, and 20h to tell where the shaft is")
    start = bench.begin()
    bench.accepted(0x0E, SLOW_CATCH_UP << 8)
    target = start + bench.reach
    moving = bench.go(target)
    bench.wait(0.1)
    held = Window(*bench.rig.hold_shaft(True))
    lowest, highest = moving.bounds(held)
    place = bench.position()
    session.expect(
        lowest <= place <= highest, "MACS-Q-20-01", f"held at {lowest}..{highest}", place
    )
    bench.wait(LAG * bench.period * TICK_NS / 1e9)
    again = bench.position()
    session.expect(again == place, "MACS-Q-20-01", f"still at {place}", again)
    let_go = Window(*bench.rig.hold_shaft(False))
    bench.in_time(moving, let_go)
    missed = (moving.bounds(let_go)[0] - highest, moving.bounds(let_go)[1] - lowest)
    under_way = bench.sample()
    least, most = moving.bounds(under_way.taken)
    session.expect(
        least - missed[1] <= under_way.position <= most - missed[0], "MACS-BUSY-01",
        f"{missed[0]}..{missed[1]} increments behind {least}..{most}", under_way.position,
    )  # fmt: skip
    end = moving.end
    assert end is not None
    bench.wait_until(end.latest_ns)
    late = bench.sample()
    made_up = 2 + (late.taken.latest_ns - end.earliest_ns) // _catch_up_ns(SLOW_CATCH_UP)
    lag = target - late.position
    session.expect(
        missed[0] - made_up <= lag <= missed[1], "MACS-BUSY-01",
        f"{missed[0] - made_up}..{missed[1]} increments behind", lag,
    )  # fmt: skip
    _follow_catch_up(bench, late.taken, late.position, target, SLOW_CATCH_UP, "MACS-CMD-0E-01")
    place = bench.rest()
    session.expect(place == target, ("MACS-CMD-0E-01", "MACS-BUSY-01"), target, place)


@check("MACS-STOP-01", "MACS-CMD-0E-01", safety=WORKED, needs=(*HOLD, "rig:positive_stop"),
       level="full")  # fmt: skip
def a_hardware_stop_lets_a_catch_up_away_from_it_go_on(session: Session) -> None:
    """Catching up counts down: an active positive stop is none of its business."""
    _comes_back_from_a_stop(rig_bench_of(session), -LAG, 0)


@check("MACS-STOP-01", "MACS-CMD-0E-01", safety=WORKED,
       needs=(*HOLD, *TURN, "rig:positive_stop"), level="full")  # fmt: skip
def a_hardware_stop_lets_a_shaft_turned_too_far_come_back(session: Session) -> None:
    """The move led up, but what is left of it counts down: the positive stop does not end it."""
    bench = rig_bench_of(session)
    if not bench.rig.is_exact:
        session.skip(f"{AT_ONCE}: the shaft is turned while it is held")
    bench.needs_room(2 * LAG, "room to turn the shaft beyond its target")
    _comes_back_from_a_stop(bench, LAG, 2 * LAG)


def _comes_back_from_a_stop(bench: RigBench, distance: int, turned: int) -> None:
    """Hold the shaft in a move, turn it, close the positive stop, let go: it must count down."""
    start = bench.begin(0x0640)
    if bench.known("position_source"):
        bench.session.skip("20h tells the set-point: nothing to see of the shaft (MACS-AMB-55)")
    target = start + distance
    bench.accepted(0x0E, SLOW_CATCH_UP << 8)
    bench.accepted(0x03, 1)
    bench.rig.hold_shaft(True)
    end = bench.go(target).end
    assert end is not None
    bench.wait_until(end.latest_ns)
    bench.wait(0.1)
    if turned:
        bench.rig.turn_shaft(turned)
    bench.contact("positive_stop", True)
    bench.rig.hold_shaft(False)
    bench.wait((LAG + 5) * _catch_up_ns(SLOW_CATCH_UP) / 1e9)
    place, ff = bench.position(), bench.stopped_on()
    if bench.known("ff_lifetime") == 1:  # on this device ff shows the stop, not who met it
        ff = 0
    bench.contact("positive_stop", False)
    bench.accepted(0x03, 0)
    bench.session.expect(
        (place, ff) == (target, 0), ("MACS-STOP-01", "MACS-CMD-0E-01"),
        f"at {target}, ff 00", f"at {place}, ff {ff:02X}",
    )  # fmt: skip


def _change_under_way(bench: RigBench) -> None:
    """0Eh during catch-up is accepted, and counts from the next increment on."""
    slow, fast = EASY_CATCH_UP, _fastest_catch_up(bench, 5)
    target = _left_behind(bench, slow)
    bench.rig.hold_shaft(False)
    bench.wait(5 * _catch_up_ns(slow) / 1e9)
    changed = bench.accepted(0x0E, fast << 8, requirement="MACS-CMD-0E-02").taken
    # The increment under way may still be a slow one; the others take a millisecond each, or more.
    bench.wait_until(changed.latest_ns + _catch_up_ns(slow) + LAG * _catch_up_ns(fast))
    place = bench.position()
    bench.session.expect(place == target, "MACS-CMD-0E-02", f"already at {target}", place)


def _sent_again_under_way(bench: RigBench) -> None:
    """0Eh with what is set already changes nothing, however often it comes."""
    target = _left_behind(bench, EASY_CATCH_UP)
    let_go = Window(*bench.rig.hold_shaft(False))
    for _ in range(RESENT):
        bench.wait(0.03)
        bench.accepted(0x0E, EASY_CATCH_UP << 8, requirement="MACS-CMD-0E-02")
    sample = bench.sample()
    least, most = _caught_up(sample, let_go, _catch_up_ns(EASY_CATCH_UP), LAG)
    done = sample.position - (target - LAG)
    bench.session.expect(
        least <= done <= most, "MACS-CMD-0E-02",
        f"{least}..{most} increments caught up, 0Eh sent again or not", done,
    )  # fmt: skip


@check("MACS-BUSY-02", "MACS-Q-27-03", safety=WORKED, needs=HOLD)
def endless_motion_and_segments_are_busy_while_held(session: Session) -> None:
    """By 15h and 16h the axis is busy only while something keeps it from following."""
    bench = rig_bench_of(session)
    for way in bench.ways:
        if way.name == "13h":
            continue
        distance = min(LONGEST_SEGMENT, bench.room() if bench.rig.is_exact else bench.reach)
        start = bench.begin(bench.lasting(distance, 0.2 + 2 * LAG_SHOWS_S))
        moving = way.begin(bench, start, distance)
        bench.wait(0.1)
        session.expect(
            not bench.is_busy(),
            ("MACS-BUSY-02", "MACS-Q-27-03"),
            f"{way.name}: following, not busy",
            "busy",
        )
        held = Window(*bench.rig.hold_shaft(True))
        bench.in_time(moving, held)
        bench.wait(LAG_SHOWS_S)
        session.expect(
            bench.is_busy(), ("MACS-BUSY-02", "MACS-Q-27-03"), f"{way.name}: held, busy", "not busy"
        )
        free = Window(*bench.rig.hold_shaft(False))
        bench.in_time(moving, free)
        if way.is_endless:
            bench.wait(LAG_SHOWS_S)
            before = bench.position()
            bench.wait(0.1)
            session.expect(bench.position() > before, "MACS-BUSY-02", "turning again", "at rest")
            session.expect(
                not bench.is_busy(),
                ("MACS-BUSY-02", "MACS-Q-27-03"),
                "following again, not busy",
                "busy",
            )
        bench.at_rest()


@check("MACS-CMD-18-01", "MACS-CMD-18-03", safety=WORKED, needs=HOLD, level="full")
def a_stopped_move_does_not_catch_up(session: Session) -> None:
    """After 18h the target is given up: the shaft, let go, stays where it is and is not busy."""
    bench = rig_bench_of(session)
    _left_behind(bench, 1)
    bench.accepted(0x18)
    place = bench.position()
    if bench.known("running_until") != PROFILE:  # there 18h comes to a motion that is over
        bench.reading("busy_after_abort", int(bench.is_busy()), "MACS-CMD-18-03")
    bench.rig.hold_shaft(False)
    bench.wait(0.3)
    again, slack = bench.position(), bench.allowance(bench.period)
    session.expect(
        abs(again - place) <= slack, ("MACS-CMD-18-01", "MACS-CMD-18-03"), f"still {place}", again
    )
    session.expect(
        not _is_locked(bench), ("MACS-CMD-18-01", "MACS-CMD-18-03"), "no longer running", "locked"
    )


@check("MACS-CMD-17-01", "MACS-STATE-01", safety=WORKED, needs=HOLD, level="full")
def an_endless_motion_ends_with_its_ramp_though_the_shaft_is_held(session: Session) -> None:
    """17h ends velocity mode when the ramp is over: not busy, not locked, whatever holds the shaft;
    there is no target to wait for."""
    bench = rig_bench_of(session)
    if not bench.rig.is_exact:
        session.skip(f"{AT_ONCE}: endless motion is left to it")
    bench.begin()
    bench.turn(1, bench.period)
    bench.rig.hold_shaft(True)
    bench.wait(LAG_SHOWS_S)
    bench.accepted(0x17, requirement="MACS-CMD-17-01")
    bench.wait(LAG_SHOWS_S)
    session.expect(not bench.is_busy(), "MACS-CMD-17-01", "stopped, not busy", "busy")
    session.expect(not _is_locked(bench), "MACS-STATE-01", "no longer running", "locked")
    bench.accepted(0x18)


@check("MACS-CMD-0B-01", safety=WORKED, needs=HOLD, level="full")
def a_counter_is_cleared_where_the_shaft_is(session: Session) -> None:
    """0Bh while the shaft lags behind its set-point: 20h then tells 0, not how far it lags."""
    bench = rig_bench_of(session)
    bench.begin(SLOWEST)  # the less the shaft may have moved, the less of the envelope is lost
    with bench.own_origin() as origin:
        bench.finish(bench.go(10))
        bench.rig.hold_shaft(True)
        end = bench.go(10 + LAG).end
        assert end is not None
        bench.wait_until(end.latest_ns)
        bench.wait(0.1)
        before = bench.position()
        bench.accepted(0x0B)
        place = bench.position()
        bench.accepted(0x18)
        bench.rig.hold_shaft(False)
        origin.shift += before - place
    if abs(before - 10) > LAG // 2:
        session.skip("20h tells the set-point: nothing to see of the shaft (MACS-AMB-55)")
    session.expect(abs(place) <= bench.allowance(bench.period), None, f"0, and not {before}", place)


@check("MACS-CMD-0B-01", "MACS-CMD-13-01", safety=WORKED, needs=HOLD, level="full")
def a_move_whose_counter_is_cleared_while_it_lags_ends_where_it_should(session: Session) -> None:
    """0Bh in a move whose shaft is held: let go, it ends at its number, or after its way."""
    bench = rig_bench_of(session)
    bench.begin(SLOWEST)
    bench.accepted(0x0E, SLOW_CATCH_UP << 8)
    target = 10 + 3 * LAG
    with bench.own_origin() as origin:
        bench.finish(bench.go(10))
        bench.rig.hold_shaft(True)
        moving = bench.go(target)
        bench.wait(bench.lasting_s(LAG))
        before = bench.position()
        cleared = bench.accepted(0x0B)
        bench.rig.hold_shaft(False)
        bench.wait(bench.lasting_s(target) + target * _catch_up_ns(SLOW_CATCH_UP) / 1e9)
        place = bench.rest()
        origin.shift += before
    assert moving.end is not None
    bench.taken_in_time(cleared, moving.end.earliest_ns, "the motion")
    if abs(before - 10) > LAG // 2:
        session.skip("20h tells the set-point: nothing to see of the shaft (MACS-AMB-55)")
    due = target - before if bench.known("reset_in_motion") else target
    session.expect(
        abs(place - due) <= bench.allowance(bench.period), ("MACS-CMD-0B-01", "MACS-CMD-13-01"),
        f"at rest at {due}", place,
    )  # fmt: skip


# --- turned by hand ------------------------------------------------------------------------------


def _judge_turned(bench: RigBench, asked: int, done: int, requirement: str) -> None:
    """By hand about as far as asked; exactly so by the twin."""
    if bench.rig.is_exact:
        is_right = done == asked
    else:
        is_right = done * asked > 0 and abs(asked) // 4 <= abs(done) <= 4 * abs(asked)
    bench.session.expect(is_right, requirement, f"turned by {asked}", done)


@check("MACS-CMD-1A-02", safety=WORKED, needs=TURN)
def an_unpowered_shaft_is_still_counted(session: Session) -> None:
    """Turned by hand after 1Ah, in either direction, the counter follows and nothing returns."""
    bench = rig_bench_of(session)
    start = bench.begin()
    bench.finish(bench.go(start + 20))
    bench.accepted(0x1A)
    bench.needs_travel(20, "room to turn the shaft by hand")
    for share in (20, -35, 12):  # of what is left of the envelope
        asked = share * min(bench.room(), 1000) // 100
        before = bench.position()
        bench.rig.turn_shaft(asked)
        bench.wait(0.3)
        _judge_turned(bench, asked, bench.rest() - before, "MACS-CMD-1A-02")


@check("MACS-CMD-18-01", "MACS-BUSY-01", safety=WORKED, needs=TURN, level="full")
def a_turned_shaft_comes_back_only_where_it_is_regulated(session: Session) -> None:
    """After a move a turned shaft returns at the catch-up speed; after 18h it stays turned."""
    bench = rig_bench_of(session)
    start = bench.begin()
    bench.accepted(0x0E, SLOW_CATCH_UP << 8)
    place = bench.finish(bench.go(start + 30))
    if bench.rig.is_exact:
        for asked in (25, -25):
            turned = Window(*bench.rig.turn_shaft(asked))
            if bench.position() == place:
                session.skip("20h tells the set-point: nothing to see of the shaft (MACS-AMB-55)")
            _follow_catch_up(bench, turned, place + asked, place, SLOW_CATCH_UP, "MACS-BUSY-01")
    else:
        bench.rig.turn_shaft(25)
        bench.wait(2.0)
    back = bench.rest()
    session.expect(back == place, "MACS-BUSY-01", f"back at {place}", back)
    bench.accepted(0x18)
    bench.rig.turn_shaft(-25)
    _judge_turned(bench, -25, bench.rest() - place, "MACS-CMD-18-01")
    bench.command(0x18)


@check("MACS-CMD-17-01", "MACS-BUSY-01", safety=WORKED, needs=TURN, level="full")
def a_turned_shaft_comes_back_to_where_a_ramped_stop_has_left_it(session: Session) -> None:
    """17h holds the place it comes to rest at, with or without segments that were waiting."""
    bench = rig_bench_of(session)
    if not bench.rig.is_exact or bench.known("position_source"):
        session.skip(f"{AT_ONCE}, and 20h to tell where the shaft is")
    waiting = not bench.known("interp_during_profile") and not bench.known("abort_flush")
    for segments in range(1 + waiting):
        start = bench.begin()
        bench.accepted(0x0E, SLOW_CATCH_UP << 8)
        bench.go(start + bench.reach)
        for _ in range(segments):
            bench.accepted(0x16, segment(20, bench.period))
        bench.wait(0.05)
        bench.accepted(0x17, requirement="MACS-CMD-17-01")
        place = bench.rest()
        turned = Window(*bench.rig.turn_shaft(25))
        _follow_catch_up(bench, turned, place + 25, place, SLOW_CATCH_UP, "MACS-CMD-17-01")
        back = bench.rest()
        session.expect(back == place, "MACS-CMD-17-01", f"back at {place}", back)
        if not bench.known("busy_after_abort"):
            session.expect(not bench.is_busy(), "MACS-BUSY-01", "not busy", "busy")


@check("MACS-CMD-1A-01", "MACS-STATE-01", safety=WORKED, needs=HOLD, level="full")
def power_off_gives_a_held_move_up(session: Session) -> None:
    """After 1Ah nothing is regulated any more: a shaft that was held stays where it is let go."""
    bench = rig_bench_of(session)
    _left_behind(bench, 1)
    bench.accepted(0x1A)
    place = bench.position()
    bench.rig.hold_shaft(False)
    bench.wait(0.3)
    again, slack = bench.position(), bench.allowance(bench.period)
    session.expect(abs(again - place) <= slack, "MACS-CMD-1A-01", f"still {place}", again)
    session.expect(not _is_locked(bench), "MACS-STATE-01", "no longer running", "locked")
    bench.finish(bench.go(again + 20), "MACS-CMD-1A-01")  # power comes back with the next motion
