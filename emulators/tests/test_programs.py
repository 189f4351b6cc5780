"""Programs found by name and in files, and the one that comes with axistwin."""

import sys
from pathlib import Path

import pytest
from msc_bench import ACK, MscBench, bread, bwrite, flag
from program_bench import BAD_OPCODE, RUNNING, ProgramBench

from axistwin.errors import UsageError
from axistwin.macroprogram import Macroprogram
from axistwin.programs import find_program
from axistwin.programs.bench import Bench

HEAD = "from axistwin.macroprogram import *\n\n"
GOOD = HEAD + "class Table(Macroprogram):\n    def scan(self):\n        pass\n"

COUNT, PULSE, HALT, TIMED, TIMER = 240, 241, 242, 243, 32
COUNTER, TICKS, PULSES, TORN, BLOCK = 6144, 6148, 6152, 6156, 6272


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The present one, empty."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def found(source: str) -> type[Macroprogram]:
    """The class that ``source`` means."""
    program = find_program(source)
    assert isinstance(program, type)
    return program


# -- files -------------------------------------------------------------------------------------


def test_the_only_program_of_a_file_is_found(folder: Path) -> None:
    """By the file's name, as text or path; a class of another module is not it."""
    text = GOOD + "from axistwin.programs.bench import Bench\n"
    (folder / "table.py").write_text(text, encoding="utf-8")
    assert found("table.py").__name__ == "Table"
    assert found(str(folder / "table.py")).__name__ == "Table"
    program = find_program(folder / "table.py")
    assert isinstance(program, type)
    assert program.__name__ == "Table"


def test_one_of_several_programs_is_named(folder: Path) -> None:
    """Behind a colon."""
    text = GOOD + "class Press(Table):\n    pass\n"
    (folder / "two.py").write_text(text, encoding="utf-8")
    assert found("two.py:Press").__name__ == "Press"
    assert found("two.py:Table").__name__ == "Table"


def test_a_class_is_taken_as_it_is() -> None:
    """So is a function that makes an object."""
    assert find_program(Bench) is Bench


def test_what_stands_beside_a_file_can_be_imported(folder: Path) -> None:
    """And the search path is as before."""
    (folder / "helper_of_table.py").write_text("NUMBER = 20\n", encoding="utf-8")
    text = HEAD + (
        "from helper_of_table import NUMBER\n"
        "class Table(Macroprogram):\n"
        "    lamp = Output(NUMBER)\n"
        "    def scan(self):\n"
        "        self.lamp = True\n"
    )
    (folder / "table.py").write_text(text, encoding="utf-8")
    path = [*sys.path]
    assert ProgramBench(found("table.py")).at(0).is_on(20)
    assert sys.path == path


def test_a_file_is_read_anew_each_time(folder: Path) -> None:
    """An edit counts at once."""
    (folder / "table.py").write_text(GOOD, encoding="utf-8")
    assert found("table.py").__name__ == "Table"
    (folder / "table.py").write_text(GOOD.replace("Table", "Bench"), encoding="utf-8")
    assert found("table.py").__name__ == "Bench"
    assert not (folder / "__pycache__").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\n", "program bad.py: has no class derived from Macroprogram; write one"),
        (GOOD.replace("(self):", "(self)"), "program bad.py:4: expected ':'"),
        ("\n\n\nlamp = Output(20)\n", "program bad.py:4: NameError: name 'Output' is not defined"),
        (HEAD + "lamp = Output(256)\n", "program bad.py:3: Output(256) is not allowed; give"),
        ("import nothing_of_this_name\n", "program bad.py:1: ModuleNotFoundError: No module named"),
        ("raise SystemExit(3)\n", "program bad.py:1: SystemExit: 3"),
        ("def f():\n    1 / 0\nf()\n", "program bad.py:2: ZeroDivisionError: division by zero"),
        ("a = '\0'\n", "program bad.py: source code string cannot contain null bytes"),
        (
            GOOD + "class B(Table):\n    pass\n",
            "program bad.py: has 2 programs; write bad.py:Table",
        ),
    ],
)
def test_a_bad_file_is_told_in_one_line(folder: Path, text: str, message: str) -> None:
    """With the line that is wrong, where there is one."""
    (folder / "bad.py").write_text(text, encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        find_program("bad.py")
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_a_file_in_another_encoding_is_told(folder: Path) -> None:
    """Python says which byte."""
    (folder / "bad.py").write_bytes(b"name = '\xe4'\n")
    with pytest.raises(UsageError, match=r"program bad\.py.*utf-8"):
        find_program("bad.py")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (
            "none.py",
            "program none.py: cannot be read (No such file or directory); give an existing",
        ),
        (".py", "program .py: cannot be read"),
        ("bnch", "unknown program 'bnch': did you mean bench?; one of yours is FILE.py or"),
        (
            "table",
            "unknown program 'table': known: bench; one of yours is FILE.py or FILE.py:CLASS",
        ),
        ("table.py:Tabel", "program table.py: no class Tabel: did you mean Table?"),
        ("empty.py:Table", "program empty.py: no class Table: it has no class of Macroprogram"),
    ],
)
def test_what_is_not_found_is_told_with_what_there_is(
    folder: Path, source: str, message: str
) -> None:
    """Files, names and classes."""
    (folder / "table.py").write_text(GOOD, encoding="utf-8")
    (folder / "empty.py").write_text("", encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        find_program(source)
    assert str(caught.value).startswith(message)


def test_an_error_while_it_runs_names_the_line_of_the_file(folder: Path) -> None:
    """As an error at its loading does."""
    text = GOOD.replace("pass", "self.absent")
    (folder / "table.py").write_text(text, encoding="utf-8")
    bench = ProgramBench(found("table.py")).at(0)
    assert bench.word == BAD_OPCODE
    assert bench.runner.error is not None
    assert bench.runner.error.startswith("table.py:5: AttributeError: Table has no absent")


# -- the bench program -------------------------------------------------------------------------


@pytest.fixture
def bench() -> ProgramBench:
    """The bench program, one scan old."""
    return ProgramBench(found("bench")).at(0)


def test_the_bench_program_counts_its_scans(bench: ProgramBench) -> None:
    """One every 10 ms."""
    assert bench.at(995).value(TICKS) == 100


def test_the_bench_program_counts_a_flag_and_clears_it(bench: ProgramBench) -> None:
    """In each scan in which it is on."""
    for turn in range(1, 4):
        bench.set(COUNT)
        bench.at(bench.now / 1e6 + 10)
        assert (bench.is_on(COUNT), bench.value(COUNTER)) == (False, turn)


def test_the_bench_program_counts_rises_and_leaves_the_flag(bench: ProgramBench) -> None:
    """Once for each time it comes on."""
    for turn in range(1, 4):
        bench.set(PULSE)
        bench.at(bench.now / 1e6 + 50)
        assert (bench.is_on(PULSE), bench.value(PULSES)) == (True, turn)
        bench.clear(PULSE)
        bench.at(bench.now / 1e6 + 50)


def test_the_bench_program_stops_itself(bench: ProgramBench) -> None:
    """And clears the flag that told it to."""
    bench.set(HALT)
    bench.at(10)
    assert (bench.is_on(HALT), bench.word & RUNNING) == (False, 0)
    assert bench.at(1000).value(TICKS) == 2


def test_the_bench_program_starts_its_timer(bench: ProgramBench) -> None:
    """For 250 ms from the scan that saw the rise."""
    bench.set(TIMED)
    assert bench.at(10).is_on(TIMER)
    assert not bench.is_on(TIMED)
    assert bench.at(259.999).is_on(TIMER)
    assert not bench.at(260).is_on(TIMER)


@pytest.mark.parametrize("stride", [4, 2, 1])
def test_the_bench_program_sees_torn_blocks(stride: int) -> None:
    """First and last value differ; at any stride the variables are where the host expects them."""
    bench = ProgramBench(Bench, data_address_stride=stride).at(0)
    bench.data.write(BLOCK + 31 * stride, 7)
    assert (bench.at(20).value(TORN), bench.value(TICKS)) == (2, 3)
    bench.data.write(BLOCK, 7)
    assert bench.at(100).value(TORN) == 2


def running(line: MscBench) -> MscBench:
    """The bench program in the controller on ``line``."""
    line.perform(line.device.load_program(0, Bench))
    line.perform(line.device.start_program(0))
    return line


@pytest.mark.parametrize(("atomic", "is_torn"), [(True, False), (False, True)])
def test_a_block_is_torn_if_the_unit_tears_it(atomic: bool, is_torn: bool) -> None:
    """MSC-AMB-42; what the host reads afterwards is whole."""
    line = running(MscBench(bwrite_atomic=atomic))
    for turn in range(1, 6):
        assert line.ask(bwrite(BLOCK, [turn] * 32)) == ACK
    assert (line.value(TORN) > 0) is is_torn
    assert line.ask(bread(BLOCK))[13:-2] == (5).to_bytes(4, "big") * 32
    assert line.device.status_at(line.now) == RUNNING


@pytest.mark.parametrize(("visibility", "pulses"), [("next_scan", 0), ("immediate", 1)])
def test_a_pulse_of_the_host_may_be_too_short(visibility: str, pulses: int) -> None:
    """MSC-AMB-33: set and cleared between two scans (slow ones here)."""
    line = running(MscBench(write_visibility=visibility, scan_ms=1000))
    line.wait(100)
    assert line.tell(flag("SFLAG", PULSE), 40) == ACK
    assert line.tell(flag("CFLAG", PULSE), 40) == ACK
    line.wait(2000)
    assert line.value(PULSES) == pulses
