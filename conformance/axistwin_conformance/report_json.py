"""The machine-readable side of a run: one JSON object per event, and a report of the whole."""

from __future__ import annotations

import json
from collections.abc import Mapping, Set
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, TextIO

from axistwin_conformance import events
from axistwin_conformance.ledger import Ledger
from axistwin_conformance.plan import Plan

FORMAT = 1  # of report.json; raised when a field changes its meaning


def plain(value: object) -> Any:
    """Turn events and findings into what JSON knows: bytes as hex, sets sorted, enums by value."""
    match value:
        case Enum():
            return value.value
        case bytes():
            return value.hex(" ").upper()
        case Mapping():
            return {str(plain(key)): plain(one) for key, one in value.items()}
        case Set():
            return sorted(plain(one) for one in value)
        case list() | tuple():
            return [plain(one) for one in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {one.name: plain(getattr(value, one.name)) for one in fields(value)}
    return value


def event_object(event: events.Event) -> dict[str, Any]:
    """Return an event as a JSON object; its kind is under `event`, in snake_case."""
    kind = "".join(f"_{c.lower()}" if c.isupper() else c for c in type(event).__name__)
    return {"event": kind.lstrip("_"), **plain(event)}


class JsonStream:
    """Listens to a run and writes one line of JSON per event."""

    def __init__(self, out: TextIO) -> None:
        self._out = out

    def __call__(self, event: events.Event) -> None:
        """Take an event."""
        self._out.write(json.dumps(event_object(event), ensure_ascii=False) + "\n")
        self._out.flush()


class JsonReport:
    """Collects a run and writes `report.json` at its end."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._seen: dict[str, Any] = {"checks": [], "requirements": [], "notes": []}

    def __call__(self, event: events.Event) -> None:
        """Take an event."""
        match event:
            case events.RunStarted():
                self._seen["run"] = plain(event)
            case events.Identified():
                self._seen["device"] = plain(event)
            case events.CheckFinished():
                self._seen["checks"].append(plain(event))
            case events.RequirementJudged():
                source = self._ledger.requirements[event.id].source
                self._seen["requirements"].append({**plain(event), "source": source})
            case events.Note():
                self._seen["notes"].append(event.text)
            case events.RunFinished():
                self._seen["finished"] = plain(event)

    def write(self, directory: Path) -> Path:
        """Write the report into the directory and return the file; raises OSError."""
        path = directory / "report.json"
        text = json.dumps({"format": FORMAT, **self._seen}, ensure_ascii=False, indent=1)
        path.write_text(text + "\n", encoding="utf-8")
        return path


def overview(ledger: Ledger, plan: Plan) -> str:
    """Return requirements asked about and the plan, as one JSON object."""
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
        },
        ensure_ascii=False,
    )
