"""`--replay`: the command printed with a failure plays it again, and says what came of that."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from zoo.motion import a_ramped_stop_stops_dead

from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.cli import Duration, conform, make_options
from axistwin_conformance.engine.plan import make_plan

CHECK = "some_mixed_sequences_agree_with_the_model"
FAILING = "030002ff0500000008000000"  # turn, ramped stop, move: refused while the ramp runs


def run(*words: str) -> Result:
    """Type a command."""
    return CliRunner().invoke(conform, ("mac23", *words))


def printed(result: Result) -> list[str]:
    """The words of the replay command that was printed."""
    (command,) = re.findall(r"^   replay +((?:.*\\\n)*.*)$", result.output, re.MULTILINE)
    words = shlex.split(command.replace("\\\n", " "))  # as a shell reads it
    assert words[:3] == ["axistwin", "conform", "mac23"]
    return words[3:]


def failed(result: Result) -> set[str]:
    """The requirements that failed, as printed with the failures."""
    return set(re.findall(r"^   (?:required)? +(MACS-\S+): ", result.output, re.MULTILINE))


@pytest.mark.strength
@pytest.mark.parametrize("with_report", [False, True])
def test_the_command_printed_with_a_failure_fails_the_same_requirement(
    tmp_path: Path, with_report: bool
) -> None:
    """By its file with a report, by its hex without; a sound twin does not fail it."""
    report = ("--report", str(tmp_path)) if with_report else ()
    with a_ramped_stop_stops_dead.plant():
        first = run(CHECK, *report)
        words = printed(first)
        again = run(*words)
    assert first.exit_code == again.exit_code == 1
    assert failed(first) == failed(again) != set()
    assert again.output.splitlines()[-1].startswith("Reproduced: ")
    assert printed(again) == words
    assert Path(words[1]).is_file() is with_report
    sound = run(*words)
    assert sound.exit_code == 0, sound.output
    assert sound.output.splitlines()[-1].startswith("Not reproduced: ")


@pytest.mark.strength
def test_the_file_is_written_as_soon_as_a_list_fails_and_again_when_it_is_short(
    tmp_path: Path,
) -> None:
    """Both are events, in the order in which they came; the file has the last."""
    with a_ramped_stop_stops_dead.plant():
        result = run(CHECK, "--report", str(tmp_path), "--json")
    told = [json.loads(line) for line in result.stdout.splitlines()]
    stored = [one["recording"] for one in told if one["event"] == "failure_stored"]
    assert len(stored) == 2
    assert len(stored[0]["operations"]) > len(stored[1]["operations"])
    (finished,) = [
        one for one in told if one["event"] == "check_finished" and one["verdict"] == "fail"
    ]
    (path,) = (tmp_path / "operations").iterdir()
    assert f"--replay {path}" in finished["replay"]
    assert path.read_text(encoding="utf-8").count("[[operations]]") == len(stored[1]["operations"])
    (covered,) = [one for one in told if one["event"] == "states_covered"]
    assert covered["operations"] > 0


def test_a_replay_runs_nothing_else() -> None:
    """One check, the requirements it judges, no more."""
    options = make_options(model="mac23", replay=FAILING)
    plan = make_plan(options, load_ledger("mac_serial"), options.family.checks())
    assert [check.name for check in plan.to_run] == ["the_recorded_operations"]
    assert set(plan.requirements) == set(plan.to_run[0].requirements)
    assert options.command == f"axistwin conform mac23 --replay {FAILING} --seed 0"


def test_on_a_port_a_replay_moves_only_if_that_is_allowed() -> None:
    """It is as bounded as every other check."""
    options = make_options(model="mac23", replay=FAILING, port="/dev/ttyX")
    result = CliRunner().invoke(
        conform, ("mac23", "--replay", FAILING, "--port", "/dev/ttyX", "--dry-run")
    )
    assert "left out: the_recorded_operations: not allowed: motion, stored" in result.output
    assert options.settings.envelope.is_guarded


def test_what_is_different_from_then_is_told(tmp_path: Path) -> None:
    """A device that reads the manual in another way is another device."""
    path = tmp_path / "failure.toml"
    path.write_text(
        f'format = 1\nmodel = "mac23"\ncheck = "c"\nrequirement = "MACS-CMD-13-02"\n'
        f'[readings]\nxon_byte = "11h"\nno_such = "x"\n[[operations]]\nhex = "{FAILING}"\n',
        encoding="utf-8",
    )
    result = run("--replay", str(path))
    assert "note: recorded on a device with xon_byte=11h; this one has 1Ah" in result.output
    assert result.exit_code == 0


def test_a_replay_that_fails_otherwise_says_so(tmp_path: Path) -> None:
    """It fails all the same, and the requirement recorded is named beside."""
    path = tmp_path / "failure.toml"
    path.write_text(
        'format = 1\nmodel = "mac23"\nrequirement = "MACS-BUSY-01"\n'
        f'[[operations]]\nhex = "{FAILING}"\n',
        encoding="utf-8",
    )
    with a_ramped_stop_stops_dead.plant():
        result = run("--replay", str(path))
    assert result.exit_code == 1
    assert "(recorded: MACS-BUSY-01)" in result.output.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--replay", "nowhere.toml"), "cannot read the operations nowhere.toml"),
        (("--replay", "0102030"), "write 8 hex digits for each"),
        (("--replay", FAILING, "MACS-LINE"), "leave out an ID"),
        (("--replay", FAILING, "--level", "quick"), "leave out --level"),
        (("--replay", FAILING, "--detect", "x.toml"), "leave out --detect"),
        (("--duration", "5m"), "add --level soak"),
        (("--duration", "5m", "--level", "full"), "add --level soak"),
    ],
)
def test_what_cannot_be_replayed_is_one_line_and_exit_2(
    words: tuple[str, ...], complaint: str
) -> None:
    """The value and the remedy."""
    result = run(*words)
    assert result.exit_code == 2
    assert complaint in result.output
    assert len(result.output.splitlines()) == 1


def test_a_recording_of_another_model_is_refused(tmp_path: Path) -> None:
    """Its operations would mean something else."""
    path = tmp_path / "failure.toml"
    path.write_text('format = 1\nmodel = "mac34-1"\n[[operations]]\nhex = "00000000"\n')
    result = run("--replay", str(path))
    assert result.exit_code == 2
    assert "was recorded on a mac34-1, not on a mac23" in result.output


@pytest.mark.parametrize("text", ["0", "-1", "2d", "x", "0s", "9999999h", "1e3"])
def test_a_duration_that_is_none_is_refused(text: str) -> None:
    """By the command line, as every option."""
    result = run("--level", "soak", "--duration", text)
    assert result.exit_code == 2
    assert "write 2h, 30m or 45s" in result.output


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("2", 7200.0), ("2h", 7200.0), ("0.5h", 1800.0), ("30m", 1800.0), ("45S", 45.0)],
)
def test_a_duration_without_unit_is_in_hours(text: str, seconds: float) -> None:
    """As soaks are."""
    assert Duration().convert(text, None, None) == seconds


def test_a_soak_without_duration_takes_two_hours() -> None:
    """Long enough to be worth the name, short enough for a night."""
    assert make_options(model="mac23", level="soak").duration_s == 7200.0
    assert make_options(model="mac23").duration_s is None


def test_the_first_failure_ends_the_run_if_that_is_wanted(toy: Any) -> None:
    """What was not started says why, and is no success."""
    toy.add(_right, "MACS-LINE-01")
    toy.add(_wrong, "MACS-FRAME-01")
    toy.add(_never, "MACS-FRAME-02")
    result = toy.run(is_exitfirst=True)
    assert [one.check.name for one in result.checks] == ["_right", "_wrong"]
    told = {one.requirement.id: one for one in result.requirements}
    assert told["MACS-FRAME-02"].verdict.value == "not run"
    assert told["MACS-FRAME-02"].reason == "not started: ended after the first failure"
    assert result.exit_status == 1
    toy.events.clear()
    assert len(toy.run().checks) == 3


def _right(session: Any) -> None:
    """It answers."""
    session.expect(True, None, "q", "")


def _wrong(session: Any) -> None:
    """It would have to answer z."""
    session.expect(False, None, "z", "q")


def _never(session: Any) -> None:
    """It is not reached."""
    session.expect(True, None, "q", "")
