"""The bench program: what a test of a controller needs running in it.

The same can be written in a real controller, for its own language.  Flags from 240 on:

``count``  while it is on, a scan clears it and adds 1 to ``counter``
``pulse``  each rise from one scan to the next adds 1 to ``pulses``; it is not cleared
``halt``   the program clears it and stops itself
``timed``  its rise starts timer 32 for 250 ms, and the program clears it

Variables from 6144 on: ``counter``, ``ticks`` (1 more every scan), ``pulses``, ``torn`` (scans in
which the first and the last value of the block differed), and at 6272 the ``block`` of 32 values.
"""

from axistwin.macroprogram import (
    Array,
    Macroprogram,
    ScanCount,
    Steps,
    Timer,
    UserFlag,
    Variable,
    until,
)

FLAGS, TIMER, VARIABLES = 240, 32, 6144

TIMED_MS = 250


class Bench(Macroprogram):
    """See above."""

    count = UserFlag(FLAGS)
    pulse = UserFlag(FLAGS + 1)
    halt = UserFlag(FLAGS + 2)
    timed = UserFlag(FLAGS + 3)
    timer = Timer(TIMER)

    counter = Variable(VARIABLES)
    ticks = ScanCount(VARIABLES + 4)
    pulses = Variable(VARIABLES + 8)
    torn = Variable(VARIABLES + 12)
    block = Array(VARIABLES + 128, 32)

    def run(self) -> Steps:
        """Wait until something is to be done: most scans only count."""
        rises = self.pulse.rise | self.timed.rise
        work = self.count | self.halt | rises | until(lambda: self.is_torn, is_steady=True)
        while True:
            self.work()
            yield work

    @property
    def is_torn(self) -> bool:
        """Whether the block has not come as a whole."""
        return self.block[0] != self.block[-1]

    def work(self) -> None:
        """One scan."""
        if self.count:
            self.count = False
            self.counter += 1
        if self.pulse.rise:
            self.pulses += 1
        if self.timed.rise:
            self.timed = False
            self.timer.start(TIMED_MS)
        if self.is_torn:
            self.torn += 1
        if self.halt:
            self.halt = False
            self.stop()
