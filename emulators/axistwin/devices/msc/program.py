"""The macroprogram in a controller: a user's class (``axistwin.macroprogram``), run in scans.

Rules
-----
1. The first scan is at the start, the others follow one scan time apart.  A scan takes no time: it
   sees flags and data as they are, and what it sets is done when it has returned.
2. Scans are made up for when somebody looks (``wake``), in their order and with their own times,
   each exactly as if made when due: between two looks nothing can tell the difference.  So an hour
   of scans costs little more than the user's own code.
3. A program that only waits, for flags or for a time, is not even run: until a flag changes, or
   that time comes, each of its scans would do nothing but count (``ScanCount``).
4. What the host writes is seen in the next scan; with ``write_visibility=immediate`` there is one
   more at once (MSC-AMB-33).
5. A stray return stops the program and sets status bit 4; an exception bit 12, and nothing of its
   scan is done (ledger §5.7).  Flags, outputs and data stay, timers hold (MSC-AMB-32).
"""

import contextlib
from typing import Final

from axistwin.devices.msc.data_area import DataArea
from axistwin.devices.msc.flags import FlagKind, Flags
from axistwin.devices.msc.quirks import MscQuirks
from axistwin.devices.msc.status import Status, StatusBit
from axistwin.devices.program_traces import (
    ProgramFailed,
    ProgramStarted,
    ProgramStopped,
    StrayReturn,
)
from axistwin.errors import UsageError
from axistwin.kernel.effects import Trace
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.macroprogram.declarations import (
    Array,
    FlagDeclaration,
    FlagInUse,
    ScanCount,
    Variable,
)
from axistwin.macroprogram.program import (
    Macroprogram,
    NeverReturns,
    Program,
    Steps,
    attach,
    declared,
    file_of,
    is_generator,
    located,
)
from axistwin.macroprogram.scan import Condition, ProgramError, Scan, Until, wrapped

BATCH_SCANS: Final = 10
"""At most so many scans are made up for at once when time passes and nobody looks."""

SCAN_MIN_MS, SCAN_MAX_MS = 0.1, 60_000.0


class ProgramRunner:
    """One program in one controller, stopped.

    program: None for none.  scan_ns: of a program that does not name its own.
    Raises UsageError if the program does not fit: its flags' kinds, its addresses.
    """

    def __init__(
        self,
        program: Program | None,
        data: DataArea,
        flags: Flags,
        status: Status,
        *,
        scan_ns: Nanos,
        quirks: MscQuirks,
    ) -> None:
        self._data = data
        self._flags = flags
        self._status = status
        self._quirks = quirks
        self._program = program
        self.instance: Macroprogram | None = None
        """The program as it runs, or ran last; a new one for each start."""
        self.names: dict[str, int] = {}
        """Numbers of the flags and addresses of the variables by the program's names."""
        self.error: str | None = None
        """The script error that ended the program last: where, and what."""
        self._scan_ns = scan_ns
        self._counts: list[int] = []  # the addresses at which scans are counted
        self._is_auto_started = quirks.auto_start
        self._next_ns: Nanos | None = None  # the next scan; None while it does not run
        self._scan = Scan(data.read, data.stride, 0, 0)
        self._calls_scan = False
        self._steps: Steps | None = None
        self._awaited: Condition | None = None
        self._due: dict[int, Nanos] = {}  # when timers that the program started run out
        self._traces: list[Trace] = []
        if program is not None:
            self._fit(program)

    # -- what the controller asks --

    @property
    def has_program(self) -> bool:
        """Whether there is something to start."""
        return self._program is not None

    @property
    def is_auto_started(self) -> bool:
        """Whether the program starts when the supply is applied: it says so, or the unit is set."""
        return self._is_auto_started

    @property
    def is_running(self) -> bool:
        """Whether the program runs, as of the last ``wake``."""
        return self._next_ns is not None

    def next_event(self) -> Nanos | None:
        """When ``wake`` should be called at the latest, though nobody looks."""
        if self._next_ns is None:
            return None
        if not self._rests():
            return self._next_ns + (BATCH_SCANS - 1) * self._scan_ns
        change_ns = self._next_change()
        return None if change_ns is None else self._first_scan(change_ns)

    def wake(self, now: Nanos) -> bool:
        """Make up for all scans due by ``now``; whether that changed data.

        To be called before anything looks at, or changes, flags, data or status.
        """
        while self._next_ns is not None and self._next_ns <= now:
            if self._rests():
                change_ns = self._next_change()
                if change_ns is None or change_ns > now:
                    change_ns = now + 1
                resting_ns, self._next_ns = self._next_ns, self._first_scan(change_ns)
                self._count_scans((self._next_ns - resting_ns) // self._scan_ns)
                if self._next_ns > now:
                    break
            due_ns = self._next_ns
            self._next_ns = due_ns + self._scan_ns
            self._flags.release()
            self._perform_scan(due_ns)
        return self._data.is_changed

    def take_traces(self) -> list[Trace]:
        """What is worth telling since last time: starts, stops and errors."""
        traces, self._traces = self._traces, []
        return traces

    # -- what the controller does --

    def start(self, now: Nanos) -> None:
        """Start the program from its beginning, with a new object.  Raises UsageError if none."""
        if self._program is None:
            raise UsageError("there is no program to start; load one first")
        self.stop(now)
        self._status.set(StatusBit.SYSTEM_RETURN | StatusBit.BAD_OPCODE, on=False)
        self._status.set(StatusBit.RUNNING)
        self._flags.resume(now)
        self.error = None
        self._scan = Scan(self._data.read, self._data.stride, now, self._flags.states(now))
        self._next_ns = now
        self._due.clear()
        self._awaited = None
        self._traces.append(ProgramStarted(now))
        try:
            program = self._program()
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            self._fail(now, error)
            return
        attach(program, self._scan)
        self.instance = program
        kind = type(program)
        self._calls_scan = kind.scan is not Macroprogram.scan
        self._steps = None if kind.run is Macroprogram.run else program.run()

    def stop(self, now: Nanos) -> None:
        """Stop the program, if it runs (MSC-AMB-32)."""
        if self._next_ns is not None:
            self._end(now, ProgramStopped(now))

    # -- what the host does --

    def host_wrote(self, now: Nanos) -> None:
        """The host changed flags or data at ``now`` (MSC-AMB-33)."""
        if self._next_ns is None or self._quirks.write_visibility == "next_scan":
            return
        self._perform_scan(now)

    # -- scans --

    def _perform_scan(self, now: Nanos) -> None:
        """Let the program do one scan at ``now``."""
        scan = self._scan
        scan.now_ns = now
        scan.flags_before, scan.flags = scan.flags, self._flags.states(now)
        scan.expired = self._take_expired(now) if self._due else 0
        is_over = False
        try:
            if self._calls_scan and self.instance is not None:
                self.instance.scan()
            if self._steps is not None:
                is_over = self._step(self._steps)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # sys.exit too: it is the program that ends
            self._fail(now, error)
        else:
            self._apply(scan, now)
            if scan.is_stopping:
                self._end(now, ProgramStopped(now))
            elif is_over:
                self._status.set(StatusBit.SYSTEM_RETURN)
                self._end(now, StrayReturn(now))

    def _step(self, steps: Steps) -> bool:
        """Let ``run`` go on, if what it waits for holds; whether it came to its end."""
        if self._awaited is not None and not self._awaited.holds():
            return False
        try:
            wanted: object = next(steps)
            if wanted is None or isinstance(wanted, Condition):
                self._awaited = wanted
            elif callable(wanted):
                self._awaited = Until(wanted)
            else:
                steps.throw(
                    ProgramError(f"run cannot wait for {wanted!r}; yield a condition, or nothing")
                )
        except StopIteration:
            return True
        return False

    def _apply(self, scan: Scan, now: Nanos) -> None:
        """Do what the program wants done at the end of a scan."""
        self._count_scans(1)
        if scan.new_data:
            for address, value in scan.new_data.items():
                self._data.write(address, value)
            scan.new_data.clear()
        if scan.new_flags:
            for number, on in scan.new_flags.items():
                self._flags.set(number, on)
            scan.new_flags.clear()
        if scan.new_timers:
            for number, due_ns in scan.new_timers.items():
                if due_ns is None:
                    self._flags.stop_timer(number)
                    self._due.pop(number, None)
                else:
                    self._flags.start_timer(now, number, due_ns - now)
                    self._due[number] = due_ns
            scan.new_timers.clear()

    def _count_scans(self, scans: int) -> None:
        """So many more scans are done."""
        if scans:
            for address in self._counts:
                self._data.write(address, wrapped(self._data.read(address) + scans))

    def _take_expired(self, now: Nanos) -> int:
        """The timers that have run out since last time, as bits."""
        expired = 0
        for number, due_ns in list(self._due.items()):
            if self._flags.due_ns(number) != due_ns:  # a hand has stopped it
                del self._due[number]
            elif due_ns <= now:
                del self._due[number]
                expired |= 1 << number
        return expired

    # -- rest --

    def _rests(self) -> bool:
        """Whether scans do nothing until a flag changes or a time comes (rule 3)."""
        if self._calls_scan:
            return False
        scan, awaited = self._scan, self._awaited
        if scan.flags != scan.flags_before or scan.expired:
            return False  # an edge that is over in the next scan
        if self._flags.states(scan.now_ns) != scan.flags:
            return False
        if awaited is None:
            return self._steps is None
        change_ns = self._next_change()
        if change_ns is not None and self._next_ns is not None and change_ns < self._next_ns:
            return False  # so that a user's function is asked in scans alone
        try:
            return not awaited.holds()
        except KeyboardInterrupt:
            raise
        except BaseException:  # a condition of the user's own: its scan will tell
            return False

    def _next_change(self) -> Nanos | None:
        """When something that a resting program waits for may change by itself."""
        last_ns = self._scan.now_ns
        due_ns = self._flags.next_expiry(last_ns)
        if self._awaited is None or not self._awaited.is_timed:
            return due_ns
        may_hold_ns = self._awaited.may_hold_ns(last_ns)
        if due_ns is None or may_hold_ns is None:
            return may_hold_ns if due_ns is None else due_ns
        return min(due_ns, may_hold_ns)

    def _first_scan(self, since_ns: Nanos) -> Nanos:
        """The first of the scans to come at or after ``since_ns``."""
        assert self._next_ns is not None
        late_ns = max(0, since_ns - self._next_ns)
        return self._next_ns - -late_ns // self._scan_ns * self._scan_ns

    # -- ends --

    def _fail(self, now: Nanos, error: BaseException) -> None:
        """A script error."""
        self.error = located(error)
        self._status.set(StatusBit.BAD_OPCODE)
        self._end(now, ProgramFailed(now, self.error))

    def _end(self, now: Nanos, trace: Trace) -> None:
        """The program runs no more; what it has set and not done is forgotten."""
        self._next_ns = None
        self._awaited = None
        self._status.set(StatusBit.RUNNING, on=False)
        self._flags.hold(now)
        if self._steps is not None:
            with contextlib.suppress(Exception, SystemExit, NeverReturns):  # whatever it does
                self._steps.close()
            self._steps = None
        for wanted in (self._scan.new_data, self._scan.new_flags, self._scan.new_timers):
            wanted.clear()
        self._traces.append(trace)

    # -- loading --

    def _fit(self, program: Program) -> None:
        """Take ``program`` in.  Raises UsageError if it does not fit."""
        made = _made(program)
        kind = type(made)
        if kind.scan_ms is not None:
            if not SCAN_MIN_MS <= kind.scan_ms <= SCAN_MAX_MS:
                raise UsageError(
                    f"program {file_of(kind)}: {kind.__name__}.scan_ms = {kind.scan_ms} is out of "
                    f"range: {SCAN_MIN_MS:g}..{SCAN_MAX_MS:g}"
                )
            self._scan_ns = round(kind.scan_ms * NS_PER_MS)
        if kind.auto_start is not None:
            self._is_auto_started = kind.auto_start
        parts = declared(kind)
        for name, part in parts.items():
            what = f"program {file_of(kind)}: {kind.__name__}.{name}"
            if isinstance(part, FlagDeclaration):
                self._check_flag(what, part)
                self.names[name] = part.number
            else:
                self._check_place(what, part)
                self.names[name] = part.address
                if isinstance(part, ScanCount):
                    self._counts.append(part.address)
        for part in parts.values():
            if isinstance(part, Variable | Array):
                self._store_initial(part)

    def _check_flag(self, what: str, flag: FlagDeclaration[FlagInUse]) -> None:
        found = self._flags.kind(flag.number)
        if found.value != flag.kind:
            raise UsageError(
                f"{what}: flag {flag.number} is of kind {found.value}, not {flag.kind}; "
                f"{flag.kind}: {self._flags.spans(FlagKind(flag.kind))}"
            )

    def _check_place(self, what: str, part: Variable | Array) -> None:
        stride, end = self._data.stride, self._data.end
        last = part.address + (part.size - 1 if isinstance(part, Array) else 0) * stride
        if part.address % stride:
            raise UsageError(
                f"{what}: address {part.address} lies inside a value; "
                f"addresses are multiples of {stride}"
            )
        if last > end:
            raise UsageError(
                f"{what}: address {last} is outside the data area; the last one is {end}"
            )

    def _store_initial(self, part: Variable | Array) -> None:
        """Give ``part`` its first values where nothing is stored; everywhere after a clearing."""
        is_cleared = self._status.has(StatusBit.PROGRAM_CLEARED)
        for index, value in enumerate(part.initial):
            address = part.address + index * self._data.stride
            if is_cleared or not self._data.is_written(address):
                self._data.write(address, value)


def _made(program: object) -> Macroprogram:
    """An object of ``program``, to look at.  Raises UsageError."""
    name = getattr(program, "__name__", repr(program))
    if isinstance(program, Macroprogram):
        raise UsageError(
            f"give the class {type(program).__name__}, not an object: each start makes a new one"
        )
    if not callable(program):
        raise UsageError(
            f"{name} is no program; give a class derived from Macroprogram, or FILE.py"
        )
    try:
        made: object = program()
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise UsageError(f"program {name} cannot be made: {located(error)}") from error
    if not isinstance(made, Macroprogram):
        raise UsageError(f"{name} is no program; derive a class from Macroprogram")
    kind = type(made)
    has_run, has_scan = kind.run is not Macroprogram.run, kind.scan is not Macroprogram.scan
    if not (has_run or has_scan):
        raise UsageError(f"program {name} does nothing; give it a method run or scan")
    if has_run and not is_generator(kind.run):
        raise UsageError(
            f"program {file_of(kind)}: {name}.run never yields; write yield where it waits, or use "
            "scan"
        )
    return made
