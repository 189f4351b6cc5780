"""The MN400 on USB: transport, checks and probes, heard with a small board and with the twin."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from usb_board import LEDGER, NODE, UsbBoard, judged

from axistwin import hid
from axistwin_conformance.base.errors import TargetError, UsageError
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import conform
from axistwin_conformance.core.session import Envelope, Run, Session
from axistwin_conformance.engine.device import keeping
from axistwin_conformance.engine.judgement import ELSEWHERE, NOT_COVERED
from axistwin_conformance.engine.result import Result
from axistwin_conformance.families.mn400.codec import ReturnCode
from axistwin_conformance.families.mn400.family import MODEL
from axistwin_conformance.families.mn400.usb.driver import report_words
from axistwin_conformance.report.folder import ReportFolder
from axistwin_conformance.transport.hid import (
    HidIdentity,
    HidTransport,
    ReportPort,
    identity_of,
    open_hid,
)
from axistwin_conformance.transport.kinds import HID, LINE, choose_endpoint

ALL_OF_USB = {f"MN4-USB-{number:02}" for number in range(1, 9)}


def of_verdict(result: Result, verdict: Verdict) -> set[str]:
    """The requirements with that verdict."""
    return {one.requirement.id for one in result.requirements if one.verdict is verdict}


class TwinPort:
    """The twin in this process, as a `ReportPort`."""

    def __init__(self, url: bytes = b"axistwin://mn400?time=virtual") -> None:
        self.device = hid.device()
        self.device.open_path(url)
        self.write, self.read = self.device.write, self.device.read

    def identity(self) -> HidIdentity:
        """As hidapi tells it."""
        (told,) = (one for one in hid.enumerate() if one["serial_number"] == self.device.twin.name)
        return identity_of(
            told["vendor_id"], told["product_id"], bytes(self.device.get_report_descriptor())
        )

    @property
    def virtual_time_ns(self) -> int:
        """Of its line."""
        return self.device.virtual_time_ns

    def close(self) -> None:
        """Stay open for questions."""


def twin(address: int, **quirks: str) -> TwinPort:
    """A twin with a name of its own."""
    given = "".join(f"&quirk.{name}={value}" for name, value in quirks.items())
    return TwinPort(f"axistwin://mn400:{address}?time=virtual{given}".encode())


@pytest.mark.parametrize("make", [UsbBoard, lambda: twin(41)], ids=["small board", "twin"])
def test_a_sound_board_conforms(make: Any) -> None:
    """In all that the manual says of USB; its counters are as they were."""
    board: ReportPort = make()
    result = judged(board)
    assert of_verdict(result, Verdict.PASS) == ALL_OF_USB
    assert (result.exit_status, result.problems) == (0, [])
    if isinstance(board, UsbBoard):
        assert (board.counters, board.address) == ([5, -6, 7, 8], 1)


@pytest.mark.parametrize(
    ("number", "readings"),
    [
        (42, {"usb_error_form": "code", "usb_outcome_codes": "true"}),
        (43, {"usb_error_form": "cmd_code", "usb_outcome_codes": "false"}),
        (44, {"usb_error_form": "code", "usb_outcome_codes": "false"}),
    ],
)
def test_a_twin_of_other_readings_conforms(number: int, readings: dict[str, str]) -> None:
    """Both switches of USB are found, and the checks hold the board to them."""
    result = judged(twin(number, **readings))
    assert (of_verdict(result, Verdict.FAIL), result.readings) == (set(), readings)


class _Misnamed(UsbBoard):
    enumerated = HidIdentity(0x0461, 0x0021, 64, 64)


class _Short(UsbBoard):
    enumerated = HidIdentity(0x0461, 0x0020, 63, 64)


class _ReadsOn(UsbBoard):
    parsed = 64


class _ReadsLess(UsbBoard):
    parsed = 47


class _Talkative(UsbBoard):
    says_done = True


class _Silent(UsbBoard):
    def tell(self, letter: str, code: Any) -> None:
        if code != 0x0E:
            super().tell(letter, code)


class _TwoForms(UsbBoard):
    def tell(self, letter: str, code: Any) -> None:
        self.form = "code" if letter == "V" else "cmd_code"
        super().tell(letter, code)


class _TakesAll(UsbBoard):
    takes_all = True


class _Addressed(UsbBoard):
    heeds_address = True


class _Framed(UsbBoard):
    def read_out(self, letter: str) -> None:
        self.say(b"\x81E0,0,0,0\x06\x81\x00")


class _WithStart(UsbBoard):
    def read_out(self, letter: str) -> None:
        self.say(letter.encode() + b"\x03")
        super().read_out(letter)


class _WithDone(UsbBoard):
    def read_out(self, letter: str) -> None:
        super().read_out(letter)
        self.say(letter.encode() + b"\x05")


class _PresentAlone(UsbBoard):
    def tell(self, letter: str, code: Any) -> None:
        if code == 0x16:
            self.say(b"\x16")
        else:
            super().tell(letter, code)


@pytest.mark.parametrize(
    ("kind", "failing"),
    [
        (_Misnamed, {"MN4-USB-01"}),
        (_Short, {"MN4-USB-01"}),
        (_ReadsOn, {"MN4-USB-02"}),
        (_ReadsLess, {"MN4-USB-02"}),
        (_Framed, {"MN4-USB-03"}),
        (_WithStart, {"MN4-USB-03"}),
        (_WithDone, {"MN4-USB-03"}),
        (_Talkative, {"MN4-USB-04"}),
        (_Silent, {"MN4-USB-05"}),
        (_TwoForms, {"MN4-USB-05"}),
        (_TakesAll, {"MN4-USB-06"}),
        (_Addressed, {"MN4-USB-07"}),
        (_PresentAlone, {"MN4-USB-08"}),
    ],
)
def test_a_wrong_board_fails_what_it_breaks(kind: type[UsbBoard], failing: set[str]) -> None:
    """At least that; a fault may break more."""
    result = judged(kind())
    assert failing <= of_verdict(result, Verdict.FAIL), [
        (one.check.name, [found.text or found.actual for found in one.findings])
        for one in result.checks
    ]
    assert result.exit_status == 1


def test_a_board_that_is_none_and_one_that_is_silent_are_told() -> None:
    """Nothing is judged of them."""
    for corrupt in (lambda report: None, lambda report: b"OK"):
        board = UsbBoard()
        board.corrupt = corrupt
        result = judged(board)
        assert (result.exit_status, of_verdict(result, Verdict.PASS)) == (3, set())


def test_nothing_is_sent_to_a_device_of_somebody_else() -> None:
    """A keyboard at that node is told, and gets no report."""
    board = UsbBoard()
    board.enumerated = HidIdentity(0x046D, 0xC31C, 8, 1)
    result = judged(board)
    assert (result.exit_status, board.received) == (3, [])
    assert result.refusal.startswith("not an MN400: it enumerates as 046Dh:C31Ch, reports of 8")


def test_what_a_board_held_is_put_back_over_usb(tmp_path: Path) -> None:
    """The file says behind which option its path stands; one of an older version does not."""
    options = judged(UsbBoard()).options
    kept = keeping.load(keeping.keep(replace(options, report=str(tmp_path)), {}), "mn400")
    assert (kept.option, kept.endpoint) == ("--hid", NODE)
    path = tmp_path / "old.json"
    path.write_text(
        '{"format": 1, "model": "mn400", "port": "/dev/ttyS1", "address": 1, "rate": 9600,'
        ' "held": {}}'
    )
    assert keeping.load(path, "mn400").option == ""


def test_counters_are_put_back_and_what_could_not_be_is_told() -> None:
    """As they were when they were remembered, also by way of a file."""
    board, family = UsbBoard(), MODEL.over[HID]
    session = Session(
        Run(
            target=HidTransport(board, NODE), family=family, model=family.models["mn400"],
            ledger=LEDGER, address=1, neighbours=(), allowed=frozenset({"passive"}),
            envelope=Envelope(0, 0), seed=0,
        )
    )  # fmt: skip
    memory = family.memory_of(family.kept(family.remember(session)))
    board.counters = [9, 9, 9, 9]
    assert family.restore(session, memory) == ()
    assert board.counters == [5, -6, 7, 8]
    board.counters = [0, 0, 0, 0]
    board.done = lambda letter: board.tell(letter, ReturnCode.BUSY)  # type: ignore[method-assign]
    assert family.restore(session, memory) == ("the counters: L BUSY",)


def test_nothing_but_what_is_passive_is_sent_without_leave() -> None:
    """In no part of any report."""
    board = UsbBoard()
    result = judged(board, allowed=frozenset({"passive"}))
    assert of_verdict(result, Verdict.PASS) == ALL_OF_USB - {"MN4-USB-07"}
    for report in board.received:
        for text in report.split(b"\0"):
            assert text[:1] not in (*map(bytes, zip(b"A+TUC}Z.=~", strict=True)),)


def test_what_is_of_the_line_is_told_in_a_whole_run(tmp_path: Path) -> None:
    """Not run, with the way to judge it, also on the page."""
    folder = ReportFolder(tmp_path, MODEL.over[HID].explain, HID.spell)
    result = judged(UsbBoard(), words=(), hear=folder)
    told = {one.requirement.id: one.reason for one in result.requirements}
    assert told["MN4-PKT-03"] == told["MN4-MOT-01"] == ELSEWHERE
    assert NOT_COVERED not in told.values()
    assert ALL_OF_USB - of_verdict(result, Verdict.PASS) == {"MN4-USB-07"}  # it was not named
    assert result.options.command == (
        f"axistwin conform mn400 --hid {NODE} --allow destructive --seed 5"
    )
    assert folder.finish()
    page = (tmp_path / "report.html").read_text("utf-8")
    assert page.count("of the serial line") > 300
    assert "not covered" not in re.sub(r"<(script|style)\b.*?</\1>", "", page, flags=re.DOTALL)


# --- the transport --------------------------------------------------------------------------------


def test_reports_are_kept_until_they_are_asked_for() -> None:
    """What comes during a wait is there afterwards; a drain sets it aside."""
    board = UsbBoard()
    transport = HidTransport(board, NODE)
    transport.send(b"E")
    transport.send(b"*")
    assert transport.wait(0.5) >= 0.5
    assert [transport.receive(0.1) for _ in range(3)] == [b"E5,-6,7,8", b"*\x16", None]
    transport.send(b"E")
    assert transport.drain() == (b"E5,-6,7,8",)
    said = [record.data for record in transport.transcript if record.data]
    assert said == [b"E", b"*", b"E5,-6,7,8", b"*\x16", b"E", b"E5,-6,7,8"]


def test_a_device_that_fails_is_trouble_of_the_target() -> None:
    """Pulled out, or without room for a report."""

    class Gone(UsbBoard):
        def read(self, max_length: int, timeout_ms: int, /) -> bytes:
            raise OSError(19, "No such device")

        def write(self, data: bytes, /) -> int:
            return -1

    transport = HidTransport(Gone(), NODE)
    with pytest.raises(TargetError, match="failed while receiving: No such device"):
        transport.receive(0.1)
    with pytest.raises(TargetError, match="takes no report of 64 bytes"):
        transport.send(b"E")


def test_what_is_no_hid_device_is_told_in_a_line(tmp_path: Path) -> None:
    """A path that is not there, and a file."""
    with pytest.raises(TargetError, match=r"cannot open .*/x: No such file"):
        open_hid(str(tmp_path / "x"))
    (tmp_path / "x").touch()
    with pytest.raises(TargetError, match=r"cannot open .*/x: it is no HID device"):
        open_hid(str(tmp_path / "x"))


@pytest.mark.parametrize(
    ("descriptor", "expected"),
    [
        ("06 00 FF 09 01 A1 01 75 08 95 40 81 02 95 20 91 02 C0", (64, 32, False)),
        ("A1 01 85 01 75 01 95 09 81 02 26 FF 00 75 08 96 00 01 91 02 C0", (2, 256, True)),
        ("FE 02 00 AA BB 75 08 95 08 81 02 81 02", (16, 0, False)),
    ],
)
def test_sizes_are_read_from_the_descriptor(
    descriptor: str, expected: tuple[int, int, bool]
) -> None:
    """Fields add up; items of one, two and four bytes, and long ones, are passed over."""
    found = identity_of(1, 2, bytes.fromhex(descriptor))
    assert (found.in_bytes, found.out_bytes, found.has_numbers) == expected


@pytest.mark.parametrize(
    ("report", "words"),
    [
        (None, "nothing"), (b"", "a report of nulls"), (b"E0,0,0,0", "E 0,0,0,0"),
        (b"X\x0e", "X PARA_ERROR"), (b"\x0e", "PARA_ERROR alone"), (b"\x81E", "81 45"),
    ],
)  # fmt: skip
def test_reports_are_told_in_words(report: bytes | None, words: str) -> None:
    """Values, codes, and what is neither."""
    assert report_words(report) == words


# --- the command line -----------------------------------------------------------------------------


def choose(**given: str | int | None) -> tuple[Any, ...]:
    """What is chosen for an MN400."""
    endpoints = {f"--{name}": given.get(name) for name in ("port", "can", "hid")}
    rates = {f"--{name}": given.get(name) for name in ("baud", "bitrate")}
    return choose_endpoint((LINE, *MODEL.over), "mn400", endpoints, rates)  # type: ignore[arg-type]


def test_a_board_is_judged_over_one_of_its_ports() -> None:
    """The line, unless the other one is named."""
    assert choose() == (LINE, None, None)
    assert choose(port="/dev/ttyS1", baud=19200) == (LINE, "/dev/ttyS1", 19200)
    assert choose(hid=NODE) == (HID, NODE, None)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"hid": NODE, "port": "/dev/ttyS1"}, "--port and --hid: judge it over one of them"),
        ({"hid": NODE, "baud": 9600}, "--baud 9600: USB has no rate; leave it out"),
        ({"hid": "axistwin://mn400"}, "--hid axistwin://mn400 is a URL: write a path such as /dev"),
        ({"can": "socketcan:can0"}, "--can socketcan:can0: an mn400 is on a line: --port URL"),
        ({"hid": NODE, "can": "socketcan:can0"}, "--can socketcan:can0: an mn400 is on a line"),
    ],
)
def test_what_does_not_go_together_is_told(given: dict[str, Any], told: str) -> None:
    """In one line."""
    with pytest.raises(UsageError, match="^" + told.replace("?", r"\?")):
        choose(**given)


@pytest.mark.parametrize("model", ["mac23", "mac23-can", "msc-250"])
def test_a_model_without_usb_is_one_clear_line(model: str) -> None:
    """Status 2, with the option that it has."""
    ran = CliRunner().invoke(conform, [model, "--hid", NODE])
    assert ran.exit_code == 2
    option = "--can" if "can" in model else "--port"
    line = ran.output.splitlines()[-1]
    assert line.startswith(f"Error: --hid {NODE}: ")
    assert f"for instance {option} " in line
