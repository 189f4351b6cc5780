"""The ladder: a device is judged by how it answers the engine itself, and the run climbs on.

    contact → framing → identity → snapshot → readings → checks

Rules.

1. When a rung does not hold, what came is read under the family's lenient grammar.  A departure
   that is there time after time, by the same bytes, fails the requirement it breaks; noise does not
   do that (`LineQuality.alike_needed`).
2. From then on replies are mended, for exactly those departures, before anybody below the checks
   reads them; on every line of the run, and on that of a fresh twin as well.
3. A check that is about nothing else than what has failed so, reads replies as they come; any other
   one reads them mended, and does not say that the requirement holds.
4. What rests on a reply that cannot be mended is not run, because of what it breaks.
5. Silence, and what is none of this protocol, is left to whoever asked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.lenient import (
    COMPLETENESS,
    Mending,
    ReplyDeparture,
    SteadyReply,
    steady_replies,
)
from axistwin_conformance.core.session import Run, Session

MENDED = "it has failed already: replies are read here as if it held"


@dataclass(slots=True)
class Ladder:
    """What a device departs by, and what replies are mended for."""

    family: Family
    judged: dict[tuple[str, str], ReplyDeparture] = field(default_factory=dict)
    known: dict[tuple[str, str], ReplyDeparture] = field(default_factory=dict)  # what can be mended

    def climb(self, session: Session, needed: int) -> Iterator[tuple[ReplyDeparture, SteadyReply]]:
        """What is new in the replies of a session that came `needed` times alike; once all is
        taken, replies are mended for what can be."""

        read = partial(self.family.lenient, session)
        for steady in steady_replies(session.records(), read, needed):
            for one in steady.lenient.departures:
                if steady.lenient.mended and one.name != COMPLETENESS:
                    self.known[one.key] = one
                if one.key not in self.judged:
                    self.judged[one.key] = one
                    yield one, steady
        self.equip(session.run)

    def equip(self, run: Run) -> None:
        """Let the replies of this run's device be mended for what is known."""
        if not self.known or run.target.mender is not None:
            return
        session = Session(run)
        run.target.mender = Mending(
            partial(self.family.lenient, session),
            lambda request: self.family.diagnose(session, request, None) is not None,
            self.known,
        )

    def mended(self, session: Session, request: bytes, reply: bytes) -> bytes:
        """A reply as it is handed on."""
        lenient = self.family.lenient(session, request, reply) if self.known else None
        if lenient is None or not {one.key for one in lenient.departures} <= self.known.keys():
            return reply
        return lenient.mended


def read_as_fits(run: Run, check: Check | None = None) -> None:
    """Have replies handed on to a check mended or as they come (rule 3); mended where none runs."""
    mending = run.target.mender
    if isinstance(mending, Mending):
        mending.is_off = check is not None and mending.requirements.issuperset(check.requirements)


def unproven(run: Run, findings: tuple[Finding, ...]) -> tuple[Finding, ...]:
    """The findings of a check that may have read mended replies."""
    mending = run.target.mender
    if not isinstance(mending, Mending):
        return findings
    return tuple(
        replace(one, verdict=Verdict.NOT_RUN, text=MENDED)
        if one.requirement in mending.requirements and one.verdict in (Verdict.PASS, Verdict.QUIRK)
        else one
        for one in findings
    )
