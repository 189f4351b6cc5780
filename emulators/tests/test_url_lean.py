"""What a suite asks of the port a dozen times per exchange costs next to nothing."""

import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

import pytest
import serial
from mac_frames import ANSWER_LENGTH, request

import axistwin as _axistwin  # noqa: F401  registers the URL scheme
from axistwin.runtime.line import Line


@pytest.fixture
def port() -> Iterator[Any]:
    """A twin in virtual time, at its rate."""
    url = "axistwin://mac23?time=virtual"
    with serial.serial_for_url(url, baudrate=38400, timeout=0.5) as opened:
        yield opened


@pytest.mark.parametrize(
    "ask",
    [
        lambda port: port.virtual_time_ns,
        lambda port: setattr(port, "timeout", 0.25),
        lambda port: setattr(port, "write_timeout", 0.25),
        lambda port: setattr(port, "inter_byte_timeout", 0.25),
    ],
    ids=["virtual_time_ns", "timeout", "write_timeout", "inter_byte_timeout"],
)
def test_what_concerns_no_byte_waits_for_no_other_thread(
    port: Any, ask: Callable[[Any], object]
) -> None:
    """The clock and the time-outs, while another thread holds the line."""
    line: Line = port.line
    held, done = threading.Event(), threading.Event()

    def hold() -> None:
        with line.present():
            held.set()
            assert done.wait(30)

    def ask_now() -> None:
        ask(port)
        done.set()

    holder = threading.Thread(target=hold)
    asker = threading.Thread(target=ask_now)
    holder.start()
    assert held.wait(30)
    asker.start()
    asker.join(5)
    answered = done.is_set()
    done.set()
    holder.join(30)
    asker.join(30)
    assert answered


def test_a_time_out_leaves_the_line_as_it_is(port: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rate and framing are set when they change, and only then."""
    told: list[object] = []
    host_format: Any = vars(Line)["host_format"]

    def note(line: Line, line_format: Any) -> None:
        told.append(line_format.baud)
        host_format.fset(line, line_format)

    monkeypatch.setattr(Line, "host_format", host_format.setter(note))
    port.timeout = 1
    port.write_timeout = 1
    assert told == []
    port.baudrate = 9600
    port.timeout = 2
    assert told == [9600]
    with pytest.raises(ValueError, match="timeout"):
        port.timeout = -1
    assert port.timeout == 2


def test_the_rate_holds_after_a_port_was_closed(port: Any) -> None:
    """Another port on the same line may have set another one meanwhile."""
    line: Line = port.line
    own = line.host_format
    port.close()
    line.host_format = type(own)(9600)
    port.open()
    assert line.host_format == own


def test_time_passes_as_far_as_the_bytes_asked_for(port: Any) -> None:
    """One byte at a time, all at once, or more than there are: at the same nanoseconds."""
    starts = []
    for sizes in ([ANSWER_LENGTH], [1, ANSWER_LENGTH - 1], [1] * ANSWER_LENGTH):
        start_ns = port.virtual_time_ns
        port.write(request(0x20))
        answer = b"".join(port.read(size) for size in sizes)
        assert len(answer) == ANSWER_LENGTH
        starts.append(port.virtual_time_ns - start_ns)
    assert max(starts) - min(starts) <= 1  # a byte time has a fraction of a nanosecond
    port.write(request(0x20))
    start_ns = port.virtual_time_ns
    assert len(port.read(100)) == ANSWER_LENGTH
    assert port.virtual_time_ns - start_ns == 500_000_000


def calls_of(action: Callable[[], object]) -> int:
    """How many functions of Python it takes, once all that it remembers is remembered."""
    for _ in range(5):
        action()
    calls = 0

    def count(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    former = sys.getprofile()
    sys.setprofile(count)
    try:
        action()
    finally:
        sys.setprofile(former)
    return calls


@pytest.mark.parametrize(
    ("modules", "writes", "calls_max"),
    [(1, False, 50), (2, False, 82), (127, False, 82), (1, True, 95)],
)
def test_an_exchange_takes_few_calls(modules: int, writes: bool, calls_max: int) -> None:
    """Each costs 0.1 to 0.2 microseconds, of which a whole exchange takes about ten."""
    devices = ",".join(f"mac23:{address}" for address in range(modules))
    url = f"axistwin://{devices}?time=virtual"
    with serial.serial_for_url(url, baudrate=38400, timeout=0.03) as opened:
        port: Any = opened
        query = request(0x20, address=modules - 1)

        def exchange() -> bytes:
            if writes:
                port.write(query)
                return bytes(port.read(ANSWER_LENGTH))
            return bytes(port.exchange(query, ANSWER_LENGTH, 0.03)[1])

        assert len(exchange()) == ANSWER_LENGTH
        assert calls_of(exchange) <= calls_max
