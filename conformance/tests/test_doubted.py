"""What a device held is known by its own answers; once these have failed, nobody knows it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from family_variants import vary
from interfaces import PLAIN, InterfacePort, judge_behind
from zoo.mutant import MonkeyPatch, answers, forget

from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result

pytestmark = pytest.mark.strength

READS_PERIOD = "the_period_reads_back"
READS_CATCH_UP = "the_catch_up_speed_reads_back"
CATCH_UP = b"0E"


@pytest.fixture
def sent(monkeypatch: MonkeyPatch) -> list[bytes]:
    """The indices of all that goes to the device."""
    sent, send = list[bytes](), InterfacePort._send

    def told(port: InterfacePort, data: Any) -> None:
        sent.append(data[6:8])
        send(port, data)

    monkeypatch.setattr(InterfacePort, "_send", told)
    return sent


def judged(patch: MonkeyPatch, *words: str) -> Result:
    """A run on a real port without probes, of a module that answers 25h without its last byte."""
    answers(patch, 0x25, lambda value, axis, now: value & ~0xFF)
    forget()
    options = make_options(
        model="mac23", port=PLAIN.url, ids=words, level="quick", allow="motion,stored"
    )
    options = replace(options, family=vary(options.family, probe_modules=()))
    url = options.family.twin_url(options.model, options.address, options.neighbours)
    try:
        return judge_behind(PLAIN, options, url).result
    finally:
        patch.undo()
        forget()


def test_what_was_written_and_told_wrongly_before_is_said(monkeypatch: MonkeyPatch) -> None:
    """With what it was told as, and what was written last."""
    result = judged(monkeypatch, READS_PERIOD)
    assert result.exit_status == 1, result.sentence
    (told,) = result.problems
    assert told.startswith(
        "period was written to, and what it was is not known: it was told as 300h"
    )


def test_what_is_told_wrongly_and_not_written_yet_stays(
    monkeypatch: MonkeyPatch, sent: list[bytes]
) -> None:
    """What a check would write to it is left out."""
    result = judged(monkeypatch, READS_PERIOD, READS_CATCH_UP)
    assert result.exit_status == 1, result.sentence
    assert CATCH_UP not in sent
    (left_out,) = [one for one in result.checks if one.check.name == READS_CATCH_UP]
    assert "would write catch_up, and what it was is not known" in left_out.trouble
