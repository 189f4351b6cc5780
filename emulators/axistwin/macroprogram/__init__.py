"""Macroprograms: what a user writes in Python to have a controller do something.

A program is a class.  It names the flags and variables it uses, and does its work in scans::

    from axistwin.macroprogram import Macroprogram, MotorStatus, Output, Steps, UserFlag, Variable


    class Table(Macroprogram):
        start = UserFlag(200)
        lamp = Output(20)
        in_position = MotorStatus(41)
        count = Variable(2008)

        def run(self) -> Steps:
            while True:
                yield self.start.rise & self.in_position  # waits until the host starts a cycle
                self.start = False
                self.lamp = True
                self.count += 1
                yield self.after_ms(250)
                self.lamp = False

Rules
-----
1. The controller runs the program once every scan (10 ms of its own time unless told otherwise).
   ``scan`` is called in each; ``run`` goes on from where it waits, when what it waits for holds.
2. A scan sees flags and data as they are at its beginning.  What it sets is done at its end, all at
   once: until the next scan the program itself reads the old values too.  What a program must
   remember otherwise it keeps in attributes of its own, such as ``self._parts = 0``.
3. ``rise`` and ``fall`` compare with the previous scan.  In the first scan after a start there are
   none.
4. Variables are 32 bits in two's complement: what does not fit wraps around.
5. The program may set any flag, also inputs and motor flags: it may be the machine's model too.
   Timers are started, and run out by themselves.
6. Each start makes a new object of the class.  Flags, outputs and data stay as they are.
7. ``stop`` ends the program in good order at the end of the scan.  A ``run`` that comes to its end
   is a stray return (status bit 4).  An exception is a script error (status bit 12); nothing of the
   scan that raised it is done.  All three stop the program.

Pure: no clock and no input or output; a program that has neither runs the same way every time.
"""

from axistwin.macroprogram.declarations import (
    Array,
    ArrayInUse,
    FlagInUse,
    Input,
    MotorStatus,
    Output,
    ScanCount,
    Timer,
    TimerInUse,
    UserFlag,
    Variable,
)
from axistwin.macroprogram.program import Macroprogram, Steps, cam_position
from axistwin.macroprogram.scan import Condition, ProgramError, until, wrapped

__all__ = [
    "Array",
    "ArrayInUse",
    "Condition",
    "FlagInUse",
    "Input",
    "Macroprogram",
    "MotorStatus",
    "Output",
    "ProgramError",
    "ScanCount",
    "Steps",
    "Timer",
    "TimerInUse",
    "UserFlag",
    "Variable",
    "cam_position",
    "until",
    "wrapped",
]
