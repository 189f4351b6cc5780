"""The report as one self-contained HTML page: the verdict, what failed in words, then all the rest.

Each check that failed has one article: what was done, expected and came, what the manual asks, the
lines that decided and the plot of the motion.  From a requirement that failed, one click leads from
its row to that article.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import jinja2

from axistwin_conformance.base.errors import counted
from axistwin_conformance.base.recording import FOLDER
from axistwin_conformance.engine.judgement import CONFORMS, ELSEWHERE
from axistwin_conformance.report.by_hand import Instruction, instructions
from axistwin_conformance.report.failures import (
    ALSO,
    LAST_PROBLEMS,
    SHOWN,
    TIMES,
    Failed,
    Required,
    Statement,
    failed,
)
from axistwin_conformance.report.json import Report
from axistwin_conformance.report.plot import is_inside, is_on_path, plot, plot_path

# In the order of urgency; the sign says the same as the colour.
SIGNS = {
    "fail": "✕",
    "inconclusive": "?",
    "quirk": "◆",
    "pass": "✓",
    "info": "i",
    "not run": "–",
}
NOT_COVERED, NOT_ON_WIRE, NOT_ARMED = "not covered", "not on the wire", "not armed"
ON_THE_LINE = "of the serial line"

PROFILE = "profile"  # the anchor of its article

WHOLE_EXCHANGES = 24  # with their beginnings; of a device that is wrong all over more is too much

HEADLINES = {
    0: "conforms",
    1: "does not conform",
    2: "not judged",
    3: "not judged",
    4: "not settled",
    130: "interrupted",
}


@dataclass(frozen=True, slots=True)
class TranscriptRow:
    """One record of a transcript, ready to be shown."""

    time_ms: str
    direction: str
    hex: str
    words: str
    is_last: bool  # the last thing the device did, which was judged


@dataclass(frozen=True, slots=True)
class Exhibit:
    """One thing that a check saw: in words, what is asked, and the exchange.

    `by_hand`: how to see it again without the suite.  `rows`: those that decided; `others`: the
    rest; `cut`: how many of these are in the report's other files only.
    """

    statement: Statement
    whose: str
    required: Sequence[Required]
    by_hand: Sequence[Instruction] = ()
    rows: Sequence[TranscriptRow] = ()
    others: Sequence[TranscriptRow] = ()
    cut: int = 0


@dataclass(frozen=True, slots=True)
class CheckArticle:
    """One check that failed, or settled nothing.

    `motion`, `path`: those that failed.  `operations`: the file beside the page that plays the
    failure again, if there is one.  `also`: the checks that fail by the same cause, as far as can
    be seen.
    """

    anchor: str
    slug: str
    check: Mapping[str, Any]
    seen: Sequence[Exhibit]
    motion: Mapping[str, Any] | None = None
    operations: str = ""
    also: Sequence[CheckArticle] = ()
    path: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class Article:
    """All about one requirement."""

    id: str
    slug: str  # of the verdict, for style
    judged: Mapping[str, Any]
    coverage: str
    armed: str
    told: list[CheckArticle] = field(default_factory=list)  # where it failed or stayed open
    said: list[tuple[str, str, str]] = field(default_factory=list)  # check, verdict, its words
    departures: Sequence[Mapping[str, Any]] = ()  # of the profile's article: what is not as it says


def render(report: Report) -> str:
    """Return the page."""
    checks = _check_articles(report)
    articles = _articles(report, checks)
    profile = _profile_article(report)
    shown = [*profile, *articles]
    counts = Counter(one.judged["verdict"] for one in shown)
    failures = [one for one in checks if one.slug == "fail"]
    armed = [article for article in articles if article.judged["armed"]]
    page = _template().render(
        report=report,
        run=report["run"],
        device=report["device"],
        finished=report["finished"],
        problems=report["finished"]["problems"][-LAST_PROBLEMS:],
        earlier_problems=report["finished"]["problems"][:-LAST_PROBLEMS],
        headline=HEADLINES[report["finished"]["exit_status"]],
        is_good=report["finished"]["exit_status"] == CONFORMS,
        signs=SIGNS,
        counts={verdict: counts[verdict] for verdict in SIGNS},
        articles=articles,
        shown=shown,
        profile=profile,
        failures=failures,
        failed_checks=sum(1 + len(one.also) for one in failures),
        open_ends=[one for one in checks if one.slug == "inconclusive"],
        covered=sum(bool(article.judged["checks"]) for article in articles),
        armed=None if any(article.judged["armed"] is None for article in articles) else len(armed),
        gaps={
            "not covered": [article.id for article in articles if article.coverage == NOT_COVERED],
            "not armed": [article.id for article in articles if article.armed == NOT_ARMED],
            "not on the wire": [
                article.id for article in articles if article.coverage == NOT_ON_WIRE
            ],
        },
        quirks=[one for one in report["readings"] if one["reading"] != one["default"]],
        followed=[one for one in report["readings"] if one["reading"] == one["default"]],
        moved=[check for check in report["checks"] if check["motions"]],
        check_names={check["name"] for check in report["checks"]},
    )
    return page.lstrip()  # what the macros at the top leave behind


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("axistwin_conformance.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        slug=slug, plot=plot, plot_path=plot_path, duration=duration, thousands=thousands, rate=rate
    )
    environment.tests["inside"] = is_inside
    environment.tests["on_path"] = is_on_path
    environment.globals.update(times=TIMES, also=ALSO)
    return environment.get_template("report.html.j2")


def slug(verdict: str) -> str:
    """A verdict as a name for styles and anchors."""
    return verdict.replace(" ", "-")


def thousands(number: int) -> str:
    """A number of many digits in groups that do not break."""
    return f"{number:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def rate(run: Mapping[str, Any]) -> str:
    """How fast our end talks."""
    if run["carrier"] == "line":
        return f"{run['baud']} baud"
    bitrate = run["bitrate"]
    return "bit rate as the interface is set" if bitrate is None else f"{bitrate} bit/s"


def duration(seconds: float) -> str:
    """A time that people read at a glance."""
    if seconds < 0.1:
        return f"{seconds * 1000:.0f} ms"
    if seconds < 90:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


def _check_articles(report: Report) -> list[CheckArticle]:
    """An article for each check that failed or settled nothing, in the order of the run, with those
    of the same cause in the first one's."""
    known = {one["id"]: one for one in report["requirements"]}
    names: Counter[str] = Counter()
    count = 0

    def article(one: Failed) -> CheckArticle:
        nonlocal count
        check, verdict = one.check, one.found[0].verdict
        names[check["name"]] += 1
        number = names[check["name"]]
        anchor = f"{verdict}-{check['name']}{f'-{number}' if number > 1 else ''}"
        is_cut = count >= WHOLE_EXCHANGES
        seen = [_seen(each, known, report["run"], is_cut=is_cut) for each in one.found]
        count += 1
        motion = check["motions"][-1] if check["motions"] else None
        if motion is not None and (verdict != "fail" or is_inside(motion)):
            motion = None  # it failed on something else
        path = next(iter(check.get("paths", [])[-1:]), None)
        if path is not None and (verdict != "fail" or is_on_path(path)):
            path = None
        operations = _operations(check["replay"])
        also = [article(each) for each in one.also]
        return CheckArticle(anchor, slug(verdict), check, seen, motion, operations, also, path)

    return [article(one) for one in failed(report["checks"])]


def _seen(
    statement: Statement,
    known: Mapping[str, Mapping[str, Any]],
    run: Mapping[str, Any],
    *,
    is_cut: bool,
) -> Exhibit:
    rows = _rows(statement.transcript, statement.shown)
    decided = set(statement.shown)
    others = [row for number, row in enumerate(rows) if number not in decided]
    left = len(others) if is_cut else 0
    shown = [rows[number] for number in statement.shown]
    by_hand = tuple(instructions(run, statement)) if statement.verdict == "fail" else ()
    whose = statement.whose(known) if statement.verdict == "fail" else ""
    required = statement.required(known)
    return Exhibit(statement, whose, required, by_hand, shown, () if left else others, left)


def _articles(report: Report, checks: Sequence[CheckArticle]) -> list[Article]:
    """What is known of each requirement."""
    articles = {
        judged["id"]: Article(
            judged["id"], slug(judged["verdict"]), judged, _coverage(judged), _armed(judged)
        )
        for judged in report["requirements"]
    }
    for article in [one for group in checks for one in (group, *group.also)]:
        named = {name for seen in article.seen for name in seen.statement.requirements}
        for name in named & articles.keys():
            articles[name].told.append(article)
    for check in report["checks"]:
        for finding in check["findings"]:
            if finding["requirement"] in articles and finding["verdict"] not in SHOWN:
                remark = (check["name"], finding["verdict"], finding["text"])
                articles[finding["requirement"]].said.append(remark)
    return list(articles.values())


def _profile_article(report: Report) -> list[Article]:
    """The profile that the device was held to, told as a requirement is."""
    judged = report.get("profile")
    if not judged:
        return []
    told = {
        "id": PROFILE,
        "verdict": judged["verdict"],
        "reason": judged["reason"],
        "text": "The device reads the manual as its profile says; what that does not name, as the"
        " default says.",
        "kind": "profile",
        "safety": ("as the questions",),
        "source": judged["profile"],
        "where": judged["profile"],
        "checks": (),
        "armed": (),
    }
    asked = len(report["readings"])
    coverage = f"{counted(asked, 'reading')} seen"
    return [
        Article(
            PROFILE, slug(judged["verdict"]), told, coverage, "–", departures=judged["departures"]
        )
    ]


def _coverage(judged: Mapping[str, Any]) -> str:
    if judged["checks"]:
        return counted(len(judged["checks"]), "check")
    if judged["reason"] == ELSEWHERE:
        return ON_THE_LINE
    return NOT_ON_WIRE if judged["not_on_wire"] else NOT_COVERED


def _armed(judged: Mapping[str, Any]) -> str:
    if judged["armed"] is None:
        return "unknown"
    count = len(judged["armed"])
    return f"{counted(count, 'fault')} caught" if count else NOT_ARMED


def _operations(replay: str) -> str:
    """The file of operations that the command plays, as seen from the page; empty if none."""
    words = shlex.split(replay)
    files = [word for option, word in pairwise(words) if option == "--replay"]
    name = Path(files[0]).name if files else ""
    return f"{FOLDER}/{name}" if name.endswith(".toml") else ""


def _rows(records: Sequence[Mapping[str, Any]], decisive: Sequence[int]) -> list[TranscriptRow]:
    directions = {n: records[n]["direction"] for n in decisive}
    asked = max((n for n in decisive if directions[n] == "host"), default=-1)
    answers = [n for n in decisive if directions[n] == "device" and n > asked] or [
        n for n in decisive if directions[n] in ("device", "silence")
    ]  # behind an answer silence is no more than its end
    return [
        TranscriptRow(
            f"{(one['time_ns'] - records[0]['time_ns']) / 1e6:.3f}",
            one["direction"],
            one["data"],
            one["decoded"] if one["data"] else one["text"],
            bool(answers) and number == answers[-1],
        )
        for number, one in enumerate(records)
    ]
