"""Measures the MAC twins beside a bare echo, on the same transport, in one run.

The echo sends back what it gets: as long as a request and as an answer.  The twin runs without
pacing and without its own reply latency (``--no-pacing --quirk reply_latency_us=0``), so that what
is compared is the program, not the emulated line or bus.  Slices of both alternate, so a noisy
machine hits both alike; quote the ratios, not the rates.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import socket
import statistics
import sys
import tempfile
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

import serial
from scripts import bench_can
from scripts.bench_tools import (
    HOST,
    Exchange,
    alternate,
    child,
    print_idle,
    print_results,
    ready_url,
)

import axistwin as _axistwin  # registers the URL scheme

QUERY = b"\x0201400200000000000A2\x03"  # 20h (position) to module 0
ANSWER_BYTES = 21

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


def check_answer(answer: bytes) -> None:
    """An answer to the query, or an echo of it; anything else ends the benchmark."""
    if answer != QUERY and not answer.startswith(b"\x06\x13\x02011000"):
        raise SystemExit(f"bench: unexpected answer {answer.hex(' ')}")


@contextlib.contextmanager
def pty_client(path: str) -> Iterator[Exchange]:
    """A blocking client on a pty at 38400."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    settings = termios.tcgetattr(fd)
    settings[4] = settings[5] = termios.B38400
    termios.tcsetattr(fd, termios.TCSANOW, settings)

    def exchange() -> None:
        os.write(fd, QUERY)
        answer = os.read(fd, 64)
        while len(answer) < ANSWER_BYTES:
            answer += os.read(fd, 64)
        check_answer(answer)

    try:
        yield exchange
    finally:
        os.close(fd)


@contextlib.contextmanager
def tcp_client(port: int) -> Iterator[Exchange]:
    """A blocking client on a TCP port of the loopback."""
    with socket.create_connection((HOST, port)) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

        def exchange() -> None:
            connection.sendall(QUERY)
            answer = connection.recv(64)
            while len(answer) < ANSWER_BYTES:
                answer += connection.recv(64)
            check_answer(answer)

        yield exchange


def twin_command(*endpoint: str) -> list[str]:
    """The daemon under test on ``endpoint``."""
    options = ["--no-pacing", "--quirk", "reply_latency_us=0", "--json"]
    return [sys.executable, "-m", "axistwin", "run", "mac23:0", *endpoint, *options]


def compare(
    title: str,
    echo: str,
    endpoint: list[str],
    client: Callable[[str], AbstractContextManager[Exchange]],
    seconds: float,
) -> None:
    """Alternate slices of echo and twin on one transport and print both and the ratio."""
    with (
        child(sys.executable, "-c", echo) as (_, echo_line),
        child(*twin_command(*endpoint)) as (twin, twin_line),
    ):
        with client(echo_line.strip()) as bare, client(ready_url(twin_line)) as ours:
            results = alternate({"bare asyncio echo": bare, "mac23 twin": ours}, seconds)
        print_results(title, results)
        print_idle(twin.pid)


def compare_in_process(seconds: float) -> None:
    """Exchanges in virtual time in this process, beside pyserial's own loop:// port."""

    def exchange(port: serial.SerialBase) -> None:
        port.write(QUERY)
        check_answer(port.read(ANSWER_BYTES))

    bare = serial.serial_for_url("loop://", baudrate=4_000_000, timeout=1)
    ours = serial.serial_for_url("axistwin://mac23:0?time=virtual", baudrate=38400, timeout=1)
    exchanges = {
        "pyserial loop://": partial(exchange, bare),
        "axistwin:// virtual": partial(exchange, ours),
    }
    print_results("in process, virtual time", alternate(exchanges, seconds))


def first_answer(folder: str) -> tuple[float, float]:
    """Seconds from starting the daemon to its ready line and to its first answer."""
    link = str(Path(folder) / "first")
    begin = time.perf_counter()
    with child(*twin_command("--pty", link)) as (_, line):
        ready = time.perf_counter() - begin
        with pty_client(ready_url(line)) as exchange:
            exchange()
            return ready, time.perf_counter() - begin


def bare_start() -> float:
    """Seconds from starting a bare echo to its first line."""
    begin = time.perf_counter()
    with child(sys.executable, "-c", ECHO_PTY):
        return time.perf_counter() - begin


def compare_start(folder: str, runs: int = 7) -> None:
    """Start-up of the daemon beside the echo's, taken in turn."""
    bare: list[float] = []
    ours: list[tuple[float, float]] = []
    for _ in range(runs):
        bare.append(bare_start())
        ours.append(first_answer(folder))
    ready, answer = (statistics.median(column) * 1e3 for column in zip(*ours, strict=True))
    echo = statistics.median(bare) * 1e3
    print("\nstart-up (medians of 7)")
    print(f"  bare asyncio echo   ready {echo:6.0f} ms")
    timing = f"ready {ready:6.0f} ms   first answer {answer:6.0f} ms"
    print(f"  mac23 twin          {timing}   {answer / echo:.2f} x echo")


def compare_serial(folder: str, seconds: float) -> None:
    """All comparisons on a serial line."""
    link = str(Path(folder) / "pty")
    compare("serial: pty, no pacing", ECHO_PTY, ["--pty", link], pty_client, seconds)
    compare(
        "serial: TCP, no pacing",
        ECHO_TCP,
        ["--tcp", f"{HOST}:0"],
        lambda url: tcp_client(int(url.rsplit(":", 1)[-1])),
        seconds,
    )
    compare_in_process(seconds)
    compare_start(folder)


CARRIERS = {"serial": compare_serial, "can": bench_can.compare_can}


def main() -> None:
    """Run the comparisons."""
    parser = argparse.ArgumentParser(description=__doc__, prog="scripts/bench")
    parser.add_argument("carriers", nargs="*", metavar="serial|can", help="which (default: all)")
    parser.add_argument("--seconds", type=float, default=1.0, help="length of a slice (default 1)")
    options = parser.parse_args()
    for name in options.carriers:
        if name not in CARRIERS:
            parser.error(f"{name!r} is no carrier; known: {', '.join(CARRIERS)}")
    print(
        f"axistwin {_axistwin.__version__}, Python {sys.version.split()[0]}, {os.cpu_count()} cores"
    )
    with tempfile.TemporaryDirectory(prefix="axistwin-bench-") as folder:
        for name in options.carriers or CARRIERS:
            CARRIERS[name](folder, options.seconds)


if __name__ == "__main__":
    main()
