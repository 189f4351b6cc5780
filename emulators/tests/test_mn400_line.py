"""An MN400 on its serial line: packets, errors, addresses, rates, several boards."""

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mn400_bench import Mn400Bench, in_short, packets_in

from axistwin.devices.mn400.link.packets import packet
from axistwin.devices.traces import Refused
from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_MS

POLLED = "81 2A 03 00 81 2F 81 2A 16 00 81 42"


def hexed(data: bytes) -> str:
    """As people read bytes."""
    return data.hex(" ").upper()


def told(data: bytes) -> str:
    """What packets say, in short."""
    return " ".join(map(in_short, packets_in(data)))


def test_a_poll_is_answered_as_in_the_manual() -> None:
    """Byte for byte."""
    assert hexed(Mn400Bench().ask(bytes.fromhex("81 2A 81 2C"))) == POLLED


def test_the_move_of_the_manual_is_answered_at_once() -> None:
    """START and DONE long before its end, which nothing tells (MN4-RSP-05, MN4-RSP-14)."""
    bench = Mn400Bench()
    assert told(bench.ask(bytes.fromhex("81 4D 31 30 30 30 81 10"))) == "S D"
    assert 0 < bench.peek()[0] < 1000
    assert bench.wait(5000) == b""
    assert bench.peek() == [1000, 0, 0, 0]


@pytest.mark.parametrize(
    ("sent", "heard"),
    [
        ("81 2A 81 2D", "81 2A 07 00 81 33"),  # a wrong sum
        ("82 2A 82 2E", ""),  # another board's
        ("82 2A 82 2F", ""),  # likewise, and wrong
        ("00 13 41 2A 81 2A 81 2C", POLLED),  # junk in front
        ("82 4D 31 81 2A 81 2C", POLLED),  # a packet that breaks off
        ("81 81 2A 81 2C", POLLED),  # a doubled opening
        ("81 2A 82 81 2A 81 2C", POLLED),  # another opening inside
        ("81 2A 81 81 2A 81 2C", POLLED),  # an opening in the place of the sum
        ("80 2A 80 2A", POLLED),  # for all boards, answered from its own number
    ],
)
def test_what_is_heard_and_what_is_not(sent: str, heard: str) -> None:
    """Ledger §2.7, §3.1."""
    assert hexed(Mn400Bench().ask(bytes.fromhex(sent))) == heard


def loads() -> list[bytes]:
    """Lines that load counters, one for each possible sum."""
    digits = ["9" * count + str(last) for count in range(30) for last in range(10)]
    lines = [",".join(text[at : at + 9] for at in range(0, len(text), 9)) for text in digits]
    found = {packet(1, b"L" + line.encode())[-1]: b"L" + line.encode() for line in lines}
    assert found.keys() == set(range(128))
    return list(found.values())


def test_every_sum_may_stand_behind_the_closing_address() -> None:
    """Also those that are a command, a code, XON or XOFF (MN4-PKT-04)."""
    bench = Mn400Bench()
    for line in loads():
        bench.say("L0,0,0,0")
        assert told(bench.ask(packet(1, line))) == "S D", line
        assert bench.value("E").split(",")[0] == str(int(line[1:].split(b",")[0]))


def test_requests_back_to_back_are_answered_one_by_one() -> None:
    """In order, no reply inside another (MN4-PKT-08)."""
    bench = Mn400Bench()
    heard = bench.ask(packet(1, b"L7,0,0,0") + packet(1, b"E") + packet(1, b"*"), 200)
    assert told(heard) == "S D S 7,0,0,0 S PR"


def test_gaps_within_a_packet_do_not_break_it() -> None:
    """As long as they are shorter than the time limit (MN4-PKT-09)."""
    bench = Mn400Bench()
    heard = b""
    for byte in packet(1, b"E"):
        bench.send(bytes((byte,)))
        heard += bench.wait(450)
    assert told(heard) == "S 0,0,0,0"


@settings(max_examples=60, derandomize=True)
@given(st.data())
def test_how_a_stream_is_cut_changes_nothing(data: st.DataObject) -> None:
    """Arbitrary stretches below the time limit."""
    stream = b"".join(packet(1, line) for line in (b"L1,2,3,4", b"E", b"X3", b"?"))
    bench, heard, at = Mn400Bench(), b"", 0
    while at < len(stream):
        count = data.draw(st.integers(1, len(stream) - at))
        bench.send(stream[at : at + count])
        heard += bench.wait(data.draw(st.integers(0, 480)))
        at += count
    heard += bench.wait(200)
    assert told(heard) == "S D S 1,2,3,4 S PE S MN400 V 1.08 / 1.04"


@settings(max_examples=60, derandomize=True)
@given(st.binary(max_size=60))
def test_after_any_garbage_and_the_time_limit_a_poll_is_answered(garbage: bytes) -> None:
    """The link is ready again (MN4-ERR-05, MN4-PKT-15)."""
    bench = Mn400Bench()
    harmless = bytes(byte for byte in garbage if byte not in b"=~H(.ZJQ")
    bench.ask(harmless, 1500)
    assert hexed(bench.ask(packet(1, b"*"))) == POLLED


def test_a_packet_that_breaks_off_is_reported_to_its_board_alone() -> None:
    """For another board, or for all, nothing is said (ledger §2.7)."""
    bench = Mn400Bench()
    assert hexed(bench.ask(b"\x81m1", 1000)) == "81 4D 13 00 81 62"
    assert bench.ask(b"\x82M1", 1000) == b""
    assert bench.ask(b"\x80M1", 1000) == b""
    assert bench.say("*") == "S PR"


def test_the_longest_legal_line_is_received() -> None:
    """69 characters (MN4-PKT-13); 200 are not (MN4-PKT-14)."""
    bench = Mn400Bench()
    number = "-2147483647"
    line = f"+{number},{number},{number},{number},-32767,{number},-32767"
    assert len(line) >= 69
    assert bench.say(line, milliseconds=300) == "S PE"
    assert bench.say("L" + "1" * 200, milliseconds=400) == "OV"
    assert bench.value("E") == "0,0,0,0"


def test_why_a_command_is_refused_is_told_to_who_looks_on() -> None:
    """Beside the line: parameters, states, sums, what breaks off; nothing for what is obeyed."""
    bench = Mn400Bench()
    bench.say("M5000", "X3", "J1", "W", "K")
    bench.ask(bytes.fromhex("81 2A 81 2D"))
    bench.ask(b"\x81M1", 1000)
    effects = [effect for _, effect in bench.network.take_effects()]
    assert [effect.reason for effect in effects if isinstance(effect, Refused)] == [
        "refused 'X3': a parameter is malformed or out of range",
        "refused 'J1': not possible in this state: moving",
        "refused 'W': no such command while the board is in this state: moving",
        "refused '*': its checksum is wrong",
        "refused 'M1': the packet broke off",
    ]


# ---- the last message ----


def test_the_last_message_is_sent_again_with_another_first_character() -> None:
    """Without START, as often as wanted, and without doing anything again (MN4-CMD-RTX-01..03)."""
    bench = Mn400Bench()
    assert bench.ask(packet(1, b"&")) == b""
    bench.say("L5,0,0,0")
    assert hexed(bench.ask(packet(1, b"&"))) == "81 26 05 00 81 2D"
    data = packets_in(bench.ask(packet(1, b"E")))[1]
    bench.say("M1000")
    bench.say("E")
    bench.wait(1000)
    again = [bench.ask(packet(1, b"&")) for _ in range(2)]
    assert again[0] == again[1]
    assert again[0][1:2] == b"&"
    assert in_short(again[0]) != in_short(data)
    assert int(in_short(again[0]).split(",")[0]) < 1005


def test_the_last_message_comes_from_the_present_number() -> None:
    """After = 5 (MN4-CMD-RTX-04)."""
    bench = Mn400Bench()
    assert hexed(bench.ask(packet(1, b"=5"))) == "81 3D 03 00 81 42 85 3D 05 00 85 4C"
    assert hexed(bench.ask(packet(5, b"&"))) == "85 26 05 00 85 35"


# ---- address and rate ----


def test_a_board_is_at_its_new_number_at_once_and_until_the_supply_is_cut() -> None:
    """The old one is silent, 0 still works (MN4-CMD-ADDR-03, MN4-CMD-ADDR-04)."""
    bench = Mn400Bench()
    bench.say("=127")
    assert bench.ask(packet(1, b"*"), 3000) == b""
    assert hexed(bench.ask(packet(127, b"*"), 3000))[:5] == "FF 2A"
    assert told(bench.ask(packet(0, b"*"), 3000)) == "S PR"
    bench.power_cycle()
    assert bench.say("*") == "S PR"


def test_the_rate_changes_between_the_two_packets_of_the_reply() -> None:
    """START at 9600, BAUDCHANGEOK at 115200 (MN4-CMD-BAUD-01)."""
    bench = Mn400Bench()
    sent_ns = bench.send(packet(1, b"~4"))
    bench.network.run_until(sent_ns + NS_PER_MS + 6_250_000)
    assert hexed(bench.network.host_take()) == "81 7E 03 00 81 03"
    bench.host_rate(115200)
    assert hexed(bench.wait(5)) == "81 7E 12 00 81 12"
    assert bench.say("*") == "S PR"
    bench.host_rate(9600)
    assert "S PR" not in repr(bench.ask(packet(1, b"*")))
    bench.power_cycle()
    assert bench.say("*") == "S PR"


def test_the_same_rate_may_be_set_again() -> None:
    """Still BAUDCHANGEOK (MN4-CMD-BAUD-04)."""
    assert hexed(Mn400Bench().ask(packet(1, b"~0"))) == "81 7E 03 00 81 03 81 7E 12 00 81 12"


@pytest.mark.parametrize("rate", [9600, 19200, 38400, 57600, 115200])
def test_a_board_is_found_at_each_of_the_five_rates(rate: int) -> None:
    """By a poll for all boards (MN4-DROP-12); without pacing, too."""
    for is_paced in (True, False):
        bench = Mn400Bench(9, paced=is_paced, cells={"baud": rate})
        bench.host_rate(rate)
        heard = bench.ask(packet(0, b"*"), 3000)
        assert hexed(heard[:2]) == "89 2A"
        assert told(heard) == "S PR"


# ---- several boards ----


def test_a_poll_for_all_finds_every_board_without_a_collision() -> None:
    """In the order of their numbers, each in a slot of two packets and 2 ms (MN4-DROP-02, -03)."""
    numbers = (1, 2, 3, 40, 127)
    bench = Mn400Bench(*numbers)
    heard = packets_in(bench.ask(packet(0, b"*"), 127 * 14.5 + 100))
    assert [raw[0] & 0x7F for raw in heard] == [number for number in numbers for _ in range(2)]
    starts = [device.sent[0][0] for device in bench.devices]
    slots = [round((start - starts[0]) / NS_PER_MS / 14.5) for start in starts]
    assert slots == [number - 1 for number in numbers]


@pytest.mark.parametrize(
    ("line", "last"),
    [
        ("E", "0,0,0,0"),
        ("E1", "0,0,0,0,0"),
        ("E00001", "0,0,0,0,0"),
        ("S", "0"),
        ("?", "MN400 V 1.08 / 1.04"),
    ],
)
def test_values_for_all_are_told_in_longer_slots(line: str, last: str) -> None:
    """Every packet is whole (MN4-DROP-04)."""
    bench = Mn400Bench(1, 2, 3)
    heard = packets_in(bench.ask(packet(0, line.encode()), 2000))
    assert [raw[0] & 0x7F for raw in heard] == [1, 1, 2, 2, 3, 3]
    assert {in_short(raw) for raw in heard} == {"S", last}


def test_boards_hold_and_start_together() -> None:
    """H to all, a motion each, K to all; who holds none says so (MN4-DROP-05, MN4-DROP-06)."""
    bench = Mn400Bench(1, 2, 3)
    bench.say("H", number=0, milliseconds=500)
    assert bench.say("M1000,2000,3000,4000", number=1) == "S D"
    assert bench.say("M9000,2500", number=2) == "S D"
    assert bench.say("E", number=1) == "S MP"
    assert bench.say("E", number=3) == "S 0,0,0,0"
    assert bench.say("K", number=0, milliseconds=500) == "S D S D S NP"
    bench.wait(9000)
    where = [list(device.position_at(bench.now)) for device in bench.devices]
    assert where == [[1000, 2000, 3000, 4000], [9000, 2500, 0, 0], [0, 0, 0, 0]]


def spans(bench: Mn400Bench) -> list[tuple[int, int]]:
    """When which packet is on the line, from first to last bit, in the order of time."""
    length = bench.device.line_format.span_ns
    return sorted(
        (start_ns, start_ns + length(len(data)))
        for device in bench.devices
        for start_ns, data in device.sent
    )


def test_held_motions_start_at_one_instant() -> None:
    """When K for all is complete, whatever the boards answer, and when (MN4-CMD-K-03)."""
    bench = Mn400Bench(1, 2, 3)
    bench.say("H", number=0, milliseconds=500)
    assert bench.say("M1000,2000,3000,4000", number=1) == "S D"
    assert bench.say("A-1000,0,-2000,0,1", number=3) == "S D"
    heard_ns = bench.send(packet(0, b"K"))
    bench.wait(200)
    motions = [device.mover.motion_at(bench.now) for device in bench.devices]
    assert [motion and motion.since_ns for motion in motions] == [heard_ns, None, heard_ns]


@pytest.mark.parametrize(
    "line", ["*", "K", "M5", "E", "E1", "N", "S", "?", ":", "[", "/", "R", "X3"]
)
def test_replies_to_a_command_for_all_do_not_overlap(line: str) -> None:
    """On one pair, whatever is answered (MN4-DROP-02, MN4-DROP-04)."""
    bench = Mn400Bench(1, 2, 3)
    bench.ask(packet(0, line.encode()), 60_000)
    on_line = spans(bench)
    assert len(on_line) >= 3
    assert all(before[1] <= after[0] for before, after in pairwise(on_line))


@pytest.mark.parametrize(
    ("payload", "heard"),
    [
        ("4C 31 05 32", "S PE"),  # within a parameter
        ("4C 01 02", "S PE"),  # no board sends two codes
        ("4C 31 06", ""),  # as a board of the same number tells a value
        ("4C 31 06 00", ""),
        ("4C 05 00", ""),  # as it says DONE
        ("4C 05", ""),
    ],
)
def test_a_reply_is_told_from_a_mistake_by_its_form(payload: str, heard: str) -> None:
    """On a shared pair; alone, or for all, only a host can have sent it (MN4-DROP-10)."""
    line = bytes.fromhex(payload)
    assert told(Mn400Bench(1, 2).ask(packet(1, line))) == heard
    assert told(Mn400Bench(1).ask(packet(1, line))) == "S PE"
    assert told(Mn400Bench(1, 2).ask(packet(0, line))) == "S PE S PE"


def test_a_packet_behind_a_rate_that_stays_is_not_lost() -> None:
    """The board goes on hearing while it answers (MN4-PKT-08, MN4-CMD-BAUD-04)."""
    heard = Mn400Bench().ask(packet(1, b"~0") + packet(1, b"*") * 3, 200)
    assert told(heard) == "S BC S PR S PR S PR"


def test_boards_of_one_number_collide_but_do_not_take_replies_for_requests() -> None:
    """What = for all makes of them (MN4-DROP-08, MN4-DROP-10, MN4-PHY-04)."""
    bench = Mn400Bench(1, 2)
    heard = packets_in(bench.ask(packet(0, b"=7"), 500))
    assert [(raw[0] & 0x7F, in_short(raw)) for raw in heard] == [
        (1, "S"),
        (7, "D"),
        (2, "S"),
        (7, "D"),
    ]
    sent = sum(len(device.sent) for device in bench.devices)
    assert len(bench.ask(packet(7, b"?"), 500)) < 2 * (6 + 24)
    assert sum(len(device.sent) for device in bench.devices) == sent + 4


def test_a_board_that_is_alone_on_its_line_has_a_pair_for_each_direction() -> None:
    """Others share one pair."""
    assert Mn400Bench().device.is_full_duplex
    assert not Mn400Bench(1, 2).device.is_full_duplex


@pytest.mark.parametrize("number", [0, 128, -1])
def test_a_board_has_a_number_between_1_and_127(number: int) -> None:
    """Or it is a mistake."""
    with pytest.raises(UsageError, match=r"1\.\.127"):
        Mn400Bench(number)


def test_a_board_with_a_fixed_number_cannot_be_at_another() -> None:
    """The mistake is told at the beginning."""
    with pytest.raises(UsageError, match="address_settable"):
        Mn400Bench(5, address_settable=False)
