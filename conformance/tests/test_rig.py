"""The rig: three ways to work a device's inputs, supply and shaft, and what the plan says of it."""

from __future__ import annotations

import io
import stat
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from axistwin_conformance.base.errors import CannotDo, RigError, UsageError
from axistwin_conformance.base.events import CheckFinished, Outcome, RigQuestion
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.session import Session
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.catalog import families, find_family
from axistwin_conformance.families.mac.axis.rig_controls import AXIS_CONTROLS
from axistwin_conformance.transport.rig import (
    Act,
    CommandRig,
    Console,
    PromptRig,
    Rig,
    RigChoice,
    TwinRig,
    act_done,
    choose_rig,
    run_command,
)
from axistwin_conformance.transport.serial import SerialTransport, open_target
from axistwin_conformance.transport.transport import Transport

ALL = frozenset(AXIS_CONTROLS)
INPUTS = tuple(one.name for one in AXIS_CONTROLS.values() if one.verb == "input")
TWIN = "axistwin://mac23:0,mac23:1?time=virtual"
RIG_CHECKS = tuple(one.name for one in find_family("mac23").checks() if one.rig_needs)
# Every verb once, each away from rest.
ACTS: tuple[tuple[str, Callable[[Rig], Any]], ...] = (
    *((f"input {name} on", lambda rig, name=name: rig.work(name, True)) for name in INPUTS),
    ("supply volts 46.5", lambda rig: rig.work("supply", 46.5)),
    ("temperature celsius 90", lambda rig: rig.work("temperature", 90.0)),
    ("hold shaft on", lambda rig: rig.work("hold", True)),
    ("turn shaft -25", lambda rig: rig.work("turn", -25)),
    ("fault micro_cut on", lambda rig: rig.work("micro_cut", True)),
    ("power supply off", lambda rig: rig.work("power", False)),
)


@pytest.fixture
def target() -> Any:
    """The built-in twin."""
    one = open_target(TWIN, 38400, is_builtin=True)
    yield one
    one.close()


# --- the twin's handles --------------------------------------------------------------------------


def test_the_twin_is_worked_by_its_handles(target: SerialTransport) -> None:
    """Each verb reaches the twin with that address, and no other."""
    rig, (other, twin) = TwinRig(target, 1, AXIS_CONTROLS), target.twins
    rig.work("positive_stop", True)
    rig.work("supply", 30.0)
    rig.work("temperature", 50.0)
    rig.work("hold", True)
    assert (twin.inputs.positive_stop, twin.supply_volts, twin.load.held) == (True, 30.0, True)
    assert twin.temperature_celsius == 50.0
    rig.work("hold", False)
    rig.work("turn", -7)
    assert (twin.position, other.position) == (-7, 0)
    assert not other.inputs.positive_stop
    rig.work("power", False)
    assert not twin.is_powered


def test_reset_brings_the_twin_back_to_rest(target: SerialTransport) -> None:
    """Whatever was worked; the usual supply and temperature are those it had."""
    rig, twin = TwinRig(target, 0, AXIS_CONTROLS), target.twins[0]
    usual = (twin.supply_volts, twin.temperature_celsius)
    for _, act in ACTS:
        act(rig)
    before = rig.is_disturbed
    rig.reset()
    assert (before, rig.is_disturbed) == (True, False)
    assert (twin.supply_volts, twin.temperature_celsius, twin.load.held) == (*usual, False)
    assert not any(getattr(twin.inputs, name) for name in INPUTS)
    assert twin.describe()["state"] == "BT"


def test_acts_are_bracketed_in_time_and_told_in_the_transcript(target: SerialTransport) -> None:
    """The twin's take no time."""
    rig = TwinRig(target, 0, AXIS_CONTROLS)
    begin_ns = target.now_ns
    assert rig.work("reference", True) == (begin_ns, begin_ns)
    told = [one.text for one in target.transcript.since(0, 99)]
    assert "rig: the reference input was activated" in told


@pytest.mark.parametrize(("time", "is_exact"), [("virtual", True), ("20", False)])
def test_only_in_virtual_time_are_the_acts_of_a_twin_exact(time: str, is_exact: bool) -> None:
    """Elsewhere time passes while the suite is at it."""
    target = open_target(f"axistwin://mac23?time={time}", 38400)
    assert TwinRig(target, 0, AXIS_CONTROLS).is_exact is is_exact
    target.close()


def test_a_line_without_that_twin_is_told() -> None:
    """Not a traceback."""
    target = open_target(TWIN, 38400)
    with pytest.raises(RigError, match="address 9"):
        TwinRig(target, 9, AXIS_CONTROLS)
    target.close()


# --- the user's command --------------------------------------------------------------------------


@dataclass
class Relay:
    """A rig's command: notes its words, answers with the status told."""

    path: Path
    log: Path

    @property
    def template(self) -> str:
        """What the user types."""
        return f"{sys.executable} {self.path} {{verb}} {{name}} {{value}}"

    @property
    def said(self) -> list[str]:
        """What it was told, a line per run."""
        return self.log.read_text().splitlines() if self.log.exists() else []


@pytest.fixture
def relay(tmp_path: Path) -> Relay:
    """Able to do everything but temperature, encoder and amplifier; fails for 13 V, hangs at 14."""
    log = tmp_path / "log"
    script = tmp_path / "relay.py"
    script.write_text(
        "import sys, time\n"
        f"open({str(log)!r}, 'a').write(' '.join(sys.argv[1:]) + '\\n')\n"
        "verb, name, value = sys.argv[1:]\n"
        "if value == '14': time.sleep(60)\n"
        "if value == '13': print('relay: no contact'); sys.exit(1)\n"
        "words = {verb, name}\n"
        "sys.exit(3 if words & {'temperature', 'encoder', 'amplifier'} else 0)\n"
    )
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    return Relay(script, log)


@pytest.mark.system
def test_a_command_gets_verb_name_and_value(relay: Relay, target: SerialTransport) -> None:
    """One run per act; reset undoes each, the shaft first and the supply last."""
    rig = CommandRig(target, AXIS_CONTROLS, relay.template)
    acts = [(words, act) for words, act in ACTS if not words.startswith("temperature")]
    for _, act in acts:
        act(rig)
    assert relay.said == [words for words, _ in acts]
    rig.reset()
    undone = relay.said[len(acts) :]
    assert undone[:2] == ["hold shaft off", "fault micro_cut off"]
    assert set(undone[2:6]) == {f"input {name} off" for name in INPUTS}
    assert undone[6:] == ["supply volts rest", "power supply on"]


@pytest.mark.system
def test_what_a_command_cannot_do_is_told_by_status_3(
    relay: Relay, target: SerialTransport
) -> None:
    """Which is no failure."""
    rig = CommandRig(target, AXIS_CONTROLS, relay.template)
    with pytest.raises(CannotDo, match="temperature celsius 90"):
        rig.work("temperature", 90.0)
    assert not rig.is_disturbed


@pytest.mark.system
def test_a_command_that_fails_says_why_in_one_line(relay: Relay, target: SerialTransport) -> None:
    """The last line of its output; what it may have half done is still put back."""
    rig = CommandRig(target, AXIS_CONTROLS, relay.template)
    with pytest.raises(RigError, match=r"supply volts 13 ended with status 1: relay: no contact$"):
        rig.work("supply", 13.0)
    assert rig.is_disturbed
    rig.reset()
    assert relay.said[-1] == "supply volts rest"


@pytest.mark.system
def test_a_command_that_hangs_is_ended(relay: Relay, target: SerialTransport) -> None:
    """After its time-out."""
    rig = CommandRig(target, AXIS_CONTROLS, relay.template, timeout_s=0.5)
    with pytest.raises(RigError, match=r"did not end within 0\.5 s"):
        rig.work("supply", 14.0)


@pytest.mark.system
def test_what_is_filled_in_stays_one_word(tmp_path: Path) -> None:
    """No shell ever sees it."""
    out = tmp_path / "out"
    template = f"{sys.executable} -c 'import sys; open(sys.argv[1], \"w\").write(sys.argv[2])'"
    assert run_command(f"{template} {out} '{{verb}};{{name}} {{value}}'", ("a b", "$(c)", "`d`"), 9)
    assert out.read_text() == "a b;$(c) `d`"


@pytest.mark.system
def test_reset_puts_back_all_it_can_and_names_the_rest(
    relay: Relay, target: SerialTransport
) -> None:
    """One thing that fails does not keep the others disturbed."""
    rig = CommandRig(target, AXIS_CONTROLS, relay.template)
    rig.work("supply", 30.0)
    rig.work("hold", True)
    rig.work("power", False)
    relay.path.write_text("import sys; sys.exit(sys.argv[1] == 'hold')\n")
    with pytest.raises(RigError, match=r"hold shaft is still on .*status 1") as caught:
        rig.reset()
    assert "power" not in str(caught.value)


@pytest.mark.system
def test_a_command_is_asked_what_it_can_do(relay: Relay) -> None:
    """With the verb `can`; the plan then says exactly what is missing."""
    choice = choose_rig(None, relay.template, "/dev/null", is_allowed=True, capabilities=ALL)
    assert choice.capabilities == ALL - {"temperature", "encoder", "amplifier"}
    assert set(relay.said) == {f"can {name} -" for name in ALL}
    options = make_options(
        model="mac23", port="/dev/null", allow="motion,stored,rig", rig_command=relay.template
    )
    left_out = {one.name: why for one, why in Engine(options).plan().left_out}
    assert left_out["overheating_locks_motion"] == (
        "needs a rig that sets the module's temperature (--rig)"
    )
    assert "disabled_hardware_stops_do_nothing" not in left_out


def test_without_rig_the_command_is_not_run(relay: Relay) -> None:
    """Nothing happens that was not allowed."""
    choice = choose_rig(None, relay.template, "/dev/null", is_allowed=False, capabilities=ALL)
    assert (choice.capabilities, relay.said) == (frozenset(), [])


# --- a person at the terminal --------------------------------------------------------------------


@dataclass
class Person:
    """Sits at the terminal: gives these answers, one after the other, then nothing."""

    answers: list[str | None]
    asked: list[str] = field(default_factory=list)

    def ask(self, text: str, timeout_s: float | None = None) -> str | None:
        """Take a question."""
        self.asked.append(text)
        return self.answers.pop(0) if self.answers else None


def test_a_person_is_asked_and_presses_enter(target: SerialTransport) -> None:
    """In words; a report is told that a question is open."""
    told: list[bool] = []
    person = Person(["\n", "\n"])
    rig = PromptRig(target, AXIS_CONTROLS, person, lambda is_open, text: told.append(is_open))
    rig.work("positive_stop", True)
    rig.work("supply", 46.5)
    assert "Close the contact of the positive stop input." in person.asked[0]
    assert "Set the supply to 46.5 V." in person.asked[1]
    assert told == [True, False] * 2


def test_what_a_person_skips_is_not_asked_again(target: SerialTransport) -> None:
    """Whatever else it takes."""
    person = Person(["s\n"])
    rig = PromptRig(target, AXIS_CONTROLS, person)
    for _ in range(2):
        with pytest.raises(CannotDo):
            rig.work("temperature", 90.0)
    assert len(person.asked) == 1


def test_a_person_is_asked_to_put_everything_back(target: SerialTransport) -> None:
    """And if nobody answers, that is told instead of waited for."""
    person = Person(["\n", "\n", "\n"])
    rig = PromptRig(target, AXIS_CONTROLS, person)
    rig.work("hold", True)
    rig.work("power", False)
    with pytest.raises(RigError, match="power supply is still off"):
        rig.reset()
    assert "Let the shaft go." in person.asked[2]
    assert "Switch the supply on." in person.asked[3]


def test_the_end_of_input_is_no_consent(target: SerialTransport) -> None:
    """A closed terminal skips."""
    rig = PromptRig(target, AXIS_CONTROLS, Console(io.StringIO(""), io.StringIO()))
    with pytest.raises(CannotDo):
        rig.work("hold", True)


def test_every_act_has_words_for_a_person() -> None:
    """Both to do it and to undo it."""
    for family in families():
        for control in family.rig_controls.values():
            act = Act(control, True, 3)
            assert act.order.endswith(".")
            if not control.is_step:
                assert act.undone.order.endswith(".")


# --- choosing ------------------------------------------------------------------------------------


@pytest.mark.system
@pytest.mark.parametrize(
    ("kind", "command", "complaint"),
    [
        ("twin", None, "twin in this process"),
        ("prompt", None, "terminal with somebody"),
        ("command", None, "needs --rig-command"),
        ("prompt", "x {verb} {name} {value}", "goes with --rig command"),
        (None, "relay {verb}", "lacks {name}, {value}"),
        (None, "relay 'x {verb} {name} {value}", "quotation"),
        (None, "/no/such/relay {verb} {name} {value}", "No such file"),
        (None, f"{sys.executable} -c 'exit(7)' {{verb}} {{name}} {{value}}", "status 7"),
    ],
)
def test_a_rig_that_cannot_be_meant_is_refused(
    kind: str | None, command: str | None, complaint: str
) -> None:
    """In one line, before anything is opened."""
    with pytest.raises(UsageError, match=complaint) as caught:
        choose_rig(kind, command, "/dev/ttyUSB0", is_allowed=True, capabilities=ALL)
    assert "\n" not in str(caught.value)


def test_a_twin_is_its_own_rig_and_a_port_has_none() -> None:
    """Unless the user says otherwise."""
    assert make_options(model="mac23").rig.kind == "twin"
    options = make_options(model="mac23", port="/dev/null", allow="motion,stored,rig")
    assert options.rig == RigChoice()
    reasons = {one.name: why for one, why in Engine(options).plan().left_out}
    assert reasons["the_reference_is_disabled_at_power_up"] == (
        "needs a rig that switches the supply off and on and works the reference input (--rig)"
    )


def test_the_replay_names_the_rig() -> None:
    """So that the same hands work it."""
    options = make_options(model="mac23", port="/dev/null", allow="rig")
    check = options.family.checks()[0]
    assert "--rig" not in make_options(model="mac23").replay(check)
    chosen = replace(options, rig=RigChoice("command", "relay {verb} {name} {value}", ALL))
    assert "--rig command --rig-command 'relay {verb} {name} {value}'" in chosen.replay(check)


@pytest.mark.parametrize("family", families(), ids=lambda family: min(family.models))
def test_what_was_done_tells_what_to_do(family: Family) -> None:
    """The clause of each act of each control gives that act again; another clause gives none."""
    for control in family.rig_controls.values():
        number = None if control.name else 7
        values: list[bool | float | None] = [12.5, None] if control.rest is None else [True, False]
        if control.is_step:
            values = [-25.0 if "{value}" in control.done[0] else True]
        for value in values:
            act = Act(control, value, number)
            assert act_done(family.rig_controls, act.done) == act
    assert act_done(family.rig_controls, "nothing is wired to it: the device has none") is None


# --- in a run ------------------------------------------------------------------------------------


class FakeRig(Rig):
    """Notes what it is told; may fail or be unable."""

    def __init__(self, target: Transport, *, trouble: Exception | None = None) -> None:
        super().__init__(target, AXIS_CONTROLS)
        self.trouble = trouble
        self.done: list[str] = []

    def _work(self, act: Act) -> None:
        if self.trouble is not None:
            raise self.trouble
        self.done.append(str(act))


@dataclass(frozen=True, slots=True)
class FakeChoice(RigChoice):
    """Hands out one rig."""

    capabilities: frozenset[str] = ALL
    made: list[FakeRig] = field(default_factory=list)
    trouble: Exception | None = None

    def open(self, target: Transport, address: int, controls: Any, notify: Any) -> Rig:
        """Make it."""
        self.made.append(FakeRig(target, trouble=self.trouble))
        return self.made[-1]


def holding(session: Session) -> None:
    """It holds the shaft and leaves it so."""
    session.rig.work("hold", True)
    session.expect(True, None, "", "")


def crashing(session: Session) -> None:
    """It crashes with the shaft held."""
    session.rig.work("hold", True)
    raise ZeroDivisionError


def interrupted(session: Session) -> None:
    """Somebody presses Ctrl-C."""
    session.rig.work("power", False)
    raise KeyboardInterrupt


@pytest.mark.parametrize("function", [holding, crashing, interrupted])
def test_the_rig_is_brought_to_rest_on_every_way_out(toy: Any, function: Any) -> None:
    """Before the parameters are put back."""
    toy.add(function, "MACS-BUSY-02", safety="rig", needs=("rig:hold", "rig:power"))
    choice = FakeChoice()
    toy.run(rig=choice)
    assert not choice.made[0].is_disturbed
    assert choice.made[0].done[-1] in ("hold shaft off", "power supply on")


def run_one(toy: Any, trouble: Exception) -> tuple[CheckFinished, Result]:
    """Run a check whose rig has this trouble."""
    toy.add(holding, "MACS-BUSY-02", safety="rig", needs=("rig:hold",))
    result = toy.run(rig=FakeChoice(trouble=trouble))
    return toy.seen(CheckFinished)[0], result


def test_what_the_rig_turns_out_unable_to_do_is_not_run(toy: Any) -> None:
    """With its words as the reason; nothing failed and nothing is in doubt."""
    event, _ = run_one(toy, CannotDo("no relay for that"))
    assert event.outcome is Outcome.LEFT_OUT
    assert [(one.verdict, one.text) for one in event.findings] == [
        (Verdict.NOT_RUN, "no relay for that")
    ]


def test_a_rig_that_goes_wrong_leaves_it_inconclusive_and_ends_the_run(toy: Any) -> None:
    """What may still be disturbed must not be judged further."""
    event, result = run_one(toy, RigError("relay stuck"))
    assert event.verdict is Verdict.INCONCLUSIVE
    assert any("hold shaft is still on" in one for one in result.problems)


def test_a_rig_check_says_what_it_needs() -> None:
    """Or is refused at import."""
    from axistwin_conformance.base.check import check

    for declared in ({"safety": "rig"}, {"needs": ("rig:hold",)}):
        with pytest.raises(TypeError, match="go together"):
            check("MACS-BUSY-02", **declared)(holding)


def test_a_question_stops_the_bar() -> None:
    """The terminal's face takes the event without a word of its own."""
    from rich.console import Console

    from axistwin_conformance.base.ledger import load_ledger
    from axistwin_conformance.report.terminal import TerminalReport

    console = Console(file=io.StringIO(), force_terminal=True)
    face = TerminalReport(console, load_ledger("mac_serial"), str)
    with face:
        face(RigQuestion(True, "Hold the shaft fast."))
        assert not face.bar.live.is_started
        face(RigQuestion(False, "Hold the shaft fast."))
        assert face.bar.live.is_started
