"""``axistwin run``, ``models`` and ``decode`` with a controller, as MAC has them."""

from pathlib import Path

import pytest
import serial
from daemon_process import TIMEOUT_S, assert_one_clear_line, daemon, invoke
from msc_bench import ACK, NAK, dread, dwrite, flag, rqstat

pytestmark = pytest.mark.system

COUNTING = """
from axistwin.macroprogram import Macroprogram, UserFlag, Variable


class Counting(Macroprogram):
    auto_start = True
    count = UserFlag(200)
    counted = Variable(2008, initial=7)

    def scan(self) -> None:
        if self.count:
            self.count = False
            self.counted += 1
"""
STATUS_65 = "06 02 01 00 0F 00 00 52 51 53 54 41 54 2C 00 41 00 00 00 00 00 00 02 5C"


def ask(port: serial.Serial, data: bytes, size: int) -> bytes:
    """Send a request, take the answer, and acknowledge a reply."""
    port.write(data)
    answer = bytes(port.read(size))
    if size > len(ACK):
        port.write(ACK)
    return answer


def test_a_controller_runs_its_program_behind_a_pty(tmp_path: Path) -> None:
    """The ready line names unit and port; a host sets a flag, the program counts it."""
    (tmp_path / "counting.py").write_text(COUNTING, encoding="utf-8")
    with daemon(tmp_path, "msc-250", "--program", "counting.py") as process:
        assert process.line().startswith("ready msc-250:1 pty=./msc-250 (/dev/")
        with serial.Serial(str(tmp_path / "msc-250"), 9600, timeout=TIMEOUT_S) as port:
            assert ask(port, rqstat(), 24) == bytes.fromhex(STATUS_65)
            assert ask(port, flag("SFLAG", 200), 1) == ACK
            counted = bytes(4)
            while counted != (8).to_bytes(4, "big"):
                counted = ask(port, dread(2008), 19)[-6:-2]
        status, _, err = process.end()
    assert status == 0
    assert "Traceback" not in err


def test_a_capture_of_a_controller_is_in_words_and_decodes_to_the_same(tmp_path: Path) -> None:
    """Requests, signs and replies are told by the daemon, and again by ``axistwin decode``."""
    with daemon(tmp_path, "msc-250", "--no-pacing", "--capture", "line.txt") as process:
        process.line()
        with serial.Serial(str(tmp_path / "msc-250"), 9600, timeout=TIMEOUT_S) as port:
            assert ask(port, dwrite(2008, -5), 1) == ACK
            assert len(ask(port, dread(2008), 19)) == 19
            assert ask(port, dread(2008)[:-1] + b"\0", 1) == NAK
        process.end()
    text = (tmp_path / "line.txt").read_text("utf-8")
    told = [row.split("  ")[-1] for row in text.splitlines()[1:]]
    assert told == [
        "DWRITE at 2008: -5 (unit 1)",
        "ACK",
        "DREAD at 2008? (unit 1)",
        "ACK; DREAD = -5 (unit 1)",
        "ACK; DREAD at 2008? (unit 1) [checksum wrong, 0274h is right]",
        "NAK",
    ]
    decoded = invoke("decode", "msc-250", str(tmp_path / "line.txt"))
    assert decoded.exit_code == 0
    assert decoded.stdout == text


def test_units_on_one_line_are_named_one_by_one(tmp_path: Path) -> None:
    """Each with a ready line; each answers its own number, and no other does."""
    with daemon(tmp_path, "msc-250", "msc-generic:15", "--no-pacing") as process:
        lines = [process.line() for _ in range(2)]
        assert [line.split()[1] for line in lines] == ["msc-250:1", "msc-generic:15"]
        with serial.Serial(str(tmp_path / "msc-250"), 9600, timeout=TIMEOUT_S) as port:
            for unit in (1, 15):
                answer = ask(port, rqstat(unit), 24)
                assert (answer[0], answer[2]) == (ACK[0], unit)
            port.timeout = 0.1
            assert ask(port, rqstat(2), 24) == b""
        process.end()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("msc-250:2", "--quirk", "transport=rs232"),
            "msc-250:2: is unit 1, since a controller on RS-232 has no other number",
        ),
        (
            ("msc-250", "mac23"),
            "msc-250:1 at 9600 baud, mac23:0 at 38400 baud: no client understands all of them",
        ),
    ],
)
def test_a_line_that_cannot_be_as_asked_for_is_told_of(
    tmp_path: Path, words: tuple[str, ...], told: str
) -> None:
    """One line each; the twins run all the same."""
    with daemon(tmp_path, *words) as process:
        process.line()
        _, _, err = process.end()
    assert f"axistwin: {told}" in err.splitlines()


def test_a_controller_has_one_rate(tmp_path: Path) -> None:
    """A client at another one is told of; none can be given."""
    with daemon(tmp_path, "msc-850", "--json") as process:
        assert process.event()["device"] == "msc-850:1"
        with serial.Serial(str(tmp_path / "msc-850"), 38400, timeout=0.1) as port:
            ask(port, rqstat(), 24)
            assert process.event()["event"] == "connected"
            told = process.event()
        assert (told["event"], told["baud"], told["module_bauds"]) == ("wrong_rate", 38400, [9600])
    assert_one_clear_line(invoke("run", "msc-250", "--baud", "38400"), "38400", "9600")
    text = invoke("models", "msc-250").stdout
    assert "rate: 9600 baud, always" in text
    text = invoke("models", "msc-250", "stx_while_waiting").stdout
    assert "  stx_while_waiting = serve    [MSC-AMB-27]" in text


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("msc-250:16",), ("16", "1..15")),
        (("msc-250:0",), ("address 0", "1..15")),
        (("msc-25",), ("'msc-25'", "did you mean msc-250?")),
        (("msc-250", "--quirk", "stx_while_waiting=never"), ("never", "serve", "as_nak", "ignore")),
        (("msc-250", "--quirk", "xon_byte=11h"), ("xon_byte", "axistwin models msc-250")),
        (("msc-250", "--program", "bensh"), ("'bensh'", "bench", "FILE.py")),
        (("msc-250", "--program", "2=bench"), ("no unit 2",)),
        (("mac23", "--program", "bench"), ("mac23:0 runs no program",)),
    ],
)
def test_a_mistake_with_a_controller_is_one_clear_line(
    arguments: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    """Units, quirks and programs that do not exist are named, with what does."""
    assert_one_clear_line(invoke("run", *arguments), *parts)


PROGRAM = "from axistwin.macroprogram import *\nclass P(Macroprogram):\n    def run(self):\n"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("        import sys\n        sys.exit(3)\n        yield\n", "p.py:5: SystemExit: 3"),
        ("        yield\n        raise BaseException('odd')\n", "p.py:5: BaseException: odd"),
        ("        while True: pass\n        yield\n", "p.py:4: it did not come back for 5 s"),
        (
            "        try: all(iter(lambda: 1, 0))\n        except Exception: yield\n",
            "p.py:4: it did not come back for 5 s",
        ),
    ],
    ids=["exit", "base", "loop", "loop that catches errors"],
)
def test_a_program_that_ends_or_never_ends_is_told_with_its_line(
    tmp_path: Path, text: str, told: str
) -> None:
    """It stops with a script error, and the run goes on."""
    (tmp_path / "p.py").write_text(PROGRAM + text, encoding="utf-8")
    with daemon(tmp_path, "msc-250", "--program", "p.py", "--json") as process:
        events = {event["event"]: event for event in (process.event(), process.event())}
        assert events.keys() == {"ready", "program_error"}
        assert told in str(events["program_error"]["error"])
        status, _, err = process.end()
    assert status == 0
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("raise BaseException('odd')\n", "p.py:1: BaseException: odd"),
        ("\nwhile True: pass\n", "p.py:2: it did not come back"),
    ],
)
def test_a_program_that_cannot_be_loaded_is_one_clear_line(
    tmp_path: Path, text: str, told: str
) -> None:
    """Whatever it raises, and if it never comes back."""
    (tmp_path / "p.py").write_text(text, encoding="utf-8")
    assert_one_clear_line(invoke("run", "msc-250", "--program", str(tmp_path / "p.py")), told)
