"""What the travel guard (`axis.travel_guard`) reads on the bus: frames that would be obeyed, and
replies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.travel_guard import ReceivedReply, SentRequest
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import CanRequest
from axistwin_conformance.transport.can_frame import Frame, unpack_all

SYNCHRO: Final = 0x11  # what a SYNC frame does (MACC-SYNC-03)
NOT_ON_CAN: Final = frozenset({0x08, 0x1B})
SET_ADDRESS: Final = 0x08  # the serial command that an LMT frame stands for
GIVE_ADDRESS: Final = 0x11  # the first byte of that frame
BYTE_ORDERS: Final = ("big", "little")


class BusReader:
    """Reads what is sent and the reply to it.

    A frame that only some readings would obey (too short, another command byte, SYNC with data)
    counts as obeyed; a short one no longer once this device is known to ignore them.  `readings`:
    what is known of it, as the run learns it.  Until the order of bytes is, a parameter is what it
    is in either, and no number is learnt from an answer.

    A reply belongs to the request that was sent last if it names the same index, sub-index and
    direction: one that comes late must not tell what became of another request.
    """

    def __init__(self, readings: Mapping[str, str]) -> None:
        self._readings = readings
        self._request: CanRequest | None = None  # sent last, if it is one that is answered

    def foreseen(self, data: bytes) -> list[SentRequest]:
        """See `travel_guard.Reader`."""
        return [request for frame in unpack_all(data) for request in self._asked(frame)]

    def sent(self, data: bytes) -> None:
        """See `travel_guard.Reader`."""
        for frame in unpack_all(data):
            self._request = _request_of(frame)

    def received(self, data: bytes) -> ReceivedReply | None:
        """See `travel_guard.Reader`."""
        asked = self._request
        for frame in unpack_all(data):
            if asked is None or not codec.is_reply(frame):
                continue
            whom = frame.identifier - codec.REPLY
            if asked.address not in (codec.GENERAL_ADDRESS, whom) or codec.mismatch(asked, frame):
                continue
            order = self._byte_order
            reply = codec.parse(frame, order or "big")
            if reply.kind is not ReplyKind.GARBAGE:
                return ReceivedReply(reply.kind, reply.data if order else None, whom)
        return None

    def stop(self, address: int) -> bytes:
        """See `travel_guard.Reader`."""
        return codec.request(address, 0x18).frame().pack()

    def explained(self, raw: bytes) -> str:
        """See `travel_guard.Reader`."""
        return "; ".join(codec.explain(frame) for frame in unpack_all(raw))

    @property
    def _byte_order(self) -> str | None:
        return self._readings.get("can_byte_order")

    def _asked(self, frame: Frame) -> list[SentRequest]:
        """What a frame would ask for; nothing for what nobody obeys."""
        raw = frame.pack()
        if not frame.is_plain:
            return []
        if frame.identifier == codec.SYNC:
            return [SentRequest(None, SYNCHRO, 0, raw)]
        if frame.identifier == codec.LMT_REQUEST and frame.data[:1] == bytes([GIVE_ADDRESS]):
            return [SentRequest(None, SET_ADDRESS, frame.data[1] if frame.length > 1 else 0, raw)]
        request = _request_of(frame)
        if request is None or request.index_high != codec.INDEX_HIGH:
            return []
        is_short = frame.length < codec.TRANSFER_BYTES
        if is_short and self._readings.get("short_frame") == "ignore":
            return []
        whom = None if request.address == codec.GENERAL_ADDRESS else request.address
        if request.command == codec.UPLOAD:
            return [SentRequest(whom, 0x20 + (request.index_low & 0x0F), 0, raw)]
        index = request.index_low & 0x1F
        if index in NOT_ON_CAN:  # nothing here, and by no reading what it is on the serial line
            return []
        orders = BYTE_ORDERS if self._byte_order is None else (self._byte_order,)
        numbers = dict.fromkeys(_number(index, request.data, order) for order in orders)
        return [SentRequest(whom, index, number, raw) for number in numbers]


def _request_of(frame: Frame) -> CanRequest | None:
    """A frame under an identifier of requests, taken apart as if it were whole."""
    if not frame.is_plain or frame.identifier & 0x780 != codec.REQUEST:
        return None
    data = frame.data.ljust(codec.TRANSFER_BYTES, b"\0")
    command, low, high, sub_index = data[:4]
    return CanRequest(frame.identifier - codec.REQUEST, command, low, data[4:], sub_index, high)


def _number(index: int, data: bytes, order: str) -> int:
    if order != BYTE_ORDERS[0]:
        data = codec.LAYOUTS.get(index, codec.Layout()).reordered(data)
    return int.from_bytes(data, "big")
