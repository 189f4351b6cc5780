"""Judges drawn motions of the MN400 twin: moves, arcs, helices and contours, in virtual time.

Each is run with pauses, turns of the pot and plans made anew, and once more mirrored.  The end has
to be exact, no step lost, and speed, acceleration and margin kept.  A motion is drawn from the seed
and its number, and with both it is the same again.

With ``--sequences`` they come one after the other on a board, as commands: settings change between
them, and pauses, holds and Q come wherever they are.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "emulators" / "tests" / "support"))

from mn400_journeys import drawn  # noqa: E402
from mn400_sequences import drawn_sequence, judge_sequence  # noqa: E402
from mn400_travel_rules import judge  # noqa: E402

SHOWN_MAX = 10


def main() -> int:
    """Judge them; the exit status is 1 if any broke a rule."""
    parser = argparse.ArgumentParser(description=__doc__, prog="scripts/sweep_motions")
    parser.add_argument("--sequences", action="store_true", help="of motions, not single ones")
    parser.add_argument("--number", type=int, default=1000, help="of motions (default 1000)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first (default 0)")
    parser.add_argument("--only", type=int, action="append", help="that motion alone")
    options = parser.parse_args()
    judge_one = judge_drawn_sequence if options.sequences else judge_drawn
    kinds: Counter[str] = Counter()
    judged = wrong = 0
    begun = time.process_time()
    with contextlib.suppress(KeyboardInterrupt):  # then it tells what was judged
        for number in options.only or range(options.first, options.first + options.number):
            judged += 1
            try:
                judge_one(options.seed, number, kinds)
            except AssertionError as failure:
                wrong += 1
                if wrong <= SHOWN_MAX:
                    print(f"--seed {options.seed} --only {number}: {failure}", flush=True)
    used_s = time.process_time() - begun
    counted = ", ".join(f"{count} {name}" for name, count in sorted(kinds.items()))
    what = "sequences" if options.sequences else "motions"
    print(f"{judged} {what} in {used_s:.0f} s of CPU: {counted}")
    print(f"{wrong} broke a rule")
    return int(wrong > 0)


def judge_drawn(seed: int, number: int, kinds: Counter[str]) -> None:
    """Judge one motion, and count what is done in it."""
    journey = drawn(seed, number)
    kinds[journey.kind] += 1
    kinds.update(change.what for change in journey.changes)
    judge(journey)


def judge_drawn_sequence(seed: int, number: int, kinds: Counter[str]) -> None:
    """Judge one sequence, and count its motions and its commands."""
    sequence = drawn_sequence(seed, number)
    kinds.update(act.what for act in sequence.acts)
    kinds["made"] += judge_sequence(sequence)


if __name__ == "__main__":
    raise SystemExit(main())
