"""What a rig works of an axis: its contacts, supply, temperature and shaft."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.transport.rig import POWER, RigControl, rig_controls

CONTACT: Final = ("Close the contact of the {} input.", "Open the {} contact.")


def _input(name: str, close: str, leave: str) -> RigControl:
    noun = name.replace("_", " ")
    words, orders = f"works the {noun} input", (close.format(noun), leave.format(noun))
    done = f"the {noun} input was activated", f"the {noun} input was released"
    return RigControl(name, name, words, orders, done, f"inputs.{name}", "input", is_optional=True)


def _fault(name: str, words: str, order: str, fault: str) -> RigControl:
    orders = (order, f"End the fault: {name.replace('_', ' ')}.")
    done = f"the fault began: {fault}", f"the fault ended: {fault}"
    return RigControl(name, name, words, orders, done, f"faults.{name}", "fault")


# In the order in which they are put back.
AXIS_CONTROLS: Final = rig_controls(
    RigControl(
        "turn",
        "shaft",
        "turns the shaft by hand",
        ("Turn the shaft by about {value} increments (+ is clockwise).", ""),  # facing the flange
        ("the shaft was turned by {value} increments", ""),
        "push",
        is_step=True,
    ),
    RigControl(
        "hold",
        "shaft",
        "holds the shaft against the motor",
        ("Hold the shaft fast.", "Let the shaft go."),
        ("the shaft was held", "the shaft was released"),
        "load.held",
    ),
    _fault(
        "micro_cut",
        "makes a micro-cut of the supply",
        "Interrupt the supply so briefly that the module does not restart.",
        "power line disturbance",
    ),
    _fault(
        "amplifier",
        "makes the amplifier report a fault",
        "Make the amplifier report a fault.",
        "amplifier fault",
    ),
    _fault("encoder", "takes the encoder away", "Disconnect the encoder.", "encoder fault"),
    *(_input(name, *CONTACT) for name in ("reference", "positive_stop", "negative_stop")),
    _input("reset", "Hold the {} input low.", "Release the {} input."),
    RigControl(
        "temperature",
        "celsius",
        "sets the module's temperature",
        ("Bring the module to {value} °C.", "Bring the module back to its usual temperature."),
        ("the temperature was set to {value} °C", "the temperature was set back"),
        "temperature_celsius",
        rest=None,
    ),
    RigControl(
        "supply",
        "volts",
        "sets the supply voltage",
        ("Set the supply to {value} V.", "Set the supply back to its usual voltage."),
        ("the supply was set to {value} V", "the supply was set back"),
        "supply_volts",
        rest=None,
    ),
    POWER,
)
