"""The Python printed in README.md and docs/ runs, and says what is printed."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import can
import pytest
from daemon_process import daemon, invoke

from axistwin import testing

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
README, PYTEST_PAGE = ROOT / "README.md", ROOT / "docs" / "how-to" / "use-pytest.md"
CAN_PAGE = ROOT / "docs" / "how-to" / "use-python-can.md"
HID_PAGE = ROOT / "docs" / "how-to" / "use-hid.md"
PROGRAM_PAGE = ROOT / "docs" / "how-to" / "write-a-macroprogram.md"
CONTOUR_PAGE = ROOT / "docs" / "how-to" / "drive-a-contour.md"
RUN_ELSEWHERE = {
    ROOT / "docs" / "how-to" / "use-pyserial.md": 2,  # blocks, by test_url_lines.py
    ROOT / "docs" / "how-to" / "run-on-can.md": 1,  # by test_run_can.py
    ROOT / "docs" / "how-to" / "break-the-wire.md": 1,  # by test_wire_faults_served.py
}


def python_blocks(page: Path) -> list[str]:
    """What stands between the fences of Python."""
    return re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def run_tests(folder: Path, text: str, passed: int) -> None:
    """Run ``text`` as a test file of its own, in which that many tests have to pass."""
    path = folder / "test_printed.py"
    path.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(path)]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{passed} passed" in done.stdout


def without_remark(line: str) -> str:
    """A printed result without what is said about it."""
    return re.sub(r"\s+# .*$", "", line)


def test_the_readmes_session_prints_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Line by line, as typed into Python beside a twin at ./mac23."""
    session = python_blocks(README)[0]
    names: dict[str, Any] = {}
    monkeypatch.chdir(tmp_path)
    with testing.start("mac23") as twin:
        (tmp_path / "mac23").symlink_to(twin.port)
        typed = re.findall(r"^>>> (.*)\n((?:(?!>>> ).+\n)*)", session, re.MULTILINE)
        assert len(typed) == session.count(">>> ") == 6
        for statement, printed in typed:
            if printed:
                assert repr(eval(statement, names)) == without_remark(printed.rstrip("\n"))
            else:
                exec(statement, names)
        names["port"].close()


def test_the_readmes_url_answers() -> None:
    """The port of the second block is a twin's."""
    names: dict[str, Any] = {}
    exec(python_blocks(README)[1], names)
    with names["port"] as port:
        port.write(b"\x0201400200000000000A2\x03")
        assert port.read(21) == b"\x06\x13\x020110000000000010\x03\x1a"


def test_the_readmes_test_passes_beside_the_driver_that_it_names(tmp_path: Path) -> None:
    """The third block, in the folder where the page says."""
    shutil.copy(ROOT / "fixtures" / "example-project" / "mac_driver.py", tmp_path)
    run_tests(tmp_path, python_blocks(README)[2], passed=1)


def test_the_readmes_bus_answers() -> None:
    """The bus of the fourth block carries both modules."""
    names: dict[str, Any] = {}
    exec(python_blocks(README)[3], names)
    with names["bus"] as bus:
        for address in (1, 2):
            data = bytes.fromhex("4000200000000000")  # position?
            bus.send(can.Message(arbitration_id=0x600 + address, data=data, is_extended_id=False))
            assert bus.recv(1).arbitration_id == 0x580 + address


def test_the_blocks_of_the_can_page_hold(capsys: pytest.CaptureFixture[str]) -> None:
    """One after the other, with every assertion in them; the transcript is in words."""
    names: dict[str, Any] = {}
    for block in python_blocks(CAN_PAGE):
        exec(block, names)
    assert "602#23132000FFFFFC18  2013h go to position -1000 -> module 2" in capsys.readouterr().out


def test_the_blocks_of_the_hid_page_hold() -> None:
    """With every assertion in them, each by itself."""
    for block in python_blocks(HID_PAGE):
        exec(block, {})


def test_the_tests_of_the_how_to_pass(tmp_path: Path) -> None:
    """All blocks of docs/how-to/use-pytest.md in one file."""
    run_tests(tmp_path, "\n\n".join(python_blocks(PYTEST_PAGE)), passed=9)


def test_the_programs_of_the_page_on_macroprograms_run(tmp_path: Path) -> None:
    """All blocks in one file, the tests among them pass."""
    run_tests(tmp_path, "\n\n".join(python_blocks(PROGRAM_PAGE)), passed=5)


def test_the_contour_of_the_page_is_driven_recorded_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its own lines and commands; the recording is all that the picture needs."""
    monkeypatch.chdir(tmp_path)
    (block,) = python_blocks(CONTOUR_PAGE)
    typed, printed = re.search(
        r"^\$ axistwin (plot .*--capture.*)\n(.*)\n", CONTOUR_PAGE.read_text("utf-8"), re.M
    ).groups()  # type: ignore[union-attr]  # or else the test fails, as it should
    with daemon(tmp_path, "mn400", "--capture", "contour.txt", "--speed", "20") as process:
        process.line()
        exec(block, {})
        process.end()
    result = invoke(*shlex.split(typed))
    assert result.exit_code == 0, result.output
    assert result.stdout.rpartition(" s")[0][:-1] == printed.rpartition(" s")[0][:-1]
    assert result.stderr == ""


@pytest.mark.parametrize("number", range(4))
def test_what_else_can_be_drawn_is_drawn(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each command of the page that needs nothing else."""
    monkeypatch.chdir(tmp_path)
    part = CONTOUR_PAGE.read_text("utf-8").partition("## What else can be drawn")[2]
    typed = re.findall(r"^\$ axistwin (plot .*)$", part, re.MULTILINE)
    assert len(typed) == 4
    result = invoke(*shlex.split(typed[number], comments=True))
    assert result.exit_code == 0, result.output


def test_the_recordings_of_the_page_are_replayed_as_it_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each command with its whole output."""
    monkeypatch.chdir(ROOT)
    page = (ROOT / "docs" / "how-to" / "record-and-replay.md").read_text("utf-8")
    found = re.findall(r"^\$ axistwin (replay .*)\n((?:(?!\$ |```).*\n)+)", page, re.MULTILINE)
    assert len(found) == 3
    for typed, printed in found:
        assert invoke(*shlex.split(typed)).stdout == printed


def test_no_block_of_python_is_left_out() -> None:
    """A new one in any page has to be run by a test too."""
    pages = [README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    found = {page: len(blocks) for page in pages if (blocks := python_blocks(page))}
    assert found == {
        README: 4,
        CAN_PAGE: 2,
        HID_PAGE: 2,
        PROGRAM_PAGE: 4,
        PYTEST_PAGE: 5,
        CONTOUR_PAGE: 1,
        **RUN_ELSEWHERE,
    }
