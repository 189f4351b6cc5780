"""What to type to send the requests of a failure again by hand."""

import re
import shlex
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

from axistwin_conformance.base.events import RunStarted
from axistwin_conformance.base.transcript import Direction

WORTH_A_WAIT_NS: Final = 10_000_000  # less passes between two requests anyway
LONG_NS: Final = 1_000_000_000  # no reply takes longer

_BUILT_IN = re.compile(r"built-in twin \((.*)\)")


def send_command(run: RunStarted, *requests: str) -> str:
    """The command that sends these requests, as a transcript writes their bytes, to the device."""
    built_in = _BUILT_IN.fullmatch(run.target)
    words = ["axistwin", "send", built_in[1] if built_in else run.target, "--model", run.model]
    rate = run.baud or run.bitrate
    words += ["--baud", str(rate)] if rate else []
    return shlex.join([*words, *requests])


def again(records: Sequence[Mapping[str, Any]], numbers: Sequence[int]) -> list[str]:
    """Those requests of a transcript, with waits between them as long as they were there."""
    steps: list[str] = []
    free_ns = records[numbers[0]]["time_ns"] if numbers else 0
    for before, number in pairwise((numbers[0] - 1, *numbers) if numbers else ()):
        wait_ns = records[number]["time_ns"] - free_ns
        left_out = [n for n in range(before + 1, number) if _is_request(records[n])]
        busy_ns = sum(_answered_ns(records, n) - records[n]["time_ns"] for n in left_out)
        if wait_ns - busy_ns > WORTH_A_WAIT_NS:
            steps.append(f"wait {wait_ns / 1e6:.0f} ms")
        steps.append(records[number]["data"])
        free_ns = _answered_ns(records, number)
    if numbers and (rest_ns := free_ns - records[numbers[-1]]["time_ns"]) > LONG_NS:
        steps.append(f"wait {rest_ns / 1e6:.0f} ms")  # a message that was not asked for
    return steps


def _is_request(record: Mapping[str, Any]) -> bool:
    return record["direction"] == Direction.HOST.value and " " in record["data"].replace("#", " ")


def _answered_ns(records: Sequence[Mapping[str, Any]], number: int) -> int:
    """When what came of a request was there; without an answer, when it was sent."""
    time_ns: int = records[number]["time_ns"]
    for record in records[number + 1 :]:
        if record["direction"] == Direction.HOST.value:
            break
        if record["direction"] == Direction.DEVICE.value:
            time_ns = record["time_ns"]
    return time_ns
