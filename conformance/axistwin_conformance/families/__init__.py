"""The device families, each in a folder of its own; `catalog` finds them.

A family is a folder here, or a folder `axistwin_conformance/families/NAME` anywhere on Python's
path; its `family.py` declares it.
"""

import sys
from pathlib import Path

__path__ += [
    folder
    for folder in (f"{place}/axistwin_conformance/families" for place in sys.path)
    if folder not in __path__ and Path(folder).is_dir()
]
