"""What a controller remembers: through power cycles, restarts, and with a battery that fails."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msc_bench import ACK, MscBench, bread, bwrite, dwrite, flag, rqstat

from axistwin.catalog import build_line, parse_device
from axistwin.devices.msc.controller import MscController
from axistwin.devices.msc.data_area import DataArea
from axistwin.devices.msc.quirks import parse_quirks
from axistwin.devices.traces import StateChanged
from axistwin.errors import StateError, UsageError
from axistwin.kernel.effects import Store
from axistwin.macroprogram import Macroprogram, Variable
from axistwin.programs.bench import Bench
from axistwin.runtime.clock import VirtualClock
from axistwin.runtime.line import Line
from axistwin.runtime.storage import Storage

VALUES = st.integers(-(1 << 31), (1 << 31) - 1)


class Counting(Macroprogram):
    """One more in every scan."""

    count = Variable(0x1800)

    def scan(self) -> None:
        """Count."""
        self.count += 1


def power_cycle(bench: MscBench) -> None:
    """Off for a second, and on."""
    bench.network.power_off(0)
    bench.wait(1000)
    bench.network.power_on(0)


@given(st.integers(0, 0x1FFF), VALUES)
def test_what_is_written_is_read(number: int, value: int) -> None:
    """MSC-PROP-08, on every 32-bit value; reading changes nothing (MSC-DREAD-04)."""
    bench = MscBench(paced=False)
    assert bench.ask(dwrite(4 * number, value)) == ACK
    assert bench.value(4 * number) == bench.value(4 * number) == value


@pytest.mark.strength
@given(
    st.lists(st.tuples(st.integers(0, 63), st.lists(VALUES, min_size=1, max_size=32)), max_size=8)
)
def test_blocks_and_values_agree_with_a_dictionary(writes: list[tuple[int, list[int]]]) -> None:
    """MSC-PROP-09: padding is stored too, neighbours behind an array are overwritten."""
    bench, model = MscBench(paced=False), dict.fromkeys(range(0, 4 * 128, 4), 0)
    for number, values in writes:
        if len(values) == 1:
            assert bench.ask(dwrite(4 * number, values[0])) == ACK
            model[4 * number] = values[0]
        else:
            values = (values + [0] * 32)[:32]
            assert bench.ask(bwrite(4 * number, values)) == ACK
            model.update({4 * (number + place): value for place, value in enumerate(values)})
    heard = b"".join(bench.ask(bread(address))[13:-2] for address in range(0, 4 * 128, 128))
    assert heard == b"".join(value.to_bytes(4, "big", signed=True) for value in model.values())


def test_the_battery_keeps_the_data_and_nothing_else() -> None:
    """Flags and conditions are gone, bit 6 aside."""
    bench = MscBench(auto_start=True)
    bench.ask(dwrite(2008, 1234))
    bench.ask(flag("SFLAG", 200))
    bench.perform(bench.device.set_status(bench.now, 12, on=True))
    power_cycle(bench)
    assert bench.value(2008) == 1234
    assert not bench.is_on(200)
    assert bench.status() == 64


def test_a_low_battery_is_told_and_keeps_the_data() -> None:
    """Bit 1, at once and after a power cycle; 67 says running, low, auto start (trap 33)."""
    bench = MscBench(auto_start=True)
    bench.perform(bench.device.load_program(bench.now, Bench))
    bench.perform(bench.device.start_program(bench.now))
    bench.ask(dwrite(2008, 1234))
    bench.perform(bench.device.set_battery(bench.now, "low"))
    assert bench.status() == 67
    power_cycle(bench)
    assert (bench.status(), bench.value(2008)) == (67, 1234)
    bench.perform(bench.device.set_battery(bench.now, "good"))
    assert bench.status() == 65


def test_a_flat_battery_loses_the_data_with_the_supply() -> None:
    """Zeros and bit 2 at power-up; with a new battery the next power-up is a good one."""
    bench = MscBench()
    bench.ask(dwrite(2008, 1234))
    bench.perform(bench.device.set_battery(bench.now, "flat"))
    assert (bench.value(2008), bench.status()) == (1234, 2)
    power_cycle(bench)
    assert (bench.value(2008), bench.status()) == (0, 6)
    bench.ask(dwrite(2008, 5))
    bench.perform(bench.device.set_battery(bench.now, "good"))
    assert bench.status() == 4
    power_cycle(bench)
    assert (bench.value(2008), bench.status()) == (5, 0)


def test_a_battery_that_dies_without_supply_loses_the_data_too() -> None:
    """A new one does not bring them back."""
    bench = MscBench()
    bench.ask(dwrite(2008, 1234))
    bench.network.power_off(0)
    bench.perform(bench.device.set_battery(bench.now, "flat"))
    bench.perform(bench.device.set_battery(bench.now, "good"))
    bench.network.power_on(0)
    assert (bench.value(2008), bench.status()) == (0, 4)


def test_without_supply_nothing_is_heard_or_sent() -> None:
    """Nor at power-up (MSC-PHY-04); what was being sent breaks off."""
    bench = MscBench()
    bench.ask(dwrite(8, 1))
    bench.send(bread(8))
    bench.wait(60)  # in the middle of the reply
    bench.network.power_off(0)
    bench.wait(100)
    assert bench.tell(rqstat(), 3000) == b""
    bench.network.power_on(0)
    assert bench.settle() == b""
    assert bench.tell(rqstat())[:1] == ACK


def test_switching_on_twice_is_switching_on() -> None:
    """And off twice off."""
    bench = MscBench()
    bench.ask(flag("SFLAG", 200))
    bench.network.power_on(0)
    assert bench.is_on(200)
    bench.network.power_off(0)
    bench.network.power_off(0)
    assert bench.device.describe(bench.now)["state_text"] == "off"


def test_a_self_test_delays_the_program() -> None:
    """Bit 7 for its time; commands work meanwhile; then the program starts."""
    bench = MscBench(self_test_ms=500, auto_start=True)
    bench.perform(bench.device.load_program(bench.now, Bench))
    power_cycle(bench)
    assert bench.status() == 64 + 128
    assert bench.device.describe(bench.now)["state_text"] == "self-test"
    bench.wait(200)
    assert bench.status() == 65
    bench.network.power_off(0)
    bench.network.power_on(0)
    bench.network.power_off(0)
    bench.wait(1000)
    assert bench.device.status_at(bench.now) & 1 == 0


def test_a_cleared_program_leaves_zeros() -> None:
    """Bit 3, all commands work (MSC-AMB-32); loading one ends it."""
    bench = MscBench()
    bench.perform(bench.device.load_program(bench.now, Bench))
    bench.perform(bench.device.start_program(bench.now))
    bench.ask(dwrite(2008, 1234))
    bench.ask(flag("SFLAG", 200))
    bench.perform(bench.device.clear_program(bench.now))
    assert (bench.status(), bench.value(2008), bench.is_on(200)) == (8, 0, False)
    with pytest.raises(UsageError):
        bench.device.start_program(bench.now)
    bench.perform(bench.device.load_program(bench.now, Bench))
    assert bench.status() == 0


def test_a_write_of_the_host_is_stored_durably_and_a_programs_is_not() -> None:
    """The one in front of everything else, the other for the operating system."""
    bench = MscBench()
    bench.ask(bwrite(400, range(32)))
    (stored,) = bench.device.stored
    assert stored.durable
    assert dict(stored.cells) == {f"data_{400 + 4 * n:04X}": n for n in range(32)}
    bench.perform(bench.device.load_program(bench.now, Counting))
    bench.perform(bench.device.start_program(bench.now))
    bench.device.stored.clear()
    bench.wait(1000)
    assert bench.device.stored
    assert not any(store.durable for store in bench.device.stored)
    assert (
        dict(bench.device.stored[-1].cells)["data_1800"]
        == bench.device.cells(bench.now)["data_1800"]
        > 90
    )


def test_what_it_is_doing_is_told() -> None:
    """A trace for each new state."""
    device = MscBench().device
    told = []
    for effects in (
        device.load_program(0, Bench),
        device.start_program(0),
        device.stop_program(10),
        device.clear_program(20),
        device.power_off(30),
        device.power_on(40),
    ):
        told += [each.state for each in effects if isinstance(each, StateChanged)]
    assert told == [
        *("program stopped", "program running", "program stopped"),
        *("program cleared", "off", "no program"),
    ]


# ---- on disk ----


def line_of(folder: Path, *devices: str, cold: bool = False, **quirks: str) -> Line:
    """A line whose memory is in ``folder``."""
    specs = [parse_device(device) for device in devices]
    return build_line(
        specs, quirks=quirks, clock=VirtualClock(), storage=Storage(folder), cold=cold
    )


def ask(line: Line, data: bytes) -> bytes:
    """Send, and take what comes within 300 ms."""
    line.send(data)
    line.advance(300_000_000)
    return line.receive()


def test_data_and_battery_outlive_the_process(tmp_path: Path) -> None:
    """Read back from the folder, by a unit that is taken for one that has run for long."""
    with line_of(tmp_path, "msc-250:3") as line:
        assert ask(line, dwrite(2008, -7, 3)) == ACK
        line.twins[0].battery = "low"
    with line_of(tmp_path, "msc-250:3") as line:
        assert line.twins[0].variables[2008] == -7
        assert line.twins[0].status == 2
        line.twins[0].battery = "flat"
        line.twins[0].power_cycle()
        assert line.twins[0].status == 6
    with line_of(tmp_path, "msc-250:3") as line:
        assert line.twins[0].cells == {"battery": 2, "memory_lost": 1, "data_07D8": 0}
        assert line.twins[0].status == 6


def test_a_cold_start_with_a_flat_battery_finds_nothing(tmp_path: Path) -> None:
    """Starting the program is then what power-up is."""
    with line_of(tmp_path, "msc-250") as line:
        ask(line, dwrite(2008, -7))
        line.twins[0].battery = "flat"
    with line_of(tmp_path, "msc-250", cold=True) as line:
        assert line.twins[0].variables[2008] == 0


def test_memory_that_does_not_fit_is_a_clear_error(tmp_path: Path) -> None:
    """A smaller data area cannot hold what was stored."""
    with line_of(tmp_path, "msc-250") as line:
        ask(line, dwrite(0x7000, 1))
    with pytest.raises(StateError, match="cell data_7000 cannot be 1"):
        line_of(tmp_path, "msc-250", data_size="4096")


def test_a_unit_that_is_none_is_told() -> None:
    """Models and units, in one line each."""
    with pytest.raises(UsageError, match=r"unit 16 is not in 1\.\.15"):
        MscController("msc-250", 16)
    with pytest.raises(UsageError, match="unknown model 'msc-25': did you mean msc-250"):
        MscController("msc-25")


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (lambda d: d.flag_at(0, 256), "flag 256 does not exist: 0..255"),
        (lambda d: d.set_flag(0, -1, on=True), "flag -1 does not exist: 0..255"),
        (lambda d: d.variable_at(0, 32768), "address 32768 does not exist: 0..32764"),
        (lambda d: d.set_variable(0, 8, 1 << 31), "value 2147483648 is out of range"),
        (lambda d: d.set_status(0, 16, on=True), "status bit 16 does not exist"),
        (lambda d: d.set_battery(0, "empty"), "battery 'empty': "),
    ],
)
def test_the_back_door_tells_what_does_not_exist(action: object, message: str) -> None:
    """One clear line."""
    assert callable(action)
    with pytest.raises(UsageError) as told:
        action(MscController("msc-250"))
    assert message in str(told.value)
    assert "\n" not in str(told.value)


def test_cells_are_cheap_when_the_area_is_full() -> None:
    """8192 values: sparse, and no longer than it takes to look."""
    data = DataArea(parse_quirks({}))
    for address in range(0, data.size, 4):
        data.write(address, address)
    assert len(data.cells()) == 8192
    assert isinstance(Store(data.take_changed()).cells, tuple)
