"""Where the MSC manual leaves a doubt, the doubt has a name: every switch of the twin, as data.

Rules
-----
1. One field per switch, its values in the order of the ledger's readings, default first.
2. Readings that depart from a requirement marked MUST or DERIVED are offered as well, because real
   units may differ (ledger §6.1a).
3. A doubt with one possible reading is no switch: the checksum has 16 bits (MSC-AMB-17), a flag
   that is on reads 1 (MSC-AMB-37), a unit cannot be switched to 0 (MSC-AMB-44).
4. What a user sets up rather than doubts (size of the memory, delays, kinds of the flags) stands
   last: the configuration of one unit.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

from axistwin.devices.msc.flags import parse_flag_map
from axistwin.devices.switches import Quirk, Settings, number, parse_settings, quirk, switches

TIME_MAX_MS = 60_000


def _is_flag_map(text: str) -> bool:
    return parse_flag_map(text) is not None


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MscQuirks:
    """One reading of the manual: what an MSC twin does wherever it is silent."""

    TIME_OUTS_AND_REPEATS: ClassVar[str] = "Time-outs and repeats"
    retransmit_limit: Literal["5_repeats", "5_total"] = quirk(
        "5_repeats", "MSC-AMB-01", "what the limit of five counts: repeats, or sendings in all"
    )
    ack_timeout_action: Literal["retransmit", "abandon", "wait"] = quirk(
        "retransmit", "MSC-AMB-02", "when the host answers a reply with nothing"
    )
    ack_timeout_ms: int = number(
        1000, 1, TIME_MAX_MS, "MSC-AMB-02", "how long the host's ACK or NAK is awaited, ms"
    )
    packet_timeout_mode: Literal["total", "interbyte", "after_header"] = quirk(
        "total", "MSC-AMB-03", "what the packet time limit runs from: STX, last byte, header"
    )
    packet_timeout_ms: int = number(
        1000, 1, TIME_MAX_MS, "MSC-AMB-03", "packet time limit, ms (below 152 breaks BWRITE)"
    )

    BODIES: ClassVar[str] = "Bodies"
    unknown_command: Literal["nak", "ack_ignore", "silent"] = quirk(
        "nak", "MSC-AMB-04", "a name that is none, the checksum right"
    )
    malformed_body: Literal["nak", "ack_ignore", "lenient"] = quirk(
        "nak", "MSC-AMB-05", "a body too short or too long for its command (lenient: what fits)"
    )
    rflags_unsupported: Literal["as_unknown", "ack_no_reply"] = quirk(
        "as_unknown", "MSC-AMB-06", "RFLAGS sent to a model without it"
    )
    comma: Literal["required", "optional"] = quirk(
        "required", "MSC-AMB-07", "the comma behind the name"
    )
    case_sensitive: bool = quirk(True, "MSC-AMB-08", "names in lower case are no names")
    ack_order: Literal["ack_first", "ack_last"] = quirk(
        "ack_first", "MSC-AMB-09", "a write is carried out when its ACK has left, or before"
    )

    REPLIES: ClassVar[str] = "Replies"
    reply_block: Literal["zero", "echo", "counter"] = quirk(
        "zero", "MSC-AMB-10", "block number of a reply: 0, the request's, or 1 more each reply"
    )
    reply_unit: Literal["own", "echo"] = quirk(
        "own", "MSC-AMB-11", "unit number of a reply (echo shows with rs232_unit_check=ignore)"
    )
    rs232_unit_check: Literal["silent", "nak", "ignore"] = quirk(
        "silent", "MSC-AMB-12", "a packet for unit 2..15 on RS-232"
    )
    invalid_unit: Literal["silent", "nak", "broadcast"] = quirk(
        "silent", "MSC-AMB-13", "unit 0 or above 15 (broadcast: obeyed, not answered)"
    )
    other_unit_framing: Literal["skip_by_length", "hunt_stx"] = quirk(
        "skip_by_length", "MSC-AMB-14", "how packets for other units are got over"
    )
    overlength: Literal["nak_after_packet", "nak_after_header", "timeout_only", "accept"] = quirk(
        "nak_after_packet", "MSC-AMB-15", "a header that announces more than 240 bytes"
    )
    empty_body: Literal["as_unknown", "ack"] = quirk(
        "as_unknown", "MSC-AMB-16", "a packet of length 0, the checksum right"
    )

    DATA_AREA: ClassVar[str] = "Data area"
    data_address_stride: Literal[4, 2, 1] = quirk(
        4, "MSC-AMB-18", "from one value to the next: 4 bytes, 2 words, 1 variable"
    )
    data_misaligned: Literal["overlap", "nak", "round_down"] = quirk(
        "overlap", "MSC-AMB-19", "an address inside a value"
    )
    data_out_of_range: Literal["nak", "zero", "wrap"] = quirk(
        "nak", "MSC-AMB-20", "an address outside the data area (zero: reads 0, stores nothing)"
    )
    block_overrun: Literal["nak_atomic", "partial", "wrap"] = quirk(
        "nak_atomic", "MSC-AMB-21", "a block that runs over the end of the data area"
    )

    FLAGS_AND_STATUS: ClassVar[str] = "Flags and status"
    flag_out_of_range: Literal["nak", "off", "mod256"] = quirk(
        "nak", "MSC-AMB-22", "a flag number above 255"
    )
    flag_write_readonly: Literal["ack_ignore", "nak", "force"] = quirk(
        "ack_ignore", "MSC-AMB-23", "SFLAG, CFLAG of no output or user flag (force: until a scan)"
    )
    status_spare: Literal["zeros", "internal"] = quirk(
        "zeros", "MSC-AMB-25", "content of FF and AAAA in the reply to RQSTAT"
    )
    status_latch: Literal["level", "clear_on_read"] = quirk(
        "level", "MSC-AMB-26", "error bits of the status word when they are read"
    )

    WHAT_COMES_AT_THE_WRONG_MOMENT: ClassVar[str] = "What comes at the wrong moment"
    stx_while_waiting: Literal["serve", "as_nak", "ignore"] = quirk(
        "serve", "MSC-AMB-27", "an STX while the host's ACK is awaited"
    )
    pending_reply_on_stx: Literal["drop", "keep_if_foreign"] = quirk(
        "drop", "MSC-AMB-45", "the reply whose ACK is awaited when a packet for another unit begins"
    )
    junk_while_waiting: Literal["ignore", "as_nak", "abandon"] = quirk(
        "ignore", "MSC-AMB-28", "any other byte while the host's ACK is awaited"
    )
    stray_nak: Literal["ignore", "resend_last"] = quirk("ignore", "MSC-AMB-29", "a NAK while idle")
    noise_in_idle: Literal["ignore", "nak"] = quirk(
        "ignore", "MSC-AMB-30", "other bytes while idle"
    )
    timeout_before_unit: Literal["silent_on_rs485", "silent", "nak"] = quirk(
        "silent_on_rs485", "MSC-AMB-31", "a packet that breaks off behind its STX"
    )
    stopped_access: Literal["allow", "nak"] = quirk(
        "allow", "MSC-AMB-32", "commands other than RQSTAT while no program runs"
    )
    loading_access: Literal["allow", "nak"] = quirk(
        "allow", "MSC-AMB-32", "commands other than RQSTAT while a program is loaded"
    )
    write_visibility: Literal["next_scan", "immediate"] = quirk(
        "next_scan", "MSC-AMB-33", "when a running program sees what the host writes"
    )
    rs485_mode: Literal["two_wire", "four_wire"] = quirk(
        "two_wire", "MSC-AMB-34", "wiring on RS-485: one pair, or one for each direction"
    )
    retransmit_content: Literal["snapshot", "fresh"] = quirk(
        "snapshot", "MSC-AMB-35", "what a repeat of a reply carries"
    )
    write_reply: Literal["none", "empty_packet"] = quirk(
        "none", "MSC-AMB-36", "what follows the ACK of a write command"
    )
    status_tail: Literal[6, 4] = quirk(
        6, "MSC-AMB-38", "bytes behind the status word: FF and AAAA, or FF and AA"
    )
    rx_while_busy: Literal["buffer", "drop"] = quirk(
        "buffer", "MSC-AMB-39", "bytes that arrive while the unit works or sends (256 are kept)"
    )
    reply_delay_ms: int = number(
        10, 0, TIME_MAX_MS, "MSC-AMB-40", "time from the ACK to the reply, ms"
    )
    timer_flag: Literal["running", "expired"] = quirk(
        "running", "MSC-AMB-41", "when a timer's flag is on"
    )
    bwrite_atomic: bool = quirk(
        True, "MSC-AMB-42", "a program sees the 32 values of a BWRITE together"
    )
    uart_error: Literal["bad_packet", "use_byte", "drop_byte"] = quirk(
        "bad_packet", "MSC-AMB-43", "a character with a bad stop bit inside a packet"
    )

    CONFIGURATION: ClassVar[str] = "Configuration"
    data_size: int = number(
        32768, 128, 65536, "MSC-DAT-01", "addresses of the data area: 0 to one less than this"
    )
    response_delay_ms: int = number(
        5, 0, TIME_MAX_MS, "MSC-LNK-01", "time from the last byte of a packet to the ACK, ms"
    )
    turnaround_ms: int = number(
        1, 0, TIME_MAX_MS, "MSC-AMB-34", "silence before a unit drives two wires, at least, ms"
    )
    flag_map: str = quirk(
        "generic",
        "MSC-AMB-24",
        "which flags are inputs, outputs, timers, motor status, user",
        form="generic, or KIND:FIRST-LAST/... such as input:0-15/output:16-31/user:128-255",
        check=_is_flag_map,
    )
    transport: Literal["auto", "rs232", "rs485"] = quirk(
        "auto", "MSC-PKT-04", "line type (auto: rs232 for unit 1 alone on its line)"
    )
    scan_ms: int = number(10, 1, TIME_MAX_MS, "MSC-AMB-33", "time from scan to scan, ms")
    self_test_ms: int = number(
        0, 0, TIME_MAX_MS, "MSC-STA-02", "self-test after power-up (status bit 7), ms"
    )
    auto_start: bool = quirk(False, "MSC-STA-01", "the program starts at power-up (status bit 6)")


QUIRKS: dict[str, Quirk] = switches(MscQuirks)
"""The switches of the family by name."""


def parse_quirks(settings: Settings) -> MscQuirks:
    """The quirks with the given ``settings`` (name, value as text or TOML) over the defaults.

    Raises UsageError for an unknown name (with the nearest one) or a value that is not allowed.
    """
    return parse_settings(MscQuirks, QUIRKS, settings)
