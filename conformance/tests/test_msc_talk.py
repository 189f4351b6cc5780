"""Exchanges with a unit: signs, replies, repeats, and what noise does to them."""

from __future__ import annotations

import pytest
from msc_twin import BYTE_NS, REPEATS, RESPONSE_NS, TwinPort, check_of, session_on, target_of

from axistwin_conformance.base.errors import AttemptVoid, TargetError
from axistwin_conformance.core.session import Stop
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, NAK
from axistwin_conformance.families.msc.driver import ACKED, MscDriver
from axistwin_conformance.families.msc.snapshot import sanity


def driver_on(port: TwinPort) -> MscDriver:
    """Hands on a unit in virtual time."""
    return MscDriver(session_on(port, check_of("stored")))


def spoilt_once(port: TwinPort, spoils: bytes | None = None) -> None:
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
    port = TwinPort()
    driver = driver_on(port)
    driver.write(2008, -1234)
    assert driver.read(2008) == -1234
    driver.write_block(2048, range(-16, 16))
    assert driver.read_block(2048) == tuple(range(-16, 16))
    driver.set_flag(150)
    assert driver.flag(150)
    assert codec.flags_on(driver.flags() or b"") == {150}
    driver.clear_flag(150)
    assert not driver.flag(150)
    assert driver.status() == 65


def test_an_exchange_tells_when_its_parts_came() -> None:
    """The sign after the request and the response time, the reply after that."""
    port = TwinPort()
    exchange = driver_on(port).ask(codec.RQSTAT)
    signed_ns = exchange.asked_ns + (len(exchange.request) + 1) * BYTE_NS + RESPONSE_NS
    assert abs(exchange.signed_ns - signed_ns) < BYTE_NS
    assert exchange.reply is not None
    assert exchange.replied_ns > exchange.signed_ns + len(exchange.reply.raw) * BYTE_NS
    assert port.received.endswith(ACK)


def test_a_reply_that_is_not_acknowledged_comes_again_and_settling_ends_that() -> None:
    """Kept back, our ACK is missed; what comes then is acknowledged and thrown away."""
    port = TwinPort()
    driver = driver_on(port)
    exchange = driver.ask(codec.RQSTAT, answer=None)
    assert exchange.reply is not None
    heard = driver.client.wait_until_quiet()
    assert heard == exchange.reply.raw
    assert driver.client.listen(10.0) == b""


def test_a_refused_reply_comes_again_as_often_as_it_may() -> None:
    """NAK by NAK, with no ACK before any of them, then never again."""
    port = TwinPort()
    driver = driver_on(port)
    first = driver.ask(codec.dread(0), answer=NAK).reply
    for _ in range(REPEATS - 1):
        again, strays = driver.client.receive_packet()
        assert (again, strays) == (first, b"")
        driver.client.send(NAK)
    assert driver.client.receive_packet() == (first, b"")
    driver.client.send(NAK)
    assert driver.client.receive_packet(3.0) == (None, b"")


def test_the_late_nak_of_a_packet_cut_short_is_settled_away() -> None:
    """Nothing of it is left when the next packet is asked."""
    driver = driver_on(TwinPort())
    driver.client.send(driver.client.request(codec.RQSTAT)[:9])
    assert driver.client.wait_until_quiet() == NAK
    assert driver.status() == 65


def test_between_checks_a_unit_is_asked_last_what_it_answers_wrongly() -> None:
    """The status is asked ten times in vain once, and not after every check."""
    port = TwinPort()
    session = session_on(port, target=target_of(port, is_lossless=False))
    port.spoil = lambda data: b"" if b"RQSTAT" in data else data
    assert sanity(session)
    asked = len(port.received)
    assert sanity(session)
    assert port.received[asked:] == codec.packet(1, codec.rflag(0)) + ACK


class Saying(TwinPort):
    """It says the same byte every 10 ms, whatever is asked."""

    byte = NAK

    def read(self, size: int = 1) -> bytes:
        """One more of them, as soon as it may come."""
        self.timeout = min(self.timeout or 0, 0.01)
        return super().read(size) or self.byte


def test_a_unit_that_signs_without_end_fails_and_is_asked_nothing_more() -> None:
    """No noise says NAK for half a minute and nothing else."""
    driver = driver_on(Saying())
    with pytest.raises(TargetError, match="sends ACK or NAK without end"):
        driver.client.wait_until_quiet()
    ((requirement, expected, came),) = driver.session.run.violations
    assert (requirement, expected) == ("MSC-LNK-04", "one ACK or NAK for a packet")
    assert came.endswith("and no end")


def test_a_line_that_says_other_things_without_end_is_no_failing_unit() -> None:
    """Noise never stops either."""
    port = Saying()
    port.byte = b"U"
    driver = driver_on(port)
    assert set(driver.client.wait_until_quiet()) == {ord("U")}
    assert driver.session.run.violations == []


def test_a_packet_with_a_wrong_checksum_is_asked_once() -> None:
    """Its NAK is the answer; on a line that may lose bytes as well."""
    port = TwinPort()
    session = session_on(port, check_of(), target=target_of(port, is_lossless=False))
    driver = MscDriver(session)
    exchange = driver.client.ask(codec.with_wrong_checksum(driver.client.request(codec.RQSTAT)))
    assert exchange.is_naked
    assert session.retries == []


@pytest.mark.parametrize("spoils", [None, b"", b"\x06\x06\x06", b"\x15"], ids=repr)
def test_a_read_that_noise_has_spoilt_is_asked_again(spoils: bytes | None) -> None:
    """The right answer in the end, and one retry told."""
    port = TwinPort()
    port.data[0] = 77
    session = session_on(port, check_of(), target=target_of(port, is_lossless=False))
    spoilt_once(port, spoils)
    assert MscDriver(session).read(0) == 77
    assert len(session.retries) == 1


def test_a_value_is_written_again_but_a_flag_is_not_set_again() -> None:
    """A second SFLAG would be a second cycle of the machine: the attempt is void."""
    port = TwinPort()
    session = session_on(port, check_of("stored"), target=target_of(port, is_lossless=False))
    driver = MscDriver(session)
    spoilt_once(port, b"")
    driver.write(2008, 5)
    assert port.data[2008] == 5
    spoilt_once(port, b"")
    before = port.received
    with pytest.raises(AttemptVoid):
        driver.set_flag(150)
    assert port.received.removeprefix(before).count(b"SFLAG") == 1


@pytest.mark.parametrize("body", [codec.dwrite(2009, 5), codec.sflag(150)], ids=repr)
def test_a_bare_ack_is_what_a_write_may_draw(body: bytes) -> None:
    """Where bytes may get lost it is believed at once, also if a reply is waited for behind it."""
    port = TwinPort()
    session = session_on(port, check_of("stored"), target=target_of(port, is_lossless=False))
    driver = MscDriver(session)
    assert driver.draws(driver.client.request(body))[0] == ACKED
    assert session.retries == []


def test_a_packet_behind_the_ack_to_a_write_that_noise_has_broken_is_asked_again() -> None:
    """Nobody says that: what follows the ACK must be sound."""
    port = TwinPort()
    session = session_on(port, check_of("stored"), target=target_of(port, is_lossless=False))
    driver = MscDriver(session)
    session.run.readings["write_reply"] = "empty_packet"
    empty = codec.packet(1, codec.body("DWRITE"))
    said = [ACK + codec.with_wrong_checksum(empty), ACK + empty]
    port.spoil = lambda data: said.pop(0) if data == ACK else data
    exchange = driver.ask(codec.dwrite(2008, 1))
    assert exchange.reply is not None
    assert exchange.reply.raw == empty
    assert len(session.retries) == 1


def test_a_repeat_that_noise_has_broken_voids_the_attempt_or_is_compared_by() -> None:
    """It cannot be asked for again; handed on strictly, its bytes tell noise from the unit."""
    port = TwinPort()
    session = session_on(port, check_of(), target=target_of(port, is_lossless=False))
    driver = MscDriver(session)
    assert driver.ask(codec.RQSTAT, answer=None).reply is not None
    spoilt_once(port)
    driver.client.send(NAK)
    with pytest.raises(AttemptVoid):
        driver.client.receive_packet()
    session.is_strict = True
    spoilt_once(port)
    driver.client.send(NAK)
    again, strays = driver.client.receive_packet()
    assert again is not None
    assert (again.is_sound, strays) == (False, b"")
    assert len(session.corrupted) == 1
    assert again.raw.hex() in session.corrupted[0]


def test_without_noise_a_wrong_reply_is_handed_on() -> None:
    """In virtual time it is the unit's own, at once."""
    port = TwinPort()
    spoilt_once(port, b"\x07")
    driver = driver_on(port)
    exchange = driver.ask(codec.RQSTAT)
    assert (exchange.sign, exchange.extra[:1]) == (b"", b"\x07")


def test_the_typed_hands_go_on_only_with_a_sound_reply() -> None:
    """A NAK where a value was asked for leaves unmet what the check names."""
    driver = driver_on(TwinPort())
    with pytest.raises(Stop):
        driver.read(0xFFFC)


def test_measured_time_outs_shorten_the_settling() -> None:
    """Not known, all repeats are allowed for; known, the longer one and a margin."""
    driver = driver_on(TwinPort())
    assert driver.client.quiet_limit_s == pytest.approx(1.0 + 6 * 1.15)
    driver.session.run.readings.update(packet_timeout_ms="300", ack_timeout_ms="700")
    assert driver.client.quiet_limit_s == pytest.approx(0.9)


def test_a_unit_that_has_said_nothing_is_waited_for_no_longer_than_a_packet_that_broke_off() -> (
    None
):
    """No reply of its can come again, so that a port where nobody is does not take minutes."""
    driver = driver_on(TwinPort())
    exchange = driver.client.ask(codec.packet(5, codec.RQSTAT))
    assert exchange.is_silence
    before_ns = driver.target.now_ns
    assert driver.client.wait_until_quiet(after=exchange) == b""
    assert (driver.target.now_ns - before_ns) / 1e9 == pytest.approx(1.2, abs=0.1)


def test_an_empty_packet_after_a_write_is_acknowledged_where_it_is_known() -> None:
    """Left unanswered it would come again and be taken for the next reply."""
    port = TwinPort()
    driver = driver_on(port)
    driver.session.run.readings["write_reply"] = "empty_packet"
    empty = codec.packet(1, codec.body("DWRITE"))
    port.spoil = lambda data: ACK + empty if data == ACK else data
    exchange = driver.write(2008, 1)
    assert exchange.reply is not None
    assert exchange.reply.raw == empty
    assert port.received.endswith(ACK)


def test_a_model_without_rflags_has_no_flags_to_tell_at_once() -> None:
    """The hands know, and ask nothing."""
    port = TwinPort(has_rflags=False)
    driver = driver_on(port)
    assert driver.flags() is None
    assert port.received == b""
