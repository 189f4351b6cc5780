"""What is said to an axis and what it answers, whichever way that travels: kinds of replies, names
of commands and queries, numbers.

Indices are the serial ones: 00h to 1Fh are commands, 20h to 2Fh queries.  On CAN they are the
downloads 2000h to 201Fh and the uploads 2000h to 200Fh.
"""

from __future__ import annotations

from enum import Enum
from typing import Final, Protocol

QUERIES: Final = range(0x20, 0x30)


class ReplyKind(Enum):
    """What a module said, or that it said nothing."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    NACK = "nack"
    ANSWER = "answer"
    GARBAGE = "garbage"
    SILENCE = "silence"

    __hash__ = object.__hash__  # a member is one object; what Enum computes takes its time

    @property
    def in_words(self) -> str:
        """As the reply that is expected."""
        return _KINDS_IN_WORDS[self]


_KINDS_IN_WORDS: Final = {
    ReplyKind.ACCEPTED: "acceptance",
    ReplyKind.REFUSED: "a refusal",
    ReplyKind.NACK: "Nack",
    ReplyKind.ANSWER: "an answer",
    ReplyKind.GARBAGE: "garbage",
    ReplyKind.SILENCE: "no reply",
}


class AxisReply(Protocol):
    """A reply taken apart; its `str` says in words what came."""

    @property
    def kind(self) -> ReplyKind:
        """What the module said."""

    @property
    def raw(self) -> bytes:
        """The bytes of the reply; empty for silence."""

    @property
    def data(self) -> int | None:
        """The 32-bit number of an answer, None for anything else."""

    def data_bytes(self) -> tuple[int, int, int, int]:
        """Give the four data bytes of an answer, first byte first."""


def signed(value: int, bits: int = 32) -> int:
    """Read an unsigned field of ``bits`` bits as two's complement (MACS-FRAME-05)."""
    return value - (1 << bits) if value >> (bits - 1) else value


COMMAND_NAMES: Final = {
    0x00: "module init",
    0x01: "EEPROM init",
    0x02: "torque at rest",
    0x03: "stops mode",
    0x07: "reference input",
    0x08: "set address",
    0x09: "superior software stop",
    0x0A: "inferior software stop",
    0x0B: "position counter reset",
    0x0C: "torque limit",
    0x0D: "maximum-speed period",
    0x0E: "unstall (catch-up) speed",
    0x0F: "ramp coefficient",
    0x10: "wait for synchro",
    0x11: "synchro",
    0x13: "go to position",
    0x14: "go to 0",
    0x15: "velocity",
    0x16: "segment",
    0x17: "ramped stop",
    0x18: "stop without ramp",
    0x19: "power on",
    0x1A: "power off",
    0x1B: "baud rate",
    0x1C: "tolerance",
    0x1E: "virtual segment",
}
QUERY_NAMES: Final = {
    0x20: "position",
    0x21: "status",
    0x22: "superior software stop",
    0x23: "inferior software stop",
    0x24: "release",
    0x25: "speeds",
    0x26: "ramp, torque, modes, tolerance",
    0x27: "temperature, supply, inputs",
    0x28: "RAM",
    0x29: "EEPROM",
}
