"""Every device family that the suite knows."""

from __future__ import annotations

import difflib
import importlib

from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.core.family import Family

FAMILY_PACKAGES = (
    "axistwin_conformance.mac_serial",
    "axistwin_conformance.mac_can",
    "axistwin_conformance.msc",
)


def families() -> tuple[Family, ...]:
    """Return every family the suite knows, each the `FAMILY` of its package."""
    return tuple(importlib.import_module(f"{name}.family").FAMILY for name in FAMILY_PACKAGES)


def find_family(model: str) -> Family:
    """Return the family of a model; raises UsageError with the nearest name for an unknown one."""
    known: dict[str, Family] = {name: family for family in families() for name in family.models}
    if model in known:
        return known[model]
    name, colon, address = model.partition(":")
    if colon and name in known:
        raise UsageError(f"{model}: the address is an option here: {name} --address {address}")
    near = difflib.get_close_matches(model, known, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise UsageError(f"unknown model {model!r}: {hint}Known: {', '.join(sorted(known))}.")
