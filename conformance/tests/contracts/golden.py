"""What was recorded, how it is compared, and what of it may differ from one run to the next."""

from __future__ import annotations

import difflib
import json
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent / "golden"
RECORD = "AXISTWIN_RECORD_CONTRACTS"
HOW = f"""\
This is a contract: users and their programs rely on it.  If the change is meant, record it anew by
    {RECORD}=1 python -m pytest {os.path.relpath(Path(__file__).parent)}
read the difference that git shows, and name it in CHANGELOG.md."""
MOST_LINES, MOST_COLUMNS = 40, 200

# Fields that tell how fast and when this machine ran, and what was installed.
VOLATILE: dict[str, Any] = {"seconds": 0, "started_at": "(time)", "suite_version": "(version)"}
# The same where it is part of a text.
TEXTS = tuple(
    (re.compile(pattern, re.MULTILINE), instead)
    for pattern, instead in (
        (r"(\d operations, )\d+\.\d s\b", r"\1(time) s"),  # what shrinking took
        (r"( · )\d+\.\d s$", r"\1(time) s"),  # the counts on the terminal
        (r"^… .*\n", ""),  # how long it still takes, told now and then
        (r"( · suite )\S+( · )", r"\1(version)\2"),
        (r'^(suite_version = )".*"$', r'\1"(version)"'),
        (r'("suite_version" value=)".*?"', r'\1"(version)"'),
        (r'( time(?:stamp)?=)".*?"', r'\1"(time)"'),
    )
)


def steady_text(text: str) -> str:
    """The text without what may differ."""
    for pattern, instead in TEXTS:
        text = pattern.sub(instead, text)
    return text


def steady(value: Any) -> Any:
    """A value of JSON without what may differ; the order of keys stays."""
    match value:
        case str():
            return steady_text(value)
        case list():
            return [steady(one) for one in value]
        case dict():
            return {key: VOLATILE.get(key, steady(one)) for key, one in value.items()}
    return value


def steady_lines(stream: str) -> list[dict[str, Any]]:
    """The events of a stream, one object per line."""
    return [steady(json.loads(line)) for line in stream.splitlines()]


def as_lines(told: list[dict[str, Any]]) -> str:
    """Events as they are recorded."""
    return "".join(json.dumps(one, ensure_ascii=False) + "\n" for one in told)


def folded(told: list[dict[str, Any]]) -> dict[str, Any]:
    """The report that docs/reference/reports.md promises for these events."""
    bodies = [(one["event"], {k: v for k, v in one.items() if k != "event"}) for one in told]

    def one_of(kind: str) -> dict[str, Any]:
        return next((body for name, body in bodies if name == kind), {})

    def all_of(kind: str) -> list[dict[str, Any]]:
        return [body for name, body in bodies if name == kind]

    return {
        "format": 1,
        "run": one_of("run_started"),
        "device": one_of("identified"),
        "checks": list(_checks(bodies)),
        "readings": all_of("reading_seen"),
        "unknown_readings": all_of("reading_unknown"),
        "profile": one_of("profile_judged"),
        "coverage": all_of("states_covered"),
        "requirements": all_of("requirement_judged"),
        "notes": [body["text"] for body in all_of("note")],
        "finished": one_of("run_finished"),
    }


def _checks(bodies: list[tuple[str, dict[str, Any]]]) -> Iterator[dict[str, Any]]:
    """Each check in one: as it was started, as it ended, and its motions."""
    started: Mapping[str, Any] = {}
    motions: list[dict[str, Any]] = []
    for name, body in bodies:
        if name == "check_started":
            started, motions = body, []
        elif name == "motion_sampled":
            motions.append({key: value for key, value in body.items() if key != "check"})
        elif name == "check_finished":
            yield {**started, **body, "motions": motions}


def compare(name: str, came: str) -> None:
    """Hold a text against the recorded one of this name; with the switch set, record it."""
    path = FOLDER / name
    if RECORD in os.environ:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(came, encoding="utf-8")
        return
    assert path.is_file(), f"nothing is recorded as {name}\n{HOW}"
    recorded = path.read_text(encoding="utf-8")
    if came != recorded:
        raise AssertionError(f"not as recorded in {name}:\n{difference(recorded, came)}\n{HOW}")


def difference(recorded: str, came: str) -> str:
    """A short difference of two texts; lines of JSON are told field by field."""
    before, after = recorded.splitlines(), came.splitlines()
    first = next((at for at, (x, y) in enumerate(zip(before, after, strict=False)) if x != y), None)
    at = min(len(before), len(after)) if first is None else first
    where = f"(first difference in line {1 + at})"
    if before[at : at + 1] and before[at].startswith('{"'):
        before, after, at = _fields(before[at:]), _fields(after[at:]), 0
    start = max(0, at - 3)
    window = slice(start, start + 20 * MOST_LINES)  # more is not shown, and takes long to compare
    lines = difflib.unified_diff(before[window], after[window], "recorded", "came", "", "", 2, "")
    shown = [line[:MOST_COLUMNS] for line in lines]
    rest = [f"... and {len(shown) - MOST_LINES} lines more"] if len(shown) > MOST_LINES else []
    return "\n".join([where, *shown[:MOST_LINES], *rest])


def _fields(lines: list[str]) -> list[str]:
    """The first of these lines of JSON, a field a line, and the beginnings of some that follow."""
    head = json.dumps(json.loads(lines[0]), ensure_ascii=False, indent=1) if lines else ""
    return [*head.splitlines(), *(line[:MOST_COLUMNS] for line in lines[1:MOST_LINES])]
