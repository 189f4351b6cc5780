import pytest

from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_MS, NS_PER_S
from axistwin.runtime.clock import PacedClock, VirtualClock


class Source:
    """A count of nanoseconds that a test moves."""

    def __init__(self, now: int = 5_000_000_000_000) -> None:
        self.now = now

    def __call__(self) -> int:  # noqa: D102
        return self.now


def test_a_virtual_clock_stands_until_it_is_moved() -> None:
    """Virtual time passes by advance_to alone, and needs no sleep."""
    clock = VirtualClock(7)
    assert clock.now_ns() == 7
    clock.advance_to(1_000)
    assert clock.now_ns() == 1_000
    assert clock.delay_s(10**12) == 0.0
    assert clock.is_virtual


def test_a_virtual_clock_never_goes_back() -> None:
    """A time that has passed already does not move the clock."""
    clock = VirtualClock(100)
    clock.advance_to(99)
    assert clock.now_ns() == 100


def test_a_paced_clock_begins_at_its_start_whatever_the_source_shows() -> None:
    """The line's time begins at start_ns, not at the age of the machine."""
    source = Source()
    assert PacedClock(source=source).now_ns() == 0
    assert PacedClock(start_ns=42, source=source).now_ns() == 42


@pytest.mark.parametrize(("speed", "expected_ms"), [(1.0, 250), (20.0, 5_000), (0.5, 125)])
def test_a_paced_clock_runs_at_its_speed(speed: float, expected_ms: int) -> None:
    """A quarter of a second of the source is that many milliseconds of the line."""
    source = Source()
    clock = PacedClock(speed, source=source)
    source.now += 250 * NS_PER_MS
    assert clock.now_ns() == expected_ms * NS_PER_MS


def test_real_time_is_exact_to_the_nanosecond_after_a_year() -> None:
    """At speed 1 no floating point number is involved."""
    source = Source(0)
    clock = PacedClock(source=source)
    source.now = 365 * 86_400 * NS_PER_S + 1
    assert clock.now_ns() == source.now


def test_time_is_continuous_over_a_change_of_speed() -> None:
    """The clock goes on from where it is, only faster or slower."""
    source = Source()
    clock = PacedClock(source=source)
    source.now += NS_PER_S
    clock.speed = 10.0
    assert clock.now_ns() == NS_PER_S
    source.now += NS_PER_S
    assert clock.now_ns() == 11 * NS_PER_S
    clock.speed = 0.1
    assert clock.now_ns() == 11 * NS_PER_S
    source.now += NS_PER_S
    assert clock.now_ns() == pytest.approx(11.1 * NS_PER_S, abs=1)
    assert clock.speed == 0.1


def test_a_source_that_goes_back_does_not_take_the_clock_with_it() -> None:
    """What was told once stays told."""
    source = Source()
    clock = PacedClock(source=source)
    source.now += 1_000
    assert clock.now_ns() == 1_000
    source.now -= 600
    assert clock.now_ns() == 1_000
    source.now += 700
    assert clock.now_ns() == 1_100


@pytest.mark.parametrize("speed", [1.0, 3.0, 20.0, 0.25])
def test_after_the_delay_the_time_has_come(speed: float) -> None:
    """Sleeping for delay_s, rounded to a nanosecond, is at most one nanosecond short."""
    source = Source()
    clock = PacedClock(speed, source=source)
    until_ns = 123_456_789
    delay_s = clock.delay_s(until_ns)
    source.now += round(delay_s * NS_PER_S)
    assert until_ns - speed <= clock.now_ns() <= until_ns + speed
    source.now += 2
    assert clock.now_ns() >= until_ns
    assert clock.delay_s(until_ns) == 0.0


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf"), 1e9])
def test_an_impossible_speed_is_refused_in_one_line(speed: float) -> None:
    """The message names the value and the range; the clock keeps its speed."""
    with pytest.raises(UsageError, match=r"^speed .* is out of range: 1e-06\.\.1e\+06"):
        PacedClock(speed)
    clock = PacedClock()
    with pytest.raises(UsageError):
        clock.speed = speed
    assert clock.speed == 1.0
