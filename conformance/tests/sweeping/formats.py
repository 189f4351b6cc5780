"""Where kind, values and sum stand in what hosts and devices say, as the ledgers have it (§2 each).

A message is bytes; on CAN, two bytes of identifier and then the data.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Final

STX, ETX, NACK = 0x02, 0x03, 0x15
ACK: Final = b"\x06"
MAC_BYTES = 21
SDO_REPLY, SDO_REQUEST, NODES = 0x580, 0x600, 0x7F
DOWNLOAD, UPLOAD, REFUSED = 0x23, 0x40, 0x80
MSC_HEAD, MSC_SUM = 6, 2
# What stands behind the comma of a command; with another size it is refused, whatever it says.
MSC_SIZES: Final = {"DWRITE": 6, "BWRITE": 130, "SFLAG": 2, "CFLAG": 2}
MSC_FLAGS: Final = 256

MAC_COMMANDS: Final = (
    *("00", "02", "03", "07", "09", "0A", "0B", "0C", "0D", "0E", "0F", "10", "11", "13"),
    *("14", "15", "16", "17", "18", "19", "1A", "1C", "1E"),
)
# Command → which of its four bytes mean anything; one that is not here has none.
MEANT: Final = {
    **dict.fromkeys(("02", "03", "07", "08", "0C", "0F", "1B", "1C"), 0xFF),
    **dict.fromkeys(("09", "0A", "13", "16", "1E"), 0xFFFFFFFF),
    "0D": 0xFFFF, "0E": 0xFF00, "15": 0xFFFFFF,
}  # fmt: skip


class Format(ABC):
    """The messages of one family.  `commands` have an effect, `queries` an answer; that to `place`
    tells where the axis is."""

    commands: tuple[str, ...]
    queries: tuple[str, ...]
    place = ""

    @abstractmethod
    def kind(self, message: bytes) -> str:
        """Of a request; empty if these bytes are none."""

    def is_reply(self, message: bytes) -> bool:
        """Whether what a device says is an answer to a request."""
        return True

    def lead(self, message: bytes) -> int:
        """How many bytes before a request belong to the exchange before it."""
        return 0

    @abstractmethod
    def values(self, message: bytes) -> bytes:
        """What a request or an answer carries; nothing if it carries none."""

    def means_other(self, kind: str, values: bytes, others: bytes) -> bool:
        """Whether a request of that kind means something else with other values."""
        mask = MEANT.get(kind[-2:], 0).to_bytes(4)
        pairs = zip(values, others, mask, strict=True)
        return any((one ^ other) & seen for one, other, seen in pairs)

    @abstractmethod
    def with_values(self, message: bytes, values: bytes) -> bytes:
        """The message with as many other values, and a right sum."""

    @abstractmethod
    def with_kind(self, message: bytes, kind: str) -> bytes:
        """The request as another of the same size, with a right sum."""

    @abstractmethod
    def resummed(self, message: bytes) -> bytes:
        """The message with a right sum, as far as it is one."""

    @abstractmethod
    def refusal(self, message: bytes) -> bytes:
        """What refuses a request."""


class MacSerialFormat(Format):
    """21 bytes of characters; an answer has its sum at another place than a request."""

    commands = (*MAC_COMMANDS, "08", "1B", "01")
    queries = tuple(f"{index:02X}" for index in range(0x20, 0x2A))
    place = "20"

    def kind(self, message: bytes) -> str:
        """The index."""
        is_request = len(message) == MAC_BYTES and message[0] == STX and message[-1] == ETX
        return message[6:8].decode("ascii", "replace") if is_request else ""

    def _place(self, message: bytes) -> int:
        """Where the digits begin; 0: nowhere."""
        if len(message) != MAC_BYTES:
            return 0
        return 10 if message[0] == STX else 9 if message[2] == STX else 0

    def values(self, message: bytes) -> bytes:
        """The eight digits."""
        place = self._place(message)
        try:
            return bytes.fromhex(message[place : place + 8].decode()) if place else b""
        except ValueError:
            return b""

    def with_values(self, message: bytes, values: bytes) -> bytes:
        """In upper case."""
        place = self._place(message)
        return self.resummed(message[:place] + values.hex().upper().encode() + message[place + 8 :])

    def with_kind(self, message: bytes, kind: str) -> bytes:
        """Another index."""
        return self.resummed(message[:6] + kind.encode() + message[8:])

    def resummed(self, message: bytes) -> bytes:
        """Two digits before the end of the frame."""
        place = self._place(message)
        if not place:
            return message
        first, last = (4, 18) if place == 10 else (6, 17)
        total = b"%02X" % (sum(message[first:last]) % 256)
        return message[:last] + total + message[last + 2 :]

    def refusal(self, message: bytes) -> bytes:
        """Ack, Xoff, Xonerror."""
        return b"\x06\x13\x17"


class MacCanFormat(Format):
    """An SDO of 8 bytes behind an identifier; no sum."""

    commands = tuple(f"d{index}" for index in MAC_COMMANDS if index not in ("08", "1B"))
    queries = tuple(f"u{index:02X}" for index in range(8))
    place = "u00"

    def is_reply(self, message: bytes) -> bool:
        """Boot-ups and heartbeats come unasked."""
        return int.from_bytes(message[:2]) & ~NODES == SDO_REPLY

    def kind(self, message: bytes) -> str:
        """Direction and index."""
        identifier = int.from_bytes(message[:2])
        if identifier & ~NODES != SDO_REQUEST or len(message) != 10:
            return ""
        letter = {DOWNLOAD: "d", UPLOAD: "u"}.get(message[2], "")
        return f"{letter}{message[3]:02X}" if letter else ""

    def values(self, message: bytes) -> bytes:
        """The last four bytes."""
        is_sdo = int.from_bytes(message[:2]) & ~NODES in (SDO_REQUEST, SDO_REPLY)
        return message[6:] if is_sdo and len(message) == 10 else b""

    def with_values(self, message: bytes, values: bytes) -> bytes:
        """The same."""
        return message[:6] + values

    def with_kind(self, message: bytes, kind: str) -> bytes:
        """The index; a download stays one."""
        return message[:3] + bytes.fromhex(kind[1:]) + message[4:]

    def resummed(self, message: bytes) -> bytes:
        """There is no sum."""
        return message

    def refusal(self, message: bytes) -> bytes:
        """80h with zeros."""
        identifier = SDO_REPLY + (int.from_bytes(message[:2]) & NODES or 1)
        return identifier.to_bytes(2) + bytes([REFUSED]) + message[3:6] + bytes(4)


class MscFormat(Format):
    """Packets; the name of the command ends with a comma."""

    commands = ("DWRITE", "BWRITE", "SFLAG", "CFLAG")
    queries = ("DREAD", "BREAD", "RFLAG", "RFLAGS", "RQSTAT")

    def lead(self, message: bytes) -> int:
        """The host's ACK to a reply, where the next packet follows it at once."""
        return int(message[:1] == ACK and self.kind(message[1:]) != "")

    def kind(self, message: bytes) -> str:
        """The name."""
        if len(message) < MSC_HEAD + MSC_SUM or message[0] != STX:
            return ""
        name = message[MSC_HEAD:-MSC_SUM].partition(b",")[0].decode("ascii", "replace")
        return name if name in self.commands + self.queries else ""

    def values(self, message: bytes) -> bytes:
        """All behind the comma."""
        return message[MSC_HEAD:-MSC_SUM].partition(b",")[2] if self.kind(message) else b""

    def means_other(self, kind: str, values: bytes, others: bytes) -> bool:
        """All of them count, unless both are refused: for their size, or as no flag."""
        if len(values) != MSC_SIZES.get(kind, len(values)):
            return False
        if kind.endswith("FLAG"):
            numbers = {min(int.from_bytes(one), MSC_FLAGS) for one in (values, others)}
            return len(numbers) > 1
        return values != others

    def with_values(self, message: bytes, values: bytes) -> bytes:
        """The same number of bytes."""
        head = message[: MSC_HEAD + len(self.kind(message)) + 1]
        return self.resummed(head + values + message[-MSC_SUM:])

    def with_kind(self, message: bytes, kind: str) -> bytes:
        """Another name, and the length that goes with it."""
        body = kind.encode() + b"," + self.values(message)
        head = message[:2] + len(body).to_bytes(2) + message[4:MSC_HEAD]
        return self.resummed(head + body + message[-MSC_SUM:])

    def resummed(self, message: bytes) -> bytes:
        """Two bytes at the end."""
        if len(message) < MSC_HEAD + MSC_SUM or message[0] != STX:
            return message
        body = message[:-MSC_SUM]
        return body + (sum(body[1:]) % 65536).to_bytes(2)

    def refusal(self, message: bytes) -> bytes:
        """One character."""
        return bytes([NACK])


FORMATS: Final = {
    "mac23": MacSerialFormat(),
    "mac23-can": MacCanFormat(),
    "msc-250": MscFormat(),
}
