"""Restarts, the supply, and what outlives them (ledger §3.3, §5.10)."""

import pytest
from mac_bench import MS, SILENCE, MacBench, S

from axistwin.devices.mac.serial.device import MacSerial
from axistwin.devices.mac.serial.framing import checksum
from axistwin.kernel.effects import Store, Transmit
from axistwin.runtime.network import SerialNetwork
from axistwin.wire.framing import LineFormat

EXAMPLE_20H = bytes.fromhex("02 30 31 34 30 30 32 30 30 30 30 30 30 30 30 30 30 30 41 32 03")
ANSWER_20H = bytes.fromhex("06 13 02 30 31 31 30 30 30 30 30 30 30 30 30 30 30 31 30 03 1A")

# ---- restart (00h, 01h, power, reset input) ----


@pytest.mark.parametrize("index", [0x00, 0x01])
def test_after_a_restart_everything_is_lost_for_two_seconds(index: int) -> None:
    """No reply, no effect, nothing queued; then alive (MACS-CMD-00-02, -01-03)."""
    bench = MacBench()
    bench.do(index)
    end = bench.now + 2 * S
    while bench.now + 25 * MS < end:
        assert bench.ask(0x0C, 0x11) == SILENCE
        bench.advance(20 * MS)
    bench.run_until(end)
    assert bench.read(0x26) >> 16 & 0xFF == 0x60


def test_the_first_byte_heard_after_the_boot_counts() -> None:
    """Deaf for exactly 2.000 s after the reply (MACS-AMB-21)."""
    for early, reply in ((0, ANSWER_20H), (1, SILENCE)):
        bench = MacBench()
        bench.do(0x00)
        bench.advance(2 * S - LineFormat(38400).span_ns(1) - early)
        assert bench.send(EXAMPLE_20H) == reply


def test_00h_drops_motion_and_modes_but_keeps_position_and_parameters() -> None:
    """MACS-CMD-00-01."""
    bench = MacBench()
    bench.do(0x0D, 0x1000)
    bench.do(0x15, 0x320)
    bench.advance(S)
    bench.reset()
    position = bench.position()
    assert position > 1000
    bench.advance(S)
    assert bench.position() == position
    assert bench.state() == "OF"
    assert bench.read(0x25) & 0xFFFF == 0x1000


def test_01h_restores_the_factory_but_not_the_position() -> None:
    """Address 00, 38400 baud, all parameters; the counter stays (MACS-CMD-01-01, -02)."""
    bench = MacBench(address=5, cells={"baud": 9600, "position": 123})
    for index, value in ((0x0C, 0x10), (0x0D, 0x1000), (0x0F, 1), (0x09, 55), (0x1C, 9)):
        bench.do(index, value)
    bench.do(0x01)
    bench.advance(2 * S)
    bench.address = 0
    assert bench.device.line_format.baud == 38400
    assert bench.read(0x26) == 0x0A601000
    assert bench.read(0x25) == 0x05000320
    assert bench.read(0x22) == 0x3FFFFFFF
    assert bench.read(0x23) == 0xC0000000
    assert bench.position() == 123


def test_while_the_reset_input_is_held_the_module_is_dead_then_boots() -> None:
    """MACS-IO-01."""
    bench = MacBench()
    bench.do(0x13, 100_000)
    bench.input("reset", True)
    assert bench.state() == "RI"
    bench.advance(10 * S)
    assert bench.ask(0x20) == SILENCE
    bench.input("reset", False)
    assert bench.state() == "BT"
    assert bench.ask(0x20) == SILENCE
    bench.advance(2 * S)
    assert bench.state() == "OF"
    assert bench.position() < 100


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("etx_to_reset_us", [500, 1500])
def test_a_module_held_in_reset_says_nothing_more(paced: bool, etx_to_reset_us: int) -> None:
    """A waiting reply never comes, one under way breaks off (MACS-IO-01)."""
    device = MacSerial("mac23", 0)
    network = SerialNetwork([device], paced=paced)
    network.host_send(EXAMPLE_20H)
    etx_ns = LineFormat(38400).span_ns(21) if paced else 0
    network.run_until(etx_ns + etx_to_reset_us * 1000)
    heard = network.host_take()
    assert ANSWER_20H.startswith(heard)
    network.perform(0, device.set_input(network.now_ns, "reset", True))
    network.run_until(network.now_ns + S)
    assert network.host_available <= (1 if paced else 0)  # at most the byte that broke off
    network.perform(0, device.set_input(network.now_ns, "reset", False))
    network.run_until(network.now_ns + 2 * S)
    network.host_take()
    network.host_send(EXAMPLE_20H)
    network.run_until(network.now_ns + S)
    assert network.host_take() == ANSWER_20H


@pytest.mark.parametrize(("echo", "digits"), [("as_sent", b"FF"), ("own_address", b"00")])
def test_an_answer_of_zeros_to_all_carries_the_address_of_every_answer(
    echo: str, digits: bytes
) -> None:
    """MACS-REPLY-08, MACS-AMB-17, MACS-AMB-58."""
    bench = MacBench(unknown_index="zero_answer", general_echo=echo)
    answer = bench.ask(0x2A, address=0xFF)
    assert answer[6:8] == digits
    assert answer[17:19] == checksum(answer[6:17])


def test_power_off_silences_and_power_on_boots() -> None:
    """Nothing is heard without power; two seconds after power-up it lives (MACS-AMB-21)."""
    bench = MacBench()
    bench.take(bench.device.power_off(bench.now))
    assert bench.state() == "off"
    assert bench.ask(0x20) == SILENCE
    bench.take(bench.device.power_on(bench.now))
    bench.advance(1994 * MS)
    assert bench.ask(0x20) == SILENCE
    bench.advance(MS)
    assert bench.ask(0x20) == ANSWER_20H


# ---- stored cells ----

STORED = [
    (0x02, 0, "standby", 0),
    (0x03, 9, "stops", 9),
    (0x09, 0x1234, "superior_stop", 0x1234),
    (0x0A, 0xFFFFFF00, "inferior_stop", -256),
    (0x0C, 0x20, "torque", 0x20),
    (0x0D, 0x0400, "period", 0x400),
    (0x0E, 0x0700, "catchup", 7),
    (0x0F, 0x02, "ramp", 2),
    (0x1C, 0x30, "tolerance", 0x30),
]


@pytest.mark.parametrize(("index", "parameters", "cell", "value"), STORED)
def test_a_parameter_is_stored_durably_before_its_acknowledgement(
    index: int, parameters: int, cell: str, value: int
) -> None:
    """The Store stands in front of the Transmit and a new device reads it (MACS-PERS-01, -02)."""
    bench = MacBench()
    bench.do(index, parameters)
    store, transmit = bench.effects[-2:]
    assert store == Store(((cell, value),), durable=True)
    assert isinstance(transmit, Transmit)
    again = MacBench(cells=dict(bench.device.cells(bench.now)))
    for query in (0x22, 0x23, 0x25, 0x26):
        assert again.read(query) == bench.read(query)


def test_a_refused_parameter_stores_nothing() -> None:
    """MACS-REPLY-05."""
    bench = MacBench()
    bench.refuse(0x0C, 0x81)
    bench.refuse(0x0D, 0)
    bench.refuse(0x03, 2)
    assert not bench.stores


def test_the_position_is_handed_on_at_every_end_of_a_motion_and_kept_over_power_off() -> None:
    """MACS-PERS-01, MACS-Q-20-02: not durable, the hardware saves it when the supply fails."""
    bench = MacBench()
    bench.do(0x13, 777)
    bench.settle()
    assert Store((("position", 777),), durable=False) in bench.effects[-2:]
    bench.do(0x15, 0x320)
    bench.advance(S // 2)
    moving = bench.device.cells(bench.now)["position"]
    assert moving > 777
    bench.take(bench.device.power_off(bench.now))
    assert bench.stores["position"] == moving
    bench.take(bench.device.power_on(bench.now))
    bench.advance(2 * S)
    assert bench.position() == moving


def test_a_shaft_turned_while_the_supply_is_off_is_not_counted() -> None:
    """The position is valid only if the shaft was not moved (MACS-Q-20-02)."""
    bench = MacBench(cells={"position": 100})
    bench.take(bench.device.power_off(bench.now))
    bench.take(bench.device.push(bench.now, 50))
    bench.take(bench.device.power_on(bench.now))
    bench.advance(2 * S)
    assert bench.position() == 100
    bench.take(bench.device.push(bench.now, 50))
    assert bench.position() == 150


def test_the_counter_stands_while_the_supply_is_off() -> None:
    """One truth: reading and cell stay as saved, whatever the shaft does (MACS-PERS-01)."""
    bench = MacBench(cells={"position": 100})
    bench.take(bench.device.power_off(bench.now))
    bench.take(bench.device.push(bench.now, 50))
    assert bench.device.position_at(bench.now) == 100
    assert bench.device.cells(bench.now)["position"] == 100
    assert not bench.device.is_moving(bench.now)


def test_a_shaft_that_coasts_without_supply_is_not_counted() -> None:
    """Saved once, when the supply fails; nothing is written without it (MACS-Q-20-02)."""
    bench = MacBench(plant="inertial", factory_ramp=0)
    bench.do(0x15, 100)
    bench.advance(S)
    bench.take(bench.device.power_off(bench.now))
    saved = bench.stores["position"]
    before = len(bench.effects)
    bench.advance(20 * S)
    assert len(bench.effects) == before
    assert bench.device.position_at(bench.now) == saved
    bench.take(bench.device.power_on(bench.now))
    bench.advance(2 * S)
    assert bench.position() == saved


def test_a_shaft_that_still_coasts_is_counted_again_when_the_supply_is_back() -> None:
    """From the saved number on (MACS-Q-20-02, MACS-CMD-1A-02)."""
    bench = MacBench(plant="inertial", factory_ramp=0)
    bench.do(0x15, 100)
    bench.advance(S)
    bench.take(bench.device.power_off(bench.now))
    saved = bench.stores["position"]
    bench.advance(10 * MS)
    bench.take(bench.device.power_on(bench.now))
    assert bench.device.position_at(bench.now) == saved
    bench.advance(30 * S)
    assert bench.position() > saved + 1000
    assert bench.stores["position"] == bench.position()


def test_stored_address_and_rate_win_over_the_constructor() -> None:
    """What a module stored is what it is."""
    device = MacSerial("mac23", 1, cells={"address": 9, "baud": 19200})
    assert device.address == 9
    assert device.line_format == LineFormat(19200)


def test_impossible_cells_are_ignored() -> None:
    """A cell that this device could not have stored reads as from the factory."""
    strange = {"baud": 12345, "address": 200, "period": 0, "stops": 5, "torque": 0x81, "mystery": 4}
    device = MacSerial("mac23", 1, cells=strange)
    assert device.address in (0, 1)
    assert device.axis.values["stops"] == 0
    assert device.axis.values["torque"] == 0x60
    assert MacBench(cells=strange).read(0x29, 0) == 0x00030100
    assert device.line_format == LineFormat(38400)
    assert device.axis.values["period"] == 0x320


@pytest.mark.parametrize(("imax", "torque"), [(0x40, 0x40), (0x60, 0x60), (0xFF, 0x60)])
def test_the_factory_torque_is_within_imax(imax: int, torque: int) -> None:
    """At start and after 01h: no motor gives more than its maximum (MACS-AMB-11, -25)."""
    bench = MacBench(imax_value=imax)
    assert bench.read(0x26) >> 16 & 0xFF == torque
    bench.do(0x0C, 1)
    bench.do(0x01)
    bench.advance(2 * S)
    assert bench.read(0x26) >> 16 & 0xFF == torque
