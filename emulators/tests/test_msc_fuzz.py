"""Any bytes in any pieces: what a controller does depends on the bytes and their times alone."""

import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msc_bench import (
    ACK,
    F9600,
    NAK,
    MscBench,
    WatchedController,
    bread,
    broken,
    bwrite,
    dread,
    dwrite,
    flag,
    rflags,
    rqstat,
)

from axistwin.devices.msc.packets import packet
from axistwin.devices.msc.quirks import QUIRKS, parse_quirks
from axistwin.wire.framing import Chunk

pytestmark = pytest.mark.strength

PIECES = st.one_of(
    st.binary(min_size=1, max_size=12),
    st.sampled_from(
        [
            *(ACK, NAK, b"\x02", b"\x02\x01", b"\x02\x01\x00", rqstat()[:7]),
            *(rqstat(), rflags(), dread(8), dwrite(8, 7), bread(8), bwrite(8, range(32))),
            *(flag("SFLAG", 200), flag("RFLAG", 3), rqstat(2), rqstat(0), dwrite(8, 9, 7)),
            *(broken(rqstat()), broken(rqstat(2)), packet(1, b"?" * 241), packet(1, b"")),
            packet(2, (b"\0\0" + rqstat()) * 8),
        ]
    ),
)
STREAMS = st.lists(PIECES, max_size=12).map(b"".join)
SETTINGS = st.fixed_dictionaries(
    {},
    optional={
        name: st.sampled_from(quirk.allowed)
        for name, quirk in QUIRKS.items()
        if quirk.kind in ("choice", "bool")
    },
)
TIMES = st.fixed_dictionaries(
    {},
    optional={
        "packet_timeout_ms": st.sampled_from([1, 2, 9, 50, 1000]),
        "ack_timeout_ms": st.sampled_from([1, 7, 100]),
        "response_delay_ms": st.sampled_from([0, 1, 5]),
        "reply_delay_ms": st.sampled_from([0, 3]),
    },
)


def stepped(bench: MscBench, data: bytes, rng: random.Random) -> None:
    """Send ``data`` as one stretch, the time passed in any steps."""
    end_ns = bench.send(data)
    while bench.now < end_ns:
        bench.run_until(min(end_ns, bench.now + rng.randrange(1, 40_000_000)))


def sent_byte_by_byte(data: bytes, units: tuple[int, ...], quirks: dict[str, Any]) -> list[Any]:
    """What a unit sends when it is handed every byte alone, woken whenever it asks."""
    device = WatchedController("msc-250", units[0], quirks=parse_quirks(quirks), alone=True)
    device.sent, device.stored = [], []

    def wake_until(now: int) -> None:
        while (due := device.next_event()) is not None and due < now:
            device.wake(due)

    for at in range(len(data)):
        now = F9600.span_ns(at + 1)
        wake_until(now)
        device.receive(Chunk(0, data[at : at + 1], F9600, at))
    wake_until(30 * 10**9)
    return device.sent


@settings(max_examples=300)
@given(STREAMS, SETTINGS, TIMES, st.sampled_from([(1,), (2,)]), st.integers(0, 2**32))
def test_pieces_and_looks_change_nothing(
    data: bytes, quirks: dict[str, Any], times: dict[str, Any], units: tuple[int, ...], seed: int
) -> None:
    """One stretch on a line, looked at any time, equals byte by byte: all sendings, all times."""
    quirks = {**quirks, **times, "rs485_mode": "four_wire"}  # the line hands over every byte
    bench = MscBench(*units, **quirks)
    if data:
        stepped(bench, data, random.Random(seed))
    bench.run_until(30 * 10**9)
    assert bench.sent == sent_byte_by_byte(data, units, quirks)


@settings(max_examples=200)
@given(STREAMS, STREAMS, SETTINGS, TIMES)
def test_the_quiet_prefix_is_quiet(
    before: bytes, data: bytes, quirks: dict[str, Any], times: dict[str, Any]
) -> None:
    """In any state, no byte of it has an effect, nor a time limit that ends within it."""
    device = MscBench(**quirks, **times).device
    now = 0
    for at in range(len(before)):
        due = device.next_event()
        now += F9600.span_ns(1)
        while due is not None and due < now:
            device.wake(due)
            due = device.next_event()
        device.receive(Chunk(now - F9600.span_ns(1), before[at : at + 1], F9600))
    due = device.next_event()
    quiet = device.quiet_prefix(data)
    assert 0 <= quiet <= len(data)
    for at in range(quiet):
        arrival_ns = now + F9600.span_ns(at + 1)
        if due is not None and due < arrival_ns:
            return  # the line hands over no more than that
        running = device.next_event()
        assert due or running is None or running >= arrival_ns, "a time limit within the prefix"
        chunk = Chunk(arrival_ns - F9600.span_ns(1), data[at : at + 1], F9600)
        assert device.receive(chunk) == []
        changed = device.next_event()
        assert changed is None or due is None or changed >= min(due, arrival_ns)


@settings(max_examples=100)
@given(
    st.sampled_from([rqstat(), dread(8), bwrite(8, range(32)), broken(rqstat()), rflags()]),
    st.lists(st.integers(0, 60), max_size=6),
)
def test_however_a_packet_is_cut_within_t1_the_answer_is_the_same(
    raw: bytes, pauses: list[int]
) -> None:
    """MSC-PROP-03."""
    bench = MscBench()
    expected = MscBench().tell(raw, 800)
    cut = len(raw) // (len(pauses) + 1) + 1
    for place, pause_ms in zip(range(0, len(raw), cut), [*pauses, 0], strict=False):
        bench.run_until(bench.send(raw[place : place + cut]) + pause_ms * 1_000_000)
    assert bench.wait(600) == expected


@pytest.mark.parametrize("raw", [rqstat(), dread(0x1234), flag("RFLAG", 3), bread(64), rflags()])
def test_any_one_bit_behind_the_header_draws_one_nak(raw: bytes) -> None:
    """And nothing else (MSC-PROP-04)."""
    for place in range(6, len(raw)):
        for bit in range(8):
            changed = bytearray(raw)
            changed[place] ^= 1 << bit
            bench = MscBench()
            assert bench.tell(bytes(changed), 3000) == NAK


@settings(max_examples=50)
@given(st.integers(0, 0x1FFF), st.integers(1, 200))
def test_bytes_that_change_places_go_unnoticed(number: int, shift: int) -> None:
    """The sum is weak (MSC-PROP-05): what is read is what the bytes now say."""
    address = number * 4
    high, low = address >> 8, address & 0xFF
    moved = min(shift, high, 255 - low) // 4 * 4
    changed = (high - moved) << 8 | low + moved
    raw = bytearray(dread(address))
    raw[12:14] = changed.to_bytes(2, "big")
    bench = MscBench()
    bench.perform(bench.device.set_variable(0, changed, 77))
    assert bench.tell(bytes(raw))[-6:-2] == (77).to_bytes(4, "big")


@settings(max_examples=200)
@given(STREAMS, SETTINGS)
def test_without_pacing_nothing_breaks_either(data: bytes, quirks: dict[str, Any]) -> None:
    """Bytes that take no time: no exception, and the unit is serviceable afterwards."""
    quirks = {**quirks, "noise_in_idle": "ignore", "stopped_access": "allow"}
    bench = MscBench(paced=False, **quirks)
    bench.tell(data, 300)
    bench.settle()
    bench.tell(ACK)  # it may wait for one for ever
    assert bench.tell(rqstat())[:1] == ACK
