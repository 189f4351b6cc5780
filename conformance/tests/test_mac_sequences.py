"""Sequences: any bytes are operations, the short way is the long way, and what is judged counts."""

from __future__ import annotations

import random

import pytest
from test_mac_machines import new_runner

from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.sequences.operations import ANCHORS, OPERATIONS, WHAT
from axistwin_conformance.families.mac.axis.sequences.sequence import AxisSequence
from axistwin_conformance.sequences.runner import Mismatch

pytestmark = pytest.mark.strength

OPERATION_COUNT = 60


def operation(name: str, first: int = 0, second: int = 0, pause: int = 0) -> bytes:
    """An operation by its name."""
    return bytes([WHAT[name], first, second, pause])


def performed(data: bytes, *, is_direct: bool = True) -> AxisSequence:
    """A sequence that has been played on a fresh twin, by the short way or by the long one."""
    run = new_runner().begin()
    assert run._is_direct
    run._is_direct = is_direct
    run.client.target.drain = bytes  # type: ignore[method-assign]  # looking for stray bytes takes time
    run.perform(data)
    return run


def test_any_byte_names_an_operation() -> None:
    """Every value of every byte is decoded, and the module agrees with the model."""
    run = performed(b"".join(bytes([what, 7, 9, 0]) for what in range(256)))
    assert {name for _, name in run.operated} == {one.name for one in OPERATIONS}


@pytest.mark.parametrize("number", range(3))
def test_the_short_way_hears_what_the_long_one_hears(number: int) -> None:
    """Lean exchanges lead to the same words, the same judgements and the same states."""
    data = random.Random(number).randbytes(4 * OPERATION_COUNT)
    short, long = performed(data), performed(data, is_direct=False)
    assert short.story == long.story
    assert short.judged == long.judged
    assert short.operated == long.operated


def test_only_what_was_asked_is_judged() -> None:
    """Nothing but the closing stop and queries: no credit for motion, starts or the FIFO."""
    run = performed(b"")
    assert set(run.judged) == {
        "MACS-CMD-18-01", "MACS-Q-XX-01", "MACS-Q-20-01", "MACS-Q-21-01", "MACS-REPLY-05",
        "MACS-BUSY-01",
    }  # fmt: skip
    more = performed(operation("move", 0xA0))
    assert set(more.judged) - set(run.judged) == {"MACS-CMD-13-02", "MACS-CMD-13-01"}


def test_a_reply_that_may_be_either_proves_nothing() -> None:
    """Where both replies are admissible, neither counts as a judgement."""
    run = new_runner().begin()
    run.model.outcomes = lambda *_: {  # type: ignore[method-assign]
        ReplyKind.ACCEPTED: run.model.forecast,
        ReplyKind.REFUSED: run.model.forecast,
    }
    run.command(0x19)
    assert not run.judged


def test_each_operation_begins_at_a_mark_in_the_story() -> None:
    """What an operation sent and waited lies between its mark and the next."""
    run = performed(operation("stop", pause=0x8A) + operation("ask", 7) + operation("restart", 0))
    words = [run.story[begun] for begun in run.marks]
    assert [one.split()[3] for one in words] == ["18h", "27h", "00h"]
    assert run.story[run.marks[0] + 1] == "wait 10 ms"


def test_a_mismatch_carries_the_story_that_led_to_it() -> None:
    """The words of a mismatch end with the exchange that did not fit."""
    run = new_runner().begin()
    run.model.parameters.tolerance = 5
    with pytest.raises(Mismatch) as refuted:
        run.perform(operation("ask", 6))
    assert refuted.value.requirement == "MACS-REPLY-05"
    assert "26h" in refuted.value.story[-1]


def test_a_wait_for_an_instant_ends_about_the_end_of_the_motion() -> None:
    """The next request is taken over within the offset of the end of a move."""
    run = new_runner().begin()
    run.operate(*operation("set the ramp", 0))
    run.operate(*operation("move", 0xA0))
    end = run.model.forecast.end
    assert end is not None
    run.operate(*operation("wait for an instant", 0xFE, 0))
    aimed_ns = run.client.target.now_ns + run.driver.client.frame_ns
    assert end.earliest_ns <= aimed_ns <= end.latest_ns
    run.conclude()
    run.leave()


def test_a_sequence_begins_where_the_last_one_began() -> None:
    """Replays are comparable: the same place, whatever was done before."""
    runner = new_runner()
    runner.begin().perform(operation("move", 0xFF, 0, 0xFF) + operation("stop"))
    assert runner.begin().model.forecast.timelines[0].origin == runner.home


def test_a_sequence_behind_another_one_asks_nothing_that_is_known() -> None:
    """Only what differs is set back; the module is then as a beginning from nothing leaves it."""
    runner = new_runner()
    runner.begin().perform(operation("set the ramp", 4) + operation("enable the stops", 1))
    target = runner.driver.client.target
    before = target.transcript.position
    known = runner.begin().model
    said = [one.data[6:8] for one in target.transcript.since(before) if one.direction == "host"]
    assert said == [b"03", b"0F"]
    runner._last = None
    asked = runner.begin().model
    assert (known.parameters, known.forecast) == (asked.parameters, asked.forecast)


def test_a_sequence_behind_one_that_failed_asks_everything() -> None:
    """Nothing is believed of a module that the model does not fit."""
    runner = new_runner()
    failing = runner.begin()
    failing.model.parameters.tolerance = 5
    with pytest.raises(Mismatch):
        failing.perform(b"")
    assert not failing.is_known
    assert runner.begin().model.parameters.tolerance == 0


def test_a_counter_that_was_cleared_is_put_back_by_what_is_known() -> None:
    """The next sequence begins at the same place of the shaft."""
    runner = new_runner()
    runner.begin().perform(operation("move", 0xA0, 0, 0xFF) * 4 + operation("clear the counter"))
    assert runner.begin().home == runner.driver.client.position() == runner.home
    (twin,) = runner.driver.client.target.twins
    assert twin.position == runner.home


def test_a_place_after_segments_is_a_matter_of_segments() -> None:
    """So is the first reading after that motion; the next one is a matter of the query."""
    run = new_runner().begin()
    run.operate(*operation("segment", 40, 0, 0xFF))
    assert run.is_resting
    for name in ("MACS-CMD-16-01", "MACS-Q-20-01"):
        with pytest.raises(Mismatch) as refuted:
            run._judge_position(1 << 20, run._now())
        assert refuted.value.requirement == name
        run.query(0x20)


def test_a_frame_that_stores_nothing_passes_the_gate_once() -> None:
    """Each kind of frame is shown to the gate, each one that stores to gate and meter."""
    run = new_runner().begin()
    seen, metered = list[bytes](), list[bytes]()
    run.client.target.gate, run.client.target.meter = seen.append, metered.append
    for name in ("ask the position", "stop", "set the ramp") * 3:
        run.operate(*operation(name, 2))
    assert [one[6:8] for one in seen] == [b"20", b"18", b"0F", b"0F", b"0F"]
    assert metered == seen


def test_a_place_in_doubt_is_asked_for_before_the_next_motion() -> None:
    """A stop leaves some increments of doubt; only what starts from there needs to know."""
    run = new_runner().begin()
    for one in (operation("turn", 0, 0, 0xA0), operation("stop"), operation("ask", 6)):
        run.operate(*one)
    assert not run.model.forecast.is_in_one_place
    before = len(run.story)
    run.operate(*operation("nudge", 3))
    assert ["20h" in one for one in run.story[before:]] == [True, False]


@pytest.mark.parametrize(
    ("anchor", "place"),
    [("here", 0), ("superior stop", 100), ("inferior stop", -50), ("home", 0), ("counter 0", 0)],
)
def test_a_move_beside_an_anchor_goes_there(anchor: str, place: int) -> None:
    """An increment above it, where the state of the model says that it is."""
    run = new_runner().begin()
    run.command(0x09, 100)
    run.command(0x0A, -50)
    run.operate(*operation("move beside", ANCHORS.index(anchor), 0x81))
    assert run.model.forecast.final == (place + 1, place + 1)
    run.conclude()


def test_any_period_is_one_the_axis_may_run_at() -> None:
    """From the fastest of a sequence to the slowest there is."""
    run = new_runner().begin()
    for byte, period in ((0, 0x640), (0x10, 0x1010), (0xFF, 0xFFFF)):
        run.operate(*operation("set any period", byte))
        assert run.model.parameters.period == period
    run.conclude()
