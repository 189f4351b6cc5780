"""Stateful machines, whatever the family: rules that are tried where they mean something.

A family has the rules; what a step does is an operation of some bytes, seldom a few, judged by the
family's model and recorded, so that a player plays a failing run again.

    rules + preconditions ─▶ operation ─▶ Device ─▶ device and model ─▶ view ─▶ preconditions
"""

from __future__ import annotations

import random
import sys
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Protocol, TypeVar

from hypothesis import seed
from hypothesis.errors import Flaky
from hypothesis.stateful import RuleBasedStateMachine, run_state_machine_as_test

from axistwin_conformance.sequences.runner import Mismatch
from axistwin_conformance.sequences.strategies import generate_only

Run = TypeVar("Run")


class Device(Protocol):
    """What a machine drives: a device held against the model, or one that does nothing."""

    @property
    def view(self) -> Any:
        """The state after the last operation, as preconditions look at it."""

    def operate(self, what: int, first: int, second: int, pause: int, /) -> None:
        """Do an operation; raises Mismatch for a reply that is not admissible."""

    def conclude(self) -> None:
        """Compare everything readable; raises Mismatch."""

    def leave(self) -> None:
        """Leave the device as it was found."""


class Machine(RuleBasedStateMachine):
    """What the rules of a family stand on; `driven` makes a machine of them that drives a device of
    its own.  `what`: the numbers of its operations, by their names."""

    what: ClassVar[Mapping[str, int]]
    begin: Callable[[], Device]
    record: Callable[[bytes], None]
    note_steps: Callable[[int], None]

    def __init__(self) -> None:
        super().__init__()
        self.device = type(self).begin()
        self.steps = 0
        self.is_refuted = False

    def do(self, name: str, first: int = 0, second: int = 0, pause: int = 0) -> None:
        """Do an operation, and record it first."""
        what = self.what[name]
        type(self).record(bytes((what, first, second, pause)))
        try:
            self.device.operate(what, first, second, pause)
        except Mismatch:
            self.is_refuted = True
            raise

    def teardown(self) -> None:
        """Compare everything at the end, and leave the device as it was found."""
        type(self).note_steps(self.steps - 1)  # the invariants are asked once before the first step
        try:
            # What tidying up then found would take the place of the interrupt, as a failure.
            if not self.is_refuted and not isinstance(sys.exception(), KeyboardInterrupt):
                self.device.conclude()
        finally:
            self.device.leave()


def driven(
    begin: Callable[[], Device], record: Callable[[bytes], None], rules: type[Machine]
) -> type[Machine]:
    """The machine on devices that `begin` makes; `record` is told of each operation."""
    members = {"begin": staticmethod(begin), "record": staticmethod(record)}
    return type(f"Driven{rules.__name__}", (rules,), members)


def run(
    machine: type[Machine],
    examples: int,
    steps: int,
    number: int,
    note_steps: Callable[[int], None] = lambda steps: None,
) -> None:
    """Run a machine with the seed `number`: so many examples of so many steps; `note_steps` takes
    how many each really had.

    Raises Mismatch.
    """
    machine.note_steps = staticmethod(note_steps)
    bounds = generate_only(examples, steps)
    run_state_machine_as_test(seed(number)(machine), settings=bounds)


def search(
    begin: Callable[[], Run],
    judged: Callable[[Run], Device],
    examples: int,
    steps: int,
    source: random.Random,
    rules: type[Machine],
) -> tuple[list[Run], tuple[bytes, Mismatch, Run] | None]:
    """Let Hypothesis look for a run that the model does not admit; `judged` makes a device of what
    `begin` begins.

    Give all that was begun, and of a failing run, if one was found, the operations, what came, and
    what `begin` began for it.
    """
    begun: list[Run] = []
    operations = bytearray()
    failing: list[tuple[bytes, Mismatch, Run]] = []

    def start() -> Device:
        operations.clear()
        begun.append(begin())
        run = begun[-1]
        return _Noticing(judged(run), lambda one: failing.append((bytes(operations), one, run)))

    while len(begun) < examples:
        left = examples - len(begun)
        try:
            run(driven(start, operations.extend, rules), left, steps, source.getrandbits(32))
            break
        except (Mismatch, Flaky):
            if failing:
                return begun, failing[0]
            # The device has kept something from the run before, so that the same steps led
            # elsewhere: Hypothesis gives up, and draws anew.
    return begun, None


class _Noticing:
    """A device of whose mismatches somebody is told."""

    def __init__(self, device: Device, note: Callable[[Mismatch], None]) -> None:
        self._device, self._note = device, note

    @property
    def view(self) -> Any:
        return self._device.view

    def operate(self, what: int, first: int, second: int, pause: int) -> None:
        try:
            self._device.operate(what, first, second, pause)
        except Mismatch as mismatch:
            self._note(mismatch)
            raise

    def conclude(self) -> None:
        try:
            self._device.conclude()
        except Mismatch as mismatch:
            self._note(mismatch)
            raise

    def leave(self) -> None:
        self._device.leave()
