"""Where motion comes from: commands, a program or a recording for a twin; or a device on a port."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any, Final

from axistwin.cli.decode import READERS
from axistwin.cli.plot.track import MotionTrack
from axistwin.cli.plot.twin_motion import HostMessage
from axistwin.cli.send import exchanges, request_of
from axistwin.devices.controls import AxisReadout
from axistwin.devices.family import Model
from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_MS, NS_PER_S
from axistwin.wire.can_frame import CanFrame

_ON_LINE: Final = re.compile(r"\s*(?P<time>\d+(?:\.\d+)?)\s+(?:ms\s+)?(?P<way>[<>])\s")
_ON_BUS: Final = re.compile(r"\s*\((?P<time>\d+(?:\.\d+)?)\)\s.*\s(?P<way>[TR])\s*")
_FROM_HOST: Final = (">", "T")
_FORMS: Final = {
    "serial": "a recording of 'axistwin run --capture' has '1520.312 > 81 45 81 47'",
    "can": "a recording of 'axistwin run --capture' has '(12.5) vcan0 601#4000200000000000 T'",
}

REMARK: Final = "#"
"""Begins one, to the end of the line of a program."""

LIVE_TIMEOUT_S: Final = 1.0


def from_words(model: Model, address: int, texts: tuple[str, ...]) -> list[HostMessage]:
    """Commands as ``axistwin send`` takes them, one after the other.  Raises UsageError."""
    return [HostMessage(request_of(model, address, text)) for text in texts]


def from_program(model: Model, address: int, path: str) -> list[HostMessage]:
    """A file with one command in a line, each sent when all axes stand.  Raises UsageError."""
    messages = []
    for number, line in enumerate(_lines(path), 1):
        text = line.partition(REMARK)[0].strip()
        if not text:
            continue
        try:
            messages.append(HostMessage(request_of(model, address, text), waits=True))
        except UsageError as error:
            raise UsageError(f"{path}, line {number}: {error}") from None
    if not messages:
        raise UsageError(f"{path}: it has no command; write one in a line")
    return messages


def from_capture(model: Model, path: str) -> list[HostMessage]:
    """The host's half of a recording, with the replies that it has.  Raises UsageError."""
    sent: list[tuple[float, Any, list[Any]]] = []
    form, unit_ns = (_ON_BUS, NS_PER_S) if model.carrier == "can" else (_ON_LINE, NS_PER_MS)
    for number, line in enumerate(_lines(path), 1):
        if not line.strip() or line.lstrip().startswith(("#", "…")):
            continue
        found = READERS[model.carrier](line)
        match = form.match(line) if found is not None else None
        if found is None or match is None:
            raise UsageError(f"{path}, line {number}: {line[:60]!r}; {_FORMS[model.carrier]}")
        if match["way"] in _FROM_HOST and found.content is not None:
            sent.append((float(match["time"]) * unit_ns, found.content, []))
        elif sent and found.content is not None:
            sent[-1][2].append(found.content)
    if not sent:
        raise UsageError(f"{path}: it has nothing from a host; {_FORMS[model.carrier]}")
    origin_ns = sent[0][0]
    return [
        HostMessage(content, at_ns=round(time_ns - origin_ns), recorded=tuple(replies))
        for time_ns, content, replies in sent
    ]


def _lines(path: str) -> list[str]:
    """The lines of the file at ``path``.  Raises UsageError."""
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise UsageError(
            f"{path}: cannot be read ({error.strerror}); give an existing file"
        ) from None


def differing(messages: list[HostMessage], replies: list[list[Any]]) -> list[int]:
    """Which of ``messages`` got another reply than the recorded one."""

    def joined(parts: Any) -> Any:
        is_bytes = all(isinstance(part, bytes) for part in parts)
        return b"".join(parts) if is_bytes else list(parts)

    return [
        index
        for index, (message, reply) in enumerate(zip(messages, replies, strict=True))
        if joined(message.recorded) != joined(reply)
    ]


def read_out(
    model: Model,
    view: AxisReadout,
    place: str,
    address: int,
    requests: list[bytes | CanFrame | float],
    baud: int | None,
    span_s: float,
) -> MotionTrack:
    """The positions of the device at ``place``, asked as fast as it answers for ``span_s``.

    ``requests`` are sent first.  Rates are those between two answers.  Raises UsageError and
    PortError.
    """
    query: Any = model.family.compose(view.query, address)
    began_s = time.monotonic()

    def queries() -> Iterator[Any]:
        while time.monotonic() - began_s < span_s:
            yield query

    def is_whole(reply: bytes) -> bool:
        return model.family.is_whole(reply) or bool(re.search(view.answer, model.explain(reply)))

    times_s: list[float] = []
    positions: list[tuple[int, ...]] = []
    answers = exchanges(
        model, place, chain([query], requests, queries()), baud, LIVE_TIMEOUT_S, is_whole
    )
    for request, reply in answers:
        words = " ".join(model.explain(part) for part in reply)
        found = re.search(view.answer, words)
        if request is query and found is not None:
            times_s.append(time.monotonic() - began_s)
            positions.append(tuple(int(number) for number in found[1].split(",")))
    if not positions:
        raise UsageError(f"{place}: no position came back; is a {model.name} there, at {address}?")
    names = view.names[: len(positions[0])]
    return MotionTrack(names, view.unit, times_s, positions, _between(times_s, positions), True)


def _between(times_s: list[float], positions: list[tuple[int, ...]]) -> list[tuple[float, ...]]:
    """The mean rate from each instant to the next one; the last has that before it."""
    rates = [
        tuple(
            (after - before) / (end - begin) for before, after in zip(row, following, strict=True)
        )
        for begin, end, row, following in zip(
            times_s, times_s[1:], positions, positions[1:], strict=False
        )
    ]
    return [*rates, rates[-1] if rates else (0.0,) * len(positions[0])]
