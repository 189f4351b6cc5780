"""Hardware safety, seen from outside: everything a run sends, where the shafts then are, and how a
run ends that is interrupted, crashes or loses its port.

Runs are in virtual time.  At each of the moments chosen for trouble the process forks, and the
child meets it there: so hundreds of interrupts all over a run cost little more than that run.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any, NoReturn

import pytest
import serial
from shaft_watch import ACTING, Watch, orders

from axistwin_conformance.cli import make_options
from axistwin_conformance.engine import Engine, Result
from axistwin_conformance.events import Outcome
from axistwin_conformance.session import Session
from axistwin_conformance.targets import TWIN_HANDLER, Target

TRAVEL, SPEED = 2000, 10_000
MOVING = ("MACS-CMD-13", "MACS-CMD-15", "MACS-CMD-16", "MACS-CMD-0D", "MACS-CMD-09")
STOP = 0x18
SLOW = pytest.mark.slow
SOAK = pytest.mark.soak
NOBODY: Callable[[Watch], None] = lambda watch: None  # noqa: E731 - a default, not a function


def run(
    *words: str,
    level: str = "full",
    seed: int = 0,
    at_call: Callable[[Watch], None] = NOBODY,
    is_lossless: bool = True,
) -> tuple[Result, list[Watch]]:
    """Run against the built-in twin inside the envelope; its lines stay open for questions.

    `is_lossless`: what is lost is the device's doing, as in virtual time it must be.
    """
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    options = make_options(
        model="mac23", ids=words, level=level, seed=seed, max_travel=TRAVEL, max_speed=SPEED
    )
    watches: list[Watch] = []

    def open_watch(neighbours: tuple[int, ...]) -> Target:
        url = options.family.twin_url(options.model, options.address, neighbours)
        watches.append(Watch(serial.serial_for_url(url, baudrate=options.rate or 38400), at_call))
        return Target(watches[-1], url, is_builtin=True, is_lossless=is_lossless)

    return Engine(options, open_watch).run(lambda event: None), watches


# --- the envelope --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("level", "seed"),
    [
        ("quick", 0),
        *(pytest.param("full", seed, marks=SLOW) for seed in range(3)),
        *(pytest.param("full", seed, marks=SOAK) for seed in range(3, 20)),
    ],
)
def test_a_run_never_leaves_the_envelope(level: str, seed: int) -> None:
    """With --max-travel 2000, rig and all, no position further away is asked for, or reached."""
    # The twin's plant is ideal: it brakes within the increment.  Each 0Bh in motion leaves the
    # witness itself in doubt about one (`blur`).
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


# --- trouble at a random moment ------------------------------------------------------------------


class Crash(Exception):  # noqa: N818 - no error of anybody's
    """A mistake in a check."""


@dataclass
class Trouble:
    """Counts what is done with a port, and at chosen moments lets a child of this process meet
    trouble there; `judge` looks at how that child's run ends."""

    moments: frozenset[int]
    befall: Callable[[], None]
    judge: Callable[[Result, list[Watch], Watch, int], None]
    calls: int = 0
    failures: list[str] = field(default_factory=list)
    met: tuple[Watch, int] | None = None  # in the child: where, and after how many requests
    _pipe: int = -1

    def __call__(self, watch: Watch) -> None:
        """A moment of the run."""
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
            return  # on the way out: interrupts are held back, and no other trouble is made there
        self.calls += 1
        if self.met is not None or self.calls not in self.moments:
            return
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reading)
            self.met, self._pipe = (watch, len(watch.sent)), writing
            self.befall()
            return
        os.close(writing)
        with os.fdopen(reading, "rb") as pipe:
            told = pipe.read().decode()
        _, status = os.waitpid(child, 0)
        if told or status:
            self.failures.append(f"at call {self.calls}: {told or status}")

    def finish(self, result: Result, watches: list[Watch]) -> None:
        """In the child: judge, tell, and be gone."""
        if self.met is None:
            return
        try:
            self.judge(result, watches, *self.met)
            self._leave("")
        except BaseException:
            self._leave(f"{result.sentence} {result.problems}\n{traceback.format_exc()}")

    def _leave(self, text: str) -> NoReturn:
        os.write(self._pipe, text[-60_000:].encode())
        os._exit(0)


def meet(trouble: Trouble, *words: str, level: str, is_lossless: bool = True) -> None:
    """Run with trouble; every child must have ended well."""
    parent = os.getpid()
    try:
        result, watches = run(*words, level=level, at_call=trouble, is_lossless=is_lossless)
        trouble.finish(result, watches)
        assert result.exit_status == 0, result.sentence
    except BaseException:
        if os.getpid() != parent:
            trouble._leave(traceback.format_exc())
        raise
    assert "\n".join(trouble.failures) == ""


def moments_of(
    number: int, *words: str, level: str, seed: int, is_lossless: bool = True
) -> frozenset[int]:
    """That many moments, all over the true length of the run."""
    measured = Trouble(frozenset(), NOBODY, lambda *given: None)  # type: ignore[arg-type]
    run(*words, level=level, at_call=measured, is_lossless=is_lossless)
    return frozenset(random.Random(seed).sample(range(1, measured.calls + 1), number))


def judge_way_out(watches: list[Watch], met: Watch, sent: int, *, is_ended: bool = True) -> None:
    """The stop went out first, every shaft rests inside, and every EEPROM is as it was.

    `is_ended`: what was being done ended there; otherwise it may have been the putting back.
    """
    if met.has_acted(sent):
        after = [order.index for data in met.sent[sent:] for order in orders(b"", data)]
        # A module that has another address or rate just now could not hear the stop.
        acts = [index for index in after if index in ACTING - {0x00, 0x08, 0x1B}]
        assert acts[0] == STOP or (not is_ended and STOP in acts), [
            f"{index:02X}h" for index in after[:9]
        ]
    for watch in watches:
        before = [shaft.place for shaft in watch.shafts]
        watch.rest()
        assert [shaft.place for shaft in watch.shafts] == before, "at rest"
        assert not any(shaft.twin.is_moving for shaft in watch.shafts)
        assert watch.stored() == watch.cells
        for shaft in watch.shafts:
            assert max(shaft.asked, shaft.furthest) <= TRAVEL + shaft.blur


def interrupt() -> None:
    """Ctrl-C."""
    raise KeyboardInterrupt


def judge_interrupted(result: Result, watches: list[Watch], met: Watch, sent: int) -> None:
    """Stopped, put back, 130."""
    assert result.is_interrupted
    assert result.exit_status == 130
    assert result.problems == []
    judge_way_out(watches, met, sent)


@SLOW
def test_an_interrupt_at_any_moment_leaves_the_axis_at_rest_and_its_memory_as_it_was() -> None:
    """Forty random moments of a run at level quick."""
    moments = moments_of(40, level="quick", seed=3)
    meet(Trouble(moments, interrupt, judge_interrupted), level="quick")


@SOAK
def test_an_interrupt_at_two_hundred_random_moments() -> None:
    """All over a run of everything."""
    moments = moments_of(200, level="full", seed=1)
    meet(Trouble(moments, interrupt, judge_interrupted), level="full")


@SLOW
def test_a_port_lost_at_any_moment_ends_the_run_soon() -> None:
    """Nothing can be stopped then; that is said, and it is no crash."""

    def judge(result: Result, watches: list[Watch], met: Watch, sent: int) -> None:
        assert result.exit_status in (3, 4)
        told = " ".join([*result.problems, result.refusal])
        assert "error in the suite" not in told
        assert "the port failed" in told or "cannot open" in told
        if met.has_acted(sent):
            assert "could not stop the axis or put its parameters back" in told

    lost = Lost(for_good=True)
    moments = moments_of(5, *MOVING[:3], level="quick", seed=5, is_lossless=False)
    meet(Trouble(moments, lost.begin, judge), *MOVING[:3], level="quick", is_lossless=False)


@SLOW
def test_a_port_that_fails_once_does_not_keep_the_axis_from_being_stopped() -> None:
    """What was under way is spoilt; then the stop goes out and everything is put back."""

    def judge(result: Result, watches: list[Watch], met: Watch, sent: int) -> None:
        told = " ".join([*result.problems, result.refusal])
        assert "error in the suite" not in told
        assert result.exit_status in (0, 3, 4)
        judge_way_out(watches, met, sent, is_ended=False)

    lost = Lost(for_good=False)
    moments = moments_of(5, *MOVING[:3], level="quick", seed=6, is_lossless=False)
    meet(Trouble(moments, lost.begin, judge), *MOVING[:3], level="quick", is_lossless=False)


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


@SLOW
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
        judge_way_out(watches, met, sent)

    crashing = Crashing(Session.expect, random.Random(4).sample(range(60), 3), judge)

    def expect(session: Session, *given: Any) -> None:
        crashing(session, *given)

    monkeypatch.setattr(Session, "expect", expect)
    meet(crashing.trouble, *MOVING[-2:], level="quick")


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
    """How a process ended: its status, what it said, and what its last event was."""

    status: int
    errors: str
    last: dict[str, Any]


def signalled(port: str, number: int, moment: tuple[int, float], times: int) -> Ended:
    """Start a run on a port; send a signal (more than once) so many events and seconds into it."""
    command = [sys.executable, "-m", "axistwin", "conform", "mac23", "--port", port, "--json"]
    command += ["--allow", "motion,stored", "--level", "quick", "--max-travel", str(TRAVEL)]
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
    return Ended(process.returncode, errors, json.loads(lines[-1]))


@pytest.fixture
def pty_twin(axistwin: Callable[..., Any]) -> Any:
    """A twin behind a real pty; bytes take no time."""
    return axistwin("mac23", pacing=False)


@SLOW
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
    assert ended.status == 130, ended.errors
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
