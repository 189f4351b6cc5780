"""The search for the instant at which a twin says what was recorded."""

from collections.abc import Callable

import pytest

from axistwin.cli.replay.moments import ROUNDS_MAX, Moment, words_of
from axistwin.kernel.time import NS_PER_MS

REACH_NS = 5 * NS_PER_MS


def tries(wanted: str, says: Callable[[int], str]) -> list[int]:
    """The shifts that are tried until the device, which ``says`` something at each, says it."""
    moment = Moment(words_of(wanted), REACH_NS)
    moment.note(0, words_of(says(0)))
    tried: list[int] = []
    while len(tried) < ROUNDS_MAX and moment.go_on():
        tried.append(moment.shift_ns)
        told = says(moment.shift_ns)
        if told == wanted:
            break
        moment.note(moment.shift_ns, words_of(told))
    return tried


@pytest.mark.parametrize("at_ns", [-4_999_000, -700_001, 3, 1_234_567, 4_999_999])
@pytest.mark.parametrize("per_s", [500, -70_000])
def test_a_position_is_found_wherever_it_is(at_ns: int, per_s: int) -> None:
    """By few tries, though it is there only as long as one increment takes."""

    def says(shift_ns: int) -> str:
        far, near = (1000 + (shift_ns * rate) // 10**9 for rate in (per_s, per_s // 7))
        return f"position = {far},{near}"

    tried = tries(says(at_ns), says)
    if says(at_ns) != says(0):
        assert says(tried[-1]) == says(at_ns)
    assert max(map(abs, tried), default=0) <= REACH_NS
    assert len(tried) <= 14


@pytest.mark.parametrize("wanted", ["position = 2000,143", "position = 1010,999", "at rest"])
def test_what_is_nowhere_is_tried_to_the_edges_and_given_up(wanted: str) -> None:
    """Other numbers, numbers that never come together, other words."""
    tried = tries(wanted, lambda shift_ns: f"position = {1000 + shift_ns // 100_000},143")
    assert {REACH_NS, -REACH_NS} <= set(tried)
    assert len(tried) < ROUNDS_MAX


def test_words_without_numbers_are_tried_on_both_sides() -> None:
    """A state that ends within the reach; bytes that differ behind the same words are no place."""
    assert tries("moves", lambda shift_ns: "moves" if shift_ns < -1_000_000 else "rests")
    moment = Moment(words_of("moves"), REACH_NS)
    for shift_ns in (0, 1, 2):
        moment.note(shift_ns, words_of("moves"))
    assert moment.go_on()
