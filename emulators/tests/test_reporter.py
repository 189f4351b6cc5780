"""What ``axistwin run`` and ``rack`` tell, on pipes that are read late, or never."""

import contextlib
import json
import os
import threading

import pytest
from served import TIMEOUT_S

from axistwin.cli.run import reporter
from axistwin.cli.run.outlet import Outlet
from axistwin.cli.run.reporter import ROOM_BYTES, Reporter

pytestmark = pytest.mark.system

KERNEL_BYTES = 64 * 1024
"""What a pipe keeps."""

EVENTS = 2 * (KERNEL_BYTES + ROOM_BYTES) // 50
"""Far more than have room; each is longer than 50 bytes."""


class Somewhere:
    """A port that is always there."""

    kind = "pty"
    url = "./somewhere"

    def describe(self) -> str:
        """For people."""
        return self.url

    def open(self) -> None:
        """It is."""

    def close(self) -> None:
        """It need not be."""


def told_late(delay_s: float, as_json: bool) -> list[str]:
    """The ready lines of many devices that a reader finds who comes so late."""
    read_at, told_at = os.pipe()
    found: list[str] = []

    def read() -> None:
        with open(read_at, encoding="ascii") as lines:  # noqa: PTH123 - a descriptor
            found.extend(lines)

    reader = threading.Timer(delay_s, read)
    reader.start()
    with contextlib.closing(Reporter(as_json, told_at)) as tells:
        for number in range(EVENTS):
            tells.ready([f"mac23:0@a-line-with-a-rather-long-name-{number}"], [Somewhere()])
    os.close(told_at)
    reader.join(TIMEOUT_S)
    return found


@pytest.mark.parametrize("as_json", [True, False])
def test_no_ready_line_is_lost_to_a_reader_who_is_behind(
    monkeypatch: pytest.MonkeyPatch, as_json: bool
) -> None:
    """Who reads them knows which devices there are."""
    monkeypatch.setattr(reporter, "_FAREWELL_S", TIMEOUT_S)
    found = told_late(0.2, as_json)
    assert len(found) == EVENTS
    if as_json:
        assert {json.loads(each)["event"] for each in found} == {"ready"}


def test_a_reader_who_never_reads_is_waited_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """And not for each device."""
    monkeypatch.setattr(reporter, "_FAREWELL_S", 0.01)
    waited: list[float] = []
    put = Outlet.put

    def counted(outlet: Outlet, data: bytes, patience_s: float = 0.0) -> bool:
        has_room = put(outlet, data, patience_s)
        if not has_room and patience_s:
            waited.append(patience_s)
        return has_room

    monkeypatch.setattr(Outlet, "put", counted)
    read_at, told_at = os.pipe()
    with contextlib.closing(Reporter(True, told_at)) as tells:
        for number in range(EVENTS):
            tells.ready([f"mac23:0@a-line-with-a-rather-long-name-{number}"], [Somewhere()])
        assert waited == [0.01]
        os.close(read_at)
    os.close(told_at)
