"""Every device family that the suite knows."""

from __future__ import annotations

import difflib
import importlib
from functools import cache
from pathlib import Path

from axistwin_conformance import families as packages
from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.settings import FamilyOption


def _modules(name: str) -> list[str]:
    """The modules of that name in the folders of families, sorted; nothing is imported."""
    found = set()
    for folder in map(Path, packages.__path__):
        for path in (*folder.glob(f"*/{name}.py"), *folder.glob(f"*/*/{name}.py")):
            found.add(
                ".".join([packages.__name__, *path.relative_to(folder).with_suffix("").parts])
            )
    return sorted(found)


@cache
def families() -> tuple[Family, ...]:
    """Every family the suite knows: the `FAMILY` of each module `family` below this package, by the
    names of its folders."""
    return tuple(importlib.import_module(name).FAMILY for name in _modules("family"))


@cache
def family_options() -> tuple[FamilyOption, ...]:
    """The options of the command line that belong to families: what the `OPTIONS` of each module
    `options` below this package has declared, in the order of `--help`; once what several share."""
    declared = (importlib.import_module(name).OPTIONS.declared for name in _modules("options"))
    return tuple(sorted({*sum(declared, ())}, key=lambda option: option.order))


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
