"""Devices and host ports on one CAN bus, driven by hand."""

import pytest
from mac_bench import MS, S

from axistwin.devices.mac.can.device import MacCan
from axistwin.kernel.effects import Effect, SendFrame, Store
from axistwin.runtime import can_network
from axistwin.runtime.can_network import CanNetwork
from axistwin.wire.can_bus import Change, Fault
from axistwin.wire.can_frame import INTERMISSION_BITS, CanFrame, wire_bits

BITRATE = 125_000
BIT_NS = 8000
LATENCY_NS = MacCan(1).quirks.reply_latency_us * 1000


def upload(address: int, index: int = 0) -> CanFrame:
    """A request to read an object."""
    return CanFrame(0x600 + address, bytes((0x40, index, 0x20, 0, 0, 0, 0, 0)))


def download(address: int, index: int, value: int = 0) -> CanFrame:
    """A request to execute a command."""
    head = bytes((0x23, index, 0x20, 0))
    return CanFrame(0x600 + address, head + value.to_bytes(4, "big", signed=value < 0))


def network_of(*addresses: int, paced: bool = True) -> CanNetwork:
    """Started modules at 125 kbit/s."""
    return CanNetwork([MacCan(each) for each in addresses], bitrate=BITRATE, paced=paced)


def test_a_request_is_answered_after_frame_latency_frame() -> None:
    """To the nanosecond, and the port does not hear itself."""
    network = network_of(1)
    port = network.attach()
    network.host_send(port, upload(1))
    assert network.host_backlog(port) == 1
    network.run_until(S)
    ((end_ns, frame, is_own),) = network.host_take(port)
    assert str(frame) == "581#4200200000000000"
    assert not is_own
    assert end_ns == (wire_bits(upload(1)) + wire_bits(frame)) * BIT_NS + LATENCY_NS
    assert network.host_take(port) == []
    assert network.host_backlog(port) == 0


def test_without_pacing_only_the_device_takes_time() -> None:
    """Its latency stays."""
    network = network_of(1, paced=False)
    port = network.attach()
    network.host_send(port, upload(1))
    network.run_until(S)
    assert [each.end_ns for each in network.host_take(port)] == [LATENCY_NS]


def test_every_port_hears_all_others_and_itself_if_it_wants() -> None:
    """In one order with the same times."""
    network = network_of(1)
    asks, listens = network.attach(hears_own=True), network.attach()
    network.host_send(asks, upload(1))
    network.run_until(S)
    own, other = network.host_take(asks), network.host_take(listens)
    assert [(each.frame, each.is_own) for each in own] == [
        (upload(1), True),
        (CanFrame(0x581, bytes.fromhex("4200200000000000")), False),
    ]
    assert [each[:2] for each in own] == [each[:2] for each in other]
    assert not any(each.is_own for each in other)


def test_taking_may_be_limited() -> None:
    """The oldest first; the rest stays."""
    network = network_of(1, 2)
    port = network.attach()
    for address in (1, 2):
        network.host_send(port, upload(address))
    network.run_until(S)
    assert [each.frame.identifier for each in network.host_take(port, 1)] == [0x581]
    assert network.host_has_news(port)
    assert [each.frame.identifier for each in network.host_take(port)] == [0x582]
    assert not network.host_has_news(port)


def test_a_port_that_is_not_read_loses_what_comes_last_and_harms_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The loss is counted, for this port alone."""
    monkeypatch.setattr(can_network, "PORT_QUEUE_FRAMES", 3)
    network = network_of(1)
    sleeps, reads = network.attach(), network.attach()
    for index in range(5):
        network.host_send(reads, upload(1, index))
        network.run_until(network.now_ns + 10 * MS)
        assert len(network.host_take(reads)) == 1
    assert network.host_dropped(reads) == 0
    assert network.host_dropped(sleeps) == 7
    assert [each.frame.identifier for each in network.host_take(sleeps)] == [0x601, 0x581, 0x601]


def test_those_who_are_ready_at_the_same_time_compete() -> None:
    """Devices that wake at one nanosecond have all offered before the bus arbitrates (rule 1)."""
    modules = [MacCan(each, started=False) for each in (9, 5, 7)]
    network = CanNetwork(modules, bitrate=BITRATE)
    port = network.attach()
    network.run_until(3 * S)
    heard = network.host_take(port)
    assert [str(each.frame) for each in heard] == ["705#00", "707#00", "709#00"]
    first = 2 * S
    for end_ns, frame, _ in heard:
        first += wire_bits(frame) * BIT_NS
        assert end_ns == first
        first += INTERMISSION_BITS * BIT_NS


def test_waiting_for_a_port_ends_when_it_has_heard() -> None:
    """Not a nanosecond later; in vain, at the limit; for ever, when nothing can happen."""
    network = network_of(1)
    port, silent = network.attach(), network.attach()
    network.host_send(port, upload(1))
    heard_ns = network.run_until_heard(port, S)
    assert heard_ns == network.now_ns == network.host_take(port)[0].end_ns
    assert network.run_until_heard(port, heard_ns + S) == heard_ns + S
    network.host_take(silent)
    network.power_off(0)
    network.run_until(20 * S)
    assert network.next_event() is None
    assert network.run_until_heard(silent, None) == 20 * S


def test_a_wait_stops_where_something_is_to_be_stored() -> None:
    """So that it is on disk before the acknowledgement is heard."""
    network = network_of(1)
    port = network.attach()
    network.host_send(port, download(1, 0x0D, 0x1234))
    stored_ns = network.run_until_heard(port, S)
    assert stored_ns == wire_bits(download(1, 0x0D, 0x1234)) * BIT_NS
    assert not network.host_has_news(port)
    ((index, effect),) = network.take_effects()
    assert index == 0
    assert isinstance(effect, Store)
    assert network.run_until_heard(port, S) > stored_ns
    assert str(network.host_take(port)[0].frame) == "581#600D200000000000"


def test_a_restart_acts_when_its_reply_has_left() -> None:
    """The module learns that its frame was sent (MACC-CMD-00-02)."""
    network = network_of(1)
    port = network.attach()
    network.host_send(port, download(1, 0x00))
    network.run_until(3 * S)
    reply, boot_up = network.host_take(port)
    assert str(reply.frame) == "581#6000200000000000"
    assert str(boot_up.frame) == "701#00"
    assert boot_up.end_ns == reply.end_ns + 2 * S + wire_bits(boot_up.frame) * BIT_NS


def test_a_module_without_supply_is_not_on_the_bus() -> None:
    """Nobody acknowledges then; with supply it does at once, but is deaf for 2 s."""
    network = network_of(1)
    port = network.attach(hears_errors=True)
    network.power_off(0)
    network.host_send(port, upload(1))
    network.run_until(S)
    reports = network.host_take_errors(port)
    assert {each.kind for each in reports if isinstance(each, Fault)} == {"ack"}
    assert [each.state for each in reports if isinstance(each, Change)] == ["passive"]
    assert network.host_state(port) == "passive"
    assert network.host_counters(port) == (128, 0)
    assert network.host_backlog(port) == 1
    network.power_on(0)
    network.run_until(4 * S)
    assert network.host_backlog(port) == 0
    assert network.host_state(port) == "active"
    assert [str(each.frame) for each in network.host_take(port)] == ["701#00"]


def test_what_was_to_be_sent_can_be_taken_back() -> None:
    """A frame under way is finished, or not tried again."""
    network = network_of(1)
    port = network.attach()
    for index in range(3):
        network.host_send(port, upload(1, index))
    network.run_until(BIT_NS)
    network.host_purge_output(port)
    assert network.host_backlog(port) == 1
    network.run_until(S)
    assert [each.frame.data[1] for each in network.host_take(port)] == [0]


def test_ports_come_and_go() -> None:
    """One that left neither hears nor acknowledges; its number is not used again."""
    network = network_of(1)
    first = network.attach()
    network.host_send(first, upload(1))
    network.detach(first)
    second = network.attach()
    assert second != first
    network.run_until(S)
    assert network.host_take(second) == []


def test_two_hosts_that_send_the_same_identifier_disturb_one_another() -> None:
    """Until both are error-passive: 16 bit errors; then one after the other gets through."""
    network = network_of(1)
    ports = [network.attach(hears_errors=True), network.attach()]
    network.host_send(ports[0], upload(1, 0))
    network.host_send(ports[1], upload(1, 1))
    network.run_until(S)
    reports = network.host_take_errors(ports[0])
    faults = [each for each in reports if isinstance(each, Fault)]
    assert [(each.kind, each.senders) for each in faults] == [("bit", tuple(ports))] * 16
    states = [each for each in reports if isinstance(each, Change)]
    assert [(each.station, each.state) for each in states][:1] == [(ports[0], "passive")]
    assert network.host_take_errors(ports[1]) == []
    replies = [each for each in network.host_take(ports[0]) if each.frame.identifier == 0x581]
    assert [each.frame.data[1] for each in replies] == [0, 1]


def test_a_device_is_touched_from_outside() -> None:
    """Its effects go on the bus at once."""
    network = network_of(1)
    port = network.attach()
    network.run_until(MS)
    network.perform(0, network.devices[0].set_supply(MS, 47_000))  # type: ignore[attr-defined]
    network.run_until(5 * MS)
    ((end_ns, frame, _),) = network.host_take(port)
    assert frame.identifier == 0x081
    assert end_ns == MS + wire_bits(frame) * BIT_NS


class Repeater:
    """Answers every frame at once, ``count`` times in all; remembers what it is told."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.done: list[tuple[str, int, str]] = []

    def accepts(self, frame: CanFrame) -> bool:
        """Every frame but one."""
        return frame.identifier != 0x7FF

    def receive(self, frame: CanFrame, end_ns: int) -> list[Effect]:
        """Say it again under another identifier."""
        self.done.append(("heard", end_ns, str(frame)))
        return self._next(end_ns)

    def sent(self, frame: CanFrame, end_ns: int) -> list[Effect]:
        """Learn it."""
        self.done.append(("sent", end_ns, str(frame)))
        return self._next(end_ns)

    def _next(self, now: int) -> list[Effect]:
        self.count -= 1
        return [SendFrame(now, CanFrame(self.count))] if self.count > 0 else []

    def next_event(self) -> None:
        """Never."""

    def wake(self, now: int) -> list[Effect]:
        """Nothing."""
        return []

    power_off = power_on = wake

    def cells(self, now: int) -> dict[str, int]:
        """None."""
        return {}

    def is_moving(self, now: int) -> bool:
        """Never."""
        return False


@pytest.mark.parametrize("paced", [True, False])
def test_a_device_reacts_before_the_bus_goes_on(paced: bool) -> None:
    """Frame by frame, even where frames take no time; what it does not accept it is not given."""
    repeater = Repeater(4)
    network = CanNetwork([repeater], bitrate=BITRATE, paced=paced)
    port = network.attach()
    network.host_send(port, CanFrame(0x7FF))
    network.host_send(port, CanFrame(0x100))
    network.run_until(S)
    assert [(what, frame) for what, _, frame in repeater.done] == [
        ("heard", "100#"),
        ("sent", "003#"),
        ("sent", "002#"),
        ("sent", "001#"),
    ]
    assert len({at for _, at, _ in repeater.done}) == (4 if paced else 1)
    assert [each.frame.identifier for each in network.host_take(port)] == [3, 2, 1]


def test_everything_on_the_bus_is_kept_for_the_record() -> None:
    """Once, with who sent it; until it is taken."""
    network = network_of(1)
    port = network.attach()
    network.host_send(port, upload(1))
    network.run_until(S)
    heard = network.take_heard()
    assert [(str(each.frame), each.senders) for each in heard] == [
        (str(upload(1)), (port,)),
        ("581#4200200000000000", (0,)),
    ]
    assert network.take_heard() == []


@pytest.mark.strength
def test_127_modules_boot_answer_and_move_on_one_bus() -> None:
    """Boot-ups by identifier, one answer each, and all moves end where they should."""
    modules = [MacCan(each, started=False) for each in range(1, 128)]
    network = CanNetwork(modules, bitrate=500_000)
    port = network.attach()
    network.run_until(3 * S)
    assert [each.frame.identifier for each in network.host_take(port)] == list(range(0x701, 0x780))
    for address in range(1, 128):
        network.host_send(port, download(address, 0x13, address))
    network.run_until(8 * S)
    assert {each.frame.data[0] for each in network.host_take(port)} == {0x60}
    for address in range(1, 128):
        network.host_send(port, upload(address))
    network.run_until(9 * S)
    positions = {
        each.frame.identifier - 0x580: int.from_bytes(each.frame.data[4:], "big")
        for each in network.host_take(port)
    }
    assert positions == {address: address for address in range(1, 128)}
