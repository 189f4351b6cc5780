"""A device that answers wrongly while no check is judging it, and a twin that falls over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
import serial
from port_in_front import PortInFront

from axistwin_conformance.base.events import Outcome
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.core.session import Envelope, Run, Session
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.diagnosis import diagnose
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport

pytestmark = pytest.mark.strength

REFUSED, NACK = b"\x06\x13\x17", b"\x15"
Answer = Callable[[bytes], bytes]


class Faulty(PortInFront):
    """The built-in twin, but for some frames: answered otherwise, or they make it fall over."""

    def __init__(self, port: Any, answers: dict[int, Answer]) -> None:
        super().__init__(port)
        self.answers = answers
        self._waiting = b""

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return len(self._waiting) or int(self.port.in_waiting)

    def write(self, data: bytes) -> int:
        """Pass on, or answer in its own way; only frames for the module under test."""
        is_frame = len(data) == 21 and data[4:6] == b"00"
        answer = self.answers.get(int(data[6:8], 16)) if is_frame else None
        if answer is None:
            return int(self.port.write(data))
        self._waiting += answer(data)
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """What there is; else time passes as it does for the twin."""
        if self._waiting:
            taken, self._waiting = self._waiting[:size], self._waiting[size:]
            return taken
        self.port.timeout = self.timeout
        return bytes(self.port.read(size))

    def close(self) -> None:
        """Close."""
        self.port.close()


class Deaf(Faulty):
    """The built-in twin until so many frames after a command of that index; then nothing more."""

    def __init__(self, port: Any, index: int, frames: int) -> None:
        super().__init__(port, {})
        self._index, self._left, self._has_begun = b"%02X" % index, frames, False

    def write(self, data: bytes) -> int:
        """Pass on, or hear nothing."""
        self._has_begun |= len(data) == 21 and data[6:8] == self._index
        self._left -= self._has_begun
        return int(self.port.write(data)) if self._left >= 0 else len(data)


class NowAndThen(Faulty):
    """The built-in twin, but for one in `every` of some frames."""

    def __init__(self, port: Any, answers: dict[int, Answer], every: int) -> None:
        super().__init__(port, answers)
        self._every, self._asked = every, 0

    def write(self, data: bytes) -> int:
        """Pass on, or answer in its own way when that is due."""
        self._asked += len(data) == 21 and int(data[6:8], 16) in self.answers
        return super().write(data) if self._asked % self._every == 0 else int(self.port.write(data))


@dataclass
class Judged:
    """What came of a run, and how many twins it took."""

    result: Result
    opened: int

    @property
    def failed(self) -> set[str]:
        """The requirements that failed."""
        return {one.requirement.id for one in self.result.requirements if one.verdict is FAIL}

    def outcome(self, name: str) -> Outcome:
        """How the check of that name ended."""
        return next(one.outcome for one in self.result.checks if one.check.name == name)


FAIL = Verdict.FAIL


def judge(
    answers: dict[int, Answer] | Callable[[Any], Faulty],
    *ids: str,
    is_lossless: bool = True,
    only_detection: bool = False,
    allow: str = "motion,stored",
) -> Judged:
    """Judge a faulty twin in virtual time."""
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    options = make_options(
        model="mac23", ids=ids, allow=allow, level=None if only_detection else "quick",
        is_detection=only_detection,
    )  # fmt: skip
    opened: list[SerialTransport] = []

    def open_faulty(neighbours: tuple[int, ...]) -> SerialTransport:
        url = options.family.twin_url(options.model, options.address, neighbours)
        twin = serial.serial_for_url(url, baudrate=options.rate or 38400)
        port = answers(twin) if callable(answers) else Faulty(twin, answers)
        opened.append(SerialTransport(port, url, is_builtin=True, is_lossless=is_lossless))
        return opened[-1]

    result = Engine(options, open_faulty).run(lambda event: None)
    told = " ".join([*result.problems, result.refusal, *(one.trouble for one in result.checks)])
    assert "error in the suite" not in told
    return Judged(result, len(opened))


def answer(data: bytes, *, address: bytes = b"00", spoil: int = 0, digit: bytes = b"") -> bytes:
    """A well-formed answer to a query, but for what is asked for."""
    summed = address + (digit or data[7:8]) + b"00000000"
    check = codec.two_digits(codec.checksum(summed) + spoil)
    return b"\x06\x13\x02011" + summed + check + b"\x03\x1a"


WRONG: dict[str, tuple[int, Answer, str]] = {
    "25h is refused": (0x25, lambda data: REFUSED, "MACS-REPLY-07"),
    "25h gets no answer": (0x25, lambda data: b"", "MACS-REPLY-07"),
    "26h has a wrong sum": (0x26, lambda data: answer(data, spoil=1), "MACS-REPLY-07"),
    "22h is of another": (0x22, lambda data: answer(data, address=b"01"), "MACS-REPLY-08"),
    "26h tells another digit": (0x26, lambda data: answer(data, digit=b"7"), "MACS-REPLY-09"),
    "24h is refused": (0x24, lambda data: REFUSED, "MACS-REPLY-07"),
    "27h is a Nack": (0x27, lambda data: NACK, "MACS-REPLY-07"),
    "18h gets an answer": (0x18, answer, "MACS-REPLY-01"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_reply_to_the_engine_itself_fails_what_it_breaks(name: str) -> None:
    """Exit 1 with that requirement, whoever asked; what does not rest on it is judged."""
    index, how, requirement = WRONG[name]
    judged = judge({index: how}, "MACS-LINE-02", "MACS-CMD-13-01", "version_word")
    assert judged.result.exit_status == 1, judged.result.sentence
    assert requirement in judged.failed
    assert judged.outcome("xoff_and_xon_arrive_as_bytes_of_the_reply") is Outcome.DONE


@pytest.mark.parametrize("name", WRONG)
def test_detection_alone_fails_it_as_well(name: str) -> None:
    """A profile of a device that is none of its model is no success."""
    index, how, requirement = WRONG[name]
    judged = judge({index: how}, only_detection=True)
    assert judged.result.exit_status == 1, judged.result.sentence
    assert requirement in judged.failed


@pytest.mark.parametrize("name", ["25h is refused", "26h has a wrong sum"])
def test_where_bytes_may_get_lost_the_same_wrong_reply_again_and_again_fails_too(name: str) -> None:
    """The line is not to blame for the same bytes every time, from who else answers well."""
    index, how, requirement = WRONG[name]
    judged = judge({index: how}, "MACS-CMD-13-01", is_lossless=False)
    assert judged.result.exit_status == 1, judged.result.sentence
    assert requirement in judged.failed


def test_where_bytes_may_get_lost_what_is_summed_rightly_is_no_noise() -> None:
    """A number with a sign, now and then: asking again helps, but no line makes its sum right."""

    def signed(data: bytes) -> bytes:
        summed = b"00" + data[7:8] + b"-A601000"
        return b"\x06\x13\x02011" + summed + codec.two_digits(codec.checksum(summed)) + b"\x03\x1a"

    judged = judge(
        lambda twin: NowAndThen(twin, {0x26: signed}, 7), "MACS-CMD-13-01", is_lossless=False
    )
    assert judged.result.exit_status == 1, judged.result.sentence
    assert "MACS-REPLY-07" in judged.failed


@pytest.mark.parametrize(
    ("other", "requirement"),
    [({"digit": b"7"}, "MACS-REPLY-09"), ({"address": b"5A"}, "MACS-REPLY-08")],
)
def test_where_bytes_may_get_lost_an_answer_to_something_else_is_no_noise(
    other: dict[str, Any], requirement: str
) -> None:
    """Now and then, where no other answer was due."""
    judged = judge(
        lambda twin: NowAndThen(twin, {0x26: lambda data: answer(data, **other)}, 7),
        "MACS-CMD-13-01", is_lossless=False,
    )  # fmt: skip
    assert judged.result.exit_status == 1, judged.result.sentence
    assert requirement in judged.failed


def test_where_bytes_may_get_lost_silence_to_one_request_alone_has_failed() -> None:
    """No line loses the same request each time and no other; what cannot be read does not move."""
    judged = judge({0x25: lambda data: b""}, "MACS-LINE-02", "MACS-CMD-13-01", is_lossless=False)
    assert judged.result.exit_status == 1
    assert judged.failed == {"MACS-REPLY-07"}
    assert judged.outcome("moves_take_the_time_of_the_closed_form") is Outcome.BLOCKED


def test_what_cannot_be_remembered_is_not_changed() -> None:
    """Passive checks run, the others say why they did not."""
    judged = judge({0x25: lambda data: REFUSED}, "MACS-LINE-02", "MACS-CMD-13-01")
    assert judged.outcome("moves_take_the_time_of_the_closed_form") is Outcome.BLOCKED
    blocked = [one for one in judged.result.checks if one.outcome is Outcome.BLOCKED]
    assert all("could not be read: no answer to query 25h" in one.trouble for one in blocked)


@pytest.mark.parametrize("frames", [0, 1, 5])
@pytest.mark.parametrize("index", [0x08, 0x1B, 0x01])
def test_a_twin_that_goes_deaf_while_readings_are_asked_for_late_has_failed(
    index: int, frames: int
) -> None:
    """In virtual time nothing gets lost by itself: exit 1, though no check had begun."""
    judged = judge(
        lambda twin: Deaf(twin, index, frames),
        "MACS-CMD-08-02", "MACS-CMD-1B-01", "MACS-CMD-01-01",
        allow="motion,stored,destructive",
    )  # fmt: skip
    assert judged.result.lost
    assert judged.result.exit_status == 1, judged.result.sentence
    assert judged.failed == {"MACS-REPLY-07"}


# --- a twin that falls over ----------------------------------------------------------------------


def falls(data: bytes) -> bytes:
    """A mistake in a twin."""
    raise ZeroDivisionError("oops")


CRASH = "the built-in twin crashed: ZeroDivisionError: oops (test_wrong_replies.py:"


def test_a_twin_that_crashes_fails_what_was_asked_of_it_and_is_replaced() -> None:
    """Exit 1; the checks behind it run on a fresh twin."""
    judged = judge({0x14: falls}, "MACS-CMD-14", "MACS-CMD-15-01")
    assert judged.result.exit_status == 1
    crashed = [one for one in judged.result.checks if one.trouble.startswith(CRASH)]
    assert crashed
    assert {one.outcome for one in crashed} == {Outcome.TROUBLE}
    assert {finding.verdict for one in crashed for finding in one.findings} == {FAIL}
    assert all(finding.transcript for one in crashed for finding in one.findings)
    assert any(one.outcome is Outcome.DONE for one in judged.result.checks)
    assert judged.opened > 1


@pytest.mark.parametrize("index", [0x20, 0x24, 0x25, 0x18])
def test_a_twin_that_crashes_beside_the_checks_has_failed_too(index: int) -> None:
    """Identity, sanity, what is remembered, stopping: exit 1, and the crash is told."""
    judged = judge({index: falls}, "MACS-LINE-02", "MACS-CMD-13-01")
    assert judged.result.exit_status == 1, judged.result.sentence
    told = [str(finding.actual) for one in judged.result.checks for finding in one.findings]
    assert any(one.startswith(CRASH) for one in told)


def test_a_twin_that_crashes_as_it_is_opened_is_unreachable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Exit 3 with the crash in the sentence."""

    def broken(*words: Any, **options: Any) -> Any:
        raise ZeroDivisionError("oops")

    monkeypatch.setattr("axistwin_conformance.transport.serial.serial.serial_for_url", broken)
    result = Engine(make_options(model="mac23", level="quick")).run(lambda event: None)
    assert result.exit_status == 3
    assert "the built-in twin crashed: ZeroDivisionError: oops" in result.sentence


class FallsAtGeneralFrames(Faulty):
    """The built-in twin, which falls over when 08h comes to the general address."""

    def __init__(self, port: Any) -> None:
        super().__init__(port, {})

    def write(self, data: bytes) -> int:
        """Pass on, or fall over."""
        return len(falls(data)) if data[4:8] == b"FF08" else int(self.port.write(data))


def test_a_twin_that_crashes_at_a_general_frame_asked_late_has_failed() -> None:
    """Nobody need answer one, but nobody may fall over it: exit 1, and the run goes on."""
    judged = judge(
        FallsAtGeneralFrames, "MACS-CMD-1B-01", "general_reply_policy",
        allow="motion,stored,destructive",
    )  # fmt: skip
    assert judged.result.exit_status == 1, judged.result.sentence
    assert "MACS-REPLY-01" in judged.failed
    assert judged.outcome("the_rate_can_be_programmed") is Outcome.DONE


# --- whom a reply accuses ------------------------------------------------------------------------


def blamed(request: bytes, reply: bytes | None) -> str:
    """The requirement that is broken by a reply, or nothing."""
    run = Run(
        SerialTransport(serial.serial_for_url("loop://"), "", is_lossless=True),
        find_family("mac23"), None,  # type: ignore[arg-type]
        None, 0, (1,),  # type: ignore[arg-type]
        frozenset(), Envelope(1000, 1000), 0,
    )  # fmt: skip
    session = Session(run)
    return breach.requirement if (breach := diagnose(session, request, reply)) else ""


QUERY = codec.request(0, 0x20).encode()


@pytest.mark.parametrize(
    ("request_", "reply", "requirement"),
    [
        (QUERY, answer(QUERY), ""),
        (QUERY, b"", "MACS-REPLY-07"),
        (QUERY, None, "MACS-REPLY-07"),
        (QUERY, b"\x06\x13\x1a", "MACS-REPLY-07"),
        (codec.request(1, 0x20).encode(), answer(QUERY), "MACS-REPLY-08"),
        (codec.request(0, 0x28, 0, 0xFF).encode(), REFUSED, ""),
        (codec.request(0, 0x24, 0xFFFFFFFF).encode(), REFUSED, ""),
        (codec.request(0, 0x13, 5).encode(), REFUSED, ""),
        (codec.request(0, 0x13, 5).encode(), NACK, "MACS-REPLY-01"),
        (codec.request(0, 0x13, 5).encode(), None, "MACS-REPLY-01"),
        (codec.request(0, 0x00).encode(), b"", ""),
        (codec.request(0, 0x12).encode(), b"", ""),  # nobody knows what it does
        (codec.request(0xFF, 0x20).encode(), b"", ""),
        (codec.request(0xFF, 0x08, 0xAA).encode(), None, "MACS-REPLY-01"),
        (codec.request(5, 0x20).encode(), b"", ""),  # nobody has that address
        (codec.request(0, 0x20).with_wrong_checksum().encode(), NACK, ""),
        (b"\x02014", b"\x99", ""),
    ],
)
def test_a_reply_accuses_only_by_what_every_reading_leaves_out(
    request_: bytes, reply: bytes | None, requirement: str
) -> None:
    """Whatever is open, of nobody here, or no frame at all, may be answered by anything."""
    assert blamed(request_, reply) == requirement
