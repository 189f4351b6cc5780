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

TIMEOUT_S = 10.0


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


def abort_code(node: Any, index: int, data: bytes) -> int | None:
    """Of a download that is refused; None: it was taken."""
    try:
        node.sdo.download(index, 0, data)
    except SdoAbortedError as error:
        return int(error.code)
    return None


def converse_by_sdo(node: Any) -> None:
    """Objects are written and read; a value that is not allowed is refused."""
    for index in range(0x2000, 0x2008):
        assert len(node.sdo.upload(index, 0)) == 4
    node.sdo.download(0x200C, 0, bytes((0, 0, 0, 0x40)))  # torque
    assert node.sdo.upload(0x2006, 0)[1] == 0x40
    assert abort_code(node, 0x200C, bytes((0, 0, 0, 0x81))) == 0
    node.sdo.download(0x2013, 0, (100).to_bytes(4, "big"))  # go to 100
    until(lambda: node.sdo.upload(0x2000, 0) == (100).to_bytes(4, "big"))


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
    network[1].sdo.RESPONSE_TIMEOUT = 0.05
    try:
        network[1].sdo.upload(0x2000, 0)
    except SdoCommunicationError:
        return
    raise AssertionError("the old address still answers")


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
