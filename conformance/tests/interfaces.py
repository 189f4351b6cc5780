"""Interfaces that people really have, in front of a twin, in exact time.

The suite takes an `InterfacePort` for a real port: it tells no virtual time, so that everything for
real devices is used.  The clock that the suite then looks at is replaced (`real_time_of`) by that
of the twin, and hours of a bench take seconds; the same seed is the same run, byte for byte.

    suite ──write─> [stall] ──> on the way out ──> twin ──> on the way in ──> [stall] ─read──> suite
                       │ local echo                                              ^
                       └─────────────────────────────────────────────────────────┘
"""

from __future__ import annotations

import contextlib
import random
import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import pytest
import serial
from small_scratch import VARIABLES

from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mac.axis.options import AxisSettings
from axistwin_conformance.transport import serial as serial_transport
from axistwin_conformance.transport import transport
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport

MS = 1_000_000
BYTE_BITS = 10
BAUD = 38400
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


class InterfacePort:
    """A pyserial port as the interface makes it, on a twin's line in virtual time."""

    def __init__(self, line: Any, interface: Interface, seed: int) -> None:
        self.line, self.interface = line, interface
        self.timeout: float | None = 0.0
        self.random = random.Random(seed)
        self._out: deque[tuple[int, bytes]] = deque()  # from when on on the line, bytes
        self._in: deque[tuple[int, int]] = deque()  # from when on in the host's hands, byte
        self._phase_ns = self.random.randrange(interface.lump_ns) if interface.lump_ns else 0
        self._held: list[int] = []  # by the adapter, until the lump is full or its time is over
        self._due_ns = 0
        self._sent_until_ns = 0
        self._origin_ns = self.now_ns
        self.is_rebooted = False
        if interface.glitch:
            self.line.write(interface.glitch)
            self._in.extend((self.now_ns, byte) for byte in interface.glitch)

    # --- the clock --------------------------------------------------------------------------------

    @property
    def now_ns(self) -> int:
        """The clock of this world."""
        return int(self.line.virtual_time_ns)

    def sleep(self, seconds: float) -> None:
        """Let time pass for everybody."""
        self._pass(round(seconds * 1e9))
        self._stall()

    def _stall(self) -> None:
        every = self.interface.stall_every
        if every and not self.random.randrange(every):
            self._pass(self.random.randrange(*self.interface.stall_ns))

    def _pass(self, duration_ns: int) -> None:
        """Let time pass; what is on its way either way goes on."""
        until_ns = self.now_ns + duration_ns
        while True:
            self._reboot_if_due()
            now_ns = self.now_ns
            while self._out and self._out[0][0] <= now_ns:
                self.line.write(self._out.popleft()[1])
            if self._held and self._due_ns <= now_ns:
                self._hand_on()
            if now_ns >= until_ns:
                return
            steps = [until_ns]
            steps += [self._out[0][0]] if self._out else []
            steps += [self._due_ns] if self._held else []
            self.line.timeout = max(1, min(steps) - now_ns) / 1e9
            data = self.line.read(1)
            if data:
                self._from_line(data + self.line.read(self.line.in_waiting))

    def _reboot_if_due(self) -> None:
        due_ns = self.interface.reboot_ns
        if due_ns and not self.is_rebooted and self.now_ns - self._origin_ns >= due_ns:
            self.is_rebooted = True
            for twin in self.line.twins:
                twin.power_cycle()

    # --- from the line to the host ----------------------------------------------------------------

    def _from_line(self, data: bytes) -> None:
        for byte in data:
            if not self._is_dropped():
                self._collect(byte)

    def _collect(self, byte: int) -> None:
        lump_ns = self.interface.lump_ns
        if not lump_ns:
            self._towards_host(byte)
            return
        if not self._held:
            past_ns = (self.now_ns - self._phase_ns) % lump_ns
            self._due_ns = self.now_ns + lump_ns - past_ns
        self._held.append(byte)
        if len(self._held) >= self.interface.lump_bytes:
            self._hand_on()

    def _hand_on(self) -> None:
        held, self._held = self._held, []
        for byte in held:
            self._towards_host(byte)

    def _towards_host(self, byte: int) -> None:
        ready_ns = self.now_ns + self._way_ns()
        before_ns = self._in[-1][0] if self._in else 0
        self._in.append((max(ready_ns, before_ns), byte))

    def _way_ns(self) -> int:
        first, last = self.interface.way_ns
        return self.random.randrange(first, last) if last else 0

    def _is_dropped(self) -> bool:
        every = self.interface.drop_every
        return bool(every) and not self.random.randrange(every)

    # --- what pyserial has ------------------------------------------------------------------------

    @property
    def baudrate(self) -> int:
        """The rate of our end of the line."""
        return int(self.line.baudrate)

    @baudrate.setter
    def baudrate(self, rate: int) -> None:
        self.line.baudrate = rate

    def write(self, data: bytes) -> int:
        """Hand the bytes to the driver; it returns before they are on the line."""
        self._stall()
        left = bytes(byte for byte in data if not self._is_dropped())
        before_ns = self._out[-1][0] if self._out else 0
        ready_ns = max(self.now_ns + self._way_ns(), before_ns)
        self._out.append((ready_ns, left))
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
        self._pass(0)
        deadline_ns = self.now_ns + round((self.timeout or 0) * 1e9)
        while self._ready() < size and self.now_ns < deadline_ns:
            left_ns = deadline_ns - self.now_ns
            if self._in and self._in[0][0] > self.now_ns:
                left_ns = min(left_ns, self._in[0][0] - self.now_ns)
            elif len(self._in) > self._ready():
                left_ns = min(left_ns, self._in[self._ready()][0] - self.now_ns)
            else:
                left_ns = min(left_ns, MS)
            self._pass(max(1, left_ns))
        self._stall()
        count = min(size, self._ready())
        return bytes(self._in.popleft()[1] for _ in range(count))

    def _ready(self) -> int:
        count = 0
        for ready_ns, _ in self._in:
            if ready_ns > self.now_ns:
                break
            count += 1
        return count

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        self._pass(LOOK_NS)
        return self._ready()

    def close(self) -> None:
        """Give it back."""
        self.line.close()


class WorldTime:
    """Stands for the module `time` where the suite looks at a real line."""

    def __init__(self) -> None:
        self.port: InterfacePort | None = None

    def monotonic_ns(self) -> int:
        """The clock of the world behind the port."""
        return 0 if self.port is None else self.port.now_ns

    def sleep(self, seconds: float) -> None:
        """Let time pass there."""
        assert self.port is not None, "nobody waits before a port is open"
        self.port.sleep(seconds)

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name)


@contextlib.contextmanager
def real_time_of() -> Iterator[WorldTime]:
    """What the suite takes for the machine's clock is the world's."""
    world = WorldTime()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(transport, "time", world)
        patch.setattr(serial_transport, "time", world)
        yield world


@dataclass(frozen=True, slots=True)
class InterfaceRun:
    """What came of a run behind an interface."""

    result: Result
    port: InterfacePort
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
    seed: int = 0,
    rate: int | None = None,
    query: str = "",
    detects: bool = False,
) -> InterfaceRun:
    """Judge a twin behind an interface, as a real device.

    `rate`: what is stored in the module and set at our end; `query`: more of the twin's URL;
    `detects`: also without a level, then nothing but its readings are asked for.
    """
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    given: dict[str, Any] = {}
    if model.startswith("msc"):
        given = {
            "variables": VARIABLES, "flags": range(128, 192), "bench_program": (240, 6144)
        }  # fmt: skip
    options = make_options(
        model=model, ids=words, level=level, seed=seed, port=interface.url, baud=rate,
        is_detection=detects,
        allow="motion,stored" if given else "motion,stored,destructive", **given,
    )  # fmt: skip
    if isinstance(settings := options.settings, AxisSettings):
        settings = replace(settings, envelope=replace(settings.envelope, max_travel=20_000))
        options = replace(options, settings=settings)
    url = options.family.twin_url(options.model, options.address, ())
    url += query + (f"&baud={rate}" if rate else "")
    ports: list[InterfacePort] = []
    with real_time_of() as world:

        def opener(neighbours: tuple[int, ...]) -> SerialTransport:
            line = serial.serial_for_url(url, baudrate=options.rate or BAUD)
            ports.append(InterfacePort(line, interface, seed))
            world.port = ports[-1]
            return SerialTransport(ports[-1], interface.url)

        result = Engine(options, opener).run(lambda event: None)
        seconds = sum(port.now_ns for port in ports) / 1e9
    return InterfaceRun(result, ports[-1], seconds)
