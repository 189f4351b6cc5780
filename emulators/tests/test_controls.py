import ast
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from axistwin import discovery, testing
from axistwin.devices.controls import ControlTable
from axistwin.errors import UsageError
from axistwin.macroprogram import Macroprogram, UserFlag
from axistwin.runtime import any_twin
from axistwin.runtime.any_twin import AnyTwin

FAMILIES = {model.family.controls(): name for name, model in discovery.models().items()}


class Lamp(Macroprogram):
    """Has one name."""

    start = UserFlag(200)

    def scan(self) -> None:
        """Nothing but look."""


@pytest.fixture(params=sorted(FAMILIES.values()))
def twin(request: pytest.FixtureRequest) -> Iterator[AnyTwin]:
    """A twin for each table."""
    with testing.start(request.param, time="virtual") as started:
        yield started.twin


@pytest.fixture
def motor() -> Iterator[AnyTwin]:
    """A MAC23."""
    with testing.start("mac23", time="virtual") as started:
        yield started.twin


@pytest.fixture
def controller() -> Iterator[AnyTwin]:
    """An MSC with a program."""
    with testing.start("msc-250", time="virtual", program=Lamp) as started:
        yield started.twin


@pytest.mark.parametrize("table", FAMILIES, ids=FAMILIES.get)
def test_a_table_says_all_that_a_panel_needs(table: ControlTable) -> None:
    """Each control has a name of its own, a line of documentation, and a way to be used."""
    names = [control.name for control in table]
    assert len(set(names)) == len(names) > 5
    for control in table:
        assert control.doc
        assert control.read or control.field or control.write or control.name == "power"
        assert control.kind != "choice" or control.choices
        if control.kind == "number" and control.write:
            assert control.unit
            assert control.low is not None


def test_every_value_can_be_written_as_json(twin: AnyTwin) -> None:
    """A number of a keyed control too."""
    for name, control in twin.controls.items():
        if control.is_readable and not control.has_numbers:
            assert json.loads(json.dumps(control.value)) == control.value, name


def test_python_handles_have_what_the_tables_have() -> None:
    """What a type checker is told of twins is what there is, neither more nor less."""
    tree = ast.parse(Path(any_twin.__file__).read_text(encoding="utf-8"))
    (stub,) = (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    methods = {node.name for node in stub.body if isinstance(node, ast.FunctionDef)}
    fields = {ast.unparse(node.target) for node in stub.body if isinstance(node, ast.AnnAssign)}
    assert methods | fields == {name for table in FAMILIES for name in table.attributes()}


def test_a_motor_is_worked_by_the_names_of_its_controls(motor: AnyTwin) -> None:
    """The same as by its attributes."""
    controls = motor.controls
    controls["inputs.reference"].set(True)
    controls["supply_volts"].set(30)
    controls["load.held"].set(True)
    controls["load.torque_nm"].set(0.1)
    controls["push"].set(-3)
    assert motor.inputs.reference is controls["inputs.reference"].value is True
    assert motor.supply_volts == controls["supply_volts"].value == 30
    assert (motor.load.held, controls["load.torque_nm"].value) == (True, 0.1)
    assert motor.position == controls["position"].value == -3
    controls["faults.micro_cut"].set(True)
    assert controls["fault_bits"].value == 1
    controls["power"].set(False)
    assert (motor.is_powered, controls["mode"].value) == (False, "off")


def test_a_controller_is_worked_by_the_names_of_its_controls(controller: AnyTwin) -> None:
    """Numbers, and the names of its program, stand for keys."""
    controls = controller.controls
    controls["flags.start"].set(True)
    controls["variables.2008"].set(7)
    controls["status_bits.3"].set(True)
    controls["battery"].set("low")
    assert (controller.flags[200], controls["flags.200"].value) == (True, True)
    assert (controller.variables[2008], controller.battery) == (7, "low")
    assert controls["status_bits.3"].value is True
    controls["stop_program"].set()
    assert controller.state == "program cleared"  # as bit 3 says
    controls["status_bits.3"].set(False)
    controls["start_program"].set()
    assert controls["state"].value == "program running"


def test_a_control_says_what_it_takes(motor: AnyTwin) -> None:
    """Kind, unit and limits, for a panel."""
    supply, held = motor.controls["supply_volts"], motor.controls["load.held"]
    assert (supply.kind, supply.unit, supply.low, supply.high) == ("number", "V", 0, 1000)
    assert (held.kind, held.is_readable, held.is_writable) == ("switch", True, True)
    assert not motor.controls["position"].is_writable
    assert not motor.controls["push"].is_readable


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("inputs.refrence", True, "mac23:0 has no control 'inputs.refrence': did you mean inputs."),
        ("inputs", True, "has no control 'inputs'"),
        ("flags.3", True, "has no control 'flags.3'"),
        ("inputs.reference", "on", "input reference: 'on' is not allowed; set True or False"),
        ("supply_volts", 1001, "supply_volts = 1001 is out of range: 0..1000 V"),
        ("load.held", 2, "held: 2 is not allowed; set True or False"),
        ("load.torque_nm", -1, "torque_nm = -1 is out of range: at least 0 Nm"),
        ("push", 0.5, "push 0.5 is no number of increments; give a whole number"),
        ("position", 3, "control position of mac23:0 is only read, not worked"),
        ("faults.encoder", True, "a mac23 has no fault 'encoder'; it has: micro_cut"),
    ],
)
def test_a_mistake_with_a_control_is_one_line(
    motor: AnyTwin, name: str, value: Any, message: str
) -> None:
    """With what is allowed; nothing has changed."""
    before = motor.describe()
    with pytest.raises(UsageError) as caught:
        motor.controls[name].set(value)
    assert message in str(caught.value)
    assert motor.describe() == before


def test_what_is_only_worked_cannot_be_read(motor: AnyTwin, controller: AnyTwin) -> None:
    """Nor can a control with numbers, without one."""
    with pytest.raises(UsageError, match="control push of mac23:0 is only worked, not read"):
        motor.controls["push"].value  # noqa: B018
    with pytest.raises(UsageError, match=r"control flags of msc-250:1 has numbers: name one"):
        controller.controls["flags"].value  # noqa: B018
    with pytest.raises(UsageError, match=r"control flags of msc-250:1 has numbers: name one"):
        controller.controls["flags"].set(True)
    assert "flags" in controller.controls
    assert controller.controls["flags"].has_numbers
