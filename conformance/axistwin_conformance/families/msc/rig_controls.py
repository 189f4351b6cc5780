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
        ("the machine turned flag {name} on", "the machine turned flag {name} off"),
        "flags.{}",
    ),
    RigControl(
        "status",
        "",
        "brings about the conditions of the status word",
        (f"Bring about {CONDITION}", f"End {CONDITION}"),
        ("the condition of status bit {name} began", "the condition of status bit {name} ended"),
        "status_bits.{}",
    ),
    RigControl(
        "battery",
        "memory",
        "takes the battery of the memory away",
        ("Take the battery of the memory away.", "Put a good battery of the memory in."),
        ("the battery of the memory was removed", "a good battery of the memory was put in"),
        {True: ("battery", "flat"), False: ("battery", "good")},
    ),
    POWER,
    RigControl(
        "program",
        "macroprogram",
        "starts and stops the macroprogram",
        ("Start the macroprogram.", "Stop the macroprogram."),
        ("the macroprogram was started", "the macroprogram was stopped"),
        {True: ("start_program", None), False: ("stop_program", None)},
        rest=True,
    ),
)
