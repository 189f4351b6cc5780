"""What the engine must know of the MAC23 on CAN beside its checks: who is there, how to open the
bus, and which frame may do what to the axis."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from functools import lru_cache
from typing import Final

from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.core.family import Violation
from axistwin_conformance.core.identity import Model
from axistwin_conformance.core.lenient import Lenient
from axistwin_conformance.core.session import Run, Session
from axistwin_conformance.core.wording import Effect, Exchange
from axistwin_conformance.families.mac.axis.axis_family import AxisFamily
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.axis.driver.facts import MacFacts
from axistwin_conformance.families.mac.axis.exchanges import AxisReply, ReplyKind
from axistwin_conformance.families.mac.axis.safety import impact_of_axis
from axistwin_conformance.families.mac.axis.travel_guard import AxisTravelGuard
from axistwin_conformance.families.mac.axis.words import (
    MOVED,
    MOVES_BY,
    exchange_words,
    request_words,
)
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.client import bus_of
from axistwin_conformance.families.mac.can.diagnosis import diagnose
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.lenient import lenient
from axistwin_conformance.families.mac.can.reader import BusReader
from axistwin_conformance.transport.can import CanTransport, open_can_target
from axistwin_conformance.transport.can_frame import Frame, unpack_all
from axistwin_conformance.transport.kinds import BUS

NOT_ON_CAN: Final = frozenset({0x08, 0x1B})
LISTEN_S: Final = 0.25  # for traffic of others, before the first question
SPOKEN: Final = frozenset({codec.REPLY, codec.EMERGENCY, codec.BOOT_UP})  # + address
SET_ADDRESS: Final = 0x08  # in the safety classes of the axis: what the LMT frames do

MODELS: Final = {
    "mac23-can": Model("mac23-can", "MAC23 (CAN)", MacFacts(2000, 2.5, -215.0, 1 / 4.8, codec.IMAX))
}


@lru_cache(maxsize=1024)  # the same frame is asked about three times on its way out
def _indices(data: bytes) -> tuple[int, ...]:
    """The index of every request in these bytes that some reading would obey."""
    return tuple(index for frame in unpack_all(data) if (index := _index_of(frame)) is not None)


def _index_of(frame: Frame) -> int | None:
    head = frame.data.ljust(4, b"\0")
    if frame.is_extended or frame.is_remote:
        return None
    if frame.identifier == codec.LMT_REQUEST:
        return SET_ADDRESS
    if frame.identifier == codec.SYNC:
        return 0x11
    if frame.identifier & 0x780 != codec.REQUEST or head[2] != codec.INDEX_HIGH:
        return None
    if head[0] == codec.UPLOAD:
        return head[1] + 0x20
    return None if head[1] in NOT_ON_CAN else head[1]  # unassigned here: refused


_BUSES: Final = itertools.count()
TWIN_BITRATE: Final = 125_000  # of the built-in twin, unless another one is asked for


class MacCan(AxisFamily):
    """MAC23 on a CAN bus."""

    name = "mac_can"
    models = MODELS
    addresses = codec.ADDRESSES
    default_address = 1
    transport_kind = BUS
    impact = impact_of_axis("address (LMT)", NOT_ON_CAN)

    def open(self, url: str, rate: int | None, /, *, is_builtin: bool = False) -> CanTransport:
        """Open INTERFACE:CHANNEL, at that bit rate if one is given; the built-in twin on a bus of
        its own, however many of its kind are open in this process."""
        target = open_can_target(
            f"{url}&bus=suite{next(_BUSES)}" if is_builtin else url,
            bitrate=rate or (TWIN_BITRATE if is_builtin else None),
            is_spontaneous=codec.is_spontaneous,
            is_builtin=is_builtin,
        )
        target.description = url  # which opens another such bus
        return target

    def explain(self, record: Record) -> str:
        """Put the frames of a record into words."""
        return "; ".join(codec.explain(frame) for frame in unpack_all(record.data))

    def in_words(self, request: bytes, reply: bytes) -> Exchange:
        """Put an exchange into the words of a failure."""
        frame, *others = unpack_all(request)
        index = codec.index_of(frame)
        if others or index is None:
            words = self.explain(Record(0, Direction.HOST, request))
            to, _, sent = words.partition(": ")
            if to.startswith("to ") and len(frame.data) < codec.TRANSFER_BYTES:
                return Exchange(f"{sent} {to}", Effect.NOTHING)
            is_sync = frame.identifier == codec.SYNC
            if is_sync:
                return Exchange(words, Effect.START, sets=MOVED, needs=MOVES_BY)
            return Exchange(words)
        came = [codec.parse(one) for one in unpack_all(reply)]
        data = next((one.data for one in came if one.index == index), None)
        address = frame.identifier - codec.REQUEST
        to = {codec.GENERAL_ADDRESS: " to all", self.default_address: ""}.get(
            address, f" to module {address}"
        )
        named = f"{'upload' if index in codec.QUERIES else 'download'} 20{frame.data[1]:02X}h"
        parameter = int.from_bytes(frame.data[4:], "big")
        words = request_words(index, parameter, named) + to
        is_refused = any(one.kind is ReplyKind.REFUSED and one.index == index for one in came)
        told = exchange_words(words, index, parameter, data)
        if to.startswith(" to module"):  # what another one depends on is not known
            told = told._replace(sets=None, needs=None, shows={})
        return told._replace(is_refused=is_refused)

    def driver(self, session: Session, address: int | None = None) -> CanDriver:
        """A module on the bus."""
        return CanDriver(session, address)

    def _address_text(self, address: int) -> str:
        """In decimal."""
        return str(address)

    def _nobody_there(self, driver: AxisDriver, reply: AxisReply) -> str:
        """With what was seen of the bus."""
        transport = driver.session.transport
        return (
            f"no module answers at address {driver.client.address} on {transport.description}:"
            f" {'; '.join((str(reply), *transport.remarks))}; try another --address or --bitrate"
        )

    def _listen_first(self, session: Session) -> None:
        """Who else talks on the bus while nothing is asked is left out."""
        if session.transport.is_virtual:
            return
        own = {session.address, *session.neighbours}

        def is_ours(frame: Frame) -> bool:
            is_mine = frame.identifier & 0x7F in own and frame.identifier & ~0x7F in SPOKEN
            return frame.is_plain and is_mine

        bus_of(session).leave_out_others(LISTEN_S, is_ours)

    def _indices(self, data: bytes) -> Iterable[int]:
        """The index of every request in these bytes that some reading would obey."""
        return _indices(data)

    def travel_guard(self, run: Run) -> AxisTravelGuard:
        """What keeps the axes of a bus inside the envelope."""
        bounds, reader = run.envelope, BusReader(run.readings)
        return AxisTravelGuard(
            reader, bounds.max_travel, bounds.max_speed, run.address, run.readings
        )

    def diagnose(self, session: Session, request: bytes, reply: bytes | None) -> Violation | None:
        """See `diagnose`."""
        return diagnose(session, request, reply)

    def _read_leniently(
        self, session: Session, request: bytes, reply: bytes, after_ns: int
    ) -> Lenient | None:
        """See `lenient`."""
        is_identified = session.run.identity is not None
        return lenient(request, reply, session.readings, after_ns, is_identified=is_identified)


FAMILY: Final = MacCan()
