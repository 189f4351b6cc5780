"""CAN frames bit by bit, against a sender that knows only the standard's sentences."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin.wire.can_frame import CanFrame, arbitration_key, crc_15, stuffed_bits, wire_bits


@st.composite
def frames(draw: st.DrawFn) -> CanFrame:
    """Any frame; runs of equal bits are frequent, because stuffing is about them."""
    is_extended = draw(st.booleans())
    top = 0x1FFFFFFF if is_extended else 0x7FF
    identifier = draw(st.sampled_from([0, 1, top, top - 1, top >> 1, 0x7E0]) | st.integers(0, top))
    if draw(st.integers(0, 4)) == 0:
        return CanFrame(identifier, b"", is_extended, True, draw(st.integers(0, 8)))
    byte = st.sampled_from([0x00, 0xFF, 0xF0, 0x0F, 0x83, 0x3E]) | st.integers(0, 255)
    return CanFrame(identifier, bytes(draw(st.lists(byte, max_size=8))), is_extended)


# ---- the naive sender: one bit at a time, as the standard says it ----


def field_bits(frame: CanFrame) -> list[int]:
    """SOF to the last data bit."""
    text = "0"
    if frame.is_extended:
        whole = f"{frame.identifier:029b}"
        text += whole[:11] + "11" + whole[11:] + str(int(frame.is_remote)) + "00"
    else:
        text += f"{frame.identifier:011b}" + str(int(frame.is_remote)) + "00"
    text += f"{frame.length:04b}" + "".join(f"{byte:08b}" for byte in frame.data)
    return [int(bit) for bit in text]


def check_bits(bits: list[int]) -> list[int]:
    """The shift register of the standard."""
    register = 0
    for bit in bits:
        feedback = bit ^ (register >> 14)
        register = register << 1 & 0x7FFF
        if feedback:
            register ^= 0x4599
    return [register >> shift & 1 for shift in range(14, -1, -1)]


def naively_stuffed(bits: list[int]) -> list[int]:
    """After five equal bits on the wire, stuff bits included, one of the other value."""
    sent: list[int] = []
    for bit in bits:
        sent.append(bit)
        if len(sent) >= 5 and len(set(sent[-5:])) == 1:
            sent.append(1 - bit)
    return sent


def naive_wire(frame: CanFrame) -> list[int]:
    """Everything from SOF to the end of EOF."""
    bits = field_bits(frame)
    stuffed = naively_stuffed(bits + check_bits(bits))
    delimiter_ack_end = [1, 0, 1] + [1] * 7
    return stuffed + delimiter_ack_end


@pytest.mark.strength
@given(frames())
def test_every_frame_has_the_bits_that_a_naive_sender_puts_on_the_wire(frame: CanFrame) -> None:
    """Length and content, standard and extended, data and remote."""
    wire = naive_wire(frame)
    assert wire_bits(frame) == len(wire)
    assert stuffed_bits(frame) == "".join(map(str, wire[:-10]))


@pytest.mark.strength
@given(frames())
def test_no_six_equal_bits_follow_one_another_before_the_delimiter(frame: CanFrame) -> None:
    """And what is stuffed in can be taken out again."""
    sent = stuffed_bits(frame)
    assert "000000" not in sent
    assert "111111" not in sent
    taken, run = "", ""
    for bit in sent:
        if len(run) == 5 and len(set(run)) == 1:
            assert bit != run[-1]
        else:
            taken += bit
        run = (run + bit)[-5:] if bit == run[-1:] else bit
    bits = field_bits(frame)
    assert taken == "".join(map(str, bits + check_bits(bits)))


def test_the_check_sequence_is_the_catalogued_one() -> None:
    """CRC-15/CAN has the check value 059Eh for the nine digits."""
    assert crc_15(b"123456789") == 0x059E
    assert crc_15(b"\0\0" + b"123456789") == 0x059E  # padding on the left changes nothing


@pytest.mark.parametrize(
    ("frame", "bits"),
    [
        (CanFrame(0x555), 44),  # nothing to stuff but what the control field and the CRC need
        (CanFrame(0x080), 44),
        (CanFrame(0x000), 44),
        (CanFrame(0x701, b"\0"), 52),
        (CanFrame(0x601, bytes.fromhex("4000200000000000")), 108),
    ],
)
def test_lengths_lie_between_the_bare_frame_and_the_worst_case(frame: CanFrame, bits: int) -> None:
    """44 + 8n bits, and at most one stuff bit per four of the 34 + 8n that are stuffed."""
    assert bits == 44 + 8 * len(frame.data)
    assert bits < wire_bits(frame) <= bits + (bits - 10 - 1) // 4


@pytest.mark.strength
@given(frames())
def test_no_frame_is_longer_than_the_worst_case(frame: CanFrame) -> None:
    """The bound of every response-time analysis: 135 bits with the intermission for 8 bytes."""
    stuffed = (54 if frame.is_extended else 34) + 8 * len(frame.data)
    assert stuffed + 10 <= wire_bits(frame) <= stuffed + 10 + (stuffed - 1) // 4
    if not frame.is_extended:
        assert wire_bits(frame) + 3 <= 135


@pytest.mark.strength
@given(frames(), frames())
def test_the_lower_key_is_dominant_at_the_first_bit_that_differs(
    one: CanFrame, other: CanFrame
) -> None:
    """Up to the control field the bits themselves decide who wins."""

    def arbitration(frame: CanFrame) -> str:
        return stuffed_bits(frame)

    first, second = arbitration(one), arbitration(other)
    if arbitration_key(one) == arbitration_key(other):
        assert one.identifier == other.identifier
        assert one.is_remote == other.is_remote
        assert one.is_extended == other.is_extended
        return
    differing = next(at for at, (a, b) in enumerate(zip(first, second, strict=False)) if a != b)
    assert (arbitration_key(one) < arbitration_key(other)) == (first[differing] == "0")


@pytest.mark.parametrize(
    ("lower", "higher"),
    [
        (CanFrame(0x080), CanFrame(0x081)),
        (CanFrame(0x123, b"\xff" * 8), CanFrame(0x123, is_remote=True)),
        (CanFrame(0x123, is_remote=True), CanFrame(0x123 << 18, is_extended=True)),
        (CanFrame(0x123 << 18, is_extended=True), CanFrame(0x124)),
        (
            CanFrame(0x48C0001, b"", is_extended=True),
            CanFrame(0x48C0001, is_extended=True, is_remote=True),
        ),
    ],
)
def test_who_wins(lower: CanFrame, higher: CanFrame) -> None:
    """Lower identifier, data before remote, standard before extended of the same base."""
    assert arbitration_key(lower) < arbitration_key(higher)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: CanFrame(0x800), "800h does not fit into 11 bits"),
        (lambda: CanFrame(-1), "11 bits"),
        (lambda: CanFrame(0x20000000, is_extended=True), "29 bits"),
        (lambda: CanFrame(1, b"123456789"), "0 to 8 bytes"),
        (lambda: CanFrame(1, b"12", length=3), "2 bytes of data in a frame of length 3"),
        (lambda: CanFrame(1, b"12", is_remote=True), "a remote frame none"),
        (lambda: CanFrame(1, is_remote=True, length=9), "0 to 8 bytes"),
    ],
)
def test_what_no_controller_could_send_is_no_frame(make: object, words: str) -> None:
    """ValueError naming the value."""
    assert callable(make)
    with pytest.raises(ValueError, match=words):
        make()


def test_a_frame_shows_itself_as_candump_does() -> None:
    """So that a failing test reads like a trace."""
    assert str(CanFrame(0x601, bytes.fromhex("4000200000000000"))) == "601#4000200000000000"
    assert str(CanFrame(0x80)) == "080#"
    assert str(CanFrame(0x123, is_remote=True, length=8)) == "123#R8"
    assert str(CanFrame(0x123, is_extended=True, is_remote=True)) == "00000123#R"
