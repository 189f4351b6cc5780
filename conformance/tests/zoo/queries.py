"""Faults in what queries tell, and in when they are answered."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.memory_map import four_bytes
from axistwin.devices.mac.serial import device as serial
from axistwin.devices.mac.serial.device import MacSerial
from zoo.mutant import Any_, MonkeyPatch, answers, frames, motion_of, mutant, replies, wrap

QUERIES = range(0x20, 0x2A)


def _bytes(value: int, *order: int) -> int:
    """The four bytes of a value in another order."""
    four = value.to_bytes(4, "big")
    return int.from_bytes(bytes(four[place] for place in order), "big")


@mutant("MACS-Q-20-01")
def positions_have_24_bits(patch: MonkeyPatch) -> None:
    """20h loses the upper byte, and with it the sign."""
    answers(patch, 0x20, lambda value, axis, now: value & 0xFFFFFF)


@mutant("MACS-Q-22-01", "MACS-CMD-09-01", traps=(39,))
def a_negative_stop_carries_a_minus(patch: MonkeyPatch) -> None:
    """A superior stop of -1000 is told as -00003E8."""

    def change(data: bytes, _: MacSerial) -> bytes:
        if len(data) != 21 or data[8:9] != b"2" or data[9:10] < b"8":
            return data
        return data[:9] + b"-%07X" % (0x100000000 - int(data[9:17], 16)) + data[17:]

    replies(patch, change)


@mutant("MACS-Q-21-01")
def the_status_is_written_backwards(patch: MonkeyPatch) -> None:
    """21h answers hh gg ff dd."""
    answers(patch, 0x21, lambda value, axis, now: _bytes(value, 3, 2, 1, 0))


@mutant("MACS-Q-21-01")
def reading_the_status_clears_it(patch: MonkeyPatch) -> None:
    """ff of 21h is told once."""

    def change(value: int, axis: Axis, _: int) -> int:
        axis.drive.stops.bits = 0
        return value

    answers(patch, 0x21, change)


@mutant("MACS-Q-21-01")
def an_idle_module_warns_of_under_voltage(patch: MonkeyPatch) -> None:
    """dd bit 5 has the wrong polarity."""
    answers(patch, 0x21, lambda value, axis, now: value ^ 0x20000000)


@mutant("MACS-Q-22-01")
def the_superior_stop_reads_as_the_inferior_one(patch: MonkeyPatch) -> None:
    """22h answers what 23h answers."""
    answers(patch, 0x22, lambda value, axis, now: axis.values["inferior_stop"])


@mutant("MACS-Q-23-01", traps=(39,))
def the_inferior_stop_reads_without_its_sign(patch: MonkeyPatch) -> None:
    """23h answers the magnitude."""
    answers(patch, 0x23, lambda value, axis, now: abs(axis.values["inferior_stop"]))


@mutant("MACS-Q-24-01")
def the_release_counts_up(patch: MonkeyPatch) -> None:
    """24h answers another number each time."""

    def change(value: int, axis: Any, _: int) -> int:
        axis.asked = getattr(axis, "asked", 0) + 1
        return value + int(axis.asked)

    answers(patch, 0x24, change)


@mutant("MACS-Q-25-01")
def the_speeds_are_in_the_other_order(patch: MonkeyPatch) -> None:
    """25h answers vvvv 00 rr."""
    answers(patch, 0x25, lambda value, axis, now: _bytes(value, 2, 3, 1, 0))


@mutant("MACS-CMD-15-05", traps=(14,))
def the_speed_of_15h_shows_in_25h(patch: MonkeyPatch) -> None:
    """25h answers the period in use."""

    def change(value: int, axis: Any, now: int) -> int:
        motion = motion_of(axis.drive)
        running = motion.ramp.period_ticks if motion is not None else value & 0xFFFF
        return value & 0xFFFF0000 | (running if axis.drive.kind is not None else value & 0xFFFF)

    answers(patch, 0x25, change)


@mutant("MACS-Q-26-01")
def both_modes_are_exchanged(patch: MonkeyPatch) -> None:
    """26h tells m before K."""
    answers(
        patch,
        0x26,
        lambda value, axis, now: value & 0xFFFF00FF | (value & 0xF00) << 4 | (value & 0xF000) >> 4,
    )


@mutant("MACS-Q-27-01")
def the_supply_is_told_as_0(patch: MonkeyPatch) -> None:
    """27h has no measure of the supply."""
    answers(patch, 0x27, lambda value, axis, now: value & 0xFF00FFFF)


@mutant("MACS-Q-27-03", "MACS-BUSY-01", traps=(19,))
def the_busy_bit_is_1_when_busy(patch: MonkeyPatch) -> None:
    """cc bit 3 of 27h has the polarity of the output line."""
    answers(patch, 0x27, lambda value, axis, now: value ^ 0x0800)


def _memory(patch: MonkeyPatch, index: int, change: Any_) -> None:
    """Let 28h or 29h answer `change(value, image, address)`."""

    def act(judge: Any_, module: Any, frame: bytes, request: Any) -> None:
        module.asked = request.command
        judge()

    frames(patch, act)

    def make(query: Any_) -> Any_:
        def querying(module: MacSerial, frame: bytes, asked: int) -> Any:
            with MonkeyPatch.context() as within:
                if asked == index:
                    within.setattr(
                        serial,
                        "four_bytes",
                        lambda image, address, *, wraps: change(
                            four_bytes(image, address, wraps=wraps), image, address
                        ),
                    )
                return query(module, frame, asked)

        return querying

    wrap(patch, MacSerial, "_query", make)


@mutant("MACS-Q-28-01", traps=(40,))
def ram_is_told_last_byte_first(patch: MonkeyPatch) -> None:
    """28h answers its four bytes in reverse, Imax last."""
    _memory(patch, 0x28, lambda value, image, address: _bytes(value, 3, 2, 1, 0))


@mutant("MACS-Q-28-01", "MACS-FRAME-09")
def ram_is_read_at_its_beginning(patch: MonkeyPatch) -> None:
    """28h ignores the sub-index."""
    _memory(patch, 0x28, lambda value, image, address: int.from_bytes(image[0xAF:0xB3], "big"))


@mutant("MACS-Q-29-01")
def eeprom_is_told_last_byte_first(patch: MonkeyPatch) -> None:
    """29h answers its four bytes in reverse."""
    _memory(patch, 0x29, lambda value, image, address: _bytes(value, 3, 2, 1, 0))


@mutant("MACS-Q-29-01")
def eeprom_is_read_in_words(patch: MonkeyPatch) -> None:
    """29h ignores the last two bits of the sub-index."""
    _memory(
        patch,
        0x29,
        lambda value, image, address: int.from_bytes(
            image[address & ~3 : (address & ~3) + 4], "big"
        ),
    )


@mutant("MACS-Q-XX-01", traps=(17,))
def queries_are_refused_in_motion(patch: MonkeyPatch) -> None:
    """25h and 26h are answered at rest only."""

    def act(judge: Any_, module: MacSerial, _: bytes, request: Any) -> None:
        asked = request.command in (0x25, 0x26) and request.address == module.address
        if asked and request.is_sum_right and module.axis.drive.kind is not None:
            module._transmit(module._refused)
            return
        judge()

    frames(patch, act)


@mutant("MACS-Q-XX-01")
def a_query_delays_the_motion(patch: MonkeyPatch) -> None:
    """Each reading of 21h in a move ends it a little early."""

    def act(judge: Any_, module: MacSerial, _: bytes, request: Any) -> None:
        drive = module.axis.drive
        if request.command == 0x21 and drive.kind is not None:
            drive.ramped_stop(module._etx_ns)
        judge()

    frames(patch, act)


@mutant("MACS-Q-XX-02")
def one_unassigned_query_answers(patch: MonkeyPatch) -> None:
    """2Fh answers the release, though it is not assigned."""

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        judge(frame, request._replace(command=0x24) if request.command == 0x2F else request)

    frames(patch, act)


@mutant("MACS-Q-29-01")
def the_first_reading_of_eeprom_behind_one_of_ram_reads_ram(patch: MonkeyPatch) -> None:
    """The pointer of 28h is still set when the next 29h reads."""
    is_left = [False]

    def make(memory: Any_) -> Any_:
        def reading(axis: Axis, now: int, *, ram: bool) -> Any:
            is_wrong, is_left[0] = is_left[0] and not ram, ram
            return memory(axis, now, ram=ram or is_wrong)

        return reading

    wrap(patch, Axis, "memory", make)
