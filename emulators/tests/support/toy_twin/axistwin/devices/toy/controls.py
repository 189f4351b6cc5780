"""What can be worked and seen of the lamp."""

from typing import Final

from axistwin.devices.controls import COMMON, Control, ControlTable, seen

LAMP: Final = ControlTable(
    "lamp",
    (
        *COMMON,
        Control("level", "whole", "how bright it is, 0..9", seen("level"), low=0, high=9),
        Control(
            "press",
            "nothing",
            "press the button on it, which turns it off",
            write=lambda device, now: device.press(now),
            parameters=(),
        ),
    ),
)
