"""What is made of an MN400 on a real line: silences that are wanted, and replies that take time."""

from __future__ import annotations

from typing import Any

import pytest
from interfaces import PLAIN, InterfaceRun, judged_behind
from mn400_twin import URL, AlteredTwin, session_of
from zoo_mn400.boards import the_new_rate_is_told_at_the_old_one

from axistwin_conformance.base.errors import TargetError
from axistwin_conformance.base.events import Event, Note
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.driver import BoardDriver
from axistwin_conformance.families.mn400.persistence.address_recovery import brought_back
from axistwin_conformance.families.mn400.persistence.supply import serves_again
from axistwin_conformance.transport.serial import SerialTransport

ELSEWHERE = (
    "the_id_can_be_set", "an_id_for_all_boards_is_obeyed_or_refused", "the_rate_can_be_set",
    "a_configuration_is_kept_and_not_carried_out", "a_configuration_leaves_the_program_as_it_is",
    "both_programs_share_one_memory",
)  # fmt: skip


def judged(*words: str, **given: Any) -> tuple[InterfaceRun, list[str]]:
    """Judge a sound twin as a real board, with all allowed that needs no rig; and what is told of
    the line."""
    told: list[Event] = []
    how = {"model": "mn400", "rate": 9600, "level": "full", "hear": told.append, **given}
    run = judged_behind(PLAIN, *words, **how)
    notes = [one.text for one in told if isinstance(one, Note)]
    return run, [text for text in notes if "was late" in text or "noise on" in text]


def session_on_a_line(port: Any) -> Session:
    """A session with a twin from which a reply may be lost."""
    return session_of(port, target=SerialTransport(port, URL, is_lossless=False))


# --- where nobody answers -------------------------------------------------------------------------


@pytest.mark.strength(seconds=10)
def test_a_board_that_is_elsewhere_makes_no_line_noisy() -> None:
    """No silence at an id or a rate that it has left counts; nothing is left changed."""
    run, told = judged(*ELSEWHERE)
    result = run.result
    assert {one.verdict for one in result.requirements} == {Verdict.PASS}
    assert told == []
    assert result.problems == []
    assert result.exit_status == 0, result.sentence


def test_a_rate_that_is_told_at_the_old_one_is_found_on_a_line_that_may_lose_it() -> None:
    """BAUDCHANGEOK is whole where our end has stayed."""
    with the_new_rate_is_told_at_the_old_one.plant():
        run, _ = judged("the_rate_can_be_set")
    failed = {one.requirement.id for one in run.result.requirements if one.verdict is Verdict.FAIL}
    assert failed == {"MN4-CMD-BAUD-01", "MN4-DROP-11"}


def test_a_board_that_does_not_answer_any_more_is_brought_back_from_its_new_id() -> None:
    """Where the silence at its old one has lasted too long."""
    session = session_on_a_line(AlteredTwin())
    driver = BoardDriver(session)

    def given_up() -> None:
        with brought_back(driver, 9):
            driver.ask("=77")
            while True:
                driver.ask("*")

    with pytest.raises(TargetError, match="nothing has come"):
        given_up()
    assert session.run.cleanups == []
    assert driver.is_present()


def test_a_board_that_takes_its_time_after_power_up_makes_no_line_noisy() -> None:
    """It is polled until it answers, and what it did not hear counts for nothing."""
    port = AlteredTwin(says=lambda raw: raw if port.virtual_time_ns > from_ns else b"")
    from_ns = 0
    session = session_on_a_line(port)
    from_ns = port.virtual_time_ns + 3 * 10**9
    assert serves_again(BoardDriver(session))
    assert session.run.quality.corrupted == 0


def test_a_poll_that_is_lost_does_not_hide_a_board() -> None:
    """Whether one is at some id is asked again, on a line that may lose what is said."""
    port = AlteredTwin(hears=lambda text: lost.pop() if lost else text)
    lost: list[str] = []
    session = session_on_a_line(port)
    lost += [""]
    assert BoardDriver(session).is_found()
    assert session.run.quality.corrupted == 0


class LosingPort(AlteredTwin):
    """Loses the second character of requests, of so many."""

    losing = 0

    def write(self, data: bytes) -> int:
        """Send what is not lost."""
        if not self.losing:
            return super().write(data)
        self.losing -= 1
        self.inner.write(data[:2] + data[3:])
        return len(data)


@pytest.mark.parametrize("text", ["M50", "H0", "J0"])
def test_what_a_board_has_not_taken_is_sent_again(text: str) -> None:
    """A move, too, under a sum that a lost character has made wrong; the axis goes there once."""
    port = LosingPort()
    driver = BoardDriver(session_on_a_line(port))
    port.losing = 1
    assert driver.ask(text).says("START", "DONE")
    driver.client.listen(1)
    assert driver.position()[0] == (50 if text == "M50" else 0)


# --- what takes its time --------------------------------------------------------------------------


@pytest.mark.strength(seconds=10)
def test_a_reply_that_is_due_later_than_others_is_not_late() -> None:
    """A measurement takes 0.1 s or 1 s, and behind the last line of a listing it is we who wait."""
    run, told = judged("MN4-MEA-01", "MN4-NVM-11")
    assert {one.verdict for one in run.result.requirements} == {Verdict.PASS}
    assert told == []


@pytest.mark.strength
def test_a_board_of_a_high_id_is_judged_by_how_long_it_takes_without_its_slot() -> None:
    """At id 100 a poll waits for 1.4 s: that makes no line too slow to tell a reading."""
    query = "&quirk.omitted_param=zero"
    run, told = judged("what_is_left_out_keeps_its_value", address=100, query=query)
    assert run.result.readings["omitted_param"] == "zero"
    assert told == []


@pytest.mark.strength(seconds=10)
def test_a_board_of_a_high_id_conforms() -> None:
    """Its slot is waited for wherever what is asked holds a poll."""
    run, told = judged(
        "packets_in_a_row_are_answered_one_by_one", "a_gap_within_a_frame_does_not_break_it",
        "a_board_finds_the_next_frame", "in_motion_reads_are_answered_at_once",
        "what_another_board_says_is_none_of_its_business", address=100,
    )  # fmt: skip
    found = [one for ran in run.result.checks for one in ran.findings]
    assert {one.verdict for one in found} == {Verdict.PASS}
    assert run.wrong_readings == {}
    assert told == []
