"""What the fence (`mac_axis.fence`) reads on the bus: frames that would be obeyed, and replies."""

from __future__ import annotations

from collections.abc import Mapping

from axistwin_conformance.can_frame import Frame, unpack_all
from axistwin_conformance.mac_axis.dialogue import signed
from axistwin_conformance.mac_axis.fence import Asked, Heard
from axistwin_conformance.mac_can import codec

SYNCHRO = 0x11  # what a SYNC frame does (MACC-SYNC-03)
NOT_ON_CAN = frozenset({0x08, 0x1B})
SET_ADDRESS = 0x08  # the serial command that an LMT frame stands for


class BusReader:
    """Reads what is sent and the reply to it.

    A frame that only some readings would obey (too short, another command byte, SYNC with data)
    counts as obeyed.  `readings`: what is known of the device, as the run learns it.
    """

    def __init__(self, readings: Mapping[str, str]) -> None:
        self._readings = readings
        self._whom: int | None = None  # who was asked last; None: nobody who would answer

    def foreseen(self, data: bytes) -> list[Asked]:
        """See `fence.Reader`."""
        return [one for frame in unpack_all(data) if (one := self._asked(frame))]

    def sent(self, data: bytes) -> None:
        """See `fence.Reader`."""
        frames = unpack_all(data)
        last = frames[-1] if frames else None
        is_request = last is not None and last.identifier & 0x780 == codec.REQUEST
        self._whom = last.identifier - codec.REQUEST if last is not None and is_request else None

    def heard(self, data: bytes) -> Heard | None:
        """See `fence.Reader`."""
        for frame in unpack_all(data):
            if self._whom is None or not codec.is_reply(frame):
                continue
            if self._whom not in (codec.GENERAL_ADDRESS, frame.identifier - codec.REPLY):
                continue
            reply = codec.parse(frame, self._byte_order)
            return Heard(reply.kind, reply.data)
        return None

    def stop(self, address: int) -> bytes:
        """See `fence.Reader`."""
        return codec.request(address, 0x18).frame().pack()

    def explained(self, raw: bytes) -> str:
        """See `fence.Reader`."""
        return "; ".join(codec.explain(frame) for frame in unpack_all(raw))

    def _asked(self, frame: Frame) -> Asked | None:
        """What a frame would ask for; None for what nobody obeys."""
        raw = frame.pack()
        if frame.is_extended or frame.is_remote:
            return None
        if frame.identifier == codec.SYNC:
            return Asked(None, SYNCHRO, 0, raw)
        data = frame.data.ljust(codec.TRANSFER_BYTES, b"\0")
        if frame.identifier == codec.LMT_REQUEST and data[0] == 0x11:
            return Asked(None, SET_ADDRESS, data[1], raw)
        if frame.identifier & 0x780 != codec.REQUEST or data[2] != codec.INDEX_HIGH:
            return None
        address = frame.identifier - codec.REQUEST
        whom = None if address == codec.GENERAL_ADDRESS else address
        if data[0] == codec.UPLOAD:
            return Asked(whom, 0x20 + (data[1] & 0x0F), 0, raw)
        index = data[1] & 0x1F
        if index in NOT_ON_CAN:  # nothing here, and by no reading what it is on the serial line
            return None
        return Asked(whom, index, signed(self._number(index, data[4:])), raw)

    def _number(self, index: int, data: bytes) -> int:
        if self._byte_order == "little":
            data = codec.LAYOUTS.get(index, codec.Layout()).reordered(data)
        return int.from_bytes(data, "big")

    @property
    def _byte_order(self) -> str:
        return self._readings.get("can_byte_order", "big")
