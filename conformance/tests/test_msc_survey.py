"""What was named and the unit has not: told before anything is judged, and blamed on nobody; a unit
that refuses what it has to serve gets away by none of that."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest
from click.testing import CliRunner
from msc_twin import TwinPort, target_of

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import conform, make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.msc import codec

pytestmark = pytest.mark.strength

SIZE = 32768  # of the data areas here
READS = ("DREAD", "BREAD", "RFLAG")
IDS = ("MSC-DREAD", "MSC-BREAD", "MSC-PKT-06", "MSC-PROP-01", "MSC-PROP-02")


def refusing(refuses: Callable[[str, int], bool], status: int = 65) -> TwinPort:
    """A unit that refuses reads of some addresses within its data area, too."""
    port = TwinPort()
    port.status, served = status, port.served

    def fault(one: codec.Packet) -> bytes | None:
        is_refused = one.name in READS and refuses(one.name, one.numbers[0])
        return None if is_refused else served(one)

    port.served = fault
    return port


def judged(port: TwinPort, first: int, last: int, *, is_lossless: bool = True) -> Result:
    """A passive run over a line with that unit, with those variables named."""
    options = make_options(
        model="msc-250", port="/dev/ttyUSB0", variables=range(first, last + 1), ids=IDS,
        level="quick",
    )  # fmt: skip
    engine = Engine(options, lambda neighbours: target_of(port, is_lossless=is_lossless))
    return engine.run(lambda event: None)


def verdicts(result: Result) -> set[Verdict]:
    """All there are."""
    return {one.verdict for one in result.requirements}


@pytest.mark.parametrize("is_lossless", [True, False])
@pytest.mark.parametrize(
    ("first", "last", "told"),
    [
        (40000, 40100, "refuses 40000, 40100 and what was tried between (NAK): outside of its"),
        (32760, 32799, "refuses 32796 (NAK): its data area has of these 32760-32767 alone"),
        (8192, 65535, "refuses 65532 (NAK): its data area has of these 8192-32767 alone"),
        (32768, 32768, "refuses 32768 (NAK): outside of its data area; name addresses that the"),
    ],
)
def test_a_span_beyond_the_data_area_is_told_and_blamed_on_nobody(
    first: int, last: int, told: str, is_lossless: bool
) -> None:
    """Exit 2, nothing judged, and the span is named with what the unit has of it."""
    result = judged(TwinPort(), first, last, is_lossless=is_lossless)
    assert result.exit_status == 2
    assert result.sentence.startswith(f"Not judged: --variables {first}-{last}: this unit ")
    assert told in result.sentence
    assert verdicts(result) == {Verdict.NOT_RUN}
    assert (result.checks, result.problems) == ([], [])


def test_an_area_that_begins_later_is_told_by_both_its_ends() -> None:
    """Where the ends of a span are refused and something between is served."""
    result = judged(
        refusing(lambda name, at: name != "RFLAG" and not 4096 <= at < 8192), 2048, 16383
    )
    assert "refuses 2048 and 16380 (NAK)" in result.sentence
    assert "its data area has of these 4096-8191 alone" in result.sentence


def test_a_span_up_to_the_very_end_is_judged() -> None:
    """The last value of the data area is the last one named."""
    result = judged(TwinPort(), SIZE - 256, SIZE - 1)
    assert result.exit_status == 0
    assert verdicts(result) == {Verdict.PASS, Verdict.NOT_RUN}


def test_a_unit_that_serves_no_data_without_its_program_is_told_with_its_status() -> None:
    """It may refuse them all because nothing runs in it (MSC-AMB-32)."""
    result = judged(refusing(lambda name, at: name != "RFLAG", status=64), 2048, 3071)
    assert result.exit_status == 2
    assert "perhaps because no program runs in it (status 64)" in result.sentence


@pytest.mark.parametrize("is_lossless", [True, False])
@pytest.mark.parametrize(
    "refuses",
    [
        lambda name, at: at == 3068 - 128 * 7,
        lambda name, at: name == "DREAD",
        lambda name, at: name == "DREAD" and at % 256 in (0, 252),
        lambda name, at: True,
        lambda name, at: at >= 128,
    ],
)
def test_a_unit_that_refuses_what_it_has_is_still_found(
    refuses: Callable[[str, int], bool], is_lossless: bool
) -> None:
    """An address between others that it serves; DREAD where BREAD is served; flags as well."""
    result = judged(refusing(refuses), 2048, 3071, is_lossless=is_lossless)
    assert result.exit_status == 1
    assert Verdict.FAIL in verdicts(result)


def test_a_unit_that_refuses_what_it_has_served_is_found() -> None:
    """From the sixth read on the numbers are taken for others."""
    count = itertools.count()
    result = judged(refusing(lambda name, at: next(count) > 5), 2048, 3071)
    assert result.exit_status == 1
    assert Verdict.FAIL in verdicts(result)


def test_a_bench_program_beyond_the_data_area_is_told_likewise() -> None:
    """Its counters would be read as much as any variable."""
    options = make_options(
        model="msc-250", port="/dev/ttyUSB0", bench_program=(240, 40064), ids=IDS, level="quick"
    )
    result = Engine(options, lambda neighbours: target_of(TwinPort())).run(lambda event: None)
    assert result.exit_status == 2
    assert "--bench-program 240:40064: this unit refuses 40064" in result.sentence


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (
            ("--variables", "65530-65536"),
            "'65530-65536' is no span: write FIRST-LAST within 0-65535",
        ),
        (("--variables", "3071-2048"), "'3071-2048' runs backwards: write 2048-3071"),
        (("--flags", "250-256"), "'250-256' is no span: write FIRST-LAST within 0-255"),
        (("--flags", "207-200"), "'207-200' runs backwards: write 200-207"),
        (("--flags", "239-241"), "240-243 to itself: --flags 239-241 must not reach into it"),
        (("--variables", "6000-6200"), "6144-6399 to itself: --variables 6000-6200 must not"),
        (("--bench-program", "240:65408"), "the last of them 65663: its ADDRESS is 65280 at most"),
    ],
)
def test_a_span_that_no_unit_can_have_is_refused_at_once(
    words: tuple[str, ...], complaint: str
) -> None:
    """Exit 2 and one line, with nothing asked of any device."""
    result = CliRunner().invoke(conform, ("msc-250", *words))
    assert result.exit_code == 2
    assert complaint in result.output
    assert "device " not in result.output
