"""The examples of a rack as a service and in a container name what there is, and it works."""

import configparser
import json
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from daemon_process import TIMEOUT_S, daemon, invoke

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
RACKS = ROOT / "fixtures" / "racks"
FILE = "/etc/axistwin/rack.toml"
RACK = '[[line]]\nname = "press"\ndevices = "mac23"\npty = "./press"\n'


def service() -> dict[str, str]:
    """The keys of [Service] in the unit."""
    unit = configparser.ConfigParser(interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]  # as systemd: case counts
    unit.read(RACKS / "axistwin-rack.service")
    return dict(unit["Service"])


def test_the_unit_checks_starts_and_reloads_a_rack(tmp_path: Path) -> None:
    """By its own commands, in a folder of its own; the rack tells systemd when it is ready."""
    keys = service()
    (program, *check), (again, *start) = map(shlex.split, (keys["ExecStartPre"], keys["ExecStart"]))
    assert program == again
    assert (start, keys["Type"]) == (["rack", FILE], "notify")
    (tmp_path / "rack.toml").write_text(RACK)
    for words, status in ((check, 0), (["rack", "--check", FILE + "~"], 2)):
        given = [word.replace(FILE, str(tmp_path / "rack.toml")) for word in words]
        assert invoke(*given).exit_code == status
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(TIMEOUT_S)
        notify = {"NOTIFY_SOCKET": str(tmp_path / "notify")}
        with daemon(tmp_path, "rack.toml", "--json", command="rack", environment=notify) as rack:
            assert systemd.recv(4096).decode().splitlines()[0] == "READY=1"
            assert rack.event()["event"] == "ready"
            (tmp_path / "rack.toml").write_text(RACK + RACK.replace("press", "saw"))
            how = shlex.split(keys["ExecReload"])
            assert (how[0], how[2]) == ("/bin/kill", "$MAINPID")
            rack.process.send_signal(getattr(signal, f"SIG{how[1][1:]}"))
            while (event := rack.event())["event"] != "reloaded":
                assert event["event"] == "ready"
            assert event["added"] == ["saw"]
            assert rack.end()[0] == 0


def test_the_container_has_all_that_it_installs_and_runs(tmp_path: Path) -> None:
    """A wheel is built of what is copied into it, with the extra that is installed."""
    text = (RACKS / "Containerfile").read_text("utf-8").replace("\\\n", " ")
    source = tmp_path / "source"
    source.mkdir()
    for copied in re.findall(r"^COPY (.*)$", text, re.MULTILINE):
        *names, place = copied.split()
        for path in (ROOT / name for name in names):
            if path.is_dir():
                ignored = shutil.ignore_patterns("__pycache__", "tests")
                assert place == f"/source/{path.name}"
                shutil.copytree(path, source / path.name, ignore=ignored)
            else:
                shutil.copy(path, source)
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", str(source)]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    (wheel,) = (source / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as files:
        (name,) = (name for name in files.namelist() if name.endswith("/METADATA"))
        extras = re.findall(r"^Provides-Extra: (.*)$", files.read(name).decode(), re.MULTILINE)
    (extra,) = re.findall(r"'/source\[(\w+)\]'", text)
    assert extra in extras
    (pins,) = re.findall(r"--constraint /source/(\S+)", text)
    assert (source / pins).is_file()
    (entry,) = re.findall(r"^ENTRYPOINT (.*)$", text, re.MULTILINE)
    assert json.loads(entry) == ["axistwin", "rack", FILE]
