"""What a controller decides: the rows of ledger §4.2, and of §4.3, what goes wrong."""

import pytest
from msc_bench import (
    ACK,
    CHARACTER_NS,
    NAK,
    REPLY,
    STATUS,
    MscBench,
    broken,
    bwrite,
    dread,
    dwrite,
    end_of,
    flag,
    rflags,
    rqstat,
    word,
)

from axistwin.devices.msc.packets import packet
from axistwin.kernel.time import NS_PER_MS


@pytest.fixture
def bench() -> MscBench:
    """A controller alone on its line, with the defaults."""
    return MscBench()


# ---- rows of §4.2 --------------------------------------------------------------------------------


@pytest.mark.parametrize("length", [1, 7, 100, 239, 240])
def test_any_length_up_to_240_is_a_packet(bench: MscBench, length: int) -> None:
    """Judged when its sum is there: here no command (MSC-PKT-10)."""
    heard_ns = bench.send(packet(1, b"Q" * length))
    bench.wait(400)
    assert bench.sent == [(heard_ns + 5 * NS_PER_MS, NAK)]
    assert bench.ask(rqstat()) == ACK + STATUS


def test_length_0_is_a_packet_without_a_command() -> None:
    """Eight bytes, one NAK (MSC-AMB-16)."""
    assert MscBench().tell(bytes.fromhex("02 01 00 00 00 00 00 01")) == NAK


@pytest.mark.parametrize("length", [241, 255, 256, 512])
def test_a_longer_packet_is_swallowed_and_refused(bench: MscBench, length: int) -> None:
    """NAK behind its last byte (MSC-LNK-20); nothing in it is looked at."""
    inside = rqstat() * 40
    heard_ns = bench.send(packet(1, inside[:length]))
    bench.wait(700)
    assert bench.sent == [(heard_ns + 5 * NS_PER_MS, NAK)]
    assert bench.settle() == b""


def test_a_longer_packet_that_breaks_off_is_refused_at_the_time_limit() -> None:
    """T1 runs there too, also for one that takes longer than that to send."""
    for data in (bytes.fromhex("02 01 00 F1 00 00"), b"\x02\x01\xff\xff" + b"\0" * 1200):
        bench = MscBench()
        bench.send(data)
        bench.settle()
        assert bench.sent == [(CHARACTER_NS + 1000 * NS_PER_MS, NAK)]


@pytest.mark.parametrize("unit", [2, 7, 15, 0, 16, 0x31, 255])
@pytest.mark.parametrize("units", [(1,), (4,), (1, 3)])
def test_packets_for_others_are_silent_good_or_bad(units: tuple[int, ...], unit: int) -> None:
    """On RS-232 and RS-485; there is no broadcast (MSC-LNK-19, MSC-AMB-12, MSC-AMB-13)."""
    bench = MscBench(*units)
    for raw in (dwrite(8, 5, unit), broken(rqstat(unit)), packet(unit, b"?" * 300)):
        assert bench.tell(raw, 800) == b""
    assert bench.settle() == b""
    assert bench.tell(rqstat(units[0]))[:1] == ACK
    assert "data_0008" not in bench.device.cells(bench.now)


@pytest.mark.parametrize("error", [1, 0x100, 0xFFFF, 0xFF00])
def test_a_wrong_sum_is_refused(error: int) -> None:
    """In either byte (MSC-AMB-17), without any effect (MSC-LNK-06)."""
    raw = dwrite(8, 5)
    total = int.from_bytes(raw[-2:], "big") + error & 0xFFFF
    bench = MscBench()
    assert bench.tell(raw[:-2] + word(total), 5000) == NAK
    assert bench.value(8) == 0


@pytest.mark.parametrize(
    "content",
    [b"RQSTAT", b"ZZZZZZ,", b",", b"rqstat,", b"RQSTATS,", b"RFLA,\0\1", b" RQSTAT,", b"\0\0"],
)
def test_what_is_no_command_is_refused(content: bytes) -> None:
    """No comma, or no name (MSC-CMD-07, -09, -10)."""
    assert MscBench().tell(packet(1, content), 3000) == NAK


@pytest.mark.parametrize("model", ["msc-850", "msc-generic"])
def test_rflags_is_refused_where_it_is_unknown(model: str) -> None:
    """MSC-MOD-02."""
    bench = MscBench(model=model)
    assert bench.tell(rflags(), 3000) == NAK
    assert bench.ask(rqstat()) == ACK + STATUS


@pytest.mark.parametrize("model", ["msc-250", "msc-850-32"])
def test_rflags_is_answered_where_it_is_known(model: str) -> None:
    """MSC-MOD-01."""
    assert MscBench(model=model).tell(rflags()) == ACK + packet(1, b"RFLAGS," + bytes(32))


@pytest.mark.parametrize(
    "content",
    [
        b"RQSTAT,\0",
        b"RFLAGS,\0",
        b"DREAD,\0",
        b"DREAD,",
        b"DREAD,\0\0\0",
        b"DWRITE,\0\0\0\0\0",
        b"DWRITE,\0\0\0\0\0\0\0",
        b"BREAD,\0",
        b"BWRITE,\0\0" + bytes(127),
        b"BWRITE,\0\0" + bytes(129),
        b"BWRITE,\0\0" + bytes(4 * 31),
        b"RFLAG,\1",
        b"SFLAG,\0\0\0",
        b"CFLAG,",
    ],
)
def test_a_body_of_the_wrong_size_is_refused(bench: MscBench, content: bytes) -> None:
    """MSC-CMD-11."""
    assert bench.tell(packet(1, content), 3000) == NAK
    assert set(bench.device.cells(bench.now)) == {"battery", "memory_lost"}


@pytest.mark.parametrize(
    "raw",
    [
        dread(0x8000),
        dread(0x7FFD),
        dread(0xFFFF),
        dwrite(0x7FFE, 1),
        packet(1, b"BREAD," + word(0x7F84)),
        bwrite(0x7F84, [1] * 32),
        flag("RFLAG", 256),
        flag("SFLAG", 256),
        flag("CFLAG", 0xFFFF),
    ],
)
def test_what_does_not_exist_is_refused(bench: MscBench, raw: bytes) -> None:
    """Address, block or flag out of range: NAK, and nothing has changed."""
    before = bench.device.cells(bench.now), bench.device.flags.states(bench.now)
    assert bench.tell(raw, 3000) == NAK
    assert (bench.device.cells(bench.now), bench.device.flags.states(bench.now)) == before


def test_a_good_write_draws_the_ack_and_nothing_else(bench: MscBench) -> None:
    """It is carried out when the ACK has left, before the next packet is looked at (MSC-LNK-14)."""
    bench.send(dwrite(8, 7))
    bench.wait(27)
    assert len(bench.sent) == 1
    acked_ns = end_of(bench.sent[0])
    bench.run_until(acked_ns - 1)
    assert bench.device.variable_at(bench.now, 8) == 0
    bench.run_until(acked_ns)
    assert bench.device.variable_at(bench.now, 8) == 7
    assert bench.settle() == ACK
    assert bench.tell(ACK, 3000) == b""


@pytest.mark.parametrize("number", [0, 15, 32, 39, 40, 71, 72, 127])
def test_writing_a_flag_that_is_not_the_hosts_has_no_effect(bench: MscBench, number: int) -> None:
    """Inputs, timers, motor status, unassigned: ACK (MSC-SFLAG-03, MSC-CFLAG-03)."""
    assert bench.tell(flag("SFLAG", number)) == ACK
    assert not bench.is_on(number)
    bench.perform(bench.device.set_flag(bench.now, number, on=True))
    assert bench.tell(flag("CFLAG", number)) == ACK
    assert bench.is_on(number)


def test_a_read_looks_at_the_data_when_its_ack_has_left() -> None:
    """MSC-LNK-07: what changes before that is in the reply, what changes later is not."""
    for late_ns, value in ((-1, 5), (1, 0)):
        bench = MscBench()
        heard_ns = bench.send(dread(8))
        bench.run_until(heard_ns + 5 * NS_PER_MS + CHARACTER_NS + late_ns)
        bench.perform(bench.device.set_variable(bench.now, 8, 5))
        bench.wait(100)
        assert bench.sent[-1][1] == packet(1, b"DREAD," + value.to_bytes(4, "big"))


# ---- rows of §4.3 --------------------------------------------------------------------------------


def test_a_request_damaged_with_its_length_intact(bench: MscBench) -> None:
    """NAK behind the last byte; the repeat is served."""
    heard_ns = bench.send(rqstat().replace(b"Q", b"P"))
    bench.wait(100)
    assert bench.sent == [(heard_ns + 5 * NS_PER_MS, NAK)]
    assert bench.ask(rqstat()) == ACK + STATUS


def test_a_request_with_too_large_a_length_swallows_an_early_repeat(bench: MscBench) -> None:
    """And is refused at T1; a repeat after that is served."""
    damaged = bytearray(rqstat())
    damaged[3] = 100
    bench.send(bytes(damaged))
    bench.wait(300)
    bench.send(rqstat())
    bench.wait(2000)
    assert bench.sent == [(CHARACTER_NS + 1000 * NS_PER_MS, NAK)]
    assert bench.ask(rqstat()) == ACK + STATUS


def test_a_request_with_too_small_a_length_may_draw_a_second_nak(bench: MscBench) -> None:
    """Its tail holds 02h, which starts a phantom packet, here for this very unit (trap 2)."""
    damaged = bytearray(dread(0x0201))
    damaged[3] = 1
    bench.send(bytes(damaged))
    assert bench.settle() == NAK + NAK
    assert bench.sent[1][0] == end_of(bench.sent[0]) + 1000 * NS_PER_MS  # it came in EXEC
    assert bench.ask(rqstat()) == ACK + STATUS


def test_a_request_damaged_in_the_unit_byte_is_silent(bench: MscBench) -> None:
    """It looks like another unit's."""
    assert bench.tell(rqstat(9), 3000) == b""
    assert bench.ask(rqstat()) == ACK + STATUS


@pytest.mark.parametrize("lost", range(1, 15))
def test_a_lost_byte_is_refused_at_the_time_limit(lost: int) -> None:
    """NAK at T1, wherever it was lost (a lost unit byte makes it another's)."""
    raw, bench = rqstat(), MscBench()
    bench.send(raw[:lost] + raw[lost + 1 :])
    heard = bench.settle()
    assert heard == (b"" if lost == 1 else NAK)
    assert bench.ask(raw) == ACK + STATUS


def test_a_write_whose_ack_was_lost_has_been_carried_out(bench: MscBench) -> None:
    """The repeat is carried out again: nothing marks it (MSC-LNK-18)."""
    assert bench.tell(flag("SFLAG", 200)) == ACK
    bench.perform(bench.device.set_flag(bench.now, 200, on=False))  # the program takes it
    assert bench.tell(flag("SFLAG", 200)) == ACK
    assert bench.is_on(200)


def test_a_nak_that_was_lost_leaves_the_unit_idle(bench: MscBench) -> None:
    """The host's repeat is served."""
    bench.tell(broken(rqstat()), 2000)
    assert bench.device.next_event() is None
    assert bench.ask(rqstat()) == ACK + STATUS


def test_a_reply_that_was_damaged_waits_for_the_host(bench: MscBench) -> None:
    """NAK repeats it, however late within T2."""
    bench.tell(dread(8), 1000)
    assert bench.tell(NAK, 100) == REPLY


def test_a_nak_garbled_into_another_byte_is_ignored_and_t2_repeats(bench: MscBench) -> None:
    """As if nothing had come."""
    bench.tell(dread(8), 100)
    assert bench.tell(b"\x95", 500) == b""
    assert bench.wait(600) == REPLY


def test_two_acks_are_one(bench: MscBench) -> None:
    """The second is a stray."""
    bench.tell(dread(8), 100)
    assert bench.tell(ACK + ACK, 20_000) == b""


def test_a_nak_behind_the_own_ack_is_ignored(bench: MscBench) -> None:
    """The reply is gone; ask again."""
    bench.tell(dread(8), 100)
    assert bench.tell(ACK + NAK, 20_000) == b""


def test_packets_back_to_back_are_served_in_order(bench: MscBench) -> None:
    """From the receive buffer (MSC-AMB-39): writes one after the other."""
    heard = bench.tell(dwrite(8, 1) + dwrite(12, 2) + broken(rqstat()) + dwrite(8, 3), 500)
    assert heard == ACK + ACK + NAK + ACK
    assert (bench.value(8), bench.value(12)) == (3, 2)


def test_a_read_behind_a_read_takes_the_place_of_its_answer(bench: MscBench) -> None:
    """Both are answered: the second packet is there when the first reply has left."""
    assert bench.tell(dread(8) + rqstat(), 300) == ACK + REPLY + ACK + STATUS
    assert bench.settle() == 5 * STATUS


def test_bytes_of_a_refused_packet_are_never_looked_at_again() -> None:
    """A whole RQSTAT inside a bad BWRITE: one NAK, nothing else (MSC-LNK-24)."""
    inside = (b"\0\0" + rqstat()).ljust(128, b"\0")
    bench = MscBench()
    assert bench.tell(broken(packet(1, b"BWRITE,\x08\0" + inside)), 20_000) == NAK


def test_a_packet_inside_the_data_of_a_good_one_is_data() -> None:
    """Exactly one ACK (MSC-PKT-15)."""
    inside = (b"\0\0" + rqstat()).ljust(128, b"\0")
    bench = MscBench()
    assert bench.tell(packet(1, b"BWRITE,\x08\0" + inside), 20_000) == ACK
