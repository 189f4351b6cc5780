"""A lamp whose level, 0..9, is set by ``=5`` and asked by ``?``, each with a line feed."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from axistwin.devices.snapshot import Snapshot
from axistwin.devices.switches import Quirk, quirk, switches
from axistwin.kernel.effects import Effect, Store, Transmit
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.wire.framing import Chunk, LineFormat


@dataclass(frozen=True, slots=True)
class LampQuirks:
    """Where the manual of the lamp leaves a doubt."""

    acknowledge: Literal["K", "A"] = quirk("K", "TOY-AMB-01", "answer to a level that was set")
    keeps_level: bool = quirk(True, "TOY-AMB-02", "the level outlives the supply")


QUIRKS: Final[dict[str, Quirk]] = switches(LampQuirks)


@dataclass(frozen=True, slots=True)
class LampSnapshot(Snapshot):
    """The lamp at one instant."""

    address: int
    state_text: str
    level: int


@dataclass
class Lamp:
    """A lamp; ``level`` is what was stored."""

    quirks: LampQuirks
    level: int = 0
    line_format: LineFormat = field(default_factory=lambda: LineFormat(9600))
    is_full_duplex = True
    is_powered = True
    received = b""

    def quiet_prefix(self, data: bytes) -> int:
        """All before the end of the first line."""
        end = data.find(b"\n")
        return len(data) if end < 0 else end

    def receive(self, chunk: Chunk) -> list[Effect]:
        """Answer the line that ends here, 1 ms later."""
        self.received += chunk.data
        line, end, self.received = self.received.partition(b"\n")
        if not end:
            self.received = line
            return []
        effects: list[Effect] = []
        if line == b"?":
            answer = b"%d\n" % self.level
        elif found := re.fullmatch(rb"=(\d)", line):
            self.level = int(found[1])
            effects.append(Store((("level", self.level),)))
            answer = self.quirks.acknowledge.encode()
        else:
            return []
        now = chunk.arrival_ns(len(chunk.data) - 1)
        return [*effects, Transmit(now + NS_PER_MS, answer)] if self.is_powered else []

    def press(self, now: Nanos) -> list[Effect]:
        """Press the button on the lamp, which turns it off."""
        self.level = 0
        return [Store((("level", 0),))]

    def next_event(self) -> Nanos | None:
        """Nothing happens by itself."""
        return None

    def wake(self, now: Nanos) -> list[Effect]:
        """Nothing is ever due."""
        return []

    def power_off(self, now: Nanos) -> list[Effect]:
        """Cut the supply."""
        self.is_powered, self.received = False, b""
        return [] if self.quirks.keeps_level else self.press(now)

    def power_on(self, now: Nanos) -> list[Effect]:
        """Apply the supply."""
        self.is_powered = True
        return []

    def cells(self, now: Nanos) -> Mapping[str, int]:
        """What is stored."""
        return {"level": self.level}

    def is_moving(self, now: Nanos) -> bool:
        """Never."""
        return False

    def describe(self, now: Nanos) -> LampSnapshot:
        """Everything worth showing."""
        return LampSnapshot(0, "on" if self.level and self.is_powered else "off", self.level)


def explain(data: bytes) -> str:
    """Lines of either direction in words."""
    words = {"?": "level?", "K": "accepted", "A": "accepted"}
    lines = data.decode("ascii", "replace").split("\n")
    return "; ".join(words.get(line, f"level {line.lstrip('=')}") for line in lines if line)
