"""`axistwin conform`: what is typed, what is shown, how it exits."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from family_variants import vary
from rich.console import Console

from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.cli import Mistake, conform, make_options, parse_allowed
from axistwin_conformance.core.session import Session
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families import catalog
from axistwin_conformance.report.terminal import TerminalReport
from axistwin_conformance.transport.serial import SerialTransport

LINE, FRAME, MOVE = "MACS-LINE-01", "MACS-FRAME-01", "MACS-CMD-13-01"


def answers(session: Session) -> None:
    """It answers a question."""
    session.target.send(b"Q")
    answer = session.target.receive(1, 0.01)
    session.expect(answer == b"q", None, "q", answer)


def moves(session: Session) -> None:
    """It moves when it is told to."""
    session.target.send(b"M")
    session.expect(session.target.receive(1, 0.01) == b"m", None, "m", "")


def fails(session: Session) -> None:
    """It would have to answer z."""
    session.target.send(b"Q")
    answer = session.target.receive(1, 0.01)
    session.expect(answer == b"z", None, ["z", "Z"], answer.decode())


@pytest.fixture
def bench(toy: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The toy family known to the command, with one passive and one moving check."""

    def open_toy(url: str, rate: int | None, *, is_builtin: bool = False) -> SerialTransport:
        toy.opened.append((url, rate, is_builtin))
        return SerialTransport(toy.port, url, is_builtin=is_builtin)

    known = (*catalog.families(), vary(toy.family, open=open_toy))
    monkeypatch.setattr(catalog, "families", lambda: known)
    toy.add(answers, LINE)
    toy.add(moves, MOVE, safety="motion")
    return toy


def run(*words: str) -> Result:
    """Type a command."""
    return CliRunner().invoke(conform, words)


def test_the_built_in_twin_is_judged_with_everything_allowed(bench: Any) -> None:
    """Exit 0; with -v progress with how far it is, a verdict per requirement; a last sentence."""
    result = run("toy", "-v")
    assert result.exit_code == 0, result.output
    assert "seed 0" in result.output
    assert "[1/2] answers  pass" in result.output
    assert "[2/2] moves  pass" in result.output
    assert "MACS-CMD-13-01" in result.output
    assert result.output.splitlines()[-1].startswith("The device conforms to toy")
    assert bench.opened == [("toy://toy:0", 9600, True)]


def test_a_port_gets_passive_tests_only_unless_more_is_allowed(bench: Any) -> None:
    """And the report says what was left out and how to grant it."""
    result = run("toy", "--port", "/dev/ttyX", "--baud", "4800")
    assert result.exit_code == 0
    assert bench.opened == [("/dev/ttyX", 4800, False)]
    assert bench.port.sent.count("M") == 0
    assert "  not allowed: motion (--allow motion)\n      MACS-CMD-13-01" in result.output
    run("toy", "--port", "/dev/ttyX", "--allow", "motion")
    assert bench.port.sent.count("M") == 1


def test_a_failure_is_explained_down_to_the_bytes(bench: Any) -> None:
    """What was done, expected and came, what the manual asks and where, bytes, replay; exit 1."""
    bench.add(fails, FRAME)
    result = run("toy", "--seed", "9")
    assert result.exit_code == 1
    for part in (
        "FAIL  fails",
        "   The letter Q: q; expected z or Z.",
        "required    MACS-FRAME-01: A request has exactly 21 bytes",
        "(MAC23/34 V24 expert manual r5 (2006), chapter II, chapter III)",
        "host     51  the letter Q",
        "device   71  the letter q",
        "replay      axistwin conform toy --seed 9 fails",
        "does not conform",
    ):
        assert part in result.output


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("tyo",), "did you mean toy?"),
        (("toy", "MACS-LNE-01"), "did you mean MACS-LINE-01?"),
        (("toy", "--allow", "motoin"), "did you mean motion?"),
        (("toy", "--address", "9"), "address 9 is out of range: choose 0 to 7"),
        (("toy", "--address", "3", "--neighbour", "3"), "must differ"),
        (("toy", "MACS-ADDR"), "they begin with MACS-LINE, MACS-FRAME, MACS-REPLY"),
        (("toy", "MACS-CMD-0Z"), "they begin with MACS-CMD-00, MACS-CMD-01"),
        (("toy", "nonsense"), "(--list shows them all)"),
        (("toy", "--port", "127.0.0.1:4001"), "--port socket://127.0.0.1:4001"),
        (("toy", "--port", "[::1]:4001"), "--port socket://[::1]:4001"),
        (("mac23", "--baud", "12345"), "--baud 12345: a mac23 knows 9600, 19200, 38400"),
    ],
)
def test_a_mistake_gets_one_line_and_exit_2(
    bench: Any, words: tuple[str, ...], complaint: str
) -> None:
    """The value, the allowed ones, the remedy; no traceback, nothing opened."""
    result = run(*words)
    assert result.exit_code == 2
    assert complaint in result.output
    assert len(result.output.splitlines()) == 1
    assert bench.opened == []


@pytest.mark.parametrize(
    "words", [("toy", "--level", "slow"), ("toy", "--address", "x"), ("toy", "--seed", "-1"), ()]
)
def test_options_that_cannot_be_read_exit_2(bench: Any, words: tuple[str, ...]) -> None:
    """As every command line program does."""
    assert run(*words).exit_code == 2


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("mac23", "--max-travel", "0"), "0 is out of range: choose 1 to 2147483648"),
        (("mac23", "--max-travel", "9" * 29), "9 is out of range: choose 1 to 2147483648"),
        (("mac23", "--max-speed", "8000001"), "8000001 is out of range: choose 1 to 8000000"),
        (("mac23", "--max-speed", "x"), "'x' is no whole number: choose one of 1 to 8000000"),
        (("mac23", "--jobs", "1025"), "1025 is out of range: choose 1 to 1024"),
        (("mac23", "--baud", "9" * 20), "9 is out of range: choose 1 to 16000000"),
    ],
)
def test_a_number_that_no_device_can_mean_is_refused_with_the_range(
    bench: Any, words: tuple[str, ...], complaint: str
) -> None:
    """From one end of the counter to the other is as far as an axis goes."""
    result = run(*words)
    assert result.exit_code == 2
    assert complaint in result.output


def test_a_run_that_judges_nothing_exits_2(bench: Any) -> None:
    """A selection of forbidden checks is no success."""
    result = run("toy", "--port", "/dev/ttyX", MOVE)
    assert result.exit_code == 2
    assert "Nothing was judged" in result.output
    assert bench.opened == []


def test_a_silent_device_exits_3(bench: Any) -> None:
    """With the reason as the closing sentence."""
    bench.port.is_mute = True
    result = run("toy")
    assert result.exit_code == 3
    assert "Not judged: device unreachable: nothing answers." in result.output
    assert "MACS-" not in result.output, "a table of what was not run would bury the reason"


def test_an_unsettled_run_exits_4(bench: Any) -> None:
    """Nothing failed, but not everything could be settled."""

    def unsure(session: Session) -> None:
        """It might."""
        session.inconclusive(None, "3 of 10 times")

    bench.add(unsure, FRAME)
    result = run("toy")
    assert result.exit_code == 4
    assert "3 of 10 times" in result.output


class Closed(io.StringIO):
    """An output that fails once the toy's digit has been changed."""

    def __init__(self, number: int, port: Any) -> None:
        super().__init__()
        self.number, self.port = number, port

    def write(self, text: str) -> int:
        """Take what comes first."""
        if "P3" in self.port.sent:
            raise OSError(self.number, os.strerror(self.number))
        return super().write(text)


@pytest.mark.parametrize("words", [(), ("--json",)])
@pytest.mark.parametrize(
    ("number", "status", "complaint"),
    [(errno.EPIPE, 141, ""), (errno.ENOSPC, 2, "cannot write the output: No space left")],
)
def test_an_output_nobody_takes_ends_the_run_and_is_no_verdict(
    bench: Any,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: Any,
    number: int,
    status: int,
    complaint: str,
) -> None:
    """`| head -1` and a full disk: the device is put back, and the exit status is no verdict's."""
    monkeypatch.setattr(sys, "stdout", Closed(number, bench.port))

    def stores(session: Session) -> None:
        """It stores a digit."""
        session.target.send(b"P3")
        session.expect(session.target.receive(1, 0.01) == b"p", None, "p", "")

    bench.add(stores, FRAME, safety="stored")
    assert conform.main(["toy", *words], standalone_mode=False) == status
    said = capsys.readouterr().err
    assert complaint in said
    assert "--help" not in said
    assert bench.port.sent.count("P3") == 1
    assert bench.port.stored == "7"
    assert not bench.port.is_open


def test_a_mistake_points_at_the_help_of_this_command(bench: Any) -> None:
    """Not at the program's."""
    with pytest.raises(Mistake) as caught:
        conform.main(["tyo"], "axistwin conform", standalone_mode=False)
    assert caught.value.ctx.command_path == "axistwin conform"


@pytest.mark.system
@pytest.mark.parametrize("name", ["hypothesis", "rich", "jinja2"])
def test_what_is_not_installed_is_named_with_the_remedy(name: str, tmp_path: Path) -> None:
    """In one line, in a Python that lacks it."""
    code = (
        f"import sys; sys.modules[{name!r}] = None; from axistwin_conformance.cli import conform; "
        "conform(['mac23', 'MACS-LINE-01', '--report', sys.argv[1]])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        f"Error: the suite needs {name}: pip install hypothesis jinja2 rich"
    ]


def test_termination_stops_and_puts_back_like_an_interrupt(bench: Any) -> None:
    """SIGTERM in mid-motion: stopped, reported, exit 130, and the handler is as before."""

    def terminated(session: Session) -> None:
        """It is told to go while it moves."""
        session.target.send(b"M")
        os.kill(os.getpid(), signal.SIGTERM)
        session.target.wait(1)

    bench.add(terminated, FRAME, safety="motion")
    before = signal.getsignal(signal.SIGTERM)
    result = run("toy")
    assert result.exit_code == 130
    assert not bench.port.is_moving
    assert "Interrupted" in result.output
    assert signal.getsignal(signal.SIGTERM) is before


def test_the_list_names_every_requirement_and_its_checks(bench: Any) -> None:
    """Nothing runs; a word narrows it."""
    result = run("toy", "--list")
    assert result.exit_code == 0
    assert "MACS-MULTI-03" in result.output
    assert "→ moves" in result.output
    narrowed = run("toy", "--list", "MACS-LINE").output
    assert "MACS-LINE-02" in narrowed
    assert "MACS-FRAME" not in narrowed
    assert bench.opened == []


def test_a_dry_run_shows_the_plan_and_opens_nothing(bench: Any) -> None:
    """Before anything moves."""
    result = run("toy", "--port", "/dev/ttyX", "--dry-run")
    assert result.exit_code == 0
    assert "It answers a question." in result.output
    assert "left out: moves: not allowed: motion" in result.output
    assert bench.opened == []


def test_the_list_and_the_plan_are_one_json_object(bench: Any) -> None:
    """For programs."""
    seen = json.loads(run("toy", "--list", "--json", MOVE).output)
    assert [one["name"] for one in seen["checks"]] == ["moves"]
    assert seen["requirements"][0]["id"] == MOVE


def test_events_are_one_json_object_per_line(bench: Any) -> None:
    """From run_started to run_finished, bytes as hex."""
    bench.add(fails, FRAME)
    result = run("toy", "--json")
    seen = [json.loads(line) for line in result.output.splitlines()]
    assert result.exit_code == 1
    assert seen[0]["event"] == "run_started"
    assert seen[0]["seed"] == 0
    assert seen[-1]["event"] == "run_finished"
    assert seen[-1]["counts"]["fail"] == 1
    failed = next(one for one in seen if one.get("name") == "fails" and "findings" in one)
    assert failed["findings"][0]["transcript"][-1]["data"] == "71"


def test_a_report_holds_the_whole_run(bench: Any, tmp_path: Path) -> None:
    """Run, device, checks, requirements with their source, and the end."""
    result = run("toy", "--report", str(tmp_path / "new" / "place"))
    assert result.exit_code == 0
    report = json.loads((tmp_path / "new" / "place" / "report.json").read_text())
    assert report["run"]["model"] == "toy"
    assert report["device"]["values"] == {"release": "1"}
    assert [one["name"] for one in report["checks"]] == ["answers", "moves"]
    assert len(report["requirements"]) == 136
    assert all(one["source"] for one in report["requirements"])
    assert report["finished"]["exit_status"] == 0


def test_a_report_that_cannot_be_written_is_one_line(bench: Any, tmp_path: Path) -> None:
    """And known before the run, not after it."""
    (tmp_path / "file").write_text("")
    result = run("toy", "--report", str(tmp_path / "file" / "below"))
    assert result.exit_code == 2
    assert result.output.startswith("Error: cannot write the report")
    assert bench.opened == []


def test_on_a_terminal_a_bar_runs_and_passes_are_not_told_one_by_one(bench: Any) -> None:
    """Only what is not a pass interrupts the bar."""
    bench.add(fails, FRAME)
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=100, color_system=None)
    with TerminalReport(console, load_ledger("mac_serial"), bench.family.explain) as report:
        Engine(make_options(model="toy")).run(report)
    shown = out.getvalue()
    assert "2/3" in shown
    assert "[2/3] fails  fail" in shown
    assert "] answers  pass" not in shown


@pytest.mark.parametrize("text", ["motion,stored", " stored , motion ", "motion,stored,"])
def test_permissions_are_read_with_passive_always_among_them(text: str) -> None:
    """Commas and blanks as people type them."""
    assert parse_allowed(text, is_builtin=False) == {"passive", "motion", "stored"}


@pytest.mark.parametrize("text", ["5", "0x05", "05h", "5H"])
def test_addresses_are_read_as_manuals_write_them(bench: Any, text: str) -> None:
    """Decimal, C and Intel spelling."""
    result = run("toy", "--address", text)
    assert result.exit_code == 0
    assert "address 5" in result.output


def test_the_twin_s_neighbour_stays_in_range(bench: Any) -> None:
    """At the last address it wraps round."""
    assert make_options(model="toy", address=7).neighbours == (0,)
