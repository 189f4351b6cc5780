"""What a host at any port hears of faults on the wire, whatever time its bytes or frames take."""

from collections.abc import Callable
from typing import Any

import can
import serial
from served import eventually
from served_bus import POSITION, TIMEOUT_S, receive

from axistwin.kernel.time import NS_PER_MS
from axistwin.runtime.bus import Bus
from axistwin.runtime.line import Line
from axistwin.wire.can_frame import CanFrame

QUERY = b"\x0201400200000000000A2\x03"
ANSWER = bytes.fromhex("06 13 02 30 31 31 30 30 30 30 30 30 30 30 30 30 30 31 30 03 1A")
SILENCE_NS = 300 * NS_PER_MS
"""Longer than an answer takes, with what any fault adds to it."""

BAD_QUERY, NAK = QUERY[:-3] + b"A3\x03", b"\x15"


def check_line(line: Line, port: serial.SerialBase) -> None:
    """Every kind of fault that a serial line has."""
    port.timeout = TIMEOUT_S
    changed: dict[str, Callable[[bytes], bool]] = {
        "corrupt": lambda heard: _bits(heard, ANSWER) == 1,
        "duplicate": lambda heard: heard == 2 * ANSWER,
        "delay": lambda heard: heard == ANSWER,
        "jitter": lambda heard: heard == ANSWER,
        "break": lambda heard: heard == b"\0" + ANSWER,
    }
    assert _asked(line, port) == ANSWER
    for kind, is_right in changed.items():
        with _Fault(line, kind, direction="to_host", hex="30 31 31"):
            heard = _asked(line, port)
            assert is_right(heard), (kind, heard)
    for kind in ("drop", "disconnect", "busy"):
        with _Fault(line, kind, direction="to_host", count=1):
            heard = _asked(line, port)
            assert ANSWER not in heard, kind
        assert _asked(line, port) == ANSWER, kind
    number = line.faults.add("noise", direction="to_host", per_s=200)
    assert len(port.read(5)) == 5
    line.faults.remove(number)


def _asked(line: Line, port: serial.SerialBase) -> bytes:
    """All that comes behind a query and is no answer to the next message, a bad one."""
    before = _host_bytes(line)
    port.write(QUERY)
    assert eventually(lambda: _host_bytes(line) == before + len(QUERY))
    heard_ns = line.sync()
    assert eventually(lambda: line.sync() > heard_ns + SILENCE_NS and _is_quiet(line))
    port.write(BAD_QUERY)
    heard = b""
    while not heard.endswith(NAK):
        data = port.read(1)
        assert data, heard
        heard += data
    return heard.removesuffix(NAK)


def _host_bytes(line: Line) -> int:
    """How many bytes the line has heard from the host."""
    said = [each.content for each in line.messages if each.direction == "host"]
    return sum(len(data) for data in said if isinstance(data, bytes))


def check_bus(bus: Bus, host: can.BusABC) -> None:
    """Every kind of fault that a bus has."""

    def ask() -> can.Message:
        host.send(POSITION)
        return receive(host, 0x581)

    right = bytes(ask().data)
    assert right == bytes.fromhex("4200200000000000")
    with _Fault(bus, "corrupt", direction="to_host", hex="581#"):
        host.send(POSITION)
        frame = host.recv(TIMEOUT_S)
        assert frame is not None
        heard = frame.arbitration_id.to_bytes(4, "big") + frame.data
        assert _bits(heard, (0x581).to_bytes(4, "big") + right) == 1
    with _Fault(bus, "duplicate", direction="to_host", hex="581#"):
        assert bytes(ask().data) == bytes(receive(host, 0x581).data) == right
    for kind in ("delay", "jitter", "error_frame"):
        with _Fault(bus, kind, direction="to_host", hex="581#"):
            assert bytes(ask().data) == right, kind
    with _Fault(bus, "drop", direction="to_host", hex="581#") as has_acted:
        host.send(POSITION)
        assert eventually(has_acted)
        assert bytes(ask().data) == right
    with _Fault(bus, "disconnect", direction="to_host", hex="581#") as has_acted:
        host.send(POSITION)
        assert eventually(has_acted)
        ended_ns = bus.sync() + 100 * NS_PER_MS
        assert eventually(lambda: bus.sync() > ended_ns)
        assert bytes(ask().data) == right
    with _Fault(bus, "busy", duration_ms=50.0):
        assert bytes(ask().data) == right
    port = bus.attach()
    bus.send(port, CanFrame(0x123, b""))  # behind all that was to come
    assert receive_any(host) == 0x123
    bus.detach(port)


def receive_any(host: can.BusABC) -> int:
    """The identifier of the next frame."""
    message = host.recv(TIMEOUT_S)
    assert message is not None
    return message.arbitration_id


class _Fault:
    """A fault within ``with``, which has acted once at the end."""

    def __init__(self, simulation: Any, kind: Any, **selection: Any) -> None:
        self._faults = simulation.faults
        self._number = self._faults.add(kind, **selection)

    def __enter__(self) -> Callable[[], bool]:
        return lambda: bool(self._faults[self._number].acted)

    def __exit__(self, *error: object) -> None:
        report = self._faults.remove(self._number)
        assert error[0] or report.acted == 1, report


def _is_quiet(line: Line) -> bool:
    return line.next_event_ns() is None


def _bits(heard: bytes, right: bytes) -> int:
    """How many bits differ."""
    return sum((a ^ b).bit_count() for a, b in zip(heard, right, strict=True))
