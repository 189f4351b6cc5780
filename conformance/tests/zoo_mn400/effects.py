"""Faults of effects: what a command leaves undone, does too much, or does to what it should leave
alone (settings, paths, replies of single commands)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from axistwin.devices.mn400.commands import Interpreter
from axistwin.devices.mn400.link.packets import ReturnCode
from axistwin.devices.mn400.link.ports import Answer
from axistwin.devices.mn400.link.sender import Reply
from axistwin.devices.mn400.motion import (
    MoveSettings,
    SpeedProfile,
    VectorMotion,
    moves,
    straight,
)
from axistwin.devices.mn400.motion.arcs import ArcPath
from axistwin.devices.mn400.motion.paths import PathChain
from axistwin.devices.mn400.motion.timeline import FINE
from axistwin.devices.mn400.mover import Mover
from axistwin.devices.mn400.orders import MotionOrder
from axistwin.devices.mn400.readout import ReadOut
from zoo_mn400.planting import (
    Any_,
    MonkeyPatch,
    around,
    board_mutant,
    commands,
    data_packets,
    judges,
    parameter,
    plans,
    repeats,
    resummed,
    settles,
    values,
)

JOINED = {"is_joined": True}

# --- packets --------------------------------------------------------------------------------------


@board_mutant("MN4-PHY-02")
def seven_bits_of_a_value_are_sent(patch: MonkeyPatch) -> None:
    """The data packet of S closes with its address without bit 7."""
    data_packets(
        patch,
        lambda raw: raw[:-2] + bytes([raw[-2] & 0x7F]) + raw[-1:] if raw[1:2] == b"S" else raw,
    )


@board_mutant("MN4-PKT-12")
def a_space_in_front_is_passed_over(patch: MonkeyPatch) -> None:
    """A packet that begins with a space is the command behind it."""

    def act(go: Any_, one: Interpreter, now: int, payload: bytes, *rest: Any) -> Any:
        return go(now, payload.lstrip(b" "), *rest)

    around(patch, Interpreter, "obey", act)


@board_mutant("MN4-RSP-07")
def flags_have_no_start(patch: MonkeyPatch) -> None:
    """: draws the flags alone."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Answer:
        answer: Answer = go()
        return answer._replace(parts=answer.parts[1:]) if letter == ":" else answer

    judges(patch, act)


@board_mutant("MN4-RSP-07")
def feed_hold_is_done_in_silence(patch: MonkeyPatch) -> None:
    """; draws START alone."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Answer:
        answer: Answer = go()
        return answer._replace(parts=answer.parts[:1]) if letter == ";" else answer

    judges(patch, act)


def _codes_alone(patch: MonkeyPatch, code: ReturnCode) -> None:
    """Let packets with that code come without START."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Answer:
        answer: Answer = go()
        last = answer.parts[-1].message if answer.parts else None
        is_it = getattr(last, "code", None) == code and len(answer.parts) > 1
        return answer._replace(parts=answer.parts[-1:]) if is_it else answer

    judges(patch, act)


@board_mutant("MN4-ERR-03", "MN4-ERR-04", traps=(33,))
def nothing_pending_is_told_without_start(patch: MonkeyPatch) -> None:
    """K with nothing pending draws NOMOVEPENDING alone."""

    def act(go: Any_, one: Interpreter, line: Any, code: ReturnCode) -> Answer:
        answer: Answer = go()
        is_it = code is ReturnCode.NOMOVEPENDING
        return answer._replace(parts=answer.parts[-1:]) if is_it else answer

    around(patch, Interpreter, "_started", act)


@board_mutant("MN4-CMD-BAUD-04")
def the_rate_in_force_is_just_done(patch: MonkeyPatch) -> None:
    """~0 at 9600 baud draws START and DONE."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Answer:
        answer: Answer = go()
        return one._started(line, ReturnCode.DONE) if given == (0,) else answer

    around(patch, Interpreter, "_set_rate", act)


@board_mutant("MN4-CMD-RTX-03")
def a_repeat_is_read_anew(patch: MonkeyPatch) -> None:
    """& behind E tells where the axes are by then."""

    def change(readout: ReadOut, last: Reply, now: int) -> Reply:
        if last.value is None or last.value.count(",") != 3:
            return last
        return last._replace(value=",".join(map(str, readout.position_at(now))))

    repeats(patch, change)


@board_mutant("MN4-CMD-FW-01")
def the_revision_is_that_of_one_processor(patch: MonkeyPatch) -> None:
    """? leaves the last number out."""
    values(patch, "?", lambda text, readout, now: text.rpartition(" ")[0])


# --- settings -------------------------------------------------------------------------------------


@board_mutant("MN4-CMD-P-01", "MN4-CMD-HEL-03", "MN4-ARC-08")
def a_plane_stays_that_of_power_on(patch: MonkeyPatch) -> None:
    """P is answered and sets nothing."""
    settles(patch, "P", lambda after, before: replace(after, plane=before.plane))


@board_mutant("MN4-CMD-Y-01")
def a_jog_speed_is_not_kept(patch: MonkeyPatch) -> None:
    """Y is answered and sets nothing."""
    settles(patch, "Y", lambda after, before: replace(after, jog_speed=before.jog_speed))


@board_mutant("MN4-CMD-F-01")
def a_lower_end_speed_lowers_the_speed(patch: MonkeyPatch) -> None:
    """F with an end speed below V makes V as low, for good."""
    settles(patch, "F", lambda after, before: replace(after, speed=min(before.speed, after.top)))


@board_mutant("MN4-CMD-F-01", "MN4-CMD-F-03")
def a_profile_is_that_of_power_on(patch: MonkeyPatch) -> None:
    """F is answered and sets nothing."""
    settles(
        patch,
        "F",
        lambda after, before: replace(
            after, start=before.start, top=before.top, acceleration=before.acceleration
        ),
    )


@board_mutant("MN4-CMD-G-01", "MN4-JOG-02")
def a_tap_is_that_of_power_on(patch: MonkeyPatch) -> None:
    """G is answered and sets nothing."""
    settles(patch, "G", lambda after, before: replace(after, taps=before.taps, spi=before.spi))


@board_mutant("MN4-CMD-D-01")
def two_is_a_direction(patch: MonkeyPatch) -> None:
    """D2,1,1,1 draws DONE."""
    parameter(patch, "D", None, allowed=(1, -1, 2))


@board_mutant("MN4-CMD-FH-02", "MN4-SHD-02")
def feed_hold_cannot_be_set(patch: MonkeyPatch) -> None:
    """; is answered and sets nothing."""
    commands(patch, ";", lambda go, one, line, given: None)


@board_mutant("MN4-CMD-Q-03", "MN4-CMD-Q-01")
def quit_clears_the_counters(patch: MonkeyPatch) -> None:
    """Q loads them with 0."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        found = go()
        one._mover.load(line.now, (0, 0, 0, 0))
        return found

    commands(patch, "Q", act)


@board_mutant("MN4-SYN-02")
def external_sync_is_for_good(patch: MonkeyPatch) -> None:
    """Behind a negative V a positive one sets nothing."""
    settles(patch, "V", lambda after, before: before if before.speed < 0 else after)


@board_mutant("MN4-CMD-I-03")
def a_coordinate_mode_is_for_one_move(patch: MonkeyPatch) -> None:
    """Behind each motion the board is in relative mode again."""

    def act(go: Any_, mover: Mover, now: int, order: Any) -> None:
        go()
        mover.accepted = replace(mover.accepted, is_absolute=False)
        mover.settings = replace(mover.settings, is_absolute=False)

    around(patch, Mover, "_begin", act)


@board_mutant("MN4-PAR-07", "MN4-PKT-01")
def one_parameter_is_too_few_for_a_move(patch: MonkeyPatch) -> None:
    """M1000 draws PARA_ERROR, M1000, does not."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Answer:
        is_short = letter == "M" and line.text and "," not in str(line.text)
        answer: Answer = one._started(line, ReturnCode.PARA_ERROR) if is_short else go()
        return answer

    judges(patch, act)


# --- paths ----------------------------------------------------------------------------------------


@board_mutant("MN4-CMD-A-02")
def arcs_know_no_coordinates(patch: MonkeyPatch) -> None:
    """In absolute mode centre and destination of A and + are distances."""

    def act(go: Any_, order: MotionOrder, position: Any, field: int, axis: int) -> int:
        return int(go((0, 0, 0, 0), field, axis) if order.letter in "A+" else go())

    around(patch, MotionOrder, "distance", act)


@board_mutant("MN4-CMD-T-02")
def threads_know_no_coordinates(patch: MonkeyPatch) -> None:
    """In absolute mode the parameters of T are distances."""

    def act(go: Any_, order: MotionOrder, position: Any, field: int, axis: int) -> int:
        return int(go((0, 0, 0, 0), field, axis) if order.letter == "T" else go())

    around(patch, MotionOrder, "distance", act)


def _chord(plane: Any, end: Any) -> tuple[int, int, int, int]:
    steps = [0, 0, 0, 0]
    steps[plane[0]], steps[plane[1]] = end
    first, second, third, fourth = steps
    return first, second, third, fourth


@board_mutant("MN4-CMD-A-01", "MN4-ARC-05", "MN4-CMD-A-05", "MN4-ARC-04")
def arcs_are_their_chords(patch: MonkeyPatch) -> None:
    """A leads straight to its destination."""

    def act(
        go: Any_, now: int, settings: MoveSettings, plane: Any, center: Any, end: Any, way: Any
    ) -> Any:
        return straight(now, settings, _chord(plane, end))

    plans(patch, "arc", act)


@board_mutant("MN4-CMD-A-03", "MN4-ARC-01")
def every_arc_is_clockwise(patch: MonkeyPatch) -> None:
    """Direction -1 is 1."""
    plans(patch, "arc", lambda go, now, settings, *rest: go(now, settings, *rest[:-1], True))


@board_mutant("MN4-MOT-13", "MN4-CMD-A-05")
def arcs_are_slower_by_a_fifth(patch: MonkeyPatch) -> None:
    """A runs at four fifths of V."""

    def act(go: Any_, now: int, settings: MoveSettings, *rest: Any) -> Any:
        return go(now, replace(settings, speed=settings.speed * 4 // 5), *rest)

    plans(patch, "arc", act)


@board_mutant("MN4-CMD-HEL-01")
def a_helix_is_one_arc(patch: MonkeyPatch) -> None:
    """Its revolutions are not made."""
    plans(patch, "helix", lambda go, now, settings, *rest: go(now, settings, *rest[:-1], 0))


@board_mutant("MN4-HEL-02", "MN4-CMD-HEL-01")
def a_helix_rises_half_its_way(patch: MonkeyPatch) -> None:
    """The traverse is half of what was asked for."""

    def act(go: Any_, now: int, settings: MoveSettings, *rest: Any) -> Any:
        *before, traverse, turns = rest
        return go(now, settings, *before, traverse // 2, turns)

    plans(patch, "helix", act)


@board_mutant("MN4-HEL-05")
def a_helix_may_turn_back(patch: MonkeyPatch) -> None:
    """A negative number of revolutions is taken for none."""
    parameter(patch, "+", 6, low=-100)
    plans(
        patch,
        "helix",
        lambda go, now, settings, *rest: go(now, settings, *rest[:-1], max(0, rest[-1])),
    )


@board_mutant("MN4-MOT-05")
def a_multiplex_slows_a_move(patch: MonkeyPatch) -> None:
    """With X2 a move takes twice its time."""

    def act(go: Any_, now: int, settings: MoveSettings, *rest: Any) -> Any:
        return go(now, replace(settings, speed=max(2, settings.speed // settings.multiplex)), *rest)

    plans(patch, "straight", act)


def _slower(settings: MoveSettings, speed: int) -> int:
    """A speed, divided by the multiplex; external sync as it is."""
    return speed if speed < 0 else max(2, speed // settings.multiplex)


@board_mutant("MN4-MOT-05", "MN4-CMD-A-05")
def a_multiplex_slows_an_arc(patch: MonkeyPatch) -> None:
    """With X2 A takes twice its time."""

    def act(go: Any_, now: int, settings: MoveSettings, *rest: Any) -> Any:
        return go(now, replace(settings, speed=_slower(settings, settings.speed)), *rest)

    plans(patch, "arc", act)


@board_mutant("MN4-MOT-05", "MN4-CMD-HEL-01")
def a_multiplex_hastens_a_helix(patch: MonkeyPatch) -> None:
    """With X2 + takes half its time."""

    def act(go: Any_, now: int, settings: MoveSettings, *rest: Any) -> Any:
        return go(now, replace(settings, speed=settings.speed * settings.multiplex), *rest)

    plans(patch, "helix", act)


@board_mutant("MN4-MOT-05", "MN4-CMD-CC-05")
def a_multiplex_slows_a_contour(patch: MonkeyPatch) -> None:
    """With X2 each segment runs at half its speed."""

    def act(go: Any_, now: int, settings: MoveSettings, segments: Any, margin: int) -> Any:
        slow = [one._replace(speed=_slower(settings, one.speed)) for one in segments]
        return go(now, settings, slow, margin)

    plans(patch, "contour", act)


@board_mutant("MN4-MOT-05", "MN4-BKL-01")
def a_multiplex_slows_a_compensation(patch: MonkeyPatch) -> None:
    """With X2 backlash is taken up at half the speed."""
    make = moves.compensation

    def act(settings: MoveSettings, *given: Any) -> Any:
        return make(replace(settings, speed=_slower(settings, settings.speed)), *given)

    patch.setattr(moves, "compensation", act)


@board_mutant("MN4-MOT-11")
def short_moves_run_at_their_top_speed(patch: MonkeyPatch) -> None:
    """A move too short for its ramps has none."""

    def act(go: Any_, now: int, settings: MoveSettings, displacement: Any) -> Any:
        profile = settings.profile
        longest = max(map(abs, displacement))
        if longest * profile.acceleration < settings.speed**2 - profile.start**2:
            profile = SpeedProfile(profile.end, profile.end, profile.acceleration)
        return go(now, replace(settings, profile=profile), displacement)

    plans(patch, "straight", act)


@board_mutant("MN4-CC-04")
def a_margin_counts_fourfold(patch: MonkeyPatch) -> None:
    """(50 is a margin of 200."""
    plans(
        patch,
        "contour",
        lambda go, now, settings, segments, margin: go(now, settings, segments, 4 * margin),
    )


@board_mutant("MN4-CC-06", "MN4-CC-03")
def a_contour_has_the_speed_of_its_last_segment(patch: MonkeyPatch) -> None:
    """The speeds of the segments before it are forgotten."""

    def act(go: Any_, now: int, settings: MoveSettings, segments: Any, margin: int) -> Any:
        last = [one._replace(speed=segments[-1].speed) for one in segments]
        return go(now, settings, last, margin)

    plans(patch, "contour", act)


@board_mutant("MN4-BKL-02")
def an_axis_that_stands_forgets_its_direction(patch: MonkeyPatch) -> None:
    """A move of one axis lets the others remember the negative direction."""

    def act(go: Any_, now: int, settings: MoveSettings, displacement: Any) -> Any:
        rows = zip(displacement, settings.lash_memory, strict=True)
        first, second, third, fourth = (m if d else -1 for d, m in rows)
        if sum(one != 0 for one in displacement) == 1:
            settings = replace(settings, lash_memory=(first, second, third, fourth))
        return go(now, settings, displacement)

    plans(patch, "straight", act)


@board_mutant("MN4-BKL-02")
def an_axis_that_quit_keeps_from_its_segment_turns(patch: MonkeyPatch) -> None:
    """A contour that Q ends early lets the axes that have not moved remember the negative
    direction."""

    def act(go: Any_, motion: VectorMotion, axis: int, taken: int) -> int:
        is_kept = motion.is_aborted and len(motion.chain.paths) > 1 and not taken
        return -1 if is_kept and motion.chain.total(axis) else int(go())

    around(patch, VectorMotion, "_memory", act)


@board_mutant("MN4-BKL-01", "MN4-BKL-07")
def a_compensation_runs_on_into_its_motion(patch: MonkeyPatch) -> None:
    """Where both have one direction, without braking between them."""
    part: Any_ = moves.straight_part
    patch.setattr(moves, "straight_part", lambda *given, **how: part(*given, **how | JOINED))


@board_mutant("MN4-THR-06")
def a_thread_is_cut_short_by_a_low_speed(patch: MonkeyPatch) -> None:
    """Below 100 steps/s T takes half as many pulses."""

    def act(go: Any_, now: int, settings: MoveSettings, way: Any, pulses: int, offset: int) -> Any:
        is_slow = abs(settings.speed) < 100
        return go(now, settings, way, max(1, pulses // 2) if is_slow else pulses, offset)

    plans(patch, "thread", act)


@board_mutant("MN4-THR-04")
def a_thread_goes_on_beyond_its_pulses(patch: MonkeyPatch) -> None:
    """T makes its steps once more with as many pulses."""

    def act(go: Any_, now: int, settings: MoveSettings, way: Any, pulses: int, offset: int) -> Any:
        first, second, third, fourth = (2 * one for one in way)
        return go(now, settings, (first, second, third, fourth), 2 * pulses, offset)

    plans(patch, "thread", act)


@board_mutant("MN4-CMD-E-02")
def a_measurement_tells_no_count(patch: MonkeyPatch) -> None:
    """E1 and E2 tell the four counters alone."""

    def change(raw: bytes) -> bytes:
        if raw[1:2] != b"E" or raw.count(b",") != 4:
            return raw
        return resummed(raw[: raw.rindex(b",")] + raw[-3:-1])

    data_packets(patch, change)


# --- abort ----------------------------------------------------------------------------------------


@board_mutant("MN4-PAU-05", "MN4-CMD-PAU-02")
def quit_in_a_pause_is_not_heard(patch: MonkeyPatch) -> None:
    """A } behind { and Q goes on with the move."""

    def act(go: Any_, mover: Mover, now: int) -> None:
        if not mover.is_paused:
            go()

    around(patch, Mover, "quit", act)


@board_mutant("MN4-CMD-N-02", "MN4-LIM-08")
def too_much_is_left_behind_an_abort(patch: MonkeyPatch) -> None:
    """N is twice what is left, once a move has ended early."""

    def change(text: str, readout: Any, now: int) -> str:
        if readout._mover.is_busy:
            return text
        return ",".join(str(2 * int(one)) for one in text.split(","))

    values(patch, "N", change)


@board_mutant("MN4-CMD-S-01")
def aux_inputs_are_limits(patch: MonkeyPatch) -> None:
    """Aux input 1 is shown as the limit M1-."""

    def change(text: str, readout: Any, now: int) -> str:
        word = int(text)
        return str(word & ~0x100 | 1 if word & 0x100 else word)

    values(patch, "S", change)


@board_mutant("MN4-CMD-L-03")
def loading_forgets_what_is_left(patch: MonkeyPatch) -> None:
    """Behind L N is 0."""

    def load(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        one._mover.is_forgetful = True  # type: ignore[attr-defined]
        return go()

    def change(text: str, readout: Any, now: int) -> str:
        is_forgotten = getattr(readout._mover, "is_forgetful", False)
        readout._mover.is_forgetful = False
        return "0,0,0,0" if is_forgotten and not readout._mover.is_busy else text

    commands(patch, "L", load)
    values(patch, "N", change)


@board_mutant("MN4-HEL-02")
def a_long_traverse_runs_ahead_of_its_arc(patch: MonkeyPatch) -> None:
    """Where the traverse leads, the arc keeps to the ticks of its circle, not to its angle."""

    def act(go: Any_, path: ArcPath, x: int) -> int:
        return x * path.ticks // path.length if path.is_by_angle else int(go())

    around(patch, ArcPath, "_tick_at", act)


@board_mutant("MN4-HEL-02")
def a_traverse_keeps_to_the_ticks_of_its_arc(patch: MonkeyPatch) -> None:
    """It is even over them, where they are more than its steps, not over the angle."""

    def act(go: Any_, path: ArcPath, x: int) -> int:
        last = abs(path.traverse)
        even = (2 * last * x + path.length) // (2 * path.length)
        return int(go()) if path.is_by_angle else min(last, max(0, even))

    around(patch, ArcPath, "_traversed", act)


@board_mutant("MN4-MEA-01")
def each_segment_is_counted_anew(patch: MonkeyPatch) -> None:
    """Of a contour E1 counts the ticks of one segment, from its begin."""

    def act(go: Any_, chain: PathChain, x: int) -> int:
        over = (phantom for start, phantom in zip(chain.starts, chain._phantoms, strict=True)
                if start < x)  # fmt: skip
        return int(go()) - (max(over, default=0) >> FINE)

    around(patch, PathChain, "phantoms", act)


@board_mutant("MN4-CC-04")
def an_axis_that_sets_out_has_half_the_margin(patch: MonkeyPatch) -> None:
    """As one that turns round has; one that ends, too."""

    def act(go: Any_, before: Any, after: Any, margin: int, *rest: Any) -> Any:
        is_alone = any(bool(one) != bool(other) for one, other in zip(before, after, strict=True))
        return go(after, margin // 2 if is_alone else margin, *rest)

    around(patch, moves, "seam_between", act)
