"""One complete exchange of each command, byte for byte (ledger §2.3 and §2.5)."""

import pytest
from msc_bench import ACK, NAK, MscBench, word

from axistwin.devices.msc.packets import is_sum_right, packet

VALUES_1_TO_32 = "".join(f" 00 00 00 {value:02X}" for value in range(1, 33))

EXCHANGES = {
    "BREAD 2048": (
        "02 01 00 08 00 00 42 52 45 41 44 2C 08 00 01 9B",
        f"02 01 00 86 00 00 42 52 45 41 44 2C{VALUES_1_TO_32} 04 21",
    ),
    "BWRITE 2048": (
        f"02 01 00 89 00 00 42 57 52 49 54 45 2C 08 00{VALUES_1_TO_32} 04 9B",
        "",
    ),
    "CFLAG 200": ("02 01 00 08 00 00 43 46 4C 41 47 2C 00 C8 02 5A", ""),
    "DREAD 2008": (
        "02 01 00 08 00 00 44 52 45 41 44 2C 07 D8 02 74",
        "02 01 00 0A 00 00 44 52 45 41 44 2C 00 00 04 D2 02 6D",
    ),
    "DWRITE 2008, 1234": (
        "02 01 00 0D 00 00 44 57 52 49 54 45 2C 07 D8 00 00 04 D2 03 BE",
        "",
    ),
    "RFLAG 200": (
        "02 01 00 08 00 00 52 46 4C 41 47 2C 00 C8 02 69",
        "02 01 00 08 00 00 52 46 4C 41 47 2C 00 01 01 A2",
    ),
    "RFLAGS": (
        "02 01 00 07 00 00 52 46 4C 41 47 53 2C 01 F3",
        (
            "02 01 00 27 00 00 52 46 4C 41 47 53 2C 02 02 00 40 00 00 00 00 00 00 00 00 10 00 00 "
            "00 08 00 00 00 00 00 00 00 00 01 00 00 00 00 00 40 02 B0"
        ),
    ),
    "RQSTAT": (
        "02 01 00 07 00 00 52 51 53 54 41 54 2C 02 13",
        "02 01 00 0F 00 00 52 51 53 54 41 54 2C 00 41 00 00 00 00 00 00 02 5C",
    ),
    "SFLAG 200": ("02 01 00 08 00 00 53 46 4C 41 47 2C 00 C8 02 6A", ""),
}


def prepared(*units: int) -> MscBench:
    """A unit in the state that ledger §2.5 names."""
    bench = MscBench(*units)
    for number in (1, 9, 30, 100, 131, 200, 254):
        bench.perform(bench.device.set_flag(bench.now, number, on=True))
    bench.perform(bench.device.set_variable(bench.now, 2008, 1234))
    for value in range(1, 33):
        bench.perform(bench.device.set_variable(bench.now, 2044 + 4 * value, value))
    for bit in (0, 6):
        bench.perform(bench.device.set_status(bench.now, bit, on=True))
    return bench


@pytest.mark.parametrize("name", EXCHANGES)
def test_each_command_is_answered_byte_for_byte(name: str) -> None:
    """The ACK, the reply if there is one, and nothing after the host's ACK."""
    request, reply = (bytes.fromhex(text) for text in EXCHANGES[name])
    bench = prepared()
    assert bench.tell(request) == ACK + reply
    assert bench.tell(ACK, 20_000) == b""


def test_the_second_dread_of_the_ledger() -> None:
    """The same address holding -1."""
    bench = prepared()
    bench.perform(bench.device.set_variable(bench.now, 2008, -1))
    assert bench.tell(bytes.fromhex(EXCHANGES["DREAD 2008"][0])) == ACK + bytes.fromhex(
        "02 01 00 0A 00 00 44 52 45 41 44 2C FF FF FF FF 05 93"
    )


def test_unit_6_on_rs485() -> None:
    """The reply carries the number of the unit that answers (MSC-PKT-18)."""
    bench = prepared(6)
    assert bench.device.is_full_duplex is False
    assert bench.tell(bytes.fromhex("02 06 00 08 00 00 44 52 45 41 44 2C 07 D8 02 79")) == (
        ACK + bytes.fromhex("02 06 00 0A 00 00 44 52 45 41 44 2C 00 00 04 D2 02 72")
    )
    assert bench.tell(ACK, 20_000) == b""


def test_a_refused_packet_its_repeat_and_a_reply_refused_once() -> None:
    """The longest exchange of the ledger; the repeat has no ACK before it (MSC-LNK-10)."""
    bench = prepared()
    good, reply = (bytes.fromhex(text) for text in EXCHANGES["DREAD 2008"])
    assert bench.tell(good[:-1] + b"\x75") == NAK
    assert bench.tell(good) == ACK + reply
    assert bench.tell(NAK) == reply
    assert bench.tell(ACK, 20_000) == b""


def test_the_worked_example_stores_what_it_says() -> None:
    """1234 at 2008 (MSC-PKT-21, MSC-DWRITE-02); the sum is 958."""
    bench = MscBench()
    example = bytes.fromhex(EXCHANGES["DWRITE 2008, 1234"][0])
    assert int.from_bytes(example[-2:], "big") == 958
    assert bench.tell(example) == ACK
    assert bench.device.cells(bench.now)["data_07D8"] == 1234


@pytest.mark.parametrize("name", EXCHANGES)
def test_our_packets_are_those_of_the_ledger(name: str) -> None:
    """Length, sum and byte order of what we build; one bit more or less makes a sum wrong."""
    for text in EXCHANGES[name]:
        raw = bytes.fromhex(text)
        if not raw:
            continue
        assert packet(raw[1], raw[6:-2], int.from_bytes(raw[4:6], "big")) == raw
        assert is_sum_right(raw)
        for place in range(1, len(raw)):
            for bit in range(8):
                changed = bytearray(raw)
                changed[place] ^= 1 << bit
                assert not is_sum_right(bytes(changed))


def test_the_block_number_of_a_request_has_no_effect() -> None:
    """It is in the sum, and the reply carries 0 (MSC-PKT-09, MSC-PKT-19)."""
    bench = MscBench()
    plain = bench.ask(packet(1, b"DREAD," + word(8)))
    for block in (1, 0x1234, 0xFFFF):
        assert bench.ask(packet(1, b"DREAD," + word(8), block)) == plain
