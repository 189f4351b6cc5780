"""Records which switches the checks and probes of a family look up, and writes its reads.toml."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "conformance" / "tests"))

from recorded_reads import MODELS, as_toml, recorded  # noqa: E402

from axistwin_conformance.base.ledger import family_folder  # noqa: E402


def main() -> None:
    """Record and write."""
    parser = argparse.ArgumentParser(prog="scripts/reads", description=__doc__)
    parser.add_argument(
        "families", nargs="*", metavar="FAMILY", help=f"{', '.join(MODELS)}; or all"
    )
    for family in parser.parse_args().families or MODELS:
        path = Path(str(family_folder(family))) / "reads.toml"
        path.write_text(as_toml(recorded(MODELS[family])), encoding="utf-8")
        print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
