"""Sequences on a unit: a sound one is found sound, a faulty one is found, shrunk and told."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from msc_twin import REPEATS, TwinPort, session_on, target_of

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.events import Event, FailureStored, StatesCovered
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.session import Session, Stop
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.machines import (
    some_runs_of_the_machine_agree_with_the_model as some_runs,
)
from axistwin_conformance.families.msc.checks.sequences import (
    many_mixed_sequences_agree_with_the_model as many_sequences,
)
from axistwin_conformance.families.msc.checks.sequences import replay_check
from axistwin_conformance.families.msc.checks.sequences import (
    some_mixed_sequences_agree_with_the_model as some_sequences,
)
from axistwin_conformance.families.msc.codec import ACK, NAK
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.family import FAMILY
from axistwin_conformance.families.msc.options import ScratchArea
from axistwin_conformance.families.msc.sequences.machine import ModelledUnit, UnitMachine
from axistwin_conformance.families.msc.sequences.operations import OPERATIONS, WHAT
from axistwin_conformance.families.msc.sequences.runner import MscRunner, runner_of
from axistwin_conformance.families.msc.sequences.sequence import places
from axistwin_conformance.sequences import machine
from axistwin_conformance.sequences.runner import Mismatch
from axistwin_conformance.sequences.strategies import reproducible

pytestmark = pytest.mark.strength


def operation(name: str, first: int = 0, second: int = 0, pause: int = 0) -> bytes:
    """An operation by its name."""
    return bytes([WHAT[name], first, second, pause])


class Case:
    """A check on a unit in virtual time, and what it tells."""

    def __init__(self, port: TwinPort, check: Check = some_sequences, **how: Any) -> None:
        self.port, self.events = port, list[Event]()
        self.session = session_on(port, check, emit=self.events.append, **how)
        self.session.run.memory = FAMILY.remember(Session(self.session.run))

        def gate(data: bytes) -> None:
            reason = FAMILY.forbid(self.session, data)
            assert reason is None, reason

        self.session.target.gate = gate

    def run(self) -> None:
        """Run the check; it may end early."""
        check = self.session.check
        assert check is not None
        try:
            check(self.session)
        except Stop:
            return

    @property
    def runner(self) -> MscRunner:
        """Somebody who plays on it."""
        return runner_of(self.session)

    @property
    def failed(self) -> dict[str, str]:
        """What failed, and the words."""
        return {
            one.requirement: one.text
            for one in self.session.findings
            if one.verdict is Verdict.FAIL
        }

    @property
    def stored(self) -> list[Recording]:
        """The recordings told, in order."""
        return [one.recording for one in self.events if isinstance(one, FailureStored)]


# --- sound ones -----------------------------------------------------------------------------------


@pytest.mark.parametrize("check", [some_sequences, many_sequences, some_runs],
                         ids=lambda check: check.name)  # fmt: skip
@pytest.mark.parametrize("has_rflags", [True, False])
def test_a_sound_unit_is_found_sound(check: Check, has_rflags: bool) -> None:
    """Whatever is drawn; on models with and without RFLAGS."""
    case = Case(TwinPort(has_rflags=has_rflags), check)
    case.run()
    assert case.failed == {}
    assert {"MSC-PROP-08", "MSC-PROP-09", "MSC-PROP-10", "MSC-PROP-13"} <= set(case.session.passed)


def test_every_operation_is_met_idle_and_waiting() -> None:
    """The state in which each was done is told."""
    case = Case(TwinPort(), many_sequences)
    case.run()
    (covered,) = [one for one in case.events if isinstance(one, StatesCovered)]
    names = {one.name for one in OPERATIONS}
    assert set(covered.counts["idle"]) == names
    assert len(covered.counts["waiting"]) > len(names) // 2


@reproducible()
def test_the_machine_does_every_operation() -> None:
    """Its rules reach all of the table but the wait, which is a pause there."""
    runner, missing = Case(TwinPort(), some_runs).runner, {one.name for one in OPERATIONS}
    for number in range(8):  # what one seed draws depends on the modules that are loaded
        begun, failing = machine.search(
            runner.begin, ModelledUnit, 20, 60, random.Random(number), UnitMachine
        )
        assert failing is None
        missing -= {name for run in begun for _, name in run.operated}
        if missing <= {"wait"}:
            break
    assert missing <= {"wait"}


def test_what_is_written_is_put_back() -> None:
    """Values and flags hold what they held before the check."""
    port = TwinPort()
    port.data = {address: address * 31 for address in range(1024, 5120, 4)}
    port.flags = {130, 150, 180}
    before = dict(port.data), set(port.flags)
    case = Case(port)
    case.run()
    assert (port.data, port.flags) != before
    assert FAMILY.restore(Session(case.session.run), case.session.run.memory) == ()
    assert (port.data, port.flags) == before


@pytest.mark.parametrize("named", [range(2000, 2001), range(2001, 2050), range(1026, 1300)])
def test_places_lie_inside_what_is_named(named: range) -> None:
    """However little that is, and wherever it begins."""
    scratch = ScratchArea(named, range(130, 131))
    driver = MscDriver(session_on(TwinPort(), many_sequences, settings=scratch))
    spots, blocks, cover = places(driver)
    assert all(one in named and one % 4 == 0 for one in (*spots, *blocks))
    assert all(one + 31 * 4 in named for one in blocks)
    assert set(cover) <= set(blocks)


def test_the_smallest_ground_is_enough_to_play_on() -> None:
    """One variable, one flag: what needs more does less."""
    scratch = ScratchArea(range(2000, 2004), range(130, 131))
    case = Case(TwinPort(), many_sequences, settings=scratch)
    case.run()
    assert case.failed == {}


def test_on_a_line_that_may_lose_bytes_the_lists_are_few_and_short() -> None:
    """Nothing there is sent twice that must not be."""
    port = TwinPort()
    case = Case(port, many_sequences, target=target_of(port, is_lossless=False))
    case.run()
    assert case.failed == {}
    (covered,) = [one for one in case.events if isinstance(one, StatesCovered)]
    assert covered.operations == 5 * 30


# --- faulty ones ----------------------------------------------------------------------------------


def _lets_go_of(port: TwinPort, name: str) -> None:
    """The unit acknowledges that command and does nothing."""
    served = port.served

    def fault(one: codec.Packet) -> bytes | None:
        return b"" if one.name == name else served(one)

    port.served = fault


def _clobbers(port: TwinPort) -> None:
    """DWRITE takes the next value with it."""
    served = port.served

    def fault(one: codec.Packet) -> bytes | None:
        if one.name == "DWRITE":
            port.data[one.numbers[0] + 4] = 0
        return served(one)

    port.served = fault


def _reads_change(port: TwinPort) -> None:
    """BREAD clears what it has read."""
    served = port.served

    def fault(one: codec.Packet) -> bytes | None:
        told = served(one)
        if one.name == "BREAD":
            port.data.update(dict.fromkeys(range(one.numbers[0], one.numbers[0] + 128, 4), 0))
        return told

    port.served = fault


def _repeats_with_an_ack(port: TwinPort) -> None:
    """A repeated reply has an ACK before it."""
    unit = port.receiver
    again = unit._repeat

    def fault(now: int, start_ns: int) -> None:
        again(now, unit._send(start_ns, ACK) if unit._repeats < REPEATS else start_ns)

    unit._repeat = fault


def _repeats_six_times(port: TwinPort) -> None:
    """One repeat too many."""
    port.receiver._repeats_max = REPEATS + 1


def _forgets_the_time(port: TwinPort) -> None:
    """A packet that breaks off is waited for for ever."""
    port.receiver._packet_ns = 10**18


def _answers_signs(port: TwinPort) -> None:
    """A sign that nobody waits for draws a NAK."""
    unit = port.receiver

    def fault(byte: int, now: int) -> None:
        if bytes([byte]) == NAK:
            unit._sign(now, now, NAK, unit._rest)

    unit._heeds_noise, unit._take_noise = True, fault


def _keeps_the_wait(port: TwinPort) -> None:
    """A new packet does not end the wait: it is not taken for one."""
    port.receiver._serves_when_waiting = False
    port.receiver._quirks = replace(port.receiver._quirks, stx_while_waiting="ignore")


Plant = Callable[[TwinPort], None]


@pytest.mark.parametrize("check", [some_sequences, some_runs], ids=lambda check: check.name)
@pytest.mark.parametrize(
    ("plant", "requirements"),
    [
        (lambda port: _lets_go_of(port, "DWRITE"), {"MSC-PROP-08", "MSC-PROP-09"}),
        (lambda port: _lets_go_of(port, "BWRITE"), {"MSC-PROP-09", "MSC-PROP-08"}),
        (lambda port: _lets_go_of(port, "SFLAG"), {"MSC-PROP-10"}),
        (lambda port: _lets_go_of(port, "CFLAG"), {"MSC-PROP-10"}),
        (_clobbers, {"MSC-PROP-09", "MSC-PROP-08"}),
        (_reads_change, {"MSC-PROP-13", "MSC-PROP-08", "MSC-PROP-09"}),
        (_repeats_with_an_ack, {"MSC-LNK-10", "MSC-LNK-12"}),
        (_repeats_six_times, {"MSC-LNK-09"}),
        (_forgets_the_time, {"MSC-LNK-03"}),
        (_answers_signs, {"MSC-LNK-15", "MSC-PROP-15"}),
        (_keeps_the_wait, {"MSC-LNK-16"}),
    ],
    ids=["DWRITE", "BWRITE", "SFLAG", "CFLAG", "clobbers", "reads", "ack", "six", "time", "signs",
         "wait"],
)  # fmt: skip
def test_a_faulty_unit_fails_what_it_breaks(
    check: Check, plant: Plant, requirements: set[str]
) -> None:
    """By a few sequences, and by a few runs of the machine, each alone; some seeds are enough."""
    for seed in range(4):
        port = TwinPort()
        case = Case(port, check, seed=seed)
        plant(port)
        case.run()
        if case.failed:
            break
    assert set(case.failed) & requirements, case.failed
    assert len(case.failed) == 1


def test_a_failure_is_shrunk_stored_and_plays_again() -> None:
    """To the one write whose neighbour it takes, in words and as bytes."""
    port = TwinPort()
    case = Case(port)
    _clobbers(port)
    case.run()
    last = case.stored[-1]
    assert last.model == "msc-250"
    assert len(last.operations) <= 3
    assert len(case.stored[0].operations) > len(last.operations)
    assert "DWRITE" in " ".join(last.words)
    again = Case(port, replay_check(last))
    again.run()
    assert set(again.failed) == {last.requirement}
    sound = Case(TwinPort(), replay_check(last))
    sound.run()
    assert sound.failed == {}


def test_a_mismatch_tells_what_was_said_before_it() -> None:
    """Request and answer of every step, the last one included."""
    port = TwinPort()
    case = Case(port)
    _lets_go_of(port, "DWRITE")
    run = case.runner.begin()
    with pytest.raises(Mismatch) as refuted:
        run.perform(operation("write a value", 0, 4) + operation("read a value"))
    assert refuted.value.requirement == "MSC-PROP-08"
    assert refuted.value.story == (
        "unit 1: DWRITE 1024 = -2147483648 → ACK",
        "unit 1: DREAD 1024 → ACK, unit 1: DREAD = 0",
    )


def test_units_that_hunt_for_starts_are_not_played_among_others() -> None:
    """What they say there is no answer to what was asked."""
    case = Case(TwinPort(), neighbours=(2,))
    case.session.run.readings["other_unit_framing"] = "hunt_stx"
    case.run()
    assert {one.verdict for one in case.session.findings} == {Verdict.NOT_RUN}
