"""A motion that is acknowledged and not done, once: several attempts would take it for noise."""

from __future__ import annotations

import pytest
from interfaces import DROPPING, PLAIN, judged_behind
from zoo import leftovers
from zoo.leftovers import every_sixteenth_move_is_lost

from axistwin_conformance.base.verdicts import Verdict

CHECKS = ("positions_are_signed_and_big_endian", "moves_take_the_time_of_the_closed_form")


@pytest.mark.parametrize("every", [9, 16])
def test_a_move_that_is_lost_once_fails_where_the_line_has_no_spot(
    every: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same 13h right behind it is done: no more attempts are made, and the device is wrong."""
    monkeypatch.setattr(leftovers, "SOME_MOVES", every)
    with every_sixteenth_move_is_lost.plant():
        run = judged_behind(PLAIN, *CHECKS, model="mac23", level="full")
    verdicts = {one.requirement.id: one.verdict for one in run.result.requirements}
    assert verdicts["MACS-CMD-13-01"] is Verdict.FAIL
    assert run.result.exit_status == 1


def test_a_line_that_drops_bytes_is_not_believed_so_easily() -> None:
    """Without the fault, and with noise, nothing fails."""
    run = judged_behind(DROPPING, *CHECKS, model="mac23", level="full")
    assert run.failed == []
