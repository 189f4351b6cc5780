"""Judges the mutant zoo of a family and writes its armed.toml: requirement → mutants its checks
have killed."""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "conformance" / "tests"))

from zoo import armed_by  # noqa: E402
from zoo.judge import kills  # noqa: E402
from zoo.mutant import Mutant  # noqa: E402

from axistwin_conformance.base.ledger import family_folder, load_ledger  # noqa: E402

# Family → package of its mutants.
ZOOS = {"mac_serial": "zoo", "mac_can": "zoo_can", "msc": "zoo_msc", "mn400": "zoo_mn400"}
HEAD = """\
# Written by scripts/zoo: which requirements are armed, that is, which planted firmware faults the
# checks of each have found.  Do not edit.

[armed]
"""


def as_toml(armed: Mapping[str, tuple[str, ...]]) -> str:
    """The table as it is shipped."""
    rows = (
        f"{claim} = [\n" + "".join(f'    "{name}",\n' for name in names) + "]\n"
        for claim, names in armed.items()
    )
    return HEAD + "".join(rows)


def judged(mutants: tuple[Mutant, ...]) -> list[str]:
    """Judge all mutants; return a line for each that has survived on a claim."""
    survivors = []
    for number, mutant in enumerate(mutants, 1):
        started = time.monotonic()
        missing = set(mutant.claims) - set(kills(mutant))
        seconds = time.monotonic() - started
        word = "SURVIVES" if missing else "killed"
        told = f" on {', '.join(sorted(missing))}" if missing else ""
        print(f"{number:3}/{len(mutants)} {word:8} {mutant.name}{told} ({seconds:.1f} s)")
        if missing:
            survivors.append(f"{mutant.name}{told}: {mutant.description}")
    return survivors


def summary(family: str, armed: Mapping[str, tuple[str, ...]]) -> str:
    """How much of the ledger is armed."""
    ledger = load_ledger(family)
    parts = []
    for kind in ("must", "derived", "interpretation"):
        visible = [
            one.id
            for one in ledger.requirements.values()
            if one.kind == kind and not one.not_on_wire
        ]
        bare = [name for name in visible if name not in armed]
        told = f"; not: {', '.join(bare)}" if bare else ""
        parts.append(f"{kind}: {len(visible) - len(bare)} of {len(visible)} armed{told}")
    return "\n".join(parts)


def main() -> int:
    """Judge, tell, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "names",
        nargs="*",
        metavar="[FAMILY] [MUTANT]...",
        help=f"family: {' or '.join(ZOOS)} (the first one if none is named); mutants: only these,"
        " and then nothing is written",
    )
    words = parser.parse_args().names
    family = words.pop(0) if words and words[0] in ZOOS else next(iter(ZOOS))
    names = set(words)
    zoo: tuple[Mutant, ...] = importlib.import_module(ZOOS[family]).ZOO
    unknown = names - {mutant.name for mutant in zoo}
    if unknown:
        parser.error(f"no mutant of {family} is named {', '.join(sorted(unknown))}")
    chosen = tuple(mutant for mutant in zoo if not names or mutant.name in names)
    survivors = judged(chosen)
    print(f"{len(chosen) - len(survivors)} of {len(chosen)} killed")
    for line in survivors:
        print(f"  {line}", file=sys.stderr)
    if survivors or names:
        return int(bool(survivors))
    path, armed = Path(str(family_folder(family) / "armed.toml")), armed_by(zoo)
    path.write_text(as_toml(armed), encoding="utf-8")
    print(f"{path.relative_to(ROOT)} written\n{summary(family, armed)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
