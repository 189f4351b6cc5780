"""Measures the MAC twin's daemon beside a bare asyncio echo, on the same transport, in one run.

The echo sends back what it gets: 21 bytes, as long as a request and as an answer.  The twin runs
without pacing and without its own reply latency (``--no-pacing --quirk reply_latency_us=0``), so
that what is compared is the program, not the emulated line.  Slices of both alternate, so a noisy
machine hits both alike; quote the ratios, not the rates.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import termios
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import serial

import axistwin as _axistwin  # registers the URL scheme

QUERY = b"\x0201400200000000000A2\x03"  # 20h (position) to module 0
ANSWER_BYTES = 21
HOST = "127.0.0.1"

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


@dataclass
class Samples:
    """Round-trip times of one contestant, in seconds, slice by slice."""

    rates: list[float] = field(default_factory=list)
    trips: list[float] = field(default_factory=list)

    def row(self) -> str:
        """Rate and latencies as one line."""
        ordered = sorted(self.trips)
        p50, p99 = (ordered[int(len(ordered) * share)] * 1e6 for share in (0.50, 0.99))
        return f"{statistics.median(self.rates):9.0f}/s   p50 {p50:6.1f} µs   p99 {p99:6.1f} µs"


Exchange = Callable[[], None]


def run_slice(exchange: Exchange, seconds: float, samples: Samples) -> None:
    """Exchange as fast as possible for ``seconds``."""
    trips: list[float] = []
    clock = time.perf_counter
    begin = before = clock()
    end = begin + seconds
    while before < end:
        exchange()
        after = clock()
        trips.append(after - before)
        before = after
    samples.rates.append(len(trips) / (before - begin))
    samples.trips += trips


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


@contextlib.contextmanager
def child(*command: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A server process and the first line it prints."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline()
        finally:
            process.terminate()
            process.wait(10)


def twin_command(*endpoint: str) -> list[str]:
    """The daemon under test on ``endpoint``."""
    options = ["--no-pacing", "--quirk", "reply_latency_us=0", "--json"]
    return [sys.executable, "-m", "axistwin", "run", "mac23:0", *endpoint, *options]


def ready_url(line: str) -> str:
    """The client's address in a ready line."""
    event = json.loads(line)
    assert event["event"] == "ready", line
    return str(event["url"])


def compare(
    title: str, echo: str, endpoint: list[str], client: Callable[[str], object], seconds: float
) -> None:
    """Alternate slices of echo and twin on one transport and print both and the ratio."""
    results = {"bare asyncio echo": Samples(), "mac23 twin": Samples()}
    with (
        child(sys.executable, "-c", echo) as (_, echo_line),
        child(*twin_command(*endpoint)) as (twin, twin_line),
    ):
        addresses = [echo_line.strip(), ready_url(twin_line)]
        with contextlib.ExitStack() as stack:
            exchanges: list[Exchange] = [
                stack.enter_context(client(address))  # type: ignore[arg-type]
                for address in addresses
            ]
            for exchange in exchanges:  # warm up, not counted
                run_slice(exchange, seconds / 4, Samples())
            for _ in range(5):
                for exchange, samples in zip(exchanges, results.values(), strict=True):
                    run_slice(exchange, seconds, samples)
        print(f"\n{title}")
        for name, samples in results.items():
            print(f"  {name:<20}{samples.row()}")
        bare, ours = (samples.rates for samples in results.values())
        ratios = [own / echo for own, echo in zip(ours, bare, strict=True)]
        spread = f"slices {min(ratios):.2f} to {max(ratios):.2f}"
        print(f"  ratio twin/echo     {statistics.median(ratios):.2f} ({spread})")
        print_idle(twin.pid)


def print_idle(pid: int, seconds: float = 3.0) -> None:
    """CPU time that the daemon uses while nobody talks to it, and its memory."""
    process = psutil.Process(pid)
    before = process.cpu_times()
    time.sleep(seconds)
    after = process.cpu_times()
    used = after.user + after.system - before.user - before.system
    memory = process.memory_info().rss / 2**20
    print(f"  idle CPU            {100 * used / seconds:.2f} %   memory {memory:.1f} MiB")


def compare_in_process(seconds: float) -> None:
    """Exchanges in virtual time in this process, beside pyserial's own loop:// port."""
    results = {"pyserial loop://": Samples(), "axistwin:// virtual": Samples()}
    ports = [
        serial.serial_for_url("loop://", baudrate=4_000_000, timeout=1),
        serial.serial_for_url("axistwin://mac23:0?time=virtual", baudrate=38400, timeout=1),
    ]
    for _ in range(5):
        for port, samples in zip(ports, results.values(), strict=True):

            def exchange(port: serial.SerialBase = port) -> None:
                port.write(QUERY)
                check_answer(port.read(ANSWER_BYTES))

            run_slice(exchange, seconds, samples)
    print("\nin process, virtual time")
    for name, samples in results.items():
        print(f"  {name:<20}{samples.row()}")


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


def main() -> None:
    """Run all comparisons."""
    parser = argparse.ArgumentParser(description=__doc__, prog="scripts/bench")
    parser.add_argument("--seconds", type=float, default=1.0, help="length of a slice (default 1)")
    seconds = parser.parse_args().seconds
    print(
        f"axistwin {_axistwin.__version__}, Python {sys.version.split()[0]}, {os.cpu_count()} cores"
    )
    with tempfile.TemporaryDirectory(prefix="axistwin-bench-") as folder:
        link = str(Path(folder) / "pty")
        compare("pty, no pacing", ECHO_PTY, ["--pty", link], pty_client, seconds)
        compare(
            "TCP, no pacing",
            ECHO_TCP,
            ["--tcp", f"{HOST}:0"],
            lambda url: tcp_client(int(url.rsplit(":", 1)[-1])),
            seconds,
        )
        compare_in_process(seconds)
        compare_start(folder)


if __name__ == "__main__":
    main()
