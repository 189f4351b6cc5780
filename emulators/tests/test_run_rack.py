"""``axistwin rack`` as a process: served, worked, reloaded, ended."""

import io
import json
import os
import re
import shlex
import signal
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
from daemon_process import TIMEOUT_S, daemon, invoke
from rack_process import answers, line_of, next_event, ready, reload, serve
from rich.console import Console

from axistwin.cli.watch.screen import OverviewScreen
from axistwin.control.client import ControlClient
from axistwin.errors import UsageError

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "run-a-rack.md").read_text(encoding="utf-8")


BOTH = pytest.mark.parametrize("workers", [1, 2])
"""Nobody can tell how many there are."""


@BOTH
def test_every_kind_of_line_is_served_by_one_process(tmp_path: Path, workers: int) -> None:
    """Devices are named with their lines; what is stored is in a folder for each; all ends."""
    text = (ROOT / "fixtures" / "racks" / "every-kind.toml").read_text()
    with serve(tmp_path, text, workers) as rack:
        events = ready(rack, 8)
        assert list(events) == [
            *("mac23:0@rs485", "mac34-1:5@rs485", "mac34-2:6@rs485"),
            *("msc-250:1@controller", "mn400:1@board", "mn400:2@board"),
            *("mac23-can:1@hub", "mac23-can:2@hub"),
        ]
        kinds = [each["endpoint"] for each in events["mac23-can:1@hub"]["endpoints"]]
        assert sorted(kinds) == ["slcan", "slcan-tcp", "socketcand"]
        url = events["mac23:0@rs485"]["control"]
        with urllib.request.urlopen(
            f"{url}/api/v1/devices/mac23:0@rs485/state", timeout=TIMEOUT_S
        ) as reply:
            values = json.load(reply)["values"]
        assert (values["inputs.reference"], values["supply_volts"]) == (True, 22.5)
        with urllib.request.urlopen(f"{url}/api/v1/lines", timeout=TIMEOUT_S) as reply:
            lines = json.load(reply)["lines"]
        assert [line["name"] for line in lines] == ["rs485", "controller", "board", "hub"]
        status, out, err = rack.end()
        assert (status, err) == (0, "")
        assert json.loads(out.splitlines()[-1])["event"] == "stopped"
    assert not [path for path in tmp_path.iterdir() if path.is_symlink()]
    memory = {path.name for path in (tmp_path / "memory").iterdir()}
    assert memory == {"rs485", "controller", "board", "hub"}


def test_people_are_told_ready_lines_as_run_tells_them(tmp_path: Path) -> None:
    """With the name that ctl takes; SIGINT ends it too."""
    (tmp_path / "rack.toml").write_text(line_of("press"))
    with daemon(tmp_path, "rack.toml", command="rack") as rack:
        assert rack.line().startswith("ready mac23:0@press pty=./press (")
        assert answers(tmp_path / "press")
        status, _, err = rack.end(signal.SIGINT)
    assert status == 0
    assert err.splitlines() == ["axistwin: memory ends with this run; 'state' in the file keeps it"]


@BOTH
def test_a_line_that_cannot_be_opened_is_told_and_the_others_go_on(
    tmp_path: Path, workers: int
) -> None:
    """The exit status tells it too; what stood in the way is left alone."""
    (tmp_path / "saw").write_text("precious")
    with serve(tmp_path, line_of("press") + line_of("saw"), workers) as rack:
        failed = rack.event()
        assert (failed["event"], failed["line"]) == ("line_failed", "saw")
        assert failed["devices"] == ["mac23:0@saw"]
        ready(rack, 1)
        assert answers(tmp_path / "press")
        status, _, err = rack.end()
    assert status == 2
    assert "axistwin: saw: has failed and is not served any more, others are: " in err
    assert (tmp_path / "saw").read_text() == "precious"


def test_when_no_line_can_be_opened_the_rack_ends(tmp_path: Path) -> None:
    """There is nothing to serve."""
    (tmp_path / "saw").write_text("precious")
    with serve(tmp_path, line_of("saw")) as rack:
        out, err = rack.process.communicate(timeout=TIMEOUT_S)
    assert rack.process.returncode == 2
    assert "Traceback" not in err
    assert json.loads(out)["event"] == "line_failed"


@BOTH
def test_on_sighup_what_did_not_change_goes_on(tmp_path: Path, workers: int) -> None:
    """A client of it notices nothing; the others come, go, and are as the file has them now."""
    before = line_of("same") + line_of("gone") + line_of("changed")
    after = line_of("changed", "mac34-1") + line_of("new") + line_of("same")
    with serve(tmp_path, before, workers) as rack:
        ready(rack, 3)
        terminal = (tmp_path / "same").readlink()
        with serial.Serial(str(tmp_path / "same"), timeout=TIMEOUT_S):
            event = reload(rack, tmp_path, after)
            assert event["event"] == "reloaded"
            assert (event["removed"], event["added"], event["unchanged"]) == (
                ["gone", "changed"],
                ["changed", "new"],
                ["same"],
            )
            assert (tmp_path / "same").readlink() == terminal
        assert not (tmp_path / "gone").is_symlink()
        assert answers(tmp_path / "same")
        assert answers(tmp_path / "new")
        assert answers(tmp_path / "changed", "mac34-1")
        again = reload(rack, tmp_path, after)
        assert (again["removed"], again["added"]) == ([], [])
        assert rack.end()[0] == 0


@BOTH
def test_who_watches_a_line_that_changes_sees_it_come_back(tmp_path: Path, workers: int) -> None:
    """``axistwin watch`` begins again with it; when the device is gone for good, that is told."""
    control = '[control]\naddress = "127.0.0.1:0"\n' + line_of("lathe")
    with serve(tmp_path, control + line_of("press"), workers) as rack:
        events = ControlClient(ready(rack, 2)["mac23:0@press"]["control"]).watch("mac23:0@press")
        assert next(events)["event"] == "snapshot"
        reload(rack, tmp_path, control + line_of("press", seed=5))
        assert "line_removed" in [event.get("kind") for event in until(events, "snapshot")]
        reload(rack, tmp_path, control + line_of("other"))
        with pytest.raises(
            UsageError, match="no device 'mac23:0@press': known: mac23:0@lathe, mac23:0@other"
        ):
            until(events, "snapshot")
        assert rack.end()[0] == 0


@BOTH
def test_who_watches_all_sees_the_lines_that_a_reload_adds(tmp_path: Path, workers: int) -> None:
    """With those that were there; who watches one device is not disturbed."""
    control = '[control]\naddress = "127.0.0.1:0"\n' + line_of("lathe")
    with serve(tmp_path, control + line_of("press"), workers) as rack:
        client = ControlClient(ready(rack, 2)["mac23:0@press"]["control"])
        everything, alone = client.watch(), client.watch("mac23:0@press")
        screen = OverviewScreen(
            client.get("devices")["devices"], lambda name: client.get("devices", name)
        )
        for events in (everything, alone):
            assert next(events)["event"] == "snapshot"
        reload(rack, tmp_path, control + line_of("press") + line_of("saw"))
        told = until(everything, "line")
        told += [event for _ in range(3) for event in until(everything, "snapshot")]
        shown = [event["device"] for event in told if event["event"] == "snapshot"][-3:]
        assert sorted(shown) == ["mac23:0@lathe", "mac23:0@press", "mac23:0@saw"]
        assert "line_added" in [event.get("kind") for event in told]
        assert [event.get("kind") for event in until(alone, "line")] == ["line_added"]
        for event in told:
            screen.receive(event)
        assert all(name in text_of(screen, 3) for name in shown)
        reload(rack, tmp_path, control + line_of("saw"))
        for event in until(everything, "snapshot"):
            screen.receive(event)
        assert "mac23:0@press" not in text_of(screen, 2)
        assert rack.end()[0] == 0


def text_of(screen: OverviewScreen, count: int) -> str:
    """What it shows of so many devices, without the events below."""
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(screen.render(80, count + 2))
    return console.export_text()


def until(events: Iterator[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    """All ``events`` up to one of that kind."""
    found = []
    for event in events:
        found.append(event)
        if event["event"] == kind:
            break
    return found


def test_a_mistake_in_the_file_changes_nothing(tmp_path: Path) -> None:
    """It is told with its line, and the rack goes on; also without a file, or where a pipe is."""
    with serve(tmp_path, line_of("press")) as rack:
        ready(rack, 1)
        event = reload(rack, tmp_path, line_of("press", "mca23") + line_of("saw"))
        assert event["event"] == "reload_failed"
        (problem,) = event["problems"]
        assert problem.startswith("rack.toml:3: unknown model 'mca23': did you mean mac23")
        assert answers(tmp_path / "press")
        assert not (tmp_path / "saw").is_symlink()
        (tmp_path / "rack.toml").unlink()
        rack.process.send_signal(signal.SIGHUP)
        assert "cannot be read (No such file" in next_event(rack, "reload_failed")["problems"][0]
        os.mkfifo(tmp_path / "rack.toml")
        rack.process.send_signal(signal.SIGHUP)
        assert "pipe from which nothing" in next_event(rack, "reload_failed")["problems"][0]
        assert answers(tmp_path / "press")
        status, _, err = rack.end()
    assert status == 0
    assert problem in err


@BOTH
def test_memory_outlives_a_line_that_goes_and_comes(tmp_path: Path, workers: int) -> None:
    """With a state folder; a device that is added again is where it was left."""
    folder = 'state = "memory"\n'
    press, saw = line_of("press"), line_of("saw")
    with serve(tmp_path, folder + press + saw, workers) as rack:
        ready(rack, 2)
        assert reload(rack, tmp_path, folder + saw)["removed"] == ["press"]
        assert (tmp_path / "memory" / "press" / "mac23-0.state").is_file()
        assert reload(rack, tmp_path, folder + saw + press)["added"] == ["press"]
        assert answers(tmp_path / "press")
        assert rack.end()[0] == 0


def test_the_commands_of_the_page_do_what_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From writing the file to working a device; at a free port in place of the one printed."""
    (written, run, worked, _) = re.findall(r"```console\n(.*?)```", PAGE, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    shown = "".join(
        f"$ {line}\n{invoke(*shlex.split(line)[1:]).output}"
        for line in re.findall(r"^\$ (.*)$", written, re.MULTILINE)
    )
    assert shown == written
    (line,) = re.findall(r"^\$ axistwin rack (.*)$", run, re.MULTILINE)
    text = (ROOT / line).read_text(encoding="utf-8")
    (tmp_path / "rack.toml").write_text(text.replace(":8080", ":0"))
    with daemon(tmp_path, "rack.toml", command="rack") as rack:
        ready_lines = [rack.line() for _ in range(2)]
        address = ready_lines[0].rpartition("http://")[2]
        assert [re.sub(r"\(.*", "", each) for each in ready_lines] == [
            re.sub(r"\(.*", "", each) for each in run.splitlines()[1:]
        ]
        monkeypatch.setenv("AXISTWIN_CONTROL", address)
        shown = "".join(
            f"$ {line}\n{invoke(*shlex.split(line)[1:]).output}"
            for line in re.findall(r"^\$ (.*)$", worked, re.MULTILINE)
        )
        assert shown == worked
        assert rack.end()[0] == 0
