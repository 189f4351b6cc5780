"""A mutant, and the few ways in which one is planted into the twins of this process."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest

from axistwin.devices.mac.axis import axis as axis_module
from axistwin.devices.mac.axis.acceptance import MOVING, State, acceptance_table
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.drive import Drive
from axistwin.devices.mac.axis.parameters import Parameters
from axistwin.devices.mac.serial.device import MacSerial
from axistwin.motion.ramp import RampedMotion

Any_ = Callable[..., Any]
MonkeyPatch = pytest.MonkeyPatch
Alteration = Callable[[MonkeyPatch], None]

__all__ = ["MOVING", "MonkeyPatch", "Mutant", "State", "mutant"]


@dataclass(frozen=True, slots=True)
class Mutant:
    """One planted firmware fault.

    `claims`: the requirements it breaks, each of which must be seen broken.  `traps`: entries of
    the ledger's list of traps (§8).  `model`: the twin that has the fault; `address`: where it is
    judged, if not where the family's twin is.
    """

    name: str
    claims: tuple[str, ...]
    description: str
    alter: Alteration
    traps: tuple[int, ...] = ()
    model: str = "mac23"
    address: int | None = None

    @contextmanager
    def plant(self) -> Iterator[None]:
        """Let every twin built in this process have the fault."""
        with MonkeyPatch.context() as patch:
            self.alter(patch)
            forget()
            try:
                yield
            finally:
                patch.undo()
                forget()


def forget() -> None:
    """Empty the caches of the twins: what was remembered was said by another firmware."""
    for name, module in list(sys.modules.items()):
        if name.startswith("axistwin."):
            for value in list(vars(module).values()):
                if callable(clear := getattr(value, "cache_clear", None)):
                    clear()


def mutant(
    *claims: str, traps: Sequence[int] = (), model: str = "mac23", address: int | None = None
) -> Callable[[Alteration], Mutant]:
    """Declare the function below as a mutant: it plants the fault, its docstring describes it."""

    def declare(alter: Alteration) -> Mutant:
        text = " ".join((alter.__doc__ or "").split())
        return Mutant(alter.__name__, claims, text, alter, tuple(traps), model, address)

    return declare


# --- ways to plant a fault -----------------------------------------------------------------------


def wrap(patch: MonkeyPatch, owner: Any, name: str, make: Callable[[Any_], Any_]) -> None:
    """Replace `owner.name` by what `make` builds around it."""
    patch.setattr(owner, name, make(getattr(owner, name)))


def everywhere(patch: MonkeyPatch, function: Any_, instead: Any_) -> None:
    """Replace a function in every module of the twins that has it under its name."""
    name = getattr(function, "__name__", "")
    places = [
        module
        for path, module in list(sys.modules.items())
        if path.startswith("axistwin.") and vars(module).get(name) is function
    ]
    assert places, f"nobody uses {name}"
    for module in places:
        patch.setattr(module, name, instead)


def on(patch: MonkeyPatch, indices: int | Sequence[int], act: Any_) -> None:
    """Let command(s) do `act(go, axis, now, parameters)` instead; `go(parameters)` is the command
    as it should be.  Acceptance by state is within `go`."""
    chosen = (indices,) if isinstance(indices, int) else tuple(indices)
    is_locked = Axis.is_locked

    def make(execute: Any_) -> Any_:
        def executing(axis: Axis, now: int, index: int, parameters: int, start_ns: int) -> bool:
            if index not in chosen:
                return bool(execute(axis, now, index, parameters, start_ns))

            def go(changed: int | None = None, *, later_ns: int = 0) -> bool:
                number = parameters if changed is None else changed & 0xFFFFFFFF
                if is_locked(axis, index, number):
                    return False
                return bool(execute(axis, now, index, number, start_ns + later_ns))

            return bool(act(go, axis, now, parameters))

        return executing

    wrap(patch, Axis, "execute", make)
    # The command is handed on whatever the state says, so that `act` may do it all the same.
    wrap(
        patch,
        Axis,
        "is_locked",
        lambda locked: (
            lambda axis, index, number: index not in chosen and locked(axis, index, number)
        ),
    )


def cells(
    patch: MonkeyPatch, indices: int | Sequence[int], states: Sequence[State], letter: str
) -> None:
    """Write `letter` (A accepted, R refused) into cells of the acceptance table."""
    chosen = (indices,) if isinstance(indices, int) else tuple(indices)
    table = acceptance_table

    def altered(quirks: Any) -> dict[State, tuple[str, ...]]:
        return {
            state: tuple(
                letter if state in states and index in chosen else cell
                for index, cell in enumerate(column)
            )
            for state, column in table(quirks).items()
        }

    patch.setattr(axis_module, "acceptance_table", altered)


def answers(patch: MonkeyPatch, indices: int | Sequence[int], change: Any_) -> None:
    """Let queries 20h..27h answer `change(value, axis, now)`."""
    chosen = (indices,) if isinstance(indices, int) else tuple(indices)

    def make(query: Any_) -> Any_:
        def answering(axis: Axis, now: int, index: int) -> int:
            value = query(axis, now, index)
            return int(change(value, axis, now)) & 0xFFFFFFFF if index in chosen else int(value)

        return answering

    wrap(patch, Axis, "query", make)


def replies(patch: MonkeyPatch, change: Any_) -> None:
    """Let the module send `change(data, module)` instead of each reply."""

    def make(transmit: Any_) -> Any_:
        return lambda module, data: transmit(module, change(data, module))

    wrap(patch, MacSerial, "_transmit", make)


def frames(patch: MonkeyPatch, act: Any_) -> None:
    """Let the module judge each frame by `act(judge, module, frame, request)`; `judge(frame)` is
    the judgement as it should be."""

    def make(judge: Any_) -> Any_:
        def judging(module: MacSerial, frame: bytes, request: Any) -> None:
            act(lambda f=frame, r=request: judge(module, f, r), module, frame, request)

        return judging

    wrap(patch, MacSerial, "_judge", make)


def setter(patch: MonkeyPatch, index: int, change: Any_) -> None:
    """Let a parameter command store `change(number)` of its four bytes."""
    take, apply = axis_module._PARAMETERS[index]

    def taking(parameters: Parameters, number: int) -> bool:
        return take(parameters, change(number))

    patch.setitem(axis_module._PARAMETERS, index, (taking, apply))


def motion_of(drive: Drive) -> RampedMotion | None:
    """The ramped motion that has the shaft; None if something else has."""
    motion = getattr(drive._control, "motion", None)
    assert motion is None or isinstance(motion, RampedMotion)
    return motion


def target_of(drive: Drive) -> int | None:
    """The number that a move is on its way to; None if no move has the shaft."""
    number = getattr(drive._control, "number", None)
    assert number is None or isinstance(number, int)
    return number
