"""Running a plan: identity first, safe on every way out, an honest verdict at the end."""

from __future__ import annotations

from typing import Any

import pytest
from family_variants import vary

from axistwin_conformance.base import events
from axistwin_conformance.base.errors import OutsideEnvelope, TargetError, UsageError
from axistwin_conformance.base.events import Outcome
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.probing import Seen
from axistwin_conformance.core.session import Session
from axistwin_conformance.engine import run as engine_module
from axistwin_conformance.engine.device import device_guard
from axistwin_conformance.engine.result import RequirementResult

LINE, FRAME, MOVE, STORE = "MACS-LINE-01", "MACS-FRAME-01", "MACS-CMD-13-01", "MACS-CMD-0D-01"


def exchange(session: Session, text: str) -> str:
    """One exchange with the toy."""
    session.target.send(text.encode())
    return session.target.receive(1, 0.01).decode()


def answers(session: Session) -> None:
    """It answers."""
    session.expect(exchange(session, "Q") == "q", None, "q", "something else")


def moves(session: Session) -> None:
    """It moves."""
    session.expect(exchange(session, "M") == "m", None, "m", "something else")


def stores(session: Session) -> None:
    """It stores a digit."""
    exchange(session, "P3")
    session.expect(exchange(session, "R") == "3", None, "3", "something else")


def fails(session: Session) -> None:
    """It would have to answer z."""
    session.note("asking for z")
    answer = exchange(session, "Q")
    session.expect(answer == "z", None, ["z", "Z"], answer, "z is the last letter")


def verdict_of(result: Any, key: str) -> RequirementResult:
    """What was said about a requirement."""
    found: list[RequirementResult] = [
        one for one in result.requirements if one.requirement.id == key
    ]
    return found[0]


def test_a_device_that_does_all_that_was_asked_conforms(toy: Any) -> None:
    """Exit 0, the target closed, one verdict per requirement of the ledger."""
    toy.add(answers, LINE)
    toy.add(moves, MOVE, safety="motion")
    result = toy.run()
    assert result.exit_status == 0
    assert verdict_of(result, LINE).verdict is Verdict.PASS
    assert verdict_of(result, FRAME).verdict is Verdict.NOT_RUN
    assert len(result.requirements) == 136
    assert not toy.port.is_open
    assert "conforms" in result.sentence
    assert "2 of 136" in result.sentence


def test_events_come_in_the_documented_order(toy: Any) -> None:
    """Reporters rely on it."""
    toy.add(answers, LINE)
    toy.run(words=(LINE,))
    assert [type(event) for event in toy.events] == [
        events.RunStarted, events.Identified, events.CheckStarted, events.CheckFinished,
        events.RequirementJudged, events.RunFinished,
    ]  # fmt: skip
    assert toy.seen(events.CheckStarted)[0].total == 1


def test_a_failure_tells_admissible_actual_transcript_and_replay(toy: Any) -> None:
    """Exit 1, and all a reader needs to follow it."""
    toy.add(fails, LINE)
    result = toy.run()
    assert result.exit_status == 1
    finding = result.checks[0].findings[0]
    assert finding.expected == ("z", "Z")
    assert finding.actual == "q"
    assert [one.data or one.text for one in finding.transcript] == [
        "check fails", "asking for z", b"Q", b"q",
    ]  # fmt: skip
    assert toy.seen(events.CheckFinished)[0].replay.endswith("--seed 5 fails")


def test_a_failure_is_told_also_if_nobody_asked_about_that_requirement(toy: Any) -> None:
    """A breach seen by the way must not be hidden by the selection."""

    def twofold(session: Session) -> None:
        session.expect(True, LINE, "", "")
        session.expect(False, FRAME, "", "")

    toy.add(twofold, LINE, FRAME)
    result = toy.run(words=(LINE,))
    assert result.exit_status == 1
    assert {one.requirement.id for one in result.requirements} == {LINE, FRAME}


def test_after_each_check_that_acts_the_axis_is_stopped_and_its_memory_put_back(toy: Any) -> None:
    """Every check finds the device as the run found it."""
    toy.add(moves, MOVE, safety="motion")
    toy.add(stores, STORE, safety="stored")
    toy.run()
    assert not toy.port.is_moving
    assert toy.port.stored == "7"
    sent = toy.port.sent
    assert sent.index("R") < sent.index("M"), "remembered before anything moved"
    assert "S" in sent[sent.index("M") : sent.index("P3")]
    assert sent.count("P7") == 1, "only what differs is written again"


def test_a_passive_run_sends_no_stop_and_reads_nothing_to_put_back(toy: Any) -> None:
    """Somebody else's axis may be moving: a passive run does not touch it."""
    toy.add(answers, LINE)
    toy.add(moves, MOVE, safety="motion")
    result = toy.run(allowed=frozenset({"passive"}))
    assert set(toy.port.sent) == {"Q"}
    assert "--allow motion" in verdict_of(result, MOVE).reason
    assert result.exit_status == 0


def test_an_interrupt_stops_the_axis_and_puts_everything_back(toy: Any) -> None:
    """Ctrl-C in the middle of a motion: stopped, restored, the rest not run, exit 130."""

    def interrupted(session: Session) -> None:
        exchange(session, "P9")
        exchange(session, "M")
        raise KeyboardInterrupt

    toy.add(interrupted, MOVE, safety=("motion", "stored"))
    toy.add(stores, STORE, safety="stored")
    result = toy.run()
    assert result.exit_status == 130
    assert not toy.port.is_moving
    assert toy.port.stored == "7"
    assert not toy.port.is_open
    assert verdict_of(result, STORE).reason == "the run was interrupted"
    assert "P3" not in toy.port.sent


def test_a_check_that_is_interrupted_with_a_failure_in_hand_tells_it_and_the_run_ends(
    toy: Any,
) -> None:
    """What was found is not lost; stopped, restored, the rest not run, and the end says both."""

    def interrupted(session: Session) -> None:
        exchange(session, "P9")
        session.run.is_interrupted = True
        session.fail(MOVE, ("here",), "there")

    toy.add(interrupted, MOVE, safety=("motion", "stored"))
    toy.add(stores, STORE, safety="stored")
    result = toy.run()
    assert result.exit_status == 1
    assert verdict_of(result, MOVE).verdict is Verdict.FAIL
    assert verdict_of(result, STORE).reason == "the run was interrupted"
    assert result.sentence.endswith("requirements judged; then it was interrupted.")
    assert toy.port.stored == "7"
    assert not toy.port.is_open
    assert "P3" not in toy.port.sent


def test_a_crash_of_a_check_is_reported_and_the_others_run(toy: Any) -> None:
    """Our mistake is neither a pass nor a fail of the device: inconclusive, exit 4."""

    def crashes(session: Session) -> None:
        session.expect(True, LINE, "", "")
        exchange(session, "M")
        raise ZeroDivisionError("oops")

    toy.add(crashes, LINE, FRAME, safety="motion")
    toy.add(stores, STORE, safety="stored")
    result = toy.run()
    assert result.checks[0].outcome is Outcome.ERROR
    assert "ZeroDivisionError: oops (crashes, line" in result.checks[0].trouble
    assert not toy.port.is_moving
    for key in (LINE, FRAME):
        assert verdict_of(result, key).verdict is Verdict.INCONCLUSIVE
    assert verdict_of(result, STORE).verdict is Verdict.PASS
    assert result.exit_status == 4


@pytest.mark.parametrize("condition", ["is_mute", "is_gone"])
def test_a_device_that_does_not_answer_is_unreachable(toy: Any, condition: str) -> None:
    """Exit 3 with the reason; nothing is judged."""
    toy.add(answers, LINE)
    setattr(toy.port, condition, True)
    result = toy.run()
    assert result.exit_status == 3
    assert "unreachable" in result.sentence
    assert result.checks == []
    assert "unreachable" in verdict_of(result, LINE).reason


def test_a_device_that_answers_in_another_tongue_is_not_the_model(toy: Any) -> None:
    """Exit 3: identity comes first."""
    toy.add(answers, LINE)
    toy.port.garbage = b"\xff"[:0] + b"#"
    result = toy.run()
    assert result.exit_status == 3
    assert "not a toy" in result.sentence


def test_a_port_that_cannot_be_opened_is_unreachable(toy: Any) -> None:
    """The opener's complaint is the reason."""
    toy.add(answers, LINE)

    def refuse(neighbours: tuple[int, ...]) -> Any:
        raise TargetError("cannot open /dev/none: no such device")

    result = engine_module.Engine(toy.options(), refuse).run(toy.events.append)
    assert result.exit_status == 3
    assert "/dev/none" in result.sentence


def test_a_run_that_judged_nothing_is_no_success(toy: Any) -> None:
    """Everything left out: exit 2, and the port is not even opened."""
    toy.add(moves, MOVE, safety="motion")
    result = toy.run(allowed=frozenset({"passive"}))
    assert result.exit_status == 2
    assert "every check was left out" in result.sentence
    assert toy.opened == []


def test_an_id_that_matches_nothing_is_wrong_usage(toy: Any) -> None:
    """Before anything is opened."""
    toy.add(answers, LINE)
    with pytest.raises(UsageError, match="matches no requirement"):
        toy.run(words=("MACS-NOTHING",))
    assert toy.opened == []


@pytest.mark.parametrize("readings", [(), ("1Ah", "11h")])
def test_a_detection_that_detects_nothing_is_no_success(toy: Any, readings: Any) -> None:
    """Exit 2: neither no reading nor two of them are one."""
    toy.probe("xon_byte", lambda session: Seen(readings, "seen so"))
    result = toy.run(is_detection=True, is_only_detection=True)
    assert result.exit_status == 2
    assert result.sentence.startswith("Nothing was detected: 1 question told nothing")


def test_a_detection_without_a_question_is_no_success(toy: Any) -> None:
    """Exit 2, and nothing is opened."""
    toy.probe("xon_byte", lambda session: Seen((), ""), safety=("motion",))
    passive = frozenset({"passive"})
    result = toy.run(is_detection=True, is_only_detection=True, allowed=passive)
    assert result.exit_status == 2
    assert "every question was left out" in result.sentence
    assert toy.opened == []


@pytest.mark.parametrize(
    ("option", "needed", "told"),
    [
        ("--max-speed", 2000, "needs --max-speed 2000: held back"),
        ("--max-travel", None, "needs more --max-travel, nobody knows how much: held back"),
        ("", None, "held back"),
    ],
)
def test_what_the_fence_holds_back_is_not_run(
    toy: Any, option: str, needed: int | None, told: str
) -> None:
    """It was never sent: no error, no fail, and the reason names what would let it through."""

    def fenced(session: Session) -> None:
        session.expect(True, LINE, "", "")
        raise OutsideEnvelope("held back M", option, needed)

    toy.add(fenced, LINE, FRAME)
    toy.add(answers, STORE)
    result = toy.run()
    assert result.exit_status == 0
    assert result.checks[0].outcome is Outcome.LEFT_OUT
    for key in (LINE, FRAME):
        assert verdict_of(result, key).verdict is Verdict.NOT_RUN
        assert verdict_of(result, key).reason.startswith(told)


def test_what_a_probe_may_not_send_leaves_its_switch_unknown(toy: Any) -> None:
    """The others are asked."""

    def fenced(session: Session) -> Seen:
        raise OutsideEnvelope("held back M", "--max-travel", 7)

    toy.probe("xon_byte", fenced)
    toy.probe("zero_period_0d", lambda session: Seen(("refuse",), "asked"))
    result = toy.run(is_detection=True, is_only_detection=True)
    assert result.exit_status == 0
    assert result.detections["xon_byte"].evidence == "needs --max-travel 7: held back M"
    assert dict(result.readings) == {"zero_period_0d": "refuse"}


def test_a_passive_check_runs_though_nothing_can_be_remembered_for_a_probe(toy: Any) -> None:
    """Probes that change something are left out with the reason; the others are asked."""

    def unreadable(session: Session) -> Any:
        raise TargetError("no answer to 22h")

    toy.family = vary(toy.family, remember=unreadable)
    toy.probe("xon_byte", lambda session: Seen(("11h",), "asked"))
    toy.probe("zero_period_0d", lambda session: Seen(("refuse",), "asked"), safety=("stored",))
    toy.add(answers, LINE)
    toy.add(stores, STORE, safety="stored")
    result = toy.run()
    assert dict(result.readings) == {"xon_byte": "11h"}
    assert "no answer to 22h" in result.detections["zero_period_0d"].evidence
    assert verdict_of(result, LINE).verdict is Verdict.PASS
    assert result.exit_status == 4


def test_the_eeprom_writes_are_told_at_the_end(toy: Any) -> None:
    """With what was put back, and how many there might have been."""
    toy.family = vary(toy.family, stored_writes=lambda data: data[:1] == b"P")
    toy.add(stores, STORE, safety="stored")
    toy.run(eeprom_budget=9)
    [finished] = toy.seen(events.RunFinished)
    assert (finished.eeprom_writes, finished.eeprom_budget) == (2, 9)


def test_a_value_recorded_is_no_judgement(toy: Any) -> None:
    """Only informed, nothing judged: exit 2."""

    def informs(session: Session) -> None:
        session.info(LINE, "the answer took 1 ms")

    toy.add(informs, LINE)
    result = toy.run()
    assert verdict_of(result, LINE).verdict is Verdict.INFO
    assert result.exit_status == 2


def test_a_check_that_never_judges_what_it_names_is_not_a_pass(toy: Any) -> None:
    """Not run, with that reason."""

    def idles(session: Session) -> None:
        session.expect(True, LINE, "", "")

    toy.add(idles, LINE, FRAME)
    result = toy.run()
    assert verdict_of(result, FRAME).verdict is Verdict.NOT_RUN
    assert "without judging" in verdict_of(result, FRAME).reason


def loses_the_device(toy: Any, session: Session) -> None:
    """Ends in a failure after which the device is mute."""
    toy.port.is_mute = True
    answer = exchange(session, "Q")
    session.expect(answer == "q", None, "q", answer or "silence")


def test_a_device_lost_in_the_middle_blocks_the_rest(real_toy: Any) -> None:
    """What the last check said is withdrawn, the rest is inconclusive, exit 4."""

    def loses(session: Session) -> None:
        loses_the_device(real_toy, session)

    real_toy.add(answers, LINE)
    real_toy.add(loses, FRAME)
    real_toy.add(moves, MOVE, safety="motion")
    result = real_toy.run()
    assert [one.outcome for one in result.checks] == [
        Outcome.DONE, Outcome.TROUBLE, Outcome.BLOCKED,
    ]  # fmt: skip
    assert verdict_of(result, LINE).verdict is Verdict.PASS
    assert verdict_of(result, FRAME).verdict is Verdict.INCONCLUSIVE
    assert verdict_of(result, FRAME).reason.startswith("Fail, but the device no longer answers")
    assert "not started" in verdict_of(result, MOVE).reason
    assert result.exit_status == 4


def test_in_virtual_time_a_device_that_falls_silent_has_failed(toy: Any) -> None:
    """Nothing gets lost by itself there: the failure stands, the rest is blocked."""

    def loses(session: Session) -> None:
        loses_the_device(toy, session)

    toy.add(loses, FRAME)
    toy.add(moves, MOVE, safety="motion")
    result = toy.run()
    assert verdict_of(result, FRAME).verdict is Verdict.FAIL
    assert verdict_of(result, MOVE).verdict is Verdict.INCONCLUSIVE
    assert result.exit_status == 1


def test_a_port_that_vanishes_becomes_verdicts(toy: Any) -> None:
    """An unplugged adapter: no traceback, inconclusive, exit 4."""

    def unplugged(session: Session) -> None:
        toy.port.is_gone = True
        exchange(session, "Q")

    toy.add(moves, MOVE, safety="motion")
    toy.add(unplugged, STORE, safety="stored")
    toy.add(answers, LINE, safety="destructive")
    result = toy.run()
    assert verdict_of(result, STORE).verdict is Verdict.INCONCLUSIVE
    assert verdict_of(result, LINE).verdict is Verdict.INCONCLUSIVE
    assert any("could not stop" in problem for problem in result.problems)
    assert result.exit_status == 4


def test_a_deaf_device_is_waited_for(toy: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module that re-initialises is silent for 2 s and is not lost."""
    monkeypatch.setattr(device_guard, "SANITY_PAUSES_S", (0.0, 1.0, 1.5))
    original = toy.port.pass_time

    def pass_time(duration_ns: int) -> None:
        original(duration_ns)
        toy.port.is_mute = until_ns > toy.port.virtual_time_ns

    until_ns = 0
    toy.port.pass_time = pass_time

    def restarts(session: Session) -> None:
        nonlocal until_ns
        session.expect(exchange(session, "Q") == "q", None, "", "")
        until_ns = session.target.now_ns + 2_000_000_000
        toy.port.is_mute = True

    toy.add(restarts, LINE)
    toy.add(moves, MOVE, safety="motion")
    assert toy.run().exit_status == 0


def test_a_device_that_restarts_while_it_is_put_back_is_put_back_again(toy: Any) -> None:
    """It is deaf then, and not lost."""
    restore, deaf = toy.family.restore, [True]

    def restarts(session: Session, memory: Any) -> tuple[str, ...]:
        if deaf:
            deaf.pop()
            raise TargetError("expected an answer, got silence")
        told: tuple[str, ...] = restore(session, memory)
        return told

    toy.family = vary(toy.family, restore=restarts)
    toy.add(stores, STORE, safety="stored")
    toy.add(moves, MOVE, safety="motion")
    result = toy.run()
    assert not deaf
    assert (result.exit_status, result.problems) == (0, [])


def test_without_a_memory_nothing_but_passive_runs(toy: Any) -> None:
    """What cannot be read cannot be put back."""

    def unreadable(session: Session) -> Any:
        raise TargetError("no answer to 22h")

    toy.family = vary(toy.family, remember=unreadable)
    toy.add(answers, LINE)
    toy.add(moves, MOVE, safety="motion")
    result = toy.run()
    assert "M" not in toy.port.sent
    assert verdict_of(result, LINE).verdict is Verdict.PASS
    assert "22h" in verdict_of(result, MOVE).reason


def test_what_could_not_be_put_back_is_a_problem_of_the_run(toy: Any) -> None:
    """It is named, and the run does not end as a success."""
    toy.family = vary(toy.family, restore=lambda session, memory: ("the stored digit 7",))
    toy.add(moves, MOVE, safety="motion")
    toy.add(answers, LINE)
    result = toy.run()
    assert result.problems.count("not put back: the stored digit 7") == 1  # not once per check
    assert result.exit_status == 4


def test_a_mistake_in_putting_back_is_reported_and_still_closes_the_port(toy: Any) -> None:
    """The way out is taken whatever happens on it."""

    def broken(session: Session, memory: Any) -> tuple[str, ...]:
        raise ZeroDivisionError("oops")

    toy.family = vary(toy.family, restore=broken)
    toy.add(moves, MOVE, safety="motion")
    toy.add(stores, STORE, safety="stored")
    result = toy.run()
    assert verdict_of(result, MOVE).verdict is Verdict.PASS
    assert "ZeroDivisionError" in verdict_of(result, STORE).reason
    assert any("ZeroDivisionError" in problem for problem in result.problems)
    assert not toy.port.is_moving
    assert not toy.port.is_open
    assert result.exit_status == 4


def test_a_frame_that_the_family_guards_against_is_never_sent(toy: Any) -> None:
    """A check that would leave its class or the envelope is our mistake, caught before the wire."""
    toy.family = vary(
        toy.family, forbid=lambda session, data: "it would move" if data == b"M" else None
    )
    toy.add(moves, MOVE)
    result = toy.run()
    assert "M" not in toy.port.sent
    assert result.checks[0].outcome is Outcome.ERROR
    assert "it would move" in result.checks[0].trouble


def test_a_check_that_must_be_alone_gets_a_line_of_its_own(toy: Any) -> None:
    """On the built-in twin only; the other line stays as it is."""
    seen = []

    def alone(session: Session) -> None:
        seen.append(session.neighbours)
        session.expect(True, None, "", "")

    toy.add(alone, LINE, needs=("alone",))
    toy.add(answers, FRAME)
    assert toy.run().exit_status == 0
    assert seen == [()]
    assert toy.opened == [(1,), ()]


def test_a_twin_that_meddles_with_its_neighbours_is_judged_alone(toy: Any) -> None:
    """Only checks that need the neighbours have them, once a reading of the twin is a nuisance."""
    seen = []

    def anywhere(session: Session) -> None:
        seen.append(("anywhere", session.neighbours))
        session.expect(True, None, "", "")

    def together(session: Session) -> None:
        seen.append(("together", session.neighbours))
        session.expect(True, None, "", "")

    toy.family = vary(toy.family, disturbs=lambda readings: True)
    toy.add(anywhere, LINE)
    toy.add(together, FRAME, needs=("neighbour",))
    assert toy.run().exit_status == 0
    assert seen == [("anywhere", ()), ("together", (1,))]


def test_a_partial_pass_says_what_was_left_out(toy: Any) -> None:
    """A requirement half judged is a pass with a remark."""
    toy.add(answers, LINE)
    toy.add(moves, LINE, safety="motion")
    one = verdict_of(toy.run(allowed=frozenset({"passive"})), LINE)
    assert one.verdict is Verdict.PASS
    assert "1 of 2 checks not run: not allowed: motion" in one.reason
    assert one.checks == ("answers", "moves")


def test_a_neighbour_that_is_not_there_is_named_and_not_the_device(toy: Any) -> None:
    """Its silence, which the line is given up for, is not the silence of what is to be judged."""
    toy.add(answers, FRAME)
    is_alive = toy.family.is_alive

    def gives_up(session: Session) -> bool:
        if session.address == 2:
            raise TargetError("nothing has come for 5 s")
        return bool(is_alive(session))

    toy.family = vary(toy.family, is_alive=gives_up)
    result = toy.run(endpoint="toy://there", neighbours=(2,))
    assert result.exit_status == 3
    assert "nobody answers at 2, which --neighbour names; leave that out" in result.refusal
