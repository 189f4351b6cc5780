"""Which requirements are armed: proven able to fail, by a planted firmware fault they have caught.

`armed.toml` beside a family's checks is written by the run over the mutants and holds a table
`[armed]` of requirement = [names of mutants that a check naming the requirement has killed].
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
    path = family_folder(family) / "armed.toml"
    if not path.is_file():
        return None
    return parse_armed(path.read_text(encoding="utf-8"))


def parse_armed(text: str) -> Mapping[str, tuple[str, ...]]:
    """Read the table from TOML text; raises ValueError naming what is wrong with it."""
    table = tomllib.loads(text).get("armed")
    if not isinstance(table, dict):
        raise ValueError("armed.toml: there is no table [armed]")
    for key, names in table.items():
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ValueError(f"armed.toml: {key} is not a list of names")
    return {key: tuple(names) for key, names in table.items()}
