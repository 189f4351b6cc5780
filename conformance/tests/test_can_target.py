"""The one way from the suite to a CAN bus."""

from __future__ import annotations

import errno
import os
import pty
import tty
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import can
import pytest
import serial
from scripted_bus import ScriptedPeer, VirtualBus

from axistwin_conformance.base.errors import OutsideEnvelope, TargetError, TwinCrashed, UsageError
from axistwin_conformance.base.transcript import Direction
from axistwin_conformance.families.mac.can.codec import is_spontaneous
from axistwin_conformance.transport import can as can_transport
from axistwin_conformance.transport.can import CanTransport, any_frame, open_can_target, split_words
from axistwin_conformance.transport.can_frame import Frame, unpack

ASK = Frame(0x601, bytes.fromhex("4000200000000000"))
ANSWER = Frame(0x581, bytes.fromhex("4200200000000007"))
BOOT_UP = Frame(0x701, b"\0")
LIFEBEAT = Frame(0x081, bytes(8))


def answers(frame: Frame) -> Iterable[Frame]:
    """A module that says its lifebeat just before it answers."""
    return (LIFEBEAT, ANSWER) if frame == ASK else ()


def is_answer(frame: Frame) -> bool:
    """What is waited for in most tests."""
    return frame.identifier == 0x581


def virtual(script: Callable[[Frame], Iterable[Frame]] = answers, **words: Any) -> CanTransport:
    """A target on a bus of virtual time."""
    return CanTransport(VirtualBus(script), "toy", is_spontaneous=is_spontaneous, **words)


def behind(target: CanTransport) -> VirtualBus:
    """The bus of such a target."""
    bus = target._bus
    assert isinstance(bus, VirtualBus)
    return bus


@pytest.fixture
def peer() -> Iterator[ScriptedPeer]:
    """A module on python-can's in-process bus."""
    one = ScriptedPeer("suite-test", answers)
    yield one
    one.close()


@pytest.fixture
def target(peer: ScriptedPeer) -> Iterator[CanTransport]:
    """The way to it."""
    one = open_can_target("virtual:suite-test", is_spontaneous=is_spontaneous)
    yield one
    one.close()


# --- over a real python-can bus -------------------------------------------------------------------


def test_frames_go_and_come_over_a_python_can_bus(target: CanTransport, peer: ScriptedPeer) -> None:
    """The machine's clock tells when; all that was said is in the transcript, each frame whole."""
    before_ns = target.now_ns
    target.send(ASK)
    arrival = target.receive(any_frame, 2.0)
    assert arrival is not None
    assert arrival.frame == ANSWER
    assert before_ns <= arrival.time_ns <= target.now_ns
    assert peer.heard == [ASK]
    records = target.transcript.since(0)
    assert [(one.direction, unpack(one.data)) for one in records] == [
        (Direction.HOST, ASK), (Direction.DEVICE, LIFEBEAT), (Direction.DEVICE, ANSWER),
    ]  # fmt: skip
    assert not target.is_virtual
    assert not target.is_lossless


def test_remote_and_extended_frames_arrive_as_what_they_are(
    target: CanTransport, peer: ScriptedPeer
) -> None:
    """Either way."""
    odd = (Frame(0x601, is_remote=True, asked_length=8), Frame(0x601, b"\1", is_extended=True))
    for one in odd:
        target.send(one)
        peer.say(one)
        arrival = target.receive(any_frame, 2.0)
        assert arrival is not None
        assert arrival.frame == one
    target.send(ASK)
    assert target.receive(is_answer, 2.0) is not None
    assert peer.heard == [*odd, ASK]


def test_a_bus_that_is_closed_is_trouble_in_one_line(target: CanTransport) -> None:
    """TargetError, nothing else; closing it again is fine."""
    target.close()
    for act in (lambda: target.send(ASK), lambda: target.receive(any_frame, 0.1), target.drain):
        with pytest.raises(TargetError, match=r"the bus failed while (sending|receiving)") as told:
            act()
        assert "\n" not in str(told.value)
    target.close()


def test_the_round_trip_is_measured(target: CanTransport) -> None:
    """And bounds how well an instant is known."""

    def exchange() -> bool:
        target.send(ASK)
        return target.receive(is_answer, 2.0) is not None

    trip = target.measure_round_trip(exchange, 3)
    assert trip.samples == 3
    assert 0 < trip.median_ns <= trip.max_ns == target.uncertainty_ns


# --- replies, and what is said unasked ------------------------------------------------------------


def test_what_is_said_unasked_is_never_a_reply() -> None:
    """However it is asked for; it is kept and can be taken, once."""
    target = virtual()
    target.send(ASK)
    arrival = target.receive(any_frame, 1.0)
    assert arrival is not None
    assert arrival.frame == ANSWER
    assert target.receive(lambda frame: frame == LIFEBEAT, 0.1) is None
    assert [one.frame for one in target.take_spontaneous()] == [LIFEBEAT]
    assert target.take_spontaneous() == ()


def test_what_is_said_unasked_can_be_waited_for() -> None:
    """It has its exact time in virtual time, and replies that come meanwhile are kept."""
    target = virtual()
    behind(target).schedule(2_000_000_001, BOOT_UP)
    target.send(ASK)
    boot_up = target.receive_spontaneous(lambda frame: frame == BOOT_UP, 3.0)
    assert boot_up == (BOOT_UP, 2_000_000_001)
    assert target.now_ns == 2_000_000_001
    reply = target.receive(is_answer, 0.0)
    assert reply == (ANSWER, 1_000_000)


def test_frames_that_are_not_wanted_wait_for_who_wants_them() -> None:
    """In the order in which they came."""
    foreign = (Frame(0x123, b"\1"), Frame(0x123, b"\2"))
    target = virtual(lambda frame: (*foreign, ANSWER))
    target.send(ASK)
    assert target.receive(is_answer, 1.0) is not None
    assert [target.receive(any_frame, 0.0) for _ in range(3)] == [
        (foreign[0], 1_000_000), (foreign[1], 1_000_000), None,
    ]  # fmt: skip


def test_a_frame_is_found_among_more_than_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest of what nobody wants falls out; what comes last is still seen."""
    monkeypatch.setattr(can_transport, "FRAMES_KEPT", 3)
    target = virtual(lambda frame: [*(Frame(0x100 + one) for one in range(5)), ANSWER])
    target.send(ASK)
    assert target.receive(is_answer, 1.0) is not None
    assert [one.frame.identifier for one in target.drain()] == [0x103, 0x104]


def test_silence_takes_its_time_and_is_noted() -> None:
    """A reader of the transcript sees that something was awaited."""
    target = virtual(lambda frame: ())
    assert target.receive(any_frame, 0.5) is None
    assert target.now_ns == 500_000_000
    assert list(target.transcript)[-1].text == "nothing for 500 ms"


def test_a_wait_takes_exactly_its_time_whatever_arrives() -> None:
    """And what arrives is kept."""
    target = virtual()
    target.send(ASK)
    assert target.wait(1.5) == 1.5
    assert target.now_ns == 1_500_000_000
    assert target.receive(any_frame, 0.0) == (ANSWER, 1_000_000)


def test_what_nobody_asked_for_can_be_set_aside() -> None:
    """It is returned and noted; what was said unasked stays."""
    target = virtual()
    target.send(ASK)
    target.wait(0.1)
    assert [one.frame for one in target.drain()] == [ANSWER]
    assert list(target.transcript)[-1].text == (
        "1 frames nobody asked for were set aside: 581h [8] 42 00 20 00 00 00 00 07"
    )
    assert target.drain() == ()
    assert len(target.take_spontaneous()) == 1


def test_a_bus_that_has_babbled_is_hushed() -> None:
    """Nothing that comes late is left; one that never stops is given up."""
    target = virtual()
    target.send(ASK)
    target.wait_until_quiet(0.1)
    assert target.receive(any_frame, 0.0) is None
    for at in range(100):
        behind(target).schedule(target.now_ns + at * 50_000_000, ANSWER)
    before_ns = target.now_ns
    target.wait_until_quiet(0.1)
    assert target.now_ns - before_ns < 2_000_000_000


# --- our own frames -------------------------------------------------------------------------------


class EchoingBus(VirtualBus):
    """Gives back each frame sent, marked or not, before anything else."""

    def __init__(self, *, is_marked: bool) -> None:
        super().__init__(lambda frame: (frame, *answers(frame)))
        self.is_marked = is_marked

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame."""
        message = super().recv(timeout)
        if message is not None and self.is_marked:
            message.is_rx = message.arbitration_id != ASK.identifier
        return message


@pytest.mark.parametrize("is_marked", [True, False])
def test_our_own_frames_are_not_heard(is_marked: bool) -> None:
    """Those the interface marks, and one for each sent on an interface known for it."""
    bus = EchoingBus(is_marked=is_marked)
    target = CanTransport(bus, "toy", is_spontaneous=is_spontaneous, is_echoing=not is_marked)
    target.send(ASK)
    assert target.wait(0.1)
    assert [one.frame for one in target.drain()] == [ANSWER]


def test_on_socketcan_frames_of_other_local_programs_are_heard() -> None:
    """Linux marks whatever was sent on this machine."""
    bus = EchoingBus(is_marked=True)
    target = CanTransport(bus, "toy", is_spontaneous=is_spontaneous, marks_own=False)
    target.send(ASK)
    assert target.wait(0.1)
    assert [one.frame for one in target.drain()] == [ASK, ANSWER]


def test_a_frame_like_ours_is_heard_where_nothing_echoes() -> None:
    """A reply that equals what we sent is still a reply."""
    target = virtual(lambda frame: (frame,))
    target.send(ASK)
    assert target.receive(any_frame, 0.1) is not None


def test_an_echo_is_taken_away_once_and_not_for_ever() -> None:
    """A second one like it is a foreign frame, and so is one long after."""
    target = CanTransport(VirtualBus(lambda frame: (frame, frame)), "toy", is_echoing=True)
    target.send(ASK)
    target.wait(0.1)
    assert len(target.drain()) == 1
    silent = CanTransport(VirtualBus(), "toy", is_echoing=True)
    silent.send(ASK)
    silent.wait(2.0)
    behind(silent).schedule(silent.now_ns, ASK)
    assert silent.receive(any_frame, 0.0) is not None


# --- gate, fence, meter ---------------------------------------------------------------------------


def test_nothing_passes_a_closed_gate() -> None:
    """The gate sees every frame, packed, before the bus does."""
    target = virtual()

    def gate(data: bytes) -> None:
        raise AssertionError(f"closed for {unpack(data)}")

    target.gate = gate
    with pytest.raises(AssertionError, match="closed for 601h"):
        target.send(ASK)
    assert behind(target).sent == []
    assert len(target.transcript) == 0
    assert target.last_sent == b""


def test_what_is_really_sent_is_counted() -> None:
    """The meter sees what has passed the gate."""
    target = virtual()
    seen: list[bytes] = []
    target.meter = seen.append
    target.send(ASK)
    assert seen == [ASK.pack()] == [target.last_sent]


class ToyFence:
    """Endless motion that has to be stopped after half a second."""

    runaway = broken = ""
    is_in_doubt = False

    def __init__(self) -> None:
        self.deadline_ns: int | None = 500_000_000
        self.heard: list[Frame] = []
        self.said: list[Frame] = []

    def sending(self, data: bytes, now_ns: int, /) -> None:
        """Learn that it is stopped."""
        self.said.append(unpack(data))
        if self.said[-1] == STOP:
            self.deadline_ns = None

    def received(self, data: bytes, now_ns: int, /) -> None:
        """Hear all there is."""
        self.heard.append(unpack(data))

    def stop(self) -> tuple[bytes, ...]:
        """What ends it."""
        return (STOP.pack(),)

    def needed(self, wait_ns: int, /) -> int:
        """How large the envelope would have to be."""
        return 1000

    def worked(self, name: str, window: tuple[int, int], *_: object) -> None:
        """No rig here."""


STOP = Frame(0x601, bytes.fromhex("2318200000000000"))


def test_the_fence_hears_both_ways_and_stops_endless_motion_in_time() -> None:
    """Past the gate, and the check is told that its wait was cut."""
    target, travel_guard = virtual(), ToyFence()
    target.travel_guard = travel_guard

    def gate(data: bytes) -> None:
        assert unpack(data) == ASK, "a stop need not pass"

    target.gate = gate
    target.send(ASK)
    with pytest.raises(OutsideEnvelope) as told:
        target.wait(10.0)
    assert told.value.needed == 1000
    assert behind(target).sent == [ASK, STOP]
    assert target.gate is gate
    assert target.now_ns <= 550_000_000
    assert travel_guard.heard == [LIFEBEAT, ANSWER]


def test_between_checks_endless_motion_is_stopped_without_a_word() -> None:
    """There is nobody to tell; the wait goes on."""
    target = virtual()
    target.travel_guard = ToyFence()
    assert target.wait(2.0) == 2.0
    assert behind(target).sent == [STOP]


# --- trouble --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (can.CanOperationError("Transmit buffer full"), "Transmit buffer full"),
        (can.CanOperationError("no", errno.ENETDOWN), "Network is down"),
        (OSError(errno.ENODEV, "x"), "No such device"),
        (can.CanTimeoutError("late"), "does not take frames any more"),
    ],
)
def test_whatever_a_bus_raises_becomes_one_line(error: Exception, words: str) -> None:
    """Gone, down or stuck: TargetError, and no crash of a twin."""
    target = virtual()

    def fail(*_: object) -> None:
        raise error

    behind(target).send = fail  # type: ignore[method-assign, assignment]
    with pytest.raises(TargetError, match=words) as told:
        target.send(ASK)
    assert not isinstance(told.value, TwinCrashed)
    assert target.crash == ""


def test_a_full_queue_is_waited_for() -> None:
    """An adapter that has no room at once takes the frame a little later."""
    target, left = virtual(), [3]
    send = behind(target).send

    def full(msg: can.Message, timeout: float | None = None) -> None:
        left[0] -= 1
        if left[0]:
            raise can.CanOperationError("Failed to transmit", errno.ENOBUFS)
        send(msg, timeout)

    behind(target).send = full  # type: ignore[method-assign]
    target.send(ASK)
    assert behind(target).sent == [ASK]


def test_a_twin_that_falls_over_is_told_from_a_bus_that_fails() -> None:
    """With exception and place; nothing goes to it any more."""
    target = virtual()

    def fail(*_: object) -> None:
        raise ZeroDivisionError("oops")

    behind(target).recv = fail  # type: ignore[method-assign, assignment]
    with pytest.raises(TwinCrashed, match=r"crashed: ZeroDivisionError: oops \(test_can_target.py"):
        target.wait(1.0)
    assert "ZeroDivisionError" in target.crash
    with pytest.raises(TwinCrashed):
        target.send(ASK)
    target.close()
    assert not behind(target).is_open


def test_a_driver_that_falls_over_is_no_twin() -> None:
    """On a real bus whatever comes out of it is trouble of the bus."""

    class Broken(VirtualBus):
        virtual_time_ns = None  # type: ignore[assignment]

        def __init__(self) -> None:
            pass

        def recv(self, timeout: float | None = None) -> can.Message | None:
            raise TypeError("'NoneType'\nobject")

    target = CanTransport(Broken(), "toy")
    with pytest.raises(TargetError, match="closed while receiving: 'NoneType' object"):
        target.receive(any_frame, 0.1)
    assert target.crash == ""


@pytest.mark.parametrize("words", [{"is_error_frame": True}, {"is_fd": True}])
def test_what_is_no_classical_frame_is_noted_and_no_reply(words: dict[str, bool]) -> None:
    """Error frames and CAN FD are in the transcript for the reader."""
    target = virtual()
    coming = [can.Message(arbitration_id=0x581, data=b"\1", is_extended_id=False, **words)]
    behind(target).recv = lambda timeout=None: coming.pop() if coming else None  # type: ignore[method-assign]
    assert target.receive(any_frame, 0.0) is None
    assert "on the bus: 581h 01" in list(target.transcript)[-1].text
    assert target.error_frames == int("is_error_frame" in words)


# --- opening --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "split"),
    [
        ("socketcan:vcan0", ("socketcan", "vcan0", {})),
        ("slcan:socket://127.0.0.1:7?sleep_after_open=0",
         ("slcan", "socket://127.0.0.1:7", {"sleep_after_open": "0"})),
        ("axistwin:mac23-can:1,2?time=virtual&quirk.a=b",
         ("axistwin", "mac23-can:1,2?time=virtual&quirk.a=b", {})),
    ],
)  # fmt: skip
def test_interface_channel_and_options_are_told_apart(words: str, split: object) -> None:
    """The built-in twin takes its options itself."""
    assert split_words(words) == split


@pytest.mark.parametrize("words", ["vcan0", ":vcan0", "socketcan:", "slcan:/dev/x?fast"])
def test_words_that_cannot_be_meant_are_refused_with_the_remedy(words: str) -> None:
    """The user reads what to write instead."""
    with pytest.raises(UsageError, match=r"--can .*(socketcan:vcan0|\?name=value)"):
        split_words(words)


@pytest.mark.parametrize(
    "words", ["nonsense:x", "socketcan:no-such-interface", "slcan:/dev/no-such-device"]
)
def test_a_bus_that_cannot_be_opened_is_told_in_one_line(words: str) -> None:
    """With what was asked for, and without a traceback."""
    with pytest.raises(TargetError, match=f"cannot open {words}: ") as told:
        open_can_target(words)
    assert "\n" not in str(told.value)


def test_options_and_bit_rate_reach_the_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    """Multicast stays on this machine unless the user says otherwise, and is known to echo."""
    asked: list[tuple[object, ...]] = []

    def fake(channel: str, interface: str, **words: object) -> VirtualBus:
        asked.append((channel, interface, words))
        return VirtualBus()

    monkeypatch.setattr(can, "Bus", fake)
    open_can_target("udp_multicast:239.74.163.2")
    options = "ttyBaudrate=115200&sleep_after_open=0.5&fd=false&name=x"
    open_can_target(f"slcan:/dev/x?{options}", bitrate=125_000)
    assert asked == [
        ("239.74.163.2", "udp_multicast", {"ignore_config": True, "hop_limit": 0}),
        ("/dev/x", "slcan",
         {"ignore_config": True, "ttyBaudrate": 115_200, "sleep_after_open": 0.5, "fd": False,
          "name": "x", "bitrate": 125_000}),
    ]  # fmt: skip


def test_a_twin_that_cannot_be_made_has_crashed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mistake of the twin's is not blamed on the user."""

    def fall(*_: object, **__: object) -> None:
        raise AssertionError("broken")

    monkeypatch.setattr(can, "Bus", fall)
    with pytest.raises(TwinCrashed, match="broken"):
        open_can_target("axistwin:mac23-can:1?time=virtual")
    with pytest.raises(TargetError, match="cannot open virtual:x: AssertionError: broken"):
        open_can_target("virtual:x")


# --- adapters on a line ---------------------------------------------------------------------------


def test_a_frame_that_cannot_be_is_the_adapter_s_and_ends_nothing() -> None:
    """A byte lost on the adapter's line makes an identifier of 12 bits; what comes next counts."""
    target = virtual()
    arriving = iter(
        (can.Message(arbitration_id=0x814, is_extended_id=False), can.Message(
            arbitration_id=0x581, data=ANSWER.data, is_extended_id=False))
    )  # fmt: skip
    behind(target).recv = lambda timeout=None: next(arriving, None)  # type: ignore[method-assign]
    arrival = target.receive(any_frame, 1.0)
    assert arrival is not None
    assert arrival.frame == ANSWER
    assert target.error_frames == 1
    assert any("identifier 814h is outside" in one.text for one in target.transcript)


@pytest.mark.system
def test_an_adapter_that_another_program_uses_is_not_shared() -> None:
    """Each of two readers would get halves of frames, and a sound module seem a wrong one."""
    far, near = pty.openpty()
    tty.setraw(near)
    name = os.ttyname(near)
    try:
        with (
            serial.Serial(name, exclusive=True),
            pytest.raises(TargetError, match="in use by another program"),
        ):
            open_can_target(f"slcan:{name}?sleep_after_open=0")
        open_can_target(f"slcan:{name}?sleep_after_open=0").close()
    finally:
        os.close(far)
        os.close(near)
