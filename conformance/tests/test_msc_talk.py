"""Exchanges with a unit: signs, replies, repeats, and what noise does to them."""

from __future__ import annotations

import pytest
from msc_device import BYTE_NS, REPEATS, RESPONSE_NS, MscPort, check_of, session_on, target_of

from axistwin_conformance.base.errors import AttemptVoid
from axistwin_conformance.core.session import Stop
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, NAK
from axistwin_conformance.families.msc.driver import Bench


def bench_on(port: MscPort) -> Bench:
    """Hands on a unit in virtual time."""
    return Bench(session_on(port, check_of("stored")))


def spoilt_once(port: MscPort, spoils: bytes | None = None) -> None:
    """Spoil the next thing the unit says: its last byte turned, or these bytes in its place."""
    left = [True]

    def spoil(data: bytes) -> bytes:
        if not left:
            return data
        left.clear()
        return data[:-1] + bytes([data[-1] ^ 0x40]) if spoils is None else spoils

    port.spoil = spoil


def test_the_typed_hands_read_what_was_written() -> None:
    """Values, blocks, flags and the status, each by its own command."""
    port = MscPort()
    bench = bench_on(port)
    bench.write(2008, -1234)
    assert bench.read(2008) == -1234
    bench.write_block(2048, range(-16, 16))
    assert bench.read_block(2048) == tuple(range(-16, 16))
    bench.set_flag(150)
    assert bench.flag(150)
    assert codec.flags_on(bench.flags() or b"") == {150}
    bench.clear_flag(150)
    assert not bench.flag(150)
    assert bench.status() == 65


def test_an_exchange_tells_when_its_parts_came() -> None:
    """The sign after the request and the response time, the reply after that."""
    port = MscPort()
    exchange = bench_on(port).ask(codec.RQSTAT)
    signed_ns = exchange.asked_ns + (len(exchange.request) + 1) * BYTE_NS + RESPONSE_NS
    assert abs(exchange.signed_ns - signed_ns) < BYTE_NS
    assert exchange.reply is not None
    assert exchange.replied_ns > exchange.signed_ns + len(exchange.reply.raw) * BYTE_NS
    assert port.heard.endswith(ACK)


def test_a_reply_that_is_not_acknowledged_comes_again_and_settling_ends_that() -> None:
    """Kept back, our ACK is missed; what comes then is acknowledged and thrown away."""
    port = MscPort()
    bench = bench_on(port)
    exchange = bench.ask(codec.RQSTAT, answer=None)
    assert exchange.reply is not None
    heard = bench.talk.settle()
    assert heard == exchange.reply.raw
    assert bench.talk.listen(10.0) == b""


def test_a_refused_reply_comes_again_as_often_as_it_may() -> None:
    """NAK by NAK, with no ACK before any of them, then never again."""
    port = MscPort()
    bench = bench_on(port)
    first = bench.ask(codec.dread(0), answer=NAK).reply
    for _ in range(REPEATS - 1):
        again, strays = bench.talk.hear_packet()
        assert (again, strays) == (first, b"")
        bench.talk.send(NAK)
    assert bench.talk.hear_packet() == (first, b"")
    bench.talk.send(NAK)
    assert bench.talk.hear_packet(3.0) == (None, b"")


def test_the_late_nak_of_a_packet_cut_short_is_settled_away() -> None:
    """Nothing of it is left when the next packet is asked."""
    bench = bench_on(MscPort())
    bench.talk.send(bench.talk.request(codec.RQSTAT)[:9])
    assert bench.talk.settle() == NAK
    assert bench.status() == 65


def test_a_packet_with_a_wrong_checksum_is_asked_once() -> None:
    """Its NAK is the answer; on a line that may lose bytes as well."""
    port = MscPort()
    session = session_on(port, check_of(), target=target_of(port, is_lossless=False))
    bench = Bench(session)
    exchange = bench.talk.ask(codec.with_wrong_checksum(bench.talk.request(codec.RQSTAT)))
    assert exchange.is_naked
    assert session.retries == []


@pytest.mark.parametrize("spoils", [None, b"", b"\x06\x06\x06", b"\x15"], ids=repr)
def test_a_read_that_noise_has_spoilt_is_asked_again(spoils: bytes | None) -> None:
    """The right answer in the end, and one retry told."""
    port = MscPort()
    port.data[0] = 77
    session = session_on(port, check_of(), target=target_of(port, is_lossless=False))
    spoilt_once(port, spoils)
    assert Bench(session).read(0) == 77
    assert len(session.retries) == 1


def test_a_value_is_written_again_but_a_flag_is_not_set_again() -> None:
    """A second SFLAG would be a second cycle of the machine: the attempt is void."""
    port = MscPort()
    session = session_on(port, check_of("stored"), target=target_of(port, is_lossless=False))
    bench = Bench(session)
    spoilt_once(port, b"")
    bench.write(2008, 5)
    assert port.data[2008] == 5
    spoilt_once(port, b"")
    before = port.heard
    with pytest.raises(AttemptVoid):
        bench.set_flag(150)
    assert port.heard.removeprefix(before).count(b"SFLAG") == 1


def test_a_repeat_that_noise_has_broken_voids_the_attempt_or_is_compared_by() -> None:
    """It cannot be asked for again; handed on strictly, its bytes tell noise from the unit."""
    port = MscPort()
    session = session_on(port, check_of(), target=target_of(port, is_lossless=False))
    bench = Bench(session)
    assert bench.ask(codec.RQSTAT, answer=None).reply is not None
    spoilt_once(port)
    bench.talk.send(NAK)
    with pytest.raises(AttemptVoid):
        bench.talk.hear_packet()
    session.is_strict = True
    spoilt_once(port)
    bench.talk.send(NAK)
    again, strays = bench.talk.hear_packet()
    assert again is not None
    assert (again.is_sound, strays) == (False, b"")
    assert len(session.corrupted) == 1
    assert again.raw.hex() in session.corrupted[0]


def test_without_noise_a_wrong_reply_is_handed_on() -> None:
    """In virtual time it is the unit's own, at once."""
    port = MscPort()
    spoilt_once(port, b"\x07")
    bench = bench_on(port)
    exchange = bench.ask(codec.RQSTAT)
    assert (exchange.sign, exchange.extra[:1]) == (b"", b"\x07")


def test_the_typed_hands_go_on_only_with_a_sound_reply() -> None:
    """A NAK where a value was asked for leaves unmet what the check names."""
    bench = bench_on(MscPort())
    with pytest.raises(Stop):
        bench.read(0xFFFC)


def test_measured_time_outs_shorten_the_settling() -> None:
    """Not known, all repeats are allowed for; known, the longer one and a margin."""
    bench = bench_on(MscPort())
    assert bench.talk.settle_s == pytest.approx(1.0 + 6 * 1.15)
    bench.session.run.readings.update(packet_timeout_ms="300", ack_timeout_ms="700")
    assert bench.talk.settle_s == pytest.approx(0.9)


def test_a_unit_that_has_said_nothing_is_waited_for_no_longer_than_a_packet_that_broke_off() -> (
    None
):
    """No reply of its can come again, so that a port where nobody is does not take minutes."""
    bench = bench_on(MscPort())
    exchange = bench.talk.ask(codec.packet(5, codec.RQSTAT))
    assert exchange.is_silence
    before_ns = bench.target.now_ns
    assert bench.talk.settle(after=exchange) == b""
    assert (bench.target.now_ns - before_ns) / 1e9 == pytest.approx(1.2, abs=0.1)


def test_an_empty_packet_after_a_write_is_acknowledged_where_it_is_known() -> None:
    """Left unanswered it would come again and be taken for the next reply."""
    port = MscPort()
    bench = bench_on(port)
    bench.session.run.readings["write_reply"] = "empty_packet"
    empty = codec.packet(1, codec.body("DWRITE"))
    port.spoil = lambda data: ACK + empty if data == ACK else data
    exchange = bench.write(2008, 1)
    assert exchange.reply is not None
    assert exchange.reply.raw == empty
    assert port.heard.endswith(ACK)


def test_a_model_without_rflags_has_no_flags_to_tell_at_once() -> None:
    """The hands know, and ask nothing."""
    port = MscPort(has_rflags=False)
    bench = bench_on(port)
    assert bench.flags() is None
    assert port.heard == b""
