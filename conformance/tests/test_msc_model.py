"""The model of a unit's variables and flags: what it admits, and whom a surprise speaks about."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin_conformance.families.msc.sequences.model import UnitModel

BLOCK = tuple(range(100, 132))
Step = Callable[[UnitModel], object]


def model(*strides: int) -> UnitModel:
    """A model in which nothing is known; the distance of neighbours is 4 unless told."""
    return UnitModel(strides or (4,))


def write(address: int, value: int) -> Step:
    """DWRITE."""
    return lambda one: one.write(address, value)


def block(address: int) -> Step:
    """BWRITE."""
    return lambda one: one.write_block(address, BLOCK)


def read(address: int, value: int) -> Step:
    """DREAD with what came."""
    return lambda one: one.read(address, value)


def test_what_nobody_has_written_may_be_anything_once() -> None:
    """The first read tells it, the second must agree."""
    one = model()
    assert one.admissible(0) is None
    assert one.read(0, 77) == ("", None)
    assert one.admissible(0) == frozenset({77})
    told, wrong = one.read(0, 78)
    assert told == "MSC-PROP-13"
    assert wrong is not None
    assert (wrong.expected, wrong.actual) == ("77 at 0", "78")


@pytest.mark.parametrize(
    ("steps", "requirement"),
    [
        ((write(0, 5),), "MSC-PROP-08"),
        ((write(0, 5), write(4, 6)), "MSC-PROP-08"),
        ((block(0), write(0, 5)), "MSC-PROP-08"),
        ((write(0, 5), read(0, 5)), "MSC-PROP-13"),
        ((write(0, 5), read(0, 5), write(4, 1)), "MSC-PROP-09"),
        ((block(0),), "MSC-PROP-09"),
    ],
)
def test_a_wrong_value_speaks_about_what_was_done_before(
    steps: tuple[Step, ...], requirement: str
) -> None:
    """DWRITE and DREAD alone, the dictionary, or reads that have changed something."""
    one = model()
    for step in steps:
        step(one)
    told, wrong = one.read(0, 999)
    assert told == requirement
    assert wrong is not None
    assert wrong.requirement == requirement


def test_a_block_is_compared_value_by_value() -> None:
    """Across a value written into it."""
    one = model()
    one.write_block(0, BLOCK)
    one.write(8, -1)
    right = (*BLOCK[:2], -1, *BLOCK[3:])
    assert one.read_block(0, right) == ("MSC-PROP-09", None)
    _, wrong = one.read_block(0, BLOCK)
    assert wrong is not None
    assert wrong.expected == "-1 at 8"
    assert wrong.actual == "102 in place 3 of the block at 0"


@pytest.mark.parametrize("stride", [4, 2, 1])
def test_the_distance_of_neighbours_shows_in_what_a_block_leaves_behind(stride: int) -> None:
    """Each hypothesis that a read contradicts is struck out."""
    one = model(4, 2, 1)
    one.write_block(0, BLOCK)
    assert one.admissible(4) == frozenset({101, 102, 104})
    assert one.read(4, BLOCK[4 // stride])[1] is None
    assert list(one.memories) == [stride]


def test_a_value_that_no_distance_explains_is_wrong() -> None:
    """All that would do is told."""
    one = model(4, 2, 1)
    one.write_block(0, BLOCK)
    _, wrong = one.read(4, 103)
    assert wrong is not None
    assert wrong.expected == "101 or 102 or 104 at 4"


def test_what_only_one_distance_knows_may_be_anything() -> None:
    """Behind the end of the block in two of the three."""
    one = model(4, 2, 1)
    one.write_block(0, BLOCK)
    assert one.admissible(64 + 4) is None
    assert one.read(64 + 4, 555)[1] is None
    assert list(one.memories) == [2, 1]


def test_values_are_kept_in_32_bits() -> None:
    """What does not fit wraps as it would in a variable."""
    one = model()
    one.write(0, 0xFFFFFFFF)
    assert one.admissible(0) == frozenset({-1})


@given(
    st.lists(
        st.tuples(st.integers(0, 40).map(lambda one: one * 4), st.integers(-(2**31), 2**31 - 1)),
        max_size=30,
    ),
    st.integers(0, 20).map(lambda one: one * 4),
)
def test_the_model_agrees_with_a_dictionary(writes: list[tuple[int, int]], address: int) -> None:
    """Of addresses and values, in any order of writes."""
    one, known = model(), dict[int, int]()
    one.write_block(0, BLOCK)
    known.update(zip(range(0, 128, 4), BLOCK, strict=True))
    for at, value in writes:
        one.write(at, value)
        known[at] = value
    for at, value in known.items():
        assert one.admissible(at) == frozenset({value})
    values = tuple(known.get(at, 7) for at in range(address, address + 128, 4))
    assert one.read_block(address, values)[1] is None
    assert one.read_block(address, (values[0] ^ 1, *values[1:]))[1] is not None


def test_flags_are_a_set() -> None:
    """A wrong one speaks about the set, or about reads if there was nothing else."""
    one = model()
    assert one.read_flag(130, True) == ("", None)
    one.turn(130, False)
    assert one.read_flag(130, False) == ("MSC-PROP-10", None)
    assert one.read_flag(130, False) == ("MSC-PROP-13", None)
    one.turn(131, True)
    told, wrong = one.read_flag(130, True)
    assert told == "MSC-PROP-10"
    assert wrong is not None
    assert (wrong.expected, wrong.actual) == ("flag 130 off", "on")
