"""One run of the suite on a twin that another process runs in real time, over a pty."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

from small_scratch import small_scratch

from axistwin.cli.main import main
from axistwin.cli.program import EXIT_BUG
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.run import Engine
from sweeping.runs import NEIGHBOURS, TRAVEL, Row, Setting, judged_within, told
from sweeping.wrong_device import UNENDING, Tally

PTY = "a pty"
LIMIT_S = 60.0  # until it is there, or gone
TICK_S = 0.01


def judge_over_pty(setting: Setting, seed: int, tally: Tally) -> Row:
    """Judge what is planted in this process, run by a copy of it; `tally` becomes the copy's."""
    with tempfile.TemporaryDirectory() as folder:
        link, notes = Path(folder, "line"), Path(folder, "tally")
        twin = os.fork()
        if not twin:
            _serve(setting.model, link, notes, tally)
        try:
            if not _comes(link):
                return {"hang": "", "errors": ["the twin never listened"]}
            return judged_within(setting, lambda hear: _run(setting, seed, link, hear))
        finally:
            _end(twin)
            seen = json.loads(notes.read_text("utf-8")) if notes.exists() else {"crash": UNENDING}
            for name, value in seen.items():
                setattr(tally, name, value)


def _serve(model: str, link: Path, notes: Path, tally: Tally) -> None:
    """Be `axistwin run` until it is ended."""
    quiet = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(quiet, stream)
    words = ["run", *(f"{model}:{address}" for address in _addresses(model))]
    words += ["--slcan" if model.endswith("-can") else "--pty", str(link)]
    words += ["--program", "bench"] if model.startswith("msc") else []
    try:
        main(words)
    except BaseException as error:
        is_crash = isinstance(error, Exception) or getattr(error, "code", 0) == EXIT_BUG
        tally.crash = tally.crash or (repr(error) if is_crash else "")
    finally:
        try:
            notes.write_text(json.dumps(dataclasses.asdict(tally)), "utf-8")
        finally:  # or the copy would go on with the tests
            os._exit(0)


def _addresses(model: str) -> tuple[int, ...]:
    return (make_options(model=model).address, *NEIGHBOURS.get(model, ()))


def _end(twin: int) -> None:
    """Let it end by itself, if it can."""
    os.kill(twin, signal.SIGTERM)
    until = time.monotonic() + LIMIT_S
    while not (is_over := os.waitpid(twin, os.WNOHANG)[0]) and time.monotonic() < until:
        time.sleep(TICK_S)
    if not is_over:
        os.kill(twin, signal.SIGKILL)
        os.waitpid(twin, 0)


def _comes(link: Path) -> bool:
    until = time.monotonic() + LIMIT_S
    while not link.exists() and time.monotonic() < until:
        time.sleep(TICK_S)
    return link.exists()


def _run(setting: Setting, seed: int, link: Path, hear: Any) -> Row:
    model = setting.model
    choices: dict[str, Any] = {"allow": "motion,stored,destructive", "max_travel": TRAVEL}
    if model.startswith("msc"):
        choices = {"allow": "motion,stored", **small_scratch(model)}
    if beside := NEIGHBOURS.get(model, ()):
        choices["neighbours"] = beside
    choices |= {"can": f"slcan:{link}"} if model.endswith("-can") else {"port": str(link)}
    options = make_options(
        model=model, level=setting.level, seed=seed, exitfirst=setting.is_exitfirst, **choices
    )
    began = time.monotonic()
    result = Engine(options).run(hear)
    return told(result) | {"bench_s": round(time.monotonic() - began), "left": []}
