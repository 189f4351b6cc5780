"""A small MSC in virtual time, written from the manual for the suite's own tests: what the suite
takes for a sound unit must not hang on the twin, which is judged by it."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from functools import partial
from typing import Any

from axistwin_conformance.base.check import Check, check
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.core.session import Envelope, Run, Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, NAK, STX
from axistwin_conformance.families.msc.family import FAMILY
from axistwin_conformance.families.msc.options import TWIN_SCRATCH
from axistwin_conformance.transport.serial import SerialTransport

BYTE_NS = 10_000_000_000 // 9600
T1_NS = T2_NS = 1_000_000_000
RESPONSE_NS, REPLY_NS = 5_000_000, 10_000_000
REPEATS = 5
SIZE = 32768
STRIDE = 4

Spoil = Callable[[bytes], bytes]


class MscPort:
    """A pyserial port with one unit behind it, on RS-232.

    `spoil`: what becomes of each thing the unit sends; `read_only`: flags that SFLAG leaves alone.
    """

    virtual_time_ns = 0
    timeout: float | None = 0.0
    baudrate = 9600

    def __init__(self, unit: int = 1, *, has_rflags: bool = True) -> None:
        self.unit, self.has_rflags = unit, has_rflags
        self.data: dict[int, int] = {}
        self.flags: set[int] = set()
        self.status = 65
        self.read_only = range(128)
        self.spoil: Spoil = lambda data: data
        self.heard = b""  # everything the host has sent
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._count = 0
        self._host_free_ns = self._free_ns = 0
        self._packet, self._reply, self._repeats = b"", b"", 0
        self._timer = 0  # what is armed, by number: the others are void
        self._ready: list[bytes] = []

    # --- the port -------------------------------------------------------------------------------

    @property
    def in_waiting(self) -> int:
        """Bytes that are there."""
        self._run(self.virtual_time_ns)
        return len(self._ready)

    def write(self, data: bytes) -> int:
        """Put bytes on the line, one after another."""
        self.heard += data
        for one in data:
            self._host_free_ns = max(self._host_free_ns, self.virtual_time_ns) + BYTE_NS
            self._at(self._host_free_ns, partial(self._hear, bytes([one])))
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """Bytes as they come; time passes until there are so many, or the time-out is over."""
        end_ns = self.virtual_time_ns + round((self.timeout or 0) * 1e9)
        while len(self._ready) < size and self._events and self._events[0][0] <= end_ns:
            self._run(self._events[0][0])
        if len(self._ready) < size:
            self._run(end_ns)
        taken = b"".join(self._ready[:size])
        del self._ready[:size]
        return taken

    def close(self) -> None:
        """Nothing to close."""

    def _at(self, time_ns: int, act: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._events, (time_ns, self._count, act))

    def _run(self, until_ns: int) -> None:
        while self._events and self._events[0][0] <= until_ns:
            self.virtual_time_ns, _, act = heapq.heappop(self._events)
            act()
        self.virtual_time_ns = max(self.virtual_time_ns, until_ns)

    # --- the unit -------------------------------------------------------------------------------

    def _say(self, data: bytes, delay_ns: int) -> int:
        """Send after a delay; return when the last byte has left."""
        at_ns = max(self.virtual_time_ns, self._free_ns) + delay_ns
        for one in self.spoil(data):
            at_ns += BYTE_NS
            self._at(at_ns, partial(self._ready.append, bytes([one])))
        self._free_ns = at_ns
        return at_ns

    def _arm(self, time_ns: int, act: Callable[[], None]) -> None:
        self._timer += 1
        number = self._timer
        self._at(time_ns, lambda: act() if self._timer == number else None)

    def _hear(self, byte: bytes) -> None:
        if not self._packet:
            self._hear_idle(byte)
            return
        self._packet += byte
        if not codec.missing_bytes(self._packet):
            self._timer += 1
            raw, self._packet = self._packet, b""
            if raw[1] == self.unit:
                self._serve(raw)

    def _hear_idle(self, byte: bytes) -> None:
        if byte == STX:
            self._reply, self._packet = b"", byte
            self._arm(self.virtual_time_ns + T1_NS, self._broken_off)
        elif self._reply and byte == ACK:
            self._reply = b""
            self._timer += 1
        elif self._reply and byte == NAK:
            self._again()

    def _broken_off(self) -> None:
        raw, self._packet = self._packet, b""
        if raw[1:2] in (b"", bytes([self.unit])):
            self._say(NAK, 0)

    def _again(self) -> None:
        if self._repeats == REPEATS:
            self._reply = b""
            self._timer += 1
            return
        self._repeats += 1
        self._arm(self._say(self._reply, RESPONSE_NS) + T2_NS, self._again)

    def _serve(self, raw: bytes) -> None:
        one = codec.parse(raw)
        assert one is not None
        served = self._served(one) if one.is_request else None
        self._say(NAK if served is None else ACK, RESPONSE_NS)
        if served:
            self._reply = codec.packet(self.unit, codec.body(one.name, served))
            self._repeats = 0
            self._arm(self._say(self._reply, REPLY_NS) + T2_NS, self._again)

    def _served(self, one: codec.Packet) -> bytes | None:
        """What is behind the comma of the reply; empty: there is none; None: refused."""
        number = one.numbers[0] if one.numbers else 0
        is_block = one.name[0] == "B"
        if one.name in ("DREAD", "BREAD", "DWRITE", "BWRITE"):
            places = range(number, number + (32 if is_block else 1) * STRIDE, STRIDE)
            if places[-1] >= SIZE:
                return None
            if one.name in ("DREAD", "BREAD"):
                return b"".join(codec.i32(self.data.get(at, 0)) for at in places)
            values = one.payload[2:]
            for index, at in enumerate(places):
                self.data[at] = int.from_bytes(values[4 * index :][:4], "big", signed=True)
            return b""
        return self._served_flag(one.name, number)

    def _served_flag(self, name: str, number: int) -> bytes | None:
        if name == "RQSTAT":
            return codec.u16(self.status) + bytes(6)
        if name == "RFLAGS":
            states = bytes(sum(1 << bit for bit in range(8) if 8 * k + bit in self.flags)
                           for k in range(32))  # fmt: skip
            return states if self.has_rflags else None
        if number >= 256:
            return None
        if name == "RFLAG":
            return codec.u16(number in self.flags)
        if number not in self.read_only:
            (self.flags.add if name == "SFLAG" else self.flags.discard)(number)
        return b""


def target_of(port: MscPort, *, is_lossless: bool = True) -> SerialTransport:
    """The suite's view of it."""
    return SerialTransport(port, "a small MSC", is_lossless=is_lossless)


def session_on(port: MscPort, checked: Check | None = None, **how: Any) -> Session:
    """A session with it; `how`: fields of the run."""
    run = Run(
        **{
            "target": target_of(port), "family": FAMILY,
            "model": FAMILY.models["msc-250" if port.has_rflags else "msc-generic"],
            "ledger": load_ledger("msc"), "address": port.unit, "neighbours": (),
            "allowed": frozenset({"passive", "stored"}), "envelope": Envelope(0, 0), "seed": 0,
            "settings": TWIN_SCRATCH, **how,
        }
    )  # fmt: skip
    return Session(run, checked)


def check_of(*safety: str, needs: tuple[str, ...] = ()) -> Check:
    """A check of these classes that does nothing by itself."""

    def nothing(session: Session) -> None:
        """Does nothing."""

    return check("MSC-LNK-01", safety=safety or "passive", needs=needs)(nothing)
