"""The folder of `--report`: events as they come, and at the end everything made from them."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
from pathlib import Path
from typing import Any

from axistwin_conformance.base import events
from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.base.recording import FOLDER
from axistwin_conformance.report import html, junit
from axistwin_conformance.report import json as report_json
from axistwin_conformance.report.json import Explain, Spell
from axistwin_conformance.transport.kinds import in_hex

EVENTS, REPORT, JUNIT, PAGE = "events.jsonl", "report.json", "junit.xml", "report.html"


def past_seconds(directory: Path, url: str) -> dict[str, float]:
    """How long each check took on the same url in the run whose report lies there, if any."""
    try:
        if not (directory / REPORT).is_file():  # a device may have no end
            return {}
        report = report_json.load(directory / REPORT)
        if url not in report["run"]["target"]:
            return {}
        return {check["name"]: float(check["seconds"]) for check in report["checks"]}
    except (UsageError, KeyError, TypeError, ValueError):
        return {}  # whatever lies there is about to be replaced


class ReportFolder:
    """Listens to a run and fills a folder, which is made at once.

    The operations of a failure go into a file of their own as soon as they are known.
    `events.jsonl` grows while the run goes, so that a run that is cut off leaves its traces.  What
    an earlier run has left there would be taken for this one's, and goes first.  A folder belongs
    to one run at a time: BlockingIOError while another one fills it.

    Before anything has been told, and in the constructor, what cannot be written raises OSError.
    From then on the run is worth more than its report: what cannot be written is kept in `lost`
    (file → reason), the file ends with its last whole line, and all others are still written.
    """

    def __init__(self, directory: Path, explain: Explain, spell: Spell = in_hex) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self.directory = directory
        self.lost: dict[Path, str] = {}
        self._explain, self._spell = explain, spell
        self._stream = (directory / EVENTS).open("ab", buffering=0)
        self._own()
        for path in (directory / name for name in (PAGE, REPORT, JUNIT)):
            if path.is_file() and not path.is_symlink():
                _remove(path)
        self._whole = 0  # bytes of the lines that are in it
        self._told: list[dict[str, Any]] = []

    def _own(self) -> None:
        """Keep other runs out, as long as the stream is open, and begin anew."""
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._stream.close()
            told = "another run is writing its report there"
            raise BlockingIOError(errno.EWOULDBLOCK, told, str(self.directory)) from error
        except OSError:
            pass  # a network's disk without locks
        with contextlib.suppress(OSError):  # what is no file has no length
            self._stream.truncate(0)

    def __call__(self, event: events.Event) -> None:
        """Take an event."""
        if isinstance(event, events.FailureStored):
            self._store(event)
        told = report_json.event_object(event, self._explain, self._spell)
        self._told.append(told)
        path = self.directory / EVENTS
        if path in self.lost:
            return
        try:
            self._write((json.dumps(told, ensure_ascii=False) + "\n").encode())
        except OSError as error:
            with contextlib.suppress(OSError):  # what is no file has no length
                self._stream.truncate(self._whole)
            if not self._whole:
                self.close()
                raise OSError(error.errno, error.strerror, str(path)) from error
            self.lost[path] = _reason(error)

    def _write(self, line: bytes) -> None:
        rest = line
        while rest:
            rest = rest[self._stream.write(rest) or 0 :]
        self._whole += len(line)

    def _store(self, event: events.FailureStored) -> None:
        try:
            event.recording.write(self.directory)
        except OSError as error:
            path = self.directory / FOLDER / event.recording.file_name
            _remove(path)
            self.lost[path] = _reason(error)

    def close(self) -> None:
        """Take nothing more; what was told is written."""
        self._stream.close()

    def finish(self) -> tuple[Path, ...]:
        """Write what is made from the events; return the files that are whole, the one for people
        first.  Of one that cannot be written nothing is left, of an earlier run neither."""
        try:
            return self._made()
        finally:
            self.close()

    def _made(self) -> tuple[Path, ...]:
        if not self._told or self._told[0]["event"] != "run_started":
            return ()  # interrupted before there was anything to be told
        report = report_json.fold(self._told)
        text = report_json.to_text(report)
        made = {PAGE: html.render(report), REPORT: text, JUNIT: junit.junit(report)}
        for name in reversed(made):  # the small ones for programs first
            path = self.directory / name
            try:
                path.write_text(made[name], encoding="utf-8")
            except OSError as error:
                _remove(path)
                self.lost[path] = _reason(error)
        paths = (self.directory / name for name in (*made, EVENTS))
        return tuple(path for path in paths if path not in self.lost)


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
