"""What the engine must know of the MAC family beside its checks: who is there, how to stop, what to
put back, and which frame may do what to the axis."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Final

from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.core.family import Violation
from axistwin_conformance.core.identity import Model
from axistwin_conformance.core.lenient import Lenient
from axistwin_conformance.core.session import REPLY_TIMEOUT_S, Run, Session
from axistwin_conformance.core.wording import Exchange
from axistwin_conformance.families.mac.axis.axis_family import AxisFamily
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.axis.driver.facts import MacFacts
from axistwin_conformance.families.mac.axis.exchanges import AxisReply, ReplyKind
from axistwin_conformance.families.mac.axis.safety import impact_of_axis
from axistwin_conformance.families.mac.axis.travel_guard import AxisTravelGuard
from axistwin_conformance.families.mac.axis.words import exchange_words, request_words
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.address_recovery import found_elsewhere
from axistwin_conformance.families.mac.serial.diagnosis import acknowledged_late, diagnose
from axistwin_conformance.families.mac.serial.driver import SerialDriver
from axistwin_conformance.families.mac.serial.lenient import lenient
from axistwin_conformance.families.mac.serial.reader import LineReader
from axistwin_conformance.transport.serial import SerialTransport, open_target

FACTORY_BAUD: Final = 38400  # MACS-LINE-01
BAUDS: Final = (9600, 19200, 38400)  # MACS-CMD-1B-01
FACE_BYTES: Final = 16
PARTS_S: Final = 3.0  # how long the parts of a reply are waited for, of whom nothing else comes

MODELS: Final = {
    model.name: model
    for model in (
        Model("mac23", "MAC23 (serial)", MacFacts(2000, 2.5, -215.0, 1 / 4.8, 0x80)),
        Model("mac34-1", "MAC34-1 (serial)", MacFacts(10000, 2.45, -140.0, 0.4, None)),
        Model("mac34-2", "MAC34-2 (serial)", MacFacts(10000, 2.45, -140.0, 0.8, None)),
    )
}


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

    def in_words(self, request: bytes, reply: bytes) -> Exchange:
        """Put an exchange into the words of a failure."""
        if len(request) != codec.REQUEST_BYTES or not set(request[4:18]) <= codec.DIGITS:
            words = codec.explain_request(request).removeprefix("to module 00h: ")
            words += f": {request.hex(' ').upper()}" if words.startswith("no frame") else ""
            is_altered = request[-1:] != bytes([codec.ETX])
            return Exchange(words, is_altered=is_altered, is_refused=codec.is_refusal(reply))
        address, index = int(request[4:6], 16), int(request[6:8], 16)
        to = {codec.GENERAL_ADDRESS: " to all (FF)", self.default_address: ""}.get(address)
        words = request_words(index, int(request[10:18], 16))
        odd = codec.oddities(request)
        if request[8:10] != b"00":  # part of the parameter
            sub_index, _, odd = odd.removeprefix(", ").partition(", ")
            name = words[:-1].partition("(")[2]
            more = sub_index.removeprefix(name) if sub_index.startswith(name) else f", {sub_index}"
            words, odd = f"{words[:-1]}{more})", odd and f", {odd}"
        words += odd.replace(", ", " with ", 1)
        to = f" to module {address:02X}h" if to is None else to
        words += to
        told = exchange_words(words, index, int(request[10:18], 16), codec.answer_data(reply))
        if to.startswith(" to module"):  # what another one depends on is not known
            told = told._replace(sets=None, needs=None, shows={})
        return told._replace(is_refused=codec.is_refusal(reply))

    def driver(self, session: Session, address: int | None = None) -> SerialDriver:
        """A module on the line."""
        return SerialDriver(session, address)

    def _address_text(self, address: int) -> str:
        """In hex."""
        return f"{address:02X}h"

    def _nobody_there(self, driver: AxisDriver, reply: AxisReply) -> str:
        """With what follows the reply: another protocol shows its face."""
        target = driver.session.target
        others = " or ".join(str(rate) for rate in BAUDS if rate != target.baud)
        came = str(reply)
        if reply.kind is ReplyKind.GARBAGE:
            raw = reply.raw + target.receive(FACE_BYTES, QUIET_S)
            text = "".join(chr(byte) if 0x20 <= byte < 0x7F else "." for byte in raw)
            came = f"something else talks there: {raw.hex(' ').upper()} ({text})"
            if self._replies_in_parts(driver, raw):
                came = "replies stop in their midst, and go on later"
        return (
            f"no module answers at address {self._address_text(driver.client.address)} and"
            f" {target.baud} baud: {came}; try --baud {others}, or another --address"
        )

    def _replies_in_parts(self, driver: AxisDriver, heard: bytes) -> bool:
        """Whether replies are whole, of which only a part was listened to; then that is judged
        (MACS-REPLY-16).  Time after time, since noise does not do that."""
        session, target = driver.session, driver.session.target
        request, took_s = codec.request(driver.client.address, 0x24).encode(), 0.0
        if self.lenient(session, request, heard) is not None:
            return False  # then it is no part of one
        for _ in range(RETRY.alike):
            target.wait(PARTS_S)
            target.drain()
            sent_ns = target.send(request)
            reply = codec.parse(target.receive(codec.ANSWER_BYTES, PARTS_S))
            took_s = (target.now_ns - sent_ns) / 1e9
            if reply.kind is not ReplyKind.ANSWER or took_s <= REPLY_TIMEOUT_S:
                return False
        actual = f"one in parts, over {took_s:.1f} s"
        limit = f"a reply within {REPLY_TIMEOUT_S:g} s"
        session.run.violations.append(("MACS-REPLY-16", limit, actual))
        return True

    def _own_values(self, driver: AxisDriver) -> dict[str, str]:
        """The highest torque limit, from the RAM."""
        imax: AxisReply = driver.client.ask(0x28, codec.IMAX_ADDRESS).reply
        return {} if imax.data is None else {"imax": f"{imax.data_bytes()[0]:02X}h"}

    def _indices(self, data: bytes) -> Iterable[int]:
        """The index of every whole frame in these bytes, whatever its checksum."""
        return _indices(data)

    def travel_guard(self, run: Run) -> AxisTravelGuard:
        """What keeps the axes of a line inside the envelope."""
        bounds = run.envelope
        return AxisTravelGuard(
            LineReader(), bounds.max_travel, bounds.max_speed, run.address, run.readings
        )

    def diagnose(self, session: Session, request: bytes, reply: bytes | None) -> Violation | None:
        """See `diagnose`, and of who is lost `acknowledged_late` and `found_elsewhere`."""
        if not request:
            return acknowledged_late(session) or found_elsewhere(SerialDriver(session))
        return diagnose(session, request, reply)

    def _read_leniently(
        self, session: Session, request: bytes, reply: bytes, after_ns: int
    ) -> Lenient | None:
        """See `lenient`."""
        return lenient(request, reply, session.readings, after_ns)


FAMILY: Final = MacSerial()
