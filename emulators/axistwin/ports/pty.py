"""A pseudo terminal: to the client a serial port, opened by its path.

What a pty shows and hides
--------------------------
- The kernel keeps the settings of the client's side (the *slave*); we read them at the master.  The
  rate (odd ones too) and the stop bits show.  Parity and data bits do not (the driver forces 8N),
  nor do break and the modem lines; a client that needs those uses RFC 2217.
- A pty has no rate of its own: the line behind it keeps the time.

Clients come and go
-------------------
- The slave is not kept open here.  When the last client closes it, the master first gives the rest
  of the data and then EIO, again and again; so reading stops, and what that client has left unread
  is dropped, as a closed serial port drops it.
- The loop tells of the next open (``opens``).  It may tell two opens as one, so nothing is
  counted: whether somebody is there is always the answer of the master itself.
- The settings outlive the clients, as those of a real port do; only "raw" is put back.

Two flags that mean nothing
---------------------------
glibc's ``tcsetattr`` fails with EINVAL when all that a client changes is parity or data bits, since
neither sticks to a pty: the second program that opens a port with 8E1 would get an error.  So two
local flags that mean nothing on a raw terminal, ECHONL and ECHOK, are kept set: every client
clears them, thus changes something, and succeeds.  They are set again as soon as bytes show that
they are gone, since a client that closes and opens again is faster than any notice of it.
"""

import contextlib
import fcntl
import os
import pty
import select
import struct
import termios
import time
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, TypeVar

from axistwin.errors import PortError
from axistwin.ports.link import Link
from axistwin.ports.stream import REST_S, Owner, SerialStream, Stream
from axistwin.runtime.serving.line_server import Server
from axistwin.wire.framing import LineFormat

# Linux's asm-generic/termbits.h; the termios module knows neither these nor odd rates.
_TCGETS2, _TCSETS2, _TCSETSF2 = 0x802C542A, 0x402C542B, 0x402C542D
_CBAUD, _BOTHER, _CIBAUD_SHIFT = 0o010017, 0o010000, 16
# struct termios2: input, output, control and local flags, line and characters, two rates.
_SETTINGS = struct.Struct("=IIII20sII")
_NO_SETTINGS = bytes(_SETTINGS.size)
_COOKED = termios.ICANON | termios.ECHO | termios.ISIG
_ARMED = termios.ECHONL | termios.ECHOK


ServerT = TypeVar("ServerT", bound=Owner)


class PseudoTerminal(ABC, Generic[ServerT]):
    """A pty behind the symbolic link ``link``, whose rate begins as ``baud``.

    option: that of the command line which chose the link, for the remedy in messages.
    """

    kind = "pty"
    option = "--pty"

    def __init__(self, link: str, baud: int) -> None:
        self.url = link
        self.device = ""
        self._link = Link(link, self.option)
        self._first_baud = baud
        self._master = -1
        self._watch: int | None = None
        self._stream: Stream | None = None
        self._server: ServerT | None = None

    @abstractmethod
    def make_stream(self, server: ServerT, master: int, on_end: Callable[[], None]) -> Stream:
        """The stream of whoever has opened the pty."""

    def describe(self) -> str:
        """The link and, in brackets, what it points to."""
        return f"{self.url} ({self.device})"

    def open(self) -> None:
        """Make the pty, raw from the first moment, and its link.  Raises PortError."""
        self._link.claim()
        try:
            self._master, slave = pty.openpty()
        except OSError as error:
            raise PortError(
                f"pty {self.url}: no pseudo terminal to be had ({error.strerror}); "
                "see 'axistwin doctor'"
            ) from None
        self.device = os.ttyname(slave)
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        set_rate(self._master, self._first_baud)
        os.close(slave)
        self._link.point(self.device)

    def attach(self, server: ServerT) -> None:
        """Wait for clients.  Raises PortError."""
        self._server = server
        try:
            self._watch = server.loop.add_open_watch(self.device, self._opened)
        except OSError as error:
            raise PortError(
                f"pty {self.device}: clients cannot be noticed, inotify fails ({error.strerror}); "
                "end other programs or raise fs.inotify.max_user_instances"
            ) from None
        self._opened()  # somebody may have been faster than we

    def close(self) -> None:
        """Remove the link and the pty; a client that has it open sees a hang-up."""
        if self._server is not None:
            if self._stream is not None:
                self._end_stream()
            if self._watch is not None:
                self._server.loop.remove_open_watch(self._watch)
        self._server = self._watch = None
        self._link.remove()
        if self._master >= 0:
            os.close(self._master)
        self._master = -1

    def _opened(self) -> None:
        """Somebody opens the pty, or did and has gone again, leaving bytes or not."""
        assert self._server is not None
        if self._stream is not None:
            return
        if _wants_reading(self._master):
            self._stream = self.make_stream(self._server, self._master, self._left)
            self._stream.place = self._place
            self._tell("connected")
            self._stream.start()
        else:
            tidy(self._master)

    def _left(self) -> None:
        """The last client has closed the pty."""
        self._end_stream()
        tidy(self._master)
        _drop_unread(self.device)

    def _end_stream(self) -> None:
        stream, self._stream = self._stream, None
        assert stream is not None
        stream.stop()
        self._tell("disconnected", **stream.take_losses())

    def _tell(self, event: str, **details: object) -> None:
        assert self._server is not None
        self._server.report({"event": event, **self._place, **details})

    @property
    def _place(self) -> dict[str, object]:
        return {"endpoint": self.kind, "url": self.url}


class PtyPort(PseudoTerminal[Server]):
    """A serial line on a pty, whose settings begin as ``line_format``."""

    def __init__(self, link: str, line_format: LineFormat) -> None:
        super().__init__(link, line_format.baud)
        self._format = line_format

    def make_stream(self, server: Server, master: int, on_end: Callable[[], None]) -> Stream:
        """A stream at the rate that the pty was last set to."""
        return _PtyStream(server, master, self._format, on_end)


class _PtyStream(SerialStream):
    """Whoever has the pty open."""

    def __init__(
        self, server: Server, master: int, line_format: LineFormat, on_end: Callable[[], None]
    ) -> None:
        super().__init__(server, master, on_end, PtyFarewell(master).is_over)
        self._settings = PtySettings(master, line_format)

    def line_format(self) -> LineFormat:
        """What the client has set by now."""
        return self._settings.line_format()


class PtySettings:
    """What clients set on a pty, at first ``line_format``."""

    def __init__(self, master: int, line_format: LineFormat) -> None:
        self._master = master
        self._present = bytearray(_SETTINGS.size)
        self._settings = b""
        self._format = line_format

    def line_format(self) -> LineFormat:
        """What the client has set by now; B0 (hang up) leaves the rate as it was."""
        # Into a bytearray: bytes would do, at twice the time.
        fcntl.ioctl(self._master, _TCGETS2, self._present)
        if self._present != self._settings:
            self._settings = settings = bytes(self._present)
            _, _, control, local, _, _, baud = _SETTINGS.unpack(settings)
            stop_half_bits = 4 if control & termios.CSTOPB else 2
            self._format = LineFormat(baud or self._format.baud, stop_half_bits=stop_half_bits)
            if local & _ARMED != _ARMED and not local & _COOKED:
                _set_local_flags(self._master, settings)
        return self._format


def tidy(master: int) -> None:
    """Put back what the next client relies on, and touch nothing that is right already.

    The next client may be setting the line just now.
    """
    settings = fcntl.ioctl(master, _TCGETS2, _NO_SETTINGS)
    local = _SETTINGS.unpack(settings)[3]
    if local & _COOKED:
        tty.setraw(master, termios.TCSANOW)
        settings = fcntl.ioctl(master, _TCGETS2, _NO_SETTINGS)
    if local & _ARMED != _ARMED:
        _set_local_flags(master, settings)


def set_rate(fd: int, baud: int) -> None:
    """Set the rate of a terminal, any number of bits per second."""
    fields = list(_SETTINGS.unpack(fcntl.ioctl(fd, _TCGETS2, _NO_SETTINGS)))
    # No input rate of its own in the control flags: it follows the output rate.
    fields[2] = fields[2] & ~(_CBAUD | _CBAUD << _CIBAUD_SHIFT) | _BOTHER
    fields[5] = fields[6] = baud
    fcntl.ioctl(fd, _TCSETS2, _SETTINGS.pack(*fields))


def _set_local_flags(fd: int, settings: bytes) -> None:
    """Set the two flags that mean nothing; see above."""
    fields = list(_SETTINGS.unpack(settings))
    fields[3] |= _ARMED
    fcntl.ioctl(fd, _TCSETS2, _SETTINGS.pack(*fields))


def _wants_reading(master: int) -> bool:
    """Whether a client has the pty open, or has left bytes in it."""
    events = _events(master)
    return bool(events & select.POLLIN) or not events & select.POLLHUP


class PtyFarewell:
    """Finds out that a client of a pty, who is not read, has closed it."""

    def __init__(self, master: int) -> None:
        self._master = master
        self._closed_s: float | None = None

    def is_over(self) -> bool:
        """Whether it has closed, and had its time for what it had sent before; the rest is lost."""
        if not _events(self._master) & select.POLLHUP:
            self._closed_s = None
            return False
        if self._closed_s is None:
            self._closed_s = time.monotonic()
        if time.monotonic() - self._closed_s < REST_S:
            return False
        termios.tcflush(self._master, termios.TCIFLUSH)  # or it would seem to be the next one's
        return True


def _events(master: int) -> int:
    poll = select.poll()
    poll.register(master, select.POLLIN)
    ((_, events),) = poll.poll(0) or ((master, 0),)
    return events


def _drop_unread(device: str) -> None:
    """Drop what no client has read, but not what the next one may have written already.

    Only the client's side can do that.  Our own open makes a notice that nobody is there.
    """
    with contextlib.suppress(OSError):
        slave = os.open(device, os.O_RDWR | os.O_NOCTTY)
        try:
            termios.tcflush(slave, termios.TCIFLUSH)
            # A program that died holding the port exclusively must not shut out the next one.
            fcntl.ioctl(slave, termios.TIOCNXCL)
        finally:
            os.close(slave)
