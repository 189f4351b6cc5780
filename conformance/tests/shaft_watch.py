"""A witness of a run that shares nothing with the fence: it decodes every byte sent by itself and
asks the twins, not the wire, where their shafts are.

The twin's own counter is looked at whenever the suite sends, receives or works the rig, and in
motion every 20 ms of virtual time.  A counter that is cleared is no shaft that moves: after 0Bh it
is looked at every 20 µs until the reply comes, in which an axis makes no more than one increment
(`blur`).  A counter that jumps while no time passes was turned by hand, or cleared by the contact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from port_in_front import PortInFront

SLICE_NS, CLEARING_SLICE_NS, CLEARING_NS = 20_000_000, 20_000, 200_000_000
LENGTH = 21
HEX = frozenset(b"0123456789ABCDEFabcdef")
# What moves, stops, stores or re-initialises: after any of it a run has something to put back.
ACTING = {*range(0x04), 0x08, 0x09, 0x0A, *range(0x0C, 0x11), *range(0x13, 0x1D), 0x1E}
REFUSALS = (b"\x15", b"\x06\x13\x17")


@dataclass(frozen=True)
class Order:
    """A frame that a module would execute."""

    address: int
    index: int
    parameter: int


def orders(tail: bytes, data: bytes) -> list[Order]:
    """Every frame with a right checksum that ends in `data`, wherever it begins."""
    stream, found = tail + data, []
    for end in range(max(LENGTH, len(tail) + 1), len(stream) + 1):
        frame = stream[end - LENGTH : end]
        digits = frame[4:20]
        if frame[:4] != b"\x02014" or frame[20] != 3 or not HEX.issuperset(digits):
            continue
        if sum(frame[4:18]) % 256 == int(frame[18:20], 16):
            found.append(Order(int(digits[:2], 16), int(digits[2:4], 16), int(digits[6:14], 16)))
    return found


def signed(value: int, bits: int) -> int:
    """Two's complement."""
    return value - (1 << bits) if value >> (bits - 1) else value


class Shaft:
    """One twin's shaft: how far from where it was found it has been, and has been asked to go."""

    def __init__(self, twin: Any) -> None:
        self.twin = twin
        self.place = self.furthest = self.asked = self.blur = 0
        self.fastest = 0.0  # increments per second
        self.counter, self._seen_ns = int(twin.position), -1
        self._target: int | None = None  # of the last 13h or 14h, held back or not
        self._tip = 0  # where the last segment ends
        self._clearing_until_ns = -1

    def look(self, now_ns: int) -> None:
        """Follow the shaft."""
        counter = int(self.twin.position)
        step, passed_ns = counter - self.counter, now_ns - self._seen_ns
        is_cleared = False
        if step and passed_ns == 0:  # by hand or by the contact
            is_cleared = counter == 0 and bool(self.twin.describe()["reference_enabled"])
        elif self.is_clearing(now_ns) and abs(counter) <= 1 < abs(step):
            is_cleared = True
            self.blur += bool(self.twin.is_moving)
            self._clearing_until_ns = -1
        if is_cleared:
            if (
                self.twin.is_moving and self._target is not None
            ):  # it counts anew, to the old number
                self._ask(self.place + self._target)
        else:
            self.place += step
            if passed_ns >= SLICE_NS // 2:
                self.fastest = max(self.fastest, (abs(step) - 1) * 1e9 / passed_ns)
        self.counter, self._seen_ns = counter, now_ns
        self.furthest = max(self.furthest, abs(self.place))

    def is_clearing(self, now_ns: int) -> bool:
        """True while 0Bh may be on its way."""
        return now_ns < self._clearing_until_ns

    def _ask(self, place: int) -> None:
        self.asked = max(self.asked, abs(place))

    def is_told(self, order: Order) -> bool:
        """True if this twin heeds that address."""
        return order.address in (0xFF, self.twin.address)

    def tell(self, order: Order, now_ns: int) -> None:
        """Account for an order that is being sent, whether or not it will be refused."""
        if order.index in (0x13, 0x14, 0x15):
            places = {0x13: signed(order.parameter, 32), 0x14: 0}
            self._target = places.get(order.index)
        is_begun = order.index in (0x13, 0x14)
        if order.index == 0x11:  # the target counts from where the counter begins by now
            is_begun = bool(self.twin.describe()["preloaded"])
        if is_begun and self._target is not None:
            self._ask(self.place + self._target - self.counter)
        if order.index == 0x16 and self.twin.describe()["state"] != "IN":
            self._tip = self.place
        if order.index == 0x0B:
            self._clearing_until_ns = now_ns + CLEARING_NS

    def heed(self, order: Order) -> None:
        """Account for a segment that was not refused: it begins where the last one ends."""
        if order.index == 0x16 and order.parameter & 0xFFFF:
            self._tip += signed(order.parameter >> 16, 16)
            self._ask(self._tip)


class Handled:
    """A handle of the twin's that tells before and after it is worked."""

    def __init__(self, inner: Any, look: Callable[[], None]) -> None:
        vars(self).update(inner=inner, look=look)

    def __getattr__(self, name: str) -> Any:
        """What the handle has, told as well."""
        value = getattr(self.inner, name)
        return Handled(value, self.look) if name == "controls" or callable(value) else value

    def __getitem__(self, name: str) -> Handled:
        """One of the twin's controls, told when it is worked."""
        return Handled(self.inner[name], self.look)

    def __call__(self, *given: Any) -> Any:
        """Do it between two looks."""
        self.look()
        result = self.inner(*given)
        self.look()
        return result


class Watch(PortInFront):
    """The twin's port as the suite sees it, with a witness; `at_call` is told before each call."""

    def __init__(self, port: Any, at_call: Callable[[Watch], None] = lambda watch: None) -> None:
        super().__init__(port)
        self.sent: list[bytes] = []
        self.shafts = [Shaft(twin) for twin in port.twins]
        self.cells = self.stored()
        self._at_call = at_call
        self._tail = self._reply = b""
        self._open: list[tuple[Shaft, Order]] = []

    def stored(self) -> list[dict[str, Any]]:
        """What each twin's EEPROM holds; the counter is no parameter."""
        return [
            {name: cell for name, cell in twin.cells.items() if name != "position"}
            for twin in self.port.twins
        ]

    @property
    def twins(self) -> Any:
        """The handles, with a look before and after whatever the rig does by them."""
        return [Handled(twin, self._look) for twin in self.port.twins]

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        self._at_call(self)
        return int(self.port.in_waiting)

    def _look(self) -> None:
        now_ns = int(self.port.virtual_time_ns)
        for shaft in self.shafts:
            shaft.look(now_ns)

    def write(self, data: bytes) -> int:
        """Record, look, send."""
        self._at_call(self)
        self._look()
        self._settle()
        self.sent.append(data)
        for order in orders(self._tail, data):
            for shaft in self.shafts:
                if shaft.is_told(order):
                    shaft.tell(order, int(self.port.virtual_time_ns))
                    self._open.append((shaft, order))
        self._tail = (self._tail + data)[1 - LENGTH :]
        return int(self.port.write(data))

    def _settle(self) -> None:
        if self._reply not in REFUSALS:
            for shaft, order in self._open:
                shaft.heed(order)
        self._open, self._reply = [], b""

    def read(self, size: int = 1) -> bytes:
        """Receive, with looks in between."""
        self._at_call(self)
        deadline_ns = int(self.port.virtual_time_ns) + round((self.timeout or 0) * 1e9)
        while True:
            now_ns = int(self.port.virtual_time_ns)
            is_clearing = any(shaft.is_clearing(now_ns) for shaft in self.shafts)
            left_ns = deadline_ns - now_ns
            is_moving = any(shaft.twin.is_moving for shaft in self.shafts)
            slice_ns = min(left_ns, SLICE_NS) if is_moving else left_ns
            slice_ns = min(left_ns, CLEARING_SLICE_NS) if is_clearing and is_moving else slice_ns
            self.port.timeout = max(0, slice_ns) / 1e9
            data = bytes(self.port.read(size))
            self._look()
            if data or slice_ns >= left_ns:
                break
        self._reply += data
        if len(self._reply) == 3:  # a segment may begin to run with its acceptance
            self._settle()
        return data

    def close(self) -> None:
        """The port stays open for questions."""

    def rest(self, seconds: float = 1.0) -> None:
        """Let time pass in which nobody sends."""
        self.port.advance(seconds)
        self._look()

    def has_acted(self, before: int) -> bool:
        """True if anything was sent by then that leaves something to put back."""
        return any(
            order.index in ACTING for data in self.sent[:before] for order in orders(b"", data)
        )

    def orders_after(self, sent: int) -> list[Order]:
        """What was asked for later than that."""
        return [order for data in self.sent[sent:] for order in orders(b"", data)]
