"""The control API of a front: what it does with clients, and with workers that are gone."""

import http.client
import json
import socket
import time
from collections.abc import Iterator

import pytest
from served_control import TIMEOUT_S, ServedControl
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from axistwin.control import listener, watching
from axistwin.control.client import LET_GO, ControlClient
from axistwin.control.front.workforce import WorkedLine, Worker, Workforce
from axistwin.control.server import ControlServer
from axistwin.errors import UsageError

pytestmark = pytest.mark.system

TOKEN = "0123456789abcdef0123456789abcdef"


class FrontOf:
    """A front of ``worker``, and of one that has just ended."""

    def __init__(self, worker: ServedControl) -> None:
        self.workforce = Workforce()
        living = Worker(0, worker.server.url.removeprefix("http://"), TOKEN)
        gone = Worker(1, "127.0.0.1:1", TOKEN)
        self.workforce.lines = {
            "mac23:0": WorkedLine("mac23:0", ("mac23:0",), (), living),
            "gone": WorkedLine("gone", ("mac23:0@gone",), (), gone),
        }
        self.server = ControlServer(self.workforce, "127.0.0.1:0", None)

    def watch(self, query: str) -> ClientConnection:
        """The WebSocket."""
        url = f"{self.server.url.replace('http', 'ws')}/api/v1/events{query}"
        return connect(url, open_timeout=TIMEOUT_S, proxy=None, max_queue=1)

    def forget_gone(self) -> None:
        """As the front does when it has noticed."""
        lines = dict(self.workforce.lines)
        gone = WorkedLine("gone", ("mac23:0@gone",), (("pty", "./gone"),), None, "it was killed")
        self.workforce.lines = {**lines, "gone": gone}


@pytest.fixture
def worker() -> Iterator[ServedControl]:
    """One that serves."""
    with ServedControl("mac23", token=TOKEN) as served:
        yield served


@pytest.fixture
def front(worker: ServedControl) -> Iterator[FrontOf]:
    """It is served."""
    front = FrontOf(worker)
    front.server.open()
    front.server.serve()
    yield front
    front.server.close()


def code_at_end(client: ClientConnection) -> int:
    """The code with which the WebSocket is closed, after all that is told before."""
    try:
        while True:
            client.recv(TIMEOUT_S)
    except ConnectionClosed as closed:
        return 0 if closed.rcvd is None else closed.rcvd.code


def test_a_slow_reader_is_dropped_with_the_code(
    front: FrontOf, worker: ServedControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The worker drops the front, and the front its client; both count it."""
    front.forget_gone()
    monkeypatch.setattr(watching, "QUEUE_MAX", 20)
    monkeypatch.setattr(listener, "FAREWELL_S", TIMEOUT_S)
    with front.watch("?device=mac23:0") as client:
        end = time.monotonic() + TIMEOUT_S
        while worker.server.counts.dropped == 0 and time.monotonic() < end:
            for _ in range(50):
                worker.rack.loop.call_soon(
                    worker.server.live._line_told, "mac23:0", {"event": "x", "text": "y" * 20_000}
                )
            assert ControlClient(front.server.url).get("devices")
        assert code_at_end(client) == watching.TOO_SLOW
    assert front.server.counts.dropped == 1


def test_who_says_something_is_dropped(front: FrontOf, worker: ServedControl) -> None:
    """With a code that says so; nothing is left of it at the worker."""
    front.forget_gone()
    with front.watch("?device=mac23:0") as client:
        assert json.loads(client.recv(TIMEOUT_S))["event"] == "snapshot"
        client.send("hello")
        assert code_at_end(client) == watching.NOT_EXPECTED
    end = time.monotonic() + TIMEOUT_S
    while worker.server.counts.watchers and time.monotonic() < end:
        time.sleep(0.01)
    assert (front.server.counts.watchers, worker.server.counts.watchers) == (0, 0)


def test_one_more_client_than_may_watch_is_refused(
    front: FrontOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the front."""
    front.forget_gone()
    monkeypatch.setattr(watching, "WATCHERS_MAX", 1)
    with front.watch("") as client:
        client.recv(TIMEOUT_S)
        with pytest.raises(InvalidStatus) as caught:
            front.watch("")
    assert caught.value.response.status_code == 503


def test_lines_that_come_let_go_who_watches_all(front: FrontOf) -> None:
    """They are told first; who watches one device goes on, unless it would not hear of them."""
    front.forget_gone()
    viewers = front.workforce.viewers
    assert viewers is not None
    with front.watch("") as everything, front.watch("?device=mac23:0") as alone:
        for client in (everything, alone):
            assert json.loads(client.recv(TIMEOUT_S))["event"] == "snapshot"
        added = [front.workforce.lines["gone"]]
        viewers.lines_came(added, by_new_worker=False)
        told = json.loads(everything.recv(TIMEOUT_S))
        assert (told["line"], told["kind"]) == ("gone", "line_added")
        assert code_at_end(everything) == LET_GO
        viewers.line_failed(added[0])
        told = json.loads(alone.recv(TIMEOUT_S))
        assert (told["line"], told["kind"]) == ("gone", "line_failed")
        assert told["details"]["error"] == "it was killed"
        viewers.lines_came(added, by_new_worker=True)
        assert code_at_end(alone) == LET_GO


def test_nothing_is_told_before_every_worker_is_heard(front: FrontOf) -> None:
    """Who has its snapshots would wait for ever for what a worker told before that."""
    with socket.create_server(("127.0.0.1", 0)) as slow:
        late = Worker(1, f"127.0.0.1:{slow.getsockname()[1]}", TOKEN)
        late_line = WorkedLine("gone", ("mac23:0@gone",), (), late)
        front.workforce.lines = {**front.workforce.lines, "gone": late_line}
        with front.watch("") as client:
            with pytest.raises(TimeoutError):
                client.recv(0.5)
            slow.accept()[0].close()
            assert code_at_end(client) == LET_GO


def test_a_worker_that_does_not_answer_is_told(front: FrontOf) -> None:
    """As busy devices are; once it is known that it has ended, its line is shown as failed."""
    client = ControlClient(front.server.url)
    for path in (("devices",), ("lines",), ("devices", "mac23:0@gone")):
        with pytest.raises(UsageError, match="worker 1 does not answer; try again"):
            client.get(*path)
    assert client.get("devices", "mac23:0")["name"] == "mac23:0"
    front.forget_gone()
    assert [each["name"] for each in client.get("devices")["devices"]] == ["mac23:0"]
    gone = client.get("lines")["lines"][1]
    assert (gone["name"], gone["failure"]) == ("gone", "it was killed")
    assert gone["endpoints"] == [{"kind": "pty", "url": "./gone"}]
    with pytest.raises(UsageError, match="gone is not served any more: it was killed"):
        client.get("devices", "mac23:0@gone")
    with pytest.raises(InvalidStatus) as caught:
        front.watch("?device=mac23:0@gone")
    assert caught.value.response.status_code == 503


def test_another_sites_page_is_refused_by_the_front(front: FrontOf) -> None:
    """Before any worker is asked."""
    host, port = front.server.url.removeprefix("http://").split(":")
    connection = http.client.HTTPConnection(host, int(port), timeout=TIMEOUT_S)
    connection.request("GET", "/api/v1/devices", headers={"Origin": "http://example.org"})
    assert connection.getresponse().status == 403
    connection.close()
