"""Targets: the one way from the suite to a device, whatever carries the bytes.

A `Target` wraps a pyserial port: the built-in twin by URL (virtual time), a pty, `socket://`,
`rfc2217://` or a real port.  It keeps the transcript and the clock.

Time.  On the built-in twin it is the port's own, exact, and passes only while we wait; elsewhere it
is the machine's monotonic clock.  What a check measures on it is known to `uncertainty_ns`: an
instant that the device fixes while it handles an exchange lies somewhere between our first byte and
its last, so the slowest exchange seen on the idle line bounds it.

Trouble.  A port that is closed, vanished or does not take bytes raises `TargetError`, nothing else.
A twin in this process may also fall over a mistake of its own: whatever comes out of its port and
is no trouble of a port is `TwinCrashed`, and from then on no byte goes to that port or comes back.
"""

from __future__ import annotations

import contextlib
import errno
import os
import statistics
import termios
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import serial

from axistwin_conformance.errors import OutsideEnvelope, TargetError, TwinCrashed
from axistwin_conformance.transcript import Direction, Transcript

TWIN_SCHEME = "axistwin://"
TWIN_HANDLER = "axistwin.urlhandler"  # found by pyserial by this name; the suite never imports it
SLICE_S = (
    0.02  # a real port is read in slices of one length: on RFC 2217 each new length costs 0.1 s
)
WRITE_TIMEOUT_S = 3.0
BYTE_BITS = 10  # 8N1
SILENCE_NOTED_S = 0.05  # shorter waits without a byte are not worth a line in the transcript
DRAIN_BYTES = 65_536
DRAINED_AT_ONCE = 4096
MOST_HUSHES = 20  # a device that never stops talking is not waited for
STOP_HEARD_NS = 50_000_000  # the reply to a stop takes 3 ms at 9600 baud


class SerialPort(Protocol):
    """What a target needs of a pyserial port."""

    timeout: float | None
    baudrate: int

    def read(self, size: int = 1, /) -> bytes:
        """Return up to `size` bytes, fewer when the time-out passes first."""

    def write(self, data: bytes, /) -> int | None:
        """Send the bytes."""

    def close(self) -> None:
        """Give the port back."""

    @property
    def in_waiting(self) -> int:
        """How many bytes `read` would return at once."""


class Fence(Protocol):
    """What keeps the axes on a line inside the envelope; it hears everything, either way."""

    def sending(self, data: bytes, now_ns: int, /) -> None:
        """Raise OutsideEnvelope if these bytes must not be sent."""

    def received(self, data: bytes, now_ns: int, /) -> None:
        """Learn from what the device says."""

    @property
    def deadline_ns(self) -> int | None:
        """When endless motion has to be stopped at the latest; None while there is none."""

    def stop(self) -> tuple[bytes, ...]:
        """The frames that end it."""

    def needed(self, wait_ns: int, /) -> int:
        """How large the envelope would have to be for endless motion to go on for so long."""

    def worked(self, name: str, window: tuple[int, int], /) -> None:
        """Learn what the rig has done, and between which instants."""


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """How long exchanges take on the idle line, in ns."""

    samples: int = 0
    median_ns: int = 0
    max_ns: int = 0


class Target:
    """A device behind a port.  Not thread-safe: one run, one target."""

    def __init__(
        self,
        port: SerialPort,
        description: str,
        *,
        is_builtin: bool = False,
        is_lossless: bool | None = None,
    ) -> None:
        self._port = port
        self._pending = bytearray()
        self._clock_ns: int | None = None  # in virtual time, as long as nothing has let it pass
        self.byte_ns = BYTE_BITS * 1_000_000_000 // port.baudrate  # what a byte takes on the line
        # A port may offer request and reply in one call: when it began, the reply, when it was
        # there.
        self._at_once = getattr(port, "exchange", None)
        self.description = description
        self.is_builtin = is_builtin
        self.is_virtual = getattr(port, "virtual_time_ns", None) is not None
        # In virtual time there is no noise, unless somebody puts it there.
        self.is_lossless = self.is_virtual if is_lossless is None else is_lossless
        self.transcript = Transcript()
        self.round_trip = RoundTrip()
        self.last_sent = b""
        self.gate: Callable[[bytes], None] | None = None  # sees every byte before it is sent
        self.fence: Fence | None = None
        self.meter: Callable[[bytes], None] | None = None  # counts what is really sent
        self.crash = ""  # of the twin behind the port, once it has fallen over
        if not self.is_virtual:
            port.timeout = SLICE_S

    @property
    def now_ns(self) -> int:
        """The target's clock, ns from an arbitrary origin."""
        if not self.is_virtual:
            return time.monotonic_ns()
        if self._clock_ns is not None:
            return self._clock_ns
        try:
            return self._port.virtual_time_ns  # type: ignore[attr-defined,no-any-return]
        except Exception as error:
            raise self._trouble("asking the time", error) from error

    @property
    def is_direct(self) -> bool:
        """True if `exchange` may be used: virtual time, no noise, nobody has to hold the axis."""
        return self.is_virtual and self.is_lossless and self.fence is None

    @property
    def uncertainty_ns(self) -> int:
        """How well the instant of something inside one exchange is known (see above)."""
        return self.round_trip.max_ns

    @property
    def twins(self) -> Sequence[Any]:
        """The handles of the twins behind the port; none behind a real one."""
        return cast(Sequence[Any], getattr(self._port, "twins", ()))

    @property
    def baud(self) -> int:
        """The rate of our end of the line."""
        return self._port.baudrate

    @baud.setter
    def baud(self, rate: int) -> None:
        self._clock_ns = None
        with self._port_trouble(f"setting {rate} baud"):
            self._port.baudrate = rate
        self.byte_ns = BYTE_BITS * 1_000_000_000 // rate
        self.mark(f"our end of the line now talks {rate} baud")

    def send(self, data: bytes) -> int:
        """Send the bytes and return the time at which that began."""
        if self.gate is not None:
            self.gate(data)
        started_ns = self.now_ns
        if self.fence is not None:
            self.fence.sending(data, started_ns)
        if self.meter is not None:
            self.meter(data)
        self.last_sent = bytes(data)
        self._clock_ns = None
        self.transcript.note(started_ns, Direction.HOST, bytes(data))
        with self._port_trouble("sending"):
            self._port.write(bytes(data))
        return started_ns

    def exchange(
        self, data: bytes, size: int, timeout_s: float, is_cleared: bool = False
    ) -> tuple[int, bytes, int]:
        """What `send` and `receive` do, at a fraction of their cost (see `is_direct`): send the
        bytes, return when that began, up to `size` bytes of reply, and when they were there.

        `is_cleared`: the gate has let such a frame pass, and it holds nothing for the meter.
        """
        if not is_cleared:
            if self.gate is not None:
                self.gate(data)
            if self.meter is not None:
                self.meter(data)
        if self._pending:
            self.drain()
        self._refuse_the_dead()
        started_ns, note = self.now_ns, self.transcript.note
        self.last_sent = data
        note(started_ns, Direction.HOST, data)
        self._clock_ns = None
        try:
            if self._at_once is not None:
                _, reply, done_ns = self._at_once(data, size, timeout_s)
            else:
                reply, done_ns = self._in_turn(data, size, timeout_s)
        except Exception as error:
            raise self._trouble("exchanging", error) from error
        self._clock_ns = done_ns
        if reply:
            note(done_ns, Direction.DEVICE, reply)
        elif timeout_s >= SILENCE_NOTED_S:
            self._note_silence(started_ns)
        return started_ns, reply, done_ns

    def _in_turn(self, data: bytes, size: int, timeout_s: float) -> tuple[bytes, int]:
        port = self._port
        port.write(data)
        if port.timeout != timeout_s:
            port.timeout = timeout_s
        return port.read(size), port.virtual_time_ns  # type: ignore[attr-defined]

    def receive(self, count: int, timeout_s: float) -> bytes:
        """Return up to `count` bytes, fewer if the time-out (s, for all of them) passes first."""
        started_ns = self.now_ns
        deadline_ns = started_ns + round(timeout_s * 1e9)
        while len(self._pending) < count:
            left_ns = deadline_ns - self.now_ns
            arrived = self._read(count - len(self._pending), self._fenced(max(left_ns, 0)))
            # A look at a line in virtual time lets some pass: there the first one is enough.
            if not arrived and (left_ns if not self.is_virtual else deadline_ns - self.now_ns) <= 0:
                break
        taken = bytes(self._pending[:count])
        del self._pending[:count]
        if not taken and timeout_s >= SILENCE_NOTED_S:
            self._note_silence(started_ns)
        return taken

    def wait(self, seconds: float) -> float:
        """Let time pass, keep what arrives for `receive`; return the seconds that really passed."""
        started_ns = now_ns = self.now_ns
        deadline_ns = started_ns + round(seconds * 1e9)
        while (left_ns := deadline_ns - now_ns) > 0:
            left_ns = self._fenced(left_ns)
            if self.is_virtual or left_ns > SLICE_S * 1e9:
                self._read(1, left_ns)
            else:
                time.sleep(left_ns / 1e9)
            now_ns = self.now_ns
        if not self.is_virtual:
            self._read(max(self._waiting(), 1), 0) if self._waiting() else None
            now_ns = self.now_ns
        return (now_ns - started_ns) / 1e9

    def drain(self) -> bytes:
        """Throw away what has arrived and return it, for the record."""
        if waiting := self._waiting():
            self._read(min(waiting, DRAIN_BYTES), 0)
        dropped = bytes(self._pending)
        self._pending.clear()
        if dropped:
            self.mark(f"{len(dropped)} bytes nobody asked for were set aside")
        return dropped

    def hush(self, seconds: float) -> None:
        """Set aside what comes until nothing has come for so long: a late reply must not be taken
        for the next one."""
        for _ in range(MOST_HUSHES):
            if not self.receive(DRAINED_AT_ONCE, seconds):
                break

    def mark(self, text: str) -> None:
        """Write a line into the transcript."""
        self.transcript.note(self.now_ns, Direction.NOTE, text=text)

    def measure_round_trip(self, exchange: Callable[[], bool], samples: int) -> RoundTrip:
        """Time `exchange` on the idle line; only the ones that succeed count."""
        taken: list[int] = []
        for _ in range(samples):
            started_ns = self.now_ns
            if exchange():
                taken.append(self.now_ns - started_ns)
        if taken:
            self.round_trip = RoundTrip(len(taken), round(statistics.median(taken)), max(taken))
        return self.round_trip

    def close(self) -> None:
        """Close the port; a port that is gone already is fine."""
        with contextlib.suppress(Exception):
            self._port.close()

    def _fenced(self, left_ns: int) -> int:
        """How long may be waited; stops endless motion that nobody has stopped in time."""
        deadline_ns = None if self.fence is None else self.fence.deadline_ns
        if self.fence is None or deadline_ns is None:
            return left_ns
        spare_ns = deadline_ns - self.now_ns
        if spare_ns > 0:
            return min(left_ns, spare_ns)
        self.mark("endless motion has come near the edge of the envelope: stopped")
        needed = self.fence.needed(left_ns)
        gate, self.gate = self.gate, None  # a stop is not held back
        try:
            for frame in self.fence.stop():
                self.send(frame)
                self._read(DRAIN_BYTES, STOP_HEARD_NS)
        finally:
            self.gate = gate
        if gate is None:  # between checks there is no one to tell; until heard it is sent again
            return min(left_ns, STOP_HEARD_NS)
        raise OutsideEnvelope(
            "endless motion had come near the edge of the envelope", "--max-travel", needed
        )

    def _read(self, count: int, left_ns: int) -> bool:
        self._refuse_the_dead()
        self._clock_ns = None
        try:
            if self.is_virtual:
                self._port.timeout = left_ns / 1e9
            data = bytes(self._port.read(count))
        except Exception as error:
            raise self._trouble("receiving", error) from error
        if data:
            self._pending += data
            now_ns = self.now_ns
            self.transcript.note(now_ns, Direction.DEVICE, data)
            if self.fence is not None:
                self.fence.received(data, now_ns)
        return bool(data)

    def _waiting(self) -> int:
        self._clock_ns = None
        with self._port_trouble("receiving"):
            return self._port.in_waiting

    def _note_silence(self, started_ns: int) -> None:
        passed_ms = (self.now_ns - started_ns) / 1e6
        text = f"nothing for {passed_ms:.0f} ms"
        self.transcript.note(started_ns, Direction.SILENCE, text=text)

    def _refuse_the_dead(self) -> None:
        """Raise TwinCrashed if the twin has crashed: nobody knows what is left of it."""
        if self.crash:
            raise TwinCrashed(self.crash)

    @contextlib.contextmanager
    def _port_trouble(self, doing: str) -> Iterator[None]:
        """Turn whatever a port raises into a TargetError."""
        self._refuse_the_dead()
        try:
            yield
        except Exception as error:
            raise self._trouble(doing, error) from error

    def _trouble(self, doing: str, error: Exception) -> TargetError:
        """What a port has raised, as a TargetError that says what was being done."""
        if isinstance(error, serial.SerialTimeoutException):
            return TargetError(f"the port does not take bytes any more ({doing})")
        if isinstance(error, OSError | termios.error):  # SerialException is an OSError
            return TargetError(f"the port failed while {doing}: {_one_line(error)}")
        if self.is_virtual or hasattr(self._port, "twins"):
            self.crash = self.crash or crash_of(error)
            return TwinCrashed(self.crash)
        # pyserial's own ports fall over a file descriptor that somebody else has closed.
        return TargetError(f"the port was closed while {doing}: {_one_line(error)}")


def crash_of(error: Exception) -> str:
    """What a twin fell over, in a line: the exception and the place where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    text = " ".join(str(error).split())
    return f"the built-in twin crashed: {type(error).__name__}: {text}{place}"


def open_target(url: str, baud: int, *, is_builtin: bool = False) -> Target:
    """Open a pyserial URL or device name, 8N1; raises TargetError with the reason in one line."""
    if url.startswith(TWIN_SCHEME) and TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    scheme = url.partition("://")[0] if "://" in url else ""
    options: dict[str, object] = {"timeout": SLICE_S}
    if scheme != "rfc2217":  # pyserial has no write time-out there
        options["write_timeout"] = WRITE_TIMEOUT_S
    if not scheme:
        options["exclusive"] = True  # a second program on the port would spoil every verdict
    try:
        port = serial.serial_for_url(url, baudrate=baud, **options)  # type: ignore[arg-type]
    except (OSError, ValueError, termios.error) as error:
        raise TargetError(f"cannot open {url}: {_one_line(error)}") from error
    except Exception as error:
        if not url.startswith(TWIN_SCHEME):
            raise
        raise TwinCrashed(f"cannot open {url}: {crash_of(error)}") from error
    return Target(port, url, is_builtin=is_builtin)


def _one_line(error: BaseException) -> str:
    """The reason without pyserial's wrapping, which names port and number twice."""
    number = getattr(error, "errno", None)
    if number in (errno.EAGAIN, errno.EBUSY):
        return "it is in use by another program"
    if number is not None:
        return os.strerror(number)
    if "returned no data" in str(error):  # pyserial's words for the end of a pty or an adapter
        return "the far end has hung up, or another program reads here too"
    return " ".join(str(error).split()) or type(error).__name__
