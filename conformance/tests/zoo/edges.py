"""Faults at the edges of fields: a bit too few, a sign lost, one too many or too few."""

from __future__ import annotations

from axistwin.devices.mac.axis import axis as axis_module
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.drive import Drive
from axistwin.devices.mac.axis.parameters import Parameters
from axistwin.devices.mac.serial import device as serial
from zoo.mutant import Any_, MonkeyPatch, answers, mutant, on, setter, target_of, wrap


def _signed(number: int, bits: int = 32) -> int:
    """The lower bits of a number, with their sign."""
    number &= (1 << bits) - 1
    return number - (1 << bits) if number >> bits - 1 else number


@mutant("MACS-FRAME-05", "MACS-CMD-13-01")
def targets_have_16_bits(patch: MonkeyPatch) -> None:
    """13h takes the lower 16 bits of its target, with their sign."""
    on(patch, 0x13, lambda go, axis, now, n: go(_signed(n, 16)))


@mutant("MACS-CMD-13-01")
def a_move_down_ends_one_increment_early(patch: MonkeyPatch) -> None:
    """13h to a place below ends one above it."""
    on(patch, 0x13, lambda go, axis, now, n: go(n + (_signed(n) < axis.counter_at(now))))


@mutant("MACS-CMD-13-04")
def a_move_of_no_length_has_one_increment(patch: MonkeyPatch) -> None:
    """13h to the present place goes one further."""
    on(patch, 0x13, lambda go, axis, now, n: go(n + (_signed(n) == axis.counter_at(now))))


@mutant("MACS-CMD-14-01")
def going_to_0_from_below_ends_at_minus_1(patch: MonkeyPatch) -> None:
    """14h from a negative place ends one short."""

    def going(axis: Axis, now: int, _: int, start_ns: int) -> bool:
        return axis._go_to(now, 0xFFFFFFFF if axis.counter_at(now) < 0 else 0, start_ns)

    patch.setitem(axis_module._COMMANDS, 0x14, going)


@mutant("MACS-Q-20-01")
def positions_have_16_bits(patch: MonkeyPatch) -> None:
    """20h tells the lower 16 bits, with their sign."""
    answers(patch, 0x20, lambda value, axis, now: _signed(value, 16))


@mutant("MACS-Q-20-01")
def positions_are_told_by_magnitude(patch: MonkeyPatch) -> None:
    """20h tells a negative position as its magnitude, with the highest bit set."""
    answers(
        patch, 0x20, lambda value, axis, now: 0x80000000 - _signed(value) if value >> 31 else value
    )


@mutant("MACS-CMD-0A-01", "MACS-Q-23-01")
def the_inferior_stop_has_16_bits(patch: MonkeyPatch) -> None:
    """0Ah keeps the lower 16 bits of its number, with their sign."""
    setter(patch, 0x0A, lambda n: _signed(n, 16) & 0xFFFFFFFF)


@mutant("MACS-PERS-01")
def stops_are_stored_in_16_bits(patch: MonkeyPatch) -> None:
    """Software stops come back with the lower 16 bits, and their sign."""

    def make(store: Any_) -> Any_:
        def storing(parameters: Parameters, name: str, value: int) -> None:
            store(parameters, name, _signed(value, 16) if name.endswith("_stop") else value)

        return storing

    wrap(patch, Parameters, "store", make)


@mutant("MACS-CMD-0C-01")
def the_torque_limit_has_seven_bits(patch: MonkeyPatch) -> None:
    """0Ch keeps seven bits, so that 80h is 0."""
    setter(patch, 0x0C, lambda n: n & 0x7F)


@mutant("MACS-CMD-0D-01")
def the_period_has_fifteen_bits(patch: MonkeyPatch) -> None:
    """0Dh keeps fifteen bits, as of a signed word."""
    setter(patch, 0x0D, lambda n: n & 0x7FFF)


@mutant("MACS-CMD-0E-01")
def the_catch_up_speed_has_seven_bits(patch: MonkeyPatch) -> None:
    """0Eh keeps seven bits."""
    setter(patch, 0x0E, lambda n: n & ~0x8000)


@mutant("MACS-CMD-15-01")
def the_speed_has_fifteen_bits(patch: MonkeyPatch) -> None:
    """15h takes fifteen bits of its period, and none of them for the longest."""
    on(patch, 0x15, lambda go, axis, now, n: go(n & ~0x8000 | (n & 0x7FFF == 0 < n & 0x8000)))


@mutant("MACS-CMD-16-01")
def segments_have_eight_bits(patch: MonkeyPatch) -> None:
    """16h takes eight bits of its steps, with their sign."""
    on(patch, 0x16, lambda go, axis, now, n: go(_signed(n >> 16, 8) << 16 | n & 0xFFFF))


@mutant("MACS-CMD-16-01")
def the_period_of_a_segment_has_fifteen_bits(patch: MonkeyPatch) -> None:
    """16h takes fifteen bits of its period."""
    on(patch, 0x16, lambda go, axis, now, n: go(n & ~0x8000))


@mutant("MACS-CMD-1E-01")
def virtual_segments_have_eight_bits(patch: MonkeyPatch) -> None:
    """1Eh takes eight bits of its count."""
    on(patch, 0x1E, lambda go, axis, now, n: go(n & 0x00FFFFFF))


@mutant("MACS-CMD-08-01")
def a_new_address_has_six_bits(patch: MonkeyPatch) -> None:
    """08h takes 40h and above for 00h and above."""
    program = serial._FACE_COMMANDS[0x08]
    patch.setitem(
        serial._FACE_COMMANDS,
        0x08,
        lambda module, n, general: program(module, n if n & 0x80 else n & ~0x40, general),
    )


@mutant("MACS-CMD-1A-02")
def turns_by_hand_count_up(patch: MonkeyPatch) -> None:
    """A shaft turned by hand counts up, whichever way it is turned."""
    wrap(patch, Drive, "push", lambda push: lambda drive, now, n: push(drive, now, abs(n)))


@mutant("MACS-CMD-11-01")
def a_preloaded_speed_loses_its_sign(patch: MonkeyPatch) -> None:
    """11h starts a 15h that was held back in the positive direction."""

    def make(start: Any_) -> Any_:
        def starting(axis: Axis, now: int, held: tuple[int, int], start_ns: int) -> bool:
            index, n = held
            return bool(start(axis, now, (index, n & 0xFFFF if index == 0x15 else n), start_ns))

        return starting

    wrap(patch, Axis, "_start_held", make)


@mutant("MACS-Q-20-02", "MACS-PERS-01")
def each_power_off_loses_an_increment(patch: MonkeyPatch) -> None:
    """The counter comes back one less."""

    def make(power_on: Any_) -> Any_:
        def powering_on(axis: Axis, now: int) -> None:
            power_on(axis, now)
            axis.drive.counter.set(now, axis.counter_at(now) - 1)

        return powering_on

    wrap(patch, Axis, "power_on", make)


@mutant("MACS-CMD-13-02")
def a_move_to_where_it_goes_anyway_is_accepted(patch: MonkeyPatch) -> None:
    """13h during 13h is accepted, and changes nothing, if its target is the same."""

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        return target_of(axis.drive) == number - (number >> 31 << 32) or bool(go())

    on(patch, 0x13, act)
