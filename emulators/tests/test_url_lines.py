"""What an ``axistwin://`` URL can say, who shares a line, and how virtual time passes."""

import gc
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
from mac_frames import ACCEPTED, ANSWER_LENGTH, ask, request

import axistwin
from axistwin.errors import UsageError
from axistwin.runtime.storage import Storage
from axistwin.urlhandler import lines
from axistwin.urlhandler.protocol_axistwin import PATIENCE_NS
from axistwin.urlhandler.url import _PARAMETERS, parse_speed, parse_url

QUERY = request(0x20)
BYTE_NS = 260_416
EXCHANGE_NS = 11_937_500
"""21 bytes, 1 ms until the module answers, 21 bytes (MACS-REPLY-16 and the ledger's table)."""


def open_url(url: str, **settings: Any) -> Any:
    """``url`` opened at the module's rate, with half a second of patience."""
    return serial.serial_for_url(url, **{"baudrate": 38400, "timeout": 0.5, **settings})


def command(port: Any, index: int, parameter: int = 0, address: int = 0) -> bytes:
    """The reply to a command."""
    port.write(request(index, parameter, address))
    return bytes(port.read(3))


@pytest.fixture
def port() -> Iterator[Any]:
    """A module in virtual time."""
    with open_url("axistwin://mac23?address=0&time=virtual") as port:
        yield port


# -- virtual time ---------------------------------------------------------------------------------


def test_an_exchange_takes_its_bytes_and_the_latency(port: Any) -> None:
    """Virtual time is exact to the nanosecond."""
    ask(port, 0x20)
    assert port.virtual_time_ns == EXCHANGE_NS


def test_time_stands_while_the_host_computes(port: Any) -> None:
    """Neither real time nor a write makes it pass."""
    port.write(QUERY)
    time.sleep(0.01)
    assert port.virtual_time_ns == 0


def test_an_hour_of_waiting_takes_no_time(port: Any) -> None:
    """A long time-out, and a long ``advance``, return at once."""
    start = time.process_time()
    port.timeout = 3600
    assert port.read(1) == b""
    port.advance(3600)
    assert port.virtual_time_ns == 7200 * 10**9
    assert time.process_time() - start < 0.5


def test_an_hour_of_motion_takes_no_time(port: Any) -> None:
    """A move of 36 million increments at 10000/s, without a poll: it ends where it should."""
    assert command(port, 0x0D, 800) == ACCEPTED
    assert command(port, 0x0F, 10) == ACCEPTED
    start = time.process_time()
    assert command(port, 0x13, 36_000_000) == ACCEPTED
    port.advance(1800)
    assert 17_990_000 < ask(port, 0x20) < 18_010_000
    port.advance(1801)
    assert ask(port, 0x20) == 36_000_000
    assert time.process_time() - start < 1


def test_a_read_that_would_wait_for_ever_says_so(port: Any) -> None:
    """Nothing was asked, so nothing can arrive: an error instead of a hang, and no time passes."""
    port.timeout = None
    with pytest.raises(serial.SerialException, match="virtual time: nothing will ever arrive"):
        port.read(1)
    assert port.virtual_time_ns == 0


def test_a_read_of_more_than_the_answer_says_so_too(port: Any) -> None:
    """The answer comes and is too short; it can still be read afterwards."""
    port.timeout = None
    port.write(QUERY)
    with pytest.raises(serial.SerialException, match="nothing will ever arrive"):
        port.read(ANSWER_LENGTH + 1)
    assert port.virtual_time_ns < PATIENCE_NS
    assert port.in_waiting == ANSWER_LENGTH
    port.write(QUERY)
    assert len(port.read(2 * ANSWER_LENGTH)) == 2 * ANSWER_LENGTH


def test_an_endless_motion_does_not_keep_a_read_waiting_for_ever(port: Any) -> None:
    """A motor that turns without end sends nothing by itself (MACS-REPLY-12)."""
    assert command(port, 0x15, 800) == ACCEPTED
    port.timeout = None
    start = time.process_time()
    with pytest.raises(serial.SerialException, match="nothing will ever arrive"):
        port.read(1)
    assert time.process_time() - start < 5


def test_events_that_never_end_do_not_keep_a_read_waiting_for_ever(
    port: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line on which something is always due, and nothing is ever said, is given up on."""
    hour_ns = 3600 * 10**9
    monkeypatch.setattr(type(port.line), "next_event_ns", lambda line: line.sync() + hour_ns)
    port.timeout = None
    with pytest.raises(serial.SerialException, match="nothing will ever arrive"):
        port.read(1)
    assert port.virtual_time_ns == PATIENCE_NS


def test_a_look_at_in_waiting_takes_one_byte_time(port: Any) -> None:
    """So that a loop that polls it ends."""
    before = port.virtual_time_ns
    assert port.in_waiting == 0
    assert port.virtual_time_ns - before == BYTE_NS


def test_a_poll_with_timeout_zero_takes_one_byte_time(port: Any) -> None:
    """Only when there is nothing to be had."""
    port.timeout = 0
    assert port.read(1) == b""
    assert port.virtual_time_ns == BYTE_NS
    port.write(QUERY)
    port.advance(0.1)
    before = port.virtual_time_ns
    assert len(port.read(100)) == ANSWER_LENGTH
    assert port.virtual_time_ns == before


def test_read_stops_at_the_byte_asked_for(port: Any) -> None:
    """Time moves to the arrival of the last byte wanted, not beyond."""
    port.write(QUERY)
    port.read(1)
    assert EXCHANGE_NS - 20 * BYTE_NS - 20 <= port.virtual_time_ns <= EXCHANGE_NS - 20 * BYTE_NS


def test_flush_advances_to_the_last_stop_bit(port: Any) -> None:
    """21 bytes at 38400 baud are 5.46875 ms."""
    port.write(QUERY)
    port.flush()
    assert port.virtual_time_ns == 5_468_750


def test_send_break_takes_its_duration(port: Any) -> None:
    """In virtual time, like everything else; one bit of rest belongs to it."""
    port.send_break(0.25)
    assert 250_000_000 < port.virtual_time_ns <= 250_000_000 + BYTE_NS // 10 + 1


def test_output_stopped_by_xoff_is_an_error_and_no_hang(port: Any) -> None:
    """The reply's 13h stops the output, and nothing will ever start it again (MACS-LINE-02)."""
    port.xonxoff = True
    assert command(port, 0x0B) == ACCEPTED.replace(b"\x13", b"")
    port.write(QUERY)
    with pytest.raises(serial.SerialException, match="nothing will ever arrive"):
        port.flush()


@pytest.mark.parametrize("seconds", [-1, float("nan"), float("inf"), 1e13])
def test_time_neither_goes_back_nor_ends(port: Any, seconds: float) -> None:
    """``advance`` takes 0 or more, and no more than a clock can show."""
    with pytest.raises(ValueError, match=r"is out of range: 0\.\.1e\+12 s"):
        port.advance(seconds)


def test_only_virtual_time_can_be_moved() -> None:
    """Real time passes by itself."""
    with (
        open_url("axistwin://mac23") as port,
        pytest.raises(serial.SerialException, match="only virtual time can be moved"),
    ):
        port.advance(1)


def test_time_stands_while_the_port_is_closed(port: Any) -> None:
    """Twins stay powered and wait; the line and the twins can be looked at meanwhile."""
    ask(port, 0x20)
    port.close()
    assert port.virtual_time_ns == EXCHANGE_NS
    assert port.twins[0].position == 0
    port.open()
    assert port.virtual_time_ns == EXCHANGE_NS


def test_scaled_time_runs_faster_than_the_host() -> None:
    """Time-outs are the host's seconds; meanwhile more of the twin's pass."""
    with open_url("axistwin://mac23?time=100", timeout=0.05) as port:
        start = port.virtual_time_ns
        assert port.read(1) == b""
        assert port.virtual_time_ns - start >= 5 * 10**9


# -- what a URL can say ---------------------------------------------------------------------------


def test_several_devices_share_the_line() -> None:
    """Each answers at its address, and only there."""
    with open_url("axistwin://mac23:0,mac34-1:5?time=virtual") as port:
        assert [twin.name for twin in port.twins] == ["mac23:0", "mac34-1:5"]
        assert command(port, 0x13, 100, address=5) == ACCEPTED
        port.advance(1)
        assert ask(port, 0x20, address=5) == 100
        assert ask(port, 0x20, address=0) == 0
        port.write(request(0x20, address=1))
        assert port.read(1) == b""


@pytest.mark.parametrize(
    "url",
    [
        "axistwin://mac23:7?time=virtual",
        "axistwin://mac23:7h/?time=virtual",
        "axistwin://mac23?address=0x7&time=virtual",
    ],
)
def test_an_address_can_be_written_in_two_places(url: str) -> None:
    """Behind the name or as a parameter, decimal or hexadecimal."""
    with open_url(url) as port:
        assert ask(port, 0x20, address=7) == 0


def test_the_scheme_is_not_case_sensitive() -> None:
    """As pyserial has it for its own."""
    with open_url("AxisTwin://mac23?time=virtual") as port:
        assert ask(port, 0x20) == 0


def test_cold_devices_start_up_first() -> None:
    """For 2 s after the supply is applied, nothing is heard (MACS-CMD-00-02, MACS-AMB-21)."""
    with open_url("axistwin://mac23?time=virtual&cold=yes") as port:
        port.write(QUERY)
        assert port.read(1) == b""
        port.advance(2)
        assert ask(port, 0x20) == 0


def test_baud_is_the_rate_the_devices_left_the_factory_with() -> None:
    """A module stored at 9600 baud is found there."""
    with open_url("axistwin://mac23?time=virtual&baud=9600", baudrate=9600) as port:
        assert ask(port, 0x20) == 0


def test_without_pacing_only_the_devices_take_time() -> None:
    """The module's own millisecond stays."""
    with open_url("axistwin://mac23?time=virtual&pacing=no") as port:
        assert ask(port, 0x20) == 0
        assert port.virtual_time_ns == 1_000_000


def test_quirks_come_from_the_url_and_from_a_profile(tmp_path: Path) -> None:
    """The URL beats the file."""
    profile = tmp_path / "unit 7+8.toml"
    profile.write_text('model = "mac23"\n[quirks]\nxon_byte = "11h"\n')
    with open_url(f"axistwin://mac23?time=virtual&profile={profile}") as port:
        assert command(port, 0x0B) == b"\x06\x13\x11"
    with open_url(f"axistwin://mac23?profile={profile}&time=virtual&quirk.xon_byte=1Ah") as port:
        assert command(port, 0x0B) == ACCEPTED


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("axistwin://", "names no device"),
        ("axistwin://?line=nobody", "there is no line nobody, not yet"),
        ("axistwin://mac24", "unknown model 'mac24': did you mean mac23"),
        ("axistwin://mac23:80h", "address 80h.*out of range"),
        ("axistwin://mac23:x", "address 'x' of mac23 is no number"),
        ("axistwin://mac23:1?address=2", "address=2: is for one device without an address"),
        ("axistwin://mac23,mac23?address=2", "address=2: is for one device without an address"),
        ("axistwin://mac23,?time=virtual", "a device is missing at a comma"),
        ("axistwin://mac23?speed=20", "unknown parameter speed: write time=20"),
        ("axistwin://mac23?tim=virtual", "unknown parameter tim: did you mean time"),
        ("axistwin://mac23?time=later", "time=later: use virtual, real, or a speed"),
        ("axistwin://mac23?time=0", "time=0: use virtual, real, or a speed"),
        ("axistwin://mac23?time=nan", "time=nan: use virtual, real, or a speed"),
        ("axistwin://mac23?time=1e9", "speed 1e.09 is out of range"),
        ("axistwin://mac23?time", "time: no value given"),
        ("axistwin://mac23?time=real&time=virtual", "time: given twice"),
        ("axistwin://mac23?pacing=off", "pacing=off: use yes or no"),
        ("axistwin://mac23?seed=-1", "seed=-1: use a whole number, 0 or above"),
        ("axistwin://mac23?baud=many", "baud=many: use a whole number, 1 or above"),
        ("axistwin://mac23?baud=12345", "baud 12345 is no rate of mac23"),
        ("axistwin://mac23?quirk.xon_bite=11h", "unknown quirk 'xon_bite': did you mean xon_byte"),
        ("axistwin://mac23?profile=/nowhere.toml", "profile /nowhere.toml: cannot be read"),
        ("axistwin://mac23?state=/dev/null", "state /dev/null: cannot be used"),
    ],
)
def test_a_mistake_in_a_url_is_one_clear_line(url: str, message: str) -> None:
    """Every mistake comes out as pyserial's own error, and the port stays closed."""
    port = serial.serial_for_url(url, do_not_open=True)
    with pytest.raises(serial.SerialException, match=message) as caught:
        port.open()
    assert "\n" not in str(caught.value)
    assert not port.is_open


def test_a_port_without_a_name_cannot_be_opened() -> None:
    """As pyserial has it."""
    port = serial.serial_for_url("axistwin://mac23", do_not_open=True)
    port.port = None
    with pytest.raises(serial.SerialException, match="Port must be configured"):
        port.open()
    with pytest.raises(serial.PortNotOpenError):
        port.virtual_time_ns  # type: ignore[attr-defined]  # noqa: B018


def test_another_name_is_another_line() -> None:
    """Setting ``port`` on an open object closes the one and opens the other."""
    with open_url("axistwin://mac23:1?time=virtual") as port:
        assert ask(port, 0x20, address=1) == 0
        port.port = "axistwin://mac23:2?time=virtual"
        assert ask(port, 0x20, address=2) == 0
        assert port.virtual_time_ns == EXCHANGE_NS


def test_only_our_scheme_is_taken_apart() -> None:
    """A handler of ours is never given another scheme by pyserial, but may be by somebody."""
    with pytest.raises(UsageError, match="expected axistwin://MODEL"):
        parse_url("loop://mac23")


def test_a_speed_may_be_a_number() -> None:
    """From Python, that is what one writes."""
    assert parse_speed(20) == parse_speed("20") == 20.0
    assert parse_speed("virtual") is None


def test_importing_the_package_registers_the_scheme() -> None:
    """Once, however often it is imported."""
    assert axistwin.__name__ in serial.protocol_handler_packages[-1]
    assert serial.protocol_handler_packages.count("axistwin.urlhandler") == 1


# -- who shares a line ----------------------------------------------------------------------------


@pytest.fixture
def named() -> Iterator[str]:
    """A URL with a name that is free again afterwards."""
    yield "axistwin://mac23?time=virtual&line=shared"
    lines.release("shared")


def test_a_named_line_outlives_its_ports(named: str) -> None:
    """Whoever opens the name finds the same twins, as they were left."""
    with open_url(named) as port:
        assert command(port, 0x13, 500) == ACCEPTED
        port.advance(10)
    del port
    gc.collect()
    with open_url(named) as port:
        assert ask(port, 0x20) == 500
    with open_url("axistwin://?line=shared") as port:
        assert ask(port, 0x20) == 500


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("axistwin://mac34-1?line=shared", "devices is mac23, not mac34-1"),
        ("axistwin://mac23?line=shared&time=real", "speed is None, not 1.0"),
        ("axistwin://mac23?line=shared&quirk.xon_byte=11h", "quirks is none, not xon_byte=11h"),
    ],
)
def test_a_named_line_is_not_changed_by_another_url(named: str, url: str, message: str) -> None:
    """Asking for something else under the same name is a mistake, told in one line."""
    with (
        open_url(named),
        pytest.raises(serial.SerialException, match=f"line shared is open already: {message}"),
    ):
        open_url(url)


def test_a_released_line_cannot_be_used_any_more(named: str) -> None:
    """The port says so, and the name is free."""
    with open_url(named) as port:
        lines.release("shared")
        with pytest.raises(serial.SerialException, match="line is closed"):
            port.write(QUERY)
    with open_url(named) as port:
        assert ask(port, 0x20) == 0


def test_lines_without_a_name_are_not_shared() -> None:
    """Each object has its own twins."""
    url = "axistwin://mac23?time=virtual"
    with open_url(url) as first, open_url(url) as second:
        assert command(first, 0x0D, 1234) == ACCEPTED
        assert ask(second, 0x25) & 0xFFFF != 1234


def test_state_outlives_the_port_object(tmp_path: Path) -> None:
    """What a real unit keeps without a supply is in the directory when nobody uses it any more."""
    url = f"axistwin://mac23?time=virtual&state={tmp_path}"
    with open_url(url) as port:
        assert command(port, 0x0D, 1234) == ACCEPTED
        assert command(port, 0x13, 50) == ACCEPTED
        port.advance(5)
    del port
    Storage(tmp_path).close()  # the directory is not locked
    with open_url(url) as port:
        assert ask(port, 0x25) & 0xFFFF == 1234
        assert ask(port, 0x20) == 50


def test_ports_with_the_same_state_share_the_line(tmp_path: Path) -> None:
    """One memory has one owner; a second port of this process finds the same twins."""
    url = f"axistwin://mac23?time=virtual&state={tmp_path}"
    with open_url(url) as first, open_url(url) as second:
        assert first.line is second.line
        with pytest.raises(serial.SerialException, match="open already: seed is 0, not 7"):
            open_url(f"{url}&seed=7")


def test_state_used_by_somebody_else_is_refused(tmp_path: Path) -> None:
    """Two programs never write one memory."""
    other = Storage(tmp_path)
    with pytest.raises(serial.SerialException, match="in use by another axistwin"):
        open_url(f"axistwin://mac23?state={tmp_path}")
    other.close()


@pytest.mark.system
def test_state_is_saved_when_the_program_ends(tmp_path: Path) -> None:
    """Also by a program that never closes its port."""
    url = f"axistwin://mac23?time=virtual&state={tmp_path}"
    program = (
        "import sys, serial, axistwin\n"
        "port = serial.serial_for_url(sys.argv[1], baudrate=38400, timeout=1)\n"
        "port.write(bytes.fromhex(sys.argv[2]))\n"
        "port.read(3)\n"
        "port.advance(10)\n"
    )
    words = [sys.executable, "-c", program, url, request(0x13, 77).hex()]
    done = subprocess.run(words, check=True, capture_output=True, timeout=30)
    assert done.stderr == b""
    with open_url(url) as port:
        assert ask(port, 0x20) == 77


def test_a_line_is_freed_with_its_port() -> None:
    """No reference keeps a private line alive."""
    port = open_url("axistwin://mac23?time=virtual")
    line = port.line
    port.close()
    del port
    with pytest.raises(axistwin.errors.StateError, match="line is closed"):
        line.sync()


# -- the how-to -----------------------------------------------------------------------------------

HOW_TO = Path(__file__).parents[2] / "docs" / "how-to" / "use-pyserial.md"


def test_the_how_to_runs_as_printed(capsys: pytest.CaptureFixture[str]) -> None:
    """The blocks of Python in the page, one after another."""
    page = HOW_TO
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, Any] = {}
    for block in blocks:
        exec(block, names)
    assert len(blocks) == 2
    assert "go to position 36000000" in capsys.readouterr().out


def test_the_how_to_names_every_parameter() -> None:
    """None is missing from the table."""
    page = HOW_TO.read_text(encoding="utf-8")
    told = set(re.findall(r"^\| `([a-z._A-Z]+)=", page, re.MULTILINE))
    assert told == {*_PARAMETERS, "address", "line", "quirk.NAME", "program", "program.UNIT"}
