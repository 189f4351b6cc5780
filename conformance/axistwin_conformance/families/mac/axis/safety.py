"""Which command of an axis may do what: the safety classes, for guards, budgets and `--dry-run`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.exchanges import COMMAND_NAMES
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS

_CLASS_OF: Final[Mapping[str, tuple[int, ...]]] = {
    "stored": tuple(PARAMETERS),
    "motion": (0x00, 0x10, 0x13, 0x14, 0x15, 0x16, 0x17, 0x18, 0x19, 0x1A, 0x1E),
    "destructive": (0x01, 0x08, 0x1B),
}


def _named(indices: Iterable[int]) -> str:
    return ", ".join(f"{COMMAND_NAMES[index]} ({index:02X}h)" for index in indices)


STORING: Final = frozenset(_CLASS_OF["stored"] + _CLASS_OF["destructive"])
SAFETY_OF: Final = {index: name for name, indices in _CLASS_OF.items() for index in indices}


_IMPACT_OF: Final[Mapping[str, str]] = {
    "passive": "queries, and frames that a module refuses, Nacks or takes no notice of",
    "motion": "moves, stops, powers and re-initialises",
    "stored": "writes",
    "destructive": "factory values over all parameters",
}


def impact_of_axis(others: str, left_out: frozenset[int] = frozenset()) -> Mapping[str, str]:
    """Safety class → what its checks do to a device, in words.

    `others`: what the destructive ones change beside the parameters; `left_out`: the commands that
    this face of the module does not have.
    """
    described = {
        "rig": "inputs, supply, temperature and shaft are worked, the supply is cut",
        "end": "stop the axis or put its parameters back",
    }
    for name, words in _IMPACT_OF.items():
        words = f"{words}, {others}" if name == "destructive" else words
        named = _named(index for index in _CLASS_OF.get(name, ()) if index not in left_out)
        described[name] = f"{words}: {named}" if named else words
    return described


def objection(session: Session, indices: Iterable[int]) -> str | None:
    """Why these commands must not be sent now: one is of a class that the check did not declare."""
    if session.check is None:
        return None
    for index in indices:
        needed = SAFETY_OF.get(index, "passive")
        if needed == "passive" or needed in session.check.safety:
            continue
        if needed != "destructive" and "destructive" in session.check.safety:
            continue
        assert needed in SAFETY_CLASSES
        return f"{index:02X}h is {needed}, which this check does not declare"
    return None
