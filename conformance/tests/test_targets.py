"""The one way from the suite to a device."""

from __future__ import annotations

import os
import pty
import socket
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
from small_scratch import small_scratch

from axistwin_conformance.base.errors import TargetError, TwinCrashed, UsageError
from axistwin_conformance.base.transcript import Direction
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.transport.kinds import LINE, choose_endpoint
from axistwin_conformance.transport.serial import SerialTransport, open_target

NO_RATES = {"--baud": None, "--bitrate": None}


@pytest.fixture
def master_and_name() -> Iterator[tuple[int, str]]:
    """A pty: the file descriptor of its far end, and the name to open."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    os.close(master)


def test_bytes_go_and_come_and_are_all_in_the_transcript(toy: Any) -> None:
    """With direction and time."""
    target = toy.open(())
    target.send(b"Q")
    assert target.receive(1, 0.1) == b"q"
    assert [(one.direction, one.data) for one in target.transcript] == [
        (Direction.HOST, b"Q"), (Direction.DEVICE, b"q"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("model", "check"),
    [
        ("mn400", "every_reply_is_packets_as_the_manual_draws_them"),
        ("msc-250", "all_flags_come_in_one_reply"),
    ],
)
def test_a_look_at_what_is_upcoming_changes_nothing(
    model: str, check: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is said, what comes of it and when is the same; it only takes fewer calls."""
    options = make_options(model=model, ids=(check,), **small_scratch(model))
    kinds = []
    for looks in (True, False):
        lines: list[SerialTransport] = []
        if not looks:
            monkeypatch.setattr(SerialTransport, "upcoming", b"")

        def opened(neighbours: tuple[int, ...], lines: list[SerialTransport] = lines) -> Any:
            url = options.family.twin_url(options.model, options.address, neighbours)
            lines.append(open_target(url, 9600, is_builtin=True))
            return lines[-1]

        assert Engine(options, opened).run(lambda event: None).exit_status == 0
        kinds.append((_said(lines), [line.now_ns for line in lines], lines))
    (said, times, looking), (also_said, also_times, blind) = kinds
    assert (said, times) == (also_said, also_times)
    pieces, single = (sum(line.transcript.position for line in each) for each in (looking, blind))
    assert pieces < single


def _said(lines: list[SerialTransport]) -> list[tuple[bytes, bytes]]:
    """The exchanges: what was sent, and all that came before the next."""
    found = [(b"", b"")]
    for record in (record for line in lines for record in line.transcript):
        if record.direction is Direction.HOST:
            found.append((record.data, b""))
        elif record.direction is Direction.DEVICE:
            found[-1] = (found[-1][0], found[-1][1] + record.data)
    return found


def test_in_virtual_time_a_wait_takes_exactly_its_time(toy: Any) -> None:
    """The clock is the port's."""
    target = toy.open(())
    assert target.is_virtual
    before_ns = target.now_ns
    assert target.wait(1.5) == 1.5
    assert target.now_ns - before_ns == 1_500_000_000


def test_bytes_that_arrive_during_a_wait_are_kept(toy: Any) -> None:
    """And the wait still lasts its time."""
    target = toy.open(())
    target.send(b"Q")
    assert target.wait(1.0) == 1.0
    assert target.receive(1, 0.0) == b"q"


def test_silence_takes_its_time_and_is_noted(toy: Any) -> None:
    """A reader of the transcript sees that something was awaited."""
    target = toy.open(())
    before_ns = target.now_ns
    assert target.receive(1, 0.5) == b""
    assert target.now_ns - before_ns == 500_000_000
    assert list(target.transcript)[-1].text == "nothing for 500 ms"


def test_what_nobody_asked_for_can_be_set_aside(toy: Any) -> None:
    """And is returned, for a check that judges it."""
    target = toy.open(())
    target.send(b"Q")
    assert target.drain() == b"q"
    assert target.drain() == b""


def test_the_round_trip_counts_only_exchanges_that_succeed(toy: Any) -> None:
    """A lost reply says nothing about the line's speed."""
    target = toy.open(())
    outcomes = [True, False, True, True]

    def exchange() -> bool:
        target.wait(0.001 * len(outcomes))
        return outcomes.pop()

    trip = target.measure_round_trip(exchange, 4)
    assert (trip.samples, trip.median_ns, trip.max_ns) == (3, 3_000_000, 4_000_000)
    assert target.uncertainty_ns == 4_000_000


def test_exchanges_that_all_fail_are_timed_for_two_minutes_at_most(toy: Any) -> None:
    """Each may take a minute, of a device that answers one question of three."""
    target = toy.open(())
    asked: list[int] = []

    def exchange() -> bool:
        asked.append(target.now_ns)
        target.wait(70)
        return False

    assert target.measure_round_trip(exchange, 20).samples == 0
    assert len(asked) == 2


def test_nothing_passes_a_closed_gate(toy: Any) -> None:
    """The gate sees every byte before the port does."""
    target = toy.open(())

    def gate(data: bytes) -> None:
        raise AssertionError("closed")

    target.gate = gate
    with pytest.raises(AssertionError, match="closed"):
        target.send(b"M")
    assert toy.port.sent == []
    assert len(target.transcript) == 0


@pytest.mark.parametrize(
    "error",
    [
        serial.SerialException("gone"),
        serial.SerialTimeoutException("Write timeout"),
        OSError(5, "Input/output error"),
        TypeError("'NoneType' object cannot be interpreted as an integer"),
    ],
)
def test_whatever_a_port_raises_becomes_one_line(real_toy: Any, error: Exception) -> None:
    """Closed, vanished or stuck: TargetError, nothing else."""
    target = real_toy.open(())

    def fail(data: bytes) -> int:
        raise error

    real_toy.port.write = fail
    with pytest.raises(TargetError, match="sending") as caught:
        target.send(b"Q")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("error", [ZeroDivisionError("oops"), TypeError("a\nb")])
def test_a_twin_that_falls_over_is_told_from_a_port_that_fails(toy: Any, error: Exception) -> None:
    """One line with exception and place; nothing goes to it any more, closing it is fine."""
    target = toy.open(())

    def fail(data: bytes) -> int:
        raise error

    toy.port.write = fail
    with pytest.raises(TwinCrashed) as caught:
        target.send(b"Q")
    name, text = type(error).__name__, " ".join(str(error).split())
    told = f"the built-in twin crashed: {name}: {text} (test_targets.py:"
    assert str(caught.value).startswith(told)
    assert target.crash == str(caught.value)
    del toy.port.write
    for act in (lambda: target.send(b"Q"), target.drain, lambda: target.receive(1, 0.1)):
        with pytest.raises(TwinCrashed, match="crashed"):
            act()
    assert toy.port.sent == []
    target.mark("still with a clock")
    target.close()


def test_closing_a_port_that_is_gone_is_fine(toy: Any) -> None:
    """The way out never fails."""

    def fail() -> None:
        raise OSError(9, "Bad file descriptor")

    toy.port.close = fail
    toy.open(()).close()


@pytest.mark.system
def test_a_pty_is_a_target(master_and_name: tuple[int, str]) -> None:
    """In real time, with a wait that lasts at least its time."""
    master, name = master_and_name
    target = open_target(name, 38400)
    target.send(b"hello")
    assert os.read(master, 10) == b"hello"
    os.write(master, b"answer")
    assert target.receive(6, 1.0) == b"answer"
    assert not target.is_virtual
    assert target.wait(0.03) >= 0.03
    os.write(master, b"late")
    target.wait(0.01)
    assert target.drain() == b"late"
    target.baud = 9600
    assert target.baud == 9600
    target.close()
    with pytest.raises(TargetError):
        target.send(b"x")


@pytest.mark.system
def test_a_pty_whose_far_end_closes_is_trouble_not_a_traceback() -> None:
    """As an adapter pulled out of its socket."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    target = open_target(os.ttyname(slave), 38400)
    os.close(slave)
    os.close(master)
    with pytest.raises(TargetError, match="port failed"):
        target.receive(1, 0.2)
    target.close()


@pytest.mark.system
def test_a_socket_is_a_target_and_its_end_is_trouble() -> None:
    """`socket://` works, and a peer that hangs up is TargetError."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        target = open_target(f"socket://127.0.0.1:{server.getsockname()[1]}", 38400)
        peer, _ = server.accept()
        with peer:
            target.send(b"hello")
            assert peer.recv(10) == b"hello"
            peer.sendall(b"answer")
            assert target.receive(6, 1.0) == b"answer"
        with pytest.raises(TargetError, match="disconnected"):
            target.receive(1, 0.2)
        target.close()


@pytest.mark.system
@pytest.mark.parametrize(
    "url", ["/dev/no-such-port", "socket://127.0.0.1:1", "nonsense://x", "socket://nowhere"]
)
def test_a_port_that_cannot_be_opened_says_so_in_one_line(url: str) -> None:
    """With its name."""
    with pytest.raises(TargetError, match="cannot open") as caught:
        open_target(url, 38400)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value.__cause__, Exception)


@pytest.mark.system
def test_a_port_is_not_shared(master_and_name: tuple[int, str]) -> None:
    """A second program on the port would spoil every verdict."""
    first = open_target(master_and_name[1], 38400)
    with pytest.raises(TargetError, match="in use by another program"):
        open_target(master_and_name[1], 38400)
    first.close()
    assert isinstance(first, SerialTransport)


@pytest.mark.system
def test_an_exchange_is_a_send_and_a_receive(toy: Any) -> None:
    """The reply, when it was asked for and when it was there; all of it in the transcript."""
    target = toy.open(())
    before_ns = target.now_ns
    assert target.is_direct
    started_ns, reply, done_ns = target.exchange(b"Q", 1, 0.5)
    assert (started_ns, reply) == (before_ns, b"q")
    assert target.now_ns == done_ns
    assert target.last_sent == b"Q"
    assert [(one.direction, one.data) for one in target.transcript] == [
        (Direction.HOST, b"Q"), (Direction.DEVICE, b"q"),
    ]  # fmt: skip


def test_a_silent_exchange_takes_its_time_and_is_noted(toy: Any) -> None:
    """As with `receive`; the clock goes on from there."""
    target = toy.open(())
    target.exchange(b"Q", 1, 0.5)
    toy.port.is_mute = True
    started_ns, reply, done_ns = target.exchange(b"Q", 1, 0.5)
    assert (reply, done_ns - started_ns) == (b"", 500_000_000)
    assert list(target.transcript)[-1].text == "nothing for 500 ms"
    assert target.wait(0.25) == 0.25
    assert target.now_ns - done_ns == 250_000_000


def test_an_exchange_passes_the_gate_and_the_meter(toy: Any) -> None:
    """What may not be sent is not, whichever way it takes."""
    target, counted = toy.open(()), list[bytes]()
    target.meter = counted.append
    target.exchange(b"Q", 1, 0.5)
    assert counted == [b"Q"]

    def gate(data: bytes) -> None:
        raise AssertionError("closed")

    target.gate = gate
    with pytest.raises(AssertionError, match="closed"):
        target.exchange(b"M", 1, 0.5)
    assert toy.port.sent == ["Q"]


def test_a_port_that_exchanges_in_one_call_is_asked_once(toy: Any) -> None:
    """What it tells is what is told, and it stands in the transcript as always."""
    asked = list[tuple[bytes, int, float]]()

    def exchange(data: bytes, size: int, timeout_s: float) -> tuple[int, bytes, int]:
        asked.append((data, size, timeout_s))
        return 0, b"q", 5_000

    toy.port.exchange = exchange
    target = toy.open(())
    before_ns = target.now_ns
    assert target.exchange(b"Q", 1, 0.5) == (before_ns, b"q", 5_000)
    assert asked == [(b"Q", 1, 0.5)]
    assert toy.port.sent == []
    assert target.now_ns == 5_000
    assert [one.data for one in target.transcript] == [b"Q", b"q"]


def test_a_twin_that_falls_over_in_an_exchange_is_told_with_what_it_was_asked(toy: Any) -> None:
    """The request stands in the transcript; nothing is sent to it any more."""

    def exchange(data: bytes, size: int, timeout_s: float) -> tuple[int, bytes, int]:
        raise KeyError("fallen over")

    toy.port.exchange = exchange
    target = toy.open(())
    with pytest.raises(TwinCrashed, match="fallen over"):
        target.exchange(b"Q", 1, 0.5)
    assert [one.data for one in target.transcript] == [b"Q"]
    with pytest.raises(TwinCrashed):
        target.send(b"S")


def test_a_cleared_exchange_asks_neither_gate_nor_meter(toy: Any) -> None:
    """Whoever says so has asked them about such a frame before."""
    target, seen = toy.open(()), list[bytes]()
    target.gate = target.meter = seen.append
    target.exchange(b"Q", 1, 0.5, is_cleared=True)
    assert seen == []


def test_a_byte_takes_as_long_as_the_rate_says(toy: Any) -> None:
    """Ten bits, also after the rate has changed."""
    target = toy.open(())
    assert target.byte_ns == 10 * 1_000_000_000 // 9600
    target.baud = 38400
    assert target.byte_ns == 10 * 1_000_000_000 // 38400


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("tcp://h:1", "pyserial has no tcp://; did you mean socket://?"),
        ("nonsense://h:1", "pyserial has no nonsense://; alt, axistwin,"),
        ("socket://h", "write HOST:PORT, PORT in 1 to 65535, as --port socket://192.168.0.5:4001"),
        ("socket://h:99999", "write HOST:PORT"),
        ("rfc2217://h:x", "write HOST:PORT"),
        ("socket://[::1", "Invalid IPv6 URL"),
        ("socket://h:1?speed=9", "it has no option speed; known: logging"),
    ],
)
def test_a_url_that_could_be_opened_nowhere_is_a_mistake_of_whoever_typed_it(
    url: str, told: str
) -> None:
    """With the remedy, before anything is opened; pyserial's own words were of no help."""
    with pytest.raises(UsageError) as caught:
        choose_endpoint((LINE,), "mac23", {"--port": url, "--can": None}, NO_RATES)
    assert str(caught.value).startswith(f"--port {url}: {told}")


@pytest.mark.parametrize(
    "url",
    ["/dev/ttyX", "./x?y", "loop://", "spy:///dev/ttyX", "socket://h:1?logging=debug", "hwgrep://x",
     "SOCKET://h:1", "rfc2217://[::1]:1?ign_set_control&timeout=3", "axistwin://mac23"],
)  # fmt: skip
def test_whatever_pyserial_may_open_is_let_through(url: str) -> None:
    """Whether it is there, shows when it is opened."""
    assert choose_endpoint((LINE,), "mac23", {"--port": url, "--can": None}, NO_RATES)[1] == url


@pytest.mark.system
def test_what_is_no_serial_port_and_who_refuses_is_told_in_plain_words(tmp_path: Path) -> None:
    """Neither numbers of the system nor the name twice."""
    (file := tmp_path / "file").write_text("")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        nobody = f"socket://127.0.0.1:{free.getsockname()[1]}"
        for url, told in (
            (str(file), "it is no serial port"), ("/dev/null", "it is no serial port"),
            (nobody, "Connection refused"),
        ):  # fmt: skip
            with pytest.raises(TargetError) as caught:
                open_target(url, 9600)
            assert str(caught.value) == f"cannot open {url}: {told}"
