"""Whether the unit has the addresses that the operator has named.

How large the data area is, nobody has written (§5.2); it is in the listing of the macroprogram.  An
address outside of it draws NAK, as one would that a faulty unit refuses.  What tells them apart is
where the refused ones lie: a data area is one stretch of addresses.  What was named beyond its ends
is the operator's mistake; a unit that refuses an address between others that it serves, or that it
has just served, DREAD where it serves BREAD, or a flag too, is left to the checks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.safety import MOST_FLAGS
from axistwin_conformance.families.msc.scratch import (
    SAFE_BLOCK,
    SAFE_STRIDE,
    known_scratch,
    scratch_of,
)

SAMPLES: Final = 16  # addresses from the first to the last that are looked at
RUNNING, LOADING = 1, 1 << 10  # of the status word (MSC-AMB-32)
REMEDY: Final = "name addresses that the data table of its macroprogram's listing gives"


def check_spans(session: Session) -> None:
    """Read the ends of what has been named; raises UsageError for what this unit has not.

    What the built-in twin has of its own is known, and whatever it refuses there is its fault.
    """
    scratch, own = scratch_of(session), known_scratch(session)
    spans = [("variables", scratch.variables, scratch.variables == own.variables)]
    spans.append(("bench-program", scratch.of_program[0], scratch.program == own.program))
    for name, span, is_known in spans:
        places = [place for place in span if place % SAFE_STRIDE == 0]
        if not places or is_known:
            continue
        if found := _DataAreaLook(MscDriver(session), span, places).at_the_ends():
            raise UsageError(f"--{name} {scratch.named[name]}: {found}")


class _DataAreaLook:
    """A look at the addresses of one span."""

    def __init__(self, driver: MscDriver, span: range, places: Sequence[int]) -> None:
        self._driver, self._span, self._places = driver, span, places
        self._known: dict[int, bool] = {}  # address → whether it is refused

    def at_the_ends(self) -> str:
        """What of the span lies outside the data area, and what to do; empty: nothing does."""
        places = self._places
        refused = [
            place for place in dict.fromkeys((places[0], places[-1])) if self._is_refused(place)
        ]
        if not refused:
            return ""
        looked = sorted({*places[:: -(-len(places) // SAMPLES)], places[-1]})
        served = [place for place in looked if not self._is_refused(place)]
        if not served:
            return "" if self._is_to_blame() else self._all_refused()
        if any(self._is_refused(place) for place in looked if served[0] < place < served[-1]):
            return ""
        if self._draws_nak(codec.dread(served[0])):
            return ""
        low = self._edge(
            served[0], max((place for place in looked if place < served[0]), default=None)
        )
        high = self._edge(
            served[-1], min((place for place in looked if place > served[-1]), default=None)
        )
        there = f"{max(low, self._span.start)}-{min(high + SAFE_STRIDE, self._span.stop) - 1}"
        return (
            f"this unit refuses {_listed(refused)} (NAK): its data area has of these {there} alone;"
            f" name what is within it"
        )

    def _all_refused(self) -> str:
        first, last = self._places[0], self._places[-1]
        what = f"{first}" if first == last else f"{first}, {last} and what was tried between"
        identity = self._driver.session.run.identity
        status = identity.values["status"] if identity else ""
        if status.isdecimal() and int(status) & (LOADING | RUNNING) != RUNNING:
            return (
                f"this unit refuses {what} (NAK), perhaps because no program runs in it (status"
                f" {status}): start that; or {REMEDY}"
            )
        return f"this unit refuses {what} (NAK): outside of its data area; {REMEDY}"

    def _edge(self, served: int, refused: int | None) -> int:
        """The last place that is served on the way to one that is refused; without one, itself."""
        while refused is not None and abs(refused - served) > SAFE_STRIDE:
            middle = (served + refused) // 2 // SAFE_STRIDE * SAFE_STRIDE
            if self._is_refused(middle):
                refused = middle
            else:
                served = middle
        return served

    def _is_to_blame(self) -> bool:
        """True if BREAD is served where DREAD is not, or what every unit has is refused as well."""
        first = self._places[0]
        if any(self._draws_nak(codec.rflag(number)) for number in (0, MOST_FLAGS - 1)):
            return True
        return first + SAFE_BLOCK <= self._span.stop and not self._draws_nak(codec.bread(first))

    def _is_refused(self, address: int) -> bool:
        if address not in self._known:
            self._known[address] = self._draws_nak(codec.dread(address))
        return self._known[address]

    def _draws_nak(self, body: bytes) -> bool:
        """True for NAK, time after time where noise is possible; all else is for the checks."""
        return self._driver.ask(body).is_naked


def _listed(places: Sequence[int]) -> str:
    return " and ".join(map(str, places))
