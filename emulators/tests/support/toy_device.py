"""The smallest device with a shaft: enough to test what surrounds devices.

Requests of one byte, answered 1 ms later: ``W`` stores (cell ``writes`` counts) and answers ``K``;
``P`` answers the position in four bytes; ``G`` starts an endless move of 1 increment per ms and
``S`` ends it, both without an answer; ``T`` makes a trace and answers ``t``.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from axistwin.devices.snapshot import Snapshot
from axistwin.errors import UsageError
from axistwin.kernel.effects import Effect, Store, Trace, Transmit
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.motion.plant import Load
from axistwin.wire.framing import Chunk, LineFormat

LATENCY_NS = NS_PER_MS


@dataclass(frozen=True, slots=True)
class ToyTrace(Trace):
    """What a toy tells."""

    what: str


@dataclass(frozen=True, slots=True)
class ToySnapshot(Snapshot):
    """What a toy shows."""

    state_text: str
    address: int
    supply_millivolts: int
    temperature_millidegrees: int


class ToyDevice:
    """See above; notes everything done to it in ``done``."""

    line_format = LineFormat(38400)
    is_full_duplex = False

    def __init__(self, cells: Mapping[str, int] | None = None) -> None:
        self.stored = {"address": 0, "writes": 0, "position": 0, **(cells or {})}
        self.supply_millivolts = 24_000
        self.temperature_millidegrees = 25_000
        self.done: list[tuple[Nanos, str, object]] = []
        self.powered = True
        self.inputs = dict.fromkeys(("reference", "positive_stop", "negative_stop", "reset"), False)
        self.load = Load()
        self._moving_since: Nanos | None = None

    def quiet_prefix(self, data: bytes) -> int:
        """Every byte may cause something."""
        return 0

    def receive(self, chunk: Chunk) -> list[Effect]:
        """Answer the last byte."""
        now = chunk.arrival_ns(len(chunk.data) - 1)
        if not self.powered:
            return []
        effects: list[Effect] = []
        reply = b""
        match chunk.data[-1:]:
            case b"W":
                self.stored["writes"] += 1
                effects.append(Store((("writes", self.stored["writes"]),)))
                reply = b"K"
            case b"P":
                reply = self.position_at(now).to_bytes(4, "big", signed=True)
            case b"G":
                self._moving_since = now
            case b"S":
                self._stop(now)
            case b"T":
                effects.append(ToyTrace(now, "told"))
                reply = b"t"
        return [*effects, Transmit(now + LATENCY_NS, reply)] if reply else effects

    def next_event(self) -> Nanos | None:
        """It never wakes by itself."""
        return None

    def wake(self, now: Nanos) -> list[Effect]:
        """Nothing is ever due."""
        return []

    def power_off(self, now: Nanos) -> list[Effect]:
        """The axis stops where it is; its position is saved."""
        self._stop(now)
        self.powered = False
        self.done.append((now, "power", False))
        return [Store((("position", self.stored["position"]),), durable=False)]

    def power_on(self, now: Nanos) -> list[Effect]:
        """It listens at once."""
        self.powered = True
        self.done.append((now, "power", True))
        return []

    def cells(self, now: Nanos) -> Mapping[str, int]:
        """All cells."""
        return {**self.stored, "position": self.position_at(now)}

    def is_moving(self, now: Nanos) -> bool:
        """Between G and S."""
        return self._moving_since is not None

    def input_at(self, now: Nanos, name: str) -> bool:
        """As it was set."""
        return self.inputs[name]

    def load_at(self, now: Nanos) -> Load:
        """As it was set."""
        return self.load

    def set_input(self, now: Nanos, name: str, active: bool) -> list[Effect]:
        """Note it."""
        if name not in self.inputs:
            raise UsageError(f"unknown input {name}")
        self.inputs[name] = active
        self.done.append((now, name, active))
        return []

    def set_supply(self, now: Nanos, millivolts: int) -> list[Effect]:
        """Note it."""
        self.supply_millivolts = millivolts
        self.done.append((now, "supply", millivolts))
        return []

    def set_temperature(self, now: Nanos, millidegrees: int) -> list[Effect]:
        """Note it; a toy stores and tells that it was heated."""
        self.temperature_millidegrees = millidegrees
        self.done.append((now, "temperature", millidegrees))
        self.stored["writes"] += 1
        return [Store((("writes", self.stored["writes"]),)), ToyTrace(now, "hot")]

    def set_load(self, now: Nanos, load: Load) -> list[Effect]:
        """Note it."""
        self.load = load
        self.done.append((now, "load", load))
        return []

    def set_fault(self, now: Nanos, name: str, present: bool) -> list[Effect]:
        """Note it."""
        self.done.append((now, f"fault {name}", present))
        return []

    def push(self, now: Nanos, increments: int) -> list[Effect]:
        """Move the position."""
        self.stored["position"] += increments
        return []

    def position_at(self, now: Nanos) -> int:
        """One increment per ms while it moves."""
        moved = 0 if self._moving_since is None else (now - self._moving_since) // NS_PER_MS
        return self.stored["position"] + moved

    def describe(self, now: Nanos) -> ToySnapshot:
        """State, address and position."""
        state = "moving" if self.is_moving(now) else "at rest"
        return ToySnapshot(
            state, self.stored["address"], self.supply_millivolts, self.temperature_millidegrees
        )

    def _stop(self, now: Nanos) -> None:
        self.stored["position"] = self.position_at(now)
        self._moving_since = None
