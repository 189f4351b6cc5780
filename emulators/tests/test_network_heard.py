"""Letting things happen until the host has heard enough: the same, in fewer steps."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mac_frames import request
from toy_device import LATENCY_NS, ToyDevice

from axistwin.devices.mac.axis.quirks import parse_quirks
from axistwin.devices.mac.serial.device import MacSerial
from axistwin.runtime.network import SerialNetwork
from axistwin.wire.framing import LineFormat

BYTE_NS = LineFormat(38400).span_ns(1)
FOREVER = 1 << 62
PACED = pytest.mark.parametrize("paced", [True, False])


def network(count: int, *, paced: bool) -> SerialNetwork:
    """A line of that many modules."""
    quirks = parse_quirks({"factory_ramp": 0})
    devices = [MacSerial("mac23", address, quirks=quirks) for address in range(count)]
    return SerialNetwork(devices, paced=paced)


def heard_in_steps(line: SerialNetwork, count: int, limit_ns: int) -> int:
    """Event by event, as a server does it: the time when the host has ``count`` bytes."""
    while line.host_available < count and line.now_ns < limit_ns:
        due_ns = line.next_event(count - line.host_available)
        line.run_until(limit_ns if due_ns is None else min(limit_ns, due_ns))
    return line.now_ns


@settings(max_examples=60)
@given(
    st.integers(1, 3),
    st.booleans(),
    st.lists(
        st.tuples(
            st.sampled_from([0x20, 0x26, 0x10, 0x15, 0x17, 0x99]),
            st.integers(0, 2),
            st.integers(1, 50),
            st.integers(0, 40_000_000),
        ),
        min_size=1,
        max_size=6,
    ),
)
def test_the_host_hears_the_same_at_the_same_time(
    count: int, paced: bool, exchanges: list[tuple[int, int, int, int]]
) -> None:
    """Whatever is asked, of whom, however many bytes are waited for and how long."""
    stepped, batched = network(count, paced=paced), network(count, paced=paced)
    for index, address, wanted, patience_ns in exchanges:
        limit_ns = stepped.now_ns + patience_ns
        for line in (stepped, batched):
            line.host_send(request(index, 0x320, address=address))
        reached_ns = heard_in_steps(stepped, wanted, limit_ns)
        while batched.host_available < wanted and batched.now_ns < limit_ns:
            batched.run_until(batched.run_until_heard(wanted, limit_ns))
            batched.take_effects()
        stepped.take_effects()
        assert batched.now_ns == reached_ns
        assert batched.host_available == stepped.host_available
        assert batched.host_take(wanted) == stepped.host_take(wanted)


@PACED
def test_it_stops_for_what_is_to_be_stored(paced: bool) -> None:
    """Nothing later happens before a store is performed: the reply of W is not heard yet."""
    line = SerialNetwork([ToyDevice()], paced=paced)
    line.host_send(b"W")
    sent_ns = BYTE_NS if paced else 0
    assert line.run_until_heard(1, FOREVER) == sent_ns
    assert (line.has_effects, line.host_available) == (True, 0)
    line.take_effects()
    arrived_ns = sent_ns + LATENCY_NS + (BYTE_NS if paced else 0)
    assert line.run_until_heard(1, FOREVER) == arrived_ns
    assert line.host_take() == b"K"


@PACED
def test_without_a_limit_it_ends_when_nothing_can_happen(paced: bool) -> None:
    """One byte came of five: the time is that of the last event, and then it stands."""
    line = SerialNetwork([ToyDevice()], paced=paced)
    line.host_send(b"T")
    line.run_until_heard(5, None)
    line.take_effects()
    end_ns = LATENCY_NS + (2 * BYTE_NS if paced else 0)
    assert line.run_until_heard(5, None) == end_ns
    assert line.run_until_heard(5, None) == end_ns
    assert line.host_take() == b"t"
