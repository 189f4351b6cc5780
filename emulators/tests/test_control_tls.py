"""The control API over TLS: what serves it, who trusts it, and what wrong files are told."""

import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from control_tls_files import Files
from daemon_process import Daemon, assert_one_clear_line, daemon, invoke
from served_control import TIMEOUT_S
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from axistwin.control import listener
from axistwin.control.client import ControlClient
from axistwin.control.server import ControlServer
from axistwin.control.tls import client_context, server_context
from axistwin.runtime.serving.rack import Rack

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Made anew for each run of the tests."""
    return Files(tmp_path_factory.mktemp("tls"))


@pytest.fixture(scope="module")
def url(files: Files, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """That of a daemon with a certificate."""
    folder = tmp_path_factory.mktemp("daemon")
    words = ("mac23", "--pty", "./m", "--control", "127.0.0.1:0", "--json")
    with daemon(folder, *words, *files.options) as process:
        yield process.event()["control"]


def test_a_daemon_with_a_certificate_is_worked_over_https(url: str, files: Files) -> None:
    """By ctl, by its CA from an option or from the environment; the ready line has the URL."""
    assert url.startswith("https://127.0.0.1:")
    words = ("--control", url, "--control-ca", files.authority)
    assert invoke("ctl", "mac23:0", "inputs.reference", "on", *words).exit_code == 0
    client = ControlClient(url, authority=files.authority)
    assert client.get("devices", "mac23:0", "controls", "inputs.reference")["value"] is True


def test_the_variable_names_the_ca(url: str, files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    """For who would write the option again and again."""
    monkeypatch.setenv("AXISTWIN_CONTROL_CA", files.authority)
    monkeypatch.setenv("AXISTWIN_CONTROL", url)
    assert "mac23:0" in invoke("ctl").output


def test_events_come_over_wss(url: str, files: Files) -> None:
    """Snapshots first, and then what is worked."""
    client = ControlClient(url, authority=files.authority)
    events = client.watch("mac23:0")
    assert next(events)["event"] == "snapshot"
    client.put("devices", "mac23:0", "controls", "inputs.positive_stop", value=True)
    assert next(each for each in events if each["event"] == "set")["value"] is True


@pytest.mark.parametrize(("scheme", "is_served"), [("https", True), ("http", False)])
def test_the_origin_of_the_panel_is_https(
    url: str, files: Files, scheme: str, is_served: bool
) -> None:
    """A page that came without TLS is another site's."""
    place = url.removeprefix("https://")
    context = client_context(files.authority)

    def join() -> str:
        with connect(
            f"wss://{place}/api/v1/events",
            origin=Origin(f"{scheme}://{place}"),
            ssl=context,
            proxy=None,
            open_timeout=TIMEOUT_S,
        ) as client:
            return str(json.loads(client.recv(TIMEOUT_S))["event"])

    if is_served:
        assert join() == "snapshot"
    else:
        with pytest.raises(InvalidStatus, match="403"):
            join()


def test_who_does_not_trust_it_is_told_so(url: str, files: Files, tmp_path: Path) -> None:
    """Another CA, none at all, the wrong scheme at either end: one line, with the remedy."""
    other = Files(tmp_path / "other")
    for more in ((), ("--control-ca", other.authority)):
        result = invoke("ctl", "--control", url, *more)
        assert_one_clear_line(result, "not trusted", "--control-ca")
    plain = invoke("ctl", "--control", url.replace("https", "http"))
    assert_one_clear_line(plain, "certificate", "https://")
    watched = invoke("watch", url)
    assert_one_clear_line(watched, "not trusted", "--control-ca")
    with daemon(tmp_path, "mac23", "--pty", "./m", "--control", "127.0.0.1:0", "--json") as process:
        bare = process.event()["control"].replace("http", "https")
        result = invoke("ctl", "--control", bare, "--control-ca", files.authority)
        assert_one_clear_line(result, "no TLS", "http://")


def nothing(path: Path, files: Files) -> tuple[str, str | None]:
    """No file."""
    return str(path / "nowhere"), None


def text(path: Path, files: Files) -> tuple[str, str | None]:
    """A file that is no PEM, as certificate."""
    (path / "text").write_bytes(b"\xffno certificate\n")
    return str(path / "text"), files.key


def text_as_key(path: Path, files: Files) -> tuple[str, str | None]:
    """A file that is no PEM, as key."""
    (path / "text").write_text("no key\n")
    return files.certificate, str(path / "text")


def no_key(path: Path, files: Files) -> tuple[str, str | None]:
    """A certificate without the key that should be behind it."""
    return files.certificate, None


def foreign_key(path: Path, files: Files) -> tuple[str, str | None]:
    """That of another certificate."""
    return files.certificate, Files(path / "other").key


def broken(path: Path, files: Files) -> tuple[str, str | None]:
    """PEM around what is no certificate."""
    body = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"
    (path / "broken").write_text(body)
    return str(path / "broken"), files.key


def locked(path: Path, files: Files) -> tuple[str, str | None]:
    """A key with a password, for which nobody is to be asked."""
    body = Path(files.key).read_text().replace("RSA ", "").replace("EC ", "")
    (path / "locked").write_text(body.replace("PRIVATE", "ENCRYPTED PRIVATE"))
    return files.certificate, str(path / "locked")


@pytest.mark.parametrize(
    ("make", "part"),
    [
        (nothing, "No such file"),
        (text, "no certificate in PEM"),
        (text_as_key, "no private key in PEM"),
        (no_key, "no private key in PEM"),
        (foreign_key, "does not belong"),
        (broken, "certificate"),
        (locked, "password"),
    ],
)
def test_files_that_are_wrong_are_one_clear_line(
    make: Callable[[Path, Files], tuple[str, str | None]], part: str, files: Files, tmp_path: Path
) -> None:
    """Before anything is served, of a run and of a rack, which names its line."""
    certificate, key = make(tmp_path, files)
    options = ["--control-certificate", certificate, *(["--control-key", key] if key else [])]
    where = ("--pty", str(tmp_path / "p"), "--control", "127.0.0.1:0")
    assert_one_clear_line(invoke("run", "mac23", *where, *options), "control", part)
    table = f'[control]\naddress = "127.0.0.1:0"\ncertificate = "{certificate}"\n'
    table += f'key = "{key}"\n' if key else ""
    rack = tmp_path / "rack.toml"
    rack.write_text(f'{table}[[line]]\nname = "a"\ndevices = "mac23"\npty = "./a"\n')
    result = invoke("rack", "--check", str(rack))
    (line,) = result.stderr.splitlines()
    assert (result.exit_code, line.partition(": ")[0]) == (2, f"{rack}:1")
    assert part in line


def test_options_that_want_others_say_so(files: Files, tmp_path: Path) -> None:
    """A certificate without an address, a key without a certificate, a CA that is none."""
    result = invoke("run", "mac23", *files.options)
    assert_one_clear_line(result, "--control-certificate goes with --control")
    result = invoke("run", "mac23", "--control", "127.0.0.1:0", "--control-key", files.key)
    assert_one_clear_line(result, "control key", "certificate")
    for path, part in ((files.key, "no certificate in PEM"), ("nowhere", "cannot be read")):
        result = invoke("ctl", "--control", "https://127.0.0.1:1", "--control-ca", path)
        assert_one_clear_line(result, "control CA", part)


def test_a_rack_has_a_certificate_too(files: Files, tmp_path: Path) -> None:
    """With its key in the same file."""
    (tmp_path / "rack.toml").write_text(
        f'[control]\naddress = "127.0.0.1:0"\ncertificate = "{files.both}"\n'
        '[[line]]\nname = "a"\ndevices = "mac23"\npty = "./a"\n'
    )
    with daemon(tmp_path, "rack.toml", "--json", command="rack") as process:
        client = ControlClient(process.event()["control"], authority=files.authority)
        assert [each["name"] for each in client.get("devices")["devices"]] == ["mac23:0@a"]
        assert_ends(process)


def assert_ends(process: Daemon) -> None:
    """At once, with status 0 and no word."""
    status, _, errors = process.end()
    assert status == 0
    assert "Traceback" not in errors


def test_who_never_begins_the_handshake_is_cut(
    files: Files, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As who sends no request; and the server ends although one is still there."""
    monkeypatch.setattr(listener, "IDLE_S", 0.3)
    rack = Rack()
    server = ControlServer(rack, "127.0.0.1:0", None, server_context(files.certificate, files.key))
    place = ("127.0.0.1", 0)
    server.open()
    rack.start()
    server.serve()
    try:
        place = ("127.0.0.1", int(server.url.rpartition(":")[2]))
        with socket.create_connection(place, timeout=TIMEOUT_S) as silent:
            assert silent.recv(1) == b""
        monkeypatch.setattr(listener, "IDLE_S", 60.0)
        late = socket.create_connection(place, timeout=TIMEOUT_S)
        begun_s = time.monotonic()
    finally:
        server.close()
        rack.stop()
    assert time.monotonic() - begun_s < listener.STOP_TIMEOUT_S
    late.close()
