"""The axis' faults, which the zoo of the serial line plants, as the bus shows them.

A mutant of the axis, or of the module between axis and face, is the same mutant here: its claims
are those that the CAN ledger covers, by its own names.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import ModuleType
from typing import Any

from zoo import ZOO as SERIAL_ZOO
from zoo.mutant import MonkeyPatch, Mutant

from axistwin.devices.mac.serial import device as serial
from axistwin.devices.mac.serial import framing
from axistwin.runtime import network
from axistwin_conformance.base.ledger import load_ledger

LINE_MODULES = (serial, framing, network)
# Of the axis, and no fault of a module on a bus.
NOT_ON_THE_BUS = {
    "a_factory_reset_keeps_the_rate": "there is no rate",
    "arming_is_for_good": "a reading of it (MACC-AMB-31)",
}
# What the bus shows of a claim is another requirement's affair.
NOT_CLAIMED = {
    "a_refused_move_ends_the_running_one": ("MACC-CMD-13-01",),  # MACC-SDO-12
}
# Traps of the serial ledger (§8) that the CAN ledger has under another number.
TRAPS = {
    8: 23, 13: 22, 16: 24, 18: 25, 19: 28, 21: 31, 22: 32, 23: 12, 24: 26, 25: 27, 27: 34, 31: 30,
    34: 33,
}  # fmt: skip


def _held(module: ModuleType) -> Iterator[tuple[str, object]]:
    """What a module, its classes and its tables hold, each with its name."""
    for name, value in list(vars(module).items()):
        yield name, value
        inside: Any = vars(value) if isinstance(value, type) else value
        if isinstance(inside, dict) or isinstance(value, type):
            for key, item in list(inside.items()):
                yield f"{name} {key!r}", item


def alters_the_line(mutant: Mutant) -> bool:
    """True if what it alters is of the serial face, or of the line."""
    before = {(module, name): value for module in LINE_MODULES for name, value in _held(module)}
    with MonkeyPatch.context() as patch:
        mutant.alter(patch)
        return any(
            before.get((module, name)) is not value
            for module in LINE_MODULES
            for name, value in _held(module)
        )


def _on_the_bus(mutant: Mutant) -> Mutant:
    left_out = NOT_CLAIMED.get(mutant.name, ())
    claims = tuple(one for one in load_ledger("mac_can").own(mutant.claims) if one not in left_out)
    traps = tuple(TRAPS[trap] for trap in mutant.traps if trap in TRAPS)
    return replace(mutant, claims=claims, traps=traps, model="mac23-can")


def axis_mutants() -> tuple[Mutant, ...]:
    """The mutants of the serial zoo that a MAC23 on CAN can be as well."""
    found = (
        _on_the_bus(mutant)
        for mutant in SERIAL_ZOO
        if mutant.model == "mac23"
        and mutant.name not in NOT_ON_THE_BUS
        and not alters_the_line(mutant)
    )
    return tuple(mutant for mutant in found if mutant.claims)
