"""The tiers of the tests: what is in none of the dear ones, is fast and does nothing dear."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DEAR = {
    "process": "import subprocess; subprocess.run(['true'], check=True)",
    "fork": "import os; os.fork() or os._exit(0)",
    "pty": "import pty; pty.openpty()",
    "socket": "import socket; socket.create_server(('127.0.0.1', 0)).close()",
    "secret": "import contextlib, os\n with contextlib.suppress(BaseException): os.openpty()",
}


def told(folder: Path, *words: str) -> str:
    """What pytest says at the end, with the project's own settings."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.stdout


@pytest.mark.system
def test_a_fast_test_that_does_something_dear_fails_and_says_so(tmp_path: Path) -> None:
    """A process, a fork, a pty, a socket: allowed where the test is marked for it, else not."""
    for name in ("conftest.py", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    lines = ["import pytest", "def test_nothing(): pass"]
    for name, deed in DEAR.items():
        lines += [f"def test_{name}():\n {deed}"]
        lines += ["@pytest.mark.system", f"def test_marked_{name}():\n {deed}"]
    (tmp_path / "test_all.py").write_text("\n".join(lines), "utf-8")
    out = told(tmp_path, "test_all.py")
    assert f"{len(DEAR)} failed, {len(DEAR) + 1} passed" in out, out
    assert out.count("mark it 'system' or 'strength'\n") >= len(DEAR)
    fast = told(tmp_path, "test_all.py", "-m", "fast", "--collect-only")
    assert "test_nothing" in fast
    assert "test_marked" not in fast
