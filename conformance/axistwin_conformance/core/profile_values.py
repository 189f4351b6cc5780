"""How the value of a switch may be written in a profile, and how the suite spells it.

1. A reading is written as it is listed.  One that is a number may be written `17`, `11h` or `0x11`,
   as text or as a number of TOML; `true` also `yes`, `on` or `1`, `false` also `no`, `off` or `0`.
2. A switch whose readings are measured, and what a unit simply comes with (its factory values), has
   a range or a form here, by its name: every family means the same by it.
3. Two spellings of one value are one reading: what is returned is always spelled the same way.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

from axistwin_conformance.base.ledger import ANY_READING

WORDS_OF_TRUTH = {
    "true": "true", "yes": "true", "on": "true", "1": "true",
    "false": "false", "no": "false", "off": "false", "0": "false",
}  # fmt: skip
MOST_DIGITS = 32  # more than any switch has; Python itself refuses to read thousands of them
SIGN_32 = 1 << 31

DECIMAL = re.compile(r"-?[0-9]+")
HEX = re.compile(r"(?:0x([0-9a-f]+))|(?:([0-9a-f]+)h)")
HEX_READING = re.compile(r"([0-9A-F]+)h")


@dataclass(frozen=True, slots=True)
class Range:
    """Numbers from `low` to `high`; `digits`: spelled in so many hex digits, 0: in decimal ones."""

    low: int
    high: int
    digits: int = 0

    def read(self, value: str | int) -> str | None:
        """Return the value as it is always spelled; None if it is none of them."""
        number = number_of(value)
        if number is None:
            return None
        if self.low == -SIGN_32 and number // SIGN_32 == 1:
            number -= 2 * SIGN_32  # 80000000h: a field with a sign, in hex digits
        return self.spell(number) if self.low <= number <= self.high else None

    def spell(self, number: int) -> str:
        """Return a number of the range as it is always spelled."""
        if not self.digits:
            return str(number)
        return f"{number % (1 << 4 * self.digits):0{self.digits}X}h"

    @property
    def words(self) -> str:
        """What may be written, for a person."""
        return f"{self.spell(self.low)}..{self.spell(self.high)}"


@dataclass(frozen=True, slots=True)
class Form:
    """Text of a form; `read` returns it as it is always spelled, or None."""

    words: str
    of_text: Callable[[str], str | None]

    def read(self, value: str | int) -> str | None:
        """Return the value as it is always spelled; None if it has not that form."""
        return self.of_text(str(value).strip())


@dataclass(frozen=True, slots=True)
class Choice:
    """One of some readings, of which those that are numbers may be written in other ways."""

    readings: tuple[str, ...]

    def read(self, value: str | int) -> str | None:
        """Return the reading that is meant; None if it is none of them."""
        if set(self.readings) == {"true", "false"}:
            return WORDS_OF_TRUTH.get(str(value).strip().lower())
        if isinstance(value, bool):
            return None
        if str(value) in self.readings:
            return str(value)
        number = number_of(value)
        meant = (
            candidate
            for candidate in self.readings
            if number is not None and _is(candidate, number)
        )
        return next(meant, None)

    @property
    def words(self) -> str:
        """What may be written, for a person."""
        return " or ".join(self.readings)


def number_of(value: str | int) -> int | None:
    """The number that `17`, `11h`, `0x11`, or a number of TOML is; None for anything else."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int):
        return value
    text = value.strip().lower()
    if len(text) > MOST_DIGITS:
        return None
    if DECIMAL.fullmatch(text):
        return int(text)
    match = HEX.fullmatch(text)
    return int(match[1] or match[2], 16) if match else None


def _is(reading: str, number: int) -> bool:
    """True if a reading is that number; `011` is three digits and no number."""
    match = HEX_READING.fullmatch(reading)
    return int(match[1], 16) == number if match else reading == str(number)


def _braking(text: str) -> str | None:
    is_number = DECIMAL.fullmatch(text) and not text.startswith("-") and len(text) <= MOST_DIGITS
    return str(int(text)) if is_number and int(text) <= 0xFFFF else None


def _limits(text: str) -> str | None:
    """UNDER/OVER/VMAX/TRIP: bytes, the thresholds in their order, OVER within 5/4 of VMAX."""
    if not re.fullmatch(r"[0-9]{1,32}(/[0-9]{1,32}){3}", text):
        return None
    under, over, v_max, trip = (int(part) for part in text.split("/"))
    is_sound = max(under, over, v_max, trip) <= 0xFF and under < over <= v_max * 5 // 4
    return f"{under}/{over}/{v_max}/{trip}" if is_sound else None


def _error_codes(text: str) -> str | None:
    """Entries BITS/CODE/REGISTER in hex."""
    entry = r"[0-9A-Fa-f]{2}/[0-9A-Fa-f]{4}/[0-9A-Fa-f]{2}"
    return text.upper() if re.fullmatch(rf"{entry}(,{entry})*", text) else None


def _flag_map(text: str) -> str | None:
    """KIND:FIRST-LAST joined by slashes; no flag twice."""
    kinds = "input|output|timer|motor|user|unassigned"
    taken: set[int] = set()
    for entry in text.split("/"):
        match = re.fullmatch(rf"({kinds}):([0-9]{{1,3}})(?:-([0-9]{{1,3}}))?", entry)
        if match is None:
            return None
        first, last = int(match[2]), int(match[3] or match[2])
        flags = set(range(first, last + 1))
        if not first <= last <= 0xFF or (flags & taken and match[1] != "unassigned"):
            return None
        taken |= flags if match[1] != "unassigned" else set()
    return text


def _decimal(text: str) -> str | None:
    """A number with or without places, of which zeros at the end are left out."""
    if re.fullmatch(r"[0-9]{1,5}(\.[0-9]{1,3})?", text) is None:
        return None
    whole, _, places = text.partition(".")
    return f"{int(whole)}.{places.rstrip('0')}".rstrip(".")


def _duration(text: str) -> str | None:
    read = _decimal(text)
    return None if read == "0" else read


def _shown(text: str) -> str | None:
    return text if re.fullmatch(r"[ -~]{1,40}", text) else None


def _exit_code(text: str) -> str | None:
    digits = text.lstrip("0") if re.fullmatch("[0-9]+", text) else "none"
    return Range(0, 0xFF).read(digits or "0")


def _or(word: str, read: Callable[[str], str | None]) -> Callable[[str], str | None]:
    return lambda text: word if text == word else read(text)


MILLISECONDS, BYTE, LONG = Range(0, 60_000), Range(0, 0xFF, 2), Range(0, 0xFFFF_FFFF, 8)
POSITION = Range(-SIGN_32, SIGN_32 - 1, 8)

Value: TypeAlias = Range | Form | Choice

FORMS: Final[Mapping[str, Value]] = {
    "boot_time_ms": MILLISECONDS,
    "imax_value": Range(1, 0xFF, 2),
    "version_word": LONG,
    "emcy_trigger_mask": LONG,
    # `mixed` and `other`: seen of a device, and no twin does it.
    "reserved_bits": Choice(("0", "1", "mixed")),
    "mem_wrap": Choice(("wrap", "zero", "other")),
    "brake_increments": Form("plant, or a number 0..65535", _or("plant", _braking)),
    "mac34_limits": Form("model, or UNDER/OVER/VMAX/TRIP", _or("model", _limits)),
    "emcy_code_map": Form(
        "cia301, or BITS/CODE/REGISTER in 2/4/2 hex digits, separated by commas",
        _or("cia301", _error_codes),
    ),
    "reply_latency_us": Range(0, 1_000_000),
    "factory_standby": Choice(("1", "0")),
    "factory_stops": Choice(("0", "1", "8", "9")),
    "factory_superior_stop": POSITION,
    "factory_inferior_stop": POSITION,
    "factory_torque": BYTE,
    "factory_period": Range(1, 0xFFFF, 4),
    "factory_catchup": BYTE,
    "factory_ramp": BYTE,
    "factory_tolerance": BYTE,
    "ack_timeout_ms": Range(1, 60_000),
    "packet_timeout_ms": Range(1, 60_000),
    "reply_delay_ms": MILLISECONDS,
    "response_delay_ms": MILLISECONDS,
    "turnaround_ms": MILLISECONDS,
    "self_test_ms": MILLISECONDS,
    "scan_ms": Range(1, 60_000),
    "data_size": Range(128, 65_536),
    "auto_start": Choice(("false", "true")),
    "transport": Choice(("auto", "rs232", "rs485")),
    "poll_slot_ms": Form("auto, or milliseconds such as 14.5", _or("auto", _duration)),
    "long_max": Range(2_147_000_000, SIGN_32 - 1),
    "long_min": Range(-SIGN_32, -2_147_000_000),
    "rx_timeout_ms": Range(2, 60_000),
    "rx_payload_max": Range(1, 9000),
    "cc_capacity": Range(1, 100_000),
    "queue_depth": Range(0, 10_000),
    "nvm_size": Range(16, 65_536),
    "nvm_line_overhead": Range(0, 16),
    "arc_radius_tol": Form("steps such as 2.5", _decimal),
    "abort_exit_code": Form("keep, or 0..255", _or("keep", _exit_code)),
    "jog_hold_ms": Range(1, 60_000),
    "power_on_position": Range(-SIGN_32 + 1, SIGN_32 - 1),
    "firmware": Form("at most 40 printable characters of ASCII", _shown),
    "axes": Range(1, 4),
    "mn100_codes": Choice(("false", "true")),
    "motion_done": Choice(("at_once", "at_end")),
    "queue_full_code": Choice(("slavebuffov", "busy")),
    "start_null": Choice(("true", "false")),
    "flag_map": Form("generic, or KIND:FIRST-LAST/...", _or("generic", _flag_map)),
}


def value_of(switch: str, readings: Sequence[str] | None) -> Value:
    """How values of a switch are written; `readings`: those of the ledger, None: configuration."""
    if readings is None or ANY_READING in readings:
        return FORMS[switch]
    return Choice(tuple(readings))
