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
from trouble import (
    Trouble,
    interrupt,
    judge_envelope,
    judge_interrupted,
    judge_lost,
    meet,
    moments_of,
)

from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.transport.can import CanTransport

pytestmark = pytest.mark.strength

TRAVEL, SPEED = 2000, 10_000
STOPPED = partial(judge_interrupted, most=TRAVEL)
MOVING = ("MACC-CMD-13", "MACC-CMD-15", "MACC-CMD-16")
UNREACHABLE = (
    "the_address_is_given_in_three_steps",
    "requests_are_served_at_the_old_address_meanwhile",
    "a_factory_reset_brings_the_factory_values",
    "the_address_outlives_the_supply_once_it_holds",
)
SOAK = pytest.mark.soak
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

    def opened(neighbours: tuple[int, ...]) -> CanTransport:
        url = options.family.twin_url(options.model, options.address, neighbours)
        OPEN.append(twin_bus(f"{url}&bus=watch{next(NUMBERS)}"))
        watches.append(BusWatch(OPEN[-1], at_call))
        return CanTransport(
            watches[-1], url, is_spontaneous=codec.is_spontaneous, bitrate=BITRATE,
            is_builtin=True, is_lossless=is_lossless,
        )  # fmt: skip

    return Engine(options, opened).run(lambda event: None), watches


# --- the envelope ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("level", "seed"),
    [
        ("quick", 0),
        *(pytest.param("full", seed, marks=SOAK) for seed in range(12)),
    ],
)
def test_a_run_never_leaves_the_envelope(level: str, seed: int) -> None:
    """With --max-travel 2000, rig and all, no position further away is asked for, or reached."""
    result, watches = run(level=level, seed=seed)
    judge_envelope(result, watches, travel=TRAVEL, speed=SPEED)


# --- trouble at a random moment -------------------------------------------------------------------


def test_an_interrupt_at_any_moment_leaves_the_axis_at_rest_and_its_memory_as_it_was() -> None:
    """Twelve random moments of a run of motions."""
    moving = partial(run, words=MOVING)
    meet(Trouble(moments_of(12, moving, seed=3), interrupt, STOPPED), moving)


def test_an_interrupt_while_a_module_has_another_address_brings_it_back() -> None:
    """A hundred random moments of the probes and checks that give it another one."""
    away = partial(run, words=UNREACHABLE)
    meet(Trouble(moments_of(100, away, seed=2), interrupt, STOPPED), away)


@SOAK
def test_an_interrupt_at_a_hundred_random_moments() -> None:
    """All over a run of everything."""
    full = partial(run, level="full")
    meet(Trouble(moments_of(100, full, seed=1), interrupt, STOPPED), full)


def test_a_bus_lost_at_any_moment_ends_the_run_soon() -> None:
    """Nothing can be stopped then; that is said, and it is no crash."""

    def gone(*given: Any) -> NoReturn:
        raise can.CanOperationError("the adapter was pulled out")

    def lose() -> None:
        for name in ("send", "recv"):
            setattr(BusWatch, name, gone)
        gone()

    def judge(result: Result, watches: list[Any], met: Any, sent: int) -> None:
        judge_lost(result, met, sent, transport="bus")

    moving = partial(run, words=MOVING, is_lossless=False)
    meet(Trouble(moments_of(5, moving, seed=5), lose, judge), moving)
