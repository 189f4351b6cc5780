"""The acceptance table of the CAN ledger §4, cell by cell over the bus, in both directions."""

from typing import Any

import pytest
from can_bench import CanBench
from mac_bench import ACCEPTED, REFUSED, SILENCE, S
from mac_states import SHARED_VALUES, brought

# Typed from the ledger, independently of the device's own table.  A 60h, R 80h, - no reply,
# Q 42h.  2016h and 201Eh in IN: accepted as long as the FIFO has room.
STATES = ("BT", "RI", "OF", "HD", "PO", "VE", "IN", "AR", "PL", "DJ")
FREE, LOCKED, NOBODY, MOTION = "--AAAAAAAA", "--AARRRAAA", "--RRRRRRRR", "--AAAAAAAR"
DOWNLOADS = {
    **dict.fromkeys((0x00, 0x01, 0x07, 0x0B, 0x0C, 0x0E, 0x1C), FREE),
    **dict.fromkeys((0x02, 0x03, 0x09, 0x0A, 0x0D, 0x0F), LOCKED),
    **dict.fromkeys((0x04, 0x05, 0x06, 0x08, 0x12, 0x1B, 0x1D, 0x1F, 0x20, 0x2F, 0xFF), NOBODY),
    **dict.fromkeys((0x10, 0x11, 0x15, 0x16, 0x17, 0x18, 0x19, 0x1A, 0x1E), MOTION),
    **dict.fromkeys((0x13, 0x14), "--AARRRAAR"),
}
UPLOADS = {
    **dict.fromkeys(range(8), "--QQQQQQQQ"),
    **dict.fromkeys((*range(8, 0x10), 0x10, 0x20, 0xFF), NOBODY),
}
# What the other readings change: quirk, value, download indexes, states, reply.
OTHER_READINGS = [
    ("motion_lock_set", "serial_list", (0x09, 0x0A, 0x0D, 0x0F, 0x14), ("PO", "VE", "IN"), "A"),
    ("motion_lock_set", "serial_list", (0x02, 0x03, 0x13), ("PO", "VE", "IN"), "R"),
    ("vel_during_position", "refuse", (0x15,), ("PO",), "R"),
    ("vel_during_interp", "refuse", (0x15,), ("IN",), "R"),
    ("interp_during_profile", "refuse", (0x16, 0x1E), ("PO", "VE"), "R"),
    ("stop17_in_interp", "refuse", (0x17,), ("IN",), "R"),
    ("disj_refuse_set", "starting", (0x10, 0x11, 0x17, 0x18, 0x1A), ("DJ",), "A"),
    ("sync_without_preload", "refuse", (0x11,), ("OF", "HD", "PO", "VE", "IN", "AR"), "R"),
    ("preload_locks", "true", (2, 3, 9, 0xA, 0xD, 0xF, 0x13, 0x14), ("PL",), "R"),
    ("preload_policy", "refuse", (0x13, 0x14, 0x15), ("PL",), "R"),
    ("unknown_index", "accept", (0x04, 0x08, 0x12, 0x1B, 0x30), STATES[2:], "A"),
    ("unknown_index", "silence", (0x04, 0x08, 0x12, 0x1B, 0x30), STATES[2:], "-"),
    ("fault_ack_while_present", "refuse", (0x00,), ("DJ",), "R"),
    ("fault_ack_while_present", "refuse", (0x00,), ("OF", "PO", "AR"), "A"),
]


def bench_in(state: str, **quirks: Any) -> CanBench:
    """A module brought into ``state`` over the bus (or by its surroundings)."""
    return brought(CanBench(**quirks), state)


def outcome(bench: CanBench, command: int, index: int, parameters: int = 0) -> str:
    """Send one request; A, R, Q or - for what came."""
    reply = bench.ask_raw(bytes((command, index, 0x20, 0)) + parameters.to_bytes(4, "big"))
    if not reply:
        return "-"
    assert reply[1:4] == bytes((index, 0x20, 0))
    if reply[0] == 0x42:
        return "Q"
    assert reply[4:] == bytes(4)
    return {0x60: "A", 0x80: "R"}[reply[0]]


@pytest.mark.parametrize("state", [*STATES, "powered AR", "powered PL"])
def test_every_download_in_every_state(state: str) -> None:
    """Index by index, each on a module of its own."""
    column = STATES.index(state.removeprefix("powered "))
    for index, cells in DOWNLOADS.items():
        got = outcome(bench_in(state), 0x23, index, SHARED_VALUES.get(index, 0))
        assert got == cells[column], f"20{index:02X}h in {state}"


@pytest.mark.parametrize("state", STATES)
def test_every_upload_in_every_state(state: str) -> None:
    """Accepted in all listening states (MACC-SDO-14); the state stays."""
    column = STATES.index(state)
    bench = bench_in(state)
    before = bench.state()
    for index, cells in UPLOADS.items():
        assert outcome(bench, 0x40, index) == cells[column], f"20{index:02X}h in {state}"
    assert bench.state() == before


@pytest.mark.parametrize(("quirk", "value", "indexes", "states", "reply"), OTHER_READINGS)
def test_the_other_readings_of_the_table(
    quirk: str, value: str, indexes: tuple[int, ...], states: tuple[str, ...], reply: str
) -> None:
    """Each changes its own cells."""
    for state in states:
        for index in indexes:
            got = outcome(
                bench_in(state, **{quirk: value}), 0x23, index, SHARED_VALUES.get(index, 0)
            )
            assert got == reply, f"20{index:02X}h in {state}"


@pytest.mark.parametrize("index", [0x16, 0x1E])
def test_the_fifo_takes_three_segments_beyond_the_executing_one(index: int) -> None:
    """The fifth is refused until a stage is free (MACC-CMD-16-01, trap 26)."""
    bench = CanBench()
    replies = [bench.ask(index, 0x03E80400) for _ in range(5)]
    assert replies == [ACCEPTED] * 4 + [REFUSED]
    bench.advance(S)
    assert bench.ask(index, 0x03E80400) == ACCEPTED


SYNC = {**{state: state for state in STATES}, "AR": "OF+AR", "PL": "PO"}


@pytest.mark.parametrize("state", STATES)
def test_sync_in_every_state(state: str) -> None:
    """Starts what is preloaded, and does nothing else; never answered (MACC-SYNC-02, -04)."""
    bench = bench_in(state)
    assert bench.say(0x080) == []
    assert bench.state() == SYNC[state]


@pytest.mark.parametrize("state", ["PO", "VE"])
def test_sync_in_motion_takes_a_preloaded_speed(state: str) -> None:
    """Armed in motion, 2015h is held until then."""
    bench = bench_in(state)
    bench.do(0x10)
    bench.do(0x15, 0x640)
    assert bench.state() == f"{state}+PL"
    assert bench.say(0x080) == []
    assert bench.state() == "VE"


@pytest.mark.parametrize("state", STATES[2:])
def test_the_address_procedure_is_open_in_every_listening_state(state: str) -> None:
    """7E4h answers the address, and the end restarts."""
    bench = bench_in(state)
    assert bench.say(0x7E5, "04 01 00 00 00 00 00 00") == []
    assert bench.say(0x7E5, "11 55 00 00 00 00 00 00") == ["7E4#1100000000000000"]
    assert bench.say(0x7E5, "04 00 00 00 00 00 00 00") == []
    assert bench.state() == "BT"


@pytest.mark.parametrize("state", ["BT", "RI"])
def test_no_address_procedure_while_the_module_is_deaf(state: str) -> None:
    """No service at all before the boot-up."""
    bench = bench_in(state)
    for data in ("04 01", "11 55", "04 00"):
        assert bench.say(0x7E5, data) == []
    assert bench.state() == state
    assert bench.ask(0x20) == SILENCE
