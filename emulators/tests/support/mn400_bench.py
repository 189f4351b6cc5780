"""Boards on a line of their own in virtual time, and a host that speaks in commands."""

from collections.abc import Mapping

from axistwin.devices.mn400.device import Mn400Board
from axistwin.devices.mn400.link.packets import packet
from axistwin.devices.mn400.quirks import parse_quirks
from axistwin.devices.switches import Value
from axistwin.kernel.effects import Effect, Store, Transmit
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.runtime.network import SerialNetwork
from axistwin.wire.framing import Chunk, LineFormat

CODES = {
    0x03: "S",
    0x04: "ABORT",
    0x05: "D",
    0x07: "CHK",
    0x08: "ADDR",
    0x0C: "IC",
    0x0D: "IP",
    0x0E: "PE",
    0x0F: "NC",
    0x10: "NP",
    0x11: "MP",
    0x12: "BC",
    0x13: "TO",
    0x14: "BY",
    0x15: "OV",
    0x16: "PR",
    0x1D: "NA",
    0x1E: "MF",
    0x20: "STOP",
}
REPLY_MS = 100
"""Within this any reply has come at 9600, but for measurements and later slots."""


def packets_in(data: bytes) -> list[bytes]:
    """The packets in what a host has heard, each with its right sum."""
    found, rest = [], data
    while rest:
        assert rest[0] & 0x80, data.hex(" ")
        end = rest.index(rest[:1], 1) + 2
        raw, rest = rest[:end], rest[end:]
        assert sum(raw[:-1]) & 0x7F == raw[-1], raw.hex(" ")
        found.append(raw)
    return found


def in_short(raw: bytes) -> str:
    """``D`` or ``S`` or whatever a status packet says; of a data packet the value."""
    inner = raw[2:-2]
    if inner and inner[0] in CODES and inner[1:] in (b"", b"\x00"):
        return CODES[inner[0]]
    return bytes(byte for byte in inner if byte >= 0x20).decode("ascii")


class WatchedBoard(Mn400Board):
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


class Mn400Bench:
    """Boards on one line; quirks are keyword arguments.  One alone is on RS-232."""

    def __init__(
        self,
        *numbers: int,
        paced: bool = True,
        cells: Mapping[str, int] | None = None,
        **quirks: Value,
    ) -> None:
        self.quirks = parse_quirks(quirks)
        self.devices = []
        for place, number in enumerate(numbers or (1,)):
            device = WatchedBoard(
                number,
                quirks=self.quirks,
                skew_ns=70_000 * place,
                alone=len(numbers) < 2,
                cells=cells,
            )
            device.sent, device.stored = [], []
            self.devices.append(device)
        self.device = self.devices[0]
        self.network = SerialNetwork(self.devices, paced=paced)

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
        self.network.run_until(self.now + round(milliseconds * NS_PER_MS))
        return self.network.host_take()

    def ask(self, data: bytes, milliseconds: float = REPLY_MS) -> bytes:
        """Send, and what is heard within some time."""
        self.send(data)
        return self.wait(milliseconds)

    def say(self, *lines: str, number: int = 1, milliseconds: float = REPLY_MS) -> str:
        """Send commands, each with time for its reply; returns the last one's in short: ``S D``."""
        heard = b""
        for line in lines:
            heard = self.ask(packet(number, line.encode("latin-1")), milliseconds)
        return " ".join(in_short(raw) for raw in packets_in(heard))

    def value(self, line: str, number: int = 1, milliseconds: float = REPLY_MS) -> str:
        """What a read-out tells."""
        told = self.say(line, number=number, milliseconds=milliseconds)
        assert told.startswith("S "), told
        return told[2:]

    def position(self, number: int = 1) -> list[int]:
        """The counters, by E."""
        return [int(text) for text in self.value("E", number).split(",")]

    def peek(self) -> list[int]:
        """The counters, behind the host's back."""
        return list(self.device.position_at(self.now))

    def perform(self, effects: list[Effect], index: int = 0) -> None:
        """Perform what a method called from outside returned."""
        self.network.perform(index, effects)

    def switch(self, name: str, on: bool = True) -> None:
        """Turn an input of the first board on or off."""
        self.perform(self.device.set_input(self.now, name, on))

    def host_rate(self, baud: int) -> None:
        """Change the host's rate."""
        self.network.host_format = LineFormat(baud)

    def power_cycle(self) -> None:
        """Off and on again."""
        self.network.power_off(0)
        self.wait(10)
        self.network.power_on(0)
        self.device.sent.clear()

    def moving_ms(self, *lines: str) -> float:
        """How long the axes move after the last of ``lines`` was heard, ms."""
        for line in lines[:-1]:
            assert self.say(line) == "S D", line
        began = self.send(packet(1, lines[-1].encode()))
        self.network.run_until(began)
        while self.device.moves_at(self.now):
            due = self.network.next_event()
            assert due is not None, "it would never end"
            self.network.run_until(due)
        ended = self.now
        self.wait(REPLY_MS)
        return (ended - began) / NS_PER_MS
