"""Events of /dev/uhid as bytes, against the structures of linux/uhid.h."""

import struct

import pytest

from axistwin.catalog import find_model
from axistwin.devices.family import UsbIdentity
from axistwin.devices.mn400.link.packets import REPORT_BYTES
from axistwin.ports.hid import uhid_events
from axistwin.ports.hid.uhid_events import EventType, KernelEvent

USB = UsbIdentity(0x0461, 0x0020, 64, "MN400")


def output(data: bytes) -> bytes:
    """An OUT report as the kernel tells of it: data, how many bytes, which type."""
    return struct.pack("=I4096sHB", 6, data, len(data), 1).ljust(uhid_events.EVENT_BYTES, b"\0")


def set_report(number: int, report_type: int, data: bytes) -> bytes:
    """A report that a program sets by the control pipe."""
    return struct.pack("=IIBBH4096s", 13, number, 0, report_type, len(data), data)


def test_a_board_is_created_as_the_kernel_reads_it() -> None:
    """Three names, sizes and ids, then the descriptor."""
    data = uhid_events.create(USB, "axistwin/1/0", "mn400:1")
    number, name, place, serial, size, bus, vendor, product, _, country = struct.unpack_from(
        "=I128s64s64sHHIIII", data
    )
    assert (number, bus, vendor, product, country) == (EventType.CREATE2, 3, 0x0461, 0x0020, 0)
    texts = [text.rstrip(b"\0") for text in (name, place, serial)]
    assert texts == [b"MN400", b"axistwin/1/0", b"mn400:1"]
    assert data[280:] == uhid_events.descriptor(64)
    assert size == len(uhid_events.descriptor(64))


def test_the_descriptor_has_one_report_of_64_bytes_each_way() -> None:
    """Eight bits, 64 times, in and out, and an end to what it has begun."""
    items = uhid_events.descriptor(64)
    assert items.count(b"\x75\x08") == 1
    assert items.count(b"\x95\x40") == 2
    assert [items.count(each) for each in (b"\x81\x02", b"\x91\x02")] == [1, 1]
    assert (items[5:7], items[-1:]) == (b"\xa1\x01", b"\xc0")


def test_an_out_report_comes_without_its_number() -> None:
    """The kernel has 0 before it; a program may leave that out."""
    report = b"L1,2,3,4".ljust(64, b"\0")
    assert uhid_events.parse(output(b"\0" + report)) == KernelEvent(EventType.OUTPUT, 0, report)
    assert uhid_events.parse(output(report)) == KernelEvent(EventType.OUTPUT, 0, report)
    assert uhid_events.parse(output(b"\0E")) == KernelEvent(EventType.OUTPUT, 0, b"E")


def test_a_report_can_be_set_and_none_can_be_asked_for() -> None:
    """The kernel waits for an answer to either."""
    event = uhid_events.parse(set_report(7, 1, b"\0E"))
    assert event == KernelEvent(EventType.SET_REPORT, 7, b"E")
    assert uhid_events.answer(event) == struct.pack("=IIH", 14, 7, 0)
    feature = uhid_events.parse(set_report(8, 0, b"\0E"))
    assert feature == KernelEvent(EventType.SET_REPORT, 8, None)
    assert uhid_events.answer(feature) == struct.pack("=IIH", 14, 8, 5)
    asked = uhid_events.parse(struct.pack("=IIBB", 9, 9, 0, 2))
    assert asked == KernelEvent(EventType.GET_REPORT, 9)
    assert uhid_events.answer(asked) == struct.pack("=IIHH", 10, 9, 5, 0)


@pytest.mark.parametrize("kind", [EventType.START, EventType.STOP, EventType.OPEN, EventType.CLOSE])
def test_what_only_tells_needs_no_answer(kind: EventType) -> None:
    """The device was opened, closed, started, stopped."""
    event = uhid_events.parse(struct.pack("=I", kind).ljust(uhid_events.EVENT_BYTES, b"\0"))
    assert event == KernelEvent(kind)
    assert uhid_events.answer(event) is None


@pytest.mark.parametrize("number", [0, 7, 8, 15, 1 << 31])
def test_events_that_nobody_knows_are_passed_over(number: int) -> None:
    """Old ones, and those of a kernel to come."""
    assert uhid_events.parse(struct.pack("=I", number)) is None


def test_an_in_report_is_told_with_its_size() -> None:
    """Without a number."""
    assert uhid_events.input_report(b"E0,0,0,0") == b"\x0c\0\0\0\x08\0E0,0,0,0"


def test_the_mn400_declares_what_its_device_does() -> None:
    """The catalog tells it without loading the device (MN4-USB-01)."""
    usb = find_model("mn400").usb
    assert usb == UsbIdentity(0x0461, 0x0020, REPORT_BYTES, "MN400")
    assert find_model("mac23").usb is None
