"""What a check is handed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from axistwin_conformance.base.check import check
from axistwin_conformance.base.errors import TargetError
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.base.verdicts import Finding, Verdict, merge
from axistwin_conformance.core.profile import Detection
from axistwin_conformance.core.session import Run, Session, Stop
from axistwin_conformance.core.travel import MOTIONS_KEPT

LINE, FRAME = "MACS-LINE-01", "MACS-FRAME-01"


def sample(session: Session) -> None:
    """It behaves."""


def make_run(toy: Any) -> Run:
    """A run on the toy."""
    options = toy.options()
    return Run(
        target=toy.open(()),
        family=toy.family,
        model=toy.family.models["toy"],
        ledger=load_ledger("mac_serial"),
        address=0,
        neighbours=(),
        allowed=options.allowed,
        envelope=options.settings.envelope,
        seed=5,
    )


@pytest.fixture
def session(toy: Any) -> Session:
    """The session of a check that names two requirements."""
    return Session(make_run(toy), check(LINE, FRAME)(sample))


def verdicts(findings: tuple[Finding, ...]) -> dict[str, Verdict]:
    """Requirement → verdict."""
    names = {one.requirement for one in findings}
    return {name: merge(f.verdict for f in findings if f.requirement == name) for name in names}


def test_a_judgement_that_holds_is_counted(session: Session) -> None:
    """Each named requirement passes by what was judged of it."""
    session.expect(True, LINE, "a", "a")
    session.expect(True, (LINE, FRAME), "b", "b")
    findings = session.conclude("")
    assert verdicts(findings) == {LINE: Verdict.PASS, FRAME: Verdict.PASS}
    assert findings[0].text == "2 judgements held"


def test_a_check_of_several_requirements_says_which_one_it_judges(session: Session) -> None:
    """What proves one of them must not be counted for the others."""
    with pytest.raises(TypeError, match="several requirements: say which is judged"):
        session.expect(True, None, "a", "a")
    with pytest.raises(TypeError, match="several requirements: say which is judged"):
        session.quirk(None, "xon_byte", "11h")


def test_a_step_that_works_proves_nothing(session: Session) -> None:
    """One that fails leaves all that the check names unmet."""
    session.step(True, "a", "a")
    assert verdicts(session.conclude("")) == {LINE: Verdict.NOT_RUN, FRAME: Verdict.NOT_RUN}
    with pytest.raises(Stop):
        session.step(False, "a", "b")
    assert verdicts(session.conclude("")) == {LINE: Verdict.FAIL, FRAME: Verdict.FAIL}


def test_a_judgement_that_does_not_hold_ends_the_check(session: Session) -> None:
    """What came before stands, what was to come is not run."""
    session.expect(True, LINE, "a", "a")
    with pytest.raises(Stop):
        session.expect(False, FRAME, ("a", "b"), 7)
    assert verdicts(session.conclude("")) == {LINE: Verdict.PASS, FRAME: Verdict.FAIL}
    assert session.findings[0].expected == ("a", "b")
    assert session.findings[0].actual == "7"


def test_after_trouble_nothing_counts_as_passed(session: Session) -> None:
    """The judgements still to come might have failed."""
    session.expect(True, LINE, "a", "a")
    assert set(verdicts(session.conclude("port gone")).values()) == {Verdict.INCONCLUSIVE}


def test_judging_what_was_not_declared_is_our_mistake(session: Session) -> None:
    """The plan would not have known."""
    with pytest.raises(ValueError, match="sample judges MACS-LINE-02"):
        session.expect(True, "MACS-LINE-02", "", "")


def test_the_default_reading_passes_and_another_one_is_a_quirk(session: Session) -> None:
    """Both are admissible; the other one is named."""
    session.quirk(LINE, "xon_byte", "1Ah")
    session.quirk(FRAME, "preload_policy", "keep")
    assert verdicts(session.conclude("")) == {LINE: Verdict.PASS, FRAME: Verdict.QUIRK}
    assert "preload_policy=keep (MACS-AMB-36" in session.findings[0].text


def test_two_readings_in_one_run_fail(toy: Any) -> None:
    """A device has to stay with its reading, over all checks of a run."""
    run = make_run(toy)
    Session(run, check(LINE)(sample)).quirk(LINE, "xon_byte", "11h")
    later = Session(run, check(FRAME)(sample))
    with pytest.raises(Stop):
        later.quirk(FRAME, "xon_byte", "1Ah")
    assert later.findings[0].verdict is Verdict.FAIL
    assert "xon_byte=11h" in later.findings[0].expected[0]


@pytest.mark.parametrize("is_known", [True, False])
def test_a_second_reading_is_told_with_the_exchange_that_showed_the_first(
    toy: Any, is_known: bool
) -> None:
    """And with the rule; where two readings explain the first exchange, it shows neither."""
    run = make_run(toy)
    asked = Record(7, Direction.HOST, b"Q")
    run.shown["xon_byte"] = (asked,)
    if is_known:
        run.readings["xon_byte"] = "11h"
    else:
        run.detections["xon_byte"] = Detection("xon_byte", None, "open", ("11h", "13h"))
    later = Session(run, check(LINE)(sample))
    later.target.send(b"R")
    with pytest.raises(Stop):
        later.quirk(LINE, "xon_byte", "1Ah")
    [found] = later.conclude("")
    assert found.sentence.endswith("; expected the same each time.")
    assert found.rule.startswith("The manual leaves this open (MACS-AMB-01: ")
    texts = [record.text for record in found.transcript]
    assert (asked in found.transcript) is is_known
    assert ("in this check:" in texts) is is_known


def test_a_reading_against_a_firm_requirement_is_named_as_such(session: Session) -> None:
    """Real units may differ from what a manual states; the report says from what."""
    session.quirk(LINE, "stop17_in_interp", "now")
    assert "against MACS-CMD-17-02" in session.findings[0].text


@pytest.mark.parametrize(("switch", "reading"), [("mood", "good"), ("xon_byte", "12h")])
def test_an_unknown_switch_or_reading_is_our_mistake(
    session: Session, switch: str, reading: str
) -> None:
    """Never a verdict."""
    with pytest.raises(ValueError, match=switch):
        session.quirk(LINE, switch, reading)


def test_randomness_depends_on_seed_and_name_alone(toy: Any) -> None:
    """A check replayed alone draws what it drew in the whole run."""
    run = make_run(toy)
    one = check(LINE)(sample)
    draws = [Session(run, one).random.random() for _ in range(2)]
    assert draws[0] == draws[1]
    assert Session(run, replace(one, name="other")).random.random() != draws[0]
    run.seed = 6
    assert Session(run, one).random.random() != draws[0]


def test_outside_a_check_a_judgement_becomes_trouble(toy: Any) -> None:
    """The family's hooks use the same words; there is nobody to judge there."""
    hook = Session(make_run(toy))
    hook.expect(True, None, "a", "a")
    with pytest.raises(TargetError, match="expected a, got b"):
        hook.expect(False, None, "a", "b")


# Asking again.


class Flaky:
    """Makes the toy's answers bad as a list says, then good."""

    def __init__(self, toy: Any, answers: list[bytes]) -> None:
        self.toy, self.answers = toy, answers
        self.write = toy.port.write
        toy.port.write = self

    def __call__(self, data: bytes) -> int:
        """Spoil or leave the answer to one request."""
        spoilt = self.answers.pop(0) if self.answers else None
        self.toy.port.garbage = spoilt or b""
        self.toy.port.is_mute = spoilt == b""
        return int(self.write(data))


@pytest.fixture
def noisy(real_toy: Any) -> Session:
    """A session on a port without virtual time."""
    return Session(make_run(real_toy), check(LINE)(sample))


def ask(session: Session) -> bytes:
    """A query of the toy."""
    bad: list[bytes] = []
    for _ in range(RETRY.exchange):
        session.target.drain()
        session.target.send(b"Q")
        reply = session.target.receive(1, 0.0)
        if session.is_believed(bad, reply, is_good=reply == b"q"):
            return reply
        session.record_retry("asked again")
    return session.inconclusive(None, "differing replies: noise on the line")


def test_a_query_is_asked_again_until_the_answer_is_good(real_toy: Any, noisy: Session) -> None:
    """Noise is overcome below the checks, and recorded."""
    Flaky(real_toy, [b"#", b"", b"%"])
    assert ask(noisy) == b"q"
    assert len(noisy.retries) == 3
    assert noisy.findings == []


def test_the_same_bad_reply_every_time_is_the_device_s_own(real_toy: Any, noisy: Session) -> None:
    """The check gets it to judge."""
    Flaky(real_toy, [b"#"] * 100)
    assert ask(noisy) == b"#"


@pytest.mark.strength
def test_a_line_that_will_not_settle_is_inconclusive(real_toy: Any, noisy: Session) -> None:
    """Different garbage every time proves nothing about the device."""
    Flaky(real_toy, [b"#", b"%"] * RETRY.exchange)
    with pytest.raises(Stop):
        ask(noisy)
    assert noisy.findings[0].verdict is Verdict.INCONCLUSIVE


def test_in_virtual_time_nothing_is_asked_twice(toy: Any, session: Session) -> None:
    """There is no noise: what came is what the device said."""
    Flaky(toy, [b"#"])
    assert ask(session) == b"#"
    assert session.retries == []


def test_motions_are_kept_by_name_the_first_ones_and_the_last(session: Session) -> None:
    """Samples under one name are one motion; what failed last is never pushed out."""
    for number in range(MOTIONS_KEPT + 3):
        session.motions.sample(f"move {number}", [(1, 10)], [(0, 0, 1), (1, 9, 11)])
        session.motions.sample(f"move {number}", [(2, 20)])
    names = [one.name for one in session.motions.kept]
    assert session.motions.count == MOTIONS_KEPT + 3
    assert names == [*(f"move {n}" for n in range(MOTIONS_KEPT - 1)), f"move {MOTIONS_KEPT + 2}"]
    assert session.motions.kept[-1].measured == ((1, 10), (2, 20))
    assert session.motions.kept[-1].predicted == ((0, 0, 1), (1, 9, 11))
