"""Hardware safety, seen from outside: everything a run sends, where the shafts then are, and how a
run ends that is interrupted, crashes or loses its port.

Runs are in virtual time.
"""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Any, NoReturn

import pytest
import serial
from shaft_watch import Watch
from trouble import (
    Trouble,
    interrupt,
    judge_envelope,
    judge_interrupted,
    judge_lost,
    judge_way_out,
    meet,
    moments_of,
)

from axistwin_conformance.base.events import Outcome
from axistwin_conformance.cli import make_options
from axistwin_conformance.core.session import Session
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport

pytestmark = pytest.mark.strength

TRAVEL, SPEED = 2000, 10_000
STOPPED = partial(judge_interrupted, most=TRAVEL)
MAC = ("mac23", "--allow", "motion,stored", "--level", "quick", "--max-travel", str(TRAVEL))
MOVING = ("MACS-CMD-13", "MACS-CMD-15", "MACS-CMD-16", "MACS-CMD-0D", "MACS-CMD-09")
UNREACHABLE = (
    "the_address_can_be_programmed",
    "the_rate_can_be_programmed",
    "a_factory_reset_brings_the_factory_values",
    "the_rate_outlives_the_supply",
    "the_address_outlives_the_supply",
)
SOAK = pytest.mark.soak
NOBODY: Callable[[Watch], None] = lambda watch: None  # noqa: E731 - a default, not a function


def run(
    *words: str,
    level: str = "full",
    seed: int = 0,
    at_call: Callable[[Watch], None] = NOBODY,
    is_lossless: bool = True,
    max_speed: int = SPEED,
) -> tuple[Result, list[Watch]]:
    """Run against the built-in twin inside the envelope; its lines stay open for questions.

    `is_lossless`: what is lost is the device's doing, as in virtual time it must be.
    """
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    options = make_options(
        model="mac23", ids=words, level=level, seed=seed, max_travel=TRAVEL, max_speed=max_speed
    )
    watches: list[Watch] = []

    def open_watch(neighbours: tuple[int, ...]) -> SerialTransport:
        url = options.family.twin_url(options.model, options.address, neighbours)
        watches.append(Watch(serial.serial_for_url(url, baudrate=options.rate or 38400), at_call))
        return SerialTransport(watches[-1], url, is_builtin=True, is_lossless=is_lossless)

    return Engine(options, open_watch).run(lambda event: None), watches


def watched(
    at_call: Callable[[Watch], None],
    *,
    words: Sequence[str] = (),
    level: str = "quick",
    is_lossless: bool = True,
) -> tuple[Result, list[Watch]]:
    """A run of which somebody is told call by call."""
    return run(*words, level=level, at_call=at_call, is_lossless=is_lossless)


# --- the envelope --------------------------------------------------------------------------------


@pytest.mark.strength(seconds=40)
@pytest.mark.parametrize(
    ("level", "seed"),
    [
        ("quick", 0),
        ("full", 0),
        *(pytest.param("full", seed, marks=SOAK) for seed in range(1, 20)),
    ],
)
def test_a_run_never_leaves_the_envelope(level: str, seed: int) -> None:
    """With --max-travel 2000, rig and all, no position further away is asked for, or reached."""
    result, watches = run(level=level, seed=seed)
    judge_envelope(result, watches, travel=TRAVEL, speed=SPEED)


@pytest.mark.parametrize("max_speed", [130, 300])
def test_a_shaft_that_is_let_go_does_not_catch_up_too_fast(max_speed: int) -> None:
    """0Eh is a speed as well: --max-speed holds for it."""
    name = "a_held_axis_catches_up_at_its_own_speed"
    result, watches = run(name, max_speed=max_speed)
    assert result.exit_status == 0, result.sentence
    assert max(shaft.fastest for watch in watches for shaft in watch.shafts) <= max_speed


# --- trouble at a random moment ------------------------------------------------------------------


class Crash(Exception):  # noqa: N818 - no error of anybody's
    """A mistake in a check."""


@pytest.mark.strength(seconds=20)
def test_an_interrupt_at_any_moment_leaves_the_axis_at_rest_and_its_memory_as_it_was() -> None:
    """Forty random moments of a run at level quick."""
    quick = partial(watched, level="quick")
    meet(Trouble(moments_of(40, quick, seed=3), interrupt, STOPPED), quick)


def test_an_interrupt_while_a_module_has_another_address_or_rate_brings_it_back() -> None:
    """Two hundred random moments of the probes and checks that give it another one."""
    away = partial(watched, words=UNREACHABLE)
    meet(Trouble(moments_of(200, away, seed=2), interrupt, STOPPED), away)


@SOAK
def test_an_interrupt_at_two_hundred_random_moments() -> None:
    """All over a run of everything."""
    full = partial(watched, level="full")
    meet(Trouble(moments_of(200, full, seed=1), interrupt, STOPPED), full)


def test_a_port_lost_at_any_moment_ends_the_run_soon() -> None:
    """Nothing can be stopped then; that is said, and it is no crash."""

    def judge(result: Result, watches: list[Watch], met: Watch, sent: int) -> None:
        judge_lost(result, met, sent, transport="port")

    lost = Lost(for_good=True)
    moving = partial(watched, words=MOVING[:3], is_lossless=False)
    meet(Trouble(moments_of(5, moving, seed=5), lost.begin, judge), moving)


def test_a_port_that_fails_once_does_not_keep_the_axis_from_being_stopped() -> None:
    """What was under way is spoilt; then the stop goes out and everything is put back."""

    def judge(result: Result, watches: list[Watch], met: Watch, sent: int) -> None:
        told = " ".join([*result.problems, result.refusal])
        assert "error in the suite" not in told
        assert result.exit_status in (0, 3, 4)
        judge_way_out(watches, met, sent, most=TRAVEL, is_ended=False)

    lost = Lost(for_good=False)
    moving = partial(watched, words=MOVING[:3], is_lossless=False)
    meet(Trouble(moments_of(5, moving, seed=6), lost.begin, judge), moving)


@dataclass
class Lost:
    """A port that raises, once or from now on."""

    for_good: bool

    def begin(self) -> None:
        """Lose it."""
        if self.for_good:
            for name in ("write", "read"):
                setattr(Watch, name, _gone)
        _gone()


def _gone(*given: Any) -> NoReturn:
    raise serial.SerialException("device reports readiness to read but returned no data")


def test_a_crash_of_a_check_at_any_moment_leaves_the_others_to_be_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The check is an error of the suite, told as one; stopped, put back, exit 4."""

    def judge(result: Result, watches: list[Watch], met: Watch, sent: int) -> None:
        crashed = [one.trouble for one in result.checks if one.outcome is Outcome.ERROR]
        (told,) = [*crashed, *result.problems]  # a check has crashed, or a probe
        assert "Crash: a mistake" in told
        assert len(result.checks) == len(result.plan.to_run)
        assert result.exit_status == 4
        judge_way_out(watches, met, sent, most=TRAVEL)

    crashing = Crashing(Session.expect, random.Random(4).sample(range(60), 3), judge)

    def expect(session: Session, *given: Any) -> None:
        crashing(session, *given)

    monkeypatch.setattr(Session, "expect", expect)
    meet(crashing.trouble, partial(watched, words=MOVING[-2:]))


class Crashing:
    """A way of judging that crashes at some of its calls, each in a child of this process."""

    def __init__(
        self,
        judge: Callable[..., None],
        calls: Sequence[int],
        verdict: Callable[[Result, list[Watch], Watch, int], None],
    ) -> None:
        self._judge, self._calls, self._numbers = judge, calls, count()
        self.trouble = Trouble(frozenset({-1}), self._crash, verdict)
        self._watch: Watch | None = None

    def _crash(self) -> None:
        raise Crash("a mistake")

    def __call__(self, session: Session, *given: Any) -> None:
        """Judge, or crash."""
        if next(self._numbers) in self._calls:
            watch: Any = session.target._port
            self.trouble.moments = frozenset({self.trouble.calls + 1})
            self.trouble(watch)
        self._judge(session, *given)


# --- signals to a real process on a real pty -----------------------------------------------------


@dataclass
class Ended:
    """How a process ended: its status, what it said, what its last event was, and what failed."""

    status: int
    errors: str
    last: dict[str, Any]
    failed: list[dict[str, Any]]


def signalled(
    port: str, number: int, moment: tuple[int, float], times: int, words: Sequence[str] = MAC
) -> Ended:
    """Start a run on a port; send a signal (more than once) so many events and seconds into it."""
    command = [sys.executable, "-m", "axistwin", "conform", *words, "--port", port, "--json"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        lines = [process.stdout.readline() for _ in range(moment[0])]
        time.sleep(moment[1])  # two events into it, the axis is moved to detect the readings
        for _ in range(times):
            process.send_signal(number)
        lines += process.stdout.readlines()
        errors = process.stderr.read()
        process.wait(60)
    told = [json.loads(line) for line in lines]
    failed = [one for one in told if one.get("verdict") == "fail"]
    return Ended(process.returncode, errors, told[-1], failed)


@pytest.fixture
def pty_twin(axistwin: Callable[..., Any]) -> Any:
    """A twin behind a real pty; bytes take no time."""
    return axistwin("mac23", pacing=False)


@pytest.mark.parametrize(
    ("number", "moment", "times"),
    [
        (signal.SIGINT, (2, 0.0), 1),
        (signal.SIGINT, (2, 1.7), 3),
        (signal.SIGINT, (2, 5.1), 1),
        (signal.SIGTERM, (2, 0.6), 1),
        (signal.SIGTERM, (2, 3.3), 2),
        (signal.SIGTERM, (2, 8.2), 1),
        (signal.SIGHUP, (2, 2.4), 1),
        (signal.SIGHUP, (2, 6.9), 1),
        pytest.param(signal.SIGINT, (135, 0.4), 1, marks=SOAK),
        pytest.param(signal.SIGTERM, (150, 1.1), 1, marks=SOAK),
    ],
)
def test_a_signal_ends_a_run_on_a_port_safely(
    pty_twin: Any, number: int, moment: tuple[int, float], times: int
) -> None:
    """SIGINT, SIGTERM, SIGHUP, also when impatient: at rest, put back, told, 130, no traceback."""
    before = {name: cell for name, cell in pty_twin.cells.items() if name != "position"}
    ended = signalled(pty_twin.port, number, moment, times)
    assert ended.status == 130, (ended.errors, ended.failed)
    assert "Traceback" not in ended.errors
    assert ended.last["event"] == "run_finished"
    assert ended.last["sentence"].startswith("Interrupted")
    assert ended.last["problems"] == []
    place = pty_twin.position
    time.sleep(0.3)
    assert pty_twin.position == place
    assert not pty_twin.is_moving
    after = {name: cell for name, cell in pty_twin.cells.items() if name != "position"}
    assert after == before
