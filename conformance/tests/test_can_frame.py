"""CAN frames as values and as bytes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin_conformance.transport.can_frame import Frame, unpack, unpack_all


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Any frame a classical bus can carry."""
    is_extended = draw(st.booleans())
    identifier = draw(st.integers(0, (1 << (29 if is_extended else 11)) - 1))
    if draw(st.booleans()):
        asked = draw(st.integers(0, 8))
        return Frame(identifier, b"", is_extended, is_remote=True, asked_length=asked)
    return Frame(identifier, draw(st.binary(max_size=8)), is_extended)


@given(st.lists(frames(), max_size=5))
def test_packed_frames_in_a_row_are_found_again(row: list[Frame]) -> None:
    """Each tells its own length."""
    assert unpack_all(b"".join(one.pack() for one in row)) == tuple(row)


def test_a_packed_frame_has_head_length_and_data() -> None:
    """The top bits of the head tell extended and remote."""
    assert Frame(0x601, b"\x40\x00").pack() == bytes.fromhex("00000601 02 4000")
    assert Frame(0x601, is_remote=True, asked_length=8).pack() == bytes.fromhex("40000601 08")
    assert Frame(0x601, is_extended=True).pack() == bytes.fromhex("80000601 00")


@pytest.mark.parametrize("packed", ["", "00000601", "0000060102FF", "0000060100 0000060100"])
def test_what_is_not_one_frame_is_refused(packed: str) -> None:
    """Nothing, a piece of one, or two."""
    with pytest.raises(ValueError, match=r"frame"):
        unpack(bytes.fromhex(packed))


@pytest.mark.parametrize(
    "arguments",
    [
        {"identifier": 0x800},
        {"identifier": -1},
        {"identifier": 1 << 29, "is_extended": True},
        {"identifier": 0, "data": bytes(9)},
        {"identifier": 0, "data": b"x", "is_remote": True},
        {"identifier": 0, "asked_length": 4},
        {"identifier": 0, "is_remote": True, "asked_length": 9},
    ],
)
def test_what_no_controller_could_send_is_our_mistake(arguments: dict[str, int]) -> None:
    """A frame outside the format is refused when it is made."""
    with pytest.raises(ValueError, match=r"identifier|carries|asks"):
        Frame(**arguments)  # type: ignore[arg-type]


def test_a_frame_is_written_as_on_a_bus_monitor() -> None:
    """Identifier, length, data."""
    assert str(Frame(0x81, b"\x00\xff")) == "081h [2] 00 FF"
    assert str(Frame(0x80)) == "080h [0]"
    assert str(Frame(1, is_extended=True, is_remote=True, asked_length=4)) == (
        "00000001h [4] remote, 4"
    )


def test_the_shortest_time_on_the_bus_is_counted_without_stuffing() -> None:
    """44 bits around the data, 64 in the long form; a remote frame has no data."""
    assert Frame(0x601, bytes(8)).least_bits == 108
    assert Frame(0x601, is_extended=True).least_bits == 64
    assert Frame(0x601, is_remote=True, asked_length=8).least_bits == 44
