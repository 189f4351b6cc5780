"""Sequences and machines on CAN: the operations of the axis, judged by the names of this family."""

from __future__ import annotations

import itertools
import json
import random
import re
import shlex
from collections.abc import Iterator, Mapping
from typing import Any

import can
import pytest
from click.testing import CliRunner
from zoo.motion import a_ramped_stop_stops_dead

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.errors import AttemptVoid
from axistwin_conformance.base.events import Event, FailureStored
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import conform
from axistwin_conformance.core.readings import Readings
from axistwin_conformance.core.session import Envelope, Run, Session, Stop
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.families.mac.axis.checks.machines import (
    some_runs_of_the_machine_agree_with_the_model as some_runs,
)
from axistwin_conformance.families.mac.axis.checks.sequences import (
    many_mixed_sequences_agree_with_the_model as many_sequences,
)
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.sequences.machine import AxisMachine
from axistwin_conformance.families.mac.axis.sequences.machine_devices import JudgedAxis
from axistwin_conformance.families.mac.axis.sequences.machine_sync import SyncMachine
from axistwin_conformance.families.mac.axis.sequences.operations import OPERATIONS, WHAT, WITH_SYNC
from axistwin_conformance.families.mac.axis.sequences.runner import AxisRunner
from axistwin_conformance.families.mac.axis.sequences.sequence import AxisSequence
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.sequences import failure, machine
from axistwin_conformance.sequences.failure import Failure
from axistwin_conformance.sequences.runner import Mismatch
from axistwin_conformance.sequences.strategies import reproducible
from axistwin_conformance.transport.can import CanTransport
from axistwin_conformance.transport.can_frame import Frame

pytestmark = pytest.mark.strength

FAMILY = find_family("mac23-can")
TWIN = "mac23-can:1,mac23-can:3?time=virtual"
BUSES = itertools.count()
opened: list[Any] = []
CHECK = "some_mixed_sequences_agree_with_the_model"
FAILING = "030002ff0500000008000000"  # turn, ramped stop, move: refused while the ramp runs
BITRATE = 125_000


def own(name: str) -> Check:
    """A check of the axis as this family runs it."""
    return next(one for one in FAMILY.checks() if one.name == name)


def operation(name: str, first: int = 0, second: int = 0, pause: int = 0) -> bytes:
    """An operation by its name."""
    return bytes([WHAT[name], first, second, pause])


def twin_bus(options: str = "") -> Any:
    """The bus object of a fresh twin, open until the test is over."""
    channel = f"{TWIN}{options}&bus=sequences{next(BUSES)}"
    opened.append(can.Bus(channel, "axistwin", ignore_config=True, bitrate=BITRATE))
    return opened[-1]


@pytest.fixture(autouse=True)
def no_bus_outlives_its_test() -> Iterator[None]:
    """Tests of the bus in the same process count those that are open."""
    yield
    while opened:
        opened.pop().shutdown()


class Case:
    """Somebody who plays on a fresh twin beside another, and all that came of it."""

    def __init__(
        self,
        check: Check = many_sequences,
        *,
        bus: Any = None,
        is_lossless: bool = True,
        readings: Mapping[str, str] | None = None,
    ) -> None:
        """`readings`: what the twin makes of the manual, known from the beginning."""
        readings = readings or {}
        quirks = "".join(f"&quirk.{switch}={one}" for switch, one in readings.items())
        if bus is None:
            bus = twin_bus(quirks)
        target = CanTransport(
            bus, f"axistwin:{TWIN}{quirks}", is_spontaneous=codec.is_spontaneous, bitrate=BITRATE,
            is_lossless=is_lossless,
        )  # fmt: skip
        self.events: list[Event] = []
        self.run = Run(
            target=target, family=FAMILY, model=FAMILY.models["mac23-can"],
            ledger=load_ledger("mac_can"), address=1, neighbours=(3,),
            allowed=frozenset(SAFETY_CLASSES), envelope=Envelope(1 << 20, 5000, is_guarded=False),
            seed=3, emit=self.events.append, readings=Readings(readings),
        )  # fmt: skip
        self.run.memory = FAMILY.remember(Session(self.run))
        self.session = Session(self.run, own(check.name))
        driver = CanDriver(self.session)
        self.runner = AxisRunner(driver, driver.motion.ready())

    def performed(self, data: bytes) -> AxisSequence:
        """A sequence that has been played."""
        run = self.runner.begin()
        run.perform(data)
        return run


# --- operations -----------------------------------------------------------------------------------


def test_any_byte_names_an_operation_and_sync_is_one_more() -> None:
    """Every value of every byte is decoded, and the module agrees with the model."""
    run = Case().performed(b"".join(bytes([what, 7, 9, 0]) for what in range(256)))
    assert {name for _, name in run.operated} == {one.name for one in WITH_SYNC}
    assert len(WITH_SYNC) == len(OPERATIONS) + 1


@pytest.mark.parametrize(
    "readings",
    [{}, {"can_byte_order": "little"}, {"upload_scs": "43h", "abort_code_form": "code"}],
    ids=str,
)
def test_random_bytes_are_judged_by_the_ids_that_this_family_translates(
    readings: dict[str, str],
) -> None:
    """No judgement is lost on the way from the axis's names, however this device spells frames."""
    run = Case(readings=readings).performed(random.Random(len(readings)).randbytes(240))
    assert "MACS-REPLY-05" in run.judged
    own_names = load_ledger("mac_can").own
    assert all(len(own_names((name,))) == 1 for name in run.judged)


def test_sync_starts_a_held_move_as_11h_does() -> None:
    """It gets no reply, and the module is then where the model says."""
    ends = []
    for name in ("trigger", "trigger by SYNC"):
        run = Case().runner.begin()
        for one in (operation("arm"), operation("move", 0xA0), operation(name)):
            run.operate(*one)
        assert run.model.preloaded is None
        assert not run.is_resting
        run.operate(*operation("ask the position", 0, 0, 0xFF))
        run.operate(*operation("wait for an instant"))
        run.conclude()
        run.leave()
        ends.append(run.model.forecast.final)
    assert ends[0] == ends[1]


def test_where_sync_may_do_something_else_the_axis_is_stopped_instead() -> None:
    """In motion, and where nobody knows what it does without a preloaded motion."""
    run = Case().runner.begin()
    run.operate(*operation("turn", 0, 2))
    run.operate(*operation("trigger by SYNC"))
    assert "2018h" in run.story[-1]
    refusing = Case(readings={"sync_without_preload": "refuse"}).runner.begin()
    refusing.operate(*operation("trigger by SYNC"))
    assert "2018h" in refusing.story[-1]


def test_what_only_the_serial_line_has_is_unassigned_here() -> None:
    """08h, 1Bh, 28h and 29h are refused like any other index that means nothing."""
    run = Case().runner.begin()
    for first in range(12):
        run.operate(*operation("send an unassigned index", first))
    told = " ".join(run.story)
    for words in ("download 2008h", "download 201Bh", "upload 2008h", "upload 2009h"):
        assert f"{words} (not used" in told
    assert "accepted" not in told
    assert "answer" not in told


def test_every_query_of_the_face_is_asked_and_no_other() -> None:
    """Eight uploads, whatever the byte."""
    run = Case().runner.begin()
    before = len(run.story)
    for first in range(16):
        run.operate(*operation("ask", first))
    told = run.story[before:]
    assert all(": answer" not in one and "answer 200" in one for one in told), told
    assert len({one.split(" → ")[0] for one in told}) == 8


def test_a_spoilt_frame_is_too_short_and_one_to_nobody_is_nobody_s() -> None:
    """Neither gets a reply, nor does anything; 600h, which is everybody's, is never meant."""
    run = Case().runner.begin()
    before = len(run.story)
    for first in range(0x70):
        run.operate(*operation("call another address", first, 3))
        run.operate(*operation("spoil a frame", first, first))
    told = run.story[before:]
    assert all(one.endswith("→ silence") for one in told)
    assert not any(one.startswith(("to all", "to module 1:", "to module 3:")) and len(one) > 99
                   for one in told)  # fmt: skip
    assert run.judged["MACS-FRAME-07"] == run.judged["MACS-REPLY-02"] == 0x70


def test_a_device_that_pads_short_frames_gets_none() -> None:
    """On it they are requests like any other."""
    run = Case(readings={"short_frame": "pad"}).runner.begin()
    before = len(run.story)
    run.operate(*operation("spoil a frame", 4, 9))
    assert run.story[before:] == []


@pytest.mark.parametrize("seconds", [4, 11])
def test_what_modules_say_unasked_disturbs_nothing(seconds: int) -> None:
    """A lifebeat between two requests, or between a request and its reply, is no reply."""
    case = Case()
    run = case.runner.begin()
    for _ in range(12):
        run.pause(seconds)
        run.query(0x20)
    assert isinstance(case.run.target, CanTransport)
    heard = {one.frame.identifier for one in case.run.target.take_spontaneous()}
    assert heard == ({0x083} if seconds < 10 else {0x081, 0x083})
    run.conclude()
    run.leave()


# --- the machine ----------------------------------------------------------------------------------


@reproducible()
def test_the_machine_synchronises_by_the_frame_too() -> None:
    """Among its rules are all of the axis."""
    case = Case(some_runs)
    begin = case.runner.begin
    sequences, failing = machine.search(begin, JudgedAxis, 6, 60, random.Random(5), SyncMachine)
    assert failing is None
    names = {name for run in sequences for _, name in run.operated}
    assert "trigger by SYNC" in names
    plain = {one.function.__name__ for one in AxisMachine.setup_state().rules}
    assert plain < {one.function.__name__ for one in SyncMachine.setup_state().rules}


# --- failures -------------------------------------------------------------------------------------


def test_a_failure_is_told_in_the_names_of_can_and_shrunk() -> None:
    """Requirement and words are those of this face, in the verdict and in the record."""
    long = (operation("set the ramp", 6), operation("turn", 0, 2, 0xFF), operation("ramped stop"),
            operation("nudge"))  # fmt: skip
    noise = tuple(operation("ask", number) for number in range(8))
    case = Case()
    with a_ramped_stop_stops_dead.plant(), pytest.raises(Stop):
        Failure(case.runner, case.runner.run((*noise, *long, *noise))).conclude()
    failed = [one for one in case.session.findings if one.verdict is Verdict.FAIL]
    assert [one.requirement for one in failed] == ["MACC-CMD-13-01"]
    assert "refused to download 2013h in VE" in failed[0].expected[0]
    (*_, last) = [one.recording for one in case.events if isinstance(one, FailureStored)]
    assert last.requirement == "MACC-CMD-13-01"
    assert last.model == "mac23-can"
    assert len(last.operations) == 3
    assert "download 2017h" in " ".join(last.words)


def test_the_twin_to_shrink_on_is_one_on_a_bus_with_the_same_readings() -> None:
    """With its neighbours, at the same bit rate, held to what the device has shown."""
    case = Case(readings={"ramp_law": "equal_increments"})
    twin = failure.open_twin(case.session)
    assert isinstance(twin, CanTransport)
    assert twin.rate == BITRATE
    assert "quirk.ramp_law=equal_increments" in twin.description
    other = case.runner.on(failure.twin_session(case.session, twin))
    assert other.run((operation("turn", 0, 2), operation("nudge"))).mismatch is None
    assert sorted(one.address for one in twin.twins) == [1, 3]
    twin.close()


def test_a_reply_that_does_not_fit_is_not_taken_for_an_admissible_one() -> None:
    """A module that answers with the data of another query fails the query."""
    case = Case()
    run = case.runner.begin()
    run.model.parameters.tolerance = 5
    with pytest.raises(Mismatch) as refuted:
        run.perform(operation("ask", 6))
    assert refuted.value.requirement == "MACS-REPLY-05"
    assert "2006h" in refuted.value.story[-1]
    assert "upload 2006h" in refuted.value.expected


class DroppingBus:
    """The twin's bus, on which one frame in `every` is lost, either way."""

    def __init__(self, every: int, seed: int) -> None:
        self.bus = twin_bus()
        self.every, self.random, self.lost = every, random.Random(seed), 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.bus, name)

    def _is_lost(self) -> bool:
        is_lost = not self.random.randrange(self.every)
        self.lost += is_lost
        return is_lost

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send it, or not."""
        if not self._is_lost():
            self.bus.send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Receive, unless what came was lost: then the time is over all the same."""
        message: can.Message | None = self.bus.recv(timeout)
        return None if message is not None and self._is_lost() else message


@pytest.mark.parametrize("seed", range(4))
def test_lost_frames_make_no_mismatch(seed: int) -> None:
    """What may be said twice is said again; what may not, breaks the sequence off."""
    case = Case(bus=DroppingBus(60, seed), is_lossless=False)
    case.session.is_strict = False
    data = random.Random(seed).randbytes(160)
    for _ in range(2):
        try:
            result = case.runner.run(case.runner.split(data))
        except AttemptVoid:
            continue
        assert result.mismatch is None, result.mismatch
    assert case.run.target._bus.lost  # type: ignore[attr-defined]


# --- replay ---------------------------------------------------------------------------------------


def typed(*words: str) -> Any:
    """Type a command."""
    return CliRunner().invoke(conform, ("mac23-can", *words))


def failed(output: str) -> set[str]:
    """The requirements that failed, as printed with the failures."""
    return set(re.findall(r"^ {3}(?:required| {8}) +(MAC\w-\S+): ", output, re.MULTILINE))


def test_the_command_printed_with_a_failure_fails_the_same_requirement() -> None:
    """On a twin without the fault it does not."""
    with a_ramped_stop_stops_dead.plant():
        first = typed(CHECK)
        printed = re.sub(r" \\\n +", " ", first.output)
        (line,) = re.findall(r"^   replay +(.*)$", printed, re.MULTILINE)
        words = shlex.split(line)[3:]
        again = typed(*words)
    assert first.exit_code == again.exit_code == 1, first.output
    assert failed(first.output) == failed(again.output) != set()
    assert {name[:4] for name in failed(first.output)} == {"MACC"}
    assert again.output.splitlines()[-1].startswith("Reproduced: ")
    sound = typed(*words)
    assert sound.exit_code == 0, sound.output
    assert sound.output.splitlines()[-1].startswith("Not reproduced: ")


def test_recorded_operations_of_the_line_mean_the_same_on_the_bus() -> None:
    """The table is shared: its numbers stay, and SYNC stands behind them."""
    result = typed("--replay", FAILING, "--json")
    assert result.exit_code == 0, result.output
    events = [json.loads(line) for line in result.stdout.splitlines()]
    (covered,) = [one for one in events if one["event"] == "states_covered"]
    names = {name for counts in covered["counts"].values() for name in counts}
    assert names == {"turn", "ramped stop", "nudge"}
    assert WHAT["trigger by SYNC"] == len(OPERATIONS)


def test_a_reply_to_sync_is_none_of_the_exchange() -> None:
    """The frame alone is told, with silence; the upload behind it bounds when it was heard."""
    case = Case()
    exchange = case.runner.driver.client.synchronise()
    assert exchange is not None
    assert exchange.request == Frame(codec.SYNC).pack()
    assert exchange.kind is ReplyKind.SILENCE
    assert 0 < exchange.taken.latest_ns - exchange.taken.earliest_ns < 5_000_000


def test_each_built_in_twin_is_on_a_bus_of_its_own() -> None:
    """Two runs in one process, or the twin to shrink on beside another, have nothing in common."""
    url = FAMILY.twin_url("mac23-can", 1, ())
    one, other = (FAMILY.open(url, None, is_builtin=True) for _ in range(2))
    assert one.description == other.description == url, "it opens a third"
    one.twins[0].power_off()
    assert other.twins[0].state != one.twins[0].state
    one.close()
    other.close()
