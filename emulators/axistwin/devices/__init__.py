"""Devices: firmware as state machines.  They never import one another, nor a clock, nor IO.

A family of devices is a folder here, or a folder ``axistwin/devices/NAME`` anywhere on Python's
path; its ``family.py`` declares it.
"""

import sys
from pathlib import Path

__path__ += [
    folder
    for folder in (f"{place}/axistwin/devices" for place in sys.path)
    if folder not in __path__ and Path(folder).is_dir()
]
