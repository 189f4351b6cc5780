"""Joining a CAN bus that is there already, through any of python-can's interfaces.

    external bus -- can.Bus --- fileno or thread --> Bus.send    (heard by the devices)
                       ^------- [frames] <---------- Bus.receive (what the devices send)

Rules
-----
1. Arbitration, bit times and acknowledgement are the external bus' own: the ``Bus`` of the twins
   has none (frames take no time there).  A device's frame is offered when the device says.
2. Frames go out in their order.  While the interface takes none they wait, ``QUEUE_FRAMES`` at
   most; what comes then is lost, told once, and counted.
3. Nothing that was sent here is heard here: interfaces that give a sender its own frames back
   (udp_multicast) have them taken out again, the oldest equal one for each.
4. A bus that goes away ends the server with a PortError.  Nothing is polled meanwhile.
5. Error frames and CAN FD are not for the devices.
"""

import contextlib
import errno
import logging
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final
from urllib.parse import parse_qsl

import can
import serial

from axistwin.errors import PortError, UsageError, nearest
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.ports import socketcan
from axistwin.ports.can_message import frame_of, message_of
from axistwin.runtime.serving.bus_server import BusServer
from axistwin.wire.can_frame import CanFrame

QUEUE_FRAMES: Final = 1024
"""Frames that wait for an interface which takes none."""

RECEIVE_BUFFER_BYTES: Final = 1 << 20
"""Asked of the kernel: vcan loses what a reader is late for."""

_SO_RCVBUFFORCE: Final = 33  # Linux's asm-generic/socket.h

_ECHOING: Final = ("udp_multicast",)
_ECHO_S: Final = 1.0  # an echo that has not come by then was lost

_IMMEDIATE: Final = ("socketcan", "udp_multicast", "virtual")
"""Interfaces whose ``send`` never has to wait; serial ones would cut a frame in two."""

_SEND_TIMEOUT_S: Final = 0.1

_OWN_ARGUMENTS: Final[Mapping[str, Mapping[str, Any]]] = {"udp_multicast": {"hop_limit": 0}}
"""Given unless the user says otherwise.  hop_limit: nothing leaves this machine."""

_BUSY: Final = (errno.ENOBUFS, errno.EAGAIN, errno.ENOMEM, errno.EINTR)
_RETRY_NS: Final = (1 * NS_PER_MS, 50 * NS_PER_MS)

_SILENT_AT_END: Final = ("socketcand",)
"""Interfaces that give nothing, again and again and at once, when their connection has ended."""

_AT_ONCE: Final = 256  # frames read before others have their turn
_EMPTY_MAX: Final = 64  # times a descriptor may be readable with nothing in it, in a row
_REST_S: Final = 0.01
_THREAD_TIMEOUT_S: Final = 0.2


class JoinPort:
    """The bus at ``place``: ``INTERFACE:CHANNEL[?NAME=VALUE[&...]]``, names of the interface's own.

    bitrate: bits per second, for interfaces that set one.
    Raises UsageError for what cannot be read, or is no interface.
    """

    kind = "can"

    def __init__(self, place: str, bitrate: int) -> None:
        self.interface, colon, rest = place.partition(":")
        self.channel, _, query = rest.partition("?")
        if not colon or not self.interface or not self.channel:
            raise UsageError(
                f"can {place!r}: INTERFACE:CHANNEL is needed, such as socketcan:vcan0 or "
                "udp_multicast:239.74.163.2"
            )
        if self.interface not in can.VALID_INTERFACES:
            raise UsageError(
                f"can {place}: python-can has no interface {self.interface!r}: "
                f"{nearest(self.interface, can.VALID_INTERFACES)}"
            )
        self.url = place
        self.bitrate = bitrate
        self._arguments = {
            "bitrate": bitrate,
            **_OWN_ARGUMENTS.get(self.interface, {}),
            **{name: _value(text) for name, text in parse_qsl(query, keep_blank_values=True)},
        }
        self._can: can.BusABC | None = None
        self._member: _Joined | None = None

    @property
    def client_line(self) -> str:
        """For python-can, where it can open the same bus."""
        if self.interface not in ("socketcan", "udp_multicast"):
            return ""
        own = {name: value for name, value in self._arguments.items() if name != "bitrate"}
        more = "".join(f", {name}={value!r}" for name, value in own.items())
        return f'can.Bus(interface="{self.interface}", channel="{self.channel}"{more})'

    @property
    def station(self) -> int:
        """Its number on the bus of the server; -1 before it is attached."""
        return self._member.station if self._member is not None else -1

    def describe(self) -> str:
        """The place."""
        return self.url

    def open(self) -> None:
        """Join.  Raises PortError."""
        # python-can says on stderr what its exceptions say too.
        logging.getLogger("can").addHandler(logging.NullHandler())
        if self.interface == "socketcan" and socketcan.link_state(self.channel) != "up":
            state = {"absent": "there is no such interface", "down": "the interface is down"}
            raise self._failed(
                state[socketcan.link_state(self.channel)], socketcan.remedy(self.channel)
            )
        try:
            self._can = can.Bus(
                interface=self.interface,
                channel=self.channel,
                ignore_config=True,
                **self._arguments,
            )
        except TypeError as error:  # an argument that it needs, or does not know
            remedy = f"its arguments go behind the channel: {self.interface}:CHANNEL?NAME=VALUE&..."
            raise self._failed(_reason(error), remedy) from None
        except Exception as error:  # whatever an interface of anybody's may raise
            raise self._failed(_reason(error), "see 'axistwin doctor'") from None
        _enlarge_buffer(self._can)

    def attach(self, server: BusServer) -> None:
        """Pass on frames, in the server's loop."""
        assert self._can is not None
        timeout_s = 0.0 if self.interface in _IMMEDIATE else _SEND_TIMEOUT_S
        self._member = _Joined(
            server, self, self._can, timeout_s, echoes=self.interface in _ECHOING
        )
        self._member.start()

    def close(self) -> None:
        """Leave."""
        if self._member is not None:
            self._member.stop()
            self._member = None
        if self._can is not None:
            with contextlib.suppress(Exception):  # it may be gone already
                self._can.shutdown()
            self._can = None

    def lost(self, error: Exception) -> PortError:
        """What ends the server when the bus has gone."""
        return PortError(
            f"can {self.url}: the bus is gone ({_reason(error)}); bring it back, and start again"
        )

    def _failed(self, reason: str, remedy: str) -> PortError:
        return PortError(f"can {self.url}: cannot be joined ({reason}); {remedy}")


class _Joined:
    """The member of the twins' bus that stands for all on the external one."""

    is_behind = False  # the twins' bus takes everything at once

    def __init__(
        self,
        server: BusServer,
        port: JoinPort,
        outside: can.BusABC,
        timeout_s: float,
        *,
        echoes: bool,
    ) -> None:
        assert not server.bus.is_paced, "two arbitrations for one frame"
        self._server = server
        self._bus = server.bus
        self._port = port
        self._outside = outside
        self._timeout_s = timeout_s
        self._echoes: deque[tuple[CanFrame, float]] | None = (
            deque(maxlen=QUEUE_FRAMES) if echoes else None
        )
        self.station = -1
        self._waiting: deque[CanFrame] = deque()
        self._retry_ns: Nanos | None = None
        self._pause_ns = _RETRY_NS[0]
        self._dropped = 0
        self._fd = -1
        self._empty = 0
        self._stopping = False
        self._thread: threading.Thread | None = None

    # -- life --

    def start(self) -> None:
        """Take part in the twins' bus, and listen to the external one."""
        self.station = self._bus.attach()
        self._server.add_member(self)
        try:
            self._fd = self._outside.fileno()
        except Exception:  # NotImplementedError, and what interfaces make of it
            self._fd = -1
        if self._fd >= 0:
            self._server.loop.add_reader(self._fd, self._readable)
            return
        self._thread = threading.Thread(target=self._listen, name="axistwin-can", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Take part no more."""
        self._stopping = True
        if self._fd >= 0:
            self._server.loop.remove_reader(self._fd)
        if self._thread is not None:
            self._thread.join(10 * _THREAD_TIMEOUT_S)
        self._server.remove_member(self)
        with contextlib.suppress(Exception):
            self._bus.detach(self.station)
        if self._dropped:
            place = {"endpoint": self._port.kind, "url": self._port.url}
            self._server.report(
                {"event": "disconnected", **place, "dropped_messages": self._dropped}
            )

    # -- from outside --

    def _readable(self) -> None:
        """Read what has come, and give way when that does not end."""
        count = 0
        for _ in range(_AT_ONCE):
            frame, is_all = self._read(0)
            if is_all:
                break
            if frame is not None:
                count += 1
                self._hear(frame)
        if count:
            self._empty = 0
            self._server.heard()
            return
        self._empty += 1
        if self._empty >= _EMPTY_MAX:  # readable, with nothing that means anything: do not spin
            self._server.loop.remove_reader(self._fd)
            self._server.loop.call_later(_REST_S, self._listen_again)

    def _listen_again(self) -> None:
        if not self._stopping:
            self._server.loop.add_reader(self._fd, self._readable)

    def _read(self, timeout_s: float) -> tuple[CanFrame | None, bool]:
        """The next frame, or None for what is no frame for us; whether that was all."""
        try:
            message = self._receive(timeout_s)
        except Exception as error:  # whatever an interface may raise
            if _errno(error) is not None:
                raise self._port.lost(error) from None
            return None, True  # something that could not be understood
        return (None, True) if message is None else (_frame(message), False)

    def _receive(self, timeout_s: float) -> can.Message | None:
        """``recv`` that does not ask an interface again and again which gives nothing at once."""
        if type(self._outside).recv is can.BusABC.recv:
            return self._outside._recv_internal(timeout_s)[0]
        return self._outside.recv(timeout_s)

    def _listen(self) -> None:
        """The thread that reads an interface without a descriptor."""
        empty = 0
        while not self._stopping:
            began_s = time.monotonic()
            try:
                frame, _ = self._read(_THREAD_TIMEOUT_S)
                if empty > _EMPTY_MAX and self._port.interface in _SILENT_AT_END:
                    raise self._port.lost(EOFError("the connection has ended"))
            except PortError as error:
                self._server.loop.call_soon(self._fail, error)
                return
            if frame is not None:
                empty = 0
                self._server.loop.call_soon(self._hear_one, frame)
            elif time.monotonic() - began_s < _REST_S:
                empty += 1
                time.sleep(_REST_S)  # it does not wait as it should
            else:
                empty = 0

    def _hear_one(self, frame: CanFrame) -> None:
        if not self._stopping:
            self._hear(frame)
            self._server.heard()

    def _fail(self, error: PortError) -> None:
        raise error

    def _hear(self, frame: CanFrame) -> None:
        """A frame of another station, or (rule 3) an echo of our own."""
        if self._echoes is not None and self._is_echo(frame, self._echoes):
            return
        self._bus.send(self.station, frame)
        self._bus.sync()  # it has been on its bus, and competes with nothing here

    @staticmethod
    def _is_echo(frame: CanFrame, echoes: deque[tuple[CanFrame, float]]) -> bool:
        oldest_s = time.monotonic() - _ECHO_S
        while echoes and echoes[0][1] < oldest_s:
            echoes.popleft()
        for index, (sent, _) in enumerate(echoes):
            if sent == frame:
                del echoes[index]
                return True
        return False

    # -- to the outside --

    @property
    def has_news(self) -> bool:
        """Whether the twins' bus has something to be sent."""
        return self._bus.has_news(self.station)

    def next_event_ns(self) -> Nanos | None:
        """When to try again what the interface did not take."""
        return self._retry_ns

    def pump(self) -> None:
        """Send what is to be sent."""
        for arrival in self._bus.receive(self.station):
            if len(self._waiting) < QUEUE_FRAMES:
                self._waiting.append(arrival.frame)
                continue
            if not self._dropped:
                self._server.report(
                    {"event": "overrun", "endpoint": self._port.kind, "url": self._port.url}
                )
            self._dropped += 1
        now = self._bus.clock.now_ns()
        if self._waiting and (self._retry_ns is None or now >= self._retry_ns):
            self._send(now)

    def _send(self, now: Nanos) -> None:
        """Send what the interface takes, and set the time for the rest."""
        self._retry_ns = None
        while self._waiting:
            frame = self._waiting[0]
            if self._echoes is not None:
                self._echoes.append((frame, time.monotonic()))
            if not self._offer(frame):
                self._retry_ns = now + self._pause_ns
                self._pause_ns = min(2 * self._pause_ns, _RETRY_NS[1])
                return
            self._waiting.popleft()
            self._pause_ns = _RETRY_NS[0]

    def _offer(self, frame: CanFrame) -> bool:
        """Whether the interface has taken ``frame``.  Raises PortError if the bus is gone."""
        try:
            self._outside.send(message_of(frame), self._timeout_s)
        except Exception as error:  # whatever an interface may raise
            number = _errno(error)
            if number is not None and number not in _BUSY:
                raise self._port.lost(error) from None
            if self._echoes is not None:
                self._echoes.pop()
            return False
        return True

    # -- what is never called: it is never behind --

    def pause(self) -> None:
        """See ``is_behind``."""

    resume = look = pause


def _value(text: str) -> object:
    """An argument of an interface, as a number or a truth value where it looks like one."""
    words: dict[str, object] = {"true": True, "false": False}
    if text.lower() in words:
        return words[text.lower()]
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def _enlarge_buffer(bus: can.BusABC) -> None:
    """Where the interface is a socket, have the kernel keep more for a reader that is late."""
    setsockopt: Callable[..., None] | None = getattr(
        getattr(bus, "socket", None), "setsockopt", None
    )
    if setsockopt is not None:
        for option in (socket.SO_RCVBUF, _SO_RCVBUFFORCE):  # the latter without limit, for root
            with contextlib.suppress(OSError):
                setsockopt(socket.SOL_SOCKET, option, RECEIVE_BUFFER_BYTES)


def _frame(message: can.Message) -> CanFrame | None:
    """None: nothing for the devices (rule 5).

    ``is_rx`` tells nothing: of SocketCAN's it means sent from another machine.
    """
    if message.is_error_frame or message.is_fd:
        return None
    try:
        return frame_of(message)
    except ValueError:
        return None


def _errno(error: BaseException | None) -> int | None:
    """The system's error behind ``error``, 0 for one without a number; None: it was not that."""
    while error is not None:
        if isinstance(error, TimeoutError | serial.SerialTimeoutException):
            return errno.EAGAIN
        if isinstance(error, OSError):
            return error.errno or 0
        error = error.__cause__
    return None


def _reason(error: BaseException) -> str:
    """What went wrong, in one line: the system's own words where there are some."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.strerror:
            return cause.strerror
        cause = cause.__cause__
    return " ".join(str(error).split()) or type(error).__name__
