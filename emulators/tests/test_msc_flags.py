"""Flags and status word of a controller."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msc_bench import ACK, MscBench, flag, rflags

from axistwin.devices.msc.flags import FlagKind, Flags, parse_flag_map
from axistwin.devices.msc.status import ERRORS, Status, StatusBit, status_bit
from axistwin.errors import UsageError

GENERIC = parse_flag_map("generic")
assert GENERIC is not None
KINDS = GENERIC


def test_the_generic_map_is_the_ledgers() -> None:
    """Ledger §5.3."""
    expected = {
        FlagKind.INPUT: range(16),
        FlagKind.OUTPUT: range(16, 32),
        FlagKind.TIMER: range(32, 40),
        FlagKind.MOTOR: range(40, 72),
        FlagKind.UNASSIGNED: range(72, 128),
        FlagKind.USER: range(128, 256),
    }
    for kind, numbers in expected.items():
        assert {number for number in range(256) if KINDS[number] is kind} == set(numbers)


@pytest.mark.parametrize(
    "text",
    ["", "input", "input:", "input:1-", "input:-1", "input:3-2", "input:256", "x:1", "input:1/"],
)
def test_a_flag_map_that_means_nothing(text: str) -> None:
    """None."""
    assert parse_flag_map(text) is None


def test_a_flag_map_of_ones_own() -> None:
    """What is not named is unassigned; a single flag is no span."""
    kinds = parse_flag_map("timer:0-7/user:255")
    assert kinds is not None
    flags = Flags(kinds)
    assert flags.spans(FlagKind.TIMER) == "0..7"
    assert flags.spans(FlagKind.USER) == "255"
    assert flags.spans(FlagKind.INPUT) == "none"
    assert flags.spans(FlagKind.UNASSIGNED) == "8..254"


@given(st.sets(st.integers(0, 255)))
def test_the_snapshot_has_its_bytes_upward_and_its_bits_downward(numbers: set[int]) -> None:
    """Flag f is bit f mod 8 of byte f // 8 (MSC-RFLAGS-02)."""
    flags = Flags(KINDS)
    for number in numbers:
        flags.set(number, on=True)
    snapshot = flags.snapshot(0)
    assert len(snapshot) == 32
    assert {f for f in range(256) if snapshot[f // 8] >> f % 8 & 1} == numbers
    assert {f for f in range(256) if flags.state(0, f)} == numbers


@pytest.mark.strength
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 255)), max_size=40))
def test_sflag_and_cflag_agree_with_a_set(steps: list[tuple[bool, int]]) -> None:
    """Read by RFLAG and RFLAGS alike (MSC-PROP-10, MSC-PROP-11)."""
    bench = MscBench(paced=False)
    model: set[int] = set()
    for on, number in steps:
        assert bench.ask(flag("SFLAG" if on else "CFLAG", number)) == ACK
        if KINDS[number] in (FlagKind.OUTPUT, FlagKind.USER):
            (model.add if on else model.discard)(number)
    snapshot = bench.ask(rflags())[14:-2]
    assert {f for f in range(256) if snapshot[f // 8] >> f % 8 & 1} == model
    for _, number in steps:
        assert bench.is_on(number) is (number in model)


def test_a_timer_is_on_until_the_nanosecond_it_runs_out() -> None:
    """By the time alone (MSC-AMB-41); starting it again begins anew."""
    flags = Flags(KINDS)
    flags.start_timer(100, 32, 50)
    assert [flags.state(now, 32) for now in (100, 149, 150)] == [True, True, False]
    assert flags.next_expiry(100) == 150
    flags.start_timer(149, 32, 50)
    assert flags.state(198, 32)
    assert flags.next_expiry(199) is None
    flags.start_timer(200, 33, 50)
    flags.stop_timer(33)
    assert not flags.state(201, 33)


def test_a_timer_may_be_on_when_it_has_expired() -> None:
    """Off while it runs, and before it ever ran."""
    flags = Flags(KINDS, is_on_expired=True)
    assert not flags.state(0, 32)
    flags.start_timer(0, 32, 50)
    assert [flags.state(now, 32) for now in (0, 49, 50)] == [False, False, True]


def test_timers_hold_and_go_on() -> None:
    """The time between does not count; one that had run out stays so."""
    flags = Flags(KINDS)
    flags.start_timer(0, 32, 100)
    flags.start_timer(0, 33, 10)
    flags.hold(40)
    flags.hold(60)
    assert flags.state(10_000, 32)
    assert not flags.state(10_000, 33)
    assert flags.next_expiry(10_000) is None
    flags.resume(1000)
    assert [flags.state(now, 32) for now in (1059, 1060)] == [True, False]
    assert not flags.state(1000, 33)
    flags.resume(1000)


def test_only_timers_can_be_started() -> None:
    """One clear line."""
    with pytest.raises(UsageError, match=r"flag 5 is no timer; timers are 32\.\.39"):
        Flags(KINDS).start_timer(0, 5, 1)


def test_a_forced_flag_is_released() -> None:
    """It reads as forced until then; setting it for good ends that too."""
    flags = Flags(KINDS)
    flags.force(0, 3, on=True)
    flags.force(0, 3, on=True)
    assert flags.state(0, 3)
    flags.release()
    assert not flags.state(0, 3)
    flags.force(0, 4, on=True)
    flags.set(4, on=False)
    assert not flags.state(0, 4)


def test_clearing_turns_everything_off() -> None:
    """As at power-up."""
    flags = Flags(KINDS)
    flags.set(200, on=True)
    flags.start_timer(0, 32, 1000)
    flags.force(0, 3, on=True)
    flags.hold(5)
    flags.clear()
    assert flags.states(10) == 0
    flags.start_timer(10, 32, 5)
    assert not flags.state(15, 32)


# ---- the status word ----


def test_the_bits_have_the_manuals_values() -> None:
    """Ledger §5.4."""
    names = (
        "RUNNING BATTERY_LOW RAM_UNRELIABLE PROGRAM_CLEARED SYSTEM_RETURN SYSTEM_FAULT AUTO_START "
        "SELF_TEST LOAD_OVER_RUNNING LOAD_CHECKSUM LOADING LOAD_SEQUENCE BAD_OPCODE STACK_OVERFLOW "
        "STACK_UNDERFLOW INTERRUPT_TABLE_FULL"
    )
    assert [StatusBit[name] for name in names.split()] == [1 << bit for bit in range(16)]
    assert StatusBit.RUNNING | StatusBit.AUTO_START == 65


@pytest.mark.parametrize("bit", range(16))
def test_every_bit_can_be_reached_and_read(bit: int) -> None:
    """Alone, by the back door, and told by RQSTAT."""
    bench = MscBench()
    bench.perform(bench.device.set_status(bench.now, bit, on=True))
    assert bench.status() == bench.status() == 1 << bit
    assert bench.device.status_at(bench.now) == 1 << bit
    bench.perform(bench.device.set_status(bench.now, bit, on=False))
    assert bench.status() == 0


def test_reading_may_clear_the_errors_alone() -> None:
    """Conditions stay (MSC-AMB-26)."""
    status = Status(clears_on_read=True)
    status.set(~StatusBit(0))
    assert status.read() == 0xFFFF
    assert status.read() == 0xFFFF & ~ERRORS == 0x04FF
    assert status.word == 0x04FF


@pytest.mark.parametrize("bit", [-1, 16])
def test_there_are_sixteen_bits(bit: int) -> None:
    """One clear line."""
    with pytest.raises(UsageError, match=rf"status bit {bit} does not exist: 0\.\.15"):
        status_bit(bit)
