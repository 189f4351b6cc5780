"""Where the MAC manuals leave a doubt, the doubt has a name: every switch of the twin, as data.

Rules
-----
1. One field per switch.  Its values stand in the order of the ledger's readings, default first.
2. A choice is a ``Literal``: its values are what a user writes.  A ``bool`` is written ``true`` or
   ``false``.  A number may be written ``11h``, ``0x11`` or ``17``.
3. ``MacQuirks`` is what the twin obeys; ``QUIRKS`` is what the program lists; both are the same
   fields below.
4. A doubt with one possible reading is no switch: the virtual segment has index 1Eh, 16h on its
   page is a misprint (MACS-AMB-06).
5. Readings that depart from a requirement marked M or D are offered as well, because real units may
   differ.
6. A switch belongs to the faces that can show it: those of bytes, characters and rates to the
   serial one alone.  What only the CAN face has stands in ``can_quirks``.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

from axistwin.devices.switches import (
    DIGITS_MAX,
    Quirk,
    Settings,
    number,
    parse_settings,
    quirk,
    switches,
)

RANGE_MIN, RANGE_MAX = -(1 << 30), (1 << 30) - 1
"""Ends of the position counter: 31 bits signed (MACS-AMB-54)."""

_SIGNED_32 = (-(1 << 31), (1 << 31) - 1)

SERIAL, CAN = frozenset({"serial"}), frozenset({"can"})
"""Faces that a switch belongs to (rule 6)."""


def _are_limits(text: str) -> bool:
    """UNDER/OVER/VMAX/TRIP in whole V and °C, in an order that makes sense."""
    parts = text.split("/")
    if len(parts) != 4 or any(not _is_number(part) or int(part) > 255 for part in parts):
        return False
    under, over, v_max, _ = map(int, parts)
    return under < over <= v_max * 5 // 4


def _are_increments(text: str) -> bool:
    return _is_number(text) and int(text) <= 0xFFFF


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= DIGITS_MAX


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MacQuirks:
    """One reading of the manuals: what a MAC twin does wherever they are silent or contradict."""

    FRAMES_AND_REPLIES: ClassVar[str] = "Frames and replies"
    xon_byte: Literal[0x1A, 0x11] = quirk(
        0x1A, "MACS-AMB-01", "last byte of the reply to an accepted frame", SERIAL
    )
    xonerror_byte: Literal[0x17, 0x18] = quirk(
        0x17, "MACS-AMB-02", "last byte of the reply to a refused command", SERIAL
    )
    status_reply_digit: Literal["1", "2"] = quirk(
        "1",
        "MACS-AMB-03",
        "index digit in the answer to 21h (the data are the status always)",
        SERIAL,
    )
    reply23_digit: Literal["3", "2"] = quirk(
        "3", "MACS-AMB-04", "index digit in the answer to 23h", SERIAL
    )
    reply28_length: Literal["011", "014"] = quirk(
        "011", "MACS-AMB-05", "length field in the answer to 28h", SERIAL
    )
    bad_frame_reply: Literal["silence", "nack"] = quirk(
        "silence", "MACS-AMB-64", "wrong length field, or byte 20 not Etx", SERIAL
    )
    lowercase_hex: Literal["refuse", "accept"] = quirk(
        "refuse", "MACS-AMB-64", "digits a-f in a frame", SERIAL
    )
    rx_during_xoff: Literal["lost", "kept"] = quirk(
        "lost", "MACS-AMB-64", "bytes that arrive between Etx and the end of the reply", SERIAL
    )
    subindex_policy: Literal["ignore", "refuse"] = quirk(
        "ignore", "MACS-AMB-61", "sub-index other than 00 (28h and 29h excepted)"
    )
    dont_care_digits: Literal["ignore", "refuse"] = quirk(
        "ignore", "MACS-AMB-62", "parameter digits printed x that are not 0"
    )
    unknown_index: Literal["refuse", "accept", "zero_answer", "silence"] = quirk(
        "refuse", "MACS-AMB-58", "unassigned index (zero_answer: queries; commands do nothing)"
    )
    param_range_policy: Literal["refuse", "mask", "clamp"] = quirk(
        "refuse", "MACS-AMB-60", "02h 03h 07h 1Bh with a value outside the printed set"
    )
    reply_latency_us: int = number(
        1000, 0, 1_000_000, "MACS-REPLY-16", "time from Etx to the first byte of the reply, µs"
    )
    version_word: int = number(
        0x704, 0, 0xFFFFFFFF, "MACS-AMB-66", "the eight digits that 24h answers", digits=8
    )
    reserved_bits: Literal[0, 1] = quirk(
        0, "MACS-AMB-59", "value of every reserved bit in the answers to 21h and 27h"
    )
    mem_wrap: Literal["wrap", "zero"] = quirk(
        "wrap", "MACS-AMB-65", "28h and 29h beyond address FFh", SERIAL
    )

    ADDRESSES_AND_SEVERAL_MODULES: ClassVar[str] = "Addresses and several modules"
    general_reply_policy: Literal["addr00_only", "all", "none", "lone"] = quirk(
        "addr00_only",
        "MACS-AMB-16",
        "who replies to FF (lone: 00, and a module alone on its line)",
        SERIAL,
    )
    general_echo: Literal["as_sent", "own_address"] = quirk(
        "as_sent", "MACS-AMB-17", "address in the answer to a query to FF", SERIAL
    )
    addr_prog_requires_ff: bool = quirk(
        False, "MACS-AMB-18", "08h sent to the module's own address is refused", SERIAL
    )
    addr_effective: Literal["at_once", "at_restart"] = quirk(
        "at_once", "MACS-AMB-18", "from when on a programmed address is used", SERIAL
    )
    addr_range: Literal["refuse", "mask"] = quirk(
        "refuse", "MACS-AMB-18", "08h with an address of 80h and above", SERIAL
    )
    nack_scope: Literal["addressed", "module_00", "any"] = quirk(
        "addressed", "MACS-AMB-19", "which module answers Nack to a wrong checksum", SERIAL
    )

    START_UP_AND_STORAGE: ClassVar[str] = "Start-up and storage"
    reset_reply: Literal["ack", "silence"] = quirk(
        "ack", "MACS-AMB-20", "00h and 01h are acknowledged before they restart"
    )
    boot_time_ms: int = number(
        2000, 0, 60_000, "MACS-AMB-21", "deaf time after 00h, 01h, 1Bh and power-up, ms"
    )
    baud_reply_rate: Literal["old", "new"] = quirk(
        "old", "MACS-AMB-22", "rate at which 1Bh itself is acknowledged", SERIAL
    )
    factory_reset_scope: Literal["restart", "no_restart"] = quirk(
        "restart", "MACS-AMB-23", "01h restarts like 00h, or only replaces the parameters"
    )
    persist_modes: Literal["stored", "volatile"] = quirk(
        "stored", "MACS-AMB-24", "02h, 03h and 1Ch over power-off"
    )
    power_on_at_boot: bool = quirk(False, "MACS-AMB-26", "the motor is powered after start-up")
    cmd_1b_supported: bool = quirk(
        True, "MACS-AMB-09", "1Bh exists (older releases refuse it)", SERIAL
    )
    cmd_1c_supported: bool = quirk(
        True, "MACS-AMB-09", "1Ch exists (older releases refuse it)", SERIAL
    )
    has_reset_input: bool = quirk(True, "MACS-AMB-67", "the reset input is present", SERIAL)
    factory_standby: Literal[1, 0] = quirk(
        1, "MACS-AMB-25", "factory value of 02h: 1 half torque at rest"
    )
    factory_stops: Literal[0, 1, 8, 9] = quirk(
        0, "MACS-AMB-25", "factory value of 03h: bit 0 hardware, bit 3 software stops"
    )
    factory_superior_stop: int = number(
        RANGE_MAX, *_SIGNED_32, "MACS-AMB-25", "factory value of 09h, increments", digits=8
    )
    factory_inferior_stop: int = number(
        RANGE_MIN, *_SIGNED_32, "MACS-AMB-25", "factory value of 0Ah, increments", digits=8
    )
    factory_torque: int = number(
        0x60, 0, 0xFF, "MACS-AMB-25", "factory value of 0Ch, in parts of Imax", digits=2
    )
    factory_period: int = number(
        0x320, 1, 0xFFFF, "MACS-AMB-25", "factory value of 0Dh, ticks per increment", digits=4
    )
    factory_catchup: int = number(
        0x05, 0, 0xFF, "MACS-AMB-25", "factory value of 0Eh, 200 µs per increment", digits=2
    )
    factory_ramp: int = number(
        0x0A, 0, 0xFF, "MACS-AMB-25", "factory value of 0Fh, 120 increments", digits=2
    )
    factory_tolerance: int = number(
        0, 0, 0xFF, "MACS-AMB-25", "factory value of 1Ch, increments", digits=2
    )
    imax_value: int = number(
        0x80, 1, 0xFF, "MACS-AMB-11", "Imax, the byte at RAM address AFh", digits=2
    )
    mac34_limits: str = quirk(
        "model",
        "MACS-AMB-56",
        "MAC34 thresholds UNDER/OVER/VMAX/TRIP in V, V, V, °C, such as 24/60/64/85",
        SERIAL,
        form="model, or UNDER/OVER/VMAX/TRIP in whole V, V, V, °C",
        check=_are_limits,
    )

    ACCEPTANCE: ClassVar[str] = "Acceptance"
    motion_lock_set: Literal["can_list", "serial_list"] = quirk(
        "can_list", "MACS-AMB-08", "locked in motion: 02 03 09 0A 0D 0F 13 14, or 02 03(d=1) 13"
    )
    lock_08_1b: bool = quirk(False, "MACS-AMB-08", "08h and 1Bh are locked in motion too", SERIAL)
    preload_locks: bool = quirk(False, "MACS-AMB-27", "a preloaded motion counts as running")
    running_until: Literal["tolerance", "exact", "profile"] = quirk(
        "tolerance", "MACS-AMB-27", "after the profile, what a position motion still waits for"
    )
    disj_refuse_set: Literal["motion_type", "starting"] = quirk(
        "motion_type", "MACS-AMB-33", "refused after a disjunction: 10 11 13-1A 1E, or 13-16 19 1E"
    )
    torque_range: Literal["inclusive", "exclusive"] = quirk(
        "inclusive", "MACS-AMB-10", "whether the ends 00 and Imax belong to the range of 0Ch"
    )
    torque_over: Literal["refuse", "clamp", "mask"] = quirk(
        "refuse", "MACS-AMB-10", "0Ch outside the range (mask: seven bits)"
    )
    zero_period_0d: Literal["refuse", "as_one"] = quirk("refuse", "MACS-AMB-46", "0Dh 0000")
    zero_catchup: Literal["as_one", "refuse"] = quirk(
        "as_one", "MACS-AMB-47", "0Eh with VV = 00 (as_one: stored as 00, acts as 01)"
    )
    catchup_low_byte: Literal["ignore", "refuse"] = quirk(
        "ignore", "MACS-AMB-47", "last byte of 0Eh other than 00"
    )

    POSITION_AND_VELOCITY_MOTION: ClassVar[str] = "Position and velocity motion"
    motion_start_ref: Literal["etx", "reply_end"] = quirk(
        "etx", "MACS-AMB-41", "when a motion starts: Etx heard, or the end of the reply", SERIAL
    )
    step_phase: Literal["end", "start"] = quirk(
        "end", "MACS-AMB-41", "the counter steps at the end or at the start of an increment"
    )
    ramp_law: Literal["equal_time", "equal_increments"] = quirk(
        "equal_time", "MACS-AMB-42", "what the 16 speed levels of a ramp share evenly"
    )
    period_rounding: Literal["half_up", "floor", "ceil"] = quirk(
        "half_up", "MACS-AMB-43", "rounding of the periods of a ramp to ticks"
    )
    triangle_law: Literal["mirror", "shared_peak"] = quirk(
        "mirror", "MACS-AMB-74", "short moves: symmetric, or the middle one level higher"
    )
    vel_f6_direction: Literal["negative", "positive"] = quirk(
        "negative", "MACS-AMB-07", "direction of 15h with SS = F6", SERIAL
    )
    vel_reverse_cmd: Literal["ignore", "refuse"] = quirk(
        "ignore", "MACS-AMB-28", "15h with the other direction in motion (ignore: speed taken)"
    )
    vel_during_position: Literal["accept", "refuse"] = quirk(
        "accept", "MACS-AMB-29", "15h during 13h and 14h"
    )
    vel_during_interp: Literal["accept", "refuse"] = quirk(
        "accept", "MACS-AMB-30", "15h during segments"
    )
    vel_change_law: Literal["ramp_length", "constant_acceleration", "step"] = quirk(
        "ramp_length", "MACS-AMB-44", "speed change in motion"
    )
    stop_ramp_law: Literal["climbed", "ramp_length"] = quirk(
        "climbed", "MACS-AMB-45", "17h during a ramp: as many increments as climbed, or N"
    )
    overshoot_return: Literal["catch_up", "fresh_profile"] = quirk(
        "catch_up", "MACS-AMB-75", "return to a target that fell behind by a change of origin"
    )
    standby_swing: Literal["none", "one"] = quirk(
        "none", "MACS-CMD-02-03", "reading of a place held in standby (one: +1, 0, -1, 0 about it)"
    )
    plant: Literal["ideal", "inertial"] = quirk(
        "ideal", "MACS-AMB-73", "motor and load: follows exactly, or by torque and inertia"
    )
    busy_after_abort: bool = quirk(
        False, "MACS-AMB-51", "after 18h or a stop busy until the old target is reached"
    )
    busy_after_17h: bool = quirk(
        False, "MACS-AMB-72", "after 17h busy until the old target is reached"
    )
    abort_flush: bool = quirk(
        True,
        "MACS-AMB-51",
        "18h and stops drop preload and FIFO (false: what is stored runs with the next segment)",
    )

    SYNCHRONOUS_MODE: ClassVar[str] = "Synchronous mode"
    sync_without_preload: Literal["accept", "refuse"] = quirk(
        "accept", "MACS-AMB-34", "11h with nothing preloaded"
    )
    sync_arm_lifetime: Literal["kept", "lost"] = quirk(
        "kept", "MACS-AMB-35", "the arm of 10h when it is given in motion"
    )
    arm_after_segment: Literal["kept", "lost"] = quirk(
        "kept", "MACS-AMB-71", "the arm of 10h, and what it holds, when a segment follows"
    )
    preload_policy: Literal["replace", "refuse", "keep"] = quirk(
        "replace", "MACS-AMB-36", "a second motion while preloaded; keep: 17h 18h 1Ah keep it too"
    )
    armed_zero_velocity: Literal["keep", "spend", "refuse"] = quirk(
        "keep", "MACS-AMB-68", "15h 0000 at rest while armed"
    )
    sync_during_interp: Literal["after", "now", "drop"] = quirk(
        "after", "MACS-AMB-69", "11h with a 13h or 14h preloaded while segments are executed"
    )

    SEGMENTS: ClassVar[str] = "Segments"
    fifo_counts_executing: bool = quirk(
        False, "MACS-AMB-37", "the executing segment occupies one of the three stages"
    )
    segment_signed: bool = quirk(True, "MACS-AMB-38", "DDDD is signed")
    segment_zero_period: Literal["refuse", "fastest", "65536"] = quirk(
        "refuse", "MACS-AMB-39", "segment with VVVV = 0000"
    )
    segment_zero_steps: Literal["zero_time", "65536"] = quirk(
        "zero_time", "MACS-AMB-39", "segment with DDDD = 0000"
    )
    fifo_underrun: Literal["halt", "decelerate", "error"] = quirk(
        "halt", "MACS-AMB-40", "FIFO empty at the end of a segment (error: 18h or 00h needed)"
    )
    interp_during_profile: Literal["queue", "refuse", "preempt"] = quirk(
        "queue", "MACS-AMB-31", "16h and 1Eh during 13h, 14h, 15h"
    )
    stop17_in_interp: Literal["ignore", "refuse", "after_segment", "now"] = quirk(
        "ignore", "MACS-AMB-32", "17h during segments (now departs from MACS-CMD-17-02)"
    )
    segments_after_17h: Literal["run", "dropped"] = quirk(
        "run", "MACS-AMB-77", "segments that wait for the end of a profile that 17h stops"
    )

    STOPS_REFERENCE_COUNTER_FAULTS: ClassVar[str] = "Stops, reference, counter, faults"
    soft_stop_compare: Literal["strict", "equal"] = quirk(
        "strict", "MACS-AMB-48", "a software stop acts beyond its position, or at it"
    )
    soft_stop_blocks: Literal["same_direction", "both"] = quirk(
        "same_direction", "MACS-AMB-48", "directions that a software stop blocks"
    )
    hard_stop_command: Literal["accept", "refuse"] = quirk(
        "accept", "MACS-AMB-49", "a motion toward an active hardware stop"
    )
    brake_increments: str = quirk(
        "plant",
        "MACS-AMB-76",
        "increments that 18h and stops still take: 0 of the ideal plant, v²/2a, or a number",
        form="plant, or a number 0..65535",
        check=_are_increments,
    )
    ff_lifetime: Literal["next_motion", "live", "until_reset"] = quirk(
        "next_motion", "MACS-AMB-50", "how long the stop bits of 21h stay"
    )
    status_ff_layout: Literal["can_map", "shifted"] = quirk(
        "can_map", "MACS-AMB-12", "stop bits at 3..0, or one higher", SERIAL
    )
    status_hh_bit: Literal["7", "6-0"] = quirk(
        "7", "MACS-AMB-13", "bits of hh that tell a past over-voltage", SERIAL
    )
    ref_edge: Literal["opening", "closing"] = quirk(
        "opening", "MACS-AMB-52", "edge of the reference contact that zeroes the counter"
    )
    ref_retarget: Literal["absolute", "remaining"] = quirk(
        "absolute", "MACS-AMB-52", "what a 13h under way keeps when the reference zeroes"
    )
    reset_in_motion: Literal["absolute", "remaining"] = quirk(
        "absolute", "MACS-AMB-53", "what a 13h under way keeps when 0Bh zeroes"
    )
    position_overflow: Literal["wrap", "saturate"] = quirk(
        "wrap", "MACS-AMB-54", "the counter at the end of its 31 bits"
    )
    target_range: Literal["refuse", "accept"] = quirk(
        "refuse", "MACS-AMB-54", "13h outside the counter's range"
    )
    position_source: Literal["encoder", "set_point"] = quirk(
        "encoder", "MACS-AMB-55", "what 20h reads"
    )
    encoder_fault_locks: bool = quirk(
        True, "MACS-AMB-57", "dd.1, encoder not found, is a disjunction", SERIAL
    )


QUIRKS: dict[str, Quirk] = switches(MacQuirks, "serial")
"""The switches of the serial face."""


def parse_quirks(settings: Settings) -> MacQuirks:
    """The serial face's quirks with the given ``settings``; see ``parse_settings``."""
    return parse_settings(MacQuirks, QUIRKS, settings)
