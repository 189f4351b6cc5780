"""The faults of one wire at work: what becomes of a message, and what happens by itself.

Rules
-----
1. Faults act in the order in which they were added; what one makes of a message the next one gets.
   Which messages a fault chooses is decided by the message as its sender sent it.
2. Every fault draws from a stream of its own, made from the seed and its number.  Numbers count
   from 1 and are not used again: the same faults on the same messages do the same.
3. While a wire is disconnected or held, what would be heard is lost, in the direction of the fault,
   by the time at which it is complete.  On a bus that is held, nothing is complete.
4. A fault that has acted as often as it may stays in the list, with what it has done, until it is
   removed.  To remove one ends what it is doing.
"""

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, NamedTuple

from axistwin.errors import UnknownNameError, UsageError
from axistwin.kernel.seed import Draws, derive_seed
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.wire.can_frame import CanFrame
from axistwin.wire.wire_fault import FaultKind, Message, Wire, WireFault

FAULTS_MAX: Final = 64
ACTS_MAX: Final = 1000
"""How many acts are kept until somebody takes them."""

_CHANCES: Final = 1 << 53


class FaultReport(NamedTuple):
    """A fault of the list: its number, what it is, and what it has done so far.

    seen: messages that it could have chosen.  acted: how many times it did something.
    last: what it did last, and when; empty and None: nothing.
    """

    number: int
    fault: WireFault
    seen: int
    acted: int
    is_over: bool
    last_ns: Nanos | None
    last: str


class FaultAct(NamedTuple):
    """A fault did something at ``time_ns``: ``text`` tells what."""

    time_ns: Nanos
    number: int
    kind: FaultKind
    text: str


class Passage(NamedTuple):
    """What becomes of a message: its pieces, each with the time that it waits behind the last.

    break_ns: how long the sender holds the line at space before.
    """

    break_ns: Nanos
    pieces: list[tuple[Nanos, Any]]


class Disturbance(NamedTuple):
    """What a wire is to do now: a ``break``, a byte of ``noise``, or to be held (``busy``)."""

    kind: Literal["break", "noise", "busy"]
    fault: WireFault
    value: int
    """Of noise the byte, else the duration in nanoseconds."""


@dataclass(slots=True)
class _Outage:
    """From ``begin_ns`` up to ``end_ns`` nothing passes."""

    begin_ns: Nanos
    end_ns: Nanos
    at: "_Listed"
    has_begun: bool = False


@dataclass(slots=True)
class _Listed:
    """A fault at work; ``next_ns``: when it comes by itself."""

    number: int
    fault: WireFault
    draws: Draws
    next_ns: Nanos | None = None
    seen: int = 0
    acted: int = 0
    last_ns: Nanos | None = None
    last: str = ""

    @property
    def is_over(self) -> bool:
        limit = self.fault.limit
        return limit is not None and self.acted >= limit

    def chooses(self, message: Message, meaning: Callable[[Message], str]) -> bool:
        """Whether it acts on ``message``, which goes its way."""
        fault = self.fault
        if self.is_over or not fault.chooses_messages or not fault.fits(message):
            return False
        if fault.message and fault.message.lower() not in meaning(message).lower():
            return False
        if fault.kind == "corrupt" and not _data(message):
            return False
        self.seen += 1
        chance = 1.0 if fault.chance is None else fault.chance
        return chance >= 1.0 or self.draws.below(_CHANCES) < chance * _CHANCES

    def come_again(self, now: Nanos) -> None:
        """Find out when it comes by itself."""
        self.next_ns = None
        if self.fault.per_s is not None and not self.is_over:
            self.next_ns = now + 1 + self.draws.below(self.fault.gap_max_ns)


class WireFaults:
    """The faults of a ``wire``; ``explain`` gives the meaning of a message in words.

    ``acted``: how many times faults of each kind have acted, removed ones included.
    """

    def __init__(
        self,
        wire: Wire,
        explain: Callable[[Any], str] = lambda message: "",
        seed: int = 0,
    ) -> None:
        self.wire = wire
        self.acted: Counter[FaultKind] = Counter()
        self._explain = explain
        self._seed = seed
        self._listed: dict[int, _Listed] = {}
        self._outages: list[_Outage] = []
        self._acts: deque[FaultAct] = deque(maxlen=ACTS_MAX)
        self._added = 0
        self.is_idle = True
        """Whether nothing will become of any message, and nothing happens."""

    # -- the list --

    def add(self, fault: WireFault, now: Nanos) -> int:
        """Have ``fault`` act from now on; its number.  Raises UsageError if there are too many."""
        if len(self._listed) >= FAULTS_MAX:
            raise UsageError(f"there are {FAULTS_MAX} faults already; remove one")
        self._added = number = self._added + 1
        listed = _Listed(number, fault, Draws(derive_seed(self._seed, f"wire fault {number}")))
        self._listed[number] = listed
        if fault.is_immediate:
            listed.next_ns = now
        else:
            listed.come_again(now)
        self._look()
        return number

    def remove(self, number: int) -> FaultReport:
        """Take a fault away, and end what it is doing.  Raises UnknownNameError."""
        if number not in self._listed:
            known = ", ".join(map(str, self._listed)) or "none"
            raise UnknownNameError(f"no fault {number}: known: {known}")
        listed = self._listed.pop(number)
        self._outages = [each for each in self._outages if each.at is not listed]
        self._look()
        return _report(listed)

    def reports(self) -> list[FaultReport]:
        """All faults in the order of their numbers."""
        return [_report(each) for each in self._listed.values()]

    def _look(self) -> None:
        works = any(not each.is_over for each in self._listed.values())
        self.is_idle = not (works or self._outages)

    @property
    def has_acts(self) -> bool:
        """Whether there is something to take."""
        return bool(self._acts)

    def take_acts(self) -> list[FaultAct]:
        """What faults have done since last time, the last ``ACTS_MAX`` at most."""
        acts = list(self._acts)
        self._acts.clear()
        return acts

    def _note(self, listed: _Listed, now: Nanos, text: str) -> None:
        listed.acted += 1
        listed.last_ns, listed.last = now, text
        self.acted[listed.fault.kind] += 1
        self._acts.append(FaultAct(now, listed.number, listed.fault.kind, text))
        if listed.is_over:
            self._look()

    # -- messages --

    def passage(
        self, start_ns: Nanos, message: Message, *, to_host: bool, data_bits: int = 8
    ) -> Passage | None:
        """What becomes of ``message``, sent from ``start_ns`` on; None: it goes as it is."""
        changed: Passage | None = None
        for listed in tuple(self._listed.values()):
            if listed.fault.kind == "error_frame" or not listed.fault.concerns(to_host=to_host):
                continue
            if changed is not None and not changed.pieces:
                break
            if listed.chooses(message, self._explain):
                changed = changed or Passage(0, [(0, message)])
                changed, text = self._change(listed, changed, start_ns, data_bits)
                shown = message if isinstance(message, CanFrame) else message.hex(" ").upper()
                self._note(listed, start_ns, f"{text}: {shown}")
        return changed

    def _change(
        self, listed: _Listed, passage: Passage, start_ns: Nanos, data_bits: int
    ) -> tuple[Passage, str]:
        """What the fault makes of it, and what it did in words."""
        kind, duration_ns, draws = listed.fault.kind, listed.fault.duration_ns, listed.draws
        break_ns, pieces = passage
        (gap_ns, first), *rest = pieces
        last = f"{duration_ns / NS_PER_MS:g} ms"
        if kind == "corrupt":
            corrupted, text = _flipped(first, draws, data_bits)
            return Passage(break_ns, [(gap_ns, corrupted), *rest]), text
        if kind == "drop":
            return Passage(0, []), "lost"
        if kind == "duplicate":
            return Passage(break_ns, pieces + [(0, each) for _, each in pieces]), "came twice"
        if kind == "delay":
            return Passage(break_ns, [(gap_ns + duration_ns, first), *rest]), f"{last} later"
        if kind == "jitter":
            return _jittered(passage, draws, duration_ns), f"up to {last} later"
        if kind == "break":
            return Passage(break_ns + duration_ns, pieces), f"behind a break of {last}"
        assert kind in ("disconnect", "busy"), kind
        self._open(listed, start_ns)
        return passage, f"{kind} for {last} from here on"

    def destroys(self, now: Nanos, frame: CanFrame, *, to_host: bool) -> bool:
        """Whether an error frame destroys ``frame``, which is being sent."""
        for listed in self._listed.values():
            fault = listed.fault
            if fault.kind != "error_frame" or not fault.concerns(to_host=to_host):
                continue
            if listed.chooses(frame, self._explain):
                self._note(listed, now, f"destroyed: {frame}")
                return True
        return False

    # -- what happens by itself --

    def _open(self, listed: _Listed, now: Nanos) -> None:
        self._outages.append(_Outage(now, now + listed.fault.duration_ns, listed))
        self.is_idle = False

    def is_lost(self, time_ns: Nanos, *, to_host: bool) -> bool:
        """Whether what is complete at ``time_ns`` is not heard (rule 3)."""
        return any(
            each.begin_ns <= time_ns < each.end_ns
            and each.at.fault.concerns(to_host=to_host)
            and (self.wire == "serial" or each.at.fault.kind == "disconnect")
            for each in self._outages
        )

    def next_event(self) -> Nanos | None:
        """When something next begins, ends or comes by itself."""
        if self.is_idle:
            return None
        times = [each.next_ns for each in self._listed.values() if each.next_ns is not None]
        for outage in self._outages:
            times.append(outage.end_ns if outage.has_begun else outage.begin_ns)
        return min(times, default=None)

    def take_due(self, now: Nanos) -> list[Disturbance]:
        """What the wire is to do at ``now``."""
        due: list[Disturbance] = []
        for listed in self._listed.values():
            if listed.next_ns is not None and listed.next_ns <= now:
                due += self._come(listed, now)
                listed.come_again(now)
        for outage in self._outages:
            is_new, outage.has_begun = not outage.has_begun, outage.begin_ns <= now
            if is_new and outage.has_begun and outage.at.fault.kind == "busy":
                due.append(Disturbance("busy", outage.at.fault, outage.end_ns - now))
        self._outages = [each for each in self._outages if each.end_ns > now]
        self._look()
        return due

    def _come(self, listed: _Listed, now: Nanos) -> list[Disturbance]:
        """The fault comes by itself."""
        fault = listed.fault
        if fault.kind == "noise":
            value = listed.draws.below(256)
            self._note(listed, now, f"noise: {value:02X}")
            return [Disturbance("noise", fault, value)]
        self._note(listed, now, f"{fault.kind} for {fault.duration_ns / NS_PER_MS:g} ms")
        if fault.kind == "break":
            return [Disturbance("break", fault, fault.duration_ns)]
        self._open(listed, now)
        return []


def _report(listed: _Listed) -> FaultReport:
    return FaultReport(
        listed.number,
        listed.fault,
        listed.seen,
        listed.acted,
        listed.is_over,
        listed.last_ns,
        listed.last,
    )


def _data(message: Message) -> bytes:
    return message.data if isinstance(message, CanFrame) else message


def _flipped(message: Message, draws: Draws, data_bits: int) -> tuple[Message, str]:
    """``message`` with a bit flipped, and which."""
    data = bytearray(_data(message))
    place, bit = draws.below(len(data)), draws.below(data_bits)
    data[place] ^= 1 << bit
    text = f"bit {bit} of byte {place + 1} flipped"
    if isinstance(message, CanFrame):
        return replace(message, data=bytes(data)), text
    return bytes(data), text


def _jittered(passage: Passage, draws: Draws, most_ns: Nanos) -> Passage:
    """Every byte or frame by itself, each with a wait before it."""
    pieces: list[tuple[Nanos, Any]] = []
    for gap_ns, piece in passage.pieces:
        is_frame = isinstance(piece, CanFrame)
        units = [piece] if is_frame else [bytes([value]) for value in piece]
        for place, unit in enumerate(units):
            pieces.append((draws.below(most_ns + 1) + (0 if place else gap_ns), unit))
    return Passage(passage.break_ns, pieces)
