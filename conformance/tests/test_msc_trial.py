"""Flags that the operator has named and something else drives: nothing is judged by them, and no
unit that loses or misplaces what is written gets away by that."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from click.testing import CliRunner
from msc_controller import Controller, refuses, twisted
from msc_twin import TwinPort, session_on, target_of

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import conform, make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.family import FAMILY
from axistwin_conformance.families.msc.options import ScratchArea
from axistwin_conformance.families.msc.preflight.flag_check import try_flags

pytestmark = pytest.mark.strength

PORT = "axistwin://msc-250?time=virtual"
INPUTS = "0-7"
NAMED = range(128, 136)
REMEDY = "name only flags that nothing else drives"


def tried(port: TwinPort, flags: range = NAMED, *, is_lossless: bool = True) -> str:
    """What the trial says of these flags; all that it has touched is put back."""
    target = target_of(port, is_lossless=is_lossless)
    session = session_on(port, target=target, settings=ScratchArea(range(0), flags))
    session.run.memory = FAMILY.remember(session)
    told = try_flags(session)
    assert isinstance(told, str)
    assert FAMILY.restore(session, session.run.memory) == ()
    return told


def judged(make: Callable[[], Controller], flags: range = NAMED) -> Result:
    """A run over a port with that controller behind it, of what flags are written for."""
    options = make_options(
        model="msc-250", port="/dev/ttyUSB0", allow="stored", variables=range(1024, 1400),
        flags=flags, ids=("MSC-SFLAG-02", "MSC-CFLAG-02", "MSC-DWRITE-02"), level="quick",
    )  # fmt: skip
    return Engine(options, lambda neighbours: target_of(make())).run(lambda event: None)


def verdict(result: Result, name: str) -> Verdict:
    """That of one requirement."""
    return next(one.verdict for one in result.requirements if one.requirement.id == name)


# --- who is wrong ---------------------------------------------------------------------------------


class Consuming(Controller):
    """Its program takes a flag for an order, and turns it off when it has seen it."""

    def scan(self) -> None:
        """Takes the order."""
        super().scan()
        self.on.discard(NAMED[2])


def next_one(self: Controller, number: int, *, on: bool) -> bytes | None:
    """The flag behind the one that was meant."""
    return Controller.turn(self, number + 1, on=on)


def and_the_next_one(self: Controller, number: int, *, on: bool) -> bytes | None:
    """The flag that was meant, and the one behind it."""
    Controller.turn(self, number + 1, on=on)
    return Controller.turn(self, number, on=on)


def sets_the_next_one(self: Controller, number: int, *, on: bool) -> bytes | None:
    """SFLAG turns the flag behind the one that was meant; CFLAG is right."""
    return Controller.turn(self, number + on, on=on)


def clears_the_one_before(self: Controller, number: int, *, on: bool) -> bytes | None:
    """CFLAG turns the flag before the one that was meant; SFLAG is right."""
    return Controller.turn(self, number - (not on), on=on)


def without_high_bit(self: Controller, number: int, *, on: bool) -> bytes | None:
    """The flag with the low seven bits of the number."""
    (self.on.add if on else self.on.discard)(number & 0x7F)
    return b""


def lost(self: Controller, number: int, *, on: bool) -> bytes | None:
    """SFLAG is lost."""
    return b"" if on else Controller.turn(self, number, on=on)


def never_off(self: Controller, number: int, *, on: bool) -> bytes | None:
    """CFLAG acts as SFLAG."""
    return Controller.turn(self, number, on=True)


def lost_now_and_then(self: Controller, number: int, *, on: bool) -> bytes | None:
    """Every ninth write is lost."""
    self.notes["turned"] += 1
    return Controller.turn(self, number, on=on) if self.notes["turned"] % 9 else b""


def each_second_is_lost(self: Controller, number: int, *, on: bool) -> bytes | None:
    """Of the SFLAGs; among an even number of flags these are the same ones in every round."""
    self.notes["set"] += on
    return Controller.turn(self, number, on=on and self.notes["set"] % 2 == 0)


def toggles(self: Controller, number: int, *, on: bool) -> bytes | None:
    """SFLAG turns a flag that is on off."""
    return Controller.turn(self, number, on=on and number not in self.on)


@pytest.mark.parametrize("has_rflags", [True, False])
def test_inputs_that_were_named_are_told_by_their_numbers(has_rflags: bool) -> None:
    """With those that are on, and with what to do."""
    port = Controller(has_rflags=has_rflags)
    port.machine = {14}
    told = tried(port, range(13, 18))
    assert told.startswith("flags 13, 14, 15 do not follow SFLAG and CFLAG (--flags 13-17): ")
    assert told.endswith(REMEDY)


def test_an_input_that_refuses_to_be_written_is_told_as_well() -> None:
    """Where the unit answers SFLAG of an input by NAK."""
    port = refuses("SFLAG", lambda one: one.numbers[0] < 16)()
    port.serve = _refusing(port.serve)
    assert tried(port, range(15, 18)).startswith("flag 15 does not follow")


def _refusing(serve: Callable[[codec.Packet], bytes | None]) -> Callable[..., bytes | None]:
    def refusing(one: codec.Packet) -> bytes | None:
        return None if one.name == "CFLAG" and one.numbers[0] < 16 else serve(one)

    return refusing


def test_a_flag_that_the_program_takes_is_told() -> None:
    """It goes off by itself, scans after it was set."""
    assert tried(Consuming()).startswith(f"flag {NAMED[2]} does not follow")


@pytest.mark.parametrize("has_rflags", [True, False])
@pytest.mark.parametrize(
    "turn",
    [
        None,
        toggles,
        next_one,
        sets_the_next_one,
        lost_now_and_then,
        each_second_is_lost,
    ],
)
def test_flags_that_follow_or_show_a_fault_are_left_to_the_checks(
    turn: Callable[..., bytes | None] | None, has_rflags: bool
) -> None:
    """Writes that go to another flag, or are lost seldom, are nobody else's doing."""
    port = twisted(**({"turn": turn} if turn else {}))()
    port.has_rflags = has_rflags
    assert tried(port) == ""


@pytest.mark.parametrize("flags", [NAMED, range(128, 192)])
def test_a_unit_whose_rflags_tells_what_was_before_fails(flags: range) -> None:
    """RFLAG tells that they follow: nothing but the unit can be wrong."""

    class Belated(Controller):
        before = b""

        def serve(self, one: codec.Packet) -> bytes | None:
            told = super().serve(one)
            if one.name != "RFLAGS" or told is None:
                return told
            self.before, told = told, self.before or told
            return told

    assert tried(Belated(), flags) == ""


def test_noise_drives_no_flag() -> None:
    """Every fifth packet is spoilt, either way."""
    for number in range(6):
        port, draw = Controller(), random.Random(number)
        port.spoil = lambda data, draw=draw: b"" if draw.random() < 0.2 else data  # type: ignore[misc]
        assert tried(port, is_lossless=False) == ""


# --- what the run makes of it ---------------------------------------------------------------------


def test_inputs_that_were_named_fail_no_unit() -> None:
    """The line names them; what flags are not needed for is judged."""
    words = ["msc-250", "--port", PORT, "--allow", "stored", "--flags", INPUTS]
    ids = ["MSC-SFLAG-02", "MSC-DWRITE-02", "--level", "quick"]
    result = CliRunner().invoke(conform, [*words, "--variables", "1024-1400", "-v", *ids])
    assert result.exit_code == 4, result.output
    named = "flags 0, 1, 2, 3, 4, 5, 6, 7 do not follow SFLAG and CFLAG (--flags 0-7)"
    assert f"problem: {named}" in result.output
    assert "MSC-DWRITE-02  pass" in result.output
    assert "0 fail" in result.output


def test_a_unit_that_loses_what_is_written_to_flags_does_not_pass() -> None:
    """It might be the operator's mistake; nothing is said for the unit, and the rest is judged."""
    result = judged(twisted(turn=lost))
    assert verdict(result, "MSC-SFLAG-02") is Verdict.INCONCLUSIVE
    assert result.exit_status == 4
    assert verdict(result, "MSC-DWRITE-02") is Verdict.PASS
    assert any(one.endswith(REMEDY) for one in result.problems)


@pytest.mark.parametrize(
    ("turn", "requirement"), [(lost, "MSC-SFLAG-02"), (never_off, "MSC-CFLAG-02")]
)
def test_a_unit_that_loses_what_is_written_to_many_flags_fails(
    turn: Callable[..., bytes | None], requirement: str
) -> None:
    """It acknowledges every time; no machine holds so many flags in one state."""
    result = judged(twisted(turn=turn), range(128, 192))
    assert result.exit_status == 1, result.sentence
    assert verdict(result, requirement) is Verdict.FAIL
    assert verdict(result, "MSC-DWRITE-02") is Verdict.PASS


@pytest.mark.parametrize(
    ("turn", "requirement"),
    [
        (next_one, "MSC-SFLAG-02"),
        (sets_the_next_one, "MSC-SFLAG-02"),
        (clears_the_one_before, "MSC-CFLAG-02"),
        (without_high_bit, "MSC-SFLAG-02"),
        (toggles, "MSC-SFLAG-02"),
        (lost_now_and_then, "MSC-SFLAG-02"),
        (each_second_is_lost, "MSC-SFLAG-02"),
    ],
)
def test_a_unit_that_writes_flags_wrongly_fails_over_a_port(
    turn: Callable[..., bytes | None], requirement: str
) -> None:
    """Nobody else can have done that."""
    result = judged(twisted(turn=turn))
    assert verdict(result, requirement) is Verdict.FAIL, result.problems


def test_flags_are_put_back_whatever_was_tried() -> None:
    """Before anything is judged, and also if the run goes no further."""
    made: list[Controller] = []

    def make() -> Controller:
        made.append(Controller())
        made[0].on = {129, 131}
        return made[0]

    result = judged(make)
    assert made[0].on == {129, 131}
    assert verdict(result, "MSC-SFLAG-02") is Verdict.PASS


def test_a_unit_that_turns_the_next_flag_as_well_fails() -> None:
    """Also where the next one is not named: all that can be seen at once is looked at."""
    result = judged(twisted(turn=and_the_next_one))
    assert result.exit_status == 1
    assert verdict(result, "MSC-SFLAG-02") is Verdict.FAIL
    (told,) = [one for one in result.checks if one.check.name == "trial"]
    assert told.findings[0].actual == "flag 129 as well"
