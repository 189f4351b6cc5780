"""The follower of a cam, as programs have it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin.macroprogram import ProgramError, cam_position

INT32 = st.integers(-(1 << 31), (1 << 31) - 1)


@pytest.mark.parametrize(
    ("master", "position"),
    [(0, 0), (45, 50), (90, 100), (100, 89), (180, 0), (315, -50), (360, 0), (-45, -50), (765, 50)],
)
def test_a_cyclic_cam_goes_round(master: int, position: int) -> None:
    """Straight from point to point, and from the last to the first."""
    assert cam_position([0, 100, 0, -100], master, 360) == position


@pytest.mark.parametrize(
    ("master", "position"), [(-5, 10), (0, 10), (1, 15), (5, 35), (10, 60), (11, 60)]
)
def test_another_cam_has_two_ends(master: int, position: int) -> None:
    """And the follower stands still outside."""
    assert cam_position([10, 60], master, 10, is_cyclic=False) == position


@pytest.mark.strength
@given(
    st.lists(INT32, min_size=1, max_size=64),
    st.integers(-(1 << 33), 1 << 33),
    st.integers(1, 1 << 31),
    st.booleans(),
)
def test_a_follower_is_on_the_line_between_its_points(
    table: list[int], master: int, period: int, is_cyclic: bool
) -> None:
    """To half an increment, in whole numbers of any size; never outside the table's range."""
    found = cam_position(table, master, period, is_cyclic=is_cyclic)
    assert min(table) <= found <= max(table)
    spans = len(table) if is_cyclic else len(table) - 1
    inside = master % period if is_cyclic else min(max(master, 0), period)
    place, rest = divmod(inside * spans, period)
    first, second = table[place], table[(place + 1) % len(table)]
    assert abs(2 * (found - first) * period - 2 * (second - first) * rest) <= period


@pytest.mark.parametrize(("table", "period"), [([], 10), ([1], 0), ([1], -1)])
def test_a_cam_without_points_or_period_is_an_error(table: list[int], period: int) -> None:
    """Of the program."""
    with pytest.raises(ProgramError, match="a cam needs points and a period above 0"):
        cam_position(table, 0, period)
