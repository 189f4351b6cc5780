from fractions import Fraction
from typing import Any

import pytest
from toy_device import ToyDevice, ToyTrace

from axistwin.errors import UsageError
from axistwin.kernel.effects import Trace
from axistwin.kernel.time import NS_PER_MS, NS_PER_S
from axistwin.motion.plant import Load
from axistwin.runtime.clock import PacedClock, VirtualClock
from axistwin.runtime.line import Line
from axistwin.runtime.network import SerialNetwork
from axistwin.runtime.simulation import Station
from axistwin.runtime.storage import MemorySlot, MemoryStorage
from axistwin.runtime.twin import Twin


class Rig:
    """One toy on a line, and its twin."""

    def __init__(self, speed: float | None = None) -> None:
        self.toy = ToyDevice({"address": 3})
        self.slot = MemorySlot()
        clock = VirtualClock() if speed is None else PacedClock(speed)
        self.line = Line(
            SerialNetwork([self.toy]),
            clock,
            MemoryStorage(),
            [Station("toy:3", "toy", self.toy, self.slot)],
        )
        self.twin = self.line.twins[0]


@pytest.fixture
def rig() -> Rig:
    """In virtual time."""
    return Rig()


def test_a_twin_tells_who_and_where_it_is(rig: Rig) -> None:
    """Name and model as it was started; address, state, position and cells as they are."""
    assert (rig.twin.name, rig.twin.model, rig.twin.address) == ("toy:3", "toy", 3)
    assert rig.twin.state == "at rest"
    assert rig.twin.cells == {"address": 3, "writes": 0, "position": 0}
    assert repr(rig.twin) == "<Twin toy:3: at rest>"
    rig.toy.stored["address"] = 9
    assert (rig.twin.name, rig.twin.address) == ("toy:3", 9)


def test_what_is_read_is_read_at_the_present_time(rig: Rig) -> None:
    """A look at the position brings the line to its clock's time first."""
    rig.line.send(b"G")
    rig.line.clock.advance_to(NS_PER_S)
    assert rig.twin.position == 999
    assert rig.twin.is_moving
    assert rig.twin.describe()["state_text"] == "moving"


@pytest.mark.parametrize("name", ["reference", "positive_stop", "negative_stop", "reset"])
def test_every_input_can_be_tied_and_opened(rig: Rig, name: str) -> None:
    """At the line's present time; and it can be read back."""
    assert getattr(rig.twin.inputs, name) is False
    rig.line.advance(NS_PER_MS)
    setattr(rig.twin.inputs, name, True)
    assert getattr(rig.twin.inputs, name) is True
    setattr(rig.twin.inputs, name, 0)
    assert getattr(rig.twin.inputs, name) is False
    assert rig.toy.done == [(NS_PER_MS, name, True), (NS_PER_MS, name, False)]


def test_an_unknown_input_is_refused_with_the_nearest_name(rig: Rig) -> None:
    """For reading and for setting."""
    with pytest.raises(UsageError, match="unknown input 'refrence': did you mean reference"):
        rig.twin.inputs.refrence = True
    with pytest.raises(UsageError, match="did you mean positive_stop"):
        rig.twin.inputs.postive_stop  # noqa: B018


@pytest.mark.parametrize("value", ["on", 2, None, "False"])
def test_an_input_is_true_or_false(rig: Rig, value: Any) -> None:
    """A text is not taken for True; nothing happens."""
    with pytest.raises(UsageError, match=r"input reset: .* is not allowed; set True or False"):
        rig.twin.inputs.reset = value
    assert rig.toy.done == []


def test_supply_and_temperature_have_units(rig: Rig) -> None:
    """Volts and degrees Celsius outside, thousandths inside."""
    assert (rig.twin.supply_volts, rig.twin.temperature_celsius) == (24.0, 25.0)
    rig.twin.supply_volts = 46.05
    rig.twin.temperature_celsius = -12.5
    assert (rig.twin.supply_volts, rig.twin.temperature_celsius) == (46.05, -12.5)
    assert rig.toy.done == [(0, "supply", 46_050), (0, "temperature", -12_500)]


@pytest.mark.parametrize("volts", [-0.1, 1e4, float("nan"), float("inf"), "24", None, True])
def test_an_impossible_supply_is_refused_in_one_line(rig: Rig, volts: Any) -> None:
    """The message names what was set and what is allowed."""
    with pytest.raises(UsageError, match=r"supply_volts = .* 0\.\.1000 V"):
        rig.twin.supply_volts = volts
    with pytest.raises(UsageError, match=r"temperature_celsius = .* -273\.\.1000 °C"):
        rig.twin.temperature_celsius = float("nan")
    assert rig.toy.done == []


def test_effects_of_a_hand_are_performed(rig: Rig) -> None:
    """What the device stores and tells in answer reaches memory and subscribers at once."""
    traces: list[tuple[Twin, Trace]] = []
    rig.line.subscribe(lambda twin, trace: traces.append((twin, trace)))
    rig.twin.temperature_celsius = 90
    assert rig.slot.cells["writes"] == 1
    assert traces == [(rig.twin, ToyTrace(0, "hot"))]


def test_the_load_is_set_as_a_whole_or_value_by_value(rig: Rig) -> None:
    """Each change gives the device a whole load."""
    rig.twin.load = Load(torque_nm=0.5)
    rig.twin.load.held = True
    assert rig.twin.load == Load(torque_nm=0.5, held=True)
    assert rig.twin.load.torque_nm == Fraction(1, 2)
    assert [load for _, _, load in rig.toy.done] == [Load(0.5), Load(0.5, held=True)]
    assert "held=True" in repr(rig.twin.load)


def test_a_bad_load_is_refused_in_one_line(rig: Rig) -> None:
    """Unknown values, values out of range, and what is no load."""
    with pytest.raises(UsageError, match="unknown load 'heldd': did you mean held"):
        rig.twin.load.heldd = True
    with pytest.raises(UsageError, match="torque_nm -1 is not allowed"):
        rig.twin.load.torque_nm = -1
    with pytest.raises(UsageError, match="set a Load of"):
        rig.twin.load = 0.5  # type: ignore[assignment]
    assert rig.toy.done == []
    assert rig.twin.load == Load()


def test_a_shaft_can_be_turned_by_hand(rig: Rig) -> None:
    """By whole increments."""
    rig.twin.push(-7)
    assert rig.twin.position == rig.slot.cells["position"] == -7
    with pytest.raises(UsageError, match=r"push 0\.5 is no number of increments"):
        rig.twin.push(0.5)  # type: ignore[arg-type]


def test_a_fault_can_be_made_and_taken_away(rig: Rig) -> None:
    """The device knows the names."""
    rig.twin.set_fault("encoder")
    rig.twin.set_fault("encoder", present=False)
    assert rig.toy.done == [(0, "fault encoder", True), (0, "fault encoder", False)]


def test_power_is_cut_and_applied_once(rig: Rig) -> None:
    """Cutting what is cut already does nothing; the position outlives it."""
    rig.line.send(b"G")
    rig.line.advance(NS_PER_S)
    rig.twin.power_off()
    rig.twin.power_off()
    powered = [rig.twin.is_powered]
    rig.line.advance(NS_PER_S)
    rig.twin.power_on()
    rig.twin.power_on()
    powered.append(rig.twin.is_powered)
    assert powered == [False, True]
    assert rig.toy.done == [(NS_PER_S, "power", False), (2 * NS_PER_S, "power", True)]
    assert rig.slot.cells["position"] == rig.twin.position == 999


def test_a_twin_without_power_hears_nothing(rig: Rig) -> None:
    """And answers when it has power again."""
    rig.twin.power_off()
    rig.line.send(b"W")
    rig.line.advance(NS_PER_S)
    assert rig.line.receive() == b""
    rig.twin.power_on()
    rig.line.send(b"W")
    rig.line.wait(2 * NS_PER_S)
    assert rig.line.receive() == b"K"


def test_a_power_cycle_takes_the_time_it_is_told_to(rig: Rig) -> None:
    """Virtual time moves by the pause alone."""
    rig.twin.power_cycle(off_s=2.5)
    assert [(now, on) for now, _, on in rig.toy.done] == [(0, False), (2_500_000_000, True)]
    rig.twin.power_cycle()
    assert rig.line.sync() == 2_500_000_000
    with pytest.raises(UsageError, match="off_s"):
        rig.twin.power_cycle(off_s=-1)


def test_a_power_cycle_in_scaled_time_waits_in_the_twins_time() -> None:
    """Twenty seconds at speed 1000 are twenty milliseconds."""
    rig = Rig(speed=1000.0)
    rig.twin.power_cycle(off_s=20)
    (off_ns, _, _), (on_ns, _, _) = rig.toy.done
    assert on_ns - off_ns >= 20 * NS_PER_S
