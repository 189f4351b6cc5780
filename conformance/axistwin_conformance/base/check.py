"""Checks: how a property is declared.

A check is a function that takes a `Session` and judges; the decorator says which requirements it
judges and what it does to the device:

    @check("MACS-CMD-13-01", "MACS-REPLY-14", safety=("motion", "stored"), needs=("neighbour",))
    def a_move_ends_at_its_target(session: Session) -> None:
        '''20h reads the target once the profile is over.'''

The function's name is the property's name, its docstring the behaviour in a sentence.  A wrong
declaration is refused at import, with the remedy in the message.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from axistwin_conformance.base.classes import LEVELS, SAFETY_CLASSES

RIG = "rig:"  # what a need of a rig's capability begins with
BENCH = "bench"  # the need of what may go wrong where hands on the wiring have to be near

# What a check may need beside the device and its rig, and what to tell who does not have it.
# Families add what only their options meet (`declare_needs`).
NEEDS: dict[str, str] = {
    "neighbour": "needs a second module beside it (--neighbour ADDRESS)",
    "alone": "needs the module alone (no --neighbour)",
    "virtual": "needs virtual time: only the built-in twin can show it",
    "bench": "may disturb a controller that is in use: only on a bench (--allow rig)",
}


def declare_needs(needs: Mapping[str, str]) -> None:
    """Let checks have these needs, too: name → what to tell who does not have it.  Raises
    ValueError for a name that means something else already."""
    for name, text in needs.items():
        if NEEDS.setdefault(name, text) != text:
            raise ValueError(f"two families have a need {name}: call one of them otherwise")


CheckFunction = Callable[[Any], None]  # of a `Session`, which knows checks and is not known here


@dataclass(frozen=True, slots=True)
class Check:
    """A declared property: what it judges, what it does to the device, what it needs."""

    name: str
    function: CheckFunction
    requirements: tuple[str, ...]
    safety: tuple[str, ...]
    level: str
    needs: tuple[str, ...]
    behaviour: str
    module: str
    soaks: bool = False
    shared: tuple[str, ...] = ()  # taken over by another family: as it names what it judges itself

    @classmethod
    def named(
        cls,
        name: str,
        behaviour: str,
        module: str,
        *,
        requirements: tuple[str, ...] = (),
        safety: tuple[str, ...] = ("passive",),
        needs: tuple[str, ...] = (),
    ) -> Check:
        """A check without a function: for what the engine or a probe judges itself."""
        return cls(
            name, lambda session: None, requirements, safety, "quick", needs, behaviour, module
        )

    @property
    def declared(self) -> tuple[str, ...]:
        """The requirements as the check itself names them, whichever family runs it."""
        return self.shared or self.requirements

    def __call__(self, session: Any) -> None:
        """Run the check."""
        self.function(session)

    @property
    def rig_needs(self) -> tuple[str, ...]:
        """The capabilities of a rig that it needs."""
        return tuple(need.removeprefix(RIG) for need in self.needs if need.startswith(RIG))

    @property
    def danger(self) -> int:
        """The rank of its worst safety class; checks run in this order."""
        return max(SAFETY_CLASSES.index(name) for name in self.safety)


def check(
    *requirements: str,
    safety: str | Sequence[str] = "passive",
    level: str = "quick",
    needs: Sequence[str] = (),
    soaks: bool = False,
) -> Callable[[CheckFunction], Check]:
    """Declare the function below as the check of these requirements.

    `safety`: one class or several of `SAFETY_CLASSES`; all of them must be allowed for the check to
    run.  `level`: "quick" runs always, "full" only in full runs.  `needs`: names of `NEEDS`.
    `soaks`: it draws from its seed, and a soak repeats it with fresh ones until the time is over.
    Raises TypeError for a declaration that cannot be meant.
    """
    classes = (safety,) if isinstance(safety, str) else tuple(safety)

    def declare(function: CheckFunction) -> Check:
        name = function.__name__
        behaviour = " ".join((function.__doc__ or "").split())
        if not requirements or len(set(requirements)) != len(requirements):
            raise TypeError(f"{name}: name the requirements it judges in @check(...), each once")
        if not behaviour:
            raise TypeError(f"{name}: give it a docstring, the behaviour in one sentence")
        if not classes:
            raise TypeError(f"{name}: safety= needs a class; choose from {SAFETY_CLASSES}")
        _refuse_unknown(name, "safety", classes, SAFETY_CLASSES)
        _refuse_unknown(name, "level", (level,), LEVELS)
        others = [need for need in needs if not need.startswith(RIG)]
        _refuse_unknown(name, "needs", others, tuple(NEEDS))
        if ("rig" in classes) is not any(need == BENCH or need.startswith(RIG) for need in needs):
            raise TypeError(f"{name}: safety 'rig' and a need of 'rig:...' or 'bench' go together")
        home = function.__module__
        return Check(
            name, function, requirements, classes, level, tuple(needs), behaviour, home, soaks
        )

    return declare


def _refuse_unknown(name: str, what: str, given: Sequence[str], known: Sequence[str]) -> None:
    for word in given:
        if word not in known:
            raise TypeError(f"{name}: {what}={word!r} is unknown; choose from {', '.join(known)}")
