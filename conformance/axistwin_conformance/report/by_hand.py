"""What to type, and to do, to send the requests of a failure again by hand."""

import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

from axistwin_conformance.base.events import RunStarted
from axistwin_conformance.base.transcript import Direction

WORTH_A_WAIT_NS: Final = 2_000_000  # less passes between two requests anyway
LONG_NS: Final = 900_000_000  # what comes later than that, 'axistwin send' does not wait for
LONGEST_NS: Final = 2_500_000_000  # between an earlier exchange and this one nothing counts

STARTS_IN_NS: Final = 1_000_000_000  # until a move to where a check began is over, at least
SLOWEST_INCREMENT_NS: Final = 10_000_000

_FOUND_AT: Final = re.compile(r"\(position\) showed (-?[1-9][0-9]*) increments?$")
_BUILT_IN = re.compile(r"built-in twin \((.*)\)")


def built_in(run: RunStarted) -> str:
    """The URL of the twin that was judged; empty: a device at a port."""
    found = _BUILT_IN.fullmatch(run.target)
    return found[1] if found else ""


def send_command(run: RunStarted, *requests: str, timeout_s: int = 0) -> str:
    """The command that sends these requests, as a transcript writes their bytes, to the device;
    `timeout_s`: the longest wait for a reply, 0 for that of 'axistwin send'."""
    words = ["axistwin", "send", built_in(run) or run.target, "--model", run.model]
    rate = run.baud or run.bitrate
    words += ["--baud", str(rate)] if rate else []
    words += ["--timeout", str(timeout_s)] if timeout_s else []
    return shlex.join([*words, *requests])


def move_to_start(found: Iterable[str]) -> list[str]:
    """What brings an axis to where the check found it; nothing for one that stood at 0."""
    place = next(filter(None, map(_FOUND_AT.search, found)), None)
    if place is None:
        return []
    lasting_ns = STARTS_IN_NS + abs(int(place[1])) * SLOWEST_INCREMENT_NS
    return [f"go to {place[1]}", f"wait {lasting_ns / 1e6:.0f} ms"]


def timeout_s(records: Sequence[Mapping[str, Any]], numbers: Iterable[int]) -> int:
    """How long to wait for the replies to these requests; 0: as long as 'axistwin send' does."""
    slowest_ns = 0
    for number in numbers:
        reply = records[number + 1 : number + 2]
        if reply and reply[0]["direction"] == Direction.DEVICE.value:
            slowest_ns = max(slowest_ns, reply[0]["time_ns"] - records[number]["time_ns"])
    return slowest_ns // 1_000_000_000 + 2 if slowest_ns > LONG_NS else 0


def again(records: Sequence[Mapping[str, Any]], numbers: Sequence[int]) -> list[str]:
    """Those requests of a transcript, with waits between them as long as they were there; what was
    done to the rig, as it says it."""
    steps: list[str] = []
    free_ns = records[numbers[0]]["time_ns"] if numbers else 0
    is_request = False
    for before, number in pairwise((numbers[0] - 1, *numbers) if numbers else ()):
        record = records[number]
        wait_ns = record["time_ns"] - free_ns
        if any(one["direction"] == Direction.NOTE.value for one in records[before + 1 : number]):
            wait_ns = min(wait_ns, LONGEST_NS)
        is_request, was_request = bool(record["data"]), is_request
        if wait_ns > WORTH_A_WAIT_NS and is_request and was_request:
            steps.append(f"wait {wait_ns / 1e6:.0f} ms")
        steps.append(record["data"] or record["text"])
        free_ns = _answered_ns(records, number)
    if numbers and (rest_ns := free_ns - records[numbers[-1]]["time_ns"]) > LONG_NS:
        steps.append(f"wait {rest_ns / 1e6:.0f} ms")  # a message that was not asked for
    return steps


def _answered_ns(records: Sequence[Mapping[str, Any]], number: int) -> int:
    """When what came of a request was there; without an answer, when it was sent."""
    time_ns: int = records[number]["time_ns"]
    for record in records[number + 1 :]:
        if record["direction"] == Direction.HOST.value:
            break
        if record["direction"] == Direction.DEVICE.value:
            time_ns = record["time_ns"]
    return time_ns
