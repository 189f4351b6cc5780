"""A motion that is acknowledged and does not begin, when the same one right behind it does.

On a line that corrupts frames a check that fails once and then holds is settled by more attempts.
Here none of them would tell more: two equal requests were acknowledged, one of them was obeyed, and
nothing has gone wrong on the way in the whole run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from axistwin_conformance.families.mac.axis.driver.client import AxisClient
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import Forecast

BEGINS_S: Final = 0.3  # a motion without an end has surely begun by then
SETTLED_NS: Final = 100_000_000


@dataclass(frozen=True, slots=True)
class Begun:
    """A command that was acknowledged at rest, and what to expect of it."""

    forecast: Forecast
    index: int
    parameter: int


def undone(client: AxisClient, begun: Begun | None, forecast: Forecast) -> str:
    """Where an axis has not moved at all: send the same again.  What that shows, in words; empty if
    it moved the first time, or does not the second time, or if noise may be the reason."""
    session, quality = client.session, client.session.run.quality
    target = client.target
    is_spotless = not (quality.corrupted or quality.late or target.lateness.recent)
    if begun is None or begun.forecast is not forecast or target.is_lossless or not is_spotless:
        return ""
    origin, end = forecast.timelines[0].origin, forecast.end
    lasting_s = BEGINS_S
    if end is not None:
        client.wait_until(end.latest_ns + SETTLED_NS)
        lasting_s += max(0, end.latest_ns - forecast.timelines[0].start_ns) / 1e9
    if client.position() != origin or session.retries:
        return ""
    if client.command(begun.index, begun.parameter).kind is not ReplyKind.ACCEPTED:
        return ""
    client.wait(lasting_s)
    moved = client.position()
    if moved == origin or (end is not None and moved not in range(*_span(forecast))):
        return ""
    if session.retries or quality.corrupted or quality.late:
        return ""
    session.is_replayed = True
    named = client.named(begun.index)
    return (
        f"; the same {named} sent again moved it to {moved}, and nothing was disturbed on the way"
    )


def _span(forecast: Forecast) -> tuple[int, int]:
    lowest, highest = forecast.final
    return lowest, highest + 1
