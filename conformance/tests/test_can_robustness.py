"""On a bus in real time: nodes that are no module or stop being one, others who never stop talking,
interfaces that fail.  A clear verdict soon, no traceback.

Waiting is bounded by a hard limit with much to spare, so that a busy machine makes nothing red.
"""

from __future__ import annotations

import errno
import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import can
import pytest
from family_variants import vary
from scripted_bus import FailingBus, Moment, Script, TurningModule, after, behind

from axistwin_conformance.base import line_quality
from axistwin_conformance.base.events import Event, Note, Outcome
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.transport.can import CanTransport
from axistwin_conformance.transport.can_frame import Frame

SHORT_S = 1.0  # patience of most of these tests
LONGEST_S = 400.0  # from the moment of the change to the end of the run: a tenth when idle
NEVER = after(1_000_000)
FIRST = (
    "axistwin_conformance.families.mac.can.probes.transfers",
)  # what motion waits for: the order of bytes
PASSIVE = ("the_release_is_eight_digits_that_stay",)
MOVING = (*PASSIVE, "moves_take_the_time_of_the_closed_form")
FOREIGN = (
    Frame(0x123, bytes(8)),
    Frame(0x1A0, b"\x01\x02"),
    Frame(0x5A0, bytes.fromhex("43 00 10 00 91 01 0F 00")),  # another node answers its own master
    Frame(0x00F00400, bytes(8), True),
)
NUMBERS = itertools.count()

pytestmark = pytest.mark.strength


def garbage(frame: Frame) -> tuple[Frame, ...]:
    """Something else each time, from where replies come from."""
    return (Frame(0x581, bytes((7 * byte + next(NUMBERS)) % 256 for byte in frame.data)),)


def of_the_standard(frame: Frame) -> tuple[Frame, ...]:
    """Any other CANopen node: there is no such object, and this abort code says so."""
    return (Frame(0x581, b"\x80" + frame.data[1:4] + bytes.fromhex("00 00 02 06")),)


SCRIPTS: dict[str, Script] = {
    "silence": lambda frame: (),
    "echo": lambda frame: (frame,),
    "garbage": garbage,
    "another node of CANopen": of_the_standard,
    "another protocol": lambda frame: (Frame(0x18EAFF01, b"\x00\xee\x00", True),),
    "half a reply": lambda frame: (Frame(0x581, b"\x42\x24\x20\x00"),),
    "always refused": lambda frame: (Frame(0x581, b"\x80" + frame.data[1:4] + bytes(4)),),
    "replies of module 2": lambda frame: (Frame(0x582, b"\x42" + frame.data[1:4] + bytes(4)),),
    "remote frames": lambda frame: (Frame(0x581, is_remote=True, asked_length=8),),
    "forty at once": lambda frame: (Frame(0x581, b"\x60\x13\x20\x00" + bytes(4)),) * 40,
}

WRONG_MODULES = {
    "half a reply": "MACC-SDO-03",
    "always refused": "MACC-SDO-03",
    "replies of module 2": "MACC-ID-01",
}


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_quality, "SILENCE_LIMIT_S", SHORT_S)


@pytest.fixture
def channel() -> str:
    """A bus of its own for each test."""
    return f"robust{next(NUMBERS)}"


def checked(result: Result, turned_at: float | None, ended_at: float) -> Result:
    """Whatever has happened, the run has ended soon, in one line, without a mistake of ours."""
    if turned_at is not None:
        assert ended_at - turned_at < LONGEST_S, result.sentence
    assert "\n" not in result.sentence
    assert [one.trouble for one in result.checks if one.outcome is Outcome.ERROR] == []
    assert "error in the suite" not in " ".join([*result.problems, result.refusal])
    return result


def judge(
    channel: str,
    moment: Moment,
    script: Script,
    ids: tuple[str, ...] = MOVING,
    *,
    others: tuple[Frame, ...] = (),
    rate_hz: int = 0,
    listener: Callable[[Event], None] = lambda event: None,
) -> Result:
    """Judge a module that turns at that moment, after few questions."""
    module = TurningModule(channel, moment, script, others, rate_hz)
    try:
        options = make_options(
            model="mac23-can", can=f"virtual:{channel}", ids=ids, allow="motion,stored",
            level="quick",
        )  # fmt: skip
        options = replace(options, family=vary(options.family, probe_modules=FIRST))
        result = Engine(options).run(listener)
        ended_at = time.monotonic()
    finally:
        module.close()
    return checked(result, module.turned_at, ended_at)


# --- nodes ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(SCRIPTS.keys() - WRONG_MODULES.keys()))
def test_who_is_no_module_is_unreachable(channel: str, name: str) -> None:
    """Exit 3, nothing is judged, and the line says what came instead."""
    result = judge(channel, after(0), SCRIPTS[name], PASSIVE)
    assert result.exit_status == 3
    assert result.sentence.startswith("Not judged: device unreachable: no module answers at ")
    assert "try another --address or --bitrate" in result.sentence
    assert result.checks == []


@pytest.mark.parametrize("name", WRONG_MODULES)
def test_who_replies_wrongly_is_a_module_that_has_failed(channel: str, name: str) -> None:
    """Exit 1: what comes is of this protocol, and breaks one requirement."""
    result = judge(channel, after(0), SCRIPTS[name], PASSIVE)
    assert result.exit_status == 1, result.sentence
    failed = {one.requirement.id for one in result.requirements if one.verdict is Verdict.FAIL}
    assert WRONG_MODULES[name] in failed


def test_a_module_that_refuses_all_from_a_motion_on_fails(channel: str) -> None:
    """It answers in the protocol, always alike: judged, though the run ends for it."""
    result = judge(channel, behind(0x13), SCRIPTS["another node of CANopen"])
    assert result.exit_status == 1
    failed = {one.requirement.id for one in result.requirements if one.verdict is Verdict.FAIL}
    assert failed == {"MACC-SDO-03"}


@pytest.mark.parametrize("name", ["silence", "garbage", "forty at once"])
def test_who_is_lost_in_a_motion_is_neither_failed_nor_passed(channel: str, name: str) -> None:
    """Exit 4; what was judged before stands."""
    result = judge(channel, behind(0x13), SCRIPTS[name])
    assert result.exit_status == 4
    assert "No verdict on mac23-can: the device no longer answers after " in result.sentence
    told = {one.requirement.id: one.verdict for one in result.requirements}
    assert told["MACC-Q-04-01"] is Verdict.PASS
    assert told["MACC-CMD-13-01"] is Verdict.INCONCLUSIVE
    assert any("could not stop the axis" in one for one in result.problems)


def test_without_permission_nothing_but_passive_is_done_on_a_bus(channel: str) -> None:
    """As on a port; and who has judged nothing has used it wrongly."""
    options = make_options(model="mac23-can", can=f"virtual:{channel}", ids=MOVING[1:])
    result = Engine(options).run(lambda event: None)
    assert options.allowed == {"passive"}
    assert result.exit_status == 2
    assert result.plan.to_run == ()


# --- others on the bus ----------------------------------------------------------------------------


def test_a_flood_of_foreign_frames_changes_no_verdict(channel: str) -> None:
    """5000 a second, among them replies of another node to its own master."""
    told: list[Event] = []
    result = judge(
        channel, NEVER, SCRIPTS["silence"], others=FOREIGN, rate_hz=5000, listener=told.append
    )
    assert result.exit_status == 0, result.sentence
    notes = [one.text for one in told if isinstance(one, Note)]
    assert any("others talk on this bus" in one and "123h" in one for one in notes), notes


def test_a_flood_alone_is_no_module(channel: str) -> None:
    """Nobody answers; the line says that others talk."""
    result = judge(channel, after(0), SCRIPTS["silence"], PASSIVE, others=FOREIGN, rate_hz=5000)
    assert result.exit_status == 3
    assert "others talk on this bus" in result.sentence


@pytest.mark.parametrize("identifier", [0x581, 0x081])
def test_who_babbles_on_the_modules_own_identifier_is_given_up(
    channel: str, identifier: int
) -> None:
    """A second node with that address, or a broken one: neither believed nor waited for."""
    babble = (Frame(identifier, bytes.fromhex("42 20 20 00 12 34 56 78")),)
    result = judge(channel, after(0), SCRIPTS["silence"], PASSIVE, others=babble, rate_hz=5000)
    assert result.exit_status == 3


# --- interfaces -----------------------------------------------------------------------------------

SEND, RECEIVE, BOTH = ("send",), ("recv",), ("send", "recv")
FAILURES: dict[str, tuple[Exception | None, tuple[str, ...], str]] = {
    "nobody acknowledges": (can.CanOperationError("full", errno.ENOBUFS), SEND, "acknowledges"),
    "bus off": (can.CanOperationError("no", errno.ENETDOWN), SEND, "Network is down"),
    "vanished": (can.CanOperationError("no", errno.ENODEV), BOTH, "No such device"),
    "pulled out": (OSError(errno.EIO, "read failed"), RECEIVE, "Input/output error"),
    "stuck": (can.CanTimeoutError("late"), SEND, "does not take frames any more"),
    "its driver falls over": (TypeError("object of type NoneType"), RECEIVE, "NoneType"),
}


@pytest.fixture
def bench(channel: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Judges a sound module by way of a bus that fails from a moment on."""
    monkeypatch.setattr("axistwin_conformance.transport.can.SEND_TIMEOUT_S", 0.5)
    module = TurningModule(channel, NEVER, SCRIPTS["silence"])

    def run(
        moment: Moment, error: Exception | None, where: tuple[str, ...], *, is_noisy: bool = False
    ) -> Result:
        options = make_options(
            model="mac23-can", can=f"virtual:{channel}", ids=MOVING, allow="motion,stored",
            level="quick",
        )  # fmt: skip
        options = replace(options, family=vary(options.family, probe_modules=FIRST))
        inner = can.Bus(channel, "virtual", ignore_config=True)
        bus = FailingBus(inner, moment, error, where, is_noisy=is_noisy)

        def opened(neighbours: tuple[int, ...]) -> CanTransport:
            return CanTransport(bus, "failing", is_spontaneous=codec.is_spontaneous)

        result = Engine(options, opened).run(lambda event: None)
        return checked(result, bus.turned_at, time.monotonic())

    yield run
    module.close()


@pytest.mark.parametrize("name", FAILURES)
def test_an_interface_that_fails_at_once_leaves_the_device_unreachable(
    bench: Any, name: str
) -> None:
    """Exit 3, with the system's reason."""
    error, where, words = FAILURES[name]
    result = bench(after(0), error, where)
    assert result.exit_status == 3
    assert words in result.sentence


@pytest.mark.parametrize("name", FAILURES)
def test_an_interface_that_fails_in_a_motion_leaves_no_verdict(bench: Any, name: str) -> None:
    """Exit 4, with the reason; that the axis could not be stopped is said."""
    error, where, words = FAILURES[name]
    result = bench(behind(0x13), error, where)
    assert result.exit_status == 4
    assert words in " ".join([result.sentence, *result.problems])
    assert any("could not stop the axis" in one for one in result.problems)
    assert Verdict.FAIL not in {one.verdict for one in result.requirements}


def test_error_frames_instead_of_replies_are_told(bench: Any) -> None:
    """As with the wrong bit rate: the line asks for it."""
    result = bench(after(0), None, (), is_noisy=True)
    assert result.exit_status == 3
    assert "error frames on the bus: is the bit rate right?" in result.sentence
