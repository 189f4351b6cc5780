"""The controls of a device that turns a shaft: its pins, supply, temperature, load and position."""

from typing import Final

from axistwin.devices.controls import COMMON, Control, ControlTable
from axistwin.motion.plant import Load

INPUTS: Final = ("reference", "positive_stop", "negative_stop", "reset")
FAULTS: Final = ("amplifier", "encoder", "micro_cut")

_LOAD: Final = (
    Control("torque_nm", "number", "torque against motion", unit="Nm", low=0.0),
    Control("inertia_kgcm2", "number", "inertia", unit="kg·cm²", low=0.0),
    Control("held", "switch", "whether the shaft is held fast"),
)

MOTION: Final = ControlTable(
    "motion device",
    (
        *COMMON,
        Control("position", "whole", "where the axis is", read="position_at", unit="increments"),
        Control("is_moving", "switch", "whether the axis moves now", read="is_moving"),
        Control(
            "inputs",
            "switch",
            "the input pins, on while a contact ties one to ground",
            read="input_at",
            write="set_input",
            keys=INPUTS,
            noun="input",
        ),
        Control(
            "supply_volts",
            "number",
            "voltage of the supply",
            "supply_millivolts",
            write="set_supply",
            scale=1000,
            unit="V",
            low=0.0,
            high=1000.0,
        ),
        Control(
            "temperature_celsius",
            "number",
            "temperature of the electronics",
            "temperature_millidegrees",
            write="set_temperature",
            scale=1000,
            unit="°C",
            low=-273.0,
            high=1000.0,
        ),
        Control(
            "load",
            "record",
            "what is coupled to the shaft",
            read="load_at",
            write="set_load",
            record=Load,
            members=_LOAD,
        ),
        Control(
            "push",
            "whole",
            "turn the shaft by hand, by signed increments",
            write="push",
            unit="increments",
            parameters=("increments",),
        ),
        Control(
            "faults",
            "switch",
            "a fault that no measure shows is there, or gone; a model may have only some",
            write="set_fault",
            keys=FAULTS,
            noun="fault",
            attribute="set_fault",
            parameters=("name", "present"),
            default=True,
        ),
    ),
)
"""Of whatever turns a shaft; a family may add what it alone has."""
