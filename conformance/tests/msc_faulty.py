"""Units that each do one thing wrong, and lines with several: what checks of the link must see."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from msc_device import BYTE_NS, REPEATS, REPLY_NS, RESPONSE_NS, T2_NS, MscPort

from axistwin_conformance.base.check import Check
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, NAK, STX, Packet
from axistwin_conformance.families.msc.options import ScratchArea

Accepts = Callable[[bytes], bool]
SCAN_NS = 10_000_000
PROGRAM = (240, 6144)
GROUNDS = ScratchArea(range(1024, 5120), range(128, 240), PROGRAM)
Make = Callable[[], MscPort]


def packets_spoilt(turn: Callable[[bytes], bytes]) -> Callable[[], MscPort]:
    """A unit whose packets, not its signs, become something else."""

    def make() -> MscPort:
        port = MscPort()
        port.spoil = lambda data: data if len(data) == 1 else turn(data)
        return port

    return make


def signs_spoilt(sign: bytes, instead: bytes) -> Callable[[], MscPort]:
    """A unit that says something else for one of the signs."""

    def make() -> MscPort:
        port = MscPort()
        port.spoil = lambda data: instead if data == sign else data
        return port

    return make


def resummed(raw: bytes) -> bytes:
    """The packet under its right sum."""
    return raw[:-2] + codec.u16(codec.checksum(raw[1:-2]))


def swapped_sum(raw: bytes) -> bytes:
    """The packet with its checksum low byte first."""
    return raw[:-2] + raw[:-3:-1]


def with_byte(raw: bytes, at: int, byte: int) -> bytes:
    """One byte replaced, under the right sum."""
    return resummed(raw[:at] + bytes([byte]) + raw[at + 1 :])


class Summing(MscPort):
    """Takes a packet for sound when `accepts` says so, and looks at nothing else of its sum."""

    def __init__(self, accepts: Accepts) -> None:
        super().__init__()
        self._accepts = accepts

    def _serve(self, raw: bytes) -> None:
        super()._serve(resummed(raw) if self._accepts(raw) else codec.with_wrong_checksum(raw))


def sums_to(raw: bytes, total: int) -> bool:
    """True if that is the checksum the packet carries."""
    return int.from_bytes(raw[-2:], "big") == total & 0xFFFF


class Refusing(MscPort):
    """Refuses packets that it should serve."""

    def __init__(self, refuses: Accepts) -> None:
        super().__init__()
        self._refuses = refuses

    def _serve(self, raw: bytes) -> None:
        if self._refuses(raw):
            self._say(NAK, RESPONSE_NS)
        else:
            super()._serve(raw)


class Restarting(MscPort):
    """Begins anew at any 02h (trap 2)."""

    def _hear(self, byte: bytes) -> None:
        if byte == STX:
            self._packet = b""
        super()._hear(byte)


class Hunting(MscPort):
    """Serves what lies inside a packet too, whether it has refused that or not."""

    def _serve(self, raw: bytes) -> None:
        super()._serve(raw)
        at = raw.find(STX + bytes([self.unit]), 1)
        if at > 0:
            super()._serve(raw[at:][: codec.REQUEST_BYTES["RQSTAT"]])


class Storing(MscPort):
    """Carries a write out though it refuses it."""

    def _serve(self, raw: bytes) -> None:
        one = codec.parse(raw)
        if one is not None and not one.is_sound and one.name in codec.WRITES:
            self._served(one)
        super()._serve(raw)


class Repeating(MscPort):
    """Repeats in its own way: `limit` times, with an ACK before, other bytes, or a count that is
    not reset."""

    def __init__(
        self, limit: int = REPEATS, *, ack: bool = False, turn: bool = False, resets: bool = True
    ) -> None:
        super().__init__()
        self.limit, self.ack, self.turn, self.resets = limit, ack, turn, resets
        self._all = 0

    def _again(self) -> None:
        count = self._repeats if self.resets else self._all
        if count >= self.limit:
            self._reply = b""
            self._timer += 1
            return
        self._repeats += 1
        self._all += 1
        if self.ack:
            self._say(ACK, RESPONSE_NS)
        if self.turn:
            self._reply = with_byte(self._reply, -3, self._repeats)
        self._arm(self._say(self._reply, RESPONSE_NS) + T2_NS, self._again)


class Impatient(MscPort):
    """Does not stop its time-outs where an exchange ends."""

    def _hear_idle(self, byte: bytes) -> None:
        if self._reply and byte == ACK:
            kept = self._reply
            self._at(self.virtual_time_ns + T2_NS, lambda: self._late(kept))
        super()._hear_idle(byte)

    def _late(self, raw: bytes) -> None:
        self._say(raw, 0)


class Confused(MscPort):
    """Says ACK to a byte that is no answer to its reply."""

    def _hear_idle(self, byte: bytes) -> None:
        if self._reply and byte not in (ACK, NAK, STX):
            self._say(ACK, RESPONSE_NS)
        super()._hear_idle(byte)


class Counting(MscPort):
    """Numbers its replies."""

    count = 0

    def _say(self, data: bytes, delay_ns: int) -> int:
        self.count += len(data) > 1
        own = codec.u16(self.count)
        return super()._say(
            resummed(data[:4] + own + data[6:]) if len(data) > 1 else data, delay_ns
        )


class Stubborn(MscPort):
    """Sends its last reply again to a NAK that comes when all is over."""

    last = b""

    def _hear_idle(self, byte: bytes) -> None:
        if byte == NAK and not self._reply and self.last:
            self._say(self.last, RESPONSE_NS)
        self.last = self._reply or self.last
        super()._hear_idle(byte)


class Waiting(MscPort):
    """Does nothing by itself when nobody answers its reply: it waits, or gives up after T2."""

    def __init__(self, *, gives_up: bool) -> None:
        super().__init__()
        self.gives_up = gives_up

    def _arm(self, time_ns: int, act: Callable[[], None]) -> None:
        if act == self._again:
            act = self._give_up if self.gives_up else lambda: None
        super()._arm(time_ns, act)

    def _give_up(self) -> None:
        self._reply = b""


class Answering(MscPort):
    """Says something to bytes that are none of its business: `answers` maps them."""

    def __init__(self, answers: dict[bytes, bytes]) -> None:
        super().__init__()
        self._answers = answers

    def _hear_idle(self, byte: bytes) -> None:
        is_waiting = bool(self._reply)
        super()._hear_idle(byte)
        if byte in self._answers and not is_waiting:
            self._say(self._answers[byte], RESPONSE_NS)


class Timing(MscPort):
    """Has time-outs of its own: `t1_ns` from the beginning, or from the last byte (`is_gap`), and
    `t2_ns`; `twice`: refuses what broke off two times; `from_noise`: the first byte of anything
    starts it."""

    def __init__(
        self, t1_ns: int = 1_000_000_000, t2_ns: int = T2_NS, *, is_gap: bool = False,
        twice: bool = False, from_noise: bool = False,
    ) -> None:  # fmt: skip
        super().__init__()
        self.t1_ns, self.t2_ns, self.is_gap = t1_ns, t2_ns, is_gap
        self.twice, self.from_noise = twice, from_noise
        self._noise_ns: int | None = None

    def _hear(self, byte: bytes) -> None:
        was_idle = not self._packet
        super()._hear(byte)
        if was_idle and not self._packet and not self._reply and byte not in (ACK, NAK):
            self._noise_ns = self._noise_ns or self.virtual_time_ns
        if self._packet and (was_idle or self.is_gap):
            began_ns = self.virtual_time_ns
            if self.from_noise and self._noise_ns is not None:
                began_ns = self._noise_ns
            self._arm(max(began_ns + self.t1_ns, self.virtual_time_ns), self._broken_off)

    def _broken_off(self) -> None:
        super()._broken_off()
        self._noise_ns = None
        if self.twice:
            self._say(NAK, RESPONSE_NS)

    def _arm(self, time_ns: int, act: Callable[[], None]) -> None:
        own_ns = self.t2_ns - T2_NS if act == self._again else 0
        super()._arm(time_ns + own_ns, act)


class Uart(MscPort):
    """Hears characters at another rate as ones without a stop bit: `reading` of MSC-AMB-43, or
    "deaf": from then on it hears nothing, "answers": it says NAK, "forgets": its reply is over."""

    def __init__(self, reading: str = "bad_packet") -> None:
        super().__init__()
        self.reading = reading
        self._bad = self._is_deaf = False

    def write(self, data: bytes) -> int:
        """Hear a character that has no stop bit, or what it is."""
        if self.baudrate == 9600:
            return super().write(data)
        self._at(self.virtual_time_ns + BYTE_NS, self._hear_bad)
        return len(data)

    def _hear_bad(self) -> None:
        if self.reading == "deaf":
            self._is_deaf = True
        if self.reading == "answers":
            self._say(NAK, 0)
        if self.reading == "forgets":
            self._reply = b""
        if not self._packet or self.reading == "drop_byte":
            return
        self._bad = self.reading == "bad_packet"
        self._hear(b"\x00")

    def _hear(self, byte: bytes) -> None:
        if not self._packet:
            self._bad = False
        if not self._is_deaf:
            super()._hear(byte)

    def _serve(self, raw: bytes) -> None:
        super()._serve(codec.with_wrong_checksum(raw) if self._bad else raw)
        self._bad = False


class Programmed(MscPort):
    """Has the bench program: `fresh`: repeats carry new data; `once`: a write that comes again is
    not carried out."""

    def __init__(self, *, fresh: bool = False, once: bool = False, changes: bool = True) -> None:
        super().__init__()
        self.fresh, self.once, self.changes = fresh, once, changes
        self._last = b""

    def _served(self, one: Packet) -> bytes | None:
        if self.changes:
            self.data[PROGRAM[1] + 4] = self.virtual_time_ns // SCAN_NS
        if one.name in codec.WRITES:
            is_repeat, self._last = one.raw == self._last, one.raw
            if self.once and is_repeat:
                return b""
        if one.name == "SFLAG" and one.numbers == (PROGRAM[0],):
            self.data[PROGRAM[1]] = self.data.get(PROGRAM[1], 0) + 1
            return b""
        return super()._served(one)

    def _again(self) -> None:
        if self.fresh:
            self._reply = with_byte(self._reply, -3, self.virtual_time_ns // SCAN_NS & 0xFF)
        super()._again()


class Powered(MscPort):
    """Has a supply; `greets`: says something when it comes; `keeps`: what waits outlives a cut."""

    capabilities = frozenset({"power", "flag", "status", "program"})
    is_exact = True

    def __init__(self, *, greets: bytes = b"", keeps: bool = False) -> None:
        super().__init__()
        self.greets, self.keeps, self.is_off = greets, keeps, False

    def power_off(self) -> tuple[int, int]:
        """Cut the supply; the macroprogram does not start by itself after that."""
        self.set_status(0, False)
        self.is_off = True
        if not self.keeps:
            self._packet, self._reply = b"", b""
            self._timer += 1
            self._events.clear()
            self._free_ns = 0
        return self.virtual_time_ns, self.virtual_time_ns

    def power_on(self) -> tuple[int, int]:
        """Give it back."""
        self.is_off = False
        if self.greets:
            self._say(self.greets, 0)
        return self.virtual_time_ns, self.virtual_time_ns

    def run_program(self, running: bool) -> None:
        """Start the macroprogram, or stop it."""
        self.set_status(0, running)

    def set_flag(self, number: int, on: bool) -> None:
        """Turn a flag on or off by the machine."""
        (self.flags.add if on else self.flags.discard)(number)

    def set_status(self, bit: int, on: bool) -> None:
        """Bring a condition about."""
        self.status = self.status | 1 << bit if on else self.status & ~(1 << bit)

    def _hear(self, byte: bytes) -> None:
        if not self.is_off:
            super()._hear(byte)


class Neighbour(MscPort):
    """A further unit behind the port of another one."""

    def __init__(self, line: Line, unit: int) -> None:
        self._line = line
        super().__init__(unit)

    virtual_time_ns = property(lambda self: self._line.virtual_time_ns)

    @property
    def _ready(self) -> list[bytes]:
        return self._line._ready

    @_ready.setter
    def _ready(self, value: list[bytes]) -> None:
        """It is the line's."""

    def _at(self, time_ns: int, act: Callable[[], None]) -> None:
        self._line._at(time_ns, act)

    def _say(self, data: bytes, delay_ns: int) -> int:
        return self._line.overheard(self, data, super()._say(data, delay_ns))

    def _broken_off(self) -> None:
        if self._packet == STX and not self._line.shouts:
            self._packet = b""
        else:
            super()._broken_off()


class Line(MscPort):
    """Several units on two wires, each of which hears the others.

    `shouts`: each refuses what broke off before its unit byte; `nosy`: unit 1 refuses what is
    broken for others; `answers_for`: and answers for these.
    """

    def __init__(
        self, others: tuple[int, ...] = (2, 3), *, shouts: bool = False, nosy: bool = False,
        answers_for: tuple[int, ...] = (), hunts: bool = False,
    ) -> None:  # fmt: skip
        super().__init__()
        self.shouts, self.nosy, self.answers_for, self.hunts = shouts, nosy, answers_for, hunts
        self.others = tuple(Neighbour(self, unit) for unit in others)

    def overheard(self, speaker: MscPort, data: bytes, end_ns: int) -> int:
        """Let all but the speaker hear what is said until then."""
        listeners = [one for one in (self, *self.others) if one is not speaker]
        for number, byte in enumerate(data, 1):
            at_ns = end_ns - (len(data) - number) * BYTE_NS
            for one in listeners:
                self._at(at_ns, partial(MscPort._hear, one, bytes([byte])))
        return end_ns

    def _say(self, data: bytes, delay_ns: int) -> int:
        return self.overheard(self, data, super()._say(data, delay_ns))

    def _hear(self, byte: bytes) -> None:
        before = self._packet
        super()._hear(byte)
        for one in self.others:
            one._hear(byte)
        whole = before + byte
        if before and not self._packet and whole[1] != self.unit:
            self._meddle(whole)

    def _meddle(self, raw: bytes) -> None:
        one = codec.parse(raw)
        if self.hunts and (at := raw.find(STX + bytes([self.unit]), 1)) > 0:
            self._serve(raw[at:][: codec.REQUEST_BYTES["RQSTAT"]])
        elif raw[1] in self.answers_for:
            is_right = sums_to(raw, codec.checksum(raw[1:-2]))
            self._serve(with_byte(raw, 1, self.unit) if is_right else raw)
        elif self.nosy and one is not None and not one.is_sound:
            self._say(NAK, RESPONSE_NS + REPLY_NS)

    def _broken_off(self) -> None:
        if self.nosy and len(self._packet) > 1:
            self._packet = b""
            self._say(NAK, RESPONSE_NS)
        elif self._packet == STX and not self.shouts:
            self._packet = b""
        else:
            super()._broken_off()


class Forgetful(MscPort):
    """Loses what comes while it talks."""

    def _hear_idle(self, byte: bytes) -> None:
        if self.virtual_time_ns >= self._free_ns:
            super()._hear_idle(byte)


def around(check: Check, port: MscPort) -> dict[str, Any]:
    """What a run needs for a check beside the port."""
    how: dict[str, Any] = {"settings": GROUNDS}
    if "neighbour" in check.needs:
        how["neighbours"] = (2, 3)
    if any(need in check.needs for need in ("rig:power", "rig:flag")):
        how["rig"] = port
    return how


def sound(check: Check) -> MscPort:
    """A unit without fault that has what a check needs."""
    if "neighbour" in check.needs:
        return Line()
    if "program" in check.needs:
        return Programmed()
    return Powered() if check.rig_needs else Uart()
