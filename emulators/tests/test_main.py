"""The program before anything is loaded."""

import subprocess
import sys

import pytest

INTERRUPTED = """
import importlib.abc, runpy, sys

class Interrupt(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "click":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupt())
"""


@pytest.mark.parametrize(
    "start",
    [
        "from axistwin.cli.main import main\nsys.exit(main())",
        "runpy.run_module('axistwin', run_name='__main__')",
    ],
    ids=["axistwin", "python -m axistwin"],
)
def test_ctrl_c_while_the_program_is_loaded_ends_it_without_a_word(start: str) -> None:
    """Status 130, as at any later time, and no traceback."""
    command = [sys.executable, "-c", INTERRUPTED + start]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
