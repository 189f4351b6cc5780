"""Which quirks explain that a device says something else than its twin.

Rules
-----
1. Every quirk is tried by itself with every value; a number with its limits, half and double of its
   default, and the numbers in the recorded replies that differ.
2. What leaves the fewest differences is kept.  While some are left, another quirk is looked for
   beside it, up to ``QUIRKS_MAX`` in all.
3. Of equals the first one in the model's list is kept; the others are named.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from axistwin.cli.replay.capture import Exchange
from axistwin.cli.replay.comparison import Difference, SameSoon, differences
from axistwin.cli.replay.host_port import TwinSetup
from axistwin.cli.replay.moments import words_of
from axistwin.devices.family import Value
from axistwin.devices.switches import Quirk
from axistwin.errors import UsageError
from axistwin.kernel.time import Nanos

QUIRKS_MAX: Final = 2

_NUMBERS_MAX: Final = 8
"""From the recorded replies."""


@dataclass(slots=True)
class Proposal:
    """The quirks to be ``added``, how many differences are ``left``, and what does as well."""

    left: int
    added: dict[str, Value] = field(default_factory=dict)
    ties: list[tuple[str, Value]] = field(default_factory=list)


def inferred(
    setup: TwinSetup,
    exchanges: Sequence[Exchange],
    found: Sequence[Difference],
    window_ns: Nanos,
    known: SameSoon,
) -> Proposal:
    """The quirks that explain most of what was ``found`` (rules 1 to 3); ``known`` with it."""
    proposal = Proposal(len(found))
    numbers = _numbers_in(setup, found)
    while proposal.left and len(proposal.added) < QUIRKS_MAX:
        base = {**setup.quirks, **proposal.added}
        best, ties = proposal.left, list[tuple[str, Value]]()
        for name, value in _candidates(setup.model.quirks, base, numbers):
            try:
                tried = replace(setup, quirks={**base, name: value})
                left = len(differences(tried, exchanges, window_ns, known))
            except UsageError:  # it does not go with another quirk
                continue
            if left < best:
                best, ties = left, []
            if left == best < proposal.left:
                ties.append((name, value))
        if not ties:
            break
        (name, value), *proposal.ties = ties
        proposal.added[name], proposal.left = value, best
    return proposal


def _candidates(
    known: Mapping[str, Quirk], base: Mapping[str, Value], numbers: Sequence[int]
) -> Iterator[tuple[str, Value]]:
    """Every quirk with every value that it does not have (rule 1)."""
    for name, quirk in known.items():
        present = quirk.parse(base.get(name, quirk.default))
        values: Sequence[Value]
        if quirk.kind == "text":
            continue
        if quirk.kind == "number":
            default = quirk.parse(quirk.default)
            assert isinstance(default, int)
            tried = [quirk.low, quirk.high, default // 2, default * 2, *numbers]
            values = [each for each in dict.fromkeys(tried) if quirk.low <= each <= quirk.high]
        else:
            values = quirk.choices or (True, False)
        for value in values:
            if value != present:
                yield name, value


def _numbers_in(setup: TwinSetup, found: Sequence[Difference]) -> list[int]:
    """Numbers that the recorded replies have in words."""
    words = " ".join(setup.model.explain(part) for each in found for part in each.recorded)
    return list(dict.fromkeys(words_of(words).numbers))[:_NUMBERS_MAX]
