"""The program before anything is loaded, and while it is."""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import axistwin

pytestmark = pytest.mark.system

OURS = str(Path(axistwin.__file__).parent)
FIRST_WITH_A_HANDLER = "axistwin.cli.output"  # imported once Ctrl-C is taken care of

INTERRUPTED = """
import importlib.abc, runpy, sys

class Interrupt(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == {module!r}:
            sys.meta_path.remove(self)
            raise KeyboardInterrupt

sys.argv = ["axistwin", "models"]
sys.meta_path.insert(0, Interrupt())
"""

SIGNALLED = """
import importlib.abc, os, runpy, signal, sys

class Interrupt(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == {module!r}:
            sys.meta_path.remove(self)
            class Name:  # amid what makes other exceptions of exceptions
                def __set_name__(self, owner, name):
                    os.kill(os.getpid(), signal.SIGINT)
                    for _ in range(1000): pass
            class Owner:
                name = Name()

sys.meta_path.insert(0, Interrupt())
sys.argv = ["axistwin", *{words!r}]
"""


STARTS = pytest.mark.parametrize(
    "start",
    [
        "from axistwin.cli.main import main\nsys.exit(main())",
        "runpy.run_module('axistwin', run_name='__main__')",
    ],
    ids=["axistwin", "python -m axistwin"],
)

INTERRUPTED_AT_LAST = """
import os, runpy, signal, sys

class Last:
    def __del__(self, kill=os.kill, me=os.getpid(), number=signal.SIGINT):
        kill(me, number)

last = Last()
sys.argv = ["axistwin", "models", "mac23"]
"""


@STARTS
def test_ctrl_c_when_all_is_done_changes_nothing(start: str) -> None:
    """While the interpreter takes its modules apart: what was said stands, and so does status 0."""
    command = [sys.executable, "-c", INTERRUPTED_AT_LAST + start]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "mac23" in done.stdout


@STARTS
@pytest.mark.parametrize("module", ["axistwin._starting", "click"])
def test_ctrl_c_while_the_program_is_loaded_ends_it_without_a_word(start: str, module: str) -> None:
    """Status 130, as at any later time, and no traceback."""
    command = [sys.executable, "-c", INTERRUPTED.format(module=module) + start]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@STARTS
@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("serial", ("models",)),
        ("click", ("models",)),
        ("axistwin.cli.models", ("models",)),
        ("axistwin.catalog", ("models",)),
        ("axistwin_conformance.cli", ("conform", "mac23")),
        ("axistwin_conformance.engine.run", ("conform", "mac23")),
    ],
)
def test_ctrl_c_while_a_module_is_loaded_ends_it_without_a_word(
    start: str, module: str, words: tuple[str, ...]
) -> None:
    """From the first line of the package on, and for commands that other packages add."""
    code = SIGNALLED.format(module=module, words=words)
    command = [sys.executable, "-c", code + start]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@pytest.mark.parametrize(
    "words", [("conform", "mac23", "--level", "quick"), ("run", "mac23"), ("models", "mac23")]
)
def test_ctrl_c_at_any_moment_gives_no_traceback(words: tuple[str, ...], tmp_path: Path) -> None:
    """Real processes; before the first line of ours it is the interpreter that ends as it likes."""
    draw = random.Random(7)
    for _ in range(20):
        moment_s = draw.uniform(0, 1.0)
        command = [sys.executable, "-X", "importtime", "-m", "axistwin", *words]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
        ) as process:
            time.sleep(moment_s)
            process.send_signal(signal.SIGINT)
            try:
                _, errors = process.communicate(timeout=60)
            except subprocess.TimeoutExpired:  # swallowed, or else found below
                process.kill()
                _, errors = process.communicate()
        early, is_handled, _ = errors.partition(FIRST_WITH_A_HANDLER)
        told = f"{moment_s:.3f} s: {process.returncode}, {errors}"
        if process.returncode in (-signal.SIGINT, 1):
            assert not is_handled, told
            assert OURS not in errors, told
        elif "KeyboardInterrupt" not in early:  # else the interpreter has swallowed it
            assert process.returncode in (130, 0), told
            assert process.returncode == 130 or words[0] != "conform", told
            assert "Traceback" not in errors, told
            assert "Exception ignored" not in errors, told


def test_a_program_that_imports_the_package_keeps_its_ctrl_c() -> None:
    """Nothing but the program itself ends by it without a word."""
    code = (
        "import signal, axistwin\n"
        "assert signal.getsignal(signal.SIGINT) is signal.default_int_handler\n"
        "from axistwin.cli.main import main\n"
        "try:\n    main(['--version'])\nexcept SystemExit:\n    pass\n"
        "assert signal.getsignal(signal.SIGINT) is signal.default_int_handler\n"
    )
    subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)


def test_a_plain_run_loads_only_what_it_needs(tmp_path: Path) -> None:
    """No bus, program, control API, rack file, plot, suite or their libraries: a start is quick."""
    command = [
        sys.executable,
        "-X",
        "importtime",
        "-m",
        "axistwin",
        "run",
        "mac23",
        "--pty",
        "port",
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        process.terminate()
        _, errors = process.communicate(timeout=60)
    lines = [line for line in errors.splitlines() if line.startswith("import time:")]
    loaded = {line.rpartition("|")[2].strip() for line in lines}
    assert "axistwin.runtime.line" in loaded
    ours = ("control", "runtime.bus", "wire.can_bus", "programs", "macroprogram", "cli.rack")
    unwanted = {*(f"axistwin.{name}" for name in (*ours, "cli.plot", "canbus", "hid"))}
    unwanted |= {"axistwin_conformance", "pydantic", "hid", "can", "fastapi", "matplotlib"}
    unwanted |= {"asyncio", "logging", "concurrent.futures", "difflib"}
    assert not loaded & unwanted
