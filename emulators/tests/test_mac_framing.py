"""The codec of the module's side: sums, numbers, answers (ledger §2)."""

import pytest

from axistwin.devices.mac.serial.framing import answer, checksum, number, request


@pytest.mark.parametrize(
    ("body", "digits"),
    [
        (b"00150000000320", b"AB"),
        (b"00200000000000", b"A2"),
        (b"00160003E81000", b"C8"),
        (b"011E0003E81000", b"D8"),
        (b"00000000000", b"10"),
    ],
)
def test_the_ledgers_sums(body: bytes, digits: bytes) -> None:
    """§2.4 and §2.5."""
    assert checksum(body) == digits


def test_a_request_has_21_bytes_with_the_literal_length() -> None:
    """MACS-FRAME-01, -02."""
    frame = request(0x7F, 0x28, 0xDEADBEEF, 0xAF)
    assert frame[:18] == b"\x020147F28AFDEADBEEF"
    assert len(frame) == 21


def test_an_answer_has_21_bytes_with_the_literal_length() -> None:
    """MACS-REPLY-07, -10."""
    assert answer(b"00", b"0", 0) == bytes.fromhex(
        "06 13 02 30 31 31 30 30 30 30 30 30 30 30 30 30 30 31 30 03 1A"
    )


@pytest.mark.parametrize("text", [b"+1", b" 1", b"1_0", b"0x1F", b"1 ", b"-1", b"G0", b"\xb2\xb3"])
def test_what_int_would_take_is_no_number(text: bytes) -> None:
    """Ledger §8.10."""
    assert number(text, any_case=True) is None


def test_case_matters_unless_told_otherwise() -> None:
    """MACS-FRAME-04, ``lowercase_hex``."""
    assert number(b"AB", any_case=False) == 0xAB
    assert number(b"ab", any_case=False) is None
    assert number(b"aB", any_case=True) == 0xAB
