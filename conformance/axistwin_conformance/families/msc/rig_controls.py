"""What a rig works of a controller: the machine behind its flags, conditions, program."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.transport.rig import POWER, RigControl, rig_controls

CONDITION: Final = "the condition of status bit {name}."

# In the order in which they are put back: the program last, which needs the supply.
MSC_CONTROLS: Final = rig_controls(
    RigControl(
        "flag",
        "",
        "works the inputs, timers and motors behind the controller's flags",
        ("Work the machine until flag {name} is on.", "Let flag {name} go off again."),
        "flags.{}",
    ),
    RigControl(
        "status",
        "",
        "brings about the conditions of the status word",
        (f"Bring about {CONDITION}", f"End {CONDITION}"),
        "status_bits.{}",
    ),
    RigControl(
        "battery",
        "memory",
        "takes the battery of the memory away",
        ("Take the battery of the memory away.", "Put a good battery of the memory in."),
        {True: ("battery", "flat"), False: ("battery", "good")},
    ),
    POWER,
    RigControl(
        "program",
        "macroprogram",
        "starts and stops the macroprogram",
        ("Start the macroprogram.", "Stop the macroprogram."),
        {True: ("start_program", None), False: ("stop_program", None)},
        rest=True,
    ),
)
