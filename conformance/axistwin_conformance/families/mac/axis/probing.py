"""What probes of the axis share: what a kind of reply to a command stands for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.core.probing import Outcome
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind

MOVES: Final = ("motion", "stored")
ACCEPTED_OR_REFUSED: Final = {ReplyKind.ACCEPTED: 0, ReplyKind.REFUSED: 1}


def reply_of(
    exchange_kind: ReplyKind, readings: Mapping[ReplyKind, int], what: str = "the reply"
) -> Outcome:
    """The reading a kind of reply stands for, or what came instead."""
    return readings.get(exchange_kind, f"{what} is {exchange_kind.value}")
