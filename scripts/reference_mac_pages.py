"""The command pages of the MAC, for serial and CAN: the twins' tables, and exchanges with them.

What a command is for stands in ``reference_mac_words``; everything else comes from the twins.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from scripts.reference_mac import (
    FIRST_QUERY,
    LINE,
    CanFace,
    Face,
    SerialFace,
    accepted,
    requirements_of,
    touching,
)
from scripts.reference_mac_words import Command, Query
from scripts.reference_tables import prose, table

from axistwin import catalog
from axistwin.devices.mac.axis.acceptance import SIGNIFICANT, STATE_TEXTS, State, acceptance_table
from axistwin.devices.mac.axis.axis import NEGATIVE_STOP, NOT_BUSY, POSITIVE_STOP, REFERENCE
from axistwin.devices.mac.axis.memory_map import CELLS, RATE_CODES, factory_values
from axistwin.devices.mac.axis.models import (
    MAC23,
    MAC23_THERMAL,
    MAC34_AMPLIFIER,
    MAC34_ENCODER,
    MAC34_THERMAL,
    MICRO_CUT,
    MODELS,
    OVER_VOLTAGE_WARNING,
    UNDER_VOLTAGE_WARNING,
)
from axistwin.devices.mac.axis.stops import STOP_NAMES
from axistwin.devices.mac.can.device import (
    ACCEPTED,
    BOOT_UP,
    DOWNLOAD,
    EMERGENCY,
    GENERAL_REQUEST,
    INDEX_HIGH,
    LMT_REPLY,
    LMT_REQUEST,
    REFUSED,
    REPLY,
    REQUEST,
    SYNC,
    UPLOAD,
)
from axistwin.devices.mac.can.quirks import MacCanQuirks
from axistwin.devices.mac.serial.framing import GENERAL_ADDRESS, REQUEST_BYTES
from axistwin.kernel.time import NS_PER_MS

RAM_EXAMPLE: Final = 0xAF  # Imax, the one address that the manual gives

STATES: Final = {
    State.OF: "off",
    State.HD: "hold",
    State.PO: "position",
    State.VE: "velocity",
    State.IN: "segments",
    State.AR: "armed",
    State.PL: "preloaded",
    State.DJ: "fault",
}
"""Column heads of the acceptance table."""


def digits(command: Command) -> str:
    """The parameter of a command, digit by digit; x: any."""
    shown = ["x"] * 8
    for field in command.fields:
        first = 8 - (field.shift + field.bits) // 4
        shown[first : first + len(field.letters)] = field.letters
    return "".join(shown)


def factory(face: Face, command: Command) -> str:
    """The factory value that a command replaces."""
    if not command.cell:
        return "-"
    addresses = catalog.find_model(face.model).addresses
    value = factory_values(face.defaults, addresses)[command.cell]
    return str(RATE_CODES[value] if command.cell == "baud" else value)


def overview(face: Face) -> str:
    """Every command in a row."""
    rows = []
    for index, command in face.commands.items():
        mask = SIGNIFICANT.get(index, 0)
        assert mask == sum(field.mask for field in command.fields), f"{index:02X}h: digits"
        cell = f"`{digits(command)}`"
        name = face.name(index)
        rows.append(
            (f"[{name}](#{anchor(face, index)})", command.title, cell, factory(face, command))
        )
    cells = {command.cell for command in face.commands.values()}
    missing = {cell.name for cell in CELLS} - cells - {"position", "address", "baud"}
    assert not missing, f"set by no command: {missing}"
    return table(["command", "what it does", "parameter", "factory value"], rows)


def title_of(face: Face, index: int) -> str:
    """The heading of a command or query."""
    known: Mapping[int, Command | Query] = {**face.commands, **face.queries}
    service = " (upload)" if isinstance(face, CanFace) and index >= FIRST_QUERY else ""
    return f"{face.name(index)}: {known[index].title}{service}"


def anchor(face: Face, index: int) -> str:
    """The link to a heading, as GitHub makes it."""
    return re.sub(r"[^\w -]", "", title_of(face, index).lower()).replace(" ", "-")


def acceptance(face: Face) -> str:
    """Which command is accepted in which state."""
    cells = acceptance_table(face.defaults)
    words = {"A": "yes", "R": "-"}
    rows = (
        (face.name(index), *(words[cells[state][index]] for state in State))
        for index in face.commands
    )
    states = ((f"*{text}*", STATE_TEXTS[state.name]) for state, text in STATES.items())
    return (
        "## When a command is accepted\n\n"
        + prose(
            f"""A module that starts up or is held in reset does not listen. In all other states it
            answers every query. It accepts the commands marked *yes*, as far as it accepts their
            values, and refuses the others. In motion, the column of the motion counts, also for an
            armed module. A refused command changes nothing. The columns show the defaults of the
            [quirks]({face.quirk_page})."""
        )
        + table(["command", *STATES.values()], rows)
        + "\n"
        + table(["state", "the axis is"], states)
        + "\n"
    )


def command_section(face: Face, index: int) -> str:
    """One command: effect, parameter, limits, requirements, switches, an exchange."""
    command = face.commands[index]
    page = f"\n### {title_of(face, index)}\n\n{prose(face.renamed(command.effect))}"
    if command.fields:
        rows = (
            (f"`{field.letters}`", face.renamed(field.meaning), accepted(face, index, field))
            for field in command.fields
        )
        page += table([f"of `{digits(command)}`", "meaning", "accepted values"], rows) + "\n"
    if command.cell:
        page += prose(f"Factory value: {factory(face, command)}. The module stores the value.")
    return page + links(face, index) + face.exchange(index, command.sample)


def query_section(face: Face, index: int) -> str:
    """One query: what its four bytes are, requirements, switches, an exchange."""
    query = face.queries[index]
    page = f"\n### {title_of(face, index)}\n\n"
    page += prose(face.renamed(f"The answer is `{query.layout}`: {query.meaning}."))
    sub_index = RAM_EXAMPLE if query.title == "RAM" else 0
    return page + links(face, index) + face.exchange(index, sub_index=sub_index)


def links(face: Face, index: int) -> str:
    """Requirements and switches."""
    requirements = requirements_of(face, index)
    assert requirements, f"{face.name(index)}: no requirement names it"
    text = f"[Requirements]({face.requirement_page}): "
    text += ", ".join(each.id for each in requirements) + "."
    switches = ", ".join(f"`{name}`" for name in touching(face, index))
    if switches:
        text += f" [Quirks]({face.quirk_page}): {switches}."
    return prose(text)


def sections(face: Face) -> str:
    """Every command, then every query."""
    commands = "".join(command_section(face, index) for index in face.commands)
    queries = "".join(query_section(face, index) for index in face.queries)
    return f"## The commands\n{commands}\n## The queries\n{queries}"


def bit(mask: int) -> int:
    """The number of the only bit of a mask."""
    assert mask.bit_count() == 1
    return mask.bit_length() - 1


def answer_bits(face: Face) -> str:
    """The bits of status and measures."""
    faults = {
        OVER_VOLTAGE_WARNING: "over-voltage warning; follows the supply",
        UNDER_VOLTAGE_WARNING: "under-voltage warning; follows the supply",
        MAC23_THERMAL: "MAC23: too hot",
        MAC34_AMPLIFIER: "MAC34: over-current, earth leak or far too high a supply",
        MAC34_THERMAL: "MAC34: too hot",
        MAC34_ENCODER: "MAC34: encoder not found",
        MICRO_CUT: "micro-cut of the supply",
    }
    if isinstance(face, CanFace):
        faults = {mask: text for mask, text in faults.items() if not text.startswith("MAC34")}
    status = [(f"dd.{bit(mask)}", text) for mask, text in faults.items()]
    status += [
        (f"ff.{bit(mask)}", f"stopped by the {name} stop") for mask, name in STOP_NAMES.items()
    ]
    status += [("hh.7", "over-voltage seen since the start-up")]
    measures = [
        (f"cc.{bit(POSITIVE_STOP)}", "positive stop input active"),
        (f"cc.{bit(NOT_BUSY)}", "0 while the axis is busy"),
        (f"dd.{bit(NEGATIVE_STOP)}", "negative stop input active"),
        (f"dd.{bit(REFERENCE)}", "reference input active"),
    ]
    status_name, measures_name = face.name(0x21), face.name(0x27)
    reset = face.name(0)
    return (
        f"\n## The bits of {status_name} and {measures_name}\n\n"
        + prose(
            f"""Status, {status_name}. A fault of *dd* that is no warning cuts the motor's power and
            stays until {reset} or a power cycle; until then the motion commands are refused."""
        )
        + table(["bit", "meaning"], status)
        + "\n"
        + prose(f"Inputs and state, {measures_name}. An input is active while it is grounded.")
        + table(["bit", "meaning"], measures)
        + "\n"
        + scales(face)
    )


def scales(face: Face) -> str:
    """How temperature and supply are coded."""
    models = [MAC23] if isinstance(face, CanFace) else list(MODELS.values())
    rows = (
        (
            f"`{face.model if isinstance(face, CanFace) else model.name}`",
            f"{model.temperature_step_m / 1000:g} · tt - {-model.temperature_offset_m / 1000:g}",
            f"{model.supply_step_uv / 1e6:.4g} · vv",
        )
        for model in models
    )
    return table(["model", "temperature, °C", "supply, V"], rows)


def other_switches(face: Face) -> str:
    """The switches that concern no command of their own."""
    shown = {name for index in (*face.commands, *face.queries) for name in touching(face, index)}
    quirks = catalog.find_model(face.model).quirks
    rows = [
        (f"`{name}`", quirk.default, quirk.doc)
        for name, quirk in quirks.items()
        if name not in shown
    ]
    return (
        "\n## Quirks that concern no single command\n\n"
        + prose(f"The [whole list]({face.quirk_page}) has the other readings too.")
        + table(["switch", "default", "meaning"], rows)
    )


# --- the pages ------------------------------------------------------------------------------------


def serial_head(face: SerialFace) -> str:
    """Line, frame and replies."""
    byte_ms = LINE.span_ns(1) / NS_PER_MS
    rows = (
        ("0", "Stx", "02h"),
        ("1..3", "length", "`014`"),
        ("4..5", "address", f"`00` to `7F`; `{GENERAL_ADDRESS:02X}`: every module"),
        ("6..7", "index", "`00` to `1F`: commands; `20` to `2F`: queries"),
        ("8..9", "sub-index", "`00`; for 28h and 29h the address in the memory"),
        ("10..17", "parameter", "8 digits, most significant first; `x`: any digit"),
        ("18..19", "checksum", "sum of the characters 4 to 17, modulo 100h"),
        (f"{REQUEST_BYTES - 1}", "Etx", "03h"),
    )
    quirks = face.defaults
    replies = (
        (f"`06 13 {quirks.xon_byte:02X}`", "Ack Xoff Xon", "the command is accepted"),
        (f"`06 13 {quirks.xonerror_byte:02X}`", "Ack Xoff Xonerror", "the command is refused"),
        ("`15`", "Nack", "the checksum is wrong"),
        (
            f"`06 13 02` … `03 {quirks.xon_byte:02X}`",
            "Ack Xoff, answer frame, Xon",
            "answer to a query: length `011`, address, last digit of the index, 8 digits, checksum",
        ),
    )
    return (
        "# The MAC serial interface\n\n"
        + prose(
            """What goes over the serial line of a MAC23, MAC34-1 or MAC34-2, for those who write a
            host. The tables are those of the twin. The accepted values and the exchanges are what a
            fresh twin of a MAC23 does."""
        )
        + "## Line and frame\n\n"
        + prose(
            f"""From the factory a module talks {LINE.baud} baud, 8 data bits, no parity, 1 stop
            bit: {byte_ms:.3f} ms a byte. It shares the line with others, half duplex. A request has
            {REQUEST_BYTES} bytes, and its digits are upper-case hexadecimal characters."""
        )
        + table(["bytes", "field", "value"], rows)
        + "\n"
        + prose(
            f"""The module replies {quirks.reply_latency_us / 1000:g} ms after the request
            (`reply_latency_us`). It loses what arrives before the end of its reply. To a frame for
            every module, only module 0 replies. After 00h, 01h, 1Bh and power-up the module is deaf
            for {quirks.boot_time_ms / 1000:g} s (`boot_time_ms`)."""
        )
        + table(["reply", "name", "meaning"], replies)
        + "\n"
    )


def can_head(face: CanFace) -> str:
    """Identifiers, requests and replies, messages."""
    quirks = face.defaults
    assert isinstance(quirks, MacCanQuirks)
    services = (
        (f"`{DOWNLOAD:02X} ii {INDEX_HIGH:02X} ss dddddddd`", "download: command 20ii", ""),
        (f"`{ACCEPTED:02X} ii {INDEX_HIGH:02X} ss 00000000`", "", "the command is accepted"),
        (f"`{REFUSED:02X} ii {INDEX_HIGH:02X} ss 00000000`", "", "the request is refused"),
        (f"`{UPLOAD:02X} ii {INDEX_HIGH:02X} ss xxxxxxxx`", "upload: query 20ii", ""),
        (f"`{quirks.upload_scs:02X} ii {INDEX_HIGH:02X} ss dddddddd`", "", "the answer"),
    )
    identifiers = (
        (f"{REQUEST:03X}h + address", "host", "request to one module"),
        (f"{REPLY:03X}h + address", "module", "its reply"),
        (f"{GENERAL_REQUEST:03X}h", "host", "request to every module; module 1 alone replies"),
        (f"{SYNC:03X}h", "host", "SYNC: command 2011h for every module, without a reply"),
        (f"{BOOT_UP:03X}h + address", "module", "boot-up, one byte 00h, at the end of a start-up"),
        (
            f"{EMERGENCY:03X}h + address",
            "module",
            "emergency: error code (low byte first), error register, 4 bytes of status, 00h",
        ),
        (f"{LMT_REQUEST:03X}h", "host", "address procedure: `04 01`, `11 adr`, `04 00`"),
        (f"{LMT_REPLY:03X}h", "module", "reply to `11 adr`: `11 00` accepted, `11 01` refused"),
    )
    return (
        "# The MAC23 on CAN\n\n"
        + prose(
            """What goes over the bus of a MAC23 on CAN, for those who write a host. The tables are
            those of the twin. The accepted values and the exchanges are what a fresh twin does,
            written as `candump` logs them."""
        )
        + "## Frames\n\n"
        + prose(
            f"""Identifiers have 11 bits. Addresses are 1 to 127; the factory's is 1. A request has
            8 bytes, and the module replies {quirks.reply_latency_us / 1000:g} ms after it.
            Parameters go most significant byte first, the index goes low byte first. Commands and
            queries share their indices: the direction decides. After 2000h, 2001h, the address
            procedure and power-up the module is deaf for {quirks.boot_time_ms / 1000:g} s."""
        )
        + table(["data", "request", "reply"], services)
        + "\n"
        + table(
            ["identifier", "from", "meaning"],
            ((a, b, " ".join(c.split())) for a, b, c in identifiers),
        )
        + "\n"
    )


def page(face: Face, head: str) -> str:
    """Everything of one face."""
    return (
        head
        + "## Commands and queries\n\n"
        + prose(
            """Numbers are decimal, indices and digits in frames hexadecimal. The letters of a
            parameter are explained with each command; `x`: any digit."""
        )
        + overview(face)
        + "\n"
        + table(
            ["query", "what it reads", "answer"],
            (
                (f"[{face.name(index)}](#{anchor(face, index)})", query.title, f"`{query.layout}`")
                for index, query in face.queries.items()
            ),
        )
        + "\n"
        + acceptance(face)
        + sections(face)
        + answer_bits(face)
        + other_switches(face)
    )


def serial_page() -> str:
    """The page of the serial interface."""
    face = SerialFace()
    return page(face, serial_head(face))


def can_page() -> str:
    """The page of the CAN interface."""
    face = CanFace()
    return page(face, can_head(face))
