"""On a real line or bus somebody may answer whom the operator has not named: no fault of the device
under test if it is another module, and one if it is the device itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest
from bus_in_front import BITRATE, twin_bus
from interfaces import PLAIN, judge_behind
from lying_bus import Liar, Turn, as_it_is

from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.families.mac.can import codec as can_codec
from axistwin_conformance.transport.can import CanTransport
from axistwin_conformance.transport.can_frame import Frame

pytestmark = pytest.mark.strength

LINE, BUS = find_family("mac23"), find_family("mac23-can")
SERIAL = {
    "only_its_own_address_and_ff_reach_it": 1,
    "frames_for_another_module_do_nothing": 0x33,
    "a_wrong_checksum_for_somebody_else_is_not_nacked": 0x55,
}
CAN = {
    "requests_to_other_addresses_get_no_reply": 2,
    "downloads_to_other_addresses_do_nothing": 0x33,
    "no_other_identifier_reaches_a_module": 2,
    "what_others_are_told_neither_starts_nor_disarms_it": 0x33,
    "a_setting_for_all_outlasts_a_restart_for_all": 0x45,
    "what_all_are_told_follows_the_same_rules": 0x45,
}
Change = Callable[[Any], None]


def differs(line: Any) -> None:
    """The last module stands elsewhere than the first."""
    line.twins[-1].push(1234)


def alike(line: Any) -> None:
    """Two modules that nothing at rest tells apart."""


def on_the_line(name: str, url: str, change: Change) -> Result:
    """Judge module 0 of the line by one check, as a real device."""
    options = make_options(
        model="mac23", port=PLAIN.url, ids=(name,), allow="motion,stored", level="full"
    )

    def changed(line: Any) -> Any:
        change(line)
        return line

    return judge_behind(PLAIN, options, url, before=changed).result


def on_the_bus(
    name: str, url: str, change: Change, hears: Turn = as_it_is, says: Turn = as_it_is,
    *, address: int = 1,
) -> Result:  # fmt: skip
    """Judge a module of the bus by one check, as a real device."""
    options = make_options(
        model="mac23-can", can="socketcan:can0", ids=(name,), allow="motion,stored", level="full",
        address=address,
    )  # fmt: skip

    def opener(neighbours: tuple[int, ...]) -> CanTransport:
        bus = twin_bus(url)
        change(bus)
        liar = Liar(bus, says, hears, lambda frame: ())
        return CanTransport(
            liar, url, is_spontaneous=can_codec.is_spontaneous, bitrate=BITRATE, is_lossless=False
        )

    return Engine(options, opener).run(lambda event: None)


def findings(result: Result, verdict: Verdict) -> list[Finding]:
    """What was found so."""
    return [one for ran in result.checks for one in ran.findings if one.verdict is verdict]


def is_told(result: Result, address: int) -> None:
    """Nothing failed, nothing of the check passed, and the remedy is named."""
    assert findings(result, Verdict.FAIL) == []
    left = findings(result, Verdict.INCONCLUSIVE)
    assert {one.requirement for one in left} == set(result.checks[0].check.requirements)
    for one in left:
        assert f"another module answers at {address} " in one.text
        assert f"name it (--neighbour {address}) or take it off the" in one.text


@pytest.mark.strength
@pytest.mark.parametrize(("name", "other"), SERIAL.items())
def test_another_module_on_the_line_is_not_held_against_the_device(name: str, other: int) -> None:
    """It stands elsewhere, so it is another one: inconclusive, with what to do."""
    url = LINE.twin_url("mac23", 0, (other,))
    is_told(on_the_line(name, url, differs), other)


@pytest.mark.strength
@pytest.mark.parametrize(("name", "other"), CAN.items())
def test_another_module_on_the_bus_is_not_held_against_the_device(name: str, other: int) -> None:
    """It stands elsewhere, so it is another one: inconclusive, with what to do."""
    url = BUS.twin_url("mac23-can", 1, (other,))
    is_told(on_the_bus(name, url, differs), other)


@pytest.mark.strength
@pytest.mark.parametrize(
    "name",
    ["module_1_alone_answers_what_all_are_asked", "the_manuals_examples_get_their_replies"],
)
def test_a_module_1_that_nobody_named_may_answer_what_all_are_asked(name: str) -> None:
    """It has to; module 2, which is under test, is not blamed for it."""
    url = BUS.twin_url("mac23-can", 2, (1,))
    is_told(on_the_bus(name, url, differs, address=2), 1)


def test_who_is_like_the_module_in_everything_may_be_the_module() -> None:
    """That fails as before, and says what to do if it is another one."""
    name = "only_its_own_address_and_ff_reach_it"
    result = on_the_line(name, LINE.twin_url("mac23", 0, (1,)), alike)
    failed = findings(result, Verdict.FAIL)
    assert {one.requirement for one in failed} == {"MACS-FRAME-07", "MACS-REPLY-13"}
    assert all("name it (--neighbour 1)" in one.text for one in failed)


class SixBits:
    """A module 1 that takes address 41h for its own, and answers under the one it was asked at."""

    def __init__(self) -> None:
        self.is_asked = False

    def hears(self, frame: Frame) -> Iterable[Frame]:
        """What it takes a frame for."""
        self.is_asked = frame.identifier == 0x641
        return (Frame(0x601, frame.data),) if self.is_asked else (frame,)

    def says(self, frame: Frame) -> Iterable[Frame]:
        """Under which identifier it answers."""
        is_other = self.is_asked and frame.identifier == 0x581
        return (Frame(0x5C1, frame.data),) if is_other else (frame,)


def test_a_module_that_answers_at_a_second_address_fails() -> None:
    """One bit of the address is not compared: the same position, release and parameters."""
    module = SixBits()
    result = on_the_bus(
        "requests_to_other_addresses_get_no_reply", BUS.twin_url("mac23-can", 1, ()), alike,
        module.hears, module.says,
    )  # fmt: skip
    failed = findings(result, Verdict.FAIL)
    assert {one.requirement for one in failed} == {"MACC-ID-02", "MACC-SDO-06"}
    assert all("name it (--neighbour 65)" in one.text for one in failed)
