"""Twins that each do one thing wrong, and what a run needs to judge them by a check of the link."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from msc_twin import TwinPort
from zoo.mutant import MonkeyPatch, Mutant
from zoo_msc.planting import alarms, around

from axistwin.devices.msc.packets import Whom
from axistwin.devices.msc.receiver import Receiver
from axistwin_conformance.base.check import Check
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, STX
from axistwin_conformance.families.msc.options import ScratchArea

Make = Callable[[MonkeyPatch], TwinPort]
Turn = Callable[[bytes], bytes]
Accepts = Callable[[bytes], bool]
SCRATCH: Final = ScratchArea(range(1024, 5120), range(128, 240), (240, 6144))
PROGRAM_NEEDS: Final = frozenset({"program", "rig:power"})


def twin(**how: Any) -> Make:
    """A twin with these readings."""
    return lambda patch: TwinPort(**how)


def with_fault(*mutants: Mutant, **how: Any) -> Make:
    """A twin with faults of the zoo."""

    def make(patch: MonkeyPatch) -> TwinPort:
        for mutant in mutants:
            mutant.alter(patch)
        return TwinPort(**how)

    return make


def changed(change: Callable[[TwinPort], None], **how: Any) -> Make:
    """A twin in which something has been changed."""

    def make(patch: MonkeyPatch) -> TwinPort:
        port = TwinPort(**how)
        change(port)
        return port

    return make


# --- what it sends --------------------------------------------------------------------------------


def packets_spoilt(turn: Turn) -> Make:
    """A unit whose packets, not its signs, become something else."""
    return _spoilt(lambda data: data if len(data) == 1 else turn(data))


def signs_spoilt(sign: bytes, instead: bytes) -> Make:
    """A unit that says something else for one of the signs."""
    return _spoilt(lambda data: instead if data == sign else data)


def _spoilt(spoil: Turn) -> Make:
    return changed(lambda port: setattr(port, "spoil", spoil))


def resummed(raw: bytes) -> bytes:
    """The packet under its right sum."""
    return raw[:-2] + codec.u16(codec.checksum(raw[1:-2]))


def swapped_sum(raw: bytes) -> bytes:
    """The packet with its checksum low byte first."""
    return raw[:-2] + raw[:-3:-1]


def with_byte(raw: bytes, at: int, byte: int) -> bytes:
    """One byte replaced, under the right sum."""
    return resummed(raw[:at] + bytes([byte]) + raw[at + 1 :])


def repeats_differ() -> Make:
    """A unit whose repeats have another last byte, under the right sum."""

    def change(port: TwinPort) -> None:
        unit, again = port.receiver, port.receiver._repeat

        def fault(now: int, start_ns: int) -> None:
            unit._reply = with_byte(unit._reply, -3, unit._repeats + 1)
            again(now, start_ns)

        unit._repeat = fault

    return changed(change)


def repeating_what_is_over() -> Make:
    """A unit whose time limit for the host's sign outlives the exchange."""

    def late(go: Callable[..., None], unit: Any, now: int) -> None:
        go()
        unit.alarm_ns = now + unit._answer_ns

    def make(patch: MonkeyPatch) -> TwinPort:
        alarms(patch, lambda unit, now: unit._send(now, unit._reply))
        around(patch, Receiver, "_await_answer", late)
        return TwinPort()

    return make


def talking(at_ns: int, **how: Any) -> Make:
    """A unit that says something by itself at that time."""

    def make(patch: MonkeyPatch) -> TwinPort:
        alarms(patch, lambda unit, now: unit._send(now, STX))
        port = TwinPort(**how)
        port.receiver.alarm_ns = at_ns
        return port

    return make


# --- what it takes --------------------------------------------------------------------------------


def judging(turn: Turn) -> Make:
    """A unit that judges another packet than the one that has come."""

    def change(port: TwinPort) -> None:
        judge = port.receiver._judge
        port.receiver._judge = lambda raw, now: judge(turn(raw), now)

    return changed(change)


def summing(accepts: Accepts) -> Make:
    """A unit that takes a packet for sound when `accepts` says so, whatever its sum is."""
    return judging(lambda raw: resummed(raw) if accepts(raw) else codec.with_wrong_checksum(raw))


def refusing(refuses: Accepts) -> Make:
    """A unit that refuses packets that it should serve."""
    return judging(lambda raw: codec.with_wrong_checksum(raw) if refuses(raw) else raw)


def sums_to(raw: bytes, total: int) -> bool:
    """True if that is the checksum the packet carries."""
    return int.from_bytes(raw[-2:], "big") == total & 0xFFFF


def answering(answers: dict[bytes, bytes]) -> Make:
    """A unit that says something to bytes that are none of its business while it is idle."""

    def change(port: TwinPort) -> None:
        unit = port.receiver

        def fault(byte: int, now: int) -> None:
            if sign := answers.get(bytes([byte])):
                unit._sign(now, now + unit._delay_ns, sign, unit._rest)

        unit._heeds_noise, unit._take_noise = True, fault

    return changed(change)


def confused() -> Make:
    """A unit that says ACK to a byte that is no answer to its reply."""

    def change(port: TwinPort) -> None:
        unit, take = port.receiver, port.receiver._take_waiting

        def fault(byte: int, now: int) -> None:
            if bytes([byte]) in (codec.ACK, codec.NAK, codec.STX):
                take(byte, now)
            else:
                unit._stay_busy(now, unit._send(now + unit._delay_ns, ACK), unit._await_answer)

        unit._take_waiting = fault
        unit._quiet_while_waiting = lambda data: (0, False)

    return changed(change)


def answering_for(*numbers: int, **how: Any) -> Make:
    """A unit that takes these numbers for its own too."""

    def change(port: TwinPort) -> None:
        whom = enumerate(port.receiver._whom_of)
        port.receiver._whom_of = tuple(Whom.OWN if n in numbers else each for n, each in whom)

    return changed(change, **how)


def at_bad_characters(act: Callable[[Receiver, int], None]) -> Make:
    """A unit that does something of its own where a character has no stop bit."""

    def change(port: TwinPort) -> None:
        take = port.receiver._take_bad

        def fault(chunk: Any) -> None:
            take(chunk)
            act(port.receiver, chunk.start_ns)

        port.receiver._take_bad = fault

    return changed(change)


def dropping_repeated_writes() -> Make:
    """A unit with the bench program that does not carry out a write that comes again."""

    def change(port: TwinPort) -> None:
        served, last = port.served, [b""]

        def fault(request: codec.Packet) -> bytes | None:
            is_repeat = request.name in codec.WRITES and request.raw == last[0]
            last[0] = request.raw if request.name in codec.WRITES else last[0]
            return b"" if is_repeat else served(request)

        port.served = fault

    return changed(change, program=True)


# --- runs -----------------------------------------------------------------------------------------


def needed_by(check: Check) -> dict[str, Any]:
    """How a twin is made that has what a check needs."""
    if "neighbour" in check.needs:
        return {"others": (2, 3)}
    return {"program": bool(PROGRAM_NEEDS & {*check.needs})}


def sound(check: Check) -> TwinPort:
    """A unit without fault that has what a check needs."""
    return TwinPort(**needed_by(check))


def doubled(raw: bytes) -> bytes:
    """The packet twice."""
    return raw + raw


def only_low(raw: bytes) -> bool:
    """True if the low byte of the sum is right."""
    return raw[-1] == codec.checksum(raw[1:-2]) & 0xFF


def has_odd_body(raw: bytes) -> bool:
    """True for a body of odd length."""
    return raw[3] % 2 == 1


def values_reversed(raw: bytes) -> bytes:
    """A DREAD reply with its value low byte first."""
    is_value = raw[6:12] == b"DREAD,"
    return resummed(raw[:12] + raw[-3:-7:-1] + raw[-2:]) if is_value else raw


def no_xoff(raw: bytes) -> bytes:
    """The bytes without XON and XOFF, as a terminal driver hands them on."""
    return raw.translate(None, b"\x11\x13")


def length_swapped(raw: bytes) -> bytes:
    """The packet with its length low byte first."""
    return resummed(raw[:2] + raw[3:1:-1] + raw[4:])


def flags_reversed(raw: bytes) -> bytes:
    """An RFLAGS reply with its bytes in the other order."""
    is_flags = raw[6:13] == b"RFLAGS,"
    return resummed(raw[:13] + raw[-3:12:-1] + raw[-2:]) if is_flags else raw


def for_block_0(raw: bytes) -> bool:
    """True for a packet whose block number is not 0."""
    return raw[4:6] != b"\x00\x00"
