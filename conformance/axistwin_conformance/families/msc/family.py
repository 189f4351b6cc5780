"""What the engine must know of the MSC family beside its checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.core.family import Family, Violation
from axistwin_conformance.core.identity import Model
from axistwin_conformance.core.lenient import Lenient
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import Effect, Exchange
from axistwin_conformance.families.msc import codec, snapshot
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import SHOUTING
from axistwin_conformance.families.msc.options import OPTIONS
from axistwin_conformance.families.msc.preflight.data_area import check_spans
from axistwin_conformance.families.msc.preflight.flag_check import try_flags
from axistwin_conformance.families.msc.replies.diagnosis import diagnose
from axistwin_conformance.families.msc.replies.lenient import lenient
from axistwin_conformance.families.msc.rig_controls import MSC_CONTROLS
from axistwin_conformance.families.msc.safety import IMPACT, objection
from axistwin_conformance.families.msc.snapshot import MscSnapshot
from axistwin_conformance.transport.serial import SerialTransport, open_target

BAUD: Final = 9600  # MSC-PHY-01
FLAGS: Final = 256  # a device may take a number modulo this (MSC-AMB-22)


@dataclass(frozen=True, slots=True)
class MscFacts:
    """What differs between the models on the wire (MSC-MOD-01)."""

    has_rflags: bool


MODELS: Final = {
    model.name: model
    for model in (
        Model("msc-generic", "MSC of any model", MscFacts(has_rflags=False)),
        Model("msc-250", "MSC-250", MscFacts(has_rflags=True)),
        Model("msc-850", "MSC-850", MscFacts(has_rflags=False)),
        Model("msc-850-32", "MSC-850/32", MscFacts(has_rflags=True)),
    )
}


class Msc(Family):
    """MSC controllers on their executive port."""

    name = "msc"
    models = MODELS
    addresses = range(codec.UNITS.start, codec.UNITS.stop)
    default_address = 1
    default_rate = BAUD
    rates = (BAUD,)
    rig_controls = MSC_CONTROLS
    options = OPTIONS
    impact = IMPACT
    tried_needs = frozenset({"flags"})
    _replay_module = "axistwin_conformance.families.msc.checks.sequences"
    operation_bytes = 4

    def open(self, url: str, rate: int | None, /, *, is_builtin: bool = False) -> SerialTransport:
        """Open a port at that rate, or at the manual's."""
        return open_target(url, rate or BAUD, is_builtin=is_builtin)

    def twin_url(self, model: str, address: int, neighbours: tuple[int, ...]) -> str:
        """The built-in twin, in virtual time, with its neighbours on one line and the bench program
        in each of them."""
        return f"{super().twin_url(model, address, neighbours)}&program=bench"

    def explain(self, record: Record) -> str:
        """Put a packet, or what comes back, into words."""
        is_request = record.direction is Direction.HOST
        return (codec.explain_request if is_request else codec.explain)(record.data)

    def in_words(self, request: bytes, reply: bytes) -> Exchange:
        """Put an exchange into the words of a failure; the host's receipts are left out."""
        if request in (codec.ACK, codec.NAK):
            return Exchange("", is_altered=request == codec.NAK)
        packet, words = codec.parse(request), codec.explain_request(request)
        name = packet.name if packet is not None else ""
        unit, _, rest = words.partition(": ")
        if packet is not None and rest and unit.startswith("unit "):
            words, _, flaws = rest.partition("; ")
            words += "" if packet.unit == self.default_address else f" to {unit}"
            words += f" with {flaws}" if flaws else ""
        is_write = name in codec.WRITES and codec.is_whole(request)
        effect = Effect.VALUE if is_write else Effect.NOTHING
        sets, needs = _touched(packet) if packet is not None else ({}, frozenset[str]())
        is_refused = reply == codec.NAK
        return Exchange(words, effect, is_refused=is_refused, sets=sets, needs=needs)

    def driver(self, session: Session, address: int | None = None) -> MscDriver:
        """A unit on the line."""
        return MscDriver(session, address)

    identify = staticmethod(snapshot.identify)
    is_alive = staticmethod(snapshot.sanity)
    stop = staticmethod(snapshot.stop)
    remember = staticmethod(snapshot.remember)
    restore = staticmethod(snapshot.restore)
    kept = staticmethod(MscSnapshot.as_object)
    memory_of = staticmethod(MscSnapshot.from_object)

    def forbid(self, session: Session, data: bytes) -> str | None:
        """Why these bytes must not be sent; see `safety`."""
        return objection(session, data)

    def preflight(self, session: Session) -> None:
        """See `check_spans`."""
        check_spans(session)

    def unusable(self, session: Session, need: str) -> str | Violation:
        """See `try_flags`; nothing else the operator names has to be tried."""
        return try_flags(session) if need == "flags" else ""

    def disturbs(self, readings: Mapping[str, str]) -> bool:
        """Whether idle units of such readings answer what is said to, or by, another one."""
        return any(readings.get(switch) == reading for switch, reading in SHOUTING)

    def diagnose(self, session: Session, request: bytes, reply: bytes | None) -> Violation | None:
        """See `diagnose`."""
        return diagnose(session, request, reply)

    def lenient(self, session: Session, request: bytes, reply: bytes) -> Lenient | None:
        """See `lenient`."""
        return lenient(session, request, reply)


FAMILY: Final = Msc()


def _touched(packet: codec.Packet) -> tuple[Mapping[str, str | None] | None, frozenset[str] | None]:
    """Which variable or flag a request sets, and which it reads; None: several."""
    name, number = packet.name, next(iter(packet.numbers), 0)
    if name == "DWRITE":
        return {f"D{number}": packet.payload[2:].hex()}, frozenset()
    if name in ("SFLAG", "CFLAG"):
        return {f"F{number % FLAGS}": name}, frozenset()
    if name in ("DREAD", "RFLAG"):
        return {}, frozenset({f"D{number}" if name == "DREAD" else f"F{number % FLAGS}"})
    return (
        (None, frozenset()) if name == "BWRITE" else ({}, None if name != "RQSTAT" else frozenset())
    )
