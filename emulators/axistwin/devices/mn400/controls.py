"""The controls of an MN400: inputs, panel, potentiometers, pulses, outputs, USB, memory."""

from typing import Final

from axistwin.devices.controls import COMMON, AxisReadout, Bit, Control, ControlTable
from axistwin.devices.mn400.inputs import NAMES, ON_VALUES

FLAGS: Final = ("stop", "pause", "jog", "run")


def _pot(name: str, doc: str) -> Control:
    return Control(
        f"{name}_pot_percent",
        "number",
        doc,
        f"{name}_pot_permille",
        write=f"set_{name}_pot",
        scale=10,
        unit="%",
        low=0.0,
        high=100.0,
    )


MN400: Final = ControlTable(
    "step controller",
    (
        *COMMON,
        Control("baud", "whole", "the rate of its serial line now", "baud"),
        Control("counters", "data", "the four counters, in steps (E)", "counters"),
        Control("remaining", "data", "steps that are not made of the motion (N)", "remaining"),
        Control(
            "step_pulses",
            "data",
            "pulses at the four step outputs since power-up, in either direction, all counted",
            read="steps_at",
        ),
        Control(
            "step_rates",
            "data",
            "steps per second at the four step outputs, with the sign of the direction",
            read="step_rates_at",
        ),
        Control("is_moving", "switch", "whether a motion is under way or paused", read="moves_at"),
        Control("exit_code", "whole", "what / tells", "exit_code"),
        Control(
            "inputs",
            "switch",
            "limits, auxiliary inputs, shield (on while it is open) and the switches of the panel",
            read="input_at",
            write="set_input",
            keys=NAMES,
            noun="input",
        ),
        Control(
            "inputs_status",
            "whole",
            "what S tells",
            "inputs_status",
            bits=tuple(
                Bit(value.bit_length() - 1, name.replace("_", " "), "MN4-CMD-S-01")
                for name, value in ON_VALUES.items()
            ),
        ),
        _pot("feed", "the feedrate potentiometer; works while the input feedrate_enable is on"),
        _pot("jog", "the potentiometer for the speed of jogging"),
        Control(
            "outputs",
            "switch",
            "the eight outputs that C works",
            read="output_at",
            keys=range(1, 9),
            noun="output",
        ),
        Control(
            "panel_flags",
            "switch",
            "the flag outputs of the panel",
            read="flag_at",
            keys=FLAGS,
            noun="flag",
        ),
        Control(
            "directions",
            "switch",
            "levels of the direction outputs, high is on",
            read="direction_at",
            keys=range(1, 5),
            noun="direction",
        ),
        Control(
            "index_pulse",
            "nothing",
            "one pulse at the threader's index input",
            write="index_pulse",
            parameters=(),
        ),
        Control(
            "feed_pulses",
            "whole",
            "pulses at the threader's input A, all at once",
            write="feed_pulses",
            unit="pulses",
            parameters=("pulses",),
        ),
        Control(
            "spindle_hz",
            "number",
            "pulses that come by themselves at the threader's input A, index pulses with them",
            "spindle_millihertz",
            write="turn_spindle",
            scale=1000,
            unit="pulses per second",
            low=0.0,
            high=1e6,
        ),
        Control(
            "send_usb",
            "text",
            "send an OUT report with this text over USB",
            write="send_usb",
            parameters=("text",),
        ),
        Control(
            "usb_reports",
            "data",
            "the IN reports that the host has not read, in hex; the oldest of more than 8 are lost",
            read="take_report",
        ),
        Control(
            "read_usb",
            "nothing",
            "read all IN reports: they are gone",
            write="drop_reports",
            parameters=(),
        ),
        Control(
            "queued",
            "whole",
            "commands that wait behind what runs",
            "queued",
            unit="commands",
            is_queue=True,
            attribute="",
        ),
        Control("program_lines", "data", "the user program", "program_lines"),
        Control("configuration_lines", "data", "what runs at power-up", "configuration_lines"),
    ),
)
"""Of every board."""

AXES: Final = AxisReadout(
    names=("M1", "M2", "M3", "M4"),
    unit="steps",
    position="counters",
    rate="step_rates",
    query="E",
    answer=r"ReadPosition (?:= )?(-?\d[-\d,]*)",
)
