"""The owner of a CAN network: time, storage, ports, transcript, threads."""

import threading
import time
from typing import Any

import pytest
from spy_storage import SpySlot, SpyStorage

from axistwin.catalog import build_bus, parse_device
from axistwin.devices.mac.can.decode import explain_frame
from axistwin.devices.mac.can.device import MacCan
from axistwin.errors import StateError
from axistwin.kernel.effects import Trace
from axistwin.kernel.time import NS_PER_MS, NS_PER_S
from axistwin.runtime import can_network
from axistwin.runtime.bus import TRANSCRIPT_FRAMES, Bus, Passed
from axistwin.runtime.can_network import MANY_STEPS, CanNetwork
from axistwin.runtime.clock import PacedClock, VirtualClock
from axistwin.runtime.simulation import Station
from axistwin.runtime.twin import Twin
from axistwin.wire.can_frame import CanFrame, wire_bits

READ = CanFrame(0x601, bytes.fromhex("4000200000000000"))
BIT_NS = 8000


def download(index: int, value: int = 0) -> CanFrame:
    """A request to module 1."""
    return CanFrame(0x601, bytes((0x23, index, 0x20, 0)) + value.to_bytes(4, "big"))


class Rig:
    """A bus with started modules, in virtual time unless a speed is given."""

    def __init__(self, *addresses: int, speed: float | None = None) -> None:
        modules: list[Any] = [MacCan(each) for each in addresses or (1,)]
        self.slots = [SpySlot() for _ in modules]
        stations = []
        for module, slot in zip(modules, self.slots, strict=True):
            slot.cells.update(module.cells(0))
            stations.append(Station(f"mac23-can:{module.address}", "mac23-can", module, slot))
        self.clock = VirtualClock() if speed is None else PacedClock(speed)
        network = CanNetwork(modules, bitrate=125_000)
        self.bus = Bus(network, self.clock, SpyStorage(), stations, explain=explain_frame)

    def ask(self, port: int, frame: CanFrame) -> str:
        """Send, and wait for one frame."""
        self.bus.send(port, frame)
        self.bus.wait(self.bus.sync() + NS_PER_S, port)
        (arrival,) = self.bus.receive(port)
        return str(arrival.frame)


@pytest.fixture
def rig() -> Rig:
    """With the defaults."""
    return Rig()


def test_time_stands_still_while_nobody_waits(rig: Rig) -> None:
    """Sending and receiving move none; waiting ends when something is complete."""
    port = rig.bus.attach()
    rig.bus.send(port, READ)
    assert rig.bus.receive(port) == []
    assert rig.bus.backlog(port) == 1
    assert rig.clock.now_ns() == 0
    now = rig.bus.wait(NS_PER_S, port)
    ((end_ns, frame, _),) = rig.bus.receive(port)
    assert now == end_ns == rig.clock.now_ns()
    assert frame.identifier == 0x581
    assert rig.bus.backlog(port) == 0


def test_waiting_for_ever_ends_when_nothing_will_happen(rig: Rig) -> None:
    """As long as something will, it is waited for."""
    port = rig.bus.attach()
    assert rig.bus.wait(None, port) == 10 * NS_PER_S + wire_bits(CanFrame(0x81, bytes(8))) * BIT_NS
    assert len(rig.bus.receive(port)) == 1
    rig.bus.twins[0].power_off()
    before = rig.bus.sync()
    assert rig.bus.next_event_ns() is None
    assert rig.bus.wait(None, port) == before


def test_what_is_stored_is_on_disk_before_its_reply_can_be_read(rig: Rig) -> None:
    """The write happens when the request is complete; the reply comes later."""
    port = rig.bus.attach()
    rig.bus.send(port, download(0x0D, 0x1234))
    rig.bus.advance(wire_bits(download(0x0D, 0x1234)) * BIT_NS)
    ((cells, durable),) = rig.slots[0].writes
    assert durable
    assert 0x1234 in cells.values()
    assert rig.bus.receive(port) == []
    rig.bus.advance(NS_PER_MS * 10)
    assert [str(each.frame) for each in rig.bus.receive(port)] == ["581#600D200000000000"]


def test_what_cannot_be_stored_is_never_acknowledged(rig: Rig) -> None:
    """The error is raised again and again; nothing can be read."""
    port = rig.bus.attach()
    rig.slots[0].fail = True
    rig.bus.send(port, download(0x0D, 0x1234))
    for _ in range(2):
        with pytest.raises(StateError, match="disk full"):
            rig.bus.wait(NS_PER_S, port)
        with pytest.raises(StateError, match="disk full"):
            rig.bus.receive(port)


def test_what_a_host_is_told_of_a_moving_axis_outlives_a_kill(rig: Rig) -> None:
    """The position is saved before a frame can be read."""
    port = rig.bus.attach()
    assert rig.ask(port, download(0x15, 0x0320)).startswith("581#60")
    rig.bus.advance(NS_PER_S)
    rig.slots[0].writes.clear()
    position = int(rig.ask(port, READ)[-8:], 16)
    assert position > 0
    (cells, durable) = rig.slots[0].writes[-1]
    assert cells["position"] >= position
    assert not durable
    rig.bus.advance(NS_PER_S)
    rig.bus.close()
    assert rig.slots[0].writes[-1][1]


def test_ports_come_and_go(rig: Rig) -> None:
    """Each hears what happens while it is there; the counters of a lone one tell."""
    first = rig.bus.attach(hears_own=True, hears_errors=True)
    rig.ask(first, READ)
    assert rig.bus.dropped(first) == 0
    assert rig.bus.controller(first) == "active"
    rig.bus.twins[0].power_off()
    rig.bus.send(first, READ)
    rig.bus.advance(NS_PER_S)
    assert rig.bus.controller(first) == "passive"
    assert rig.bus.counters(first) == (128, 0)
    arrivals, reports = rig.bus.receive_all(first)
    assert arrivals == []
    assert rig.bus.receive_all(first) == ([], [])
    assert [type(each).__name__ for each in reports].count("Change") == 1
    assert len(reports) == 18
    rig.bus.purge_output(first)
    rig.bus.advance(NS_PER_S)
    second = rig.bus.attach()
    rig.bus.detach(first)
    rig.bus.twins[0].power_on()
    rig.bus.advance(3 * NS_PER_S)
    assert "701#00" in [str(each.frame) for each in rig.bus.receive(second)]


def test_a_module_alone_on_the_bus_keeps_one_lifebeat_for_who_comes() -> None:
    """However long nobody acknowledges; from then on they come every ten seconds."""
    bus = build_bus([parse_device("mac23-can:1")], clock=VirtualClock())
    bus.advance(3600 * NS_PER_S)
    port = bus.attach()
    bus.advance(NS_PER_S)
    assert [each.frame.identifier for each in bus.receive(port)] == [0x081]
    bus.advance(30 * NS_PER_S)
    assert [each.frame.identifier for each in bus.receive(port)] == [0x081] * 3


@pytest.mark.strength
def test_time_does_not_run_away_from_who_computes_it() -> None:
    """Lifebeats that come faster than they can be computed slow time down, and end no sync."""
    passed_ns = 0
    clock = PacedClock(1e6, source=lambda: passed_ns)
    heard = 0

    def work(_: Passed) -> None:
        nonlocal passed_ns, heard
        passed_ns += 30_000  # in which three more come
        heard += 1

    bus = build_bus([parse_device("mac23-can:1")], clock=clock)
    bus.subscribe_frames(work)
    bus.attach()
    times = [bus.sync()]
    for _ in range(40):
        passed_ns += 100_000
        heard = 0
        times.append(bus.sync())
        assert heard < 4 * MANY_STEPS
    assert times == sorted(times)
    assert times[-1] > times[-2]


def test_twins_work_on_a_bus_as_on_a_line() -> None:
    """Inputs, supply, load, position, power; traces go to subscribers."""
    rig = Rig(1, 2)
    traces: list[tuple[Twin, Trace]] = []
    rig.bus.subscribe(lambda twin, trace: traces.append((twin, trace)))
    port = rig.bus.attach()
    twin = rig.bus.twins[1]
    assert (twin.name, twin.address, twin.model) == ("mac23-can:2", 2, "mac23-can")
    twin.supply_volts = 11
    rig.bus.advance(10 * NS_PER_MS)
    assert [each.frame.identifier for each in rig.bus.receive(port)] == [0x082]
    twin.push(5)
    assert twin.position == 5
    twin.inputs.reset = True
    assert twin.inputs.reset
    twin.inputs.reset = False
    twin.power_cycle(0.5)
    assert rig.bus.sync() == 510 * NS_PER_MS
    assert {twin for twin, _ in traces} <= {rig.bus.twins[1]}


def test_the_transcript_has_the_last_frames_in_words(rig: Rig) -> None:
    """With who sent them; a recording gets all of them."""
    recorded: list[Passed] = []
    end = rig.bus.subscribe_frames(recorded.append)
    port = rig.bus.attach()
    rig.ask(port, READ)
    lines = rig.bus.render_transcript().splitlines()
    assert [line.split("ms ")[1] for line in lines] == [
        "> 601#4000200000000000  2000h position? -> module 1",
        "< 581#4200200000000000  2000h position = 0 (module 1)",
    ]
    assert [(str(each.frame), each.from_host) for each in recorded] == [
        (str(READ), True),
        ("581#4200200000000000", False),
    ]
    end()
    rig.ask(port, READ)
    assert len(recorded) == 2
    assert len(rig.bus.transcript) == 4


def test_a_long_stretch_of_virtual_time_loses_no_record(monkeypatch: pytest.MonkeyPatch) -> None:
    """More frames than the network keeps reach a recording; the transcript stays bounded."""
    monkeypatch.setattr(can_network, "HEARD_MAX", 64)
    rig = Rig(1, 2, 3)
    recorded: list[Passed] = []
    rig.bus.subscribe_frames(recorded.append)
    rig.bus.advance(5001 * NS_PER_S)
    assert len(recorded) == 3 * 500 > TRANSCRIPT_FRAMES
    assert len(rig.bus.transcript) == TRANSCRIPT_FRAMES


def test_who_keeps_an_alarm_is_told_of_changes(rig: Rig) -> None:
    """Sending, coming and going bring the next event nearer."""
    told: list[int] = []
    rig.bus.on_change(lambda: told.append(1))
    port = rig.bus.attach()
    rig.bus.send(port, READ)
    assert len(told) == 2
    assert rig.bus.next_event_ns() == 0
    rig.bus.sync()
    assert rig.bus.next_event_ns() == wire_bits(READ) * BIT_NS
    rig.bus.detach(port)
    assert len(told) == 3


def test_a_bus_in_real_time_wakes_who_waits() -> None:
    """Another thread's frame ends a wait; so does leaving; ``stop`` is asked."""
    rig = Rig(speed=1.0)
    first, second = rig.bus.attach(), rig.bus.attach()
    heard: list[str] = []

    def listen() -> None:
        while len(heard) < 2:
            rig.bus.wait(rig.bus.sync() + 60 * NS_PER_S, second)
            heard.extend(str(each.frame) for each in rig.bus.receive(second))

    thread = threading.Thread(target=listen)
    thread.start()
    while not rig.bus._sleepers:
        time.sleep(0.001)
    rig.bus.send(first, READ)
    thread.join(10)
    assert not thread.is_alive()
    assert heard == [str(READ), "581#4200200000000000"]
    assert rig.bus.wait(None, first, stop=lambda: True) > 0


def test_a_closed_bus_says_so(rig: Rig) -> None:
    """Closing twice is once."""
    with rig.bus:
        port = rig.bus.attach()
    rig.bus.close()
    with pytest.raises(StateError, match="the bus is closed; build a new one"):
        rig.bus.receive(port)
