"""The benchmarks of the MAC23 on CAN: an exchange is an SDO request and its reply, two frames.

Beside the twin stands an echo that sends each frame back, 80h below its identifier, as a reply is:

- in process: another bus object on python-can's ``virtual`` interface;
- an slcan adapter on a pty: a bare asyncio program that knows no other command, as answered by
  python-can, and by a client that does nothing but read and write;
- SocketCAN, where there is a vcan0 (in ``scripts/vm``): a python-can program.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tty
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import can
from scripts.bench_tools import (
    Exchange,
    Samples,
    alternate,
    child,
    print_idle,
    print_results,
    ready_url,
)

READ_POSITION = bytes.fromhex("4000200000000000")
REQUEST = can.Message(arbitration_id=0x601, data=READ_POSITION, is_extended_id=False)
REPLY_ID = 0x581
REPLIES = (READ_POSITION, b"\x42" + READ_POSITION[1:])  # of the echo, of the module
INTERFACE = "vcan0"
MANY = 127

ECHO_SLCAN = """
import asyncio, os, pty, tty
rest = b""
def answer():
    global rest
    *lines, rest = (rest + os.read(master, 4096)).split(b"\\r")
    for line in lines:
        if line[:1] == b"t":
            reply = b"z\\rt%03X" % (int(line[1:4], 16) - 0x80) + line[4:] + b"\\r"
        else:
            reply = b"\\r"
        os.write(master, reply)
async def main():
    global master
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    asyncio.get_running_loop().add_reader(master, answer)
    print(os.ttyname(slave), flush=True)
    await asyncio.Event().wait()
asyncio.run(main())
"""
ECHO_SOCKETCAN = """
import can
with can.Bus(interface="socketcan", channel="vcan0", ignore_config=True) as bus:
    bus.set_filters([{"can_id": 0x602, "can_mask": 0x7FF, "extended": False}])
    print("ready", flush=True)
    for message in bus:
        message.arbitration_id -= 0x80
        bus.send(message)
"""


def check_reply(identifier: int, data: bytes) -> None:
    """The position of a module that stands at 0, or an echo; anything else ends the benchmark."""
    if (identifier & ~3) != (REPLY_ID & ~3) or data not in REPLIES:
        raise SystemExit(f"bench: unexpected frame {identifier:03X}#{data.hex()}")


def exchange_by(bus: can.BusABC, request: can.Message = REQUEST) -> None:
    """One exchange through python-can."""
    bus.send(request)
    reply = bus.recv(1)
    if reply is None:
        raise SystemExit("bench: no reply within a second")
    check_reply(reply.arbitration_id, bytes(reply.data))


def twin_command(*arguments: str, count: int = 1) -> list[str]:
    """The daemon under test, with ``count`` modules."""
    modules = [f"mac23-can:{address}" for address in range(1, count + 1)]
    options = ["--no-pacing", "--quirk", "reply_latency_us=0", "--json"]
    return [sys.executable, "-m", "axistwin", "run", *modules, *arguments, *options]


def print_frames(results: dict[str, Samples]) -> None:
    """How many frames the last contestant had on the bus per second, at best."""
    name, samples = list(results.items())[-1]
    print(f"  {name}: {2 * max(samples.rates):.0f} frames/s")


def compare_in_process(seconds: float) -> None:
    """Virtual time, this process, beside two buses of python-can's virtual interface."""
    with (
        can.Bus(interface="virtual", channel="bench", ignore_config=True) as client,
        can.Bus(interface="virtual", channel="bench", ignore_config=True) as echo,
        can.Bus(
            interface="axistwin", channel="mac23-can:1", time="virtual", ignore_config=True
        ) as ours,
    ):

        def bare() -> None:
            client.send(REQUEST)
            request = echo.recv(1)
            assert request is not None
            request.arbitration_id = REPLY_ID
            echo.send(request)
            reply = client.recv(1)
            assert reply is not None
            check_reply(reply.arbitration_id, bytes(reply.data))

        exchanges = {"python-can echo": bare, "mac23-can twin": lambda: exchange_by(ours)}
        results = alternate(exchanges, seconds)
    print_results("CAN: in process, virtual time, exact frame times", results)
    print_frames(results)


@contextlib.contextmanager
def python_can_client(path: str) -> Iterator[Exchange]:
    """python-can's slcan interface."""
    with can.Bus(
        interface="slcan", channel=path, bitrate=125_000, sleep_after_open=0, ignore_config=True
    ) as bus:
        yield lambda: exchange_by(bus)


@contextlib.contextmanager
def bare_client(path: str) -> Iterator[Exchange]:
    """A blocking client on the pty, which looks at nothing but the end of the reply."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    request = b"t6018" + READ_POSITION.hex().upper().encode() + b"\r"
    replies = [
        b"z\rt%03X8%s\r" % (REPLY_ID, data.hex().upper().encode("ascii")) for data in REPLIES
    ]

    def exchange() -> None:
        os.write(fd, request)
        reply = os.read(fd, 64)
        while reply.count(b"\r") < 2:
            reply += os.read(fd, 64)
        if reply not in replies:
            raise SystemExit(f"bench: unexpected reply {reply!r}")

    os.write(fd, b"C\rS4\rO\r")
    answers = b""
    while answers.count(b"\r") + answers.count(b"\a") < 3:
        answers += os.read(fd, 64)
    try:
        yield exchange
    finally:
        os.write(fd, b"C\r")
        os.close(fd)


def compare_slcan(
    folder: str,
    name: str,
    client: Callable[[str], AbstractContextManager[Exchange]],
    seconds: float,
) -> None:
    """The daemon's slcan pty beside a bare echo on one."""
    link = str(Path(folder) / "can")
    with (
        child(sys.executable, "-c", ECHO_SLCAN) as (_, echo_line),
        child(*twin_command("--slcan", link)) as (twin, twin_line),
    ):
        with client(echo_line.strip()) as bare, client(ready_url(twin_line)) as ours:
            results = alternate({"bare asyncio echo": bare, "mac23-can twin": ours}, seconds)
        print_results(f"CAN: slcan on a pty, no pacing, {name}", results)
        print_frames(results)
        print_idle(twin.pid)


def compare_socketcan(seconds: float) -> None:
    """The daemon on vcan0 beside a python-can program there, which plays module 2."""
    if not Path("/sys/class/net", INTERFACE).exists():
        print(f"\nCAN: SocketCAN\n  not measured: there is no {INTERFACE}; use scripts/vm")
        return
    request = can.Message(arbitration_id=0x602, data=READ_POSITION, is_extended_id=False)
    with (
        child(sys.executable, "-c", ECHO_SOCKETCAN),
        child(*twin_command("--can", f"socketcan:{INTERFACE}")) as (twin, _),
    ):
        with can.Bus(interface="socketcan", channel=INTERFACE, ignore_config=True) as bus:
            exchanges = {
                "python-can echo": lambda: exchange_by(bus, request),
                "mac23-can twin": lambda: exchange_by(bus),
            }
            results = alternate(exchanges, seconds)
        print_results(f"CAN: SocketCAN on {INTERFACE}", results)
        print_frames(results)
        print_idle(twin.pid)


def print_many(folder: str) -> None:
    """What a full bus costs while nobody talks."""
    link = str(Path(folder) / "many")
    with child(*twin_command("--slcan", link, count=MANY)) as (twin, _):
        print(f"\nCAN: {MANY} modules on one bus, in real time")
        print_idle(twin.pid, seconds=12.0)  # a lifebeat of each is among it


def compare_can(folder: str, seconds: float) -> None:
    """All comparisons on a bus."""
    compare_in_process(seconds)
    compare_slcan(folder, "bare client", bare_client, seconds)
    compare_slcan(folder, "python-can", python_can_client, seconds)
    compare_socketcan(seconds)
    print_many(folder)
