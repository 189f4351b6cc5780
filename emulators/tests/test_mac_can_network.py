"""Boot-up, emergency, lifebeat, SYNC, address procedure, general message (ledger §3.2, §6)."""

from typing import Any

import pytest
from can_bench import CanBench, emergencies
from mac_bench import MS, TICK_NS, S

from axistwin.devices.mac.can.device import MacCan
from axistwin.kernel.effects import Effect, SendFrame
from axistwin.wire.can_frame import CanFrame

HEALTHY = "00 00 00 00 00 00 00 00"
READ = "40 00 20 00 00 00 00 00"
UNDER, NORMAL, OVER = 11_000, 24_000, 47_000  # mV
HOT, COOL = 90_000, 25_000  # m°C


def supply(bench: CanBench, millivolts: int) -> None:
    """Change the supply now."""
    bench.take(bench.device.set_supply(bench.now, millivolts))


def temperature(bench: CanBench, millidegrees: int) -> None:
    """Change the temperature now."""
    bench.take(bench.device.set_temperature(bench.now, millidegrees))


@pytest.fixture
def bench() -> CanBench:
    """A module at rest, with the defaults."""
    return CanBench()


# ---- boot-up ----


@pytest.mark.parametrize("address", [1, 2, 127])
def test_power_up_ends_in_one_boot_up_after_exactly_two_seconds(address: int) -> None:
    """700h + address, one byte 00h; nothing before (MACC-BOOT-01, -02, -04)."""
    bench = CanBench(address=address, started=False)
    assert bench.device.next_event() == 2 * S
    bench.run_until(11 * S)
    assert bench.frames == [(2 * S, CanFrame(0x700 + address, b"\0"))]


def test_a_started_module_has_its_boot_up_behind_it(bench: CanBench) -> None:
    """Its first lifebeat is 10 s after time 0."""
    bench.run_until(10 * S)
    assert emergencies(bench) == [(10 * S, HEALTHY)]
    assert len(bench.frames) == 1


# ---- lifebeat ----


def test_the_lifebeat_comes_every_ten_seconds_of_silence() -> None:
    """From the boot-up on, exact to the nanosecond, for ever (MACC-EMCY-01)."""
    bench = CanBench(address=3, started=False)
    bench.run_until(3600 * S)
    assert emergencies(bench) == [(12 * S + n * 10 * S, HEALTHY) for n in range(359)]


def test_an_own_request_restarts_the_ten_seconds() -> None:
    """At the end of its frame, refused ones and uploads alike (MACC-EMCY-05)."""
    for data in (READ, "23 12 20 00 00 00 00 00", "40 00 10 00 00 00 00 00", "00" * 8):
        bench = CanBench()
        bench.run_until(7 * S)
        bench.say(0x601, data)
        asked = bench.etx_ns
        bench.advance(25 * S)
        assert [at for at, _ in emergencies(bench)] == [asked + 10 * S, asked + 20 * S]


def test_a_poll_per_second_keeps_the_module_quiet(bench: CanBench) -> None:
    """15 s of requests: no spontaneous message (MACC-AMB-06)."""
    for _ in range(15):
        bench.say(0x601, READ)
        bench.advance(S)
    assert emergencies(bench) == []


@pytest.mark.parametrize(
    ("identifier", "data"),
    [
        (0x600, "23 12 20 00 00 00 00 00"),
        (0x600, READ),
        (0x080, ""),
        (0x7E5, "04 01"),
        (0x602, READ),
        (0x000, "01 00"),
        (0x601, "40 00 20 00"),  # too short: ignored entirely
    ],
)
def test_other_traffic_does_not_restart_the_ten_seconds(
    bench: CanBench, identifier: int, data: str
) -> None:
    """General, SYNC, LMT, foreign and malformed frames (MACC-EMCY-05, trap 14)."""
    for _ in range(12):
        bench.say(identifier, data)
        bench.advance(S)
    assert [at for at, _ in emergencies(bench)] == [10 * S]


def test_no_lifebeat_while_the_module_starts_or_is_held(bench: CanBench) -> None:
    """Trap 38; the boot-up starts the 10 s anew."""
    bench.run_until(9 * S)
    bench.do(0x00)
    restarted = bench.now
    count = len(bench.frames)
    bench.run_until(restarted + 12 * S)
    assert [at for at, _ in bench.frames[count:]] == [restarted + 2 * S, restarted + 12 * S]
    bench.input("reset", True)
    count = len(bench.frames)
    bench.advance(100 * S)
    assert len(bench.frames) == count


def test_the_lifebeat_repeats_the_present_content() -> None:
    """The stop byte is told although it is no error (ledger §6.3)."""
    bench = CanBench(factory_stops=8, factory_superior_stop=50)
    bench.do(0x13, 500)
    bench.settle()
    bench.advance(10 * S)
    assert [payload for _, payload in emergencies(bench)] == ["00 00 00 00 02 00 00 00"]


# ---- emergency ----


@pytest.mark.parametrize(
    ("act", "dd", "head"),
    [
        (lambda bench: supply(bench, OVER), "40", "10 32 05"),
        (lambda bench: supply(bench, UNDER), "20", "20 32 05"),
        (lambda bench: temperature(bench, HOT), "10", "00 42 09"),
        (
            lambda bench: bench.take(bench.device.set_fault(bench.now, "micro_cut", True)),
            "01",
            "00 31 05",
        ),
    ],
)
def test_every_error_is_told_when_it_appears(act: Any, dd: str, head: str) -> None:
    """At once: code low byte first, register, dd ff gg hh, 00 (MACC-EMCY-02..04)."""
    bench = CanBench(address=5)
    act(bench)
    hh = "80" if dd == "40" else "00"
    assert bench.frames == [
        (bench.now, CanFrame(0x085, bytes.fromhex(f"{head} {dd} 00 00 {hh} 00")))
    ]


def test_a_warning_that_goes_is_told_as_code_zero(bench: CanBench) -> None:
    """And the 10 s count from each message (MACC-EMCY-02, MACC-AMB-28)."""
    supply(bench, UNDER)
    appeared = bench.now
    bench.advance(3 * S)
    supply(bench, NORMAL)
    gone = bench.now
    bench.advance(10 * S)
    assert emergencies(bench) == [
        (appeared, "20 32 05 20 00 00 00 00"),
        (gone, HEALTHY),
        (gone + 10 * S, HEALTHY),
    ]


def test_every_change_of_dd_is_told_even_if_the_code_stays(bench: CanBench) -> None:
    """The thermal fault hides the warning, but dd tells both (ledger §6.3)."""
    temperature(bench, HOT)
    supply(bench, UNDER)
    supply(bench, UNDER - 100)
    temperature(bench, COOL)  # the fault is latched
    assert [payload for _, payload in emergencies(bench)] == [
        "00 42 09 10 00 00 00 00",
        "00 42 09 30 00 00 00 00",
    ]


def test_codes_follow_their_priority(bench: CanBench) -> None:
    """dd.4, dd.0, dd.6, dd.5."""
    supply(bench, OVER)
    bench.take(bench.device.set_fault(bench.now, "micro_cut", True))
    temperature(bench, HOT)
    codes = [payload[:8] for _, payload in emergencies(bench)]
    assert codes == ["10 32 05", "00 31 05", "00 42 09"]


def test_an_error_that_outlasts_the_restart_is_told_after_the_boot_up(bench: CanBench) -> None:
    """Boot-up first, then the emergency, both at the end of the boot; nothing during it."""
    temperature(bench, HOT)
    count = len(bench.frames)
    bench.do(0x00)
    left = bench.now
    bench.advance(3 * S)
    assert bench.frames[count + 1 :] == [
        (left + 2 * S, CanFrame(0x701, b"\0")),
        (left + 2 * S, CanFrame(0x081, bytes.fromhex("0042091000000000"))),
    ]


def test_a_restart_acknowledges_what_has_gone(bench: CanBench) -> None:
    """The boot-up is the only message (MACC-CMD-00-01)."""
    temperature(bench, HOT)
    temperature(bench, COOL)
    assert bench.state() == "DJ"
    count = len(bench.frames)
    bench.reset()
    assert bench.told(count) == ["581#6000200000000000", "701#00"]
    assert bench.state() == "OF"


# ---- SYNC ----


def test_sync_starts_what_is_preloaded_at_the_end_of_its_frame(bench: CanBench) -> None:
    """As 2011h, without an answer; the arm is spent (MACC-SYNC-01..03, trap 12)."""
    bench.do(0x0F, 0)
    bench.do(0x10)
    bench.do(0x13, 4)
    bench.advance(S)
    assert bench.position() == 0
    assert bench.say(0x080) == []
    assert bench.position_at(bench.etx_ns + 800 * TICK_NS) == 1
    assert bench.settled_position() == 4
    bench.do(0x13, 8)
    assert bench.settled_position() == 8


def test_sync_takes_data_and_ignores_it(bench: CanBench) -> None:
    """MACC-SYNC-05."""
    bench.do(0x10)
    bench.do(0x13, 4)
    assert bench.say(0x080, "11") == []
    assert bench.state() == "PO"


def test_sync_without_a_preload_does_nothing(bench: CanBench) -> None:
    """Armed or not, and it does not arm (MACC-SYNC-04)."""
    bench.say(0x080)
    bench.do(0x10)
    bench.say(0x080)
    assert bench.state() == "OF+AR"
    bench.do(0x13, 4)
    assert bench.state() == "OF+PL"
    assert bench.position() == 0


def test_the_emergency_of_another_module_is_no_sync() -> None:
    """Trap 13: 081h and its like start nothing."""
    bench = CanBench(address=2)
    bench.do(0x10)
    bench.do(0x13, 4)
    for identifier in (0x081, 0x082, 0x0FF):
        bench.say(identifier, HEALTHY)
    assert bench.state() == "OF+PL"


# ---- the address procedure ----


@pytest.mark.parametrize("length", [2, 3, 7, 8])
def test_the_address_procedure(length: int) -> None:
    """Only 11 is answered; boot-up at the new address 2 s after 04 00 (MACC-LMT-01..03)."""
    bench = CanBench(address=4)
    parts = [bytes.fromhex(each).ljust(length, b"\xa5") for each in ("0401", "1155", "0400")]
    assert bench.say(0x7E5, parts[0]) == []
    assert bench.say(0x7E5, parts[1]) == ["7E4#1100000000000000"]
    assert bench.say(0x604, READ) == ["584#4200200000000000"]  # MACC-LMT-08, trap 15
    assert "address" not in bench.stores
    count = len(bench.frames)
    assert bench.say(0x7E5, parts[2]) == []
    left = bench.etx_ns
    bench.advance(3 * S)
    assert bench.frames[count:] == [(left + 2 * S, CanFrame(0x755, b"\0"))]
    assert bench.say(0x604, READ) == []
    assert bench.say(0x655, READ) == ["5D5#4200200000000000"]
    assert bench.stores["address"] == 0x55
    bench.power_cycle()
    assert bench.told()[-1] == "755#00"


def test_an_abandoned_procedure_leaves_the_old_address() -> None:
    """Given, but not taken over: forgotten at the next start (MACC-LMT-03)."""
    bench = CanBench(address=4)
    bench.say(0x7E5, "04 01")
    bench.say(0x7E5, "11 55")
    bench.power_cycle()
    assert bench.say(0x7E5, "04 00") == []
    bench.advance(3 * S)
    assert bench.say(0x604, READ) == ["584#4200200000000000"]
    assert "address" not in bench.stores


def test_addresses_from_1_to_127_are_taken() -> None:
    """Both ends (MACC-LMT-04)."""
    for address in (1, 0x7F):
        bench = CanBench(address=4)
        bench.say(0x7E5, "04 01")
        assert bench.say(0x7E5, bytes((0x11, address))) == ["7E4#1100000000000000"]
        bench.say(0x7E5, "04 00")
        assert bench.device.address == address


@pytest.mark.parametrize("address", [0x00, 0x80, 0xFF])
def test_other_addresses_are_refused(address: int) -> None:
    """11 01 00; the end of the procedure then changes nothing (MACC-LMT-05, -07, trap 17)."""
    bench = CanBench(address=4)
    bench.say(0x7E5, "04 01")
    assert bench.say(0x7E5, bytes((0x11, address))) == ["7E4#1101000000000000"]
    assert bench.say(0x7E5, "04 00") == []
    assert bench.state() == "OF"
    assert bench.say(0x604, READ) == ["584#4200200000000000"]


def test_frames_of_the_procedure_out_of_order_do_nothing() -> None:
    """11 outside configuration mode, 04 00 alone, 04 01 04 00 (MACC-LMT-06, -07)."""
    bench = CanBench(address=4)
    for data in ("11 55", "04 00", "04 01", "04 00", "11 55", "04 02", "04", "", "11"):
        assert bench.say(0x7E5, data) == []
    assert bench.state() == "OF"
    assert bench.device.address == 4
    assert bench.device.describe(bench.now)["configuration_mode"] is False


@pytest.mark.parametrize("data", ["13 00 02", "15 00", "17 00", "40 01", "5A 00", "5E 00", "4C 01"])
def test_other_services_are_ignored(bench: CanBench, data: str) -> None:
    """In configuration mode and outside it (MACC-LMT-09)."""
    assert bench.say(0x7E5, data) == []
    bench.say(0x7E5, "04 01")
    assert bench.say(0x7E5, data) == []


def test_two_modules_on_the_bus_take_the_same_address() -> None:
    """Configuration mode is global (ledger §6.1)."""
    one, other = CanBench(address=4), CanBench(address=5)
    for bench in (one, other):
        for data in ("04 01", "11 09", "04 00"):
            bench.say(0x7E5, data)
        bench.advance(3 * S)
    assert one.told()[-1] == other.told()[-1] == "709#00"


# ---- the general message ----


def test_all_obey_the_general_message_and_module_1_answers() -> None:
    """With its own verdict, on 581h (MACC-GEN-01..03, traps 9 and 10)."""
    one, two = CanBench(address=1), CanBench(address=2)
    for bench, reply in ((one, ["581#600C200000000000"]), (two, [])):
        assert bench.say(0x600, "23 0C 20 00 00 00 00 22") == reply
        assert bench.read(0x26) >> 16 & 0xFF == 0x22
    two.do(0x15, 0x320)
    one.do(0x15, 0x320)
    assert one.say(0x600, "23 0D 20 00 00 00 01 00") == ["581#800D200000000000"]
    assert two.say(0x600, "23 0D 20 00 00 00 01 00") == []
    assert one.say(0x600, READ)[0].startswith("581#4200200000000")
    assert two.say(0x600, READ) == []


def test_a_general_reset_restarts_all_at_once() -> None:
    """Module 1 when its reply has left, the mute ones with the frame."""
    for address, replies in ((1, 1), (2, 0)):
        bench = CanBench(address=address)
        count = len(bench.frames)
        assert len(bench.say(0x600, "23 00 20 00 00 00 00 00")) == replies
        restarted = bench.now
        bench.advance(5 * S)
        assert bench.frames[count + replies :] == [
            (restarted + 2 * S, CanFrame(0x700 + address, b"\0"))
        ]


def test_a_preload_for_all_and_one_sync_start_all_at_the_same_tick() -> None:
    """Two modules, equal commands at different times, one SYNC (ledger §6.4, trap 37)."""
    modules = [MacCan(address) for address in (1, 2)]
    for number, module in enumerate(modules):
        at = S + number * 7_654_321
        module.receive(CanFrame(0x600, bytes.fromhex("2310200000000000")), at)
        download = bytes.fromhex("2313200000001388")
        module.receive(CanFrame(0x601 + number, download), at + 3 * MS)
    sync = 2 * S + 12_345
    for module in modules:
        module.receive(CanFrame(0x080), sync)
    for later in (1 * MS, 30 * MS, 300 * MS, 700 * MS):
        positions = []
        for module in modules:
            while (due := module.next_event()) is not None and due <= sync + later:
                module.wake(due)
            positions.append(module.position_at(sync + later))
        assert positions[0] == positions[1]
    assert positions[0] > 100


def test_real_and_virtual_segments_on_two_modules_end_at_the_same_tick() -> None:
    """DDDD·VVVV ticks each, for ever in step (MACC-CMD-1E-01, trap 37)."""
    segments = [(7, 0x1234), (1, 0xFFFF), (1000, 3), (13, 0x0777)]
    ticks = sum(count * period for count, period in segments)
    for index, steps in ((0x16, 1021), (0x1E, 0)):
        bench = CanBench()
        bench.do(index, segments[0][0] << 16 | segments[0][1])
        start = bench.etx_ns
        for count, period in segments[1:]:
            bench.do(index, count << 16 | period)
        assert bench.settle() - start == ticks * TICK_NS
        assert bench.position() == steps


# ---- what a node ignores ----


def test_nmt_guarding_and_other_protocols_are_ignored(bench: CanBench) -> None:
    """000h, time stamp, PDOs, heartbeat of others (MACC-AMB-24)."""
    frames = [(0x000, "02 01"), (0x000, "81 00"), (0x100, "00" * 6), (0x181, "00"), (0x702, "05")]
    for identifier, data in frames:
        assert bench.say(identifier, data) == []
    bench.put(CanFrame(0x701, is_remote=True, length=1))
    bench.advance(5 * S)
    assert bench.told() == []
    assert bench.say(0x601, READ) == ["581#4200200000000000"]


def test_a_frame_it_does_not_accept_has_no_effect_even_if_it_is_handed_over() -> None:
    """``accepts`` only spares the call."""
    module = MacCan(1)
    frame = CanFrame(0x602, bytes.fromhex("2300200000000000"))
    assert not module.accepts(frame)
    effects: list[Effect] = module.receive(frame, S)
    assert effects == []
    assert module.accepts(CanFrame(0x601, b""))
    assert not [each for each in module.wake(S) if isinstance(each, SendFrame)]
