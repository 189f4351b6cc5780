"""The base class of programs, and the follower of a cam."""

from collections.abc import Callable, Generator, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeAlias

from axistwin.errors import AxistwinError, nearest
from axistwin.kernel.time import NS_PER_MS
from axistwin.macroprogram.declarations import Array, FlagDeclaration, Variable
from axistwin.macroprogram.scan import After, Condition, ProgramError, Scan, ScannedProgram

Steps: TypeAlias = Generator[Any, None, None]
"""What ``run`` returns: ``yield`` a condition, a function to be asked, or nothing (one scan)."""


class Macroprogram(ScannedProgram):
    """Base class of all programs: override ``run`` or ``scan``, or both; ``scan`` comes first.

    auto_start: whether it starts when the supply is applied (status bit 6); None: as the unit is
    set.  scan_ms: time from one scan to the next; None: as the unit is set.
    """

    auto_start: ClassVar[bool | None] = None
    scan_ms: ClassVar[float | None] = None

    if not TYPE_CHECKING:  # or else no misspelt name would be found by a type checker

        def __getattr__(self, name: str) -> Any:
            kind = type(self).__name__
            if name in ("_scan", "_in_use"):
                raise ProgramError(
                    f"{kind}.__init__ cannot use flags and data: there is no scan yet; do it in "
                    "run or scan, or declare initial values"
                )
            known = [each for each in dir(self) if not each.startswith("_")]
            raise AttributeError(f"{kind} has no {name}: {nearest(name, known)}")

    def scan(self) -> None:
        """Called in every scan; by default nothing is done."""

    def run(self) -> Steps:
        """A sequence of steps: each ``yield`` ends a scan and says what is waited for.

        ``yield`` alone waits for the next scan; what is waited for is looked at from the next scan
        on, in every one, until it holds.
        """
        yield from ()

    # -- for use in run and scan --

    @property
    def time_ms(self) -> float:
        """Time since the program was started, milliseconds."""
        return (self._scan.now_ns - self._scan.began_ns) / NS_PER_MS

    def after_ms(self, duration_ms: float) -> Condition:
        """A condition that holds from ``duration_ms`` (>= 0) after this scan on."""
        if not 0 <= duration_ms < 1e12:
            raise ProgramError(f"{duration_ms} ms cannot be waited for; give 0 or more")
        return After(self._scan, self._scan.now_ns + round(duration_ms * NS_PER_MS))

    def stop(self) -> None:
        """Stop the program at the end of this scan."""
        self._scan.is_stopping = True

    def fault(self, reason: str) -> None:
        """Stop the program at once with a script error (status bit 12).  Raises ProgramError."""
        raise ProgramError(reason)


Program: TypeAlias = Callable[[], Macroprogram]
"""A class of programs, or what makes an object of one."""


def attach(program: Macroprogram, scan: Scan) -> None:
    """Let ``program`` see and do what it does through ``scan``."""
    program._scan = scan
    program._in_use = {}


def declared(program: type[Macroprogram]) -> dict[str, Any]:
    """The flags, variables and arrays that a program's class and its bases name."""
    kinds = (FlagDeclaration, Variable, Array)
    names = {name: None for base in reversed(program.__mro__) for name in vars(base)}
    found = {name: getattr(program, name) for name in names}
    return {name: each for name, each in found.items() if isinstance(each, kinds)}


def is_generator(function: Callable[..., object]) -> bool:
    """Whether ``function`` has a ``yield``."""
    code = getattr(function, "__code__", None)
    return code is not None and bool(code.co_flags & _CO_GENERATOR)


def file_of(kind: type[Macroprogram]) -> str:
    """The file in which a program does its work."""
    work = kind.scan if kind.run is Macroprogram.run else kind.run
    code = getattr(work, "__code__", None)
    return str(code.co_filename) if code is not None else kind.__module__


_CO_GENERATOR: Final = 0x20
"""As in ``inspect.CO_GENERATOR``."""

_OWN_FOLDER: Final = __file__.removesuffix("program.py")
_CALLERS: Final = ("axistwin/devices/msc/program.py", "axistwin/programs/__init__.py")
_OWN_FILES: Final = (*_CALLERS, "axistwin/cli/run/watchdog.py")


class NeverReturns(BaseException):
    """A program is stopped that would go on for ever; what catches errors does not catch it."""


def calls_programs(file: str) -> bool:
    """Whether it is in ``file`` that users' programs are called."""
    return file.replace("\\", "/").endswith(_CALLERS)


def located(error: BaseException) -> str:
    """Where in the user's file ``error`` arose, and what it says."""
    place = ""
    trace = error.__traceback__
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if not (file.startswith(_OWN_FOLDER) or file.replace("\\", "/").endswith(_OWN_FILES)):
            place = f"{file}:{trace.tb_lineno}: "
        trace = trace.tb_next
    is_ours = isinstance(error, ProgramError | AxistwinError | NeverReturns)
    kind = "" if is_ours else f"{type(error).__name__}: "
    return f"{place}{kind}{error}"


def cam_position(table: Sequence[int], master: int, period: int, *, is_cyclic: bool = True) -> int:
    """Where a cam's follower is when the master is at ``master``: a straight line between points.

    table: positions of the follower at equal distances of the master.  period: how far the master
    goes in one cycle, > 0.  A cyclic table has the points at 0, ``period/n``, ... and comes back to
    its first at ``period``; any other one goes from its first point at 0 to its last at ``period``
    and stands still outside.  Rounded to the nearest whole number, halves up.
    Raises ProgramError for an empty table or a period that is not above 0.
    """
    size = len(table)
    if period <= 0 or size == 0:
        raise ProgramError(f"a cam needs points and a period above 0, not {size} and {period}")
    spans = size if is_cyclic else size - 1
    if is_cyclic:
        master %= period
    else:
        master = min(max(master, 0), period)
    place, rest = divmod(master * spans, period)
    first = table[place]
    if rest == 0:
        return first
    second = table[(place + 1) % size]
    return (2 * (first * period + (second - first) * rest) + period) // (2 * period)
