"""Interfaces that people really have, in front of a twin, in exact time.

The suite takes an `InterfacePort` for a real port, an `InterfaceBus` for a real bus: they tell no
virtual time, so that everything for real devices is used.  The clock that the suite then looks at
is replaced (`real_time_of`) by that of the twin, and hours of a bench take seconds; the same seed
is the same run, byte for byte.

    suite ──write─> [stall] ──> on the way out ──> twin ──> on the way in ──> [stall] ─read──> suite
                       │ local echo                                              ^
                       └─────────────────────────────────────────────────────────┘
"""

from __future__ import annotations

import contextlib
import random
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import can
import pytest
import serial
from small_scratch import small_scratch

from axistwin_conformance.base.events import Listener, RunFinished
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.plan import Options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.family import TWIN_BITRATE
from axistwin_conformance.transport import can as can_transport
from axistwin_conformance.transport import serial as serial_transport
from axistwin_conformance.transport import transport
from axistwin_conformance.transport.can import CanTransport, split_words
from axistwin_conformance.transport.kinds import BUS
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport
from axistwin_conformance.transport.transport import Transport

Item = TypeVar("Item")
MS = 1_000_000
BYTE_BITS = 10
BAUD = 38400
UPTIME_NS = 5 * 86_400 * 10**9  # a real clock counts from when the machine was switched on
LOOK_NS = 20_000  # what a look at the port or the clock of a real machine takes


@dataclass(frozen=True, slots=True)
class Interface:
    """What lies between a host and a line.  Times in ns; 0: not there.

    `lump_ns`, `lump_bytes`: what is received is handed on once per so long, or when there are so
    many bytes; `way_ns`: how long either way takes, from..to; `stall_every`, `stall_ns`: about one
    call in so many is held up for so long; `echoes`: what is sent comes back; `glitch`: received,
    and heard by the device, when the port is opened; `drop_every`: one byte in so many is lost.
    `reboot_ns`: when the device loses its supply for a moment.
    """

    name: str = "a plain port"
    lump_ns: int = 0
    lump_bytes: int = 62
    way_ns: tuple[int, int] = (0, 0)
    stall_every: int = 0
    stall_ns: tuple[int, int] = (100 * MS, 300 * MS)
    echoes: bool = False
    glitch: bytes = b""
    drop_every: int = 0
    reboot_ns: int = 0
    url: str = "/dev/ttyUSB0"

    def __str__(self) -> str:
        return self.name


PLAIN = Interface()
LATENCY_TIMER = Interface("USB, latency timer 16 ms", lump_ns=16 * MS)
LOW_LATENCY = Interface("USB, latency timer 1 ms", lump_ns=MS)
TERMINAL_SERVER = Interface(
    "terminal server", way_ns=(5 * MS, 40 * MS), url="socket://10.0.0.7:4001"
)
FAR_AWAY = Interface("far away", way_ns=(100 * MS, 150 * MS), url="socket://10.9.0.7:4001")
LOADED_HOST = Interface("loaded host", stall_every=150)
BUSY_HOST = Interface("very busy host", stall_every=15)
ECHOING = Interface("RS-485 with local echo", echoes=True)
GLITCH = Interface("glitch at opening", glitch=b"\x00\xff\xfe")
DROPPING = Interface("drops a byte in 2000", drop_every=2000)
REBOOTING = Interface("reboots once", reboot_ns=15_000 * MS)
WORST = Interface("USB on a loaded host", lump_ns=16 * MS, stall_every=150)
ALL = (
    PLAIN, LOW_LATENCY, LATENCY_TIMER, TERMINAL_SERVER, FAR_AWAY, LOADED_HOST, BUSY_HOST, ECHOING,
    GLITCH, DROPPING, REBOOTING, WORST,
)  # fmt: skip


class Way(Generic[Item]):
    """What an interface makes of what is on its way, either way, in exact time.

    `source`: the twins' line or bus, in virtual time.  Items are bytes, or frames.
    """

    def __init__(self, source: Any, interface: Interface, seed: int) -> None:
        self.source, self.interface = source, interface
        self.random = random.Random(seed)
        self._out: deque[tuple[int, Any]] = deque()  # from when on on the line, what is sent
        self._in: deque[tuple[int, Item]] = deque()  # from when on in the host's hands, item
        self._phase_ns = self.random.randrange(interface.lump_ns) if interface.lump_ns else 0
        self._held: list[Item] = []  # by the adapter, until the lump is full or its time is over
        self._due_ns = 0
        self._begun_ns = self._ended_ns = self.now_ns
        self.is_rebooted = False
        # What comes is at once in the host's hands: it need not be looked at one by one.
        self._is_prompt = not (interface.lump_ns or interface.way_ns[1] or interface.echoes)
        self.found = self.left = self.stored()
        self.is_left_moving = False

    # What a kind of carrier adds.

    def _put(self, sent: Any) -> None:
        """Put what was sent on the line."""
        raise NotImplementedError

    def _take(self, seconds: float, count: int) -> Iterable[Item]:
        """Let time pass on the line until so many have come, no longer than that; give them."""
        raise NotImplementedError

    def stored(self) -> list[dict[str, Any]]:
        """What each twin keeps without supply; a counter is no parameter."""
        return [
            {name: cell for name, cell in twin.cells.items() if name != "position"}
            for twin in self.source.twins
        ]

    def _part(self) -> None:
        """Look back before the line is closed."""
        self.left, self._ended_ns = self.stored(), self.now_ns
        self.is_left_moving = any(twin.is_moving for twin in self.source.twins)

    @property
    def is_put_back(self) -> bool:
        """True if the twins keep at the end what they kept before."""
        return self.left == self.found

    @property
    def seconds(self) -> float:
        """How long it was open."""
        return (self._ended_ns - self._begun_ns) / 1e9

    # The clock.

    @property
    def now_ns(self) -> int:
        """The clock of this world."""
        return int(self.source.virtual_time_ns)

    def sleep(self, seconds: float) -> None:
        """Let time pass for everybody."""
        self._pass(round(seconds * 1e9))
        self._stall()

    def _stall(self) -> None:
        every = self.interface.stall_every
        if every and not self.random.randrange(every):
            self._pass(self.random.randrange(*self.interface.stall_ns))

    def _pass(self, duration_ns: int, wanted: int = 0) -> None:
        """Let time pass, no longer than until so many items are there, if any are `wanted`; what
        is on its way either way goes on."""
        until_ns = self.now_ns + duration_ns
        while True:
            self._reboot_if_due()
            now_ns = self.now_ns
            while self._out and self._out[0][0] <= now_ns:
                self._put(self._out.popleft()[1])
            if self._held and self._due_ns <= now_ns:
                self._hand_on()
            if now_ns >= until_ns or (wanted and self._ready() >= wanted):
                return
            steps = [until_ns]
            steps += [self._out[0][0]] if self._out else []
            steps += [self._due_ns] if self._held else []
            if wanted and len(self._in) >= wanted:
                steps.append(self._in[wanted - 1][0])
            missing = wanted - len(self._in) if self._is_prompt else 1
            for item in self._take(max(1, min(steps) - now_ns) / 1e9, max(1, missing)):
                if not self._is_dropped():
                    self._collect(item)

    def _reboot_if_due(self) -> None:
        due_ns = self.interface.reboot_ns
        if due_ns and not self.is_rebooted and self.now_ns - self._begun_ns >= due_ns:
            self.is_rebooted = True
            for twin in self.source.twins:
                twin.power_cycle()

    # From the line to the host, and back.

    def _collect(self, item: Item) -> None:
        lump_ns = self.interface.lump_ns
        if not lump_ns:
            self._towards_host(item)
            return
        if not self._held:
            past_ns = (self.now_ns - self._phase_ns) % lump_ns
            self._due_ns = self.now_ns + lump_ns - past_ns
        self._held.append(item)
        if len(self._held) >= self.interface.lump_bytes:
            self._hand_on()

    def _hand_on(self) -> None:
        held, self._held = self._held, []
        for item in held:
            self._towards_host(item)

    def _towards_host(self, item: Item) -> None:
        ready_ns = self.now_ns + self._way_ns()
        before_ns = self._in[-1][0] if self._in else 0
        self._in.append((max(ready_ns, before_ns), item))

    def _send(self, sent: Any) -> None:
        """Hand it to the driver, which returns before it is on the line."""
        before_ns = self._out[-1][0] if self._out else 0
        self._out.append((max(self.now_ns + self._way_ns(), before_ns), sent))

    def _way_ns(self) -> int:
        first, last = self.interface.way_ns
        return self.random.randrange(first, last) if last else 0

    def _is_dropped(self) -> bool:
        every = self.interface.drop_every
        return bool(every) and not self.random.randrange(every)

    def _ready(self) -> int:
        count = 0
        for ready_ns, _ in self._in:
            if ready_ns > self.now_ns:
                break
            count += 1
        return count

    def _await(self, wanted: int, timeout_s: float) -> list[Item]:
        """Up to so many items, fewer when the time-out passes first."""
        self._pass(0)
        if self._ready() < wanted:
            self._pass(round(timeout_s * 1e9), wanted)
        self._stall()
        return [self._in.popleft()[1] for _ in range(min(wanted, self._ready()))]


class InterfacePort(Way[int]):
    """A pyserial port as the interface makes it."""

    def __init__(self, source: Any, interface: Interface, seed: int) -> None:
        super().__init__(source, interface, seed)
        self.timeout: float | None = 0.0
        self._sent_until_ns = 0
        if interface.glitch:
            self.source.write(interface.glitch)
            self._in.extend((self.now_ns, byte) for byte in interface.glitch)

    def _put(self, sent: bytes) -> None:
        self.source.write(sent)

    def _take(self, seconds: float, count: int) -> bytes:
        self.source.timeout = seconds
        data = bytes(self.source.read(count))
        return data and data + bytes(self.source.read(self.source.in_waiting))

    @property
    def baudrate(self) -> int:
        """The rate of our end of the line."""
        return int(self.source.baudrate)

    @baudrate.setter
    def baudrate(self, rate: int) -> None:
        self.source.baudrate = rate

    def write(self, data: bytes) -> int:
        """Send what is not dropped of the bytes."""
        self._stall()
        left = bytes(byte for byte in data if not self._is_dropped())
        self._send(left)
        if self.interface.echoes:
            byte_ns = BYTE_BITS * 1_000_000_000 // self.baudrate
            begun_ns = max(self.now_ns, self._sent_until_ns)
            for number, byte in enumerate(left, 1):
                self._in.append((begun_ns + number * byte_ns, byte))
            self._sent_until_ns = begun_ns + len(left) * byte_ns
        self._pass(LOOK_NS)
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """Up to so many bytes, fewer when the time-out passes first."""
        return bytes(self._await(size, self.timeout or 0))

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        self._pass(LOOK_NS)
        return self._ready()

    def close(self) -> None:
        """Give it back."""
        self._part()
        self.source.close()


class InterfaceBus(Way[can.Message]):
    """A python-can bus as the interface makes it."""

    def _put(self, sent: can.Message) -> None:
        self.source.send(sent)

    def _take(self, seconds: float, count: int) -> list[can.Message]:
        message = self.source.recv(seconds)
        return [] if message is None else [message]

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hand the frame to the adapter, unless it is dropped."""
        self._stall()
        if not self._is_dropped():
            self._send(msg)
        self._pass(LOOK_NS)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, None when the time-out passes first."""
        self._pass(LOOK_NS)
        found = self._await(1, timeout or 0)
        return found[0] if found else None

    def shutdown(self) -> None:
        """Give it back."""
        self._part()
        self.source.shutdown()


class WorldTime:
    """Stands for the module `time` where the suite looks at a real line or bus."""

    def __init__(self) -> None:
        self.way: Way[Any] | None = None

    def monotonic_ns(self) -> int:
        """The clock of the world behind the port."""
        return UPTIME_NS + (0 if self.way is None else self.way.now_ns)

    def sleep(self, seconds: float) -> None:
        """Let time pass there."""
        assert self.way is not None, "nobody waits before a port is open"
        self.way.sleep(seconds)

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name)


@contextlib.contextmanager
def real_time_of() -> Iterator[WorldTime]:
    """What the suite takes for the machine's clock is the world's."""
    world = WorldTime()
    with pytest.MonkeyPatch.context() as patch:
        for module in (transport, serial_transport, can_transport):
            patch.setattr(module, "time", world)
        yield world


@dataclass(frozen=True, slots=True)
class InterfaceRun:
    """What came of a run behind an interface."""

    result: Result
    way: Way[Any]
    seconds: float  # that it would have taken on a bench

    @property
    def failed(self) -> list[str]:
        """What the device was said not to do, with what came."""
        return [
            f"{one.check.name}: {finding.requirement} expected {finding.expected}, got"
            f" {finding.actual}"
            for one in self.result.checks
            for finding in one.findings
            if finding.verdict is Verdict.FAIL
        ]

    @property
    def wrong_readings(self) -> dict[str, str]:
        """What a twin with all its defaults was taken to read otherwise."""
        ledger = load_ledger(self.result.options.family.name)
        return {
            switch: reading
            for switch, reading in self.result.readings.items()
            if reading != ledger.ambiguity_of(switch).default_of(switch)
        }

    @property
    def verdicts(self) -> Mapping[str, Verdict]:
        """What was said of each requirement."""
        return {one.requirement.id: one.verdict for one in self.result.requirements}

    @property
    def counts(self) -> Mapping[str, int]:
        """How many requirements got which verdict."""
        counts: dict[str, int] = {}
        for one in self.result.requirements:
            counts[one.verdict.value] = counts.get(one.verdict.value, 0) + 1
        return counts


def judged_behind(
    interface: Interface,
    *words: str,
    model: str = "mac23",
    level: str | None = "quick",
    rate: int | None = None,
    detects: bool = False,
    query: str = "",
    seed: int = 0,
    hear: Listener = lambda event: None,
    **given: Any,
) -> InterfaceRun:
    """Judge a twin behind an interface, as a real device, with all allowed that needs no rig.

    `rate`: what is stored in the module and set at our end; `detects`: also without a level, then
    nothing but its readings are asked for; `query`: more of the twin's URL.
    """
    asked: dict[str, Any] = {"allow": "motion,stored,destructive", "is_detection": detects, **given}
    if model.startswith("msc"):
        asked = {**asked, "allow": "motion,stored", **small_scratch(model), **given}
    elif "max_travel" not in asked:
        asked["max_travel"] = 20_000
    asked |= {"can": "socketcan:can0"} if model.endswith("-can") else {"port": interface.url}
    options = make_options(model=model, ids=words, level=level, seed=seed, baud=rate, **asked)
    url = options.family.twin_url(model, options.address, options.neighbours) + query
    rated = f"&baud={rate}" if rate else ""
    return judge_behind(interface, options, url + rated, seed, hear=hear)


def cost_behind(interface: Interface, *words: str, **given: Any) -> tuple[int, float, InterfaceRun]:
    """EEPROM writes and seconds that such a run costs on a bench; see `judged_behind`."""
    finished: list[RunFinished] = []

    def hear(event: object) -> None:
        if isinstance(event, RunFinished):
            finished.append(event)

    how = {"allow": "motion,stored", "level": "full", **given}
    run = judged_behind(interface, *words, hear=hear, **how)
    return finished[0].eeprom_writes, run.seconds, run


def real_options(*words: str, **given: Any) -> Options:
    """What is asked of a MAC23 on a real port that may move and be written to."""
    asked = {"level": "quick", "allow": "motion,stored", **given}
    return make_options(model="mac23", port=PLAIN.url, ids=words, **asked)


def judge_plainly(
    options: Options, query: str = "", before: Callable[[Any], Any] = lambda source: source
) -> Result:
    """Judge a twin made with these words in its URL behind a plain port."""
    url = options.family.twin_url(options.model, options.address, options.neighbours) + query
    return judge_behind(PLAIN, options, url, before=before).result


def judge_behind(
    interface: Interface,
    options: Options,
    url: str,
    seed: int = 0,
    before: Callable[[Any], Any] = lambda source: source,
    hear: Listener = lambda event: None,
) -> InterfaceRun:
    """Judge the twin of a URL behind an interface; `before`: what stands before its line or bus."""
    ways: list[Way[Any]] = []
    with real_time_of() as world:

        def opener(neighbours: tuple[int, ...]) -> Transport:
            source, make = _source_of(url, options)
            make_way = InterfaceBus if options.family.transport_kind is BUS else InterfacePort
            world.way = way = make_way(before(source), interface, seed)
            ways.append(way)
            return make(way)

        result = Engine(options, opener).run(hear)
    return InterfaceRun(result, ways[-1], sum(way.seconds for way in ways))


def _source_of(url: str, options: Options) -> tuple[Any, Callable[[Any], Transport]]:
    """The twins' end of their line or bus, and what makes a transport of an interface to it."""
    place = options.endpoint or url
    if options.family.transport_kind is BUS:
        interface, channel, words = split_words(url)
        bus: Any = can.Bus(channel, interface, ignore_config=True, bitrate=TWIN_BITRATE, **words)
        return bus, lambda way: CanTransport(
            way, place, is_spontaneous=codec.is_spontaneous, bitrate=TWIN_BITRATE
        )
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    line = serial.serial_for_url(url, baudrate=options.rate or BAUD)
    return line, lambda way: SerialTransport(way, place)
