"""Every device family that the suite knows."""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from functools import cache

from axistwin_conformance import families as packages
from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.core.family import Family


@cache
def families() -> tuple[Family, ...]:
    """Every family the suite knows: the `FAMILY` of each module `family` below this package, by the
    names of its folders."""
    found = pkgutil.walk_packages(packages.__path__, f"{packages.__name__}.")
    names = sorted(module.name for module in found if module.name.endswith(".family"))
    return tuple(importlib.import_module(name).FAMILY for name in names)


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
