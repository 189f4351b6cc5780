"""The controls of an MSC: flags, variables, status, battery, and the user's program."""

from typing import Final

from axistwin.devices.controls import COMMON, Bit, Control, ControlTable
from axistwin.devices.msc.controller import BATTERY_LEVELS
from axistwin.devices.msc.data_area import VALUE_MAX, VALUE_MIN
from axistwin.devices.msc.flags import FLAGS
from axistwin.devices.msc.status import StatusBit

ADDRESSES: Final = 0x10000
STATUS_BITS: Final = 16


def _action(name: str, doc: str) -> Control:
    return Control(name, "nothing", doc, write=name, parameters=())


MSC: Final = ControlTable(
    "controller",
    (
        *COMMON,
        Control(
            "flags",
            "switch",
            "every flag, of any kind, also those that the host cannot set",
            read="flag_at",
            write="set_flag",
            keys=range(FLAGS),
            names="program_names",
            noun="flag",
        ),
        Control(
            "variables",
            "whole",
            "every variable, by its address",
            read="variable_at",
            write="set_variable",
            low=VALUE_MIN,
            high=VALUE_MAX,
            keys=range(ADDRESSES),
            names="program_names",
            noun="variable",
        ),
        Control(
            "status",
            "whole",
            "the status word, as RQSTAT gives it; looking at it changes nothing",
            read="status_at",
            bits=tuple(
                Bit(n, str(bit.name).lower().replace("_", " "), "MSC-STA-02")
                for n, bit in enumerate(StatusBit)
            ),
        ),
        Control(
            "status_bits",
            "switch",
            "the condition that a bit of the status word tells, there or gone",
            read="status_bit_at",
            write="set_status",
            keys=range(STATUS_BITS),
            noun="status bit",
            attribute="set_status",
            parameters=("bit", "on"),
        ),
        Control(
            "battery",
            "choice",
            "the battery of the memory; when it is flat, what is stored is lost at power-up",
            "battery",
            write="set_battery",
            choices=BATTERY_LEVELS,
        ),
        Control("program", "program", "its object as it runs, or ran last", read="program_at"),
        Control(
            "program_error",
            "text",
            "where and why the program ended with a script error, if it did",
            "program_error",
        ),
        Control(
            "load_program",
            "program",
            "put a program in, in place of the one that is there: a class derived from "
            "``axistwin.macroprogram.Macroprogram``, FILE.py, FILE.py:CLASS, or a built-in name",
            write="load_program",
            parameters=("program",),
        ),
        _action("start_program", "start the program from its beginning"),
        _action("stop_program", "stop the program; flags, outputs and data stay as they are"),
        _action("clear_program", "reset the system and clear the program, with the data (bit 3)"),
    ),
)
"""Of every model."""
