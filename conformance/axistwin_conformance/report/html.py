"""The report as one self-contained HTML page, indexed by requirement.

From a requirement that failed, one click leads to its bytes: its row links to an article below that
holds what was asked, what was admissible, what came, the exchange, and the command that replays it.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import jinja2

from axistwin_conformance.base.errors import counted
from axistwin_conformance.base.recording import FOLDER
from axistwin_conformance.engine.judgement import CONFORMS
from axistwin_conformance.report.json import Report
from axistwin_conformance.report.plot import is_inside, plot

# In the order of urgency; the sign says the same as the colour.
SIGNS = {
    "fail": "✕",
    "inconclusive": "?",
    "quirk": "◆",
    "pass": "✓",
    "info": "i",
    "not run": "–",
}
SHOWN_RECORDS = 16  # of a transcript at once; what came before is folded away
REPEATED_RECORDS = 3  # of a transcript that an earlier article shows whole

NOT_COVERED, NOT_ON_WIRE, NOT_ARMED = "not covered", "not on the wire", "not armed"

PROFILE = "profile"  # the anchor of its article

WHOLE_EXCHANGES = 24  # with their beginnings; of a device that is wrong all over more is too much
WHOLE_CHECKS = 2  # of a requirement with an exchange each; more only if shown nowhere else

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
class Evidence:
    """What one check said about one requirement.

    `whole_at`: where the exchange is shown whole.  `motion`: drawn there and only there.
    `has_plot`: it is drawn somewhere, at least with the other motions of the check.  `is_brief`:
    only said in a line that leads to the exchange.  `cut`: how many records of a beginning are in
    the report's other files only.
    `operations`: the file beside the page that plays the failure again, if there is one.
    """

    anchor: str
    check: Mapping[str, Any]
    finding: Mapping[str, Any]
    earlier: Sequence[TranscriptRow] = ()
    rows: Sequence[TranscriptRow] = ()
    left_out: int = 0
    whole_at: str = ""
    motion: Mapping[str, Any] | None = None
    has_plot: bool = False
    operations: str = ""
    is_brief: bool = False
    cut: int = 0


@dataclass(frozen=True, slots=True)
class Article:
    """All about one requirement."""

    id: str
    slug: str  # of the verdict, for style
    judged: Mapping[str, Any]
    coverage: str
    armed: str
    evidence: list[Evidence] = field(default_factory=list)
    held: list[tuple[str, str]] = field(default_factory=list)  # name of a check, what it said
    departures: Sequence[Mapping[str, Any]] = ()  # of the profile's article: what is not as it says


def render(report: Report) -> str:
    """Return the page."""
    articles = _articles(report)
    profile = _profile_article(report)
    shown = [*profile, *articles]
    counts = Counter(one.judged["verdict"] for one in shown)
    armed = [article for article in articles if article.judged["armed"]]
    page = _template().render(
        report=report,
        run=report["run"],
        device=report["device"],
        finished=report["finished"],
        headline=HEADLINES[report["finished"]["exit_status"]],
        is_good=report["finished"]["exit_status"] == CONFORMS,
        signs=SIGNS,
        counts={verdict: counts[verdict] for verdict in SIGNS},
        articles=articles,
        shown=shown,
        told=[one for one in shown if one.slug in ("fail", "inconclusive")],
        others=[one for one in shown if one.slug not in ("fail", "inconclusive")],
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
        slug=slug, plot=plot, duration=duration, thousands=thousands, rate=rate
    )
    environment.tests["inside"] = is_inside
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


def _articles(report: Report) -> list[Article]:
    spoken: dict[str, list[tuple[Mapping[str, Any], Mapping[str, Any]]]] = {}
    for check in report["checks"]:
        for finding in check["findings"]:
            spoken.setdefault(finding["requirement"], []).append((check, finding))
    shown: dict[object, str] = {}  # an exchange → the article that shows it whole
    articles = []
    for judged in report["requirements"]:
        article = Article(
            judged["id"], slug(judged["verdict"]), judged, _coverage(judged), _armed(judged)
        )
        said = spoken.get(judged["id"], [])
        # First what decided: under a red requirement its bytes come before anything else.
        for check, finding in sorted(
            said, key=lambda pair: pair[1]["verdict"] != judged["verdict"]
        ):
            if finding["verdict"] == "pass":
                article.held.append((check["name"], finding["text"]))
            else:
                number = sum(one.check is check for one in article.evidence)
                anchor = f"{judged['id']}--{check['name']}{f'-{number + 1}' if number else ''}"
                one = _evidence(anchor, check, finding, shown)
                is_brief = len(article.evidence) >= WHOLE_CHECKS and one.whole_at != one.anchor
                article.evidence.append(replace(one, is_brief=is_brief))
        articles.append(article)
    return articles


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
    return NOT_ON_WIRE if judged["not_on_wire"] else NOT_COVERED


def _armed(judged: Mapping[str, Any]) -> str:
    if judged["armed"] is None:
        return "unknown"
    count = len(judged["armed"])
    return f"{counted(count, 'fault')} caught" if count else NOT_ARMED


def _evidence(
    anchor: str,
    check: Mapping[str, Any],
    finding: Mapping[str, Any],
    shown: dict[object, str],
) -> Evidence:
    rows = _rows(finding["transcript"])
    whole_at = shown.setdefault((check["name"], tuple(rows)), anchor) if rows else anchor
    is_failing = finding["verdict"] == "fail"
    motion = check["motions"][-1] if is_failing and check["motions"] else None
    if motion is not None and is_inside(motion):
        motion = None  # it failed on something else
    is_whole, kept = whole_at == anchor, rows[-REPEATED_RECORDS:]
    earlier = rows[:-SHOWN_RECORDS] if is_whole else []
    is_cut = len(shown) > WHOLE_EXCHANGES
    return Evidence(
        anchor,
        check,
        finding,
        earlier=() if is_cut else earlier,
        rows=rows[-SHOWN_RECORDS:] if is_whole else kept,
        left_out=0 if is_whole else len(rows) - len(kept),
        whole_at=whole_at,
        motion=motion if is_whole else None,
        has_plot=motion is not None,
        operations=_operations(check["replay"]),
        cut=len(earlier) if is_cut else 0,
    )


def _operations(replay: str) -> str:
    """The file of operations that the command plays, as seen from the page; empty if none."""
    words = shlex.split(replay)
    files = [word for option, word in pairwise(words) if option == "--replay"]
    name = Path(files[0]).name if files else ""
    return f"{FOLDER}/{name}" if name.endswith(".toml") else ""


def _rows(records: Sequence[Mapping[str, Any]]) -> list[TranscriptRow]:
    answers = [n for n, one in enumerate(records) if one["direction"] in ("device", "silence")]
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
