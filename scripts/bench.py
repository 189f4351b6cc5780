"""Measures the twins beside a bare echo, on the same transport, in one run.

The echo sends back what it gets, as much as the twin answers.  The twin runs without pacing and
without latencies of its own (``--no-pacing --quirk reply_latency_us=0``), so that what is compared
is the program, not the emulated line or bus.  Slices of both alternate, so a noisy machine hits
both alike; quote the ratios, not the rates.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

from scripts import bench_can, bench_mn400, bench_msc, bench_panel, bench_rack, bench_ratios
from scripts.bench_line import (
    ECHO_PTY,
    Dialogue,
    Twin,
    compare,
    compare_in_process,
    pty_client,
    transports,
)
from scripts.bench_tools import child, ready_url

import axistwin as _axistwin

QUERY = b"\x0201400200000000000A2\x03"  # 20h (position) to module 0
ANSWER = b"\x06\x13\x020110000000000010\x03\x1a"  # at 0
MAC = Twin("mac23:0", ("reply_latency_us=0",), 38400)
DIALOGUE = Dialogue(QUERY, ANSWER)


def first_answer(folder: str) -> tuple[float, float]:
    """Seconds from starting the daemon to its ready line and to its first answer."""
    link = str(Path(folder) / "first")
    begin = time.perf_counter()
    with child(*MAC.command("--pty", link)) as (_, line):
        ready = time.perf_counter() - begin
        with pty_client(ready_url(line), DIALOGUE, MAC.speed) as exchange:
            exchange()
            return ready, time.perf_counter() - begin


def bare_start() -> float:
    """Seconds from starting a bare echo to its first line."""
    begin = time.perf_counter()
    with child(sys.executable, "-c", ECHO_PTY):
        return time.perf_counter() - begin


def compare_start(folder: str, runs: int = 7) -> None:
    """Start-up of the daemon beside the echo's, taken in turn."""
    bare: list[float] = []
    ours: list[tuple[float, float]] = []
    for _ in range(runs):
        bare.append(bare_start())
        ours.append(first_answer(folder))
    ready, answer = (statistics.median(column) * 1e3 for column in zip(*ours, strict=True))
    echo = statistics.median(bare) * 1e3
    print("\nstart-up (medians of 7)")
    print(f"  bare asyncio echo   ready {echo:6.0f} ms")
    timing = f"ready {ready:6.0f} ms   first answer {answer:6.0f} ms"
    print(f"  mac23 twin          {timing}   {answer / echo:.2f} x echo")


def compare_serial(folder: str, seconds: float) -> None:
    """All comparisons on a serial line."""
    dialogues = {"position": DIALOGUE}
    for way in transports(folder):
        compare("serial", way, MAC, dialogues, seconds)
    compare_in_process("serial", "axistwin://mac23:0?time=virtual", MAC, dialogues, seconds)
    compare_start(folder)


CARRIERS = {
    "serial": compare_serial,
    "can": bench_can.compare_can,
    "msc": bench_msc.compare_msc,
    "mn400": bench_mn400.compare_mn400,
    "rack": bench_rack.measure_rack,
    "panel": bench_panel.measure_panel,
    "ratios": bench_ratios.compare_ratios,
}


def main() -> None:
    """Run the comparisons."""
    parser = argparse.ArgumentParser(description=__doc__, prog="scripts/bench")
    parser.add_argument(
        "carriers",
        nargs="*",
        metavar="serial|can|msc|mn400|rack|panel|ratios",
        help="which (default: all)",
    )
    parser.add_argument("--seconds", type=float, default=1.0, help="length of a slice (default 1)")
    options = parser.parse_args()
    for name in options.carriers:
        if name not in CARRIERS:
            parser.error(f"{name!r} is not measured; known: {', '.join(CARRIERS)}")
    print(
        f"axistwin {_axistwin.__version__}, Python {sys.version.split()[0]}, {os.cpu_count()} cores"
    )
    with tempfile.TemporaryDirectory(prefix="axistwin-bench-") as folder:
        for name in options.carriers or CARRIERS:
            CARRIERS[name](folder, options.seconds)


if __name__ == "__main__":
    main()
