"""The port of a bus of twins that python-can opens; the rules stand at the head of the package."""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

import can
from can.broadcastmanager import (
    CyclicSendTaskABC,
    LimitedDurationCyclicSendTaskABC,
    ModifiableCyclicTaskABC,
    RestartableCyclicTaskABC,
)
from can.typechecking import AutoDetectedConfig, CanFilters

from axistwin import catalog
from axistwin.canbus.channel import parse_channel
from axistwin.canbus.shared import abandon, close_bus, open_bus, open_names
from axistwin.errors import AxistwinError
from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.ports.can_message import frame_of, message_of
from axistwin.runtime.any_twin import AnyTwin
from axistwin.runtime.bus import Bus
from axistwin.runtime.can_network import Arrival, ErrorReport
from axistwin.runtime.clock import check_advance
from axistwin.runtime.host.patches import really_sleep
from axistwin.wire.can_bus import ControllerState, Fault
from axistwin.wire.can_frame import INTERMISSION_BITS

_LOG: Final = logging.getLogger("can.axistwin")

SEND_QUEUE_FRAMES: Final = 256
"""Frames that a port's controller holds; ``send`` waits for room behind them."""

SHORTEST_BITS: Final = 44 + INTERMISSION_BITS
"""A standard frame without data and without stuff bits."""

LONGEST_BITS: Final = 160
"""More than any frame with its intermission."""

GIVE_WAY_S: Final = 0.001
"""What a reader in a thread of its own sleeps when nothing came in virtual time (``Notifier``)."""

# Error frames as SocketCAN forms them (linux/can/error.h).
_CLASS_CONTROLLER, _CLASS_PROTOCOL, _CLASS_ACK = 0x004, 0x008, 0x020
_CLASS_OFF, _CLASS_BUS_ERROR, _CLASS_RESTARTED = 0x040, 0x080, 0x100
_RX_PASSIVE, _TX_PASSIVE, _ACTIVE_AGAIN = 0x10, 0x20, 0x40
_PROTOCOL_BIT, _PROTOCOL_STUFF, _PROTOCOL_WHILE_SENDING = 0x01, 0x04, 0x80
_PASSIVE_ABOVE = 127

_STATES: Final[dict[ControllerState, can.BusState]] = {
    "active": can.BusState.ACTIVE,
    "passive": can.BusState.PASSIVE,
    "off": can.BusState.ERROR,
}


class VirtualCyclicTask(
    LimitedDurationCyclicSendTaskABC, ModifiableCyclicTaskABC, RestartableCyclicTaskABC
):
    """Messages sent one after the other at a period of virtual time (rule 2).

    It ends with the first message that cannot be sent.
    """

    def __init__(
        self,
        owner: "AxistwinBus",
        messages: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None,
        modifier: Callable[[can.Message], None] | None,
    ) -> None:
        super().__init__(messages, period, duration)
        if self.period_ns <= 0:
            raise ValueError(f"period {period} s is too short: 1 ns or more")
        self._owner = owner
        self._modifier = modifier
        self._index = 0
        self._end_ns: Nanos | None = None
        self.due_ns: Nanos = 0

    def start(self) -> None:
        """Send at once, and go on from there."""
        now = self.due_ns = self._owner.virtual_time_ns
        if self.duration is not None:
            self._end_ns = now + round(self.duration * NS_PER_S)
        self._owner._shared.add_task(self)
        self.run(now)

    def stop(self) -> None:
        """Send nothing more; it may be started again."""
        self._owner._shared.remove_task(self)

    def run(self, now: Nanos) -> None:
        """Send what is due; what was missed meanwhile is not made up for."""
        if self._end_ns is not None and self.due_ns >= self._end_ns:
            self.stop()
            return
        message = self.messages[self._index]
        self._index = (self._index + 1) % len(self.messages)
        self.due_ns += self.period_ns * ((now - self.due_ns) // self.period_ns + 1)
        if self._modifier is not None:
            self._modifier(message)
        try:
            self._owner.send(message, timeout=0)
        except can.CanOperationError:
            self.stop()


class AxistwinBus(can.BusABC):
    """A port of a bus of twins.

    channel and keyword arguments: see the head of this package.
    receive_own_messages: frames sent here are received here too, with ``is_rx`` false.
    ignore_rx_error_frames: error frames are not received.

    Raises CanInitializationError, one line that says what would be right.
    """

    def __init__(
        self,
        channel: str = "mac23-can",
        can_filters: CanFilters | None = None,
        *,
        receive_own_messages: bool = False,
        ignore_rx_error_frames: bool = False,
        fd: bool = False,
        timing: can.BitTiming | None = None,
        **kwargs: Any,
    ) -> None:
        if fd:
            raise can.CanInitializationError("fd: the twins speak classical CAN; leave it out")
        if timing is not None:
            kwargs.setdefault("bitrate", timing.bitrate)
        try:
            self._shared = open_bus(parse_channel(str(channel), kwargs))
            self._bus = self._shared.bus
            self._port = self._attached(receive_own_messages, not ignore_rx_error_frames)
        except AxistwinError as error:
            raise can.CanInitializationError(str(error)) from None
        self._received: deque[can.Message] = deque()
        self._controller: ControllerState = "active"
        self.channel = channel
        self.channel_info = f"axistwin {channel}"
        super().__init__(channel, can_filters)

    def _attached(self, hears_own: bool, hears_errors: bool) -> int:
        """The number of a new port; the bus is let go of if there is none to be had."""
        try:
            return self._bus.attach(hears_own=hears_own, hears_errors=hears_errors)
        except AxistwinError:
            self._is_shutdown = True
            close_bus(self._shared)
            raise

    # -- python-can's contract --

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next message that passes the filters; None when ``timeout`` seconds are over.

        Raises CanOperationError after ``shutdown``, when the memory cannot be written, and in
        virtual time without a time-out when nothing can ever arrive.
        """
        self._check_open()
        with self._translated():
            now = self._bus.sync()
            until_ns = None if timeout is None else now + self._patience_ns(timeout)
            while True:
                self._check_open()
                message = self._next_message()
                if message is not None:
                    return message
                if until_ns is not None and now >= until_ns:
                    break
                before, now = now, self._shared.wait(until_ns, self._port, self._is_closed)
                if until_ns is None and now == before and self._is_at_end():
                    raise can.CanOperationError(
                        "nothing can ever arrive, and virtual time waits for nothing; "
                        "give recv a time-out"
                    )
        if (
            self._bus.is_virtual
            and not self._bus.clock.is_shared
            and threading.current_thread() is not threading.main_thread()
        ):
            really_sleep(GIVE_WAY_S)
        return None

    def _patience_ns(self, timeout: float) -> Nanos:
        if timeout <= 0 and self._bus.is_virtual:
            return self._shared.bits_ns(SHORTEST_BITS)
        return self._shared.options.span_ns(max(0.0, timeout))

    def _is_at_end(self) -> bool:
        if self._bus.clock.is_shared:
            return False
        return self._bus.is_virtual and self._bus.next_event_ns() is None and not self._has_news()

    def _has_news(self) -> bool:
        self._take_arrivals()
        return bool(self._received)

    def _next_message(self) -> can.Message | None:
        """The oldest that passes the filters, which error frames always do."""
        while self._received or self._has_news():
            message = self._received.popleft()
            if message.is_error_frame or self._matches_filters(message):
                return message
        return None

    def _take_arrivals(self) -> None:
        """Frames and error reports, in the order of time."""
        arrivals, reports = self._bus.receive_all(self._port)
        messages = [self._message_of(each) for each in arrivals]
        if reports:
            messages += map(self._error_message, reports)
            messages.sort(key=lambda message: message.timestamp)
        self._received.extend(messages)

    def _stamp(self, time_ns: Nanos) -> float:
        return (self._shared.epoch_ns + time_ns) / NS_PER_S

    def _message_of(self, arrival: Arrival) -> can.Message:
        time_s = self._stamp(arrival.end_ns)
        return message_of(
            arrival.frame, time_s=time_s, channel=self.channel, is_rx=not arrival.is_own
        )

    def _error_message(self, report: ErrorReport) -> can.Message:
        """A report as SocketCAN tells it."""
        data = bytearray(8)
        if isinstance(report, Fault):
            time_ns = report.end_ns
            if report.kind == "ack":
                error_class = _CLASS_ACK | _CLASS_BUS_ERROR
            else:
                error_class = _CLASS_PROTOCOL | _CLASS_BUS_ERROR
                data[2] = _PROTOCOL_BIT if report.kind == "bit" else _PROTOCOL_STUFF
                if self._port in report.senders:
                    data[2] |= _PROTOCOL_WHILE_SENDING
        else:
            time_ns, before, self._controller = report.time_ns, self._controller, report.state
            transmit_errors, receive_errors = self._bus.counters(self._port)
            error_class = _CLASS_CONTROLLER
            if report.state == "off":
                error_class = _CLASS_OFF
            elif before == "off":
                error_class = _CLASS_RESTARTED
            elif report.state == "active":
                data[1] = _ACTIVE_AGAIN
            else:
                data[1] = _TX_PASSIVE if transmit_errors > _PASSIVE_ABOVE else _RX_PASSIVE
            data[6:] = min(transmit_errors, 255), min(receive_errors, 255)
        return can.Message(
            timestamp=self._stamp(time_ns),
            arbitration_id=error_class,
            is_extended_id=False,
            is_error_frame=True,
            channel=self.channel,
            data=data,
        )

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue ``msg``; wait ``timeout`` seconds, None for ever, only while the queue is full.

        Raises CanOperationError after ``shutdown``, for error and FD frames, and in virtual time
        when the queue is full and nobody acknowledges; CanTimeoutError when it stays full;
        ValueError for what is no frame.
        """
        if msg.is_fd or msg.is_error_frame:
            kind = "FD" if msg.is_fd else "error"
            raise can.CanOperationError(f"{kind} frames cannot be sent; the bus is classical CAN")
        frame = frame_of(msg)
        self._check_open()
        with self._translated():
            if self._bus.backlog(self._port) >= SEND_QUEUE_FRAMES:
                self._wait_for_room(timeout)
            self._bus.send(self._port, frame)

    def _wait_for_room(self, timeout: float | None) -> None:
        now = self._bus.sync()
        until_ns = None if timeout is None else now + self._shared.options.span_ns(timeout)
        while self._bus.backlog(self._port) >= SEND_QUEUE_FRAMES:
            if until_ns is not None and now >= until_ns:
                raise can.CanTimeoutError(
                    f"the send queue is still full ({SEND_QUEUE_FRAMES} frames) after {timeout} s"
                )
            if until_ns is None and self._bus.is_virtual and self._bus.next_event_ns() is None:
                raise can.CanOperationError(
                    "the send queue is full and nobody on the bus acknowledges; power a twin"
                )
            slice_ns = now + self._shared.bits_ns(LONGEST_BITS)
            now = self._bus.wait(slice_ns if until_ns is None else min(until_ns, slice_ns))
            self._check_open()

    def _send_periodic_internal(
        self,
        msgs: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None = None,
        autostart: bool = True,
        modifier_callback: Callable[[can.Message], None] | None = None,
    ) -> CyclicSendTaskABC:
        if not self._bus.is_virtual or self._shared.options.host_clock:
            return super()._send_periodic_internal(
                msgs, period, duration, autostart, modifier_callback
            )
        task = VirtualCyclicTask(self, msgs, period, duration, modifier_callback)
        if autostart:
            task.start()
        return task

    def flush_tx_buffer(self) -> None:
        """Forget what has not been sent; a frame under way is not tried again."""
        self._check_open()
        with self._translated():
            self._bus.purge_output(self._port)

    def shutdown(self) -> None:
        """Send what is queued, if anybody acknowledges it, and leave the bus.

        The last one who leaves ends the bus, and its memory is saved.
        """
        if self._is_shutdown:
            return
        super().shutdown()
        try:
            self._send_the_rest()
            self._bus.detach(self._port)
        except AxistwinError as error:  # told as long as anybody uses the bus
            raise can.CanOperationError(str(error)) from error
        finally:
            close_bus(self._shared)

    def __del__(self) -> None:
        """Leave the bus, but later: whoever is collected may be so in the midst of what another
        port of the same bus does in this very thread."""
        if not self._is_shutdown:
            _LOG.warning("%s was not properly shut down", type(self).__name__)
            self._is_shutdown = True
            if hasattr(self, "_port"):
                abandon(self._shared, self._port)

    def _send_the_rest(self) -> None:
        now, slice_ns = self._bus.sync(), self._shared.bits_ns(LONGEST_BITS)
        until_ns = now + slice_ns * self._bus.backlog(self._port)
        while self._bus.backlog(self._port) and now < until_ns:
            now = self._bus.wait(min(until_ns, now + slice_ns))

    @property
    def state(self) -> can.BusState:
        """ACTIVE, PASSIVE (error-passive), or ERROR (bus-off)."""
        self._check_open()
        with self._translated():
            return _STATES[self._bus.controller(self._port)]

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError("the controller's state follows from what happens on the bus")

    @staticmethod
    def _detect_available_configs() -> Sequence[AutoDetectedConfig]:
        """Every model that lives on a bus, and the buses that are open in this process."""
        names = [model.name for model in catalog.models().values() if model.carrier == "can"]
        names += [f"?bus={name}" for name in open_names()]
        return [AutoDetectedConfig(interface="axistwin", channel=name) for name in names]

    # -- what only twins have --

    @property
    def line(self) -> Bus:
        """The bus with its twins, and with the faults of its wire."""
        return self._bus

    @property
    def twins(self) -> list[AnyTwin]:
        """The devices, to be looked at and worked: inputs, supply, load, position."""
        return self._bus.twins

    @property
    def virtual_time_ns(self) -> Nanos:
        """The present time of the bus, nanoseconds since it was made."""
        self._check_open()
        with self._translated():
            return self._bus.sync()

    def advance(self, seconds: float) -> None:
        """Let ``seconds`` (0..1e12) pass; what arrives meanwhile is there to be received."""
        self._check_open()
        check_advance(seconds)
        with self._translated():
            self._bus.note(f"advance({seconds:g})")
            self._shared.advance(self._shared.options.span_ns(seconds), self._is_closed)
            self._check_open()

    def render_transcript(self) -> str:
        """The last frames on the bus, in words."""
        return self._bus.render_transcript()

    # -- errors --

    def _is_closed(self) -> bool:
        return self._is_shutdown

    def _check_open(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError(f"{self.channel_info} is shut down; open it again")

    @contextmanager
    def _translated(self) -> Iterator[None]:
        """What goes wrong with twins, as python-can's users expect it."""
        try:
            yield
        except AxistwinError as error:
            self._check_open()  # the bus is closed because this port is shut down
            raise can.CanOperationError(str(error)) from error
        except KeyError:
            self._check_open()  # another thread has taken the port off the bus just now
            raise
