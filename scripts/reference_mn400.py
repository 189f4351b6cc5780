"""The protocol page of the MN400: tables and a transcript of the twin."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Final

from scripts.reference_tables import prose, table

from axistwin.devices.mn400.acceptance import TABLE, BoardState, Treatment
from axistwin.devices.mn400.device import Mn400Board
from axistwin.devices.mn400.grammar import COMMANDS, BoardParameter, Omitted
from axistwin.devices.mn400.link.decode import explain
from axistwin.devices.mn400.link.packets import OF_MN100, ReturnCode, packet
from axistwin.kernel.effects import Transmit
from axistwin.kernel.time import NS_PER_MS
from axistwin.wire.framing import Chunk

HEAD: Final = "# The serial port of the MN400\n\n" + "".join(
    prose(text)
    for text in (
        """This page describes the serial port of an MN400 for those who write a host. The tables
        are those of the twin. The transcript shows what the twin sends, byte for byte, with the
        default of every quirk. The [quirks](mn400-quirks.md) have a page of their own.""",
        """A request is an address byte (the number of the board with bit 7 set, 80h for all
        boards), the command's character, its parameters as decimal text with commas between them,
        the address byte again, and the sum of all that without bit 7. A board answers with START
        and DONE, or with START and a value. It sends nothing unasked but the replies of its
        configuration program at power-up, and TIMEOUT for a packet that breaks off.""",
    )
)

EXAMPLES: Final = ("*", "L5,0,-7,0", "E", "&", "K", "X3", "W", "M1000", "J1", "Q", "~0")

ANSWERS: Final = {
    Treatment.NOW: "obeyed at once",
    Treatment.QUEUED: "waits in the queue",
    Treatment.PENDING: "becomes the pending motion",
    Treatment.BUFFERED: "stored in the contour",
    Treatment.STORED: "stored as a line",
    Treatment.VOID: "START, DONE, no effect",
    Treatment.VALUE: "START, value",
    Treatment.LISTING: "START, one packet for each line",
    Treatment.POLL: "START, PRESENT",
    Treatment.RETRANSMIT: "the last message once more",
    Treatment.NOTHING_PENDING: "START, NOMOVEPENDING",
    Treatment.MOVE_PENDING: "START, MOVEPENDING",
    Treatment.BAUD: "START, BAUDCHANGEOK at the new rate",
    Treatment.BUSY: "START, BUSY",
    Treatment.INVALID: "INVALIDCOMMAND",
    Treatment.INVALID_LINE: "START, INVALIDPROGCOMM",
}

MEANINGS: Final = {
    Omitted.REQUIRED: "required",
    Omitted.KEEP: "keeps its value",
    Omitted.STAY: "keeps its value",
    Omitted.STILL: "none",
}


def _range(parameter: BoardParameter) -> str:
    """The values of a parameter, and what its omission means."""
    if parameter.allowed:
        values = "/".join(map(str, parameter.allowed))
    elif parameter.low is None and parameter.high is None:
        values = "32 bits" if parameter.is_long else "16 bits"
    else:
        values = f"{parameter.low}..{'' if parameter.high is None else parameter.high}"
    if parameter.is_sync:
        values += " or negative"
    omitted = parameter.omitted
    return f"{values} ({MEANINGS[omitted] if isinstance(omitted, Omitted) else omitted})"


def _parameters() -> Iterator[tuple[str, str, str]]:
    for letter, command in COMMANDS.items():
        alike = ((text, len(list(each))) for text, each in groupby(map(_range, command.parameters)))
        ranges = [f"{count} × {text}" if count > 1 else text for text, count in alike]
        yield f"`{letter}`", command.name, ", ".join(ranges) or "-"


def _transcript() -> str:
    """What the twin answers to the examples, in bytes and in words."""
    board, now, lines = Mn400Board(), 0, []
    for text in EXAMPLES:
        request = packet(1, text.encode())
        now += 100 * NS_PER_MS
        effects = [*board.wake(now), *board.receive(Chunk(now, request, board.line_format))]
        for _ in range(3):
            now += 20 * NS_PER_MS
            effects += board.wake(now)
        reply = b"".join(each.data for each in effects if isinstance(each, Transmit))
        for sign, data in ((">", request), ("<", reply)):
            lines += [f"{sign} {data.hex(' ').upper()}", f"      {explain(data)}"]
    return "```text\n" + "\n".join(lines) + "\n```\n"


def page() -> str:
    """The whole page."""
    states = list(BoardState)
    rows = (
        (f"`{letter}`", *(TABLE[letter, state].value for state in states)) for letter in COMMANDS
    )
    codes = (
        (f"{code.value:02X}", f"{code.name}{' (MN100)' if code in OF_MN100 else ''}")
        for code in ReturnCode
    )
    return (
        HEAD
        + "## Commands\n\nIn brackets: what an omitted parameter means.\n\n"
        + table(["command", "name", "parameters"], _parameters())
        + "\n## Return codes\n\n"
        + "MN100: only its [profile](../how-to/run-mn100-programs.md) uses them.\n\n"
        + table(["code", "name"], codes)
        + "\n## What a command does in each state\n\n"
        + table(["state", "meaning"], ((state.name, state.value) for state in states))
        + "\n"
        + table(["word", "meaning"], ((each.value, ANSWERS[each]) for each in Treatment))
        + "\n"
        + table(["command", *(state.name for state in states)], rows)
        + "\n## Transcript\n\n"
        + _transcript()
    )
