"""What to type to say a request of a run again by hand."""

import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from axistwin_conformance.base.events import RunStarted
from axistwin_conformance.base.transcript import Direction

REQUESTS = 2
"""What was done last, and the question that showed it."""

_BUILT_IN = re.compile(r"built-in twin \((.*)\)")


def send_command(run: RunStarted, *requests: str) -> str:
    """The command that sends these requests, as a transcript writes their bytes, to the device."""
    built_in = _BUILT_IN.fullmatch(run.target)
    words = ["axistwin", "send", built_in[1] if built_in else run.target, "--model", run.model]
    rate = run.baud or run.bitrate
    words += ["--baud", str(rate)] if rate else []
    return shlex.join([*words, *requests])


def last_requests(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """The last requests of a transcript; one byte, an acknowledgement, is sent anyway."""
    asked = [each["data"] for each in records if each["direction"] == Direction.HOST.value]
    return [request for request in asked if len(request) > len("06")][-REQUESTS:]
