"""The folder of `--report`: events as they come, and at the end everything made from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TextIO

from axistwin_conformance import events, report_html, report_json, report_junit
from axistwin_conformance.errors import UsageError
from axistwin_conformance.report_json import Explain, Spell
from axistwin_conformance.ways import in_hex

EVENTS, REPORT, JUNIT, PAGE = "events.jsonl", "report.json", "junit.xml", "report.html"


def past_seconds(directory: Path, url: str) -> dict[str, float]:
    """How long each check took on the same url in the run whose report lies there, if any."""
    try:
        report = report_json.load(directory / REPORT)
        if url not in report["run"]["target"]:
            return {}
        return {check["name"]: float(check["seconds"]) for check in report["checks"]}
    except (UsageError, KeyError, TypeError, ValueError):
        return {}  # whatever lies there is about to be replaced


class ReportFolder:
    """Listens to a run and fills a folder; the folder is made at once.  Raises OSError.

    The operations of a failure go into a file of their own as soon as they are known.

    `events.jsonl` grows while the run goes, so that a run that is cut off leaves its traces.
    """

    def __init__(self, directory: Path, explain: Explain, spell: Spell = in_hex) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self.directory = directory
        self._explain, self._spell = explain, spell
        self._stream: TextIO = (directory / EVENTS).open("w", encoding="utf-8")
        self._told: list[dict[str, Any]] = []

    def __call__(self, event: events.Event) -> None:
        """Take an event."""
        if isinstance(event, events.FailureStored):
            event.recording.write(self.directory)
        told = report_json.event_object(event, self._explain, self._spell)
        self._told.append(told)
        report_json.write_line(self._stream, told)

    def finish(self) -> tuple[Path, ...]:
        """Write what is made from the events; return the files, the one for people first."""
        self._stream.close()
        report = report_json.fold(self._told)
        text = report_json.to_text(report)
        made = {PAGE: report_html.render(report), REPORT: text, JUNIT: report_junit.junit(report)}
        for name, content in made.items():
            (self.directory / name).write_text(content, encoding="utf-8")
        return tuple(self.directory / name for name in (*made, EVENTS))
