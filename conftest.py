"""What holds for all tests, of twins and of the suite: their tiers, signals, what needs a kernel
with CAN or uhid."""

import os
import re
import signal
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# A busy machine makes no example wrong.
settings.register_profile(
    "any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("any machine")

# What tests of a mark need, and the virtual machine that has it.
KERNEL_NEEDS = {
    "vcan": (Path("/sys/class/net/vcan0"), "scripts/vm"),
    "uhid": (Path("/dev/uhid"), "scripts/vm --uhid"),
}
BY_HAND = frozenset({"soak", *KERNEL_NEEDS})
DEAR = BY_HAND | {"system", "strength"}
DEAR_FILE = re.compile(rf"^pytestmark = (\[\s*)?pytest\.mark\.({'|'.join(DEAR)})\b", re.MULTILINE)
# What a fast test does not do, in the words of Python's audit hooks.
NOT_FAST = frozenset(
    {"subprocess.Popen", "os.fork", "os.posix_spawn", "socket.bind", "socket.connect", "openpty"}
)
running: list[str] = []
"""The fast test that is under way, if one is."""
refused: list[str] = []
"""What it was refused, and may have swallowed."""


def pytest_configure() -> None:
    """Heed Ctrl-C and hang-ups, and let programs under test do so: a shell has what it starts in
    the background ignore SIGINT, and nohup SIGHUP, which whoever is started from there inherits."""
    for number, handler in (
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGHUP, signal.SIG_DFL),
    ):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)
    sys.addaudithook(_refuse_what_is_not_fast)
    open_pty = os.openpty  # which no audit hook is told of

    def openpty() -> tuple[int, int]:
        sys.audit("openpty")
        return open_pty()

    os.openpty = openpty


def _refuse_what_is_not_fast(event: str, arguments: tuple[Any, ...]) -> None:
    if event in NOT_FAST and running:
        refused.append(f"{running.pop()} is no fast test ({event}): mark it 'system' or 'strength'")
        raise AssertionError(refused[0])


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Of what is dear as a whole, a fast run does not even read the tests."""
    is_fast = config.option.markexpr == "fast" and collection_path.suffix == ".py"
    return (is_fast and bool(DEAR_FILE.search(collection_path.read_text("utf-8")))) or None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Every test is of a tier; what is marked for none of the dear ones is fast.

    What is run by hand is left out unless it is asked for.  What takes long comes first, so that
    all processes end together.
    """
    left_out = {name for name in BY_HAND if name not in config.option.markexpr}
    chosen: list[pytest.Item] = []
    others: list[pytest.Item] = []
    for item in items:
        marks = {mark.name for mark in item.iter_markers()}
        if not DEAR & marks:
            item.add_marker(pytest.mark.fast)
        (others if left_out & marks else chosen).append(item)
    config.hook.pytest_deselected(items=others)
    items[:] = sorted(chosen, key=_seconds, reverse=True)


def _seconds(item: pytest.Item) -> float:
    """About how long a test takes, where it says so: pytest.mark.strength(seconds=...)."""
    return max((float(mark.kwargs.get("seconds", 0)) for mark in item.iter_markers()), default=0)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Let a fast test start no process and open no port."""
    refused.clear()
    if item.get_closest_marker("fast") is not None:
        running.append(item.nodeid)
    try:
        return (yield)
    finally:
        running.clear()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, object, object]:
    """Fail it also where it takes the refusal for an error of its own."""
    result = yield
    assert not refused, refused[0]
    return result


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what needs another kernel than this one; in the virtual machine it is there."""
    for mark, (need, machine) in KERNEL_NEEDS.items():
        if item.get_closest_marker(mark) is None or need.exists():
            continue
        assert "AXISTWIN_VM" not in os.environ, f"the virtual machine has no {need.name}"
        pytest.skip(f"there is no {need.name}; run '{machine} python -m pytest -m {mark}'")
