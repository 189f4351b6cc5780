"""The rig checks on the built-in twin: with its own rig, a slow one, one that does nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import pytest

from axistwin_conformance.base.events import CheckFinished, Event
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.families.mac.axis.rig_controls import AXIS_CONTROLS
from axistwin_conformance.transport.rig import Act, Rig, RigChoice, TwinRig
from axistwin_conformance.transport.transport import Transport

pytestmark = pytest.mark.strength

TWIN = "axistwin://mac23:0,mac23:1?time=virtual"
RIG_CHECKS = tuple(one.name for one in find_family("mac23").checks() if one.rig_needs)


class SlowRig(TwinRig):
    """As a person or a relay: every act takes a while, and nobody knows when it happened."""

    delay_s = 0.4

    def __init__(self, target: Transport, address: int) -> None:
        super().__init__(target, address, AXIS_CONTROLS)
        self.is_exact = False

    def _work(self, act: Act) -> None:
        self._target.wait(self.delay_s)
        super()._work(act)
        self._target.wait(self.delay_s)


@dataclass(frozen=True, slots=True)
class SlowChoice(RigChoice):
    """Hands out a slow rig."""

    capabilities: frozenset[str] = frozenset(AXIS_CONTROLS)

    def open(self, target: Transport, address: int, controls: Any, notify: Any) -> Rig:
        """Make it."""
        return SlowRig(target, address)


def with_quirks(model: str, *quirks: str) -> str:
    """The URL of a twin with these readings."""
    return f"axistwin://{model}:0,{model}:1?time=virtual" + "".join(f"&quirk.{q}" for q in quirks)


def judge(
    model: str, url: str | None = None, *names: str, rig: RigChoice | None = None, **given: Any
) -> Any:
    """Run rig checks, all of them or these; give all findings but passes, and the result."""
    options = make_options(model=model, ids=names or RIG_CHECKS, port=url, **given)
    engine = Engine(options if rig is None else replace(options, rig=rig))
    events: list[Event] = []
    result = engine.run(events.append)
    said = [
        (one.name, finding.verdict, finding.text, finding.requirement)
        for one in events
        if isinstance(one, CheckFinished)
        for finding in one.findings
        if finding.verdict not in (Verdict.PASS, Verdict.INFO)
    ]
    return said, result


GRANTED: dict[str, Any] = {"allow": "motion,stored,rig,destructive", "neighbours": (1,)}
REASONS = ("only a MAC34", "the manual gives no thresholds", "needs a rig that acts at once")


def test_where_there_is_no_room_for_a_single_step_more_is_asked_for() -> None:
    """A move of no increments is over before any rig acts: the check says what it needs."""
    name = "a_zeroed_move_ends_at_its_target_by_the_new_count"
    said, result = judge("mac23", None, name, max_travel=3)
    assert [verdict for _, verdict, _, _ in said] == [Verdict.NOT_RUN]
    assert "--max-travel" in said[0][2]
    assert not result.problems


@pytest.mark.parametrize("model", ["mac23", "mac34-1", "mac34-2"])
def test_the_twin_passes_every_rig_check(model: str) -> None:
    """Two readings of one manual agree about inputs, faults, loads and power cuts."""
    said, result = judge(model)
    assert [one for one in said if not one[2].startswith(REASONS)] == []
    assert result.exit_status == 0
    if model == "mac23":  # of which the manual gives all thresholds
        assert {one.verdict for one in result.requirements} == {Verdict.PASS}


def test_a_device_that_may_only_move_slowly_is_not_taken_for_another() -> None:
    """At 130 increments per second a move lasts longer, and its end is waited for all the same."""
    name = "a_zeroed_move_ends_at_its_target_by_the_new_count"
    said, result = judge("mac23", TWIN, name, max_travel=2000, max_speed=130, **GRANTED)
    assert said == []
    assert result.exit_status == 0


def test_a_question_that_came_near_the_edge_leaves_no_reference_enabled() -> None:
    """Otherwise every later move up counts as one without an end, and has no room for it."""
    name = "a_hardware_stop_lets_a_catch_up_away_from_it_go_on"
    said, result = judge("mac23", TWIN, name, max_travel=500, max_speed=20_000, **GRANTED)
    assert said == []
    assert result.exit_status == 0


def test_a_slow_rig_gives_the_same_verdicts() -> None:
    """Nothing is judged more sharply than the rig's own time allows."""
    said, _ = judge("mac23", rig=SlowChoice(), max_travel=2000, max_speed=10_000)
    assert [one for one in said if not one[2].startswith(REASONS)] == []


def test_a_rig_that_is_too_slow_makes_no_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was over before the rig acted is no verdict, nor what then fits no more inside."""
    monkeypatch.setattr(SlowRig, "delay_s", 6.0)
    said, _ = judge("mac23", rig=SlowChoice(), max_travel=2000, max_speed=10_000)
    rest = [one for one in said if not one[2].startswith((*REASONS, "needs --max-travel"))]
    assert {verdict for _, verdict, _, _ in rest if verdict is not Verdict.NOT_RUN} == {
        Verdict.INCONCLUSIVE
    }


def test_a_rig_that_does_nothing_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Above all not that a disabled input has no effect."""
    monkeypatch.setattr(SlowRig, "_work", lambda rig, act: None)
    _, result = judge("mac23", rig=SlowChoice(), max_travel=2000, max_speed=10_000)
    passed = {one.requirement.id for one in result.requirements if one.verdict is Verdict.PASS}
    assert (
        passed
        & {
            "MACS-STOP-01",
            "MACS-STOP-02",
            "MACS-REF-01",
            "MACS-CMD-07-01",
            "MACS-CMD-07-02",
            "MACS-IO-01",
            "MACS-Q-27-02",
            "MACS-PERS-01",
            "MACS-PERS-03",
            "MACS-BUSY-02",
            "MACS-CMD-1A-02",
            "MACS-STATE-02",
        }
        == set()
    )


# switch, reading, model, the check that has to notice
SEEN = [
    ("hard_stop_command", "refuse", "mac23", "toward_an_active_hardware_stop_nothing_moves"),
    ("ff_lifetime", "live", "mac23", "a_hardware_stop_ends_motion_of_its_sign"),
    ("ff_lifetime", "until_reset", "mac23", "a_hardware_stop_ends_motion_of_its_sign"),
    ("status_ff_layout", "shifted", "mac23", "a_hardware_stop_ends_motion_of_its_sign"),
    ("busy_after_abort", "true", "mac23", "a_stopped_move_does_not_catch_up"),
    ("ref_edge", "closing", "mac23", "opening_the_reference_contact_zeroes_the_counter"),
    ("ref_retarget", "remaining", "mac23", "a_zeroed_move_ends_at_its_target_by_the_new_count"),
    ("has_reset_input", "false", "mac23", "held_in_reset_the_module_is_deaf"),
    ("disj_refuse_set", "starting", "mac23", "a_micro_cut_of_the_supply_locks_motion"),
    ("encoder_fault_locks", "false", "mac34-1", "a_missing_encoder_locks_motion"),
    ("status_hh_bit", "6-0", "mac23", "an_over_voltage_is_remembered"),
    ("persist_modes", "volatile", "mac23", "modes_outlive_the_supply_or_all_do_not"),
    ("zero_catchup", "refuse", "mac23", "a_held_axis_catches_up_at_its_own_speed"),
    ("running_until", "exact", "mac23", "a_held_axis_is_busy_until_it_is_near_its_target"),
    ("running_until", "profile", "mac23", "a_held_axis_is_busy_until_it_is_near_its_target"),
    ("position_source", "set_point", "mac23", "a_held_axis_is_busy_until_it_is_near_its_target"),
]


@pytest.mark.parametrize(
    ("switch", "reading", "model", "check"), SEEN, ids=[f"{one[0]}={one[1]}" for one in SEEN]
)
def test_another_reading_is_named_and_not_failed(
    switch: str, reading: str, model: str, check: str
) -> None:
    """The check that looks at an ambiguity records the reading the twin follows."""
    said, result = judge(model, with_quirks(model, f"{switch}={reading}"), check, **GRANTED)
    assert any(text.startswith(f"{switch}={reading}") for _, _, text, _ in said)
    assert {verdict for _, verdict, _, _ in said} <= {Verdict.QUIRK, Verdict.NOT_RUN}
    assert result.exit_status == 0


@pytest.mark.parametrize("stops", ["9", "1"])
def test_modes_that_come_up_as_they_were_set_are_lost_all_the_same(stops: str) -> None:
    """A factory value may be the very one that the check has set."""
    quirks = with_quirks("mac23", "persist_modes=volatile", f"factory_stops={stops}")
    said, result = judge("mac23", quirks, "modes_outlive_the_supply_or_all_do_not", **GRANTED)
    assert [text for _, _, text, _ in said if text.startswith("persist_modes=volatile")]
    assert result.exit_status == 0


@pytest.mark.parametrize(
    "quirks",
    [
        # readings that rig checks look at, as many at once as go together
        (
            "hard_stop_command=refuse ff_lifetime=until_reset busy_after_abort=true"
            " ref_edge=closing disj_refuse_set=starting persist_modes=volatile"
            " zero_catchup=refuse running_until=exact"
        ),
        (
            "ff_lifetime=live status_ff_layout=shifted ref_retarget=remaining has_reset_input=false"
            " status_hh_bit=6-0 running_until=profile encoder_fault_locks=false"
        ),
        "position_source=set_point overshoot_return=fresh_profile boot_time_ms=2300",
        # and others, of which a run of rig checks alone has learnt nothing before
        "vel_f6_direction=positive segment_signed=false cmd_1c_supported=false xonerror_byte=18h",
        "plant=inertial power_on_at_boot=true motion_lock_set=serial_list reserved_bits=1",
    ],
)
def test_all_rig_checks_live_with_other_readings(quirks: str) -> None:
    """Named or not looked at, but never failed and never in doubt."""
    said, result = judge("mac23", with_quirks("mac23", *quirks.split()), **GRANTED)
    assert [one for one in said if one[1] not in (Verdict.QUIRK, Verdict.NOT_RUN)] == []
    assert result.exit_status == 0
