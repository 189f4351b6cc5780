"""The face at a terminal: how long still, quirks, coverage."""

from __future__ import annotations

import io
import re
from typing import Any

import pytest
from rich.console import Console

from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.events import Event, RunFinished
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.core.probing import Seen
from axistwin_conformance.core.session import Session
from axistwin_conformance.engine import run as engine_module
from axistwin_conformance.engine.eta import Eta
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.options import make_options
from axistwin_conformance.report import terminal
from axistwin_conformance.report.terminal import TerminalReport

pytestmark = pytest.mark.strength


def answers(session: Session) -> None:
    """It answers a question."""
    session.target.send(b"Q")
    session.expect(session.target.receive(1, 0.01) == b"q", None, "q", "")


def reads_otherwise(session: Session) -> None:
    """It has a reading of its own."""
    session.expect(True, None, "", "")
    session.quirk(None, "xon_byte", "11h")


def reads_as_well(session: Session) -> None:
    """It is left out."""


def shown(
    toy: Any,
    pace: Eta | None = None,
    *,
    width: int = 100,
    is_verbose: bool = False,
    allowed: frozenset[str] = frozenset(SAFETY_CLASSES),
    **console: Any,
) -> str:
    """Run the toy and give what was printed."""
    out = io.StringIO()
    face = TerminalReport(
        Console(file=out, width=width, color_system=None, **console),
        load_ledger("mac_serial"),
        toy.family.explain,
        pace,
        is_verbose=is_verbose,
    )
    with face:
        Engine(toy.options(allowed=allowed), toy.open).run(face)
    return out.getvalue()


@pytest.fixture
def bench(toy: Any) -> Any:
    """A toy with two checks."""
    toy.add(answers, "MACS-LINE-01")
    toy.add(reads_otherwise, "MACS-REPLY-01")
    return toy


def test_a_log_is_told_now_and_then_how_long_it_still_takes(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not with every line."""
    past = {"answers": 60.0, "reads_otherwise": 300.0}
    quiet = shown(bench, Eta({"answers": 1, "reads_otherwise": 1}, past))
    assert "… " not in quiet
    monkeypatch.setattr(terminal, "LEFT_TOLD_EVERY_S", 0)
    assert "… " in shown(bench, Eta({"answers": 1, "reads_otherwise": 1}, past))


def test_on_a_terminal_the_guess_stands_beside_the_bar(bench: Any) -> None:
    """From the first check on, if an earlier run is known."""
    pace = Eta({"answers": 1, "reads_otherwise": 1}, {"answers": 600.0, "reads_otherwise": 300.0})
    assert "about 15 min left" in shown(bench, pace, force_terminal=True)


def test_quirks_are_listed_with_the_question_they_answer(bench: Any) -> None:
    """Only readings that are not the default; the report has all of them."""
    text = shown(bench)
    assert "  xon_byte=11h  MACS-AMB-01: Xon is printed as 1Ah" in text
    assert "1 reading of the manual seen" in text


@pytest.mark.parametrize(
    ("known", "told"),
    [
        (None, "2 of 136 requirements have a check;"),
        ({"MACS-LINE-01": ("deaf", "slow")}, "2 of 136 requirements have a check, 1 of those are"),
    ],
)
def test_how_much_is_covered_and_armed_is_told(
    bench: Any, monkeypatch: pytest.MonkeyPatch, known: Any, told: str
) -> None:
    """A requirement without a check, or one that never failed a wrong device, proves little."""
    monkeypatch.setattr(engine_module, "load_armed", lambda family: known)
    text = shown(bench)
    assert told in text
    assert ("armed" in text) is (known is not None)


@pytest.mark.parametrize("width", [40, 80, 120])
def test_on_a_narrow_terminal_no_word_is_cut_off(bench: Any, width: int) -> None:
    """A terminal has 80 columns, or 40: names can be copied, and what is asked can be read."""
    text = shown(bench, width=width, is_verbose=True)
    assert "…" not in text
    asked = load_ledger("mac_serial").requirements["MACS-REPLY-01"].text
    if width < 80:
        assert asked in " ".join(text.split())
    assert re.search(r"^MACS-REPLY-01 +quirk\b", text, re.MULTILINE)


def is_wrong(session: Session) -> None:
    """It answers as it should, whatever that takes, and however many words that takes."""
    session.target.send(b"Q")
    session.target.receive(1, 0.01)
    session.fail(None, ["a first thing that is admissible here", "another"], "something else")


@pytest.mark.parametrize("width", [40, 80, 120])
def test_a_failure_fits_the_terminal_and_its_command_can_be_copied(toy: Any, width: int) -> None:
    """Wrapped between words; a command goes on behind a backslash."""
    toy.add(is_wrong, "MACS-LINE-01")
    text = re.sub("\x1b\\[[0-9;?]*[A-Za-z]", "", shown(toy, width=width, force_terminal=True))
    lines = [line.rpartition("\r")[2] for line in text.split("\n")]
    assert max(map(len, lines)) <= width
    text = "\n".join(lines)
    failure = text[text.index("FAIL  is_wrong") :].partition("\n\n")[0]
    assert max(map(len, failure.splitlines())) <= width
    told = " ".join(failure.split())
    words = "The letter Q: something else; expected"
    assert f"{words} a first thing that is admissible here or another." in told
    assert "MAC23/34 V24 expert manual r5 (2006), chapter I, 1Bh" in told
    command = failure.partition("replay")[2].partition("by hand")[0].replace(" \\\n", " ")
    assert " ".join(command.split()) == "axistwin conform toy --seed 5 is_wrong"


def test_passes_are_shown_to_those_who_ask(bench: Any) -> None:
    """A failure among a hundred passes is not looked for."""
    assert "answers  pass" not in shown(bench)
    assert "answers  pass" in shown(bench, is_verbose=True)


def test_while_the_device_is_asked_how_it_reads_the_manual_the_bar_counts(toy: Any) -> None:
    """A minute of silence looks as if the run hung."""
    toy.add(answers, "MACS-LINE-01")
    toy.probe("xon_byte", lambda session: Seen(("1Ah",), "seen"))
    console = Console(file=io.StringIO(), force_terminal=True)
    face = TerminalReport(console, load_ledger("mac_serial"), toy.family.explain)
    bar: list[str] = []

    def hear(event: Event) -> None:
        face(event)
        [task] = face.bar.tasks
        bar.append(f"{task.description} {task.completed:.0f}/{task.total}")

    with face:
        Engine(toy.options(), toy.open).run(hear)
    assert "asking how it reads the manual 1/1" in bar
    assert "answers 0/1" in bar


def test_checks_that_have_not_run_are_not_counted_as_if_they_had(bench: Any) -> None:
    """Beside the verdict stands how many of the checks have judged."""
    bench.add(reads_as_well, "MACS-LINE-01", safety="motion")
    text = shown(bench, is_verbose=True, allowed=frozenset({"passive"}))
    assert re.search(r"^MACS-LINE-01 +pass +.* 1 of 2 ", text, re.MULTILINE)
    assert "1 of 2 checks not run" in text


@pytest.mark.parametrize("width", [40, 80, 120])
@pytest.mark.parametrize("model", ["mac23", "mac23-can", "msc-250"])
def test_list_and_plan_fit_every_terminal(model: str, width: int) -> None:
    """Each name begins a line of its own and is whole, and what it is about stands below."""
    engine = Engine(make_options(model=model))
    plan, out = engine.plan(), io.StringIO()
    console = Console(file=out, width=width, color_system=None)
    terminal.print_plan(console, plan, engine.options)
    planned = out.getvalue()
    terminal.print_ledger(console, engine.ledger, plan.requirements, engine.family.checks())
    listed = out.getvalue().removeprefix(planned)
    assert "…" not in planned + listed
    lines, words = planned.splitlines(), " ".join(planned.split())
    for check in plan.to_run:
        assert f"{check.name}  {'+'.join(check.safety)}" in lines
        assert check.behaviour in words
    assert {one.partition(" ")[0] for one in listed.splitlines()} - {""} == set(plan.requirements)


def is_wrong_too(session: Session) -> None:
    """The same again."""
    is_wrong(session)


def test_failures_of_one_cause_are_one_block(toy: Any) -> None:
    """The others are named below it, with what they fail; who asks gets them all."""
    toy.add(is_wrong, "MACS-LINE-01")
    toy.add(is_wrong_too, "MACS-REPLY-01")
    text = shown(toy)
    assert re.findall("^FAIL  (.*)$", text, re.MULTILINE) == ["is_wrong"]
    assert "also fails, likely by the same cause: is_wrong_too (MACS-REPLY-01)" in text
    assert "requirements: 0 pass · 2 fail" in text
    text = shown(toy, is_verbose=True)
    assert re.findall("^FAIL  (.*)$", text, re.MULTILINE) == ["is_wrong", "is_wrong_too"]


@pytest.mark.parametrize(("is_verbose", "first"), [(False, 6), (True, 0)])
def test_of_many_problems_the_last_are_told(toy: Any, is_verbose: bool, first: int) -> None:
    """They tell the state in which the run has ended, and how many came before."""
    out = io.StringIO()
    console, ledger = Console(file=out, width=80), load_ledger("mac_serial")
    face = TerminalReport(console, ledger, toy.family.explain, is_verbose=is_verbose)
    face(RunFinished(1, "It fails.", {}, tuple(f"trouble {n}." for n in range(9)), 0.0))
    told = re.findall(r"^problem: (.*)$", out.getvalue(), re.MULTILINE)
    before = [] if is_verbose else ["6 earlier problems: --verbose, --report"]
    assert told == [*before, *(f"trouble {n}." for n in range(first, 9))]
