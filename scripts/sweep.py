"""Judges many devices that nobody made by hand, and tells which of them are judged wrongly.

quirks: twins of other readings, one or two at once, which must conform.  faults: twins wrong in one
thing, which must not.  The devices are drawn from the seed; every number is the same device again.
Rows go into a file as they come, so that a sweep that was ended goes on with the same command.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "conformance" / "tests"))

from sweeping.journal import Journal, run_all  # noqa: E402
from sweeping.real_runs import PTY  # noqa: E402
from sweeping.runs import INTERFACES, VIRTUAL, Row, Setting  # noqa: E402
from sweeping.sweeps import MODELS, FaultSweep, QuirkSweep, Sweep  # noqa: E402


def parsed_options() -> argparse.Namespace:
    """The options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("sweep", choices=("quirks", "faults"))
    parser.add_argument("models", nargs="*", metavar="MODEL", help=f"of {', '.join(MODELS)}")
    parser.add_argument("--number", type=int, default=40, help="of devices, of each model")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, action="append", help="that device alone, told in full")
    interfaces = (VIRTUAL, *INTERFACES, PTY)  # a pty: in real time, faults only
    parser.add_argument("--interface", choices=interfaces, help="before the twin")
    parser.add_argument("--level", choices=("quick", "full"))
    parser.add_argument("--singles", action="store_true", help="quirks: every switch by itself")
    parser.add_argument("--at-once", type=int, default=0, help="quirks: pools of so many switches")
    parser.add_argument("--exitfirst", action="store_true", help="end a run with the first failure")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--limit", type=float, default=300.0, help="processor time of a run, s")
    parser.add_argument("--folder", type=Path, default=ROOT / "sweeps", help="of the rows")
    options = parser.parse_intermixed_args()
    if unknown := set(options.models) - set(MODELS):
        parser.error(f"no model is named {', '.join(sorted(unknown))}")
    return options


def sweep(options: argparse.Namespace, model: str) -> int:
    """Sweep one model; return how many devices were judged wrongly."""
    is_quirks = options.sweep == "quirks"
    interface = options.interface or (VIRTUAL if is_quirks else "a plain port")
    level = options.level or ("full" if is_quirks else "quick")
    setting = Setting(model, interface, level, options.limit, options.exitfirst)
    words = [options.sweep, model, level, interface.replace(" ", "-"), f"seed-{options.seed}"]
    words += [name for name in ("singles", "exitfirst") if getattr(options, name)]
    words += [f"at-once-{options.at_once}"] if options.at_once else []
    journal = Journal(options.folder / ("_".join(words) + ".jsonl"))
    judge: Sweep
    if is_quirks:
        judge = quirks = QuirkSweep(
            setting, options.seed, is_single=options.singles, at_once=options.at_once
        )
        if 0 not in journal.rows:
            journal.add({"number": 0, **quirks.judge(0)})
        quirks.usual = frozenset(journal.rows[0]["judged"])
    else:
        judge = FaultSweep(setting, options.seed)
    numbers = options.only or range(1, options.number + 1)

    def keep(row: Row) -> None:
        row = {"device": "?", "outcome": "hang", "why": row.get("hang", ""), **row}
        journal.add(row)
        print(f"{model} {row['number']:4} {row['outcome']:13} {row['device']}", flush=True)
        if options.only:
            print("\n".join(f"    {name}: {value}" for name, value in row.items()))

    missing = [one for one in numbers if options.only or one not in journal.rows]
    run_all(missing, judge.judge, keep, jobs=options.jobs, limit_s=options.limit)
    rows = [journal.rows[one] for one in numbers]
    print(f"\n{judge.table(rows)}\n{judge.escapes(rows)}\n")
    return sum(row["outcome"] in judge.wrong for row in rows)


def main() -> int:
    """Sweep; the exit status is 1 if any device was judged wrongly."""
    options = parsed_options()
    with tempfile.TemporaryDirectory() as folder:  # what real ports held is kept for no user
        os.environ["XDG_STATE_HOME"] = folder
        return int(sum(sweep(options, model) for model in options.models or MODELS) > 0)


if __name__ == "__main__":
    raise SystemExit(main())
