"""What holds for all tests, of twins and of the suite."""

import os
import signal
from pathlib import Path

import pytest

VCAN = Path("/sys/class/net/vcan0")


def pytest_configure() -> None:
    """Heed Ctrl-C and hang-ups, and let programs under test do so: a shell has what it starts in
    the background ignore SIGINT, and nohup SIGHUP, which whoever is started from there inherits."""
    for number, handler in (
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGHUP, signal.SIG_DFL),
    ):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what needs a kernel with CAN where there is none; in the virtual machine there is."""
    if item.get_closest_marker("vcan") is None or VCAN.exists():
        return
    assert "AXISTWIN_VM" not in os.environ, "the virtual machine has no vcan0"
    pytest.skip("there is no vcan0; run 'scripts/vm python -m pytest -m vcan'")
