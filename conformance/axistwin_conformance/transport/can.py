"""The way from the suite to a CAN bus, whatever carries the frames.

A `CanTransport` wraps a python-can bus: the built-in twin in virtual time, SocketCAN, an slcan
adapter or any other of its interfaces.

What is heard is kept in two places.  `receive` gives replies; what modules say unasked (boot-up,
lifebeat, emergency) never comes out there, whatever is asked for, but from `receive_spontaneous`
and `take_spontaneous`.  Each frame is given once, with the time at which it was in our hands.

A bus may have other inhabitants, with traffic of their own.  Identifiers on which others talk while
nobody has asked anything (`leave_out_others`) are theirs: such frames are counted and go nowhere.

A CAN controller does not hear itself.  Some interfaces give us our own frames all the same: those
they mark, and on the ones known not to mark them (`ECHOING`) each frame that equals one sent within
the last second, once.  Linux marks what any program of this machine has sent, us or not, and does
not give us our own: on its interfaces (`LOCALLY_MARKING`) the mark means nothing.
"""

from __future__ import annotations

import contextlib
import difflib
import errno
import logging
import os
import re
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple, Protocol

import can
import serial

from axistwin_conformance.base.errors import TargetError, TwinCrashed, UsageError
from axistwin_conformance.base.transcript import Transcript
from axistwin_conformance.transport.can_frame import Frame, unpack, unpack_all
from axistwin_conformance.transport.transport import (
    SILENCE_NOTED_S,
    STOP_HEARD_NS,
    Transport,
    crash_of,
)

TWIN_INTERFACE: Final = "axistwin"  # found by python-can by this name; the suite never imports it
ECHOING: Final = frozenset({"udp_multicast"})
LOCALLY_MARKING: Final = frozenset({"socketcan"})
# What an interface needs unless the user says otherwise: frames stay on this machine.
PRESETS: Final[Mapping[str, Mapping[str, object]]] = {"udp_multicast": {"hop_limit": 0}}
EXTENDED: Final = -1
ECHO_NS: Final = 1_000_000_000
SEND_TIMEOUT_S: Final = 3.0
FULL_QUEUE_PAUSE_S: Final = 0.001  # an adapter's queue of ten frames is empty after 2 ms at 500 k
FRAMES_KEPT: Final = 4096
REMEDIES: Final[Mapping[int, str]] = {
    errno.EAFNOSUPPORT: "this kernel has no CAN, see axistwin doctor",
    errno.ENODEV: "ip link lists the interfaces",
    errno.ENETDOWN: "ip link set NAME up",
    errno.ENOBUFS: "nobody acknowledges; is anybody connected, and at this bit rate?",
}
LONG_TRIP: Final = 4  # times the usual one: no exchange of two frames takes so long by itself
LATE_FRAMES: Final = 256  # looked at when the time is over; a bus may never fall silent
ERRORS_MARKED: Final = 20  # error frames that the transcript shows
FOREIGN_TOLD: Final = 8  # identifiers of others that are told by name
DRAINED_TOLD: Final = 4  # frames set aside that are told by name

# What drivers remark while they are looked for is not for the person at the terminal: what matters
# of it comes as an exception.
logging.getLogger("can").addHandler(logging.NullHandler())

Wanted = Callable[[Frame], bool]


class CanBus(Protocol):
    """What a target needs of a python-can bus."""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send the frame."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame, None when the time-out (s) passes first."""

    def shutdown(self) -> None:
        """Give the bus back."""


class Arrival(NamedTuple):
    """A frame and the time at which it was in our hands."""

    frame: Frame
    time_ns: int


def any_frame(frame: Frame) -> bool:
    """Accept whatever comes."""
    return True


def nothing(frame: Frame) -> bool:
    """Accept no frame: of a device that says nothing unasked."""
    return False


class CanTransport(Transport):
    """A device on a bus.

    `is_spontaneous`: what devices of the family say unasked.  `is_echoing`: the interface gives us
    our own frames without saying so.  `marks_own`: it marks what comes from us, and only that.
    `bitrate`: of the bus in bit/s, None if nobody has told it.
    """

    source_word = "the bus"
    word = "bus"

    def __init__(
        self,
        bus: CanBus,
        description: str,
        *,
        is_spontaneous: Wanted = nothing,
        is_echoing: bool = False,
        marks_own: bool = True,
        bitrate: int | None = None,
        is_builtin: bool = False,
        is_lossless: bool | None = None,
    ) -> None:
        super().__init__(
            bus,
            description,
            is_builtin=is_builtin,
            is_lossless=is_lossless,
            transcript=Transcript(is_in_pieces=False),
        )
        self._bus = bus
        self._is_spontaneous = is_spontaneous
        self._is_echoing = is_echoing
        self._marks_own = marks_own
        self._echoes: deque[tuple[int, Frame]] = deque(maxlen=FRAMES_KEPT)
        self._waiting: deque[Arrival] = deque(maxlen=FRAMES_KEPT)
        self._unasked: deque[Arrival] = deque(maxlen=FRAMES_KEPT)
        self.unjudged: deque[Arrival] = deque(maxlen=FRAMES_KEPT)  # of these, nobody has judged yet
        self._unanswered = 0  # requests since the last drain, less the replies
        self._last_reply: Frame | None = None
        self._bitrate = bitrate
        self.error_frames = self._foreign_frames = 0
        self._foreign: set[int] = set()  # identifiers, and `EXTENDED` for all of 29 bits

    def least_time_ns(self, frame: Frame) -> int:
        """How long a frame is on the bus at least; 0 where the bit rate is not known."""
        return 0 if self._bitrate is None else frame.least_bits * 1_000_000_000 // self._bitrate

    # --- sending ----------------------------------------------------------------------------------

    def send(self, frame: Frame) -> int:
        """Send a frame and return the time at which that began."""
        started_ns = self._announced(frame.pack())
        message = can.Message(
            arbitration_id=frame.identifier,
            data=frame.data,
            dlc=frame.length,
            is_extended_id=frame.is_extended,
            is_remote_frame=frame.is_remote,
        )
        with self._told("sending"):
            self._send_patiently(message)
        if self._is_echoing:
            self._echoes.append((started_ns, frame))
        self._unanswered += 1
        return started_ns

    def _send_patiently(self, message: can.Message) -> None:
        """Send; while the adapter's queue is full, wait for it to empty."""
        deadline_ns = time.monotonic_ns() + round(SEND_TIMEOUT_S * 1e9)
        while True:
            try:
                return self._bus.send(message, SEND_TIMEOUT_S)
            except (can.CanOperationError, OSError) as error:
                if _number_of(error) != errno.ENOBUFS or time.monotonic_ns() > deadline_ns:
                    raise
            time.sleep(FULL_QUEUE_PAUSE_S)

    def note_exchange(self, request: Frame, sent_ns: int, done_ns: int) -> None:
        """Remember an exchange that took longer than any did while the bus was measured; in virtual
        time, longer than any of them should."""
        trip = self.round_trip
        due_ns = LONG_TRIP * trip.median_ns if self.is_virtual else trip.max_ns
        if trip.samples:
            self.lateness.note(f"the reply to {request}", done_ns - sent_ns - due_ns)

    # --- receiving --------------------------------------------------------------------------------

    def receive(self, wanted: Wanted, timeout_s: float) -> Arrival | None:
        """Return the first frame that is wanted and was not said unasked, None if the time-out (s)
        passes first.  What else arrives is kept for later."""
        return self._await(self._waiting, wanted, timeout_s)

    def receive_spontaneous(self, wanted: Wanted, timeout_s: float) -> Arrival | None:
        """Return the first frame that is wanted of those said unasked."""
        return self._await(self._unasked, wanted, timeout_s)

    def take_spontaneous(self) -> tuple[Arrival, ...]:
        """Return what was said unasked and not taken yet, without waiting for more."""
        self._read_waiting()
        taken = tuple(self._unasked)
        self._unasked.clear()
        return taken

    def wait(self, seconds: float) -> float:
        """Let time pass, keep what arrives; return the seconds that really passed."""
        started_ns = now_ns = self.now_ns
        deadline_ns = started_ns + round(seconds * 1e9)
        while (left_ns := deadline_ns - now_ns) > 0:
            self._read(self._within_travel(left_ns))
            now_ns = self.now_ns
        return (now_ns - started_ns) / 1e9

    def drain(self) -> tuple[Arrival, ...]:
        """Throw away what nobody has asked for and return it; what was said unasked stays."""
        self._read_waiting()
        dropped = tuple(self._waiting)
        self._waiting.clear()
        self._unanswered = 0
        if dropped:
            told = ", ".join(str(one.frame) for one in dropped[:DRAINED_TOLD])
            more = ", ..." if len(dropped) > DRAINED_TOLD else ""
            self.mark(f"{len(dropped)} frames nobody asked for were set aside: {told}{more}")
        return dropped

    def leave_out_others(self, seconds: float, is_ours: Wanted) -> None:
        """Listen for so long; who talks meanwhile on identifiers that are not ours is left out."""
        self._read_waiting()
        deadline_ns = self.now_ns + round(seconds * 1e9)
        while (left_ns := deadline_ns - self.now_ns) > 0:
            self._read(left_ns)
        self._foreign = {_line_of(one.frame) for one in self._waiting if not is_ours(one.frame)}
        self._foreign |= {_line_of(one.frame) for one in self._unasked if not is_ours(one.frame)}
        if self._foreign:
            self.drain()
            self.mark(self.remarks[0])

    @property
    def remarks(self) -> tuple[str, ...]:
        """See `Transport.remarks`."""
        told = []
        if self._foreign:
            names = [f"{one:03X}h" if one >= 0 else "29-bit ones" for one in sorted(self._foreign)]
            more = ", ..." if len(names) > FOREIGN_TOLD else ""
            count = f"; {self._foreign_frames} so far" if self._foreign_frames else ""
            told.append(
                f"others talk on this bus; their frames are left out:"
                f" {', '.join(names[:FOREIGN_TOLD])}{more}{count}"
            )
        if self.error_frames:
            told.append(f"{self.error_frames} error frames on the bus: is the bit rate right?")
        return (*told, *super().remarks)

    def close(self) -> None:
        """Close the bus; one that is gone already is fine."""
        with contextlib.suppress(Exception):
            self._bus.shutdown()

    def _await(self, store: deque[Arrival], wanted: Wanted, timeout_s: float) -> Arrival | None:
        started_ns = self.now_ns
        deadline_ns = started_ns + round(timeout_s * 1e9)
        looked_at = late = 0
        while True:
            for at in range(looked_at, len(store)):
                if wanted(store[at].frame):
                    found = store[at]
                    del store[at]
                    return found
            # A full store drops its oldest frame for each new one: then all have to be looked at.
            looked_at = len(store) if len(store) < FRAMES_KEPT else 0
            until_ns = self._until_ns(deadline_ns)
            left_ns = until_ns - self.now_ns
            is_more = self._read(self._within_travel(max(left_ns, 0)))
            late += left_ns <= 0
            if left_ns <= 0 and (not is_more or late > LATE_FRAMES):
                if not self.is_holding:
                    break
                self._sort_in(unpack_all(self._given_up()), self.now_ns)
        if timeout_s >= SILENCE_NOTED_S:
            self._note_silence(started_ns)
        return None

    def _read_waiting(self) -> None:
        """Read what has arrived already."""
        for _ in range(FRAMES_KEPT):  # a bus that never falls silent is not listened to for ever
            if not self._read(0):
                break

    def _read(self, left_ns: int) -> bool:
        """Read one frame and put it where it belongs; False if none came in time."""
        self._refuse_the_dead()
        self._clock_ns = None
        try:
            message = self._bus.recv(left_ns / 1e9)
        except Exception as error:
            raise self._trouble("receiving", error) from error
        if message is None:
            return False
        if message.is_error_frame or message.is_fd:
            self.error_frames += message.is_error_frame
            form = "an error frame" if message.is_error_frame else "a CAN FD frame"
            if self.error_frames <= ERRORS_MARKED:
                self.mark(f"{form} on the bus: {message.arbitration_id:X}h {message.data.hex(' ')}")
            return True
        try:
            frame = _frame_of(message)
        except ValueError as error:  # an adapter's line was disturbed: no bus carries such a frame
            self.error_frames += 1
            if self.error_frames <= ERRORS_MARKED:
                self.mark(f"the adapter told of a frame that cannot be: {error}")
            return True
        is_marked = self._marks_own and not message.is_rx
        if is_marked or (self._is_echoing and self._is_echo(frame)):
            return True
        if self._foreign and _line_of(frame) in self._foreign:
            self._foreign_frames += 1
            return True
        handed, now_ns = self._arrived(frame.pack())
        self._sort_in((frame,) if self.mender is None else unpack_all(handed), now_ns)
        return True

    def _sort_in(self, frames: Sequence[Frame], now_ns: int) -> None:
        """Put frames where they belong."""
        for frame in frames:
            arrival = Arrival(frame, now_ns)
            if self._is_spontaneous(frame):
                self._unasked.append(arrival)
                self.unjudged.append(arrival)
                continue
            self._waiting.append(arrival)
            if self._unanswered <= 0 and frame == self._last_reply:
                self.lateness.note_doubled(str(frame))
            self._unanswered -= 1
            self._last_reply = frame

    def _is_echo(self, frame: Frame) -> bool:
        """True if we have sent that ourselves, and not had it back yet."""
        oldest_ns = self.now_ns - ECHO_NS
        while self._echoes and self._echoes[0][0] < oldest_ns:
            self._echoes.popleft()
        for at, (_, sent) in enumerate(self._echoes):
            if sent == frame:
                del self._echoes[at]
                return True
        return False

    # --- what the base asks for -------------------------------------------------------------------

    @property
    def rate(self) -> int | None:
        """The bit rate, if it was asked for here."""
        return self._bitrate

    def _stop_by(self, data: bytes) -> None:
        self.send(unpack(data))
        self._read(STOP_HEARD_NS)

    def _has_heard(self, seconds: float) -> bool:
        return self.receive(any_frame, seconds) is not None

    def _source_trouble(self, doing: str, error: Exception) -> TargetError | None:
        if isinstance(error, can.CanTimeoutError):
            return TargetError(f"the bus does not take frames any more ({doing})")
        if isinstance(error, OSError | can.CanError):
            return TargetError(f"the bus failed while {doing}: {_one_line(error)}")
        return None


def _line_of(frame: Frame) -> int:
    """What a frame has in common with others of its sender."""
    return EXTENDED if frame.is_extended else frame.identifier


def _frame_of(message: can.Message) -> Frame:
    if message.is_remote_frame:
        return Frame(message.arbitration_id, b"", message.is_extended_id, True, min(message.dlc, 8))
    return Frame(message.arbitration_id, bytes(message.data), message.is_extended_id)


def split_words(words: str) -> tuple[str, str, dict[str, str]]:
    """Take INTERFACE:CHANNEL?option=value&... apart; raises UsageError for anything else.

    The channel of the built-in twin keeps its options: they are the twin's.
    """
    interface, _, channel = words.partition(":")
    if not interface or not channel:
        raise UsageError(
            f"--can {words!r} is no INTERFACE:CHANNEL; write for instance socketcan:vcan0"
        )
    if interface == TWIN_INTERFACE or "?" not in channel:
        return interface, channel, {}
    channel, _, rest = channel.partition("?")
    pairs = [one.partition("=") for one in rest.split("&")]
    for name, equals, value in pairs:
        if not (name and equals and value):
            raise UsageError(f"--can {words!r}: write options as ?name=value&name=value")
    return interface, channel, {name: value for name, _, value in pairs}


def check_interface(words: str, bitrate: int | None = None) -> None:
    """Raise UsageError for INTERFACE:CHANNEL that names no interface of python-can, or another bit
    rate than that one."""
    interface, _, _ = split_words(words)
    _bitrate_of(words, bitrate)
    if interface in can.VALID_INTERFACES:
        return
    near = difflib.get_close_matches(interface, can.VALID_INTERFACES, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    known = ", ".join(sorted(can.VALID_INTERFACES))
    raise UsageError(f"--can {words}: python-can has no interface {interface!r}; {hint}{known}")


def open_can_target(
    words: str,
    *,
    bitrate: int | None = None,
    is_spontaneous: Wanted = nothing,
    is_builtin: bool = False,
) -> CanTransport:
    """Open INTERFACE:CHANNEL of python-can.

    `bitrate`: in bit/s, for interfaces that set it; None: as the interface is configured.  Raises
    UsageError for words without an interface or a channel, TargetError with the reason in a line.
    """
    interface, channel, options = split_words(words)
    asked: dict[str, object] = {**PRESETS.get(interface, {})}
    asked |= {name: _value(text) for name, text in options.items()}
    is_said = _bitrate_in(words) is not None
    bitrate = _bitrate_of(words, bitrate)
    if bitrate is not None and not (interface == TWIN_INTERFACE and is_said):
        asked["bitrate"] = bitrate
    try:
        bus = can.Bus(channel, interface, ignore_config=True, **asked)  # type: ignore[arg-type]
        _keep_others_off(bus, words)
    except (can.CanError, OSError, ValueError, ImportError) as error:
        raise TargetError(f"cannot open {words}: {_one_line(error)}") from error
    except Exception as error:
        if interface != TWIN_INTERFACE:  # a driver that falls over what it was given
            raise TargetError(f"cannot open {words}: {_one_line(error)}") from error
        raise TwinCrashed(f"cannot open {words}: {crash_of(error)}") from error
    return CanTransport(
        bus,
        words,
        is_spontaneous=is_spontaneous,
        is_echoing=interface in ECHOING,
        marks_own=interface not in LOCALLY_MARKING,
        bitrate=bitrate,
        is_builtin=is_builtin,
    )


def _keep_others_off(bus: can.BusABC, words: str) -> None:
    """Lock the port of an adapter on a line; raises TargetError if another program has it: both
    would read halves of frames."""
    port = getattr(bus, "serialPortOrig", None)
    if not isinstance(port, serial.Serial):
        return
    try:
        port.exclusive = True
    except (OSError, ValueError) as error:
        can.BusABC.shutdown(bus)  # and no word to the adapter, which would leave the bus
        port.close()
        raise TargetError(f"cannot open {words}: it is in use by another program") from error


def _value(text: str) -> object:
    """An option of an interface as its driver expects it: a number, a truth value or a word."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _bitrate_of(words: str, bitrate: int | None) -> int | None:
    """The bit rate that was given, in either place; raises UsageError for two that differ."""
    said = _bitrate_in(words)
    if bitrate is not None and said not in (None, bitrate):
        raise UsageError(f"--bitrate {bitrate}: {words} says {said}; give one of them")
    return bitrate or said


def _bitrate_in(words: str) -> int | None:
    """The bit rate among the options of an interface."""
    found = re.search(r"[?&]bitrate=(\d+)(?=&|$)", words)
    return int(found[1]) if found else None


def _number_of(error: BaseException) -> int | None:
    """The system's number of an error, which python-can keeps under a name of its own."""
    number = getattr(error, "error_code", None)
    return number if number is not None else getattr(error, "errno", None)


def _one_line(error: BaseException) -> str:
    """The reason in a line, in the system's words where it is the system's."""
    number, text = _number_of(error), " ".join(str(error).split())
    if number is None and (found := re.search(r"\[Errno (\d+)\]", text)):
        number = int(found[1])
    if number is not None and number in errno.errorcode:
        remedy = f": {REMEDIES[number]}" if number in REMEDIES else ""
        return f"{os.strerror(number)}{remedy}"
    known = isinstance(error, can.CanError | OSError | ValueError | ImportError) and text
    return text if known else f"{type(error).__name__}: {text}".rstrip(": ")
