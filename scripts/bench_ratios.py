"""What an exchange out of the ordinary costs beside an ordinary one, which is 1.

In this process, in virtual time, by the CPU time of the process: what else runs on the machine
counts little.  All take turns; of each the best of several turns counts.  Only what users have is
used, so that an older commit can be measured by this file too (``PYTHONPATH``).
"""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from typing import Any

import serial
from scripts import bench_mn400
from scripts.bench_msc import ACK, DIALOGUES, MODEL
from scripts.bench_tools import SLICES, Exchange

import axistwin as _axistwin  # noqa: F401 - registers the URL scheme

ANSWER_BYTES = 21
BAUD = 38400
PATIENCE_S = 0.03
QUICK_QUIRKS = "quirk.response_delay_ms=0&quirk.reply_delay_ms=0"
GARBAGE = random.Random(14).randbytes(4096)


def query(address: int = 0) -> bytes:
    """20h (position) to that module."""
    body = b"%02X200000000000" % address
    return b"\x02014" + body + b"%02X\x03" % (sum(body) & 0xFF)


def many(count: int) -> str:
    """So many modules, at addresses of their own."""
    return ",".join(f"mac23:{address}" for address in range(count))


class Contestant:
    """A port of its own, and what is done with it again and again.

    expects: the bytes that come of it; None: whatever comes.
    """

    def __init__(self, name: str, devices: str, **settings: Any) -> None:
        self.name = name
        self.data = settings.pop("data", query())
        self.size = settings.pop("size", ANSWER_BYTES)
        self.expects: int | None = settings.pop("expects", ANSWER_BYTES)
        self.frames: float = settings.pop("frames", 1)
        self.closing: bytes = settings.pop("closing", b"")
        self.writes: bool = settings.pop("writes", False)
        mark = "&" if "?" in devices else "?"
        options = {"baudrate": BAUD, "timeout": PATIENCE_S} | settings
        self.port: Any = serial.serial_for_url(f"axistwin://{devices}{mark}time=virtual", **options)
        self.best_s = float("inf")

    def exchange(self) -> None:
        """Once."""
        port = self.port
        if self.writes:
            port.write(self.data)
            answer = port.read(self.size)
        else:
            answer = port.exchange(self.data, self.size, port.timeout)[1]
        if self.expects is not None and len(answer) != self.expects:
            raise SystemExit(f"bench: {self.name}: {answer.hex(' ')}")
        if self.closing:
            port.write(self.closing)

    def take_turn(self, seconds: float) -> None:
        """Exchange for so long, and note what one exchange costs."""
        exchange: Exchange = self.exchange
        count, batch = 0, 1
        begin = time.process_time()
        while (used := time.process_time() - begin) < seconds:
            for _ in range(batch):
                exchange()
            count += batch
            batch = min(64, 2 * batch)
        self.best_s = min(self.best_s, used / count / self.frames)


def garbage(where: str, baud: int) -> Contestant:
    """Bytes that mean nothing, from a host at that rate."""
    size = 1024
    name = f"garbage at {where}, {ANSWER_BYTES} bytes of it"
    frames = size / ANSWER_BYTES
    data = GARBAGE[:size]
    return Contestant(name, "mac23:0", baudrate=baud, data=data, expects=None, frames=frames)


def mac_contestants() -> list[Contestant]:
    """One module and what is out of the ordinary on its line."""
    return [
        Contestant("one module, 20h", "mac23:0"),
        Contestant("the host sends two stop bits", "mac23:0", stopbits=2),
        Contestant("the host at half the rate", "mac23:0", baudrate=19200, expects=0),
        Contestant("the host at 9600", "mac23:0", baudrate=9600, expects=0),
        Contestant("the host at 115200", "mac23:0", baudrate=115200, expects=0),
        garbage("19200", 19200),
        garbage("115200", 115200),
        garbage("the right rate", BAUD),
        Contestant(
            "a module at 9600, the host at 115200",
            "mac23:0?baud=9600",
            baudrate=115200,
            expects=0,
        ),
        Contestant("two modules at one address", "mac23:0,mac23:0", expects=None),
        Contestant("nobody there, 127 modules", many(127), data=query(127), expects=0),
        *(
            Contestant(f"one of {count} modules", many(count), data=query(count // 2))
            for count in (2, 16, 50, 127)
        ),
        Contestant("one of 127 modules, write and read", many(127), data=query(3), writes=True),
        Contestant("write and read", "mac23:0", writes=True),
    ]


def quick_mac() -> Contestant:
    """What other families are compared with."""
    return Contestant("MAC, 20h", "mac23:0?quirk.reply_latency_us=0")


def mn400_contestants() -> list[Contestant]:
    """The dialogues of the board."""
    group = [quick_mac()]
    for name, dialogue in bench_mn400.DIALOGUES.items():
        group.append(
            Contestant(
                f"MN400, {name}",
                f"{bench_mn400.MODEL}?quirk.response_delay_ms=0",
                baudrate=9600,
                data=dialogue.request,
                size=len(dialogue.answer),
                expects=len(dialogue.answer),
            )
        )
    return group


def msc_contestants() -> list[Contestant]:
    """The dialogues of one controller, and of one of two on a line."""
    group = [quick_mac()]
    for name, dialogue in DIALOGUES.items():
        for kind, device in (("alone", MODEL), ("of two", f"{MODEL},msc-250:2")):
            group.append(
                Contestant(
                    f"MSC {kind}, {name}, ACK, reply, ACK",
                    f"{device}?{QUICK_QUIRKS}",
                    baudrate=9600,
                    timeout=1,
                    data=dialogue.request,
                    size=len(dialogue.answer),
                    expects=len(dialogue.answer),
                    closing=ACK,
                )
            )
    return group


def contestants() -> Iterator[tuple[str, list[Contestant]]]:
    """Groups by what they are compared with: the first of a group is 1."""
    yield "an exchange", mac_contestants()
    yield "MN400", mn400_contestants()
    yield "MSC", msc_contestants()


def compare_ratios(_folder: str, seconds: float) -> None:
    """All of them, in turn."""
    for title, group in contestants():
        for _ in range(SLICES + 1):
            for each in group:
                each.take_turn(seconds / 10)
        print(f"\nratios: {title}, in process, virtual time, CPU time")
        normal = group[0]
        for each in group:
            ratio = each.best_s / normal.best_s
            print(f"  {each.name:<44}{each.best_s * 1e6:9.1f} µs {ratio:8.2f}")
