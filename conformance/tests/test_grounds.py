"""What an operator grants of a controller, and the rig that works one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from click.testing import CliRunner

from axistwin_conformance.base.check import check
from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.cli import conform, make_options
from axistwin_conformance.core.session import Session
from axistwin_conformance.engine.plan import Options
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.msc.options import NO_SCRATCH, TWIN_SCRATCH, ScratchArea
from axistwin_conformance.families.msc.rig_controls import MSC_CONTROLS
from axistwin_conformance.transport.rig import CommandRig, TwinRig
from axistwin_conformance.transport.serial import SerialTransport, open_target

PORT = "/dev/ttyUSB0"


def options(**given: Any) -> Options:
    """Those of a controller on a real port."""
    return make_options(model="msc-250", port=PORT, **given)


# --- what is granted -----------------------------------------------------------------------------


def test_a_real_controller_grants_nothing_by_itself() -> None:
    """Whatever the built-in twin has, of a device on a port nothing is the suite's to use."""
    assert options().settings == NO_SCRATCH
    assert not options().settings.met
    assert not {"variables", "flags", "program", "bench"} & options().provided
    builtin = make_options(model="msc-250")
    assert builtin.settings == TWIN_SCRATCH
    assert {"variables", "flags", "program", "bench"} <= builtin.provided


def test_what_is_named_is_granted() -> None:
    """Each option meets the need of its name."""
    named = options(variables=range(2048, 2304), flags=range(200, 204), bench_program=(240, 6144))
    assert named.settings == ScratchArea(range(2048, 2304), range(200, 204), (240, 6144))
    assert {"variables", "flags", "program"} <= named.provided
    assert "bench" not in named.provided
    assert "bench" in options(allow="rig").provided


def test_the_command_of_a_run_names_its_grounds_again() -> None:
    """What is copied from a report does what the report tells of."""
    named = options(variables=range(2048, 2304), flags=range(200, 201), bench_program=(240, 6144))
    words = named.command
    assert "--variables 2048-2303 --flags 200-200 --bench-program 240:6144" in words
    assert "--max-travel" not in words
    assert "--variables" not in make_options(model="msc-250").command


def test_what_is_named_on_a_port_is_named_again_even_if_a_twin_has_just_that() -> None:
    """Nothing is granted by itself there, so that the command of the report has to say it."""
    named = make_options(
        model="msc-250", port=PORT, variables=range(1024, 5120), flags=range(128, 192),
        bench_program=(240, 6144),
    )  # fmt: skip
    assert named.settings == TWIN_SCRATCH
    assert "--variables 1024-5119 --flags 128-191 --bench-program 240:6144" in named.command


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"bench_program": (240, 6145)}, "240:6145: its ADDRESS is a multiple of 128"),
        (
            {"bench_program": (240, 6144), "variables": range(6300, 7000)},
            "has 6144-6399 to itself: --variables 6300-6999 must not reach into it",
        ),
        (
            {"bench_program": (240, 6144), "flags": range(200, 241)},
            "has 240-243 to itself: --flags 200-240 must not reach into it",
        ),
    ],
)
def test_the_bench_program_shares_nothing(given: Any, told: str) -> None:
    """What it counts in must not be overwritten by other checks, nor its orders be given."""
    with pytest.raises(UsageError, match=told):
        options(**given)


def test_a_controller_has_no_eeprom_to_be_spared() -> None:
    """An option that would be without effect is a mistake."""
    with pytest.raises(UsageError, match="--eeprom-budget 5: msc-250 has no EEPROM"):
        options(eeprom_budget=5)


def test_a_program_that_nobody_has_named_is_neither_stopped_nor_started() -> None:
    """It may be the one that works the machine; the plan says how to name the bench program."""
    url = "axistwin://msc-250:1?time=virtual"
    unnamed = make_options(model="msc-250", port=url, allow="stored,motion,rig")
    assert "program" not in unnamed.rig.capabilities
    plan = Engine(unnamed).plan()
    reasons = [why for one, why in plan.left_out if "rig:program" in one.needs]
    assert reasons
    assert all("--bench-program FLAG:ADDRESS" in why for why in reasons)
    assert not any("starts and stops" in why for why in reasons)
    named = make_options(model="msc-250", port=url, allow="rig", bench_program=(240, 6144))
    assert "program" in named.rig.capabilities


def test_an_axis_has_no_variables_and_a_controller_no_envelope() -> None:
    """An option that means nothing to the model is a mistake, told in a line."""
    with pytest.raises(UsageError, match="--flags: a mac23 has no variables"):
        make_options(model="mac23", flags=range(3))
    with pytest.raises(UsageError, match="--max-travel 5: the suite drives no axis"):
        options(max_travel=5)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--variables", "5-4"), "'5-4' runs backwards: write 4-5"),
        (("--variables", "0-10000h"), "within 0-65535"),
        (("--flags", "256"), "within 0-255"),
        (("--flags", "one"), "'one' is no address"),
        (("--bench-program", "240"), "no FLAG:ADDRESS, such as 240:6144"),
        (("--bench-program", "253:0"), "out of range: 0-252 and 0-65535"),
    ],
)
def test_a_span_that_cannot_be_is_refused(words: tuple[str, str], told: str) -> None:
    """One line, naming the value and the range."""
    result = CliRunner().invoke(conform, ["msc-250", *words, "--dry-run"])
    assert result.exit_code == 2
    assert told in result.output


def test_spans_are_typed_in_any_notation() -> None:
    """Decimal, 0x and h; one number is a span of its own."""
    words = ["msc-250", "--variables", "0x800-8FFh", "--flags", "200", "--dry-run"]
    result = CliRunner().invoke(conform, words)
    assert result.exit_code == 0, result.output


def test_a_check_that_may_disturb_a_controller_is_of_class_rig() -> None:
    """Class and need go together, either way round."""
    with pytest.raises(TypeError, match="or 'bench' go together"):

        @check("MSC-CMD-10", needs=("bench",))
        def passive_on_a_bench(session: Session) -> None:
            """Nothing."""


# --- the rig -------------------------------------------------------------------------------------


@pytest.fixture
def target() -> Iterator[SerialTransport]:
    """The built-in twin with its bench program."""
    one = open_target("axistwin://msc-250:1?time=virtual&program=bench", 9600, is_builtin=True)
    yield one
    one.close()


def test_the_twin_of_a_controller_is_worked_by_its_handles(target: SerialTransport) -> None:
    """Flags of the machine, conditions, battery, program, supply; and all put back."""
    rig, twin = TwinRig(target, 1, MSC_CONTROLS), target.twins[0]
    rig.work("flag", True, number=3)
    rig.work("status", True, number=9)
    rig.work("battery", True)
    rig.work("program", False)
    assert (twin.flags[3], twin.status & 1 << 9, twin.status & 1) == (True, 1 << 9, 0)
    assert rig.is_disturbed
    rig.reset()
    assert (twin.flags[3], twin.status & 1 << 9, twin.status & 1) == (False, 0, 1)
    rig.work("power", False)
    assert not twin.is_powered
    rig.reset()
    assert twin.is_powered


@pytest.mark.system
def test_a_command_is_told_what_to_do_with_a_controller(
    tmp_path: Any, target: SerialTransport
) -> None:
    """Verb, name and value of each act, and of what undoes it."""
    log = tmp_path / "said"
    template = f"sh -c 'echo $0 $1 $2 >> {log}' {{verb}} {{name}} {{value}}"
    rig = CommandRig(target, MSC_CONTROLS, template)
    rig.work("flag", True, number=3)
    rig.work("status", True, number=1)
    rig.work("battery", True)
    rig.work("program", False)
    rig.reset()
    said = log.read_text().splitlines()
    assert said[:4] == [
        "flag 3 on", "status 1 on", "battery memory on", "program macroprogram off",
    ]  # fmt: skip
    assert said[4:] == [
        "flag 3 off", "status 1 off", "battery memory off", "program macroprogram on",
    ]  # fmt: skip


def test_a_person_is_asked_for_it_in_words(target: SerialTransport) -> None:
    """Numbers of flags and bits are in the sentence."""
    rig = TwinRig(target, 1, MSC_CONTROLS)
    told = []
    rig._work = lambda act: told.append((act.order, act.undone.order))  # type: ignore[method-assign]
    rig.work("flag", True, number=12)
    rig.work("status", True, number=1)
    rig.work("program", False)
    assert told == [
        ("Work the machine until flag 12 is on.", "Let flag 12 go off again."),
        ("Bring about the condition of status bit 1.", "End the condition of status bit 1."),
        ("Stop the macroprogram.", "Start the macroprogram."),
    ]
