"""Client, driver, checks and probes of the MN400, heard with a small board."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable

import pytest
from mn400_board import LEDGER, SmallBoard, session_on

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.session import Stop
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.driver import BoardDriver
from axistwin_conformance.families.mn400.family import Mn400
from axistwin_conformance.families.mn400.grammar import ParsedCommand, Refusal


def is_for_one_that_stands(check: Check) -> bool:
    """True for what asks no motion and no second board: the small board has neither."""
    return check.danger == 0 and "neighbour" not in check.needs


CHECKS = {one.name: one for one in Mn400().checks() if is_for_one_that_stands(one)}
Plant = Callable[[SmallBoard], None]


def failures(board: SmallBoard, check: Check, **how: object) -> dict[str, str]:
    """What fails, by requirement: what was expected and what came."""
    session = session_on(board, check, **how)
    with contextlib.suppress(Stop):
        check(session)
    found = session.conclude("")
    return {
        one.requirement: f"{one.expected}: {one.actual}"
        for one in found
        if one.verdict is Verdict.FAIL
    }


@pytest.mark.parametrize("name", CHECKS)
def test_a_sound_board_passes_every_check(name: str) -> None:
    """And judges something of each requirement that it names, or says why not."""
    assert failures(SmallBoard(), CHECKS[name]) == {}


def test_the_client_tells_when_a_reply_is_over() -> None:
    """Two packets to a read, one to &, none to another id."""
    driver = BoardDriver(session_on(SmallBoard()))
    assert driver.ask("E").codes == ("START", "data")
    assert driver.ask("&").codes == ("data",)
    assert driver.ask("W").codes == ("INVALIDCOMMAND",)
    assert driver.client.ask_raw(codec.request(9, "E")).is_silence


def judged(board: SmallBoard, check: Check) -> dict[str, set[Verdict]]:
    """Every verdict of a check, by requirement."""
    session = session_on(board, check)
    with contextlib.suppress(Stop):
        check(session)
    verdicts: dict[str, set[Verdict]] = {}
    for one in session.conclude(""):
        verdicts.setdefault(one.requirement, set()).add(one.verdict)
    return verdicts


def test_together_they_judge_every_requirement_that_they_name() -> None:
    """Of a sound board something passes, or is told not to be run here for a reason."""
    verdicts: dict[str, set[Verdict]] = {}
    for check in CHECKS.values():
        for name, found in judged(SmallBoard(), check).items():
            verdicts.setdefault(name, set()).update(found)
    assert {name for name, found in verdicts.items() if Verdict.PASS not in found} == {
        "MN4-CMD-U-02",
    }


def test_a_check_leaves_a_board_as_it_was() -> None:
    """Counters and feed hold; the rest as at power-on, said last."""
    for check in CHECKS.values():
        board = SmallBoard()
        board.counters, board.feed_hold = [5, -6, 7, 8], 1
        failures(board, check)
        assert (board.counters, board.feed_hold) == ([5, -6, 7, 8], 1), check.name
        assert not board.is_entering, check.name


def spoilt(old: bytes, new: bytes) -> Plant:
    """A board that says something else in each packet, under a right sum."""

    def plant(board: SmallBoard) -> None:
        def spoil(packet: bytes) -> bytes:
            read = codec.parse(packet)
            assert read is not None
            return codec.request(read.board, read.payload.replace(old, new))

        board.spoil = spoil

    return plant


def judges(change: Callable[[str], str | None]) -> Plant:
    """A board that takes one text for another; None: it is refused."""

    def plant(board: SmallBoard) -> None:
        judged_well = board.judged

        def judged_badly(text: str) -> ParsedCommand | Refusal:
            other = change(text)
            return Refusal("planted", "MN4-ERR-02") if other is None else judged_well(other)

        board.judged = judged_badly  # type: ignore[method-assign]

    return plant


def sends(change: Callable[[bytes], bytes]) -> Plant:
    """A board whose packets are changed as they leave."""

    def plant(board: SmallBoard) -> None:
        board.spoil = change

    return plant


def ignoring_sums(board: SmallBoard) -> None:
    """It does not look at checksums."""
    board.ignores_sum = True


def wrapped(bits: int, letters: str) -> Plant:
    """Numbers of these commands are cut to so many bits before they are looked at (trap 30)."""

    def cut(match: re.Match[str]) -> str:
        half = 1 << bits - 1
        return str((int(match[0]) + half) % (2 * half) - half)

    def cut_all(text: str) -> str:
        return re.sub(r"-?[0-9]+", cut, text) if text[:1] in letters else text

    return judges(cut_all)


FAULTS: dict[str, tuple[Plant, str]] = {
    "no null": (sends(lambda raw: codec.request(raw[0] & 0x7F, raw[1:-2].rstrip(b"\0"))),
                "MN4-RSP-01"),
    "sum with bit 7": (sends(lambda raw: raw[:-1] + bytes([raw[-1] ^ 1])), "MN4-PKT-03"),
    "broadcast address": (sends(lambda raw: codec.request(0, raw[1:-2])), "MN4-PKT-07"),
    "second address": (sends(lambda raw: codec.request(raw[0] & 0x7F, raw[1:-2], closing=0x85)),
                       "MN4-PKT-02"),
    "sums ignored": (ignoring_sums, "MN4-PKT-05"),
    "16 bits": (wrapped(16, "B"), "MN4-PAR-04"),
    "32 bits": (wrapped(32, "L"), "MN4-PAR-05"),
    "leading zeros refused": (judges(lambda text: None if re.search(r"[L,]-?0[0-9]", text)
                                     else text), "MN4-PAR-08"),
    "plus accepted": (judges(lambda text: text.replace("+", "")), "MN4-PAR-02"),
    "periods accepted": (judges(lambda text: text.replace(".", "")), "MN4-PAR-02"),
    "minus ignored": (judges(lambda text: re.sub("-(?=[^0-9]|$)", "", text)), "MN4-PAR-03"),
    "multiplex 3": (judges(lambda text: "X2" if text == "X3" else text), "MN4-CMD-X-01"),
    "direction 0": (judges(lambda text: re.sub(r"(?<=[D,])0", "1", text) if text[:1] == "D"
                           else text), "MN4-CMD-D-01"),
    "plane 1,1": (judges(lambda text: "P1,3" if text.startswith("P1,1") else text),
                  "MN4-CMD-P-02"),
    "address 0": (judges(lambda text: "=1" if text == "=0" else text), "MN4-CMD-ADDR-02"),
    "rate 5": (judges(lambda text: "~0" if text == "~5" else text), "MN4-CMD-BAUD-02"),
    "period and null in E": (spoilt(b",", b".\0"), "MN4-RSP-10"),
    "positive sign": (spoilt(b"E1,", b"E+1,"), "MN4-RSP-10"),
    "command of another": (spoilt(b"N0", b"M0"), "MN4-RSP-11"),
}  # fmt: skip


@pytest.mark.strength
@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_found(fault: str) -> None:
    """By a check that names its requirement."""
    plant, requirement = FAULTS[fault]
    found: set[str] = set()
    for check in CHECKS.values():
        if requirement in check.requirements:
            board = SmallBoard()
            plant(board)
            found |= {*failures(board, check)}
    assert requirement in found


@pytest.mark.strength
@pytest.mark.parametrize(
    ("switch", "reading"),
    [
        ("data_packet_trailer", "none"), ("data_packet_trailer", "0600"),
        ("outcome_null", "false"), ("error_start_policy", "never"),
        ("error_start_policy", "always"), ("cc_unsupported", "busy"),
        ("cc_unsupported", "ignored"), ("shield_status_sense", "switch"),
        ("baud_reply", "plus_done"), ("plane_base", "0"), ("omitted_param", "zero"),
        ("extra_params", "ignore"), ("g_widths", "32x5"), ("negative_v", "minus_one_only"),
        ("speed_range_policy", "clip"), ("space_policy", "skip"),
        ("long_max", "2147000000"), ("long_min", "-2147483648"), ("plane_z_check", "at_plane"),
    ],
)  # fmt: skip
def test_a_board_of_another_reading_passes_once_that_is_known(switch: str, reading: str) -> None:
    """Nothing that the manual leaves open fails a board that keeps to one reading."""
    for check in CHECKS.values():
        board = SmallBoard(1, **{switch: reading})
        assert failures(board, check, readings={switch: reading}) == {}, check.name


# --- probes ---------------------------------------------------------------------------------------

PROBES = {one.switch: one for one in Mn400().probes() if is_for_one_that_stands(one.check)}
# What a small board can show of itself, beside the default of every switch.
OTHER_READINGS = [
    *[("data_packet_trailer", one) for one in ("none", "0600", "05", "0500", "00")],
    ("outcome_null", "false"), ("error_start_policy", "always"), ("error_start_policy", "never"),
    ("baud_reply", "plus_done"), ("omitted_param", "zero"), ("omitted_param", "error"),
    ("extra_params", "ignore"), ("space_policy", "skip"), ("long_max", "2147000000"),
    ("long_min", "-2147483648"), ("long_min", "-2147000000"), ("g_widths", "32x5"),
    ("g_widths", "16x4_32"), ("speed_range_policy", "clip"), ("negative_v", "minus_one_only"),
    ("plane_base", "0"), ("plane_z_check", "at_plane"), ("hold_takes_arg", "false"),
    ("measure_other", "plain"), ("has_feedhold_cmds", "false"), ("shield_status_sense", "switch"),
    ("cc_unsupported", "busy"), ("cc_unsupported", "ignored"),
]  # fmt: skip


def seen_of(switch: str, **readings: str) -> tuple[str, ...]:
    """The readings that a probe finds on a board of these."""
    one = PROBES[switch]
    session = session_on(SmallBoard(1, **readings), one.check)
    return one.look(session).readings


@pytest.mark.parametrize("switch", PROBES)
def test_a_probe_finds_the_default(switch: str) -> None:
    """Alone, or among those that it cannot tell apart."""
    assert LEDGER.ambiguity_of(switch).default_of(switch) in seen_of(switch)


@pytest.mark.parametrize(("switch", "reading"), OTHER_READINGS)
def test_a_probe_finds_another_reading(switch: str, reading: str) -> None:
    """And no other with it."""
    assert seen_of(switch, **{switch: reading}) == (reading,)


def test_a_probe_leaves_a_board_as_it_was() -> None:
    """Counters, feed hold, no entry left open."""
    for one in PROBES.values():
        board = SmallBoard()
        board.counters, board.feed_hold = [5, -6, 7, 8], 1
        one.look(session_on(board, one.check))
        assert (board.counters, board.feed_hold) == ([5, -6, 7, 8], 1), one.switch
        assert not board.is_entering, one.switch
