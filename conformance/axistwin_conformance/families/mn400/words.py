"""Packets of the MN400 in words, for reports and for whoever reads a transcript."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.core.wording import PLACE, RUNNING
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.codec import BoardPacket, ReturnCode
from axistwin_conformance.families.mn400.grammar import PARAMETER, CommandRule, rule_of

# Commands of which the last one counts, as far as it has all parameters, and what moves depend on.
SETTINGS: Final = "BDFGIPVXY"
MOVES_BY: Final = frozenset({RUNNING, PLACE, *"BDFIPVX"})
EVERY_BOARD: Final = "all boards"


def hex_words(data: bytes) -> str:
    """Bytes that mean nothing: ``3 bytes: 81 2A 03``."""
    return f"{len(data)} bytes: {data.hex(' ').upper()}"


def explain_request(data: bytes) -> str:
    """Put what the host has sent into words: ``1: M1000,,-5 (move: m1 1000, m3 -5)``."""
    if not data:
        return "nothing sent"
    found, strays = codec.packets(data)
    told = [_request(packet) for packet in found]
    told += [hex_words(strays)] if strays else []
    return ", then ".join(told)


def _request(packet: BoardPacket) -> str:
    board = str(packet.board) if packet.board != codec.ALL_BOARDS else EVERY_BOARD
    return "; ".join((f"{board}: {command_words(packet.text)}", *packet.flaws))


def command_words(text: str) -> str:
    """A command as typed, and what it means: ``V500 (speed: speed 500)``."""
    if text == codec.END_OF_PROGRAM:
        return "Ctrl-D (end of the program)"
    shown = text if text.isprintable() else repr(text)
    rule = rule_of(text)
    if rule is None:
        return f"{shown or 'nothing'} (no command)"
    values = _values(rule, text[1:])
    return f"{shown} ({rule.title}{': ' if values else ''}{values})"


def touched(
    rule: CommandRule, text: str
) -> tuple[Mapping[str, str | None] | None, frozenset[str] | None]:
    """What a command changes of the state of a board, and what it depends on; None: not known."""
    parts = text[1:].split(",")
    is_whole = len(parts) == len(rule.parameters) and all(parts)
    value = text if is_whole else None  # what is left out may stay as it is
    if rule.letter in SETTINGS:
        return {rule.letter: value}, frozenset()
    if rule.letter == "L":
        return {PLACE: value}, frozenset({RUNNING, PLACE})
    if rule.moves and rule.letter != ")":
        return {RUNNING: None, PLACE: None}, MOVES_BY
    if rule.letter in "E*?":
        return {}, frozenset({RUNNING, PLACE} if rule.letter == "E" else ())
    return None, None


def _values(rule: CommandRule, body: str) -> str:
    """The parameters by their names, without those that are left out."""
    parts = body.split(",") if body else []
    names = [parameter.name for parameter in rule.parameters]
    if len(parts) > len(names) or not all(not one or PARAMETER.fullmatch(one) for one in parts):
        return "parameters of no sense" if parts else ""
    return ", ".join(f"{name} {part}" for name, part in zip(names, parts, strict=False) if part)


def explain_reply(data: bytes) -> str:
    """Put what boards have sent into words: ``1: E START, 1: E 5455,0,0,0``."""
    found, strays = codec.packets(data)
    told = [packet_words(packet) for packet in found]
    told += [hex_words(strays)] if strays else []
    return ", ".join(told)


def packet_words(packet: BoardPacket) -> str:
    """One packet of a board: ``1: M DONE``, ``1: E 0,0,0,0``."""
    shown = packet.command if packet.command.isprintable() else packet.payload[:1].hex().upper()
    if packet.code is not None:
        said = ReturnCode(packet.code).name + ("" if packet.has_null else " without null")
    else:
        value = packet.value
        said = value if value.isprintable() else packet.payload[1:].hex(" ").upper()
        said = said or "an empty value"
    return "; ".join((f"{packet.board}: {shown} {said}", *packet.flaws))
