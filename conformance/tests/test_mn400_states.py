"""Commands, hold, queue, panel and states of the MN400: a twin passes, a wrong device is caught."""

from __future__ import annotations

from collections.abc import Callable
from urllib.parse import quote

import pytest
from mn400_board import LEDGER
from mn400_twin import AlteredTwin, judged, session_of

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.codec import ReturnCode
from axistwin_conformance.families.mn400.family import Mn400

pytestmark = pytest.mark.strength

MODULES = ("queue", "settings", "hold", "acceptance", "entry_states", "rig_panel")
CHECKS = {one.name: one for one in Mn400().checks() if one.module.rpartition(".")[2] in MODULES}
PROBES = {one.switch: one for one in Mn400().probes() if one.check.module.endswith("probes.states")}
Plant = Callable[[], AlteredTwin]


def verdicts(check: Check, port: AlteredTwin | None = None, **how: object) -> dict[str, set[str]]:
    """Every verdict of a check, by requirement."""
    found: dict[str, set[str]] = {}
    for one in judged(check, port, **how):
        found.setdefault(one.requirement, set()).add(one.verdict.value)
    return found


@pytest.mark.parametrize("name", CHECKS)
def test_a_twin_passes_every_check(name: str) -> None:
    """And something is judged of each requirement that the check names."""
    found = verdicts(CHECKS[name])
    assert found == {one: {Verdict.PASS.value} for one in CHECKS[name].requirements}


def hears(*texts: tuple[str, str]) -> Plant:
    """A board that takes one text for another."""
    told = dict(texts)
    return lambda: AlteredTwin(lambda text: told.get(text, text))


def says(change: Callable[[codec.BoardPacket], bytes | None]) -> Plant:
    """A board whose packets say something else; None: as they are."""

    def said(raw: bytes) -> bytes:
        packet = codec.parse(raw)
        assert packet is not None
        payload = change(packet)
        return raw if payload is None else codec.request(packet.board, payload)

    return lambda: AlteredTwin(says=said)


def code(letter: str, other: ReturnCode) -> Plant:
    """A board that ends its replies to a command with another code."""

    def change(packet: codec.BoardPacket) -> bytes | None:
        if packet.command != letter or packet.code == ReturnCode.START:
            return None
        return letter.encode() + bytes([other, 0])

    return says(change)


def value(letter: str, alter: Callable[[list[int]], list[int]]) -> Plant:
    """A board that tells other numbers."""

    def change(packet: codec.BoardPacket) -> bytes | None:
        if packet.command != letter or packet.code is not None or packet.fields is None:
            return None
        told = ",".join(map(str, alter([*packet.fields])))
        return (letter + told).encode() + packet.trailer

    return says(change)


def forgetful(text: str, after: str) -> Plant:
    """A board that does not obey a command any more once another one has come."""

    def make() -> AlteredTwin:
        twin = AlteredTwin()
        twin.hears = lambda heard: "|" if heard == text and after in twin.sent else heard
        return twin

    return make


def while_running(text: str, other: str) -> Plant:
    """A board that takes one text for another right behind reads of a program that runs."""

    def make() -> AlteredTwin:
        twin = AlteredTwin()

        def heard(sent: str) -> str:
            is_running = "U" in twin.sent and "T2,0,0,0,1000,0" in twin.sent[-2:]
            return other if sent == text and is_running else sent

        twin.hears = heard
        return twin

    return make


def later(letter: str, after: str, told: str) -> Plant:
    """A board whose value changes to this once a command has been sent."""

    def make() -> AlteredTwin:
        twin = AlteredTwin()

        def said(raw: bytes) -> bytes:
            packet = codec.parse(raw)
            assert packet is not None
            is_late = any(text.startswith(after) for text in twin.sent)
            if packet.command != letter or packet.code is not None or not is_late:
                return raw
            return codec.request(packet.board, letter.encode() + told.encode() + packet.trailer)

        twin.says = said
        return twin

    return make


def forgotten_by_the_next_move() -> AlteredTwin:
    """A board whose exit code is 0 as soon as the next move has begun."""
    twin = AlteredTwin()

    def said(raw: bytes) -> bytes:
        moves = sum(text.startswith("M") for text in twin.sent)
        packet = codec.parse(raw)
        assert packet is not None
        is_told = packet.command == "/" and packet.code is None and moves > 1
        return codec.request(packet.board, b"/0\x06") if is_told else raw

    twin.says = said
    return twin


BUSY, DONE = ReturnCode.BUSY, ReturnCode.DONE
# Fault: the check that catches it, what it plants, the requirement it fails by.
FAULTS: dict[str, tuple[str, Plant, str]] = {
    "an L in motion loads something else": (
        "counters_are_loaded_in_their_turn", hears(("L,7", "L,6")), "MN4-STM-01"),
    "no N in motion": ("in_motion_reads_are_answered_at_once", code("N", BUSY), "MN4-STM-02"),
    "no ; in motion": (
        "in_motion_what_is_no_setting_of_motion_works_at_once", code(";", BUSY), "MN4-STM-02"),
    "a full queue is busy": (
        "a_full_queue_is_told", says(lambda packet: b"M\x14\0" if packet.code == 0x15 else None),
        "MN4-STM-03"),
    "a queued move goes nowhere": (
        "a_full_queue_is_told", hears(("M,,1", "M")), "MN4-STM-01"),
    "& reads anew": (
        "a_repetition_repeats_and_carries_nothing_out",
        value("&", lambda row: [row[0] + 9, *row[1:]]), "MN4-CMD-RTX-03"),
    "no abort flag": (
        "the_abort_flag_is_of_the_last_motion", value(":", lambda row: [*row[:4], 0]),
        "MN4-CMD-SW-01"),
    "32 bits wrap": (
        "what_moves_is_refused_beyond_its_edges", hears(("M4294967297,0,0,0", "M1")), "MN4-PAR-05"),
    "port 9": ("what_moves_is_refused_beyond_its_edges", hears(("C9,0", "C8,1")), "MN4-CMD-C-03"),
    "direction 0": (
        "what_moves_is_refused_beyond_its_edges",
        hears(("A-2,0,-4,0,0", "A-2,0,-4,0,1")), "MN4-CMD-A-03"),
    "turns below 0": (
        "what_moves_is_refused_beyond_its_edges",
        hears(("+-2,0,-4,0,1,0,-1", "+-2,0,-4,0,1,0,1")), "MN4-HEL-05"),
    "hold 2": (
        "hold_and_contours_are_served_and_refused_at_their_edges", hears(("H2", "H1")),
        "MN4-ERR-02"),
    "margin -1": (
        "hold_and_contours_are_served_and_refused_at_their_edges", hears(("(-1", "(1")),
        "MN4-ERR-02"),
    "a space is skipped": (
        "a_space_is_no_part_of_a_command", hears((" E", "E")), "MN4-PKT-12"),
    "L clears what is left": (
        "loading_leaves_what_is_left_of_a_move", later("N", "L5,6", "0,0,0,0"), "MN4-CMD-L-03"),
    "H1 does nothing": (
        "a_held_move_waits_for_its_release", hears(("H1", "H0")), "MN4-CMD-H-01"),
    "H0 does nothing": (
        "a_held_move_waits_for_its_release", forgetful("H0", "K"), "MN4-CMD-H-02"),
    "K runs nothing": (
        "a_held_move_waits_for_its_release", hears(("K", "?")), "MN4-CMD-K-01"),
    "an arc is not held": (
        "all_that_moves_is_held", hears(("A-10,0,-20,0,1", "|")), "MN4-CMD-H-01"),
    "a held contour loses a segment": (
        "all_that_moves_is_held", hears(("(", "(0"), ("M40", "M39")), "MN4-CMD-K-01"),
    "reads while a move is pending": (
        "with_a_move_pending_nothing_else_is_served",
        says(lambda packet: b"E0,0,0,0\x06" if packet.payload == b"E\x11\0" else None),
        "MN4-RSP-09"),
    "a second move is kept": (
        "with_a_move_pending_nothing_else_is_served",
        says(lambda packet: b"M\x05\0" if packet.payload == b"M\x11\0" else None), "MN4-STM-08"),
    "a release that runs elsewhere": (
        "with_a_move_pending_nothing_else_is_served",
        hears(("M40,,-40", "M40,,-41")), "MN4-RSP-09"),
    "K to all does nothing": (
        "a_release_of_all_boards_is_one_of_this", hears(("K", "E")), "MN4-CMD-K-03"),
    "a move after K is refused": (
        "hold_stays_on_after_a_release", hears(("M,-40", "M,-")), "MN4-CMD-K-02"),
    "ready: no S": ("at_rest_every_command_is_served", code("S", BUSY), "MN4-STM-02"),
    "ready: L loads more": (
        "at_rest_every_command_is_served", hears(("L1,2,3,4", "L1,2,3,5")), "MN4-STM-02"),
    "moving: no M": (
        "in_motion_commands_wait_or_are_served_at_once", code("M", BUSY), "MN4-RSP-06"),
    "moving: W is a command": (
        "in_motion_commands_wait_or_are_served_at_once", hears(("W", "|")), "MN4-STM-02"),
    "moving: { does nothing": (
        "in_motion_commands_wait_or_are_served_at_once", hears(("{", "|")), "MN4-STM-02"),
    "queue: no A": (
        "behind_a_queue_commands_wait_or_are_served_at_once", code("A", BUSY), "MN4-RSP-06"),
    "pause: X resumes": (
        "in_a_pause_commands_wait_or_are_served_at_once", hears(("|", "}")), "MN4-CMD-PAU-01"),
    "pause: no M": (
        "in_a_pause_commands_wait_or_are_served_at_once", code("M", BUSY), "MN4-RSP-06"),
    "hold: M runs": (
        "on_hold_moves_are_kept_and_the_rest_is_served", hears(("H1", "H0")), "MN4-CMD-H-01"),
    "hold: no ?": (
        "on_hold_moves_are_kept_and_the_rest_is_served", code("?", BUSY), "MN4-CMD-H-03"),
    "pending: [ is read": (
        "a_pending_move_keeps_everything_out",
        says(lambda packet: b"[1\x06" if packet.payload == b"[\x11\0" else None), "MN4-RSP-09"),
    "contour: V is refused": (
        "a_contour_takes_moves_and_speeds_alone", hears(("(", "Z")), "MN4-CMD-CC-02"),
    "contour: E is lost": (
        "in_a_contour_commands_wait_or_are_served_at_once", code("S", BUSY), "MN4-CMD-CC-06"),
    "contour: T is refused": (
        "in_a_contour_commands_wait_or_are_served_at_once", code("T", BUSY), "MN4-RSP-06"),
    "jog: no mode": (
        "in_jog_mode_moves_are_refused_and_the_rest_is_served",
        value("E", lambda row: [one + 1 for one in row]), "MN4-CMD-J-01"),
    "thread: no +": (
        "without_pulses_commands_wait_or_are_served_at_once", code("+", BUSY), "MN4-RSP-06"),
    "thread: moves by itself": (
        "without_pulses_commands_wait_or_are_served_at_once",
        hears(("T200,0,0,0,400,0", "M200")), "MN4-CMD-T-03"),
    "abort: N is refused": (
        "after_an_abort_every_command_is_served", code("N", BUSY), "MN4-CMD-Q-01"),
    "a line is stored as another": (
        "in_a_program_every_command_is_a_line", hears(("S", "N")), "MN4-STM-04"),
    "Ctrl-D draws an error": (
        "in_a_program_every_command_is_a_line", code("\x04", BUSY), "MN4-NVM-01"),
    "a configuration is carried out": (
        "in_a_configuration_every_command_is_a_line", hears((".", "|")), "MN4-NVM-04"),
    "running: no S": ("while_a_program_runs_reads_are_served", code("S", BUSY), "MN4-STM-02"),
    "running: Q does nothing": (
        "while_a_program_runs_reads_are_served", while_running("Q", "|"), "MN4-STM-02"),
    "U is refused": ("while_a_program_runs_reads_are_served", code("U", BUSY), "MN4-CMD-U-01"),
    "limits and aux exchanged": (
        "every_input_has_its_value", value("S", lambda row: [row[0] >> 8 | (row[0] & 255) << 8]),
        "MN4-CMD-S-01"),
    "S in 15 bits": (
        "every_input_has_its_value", value("S", lambda row: [row[0] if row[0] < 65535 else 32767]),
        "MN4-CMD-S-02"),
    "exit code is cleared by the next move": (
        "the_exit_code_is_that_of_the_last_move", forgotten_by_the_next_move, "MN4-CMD-EXIT-02"),
    "exit code stays": (
        "the_exit_code_is_that_of_the_last_move", value("/", lambda row: [row[0] or 4]),
        "MN4-CMD-EXIT-04"),
    "| clears nothing": (
        "the_exit_code_is_that_of_the_last_move", hears(("|", "X1")), "MN4-CMD-EXIT-03"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_device_is_caught(fault: str) -> None:
    """By the check that is there for it, under the requirement it breaks."""
    name, plant, requirement = FAULTS[fault]
    assert Verdict.FAIL.value in verdicts(CHECKS[name], plant())[requirement]


# Where the manual is silent: what is told of a device that does otherwise.
OPEN: dict[str, tuple[Plant, str]] = {
    "a_position_is_of_one_instant": (
        value("E", lambda row: [row[0], row[1] - (row[0] % 9 == 4), *row[2:]]), "MN4-RSP-15"),
    "the_panel_pauses_and_stops": (
        value(":", lambda row: [*row[:2], 0, 0, row[4]]), "MN4-IO-02"),
}  # fmt: skip


@pytest.mark.parametrize("name", OPEN)
def test_where_the_manual_is_silent_another_behaviour_is_told(name: str) -> None:
    """And fails nobody."""
    plant, requirement = OPEN[name]
    assert Verdict.INFO.value in verdicts(CHECKS[name], plant())[requirement]


@pytest.mark.parametrize("switch", ["feedrate_pot", "queue_modal"])
def test_a_reading_other_than_the_one_it_was_found_to_follow_is_caught(switch: str) -> None:
    """A device that shows two readings of a switch follows none."""
    usual, other = LEDGER.ambiguity_of(switch).switches[switch]
    for name, switches in LOOKED_UP.items():
        if switch in switches:
            found = verdicts(CHECKS[name], of_reading(switch, other), readings={switch: usual})
            assert any(Verdict.FAIL.value in one for one in found.values()), name


def test_every_check_has_a_wrong_device_that_it_catches() -> None:
    """Above, or it tells of one where the manual is silent."""
    caught = {name for name, _, _ in FAULTS.values()} | {*OPEN}
    caught |= {name for name, switches in LOOKED_UP.items() if "feedrate_pot" in switches}
    assert caught == {*CHECKS}


# --- readings -------------------------------------------------------------------------------------

HOLDING = (
    "hold_bare_arg", "hold_after_release", "movepending_exempt", "pending_move_reply",
    "hold_scope", "release_reply",
)  # fmt: skip
LOOKED_UP: dict[str, tuple[str, ...]] = {
    **{name: HOLDING for name, one in CHECKS.items() if one.module.endswith("hold")},
    "on_hold_moves_are_kept_and_the_rest_is_served": HOLDING,
    "a_pending_move_keeps_everything_out": HOLDING,
    "counters_are_loaded_in_their_turn": ("queue_modal",),
    "a_full_queue_is_told": ("queue_depth",),
    "the_abort_flag_is_of_the_last_motion": ("abort_flag_clear",),
    "in_motion_commands_wait_or_are_served_at_once": ("quit_in_entry", "abs_mode_value"),
    "the_exit_code_is_that_of_the_last_move": ("abort_exit_code",),
    "every_input_has_its_value": ("limit_status_signed",),
    "the_feedrate_pot_scales_the_speed": ("feedrate_pot",),
}
NUMBERS = {
    "queue_depth": "7",
    "abort_exit_code": "64",
    "cc_capacity": "100",
}  # for a reading that is any number
READINGS = [
    (switch, NUMBERS[switch] if reading == "*" else reading)
    for switch in PROBES
    for reading in LEDGER.ambiguity_of(switch).switches[switch]
]


def of_reading(switch: str, reading: str) -> AlteredTwin:
    """A twin of that reading."""
    return AlteredTwin(quirks={switch: quote(reading)})


@pytest.mark.parametrize(("switch", "reading"), READINGS)
def test_a_probe_finds_the_reading_of_a_twin(switch: str, reading: str) -> None:
    """And no other with it."""
    probe = PROBES[switch]
    assert probe.look(session_of(of_reading(switch, reading), probe.check)).readings == (reading,)


@pytest.mark.parametrize(("switch", "reading"), READINGS)
def test_another_reading_fails_no_check_that_knows_it(switch: str, reading: str) -> None:
    """Of the checks that ask for that reading, or look at what it decides."""
    for name, check in CHECKS.items():
        if switch in LOOKED_UP.get(name, ()):
            found = verdicts(check, of_reading(switch, reading), readings={switch: reading})
            failed = [one for one, seen in found.items() if Verdict.FAIL.value in seen]
            assert failed == [], name
