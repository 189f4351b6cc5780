"""The controls of a device that turns a shaft: its pins, supply, temperature, load and position."""

from typing import Any, Final

from axistwin.devices.controls import COMMON, Control, ControlTable
from axistwin.kernel.effects import Effect
from axistwin.kernel.time import Nanos
from axistwin.motion.plant import Load

INPUTS: Final = ("reference", "positive_stop", "negative_stop", "reset")
FAULTS: Final = ("amplifier", "encoder", "micro_cut")


def _set_supply(device: Any, now: Nanos, volts: float) -> list[Effect]:
    effects: list[Effect] = device.set_supply(now, round(volts * 1000))
    return effects


def _set_temperature(device: Any, now: Nanos, celsius: float) -> list[Effect]:
    effects: list[Effect] = device.set_temperature(now, round(celsius * 1000))
    return effects


MOTION: Final = ControlTable(
    "motion device",
    (
        *COMMON,
        Control(
            "position",
            "whole",
            "where the axis is now",
            lambda device, now: device.position_at(now),
            unit="increments",
        ),
        Control(
            "is_moving",
            "switch",
            "whether the axis moves now",
            lambda device, now: device.is_moving(now),
        ),
        Control(
            "inputs",
            "switch",
            "the input pins, on while a contact ties one to ground",
            lambda device, now, key: device.inputs[key],
            lambda device, now, key, active: device.set_input(now, key, active),
            keys=INPUTS,
            noun="input",
        ),
        Control(
            "supply_volts",
            "number",
            "voltage of the supply",
            lambda device, now: device.describe(now)["supply_millivolts"] / 1000,
            _set_supply,
            unit="V",
            low=0.0,
            high=1000.0,
        ),
        Control(
            "temperature_celsius",
            "number",
            "temperature of the electronics",
            lambda device, now: device.describe(now)["temperature_millidegrees"] / 1000,
            _set_temperature,
            unit="°C",
            low=-273.0,
            high=1000.0,
        ),
        Control(
            "load",
            "record",
            "what is coupled to the shaft",
            lambda device, now: device.load,
            lambda device, now, load: device.set_load(now, load),
            record=Load,
            members=(
                Control("torque_nm", "number", "torque against motion", unit="Nm", low=0.0),
                Control("inertia_kgcm2", "number", "inertia", unit="kg·cm²", low=0.0),
                Control("held", "switch", "whether the shaft is held fast"),
            ),
        ),
        Control(
            "push",
            "whole",
            "turn the shaft by hand, by signed increments",
            write=lambda device, now, increments: device.push(now, increments),
            unit="increments",
            parameters=("increments",),
        ),
        Control(
            "faults",
            "switch",
            "a fault that no measure shows is there, or gone; a model may have only some",
            write=lambda device, now, key, present: device.set_fault(now, key, present),
            keys=FAULTS,
            noun="fault",
            attribute="set_fault",
            parameters=("name", "present"),
            default=True,
        ),
    ),
)
"""Of whatever keeps to ``MotionDevice``; a family may add what it alone has."""
