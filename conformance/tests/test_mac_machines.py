"""The stateful machine: what it finds alone, what it drives, and that its runs can be played."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from zoo import ZOO
from zoo.judge import run
from zoo.mutant import Mutant

from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.session import Envelope, Run, Session
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.families.mac.axis.checks.machines import (
    some_runs_of_the_machine_agree_with_the_model as some_runs,
)
from axistwin_conformance.families.mac.axis.checks.sequences import runner_of
from axistwin_conformance.families.mac.axis.sequences.machine import AxisMachine
from axistwin_conformance.families.mac.axis.sequences.machine_devices import JudgedAxis, Trivial
from axistwin_conformance.families.mac.axis.sequences.operations import OPERATIONS, WHAT
from axistwin_conformance.families.mac.axis.sequences.runner import AxisRunner
from axistwin_conformance.families.mac.axis.sequences.sequence import BYTES_PER_OPERATION
from axistwin_conformance.sequences import machine
from axistwin_conformance.sequences.machine import Device
from axistwin_conformance.sequences.runner import Mismatch
from axistwin_conformance.sequences.strategies import reproducible
from axistwin_conformance.transport.serial import open_target

pytestmark = pytest.mark.strength

# Each needs a state first: a motion under way, one segment being executed and three that wait.
FOUND_ALONE = (
    "a_move_is_taken_over_in_motion",
    "the_fifo_has_one_stage",
    "the_fifo_has_four_stages",
)


def new_runner() -> AxisRunner:
    """Somebody who plays on a fresh twin."""
    family = find_family("mac23")
    target = open_target(
        family.twin_url("mac23", 0, ()), family.default_rate or 38400, is_builtin=True
    )
    one = Run(
        target=target, family=family, model=family.models["mac23"],
        ledger=load_ledger(family.name), address=0, neighbours=(),
        allowed=frozenset(SAFETY_CLASSES), envelope=Envelope(1 << 20, 5000, is_guarded=False),
        seed=1,
    )  # fmt: skip
    one.memory = family.remember(Session(one))
    return runner_of(Session(one, some_runs))


def rules() -> set[str]:
    """The names of the machine's rules."""
    return {one.function.__name__ for one in AxisMachine.setup_state().rules}


def planted(name: str) -> Mutant:
    """A mutant of the zoo."""
    (mutant,) = [one for one in ZOO if one.name == name]
    return mutant


@reproducible()
def found_in(mutant: Mutant) -> tuple[bytes, Mismatch]:
    """The operations and the mismatch with which the machine finds a mutant, on its own."""
    with mutant.plant():
        _, failing = machine.search(
            new_runner().begin, JudgedAxis, 15, 100, random.Random(1), AxisMachine
        )
    assert failing is not None, mutant.description
    return failing[:2]


@pytest.mark.parametrize("name", FOUND_ALONE)
def test_the_machine_alone_finds_planted_faults(name: str) -> None:
    """Mutants that show in rich states only fall by the requirement they claim."""
    mutant = planted(name)
    operations, mismatch = found_in(mutant)
    assert mismatch.requirement in mutant.claims
    assert len(operations) % BYTES_PER_OPERATION == 0


def test_a_healthy_twin_agrees_with_the_model() -> None:
    """Nothing fails, and what passes was really judged."""
    result = run(some_runs.name)
    verdicts = Counter(finding.verdict for ran in result.checks for finding in ran.findings)
    assert set(verdicts) <= {Verdict.PASS, Verdict.NOT_RUN}
    assert verdicts[Verdict.PASS] >= 15
    assert result.exit_status == 0


def test_a_failing_run_is_played_again_from_its_bytes() -> None:
    """The operations that the machine records lead a sequence to the same requirement."""
    mutant = planted(FOUND_ALONE[2])
    operations, mismatch = found_in(mutant)
    with mutant.plant(), pytest.raises(Mismatch) as again:
        new_runner().begin().perform(operations)
    assert again.value.requirement == mismatch.requirement


@reproducible()
def test_every_rule_is_reached_and_every_state_is_met() -> None:
    """On the twin no rule waits for a state that never comes."""
    runner, reached = new_runner(), Counter[str]()

    class Counted(JudgedAxis):
        """Notes what is done."""

        def operate(self, what: int, first: int, second: int, pause: int) -> None:
            reached[OPERATIONS[what].name] += 1
            super().operate(what, first, second, pause)

    devices: list[Counted] = []

    def begin() -> Device:
        devices.append(Counted(runner.begin()))
        return devices[-1]

    machine.run(machine.driven(begin, lambda operation: None, AxisMachine), 40, 100, 5)
    states = {state for one in devices for state, _ in one.sequence.operated}
    assert {"HD", "PO", "VE", "IN", "AR", "PL"} <= states
    unreached = {one.name for one in OPERATIONS} - set(reached)
    assert unreached <= {"ask the position"}, "which the rules ask for by 'ask'"


def test_a_trivial_device_meets_every_precondition() -> None:
    """The limit is measured with the same rules: each can be tried on the device without sense."""
    device, allowed = Trivial(), set[str]()
    source = random.Random(1)
    preconditions = {
        one.function.__name__: one.preconditions for one in AxisMachine.setup_state().rules
    }

    class Looking:
        """What preconditions are asked of."""

    looking = Looking()
    looking.device = device  # type: ignore[attr-defined]
    for _ in range(3000):
        for name, conditions in preconditions.items():
            if all(one(looking) for one in conditions):
                allowed.add(name)
        device.operate(source.choice(tuple(WHAT.values())), 0, 0, 0)
    assert allowed == rules()


@reproducible()
def test_the_same_seed_draws_the_same_run() -> None:
    """A replayed check does what it did before."""

    def drawn() -> bytes:
        record = bytearray()
        machine.run(machine.driven(Trivial, record.extend, AxisMachine), 5, 30, 7)
        return bytes(record)

    assert drawn() == drawn() != b""
