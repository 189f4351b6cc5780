"""The controls of a MAC module: those of any shaft, and what the module shows of itself."""

from typing import Final

from axistwin.devices.controls import AxisReadout, Bit, Control, ControlTable, Kind
from axistwin.devices.mac.axis.stops import HARD_BITS, STOP_NAMES
from axistwin.devices.motion_controls import MOTION


def _shown(
    field: str,
    kind: Kind,
    doc: str,
    unit: str = "",
    name: str = "",
    bits: tuple[Bit, ...] = (),
    is_queue: bool = False,
) -> Control:
    """What the module's snapshot has in ``field``; for those who look on, not on Python handles."""
    return Control(
        name or field, kind, doc, field, unit=unit, bits=bits, is_queue=is_queue, attribute=""
    )


_FAULT_BITS: Final = (
    Bit(6, "over-voltage warning", "MACS-Q-21-02"),
    Bit(5, "under-voltage warning", "MACS-Q-21-02"),
    Bit(4, "temperature (MAC23)", "MACS-STATE-02"),
    Bit(3, "amplifier (MAC34)", "MACS-STATE-02"),
    Bit(2, "temperature (MAC34)", "MACS-STATE-02"),
    Bit(1, "encoder (MAC34)", "MACS-STATE-02"),
    Bit(0, "micro-cut", "MACS-STATE-02"),
)

_STOP_BITS: Final = tuple(
    Bit(mask.bit_length() - 1, name, f"MACS-STOP-0{1 if mask in HARD_BITS.values() else 3}")
    for mask, name in STOP_NAMES.items()
)


MAC: Final = ControlTable(
    MOTION.noun,
    (
        *MOTION,
        Control(
            "velocity", "number", "speed now", read="velocity_at", unit="increments/s", attribute=""
        ),
        _shown("state", "text", "the state in the ledger's letters, such as HD+AR", name="mode"),
        _shown("powered", "switch", "whether the motor has torque"),
        _shown("busy", "switch", "whether a motion is under way"),
        _shown("armed", "switch", "whether motions wait for the synchronisation"),
        _shown("preloaded", "switch", "whether a motion waits for the synchronisation"),
        _shown(
            "segments_stored",
            "whole",
            "length of the interpolator's queue",
            "segments",
            is_queue=True,
        ),
        _shown("reference_enabled", "switch", "whether the reference input sets the counter"),
        _shown(
            "fault_bits",
            "whole",
            "warnings and latched faults: the byte dd of 21h",
            bits=_FAULT_BITS,
        ),
        _shown(
            "stop_bits",
            "whole",
            "stops that are met: the low bits of the byte ff of 21h",
            bits=_STOP_BITS,
        ),
    ),
)
"""For every kind of wire."""

AXIS: Final = AxisReadout(
    names=("axis",),
    unit="increments",
    position="position",
    rate="velocity",
    query="20h",
    answer=r"position = (-?\d+)",
)
