"""Times as a client of the bus sees them: exact to the nanosecond of the model, for ever."""

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import can
import pytest

from axistwin.canbus import AxistwinBus
from axistwin.kernel.time import NS_PER_MS, NS_PER_S
from axistwin.wire.can_frame import CanFrame, wire_bits

S, MS = NS_PER_S, NS_PER_MS
BOOT_NS, LIFEBEAT_NS, LATENCY_NS = 2 * S, 10 * S, MS
TICK_NS = 125
BITRATES = (1_000_000, 125_000, 33_333)
READ = bytes.fromhex("4000200000000000")
RESET = bytes.fromhex("2300200000000000")
Opener = Callable[..., "Client"]


class Client:
    """A port of a bus of twins in virtual time."""

    def __init__(self, devices: str, **options: Any) -> None:
        bus = can.Bus(
            interface="axistwin", channel=devices, time="virtual", ignore_config=True, **options
        )
        assert isinstance(bus, AxistwinBus)
        self.bus = bus

    @property
    def now(self) -> int:
        """Nanoseconds since the beginning."""
        return self.bus.virtual_time_ns

    def frame_ns(self, identifier: int, data: bytes) -> int:
        """How long a frame is on the bus, from its SOF to the end of its EOF."""
        return wire_bits(CanFrame(identifier, data)) * S // self.bus._bus.bitrate

    def send(self, identifier: int, data: bytes = b"") -> int:
        """Send a frame on a bus that is idle; when it is complete."""
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        self.bus.send(message)
        return self.now + self.frame_ns(identifier, data)

    def start_of_next(self, patience_s: float = 11) -> tuple[int, int]:
        """When the next frame began, from its time stamp alone, and its identifier."""
        message = self.bus.recv(patience_s)
        assert message is not None
        length_ns = self.frame_ns(message.arbitration_id, bytes(message.data))
        return round(message.timestamp * S) - length_ns, message.arbitration_id

    def advance_to(self, time_ns: int) -> None:
        """Let time pass until exactly then."""
        self.bus.advance((time_ns - self.now) / S)
        assert self.now == time_ns


@pytest.fixture
def opened() -> Iterator[Opener]:
    """Opens clients, each on a bus of its own devices; all is shut down after."""
    clients: list[Client] = []

    def open_client(devices: str, **options: Any) -> Client:
        clients.append(Client(devices, **options))
        return clients[-1]

    yield open_client
    for client in clients:
        client.bus.shutdown()


# ---- boot-up, reply, lifebeat --------------------------------------------------------------------


@pytest.mark.parametrize("bitrate", BITRATES)
def test_every_way_to_start_ends_in_a_boot_up_two_seconds_later(
    opened: Opener, bitrate: int
) -> None:
    """From power, the end of the reply to 2000h, the reset input, the address (MACC-BOOT-04)."""
    client = opened("mac23-can:5", bitrate=bitrate, cold=True)
    twin = client.bus.twins[0]
    assert client.start_of_next() == (BOOT_NS, 0x705)

    client.bus.advance(0.001)  # the intermission is over
    asked_ns = client.send(0x605, RESET)
    reply_ns, _ = client.start_of_next()
    assert reply_ns == asked_ns + LATENCY_NS
    left_ns = reply_ns + client.frame_ns(0x585, bytes.fromhex("6000200000000000"))
    assert client.start_of_next() == (left_ns + BOOT_NS, 0x705)

    client.advance_to(client.now + 12_345_678)
    twin.inputs.reset = True
    client.advance_to(client.now + 3 * S)
    twin.inputs.reset = False
    released_ns = client.now
    assert client.start_of_next() == (released_ns + BOOT_NS, 0x705)

    for data in (b"\4\1", b"\x11\6"):
        client.send(0x7E5, data.ljust(8, b"\0"))
        client.bus.advance(0.1)
    assert client.start_of_next()[1] == 0x7E4
    taken_ns = client.send(0x7E5, b"\4\0".ljust(8, b"\0"))
    assert client.start_of_next() == (taken_ns + BOOT_NS, 0x706)

    twin.power_off()
    client.advance_to(client.now + 987_654_321)
    twin.power_on()
    applied_ns = client.now
    assert client.start_of_next() == (applied_ns + BOOT_NS, 0x706)


@pytest.mark.parametrize("milliseconds", [1, 750, 60_000])
def test_the_boot_time_is_the_quirks(opened: Opener, milliseconds: int) -> None:
    """``boot_time_ms`` (MACC-AMB-25)."""
    client = opened(f"mac23-can:1?quirk.boot_time_ms={milliseconds}", cold=True)
    assert client.start_of_next(61) == (milliseconds * MS, 0x701)


@pytest.mark.parametrize("bitrate", BITRATES)
def test_ten_seconds_of_silence_count_from_the_end_of_the_last_request(
    opened: Opener, bitrate: int
) -> None:
    """At whatever nanosecond it came; then every ten seconds (MACC-EMCY-01, -05)."""
    client = opened("mac23-can:9", bitrate=bitrate)
    chance = random.Random(bitrate)
    for _ in range(20):
        client.advance_to(client.now + chance.randrange(9 * S))
        asked_ns = client.send(0x609, READ)
        assert client.start_of_next() == (asked_ns + LATENCY_NS, 0x589)
    for number in range(1, 100):
        assert client.start_of_next() == (asked_ns + number * LIFEBEAT_NS, 0x089)


def test_what_others_say_does_not_move_the_lifebeat(opened: Opener) -> None:
    """General, SYNC, address procedure, foreign requests, a bus full of frames (MACC-EMCY-05)."""
    client = opened("mac23-can:2", bitrate=1_000_000)
    frames = ((0x600, READ), (0x080, b""), (0x7E5, b"\4\1"), (0x603, READ), (0x123, b"12345678"))
    for number, (identifier, data) in enumerate(frames, 1):
        for _ in range(9):
            client.send(identifier, data)
            client.bus.advance(1)
        assert client.start_of_next() == (number * LIFEBEAT_NS, 0x082)


def test_an_emergency_is_sent_in_the_instant_of_its_cause(opened: Opener) -> None:
    """And the ten seconds count from it (MACC-EMCY-02, ledger §6.3)."""
    client = opened("mac23-can:3")
    client.advance_to(7_777_777_777)
    for volts in (11.0, 24.0):
        client.bus.twins[0].supply_volts = volts
        told_ns = client.now
        assert client.start_of_next() == (told_ns, 0x083)
        client.advance_to(client.now + 1_234_567)
    assert client.start_of_next() == (told_ns + LIFEBEAT_NS, 0x083)


def test_a_frame_that_waits_for_the_bus_moves_nothing_but_itself(opened: Opener) -> None:
    """The next lifebeat is where it would have been."""
    client = opened("mac23-can:3")
    client.advance_to(LIFEBEAT_NS - 1000)
    end_ns = client.send(0x001, b"12345678")
    late_ns, identifier = client.start_of_next()
    assert (late_ns, identifier) == (end_ns + 3 * 8000, 0x083)
    assert client.start_of_next() == (2 * LIFEBEAT_NS, 0x083)


@pytest.mark.parametrize("kind", ["boot", "lifebeat"])
def test_without_pacing_the_modules_own_times_stay(opened: Opener, kind: str) -> None:
    """Frames take no time; two seconds and ten seconds do."""
    client = opened("mac23-can:1", pacing=False, cold=kind == "boot")
    message = client.bus.recv(11)
    assert message is not None
    assert message.timestamp == (2 if kind == "boot" else 10)


# ---- two axes in step ----------------------------------------------------------------------------

SEGMENTS = 3000
STAGES = 3  # beyond the executing one
REAL, VIRTUAL = 0x16, 0x1E


@dataclass(frozen=True, slots=True)
class Segment:
    """|steps|·period ticks long; a virtual one stands still for so long."""

    index: int
    steps: int
    period: int

    @property
    def duration_ns(self) -> int:
        """Exactly so long (MACC-CMD-16-01, -1E-01)."""
        return abs(self.steps) * self.period * TICK_NS

    @property
    def distance(self) -> int:
        """Increments, with their sign."""
        return self.steps if self.index == REAL else 0

    def request(self) -> bytes:
        """As a download."""
        head = bytes((0x23, self.index, 0x20, 0))
        return head + (self.steps & 0xFFFF).to_bytes(2, "big") + self.period.to_bytes(2, "big")


def random_pair(chance: random.Random) -> list[Segment]:
    """Segments for two axes that last equally long, and hardly ever look alike."""
    steps, period = chance.randrange(30, 60), chance.randrange(1200, 4000)
    a, b = chance.choice(((1, 1), (2, 1), (5, 3), (1, 4)))
    shapes = ((steps * a, period * b), (steps * b, period * a))
    return [
        Segment(chance.choice((REAL, VIRTUAL)), length * chance.choice((1, -1)), ticks)
        for length, ticks in shapes
    ]


def store(client: Client, pair: list[Segment]) -> None:
    """A segment for each axis; both are accepted."""
    for address, segment in enumerate(pair, 1):
        client.send(0x600 + address, segment.request())
        message = client.bus.recv(0.01)
        assert message is not None
        assert (message.arbitration_id, message.data[0]) == (0x580 + address, 0x60)


@pytest.mark.strength
def test_real_and_virtual_segments_end_at_the_same_tick_on_both_axes(opened: Opener) -> None:
    """Thousands of them, queues kept filled while they run: no tick is lost (trap 37)."""
    client = opened("mac23-can:1,2", bitrate=1_000_000)
    chance = random.Random(16)
    first = [Segment(VIRTUAL, 4, 60_000)] * 2  # started on both at once, by the general message
    pairs = [first, *(random_pair(chance) for _ in range(SEGMENTS))]
    end_ns = client.send(0x600, first[0].request())
    assert client.start_of_next()[1] == 0x581
    for pair in pairs[1 : 1 + STAGES]:
        store(client, pair)
    expected = [0, 0]
    for number, pair in enumerate(pairs):
        end_ns += pair[0].duration_ns
        assert pair[0].duration_ns == pair[1].duration_ns
        expected = [place + segment.distance for place, segment in zip(expected, pair, strict=True)]
        last_steps = [(each.distance > 0) - (each.distance < 0) for each in pair]
        client.advance_to(end_ns - 1)
        before = [twin.position for twin in client.bus.twins]
        client.advance_to(end_ns)
        after = [twin.position for twin in client.bus.twins]
        assert after == expected, f"at the end of segment {number}"
        assert [b - a for a, b in zip(before, after, strict=True)] == last_steps
        if number + 1 + STAGES < len(pairs):
            store(client, pairs[number + 1 + STAGES])  # the stage has been free for no time
    assert not any(twin.is_moving for twin in client.bus.twins)
    assert end_ns > 20 * S
