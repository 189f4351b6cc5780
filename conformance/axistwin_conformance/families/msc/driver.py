"""One MSC unit as checks handle it: typed hands over `talk`, and what the operator has named.

`read`, `status` and the other typed questions go on only with the answer they ask for; a check that
is about the answer itself asks `talk` and judges the `Exchange`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.client import Exchange, Talk
from axistwin_conformance.families.msc.codec import Packet
from axistwin_conformance.families.msc.options import ScratchArea
from axistwin_conformance.families.msc.safety import may_set, may_write

SAFE_STRIDE: Final = 4  # addresses so far apart are different variables in every reading (§5.2)
SAFE_BLOCK: Final = 128  # and so are blocks
HOOK_ATTEMPTS: Final = 3  # between checks
RS232_UNIT: Final = 1  # MSC-PKT-04


class Bench:
    """A unit of the MSC family, and the session in which it is asked."""

    def __init__(self, session: Session, unit: int | None = None) -> None:
        self.session = session
        self.talk = Talk(session, unit)
        self.unit = self.talk.unit
        self.target = session.target

    # --- what is known of the unit and of what may be changed -------------------------------------

    @property
    def variables(self) -> range:
        """The addresses the operator has named as free; none named: empty."""
        scratch: ScratchArea = self.session.run.settings
        return scratch.variables

    @property
    def flags_free(self) -> range:
        """The flags the operator has named as free; none named: empty."""
        scratch: ScratchArea = self.session.run.settings
        return scratch.flags

    def may_write(self, address: int, values: int = 1) -> bool:
        """True if so many values from an address on may be written in this check."""
        return may_write(self.session.run, address, values, has_program=self._has_program)

    def may_set(self, number: int) -> bool:
        """True if a flag may be set and cleared in this check."""
        return may_set(self.session.run, number, has_program=self._has_program)

    @property
    def _has_program(self) -> bool:
        return self.session.check is not None and "program" in self.session.check.needs

    @property
    def stride(self) -> int:
        """How far apart the values of a block are, in this device's reading (MSC-AMB-18)."""
        return int(self.session.reading("data_address_stride"))

    @property
    def is_rs485(self) -> bool:
        """True if the unit can only be on RS-485: not number 1, or not alone (MSC-PKT-04)."""
        return self.unit != RS232_UNIT or bool(self.session.neighbours)

    @property
    def has_rflags(self) -> bool:
        """True for the models that the manual gives RFLAGS (MSC-MOD-01)."""
        return bool(self.session.run.model.facts.has_rflags)

    @property
    def packet_timeout_s(self) -> float:
        """T1, as measured in this run or by default (MSC-AMB-03)."""
        return self.talk.packet_timeout_s

    @property
    def ack_timeout_s(self) -> float:
        """T2, as measured in this run or by default (MSC-AMB-02)."""
        return self.talk.ack_timeout_s

    def reading(
        self, switch: str, seen: str | Sequence[str], requirement: str | Sequence[str] | None = None
    ) -> None:
        """Judge which reading of an ambiguity the device follows here; see `Session.quirk`."""
        self.session.quirk(requirement, switch, seen)

    # --- asking -----------------------------------------------------------------------------------

    def ask(self, body: bytes, block: int = 0, **how: Any) -> Exchange:
        """Send a sound packet with that body; `how` is as `Talk.ask` takes it."""
        return self.talk.ask(self.talk.request(body, block), **how)

    def query(self, body: bytes, block: int = 0) -> Packet:
        """Ask one of the reading commands; go on only with the reply it must have.

        Between checks nothing is judged: there it is asked again once the line is at rest.
        """
        name = body.partition(codec.COMMA)[0].decode()
        exchange = self.ask(body, block)
        for _ in range(0 if self.session.check is not None else HOOK_ATTEMPTS - 1):
            if self._is_right(exchange, name):
                break
            self.talk.settle()
            exchange = self.ask(body, block)
        size = self.talk.reply_bytes(name)
        is_right = self._is_right(exchange, name)
        self.session.step(is_right, f"ACK and a {name} reply of {size} bytes", exchange)
        assert exchange.reply is not None, "the step above has seen to it"
        return exchange.reply

    def _is_right(self, exchange: Exchange, name: str) -> bool:
        """True for what must come of a read, in the reading of this device."""
        reply = exchange.reply
        return (
            exchange.is_acked and reply is not None and reply.is_sound and reply.name == name
            and reply.unit == self.unit and len(reply.raw) == self.talk.reply_bytes(name)
        )  # fmt: skip

    def command(self, body: bytes) -> Exchange:
        """Send one of the writing commands and go on with its ACK."""
        exchange = self.ask(body)
        told = codec.explain_request(exchange.request)
        self.session.step(exchange.sign == codec.ACK, f"ACK to {told}", exchange)
        return exchange

    def read(self, address: int) -> int:
        """The value at an address."""
        return self.query(codec.dread(address)).values[0]

    def read_block(self, address: int) -> tuple[int, ...]:
        """The 32 values from an address on."""
        return self.query(codec.bread(address)).values

    def write(self, address: int, value: int) -> Exchange:
        """Write a value."""
        return self.command(codec.dwrite(address, value))

    def write_block(self, address: int, values: Iterable[int]) -> Exchange:
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

    def in_time(self, since_ns: int, limit_s: float, what: str) -> None:
        """Give the attempt up if so long has passed since then: what is seen then tells nothing."""
        passed_s = (self.target.now_ns - since_ns) / 1e9
        if passed_s > limit_s:
            self.session.void_attempt(
                f"{what} lasts {limit_s * 1000:.0f} ms and was looked at within"
                f" {passed_s * 1000:.0f}: this line or this host is too slow"
            )

    def set_flag(self, number: int) -> Exchange:
        """Turn a flag on; never sent twice."""
        return self.command(codec.sflag(number))

    def clear_flag(self, number: int) -> Exchange:
        """Turn a flag off; never sent twice."""
        return self.command(codec.cflag(number))
