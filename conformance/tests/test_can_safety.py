"""Hardware safety on CAN, seen from outside: everything a run sends, where the shafts then are, and
how a run ends that is interrupted or loses its bus.  Runs are in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import count
from typing import Any, NoReturn

import can
import pytest
from bus_in_front import BITRATE, twin_bus
from bus_watch import BusWatch
from trouble import Trouble, interrupt, judge_way_out, meet, moments_of

from axistwin_conformance.can_target import CanTarget
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine import Engine, Result
from axistwin_conformance.events import Outcome
from axistwin_conformance.mac_can import codec

TRAVEL, SPEED = 2000, 10_000
MOVING = ("MACC-CMD-13", "MACC-CMD-15", "MACC-CMD-16")
SLOW, SOAK = pytest.mark.slow, pytest.mark.soak
NUMBERS = count()  # a bus of its own for each target
OPEN: list[Any] = []


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    """After each test, the buses that were left open for questions are closed."""
    yield
    while OPEN:
        OPEN.pop().shutdown()


def run(
    at_call: Callable[[Any], None] = lambda watch: None,
    *,
    words: tuple[str, ...] = (),
    level: str = "quick",
    seed: int = 0,
    is_lossless: bool = True,
) -> tuple[Result, list[BusWatch]]:
    """Run against the built-in twin inside the envelope; its buses stay open for questions."""
    options = make_options(
        model="mac23-can", ids=words, level=level, seed=seed, max_travel=TRAVEL, max_speed=SPEED
    )
    watches: list[BusWatch] = []

    def opened(neighbours: tuple[int, ...]) -> CanTarget:
        url = options.family.twin_url(options.model, options.address, neighbours)
        OPEN.append(twin_bus(f"{url}&bus=watch{next(NUMBERS)}"))
        watches.append(BusWatch(OPEN[-1], at_call))
        return CanTarget(
            watches[-1], url, is_spontaneous=codec.is_spontaneous, bitrate=BITRATE,
            is_builtin=True, is_lossless=is_lossless,
        )  # fmt: skip

    return Engine(options, opened).run(lambda event: None), watches


# --- the envelope ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("level", "seed"),
    [
        pytest.param("quick", 0, marks=SLOW),
        *(pytest.param("full", seed, marks=SOAK) for seed in range(12)),
    ],
)
def test_a_run_never_leaves_the_envelope(level: str, seed: int) -> None:
    """With --max-travel 2000, rig and all, no position further away is asked for, or reached."""
    result, watches = run(level=level, seed=seed)
    assert result.problems == []
    held_back = [one.trouble for one in result.checks if one.outcome is not Outcome.DONE]
    assert held_back == [], "the checks know the envelope; the fence had nothing to do"
    shafts = [shaft for watch in watches for shaft in watch.shafts]
    for shaft in shafts:
        assert shaft.asked <= TRAVEL + shaft.blur
        assert shaft.furthest <= TRAVEL + shaft.blur
        assert shaft.fastest <= SPEED
    assert max(shaft.furthest for shaft in shafts) > TRAVEL // 2, "there was motion"
    assert max(shaft.asked for shaft in shafts) > TRAVEL // 2
    for watch in watches:
        assert watch.stored() == watch.cells, "what the EEPROMs held is back"


# --- trouble at a random moment -------------------------------------------------------------------


def judge_interrupted(result: Result, watches: list[Any], met: Any, sent: int) -> None:
    """Stopped, put back, 130."""
    assert result.is_interrupted
    assert result.exit_status == 130
    assert result.problems == []
    judge_way_out(watches, met, sent, most=TRAVEL)


@SLOW
def test_an_interrupt_at_any_moment_leaves_the_axis_at_rest_and_its_memory_as_it_was() -> None:
    """Twelve random moments of a run of motions."""
    moving = partial(run, words=MOVING)
    meet(Trouble(moments_of(12, moving, seed=3), interrupt, judge_interrupted), moving)


@SOAK
def test_an_interrupt_at_a_hundred_random_moments() -> None:
    """All over a run of everything."""
    full = partial(run, level="full")
    meet(Trouble(moments_of(100, full, seed=1), interrupt, judge_interrupted), full)


@SLOW
def test_a_bus_lost_at_any_moment_ends_the_run_soon() -> None:
    """Nothing can be stopped then; that is said, and it is no crash."""

    def gone(*given: Any) -> NoReturn:
        raise can.CanOperationError("the adapter was pulled out")

    def lose() -> None:
        for name in ("send", "recv"):
            setattr(BusWatch, name, gone)
        gone()

    def judge(result: Result, watches: list[Any], met: Any, sent: int) -> None:
        assert result.exit_status in (3, 4)
        told = " ".join([*result.problems, result.refusal])
        assert "error in the suite" not in told
        assert "the bus failed" in told or "cannot open" in told
        if met.has_acted(sent):
            assert "could not stop the axis or put its parameters back" in told

    moving = partial(run, words=MOVING, is_lossless=False)
    meet(Trouble(moments_of(5, moving, seed=5), lose, judge), moving)
