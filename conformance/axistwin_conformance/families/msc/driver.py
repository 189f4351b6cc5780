"""One MSC unit as checks handle it: typed questions and orders, and what its answers must be.

`client` asks as checks of the answer itself do; `link` judges signs, repeats and times; `scratch`
has the places that may be used.  `read`, `status` and the other typed questions go on only with the
answer they ask for.  What is written is put back by the family after each check.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.core.session import SHOWN, Session
from axistwin_conformance.core.wording import Observation
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.client import MscClient, MscExchange
from axistwin_conformance.families.msc.codec import RQSTAT, Packet
from axistwin_conformance.families.msc.link import MscLink, Names
from axistwin_conformance.families.msc.scratch import SAFE_BLOCK, ScratchPlaces

POLL_S: Final = 0.02

Readings = Mapping[str, str | tuple[str, ...]]

# What a packet may draw, in words.
ACKED: Final = "ACK and nothing more"
SERVED: Final = "ACK and a reply"
NAKED: Final = "NAK"
SILENCE: Final = "silence"

# What an unknown command draws, and what that says of MSC-AMB-04.
AS_UNKNOWN: Final[Readings] = {NAKED: "nak", ACKED: "ack_ignore", SILENCE: "silent"}


class MscDriver:
    """A unit of the MSC family, and the session in which it is asked."""

    def __init__(self, session: Session, unit: int | None = None) -> None:
        self.session = session
        self.client = MscClient(session, unit)
        self.link = MscLink(self.client)
        self.scratch = ScratchPlaces(session)
        self.unit = self.client.unit
        self.target = session.target

    # --- what is known of the unit ----------------------------------------------------------------

    @property
    def has_rflags(self) -> bool:
        """True for the models that the manual gives RFLAGS (MSC-MOD-01)."""
        return bool(self.session.run.model.facts.has_rflags)

    def reading(
        self,
        switch: str,
        seen: str | Sequence[str],
        requirement: str | Sequence[str] | None = None,
        shown: Observation = SHOWN,
    ) -> None:
        """Judge which reading of an ambiguity the device follows here; see `Session.quirk`."""
        self.session.quirk(requirement, switch, seen, shown)

    # --- asking -----------------------------------------------------------------------------------

    def ask(self, body: bytes, block: int = 0, **how: Any) -> MscExchange:
        """Send a sound packet with that body; `how` is as `MscClient.ask` takes it."""
        return self.client.ask(self.client.request(body, block), **how)

    def query(self, body: bytes, block: int = 0) -> Packet:
        """Ask one of the reading commands; go on only with the reply it must have.

        Between checks nothing is judged: there it is asked again once the line is at rest.
        """
        name = codec.name_of(body)
        exchange = self.ask(body, block)
        for _ in range(0 if self.session.check is not None else RETRY.recovery - 1):
            if self.client.is_right(exchange, name):
                break
            self.client.wait_until_quiet()
            exchange = self.ask(body, block)
        size = self.client.reply_bytes(name)
        is_right = self.client.is_right(exchange, name)
        self.session.step(is_right, f"ACK and a {name} reply of {size} bytes", exchange)
        assert exchange.reply is not None, "the step above has seen to it"
        return exchange.reply

    def command(self, body: bytes) -> MscExchange:
        """Send one of the writing commands and go on with its ACK."""
        exchange = self.ask(body)
        text = codec.explain_request(exchange.request)
        self.session.step(exchange.sign == codec.ACK, f"ACK to {text}", exchange)
        return exchange

    def read(self, address: int) -> int:
        """The value at an address."""
        return self.query(codec.dread(address)).values[0]

    def read_block(self, address: int) -> tuple[int, ...]:
        """The 32 values from an address on."""
        return self.query(codec.bread(address)).values

    def write(self, address: int, value: int) -> MscExchange:
        """Write a value."""
        return self.command(codec.dwrite(address, value))

    def write_block(self, address: int, values: Iterable[int]) -> MscExchange:
        """Write 32 values from an address on."""
        return self.command(codec.bwrite(address, values))

    def flag(self, number: int) -> bool:
        """Whether a flag is on."""
        state = self.query(codec.rflag(number)).numbers[0]
        self.session.step(state in (0, 1), "0 or 1", state)
        return bool(state)

    def flags(self) -> bytes | None:
        """The 32 bytes of all flags; None on a model without RFLAGS."""
        return self.query(codec.RFLAGS).payload if self.has_rflags else None

    def status(self) -> int:
        """The macroprogram's status word."""
        return self.query(codec.RQSTAT).numbers[0]

    def until(self, is_so: Callable[[], bool], within_s: float) -> bool:
        """Ask until it is so; False if it is not when that is asked after so long: an answer may
        tell what was so when it was asked, however late it comes."""
        deadline_ns = self.target.now_ns + round(within_s * 1e9)
        while True:
            asked_ns = self.target.now_ns
            if is_so():
                return True
            if asked_ns >= deadline_ns:
                return False
            self.target.wait(POLL_S)

    def in_time(self, since_ns: int, limit_s: float, what: str) -> None:
        """Give the attempt up if so long has passed since then: what is seen then tells nothing."""
        passed_s = (self.target.now_ns - since_ns) / 1e9
        if passed_s > limit_s:
            self.session.void_attempt(
                f"{what} lasts {limit_s * 1000:.0f} ms and was looked at within"
                f" {passed_s * 1000:.0f}: this line or this host is too slow"
            )

    def set_flag(self, number: int) -> MscExchange:
        """Turn a flag on; never sent twice."""
        return self.command(codec.sflag(number))

    def clear_flag(self, number: int) -> MscExchange:
        """Turn a flag off; never sent twice."""
        return self.command(codec.cflag(number))

    def values(self, count: int) -> list[int]:
        """So many different values, none of them 0, in all four bytes of each something else."""
        drawn: set[int] = set()
        while len(drawn) < count:
            value = bytes(self.session.random.sample(range(1, 256), 4))
            drawn.add(int.from_bytes(value, "big", signed=True))
        return self.session.random.sample(sorted(drawn), count)

    def reads(self) -> list[bytes]:
        """The bodies of all reading commands that this unit has and that need nothing named, and
        those of the named variables."""
        bodies = [RQSTAT, codec.rflag(0), codec.rflag(255)]
        bodies += [codec.RFLAGS] if self.has_rflags else []
        for address in self.scratch.spots(1):
            bodies.append(codec.dread(address))
            if address + SAFE_BLOCK - 1 in self.scratch.variables:
                bodies.append(codec.bread(address))
        return bodies

    # --- judging what a packet draws --------------------------------------------------------------

    def served(self, body: bytes, names: Names | None, what: str) -> Packet:
        """Judge that a reading command draws ACK and a reply, in words `what`; the reply."""
        exchange = self.ask(body)
        is_served = exchange.is_acked and exchange.reply is not None
        self.session.expect(is_served, names, f"ACK, and {what}", exchange.observed)
        assert exchange.reply is not None
        return exchange.reply

    def draws(self, raw: bytes) -> tuple[str, MscExchange]:
        """Send bytes; what they draw, in the words above, or as received if it is none of those."""
        exchange = self.client.ask(raw, is_read=True)
        kind = str(exchange)
        if exchange.is_naked:
            kind = NAKED
        elif exchange.is_silence:
            kind = SILENCE
        elif exchange.is_acked:
            is_bare = exchange.reply is None or self._is_empty(exchange.reply)
            kind = ACKED if is_bare else SERVED
        return kind, exchange

    def _is_empty(self, reply: Packet) -> bool:
        """True for what a device says behind the ACK to a write that packs that up as well."""
        is_packed = self.session.reading("write_reply") == "empty_packet"
        return is_packed and reply.is_sound and reply.name in codec.WRITES and not reply.payload

    def follows(self, raw: bytes, switch: str, readings: Readings, names: Names) -> MscExchange:
        """Judge that a packet draws what some reading of a switch admits, then nothing more, and
        which one that is."""
        kind, exchange = self.draws(raw)
        text = codec.explain_request(raw)
        if kind not in readings:
            self.session.fail(names, tuple(readings), exchange, f"to {text}")
        if exchange.reply is not None:
            self.session.expect(exchange.reply.is_sound, names, "a sound reply", exchange)
        self.reading(switch, readings[kind], names)
        self.link.nothing_more(names, text)
        return exchange

    @property
    def as_unknown(self) -> str:
        """What an unknown command draws from this device (MSC-AMB-04)."""
        held = self.session.reading("unknown_command")
        return next(kind for kind, reading in AS_UNKNOWN.items() if reading == held)

    # --- flags ------------------------------------------------------------------------------------

    def turn(self, number: int, *, on: bool) -> None:
        """Turn a user flag on or off."""
        if on:
            self.set_flag(number)
        else:
            self.clear_flag(number)

    def flags_at_once(self) -> frozenset[int]:
        """All flags that are on, by RFLAGS."""
        states = self.flags()
        assert states is not None, "only where the model has RFLAGS"
        return codec.flags_on(states)
