"""Replies that are not as the manual asks, read all the same, so that the rest can be judged.

A family reads a reply under a grammar that names each thing in which it departs
(`Family.lenient`).  The engine judges what departs the same way time after time, and from then on
replies are handed on as a sound device would have put them, where they depart by nothing else
(`Mending`): a wrong sum hides no wrong value.

A departure is known by its requirement and its name; what was expected and came differs from reply
to reply.  What came so far and is the beginning of a reply departs by `COMPLETENESS`; its `mended`
is what can be handed on already.  A reply that nothing can be made of has an empty one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from axistwin_conformance.base.transcript import Direction, Record, is_echoed

COMPLETENESS: Final = "completeness"
MOST_HELD: Final = 2048  # bytes: a device that never stops talking is not mended


@dataclass(frozen=True, slots=True)
class ReplyDeparture:
    """One thing in which a reply is not as the manual asks."""

    requirement: str
    name: str
    expected: str
    actual: str

    @property
    def key(self) -> tuple[str, str]:
        """What it has in common with that of another reply."""
        return self.requirement, self.name


@dataclass(frozen=True, slots=True)
class Lenient:
    """A reply read leniently; `mended`: as a sound device would have put it."""

    departures: tuple[ReplyDeparture, ...]
    mended: bytes


Reader = Callable[[bytes, bytes], Lenient | None]  # request, and what came of it


@dataclass(frozen=True, slots=True)
class SteadyReply:
    """What came of one request as often as noise does not make it, read leniently."""

    request: bytes
    reply: bytes
    lenient: Lenient


def steady_replies(records: Iterable[Record], read: Reader, needed: int) -> tuple[SteadyReply, ...]:
    """The replies that can be read and came `needed` times alike to the same request; none of them
    is the request itself: who hears himself has heard no device."""
    counted = Counter(_exchanges(records))
    return tuple(
        SteadyReply(request, reply, lenient)
        for (request, reply), count in counted.items()
        if reply
        and count >= needed
        and not is_echoed(request, reply)
        and (lenient := read(request, reply)) is not None
    )


def _exchanges(records: Iterable[Record]) -> Iterator[tuple[bytes, bytes]]:
    request, reply = b"", b""
    for record in records:
        if record.direction is Direction.HOST:
            yield request, reply
            request, reply = record.data, b""
        elif record.direction is Direction.DEVICE:
            reply += record.data
    yield request, reply


@dataclass(slots=True)
class Mending:
    """Hands on what a device sends as a sound one would have put it, where it departs by what is
    known and by nothing else.

    `read`: the family's.  `is_due`: whether a request has one known form of reply.  `known`: what
    has been judged already, shared by all lines of a run.  `is_off`: everything is handed on as it
    comes.
    """

    read: Reader
    is_due: Callable[[bytes], bool]
    known: dict[tuple[str, str], ReplyDeparture]
    is_off: bool = False
    _request: bytes = b""
    _heard: bytes = b""  # of one reply, all that came
    _settled: int = 0  # of that, how much has been handed on, mended or not
    _handed: bytes = b""  # what was handed on for it
    _is_awaited: bool = False

    @property
    def requirements(self) -> frozenset[str]:
        """Those that have failed by what is known."""
        return frozenset(requirement for requirement, _ in self.known)

    @property
    def is_holding(self) -> bool:
        """True if something has come and was not handed on yet."""
        return len(self._heard) > self._settled

    def begin(self, request: bytes) -> None:
        """A request goes out; what comes from now on is its reply."""
        self._forget()
        self._request, self._is_awaited = request, self.is_due(request)

    def hear(self, data: bytes) -> bytes:
        """Something has come: return what can be handed on now."""
        if self.is_off:
            return data
        self._heard += data
        lenient = self.read(self._request, self._heard)
        if lenient is None or len(self._heard) > MOST_HELD:
            is_hopeful = self._is_awaited and len(self._heard) <= MOST_HELD
            return b"" if is_hopeful else self.give_up()
        new = {one.key for one in lenient.departures} - self.known.keys()
        is_begun = any(name == COMPLETENESS for _, name in new)
        is_known = all(name == COMPLETENESS for _, name in new)
        mended = lenient.mended
        if not is_known or not mended.startswith(self._handed):
            return b""
        handed = mended[len(self._handed) :]
        self._handed, self._settled = mended, len(mended if is_begun else self._heard)
        return handed

    def give_up(self) -> bytes:
        """Nothing more comes for now: what was held back is handed on as it came."""
        rest = self._heard[self._settled :]
        self._forget()
        return rest

    def _forget(self) -> None:
        self._heard = self._handed = b""
        self._settled = 0
