"""Host programs of the sleeping kind, which know nothing of twins and of virtual time."""

import asyncio
import queue
import threading
import time
from datetime import timedelta
from time import monotonic, sleep
from typing import Any

import can

HOUR_S = timedelta(hours=1).total_seconds()

WHERE = b"\x0201400200000000000A2\x03"
"""Query 20h to module 00."""

UPLOAD = can.Message(
    arbitration_id=0x601, data=bytes.fromhex("4000200000000000"), is_extended_id=False
)
"""The same of module 1, on CAN."""


def ask(port: Any) -> int:
    """Where module 00 is.  Raises TimeoutError."""
    port.write(WHERE)
    answer = port.read(21)
    if len(answer) != 21:
        raise TimeoutError("timed out")
    return int(answer[9:17], 16)


def wait_until_there(port: Any, target: int, timeout_s: float = 30.0) -> None:
    """Poll ten times a second.  Raises TimeoutError."""
    give_up = monotonic() + timeout_s
    while ask(port) != target:
        if monotonic() > give_up:
            raise TimeoutError(f"not at {target} within {timeout_s} s")
        sleep(0.1)


def poll(port: Any, period_s: float = 2.0, duration_s: float = HOUR_S) -> int:
    """One thread: how often it asked."""
    end = monotonic() + duration_s
    count = 0
    while monotonic() < end:
        ask(port)
        sleep(period_s)
        count += 1
    return count


def poll_in_a_thread(port: Any, period_s: float = 2.0, duration_s: float = HOUR_S) -> int:
    """One thread asks, one takes what it found, a timer ends both."""
    found: queue.Queue[int] = queue.Queue()
    stop = threading.Event()

    def work() -> None:
        while not stop.wait(period_s):
            found.put(ask(port))

    worker = threading.Thread(target=work)
    timer = threading.Timer(duration_s, stop.set)
    worker.start()
    timer.start()
    count = 0
    while not stop.is_set():
        try:
            found.get(timeout=2 * period_s)
            count += 1
        except queue.Empty:
            break
    worker.join(timeout=5)
    timer.cancel()
    if worker.is_alive():
        raise TimeoutError("the worker does not end")
    return count


async def poll_in_a_loop(port: Any, period_s: float = 5.0, duration_s: float = HOUR_S) -> int:
    """asyncio: the port is read in an executor, and a watchdog runs beside."""
    loop = asyncio.get_running_loop()
    barks = 0

    async def watch() -> None:
        nonlocal barks
        while True:
            await asyncio.sleep(60)
            barks += 1

    watchdog = asyncio.create_task(watch())
    end = loop.time() + duration_s
    while loop.time() < end:
        await loop.run_in_executor(None, ask, port)
        await asyncio.sleep(period_s)
    watchdog.cancel()
    return barks


def listen(bus: can.BusABC, period_s: float = 2.0, duration_s: float = HOUR_S) -> int:
    """python-can: a periodic request, a notifier's thread, and a main thread that sleeps."""
    replies: list[can.Message] = []

    def take(message: can.Message) -> None:
        if message.arbitration_id == 0x581:
            replies.append(message)

    notifier = can.Notifier(bus, [take])
    task = bus.send_periodic(UPLOAD, period_s)
    end = time.monotonic() + duration_s
    while time.monotonic() < end:
        time.sleep(10)
    task.stop()
    notifier.stop()
    return len(replies)
