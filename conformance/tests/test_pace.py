"""How long a run still takes: guesses, as good as what is known."""

from __future__ import annotations

from typing import Any

import pytest

from axistwin_conformance.base.errors import time_left
from axistwin_conformance.core.session import Session
from axistwin_conformance.engine.eta import Eta, weigh
from axistwin_conformance.engine.run import Engine


class Clock:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        """The time."""
        return self.now


def test_nobody_can_say_at_the_beginning() -> None:
    """No past, nothing done: silence is better than a number."""
    pace = Eta({"a": 1, "b": 1})
    assert pace.remaining_s is None
    pace.end("a", 3.0)
    assert pace.remaining_s is None, "one check says little about the others"


def test_the_run_so_far_gives_the_measure() -> None:
    """Five checks of one second each: the next five, twice as heavy, take ten."""
    pace = Eta({**{f"a{n}": 1.0 for n in range(5)}, **{f"b{n}": 2.0 for n in range(5)}})
    for n in range(5):
        pace.end(f"a{n}", 1.0)
    assert pace.remaining_s == pytest.approx(10.0)


def test_an_earlier_run_is_the_best_guide() -> None:
    """At once, check by check, whatever their weights are."""
    clock = Clock()
    pace = Eta({"a": 1, "b": 1, "c": 1}, {"a": 2.0, "b": 60.0, "c": 5.0}, clock)
    assert pace.remaining_s == pytest.approx(67.0)
    pace.begin("a")
    clock.now += 1.5
    assert pace.remaining_s == pytest.approx(65.5)
    clock.now += 20
    assert pace.remaining_s == pytest.approx(65.0), "a check that takes longer cannot pay for more"


def test_a_run_that_is_slower_than_the_earlier_one_is_guessed_longer() -> None:
    """Another adapter, another machine."""
    pace = Eta({"a": 1, "b": 1}, {"a": 4.0, "b": 10.0})
    pace.end("a", 8.0)
    assert pace.remaining_s == pytest.approx(20.0)


def test_a_check_that_is_new_is_guessed_from_the_others() -> None:
    """By its weight."""
    pace = Eta({"a": 1, "b": 1, "new": 3}, {"a": 2.0, "b": 2.0})
    assert pace.remaining_s == pytest.approx(10.0)


def test_at_the_end_nothing_is_left() -> None:
    """Zero, not None."""
    pace = Eta({"a": 1}, {"a": 2.0})
    pace.end("a", 2.0)
    assert pace.remaining_s == 0 or pace.remaining_s is None


def test_what_may_do_more_weighs_more(toy: Any) -> None:
    """Motion takes longer than a question, and full checks longer than quick ones."""

    def asks(session: Session) -> None:
        """Ask."""

    def moves(session: Session) -> None:
        """Move."""

    def moves_far(session: Session) -> None:
        """Move far."""

    toy.add(asks, "MACS-LINE-01")
    toy.add(moves, "MACS-LINE-01", safety="motion")
    toy.add(moves_far, "MACS-LINE-01", safety="motion", level="full")
    weights = weigh(Engine(toy.options()).plan())
    assert weights["asks"] < weights["moves"] < weights["moves_far"]


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.2, "a few seconds left"),
        (23, "about 25 s left"),
        (58, "about 1 min left"),
        (700, "about 12 min left"),
        (9000, "about 2.5 h left"),
    ],
)
def test_a_guess_is_told_as_rough_as_it_is(seconds: float, words: str) -> None:
    """Nobody is promised a second."""
    assert time_left(seconds) == words
