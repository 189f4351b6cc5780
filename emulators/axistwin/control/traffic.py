"""Messages of a line as the control API has them: in hex, in words, and whose they are.

Nothing here is known of a family but what it declares: how it explains bytes or frames, and how it
names a unit in that (``Family.unit_named``).
"""

import re
from collections.abc import Callable, Iterator
from itertools import islice

from axistwin.catalog import find_model
from axistwin.control.models import Direction, TrafficMessage
from axistwin.errors import UsageError
from axistwin.runtime.serving.rack import AnyServer
from axistwin.runtime.transcript import Message
from axistwin.wire.can_frame import CanFrame

_FRAME_SIGNS = re.compile(r"[0-9A-F#R]*")


class TrafficWords:
    """Describes messages of the line that ``server`` serves."""

    def __init__(self, server: AnyServer) -> None:
        self._simulation = server.simulation
        family = find_model(server.simulation.twins[0].model).family
        self._unit = re.compile(family.unit_named)

    def describe(self, message: Message) -> TrafficMessage:
        """``message`` for programs and people."""
        content = message.content
        text = message.note or self._simulation.explain(content)
        unit = self._unit.search(text)
        return TrafficMessage(
            time_ns=message.time_ns,
            direction=message.direction,
            hex=_shown(content),
            text=text,
            unit=int(unit[1]) if unit and not message.note else None,
        )


def _shown(content: bytes | CanFrame) -> str:
    return str(content) if isinstance(content, CanFrame) else content.hex(" ").upper()


def select(
    words: TrafficWords,
    messages: list[Message],
    *,
    last: int,
    text: str,
    hexes: str,
    direction: Direction | None,
) -> list[TrafficMessage]:
    """The ``last`` of those of ``messages`` that have ``text`` in their words, ``hexes`` in their
    bytes, and this ``direction``; empty, and None: any.  Raises UsageError.
    """
    has_hex = _hex_filter(hexes)

    def found() -> Iterator[TrafficMessage]:
        for message in reversed(messages):
            if (direction and message.direction != direction) or not has_hex(message.content):
                continue
            described = words.describe(message)
            if text.lower() in described.text.lower():
                yield described

    return list(islice(found(), last))[::-1]


def _hex_filter(hexes: str) -> Callable[[bytes | CanFrame], bool]:
    """Whether bytes have ``hexes`` in them, or a frame as candump writes it has."""
    digits = re.sub(r"[\s:]", "", hexes).upper()
    if not _FRAME_SIGNS.fullmatch(digits):
        raise UsageError(f"hex {hexes!r} is not hexadecimal; write 06 13, or 601#4000 of a frame")

    def has(content: bytes | CanFrame) -> bool:
        if isinstance(content, CanFrame):
            return digits in str(content)
        at = content.hex().upper().find(digits)
        while at > 0 and at % 2:  # half a byte and half of the next
            at = content.hex().upper().find(digits, at + 1)
        return at >= 0

    return has
