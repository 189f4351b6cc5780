"""Twins of drawn readings: one switch at any of its values, two, or a pool of them."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from typing import Final

from axistwin.catalog import models
from axistwin.devices.switches import Quirk
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.families.catalog import find_family
from sweeping.runs import Row

NEAR = 0.05  # a number that a device shows is measured
# Beyond these a device breaks a requirement (MACS-CMD-00-02, MACS-REPLY-16, MSC-LNK-17), leaves
# the host no time for its sign (MSC-LNK-08), is not there within the time in which a device is
# found, or has a program that no machine could use.
SOUND: Mapping[str, tuple[int, int]] = {
    "boot_time_ms": (1500, 2400),
    "reply_latency_us": (0, 450_000),
    "imax_value": (0x60, 0xFF),  # what 01h stores, and the manual's example, are no more
    "packet_timeout_ms": (260, 60_000),
    "ack_timeout_ms": (100, 60_000),
    "response_delay_ms": (0, 3000),
    "reply_delay_ms": (0, 3000),
    "turnaround_ms": (0, 3000),
    "scan_ms": (1, 100),
    "self_test_ms": (0, 5000),
    "data_size": (8192, 65_536),  # of which the sweep names variables, and the bench program some
    "rx_timeout_ms": (50, 2000),
    "rx_payload_max": (69, 9000),  # MN4-PKT-13
    "queue_depth": (2, 1000),  # "multiple commands"
    "cc_capacity": (5, 1000),  # the segments of the manual's example
    "jog_hold_ms": (50, 2000),
}
STEPS: Mapping[str, int] = {"data_size": 2}  # an area that ends within a variable holds no use
# Switches that a device of that model cannot have at another value: MACS-CMD-1C-01, MACC-CMD-0C-01.
FIXED: Mapping[str, frozenset[str]] = {
    "mac23": frozenset({"factory_tolerance"}),
    "mac23-can": frozenset({"factory_tolerance", "imax_value"}),
    "msc-250": frozenset(),
    "mn400": frozenset({  # those of its predecessor, and a store of the size that the manual says
        "start_null", "motion_done", "queue_full_code", "mn100_codes", "axes", "firmware",
        "transport", "nvm_size", "response_delay_ms",
    }),
}  # fmt: skip
# Neighbours that look for packets in those of others and refuse what they find drown every reply
# on the line; the manual has the unit that is named answer, and no other (MSC-PHY-03).
DROWNING: Final = frozenset({("other_unit_framing", "hunt_stx"), ("invalid_unit", "nak")})
# A motor without any torque moves no shaft that has inertia: nothing of a motion can be judged
# (MACS-CMD-0C-01: torque = maximum·dd/Imax; MACS-CMD-0F-03).
POWERLESS: Final = frozenset({("plant", "inertial"), ("factory_torque", "0")})
# Where H has no parameter, hold once on goes off by one of these or never (MN4-CMD-H-02).
HELD: Final = frozenset({("hold_takes_arg", "false")})
LET_GO: Final = (("hold_bare_arg", "toggle"), ("hold_after_release", "one_shot"))
# What a unit does with other numbers on RS-232 it never shows on RS-485 (MSC-AMB-12).
UNSEEN: Final = tuple(
    frozenset({("transport", "rs485"), ("rs232_unit_check", one)}) for one in ("ignore", "nak")
)
# An axis that halts alone, beside others that go on, halts at once (MN4-AMB-47).
UNRAMPED: Final = frozenset({("limit_halts", "axis"), ("limit_ramp", "true")})
UNSOUND: Final = (DROWNING, POWERLESS, *UNSEEN, UNRAMPED)  # readings of which no device has all
# Counters that a board shows at power-up and that L does not load are never put back.
COUNTERS: Final = ("long_min", "power_on_position", "long_max")
FURTHEST: Final = ("-2147483647", "0", "2147483647")  # the defaults of these
# Texts have no values to draw from, and of a mask not every number is one (MACC-EMCY-02).
VALUES: Mapping[str, tuple[str, ...]] = {
    "brake_increments": ("0", "1", "30", "300", "900"),
    "poll_slot_ms": ("20", "50"),
    "arc_radius_tol": ("0.7", "2.0", "5.0"),
    "abort_exit_code": ("1", "255", "keep"),
    "emcy_trigger_mask": ("FFFFFFFFh", "FF0F0000h", "FF000080h"),
    "mac34_limits": ("24/60/64/85",),
    "emcy_code_map": (
        "10/4210/09,01/3110/05,40/3210/05,20/3220/05", "40/3210/05,20/3220/05,01/3100/05",
    ),
}  # fmt: skip


def go_together(readings: Mapping[str, str]) -> bool:
    """False for readings that no sound device has at once."""
    low, place, high = (
        int(readings.get(name, default)) for name, default in zip(COUNTERS, FURTHEST, strict=True)
    )
    is_loadable = low <= place <= high
    if readings.items() >= HELD and not any(one in readings.items() for one in LET_GO):
        return False
    is_unsound = any(readings.items() >= unsound for unsound in UNSOUND)
    return is_loadable and not is_unsound and _takes_its_own_torque(readings)


def _takes_its_own_torque(readings: Mapping[str, str]) -> bool:
    """False if a module refuses the torque that it has from the factory, its own highest one: no
    host puts that back."""
    imax = int(readings.get("imax_value", "128"))
    torque = int(readings.get("factory_torque", "96"))
    return readings.get("torque_range") != "exclusive" or torque < imax


def values_of(quirk: Quirk, draw: random.Random) -> tuple[str, ...]:
    """Every value but the default; of a number the ends and some between."""
    if quirk.name in VALUES:
        return VALUES[quirk.name]
    if quirk.kind == "number":
        default = quirk.parse(quirk.default)
        assert isinstance(default, int)
        low, high = SOUND.get(quirk.name, (quirk.low, quirk.high))
        between = [low + int((high - low) ** draw.random()) for _ in range(3)]
        step = STEPS.get(quirk.name, 1)
        near = [one for one in (default - step, default + step) if low <= one <= high]
        found = {one - one % step for one in (low, high, *near, *between)} - {default}
        return tuple(str(one) for one in sorted(found))
    if quirk.kind == "text":
        return ()
    return tuple(one for one in quirk.allowed if one != quirk.default)


def open_to(model: str) -> Mapping[str, Quirk]:
    """The switches of which a device of that model may have any value."""
    quirks = models()[model].quirks
    return {name: one for name, one in quirks.items() if name not in FIXED.get(model, ())}


def singles(model: str, seed: str) -> list[dict[str, str]]:
    """Every switch at each of its other values."""
    draw = random.Random(seed)
    quirks = open_to(model)
    known = ({name: one} for name, quirk in quirks.items() for one in values_of(quirk, draw))
    return [one for one in known if go_together(one)]


def drawn(model: str, seed: str) -> Iterator[dict[str, str]]:
    """Without end: two switches at once, and every third time one."""
    draw = random.Random(seed)
    while True:
        quirks = open_to(model)
        known = [name for name, quirk in quirks.items() if values_of(quirk, draw)]
        names = draw.sample(known, 2 if draw.random() < 2 / 3 else 1)
        pair = {name: draw.choice(values_of(quirks[name], draw)) for name in names}
        if go_together(pair):
            yield pair


def pooled(model: str, seed: str, size: int) -> Iterator[dict[str, str]]:
    """Without end: that many switches at once, each of their values once before any comes again.

    A sound device clears all of its readings and each pair of them for the price of one run.
    """
    draw = random.Random(seed)
    while True:
        waiting = [one for each in singles(model, seed) for one in each.items()]
        draw.shuffle(waiting)
        while waiting:
            pool: dict[str, str] = {}
            for name, value in list(waiting):
                if name in pool or len(pool) == size:
                    continue
                if go_together(pool | {name: value}):
                    pool[name] = value
                    waiting.remove((name, value))
            yield pool


def misread(model: str, truth: Mapping[str, str], row: Row) -> dict[str, str]:
    """Switches of which a run has told what is not so: what, and what is."""
    ledger = load_ledger(find_family(model).name)
    wrong = {}
    for name, (reading, candidates) in row["detected"].items():
        told = row["named"].get(name, reading)
        default = ledger.ambiguity_of(name).default_of(name)
        right = truth.get(name, default)
        if told is None and not candidates:
            continue  # nothing is told
        known = (told,) if told is not None else tuple(candidates)
        if not any(_is_same(model, name, one, right) for one in known):
            wrong[name] = f"{' or '.join(known)} told, {right} is so"
    return wrong


def unread(model: str, truth: Mapping[str, str], row: Row) -> tuple[str, ...]:
    """Switches at another value than the default, of which nothing is told, not even some values
    of which the right one is one."""
    asked = row["detected"]
    return tuple(
        name for name in truth
        if name in asked and asked[name] == [None, []] and name not in row["named"]
    )  # fmt: skip


def _is_near(told: str, right: str) -> bool:
    """True for two numbers that a measurement may take for one."""
    try:
        return abs(float(told) - float(right)) <= NEAR * abs(float(right))
    except ValueError:
        return False


def _is_same(model: str, name: str, told: str, right: str) -> bool:
    if told in (right, "*"):
        return True
    quirk = models()[model].quirks[name]
    if name == "brake_increments" and {told, right} == {"plant", "0"}:
        return True  # of an ideal plant it is the same
    if quirk.kind == "text":
        return _is_near(told, right)
    try:
        one, other = quirk.parse(told), quirk.parse(right)
    except Exception:
        return False
    if quirk.kind == "number" and isinstance(one, int) and isinstance(other, int):
        return abs(one - other) <= max(1, NEAR * abs(other))
    return one == other
