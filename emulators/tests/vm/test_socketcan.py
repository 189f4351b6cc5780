"""``axistwin run`` on a kernel with CAN: vcan0 by itself, can-utils, canopen, a real can0."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import canopen_talk
import pytest
from can_clients import frame_of, message
from served_bus import ServedBus
from wire_fault_checks import check_bus

from axistwin.errors import PortError
from axistwin.ports import socketcan
from axistwin.ports.can_join import JoinPort
from axistwin.wire.can_frame import CanFrame

pytestmark = pytest.mark.vcan

TIMEOUT_S = 20.0
POSITION = CanFrame(0x601, bytes.fromhex("4000200000000000"))


@contextmanager
def running(folder: Path, *arguments: str, command: str = "run") -> Iterator[subprocess.Popen[str]]:
    """``axistwin run`` with ``arguments``, ready; ends with status 0 unless it has ended."""
    process = subprocess.Popen(
        [sys.executable, "-m", "axistwin", command, *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            assert process.wait(TIMEOUT_S) == 0
    finally:
        process.kill()
        process.communicate()


def first_line(process: subprocess.Popen[str]) -> str:
    """What it says on stdout first."""
    assert process.stdout is not None
    return process.stdout.readline().rstrip("\n")


@contextmanager
def dumping(interface: str, count: int) -> Iterator[subprocess.Popen[str]]:
    """``candump`` of that many requests and replies of module 1, running."""
    process = subprocess.Popen(
        ["candump", "-L", "-n", str(count), f"{interface},581:7FF,601:7FF"],
        stdout=subprocess.PIPE,
        text=True,
    )
    time.sleep(0.3)  # it says nothing when it is ready
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def dumped(process: subprocess.Popen[str]) -> list[str]:
    """The frames as candump shows them."""
    out, _ = process.communicate(timeout=TIMEOUT_S)
    return [line.split()[2] for line in out.splitlines()]


def cansend(interface: str, frame: str) -> None:
    """Send a frame by can-utils."""
    subprocess.run(["cansend", interface, frame], check=True, timeout=TIMEOUT_S)


def converse(bus: can.BusABC) -> None:
    """A position is asked for and told."""
    bus.send(message(POSITION))
    deadline = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
        answer = bus.recv(TIMEOUT_S)
        if answer is not None and answer.arbitration_id == 0x581:
            assert answer.data == bytes.fromhex("4200200000000000")
            return
    raise AssertionError("no answer")


def test_vcan0_is_chosen_where_it_is_up(tmp_path: Path) -> None:
    """It is said, with the line that a client needs, and that line works."""
    with running(tmp_path, "mac23-can:1", "mac23-can:2", "--json") as process:
        events = [json.loads(first_line(process)) for _ in range(2)]
        assert [event["device"] for event in events] == ["mac23-can:1", "mac23-can:2"]
        assert {(event["endpoint"], event["url"]) for event in events} == {
            ("can", "socketcan:vcan0")
        }
        with can.Bus(interface="socketcan", channel="vcan0") as bus:
            converse(bus)
        assert list(tmp_path.iterdir()) == []
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=TIMEOUT_S)
    assert 'vcan0 is up, the modules join it; clients: can.Bus(interface="socketcan"' in err


def test_cansend_and_candump_say_what_is_printed(tmp_path: Path) -> None:
    """docs/how-to/run-on-can.md: a position is read, a move is made, a mistake is refused."""
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "run-on-can.md").read_text("utf-8")
    requests = re.findall(r"^\$ cansend vcan0 (\S+)", page, re.MULTILINE)
    printed = [
        f"{identifier}#{data.replace(' ', '')}"
        for identifier, data in re.findall(r"^ \(.*vcan0  (...)   \[8\]  (.*)$", page, re.MULTILINE)
    ]
    assert len(printed) == 2 * len(requests) == 8
    with running(tmp_path, "mac23-can", "--can", "socketcan:vcan0") as process:
        assert first_line(process) == "ready mac23-can:1 can=socketcan:vcan0"
        with dumping("vcan0", len(printed)) as dump:
            for request in requests:
                cansend("vcan0", request)
                time.sleep(1.2)  # the move
            assert dumped(dump) == printed


def test_canopen_converses(tmp_path: Path) -> None:
    """Objects, a refusal, boot-up, lifebeat and the address, over real SocketCAN."""
    with running(tmp_path, "mac23-can", "--speed", "20") as process:
        assert first_line(process).startswith("ready")
        done = subprocess.run(
            [sys.executable, canopen_talk.__file__, "socketcan", "vcan0"],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert (done.returncode, done.stdout) == (0, "conversed\n"), done.stderr


def test_a_burst_of_requests_is_answered_entirely(tmp_path: Path) -> None:
    """In order; a reader's buffer holds that many while it does something else."""
    with (
        running(tmp_path, "mac23-can") as process,
        can.Bus(interface="socketcan", channel="vcan0") as bus,
    ):
        assert first_line(process).startswith("ready")
        requests = [bytes((0x40, 0, 0x20, i, 0, 0, 0, 0)) for i in range(100)]
        for request in requests:
            bus.send(message(CanFrame(0x601, request)), timeout=1)
        heard = [frame_of(bus.recv(5)) for _ in requests]
        assert [frame.data[3] for frame in heard] == [request[3] for request in requests]


def test_slcand_makes_a_can0_of_the_hub(tmp_path: Path) -> None:
    """The kernel's own driver on the hub's pty; can-utils, python-can and canopen over it."""
    with running(tmp_path, "mac23-can", "--slcan", "./adapter", "--speed", "20") as process:
        assert first_line(process).startswith("ready mac23-can:1 slcan=./adapter (/dev/pts/")
        tty = os.path.realpath(tmp_path / "adapter")
        daemon = subprocess.Popen(["slcand", "-F", "-o", "-c", "-s4", tty, "can7"])
        try:
            deadline = time.monotonic() + TIMEOUT_S
            while socketcan.link_state("can7") == "absent":
                assert time.monotonic() < deadline, "slcand made no interface"
                time.sleep(0.01)
            subprocess.run(["ip", "link", "set", "can7", "up"], check=True)
            with dumping("can7", 2) as dump:
                cansend("can7", "601#4000200000000000")
                assert dumped(dump) == ["601#4000200000000000", "581#4200200000000000"]
            with can.Bus(interface="socketcan", channel="can7") as bus:
                converse(bus)
            done = subprocess.run(
                [sys.executable, canopen_talk.__file__, "socketcan", "can7"],
                capture_output=True,
                text=True,
                timeout=60,
                check=False,
            )
            assert (done.returncode, done.stdout) == (0, "conversed\n"), done.stderr
        finally:
            daemon.terminate()
            daemon.wait(TIMEOUT_S)


def test_a_bus_that_goes_down_ends_the_run_with_one_clear_line(tmp_path: Path) -> None:
    """Status 2, without a traceback; a bus that is down cannot be joined."""
    with running(tmp_path, "mac23-can", "--can", "socketcan:vcan1") as process:
        assert first_line(process) == "ready mac23-can:1 can=socketcan:vcan1"
        subprocess.run(["ip", "link", "set", "vcan1", "down"], check=True)
        try:
            _, err = process.communicate(timeout=TIMEOUT_S)
            with pytest.raises(PortError, match=r"is down.*sudo ip link set vcan1 up"):
                JoinPort("socketcan:vcan1", 125_000).open()
        finally:
            subprocess.run(["ip", "link", "set", "vcan1", "up"], check=True)
    assert process.returncode == 2
    assert err.splitlines()[-1] == (
        "axistwin: can socketcan:vcan1: the bus is gone (Network is down); "
        "bring it back, and start again"
    )


def test_an_interface_that_is_not_there_comes_with_the_remedy() -> None:
    """How a vcan is made, and which interfaces there are."""
    assert socketcan.kernel_has_can()
    with pytest.raises(PortError, match=r"no such interface.*ip link add vcan9 type vcan"):
        JoinPort("socketcan:vcan9", 125_000).open()
    with pytest.raises(PortError, match=r"no such interface.*there are vcan"):
        JoinPort("socketcan:can9", 125_000).open()


def test_faults_of_the_wire_reach_a_host_on_vcan() -> None:
    """Every kind; and then all is as before."""
    with (
        can.Bus(interface="socketcan", channel="vcan0") as host,
        ServedBus(JoinPort("socketcan:vcan0", 125_000), paced=False) as bench,
    ):
        check_bus(bench.bus, host)


def test_a_tap_passes_on_between_two_interfaces(tmp_path: Path) -> None:
    """The module is on vcan1, the program on vcan0; a second tap only listens."""
    with (
        running(tmp_path, "mac23-can", "--can", "socketcan:vcan1") as process,
        running(tmp_path, "socketcan:vcan1", "heard.log", command="tap") as listener,
        running(
            *(tmp_path, "socketcan:vcan1", "passed.log", "--can", "socketcan:vcan0"), command="tap"
        ) as tap,
    ):
        for each in (process, listener, tap):
            assert first_line(each).startswith("ready ")
        with can.Bus(interface="socketcan", channel="vcan0") as bus:
            converse(bus)
    for path, ways in (("heard.log", ("", "")), ("passed.log", (" T", " R"))):
        rows = (tmp_path / path).read_text("utf-8").splitlines()
        assert [row.partition(" ")[2] for row in rows if " 081#" not in row] == [  # a lifebeat
            f"vcan1 601#4000200000000000{ways[0]}",
            f"vcan1 581#4200200000000000{ways[1]}",
        ]
