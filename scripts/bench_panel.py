"""The benchmark of the front panel: twenty boards that move, in a browser without a window.

All axes of all boards move for as long as it takes.  The overview, and the page of a board with
its charts, stay open for ten slices each.  What is told: how often the shown positions change, and
the longest that the page's main thread worked without a pause.  By the clock that is more on a
machine where the browser waits for a core.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import serial
from playwright.sync_api import Page, sync_playwright
from scripts.bench_tools import child

DEVICES = 20
SLICES = 10
MAIN = "CrRendererMain"
TRACED = ["toplevel", "disabled-by-default-devtools.timeline", "__metadata"]
MOVE = b"\x81M1000000000,900000000,800000000,700000000\x81"

COUNT = """
([selector, ms]) => new Promise((resolve) => {
  const seen = document.querySelector(selector);
  let count = 0;
  const observer = new MutationObserver(() => (count += 1));
  observer.observe(seen, { childList: true, characterData: true, subtree: true });
  setTimeout(() => { observer.disconnect(); resolve(count); }, ms);
})
"""


def rack_text(folder: Path) -> str:
    """A line for each board, and the panel."""
    lines = [
        f'[[line]]\nname = "m{n}"\ndevices = "mn400"\npty = "{folder}/m{n}"\n'
        for n in range(DEVICES)
    ]
    head = f'state = "{folder}/memory"\n[control]\naddress = "127.0.0.1:0"\n'
    return "".join([head, *lines])


def measure_panel(folder: str, seconds: float) -> None:
    """Both pages."""
    place = Path(folder)
    (place / "panel.toml").write_text(rack_text(place), encoding="utf-8")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        sys.exit("scripts/bench panel: chromium is missing; apt-get install chromium")
    command = (sys.executable, "-m", "axistwin", "rack", str(place / "panel.toml"), "--json")
    with child(*command) as (process, line):
        for _ in range(DEVICES - 1):
            assert process.stdout is not None
            process.stdout.readline()
        for n in range(DEVICES):
            start(f"{folder}/m{n}")
        print(f"\npanel: {DEVICES} boards, all axes moving")
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
            page = browser.new_page()
            page.goto(json.loads(line)["control"])
            page.wait_for_selector(".card")
            show("overview", page, ".card .value", seconds)
            page.get_by_role("link", name="mn400:1@m0").click()
            page.wait_for_selector("figcaption .value")
            show("page of a board", page, "figcaption .value", seconds)
            browser.close()


def start(pty: str) -> None:
    """Let a board move for days."""
    with serial.Serial(pty, 9600, timeout=2) as port:
        port.write(MOVE + bytes([sum(MOVE) & 0x7F]))
        assert len(port.read(12)) == 12


def show(name: str, page: Page, selector: str, seconds: float) -> None:
    """One line about what is shown at ``selector``."""
    browser = page.context.browser
    assert browser is not None
    browser.start_tracing(page=page, categories=TRACED)
    count = page.evaluate(COUNT, [selector, seconds * SLICES * 1000])
    tasks = main_tasks(json.loads(browser.stop_tracing())["traceEvents"])
    cpu_ms, clock_ms = (max(column) for column in zip(*tasks, strict=True))
    print(
        f"  {name:<16} {count / SLICES / seconds:5.1f} changes/s   "
        f"longest task {cpu_ms:5.1f} ms of CPU, {clock_ms:5.1f} ms by the clock"
    )


def main_tasks(events: list[dict[str, Any]]) -> list[tuple[float, float]]:
    """What the main thread of the page did without a pause: milliseconds of CPU, and by the clock.

    At least one.
    """
    named = (each for each in events if each["name"] == "thread_name")
    mains = [(each["pid"], each["tid"]) for each in named if each["args"]["name"] == MAIN]
    return [
        (each.get("tdur", 0) / 1000, each.get("dur", 0) / 1000)
        for each in events
        if each["name"].endswith("RunTask") and (each["pid"], each["tid"]) in mains
    ]
