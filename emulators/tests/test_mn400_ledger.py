"""Every byte example, figure, range and default of the MN400's ledger, and each requirement."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from mn400_bench import Mn400Bench
from mn400_effects import SETTINGS, shown
from mn400_sessions import Session

HERE = Path(__file__).parent
LEDGER = HERE.parents[1] / "conformance/axistwin_conformance/families/mn400/ledger.toml"
EXAMPLES: dict[str, str] = tomllib.loads(
    (HERE / "support" / "mn400_ledger_examples.toml").read_text(encoding="utf-8")
)
LONG, LONG_NOT = "0 2147483647 -2147483647", "2147483648 -2147483648 4294967296"
LASH, LASH_NOT = "0 32767", "-1 32768 65536"
TURN, TURN_NOT = "1 -1", "0 2 -2 32768"
TAP, TAP_NOT = "1 32767", "0 -1 32768 65537"
FLAG, FLAG_NOT = "0 1", "-1 2 65536"
SPEED, SPEED_NOT = "2 100000", "1 0 100001"
RANGES = [
    ("A-20,0,-40,0,{}", TURN, TURN_NOT),
    ("A{},0,-40,0,1", "-20", LONG_NOT),
    ("A0,{},0,-40,1", "-20", LONG_NOT),
    ("A-20,0,{},0,1", "-40", LONG_NOT),
    ("A0,-20,0,{},1", "-40", LONG_NOT),
    ("({}", LASH, LASH_NOT),
    ("C{},0", "1 8", "0 9 -1 65537"),
    ("C1,{}", FLAG, FLAG_NOT),
    (";{}", FLAG, FLAG_NOT),
    ("+-20,0,-40,0,{}", TURN, TURN_NOT),
    ("+-20,0,-40,0,1,{}", LONG, LONG_NOT),
    ("+-20,0,-40,0,1,0,{}", LASH, LASH_NOT),
    ("H{}", FLAG, FLAG_NOT),
    ("J{}", FLAG, FLAG_NOT),
    *((f"G{'1,' * n}{{}}{',1' * (4 - n)}", TAP, TAP_NOT) for n in range(5)),
    ("Y{}", SPEED, f"{SPEED_NOT} -1"),
    *((f"L{',' * n}{{}}", LONG, LONG_NOT) for n in range(4)),
    *((f"M{',' * n}{{}}", LONG, LONG_NOT) for n in range(4)),
    ("F{},100000,1", SPEED, f"{SPEED_NOT} -1"),
    ("F2,{},1", SPEED, f"{SPEED_NOT} -1"),
    ("F3,{},1", "3", "2"),
    ("F2,2,{}", "1 2147483647", "0 -1 2147483648"),
    ("E{}", "1 2", "0 3 -1 65537"),
    ("I{}", FLAG, FLAG_NOT),
    ("={}", "1 127", "0 128 -1 257 65537"),
    *((f"B{',' * n}{{}}", LASH, LASH_NOT) for n in range(4)),
    *((f"D{',' * n}{{}}", TURN, TURN_NOT) for n in range(4)),
    ("~{}", "0", "5 -1 65536"),
    ("P{},2", "1 3 4", "0 5 -1 2"),
    ("P2,{}", "1 3 4", "0 5 -1 2"),
    ("P1,3,{}", "1 2 3 4", "0 5 -1"),
    ("X{}", "1 2 4", "0 3 5 8 -1 65537"),
    ("V{}", f"{SPEED} -1 -2147483647", f"{SPEED_NOT} -2147483648"),
    *((f"T{',' * n}{{}}{',' * (4 - n)}10", "0 10 -10", f"11 -11 {LONG_NOT}") for n in range(4)),
    ("T,,,,{}", "1 2147483647", "0 -1 2147483648"),
    ("T,,,,1,{}", LASH, LASH_NOT),
    *((f"{letter}{{}}", "", "0 , -") for letter in ")|/?S{}*ZQNRU.[:" if letter not in "{}"),
    *((f"{2 * letter}{{}}", "", "0 , -") for letter in "{}"),
]
"""A line with a place for a parameter, what may stand there, and what may not (ledger §3.4)."""

MISSING = "A A1,2,3,4 C C1 C,0 ; J +1,2,3,4 G G1,1,1,1 G,1,1,1,1 G1,1,,1,1 Y I = ~ P P1 P,1 X V T1"
"""Lines without a parameter that they need."""


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_of_the_ledger_are_as_it_says(name: str) -> None:
    """Step by step on the wire (mn400_ledger_examples.toml)."""
    assert Session().play(EXAMPLES[name]) == []


@pytest.mark.parametrize(("form", "right", "wrong"), RANGES, ids=[row[0] for row in RANGES])
def test_each_parameter_has_its_range(form: str, right: str, wrong: str) -> None:
    """At its edges and beside them; what is refused changes nothing (ledger §3.4)."""
    for text in right.split():
        assert Mn400Bench().say(form.format(text)).split()[1:] != ["PE"], text
    bench = Mn400Bench()
    before = shown(bench)
    for text in wrong.split():
        assert bench.say(form.format(text)) == "S PE", text
    assert shown(bench) == before


@pytest.mark.parametrize("line", MISSING.split())
def test_what_is_required_is_required(line: str) -> None:
    """PARA_ERROR and no effect (MN4-PAR-09)."""
    bench = Mn400Bench()
    before = shown(bench)
    assert bench.say(line) == "S PE"
    assert shown(bench) == before


@pytest.mark.parametrize("letter", SETTINGS)
def test_power_up_brings_the_default_back(letter: str) -> None:
    """Of everything that a command sets (MN4-PWR-01, MN4-PWR-02, MN4-CMD-ADDR-03)."""
    line, watch = SETTINGS[letter]
    bench = Mn400Bench()
    default = watch(bench)
    bench = Mn400Bench()
    bench.ask(f"\x81{line}\x81".encode("latin-1") + bytes((sum(line.encode()) + 2 & 0x7F,)))
    bench.power_cycle()
    bench.host_rate(9600)
    assert watch(bench) == default


def named() -> Iterator[str]:
    """Requirements that a test, a case of one, or an example names."""
    yield from EXAMPLES
    for path in HERE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for name, first, last in re.findall(
            r"(MN4-[A-Z]+(?:-[A-Z]+)?-)(\d\d)(?:(?:\.\.|, -)(\d\d))?", text
        ):
            yield from (f"{name}{n:02}" for n in range(int(first), int(last or first) + 1))


def test_every_requirement_is_shown_by_a_test() -> None:
    """By an example of its own, or by a test that names it."""
    requirements = tomllib.loads(LEDGER.read_text(encoding="utf-8"))["requirement"]
    assert len(requirements) == 287
    assert set(requirements) <= set(named())
