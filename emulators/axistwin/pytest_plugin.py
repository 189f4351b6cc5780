"""The pytest plugin, loaded by entry point: the ``axistwin`` fixture, and exchanges in reports.

    def test_homing(axistwin):
        twin = axistwin("mac23", time="virtual")
        driver = MyDriver(twin.port)
        twin.inputs.reference = True
        ...

Nothing but pytest is imported until a twin is wanted: a project that has this installed and does
not use it pays nothing.
"""

import contextlib
import sys
from collections.abc import Generator, Iterator
from typing import TYPE_CHECKING, Protocol, Unpack, overload

import pytest

if TYPE_CHECKING:
    from axistwin.testing import Options, StartedLine, StartedTwin


class Start(Protocol):
    """What the fixture is: ``axistwin.testing.start``, with the stopping left to pytest."""

    @overload
    def __call__(self, device: str, /, **options: "Unpack[Options]") -> "StartedTwin": ...
    @overload
    def __call__(
        self, device: str, second: str, /, *others: str, **options: "Unpack[Options]"
    ) -> "StartedLine": ...


_MAKERS = ("axistwin.urlhandler.lines", "axistwin.canbus.shared")
"""The modules that keep lines and buses."""

_STARTED = pytest.StashKey["list[StartedLine]"]()


@pytest.fixture
def axistwin(request: pytest.FixtureRequest) -> Iterator[Start]:
    """Start twins that are stopped after the test: ``axistwin("mac23")``, as often as you like.

    Gives a twin, or for several devices on one line the line, with the ``port`` to open, or on CAN
    the ``bus`` to use; see ``axistwin.testing.start`` for the options: time="virtual",
    quirks={...}, state=..., and so on.
    """
    from axistwin import testing

    started = request.node.stash.setdefault(_STARTED, [])
    with contextlib.ExitStack() as stack:

        def start(*devices: str, **options: "Unpack[Options]") -> "StartedLine":
            line: StartedLine = testing.start(*devices, **options)
            started.append(line)
            stack.callback(line.stop)
            return line

        yield start  # type: ignore[misc]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Twins that outlive a test tell of each test alone."""
    if _lines_exist():
        from axistwin import testing

        testing.forget_exchanges()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A failing test, or fixture, tells what was said on the lines of all twins in use."""
    report = yield
    started = item.stash.get(_STARTED, [])
    if report.failed and _lines_exist():
        from axistwin import testing

        report.sections += [
            (f"axistwin {title}", text) for title, text in testing.exchanges(started)
        ]
    if call.when == "teardown":
        started.clear()
    return report


def _lines_exist() -> bool:
    """Whether anybody may have made twins in this process, by whatever way."""
    return not sys.modules.keys().isdisjoint(_MAKERS)
