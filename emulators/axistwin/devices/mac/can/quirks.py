"""Where the MAC23 CAN manual leaves a doubt: the switches of the CAN face.

Rules
-----
1. Fields as in ``quirks``, whose switches of motion and parameters hold here under the same names:
   ``MacCanQuirks`` is a ``MacQuirks`` with more, and ``CAN_QUIRKS`` lists what a bus can show.
2. A field that stands here again is the same doubt with the CAN ledger's own readings.
3. A doubt with one reading is no switch: 681h is a misprint of 601h (MACC-AMB-02), the direction
   decides between the two meanings of an index (MACC-AMB-21), the reset input silences any dialogue
   (MACC-AMB-30).  The bit rate belongs to the bus, not to a module (MACC-AMB-23).
"""

from dataclasses import dataclass
from typing import ClassVar, Final, Literal

from axistwin.devices.mac.axis.quirks import CAN, MacQuirks
from axistwin.devices.switches import Quirk, Settings, number, parse_settings, quirk, switches

ErrorCodes = tuple[tuple[int, int, int], ...]
"""Bits of dd, error code, error register; the first entry that matches counts."""

CIA301_CODES: Final[ErrorCodes] = (
    (0x10, 0x4200, 0x09),  # temperature of the device
    (0x01, 0x3100, 0x05),  # mains voltage
    (0x40, 0x3210, 0x05),  # voltage inside the device: over-voltage
    (0x20, 0x3220, 0x05),  # under-voltage
)
"""Ledger §6.3.  Register: bit 0 generic, bit 2 voltage, bit 3 temperature."""


def read_error_codes(text: str) -> ErrorCodes | None:
    """What ``emcy_code_map`` means: entries ``BITS/CODE/REGISTER``; None if it means nothing."""
    if text == "cia301":
        return CIA301_CODES
    entries = []
    for entry in text.split(","):
        parts = entry.split("/")
        digits = [len(part) for part in parts]
        if digits != [2, 4, 2] or any(c not in "0123456789abcdefABCDEF" for c in "".join(parts)):
            return None
        bits, code, register = (int(part, 16) for part in parts)
        entries.append((bits, code, register))
    return tuple(entries)


def _are_error_codes(text: str) -> bool:
    return read_error_codes(text) is not None


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MacCanQuirks(MacQuirks):
    """One reading of the manuals: what a MAC23 on CAN does wherever they are silent."""

    SDO: ClassVar[str] = "SDO"
    can_byte_order: Literal["big", "little"] = quirk(
        "big", "MACC-AMB-01", "byte order of parameters (little: in each word or long)", CAN
    )
    upload_scs: Literal[0x42, 0x43] = quirk(
        0x42, "MACC-AMB-18", "first byte of the reply to an upload", CAN
    )
    abort_code_form: Literal["zeros", "code"] = quirk(
        "zeros", "MACC-AMB-17", "last four bytes of a refusal (code: an abort code of CiA 301)", CAN
    )
    sdo_other_ccs: Literal["refuse", "as_23h", "silence"] = quirk(
        "refuse", "MACC-AMB-13", "command bytes other than 23h and 40h (as_23h: 22 27 2B 2F)", CAN
    )
    od_outside_20: Literal["refuse", "minimum", "silence"] = quirk(
        "refuse", "MACC-AMB-14", "index outside 20xxh (minimum: 1000h 1001h 1018h can be read)", CAN
    )
    unknown_index: Literal["refuse", "accept", "silence"] = quirk(
        "refuse", "MACC-AMB-15", "unassigned index (accept: nothing done, zeros read)", CAN
    )
    subindex_policy: Literal["ignore", "refuse"] = quirk(
        "ignore", "MACC-AMB-16", "sub-index other than 00h", CAN
    )
    dont_care_digits: Literal["ignore", "refuse"] = quirk(
        "ignore", "MACC-AMB-22", "parameter bytes printed x that are not 0", CAN
    )
    short_frame: Literal["ignore", "pad"] = quirk(
        "ignore", "MACC-AMB-19", "SDO requests of less than 8 bytes (pad: with zeros)", CAN
    )

    GENERAL_MESSAGE_AND_NETWORK: ClassVar[str] = "General message and network"
    general_reply_id: Literal[0x581, 0x601] = quirk(
        0x581, "MACC-AMB-03", "identifier of module 1's reply to the general message", CAN
    )
    general_upload: Literal["answer", "ignore"] = quirk(
        "answer", "MACC-AMB-20", "upload requests in the general message", CAN
    )
    bootup_form: Literal["heartbeat", "emergency_empty", "heartbeat_empty"] = quirk(
        "heartbeat", "MACC-AMB-04", "700h+adr with 00h, or empty on 080h+adr, or on 700h+adr", CAN
    )
    emcy_payload: Literal["cia301_status", "status_first", "code_only", "none"] = quirk(
        "cia301_status",
        "MACC-AMB-05",
        "emergency: code, register, status, 0; status, 0; code, register, 0; or never sent",
        CAN,
    )
    emcy_code_map: str = quirk(
        "cia301",
        "MACC-AMB-05",
        "error codes by priority, such as 10/4200/09,01/3100/05,40/3210/05,20/3220/05",
        CAN,
        form="cia301, or BITS/CODE/REGISTER in 2/4/2 hex digits, separated by commas",
        check=_are_error_codes,
    )
    emcy_on_clear: bool = quirk(
        True, "MACC-AMB-28", "an emergency is sent when an error disappears, too", CAN
    )
    emcy_trigger_mask: int = number(
        0xFF000000,
        0,
        0xFFFFFFFF,
        "MACC-AMB-29",
        "bits of dd ff gg hh whose change sends an emergency",
        8,
        CAN,
    )
    lifebeat_restart: Literal["own", "any", "free"] = quirk(
        "own",
        "MACC-AMB-06",
        "what restarts the 10 s: own requests, 600h and SYNC too, nothing",
        CAN,
    )
    sync_dlc: Literal["any", "empty"] = quirk(
        "any", "MACC-AMB-07", "SYNC frames that count: with any data, or only without", CAN
    )
    nmt_supported: bool = quirk(
        False, "MACC-AMB-24", "NMT 000h is obeyed: start, stop, pre-operational, resets", CAN
    )

    ADDRESS_PROCEDURE: ClassVar[str] = "Address procedure"
    lmt_dlc: Literal[8, 7] = quirk(8, "MACC-AMB-08", "bytes in the reply on 7E4h", CAN)
    lmt_error_reply: Literal["01", "FF", "silence"] = quirk(
        "01", "MACC-AMB-09", "second byte of the reply to an impossible address", CAN
    )
    lmt_incomplete: Literal["ignore", "bootup"] = quirk(
        "ignore", "MACC-AMB-10", "04 00 without an address given (bootup: restarts)", CAN
    )
    lmt_sdo: Literal["served", "ignored"] = quirk(
        "served", "MACC-AMB-11", "SDO requests in configuration mode", CAN
    )
    lmt_other: Literal["ignored", "cia305"] = quirk(
        "ignored",
        "MACC-AMB-12",
        "other services (cia305: 5Ah..5Eh answered, only 17h stores the address)",
        CAN,
    )

    START_UP_SYNCHRONOUS_MODE_FAULTS: ClassVar[str] = "Start-up, synchronous mode, faults"
    reset_reply: Literal["ack", "silence"] = quirk(
        "ack", "MACC-AMB-26", "2000h and 2001h are acknowledged before they restart", CAN
    )
    boot_time_ms: int = number(
        2000, 0, 60_000, "MACC-AMB-25", "time from a restart to the boot-up message, ms", 0, CAN
    )
    factory_reset_scope: Literal["restart", "no_restart"] = quirk(
        "restart", "MACC-AMB-27", "2001h restarts like 2000h, or only replaces parameters", CAN
    )
    sync_arm_lifetime: Literal["kept", "lost", "permanent"] = quirk(  # type: ignore[assignment]
        "kept",
        "MACC-AMB-31",
        "the arm of 2010h when it is given in motion; permanent: it holds every motion",
        CAN,
    )
    fault_ack_while_present: Literal["returns", "refuse"] = quirk(
        "returns", "MACC-AMB-32", "2000h while the cause of a disjunction is present", CAN
    )


CAN_QUIRKS: Final[dict[str, Quirk]] = switches(MacCanQuirks, "can")
"""The switches of the CAN face, by name."""


def parse_can_quirks(settings: Settings) -> MacCanQuirks:
    """The CAN face's quirks with ``settings`` over the defaults; see ``quirks.parse_settings``."""
    return parse_settings(MacCanQuirks, CAN_QUIRKS, settings)
