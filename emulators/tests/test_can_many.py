"""As many modules as there are addresses on one bus: they boot, answer and move in one process."""

from collections.abc import Iterator
from itertools import pairwise

import can
import pytest

from axistwin.canbus import AxistwinBus
from axistwin.kernel.time import NS_PER_S
from axistwin.wire.can_frame import INTERMISSION_BITS, CanFrame, wire_bits

ADDRESSES = range(1, 128)
CHANNEL = "mac23-can:" + ",".join(map(str, ADDRESSES))
BIT_NS = 8000  # 125 kbit/s
BOOT_NS, LIFEBEAT_NS, LATENCY_NS = 2 * NS_PER_S, 10 * NS_PER_S, 1_000_000


@pytest.fixture
def bus() -> Iterator[AxistwinBus]:
    """127 modules in virtual time, whose supply is applied at time 0."""
    bus = can.Bus(
        interface="axistwin", channel=CHANNEL, time="virtual", cold=True, ignore_config=True
    )
    assert isinstance(bus, AxistwinBus)
    yield bus
    bus.shutdown()


def time_ns(message: can.Message) -> int:
    """Its time stamp to the nanosecond: a float of that size is exact enough."""
    return round(message.timestamp * NS_PER_S)


def frame_ns(message: can.Message, *, spaced: bool = True) -> int:
    """How long it is on the bus, the intermission included if it is ``spaced``."""
    frame = CanFrame(message.arbitration_id, bytes(message.data))
    return (wire_bits(frame) + (INTERMISSION_BITS if spaced else 0)) * BIT_NS


def message(identifier: int, data: bytes = b"") -> can.Message:
    """With an 11-bit identifier."""
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False)


def request(address: int, command: int, index: int, value: int = 0) -> can.Message:
    """An SDO request."""
    head = bytes((command, index, 0x20, 0))
    return message(0x600 + address, head + value.to_bytes(4, "big", signed=value < 0))


def hear(bus: AxistwinBus, count: int, patience_s: float) -> list[can.Message]:
    """The next ``count`` messages."""
    heard: list[can.Message] = []
    for _ in range(count):
        received = bus.recv(patience_s)
        assert received is not None, f"only {len(heard)} of {count}"
        heard.append(received)
    return heard


def assert_without_a_gap(heard: list[can.Message], first_start_ns: int) -> None:
    """One after the other in the order of their identifiers, as arbitration has it."""
    assert time_ns(heard[0]) == first_start_ns + frame_ns(heard[0], spaced=False)
    for before, after in pairwise(heard):
        assert before.arbitration_id < after.arbitration_id
        assert time_ns(after) == time_ns(before) + INTERMISSION_BITS * BIT_NS + frame_ns(
            after, spaced=False
        )


@pytest.mark.strength
def test_127_modules_boot_answer_and_move_on_one_bus(bus: AxistwinBus) -> None:
    """All boot in one instant, every one answers its own request, and one SYNC moves them all."""
    boots = hear(bus, 127, 3)
    assert [each.arbitration_id for each in boots] == [0x700 + address for address in ADDRESSES]
    assert_without_a_gap(boots, BOOT_NS)

    for address in ADDRESSES:
        bus.send(request(address, 0x40, 0x00))
        (reply,) = hear(bus, 1, 0.1)
        assert (reply.arbitration_id, reply.data.hex()) == (0x580 + address, "4200200000000000")

    bus.send(request(0, 0x23, 0x10))  # to all: wait for the synchronisation; module 1 answers
    assert hear(bus, 1, 0.1)[0].data[0] == 0x60
    for address in ADDRESSES:
        bus.send(request(address, 0x23, 0x13, 10 * address - 640))
        assert hear(bus, 1, 0.1)[0].data[0] == 0x60
    bus.advance(1)
    assert {twin.position for twin in bus.twins} == {0}
    bus.send(message(0x080))
    bus.advance(0.01)
    assert all(twin.is_moving for twin in bus.twins if twin.address != 64)
    bus.advance(3)
    assert [twin.position for twin in bus.twins] == [10 * each - 640 for each in ADDRESSES]


def test_requests_in_a_burst_are_all_answered(bus: AxistwinBus) -> None:
    """127 at once: requests and replies compete for the bus, none is lost (MACC-SDO-06)."""
    hear(bus, 127, 3)
    for address in ADDRESSES:
        bus.send(request(address, 0x40, 0x07))
    replies = hear(bus, 127, 0.1)
    assert {each.arbitration_id for each in replies} == {0x580 + each for each in ADDRESSES}
    assert bus.recv(1) is None
    # The replies have the lower identifiers, and are ready long before the last request has left.
    sent = sum(frame_ns(request(address, 0x40, 0x07)) for address in ADDRESSES)
    answered = sum(frame_ns(each) for each in replies)
    busy_ns = time_ns(replies[-1]) - time_ns(replies[0])
    assert busy_ns < sent + answered + LATENCY_NS


@pytest.mark.strength
def test_lifebeats_of_127_modules_never_drift_apart(bus: AxistwinBus) -> None:
    """Ten minutes of silence: every 10 s each tells one, all in one instant, in order."""
    hear(bus, 127, 3)
    bus.set_filters([{"can_id": 0x080, "can_mask": 0x780, "extended": False}])
    for number in range(1, 61):
        beats = hear(bus, 127, 11)
        assert [each.arbitration_id for each in beats] == [0x080 + each for each in ADDRESSES]
        assert_without_a_gap(beats, BOOT_NS + number * LIFEBEAT_NS)
