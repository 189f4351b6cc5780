"""Ports that a program forgets to shut down."""

import gc
import logging

import can
import pytest

from axistwin.canbus import AxistwinBus
from axistwin.canbus.shared import open_names, sweep

READ = can.Message(
    arbitration_id=0x601, data=bytes.fromhex("4000200000000000"), is_extended_id=False
)


def opened(name: str) -> AxistwinBus:
    """A port of the bus of that name."""
    bus = can.Bus(interface="axistwin", channel=f"mac23-can:1?bus={name}&time=virtual")
    assert isinstance(bus, AxistwinBus)
    return bus


def test_a_port_may_be_collected_while_another_one_is_told_of_a_frame(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """It is taken off the bus later; nobody else notices, and the log says what was forgotten."""
    one = opened("told")
    forgotten = [opened("told")]
    one._bus.subscribe_frames(lambda *_: forgotten.clear())  # with the bus locked, amid a frame
    with caplog.at_level(logging.WARNING):
        one.send(READ)
        replies = [one.recv(0.1), one.recv(0.1)]
    assert [reply and reply.arbitration_id for reply in replies] == [0x581, None]
    assert caplog.messages == ["AxistwinBus was not properly shut down"]
    one.shutdown()
    sweep()
    assert open_names() == []


def test_the_bus_ends_with_its_last_port_though_forgotten() -> None:
    """Swept away when another bus is opened, or at the end of the program."""
    bus = opened("last")
    del bus
    gc.collect()
    other = opened("other")
    assert open_names() == ["other"]
    other.shutdown()


def test_a_port_may_be_collected_while_another_one_is_opened() -> None:
    """The registry of buses is locked then, and must not be asked for again."""
    forgotten = [opened("registry")]
    callback = gc.callbacks
    seen = []

    def forget(phase: str, _: object) -> None:
        if phase == "start" and forgotten:
            seen.append(phase)
            forgotten.clear()

    callback.append(forget)
    threshold = gc.get_threshold()
    try:
        gc.set_threshold(1)
        other = opened("besides")
    finally:
        gc.set_threshold(*threshold)
        callback.remove(forget)
    assert seen
    other.shutdown()
    sweep()
    assert open_names() == []
