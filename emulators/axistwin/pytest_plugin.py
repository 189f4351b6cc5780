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
from types import TracebackType
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

_ON_THE_WAY = ("axistwin", "serial", "can", "contextlib")
"""Whose frames a mistake of the user does not show."""

_TOLD_BY = (
    ("axistwin.errors", "AxistwinError"),
    ("serial", "SerialException"),
    ("can", "CanError"),
)

_PATCHES = "axistwin.runtime.host.patches"
_HOST_USERS = pytest.StashKey["list[object]"]()

SLEPT_MIN_S = 0.02
"""Less real sleep than this is no reason for a failure."""

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
    """A failing test, or fixture, tells what was said on the lines of all twins in use; a mistake
    in the use of twins is shown where it was made."""
    if call.excinfo is not None and not item.config.getoption("fulltrace"):
        call.excinfo = _without_our_frames(call.excinfo)
    report = yield
    started = item.stash.get(_STARTED, [])
    if report.failed and _lines_exist():
        from axistwin import testing

        report.sections += [
            (f"axistwin {title}", text) for title, text in testing.exchanges(started)
        ]
    if report.failed and call.when == "call" and (note := _note_of_sleep()):
        report.sections.append(("axistwin time", note))
    if call.when == "teardown":
        started.clear()
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Note which ports the test opens that move the time of the process."""
    before = _host_users()
    try:
        return (yield)
    finally:
        item.stash[_HOST_USERS] = [user for user in _host_users() if user not in before]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Iterator[None]:
    """Put the clocks of the process back, also if the test has left a port open."""
    try:
        return (yield)
    finally:
        patches = sys.modules.get(_PATCHES)
        if patches is not None:
            for user in item.stash.get(_HOST_USERS, []):
                patches.release(user)
            patches.stop_watching()


def _host_users() -> list[object]:
    """What keeps the time of the process virtual."""
    patches = sys.modules.get(_PATCHES)
    return patches.users() if patches is not None else []


def _note_of_sleep() -> str:
    """What to say of a test that slept while the time of its twins stood still."""
    patches = sys.modules.get(_PATCHES)
    slept_s = patches.slept_s() if patches is not None else 0.0
    if slept_s < SLEPT_MIN_S:
        return ""
    return (
        f"The test slept {slept_s:.2f} s of real time, in which the virtual time of its twins "
        "stood still.\nIf the program polls and sleeps, let its sleeping and its clocks move that "
        'time:\nstart the twin with host_clock=True, or add "&host_clock=yes" to its URL.'
    )


def _without_our_frames(
    excinfo: pytest.ExceptionInfo[BaseException],
) -> pytest.ExceptionInfo[BaseException]:
    """An error meant for the user without our frames, and those of what leads to us: its one line
    says all, and belongs to his line.  Our own bugs keep theirs."""
    entries = []
    entry = excinfo.value.__traceback__
    while entry is not None:
        entries.append(entry)
        entry = entry.tb_next
    if not entries or not _is_told_by_us(excinfo.value) or not _is_in(entries[-1], ("axistwin",)):
        return excinfo
    kept = [entry for entry in entries if not _is_in(entry, _ON_THE_WAY)]
    if not kept or _is_in(kept[-1], ("_pytest", "pluggy")):  # none of it is the user's
        return excinfo
    shown = None
    for entry in reversed(kept):
        shown = TracebackType(shown, entry.tb_frame, entry.tb_lasti, entry.tb_lineno)
    assert shown is not None
    return pytest.ExceptionInfo.from_exc_info((excinfo.type, excinfo.value, shown))


def _is_told_by_us(error: BaseException) -> bool:
    """Whether it is one of ours, or of a library's by which ours come out of a port or a bus."""
    for module, name in _TOLD_BY:
        kind = getattr(sys.modules.get(module), name, None)
        if kind is not None and isinstance(error, kind):
            return True
    return False


def _is_in(entry: TracebackType, names: tuple[str, ...]) -> bool:
    """Whether a frame belongs to one of these packages or modules."""
    module = str(entry.tb_frame.f_globals.get("__name__"))
    return any(module == name or module.startswith(f"{name}.") for name in names)


def _lines_exist() -> bool:
    """Whether anybody may have made twins in this process, by whatever way."""
    return not sys.modules.keys().isdisjoint(_MAKERS)
