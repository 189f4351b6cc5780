"""What a device held, in a file: written before anything is written to the device, and put back
from there by `axistwin conform MODEL --restore FILE`, whatever has become of the run."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.engine.plan import Options

FORMAT = 1


@dataclass(frozen=True, slots=True)
class Kept:
    """A file's content: which device it was, and what the family keeps of it (`Family.kept`).

    `option`: behind which the endpoint stands; empty: the one that the family has first.
    """

    model: str
    endpoint: str
    address: int
    rate: int | None
    held: Mapping[str, Any]
    option: str = ""


def folder(options: Options) -> Path:
    """Where files of this run go: to its report, or to the user's state folder."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(options.report or Path(state) / "axistwin" / "held")


def keep(options: Options, held: Mapping[str, Any], now: datetime | None = None) -> Path:
    """Write a file, whole or not at all; raises OSError."""
    moment = (now or datetime.now(UTC)).strftime("%Y%m%d-%H%M%S-%f")
    where = folder(options)
    where.mkdir(parents=True, exist_ok=True)
    path = where / f"held-{options.model}-{options.address}-{moment}.json"
    content = {
        "format": FORMAT, "model": options.model, "port": options.endpoint,
        "address": options.address, "rate": options.rate, "held": held,
        "option": options.family.transport_kind.option,
    }  # fmt: skip
    number, name = tempfile.mkstemp(dir=where, prefix=path.name)
    try:
        with os.fdopen(number, "w", encoding="utf-8") as file:
            json.dump(content, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    return path


def load(path: Path, model: str) -> Kept:
    """Read a file; raises UsageError for one that is none, or of another model."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        kept = Kept(
            str(content["model"]), str(content["port"]), int(content["address"]),
            None if content["rate"] is None else int(content["rate"]), dict(content["held"]),
            str(content.get("option", "")),
        )  # fmt: skip
        is_known = content["format"] == FORMAT
    except OSError as error:
        raise UsageError(f"--restore {path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UsageError(f"--restore {path}: it does not say what a device held") from error
    if not is_known:
        raise UsageError(f"--restore {path}: it is of another version of axistwin")
    if kept.model != model:
        raise UsageError(f"--restore {path}: it is of a device of model {kept.model}, not {model}")
    return kept


def understood(path: Path, kept: Kept, read: Callable[[Mapping[str, Any]], Any]) -> Any:
    """What the family makes of it; raises UsageError for what it cannot."""
    try:
        return read(kept.held)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(f"--restore {path}: it does not say what a device held") from error
