"""Makes the pictures of the pages; what each shows is told by a function and needs no browser.

``docs/pictures/made-from.txt`` holds the digests of what they were made from, for a test.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from click.testing import CliRunner
from playwright.sync_api import sync_playwright

from axistwin.cli import program
from axistwin.control.panel import read_page
from axistwin_conformance.report import html, plot
from axistwin_conformance.report.json import Report, fold

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
DIGESTS = PICTURES / "made-from.txt"
PANEL_SIZE = (1120, 1000)
TRAFFIC_HEIGHT = 740
JOGGED = ("inputs.run_jog", "inputs.jog_m1_plus", "inputs.jog_m2_minus")
RECORD = ROOT / "conformance" / "tests" / "contracts" / "golden" / "mac23-faulty" / "events.jsonl"
EXAMPLE = ROOT / "fixtures" / "example-project"
CONTOUR_PAGE = ROOT / "docs" / "how-to" / "drive-a-contour.md"
HELIX = "+-1000,0,-2000,0,1,-500,4"

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PAGE_SIZE = (1000, 1000)  # to the end of the first failure's plot
CHARACTER, LINE, MARGIN = 7.3, 17, 14
COLUMNS = 118
HANGING = " " * 16  # below the bytes of an exchange


def report() -> Report:
    """The recorded run of a twin with a planted fault."""
    text = RECORD.read_text(encoding="utf-8")
    for word, shown in {"(version)": "0.1.0", "(time)": "2026-01-01T00:00:00Z"}.items():
        text = text.replace(f'"{word}"', f'"{shown}"')
    return fold(json.loads(line) for line in text.splitlines())


def page() -> str:
    """The page of that run."""
    return html.render(report())


def first_plot() -> str:
    """The first motion that left its band, as a picture of its own."""
    motions = [
        motion
        for check in report()["checks"]
        for motion in check["motions"]
        if not plot.is_inside(motion)
    ]
    drawn = str(plot.plot(motions[0]))
    style = f'<style>{_plot_style()}</style><rect width="100%" height="100%" fill="#fff"/>'
    drawn = re.sub(r"(<svg[^>]*>)", rf"\1{style}", drawn, count=1)
    return (
        drawn
        if "xmlns=" in drawn
        else drawn.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
    )


def _plot_style() -> str:
    """The rules of the page for its plots, by daylight."""
    sheet = (Path(html.__file__).parent / "templates" / "report.css").read_text(encoding="utf-8")
    colours: dict[str, str] = {}
    for name, colour in re.findall(r"--([\w-]+): *(#\w+)", sheet):
        colours.setdefault(name, colour)  # those of the night come later
    rules = re.findall(r"svg [.\w][^{]*\{[^}]*\}", sheet)
    text = re.sub(r"var\(--([\w-]+)\)", lambda found: colours[found[1]], "".join(rules))
    return text.replace("svg ", "")


def failing_test() -> str:
    """What pytest prints of the naive driver, from the assertion on."""
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q", "--no-header"]
    with tempfile.TemporaryDirectory() as folder:
        for file in EXAMPLE.glob("*.py"):
            shutil.copy(file, folder)
        done = subprocess.run(
            [*command, "-k", "naive and virtual"],
            cwd=folder,
            capture_output=True,
            encoding="utf-8",
            check=False,
        )
    rows = done.stdout.splitlines()
    begin = max(number for number, row in enumerate(rows) if row.startswith(">"))
    end = next(number for number, row in enumerate(rows) if "short test summary" in row)
    return "\n".join(re.sub(r"started-\d+", "started-1", row) for row in rows[begin:end] if row)


def as_svg(text: str) -> str:
    """``text`` as a terminal shows it; a long row goes on below, nothing is cut."""
    rows = [
        part
        for row in text.splitlines()
        for part in textwrap.wrap(row, COLUMNS, subsequent_indent=HANGING, break_on_hyphens=False)
    ]
    width = round(COLUMNS * CHARACTER) + 2 * MARGIN
    height = len(rows) * LINE + 2 * MARGIN
    body = "\n".join(_svg_rows(rows))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">\n'
        "<style>text{font:12px monospace;white-space:pre;fill:#ddd}.bad{fill:#f77}.done{fill:#fd7}"
        "</style>\n"
        f'<rect width="{width}" height="{height}" rx="6" fill="#1d1f21"/>\n{body}\n</svg>\n'
    )


def _svg_rows(rows: list[str]) -> Iterator[str]:
    for number, row in enumerate(rows):
        kind = "bad" if row.startswith(("E ", ">")) else "done" if " ms * " in row else ""
        top = MARGIN + (number + 1) * LINE - 5
        yield (
            f'<text x="{MARGIN}" y="{top}" class="{kind}" xml:space="preserve">{escape(row)}</text>'
        )


def motion(name: str, *words: str) -> str:
    """What ``axistwin plot mn400`` draws of some commands."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "motion.svg")
        command = ["plot", "mn400", "--title", name, "-o", str(target), "--", *words]
        done = CliRunner().invoke(program.main, command)
        assert done.exit_code == 0, done.output
        return target.read_text(encoding="utf-8")


def circle() -> list[str]:
    """The contour of the page on contours, from its own lines."""
    (block,) = re.findall(
        r"```python\n(.*?)```", CONTOUR_PAGE.read_text(encoding="utf-8"), re.DOTALL
    )
    head = textwrap.dedent("".join(re.findall(r"^    (?:angles|corners|moves) =.*\n", block, re.M)))
    names: dict[str, Any] = {"math": math, "itertools": itertools}
    exec(head, names)
    moves: list[str] = names["moves"]
    return ["V3000", "(200", *moves, ")"]


def photograph(text: str, target: Path) -> None:
    """The beginning of the page ``text``, as a browser shows it."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"pictures: no browser found ({', '.join(BROWSERS)}); apt-get install chromium")
    width, height = PAGE_SIZE
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "page.html")
        source.write_text(text, encoding="utf-8")
        subprocess.run(
            [
                browser,
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--hide-scrollbars",
                f"--user-data-dir={folder}/profile",
                f"--window-size={width},{height}",
                f"--screenshot={target}",
                source.as_uri(),
            ],
            check=True,
            capture_output=True,
        )


def photograph_panel(target: Path, traffic: Path) -> None:
    """A board that is jogged, and meets a limit, as the panel of a daemon shows it; and ``traffic``
    with a program that works it.
    """
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    width, height = PANEL_SIZE
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        command = ["run", "mn400", "--pty", "mn400", "--control", "127.0.0.1:0", "--json"]
        with subprocess.Popen(
            [sys.executable, "-m", "axistwin", *command],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        ) as daemon:
            assert daemon.stdout is not None
            ready = json.loads(daemon.stdout.readline())
            shown = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
            page = shown.new_page(viewport={"width": width, "height": height})
            page.goto(f"{ready['control']}/#/device/{ready['device']}")
            for control in (*JOGGED, "inputs.m1_plus"):
                page.locator(f"[data-control='{control}']").click()
                page.wait_for_timeout(1500)
            page.evaluate("scrollTo(0, 0)")
            page.screenshot(path=target)
            send = [sys.executable, "-m", "axistwin", "send", "mn400"]
            for text in ("?", "V2000", "M400,-150", "E", "S", "M0,900", "N"):
                subprocess.run([*send, text], cwd=folder, check=True, stdout=subprocess.DEVNULL)
            page.set_viewport_size({"width": width, "height": TRAFFIC_HEIGHT})
            page.goto(f"{ready['control']}/#/line/{ready['device']}")
            page.get_by_label("Search").fill("LimitStatus")
            page.locator(".message.device").first.wait_for()
            page.get_by_role("button", name="Next").click()
            page.wait_for_timeout(500)
            page.screenshot(path=traffic)
            shown.close()
            daemon.terminate()


def contents() -> dict[str, str]:
    """What each picture is made from."""
    return {
        "contour.svg": motion("A circle of 120 segments", *circle()),
        "helix.svg": motion("A helix: + -1000,0,-2000,0,1,-500,4", "V2000", HELIX),
        "failing-page.png": page(),
        "failing-test.svg": as_svg(failing_test()),
        "panel.png": "".join(map(str, sorted(read_page().items()))),
        "plot.svg": first_plot(),
        "traffic.png": "".join(map(str, sorted(read_page().items()))),
    }


def digests(made_from: dict[str, str]) -> str:
    """One line for each."""
    return "".join(
        f"{hashlib.sha256(text.encode()).hexdigest()}  {name}\n"
        for name, text in sorted(made_from.items())
    )


def main() -> None:
    """Make them all."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    made_from = contents()
    photograph(made_from["failing-page.png"], PICTURES / "failing-page.png")
    photograph_panel(PICTURES / "panel.png", PICTURES / "traffic.png")
    for name, text in made_from.items():
        if name.endswith(".svg"):
            (PICTURES / name).write_text(text, encoding="utf-8")
    DIGESTS.write_text(digests(made_from), encoding="utf-8")


if __name__ == "__main__":
    main()
