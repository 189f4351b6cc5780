"""Talks to twins of every model for a day of virtual time, over wires with random faults.

What is said are the random sequences of the suite's soak, each held against the model of its
family.  The status is 1 if a twin departed from it, if one of the checks held in no round, or if
memory has grown by more than 8 MiB after the first tenth.  Of each model a line tells how long it
was, how many messages and faults there were, how much memory the process has taken at the start and
at each quarter, and a digest of all messages with their times: the same seed has the same digest.
Ctrl-C ends it, with what was found until then.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import re
import resource
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import serial

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "conformance" / "tests"))

from bus_in_front import BITRATE, twin_bus  # noqa: E402
from small_scratch import small_scratch  # noqa: E402

from axistwin.catalog import models  # noqa: E402
from axistwin.kernel.time import NS_PER_S  # noqa: E402
from axistwin.runtime.transcript import Message  # noqa: E402
from axistwin.wire.faults import FaultAct  # noqa: E402
from axistwin.wire.wire_fault import FAULT_TYPES, Wire  # noqa: E402
from axistwin_conformance.base.events import Event, SoakProgress  # noqa: E402
from axistwin_conformance.base.verdicts import Verdict  # noqa: E402
from axistwin_conformance.cli import make_options  # noqa: E402
from axistwin_conformance.engine.plan import Options  # noqa: E402
from axistwin_conformance.engine.result import Result  # noqa: E402
from axistwin_conformance.engine.run import Engine  # noqa: E402
from axistwin_conformance.families.catalog import find_family  # noqa: E402
from axistwin_conformance.families.mac.can import codec  # noqa: E402
from axistwin_conformance.transport.can import CanTransport  # noqa: E402
from axistwin_conformance.transport.kinds import BUS  # noqa: E402
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport  # noqa: E402
from axistwin_conformance.transport.transport import Transport  # noqa: E402

HOURS = 24.0
GROWTH_MAX_MIB = 8.0
INTERRUPTED = 130
# So rarely that most attempts of a check are spared: what noise hits is tried again, not judged.
CHANCES = (0.00003, 0.0001, 0.0003)
RATES_PER_S = (0.001, 0.002)
NOT_NOTICED = {"can": ("corrupt",)}
"""A host cannot notice that a frame was changed whose checksum is right: it is what was said."""
QUIET_WIRE = frozenset({"many_runs_of_the_machine_agree_with_the_model"})
"""Hypothesis draws these by what is answered; over a faulty wire the suite leaves them out."""


@dataclass
class FaultyLine:
    """The lines of one model, one after the other, and what went over them."""

    options: Options
    seed: int
    messages: int = 0
    passed_ns: int = 0
    digest: Any = field(default_factory=hashlib.sha256)
    memory_mib: list[float] = field(default_factory=list)
    opened: int = 0
    acted: Counter[str] = field(default_factory=Counter)

    def open(self, neighbours: tuple[int, ...]) -> Transport:
        """A twin on a wire with faults."""
        options, number = self.options, self.seed + self.opened
        family = options.family
        url = f"{family.twin_url(options.model, options.address, neighbours)}&seed={number}"
        port: Any
        target: Transport
        if family.transport_kind is BUS:
            port = twin_bus(url)
            target = CanTransport(
                port, url, is_spontaneous=codec.is_spontaneous, bitrate=BITRATE, is_builtin=True,
                is_lossless=False,
            )  # fmt: skip
        else:
            rate = options.rate or family.default_rate
            assert rate is not None
            port = serial.serial_for_url(url, baudrate=rate)
            target = SerialTransport(port, url, is_builtin=True, is_lossless=False)
        spoil(port.line.faults, "can" if family.transport_kind is BUS else "serial", number)
        latest_ns = 0  # each line has a clock of its own

        def hear(message: Message) -> None:
            nonlocal latest_ns
            self.passed_ns += message.time_ns - latest_ns
            latest_ns = message.time_ns
            self.messages += 1
            self.digest.update(f"{latest_ns} {message.direction} {message.content!r}".encode())

        port.line.subscribe_messages(hear)
        port.line.subscribe_faults(self.count)
        self.opened += 1
        return target

    def count(self, act: FaultAct) -> None:
        """Count what a fault did."""
        self.acted[act.kind] += 1

    def seconds(self) -> float:
        """How long all lines have been spoken on."""
        return self.passed_ns / NS_PER_S

    def look(self, event: Event) -> None:
        """Note the memory after each round."""
        if isinstance(event, SoakProgress):
            self.memory_mib.append(memory_mib())


def memory_mib() -> float:
    """What this process has of the machine's memory now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def spoil(faults: Any, wire: Wire, seed: int) -> None:
    """Have every kind of fault of ``wire``, as often as the seed says."""
    drawn = random.Random(seed)
    for kind, fault in FAULT_TYPES.items():
        if wire not in fault.wires or kind in NOT_NOTICED.get(wire, ()):
            continue
        if fault.comes or not fault.chooses:
            faults.add(kind, per_s=drawn.choice(RATES_PER_S))
        else:
            faults.add(kind, chance=drawn.choice(CHANCES))


def soak(model: str, seed: int, hours: float) -> bool:
    """Talk to a model and tell what came of it; whether all was well."""
    family = find_family(model)
    soaking = (check.name for check in family.checks() if check.soaks)
    drawing = tuple(name for name in soaking if name not in QUIET_WIRE)
    wanted: dict[str, Any] = {"level": "soak", "duration": hours * 3600, "seed": seed}
    options = make_options(model=model, ids=drawing, **wanted, **small_scratch(model))
    line = FaultyLine(options, seed)
    result = Engine(options, line.open, line.seconds).run(line.look)
    held = {name: rounds_held(result, name) for name in drawing}
    never_judged = [f"{name} held in no round" for name, count in held.items() if not count]
    wrong = [
        f"{finding.requirement} in {check.check.name}: {finding.sentence or finding.text}"
        for check in result.checks
        for finding in check.findings
        if finding.verdict in (Verdict.FAIL, Verdict.QUIRK)
    ]
    sizes = line.memory_mib or [memory_mib()]
    first, last = sizes[len(sizes) // 10], sizes[-1]
    quarters = " ".join(f"{sizes[(len(sizes) - 1) * part // 4]:.1f}" for part in range(5))
    print(
        f"{model}: {line.seconds() / 3600:.2f} h, {len(sizes)} rounds, {line.messages} messages,"
        f" each check held in {min(held.values())} or more, {line.acted.total()} faults,"
        f" memory {quarters} MiB, digest {line.digest.hexdigest()[:16]}: {result.sentence}",
        flush=True,
    )
    print("".join(f"  {kind} {count}" for kind, count in sorted(line.acted.items())), flush=True)
    for text in dict.fromkeys([*wrong, *never_judged, *result.problems, result.lost]):
        if text:
            print(f"  {text}", flush=True)
    is_done = line.seconds() >= hours * 3600 and not (result.lost or result.problems)
    if result.is_interrupted:
        raise KeyboardInterrupt
    return is_done and not (wrong or never_judged) and last - first < GROWTH_MAX_MIB


def rounds_held(result: Result, name: str) -> int:
    """In how many rounds a check held, as its summary tells."""
    told = (
        re.fullmatch(r"held in (\d+) rounds", finding.text)
        for check in result.checks
        if check.check.name == f"{name}-soak"
        for finding in check.findings
    )
    return max((int(each[1]) for each in told if each), default=0)


def main() -> int:
    """Soak the models that are named."""
    parser = argparse.ArgumentParser(description=__doc__, prog="scripts/soak")
    parser.add_argument("seed", type=int)
    parser.add_argument("models", nargs="*", metavar="MODEL", help="all without it")
    parser.add_argument("--hours", type=float, default=HOURS, help=f"of each (default {HOURS:g})")
    options = parser.parse_args()
    known = list(models())
    if unknown := set(options.models) - set(known):
        parser.error(f"no model is named {', '.join(sorted(unknown))}; known: {', '.join(known)}")
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    try:
        done = [soak(model, options.seed, options.hours) for model in options.models or known]
    except KeyboardInterrupt:
        return INTERRUPTED
    return int(not all(done))


if __name__ == "__main__":
    raise SystemExit(main())
