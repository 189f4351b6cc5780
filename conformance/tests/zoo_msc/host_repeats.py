"""Faults of the link where the host repeats a packet (LNK)."""

from __future__ import annotations

from typing import Any

from axistwin.devices.msc.packets import is_sum_right
from axistwin.devices.msc.receiver import ACCEPTED
from zoo_msc.planting import ACK, Any_, MonkeyPatch, Receiver, around, bodies, msc_mutant, name_of


@msc_mutant("MSC-LNK-18", traps=(15,))
def a_write_that_comes_twice_is_carried_out_once(patch: MonkeyPatch) -> None:
    """A write that equals the last one, byte for byte, is taken for its repeat."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        is_write = body[:1] in b"BDSC" and body[1:6] in (b"WRITE", b"FLAG,")
        if not is_write:
            return go()
        before, unit.last_write = getattr(unit, "last_write", b""), body
        return ACCEPTED if body == before else go()

    bodies(patch, act)


@msc_mutant("MSC-LNK-18", traps=(15,))
def a_write_with_the_last_block_number_is_carried_out_once(patch: MonkeyPatch) -> None:
    """Where block numbers count, one that comes twice is a repeat."""

    def act(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        block = raw[4:6]
        is_repeat = (
            any(block) and block == getattr(receiver, "last_block", b"")
            and name_of(raw) == "SFLAG" and is_sum_right(raw)
        )  # fmt: skip
        if name_of(raw) == "SFLAG":
            receiver.last_block = block
        if is_repeat:
            receiver._sign(now, now + receiver._delay_ns, bytes([ACK]), receiver._rest)
        else:
            go()

    around(patch, Receiver, "_judge", act)


@msc_mutant("MSC-PROP-05")
def two_packets_of_one_sum_are_one(patch: MonkeyPatch) -> None:
    """A packet whose checksum is that of the one before is refused, if its bytes are others."""

    def act(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        before, receiver.last_raw = getattr(receiver, "last_raw", b""), raw
        is_other = before[-2:] == raw[-2:] and before[4:6] != raw[4:6]
        if is_other and is_sum_right(raw):
            receiver._refuse(now)
        else:
            go()

    around(patch, Receiver, "_judge", act)


@msc_mutant("MSC-LNK-22", "MSC-LNK-06")
def the_repeat_of_a_refused_write_is_only_acknowledged(patch: MonkeyPatch) -> None:
    """A write that a wrong sum had refused, or that was cut short, is taken for done when it comes
    again."""

    def judge(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        before, receiver.refused = getattr(receiver, "refused", b""), b""
        if not is_sum_right(raw):
            receiver.refused = raw[:-2]
        elif before == raw[:-2] and name_of(raw) in ("DWRITE", "BWRITE", "SFLAG", "CFLAG"):
            receiver._sign(now, now + receiver._delay_ns, bytes([ACK]), receiver._rest)
            return
        go()

    def give_up(go: Any_, receiver: Any, now: int) -> None:
        receiver.refused = bytes(receiver._packet[:-1])
        go()

    around(patch, Receiver, "_judge", judge)
    around(patch, Receiver, "_give_up_packet", give_up)
