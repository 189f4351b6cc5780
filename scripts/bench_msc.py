"""The benchmarks of the MSC: a request, its ACK and the reply, and the host's ACK.

What an exchange costs depends on how much is answered: the status word (24 bytes with the ACK), one
variable (19), a block of 32 (143).
"""

from __future__ import annotations

from scripts.bench_line import Dialogue, Twin, compare, compare_in_process, transports

ACK = b"\x06"
MODEL = "msc-250:1"
MSC = Twin(MODEL, ("response_delay_ms=0", "reply_delay_ms=0"), 9600)
ADDRESS = (2048).to_bytes(2, "big")
VALUES_OF_A_BLOCK = 32


def packet(body: bytes) -> bytes:
    """A packet of unit 1, of either direction."""
    counted = b"\x01" + len(body).to_bytes(2, "big") + bytes(2) + body
    return b"\x02" + counted + sum(counted).to_bytes(2, "big")


def dialogue(name: bytes, field: bytes, answered: bytes) -> Dialogue:
    """A read command with what a controller answers that has just started."""
    return Dialogue(packet(name + b"," + field), ACK + packet(name + b"," + answered), ACK)


DIALOGUES = {
    "RQSTAT": dialogue(b"RQSTAT", b"", bytes(8)),
    "DREAD": dialogue(b"DREAD", ADDRESS, bytes(4)),
    "BREAD": dialogue(b"BREAD", ADDRESS, bytes(4 * VALUES_OF_A_BLOCK)),
}


def compare_msc(folder: str, seconds: float) -> None:
    """All comparisons of a controller, alone on its line."""
    for way in transports(folder):
        compare("MSC", way, MSC, DIALOGUES, seconds)
    compare_in_process("MSC", f"axistwin://{MODEL}?time=virtual", MSC, DIALOGUES, seconds)
