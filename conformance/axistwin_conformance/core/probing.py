"""How a probe is written: a function that asks the device one question of the ledger.

It is named after the switch that it tells, is handed the device as its family's checks handle it
(`Family.driver`), has the evidence for a docstring, and returns

    a number     the reading seen, 0 the default, in the order of the ledger
    numbers      the readings that explain what came, where this look cannot tell them apart
    Measured     the value of a reading that is a number of the unit's own
    a sentence   what came, if it fits no reading
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from axistwin_conformance.base.check import Check
from axistwin_conformance.core.session import Session


@dataclass(frozen=True, slots=True)
class Measured:
    """A reading that is a value of the unit's own, spelled as the ledger spells it."""

    value: str


Look = Callable[[Session], "Seen"]


@dataclass(frozen=True, slots=True)
class Seen:
    """What a look at the device showed: the readings that explain it (one: it is known; several:
    this look cannot tell them apart; none: it fits no reading), and what came, in words."""

    readings: tuple[str, ...]
    evidence: str


@dataclass(frozen=True, slots=True)
class Probe:
    """A short question to the device that tells one switch.

    Two probes may tell the same switch: the second then narrows down what the first leaves open.
    `check` carries name, safety classes and needs, and is what the run attempts; `look` asks.
    """

    switch: str
    look: Look
    check: Check

    @property
    def is_destructive(self) -> bool:
        """True if the question may leave the device where nobody finds it."""
        return "destructive" in self.check.safety


Outcome = int | tuple[int, ...] | Measured | str


def probe(
    *,
    safety: str | Sequence[str] = "passive",
    needs: Sequence[str] = (),
    switch: str | None = None,
) -> Callable[[Callable[[Any], Outcome]], Probe]:
    """Declare the function below as the probe of `switch`, or of the one it is named after."""
    classes = (safety,) if isinstance(safety, str) else tuple(safety)

    def declare(function: Callable[[Any], Outcome]) -> Probe:
        told = switch or function.__name__
        question = " ".join((function.__doc__ or "").split()).rstrip(".")

        def look(session: Session) -> Seen:
            return _seen(session, told, question, function(session.run.family.driver(session)))

        name = f"detect_{function.__name__}"
        check = Check.named(name, question, function.__module__, safety=classes, needs=tuple(needs))
        return Probe(told, look, check)

    return declare


def _seen(session: Session, switch: str, question: str, outcome: Outcome) -> Seen:
    readings = session.run.ledger.ambiguity_of(switch).switches[switch]
    if isinstance(outcome, str):
        return Seen((), f"{question}: {outcome}")
    if isinstance(outcome, Measured):
        return Seen((outcome.value,), f"{question}: {outcome.value}")
    numbers = (outcome,) if isinstance(outcome, int) else outcome
    return Seen(tuple(readings[number] for number in numbers), question)
