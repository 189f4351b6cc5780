"""Repeats and time-outs of a controller, to the nanosecond."""

import pytest
from msc_bench import (
    ACK,
    CHARACTER_NS,
    NAK,
    REPLY,
    STATUS,
    MscBench,
    dread,
    dwrite,
    end_of,
    rqstat,
)

from axistwin.kernel.time import NS_PER_MS


def test_an_exchange_takes_just_its_time() -> None:
    """5 ms to the ACK, 10 ms from its end to the reply (ledger §5.6)."""
    bench = MscBench()
    heard_ns = bench.send(rqstat())
    bench.wait(100)
    sign, reply = bench.sent
    assert sign == (heard_ns + 5 * NS_PER_MS, ACK)
    assert reply == (end_of(sign) + 10 * NS_PER_MS, STATUS)


@pytest.mark.parametrize("timeout_ms", [1000, 3, 250])
def test_a_reply_without_an_answer_is_repeated_five_times(timeout_ms: int) -> None:
    """Each T2 behind the end of the one before, the same bytes, no ACK between; then silence."""
    bench = MscBench(ack_timeout_ms=timeout_ms)
    bench.send(dread(8))
    bench.settle()
    assert [data for _, data in bench.sent] == [ACK] + 6 * [REPLY]
    for before, after in zip(bench.sent[1:], bench.sent[2:], strict=False):
        assert after[0] == end_of(before) + timeout_ms * NS_PER_MS
    assert bench.device.next_event() is None
    assert bench.tell(rqstat(), 60)[:24] == ACK + STATUS


def test_nothing_is_repeated_behind_the_ack() -> None:
    """Not even when the ACK comes in the last nanosecond of T2."""
    bench = MscBench()
    bench.send(dread(8))
    bench.wait(100)
    due_ns = end_of(bench.sent[-1]) + 1000 * NS_PER_MS
    bench.run_until(due_ns - CHARACTER_NS - 1)
    bench.send(ACK)
    bench.settle()
    assert len(bench.sent) == 2


def test_an_ack_that_comes_too_late_ends_the_repeat() -> None:
    """It has begun already, and the ACK counts when it has left."""
    bench = MscBench()
    bench.send(dread(8))
    bench.wait(100)
    due_ns = end_of(bench.sent[-1]) + 1000 * NS_PER_MS
    bench.run_until(due_ns - CHARACTER_NS + 1)
    bench.send(ACK)
    bench.settle()
    assert [data for _, data in bench.sent] == [ACK, REPLY, REPLY]


@pytest.mark.parametrize("ends_by", [ACK, b"", NAK * 6])
def test_nothing_is_repeated_into_the_next_exchange(ends_by: bytes) -> None:
    """However the one before ended; a count of repeats belongs to its reply (trap 19)."""
    bench = MscBench()
    bench.tell(dread(8), 100)
    for byte in ends_by:
        bench.tell(bytes((byte,)), 100)
    count = len(bench.sent)
    bench.send(rqstat())
    bench.settle()
    assert [data for _, data in bench.sent[count:]] == [ACK] + 6 * [STATUS]
    bench.send(dwrite(8, 1))
    bench.settle()
    assert bench.sent[count + 7 :] == [(bench.sent[-1][0], ACK)]


@pytest.mark.parametrize("naks", range(8))
def test_as_many_repeats_as_naks_but_five_at_most(naks: int) -> None:
    """MSC-PROP-07; each begins 5 ms behind its NAK."""
    bench = MscBench()
    bench.tell(dread(8), 100)
    for number in range(naks):
        heard_ns = bench.send(NAK)
        assert bench.wait(100) == (REPLY if number < 5 else b"")
        if number < 5:
            assert bench.sent[-1] == (heard_ns + 5 * NS_PER_MS, REPLY)
    bench.tell(ACK)
    assert len(bench.sent) == 2 + min(naks, 5)
    assert bench.settle() == b""


def test_naks_and_time_outs_share_one_limit() -> None:
    """R counts both."""
    bench = MscBench()
    bench.tell(dread(8), 100)
    bench.tell(NAK, 100)
    bench.wait(1100)
    bench.tell(NAK, 100)
    assert bench.settle() == 2 * REPLY
    assert len(bench.sent) == 7
