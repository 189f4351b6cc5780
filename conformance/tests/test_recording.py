"""Recordings: written, read back, and refused in one line."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from zoo.motion import a_ramped_stop_stops_dead
from zoo.mutant import Mutant
from zoo_msc.flags import a_flag_that_is_set_again_goes_off

from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.base.events import Event, FailureStored
from axistwin_conformance.base.recording import Recording, load_recording
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.sequences import failure
from axistwin_conformance.sequences.shrink import Budget

ONE = Recording(
    "mac23", (b"\x01\xff\x00\x00", b"\x06\x00\x00\x00"), check="a_check", seed=7,
    requirement="MACS-CMD-13-01", expected='"quoted" \\ and\nmore', actual="7fh \x7f \t °C",
    words=("13h → Xon", "18h → Xon"), readings={"xon_byte": "11h"}, suite_version="1.2",
    found=b"\x01\xff\x00\x00" * 3, history=("reproduced 3 of 3",),
)  # fmt: skip
OPERATION = st.binary(min_size=4, max_size=4)


def test_what_is_written_is_what_is_read(tmp_path: Path) -> None:
    """All that a replay needs, and for people what each operation did."""
    path = ONE.write(tmp_path)
    assert path == tmp_path / "operations" / "a_check-7.toml"
    back = load_recording(str(path), "mac23", 4)
    for name in (
        "model", "operations", "check", "seed", "requirement", "expected", "actual", "words",
        "readings", "suite_version",
    ):  # fmt: skip
        assert getattr(back, name) == getattr(ONE, name), name
    text = path.read_text(encoding="utf-8")
    assert 'words = "13h → Xon"' in text
    assert ONE.found.hex() in text


@settings(max_examples=30)
@given(st.lists(OPERATION, min_size=1, max_size=9).map(tuple), st.text(max_size=20))
def test_every_recording_can_be_read_back(operations: tuple[bytes, ...], text: str) -> None:
    """Whatever stands in its words; and its hex on the command line means the same."""
    with tempfile.TemporaryDirectory() as folder:
        words = tuple(text for _ in operations)
        path = Recording("mac23", operations, check="c", words=words).write(Path(folder))
        back = load_recording(str(path), "mac23", 4)
    assert (back.operations, back.words) == (operations, words)
    assert load_recording(back.hex, "mac23", 4).operations == operations


@pytest.mark.strength
@pytest.mark.parametrize(
    ("model", "fault"),
    [
        ("mac23", a_ramped_stop_stops_dead),
        ("mac23-can", a_ramped_stop_stops_dead),
        ("msc-250", a_flag_that_is_set_again_goes_off),
    ],
)
def test_each_operation_of_a_machines_run_is_told_in_words(
    monkeypatch: pytest.MonkeyPatch, model: str, fault: Mutant
) -> None:
    """Also of a run as it was found, which nobody has made shorter."""
    monkeypatch.setattr(failure, "TWIN_BUDGET", Budget(operations=0, seconds=0.0))
    told: list[Event] = []
    ids = ("some_runs_of_the_machine_agree_with_the_model",)
    with fault.plant():
        Engine(make_options(model=model, ids=ids, jobs=1)).run(told.append)
    found, *_ = [one.recording for one in told if isinstance(one, FailureStored)]
    assert found.operations
    assert len(found.words) == len(found.operations)
    assert all(found.words)
    assert any("→" in words for words in found.words)


def test_with_a_report_it_is_named_by_its_file_and_without_by_its_hex() -> None:
    """What the replay command says."""
    assert ONE.word("out") == "out/operations/a_check-7.toml"
    assert ONE.word("") == "01ff000006000000"
    assert len(load_recording("00" * 400, "mac23", 4).operations) == 100  # no name of a file


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (None, "No such file or directory; --replay takes a file written by --report"),
        ("\x00[", "is no recording"),
        ("a = " + "[" * 3000 + "]" * 3000, "is no recording: nested too deep"),
        ("answer = 42", "format is missing"),
        ('format = 1\nmodel = "mac34-1"', "was recorded on a mac34-1, not on a mac23"),
        ('format = 1\nmodel = "mac23"', "holds no operations"),
        ('format = 1\nmodel = "mac23"\noperations = [1]', "holds no operations"),
        ('format = 1\nmodel = "mac23"\n[[operations]]\nhex = "01ff"', "write 8 hex digits"),
        ('format = 1\nmodel = "mac23"\n[[operations]]\nhex = "01ffzz00"', "write 8 hex digits"),
        ("# " + "x" * 1_000_000, "longer than"),
    ],
)
def test_an_unusable_file_is_one_line(tmp_path: Path, text: str | None, complaint: str) -> None:
    """It names the file and what would be right."""
    path = tmp_path / "failure.toml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=complaint) as raised:
        load_recording(str(path), "mac23", 4)
    assert "failure.toml" in str(raised.value)
    assert len(str(raised.value).splitlines()) == 1


@pytest.mark.parametrize("word", ["abc", "00112233445566", "f" * 99])
def test_hex_that_is_no_whole_operation_is_one_line(word: str) -> None:
    """An operation cut off on the way to the command line is not played."""
    with pytest.raises(UsageError, match="write 8 hex digits for each"):
        load_recording(word, "mac23", 4)
