"""Rows of a sweep in a file, one line each, so that it goes on where it was ended; and the runs,
each in a process of its own that cannot take for ever."""

from __future__ import annotations

import json
import os
import resource
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from sweeping.runs import Row

PAUSE_S = 0.05


class Journal:
    """The rows of one sweep by their number; `path` need not exist yet."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[int, Row] = {}
        if path.exists():
            for line in path.read_text("utf-8").splitlines():
                row = json.loads(line)
                self.rows[row["number"]] = row

    def add(self, row: Row) -> None:
        """Keep a row, at once."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        self.rows[row["number"]] = row


def run_all(
    numbers: Sequence[int],
    judge: Callable[[int], Row],
    keep: Callable[[Row], None],
    *,
    jobs: int,
    limit_s: float,
) -> None:
    """Judge every number in a process of its own, `jobs` at a time.

    `limit_s`: of processor time; who takes twice as much is ended by the system.
    """
    waiting = list(numbers)
    at_work: dict[Child, int] = {}
    while waiting or at_work:
        while waiting and len(at_work) < jobs:
            number = waiting.pop(0)
            at_work[_begin(number, judge, limit_s)] = number
        ended = [child for child in at_work if _is_over(child)]
        for child in ended:
            number = at_work.pop(child)
            keep({"number": number, **_result(child)})
        if not ended:
            time.sleep(PAUSE_S)


Child = tuple[int, Path]


def _begin(number: int, judge: Callable[[int], Row], limit_s: float) -> Child:
    place = Path(os.environ.get("TMPDIR", "/tmp")) / f"sweep-{os.getpid()}-{number}.json"
    child = os.fork()
    if child:
        return child, place
    try:
        most = int(2 * limit_s) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (most, most))
        row = judge(number)
    except BaseException:
        row = {"hang": "", "errors": [traceback.format_exc()]}
    place.write_text(json.dumps(row), "utf-8")
    os._exit(0)


def _is_over(child: Child) -> bool:
    return os.waitpid(child[0], os.WNOHANG)[0] != 0


def _result(child: Child) -> Row:
    try:
        row: Row = json.loads(child[1].read_text("utf-8"))
        child[1].unlink()
    except OSError:
        return {"hang": "ended by the system, at twice the processor time", "errors": []}
    return row
