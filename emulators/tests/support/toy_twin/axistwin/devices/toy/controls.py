"""What can be worked and seen of the lamp."""

from typing import Final

from axistwin.devices.controls import COMMON, Control, ControlTable

LAMP: Final = ControlTable(
    "lamp",
    (
        *COMMON,
        Control("level", "whole", "how bright it is, 0..9", "level", low=0, high=9),
        Control("press", "nothing", "press its button: it is off", write="press", parameters=()),
    ),
)
