"""A MAC as its pages need it: how a fresh twin is asked, what it accepts, what changes its answers.

Each limit is found by asking a fresh module, so that a page cannot promise what the twin refuses.
All that is known here of the MAC twins stands in the imports of this file and of
``reference_mac_pages``.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import replace
from functools import cache
from typing import Any, ClassVar, Final

from scripts.reference_mac_words import COMMANDS, QUERIES, Command, Field, Query

from axistwin import catalog
from axistwin.devices.mac.axis.acceptance import SERIAL_ONLY, State, acceptance_table
from axistwin.devices.mac.axis.quirks import MacQuirks
from axistwin.devices.mac.can.device import (
    ACCEPTED,
    DOWNLOAD,
    INDEX_HIGH,
    REFUSED,
    REPLY,
    REQUEST,
    UPLOAD,
    UPLOAD_COUNT,
    MacCan,
)
from axistwin.devices.mac.can.quirks import MacCanQuirks
from axistwin.devices.mac.serial.device import MacSerial
from axistwin.devices.mac.serial.framing import GENERAL_ADDRESS, request
from axistwin.devices.switches import Quirk
from axistwin.kernel.effects import SendFrame, Transmit
from axistwin.wire.can_frame import CanFrame
from axistwin.wire.framing import Chunk, LineFormat
from axistwin_conformance.base.ledger import Requirement, load_ledger

LINE: Final = LineFormat(38400)
FIRST_QUERY: Final = 0x20

EVERYWHERE: Final = frozenset({"bootup_form", "subindex_policy", "lmt_other", "sdo_other_ccs"})
"""Switches that mention an index and concern no command of its own."""

NAMES: Final = {
    "segment": (0x16,),
    "position motion": (0x13,),
    "ramp": (0x0F,),
    "a motion starts": (0x13, 0x15, 0x16),
    "velocity": (0x15,),
    "speed change": (0x15,),
}
"""Words for commands in the meanings of switches."""

ALIKE: Final = {0x14: 0x13, 0x1E: 0x16}
"""Commands that do what another one does."""

MENTIONED: Final = re.compile(r"\b(?:20)?([0-2][0-9A-F])h\b")


class Face(ABC):
    """One way to a MAC module: how its page names things, and how a fresh module is asked."""

    model: ClassVar[str]
    ledger: ClassVar[str]
    requirement: ClassVar[str]
    requirement_page: ClassVar[str]
    quirk_page: ClassVar[str]
    defaults: ClassVar[MacQuirks]

    @abstractmethod
    def name(self, index: int) -> str:
        """A command or query as this face writes it."""

    @abstractmethod
    def renamed(self, text: str) -> str:
        """A text that names commands of the serial face, with this face's names."""

    @abstractmethod
    def ask(self, index: int, parameter: int = 0, sub_index: int = 0) -> tuple[Any, Any]:
        """What is sent to a fresh module, and its reply; None: silence."""

    @abstractmethod
    def is_accepted(self, reply: Any) -> bool:
        """Whether the reply says that the command was executed."""

    @abstractmethod
    def spell(self, data: Any) -> str:
        """A request or a reply as it is on the wire."""

    @property
    @abstractmethod
    def commands(self) -> dict[int, Command]:
        """The commands that it has."""

    @property
    @abstractmethod
    def queries(self) -> dict[int, Query]:
        """The queries that it has."""

    def exchange(self, index: int, parameter: int = 0, sub_index: int = 0) -> str:
        """A request and its reply, as bytes and in words."""
        explain = catalog.find_model(self.model).explain
        lines = []
        for arrow, data in zip("><", self.ask(index, parameter, sub_index), strict=True):
            lines += [f"{arrow} {self.spell(data)}", f"  {explain(data)}"]
        return "```text\n" + "\n".join(lines) + "\n```\n"


class SerialFace(Face):
    """Expert frames on a line."""

    model = "mac23"
    ledger = "mac_serial"
    requirement = "MACS"
    requirement_page = "mac-serial-requirements.md"
    quirk_page = "mac-serial-quirks.md"
    defaults = MacQuirks()

    def name(self, index: int) -> str:
        """``13h``."""
        return f"{index:02X}h"

    def renamed(self, text: str) -> str:
        """As it is."""
        return text

    def ask(self, index: int, parameter: int = 0, sub_index: int = 0) -> tuple[bytes, bytes | None]:
        """Module 0; the general address for 08h."""
        data = request(GENERAL_ADDRESS if index == 0x08 else 0, index, parameter, sub_index)
        effects = MacSerial(self.model).receive(Chunk(0, data, LINE))
        return data, next((each.data for each in effects if isinstance(each, Transmit)), None)

    def is_accepted(self, reply: bytes | None) -> bool:
        """Ack Xoff Xon."""
        assert reply is None or len(reply) == 3
        return reply is not None and reply[-1] == self.defaults.xon_byte

    def spell(self, data: bytes) -> str:
        """Its bytes in hex."""
        return data.hex(" ").upper()

    @property
    def commands(self) -> dict[int, Command]:
        """All."""
        return dict(COMMANDS)

    @property
    def queries(self) -> dict[int, Query]:
        """All."""
        return dict(QUERIES)


class CanFace(Face):
    """SDO requests on a bus."""

    model = "mac23-can"
    ledger = "mac_can"
    requirement = "MACC"
    requirement_page = "mac-can-requirements.md"
    quirk_page = "mac-can-quirks.md"
    defaults = MacCanQuirks()

    def name(self, index: int) -> str:
        """``2013h``; a query is an upload, and counts from 2000h."""
        return f"{INDEX_HIGH:02X}{index % FIRST_QUERY:02X}h"

    def renamed(self, text: str) -> str:
        """13h becomes 2013h."""
        return MENTIONED.sub(lambda found: self.name(int(found[1], 16)), text)

    def ask(
        self, index: int, parameter: int = 0, sub_index: int = 0
    ) -> tuple[CanFrame, CanFrame | None]:
        """Module 1."""
        command = UPLOAD if index >= FIRST_QUERY else DOWNLOAD
        head = bytes((command, index % FIRST_QUERY, INDEX_HIGH, sub_index))
        frame = CanFrame(REQUEST + 1, head + (parameter & 0xFFFFFFFF).to_bytes(4, "big"))
        effects = MacCan().receive(frame, 0)
        replies = (each.frame for each in effects if isinstance(each, SendFrame))
        return frame, next((each for each in replies if each.identifier == REPLY + 1), None)

    def is_accepted(self, reply: CanFrame | None) -> bool:
        """60h."""
        assert reply is None or reply.data[0] in (ACCEPTED, REFUSED)
        return reply is not None and reply.data[0] == ACCEPTED

    def spell(self, data: CanFrame) -> str:
        """As candump writes it in a log."""
        return f"{data.identifier:03X}#{data.data.hex().upper()}"

    @property
    def commands(self) -> dict[int, Command]:
        """All but address and rate."""
        return {index: each for index, each in COMMANDS.items() if index not in SERIAL_ONLY}

    @property
    def queries(self) -> dict[int, Query]:
        """All but the memories."""
        return dict(list(QUERIES.items())[:UPLOAD_COUNT])


# --- what is found out ----------------------------------------------------------------------------


def accepted(face: Face, index: int, field: Field) -> str:
    """The values of a field that a fresh module accepts, as ranges; the rest is refused."""
    rest = face.commands[index].sample & ~field.mask
    ranges: list[tuple[int, int]] = []
    was_taken = False
    for value in field.candidates():
        is_taken = face.is_accepted(face.ask(index, rest | field.placed(value))[1])
        if is_taken:
            ranges[-1:] = [(ranges[-1][0], value)] if was_taken else [*ranges[-1:], (value, value)]
        was_taken = is_taken
    return ", ".join(spelled(low, high) for low, high in ranges)


def spelled(low: int, high: int) -> str:
    """A range of values."""
    joint = ", " if high == low + 1 else ".."
    return f"{low}" if low == high else f"{low}{joint}{high}"


def touching(face: Face, index: int) -> list[str]:
    """The switches that change what a command or query does, in the order of the list.

    They name it, or change a cell of the acceptance table, or decide what one of its requirements
    leaves open.
    """
    book = load_ledger(face.ledger)
    requirements = requirements_of(face, index)
    open_points = [key for requirement in requirements for key in requirement.quirks]
    by_ledger = {name for key in open_points for name in book.ambiguities[key].switches}
    ids = {each.id for each in requirements}
    ids |= {covered for each in requirements for covered in each.covers}
    found = set(touching(face, ALIKE[index])) if index in ALIKE else set()
    quirks = catalog.find_model(face.model).quirks
    for name, quirk in quirks.items():
        cells = amended(face, name)
        if (
            index in named_by(quirk) | cells
            or quirk.source in ids
            or (not cells and name in by_ledger)
        ):
            found.add(name)
    return [name for name in quirks if name in found]


def named_by(quirk: Quirk) -> set[int]:
    """The commands and queries that the meaning of a switch names."""
    if quirk.name in EVERYWHERE:
        return set()
    found = {int(digits, 16) for digits in MENTIONED.findall(quirk.doc)}
    return found.union(*(indices for word, indices in NAMES.items() if word in quirk.doc))


@cache
def amended(face: Face, name: str) -> frozenset[int]:
    """The commands of which another reading of a switch changes the acceptance."""
    quirk = catalog.find_model(face.model).quirks[name]
    readings = quirk.choices or ((True, False) if quirk.kind == "bool" else ())
    usual = acceptance_table(face.defaults)
    found: set[int] = set()
    for reading in readings:
        setting: dict[str, Any] = {name: reading}
        cells = acceptance_table(replace(face.defaults, **setting))
        found |= {i for state in State for i in COMMANDS if cells[state][i] != usual[state][i]}
    return frozenset(found)


def requirements_of(face: Face, index: int) -> list[Requirement]:
    """Those that are named after a command or query, or after several with it among them."""
    service, low = ("Q", index) if index >= FIRST_QUERY else ("CMD", index)
    if isinstance(face, CanFace):
        low %= FIRST_QUERY
    form = re.compile(rf"{face.requirement}-{service}-(?:..)?{low:02X}(?:..)?-\d+$")
    return [each for key, each in load_ledger(face.ledger).requirements.items() if form.match(key)]
