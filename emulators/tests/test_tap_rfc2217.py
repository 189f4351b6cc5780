"""``axistwin tap`` with RFC 2217 for the program: all settings and the modem lines pass through."""

import contextlib
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
from daemon_process import daemon
from served import TIMEOUT_S, eventually, hurry_rfc2217_clients

from axistwin.cli.tap.file import TapFile
from axistwin.cli.tap.line import LineTap
from axistwin.cli.tap.program import ProgramPort
from axistwin.runtime.serving.loop import Loop

# pyserial's own client does it that way.
pytestmark = [
    pytest.mark.system,
    pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning"),
]

QUERY = b"\x0201400200000000000A2\x03"
ANSWER_BYTES = 21


class DevicePort:
    """Stands for a serial port with a device, as pyserial has it: an echo, and what was done."""

    port = "/dev/ttyX"
    no_modem_lines = False

    def __init__(self) -> None:
        self.__dict__.update(
            baudrate=9600, bytesize=8, parity="N", stopbits=1, xonxoff=False, rtscts=False
        )
        self.__dict__.update(dtr=True, rts=True, break_condition=False, done=[])
        self.__dict__.update(lines={"cts": True, "dsr": False, "cd": False, "ri": False})
        self.__dict__.update(answers=bytearray(), is_here=threading.Event())

    def __getattr__(self, name: str) -> Any:
        if name not in self.__dict__["lines"]:
            raise AttributeError(name)
        if self.no_modem_lines:
            raise OSError("Inappropriate ioctl for device")
        return self.__dict__["lines"][name]

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "bytesize" and value == 5:
            raise ValueError("not a valid byte size: 5")
        if name in ("dtr", "rts") and self.no_modem_lines:
            raise OSError("Inappropriate ioctl for device")
        self.__dict__[name] = value
        self.done.append((name, value))

    def write(self, data: bytes) -> None:
        """Echo it."""
        self.done.append(("write", data))
        self.answers.extend(data)
        self.is_here.set()

    def read(self, count: int) -> bytes:
        """What there is, after a while."""
        self.is_here.wait(0.05)
        data = bytes(self.answers[:count])
        del self.answers[:count]
        if not self.answers:
            self.is_here.clear()
        return data

    @property
    def in_waiting(self) -> int:
        """How many bytes there are."""
        return len(self.answers)

    def flush(self) -> None:
        """Nothing waits."""

    def reset_input_buffer(self) -> None:
        """Noted."""
        self.done.append(("purge", "input"))

    def reset_output_buffer(self) -> None:
        """Noted."""
        self.done.append(("purge", "output"))


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """Where the recording is."""
    return tmp_path / "capture.txt"


@pytest.fixture(autouse=True)
def _impatient_client(monkeypatch: pytest.MonkeyPatch) -> None:
    hurry_rfc2217_clients(monkeypatch)


@contextlib.contextmanager
def tapped(port: DevicePort, capture: Path) -> Iterator[str]:
    """A tap of ``port``; the URL for the program."""
    ready = threading.Event()
    with (
        contextlib.closing(Loop()) as loop,
        contextlib.closing(TapFile(str(capture), print)) as file,
    ):
        program = ProgramPort("127.0.0.1:0")
        tap = LineTap(port, program, file, loop, lambda event: None)
        thread = threading.Thread(target=tap.run, args=(ready.set,))
        thread.start()
        try:
            assert ready.wait(TIMEOUT_S)
            yield program.url
        finally:
            loop.stop()
            thread.join(TIMEOUT_S)
            assert not thread.is_alive()


def remarks(capture: Path) -> list[str]:
    """The remarks of the recording."""
    return re.findall(r"^# /dev/ttyX (.*)$", capture.read_text("utf-8"), re.MULTILINE)


def test_settings_are_set_on_the_port_and_recorded(capture: Path) -> None:
    """Parity, data and stop bits, flow control, DTR, RTS and breaks, between the bytes."""
    port = DevicePort()
    with tapped(port, capture) as url:
        with serial.serial_for_url(url, 4800, parity="E", timeout=TIMEOUT_S) as client:
            client.write(b"one")
            assert client.read(3) == b"one"
            del port.done[:]
            client.dtr = False
            client.rts = False
            client.write(b"\xff\x00two")
            assert client.read(5) == b"\xff\x00two"
            client.break_condition = True
            client.break_condition = False
            client.parity, client.bytesize, client.stopbits = "O", 7, 2
            client.reset_output_buffer()
            assert eventually(lambda: ("purge", "output") in port.done)
        assert (port.baudrate, port.parity, port.bytesize, port.stopbits) == (4800, "O", 7, 2)
    told = [each for each in port.done if each[0] in ("dtr", "rts", "write", "break_condition")]
    assert told[:5] == [
        ("dtr", False),
        ("rts", False),
        ("write", b"\xff\x00two"),
        ("break_condition", True),
        ("break_condition", False),
    ]
    recorded = remarks(capture)
    assert recorded[0] == "9600 8N1"
    for expected in ("4800 8E1", "dtr off", "rts off", "break_condition on", "4800 7O2"):
        assert expected in recorded


def test_modem_lines_reach_the_program_when_they_change(capture: Path) -> None:
    """And are recorded."""
    port = DevicePort()
    with tapped(port, capture) as url, serial.serial_for_url(url, timeout=TIMEOUT_S) as client:
        assert (client.cts, client.dsr, client.cd, client.ri) == (True, False, False, False)
        port.lines.update(cts=False, dsr=True, ri=True)
        assert eventually(lambda: (client.cts, client.dsr, client.ri) == (False, True, True))
    assert {"cts on", "cts off", "dsr on", "ri on"} <= set(remarks(capture))


def test_a_port_without_modem_lines_holds_no_program_up(capture: Path) -> None:
    """As a pty: CTS and DSR seem to be on, DTR goes nowhere."""
    port = DevicePort()
    port.__dict__["no_modem_lines"] = True
    with tapped(port, capture) as url, serial.serial_for_url(url, timeout=TIMEOUT_S) as client:
        assert client.cts
        assert client.dsr
        client.dtr = False
        client.write(b"still")
        assert client.read(5) == b"still"
    assert "# dtr False cannot be set: Inappropriate ioctl" in capture.read_text("utf-8")


def test_a_setting_that_the_port_refuses_is_refused(capture: Path) -> None:
    """The program is told what is set instead."""
    port = DevicePort()
    with (
        tapped(port, capture) as url,
        serial.serial_for_url(url, timeout=TIMEOUT_S) as client,
        pytest.raises(ValueError, match="rejected"),
    ):
        client.bytesize = 5
    assert port.bytesize == 8
    assert "# bytesize 5 cannot be set" in capture.read_text("utf-8")


def test_parity_reaches_a_twin_through_two_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With parity it does not understand; without it does."""
    monkeypatch.chdir(tmp_path)
    with daemon(tmp_path, "mac23", "--rfc2217", "127.0.0.1:0", "--json") as twin:
        place = twin.event()["url"]
        with daemon(
            tmp_path, place, "capture.txt", "--rfc2217", "127.0.0.1:0", command="tap"
        ) as tap:
            url = tap.line().split()[2]
            with serial.serial_for_url(url, 38400, timeout=TIMEOUT_S) as port:
                port.write(QUERY)
                assert len(port.read(ANSWER_BYTES)) == ANSWER_BYTES
                port.parity, port.timeout = "E", 0.5
                port.write(QUERY)
                assert len(port.read(ANSWER_BYTES)) < ANSWER_BYTES
            assert tap.end()[0] == 0
    assert f"# {place} 38400 8E1" in Path("capture.txt").read_text("utf-8")
