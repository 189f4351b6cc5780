"""A controller on a line of its own in virtual time, and a host with all the time in the world."""

from collections.abc import Sequence

from axistwin.devices.msc.controller import MscController
from axistwin.devices.msc.packets import packet
from axistwin.devices.msc.quirks import parse_quirks
from axistwin.devices.switches import Value
from axistwin.kernel.effects import Effect, Store, Transmit
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.runtime.network import SerialNetwork
from axistwin.wire.framing import Chunk, LineFormat

F9600 = LineFormat(9600)
CHARACTER_NS = F9600.span_ns(1)
ACK, NAK = b"\x06", b"\x15"
SETTLE_MS = 1000 + 6 * 1150 + 100
"""T1 + 6 x (T2 + 150 ms), and a little more."""


def word(number: int) -> bytes:
    """16 bits, high byte first."""
    return number.to_bytes(2, "big")


def long(value: int) -> bytes:
    """Signed 32 bits, high byte first."""
    return value.to_bytes(4, "big", signed=True)


def dread(address: int, unit: int = 1, block: int = 0) -> bytes:
    """A DREAD packet."""
    return packet(unit, b"DREAD," + word(address), block)


def dwrite(address: int, value: int, unit: int = 1) -> bytes:
    """A DWRITE packet."""
    return packet(unit, b"DWRITE," + word(address) + long(value), 0)


def bread(address: int, unit: int = 1) -> bytes:
    """A BREAD packet."""
    return packet(unit, b"BREAD," + word(address))


def bwrite(address: int, values: Sequence[int], unit: int = 1) -> bytes:
    """A BWRITE packet."""
    return packet(unit, b"BWRITE," + word(address) + b"".join(map(long, values)))


def flag(name: str, number: int, unit: int = 1) -> bytes:
    """An RFLAG, SFLAG or CFLAG packet."""
    return packet(unit, name.encode() + b"," + word(number))


def rqstat(unit: int = 1, block: int = 0) -> bytes:
    """An RQSTAT packet."""
    return packet(unit, b"RQSTAT,", block)


def rflags(unit: int = 1) -> bytes:
    """An RFLAGS packet."""
    return packet(unit, b"RFLAGS,")


def broken(raw: bytes) -> bytes:
    """``raw`` with a checksum that is one too high."""
    return raw[:-2] + word(int.from_bytes(raw[-2:], "big") + 1 & 0xFFFF)


STATUS = packet(1, b"RQSTAT," + bytes(8))
"""The reply of a unit 1 without a program."""

REPLY = packet(1, b"DREAD," + bytes(4))
"""The reply to a DREAD of a variable that was never written."""


def end_of(sending: tuple[Nanos, bytes]) -> Nanos:
    """When the last byte of what a unit sent has left."""
    return sending[0] + F9600.span_ns(len(sending[1]))


class WatchedController(MscController):
    """One that notes when it begins to send what, and all it wants stored."""

    sent: list[tuple[Nanos, bytes]]
    stored: list[Store]

    def receive(self, chunk: Chunk) -> list[Effect]:
        """Note the effects."""
        return self._note(super().receive(chunk))

    def wake(self, now: Nanos) -> list[Effect]:
        """Note the effects."""
        return self._note(super().wake(now))

    def _note(self, effects: list[Effect]) -> list[Effect]:
        self.sent += [(each.start_ns, each.data) for each in effects if isinstance(each, Transmit)]
        self.stored += [each for each in effects if isinstance(each, Store)]
        return effects


class MscBench:
    """Units of one model on one line; quirks are keyword arguments.

    Unit 1 alone is on RS-232, else all are on RS-485.
    """

    def __init__(
        self,
        *units: int,
        model: str = "msc-250",
        paced: bool = True,
        host_format: LineFormat | None = None,
        **quirks: Value,
    ) -> None:
        settings = parse_quirks(quirks)
        self.devices = []
        for place, unit in enumerate(units or (1,)):
            device = WatchedController(
                model, unit, quirks=settings, skew_ns=70_000 * place, alone=len(units) < 2
            )
            device.sent, device.stored = [], []
            self.devices.append(device)
        self.device = self.devices[0]
        self.network = SerialNetwork(self.devices, paced=paced, host_format=host_format)

    @property
    def now(self) -> Nanos:
        """The present time."""
        return self.network.now_ns

    def send(self, data: bytes) -> Nanos:
        """Send from the host's end; returns when the last byte will have been heard."""
        self.network.host_send(data)
        return self.network.host_sent_ns

    def wait(self, milliseconds: float) -> bytes:
        """Let time pass; returns what the host has heard since last time."""
        self.run_until(self.now + round(milliseconds * NS_PER_MS))
        return self.network.host_take()

    def run_until(self, time_ns: Nanos) -> None:
        """Let time pass until then."""
        self.network.run_until(time_ns)

    def tell(self, data: bytes, milliseconds: float = 400) -> bytes:
        """Send, and what is heard within some time."""
        self.send(data)
        return self.wait(milliseconds)

    def ask(self, data: bytes) -> bytes:
        """Send a packet, take sign and reply, and acknowledge a reply; returns both."""
        heard = self.tell(data)
        if len(heard) > 1:
            assert self.tell(ACK, 50) == b""
        return heard

    def value(self, address: int, unit: int = 1) -> int:
        """The value at ``address``, by DREAD."""
        heard = self.ask(dread(address, unit))
        assert heard[:1] == ACK, heard
        return int.from_bytes(heard[-6:-2], "big", signed=True)

    def is_on(self, number: int) -> bool:
        """Whether a flag is on, by RFLAG."""
        heard = self.ask(flag("RFLAG", number))
        assert heard[:1] == ACK, heard
        return bool(heard[-3])

    def status(self) -> int:
        """The status word, by RQSTAT."""
        heard = self.ask(rqstat())
        assert heard[:1] == ACK, heard
        return int.from_bytes(heard[14:16], "big")

    def settle(self) -> bytes:
        """Let every time limit run out; returns what is heard meanwhile."""
        return self.wait(SETTLE_MS)

    def perform(self, effects: list[Effect], index: int = 0) -> None:
        """Perform what a method called from outside returned."""
        self.network.perform(index, effects)

    @property
    def sent(self) -> list[tuple[Nanos, bytes]]:
        """When the first unit began to send what."""
        return self.device.sent
