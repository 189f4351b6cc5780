"""Behind the interfaces that people have, a healthy device never fails and shows no reading that is
not its own, and a faulty one never passes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from family_variants import vary
from interfaces import (
    ALL,
    BUSY_HOST,
    DROPPING,
    ECHOING,
    FAR_AWAY,
    GLITCH,
    LATENCY_TIMER,
    LOADED_HOST,
    MS,
    PLAIN,
    REBOOTING,
    TERMINAL_SERVER,
    WORST,
    Interface,
    InterfaceBus,
    InterfacePort,
    InterfaceRun,
    Way,
    judged_behind,
)
from real_interface import RealWay, twin_behind
from zoo.interpolation import segments_are_ramped
from zoo.motion import (
    a_triangle_stops_climbing_at_half_speed,
    busy_ignores_the_tolerance,
    going_to_0_clears_the_counter,
    the_lock_ends_early,
)
from zoo.mutant import Mutant
from zoo.sync import sync_starts_50_ms_late
from zoo_msc.line import a_packet_has_200_ms, a_pause_of_100_ms_in_a_body_ends_a_packet

from axistwin_conformance.base.events import Note
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.catalog import find_family

pytestmark = pytest.mark.strength

# What depends on how long an exchange takes: bursts, rows of segments, what must not be answered.
MAC_WORDS = (
    "the_fifo_has_three_stages", "a_refused_segment_is_accepted_when_a_stage_frees",
    "a_ramped_stop_does_not_interrupt_segments", "segments_follow_one_another_without_a_gap",
    "queries_end_at_29h", "unassigned_commands_are_refused",
    "after_00h_it_is_deaf_for_two_seconds",
)  # fmt: skip
MSC_WORDS = (
    "a_packet_broken_off_is_refused_when_its_time_is_over", "the_longest_packet_has_time_enough",
    "a_timer_flag_follows_its_timer", "a_repeat_carries_the_data_of_the_first_reply",
    "a_repeated_write_is_carried_out_again",
)  # fmt: skip
HEALTHY = [one for one in ALL if not one.echoes]


def healthy(run: InterfaceRun) -> InterfaceRun:
    """Nothing wrong is said of a device that is as it should be."""
    assert run.failed == []
    assert run.wrong_readings == {}
    assert run.result.exit_status in (0, 4), run.result.sentence
    assert run.result.problems == []
    return run


def seldom(value: object) -> Any:
    """A case that is like one that is always run."""
    return pytest.param(value, marks=pytest.mark.soak)


@pytest.mark.parametrize("interface", [PLAIN, LATENCY_TIMER, TERMINAL_SERVER], ids=str)
@pytest.mark.parametrize("rate", [38400, seldom(9600)])
def test_a_slow_line_costs_a_module_no_verdict(interface: Interface, rate: int) -> None:
    """Segments, bursts and silences last as long as exchanges there need: all of it is judged."""
    run = healthy(judged_behind(interface, *MAC_WORDS, rate=rate))
    assert run.result.exit_status == 0, run.result.sentence


@pytest.mark.parametrize(
    "interface",
    [LOADED_HOST, seldom(BUSY_HOST), WORST, DROPPING, seldom(GLITCH), seldom(FAR_AWAY)],
    ids=str,
)
def test_an_unsteady_line_makes_nothing_up_of_a_module(interface: Interface) -> None:
    """What comes late, or not at all, is tried again; if need be it is inconclusive."""
    healthy(judged_behind(interface, *MAC_WORDS, seed=2))


@pytest.mark.parametrize(
    "interface",
    [LATENCY_TIMER, TERMINAL_SERVER, seldom(LOADED_HOST), BUSY_HOST, seldom(DROPPING)],
    ids=str,
)
def test_an_interface_costs_a_controller_certainty_at_most(interface: Interface) -> None:
    """Time-outs, a timer of 250 ms and repeats, behind what disturbs them."""
    healthy(judged_behind(interface, *MSC_WORDS, model="msc-250"))


@pytest.mark.parametrize(
    "interface", [TERMINAL_SERVER, seldom(LATENCY_TIMER), seldom(WORST)], ids=str
)
def test_an_interface_costs_a_board_no_verdict(interface: Interface) -> None:
    """Moves, pauses, queue and program, each instant known a little worse."""
    run = healthy(judged_behind(interface, model="mn400", allow="motion,stored", seed=1))
    assert run.result.exit_status == 0, run.result.sentence


def test_a_line_too_slow_to_tell_holds_nothing_against_a_device() -> None:
    """What would fail only because an exchange takes 0.3 s is waited for, or left open for that."""
    run = healthy(judged_behind(FAR_AWAY, "refusals_change_nothing", seed=1))
    (one,) = run.result.checks
    assert not one.trouble or "an exchange takes up to" in one.trouble
    open_or_passed = (Verdict.PASS, Verdict.INCONCLUSIVE)
    assert run.verdicts["MACS-CMD-13-02"] in open_or_passed


def test_the_silence_of_addresses_left_is_no_noise() -> None:
    """Or what may change address, rate and memory is not run after the first check of them."""
    names = [one.name for one in find_family("mac23").checks() if "destructive" in one.safety]
    run = judged_behind(PLAIN, *names, model="mac23", level="full")
    assert run.result.exit_status == 0, run.result.sentence
    judged = {one.requirement.id for one in run.result.requirements if one.verdict is Verdict.PASS}
    assert {"MACS-CMD-01-01", "MACS-CMD-08-01", "MACS-CMD-1B-01", "MACS-FRAME-13"} <= judged


def test_nacks_of_two_modules_that_collide_are_held_against_neither() -> None:
    """Where every module Nacks every wrong sum, and jitter keeps the two apart (MACS-AMB-19)."""
    given: dict[str, Any] = {"query": "&quirk.nack_scope=any", "neighbours": (1,), "seed": 1}
    run = judged_behind(TERMINAL_SERVER, "a_nacked_frame_does_nothing", **given)
    assert run.failed == []
    assert run.result.exit_status == 0, run.result.sentence


def test_jitter_makes_no_unit_late_whose_time_limit_is_short() -> None:
    """T1 of 260 ms; the longest packet takes 258 ms on the slowest line (MSC-LNK-17, -22)."""
    words = ("the_longest_packet_has_time_enough", "the_time_limit_begins_with_each_packet")
    given: dict[str, Any] = {"query": "&quirk.packet_timeout_ms=260", "seed": 4201}
    run = judged_behind(TERMINAL_SERVER, *words, model="msc-250", level="full", **given)
    assert run.failed == []
    assert run.verdicts["MSC-LNK-22"] is Verdict.PASS
    assert run.verdicts["MSC-LNK-17"] is not Verdict.FAIL


REAL_WAYS = {
    "a pty in lumps": RealWay(lump_s=0.016),
    "TCP with jitter": RealWay(way_s=(0.005, 0.04), is_pty=False),
}


@pytest.mark.parametrize("kind", REAL_WAYS)
def test_a_real_port_gives_what_the_model_of_it_does(kind: str) -> None:
    """In front of `axistwin run`: whatever this machine does meanwhile, nothing fails."""
    words = ("the_fifo_has_three_stages", "queries_end_at_29h", "MACS-LINE-01")
    with twin_behind(REAL_WAYS[kind], "mac23") as port:
        options = make_options(
            model="mac23", port=port, ids=words, allow="motion,stored", level="quick"
        )
        options = replace(options, family=vary(options.family, probe_modules=()))
        told: list[str] = []
        result = Engine(options).run(
            lambda event: told.append(event.text) if isinstance(event, Note) else None
        )
    verdicts = {finding.verdict for one in result.checks for finding in one.findings}
    assert verdicts, result.sentence
    assert Verdict.FAIL not in verdicts, result.sentence
    assert any(text.startswith("instants are known to within ") for text in told)


@pytest.mark.parametrize("at_s", [seldom(5), 40, seldom(70)])
@pytest.mark.parametrize(("model", "words"), [("mac23", MAC_WORDS), ("msc-250", MSC_WORDS)])
def test_a_device_that_restarts_once_does_not_fail_by_it(
    at_s: int, model: str, words: tuple[str, ...]
) -> None:
    """Neither by being deaf, nor because its program stands still then."""
    interface = replace(REBOOTING, reboot_ns=at_s * 1000 * MS)
    healthy(judged_behind(interface, *words, model=model))


@pytest.mark.parametrize("model", ["mac23", "msc-250", "mn400"])
def test_who_hears_himself_is_told_so(model: str) -> None:
    """An adapter for RS-485 that echoes: not judged, and the remedy is named."""
    result = judged_behind(ECHOING, model=model).result
    assert result.exit_status == 3
    assert "switch off the local echo of the adapter" in result.sentence


FAULTS = (
    a_triangle_stops_climbing_at_half_speed, sync_starts_50_ms_late,
    a_packet_has_200_ms, a_pause_of_100_ms_in_a_body_ends_a_packet,
)  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
@pytest.mark.parametrize(
    "interface", [LATENCY_TIMER, TERMINAL_SERVER, seldom(LOADED_HOST)], ids=str
)
def test_a_fault_of_tens_of_ms_never_passes(fault: Mutant, interface: Interface) -> None:
    """Behind an adapter it is found; elsewhere it is at least not held for sound."""
    if fault is sync_starts_50_ms_late and interface is TERMINAL_SERVER:
        pytest.skip("a delay shorter than an exchange: the run says that it is not seen")
    with fault.plant():
        run = judged_behind(interface, *fault.claims, model=fault.model)
    told = {run.verdicts[name] for name in fault.claims}
    assert told <= {Verdict.FAIL, Verdict.INCONCLUSIVE}, run.result.sentence
    assert interface is not LATENCY_TIMER or told == {Verdict.FAIL}


@pytest.mark.parametrize("interface", [PLAIN, LATENCY_TIMER], ids=str)
def test_a_time_of_the_device_is_not_taken_for_the_way_to_it(interface: Interface) -> None:
    """What passes between two things heard has no way in it: a delay of 40 ms is told as that."""
    run = judged_behind(
        interface, model="msc-250", level=None, detects=True,
        query="&quirk.reply_delay_ms=40&quirk.packet_timeout_ms=400",
    )  # fmt: skip
    readings = {switch: one.reading for switch, one in run.result.detections.items()}
    assert readings["reply_delay_ms"] == "40"
    assert readings["ack_timeout_ms"] == "1000"
    assert readings["packet_timeout_ms"] in ("400", "420")


SLOWED = (
    going_to_0_clears_the_counter, busy_ignores_the_tolerance, the_lock_ends_early,
    segments_are_ramped,
)  # fmt: skip


@pytest.mark.parametrize("fault", SLOWED, ids=lambda fault: fault.name)
def test_a_motion_is_slowed_until_its_faults_show(fault: Mutant) -> None:
    """Where an exchange takes 80 ms, a motion at the usual speed would be over before it shows."""
    with fault.plant():
        run = judged_behind(TERMINAL_SERVER, *fault.claims, model=fault.model, level="full")
    assert {run.verdicts[name] for name in fault.claims} == {Verdict.FAIL}, run.result.sentence


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(10, 13))
@pytest.mark.parametrize(("model", "rate"), [("mac23", 38400), ("mac23", 9600), ("msc-250", 9600)])
@pytest.mark.parametrize("interface", HEALTHY, ids=str)
def test_whatever_the_interface_a_healthy_device_never_fails(
    interface: Interface, model: str, rate: int, seed: int
) -> None:
    """All that is judged at quick."""
    healthy(judged_behind(interface, model=model, rate=rate, seed=seed))


@pytest.mark.strength(seconds=20)
@pytest.mark.parametrize("calls", [400, 2600])
@pytest.mark.parametrize(("model", "kind"), [("mac23", InterfacePort), ("mac23-can", InterfaceBus)])
def test_an_interrupted_run_puts_back_what_it_found(
    model: str, kind: type[Way[Any]], calls: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy host, wherever it is met, with what is late still on its way."""
    left, send = [calls], kind._send

    def interrupted(way: Way[Any], sent: Any) -> None:
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt
        send(way, sent)

    monkeypatch.setattr(kind, "_send", interrupted)
    run = judged_behind(BUSY_HOST, model=model, allow="motion,stored")
    assert run.result.is_interrupted
    assert (run.result.exit_status, run.result.problems) == (130, [])
    assert (run.way.is_put_back, run.way.is_left_moving) == (True, False)
