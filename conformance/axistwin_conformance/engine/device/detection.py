"""The detection phase: the family's probes asked one after another, before what rests on them.

Rules.

1. A probe does no more to the device than its safety classes say, which the plan has checked; the
   family's guard holds it to that, byte by byte.
2. After a probe that moves, the axis is stopped.  What probes store is put back once, at the end.
3. Where bytes may get lost, a probe is asked until two answers agree; where this host or the line
   was late meanwhile, what is unusual needs three, with the very same held up.
4. A second probe of a switch is asked only if the first left something open, and narrows it.
5. A probe without a result is followed by a sanity exchange: a device that is gone ends the phase
   at once, whatever else would still be asked.
6. Once an axis was seen where nothing leads that it was asked for, only what is passive is asked.
7. A reply that no reading admits is given to the device guard, which judges it; then the next
   probe is asked.
"""

from __future__ import annotations

from collections.abc import Iterable

from axistwin_conformance.base.errors import (
    AttemptVoid,
    CannotDo,
    OutsideEnvelope,
    RigError,
    TargetError,
    TwinCrashed,
    interrupts_first,
)
from axistwin_conformance.base.events import QuestionAsked
from axistwin_conformance.core.probing import Probe, Seen
from axistwin_conformance.core.profile import Detection
from axistwin_conformance.core.session import EXCERPT_RECORDS, Run, Session, Stop
from axistwin_conformance.engine.device.device_guard import DeviceGuard
from axistwin_conformance.engine.replays import MOST_ATTEMPTS


def detect(run: Run, probes: Iterable[Probe], device_guard: DeviceGuard) -> None:
    """Ask the probes and put what they tell into `run`; raises TargetError for a lost device."""
    for probe in probes:
        before = run.detections.get(probe.switch)
        if before is not None and before.reading is not None:
            continue
        if run.runaway and probe.check.danger > 0:
            leave_out(run, probe, run.runaway)
            continue
        run.emit(QuestionAsked(probe.switch))
        try:
            detection = _ask_until_believed(run, probe, device_guard)
        except TwinCrashed as error:
            if not device_guard.revive(run):
                raise
            detection = Detection(probe.switch, None, str(error))
        if before is not None and before.candidates:
            detection = _narrowed(run, before, detection)
        run.detections[probe.switch] = detection
        if detection.reading is not None:
            run.readings.setdefault(probe.switch, detection.reading)
        elif not device_guard.is_sane(run):
            raise TargetError(f"it no longer answers after it was asked for {probe.switch}")


def _ask_until_believed(run: Run, probe: Probe, device_guard: DeviceGuard) -> Detection:
    """Ask once; where noise is possible, what is unusual counts when two answers agree."""
    known = dict(run.readings)
    told: list[tuple[tuple[str, ...], tuple[str, ...]]] = []  # answers, and what was late
    why = ""
    for _ in range(MOST_ATTEMPTS):
        run.target.lateness.forget()
        try:
            detection = _ask(run, probe, device_guard)
        except AttemptVoid as error:
            if not device_guard.is_sane(run):
                raise TargetError(f"it was lost while asked for {probe.switch}: {error}") from error
            why = str(error)
            continue
        is_usual = detection.reading == run.ledger.ambiguity_of(probe.switch).default_of(
            probe.switch
        )
        if run.target.too_slow and not is_usual:
            return Detection(probe.switch, None, run.target.too_slow)
        late = tuple(run.target.lateness.recent)
        is_quiet = is_usual and not late and not run.quality.is_noisy
        answer = (detection.candidates, late)
        is_agreed = told.count(answer) > bool(late)
        is_agreed |= is_usual and any(before == detection.candidates for before, _ in told)
        if run.target.is_lossless or is_quiet or is_agreed:
            return detection
        why = "this host or the line was late" if late else why
        told.append(answer)
        run.readings.clear()
        run.readings.update(known)
    text = f"the {run.target.word} is too noisy or too slow to tell ({why or run.quality})"
    return Detection(probe.switch, None, text)


def _narrowed(run: Run, before: Detection, after: Detection) -> Detection:
    """What two looks at the same switch tell together."""
    left = tuple(candidate for candidate in before.candidates if candidate in after.candidates)
    if not left:
        return before
    reading = left[0] if len(left) == 1 else None
    return Detection(before.switch, reading, f"{before.evidence}; {after.evidence}", left)


def leave_out(run: Run, probe: Probe, reason: str) -> None:
    """Record a switch that is not asked for, and why."""
    run.detections[probe.switch] = Detection(probe.switch, None, reason)


def _ask(run: Run, probe: Probe, device_guard: DeviceGuard) -> Detection:
    """Ask once.  What is no answer at all is judged before anything else is said."""
    session = Session(run, probe.check)
    try:
        seen = _look(session, probe, device_guard)
    finally:
        run.target.gate = None
        if probe.check.danger > 0 and not run.target.crash:
            device_guard.run_cleanups(run)
            device_guard.bring_to_rest(run)
    return seen if isinstance(seen, Detection) else _told(run, probe, seen)


def _look(session: Session, probe: Probe, device_guard: DeviceGuard) -> Seen | Detection:
    """What the probe saw, or why it saw nothing."""
    target, act = session.transport, (probe.check.name, probe.check.behaviour)
    target.gate = lambda data: device_guard.guard(session, data)
    try:
        target.drain()
        target.mark(f"detecting {probe.switch}")
        for capability in probe.check.rig_needs:
            session.rig.require(capability)
        with interrupts_first():
            seen = probe.look(session)
        session.run.shown[probe.switch] = session.records(EXCERPT_RECORDS)
        if not seen.readings:
            device_guard.record_violation(session, *act)
        return seen
    except Stop as reason:
        if session.has_failed:
            device_guard.record_violation(session, *act)
        return Detection(probe.switch, None, str(reason))
    except (CannotDo, RigError) as reason:
        return Detection(probe.switch, None, str(reason))
    except OutsideEnvelope as error:
        return Detection(probe.switch, None, error.reason)
    except TwinCrashed:
        device_guard.record_violation(session, *act)
        raise
    except AttemptVoid:
        raise
    except TargetError as error:  # of this question alone, if it still answers others
        if not device_guard.is_sane(session.run):
            raise
        device_guard.record_violation(session, *act)
        return Detection(probe.switch, None, str(error))
    except Exception as error:  # a mistake of the suite must not stop the run
        text = f"error in the suite while detecting {probe.switch}: {type(error).__name__}: {error}"
        device_guard.trouble(text)
        return Detection(probe.switch, None, text)


def _told(run: Run, probe: Probe, seen: Seen) -> Detection:
    """What a look tells of the switch."""
    ambiguity = run.ledger.ambiguity_of(probe.switch)
    for reading in seen.readings:
        ambiguity.check_reading(probe.switch, reading)
    if len(seen.readings) == 1:
        return Detection(probe.switch, seen.readings[0], seen.evidence, seen.readings)
    if not seen.readings:
        return Detection(probe.switch, None, f"fits no reading: {seen.evidence}")
    told = f"{' or '.join(seen.readings)}: {seen.evidence}"
    return Detection(probe.switch, None, told, seen.readings)
