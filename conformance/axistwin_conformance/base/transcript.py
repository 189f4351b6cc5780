"""The record of everything said on the wire, with times, and marks of what was being tried."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import islice, takewhile
from typing import TypeAlias

PIECES_APART_NS = 30_000_000  # beside the time that the bytes of the later piece take
SLOWEST_BYTE_NS = 1_041_667  # at 9600 baud
ACK = b"\x06"  # what every family says before it answers
SURELY_OURS = 4  # bytes in a row that no reply has by chance: the shortest request (MN400)
RECORDS_KEPT = 20_000  # some minutes at full line rate: more than any failure needs, flat memory


class Direction(StrEnum):
    """Who is speaking in a record."""

    HOST = "host"
    DEVICE = "device"
    SILENCE = "silence"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Record:
    """One thing that happened: bytes one way or the other, an awaited reply that did not come
    (`text` says how long was waited), or a mark set by a check or the engine.

    `time_ns` is the target's clock: for the host the time of sending, for the device the time at
    which the last of these bytes was in our hands.
    """

    time_ns: int
    direction: Direction
    data: bytes = b""
    text: str = ""


_Piece: TypeAlias = tuple[int, Direction, bytes, str]  # what makes a `Record`


class Transcript:
    """A bounded log of records; older ones fall out, positions stay valid.

    `is_in_pieces`: a message may come in several records; False where each is whole (a frame).
    Most of what is said is never looked at: a `Record` is made of it when somebody does.
    """

    def __init__(self, kept: int = RECORDS_KEPT, *, is_in_pieces: bool = True) -> None:
        self._is_in_pieces = is_in_pieces
        self._records: deque[_Piece] = deque(maxlen=kept)
        self._count = 0

    def __len__(self) -> int:
        return len(self._records)

    def __iter__(self) -> Iterator[Record]:
        return (Record(*record) for record in self._records)

    def __reversed__(self) -> Iterator[Record]:
        return (Record(*record) for record in reversed(self._records))

    @property
    def position(self) -> int:
        """The number of records ever made: a mark for `since`."""
        return self._count

    def add(self, record: Record) -> None:
        """Append a record."""
        self.note(record.time_ns, record.direction, record.data, record.text)

    def note(self, time_ns: int, direction: Direction, data: bytes = b"", text: str = "") -> None:
        """Append what would make a record."""
        self._records.append((time_ns, direction, data, text))
        self._count += 1

    @property
    def has_echo(self) -> bool:
        """True if a request has come back as it was: we hear ourselves.  Behind an ACK it may be
        an answer: an MSC tells that flag 0 is off by the same bytes that ask for it."""
        heard = b"".join(record.data for record in self if record.direction is Direction.DEVICE)
        asked = {record.data for record in self if record.direction is Direction.HOST}
        return any(is_echoed(data, heard.replace(ACK + data, b"")) for data in asked)

    def since(self, position: int, limit: int | None = None) -> tuple[Record, ...]:
        """Return what was recorded after `position`, at most the last `limit` records.

        A reply is read in pieces, as its length becomes known; here it is whole again.
        """
        wanted = min(self._count - position, len(self._records))
        latest = list(islice(reversed(self._records), max(0, wanted)))  # however long the log is
        whole: list[_Piece] = []
        for piece in reversed(latest):
            if self._is_in_pieces and whole and _belong_together(whole[-1], piece):
                time_ns, direction, data, text = piece
                piece = time_ns, direction, whole.pop()[2] + data, text
            whole.append(piece)
        return tuple(Record(*piece) for piece in (whole if limit is None else whole[-limit:]))

    def since_request(self, limit: int) -> tuple[Record, ...]:
        """Return the last request and what was recorded after it; nothing if there is none among
        the last `limit` records."""
        for back, piece in enumerate(islice(reversed(self._records), limit), 1):
            if piece[1] is Direction.HOST:
                return self.since(self._count - back)
        return ()

    def has_come(self, since_ns: int) -> bool:
        """True if anything has come from the device since then."""
        latest = takewhile(lambda piece: piece[0] >= since_ns, reversed(self._records))
        return any(direction is Direction.DEVICE for _, direction, _, _ in latest)

    def since_sent_s(self, now_ns: int) -> float:
        """How long ago the last request was sent; 0 where none is recorded."""
        sent = (piece[0] for piece in reversed(self._records) if piece[1] is Direction.HOST)
        return (now_ns - next(sent, now_ns)) / 1e9


def is_echoed(request: bytes, heard: bytes) -> bool:
    """True if a request has come back as it was."""
    return len(request) >= SURELY_OURS and request in heard


def last_exchange(records: Iterable[Record]) -> tuple[bytes, bytes]:
    """What the host sent last, and what came since; nothing sent: empty."""
    request, reply = b"", b""
    for record in records:
        if record.direction is Direction.HOST:
            request, reply = record.data, b""
        elif record.direction is Direction.DEVICE:
            reply += record.data
    return request, reply


def _belong_together(earlier: _Piece, later: _Piece) -> bool:
    if not earlier[1] is later[1] is Direction.DEVICE:
        return False
    return later[0] - earlier[0] <= PIECES_APART_NS + len(later[2]) * SLOWEST_BYTE_NS
