"""Events run in the order of time, then rank."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin.kernel.schedule import Schedule


class Alarm:
    """A part with a list of times at which it wants to be woken."""

    def __init__(self, name: str, times: list[int], log: list[tuple[int, str]]) -> None:
        self.name = name
        self.times = sorted(set(times))
        self.log = log

    def next_event(self) -> int | None:
        """The earliest of the times asked for."""
        return self.times[0] if self.times else None

    def run(self, now: int) -> None:
        """Note it."""
        self.log.append((now, self.name))
        self.times = [time for time in self.times if time > now]


def test_ties_go_to_the_part_added_first() -> None:
    """Of two events at one nanosecond the lower rank runs first, whenever it was asked."""
    log: list[tuple[int, str]] = []
    schedule = Schedule([Alarm("a", [5, 9], log), Alarm("b", [5, 7], log)])
    schedule.touch(1)
    schedule.run_until(9)
    assert log == [(5, "a"), (5, "b"), (7, "b"), (9, "a")]
    assert schedule.now == 9
    assert schedule.next_event() is None


@given(st.lists(st.lists(st.integers(0, 50), max_size=8), max_size=5), st.lists(st.integers(0, 60)))
def test_any_way_of_stepping_runs_the_same_events(times: list[list[int]], stops: list[int]) -> None:
    """Where run_until pauses does not change what runs when."""
    log: list[tuple[int, str]] = []
    schedule = Schedule([Alarm(str(rank), each, log) for rank, each in enumerate(times)])
    for stop in sorted(stops):
        schedule.run_until(stop)
        assert schedule.now == stop
    schedule.run_until(100)
    assert log == sorted((time, str(rank)) for rank, each in enumerate(times) for time in set(each))


def test_events_up_to_and_including_the_limit_run_and_no_later_ones() -> None:
    """The limit is part of the time that passes."""
    log: list[tuple[int, str]] = []
    schedule = Schedule([Alarm("a", [3, 4], log)])
    assert not schedule.run_next(2)
    schedule.run_until(3)
    assert log == [(3, "a")]
    assert schedule.next_event() == 4


def test_a_touched_part_is_asked_again() -> None:
    """A change from outside counts from the touch on, also to never and back."""
    log: list[tuple[int, str]] = []
    alarm = Alarm("a", [50], log)
    schedule = Schedule([alarm], now=10)
    alarm.times = [20]
    schedule.touch(0)
    assert schedule.next_event() == 20
    alarm.times = []
    schedule.touch(0)
    assert schedule.next_event() is None


def test_an_event_in_the_past_runs_now() -> None:
    """A part that asks for a time gone by is woken at once, not in the past."""
    log: list[tuple[int, str]] = []
    alarm = Alarm("a", [], log)
    schedule = Schedule([alarm], now=10)
    alarm.times = [4]
    schedule.touch(0)
    assert schedule.next_event() == 10
    schedule.run_until(10)
    assert log == [(10, "a")]


def test_time_going_back_is_a_loud_bug() -> None:
    """Nobody may ask for the past."""
    schedule = Schedule([], now=10)
    with pytest.raises(AssertionError, match="time went back from 10 to 9"):
        schedule.run_until(9)


def test_a_part_that_stands_still_is_a_loud_bug() -> None:
    """A part that wants to be woken again at the same time would never let time pass."""

    class Stuck:
        def next_event(self) -> int | None:
            return 5

        def run(self, now: int) -> None:
            pass

    with pytest.raises(AssertionError, match="part 0 stands still at 5 ns"):
        Schedule([Stuck()]).run_until(6)
