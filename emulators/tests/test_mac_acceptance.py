"""The acceptance table of ledger §4.2, cell by cell over the wire, and both readings in doubt."""

from typing import Any

import pytest
from mac_bench import ACCEPTED, REFUSED, SILENCE, MacBench
from mac_states import SHARED_VALUES, brought

# Typed from the ledger, independently of the device's own table.  A accepted, R refused,
# - no reply, Q answered.  16h and 1Eh in IN: accepted as long as the FIFO has room.
STATES = ("BT", "RI", "OF", "HD", "PO", "VE", "IN", "AR", "PL", "DJ")
FREE, LOCKED, NOBODY, MOTION = "--AAAAAAAA", "--AARRRAAA", "--RRRRRRRR", "--AAAAAAAR"
LEDGER = {
    **dict.fromkeys((0x00, 0x01, 0x07, 0x08, 0x0B, 0x0C, 0x0E, 0x1B, 0x1C), FREE),
    **dict.fromkeys((0x02, 0x03, 0x09, 0x0A, 0x0D, 0x0F), LOCKED),
    **dict.fromkeys((0x04, 0x05, 0x06, 0x12, 0x1D, 0x1F, *range(0x2A, 0x31), 0xFF), NOBODY),
    **dict.fromkeys((0x10, 0x11, 0x15, 0x16, 0x17, 0x18, 0x19, 0x1A, 0x1E), MOTION),
    **dict.fromkeys((0x13, 0x14), "--AARRRAAR"),
    **dict.fromkeys(range(0x20, 0x2A), "--QQQQQQQQ"),
}
VALUES = {**SHARED_VALUES, 0x08: 7, 0x1B: 2}

# What the other readings change: quirk, value, indexes, states, reply.
OTHER_READINGS = [
    ("motion_lock_set", "serial_list", (0x09, 0x0A, 0x0D, 0x0F, 0x14), ("PO", "VE", "IN"), "A"),
    ("motion_lock_set", "serial_list", (0x02, 0x03, 0x13), ("PO", "VE", "IN"), "R"),
    ("lock_08_1b", "true", (0x08, 0x1B), ("PO", "VE", "IN"), "R"),
    ("lock_08_1b", "true", (0x08, 0x1B), ("OF", "AR", "DJ"), "A"),
    ("cmd_1b_supported", "false", (0x1B,), STATES[2:], "R"),
    ("cmd_1c_supported", "false", (0x1C,), STATES[2:], "R"),
    ("vel_during_position", "refuse", (0x15,), ("PO",), "R"),
    ("vel_during_position", "refuse", (0x15,), ("VE", "IN", "PL"), "A"),
    ("vel_during_interp", "refuse", (0x15,), ("IN",), "R"),
    ("vel_during_interp", "refuse", (0x15,), ("PO", "VE"), "A"),
    ("interp_during_profile", "refuse", (0x16, 0x1E), ("PO", "VE"), "R"),
    ("interp_during_profile", "refuse", (0x16, 0x1E), ("IN", "AR"), "A"),
    ("stop17_in_interp", "refuse", (0x17,), ("IN",), "R"),
    ("stop17_in_interp", "refuse", (0x17,), ("PO", "VE", "OF"), "A"),
    ("disj_refuse_set", "starting", (0x10, 0x11, 0x17, 0x18, 0x1A), ("DJ",), "A"),
    ("disj_refuse_set", "starting", (0x13, 0x14, 0x15, 0x16, 0x19, 0x1E), ("DJ",), "R"),
    ("sync_without_preload", "refuse", (0x11,), ("OF", "HD", "PO", "VE", "IN", "AR"), "R"),
    ("sync_without_preload", "refuse", (0x11,), ("PL",), "A"),
    ("preload_locks", "true", (2, 3, 9, 0xA, 0xD, 0xF, 0x13, 0x14), ("PL",), "R"),
    ("preload_locks", "true", (2, 3, 9, 0xA, 0xD, 0xF, 0x13, 0x14), ("AR", "HD"), "A"),
    ("preload_policy", "refuse", (0x13, 0x14, 0x15), ("PL",), "R"),
    ("preload_policy", "keep", (0x13, 0x14, 0x15, 0x17, 0x18, 0x1A), ("PL",), "A"),
    ("unknown_index", "accept", (0x04, 0x12, 0x1F, 0x2A, 0x30), STATES[2:], "A"),
    ("unknown_index", "silence", (0x04, 0x12, 0x1F, 0x2A, 0x30), STATES[2:], "-"),
    ("unknown_index", "zero_answer", (0x2A, 0x2F, 0x31), STATES[2:], "Q"),
    ("unknown_index", "zero_answer", (0x04, 0x12), STATES[2:], "A"),
]


def bench_in(state: str, **quirks: Any) -> MacBench:
    """A module brought into ``state`` over the wire (or by its inputs)."""
    return brought(MacBench(**quirks), state)


def outcome(bench: MacBench, index: int) -> str:
    """Send one frame with a proper value; A, R, Q or - for what came."""
    address = 0xFF if index == 0x08 else 0
    reply = bench.ask(index, VALUES.get(index, 0), address=address)
    names = {ACCEPTED: "A", REFUSED: "R", SILENCE: "-"}
    return names.get(reply) or ("Q" if len(reply) == 21 else reply.hex())


@pytest.mark.parametrize("state", [*STATES, "powered AR", "powered PL"])
def test_every_cell_of_the_ledgers_table(state: str) -> None:
    """Index by index, each on a module of its own; AR and PL are flags over OF and HD (§4.1)."""
    column = STATES.index(state.removeprefix("powered "))
    wanted = {index: row[column] for index, row in LEDGER.items()}
    got = {index: outcome(bench_in(state), index) for index in LEDGER}
    assert got == wanted


@pytest.mark.parametrize(("quirk", "value", "indexes", "states", "reply"), OTHER_READINGS)
def test_the_other_readings_change_their_cells(
    quirk: str, value: str, indexes: tuple[int, ...], states: tuple[str, ...], reply: str
) -> None:
    """And the cells beside them stay."""
    for state in states:
        got = {index: outcome(bench_in(state, **{quirk: value}), index) for index in indexes}
        assert got == dict.fromkeys(indexes, reply), state


@pytest.mark.parametrize("stops", [0, 8, 9])
def test_the_serial_list_marks_03h_for_the_hardware_stops_only(stops: int) -> None:
    """MACS-AMB-08: of the four values the serial list locks d = 1 alone."""
    bench = bench_in("VE", motion_lock_set="serial_list")
    bench.do(0x03, stops)
    bench.refuse(0x03, 1)


@pytest.mark.parametrize("state", ["PO", "VE", "IN"])
def test_a_refused_command_changes_nothing(state: str) -> None:
    """The motion goes on and every parameter reads as before (MACS-REPLY-05, MACS-CMD-13-02)."""
    bench, untouched = bench_in(state), bench_in(state)
    for index in (0x02, 0x03, 0x09, 0x0A, 0x0D, 0x0F, 0x13, 0x14, 0x12):
        bench.refuse(index, VALUES.get(index, 1))
    bench.advance(1_000_000_000)
    untouched.run_until(bench.now)
    for query in (0x20, 0x21, 0x22, 0x23, 0x25, 0x26, 0x27):
        assert bench.read(query) == untouched.read(query), f"{query:02X}h"
    assert not {"standby", "stops", "period", "ramp"} & bench.stores.keys()


def test_the_lock_ends_with_the_motion() -> None:
    """What was refused under way is accepted at rest (MACS-STATE-01)."""
    bench = MacBench()
    bench.do(0x13, 100)
    bench.refuse(0x0D, 0x400)
    bench.settle()
    bench.do(0x0D, 0x400)
    bench.do(0x13, 0)


def test_parameters_stay_writable_after_a_disjunction() -> None:
    """Only motion commands are refused (MACS-STATE-02)."""
    bench = bench_in("DJ")
    bench.do(0x0D, 0x1234)
    assert bench.read(0x25) & 0xFFFF == 0x1234
