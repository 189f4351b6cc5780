"""What to type, and to do, to send the requests of a failure again by hand."""

import math
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum, auto
from itertools import groupby, pairwise
from typing import Any, Final, NamedTuple

from axistwin_conformance.base.transcript import Direction
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.wording import RIG
from axistwin_conformance.families.catalog import families
from axistwin_conformance.report.failures import Statement
from axistwin_conformance.transport.rig import act_done

WORTH_A_WAIT_NS: Final = 2_000_000  # less passes between two requests anyway
LONG_NS: Final = 900_000_000  # what comes later than that, 'axistwin send' does not wait for
MARGIN_NS: Final = 500_000_000  # what comes unasked may come a little later than it did
HAND_MS: Final = 20_000  # within which somebody has done what is to be done to the device
WAIT: Final = "wait "
GO: Final = "go to "
LONGEST_NS: Final = 2_500_000_000  # between an earlier exchange and this one nothing counts

CONTROL: Final = "127.0.0.1:8080"  # where 'axistwin ctl' looks for a daemon

_BUILT_IN: Final = re.compile(r"built-in twin \((.*)\)")
_PROGRAM: Final = re.compile(r"[?&]program=([^&]+)")


class Part(Enum):
    """What a line of the instructions is."""

    WORDS = auto()
    ACT = auto()  # to be done to the device
    COMMAND = auto()  # to be typed
    REMARK = auto()
    PORT = auto()  # a remark that is worth saying once


class Instruction(NamedTuple):
    """One line of what to do by hand."""

    part: Part
    text: str


def instructions(run: Mapping[str, Any], one: Statement) -> Iterator[Instruction]:
    """How to see it again without the suite: the same on terminal, page and build server; `run`:
    as the report has it."""
    steps = again(one.transcript, one.by_hand)
    if not steps:
        if one.no_hand:
            yield Instruction(Part.WORDS, one.no_hand)
        return
    steps = [*(each["data"] or each["text"] for each in one.before), *steps]
    place = built_in(run)
    if place and _is_judged_alone(run["model"], one.check):
        place = place.replace(",".join(_twins(place)), _twins(place)[0], 1)
        run = {**run, "target": place}
    longest_s = timeout_s(one.transcript, one.by_hand)
    is_worked = any(map(_is_act, steps))
    if is_worked:
        yield Instruction(Part.WORDS, f"{one.no_hand}:")
        if place:  # the URL would open another twin for each of these lines
            yield Instruction(Part.WORDS, "to see it on a twin, in another terminal:")
            yield Instruction(Part.COMMAND, _start_of_twin(place))
            run = {**run, "target": f"./{run['model']}", "twin": _twins(place)[0]}
            place = run["target"]
    parts = [(is_act, [*some]) for is_act, some in groupby(steps, _is_act)]
    if is_worked and not parts[-1][0] and all(step.startswith(WAIT) for step in parts[-1][1]):
        yield from _worked_while_listening(run, parts, longest_s)
    else:
        yield from _in_turn(run, parts, longest_s)
    if one.no_hand and not is_worked:
        yield Instruction(Part.REMARK, one.no_hand)
    if one.by_hand[1:]:
        last = one.transcript[one.by_hand[-1]]
        words = last["decoded"] or last["text"].removeprefix(RIG)
        yield Instruction(Part.REMARK, f"the last step is the one that failed: {words}")
    if place:
        twin = "; 'axistwin run' and 'ctl' are for a twin" if is_worked else ""
        yield Instruction(Part.PORT, f"for a device, put its port in the place of {place}{twin}")


def _in_turn(
    run: Mapping[str, Any], parts: Iterable[tuple[bool, Sequence[str]]], timeout_s: int
) -> Iterator[Instruction]:
    """What to do to the device and what to send it, one after the other."""
    for is_act, steps in parts:
        if is_act:
            yield from (one for step in steps for one in _acts(run, step.removeprefix(RIG)))
        else:
            yield Instruction(Part.COMMAND, send_command(run, *steps, timeout_s=timeout_s))


def _acts(run: Mapping[str, Any], clause: str) -> Iterator[Instruction]:
    """What to do so that this is done: in words, and the command that does it to a twin."""
    family = _family(run["model"])
    act = act_done(family.rig_controls, clause) if family else None
    yield Instruction(Part.ACT, clause if act is None else act.order)
    if act is not None and act.value is not None and "twin" in run:
        name, value = act.of_twin()
        shown = [] if value is None else [act.words[2] if value is act.value else str(value)]
        yield Instruction(Part.COMMAND, shlex.join(["axistwin", "ctl", run["twin"], name, *shown]))


def _family(model: str) -> Family | None:
    """None: the report is of a suite that knows more models."""
    return next((family for family in families() if model in family.models), None)


def _is_judged_alone(model: str, name: str) -> bool:
    """True if the built-in twin has no neighbour in that check."""
    family = _family(model)
    checks = family.checks() if family else ()
    return any(check.name == name and "alone" in check.needs for check in checks)


def _twins(url: str) -> list[str]:
    """The devices of a built-in twin, as 'axistwin run' and 'axistwin ctl' call them."""
    return url.partition(":")[2].partition("?")[0].strip("/").split(",")


def _start_of_twin(url: str) -> str:
    """The command that serves those twins, so that they can be worked."""
    program = _PROGRAM.search(url)
    more = ["--program", program[1]] if program else []
    return shlex.join(["axistwin", "run", *_twins(url), *more, "--control", CONTROL])


def _worked_while_listening(
    run: Mapping[str, Any], parts: Sequence[tuple[bool, Sequence[str]]], timeout_s: int
) -> Iterator[Instruction]:
    """The same where what comes of the last act comes unasked: the one who listens is there first,
    and for longer than a hand takes."""
    *before, act, (_, waits) = parts
    yield from _in_turn(run, before, timeout_s)
    listened_ms = sum(float(one.split()[1]) for one in waits) + HAND_MS
    yield Instruction(
        Part.WORDS, f"start this first, and go on while it listens ({HAND_MS / 1000:.0f} s):"
    )
    yield Instruction(Part.COMMAND, send_command(run, f"{WAIT}{listened_ms:.15g} ms"))
    yield from _in_turn(run, [act], timeout_s)


def _is_act(step: str) -> bool:
    return step.startswith(RIG)


def in_lines(run: Mapping[str, Any], one: Statement) -> Iterator[str]:
    """The same as plain text."""
    for number, (part, text) in enumerate(instructions(run, one)):
        label = "" if number else "by hand: "
        shown = {Part.ACT: f"now: {text}", Part.REMARK: f"({text})", Part.PORT: f"({text})"}
        yield f"{label}{shown.get(part, text)}"


def built_in(run: Mapping[str, Any]) -> str:
    """The URL of the twin that was judged; empty: a device at a port."""
    found = _BUILT_IN.fullmatch(run["target"])
    return found[1] if found else ""


def send_command(run: Mapping[str, Any], *requests: str, timeout_s: int = 0) -> str:
    """The command that sends these requests, as a transcript writes their bytes, to the device;
    `timeout_s`: the longest wait for a reply, 0 for that of 'axistwin send'."""
    words = ["axistwin", "send", built_in(run) or run["target"], "--model", run["model"]]
    rate = run["baud"] or run["bitrate"]
    words += ["--baud", str(rate)] if rate else []
    words += ["--timeout", str(timeout_s)] if timeout_s else []
    family = _family(run["model"])
    is_elsewhere = family is not None and run["address"] not in (None, family.default_address)
    if is_elsewhere and any(step.startswith(GO) for step in requests):  # bytes hold theirs
        words += ["--address", str(run["address"])]
    return shlex.join([*words, *requests])


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
        is_request, was_request = bool(record["data"]), is_request
        wait_ns = record["time_ns"] - free_ns
        if any(one["direction"] == Direction.NOTE.value for one in records[before + 1 : number]):
            wait_ns = min(wait_ns, LONGEST_NS)
        # Whoever works a device takes time; but it may be long until it is there again.
        if is_request and wait_ns > (WORTH_A_WAIT_NS if was_request else LONG_NS):
            steps.append(f"{WAIT}{round(wait_ns / 1e6, 1):.15g} ms")
        steps.append(record["data"] or record["text"])
        free_ns = _answered_ns(records, number) if is_request else record["time_ns"]
    if numbers and (rest_ns := _rest_ns(records, numbers[-1])) > LONG_NS:
        rest_ms = math.ceil((rest_ns + MARGIN_NS) / 1e8) * 100
        steps.append(f"{WAIT}{rest_ms} ms")  # a message that was not asked for
    return steps


def _rest_ns(records: Sequence[Mapping[str, Any]], number: int) -> int:
    """How long after a request, or after something was done, the last came that came of it."""
    began_ns: int = records[number]["time_ns"]
    return _answered_ns(records, number) - began_ns


def _answered_ns(records: Sequence[Mapping[str, Any]], number: int) -> int:
    """When what came of a request was there; without an answer, when it was sent."""
    time_ns: int = records[number]["time_ns"]
    for record in records[number + 1 :]:
        if record["direction"] == Direction.HOST.value:
            break
        if record["direction"] == Direction.DEVICE.value:
            time_ns = record["time_ns"]
    return time_ns
