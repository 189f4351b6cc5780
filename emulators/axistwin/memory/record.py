"""The record of a device's nonvolatile cells: text for people, with a checksum against damage.

Rules
-----
1. Two forms.  The *record* holds all cells and is replaced as a whole.  An *entry* holds the few
   cells that change by themselves (the position) and fits a place of fixed size, so that it can be
   overwritten where it stands.
2. Both carry the format's name and version, the device's model, a sequence number that grows with
   every write (the newer one holds), and a checksum over all of this.
3. There is exactly one text for a content.  Whatever does not read back as that very text is
   refused with the reason: a record is whole or it is nothing.
"""

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

from axistwin.errors import with_article

FORMAT = "axistwin state"
VERSION = 1

ENTRY_SIZE = 256
"""Bytes of an entry, filled up with blanks and ended by a line end."""

_SEQUENCE_MAX = 1 << 63


class RecordError(ValueError):
    """The text is no record of this model; the message says what is wrong with it."""


@dataclass(frozen=True, slots=True)
class Record:
    """``cells`` (name: value) of a device of ``model`` at the ``sequence``-th write, from 1."""

    model: str
    sequence: int
    cells: Mapping[str, int]


def encode(record: Record) -> bytes:
    """The record as indented JSON, one cell a line."""
    content = _content(record)
    return (json.dumps({**content, "checksum": _checksum(content)}, indent=2) + "\n").encode()


def decode(data: bytes, model: str) -> Record:
    """The record of a device of ``model``.  Raises RecordError."""
    record = _parse(data, model)
    if encode(record) != data:
        raise RecordError("it is damaged: the checksum does not fit the content")
    return record


def encode_entry(record: Record) -> bytes | None:
    """The record in ``ENTRY_SIZE`` bytes, or None if its cells need more."""
    content = _content(record)
    text = json.dumps({**content, "checksum": _checksum(content)}, separators=(",", ":"))
    return f"{text:<{ENTRY_SIZE - 1}}\n".encode() if len(text) < ENTRY_SIZE else None


def decode_entry(data: bytes, model: str) -> Record:
    """The entry of a device of ``model``.  Raises RecordError."""
    record = _parse(data, model)
    if encode_entry(record) != data:
        raise RecordError("it is damaged: the checksum does not fit the content")
    return record


def _content(record: Record) -> dict[str, object]:
    assert 1 <= record.sequence < _SEQUENCE_MAX, f"sequence {record.sequence} is out of range"
    return {
        "format": FORMAT,
        "version": VERSION,
        "model": record.model,
        "sequence": record.sequence,
        "cells": dict(sorted(record.cells.items())),
    }


def _checksum(content: Mapping[str, object]) -> str:
    canonical = json.dumps(content, separators=(",", ":"), sort_keys=True)
    return f"crc32:{zlib.crc32(canonical.encode()):08x}"


def _parse(data: bytes, model: str) -> Record:
    """The content of ``data``; whether it is damaged is not known yet.  Raises RecordError."""
    if not data:
        raise RecordError("it is empty")
    try:
        content = json.loads(data.decode("ascii"))
    except (ValueError, RecursionError):
        reason = "it is torn or damaged" if FORMAT.encode() in data else "it is no axistwin state"
        raise RecordError(reason) from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise RecordError("it is no axistwin state")
    version, found = content.get("version"), content.get("model")
    if type(version) is int and version != VERSION:
        if _is_whole(content):
            raise RecordError(f"it has version {version}, this program knows version {VERSION}")
        if version > VERSION:
            raise RecordError(
                f"it says version {version}, this program knows version {VERSION}: "
                "a newer axistwin has written it, or it is damaged"
            )
    sequence, cells = content.get("sequence"), content.get("cells")
    if (
        version != VERSION
        or not isinstance(found, str)
        or type(sequence) is not int
        or not 1 <= sequence < _SEQUENCE_MAX
        or not isinstance(cells, dict)
        or any(type(value) is not int for value in cells.values())
    ):
        raise RecordError("it is damaged: a field has an impossible value")
    if found != model and _is_whole(content):
        raise RecordError(f"it belongs to {with_article(found)}, not to {with_article(model)}")
    return Record(found, sequence, cells)


def _is_whole(content: Mapping[str, object]) -> bool:
    """Whether the checksum, of whatever version, fits the rest of the content."""
    rest = {name: value for name, value in content.items() if name != "checksum"}
    return content.get("checksum") == _checksum(rest)
