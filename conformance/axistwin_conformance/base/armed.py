"""Two tables beside a family's checks that programs write.

`armed.toml`, by the run over the mutants: which requirements are armed, that is, proven able to
fail by a planted firmware fault.  Requirement = [mutants that a check naming it has killed].

`reads.toml`, by runs that watch: on which readings of the manual a check or a probe depends.
Name = [switches that it looks up].
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache

from axistwin_conformance.base.ledger import family_folder


@cache
def load_armed(family: str) -> Mapping[str, tuple[str, ...]] | None:
    """Return requirement → mutants killed; None if nobody has tried.  Raises ValueError for a file
    that holds something else."""
    return _load(family, "armed")


@cache
def load_reads(family: str) -> Mapping[str, tuple[str, ...]]:
    """Return check or probe → the switches whose readings it looks up; empty if nobody has recorded
    it.  Raises ValueError for a file that holds something else."""
    return _load(family, "reads") or {}


def _load(family: str, name: str) -> Mapping[str, tuple[str, ...]] | None:
    path = family_folder(family) / f"{name}.toml"
    return parse_table(path.read_text(encoding="utf-8"), name) if path.is_file() else None


def parse_table(text: str, name: str) -> Mapping[str, tuple[str, ...]]:
    """Read the table of that name from TOML; raises ValueError naming what is wrong with it."""
    table = tomllib.loads(text).get(name)
    if not isinstance(table, dict):
        raise ValueError(f"{name}.toml: there is no table [{name}]")
    for key, names in table.items():
        if not isinstance(names, list) or not all(isinstance(one, str) for one in names):
            raise ValueError(f"{name}.toml: {key} is not a list of names")
    return {key: tuple(names) for key, names in table.items()}
