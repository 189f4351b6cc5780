"""What a program sees and does in one scan, and what it can wait for."""

from collections.abc import Callable
from typing import Any

from axistwin.kernel.time import Nanos


class ProgramError(Exception):
    """Something a program does that is not possible; stops it as any other exception does."""


def wrapped(value: int) -> int:
    """The signed 32-bit number that is left of ``value`` when what does not fit is cut off."""
    return (value & 0xFFFFFFFF) - ((value & 0x80000000) << 1)


class Scan:
    """What a program sees in one scan, and what it wants done at its end.

    The controller fills it in.  Flags are the bits of one number, flag 0 the lowest.
    """

    __slots__ = (
        "began_ns",
        "expired",
        "flags",
        "flags_before",
        "is_stopping",
        "new_data",
        "new_flags",
        "new_timers",
        "now_ns",
        "read",
        "stride",
    )

    def __init__(self, read: Callable[[int], int], stride: int, now: Nanos, flags: int) -> None:
        self.read = read
        self.stride = stride
        self.began_ns = self.now_ns = now
        self.flags = self.flags_before = flags
        self.expired = 0
        self.is_stopping = False
        self.new_flags: dict[int, bool] = {}
        self.new_data: dict[int, int] = {}
        self.new_timers: dict[int, Nanos | None] = {}


class ScannedProgram:
    """What sees and does everything through a scan: the base of ``Macroprogram``."""

    _scan: Scan
    _in_use: dict[str, Any]
    """Flags and arrays by the names that the program gives them."""


# -- what can be waited for --------------------------------------------------------------------


class Condition:
    """Something that holds or not: ask it with ``if``, or ``yield`` it to wait for it.

    ``first & second``, ``first | second`` and ``~first`` are conditions too.
    """

    __slots__ = ()

    is_timed = False
    """Whether it may come to hold although neither flags nor data change: see ``may_hold_ns``."""

    def holds(self) -> bool:
        """Whether it holds in the present scan."""
        raise NotImplementedError

    def may_hold_ns(self, now: Nanos) -> Nanos | None:
        """When after ``now`` it may come to hold with no flag changing; None: never."""
        return None

    def __bool__(self) -> bool:
        return self.holds()

    def __and__(self, other: "Condition") -> "Condition":
        return _Both(self, other)

    def __or__(self, other: "Condition") -> "Condition":
        return _Either(self, other)

    def __invert__(self) -> "Condition":
        return _Not(self)


class _Both(Condition):
    __slots__ = ("_first", "_may_hold_ns", "_second", "is_timed")

    def __init__(self, first: Condition, second: Condition) -> None:
        self._first, self._second = first.holds, second.holds
        self._may_hold_ns = [each.may_hold_ns for each in (first, second) if each.is_timed]
        self.is_timed = bool(self._may_hold_ns)

    def holds(self) -> bool:
        return self._first() and self._second()

    def may_hold_ns(self, now: Nanos) -> Nanos | None:
        times = [ask(now) for ask in self._may_hold_ns]
        return min((time for time in times if time is not None), default=None)


class _Either(_Both):
    __slots__ = ()

    def holds(self) -> bool:
        return self._first() or self._second()


class _Not(Condition):
    __slots__ = ("_condition", "is_timed")

    def __init__(self, condition: Condition) -> None:
        self._condition = condition
        self.is_timed = condition.is_timed

    def holds(self) -> bool:
        return not self._condition.holds()

    def may_hold_ns(self, now: Nanos) -> Nanos | None:
        return self._condition.may_hold_ns(now)


class After(Condition):
    """It is ``due_ns`` or later."""

    __slots__ = ("_due_ns", "_scan")

    is_timed = True

    def __init__(self, scan: Scan, due_ns: Nanos) -> None:
        self._scan, self._due_ns = scan, due_ns

    def holds(self) -> bool:
        """Whether that time has come."""
        return self._scan.now_ns >= self._due_ns

    def may_hold_ns(self, now: Nanos) -> Nanos | None:
        """That time, while it lies ahead."""
        return self._due_ns if self._due_ns > now else None


class Until(Condition):
    """A function says yes.  is_steady: as of ``until``."""

    __slots__ = ("_ask", "is_timed")

    def __init__(self, ask: Callable[[], object], *, is_steady: bool = False) -> None:
        self._ask, self.is_timed = ask, not is_steady

    def holds(self) -> bool:
        """Ask it."""
        return bool(self._ask())

    def may_hold_ns(self, now: Nanos) -> Nanos | None:
        """At any time, unless it is steady."""
        return now + 1 if self.is_timed else None  # whatever it looks at may change by itself


def until(ask: Callable[[], object], *, is_steady: bool = False) -> Condition:
    """A condition that holds when ``ask()`` is true; it is asked in each scan.

    ``yield ask`` does the same; this is for joining it with others.
    is_steady: ``ask`` looks at nothing but flags, variables and arrays of the program, and does
    nothing; then it need not be asked in scans before which none of them has changed.
    """
    return Until(ask, is_steady=is_steady)
