"""A toy device with a protocol of single letters, and a family that judges it.

The frame is tested on it, without any real codec: `Q` asks (answer `q`), `M` starts a motion, `S`
stops it, `P` and a digit stores that digit, `R` reads it back.
"""

from __future__ import annotations

import sys
import time
import types
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import pytest
import serial
from family_variants import vary

from axistwin_conformance.base.check import Check, check
from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.errors import TargetError, WrongDevice
from axistwin_conformance.base.events import Event
from axistwin_conformance.base.transcript import Record
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.identity import Identity, Model
from axistwin_conformance.core.probing import Probe, Seen
from axistwin_conformance.core.session import Session
from axistwin_conformance.engine.device import device_guard
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine, Envelope, Options
from axistwin_conformance.families.mac.axis.options import OPTIONS, AxisSettings
from axistwin_conformance.families.mac.axis.rig_controls import AXIS_CONTROLS
from axistwin_conformance.report import json
from axistwin_conformance.transport.serial import SerialTransport, open_target
from axistwin_conformance.transport.transport import Transport


@pytest.fixture(autouse=True)
def own_state_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a run keeps of a device goes to no user's folder."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


STEP_NS = 1_000_000  # each exchange of the toy takes a millisecond


class ToyPort:
    """A pyserial port with the toy device behind it; silent, garbled or gone on request."""

    def __init__(self) -> None:
        self.timeout: float | None = 0.0
        self.baudrate = 9600
        self.is_open = True
        self.is_moving = False
        self.is_mute = False
        self.is_gone = False
        self.garbage = b""
        self.stored = "7"
        self.sent: list[str] = []
        self._answers = b""

    @property
    def in_waiting(self) -> int:
        """Bytes not yet read."""
        return len(self._answers)

    def write(self, data: bytes) -> int:
        """Take a request and prepare the answer."""
        if self.is_gone:
            raise serial.SerialException("device reports readiness but returned no data")
        text = data.decode()
        self.sent.append(text)
        if self.is_mute:
            return len(data)
        self.is_moving = {"M": True, "S": False}.get(text, self.is_moving)
        if text[0] == "P":
            self.stored = text[1]
        answer = self.stored if text == "R" else text[0].lower()
        self._answers += self.garbage or answer.encode()
        self.pass_time(STEP_NS)
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """Return what there is; without anything the time-out passes."""
        if self.is_gone:
            raise serial.SerialException("device reports readiness but returned no data")
        taken, self._answers = self._answers[:size], self._answers[size:]
        if not taken:
            self.pass_time(round((self.timeout or 0) * 1e9))
        return taken

    def close(self) -> None:
        """Close."""
        self.is_open = False

    def pass_time(self, duration_ns: int) -> None:
        """Real time passes by itself."""


class VirtualToyPort(ToyPort):
    """The same in virtual time."""

    virtual_time_ns = 0

    def pass_time(self, duration_ns: int) -> None:
        """Advance the clock."""
        self.virtual_time_ns += duration_ns


def ask(session: Session, text: str) -> str:
    """One exchange with the toy."""
    session.target.send(text.encode())
    return session.target.receive(1, 0.01).decode()


class ToyFamily(Family):
    """The toy among the families; its checks name requirements of a real ledger."""

    name = "mac_serial"
    models: ClassVar = {"toy": Model("toy", "a toy")}
    addresses = range(8)
    default_address = 0
    default_rate = 9600
    rig_controls = AXIS_CONTROLS
    options = OPTIONS
    impact: ClassVar = {"end": "stop the axis or put its parameters back"}

    def open(self, url: str, rate: int | None, /, *, is_builtin: bool = False) -> Transport:
        """Open a port."""
        return open_target(url, rate or 9600, is_builtin=is_builtin)

    def twin_url(self, model: str, address: int, neighbours: tuple[int, ...]) -> str:
        """Nothing that could be opened."""
        return f"toy://{model}:{address}"

    def explain(self, record: Record) -> str:
        """Put a letter into words."""
        return f"the letter {record.data.decode(errors='replace')}"

    def driver(self, session: Session, address: int | None = None) -> Session:
        """Checks of the toy speak for themselves."""
        return session

    def identify(self, session: Session) -> Identity:
        """Ask once."""
        answer = ask(session, "Q")
        if not answer:
            raise TargetError("nothing answers")
        if answer != "q":
            raise WrongDevice(f"not a toy: it answers {answer!r} where a toy says 'q'")
        return Identity("a toy", {"release": "1"})

    def is_alive(self, session: Session) -> bool:
        """Ask once."""
        return ask(session, "Q") == "q"

    def stop(self, session: Session) -> None:
        """Stop it."""
        ask(session, "S")

    def remember(self, session: Session) -> str:
        """Read the digit."""
        return ask(session, "R")

    def restore(self, session: Session, memory: str) -> tuple[str, ...]:
        """Store the digit again."""
        if ask(session, "R") != memory:
            ask(session, f"P{memory}")
        return () if ask(session, "R") == memory else (f"the stored digit {memory}",)


class Toy:
    """A toy bench: declare checks, run the engine over them, look at everything."""

    def __init__(self, module: types.ModuleType) -> None:
        self.module = module
        self.port: ToyPort = VirtualToyPort()
        self.opened: list[tuple[int, ...]] = []
        self.events: list[Event] = []
        self.soak_clock: Callable[[], float] = time.monotonic
        self.family: Family = vary(ToyFamily(), modules=(module.__name__,), probe_modules=())

    def add(self, function: Callable[[Session], None], *ids: str, **declared: Any) -> Check:
        """Declare a function as a check of the toy family."""
        function.__doc__ = function.__doc__ or "It behaves."
        one = replace(check(*ids, **declared)(function), module=self.module.__name__)
        setattr(self.module, one.name, one)
        return one

    def probe(
        self,
        switch: str,
        look: Callable[[Session], Seen],
        safety: tuple[str, ...] = ("passive",),
        needs: tuple[str, ...] = (),
    ) -> None:
        """Declare a question of the toy family."""
        name = self.module.__name__
        question = Check.named(f"detect_{switch}", "Asked.", name, safety=safety, needs=needs)
        setattr(self.module, question.name, Probe(switch, look, question))
        self.family = vary(self.family, probe_modules=(name,))

    def options(self, **changes: Any) -> Options:
        """The options of a run on the built-in toy, with everything allowed."""
        given: Mapping[str, Any] = {
            "family": self.family,
            "model": "toy",
            "endpoint": None,
            "address": 0,
            "neighbours": (1,),
            "rate": 9600,
            "allowed": frozenset(SAFETY_CLASSES),
            "settings": AxisSettings(Envelope(1000, 1000), changes.pop("eeprom_budget", None)),
            "level": "full",
            "seed": 5,
        } | changes
        return Options(**given)

    def open(self, neighbours: tuple[int, ...]) -> SerialTransport:
        """Open the toy port."""
        self.opened.append(neighbours)
        return SerialTransport(self.port, "toy", is_builtin=True)

    def run(self, **changes: Any) -> Result:
        """Run the engine over the declared checks."""
        engine = Engine(self.options(**changes), self.open, self.soak_clock)
        return engine.run(self.events.append)

    def seen(self, kind: type[Any]) -> list[Any]:
        """The events of one kind, in order."""
        return [event for event in self.events if isinstance(event, kind)]


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> Toy:
    """A toy bench without checks."""
    module = types.ModuleType("toy_checks")
    monkeypatch.setitem(sys.modules, "toy_checks", module)
    monkeypatch.setattr(device_guard, "SANITY_PAUSES_S", (0.0,))
    return Toy(module)


@pytest.fixture
def real_toy(toy: Toy) -> Toy:
    """The toy behind a port that knows no virtual time."""
    toy.port = ToyPort()
    return toy


def _wrong(session: Session) -> None:
    """It would have to answer z."""
    session.note("the <question> & its answer")
    answer = ask(session, "Q")
    session.expect(answer == "z", ("MACS-FRAME-01", "MACS-FRAME-02"), ["z", "Z"], answer)


def _drifting(session: Session) -> None:
    """It would have to be at 20 after 2 ms."""
    band = [(0, -1, 1), (1_000_000, 9, 11), (2_000_000, 19, 21)]
    session.motions.sample("move 1", [(1_000_000, 10)], band[:2])
    session.motions.sample("move 1", [(2_000_000, 27)], band[2:])
    session.expect(ask(session, "M") == "n", None, "19..21", 27)


def _unsettled(session: Session) -> None:
    """It answers now and then."""
    session.inconclusive(None, "3 of 10 times")


def _otherwise(session: Session) -> None:
    """It has a reading of its own."""
    session.expect(ask(session, "Q") == "q", None, "q", "")
    session.quirk(None, "xon_byte", "11h")


def _measured(session: Session) -> None:
    """It takes a time that nobody prescribes."""
    session.info(None, "takes 1 ms")


def _right(session: Session) -> None:
    """It answers."""
    answer = ask(session, "Q")
    session.expect(answer == "q", ("MACS-LINE-01", "MACS-FRAME-01"), "q", answer)


@pytest.fixture
def wrong_run(toy: Toy) -> list[dict[str, Any]]:
    """The event objects of a run over a toy of which every verdict can be said."""
    toy.add(_right, "MACS-LINE-01", "MACS-FRAME-01")
    toy.add(_wrong, "MACS-FRAME-01", "MACS-FRAME-02")
    toy.add(_unsettled, "MACS-FRAME-03")
    toy.add(_otherwise, "MACS-REPLY-01")
    toy.add(_measured, "MACS-REPLY-16")
    toy.add(_drifting, "MACS-CMD-13-01", safety="motion")
    toy.run()
    return [json.event_object(event, ToyFamily().explain) for event in toy.events]
