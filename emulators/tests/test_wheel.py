"""The built wheel in a clean environment, used by a project that knows nothing of this tree."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "fixtures" / "example-project"

pytestmark = pytest.mark.system


def run(*command: str | Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run ``command`` in ``folder`` with nothing inherited but PATH; the output as text."""
    environment = {"PATH": "/usr/local/bin:/usr/bin:/bin", "HOME": str(folder), "LANG": "C.UTF-8"}
    return subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=600,
    )


@pytest.fixture(scope="module")
def clean_python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of a new environment that holds the built wheel, its needs, and pytest."""
    folder = tmp_path_factory.mktemp("wheel")
    built = run(
        *(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT),
        folder=folder,
    )
    assert built.returncode == 0, built.stdout
    (wheel,) = folder.glob("axistwin-*.whl")
    environment = folder / "environment"
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    python = environment / "bin" / "python"
    # pip's own settings (an index nearby) may come from the environment: inherit it here only.
    needs = [f"{wheel}[conformance]", "pytest", "--constraint", str(ROOT / "constraints.txt")]
    subprocess.run([str(python), "-m", "pip", "install", "--quiet", *needs], check=True)
    return python


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A copy of the example project, outside the tree."""
    return Path(shutil.copytree(EXAMPLE, tmp_path / "project"))


def test_a_correct_driver_passes_with_the_installed_wheel(
    clean_python: Path, project: Path
) -> None:
    """The careful driver's tests pass in virtual time and on a pty."""
    result = run(clean_python, "-m", "pytest", "-k", "correct", "-q", folder=project)
    assert result.returncode == 0, result.stdout
    assert "2 passed" in result.stdout


def test_a_naive_driver_fails_with_the_transcript_in_the_failure(
    clean_python: Path, project: Path
) -> None:
    """The driver that ignores Xonerror fails, and the failure shows the refused command decoded."""
    result = run(clean_python, "-m", "pytest", "-k", "naive", "-q", folder=project)
    assert result.returncode == 1, result.stdout
    assert "2 failed" in result.stdout
    assert "06 13 17" in result.stdout
    assert "refused" in result.stdout


@pytest.mark.parametrize(
    ("model", "requirement"), [("mac23", "MACS-FRAME-01"), ("msc-250", "MSC-PKT-01")]
)
def test_the_installed_suite_runs_from_an_empty_folder(
    clean_python: Path, tmp_path: Path, model: str, requirement: str
) -> None:
    """Ledgers and golden frames are inside the wheel: the quick level conforms anywhere."""
    result = run(
        clean_python, "-m", "axistwin", "conform", model, "--level", "quick", "-v", folder=tmp_path
    )
    assert result.returncode == 0, result.stdout
    assert requirement in result.stdout


def test_a_macroprogram_runs_with_the_installed_wheel(clean_python: Path, tmp_path: Path) -> None:
    """A program of the user's, and one that comes with the wheel, work in a controller."""
    (tmp_path / "test_program.py").write_text(
        """
from axistwin.macroprogram import Macroprogram, Variable


class Ticks(Macroprogram):
    ticks = Variable(2008)

    def scan(self) -> None:
        self.ticks += 1


def test_programs(axistwin):
    own = axistwin("msc-250", program=Ticks, time="virtual")
    bench = axistwin("msc-250", program="bench", time="virtual")
    for twin in (own, bench):
        twin.advance(1)
        assert 99 <= twin.variables["ticks"] <= 101
""",
        encoding="utf-8",
    )
    result = run(clean_python, "-m", "pytest", "-q", folder=tmp_path)
    assert result.returncode == 0, result.stdout


def test_a_profile_comes_with_the_installed_wheel(clean_python: Path, tmp_path: Path) -> None:
    """By its name, from any folder."""
    program = (
        "from axistwin.testing import start\n"
        "with start('mn400', profile='mn100', time='virtual') as twin:\n"
        "    print(twin.line.twins[0].describe()['state'])\n"
    )
    result = run(clean_python, "-c", program, folder=tmp_path)
    assert (result.returncode, result.stdout) == (0, "RDY\n"), result.stdout


def test_the_core_install_names_what_pictures_need(clean_python: Path, tmp_path: Path) -> None:
    """matplotlib is an extra."""
    result = run(clean_python, "-m", "axistwin", "plot", "mac23", "go to 5", folder=tmp_path)
    assert result.returncode == 2
    assert result.stdout == (
        "axistwin: plot needs matplotlib, which is not installed: pip install 'matplotlib>=3.9'\n"
    )


def test_the_wheel_has_the_panel(clean_python: Path, tmp_path: Path) -> None:
    """Its files, those of others with their licence."""
    code = (
        "from importlib.resources import files; "
        "print(*(files('axistwin.control') / 'page').iterdir())"
    )
    listed = run(clean_python, "-c", code, folder=tmp_path).stdout
    for name in ("index.html", "panel.js", "uPlot.iife.min.js", "uPlot.LICENSE.txt"):
        assert name in listed
