"""What a transcript shows beside the bytes: what was done by hand, and what devices tell."""

import re
from typing import Any

import can
import pytest
import serial
from mac_frames import request

from axistwin import testing
from axistwin.errors import UsageError
from axistwin.macroprogram import Macroprogram


def ask(port: Any, *words: int, size: int = 3) -> bytes:
    """A request and its reply."""
    port.write(request(*words))
    reply: bytes = port.read(size)
    return reply


def opened(twin: testing.StartedLine, **settings: Any) -> Any:
    """A client of ``twin``."""
    return serial.serial_for_url(twin.port, **{"baudrate": 38400, "timeout": 0.1, **settings})


def told(twin: testing.StartedLine) -> list[str]:
    """The transcript without times and bytes."""
    rows = re.sub(r"^ *[\d.]+ ms ", "", twin.transcript, flags=re.MULTILINE)
    return re.sub(r"(?<=[<>]) [0-9A-F ]+  ", " ", rows, flags=re.MULTILINE).splitlines()


def test_what_a_test_does_stands_between_the_exchanges() -> None:
    """In the order in which it was done."""
    with testing.start("mac23", time="virtual") as twin:
        port = opened(twin)
        ask(port, 0x20, size=21)
        twin.inputs.reference = True
        twin.supply_volts = 30
        twin.push(5)
        twin.advance(2)
        ask(port, 0x20, size=21)
        port.advance(0.5)
        assert told(twin) == [
            "> 20h position? -> module 0",
            "< 20h position = 0 (module 0)",
            "* test: mac23:0: inputs.reference = True",
            "* test: mac23:0: supply_volts = 30.0",
            "* test: mac23:0: push = 5",
            "* test: advance(2)",
            "> 20h position? -> module 0",
            "< 20h position = 5 (module 0)",
            "* test: advance(0.5)",
        ]


def test_a_twin_that_is_silent_says_why() -> None:
    """It starts, it is off, or somebody else is meant."""
    with testing.start("mac23:3", time="virtual") as twin:
        port = opened(twin)
        twin.power_cycle()
        ask(port, 0x20, 0, 3)
        twin.advance(2)
        ask(port, 0x20, 0, 5)
        twin.power_off()
        ask(port, 0x20, 0, 3)
        rows = told(twin)
    assert rows[:5] == [
        "* test: mac23:3: power off",
        "* mac23:3: switched off",
        "* test: mac23:3: power on",
        "* mac23:3: starting up, deaf",
        "> 20h position? -> module 3",
    ]
    assert rows[-5:] == [
        "> 20h position? -> module 5",
        "* nobody has address 5: mac23:3 has 3",
        "* test: mac23:3: power off",
        "* mac23:3: switched off",
        "> 20h position? -> module 3",
    ]


def test_a_unit_that_is_not_there_is_named() -> None:
    """Of a controller."""
    with testing.start("msc-250:2", "msc-250:3", time="virtual") as line:
        port = opened(line, baudrate=9600)
        port.write(bytes.fromhex("02 01 00 08 00 00 53 46 4C 41 47 2C 00 C8 02 6A"))
        assert port.read(1) == b""
        assert told(line)[-1] == "* nobody has address 1: msc-250:2 has 2, msc-250:3 has 3"


def test_a_refusal_says_why() -> None:
    """For the state, or for the value."""
    with testing.start("mac23", time="virtual") as twin:
        port = opened(twin)
        ask(port, 0x13, 1000)
        ask(port, 0x13, -500)
        twin.advance(5)
        ask(port, 0x1B, 9)
        ask(port, 0x13, 0x7FFFFFFF)
        rows = [row for row in told(twin) if "refused " in row]
    assert rows == [
        "* mac23:0: refused 13h: moving to a position",
        "* mac23:0: refused 13h: its value is out of range, or the way is barred",
    ]


def test_a_refusal_on_can_says_why() -> None:
    """As on a serial line."""
    with testing.start("mac23-can:1", time="virtual") as twin:
        for value in (1000, -500):
            data = bytes((0x23, 0x13, 0x20, 0)) + value.to_bytes(4, "big", signed=True)
            twin.bus.send(can.Message(arbitration_id=0x601, data=data, is_extended_id=False))
            twin.bus.recv(0.1)
        twin.bus.advance(0.001)
        rows = told(twin)
    assert "* mac23-can:1: refused 13h: moving to a position" in rows
    assert rows[-1] == "* test: advance(0.001)"


def test_polls_are_still_counted_with_the_same_refusal_in_each() -> None:
    """And a poll amid which something happened is not hidden."""
    with testing.start("mac23", time="virtual") as twin:
        port = opened(twin)
        ask(port, 0x13, 10_000)
        for _ in range(20):
            ask(port, 0x13, 0)
        for _ in range(20):
            ask(port, 0x20, size=21)
        twin.inputs.reset = True
        for _ in range(20):
            ask(port, 0x20, size=21)
        rows = told(twin)
    assert sum("more like this one" in row for row in rows) >= 3
    assert sum("refused 13h" in row for row in rows) == 2
    assert "* test: mac23:0: inputs.reset = True" in rows
    assert "* mac23:0: held in reset" in rows


class Broken(Macroprogram):
    """It fails in its first scan."""

    def scan(self) -> None:
        """Fail."""
        raise ValueError("no such table")


def test_a_macroprogram_that_crashed_says_where() -> None:
    """The exchange looks all right without."""
    with testing.start("msc-250", time="virtual", program=Broken) as twin:
        port = opened(twin, baudrate=9600)
        port.write(bytes.fromhex("02 01 00 08 00 00 53 46 4C 41 47 2C 00 C8 02 6A"))
        port.read(1)
        text = twin.transcript
    assert re.search(r"its program has stopped with an error: .*ValueError: no such table", text)


def test_what_can_only_be_read_says_what_to_do_instead() -> None:
    """The position belongs to the shaft."""
    with testing.start("mac23", time="virtual") as twin:
        with pytest.raises(UsageError, match=r"position can only be read; push\(increments\)"):
            twin.position = 5  # type: ignore[misc]
        with pytest.raises(AttributeError, match="can only be read; can be set: supply_volts"):
            twin.state = "HD"  # type: ignore[misc]


def test_a_url_given_to_the_wrong_class_says_which_is_right() -> None:
    """``serial.Serial`` takes it for a file."""
    with pytest.raises(serial.SerialException, match=r"open it with serial\.serial_for_url"):
        serial.Serial("axistwin://mac23", 38400)
