"""``axistwin run --hid`` on a kernel with uhid: hidapi finds the board, and drives it."""

import importlib
import json
import os
import time
from pathlib import Path
from typing import Any

import pytest
from daemon_process import daemon

from axistwin.cli import doctor

pytestmark = pytest.mark.uhid

TIMEOUT_MS = 20_000


def ask(board: Any, text: bytes, timeout_ms: int = TIMEOUT_MS) -> bytes:
    """Send a report by hidapi, take the one that comes, without the padding."""
    assert board.write(b"\0" + text.ljust(64, b"\0")) == 65
    return bytes(board.read(64, timeout_ms)).rstrip(b"\0")


def refusal_s(board: Any) -> float:
    """How long it takes until hidapi is told that no report can be asked for."""
    begun = time.monotonic()
    with pytest.raises(OSError, match="read error"):
        board.get_input_report(0, 65)
    return time.monotonic() - begun


def test_hidapi_finds_two_boards_and_drives_one_through_a_move(tmp_path: Path) -> None:
    """By vendor and product; a pty beside it is the serial line of both."""
    hidapi: Any = importlib.import_module("hidraw")
    assert doctor.check_uhid() == "works"
    with daemon(tmp_path, "mn400:1", "mn400:2", "--hid", "--json") as process:
        ready = [json.loads(process.line()) for _ in range(2)]
        nodes = [event["url"] for event in ready]
        assert [event["endpoint"] for event in ready] == ["hid", "hid"]
        assert doctor.check_hidraw() == ", ".join(sorted(nodes))
        found = hidapi.enumerate(0x0461, 0x0020)
        assert {each["path"].decode(): each["serial_number"] for each in found} == {
            nodes[0]: "mn400:1",
            nodes[1]: "mn400:2",
        }
        board = hidapi.device()
        board.open(0x0461, 0x0020, "mn400:2")
        assert board.get_product_string() == "MN400"
        assert len(board.get_report_descriptor()) == 27
        assert ask(board, b"E") == b"E0,0,0,0"
        assert ask(board, b"M1000,-500", 50) == b""
        deadline = time.monotonic() + TIMEOUT_MS / 1000
        while ask(board, b"N") != b"N0,0,0,0":
            assert time.monotonic() < deadline
        assert ask(board, b"E") == b"E1000,-500,0,0"
        for _ in range(20):
            board.write(b"\0E")
        assert all(board.read(64, TIMEOUT_MS) for _ in range(20))
        # For a device that says nothing the kernel waits 5 s; on a busy machine we may be late.
        assert any(refusal_s(board) < 4 for _ in range(5))
        node = os.open(nodes[0], os.O_RDWR)
        status, _, err = process.end()
        assert (status, "Traceback" in err) == (0, False)
        with pytest.raises(OSError, match=r"No such device|Input/output error"):
            os.write(node, bytes(65))
        os.close(node)
    assert hidapi.enumerate(0x0461, 0x0020) == []
