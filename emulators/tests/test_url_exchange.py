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


def open_slow_side(url: str) -> Side:
    """The same with somebody who looks on: nothing takes a short way then."""
    side = open_side(url)
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
@settings(max_examples=60, deadline=None)
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
    assert not outcomes or trouble in ("break", "leftover", "behind", "flood")


@settings(max_examples=60, deadline=None)
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
