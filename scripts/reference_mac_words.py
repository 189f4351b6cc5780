"""What the commands and queries of a MAC are for: the hand-written part of its pages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

LONG_CANDIDATES: Final = tuple(
    sign * (1 << bits) + step
    for sign, bits in ((-1, 31), (-1, 30), (1, 0), (1, 30), (1, 31))
    for step in (-1, 0, 1)
    if -(1 << 31) <= sign * (1 << bits) + step < 1 << 31
)
"""Ends of 31 and 32 bits, and what lies about them and about 0."""

WORD_CANDIDATES: Final = (0, 1, 2, 0x7FFF, 0x8000, 0xFFFE, 0xFFFF)


@dataclass(frozen=True, slots=True)
class Field:
    """Digits of a command's parameter: their letters, lowest bit, width, and what they are.

    sample: the value in the example.  is_signed: two's complement.
    """

    letters: str
    shift: int
    bits: int
    meaning: str
    sample: int = 0
    is_signed: bool = False

    @property
    def mask(self) -> int:
        """Its bits in the 32 of the parameter."""
        return ((1 << self.bits) - 1) << self.shift

    def placed(self, value: int) -> int:
        """``value`` where it belongs in the parameter."""
        return value << self.shift & self.mask

    def candidates(self) -> Iterable[int]:
        """Values to try: all of a byte, the ends of the range of anything wider."""
        if self.bits == 8:
            return range(0x100)
        if self.bits == 16:
            words = WORD_CANDIDATES
            return sorted(map(signed_16, words)) if self.is_signed else words
        return LONG_CANDIDATES


@dataclass(frozen=True, slots=True)
class Command:
    """What a command is for.  cell: the nonvolatile value it sets."""

    title: str
    effect: str
    fields: tuple[Field, ...] = ()
    cell: str = ""

    @property
    def sample(self) -> int:
        """The parameter of the example."""
        return sum(field.placed(field.sample) for field in self.fields)


@dataclass(frozen=True, slots=True)
class Query:
    """What a query answers: its four bytes, and their meaning."""

    title: str
    layout: str
    meaning: str


def signed_16(word: int) -> int:
    """A 16-bit field as two's complement."""
    return word - 0x10000 if word >> 15 else word


def byte(letters: str, meaning: str, sample: int) -> tuple[Field, ...]:
    """A parameter that is the last byte."""
    return (Field(letters, 0, 8, meaning, sample),)


def position(meaning: str, sample: int) -> tuple[Field, ...]:
    """A parameter that is a signed number of all digits."""
    return (Field("dddddddd", 0, 32, meaning, sample, is_signed=True),)


SEGMENT: Final = (
    Field("DDDD", 16, 16, "increments, signed: the distance", 100, is_signed=True),
    Field("VVVV", 0, 16, "period in ticks of 0.125 µs per increment", 4000),
)
COMMANDS: Final[Mapping[int, Command]] = {
    0x00: Command(
        "re-initialise",
        "The module stops, drops motion, segments and latched faults, and starts anew.",
    ),
    0x01: Command(
        "restore the factory values",
        "All stored parameters and the address get their factory values; the position stays."
        " Then the module starts anew.",
    ),
    0x02: Command(
        "torque at rest",
        "The torque with which the motor holds its place.",
        byte("dd", "0: nominal torque; 1: half of it (standby)", 0),
        "standby",
    ),
    0x03: Command(
        "enable the stops",
        "Which end-stops end a motion.",
        byte("dd", "0: none; 1: hardware; 8: software; 9: both", 9),
        "stops",
    ),
    0x07: Command(
        "reference input",
        "While it is enabled, the reference contact sets the counter to 0 when it opens during a"
        " motion in the positive direction. A start-up disables it.",
        byte("dd", "0: disabled; 1: enabled", 1),
    ),
    0x08: Command(
        "set the address",
        "The module takes the address. A host sends this to the general address FF, with one"
        " module on the line.",
        byte("dd", "new address", 5),
        "address",
    ),
    0x09: Command(
        "superior software stop",
        "A position above it ends a motion with maximum braking, if 03h enables software stops.",
        position("position in increments", 50000),
        "superior_stop",
    ),
    0x0A: Command(
        "inferior software stop",
        "A position below it ends a motion with maximum braking, if 03h enables software stops.",
        position("position in increments", -50000),
        "inferior_stop",
    ),
    0x0B: Command(
        "set the position to 0",
        "The position counter becomes 0; the shaft does not move.",
    ),
    0x0C: Command(
        "torque limit",
        "The largest torque, as a part of Imax (`imax_value`).",
        byte("dd", "torque limit, 0 to Imax", 0x40),
        "torque",
    ),
    0x0D: Command(
        "maximum speed",
        "The speed of 13h and 14h after their ramp.",
        (Field("VVVV", 0, 16, "period in ticks of 0.125 µs per increment", 800),),
        "period",
    ),
    0x0E: Command(
        "catch-up speed",
        "How fast the module makes up for increments that it could not follow.",
        (
            Field("VV", 8, 8, "period, in 200 µs per increment", 5),
            Field("00", 0, 8, "always 00", 0),
        ),
        "catchup",
    ),
    0x0F: Command(
        "ramp",
        "The length of the ramps of 13h, 14h, 15h and 17h. 0: no ramp.",
        byte("AA", "ramp coefficient: 120 increments each", 10),
        "ramp",
    ),
    0x10: Command(
        "wait for synchronisation",
        "The next motion of 13h, 14h or 15h is accepted and held back until 11h starts it.",
    ),
    0x11: Command(
        "synchronise",
        "The motion that 10h has held back starts. To the general address it starts all modules"
        " together.",
    ),
    0x13: Command(
        "go to a position",
        "The motor is powered and moves to the position: a ramp up, the speed of 0Dh, a ramp down.",
        position("target in increments", 1000),
    ),
    0x14: Command("go to position 0", "The same as 13h with the target 0."),
    0x15: Command(
        "run at a speed",
        "The motor is powered and runs without an end. During such a motion the command changes"
        " the speed, never the direction. Period 0 stops with the ramp.",
        (
            Field("SS", 16, 8, "direction: F6 negative, anything else positive", 0),
            Field("VVVV", 0, 16, "period in ticks of 0.125 µs per increment; 0: stop", 800),
        ),
    ),
    0x16: Command(
        "segment",
        "The motor moves the distance at a constant speed, without a ramp. Three segments can"
        " wait; the module refuses a further one.",
        SEGMENT,
    ),
    0x17: Command(
        "stop with the ramp",
        "Motions of 13h, 14h and 15h end with the ramp; the motor stays powered. Segments go on.",
    ),
    0x18: Command(
        "stop without a ramp",
        "Any motion ends with maximum braking. Waiting segments and a held-back motion are"
        " dropped.",
    ),
    0x19: Command("power the motor", "The motor holds its place."),
    0x1A: Command(
        "cut the motor's power",
        "The motor has no torque from now on, also in motion: nothing brakes it.",
    ),
    0x1B: Command(
        "set the rate",
        "The module acknowledges at the old rate, then starts anew at the new one.",
        byte("dd", "1: 9600 baud; 2: 19200 baud; 3: 38400 baud", 3),
        "baud",
    ),
    0x1C: Command(
        "tolerance",
        "How far from its target a position motion is no longer busy.",
        byte("dd", "increments", 5),
        "tolerance",
    ),
    0x1E: Command(
        "virtual segment",
        "A segment that takes its time and does not move.",
        SEGMENT,
    ),
}
QUERIES: Final[Mapping[int, Query]] = {
    0x20: Query("position", "dddddddd", "position in increments, signed"),
    0x21: Query(
        "status", "dd ff gg hh", "faults and warnings, stops, reserved, memory; see the bits"
    ),
    0x22: Query("superior software stop", "dddddddd", "position in increments, signed"),
    0x23: Query("inferior software stop", "dddddddd", "position in increments, signed"),
    0x24: Query("release", "dddddddd", "identifies the release; the manual does not give its form"),
    0x25: Query("speeds", "rr 00 vvvv", "catch-up period of 0Eh, 0, period of 0Dh"),
    0x26: Query(
        "ramp, torque, modes",
        "nn cc Km tt",
        "ramp of 0Fh, torque limit of 0Ch, 02h (K) and 03h (m), tolerance of 1Ch",
    ),
    0x27: Query("measures", "tt vv cc dd", "temperature, supply, inputs and state; see the bits"),
    0x28: Query("RAM", "dddddddd", "four bytes of the RAM, from the address in the sub-index on"),
    0x29: Query(
        "EEPROM", "dddddddd", "four bytes of the EEPROM, from the address in the sub-index on"
    ),
}
assert not set(COMMANDS) & set(QUERIES)
