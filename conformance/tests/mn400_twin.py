"""The MN400 twin behind its URL, in virtual time, for checks; a fault is planted between it and the
suite: it hears another request than was sent, or says another packet than it would."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import Any

from mn400_board import LEDGER

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.errors import CannotDo, OutsideEnvelope
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.core.readings import Readings
from axistwin_conformance.core.session import Envelope, Run, Session, Stop
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.family import Mn400
from axistwin_conformance.transport.rig import TwinRig
from axistwin_conformance.transport.serial import SerialTransport, open_target

URL = "axistwin://mn400?time=virtual"
HALF_TURN = 1 << 31  # of a counter
EVERYTHING = frozenset({"passive", "motion", "stored", "rig", "destructive"})
Hears = Callable[[str], str]
Says = Callable[[bytes], bytes]


class AlteredTwin:
    """A pyserial port with a twin behind it that hears and says other things."""

    def __init__(
        self,
        hears: Hears | None = None,
        says: Says | None = None,
        *,
        ignores_sums: bool = False,
        quirks: Mapping[str, str] | None = None,
    ) -> None:
        url = URL + "".join(f"&quirk.{name}={value}" for name, value in (quirks or {}).items())
        self.inner = open_target(url, 9600)._port
        self.hears, self.says, self.ignores_sums = hears, says, ignores_sums
        self.sent: list[str] = []
        self._ready, self._partial = b"", b""

    @property
    def twins(self) -> Any:
        """The twin's own handle."""
        return self.inner.twins  # type: ignore[attr-defined]

    @property
    def virtual_time_ns(self) -> int:
        """The clock of its line."""
        return int(self.inner.virtual_time_ns)  # type: ignore[attr-defined]

    @property
    def baudrate(self) -> int:
        """The rate of the line."""
        return self.inner.baudrate

    @baudrate.setter
    def baudrate(self, rate: int) -> None:
        self.inner.baudrate = rate

    @property
    def timeout(self) -> float | None:
        """Of the next read."""
        return self.inner.timeout

    @timeout.setter
    def timeout(self, seconds: float | None) -> None:
        self.inner.timeout = seconds

    @property
    def in_waiting(self) -> int:
        """What can be read at once."""
        return len(self._ready) + self.inner.in_waiting

    def write(self, data: bytes) -> int:
        """Send what the twin is to hear instead."""
        packet = codec.parse(data)
        if packet is not None and (packet.is_sound or self.ignores_sums):
            self.sent.append(packet.text)
            heard = packet.text if self.hears is None else self.hears(packet.text)
            data = codec.request(packet.board, heard)
        self.inner.write(data)
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """Packet by packet, as they are said instead; byte by byte where nothing is altered."""
        if self.says is None:
            return self.inner.read(size)
        until_ns = self.virtual_time_ns + round((self.timeout or 0) * 1e9)
        while not self._ready:
            byte = self.inner.read(1)
            if not byte:
                return b""
            self._partial += byte
            if size_of := codec.packet_end(self._partial):
                raw, self._partial = self._partial[:size_of], self._partial[size_of:]
                self._ready = self.says(raw)
            elif self.virtual_time_ns >= until_ns:
                return b""
        taken, self._ready = self._ready[:size], self._ready[size:]
        return taken

    def close(self) -> None:
        """Close the twin's port."""
        self.inner.close()


class ShaftWatch(AlteredTwin):
    """The same, and how far each axis has been from where it was found: `lowest`, `highest`,
    `place` (steps).  The counters tell, and where one was loaded the steps that were made."""

    def __init__(self, hears: Hears | None = None) -> None:
        super().__init__(hears)
        self.place, self.lowest, self.highest = [0] * 4, [0] * 4, [0] * 4
        self._counters, self._pulses, self._is_loading = [0] * 4, [0] * 4, False
        self._has_power = True

    def write(self, data: bytes) -> int:
        """Look before anything can be carried out."""
        self._look()
        written = super().write(data)
        letter = self.sent[-1][:1].upper() if self.sent else ""
        self._is_loading = letter == "L" or (self._is_loading and letter not in "MA+T}K")
        return written

    def read(self, size: int = 1) -> bytes:
        """Look whenever time has passed."""
        received = super().read(size)
        self._look()
        return received

    def _look(self) -> None:
        controls = self.twins[0].controls
        counters, pulses = controls["counters"].value, controls["step_pulses"].value
        for axis in range(4):
            made = pulses[axis] - self._pulses[axis]
            moved = (counters[axis] - self._counters[axis] + HALF_TURN) % (
                2 * HALF_TURN
            ) - HALF_TURN
            if made < 0 or not self._has_power:  # switched off: all counts begin anew
                moved = 0
            elif self._is_loading:  # the counter may have been loaded meanwhile
                is_low = not controls[f"directions.{axis + 1}"].value
                moved = made if is_low else -made
            self.place[axis] += moved
        self.lowest = list(map(min, self.lowest, self.place))
        self.highest = list(map(max, self.highest, self.place))
        self._counters, self._pulses = list(counters), list(pulses)
        self._has_power = controls["power"].value


def session_of(port: Any, checked: Check | None = None, **changes: Any) -> Session:
    """A session with a twin behind a port; `changes`: fields of the run."""
    family = Mn400()
    target = changes.pop("target", None) or SerialTransport(port, URL)
    fields: dict[str, Any] = {
        "target": target,
        "family": family,
        "model": family.models["mn400"],
        "ledger": LEDGER,
        "address": 1,
        "neighbours": (),
        "allowed": EVERYTHING,
        "envelope": Envelope(1_000_000, 1_000_000, is_guarded=False),
        "seed": 0,
        "rig": TwinRig(target, 1, family.rig_controls),
    }
    changes["readings"] = Readings(changes.get("readings"))
    run = Run(**(fields | changes))
    if run.envelope.is_guarded:
        target.travel_guard = family.travel_guard(run)
    session = Session(run, checked)
    session.transport.gate = lambda data: _refused(family, session, data)
    if run.memory is None:
        run.memory = family.remember(session)
    return session


def _refused(family: Mn400, session: Session, data: bytes) -> None:
    reason = family.forbid(session, data)
    assert reason is None, reason


def judged(check: Check, port: Any = None, **changes: Any) -> tuple[Finding, ...]:
    """What a check finds of a twin; what is held back or cannot be worked is not run."""
    session = session_of(AlteredTwin() if port is None else port, check, **changes)
    trouble = ""
    try:
        with contextlib.suppress(Stop):
            check(session)
    except (OutsideEnvelope, CannotDo) as error:
        trouble = str(error)
    return session.conclude(trouble, Verdict.NOT_RUN)


def failures(check: Check, port: Any = None, **changes: Any) -> dict[str, str]:
    """What fails, by requirement: what was expected and what came."""
    return {
        one.requirement: f"{one.expected}: {one.actual} {one.text}"
        for one in judged(check, port, **changes)
        if one.verdict is Verdict.FAIL
    }
