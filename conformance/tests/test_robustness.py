"""Peers that are no MAC module, or stop being one: a clear verdict soon, no traceback, no hang."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest
import serial
from port_in_front import PortInFront

from axistwin_conformance.base.events import Outcome
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport

pytestmark = pytest.mark.strength

SECOND = 1_000_000_000
SOON_S = 30.0  # of the device's time, from its loss to the end; it is listened for twice
SOON_REAL_S = 30.0
Answers = Callable[[bytes], bytes]


class Peer(PortInFront):
    """A port in virtual time: the built-in twin up to a number of requests, then something else."""

    def __init__(self, port: Any, good: int, answers: Answers) -> None:
        super().__init__(port)
        self.good, self.answers = good, answers
        self._extra_ns = 0
        self._waiting = b""

    @property
    def virtual_time_ns(self) -> int:
        """The twin's clock, and what has passed since it was replaced."""
        return super().virtual_time_ns + self._extra_ns

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return len(self._waiting) if self.good < 0 else int(self.port.in_waiting)

    def write(self, data: bytes) -> int:
        """Pass on, or answer in its own way."""
        self.good -= 1
        if self.good >= 0:
            return int(self.port.write(data))
        self._extra_ns += SECOND // 200
        self._waiting += self.answers(data)
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """What there is; else the time-out passes."""
        if self.good >= 0:
            self.port.timeout = self.timeout
            return bytes(self.port.read(size))
        taken, self._waiting = self._waiting[:size], self._waiting[size:]
        if not taken:
            self._extra_ns += round((self.timeout or 0) * SECOND)
        return taken

    def close(self) -> None:
        """Close."""
        self.port.close()


PEERS: dict[str, Answers] = {
    "silence": lambda data: b"",
    "echo": lambda data: data,
    "flood": lambda data: b"\x55" * 5000,
    "garbage": lambda data: bytes((7 * byte + 3) % 256 for byte in data),
    "another protocol": lambda data: b"ERR 1: unknown command\r\n",
    "half an answer": lambda data: b"\x06\x13\x02011",
    "nack for everything": lambda data: b"\x15",
    "accepted, whatever it is": lambda data: b"\x06\x13\x1a",
}
# These speak the module's protocol, each time in the same wrong way: a judged failure, no noise.
SPEAKING = {"half an answer", "nack for everything", "accepted, whatever it is"}


def judge(good: int, answers: Answers) -> tuple[Result, Peer, float]:
    """Run everything but the rig against a peer that goes wrong after so many requests."""
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    options = make_options(model="mac23", level="quick", allow="motion,stored")
    peers: list[Peer] = []

    def open_peer(neighbours: tuple[int, ...]) -> SerialTransport:
        url = options.family.twin_url(options.model, options.address, neighbours)
        peers.append(
            Peer(serial.serial_for_url(url, baudrate=options.rate or 38400), good, answers)
        )
        return SerialTransport(peers[-1], url, is_builtin=True, is_lossless=False)

    started = time.process_time()
    result = Engine(options, open_peer).run(lambda event: None)
    return result, peers[0], time.process_time() - started


def _ends_soon(peer: Peer, seconds: float) -> None:
    assert peer._extra_ns < SOON_S * SECOND
    assert seconds < SOON_REAL_S


@pytest.mark.parametrize("name", sorted(PEERS.keys() - SPEAKING))
def test_who_is_no_module_at_all_is_not_judged(name: str) -> None:
    """Exit 3, the reason in a line, within seconds."""
    result, peer, seconds = judge(0, PEERS[name])
    assert result.exit_status == 3, result.sentence
    assert result.sentence.startswith("Not judged: ")
    assert "\n" not in result.sentence
    _ends_soon(peer, seconds)


@pytest.mark.parametrize("good", [60, 900])
@pytest.mark.parametrize("name", sorted(PEERS.keys() - SPEAKING))
def test_who_stops_being_one_in_the_middle_is_inconclusive(name: str, good: int) -> None:
    """No fail for a device that was lost, no crash of the suite, and the end comes soon."""
    result, peer, seconds = judge(good, PEERS[name])
    assert result.exit_status in (3, 4), result.sentence
    assert Verdict.FAIL not in {one.verdict for one in result.requirements}
    assert [one.trouble for one in result.checks if one.outcome is Outcome.ERROR] == []
    assert result.problems or result.refusal
    assert "error in the suite" not in " ".join([*result.problems, result.refusal])
    _ends_soon(peer, seconds)


@pytest.mark.parametrize("good", [0, 60])
@pytest.mark.parametrize("name", sorted(SPEAKING))
def test_who_answers_in_the_protocol_and_always_wrongly_fails(name: str, good: int) -> None:
    """The form of its replies is judged, however soon the run has to end for it."""
    result, peer, seconds = judge(good, PEERS[name])
    assert result.exit_status == 1, result.sentence
    failed = {one.requirement.id for one in result.requirements if one.verdict is Verdict.FAIL}
    assert "MACS-REPLY-07" in failed
    assert [one.trouble for one in result.checks if one.outcome is Outcome.ERROR] == []
    _ends_soon(peer, seconds)
