"""`axistwin conform` on a CAN bus: what may be typed, what is told."""

from __future__ import annotations

import io
import json
import logging
from pathlib import Path
from typing import Any

import can
import pytest
from bus_in_front import BITRATE, BusInFront, twin_bus
from click.testing import CliRunner, Result
from rich.console import Console

from axistwin_conformance.base.events import Event
from axistwin_conformance.cli import conform, make_options
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.report import html, junit
from axistwin_conformance.report import json as report_json
from axistwin_conformance.report.terminal import TerminalReport
from axistwin_conformance.transport.can import CanTransport
from axistwin_conformance.transport.kinds import BUS
from axistwin_conformance.transport.rig import choose_rig

ONE = "the_release_is_eight_digits_that_stay"
TWIN = "axistwin:mac23-can:5?time=virtual"


def run(*words: str) -> Result:
    """Type a command."""
    return CliRunner().invoke(conform, list(words))


# --- mistakes -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("mac23-can", "--port", "/dev/ttyUSB0"), "a mac23-can is on a bus: --can INTERFACE:CHANN"),
        (
            ("mac23", "--can", "socketcan:can0"),
            "a mac23 is on a line: --port URL, for instance --p",
        ),
        (("mac23-can", "--baud", "9600"), "a mac23-can is on a bus; its rate is --bitrate"),
        (("mac23", "--bitrate", "500000"), "a mac23 is on a line; its rate is --baud"),
        (("msc-250", "--can", "socketcan:can0"), "an msc-250 is on a line: --port URL, for inst"),
        (("msc-250", "--baud", "300"), "--baud 300: an msc-250 knows 9600"),
        (("mac23-can", "--can", "sokcetcan:can0"), "no interface 'sokcetcan'; did you mean socket"),
        (
            ("mac23-can", "--can", "can0"),
            "--can 'can0' is no INTERFACE:CHANNEL; write for instance",
        ),
        (("mac23-can", "--can", "socketcan:"), "is no INTERFACE:CHANNEL"),
        (("mac23-can", "--can", "slcan:x?sleep"), "write options as ?name=value&name=value"),
        (("mac23-can", "--address", "0"), "address 0 is out of range: choose 1 to 127"),
        (("mac23-can", "--address", "80h"), "address 128 is out of range: choose 1 to 127"),
        (("mac23-can", "--address", "2", "--neighbour", "2"), "must differ"),
        (("mac23-can", "--can", "slcan:./x", "--rig", "twin"), "--can axistwin:..."),
        (
            ("mac23-can", "--can", "slcan:x?bitrate=20000", "--bitrate", "50000"),
            "x?bitrate=20000 sa",
        ),
    ],
)
def test_a_mistake_gets_one_line_and_exit_2(words: tuple[str, ...], complaint: str) -> None:
    """The value and the remedy; a line's words for a bus, and the other way round, among them."""
    result = run(*words)
    assert result.exit_code == 2
    assert complaint in result.output
    assert len(result.output.splitlines()) == 1


@pytest.mark.parametrize("bitrate", ["9999", "1000001", "x"])
def test_a_bit_rate_that_no_bus_has_is_a_mistake(bitrate: str) -> None:
    """From 10 kbit/s to 1 Mbit/s."""
    assert run("mac23-can", "--bitrate", bitrate).exit_code == 2


@pytest.mark.system
@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("slcan:/nowhere/tty", "cannot open slcan:/nowhere/tty: No such file or directory"),
        ("seeedstudio:/nowhere/tty", "No such file or directory"),
        ("pcan:PCAN_USBBUS1", "cannot open pcan:PCAN_USBBUS1: "),
        ("kvaser:0", "cannot open kvaser:0: "),
        ("axistwin:mac23-can:1?time=virtual&nonsense=1", "nonsense"),
    ],
)
def test_an_interface_that_cannot_be_opened_is_one_line_and_exit_3(
    words: str, reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    """No such device, no driver: with the reason, and nothing else on the terminal."""
    with caplog.at_level(logging.CRITICAL, "can"):
        result = run("mac23-can", "--can", words)
    assert result.exit_code == 3
    last = result.output.splitlines()[-1]
    assert last.startswith("Not judged: device unreachable: cannot open ")
    assert reason in last
    assert "Traceback" not in result.output


# --- the run --------------------------------------------------------------------------------------


def test_a_bus_gets_passive_tests_only_unless_more_is_allowed() -> None:
    """Also where a twin of this process is behind the words."""
    options = make_options(model="mac23-can", can=TWIN, address=5)
    assert options.allowed == {"passive"}
    assert not options.is_builtin
    assert options.is_twin
    assert {one for check in Engine(options).plan().to_run for one in check.safety} == {"passive"}
    granted = make_options(model="mac23-can", can=TWIN, address=5, allow="motion,stored")
    assert granted.allowed == {"passive", "motion", "stored"}


def test_the_built_in_twin_has_a_neighbour_at_the_next_address() -> None:
    """Behind the last address comes the first."""
    assert make_options(model="mac23-can").url == "axistwin:mac23-can:1,mac23-can:2?time=virtual"
    assert make_options(model="mac23-can", address=127).neighbours == (1,)


def test_the_replay_command_repeats_interface_rate_and_bounds() -> None:
    """One command, ready to paste."""
    options = make_options(
        model="mac23-can", can="slcan:./my twin", bitrate=500_000, address=7, neighbours=(9,),
        allow="motion", ids=(ONE,),
    )  # fmt: skip
    assert options.command == (
        "axistwin conform mac23-can --can 'slcan:./my twin' --bitrate 500000 --allow motion"
        " --max-travel 2000 --max-speed 10000 --eeprom-budget 2000 --neighbour 9"
        f" --address 7 --seed 0 {ONE}"
    )
    plain = make_options(model="mac23-can", can="socketcan:can0")
    assert "bitrate" not in plain.command
    assert make_options(model="mac23-can", bitrate=500_000).url.endswith("&bitrate=500000")


def test_a_twin_named_on_the_bus_is_its_own_rig() -> None:
    """The rig acts through its handles; on another bus somebody has to be named."""
    for url, kind in ((TWIN, "twin"), ("slcan:./x", "")):
        choice = choose_rig(
            None, None, url, is_allowed=True, capabilities=frozenset(), transport_kind=BUS
        )
        assert choice.kind == kind
    result = run(
        "mac23-can", "--can", TWIN, "--address", "5", "--allow", "motion,stored,rig",
        "overheating_locks_motion",
    )  # fmt: skip
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize("bitrate", [20_000, 1_000_000])
def test_any_bit_rate_will_do(bitrate: int) -> None:
    """The built-in twin's bus takes it over; reports say it."""
    result = run("mac23-can", "--bitrate", str(bitrate), "--json", ONE, "MACC-CMD-13-02")
    assert result.exit_code == 0, result.output
    started, *_ = (json.loads(line) for line in result.stdout.splitlines())
    assert (started["carrier"], started["baud"], started["bitrate"]) == ("bus", None, bitrate)


def test_list_and_dry_run_know_the_bus() -> None:
    """Requirements of CAN with their checks; what would be done, and the safety classes."""
    listed = run("mac23-can", "--list").output
    assert "MACC-Q-04-01" in listed
    assert ONE in listed
    planned = run("mac23-can", "--can", "socketcan:can0", "--dry-run").output
    assert "left out: " in planned
    assert "not allowed: motion" in planned
    assert ONE in planned


# --- reports --------------------------------------------------------------------------------------


class Restless(BusInFront):
    """A module whose release is another one each time."""

    answered = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hand on."""
        self.bus.send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Hand on, but for the release."""
        message: can.Message | None = self.bus.recv(timeout)
        if message is not None and bytes(message.data[:3]) == b"\x42\x04\x20":
            self.answered += 1
            message.data[7] = self.answered
        return message

    def shutdown(self) -> None:
        """Close."""
        self.bus.shutdown()


@pytest.fixture
def failed() -> tuple[Engine, list[Event]]:
    """A run in which a requirement fails."""
    options = make_options(model="mac23-can", ids=(ONE,), bitrate=BITRATE)

    def opened(neighbours: tuple[int, ...]) -> CanTransport:
        url = options.family.twin_url(options.model, options.address, neighbours)
        return CanTransport(
            Restless(twin_bus(url)), url, is_spontaneous=codec.is_spontaneous, bitrate=BITRATE,
            is_builtin=True,
        )  # fmt: skip

    engine, told = Engine(options, opened), list[Event]()
    assert engine.run(told.append).exit_status == 1
    return engine, told


def report_of(engine: Engine, told: list[Event]) -> Any:
    """The report of a run."""
    family = engine.family
    return report_json.fold(
        report_json.event_object(one, family.explain, family.transport_kind.spell) for one in told
    )


def test_reports_show_frames_with_their_identifiers(failed: tuple[Engine, list[Event]]) -> None:
    """As candump writes them, and in words: JSON, page and JUnit alike; with interface and rate."""
    report = report_of(*failed)
    records = [
        record
        for check in report["checks"]
        for finding in check["findings"]
        for record in finding["transcript"]
        if record["data"]
    ]
    assert {"601#4004200000000000"} <= {one["data"] for one in records}
    assert any(one["data"].startswith("581#42042000000007") for one in records)
    assert any("answer 2004h" in one["decoded"] for one in records)
    page, xml = html.render(report), junit.junit(report)
    for text in (page, xml):
        assert "601#4004200000000000" in text
        assert "125000" in text
    assert "<dt>Interface</dt>" in page
    assert "1, 125000 bit/s; neighbour 2" in page
    assert '<property name="carrier" value="bus" />' in xml
    assert 'name="baud"' not in xml


def test_the_terminal_says_bus_rate_and_frames(failed: tuple[Engine, list[Event]]) -> None:
    """In its words."""
    engine, told = failed
    console = Console(file=io.StringIO(), width=120)
    family = engine.family
    with TerminalReport(
        console, engine.ledger, family.explain, spell=family.transport_kind.spell
    ) as report:  # fmt: skip
        for one in told:
            report(one)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for part in ("address 1, 125000 bit/s", "bus      idle round trip", "581#42042000000007"):
        assert part in text


def test_the_folder_of_a_report_holds_the_same(tmp_path: Path) -> None:
    """Written by the command."""
    result = run("mac23-can", ONE, "--report", str(tmp_path))
    assert result.exit_code == 0
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "bit rate as the interface is set" in text
