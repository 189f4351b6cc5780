"""An axis that is far away when a run ends: the way back has an end, and can be ended."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace
from typing import Any

import pytest
from family_variants import vary
from interfaces import judge_plainly, real_options
from quirk_twins import quirks_query
from shaft_watch import Watch
from zoo.motion import a_move_is_relative

from axistwin_conformance.base import interrupts
from axistwin_conformance.base.errors import OutsideEnvelope, TargetError
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.session import Envelope, Run, Session
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mac.axis.checks import interpolation
from axistwin_conformance.families.mac.axis.driver.driver import driver_of
from axistwin_conformance.families.mac.axis.probes import sync
from axistwin_conformance.families.mac.can import collect_replies
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.options import make_options
from axistwin_conformance.transport.can import Arrival
from axistwin_conformance.transport.can_frame import Frame

pytestmark = pytest.mark.strength

FAR = 900_000_000  # increments: two days at the speed of the checks

FAR_AWAY = """
import sys

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.interrupts import heeded
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mac.axis.driver.driver import driver_of
from axistwin_conformance.options import make_options

def goes_far(session):
    driver = driver_of(session)
    start = driver.motion.ready()
    driver.client.command(0x0D, 8)
    driver.judge.accepted(0x13, start + 300_000)
    driver.client.wait(1)
    print("far", flush=True)
    driver.client.wait(60)

check = Check("goes_far", goes_far, ("MACS-CMD-13-01",), ("motion", "stored"), "quick", (), "", "")
options = make_options(
    model="mac23", port=sys.argv[1], allow="motion,stored", max_travel=10**6, max_speed=10**6,
)
family = options.family
family.modules = family.probe_modules = ()
family.__class__.checks = lambda self: (check,)
with heeded():
    result = Engine(options).run(
        lambda event: print(getattr(event, "text", ""), flush=True)
    )
print(*result.problems, sep="\\n")
sys.exit(result.exit_status)
"""


@pytest.fixture
def pty_twin(axistwin: Callable[..., Any]) -> Any:
    """A twin behind a real pty; bytes take no time."""
    return axistwin("mac23", pacing=False)


def run_on_a_twin(model: str = "mac23", readings: Mapping[str, str] = MappingProxyType({})) -> Run:
    """What a check on the built-in twin of these readings, which are known, would be handed, with
    all the travel there is."""
    options = make_options(model=model)
    family = options.family
    run = Run(
        family.open(options.url + quirks_query(readings), None, is_builtin=True),
        family, family.models[model],
        load_ledger(family.name), options.address, (), options.allowed,
        Envelope(1 << 31, 8_000_000), 0,
    )  # fmt: skip
    run.readings.update(readings)
    return run


def test_in_virtual_time_the_longest_way_back_takes_a_few_exchanges() -> None:
    """An axis is brought home over two days of virtual time."""
    run = run_on_a_twin()
    family = run.family
    try:
        memory = family.remember(Session(run))
        run.memory = memory
        driver = driver_of(Session(run))
        driver.motion.ready(1)
        driver.judge.accepted(0x13, FAR)
        driver.client.wait(FAR / 8_000_000 + 1)
        assert driver.client.position() == FAR
        before = run.target.transcript.position
        assert family.restore(Session(run), memory) == ()
        assert driver.client.position() == memory.position
        assert run.target.transcript.position - before < 100
    finally:
        run.target.close()


def test_a_motion_of_days_that_nobody_asked_for_is_not_waited_for() -> None:
    """Whoever tells its place wrongly, by 31 bits say, fails at once; no time is spent on it."""
    run = run_on_a_twin()
    try:
        driver = driver_of(Session(run))
        began_ns = run.target.now_ns
        with pytest.raises(TargetError, match="got one from which it takes 180000 s"):
            driver.client.wait_until(began_ns + FAR * driver.motion.period * 125)
        assert run.target.now_ns == began_ns
    finally:
        run.target.close()


def test_an_axis_that_does_not_move_is_not_waited_for() -> None:
    """One that is held on its way, say: given up at once, told as not put back."""
    run = run_on_a_twin()
    family = run.family
    try:
        memory = family.remember(Session(run))
        driver = driver_of(Session(run))
        driver.motion.ready(1)
        driver.judge.accepted(0x13, FAR)
        driver.client.wait(1)
        driver.client.command(0x18)
        run.target.twins[0].load.held = True
        place = driver.client.position()
        began_ns = run.target.now_ns
        (told,) = family.restore(Session(run), memory)
        assert place > 1_000_000
        assert told == f"position is {driver.client.position():X}h, was 0h"
        assert abs(driver.client.position() - place) < 100
        assert run.target.now_ns - began_ns < 60_000_000_000
    finally:
        run.target.close()


KEEPS = {"preload_policy": "keep"}  # what 10h has begun, whatever stops the axis
KEEPS_ON_CAN = {**KEEPS, "can_byte_order": "big", "sync_arm_lifetime": "kept"}


@pytest.mark.parametrize(
    ("model", "readings"),
    [
        ("mac23", KEEPS),
        ("mac23-can", KEEPS_ON_CAN),
        ("mac23-can", {**KEEPS_ON_CAN, "sync_arm_lifetime": "permanent"}),
    ],
    ids=["serial", "on CAN", "for ever"],
)
def test_an_axis_that_stops_leave_armed_is_driven_back_and_disarmed(
    model: str, readings: dict[str, str]
) -> None:
    """A 10h that no motion has followed holds neither the way back nor whoever comes next."""
    run = run_on_a_twin(model, readings)
    run.envelope = Envelope(2000, 10_000)
    run.target.travel_guard = run.family.travel_guard(run)
    try:
        run.memory = run.family.remember(Session(run))
        driver = driver_of(Session(run))
        driver.motion.finish(driver.motion.go(driver.motion.ready() + 60))
        for _ in range(2):  # away from home, and at home
            driver.judge.accepted(0x10)
            assert run.family.restore(Session(run), run.memory) == ()
        driver.judge.accepted(0x13, 30)
        driver.client.wait(1)
        assert driver.client.position() == 30
    finally:
        run.target.close()


@pytest.mark.parametrize("readings", [{}, KEEPS], ids=["usual", "keeps"])
def test_an_axis_that_goes_away_from_home_is_stopped_and_not_sent_again(
    readings: dict[str, str],
) -> None:
    """A device whose 13h is relative: on a machine each attempt would lead it further away."""
    with a_move_is_relative.plant():
        run = run_on_a_twin()
        run.readings.update(readings)  # one that keeps a preloaded motion may start it first
        try:
            driver = driver_of(Session(run))
            driver.motion.ready(1)
            driver.judge.accepted(0x13, 3_000)
            driver.client.wait(1)
            run.envelope = Envelope(500, 5000)
            run.target.travel_guard = run.family.travel_guard(run)
            run.memory = run.family.remember(Session(run))
            start = driver.motion.ready()
            driver.judge.accepted(0x13, start + 200)
            driver.client.wait(0.1)
            driver.client.position()
            assert "it is moved no more" in run.runaway
            place = driver.client.position()
            assert 200 < place - start < 1000, "it was stopped as soon as that was seen"
            with pytest.raises(OutsideEnvelope, match="it is moved no more"):
                driver.motion.go(start)
            assert any("position is" in one for one in run.family.restore(Session(run), run.memory))
            driver.client.wait(1)
            assert driver.client.position() == place
        finally:
            run.target.close()


@pytest.mark.parametrize("found_at", [0, 5000, -700])
def test_a_device_that_takes_13h_as_relative_stays_in_the_envelope_and_fails(found_at: int) -> None:
    """It strays by one motion, wherever its counter stood, and not by their sum."""
    watches: list[Watch] = []

    def watched(port: Any) -> Watch:
        port.twins[0].push(found_at)
        watches.append(Watch(port))
        return watches[-1]

    with a_move_is_relative.plant():
        result = judge_plainly(real_options(level="full", max_travel=2000), before=watched)
    assert watches[0].shafts[0].furthest <= 2000
    assert result.exit_status == 1
    failed = {one.requirement.id for one in result.requirements if one.verdict is Verdict.FAIL}
    assert "MACS-CMD-13-01" in failed
    passive = {one.requirement.id for one in result.requirements if one.verdict is Verdict.PASS}
    assert passive, "what moves nothing is judged all the same"


@pytest.mark.strength
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda one: one.name)
def test_a_second_interrupt_stops_an_axis_that_is_driven_back(pty_twin: Any, number: int) -> None:
    """The way back would take a minute; it is told, ended at once, and told again."""
    before = {name: cell for name, cell in pty_twin.cells.items() if name != "position"}
    with subprocess.Popen(
        [sys.executable, "-c", FAR_AWAY, pty_twin.port], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        while process.stdout.readline() != "far\n":
            assert process.poll() is None
        process.send_signal(number)
        line = process.stdout.readline()
        while not line.startswith("driving back "):
            assert line, "the way back is told"
            line = process.stdout.readline()
        assert line.startswith("driving back 300000 increments, about 1 min left; interrupt")
        far = pty_twin.position
        while pty_twin.position >= far:  # on its way
            assert process.poll() is None
        time.sleep(1.0)  # sooner it would be the same breath
        process.send_signal(number)
        began_s = time.monotonic()
        rest = process.stdout.read()
        assert time.monotonic() - began_s < 40  # a minute would take it back
        process.wait(60)
    assert process.returncode == 130
    assert "not put back: position is " in rest
    place = pty_twin.position
    assert not pty_twin.is_moving
    assert 0 < place < 300_000
    assert before == {name: cell for name, cell in pty_twin.cells.items() if name != "position"}


@pytest.mark.parametrize("number", interrupts.ENDING, ids=lambda one: one.name)
def test_what_never_ends_is_cut_short(
    toy: Any, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """A second interrupt gives it a while, then the stop is sent, and what was held is told."""
    monkeypatch.setattr(interrupts, "GRACE_S", 0.2)

    def endless(session: Session, memory: Any) -> tuple[str, ...]:
        threading.Timer(0.4, os.kill, (os.getpid(), number)).start()
        toy.port.sent.clear()
        time.sleep(30)
        return ()

    def interrupted(session: Session) -> None:
        toy.family.stop(session)
        os.kill(os.getpid(), number)
        time.sleep(1)

    toy.add(interrupted, "MACS-CMD-13-01", safety=("motion", "stored"))
    toy.family = vary(toy.family, restore=endless)
    began_s = time.monotonic()
    with interrupts.heeded():
        result = toy.run()
    assert time.monotonic() - began_s < 25
    assert result.exit_status == 130
    assert any("interrupted again, could not" in one and "7" in one for one in result.problems)
    assert toy.port.sent == ["S"]
    assert not toy.port.is_open


def test_a_bus_that_never_falls_silent_is_not_listened_to_for_ever() -> None:
    """Somebody answers again and again: enough is heard to judge that."""
    frame = Frame(0x581, bytes(8))

    class Babble:
        uncertainty_ns = 0

        def drain(self) -> None: ...

        def send(self, frame: Frame) -> None: ...

        def receive(self, wanted: object, timeout_s: float) -> Arrival:
            return Arrival(frame, 0)

    driver: Any = SimpleNamespace(
        client=SimpleNamespace(target=Babble(), address=1),
        session=SimpleNamespace(reply_timeout_s=0.1),
    )
    assert 2 < len(collect_replies.replies(driver, frame)) < 1000


def test_a_module_that_refuses_segments_for_ever_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is at rest, the FIFO is empty, and it goes on refusing: nobody waits for the end."""
    put, count = sync.put, itertools.count()

    def refused(driver: Any, one: Any) -> Any:
        if next(count) < 5:
            return put(driver, one)
        assert next(count) < 5000
        exchange = driver.client.ask(0x20)
        return replace(exchange, reply=codec.parse(b"\x06\x13\x17"))

    monkeypatch.setattr(interpolation, "put", refused)
    options = make_options(model="mac23", ids=("segments_follow_one_another_without_a_gap",))
    result = Engine(options).run(lambda event: None)
    verdicts = {one.requirement.id: one.verdict for one in result.requirements}
    assert verdicts["MACS-CMD-16-02"] is Verdict.FAIL


@pytest.mark.parametrize(
    ("words", "replay"),
    [
        (("endless_motion_and_segments_are_busy_while_held",), None),
        ((), "16010000240100002100000004230000"),  # to a stop at the end of the counter, and on
    ],
)
def test_an_envelope_as_wide_as_the_counter_fails_no_device(
    words: tuple[str, ...], replay: str | None
) -> None:
    """What a check uses of it, is no more than it needs."""
    options = make_options(model="mac23", ids=words, replay=replay, max_travel=1 << 31)
    assert Engine(options).run(lambda event: None).exit_status == 0
