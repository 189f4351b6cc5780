"""A controller that works a machine, seen from outside: everything a run sends to what it takes for
a real port, and what the controller holds afterwards.

Runs are in virtual time.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import pytest
from msc_twin import TwinPort, check_of, session_on
from msc_watch import FLAGS, VARIABLES, MscWatch, run_on_a_port
from small_scratch import PROGRAM
from test_safety import signalled
from trouble import Trouble, interrupt, meet, moments_of

from axistwin_conformance.base.events import Outcome
from axistwin_conformance.engine.result import Result
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.family import FAMILY
from axistwin_conformance.families.msc.safety import is_harmless

pytestmark = pytest.mark.strength

SOAK = pytest.mark.soak
DRAWING = ("MSC-PROP", "MSC-PKT", "MSC-LNK")
PROGRAM_FLAGS = range(PROGRAM[0], PROGRAM[0] + 4)
PROGRAM_BLOCK = PROGRAM[1] + 128
READS = (b"BREAD", b"DREAD", b"RFLAG", b"RFLAGS", b"RQSTAT")  # in any spelling


def judge_sent(result: Result, watches: list[MscWatch], allow: str) -> None:
    """Nothing was written that the operator has not named, and all of that is back."""
    assert result.problems == []
    crashed = [one.trouble for one in result.checks if one.outcome is not Outcome.DONE]
    assert crashed == [], "the checks know what they may send; the guard had nothing to do"
    has_program = "motion" in allow
    for watch in watches:
        for name, number in watch.writes():
            if name in ("SFLAG", "CFLAG"):
                assert number in FLAGS or (has_program and number in PROGRAM_FLAGS), (name, number)
            elif name == "DWRITE":
                assert number in VARIABLES, (name, number)
            else:
                is_program = has_program and number == PROGRAM_BLOCK
                assert is_program or {number, number + 31 * 4} <= set(VARIABLES), (name, number)
        strangers = watch.strangers()
        assert strangers == set() or "rig" in allow, strangers
        impossible = {name for name in strangers if name.strip(b" Z") in (*READS, b"")}
        known = impossible | {name for name in strangers if name.upper() in READS}
        assert strangers == known, strangers
        assert watch.held() == watch.before, "variables and flags are as they were"


# --- everything that is sent ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("allow", "level", "seed"),
    [
        ("passive", "quick", 0),
        ("stored", "quick", 1),
        ("stored,motion", "full", 2),
        ("stored,motion,rig", "full", 3),
        *(pytest.param("stored,motion,rig", "full", seed, marks=SOAK) for seed in range(4, 20)),
    ],
)
def test_nothing_is_written_but_what_the_operator_has_named(
    allow: str, level: str, seed: int
) -> None:
    """Whatever is allowed: writes inside --variables and --flags, no name that is a guess."""
    result, watches = run_on_a_port(allow=allow, level=level, seed=seed)
    judge_sent(result, watches, allow)
    wrote = [one for watch in watches for one in watch.writes()]
    assert bool(wrote) is (allow != "passive")


def test_a_model_without_rflags_is_not_asked_for_them_on_a_machine() -> None:
    """To it that would be an unknown name."""
    result, watches = run_on_a_port("MSC-RQSTAT", "MSC-MOD", allow="passive", model="msc-generic")
    judge_sent(result, watches, "passive")
    assert not any(b"RFLAGS" in one for watch in watches for one in watch.sent)


def test_drawn_operations_differ_from_seed_to_seed() -> None:
    """Twenty seeds are twenty lists, or the runs above would show one thing twenty times."""
    seen = set()
    for seed in range(3):
        _, (watch, *_) = run_on_a_port(
            "many_mixed_sequences_agree_with_the_model", seed=seed, level="full"
        )
        seen.add(b"".join(watch.sent))
    assert len(seen) == 3


# --- interrupts -----------------------------------------------------------------------------------


def judge_interrupted(result: Result, watches: list[MscWatch], met: MscWatch, sent: int) -> None:
    """Put back, 130; no trouble told."""
    assert result.is_interrupted
    assert result.exit_status == 130
    assert result.problems == []
    for watch in watches:
        assert watch.held() == watch.before


def test_an_interrupt_at_any_moment_leaves_variables_and_flags_as_they_were() -> None:
    """Thirty random moments of what writes."""

    def writing(at_call: Callable[[Any], None]) -> tuple[Result, list[MscWatch]]:
        return run_on_a_port("MSC-PROP-09", "MSC-PROP-10", "MSC-BWRITE", at_call=at_call)

    meet(Trouble(moments_of(30, writing, seed=3), interrupt, judge_interrupted), writing)


@SOAK
def test_an_interrupt_at_a_hundred_and_fifty_random_moments() -> None:
    """All over a run of everything."""
    full = partial(_everything, "stored,motion,rig")
    meet(Trouble(moments_of(150, full, seed=1), interrupt, judge_interrupted), full)


def _everything(allow: str, at_call: Callable[[Any], None]) -> tuple[Result, list[MscWatch]]:
    return run_on_a_port(allow=allow, at_call=at_call)


@pytest.mark.parametrize(
    ("number", "moment"),
    [(signal.SIGINT, (3, 1.2)), pytest.param(signal.SIGTERM, (9, 0.7), marks=SOAK)],
)
def test_a_signal_ends_a_run_on_a_real_pty_with_everything_put_back(
    axistwin: Callable[..., Any], number: int, moment: tuple[int, float]
) -> None:
    """Told, 130, no traceback, and every variable and flag as it was."""
    twin = axistwin("msc-250", program="bench", pacing=False)
    for address in VARIABLES[::4]:
        twin.variables[address] = address * 7919
    before = _held(twin)
    words = (
        "msc-250", "--allow", "stored", "--level", "quick", "--variables",
        f"{VARIABLES[0]}-{VARIABLES[-1]}", "--flags", f"{FLAGS[0]}-{FLAGS[-1]}",
        "MSC-DWRITE", "MSC-SFLAG",
    )  # fmt: skip
    ended = signalled(twin.port, number, moment, 2, words)
    assert ended.status == 130, ended.errors
    assert "Traceback" not in ended.errors
    assert ended.last["event"] == "run_finished"
    assert ended.last["problems"] == []
    assert _held(twin) == before


def _held(twin: Any) -> tuple[list[int], list[bool]]:
    return [twin.variables[at] for at in VARIABLES[::4]], [twin.flags[one] for one in FLAGS]


# --- the guard ------------------------------------------------------------------------------------


def refusal(data: bytes, *safety: str, needs: tuple[str, ...] = ()) -> str | None:
    """Why a check of these classes may not send that to a real controller."""
    session = session_on(TwinPort(), check_of(*safety, needs=needs))
    return FAMILY.forbid(session, data)


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (codec.dwrite(1024, 1), "DWRITE is stored"),
        (codec.sflag(130), "SFLAG is stored"),
        (codec.body("ZZZZZZ"), "the name 'ZZZZZZ' needs a check of class rig"),
        (codec.body("rqstat"), "the name 'rqstat' needs"),
        (b"RQSTAT", "the name 'RQSTAT' needs"),
        (codec.RQSTAT + b"x", "RQSTAT with 1 bytes behind its comma"),
        (codec.dread(1025), "the odd address 1025"),
        (codec.rflag(256), "flag 256"),
    ],
)
def test_a_passive_check_sends_reads_and_nothing_else(body: bytes, why: str) -> None:
    """Names, sizes, addresses and flags that no reading of the manual has are held back."""
    told = refusal(codec.packet(1, body), "passive")
    assert told is not None
    assert why in told


@pytest.mark.parametrize(
    ("body", "is_allowed"),
    [
        (codec.dwrite(1024, 1), True),
        (codec.dwrite(5116, 1), True),
        (codec.dwrite(1020, 1), False),
        (codec.dwrite(5120, 1), False),
        (codec.bwrite(4992, range(32)), True),
        (codec.bwrite(5000, range(32)), False),
        (codec.sflag(191), True),
        (codec.cflag(192), False),
        (codec.sflag(240), False),
    ],
)
def test_what_is_written_lies_inside_what_was_named(body: bytes, is_allowed: bool) -> None:
    """A block with all its 32 values, whatever the distance of neighbours is."""
    for raw in (codec.packet(1, body), codec.with_wrong_checksum(codec.packet(2, body))):
        assert (refusal(raw, "stored") is None) is is_allowed


def test_the_bench_program_is_for_checks_that_need_it() -> None:
    """Its four flags and its block, and no other flag."""
    for body in (codec.sflag(240), codec.cflag(243), codec.bwrite(6272, range(32))):
        assert refusal(codec.packet(1, body), "motion") is not None
        assert refusal(codec.packet(1, body), "motion", needs=("program",)) is None
    assert refusal(codec.packet(1, codec.sflag(244)), "motion", needs=("program",)) is not None


@pytest.mark.parametrize("places", [(3,), (7,), (12,), (14,), (3, 7, 12, 14, 15)])
def test_a_write_in_pieces_is_held_back_before_it_is_whole(places: tuple[int, ...]) -> None:
    """Wherever it is cut."""
    raw = codec.packet(1, codec.dwrite(64, 1))
    session = session_on(TwinPort(), check_of("stored"))
    edges = (0, *places, len(raw))
    told = [FAMILY.forbid(session, raw[a:b]) for a, b in pairwise(edges)]
    assert any(told)


def test_a_write_inside_the_values_of_a_block_is_seen() -> None:
    """A device that loses its place would carry it out."""
    inner = codec.packet(1, codec.sflag(3))
    values = [int.from_bytes(inner[at : at + 4], "big") for at in range(0, 16, 4)]
    raw = codec.packet(2, codec.bwrite(1024, [*values, *range(28)]))
    assert refusal(raw, "stored") == "SFLAG 3: not a flag named by --flags"


@pytest.mark.parametrize(
    ("body", "is_allowed"),
    [
        (codec.body("ZZZZZZ"), True),
        (codec.body("rqstat"), True),
        (codec.body("RQSTATZ"), True),
        (codec.body(" RFLAG "), True),
        (codec.dread(1025), True),
        (codec.body("LOAD"), False),
        (codec.body("LOADZ"), False),
        (codec.body("RQSTAX"), False),
        (codec.body("SFLAGZ"), False),
        (codec.dwrite(64, 1), False),
    ],
)
def test_on_a_bench_a_real_controller_is_sent_no_guesses_either(
    body: bytes, is_allowed: bool
) -> None:
    """Loaders listen on the same port, under names that nobody has documented."""
    told = refusal(codec.packet(1, body), "rig", needs=("bench",))
    assert (told is None) is is_allowed


@pytest.mark.parametrize(
    ("body", "is_allowed"),
    [
        (codec.bwrite(1024, range(31)), True),
        (codec.bwrite(1024, range(33)), True),
        (codec.bwrite(4992, range(33)), False),
        (codec.dwrite(1024, 1)[:-4], True),
        (codec.dwrite(5116, 1) + bytes(4), False),
        (codec.dwrite(1020, 1)[:-1], False),
        (codec.sflag(130) + b"\0", True),
        (codec.cflag(192) + b"\0", False),
        (codec.sflag(130)[:-1], False),
        (codec.body("DWRITEZ", b"\x04\0"), False),
    ],
)
def test_a_write_of_a_wrong_size_goes_to_named_places_on_a_bench(
    body: bytes, is_allowed: bool
) -> None:
    """With all that its values may reach, in a check of class negative."""
    raw = codec.packet(1, body)
    told = refusal(raw, "stored", "negative", "rig", needs=("bench",))
    assert (told is None) is is_allowed, told
    assert refusal(raw, "stored", "rig", needs=("bench",)) is not None
    assert refusal(raw, "stored", "negative") is not None


def test_a_header_that_announces_too_much_needs_a_bench() -> None:
    """Also without anything behind it."""
    header = codec.packet(1, codec.RQSTAT, length=241)[:6]
    assert "announces 241 bytes" in (refusal(header, "passive") or "")
    assert refusal(header, "rig", needs=("bench",)) is None


def test_junk_is_harmless_unless_something_in_it_is_not() -> None:
    """For those who draw it."""
    assert is_harmless(bytes(range(256)))
    assert not is_harmless(b"xx" + codec.packet(3, codec.RQSTAT) + b"xx")
    assert not is_harmless(b"SFLAG,\x00\x01")
    assert not is_harmless(b"dwrite\x00\x01")
