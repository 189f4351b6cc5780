"""Checks of an MSC's flags, status, program and rig: faulty controllers fail by name."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from msc_controller import (
    AUTO,
    BLOCK,
    COUNT,
    LOST,
    LOW,
    PULSE,
    RUNNING,
    TIMED,
    TIMER,
    USER,
    Controller,
    answers,
    judge,
    refuses,
    twisted,
)
from msc_judging import failed, troubles

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import Packet
from axistwin_conformance.families.msc.family import FAMILY

pytestmark = pytest.mark.strength

ERROR_BIT = 12
STATUS = "the_status_is_followed_by_what_carries_nothing"
COUNTS = "the_program_sees_a_flag_and_the_host_its_count"
BESIDE = "each_command_works_while_a_timer_runs"
BATTERY = "without_its_battery_memory_is_not_reliable"
WHOLE = "the_program_sees_a_block_whole"
HOST = "the_host_cannot_turn_a_flag_of_the_machine"
ONE_FLAG = "a_flag_is_read_as_1_or_0"
EACH_FLAG = "each_flag_reads_alone_as_among_all"
PULSED = "a_flag_set_and_cleared_at_once_is_seen_or_not"


# --- flags ---------------------------------------------------------------------------------------


def turned_round(served: bytes) -> bytes:
    """RFLAGS as one number, high byte first."""
    return served[::-1]


def mirrored(served: bytes) -> bytes:
    """RFLAGS with the bits of each byte in the opposite order."""
    return bytes(int(f"{one:08b}"[::-1], 2) for one in served)


def all_bits(self: Controller, one: Packet) -> bytes | None:
    """FFFFh for on."""
    return codec.u16(0xFFFF * (one.numbers[0] in self.states()))


def next_one(self: Controller, number: int, *, on: bool) -> bytes | None:
    """The flag behind the one that was meant."""
    return Controller.turn(self, number + 1, on=on)


def whole_byte(self: Controller, number: int, *, on: bool) -> bytes | None:
    """CFLAG clears all flags of the byte."""
    for one in range(number & ~7, number | 7) if not on else ():
        Controller.turn(self, one, on=False)
    return Controller.turn(self, number, on=on)


def toggles(self: Controller, number: int, *, on: bool) -> bytes | None:
    """SFLAG turns a flag that is on off."""
    return Controller.turn(self, number, on=on and number not in self.on)


def of_seven_bits(self: Controller, one: Packet) -> bytes | None:
    """RFLAG of the low seven bits of a number."""
    return codec.u16(one.numbers[0] & 0x7F in self.states())


def status_of(size: int) -> Callable[[Controller, Packet], bytes]:
    """A reply to RQSTAT with so many bytes."""
    return lambda self, one: codec.u16(self.status).ljust(size, b"\x00")


def now_and_then(self: Controller, one: Packet) -> bytes:
    """Bytes behind the status that are there the second time only."""
    self.notes["asked"] += 1
    return codec.u16(self.status) + (b"\x01" * 6 if self.notes["asked"] % 2 else bytes(6))


def forgets(self: Controller, one: Packet) -> bytes:
    """Errors that are told once, and told again after that."""
    self.notes["looks"] += 1
    is_hidden = self.notes["looks"] % 2 == 1
    return codec.u16(self.status & ~(1 << ERROR_BIT) if is_hidden else self.status) + bytes(6)


def swapped(self: Controller, one: Packet) -> bytes:
    """The status low byte first."""
    return codec.u16(self.status)[::-1] + bytes(6)


def deaf_bit(self: Controller, running: bool) -> None:
    """A program whose end leaves bit 0 on."""
    self.notes["stopped"] += not running


# --- the program ---------------------------------------------------------------------------------


def counts_once(self: Controller) -> None:
    """A repeat of what was written is thrown away."""
    if not self.notes["counted"]:
        Controller.counted(self)
    self.notes["counted"] += 1


def counts_twice(self: Controller) -> None:
    """A flag that is found twice."""
    self.add(6144, 2)


def torn_now_and_then(self: Controller, one: Packet) -> bytes | None:
    """Some blocks that arrive in two halves, the program's scan between."""
    self.notes["blocks"] += 1
    if self.notes["blocks"] % 9 == 0 and one.numbers[0] == BLOCK:
        self.put(BLOCK, one.payload[2:6])
        self.pass_by(self.virtual_time_ns)
    return Controller.bwrite(self, one)


def loses_block(self: Controller, one: Packet) -> bytes | None:
    """Blocks to the program's place that are not stored."""
    return b"" if one.numbers[0] == BLOCK else Controller.bwrite(self, one)


def is_timing(self: Controller) -> bool:
    """Whether the timer of the program runs."""
    return TIMER in self.states()


def lost_beside_a_timer(self: Controller, number: int, *, on: bool) -> bytes | None:
    """SFLAG has no effect while the timer runs."""
    return b"" if on and is_timing(self) else Controller.turn(self, number, on=on)


def lost_at_rest(self: Controller, number: int, *, on: bool) -> bytes | None:
    """SFLAG and CFLAG have no effect while no program runs."""
    return Controller.turn(self, number, on=on) if self.status & RUNNING else b""


def refused_beside_a_timer(self: Controller, one: Packet) -> bytes | None:
    """DWRITE draws NAK while the timer runs."""
    return None if is_timing(self) else Controller.dwrite(self, one)


def busy_beside_a_timer(self: Controller, one: Packet) -> bytes | None:
    """Bit 7 is on while the timer runs."""
    return codec.u16(self.status | 128 * is_timing(self)) + bytes(6)


def endless_timer(self: Controller, now_ns: int) -> None:
    """A timer that never runs out."""
    started = TIMED in self.on
    Controller.pass_by(self, now_ns)
    if started:
        self._timer_ends_ns = 10**15


def bounces(self: Controller, now_ns: int) -> None:
    """A flag that is seen going on twice."""
    more = PULSE in self.on and not self._was_on
    Controller.pass_by(self, now_ns)
    if more:
        self.add(6152)


def sticks(self: Controller, number: int, *, on: bool) -> bytes | None:
    """CFLAG leaves one flag on."""
    return Controller.turn(self, number, on=on or number == PULSE)


def lost_flag(self: Controller, number: int, *, on: bool) -> bytes | None:
    """SFLAG of `count` is lost."""
    return b"" if number == COUNT else Controller.turn(self, number, on=on)


def taken_but_on(self: Controller, now_ns: int) -> None:
    """The program finds nothing."""
    self.add(6148)


# --- the rig -------------------------------------------------------------------------------------


def two_bits(self: Controller, bit: int, on: bool) -> None:
    """A condition that shows in the bit above as well, once two are there."""
    Controller.set_status(self, bit, on)
    if on and bin(self.status).count("1") > 2:
        self.status |= 1 << 4


def other_bit(self: Controller, bit: int, on: bool) -> None:
    """Two conditions exchanged."""
    Controller.set_status(self, {13: 14, 14: 13}.get(bit, bit), on)


def stays(self: Controller, bit: int, on: bool) -> None:
    """An error that stays for ever."""
    Controller.set_status(self, bit, on or bit == ERROR_BIT)


def always_starts(self: Controller, on: bool) -> None:
    """A program that every power-up starts."""
    Controller.power(self, on)
    self.run_program(True)


def never_starts(self: Controller, on: bool) -> None:
    """A program that no power-up starts."""
    Controller.power(self, on)
    self.run_program(False)


def forgets_all(self: Controller, on: bool) -> None:
    """Memory that is gone without a word."""
    Controller.power(self, on)
    self.area[:] = bytes(len(self.area))
    self.status &= ~LOST


def silent_battery(self: Controller, flat: bool) -> None:
    """An empty battery that is not told."""
    self.is_flat = flat


def low_for_ever(self: Controller, flat: bool) -> None:
    """A battery that counts as low from then on."""
    self.is_flat = flat
    self.status |= LOW


def half_served(self: Controller, one: Packet) -> bytes | None:
    """A stopped unit that answers DREAD with zeros."""
    if one.name == "DREAD" and not self.status & RUNNING:
        return bytes(4)
    return Controller.serve(self, one)


def clears_the_last(self: Controller, one: Packet) -> bytes | None:
    """RQSTAT turns the user flags from 184 to 191 off."""
    self.on -= set(range(184, 192))
    return Controller.rqstat(self, one)


def loading(self: Controller, one: Packet) -> bytes | None:
    """RFLAG and BWRITE are told as a load out of sequence."""
    self.status |= (one.name in ("RFLAG", "BWRITE")) << 11
    return Controller.serve(self, one)


def half_refused(self: Controller, one: Packet) -> bytes | None:
    """A unit that refuses reads of data, not writes, while a program is loaded."""
    if one.name == "DREAD" and self.status & 1 << 10:
        return None
    return Controller.serve(self, one)


def two_at_once(self: Controller, number: int, on: bool) -> None:
    """Two inputs on one wire."""
    for one in (number, *((7,) if number == 3 else ())):
        Controller.work(self, one, on)


def inverted(self: Controller, number: int, on: bool) -> None:
    """An input the other way round."""
    Controller.work(self, number, not on if number == 15 else on)


def forced(self: Controller, number: int, *, on: bool) -> bytes | None:
    """SFLAG and CFLAG of inputs work for ever."""
    if number not in USER:
        (self.machine.add if on else self.machine.discard)(number)
    return Controller.turn(self, number, on=on)


def changed_yet_refused(self: Controller, number: int, *, on: bool) -> bytes | None:
    """SFLAG of an input is refused, and works."""
    if number in USER:
        return Controller.turn(self, number, on=on)
    (self.machine.add if on else self.machine.discard)(number)
    return None


class Stuck(Controller):
    """Inputs that SFLAG has turned on stay on, whatever the machine does."""

    def turn(self, number: int, *, on: bool) -> bytes | None:
        """Keeps what was forced."""
        if number not in USER and on:
            self.on.add(number)
        return super().turn(number, on=on)


class Forced(Controller):
    """SFLAG and CFLAG of inputs work until the next scan."""

    def __init__(self) -> None:
        super().__init__()
        self.turned: dict[int, bool] = {}

    def turn(self, number: int, *, on: bool) -> bytes | None:
        """Remembers what was there."""
        self.turned.setdefault(number, number in self.machine)
        return forced(self, number, on=on)

    def work(self, number: int, on: bool) -> None:
        """What the machine does is there from now on."""
        self.turned.pop(number, None)
        super().work(number, on)

    def pass_by(self, now_ns: int) -> None:
        """Lets inputs follow the machine again."""
        for number, was_on in self.turned.items():
            (self.machine.add if was_on else self.machine.discard)(number)
        self.turned.clear()
        super().pass_by(now_ns)


class Unstoppable(Controller):
    """Its program goes on with bit 0 off."""

    def scan(self) -> None:
        """Scans as if it ran."""
        status, self.status = self.status, self.status | RUNNING
        super().scan()
        self.status = status


FAULTS: list[tuple[str, Callable[[], Controller], str]] = [
    (ONE_FLAG, refuses("RFLAG", lambda one: one.numbers[0] > 127), "MSC-RFLAG-01"),
    (ONE_FLAG, refuses("RFLAG", lambda one: one.numbers[0] == 255), "MSC-FLG-01"),
    (ONE_FLAG, answers("RFLAG", lambda one: one[1:]), "MSC-RFLAG-02"),
    (ONE_FLAG, answers("RFLAG", lambda one: b"\xff\xff"), "MSC-RFLAG-02"),
    ("all_flags_come_in_one_reply", refuses("RFLAGS"), "MSC-MOD-01"),
    ("all_flags_come_in_one_reply", answers("RFLAGS", lambda one: one[:31]), "MSC-RFLAGS-01"),
    ("all_flags_come_in_one_reply", answers("RFLAGS", lambda one: one[:16]), "MSC-FLG-01"),
    (EACH_FLAG, answers("RFLAGS", lambda one: b"\1" * 32), "MSC-PROP-11"),
    ("a_flag_is_on_from_sflag_to_cflag", twisted(rflag=all_bits), "MSC-RFLAG-02"),
    ("a_flag_is_on_from_sflag_to_cflag", twisted(turn=next_one), "MSC-SFLAG-02"),
    ("a_flag_is_on_from_sflag_to_cflag", twisted(turn=whole_byte), "MSC-CFLAG-02"),
    ("a_flag_is_on_from_sflag_to_cflag", twisted(turn=toggles), "MSC-SFLAG-02"),
    ("a_flag_is_on_from_sflag_to_cflag", refuses("SFLAG"), "MSC-SFLAG-01"),
    ("a_flag_is_on_from_sflag_to_cflag", refuses("CFLAG"), "MSC-CFLAG-01"),
    ("flag_f_is_bit_f_mod_8_of_byte_f_div_8", answers("RFLAGS", turned_round), "MSC-RFLAGS-02"),
    ("flag_f_is_bit_f_mod_8_of_byte_f_div_8", answers("RFLAGS", mirrored), "MSC-RFLAGS-02"),
    ("flag_f_is_bit_f_mod_8_of_byte_f_div_8", twisted(turn=next_one), "MSC-SFLAG-02"),
    ("patterns_of_flags_read_alike_both_ways", answers("RFLAGS", mirrored), "MSC-RFLAGS-02"),
    ("patterns_of_flags_read_alike_both_ways", twisted(rflag=of_seven_bits), "MSC-PROP-11"),
    ("nothing_that_was_sent_is_a_load", twisted(serve=loading), "MSC-STA-02"),
    ("what_it_carries_out_is_no_error", twisted(serve=loading), "MSC-STA-02"),
    ("reads_change_no_flag", twisted(rqstat=clears_the_last), "MSC-PROP-13"),
    (STATUS, twisted(rqstat=status_of(7)), "MSC-RQSTAT-01"),
    (STATUS, twisted(rqstat=status_of(2)), "MSC-RQSTAT-01"),
    (STATUS, twisted(rqstat=now_and_then), "MSC-RQSTAT-01"),
    ("bit_0_tells_whether_the_program_runs", twisted(rqstat=swapped), "MSC-RQSTAT-02"),
    ("bit_0_tells_whether_the_program_runs", answers("RQSTAT", lambda _: bytes(8)), "MSC-STA-01"),
    (COUNTS, twisted(counted=counts_once), "MSC-SFLAG-02"),
    (COUNTS, twisted(counted=counts_twice), "MSC-DREAD-02"),
    (COUNTS, twisted(turn=lost_flag), "MSC-SFLAG-02"),
    (COUNTS, twisted(pass_by=taken_but_on), "MSC-SFLAG-02"),
    (WHOLE, twisted(bwrite=loses_block), "MSC-BWRITE-06"),
    (PULSED, twisted(pass_by=bounces), "MSC-SFLAG-02"),
    (PULSED, twisted(turn=sticks), "MSC-CFLAG-02"),
    ("a_timer_flag_follows_its_timer", twisted(pass_by=endless_timer), "MSC-FLG-03"),
    ("a_timer_flag_follows_its_timer", twisted(pass_by=taken_but_on), "MSC-FLG-03"),
    (BESIDE, twisted(pass_by=endless_timer), "MSC-FLG-03"),
    (BESIDE, twisted(turn=lost_beside_a_timer), "MSC-SFLAG-02"),
    (BESIDE, twisted(dwrite=refused_beside_a_timer), "MSC-LNK-01"),
    (BESIDE, twisted(rqstat=busy_beside_a_timer), "MSC-STA-02"),
    ("a_program_that_ends_turns_bit_0_off", twisted(run_program=deaf_bit), "MSC-STA-01"),
    ("a_program_that_ends_turns_bit_0_off", Unstoppable, "MSC-STA-02"),
    ("each_condition_has_a_bit_of_its_own", twisted(set_status=other_bit), "MSC-STA-02"),
    ("each_condition_has_a_bit_of_its_own", twisted(set_status=stays), "MSC-STA-02"),
    ("each_condition_has_a_bit_of_its_own", twisted(set_status=two_bits), "MSC-STA-03"),
    ("an_error_is_told_until_it_is_over", twisted(rqstat=forgets), "MSC-STA-04"),
    ("bit_0_is_the_program", twisted(run_program=deaf_bit), "MSC-STA-02"),
    ("auto_start_is_what_power_up_does", twisted(power=always_starts), "MSC-STA-01"),
    ("auto_start_is_what_power_up_does", twisted(power=never_starts), "MSC-STA-02"),
    ("memory_is_kept_or_said_not_to_be", twisted(power=forgets_all), "MSC-STA-02"),
    (BATTERY, twisted(power=forgets_all), "MSC-STA-02"),
    (BATTERY, twisted(set_battery=silent_battery), "MSC-STA-02"),
    (BATTERY, twisted(set_battery=low_for_ever), "MSC-STA-02"),
    ("a_stopped_controller_still_serves", twisted(serve=half_served), "MSC-DWRITE-02"),
    ("a_stopped_controller_still_turns_flags", twisted(turn=lost_at_rest), "MSC-SFLAG-02"),
    ("a_controller_that_is_loaded_still_serves", twisted(serve=half_refused), "MSC-STA-02"),
    ("a_flag_of_the_machine_follows_the_machine", twisted(work=two_at_once), "MSC-FLG-03"),
    ("a_flag_of_the_machine_follows_the_machine", twisted(work=inverted), "MSC-RFLAG-01"),
    ("flags_of_the_machine_read_alike_both_ways", answers("RFLAGS", mirrored), "MSC-RFLAGS-02"),
    (HOST, Stuck, "MSC-FLG-03"),
    (HOST, twisted(turn=forced), "MSC-FLG-03"),
    (HOST, twisted(turn=changed_yet_refused), "MSC-SFLAG-03"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "make", "requirement"), FAULTS,
    ids=[f"{one}-{key}-{number}" for number, (one, _, key) in enumerate(FAULTS)],
)  # fmt: skip
def test_a_fault_fails_what_it_breaks(
    name: str, make: Callable[[], Controller], requirement: str
) -> None:
    """Each by the check that is there for it."""
    assert requirement in failed(judge(name, make())), troubles(judge(name, make()))


@pytest.mark.parametrize(
    ("name", "make", "switch", "reading"),
    [
        (WHOLE, twisted(bwrite=torn_now_and_then), "bwrite_atomic", "false"),
        (HOST, Forced, "flag_write_readonly", "force"),
        (STATUS, twisted(rqstat=status_of(6)), "status_tail", "4"),
    ],
    ids=lambda one: one if isinstance(one, str) else "",
)  # fmt: skip
def test_another_reading_is_named_and_not_failed(
    name: str, make: Callable[[], Controller], switch: str, reading: str
) -> None:
    """It is an admissible one of the manual."""
    found = judge(name, make(), readings={switch: reading})
    assert not failed(found), troubles(found)
    told = [one.text for one in found if one.verdict is Verdict.QUIRK]
    assert any(f"{switch}={reading}" in text for text in told), found


def test_an_error_that_is_told_only_at_times_fails() -> None:
    """Of a device that has shown that its errors stand."""
    port = twisted(rqstat=forgets)()
    port.status |= 1 << ERROR_BIT
    name = "reading_the_status_leaves_its_errors_as_they_are"
    port.notes["looks"] = 1
    assert failed(judge(name, port, readings={"status_latch": "level"})) == {"MSC-STA-04"}


def test_what_the_rig_cannot_do_is_left_out() -> None:
    """Without a way to start the program, the memory checks leave it as power-up does."""
    port = Controller()
    found = judge("memory_is_kept_or_said_not_to_be", port, lacks=frozenset({"program"}))
    assert not failed(found)
    assert not port.status & (RUNNING | AUTO)


def test_a_program_that_does_not_run_proves_nothing() -> None:
    """Checks that need it skip, and say that nothing counts."""
    port = Controller()
    port.run_program(False)
    for name in ("the_program_sees_a_block_whole", "a_timer_flag_follows_its_timer"):
        found = judge(name, port)
        assert {one.verdict for one in found} == {Verdict.NOT_RUN}
        assert all("does not run" in one.text for one in found)


def test_every_check_of_flags_status_program_and_rig_has_a_fault_here() -> None:
    """No check of these modules goes without one that it finds."""
    modules = ("flags", "status", "program", "rig")
    names = {one.name for one in FAMILY.checks() if one.module.rpartition(".")[2] in modules}
    elsewhere = {  # what finds them is in the zoo
        "reading_the_status_leaves_its_errors_as_they_are",
        "a_repeat_carries_the_flags_of_the_first_reply",
    }
    assert names <= elsewhere | {name for name, _, _ in FAULTS}
