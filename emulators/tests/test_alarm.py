"""The alarm: exact, once, and off when it is off."""

import select
import time
from collections.abc import Iterator

import pytest

from axistwin.kernel.time import NS_PER_MS, NS_PER_S
from axistwin.runtime.serving.alarm import Alarm


@pytest.fixture
def alarm() -> Iterator[Alarm]:
    """An alarm that is not set."""
    alarm = Alarm()
    yield alarm
    alarm.close()


def has_gone_off(alarm: Alarm, within_s: float) -> bool:
    """Whether the alarm goes off within that time."""
    return bool(select.select([alarm], [], [], within_s)[0])


def test_an_alarm_that_is_not_set_stays_quiet(alarm: Alarm) -> None:
    """Nothing to notice."""
    assert not has_gone_off(alarm, 0.0)


def test_it_goes_off_after_its_delay_and_not_before(alarm: Alarm) -> None:
    """The delay is a lower bound."""
    begin = time.monotonic_ns()
    alarm.set(3 * NS_PER_MS)
    assert has_gone_off(alarm, 5.0)
    assert time.monotonic_ns() - begin >= 3 * NS_PER_MS


@pytest.mark.parametrize("delay_ns", [0, -5, 1])
def test_a_delay_that_is_over_goes_off_at_once(alarm: Alarm, delay_ns: int) -> None:
    """Zero and less are no special case for the caller."""
    alarm.set(delay_ns)
    assert has_gone_off(alarm, 5.0)


def test_setting_it_again_replaces_the_delay(alarm: Alarm) -> None:
    """There is one alarm, not a list."""
    alarm.set(1)
    assert has_gone_off(alarm, 5.0)
    alarm.set(100 * NS_PER_S)
    assert not has_gone_off(alarm, 0.0)


def test_clearing_it_forgets_what_has_gone_off(alarm: Alarm) -> None:
    """A cleared alarm is as good as new."""
    alarm.set(1)
    assert has_gone_off(alarm, 5.0)
    alarm.clear()
    assert not has_gone_off(alarm, 0.0)
