"""``axistwin run`` of CAN models: endpoints, what is said, memory, recordings, mistakes."""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import pytest
from can_clients import frame_of, message
from daemon_process import TIMEOUT_S, Daemon, assert_one_clear_line, daemon, invoke
from served_bus import POSITION, client, receive

from axistwin.catalog import DeviceSpec
from axistwin.cli.run.can import CanRun
from axistwin.cli.run.reporter import Reporter
from axistwin.cli.run.serving import Shared
from axistwin.errors import UsageError
from axistwin.ports import socketcan
from axistwin.ports.slcan import SlcanPort
from axistwin.runtime.serving.loop import Loop
from axistwin.wire.can_frame import CanFrame

pytestmark = pytest.mark.system

REPLY = CanFrame(0x581, bytes.fromhex("4200200000000000"))

WITHOUT_VCAN = pytest.mark.skipif(
    socketcan.link_state("vcan0") == "up", reason="vcan0 is up, and so the default"
)


def hub(folder: Path, *arguments: str, **options: Any) -> Any:
    """A daemon with an adapter at ``./can``."""
    return daemon(folder, *arguments, "--slcan", "./can", **options)


def ask(bus: can.BusABC, address: int, data: str) -> str:
    """The data of the reply to an SDO request, in hex digits."""
    bus.send(message(CanFrame(0x600 + address, bytes.fromhex(data))))
    return bytes(receive(bus, 0x580 + address).data).hex()


@contextlib.contextmanager
def adapter(folder: Path) -> Iterator[can.BusABC]:
    """A client of the daemon's adapter."""
    with client(f'can.Bus(interface="slcan", channel="{folder}/can")') as bus:
        yield bus


def ends_cleanly(process: Daemon) -> bool:
    """SIGTERM: status 0, and nothing said on stdout any more."""
    status, out, _ = process.end()
    return (status, out) == (0, "")


# ---- endpoints -----------------------------------------------------------------------------------


@WITHOUT_VCAN
def test_without_vcan_the_process_is_the_bus_and_says_so(tmp_path: Path) -> None:
    """An slcan pty at ./MODEL, the client's line, and how to get a vcan0."""
    with daemon(tmp_path, "mac23-can") as process:
        ready = process.line()
        link = tmp_path / "mac23-can"
        assert ready == f"ready mac23-can:1 slcan=./mac23-can ({link.readlink()})"
        with client(f'can.Bus(interface="slcan", channel="{link}")') as bus:
            bus.send(POSITION)
            assert frame_of(receive(bus, 0x581)) == REPLY
        status, out, err = process.end()
    assert (status, out) == (0, "")
    assert not os.path.lexists(link)
    choice, remedy, _ = err.splitlines()
    assert choice.endswith('clients: can.Bus(interface="slcan", channel="./mac23-can")')
    assert "to have vcan0: " in remedy
    assert "ip link" in remedy


def test_several_endpoints_and_modules_are_one_bus(tmp_path: Path) -> None:
    """Every endpoint is in the ready event; clients of all hear one another."""
    with hub(
        tmp_path,
        "mac23-can:1",
        "mac23-can:2",
        "--json",
        "--slcan-tcp",
        "127.0.0.1:0",
        "--socketcand",
        "127.0.0.1:0",
    ) as process:
        events = [process.event(), process.event()]
        assert [event["device"] for event in events] == ["mac23-can:1", "mac23-can:2"]
        ways = {each["endpoint"]: each["url"] for each in events[0]["endpoints"]}
        assert list(ways) == ["slcan", "slcan-tcp", "socketcand"]
        assert re.fullmatch(r"socket://127\.0\.0\.1:\d+", ways["slcan-tcp"])
        host, _, port = ways["socketcand"].removeprefix("can://").partition(":")
        with (
            adapter(tmp_path) as one,
            client(f'can.Bus(interface="slcan", channel="{ways["slcan-tcp"]}")') as two,
            can.Bus(interface="socketcand", channel="vcan0", host=host, port=int(port)) as three,
        ):
            one.send(POSITION)
            for listener in (two, three):
                assert receive(listener, 0x601).data == POSITION.data
                assert frame_of(receive(listener, 0x581)) == REPLY
            assert ask(three, 2, "4000200000000000") == "4200200000000000"
        names = [process.event()["event"] for _ in range(6)]
        assert sorted(names) == ["connected"] * 3 + ["disconnected"] * 3
        status, out, _ = process.end()
    assert status == 0
    assert json.loads(out)["event"] == "stopped"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP, signal.SIGTERM])
def test_signals_end_it_cleanly_with_a_client_connected(
    tmp_path: Path, number: signal.Signals
) -> None:
    """Status 0, the link removed, in the middle of a flood too."""
    with hub(tmp_path, "mac23-can") as process:
        process.line()
        terminal = os.open(tmp_path / "can", os.O_RDWR | os.O_NOCTTY)
        os.write(terminal, b"O\r" + b"t60184000200000000000\r" * 200)
        assert os.read(terminal, 1) == b"\r"
        status, _, err = process.end(number)
        os.close(terminal)
        assert status == 0
        assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_an_endpoint_that_is_taken_leaves_nothing(tmp_path: Path) -> None:
    """One clear line, status 2, and no link."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        link = str(tmp_path / "can")
        result = invoke("run", "mac23-can", "--slcan", link, "--socketcand", address)
    assert_one_clear_line(result, f"socketcand {address}", "choose another port")
    assert not os.path.lexists(link)


def test_an_address_that_others_reach_is_warned_of(tmp_path: Path) -> None:
    """There is no password."""
    with daemon(tmp_path, "mac23-can", "--slcan-tcp", "0.0.0.0:0") as process:
        assert process.line().startswith("ready mac23-can:1 slcan-tcp=socket://0.0.0.0:")
        _, _, err = process.end()
    assert "slcan-tcp 0.0.0.0: whoever reaches this address can drive the twin" in err


def test_a_bus_is_joined(tmp_path: Path) -> None:
    """Another daemon's adapter stands for one of metal; when that goes, the run ends with 2."""
    (tmp_path / "bench").mkdir()
    with hub(tmp_path / "bench", "mac23-can:9") as bench:
        bench.line()
        place = f"slcan:{tmp_path}/bench/can?sleep_after_open=0"
        with daemon(tmp_path, "mac23-can", "--can", place, "--slcan-tcp", "127.0.0.1:0") as process:
            ready = process.line()
            assert ready.startswith(f"ready mac23-can:1 can={place} slcan-tcp=socket://")
            with client(f'can.Bus(interface="slcan", channel="{ready.rpartition("=")[2]}")') as bus:
                assert ask(bus, 1, "4000200000000000") == "4200200000000000"
                assert ask(bus, 9, "4000200000000000") == "4200200000000000"
            bench.end()
            assert process.process.wait(TIMEOUT_S) == 2
            _, err = process.process.communicate()
    assert "Traceback" not in err
    assert f"axistwin: can {place}: the bus is gone (" in err.splitlines()[-1]


def test_systemd_is_told(tmp_path: Path) -> None:
    """When clients can connect, and of the end."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(TIMEOUT_S)
        environment = {"NOTIFY_SOCKET": str(tmp_path / "notify")}
        with hub(tmp_path, "mac23-can", environment=environment) as process:
            assert manager.recv(100) == b"READY=1"
            assert (tmp_path / "can").is_char_device()
            process.end()
            assert manager.recv(100) == b"STOPPING=1"


def test_the_how_to_s_canopen_program_converses(tmp_path: Path) -> None:
    """docs/how-to/run-on-can.md, as printed, from its own process."""
    page = Path(__file__).parents[2] / "docs" / "how-to" / "run-on-can.md"
    (program,) = re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    with daemon(tmp_path, "mac23-can", "--slcan", "./mac23-can") as process:
        process.line()
        done = subprocess.run(
            [sys.executable, "-c", program],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 0, done.stderr


# ---- the choice ----------------------------------------------------------------------------------


def chosen(capsys: pytest.CaptureFixture[str], **options: Any) -> tuple[list[str], str]:
    """The urls of the ports for these options, and what was said."""
    shared = Shared(None, None, (), 1.0, False, False, 0, None)
    given: dict[str, Any] = dict.fromkeys(("can", "slcan", "slcan_tcp", "socketcand"), ())
    run = CanRun([DeviceSpec("mac23-can", 1)], shared, **given, bitrate=None)
    with (
        contextlib.closing(Loop()) as loop,
        run.build() as bus,
        contextlib.closing(run.serve(bus, Reporter(False), loop)) as server,
    ):
        assert bus.is_paced is not any(port.kind == "can" for port in server.ports)
        return [port.url for port in server.ports], capsys.readouterr().err


@pytest.mark.parametrize("state", ["up", "down", "absent"])
def test_vcan0_is_joined_if_it_is_up(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], state: str
) -> None:
    """Else it is said why not."""
    monkeypatch.setattr(socketcan, "link_state", lambda name: state)
    urls, said = chosen(capsys)
    if state == "up":
        assert urls == ["socketcan:vcan0"]
        assert 'vcan0 is up, the modules join it; clients: can.Bus(interface="socketcan"' in said
        return
    assert urls == ["./mac23-can"]
    why = {"down": "vcan0 is down, so", "absent": "there is no vcan0, so"}[state]
    assert said.startswith(f"axistwin: {why} this process is the bus; clients: can.Bus(")


@pytest.mark.parametrize(
    ("has_can", "state", "name", "part"),
    [
        (False, "absent", "vcan0", "this kernel has no CAN; on one that has: sudo modprobe vcan"),
        (True, "absent", "vcan3", "sudo ip link add vcan3 type vcan && sudo ip link set vcan3 up"),
        (True, "down", "can0", "sudo ip link set can0 up"),
        (True, "absent", "can0", "there are vcan1, can4"),
    ],
)
def test_remedies_name_what_to_type(
    monkeypatch: pytest.MonkeyPatch, has_can: bool, state: str, name: str, part: str
) -> None:
    """For the interface in question."""
    monkeypatch.setattr(socketcan, "link_state", lambda _: state)
    monkeypatch.setattr(socketcan, "kernel_has_can", lambda: has_can)
    monkeypatch.setattr(socketcan, "interfaces", lambda: ["vcan1", "can4"])
    assert part in socketcan.remedy(name)


def test_states_of_interfaces_are_the_kernel_s() -> None:
    """The loopback is up; what is not there is absent, however long its name."""
    assert socketcan.link_state("lo") == "up"
    assert socketcan.link_state("nothing7") == "absent"
    assert socketcan.link_state("n" * 100) == "absent"


# ---- how the modules live ------------------------------------------------------------------------


def test_state_outlives_the_run(tmp_path: Path) -> None:
    """Parameters and an address given by LSS; a stored address is told."""
    arguments = ("mac23-can", "--state", "./state", "--speed", "20")
    with hub(tmp_path, *arguments) as process:
        process.line()
        with adapter(tmp_path) as bus:
            assert ask(bus, 1, "230C200000000040")[:2] == "60"
            for data in ("0401", "1105", "0400"):
                bus.send(message(CanFrame(0x7E5, bytes.fromhex(data).ljust(8, b"\0"))))
            receive(bus, 0x705)
        assert ends_cleanly(process)
    with hub(tmp_path, *arguments) as process:
        assert process.line().startswith("ready mac23-can:5 ")
        with adapter(tmp_path) as bus:
            ask(bus, 5, "4006200000000000")
        _, _, err = process.end()
    assert "mac23-can:1: its memory has address 5 (asked for: 1), and that holds" in err
    assert "volatile" not in err


def test_a_cold_start_boots_first(tmp_path: Path) -> None:
    """The boot-up is there two seconds of the module's later, for who listens by then."""
    with hub(tmp_path, "mac23-can", "--cold", "--speed", "0.5") as process:
        process.line()
        with adapter(tmp_path) as bus:
            bus.send(POSITION)
            message = bus.recv(TIMEOUT_S)
            assert message is not None
            assert (message.arbitration_id, bytes(message.data)) == (0x701, b"\0")


def test_no_pacing_takes_the_bus_out_of_the_time(tmp_path: Path) -> None:
    """What is left is the module's own latency, which is 0 here; any bit rate is right."""
    arguments = ("mac23-can", "--no-pacing", "--quirk", "reply_latency_us=0", "--bitrate", "10000")
    with hub(tmp_path, *arguments) as process:
        process.line()
        with can.Bus(
            interface="slcan", channel=f"{tmp_path}/can", bitrate=1_000_000, sleep_after_open=0
        ) as bus:
            took = []
            for _ in range(30):
                began = time.monotonic()
                ask(bus, 1, "4000200000000000")
                took.append(time.monotonic() - began)
    assert min(took) < 0.0216, "two frames at 10 kbit/s"


def test_the_bit_rate_is_that_of_the_bus(tmp_path: Path) -> None:
    """A client at another one hears nothing, and is told of."""
    with hub(tmp_path, "mac23-can", "--bitrate", "500000", "--json") as process:
        process.event()
        for bitrate, hears in ((125_000, False), (500_000, True)):
            with can.Bus(
                interface="slcan", channel=f"{tmp_path}/can", bitrate=bitrate, sleep_after_open=0
            ) as bus:
                bus.send(POSITION)
                assert (bus.recv(TIMEOUT_S if hears else 0.1) is not None) is hears
            names = [process.event()["event"] for _ in range(2 if hears else 3)]
            assert ("client_mistake" in names) is not hears
        _, _, err = process.end()
    assert err.count("opened at 125000 bit/s, the bus runs at 500000") == 1


# ---- recordings ----------------------------------------------------------------------------------


def test_capture_writes_what_candump_would(tmp_path: Path) -> None:
    """Every frame with the time of day; T for a host's, R for a module's; a second run appends."""
    began = time.time()
    for _ in range(2):
        with hub(tmp_path, "mac23-can", "--capture", "bus.log") as process:
            process.line()
            with adapter(tmp_path) as bus:
                for _ in range(300):
                    bus.send(POSITION)
                for _ in range(300):
                    receive(bus, 0x581)
            assert ends_cleanly(process)
    lines = (tmp_path / "bus.log").read_text("ascii").splitlines()
    assert len(lines) == 1200
    shape = r"\(\d+\.\d{6}\) vcan0 (601#4000200000000000 T|581#4200200000000000 R)"
    assert all(re.fullmatch(shape, line) for line in lines)
    with can.LogReader(tmp_path / "bus.log") as reader:
        logged = list(reader)
    assert [each.arbitration_id for each in logged].count(0x581) == 600
    times = [each.timestamp for each in logged]
    assert times == sorted(times)
    assert began < times[0] < times[-1] < time.time()
    shortest = min(later - earlier for earlier, later in pairwise(times))
    assert shortest == pytest.approx(0.00095, abs=0.0003), "a frame and its pause"


def test_a_recording_is_in_the_file_soon(tmp_path: Path) -> None:
    """While the run goes on."""
    with hub(tmp_path, "mac23-can", "--capture", "bus.log") as process:
        process.line()
        with adapter(tmp_path) as bus:
            ask(bus, 1, "4000200000000000")
            time.sleep(0.3)
            assert len((tmp_path / "bus.log").read_text("ascii").splitlines()) == 2
        process.process.kill()


def test_a_disk_that_fills_up_ends_the_capture_and_not_the_daemon(tmp_path: Path) -> None:
    """It is said once, as a line and as an event, and by status 2 at the end."""
    script = (
        "import resource, signal, sys; from axistwin.cli.main import main;"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300)); main()"
    )
    with hub(
        tmp_path, "mac23-can", "--json", "--capture", "bus.log", program=("-c", script)
    ) as process:
        assert process.event()["event"] == "ready"
        with adapter(tmp_path) as bus:
            for _ in range(10):
                ask(bus, 1, "4000200000000000")
            time.sleep(0.2)
            ask(bus, 1, "4000200000000000")
        names = [process.event()["event"] for _ in range(3)]
        assert sorted(names) == ["capture_lost", "connected", "disconnected"]
        status, _, err = process.end()
    assert status == 2
    assert err.count("capture bus.log: cannot be written any more (File too large)") == 1
    assert "Traceback" not in err


# ---- mistakes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("mac23-can", "mac23"), ["mac23-can:1", "mac23:0", "serial line", "once for each"]),
        (("mac23-can", "--pty", "x"), ["--pty is for a serial line", "--slcan"]),
        (("mac23-can", "--tcp", "127.0.0.1:0"), ["--tcp is for a serial line", "--slcan-tcp"]),
        (("mac23-can", "--rfc2217", "127.0.0.1:0"), ["--rfc2217 is for a serial line"]),
        (("mac23-can", "--baud", "9600"), ["--baud is for a serial line", "--bitrate"]),
        (("mac23", "--can", "socketcan:vcan0"), ["--can is for a CAN bus", "mac23:0", "--pty"]),
        (("mac23", "--slcan", "x"), ["--slcan is for a CAN bus"]),
        (("mac23", "--slcan-tcp", "127.0.0.1:0"), ["--slcan-tcp is for a CAN bus", "--tcp"]),
        (("mac23", "--socketcand", "127.0.0.1:0"), ["--socketcand is for a CAN bus"]),
        (("mac23", "--bitrate", "125000"), ["--bitrate is for a CAN bus", "--baud"]),
        (("mac23-can:0",), ["address 0 is out of range", "1..127"]),
        (("mac23-can", "--bitrate", "0"), ["bitrate 0 is out of range: 1..1000000"]),
        (("mac23-can", "--bitrate", "1000001"), ["bitrate 1000001 is out of range"]),
        (("mac23-can", "--slcan", ""), ["--slcan", "needs a name"]),
        (("mac23-can", "--slcan", "nowhere/x"), ["nowhere", "create it first"]),
        (("mac23-can", "--slcan-tcp", "5000"), ["'5000'", "HOST:PORT"]),
        (("mac23-can", "--socketcand", "127.0.0.1:x"), ["HOST:PORT"]),
        (("mac23-can", "--can", "vcan0"), ["'vcan0'", "socketcan:vcan0"]),
        (("mac23-can", "--can", "sockcan:vcan0"), ["did you mean socketcan?"]),
        (("mac23-can", "--can", "virtual:a", "--can", "virtual:b"), ["virtual:b", "one bus only"]),
        (("mac23-can", "--can", "socketcan:none7"), ["socketcan:none7", "no such interface"]),
        (("mac23-can", "--quirk", "zzz=1"), ["'zzz'", "axistwin models mac23-can"]),
        (("mac23-can", "--speed", "0"), ["speed", "0"]),
        (("mac23-can", "--slcan", "x", "--capture", "nowhere/log"), ["nowhere/log"]),
    ],
)
def test_a_mistake_is_one_clear_line_and_status_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], parts: list[str]
) -> None:
    """It names the value, what is allowed, and the remedy; nothing is left behind."""
    monkeypatch.chdir(tmp_path)
    assert_one_clear_line(invoke("run", *arguments), *parts)
    assert list(tmp_path.iterdir()) == []


def test_two_modules_with_one_address_are_warned_of(tmp_path: Path) -> None:
    """They may be what is wanted."""
    with hub(tmp_path, "mac23-can:3", "mac23-can:3") as process:
        process.line()
        _, _, err = process.end()
    assert "mac23-can:3 and mac23-can:3 disturb one another: address 3" in err


def test_one_bus_only_is_joined() -> None:
    """A second one would be another run's."""
    with pytest.raises(UsageError, match="one bus only"):
        with_rate(125_000, can=("virtual:a", "virtual:b"))


def with_rate(bitrate: int, **places: tuple[str, ...]) -> None:
    """A run on a bus of that rate, not started."""
    shared = Shared(None, None, (), 1.0, False, False, 0, None)
    given = {**dict.fromkeys(("can", "slcan", "slcan_tcp", "socketcand"), ()), **places}
    CanRun([DeviceSpec("mac23-can", 1)], shared, **given, bitrate=bitrate)


def test_a_rate_that_no_slcan_client_can_be_set_to_is_refused() -> None:
    """None of those that choose one would hear the bus; elsewhere it is a rate as any."""
    with pytest.raises(UsageError, match=r"bitrate 4000: no slcan client can .* 10000, 20000"):
        with_rate(4000, slcan=("./x",))
    with_rate(4000, socketcand=("127.0.0.1:0",))


@pytest.mark.parametrize("bitrate", [5_000, 33_333, 123_456, 666_666])
def test_a_rate_that_only_registers_set_is_told_with_them(
    bitrate: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """With that command adapter and bus understand one another; what a digit sets needs no word."""
    with_rate(bitrate, slcan_tcp=("127.0.0.1:0",))
    told = re.search(r"timing registers alone \((s[0-9A-F]{4})\)", capsys.readouterr().err)
    assert told is not None
    rights = []
    for command in ("S4", told[1]):
        port = SlcanPort(bitrate)
        port.receive(f"{command}\r".encode(), 0)
        rights.append(port.is_rate_right)
    assert rights == [False, True]
    with_rate(125_000, slcan_tcp=("127.0.0.1:0",))
    assert not capsys.readouterr().err
