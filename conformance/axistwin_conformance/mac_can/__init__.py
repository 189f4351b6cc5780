"""MAC23 on CAN: the suite's own reading of the manual, and its checks."""

from __future__ import annotations

from axistwin_conformance.mac_can.family import FAMILY

__all__ = ["FAMILY"]
