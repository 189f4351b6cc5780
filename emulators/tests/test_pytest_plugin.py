"""The pytest plugin, seen from a project that uses it."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "fixtures" / "example-project"
DOCS = ROOT / "docs"


@pytest.fixture
def project(pytester: pytest.Pytester) -> pytest.Pytester:
    """The example project in an empty folder."""
    for file in EXAMPLE.glob("*.py"):
        shutil.copy(file, pytester.path)
    return pytester


def run(pytester: pytest.Pytester, *words: str) -> pytest.RunResult:
    """pytest in a process of its own, where every warning is an error."""
    return pytester.runpytest_subprocess("-W", "error", *words, timeout=60)


def test_a_correct_driver_passes(project: pytest.Pytester) -> None:
    """In virtual time and on a pty, without a warning."""
    result = run(project, "-k", "correct")
    result.assert_outcomes(passed=2, deselected=2)


def test_a_naive_driver_fails_with_the_exchange_in_the_failure(project: pytest.Pytester) -> None:
    """The refused command is there, decoded, for the URL and for the pty."""
    result = run(project, "-k", "naive")
    result.assert_outcomes(failed=2, deselected=2)
    result.stdout.fnmatch_lines(
        [
            "*axistwin mac23:0 on axistwin://?time=virtual*",
            "* ms > 02 30 31 34 30 30 31 33 * go to position -500 *",
            "* ms < 06 13 17 *refused*",
            "*axistwin mac23:0 on */mac23 *",
            "* ms < 06 13 17 *refused*",
        ]
    )


def test_the_example_project_runs_where_it_is() -> None:
    """``pytest`` inside it finds the driver: it does not take this repository's settings."""
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q"]
    result = subprocess.run(command, cwd=EXAMPLE, capture_output=True, text=True, check=False)
    assert "2 failed, 2 passed" in result.stdout, result.stdout + result.stderr
    assert "2 failed, 2 passed" in (EXAMPLE / "README.md").read_text(
        "utf-8"
    )  # or who runs it first


def test_the_exchange_comes_through_xdist(project: pytest.Pytester) -> None:
    """Reports travel from a worker to the terminal."""
    result = run(project, "-k", "naive and virtual", "-n", "1")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*axistwin mac23:0 on *", "* ms < 06 13 17 *refused*"])


QUERY = "b'\\x0201400200000000000A2\\x03'"


def test_a_passing_test_tells_nothing(pytester: pytest.Pytester) -> None:
    """Exchanges of a test that passed are not shown with another one's failure."""
    pytester.makepyfile(
        f"""
        import serial

        def talk(twin):
            with serial.serial_for_url(twin.port, baudrate=38400, timeout=1) as port:
                port.write({QUERY})
                assert len(port.read(21)) == 21

        def test_passes(axistwin):
            talk(axistwin("mac23", time="virtual"))

        def test_fails(axistwin):
            axistwin("mac23", time="virtual")
            assert False
        """
    )
    result = run(pytester, "-p", "no:randomly")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.no_fnmatch_line("*axistwin mac23*")


def test_a_failing_fixture_tells_too(pytester: pytest.Pytester) -> None:
    """A driver's own fixture that fails at set-up or tear-down comes with the exchange."""
    pytester.makepyfile(
        f"""
        import pytest, serial

        @pytest.fixture
        def driver(axistwin):
            twin = axistwin("mac23", time="virtual")
            with serial.serial_for_url(twin.port, baudrate=38400, timeout=1) as port:
                port.write({QUERY})
                assert port.read(21) == b"", "set-up"

        @pytest.fixture
        def late(axistwin):
            twin = axistwin("mac23", time="virtual")
            yield
            with serial.serial_for_url(twin.port, baudrate=38400, timeout=1) as port:
                port.write({QUERY})
                assert port.read(21) == b"", "tear-down"

        def test_set_up(driver):
            pass

        def test_tear_down(late):
            pass
        """
    )
    result = run(pytester)
    result.assert_outcomes(passed=1, errors=2)
    result.stdout.fnmatch_lines(
        ["*ERROR at setup*", "*axistwin mac23:0 on *", "* ms < 06 13 02 *position = 0*"]
    )
    result.stdout.fnmatch_lines(
        ["*ERROR at teardown*", "*axistwin mac23:0 on *", "* ms < 06 13 02 *position = 0*"]
    )


def test_twins_of_a_wider_scope_and_plain_urls_tell_too(pytester: pytest.Pytester) -> None:
    """A module's twin tells what was said during the failing test, and not what was before."""
    pytester.makepyfile(
        f"""
        import pytest, serial
        from axistwin import testing

        @pytest.fixture(scope="module")
        def twin():
            with testing.start("mac23:0", "mac34-1:5", time="virtual") as twin:
                yield twin

        def test_before(twin):
            with serial.serial_for_url(twin.port, baudrate=38400, timeout=1) as port:
                port.write({QUERY})
                assert len(port.read(21)) == 21

        def test_module(twin):
            with serial.serial_for_url(twin.port, baudrate=38400, timeout=1) as port:
                port.write(b"hello")
                assert port.read(1) == b"x"

        def test_url():
            port = serial.serial_for_url("axistwin://mac34-2?time=virtual", timeout=1)
            port.write(b"hello")
            assert port.read(1) == b"x"
        """
    )
    result = run(pytester)
    result.assert_outcomes(passed=1, failed=2)
    result.stdout.fnmatch_lines(["*axistwin mac23:0 mac34-1:5 on *", "* ms > 68 65 6C 6C 6F*"])
    result.stdout.fnmatch_lines(["*axistwin mac34-2:0 on axistwin://*", "* ms > 68 65 6C 6C 6F*"])
    result.stdout.no_fnmatch_line("*position = 0*")


def test_frames_on_a_bus_tell_too(pytester: pytest.Pytester) -> None:
    """Of the fixture, of a module's twins, and of a bus that the test shut down itself."""
    pytester.makepyfile(
        """
        import can, pytest
        from axistwin import testing

        def refused(bus, address):
            data = bytes((0x23, 0x12, 0x20, 0, 0, 0, 0, address))
            identifier = 0x600 + address
            bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
            assert bus.recv(1).data[0] == 0x60

        @pytest.fixture(scope="module")
        def shared():
            with testing.start("mac23-can:5", time="virtual") as twin:
                yield twin

        def test_passes(shared):
            shared.bus.send(can.Message(arbitration_id=0x605, is_extended_id=False))
            shared.advance(1)

        def test_fixture(axistwin):
            refused(axistwin("mac23-can:1", "mac23-can:2", time="virtual").bus, 2)

        def test_shared(shared):
            refused(shared.bus, 5)

        def test_plain():
            with can.Bus("mac23-can:7", "axistwin", time="virtual", ignore_config=True) as bus:
                refused(bus, 7)
        """
    )
    result = run(pytester, "-p", "no:randomly")
    result.assert_outcomes(passed=1, failed=3)
    titles = (
        "mac23-can:1 mac23-can:2 on [?]bus=started-*",
        "mac23-can:5 on [?]bus=started-*",
        "mac23-can:7 on can.Bus mac23-can:7",
    )
    for title, module in zip(titles, (2, 5, 7), strict=True):
        result.stdout.fnmatch_lines(
            [
                f"*axistwin {title}*",
                f"* ms > 60{module}#* 2012h (unassigned) -> module {module}",
                f"* ms < 58{module}#* 2012h refused (module {module})",
            ]
        )
    result.stdout.no_fnmatch_line("*request of 0 bytes*")


def test_twins_are_stopped_after_the_test(pytester: pytest.Pytester) -> None:
    """Several in one test, one of them stopped by the test itself; nothing stays."""
    pytester.makepyfile(
        """
        import os, threading

        before = []

        def state():
            return threading.active_count(), len(os.listdir("/proc/self/fd"))

        def test_first(axistwin):
            axistwin("mac23").stop()  # what is made once and stays is made now
            before.append(state())

        def test_many(axistwin):
            for _ in range(3):
                axistwin("mac23")
            axistwin("mac23", time="virtual")
            axistwin("mac23", "mac34-1:5").stop()
            axistwin("mac23-can")
            assert state() != before[0]

        def test_last():
            from axistwin.canbus.shared import open_names
            assert state() == before[0]
            assert open_names() == []
        """
    )
    run(pytester).assert_outcomes(passed=3)


def test_a_twin_that_fails_is_an_error_of_the_test(pytester: pytest.Pytester) -> None:
    """What broke a server's thread comes out when the test ends, and the others are stopped too."""
    pytester.makepyfile(
        """
        import serial, threading
        from axistwin.errors import StateError
        from axistwin.runtime.line import Line

        def test_broken(axistwin, monkeypatch):
            other = axistwin("mac23")
            twin = axistwin("mac23")

            def fail(line, data):
                raise StateError("state: cannot be written (no room); make room")

            monkeypatch.setattr(Line, "exchange", fail)
            with serial.Serial(twin.port, 38400, timeout=20) as port:
                port.write(b"x")
                try:
                    port.read(1)
                except serial.SerialException:
                    pass

        def test_after():
            assert threading.active_count() == 1
        """
    )
    result = run(pytester)
    result.assert_outcomes(passed=2, errors=1)
    result.stdout.fnmatch_lines(["*StateError: state: cannot be written (no room)*"])


MISTAKES = """
    import can, pytest, serial
    from axistwin import testing

    def test_fixture(axistwin):
        axistwin("mac23", quirks={"xon_bite": "11h"})

    @pytest.fixture
    def driver(axistwin):
        return axistwin("mac23", time="quick")

    def test_set_up(driver):
        pass

    def test_twin(axistwin):
        axistwin("mac23", time="virtual").inputs.reverence = True

    def test_start():
        testing.start("mac23", time="quick")

    def test_url():
        serial.serial_for_url("axistwin://mac99")

    def test_bus():
        can.Bus(interface="axistwin", channel="mac99")
    """


def test_a_mistake_is_shown_where_it_was_made(pytester: pytest.Pytester) -> None:
    """One line of the user's and one of ours, and nothing of what is between."""
    pytester.makepyfile(MISTAKES)
    result = run(pytester, "-p", "no:randomly")
    result.assert_outcomes(failed=5, errors=1)
    text = result.stdout.str()
    for line, words in (
        ('axistwin("mac23", quirks=', "unknown quirk 'xon_bite': did you mean xon_byte?"),
        ('return axistwin("mac23", time="quick")', "time=quick: use virtual, real, or a speed"),
        ("inputs.reverence = True", "unknown input 'reverence': did you mean reference?"),
        ("serial_for_url(", "unknown model 'mac99'"),
        ("can.Bus(", "unknown model 'mac99'"),
    ):
        assert re.search(rf">[^\n]*{re.escape(line)}[^>]*\nE [^\n]*{re.escape(words)}", text), line
    assert text.count("\n>") == 6
    assert not re.search(r"^\S*(axistwin|serial|can)\S*\.py:\d+", text, re.MULTILINE)


def test_what_is_hidden_of_a_mistake_is_there_on_demand(pytester: pytest.Pytester) -> None:
    """As everything is, with --full-trace."""
    pytester.makepyfile(MISTAKES)
    result = run(pytester, "--full-trace", "-k", "test_twin")
    result.stdout.fnmatch_lines(["*axistwin*control_access.py:*: UsageError"])


def test_a_bug_of_ours_keeps_its_frames(pytester: pytest.Pytester) -> None:
    """Whoever reports it needs them."""
    pytester.makepyfile(
        """
        from axistwin.urlhandler import lines

        def test_bug(axistwin, monkeypatch):
            monkeypatch.setattr(lines, "build_line", lambda options: 1 / 0)
            axistwin("mac23")
        """
    )
    result = run(pytester)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*axistwin*testing.py:*"])


SLEEPER = """
import threading
import time
from time import sleep

import can
import pytest
import serial

def poll(port, wait, target=2000):
    port.write(b"\\x020140013000000007DBF\\x03")
    assert port.read(3) == b"\\x06\\x13\\x1a"
    for _ in range(60):
        port.write(b"\\x0201400200000000000A2\\x03")
        if int(port.read(21)[9:17], 16) == target:
            return
        wait(0.01)
    raise TimeoutError("timed out")

def opened(url):
    return serial.serial_for_url(url, baudrate=38400, timeout=0.5)

WAITS = [
    lambda seconds: sleep(seconds),
    lambda seconds: time.sleep(seconds),
    lambda seconds: threading.Event().wait(seconds),
]
"""


def test_a_test_that_slept_in_vain_says_so(pytester: pytest.Pytester) -> None:
    """However it slept, with the fixture or a URL, and what to write; a test that does not, not."""
    pytester.makepyfile(
        SLEEPER
        + """
@pytest.mark.parametrize("wait", WAITS)
def test_fixture(axistwin, wait):
    poll(opened(axistwin("mac23", time="virtual").port), wait)

def test_url():
    poll(opened("axistwin://mac23?time=virtual"), sleep)

def test_bus():
    with can.Bus(interface="axistwin", channel="mac23-can", time="virtual") as bus:
        sleep(0.1)
        assert bus.virtual_time_ns

def test_awake(axistwin):
    poll(opened(axistwin("mac23", time="virtual").port), lambda seconds: None)

def test_after(axistwin):
    assert sleep is time.sleep and "built-in" in repr(sleep), "put back"
    assert axistwin("mac23", time="virtual").port is None
"""
    )
    result = run(pytester)
    result.assert_outcomes(failed=7)
    text = result.stdout.str()
    assert len(re.findall(r"The test slept \d+\.\d\d s of real time", text)) == 5
    assert text.count("with host_clock=True, or add") == 5


def test_a_test_that_sleeps_moves_the_twin(pytester: pytest.Pytester) -> None:
    """With host_clock; what the test leaves open is put back behind it."""
    pytester.makepyfile(
        SLEEPER
        + """
kept = []

@pytest.mark.parametrize("wait", WAITS)
def test_fixture(axistwin, wait):
    poll(opened(axistwin("mac23", time="virtual", host_clock=True).port), wait, 125)

def test_url():
    kept.append(opened("axistwin://mac23?time=virtual&host_clock=yes"))
    poll(kept[0], sleep, 125)

def test_after():
    assert "built-in" in repr(sleep) and "built-in" in repr(time.monotonic)
"""
    )
    run(pytester).assert_outcomes(passed=5)


def test_the_fixture_is_documented(pytester: pytest.Pytester) -> None:
    """``pytest --fixtures`` shows how to use it."""
    result = run(pytester, "--fixtures")
    result.stdout.fnmatch_lines(["axistwin*", '*Start twins*axistwin("mac23")*'])


def test_an_installed_plugin_that_nobody_uses_costs_nothing() -> None:
    """Loading it imports neither twins nor servers."""
    program = (
        "import sys, axistwin.pytest_plugin\n"
        "loaded = [name for name in sys.modules if name.startswith('axistwin')]\n"
        "print(sorted(loaded), 'asyncio' in sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=30
    )
    assert (
        done.stdout.strip() == "['axistwin', 'axistwin._starting', 'axistwin.pytest_plugin'] False"
    )


def test_the_how_to_runs_as_printed(pytester: pytest.Pytester) -> None:
    """Every block of Python in the page is a test file that passes."""
    page = (DOCS / "how-to" / "use-pytest.md").read_text(encoding="utf-8")
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", page, re.DOTALL)):
        pytester.makepyfile(**{f"test_{number}": block})
    run(pytester).assert_outcomes(passed=9)
