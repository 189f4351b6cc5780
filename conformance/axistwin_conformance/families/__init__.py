"""The device families, each in a folder of its own; `catalog` finds them.

A folder on the path of imports that has `axistwin_conformance/families/NAME` adds a family to the
suite: the folders of all such places are looked through.
"""

import pkgutil

__path__ = pkgutil.extend_path(__path__, __name__)
