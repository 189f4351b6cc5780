"""Starts a line with a MAC23 at 0 and a MAC34 at 5, judges both over the pty, prints the verdicts.

Used by ``scripts/run``; ends with status 0 when every twin conforms.
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
from pathlib import Path

LINK = "./mac"
DEVICES = {"mac23": 0, "mac34-1": 5}
READY_TIMEOUT_S = 20.0


@contextlib.contextmanager
def line_of_twins(link: str, state: str) -> Iterator[subprocess.Popen[str]]:
    """Run the daemon until the block ends; yields when every device has said that it is ready."""
    devices = [f"{model}:{address}" for model, address in DEVICES.items()]
    command = [sys.executable, "-m", "axistwin", "run", *devices]
    command += ["--pty", link, "--state", state, "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as daemon:
        try:
            assert daemon.stdout is not None
            for _ in devices:
                event = json.loads(daemon.stdout.readline() or "{}")
                if event.get("event") != "ready":
                    raise SystemExit(f"run: the twins did not start (status {daemon.poll()})")
                print(f"ready {event['device']} on {event['url']}", flush=True)
            yield daemon
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.wait(READY_TIMEOUT_S)


def judge(model: str, link: str) -> int:
    """Judge the twin of ``model`` over ``link``; the conformance program's exit status."""
    address = DEVICES[model]
    others = [a for a in DEVICES.values() if a != address]
    command = [sys.executable, "-m", "axistwin", "conform", model, "--port", link]
    command += ["--address", str(address), "--allow", "motion,stored", "--level", "quick"]
    for other in others:
        command += ["--neighbour", str(other)]
    print(f"\n$ axistwin {' '.join(command[3:])}", flush=True)
    return subprocess.run(command, check=False).returncode


def main() -> int:
    """Parse the arguments, run, judge, and stay or leave."""
    parser = argparse.ArgumentParser(description=__doc__, prog="scripts/run")
    parser.add_argument("--once", action="store_true", help="exit when the verdicts are printed")
    arguments = parser.parse_args()
    with (
        tempfile.TemporaryDirectory(prefix="axistwin-") as state,
        line_of_twins(LINK, state) as daemon,
    ):
        status = max(judge(model, LINK) for model in DEVICES)
        print(
            f"\n{len(DEVICES)} twins judged: "
            + ("all conform" if status == 0 else f"status {status}")
        )
        if not arguments.once:
            where = Path(LINK).resolve()
            print(f"The line stays open at {LINK} ({where}); Ctrl-C ends it.", flush=True)
            with contextlib.suppress(KeyboardInterrupt):
                daemon.wait()
    return status


if __name__ == "__main__":
    raise SystemExit(main())
