"""A pyserial port whose far end is a line of twins in this process: ``axistwin://mac23?time=virtual``.

What a client sees is what ``serial.Serial`` shows on a real port; ``url.py`` explains the URL.

Time
----
- Virtual: time passes only while the client waits.  ``read`` moves it to the arrival of the bytes
  asked for or to the time-out, ``flush`` and ``send_break`` to their end, ``write`` only when the
  output buffer is full.  A look at ``in_waiting`` takes one byte time, and so do a ``read`` with
  ``timeout=0`` that finds nothing and ``out_waiting`` while there is something to send: loops end.
- Real and scaled: the same calls sleep.  Time-outs are the client's own seconds, as on a pty.
- ``host_clock=yes``: while the port is open, so do ``time.sleep`` and its like (``runtime.host``).
- Nothing runs in the background; the line catches up whenever somebody looks at it.

The port
--------
- The rate and framing are those of this end.  pyserial's default is 9600 baud and a module's is
  38400: unless a client sets its rate it understands nothing, and is not understood.
- A closed port leaves the twins powered; opening the same object again finds them as they are.
- The modem inputs are those of an RS-485 adapter that is plugged in (CTS, DSR and CD on, RI off);
  RTS and DTR go nowhere.  XON/XOFF works as in a terminal driver: the bytes are swallowed.
"""

import functools
import weakref
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

from serial.serialutil import (  # type: ignore[attr-defined]  # the stubs lack to_bytes
    LF,
    XOFF,
    XON,
    PortNotOpenError,
    SerialBase,
    SerialException,
    SerialTimeoutException,
    to_bytes,
)

from axistwin.errors import AxistwinError
from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.runtime.any_twin import AnyTwin
from axistwin.runtime.clock import check_advance
from axistwin.runtime.line import Line
from axistwin.urlhandler.lines import OpenLine, open_line
from axistwin.urlhandler.url import parse_url
from axistwin.wire.framing import LineFormat

OUTPUT_MAX = 4096
"""Bytes that the output buffer holds, as Linux' serial driver does; more, and ``write`` waits."""

INPUT_STEP = 4096
"""Bytes taken from the line at once, so that a large ``read`` never lets its buffer overflow."""

PATIENCE_NS: Nanos = 24 * 3600 * NS_PER_S
"""In virtual time, a read without a time-out is given up when nothing came for so long."""

_Method = TypeVar("_Method", bound=Callable[..., Any])


def _clear_errors(method: _Method) -> _Method:
    """Let a user's mistake, or a memory that cannot be written, come out as pyserial's error."""

    @functools.wraps(method)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        try:
            return method(*args, **kwargs)
        except AxistwinError as error:
            raise SerialException(str(error)) from None

    return cast(_Method, wrapper)


class Serial(SerialBase):
    """The host's end of a line of twins."""

    is_open = False  # for close, should the constructor fail

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._shared: OpenLine | None = None
        self._shared_url: str | None = None
        self._input = bytearray()
        self._held: bytearray | None = None
        self._break_since_ns: Nanos | None = None
        self._cancelled_read = False
        self._cancelled_write = False
        self._configured: tuple[object, ...] = ()
        self._is_plain = False  # whether ``read`` does nothing but wait for bytes
        super().__init__(*args, **kwargs)

    # -- beyond pyserial ----------------------------------------------------------------------

    @property
    def line(self) -> Line:
        """The line with its twins, also while the port is closed; it must have been open once."""
        if self._shared is None:
            raise PortNotOpenError
        return self._shared.line

    @property
    def twins(self) -> Sequence[AnyTwin]:
        """The twins on the line, in the order of the URL."""
        return self.line.twins

    @property
    def virtual_time_ns(self) -> int:
        """The line's present time in nanoseconds, in any kind of time."""
        if self._shared is None:
            raise PortNotOpenError
        try:
            return self._shared.line.sync()
        except AxistwinError as error:
            raise SerialException(str(error)) from None

    @_clear_errors
    def advance(self, seconds: float) -> None:
        """Let ``seconds`` (>= 0) pass; virtual time only, for real time passes by itself."""
        if not self.line.is_virtual:
            raise SerialException("advance: only virtual time can be moved; add time=virtual")
        check_advance(seconds)
        self.line.note(f"advance({seconds:g})")
        self.line.advance(round(seconds * NS_PER_S))

    def exchange(self, data: bytes, size: int, timeout_s: float) -> tuple[int, bytes, int]:
        """``write(data)``, then ``read(size)`` with the time-out ``timeout_s`` (>= 0), in one call.

        Without ``data`` it is a ``read`` with a time-out of its own.
        Returns when the sending of ``data`` began, what was read, and the present time; both times
        in nanoseconds of the line.  For test suites in virtual time; works in any.
        Raises SerialException.
        """
        try:
            outcome = self._ask(data, size, timeout_s)
            if outcome is not None:
                return outcome
            line = self._opened()
            began_ns = line.host_sent_ns
            self.write(data)
            answer = self._read_within(size, timeout_s)
            return began_ns, answer, line.sync()
        except AxistwinError as error:
            raise SerialException(str(error)) from None

    def _ask(self, data: bytes, size: int, timeout_s: float) -> tuple[int, bytes, int] | None:
        """``exchange`` the short way; None: there is none, and nothing was done."""
        shared = self._shared
        if (
            not self.is_open
            or not self._is_plain
            or self._held is not None
            or self._input
            or self._cancelled_read
            or not 0 < size <= INPUT_STEP
            or timeout_s <= 0
            or len(data) > OUTPUT_MAX
        ):
            return None
        assert shared is not None, "an open port has a line"
        outcome = shared.line.ask(data, size, shared.options.span_ns(timeout_s))
        if outcome is None:
            return None
        began_ns, heard, reached_ns = outcome
        if heard is not None:
            return began_ns, heard, reached_ns
        heard = self._read_on(bytearray(), size, timeout_s, reached_ns)
        return began_ns, heard, shared.line.sync()

    @property
    def upcoming(self) -> bytes:
        """What ``read`` will give next, as far as that is certain already; no time passes.

        For test suites in virtual time: what has no length can be read in one piece.
        """
        return bytes(self._input) + self.line.upcoming if self._is_plain else b""

    # -- life ---------------------------------------------------------------------------------

    @_clear_errors
    def open(self) -> None:
        """Plug in.  Raises SerialException."""
        if self.port is None:
            raise SerialException("Port must be configured before it can be used.")
        if self.is_open:
            raise SerialException("Port is already open.")
        if self._shared is None or self._shared_url != self.port:
            self._shared = open_line(parse_url(self.port))
            self._shared_url = self.port
        self._cancelled_read = self._cancelled_write = False
        self._held = self._break_since_ns = None
        self._configured = ()
        self._reconfigure_port()
        self.is_open = True
        self._shared.use_host_time()
        self.reset_input_buffer()

    def close(self) -> None:
        """Unplug; the twins stay powered."""
        if self.is_open:
            self.is_open = False
            self._input.clear()
            self._let_go_of_exclusive()
            self.line.wake()
            assert self._shared is not None, "it was open"
            self._shared.release_host_time()

    def _reconfigure_port(self) -> None:
        """Make the line's end what the settings say.  Raises ValueError and SerialException.

        pyserial calls this for time-outs too, which are none of the line's business.
        """
        wanted = (
            self.baudrate,
            self.bytesize,
            self.parity,
            self.stopbits,
            self.xonxoff,
            self.exclusive,
        )
        self._is_plain = not self.xonxoff and self.inter_byte_timeout is None
        if wanted == self._configured:
            return
        self._configured = ()  # until all of it is done
        assert self._shared is not None
        if self.baudrate == 0:
            raise ValueError(f"Not a valid baudrate: {self.baudrate!r}")
        if self.exclusive:
            owner = self._shared.exclusive_owner and self._shared.exclusive_owner()
            if owner not in (None, self):
                raise SerialException(f"Could not exclusively lock port {self.port}: it is in use")
            self._shared.exclusive_owner = weakref.ref(self)
        else:
            self._let_go_of_exclusive()
        self._shared.line.host_format = LineFormat(
            self.baudrate, self.bytesize, self.parity, round(2 * self.stopbits)
        )
        if not self.xonxoff:
            self._resume_output()
        self._configured = wanted

    def _let_go_of_exclusive(self) -> None:
        shared = self._shared
        if shared and shared.exclusive_owner and shared.exclusive_owner() is self:
            shared.exclusive_owner = None

    def _opened(self) -> Line:
        """The line.  Raises PortNotOpenError."""
        if not self.is_open:
            raise PortNotOpenError
        return self.line

    # -- input --------------------------------------------------------------------------------

    @property
    @_clear_errors
    def in_waiting(self) -> int:
        """How many bytes can be read at once."""
        self._opened()
        self._pass_poll()  # also when there are some: a loop may wait for more
        return self._available()

    @_clear_errors
    def read(self, size: int = 1, /) -> bytes:
        """Read ``size`` bytes, or those that come within ``timeout`` seconds (None: wait).

        Fewer also when ``inter_byte_timeout`` passes without a byte behind the first one, or
        another thread calls ``cancel_read``.  Raises SerialException in virtual time when it would
        wait for ever.
        """
        self._opened()
        return self._read_within(size, self.timeout)

    def _read_within(self, size: int, timeout_s: float | None) -> bytes:
        """``read`` with a time-out of its own."""
        if size <= 0:
            return b""
        if timeout_s and (outcome := self._ask(b"", size, timeout_s)) is not None:
            return outcome[1]
        if timeout_s == 0 and not self._available():
            self._pass_poll()
        data = self._take(size)
        if len(data) >= size or self._read_ended():
            return data
        return self._read_on(bytearray(data), size, timeout_s, self.line.sync())

    def _read_on(self, data: bytearray, size: int, timeout_s: float | None, now: Nanos) -> bytes:
        """``read`` that was called ``now``, when not all has come yet, but ``data``."""
        deadline_ns = None if timeout_s is None else now + self._span_ns(timeout_s)
        limit_ns = deadline_ns
        give_up_ns = now + PATIENCE_NS
        fresh = bytes(data)
        while True:
            if fresh and self.inter_byte_timeout is not None:
                limit_ns = _earlier(deadline_ns, now + self._span_ns(self.inter_byte_timeout))
            if limit_ns is not None and now >= limit_ns:
                break
            try:
                now = self._wait_for_input(limit_ns, give_up_ns, size - len(data))
            except SerialException:
                self._input[:0] = data  # for the next read
                raise
            fresh = self._take(size - len(data))
            data += fresh
            if len(data) >= size or self._read_ended():
                break
        return bytes(data)

    def read_until(self, expected: bytes = LF, size: int | None = None) -> bytes:
        """Read until ``expected`` has come, or ``size`` bytes, or ``timeout`` has passed."""
        deadline_ns = self._deadline(self.timeout)
        data = bytearray()
        while byte := self.read(1):
            data += byte
            if data.endswith(expected) or (size is not None and len(data) >= size):
                break
            if deadline_ns is not None and self.line.sync() >= deadline_ns:
                break
        return bytes(data)

    @_clear_errors
    def reset_input_buffer(self) -> None:
        """Drop what has arrived and was not read."""
        self._opened()
        self._available()  # XON and XOFF count, read or not
        self._input.clear()
        self.line.receive()

    def cancel_read(self) -> None:
        """Make a ``read`` in another thread return, or the next one if there is none."""
        if self.is_open:
            self._cancelled_read = True
            self.line.wake()

    def _available(self) -> int:
        """How many bytes ``_take`` would give."""
        if self.xonxoff:
            self._obey(self.line.receive())
        return len(self._input) + (0 if self.xonxoff else self.line.available)

    def _take(self, limit: int) -> bytes:
        """What has arrived, at most ``limit`` bytes."""
        if self.xonxoff:
            self._available()
        elif not self._input:
            return self.line.receive(limit)
        data = bytes(self._input[:limit])
        del self._input[:limit]
        return data

    def _read_ended(self) -> bool:
        """Whether another thread has cancelled this ``read``, or closed the port."""
        if not self._cancelled_read:
            return not self.is_open
        self._cancelled_read = False
        return True

    def _wait_for_input(self, limit_ns: Nanos | None, give_up_ns: Nanos, count: int) -> Nanos:
        """Wait until ``count`` bytes may have come, or less long; returns the present time."""
        one_by_one = self.xonxoff or self.inter_byte_timeout is not None
        count = 1 if one_by_one else min(count, INPUT_STEP)
        if limit_ns is None:
            limit_ns = self._next_chance(give_up_ns)
        return self.line.wait(
            limit_ns, count, stop=lambda: self._cancelled_read or not self.is_open
        )

    def _next_chance(self, give_up_ns: Nanos) -> Nanos | None:
        """How far a wait without a time-out may go: in virtual time, it must not be for ever."""
        line = self.line
        if line.clock.is_shared:
            return None
        due_ns = line.next_event_ns()
        if due_ns is None or due_ns > give_up_ns:
            raise SerialException(
                "virtual time: nothing will ever arrive, and without a time-out this would wait "
                "for ever; give the port a timeout, or look why the twins are silent"
            )
        return due_ns

    # -- output -------------------------------------------------------------------------------

    @property
    @_clear_errors
    def out_waiting(self) -> int:
        """How many bytes are written and not on the line yet."""
        self._opened()
        count = self._backlog()
        if count:
            self._pass_poll()
        return count

    @_clear_errors
    def write(self, data: Any, /) -> int:
        """Queue ``data`` (bytes, bytearray, memoryview or a list of bytes); returns how many.

        Waits only while the output buffer is full, ``write_timeout`` seconds at most (0: takes what
        there is room for).  Raises SerialTimeoutException; what was queued by then is sent.
        """
        self._opened()
        rest = to_bytes(data)
        length = len(rest)
        deadline_ns = self._deadline(self.write_timeout)
        while True:
            rest = rest[self._queue(rest) :]
            if not rest or self.write_timeout == 0 or self._write_ended():
                return length - len(rest)
            if deadline_ns is not None and self.line.sync() >= deadline_ns:
                raise SerialTimeoutException("Write timeout")
            self._wait_for_output(deadline_ns, len(rest))

    @_clear_errors
    def flush(self) -> None:
        """Wait until everything written is on the line."""
        line = self._opened()
        while self.is_open and not self._write_ended():
            sent_ns = line.host_sent_ns
            if not self._held and line.sync() >= sent_ns:
                return
            self._wait_for_output(None if self._held else sent_ns, OUTPUT_MAX)

    @_clear_errors
    def reset_output_buffer(self) -> None:
        """Drop what is written and not on the line yet."""
        self._opened().purge_output()
        if self._held:
            self._held.clear()

    def cancel_write(self) -> None:
        """Make a ``write`` in another thread return, or the next one that has to wait."""
        if self.is_open:
            self._cancelled_write = True
            self.line.wake()

    def _backlog(self) -> int:
        return self.line.host_backlog + len(self._held or b"")

    def _queue(self, data: bytes) -> int:
        """Queue what there is room for; returns how many bytes that is."""
        if self.xonxoff:
            self._available()
        if self._held is None:
            return self.line.send(data, OUTPUT_MAX)
        data = data[: max(0, OUTPUT_MAX - self._backlog())]
        self._held += data
        return len(data)

    def _write_ended(self) -> bool:
        """Whether another thread has cancelled this ``write``, or closed the port."""
        if not self._cancelled_write:
            return not self.is_open
        self._cancelled_write = False
        return True

    def _wait_for_output(self, deadline_ns: Nanos | None, count: int) -> None:
        """Wait until there may be room for ``count`` bytes, or less long."""
        line = self.line
        limit_ns = deadline_ns
        if self._held is None:
            span_ns = line.host_format.span_ns(min(max(count, 1), OUTPUT_MAX // 4))
            limit_ns = _earlier(deadline_ns, line.sync() + span_ns)
        elif deadline_ns is None:
            limit_ns = self._next_chance(line.sync() + PATIENCE_NS)
        line.wait(
            limit_ns,
            1 if self._held is not None else None,
            stop=lambda: self._cancelled_write or not self.is_open,
        )

    # -- XON and XOFF -------------------------------------------------------------------------

    def _obey(self, data: bytes) -> None:
        """Swallow XON and XOFF and do what the last of them says; the rest is input."""
        self._input += data.translate(None, XON + XOFF)
        if data.rfind(XON) > data.rfind(XOFF):
            self._resume_output()
        elif XOFF in data and self._held is None:
            self._held = bytearray()

    def _resume_output(self) -> None:
        held, self._held = self._held, None
        if held:
            self.line.send(bytes(held))

    # -- break and modem lines ----------------------------------------------------------------

    @_clear_errors
    def send_break(self, duration: float = 0.25) -> None:
        """Hold the line at space for ``duration`` seconds (> 0), and wait for its end."""
        line = self._opened()
        line.send_break(self._span_ns(duration))
        self.flush()

    @_clear_errors
    def _update_break_state(self) -> None:
        """A break whose length is known only at its end goes out then, in one piece."""
        now = self.line.sync()
        if self.break_condition:
            self._break_since_ns = now
        elif self._break_since_ns is not None:
            since_ns, self._break_since_ns = self._break_since_ns, None
            if now > since_ns:
                self.line.send_break(now - since_ns)

    def _update_rts_state(self) -> None:
        """RTS goes nowhere."""

    def _update_dtr_state(self) -> None:
        """DTR goes nowhere."""

    @property
    def cts(self) -> bool:
        """Clear to send: always on."""
        self._opened()
        return True

    @property
    def dsr(self) -> bool:
        """Data set ready: always on."""
        self._opened()
        return True

    @property
    def ri(self) -> bool:
        """Ring indicator: always off."""
        self._opened()
        return False

    @property
    def cd(self) -> bool:
        """Carrier detect: always on."""
        self._opened()
        return True

    # -- time ---------------------------------------------------------------------------------

    def _span_ns(self, seconds: float) -> Nanos:
        """``seconds`` of the client's in the line's time."""
        assert self._shared is not None
        return self._shared.options.span_ns(seconds)

    def _deadline(self, timeout_s: float | None) -> Nanos | None:
        """When a call that starts now and may take ``timeout_s`` has to return."""
        return None if timeout_s is None else self.line.sync() + self._span_ns(timeout_s)

    def _pass_poll(self) -> None:
        """A poll takes one byte time, where nothing else makes time pass."""
        if self.line.is_virtual:
            self.line.advance(self.line.host_format.span_ns(1))


def _earlier(first: Nanos | None, second: Nanos) -> Nanos:
    return second if first is None else min(first, second)
