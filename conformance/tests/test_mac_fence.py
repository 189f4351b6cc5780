"""The fence: nothing that is sent asks an axis to leave the envelope, and endless motion ends in
time."""

from __future__ import annotations

from typing import Any

import pytest

from axistwin_conformance.base.errors import OutsideEnvelope
from axistwin_conformance.core.readings import Readings
from axistwin_conformance.families.mac.axis.travel_guard import AxisTravelGuard
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.reader import LineReader

ACCEPTED, REFUSED, NACK = b"\x06\x13\x1a", b"\x06\x13\x17", b"\x15"
SECOND = 1_000_000_000
F6 = 0xF60000


def answer(index: int, data: int, address: int = 0) -> bytes:
    """The answer to a query."""
    summed = b"%02X%X%08X" % (address, index & 0xF, data & 0xFFFFFFFF)
    return b"\x06\x13\x02011" + summed + codec.two_digits(codec.checksum(summed)) + b"\x03\x1a"


class Line:
    """A host and a module that says what the test tells it to, behind the fence."""

    def __init__(self, **readings: str) -> None:
        self.travel_guard = AxisTravelGuard(LineReader(), 2000, 10_000, 0, Readings(readings))
        self.now_ns = 0
        self.reply_ns = SECOND // 100

    def say(
        self, index: int, parameter: int = 0, reply: bytes = ACCEPTED, address: int = 0
    ) -> None:
        """Send a frame; the reply comes 10 ms later, or `reply_ns`."""
        frame = codec.request(address, index, parameter).encode()
        self.travel_guard.sending(frame, self.now_ns)
        self.now_ns += self.reply_ns
        if reply:
            self.travel_guard.received(reply, self.now_ns)

    def at(self, position: int, address: int = 0) -> None:
        """A counter reading."""
        self.say(0x20, 0, answer(0x20, position, address), address)

    def has_deadline(self) -> bool:
        """Whether the fence will stop the axis by itself."""
        return self.travel_guard.deadline_ns is not None

    def refuses(self, index: int, parameter: int = 0, address: int = 0) -> bool:
        """True if the frame is held back."""
        frame = codec.request(address, index, parameter).encode()
        try:
            self.travel_guard.sending(frame, self.now_ns)
        except OutsideEnvelope:
            return True
        self.travel_guard.received(NACK, self.now_ns)  # as if never said
        return False

    def would_refuse(self, index: int, parameter: int = 0) -> bool:
        """The same without a word on the line."""
        frame = codec.request(0, index, parameter).encode()
        return self.travel_guard.foresee(frame, self.now_ns) is not None


@pytest.fixture
def line() -> Line:
    """A line whose axis was found at 500, with known readings."""
    line = Line(vel_f6_direction="negative", segment_signed="true", fifo_underrun="halt")
    line.at(500)
    line.say(0x0D, 0x1000)
    return line


def test_targets_are_counted_from_where_the_axis_was_found(line: Line) -> None:
    """500 ± 2000, to the increment."""
    assert not line.refuses(0x13, 2500)
    assert line.refuses(0x13, 2501)
    assert not line.refuses(0x13, -1500)
    assert line.refuses(0x13, -1501)


def test_an_axis_nobody_has_looked_at_is_not_moved() -> None:
    """Neither ours before its counter was read, nor a module that nobody named."""
    line = Line()
    assert line.refuses(0x13, 10)
    line.at(0)
    assert line.refuses(0x16, 0x00011000, address=7)
    assert not line.refuses(0x20, 0, address=7)


def test_a_general_command_moves_only_who_is_known_and_all_of_them(line: Line) -> None:
    """A neighbour found at 3000 must not be sent to 600."""
    assert not line.refuses(0x13, 600, address=0xFF)
    line.at(3000, address=1)
    assert line.refuses(0x13, 600, address=0xFF)
    assert not line.refuses(0x13, 1500, address=0xFF)


def test_segments_add_up_until_the_axis_is_known_to_rest(line: Line) -> None:
    """Three of 900 are too many; a stop and a reading begin anew."""
    line.say(0x16, 900 << 16 | 0x1000)
    line.say(0x16, 900 << 16 | 0x1000)
    assert line.refuses(0x16, 900 << 16 | 0x1000)
    line.say(0x18)
    line.at(700)
    assert not line.refuses(0x16, 900 << 16 | 0x1000)


def test_a_segment_that_waits_runs_from_where_a_ramped_stop_has_ended(line: Line) -> None:
    """MACS-AMB-77: some 800 increments, a ramp of 240, then the 600 that waited; not 500 more."""
    line.say(0x0F, 2)
    line.say(0x15, 0x1000)
    line.say(0x16, 600 << 16 | 0x1000)
    line.now_ns += 2 * SECOND // 5
    line.say(0x17)
    assert not line.refuses(0x16, 200 << 16 | 0x1000)
    assert line.refuses(0x16, 500 << 16 | 0x1000)


@pytest.mark.parametrize(
    ("readings", "farthest"),
    [({}, 160), ({"fifo_underrun": "decelerate"}, 160), ({"fifo_underrun": "error"}, 40)],
)
def test_behind_the_last_segment_an_axis_may_slow_down_on_its_ramp(
    readings: dict[str, str], farthest: int
) -> None:
    """MACS-AMB-40: as long as nobody knows that it does not, 120 increments per unit of 0Fh."""
    line = Line(**readings)
    line.at(0)
    line.say(0x0F, 1)
    line.say(0x16, 40 << 16 | 0x1000)
    assert line.travel_guard.axes[0].reach == (0, farthest)


def test_a_refused_segment_does_not_count_and_an_unanswered_one_may(line: Line) -> None:
    """What was not obeyed leads nowhere; what may have been obeyed does."""
    for _ in range(5):
        line.say(0x16, 900 << 16 | 0x1000, REFUSED)
    line.say(0x16, 900 << 16 | 0x1000, b"")
    line.say(0x16, 900 << 16 | 0x1000, b"")
    assert line.refuses(0x16, 900 << 16 | 0x1000)


def test_clearing_the_counter_does_not_move_the_envelope(line: Line) -> None:
    """0Bh at 1500 makes 1000 the last place up and -3000 the last down."""
    line.say(0x13, 1500)
    line.at(1500)
    line.say(0x0B)
    assert not line.refuses(0x13, 1000)
    assert line.refuses(0x13, 1001)
    assert line.refuses(0x14) is False
    line.say(0x0B, 0, b"")  # heard or not: 0 is here either way
    assert line.refuses(0x13, 1001)


def test_too_fast_a_period_is_held_back_wherever_it_stands(line: Line) -> None:
    """0Dh, 15h and 16h alike; 1Eh moves nothing."""
    assert line.refuses(0x0D, 0x031F)
    assert line.refuses(0x15, 0x031F)
    assert line.refuses(0x16, 0x0001031F)
    assert not line.refuses(0x1E, 0x0001031F)
    assert not line.refuses(0x0D, 0x0320)


def test_a_move_at_the_speed_that_was_found_is_held_back_if_that_is_too_fast() -> None:
    """The stored period counts, and what was found may be put back."""
    line = Line()
    line.at(0)
    line.say(0x25, 0, answer(0x25, 0x0100))
    assert line.refuses(0x13, 10)
    assert not line.refuses(0x13, 0), "a move of no way has no speed"
    line.say(0x16, 10 << 16 | 0x1000)
    assert line.refuses(0x13, 0), "and this one has a way"
    line.say(0x18)
    line.say(0x0D, 0x1000)
    assert not line.refuses(0x13, 10)
    assert not line.refuses(0x0D, 0x0100)


def test_endless_motion_has_to_be_stopped_before_the_edge(line: Line) -> None:
    """1953 increments per second over 2000 of room: a good second, less what braking takes."""
    line.say(0x15, 0x1000)
    deadline_ns = line.travel_guard.deadline_ns
    assert deadline_ns is not None
    assert 0.9 * SECOND < deadline_ns < 2000 / 1953 * SECOND
    line.say(0x18)
    assert line.travel_guard.deadline_ns is None


def test_a_stop_that_was_not_answered_does_not_lift_the_deadline(line: Line) -> None:
    """It may not have been heard."""
    line.say(0x15, 0x1000)
    before = line.travel_guard.deadline_ns
    line.say(0x18, 0, b"")
    line.say(0x21, 0, answer(0x21, 0))
    after = line.travel_guard.deadline_ns
    assert before is not None
    assert after is not None
    assert before - SECOND // 100 < after <= before


def test_a_reading_moves_the_deadline(line: Line) -> None:
    """From where the axis is known to be, there is more or less time left."""
    line.say(0x15, F6 | 0x1000)
    first = line.travel_guard.deadline_ns
    assert first is not None
    line.now_ns += SECOND // 2
    line.at(400)
    later = line.travel_guard.deadline_ns
    assert later is not None
    assert later > first + SECOND // 4


def test_near_the_edge_endless_motion_does_not_begin(line: Line) -> None:
    """There must be time to stop it."""
    line.say(0x13, 2490)
    line.at(2490)
    assert line.refuses(0x15, 0x1000)
    assert not line.refuses(0x15, F6 | 0x1000)


def test_while_nobody_knows_which_way_f6_turns_both_ways_count() -> None:
    """The probe that finds out stays inside, too."""
    line = Line()
    line.at(0)
    line.say(0x0D, 0x1000)
    line.say(0x13, 1990)
    line.at(1990)
    assert line.refuses(0x15, F6 | 0x1000)


def test_a_preloaded_endless_motion_begins_with_11h(line: Line) -> None:
    """Held, it needs no stop; started, it does; 18h forgets it."""
    line.say(0x10)
    line.say(0x15, 0x1000)
    assert not line.has_deadline()
    line.say(0x11)
    assert line.has_deadline()
    line.say(0x18)
    line.say(0x11)
    assert not line.has_deadline()


def test_11h_spends_the_arm(line: Line) -> None:
    """10h, 13h, 11h, and then 15h: that runs, and is no runaway."""
    for index, parameter in ((0x10, 0), (0x13, 0), (0x11, 0), (0x15, 0x0640)):
        line.say(index, parameter)
    line.now_ns += SECOND // 10
    line.at(500)
    assert not line.travel_guard.is_in_doubt
    assert line.has_deadline()


@pytest.mark.parametrize(
    "commands",
    [(0x10, 0x15, 0x17, 0x18), (0x10, 0x11, 0x15, 0x18)],
    ids=["a ramped stop", "an 11h that had nothing to start"],
)
def test_what_a_device_keeps_held_back_begins_with_11h(commands: tuple[int, ...]) -> None:
    """Where stops leave a preloaded motion (MACS-AMB-36), nothing but the 11h behind it ends it."""
    line = Line(vel_f6_direction="negative", preload_policy="keep")
    line.at(500)
    for index in commands:
        line.say(index, 0x1000 if index == 0x15 else 0)
    assert not line.has_deadline()
    line.say(0x11)
    assert line.has_deadline()


def test_an_11h_that_is_refused_tells_of_nothing_that_is_held_back() -> None:
    """10h and a stop that may leave it armed, and 11h is refused: a 15h may run at once."""
    line = Line(preload_policy="refuse")
    line.at(500)
    line.say(0x10)
    line.say(0x18)
    line.say(0x11, 0, REFUSED)
    line.say(0x15, 0x1000)
    assert line.has_deadline()


def test_an_endless_motion_behind_an_unanswered_10h_may_run_at_once(line: Line) -> None:
    """Nobody knows whether it is held: it has to be stopped in time."""
    line.say(0x10, 0, b"")
    line.say(0x15, 0x1000)
    assert line.has_deadline()


def test_a_device_that_holds_nothing_back_is_where_it_is_seen() -> None:
    """Spent by a motion and 11h, a 10h of a device that keeps what it holds uses no travel up."""
    line = Line(vel_f6_direction="negative", preload_policy="keep")
    line.at(0)
    for place in (900, 0) * 3:
        line.say(0x15, 0x1000)
        line.now_ns += SECOND // 10
        for index, parameter in ((0x18, 0), (0x10, 0), (0x13, place), (0x11, 0), (0x18, 0)):
            line.say(index, parameter)
        line.at(place)
        assert line.travel_guard.axes[0].reach == (place, place)


def test_a_frame_with_a_wrong_checksum_asks_for_nothing(line: Line) -> None:
    """It is how Nacks are provoked."""
    frame = codec.request(0, 0x13, 100_000).with_wrong_checksum().encode()
    line.travel_guard.sending(frame, line.now_ns)


def test_frames_hidden_in_noise_or_in_lower_case_are_seen(line: Line) -> None:
    """Some device might obey them."""
    frame: Any = codec.request(0, 0x13, 0x00ABCDEF)
    for data in (b"\x02\x02" + frame.encode() + b"\x03", frame.in_lower_case().encode()):
        with pytest.raises(OutsideEnvelope, match=r"11259375|00abcdef"):
            line.travel_guard.sending(data, line.now_ns)


def test_a_frame_sent_in_pieces_is_seen(line: Line) -> None:
    """A module waits for the rest of it as long as it takes."""
    frame = codec.request(0, 0x13, 0x00ABCDEF).encode()
    line.travel_guard.sending(frame[:9], line.now_ns)
    line.travel_guard.sending(frame[9:20], line.now_ns)
    with pytest.raises(OutsideEnvelope) as caught:
        line.travel_guard.sending(frame[20:], line.now_ns)
    assert (caught.value.option, caught.value.needed) == ("--max-travel", 0x00ABCDEF - 500)


def test_a_stop_is_never_held_back(line: Line) -> None:
    """Not even where braking from there leads out further than anything else may."""
    line.say(0x15, 0x0320)
    line.now_ns += SECOND // 5
    assert line.refuses(0x17), "a ramp is too long here"
    assert not line.refuses(0x18)


def test_an_axis_seen_where_nothing_leads_is_not_moved_again(line: Line) -> None:
    """Two looks in a row, at places inside the envelope too: it does not what it is told."""
    line.say(0x13, 900)
    line.at(1400)
    assert line.refuses(0x13, 600)
    assert line.travel_guard.is_in_doubt, "it may have been noise"
    line.at(700)
    assert not line.refuses(0x13, 600)
    line.at(1400)
    line.at(1420)
    assert line.travel_guard.runaway == (
        "after 13h, which leads to +200..+400 from where the axis was found, it was seen at +920:"
        " it is moved no more"
    )
    line.at(700)
    for index in (0x11, 0x13, 0x14, 0x15, 0x16):
        assert line.refuses(index, 0x00011000)
    assert not line.refuses(0x18)


def test_what_may_have_moved_an_axis_is_not_sent_again(line: Line) -> None:
    """All that was sent since it was last seen where it should be, whatever it is by its name."""
    line.say(0x0F, 2)
    line.at(500)
    line.say(0x02, 1)
    line.say(0x1C, 5)
    line.at(3000)
    assert not line.would_refuse(0x02, 0), "it may have been noise"
    line.at(3100)
    assert "after 1Ch, where other commands lead to +0..+0" in line.travel_guard.runaway
    assert line.travel_guard.broken == "MACS-CMD-1C-01"
    assert line.would_refuse(0x02, 0)
    assert line.would_refuse(0x1C, 0)
    assert not line.would_refuse(0x0F, 0)
    assert not line.would_refuse(0x18)
    assert not line.would_refuse(0x26)


def test_what_should_move_the_counter_is_named_first(line: Line) -> None:
    """Before the parameters that were written after it."""
    line.say(0x0B)
    line.say(0x0F, 2)
    line.at(3000)
    line.at(3100)
    assert line.travel_guard.broken == "MACS-CMD-0B-01"


def test_an_axis_that_ran_away_tells_what_moves_it_further(line: Line) -> None:
    """Each command that is followed by another place."""
    line.at(500)
    line.say(0x13, 900)
    line.at(3000)
    line.at(3100)
    line.say(0x0F, 2)
    line.at(3100)
    assert not line.would_refuse(0x0F, 3), "it stood"
    line.say(0x0D, 0x1000)
    line.at(3200)
    assert line.would_refuse(0x0D, 0x1000)
    assert not line.would_refuse(0x02)


def test_an_axis_whose_counter_stands_still_is_not_moved_again(line: Line) -> None:
    """Three motions that must have shown, one after the other; a short one shows nothing."""
    for target in (600, 400, 600, 400):
        line.say(0x13, target)
        line.say(0x18)
        line.at(500)
    assert not line.travel_guard.runaway
    for target in (700, 300, 700):
        assert not line.would_refuse(0x13, target)
        line.say(0x13, target)
        line.now_ns += SECOND
        line.say(0x18)
        line.at(500)
    assert line.travel_guard.runaway.startswith("3 motions in a row have not changed its counter")
    assert line.would_refuse(0x13, 600)


def test_motions_that_stops_may_bar_need_not_show(line: Line) -> None:
    """None of them, while stops are switched on: a stop may bar both directions (MACS-AMB-48)."""
    line.say(0x03, 8)
    for target in (700, 300, 700, 300, 700):
        line.say(0x13, target)
        line.now_ns += SECOND
        line.say(0x18)
        line.at(500)
    assert not line.travel_guard.runaway


def test_on_a_slow_line_a_motion_that_was_ended_at_once_need_not_show(line: Line) -> None:
    """A command may have been obeyed long before its reply is here."""
    line.reply_ns = SECOND // 2
    for target in (700, 300, 700, 300, 700):
        line.say(0x13, target)
        line.say(0x18)
        line.at(500)
    assert not line.travel_guard.runaway


def test_what_others_are_told_an_axis_need_not_show(line: Line) -> None:
    """Its counter stands while its neighbour moves."""
    line.at(0, address=1)
    for number in range(5):
        line.say(0x13, 100 * (number % 2 + 1), address=1)
        line.now_ns += SECOND
        line.at(100 * (number % 2 + 1), address=1)
        line.at(500)
    assert not line.travel_guard.runaway


def test_a_stop_may_bar_a_motion_or_two(line: Line) -> None:
    """What goes the other way shows that the counter counts."""
    for place in (500, 499, 500):
        for _ in range(2):
            line.say(0x15, 0x1000)
            line.now_ns += SECOND // 3
            line.at(place)
            line.say(0x18)
    assert not line.travel_guard.runaway


def test_an_axis_that_creeps_the_other_way_is_seen_to(line: Line) -> None:
    """Each reading lies within what an axis may run on from the one before."""
    line.say(0x13, 900)
    position = 500
    while not line.travel_guard.runaway and position > -1500:
        position -= 20
        line.at(position)
    assert "which leads to +0..+400" in line.travel_guard.runaway
    assert position > 0


def test_a_move_goes_on_to_its_number_of_the_new_count(line: Line) -> None:
    """0Bh at 700 on the way to 900: it ends 900 further on, and is seen there."""
    line.say(0x13, 900)
    line.at(700)
    line.say(0x0B)
    line.at(900)
    assert not line.travel_guard.is_in_doubt


def test_an_axis_turned_out_by_the_rig_may_come_back(line: Line) -> None:
    """What does not lead further out is let through."""
    line.travel_guard.worked("turn", (line.now_ns, line.now_ns))
    line.at(3000)
    assert line.refuses(0x13, 3001)
    assert not line.refuses(0x13, 600)


def test_what_would_be_held_back_can_be_asked_beforehand(line: Line) -> None:
    """With the option in the way and the least value that would do; nothing changes by asking."""
    fast, near = codec.request(0, 0x15, 0x0100), codec.request(0, 0x13, 2500)
    held_back = line.travel_guard.foresee(fast.encode(), line.now_ns)
    assert held_back is not None
    assert (held_back.option, held_back.needed) == ("--max-speed", 31_250)
    assert line.travel_guard.foresee(near.encode(), line.now_ns) is None
    assert line.travel_guard.axes[0].reach == (0, 0)


def test_who_refuses_18h_is_unpowered(line: Line) -> None:
    """After a fault nothing drives the axis: there is no deadline that nobody could meet."""
    line.say(0x15, 0x1000)
    line.say(0x18, 0, REFUSED)
    assert not line.has_deadline()


def test_the_rig_gives_no_travel_back(line: Line) -> None:
    """A reference contact worked at rest, and a supply that was cut, leave the shaft alone."""
    line.say(0x13, 2400)
    line.at(2400)
    for name in ("reference", "power"):
        line.travel_guard.worked(name, (line.now_ns, line.now_ns))
        line.at(2400)
        assert not line.refuses(0x13, 2500)
        assert line.refuses(0x13, 2501)


def test_a_counter_lost_with_the_supply_may_stand_anywhere_it_could(line: Line) -> None:
    """At 1500 from home it reads 0 again: it may be there still, or be back."""
    line.say(0x13, 2000)
    line.at(2000)
    line.travel_guard.worked("power", (line.now_ns, line.now_ns))
    line.at(0)
    assert line.refuses(0x13, 501)
    assert not line.refuses(0x13, 500)


def test_an_edge_of_the_reference_in_motion_moves_the_origin(line: Line) -> None:
    """Cleared near 700, the counter leaves 1800 above it, and no more."""
    line.say(0x07, 1)
    line.say(0x15, 0x4000)
    line.now_ns += 4 * SECOND // 10
    line.at(700)
    line.travel_guard.worked("reference", (line.now_ns, line.now_ns))
    line.at(4)
    line.say(0x18)
    line.at(5)
    line.say(0x07, 0)
    assert line.refuses(0x13, 1801)
    assert not line.refuses(0x13, 1750)


def test_a_move_that_the_reference_may_prolong_has_a_deadline(line: Line) -> None:
    """Until its target is seen: cleared under way, it has as far to go again."""
    line.say(0x07, 1)
    line.say(0x13, 800)
    assert line.has_deadline()
    line.now_ns += SECOND // 4
    line.at(800)
    assert not line.has_deadline()


def test_how_much_endless_motion_would_need_can_be_told(line: Line) -> None:
    """1953 increments per second go on for as long as they have already, and once more."""
    assert line.travel_guard.needed(SECOND) == 0
    line.say(0x15, 0x1000)
    needed = line.travel_guard.needed(SECOND)
    assert 2000 + 1953 - 200 < needed < 2000 + 1953 + 200


def test_an_axis_seen_to_stand_is_still_until_something_could_move_it(
    line: Line,
) -> None:
    """18h again need not be waited for; a motion that was refused has not moved it."""
    assert not line.travel_guard.is_still(0), "nobody has looked"
    for index, parameter in ((0x13, 600), (0x11, 0), (0x15, 0x0F1000), (0x16, 0x011000)):
        line.travel_guard.seen_still(0)
        line.say(index, parameter, REFUSED)
        line.say(0x18)
        assert line.travel_guard.is_still(0)
        line.say(index, parameter)
        line.say(0x18)
        assert not line.travel_guard.is_still(0)


@pytest.mark.parametrize("sign", ["true", "false", ""])
def test_a_step_back_may_be_a_long_way_forward_until_the_sign_is_known(sign: str) -> None:
    """Unknown, it may go on forward (MACS-AMB-38): that is no runaway, and ends in time."""
    known = {"segment_signed": sign} if sign else {}
    line = Line(vel_f6_direction="negative", fifo_underrun="halt", **known)
    line.at(500)
    if sign == "false":
        assert line.refuses(0x16, 0xFFFF1000)
        return
    line.say(0x16, 0xFFFF1000)
    assert line.has_deadline() is not bool(sign)
    for place in (600, 700, 800):
        line.at(place)
    assert bool(line.travel_guard.runaway) is bool(sign)
