"""One table of pyserial's contract, on a plain pty and on ``axistwin://`` in each kind of time."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import serial
from mac_frames import ACCEPTED, ANSWER_LENGTH, request
from served import TIMEOUT_S, eventually

import axistwin  # noqa: F401  registers the URL scheme
from axistwin import testing

pytestmark = pytest.mark.system

QUERY = request(0x20)
ANSWER = b"\x06\x13\x020110000000000010\x03\x1a"
assert len(ANSWER) == ANSWER_LENGTH

URLS = {
    "virtual": "axistwin://mac23?time=virtual",
    "real": "axistwin://mac23?time=real",
    "scaled": "axistwin://mac23?time=20",
}
PACED = ["real", "scaled"]

Make = Callable[..., Any]


def open_port(url: str, **settings: Any) -> Any:
    """``url`` opened at the module's rate, with patience for an answer on any machine."""
    return serial.serial_for_url(url, **{"baudrate": 38400, "timeout": TIMEOUT_S, **settings})


@pytest.fixture(params=["pty", *URLS])
def arm(request: pytest.FixtureRequest) -> str:
    """The kind of port under test."""
    return str(request.param)


@pytest.fixture
def brief_s(arm: str) -> float:
    """A time-out to be waited out, in which an answer has come."""
    return 0.1 if arm == "virtual" else 1.0  # another thread has to be given the time


@pytest.fixture
def make(arm: str) -> Iterator[Make]:
    """Open a port of this kind, with settings; every call opens the same one again."""
    if arm == "pty":
        with testing.start("mac23") as twin:
            yield lambda **settings: open_port(twin.port, **settings)
        return
    ports: list[Any] = []

    def make_url(**settings: Any) -> Any:
        ports.append(open_port(f"{URLS[arm]}&line=contract", **settings))
        return ports[-1]

    yield make_url
    for port in ports:
        port.close()
    from axistwin.urlhandler import lines

    lines.release("contract")


@pytest.fixture
def port(make: Make) -> Iterator[Any]:
    """An open port of each kind."""
    with make() as port:
        yield port


def clock(port: Any) -> Callable[[], float]:
    """The seconds that matter on this port: its own when they are virtual."""
    if hasattr(port, "line") and port.line.is_virtual:
        return lambda: port.virtual_time_ns / 1e9
    return time.monotonic


def since(start: float, now: Callable[[], float]) -> float:
    """Seconds from ``start``, without the dust of floating point."""
    return round(now() - start, 9)


def latest(now: Callable[[], float], seconds: float) -> float:
    """By when something is over on that clock; the real one runs on while others are served."""
    return TIMEOUT_S if now is time.monotonic else seconds


def test_a_query_is_answered(port: Any) -> None:
    """``write`` tells how many bytes it took, and ``read`` gives those asked for."""
    assert port.write(QUERY) == len(QUERY)
    assert port.read(ANSWER_LENGTH) == ANSWER


def test_read_without_a_size_gives_one_byte(port: Any) -> None:
    """The default size is 1."""
    port.write(QUERY)
    assert port.read() == ANSWER[:1]


def test_read_returns_what_came_when_the_time_is_over(port: Any, brief_s: float) -> None:
    """A short read takes the time-out, counted from the call, and no byte is lost."""
    port.timeout = brief_s
    now = clock(port)
    port.write(QUERY)
    start = now()
    assert port.read(100) == ANSWER
    assert brief_s <= since(start, now) < latest(now, 0.4)


def test_read_without_an_answer_times_out(port: Any) -> None:
    """Nothing comes, so nothing is returned, not before the time-out."""
    port.timeout = 0.05
    now = clock(port)
    start = now()
    assert port.read(5) == b""
    assert 0.05 <= since(start, now) < latest(now, 0.3)


def test_read_with_timeout_zero_does_not_wait(port: Any) -> None:
    """``timeout=0`` gives what is there."""
    port.timeout = 0
    took = []
    for _ in range(20):
        start = time.monotonic()
        assert port.read(10) == b""
        took.append(since(start, time.monotonic))
    assert min(took) < 0.1
    port.write(QUERY)
    data = b""
    while len(data) < ANSWER_LENGTH:
        data += port.read(100)
    assert data == ANSWER


def test_read_without_a_timeout_waits_for_all_bytes(port: Any) -> None:
    """``timeout=None`` returns the whole of what was asked for."""
    port.timeout = None
    port.write(QUERY)
    assert port.read(ANSWER_LENGTH) == ANSWER


@pytest.mark.parametrize("size", [0, -1])
def test_read_of_nothing_gives_nothing(port: Any, size: int) -> None:
    """No byte asked for, none given, and no wait."""
    port.timeout = None
    assert port.read(size) == b""


def test_bytes_are_read_in_pieces(port: Any) -> None:
    """What one ``read`` leaves, the next one gives."""
    port.write(QUERY)
    assert port.read(3) + port.read(10) + port.read(8) == ANSWER


def test_in_waiting_counts_what_can_be_read(port: Any) -> None:
    """Polling ``in_waiting`` ends in virtual time too; reading takes off what it read."""
    assert port.in_waiting == 0
    port.write(QUERY)
    while port.in_waiting < ANSWER_LENGTH:
        pass
    assert port.read(20) == ANSWER[:20]
    assert port.in_waiting == 1
    assert port.read_all() == ANSWER[20:]


def test_read_until_stops_at_the_mark(port: Any) -> None:
    """``read_until`` gives everything up to and with the mark, and leaves the rest."""
    port.write(QUERY)
    assert port.read_until(b"\x03") == ANSWER[:20]
    assert port.read(1) == ANSWER[20:]


def test_read_until_stops_at_its_size_and_its_time(port: Any, brief_s: float) -> None:
    """``read_until`` gives what it has when ``size`` bytes, or no more bytes in time, have come."""
    port.timeout = brief_s
    port.write(QUERY)
    assert port.read_until(b"?", 7) == ANSWER[:7]
    assert port.read_until() == ANSWER[7:]


def test_lines_can_be_iterated(port: Any, brief_s: float) -> None:
    """The port is a file: ``readline``, ``for line in port``, ``readlines``, ``readinto``."""
    port.timeout = brief_s
    port.write(QUERY)
    assert port.readline() == ANSWER
    port.write(QUERY)
    assert list(port) == [ANSWER]
    port.write(QUERY)
    assert port.readlines() == [ANSWER]
    port.write(QUERY)
    buffer = bytearray(ANSWER_LENGTH)
    assert port.readinto(buffer) == ANSWER_LENGTH
    assert buffer == ANSWER


def test_the_port_is_a_raw_stream(port: Any) -> None:
    """It reads and writes and does not seek."""
    assert port.readable()
    assert port.writable()
    assert not port.seekable()
    port.writelines([QUERY[:5], QUERY[5:]])
    assert port.read(ANSWER_LENGTH) == ANSWER


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview, list])
def test_write_takes_every_kind_of_bytes(port: Any, kind: Callable[[bytes], Any]) -> None:
    """Bytes, bytearrays, memory views and lists of numbers are sent alike."""
    assert port.write(kind(QUERY)) == len(QUERY)
    assert port.read(ANSWER_LENGTH) == ANSWER


def test_write_refuses_text(port: Any) -> None:
    """Text has no bytes of its own."""
    with pytest.raises(TypeError, match="unicode strings are not supported"):
        port.write("text")


def test_write_of_nothing_writes_nothing(port: Any) -> None:
    """An empty write is no error."""
    assert port.write(b"") == 0


def test_reset_input_buffer_drops_what_has_come(port: Any) -> None:
    """What arrived before is gone, and the next answer is whole."""
    port.write(QUERY)
    while port.in_waiting < ANSWER_LENGTH:
        pass
    port.reset_input_buffer()
    assert port.in_waiting == 0
    port.write(QUERY)
    assert port.read(ANSWER_LENGTH) == ANSWER


def test_a_closed_port_is_not_usable(port: Any) -> None:
    """Everything that needs the line raises the one error for that."""
    port.close()
    assert not port.is_open
    for use in (lambda: port.read(1), lambda: port.write(b"x"), port.flush):
        with pytest.raises(serial.PortNotOpenError):
            use()
    for reset in (port.reset_input_buffer, port.reset_output_buffer, port.send_break):
        with pytest.raises(serial.PortNotOpenError):
            reset()
    port.close()


def test_the_same_object_can_be_opened_again(port: Any) -> None:
    """Close and open as often as you like; an open port cannot be opened."""
    with pytest.raises(serial.SerialException, match="already open"):
        port.open()
    for _ in range(3):
        port.close()
        port.open()
        assert port.is_open
        port.write(QUERY)
        assert port.read(ANSWER_LENGTH) == ANSWER


def test_the_twin_keeps_its_state_while_the_port_is_closed(port: Any) -> None:
    """A parameter set before is still set after opening again."""
    port.write(request(0x0D, 1234))
    assert port.read(3) == ACCEPTED
    port.close()
    port.open()
    port.write(request(0x25))
    assert port.read(ANSWER_LENGTH)[13:17] == b"04D2"


def test_a_with_block_opens_and_closes(port: Any) -> None:
    """The context manager opens a closed port, and closes it whatever happens."""
    port.close()
    with port:
        assert port.is_open
    assert not port.is_open


def test_a_new_port_does_not_hear_what_came_before(make: Make, brief_s: float) -> None:
    """Opening drops what arrived while nobody listened."""
    with make() as first:
        first.write(QUERY)
        first.flush()
    with make(timeout=brief_s) as second:
        second.read(100)  # on a slow line the answer may still be under way
        second.timeout = TIMEOUT_S
        second.write(QUERY)
        assert second.read(ANSWER_LENGTH) == ANSWER


def test_a_client_at_the_wrong_rate_is_not_understood(port: Any) -> None:
    """pyserial's own default, 9600 baud, gets no valid answer; the right rate does, at once."""
    port.baudrate = 9600
    port.timeout = 0.1
    port.write(QUERY)
    assert ANSWER not in port.read(100)
    port.reset_input_buffer()
    port.baudrate, port.timeout = 38400, TIMEOUT_S
    # What the module took for the beginning of a frame ends with the next start of one.
    port.write(QUERY)
    assert port.read(ANSWER_LENGTH) == ANSWER


def test_the_default_rate_is_pyserials(make: Make) -> None:
    """Nobody sets the rate for a client that does not."""
    with make(baudrate=9600, timeout=0.1) as port:
        port.write(QUERY)
        assert ANSWER not in port.read(100)


def test_framing_can_be_changed_while_open(port: Any) -> None:
    """Settings that do not matter to the line change nothing; those of the module still work."""
    for port.stopbits in (serial.STOPBITS_TWO, serial.STOPBITS_ONE):
        port.write(QUERY)
        assert port.read(ANSWER_LENGTH) == ANSWER


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("baudrate", -1),
        ("baudrate", None),
        ("bytesize", 9),
        ("parity", "X"),
        ("stopbits", 3),
        ("timeout", -1),
        ("timeout", "soon"),
        ("write_timeout", -1),
        ("inter_byte_timeout", -1),
    ],
)
def test_settings_out_of_range_are_refused(port: Any, setting: str, value: object) -> None:
    """A bad value is a ``ValueError``, and the old one stays."""
    before = getattr(port, setting)
    with pytest.raises(ValueError, match="Not a valid"):
        setattr(port, setting, value)
    assert getattr(port, setting) == before


def test_the_timeout_can_be_changed_while_open(port: Any) -> None:
    """The next read obeys."""
    now = clock(port)
    for timeout in (0.02, 0.1):
        port.timeout = timeout
        start = now()
        assert port.read(1) == b""
        assert timeout <= since(start, now) < latest(now, timeout + 0.2)


def test_settings_go_round_in_a_dict(port: Any) -> None:
    """``apply_settings`` puts back what ``get_settings`` gave."""
    settings = port.get_settings()
    port.baudrate, port.timeout, port.xonxoff = 9600, 3, True
    assert port.get_settings() != settings
    port.apply_settings(settings)
    assert port.get_settings() == settings
    port.write(QUERY)
    assert port.read(ANSWER_LENGTH) == ANSWER


def test_repr_names_the_port(port: Any) -> None:
    """A port in a message can be told from another."""
    assert repr(port.port) in repr(port)
    assert "open=True" in repr(port)
    assert port.name == port.port == port.portstr


def test_cancel_read_makes_the_next_read_return(port: Any) -> None:
    """A cancel that comes early is not lost."""
    port.timeout = None
    port.cancel_read()
    assert port.read(1) == b""
    port.write(QUERY)
    assert port.read(ANSWER_LENGTH) == ANSWER


def test_flush_waits_until_everything_is_sent(port: Any, arm: str) -> None:
    """On a line with a rate, that takes the byte times."""
    now = clock(port)
    start = now()
    port.write(bytes(384))
    port.flush()
    if arm in ("virtual", "real"):  # a pty knows no rate, and scaled time is faster
        assert since(start, now) >= 0.1
    port.reset_output_buffer()
    assert port.out_waiting == 0


def test_send_break_returns_and_the_line_works_on(port: Any) -> None:
    """A break is no frame."""
    port.send_break(0.01)
    port.break_condition = True
    port.break_condition = False
    port.write(QUERY)
    assert port.read(ANSWER_LENGTH) == ANSWER


def test_an_exclusive_port_cannot_be_locked_twice(make: Make) -> None:
    """``exclusive=True`` is refused while another one holds it, and free once that is closed."""
    with make(exclusive=True):
        with pytest.raises(serial.SerialException, match="exclusively lock"):
            make(exclusive=True)
        with make():
            pass
    with make(exclusive=True) as port:
        port.write(QUERY)
        assert port.read(ANSWER_LENGTH) == ANSWER


def test_software_flow_control_swallows_part_of_a_reply(
    port: Any, arm: str, brief_s: float
) -> None:
    """MACS-LINE-02: with ``xonxoff`` the 13h of a reply is lost, and output stops for good."""
    port.xonxoff = True
    port.timeout = brief_s
    port.write(QUERY)
    assert port.read(100) == ANSWER.replace(b"\x13", b"")
    if arm == "pty":
        return  # a stopped pty takes no bytes at all, where a serial driver has a buffer
    port.write(QUERY)
    assert port.read(100) == b""
    port.xonxoff = False
    assert port.read(ANSWER_LENGTH) == ANSWER


def test_do_not_open_leaves_the_port_closed(make: Make) -> None:
    """The port can be configured first."""
    with make() as template:
        url = template.port
    port = serial.serial_for_url(url, do_not_open=True)
    assert not port.is_open
    port.baudrate, port.timeout = 38400, TIMEOUT_S
    with port:
        port.write(QUERY)
        assert port.read(ANSWER_LENGTH) == ANSWER


# -- threads: time that passes by itself ----------------------------------------------------------

THREADED = pytest.mark.parametrize("arm", ["pty", *PACED], indirect=True)


def in_thread(work: Callable[[], Any]) -> tuple[threading.Thread, list[Any]]:
    """``work`` running in a thread, and where its result will be."""
    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(work()))
    thread.start()
    return thread, results


@THREADED
def test_one_thread_reads_while_another_writes(port: Any) -> None:
    """A reader that waits without a time-out hears the answers to another thread's queries."""
    port.timeout = None
    heard: list[bytes] = []
    thread, _ = in_thread(lambda: heard.extend(port.read(ANSWER_LENGTH) for _ in range(5)))
    for count in range(5):
        assert eventually(lambda: len(heard) == count)  # noqa: B023
        time.sleep(0.05)  # the reader is asleep by then
        port.write(QUERY)
    thread.join(TIMEOUT_S)
    assert heard == 5 * [ANSWER]


@THREADED
def test_cancel_read_wakes_a_reader(port: Any) -> None:
    """A read under way in another thread returns what it has, and no byte is lost."""
    port.timeout = None
    port.write(QUERY)
    thread, results = in_thread(lambda: port.read(100))
    time.sleep(0.1)
    port.cancel_read()
    thread.join(TIMEOUT_S)
    (heard,) = results
    assert heard + port.read(ANSWER_LENGTH - len(heard)) == ANSWER


@pytest.mark.parametrize("arm", PACED, indirect=True)
def test_cancel_write_wakes_a_writer(port: Any) -> None:
    """A write under way in another thread returns how far it came."""
    amount = 1_000_000
    thread, results = in_thread(lambda: port.write(bytes(amount)))
    assert eventually(lambda: port.out_waiting > 0)
    port.cancel_write()
    thread.join(TIMEOUT_S)
    assert 0 < results[0] < amount


@pytest.mark.parametrize("arm", PACED, indirect=True)
def test_closing_wakes_a_reader(port: Any) -> None:
    """A read under way ends when the port is closed under it."""
    port.timeout = None
    thread, results = in_thread(lambda: port.read(1))
    assert eventually(lambda: bool(port.line._changed._waiters))
    port.close()
    thread.join(TIMEOUT_S)
    assert results == [b""]


def test_no_thread_is_left_behind() -> None:
    """Ports with a URL have none at all."""
    before = threading.active_count()
    with open_port(URLS["real"]) as port:
        port.write(QUERY)
        assert port.read(ANSWER_LENGTH) == ANSWER
        assert threading.active_count() == before


# -- what a pty cannot show -----------------------------------------------------------------------

ON_URLS = pytest.mark.parametrize("arm", list(URLS), indirect=True)


@ON_URLS
def test_out_waiting_counts_what_is_not_sent(port: Any) -> None:
    """It falls to 0, and ``reset_output_buffer`` makes it so; the byte on the line is finished."""
    port.baudrate = 50  # slow enough that nothing to speak of leaves between two lines
    port.write(bytes(2000))
    first = port.out_waiting
    assert 1000 < first <= 2000
    while port.out_waiting >= first:
        pass
    port.reset_output_buffer()
    assert port.out_waiting == 0


@ON_URLS
def test_write_timeout_zero_takes_what_fits(port: Any) -> None:
    """The output buffer is as large as a serial driver's."""
    port.write_timeout = 0
    taken = port.write(bytes(1_000_000))
    assert 4096 <= taken < 1_000_000  # scaled time goes on meanwhile, and bytes leave
    assert port.out_waiting <= 4096


@ON_URLS
def test_write_timeout_is_an_error_and_loses_nothing(port: Any) -> None:
    """Half of it does not fit in time; what was taken by then goes out."""
    port.baudrate, port.write_timeout = 50, 0.001
    with pytest.raises(serial.SerialTimeoutException, match="Write timeout"):
        port.write(bytes(10_000))
    assert port.out_waiting > 3000


@ON_URLS
def test_a_long_write_waits_for_room(port: Any) -> None:
    """Everything is taken, and the last bytes are still heard."""
    port.write(bytes(5000) + QUERY)
    assert port.out_waiting <= 4096
    assert port.read(ANSWER_LENGTH) == ANSWER


@ON_URLS
def test_inter_byte_timeout_ends_a_read(port: Any) -> None:
    """A pause behind the first byte ends the read long before its own time-out."""
    port.timeout, port.inter_byte_timeout = 60, 0.05
    now = clock(port)
    port.write(QUERY)
    start = now()
    assert port.read(100) == ANSWER
    assert 0.05 <= since(start, now) < latest(now, 0.5)


@ON_URLS
def test_modem_lines_are_those_of_an_adapter(port: Any) -> None:
    """Outputs can be set; inputs stand still."""
    port.rts = port.dtr = False
    assert (port.rts, port.dtr) == (False, False)
    assert (port.cts, port.dsr, port.cd, port.ri) == (True, True, True, False)


@ON_URLS
def test_a_port_that_is_closed_counts_nothing(port: Any) -> None:
    """The counters and the modem lines need an open port too."""
    port.close()
    for name in ("in_waiting", "out_waiting", "cts"):
        with pytest.raises(serial.PortNotOpenError):
            getattr(port, name)


@ON_URLS
@pytest.mark.parametrize(
    "framing", [{"bytesize": 7}, {"parity": "E"}, {"parity": "S"}, {"baudrate": 38400 // 2}]
)
def test_framing_is_compared_as_on_a_wire(make: Make, framing: dict[str, Any]) -> None:
    """Other data bits, parity or rate than the module's 8N1 give no valid answer."""
    with make(timeout=0.1, **framing) as port:
        port.write(QUERY)
        assert ANSWER not in port.read(100)


@ON_URLS
def test_baudrate_zero_is_refused(port: Any) -> None:
    """A line cannot stand still."""
    with pytest.raises(ValueError, match="Not a valid baudrate: 0"):
        port.baudrate = 0
