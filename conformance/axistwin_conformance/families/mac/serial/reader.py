"""What the travel guard (`axis.travel_guard`) reads on the serial line: frames that would be
executed, and replies."""

from __future__ import annotations

from axistwin_conformance.families.mac.axis.travel_guard import ReceivedReply, SentRequest
from axistwin_conformance.families.mac.serial import codec


class LineReader:
    """Reads what is sent, in whatever pieces, and the reply to it."""

    def __init__(self) -> None:
        self._tail = b""  # of what was sent, for frames sent in pieces
        self._received = b""

    def foreseen(self, data: bytes) -> list[SentRequest]:
        """See `travel_guard.Reader`."""
        return [_asked(frame) for frame in _frames(self._tail, data)]

    def sent(self, data: bytes) -> None:
        """See `travel_guard.Reader`."""
        self._tail, self._received = (self._tail + data)[1 - codec.REQUEST_BYTES :], b""

    def received(self, data: bytes) -> ReceivedReply | None:
        """See `travel_guard.Reader`."""
        self._received += data
        if codec.missing_bytes(self._received):
            return None
        reply, self._received = codec.parse(self._received), b""
        return ReceivedReply(reply.kind, reply.data)

    def stop(self, address: int) -> bytes:
        """See `travel_guard.Reader`."""
        return codec.request(address, 0x18).encode()

    def explained(self, raw: bytes) -> str:
        """See `travel_guard.Reader`."""
        return codec.explain_request(raw)


def _asked(frame: bytes) -> SentRequest:
    address = int(frame[4:6], 16)
    return SentRequest(
        None if address == codec.GENERAL_ADDRESS else address,
        int(frame[6:8], 16),
        int(frame[10:18], 16),
        frame,
    )


def _frames(tail: bytes, data: bytes) -> list[bytes]:
    """Every frame that would be executed and ends in `data`, which follows `tail`."""
    stream = tail + data
    return [
        frame
        for at in range(max(0, len(tail) - codec.REQUEST_BYTES + 1), len(stream))
        if len(frame := stream[at : at + codec.REQUEST_BYTES]) == codec.REQUEST_BYTES
        and (frame[0], frame[-1]) == (codec.STX, codec.ETX)
        and at + codec.REQUEST_BYTES > len(tail)
        and _is_obeyed(frame)
    ]


def _is_obeyed(frame: bytes) -> bool:
    """True if a module would execute it; lower-case digits count, since a device may take them."""
    summed = frame[4:18]
    is_hex = all(character in b"0123456789ABCDEFabcdef" for character in frame[4:20])
    return (
        is_hex
        and frame[1:4] == codec.REQUEST_LENGTH_FIELD
        and int(frame[18:20], 16) == codec.checksum(summed)
    )
