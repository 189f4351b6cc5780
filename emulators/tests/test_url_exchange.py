"""``exchange`` of an axistwin:// port: one fast call that is nothing but ``write`` and ``read``."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st
from mac_frames import ACCEPTED, ANSWER_LENGTH, request

import axistwin  # noqa: F401  registers the URL scheme
from axistwin.kernel.effects import Store, Trace
from axistwin.runtime.network import SerialNetwork

QUERY = request(0x20)

URLS = (
    "axistwin://mac23?time=virtual",
    "axistwin://mac23?time=virtual&quirk.plant=inertial&quirk.reply_latency_us=0",
    "axistwin://mac23?time=virtual&quirk.step_phase=start&quirk.motion_start_ref=reply_end",
    "axistwin://mac23?time=virtual&quirk.rx_during_xoff=kept&quirk.fifo_underrun=decelerate",
    "axistwin://mac23?time=virtual&quirk.reset_reply=silence&quirk.boot_time_ms=30",
    "axistwin://mac23:0,mac23:5?time=virtual",
    "axistwin://mac23:5,mac34-1:0?time=virtual&quirk.rx_during_xoff=kept",
    "axistwin://mac23:0,mac23:0,mac23:5?time=virtual&quirk.nack_scope=any",
    "axistwin://mac23?time=virtual&pacing=no",
)


@dataclass
class Side:
    """A port of its own, and what its twins asked for."""

    port: Any
    effects: list[tuple[int, Store | Trace]] = field(default_factory=list)

    def __post_init__(self) -> None:
        network: SerialNetwork = self.port.line._network
        take = network.take_effects

        def taking() -> list[tuple[int, Store | Trace]]:
            taken = take()
            self.effects += taken
            return taken

        network.take_effects = taking  # type: ignore[method-assign]

    def seen(self) -> tuple[object, ...]:
        """All that can be told of it."""
        line = self.port.line
        now = line.sync()
        devices = [station.device for station in line._stations]
        return (
            now,
            [(each.time_ns, each.direction, each.data, each.note) for each in line.transcript],
            [dict(station.slot.cells) for station in line._stations],
            [dict(device.describe(now)) for device in devices],
            [device.next_event() for device in devices],
            line.available,
            self.effects,
        )


def open_side(url: str, **options: Any) -> Side:
    """``url`` at the modules' rate."""
    return Side(serial.serial_for_url(url, **{"baudrate": 38400, "timeout": 0.5, **options}))


def open_slow_side(url: str, **options: Any) -> Side:
    """The same with somebody who looks on: nothing takes a short way then."""
    side = open_side(url, **options)
    side.port.line.subscribe(lambda twin, trace: None)
    return side


def write_and_read(port: Any, data: bytes, size: int, timeout_s: float) -> tuple[int, bytes, int]:
    """What ``exchange`` is for short."""
    began_ns = port.line.host_sent_ns
    port.write(data)
    port.timeout = timeout_s
    return began_ns, port.read(size), port.virtual_time_ns


FRAMES = st.one_of(
    st.builds(
        lambda index, number, address: request(index, number, address=address),
        st.sampled_from([0x13, 0x15, 0x16, 0x1E, 0x17, 0x18, 0x20, 0x27, 0x0D, 0x0C, 0x12, 0x00]),
        st.sampled_from([0, 5, 800, 0x00100320, 0xFFF00400, 0xFFFFFF00, 3]),
        st.sampled_from([0, 0, 0, 0, 5, 5, 0xFF]),
    ),
    st.builds(lambda frame, at: frame[:at] + b"0" + frame[at + 1 :], st.just(QUERY), st.just(17)),
    st.sampled_from([QUERY[:7], QUERY[7:], QUERY + QUERY, b"\x00\xff", b""]),
)
STEPS = st.tuples(
    FRAMES,
    st.sampled_from([3, 3, 21, 21, 1, 30, 0]),
    st.sampled_from([0.5, 0.5, 0.5, 0.0, 0.001, 0.0055, 0.0064, 0.00725, 0.0072, 0.0131, 3.0]),
    st.sampled_from([0.0, 0.0, 0.0, 0.0001, 0.01, 0.3, 2.5]),
)


@pytest.mark.strength
@settings(max_examples=60)
@given(st.sampled_from(URLS), st.lists(STEPS, min_size=1, max_size=12), st.booleans())
def test_an_exchange_is_a_write_and_a_read(
    url: str, steps: list[tuple[bytes, int, float, float]], reads_all: bool
) -> None:
    """Bytes, times, transcript, memory, state and traces are the same, whatever is said."""
    one, other = open_side(url), open_slow_side(url)
    for data, size, timeout_s, pause_s in steps:
        expected = write_and_read(other.port, data, size, timeout_s)
        assert one.port.exchange(data, size, timeout_s) == expected
        assert one.seen() == other.seen()
        for side in (one, other):
            side.port.advance(pause_s)
            if reads_all:
                side.port.reset_input_buffer()
    assert one.seen() == other.seen()


MSC_URLS = (
    "axistwin://msc-250:1?time=virtual",
    "axistwin://msc-250:1?time=virtual&quirk.response_delay_ms=0&quirk.reply_delay_ms=0",
    "axistwin://msc-250:1,msc-250:2?time=virtual",
    "axistwin://msc-250:1,msc-250:2?time=virtual&quirk.rs485_mode=four_wire",
    "axistwin://msc-250:1?time=virtual&quirk.ack_order=ack_last&quirk.stx_while_waiting=serve",
)


def packet(body: bytes, unit: int = 1) -> bytes:
    """A request to a controller."""
    inner = bytes((unit, 0, len(body), 0, 0)) + body
    return b"\x02" + inner + sum(inner).to_bytes(2, "big")


MSC_SENT = st.sampled_from(
    [
        packet(b"RQSTAT,"),
        packet(b"RQSTAT,"),
        packet(b"RQSTAT,", 2),
        packet(b"RQSTAT,", 3),
        packet(b"DREAD,\x08\0"),
        packet(b"DWRITE,\x08\0\0\0\0\x07"),
        packet(b"RQSTAT,")[:9],
        packet(b"RQSTAT,")[9:],
        b"\x06",
        b"\x06",
        b"\x06" + packet(b"RQSTAT,"),
        b"\x15",
        b"x",
        b"",
    ]
)
MSC_STEPS = st.tuples(
    MSC_SENT,
    st.sampled_from([1, 23, 24, 24, 30, 0]),
    st.sampled_from([0.05, 0.2, 1.0, 2.0, 0.0, 0.004]),
    st.sampled_from([0.0, 0.0, 0.0, 0.0002, 0.3]),
    st.sampled_from(["exchange", "exchange", "write", "both"]),
)


@pytest.mark.strength
@settings(max_examples=150)
@given(st.sampled_from(MSC_URLS), st.lists(MSC_STEPS, min_size=1, max_size=12))
def test_controllers_answer_the_same_the_short_way(
    url: str, steps: list[tuple[bytes, int, float, float, str]]
) -> None:
    """ACK and reply, repeats, time limits; asked in one call, or by ``write`` and ``read``."""
    one, other = (open_(url, baudrate=9600) for open_ in (open_side, open_slow_side))
    for data, size, timeout_s, pause_s, way in steps:
        for side in (one, other):
            if way != "exchange":
                side.port.write(data)
        if way != "write":
            said = data if way == "exchange" else b""
            expected = write_and_read(other.port, said, size, timeout_s)
            if way == "exchange":
                assert one.port.exchange(said, size, timeout_s) == expected
            else:
                one.port.timeout = timeout_s
                assert one.port.read(size) == expected[1]
        assert one.seen() == other.seen()
        for side in (one, other):
            side.port.advance(pause_s)
    assert one.seen() == other.seen()


def short_ways(side: Side, monkeypatch: pytest.MonkeyPatch) -> list[bytes | None]:
    """What comes of every attempt to take the short way, from now on."""
    outcomes: list[bytes | None] = []
    network: SerialNetwork = side.port.line._network
    ask: Callable[..., bytes | None] = network.host_ask

    def asking(*args: Any) -> bytes | None:
        outcomes.append(ask(*args))
        return outcomes[-1]

    monkeypatch.setattr(network, "host_ask", asking)
    return outcomes


@pytest.mark.parametrize("url", [URLS[0], "axistwin://mac23:0,mac34-1:7?time=virtual"])
def test_most_exchanges_take_the_short_way(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """At rest, in motion, refused, in time or not: it is not only the same, it is fast."""
    side = open_side(url)
    outcomes = short_ways(side, monkeypatch)
    for data, size, expected in (
        (QUERY, ANSWER_LENGTH, b"\x06\x13\x020110000000000010\x03\x1a"),
        (request(0x0D, 800), 3, ACCEPTED),
        (request(0x13, 100_000), 3, ACCEPTED),
        (request(0x13, 100_000), 3, b"\x06\x13\x17"),
        (request(0x20, address=5), 21, b""),
        (request(0x12), 21, b"\x06\x13\x17"),
        (request(0x18), 3, ACCEPTED),
    ):
        began_ns, reply, now = side.port.exchange(data, size, 0.05)
        assert (reply, outcomes[-1]) == (expected, expected)
        assert now - began_ns <= 50_000_000
    assert len(outcomes) == 7


@pytest.mark.parametrize(
    "trouble", ["leftover", "behind", "listener", "memory", "rate", "break", "flood"]
)
def test_where_more_is_going_on_an_exchange_is_the_same_too(
    trouble: str, tmp_path: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bytes not read or not sent, who looks on, a disk, a wrong rate, a break, too many bytes."""
    folders = [f"&state={tmp_path}/{n}" if trouble == "memory" else "" for n in (0, 1)]
    one, other = open_side(URLS[0] + folders[0]), open_slow_side(URLS[0] + folders[1])
    outcomes = short_ways(one, monkeypatch)
    told: list[list[object]] = [[], []]
    for index, side in enumerate((one, other)):
        if trouble == "leftover":
            side.port.write(QUERY)
            side.port.advance(0.02)
        elif trouble == "behind":
            side.port.write(QUERY)
        elif trouble == "listener":
            side.port.line.subscribe(lambda _, trace, told=told[index]: told.append(trace))
        elif trouble == "rate":
            side.port.baudrate = 19200
        elif trouble == "break":
            side.port.break_condition = True
            side.port.advance(0.001)
            side.port.break_condition = False
    flood = QUERY * 250 if trouble == "flood" else QUERY
    for data in (request(0x13, 500), flood, request(0x0D, 400)):
        expected = write_and_read(other.port, data, 21, 0.1)
        assert one.port.exchange(data, 21, 0.1) == expected
        assert one.seen() == other.seen()
    assert told[0] == told[1]
    is_short = trouble in ("break", "leftover", "behind", "flood")
    assert is_short or all(each is None for each in outcomes)


@settings(max_examples=60)
@given(st.sampled_from(URLS), st.lists(STEPS, min_size=1, max_size=8))
def test_a_read_in_virtual_time_is_a_wait_and_a_look(
    url: str, steps: list[tuple[bytes, int, float, float]]
) -> None:
    """Motions that end, restarts and answers on their way: what is read, and when, is the same."""
    one, other = open_side(url), open_slow_side(url)
    for data, size, timeout_s, pause_s in steps:
        for side in (one, other):
            side.port.write(data)
        assert write_and_read(one.port, b"", size, pause_s) == write_and_read(
            other.port, b"", size, pause_s
        )
        assert one.port.exchange(b"", size, timeout_s) == write_and_read(
            other.port, b"", size, timeout_s
        )
        assert one.seen() == other.seen()


def test_an_exchange_works_in_real_time_and_needs_an_open_port() -> None:
    """It is slower there, for time passes by itself; a closed port says so."""
    port: Any = serial.serial_for_url("axistwin://mac23", baudrate=38400)
    began_ns, reply, now = port.exchange(QUERY, ANSWER_LENGTH, 1.0)
    assert len(reply) == ANSWER_LENGTH
    assert now - began_ns >= 10_000_000
    port.close()
    with pytest.raises(serial.SerialException):
        port.exchange(QUERY, ANSWER_LENGTH, 1.0)


def test_a_cancelled_read_cancels_an_exchange() -> None:
    """As it does the next ``read``; what was to be sent is sent."""
    port: Any = serial.serial_for_url(URLS[0], baudrate=38400)
    port.cancel_read()
    began_ns, reply, now = port.exchange(QUERY, ANSWER_LENGTH, 1.0)
    assert (reply, now) == (b"", began_ns)
    assert len(port.read(ANSWER_LENGTH)) == ANSWER_LENGTH


def test_a_controller_s_ack_and_reply_take_the_short_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also right behind the ACK of the host, which is still on its way."""
    side = open_side(MSC_URLS[0], baudrate=9600)
    outcomes = short_ways(side, monkeypatch)
    for _ in range(3):
        reply = side.port.exchange(packet(b"RQSTAT,"), 24, 1.0)[1]
        assert len(reply) == 24
        assert outcomes == [reply]
        del outcomes[:]
        side.port.write(b"\x06")


def test_a_write_and_a_read_take_the_short_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is still to be sent when the host begins to listen is part of what it asks."""
    side = open_side(URLS[0])
    outcomes = short_ways(side, monkeypatch)
    for _ in range(3):
        side.port.write(QUERY)
        assert len(side.port.read(ANSWER_LENGTH)) == ANSWER_LENGTH
    assert [len(each or b"") for each in outcomes] == [ANSWER_LENGTH] * 3


@pytest.mark.parametrize("most", [1, 3, 25])
def test_what_is_upcoming_is_what_is_read_next(most: int) -> None:
    """A look ahead takes no time, and tells what is certain to come, nothing else."""
    port: Any = serial.serial_for_url("axistwin://mac23?time=virtual", baudrate=38400, timeout=1)
    port.advance(3)
    assert len(port.exchange(QUERY, ANSWER_LENGTH, 1)[1]) == ANSWER_LENGTH
    port.write(QUERY)
    assert port.upcoming == b""  # the request is under way
    read, seen = b"", 0
    while piece := port.read(min(most, len(port.upcoming) or 1)):
        read += piece
        before_ns, upcoming = port.virtual_time_ns, port.upcoming
        assert port.virtual_time_ns == before_ns
        seen = max(seen, len(upcoming))
        assert len(read + upcoming) <= ANSWER_LENGTH
        assert port.line._network.host_upcoming == upcoming
    assert len(read) == ANSWER_LENGTH
    assert seen == ANSWER_LENGTH - 1
