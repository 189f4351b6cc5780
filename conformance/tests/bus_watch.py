"""The witness of `shaft_watch` on a bus: it decodes every frame sent by itself, and asks the twins,
not the bus, where their shafts are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import can
from bus_in_front import BusInFront
from shaft_watch import ACTING, CLEARING_SLICE_NS, SLICE_NS, Handled, Order, Shaft

ALL = 0xFF
UPLOAD, REFUSED = 0x40, 0x80
LMT_REQUEST, SYNC, REPLY, REQUEST = 0x7E5, 0x080, 0x580, 0x600
SYNCHRONOUS_START, SET_ADDRESS = 0x11, 0x08


def order_of(message: can.Message) -> Order | None:
    """What some module would execute; None for what nobody does."""
    if message.is_extended_id or message.is_remote_frame or message.is_error_frame:
        return None
    identifier, data = message.arbitration_id, bytes(message.data)
    if identifier == SYNC:
        return Order(ALL, SYNCHRONOUS_START, 0)
    if identifier == LMT_REQUEST:
        return Order(ALL, SET_ADDRESS, 0)
    if len(data) < 8:  # ignored (MACC-SDO-11)
        return None
    if identifier & ~0x7F != REQUEST or data[2] != 0x20 or data[0] == UPLOAD:
        return None
    return Order(identifier - REQUEST or ALL, data[1], int.from_bytes(data[4:], "big"))


class BusWatch(BusInFront):
    """The twin's bus as the suite sees it, with a witness; `at_call` is told before each call."""

    def __init__(self, bus: Any, at_call: Callable[[Any], None] = lambda watch: None) -> None:
        super().__init__(bus)
        self.sent: list[can.Message] = []
        self.shafts = [Shaft(twin) for twin in bus.twins]
        self.cells = self.found
        self._at_call = at_call
        self._open: list[tuple[Shaft, Order]] = []

    @property
    def twins(self) -> Any:
        """The handles, with a look before and after whatever the rig does by them."""
        return [Handled(twin, self._look) for twin in self.bus.twins]

    def _look(self) -> None:
        now_ns = self.virtual_time_ns
        for shaft in self.shafts:
            shaft.look(now_ns)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Record, look, send."""
        self._at_call(self)
        self._look()
        self._settle()
        self.sent.append(msg)
        order = order_of(msg)
        for shaft in self.shafts if order is not None else ():
            assert order is not None
            if shaft.is_told(order):
                shaft.tell(order, self.virtual_time_ns)
                self._open.append((shaft, order))
        self.bus.send(msg, timeout)

    def _settle(self, reply: can.Message | None = None) -> None:
        """Account for what was asked: by a reply of whom it is from; of the others, and without
        one, as if it had been obeyed."""
        for shaft, order in self._open:
            is_its_own = reply is not None and reply.arbitration_id == REPLY + shaft.twin.address
            if not (is_its_own and reply is not None and reply.data[:1] == bytes([REFUSED])):
                shaft.heed(order)
        self._open = []

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Receive, with looks in between."""
        self._at_call(self)
        deadline_ns = self.virtual_time_ns + round((timeout or 0) * 1e9)
        while True:
            now_ns = self.virtual_time_ns
            is_clearing = any(shaft.is_clearing(now_ns) for shaft in self.shafts)
            left_ns = deadline_ns - now_ns
            is_moving = any(shaft.twin.is_moving for shaft in self.shafts)
            slice_ns = min(left_ns, SLICE_NS) if is_moving else left_ns
            slice_ns = min(left_ns, CLEARING_SLICE_NS) if is_clearing and is_moving else slice_ns
            message: can.Message | None = self.bus.recv(max(0, slice_ns) / 1e9)
            self._look()
            if message is not None or slice_ns >= left_ns:
                break
        if message is not None and message.arbitration_id & ~0x7F == REPLY:
            self._settle(message)
        return message

    def shutdown(self) -> None:
        """The bus stays open for questions."""

    def rest(self, seconds: float = 1.0) -> None:
        """Let time pass in which nobody sends."""
        self.bus.advance(seconds)
        self._look()

    def has_acted(self, before: int) -> bool:
        """True if anything was sent by then that leaves something to put back."""
        return any(order.index in ACTING for order in self._orders(self.sent[:before]))

    def orders_after(self, sent: int) -> list[Order]:
        """What was asked for later than that."""
        return self._orders(self.sent[sent:])

    @staticmethod
    def _orders(messages: list[can.Message]) -> list[Order]:
        found = (order_of(message) for message in messages)
        return [order for order in found if order is not None]
