"""MAC23 and MAC34 on the serial line: the suite's own reading of the manual, and its checks."""

from __future__ import annotations

from axistwin_conformance.mac_serial.family import FAMILY

__all__ = ["FAMILY"]
