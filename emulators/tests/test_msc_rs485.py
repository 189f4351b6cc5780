"""Several controllers on one RS-485 line: each behaves as if it were alone (ledger §5.5)."""

import random
from dataclasses import dataclass

import pytest
from msc_bench import (
    ACK,
    CHARACTER_NS,
    NAK,
    MscBench,
    bread,
    broken,
    bwrite,
    dread,
    dwrite,
    flag,
    rflags,
    rqstat,
    word,
)

from axistwin.devices.msc.packets import packet
from axistwin.kernel.time import NS_PER_MS
from axistwin.wire.framing import LineFormat

UNITS = (2, 7, 15)
BROKEN_UNIT = 7


@dataclass(frozen=True)
class Step:
    """One exchange with ``unit``: what is sent, what the host answers, how long it waits."""

    unit: int
    data: bytes
    answers: bytes = ACK
    wait_ms: int = 350


def exchange(bench: MscBench, step: Step) -> list[bytes]:
    """All that the host hears in answer to each of its sendings."""
    heard = [bench.tell(step.data, step.wait_ms)]
    if len(heard[0]) > 1:
        heard += [bench.tell(bytes((byte,)), 200) for byte in step.answers]
    return heard


def good(rng: random.Random, unit: int) -> Step:
    """Any complete exchange, with up to three refused replies."""
    address = rng.randrange(0, 0x2000) * 4
    kind = rng.randrange(9)
    values = [rng.getrandbits(32) - (1 << 31) for _ in range(32)]
    # Values that look like packets for somebody else.
    values[5:9] = [0x00020100, 0x07000052, 0x51535441, 0x542C0213]
    data = (
        dread(address, unit),
        dwrite(address, values[0], unit),
        bread(address & 0x3FFC, unit),
        bwrite(address & 0x3FFC, values, unit),
        flag("RFLAG", rng.randrange(256), unit),
        flag("SFLAG", rng.randrange(256), unit),
        flag("CFLAG", rng.randrange(256), unit),
        rflags(unit),
        rqstat(unit),
    )[kind]
    return Step(unit, data, NAK * rng.randrange(4) + ACK)


def bad(rng: random.Random, unit: int) -> Step:
    """A packet for ``unit`` that is broken in one way or another; then silence for T1."""
    whole = good(rng, unit).data
    kind = rng.randrange(5)
    if kind == 0:
        return Step(unit, broken(whole))
    if kind == 1:
        return Step(unit, whole[: rng.randrange(2, len(whole))], wait_ms=1300)
    if kind == 2:
        return Step(unit, packet(unit, rng.randbytes(rng.randrange(241, 600))), wait_ms=1300)
    if kind == 3:
        return Step(unit, packet(unit, rng.randbytes(rng.randrange(240))))
    place = rng.randrange(6, len(whole))
    changed = bytes((whole[place] ^ 1 << rng.randrange(8),))
    return Step(unit, whole[:place] + changed + whole[place + 1 :])


def script(rng: random.Random, length: int) -> list[Step]:
    """Exchanges with all units in any order; those of one are broken, often."""
    steps = []
    for _ in range(length):
        unit = rng.choice(UNITS)
        is_bad = unit == BROKEN_UNIT and rng.random() < 0.6
        steps.append(bad(rng, unit) if is_bad else good(rng, unit))
    return steps


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("mode", ["two_wire", "four_wire"])
def test_three_units_behave_as_if_each_were_alone(seed: int, mode: str) -> None:
    """Answers, memory and flags, under interleaved traffic with broken packets for one of them."""
    steps = script(random.Random(seed), 60)
    together = MscBench(*UNITS, rs485_mode=mode)
    alone = {unit: MscBench(unit, rs485_mode=mode) for unit in UNITS}
    for step in steps:
        assert exchange(together, step) == exchange(alone[step.unit], step), step
    for device, unit in zip(together.devices, UNITS, strict=True):
        twin = alone[unit].device
        assert device.cells(together.now) == twin.cells(alone[unit].now)
        assert device.flags.states(together.now) == twin.flags.states(alone[unit].now)
        assert [data for _, data in device.sent] == [data for _, data in twin.sent]
        assert device.describe(together.now)["state"] == "IDLE"


@pytest.mark.parametrize("paced", [True, False])
def test_only_the_unit_that_is_meant_answers(paced: bool) -> None:
    """All fifteen numbers on one line, each asked for what only it has (MSC-PKT-05)."""
    units = tuple(range(1, 16))
    bench = MscBench(*units, paced=paced)
    for unit in units:
        assert bench.ask(dwrite(8, 1000 + unit, unit)) == ACK
    for unit in reversed(units):
        heard = bench.ask(dread(8, unit))
        assert heard == ACK + packet(unit, b"DREAD," + (1000 + unit).to_bytes(4, "big"))


def test_unit_1_among_others_is_on_rs485() -> None:
    """``transport`` = auto: rs232 only for unit 1 alone on its line."""
    assert MscBench(1).device.is_rs232
    assert not MscBench(1, 2).devices[0].is_rs232
    assert not MscBench(2).device.is_rs232
    assert MscBench(2, transport="rs232").device.describe(0)["address"] == 1
    assert MscBench(1, transport="rs485").tell(b"\x02", 2000) == b""


CARRIER = packet(2, (b"BWRITE,\x08\0" + bytes(5) + rqstat()).ljust(137, b"\0"))


def test_the_carrier_of_the_ledger() -> None:
    """Byte for byte; unit 1 stays silent, whether unit 2 is there or not (MSC-AMB-14)."""
    head = "02 02 00 89 00 00 42 57 52 49 54 45 2C 08 00 00 00 00 00 00 "
    inside = "02 01 00 07 00 00 52 51 53 54 41 54 2C 02 13 "
    assert bytes.fromhex(head + inside + "00 " * 108 + "04 B6") == CARRIER
    assert MscBench(1, 3).tell(CARRIER, 3000) == b""
    assert MscBench(1, 2).tell(CARRIER, 3000) == ACK


def test_replies_of_others_are_no_requests() -> None:
    """An RFLAG reply "on" of unit 2 is a good RFLAG request to it; nobody else is concerned."""
    bench = MscBench(*UNITS)
    bench.perform(bench.devices[0].set_flag(0, 200, on=True))
    assert bench.ask(flag("RFLAG", 200, 2)) == ACK + packet(2, b"RFLAG,\0\1")
    assert bench.settle() == b""


def test_two_units_with_one_number_collide_and_take_each_others_replies() -> None:
    """Trap 23: on one pair of wires each hears what the other says."""
    bench = MscBench(4, 4)
    heard = bench.tell(rqstat(4), 100)
    assert heard != ACK + packet(4, b"RQSTAT," + bytes(8))
    assert all(device.sent for device in bench.devices)


def test_a_unit_left_waiting_stops_when_the_host_turns_to_another() -> None:
    """The STX of the next packet ends its wait; it follows that packet in silence."""
    bench = MscBench(*UNITS)
    assert len(bench.tell(dread(8, 2), 300)) == 19
    heard = bench.tell(dread(8, 7), 300)
    assert heard == ACK + packet(7, b"DREAD," + bytes(4))
    bench.tell(ACK)
    assert bench.settle() == b""


def test_a_unit_left_waiting_takes_the_nak_of_another_for_its_own() -> None:
    """Trap 39, where an STX does not end the wait: both transmit."""
    bench = MscBench(*UNITS, stx_while_waiting="ignore")
    bench.tell(dread(8, 2), 100)
    bench.tell(broken(packet(7, b"DREAD,\x09\x0a")), 100)  # nothing in it is 06h or 15h but a sum
    assert bench.devices[1].sent[-1][1] == NAK
    assert len(bench.devices[0].sent) == 3  # the reply again, which nobody asked for


def test_a_kept_reply_is_repeated_when_its_time_limit_has_run_out_behind_another_packet() -> None:
    """MSC-AMB-45: T2 goes on during the packet for another unit, and takes effect behind it."""
    bench = MscBench(
        3, pending_reply_on_stx="keep_if_foreign", ack_timeout_ms=200, packet_timeout_ms=1000
    )
    reply = bench.tell(dread(8, 3), 150)[1:]
    packet_for_another = rqstat(9)
    assert bench.tell(packet_for_another[:5], 100) == b""  # T2 is over meanwhile
    assert bench.tell(packet_for_another[5:], 100) == reply
    bench.tell(ACK)
    assert bench.settle() == b""


@pytest.mark.parametrize("heard", [2, 5])
def test_a_kept_reply_outlives_a_packet_for_another_unit_that_breaks_off(heard: int) -> None:
    """MSC-AMB-45: T1 ends that packet in silence, and the wait goes on."""
    bench = MscBench(
        3, pending_reply_on_stx="keep_if_foreign", ack_timeout_ms=5000, packet_timeout_ms=300
    )
    reply = bench.tell(dread(8, 3), 100)[1:]
    assert bench.tell(rqstat(9)[:heard], 400) == b""
    assert bench.tell(NAK, 100) == reply


def test_on_one_pair_a_unit_is_silent_for_the_turnaround() -> None:
    """At least that long behind the last byte, however fast it is else."""
    bench = MscBench(2, response_delay_ms=0, turnaround_ms=3)
    heard_ns = bench.send(rqstat(2))
    bench.wait(100)
    assert bench.sent[0] == (heard_ns + 3 * NS_PER_MS, ACK)
    bench = MscBench(2, response_delay_ms=0, turnaround_ms=3, rs485_mode="four_wire")
    heard_ns = bench.send(rqstat(2))
    bench.wait(100)
    assert bench.sent[0] == (heard_ns, ACK)


def test_time_limits_of_packets_for_others_run_unheard() -> None:
    """All units forget a packet that broke off; only the one it was for answers."""
    bench = MscBench(*UNITS)
    bench.send(dread(8, 7)[:9])
    bench.settle()
    (refusal,) = [sending for device in bench.devices for sending in device.sent]
    assert refusal[1] == NAK
    assert refusal[0] - CHARACTER_NS - 1000 * NS_PER_MS == 70_000  # the skew of the second unit
    for unit in UNITS:
        assert bench.ask(rqstat(unit))[:1] == ACK


def test_a_broken_length_for_one_swallows_what_follows_for_all() -> None:
    """Until T1: everybody follows by length."""
    bench = MscBench(*UNITS)
    damaged = b"\x02\x07" + word(200) + b"\0\0"
    bench.send(damaged)
    bench.wait(50)
    assert bench.tell(rqstat(2), 300) == b""
    assert bench.wait(1000) == NAK
    assert bench.ask(rqstat(2))[:1] == ACK


@pytest.mark.strength
@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_noise_on_a_shared_line_disturbs_nobody_for_long(seed: int, paced: bool) -> None:
    """Packets cut and joined, collisions, wrong rates, breaks: then each unit answers as ever."""
    rng = random.Random(seed)
    bench = MscBench(*UNITS, paced=paced)
    for _ in range(150):
        for _ in range(rng.randrange(1, 5)):
            unit = rng.choice(UNITS)
            bench.send(rng.choice((good(rng, unit).data, bad(rng, unit).data, rng.randbytes(30))))
            bench.wait(rng.choice((0, 3, 17, 200)))
        if rng.random() < 0.1:
            bench.network.send_break(rng.randrange(1, 50) * NS_PER_MS)
        if rng.random() < 0.1:
            bench.network.host_format = LineFormat(rng.choice((9600, 19200, 9600)))
    bench.network.host_format = LineFormat(9600)
    bench.settle()
    bench.tell(ACK)
    bench.settle()
    for unit in UNITS:
        assert bench.ask(rqstat(unit)) == ACK + packet(unit, b"RQSTAT," + bytes(8))
