"""Faults of parameters: which numbers are taken, and which texts are numbers (ERR, PAR, CMD)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from axistwin.devices.mn400 import grammar
from axistwin.devices.mn400.commands import Interpreter
from axistwin.devices.mn400.grammar import Omitted, ParameterError
from zoo_mn400.planting import (
    Any_,
    MonkeyPatch,
    around,
    board_mutant,
    commands,
    fits,
    parameter,
    settles,
    values,
)

# --- texts ----------------------------------------------------------------------------------------


def _numbers(patch: MonkeyPatch, act: Any_) -> None:
    """Let `act(go, field)` read a parameter."""
    read = grammar._number
    patch.setattr(grammar, "_number", lambda field: act(lambda other=field: read(other), field))


@board_mutant("MN4-PAR-02", traps=(44,))
def a_plus_is_taken(patch: MonkeyPatch) -> None:
    """+5 is 5."""
    _numbers(patch, lambda go, field: go(field.removeprefix(b"+")))


@board_mutant("MN4-PAR-02", traps=(44,))
def a_fraction_is_cut_off(patch: MonkeyPatch) -> None:
    """5.0 is 5."""
    _numbers(patch, lambda go, field: go(field.partition(b".")[0]) if b"." in field else go())


@board_mutant("MN4-PAR-02", traps=(44,))
def letters_end_a_number(patch: MonkeyPatch) -> None:
    """10a is 10."""

    def act(go: Any_, field: bytes) -> Any:
        return go(field.rstrip(b"abcdefghijklmnopqrstuvwxyz"))

    _numbers(patch, act)


@board_mutant("MN4-PAR-03", traps=(44,))
def a_lone_minus_is_zero(patch: MonkeyPatch) -> None:
    """- is 0."""
    _numbers(patch, lambda go, field: 0 if field == b"-" else go())


@board_mutant("MN4-PAR-03", traps=(44,))
def a_minus_may_stand_behind(patch: MonkeyPatch) -> None:
    """1-2 is 1."""

    def act(go: Any_, field: bytes) -> Any:
        return go(field[:1] + field[1:].partition(b"-")[0])

    _numbers(patch, act)


@board_mutant("MN4-PAR-08", traps=(44,))
def leading_zeros_are_refused(patch: MonkeyPatch) -> None:
    """007 is malformed."""

    def act(go: Any_, field: bytes) -> Any:
        digits = field.removeprefix(b"-")
        if len(digits) > 1 and digits[:1] == b"0":
            raise ParameterError
        return go()

    _numbers(patch, act)


@board_mutant("MN4-PAR-08", traps=(44,))
def a_leading_zero_means_base_8(patch: MonkeyPatch) -> None:
    """010 is 8, and 08 is 8."""

    def act(go: Any_, field: bytes) -> Any:
        digits = field.removeprefix(b"-")
        is_octal = digits[:1] == b"0" and not set(digits) - set(b"01234567")
        return go(b"%d" % int(field, 8)) if is_octal else go()

    _numbers(patch, act)


@board_mutant("MN4-PAR-01")
def capitals_only(patch: MonkeyPatch) -> None:
    """Commands in lower case are unknown."""

    def act(go: Any_, one: Interpreter, now: int, payload: bytes, *rest: Any) -> Any:
        if payload[:1].islower():
            payload = b"@" + payload[1:]
        return go(now, payload, *rest)

    around(patch, Interpreter, "obey", act)


@board_mutant("MN4-PAR-01")
def m_is_written_large(patch: MonkeyPatch) -> None:
    """M alone of all commands is unknown in lower case."""

    def act(go: Any_, one: Interpreter, now: int, payload: bytes, *rest: Any) -> Any:
        return go(now, payload.replace(b"m", b"@", 1), *rest)

    around(patch, Interpreter, "obey", act)


@board_mutant("MN4-ERR-01")
def digits_are_a_command(patch: MonkeyPatch) -> None:
    """A packet that begins with a digit is taken for L with no parameters."""

    def act(go: Any_, one: Interpreter, now: int, payload: bytes, *rest: Any) -> Any:
        return go(now, b"L" if payload[:1].isdigit() else payload, *rest)

    around(patch, Interpreter, "obey", act)


@board_mutant("MN4-ERR-01")
def w_is_a_command(patch: MonkeyPatch) -> None:
    """W does what | does."""

    def act(go: Any_, one: Interpreter, now: int, payload: bytes, *rest: Any) -> Any:
        return go(now, b"|" if payload[:1] == b"W" else payload, *rest)

    around(patch, Interpreter, "obey", act)


# --- numbers --------------------------------------------------------------------------------------


@board_mutant("MN4-PAR-04", traps=(30,))
def short_numbers_are_cut_to_16_bits(patch: MonkeyPatch) -> None:
    """B65537 is B1."""

    def act(go: Any_, one: Any, value: int) -> Any:
        return go() if one.is_long else go((value + 32768) % 65536 - 32768)

    fits(patch, act)


@board_mutant("MN4-PAR-05", traps=(30,))
def long_numbers_are_cut_to_32_bits(patch: MonkeyPatch) -> None:
    """L4294967297 is L1."""

    def act(go: Any_, one: Any, value: int) -> Any:
        half = 1 << 31
        return go((value + half) % (2 * half) - half) if one.is_long else go()

    fits(patch, act)


@board_mutant("MN4-PAR-05")
def long_numbers_stop_at_the_end(patch: MonkeyPatch) -> None:
    """L3000000000 is the greatest number."""

    def act(go: Any_, one: Any, value: int) -> Any:
        return go(max(-(2**31 - 1), min(value, 2**31 - 1))) if one.is_long else go()

    fits(patch, act)


@board_mutant("MN4-ERR-02", traps=(31,))
def what_is_right_is_taken_before_the_error(patch: MonkeyPatch) -> None:
    """Of L1,2,x the first two counters are loaded."""

    def act(go: Any_, one: Interpreter, line: Any, known: Any, how: Any) -> Any:
        try:
            return go()
        except ParameterError:
            first = line.text.partition(b",")[0]
            if known.letter == "L" and first.lstrip(b"-").isdigit() and len(first) < 9:
                one._mover.load(line.now, (int(first), None, None, None))
            raise

    around(patch, Interpreter, "_treat", act)


def _obeyed_all_the_same(patch: MonkeyPatch, letter: str, change: Any_) -> None:
    """Let a command that is refused be obeyed with `change(text)` for what follows its letter."""

    def act(go: Any_, one: Interpreter, line: Any, known: Any, how: Any) -> Any:
        try:
            return go()
        except ParameterError:
            if known.letter == letter:
                go(line._replace(text=change(line.text)), known, how)
            raise

    around(patch, Interpreter, "_treat", act)


@board_mutant("MN4-ERR-02")
def the_first_backlash_is_taken_before_the_error(patch: MonkeyPatch) -> None:
    """B150,-1,0,0 is refused, and sets 150 for the first axis."""
    _obeyed_all_the_same(patch, "B", lambda text: text.partition(b",")[0])


@board_mutant("MN4-ERR-02")
def the_first_direction_is_taken_before_the_error(patch: MonkeyPatch) -> None:
    """D-1,0,1,1 is refused, and sets -1 for the first axis."""
    _obeyed_all_the_same(patch, "D", lambda text: text.partition(b",")[0])


@board_mutant("MN4-ERR-02")
def the_motors_before_the_error_are_taken(patch: MonkeyPatch) -> None:
    """P2,1,5 is refused, and sets motors 2 and 1."""
    _obeyed_all_the_same(patch, "P", lambda text: text.rpartition(b",")[0])


@board_mutant("MN4-ERR-02")
def a_speed_out_of_range_is_the_greatest(patch: MonkeyPatch) -> None:
    """V200000 is refused, and sets 100000."""
    _obeyed_all_the_same(patch, "V", lambda text: b"100000")


def _wider(letter: str, index: int | None, requirement: str, text: str, **changes: Any) -> Any:
    """A mutant whose command takes one value more."""

    def alter(patch: MonkeyPatch) -> None:
        parameter(patch, letter, index, **changes)

    alter.__name__, alter.__doc__ = text.replace(" ", "_"), f"{text[0].upper()}{text[1:]}."
    return board_mutant(requirement)(alter)


three_is_a_multiplex = _wider("X", 0, "MN4-CMD-X-01", "three is a multiplex", allowed=(1, 2, 3, 4))
zero_is_a_multiplex = _wider("X", 0, "MN4-CMD-X-01", "zero is a multiplex", allowed=(0, 1, 2, 4))
zero_is_an_id = _wider("=", 0, "MN4-CMD-ADDR-02", "zero is an id", low=0)
ids_go_up_to_255 = _wider("=", 0, "MN4-CMD-ADDR-02", "ids go up to 255", high=255)
zero_is_a_direction = _wider("D", None, "MN4-CMD-D-01", "zero is a direction", allowed=(0, 1, -1))
a_tap_may_be_zero = _wider("G", None, "MN4-CMD-G-02", "a tap may be zero", low=0)
feed_hold_has_three_modes = _wider(
    ";", 0, "MN4-ERR-02", "feed hold has three modes", allowed=(0, 1, 2)
)
an_output_has_three_states = _wider(
    "C", 1, "MN4-CMD-C-03", "an output has three states", allowed=(0, 1, 2)
)
a_speed_is_at_most_10000 = _wider("V", 0, "MN4-ERR-02", "a speed is at most 10000", high=10_000)
backlash_is_at_most_255 = _wider("B", None, "MN4-ERR-02", "backlash is at most 255", high=255)
an_id_is_at_most_99 = _wider("=", 0, "MN4-CMD-ADDR-01", "an id is at most 99", high=99)


@board_mutant("MN4-CMD-BAUD-02")
def a_rate_of_five_is_9600(patch: MonkeyPatch) -> None:
    """~5 draws BAUDCHANGEOK."""
    parameter(patch, "~", 0, high=5)

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        return go(line, (0,) if given == (5,) else given)

    around(patch, Interpreter, "_set_rate", act)


@board_mutant("MN4-CMD-C-03")
def port_nine_is_port_eight(patch: MonkeyPatch) -> None:
    """C9,0 draws DONE."""
    parameter(patch, "C", 0, high=9)
    commands(patch, "C", lambda go, one, line, given: go((min(given[0], 8), given[1])))


@board_mutant("MN4-CMD-C-03")
def there_is_no_port_eight(patch: MonkeyPatch) -> None:
    """C8,1 draws PARA_ERROR."""
    parameter(patch, "C", 0, high=7)


@board_mutant("MN4-CMD-P-02")
def both_motors_of_a_plane_may_be_one(patch: MonkeyPatch) -> None:
    """P1,1 is taken for P1,3."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        return go((1, 3, given[2]) if given[0] == given[1] else given)

    commands(patch, "P", act)


@board_mutant("MN4-CMD-L-01")
def two_counters_are_exchanged(patch: MonkeyPatch) -> None:
    """L loads axis 2 with what is for axis 1."""

    def load(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        return go((given[1], given[0], *given[2:]))

    commands(patch, "L", load)


@board_mutant("MN4-CMD-L-01")
def counters_are_added_to(patch: MonkeyPatch) -> None:
    """L adds to what the counters have."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        now = one._mover.position_at(line.now)
        return go(tuple(None if n is None else n + was for n, was in zip(given, now, strict=True)))

    commands(patch, "L", act)


@board_mutant("MN4-CMD-EXIT-03", "MN4-CMD-EXIT-04")
def the_exit_code_cannot_be_cleared(patch: MonkeyPatch) -> None:
    """| is answered and does nothing; the code is 2 from the beginning."""
    values(patch, "/", lambda text, readout, now: "2")


@board_mutant("MN4-CMD-FH-02")
def feed_hold_is_shown_the_other_way_round(patch: MonkeyPatch) -> None:
    """The second field of : is 1 after ;0."""

    def change(text: str, readout: Any, now: int) -> str:
        first, second, rest = text.split(",", 2)
        return f"{first},{1 - int(second)},{rest}"

    values(patch, ":", change)


@board_mutant("MN4-CMD-SW-01")
def there_are_four_flags(patch: MonkeyPatch) -> None:
    """: leaves AbortFlag out."""
    values(patch, ":", lambda text, readout, now: text.rpartition(",")[0])


@board_mutant("MN4-CMD-E-01")
def there_are_three_counters(patch: MonkeyPatch) -> None:
    """E leaves axis 4 out."""
    values(patch, "E", lambda text, readout, now: text.rpartition(",")[0])


@board_mutant("MN4-CMD-N-01")
def what_is_left_is_one_number(patch: MonkeyPatch) -> None:
    """N tells the axis with the most."""
    values(patch, "N", lambda text, readout, now: str(max(map(int, text.split(",")), key=abs)))


@board_mutant("MN4-CMD-FW-01")
def the_revision_has_no_slash(patch: MonkeyPatch) -> None:
    """? tells MN400 V 1.08."""
    values(patch, "?", lambda text, readout, now: text.partition(" /")[0])


@board_mutant("MN4-CMD-SHD-01", "MN4-CMD-SW-01", traps=(27,))
def the_two_flags_of_the_shield_part(patch: MonkeyPatch) -> None:
    """[ tells the shield the first time, and the switch from then on."""

    def change(text: str, readout: Any, now: int) -> str:
        readout.asked = getattr(readout, "asked", 0) + 1
        return text if readout.asked % 2 else str(1 - int(text))

    values(patch, "[", change)


@board_mutant("MN4-CMD-S-01", "MN4-CMD-S-02", traps=(25,))
def inputs_have_15_bits(patch: MonkeyPatch) -> None:
    """Aux 8 is not in S."""
    values(patch, "S", lambda text, readout, now: str(int(text) & 0x7FFF))


@board_mutant("MN4-CMD-S-01", traps=(25,))
def auxiliary_inputs_come_first(patch: MonkeyPatch) -> None:
    """The two bytes of S are exchanged."""

    def change(text: str, readout: Any, now: int) -> str:
        word = int(text)
        return str((word & 0xFF) << 8 | word >> 8)

    values(patch, "S", change)


@board_mutant("MN4-MEA-01", "MN4-MEA-02", "MN4-MEA-03")
def a_measurement_is_over_at_once(patch: MonkeyPatch) -> None:
    """E1 counts for 10 ms, E2 for 100."""
    from axistwin.devices.mn400 import readout

    patch.setitem(readout.MEASURES_MS, 1, 10)
    patch.setitem(readout.MEASURES_MS, 2, 100)


@board_mutant("MN4-PAR-06", traps=(1,))
def trailing_parameters_are_required(patch: MonkeyPatch) -> None:
    """M1000 lacks three parameters."""
    parameter(patch, "M", None, omitted=Omitted.REQUIRED)


@board_mutant("MN4-PAR-06", traps=(1,))
def an_omitted_axis_goes_to_zero(patch: MonkeyPatch) -> None:
    """In absolute mode M,,-100 drives the other axes to 0."""
    parameter(patch, "M", None, omitted=0)


@board_mutant("MN4-CMD-E-03")
def a_multiplex_is_not_kept(patch: MonkeyPatch) -> None:
    """X is answered and sets nothing."""
    settles(patch, "X", lambda after, before: replace(after, multiplex=before.multiplex))


@board_mutant("MN4-CMD-F-01")
def an_acceleration_has_sixteen_bits(patch: MonkeyPatch) -> None:
    """F1000,5000,80000 ramps at 14464."""
    settles(
        patch, "F", lambda after, _: replace(after, acceleration=after.acceleration & 0xFFFF or 1)
    )


@board_mutant("MN4-CMD-B-01")
def backlash_has_eight_bits(patch: MonkeyPatch) -> None:
    """B300,0,0,0 takes up 44 steps."""
    settles(
        patch, "B", lambda after, _: replace(after, lash=tuple(one & 0xFF for one in after.lash))
    )


def _defaults(letter: str, text: str, *values: int) -> Any:
    """A mutant that takes the power-on value for what a setting leaves out."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        rows = zip(given, values, strict=True)
        return go(tuple(usual if value is None else value for value, usual in rows))

    def alter(patch: MonkeyPatch) -> None:
        commands(patch, letter, act)

    alter.__name__, alter.__doc__ = text.replace(" ", "_"), f"{text[0].upper()}{text[1:]}."
    return board_mutant("MN4-PAR-09")(alter)


a_profile_that_leaves_a_value_out_resets_it = _defaults(
    "F", "a profile that leaves a value out resets it", 1000, 5000, 10_000
)
backlash_that_is_left_out_is_none = _defaults("B", "backlash that is left out is none", 0, 0, 0, 0)
a_direction_that_is_left_out_is_positive = _defaults(
    "D", "a direction that is left out is positive", 1, 1, 1, 1
)
a_traverse_motor_that_is_left_out_is_motor_2 = _defaults(
    "P", "a traverse motor that is left out is motor 2", 1, 3, 2
)
