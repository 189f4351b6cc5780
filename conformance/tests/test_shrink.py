"""Shrinking: what is left still fails, nothing more can be spared, and the budget holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin_conformance.sequences.shrink import Budget, shrink, towards_zero

pytestmark = pytest.mark.strength

Numbers = tuple[int, ...]
PLENTY = Budget(10**9, 10**9, clock=lambda: 0.0)
LISTS = st.lists(st.integers(0, 9), max_size=24).map(tuple)


def holds_in_order(needed: Sequence[int]) -> Callable[[Numbers], bool]:
    """Fails where these numbers come, in that order, whatever is between."""

    def fails(numbers: Numbers) -> bool:
        rest = iter(numbers)
        return all(one in rest for one in needed)

    return fails


def odd_world(salt: int, known: Numbers) -> Callable[[Numbers], bool]:
    """Fails for one list and, without rule, for about a third of all others."""
    return lambda numbers: numbers == known or hash((salt, numbers)) % 3 == 0


@given(LISTS, st.data())
def test_a_hidden_cause_is_all_that_is_left(numbers: Numbers, data: st.DataObject) -> None:
    """Whatever stands between the operations that matter goes."""
    needed = data.draw(st.sampled_from([numbers[::3], numbers[1::4], numbers[:2], ()]))
    found = shrink(numbers, holds_in_order(needed), PLENTY)
    assert found.operations == tuple(needed)
    assert found.is_minimal


@given(LISTS, st.integers())
def test_no_single_operation_can_be_spared(numbers: Numbers, salt: int) -> None:
    """Also where failing follows no rule, the result fails and is 1-minimal."""
    fails = odd_world(salt, numbers)
    found = shrink(numbers, fails, PLENTY)
    kept = found.operations
    assert found.is_minimal
    assert fails(kept)
    assert not any(fails(kept[:place] + kept[place + 1 :]) for place in range(len(kept)))


@given(LISTS, st.integers())
def test_no_single_operation_can_be_simpler(numbers: Numbers, salt: int) -> None:
    """Simplifying goes on until neither it nor leaving out helps."""
    fails = odd_world(salt, numbers)
    found = shrink(numbers, fails, PLENTY, range)
    kept = found.operations
    assert fails(kept)
    for place, number in enumerate(kept):
        assert not fails(kept[:place] + kept[place + 1 :])
        assert not any(fails((*kept[:place], less, *kept[place + 1 :])) for less in range(number))


@given(LISTS, st.integers(), st.integers(0, 60))
@settings(max_examples=200)
def test_the_budget_of_operations_is_never_exceeded(
    numbers: Numbers, salt: int, allowed: int
) -> None:
    """And what is returned has failed, however early it ended."""
    performed: list[Numbers] = []
    fails = odd_world(salt, numbers)

    def counted(candidate: Numbers) -> bool:
        performed.append(candidate)
        return fails(candidate)

    found = shrink(numbers, counted, Budget(allowed, 10**9, clock=lambda: 0.0), range)
    assert sum(map(len, performed)) == found.performed <= allowed
    assert len(performed) == found.tries
    assert fails(found.operations)
    assert found.steps[0] == numbers
    assert found.steps[-1] == found.operations
    assert all(fails(one) for one in found.steps)


def test_no_try_begins_after_the_last_second() -> None:
    """The clock is the budget's own; ten seconds a try make four of them in 35."""
    seconds = [0.0]

    def slow(numbers: Numbers) -> bool:
        seconds[0] += 10
        return 3 in numbers

    found = shrink(tuple(range(40)), slow, Budget(10**6, 35, clock=lambda: seconds[0]))
    assert (found.tries, found.seconds, found.is_minimal) == (4, 40.0, False)
    assert 3 in found.operations
    assert len(found.operations) < 40


def test_what_did_not_fail_is_not_played_again() -> None:
    """A real line is slow enough."""
    performed: list[Numbers] = []

    def fails(numbers: Numbers) -> bool:
        performed.append(numbers)
        return {2, 5} <= set(numbers)

    assert shrink(tuple(range(8)), fails, PLENTY).operations == (2, 5)
    assert len(performed) == len(set(performed))


def test_forty_operations_with_a_cause_of_two_take_few_tries() -> None:
    """Halves first: fewer tries than there are operations."""
    found = shrink(tuple(range(40)), holds_in_order((11, 29)), PLENTY)
    assert found.operations == (11, 29)
    assert found.tries < 40


def test_bytes_become_zero_half_or_one_less() -> None:
    """Only at the places named, and never larger."""
    assert list(towards_zero(bytes([7, 9, 1, 0]), (1, 2, 3))) == [
        bytes([7, 0, 1, 0]), bytes([7, 4, 1, 0]), bytes([7, 8, 1, 0]), bytes([7, 9, 0, 0]),
    ]  # fmt: skip
