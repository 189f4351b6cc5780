"""What a program and Linux' /dev/uhid tell one another: events as bytes (linux/uhid.h).

Every event is a number of 32 bits and what belongs to it, packed, in the machine's byte order.  The
kernel takes a shorter event than there could be: what is missing are nulls.

A HID device without numbered reports has report number 0, which stands before the report where a
program writes one to /dev/hidraw*, and in ``OUTPUT``; on the wire, and in ``INPUT2``, it does not.
"""

import struct
from enum import IntEnum
from typing import Final, NamedTuple

from axistwin.devices.family import UsbIdentity

EVENT_BYTES: Final = 4376
"""Of the longest event; reading fewer would lose the end of one."""

_NAMES = struct.Struct("=I128s64s64s")
_FACTS = struct.Struct("=HHIIII")
_BUS_USB: Final = 3
RELEASE_NUMBER: Final = 0x0100
"""Of the device, in its descriptor; no real one is known."""

_NUMBER = struct.Struct("=I")
_INPUT = struct.Struct("=IH")
_OUTPUT = struct.Struct("=4096sHB")
_ASKED = struct.Struct("=IBB")
_SET = struct.Struct("=IBBH4096s")
_GET_REPLY = struct.Struct("=IIHH")
_SET_REPLY = struct.Struct("=IIH")
_NO_SUCH_REPORT: Final = 5  # EIO


class EventType(IntEnum):
    """Which event it is."""

    START = 2
    STOP = 3
    OPEN = 4
    CLOSE = 5
    OUTPUT = 6
    GET_REPORT = 9
    GET_REPORT_REPLY = 10
    CREATE2 = 11
    INPUT2 = 12
    SET_REPORT = 13
    SET_REPORT_REPLY = 14


_KNOWN: Final = frozenset(map(int, EventType))
_TYPE_OUTPUT: Final = 1  # of a report that is set; 0 is a feature report, 2 an input report


class KernelEvent(NamedTuple):
    """An event of the kernel.

    request: the number that a reply has to bear.  report: an OUT report without its number, where
    the event carries one.
    """

    type: EventType
    request: int = 0
    report: bytes | None = None


def descriptor(report_bytes: int) -> bytes:
    """The report descriptor of a device with one report of so many bytes each way: vendor's use."""
    count = bytes((0x95, report_bytes))
    return (
        bytes.fromhex("06 00 FF 09 01 A1 01 15 00 26 FF 00 75 08 09 01")
        + count
        + bytes.fromhex("81 02 09 01")
        + count
        + bytes.fromhex("91 02 C0")
    )


def create(usb: UsbIdentity, place: str, serial: str) -> bytes:
    """Make the device.  place, serial: tell it from others, at most 63 characters each."""
    names = (usb.product_name, place, serial)
    text = descriptor(usb.report_bytes)
    facts = (_BUS_USB, usb.vendor_id, usb.product_id, RELEASE_NUMBER, 0)
    return (
        _NAMES.pack(EventType.CREATE2, *(name.encode("ascii") for name in names))
        + _FACTS.pack(len(text), *facts)
        + text
    )


def input_report(report: bytes) -> bytes:
    """Give the host an IN report."""
    return _INPUT.pack(EventType.INPUT2, len(report)) + report


def answer(event: KernelEvent) -> bytes | None:
    """What the kernel waits for after ``event``; None: for nothing.

    There are no reports to be asked for: they come by themselves.
    """
    if event.type == EventType.GET_REPORT:
        return _GET_REPLY.pack(EventType.GET_REPORT_REPLY, event.request, _NO_SUCH_REPORT, 0)
    if event.type == EventType.SET_REPORT:
        error = _NO_SUCH_REPORT if event.report is None else 0
        return _SET_REPLY.pack(EventType.SET_REPORT_REPLY, event.request, error)
    return None


def parse(data: bytes) -> KernelEvent | None:
    """The event in ``data``; None for one that nobody here knows."""
    number, body = _NUMBER.unpack_from(data)[0], data[_NUMBER.size :]
    if number not in _KNOWN:
        return None
    kind = EventType(number)
    if kind == EventType.OUTPUT:
        content, size, _ = _OUTPUT.unpack_from(body)
        return KernelEvent(kind, report=unnumbered(content[:size]))
    if kind == EventType.GET_REPORT:
        return KernelEvent(kind, _ASKED.unpack_from(body)[0])
    if kind == EventType.SET_REPORT:
        request, _, report_type, size, content = _SET.unpack_from(body)
        is_output = report_type == _TYPE_OUTPUT
        return KernelEvent(kind, request, unnumbered(content[:size]) if is_output else None)
    return KernelEvent(kind)


def unnumbered(report: bytes) -> bytes:
    """An OUT report as it is on the wire: without the number 0, which a program may leave out."""
    return report[1:] if report[:1] == b"\0" else report
