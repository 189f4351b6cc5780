"""A judgement over a real hidraw; run where the kernel has uhid (``scripts/vm --uhid``)."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from usb_board import judged

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.engine.result import Result
from axistwin_conformance.transport.hid import open_hid

pytestmark = pytest.mark.uhid

START_S = 60.0
ATTEMPTS = 5
COMMAND = (sys.executable, "-m", "axistwin", "run", "mn400", "--hid", "--json")


@contextmanager
def board(folder: Path) -> Iterator[str]:
    """The node of a twin on USB, in a process of its own."""
    with subprocess.Popen(COMMAND, cwd=folder, stdout=subprocess.PIPE, text=True) as daemon:
        try:
            assert daemon.stdout is not None
            yield json.loads(daemon.stdout.readline())["url"]
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.wait(START_S)


def verdicts_of(result: Result) -> dict[str, Verdict]:
    """Requirement → verdict."""
    return {one.requirement.id: one.verdict for one in result.requirements}


def test_the_twin_on_usb_conforms(tmp_path: Path) -> None:
    """In all eight requirements of USB, as the kernel carries the reports, in real time."""
    with board(tmp_path) as node:
        port = open_hid(node)
        port.close()
        assert str(port.identity) == "0461h:0020h, reports of 64 bytes in, 64 out"
        verdicts = verdicts_of(judged(None, endpoint=node))
        # On a busy machine a report comes too late now and then to be told from silence: then
        # nothing is said of it, and it is asked again.
        for _ in range(ATTEMPTS):
            if open_ones := [name for name, one in verdicts.items() if one is not Verdict.PASS]:
                assert Verdict.FAIL not in verdicts.values(), verdicts
                verdicts |= verdicts_of(judged(None, *open_ones, endpoint=node))
    assert (len(verdicts), {*verdicts.values()}) == (8, {Verdict.PASS}), verdicts
