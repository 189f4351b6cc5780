"""The checker is mutated too: a wrong model, codec or table turns a healthy twin red.

What the suite predicts is proven able to be wrong: each fault planted into the suite's own
arithmetic makes the check that rests on it fail a twin that nobody has tampered with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import pytest
from checker_faults import Patch, fault, faults_in, judge_red

from axistwin_conformance.families.mac.axis.driver import facts as facts_module
from axistwin_conformance.families.mac.axis.model import forecast, kinematics
from axistwin_conformance.families.mac.axis.model.acceptance import ACCEPTANCE
from axistwin_conformance.families.mac.axis.model.forecast import Forecast, Timeline, TimeWindow
from axistwin_conformance.families.mac.axis.model.kinematics import Course, EvenRun, Profile
from axistwin_conformance.families.mac.serial import codec, family

pytestmark = pytest.mark.strength


def _cell(patch: Patch, index: int, cells: str) -> None:
    patch.setitem(ACCEPTANCE, index, replace(ACCEPTANCE[index], cells=cells))


@fault("the_period_is_locked_in_motion", "MACS-CMD-0D-02")
def a_locked_command_is_expected_to_be_free(patch: Patch) -> None:
    """The table says that 0Dh is accepted in a move."""
    _cell(patch, 0x0D, "AAAAAAAA")
    patch.setitem(
        ACCEPTANCE,
        0x0D,
        replace(ACCEPTANCE[0x0D], otherwise={}),
    )


@fault("torque_catch_up_and_tolerance_are_free_in_motion", "MACS-CMD-0C-03")
def a_free_command_is_expected_to_be_locked(patch: Patch) -> None:
    """The table says that 0Ch is refused while segments run."""
    _cell(patch, 0x0C, "AAAARAAA")


@fault("a_move_is_refused_in_motion", "MACS-CMD-13-02")
def a_move_is_expected_to_want_power(patch: Patch) -> None:
    """The table says that 13h is refused by an unpowered module."""
    _cell(patch, 0x13, "RARRRAAR")


@fault("every_answer_has_the_form_of_the_manual", "MACS-REPLY-07")
def the_sum_of_answers_is_off_by_one(patch: Patch) -> None:
    """The codec expects one more in every checksum of an answer to 22h."""
    checksum = codec.checksum
    patch.setattr(
        codec, "checksum", lambda data: checksum(data) + (len(data) == 11 and data[2:3] == b"9")
    )


@fault("every_other_checksum_is_nacked", "MACS-FRAME-03")
def a_wrong_sum_is_sent_right(patch: Patch) -> None:
    """What the suite sends as a wrong checksum is right."""
    patch.setattr(codec.SerialRequest, "with_wrong_checksum", lambda request, offset=1: request)


def _ramp(patch: Patch, change: Callable[[tuple[EvenRun, ...]], Iterable[EvenRun]]) -> None:
    ramp = kinematics.ramp

    def made(*args: Any) -> tuple[EvenRun, ...]:
        runs = ramp(*args)
        return tuple(change(runs)) if runs else ()

    patch.setattr(kinematics, "ramp", made)


@fault("moves_take_the_time_of_the_closed_form", "MACS-CMD-13-01")
def the_first_level_of_the_ramp_is_one_too_long(patch: Patch) -> None:
    """The ramp table has one more increment on its slowest level."""
    _ramp(patch, lambda runs: [replace(runs[0], count=(runs[0].count or 0) + 1), *runs[1:]])


@fault("moves_take_the_time_of_the_closed_form", "MACS-CMD-13-01")
def the_ramp_has_levels_of_equal_length(patch: Patch) -> None:
    """The ramp table shares its increments equally."""

    def shared(runs: tuple[EvenRun, ...]) -> list[EvenRun]:
        length = sum(run.count or 0 for run in runs)
        return [replace(run, count=length // 15) for run in runs]

    _ramp(patch, shared)


@fault("moves_take_the_time_of_the_closed_form", "MACS-CMD-13-01")
def the_ramp_has_fifteen_levels(patch: Patch) -> None:
    """Level k runs at k/15 of the full speed."""
    patch.setattr(kinematics, "RAMP_LEVELS", 15)


@fault("segments_run_at_their_own_constant_speed", "MACS-CMD-16-01")
def a_tick_is_too_long(patch: Patch) -> None:
    """A tick has 140 ns."""
    patch.setattr(forecast, "TICK_NS", 140)


@fault("moves_take_the_time_of_the_closed_form", "MACS-CMD-13-01")
def the_count_is_one_ahead(patch: Patch) -> None:
    """One step more is done at any time."""
    steps_by = Profile.steps_by
    patch.setattr(Profile, "steps_by", lambda profile, ticks: steps_by(profile, ticks) + 1)


@fault("velocity_climbs_and_cruises_on_time", "MACS-CMD-15-01")
def windows_end_early(patch: Patch) -> None:
    """What may be read in a window is what may be read two periods before it."""
    bounds = Forecast.bounds

    def shifted(one: Forecast, window: TimeWindow) -> tuple[int, int]:
        return bounds(one, TimeWindow(window.earliest_ns - 9_000_000, window.latest_ns - 9_000_000))

    patch.setattr(Forecast, "bounds", shifted)


@fault("a_ramped_stop_in_full_motion_takes_one_ramp", "MACS-CMD-17-01")
def a_stop_is_expected_to_take_half_a_ramp(patch: Patch) -> None:
    """A ramped stop descends half of what was climbed."""
    climbed = Course._climbed
    patch.setattr(Course, "_climbed", lambda course, done: climbed(course, done) // 2)


@fault("velocity_0_and_17h_stop_on_the_ramp", "MACS-CMD-15-04")
def a_stop_is_expected_dead(patch: Patch) -> None:
    """A ramped stop ends with the increment in progress."""
    patch.setattr(Course, "_climbed", lambda course, done: 0)


@fault("a_hard_stop_stops_where_the_axis_is", "MACS-CMD-18-01")
def a_halt_is_expected_further_on(patch: Patch) -> None:
    """18h lets the axis run on for more increments than one exchange of doubt explains."""
    at_rest = Timeline.at_rest

    def further(timeline: Timeline, now_ns: int) -> Timeline:
        rest = at_rest(timeline, now_ns)
        return replace(rest, origin=rest.origin + 60 * timeline.direction)

    patch.setattr(Timeline, "at_rest", further)


@fault("segments_follow_one_another_without_a_gap", "MACS-CMD-16-01")
def segments_are_expected_to_have_gaps(patch: Patch) -> None:
    """Each segment lasts 20 µs longer."""
    take: Any = vars(forecast.Segment)["duration_ns"].fget
    patch.setattr(forecast.Segment, "duration_ns", property(lambda one: take(one) + 20_000))


@fault("beyond_a_software_stop_every_motion_ends", "MACS-CMD-09-02")
def the_bits_of_both_stops_are_exchanged(patch: Patch) -> None:
    """ff bit 0 is expected of the superior stop."""
    from axistwin_conformance.families.mac.axis.checks import stops

    one, other = stops.SIDES
    swapped = (replace(one, bit=other.bit), replace(other, bit=one.bit))
    patch.setattr(stops, "SIDES", swapped)


@fault("supply_and_temperature_have_the_model_s_scale", "MACS-Q-27-01")
def the_supply_has_another_scale(patch: Patch) -> None:
    """27h is read with half of the model's volts per count."""
    facts = facts_module.MacFacts.volts
    patch.setattr(facts_module.MacFacts, "volts", lambda one, vv: facts(one, vv) * 0.9)


FAULTS = faults_in(globals())


@pytest.mark.parametrize("name", FAULTS)
def test_a_wrong_checker_turns_a_healthy_twin_red(name: str) -> None:
    """The prediction that was tampered with no longer holds, and the check says so."""
    judge_red(FAULTS[name], "mac23", (codec, family, forecast, facts_module, kinematics))
