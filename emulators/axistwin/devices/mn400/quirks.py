"""Where the MN400 manual leaves a doubt, the doubt has a name: every switch of the twin, as data.

Rules
-----
1. One field per switch, its values in the order of the ledger's readings, default first.
2. A doubt without an effect on the board is no switch (MN4-AMB-21, MN4-AMB-64).
3. What a user sets up rather than doubts stands last: the configuration of one board.
"""

from dataclasses import dataclass
from typing import ClassVar, Final, Literal

from axistwin.devices.switches import Quirk, Settings, number, parse_settings, quirk, switches

TIME_MAX_MS: Final = 60_000
LONG_MAX: Final = (1 << 31) - 1

FIRMWARE: Final = "MN400 V 1.08 / 1.04"
"""As in the manual."""

FIRMWARE_MAX: Final = 40
_DECIMALS_MAX: Final = 3


def parse_decimal(text: str) -> int | None:
    """Thousandths of a number such as 14.5, at least 0; None if it is none."""
    whole, _, fraction = text.partition(".")
    is_number = whole.isdigit() and text.isascii() and len(whole) <= 5
    if not is_number or len(fraction) > _DECIMALS_MAX or not (fraction or "0").isdigit():
        return None
    return int(whole) * 1000 + int(fraction.ljust(_DECIMALS_MAX, "0"))


def _is_slot(text: str) -> bool:
    return bool(parse_decimal(text))


def _is_exit_code(text: str) -> bool:
    return text == "keep" or (text.isascii() and text.isdigit() and int(text[:4]) <= 255)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Mn400Quirks:
    """One reading of the manual: what an MN400 twin does wherever it is silent."""

    PACKETS: ClassVar[str] = "Packets"
    data_packet_trailer: Literal["06", "none", "0600", "05", "0500", "00"] = quirk(
        "06", "MN4-AMB-01", "bytes between the value and the closing address"
    )
    data_value_encoding: Literal["ascii", "dot_nul"] = quirk(
        "ascii", "MN4-AMB-02", "a comma and a zero in a value (dot_nul: as the example's bytes)"
    )
    outcome_null: bool = quirk(True, "MN4-AMB-03", "a null behind every code")
    error_start_policy: Literal["after_accept", "always", "never"] = quirk(
        "after_accept", "MN4-AMB-04", "START before an error: of known commands, of all, of none"
    )
    echo_case: Literal["upper", "as_sent"] = quirk(
        "upper", "MN4-AMB-05", "command character of a reply to a command in lower case"
    )
    address_settable: bool = quirk(True, "MN4-AMB-06", "the address can be changed from 1")
    broadcast_reply: Literal["staggered", "immediate", "poll_only"] = quirk(
        "staggered", "MN4-AMB-07", "replies to commands for all boards"
    )
    poll_slot_ms: str = quirk(
        "auto",
        "MN4-AMB-08",
        "delay of a poll's reply for each address above 1, ms (auto: two packets and 2 ms)",
        form="auto, or milliseconds such as 14.5",
        check=_is_slot,
    )
    rx_timeout_ms: int = number(
        500, 2, TIME_MAX_MS, "MN4-AMB-51", "silence after which a packet is given up, ms"
    )
    timeout_reply: bool = quirk(True, "MN4-AMB-51", "TIMEOUT for a packet that was given up")
    timeout_without_command: Literal["silent", "zero"] = quirk(
        "silent", "MN4-AMB-75", "command character of TIMEOUT when none has come"
    )
    rx_payload_max: int = number(
        80, 1, 9000, "MN4-AMB-51", "characters of command and parameters that can be received"
    )
    retransmit_cmd: Literal["replaced", "verbatim"] = quirk(
        "replaced", "MN4-AMB-42", "command character of a message that is sent again"
    )
    retransmit_in_entry: Literal["retransmit", "store"] = quirk(
        "retransmit", "MN4-AMB-72", "& while a program is entered"
    )
    baud_reply: Literal["baudchangeok", "plus_done"] = quirk(
        "baudchangeok", "MN4-AMB-43", "what follows START when the rate is changed"
    )
    broadcast_setaddr: Literal["accepted", "refused"] = quirk(
        "accepted", "MN4-AMB-69", "= for all boards"
    )
    reply_transport: Literal["sender", "both"] = quirk(
        "sender", "MN4-AMB-66", "where replies go: to who has asked, or to serial line and USB"
    )
    usb_error_form: Literal["cmd_code", "code"] = quirk(
        "cmd_code", "MN4-AMB-50", "an error on USB: command and code, or the code alone"
    )
    usb_outcome_codes: bool = quirk(
        True, "MN4-AMB-50", "NOMOVEPENDING and MOVEPENDING are reported on USB"
    )

    PARAMETERS: ClassVar[str] = "Parameters"
    space_policy: Literal["error", "skip"] = quirk("error", "MN4-AMB-68", "spaces in a command")
    omitted_param: Literal["keep", "zero", "error"] = quirk(
        "keep", "MN4-AMB-49", "an omitted parameter of a setting"
    )
    extra_params: Literal["para_error", "ignore"] = quirk(
        "para_error", "MN4-AMB-49", "more parameters than a command has"
    )
    long_max: int = number(
        LONG_MAX, 2_147_000_000, LONG_MAX, "MN4-AMB-48", "largest value of a long parameter"
    )
    long_min: int = number(
        -LONG_MAX, -LONG_MAX - 1, -2_147_000_000, "MN4-AMB-48", "smallest value of a long parameter"
    )
    g_widths: Literal["16x5", "32x5", "16x4_32"] = quirk(
        "16x5", "MN4-AMB-20", "widths of the five parameters of G"
    )
    negative_v: Literal["any", "minus_one_only"] = quirk(
        "any", "MN4-AMB-23", "speeds that select external sync"
    )
    speed_range_policy: Literal["error", "clip"] = quirk(
        "error", "MN4-AMB-24", "a speed or acceleration out of range"
    )
    plane_base: Literal[1, 0] = quirk(1, "MN4-AMB-11", "number of the first motor in P")
    plane_z_check: Literal["at_helix", "at_plane", "none"] = quirk(
        "at_helix", "MN4-AMB-67", "when a traverse motor that is in the plane is refused"
    )
    abs_mode_value: Literal[1, 0] = quirk(1, "MN4-AMB-09", "parameter of I for absolute mode")
    output_on_state: Literal[0, 1] = quirk(
        0, "MN4-AMB-44", "parameter of C that turns an output on"
    )
    measure_other: Literal["error", "plain"] = quirk(
        "error", "MN4-AMB-40", "E with an argument other than 1 and 2"
    )
    has_feedhold_cmds: bool = quirk(True, "MN4-AMB-38", "the commands ; and : exist")

    HOLD_AND_QUEUE: ClassVar[str] = "Hold and queue"
    hold_bare_arg: Literal["1", "toggle"] = quirk("1", "MN4-AMB-14", "H without a parameter")
    hold_takes_arg: bool = quirk(True, "MN4-AMB-14", "H may have a parameter")
    hold_after_release: Literal["stays_on", "one_shot"] = quirk(
        "stays_on", "MN4-AMB-15", "hold after K"
    )
    hold_scope: Literal["MA+T)", "M", "MA+T)UJ"] = quirk(
        "MA+T)", "MN4-AMB-18", "commands that hold keeps back"
    )
    movepending_exempt: Literal["K&", "K&Q", "K&QH"] = quirk(
        "K&", "MN4-AMB-16", "commands that work while a motion is pending"
    )
    pending_move_reply: Literal["done", "movepending"] = quirk(
        "done", "MN4-AMB-17", "what follows START when a motion becomes pending"
    )
    release_reply: Literal["done", "movepending"] = quirk(
        "done", "MN4-AMB-19", "what follows START when a motion is released"
    )
    queue_modal: bool = quirk(True, "MN4-AMB-52", "settings wait in the queue, too")
    queue_depth: int = number(32, 0, 10_000, "MN4-AMB-52", "commands that the queue holds")

    READ_OUT: ClassVar[str] = "Read-out"
    limit_status_signed: bool = quirk(False, "MN4-AMB-35", "S has 16 bits with a sign")
    shield_status_sense: Literal["shield", "switch"] = quirk(
        "shield", "MN4-AMB-36", "what [ tells: whether the shield is closed, or its switch"
    )
    abort_flag_clear: Literal["next_or_clear", "read"] = quirk(
        "next_or_clear", "MN4-AMB-37", "what clears the abort flag: motion or |, or reading it"
    )
    readcount_after_abort: Literal["kept", "zero"] = quirk(
        "kept", "MN4-AMB-39", "N after a motion was aborted"
    )
    readcount_sign: Literal["signed", "magnitude"] = quirk("signed", "MN4-AMB-39", "sign of N")
    readcount_arc: Literal["net", "path"] = quirk(
        "net", "MN4-AMB-39", "N on arcs: the distance that is left, or the steps"
    )
    measure_single_axis: Literal["zero", "major"] = quirk(
        "zero", "MN4-AMB-40", "count of E1 and E2 when one axis moves"
    )
    measure_position_sample: Literal["end", "start"] = quirk(
        "end", "MN4-AMB-40", "when E1 and E2 take the position"
    )
    readprogram_framing: Literal["packet_per_line", "single"] = quirk(
        "packet_per_line", "MN4-AMB-41", "packets of a listing"
    )
    readprogram_end: Literal["none", "done", "empty_line"] = quirk(
        "none", "MN4-AMB-41", "what follows the last line of a listing"
    )

    STORED_PROGRAMS: ClassVar[str] = "Stored programs"
    eof_byte: Literal["04", "14", "both"] = quirk(
        "04", "MN4-AMB-12", "the character that ends the entry of a program"
    )
    eof_framing: Literal["packet", "raw", "both"] = quirk(
        "packet", "MN4-AMB-13", "that character is sent in a packet, or by itself"
    )
    program_replies: bool = quirk(False, "MN4-AMB-53", "a running user program sends replies")
    prog_check: Literal["entry", "run"] = quirk(
        "entry", "MN4-AMB-54", "when lines that cannot stand in a program are refused"
    )
    nvm_size: int = number(8192, 16, 65536, "MN4-AMB-70", "bytes of the store")
    nvm_line_overhead: int = number(1, 0, 16, "MN4-AMB-70", "bytes that a line takes beside itself")
    nvm_commit: Literal["at_end", "per_line"] = quirk(
        "at_end", "MN4-AMB-70", "when an entered program replaces the previous one"
    )

    POWER_UP: ClassVar[str] = "Power-up"
    power_on_mode: Literal["relative", "absolute"] = quirk(
        "relative", "MN4-AMB-10", "coordinate mode at power-up"
    )
    feedhold_power_on: Literal[0, 1] = quirk(0, "MN4-AMB-55", "FeedHold at power-up")
    power_on_position: int = number(
        0, -LONG_MAX, LONG_MAX, "MN4-AMB-57", "what all counters show at power-up"
    )
    power_on_outputs: Literal["off", "on"] = quirk("off", "MN4-AMB-57", "outputs at power-up")

    SPEED: ClassVar[str] = "Speed"
    accel_scale: Literal["1.0", "0.5"] = quirk(
        "1.0", "MN4-AMB-25", "effective acceleration as a part of the parameter"
    )
    multiplex_cap: Literal["clip", "error", "none"] = quirk(
        "clip", "MN4-AMB-65", "a speed above what multiplexing allows"
    )
    dda_phase: Literal["half", "zero", "full"] = quirk(
        "half", "MN4-AMB-65", "what the accumulators of the minor axes begin with"
    )
    step_phase: Literal["end", "start"] = quirk(
        "end", "MN4-AMB-71", "when a step is issued: at the end or the start of its period"
    )
    feedrate_pot: Literal["scale", "ignore"] = quirk(
        "scale", "MN4-AMB-63", "the feedrate potentiometer"
    )
    dir_level_positive: Literal["low", "high"] = quirk(
        "low", "MN4-AMB-45", "level of a direction output for positive motion"
    )

    ARCS_AND_HELICES: ClassVar[str] = "Arcs and helices"
    arc_ramp: bool = quirk(False, "MN4-AMB-26", "arcs are ramped")
    arc_rate: Literal["dominant_tick", "tangential"] = quirk(
        "dominant_tick", "MN4-AMB-27", "what the speed counts on arcs"
    )
    arc_radius_tol: str = quirk(
        "2.5",
        "MN4-AMB-28",
        "allowed difference of the distances of start and destination from the centre, steps",
        form="steps such as 2.5",
        check=lambda text: parse_decimal(text) is not None,
    )
    arc_zero_sweep: Literal["full", "none"] = quirk(
        "full", "MN4-AMB-29", "an arc that ends where it begins"
    )
    helix_abs_fields: Literal["center_dest", "none", "all"] = quirk(
        "center_dest", "MN4-AMB-30", "fields of + that are coordinates in absolute mode"
    )
    helix_zero_final: Literal["full", "none"] = quirk(
        "full", "MN4-AMB-30", "the final arc of + when it ends where it begins"
    )

    CONTOURS: ClassVar[str] = "Contours"
    cc_margin_scope: Literal["per_axis_pair", "per_axis_equal", "major_only"] = quirk(
        "per_axis_pair", "MN4-AMB-31", "which changes of speed the margin limits"
    )
    cc_unsupported: Literal["invalidcommand", "busy", "ignored", "executed"] = quirk(
        "invalidcommand", "MN4-AMB-32", "other commands while a contour is entered"
    )
    cc_corner_speed: Literal["start_speed", "margin"] = quirk(
        "start_speed", "MN4-AMB-33", "speed at corners that are beyond the margin"
    )
    cc_axis4: Literal["ignored", "error"] = quirk(
        "ignored", "MN4-AMB-34", "a segment whose longest way is that of axis 4"
    )
    cc_capacity: int = number(256, 1, 100_000, "MN4-AMB-51", "segments of a contour")
    contour_pulses: Literal["paced", "ignored", "error"] = quirk(
        "paced", "MN4-AMB-73", "a contour while the speed is negative"
    )
    quit_in_entry: Literal["both", "entry_only"] = quirk(
        "both", "MN4-AMB-74", "what Q ends while a contour is entered during a motion"
    )

    PAUSE_AND_ABORT: ClassVar[str] = "Pause and abort"
    pause_decel: bool = quirk(True, "MN4-AMB-61", "a pause ramps down")
    pause_idle: Literal["noop", "latch"] = quirk(
        "noop", "MN4-AMB-61", "a pause while nothing moves (latch: of the next motion)"
    )
    quit_decel: bool = quirk(False, "MN4-AMB-62", "Q ramps down")
    quit_flushes_queue: bool = quirk(True, "MN4-AMB-62", "Q empties the queue")
    move_abort_use: Literal["unused", "while_aborted"] = quirk(
        "unused", "MN4-AMB-51", "MOVE_ABORT in place of DONE until the abort flag is cleared"
    )
    abort_exit_code: str = quirk(
        "0",
        "MN4-AMB-46",
        "exit code of a motion that Q or the shield has ended",
        form="keep, or 0..255",
        check=_is_exit_code,
    )
    multi_limit_exit: Literal["sum", "first"] = quirk(
        "sum", "MN4-AMB-46", "exit code when several limits stop a motion"
    )
    limit_direction: Literal["toward", "both"] = quirk(
        "toward", "MN4-AMB-47", "directions that a limit blocks"
    )
    limit_halts: Literal["all", "axis"] = quirk("all", "MN4-AMB-47", "axes that a limit halts")
    limit_ramp: bool = quirk(False, "MN4-AMB-47", "a limit ramps down")

    BACKLASH: ClassVar[str] = "Backlash"
    backlash_counts: bool = quirk(False, "MN4-AMB-58", "compensation is counted in E")
    backlash_speed: Literal["v", "start"] = quirk("v", "MN4-AMB-58", "speed of compensation")
    backlash_arc: Literal["start_only", "quadrants"] = quirk(
        "start_only", "MN4-AMB-58", "where arcs are compensated"
    )

    PULSES: ClassVar[str] = "Threading and external sync"
    threader_start: Literal["index", "first_pulse"] = quirk(
        "index", "MN4-AMB-59", "what T waits for"
    )
    threader_overrate: Literal["para_error", "multi"] = quirk(
        "para_error", "MN4-AMB-59", "more steps than pulses"
    )
    sync_ratio: Literal["major_step", "tick"] = quirk(
        "major_step", "MN4-AMB-60", "what a pulse advances with external sync"
    )

    JOG_AND_PANEL: ClassVar[str] = "Jog and panel"
    tap_rounding: Literal["floor", "nearest"] = quirk(
        "floor", "MN4-AMB-22", "steps of a tap when the resolution is no whole number of them"
    )
    jog_res_code: Literal["r1_first", "r4_first"] = quirk(
        "r1_first", "MN4-AMB-22", "resolution that both inputs Jog Res select when they are off"
    )
    jog_hold_ms: int = number(
        500, 1, TIME_MAX_MS, "MN4-AMB-22", "time after which a tap becomes continuous motion, ms"
    )
    panel_start: Literal["run_program", "none"] = quirk(
        "run_program", "MN4-AMB-56", "the Start input"
    )

    PREDECESSOR: ClassVar[str] = "As the MN100, its predecessor"
    start_null: bool = quirk(True, "MN4-AMB-03", "a null behind START, DONE and PRESENT")
    motion_done: Literal["at_once", "at_end"] = quirk(
        "at_once",
        "MN4-RSP-05",
        "DONE of a motion: at once, or when it is over (MOVE_ABORT, or MOVE_STOPPED for Q, if it "
        "was ended)",
    )
    queue_full_code: Literal["slavebuffov", "busy"] = quirk(
        "slavebuffov", "MN4-AMB-52", "code for a command that finds no room in the queue"
    )
    mn100_codes: bool = quirk(
        False,
        "MN4-AMB-51",
        "ADDRESS_ERROR for two addresses that differ, NO_COMMAND for a packet without one, "
        "NOT_AVAILABLE for an output that does not exist",
    )
    axes: int = number(4, 1, 4, "MN4-CMD-E-01", "axes in the fields of E, N, M, L, B and D")

    CONFIGURATION: ClassVar[str] = "Configuration"
    firmware: str = quirk(
        FIRMWARE,
        "MN4-CMD-FW-01",
        "what ? tells: model, revisions of the motion and the communication processor",
        form=f"at most {FIRMWARE_MAX} printable characters of ASCII",
        check=lambda text: 0 < len(text) <= FIRMWARE_MAX and text.isascii() and text.isprintable(),
    )
    transport: Literal["auto", "rs232", "rs485"] = quirk(
        "auto", "MN4-PHY-04", "line type (auto: rs232 for a board alone on its line)"
    )
    response_delay_ms: int = number(
        1, 0, TIME_MAX_MS, "MN4-PHY-04", "time from the last byte of a packet to the reply, ms"
    )


QUIRKS: Final[dict[str, Quirk]] = switches(Mn400Quirks)
"""The switches of the family by name."""


def parse_quirks(settings: Settings) -> Mn400Quirks:
    """The quirks with the given ``settings`` (name, value as text or TOML) over the defaults.

    Raises UsageError for an unknown name (with the nearest one) or a value that is not allowed.
    """
    return parse_settings(Mn400Quirks, QUIRKS, settings)
