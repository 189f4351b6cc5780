"""As few variables of a controller as let every check and probe have what it needs: the rest only
takes time, because a run reads all of them before it writes any. And where its bench program is."""

from __future__ import annotations

from typing import Any

from axistwin_conformance.families.catalog import find_family

VARIABLES = range(2000, 2512)  # the manual's examples are at 2008 and 2048
FLAGS = range(128, 192)  # all that the built-in twin has
PROGRAM = (240, 6144)  # `axistwin run --program bench`: its flag and its first address


def small_scratch(model: str) -> dict[str, Any]:
    """What `make_options` is told of a model beside its name; nothing if it has no variables."""
    named = {"variables": VARIABLES, "flags": FLAGS, "bench_program": PROGRAM}
    known = {option.parameter for option in find_family(model).options.declared}
    return named if named.keys() <= known else {}
