"""The fence on a CAN bus: what a frame would ask for, and which reply tells what became of it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from axistwin_conformance.base.errors import OutsideEnvelope
from axistwin_conformance.core.readings import Readings
from axistwin_conformance.families.mac.axis.travel_guard import AxisTravelGuard
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import CanRequest
from axistwin_conformance.families.mac.can.reader import BusReader
from axistwin_conformance.transport.can_frame import Frame

SECOND = 1_000_000_000
OWN, OTHER, ALL = 1, 3, codec.GENERAL_ADDRESS
F6 = 0xF60000
KNOWN = {"can_byte_order": "big", "vel_f6_direction": "negative", "segment_signed": "true"}
BOOT_UP, LIFEBEAT = Frame(0x701, b"\0"), Frame(0x081, bytes(8))


def reply(
    one: CanRequest, command: int, data: bytes = bytes(4), address: int | None = None
) -> Frame:
    """What a module says to a request."""
    head = bytes([command, one.index_low, one.index_high, one.sub_index])
    return Frame(codec.REPLY + (one.address if address is None else address), head + data)


class Bus:
    """A host and modules that say what the test tells them to, behind the fence."""

    def __init__(self, **readings: str) -> None:
        self.readings = readings
        self.travel_guard = AxisTravelGuard(
            BusReader(readings), 2000, 10_000, OWN, Readings(readings)
        )
        self.now_ns = 0

    def request(self, index: int, parameter: int = 0, address: int = OWN) -> CanRequest:
        """A request as the suite builds it."""
        order = self.readings.get("can_byte_order", "big")
        return codec.request(address, index, parameter, byte_order=order)

    def send(self, frame: Frame, *replies: Frame) -> None:
        """Send a frame; what comes, comes 10 ms later."""
        self.travel_guard.sending(frame.pack(), self.now_ns)
        self.now_ns += SECOND // 100
        for one in replies:
            self.travel_guard.received(one.pack(), self.now_ns)

    def say(self, index: int, parameter: int = 0, address: int = OWN) -> None:
        """Send a request that is accepted."""
        one = self.request(index, parameter, address)
        self.send(one.frame(), reply(one, codec.ACCEPTED, address=address or OWN))

    def at(self, position: int, address: int = OWN) -> None:
        """A counter reading."""
        one = self.request(0x20, 0, address)
        data = codec.parameter_bytes(0x20, position, self.readings.get("can_byte_order", "big"))
        self.send(one.frame(), reply(one, 0x42, data))

    def holds_back(self, frame: Frame) -> bool:
        """True if the frame is held back; otherwise it is refused, as if never said."""
        before = dict(self.travel_guard.axes)
        try:
            self.travel_guard.sending(frame.pack(), self.now_ns)
        except OutsideEnvelope:
            return True
        self.travel_guard.axes = before
        return False

    def refuses(self, index: int, parameter: int = 0, address: int = OWN) -> bool:
        """True if a request is held back."""
        return self.holds_back(self.request(index, parameter, address).frame())

    def has_deadline(self) -> bool:
        """Whether the fence will stop an axis by itself."""
        return self.travel_guard.deadline_ns is not None


@pytest.fixture
def bus() -> Bus:
    """A bus whose axis was found at 500, with known readings."""
    bus = Bus(**KNOWN)
    bus.at(500)
    bus.say(0x0D, 0x1000)
    return bus


def test_targets_are_counted_from_where_the_axis_was_found(bus: Bus) -> None:
    """500 ± 2000, to the increment."""
    assert not bus.refuses(0x13, 2500)
    assert bus.refuses(0x13, 2501)
    assert not bus.refuses(0x13, -1500)
    assert bus.refuses(0x13, -1501)


def test_who_is_not_known_is_not_moved(bus: Bus) -> None:
    """A module that nobody named might be there."""
    assert bus.refuses(0x13, 500, address=OTHER)
    assert not bus.refuses(0x20, 0, address=OTHER)
    bus.at(0, address=OTHER)
    assert not bus.refuses(0x13, 500, address=OTHER)


def test_a_general_request_moves_all_that_are_known(bus: Bus) -> None:
    """A neighbour found at 3000 must not be sent to 600."""
    assert not bus.refuses(0x13, 600, address=ALL)
    bus.at(3000, address=OTHER)
    assert bus.refuses(0x13, 600, address=ALL)
    assert not bus.refuses(0x13, 1500, address=ALL)


def test_the_answer_to_a_general_request_tells_of_module_1_alone(bus: Bus) -> None:
    """The others' refusals are invisible: where it is refused, the others may have gone."""
    bus.at(0, address=OTHER)
    one = bus.request(0x15, F6 | 0x1000, address=ALL)
    bus.send(one.frame(), reply(one, codec.REFUSED, address=OWN))
    moving = {address for address, axis in bus.travel_guard.axes.items() if axis.speed}
    assert moving == {OTHER}
    bus.say(0x18, address=ALL)
    assert bus.has_deadline(), "only module 1 has said that it has stopped"
    bus.say(0x18, address=OTHER)
    assert not bus.has_deadline()


def test_sync_starts_what_every_module_holds(bus: Bus) -> None:
    """Held, endless motion needs no stop; started by SYNC, by whatever form of it, it does."""
    for sync in (codec.sync(), codec.sync(b"\x01")):
        bus.say(0x10)
        bus.say(0x15, 0x1000)
        assert not bus.has_deadline()
        bus.send(sync)
        assert bus.has_deadline()
        bus.say(0x18)
        bus.at(500)
        assert not bus.has_deadline()


def test_a_sync_that_is_held_back_has_no_room(bus: Bus) -> None:
    """Preloaded where there was room, it may not start where there is none any more."""
    bus.say(0x13, 2490)
    bus.say(0x10)
    bus.say(0x15, 0x2000)
    assert bus.holds_back(codec.sync())
    assert not bus.holds_back(Frame(codec.SYNC, b"", False, True, 0)), "nobody obeys a remote frame"


def test_the_address_procedure_makes_an_axis_known_by_another_address(bus: Bus) -> None:
    """Every module on the bus may have it from now on; seven bytes count as well as eight."""
    assert bus.refuses(0x13, 600, address=7)
    bus.send(codec.lmt_enter())
    bus.send(codec.lmt_address(7, length=7))
    bus.send(codec.lmt_leave())
    assert not bus.refuses(0x13, 600, address=7)
    assert bus.refuses(0x13, 2501, address=7)
    assert not bus.refuses(0x13, 600), "the old one is still possible"


@pytest.mark.parametrize("length", range(8))
def test_a_frame_that_is_too_short_counts_as_padded(bus: Bus, length: int) -> None:
    """Some device might obey it, with zeros for what is missing."""
    far = replace(bus.request(0x13, 0x00ABCDEF), length=length).frame()
    assert bus.holds_back(far) is (length > 5)
    fast = replace(bus.request(0x16, 0x00050001), length=length).frame()
    assert bus.holds_back(fast) is False, "without its last byte it has no period"


def test_a_short_frame_asks_a_device_that_ignores_them_for_nothing(bus: Bus) -> None:
    """Or each one would leave another doubt behind, of a counter cleared or not."""
    bus.readings["short_frame"] = "ignore"
    axes = dict(bus.travel_guard.axes)
    for index, parameter in ((0x0B, 0), (0x13, 0x00ABCDEF), (0x16, 0x7FFF1000)):
        bus.send(replace(bus.request(index, parameter), length=7).frame())
    assert bus.travel_guard.axes == axes


def test_another_command_byte_counts_as_a_download(bus: Bus) -> None:
    """What a device makes of 22h is a reading."""
    assert bus.holds_back(replace(bus.request(0x13, 0x00ABCDEF), command=0x22).frame())


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x601, bytes.fromhex("2313200000ABCDEF"), True),
        Frame(0x601, b"", False, True, 8),
        Frame(0x681, bytes.fromhex("2313200000ABCDEF")),
        Frame(0x601, bytes.fromhex("2313100000ABCDEF")),
        Frame(0x601, bytes.fromhex("23082000000000FF")),
        Frame(0x601, bytes.fromhex("231B2000000000FF")),
        Frame(0x000, bytes.fromhex("0201")),
    ],
)
def test_what_nobody_obeys_asks_for_nothing(bus: Bus, frame: Frame) -> None:
    """Extended and remote frames, identifiers of nobody, other objects, what CAN does not have."""
    axes = dict(bus.travel_guard.axes)
    bus.send(frame)
    assert bus.travel_guard.axes == axes


def test_a_refused_segment_does_not_count_and_an_unanswered_one_may(bus: Bus) -> None:
    """What was not obeyed leads nowhere; what may have been obeyed does."""
    one = bus.request(0x16, 900 << 16 | 0x1000)
    for _ in range(5):
        bus.send(one.frame(), reply(one, codec.REFUSED))
    bus.send(one.frame())
    bus.send(one.frame())
    assert bus.refuses(0x16, 900 << 16 | 0x1000)


@pytest.mark.parametrize("unasked", [BOOT_UP, LIFEBEAT, Frame(0x583, bytes(8)), Frame(0x7E4, b"")])
def test_what_is_no_reply_tells_nothing(bus: Bus, unasked: Frame) -> None:
    """Boot-up, lifebeat, another module's reply: the request may still have been obeyed."""
    one = bus.request(0x15, 0x1000)
    bus.send(one.frame(), unasked)
    assert bus.has_deadline()
    bus.travel_guard.received(reply(one, codec.REFUSED).pack(), bus.now_ns)
    assert not bus.has_deadline()


def test_a_late_reply_does_not_tell_what_became_of_another_request(bus: Bus) -> None:
    """Of another index, or of the other direction of the same one."""
    late, one = bus.request(0x13, 600), bus.request(0x15, 0x1000)
    bus.send(late.frame())
    bus.send(one.frame(), reply(late, codec.REFUSED))
    assert bus.has_deadline()
    bus.say(0x18)
    answer = bus.request(0x22)  # 2002h, as the download 02h
    bus.send(bus.request(0x02).frame(), reply(answer, 0x42, bytes(4)))
    assert bus.travel_guard._last is not None, "the reply is still to come"


def test_a_garbled_reply_leaves_it_open_what_was_done(bus: Bus) -> None:
    """60h with something behind it is not an acceptance, nor is a frame of five bytes."""
    one = bus.request(0x15, 0x1000)
    bus.send(one.frame(), reply(one, codec.ACCEPTED, b"\0\0\0\1"), Frame(0x581, bytes(5)))
    assert bus.has_deadline()
    assert bus.travel_guard._last is not None


def test_while_nobody_knows_the_order_of_bytes_both_count() -> None:
    """And no counter is read: it would be another one."""
    bus = Bus(**{switch: one for switch, one in KNOWN.items() if switch != "can_byte_order"})
    bus.at(0)
    assert bus.travel_guard.axes == {}
    bus.readings["can_byte_order"] = "big"
    bus.at(0)
    assert not bus.refuses(0x13, 500)
    del bus.readings["can_byte_order"]
    assert bus.refuses(0x13, 500), "F4010000h, read from the other end"
    assert not bus.refuses(0x13, 0)


def test_a_device_of_the_other_order_is_kept_inside_too() -> None:
    """What is sent to it is read as it reads it."""
    bus = Bus(**{**KNOWN, "can_byte_order": "little"})
    bus.at(500)
    bus.say(0x0D, 0x1000)
    assert not bus.refuses(0x13, 2500)
    assert bus.refuses(0x13, 2501)
    assert bus.refuses(0x16, 0x0001_031F)
    assert not bus.refuses(0x16, 0x0001_0320)
    bus.say(0x15, F6 | 0x1000)
    assert bus.travel_guard.axes[OWN].directions == (-1, 0)


def test_the_fence_stops_each_axis_by_itself(bus: Bus) -> None:
    """With 2018h to those that move without an end."""
    bus.at(0, address=OTHER)
    bus.say(0x15, 0x1000, address=OTHER)
    assert bus.travel_guard.stop() == (codec.request(OTHER, 0x18).frame().pack(),)
