"""The operations of a sequence: what four bytes can mean.

An operation is (what, first, second, pause): `what` picks a line of `OPERATIONS`, `first` and
`second` its arguments, and `pause` a wait after it.  Any four bytes are an operation.  Lines are
only ever appended: a recorded sequence keeps its meaning as long as the table is not longer than
what it names.

Nothing is broken but reads (RQSTAT and DREAD): a device that fails to look at a checksum would
carry out a broken write.  Left out where the device follows another reading than the default and
the ledger gives no exact rule: then a value is read instead.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, NAK, Packet
from axistwin_conformance.families.msc.sequences.sequence import UnitOperation, UnitSequence

Act = Callable[[UnitSequence, int, int], None]

# Values whose bytes mean something elsewhere, and the edges of 32 bits.
EDGES: Final = (
    0, 1, -1, 0x7FFFFFFF, -0x80000000, 0x02020202, 0x06060606, 0x15151515, 0x2C2C2C2C, 0x11131113,
    0x02010007, 0x80, -0x80, 0xFFFF, 0x10000, 0x00FF00FF,
)  # fmt: skip
SPREAD: Final = 0x9E3779B1, 0x85EBCA6B  # odd numbers that spread two bytes over 32 bits
STEP: Final = 0x01234567  # from one value of a block to the next
MOST_REFUSED: Final = 8
STRAYS: Final = (ACK, NAK, ACK + NAK + ACK, NAK + NAK)
UNRULED_NAKS: Final = ("stray_nak",)
UNRULED_TIMES: Final = ("packet_timeout_mode",)
LONGEST_PIECE: Final = 0.3  # of the packet's time limit


def value_of(first: int, second: int) -> int:
    """A value for two bytes: an edge, or any."""
    if second < len(EDGES):
        return EDGES[second]
    return codec.signed(first * SPREAD[0] ^ second * SPREAD[1])


def block_of(first: int, second: int) -> tuple[int, ...]:
    """32 values for two bytes, all different unless they are all the same edge."""
    start = value_of(first, second)
    step = 0 if second < len(EDGES) and first & 1 else STEP
    return tuple(codec.signed(start + number * step) for number in range(codec.BLOCK_VALUES))


def _spot(run: UnitSequence, byte: int) -> int:
    return run.spots[byte % len(run.spots)]


def _block(run: UnitSequence, byte: int) -> int:
    return run.blocks[byte % len(run.blocks)]


def _flag(run: UnitSequence, byte: int) -> int:
    return run.flags[byte % len(run.flags)]


def _read(run: UnitSequence, first: int, second: int) -> None:
    run.read(_spot(run, first))


def _write(run: UnitSequence, first: int, second: int) -> None:
    run.write(_spot(run, first), value_of(first, second))


def _write_and_read(run: UnitSequence, first: int, second: int) -> None:
    _write(run, first, second)
    _read(run, first, second)


def _read_block(run: UnitSequence, first: int, second: int) -> None:
    run.read_block(_block(run, first)) if run.blocks else _read(run, first, second)


def _write_block(run: UnitSequence, first: int, second: int) -> None:
    if run.blocks:
        run.write_block(_block(run, first), block_of(first, second))
    else:
        _write(run, first, second)


def _turn(on: bool) -> Act:
    return lambda run, first, second: run.turn(_flag(run, first), on)


def _read_flag(run: UnitSequence, first: int, second: int) -> None:
    run.read_flag(_flag(run, first))


def _read_flags(run: UnitSequence, first: int, second: int) -> None:
    run.read_flags() if run.driver.has_rflags else _read_flag(run, first, second)


def _status(run: UnitSequence, first: int, second: int) -> None:
    run.reply(codec.RQSTAT)


def _asked(run: UnitSequence, which: int, answer: bytes | None) -> Packet:
    """One of the reads, with that sign after its reply."""
    match which % 4:
        case 0:
            return run.reply(codec.RQSTAT, answer)
        case 1:
            return run.read_flag(_flag(run, which >> 2), answer)
        case 2 if run.blocks:
            return run.read_block(_block(run, which >> 2), answer)
    return run.read(_spot(run, which >> 2), answer)


def _refuse(run: UnitSequence, first: int, second: int) -> None:
    """A read, its reply refused so many times."""
    count = second % MOST_REFUSED
    if not count or not run.follows(*UNRULED_NAKS):
        _asked(run, first, ACK)
        return
    run.repeated(_asked(run, first, NAK), count)


def _leave_unanswered(run: UnitSequence, first: int, second: int) -> None:
    """A read whose reply gets no sign: the next operation finds the unit waiting."""
    _asked(run, first, None)
    run.waiting_since_ns = run.target.now_ns


def _let_time_pass(run: UnitSequence, first: int, second: int) -> None:
    """A read whose reply gets its sign only when it has come again."""
    if run.follows("ack_timeout_action"):
        run.unanswered(_asked(run, first, None))
    else:
        _asked(run, first, ACK)


def _harmless(run: UnitSequence, which: int) -> bytes:
    """The body of a read that may be broken."""
    return codec.RQSTAT if which & 1 else codec.dread(_spot(run, which >> 1))


def _wrong_checksum(run: UnitSequence, first: int, second: int) -> None:
    raw = run.client.request(_harmless(run, first))
    offset = second + 1 if first & 2 else (second + 1) << 8
    run.refused("MSC-LNK-02", codec.with_wrong_checksum(raw, offset % 0xFFFF or 1))


def _turned_bit(run: UnitSequence, first: int, second: int) -> None:
    raw = bytearray(run.client.request(_harmless(run, first)))
    places = (len(raw) - codec.HEADER_BYTES) * 8
    place = (first * 256 + second) % places
    raw[codec.HEADER_BYTES + place // 8] ^= 1 << place % 8
    run.refused("MSC-PROP-04", bytes(raw))


def _cut_short(run: UnitSequence, first: int, second: int) -> None:
    raw = run.client.request(_harmless(run, first))
    # A 02h alone may be for anybody (MSC-AMB-31).
    place = 2 + second % (len(raw) - 2)
    if run.follows(*UNRULED_TIMES):
        run.broken_off(raw[:place])
    else:
        _read(run, first, second)


def _in_pieces(run: UnitSequence, first: int, second: int) -> None:
    body = _harmless(run, first)
    place = 1 + second % (len(run.client.request(body)) - 1)
    run.in_pieces(body, place, run.driver.client.packet_timeout_s * LONGEST_PIECE * (first / 0xFF))


def _stray_sign(run: UnitSequence, first: int, second: int) -> None:
    run.finish_waiting()
    stray = STRAYS[first % len(STRAYS)]
    if NAK in stray and not run.follows(*UNRULED_NAKS):
        stray = ACK
    run.client.send(stray)
    run.silence("MSC-LNK-15", stray)


def _junk(run: UnitSequence, first: int, second: int) -> None:
    run.finish_waiting()
    if not run.follows("noise_in_idle", *UNRULED_NAKS):
        _read(run, first, second)
        return
    junk = codec.i32(value_of(first, second)) + bytes([first, second])
    junk = junk.replace(codec.STX, b"\x03")
    run.client.send(junk)
    run.silence("MSC-PROP-15", junk)


def _wait(run: UnitSequence, first: int, second: int) -> None:
    run.pause(first / 1000)


OPERATIONS: Final[tuple[UnitOperation, ...]] = (
    UnitOperation("read a value", _read),
    UnitOperation("write a value", _write),
    UnitOperation("read a block", _read_block),
    UnitOperation("write a block", _write_block),
    UnitOperation("set a flag", _turn(True)),
    UnitOperation("clear a flag", _turn(False)),
    UnitOperation("read a flag", _read_flag),
    UnitOperation("read all flags", _read_flags),
    UnitOperation("read the status", _status),
    UnitOperation("refuse a reply", _refuse, True),
    UnitOperation("leave a reply unanswered", _leave_unanswered),
    UnitOperation("spoil a checksum", _wrong_checksum, True),
    UnitOperation("turn a bit", _turned_bit, True),
    UnitOperation("send in pieces", _in_pieces, True),
    UnitOperation("send a stray sign", _stray_sign, True),
    UnitOperation("send junk", _junk, True),
    UnitOperation("wait", _wait),
    UnitOperation("write a value", _write),
    UnitOperation("write a value and read it", _write_and_read),
    UnitOperation("write a block", _write_block),
    UnitOperation("read a block", _read_block),
    UnitOperation("set a flag", _turn(True)),
    UnitOperation("cut a packet short", _cut_short, True),
    UnitOperation("let the reply come again", _let_time_pass, True),
)
WHAT: Final = {
    operation.name: number for number, operation in reversed(list(enumerate(OPERATIONS)))
}
