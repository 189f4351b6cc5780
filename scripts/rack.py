"""Starts two lines with a MAC23 at 0 and a MAC34 at 5 on each, judges both over their ptys at once.

On the first line the MAC23 is judged, on the second the MAC34; what each says about the other stays
out of it.  The verdicts are printed one after the other, whole.  Used by ``scripts/run``; ends with
status 0 when every twin conforms.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import IO

DEVICES = {"mac23": 0, "mac34-1": 5}
LINES = {"mac23": "./mac", "mac34-1": "./mac34"}  # model judged there → its port
ENDING_S = 20.0  # a judgement that is broken off stops the axis and puts everything back first
INTERRUPTED = 130


class Ended(BaseException):
    """SIGTERM; no Exception, so that nobody takes it for a mistake."""


@dataclass(slots=True)
class Judgement:
    """A judgement that runs; what it prints waits in a file until it is its turn."""

    model: str
    command: list[str]
    process: subprocess.Popen[str]
    said: IO[str]


@contextlib.contextmanager
def line_of_twins(link: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a daemon until the block ends; yields when every device has said that it is ready.

    What it remarks goes into a log: while it is judged, clients talk at wrong rates on purpose.
    """
    devices = [f"{model}:{address}" for model, address in DEVICES.items()]
    command = [sys.executable, "-m", "axistwin", "run", *devices]
    command += ["--pty", link, "--state", str(folder / "state"), "--json"]
    folder.mkdir()
    log = folder / "log"
    with (
        log.open("w") as remarks,
        # A process group of its own: Ctrl-C must not take the line from under a judgement.
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=remarks, text=True, process_group=0
        ) as daemon,
    ):
        try:
            assert daemon.stdout is not None
            for _ in devices:
                event = json.loads(daemon.stdout.readline() or "{}")
                if event.get("event") != "ready":
                    told = f"{log.read_text()}run: the twins at {link} did not start"
                    raise SystemExit(told)
                print(f"ready {event['device']} on {event['url']}", flush=True)
            yield daemon
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.wait(ENDING_S)


def judge(model: str, link: str, said: IO[str] | None) -> tuple[list[str], subprocess.Popen[str]]:
    """Start to judge the twin of ``model`` over ``link``; it prints into ``said``, or at once."""
    others = [address for other, address in DEVICES.items() if other != model]
    command = [sys.executable, "-m", "axistwin", "conform", model, "--port", link]
    command += ["--address", str(DEVICES[model]), "--allow", "motion,stored", "--level", "quick"]
    for other in others:
        command += ["--neighbour", str(other)]
    return command, subprocess.Popen(
        command, stdout=said, stderr=said and subprocess.STDOUT, text=True, process_group=0
    )


def judge_all() -> int:
    """Judge every twin, all at the same time; the worst exit status.

    The first one is followed while it goes; the others are printed when they are done.
    """
    with contextlib.ExitStack() as stack:
        running: list[Judgement] = []
        for model, link in LINES.items():
            said = stack.enter_context(tempfile.TemporaryFile("w+"))
            command, process = judge(model, link, said if running else None)
            stack.callback(_end, process)
            running.append(Judgement(model, command, process, said))
        print(f"\njudging {' and '.join(LINES)} at the same time", flush=True)
        for number, one in enumerate(running):
            print(f"\n$ axistwin {' '.join(one.command[3:])}", flush=True)
            one.process.wait()
            if number:
                one.said.seek(0)
                print(one.said.read(), end="", flush=True)
        return max(one.process.returncode for one in running)


def _end(process: subprocess.Popen[str]) -> None:
    """Break off what still runs, as Ctrl-C does: it makes its axis safe and says so."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        process.wait(ENDING_S)


def _terminated(number: int, frame: FrameType | None) -> None:
    raise Ended


def run(*, is_once: bool) -> int:
    """Start the lines, judge, and stay until somebody ends it; the exit status."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="axistwin-")))
        daemons = [
            stack.enter_context(line_of_twins(link, folder / model))
            for model, link in LINES.items()
        ]
        status = judge_all()
        told = "all conform" if status == 0 else f"status {status}"
        print(f"\n{len(LINES)} twins judged: {told}", flush=True)
        if not is_once:
            where = ", ".join(f"{link} ({Path(link).resolve()})" for link in LINES.values())
            print(f"The lines stay open at {where}; Ctrl-C ends them.", flush=True)
            with contextlib.suppress(KeyboardInterrupt, Ended):
                for daemon in daemons:
                    daemon.wait()
        return status


def main() -> int:
    """Parse the arguments and run."""
    parser = argparse.ArgumentParser(description=__doc__, prog="scripts/run")
    parser.add_argument("--once", action="store_true", help="exit when the verdicts are printed")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, _terminated)
    try:
        return run(is_once=arguments.once)
    except (KeyboardInterrupt, Ended):
        print("\nended before all verdicts were there", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    raise SystemExit(main())
