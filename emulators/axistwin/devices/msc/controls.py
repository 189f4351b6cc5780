"""The controls of an MSC: flags, variables, status, battery, and the user's program."""

from typing import Any, Final

from axistwin.devices.controls import COMMON, Control, ControlTable, seen
from axistwin.devices.msc.controller import BATTERY_LEVELS
from axistwin.devices.msc.data_area import VALUE_MAX, VALUE_MIN
from axistwin.devices.msc.flags import FLAGS
from axistwin.kernel.time import Nanos

ADDRESSES: Final = 0x10000
STATUS_BITS: Final = 16


def _program(device: Any, now: Nanos) -> Any:
    """The program's object; a look at the status brings it to the present."""
    device.status_at(now)
    return device.program


def _status_bit(device: Any, now: Nanos, bit: int) -> bool:
    return bool(device.status_at(now) >> bit & 1)


MSC: Final = ControlTable(
    "controller",
    (
        *COMMON,
        Control(
            "flags",
            "switch",
            "every flag, of any kind, also those that the host cannot set",
            lambda device, now, number: device.flag_at(now, number),
            lambda device, now, number, on: device.set_flag(now, number, on),
            keys=range(FLAGS),
            names=seen("program_names"),
            noun="flag",
        ),
        Control(
            "variables",
            "whole",
            "every variable, by its address",
            lambda device, now, address: device.variable_at(now, address),
            lambda device, now, address, value: device.set_variable(now, address, value),
            low=VALUE_MIN,
            high=VALUE_MAX,
            keys=range(ADDRESSES),
            names=seen("program_names"),
            noun="variable",
        ),
        Control(
            "status",
            "whole",
            "the status word, as RQSTAT gives it; looking at it changes nothing",
            lambda device, now: device.status_at(now),
        ),
        Control(
            "status_bits",
            "switch",
            "the condition that a bit of the status word tells, there or gone",
            _status_bit,
            lambda device, now, bit, on: device.set_status(now, bit, on),
            keys=range(STATUS_BITS),
            noun="status bit",
            attribute="set_status",
            parameters=("bit", "on"),
        ),
        Control(
            "battery",
            "choice",
            "the battery of the memory; when it is flat, what is stored is lost at power-up",
            seen("battery"),
            lambda device, now, level: device.set_battery(now, level),
            choices=BATTERY_LEVELS,
        ),
        Control("program", "program", "the program's object as it runs, or ran last", _program),
        Control(
            "program_error",
            "text",
            "where and why the program ended with a script error, if it did",
            seen("program_error"),
        ),
        Control(
            "load_program",
            "program",
            "put a program in, in place of the one that is there: a class derived from "
            "``axistwin.macroprogram.Macroprogram``, FILE.py, FILE.py:CLASS, or a built-in name",
            write=lambda device, now, program: device.load_program(now, program),
            parameters=("program",),
        ),
        Control(
            "start_program",
            "nothing",
            "start the program from its beginning",
            write=lambda device, now: device.start_program(now),
            parameters=(),
        ),
        Control(
            "stop_program",
            "nothing",
            "stop the program; flags, outputs and data stay as they are",
            write=lambda device, now: device.stop_program(now),
            parameters=(),
        ),
        Control(
            "clear_program",
            "nothing",
            "reset the system and clear the program, with the data (status bit 3)",
            write=lambda device, now: device.clear_program(now),
            parameters=(),
        ),
    ),
)
"""Of every model."""
