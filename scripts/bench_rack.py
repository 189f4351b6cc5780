"""The benchmark of a rack: 300 devices of all models in one process, at every kind of port.

What a rack costs: its start, its CPU time while nobody talks, and the memory of a further device.
Then lines where little is said are asked in turn, in slices that alternate: while nobody else
talks; while clients in a process of their own drive 50 devices of *another* rack as hard as their
lines allow, and flood one with garbage, so that the machine is busy; and while they do so in the
same rack.  The ratio of the last two is what a quiet line pays for its neighbours, on a machine
where the rack does not wait for a core.  Lines have their real rates.  At last every quiet device
is asked under that load.

What workers bring is measured with lines that take no time: one process and two workers serve the
same ones, and a client that keeps all of them busy turns from one to the other.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import random
import selectors
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import can
import psutil
import serial
from scripts import bench_can, bench_mn400, bench_msc
from scripts.bench_line import Dialogue
from scripts.bench_ratios import query
from scripts.bench_tools import HOST, SLICES, Exchange

from axistwin.catalog import models

BLOCKS = 10
PER_BLOCK = 30
DRIVEN_PER_BLOCK = 5
MODULES = 8  # on the RS-485 line of each block
NODES = 10  # on the bus of each block
PATIENCE_S = 60.0
IDLE_S = 5.0
KIB = 1024
GARBAGE = random.Random(17).randbytes(1 << 16)
TCP, RFC2217 = f'tcp = "{HOST}:0"', f'rfc2217 = "{HOST}:0"'
BUSY_LINES = 8
AT_ONCE = 400  # queries, of which only the last one is for somebody: the client has little to do
QUERIES = (AT_ONCE - 1) * query(1) + query(0)
ANSWER_BYTES = 21  # of a MAC
SLICE_FACTOR = 4  # exchanges on real lines are slow


@dataclass(frozen=True, slots=True)
class Seat:
    """A device, and the port it is reached at.  role: ``quiet``, ``driven`` or ``flooded``."""

    model: str
    address: int
    role: str
    url: str

    @property
    def is_on_can(self) -> bool:
        """Whether it has a bus."""
        return self.model.endswith("-can")

    @property
    def rate(self) -> int:
        """Of its line."""
        return 38400 if self.model.startswith("mac") else 9600

    @property
    def dialogue(self) -> Dialogue:
        """What is said to it; of a MAC's answer only the length counts here."""
        if self.model.startswith("msc"):
            return bench_msc.DIALOGUES["RQSTAT"]
        if self.model.startswith("mn400"):
            return bench_mn400.DIALOGUES["poll"]
        return Dialogue(query(self.address), bytes(21))


def ask(seat: Seat, port: Any) -> None:
    """One exchange with a device."""
    if seat.is_on_can:
        ask_node(port, seat.address)
    else:
        ask_line(port, seat.dialogue)


@contextlib.contextmanager
def client(seats: Sequence[Seat]) -> Iterator[Exchange]:
    """A client of one line or bus, which asks these devices there, one after the other."""
    first = seats[0]
    port: Any = bus_at(first.url) if first.is_on_can else line_at(first)

    def exchange() -> None:
        for seat in seats:
            ask(seat, port)

    with port:
        yield exchange


def line_at(seat: Seat) -> serial.SerialBase:
    """Its port."""
    return serial.serial_for_url(seat.url, baudrate=seat.rate, timeout=PATIENCE_S)


def lines(seats: Iterable[Seat]) -> list[list[Seat]]:
    """The devices of each line or bus."""
    by_url: dict[str, list[Seat]] = {}
    for seat in seats:
        by_url.setdefault(seat.url, []).append(seat)
    return list(by_url.values())


def ask_line(port: Any, dialogue: Dialogue) -> None:
    """One exchange on a serial line; none within a minute ends the benchmark."""
    port.write(dialogue.request)
    if len(answer := port.read(len(dialogue.answer))) != len(dialogue.answer):
        raise SystemExit(f"bench: {port.port}: {dialogue.request.hex(' ')} brought {answer!r}")
    port.write(dialogue.closing)


def ask_node(bus: can.BusABC, address: int) -> None:
    """One exchange with a module on a bus, past what others say; likewise."""
    data = bench_can.READ_POSITION
    bus.send(can.Message(arbitration_id=0x600 + address, data=data, is_extended_id=False))
    end_s = time.monotonic() + PATIENCE_S
    while (left_s := end_s - time.monotonic()) > 0:
        reply = bus.recv(left_s)
        if reply is not None and reply.arbitration_id == 0x580 + address:
            return
    raise SystemExit(f"bench: node {address} does not answer")


def bus_at(url: str) -> can.BusABC:
    """A client of an adapter."""
    if url.startswith("can://"):
        place = urlsplit(url)
        return can.Bus(
            "can0", "socketcand", host=place.hostname, port=place.port, ignore_config=True
        )
    return can.Bus(url, "slcan", bitrate=125_000, sleep_after_open=0, ignore_config=True)


# --- the rack ------------------------------------------------------------------------------------


def lines_of(block: int) -> Iterator[tuple[str, list[str], str]]:
    """The lines and buses of a block: the role, the devices, the endpoint; 30 devices in all."""
    ends = (f'pty = "./{block}-{{}}"', TCP, RFC2217)
    single = [model for model in models() if not model.endswith("-can")]
    for number, model in enumerate(single):
        yield "quiet", [model], ends[number % 3].format(model)
    for number in range(DRIVEN_PER_BLOCK - 1):
        yield "driven", ["mac23"], ends[number % 2].format(f"driven-{number}")
    yield "quiet", [f"mac23:{address}" for address in range(MODULES - 1)], ends[0].format("rs485")
    yield "flooded", ["mac34-1"], TCP
    nodes = [f"mac23-can:{address}" for address in range(1, NODES + 1)]
    adapters = (f'slcan = "./{block}-can"', f'slcan-tcp = "{HOST}:0"', f'socketcand = "{HOST}:0"')
    yield "driven" if block % 2 else "quiet", nodes, adapters[block // 2 % 3]


def rack_text(blocks: int) -> tuple[str, list[str]]:
    """The file, and the role of each line."""
    parts, roles = ['state = "memory"\n'], list[str]()
    for block in range(blocks):
        for role, devices, endpoint in lines_of(block):
            kind = "bus" if "-can" in devices[0] else "line"
            name = f"{kind}-{len(roles)}"
            parts.append(
                f'[[{kind}]]\nname = "{name}"\ndevices = {json.dumps(devices)}\n{endpoint}'
            )
            roles.append(role)
    return "\n".join(parts), roles


@dataclass(frozen=True, slots=True)
class RunningRack:
    """A rack that is ready.  start_s: from its start, as the clock goes, and of CPU time."""

    process: psutil.Process
    start_s: tuple[float, float]
    seats: Sequence[Seat]

    @property
    def cpu_s(self) -> float:
        """Its CPU time."""
        times = self.process.cpu_times()
        return float(times.user + times.system)

    @property
    def waited_s(self) -> float:
        """How long it could have run, but other processes had the cores."""
        return waited_s(self.process)

    @property
    def private_kib(self) -> float:
        """Memory that no other process has."""
        return float(self.process.memory_full_info().uss) / KIB


def waited_s(process: psutil.Process) -> float:
    """How long its first thread could have run, but others had the cores."""
    return int(Path(f"/proc/{process.pid}/schedstat").read_text().split()[1]) / 1e9


@contextlib.contextmanager
def rack(folder: Path, blocks: int) -> Iterator[RunningRack]:
    """A rack of so many blocks, until the block of the caller ends."""
    text, roles = rack_text(blocks)
    begin_s = time.perf_counter()
    with started(folder, text, PER_BLOCK * blocks) as (running, events):
        ready_s = time.perf_counter() - begin_s
        times = running.cpu_times()
        seats = []
        for event in events:
            device, _, line = event["device"].partition("@")
            model, _, address = device.partition(":")
            url = str(event["url"])
            url = str(folder / url) if url.startswith("./") else url
            seats.append(Seat(model, int(address), roles[int(line.split("-")[1])], url))
        yield RunningRack(running, (ready_s, times.user + times.system), seats)


@contextlib.contextmanager
def started(
    folder: Path, text: str, devices: int, *options: str
) -> Iterator[tuple[psutil.Process, list[dict[str, Any]]]]:
    """A rack, which is ready, and its events, until the block of the caller ends."""
    folder.mkdir()
    (folder / "rack.toml").write_text(text)
    command = [sys.executable, "-m", "axistwin", "rack", "rack.toml", "--json", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder) as process:
        try:
            assert process.stdout is not None
            events = [json.loads(process.stdout.readline()) for _ in range(devices)]
            yield psutil.Process(process.pid), events
        finally:
            process.terminate()
            process.wait(PATIENCE_S)


# --- the load ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Load:
    """Clients in another process: at work while ``on`` is set; what they have done is counted."""

    on: Event
    exchanges: Synchronized[int]
    flooded_bytes: Synchronized[int]


def drive(driven: Sequence[Seat], flooded: Seat, load: Load) -> None:
    """Have a client on each of their lines, and a flood; ends with the process."""

    def work(exchange: Exchange, devices: int) -> None:
        while load.on.wait():
            exchange()
            with load.exchanges.get_lock():
                load.exchanges.value += devices

    with contextlib.ExitStack() as stack:
        threads = [threading.Thread(target=flood, args=(flooded, load), daemon=True)]
        for each in lines(driven):
            exchange = stack.enter_context(client(each))
            threads.append(threading.Thread(target=work, args=(exchange, len(each)), daemon=True))
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


def flood(seat: Seat, load: Load) -> None:
    """Send garbage as fast as the port takes it, and read what comes of it."""
    place = urlsplit(seat.url)
    with socket.create_connection((place.hostname, place.port)) as connection:
        connection.settimeout(0.05)
        while load.on.wait():
            with contextlib.suppress(TimeoutError):
                load.flooded_bytes.value += connection.send(GARBAGE)
            with contextlib.suppress(TimeoutError):
                connection.recv(1 << 16)


@contextlib.contextmanager
def loaded(seats: Sequence[Seat]) -> Iterator[Load]:
    """The process of the clients of a rack, which waits."""
    spawn = multiprocessing.get_context("spawn")
    load = Load(spawn.Event(), spawn.Value("q", 0), spawn.Value("q", 0))
    hard = driven(seats)
    flooded = next(seat for seat in seats if seat.role == "flooded")
    process = spawn.Process(target=drive, args=(hard, flooded, load), daemon=True)
    process.start()
    try:
        yield load
    finally:
        process.terminate()
        process.join()


def driven(seats: Sequence[Seat]) -> list[Seat]:
    """What is driven hard: on a bus two modules."""
    return [seat for seat in seats if seat.role == "driven" and seat.address <= 2]


# --- what is measured ----------------------------------------------------------------------------


PHASES = ("alone", "other rack loaded", "this rack loaded")


class Quiet:
    """Lines of one kind where little is said, and the round trips there, in ms, by phase."""

    def __init__(self, name: str, seats: Sequence[Seat], stack: contextlib.ExitStack) -> None:
        self.name = name
        self.exchanges = [stack.enter_context(client([seat])) for seat in seats]
        self.trips_ms: dict[str, list[float]] = {phase: [] for phase in PHASES}

    def take_turn(self, end_s: float, phase: str) -> None:
        """Ask on each line in turn."""
        while time.perf_counter() < end_s:
            for exchange in self.exchanges:
                begin_s = time.perf_counter()
                exchange()
                self.trips_ms[phase].append((time.perf_counter() - begin_s) * 1e3)

    def percentile_ms(self, phase: str, share: float) -> float:
        """Of the round trips in a phase."""
        ordered = sorted(self.trips_ms[phase])
        return ordered[int(len(ordered) * share)]

    def row(self) -> str:
        """Round trips in each phase, and the ratio of the p99 of the last two."""
        told = "".join(
            f"{self.percentile_ms(phase, 0.5):9.1f} {self.percentile_ms(phase, 0.99):9.1f}"
            for phase in PHASES
        )
        other, this = (self.percentile_ms(phase, 0.99) for phase in PHASES[1:])
        return f"  {self.name:<18}{told} {this / other:8.2f}"


def quiet_kinds(seats: Sequence[Seat], stack: contextlib.ExitStack) -> list[Quiet]:
    """One line or bus of each kind of each block."""
    chosen: dict[str, Callable[[Seat], bool]] = {
        "mac34-1, own line": lambda seat: seat.model == "mac34-1",
        "mac23 on RS-485": lambda seat: seat.model == "mac23" and seat.address == MODULES // 2,
        "msc-250": lambda seat: seat.model == "msc-250",
        "mn400": lambda seat: seat.model == "mn400",
        "mac23-can": lambda seat: seat.is_on_can and seat.address == NODES // 2,
    }
    quiet = [seat for seat in seats if seat.role == "quiet"]
    return [
        Quiet(name, [seat for seat in quiet if is_one(seat)], stack)
        for name, is_one in chosen.items()
    ]


def compare_quiet(running: RunningRack, other: RunningRack, seconds: float) -> None:
    """Round trips where little is said, in all phases, turn about; then ask every device."""
    with contextlib.ExitStack() as stack:
        kinds = quiet_kinds(running.seats, stack)
        loads = {
            PHASES[1]: stack.enter_context(loaded(other.seats)),
            PHASES[2]: stack.enter_context(loaded(running.seats)),
        }
        loaded_s = used_s = waited_s = 0.0
        for phase in PHASES * (SLICES + 1):
            if load := loads.get(phase):
                load.on.set()
            begin_s, begin_cpu_s = time.perf_counter(), running.cpu_s
            begin_waited_s = running.waited_s
            take_turns(kinds, begin_s + seconds, phase)
            if phase == PHASES[2]:
                loaded_s += time.perf_counter() - begin_s
                used_s += running.cpu_s - begin_cpu_s
                waited_s += running.waited_s - begin_waited_s
            if load:
                load.on.clear()
        load = loads[PHASES[2]]
        print(
            f"  load: {len(driven(running.seats))} devices,"
            f" {load.exchanges.value / loaded_s:.0f} exchanges/s;"
            f" garbage {load.flooded_bytes.value / loaded_s:.0f} bytes/s;"
            f" CPU {100 * used_s / loaded_s:.0f} %,"
            f" waits for a core {100 * waited_s / loaded_s:.0f} %"
        )
        print(f"  ms                {''.join(f'{phase:>19}' for phase in PHASES)} ratio of")
        print(f"                    {'      p50       p99' * len(PHASES)}  the last")
        for kind in kinds:
            print(kind.row())
    with loaded(running.seats) as load:
        load.on.set()
        quiet = [seat for seat in running.seats if seat.role == "quiet"]
        for each in lines(quiet):
            with client(each) as exchange:
                exchange()
        print(f"  {len(quiet)} quiet devices asked under load: all have answered")


def take_turns(kinds: Sequence[Quiet], end_s: float, phase: str) -> None:
    """All kinds at the same time."""
    threads = [threading.Thread(target=each.take_turn, args=(end_s, phase)) for each in kinds]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


class Busy:
    """A rack of so many workers, and a client that keeps all lines of it busy."""

    def __init__(self, folder: Path, workers: int, stack: contextlib.ExitStack) -> None:
        text = "state = 'memory'\n" + "".join(
            f'[[line]]\nname = "line-{number}"\ndevices = "mac23"\n{TCP}\npacing = false\n'
            for number in range(BUSY_LINES)
        )
        options = ("--workers", str(workers))
        front, events = stack.enter_context(started(folder, text, BUSY_LINES, *options))
        self.processes = [front, *front.children()]
        self.rates: list[float] = []
        self.used_s = self.waited_s = 0.0
        self.requests = 0
        self._selector = stack.enter_context(selectors.DefaultSelector())
        for event in events:
            place = urlsplit(event["url"])
            connection = stack.enter_context(
                socket.create_connection((place.hostname, place.port), PATIENCE_S)
            )
            connection.sendall(QUERIES)
            self._selector.register(connection, selectors.EVENT_READ, bytearray())

    @property
    def cpu_s(self) -> float:
        """CPU time of all its processes."""
        used = [each.cpu_times() for each in self.processes]
        return float(sum(times.user + times.system for times in used))

    def take_turn(self, seconds: float) -> None:
        """Give each line more as soon as its device has answered."""
        begin_s, begin_cpu_s, count = time.perf_counter(), self.cpu_s, 0
        begin_waited_s = sum(map(waited_s, self.processes))
        while (now_s := time.perf_counter()) < begin_s + seconds:
            for key, _ in self._selector.select(PATIENCE_S):
                assert isinstance(key.fileobj, socket.socket)
                key.data.extend(key.fileobj.recv(64))
                if len(key.data) == ANSWER_BYTES:
                    key.data.clear()
                    key.fileobj.sendall(QUERIES)
                    count += AT_ONCE
        self.rates.append(count / (now_s - begin_s))
        self.used_s += self.cpu_s - begin_cpu_s
        self.waited_s += sum(map(waited_s, self.processes)) - begin_waited_s
        self.requests += count

    def row(self, name: str) -> str:
        """How fast, and at which price."""
        return (
            f"  {name:<12}{statistics.median(self.rates):9.0f} requests/s,"
            f" CPU {1e6 * self.used_s / self.requests:.1f} µs each;"
            f" had a core {100 * self.used_s / (self.used_s + self.waited_s):.0f} % of the time"
        )


def compare_workers(folder: Path, seconds: float) -> None:
    """One process and two workers, turn about."""
    with contextlib.ExitStack() as stack:
        one, two = (Busy(folder / f"busy-{count}", count, stack) for count in (1, 2))
        for _ in range(SLICES + 1):
            for each in (one, two):
                each.take_turn(seconds)
        ratios = [many / few for few, many in zip(one.rates[1:], two.rates[1:], strict=True)]
        print(f"  workers: {BUSY_LINES} lines that take no time, a client that asks on all at once")
        print(one.row("one process"))
        print(two.row("two workers"))
        print(f"  ratio {statistics.median(ratios):.2f}")


def measure_rack(folder: str, seconds: float, blocks: int = BLOCKS) -> None:
    """All of it."""
    with rack(Path(folder) / "half", blocks // 2) as half:
        half_kib = half.private_kib
    with rack(Path(folder) / "rack", blocks) as running:
        count = len(running.seats)
        ready_s, cpu_s = running.start_s
        begin_s, begin_cpu_s = time.perf_counter(), running.cpu_s
        time.sleep(IDLE_S)
        idle = (running.cpu_s - begin_cpu_s) / (time.perf_counter() - begin_s)
        further_kib = (running.private_kib - half_kib) / (count - len(half.seats))
        print(f"\nrack: {count} devices of {len(models())} models, real rates")
        print(f"  ready in {ready_s:.2f} s, CPU time {cpu_s:.2f} s; idle CPU {100 * idle:.2f} %")
        print(f"  memory: {further_kib:.1f} KiB per further device")
        with rack(Path(folder) / "other", blocks) as other:
            compare_quiet(running, other, seconds * SLICE_FACTOR)
    compare_workers(Path(folder), seconds * SLICE_FACTOR)
