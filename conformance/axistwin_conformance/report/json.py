"""The machine-readable side of a run: one JSON object per event, and a report folded from them.

The stream of events is the one truth; `report.json`, and everything made from it, holds nothing
that the stream does not.  The schema is told in docs/reference/reports.md.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Set
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, TextIO

from axistwin_conformance.base import events
from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.base.ledger import Ledger
from axistwin_conformance.base.transcript import Record
from axistwin_conformance.engine.impact import allowed_in_vain, impacts
from axistwin_conformance.engine.plan import Options, Plan
from axistwin_conformance.transport.kinds import in_hex

FORMAT = 1  # of events and report; raised when a field changes its meaning

Explain = Callable[[Record], str]
Spell = Callable[[bytes], str]
Report = dict[str, Any]


def plain(value: object, explain: Explain | None = None, spell: Spell = in_hex) -> Any:
    """Turn events and findings into what JSON knows: sets sorted, enums by value, bytes in hex.

    `spell` writes the bytes of a record, which may be frames; `explain` puts them into words, which
    are added as `decoded`.
    """
    match value:
        case Enum():
            return value.value
        case bytes():
            return in_hex(value)
        case Mapping():
            return {str(plain(key)): plain(one, explain, spell) for key, one in value.items()}
        case Set():
            return sorted(plain(one, explain, spell) for one in value)
        case list() | tuple():
            return [plain(one, explain, spell) for one in value]
    if is_dataclass(value) and not isinstance(value, type):
        named = {
            field.name: plain(getattr(value, field.name), explain, spell) for field in fields(value)
        }
        if isinstance(value, Record):
            named["data"] = spell(value.data)
            if explain is not None:
                named["decoded"] = explain(value) if value.data else ""
        return named
    return value


def event_object(
    event: events.Event, explain: Explain | None = None, spell: Spell = in_hex
) -> dict[str, Any]:
    """Return an event as a JSON object; its kind is under `event`, in snake_case."""
    kind = "".join(f"_{c.lower()}" if c.isupper() else c for c in type(event).__name__)
    return {"event": kind.lstrip("_"), **plain(event, explain, spell)}


def write_line(out: TextIO, told: Mapping[str, Any]) -> None:
    """Write one event object as a line of its own, at once: a reader may follow the run."""
    out.write(json.dumps(told, ensure_ascii=False) + "\n")
    out.flush()


class JsonStream:
    """Listens to a run and writes one line of JSON per event."""

    def __init__(self, out: TextIO, explain: Explain | None = None, spell: Spell = in_hex) -> None:
        self._out = out
        self._explain, self._spell = explain, spell

    def __call__(self, event: events.Event) -> None:
        """Take an event."""
        write_line(self._out, event_object(event, self._explain, self._spell))


def fold(told: Iterable[Mapping[str, Any]]) -> Report:
    """Put the event objects of one run, in their order, together into its report."""
    report: Report = {
        "format": FORMAT, "run": {}, "device": {}, "checks": [], "readings": [],
        "unknown_readings": [], "profile": {}, "coverage": [], "requirements": [], "notes": [],
        "finished": {},
    }  # fmt: skip
    started: dict[str, Any] = {}
    motions: list[dict[str, Any]] = []
    paths: list[dict[str, Any]] = []
    for event in told:
        body = {key: value for key, value in event.items() if key != "event"}
        match event["event"]:
            case "run_started":
                report["run"] = body
            case "identified":
                report["device"] = body
            case "check_started":
                started, motions, paths = body, [], []
            case "motion_sampled":
                motions.append({key: body[key] for key in ("name", "measured", "predicted")})
            case "states_covered":
                report["coverage"].append(body)
            case "path_sampled":
                paths.append({key: body[key] for key in ("name", "axes", "points")})
            case "check_finished":
                check = {**started, **body, "motions": motions}
                report["checks"].append(check | ({"paths": paths} if paths else {}))
            case "note":
                report["notes"].append(body["text"])
            case "reading_seen":
                report["readings"].append(body)
            case "reading_unknown":
                report["unknown_readings"].append(body)
            case "profile_judged":
                report["profile"] = body
            case "requirement_judged":
                report["requirements"].append(body)
            case "run_finished":
                report["finished"] = body
    return report


def to_text(report: Report) -> str:
    """Return a report as JSON."""
    return json.dumps(report, ensure_ascii=False) + "\n"


def load(path: Path) -> Report:
    """Read a `report.json`, an `events.jsonl`, or the folder of a report, where the first of these
    that is there counts; raises UsageError for anything else."""
    if path.is_dir():
        stream = path / "events.jsonl"  # alone, if the run was killed
        whole = path / "report.json"
        path = stream if stream.exists() and not whole.exists() else whole
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError:
        raise UsageError(f"{path} is no report of a run: not text") from None
    try:
        first = json.loads(text.partition("\n")[0]) if text.startswith('{"event"') else None
        report = json.loads(text) if first is None else fold(map(json.loads, text.splitlines()))
        known = report["format"] == FORMAT and [
            (one["id"], one["verdict"], one["reason"]) for one in report["requirements"]
        ]
    except (ValueError, TypeError, KeyError):
        known = False
    if known is False:
        raise UsageError(f"{path} is no report of a run: give a report.json of --report DIR")
    return report


def overview(ledger: Ledger, plan: Plan, options: Options) -> str:
    """Return requirements asked about, the plan, and what it would do, as one JSON object."""
    checks = [(check, "") for check in plan.to_run] + list(plan.left_out)
    return json.dumps(
        {
            "requirements": [plain(ledger.requirements[key]) for key in plan.requirements],
            "checks": [
                {
                    "name": check.name,
                    "behaviour": check.behaviour,
                    "requirements": check.requirements,
                    "safety": check.safety,
                    "level": check.level,
                    "left_out": reason,
                }
                for check, reason in checks
            ],
            "deeds": plain(impacts(plan, options)),
            "note": allowed_in_vain(options),
        },
        ensure_ascii=False,
    )
