"""Tests that need a kernel with CAN and its ``vcan0``: ``scripts/vm`` has both.

They are marked ``vcan``, skip on a machine that has no vcan0, and fail in the virtual machine if it
is missing there.
"""

import os

import pytest

from axistwin.ports import socketcan


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip where there is no vcan0, unless it is promised."""
    if item.get_closest_marker("vcan") is None or socketcan.link_state("vcan0") == "up":
        return
    assert "AXISTWIN_VM" not in os.environ, "the virtual machine has no vcan0"
    pytest.skip("there is no vcan0; run 'scripts/vm .venv/bin/python -m pytest -m vcan'")
