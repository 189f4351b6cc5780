"""The serial face: frames, replies, addresses, rates, restarts (ledger §2, §3.1, §3.2, §6)."""

import pytest
from mac_bench import ACCEPTED, MS, NACK, REFUSED, SILENCE, MacBench, S

from axistwin.devices.mac.serial.device import MacSerial
from axistwin.devices.mac.serial.framing import checksum, request
from axistwin.errors import UsageError
from axistwin.kernel.effects import Store, Transmit
from axistwin.wire.framing import Chunk, LineFormat

EXAMPLE_15H = bytes.fromhex("02 30 31 34 30 30 31 35 30 30 30 30 30 30 30 33 32 30 41 42 03")
EXAMPLE_20H = bytes.fromhex("02 30 31 34 30 30 32 30 30 30 30 30 30 30 30 30 30 30 41 32 03")
ANSWER_20H = bytes.fromhex("06 13 02 30 31 31 30 30 30 30 30 30 30 30 30 30 30 31 30 03 1A")


def with_sum(body: bytes) -> bytes:
    """A frame around the 14 characters aa..pppppppp."""
    assert len(body) == 14
    return b"\x02014" + body + checksum(body) + b"\x03"


@pytest.fixture
def bench() -> MacBench:
    """A MAC23 at rest, with the defaults."""
    return MacBench()


# ---- worked examples (§2.5) ----


def test_the_manuals_velocity_frame_is_accepted_byte_for_byte() -> None:
    """The corrected example frame turns the motor at 800 ticks per increment, clockwise."""
    bench = MacBench(factory_ramp=0)
    assert bench.send(EXAMPLE_15H) == ACCEPTED
    assert bench.position_at(bench.etx_ns + 10_000 * 800 * 125) == 10_000


def test_the_position_query_is_answered_byte_for_byte() -> None:
    """Position 0 of module 00, as the ledger writes it out."""
    assert MacBench().send(EXAMPLE_20H) == ANSWER_20H


@pytest.mark.parametrize(("address", "index", "digits"), [(0, 0x16, b"C8"), (1, 0x1E, b"D8")])
def test_the_segment_examples_have_the_sums_of_the_ledger(
    address: int, index: int, digits: bytes
) -> None:
    """1000 steps at 4096 ticks last 512 ms, moving or not."""
    frame = request(address, index, 0x03E81000)
    assert frame[18:20] == digits
    bench = MacBench(address=address)
    assert bench.send(frame) == ACCEPTED
    assert bench.settle() == bench.etx_ns + 512 * MS
    assert bench.position() == (1000 if index == 0x16 else 0)


# ---- frames (§3.1) ----


def test_a_negative_answer_comes_back_as_eight_digits() -> None:
    """-1000 is FFFFFC18."""
    bench = MacBench(cells={"position": -1000})
    assert bench.ask(0x20)[9:17] == b"FFFFFC18"


@pytest.mark.parametrize("noise", [b"\x00\xff\x1a\x06", b"\x03", b"014", b"\x02", b"\x02014000"])
def test_noise_and_half_frames_before_a_frame_do_not_disturb_it(noise: bytes) -> None:
    """Bytes outside a frame are ignored, Stx restarts reception (MACS-FRAME-10, -11)."""
    assert MacBench().send(noise + EXAMPLE_20H) == ANSWER_20H


@pytest.mark.parametrize(
    "frame",
    [
        EXAMPLE_20H[:3] + b"5" + EXAMPLE_20H[4:],
        EXAMPLE_20H[:20] + b"\x04",
        EXAMPLE_20H[:20],
        EXAMPLE_20H[1:],
    ],
    ids=["length field", "no Etx", "short", "no Stx"],
)
def test_a_malformed_frame_gets_no_reply_and_the_next_one_does(
    bench: MacBench, frame: bytes
) -> None:
    """Dropped without a byte (MACS-FRAME-12)."""
    assert bench.send(frame) == SILENCE
    assert bench.send(EXAMPLE_20H) == ANSWER_20H


def test_characters_may_come_hours_apart(bench: MacBench) -> None:
    """There is no inter-character time limit (MACS-FRAME-14)."""
    for byte in EXAMPLE_20H[:-1]:
        assert bench.send(bytes((byte,))) == SILENCE
        bench.advance(3600 * S)
    assert bench.send(EXAMPLE_20H[-1:]) == ANSWER_20H


@pytest.mark.parametrize(
    ("body", "reply"),
    [
        (b"000C00000000G0", REFUSED),
        (b"000C00 0000040"[:14], ACCEPTED),
        (b"000CXXXXXXXX40", ACCEPTED),
        (b"00ZZ0000000000", REFUSED),
        (b"0013000000+100", REFUSED),
        (b"00130000001_00", REFUSED),
        (b"0028G000000000", REFUSED),
        (b"ZZ200000000000", SILENCE),
        (b"0013000000000a", REFUSED),
    ],
)
def test_a_character_that_is_no_digit_counts_only_where_digits_count(
    body: bytes, reply: bytes
) -> None:
    """Refused in a significant field, unnoticed elsewhere (MACS-FRAME-06, -13)."""
    assert MacBench().send(with_sum(body)) == reply


def test_dont_care_digits_have_no_effect(bench: MacBench) -> None:
    """0Ch with ABCDEF40 reads back 40 (MACS-FRAME-06)."""
    bench.do(0x0C, 0xABCDEF40)
    assert bench.read(0x26) >> 16 & 0xFF == 0x40


# ---- replies (§3.2) ----


@pytest.mark.parametrize("index", [0x13, 0x20, 0x12, 0x00])
def test_a_wrong_sum_is_nacked_before_anything_else_is_judged(bench: MacBench, index: int) -> None:
    """One byte 15h and no effect, for queries and commands alike (MACS-REPLY-02, -04, -06)."""
    bench.do(0x15, 0x320)
    frame = request(0, index, 100)
    wrong = frame[:18] + checksum(frame[4:17] + b"~") + frame[20:]
    assert bench.send(wrong) == NACK
    assert bench.state() == "VE"


def test_a_lower_case_sum_is_a_wrong_sum() -> None:
    """The digits of cc are upper case."""
    frame = EXAMPLE_15H.replace(b"AB", b"ab")
    assert MacBench().send(frame) == NACK


def test_every_query_answers_with_its_last_digit_and_its_address() -> None:
    """Ack Xoff Stx 011 aa i2 dddddddd cc Etx Xon (MACS-REPLY-07..10)."""
    bench = MacBench(address=0x7F)
    for index in range(0x20, 0x2A):
        reply = bench.ask(index)
        assert reply[:9] == b"\x06\x13\x020117F%X" % (index & 0xF)
        assert reply[17:19] == checksum(reply[6:17])
        assert reply[19:] == b"\x03\x1a"


def test_a_motion_is_acknowledged_when_taken_over(bench: MacBench) -> None:
    """The reply to a ten second move comes after the latency (MACS-REPLY-14)."""
    bench.do(0x13, 100_000)
    assert bench.late[-1].start_ns == bench.etx_ns + MS
    assert bench.state() == "PO"


def test_skew_is_part_of_the_reply_latency() -> None:
    """Two modules never answer on the same nanosecond."""
    device = MacSerial("mac23", 0, skew_ns=77)
    chunk = Chunk(0, EXAMPLE_20H, LineFormat(38400))
    (effect,) = device.receive(chunk)
    assert isinstance(effect, Transmit)
    assert effect.start_ns == chunk.arrival_ns(20) + MS + 77


def test_frames_for_other_modules_have_no_effect() -> None:
    """Silence (MACS-REPLY-13)."""
    bench = MacBench(address=5)
    assert bench.ask(0x0B, address=6) == SILENCE
    assert bench.ask(0x15, 0x320, address=0) == SILENCE
    assert bench.state() == "OF"


def test_bytes_during_the_reply_are_lost(bench: MacBench) -> None:
    """A frame sent without waiting for the reply loses its beginning (MACS-REPLY-15)."""
    assert bench.send(EXAMPLE_20H + EXAMPLE_20H) == ANSWER_20H
    assert bench.send(EXAMPLE_20H) == ANSWER_20H


def test_a_frame_right_after_the_reply_is_heard() -> None:
    """Also on a line without pacing, where nothing takes time."""
    device = MacSerial("mac23", 0)
    now = S
    for _ in range(3):
        (effect,) = device.receive(Chunk(now, EXAMPLE_20H, None))
        assert isinstance(effect, Transmit)
        assert effect.data == ANSWER_20H
        now = effect.start_ns


def test_nothing_is_sent_unasked() -> None:
    """Not at power-up, not at the end of a motion, not on a fault (MACS-REPLY-12)."""
    bench = MacBench(started=False)
    bench.advance(3 * S)
    bench.do(0x13, 1000)
    sent = len(bench.late)
    bench.settle()
    bench.take(bench.device.set_temperature(bench.now, 120_000))
    bench.advance(60 * S)
    assert len(bench.late) == sent


# ---- general address (§6) ----


def test_a_general_frame_is_executed_by_all_and_answered_by_module_00() -> None:
    """MACS-MULTI-02, -03; the answer's address is as sent (MACS-AMB-17)."""
    zero, five = MacBench(address=0), MacBench(address=5)
    assert zero.ask(0x13, 50, address=0xFF) == ACCEPTED
    assert five.ask(0x13, 50, address=0xFF) == SILENCE
    zero.settle()
    five.settle()
    assert zero.position() == five.position() == 50
    assert zero.ask(0x20, address=0xFF)[6:8] == b"FF"
    assert five.ask(0x20, address=0xFF) == SILENCE


def test_a_wrong_sum_to_all_is_nacked_by_module_00_only() -> None:
    """MACS-AMB-19."""
    wrong = EXAMPLE_20H[:4] + b"FF" + EXAMPLE_20H[6:]
    assert MacBench(address=0).send(wrong) == NACK
    assert MacBench(address=5).send(wrong) == SILENCE


# ---- address and rate (08h, 1Bh) ----


def test_a_programmed_address_is_used_from_the_next_frame_on_and_kept(bench: MacBench) -> None:
    """MACS-CMD-08-01, -02: stored before the acknowledgement."""
    assert bench.ask(0x08, 0x2A, address=0xFF) == ACCEPTED
    assert bench.effects[-2] == Store((("address", 0x2A),))
    assert bench.ask(0x20) == SILENCE
    assert bench.ask(0x20, address=0x2A)[6:8] == b"2A"
    bench.power_cycle()
    assert bench.ask(0x20, address=0x2A)[6:8] == b"2A"


@pytest.mark.parametrize("address", [0x80, 0xFF])
def test_addresses_beyond_7f_are_refused(bench: MacBench, address: int) -> None:
    """MACS-CMD-08-03."""
    assert bench.ask(0x08, address, address=0xFF) == REFUSED
    assert bench.read(0x20) == 0


def test_a_module_that_is_not_00_takes_its_new_address_mutely() -> None:
    """Module 00 alone replies to FF, whatever the command."""
    bench = MacBench(address=9)
    assert bench.ask(0x08, 3, address=0xFF) == SILENCE
    assert len(bench.ask(0x20, address=3)) == 21


@pytest.mark.parametrize(("code", "baud"), [(1, 9600), (2, 19200), (3, 38400)])
def test_a_new_rate_holds_after_its_own_reply_and_two_seconds(
    bench: MacBench, code: int, baud: int
) -> None:
    """MACS-CMD-1B-01: acknowledged at the old rate, then restart, kept over power-off."""
    old = bench.device.line_format
    bench.do(0x1B, code)
    assert bench.late[-1].start_ns + old.span_ns(3) == bench.now
    assert bench.device.line_format.baud == baud
    assert bench.state() == "BT"
    bench.advance(2 * S - 1 - LineFormat(baud).span_ns(1))
    assert bench.ask(0x20) == SILENCE
    assert bench.send(EXAMPLE_20H) == ANSWER_20H
    bench.power_cycle()
    assert bench.device.line_format == LineFormat(baud)
    assert bench.send(EXAMPLE_20H) == ANSWER_20H


def test_the_rate_changes_with_the_end_of_the_reply_not_before(bench: MacBench) -> None:
    """Between Etx and the end of the reply the line still runs at the old rate."""
    chunk = Chunk(bench.now, request(0, 0x1B, 1), LineFormat(38400))
    effects = bench.device.receive(chunk)
    assert [type(effect) for effect in effects] == [Store, Transmit]
    due = bench.device.next_event()
    assert due == chunk.arrival_ns(20) + MS + LineFormat(38400).span_ns(3)
    assert bench.device.line_format.baud == 38400
    bench.device.wake(due)
    assert bench.device.line_format.baud == 9600


@pytest.mark.parametrize("code", [0, 4, 0xFF])
def test_other_rate_codes_are_refused(bench: MacBench, code: int) -> None:
    """MACS-CMD-XX-02."""
    bench.refuse(0x1B, code)
    assert bench.state() == "OF"


# ---- users' mistakes ----


@pytest.mark.parametrize("name", ["encoder", "amplifier"])
def test_a_fault_that_the_model_does_not_have_cannot_be_made(bench: MacBench, name: str) -> None:
    """dd of a MAC23 has no bit for it (ledger §5.9)."""
    with pytest.raises(UsageError, match=f"a mac23 has no fault '{name}'; it has: micro_cut"):
        bench.device.set_fault(bench.now, name, True)
    assert bench.read(0x21) == 0


def test_a_reset_input_that_is_not_there_cannot_be_held() -> None:
    """MACS-AMB-67."""
    bench = MacBench(has_reset_input=False)
    with pytest.raises(UsageError, match="has_reset_input"):
        bench.device.set_input(bench.now, "reset", True)
    assert bench.ask(0x20) == ANSWER_20H


def test_unknown_names_are_told_in_one_line_with_the_nearest_one() -> None:
    """Model, address, input and fault."""
    with pytest.raises(UsageError, match="did you mean mac23"):
        MacSerial("mac24")
    with pytest.raises(UsageError, match=r"00h\.\.7Fh"):
        MacSerial("mac23", 0x80)
    with pytest.raises(UsageError, match="did you mean reference"):
        MacSerial("mac23").set_input(0, "referense", True)
    with pytest.raises(UsageError, match="did you mean encoder"):
        MacSerial("mac23").set_fault(0, "encode", True)
