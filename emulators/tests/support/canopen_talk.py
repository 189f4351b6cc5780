"""A program that converses with ``mac23-can:1`` by the ``canopen`` package, from its own process.

    python canopen_talk.py INTERFACE CHANNEL [wait-for-fault]

The module runs twenty times as fast.  With ``wait-for-fault`` it says ``ready for a fault`` and
expects one of the supply, and its end.  Prints ``conversed`` when all was as it should be.
"""

import sys
import time
from collections.abc import Callable
from typing import Any

import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

TIMEOUT_S = 30.0


def until(condition: Callable[[], object]) -> None:
    """Wait for what another thread brings about."""
    end = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < end, "it never came true"
        time.sleep(0.001)


def node_of(network: Any, address: int) -> Any:
    """A node with an empty dictionary."""
    dictionary: Any = canopen.ObjectDictionary
    node = network.add_node(address, dictionary())
    node.sdo.RESPONSE_TIMEOUT = TIMEOUT_S
    return node


def until_at(node: Any, position: bytes) -> None:
    """Wait until the axis is there."""
    until(lambda: node.sdo.upload(0x2000, 0) == position)


def abort_code(node: Any, index: int, data: bytes) -> int | None:
    """Of a download that is refused; None: it was taken."""
    try:
        node.sdo.download(index, 0, data)
    except SdoAbortedError as error:
        return int(error.code)
    return None


# Parameters: what is written to which object, and where which bytes of it are read back.
WRITTEN = (
    (0x2002, "00000001", 0x2006, slice(2, 3), "10"),  # half torque at rest; the stops stay
    (0x2003, "00000000", 0x2006, slice(2, 3), "10"),
    (0x2002, "00000000", 0x2006, slice(2, 3), "00"),
    (0x2007, "00000001", 0x2007, slice(0, 0), ""),  # the reference input: not read back
    (0x2007, "00000000", 0x2007, slice(0, 0), ""),
    (0x2009, "00012345", 0x2002, slice(0, 4), "00012345"),
    (0x200A, "fffedcba", 0x2003, slice(0, 4), "fffedcba"),
    (0x200C, "00000040", 0x2006, slice(1, 2), "40"),
    (0x200D, "00000320", 0x2005, slice(2, 4), "0320"),
    (0x200E, "00000a00", 0x2005, slice(0, 1), "0a"),
    (0x200F, "00000000", 0x2006, slice(0, 1), "00"),
    (0x201C, "00000003", 0x2006, slice(3, 4), "03"),
    (0x201C, "00000000", 0x2006, slice(3, 4), "00"),
    (0x200B, "00000000", 0x2000, slice(0, 4), "00000000"),
)
# Motions: what is written, and the position that then comes.
MOVED = (
    (((0x2019, "00000000"), (0x2013, "00000064")), 100),
    (((0x2014, "00000000"),), 0),
    (((0x2010, "00000000"), (0x2013, "0000000a"), (0x2011, "00000000")), 10),
    (((0x201E, "000a0320"), (0x2016, "fff60320")), 0),
    (((0x2015, "00000320"), (0x2017, "00000000"), (0x2018, "00000000")), None),
    (((0x201A, "00000000"),), None),
)
UNASSIGNED = (0x2004, 0x2005, 0x2006, 0x2008, 0x2012, 0x201B, 0x201D, 0x201F)


def converse_by_sdo(node: Any) -> None:
    """Every object is written and read; what is not there or not allowed is refused."""
    for index in range(0x2000, 0x2008):
        assert len(node.sdo.upload(index, 0)) == 4
    for index, data, shown, place, wanted in WRITTEN:
        node.sdo.download(index, 0, bytes.fromhex(data))
        assert node.sdo.upload(shown, 0)[place] == bytes.fromhex(wanted), hex(index)
    for commands, target in MOVED:
        for index, data in commands:
            node.sdo.download(index, 0, bytes.fromhex(data))
        if target is not None:
            until_at(node, target.to_bytes(4, "big"))
    for index in UNASSIGNED:
        assert abort_code(node, index, bytes(4)) == 0, hex(index)
    assert abort_code(node, 0x200C, bytes((0, 0, 0, 0x81))) == 0


def receive_messages(node: Any, wait_for_fault: bool) -> None:
    """Boot-up after a reset, a lifebeat after ten seconds, an emergency for a fault."""
    node.nmt.timestamp = None
    node.sdo.download(0x2000, 0, bytes(4))
    until(lambda: node.nmt.timestamp)
    count = len(node.emcy.log)
    until(lambda: len(node.emcy.log) > count)
    assert node.emcy.log[-1].code == 0
    if wait_for_fault:
        print("ready for a fault", flush=True)
        until(lambda: node.emcy.active)
        assert [error.code for error in node.emcy.active] == [0x3220]
        until(lambda: not node.emcy.active)


def change_the_address(network: Any) -> None:
    """From 1 to 5 by LSS."""
    lss, moved = network.lss, node_of(network, 5)
    lss.RESPONSE_TIMEOUT = TIMEOUT_S
    lss.send_switch_state_global(lss.CONFIGURATION_STATE)
    lss.configure_node_id(5)
    lss.send_switch_state_global(lss.WAITING_STATE)
    until(lambda: moved.nmt.timestamp)
    assert len(moved.sdo.upload(0x2001, 0)) == 4
    old = network[1]
    old.sdo.RESPONSE_TIMEOUT = 0.05
    try:
        old.sdo.upload(0x2000, 0)
    except SdoCommunicationError:
        pass
    else:
        raise AssertionError("the old address still answers")
    old.nmt.timestamp = None
    moved.sdo.download(0x2001, 0, bytes(4))  # factory values: address 1 again
    until(lambda: old.nmt.timestamp)
    old.sdo.RESPONSE_TIMEOUT = TIMEOUT_S
    assert len(old.sdo.upload(0x2000, 0)) == 4


def main(interface: str, channel: str, *rest: str) -> None:
    """All of it."""
    arguments = {"sleep_after_open": 0} if interface == "slcan" else {}
    network: Any = canopen.Network()
    network.connect(interface=interface, channel=channel, **arguments)
    try:
        node = node_of(network, 1)
        converse_by_sdo(node)
        receive_messages(node, "wait-for-fault" in rest)
        change_the_address(network)
        network.check()
    finally:
        network.disconnect()
    print("conversed", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
