"""Devices that share what they have heard behave as if each were asked by itself."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mac_frames import request

from axistwin.devices.mac.axis.quirks import parse_quirks
from axistwin.devices.mac.serial.device import MacSerial
from axistwin.runtime.audience import Audience
from axistwin.runtime.network import SerialNetwork
from axistwin.wire.framing import LineFormat

ADDRESSES = (0, 5, 5, 7, 9, 0x7F)
QUIRKS: tuple[dict[str, Any], ...] = (
    {},
    {"rx_during_xoff": "kept", "factory_ramp": 0},
    {"nack_scope": "any"},
    {"general_reply_policy": "all", "addr_effective": "at_once"},
    {"lowercase_hex": "accept", "boot_time_ms": 30, "bad_frame_reply": "nack"},
)


class AskedByItself(Audience):
    """Nobody ever shares anything."""

    def come_back(self, index: int, now: int) -> None:
        """Never."""


def line_of(
    quirks: dict[str, Any], *, is_shared: bool, addresses: tuple[int, ...] = ADDRESSES
) -> SerialNetwork:
    """Modules at those addresses."""
    parsed = parse_quirks(quirks)
    devices = [
        MacSerial("mac23", address, quirks=parsed, skew_ns=1000 * place, alone=False)
        for place, address in enumerate(addresses)
    ]
    network = SerialNetwork(devices)
    if not is_shared:
        network._audience = AskedByItself(network.devices)
    return network


FRAMES = st.builds(
    lambda index, number, address: request(index, number, address=address),
    st.sampled_from([0x20, 0x20, 0x20, 0x13, 0x15, 0x0D, 0x08, 0x1B, 0x00, 0x26, 0x99]),
    st.sampled_from([0, 5, 9, 800, 3, 0xFFFFFF00]),
    st.sampled_from([0, 5, 5, 7, 9, 0x7F, 0x33, 0xFF]),
)
SPOILT = st.builds(
    lambda frame, at, size: (frame[:at] + b"a" + frame[at + 1 :])[:size] or b"a",
    FRAMES,
    st.integers(0, 20),
    st.integers(1, 21),
)
SENT = st.one_of(
    FRAMES, FRAMES, SPOILT, st.binary(max_size=30), st.builds(bytes.__add__, FRAMES, FRAMES)
)
STEPS = st.tuples(
    st.sampled_from(["send", "send", "send", "ask", "ask", "power", "rate", "break", "listen"]),
    SENT,
    st.integers(0, len(ADDRESSES) - 1),
    st.sampled_from([0, 10_000, 3_000_000, 12_000_000, 30_000_000, 2_500_000_000]),
)


def do(network: SerialNetwork, step: tuple[str, bytes, int, int]) -> object:
    """One step, and what is seen of it."""
    what, data, index, pause_ns = step
    answer: object = None
    if what == "send":
        network.host_send(data)
    elif what == "ask" and data:
        answer = network.host_ask(data, 21, network.now_ns + 20_000_000)
        if answer is None and network.asked_ns is None:
            network.host_send(data)
    elif what == "power":
        if network.devices[index].line_format.baud and index % 2:
            network.power_off(index)
        else:
            network.power_on(index)
    elif what == "rate":
        network.host_format = LineFormat((38400, 19200, 38400, 115200, 9600, 38400)[index])
    elif what == "break":
        network.send_break(1 + pause_ns // 4)
    network.run_until(network.now_ns + pause_ns)
    devices: Any = network.devices
    return (
        answer,
        network.now_ns,
        network.host_take(),
        network.take_effects(),
        [dict(each.describe(network.now_ns)) for each in devices],
        [each.next_event() for each in devices],
        [each._deaf_until for each in devices],
        [each.reception.partial for each in devices],
    )


@pytest.mark.strength
@settings(max_examples=200)
@given(st.sampled_from(QUIRKS), st.lists(STEPS, min_size=1, max_size=14))
def test_sharing_what_was_heard_changes_nothing(
    quirks: dict[str, Any], steps: list[tuple[str, bytes, int, int]]
) -> None:
    """Polls, broadcasts, garbage, wrong rates, supplies, new addresses: all is the same."""
    one, other = (line_of(quirks, is_shared=shared) for shared in (True, False))
    for step in steps:
        assert do(one, step) == do(other, step)


@pytest.mark.parametrize("short_way", [True, False])
def test_who_is_not_addressed_is_not_asked(
    short_way: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 127 modules only those are that are spoken to now, or were just before."""
    network = line_of({}, is_shared=True, addresses=tuple(range(127)))
    asked: list[int] = []
    receive = MacSerial.receive

    def noting(device: MacSerial, chunk: Any) -> Any:
        asked.append(device.address)
        return receive(device, chunk)

    monkeypatch.setattr(MacSerial, "receive", noting)
    for address in (3, 3, 77, 126, 200):
        del asked[:]
        if short_way:
            answer = network.host_ask(
                request(0x20, address=address), 21, network.now_ns + 50_000_000
            )
            assert (answer is not None and len(answer) == 21) is (address < 127)
        else:
            network.host_send(request(0x20, address=address))
            network.run_until(network.now_ns + 50_000_000)
            assert len(network.host_take()) == (21 if address < 127 else 0)
        if address != 3:
            assert len(asked) <= 4
