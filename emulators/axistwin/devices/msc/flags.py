"""The 256 flags of a controller: inputs, outputs, timers, motor status, user flags.

Rules
-----
1. A flag's kind tells who may write it: the host only outputs and user flags (MSC-SFLAG-02,
   MSC-CFLAG-02), a program all but timers, the back door all.
2. A timer's flag is on while the timer runs (MSC-AMB-41).  It follows from the time, exactly.
3. A program that is stopped reacts to nothing, and its timers hold (ledger §5.4): their time stands
   still until it goes on.
4. All flags are volatile: off at power-up.

Kinds of the numbers: the manual names the kinds and gives no numbers (MSC-AMB-24).  The map
``generic`` is invented:

    0-15 input   16-31 output   32-39 timer   40-71 motor status   128-255 user
"""

from enum import Enum
from typing import Final

from axistwin.errors import UsageError
from axistwin.kernel.time import Nanos

FLAGS: Final = 256
"""How many there are: 0 to 255 (MSC-FLG-01)."""


class FlagKind(Enum):
    """What a flag stands for."""

    INPUT = "input"
    OUTPUT = "output"
    TIMER = "timer"
    MOTOR = "motor"
    USER = "user"
    UNASSIGNED = "unassigned"


_HOST_WRITES = frozenset((FlagKind.OUTPUT, FlagKind.USER))

FlagMap = tuple[FlagKind, ...]
"""The kind of each of the 256 flags."""

_GENERIC = "input:0-15/output:16-31/timer:32-39/motor:40-71/user:128-255"


def parse_flag_map(text: str) -> FlagMap | None:
    """The kinds that ``text`` gives: ``generic``, or ``KIND:FIRST-LAST`` joined by slashes.

    A flag that is not named is unassigned.  None if it means nothing, or names a flag twice.
    """
    kinds = [FlagKind.UNASSIGNED] * FLAGS
    for entry in (_GENERIC if text == "generic" else text).split("/"):
        name, _, span = entry.partition(":")
        first, dash, last = span.partition("-")
        numbers = _span(first, last if dash else first)
        known = [kind for kind in FlagKind if kind.value == name]
        if numbers is None or not known:
            return None
        for number in numbers:
            if kinds[number] is not FlagKind.UNASSIGNED:
                return None
            kinds[number] = known[0]
    return tuple(kinds)


def _span(first: str, last: str) -> range | None:
    """The flags from ``first`` to ``last``, in decimal digits."""
    if not all(part.isascii() and part.isdigit() and len(part) <= 3 for part in (first, last)):
        return None
    low, high = int(first), int(last)
    return range(low, high + 1) if low <= high < FLAGS else None


class Flags:
    """The flags of one unit, all off.

    kinds: of ``parse_flag_map``.  is_on_expired: a timer's flag is on when the timer has expired,
    not while it runs (MSC-AMB-41).
    """

    def __init__(self, kinds: FlagMap, *, is_on_expired: bool = False) -> None:
        assert len(kinds) == FLAGS
        self.kinds = kinds
        self._is_on_expired = is_on_expired
        self._on = 0  # one bit each, flag 0 the lowest
        self._timers: dict[int, Nanos] = {}  # when each runs out; while held: how long it has left
        self._held_ns: Nanos | None = None
        self._forced = 0  # bits that the host has turned over until the next scan

    # -- reading --

    def kind(self, number: int) -> FlagKind:
        """What flag ``number`` (0..255) stands for."""
        return self.kinds[number]

    def state(self, now: Nanos, number: int) -> bool:
        """Whether flag ``number`` (0..255) is on."""
        return bool(self.states(now) >> number & 1)

    def states(self, now: Nanos) -> int:
        """All flags as one number: flag f is bit f."""
        states = self._on
        for number, due in self._timers.items():
            runs = due > (now if self._held_ns is None else self._held_ns)
            if runs is not self._is_on_expired:
                states |= 1 << number
        return states ^ self._forced

    def snapshot(self, now: Nanos) -> bytes:
        """The 32 bytes of RFLAGS: flag f is bit f mod 8 of byte f // 8 (MSC-RFLAGS-02)."""
        return self.states(now).to_bytes(FLAGS // 8, "little")

    # -- writing --

    def may_host_write(self, number: int) -> bool:
        """Whether SFLAG and CFLAG have an effect on flag ``number`` (MSC-SFLAG-03)."""
        return self.kinds[number] in _HOST_WRITES

    def set(self, number: int, on: bool) -> None:
        """Turn flag ``number`` (0..255) on or off; a timer is started without end, or stopped."""
        bit = 1 << number
        self._forced &= ~bit
        self._timers.pop(number, None)
        if on:
            self._on |= bit
        else:
            self._on &= ~bit

    def force(self, now: Nanos, number: int, on: bool) -> None:
        """Let flag ``number`` read ``on`` until ``release`` (MSC-AMB-23, ``force``)."""
        if self.state(now, number) is not on:
            self._forced ^= 1 << number

    def release(self) -> None:
        """A scan begins: forced flags follow their own sources again."""
        self._forced = 0

    # -- timers --

    def start_timer(self, now: Nanos, number: int, duration_ns: Nanos) -> None:
        """Let timer ``number`` run for ``duration_ns`` (>= 0), from the beginning."""
        if self.kinds[number] is not FlagKind.TIMER:
            raise UsageError(f"flag {number} is no timer; timers are {self.spans(FlagKind.TIMER)}")
        self.set(number, on=False)
        self._timers[number] = now + duration_ns

    def stop_timer(self, number: int) -> None:
        """Stop timer ``number``: its flag is off."""
        self.set(number, on=False)

    def due_ns(self, number: int) -> Nanos | None:
        """When timer ``number`` runs out, or ran out; None if nobody started it."""
        return self._timers.get(number)

    def next_expiry(self, now: Nanos) -> Nanos | None:
        """When the next timer runs out; None: none runs."""
        if self._held_ns is not None:
            return None
        return min((due for due in self._timers.values() if due > now), default=None)

    def hold(self, now: Nanos) -> None:
        """Timers stand still from now on (rule 3)."""
        if self._held_ns is None:
            self._held_ns = now

    def resume(self, now: Nanos) -> None:
        """Timers go on from where they stood."""
        if self._held_ns is not None:
            late_ns = now - self._held_ns
            for number, due in self._timers.items():
                if due > self._held_ns:
                    self._timers[number] = due + late_ns
            self._held_ns = None

    # -- all at once --

    def clear(self) -> None:
        """Everything is off, as at power-up (rule 4)."""
        self._on = self._forced = 0
        self._timers.clear()
        self._held_ns = None

    def spans(self, kind: FlagKind) -> str:
        """The numbers of a kind in words: ``32..39``, or ``none``."""
        numbers = [number for number in range(FLAGS) if self.kinds[number] is kind]
        return _ranges(numbers) or "none"


def _ranges(numbers: list[int]) -> str:
    """``0..15, 17`` for ascending ``numbers``."""
    starts = [n for n in numbers if n - 1 not in numbers]
    ends = [n for n in numbers if n + 1 not in numbers]
    return ", ".join(str(a) if a == b else f"{a}..{b}" for a, b in zip(starts, ends, strict=True))
