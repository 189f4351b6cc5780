"""Packets of an MN400: every byte example of the manual, and the forms of the replies."""

import pytest

from axistwin.devices.mn400.link.packets import (
    ReturnCode,
    completed,
    data_packet,
    packet,
    report,
    report_text,
    status,
)
from axistwin.devices.mn400.quirks import Mn400Quirks, parse_quirks

DEFAULT = Mn400Quirks()


def test_the_request_of_the_manual_has_the_printed_sum() -> None:
    """M1000 to board 1."""
    assert packet(1, b"M1000") == bytes.fromhex("81 4D 31 30 30 30 81 10")


@pytest.mark.parametrize(
    ("board", "command", "code", "written"),
    [
        (1, "*", ReturnCode.START, "81 2A 03 00 81 2F"),
        (1, "*", ReturnCode.PRESENT, "81 2A 16 00 81 42"),
        (1, "*", ReturnCode.DONE, "81 2A 05 00 81 31"),
        (1, "K", ReturnCode.START, "81 4B 03 00 81 50"),
        (1, "K", ReturnCode.NOMOVEPENDING, "81 4B 10 00 81 5D"),
        (1, "=", ReturnCode.START, "81 3D 03 00 81 42"),
        (5, "=", ReturnCode.DONE, "85 3D 05 00 85 4C"),
        (1, "~", ReturnCode.START, "81 7E 03 00 81 03"),
        (1, "~", ReturnCode.BAUDCHANGEOK, "81 7E 12 00 81 12"),
        (5, "~", ReturnCode.START, "85 7E 03 00 85 0B"),
        (5, "~", ReturnCode.BAUDCHANGEOK, "85 7E 12 00 85 1A"),
        (1, "&", ReturnCode.DONE, "81 26 05 00 81 2D"),
    ],
)
def test_status_packets_of_the_manual(
    board: int, command: str, code: ReturnCode, written: str
) -> None:
    """Every one that is printed or follows from one (ledger §2.3)."""
    assert status(board, ord(command), code, DEFAULT) == bytes.fromhex(written)


@pytest.mark.parametrize(
    ("trailer", "tail"),
    [
        ("06", "06 81 34"),
        ("0600", "06 00 81 34"),
        ("none", "81 2E"),
        ("00", "00 81 2E"),
        ("05", "05 81 33"),
        ("0500", "05 00 81 33"),
    ],
)
def test_the_data_packet_of_the_manual_is_told_right(trailer: str, tail: str) -> None:
    """The example with its commas and zeros, and the sum that belongs to each trailer."""
    quirks = parse_quirks({"data_packet_trailer": trailer})
    written = bytes.fromhex("81 45 35 34 35 35 2C 30 2C 30 2C 30" + tail)
    assert data_packet(1, ord("E"), "5455,0,0,0", quirks) == written


def test_the_bytes_of_the_example_can_be_had_with_their_right_sum() -> None:
    """2E 00 in the place of a comma and a zero: the printed sum is wrong for these."""
    quirks = parse_quirks({"data_value_encoding": "dot_nul"})
    told = data_packet(1, ord("E"), "5455,0,0,0", quirks)
    assert told == bytes.fromhex("81 45 35 34 35 35 2E 00 2E 00 2E 00 06 81 2A")


def test_a_null_behind_other_codes_is_a_quirk() -> None:
    """START, DONE and PRESENT keep theirs."""
    quirks = parse_quirks({"outcome_null": False})
    assert status(1, ord("K"), ReturnCode.NOMOVEPENDING, quirks).hex() == "814b10815d"
    assert len(status(1, ord("K"), ReturnCode.START, quirks)) == 6


def test_a_sum_has_seven_bits_and_may_be_any_character() -> None:
    """It is never looked at for its meaning."""
    lines = [b"L" + b"," * (n % 4) + b"9" * (n // 40) + b"%d" % (n // 4 % 10) for n in range(1000)]
    assert {packet(1, line)[-1] for line in lines} == set(range(128))


def test_a_packet_without_its_sum_is_completed() -> None:
    """Anything else stays as it is."""
    assert completed(bytes.fromhex("81 2A 81")) == bytes.fromhex("81 2A 81 2C")
    for other in (b"", b"\x81\x81", b"\x81*\x82", b"abc", bytes.fromhex("81 2A 81 2C")):
        assert completed(other) == other


def test_a_report_has_64_bytes_of_which_48_are_looked_at() -> None:
    """What is behind a null is not looked at either."""
    assert report(b"*\x16") == b"*\x16" + bytes(62)
    assert len(report(bytes(80))) == 64
    assert report_text(b"E\x00M5") == b"E"
    assert report_text(b"L1,2,3," + b"0" * 33 + b"123456789" + bytes(15))[-8:] == b"12345678"
