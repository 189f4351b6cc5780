"""Host programs that sleep, with twins in virtual time."""

import asyncio
import gc
import hashlib
import inspect
import queue
import selectors
import sys
import threading
import time
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import can
import pytest
import serial
import sleeping_programs as program
from hypothesis.internal.conjecture.junkdrawer import gc_cumulative_time
from mac_frames import ask, request

from axistwin import testing
from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_S
from axistwin.runtime.host import patches as host_patches
from axistwin.runtime.host.time import GRACE_S, LOOK_NS, HostTime

HOUR_NS = round(program.HOUR_S) * NS_PER_S


@pytest.fixture
def twin() -> Iterator[testing.StartedTwin]:
    """One whose time the program's sleeping moves."""
    with testing.start("mac23", time="virtual", host_clock=True) as started:
        yield started


@pytest.fixture
def port(twin: testing.StartedTwin) -> Any:
    """A program's port to it."""
    return opened(twin.port)


def opened(url: str) -> Any:
    """A client."""
    return serial.serial_for_url(url, baudrate=38400, timeout=0.5)


def places() -> dict[str, object]:
    """Everything that is patched, as it is."""
    names = ("sleep", "time", "monotonic", "perf_counter", "time_ns", "monotonic_ns")
    return {
        **{name: getattr(time, name) for name in names},
        "program": (vars(program)["sleep"], vars(program)["monotonic"]),
        "threads": (threading.Condition.wait, threading.Thread.start, threading.Thread.join),
        "library": (queue.SimpleQueue, selectors.DefaultSelector.select),
        "timer": vars(threading)["_time"],
    }


def test_a_program_that_polls_and_sleeps_lives_its_hour(
    twin: testing.StartedTwin, port: Any
) -> None:
    """``from time import sleep`` was there before the twin."""
    assert 1780 < program.poll(port) <= 1800
    assert twin.virtual_time_ns >= HOUR_NS


def test_a_motion_is_waited_for_by_sleeping(twin: testing.StartedTwin, port: Any) -> None:
    """The twin moves while the program sleeps, and not faster."""
    port.write(request(0x13, 20_000))
    port.read(3)
    program.wait_until_there(port, 20_000)
    assert twin.position == 20_000
    assert twin.virtual_time_ns > NS_PER_S


def test_several_threads_live_their_hour(twin: testing.StartedTwin, port: Any) -> None:
    """Event.wait, Queue.get, Timer and join with time-outs; every exchange is there."""
    assert program.poll_in_a_thread(port) == pytest.approx(1789, abs=1)
    assert HOUR_NS <= twin.virtual_time_ns < HOUR_NS + 10 * NS_PER_S


@pytest.mark.system
def test_a_loop_of_asyncio_lives_its_hour(twin: testing.StartedTwin, port: Any) -> None:
    """Sleeping tasks, and reads in an executor."""
    assert asyncio.run(program.poll_in_a_loop(port)) == 60
    assert HOUR_NS <= twin.virtual_time_ns < HOUR_NS + 10 * NS_PER_S


def test_a_program_on_can_lives_its_hour() -> None:
    """A notifier's thread and a periodic task."""
    with testing.start("mac23-can:1", time="virtual", host_clock=True) as twin:
        assert program.listen(twin.bus) == pytest.approx(1800, abs=1)
        assert HOUR_NS <= twin.virtual_time_ns < HOUR_NS + 10 * NS_PER_S


def test_two_runs_with_threads_are_the_same() -> None:
    """One thread runs at a time, in the order in which they are due."""
    told = []
    for _ in range(2):
        with testing.start("mac23", time="virtual", host_clock=True) as twin:
            program.poll_in_a_thread(opened(twin.port), 0.3, 10.0)
            told.append(twin.line.render_transcript())
    assert told[0] == told[1]
    assert told[0].count("position?") > 30


def test_sleepers_go_on_in_the_order_in_which_they_are_due(twin: testing.StartedTwin) -> None:
    """And at exactly that time."""
    woken: list[tuple[float, int]] = []

    def rest(seconds: float) -> None:
        time.sleep(seconds)
        woken.append((seconds, twin.virtual_time_ns))

    threads = [threading.Thread(target=rest, args=(seconds,)) for seconds in (3.0, 1.0, 2.0, 1.0)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert woken == [(each, round(each * NS_PER_S)) for each in (1.0, 1.0, 2.0, 3.0)]


def test_a_reader_without_time_out_is_woken_by_what_another_thread_asked(port: Any) -> None:
    """Nothing would ever come by itself, but somebody sleeps who will ask."""
    port.timeout = None
    heard: list[bytes] = []
    reader = threading.Thread(target=lambda: heard.append(port.read(21)))
    reader.start()
    time.sleep(1.0)
    port.write(request(0x20))
    reader.join(timeout=1.0)
    assert len(heard) == 1
    assert not reader.is_alive()


def test_a_loop_that_only_looks_at_the_clock_ends(twin: testing.StartedTwin) -> None:
    """Each look takes a little; a look of one thread does not hold up another that is due."""
    ended = threading.Event()
    threading.Timer(0.002, ended.set).start()
    looks = 0
    while not ended.is_set():
        time.perf_counter()
        looks += 1
    assert looks == pytest.approx(0.002 * NS_PER_S / LOOK_NS, rel=0.1)


def test_all_clocks_go_on_together_from_the_present_date(twin: testing.StartedTwin) -> None:
    """Also in whole nanoseconds."""
    clocks = [time.time, time.monotonic, time.perf_counter]
    before = [clock() for clock in clocks]
    before_ns = time.time_ns()
    time.sleep(7200)
    assert [clock() - began for clock, began in zip(clocks, before, strict=True)] == pytest.approx(
        [7200] * 3, abs=0.001
    )
    assert time.time_ns() - before_ns == pytest.approx(7200 * NS_PER_S, abs=NS_PER_S / 1000)
    assert before[0] == pytest.approx(before_ns / NS_PER_S, abs=0.001)


def test_a_thread_that_computes_for_long_in_c_is_waited_for(twin: testing.StartedTwin) -> None:
    """Nor does one fall behind to which a busy machine gives no time."""
    ticks: list[int] = []

    def tick() -> None:
        while not ended.is_set():
            time.sleep(1.0)
            ticks.append(twin.virtual_time_ns)

    ended = threading.Event()
    other = threading.Thread(target=tick)
    other.start()
    hashlib.pbkdf2_hmac("sha256", b"", b"", 1_000_000)
    computed = len(ticks)
    ended.set()
    other.join()
    assert computed == 0


def test_a_thread_that_blocks_in_what_is_not_known_is_not_waited_for(
    twin: testing.StartedTwin,
) -> None:
    """A lock is waited for in C: the clock goes on without it, and so the lock comes free."""
    lock = threading.Lock()
    told: list[str] = []

    def work() -> None:
        with lock:
            told.append("has it too")

    with lock:
        other = threading.Thread(target=work)
        other.start()
        time.sleep(5.0)
        told.append("lets go")
    other.join()
    assert told == ["lets go", "has it too"]
    assert twin.virtual_time_ns >= 5 * NS_PER_S


def test_another_thread_of_the_process_keeps_its_real_time() -> None:
    """What was there before, such as a plug-in's, neither waits nor is waited for."""
    go, seen = threading.Event(), []

    def work() -> None:
        go.wait(10)
        began = time.monotonic()
        time.sleep(GRACE_S)
        seen.append(time.monotonic() - began)

    bystander = threading.Thread(target=work)
    bystander.start()
    with testing.start("mac23", time="virtual", host_clock=True) as twin:
        go.set()
        while not seen:
            time.sleep(0.001)
            host_patches.really_sleep(0.001)
        assert twin.virtual_time_ns > 0
    bystander.join()
    assert seen[0] >= GRACE_S


def test_a_url_moves_with_the_program_while_it_is_open() -> None:
    """``host_clock=yes``; closed, the process has its time again."""
    before = places()
    port = opened("axistwin://mac23?time=virtual&host_clock=yes")
    vars(program)["sleep"](100)
    assert port.virtual_time_ns >= 100 * NS_PER_S
    port.close()
    assert places() == before
    port.open()
    time.sleep(100)
    assert port.virtual_time_ns >= 200 * NS_PER_S
    assert ask(port, 0x20) == 0
    del port
    assert places() == before


def test_a_bus_moves_with_the_program_until_it_is_shut_down() -> None:
    """As the argument of ``can.Bus``."""
    before = places()
    with can.Bus(
        interface="axistwin", channel="mac23-can:1", time="virtual", host_clock=True
    ) as bus:
        time.sleep(100)
        assert bus.virtual_time_ns >= 100 * NS_PER_S  # type: ignore[attr-defined]
        bus.send(program.UPLOAD)
        assert bus.recv(1.0) is not None
    assert places() == before


def test_two_lines_have_one_time() -> None:
    """Whichever is waited for; the second begins at 0 when it is made."""
    with testing.start("mac23", time="virtual", host_clock=True) as first:
        time.sleep(10)
        with testing.start("mac23", time="virtual", host_clock=True) as second:
            assert second.virtual_time_ns == 0
            assert ask(opened(second.port), 0x20) == 0
            second.advance(5)
            assert first.virtual_time_ns == second.virtual_time_ns + 10 * NS_PER_S


def test_a_library_of_tests_that_times_the_garbage_collector_moves_nothing(
    twin: testing.StartedTwin,
) -> None:
    """Hypothesis looks at a clock whenever the collector runs: that is no look of the program."""
    gc_cumulative_time()
    before_ns = twin.virtual_time_ns
    gc.collect()
    assert twin.virtual_time_ns == before_ns


def test_nothing_is_left_behind() -> None:
    """Nor in a module that was imported meanwhile; who has kept a function gets real time."""
    before = places()
    late = ModuleType("a_module_that_comes_late")
    with testing.start("mac23", time="virtual", host_clock=True):
        assert places() != before
        exec("from time import sleep, monotonic", vars(late))
        sys.modules[late.__name__] = late
        kept = time.monotonic
    del sys.modules[late.__name__]
    assert places() == before
    assert abs(kept() - time.monotonic()) < 60
    with testing.start("mac23", time="virtual", host_clock=True):
        sys.modules[late.__name__] = late
    del sys.modules[late.__name__]
    assert late.sleep is time.sleep
    assert late.monotonic is time.monotonic


def test_a_thread_that_outlives_the_twin_goes_on_in_real_time() -> None:
    """Its sleep ends soon, and it is not held up."""
    with testing.start("mac23", time="virtual", host_clock=True):
        sleeper = threading.Thread(target=lambda: time.sleep(1e6), daemon=True)
        event = threading.Event()
        waiter = threading.Thread(target=event.wait, daemon=True)
        sleeper.start()
        waiter.start()
    sleeper.join(60)
    assert not sleeper.is_alive()
    assert waiter.is_alive()
    event.set()
    waiter.join(60)
    assert not waiter.is_alive()


def test_a_mistake_is_the_same_mistake(twin: testing.StartedTwin) -> None:
    """A negative sleep, a condition without its lock, a thread that is started twice."""
    with pytest.raises(ValueError, match="non-negative"):
        time.sleep(-1)
    with pytest.raises(RuntimeError, match="un-acquired"):
        threading.Condition().wait(1)
    thread = threading.Thread(target=lambda: None)
    thread.start()
    with pytest.raises(RuntimeError, match="started once"):
        thread.start()
    thread.join()
    assert "run" not in vars(thread)


@pytest.mark.parametrize("speed", ["real", 20])
def test_only_virtual_time_can_be_moved_by_sleeping(speed: str | float) -> None:
    """The one line says what to write."""
    with pytest.raises(UsageError, match="write time=virtual too"):
        testing.start("mac23", time=speed, host_clock=True)


def test_what_is_patched_is_as_this_python_has_it() -> None:
    """The stand-ins take the same arguments."""
    for owner, name, moved in host_patches._METHODS:
        if inspect.isfunction(moved):
            real = list(inspect.signature(getattr(owner, name)).parameters)
            assert len(inspect.signature(moved).parameters) == len(real)
            assert ("timeout" in real) == ("timeout" in inspect.signature(moved).parameters)


def test_who_is_woken_while_the_waiting_are_looked_at_blocks_nobody() -> None:
    """As by the garbage collector, which may end an executor at any moment."""
    ended: list[bool] = []

    def live() -> None:
        host = HostTime()
        host.start()
        woken: list[None] = []

        def is_ready() -> bool:
            if not woken:
                woken.append(None)
                host.nudge()
            return True

        host.wait(None, is_ready)
        host.stop()
        ended.append(True)

    thread = threading.Thread(target=live, daemon=True)
    thread.start()
    thread.join(30)
    assert ended
