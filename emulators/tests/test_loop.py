"""The event loop: descriptors, times, other threads and signals."""

import contextlib
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from axistwin.runtime.serving import loop as loop_module
from axistwin.runtime.serving.loop import Loop, LoopShare


@pytest.fixture
def loop() -> Iterator[Loop]:
    """A loop that does not outlive its test."""
    loop = Loop()
    yield loop
    loop.close()


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Two connected sockets."""
    near, far = socket.socketpair()
    near.setblocking(False)
    with near, far:
        yield near, far


Pair = tuple[socket.socket, socket.socket]


def both(*actions: Callable[[], object]) -> Callable[[], object]:
    """All of ``actions``, one after the other."""
    return lambda: [action() for action in actions]


def run_for(loop: Loop, seconds: float) -> None:
    """Serve for ``seconds``."""
    loop._is_stopped = False
    loop.call_later(seconds, loop.stop)
    loop.run()


def test_a_reader_is_called_while_there_is_something_to_read(loop: Loop, pair: Pair) -> None:
    """Level-triggered: what one call leaves makes another."""
    near, far = pair
    heard: list[bytes] = []

    def read() -> None:
        heard.append(near.recv(1))
        if len(heard) == 3:
            loop.stop()

    loop.add_reader(near, read)
    far.sendall(b"abc")
    loop.run()
    assert heard == [b"a", b"b", b"c"]


def test_a_reader_that_is_removed_is_not_called_even_if_it_was_ready(
    loop: Loop, pair: Pair
) -> None:
    """Of two that are ready together, the first may remove the second."""
    near, far = pair
    called: list[str] = []

    def first_come(name: str, other: socket.socket) -> None:
        called.append(name)
        loop.remove_reader(other)
        loop.stop()

    loop.add_reader(near, lambda: first_come("near", far))
    loop.add_reader(far, lambda: first_come("far", near))
    near.send(b"x")
    far.send(b"x")
    loop.run()
    assert len(called) == 1


def test_reader_and_writer_of_one_descriptor_come_and_go_apart(loop: Loop, pair: Pair) -> None:
    """Removing the one leaves the other; removing what is not there is no error."""
    near, far = pair
    called: list[str] = []
    loop.add_reader(near, both(lambda: called.append("read"), lambda: near.recv(8)))
    loop.add_writer(near, both(lambda: called.append("write"), lambda: loop.remove_writer(near)))
    far.send(b"x")
    run_for(loop, 0.02)
    assert sorted(called) == ["read", "write"]
    loop.remove_reader(near)
    loop.remove_reader(near)
    far.send(b"x")
    run_for(loop, 0.02)
    assert sorted(called) == ["read", "write"]


def test_a_hang_up_is_told_to_the_reader(loop: Loop, pair: Pair) -> None:
    """The other end closes: there is an end to be read."""
    near, far = pair
    ends: list[bytes] = []
    loop.add_reader(near, both(lambda: ends.append(near.recv(8)), loop.stop))
    far.close()
    loop.run()
    assert ends == [b""]


def test_a_descriptor_without_reader_does_not_keep_the_loop_busy(loop: Loop, pair: Pair) -> None:
    """Bytes that nobody wants to read cost no processor time."""
    near, far = pair
    loop.add_reader(near, lambda: None)
    loop.remove_reader(near)
    far.send(b"x")
    before = time.process_time()
    run_for(loop, 0.2)
    assert time.process_time() - before < 0.1


def test_calls_are_made_in_order_and_calls_may_ask_for_calls(loop: Loop) -> None:
    """``call_soon`` keeps the order, also for what is asked for while calling."""
    called: list[int] = []
    loop.call_soon(called.append, 1)
    loop.call_soon(loop.call_soon, called.append, 3)
    loop.call_soon(called.append, 2)
    loop.call_soon(lambda: loop.call_soon(loop.stop))
    loop.run()
    assert called == [1, 2, 3]


def test_later_calls_are_made_in_the_order_of_time_and_not_too_early(loop: Loop) -> None:
    """The earlier of two first, whenever they were asked for."""
    called: list[tuple[str, float]] = []
    begin = time.monotonic()
    for name, delay_s in (("second", 0.03), ("first", 0.01)):
        loop.call_later(delay_s, lambda name=name: called.append((name, time.monotonic() - begin)))
    loop.call_later(0.04, loop.stop)
    loop.run()
    assert [name for name, _ in called] == ["first", "second"]
    assert called[0][1] >= 0.01
    assert called[1][1] >= 0.03


def test_another_thread_can_call_and_stop_it(loop: Loop) -> None:
    """The loop waits for nothing, and is woken."""
    called: list[int] = []

    def work() -> None:
        for number in range(10_000):  # more than the pipe that wakes it takes
            loop.call_soon(called.append, number)
        loop.stop()

    thread = threading.Thread(target=work)
    loop.call_soon(thread.start)
    loop.run()
    thread.join()
    loop._call_due()
    assert called == list(range(10_000))


def test_a_stop_before_run_makes_it_return_at_once(loop: Loop) -> None:
    """It is not forgotten."""
    loop.stop()
    loop.run()


def test_stop_and_call_soon_are_no_error_when_it_is_closed() -> None:
    """A thread may come too late."""
    loop = Loop()
    loop.close()
    loop.stop()
    loop.call_soon(int)


def test_an_error_in_a_callback_comes_out_of_run(loop: Loop) -> None:
    """It is not swallowed."""
    loop.call_soon(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        loop.run()


def test_the_wake_up_of_another_loop_is_put_back() -> None:
    """As asyncio's, when a server runs in its thread for a while."""
    near, far = socket.socketpair()
    near.setblocking(False)
    with near, far:
        before = signal.set_wakeup_fd(near.fileno())
        try:
            loop = Loop()
            loop.install_signal_handlers([signal.SIGUSR1])
            loop.close()
            assert signal.set_wakeup_fd(before) == near.fileno()
        finally:
            signal.set_wakeup_fd(before)


def test_signals_are_handled_while_it_waits_and_forgotten_when_it_is_closed() -> None:
    """The loop ends what it does before, and the old handler comes back."""
    before = signal.getsignal(signal.SIGUSR1)
    called: list[int] = []
    loop = Loop()
    with contextlib.closing(loop):
        loop.install_signal_handlers([signal.SIGUSR1])
        loop.call_soon(called.append, 1)
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGUSR1)).start()
        loop.run()
    assert called == [1]
    assert signal.getsignal(signal.SIGUSR1) is before


def run_with_signal_at(instruction: int, limit_s: float) -> int | None:
    """Serve, with SIGTERM before that instruction of the loop's code.

    None: that ended it.  Else it was stopped after ``limit_s``, and had come to this instruction.
    """
    seen = 0
    waits_at: int | None = None
    loop = Loop()

    def wake() -> None:
        nonlocal waits_at
        waits_at = seen
        loop.stop()

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal seen
        if frame.f_code.co_filename != loop_module.__file__:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            if seen == instruction:
                signal.raise_signal(signal.SIGTERM)
            seen += 1
        return trace

    with contextlib.closing(loop):
        loop.install_signal_handlers([signal.SIGTERM])
        loop.call_soon(int)
        loop.call_later(0.0, int)
        waker = threading.Timer(limit_s, wake)
        waker.start()
        before = sys.gettrace()
        sys.settrace(trace)
        try:
            loop.run()
        finally:
            sys.settrace(before)
            waker.cancel()
    return waits_at


def test_a_signal_before_any_instruction_of_the_loop_ends_it() -> None:
    """Also one between the last look at what has come and the wait."""
    count = run_with_signal_at(-1, limit_s=1.0)
    assert count is not None
    assert count > 50
    for instruction in range(count):
        is_lost = run_with_signal_at(instruction, limit_s=30.0) is not None
        assert not is_lost, f"the signal before instruction {instruction} was lost"


def test_a_second_signal_before_there_is_a_server_breaks_the_start_off() -> None:
    """The first one waits for it; what is closed afterwards is disturbed by none."""
    with contextlib.closing(Loop()) as loop:
        loop.install_signal_handlers([signal.SIGTERM])
        os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
        loop.has_server = True
        os.kill(os.getpid(), signal.SIGTERM)
        loop.run()


def test_the_failure_of_a_watched_descriptor_is_told_to_its_share_alone(
    loop: Loop, pair: Pair
) -> None:
    """The loop goes on, for readers and for writers."""
    near, far = pair
    errors: list[Exception] = []
    share = LoopShare(loop, errors.append)

    def fail() -> None:
        share.remove_reader(near)
        share.remove_writer(near)
        raise ValueError

    share.add_reader(near, fail)
    far.sendall(b"a")
    run_for(loop, 0.01)
    share.add_writer(near, fail)
    run_for(loop, 0.01)
    assert [type(error) for error in errors] == [ValueError, ValueError]


def test_an_open_is_told_to_who_watches_the_file_until_that_is_removed(
    loop: Loop, tmp_path: Path
) -> None:
    """Of two files each has its own callback, and one may remove the other's."""
    paths = [tmp_path / name for name in "ab"]
    opened: list[str] = []
    numbers = []
    for path in paths:
        path.touch()
        numbers.append(loop.add_open_watch(str(path), partial(opened.append, path.name)))
    paths[1].read_bytes()
    run_for(loop, 0.01)
    assert opened == ["b"]
    loop.remove_open_watch(numbers[1])
    for path in paths:
        path.read_bytes()
    paths[0].unlink()
    run_for(loop, 0.01)
    assert opened == ["b", "a"]
    loop.remove_open_watch(numbers[0])
