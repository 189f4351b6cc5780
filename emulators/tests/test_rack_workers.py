"""``axistwin rack --workers N``: several processes that nobody can tell from one."""

import json
import re
import signal
import socket
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import quote

import psutil
import pytest
from control_tls_files import Files
from daemon_process import TIMEOUT_S, assert_one_clear_line, daemon, invoke, talk
from rack_process import answers, line_of, next_event, ready, reload, serve, workers_of
from served import eventually

from axistwin.control.client import ControlClient
from axistwin.errors import UsageError

pytestmark = pytest.mark.system

CONTROL = '[control]\naddress = "127.0.0.1:0"\n'
TOKEN = "0123456789abcdef0123456789abcdef"
FAULT = {"kind": "drop", "direction": "to_host", "count": 2}


def is_over(process: psutil.Process) -> bool:
    """Whether it has ended."""
    return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE


# -- as with one process -----------------------------------------------------------------------


RACK = CONTROL + "".join(
    (
        line_of("press"),
        line_of("saw", "msc-250"),
        line_of("rs485", "mac34-1:5"),
        line_of("board", "mn400"),
    )
)


@pytest.fixture(scope="module")
def urls(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[int, str]]:
    """Of the control APIs of the same rack, by the number of workers."""
    with ExitStack() as stack:
        found = {}
        for count in (1, 3):
            rack = stack.enter_context(serve(tmp_path_factory.mktemp("rack"), RACK, count))
            found[count] = next(iter(ready(rack, 4).values()))["control"]
        yield found


ASKED = (
    ("GET", "/api/v1/lines", None),
    ("GET", "/api/v1/devices", None),
    *(("GET", f"/api/v1/devices/{name}", None) for name in ("mac23:0@press", "mn400", "mac23:7")),
    ("GET", "/api/v1/devices/mac34-1:5/controls", None),
    ("GET", "/api/v1/devices/msc-250/controls/flags.3", None),
    ("PUT", "/api/v1/devices/mac23/controls/inputs.reference", {"value": True}),
    ("PUT", "/api/v1/devices/mac23/controls/supply_volts", {"value": "much"}),
    ("PUT", "/api/v1/devices/mac24/controls/supply_volts", {"value": 20}),
    ("POST", "/api/v1/devices/mac34-1/power", {"action": "cycle"}),
    ("POST", "/api/v1/devices/nobody/power", {"action": "never"}),
    ("POST", "/api/v1/lines/rs485/faults", FAULT),
    ("GET", "/api/v1/lines/mac34-1:5/faults", None),
    ("DELETE", "/api/v1/lines/rs485/faults/1", None),
    ("GET", "/api/v1/lines/board/traffic?last=5", None),
    ("GET", "/api/v1/lines/bord/traffic", None),
    ("GET", "/api/v1/lines/", None),
    ("PATCH", "/api/v1/devices", None),
    ("GET", "/api/v1/nothing", None),
    *(("GET", path, None) for path in ("/openapi.json", "/", "/panel/api.js", "/panel/nothing")),
)


def answer(url: str, method: str, path: str, body: Any) -> tuple[int, str, str]:
    """Status, kind of content, and content, without what no two racks have in common."""
    request = urllib.request.Request(
        url + quote(path, safe="/:@?="),
        None if body is None else json.dumps(body).encode(),
        {"Content-Type": "application/json"},
        method=method,
    )
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as reply:
            status, headers, content = reply.status, reply.headers, reply.read().decode()
    except urllib.error.HTTPError as error:
        status, headers, content = error.code, error.headers, error.read().decode()
    return status, headers["Content-Type"], re.sub(r'time_ns":\d+', 'time_ns":0', content)


@pytest.mark.parametrize(("method", "path", "body"), ASKED)
def test_the_control_api_answers_as_that_of_one_process(
    urls: dict[int, str], method: str, path: str, body: Any
) -> None:
    """What is there, what is set, what is wrong, and the panel; byte for byte."""
    one, several = (answer(url, method, path, body) for url in urls.values())
    assert several == one


def test_metrics_are_those_of_all_workers(urls: dict[int, str]) -> None:
    """Each series once, with a type; processes are told apart."""
    one, several = (answer(url, "GET", "/metrics", None)[2].splitlines() for url in urls.values())
    series = [
        {line.rpartition(" ")[0] for line in page if not line.startswith(("#", "axistwin_api"))}
        for page in (one, several)
    ]
    assert {name for name in series[1] if "worker=" not in name} == series[0]
    added = {f'process_open_fds{{worker="{number}"}}' for number in range(3)}
    assert added < series[1] - series[0]
    types = [line for line in several if line.startswith("# TYPE")]
    assert len(types) == len(set(types))
    assert [line for line in one if line in types] == [line for line in one if "# TYPE" in line]


def test_what_happens_anywhere_is_live_state(urls: dict[int, str]) -> None:
    """Of all devices or of some, of several workers; `axistwin ctl` works any of them."""
    client = ControlClient(urls[3])
    everything = client.watch()
    names = {next(everything)["device"] for _ in range(4)}
    assert names == {each["name"] for each in client.get("devices")["devices"]}
    some = client.watch("mac23:0@press", "mn400:1@board")
    assert {next(some)["device"] for _ in range(2)} == {"mac23:0@press", "mn400:1@board"}
    for name in ("mac23:0@press", "msc-250:1@saw", "mn400:1@board"):
        told = invoke("ctl", "--control", urls[3], name, "power", "off")
        assert told.exit_code == 0, told.output
        assert next(e for e in everything if e["event"] == "set")["device"] == name
        if name != "msc-250:1@saw":
            assert next(e for e in some if e["event"] == "set")["device"] == name


def test_the_control_api_of_a_front_has_token_and_certificate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of the rack file; the workers' own are another's."""
    files = Files(tmp_path / "tls")
    table = f'certificate = "{files.certificate}"\nkey = "{files.key}"\n'
    text = CONTROL + table + line_of("press") + line_of("saw")
    monkeypatch.setenv("AXISTWIN_CONTROL_TOKEN", TOKEN)
    with serve(tmp_path, text, 2) as rack:
        url = ready(rack, 2)["mac23:0@saw"]["control"]
        assert url.startswith("https://")
        client = ControlClient(url, TOKEN, files.authority)
        assert [each["line"] for each in client.get("devices")["devices"]] == ["press", "saw"]
        assert next(client.watch("mac23:0@saw"))["event"] == "snapshot"
        with pytest.raises(UsageError, match="a token is needed"):
            ControlClient(url, None, files.authority).get("devices")
        own = [
            each.laddr
            for worker in workers_of(rack)
            for each in worker.net_connections()
            if each.status == psutil.CONN_LISTEN
        ]
        assert [each.ip for each in own] == ["127.0.0.1"] * 2
        for each in own:
            with pytest.raises(UsageError, match="a token is needed"):
                ControlClient(f"127.0.0.1:{each.port}", TOKEN).get("devices")
        assert rack.end()[0] == 0


def test_clients_of_all_workers_are_events_on_one_output(tmp_path: Path) -> None:
    """And the capture and the macroprogram of a line are where one process has them."""
    program = "bench"
    text = line_of("press", capture="press.log") + line_of("saw", "msc-250", program=program)
    with serve(tmp_path, text, 2) as rack:
        assert list(ready(rack, 2)) == ["mac23:0@press", "msc-250:1@saw"]
        assert len(workers_of(rack)) == 2
        for name, model in (("press", "mac23"), ("saw", "msc-250")):
            words = "position?" if model == "mac23" else "RQSTAT"
            told = talk(str(tmp_path / name), model, words)
            assert told.exit_code == 0, told.output
            assert next_event(rack, "connected")["url"] == f"./{name}"
        assert rack.end()[0] == 0
    assert (tmp_path / "press.log").stat().st_size > 0


# -- reload ------------------------------------------------------------------------------------


def test_a_port_goes_from_one_worker_to_another(tmp_path: Path) -> None:
    """What is to end has ended before another worker opens it."""
    before = line_of("a") + line_of("b", pty="./moved") + line_of("c") + line_of("d")
    after = line_of("d") + line_of("e", pty="./moved")
    with serve(tmp_path, before, 2) as rack:
        ready(rack, 4)
        assert reload(rack, tmp_path, after)["added"] == ["e"]
        assert answers(tmp_path / "moved")
        assert answers(tmp_path / "d")
        status, _, err = rack.end()
    assert (status, "failed" in err) == (0, False)


def test_reloads_that_are_asked_for_at_once_all_end(tmp_path: Path) -> None:
    """What the file has last is served."""
    with serve(tmp_path, line_of("a") + line_of("b"), 2) as rack:
        ready(rack, 2)
        for count in range(8):
            text = "".join(line_of(f"line-{each}") for each in range(count + 1))
            (tmp_path / "rack.toml").write_text(text)
            rack.process.send_signal(signal.SIGHUP)
        assert eventually((tmp_path / "line-7").is_symlink)
        assert all(answers(tmp_path / f"line-{each}") for each in range(8))
        assert not (tmp_path / "a").is_symlink()
        assert rack.end()[0] == 0


# -- ends --------------------------------------------------------------------------------------


def test_a_worker_that_is_killed_is_told_and_the_others_go_on(tmp_path: Path) -> None:
    """Its lines are shown as failed, to who asks and who watches; SIGHUP serves them again."""
    text = 'state = "memory"\n' + CONTROL + line_of("press") + line_of("saw", "mac34-1")
    with serve(tmp_path, text, 2) as rack:
        client = ControlClient(ready(rack, 2)["mac23:0@press"]["control"])
        everything, alone = client.watch(), client.watch("mac34-1:0@saw")
        assert {next(everything)["event"] for _ in range(2)} == {"snapshot"}
        assert next(alone)["event"] == "snapshot"
        workers_of(rack)[0].kill()
        failed = next_event(rack, "line_failed")
        assert (failed["line"], failed["devices"]) == ("press", ["mac23:0@press"])
        assert failed["error"] == "worker 0 has ended (SIGKILL); SIGHUP begins it again"
        for events in (everything, alone):
            told = next(each for each in events if each["event"] == "line")
            assert (told["line"], told["kind"]) == ("press", "line_failed")
        assert [each["failure"] for each in client.get("lines")["lines"]] == [failed["error"], None]
        assert [each["line"] for each in client.get("devices")["devices"]] == ["saw"]
        assert answers(tmp_path / "saw", "mac34-1")
        with pytest.raises(UsageError, match="press is not served any more: worker 0 has ended"):
            client.get("devices", "mac23:0@press", "state")
        page = answer(f"http://{client.address}", "GET", "/metrics", None)[2]
        assert 'axistwin_line_up{line="press"} 0.0' in page
        assert 'axistwin_line_up{line="saw"} 1.0' in page
        assert reload(rack, tmp_path, text)["added"] == ["press"]
        assert answers(tmp_path / "press")
        assert client.get("devices", "mac23:0@press")["line"] == "press"
        shown = (each["device"] for each in everything if each["event"] == "snapshot")
        assert next(each for each in shown if each == "mac23:0@press")
        status, _, err = rack.end()
    assert status == 0
    assert "axistwin: press: has failed and is not served any more, others are: worker 0" in err


def test_when_all_workers_have_been_killed_the_rack_ends(tmp_path: Path) -> None:
    """With the reason, and status 2."""
    with serve(tmp_path, line_of("press") + line_of("saw"), 2) as rack:
        ready(rack, 2)
        for worker in workers_of(rack):
            worker.kill()
        _, err = rack.process.communicate(timeout=TIMEOUT_S)
    assert rack.process.returncode == 2
    assert re.search(r"^axistwin: worker \d has ended \(SIGKILL\)", err, re.MULTILINE)
    assert "Traceback" not in err


def test_when_no_worker_can_open_a_line_the_rack_ends(tmp_path: Path) -> None:
    """As with one process: there is nothing to serve."""
    for name in ("press", "saw"):
        (tmp_path / name).write_text("precious")
    with serve(tmp_path, line_of("press") + line_of("saw"), 2) as rack:
        out, err = rack.process.communicate(timeout=TIMEOUT_S)
    assert rack.process.returncode == 2
    assert "Traceback" not in err
    assert {json.loads(line)["event"] for line in out.splitlines()} == {"line_failed"}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_no_worker_outlives_the_front(tmp_path: Path, number: signal.Signals) -> None:
    """However it ends; what they have open is given back."""
    with serve(tmp_path, CONTROL + line_of("press") + line_of("saw"), 2) as rack:
        ready(rack, 2)
        workers = workers_of(rack)
        assert len(workers) == 2
        status, out, _ = rack.end(number)
        assert eventually(lambda: all(map(is_over, workers)))
    if number is not signal.SIGKILL:
        assert status == 0
        assert json.loads(out.splitlines()[-1])["event"] == "stopped"
    assert not (tmp_path / "press").is_symlink()
    assert not (tmp_path / "saw").is_symlink()


def test_what_a_terminal_or_systemd_sends_to_all_is_the_fronts(tmp_path: Path) -> None:
    """Ctrl-C and SIGTERM end no worker before its front does: no line fails."""
    with serve(tmp_path, line_of("press") + line_of("saw"), 2) as rack:
        ready(rack, 2)
        for worker in workers_of(rack):
            for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
                worker.send_signal(number)
        assert answers(tmp_path / "press")
        assert answers(tmp_path / "saw")
        status, out, err = rack.end()
    assert status == 0
    assert "line_failed" not in out
    assert "failed" not in err


def test_systemd_hears_of_the_front_alone(tmp_path: Path) -> None:
    """READY=1 once, when all lines are served."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(TIMEOUT_S)
        (tmp_path / "rack.toml").write_text(line_of("press") + line_of("saw"))
        words = ("rack.toml", "--json", "--workers", "2")
        notify = {"NOTIFY_SOCKET": str(tmp_path / "notify")}
        with daemon(tmp_path, *words, command="rack", environment=notify) as rack:
            assert systemd.recv(4096) == b"READY=1"
            ready(rack, 2)
            assert rack.end()[0] == 0
            assert systemd.recv(4096) == b"STOPPING=1"
        systemd.setblocking(False)
        with pytest.raises(BlockingIOError):
            systemd.recv(4096)


# -- mistakes ----------------------------------------------------------------------------------


@pytest.mark.parametrize("more", [(), ("--check",)])
@pytest.mark.parametrize(
    ("count", "reason"),
    [
        ("0", "0 is not in the range x>=1"),
        ("-1", "-1 is not in the range x>=1"),
        ("many", "'many' is not a"),
        ("9", "rack.toml has 2 that can be apart; give at most 2"),
    ],
)
def test_a_wrong_number_of_workers_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: tuple[str, ...], count: str, reason: str
) -> None:
    """Before anything is started."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rack.toml").write_text(line_of("press") + line_of("saw"))
    result = invoke("rack", "rack.toml", "--workers", count, *more)
    assert_one_clear_line(result, "--workers", reason)
    assert list(tmp_path.iterdir()) == [tmp_path / "rack.toml"]


def test_a_mistake_in_the_file_is_told_before_a_worker_begins(tmp_path: Path) -> None:
    """With its line, as by one process."""
    with serve(tmp_path, line_of("press", "mca23") + line_of("saw"), 2) as rack:
        begin_s = time.monotonic()
        _, err = rack.process.communicate(timeout=TIMEOUT_S)
        assert time.monotonic() - begin_s < TIMEOUT_S
    assert rack.process.returncode == 2
    (line,) = err.splitlines()
    assert line.startswith("rack.toml:3: unknown model 'mca23': did you mean mac23?")
