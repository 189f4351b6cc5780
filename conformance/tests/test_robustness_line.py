"""On a real pty: peers that are no module, or stop being one.  A clear verdict soon, no traceback.

Waiting is bounded by a hard limit with much to spare, so that a busy machine makes nothing red; how
soon it is to the device's own clock is judged in virtual time, in `test_robustness`.
"""

from __future__ import annotations

import random
import time
from dataclasses import replace

import pytest
from family_variants import vary
from scripted_peer import Answers, Moment, Peer, after, at, behind

from axistwin_conformance.base import line_quality
from axistwin_conformance.base.events import Outcome
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine

pytestmark = pytest.mark.strength

SHORT_S = 1.0  # patience of most of these tests
LONGEST_S = 400.0  # from the moment of the change to the end of the run: a tenth when idle
NEVER = after(1_000_000)
PASSIVE, MOVING = ("MACS-LINE-02",), ("MACS-LINE-02", "MACS-CMD-13-01")


def random_bytes() -> Answers:
    """Other garbage each time."""
    chance = random.Random(1)
    return lambda data: chance.randbytes(chance.randrange(1, 30))


ANSWERS: dict[str, Answers | None] = {
    "silence": lambda data: b"",
    "echo": lambda data: data,
    "a banner": lambda data: b"ERR 1: unknown command\r\n",
    "a binary protocol": lambda data: b"\xa5\x5a\x80\x00\x01",
    "garbage": random_bytes(),
    "hangs up": None,
}


def judge(peer: Peer, ids: tuple[str, ...] = MOVING, *, detects: bool = False) -> Result:
    """Judge a peer; whatever it does, the run ends soon and in one line."""
    with peer.running():
        options = make_options(
            model="mac23", port=peer.name, ids=ids, allow="motion,stored", level="quick"
        )
        if not detects:
            options = replace(options, family=vary(options.family, probe_modules=()))
        result = Engine(options).run(lambda event: None)
        ended_at = time.monotonic()
    if peer.turned_at is not None:
        assert ended_at - peer.turned_at < LONGEST_S, result.sentence
    assert "\n" not in result.sentence
    assert [one.trouble for one in result.checks if one.outcome is Outcome.ERROR] == []
    assert "error in the suite" not in " ".join([*result.problems, result.refusal])
    return result


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_quality, "SILENCE_LIMIT_S", SHORT_S)


@pytest.mark.parametrize("name", ANSWERS)
@pytest.mark.parametrize("moment", [after(0), after(4)], ids=["at once", "after four"])
def test_who_is_no_module_is_unreachable(name: str, moment: Moment) -> None:
    """Exit 3, and nothing is judged."""
    result = judge(Peer(moment, ANSWERS[name]), PASSIVE)
    assert result.exit_status == 3
    assert result.sentence.startswith("Not judged: device unreachable: ")
    assert result.checks == []


MOMENTS = {"as it is to move": at(0x13), "in a motion": behind(0x13), "while put back": at(0x18)}


@pytest.mark.parametrize(
    ("name", "moment"),
    [
        ("silence", "in a motion"),
        ("garbage", "in a motion"),
        ("a banner", "in a motion"),
        ("hangs up", "in a motion"),
        ("echo", "as it is to move"),
        ("silence", "while put back"),
        ("a binary protocol", "while put back"),
    ],
)
def test_who_is_lost_in_a_check_is_neither_failed_nor_passed(name: str, moment: str) -> None:
    """Exit 4; the sentence says after which check, what was judged before stands."""
    result = judge(Peer(MOMENTS[moment], ANSWERS[name]))
    assert result.exit_status == 4
    assert "No verdict on mac23: the device no longer answers after " in result.sentence
    assert "nothing failed before, 1 of 2 requirements judged" in result.sentence
    told = {one.requirement.id: one.verdict for one in result.requirements}
    assert told == {"MACS-LINE-02": Verdict.PASS, "MACS-CMD-13-01": Verdict.INCONCLUSIVE}
    assert any("could not stop the axis" in one for one in result.problems)


@pytest.mark.parametrize("name", ["silence", "garbage", "hangs up"])
def test_who_is_lost_in_detection_is_told_so(name: str) -> None:
    """Exit 3: nothing was judged yet."""
    result = judge(Peer(after(60), ANSWERS[name]), detects=True)
    assert result.exit_status == 3
    assert result.sentence.startswith("Not judged: device lost before anything was judged: ")


def test_a_silent_device_is_given_up_within_half_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the patience that users get, to the end of the run."""
    monkeypatch.undo()
    assert judge(Peer(behind(0x13), ANSWERS["silence"])).exit_status == 4


@pytest.mark.parametrize("flood", [b"\x55" * 4096, b"\x06\x13\x1a" * 1000])
@pytest.mark.parametrize("moment", [after(0), behind(0x13)], ids=["at once", "in a motion"])
def test_who_never_stops_talking_is_given_up_too(flood: bytes, moment: Moment) -> None:
    """Neither waited for without end, nor believed."""
    result = judge(Peer(moment, ANSWERS["silence"], floods=flood))
    assert result.exit_status in (3, 4)
    assert Verdict.FAIL not in {one.verdict for one in result.requirements}


def test_another_model_of_the_family_is_not_the_one_named() -> None:
    """Exit 3: identity comes first."""
    result = judge(Peer(NEVER, None, model="mac34-1"), PASSIVE)
    assert result.exit_status == 3
    assert "not a mac23" in result.sentence


def test_bytes_that_come_late_are_waited_for() -> None:
    """Slow is not wrong: no reply time is specified (MACS-REPLY-16)."""
    assert judge(Peer(NEVER, None, spacing_s=0.01), PASSIVE).exit_status == 0


def test_garbage_now_and_then_is_noise() -> None:
    """One reply in ten is replaced: asked again, and never a fail."""
    chance = random.Random(2)
    peer = Peer(NEVER, None, spoils=lambda data: b"\x99" if chance.random() < 0.1 else data)
    assert judge(peer, PASSIVE).exit_status in (0, 4)
    assert peer.spoilt > 0
