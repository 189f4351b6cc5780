"""Who may use the control API, and how much of it, over real sockets."""

import base64
import contextlib
import http.client
import json
import resource
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from daemon_process import assert_one_clear_line, daemon, invoke
from served import eventually
from served_control import TIMEOUT_S, ServedControl
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from axistwin.control import guard, listener, watching
from axistwin.control.guard import BODY_MAX_BYTES, Guard
from axistwin.control.listener import CONNECTIONS_MAX
from axistwin.control.token import TOKEN_VARIABLE, find_token
from axistwin.errors import UsageError

pytestmark = pytest.mark.system

TOKEN = "0123456789abcdef0123456789abcdef"


@pytest.fixture(scope="module")
def api() -> Iterator[ServedControl]:
    """A MAC23, for this machine, without a token."""
    with ServedControl("mac23:0") as served:
        yield served


@pytest.fixture(scope="module")
def secret() -> Iterator[ServedControl]:
    """A MAC23, for who has the token."""
    with ServedControl("mac23:0", token=TOKEN) as served:
        yield served


def upgrade(served: ServedControl, headers: dict[str, str]) -> int:
    """The status of the answer to a WebSocket with these headers; 101: it has begun."""
    given = {
        "Host": f"127.0.0.1:{served.place[1]}",
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
        **headers,
    }
    lines = [f"{name}: {value}" for name, value in given.items()]
    with served.connect() as connection:
        request = "\r\n".join(["GET /api/v1/events HTTP/1.1", *lines, "", ""])
        connection.sendall(request.encode())
        return int(connection.recv(4096).split()[1])


# ---- where it may listen -------------------------------------------------------------------------


@pytest.mark.parametrize("host", ["0.0.0.0", "[::]", "192.0.2.1", "example.org"])
def test_others_than_this_machine_need_a_token(host: str, tmp_path: Path) -> None:
    """Without one the run does not begin, and says what to do."""
    result = invoke("run", "mac23", "--pty", str(tmp_path / "p"), "--control", f"{host}:0")
    assert_one_clear_line(result, host, "token", "--control-token-file", "127.0.0.1")


def test_a_token_in_a_file_goes_with_a_control_address(tmp_path: Path) -> None:
    """Else nothing would be protected by it."""
    result = invoke("run", "mac23", "--control-token-file", str(tmp_path / "t"))
    assert_one_clear_line(result, "--control-token-file goes with --control")


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("short", "at least 16"),
        ("0123456789abcdef 0123", "one line"),
        ("0123456789ab\x07cdef", "letters"),
    ],
)
def test_a_token_that_is_none_is_refused_and_not_shown(
    text: str, part: str, tmp_path: Path
) -> None:
    """From a file or the environment."""
    path = tmp_path / "token"
    path.write_text(text)
    for given, environment in ((str(path), ""), (None, text)):
        with pytest.raises(UsageError, match=part) as caught:
            find_token(given, {TOKEN_VARIABLE: environment})
        assert text not in str(caught.value)
    with pytest.raises(UsageError, match="cannot be read"):
        find_token(str(tmp_path / "nowhere"), {})


def test_a_token_is_read_from_a_file_or_the_environment(tmp_path: Path) -> None:
    """The file beats the environment; without either there is none."""
    path = tmp_path / "token"
    path.write_text(f"{TOKEN}\n")
    assert find_token(str(path), {TOKEN_VARIABLE: "x"}) == TOKEN
    assert find_token(None, {TOKEN_VARIABLE: TOKEN}) == TOKEN
    assert find_token(None, {}) is None


# ---- Host and Origin -----------------------------------------------------------------------------

OWN_HOSTS = ["127.0.0.1", "localhost", "LOCALHOST:1", "[::1]:8080", "127.8.9.1"]
FOREIGN_HOSTS = [
    "example.org",
    "localhost.example.org",
    "192.0.2.7:8080",
    "127.0.0.1.example.org",
    "",
    "[::2]",
    "127.0.0.1@example.org",
]


@pytest.mark.parametrize("host", OWN_HOSTS)
def test_this_servers_own_names_are_served(api: ServedControl, host: str) -> None:
    """Over HTTP and over a WebSocket."""
    assert api.ask("GET", "devices", headers={"Host": host})[0] == 200
    assert upgrade(api, {"Host": host}) == 101


@pytest.mark.parametrize("host", FOREIGN_HOSTS)
def test_a_page_whose_name_was_rebound_to_this_machine_is_refused(
    api: ServedControl, host: str
) -> None:
    """Its requests come with its own name as Host, over HTTP and over a WebSocket."""
    status, answer = api.ask("GET", "devices", headers={"Host": host})
    assert (status, answer["error"]) == (403, "forbidden")
    assert upgrade(api, {"Host": host}) in (400, 403)


def test_a_request_has_one_host(api: ServedControl) -> None:
    """Neither none nor two."""
    for hosts in (b"", b"Host: 127.0.0.1\r\nHost: example.org\r\n"):
        request = b"GET /api/v1/devices HTTP/1.1\r\n" + hosts + b"\r\n"
        assert api.raw(request).split()[1] in (b"400", b"403")
    assert api.raw(b"GET /api/v1/devices HTTP/1.0\r\n\r\n").split()[1] == b"403"


@pytest.mark.parametrize(
    "origin", ["http://example.org", "null", "https://127.0.0.1", "http://127.0.0.1:1", ""]
)
@pytest.mark.parametrize("method", ["GET", "PUT", "POST", "OPTIONS"])
def test_web_pages_of_others_are_refused(api: ServedControl, method: str, origin: str) -> None:
    """What they would ask for is not done, over HTTP and over a WebSocket."""
    headers = {"Origin": origin}
    path = "devices/mac23:0/controls/inputs.reference"
    status, answer = api.ask(method, path, {"value": True}, headers)
    assert (status, answer["error"]) == (403, "forbidden")
    assert upgrade(api, headers) == 403
    assert api.get(path)["value"] is False


def test_a_page_of_this_server_is_served(api: ServedControl) -> None:
    """Its Origin is where it came from."""
    host = "{}:{}".format(*api.place)
    headers = {"Host": host, "Origin": f"http://{host}"}
    assert api.ask("GET", "devices", headers=headers)[0] == 200
    assert upgrade(api, headers) == 101


def test_elsewhere_addresses_and_the_machines_own_names_are_hosts() -> None:
    """A name that a page chooses is none."""
    everywhere = Guard(_no_application, "0.0.0.0", TOKEN)
    assert everywhere._is_own("192.0.2.7:8080")
    assert everywhere._is_own(f"{socket.gethostname()}:8080")
    assert not everywhere._is_own("example.org:8080")


async def _no_application(*_: Any) -> None:
    raise AssertionError("nothing gets through")


# ---- the token -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "given", [None, "", "Bearer", f"Bearer {TOKEN[:-1]}", f"Bearer {TOKEN}0", f"Basic {TOKEN}", "é"]
)
@pytest.mark.parametrize("path", ["devices", "/openapi.json", "/metrics", "/nothing"])
def test_nothing_is_answered_without_the_token(
    secret: ServedControl, path: str, given: str | None
) -> None:
    """Missing, wrong or of another kind; over a WebSocket too."""
    headers = {} if given is None else {"Authorization": given}
    status, answer = secret.ask("GET", path, headers=headers)
    assert (status, answer["error"]) == (401, "unauthorized")
    assert upgrade(secret, headers) == 401


def test_everything_is_answered_with_the_token(secret: ServedControl) -> None:
    """Over HTTP and over a WebSocket."""
    headers = {"Authorization": f"Bearer {TOKEN}"}
    assert secret.ask("GET", "devices", headers=headers)[0] == 200
    assert upgrade(secret, headers) == 101


def test_a_websocket_of_a_browser_has_the_token_in_a_subprotocol(secret: ServedControl) -> None:
    """In base64url; a wrong one, or what is none, is refused, and so is it elsewhere."""
    for token, status in ((TOKEN, 101), (TOKEN[:-1], 401), ("", 401)):
        code = base64.urlsafe_b64encode(token.encode()).decode().rstrip("=")
        offered = {"Sec-WebSocket-Protocol": f"axistwin, axistwin.bearer.{code}"}
        assert upgrade(secret, offered) == status
        assert secret.ask("GET", "devices", headers=offered)[0] == 401
    for code in ("a", "____", "!"):
        assert upgrade(secret, {"Sec-WebSocket-Protocol": f"axistwin.bearer.{code}"}) == 401


def test_only_the_files_of_the_panel_are_read_without_the_token(secret: ServedControl) -> None:
    """By their exact paths; a page of another site does not get even these."""
    for path in ("/", "/panel/panel.js"):
        assert secret.ask("GET", path)[0] == 200
        assert secret.ask("GET", path, headers={"Origin": "http://example.org"})[0] == 403
    for path in (
        "/panel/",
        "/panel/nothing.js",
        "/panel/../api/v1/devices",
        "/panel/..%2fpanel.py",
        "/panel/%2e%2e/api/v1/devices",
        "//api/v1/devices",
    ):
        assert secret.ask("GET", path)[0] == 401


def test_a_token_is_compared_in_constant_time(
    secret: ServedControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the one function that is made for that."""
    compared: list[tuple[bytes, bytes]] = []

    def compare(given: bytes, wanted: bytes) -> bool:
        compared.append((given, wanted))
        return False

    monkeypatch.setattr("axistwin.control.guard.hmac.compare_digest", compare)
    headers = {"Authorization": f"Bearer {TOKEN}"}
    assert secret.ask("GET", "devices", headers=headers)[0] == 401
    assert compared == [(f"Bearer {TOKEN}".encode(),) * 2]


def test_the_token_is_told_nowhere(tmp_path: Path) -> None:
    """Not by the daemon's output, events, errors, schema or metrics."""
    environment = {TOKEN_VARIABLE: TOKEN}
    with daemon(
        tmp_path, "mac23", "--control", "0.0.0.0:0", "--json", environment=environment
    ) as process:
        ready = process.event()
        port = int(ready["control"].rpartition(":")[2])
        told = json.dumps(ready)
        for path in ("/openapi.json", "/metrics", "/api/v1/devices", "/nothing"):
            for token in (TOKEN, TOKEN[:-1]):
                connection = http.client.HTTPConnection("127.0.0.1", port, timeout=TIMEOUT_S)
                connection.request("GET", path, headers={"Authorization": f"Bearer {token}"})
                response = connection.getresponse()
                told += f"{response.headers}{response.read().decode()}"
                connection.close()
        status, out, err = process.end()
    assert status == 0
    assert "axistwin_line_up" in told
    assert TOKEN[:8] not in told + out + err


# ---- how much ------------------------------------------------------------------------------------


def test_a_body_that_is_too_long_is_not_read(api: ServedControl) -> None:
    """Told by its length, or found out as it comes."""
    path = "devices/mac23:0/controls/inputs.reference"
    status, answer = api.ask("PUT", path, b" " * (BODY_MAX_BYTES + 1))
    assert (status, answer["error"]) == (413, "too_large")
    head = f"PUT /api/v1/{path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    told = head + "Content-Length: 9999999999\r\n\r\n"
    assert api.raw(told.encode()).split()[1] == b"413"
    chunk = b"8000\r\n" + b" " * 0x8000 + b"\r\n"
    chunked = head.encode() + b"Transfer-Encoding: chunked\r\n\r\n" + 4 * chunk
    assert api.raw(chunked).split()[1] == b"413"


def test_a_body_that_does_not_come_is_not_waited_for(
    api: ServedControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Others are answered meanwhile; then the connection is closed."""
    monkeypatch.setattr(guard, "BODY_TIMEOUT_S", 0.3)
    request = b"PUT /api/v1/devices HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\nab"
    answered = api.raw(request)
    assert answered.split()[1] == b"408"
    assert b"the body took over" in answered


def test_half_a_request_is_not_waited_for(
    api: ServedControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor is none at all; each is closed."""
    monkeypatch.setattr(listener, "IDLE_S", 0.2)
    for begun in (b"", b"GET /api/v1/devices HTTP/1.1\r\nHos"):
        assert api.raw(begun) == b""
    once = b"GET /api/v1/devices HTTP/1.1\r\nHost: localhost\r\n\r\nGET /"
    assert api.raw(once).startswith(b"HTTP/1.1 200")


def test_headers_without_end_are_refused(api: ServedControl) -> None:
    """From a bound on."""
    with contextlib.suppress(ConnectionError):
        assert api.raw(b"GET / HTTP/1.1\r\nX: " + b"a" * 200_000).split()[1] in (b"400", b"431")
    assert api.get("devices")


def test_a_thousand_idle_connections_keep_nobody_out(api: ServedControl) -> None:
    """The one that has been idle longest makes room; what is open stays bounded."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    with contextlib.ExitStack() as stack:
        for _ in range(min(1000, most - 300)):
            stack.enter_context(api.connect())
        assert api.get("devices")["devices"]
        server = api.server._listener._server
        assert server is not None
        assert len(server.server_state.connections) <= CONNECTIONS_MAX


def test_websockets_that_do_not_read_are_dropped_and_disturb_nobody(
    api: ServedControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 200 those that are let in lose their place; memory is bounded, and others are told."""
    monkeypatch.setattr(watching, "QUEUE_MAX", 20)
    url = api.server.url.replace("http", "ws") + "/api/v1/events"
    headers = (
        f"GET /api/v1/events HTTP/1.1\r\nHost: 127.0.0.1:{api.place[1]}\r\n"
        "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    )
    with contextlib.ExitStack() as stack:
        for _ in range(200):
            deaf = stack.enter_context(socket.socket())
            deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            deaf.settimeout(TIMEOUT_S)
            deaf.connect(api.place)
            deaf.sendall(headers.encode())
        counts = api.server.counts
        assert eventually(lambda: counts.watchers == watching.WATCHERS_MAX)
        live = api.server.live
        end = time.monotonic() + TIMEOUT_S
        while counts.watchers and time.monotonic() < end:
            for number in range(50):
                api.rack.loop.call_soon(
                    live._line_told, "mac23:0", {"event": "x", "text": "y" * 2000, "n": number}
                )
            assert api.get("devices")["devices"]
        assert counts.watchers == 0
        assert counts.dropped >= watching.WATCHERS_MAX
    with connect(url, open_timeout=TIMEOUT_S, proxy=None) as client:
        assert json.loads(client.recv(TIMEOUT_S))["event"] == "snapshot"


def test_a_slow_reader_sees_the_code_when_it_reads(
    api: ServedControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was sent before, and then that it was too slow."""
    monkeypatch.setattr(watching, "QUEUE_MAX", 20)
    monkeypatch.setattr(listener, "FAREWELL_S", TIMEOUT_S)
    url = api.server.url.replace("http", "ws") + "/api/v1/events"
    dropped = api.server.counts.dropped
    with connect(url, open_timeout=TIMEOUT_S, proxy=None, max_queue=1) as client:
        end = time.monotonic() + TIMEOUT_S
        while api.server.counts.dropped == dropped and time.monotonic() < end:
            for _ in range(50):
                api.rack.loop.call_soon(
                    api.server.live._line_told, "mac23:0", {"event": "x", "text": "y" * 20_000}
                )
            assert api.get("devices")
        with pytest.raises(ConnectionClosed) as caught:
            read_all(client)
        assert caught.value.rcvd is not None
        assert caught.value.rcvd.code == watching.TOO_SLOW


def read_all(client: Any) -> None:
    """All that comes, until it ends."""
    while True:
        client.recv(TIMEOUT_S)


def test_a_message_that_is_too_long_ends_the_websocket(api: ServedControl) -> None:
    """With the protocol's own code."""
    url = api.server.url.replace("http", "ws") + "/api/v1/events"
    with connect(url, open_timeout=TIMEOUT_S, proxy=None) as client:
        client.send("x" * 5000)
        with pytest.raises(ConnectionClosed) as caught:
            read_all(client)
        assert caught.value.rcvd is not None
        assert caught.value.rcvd.code == 1009


def test_more_watchers_than_there_is_room_for_are_sent_away(
    api: ServedControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They may come again."""
    assert eventually(lambda: api.server.counts.watchers == 0)
    monkeypatch.setattr("axistwin.control.watching.WATCHERS_MAX", 1)
    url = api.server.url.replace("http", "ws") + "/api/v1/events"
    with connect(url, open_timeout=TIMEOUT_S, proxy=None) as first:
        first.recv(TIMEOUT_S)
        with pytest.raises(InvalidStatus) as caught:
            connect(url, open_timeout=TIMEOUT_S, proxy=None)
        assert caught.value.response.status_code == 503


def test_garbage_is_answered_with_400_or_the_end(api: ServedControl) -> None:
    """And nobody else notices."""
    for garbage in (b"\x16\x03\x01\0\0", b"\0" * 1000, b"GET\r\n\r\n", b"\xff\xfe" * 500):
        with contextlib.suppress(ConnectionError):
            answered = api.raw(garbage + b"\r\n\r\n")
            assert answered == b"" or answered.split()[1] == b"400"
    with api.connect() as connection:  # reset in the middle of a request
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        connection.sendall(b"GET /api/v1/dev")
    assert api.get("devices")


def test_a_handshake_of_a_websocket_elsewhere_is_refused(api: ServedControl) -> None:
    """There is only one place for it."""
    url = api.server.url.replace("http", "ws")
    with pytest.raises(InvalidStatus):
        connect(f"{url}/api/v1/devices", open_timeout=TIMEOUT_S, proxy=None)


def test_the_server_ends_though_clients_stay(tmp_path: Path) -> None:
    """A watcher and an idle connection do not hold it up."""
    served = ServedControl("mac23:0")
    threads = threading.active_count()
    with contextlib.ExitStack() as stack:
        with served:
            url = served.server.url.replace("http", "ws") + "/api/v1/events"
            client = stack.enter_context(connect(url, open_timeout=TIMEOUT_S, proxy=None))
            client.recv(TIMEOUT_S)
            stack.enter_context(served.connect())
        assert served.server._listener._thread is None
        assert threading.active_count() <= threads + 1  # the watcher's own
