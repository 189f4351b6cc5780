"""The benchmark of the front panel: twenty boards that move, in a browser without a window.

All axes of all boards move for as long as it takes.  The overview, and the page of a board with
its charts, stay open for ten slices each.  What is told: how often the shown positions change, and
how long the page's main thread was busy without a pause, where that was more than 50 ms.  On a
machine where browser and rack do not wait for a core, it never is.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import serial
from playwright.sync_api import Page, sync_playwright
from scripts.bench_tools import child

DEVICES = 20
SLICES = 10
MOVE = b"\x81M1000000000,900000000,800000000,700000000\x81"

WATCH = """
() => {
  window.busy = [];
  const note = (list) => window.busy.push(...list.getEntries().map((each) => each.duration));
  new PerformanceObserver(note).observe({ entryTypes: ["longtask"] });
}
"""
COUNT = """
([selector, ms]) => new Promise((resolve) => {
  const seen = document.querySelector(selector);
  const times = [];
  const observer = new MutationObserver(() => times.push(performance.now()));
  observer.observe(seen, { childList: true, characterData: true, subtree: true });
  window.busy.length = 0;
  setTimeout(() => { observer.disconnect(); resolve([times.length, window.busy]); }, ms);
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
    page.evaluate(WATCH)
    count, busy = 0, list[float]()
    for _ in range(SLICES):
        more, tasks = page.evaluate(COUNT, [selector, seconds * 1000])
        count += more
        busy += tasks
    rate = count / SLICES / seconds
    longest = f", longest {max(busy):.0f} ms" if busy else ""
    print(f"  {name:<16} {rate:5.1f} changes/s   over 50 ms: {len(busy)}{longest}")
