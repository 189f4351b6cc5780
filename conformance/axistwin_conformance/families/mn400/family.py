"""What the engine must know of the MN400 beside its checks."""

from __future__ import annotations

from typing import ClassVar, Final

from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.core.family import Family, Violation
from axistwin_conformance.core.identity import Model
from axistwin_conformance.core.lenient import Lenient
from axistwin_conformance.core.session import Run, Session
from axistwin_conformance.core.wording import RUNNING, Effect, Exchange
from axistwin_conformance.families.mn400 import codec, lenient, safety, snapshot, words
from axistwin_conformance.families.mn400.driver import BoardDriver
from axistwin_conformance.families.mn400.grammar import ReplyForm, rule_of
from axistwin_conformance.families.mn400.motion.options import OPTIONS
from axistwin_conformance.families.mn400.motion.rig_controls import BOARD_CONTROLS
from axistwin_conformance.families.mn400.motion.travel_guard import BoardTravelGuard
from axistwin_conformance.families.mn400.persistence.programs import NOT_READABLE
from axistwin_conformance.families.mn400.snapshot import BoardSnapshot
from axistwin_conformance.families.mn400.usb.usb_family import Mn400Usb
from axistwin_conformance.transport.kinds import HID
from axistwin_conformance.transport.serial import SerialTransport, open_target

MODEL: Final = Model(
    "mn400", "MN400 4-axis motion controller", over={HID: Mn400Usb()}, weight_s=2.4
)
DONE: Final = frozenset({codec.ReturnCode.START, codec.ReturnCode.DONE, codec.ReturnCode.PRESENT})
REFUSALS: Final = codec.CODES - DONE
QUERIES: Final = (ReplyForm.DATA, ReplyForm.LISTING, ReplyForm.PRESENT, ReplyForm.REPEATED)


class Mn400(Family):
    """MN400 boards on a serial line."""

    name = "mn400"
    models: ClassVar = {MODEL.name: MODEL}
    addresses = codec.IDS
    default_address = 1
    default_rate = codec.RATES[0]
    rates = codec.RATES
    rig_controls = BOARD_CONTROLS
    options = OPTIONS
    impact: ClassVar = {
        "motion": "moves axes, switches outputs, changes modal settings",
        "rig": "inputs, pots, pulses and supply are worked; what they let move, moves",
        "stored": "replaces the stored program (Z)",
        "destructive": "changes address, rate and the configuration program (=, ~, .);"
        f" {NOT_READABLE}",
        "end": "axes go back to where they were found, modal settings that were changed to those of"
        " power-on",
    }

    def open(self, url: str, rate: int | None, /, *, is_builtin: bool = False) -> SerialTransport:
        """Open a port at that rate, or at the one of power-on."""
        return open_target(url, rate or codec.RATES[0], is_builtin=is_builtin)

    def explain(self, record: Record) -> str:
        """Put a packet, or what comes back, into words."""
        is_request = record.direction is Direction.HOST
        return (words.explain_request if is_request else words.explain_reply)(record.data)

    def in_words(self, request: bytes, reply: bytes) -> Exchange:
        """Put an exchange into the words of a failure."""
        packet = codec.parse(request)
        if packet is None:
            return Exchange(words.explain_request(request))
        told = words.command_words(packet.text)
        told += "" if packet.board == self.default_address else f", to {packet.board}"
        if not packet.is_sound:  # it changes nothing
            told = " with ".join((told, *packet.flaws)).replace(", should be ", " instead of ")
            return Exchange(told, is_refused=True)
        rule = rule_of(packet.text)
        effect = Effect.NOTHING if rule is not None and rule.form in QUERIES else Effect.OTHER
        if rule is None or packet.board != self.default_address:
            return Exchange(told, effect)
        is_refused = any(part.code in REFUSALS for part in codec.packets(reply)[0])
        sets, needs = words.touched(rule, packet.text)
        effect = Effect.MOTION if RUNNING in (sets or ()) else effect
        return Exchange(told, effect, is_refused=is_refused, sets=sets, needs=needs)

    def driver(self, session: Session, address: int | None = None) -> BoardDriver:
        """A board on the line."""
        return BoardDriver(session, address)

    identify = staticmethod(snapshot.identify)
    is_alive = staticmethod(snapshot.sanity)
    stop = staticmethod(snapshot.stop)
    remember = staticmethod(snapshot.remember)
    restore = staticmethod(snapshot.restore)
    kept = staticmethod(BoardSnapshot.as_object)
    memory_of = staticmethod(BoardSnapshot.from_object)
    would_lose = staticmethod(snapshot.would_lose)

    def forbid(self, session: Session, data: bytes) -> str | None:
        """Why these bytes must not be sent; see `safety`.  What they set is noted, to be put
        back."""
        check, memory = session.check, session.run.memory
        if check is None:
            return None
        snapshot.note_sent(session, data)
        if isinstance(memory, BoardSnapshot):
            memory.touched |= {text[:1].upper() for text in safety.texts(data)}
        allowed = frozenset(check.safety)
        return safety.objection(data, allowed, session.address, session.target.baud)

    def travel_guard(self, run: Run) -> BoardTravelGuard:
        """What keeps the axes of a line inside the envelope."""
        bounds = run.envelope
        return BoardTravelGuard(bounds.max_travel, bounds.max_speed, run.readings)

    def diagnose(self, session: Session, request: bytes, reply: bytes | None) -> Violation | None:
        """Which requirement a reply breaks that no board gives: the first departure of it."""
        asked = codec.parse(request)
        if asked is None or not asked.is_sound or reply == b"":
            return None
        if reply is None:
            is_known = rule_of(asked.text) is not None
            return Violation("MN4-RSP-03", "packets", "nothing") if is_known else None
        read = lenient.lenient(asked.board, request, reply)
        if read is None:
            came = words.hex_words(reply)
            return Violation("MN4-RSP-01", "packets", came)
        for one in read.departures:
            return Violation(one.requirement, f"{one.name} {one.expected}", one.actual)
        return None

    def lenient(self, session: Session, request: bytes, reply: bytes) -> Lenient | None:
        """See `lenient`."""
        return lenient.lenient(session.address, request, reply)


FAMILY: Final = Mn400()
