"""The page: self-contained, indexed by requirement, one click from a red one to its bytes."""

from __future__ import annotations

import html
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from zoo import ZOO

from axistwin_conformance.cli import conform
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.exchanges import signed
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.codec import SerialReply
from axistwin_conformance.report import json
from axistwin_conformance.report.html import duration, render
from axistwin_conformance.report.json import Report, fold, load

pytestmark = pytest.mark.strength

VOID = {"meta", "input", "br", "circle", "path", "polygon"}
OPTIONAL_END = {"td", "tr"}  # transcripts leave these out: half of a long page would be end tags
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


class Page(HTMLParser):
    """What a test must know of a page: ids with the text below them, links, and every address."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text_of: dict[str, str] = {}
        self.links: list[tuple[str, str, str]] = []  # id of the row, class of the row, target
        self.loads: list[str] = []
        self.headings: list[str] = []
        self.headers: list[tuple[str, dict[str, str]]] = []
        self._open: list[tuple[str, dict[str, str]]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take an opening tag."""
        given = {key: value or "" for key, value in attrs}
        self.loads += [given[key] for key in ("src", "srcset", "data", "poster") if key in given]
        self.loads += [given["href"]] if tag != "a" and "href" in given else []
        if "id" in given:
            assert given["id"] not in self.text_of, f"two parts are called {given['id']}"
            self.text_of[given["id"]] = ""
        if tag == "a":
            row = next((one for name, one in reversed(self._open) if name == "tr"), {})
            self.links.append((row.get("id", ""), row.get("class", ""), given["href"]))
        if tag in ("h1", "h2", "h3", "h4", "h5"):
            self.headings.append(tag)
        if tag == "th":
            self.headers.append((tag, given))
        if tag in OPTIONAL_END:
            self._close_optional(tag)
        if tag not in VOID:
            self._open.append((tag, given))

    def _close_optional(self, tag: str) -> None:
        while self._open and self._open[-1][0] in ({"td"} if tag == "td" else OPTIONAL_END):
            self._open.pop()

    def handle_endtag(self, tag: str) -> None:
        """Take a closing tag; it must close what is open."""
        if tag in VOID:
            return
        while self._open[-1][0] != tag:
            left, _ = self._open.pop()
            assert left in OPTIONAL_END, f"<{left}> is closed by </{tag}>"
        self._open.pop()

    def handle_data(self, data: str) -> None:
        """Take text."""
        for _, given in self._open:
            if "id" in given:
                self.text_of[given["id"]] += data


@pytest.fixture
def report(wrong_run: list[dict[str, Any]]) -> Report:
    """The report of that run."""
    return fold(wrong_run)


@pytest.fixture(scope="module")
def wrong_mac(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run over a MAC23 that counts one increment too many beyond 50."""

    def parse(data: bytes) -> SerialReply:
        reply = sound(data)
        if reply.digit != 0 or reply.data is None or signed(reply.data) <= 50:
            return reply
        return replace(reply, data=reply.data + 7)

    sound, folder = codec.parse, tmp_path_factory.mktemp("wrong") / "report"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(codec, "parse", parse)
        result = CliRunner().invoke(conform, ["mac23", "--report", str(folder), "MACS-CMD-13"])
    assert result.exit_code == 1, result.output
    assert f"report: {folder / 'report.html'}" in result.output
    return folder


def failed(report: Report) -> list[str]:
    """The requirements that failed."""
    return [one["id"] for one in report["requirements"] if one["verdict"] == "fail"]


def assert_one_click_to_the_bytes(text: str, report: Report) -> None:
    """The row of every red requirement links to an article of each check that failed it, with what
    was seen in words, what the manual asks, the bytes that decided, and the command."""
    page = Page(text)
    assert failed(report)
    for key in failed(report):
        targets = {to for row, kind, to in page.links if row == f"row-{key}" and kind == "fail"}
        shown = [page.text_of[to.removeprefix("#")] for to in targets - {f"#{key}"}]
        assert f"#{key}" in targets
        assert shown
        for check, finding in failures(report, key):
            last = finding["transcript"][-1]
            wanted = (finding["sentence"], key, last["data"], last["decoded"], check["replay"])
            assert any(all(part in one for part in wanted) for one in shown), (key, wanted)


def failures(report: Report, key: str) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """The checks that failed a requirement, with what they said."""
    return [
        (check, finding)
        for check in report["checks"]
        for finding in check["findings"]
        if finding["requirement"] == key and finding["verdict"] == "fail"
    ]


def test_from_a_red_requirement_to_its_bytes_in_one_click(report: Report) -> None:
    """Words, what the manual asks, hex, and the command that replays it."""
    assert_one_click_to_the_bytes(render(report), report)


@pytest.mark.strength
def test_a_wrong_mac_leads_to_its_bytes(wrong_mac: Path) -> None:
    """The same on a real family, in the files that --report writes."""
    report = load(wrong_mac / "report.json")
    text = (wrong_mac / "report.html").read_text()
    assert_one_click_to_the_bytes(text, report)
    assert '<path class="reading off"' in text, "the motion that failed shows where"
    assert {one.name for one in wrong_mac.iterdir()} == {
        "report.html", "report.json", "junit.xml", "events.jsonl",
    }  # fmt: skip
    assert load(wrong_mac / "events.jsonl") == report


def test_every_link_leads_somewhere(report: Report) -> None:
    """Inside the page."""
    page = Page(render(report))
    assert {to.removeprefix("#") for *_, to in page.links} <= set(page.text_of)


def test_the_page_needs_nothing_but_itself(wrong_mac: Path, report: Report) -> None:
    """No address is loaded from anywhere: it works from a folder, and for years."""
    for text in (render(report), (wrong_mac / "report.html").read_text()):
        assert Page(text).loads == []
        assert not re.search(r"url\(|@import|https?://|//[a-z]+\.", text)


def test_every_requirement_has_a_row_and_an_article(report: Report) -> None:
    """In the order of the ledger."""
    text = render(report)
    page = Page(text)
    keys = [one["id"] for one in report["requirements"]]
    assert re.findall(r'<tr id="row-([^"]+)"', text) == keys
    assert all(key in page.text_of for key in keys)


def test_the_head_tells_what_was_judged_and_how(report: Report) -> None:
    """Identity, target, address, rate, level, seed, suite, envelope, and the command."""
    text = render(report)
    for part in (
        "a toy", "Does not conform.", "built-in twin (toy://toy:0)", "0, 9600 baud",
        "full, 5", "axistwin 0.", "±1\u202f000 increments", "axistwin conform toy --seed 5",
    ):  # fmt: skip
        assert part in text


def test_the_head_tells_of_a_controller_what_it_has(report: Report) -> None:
    """What was named for the suite's use; no bounds of motion, and no EEPROM."""
    scratch = {"variables": "2048-3071", "bench-program": "240:6144"}
    report["run"] |= {"max_travel": None, "max_speed": None, "grounds": scratch}
    text = render(report)
    assert "<dt>Variables</dt><dd>2048-3071</dd>" in text
    assert "<dt>Bench program</dt><dd>240:6144</dd>" in text
    assert "Envelope" not in text
    assert "EEPROM writes" not in text


def test_what_a_device_says_cannot_break_the_page(report: Report) -> None:
    """Everything that comes from outside is text."""
    text = render(report)
    assert "the &lt;question&gt; &amp; its answer" in text
    report["device"]["summary"] = "<script>alert(1)</script>"
    assert "<script>alert" not in render(report)


def test_headings_and_tables_are_built_for_screen_readers(report: Report) -> None:
    """One h1, no level skipped, every header says of what."""
    page = Page(render(report))
    levels = [int(one[1]) for one in page.headings]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    assert all(given.get("scope") in ("row", "col") for _, given in page.headers)


def test_a_quirk_is_in_the_profile_with_its_default(report: Report) -> None:
    """And names the ambiguity."""
    shown = Page(render(report)).text_of["quirks"]
    assert "xon_byte" in shown
    assert "11h" in shown
    assert "1Ah" in shown
    assert "MACS-AMB-01" in shown


def test_an_exchange_that_broke_several_requirements_is_told_once(report: Report) -> None:
    """One article for a check: its sentence, all that the manual asks, and its bytes once."""
    [check] = [one for one in report["checks"] if one["name"] == "_wrong"]
    long = [
        {"time_ns": n, "direction": "host", "data": f"{n:02X}", "decoded": f"word {n}.", "text": ""}
        for n in range(40)
    ]
    for finding in check["findings"]:
        finding["transcript"], finding["decisive"] = long, [37, 38, 39]
    text = render(report)
    shown = Page(text).text_of["fail-_wrong"]
    assert "MACS-FRAME-01" in shown
    assert "MACS-FRAME-02" in shown
    assert shown.count(check["findings"][0]["sentence"]) == 1
    assert text.count("word 39.") == text.count("word 0.") == 1
    assert "37 other lines" in shown
    assert shown.index("word 39.") < shown.index("word 0."), "what decided comes first"


def test_a_motion_that_failed_is_drawn_in_the_article_of_its_check(report: Report) -> None:
    """With what it shows; all motions of the run are further below."""
    [check] = [one for one in report["checks"] if one["name"] == "_drifting"]
    page = render(report)
    article = page[page.index('id="fail-_drifting"') :].partition("</article>")[0]
    assert article.count("<figure>") == 1
    assert f"Position in {check['motions'][-1]['name']}" in article
    assert "<figure>" not in page[page.index('id="fail-_wrong"') :].partition("</article>")[0]


def test_the_verdict_is_first_then_failures_then_what_is_open_then_quirks(report: Report) -> None:
    """Nobody scrolls through a hundred rows to the first failure."""
    page = render(report)
    parts = ["banner", "failures", "open", "quirks", "requirements", "motion", "checks", "run"]
    places = [page.index(f'"{one}' if one == "banner" else f'<section id="{one}"') for one in parts]
    assert places == sorted(places)


def test_the_operations_of_a_failure_are_one_click_away(report: Report) -> None:
    """The file lies beside the page; operations given in hex have none."""
    replays = {"_wrong": "out/operations/_wrong-5.toml", "_drifting": "01ff0000"}
    for check in report["checks"]:
        if check["name"] in replays:
            check["replay"] = f"axistwin conform toy --replay {replays[check['name']]}"
    links = {to for *_, to in Page(render(report)).links if not to.startswith("#")}
    assert links == {"operations/_wrong-5.toml"}


def test_wear_and_gaps_are_told(report: Report) -> None:
    """EEPROM writes with their budget; what is not covered, and what is not armed, by name."""
    report["finished"] |= {"eeprom_writes": 1234, "eeprom_budget": 2000}
    for one in report["requirements"]:
        one["armed"] = [] if one["id"] == "MACS-LINE-02" else ["deaf"]
    text = render(report)
    assert "1\u202f234 of 2\u202f000 allowed" in text
    assert re.search(r"1 not armed</summary><p><a href=\"#MACS-LINE-02\">", text)
    assert "not covered</summary>" in text


@pytest.mark.parametrize(
    ("armed", "coverage", "told"),
    [
        (None, ["right"], ("1 check", "unknown")),
        ([], ["right"], ("1 check", "not armed")),
        (["slow_line", "deaf"], ["right", "other"], ("2 checks", "2 faults caught")),
        ([], [], ("not covered", "not armed")),
    ],
)
def test_coverage_and_arms_are_told(
    report: Report, armed: Any, coverage: list[str], told: tuple[str, str]
) -> None:
    """What nobody has looked at is not the same as what was found missing."""
    [one] = [one for one in report["requirements"] if one["id"] == "MACS-LINE-02"]
    one |= {"armed": armed, "checks": coverage}
    row = Page(render(report)).text_of["row-MACS-LINE-02"]
    assert all(part in row for part in told)


def test_a_planted_fault_is_counted_and_not_named(report: Report) -> None:
    """What the suite's makers planted says nothing about this device."""
    for one in report["requirements"]:
        one["armed"] = ["deaf_to_everything"]
    text = render(report)
    assert "1 fault caught" in text
    assert "deaf_to_everything" not in text


def test_failures_of_one_cause_are_folded_into_the_first(report: Report) -> None:
    """Each keeps its article, to which its requirement leads; both numbers are told."""
    [wrong] = [one for one in report["checks"] if one["name"] == "_wrong"]
    report["checks"].append({**wrong, "name": "_wrong_too"})
    page = render(report)
    first = page.index('<article id="fail-_wrong"')
    folded = page.index('<details class="also"><summary>1 other check', first)
    assert first < folded < page.index('<article id="fail-_wrong_too"')
    checks = len([one for one in report["checks"] if one["verdict"] == "fail"])
    told = f"{checks} checks failed, on {len(failed(report))} requirements; {checks - 1} groups"
    assert told in page
    Page(page)


def test_of_many_problems_the_last_stand_at_the_top(report: Report) -> None:
    """They tell the state in which the run has ended; the others are folded, none is lost."""
    report["finished"]["problems"] = [f"trouble {number}." for number in range(9)]
    head = render(report).partition("</header>")[0]
    assert re.findall(r"Problem: trouble (\d)", head) == ["6", "7", "8"]
    assert "6 earlier problems</summary>" in head
    assert all(f"trouble {number}." in head for number in range(9))


def asks(session: Session) -> None:
    """It answers."""


def test_an_unreachable_device_gets_a_page_too(toy: Any) -> None:
    """Without identity, checks or verdicts there is still the reason."""
    toy.add(asks, "MACS-LINE-01")
    toy.port.is_mute = True
    toy.run()
    text = render(fold([json.event_object(event) for event in toy.events]))
    assert text.startswith("<!DOCTYPE html>")
    assert "Not judged: device unreachable: nothing answers" in text


@pytest.mark.strength(seconds=20)
def test_a_full_run_makes_a_light_page(tmp_path: Path) -> None:
    """Under a megabyte, motion plots included."""
    result = CliRunner().invoke(conform, ["mac23", "--report", str(tmp_path)])
    assert result.exit_code == 0, result.output
    text = (tmp_path / "report.html").read_text()
    assert text.count("<svg") > 20
    assert len(text.encode()) < 1_000_000
    Page(text)


@pytest.mark.strength
def test_a_device_that_is_wrong_all_over_makes_a_light_page_too(tmp_path: Path) -> None:
    """Every move goes somewhere else, dozens of requirements fail: still under a megabyte."""
    [mutant] = [one for one in ZOO if one.name == "a_move_is_relative"]
    with mutant.plant():
        CliRunner().invoke(conform, ["mac23", "--level", "quick", "--report", str(tmp_path)])
    report = load(tmp_path / "report.json")
    text = (tmp_path / "report.html").read_text()
    assert len(failed(report)) > 30
    assert_one_click_to_the_bytes(text, report)
    assert len(text.encode()) < 1_000_000


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.0042, "4 ms"), (3.21, "3.2 s"), (89, "89.0 s"), (600, "10 min"), (7500, "2 h 5 min")],
)
def test_times_are_told_as_people_do(seconds: float, words: str) -> None:
    """Not more digits than anybody wants."""
    assert duration(seconds) == words


def in_a_browser(page: Path) -> str:
    """What the page has written into `data-seen` of its body, once it was loaded."""
    dumped = subprocess.run(
        [
            CHROMIUM or "", "--headless", "--no-sandbox", "--disable-gpu", "--disable-sync",
            "--disable-background-networking", "--no-first-run", "--window-size=390,800",
            f"--user-data-dir={page.parent / 'browser'}", "--dump-dom", page.as_uri(),
        ],
        capture_output=True, text=True, timeout=60, check=True,
    ).stdout  # fmt: skip
    told = re.search(r'data-seen="([^"]*)"', dumped)
    assert told is not None
    return told[1]


@pytest.mark.strength
@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_on_a_phone_nothing_stands_out_of_the_screen(wrong_mac: Path, tmp_path: Path) -> None:
    """Tables and articles fit 360 pixels: nobody has to push them aside to read the reason."""
    frame = f'''<!DOCTYPE html><body><iframe style="width:360px;height:800px"
      srcdoc="{html.escape((wrong_mac / "report.html").read_text())}"></iframe><script>
      document.querySelector("iframe").addEventListener("load", (loaded) => {{
        const seen = [...loaded.target.contentDocument.querySelectorAll(".wide-table, article")];
        const wide = seen.filter((one) => one.scrollWidth > one.clientWidth + 1);
        document.body.dataset.seen = [seen.length > 20].concat(
          wide.map((one) => one.innerText.slice(0, 60))).join("|");
      }});
    </script></body>'''
    page = tmp_path / "phone.html"
    page.write_text(frame)
    assert in_a_browser(page) == "true"


@pytest.mark.strength
@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_a_click_in_a_browser_shows_the_bytes(wrong_mac: Path, tmp_path: Path) -> None:
    """Click the check in the first red row: its article comes into view with the bytes."""
    report = load(wrong_mac / "report.json")
    probe = """<script>
      addEventListener("load", () => {
        document.querySelector("#show-fail").click();
        const rows = [...document.querySelectorAll(".index tbody tr")];
        const shown = rows.filter((row) => row.offsetParent !== null);
        shown[0].querySelector("td a").click();
        const target = document.querySelector(":target");
        const bytes = target.querySelector(".wire .judged td:nth-child(3)");
        const wide = document.documentElement.scrollWidth > innerWidth;
        document.body.dataset.seen = [
          target.id, shown.every((row) => row.className === "fail"), shown.length,
          bytes.offsetHeight > 0, wide, bytes.textContent].join("|");
      });
    </script>"""
    page = tmp_path / "page.html"
    page.write_text((wrong_mac / "report.html").read_text().replace("</body>", probe + "</body>"))
    seen = in_a_browser(page)
    key, is_filtered, count, is_visible, is_wide, data = seen.split("|")
    first = failed(report)[0]
    assert key == f"fail-{failures(report, first)[0][0]['name']}"
    assert (is_filtered, count, is_visible) == ("true", str(len(failed(report))), "true")
    assert is_wide == "false", "a phone would have to scroll sideways"
    assert data in json_bytes(report, first)


def json_bytes(report: Report, key: str) -> list[str]:
    """All bytes of the exchanges behind one requirement's findings."""
    return [
        record["data"]
        for check in report["checks"]
        for finding in check["findings"]
        if finding["requirement"] == key
        for record in finding["transcript"]
    ]
