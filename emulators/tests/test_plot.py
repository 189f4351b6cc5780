"""``axistwin plot``: pictures, and one clear line for each mistake."""

import importlib.abc
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest
from daemon_process import assert_one_clear_line, daemon, invoke

from axistwin.cli.plot import drawing

pytestmark = pytest.mark.system

PNG = b"\x89PNG\r\n\x1a\n"
DARK, PAPER = "#0d1117", "#ffffff"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where pictures are written."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def texts_of(name: str) -> list[str]:
    """The words in a picture."""
    root = ElementTree.fromstring(Path(name).read_text("utf-8"))
    return ["".join(each.itertext()).strip() for each in root.iter() if each.tag.endswith("}text")]


# ---- pictures ------------------------------------------------------------------------------------


def test_a_picture_has_axes_with_units_and_names() -> None:
    """Path, position and rate; what was replied stands on the terminal."""
    result = invoke("plot", "mn400", "V3000", "M2000,-500", "-o", "move.svg", "--title", "A & B")
    assert result.exit_code == 0, result.output
    assert (
        "< 81 4D 03 00 81 52 81 4D 05 00 81 54  Mover: START (board 1); Mover: DONE"
        in result.stdout
    )
    assert result.stdout.splitlines()[-1] == "move.svg: M1, M2, 0.800 s"
    words = texts_of("move.svg")
    for text in (
        *("A & B", "M1 [steps]", "M2 [steps]", "position [steps]", "rate [steps/s]", "time [s]"),
        *("start", "end", "M1", "M2", "3000"),
    ):
        assert text in words


def test_a_single_axis_has_no_path() -> None:
    """Nor needs it a name in the picture; PNG is what is written unless told otherwise."""
    result = invoke("plot", "mac23", "go to 1000")
    assert result.exit_code == 0, result.output
    assert Path("mac23.png").read_bytes().startswith(PNG)
    invoke("plot", "mac23", "go to 1000", "-o", "ramp.svg")
    words = texts_of("ramp.svg")
    assert "position [increments]" in words
    assert "rate [increments/s]" in words
    assert "start" not in words


def test_a_helix_is_seen_from_three_sides() -> None:
    """Or from those that are named."""
    helix = ("plot", "mn400", "+-100,0,-200,0,1,-50,1")
    invoke(*helix, "-o", "all.svg")
    labels = [word for word in texts_of("all.svg") if word.startswith("M") and "[" in word]
    assert labels == [
        "M1 [steps]",
        "M2 [steps]",
        "M1 [steps]",
        "M3 [steps]",
        "M2 [steps]",
        "M3 [steps]",
    ]
    invoke(*helix, "-o", "one.svg", "--planes", "M3-M1", "--axes", "M2")
    words = texts_of("one.svg")
    assert [word for word in words if word.startswith("M")] == ["M3 [steps]", "M1 [steps]"]


def test_the_same_motion_is_the_same_picture() -> None:
    """Byte by byte, in both forms."""
    for form in ("png", "svg"):
        for name in ("one", "two"):
            invoke("plot", "mn400", "M300,200", "-o", f"{name}.{form}", "--title", "x")
        assert Path(f"one.{form}").read_bytes() == Path(f"two.{form}").read_bytes()


def test_a_twin_on_can_is_drawn_too() -> None:
    """Its frames stand on the terminal."""
    result = invoke("plot", "mac23-can:5", "go to 100", "-o", "can.svg")
    assert result.exit_code == 0, result.output
    assert "> 605#2313200000000064" in result.stdout


# ---- colours -------------------------------------------------------------------------------------


def luminance(colour: str) -> float:
    """Relative luminance (WCAG 2)."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(colour: str, ground: str) -> float:
    """Contrast ratio (WCAG 2)."""
    lighter, darker = sorted((luminance(colour), luminance(ground)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


@pytest.mark.parametrize("ground", [PAPER, DARK], ids=["paper", "dark"])
def test_everything_is_legible_on_paper_and_on_a_dark_page(ground: str) -> None:
    """Lines as WCAG 2 asks of graphics, words nearly as it asks of text; nothing is behind them."""
    assert all(contrast(colour, ground) >= 3 for colour in drawing.LINES)
    assert contrast(drawing.WORDS, ground) > 4.2
    invoke("plot", "mn400", "M300,200", "-o", "move.svg")
    grounds = re.findall(
        r'id="patch_1">\s*<path[^>]*style="fill: none', Path("move.svg").read_text()
    )
    assert grounds


def test_axes_are_told_apart_without_colours() -> None:
    """Each has a form of its own."""
    assert len(set(drawing.FORMS)) == len(drawing.FORMS) == len(set(drawing.LINES)) == 4


# ---- recordings and devices ----------------------------------------------------------------------


def test_a_twin_is_recorded_and_drawn(folder: Path) -> None:
    """What is drawn has the motion of the program that was recorded."""
    with daemon(folder, "mn400", "--capture", "traffic.txt", "--speed", "20") as process:
        process.line()
        assert invoke("send", "./mn400", "V3000", "M2000,-500", "wait 100 ms", "E").exit_code == 0
        process.end()
    result = invoke("plot", "mn400", "--capture", "traffic.txt", "-o", "move.svg")
    assert result.exit_code == 0, result.output
    assert re.fullmatch(r"move\.svg: M1, M2, 0\.(799|80.) s\n", result.stdout)
    assert "mn400: traffic.txt" in texts_of("move.svg")
    changed = (
        Path("traffic.txt").read_text("utf-8").replace("81 4D 05 00 81 54", "81 4D 0E 00 81 5D")
    )
    Path("other.txt").write_text(changed, "utf-8")
    result = invoke("plot", "mn400", "--capture", "other.txt", "-o", "move.svg")
    assert result.exit_code == 0
    assert "1 of 3 replies of the twin are not those recorded, first 'Mover: START" in result.stderr


def test_a_live_device_is_asked_where_it_is(folder: Path) -> None:
    """Its own line tells how often; the picture has a point for each answer."""
    with daemon(folder, "mn400", "--speed", "20") as process:
        process.line()
        result = invoke(
            *("plot", "mn400", "--live", "./mn400", "V500", "M4000,1000", "--seconds", "1.5"),
            *("-o", "live.svg"),
        )
        process.end()
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("live.svg: M1, M2, ")
    drawn = Path("live.svg").read_text("utf-8")
    assert drawn.count("<use ") > 20


def test_a_port_where_nothing_answers_is_one_clear_line(folder: Path) -> None:
    """And one that is not there."""
    with daemon(folder, "mac23", "--pty", "./port") as process:
        process.line()
        live = ("plot", "mn400", "--live", "./port", "--seconds", "0.5")
        assert_one_clear_line(
            invoke(*live), "./port: no position came back; is a mn400 there, at 1?"
        )
        process.end()
    assert_one_clear_line(invoke("plot", "mn400", "--live", "./none"), "./none")


# ---- mistakes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("mn400",), "nothing to draw is given; give commands, or one of --program"),
        (("mn400", "M5", "--capture", "x"), "commands and --capture are given"),
        (("mn400", "M5", "-o", "x.gif"), "x.gif: the name of the picture ends with .png or .svg"),
        (("mn400", "M5", "-o", "none/x.png"), "none/x.png: cannot be written (No such file"),
        (("mn400", "hopp"), "'hopp' is no command"),
        (("mn400", "M5", "--axes", "M9"), "axis 'M9': known: M1, M2, M3, M4"),
        (("mn400", "M5", "--set", "spindle_hz"), "--set 'spindle_hz': write NAME=VALUE"),
        (("mn400", "M5", "--set", "spindl=1"), "did you mean spindle_hz?"),
        (("mn400", "M5", "--baud", "9600"), "--baud: is for --live"),
        (("mn400", "--live", "./x", "--quirk", "a=b"), "--quirk: is for a twin"),
        (("mn400", "--live", "axistwin://mn400"), "leave --live out"),
        (("mn400", "--capture", "none"), "none: cannot be read (No such file or directory)"),
        (("mn400", "M5", "--quirk", "dda_fase=zero"), "did you mean dda_phase?"),
        (("msc-250", "RQSTAT"), "msc-250 has no axes to draw; those with axes: mac23"),
        (("mc23", "20h"), "unknown model 'mc23'"),
        (("mac23", "20h", "--seconds", "0"), "--seconds"),
    ],
)
def test_a_mistake_is_one_clear_line(words: tuple[str, ...], part: str) -> None:
    """With exit status 2, and no picture."""
    result = invoke("plot", *words)
    assert result.exit_code == 2, result.output
    assert len(result.stderr.splitlines()) == 1
    assert part in result.stderr
    assert not list(Path().glob("*.png"))


def test_a_command_that_moves_nothing_is_told_with_its_reply() -> None:
    """The reply says why."""
    result = invoke("plot", "mn400", "X3")
    assert result.exit_code == 2
    assert "PARA_ERROR" in result.stdout
    assert (
        result.stderr
        == "axistwin: nothing has moved, so there is nothing to draw; see the replies\n"
    )


class NoMatplotlib(importlib.abc.MetaPathFinder):
    """As if it were not installed."""

    def find_spec(self, name: str, path: Any, target: ModuleType | None = None) -> None:
        """Nowhere."""
        if name.partition(".")[0] == "matplotlib":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


@pytest.fixture
def without_matplotlib(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with the core install."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [NoMatplotlib(), *sys.meta_path])


@pytest.mark.usefixtures("without_matplotlib")
def test_without_matplotlib_the_remedy_is_named() -> None:
    """Before anything is said to a device."""
    words = ("plot", "mac23", "go to 5")
    assert_one_clear_line(invoke(*words), "matplotlib", "pip install 'matplotlib>=3.9'")


def test_no_other_command_loads_matplotlib() -> None:
    """They start as fast as they did."""
    program = (
        "import sys\n"
        "from axistwin.cli import program\n"
        "sys.argv = ['axistwin', '--help']\n"
        "try:\n    program.main()\n"
        "except SystemExit:\n    print({'matplotlib', 'numpy'} & set(sys.modules))\n"
    )
    environment = {**os.environ, "COLUMNS": "80"}
    command = [sys.executable, "-c", program]
    shown = subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=60, env=environment
    ).stdout
    assert shown.endswith("set()\n")
    assert "plot" in shown
