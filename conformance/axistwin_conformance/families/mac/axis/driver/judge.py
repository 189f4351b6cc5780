"""What the replies of an axis are held to."""

from __future__ import annotations

from typing import Any

from axistwin_conformance.core.probing import Probe
from axistwin_conformance.core.session import SHOWN
from axistwin_conformance.core.wording import Observation
from axistwin_conformance.families.mac.axis.driver.client import AxisClient, AxisExchange, Part
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind


class AxisJudge:
    """Judges replies of one module."""

    def __init__(self, client: AxisClient) -> None:
        self._client, self._session = client, client.session

    def must(
        self, kind: ReplyKind, exchange: AxisExchange, requirement: Part = None
    ) -> AxisExchange:
        """Judge that the reply is of that kind.

        Without a requirement it is a step on the way: a wrong reply fails all the check names, but
        a right one proves none of them when there are several.
        """
        is_so, wanted = exchange.kind is kind, self._client.wanted(kind)
        self.holds(is_so, requirement, wanted, lambda: self._client.observed(exchange))
        return exchange

    def holds(self, condition: bool, requirement: Part, expected: str, actual: object) -> None:
        """Judge a requirement; without one, in a check that names several, it is a step."""
        check = self._session.check
        if requirement is None and check is not None and len(check.requirements) > 1:
            self._session.step(condition, expected, actual)
        else:
            self._session.expect(condition, requirement, expected, actual)

    def accepted(
        self, index: int, parameter: int = 0, sub_index: int = 0, requirement: Part = None
    ) -> AxisExchange:
        """Send a command that must be accepted."""
        exchange = self._client.command(index, parameter, sub_index)
        return self.must(ReplyKind.ACCEPTED, exchange, requirement)

    def refused(
        self, index: int, parameter: int = 0, sub_index: int = 0, requirement: Part = None
    ) -> AxisExchange:
        """Send a command that must be refused."""
        exchange = self._client.command(index, parameter, sub_index)
        return self.must(ReplyKind.REFUSED, exchange, requirement)

    def silent(self, request: Any, requirement: Part = None) -> None:
        """Judge that a frame gets no reply: none now, and exactly one to the next query."""
        is_silent, expected, actual = self._client.silence_after(request)
        self.holds(is_silent, requirement, expected, actual)
        self.alive(requirement)

    def alive(self, requirement: Part = None) -> None:
        """Judge that the module answers a good query, once."""
        self.must(ReplyKind.ANSWER, self._client.ask(0x20), requirement)

    def reading(
        self,
        switch: str,
        outcome: int | tuple[int, ...] | str,
        requirement: Part = None,
        shown: Observation = SHOWN,
    ) -> None:
        """Judge an ambiguity: `outcome` is the number of the reading seen, 0 the default, or the
        numbers of those that explain what was seen, or a sentence about what came if none does;
        `shown`: see `Session.quirk`."""
        session = self._session
        readings = session.run.ledger.ambiguity_of(switch).switches[switch]
        if isinstance(outcome, str):
            session.no_reading(requirement, switch, readings, outcome, shown)
        numbers = (outcome,) if isinstance(outcome, int) else outcome
        session.quirk(requirement, switch, [readings[number] for number in numbers], shown)
        session.expect(True, requirement, readings, "one of them")

    def again(self, probe: Probe, requirement: Part = None) -> None:
        """Ask a probe's question again and judge that the device reads it as it did."""
        session, seen = self._session, probe.look(self._session)
        if not seen.readings:
            readings = session.run.ledger.ambiguity_of(probe.switch).switches[probe.switch]
            session.no_reading(requirement, probe.switch, readings, seen.evidence)
        session.quirk(requirement, probe.switch, seen.readings)
        session.expect(True, requirement, seen.readings, "one of them")
