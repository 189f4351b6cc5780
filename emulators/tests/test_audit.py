"""scripts/audit.py: the pins at a vulnerability database that a test plays."""

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
PINS = (ROOT / "constraints.txt").read_text("ascii").split()
H11 = next(pin for pin in PINS if pin.startswith("h11==")).removeprefix("h11==")
FLAW = {
    "id": "TOY-2026-1",
    "summary": "An oversized toy breaks it.",
    "aliases": [],
    "affected": [
        {
            "package": {"name": "h11", "ecosystem": "PyPI"},
            "ranges": [
                {"type": "ECOSYSTEM", "events": [{"introduced": "0"}, {"fixed": "99.1"}]},
            ],
        }
    ],
}


class Database(ThreadingHTTPServer):
    """Answers every question with ``status``, and knows ``flaws`` by the names of packages."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Answer)
        self.status = 200
        self.flaws: dict[str, Any] = {}
        self.asked: list[str] = []

    @property
    def url(self) -> str:
        """Where it is asked."""
        return f"http://127.0.0.1:{self.server_port}/v1/query"


class Answer(BaseHTTPRequestHandler):
    """One question."""

    server: Database

    def do_POST(self) -> None:
        """As OSV does."""
        question = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        name = question["package"]["name"]
        self.server.asked.append(f"{name}=={question['version']}")
        flaws = self.server.flaws.get(name)
        body = json.dumps({"vulns": [flaws]} if flaws else {}).encode()
        self.send_response(self.server.status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_request(self, code: int | str = "-", size: int | str = "-") -> None:
        """Nothing."""


@pytest.fixture
def database() -> Iterator[Database]:
    """One that knows of no flaw."""
    with Database() as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def audit(url: str, *arguments: str) -> tuple[int, str]:
    """Status and output of the script that asks at ``url``."""
    command = [sys.executable, str(ROOT / "scripts" / "audit.py"), "--osv-url", url, *arguments]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert result.stderr == ""
    return result.returncode, result.stdout


def test_every_pin_is_looked_up(database: Database) -> None:
    """At its version; without a flaw the check goes on."""
    told = f"audit: {len(PINS)} of {len(PINS)} pins looked up, no known vulnerability\n"
    assert audit(database.url) == (0, told)
    assert len(database.asked) == len(PINS)
    assert f"h11=={H11}" in database.asked


def test_a_known_vulnerability_fails_the_check(database: Database) -> None:
    """With package, version, its name, and where it is mended."""
    database.flaws["h11"] = FLAW
    status, told = audit(database.url)
    assert status == 1
    assert f"h11 {H11}: TOY-2026-1, mended in 99.1\n" in told
    assert audit(database.url, "--ignore-vuln", "TOY-2026-1")[0] == 0


@pytest.mark.parametrize("status", [403, 500, 503])
def test_a_database_that_refuses_does_not_stop_the_check(database: Database, status: int) -> None:
    """One line says that nothing was audited."""
    database.status = status
    code, told = audit(database.url)
    assert code == 0
    assert told.startswith("audit: not done, the vulnerability database gives no answer (")
    assert told.count("\n") == 1


def test_without_network_the_check_goes_on() -> None:
    """One line says that nothing was audited."""
    with Database() as closed:
        url = closed.url
    assert audit(url) == (
        0,
        "audit: not done, the vulnerability database gives no answer (ConnectionError)\n",
    )


def test_a_mistake_in_the_call_is_no_missing_network(database: Database) -> None:
    """It fails, with what pip-audit says."""
    status, told = audit(database.url, "--no-such-option")
    assert status == 1
    assert "--no-such-option" in told
