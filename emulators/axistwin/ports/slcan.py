r"""slcan: the ASCII protocol of serial CAN adapters, as the LAWICEL CAN232 and CANUSB speak it.

What python-can's ``slcan`` interface, Debian's ``slcand`` with the kernel's line discipline and the
tools around them send.  A command is a letter, its argument and CR; the answer ends with CR (done)
or is BEL (refused).

    command          allowed     answer      meaning
    Sn               closed      CR          bit rate by number (``RATES``)
    sxxyy            closed      CR          bit rate by BTR0 and BTR1 of an SJA1000 at 16 MHz
    O  L             closed      CR          open; open to listen only
    C                open        CR          close
    tiiildd..        normal      z CR        send a standard data frame: identifier, length, data
    Tiiiiiiiildd..   normal      Z CR        send an extended data frame
    riiil Riiiiiiiil normal      z, Z CR     send a remote frame
    Xn               closed      CR          frames come by themselves (1) or when polled (0)
    P  A             open        frames      poll: one frame or a bare CR; all, then A CR
    F                open        Fxx CR      status flags (``StatusFlags``), cleared by reading
    Zn               closed      CR          1: time behind each frame, ms, 0000..EA5F
    Wn               closed      CR          acceptance filter: 0 two short ones, 1 a long one
    Mxxxxxxxx        closed      CR          acceptance code, AC0 first
    mxxxxxxxx        closed      CR          acceptance mask: a 1 is a bit that does not matter
    Un               closed      CR          rate of the serial line; a pty and TCP have none
    Qn               open        CR          power up open: 0 no, 1 normal, 2 listen only
    V  v  N          any         Vhhss CR    versions, serial number

Rules
-----
1. Anything else, unknown, malformed, over-long or in the wrong state, is answered BEL and does
   nothing.
2. The acceptance filter is that of an SJA1000 (its data sheet, PeliCAN mode): code and mask compare
   identifier, remote bit and, in a standard frame, the first data bytes as far as there are any.
3. A frame taken in waits in the transmit queue until it is on the bus (``sent``).  While the queue
   is full, further ones are answered BEL.
4. An adapter with another bit rate than the bus understands nothing and is understood by nobody:
   no frame arrives, what it sends stays in its queue, and the error flags are set.  It is not
   modelled that it disturbs the others.
5. For a client that polls, frames wait in a queue; what does not fit is lost and flagged.  So is
   what a client loses because it does not read.
6. Only an adapter that is open, and not to listen only, acknowledges frames: what a device sends to
   a bus with nobody else is tried again until the client opens.

Where adapters differ, what clients rely on decides
---------------------------------------------------
- Frames come by themselves from the start (the CANUSB; a CAN232 is delivered with X0): neither
  python-can nor slcand ever sends X1.
- ``O`` works without a bit rate: python-can's ``slcanBus`` without ``bitrate=`` sends nothing else.
  The adapter is delivered set to the rate of its bus, as a CANable comes with a rate of its own.
- python-can closes before it sets a rate, then opens twice, and sends an empty line for "no FD
  rate" (``set_bitrate``).  The close of a closed and the second open are refused, as a CANUSB
  does; nobody reads it.  An empty line is no command and is not answered (as can-utils' slcanpty).
- S7 is 800 kbit/s (LAWICEL, kernel), 750 kbit/s to python-can: either is taken for a bus that runs
  so.  S9, 83.3 kbit/s, is python-can's and CANable's.
- LF is ignored: some clients end their lines with CR LF.
- The kernel drops lines of four characters and less unread, so z, Z and BEL harm it not.
- CAN FD (d D b B Y y) is refused: the bus is a classical one.
"""

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum, IntFlag
from typing import Final, NamedTuple

from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.ports.dialect import BusError, CanDialect, Out
from axistwin.wire.can_frame import CanFrame

OK: Final = b"\r"
BEL: Final = b"\a"

VERSION: Final = b"1013"
"""Hardware 1.0, software 1.3: that of a CANUSB."""

RATES: Final[dict[bytes, tuple[int, ...]]] = {
    b"0": (10_000,),
    b"1": (20_000,),
    b"2": (50_000,),
    b"3": (100_000,),
    b"4": (125_000,),
    b"5": (250_000,),
    b"6": (500_000,),
    b"7": (800_000, 750_000),
    b"8": (1_000_000,),
    b"9": (83_300,),
}
"""Bits per second that ``Sn`` may mean."""

_QUANTA_PER_S: Final = 8_000_000  # of an SJA1000 at 16 MHz with the prescaler at 1

# Two controllers understand one another if their rates differ by no more than this part.
_RATE_TOLERANCE: Final = 0.005

STANDARD_RATES: Final = tuple(sorted({rate for rates in RATES.values() for rate in rates}))
"""Those that a client chooses by a digit."""


def registers_of(bitrate: int) -> str:
    """The command ``sxxyy`` that sets a client to ``bitrate`` near enough; "" if none does."""
    settings = (
        (abs(_QUANTA_PER_S / prescaler / quanta - bitrate), prescaler, quanta)
        for prescaler in range(1, 65)
        for quanta in range(3, 26)
    )
    error, prescaler, quanta = min(settings)
    if error > bitrate * _RATE_TOLERANCE:
        return ""
    before = min(quanta - 3, 15)  # of the sample point, beyond the least there is
    return f"s{prescaler - 1:02X}{(quanta - 3 - before) << 4 | before:02X}"


LINE_BYTES_MAX: Final = 26
"""The longest command, an extended frame of eight bytes, without its CR."""

TRANSMIT_QUEUE_FRAMES: Final = 1024
"""A CANUSB has 8.  python-can, which sends without waiting and looks at no answer, would lose the
rest of a burst."""

RECEIVE_QUEUE_FRAMES: Final = 32
"""Frames kept for a client that polls (CAN232)."""

TIMESTAMP_PERIOD_MS: Final = 60_000


class StatusFlags(IntFlag):
    """What ``F`` reports."""

    RECEIVE_QUEUE_FULL = 0x01
    TRANSMIT_QUEUE_FULL = 0x02
    ERROR_WARNING = 0x04
    DATA_OVERRUN = 0x08
    ERROR_PASSIVE = 0x20
    ARBITRATION_LOST = 0x40
    BUS_ERROR = 0x80


_DEAF: Final = StatusFlags.ERROR_WARNING | StatusFlags.ERROR_PASSIVE | StatusFlags.BUS_ERROR


_FLAGS_OF: Final = {
    BusError.PROTOCOL | BusError.NO_ACKNOWLEDGE | BusError.BUS_ERROR: StatusFlags.BUS_ERROR,
    BusError.CONTROLLER: StatusFlags.ERROR_WARNING | StatusFlags.ERROR_PASSIVE,
    BusError.BUS_OFF: _DEAF,
}


class Channel(Enum):
    """What the controller in the adapter does."""

    CLOSED = "closed"
    NORMAL = "normal"
    LISTEN_ONLY = "listen only"


@dataclass(frozen=True, slots=True)
class Settings:
    """What an adapter remembers without power.

    bitrates: what the client's choice of rate may mean, bit/s; none: the rate of the bus.
    auto_start: the channel's state after power-up (``Q``).
    """

    bitrates: tuple[int, ...] = ()
    acceptance_code: int = 0x00000000
    acceptance_mask: int = 0xFFFFFFFF
    single_filter: bool = False
    timestamps: bool = False
    auto_poll: bool = True
    auto_start: Channel = Channel.CLOSED


# ---- frames as lines -----------------------------------------------------------------------------

_HEX: Final = re.compile(rb"[0-9A-Fa-f]+")
_REMOTE: Final = b"rR"
_EXTENDED: Final = b"TR"


def frame_line(frame: CanFrame) -> bytes:
    """``frame`` as adapters write it, without CR: ``t6018..``, ``R000001230``."""
    letter = "r" if frame.is_remote else "t"
    shown = f"{frame.identifier:03X}"
    if frame.is_extended:
        letter, shown = letter.upper(), f"{frame.identifier:08X}"
    return f"{letter}{shown}{frame.length}{frame.data.hex().upper()}".encode()


def parse_frame(line: bytes) -> CanFrame | None:
    """The frame that a line beginning with t, T, r or R names; None: it names none."""
    kind, body = line[:1], line[1:]
    digits = 8 if kind in _EXTENDED else 3
    if not _HEX.fullmatch(body) or len(body) <= digits:
        return None
    length = int(body[digits : digits + 1], 16)
    try:
        data = bytes.fromhex(body[digits + 1 :].decode())
        return CanFrame(int(body[:digits], 16), data, kind in _EXTENDED, kind in _REMOTE, length)
    except ValueError:
        return None


# ---- acceptance filter ---------------------------------------------------------------------------


class _View(NamedTuple):
    """How one filter sees a frame: the bits it compares with the code, and which these are."""

    bits: int
    compared: int


def _long_view(frame: CanFrame) -> _View:
    """The single filter: the whole identifier and, in a standard frame, two data bytes."""
    if frame.is_extended:
        return _View(frame.identifier << 3 | frame.is_remote << 2, 0xFFFFFFFC)
    bits = frame.identifier << 21 | frame.is_remote << 20
    bits |= int.from_bytes(frame.data[:2].ljust(2, b"\0"), "big")
    return _View(bits, (0xFFF00000, 0xFFF0FF00, 0xFFF0FFFF)[min(len(frame.data), 2)])


def _short_views(frame: CanFrame) -> tuple[_View, _View]:
    """The dual filter; the first looks at one data byte of a standard frame as well."""
    if frame.is_extended:
        base = frame.identifier >> 13
        return _View(base << 16, 0xFFFF0000), _View(base, 0x0000FFFF)
    base = frame.identifier << 5 | frame.is_remote << 4
    high, low = divmod(frame.data[0], 16) if frame.data else (0, 0)
    compared = 0xFFFF000F if frame.data else 0xFFF00000
    return _View(base << 16 | high << 16 | low, compared), _View(base, 0x0000FFF0)


def accepts(settings: Settings, frame: CanFrame) -> bool:
    """Whether the acceptance filter lets ``frame`` through (rule 2)."""
    relevant = ~settings.acceptance_mask & 0xFFFFFFFF
    if not relevant:
        return True
    views = (_long_view(frame),) if settings.single_filter else _short_views(frame)
    return any(not (v.bits ^ settings.acceptance_code) & relevant & v.compared for v in views)


# ---- the adapter ---------------------------------------------------------------------------------


class SlcanPort(CanDialect):
    """One adapter between a client and the bus.

    bitrate: of the bus, bit/s; None: frames take no time there, and every rate is right.
    settings: those of an earlier life; it powers up as they say.  serial_number: four characters.
    transmit_queue_frames: how many frames may wait for the bus, > 0.
    """

    def __init__(
        self,
        bitrate: int | None,
        *,
        settings: Settings | None = None,
        serial_number: str = "AT01",
        transmit_queue_frames: int = TRANSMIT_QUEUE_FRAMES,
    ) -> None:
        assert re.fullmatch("[0-9A-Za-z]{4}", serial_number), serial_number
        assert transmit_queue_frames > 0
        super().__init__()
        self.settings = settings or Settings()
        self.channel = self.settings.auto_start
        self.flags = StatusFlags(0)
        self._bitrate = bitrate
        self._serial_number = serial_number.encode()
        self._queue_max = transmit_queue_frames
        self._line = b""
        self._stuck = 0  # frames that a wrong bit rate keeps in the queue
        self._received: deque[bytes] = deque()

    @property
    def is_rate_right(self) -> bool:
        """Whether adapter and bus understand one another."""
        if self._bitrate is None or not self.settings.bitrates:
            return True
        allowed = self._bitrate * _RATE_TOLERANCE
        return any(abs(rate - self._bitrate) <= allowed for rate in self.settings.bitrates)

    @property
    def acknowledges(self) -> bool:
        """Not while it is closed, only listens, or understands nothing (rules 4 and 6)."""
        return self.channel is Channel.NORMAL and self.is_rate_right

    def receive(self, data: bytes, now_ns: Nanos) -> list[Out]:
        """Perform the complete lines in what came so far; nothing in it depends on the time."""
        *lines, rest = (self._line + data.replace(b"\n", b"")).split(b"\r")
        self._line = rest[: LINE_BYTES_MAX + 1]  # enough to know that it is too long
        return [out for line in lines if line for out in self._perform(line)]

    def deliver(self, frame: CanFrame, time_ns: Nanos) -> bytes:
        """The line of a frame on the bus, or nothing if it is kept or does not get through."""
        if self.channel is Channel.CLOSED:
            return b""
        if not self.is_rate_right:
            self.flags |= _DEAF
            return b""
        if not accepts(self.settings, frame):
            return b""
        line = frame_line(frame)
        if self.settings.timestamps:
            line += b"%04X" % (time_ns // NS_PER_MS % TIMESTAMP_PERIOD_MS)
        if self.settings.auto_poll:
            return line + OK
        if len(self._received) < RECEIVE_QUEUE_FRAMES:
            self._received.append(line)
        else:
            self.overrun()
        return b""

    def deliver_error(self, error: BusError, time_ns: Nanos) -> bytes:
        """Nothing by itself: an error is flagged until the client asks."""
        if self.channel is not Channel.CLOSED:
            for errors, flags in _FLAGS_OF.items():
                if error & errors:
                    self.flags |= flags
        return b""

    def overrun(self) -> None:
        """The client does not read: flagged, as frames are that nobody polls."""
        self.flags |= StatusFlags.RECEIVE_QUEUE_FULL | StatusFlags.DATA_OVERRUN

    # -- commands --

    def _perform(self, line: bytes) -> list[Out]:
        command = COMMANDS.get(line[:1])
        if (
            command is None
            or self.channel not in command.allowed
            or not command.argument.fullmatch(line, 1)
        ):
            return [BEL]
        return command.perform(self, line)

    def _set_rate(self, line: bytes) -> list[Out]:
        return self._set(bitrates=RATES[line[1:]])

    def _set_rate_registers(self, line: bytes) -> list[Out]:
        btr0, btr1 = bytes.fromhex(line[1:].decode())
        quanta = 3 + (btr1 & 0x0F) + (btr1 >> 4 & 0x07)
        return self._set(bitrates=(round(_QUANTA_PER_S / ((btr0 & 0x3F) + 1) / quanta),))

    def _set_flag(self, line: bytes) -> list[Out]:
        name = {b"X": "auto_poll", b"Z": "timestamps", b"W": "single_filter"}[line[:1]]
        return self._set(**{name: line[1:] == b"1"})

    def _set_code(self, line: bytes) -> list[Out]:
        return self._set(acceptance_code=int(line[1:], 16))

    def _set_mask(self, line: bytes) -> list[Out]:
        return self._set(acceptance_mask=int(line[1:], 16))

    def _set_auto_start(self, line: bytes) -> list[Out]:
        return self._set(auto_start=_AUTO_START[line[1:]])

    def _set(self, **changes: object) -> list[Out]:
        self.settings = replace(self.settings, **changes)  # type: ignore[arg-type]  # named by the callers
        return [OK]

    def _accept(self, line: bytes) -> list[Out]:
        """Nothing to do here."""
        return [OK]

    def _open(self, line: bytes) -> list[Out]:
        self.channel = Channel.LISTEN_ONLY if line == b"L" else Channel.NORMAL
        if not self.is_rate_right:
            set_to = " or ".join(str(rate) for rate in self.settings.bitrates)
            self._trouble = (
                f"the slcan client opened at {set_to} bit/s, the bus runs at {self._bitrate}: "
                f"nothing gets through until it opens with bitrate={self._bitrate}"
            )
        return [OK]

    def _close(self, line: bytes) -> list[Out]:
        self.channel = Channel.CLOSED
        self.flags = StatusFlags(0)
        self._stuck = 0
        self._received.clear()
        return [OK]

    def _send(self, line: bytes) -> list[Out]:
        frame = parse_frame(line)
        if frame is None:
            return [BEL]
        if self._on_the_way + self._stuck >= self._queue_max:
            self.flags |= StatusFlags.TRANSMIT_QUEUE_FULL
            return [BEL]
        done = OK
        if self.settings.auto_poll:
            done = (b"Z" if frame.is_extended else b"z") + OK
        if not self.is_rate_right:
            self._stuck += 1
            self.flags |= _DEAF
            return [done]
        self._on_the_way += 1
        return [frame, done]

    def _poll(self, line: bytes) -> list[Out]:
        if self.settings.auto_poll:
            return [BEL]
        return [(self._received.popleft() if self._received else b"") + OK]

    def _poll_all(self, line: bytes) -> list[Out]:
        if self.settings.auto_poll:
            return [BEL]
        lines = [*self._received, b"A"]
        self._received.clear()
        return [b"".join(line + OK for line in lines)]

    def _report_flags(self, line: bytes) -> list[Out]:
        flags, self.flags = self.flags, StatusFlags(0)
        return [b"F%02X\r" % flags]

    def _report_version(self, line: bytes) -> list[Out]:
        return [line + VERSION + OK]

    def _report_serial_number(self, line: bytes) -> list[Out]:
        return [line + self._serial_number + OK]


# ---- the commands --------------------------------------------------------------------------------

_ANY: Final = frozenset(Channel)
_CLOSED: Final = frozenset({Channel.CLOSED})
_OPEN: Final = _ANY - _CLOSED
_NORMAL: Final = frozenset({Channel.NORMAL})

_AUTO_START: Final = {b"0": Channel.CLOSED, b"1": Channel.NORMAL, b"2": Channel.LISTEN_ONLY}


@dataclass(frozen=True, slots=True)
class _Command:
    """In which states of the channel, with which argument, what happens."""

    allowed: frozenset[Channel]
    argument: re.Pattern[bytes]
    perform: Callable[[SlcanPort, bytes], list[Out]] = field(repr=False)


_NONE: Final = re.compile(rb"")
_BIT: Final = re.compile(rb"[01]")
_DIGIT: Final = re.compile(rb"[0-9]")
_FOUR: Final = re.compile(rb"[0-9A-Fa-f]{4}")
_EIGHT: Final = re.compile(rb"[0-9A-Fa-f]{8}")
_FRAME: Final = re.compile(rb".{4,%d}" % (LINE_BYTES_MAX - 1))

COMMANDS: Final[dict[bytes, _Command]] = {
    b"S": _Command(_CLOSED, _DIGIT, SlcanPort._set_rate),
    b"s": _Command(_CLOSED, _FOUR, SlcanPort._set_rate_registers),
    b"O": _Command(_CLOSED, _NONE, SlcanPort._open),
    b"L": _Command(_CLOSED, _NONE, SlcanPort._open),
    b"C": _Command(_OPEN, _NONE, SlcanPort._close),
    b"t": _Command(_NORMAL, _FRAME, SlcanPort._send),
    b"T": _Command(_NORMAL, _FRAME, SlcanPort._send),
    b"r": _Command(_NORMAL, _FRAME, SlcanPort._send),
    b"R": _Command(_NORMAL, _FRAME, SlcanPort._send),
    b"X": _Command(_CLOSED, _BIT, SlcanPort._set_flag),
    b"P": _Command(_OPEN, _NONE, SlcanPort._poll),
    b"A": _Command(_OPEN, _NONE, SlcanPort._poll_all),
    b"F": _Command(_OPEN, _NONE, SlcanPort._report_flags),
    b"Z": _Command(_CLOSED, _BIT, SlcanPort._set_flag),
    b"W": _Command(_CLOSED, _BIT, SlcanPort._set_flag),
    b"M": _Command(_CLOSED, _EIGHT, SlcanPort._set_code),
    b"m": _Command(_CLOSED, _EIGHT, SlcanPort._set_mask),
    b"U": _Command(_CLOSED, re.compile(rb"[0-6]"), SlcanPort._accept),
    b"Q": _Command(_OPEN, re.compile(rb"[0-2]"), SlcanPort._set_auto_start),
    b"V": _Command(_ANY, _NONE, SlcanPort._report_version),
    b"v": _Command(_ANY, _NONE, SlcanPort._report_version),
    b"N": _Command(_ANY, _NONE, SlcanPort._report_serial_number),
}
