"""A module on the bus that replies wrongly in one thing, always: judged by that, and the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import pytest
from family_variants import vary
from lying_bus import open_liar

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.transport.can import CanTransport
from axistwin_conformance.transport.can_frame import Frame

pytestmark = pytest.mark.strength

Turn = Callable[[Frame], Frame]
IDS = ("MACC-Q-04-01", "MACC-SDO-05", "moves_take_the_time_of_the_closed_form")


def judged(turn: Turn) -> Result:
    """A run that may move and store, over a bus with that module."""
    options = make_options(model="mac23-can", ids=IDS, allow="motion,stored", level="quick")
    options = replace(options, family=vary(options.family, probe_modules=()))

    def says(frame: Frame) -> Iterable[Frame]:
        return (turn(frame) if frame.identifier == codec.REPLY + 1 else frame,)

    def opened(neighbours: tuple[int, ...]) -> CanTransport:
        return open_liar(neighbours, says, lambda frame: (frame,), lambda frame: ())

    result = Engine(options, opened).run(lambda event: None)
    told = " ".join([*result.problems, result.refusal, *(one.trouble for one in result.checks)])
    assert "error in the suite" not in told, told
    return result


def with_bytes(*changes: tuple[int, int]) -> Turn:
    """Some bytes replaced."""

    def turn(frame: Frame) -> Frame:
        data = bytearray(frame.data)
        for at, value in changes:
            data[at] = value
        return Frame(frame.identifier, bytes(data))

    return turn


def turned_index(frame: Frame) -> Frame:
    """The two bytes of the index the other way round."""
    return Frame(frame.identifier, frame.data[:1] + frame.data[2:0:-1] + frame.data[3:])


def of_answers(turn: Turn) -> Turn:
    """What becomes of answers; other replies stay."""
    return lambda frame: turn(frame) if frame.data[0] == 0x42 else frame


WRONG: dict[str, tuple[Turn, set[str]]] = {
    "another identifier": (lambda frame: Frame(0x582, frame.data), {"MACC-ID-01"}),
    "the identifier of requests": (lambda frame: Frame(0x601, frame.data), {"MACC-ID-01"}),
    "29 bits": (lambda frame: Frame(0x581, frame.data, is_extended=True), {"MACC-ID-01"}),
    "index turned round": (of_answers(turned_index), {"MACC-SDO-03"}),
    "another sub-index": (of_answers(with_bytes((3, 0xFF))), {"MACC-SDO-03"}),
    "265 degrees": (
        lambda frame: with_bytes((4, 0xC0))(frame) if frame.data[:2] == b"\x42\x07" else frame,
        {"MACC-Q-07-01"},
    ),
    "size told": (of_answers(with_bytes((0, 0x4F))), {"MACC-SDO-03"}),
}
UNMENDABLE: dict[str, tuple[Turn, str]] = {
    "half a reply": (lambda frame: Frame(0x581, frame.data[:4]), "MACC-SDO-03"),
    "everything is refused": (
        with_bytes((0, 0x80), *((at, 0) for at in range(4, 8))),
        "MACC-SDO-03",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_module_wrong_in_one_thing_fails_the_requirement_of_that(name: str) -> None:
    """Exit 1 with that requirement; what does not rest on it is judged, and holds."""
    turn, requirements = WRONG[name]
    result = judged(turn)
    told = {one.requirement.id: one.verdict for one in result.requirements}
    assert result.exit_status == 1, result.sentence
    failed = {one for one, verdict in told.items() if verdict is Verdict.FAIL}
    assert failed
    assert failed <= requirements
    assert told["MACC-CMD-13-01"] is Verdict.PASS


@pytest.mark.parametrize("name", UNMENDABLE)
def test_a_module_whose_replies_cannot_be_read_has_failed_all_the_same(name: str) -> None:
    """Exit 1, though nothing else can be judged."""
    turn, requirement = UNMENDABLE[name]
    result = judged(turn)
    assert result.exit_status == 1, result.sentence
    failed = {one.requirement.id for one in result.requirements if one.verdict is Verdict.FAIL}
    assert requirement in failed
