"""The built-in MSC behind a port of the tests, in virtual time, and what is planted into this one.

A fault is planted by an override: of `spoil` or `served` here, or of a part of the twin (such as
`receiver`), which all belong to this unit alone.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import serial
from port_in_front import PortInFront

from axistwin.devices.msc.receiver import ACCEPTED, REFUSED, Verdict
from axistwin_conformance.base.check import Check, check
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.core.session import Envelope, Run, Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK
from axistwin_conformance.families.msc.family import FAMILY
from axistwin_conformance.families.msc.options import TWIN_SCRATCH
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport

BYTE_NS: Final = 10_000_000_000 // 9600
RESPONSE_NS: Final = 5_000_000
REPEATS: Final = 5
RUNNING_BY_ITSELF: Final = 65  # program running, auto start

Spoil = Callable[[bytes], bytes]
Served = Callable[[codec.Packet], bytes | None]


class TwinPort(PortInFront):
    """A pyserial port with one twin behind it.

    `others`: the units that share its line.  `program`: the bench program runs.  `quirks`: the
    readings it follows.  `spoil`: what becomes of each thing the unit sends.
    `served`: what is behind the comma of a reply; empty: there is none; None: refused.  `received`:
    everything the host has sent.
    """

    def __init__(
        self,
        unit: int = 1,
        *,
        has_rflags: bool = True,
        others: tuple[int, ...] = (),
        program: bool = False,
        **quirks: object,
    ) -> None:
        if TWIN_HANDLER not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append(TWIN_HANDLER)
        self.unit, self.others, self.has_rflags = unit, others, has_rflags
        words = "".join(f"&quirk.{name}={value}" for name, value in quirks.items())
        model = "msc-250" if has_rflags else "msc-850"
        devices = ",".join(f"{model}:{number}" for number in (unit, *others))
        url = f"axistwin://{devices}?time=virtual{words}{'&program=bench' * program}"
        super().__init__(serial.serial_for_url(url, baudrate=9600))
        self.received = b""
        self.spoil: Spoil = lambda data: data
        self.device: Any = self.twins[0]._device
        self.receiver, self.commands = self.device._receiver, self.device._commands
        for each in self.twins:
            receiver = each._device._receiver
            receiver._send = partial(self._send_spoilt, receiver._send)
        self._served: Served = self._serve
        self._now = 0
        if not program:
            self.status = RUNNING_BY_ITSELF

    @property
    def in_waiting(self) -> int:
        """Bytes that are there."""
        return int(self.port.in_waiting)

    def write(self, data: bytes) -> int:
        """Put bytes on the line."""
        self.received += data
        return int(self.port.write(data))

    def read(self, size: int = 1) -> bytes:
        """Bytes as they come; time passes until there are so many, or the time-out is over."""
        self.port.timeout = self.timeout
        return bytes(self.port.read(size))

    def close(self) -> None:
        """Stay open for questions."""

    # --- what it holds ----------------------------------------------------------------------------

    @property
    def data(self) -> dict[int, int]:
        """Every value ever written, by its address."""
        values: dict[int, int] = self.device.data._values
        return values

    @data.setter
    def data(self, values: dict[int, int]) -> None:
        self.data.clear()
        self.data.update(values)

    @property
    def flags(self) -> set[int]:
        """The flags that are on."""
        return set(codec.flags_on(self.device.flags.snapshot(self.virtual_time_ns)))

    @flags.setter
    def flags(self, numbers: set[int]) -> None:
        for number in self.flags ^ numbers:
            self.device.flags.set(number, number in numbers)

    @property
    def status(self) -> int:
        """The status word."""
        return int(self.device.status.word)

    @status.setter
    def status(self, word: int) -> None:
        self.device.status._word = type(self.device.status.word)(word)

    # --- where faults are planted -----------------------------------------------------------------

    @property
    def served(self) -> Served:
        """See above."""
        return self._served

    @served.setter
    def served(self, served: Served) -> None:
        self._served, self.receiver._examine = served, self._examine

    def _send_spoilt(self, send: Callable[[int, bytes], int], start_ns: int, data: bytes) -> int:
        return send(start_ns, self.spoil(data))

    def _examine(self, now: int, body: bytes) -> Any:
        self._now = now
        request = codec.parse(codec.packet(self.unit, body))
        assert request is not None
        return self._verdict(request, self._served(request))

    def _verdict(self, request: codec.Packet, served: bytes | None) -> Any:
        if served is None:
            return REFUSED
        if not served:
            return ACCEPTED
        return Verdict(ACK, None, lambda now: self.body(request, served))

    def body(self, request: codec.Packet, served: bytes) -> bytes:
        """The body of a reply with what is behind its comma."""
        return codec.body(request.name, served)

    def _serve(self, request: codec.Packet) -> bytes | None:
        """As the twin serves it, at once."""
        verdict = self.commands.examine(self._now, request.body)
        if verdict.sign != ACK:
            return None
        while verdict.act is not None and verdict.act(self._now) is not None:
            pass
        return verdict.reply(self._now).partition(codec.COMMA)[2] if verdict.reply else b""


def target_of(port: Any, *, is_lossless: bool = True) -> SerialTransport:
    """The suite's view of it, not known to be a twin."""
    return SerialTransport(port, "a small MSC", is_lossless=is_lossless)


def session_on(port: Any, checked: Check | None = None, **how: Any) -> Session:
    """A session with it; `how`: fields of the run."""
    fields = {
        "target": target_of(port),
        "family": FAMILY,
        "model": FAMILY.models["msc-250" if port.has_rflags else "msc-generic"],
        "ledger": load_ledger("msc"),
        "address": port.unit,
        "neighbours": (),
        "allowed": frozenset({"passive", "stored"}),
        "envelope": Envelope(0, 0),
        "seed": 0,
        "settings": TWIN_SCRATCH,
    }
    return Session(Run(**(fields | how)), checked)


def check_of(*safety: str, needs: tuple[str, ...] = ()) -> Check:
    """A check of these classes that does nothing by itself."""

    def nothing(session: Session) -> None:
        """Does nothing."""

    return check("MSC-LNK-01", safety=safety or "passive", needs=needs)(nothing)
