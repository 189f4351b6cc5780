"""What is done about a failing sequence: stored, counted, shrunk on the twin or on the device."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
import serial
from port_in_front import PortInFront
from zoo.motion import a_ramped_stop_stops_dead

from axistwin_conformance.base.errors import AttemptVoid
from axistwin_conformance.base.events import Event, FailureStored, StatesCovered
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.core.session import Run, Session, Stop
from axistwin_conformance.families.mac.axis.checks.sequences import (
    many_mixed_sequences_agree_with_the_model,
)
from axistwin_conformance.families.mac.axis.sequences.operations import OPERATIONS, WHAT
from axistwin_conformance.families.mac.axis.sequences.runner import AxisRunner, split
from axistwin_conformance.families.mac.serial.driver import SerialDriver
from axistwin_conformance.sequences import failure
from axistwin_conformance.sequences.failure import Failure
from axistwin_conformance.sequences.runner import Mismatch
from axistwin_conformance.sequences.shrink import Budget
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport

pytestmark = pytest.mark.strength

TRAVEL = 2000
REPLY = "MACS-REPLY-01"  # what a surprise under 19h is about


def operation(name: str, first: int = 0, second: int = 0, pause: int = 0) -> bytes:
    """An operation by its name."""
    return bytes([WHAT[name], first, second, pause])


RAMPED_STOP, POWER_ON = operation("ramped stop"), operation("power on")
FILLING = (
    operation("move", 0xA0, 0, 0x90),
    operation("ask the position"),
    operation("stop"),
    operation("set the tolerance", 3),
    operation("ask", 7),
    operation("spoil a frame", 4, 9),
)
LONG = (*FILLING, RAMPED_STOP, *FILLING[1:], POWER_ON, *FILLING)


class Device(PortInFront):
    """The built-in twin, with a fault of its own: 19h is refused once there was a 17h since the
    last 0Ch, which every sequence begins with; `lies` says which of the times it shows.  It keeps
    track of the shaft."""

    def __init__(self, lies: Iterator[bool], *words: str) -> None:
        url = "&".join(["axistwin://mac23:0,mac23:1?time=virtual", *words])
        super().__init__(serial.serial_for_url(url, baudrate=38400))
        self.lies = lies
        self.has_stopped = self.is_asked = self.is_sticky = False
        self.cleared = self.furthest = self.asked = 0

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return int(self.port.in_waiting)

    def look(self) -> None:
        """Note where the shaft is."""
        self.furthest = max(self.furthest, abs(self.port.twins[0].position + self.cleared))

    def write(self, data: bytes) -> int:
        """Send, and remember what."""
        self.look()
        is_frame = len(data) == 21 and data[4:6] == b"00"
        index = int(data[6:8], 16) if is_frame else 0
        if (index == 0x0C and not self.is_sticky) or (is_frame and index == 0x00):
            self.has_stopped = False
        self.has_stopped |= index == 0x17
        self.is_asked = index == 0x19 and self.has_stopped
        if index == 0x13:
            self.asked = max(self.asked, abs(target_of(data) + self.cleared))
        before = int(self.port.twins[0].position)
        count = int(self.port.write(data))
        if index == 0x0B and self.port.twins[0].state == "HD":
            self.cleared += before
        return count

    def read(self, size: int = 1) -> bytes:
        """Receive; 17h is how a module refuses."""
        self.port.timeout = self.timeout
        data = bytes(self.port.read(size))
        if self.is_asked and b"\x1a" in data:
            self.is_asked = False
            data = data.replace(b"\x1a", b"\x17") if next(self.lies) else data
        self.look()
        return data

    def close(self) -> None:
        """Close."""
        self.port.close()


def target_of(frame: bytes) -> int:
    """The signed number of a 13h."""
    number = int(frame[10:18], 16)
    return number - (number >> 31 << 32)


def always() -> Iterator[bool]:
    """A fault that is there each time."""
    while True:
        yield True


def at_times(*shown: bool) -> Iterator[bool]:
    """A fault that is there at these times only."""
    yield from shown
    while True:
        yield False


class Case:
    """A check on a device behind a line that may lose bytes, and all that came of it."""

    def __init__(self, port: Any, *, is_lossless: bool = False, fenced: bool = False) -> None:
        travel, speed = (TRAVEL, 10_000) if fenced else (None, None)
        options = make_options(model="mac23", max_travel=travel, max_speed=speed)
        self.port = port
        self.events: list[Event] = []
        self.run = Run(
            target=SerialTransport(port, "a device", is_lossless=is_lossless),
            family=options.family,
            model=options.family.models["mac23"],
            ledger=load_ledger("mac_serial"),
            address=0,
            neighbours=(1,),
            allowed=options.allowed,
            envelope=options.settings.envelope,
            seed=3,
            emit=self.events.append,
        )
        if fenced:
            self.run.target.travel_guard = options.family.travel_guard(self.run)
        self.run.memory = options.family.remember(Session(self.run))
        self.session = Session(self.run, many_mixed_sequences_agree_with_the_model)
        driver = SerialDriver(self.session)
        self.runner = AxisRunner(driver, driver.motion.ready())

    def settle(self, operations: tuple[bytes, ...] = LONG) -> None:
        """Play a list that fails, and let the failure be settled."""
        with pytest.raises(Stop):
            Failure(self.runner, self.runner.run(operations, is_counted=True)).conclude()

    @property
    def stored(self) -> list[Any]:
        """The recordings told, in order."""
        return [one.recording for one in self.events if isinstance(one, FailureStored)]

    @property
    def verdict(self) -> Verdict:
        """What was said about the requirement that the fault breaks."""
        assert [one.requirement for one in self.session.findings] == [REPLY]
        return self.session.findings[0].verdict

    @property
    def text(self) -> str:
        """What was said."""
        return self.session.findings[0].text


@pytest.fixture(autouse=True)
def _handler() -> None:
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)


def test_a_fault_of_the_device_alone_is_shrunk_on_the_device() -> None:
    """The twin does not show it; what is left are the two operations that make it."""
    case = Case(Device(always()))
    case.settle()
    assert case.verdict is Verdict.FAIL
    assert "reproduced 3 of 3" in case.text
    assert "the built-in twin, read alike, does not fail" in case.text
    assert "shrunk from 13 to 2 operations on the device" in case.text
    assert "on the device the 2 operations failed in run 1 of 3" in case.text
    first, last = case.stored
    assert first.operations == LONG[:13], "stored at once, as found"
    assert last.operations == (RAMPED_STOP, POWER_ON)
    assert last.found == b"".join(LONG[:13])
    assert (last.requirement, last.model, last.seed) == (REPLY, "mac23", 3)
    assert "19h" in last.words[1]
    assert "Xonerror" in last.words[1] or "refused" in last.words[1]


def test_a_fault_that_the_twin_has_too_is_shrunk_there_and_confirmed_on_the_device() -> None:
    """On the device: three replays of the whole, and the short list until it fails."""
    moving = (operation("set the ramp", 6), operation("turn", 0, 2, 0xFF), RAMPED_STOP,
              operation("nudge"))  # fmt: skip
    with a_ramped_stop_stops_dead.plant():
        case = Case(Device(at_times()))
        counted = counting(case.runner)
        case.settle((*FILLING, *moving, *FILLING))
    assert [one.requirement for one in case.session.findings] == ["MACS-CMD-13-02"]
    assert "on the built-in twin, which fails alike" in case.text
    assert "operations failed in run 1 of 3" in case.text
    assert case.stored[-1].operations[-2:] == (RAMPED_STOP, operation("nudge"))
    assert counted[:4] == [10] * 4
    assert len(counted) <= 4 + 2 * 3
    assert set(counted[4:]) <= {3, 4}


def counting(runner: AxisRunner) -> list[int]:
    """How many operations of each list the player began."""
    counted: list[int] = []
    real = runner.run

    def counted_run(operations: tuple[bytes, ...], **how: bool) -> Any:
        result = real(operations, **how)
        counted.append(len(result.operations))
        return result

    runner.run = counted_run  # type: ignore[method-assign]
    return counted


def test_the_twin_to_shrink_on_reads_the_manual_as_the_device_does() -> None:
    """The readings that differ from the defaults are parameters of its URL."""
    case = Case(Device(always(), "quirk.xonerror_byte=18h"))
    case.run.readings |= {"xonerror_byte": "18h", "xon_byte": "1Ah"}
    twin = failure.open_twin(case.session)
    assert twin.description == ("axistwin://mac23:0,mac23:1?time=virtual&quirk.xonerror_byte=18h")
    other = case.runner.on(failure.twin_session(case.session, twin))
    refused = other.run((operation("turn", 0, 2), operation("nudge")))
    assert refused.mismatch is None, "and is held to them"
    twin.close()


def test_a_failure_that_never_comes_again_is_inconclusive() -> None:
    """With the number of replays, and the operations kept."""
    case = Case(Device(at_times(True)))
    case.settle()
    assert case.verdict is Verdict.INCONCLUSIVE
    assert "came again in 0 of 3 replays" in case.text
    assert case.session.is_replayed
    assert case.stored[-1].operations == LONG[:13]


def test_a_failure_that_comes_now_and_then_fails_with_its_rate() -> None:
    """Once of three is the device's: on a quiet line nothing else makes that."""
    case = Case(Device(at_times(True, False, True, False)))
    case.settle()
    assert case.verdict is Verdict.FAIL
    assert "reproduced 1 of 3" in case.text
    assert "told as found" in case.text
    assert case.stored[-1].operations == LONG[:13]


def interrupted_at(time: int) -> Iterator[bool]:
    """A fault that is there each time; at one of them Ctrl-C is pressed."""
    yield from (True for _ in range(time - 1))
    raise KeyboardInterrupt


@pytest.mark.parametrize("time", [5, 9])
def test_an_interrupt_while_it_is_made_shorter_loses_no_failure(time: int) -> None:
    """Three of three had failed by then; the run ends, and the list is told as far as it is."""
    case = Case(Device(interrupted_at(time)))
    case.settle()
    assert case.verdict is Verdict.FAIL
    assert "reproduced 3 of 3; " in case.text
    assert "; interrupted before it was as short as can be" in case.text
    assert case.stored[-1].operations == LONG[:13]
    assert case.run.is_interrupted
    assert case.session.is_replayed, "nobody plays the check again"


def test_an_interrupt_in_virtual_time_loses_no_failure_either() -> None:
    """There nothing has to come again."""
    case = Case(Device(interrupted_at(4)), is_lossless=True)
    case.settle()
    assert case.verdict is Verdict.FAIL
    assert case.run.is_interrupted


def test_an_interrupt_before_it_came_again_leaves_it_open() -> None:
    """Seen once is told, and held against nobody."""
    case = Case(Device(interrupted_at(2)))
    case.settle()
    assert case.verdict is Verdict.INCONCLUSIVE
    assert "interrupted before it was played again" in case.text
    assert case.run.is_interrupted
    assert case.session.is_replayed


def test_on_a_noisy_line_what_never_comes_again_is_taken_for_noise() -> None:
    """The attempt is void, and the engine makes another."""
    case = Case(Device(at_times(True)))
    case.run.quality.exchanges, case.run.quality.corrupted = 1000, 20
    with pytest.raises(AttemptVoid, match="taken for noise"):
        Failure(case.runner, case.runner.run(LONG)).conclude()
    assert not case.session.findings


def test_on_a_noisy_line_once_more_is_not_enough() -> None:
    """As many must agree as noise cannot explain; more than three replays are made."""
    case = Case(Device(at_times(True, True)))
    case.run.quality.exchanges, case.run.quality.corrupted = 1000, 20
    case.settle()
    assert case.verdict is Verdict.INCONCLUSIVE
    found = re.search(r"came again in 1 of (\d+) replays", case.text)
    assert found is not None
    assert int(found[1]) > failure.REPLAYS


def test_shrinking_on_the_device_ends_with_its_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which is named; what was reached by then is what fails."""
    monkeypatch.setattr(failure, "LINE_BUDGET", Budget(40, 1000.0))
    case = Case(Device(always()))
    counted = counting(case.runner)
    case.settle()
    assert "ended by its budget (40 operations, 1000 s)" in case.text
    assert case.verdict is Verdict.FAIL
    shrinking = counted[4:-1]
    assert sum(shrinking) <= 40
    assert 2 < len(case.stored[-1].operations) < 13


def test_in_virtual_time_arguments_and_pauses_become_small() -> None:
    """Not only fewer operations."""
    with a_ramped_stop_stops_dead.plant():
        case = Case(Device(at_times()), is_lossless=True)
        case.settle((
            *FILLING, operation("turn", 0xEE, 0x77, 0x9A), operation("ramped stop", 9, 9, 0x70),
            operation("nudge", 0xDD, 3, 0x20),
        ))  # fmt: skip
    assert "in virtual time" in case.text
    short = case.stored[-1].operations
    assert [one[0] for one in short] == [WHAT["turn"], WHAT["ramped stop"], WHAT["nudge"]]
    assert [one[1:3] for one in short] == [bytes(2)] * 3
    assert [one[3] for one in short[1:]] == [0, 0]
    assert short[0][3] <= 0x8A, "a pause as short as it takes to get going"


def test_what_one_list_leaves_behind_does_not_make_the_next_one_fail() -> None:
    """In virtual time each begins with 00h; or a fault that sticks would shrink to its last act."""
    port = Device(always())
    port.is_sticky = True
    case = Case(port, is_lossless=True)
    case.settle()
    assert [one[0] for one in case.stored[-1].operations] == [RAMPED_STOP[0], POWER_ON[0]]


def test_the_same_requirement_is_not_shrunk_twice_in_a_run() -> None:
    """A soak may meet it a thousand times."""
    case = Case(Device(always()), is_lossless=True)
    case.settle()
    case.session = Session(case.run, many_mixed_sequences_agree_with_the_model)
    case.runner = AxisRunner(SerialDriver(case.session), 0)
    case.settle()
    assert "not shrunk" in case.text
    assert case.stored[-1].operations == LONG[:13]


def test_where_only_the_verdict_is_wanted_nothing_is_shrunk() -> None:
    """It fails as it was found, and nothing is played again."""
    case = Case(Device(always()), is_lossless=True)
    case.run.unshrunk = "only the verdict is wanted"
    case.settle()
    assert "not shrunk: only the verdict is wanted" in case.text
    assert case.stored[-1].operations == LONG[:13]


def test_only_what_was_judged_counts_as_held() -> None:
    """And the states that were met are told."""
    case = Case(Device(at_times()), is_lossless=True)
    result = case.runner.run((operation("ask the position"),), is_counted=True)
    assert result.mismatch is None
    case.runner.credit()
    assert "MACS-Q-XX-01" in case.session.passed
    assert "MACS-CMD-16-01" not in case.session.passed
    said = {one.requirement: one.verdict for one in case.session.conclude("")}
    assert said["MACS-Q-XX-01"] is Verdict.PASS
    assert said["MACS-CMD-16-01"] is Verdict.NOT_RUN
    (covered,) = [one for one in case.events if isinstance(one, StatesCovered)]
    assert (covered.sequences, covered.operations) == (1, 1)
    assert covered.counts == {"HD": {"ask the position": 1}}


def test_the_failing_run_is_plotted_and_no_other() -> None:
    """Measured against predicted, for the report."""
    moves = (operation("move", 0xF0), operation("ask the position", 0, 0, 0xA0))
    case = Case(Device(at_times()), is_lossless=True)
    before = case.session.motions.count
    case.runner.run((*moves, *moves))
    assert case.session.motions.count == before
    case.runner.run((*moves, *moves), is_plotted=True)
    motions = case.session.motions.kept[before:]
    assert motions
    for motion in motions:
        for time_ns, position in motion.measured:
            around = min(motion.predicted, key=lambda one: abs(one[0] - time_ns))
            assert around[1] - 1 <= position <= around[2] + 1


@pytest.mark.parametrize("seed", range(3))
def test_shrinking_never_leaves_the_envelope(seed: int) -> None:
    """Whatever is left out of a list that moves: nothing outside is asked for or reached."""
    wild = (operation("move", 0xFF, 0, 0xFF), *split(random.Random(seed).randbytes(240)))
    port = Device(at_times())
    case = Case(port, fenced=True)
    real = case.runner.run
    rest = iter(range(10**6))

    def fails_as_it_likes(operations: tuple[bytes, ...], **how: bool) -> Any:
        result = real(operations, **how)
        kept = next(rest) % 3 != 2
        return replace(result, mismatch=a_mismatch()) if kept else result

    case.runner.run = fails_as_it_likes  # type: ignore[method-assign]
    with pytest.raises(Stop):
        Failure(case.runner, case.runner.run(wild)).conclude()
    assert port.furthest <= TRAVEL
    assert port.asked <= TRAVEL
    assert port.furthest > 100


def a_mismatch() -> Any:
    """Some failure."""
    return Mismatch(REPLY, "this", "that")


def test_operations_are_told_by_their_lowest_number() -> None:
    """So that a recording keeps its meaning when there are more kinds of operations."""
    count = len(OPERATIONS)
    assert split(bytes([count + 3, 1, 2, 3, 5])) == (bytes([3, 1, 2, 3]),)
