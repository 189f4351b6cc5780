"""The ``canopen`` package, an independent client, converses with twins in this process.

It runs threads of its own, so time is real, and twenty times as fast where the module takes its
time.  Objects are read and written raw: the dictionary is empty, since canopen decodes typed
objects least significant byte first.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import canopen
import pytest
from canopen.lss import LssError
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError
from canopen_talk import until

from axistwin import testing

pytestmark = pytest.mark.system

PATIENCE_S = 20.0


@dataclass
class Conversation:
    """canopen's network, and the twins on it."""

    network: Any  # canopen's annotations are few
    twins: Any

    def node(self, address: int) -> Any:
        """A node with an empty dictionary."""
        if address not in self.network:
            dictionary: Any = canopen.ObjectDictionary
            node = self.network.add_node(address, dictionary())
            node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
        return self.network[address]

    def read(self, index: int, address: int = 1, subindex: int = 0) -> str:
        """The four bytes of an upload, in hex."""
        return str(self.node(address).sdo.upload(index, subindex).hex())

    def write(self, index: int, data: str = "00000000", address: int = 1) -> None:
        """Download four bytes, given in hex."""
        self.node(address).sdo.download(index, 0, bytes.fromhex(data))


@contextmanager
def conversation(*devices: str, **options: Any) -> Iterator[Conversation]:
    """canopen on a bus with ``devices``."""
    with ExitStack() as stack:
        twins: Any = stack.enter_context(testing.start(*devices, **{"time": 20, **options}))
        network = canopen.Network(bus=twins.bus)
        network.NOTIFIER_CYCLE = 0.05  # how long its reader, and so the end, may wait
        network.lss.RESPONSE_TIMEOUT = PATIENCE_S
        network.connect()
        stack.callback(network.disconnect)
        yield Conversation(network, twins)
        network.check()


@pytest.fixture
def talk() -> Iterator[Conversation]:
    """Modules 1 and 2."""
    with conversation("mac23-can:1", "mac23-can:2") as talk:
        yield talk


# ---- objects -------------------------------------------------------------------------------------

WRITTEN_AND_READ = [
    # download, data, upload, what is read then; in an order in which each is accepted
    (0x200B, "00000000", 0x2000, "00000000"),  # position := 0
    (0x200C, "00000040", 0x2006, "0a400000"),  # torque
    (0x2002, "00000001", 0x2006, "0a401000"),  # standby
    (0x2003, "00000009", 0x2006, "0a401900"),  # hardware and software stops
    (0x2009, "00012345", 0x2002, "00012345"),  # superior stop
    (0x200A, "fffedcbb", 0x2003, "fffedcbb"),  # inferior stop
    (0x200D, "00001234", 0x2005, "01001234"),  # period of the maximum speed
    (0x200E, "00000500", 0x2005, "05001234"),  # catch-up
    (0x200F, "00000003", 0x2006, "03401900"),  # ramp
    (0x201C, "00000007", 0x2006, "03401907"),  # tolerance
]
"""Most significant byte first, each field where the manual has it (ledger §2.2)."""


def test_what_is_written_is_read(talk: Conversation) -> None:
    """Every parameter, raw: 23h with four bytes down, 42h up (MACC-SDO-01, -03, -04)."""
    for index, data in ((0x200F, "0000000a"), (0x200E, "00000100"), (0x2002, "00000000")):
        talk.write(index, data)
    for download, data, upload, expected in WRITTEN_AND_READ:
        talk.write(download, data)
        assert talk.read(upload) == expected, f"after {download:04X}h"
    assert talk.read(0x2002, address=2) != "00012345", "module 2 was not spoken to"


@pytest.mark.parametrize("address", [1, 2])
def test_every_object_is_read(talk: Conversation, address: int) -> None:
    """Four bytes each, whatever the sub-index (MACC-SDO-09)."""
    for index in range(0x2000, 0x2008):
        assert len(talk.read(index, address)) == 8
        assert talk.read(index, address) == talk.read(index, address, subindex=3)
    assert int(talk.read(0x2000, address), 16) == 0


def test_every_command_is_taken(talk: Conversation) -> None:
    """Those that move or arm, in an order in which each is accepted."""
    commands = [
        (0x2007, "00000001"),  # reference on
        (0x2019, "00000000"),  # motor on
        (0x2010, "00000000"),  # wait for the synchronisation
        (0x2013, "00000064"),  # preloaded
        (0x2011, "00000000"),  # started
        (0x2018, "00000000"),  # stopped at once
        (0x2014, "00000000"),  # to 0
        (0x2017, "00000000"),  # stopped with its ramp
        (0x2018, "00000000"),
        (0x2015, "00F60320"),  # backwards for ever
        (0x2018, "00000000"),
        (0x2016, "00640190"),  # 100 steps
        (0x201E, "000A0190"),  # a pause
        (0x201A, "00000000"),  # power off
    ]
    for index, data in commands:
        talk.write(index, data)


def test_a_move_ends_where_it_should(talk: Conversation) -> None:
    """Signed, most significant byte first, both ways (trap 1)."""
    for target in (1000, -66):
        talk.write(0x2013, (target & 0xFFFFFFFF).to_bytes(4, "big").hex(), address=2)
        until(lambda: not talk.twins[1].is_moving)
        position = bytes.fromhex(talk.read(0x2000, address=2))
        assert int.from_bytes(position, "big", signed=True) == target
        assert talk.twins[1].position == target


# ---- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "act",
    [
        *(lambda talk, index=index: talk.read(index) for index in (*range(0x2008, 0x2010), 0x1000)),
        *(
            lambda talk, index=index: talk.write(index)
            for index in (0x2004, 0x2012, 0x201F, 0x1017)
        ),
        lambda talk: talk.write(0x200C, "00000081"),
        lambda talk: talk.write(0x200C, "0040"),  # canopen sends two bytes by 2Bh
        lambda talk: talk.node(1).sdo.download(0x200C, 0, bytes(4), force_segment=True),  # 21h
    ],
)
def test_a_refusal_is_an_aborted_transfer(
    talk: Conversation, act: Callable[[Conversation], Any]
) -> None:
    """``SdoAbortedError`` of code 0: 80h with zeros; nothing changes (MACC-SDO-02, -10, -12)."""
    before = talk.read(0x2006)
    with pytest.raises(SdoAbortedError) as caught:
        act(talk)
    assert caught.value.code == 0
    assert talk.read(0x2006) == before


def test_a_motion_command_in_motion_is_refused(talk: Conversation) -> None:
    """And the motion goes on (MACC-STATE-01)."""
    talk.write(0x2015, "0000FFFF")
    with pytest.raises(SdoAbortedError):
        talk.write(0x2013)
    assert talk.twins[0].is_moving


def test_a_module_that_tells_why_is_understood() -> None:
    """The other reading: abort codes of CiA 301 (MACC-AMB-17)."""
    with conversation("mac23-can:1", quirks={"abort_code_form": "code"}) as talk:
        with pytest.raises(SdoAbortedError) as caught:
            talk.read(0x2008)
        assert caught.value.code == 0x06020000
        assert "does not exist" in str(caught.value)


def test_nobody_answers_for_another_module(talk: Conversation) -> None:
    """Silence from address 3 (MACC-ID-02)."""
    node = talk.node(3)
    node.sdo.RESPONSE_TIMEOUT = 0.05
    with pytest.raises(SdoCommunicationError):
        node.sdo.upload(0x2000, 0)


def test_a_search_finds_the_modules(talk: Conversation) -> None:
    """canopen reads 1000h from all addresses; a refusal is an answer too."""
    talk.network.scanner.search()
    until(lambda: len(talk.network.scanner.nodes) == 2)
    assert sorted(talk.network.scanner.nodes) == [1, 2]


# ---- messages ------------------------------------------------------------------------------------


def test_a_boot_up_is_received(talk: Conversation) -> None:
    """After 2000h and after power (MACC-BOOT-01, -02)."""
    nmt = talk.node(2).nmt
    for act in (lambda: talk.write(0x2000, address=2), talk.twins[1].power_cycle):
        nmt.timestamp = None
        act()
        until(lambda: nmt.timestamp)
        assert nmt.state == "PRE-OPERATIONAL"
        assert len(talk.read(0x2000, address=2)) == 8


def test_a_boot_up_can_be_waited_for(talk: Conversation) -> None:
    """``nmt.wait_for_bootup``, two seconds of the module's after its reset."""
    talk.write(0x2000)
    talk.node(1).nmt.wait_for_bootup(PATIENCE_S)


def test_emergencies_are_received(talk: Conversation) -> None:
    """Code, register and status as they appear and go; a lifebeat reads as no error."""
    emcy = talk.node(1).emcy
    talk.twins[0].supply_volts = 11
    until(lambda: emcy.active)
    active = emcy.active[0]  # on a busy machine a lifebeat repeats it before this thread looks
    assert (active.code, active.register) == (0x3220, 0x05)
    assert active.data == bytes.fromhex("2000000000")
    assert active.get_desc() == "Voltage"
    talk.twins[0].supply_volts = 24
    until(lambda: not emcy.active)
    count = len(emcy.log)
    until(lambda: len(emcy.log) > count)
    gone, lifebeat = emcy.log[count - 1 : count + 1]
    assert (lifebeat.code, lifebeat.register, lifebeat.data) == (0, 0, bytes(5))
    assert lifebeat.timestamp - gone.timestamp == pytest.approx(10, abs=1e-5)


@pytest.mark.parametrize("way", ["transmit", "producer"])
def test_sync_starts_preloaded_motions_on_two_modules(talk: Conversation, way: str) -> None:
    """Once, or from canopen's producer; nothing is answered (MACC-SYNC-01, -02)."""
    for address, target in ((1, "00000064"), (2, "ffffff9c")):
        talk.write(0x2010, address=address)
        talk.write(0x2013, target, address=address)
    time.sleep(0.02)  # 0.4 s of the modules'
    assert [twin.position for twin in talk.twins] == [0, 0]
    if way == "transmit":
        talk.network.sync.transmit()
    else:
        talk.network.sync.start(0.01)
    until(lambda: [twin.position for twin in talk.twins] == [100, -100])
    talk.network.sync.stop()
    assert talk.read(0x2000, address=2) == "ffffff9c"


# ---- address procedure ---------------------------------------------------------------------------


@pytest.mark.parametrize("length", [7, 8])
def test_the_address_is_changed_by_lss(length: int) -> None:
    """canopen's calls are the manual's procedure; a reply of 7 bytes is good enough for it too."""
    with conversation("mac23-can:1", quirks={"lmt_dlc": length}) as talk:
        lss, node = talk.network.lss, talk.node(5)
        lss.send_switch_state_global(lss.CONFIGURATION_STATE)
        lss.configure_node_id(5)
        assert talk.read(0x2000) == "00000000", "the old address holds until the end"
        lss.send_switch_state_global(lss.WAITING_STATE)
        until(lambda: node.nmt.timestamp)
        assert talk.read(0x2000, address=5) == "00000000"
        assert talk.twins.address == 5
        talk.node(1).sdo.RESPONSE_TIMEOUT = 0.05
        with pytest.raises(SdoCommunicationError):
            talk.read(0x2000)
        talk.twins.power_cycle()
        node.nmt.timestamp = None
        until(lambda: node.nmt.timestamp)


@pytest.mark.parametrize("address", [0, 128, 255])
def test_a_bad_address_is_an_lss_error(address: int) -> None:
    """Code 1, out of range; the address stays (MACC-LMT-05)."""
    with conversation("mac23-can:1") as talk:
        lss = talk.network.lss
        lss.send_switch_state_global(lss.CONFIGURATION_STATE)
        with pytest.raises(LssError, match="LSS Error: 1"):
            lss.configure_node_id(address)
        lss.send_switch_state_global(lss.WAITING_STATE)
        assert talk.read(0x2000) == "00000000"


def test_services_that_the_manual_does_not_have_are_not_answered() -> None:
    """Inquiry and storing; so canopen's ``store_configuration`` must be left out (MACC-LMT-09)."""
    with conversation("mac23-can:1") as talk:
        lss = talk.network.lss
        lss.RESPONSE_TIMEOUT = 0.05
        lss.send_switch_state_global(lss.CONFIGURATION_STATE)
        for act in (lss.inquire_node_id, lss.store_configuration):
            with pytest.raises(LssError, match="No LSS response"):
                act()
        with pytest.raises(LssError, match="No LSS response"):
            lss.configure_bit_timing(4)


def test_the_reading_of_cia_305_answers_them() -> None:
    """Inquiry, and an address that is stored by 17h only (MACC-AMB-12)."""
    with conversation("mac23-can:9", quirks={"lmt_other": "cia305"}) as talk:
        lss, node = talk.network.lss, talk.node(10)
        lss.send_switch_state_global(lss.CONFIGURATION_STATE)
        assert lss.inquire_node_id() == 9
        lss.configure_node_id(10)
        lss.store_configuration()
        lss.send_switch_state_global(lss.WAITING_STATE)
        until(lambda: node.nmt.timestamp)
        assert talk.read(0x2000, address=10) == "00000000"
