"""A macroprogram with flags, data and status around it, and no wire: times in milliseconds."""

from axistwin.devices.msc.data_area import DataArea
from axistwin.devices.msc.flags import Flags, parse_flag_map
from axistwin.devices.msc.program import ProgramRunner
from axistwin.devices.msc.quirks import parse_quirks
from axistwin.devices.msc.status import Status
from axistwin.devices.switches import Value
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.macroprogram.program import Program

RUNNING, CLEARED, STRAY_RETURN, BAD_OPCODE = 1, 8, 16, 4096


class ProgramBench:
    """One program, running from time 0 unless ``started`` is False; quirks are keyword arguments.

    ``at(ms)`` is a look at that time; what is set then happens after the scans due by then.
    """

    def __init__(self, program: Program, *, started: bool = True, **quirks: Value) -> None:
        settings = parse_quirks(quirks)
        kinds = parse_flag_map(settings.flag_map)
        assert kinds is not None
        self.data = DataArea(settings)
        self.flags = Flags(kinds, is_on_expired=settings.timer_flag == "expired")
        self.status = Status()
        self.program = program
        self.runner = ProgramRunner(
            program,
            self.data,
            self.flags,
            self.status,
            scan_ns=settings.scan_ms * NS_PER_MS,
            quirks=settings,
        )
        self.now: Nanos = 0
        if started:
            self.runner.start(0)

    def at(self, milliseconds: float) -> "ProgramBench":
        """Let time pass until then."""
        self.now = round(milliseconds * NS_PER_MS)
        self.runner.wake(self.now)
        return self

    def set(self, *numbers: int) -> None:
        """Turn flags on, as a hand or the host does."""
        for number in numbers:
            self.flags.set(number, on=True)

    def clear(self, *numbers: int) -> None:
        """Turn flags off."""
        for number in numbers:
            self.flags.set(number, on=False)

    def is_on(self, number: int) -> bool:
        """Whether a flag is on now."""
        return self.flags.state(self.now, number)

    def value(self, address: int) -> int:
        """The variable at ``address`` now."""
        return self.data.read(address)

    @property
    def word(self) -> int:
        """The status word now."""
        return int(self.status.word)
