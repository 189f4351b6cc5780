"""Frames of the MAC's serial line, built by hand: tests share nothing with the code they test."""

from typing import Any

ACCEPTED = b"\x06\x13\x1a"
REFUSED = b"\x06\x13\x17"
NACK = b"\x15"
ANSWER_LENGTH = 21


def request(index: int, parameter: int = 0, address: int = 0, subindex: int = 0) -> bytes:
    """A 21-byte request frame; ``parameter`` is taken modulo 2**32."""
    body = f"{address:02X}{index:02X}{subindex:02X}{parameter & 0xFFFF_FFFF:08X}"
    return f"\x02014{body}{sum(body.encode()) % 256:02X}\x03".encode()


def answer_value(answer: bytes) -> int:
    """The signed 32-bit data of a 21-byte answer."""
    assert len(answer) == ANSWER_LENGTH, answer
    return int.from_bytes(bytes.fromhex(answer[9:17].decode()), "big", signed=True)


def ask(port: Any, index: int, parameter: int = 0, address: int = 0) -> int:
    """The value that a query is answered with."""
    port.write(request(index, parameter, address))
    return answer_value(port.read(ANSWER_LENGTH))
