"""The serial face: frames, replies, addresses, rates, restarts (ledger §2, §3.1, §3.2, §6)."""

import random
import time

import pytest
from mac_bench import ACCEPTED, MS, NACK, REFUSED, SILENCE, MacBench, S

from axistwin.devices.mac.framing import checksum, request
from axistwin.devices.mac.serial import MacSerial
from axistwin.errors import UsageError
from axistwin.kernel.effects import Store, Transmit
from axistwin.runtime.network import SerialNetwork
from axistwin.wire.framing import Chunk, LineFormat

EXAMPLE_15H = bytes.fromhex("02 30 31 34 30 30 31 35 30 30 30 30 30 30 30 33 32 30 41 42 03")
EXAMPLE_20H = bytes.fromhex("02 30 31 34 30 30 32 30 30 30 30 30 30 30 30 30 30 30 41 32 03")
ANSWER_20H = bytes.fromhex("06 13 02 30 31 31 30 30 30 30 30 30 30 30 30 30 30 31 30 03 1A")


def with_sum(body: bytes) -> bytes:
    """A frame around the 14 characters aa..pppppppp."""
    assert len(body) == 14
    return b"\x02014" + body + checksum(body) + b"\x03"


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
def test_a_malformed_frame_gets_no_reply_and_the_next_one_does(frame: bytes) -> None:
    """Dropped without a byte (MACS-FRAME-12)."""
    bench = MacBench()
    assert bench.send(frame) == SILENCE
    assert bench.send(EXAMPLE_20H) == ANSWER_20H


def test_characters_may_come_hours_apart() -> None:
    """There is no inter-character time limit (MACS-FRAME-14)."""
    bench = MacBench()
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


def test_dont_care_digits_have_no_effect() -> None:
    """0Ch with ABCDEF40 reads back 40 (MACS-FRAME-06)."""
    bench = MacBench()
    bench.do(0x0C, 0xABCDEF40)
    assert bench.read(0x26) >> 16 & 0xFF == 0x40


# ---- replies (§3.2) ----


@pytest.mark.parametrize("index", [0x13, 0x20, 0x12, 0x00])
def test_a_wrong_sum_is_nacked_before_anything_else_is_judged(index: int) -> None:
    """One byte 15h and no effect, for queries and commands alike (MACS-REPLY-02, -04, -06)."""
    bench = MacBench()
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


def test_a_motion_is_acknowledged_when_taken_over() -> None:
    """The reply to a ten second move comes after the latency (MACS-REPLY-14)."""
    bench = MacBench()
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


def test_bytes_during_the_reply_are_lost() -> None:
    """A frame sent without waiting for the reply loses its beginning (MACS-REPLY-15)."""
    bench = MacBench()
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


def test_a_programmed_address_is_used_from_the_next_frame_on_and_kept() -> None:
    """MACS-CMD-08-01, -02: stored before the acknowledgement."""
    bench = MacBench()
    assert bench.ask(0x08, 0x2A, address=0xFF) == ACCEPTED
    assert bench.effects[-2] == Store((("address", 0x2A),))
    assert bench.ask(0x20) == SILENCE
    assert bench.ask(0x20, address=0x2A)[6:8] == b"2A"
    bench.power_cycle()
    assert bench.ask(0x20, address=0x2A)[6:8] == b"2A"


@pytest.mark.parametrize("address", [0x80, 0xFF])
def test_addresses_beyond_7f_are_refused(address: int) -> None:
    """MACS-CMD-08-03."""
    bench = MacBench()
    assert bench.ask(0x08, address, address=0xFF) == REFUSED
    assert bench.read(0x20) == 0


def test_a_module_that_is_not_00_takes_its_new_address_mutely() -> None:
    """Module 00 alone replies to FF, whatever the command."""
    bench = MacBench(address=9)
    assert bench.ask(0x08, 3, address=0xFF) == SILENCE
    assert len(bench.ask(0x20, address=3)) == 21


@pytest.mark.parametrize(("code", "baud"), [(1, 9600), (2, 19200), (3, 38400)])
def test_a_new_rate_holds_after_its_own_reply_and_two_seconds(code: int, baud: int) -> None:
    """MACS-CMD-1B-01: acknowledged at the old rate, then restart, kept over power-off."""
    bench = MacBench()
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


def test_the_rate_changes_with_the_end_of_the_reply_not_before() -> None:
    """Between Etx and the end of the reply the line still runs at the old rate."""
    bench = MacBench()
    chunk = Chunk(bench.now, request(0, 0x1B, 1), LineFormat(38400))
    effects = bench.device.receive(chunk)
    assert [type(effect) for effect in effects] == [Store, Transmit]
    due = bench.device.next_event()
    assert due == chunk.arrival_ns(20) + MS + LineFormat(38400).span_ns(3)
    assert bench.device.line_format.baud == 38400
    bench.device.wake(due)
    assert bench.device.line_format.baud == 9600


@pytest.mark.parametrize("code", [0, 4, 0xFF])
def test_other_rate_codes_are_refused(code: int) -> None:
    """MACS-CMD-XX-02."""
    bench = MacBench()
    bench.refuse(0x1B, code)
    assert bench.state() == "OF"


# ---- restart (00h, 01h, power, reset input) ----


@pytest.mark.parametrize("index", [0x00, 0x01])
def test_after_a_restart_everything_is_lost_for_two_seconds(index: int) -> None:
    """No reply, no effect, nothing queued; then alive (MACS-CMD-00-02, -01-03)."""
    bench = MacBench()
    bench.do(index)
    end = bench.now + 2 * S
    while bench.now + 25 * MS < end:
        assert bench.ask(0x0C, 0x11) == SILENCE
        bench.advance(20 * MS)
    bench.run_until(end)
    assert bench.read(0x26) >> 16 & 0xFF == 0x60


def test_the_first_byte_heard_after_the_boot_counts() -> None:
    """Deaf for exactly 2.000 s after the reply (MACS-AMB-21)."""
    for early, reply in ((0, ANSWER_20H), (1, SILENCE)):
        bench = MacBench()
        bench.do(0x00)
        bench.advance(2 * S - LineFormat(38400).span_ns(1) - early)
        assert bench.send(EXAMPLE_20H) == reply


def test_00h_drops_motion_and_modes_but_keeps_position_and_parameters() -> None:
    """MACS-CMD-00-01."""
    bench = MacBench()
    bench.do(0x0D, 0x1000)
    bench.do(0x15, 0x320)
    bench.advance(S)
    bench.reset()
    position = bench.position()
    assert position > 1000
    bench.advance(S)
    assert bench.position() == position
    assert bench.state() == "OF"
    assert bench.read(0x25) & 0xFFFF == 0x1000


def test_01h_restores_the_factory_but_not_the_position() -> None:
    """Address 00, 38400 baud, all parameters; the counter stays (MACS-CMD-01-01, -02)."""
    bench = MacBench(address=5, cells={"baud": 9600, "position": 123})
    for index, value in ((0x0C, 0x10), (0x0D, 0x1000), (0x0F, 1), (0x09, 55), (0x1C, 9)):
        bench.do(index, value)
    bench.do(0x01)
    bench.advance(2 * S)
    bench.address = 0
    assert bench.device.line_format.baud == 38400
    assert bench.read(0x26) == 0x0A601000
    assert bench.read(0x25) == 0x05000320
    assert bench.read(0x22) == 0x3FFFFFFF
    assert bench.read(0x23) == 0xC0000000
    assert bench.position() == 123


def test_while_the_reset_input_is_held_the_module_is_dead_then_boots() -> None:
    """MACS-IO-01."""
    bench = MacBench()
    bench.do(0x13, 100_000)
    bench.input("reset", True)
    assert bench.state() == "RI"
    bench.advance(10 * S)
    assert bench.ask(0x20) == SILENCE
    bench.input("reset", False)
    assert bench.state() == "BT"
    assert bench.ask(0x20) == SILENCE
    bench.advance(2 * S)
    assert bench.state() == "OF"
    assert bench.position() < 100


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("etx_to_reset_us", [500, 1500])
def test_a_module_held_in_reset_says_nothing_more(paced: bool, etx_to_reset_us: int) -> None:
    """A waiting reply never comes, one under way breaks off (MACS-IO-01)."""
    device = MacSerial("mac23", 0)
    network = SerialNetwork([device], paced=paced)
    network.host_send(EXAMPLE_20H)
    etx_ns = LineFormat(38400).span_ns(21) if paced else 0
    network.run_until(etx_ns + etx_to_reset_us * 1000)
    heard = network.host_take()
    assert ANSWER_20H.startswith(heard)
    network.perform(0, device.set_input(network.now_ns, "reset", True))
    network.run_until(network.now_ns + S)
    assert network.host_available <= (1 if paced else 0)  # at most the byte that broke off
    network.perform(0, device.set_input(network.now_ns, "reset", False))
    network.run_until(network.now_ns + 2 * S)
    network.host_take()
    network.host_send(EXAMPLE_20H)
    network.run_until(network.now_ns + S)
    assert network.host_take() == ANSWER_20H


@pytest.mark.parametrize(("echo", "digits"), [("as_sent", b"FF"), ("own_address", b"00")])
def test_an_answer_of_zeros_to_all_carries_the_address_of_every_answer(
    echo: str, digits: bytes
) -> None:
    """MACS-REPLY-08, MACS-AMB-17, MACS-AMB-58."""
    bench = MacBench(unknown_index="zero_answer", general_echo=echo)
    answer = bench.ask(0x2A, address=0xFF)
    assert answer[6:8] == digits
    assert answer[17:19] == checksum(answer[6:17])


def test_power_off_silences_and_power_on_boots() -> None:
    """Nothing is heard without power; two seconds after power-up it lives (MACS-AMB-21)."""
    bench = MacBench()
    bench.take(bench.device.power_off(bench.now))
    assert bench.state() == "off"
    assert bench.ask(0x20) == SILENCE
    bench.take(bench.device.power_on(bench.now))
    bench.advance(1994 * MS)
    assert bench.ask(0x20) == SILENCE
    bench.advance(MS)
    assert bench.ask(0x20) == ANSWER_20H


# ---- stored cells ----

STORED = [
    (0x02, 0, "standby", 0),
    (0x03, 9, "stops", 9),
    (0x09, 0x1234, "superior_stop", 0x1234),
    (0x0A, 0xFFFFFF00, "inferior_stop", -256),
    (0x0C, 0x20, "torque", 0x20),
    (0x0D, 0x0400, "period", 0x400),
    (0x0E, 0x0700, "catchup", 7),
    (0x0F, 0x02, "ramp", 2),
    (0x1C, 0x30, "tolerance", 0x30),
]


@pytest.mark.parametrize(("index", "parameters", "cell", "value"), STORED)
def test_a_parameter_is_stored_durably_before_its_acknowledgement(
    index: int, parameters: int, cell: str, value: int
) -> None:
    """The Store stands in front of the Transmit and a new device reads it (MACS-PERS-01, -02)."""
    bench = MacBench()
    bench.do(index, parameters)
    store, transmit = bench.effects[-2:]
    assert store == Store(((cell, value),), durable=True)
    assert isinstance(transmit, Transmit)
    again = MacBench(cells=dict(bench.device.cells(bench.now)))
    for query in (0x22, 0x23, 0x25, 0x26):
        assert again.read(query) == bench.read(query)


def test_a_refused_parameter_stores_nothing() -> None:
    """MACS-REPLY-05."""
    bench = MacBench()
    bench.refuse(0x0C, 0x81)
    bench.refuse(0x0D, 0)
    bench.refuse(0x03, 2)
    assert not bench.stores


def test_the_position_is_handed_on_at_every_end_of_a_motion_and_kept_over_power_off() -> None:
    """MACS-PERS-01, MACS-Q-20-02: not durable, the hardware saves it when the supply fails."""
    bench = MacBench()
    bench.do(0x13, 777)
    bench.settle()
    assert Store((("position", 777),), durable=False) in bench.effects[-2:]
    bench.do(0x15, 0x320)
    bench.advance(S // 2)
    moving = bench.device.cells(bench.now)["position"]
    assert moving > 777
    bench.take(bench.device.power_off(bench.now))
    assert bench.stores["position"] == moving
    bench.take(bench.device.power_on(bench.now))
    bench.advance(2 * S)
    assert bench.position() == moving


def test_a_shaft_turned_while_the_supply_is_off_is_not_counted() -> None:
    """The position is valid only if the shaft was not moved (MACS-Q-20-02)."""
    bench = MacBench(cells={"position": 100})
    bench.take(bench.device.power_off(bench.now))
    bench.take(bench.device.push(bench.now, 50))
    bench.take(bench.device.power_on(bench.now))
    bench.advance(2 * S)
    assert bench.position() == 100
    bench.take(bench.device.push(bench.now, 50))
    assert bench.position() == 150


def test_the_counter_stands_while_the_supply_is_off() -> None:
    """One truth: reading and cell stay as saved, whatever the shaft does (MACS-PERS-01)."""
    bench = MacBench(cells={"position": 100})
    bench.take(bench.device.power_off(bench.now))
    bench.take(bench.device.push(bench.now, 50))
    assert bench.device.position_at(bench.now) == 100
    assert bench.device.cells(bench.now)["position"] == 100
    assert not bench.device.is_moving(bench.now)


def test_a_shaft_that_coasts_without_supply_is_not_counted() -> None:
    """Saved once, when the supply fails; nothing is written without it (MACS-Q-20-02)."""
    bench = MacBench(plant="inertial", factory_ramp=0)
    bench.do(0x15, 100)
    bench.advance(S)
    bench.take(bench.device.power_off(bench.now))
    saved = bench.stores["position"]
    before = len(bench.effects)
    bench.advance(20 * S)
    assert len(bench.effects) == before
    assert bench.device.position_at(bench.now) == saved
    bench.take(bench.device.power_on(bench.now))
    bench.advance(2 * S)
    assert bench.position() == saved


def test_a_shaft_that_still_coasts_is_counted_again_when_the_supply_is_back() -> None:
    """From the saved number on (MACS-Q-20-02, MACS-CMD-1A-02)."""
    bench = MacBench(plant="inertial", factory_ramp=0)
    bench.do(0x15, 100)
    bench.advance(S)
    bench.take(bench.device.power_off(bench.now))
    saved = bench.stores["position"]
    bench.advance(10 * MS)
    bench.take(bench.device.power_on(bench.now))
    assert bench.device.position_at(bench.now) == saved
    bench.advance(30 * S)
    assert bench.position() > saved + 1000
    assert bench.stores["position"] == bench.position()


def test_stored_address_and_rate_win_over_the_constructor() -> None:
    """What a module stored is what it is."""
    device = MacSerial("mac23", 1, cells={"address": 9, "baud": 19200})
    assert device.address == 9
    assert device.line_format == LineFormat(19200)


def test_impossible_cells_are_ignored() -> None:
    """A cell that this device could not have stored reads as from the factory."""
    strange = {"baud": 12345, "address": 200, "period": 0, "stops": 5, "torque": 0x81, "mystery": 4}
    device = MacSerial("mac23", 1, cells=strange)
    assert device.address in (0, 1)
    assert device.axis.values["stops"] == 0
    assert device.axis.values["torque"] == 0x60
    assert MacBench(cells=strange).read(0x29, 0) == 0x00030100
    assert device.line_format == LineFormat(38400)
    assert device.axis.values["period"] == 0x320


@pytest.mark.parametrize(("imax", "torque"), [(0x40, 0x40), (0x60, 0x60), (0xFF, 0x60)])
def test_the_factory_torque_is_within_imax(imax: int, torque: int) -> None:
    """At start and after 01h: no motor gives more than its maximum (MACS-AMB-11, -25)."""
    bench = MacBench(imax_value=imax)
    assert bench.read(0x26) >> 16 & 0xFF == torque
    bench.do(0x0C, 1)
    bench.do(0x01)
    bench.advance(2 * S)
    assert bench.read(0x26) >> 16 & 0xFF == torque


# ---- users' mistakes ----


@pytest.mark.parametrize("name", ["encoder", "amplifier"])
def test_a_fault_that_the_model_does_not_have_cannot_be_made(name: str) -> None:
    """dd of a MAC23 has no bit for it (ledger §5.9)."""
    bench = MacBench()
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


# ---- any bytes ----


def mutated_frames(chance: random.Random, size: int) -> bytes:
    """Frames with damage, mixed with noise, about ``size`` bytes."""
    parts: list[bytes] = []
    while sum(map(len, parts)) < size:
        frame = bytearray(
            request(
                chance.choice((0, 0, 5, 0xFF, 0x80)),
                chance.randrange(0x40),
                chance.getrandbits(32),
                chance.choice((0, 0, 0xAF)),
            )
        )
        for _ in range(chance.choice((0, 0, 0, 1, 2))):
            frame[chance.randrange(len(frame))] = chance.randrange(256)
        parts.append(bytes(frame[: chance.choice((21, 21, 21, 21, 7))]))
        parts.append(chance.randbytes(chance.choice((0, 0, 3, 40))))
    return b"".join(parts)


@pytest.mark.parametrize("seed", range(2))
def test_any_bytes_are_survived_and_answered_at_most_once_per_frame(seed: int) -> None:
    """50 000 bytes of mutated frames: no exception, no unsolicited byte, alive afterwards."""
    chance = random.Random(seed)
    bench = MacBench()
    for _ in range(25):
        data = mutated_frames(chance, 2000)
        sent = len(bench.late)
        for at in range(0, len(data), 97):
            bench.send(data[at : at + 97])
            bench.advance(chance.choice((0, 2, 30, 2500)) * MS)
        frames = data.count(b"\x02")
        assert len(bench.late) - sent <= frames
    bench.advance(3 * S)
    bench.send(b"\x02")
    position = bench.device.address
    assert len(bench.ask(0x20, address=position)) == 21


def test_quiet_prefixes_are_quiet_whatever_the_cut() -> None:
    """Fed byte by byte or in the longest stretches, the same replies at the same times."""
    chance = random.Random(7)
    data = mutated_frames(chance, 4000)
    line_format = LineFormat(38400)
    outcomes = []
    for step in (1, 5000):
        device = MacSerial("mac23", 0)
        sent: list[Transmit] = []
        at = 0
        while at < len(data):
            quiet = device.quiet_prefix(data[at : at + step])
            size = max(1, quiet)
            chunk = Chunk(S + line_format.span_ns(at), data[at : at + size], line_format)
            while (due := device.next_event()) is not None and due <= chunk.arrival_ns(0):
                device.wake(due)
            sent += [e for e in device.receive(chunk) if isinstance(e, Transmit)]
            at += size
        outcomes.append([effect.data for effect in sent if len(effect.data) < 21])
    assert outcomes[0] == outcomes[1]
    assert outcomes[0]


@pytest.mark.slow
def test_ten_million_bytes_pass_in_seconds() -> None:
    """Random bytes cost next to nothing."""
    data = random.Random(3).randbytes(10_000_000)
    device = MacSerial("mac23", 0)
    begun = time.perf_counter()
    at = 0
    while at < len(data):
        piece = data[at : at + 65536]
        size = max(1, device.quiet_prefix(piece))
        device.receive(Chunk(at * 260_416, piece[:size], LineFormat(38400)))
        at += size
    assert time.perf_counter() - begun < 10
