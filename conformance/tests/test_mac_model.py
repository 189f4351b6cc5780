"""The exact model of a MAC: what it admits, what it learns, where it expects the axis."""

from __future__ import annotations

import random

import pytest

from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.acceptance import (
    ACCEPTANCE,
    LOCKED_IN_MOTION,
    STATES,
)
from axistwin_conformance.families.mac.axis.model.axis_model import AxisModel, Parameters
from axistwin_conformance.families.mac.axis.model.forecast import (
    Forecast,
    Segment,
    Timeline,
    TimeWindow,
    slowed_down,
    speed_changed,
)
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS, Course, Law

MS = 1_000_000
PERIOD = 800  # 0.1 ms per increment


def model(**changes: int) -> AxisModel:
    """A module at rest at 0 without ramp, at 10000 increments per second."""
    values = {
        "superior": 1000, "inferior": -1000, "catch_up": 5, "period": PERIOD, "coefficient": 0,
        "torque": 0x40, "standby": 0, "stops": 0, "tolerance": 0, "imax": 0x80, **changes,
    }  # fmt: skip
    return AxisModel(Parameters(**values), Forecast.rest(0))


def at(ms: float, spread_ms: float = 0) -> TimeWindow:
    """A window that begins at a time."""
    return TimeWindow(round(ms * MS), round((ms + spread_ms) * MS))


def tell(axis: AxisModel, index: int, parameter: int, when: TimeWindow) -> ReplyKind:
    """Send a command to which one reply only is admissible, and take it over."""
    outcomes = axis.outcomes(index, parameter & 0xFFFFFFFF, when)
    (kind,) = outcomes
    axis.learn(index, parameter & 0xFFFFFFFF, kind, outcomes[kind])
    return kind


def test_the_table_has_every_index_and_state() -> None:
    """48 indices, eight states, and the eight commands that motion locks."""
    assert sorted(ACCEPTANCE) == list(range(0x30))
    assert all(len(row.cells) == len(STATES) for row in ACCEPTANCE.values())
    marked = {0x02, 0x03, 0x09, 0x0A, 0x0D, 0x0F, 0x13, 0x14}
    unassigned = {0x04, 0x05, 0x06, 0x12, 0x1D, 0x1F}
    assert set(LOCKED_IN_MOTION) == marked | unassigned


def test_a_move_locks_until_its_last_increment() -> None:
    """13h is refused during a move and accepted on the tick after it."""
    axis = model()
    assert tell(axis, 0x13, 100, at(0)) is ReplyKind.ACCEPTED
    assert tell(axis, 0x13, 50, at(9.9)) is ReplyKind.REFUSED
    assert tell(axis, 0x13, 50, at(10)) is ReplyKind.ACCEPTED


def test_around_the_end_of_a_move_both_replies_are_admissible_and_one_is_learnt() -> None:
    """A window over the end admits both; the reply that comes tells which history is true."""
    axis = model()
    tell(axis, 0x13, 100, at(0))
    outcomes = axis.outcomes(0x0F, 3, at(9.5, 1))
    assert set(outcomes) == {ReplyKind.ACCEPTED, ReplyKind.REFUSED}
    axis.learn(0x0F, 3, ReplyKind.REFUSED, outcomes[ReplyKind.REFUSED])
    assert axis.parameters.coefficient == 0
    axis.learn(0x0F, 3, ReplyKind.ACCEPTED, outcomes[ReplyKind.ACCEPTED])
    assert axis.parameters.coefficient == 3


def test_positions_are_bounded_by_both_windows() -> None:
    """Start known to 1 ms, reading known to 1 ms: 20 increments of doubt and one of phase."""
    axis = model()
    tell(axis, 0x13, 1000, at(0, 1))
    assert axis.bounds(at(50, 1)) == (490, 511)


def test_a_software_stop_ends_one_increment_beyond() -> None:
    """With 03h = 8 a move rests at the superior stop + 1, and ff tells."""
    axis = model(stops=8, superior=40)
    tell(axis, 0x13, 100, at(0))
    assert axis.bounds(at(50)) == (41, 41)
    assert axis.stopped_on(at(50)) == {0x02}
    tell(axis, 0x13, 200, at(60))
    assert axis.bounds(at(100)) == (41, 41)
    tell(axis, 0x13, 0, at(110))
    assert axis.stopped_on(at(111)) == {0}
    assert axis.bounds(at(150)) == (0, 0)


def test_the_fifth_segment_of_a_burst_is_refused() -> None:
    """One executes, three wait; when the first ends, one more is accepted."""
    axis = model()
    kinds = [tell(axis, 0x1E, segment_parameter(100, PERIOD), at(number)) for number in range(5)]
    assert kinds == [ReplyKind.ACCEPTED] * 4 + [ReplyKind.REFUSED]
    assert tell(axis, 0x16, segment_parameter(-100, PERIOD), at(10)) is ReplyKind.ACCEPTED
    assert axis.bounds(at(100)) == (-100, -100)


def test_a_fifo_that_counts_the_executing_segment_is_one_shorter() -> None:
    """The other reading of AMB-37."""
    axis = model()
    axis.known = lambda switch: int(switch == "fifo_counts_executing")
    kinds = [tell(axis, 0x1E, segment_parameter(100, PERIOD), at(number)) for number in range(4)]
    assert kinds == [ReplyKind.ACCEPTED] * 3 + [ReplyKind.REFUSED]


def test_a_preloaded_move_starts_on_11h() -> None:
    """10h, 13h, 11h: nothing before, the move after, and nothing held afterwards."""
    axis = model()
    tell(axis, 0x10, 0, at(0))
    tell(axis, 0x13, 50, at(1))
    assert axis.bounds(at(100)) == (0, 0)
    tell(axis, 0x11, 0, at(100))
    assert axis.bounds(at(200)) == (50, 50)
    tell(axis, 0x13, 0, at(200))
    assert axis.bounds(at(300)) == (0, 0)


def test_15h_against_the_motion_keeps_the_direction() -> None:
    """SS of a second 15h is ignored; 18h stops where the axis is."""
    axis = model()
    tell(axis, 0x15, velocity(-1, PERIOD), at(0))
    tell(axis, 0x15, velocity(1, PERIOD), at(10))
    lowest, highest = axis.bounds(at(20))
    assert (lowest, highest) == (-201, -200)
    tell(axis, 0x18, 0, at(20))
    assert axis.bounds(at(90)) == (-200, -200)


def test_values_outside_their_sets_are_refused() -> None:
    """Torque above Imax, period 0, mode 2, a target beyond 31 bits, a segment of no period."""
    axis = model()
    for index, parameter in (
        (0x0C, 0x81), (0x0D, 0), (0x03, 2), (0x02, 2), (0x13, 0x40000000), (0x1E, 0x00100000),
    ):  # fmt: skip
        assert set(axis.outcomes(index, parameter, at(0))) == {ReplyKind.REFUSED}, hex(index)


def test_segments_follow_on_the_very_tick() -> None:
    """Chained segments end at the sum of their ticks."""
    row = (Segment(7, 801), Segment(3, 999, moves=False), Segment(-4, 650))
    timeline = Timeline("IN", 0, 0, segments=row)
    total = (7 * 801 + 3 * 999 + 4 * 650) * TICK_NS
    assert timeline.end_ns == total
    assert timeline.position_at(total - 1) == 4
    assert timeline.position_at(total) == 3


def test_busy_lasts_until_the_tolerance() -> None:
    """|position − target| > TT is busy; at the target it is not."""
    axis = model(tolerance=10)
    tell(axis, 0x13, 100, at(0))
    assert axis.busy(at(1)) == {True}
    assert axis.busy(at(9.5)) == {False}
    assert axis.busy(at(60)) == {False}


def test_a_motion_that_ends_one_beyond_a_stop_may_tell_of_it_or_not() -> None:
    """Whether target or stop ended it is not said; what 21h tells once, it goes on telling."""
    axis = model(stops=8, superior=40)
    tell(axis, 0x13, 41, at(0))
    assert axis.bounds(at(50)) == (41, 41)
    assert axis.stopped_on(at(50)) == {0x00, 0x02}
    axis.learn_status(0x02, at(50))
    assert axis.stopped_on(at(60)) == {0x02}
    tell(axis, 0x18, 0, at(61))
    assert axis.stopped_on(at(62)) == {0x02}


def test_the_ends_of_stages_are_foretold() -> None:
    """Each segment of a row ends on its tick; what is over is not named."""
    axis = model()
    for _ in range(2):
        tell(axis, 0x16, segment_parameter(10, PERIOD), at(0))
    assert axis.forecast.ends_after(0) == [1 * MS, 2 * MS]
    assert axis.forecast.ends_after(1 * MS) == [2 * MS]


def test_a_row_made_segment_by_segment_is_the_row_made_at_once() -> None:
    """Adding a segment keeps what is known of those before it."""
    row = (Segment(7, 801), Segment(3, 999, moves=False), Segment(-4, 650))
    whole = Timeline("IN", 0, 0, segments=row, stops=(-50, 50))
    grown = Timeline("IN", 0, 0, segments=row[:1], stops=(-50, 50))
    for one in row[1:]:
        grown = grown.followed_by(one)
    assert grown == whole
    assert grown.legs == whole.legs


def test_an_axis_abandoned_in_a_window_may_stand_where_it_turned_round_in_it() -> None:
    """Two segments there and back, dropped at nobody knows what time: the turning place counts."""
    for index in (0x00, 0x18, 0x1A):
        axis = model()
        tell(axis, 0x16, segment_parameter(20, PERIOD), at(0))
        tell(axis, 0x16, segment_parameter(-30, PERIOD), at(0.1))
        tell(axis, index, 0, at(1, 3.5))  # between +10 and -5, over +20
        lowest, highest = axis.bounds(at(100))
        assert (lowest, highest) == (-5, 20), f"{index:02X}h"
        axis = model()
        tell(axis, 0x16, segment_parameter(20, PERIOD), at(0))
        tell(axis, 0x16, segment_parameter(-30, PERIOD), at(0.1))
        tell(axis, index, 0, at(1, 500))  # or when all is over
        assert axis.bounds(at(1000)) == (-10, 20), f"{index:02X}h"


def test_where_a_row_turns_round_within_a_window_is_within_its_bounds() -> None:
    """A reply that is long on its way: the axis may have been further than at either edge."""
    row = (Segment(100, PERIOD), Segment(-100, PERIOD))
    forecast = Forecast.of([Timeline("IN", 0, 0, segments=row)])
    lowest, highest = forecast.bounds(at(5, 10))
    assert lowest <= 50
    assert 100 <= highest <= 101


def test_a_later_start_is_ahead_where_its_increment_ends_right_as_the_speed_changes() -> None:
    """Increments of 2 ms, then of 0.2 ms: who has to wait 2 ms for the change loses ten of them."""
    axis = model(period=16_000)
    tell(axis, 0x13, -800, at(0, 3))
    tell(axis, 0x15, velocity(-1, 1600), at(100))
    tell(axis, 0x18, 0, at(110))
    later = Timeline("PO", 0, 125, -1, Course.to_position(800, 16_000, 0, Law()))
    changed = speed_changed(later, 100 * MS, 1600)
    assert changed.position_at(110 * MS) == -99
    assert axis.bounds(at(120)) == (-99, -90)


@pytest.mark.parametrize("seed", range(80))
def test_no_history_of_a_motion_changed_under_way_is_beyond_the_bounds(seed: int) -> None:
    """Whenever it began, was changed and stopped in windows as wide as a disturbed line makes."""
    drawn = random.Random(seed)
    periods = [drawn.choice((1600, 2048, 6144, 16384, 0xFFFF)) for _ in range(2)]
    coefficient, stop = drawn.choice((0, 0, 1, 2, 5)), drawn.choice((0x17, 0x18))
    axis = model(coefficient=coefficient)
    windows, time_ms = [], 0.0
    for index, parameter in (
        (0x15, velocity(1, periods[0])), (0x15, velocity(1, periods[1])), (stop, 0)
    ):  # fmt: skip
        windows.append(at(time_ms, drawn.choice((0, 0.2, 1, 5, 30))))
        tell(axis, index, parameter, windows[-1])
        time_ms = windows[-1].latest_ns / MS + drawn.uniform(1, 200)
    seen = []
    for _ in range(100):
        began, changed, stopped = (
            drawn.choice((*window, drawn.randint(*window))) for window in windows
        )
        law = Law(rounding=drawn.choice(("down", "half_up", "up")))
        history = Timeline("VE", 0, began, 1, Course.endless(periods[0], coefficient, law))
        history = speed_changed(history, changed, periods[1])
        history = history.at_rest(stopped) if stop == 0x18 else slowed_down(history, stopped)
        seen.append(history.position_at(round(time_ms * MS)))
    lowest, highest = axis.bounds(at(time_ms))
    assert lowest <= min(seen), "behind the bounds"
    assert max(seen) <= highest, "ahead of the bounds"
