"""The judge of automatic mutants: runs the black-box suite on the twins that PYTHONPATH offers.

Started by scripts/mutate in a process of its own, which a mutant may crash or keep busy for ever.
Arguments: what to do (`judge` or `reach`), the stages as JSON, for `reach` the folder of the twins
and the files of it that matter, as JSON.
Prints one line of JSON: for `judge` what was said first, for `reach` the executed lines per file,
each with the checks that have executed it.
"""

from __future__ import annotations

import functools
import json
import os
import resource
import signal
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from types import FrameType
from typing import Any

Stages = Sequence[tuple[str, str, Sequence[str]]]  # see scripts/mutate.py

CRASHED = "the built-in twin crashed"  # how the suite words it
MEMORY_BYTES = 4 << 30
CHECK_S = 12.0  # of processor time, several times what the longest check of healthy twins needs

crashes: list[str] = []  # exceptions that have left the twins


def watch(owner: type) -> None:
    """Note every exception that leaves a public method or property of a class of the twins."""
    for base in owner.__bases__:
        if base.__module__.startswith("axistwin."):
            watch(base)
    for name, value in list(vars(owner).items()):
        if name.startswith("_") and name != "__init__":
            continue
        if isinstance(value, property):
            get, put = (part and _watched(part) for part in (value.fget, value.fset))
            setattr(owner, name, property(get, put))
        elif callable(value) and not isinstance(value, type):
            setattr(owner, name, _watched(value))


def _watched(function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def watched(*args: Any, **named: Any) -> Any:
        try:
            return function(*args, **named)
        except Exception as error:
            crashes.append(f"{type(error).__name__}: {error}")
            raise

    return watched


def say(outcome: str, **more: Any) -> None:
    """Print the opinion and end the process: what is said first counts."""
    print(json.dumps({"outcome": outcome, **more}), flush=True)
    os._exit(0)


def allot() -> None:
    """Give the process another `CHECK_S` to live; a check that takes longer will never end."""
    signal.setitimer(signal.ITIMER_PROF, CHECK_S)


def options_of(model: str, level: str, checks: Sequence[str] = ()) -> Any:
    """The options of a run of all or these checks against the built-in twin `MODEL[:ADDRESS]`."""
    from axistwin_conformance.cli import make_options

    name, _, address = model.partition(":")
    at = int(address) if address else None
    options = make_options(model=name, level=level, address=at, ids=tuple(checks))
    return replace(options, shrinks=False)


def judge(stages: Stages) -> None:
    """Run stage after stage until something is said; `passed` if nothing is."""
    from axistwin.devices.mac.can.device import MacCan
    from axistwin.devices.mac.serial.device import MacSerial
    from axistwin.devices.mn400.device import Mn400Board
    from axistwin.devices.msc.controller import MscController
    from axistwin.runtime.bus import Bus
    from axistwin.runtime.line import Line
    from axistwin_conformance.engine.run import Engine

    for owner in (MacSerial, MscController, Mn400Board, Line, MacCan, Bus):
        watch(owner)
    readings: list[str] = []
    unsettled: list[str] = []
    for model, level, checks in stages:
        listener = _Listener(f"{model} {level}")
        allot()
        result = Engine(options_of(model, level, checks)).run(listener.hear)
        listener.heed_crash(result.refusal)
        if result.refusal:
            say("refused", stage=listener.stage, text=result.refusal)
        if result.exit_status:
            unsettled.append(f"{listener.stage}: {result.sentence}")
        readings += [f"{model}: {reading}" for reading in listener.readings]
        if listener.readings:  # another reading in one stage is enough
            break
    say("unsettled" if unsettled else "passed", readings=readings, text="; ".join(unsettled))


class _Listener:
    """Hears the events of one run."""

    def __init__(self, stage: str) -> None:
        self.stage = stage
        self.readings: list[str] = []  # other than the default

    def hear(self, event: Any) -> None:
        """Take an event of the suite."""
        from axistwin_conformance.base.events import CheckFinished, ReadingSeen
        from axistwin_conformance.base.verdicts import Verdict

        if isinstance(event, ReadingSeen) and event.reading != event.default:
            self.readings.append(f"{event.switch}={event.reading}")
        if not isinstance(event, CheckFinished):
            return
        allot()
        said = {"stage": self.stage, "check": event.name}
        self.heed_crash(event.trouble, **said)
        for one in event.findings:
            if one.verdict is Verdict.FAIL:
                self.heed_crash(one.text, **said)
                came = "" if one.actual is None else f" (came: {one.actual})"
                say("killed", **said, requirement=one.requirement, text=one.text + came)

    def heed_crash(self, text: str, **said: str) -> None:
        """A crash of the twins counts apart, whatever is judged after it."""
        if crashes or CRASHED in text:
            say("crash", **({"stage": self.stage} | said), text=crashes[0] if crashes else text)


def reach(stages: Stages, root: str, paths: Iterable[str]) -> None:
    """Print which lines of these files of the twins the stages have them execute, and in which
    checks; in none what only an import, a probe or what is between the checks executes."""
    reached: dict[str, set[tuple[int, str]]] = {}
    followers: dict[str, Callable[..., Any]] = {}
    chosen = {f"{root}/{path}" for path in paths}
    running = ""  # the check

    def hear(event: Any) -> None:
        nonlocal running
        if isinstance(event, CheckStarted | CheckFinished):
            running = event.name if isinstance(event, CheckStarted) else ""

    def follower(name: str) -> Callable[..., Any]:
        lines = reached.setdefault(name, set())

        def follow(frame: FrameType, event: str, arg: object) -> Callable[..., Any]:
            lines.add((frame.f_lineno, running))
            return follow

        return follow

    def trace(frame: FrameType, event: str, arg: object) -> Callable[..., Any] | None:
        name = frame.f_code.co_filename
        if name not in chosen:
            return None
        if name not in followers:
            followers[name] = follower(name[len(root) + 1 :])
        return followers[name](frame, event, arg)  # type: ignore[no-any-return]

    sys.settrace(trace)
    from axistwin_conformance.base.events import CheckFinished, CheckStarted
    from axistwin_conformance.engine.run import Engine

    for stage in stages:
        Engine(options_of(*stage)).run(hear)
    sys.settrace(None)
    print(json.dumps({name: by_line(lines) for name, lines in reached.items()}))


def by_line(reached: Iterable[tuple[int, str]]) -> dict[int, list[str]]:
    """Line → the checks that have executed it."""
    table: dict[int, list[str]] = defaultdict(list)
    for line, check in sorted(reached):
        table[line] += [check] if check else []
    return table


def main(arguments: Iterable[str]) -> None:
    """Do what the arguments say."""
    what, stages, *rest = arguments
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    if what == "reach":
        root, paths = rest
        reach(json.loads(stages), root, json.loads(paths))
    else:
        judge(json.loads(stages))


if __name__ == "__main__":
    main(sys.argv[1:])
