"""Where motion comes from: commands, a program or a recording for a twin; or a device on a port."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import Any, Final

from axistwin.cli.plot.track import MotionTrack
from axistwin.cli.plot.twin_motion import HostMessage
from axistwin.cli.replay.capture import Exchange, lines_of
from axistwin.cli.send import exchanges, request_of
from axistwin.devices.controls import AxisReadout
from axistwin.devices.family import Model
from axistwin.errors import UsageError
from axistwin.wire.can_frame import CanFrame

REMARK: Final = "#"
"""Begins one, to the end of the line of a program."""

LIVE_TIMEOUT_S: Final = 1.0


def from_words(model: Model, address: int, texts: tuple[str, ...]) -> list[HostMessage]:
    """Commands as ``axistwin send`` takes them, one after the other.  Raises UsageError."""
    return [HostMessage(request_of(model, address, text)) for text in texts]


def from_program(model: Model, address: int, path: str) -> list[HostMessage]:
    """A file with one command in a line, each sent when all axes stand.  Raises UsageError."""
    messages = []
    for number, line in enumerate(lines_of(path), 1):
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


def from_exchanges(exchanges: Iterable[Exchange]) -> list[HostMessage]:
    """The host's half of a recording, at its times."""
    return [HostMessage(each.request.content, at_ns=each.request.at_ns) for each in exchanges]


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
