"""The program `axistwin` with a planted firmware fault: planted.py ZOO FAULT WORD..."""

from __future__ import annotations

import importlib
import sys
import threading  # noqa: F401 - has the real clock, loaded before the other one takes its place
import time
from importlib.metadata import entry_points
from pathlib import Path


def main(zoo: str, fault: str, *words: str) -> None:
    """Plant the fault, and run the command; exits as it does.

    While a twin is judged, the machine's clock stands still: shrinking has a budget of seconds, and
    how much of it a busy machine uses up must not decide what is found.
    """
    if words[0] == "conform":
        time.monotonic = lambda: 0.0
    sys.path.insert(0, str(Path(__file__).parents[1]))
    (mutant,) = (one for one in importlib.import_module(zoo).ZOO if one.name == fault)
    (program,) = entry_points(group="console_scripts", name="axistwin")
    with mutant.plant():
        program.load()(words)


if __name__ == "__main__":
    main(*sys.argv[1:])
