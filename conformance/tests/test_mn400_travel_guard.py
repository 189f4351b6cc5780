"""What holds the axes of an MN400 inside the envelope: packet by packet, and in whole checks."""

from __future__ import annotations

import contextlib

import pytest
from mn400_twin import URL, ShaftWatch, session_of

from axistwin_conformance.base.errors import CannotDo, OutsideEnvelope
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.readings import Readings
from axistwin_conformance.core.session import Envelope, Session, Stop
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.family import Mn400
from axistwin_conformance.families.mn400.motion.travel_guard import BoardTravelGuard
from axistwin_conformance.options import make_options
from axistwin_conformance.transport.serial import SerialTransport

SECOND = 1_000_000_000
KNOWN = {
    "abs_mode_value": "1", "plane_base": "1", "queue_modal": "true",
    "cc_unsupported": "invalidcommand", "pending_move_reply": "done", "release_reply": "done",
    "quit_flushes_queue": "true", "quit_decel": "false", "quit_in_entry": "both",
    "backlash_counts": "false",
}  # fmt: skip
FAMILY = Mn400()
CHECKS = {one.name: one for one in FAMILY.checks()}
MOVING = [name for name, one in CHECKS.items() if one.safety == ("motion",)]
WORKED = [name for name, one in CHECKS.items() if set(one.safety) == {"motion", "rig"}]


class Line:
    """A line as the guard hears it; each request is answered at once."""

    def __init__(self, **readings: str) -> None:
        self.now_ns = 0
        self.travel_guard = BoardTravelGuard(1000, 5000, Readings(readings))

    def say(self, text: str, reply: str = "DONE", board: int = 1) -> None:
        """Send a command; its reply is the name of a code, or nothing."""
        self.travel_guard.sending(codec.request(board, text), self.now_ns)
        self.now_ns += SECOND // 100
        if reply:
            start = codec.status(board, text[:1], codec.ReturnCode.START)
            last = codec.status(board, text[:1], codec.ReturnCode[reply])
            self.travel_guard.received(start + last, self.now_ns)

    def at(self, *counters: int, board: int = 1) -> None:
        """Read the counters; what is not named is 0."""
        told = ",".join(map(str, (*counters, *[0] * (4 - len(counters)))))
        self.travel_guard.sending(codec.request(board, "E"), self.now_ns)
        self.now_ns += SECOND // 100
        start = codec.status(board, "E", codec.ReturnCode.START)
        self.travel_guard.received(start + codec.data(board, "E", told), self.now_ns)

    def left(self, *steps: int, board: int = 1) -> None:
        """Read the steps that are left."""
        self.travel_guard.sending(codec.request(board, "N"), self.now_ns)
        start = codec.status(board, "N", codec.ReturnCode.START)
        told = codec.data(board, "N", ",".join(map(str, steps)))
        self.travel_guard.received(start + told, self.now_ns)

    def work(self, name: str, still_on: tuple[str, ...] = (), number: int | None = None) -> None:
        """The rig works an input; `still_on`: those that are on behind it."""
        self.travel_guard.worked(name, (self.now_ns, self.now_ns), still_on, number)

    def has_deadline(self) -> bool:
        """True while something may be moving without an end."""
        return self.travel_guard.deadline_ns is not None

    def refuses(self, text: str, board: int = 1) -> bool:
        """True if the command is held back; else it is refused by the board."""
        try:
            self.say(text, "BUSY", board)
        except OutsideEnvelope:
            return True
        return False


@pytest.fixture
def line() -> Line:
    """A board found at 500 on axis 1, in relative mode, with its speed set."""
    line = Line(**KNOWN)
    line.at(500)
    for text in ("I0", "V2000", "F1000,5000,10000", "P1,3,2", "D1,1,1,1"):
        line.say(text)
    return line


def test_places_are_counted_from_where_the_axes_were_found(line: Line) -> None:
    """1000 either way of each axis, to the step."""
    assert not line.refuses("M1000,-1000")
    assert line.refuses("M1001")
    assert line.refuses("M,,-1001")
    line.say("I1")
    assert not line.refuses("M1500,1000")
    assert line.refuses("M1501")
    assert line.refuses("M-501")


def test_while_the_mode_is_unknown_both_count() -> None:
    """From a counter of 700 a move of 400 may be one of -300."""
    line = Line()
    line.at(700)
    for text in ("V2000", "F1000,5000,10000"):
        line.say(text)
    assert not line.refuses("M400")
    assert line.refuses("M-301"), "as a place it is 1001 away"
    assert line.refuses("M1001"), "as a way it is too far"


def test_loading_the_counters_does_not_move_the_envelope(line: Line) -> None:
    """400 away, it leaves 600."""
    line.say("M400")
    line.at(900)
    line.say("L0,0,0,0")
    assert not line.refuses("M600")
    assert line.refuses("M601")
    line.say("I1")
    assert line.refuses("M-1401")
    assert not line.refuses("M-1400")


def test_moves_add_up_until_the_axes_are_known_to_rest(line: Line) -> None:
    """Three of 400 are too many; Q and a reading begin anew."""
    line.say("M400")
    line.say("M400")
    assert line.refuses("M400")
    line.say("Q")
    line.at(600)
    assert not line.refuses("M400")
    assert not line.refuses("M900")
    assert line.refuses("M901")


def test_what_was_refused_leads_nowhere_and_what_was_not_answered_may(line: Line) -> None:
    """Five that are BUSY are none; two without a reply are two."""
    for _ in range(5):
        line.say("M400", "BUSY")
    line.say("M400", "")
    line.say("M400", "")
    assert line.refuses("M400")


def test_an_arc_is_judged_by_its_whole_circle(line: Line) -> None:
    """A board that goes the wrong way round stays inside, too; in any plane that may be set."""
    assert not line.refuses("A-490,0,-490,490,1")
    assert line.refuses("A-600,0,-600,600,1")
    assert line.refuses("+-100,0,-200,0,1,1001,2"), "the traverse"
    line.say("M,900")
    line.at(500, 900)
    assert not line.refuses("A-300,0,-600,0,1"), "axis 2 is not of the plane"
    line.say("P1,2,3")
    assert line.refuses("A-300,0,-600,0,1")


def test_segments_of_a_contour_and_held_moves_count_when_they_are_stored(line: Line) -> None:
    """What is closed or released later is not judged again."""
    line.say("(")
    line.say("M600")
    assert line.refuses("M600")
    line.say("Q")
    line.at(500)
    line.say("H")
    line.say("M900")
    assert line.refuses("M900")
    assert not line.refuses("K")


@pytest.mark.parametrize("reply", ["DONE", "SLAVEBUFFOV"])
def test_behind_a_contour_all_counts_as_before_it(line: Line, reply: str) -> None:
    """Whether it runs, waits or was refused: arcs, the plane, the mode and loaded counters."""
    for text in ("(", "M50,20", "M-30,,40"):
        line.say(text)
    line.say(")", reply)
    assert line.refuses("A-600,0,-600,600,1"), "an arc that leads out of the envelope"
    line.say("P1,2,4")
    line.say("A0,-40,-40,-40,-1")
    for _ in range(2):
        line.at(500, -20)
    assert not line.travel_guard.runaway, "the arc is of axis 2"
    for text in ("L0,0,0,0", "I1"):
        line.say(text)
    assert line.refuses("M0,1100")
    line.say("I0")
    assert not line.refuses("M0,-800")


def test_a_program_is_judged_by_its_lines(line: Line) -> None:
    """Nobody runs one that was not seen being stored."""
    assert line.refuses("U")
    line.say("Z")
    for text in ("M600", "M600", "\x04"):
        line.say(text)
    assert line.refuses("U")
    line.say("Z")
    for text in ("M600", "M-600", "\x04"):
        line.say(text)
    assert not line.refuses("U")


def test_what_moves_needs_a_known_speed_within_its_bound() -> None:
    """V and the end speed of F, the lower of both."""
    line = Line(**KNOWN)
    line.at(0)
    line.say("I0")
    assert line.refuses("M10"), "nobody knows how fast"
    line.say("V9000")
    line.say("F1000,9000,10000")
    assert line.refuses("M10")
    assert not line.refuses("T10,0,0,0,20"), "pulses pace it"
    line.say("F1000,5000,10000")
    assert not line.refuses("M10")
    assert line.refuses("J1"), "no jog speed was set"


def test_a_board_that_nobody_has_looked_at_is_not_moved(line: Line) -> None:
    """One beside it; to all boards, where one of them would go too far."""
    assert line.refuses("M10", board=7)
    line.at(0, board=7)
    for text in ("I0", "V2000", "F1000,5000,10000", "M900"):
        line.say(text, board=7)
    assert line.refuses("M200", board=codec.ALL_BOARDS)
    assert not line.refuses("M50", board=codec.ALL_BOARDS)


def test_backlash_counts_where_it_may_be_made_up_for(line: Line) -> None:
    """Against the remembered direction it is on top of the way."""
    line.say("B100,0,0,0")
    assert not line.refuses("M1000")
    assert line.refuses("M-950")
    assert not line.refuses("M-900")


def test_jogging_may_turn_the_axis_that_is_jogged(line: Line) -> None:
    """Its backlash may have been taken up either way; that of another axis was not."""
    for text in ("B0,100,100,0", "Y2", "J1"):
        line.say(text)
    line.work("jog_minus", number=2)
    for text in ("J0", "Q"):
        line.say(text)
    line.at(500)
    assert line.refuses("M,850"), "the way, and 200 to take up"
    assert not line.refuses("M,790")
    assert not line.refuses("M,,1000")
    line.say("D1,1,1,1")
    line.work("run_jog")
    line.say("Q")
    line.at(500)
    assert line.refuses("M,,950"), "any axis may have been jogged"


def test_hidden_and_cut_packets_are_seen(line: Line) -> None:
    """In junk, behind an address too many, in pieces; one with a wrong sum asks for nothing."""
    raw = codec.request(1, "M5000")
    for data in (b"\r\n" + raw, b"\x82E" + raw, b"\x81" + raw):
        with pytest.raises(OutsideEnvelope, match="5000"):
            line.travel_guard.sending(data, line.now_ns)
    line.travel_guard.sending(raw[:4], line.now_ns)
    with pytest.raises(OutsideEnvelope) as caught:
        line.travel_guard.sending(raw[4:], line.now_ns)
    assert (caught.value.option, caught.value.needed) == ("--max-travel", 5000)
    line.travel_guard.sending(codec.with_wrong_checksum(raw), line.now_ns)


def test_an_axis_seen_where_nothing_leads_is_not_moved_again(line: Line) -> None:
    """Two looks in a row; Q is sent all the same."""
    line.say("M100")
    line.at(900)
    assert line.travel_guard.is_in_doubt, "it may have been noise"
    assert line.refuses("M10")
    line.at(600)
    assert not line.refuses("M10")
    line.at(900)
    line.at(910)
    assert "axis 1" in line.travel_guard.runaway
    assert line.travel_guard.broken == "MN4-CMD-M-01"
    line.at(600)
    for text in ("M1", "A-1,0,-2,0,1", "+-1,0,-2,0,1", "T1,0,0,0,9", "U", "K", "}"):
        assert line.refuses(text)
    assert not line.refuses("Q")


def test_an_old_value_that_is_repeated_is_no_reading(line: Line) -> None:
    """& tells what E did before the move."""
    line.say("M400")
    line.at(900)
    line.travel_guard.sending(codec.request(1, "&"), line.now_ns)
    line.travel_guard.received(codec.data(1, "&", "500,0,0,0"), line.now_ns)
    assert not line.travel_guard.is_in_doubt
    assert line.travel_guard.way_to_start(1) == (400, 0, 0, 0)


def test_counters_may_go_round(line: Line) -> None:
    """From the greatest to the least is one step."""
    line.say("L2147483640,0,0,0")
    line.say("M20")
    line.at(2147483640 + 20 - 2**32)
    assert not line.travel_guard.is_in_doubt
    assert line.travel_guard.way_to_start(1) == (20, 0, 0, 0)


def test_jogging_has_to_be_stopped_before_the_edge(line: Line) -> None:
    """At 500 steps/s over 1000 it is ended by Q and J0 in less than two seconds."""
    line.say("Y500")
    line.say("J1")
    assert not line.has_deadline()
    line.travel_guard.worked("jog_plus", (line.now_ns, line.now_ns))
    deadline_ns = line.travel_guard.deadline_ns
    assert deadline_ns is not None
    assert 1.5 * SECOND < deadline_ns - line.now_ns < 2 * SECOND
    assert line.travel_guard.needed(SECOND) > 1400
    texts = [codec.packets(raw)[0][0].text for raw in line.travel_guard.stop()]
    assert texts == ["Q", "J0"]
    line.say("J0")
    assert not line.has_deadline()


def test_counters_loaded_in_motion_are_settled_by_n(line: Line) -> None:
    """They may be loaded then or at the end; where the axes are at the end is known."""
    line.travel_guard.readings.pop("queue_modal")
    line.say("M400")
    line.say("L0,0,0,0")
    line.at(0)
    assert line.travel_guard.way_to_start(1) is None
    line.left(0, 0, 0, 0)
    line.at(0)
    assert line.travel_guard.way_to_start(1) == (400, 0, 0, 0)


def test_a_cut_supply_gives_no_travel_back(line: Line) -> None:
    """Counters of 0 again: 400 are used up all the same, and the speed is unknown."""
    line.say("M400")
    line.at(900)
    line.travel_guard.worked("power", (line.now_ns, line.now_ns))
    line.at(0)
    assert line.refuses("M10")
    for text in ("I0", "V2000", "F1000,5000,10000"):
        line.say(text)
    assert not line.refuses("M600")
    assert line.refuses("M601")


def test_a_limit_leaves_the_axes_anywhere_on_their_way(line: Line) -> None:
    """What is relative starts there; Q and a reading tell the place again."""
    line.say("M-400")
    line.work("limit_minus")
    line.at(500 - 64)
    line.say("M100")
    for _ in range(2):
        line.at(500 - 64 + 100)
    assert not line.travel_guard.is_in_doubt
    line.say("Q")
    line.at(500 + 36)
    assert line.travel_guard.way_to_start(1) == (36, 0, 0, 0)
    assert line.refuses("M965")
    line.say("M-400")
    line.work("stop")
    line.say("M100")
    line.at(500 + 36 + 100 + 11)
    assert line.travel_guard.is_in_doubt, "farther than from the start of what was cut short"


def test_while_a_limit_is_on_every_motion_may_be_cut_short(line: Line) -> None:
    """It is on until none is, whichever was turned off; from then on moves are made whole."""
    line.work("limit_plus", still_on=("limit_plus", "limit_minus"))
    line.work("limit_minus", still_on=("limit_plus",))
    line.say("M400")
    line.say("M-100")
    for _ in range(2):
        line.at(400)
    assert not line.travel_guard.runaway
    line.say("Q")
    line.at(400)
    line.work("limit_plus")
    line.say("M600")
    line.say("M-100")
    line.at(380)
    assert line.travel_guard.is_in_doubt, "nothing leads below the start of a move made whole"


# --- whole checks on a twin -----------------------------------------------------------------------


def run_within(port: ShaftWatch, name: str, travel: int) -> tuple[Session, tuple[str, ...]]:
    """Run a check under that bound and put back what it has done; what could not be."""
    session = session_of(
        port, CHECKS[name], envelope=Envelope(travel, 5000), readings=Readings(KNOWN)
    )
    with contextlib.suppress(Stop, OutsideEnvelope, CannotDo):
        CHECKS[name](session)
    memory, session.check = session.run.memory, None
    memory.touched |= {"M", "L"}
    FAMILY.stop(session)
    return session, FAMILY.restore(session, memory)


# counters_go_round leads a counter round, which no shaft could follow.
NAMES = [name for name in MOVING if name != "counters_go_round"]


@pytest.mark.strength
@pytest.mark.parametrize(
    ("name", "travel"), [*((name, 3000) for name in NAMES), *((name, 700) for name in NAMES[::6])]
)
def test_a_check_stays_inside_and_goes_home(name: str, travel: int) -> None:
    """Whatever it is about; the shaft is where it was, the counters say so."""
    port = ShaftWatch()
    _, left = run_within(port, name, travel)
    assert min(port.lowest) >= -travel
    assert max(port.highest) <= travel
    assert (port.place, left) == ([0, 0, 0, 0], ())
    assert port.twins[0].controls["counters"].value == [0, 0, 0, 0]


@pytest.mark.parametrize("name", WORKED)
def test_a_sound_board_worked_by_a_rig_is_no_runaway(name: str) -> None:
    """Its axes are home again behind each check, and nothing was held back."""
    port = ShaftWatch()
    session, left = run_within(port, name, 3000)
    assert (session.run.runaway, left, port.place) == ("", (), [0, 0, 0, 0])


def test_a_board_that_goes_twice_as_far_is_moved_once() -> None:
    """After the runaway nothing that moves is sent, and the way home is told to be open."""
    port = ShaftWatch(
        lambda text: (
            f"M{2 * int(text[1:])}" if text[:1] == "M" and text[1:].lstrip("-").isdigit() else text
        )
    )
    session, left = run_within(port, "moves_take_the_time_of_their_profile", 3000)
    runaway = session.run.runaway
    assert "axis 1" in runaway
    assert max(port.highest) <= 4000
    assert any("away" in sentence or "from where" in sentence for sentence in left)
    with pytest.raises(OutsideEnvelope):
        session.target.send(codec.request(1, "M1"))


@pytest.mark.strength(seconds=40)
def test_a_run_with_stored_programs_leaves_the_axes_where_they_were() -> None:
    """What a program moves that the suite has stored is known to be over, and brought home."""
    port = ShaftWatch()
    options = make_options(
        model="mn400", port=URL, allow="motion,stored", max_travel=3000, seed=7,
        ids=("MN4-CMD-U", "MN4-NVM", "MN4-CMD-Q-05", "MN4-CMD-PAU-03"),
    )  # fmt: skip
    result = Engine(options, lambda neighbours: SerialTransport(port, URL)).run(lambda event: None)
    assert (result.exit_status, result.problems) == (0, [])
    assert port.highest[0] > 0
    assert port.place == [0, 0, 0, 0]


@pytest.mark.strength(seconds=40)
def test_a_run_within_an_envelope_conforms_and_leaves_the_axes_where_they_were() -> None:
    """With what asks for readings, what moves and what works the rig, by the engine."""
    port = ShaftWatch()
    options = make_options(
        model="mn400", port=URL, allow="motion,rig", max_travel=3400, seed=7,
        ids=("MN4-MOT", "MN4-ARC", "MN4-HEL", "MN4-CC", "MN4-BKL", "MN4-MEA", "MN4-PAU", "MN4-QUIT",
             "MN4-LIM", "MN4-SHD", "MN4-JOG", "MN4-THR", "MN4-SYN"),
    )  # fmt: skip
    result = Engine(options, lambda neighbours: SerialTransport(port, URL)).run(lambda event: None)
    assert not result.problems
    assert not [one.requirement.id for one in result.requirements if one.verdict is Verdict.FAIL]
    judged = {one.requirement.id for one in result.requirements if one.verdict is Verdict.PASS}
    assert len(judged) > 70
    assert min(port.lowest) >= -3400
    assert max(port.highest) <= 3400
    assert port.place == [0, 0, 0, 0]


# --- readings that nobody has asked for yet -------------------------------------------------------


def open_line(*switches: str) -> Line:
    """The board of `line`, of which these readings are not known."""
    line = Line(**{name: one for name, one in KNOWN.items() if name not in switches})
    line.at(500)
    for text in ("I0", "V2000", "F1000,5000,10000", "P1,3,2", "D1,1,1,1"):
        line.say(text)
    return line


def runs_away(line: Line, *counters: int) -> bool:
    """True if a board that was seen there twice is moved no more."""
    for _ in range(2):
        line.at(*counters)
    return bool(line.travel_guard.runaway)


@pytest.mark.parametrize(("switches", "is_known"), [((), False), (("quit_flushes_queue",), True)])
def test_a_queue_that_may_be_kept_goes_on_behind_q(
    switches: tuple[str, ...], is_known: bool
) -> None:
    """By its own way, from where Q has ended the motion before; a second Q ends it, too."""
    line = open_line(*switches)
    line.say("M300")
    line.say("M-300,30")
    assert line.refuses("M-750") is is_known, "the first may be ended at once, and the second"
    assert line.travel_guard.quits(1) == 1 + is_known
    line.say("Q")
    assert runs_away(line, 500 + 20 - 300, 30) is not is_known
    if is_known:
        assert line.travel_guard.way_to_start(1) is None
        line.say("Q")
        line.at(500 - 250, 25)
        assert line.travel_guard.way_to_start(1) == (-250, 25, 0, 0)


def test_a_contour_is_ended_by_one_q() -> None:
    """However many segments it has."""
    line = open_line("quit_flushes_queue")
    for text in ("(", "M50", "M-20,10", "M30", ")"):
        line.say(text)
    line.left(0, 0, 0, 0)
    line.at(500 + 60, 10)
    assert line.travel_guard.way_to_start(1) is None, "nothing left of a segment is not the end"
    assert line.travel_guard.quits(1) == 1


def test_a_quit_that_may_have_a_ramp_takes_two_looks() -> None:
    """Both alike; one at the end of a move that was not cut short is enough."""
    line = open_line("quit_decel")
    line.say("M900")
    line.say("Q")
    for counter in (600, 650):
        line.at(counter)
        assert line.travel_guard.way_to_start(1) is None
    line.at(650)
    assert line.travel_guard.way_to_start(1) == (150, 0, 0, 0)
    line.say("M-100")
    line.at(550)
    assert line.travel_guard.way_to_start(1) == (50, 0, 0, 0)


def test_a_quit_that_may_end_an_entry_alone_leaves_the_motion() -> None:
    """Nothing is known before the next one."""
    line = open_line("quit_in_entry")
    for text in ("M900", "(", "Q"):
        line.say(text)
    assert not runs_away(line, 600)
    assert not runs_away(line, 700)
    assert line.travel_guard.way_to_start(1) is None
    line.say("Q")
    line.at(750)
    assert line.travel_guard.way_to_start(1) == (250, 0, 0, 0)


@pytest.mark.parametrize("counted", [True, False])
def test_backlash_that_may_be_counted_is_looked_for(counted: bool) -> None:
    """The axis is where its counter says; how far it may go is known before."""
    line = open_line("backlash_counts")
    line.say("B50,0,0,0")
    line.say("M-50")
    end = -50 - 50 * counted
    line.at(500 - 20)
    assert not runs_away(line, 500 + end)
    line.left(0, 0, 0, 0)
    line.at(500 + end)
    assert line.travel_guard.way_to_start(1) == (end, 0, 0, 0)
    assert runs_away(line, 500 + end - 50)


def test_backlash_that_is_counted_leaves_no_other_slack() -> None:
    """What was made up for is on the way home already."""
    line = open_line("backlash_counts")
    line.travel_guard.readings["backlash_counts"] = "true"
    line.say("B50,0,0,0")
    assert line.refuses("M-960")
    line.say("M-900")
    line.at(500 - 950)
    assert line.travel_guard.way_to_start(1) == (-950, 0, 0, 0)
    assert not line.refuses("M-50")
