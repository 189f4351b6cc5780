"""`--restore FILE`: a device gets back what an earlier run found; nothing else is done to it."""

from __future__ import annotations

from pathlib import Path

from axistwin_conformance.base import events
from axistwin_conformance.base.errors import TargetError, WrongDevice
from axistwin_conformance.base.events import Listener
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.write_budget import WriteBudget
from axistwin_conformance.core.session import Session
from axistwin_conformance.engine.device import keeping
from axistwin_conformance.engine.device.device_guard import DeviceGuard, Opener
from axistwin_conformance.engine.judgement import CONFORMS, FAILS, UNREACHABLE
from axistwin_conformance.engine.plan import Options
from axistwin_conformance.transport.transport import Transport


def put_back(options: Options, path: Path, emit: Listener, opener: Opener | None = None) -> int:
    """Put back what the file says; the exit status: 0, 1 if something is still another, 3 for a
    device that does not answer.  Raises UsageError for a file that says nothing."""
    family = options.family
    kept = keeping.load(path, options.model)
    memory = keeping.understood(path, kept, family.memory_of)

    def opened(neighbours: tuple[int, ...]) -> Transport:
        return family.open(options.url, options.rate, is_builtin=options.is_builtin)

    budget = WriteBudget(options.settings.eeprom_budget)
    guard = DeviceGuard(options, load_ledger(family.name), opener or opened, emit, budget)
    try:
        with guard.opened(options.neighbours) as run:
            emit(events.Note(family.identify(Session(run)).summary))
            run.memory = memory  # what a run remembers is put back on its way out
    except (TargetError, WrongDevice) as error:
        emit(events.Note(f"nothing was put back: {error}"))
        return UNREACHABLE
    if not guard.problems:
        emit(events.Note(f"the device holds again what {path} says"))
    return FAILS if guard.problems else CONFORMS
