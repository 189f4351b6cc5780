"""What the benchmarks of twins on a serial line share: a dialogue, and a bare echo to hold it with.

The echo sends back what it gets.  It is sent as many bytes as the device answers, and behind them
what the host sends when it has the answer; the echo of that comes with the next answer.  So both
contestants write as often, and read as much.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import termios
import tty
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import serial
from scripts.bench_tools import (
    HOST,
    Exchange,
    alternate,
    child,
    print_idle,
    print_results,
    ready_url,
)

import axistwin as _axistwin  # noqa: F401 - registers the URL scheme

ECHO_PTY = """
import asyncio, os, pty, sys, tty
async def main():
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    asyncio.get_running_loop().add_reader(master, lambda: os.write(master, os.read(master, 4096)))
    print(os.ttyname(slave), flush=True)
    await asyncio.Event().wait()
asyncio.run(main())
"""
ECHO_TCP = """
import asyncio, socket
class Echo(asyncio.Protocol):
    def connection_made(self, transport):
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.transport = transport
    def data_received(self, data):
        self.transport.write(data)
async def main():
    server = await asyncio.get_running_loop().create_server(Echo, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await asyncio.Event().wait()
asyncio.run(main())
"""
BUFFER_BYTES = 256
LOOP_SPEED = 4_000_000


@dataclass(frozen=True, slots=True)
class Dialogue:
    """What is said again and again: a request, its whole answer, and what closes the exchange.

    `opening`: said once, before the first request; nothing answers it by itself.
    """

    request: bytes
    answer: bytes
    closing: bytes = b""
    opening: bytes = b""

    @property
    def echoed(self) -> Dialogue:
        """As much of everything, for an echo."""
        sent = self.answer[len(self.closing) :]
        return Dialogue(sent, self.closing + sent, self.closing, opening=self.closing)

    def check(self, answer: bytes) -> None:
        """Anything but the answer ends the benchmark."""
        if answer != self.answer:
            raise SystemExit(f"bench: {self.request.hex(' ')} has brought {answer.hex(' ')}")


@dataclass(frozen=True, slots=True)
class Twin:
    """The device under test as ``axistwin run`` is told of it, and the rate it is spoken to at."""

    device: str
    quirks: tuple[str, ...]
    speed: int

    @property
    def name(self) -> str:
        """Which contestant it is."""
        return f"{self.device.partition(':')[0]} twin"

    def command(self, *endpoint: str) -> list[str]:
        """The daemon on ``endpoint``, without pacing and latencies of its own."""
        quirks = [word for quirk in self.quirks for word in ("--quirk", quirk)]
        options = ["--no-pacing", *quirks, "--json"]
        return [sys.executable, "-m", "axistwin", "run", self.device, *endpoint, *options]


Client = Callable[[str, Dialogue, int], AbstractContextManager[Exchange]]


@contextlib.contextmanager
def pty_client(path: str, dialogue: Dialogue, speed: int) -> Iterator[Exchange]:
    """A blocking client on a pty at that rate."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    settings = termios.tcgetattr(fd)
    settings[4] = settings[5] = getattr(termios, f"B{speed}")
    termios.tcsetattr(fd, termios.TCSANOW, settings)
    request, size, closing = dialogue.request, len(dialogue.answer), dialogue.closing

    def exchange() -> None:
        os.write(fd, request)
        answer = os.read(fd, BUFFER_BYTES)
        while len(answer) < size:
            answer += os.read(fd, BUFFER_BYTES)
        dialogue.check(answer)
        if closing:
            os.write(fd, closing)

    try:
        if dialogue.opening:
            os.write(fd, dialogue.opening)
        yield exchange
    finally:
        os.close(fd)


@contextlib.contextmanager
def tcp_client(port: str, dialogue: Dialogue, speed: int) -> Iterator[Exchange]:
    """A blocking client on a TCP port of the loopback, which knows no rate."""
    request, size, closing = dialogue.request, len(dialogue.answer), dialogue.closing
    with socket.create_connection((HOST, int(port.rsplit(":", 1)[-1]))) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

        def exchange() -> None:
            connection.sendall(request)
            answer = connection.recv(BUFFER_BYTES)
            while len(answer) < size:
                answer += connection.recv(BUFFER_BYTES)
            dialogue.check(answer)
            if closing:
                connection.sendall(closing)

        connection.sendall(dialogue.opening)
        yield exchange


@contextlib.contextmanager
def url_client(url: str, dialogue: Dialogue, speed: int) -> Iterator[Exchange]:
    """A pyserial program in this process."""
    size, closing = len(dialogue.answer), dialogue.closing
    with serial.serial_for_url(url, baudrate=speed, timeout=1) as port:

        def exchange() -> None:
            port.write(dialogue.request)
            dialogue.check(port.read(size))
            if closing:
                port.write(closing)

        port.write(dialogue.opening)
        yield exchange


@dataclass(frozen=True, slots=True)
class Transport:
    """A way to a daemon: its option, the echo that is reached the same way, and the client."""

    name: str
    endpoint: tuple[str, str]
    echo: str
    client: Client


def transports(folder: str) -> tuple[Transport, ...]:
    """All ways to a daemon on a serial line that are measured."""
    return (
        Transport("pty, no pacing", ("--pty", str(Path(folder) / "pty")), ECHO_PTY, pty_client),
        Transport("TCP, no pacing", ("--tcp", f"{HOST}:0"), ECHO_TCP, tcp_client),
    )


def compare(
    title: str, way: Transport, twin: Twin, dialogues: Mapping[str, Dialogue], seconds: float
) -> None:
    """Alternate slices of echo and twin on one transport and print both and the ratio."""
    echo, client = way.echo, way.client
    with child(*twin.command(*way.endpoint)) as (daemon, twin_line):
        for name, dialogue in dialogues.items():
            with (
                child(sys.executable, "-c", echo) as (_, echo_line),
                client(echo_line.strip(), dialogue.echoed, twin.speed) as bare,
                client(ready_url(twin_line), dialogue, twin.speed) as ours,
            ):
                results = alternate({"bare asyncio echo": bare, twin.name: ours}, seconds)
            print_results(f"{title}: {way.name}, {name}", results)
        print_idle(daemon.pid)


def compare_in_process(
    title: str, url: str, twin: Twin, dialogues: Mapping[str, Dialogue], seconds: float
) -> None:
    """Exchanges in virtual time in this process, beside pyserial's own loop:// port."""
    for name, dialogue in dialogues.items():
        with (
            url_client("loop://", dialogue.echoed, LOOP_SPEED) as bare,
            url_client(url, dialogue, twin.speed) as ours,
        ):
            exchanges = {"pyserial loop://": bare, "axistwin:// virtual": ours}
            results = alternate(exchanges, seconds)
        print_results(f"{title}: in process, virtual time, {name}", results)
