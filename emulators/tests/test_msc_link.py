"""The link layer of a controller: every cell of the table in ledger §4.1."""

from collections.abc import Callable

import pytest
from msc_bench import (
    ACK,
    CHARACTER_NS,
    F9600,
    NAK,
    REPLY,
    STATUS,
    MscBench,
    broken,
    dread,
    dwrite,
    rqstat,
)

from axistwin.devices.msc.packets import packet
from axistwin.kernel.time import NS_PER_MS
from axistwin.wire.framing import Chunk

OTHER = dread(8, unit=2)
"""A packet for another unit."""


@pytest.fixture
def bench() -> MscBench:
    """A controller alone on its line, with the defaults."""
    return MscBench()


# ---- how each state of the table is reached, and what a byte then must lead to -------------------


def idle(bench: MscBench) -> None:
    """IDLE."""


def header(bench: MscBench) -> None:
    """HDR: two bytes of the header."""
    bench.tell(rqstat()[:2], 5)


def body(bench: MscBench) -> None:
    """BODY: in the middle of the name."""
    bench.tell(rqstat()[:9], 12)


def checksum(bench: MscBench) -> None:
    """CSUM: the last byte of the sum is missing."""
    bench.tell(rqstat()[:-1], 20)


def skip(bench: MscBench) -> None:
    """SKIP: half a packet for another unit."""
    bench.tell(OTHER[:10], 15)


def execute(bench: MscBench) -> None:
    """EXEC: the ACK is on its way."""
    bench.run_until(bench.send(dread(8)) + 3 * NS_PER_MS)
    assert bench.device.describe(bench.now)["state"] == "EXEC"


def wait(bench: MscBench) -> None:
    """WAIT: the reply has left."""
    assert bench.tell(dread(8), 100) == ACK + REPLY


def repeating(bench: MscBench) -> None:
    """RETX: the reply is on its way again."""
    wait(bench)
    bench.run_until(bench.send(NAK) + 15 * NS_PER_MS)
    assert bench.device.describe(bench.now)["state"] == "EXEC"


STATE_NAMES: dict[Callable[[MscBench], None], str] = {
    idle: "IDLE",
    header: "HEADER",
    body: "BODY",
    checksum: "BODY",
    skip: "SKIP",
}


@pytest.mark.parametrize("reach", STATE_NAMES)
def test_the_states_are_told(bench: MscBench, reach: Callable[[MscBench], None]) -> None:
    """For panels and failing tests."""
    reach(bench)
    assert bench.device.describe(bench.now)["state"] == STATE_NAMES[reach]


def test_waiting_is_told(bench: MscBench) -> None:
    """WAIT, and IDLE behind the host's ACK."""
    wait(bench)
    assert bench.device.describe(bench.now)["state"] == "WAIT"
    bench.tell(ACK)
    assert bench.device.describe(bench.now)["state"] == "IDLE"


# -- column IDLE --


def test_idle_takes_02h_for_the_start_of_a_packet(bench: MscBench) -> None:
    """And T1 starts: alone on RS-232 it is refused when it runs out."""
    heard_ns = bench.send(b"\x02")
    assert bench.wait(999) == b""
    bench.settle()
    assert bench.sent == [(heard_ns + 1000 * NS_PER_MS, NAK)]


@pytest.mark.parametrize("byte", [0x06, 0x15, 0x00, 0x01, 0x41, 0xFF])
def test_idle_ignores_every_other_byte(bench: MscBench, byte: int) -> None:
    """ACK, NAK and noise (MSC-LNK-15, MSC-PKT-20); the next packet is served."""
    assert bench.tell(bytes((byte,)) * 3, 20_000) == b""
    assert bench.ask(rqstat()) == ACK + STATUS


@pytest.mark.parametrize("byte", sorted(set(range(256)) - {2}))
def test_idle_ignores_each_byte_that_is_no_stx(byte: int) -> None:
    """None of the 255 (MSC-PROP-15)."""
    device = MscBench().device
    assert device.receive(Chunk(0, bytes((byte,)), F9600)) == []
    assert device.next_event() is None


# -- columns HDR, BODY, CSUM, SKIP: a byte is a byte --


@pytest.mark.parametrize("byte", [0x02, 0x06, 0x15, 0x41])
@pytest.mark.parametrize("place", [1, 2, 3, 4, 5])
def test_a_byte_of_the_header_is_a_byte_of_the_header(place: int, byte: int) -> None:
    """02h restarts nothing, 06h and 15h are no answers; the packet is judged by what it says."""
    raw = bytearray(rqstat())
    raw[place] = byte
    bench = MscBench()
    heard = bench.tell(bytes(raw), 50)
    if place == 1:
        assert heard == bench.settle() == b""  # for somebody else
        return
    if place == 2:  # a packet of more than 512 bytes is waited for
        assert heard == b""
    elif place == 3 and byte in (0x02, 0x06):  # shorter: the sum is looked for too early
        assert heard == NAK
    elif place == 3:
        assert heard == b""
    else:
        assert heard == NAK  # a block number that is not in the sum
    if place == 3 and byte == 0x02:
        return  # what is behind it begins with no STX
    bench.settle()
    assert bench.ask(rqstat()) == ACK + STATUS


@pytest.mark.parametrize("byte", [0x02, 0x06, 0x15, 0x11, 0x13, 0x2C])
def test_a_byte_of_the_body_is_a_byte_of_the_body(bench: MscBench, byte: int) -> None:
    """The values of a body are data, whatever they are (MSC-PKT-15, MSC-PHY-05, MSC-CMD-08)."""
    value = int.from_bytes(bytes((byte,)) * 4, "big")
    address = byte << 8 | byte & 0xFC
    assert bench.tell(dwrite(address, value)) == ACK
    assert bench.value(address) == value


@pytest.mark.strength
def test_a_byte_of_the_checksum_is_a_byte_of_the_checksum() -> None:
    """02h, 06h and 15h in either byte of the sum start and answer nothing."""
    seen = set()
    for low in range(0, 0x7FFC, 4):
        raw = dread(low)
        if set(raw[-2:]) & {0x02, 0x06, 0x15}:
            seen |= {(place, raw[place]) for place in (-2, -1) if raw[place] in (0x02, 0x06, 0x15)}
            device = MscBench().device
            assert len(device.receive(Chunk(0, raw, F9600))) == 1
            for at in range(len(raw)):
                device.receive(Chunk(10**9, raw[at : at + 1], F9600, at))
    assert seen >= {(-2, 0x02), (-1, 0x02), (-1, 0x06), (-1, 0x15)}


@pytest.mark.parametrize("byte", [0x02, 0x06, 0x15, 0x41])
def test_a_byte_of_a_packet_for_another_unit_is_counted(byte: int) -> None:
    """Whatever it is, and right or wrong: the next packet begins behind the last one."""
    bench = MscBench(1, 3)
    assert bench.tell(packet(2, bytes((byte,)) * 20)) == b""
    assert bench.tell(broken(packet(2, bytes((byte,)) * 20))) == b""
    assert bench.tell(packet(2, bytes((byte,)) * 20) + rqstat())[:1] == ACK


# -- column EXEC --


@pytest.mark.parametrize("byte", [0x02, 0x41, 0x00])
def test_bytes_in_exec_are_kept_for_later(bench: MscBench, byte: int) -> None:
    """They are looked at when the reply has left: 02h starts a packet then, others are noise."""
    execute(bench)
    rest = bytes((byte,)) + (rqstat()[1:] if byte == 0x02 else b"")
    heard = bench.tell(rest, 200)
    assert heard == (ACK + REPLY + ACK + STATUS if byte == 0x02 else ACK + REPLY)


@pytest.mark.parametrize("byte", [ACK, NAK])
def test_an_answer_in_exec_is_taken_when_the_reply_has_left(bench: MscBench, byte: bytes) -> None:
    """Too early an ACK counts; so does a NAK (ledger §4.3)."""
    execute(bench)
    heard = bench.tell(byte, 900)
    assert heard == ACK + REPLY + (REPLY if byte == NAK else b"")
    assert len(bench.settle()) == (0 if byte == ACK else 4 * len(REPLY))


def test_the_receive_buffer_has_256_bytes() -> None:
    """What comes in EXEC beyond them is lost (MSC-AMB-39)."""
    bench = MscBench(reply_delay_ms=2000)
    execute(bench)
    noise = 256 - len(rqstat())
    assert bench.tell(b"\0" * noise + rqstat() + rqstat(), 1000) == ACK
    assert bench.wait(1100) == REPLY + ACK  # the packet that was kept is served
    assert bench.wait(2500) == STATUS
    assert bench.tell(ACK, 5000) == b""  # the other one was lost


# -- column WAIT --


def test_waiting_takes_02h_for_a_new_packet(bench: MscBench) -> None:
    """The reply is dropped, the new packet served (MSC-LNK-16)."""
    wait(bench)
    assert bench.tell(rqstat()) == ACK + STATUS
    assert bench.tell(ACK, 20_000) == b""


def test_waiting_takes_06h_for_the_end(bench: MscBench) -> None:
    """Nothing answers it (MSC-LNK-11)."""
    wait(bench)
    assert bench.tell(ACK, 20_000) == b""
    assert bench.device.next_event() is None


def test_waiting_takes_15h_for_a_wish_to_hear_it_again(bench: MscBench) -> None:
    """Five times; the sixth ends it (MSC-LNK-09, MSC-LNK-13)."""
    wait(bench)
    for _ in range(5):
        assert bench.tell(NAK, 100) == REPLY
    assert bench.tell(NAK, 20_000) == b""
    assert bench.ask(rqstat()) == ACK + STATUS


@pytest.mark.parametrize("byte", [0x00, 0x07, 0x41, 0xFF])
def test_waiting_ignores_other_bytes_and_goes_on_waiting(bench: MscBench, byte: int) -> None:
    """T2 is neither stopped nor started anew."""
    wait(bench)
    left_ns = bench.sent[-1][0] + len(REPLY) * 10 * 10**9 // 9600
    assert bench.tell(bytes((byte,)), 100) == b""
    assert bench.device.next_event() == left_ns + 1000 * NS_PER_MS
    assert bench.tell(NAK, 100) == REPLY


# -- column RETX --


@pytest.mark.parametrize(
    ("data", "then"),
    [
        (b"\x02" + rqstat()[1:], REPLY + ACK + STATUS),
        (ACK, REPLY),
        (NAK, REPLY + REPLY),
        (b"A", REPLY),
    ],
)
def test_bytes_during_a_repeat_act_as_in_wait_once_it_has_left(
    bench: MscBench, data: bytes, then: bytes
) -> None:
    """A packet is served, an ACK ends it, a NAK repeats, the rest is ignored."""
    repeating(bench)
    assert bench.tell(data, 300) == then
    assert (bench.device.next_event() is None) is (data == ACK)


# -- row "UART framing or overrun error" --


def bad(bench: MscBench, byte: int = 0x41) -> None:
    """One character with a bad stop bit arrives."""
    chunk = Chunk(bench.now, bytes((byte,)), F9600, errors=(0,))
    bench.perform(bench.device.receive(chunk))
    bench.wait(2)


@pytest.mark.parametrize("byte", [0x02, 0x06, 0x15, 0x41])
@pytest.mark.parametrize("reach", [idle, execute, wait, repeating])
def test_a_bad_character_outside_packets_is_ignored(
    reach: Callable[[MscBench], None], byte: int
) -> None:
    """It starts nothing and ends nothing."""
    bench, other = MscBench(), MscBench()
    for each in (bench, other):
        reach(each)
    bad(bench, byte)
    other.wait(2)
    assert bench.wait(20_000) == other.wait(20_000)
    assert bench.sent == other.sent


@pytest.mark.parametrize("place", [1, 2, 4, 6, 12, 13, 14])
def test_a_bad_character_in_a_packet_makes_it_bad(place: int) -> None:
    """Header, body or sum: it is counted, and the packet is refused at its end."""
    raw, bench = rqstat(), MscBench()
    bench.tell(raw[:place], 20)
    bad(bench, raw[place])
    assert bench.tell(raw[place + 1 :], 100) == NAK
    assert bench.ask(raw) == ACK + STATUS


def test_a_bad_character_in_a_packet_for_another_unit_is_counted(bench: MscBench) -> None:
    """The packet ends where it says."""
    bench.tell(OTHER[:10], 20)
    bad(bench)
    assert bench.tell(OTHER[11:] + rqstat()) == ACK + STATUS


def test_a_break_in_a_packet_makes_it_bad(bench: MscBench) -> None:
    """A long space is one bad character: here it takes the place of the last one."""
    bench.send(rqstat()[:-1])
    bench.network.send_break(20 * NS_PER_MS)
    assert bench.wait(100) == NAK


# -- rows "T1 runs out", "T2 runs out", "repeat has left", "power cycle" --


@pytest.mark.parametrize("count", range(1, 15))
def test_a_packet_that_breaks_off_is_refused_at_the_time_limit_and_not_before(
    bench: MscBench, count: int
) -> None:
    """One NAK, T1 behind the arrival of the STX to the nanosecond, wherever it broke off."""
    bench.send(rqstat()[:count])
    bench.run_until(CHARACTER_NS + 1000 * NS_PER_MS - 1)
    assert bench.sent == []
    bench.settle()
    assert bench.sent == [(CHARACTER_NS + 1000 * NS_PER_MS, NAK)]
    assert bench.ask(rqstat()) == ACK + STATUS


@pytest.mark.parametrize("count", range(2, 16))
def test_a_packet_for_another_unit_that_breaks_off_is_forgotten(
    bench: MscBench, count: int
) -> None:
    """Silently, at the same time: the next packet begins anew."""
    bench.send(OTHER[:count])
    bench.run_until(CHARACTER_NS + 1000 * NS_PER_MS)
    assert bench.device.describe(bench.now)["state"] == "IDLE"
    assert bench.ask(rqstat()) == ACK + STATUS
    assert len(bench.sent) == 2


def test_a_lone_stx_is_refused_on_rs232_and_forgotten_on_rs485() -> None:
    """All units of a line would answer at once (MSC-AMB-31)."""
    assert MscBench(1).tell(b"\x02", 2000) == NAK
    assert MscBench(2).tell(b"\x02", 2000) == b""
    assert MscBench(1, 2, 3).tell(b"\x02", 2000) == b""


def test_a_byte_that_comes_just_in_time_counts() -> None:
    """The last byte complete in the very nanosecond of the time limit; one later is too late."""
    for late_ns, answer in ((0, ACK), (1, NAK)):
        bench = MscBench()
        bench.send(dwrite(8, 1)[:-1])
        due_ns = CHARACTER_NS + 1000 * NS_PER_MS
        bench.run_until(due_ns - CHARACTER_NS + late_ns)
        bench.send(dwrite(8, 1)[-1:])
        bench.wait(500)
        assert bench.sent[0][1] == answer


@pytest.mark.parametrize("reach", [header, body, checksum, skip, execute, wait, repeating])
def test_a_power_cycle_forgets_everything(
    bench: MscBench, reach: Callable[[MscBench], None]
) -> None:
    """IDLE, R = 0, nothing sent (MSC-PHY-04)."""
    reach(bench)
    count = len(bench.sent)
    bench.network.power_off(0)
    bench.wait(100)
    bench.network.power_on(0)
    assert bench.settle() == b""
    assert len(bench.sent) == count
    wait(bench)
    for _ in range(5):
        assert bench.tell(NAK, 100) == REPLY
