"""What a program has to be to fit a controller, and what its loading stores."""

import functools
from typing import Any

import pytest
from program_bench import CLEARED, ProgramBench

from axistwin.devices.msc.status import StatusBit
from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_MS
from axistwin.macroprogram import Array, Input, Macroprogram, Output, Steps, UserFlag, Variable


class Ticks(Macroprogram):
    """Counts its scans."""

    part = Input(3)
    ticks = Variable(2000)

    def scan(self) -> None:
        """One more."""
        self.ticks += 1


def test_initial_values_are_stored_where_nothing_was() -> None:
    """After a clearing everywhere (what was stored then is of no program)."""

    class Program(Ticks):
        ticks = Variable(2000, initial=7)
        table = Array(2004, 3, initial=[1, 2])

    bench = ProgramBench(Program, started=False)
    assert [bench.value(address) for address in (2000, 2004, 2008, 2012)] == [7, 1, 2, 0]
    assert bench.data.cells() == {"data_07D0": 7, "data_07D4": 1, "data_07D8": 2}
    bench.data.write(2000, 0)
    make = functools.partial(
        type(bench.runner),
        Program,
        bench.data,
        bench.flags,
        bench.status,
        scan_ns=10 * NS_PER_MS,
        quirks=bench.runner._quirks,
    )
    make()
    assert bench.value(2000) == 0
    bench.status.set(StatusBit(CLEARED))
    make()
    assert bench.value(2000) == 7


def test_names_are_known_with_those_of_bases() -> None:
    """Flags by number, variables and arrays by address."""

    class Program(Ticks):
        start = UserFlag(222)
        table = Array(2048, 4)

    names = ProgramBench(Program).runner.names
    assert names["start"] == 222
    assert (names["part"], names["ticks"], names["table"]) == (3, 2000, 2048)
    assert "run" not in names


def test_a_function_may_make_the_object() -> None:
    """For programs with parameters."""

    class Program(Ticks):
        def __init__(self, step: int) -> None:
            self._step = step

        def scan(self) -> None:
            self.ticks += self._step

    assert ProgramBench(functools.partial(Program, 5)).at(10).value(2000) == 10


class NoWork(Macroprogram):
    """Neither run nor scan."""


class NoYield(Macroprogram):
    """Would never end a scan."""

    def run(self) -> Steps:  # type: ignore[empty-body]
        """No yield."""


class WrongKind(Ticks):
    """A user flag is no output."""

    lamp = Output(200)


class NoKind(Ticks):
    """Nothing is flag 100."""

    lamp = Input(100)


class Outside(Ticks):
    """One value too far."""

    table = Array(32760, 3)


class Inside(Ticks):
    """In a value."""

    odd = Variable(2009)


class TooFast(Ticks):
    """No controller scans like that."""

    scan_ms = 0.01


def broken() -> Macroprogram:
    """Cannot be made."""
    raise ValueError("on Mondays")


@pytest.mark.parametrize(
    ("program", "message"),
    [
        (NoWork, "program NoWork does nothing; give it a method run or scan"),
        (NoYield, "NoYield.run never yields; write yield where it waits, or use scan"),
        (WrongKind, "WrongKind.lamp: flag 200 is of kind user, not output; output: 16..31"),
        (NoKind, "NoKind.lamp: flag 100 is of kind unassigned, not input; input: 0..15"),
        (Outside, "Outside.table: address 32768 is outside the data area; the last one is 32764"),
        (Inside, "Inside.odd: address 2009 lies inside a value; addresses are multiples of 4"),
        (TooFast, "TooFast.scan_ms = 0.01 is out of range: 0.1..60000"),
        (broken, "ValueError: on Mondays"),
        (Ticks(), "give the class Ticks, not an object: each start makes a new one"),
        (int, "int is no program; derive a class from Macroprogram"),
        (42, "42 is no program; give a class derived from Macroprogram, or FILE.py"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(program: Any, message: str) -> None:
    """With what would fit."""
    with pytest.raises(UsageError) as caught:
        ProgramBench(program)
    assert str(caught.value).endswith(message)
    assert "\n" not in str(caught.value)


def test_another_flag_map_allows_other_numbers() -> None:
    """The kinds are the unit's."""
    bench = ProgramBench(WrongKind, flag_map="output:200-207/input:0-15")
    assert bench.at(0).value(2000) == 1
