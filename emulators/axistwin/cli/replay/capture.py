"""A recording, read back as exchanges.

An exchange is what the host said, and all that the device said before the host spoke again.  What
the device said before the host said anything is left out.

A recording of a bus by who is not between host and device has no directions, or the same for all
frames, as candump's on their machine.  The model tells then who sends such a frame.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from axistwin.cli.decode import READERS
from axistwin.devices.family import Carrier, Model
from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.wire.can_frame import CanFrame

_ON_LINE: Final = re.compile(r"\s*(?P<time>\d+(?:\.\d+)?)\s+(?:ms\s+)?(?P<way>[<>])\s")
_ON_BUS: Final = re.compile(
    r"\s*\((?P<time>\d+(?:\.\d+)?)\)\s\S+\s+\S+(?:\s(?P<way>[TR]))?(?:\s{2}|\s*$)"
)
_FROM_HOST: Final = (">", "T")
_FORMS: Final = {
    "serial": "a recording of 'axistwin run --capture' has '1520.312 > 81 45 81 47'",
    "can": "a recording of 'axistwin run --capture' has '(12.5) vcan0 601#4000200000000000 T'",
}


@dataclass(frozen=True, slots=True)
class CapturedPart:
    """A frame, or bytes without a pause, of which the first was complete at ``at_ns``."""

    at_ns: Nanos
    content: bytes | CanFrame


@dataclass(frozen=True, slots=True)
class Exchange:
    """What the host said, and what came back; times count from the first exchange."""

    request: CapturedPart
    reply: tuple[CapturedPart, ...]


def read_capture(model: Model, path: str) -> list[Exchange]:
    """The exchanges of the recording at ``path``, at least one.  Raises UsageError."""
    rows = list(_rows(model.carrier, path))
    if model.carrier == "can" and len({way for way, _ in rows}) == 1:
        # Recorded by who heard both alike: nothing tells host and device apart but the frames.
        is_from_device = model.family.is_from_device
        rows = [("R" if is_from_device(part.content) else "T", part) for _, part in rows]
    sent: list[tuple[CapturedPart, list[CapturedPart]]] = []
    for way, part in rows:
        if way in _FROM_HOST:
            sent.append((part, []))
        elif sent:
            sent[-1][1].append(part)
    if not sent:
        raise UsageError(f"{path}: it has nothing from a host; {_FORMS[model.carrier]}")
    origin_ns = sent[0][0].at_ns

    def counted(part: CapturedPart) -> CapturedPart:
        return CapturedPart(part.at_ns - origin_ns, part.content)

    return [Exchange(counted(part), tuple(map(counted, reply))) for part, reply in sent]


def _rows(carrier: Carrier, path: str) -> Iterator[tuple[str, CapturedPart]]:
    """What the recording has, each with its direction.  Raises UsageError."""
    for number, line in enumerate(lines_of(path), 1):
        if not line.strip() or line.lstrip().startswith(("#", "…")):
            continue
        found = READERS[carrier](line)
        match = (_ON_BUS if carrier == "can" else _ON_LINE).match(line) if found else None
        if found is None or match is None:
            raise UsageError(f"{path}, line {number}: {line[:60]!r}; {_FORMS[carrier]}")
        if found.content is None:
            continue
        at_ns = _nanos(match["time"], NS_PER_S if carrier == "can" else NS_PER_MS)
        yield match["way"] or "", CapturedPart(at_ns, found.content)


def lines_of(path: str) -> list[str]:
    """The lines of the file at ``path``.  Raises UsageError."""
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise UsageError(
            f"{path}: cannot be read ({error.strerror}); give an existing file"
        ) from None


def _nanos(digits: str, unit_ns: Nanos) -> Nanos:
    """Exactly, since seconds since the epoch have more digits than a float."""
    whole, _, behind = digits.partition(".")
    behind = f"{behind[:9]:0<9}"
    return int(whole) * unit_ns + int(behind) * unit_ns // NS_PER_S
