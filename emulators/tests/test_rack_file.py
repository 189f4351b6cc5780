"""What is wrong in a rack file is told with its line."""

import os
import sys
from pathlib import Path

import pytest
from daemon_process import assert_one_clear_line, invoke

from axistwin.cli.rack.positions import Positions

RACKS = sorted((Path(__file__).parents[2] / "fixtures" / "racks").glob("*.toml"))

LINE = """[[line]]
name = "press"
devices = ["mac23:0"]
pty = "./press"
"""


@pytest.mark.parametrize("path", RACKS, ids=lambda path: str(path.stem))
def test_the_racks_of_the_documentation_have_no_mistakes(path: Path) -> None:
    """As --check says, which opens nothing and writes nothing."""
    result = invoke("rack", "--check", str(path))
    assert (result.exit_code, result.output) == (0, "")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", ":1: there is neither a [[line]] nor a [[bus]]; write one"),
        (f"a = \n{LINE}", ":1: this is no TOML (Invalid value"),
        (f"{LINE}ptty = 1\n", ":5: unknown key 'ptty': did you mean pty?"),
        ("[bus]\nname = 'a'\n", ":1: bus is {'name': 'a'}: write it as a section, [[bus]]"),
        (f"control = '127.0.0.1:80'\n{LINE}", "'127.0.0.1:80': write it as a section, [control]"),
        (f"{LINE}quirks = 3\n", ":5: quirks is 3: write it as a section, [line.quirks]"),
        (f"{LINE}faults = [1]\n", ":5: faults is 1: write it as a section, [[line.faults]]"),
        (f"{LINE}\n[contrl]\n", ":6: unknown key 'contrl': did you mean control?"),
        ('[[line]]\ndevices = "mac23"\npty = "x"\n', ":1: key 'name' is missing"),
        (f"{LINE}baud = 'fast'\n", ":5: baud is 'fast': input should be a valid integer"),
        (LINE.replace("press", "a/b", 1), ":2: name 'a/b': 1 to 64 letters"),
        (LINE.replace("mac23:0", "mca23"), ":3: unknown model 'mca23': did you mean mac23"),
        (LINE.replace("mac23:0", "mac23:200"), ":3: address 200 is out of range for mac23"),
        (
            LINE.replace('["mac23:0"]', '[\n  "mac23:0",  # ],\n  "mac23-can"\n]'),
            ":5: mac23-can:1 does not live on a [[line]]; write it under [[bus]]",
        ),
        (LINE.replace("pty", "# pty"), ":1: press has no endpoint; give one of pty, tcp"),
        (LINE + LINE, ":6: name 'press' is taken; choose another"),
        (
            LINE + LINE.replace("press", "saw", 1).replace('"./press"', '["press"]'),
            ":8: pty press: press has it already; choose another",
        ),
        (f"{LINE}baud = 1\n", ":5: baud 1 is no rate of mac23"),
        (f"{LINE}speed = -1\n", ":5: speed"),
        (f"{LINE}profile = 'no.toml'\n", ":5: profile no.toml: cannot be read"),
        (f"{LINE}program = 'bench'\n", ":1: mac23:0 runs no program"),
        (f"{LINE}tcp = 'here'\n", "address 'here'"),
        (
            f"{LINE}[line.quirks]\nreply_latency = 0\n",
            ":6: unknown quirk 'reply_latency': did you mean reply_latency_us",
        ),
        (
            f"{LINE}[line.initial.'mac23']\n'inputs.reference' = true\n",
            ":5: 'mac23': did you mean mac23:0?",
        ),
        (
            f"{LINE}[line.initial.'mac23:0']\n'inputs.referense' = true\n",
            ":6: mac23:0 has no control 'inputs.referense': did you mean inputs.reference?",
        ),
        (f"{LINE}[line.initial.'mac23:0']\n'inputs.reference' = 3\n", ":6: "),
        (f"{LINE}[control]\naddress = '192.0.2.1:80'\n", ":5: control 192.0.2.1:80: whoever"),
    ],
)
def test_a_mistake_is_told_with_its_line(text: str, told: str, tmp_path: Path) -> None:
    """One line on stderr, exit status 2; what is allowed or the nearest name in it."""
    path = tmp_path / "rack.toml"
    path.write_text(text)
    result = invoke("rack", "--check", str(path))
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"{path}:")
    assert told in line
    assert result.stdout == ""


def test_several_mistakes_are_told_in_the_order_of_their_lines(tmp_path: Path) -> None:
    """All at once."""
    path = tmp_path / "rack.toml"
    path.write_text(f"{LINE}[line.quirks]\na = 1\n{LINE.replace('mac23', 'mic23')}")
    result = invoke("rack", "--check", str(path))
    told = result.stderr.splitlines()
    numbers = [line.removeprefix(f"{path}:").split(":")[0] for line in told]
    assert numbers == ["6", "8", "9"]


def test_a_file_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    """With the command that writes one."""
    result = invoke("rack", str(tmp_path / "none.toml"))
    assert_one_clear_line(result, "cannot be read (No such file", "axistwin rack --init")


def test_a_pipe_is_read() -> None:
    """As a shell's <(...) gives it."""
    reader, writer = os.pipe()
    os.write(writer, LINE.encode())
    os.close(writer)
    assert invoke("rack", "--check", f"/dev/fd/{reader}").exit_code == 0
    os.close(reader)


def test_the_example_that_is_written_has_no_mistakes(tmp_path: Path) -> None:
    """A file that exists is left alone."""
    path = tmp_path / "rack.toml"
    assert invoke("rack", "--init", str(path)).exit_code == 0
    assert invoke("rack", "--check", str(path)).exit_code == 0
    before = path.read_text()
    assert_one_clear_line(invoke("rack", "--init", str(path)), "File exists", "name a new file")
    assert path.read_text() == before


def test_without_pydantic_the_remedy_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes with the extra, and nothing else of the program needs it."""
    for name in ("axistwin.cli.rack.file", "axistwin.cli.rack.running"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "pydantic", None)
    result = invoke("rack", "--check", str(tmp_path / "rack.toml"))
    assert_one_clear_line(result, "rack: pydantic is missing", "pip install", "'pydantic>=")


def test_positions_of_keys_are_those_in_the_text() -> None:
    """Behind strings of several lines, brackets in strings and comments, and dotted keys."""
    text = '''a.b = """
[x]
""" # [y]
"c.d" = { e = 1, f = [
  "]", '#',
] }
[[t]]
k = 1
[[t.u]]
[t.u.v]
w = "# = ["
[[t]]
k = [[1,
 2], 3,
  4]
'''
    positions = Positions(text)
    assert positions.line_of(("a", "b")) == 1
    assert positions.line_of(("c.d",)) == 4
    assert positions.line_of(("t", 0, "k")) == 8
    assert positions.line_of(("t", 0, "u", 0, "v", "w")) == 11
    assert positions.line_of(("t", 0, "missing")) == 7
    assert positions.line_of(("t", 1)) == 12
    assert [positions.line_of(("t", 1, "k", number)) for number in range(3)] == [13, 14, 15]
    assert positions.line_of(("nothing",)) == 1
