"""``axistwin.hid``: hidapi's interface to the twins of this process."""

import importlib
import threading
from typing import Any

import pytest
import serial

from axistwin import hid, testing
from axistwin.devices.mn400.link.packets import packet

VIRTUAL = b"axistwin://mn400?time=virtual"


def opened(path: bytes = VIRTUAL) -> hid.HidapiDevice:
    """A board that is plugged in."""
    board = hid.device()
    board.open_path(path)
    return board


def ask(board: hid.HidapiDevice, text: bytes, timeout_ms: int = 100) -> bytes:
    """Send a report, take the one that comes, without the padding."""
    board.write(b"\0" + text.ljust(64, b"\0"))
    return bytes(board.read(64, timeout_ms)).rstrip(b"\0")


def test_it_has_what_hidapi_has() -> None:
    """Each method of hidapi's device, and both ways to find one."""
    hidapi: Any = importlib.import_module("hidraw")
    methods = {name for name in dir(hidapi.device) if not name.startswith("_")}
    assert len(methods) > 10
    assert methods <= set(dir(hid.device))
    found = hidapi.enumerate(0x0461, 0x0020)  # of this machine
    board = opened()
    assert board.get_product_string() == "MN400"
    for told in found:
        assert set(told) == set(hid.enumerate()[0])


def test_a_board_is_found_by_vendor_and_product() -> None:
    """Each in the order in which it was made; the serial number is the twin's name."""
    first = opened(b"axistwin://mn400:5?time=virtual")
    second = opened(b"axistwin://mac23,mn400:6?time=virtual")
    ours = ("mn400:5", "mn400:6")  # others may linger until they are collected
    found = [each for each in hid.enumerate(0x0461, 0x0020) if each["serial_number"] in ours]
    assert [each["serial_number"] for each in found] == ["mn400:5", "mn400:6"]
    assert hid.enumerate(0x0461, 0x0021) == []
    assert ask(second, b"L1,2,3,4") == b""
    other = hid.device()
    other.open(0x0461, 0x0020, "mn400:6")
    assert ask(other, b"E") == b"E1,2,3,4"
    third = hid.device()
    third.open_path(found[0]["path"])
    assert (third.get_serial_number_string(), third.twin) == ("mn400:5", first.twin)


def test_what_is_not_there_cannot_be_opened() -> None:
    """In hidapi's errors, with the remedy."""
    board = hid.device()
    with pytest.raises(OSError, match=r"no twin .* 1234:0020 and serial number x; open_path"):
        board.open(0x1234, 0x20, "x")
    with pytest.raises(OSError, match="give a path of enumerate"):
        board.open_path(b"/dev/hidraw0")
    with pytest.raises(OSError, match="no device there has USB"):
        board.open_path(b"axistwin://mac23?time=virtual")
    with pytest.raises(OSError, match="unknown model 'mn4000'"):
        board.open_path(b"axistwin://mn4000")
    for call in (lambda: board.read(64), lambda: board.write(b"\0E"), board.error):
        with pytest.raises(ValueError, match="not open"):
            call()
    board.open_path(VIRTUAL)
    with pytest.raises(RuntimeError, match="already open"):
        board.open_path(VIRTUAL)


def test_a_move_takes_the_time_of_the_twin() -> None:
    """Virtual time passes in reads, and not otherwise."""
    board = opened()
    assert ask(board, b"M1000", 100) == b""
    assert board.virtual_time_ns == 100_000_000
    assert ask(board, b"N") != b"N0,0,0,0"
    assert board.virtual_time_ns == 100_000_000
    assert board.read(64, 2000) == []
    assert ask(board, b"E") == b"E1000,0,0,0"


def test_a_read_ends_when_the_report_comes() -> None:
    """With a time-out and without; E1 measures for 100 ms."""
    board = opened()
    assert ask(board, b"E1", 5000) == b"E0,0,0,0,0"
    assert board.virtual_time_ns == 100_000_000
    board.write(b"\0E1")
    assert board.read(4) == list(b"E0,0")
    assert board.virtual_time_ns == 200_000_000
    with pytest.raises(OSError, match="nothing will ever come"):
        board.read(64)


def test_a_read_that_must_not_wait_takes_a_frame_of_usb() -> None:
    """A loop that polls comes to its end."""
    board = opened()
    board.set_nonblocking(1)
    board.write(b"\0E1")
    polls = 0
    while not board.read(64):
        polls += 1
    assert polls == 99  # of 1 ms, and then the one that finds it
    board.set_nonblocking(0)
    assert ask(board, b"*") == b"*\x16"


def test_a_report_may_be_short_and_has_a_number_or_none() -> None:
    """More than 64 bytes, and none, are not sent."""
    board = opened()
    assert [board.write(data) for data in (b"\0E", b"E", b"", bytes(66))] == [2, 1, -1, -1]
    assert [bytes(board.read(64, 10))[:2] for _ in range(3)] == [b"E0", b"E0", b""]
    assert board.write(b"E".ljust(64, b"\0")) == 64
    assert board.send_feature_report(b"\0E") == -1
    for ask_for in (board.get_feature_report, board.get_input_report):
        with pytest.raises(OSError, match="no such report"):
            ask_for(0, 65)


def test_line_and_usb_lead_to_the_same_board() -> None:
    """What the line sets, USB reads; each port has its own last message."""
    port: Any = serial.serial_for_url("axistwin://mn400?time=virtual&line=both", timeout=1)
    board = opened(b"axistwin://?line=both")
    port.write(packet(1, b"L5,6,7,8"))
    assert port.read(12)[-4:] == bytes.fromhex("05 00 81 53")
    assert ask(board, b"E") == b"E5,6,7,8"
    assert ask(board, b"&") == b"&5,6,7,8"
    assert port.in_waiting == 0
    board.close()
    board.open(serial_number=port.twins[0].name)
    assert ask(board, b"E") == b"E5,6,7,8"


def test_a_board_of_the_fixture_is_found() -> None:
    """In virtual time, where it is in this process."""
    with testing.start("mn400:78", time="virtual") as twin:
        board = hid.device()
        board.open(0x0461, 0x0020, "mn400:78")
        board.write(b"\0L4,3,2,1")
        assert twin.counters == [4, 3, 2, 1]
        assert ask(board, b"X3") == b"X\x0e"
        assert ask(board, b"S") == b"S0"
        told = [row.partition(" ms ")[2] for row in twin.transcript.splitlines()]
        board.close()
    assert [row for row in told if "USB" in row] == [
        "* test: USB > L4,3,2,1",
        "* test: USB > X3",
        "* mn400:78: USB < 58 0E",
        "* test: USB > S",
        "* mn400:78: USB < S0",
    ]


def test_a_board_without_power_is_silent_and_nothing_old_is_read() -> None:
    """What came before a program opened the device is not for it."""
    board = opened(b"axistwin://mn400:77?time=virtual&line=dark")
    board.twin.power_off()
    assert ask(board, b"*") == b""
    board.twin.power_on()
    board.write(b"\0*")
    path = next(each["path"] for each in hid.enumerate() if each["serial_number"] == "mn400:77")
    twin = board.twin
    board.close()
    assert twin.is_powered
    board.open_path(path)
    assert board.twin is twin
    assert board.read(64, 10) == []


def test_in_real_time_a_read_waits_and_another_thread_ends_it() -> None:
    """By closing the device, whether the read has begun or not."""
    board = opened(b"axistwin://mn400?time=20")
    assert ask(board, b"E1", 10_000) == b"E0,0,0,0,0"
    found: list[object] = []

    def read() -> None:
        try:
            found.append(board.read(64))
        except ValueError as error:
            found.append(str(error))

    thread = threading.Thread(target=read)
    thread.start()
    board.close()
    thread.join(20)
    assert found in ([[]], ["not open"])
