"""Ports that a program forgets to shut down."""

import gc
import logging
import threading
from typing import Any

import can
import pytest

from axistwin import catalog
from axistwin.canbus import AxistwinBus
from axistwin.canbus.shared import open_names, sweep
from axistwin.devices.mac.can.device import MacCan
from axistwin.runtime.bus import Bus
from axistwin.wire.can_frame import CanFrame

READ = can.Message(
    arbitration_id=0x601, data=bytes.fromhex("4000200000000000"), is_extended_id=False
)


def opened(name: str) -> AxistwinBus:
    """A port of the bus of that name."""
    bus = can.Bus(interface="axistwin", channel=f"mac23-can:1?bus={name}&time=virtual")
    assert isinstance(bus, AxistwinBus)
    return bus


def test_a_port_may_be_collected_while_a_frame_is_handed_out(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is taken off the bus later; nobody else notices, and the log says what was forgotten."""
    one = opened("told")
    forgotten = [opened("told")]
    accepts = MacCan.accepts

    def accepting(device: MacCan, frame: CanFrame) -> bool:
        forgotten.clear()  # after it is known who hears the frame, before all are told
        return accepts(device, frame)

    monkeypatch.setattr(MacCan, "accepts", accepting)
    with caplog.at_level(logging.WARNING):
        one.send(READ)
        replies = [one.recv(0.1), one.recv(0.1)]
    assert [reply and reply.arbitration_id for reply in replies] == [0x581, None]
    assert caplog.messages == ["AxistwinBus was not properly shut down"]
    one.shutdown()
    sweep()
    assert open_names() == []


@pytest.mark.strength
def test_the_bus_ends_with_its_last_port_though_forgotten() -> None:
    """Swept away when another bus is opened, or at the end of the program."""
    bus = opened("last")
    del bus
    gc.collect()
    other = opened("other")
    assert open_names() == ["other"]
    other.shutdown()


def test_a_port_may_be_collected_while_another_one_is_opened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The registry of buses is locked then, and must not be asked for again."""
    forgotten = [opened("registry")]
    build_bus = catalog.build_bus

    def building(*arguments: Any, **options: Any) -> Bus:
        forgotten.clear()
        return build_bus(*arguments, **options)

    monkeypatch.setattr(catalog, "build_bus", building)
    others: list[AxistwinBus] = []
    thread = threading.Thread(target=lambda: others.append(opened("besides")), daemon=True)
    thread.start()
    thread.join(10)
    assert others, "it waits for itself"
    others[0].shutdown()
    sweep()
    assert open_names() == []
