"""A small controller behind the link of the built-in twin: a data area of bytes, flags by kind, the
bench program in its scans, and the hands of a rig.  Faulty ones override a line or two."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

from msc_twin import TwinPort, session_on

from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.verdicts import Finding
from axistwin_conformance.core.session import Session, Stop
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import Packet
from axistwin_conformance.families.msc.family import FAMILY
from axistwin_conformance.families.msc.options import TWIN_SCRATCH
from axistwin_conformance.families.msc.rig_controls import MSC_CONTROLS
from axistwin_conformance.transport.rig import Act, Rig

SCAN_NS = 10_000_000
AREA = 32768
FLAG, VARIABLES = TWIN_SCRATCH.program or (0, 0)
COUNT, PULSE, HALT, TIMED = range(FLAG, FLAG + 4)
COUNTER, TICKS, PULSES, TORN = range(VARIABLES, VARIABLES + 16, 4)
BLOCK, BLOCK_LAST = VARIABLES + 128, VARIABLES + 128 + 31 * 4
TIMER, TIMER_NS = 32, 250_000_000
USER = (*range(16, 32), *range(128, 256))
RUNNING, LOW, LOST, AUTO = 1, 2, 4, 64


class Controller(TwinPort):
    """The link of the twin, and behind it all that the checks of data, flags, status, program and
    rig ask for."""

    def __init__(self, *, has_rflags: bool = True) -> None:
        super().__init__(has_rflags=has_rflags)
        self.area = bytearray(AREA)
        self.on: set[int] = set()  # user flags and outputs
        self.machine: set[int] = set()  # what its inputs, timers and motors have on
        self.status = RUNNING
        self.is_powered = True
        self.is_flat = False
        self._scanned = 0  # scans that have been
        self._was_on = False
        self._timer_ends_ns = 0
        self.notes: Counter[str] = Counter()  # what faulty ones keep
        self.served = self._scan_and_serve
        self.receiver.receive = partial(self._receive, self.receiver.receive)

    @property
    def clock_ns(self) -> int:
        """Now, as the unit knows it."""
        return max(self._now, self.virtual_time_ns)

    # --- packets ----------------------------------------------------------------------------------

    def _receive(self, receive: Callable[[Any], None], chunk: Any) -> None:
        if self.is_powered:
            receive(chunk)

    def _scan_and_serve(self, one: Packet) -> bytes | None:
        self.scan()
        return self.serve(one)

    def serve(self, one: Packet) -> bytes | None:
        """What is behind the comma of the reply; empty: there is none; None: refused."""
        if not one.is_request or (one.name == "RFLAGS" and not self.has_rflags):
            return self.unknown(one)
        act: Callable[[Packet], bytes | None] = getattr(self, one.name.lower())
        return act(one)

    def unknown(self, one: Packet) -> bytes | None:
        """What draws a body that is none of the nine, or of another size."""
        return None

    # --- data -------------------------------------------------------------------------------------

    def get(self, address: int, count: int) -> bytes | None:
        """Bytes of the area; None where it ends."""
        return bytes(self.area[address : address + count]) if address + count <= AREA else None

    def put(self, address: int, data: bytes) -> bytes | None:
        """Store bytes, all or none."""
        if address + len(data) > AREA:
            return None
        self.area[address : address + len(data)] = data
        return b""

    def dread(self, one: Packet) -> bytes | None:
        """DREAD."""
        return self.get(one.numbers[0], 4)

    def bread(self, one: Packet) -> bytes | None:
        """BREAD."""
        return self.get(one.numbers[0], 128)

    def dwrite(self, one: Packet) -> bytes | None:
        """DWRITE."""
        return self.put(one.numbers[0], one.payload[2:])

    def bwrite(self, one: Packet) -> bytes | None:
        """BWRITE."""
        return self.put(one.numbers[0], one.payload[2:])

    def value(self, address: int) -> int:
        """A variable, for the program."""
        return int.from_bytes(self.area[address : address + 4], "big", signed=True)

    def add(self, address: int, more: int = 1) -> None:
        """Count a variable on."""
        self.area[address : address + 4] = codec.i32(self.value(address) + more)

    # --- flags and status -------------------------------------------------------------------------

    def states(self) -> frozenset[int]:
        """All flags that are on."""
        timer = {TIMER} if self.clock_ns < self._timer_ends_ns else set()
        return frozenset(self.on | self.machine | timer)

    def rflag(self, one: Packet) -> bytes | None:
        """RFLAG."""
        number = one.numbers[0]
        return None if number > 255 else codec.u16(number in self.states())

    def rflags(self, one: Packet) -> bytes | None:
        """RFLAGS."""
        on = self.states()
        return bytes(sum(1 << bit for bit in range(8) if 8 * k + bit in on) for k in range(32))

    def rqstat(self, one: Packet) -> bytes | None:
        """RQSTAT."""
        return codec.u16(self.status) + bytes(6)

    def sflag(self, one: Packet) -> bytes | None:
        """SFLAG."""
        return self.turn(one.numbers[0], on=True)

    def cflag(self, one: Packet) -> bytes | None:
        """CFLAG."""
        return self.turn(one.numbers[0], on=False)

    def turn(self, number: int, *, on: bool) -> bytes | None:
        """What the host makes of a flag."""
        if number > 255:
            return None
        if number in USER:
            (self.on.add if on else self.on.discard)(number)
        return b""

    # --- the program ------------------------------------------------------------------------------

    def scan(self) -> None:
        """Make up for the scans that have been since."""
        scans = self.clock_ns // SCAN_NS
        for number in range(self._scanned, scans) if self.status & RUNNING else ():
            self.pass_by(number * SCAN_NS)
            if not self.status & RUNNING:
                break
        self._scanned = scans

    def pass_by(self, now_ns: int) -> None:
        """One scan."""
        self.add(TICKS)
        self.add(TORN, int(self.value(BLOCK) != self.value(BLOCK_LAST)))
        if COUNT in self.on:
            self.on.discard(COUNT)
            self.counted()
        self.add(PULSES, int(PULSE in self.on and not self._was_on))
        self._was_on = PULSE in self.on
        if TIMED in self.on:
            self.on.discard(TIMED)
            self._timer_ends_ns = now_ns + TIMER_NS
        if HALT in self.on:
            self.on.discard(HALT)
            self.run_program(False)

    def counted(self) -> None:
        """The program has found `count` on."""
        self.add(COUNTER)

    # --- the rig ----------------------------------------------------------------------------------

    def run_program(self, running: bool) -> None:
        """Start or stop it."""
        self.status = self.status & ~RUNNING | RUNNING * running

    def set_status(self, bit: int, on: bool) -> None:
        """A condition comes or goes."""
        self.status = self.status & ~(1 << bit) | on << bit

    def set_battery(self, flat: bool) -> None:
        """The battery is empty, or good."""
        self.is_flat = flat
        self.set_status(1, flat)

    def power(self, on: bool) -> None:
        """The supply."""
        self.is_powered = on
        self.receiver.reset()
        if not on:
            return
        self.on.clear()
        if self.is_flat:
            self.area[:] = bytes(AREA)
            self.status |= LOST
        self.run_program(bool(self.status & AUTO))

    def work(self, number: int, on: bool) -> None:
        """The machine turns a flag."""
        (self.machine.add if on else self.machine.discard)(number)


class PortRig(Rig):
    """Works that controller."""

    def __init__(self, session: Session, port: Controller, lacks: frozenset[str]) -> None:
        super().__init__(session.target, MSC_CONTROLS)
        self.capabilities -= lacks
        self._port = port

    def _work(self, act: Act) -> None:
        port, value = self._port, bool(act.value)
        port.scan()
        match act.control.capability:
            case "flag":
                port.work(act.number or 0, value)
            case "status":
                port.set_status(act.number or 0, value)
            case "program":
                port.run_program(value)
            case "battery":
                port.set_battery(value)
            case "power":
                port.power(value)


def judge(
    name: str, port: Controller, *, is_twin: bool = True, is_builtin: bool = False,
    lacks: frozenset[str] = frozenset(), readings: dict[str, str] | None = None, **how: Any,
) -> tuple[Finding, ...]:  # fmt: skip
    """Run one check on that controller, as the engine would."""
    check = next(one for one in FAMILY.checks() if one.name == name)
    session = session_on(port, check, allowed=frozenset(SAFETY_CLASSES), **how)
    session.run.readings.update(readings or {})
    session.run.rig = PortRig(session, port, lacks)
    session.target.is_builtin = is_builtin
    if is_twin:
        session.target.description = "axistwin://a-small-one?time=virtual"

    def gate(data: bytes) -> None:
        reason = FAMILY.forbid(session, data)
        assert reason is None, f"{name} sends what its class does not allow: {reason}"

    session.target.gate = gate
    with contextlib.suppress(Stop):
        check(session)
    return session.conclude("")


Turn = Callable[..., Any]


def twisted(**methods: Turn) -> Callable[[], Controller]:
    """What makes a controller with these methods instead of the sound ones."""
    return type("Twisted", (Controller,), methods)


def answers(name: str, turn: Callable[[bytes], bytes | None]) -> Callable[[], Controller]:
    """One whose answer to a command, where there is one, becomes something else."""

    def serve(self: Controller, one: Packet) -> bytes | None:
        served = Controller.serve(self, one)
        return served if served is None or one.name != name else turn(served)

    return twisted(serve=serve)


def refuses(name: str, when: Callable[[Packet], bool] = lambda one: True) -> Turn:
    """One that refuses a command, or some of its packets."""

    def serve(self: Controller, one: Packet) -> bytes | None:
        return None if one.name == name and when(one) else Controller.serve(self, one)

    return twisted(serve=serve)
