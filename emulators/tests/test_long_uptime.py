"""Twins that run for longer than anybody lives: fast or virtual time gets there within hours."""

import signal
from collections.abc import Iterator
from types import FrameType

import pytest
import serial
from mac_frames import request
from msc_bench import ACK, STATUS, rqstat

from axistwin import testing

CENTURIES_S = 1e10
"""What passes at a speed of a million in less than three hours."""


def give_up(_: int, __: FrameType | None) -> None:
    """Something computes for ever."""
    raise TimeoutError("time stands still")


@pytest.fixture(autouse=True)
def patience() -> Iterator[None]:
    """Ten seconds for each test."""
    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(10)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize(
    ("model", "baudrate", "asked", "answer"),
    [
        ("mac23", 38400, request(0x10), b"\x06\x13\x1a"),
        ("msc-250", 9600, rqstat(), ACK + STATUS),
    ],
)
def test_a_twin_answers_after_three_centuries(
    model: str, baudrate: int, asked: bytes, answer: bytes
) -> None:
    """The time that never comes lies behind them all."""
    with testing.start(model, time="virtual") as twin:
        port = serial.serial_for_url(twin.port, baudrate=baudrate, timeout=1)
        twin.advance(CENTURIES_S)
        port.write(asked)
        assert port.read(len(answer)) == answer
        port.close()


def test_an_axis_turns_for_three_centuries() -> None:
    """The count wraps as often as it must (MACS-AMB-54)."""
    with testing.start("mac23", time="virtual", quirks={"factory_ramp": 0}) as twin:
        port = serial.serial_for_url(twin.port, baudrate=38400, timeout=1)
        port.write(request(0x15, 800))
        assert port.read(3) == b"\x06\x13\x1a"
        before, twin_position = twin.virtual_time_ns, twin.position
        twin.advance(CENTURIES_S)
        assert twin.virtual_time_ns - before == CENTURIES_S * 1e9
        turned = round(CENTURIES_S * 10_000)
        assert twin.position == (twin_position + turned + (1 << 30)) % (1 << 31) - (1 << 30)
        assert twin.is_moving
        port.close()


def test_a_module_on_can_answers_after_three_centuries() -> None:
    """Nothing is said meanwhile by one that sends no lifebeats (MACC-AMB-05)."""
    import can

    quirks = {"emcy_payload": "none"}
    with testing.start("mac23-can", time="virtual", quirks=quirks) as twin:
        bus = twin.bus
        bus.advance(CENTURIES_S)
        bus.send(
            can.Message(arbitration_id=0x601, data=b"\x40\0\x20\0\0\0\0\0", is_extended_id=False)
        )
        message = bus.recv(1)
        assert message is not None
        assert bytes(message.data) == b"\x42\0\x20\0\0\0\0\0"
