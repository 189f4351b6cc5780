"""What a rig works of an MN400: limits, aux inputs, shield, panel, pots, pulses, supply."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.families.mn400.planner.pulses import TURN
from axistwin_conformance.transport.rig import POWER, RigControl, rig_controls

POWER_NAME: Final = POWER.capability


def _input(name: str, noun: str, twin: str, *, is_numbered: bool = False) -> RigControl:
    """An input that is on or off; with numbers, one for each axis or port."""
    shown = noun + (" {name}" if is_numbered else "")
    return RigControl(
        name,
        "" if is_numbered else name,
        f"works the {noun}" + ("s" if is_numbered else ""),
        (f"Turn the {shown} on.", f"Turn the {shown} off."),
        (f"the {shown} was turned on", f"the {shown} was turned off"),
        f"inputs.{twin}",
        "" if is_numbered else "input",
        is_optional=True,
    )


def _pot(name: str, noun: str, twin: str) -> RigControl:
    return RigControl(
        name,
        "percent",
        f"sets the {noun}",
        (f"Set the {noun} to {{value}} %.", f"Set the {noun} back."),
        (f"the {noun} was set to {{value}} %", f"the {noun} was set back"),
        twin,
        rest=None,
    )


def _pulse(name: str, unit: str, words: str, order: str, done: str, twin: str) -> RigControl:
    return RigControl(name, unit, words, (order, ""), (done, ""), twin, is_step=True)


# In the order in which they are put back: first what drives an axis.
BOARD_CONTROLS: Final = rig_controls(
    _input("jog_plus", "jog + input of axis", "jog_m{}_plus", is_numbered=True),
    _input("jog_minus", "jog - input of axis", "jog_m{}_minus", is_numbered=True),
    _input("run_jog", "Run/Jog switch (on: jog)", "run_jog"),
    _input("start", "Start switch", "start"),
    _input("stop", "Stop switch", "stop"),
    _input("pause", "Pause switch", "pause"),
    _input("limit_plus", "+ limit input of axis", "m{}_plus", is_numbered=True),
    _input("limit_minus", "- limit input of axis", "m{}_minus", is_numbered=True),
    _input("aux", "aux input", "aux_{}", is_numbered=True),
    _input("shield", "shield switch (on: closed, the shield is open)", "shield"),
    _input("jog_res", "Jog Res input", "jog_res_{}", is_numbered=True),
    _input("feedrate_enable", "Feedrate EN input", "feedrate_enable"),
    _pot("feedrate", "feedrate pot", "feed_pot_percent"),
    _pot("jog_pot", "jog speed pot", "jog_pot_percent"),
    _pulse(
        "pulses", "threader", "feeds pulses to the threader input", "Feed {value} threader pulses.",
        "{value} threader pulses were fed", "feed_pulses",
    ),
    _pulse(
        "index", "threader", "gives the index pulse of the threader", "Give one index pulse.",
        "an index pulse was given", "index_pulse",
    ),
    RigControl(
        "spindle", "hertz", f"turns a spindle whose encoder gives an index every {TURN} pulses",
        ("Turn the spindle at {value} pulses per second, within 10 %.", "Stop the spindle."),
        ("the spindle was set to {value} pulses per second", "the spindle was stopped"),
        "spindle_hz", rest=None,
    ),
    POWER,
)  # fmt: skip
HALTING: Final = ("limit_plus", "limit_minus", "shield", "stop")  # what may cut a motion short
JOGGING: Final = ("run_jog", "jog_plus", "jog_minus")  # what may let axes jog; the switch first
