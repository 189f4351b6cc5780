"""Targets: the way from the suite to a device on a byte line.

A `SerialTransport` wraps a pyserial port: the built-in twin by URL (virtual time), a pty, `socket://`,
`rfc2217://` or a real port.  Clock, transcript, travel guard and what becomes of trouble are those
of every `Transport`.
"""

from __future__ import annotations

import contextlib
import difflib
import errno
import importlib
import os
import pkgutil
import re
import termios
import time
import urllib.parse
from collections.abc import Sequence
from typing import Protocol

import serial

from axistwin_conformance.base.errors import TargetError, TwinCrashed, UsageError
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.transport.transport import (
    SILENCE_NOTED_S,
    STOP_HEARD_NS,
    Transport,
    crash_of,
)

TWIN_SCHEME = "axistwin://"
TWIN_HANDLER = "axistwin.urlhandler"  # found by pyserial by this name; the suite never imports it
SLICE_S = (
    0.02  # a real port is read in slices of one length: on RFC 2217 each new length costs 0.1 s
)
SLICE_NS = round(SLICE_S * 1e9)
WRITE_TIMEOUT_S = 3.0
BYTE_BITS = 10  # 8N1
DRAIN_BYTES = 65_536
DRAINED_AT_ONCE = 4096
NETWORK_OPTIONS = {  # of pyserial's URLs of this kind
    "socket": ("logging",),
    "rfc2217": ("ign_set_control", "logging", "poll_modem", "timeout"),
}
ALIASES = {"tcp": "socket", "telnet": "rfc2217"}  # what others call them
NO_SERIAL_PORT = (errno.ENOTTY, errno.EINVAL)


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


class SerialTransport(Transport):
    """A device behind a port."""

    source_word = "the port"

    def __init__(
        self,
        port: SerialPort,
        description: str,
        *,
        is_builtin: bool = False,
        is_lossless: bool | None = None,
    ) -> None:
        super().__init__(port, description, is_builtin=is_builtin, is_lossless=is_lossless)
        self._port = port
        self._pending = bytearray()
        self.byte_ns = BYTE_BITS * 1_000_000_000 // port.baudrate  # what a byte takes on the line
        # A port may offer request and reply in one call: when it began, the reply, when it was
        # there.
        self._at_once = getattr(port, "exchange", None)
        if not self.is_virtual:
            port.timeout = SLICE_S

    @property
    def is_direct(self) -> bool:
        """True if `exchange` may be used: virtual time, no noise, nobody has to hold the axis or
        to mend what comes."""
        is_plain = self.travel_guard is None and self.mender is None
        return self.is_virtual and self.is_lossless and is_plain

    @property
    def is_pty(self) -> bool:
        """True if no hardware is behind it, which may not care for a rate."""
        return os.path.realpath(self.description).startswith("/dev/pts/")

    @property
    def rate(self) -> int:
        """The rate of our end of the line."""
        return self.baud

    @property
    def baud(self) -> int:
        """The rate of our end of the line."""
        return self._port.baudrate

    @baud.setter
    def baud(self, rate: int) -> None:
        self._clock_ns = None
        with self._told(f"setting {rate} baud"):
            self._port.baudrate = rate
        self.byte_ns = BYTE_BITS * 1_000_000_000 // rate
        self.mark(f"our end of the line now talks {rate} baud")

    @property
    def upcoming(self) -> bytes:
        """What `receive` will return next, where the port can tell before it has come; so what has
        no length need not be read byte by byte."""
        if not self.is_direct:
            return bytes(self._pending)
        return bytes(self._pending) + getattr(self._port, "upcoming", b"")

    def send(self, data: bytes) -> int:
        """Send the bytes and return the time at which that began."""
        started_ns = self._announced(bytes(data))
        with self._told("sending"):
            for piece in self._in_parts(bytes(data)):
                self._port.write(piece)
        if not self.is_virtual:
            late_ns = self.now_ns - started_ns - len(data) * self.byte_ns
            self.lateness.note("sending", late_ns, is_device_free=True)
        return started_ns

    def _in_parts(self, data: bytes) -> Sequence[bytes]:
        """The same in parts that the line carries well within the time-out of the port."""
        most = max(1, round(WRITE_TIMEOUT_S / 3 * 1e9) // max(1, self.byte_ns))
        return [data[at : at + most] for at in range(0, len(data), most)] or (data,)

    def note_exchange(
        self,
        data: bytes,
        received: int,
        sent_ns: int,
        *,
        done_ns: int | None = None,
        later_ns: int = 0,
    ) -> None:
        """Remember an exchange that took longer than any did while the line was measured.

        `done_ns`: when the reply was there, None: now; `later_ns`: how much later than others this
        one is due, by what is asked.
        """
        if self.is_virtual or not received or not self.round_trip.samples:
            return
        due_ns = self.round_trip.way_ns + (len(data) + received) * self.byte_ns + later_ns
        taken_ns = (self.now_ns if done_ns is None else done_ns) - sent_ns
        self.lateness.note(f"the reply to {data.hex(' ')}", taken_ns - due_ns)

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
            until_ns = self._until_ns(deadline_ns)
            left_ns = until_ns - self.now_ns
            # What is handed on may be longer or shorter than what comes.
            wanted = 1 if self.mender is not None else count - len(self._pending)
            arrived = self._read(wanted, self._within_travel(max(left_ns, 0)))
            # A look at a line in virtual time lets some pass: there the first one is enough.
            if not arrived and (left_ns if not self.is_virtual else until_ns - self.now_ns) <= 0:
                if not self.is_holding:
                    break
                self._pending += self._given_up()
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
            left_ns = self._within_travel(left_ns)
            if self.is_virtual or left_ns > SLICE_S * 1e9:
                self._read(1, left_ns)
            else:
                time.sleep(left_ns / 1e9)
            now_ns = self.now_ns
            if self.is_virtual:
                self._clock_ns = now_ns  # until something lets time pass again
        if not self.is_virtual:
            self._read(max(self._waiting(), 1), 0) if self._waiting() else None
            now_ns = self.now_ns
            self.lateness.note("a pause", now_ns - deadline_ns, is_device_free=True)
        return (now_ns - started_ns) / 1e9

    def drain(self) -> bytes:
        """Throw away what has arrived and return it, for the record."""
        if waiting := self._waiting():
            self._read(min(waiting, DRAIN_BYTES), 0)
        dropped = bytes(self._pending) + self._given_up()
        self._pending.clear()
        if dropped:
            self.mark(f"{len(dropped)} bytes nobody asked for were set aside")
        return dropped

    def close(self) -> None:
        """Close the port; a port that is gone already is fine."""
        with contextlib.suppress(Exception):
            self._port.close()

    def _read(self, count: int, left_ns: int) -> bool:
        self._refuse_the_dead()
        self._clock_ns = None
        begun_ns = 0 if self.is_virtual else self.now_ns
        try:
            if self.is_virtual:
                self._port.timeout = left_ns / 1e9
            data = bytes(self._port.read(count))
        except Exception as error:
            raise self._trouble("receiving", error) from error
        if not self.is_virtual:
            late_ns = self.now_ns - begun_ns - SLICE_NS
            self.lateness.note("listening", late_ns, is_device_free=True)
        if data:
            self._pending += self._arrived(data)[0]
        return bool(data)

    def _waiting(self) -> int:
        self._clock_ns = None
        with self._told("receiving"):
            return self._port.in_waiting

    def _own_ns(self, said: Sequence[Record]) -> int:
        return sum(len(record.data) for record in said) * self.byte_ns

    # --- what the base asks for -------------------------------------------------------------------

    def _stop_by(self, data: bytes) -> None:
        self.send(data)
        self._read(DRAIN_BYTES, STOP_HEARD_NS)

    def _has_heard(self, seconds: float) -> bool:
        return bool(self.receive(DRAINED_AT_ONCE, seconds))

    def _source_trouble(self, doing: str, error: Exception) -> TargetError | None:
        if isinstance(error, serial.SerialTimeoutException):
            return TargetError(f"the port does not take bytes any more ({doing})")
        if isinstance(error, OSError | termios.error):  # SerialException is an OSError
            return TargetError(f"the port failed while {doing}: {_one_line(error)}")
        return None


def check_url(url: str) -> None:
    """Raise UsageError for a URL that pyserial could not open anywhere."""
    if "://" not in url or url.startswith(TWIN_SCHEME):
        return
    try:
        parts = urllib.parse.urlsplit(url)
    except ValueError as error:
        raise UsageError(f"--port {url}: {error}") from error
    scheme = parts.scheme
    known = sorted({*_handlers(), TWIN_SCHEME.removesuffix("://")})
    if scheme not in known:
        near = difflib.get_close_matches(ALIASES.get(scheme, scheme), known, n=1)
        hint = f"did you mean {near[0]}://? " if near else ""
        raise UsageError(f"--port {url}: pyserial has no {scheme}://; {hint}{', '.join(known)}")
    if scheme in NETWORK_OPTIONS:
        _check_network(url, parts)


def _check_network(url: str, parts: urllib.parse.SplitResult) -> None:
    example = f"--port {parts.scheme}://192.168.0.5:4001"
    try:
        is_whole = bool(parts.port)
    except ValueError:  # no number, or more than 65535
        is_whole = False
    if not is_whole:
        raise UsageError(f"--port {url}: write HOST:PORT, PORT in 1 to 65535, as {example}")
    options = NETWORK_OPTIONS[parts.scheme]
    for name in urllib.parse.parse_qs(parts.query, keep_blank_values=True):
        if name not in options:
            raise UsageError(f"--port {url}: it has no option {name}; known: {', '.join(options)}")


def _handlers() -> set[str]:
    """The protocols that pyserial has here."""
    found = set()
    for package in serial.protocol_handler_packages:
        places = importlib.import_module(package).__path__ if package != TWIN_HANDLER else []
        found |= {module.name for module in pkgutil.iter_modules(places)}
    prefix = "protocol_"
    return {name.removeprefix(prefix) for name in found if name.startswith(prefix)}


def open_target(url: str, baud: int, *, is_builtin: bool = False) -> SerialTransport:
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
    return SerialTransport(port, url, is_builtin=is_builtin)


def _one_line(error: BaseException) -> str:
    """The reason without pyserial's wrapping, which names port and number twice."""
    number = getattr(error, "errno", None)
    if number in (errno.EAGAIN, errno.EBUSY):
        return "it is in use by another program"
    if number is not None:
        return os.strerror(number)
    text = " ".join(str(error).split())
    if any(f"({number}, " in text for number in NO_SERIAL_PORT):  # a file, /dev/null
        return "it is no serial port"
    if found := re.search(r"\[Errno (-?\d+)\] (.+)$", text):
        return found[2]
    if "returned no data" in text:  # pyserial's words for the end of a pty or an adapter
        return "the far end has hung up, or another program reads here too"
    return text or type(error).__name__
