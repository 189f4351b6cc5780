"""Failures of all families as people read them: on the terminal, on the page and at a build server.

Each planted fault is judged by one check; what the three say is held against a file in
`golden/failures/`, where an editor can read it.  The first paragraph is the same on all of them.

To record anew after a change that is meant, as in `test_contracts.py`.
"""

from __future__ import annotations

import html
import io
import re
import shlex
from functools import cache
from typing import Any, Final

import pytest
from click.testing import CliRunner
from rich.console import Console
from small_scratch import small_scratch
from zoo import ZOO as SERIAL
from zoo.mutant import Mutant
from zoo_can import ZOO as CAN
from zoo_mn400 import ZOO as BOARD
from zoo_msc import ZOO as MSC

from axistwin.cli.program import main
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.report.html import render
from axistwin_conformance.report.json import Report, event_object, fold
from axistwin_conformance.report.junit import junit
from axistwin_conformance.report.terminal import TerminalReport
from contracts.golden import FOLDER, compare, steady_text

pytestmark = pytest.mark.strength(seconds=120)

WIDTH: Final = 80
# Fault and check, by what the failure is about.
FAILURES: Final = {
    "motion-busy": (SERIAL, "a_move_is_never_busy", "busy_ends_within_the_tolerance"),
    "motion-ramp": (SERIAL, "going_to_0_has_no_ramp", "going_to_0_is_a_move_like_any_other"),
    "motion-step": (
        SERIAL,
        "an_empty_fifo_loses_a_step",
        "segments_run_at_their_own_constant_speed",
    ),
    "motion-counter": (
        SERIAL,
        "clearing_the_counter_does_nothing",
        "the_counter_is_cleared_where_the_axis_stands",
    ),
    "motion-stop": (
        SERIAL,
        "the_superior_stop_is_noticed_late",
        "beyond_a_software_stop_every_motion_ends",
    ),
    "motion-sync": (CAN, "sync_is_ignored", "sync_starts_a_preloaded_move"),
    "motion-sign": (CAN, "a_move_is_relative", "positions_are_signed_and_big_endian"),
    "refusals-lock": (
        SERIAL,
        "torque_at_rest_is_free_in_motion",
        "torque_at_rest_is_locked_in_motion",
    ),
    "refusals-effect": (SERIAL, "a_refused_period_is_stored", "refusals_change_nothing"),
    "refusals-digits": (
        SERIAL,
        "numbers_are_parsed_by_a_library",
        "parameters_that_are_no_digits_are_refused",
    ),
    "refusals-index": (SERIAL, "one_unassigned_query_answers", "queries_end_at_29h"),
    "refusals-form": (
        CAN,
        "refusals_forget_what_they_refuse",
        "refused_downloads_are_answered_with_80h_and_zeros",
    ),
    "refusals-fault": (
        SERIAL,
        "a_fault_locks_the_parameters_too",
        "a_micro_cut_of_the_supply_locks_motion",
    ),
    "refusals-flag": (MSC, "a_flag_above_255_can_be_written", "a_flag_number_above_255_is_refused"),
    "framing-checksum": (
        SERIAL,
        "the_sum_over_the_length_field_passes",
        "every_other_checksum_is_nacked",
    ),
    "framing-start": (SERIAL, "stx_does_not_restart_reception", "stx_begins_anew"),
    "framing-address": (
        SERIAL,
        "the_address_of_an_answer_is_ff",
        "every_answer_has_the_form_of_the_manual",
    ),
    "framing-length": (CAN, "seven_bytes_are_enough", "a_short_request_gets_no_reply"),
    "framing-packet": (MSC, "a_sum_may_leave_the_unit_out", "every_other_checksum_is_refused"),
    "framing-unit": (MSC, "replies_carry_unit_1", "each_unit_answers_its_own_number_only"),
    "timing-start": (
        SERIAL,
        "it_listens_while_it_starts",
        "after_00h_it_is_deaf_for_two_seconds",
    ),
    "timing-lifebeat": (
        CAN,
        "the_lifebeat_comes_every_twelve_seconds",
        "a_lifebeat_comes_every_ten_seconds_of_silence",
    ),
    "timing-packet": (
        MSC,
        "a_pause_of_100_ms_in_a_body_ends_a_packet",
        "a_packet_broken_off_is_refused_when_its_time_is_over",
    ),
    "timing-byte": (MSC, "a_second_stop_bit_is_sent", "a_character_takes_ten_bits_of_9600_baud"),
    "persistence-ramp": (SERIAL, "the_ramp_is_not_stored", "parameters_outlive_the_supply"),
    "persistence-address": (
        CAN,
        "the_address_is_kept_in_ram",
        "the_address_outlives_the_supply_once_it_holds",
    ),
    "persistence-memory": (MSC, "memory_is_lost_silently", "memory_is_kept_or_said_not_to_be"),
    "link-repeats": (
        MSC,
        "a_reply_is_repeated_three_times",
        "a_refused_reply_comes_again_up_to_five_times",
    ),
    "link-data": (MSC, "seven_bits_of_each_byte_are_stored", "a_value_written_is_the_value_read"),
    "link-inputs": (
        SERIAL,
        "the_reference_input_is_inverted",
        "the_inputs_show_whatever_is_enabled",
    ),
    "board-target": (BOARD, "targets_are_distances", "coordinates_are_those_of_the_mode"),
    "board-checksum": (BOARD, "a_sum_may_be_one_more", "every_other_checksum_is_refused"),
}


@cache
def judged(name: str) -> tuple[str, Report]:
    """What the terminal said, and the report."""
    zoo, fault, check = FAILURES[name]
    mutant: Mutant = next(one for one in zoo if one.name == fault)
    scratch = small_scratch(mutant.model)
    options = make_options(
        model=mutant.model, ids=(check,), address=mutant.address, seed=0, **scratch
    )
    engine, out, told = Engine(options), io.StringIO(), list[dict[str, Any]]()
    family = engine.family
    explain, spell = family.explain, family.transport_kind.spell
    console = Console(file=out, width=WIDTH, color_system=None)
    face = TerminalReport(console, engine.ledger, explain, spell=spell)

    def hear(event: Any) -> None:
        face(event)
        told.append(event_object(event, explain, spell))

    with mutant.plant():
        engine.run(hear)
    return out.getvalue(), fold(told)


def on_terminal(name: str) -> str:
    """The failure of the check as the terminal prints it."""
    check = FAILURES[name][2]
    return judged(name)[0].partition(f"FAIL  {check}\n")[2].partition("\n\n")[0]


def on_page(name: str) -> str:
    """The article of the check, without what is folded away and drawn."""
    check = FAILURES[name][2]
    page = render(judged(name)[1])
    article = page[page.index(f'<article id="fail-{check}"') :].partition("</article>")[0]
    text = re.sub("<svg.*?</svg>|<details>.*?</details>", "", article, flags=re.DOTALL)
    text = re.sub("<(?:td|th)[^>]*>", " ", text).replace("</li>", "\n")
    lines = (
        " ".join(line.split()) for line in html.unescape(re.sub("<[^>]*>", "", text)).split("\n")
    )
    return "\n".join(line for line in lines if line)


def at_build_server(name: str) -> str:
    """The text of the first failed case, up to the exchange."""
    text = junit(judged(name)[1])
    message = re.search(r'<failure message="(.*?)" type="fail">(.*?)\n +\d', text, re.DOTALL)
    assert message is not None, text
    return html.unescape(f"{message[1]}\n{message[2]}")


@pytest.mark.parametrize("name", FAILURES)
def test_a_failure_reads_as_recorded(name: str) -> None:
    """One sentence says what was done, expected and came; then what the manual asks, and where."""
    zoo, fault, check = FAILURES[name]
    what = next(one.description for one in zoo if one.name == fault)
    parts = {
        "planted": what,
        "terminal": f"{check}\n{on_terminal(name)}",
        "page": on_page(name),
        "build server": at_build_server(name),
    }
    told = "\n\n".join(f"=== {title}\n{text}" for title, text in parts.items())
    compare(f"failures/{name}.txt", steady_text(told) + "\n")


@pytest.mark.parametrize("name", FAILURES)
def test_terminal_page_and_build_server_use_the_same_words(name: str) -> None:
    """The sentence of the finding, whole."""
    check = FAILURES[name][2]
    [ran] = [one for one in judged(name)[1]["checks"] if one["name"] == check]
    sentence = next(one["sentence"] for one in ran["findings"] if one["verdict"] == "fail")
    assert sentence
    for text in (on_terminal(name), on_page(name), at_build_server(name)):
        assert "".join(sentence.split()) in "".join(text.split())
    # What is sent is one word to a shell, however long it is.
    lines = [line for line in on_terminal(name).splitlines() if not line.startswith(" " * 6 + "'")]
    assert max(map(len, lines)) <= WIDTH


@pytest.mark.parametrize("name", FAILURES)
def test_what_is_typed_by_hand_shows_the_failure_again(name: str) -> None:
    """The device with that fault gives the same last answer; or it is said why none can."""
    zoo, fault, check = FAILURES[name]
    [ran] = [one for one in judged(name)[1]["checks"] if one["name"] == check]
    finding = next(one for one in ran["findings"] if one["verdict"] == "fail")
    line = re.search(
        r"^   by hand     (.*?)(?:^ +\(.*)?\Z", on_terminal(name), re.MULTILINE | re.DOTALL
    )
    assert line is not None
    if line[1].startswith("not ") or not finding["by_hand"]:
        assert " ".join(line[1].split()).startswith(finding["no_hand"])
        assert finding["no_hand"]
        return
    program, *words = shlex.split(line[1].replace("\\\n", ""))
    assert program == "axistwin"
    with next(one for one in zoo if one.name == fault).plant():
        result = CliRunner().invoke(main, words)
    said = re.findall(r"^< (nothing within|\S+(?: [0-9A-F]{2})*)", result.output, re.MULTILINE)
    answers = [
        one["data"]
        for one in (finding["transcript"][number] for number in finding["decisive"])
        if one["direction"] == "device"
    ]
    last = answers[-1] if answers else "nothing within"
    assert said[-1].startswith(last), result.output


def test_every_recorded_failure_has_its_test() -> None:
    """What nobody compares any more is deleted."""
    assert {one.stem for one in (FOLDER / "failures").iterdir()} == {*FAILURES}
