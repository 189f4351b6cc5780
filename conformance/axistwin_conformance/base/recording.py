"""Recordings: the operations after which a device failed, as a value, a file and a word.

The exchange format between rigs: what was played, by which suite and seed, which requirement failed
and how the device reads the manual.  Only the operations are played again; the rest tells what to
expect of that.

    format = 1
    model = "mac23"
    requirement = "MACS-CMD-13-01"
    ...
    [readings]
    xon_byte = "13h"
    [[operations]]
    hex = "01ff0000"
    words = "13h to the address 00h ... → 06 13 1A (accepted)"

Without a folder to put a file in, the operations alone stand on the command line, in hex.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from axistwin_conformance.base.errors import UsageError, with_article

FORMAT = 1
FOLDER = "operations"  # of a report's folder
MOST_BYTES = 1_000_000  # of a file: a hundred times the longest recording
HEX = re.compile(r"[0-9A-Fa-f]+")


@dataclass(frozen=True, slots=True)
class Recording:
    """A list of operations, and what it showed.

    `words`: what each operation did, as far as it was played.  `found`: all that had been played
    when the failure was first seen.  `history`: how often it came again, what shrinking did.
    """

    model: str
    operations: tuple[bytes, ...]
    check: str = ""
    seed: int = 0
    requirement: str = ""
    expected: str = ""
    actual: str = ""
    words: tuple[str, ...] = ()
    readings: Mapping[str, str] = field(default_factory=dict)
    suite_version: str = ""
    found: bytes = b""
    history: tuple[str, ...] = ()

    @property
    def hex(self) -> str:
        """The operations on a command line."""
        return b"".join(self.operations).hex()

    @property
    def file_name(self) -> str:
        """The name of its file; a check that fails under another seed gets another one."""
        return f"{self.check}-{self.seed}.toml"

    def word(self, report: str) -> str:
        """What to give to `--replay`: its file if there is a folder of a report, or its hex."""
        return str(Path(report) / FOLDER / self.file_name) if report else self.hex

    def as_toml(self) -> str:
        """The recording as the text of a file."""
        values = {
            "format": FORMAT, "suite_version": self.suite_version, "model": self.model,
            "check": self.check, "seed": self.seed, "requirement": self.requirement,
            "admissible": self.expected, "came": self.actual, "history": list(self.history),
            "found": self.found.hex(),
        }  # fmt: skip
        lines = [
            "# Operations after which a device failed. Play them again:",
            f"# axistwin conform {self.model} --replay THIS_FILE",
            *(f"{name} = {_quoted(value)}" for name, value in values.items()),
            "",
            "[readings]",
            *(f"{switch} = {_quoted(one)}" for switch, one in sorted(self.readings.items())),
        ]
        for number, operation in enumerate(self.operations):
            words = self.words[number] if number < len(self.words) else ""
            lines += ["", "[[operations]]", f"hex = {_quoted(operation.hex())}"]
            lines += [f"words = {_quoted(words)}"]
        return "\n".join([*lines, ""])

    def write(self, directory: Path) -> Path:
        """Write its file into the folder of a report; raises OSError."""
        path = directory / FOLDER / self.file_name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(self.as_toml(), encoding="utf-8")
        return path


def _quoted(value: object) -> str:
    """A value in TOML: JSON writes strings, integers and lists of them alike, but for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def load_recording(word: str, model: str, size: int) -> Recording:
    """Read what was given to `--replay`: a file, or operations of `size` bytes in hex.

    Raises UsageError in one line for what cannot be played on this model.
    """
    path = Path(word)
    if HEX.fullmatch(word) and not _exists(path):
        return Recording(model, _operations(word, size, f"--replay {_short(word)}"))
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise UsageError(
            f"cannot read the operations {_short(word)}: {error.strerror}; --replay takes a file"
            " written by --report, or operations in hex"
        ) from error
    try:
        if len(data) > MOST_BYTES:
            raise ValueError(f"longer than {MOST_BYTES} bytes")
        told = tomllib.loads(data.decode("utf-8"))
    except RecursionError:
        raise UsageError(f"{path} is no recording: nested too deep") from None
    except ValueError as error:  # of TOML or of UTF-8
        raise UsageError(f"{path} is no recording: {error}") from error
    return _recording(path, told, model, size)


def _recording(path: Path, told: Mapping[str, Any], model: str, size: int) -> Recording:
    if told.get("format") != FORMAT:
        raise UsageError(
            f"{path} is no recording of format {FORMAT}: format is {told.get('format', 'missing')}"
        )
    named = told.get("model")
    if named != model:
        then, now = with_article(named), with_article(model)
        raise UsageError(f"{path} was recorded on {then}, not on {now}")
    listed = told.get("operations")
    rows = listed if isinstance(listed, list) else []
    if not rows or not all(
        isinstance(row, dict) and isinstance(row.get("hex"), str) for row in rows
    ):
        raise UsageError(f"{path} holds no operations: give [[operations]] with hex each")
    operations = tuple(
        operation
        for row in rows
        for operation in _operations(row["hex"], size, f"{path}: operation")
    )
    readings = told.get("readings")
    return Recording(
        model,
        operations,
        check=str(told.get("check", "")),
        seed=told["seed"] if isinstance(told.get("seed"), int) else 0,
        requirement=str(told.get("requirement", "")),
        expected=str(told.get("admissible", "")),
        actual=str(told.get("came", "")),
        words=tuple(str(row.get("words", "")) for row in rows),
        readings={
            str(switch): str(one)
            for switch, one in (readings if isinstance(readings, dict) else {}).items()
        },
        suite_version=str(told.get("suite_version", "")),
    )


def _operations(text: str, size: int, where: str) -> tuple[bytes, ...]:
    """Cut hex into operations; raises UsageError."""
    if not HEX.fullmatch(text) or len(text) % (2 * size):
        raise UsageError(f"{where} is {len(text)} characters; write {2 * size} hex digits for each")
    data = bytes.fromhex(text)
    return tuple(data[at : at + size] for at in range(0, len(data), size))


def _short(word: str) -> str:
    return word if len(word) <= 60 else f"{word[:20]}...{word[-37:]}"


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # too long for a name
        return False
