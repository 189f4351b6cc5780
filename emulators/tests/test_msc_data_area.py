"""The data area: values, bytes, strides, its end, and what is kept of it."""

import struct
from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin.devices.msc.data_area import DataArea, signed
from axistwin.devices.msc.quirks import parse_quirks

STRIDES = pytest.mark.parametrize("stride", [4, 2, 1])
VALUES = st.integers(-(1 << 31), (1 << 31) - 1)


def area(**quirks: Any) -> DataArea:
    """A data area of 1024 addresses, small enough to reach its end."""
    return DataArea(parse_quirks({"data_size": 1024, **quirks}))


def write_block(data: DataArea, address: int, values: Sequence[int]) -> None:
    """Store ``values`` from ``address`` on, as BWRITE does."""
    for place, value in zip(data.block_places(address, len(values)), values, strict=True):
        data.put(place, value)


class Bytes:
    """The same by the rule: a row of bytes, each value four of them, high byte first."""

    def __init__(self, stride: int, size: int = 1024) -> None:
        self.each = 4 // stride
        self.data = bytearray(size * self.each)

    def read(self, address: int) -> int:
        """The value at ``address``."""
        return int(struct.unpack_from(">i", self.data, address * self.each)[0])

    def write(self, address: int, value: int) -> None:
        """Store ``value``."""
        struct.pack_into(">i", self.data, address * self.each, value)


@pytest.mark.parametrize(
    ("number", "value"),
    [(0, 0), (0x7FFFFFFF, 0x7FFFFFFF), (0x80000000, -0x80000000), (-1, -1), (1 << 32, 0)],
)
def test_arithmetic_wraps_at_32_bits(number: int, value: int) -> None:
    """Two's complement."""
    assert signed(number) == value


@pytest.mark.strength
@STRIDES
@settings(max_examples=100)
@given(ops=st.lists(st.tuples(st.booleans(), st.integers(0, 1020), VALUES), max_size=30))
def test_any_addresses_agree_with_a_row_of_bytes(
    stride: int, ops: list[tuple[bool, int, int]]
) -> None:
    """Addresses inside a value reach parts of two (MSC-AMB-19); its neighbours keep theirs."""
    data, model = area(data_address_stride=stride), Bytes(stride)
    for is_write, address, value in ops:
        assert data.has(address)
        if is_write:
            data.write(address, value)
            model.write(address, value)
        assert data.read(address) == model.read(address)
    for address in range(1021):
        assert data.read(address) == model.read(address)


@STRIDES
def test_values_of_a_block_are_one_stride_apart(stride: int) -> None:
    """In order (MSC-BREAD-03, MSC-BWRITE-02), and nothing behind them changes."""
    data = area(data_address_stride=stride)
    values = [n * -70_000_000 for n in range(32)]
    data.write(400 + 32 * stride, 5)
    write_block(data, 400, values)
    assert data.read_block(400) == values
    assert [data.read(400 + n * stride) for n in range(33)] == [*values, 5]


@STRIDES
def test_the_last_value_is_the_last_that_lies_inside_whole(stride: int) -> None:
    """One stride before the end; a block 32 strides."""
    data = area(data_address_stride=stride)
    assert data.end == 1024 - stride
    assert data.has(data.end)
    assert not data.has(data.end + 1)
    assert not data.has(1024)
    assert not data.has(0xFFFF)
    assert data.has_block(1024 - 32 * stride)
    assert not data.has_block(1024 - 31 * stride)


def test_a_size_that_is_no_multiple_of_the_stride_is_cut() -> None:
    """The last value lies inside whole."""
    assert DataArea(parse_quirks({"data_size": 1027})).end == 1020


def test_an_address_beyond_the_end_may_read_zero_or_wrap() -> None:
    """MSC-AMB-20."""
    data = area(data_out_of_range="zero")
    data.write(1024, 5)
    assert (data.read(1024), data.read(0), data.read_block(5000)) == (0, 0, [0] * 32)
    write_block(data, 5000, [7] * 32)
    assert data.cells() == {}
    data = area(data_out_of_range="wrap")
    data.write(1024 + 8, 5)
    assert (data.read(8), data.read(2048 + 8)) == (5, 5)
    data.write(1022, 0x01020304)
    assert (data.read(1020), data.read(0)) == (0x0102, 0x03040000)


def test_a_block_over_the_end_may_be_cut_or_wrap() -> None:
    """MSC-AMB-21."""
    values = list(range(1, 33))
    data = area(block_overrun="partial")
    write_block(data, 1024 - 8, values)
    assert data.cells() == {"data_03F8": 1, "data_03FC": 2}
    assert data.read_block(1024 - 8) == [1, 2] + [0] * 30
    data = area(block_overrun="wrap")
    write_block(data, 1024 - 8, values)
    assert data.read_block(1024 - 8) == values
    assert (data.read(0), data.read(29 * 4)) == (3, 32)


def test_a_misaligned_address_may_be_refused_or_rounded_down() -> None:
    """MSC-AMB-19."""
    data = area(data_misaligned="nak")
    assert [data.has(address) for address in range(5)] == [True, False, False, False, True]
    assert not data.has_block(2)
    data = area(data_misaligned="round_down")
    data.write(11, 5)
    assert data.read(8) == data.read(9) == 5
    write_block(data, 7, [1] * 32)
    assert data.read(4) == 1


@STRIDES
def test_cells_are_the_values_ever_written(stride: int) -> None:
    """By address in hex; they can be taken back."""
    data = area(data_address_stride=stride)
    data.write(2 * stride, -1)
    data.write(1024 - stride, 7)
    cells = {f"data_{2 * stride:04X}": -1, f"data_{1024 - stride:04X}": 7}
    assert data.cells() == cells
    assert data.is_written(2 * stride)
    assert not data.is_written(0)
    again = area(data_address_stride=stride)
    again.restore({**cells, "battery": 1})
    assert again.cells() == cells
    assert not again.is_changed


def test_cells_that_do_not_fit_are_left_out() -> None:
    """Another size, another stride, another name."""
    data = area()
    data.restore({"data_0400": 1, "data_0002": 2, "data_0008": 3, "data_8": 4, "data_000g": 5})
    assert data.cells() == {"data_0008": 3}


def test_what_was_written_since_last_time_is_told_once() -> None:
    """For the disk: each value as it is now."""
    data = area()
    data.write(8, 1)
    data.write(8, 2)
    data.write(14, 1)
    assert data.is_changed
    assert dict(data.take_changed()) == {"data_0008": 2, "data_000C": 0, "data_0010": 0x10000}
    assert data.take_changed() == ()


def test_a_lost_memory_is_all_zeros() -> None:
    """Told value by value."""
    data = area()
    data.write(8, 1)
    data.take_changed()
    data.lose()
    assert data.read(8) == 0
    assert data.take_changed() == (("data_0008", 0),)
