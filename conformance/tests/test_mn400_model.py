"""What the suite expects of an MN400 in each of its states, and where it expects its axes."""

from __future__ import annotations

import re
from fractions import Fraction

import pytest

from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.families.mn400.grammar import COMMANDS, ParsedCommand, read_command
from axistwin_conformance.families.mn400.model.board import BoardModel
from axistwin_conformance.families.mn400.model.motions import exactly
from axistwin_conformance.families.mn400.model.settings import BoardSettings, power_on
from axistwin_conformance.families.mn400.model.states import (
    REPLIES,
    BoardState,
    CellOutcome,
    Ground,
    state_table,
)

LEDGER = load_ledger("mn400")
DONE = ("START", "DONE")
DATA = ("START", "data")
BUSY = ("START", "BUSY")
PENDING = ("START", "MOVEPENDING")
PARA_ERROR = ("START", "PARA_ERROR")
# A sound text of every command, whose parameters no state refuses.
TEXTS = {
    "A": "A-10,0,-20,0,1", "C": "C1,1", ";": ";0", "+": "+-10,0,-20,0,1,5,0", "J": "J0",
    "G": "G1,1,1,1,1", "Y": "Y500", "L": "L1,2,3,4", "M": "M5", "I": "I0", "=": "=1", "~": "~0",
    "P": "P1,3,2", "X": "X1", "V": "V500", "T": "T1,0,0,0,10",
}  # fmt: skip


def now(first: float, last: float | None = None) -> tuple[Fraction, Fraction]:
    """A span of time in seconds."""
    begin = Fraction(first).limit_denominator(1000)
    return begin, begin if last is None else Fraction(last).limit_denominator(1000)


def board(**readings: str) -> BoardModel:
    """A board at power-on, of these readings."""
    for switch, reading in readings.items():
        LEDGER.ambiguity_of(switch).check_reading(switch, reading)

    def reading_of(switch: str) -> str:
        return readings.get(switch) or LEDGER.ambiguity_of(switch).default_of(switch)

    return BoardModel(reading_of)


def after(*texts: str, **readings: str) -> BoardModel:
    """A board to which all that was sent within the first millisecond."""
    made = board(**readings)
    for text in texts:
        made.accept(text, now(0, 0.001))
    return made


def replies(model: BoardModel, text: str, first: float = 0.01) -> set[tuple[str, ...]]:
    """What a text may draw within a millisecond."""
    return {*model.expect(text, now(first, first + 0.001)).replies}


# A board in each state, and a time at which it surely is in it.
IN_STATE: dict[BoardState, tuple[str, ...]] = {
    BoardState.RDY: (),
    BoardState.MOV: ("M5000",),
    BoardState.QUE: ("M5000", "M5"),
    BoardState.PAU: ("M5000", "{"),
    BoardState.HLD: ("H",),
    BoardState.HPD: ("H", "M5"),
    BoardState.CCB: ("(",),
    BoardState.CCX: ("(", "M5000", ")"),
    BoardState.PRG: ("Z",),
    BoardState.CFG: (".",),
    BoardState.JOG: ("J1",),
    BoardState.THR: ("T5,0,0,0,10",),
    BoardState.ABT: ("M5000", "Q"),
}


def test_the_table_has_a_cell_for_every_command_in_every_state() -> None:
    """40 times 14; a reply is known for each outcome but that of &."""
    table = state_table()
    assert len(table) == 40 * 14
    assert {letter for letter, _ in table} == {*COMMANDS}
    assert {*REPLIES} == {*CellOutcome} - {CellOutcome.REPEATED}
    assert table["M", BoardState.RDY].enters is BoardState.MOV
    assert table["}", BoardState.PAU].ground is Ground.MANUAL


@pytest.mark.parametrize("state", IN_STATE)
def test_a_board_in_a_state_answers_as_its_column_says(state: BoardState) -> None:
    """Every command but &, with parameters that are right."""
    model = after(*IN_STATE[state])
    assert model.states(now(0.01, 0.011)) == {state}
    for letter in COMMANDS:
        if letter == "&":
            continue
        cell = state_table()[letter, state]
        text = TEXTS.get(letter, letter)
        expected = model.expect(text, now(0.01, 0.011))
        assert REPLIES[cell.outcome] in expected.replies, (letter, cell)
        assert len(expected.replies) == 1, (letter, expected)
        assert expected.requirement in LEDGER.requirements


def test_while_a_move_may_be_over_both_answers_are_admissible() -> None:
    """J1 is BUSY during a move of 2.5 s and served after it."""
    model = after("V2000", "M4900")
    assert replies(model, "J1", 1) == {BUSY}
    assert replies(model, "J1", 2.499) == {BUSY, DONE}
    assert replies(model, "J1", 3) == {DONE}


def test_every_requirement_that_an_expectation_names_exists() -> None:
    """Those of refusals as well."""
    for text in ("M1a", "L-", "B32768", "L9999999999", "X3", "P1,1", "A1,0,5,5,1", "A0,0,5,0,1"):
        assert board().expect(text, now(0)).requirement in LEDGER.requirements
        assert replies(board(), text) == {PARA_ERROR}


@pytest.mark.parametrize(
    ("readings", "texts", "text", "reply"),
    [
        ({"error_start_policy": "never"}, (), "X3", ("PARA_ERROR",)),
        ({"error_start_policy": "always"}, (), "W", ("START", "INVALIDCOMMAND")),
        ({}, (), "W", ("INVALIDCOMMAND",)),
        ({"movepending_exempt": "K&Q"}, ("H", "M5"), "Q", DONE),
        ({"pending_move_reply": "movepending"}, ("H",), "M5", PENDING),
        ({"release_reply": "movepending"}, ("H", "M5"), "K", PENDING),
        ({"cc_unsupported": "busy"}, ("(",), "?", BUSY),
        ({"cc_unsupported": "ignored"}, ("(",), "?", DONE),
        ({"baud_reply": "plus_done"}, (), "~0", ("START", "BAUDCHANGEOK", "DONE")),
        ({"plane_z_check": "none"}, ("P1,2",), "+-10,0,-20,0,1,5,0", DONE),
        ({}, ("P1,2",), "+-10,0,-20,0,1,5,0", PARA_ERROR),
        ({"threader_overrate": "multi"}, (), "T50,0,0,0,10", DONE),
        ({}, (), "T50,0,0,0,10", PARA_ERROR),
        ({"arc_radius_tol": "0.5"}, (), "A0,-500,-354,-146,-1", PARA_ERROR),
        ({}, (), "A0,-500,-354,-146,-1", DONE),
        ({"prog_check": "run"}, ("Z",), "W", DONE),
        ({"plane_z_check": "at_plane"}, (), "P2,3", PARA_ERROR),
        ({"omitted_param": "zero"}, (), "F2000", PARA_ERROR),
        ({"omitted_param": "zero"}, (), "D1,1,1", PARA_ERROR),
        ({}, (), "F9000", PARA_ERROR),
        ({}, ("F1000,9000,5000",), "F9000", DONE),
        ({}, ("Z",), "W", ("START", "INVALIDPROGCOMM")),
        ({}, ("Z",), "Q", DONE),
    ],
)
def test_the_reading_of_a_board_decides_what_it_answers(
    readings: dict[str, str], texts: tuple[str, ...], text: str, reply: tuple[str, ...]
) -> None:
    """Where the manual is open."""
    assert replies(after(*texts, **readings), text) == {reply}


def test_bad_parameters_come_after_the_state() -> None:
    """MOVEPENDING and BUSY hide them; a contour refuses them where it takes the command."""
    assert replies(after("H", "M5"), "X3") == {PENDING}
    assert replies(after("M5000"), "J7") == {BUSY}
    assert replies(after("("), "X3") == {("INVALIDCOMMAND",)}
    assert replies(after("("), "M1a") == {PARA_ERROR}


def test_relative_moves_add_up_and_absolute_ones_lead_to_their_coordinates() -> None:
    """Also behind one another; what is left out stands."""
    model = after("L5,0,0,0", "M10", "M,,-7", "M-3,2")
    assert model.where(now(9)) == exactly((12, 2, -7, 0))
    model = after("L5,0,0,0", "I1", "M10", "M,,-7", "M-3,2")
    assert model.where(now(9)) == exactly((-3, 2, -7, 0))
    swapped = after("L5,0,0,0", "I1", "M5", abs_mode_value="0")
    assert swapped.where(now(9)) == exactly((10, 0, 0, 0))


def test_a_queued_load_acts_behind_the_moves_before_it() -> None:
    """M500, L0,0,0,0 at once: E ends at 0 (MN4-AMB-52)."""
    assert after("M500", "L0,0,0,0").where(now(9)) == exactly((0, 0, 0, 0))
    assert after("M500", "L0,0,0,0", "M7").where(now(9)) == exactly((7, 0, 0, 0))


def test_a_counter_that_a_load_leaves_out_is_kept_or_zeroed() -> None:
    """By the reading of the board (MN4-AMB-49)."""
    assert board().loaded("L,9", (1, 2, 3, 4)) == (1, 9, 3, 4)
    assert board(omitted_param="zero").loaded("L,9", (1, 2, 3, 4)) == (0, 9, 0, 0)
    assert board().loaded("V5", (1, 2, 3, 4)) == (1, 2, 3, 4)


def test_a_move_is_where_its_plan_says_between_its_windows() -> None:
    """V1000, M2000: about 1000 after a second, exactly there in the end."""
    model = after("V1000", "M2000")
    ((low, high), *_) = model.where(now(1, 1.01))
    assert 990 <= low <= high <= 1012
    assert model.where(now(2.01)) == exactly((2000, 0, 0, 0))
    assert not model.timeline.may_run(now(2.01))


def test_a_v_that_comes_during_a_move_does_not_change_it() -> None:
    """But the next one (MN4-CMD-V-05)."""
    model = after("V1000", "M1000", "V500", "M500")
    assert model.timeline.ends == (Fraction(2), Fraction(2) + Fraction(1, 1000))


def test_q_leaves_the_axes_somewhere_on_their_way_until_they_tell() -> None:
    """And nothing queued runs (MN4-CMD-Q-02)."""
    model = after("V1000", "M5000", "M,500")
    model.accept("Q", now(1, 1.02))
    ((low, high), second, *_) = model.where(now(20))
    assert 980 <= low < high <= 1022
    assert second == (0, 0)
    model.observe((1003, 0, 0, 0))
    model.accept("M-3", now(30))
    assert model.where(now(40)) == exactly((1000, 0, 0, 0))


def test_a_pause_keeps_the_rest_and_a_resume_ends_at_the_target() -> None:
    """What was queued comes after it (MN4-PAU-04); Q drops it (MN4-PAU-05)."""
    model = after("V1000", "M2000")
    model.accept("{", now(1, 1.01))
    ((low, high), *_) = model.where(now(60))
    assert 990 <= low < high <= 1420
    assert model.states(now(60)) == {BoardState.PAU}
    model.accept("M,5", now(61))
    model.accept("}", now(70, 70.01))
    assert model.where(now(80)) == exactly((2000, 5, 0, 0))
    dropped = after("V1000", "M2000")
    dropped.accept("{", now(1, 1.01))
    dropped.accept("Q", now(2))
    dropped.accept("}", now(3))
    assert dropped.where(now(60))[0][1] < 2000


def test_what_runs_at_one_speed_goes_on_as_it_was_behind_a_pause() -> None:
    """It ends as much later as the pause lasts at most, and no earlier than without."""
    made = after("B500,0,0,0", "V500", "M-500")  # 1 s of compensation, 1 s of the move
    made.accept("{", now(0.5))
    made.accept("}", now(0.7))
    ends = made.timeline.ends
    assert ends is not None
    assert now(1.9)[0] < ends[0] <= now(2)[0] < now(2.2)[0] <= ends[1] < now(2.3)[0]
    assert made.where(now(0.9)) == exactly((0, 0, 0, 0))
    assert made.where(now(1.8))[0][1] < 0
    ramped = after("V3000", "M2600")  # 1 s
    ramped.accept("{", now(0.5))
    ramped.accept("}", now(0.7))
    assert ramped.timeline.ends == now(1, 1.7)


def test_a_pause_at_rest_is_not_kept() -> None:
    """The next move runs (MN4-CMD-PAU-04)."""
    model = after("{", "M5")
    assert model.where(now(5)) == exactly((5, 0, 0, 0))


def test_hold_keeps_one_move_and_k_releases_it() -> None:
    """With the settings at its release where nothing can change in between."""
    model = after("V1000", "H", "M1000")
    assert model.where(now(50)) == exactly((0, 0, 0, 0))
    assert replies(model, "E") == {PENDING}
    model.accept("K", now(60))
    assert model.where(now(62)) == exactly((1000, 0, 0, 0))
    assert model.states(now(62)) == {BoardState.HLD}
    once = after("H", "M5", "K", hold_after_release="one_shot")
    assert once.states(now(9)) == {BoardState.RDY}


def test_a_contour_runs_as_one_motion_and_q_forgets_it() -> None:
    """Its last V stays; after Q the one before ( is in force (MN4-CMD-CC-04, MN4-CMD-CC-07)."""
    model = after("(50", "V3000", "M500,,500", "M505,,500", ")")
    assert model.where(now(9)) == exactly((1005, 0, 1000, 0))
    assert model.settings.speed == 3000
    left = after("(", "V3000", "M500", "Q", ")")
    assert left.where(now(9)) == exactly((0, 0, 0, 0))
    assert left.settings.speed == 2000
    assert left.states(now(9)) == {BoardState.RDY}
    absolute = after("L100,0,0,0", "I1", "(", "M200", "M,50", "M150", ")")
    assert absolute.where(now(9)) == exactly((150, 50, 0, 0))


def test_circles_move_the_motors_of_the_plane() -> None:
    """M1 and M3 at power-on, with M2 along (MN4-CMD-A-01); in absolute mode by coordinates."""
    assert after("A-1000,0,-2000,0,1").where(now(9)) == exactly((-2000, 0, 0, 0))
    helix = after("+-100,0,-200,0,1,-50,4")
    assert helix.where(now(20)) == exactly((-200, -50, 0, 0))
    mid = after("A-1000,0,-2000,0,1").where(now(0.707, 0.708))
    assert mid[0][0] <= -1000 <= mid[0][1]
    assert mid[2][0] <= -999 <= mid[2][1]
    coordinates = after("L100,0,50,0", "I1", "A-900,50,-1900,50,1")
    assert coordinates.where(now(9)) == exactly((-1900, 0, 50, 0))


def test_backlash_delays_a_move_and_does_not_count() -> None:
    """B50, M-50 at 500: 0.2 s, and E ends at -50."""
    model = after("V500", "B50", "M-50")
    assert model.timeline.ends is not None
    assert model.timeline.ends[1] == Fraction(1, 5) + Fraction(1, 1000)
    assert model.where(now(0.09)) == exactly((0, 0, 0, 0))
    assert model.where(now(1)) == exactly((-50, 0, 0, 0))
    assert model.settings.backlash.memory == (-1, 1, 1, 1)


def test_what_quit_drops_is_not_remembered() -> None:
    """The direction of the move that ran is, that of the one behind it is not (MN4-BKL-02)."""
    for readings, memory in (({}, (-1, 1, 1, 1)), ({"quit_flushes_queue": "false"}, (1, -1, 1, 1))):
        model = after("V500", "M-500", "M1,-50", **readings)
        model.accept("Q", now(0.1))
        assert model.settings.backlash.memory == memory


def test_without_pulses_nothing_moves() -> None:
    """V-1, M5 waits, and Q ends that."""
    model = after("V-1", "M5")
    assert model.where(now(1000)) == exactly((0, 0, 0, 0))
    assert model.states(now(1000)) == {BoardState.THR}
    model.accept("Q", now(1001))
    assert model.states(now(1002)) == {BoardState.ABT}


def test_lines_of_a_program_are_kept_and_not_executed() -> None:
    """Ctrl-D ends it, Q does not; Q ends the configuration (traps 12, 36, 37)."""
    model = after("Z", "V1000", "m0,1000", "Q")
    assert model.states(now(1)) == {BoardState.PRG}
    model.accept("\x04", now(2))
    assert model.program == ("V1000", "m0,1000", "Q")
    assert model.settings.speed == 2000
    assert after(".", "=5", "Q").states(now(1)) == {BoardState.RDY}


def test_modal_commands_set_what_they_say() -> None:
    """Each of them, from power-on."""
    model = after(
        "V700", "F10,,20", "B1,,3", "D-1,,-1", "P4,2", "X4", "I1", ";1", "Y900", "G1,2,3,4,5",
        "C3,0", "H1",
    )  # fmt: skip
    made = model.settings
    assert (made.speed, made.profile, made.multiplex) == (700, (10, 5000, 20), 4)
    assert (made.backlash.steps, made.backlash.memory) == ((1, 0, 3, 0), (-1, 1, -1, 1))
    assert (made.plane, made.is_absolute, made.holds) == ((3, 1, 1), True, True)
    assert (made.feed_hold, made.jog_speed, made.taps) == (1, 900, (1, 2, 3, 4, 5))
    assert made.outputs == {3}


def test_power_on_is_what_the_ledger_says_and_its_readings() -> None:
    """Defaults, and the other readings of what is open."""
    default = board().reading
    assert power_on(default) == BoardSettings()
    other = {"power_on_mode": "absolute", "feedhold_power_on": "1", "power_on_outputs": "on"}
    made = power_on(lambda switch: other.get(switch) or default(switch))
    assert made.is_absolute
    assert made.feed_hold == 1
    assert len(made.outputs) == 8


def test_the_texts_of_this_file_are_sound() -> None:
    """No state hides a slip of these tests."""
    for letter, text in TEXTS.items():
        assert re.match(re.escape(letter), text)
        assert isinstance(read_command(text, board().reading), ParsedCommand)
