"""Faults of the wire of a daemon: by its API, from a shell, in a rack file, on a real pty."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest
import serial
from daemon_process import TIMEOUT_S, assert_one_clear_line, daemon, invoke
from served_control import ServedControl
from websockets.sync.client import connect

from axistwin import testing
from axistwin.runtime.line import Line

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "break-the-wire.md"
POSITION = b"\x0201400200000000000A2\x03"
REPLY_BYTES = 21
FAULTS = "lines/mac23:0/faults"


@pytest.fixture(scope="module")
def api() -> Iterator[ServedControl]:
    """A line and a bus."""
    with ServedControl("mac23:0", "mac23-can:3") as served:
        yield served


@pytest.fixture(autouse=True)
def no_faults_are_left(api: ServedControl) -> Iterator[None]:
    """Each test begins with wires that work."""
    yield
    for line in ("mac23:0", "mac23-can:3"):
        api.ask("DELETE", f"lines/{line}/faults")


# ---- a real pty ----------------------------------------------------------------------------------


def test_a_program_at_a_pty_asks_again_when_a_reply_is_lost() -> None:
    """In real time, as a reader of the first page would see it."""
    with testing.start("mac23") as twin, serial.Serial(twin.port, 38400, timeout=1.0) as port:
        twin.line.faults.add("drop", direction="to_host", count=2)
        tries = 0
        answer = b""
        while not answer:
            tries += 1
            port.write(POSITION)
            answer = port.read(REPLY_BYTES)
        assert (tries, len(answer)) == (3, REPLY_BYTES)
        assert twin.line.faults[1].acted == 2


def test_who_only_listens_hears_the_noise_of_a_line_that_was_at_rest(tmp_path: Path) -> None:
    """A fault added over the API wakes the daemon in time, though nothing else would."""
    with daemon(tmp_path, "mac23", "--control", "127.0.0.1:0", "--json") as process:
        address = process.event()["control"].removeprefix("http://")
        with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=TIMEOUT_S) as port:
            words = ("ctl", "line", "faults", "add", "noise", "direction=to_host", "per-s=50")
            assert invoke(*words, "--control", address).exit_code == 0
            assert len(port.read(5)) == 5


# ---- the API -------------------------------------------------------------------------------------


def test_faults_are_added_listed_and_removed(api: ServedControl) -> None:
    """Each with its number, what it is, and what it has done; by the name of a device as well."""
    order = {"kind": "drop", "direction": "to_host", "count": 1}
    status, added = api.ask("POST", FAULTS, order)
    assert status == 201
    assert added.items() >= {**order, "line": "mac23:0", "acted": 0, "over": False}.items()
    assert api.get(FAULTS) == {"line": "mac23:0", "faults": [added]}
    line = cast(Line, api.lines[0])
    assert line.exchange(POSITION) == b""
    line.advance(50_000_000)
    (now,) = api.get(FAULTS)["faults"]
    assert (now["seen"], now["acted"], now["over"]) == (1, 1, True)
    assert now["last"].startswith("lost: 06 13 02")
    assert api.ask("DELETE", f"{FAULTS}/{added['number']}") == (200, now)
    assert api.get("lines/mac23/faults")["faults"] == []
    api.ask("POST", "lines/mac23-can:3/faults", {"kind": "error_frame"})
    status, removed = api.ask("DELETE", "lines/mac23-can:3/faults")
    assert (status, len(removed["faults"])) == (200, 1)


@pytest.mark.parametrize(
    ("method", "path", "body", "status", "told"),
    [
        ("POST", FAULTS, {"kind": "error_frame"}, 422, "not for a serial line"),
        ("POST", FAULTS, {"kind": "dorp"}, 422, "kind"),
        ("POST", FAULTS, {"kind": "noise"}, 422, "per_s is missing"),
        ("POST", FAULTS, {"kind": "drop", "count": 0}, 422, "count"),
        ("POST", FAULTS, {"kind": "drop", "number": 3}, 422, "number"),
        ("GET", "lines/mca23/faults", None, 404, "no line 'mca23': "),
        ("DELETE", f"{FAULTS}/9999", None, 404, "no fault 9999: known: none"),
        ("DELETE", f"{FAULTS}/x", None, 422, "number"),
    ],
)
def test_a_mistake_is_told_with_the_remedy(
    api: ServedControl, method: str, path: str, body: Any, status: int, told: str
) -> None:
    """As every error is; nothing is added."""
    answered, problem = api.ask(method, path, body)
    assert (answered, problem["message"].count("\n")) == (status, 0)
    assert told in problem["message"]
    assert api.get(FAULTS)["faults"] == []


def test_those_who_watch_are_told_when_a_fault_acts(api: ServedControl) -> None:
    """Several acts in one event; the metrics count them, removed or not."""
    url = api.server.url.replace("http", "ws") + "/api/v1/events"
    with connect(url, open_timeout=TIMEOUT_S, proxy=None) as client:
        for _ in range(2):
            client.recv(TIMEOUT_S)
        api.ask("POST", FAULTS, {"kind": "duplicate", "direction": "to_device", "chance": 1})
        for _ in range(5):
            cast(Line, api.lines[0]).exchange(POSITION)
        acted = 0
        while acted < 5:
            event = json.loads(client.recv(TIMEOUT_S))
            if event["event"] == "line" and event["kind"] == "wire_fault":
                details = event["details"]
                assert (event["line"], details["fault_kind"]) == ("mac23:0", "duplicate")
                acted += details["acted"]
        assert acted == 5
    api.ask("DELETE", FAULTS)
    status, metrics = api.ask("GET", "/metrics")
    assert status == 200
    row = r'axistwin_wire_faults_total\{kind="duplicate",line="mac23:0"\} (\d+)'
    assert re.search(row, metrics.decode())


# ---- a shell -------------------------------------------------------------------------------------


def said(api: ServedControl, *words: str) -> str:
    """What ``axistwin ctl line`` says; it is done."""
    address = api.server.url.removeprefix("http://")
    result = invoke("ctl", "line", *words, "--control", address)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_ctl_lists_adds_and_removes(api: ServedControl) -> None:
    """Of several lines one is named."""
    words = ("drop", "direction=to_host", "message=20h", "count=2")
    added = said(api, "mac23:0", "faults", "add", *words)
    shown = r" +(\d+) mac23:0  drop direction=to_host message=20h count=2  seen 0, acted 0\n"
    found = re.fullmatch(shown, added)
    assert found
    busy = json.loads(said(api, "mac23-can:3", "faults", "add", "busy", "duration-ms=5", "--json"))
    assert busy["duration_ms"] == 5
    assert said(api, "faults").splitlines()[0] == added.rstrip()
    assert len(said(api, "faults").splitlines()) == 2
    said(api, "mac23:0", "faults", "remove", found[1])
    said(api, "mac23-can:3", "faults", "remove", "all")
    assert said(api, "faults") == ""


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("mac23:0", "faults", "add", "dorp"), "kind 'dorp': did you mean drop?"),
        (("mac23:0", "faults", "add"), "a kind is missing"),
        (("mac23:0", "faults", "add", "drop", "cuont=2"), "did you mean count?"),
        (("mac23:0", "faults", "add", "drop", "count=two"), "count 'two': that is no number"),
        (("mac23:0", "faults", "remove", "x"), "give its number, or 'all'"),
        (("mac23:0", "faults", "remove", "77"), "no fault 77"),
        (("mac23:0", "faults", "rmove", "1"), "did you mean remove?"),
        (("faults", "add", "drop"), "there are several lines; name one"),
        (("mac24:0", "faults"), "did you mean mac23:0"),
        ((), "write 'axistwin ctl line faults'"),
    ],
)
def test_a_mistake_in_the_shell_is_one_clear_line(
    api: ServedControl, words: tuple[str, ...], told: str
) -> None:
    """With the nearest name, or what is allowed."""
    address = api.server.url.removeprefix("http://")
    assert_one_clear_line(invoke("ctl", "line", *words, "--control", address), told)


# ---- a rack file ---------------------------------------------------------------------------------

LINE = '[[line]]\nname = "press"\ndevices = ["mac23:0"]\npty = "./press"\n'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("kind = 'dorp'\n", ":6: kind 'dorp': did you mean drop?"),
        ("knd = 'drop'\n", ":6: unknown key 'knd': did you mean kind?"),
        ("kind = 'drop'\ncount = 0\n", ":7: count 0 is out of range"),
        ("kind = 'delay'\nduration-ms = 'x'\n", ":7: duration-ms is 'x': input should be a valid"),
        ("kind = 'delay'\nduration-ms = 0\n", ":7: duration-ms 0 is out of range"),
        ("kind = 'error_frame'\n", ":6: kind 'error_frame' is not for a serial line"),
        ("kind = 'noise'\n", ":5: per-s is missing"),
        ("kind = 'drop'\nhex = '2'\n", ":7: hex '2': write bytes as two digits each"),
    ],
)
def test_a_mistake_in_a_rack_file_is_told_with_its_line(
    text: str, told: str, tmp_path: Path
) -> None:
    """And with the nearest name."""
    path = tmp_path / "rack.toml"
    path.write_text(f"{LINE}[[line.faults]]\n{text}")
    result = invoke("rack", "--check", str(path))
    assert result.exit_code == 2
    assert f"{path}{told}" in result.stderr


def test_the_example_shows_faults_that_work(tmp_path: Path) -> None:
    """Without the comment signs in front of them."""
    path = tmp_path / "rack.toml"
    assert invoke("rack", "--init", str(path)).exit_code == 0
    text = path.read_text()
    block = text[text.index("# [[line.faults]]") :].partition("\n\n")[0]
    path.write_text(text.replace(block, re.sub(r"^# ", "", block, flags=re.MULTILINE)))
    assert "\n[[line.faults]]\nkind" in path.read_text()
    result = invoke("rack", "--check", str(path))
    assert (result.exit_code, result.output) == (0, "")


def test_a_rack_has_the_faults_of_its_file(tmp_path: Path) -> None:
    """From the start, numbered in their order; they go on from there."""
    (tmp_path / "rack.toml").write_text(
        '[control]\naddress = "127.0.0.1:0"\n'
        f"{LINE}[[line.faults]]\nkind = 'drop'\ndirection = 'to_host'\n"
        "[[line.faults]]\nkind = 'delay'\nhex = 'FF'\nduration-ms = 2.5\n"
    )
    with daemon(tmp_path, "rack.toml", "--json", command="rack") as process:
        address = process.event()["control"].removeprefix("http://")
        rows = invoke("ctl", "line", "faults", "--control", address).stdout.splitlines()
        assert [row.partition("  seen")[0].strip() for row in rows] == [
            "1 press  drop direction=to_host",
            "2 press  delay hex=FF duration_ms=2.5",
        ]
        with serial.Serial(str(tmp_path / "press"), 38400, timeout=1.0) as port:
            port.write(POSITION)
            assert port.read(REPLY_BYTES) == b""
            event = process.event()
            while event["event"] != "wire_fault":
                event = process.event()
            assert (event["fault"], event["fault_kind"], event["acted"]) == (1, "drop", 1)
            port.write(POSITION)
            assert len(port.read(REPLY_BYTES)) == REPLY_BYTES


# ---- the page ------------------------------------------------------------------------------------


def shown_commands() -> Iterator[tuple[str, str]]:
    """The commands of the page's part "From a shell", each with what it says."""
    part = PAGE.read_text(encoding="utf-8").partition("## From a shell")[2].partition("\n## ")[0]
    for block in re.findall(r"```console\n(.*?)```", part, re.DOTALL):
        for text in block.split("$ ")[1:]:
            command, _, output = text.partition("\n")
            yield command, output


def test_the_commands_of_the_page_do_what_it_says(tmp_path: Path) -> None:
    """One after the other, as a reader types them; times of the line differ."""
    commands = list(shown_commands())
    assert len(commands) > 5
    scripts = str(Path(sys.executable).parent)
    with daemon(tmp_path, "mac23", "--control", "127.0.0.1:0", "--json") as process:
        address = process.event()["control"].removeprefix("http://")
        environment = {**os.environ, "AXISTWIN_CONTROL": address}
        environment["PATH"] = f"{scripts}:{environment['PATH']}"
        for command, output in commands:
            done = subprocess.run(
                ["bash", "-c", command],
                cwd=tmp_path,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
                timeout=TIMEOUT_S,
            )
            said_now = re.sub(r"last \d+\.\d{3} s", "last 9.876 s", done.stdout + done.stderr)
            assert said_now == re.sub(r"last \d+\.\d{3} s", "last 9.876 s", output), command


def test_the_rack_file_of_the_page_has_no_mistakes(tmp_path: Path) -> None:
    """As --check says."""
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "rack.toml").write_text(text)
    result = invoke("rack", "--check", str(tmp_path / "rack.toml"))
    assert (result.exit_code, result.output) == (0, "")


def test_the_python_of_the_page_does_what_it_says(tmp_path: Path) -> None:
    """As a test file of its own."""
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "test_page.py").write_text(code)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_page.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
