"""What the engine must know of the MAC family beside its checks: who is there, how to stop, what to
put back, and which frame may do what to the axis."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Final

from axistwin_conformance.base.errors import TargetError
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.core.family import Violation
from axistwin_conformance.core.identity import Identity, Model
from axistwin_conformance.core.session import ATTEMPTS, Run, Session
from axistwin_conformance.families.mac.axis.axis_family import AxisFamily
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.exchanges import Kind
from axistwin_conformance.families.mac.axis.safety import impact_of_axis
from axistwin_conformance.families.mac.axis.snapshot import PROBE_ATTEMPTS, Facts, climate, sanity
from axistwin_conformance.families.mac.axis.travel_guard import TravelGuard
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.codec import Reply
from axistwin_conformance.families.mac.serial.diagnosis import diagnose
from axistwin_conformance.families.mac.serial.driver import RigBench
from axistwin_conformance.families.mac.serial.reader import LineReader
from axistwin_conformance.transport.serial import SerialTransport, open_target

FACTORY_BAUD: Final = 38400  # MACS-LINE-01
BAUDS: Final = (9600, 19200, 38400)  # MACS-CMD-1B-01
FACE_BYTES: Final = 16

MODELS: Final = {
    model.name: model
    for model in (
        Model("mac23", "MAC23 (serial)", Facts(2000, 2.5, -215.0, 1 / 4.8, 0x80)),
        Model("mac34-1", "MAC34-1 (serial)", Facts(10000, 2.45, -140.0, 0.4, None)),
        Model("mac34-2", "MAC34-2 (serial)", Facts(10000, 2.45, -140.0, 0.8, None)),
    )
}


# --- who is there --------------------------------------------------------------------------------


def identify(session: Session) -> Identity:
    """Ask release and measures: the only things on the wire that tell one model from another.

    A module that answers one of these questions wrongly and others well is a module all the same;
    what it broke is for the checks to say.
    """
    bench = RigBench(session)
    session.is_strict = True  # the attempts are counted here
    last = _insisted(bench, 0x24)
    release = last.data if last.kind is Kind.ANSWER else None
    if release is None and not sanity(session):
        others = [str(rate) for rate in BAUDS if rate != session.target.baud]
        raise TargetError(
            f"no module answers at address {bench.address:02X}h and {session.target.baud} baud:"
            f" {_heard(bench, last)}; try --baud {' or '.join(others)}, or another --address"
        )
    session.is_strict = session.target.is_lossless
    values = {"release": "unknown" if release is None else f"{release:08X}"}
    measures, imax = bench.ask(0x27).reply, bench.ask(0x28, codec.IMAX_ADDRESS).reply
    if measures.data is not None:
        values |= climate(session, measures)
    if imax.data is not None:
        values["imax"] = f"{imax.data_bytes()[0]:02X}h"
    told = [f"release {values['release']}"]
    told += [values[name] for name in ("temperature", "supply") if name in values]
    return Identity(f"{session.run.model.title} at {bench.address:02X}h, {', '.join(told)}", values)


def _insisted(bench: RigBench, index: int) -> Reply:
    """Ask until there is an answer; longer if what comes differs, which is noise."""
    seen = set()
    for number in range(1, ATTEMPTS + 1):
        reply: Reply = bench.command(index).reply
        seen.add(reply.raw)
        if reply.kind is Kind.ANSWER or (number >= PROBE_ATTEMPTS and len(seen) == 1):
            break
    return reply


def _heard(bench: RigBench, reply: Reply) -> str:
    """What came instead of an answer, with what follows it: another protocol shows its face."""
    if reply.kind is not Kind.GARBAGE:
        return str(reply)
    raw = reply.raw + bench.target.receive(FACE_BYTES, QUIET_S)
    text = "".join(chr(one) if 0x20 <= one < 0x7F else "." for one in raw)
    return f"something else talks there: {raw.hex(' ').upper()} ({text})"


@lru_cache(maxsize=1024)  # the same frame is asked about three times on its way out
def _indices(data: bytes) -> tuple[int, ...]:
    """The index of every whole frame in these bytes, whatever its checksum."""
    found = []
    for at in range(len(data) - codec.REQUEST_BYTES + 1):
        if data[at : at + 4] != b"\x02014" or data[at + codec.REQUEST_BYTES - 1] != codec.ETX:
            continue
        digits = data[at + 6 : at + 8]
        if not digits.translate(None, b"0123456789ABCDEFabcdef"):
            found.append(int(digits, 16))
    return tuple(found)


class MacSerial(AxisFamily):
    """MAC23 and MAC34 on their serial line."""

    name = "mac_serial"
    models = MODELS
    addresses = range(0x80)
    default_address = 0
    default_rate = FACTORY_BAUD
    rates = BAUDS
    impact = impact_of_axis("address, rate")

    def open(self, url: str, rate: int | None, /, *, is_builtin: bool = False) -> SerialTransport:
        """Open a port at that rate, or at the factory's."""
        return open_target(url, rate or FACTORY_BAUD, is_builtin=is_builtin)

    def explain(self, record: Record) -> str:
        """Put a request or a reply into words."""
        is_request = record.direction is Direction.HOST
        return (codec.explain_request if is_request else codec.explain)(record.data)

    def driver(self, session: Session, address: int | None = None) -> RigBench:
        """A module on the line."""
        return RigBench(session, address)

    def identify(self, session: Session) -> Identity:
        """See `identify`."""
        return identify(session)

    def indices(self, data: bytes) -> Iterable[int]:
        """The index of every whole frame in these bytes, whatever its checksum."""
        return _indices(data)

    def travel_guard(self, run: Run) -> TravelGuard:
        """What keeps the axes of a line inside the envelope."""
        bounds = run.envelope
        return TravelGuard(
            LineReader(), bounds.max_travel, bounds.max_speed, run.address, run.readings
        )

    def diagnose(self, session: Session, request: bytes, reply: bytes | None) -> Violation | None:
        """See `diagnose`."""
        return diagnose(session, request, reply)


FAMILY: Final = MacSerial()
