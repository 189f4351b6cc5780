"""One check: run, and where noise is possible run again, until its result can be believed.

Rules.

1. Whatever a check does becomes a result; none of it ends the run.
2. A check that crashes is an error of the suite: inconclusive for all that it names.
3. A twin that crashes in this process is a device that died: all that the check names has failed,
   as far as nothing else was said of it, since nothing but the device can have been the reason.
4. What the travel guard holds back has not been sent: what it was to show is not run.
5. Nothing leaves the suite that the check has not declared, or for which no EEPROM write is left.
"""

from __future__ import annotations

import time
import traceback
from typing import Protocol

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.errors import (
    AttemptVoid,
    CannotDo,
    OutsideEnvelope,
    RigError,
    TargetError,
    TwinCrashed,
    interrupts_first,
)
from axistwin_conformance.base.events import Listener, Outcome
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.session import Run, Session, Stop
from axistwin_conformance.engine.device import ladder
from axistwin_conformance.engine.replays import Attempt, Replays
from axistwin_conformance.engine.result import CheckResult


class AttemptGuard(Protocol):
    """Who looks after the device between attempts."""

    def guard(self, session: Session, data: bytes) -> None:
        """Raise for bytes that must not be sent."""

    def restore(self, run: Run) -> None:
        """Bring the device to rest and put back what was changed."""

    def is_sane(self, run: Run) -> bool:
        """Whether the device still answers."""


class Attempts:
    """Runs checks.

    `emit`: who is told of sampled motion.  `device_guard`: who looks after the device.
    """

    def __init__(self, emit: Listener, device_guard: AttemptGuard) -> None:
        self._emit, self._guard = emit, device_guard

    def believed(self, run: Run, check: Check) -> CheckResult:
        """Run a check, where noise is possible as often as its result needs to be believed."""
        if run.target.is_lossless:
            return self._attempt(run, check).result
        known = dict(run.readings)

        def attempt(is_strict: bool) -> Attempt:
            run.readings.clear()
            run.readings.update(known)
            return self._attempt(run, check, is_strict=is_strict)

        def tidy() -> bool:
            try:
                if check.danger > 0:
                    self._guard.restore(run)
                return self._guard.is_sane(run) and not run.runaway
            except TargetError:
                return False  # found again, and told, when the check is over

        result = Replays(attempt, tidy, run.quality).conclude()
        if run.target.too_slow and result.verdict in (Verdict.FAIL, Verdict.QUIRK):
            run.readings.clear()
            run.readings.update(known)
            return result.withdrawn(run.target.too_slow)
        return result

    def _attempt(self, run: Run, check: Check, *, is_strict: bool = False) -> Attempt:
        """Run the check's function; whatever it does becomes a result."""
        session = Session(run, check)
        session.is_strict |= is_strict
        known = dict(run.readings)
        run.target.lateness.forget()
        started = time.monotonic()
        outcome, trouble, verdict, disturbance = self._run(session, check)
        for motion in session.motions.kept:
            self._emit(motion)
        for path in session.motions.paths:
            self._emit(path)
        findings = ladder.unproven(run, session.conclude(trouble, verdict))
        seconds = time.monotonic() - started
        result = CheckResult(
            check, outcome, findings, tuple(session.retries), seconds, trouble, session.recording
        )
        learnt = {
            switch: reading
            for switch, reading in run.readings.items()
            if switch not in known and reading != run.ledger.ambiguity_of(switch).default_of(switch)
        }
        return Attempt(
            result, disturbance, learnt, session.is_strict, tuple(session.corrupted),
            session.failed_after, session.is_replayed, tuple(run.target.lateness.recent),
        )  # fmt: skip

    def _run(self, session: Session, check: Check) -> tuple[Outcome, str, Verdict, str]:
        """Run the check; give how it ended, what befell it, what is then said of all that it has
        not judged, and what was corrupted on the way."""
        target, disturbance = session.transport, ""
        outcome, trouble, verdict = Outcome.DONE, "", Verdict.INCONCLUSIVE
        target.gate = lambda data: self._guard.guard(session, data)
        try:
            target.drain()
            ladder.read_as_fits(session.run, check)
            target.mark(f"check {check.name}")
            for capability in check.rig_needs:  # it may have turned out since that it cannot
                session.rig.require(capability)
            with interrupts_first():
                check(session)
        except Stop:
            pass
        except CannotDo as error:
            outcome, trouble, verdict = Outcome.LEFT_OUT, str(error), Verdict.NOT_RUN
        except AttemptVoid as error:
            outcome, trouble, disturbance = Outcome.TROUBLE, f"disturbed: {error}", str(error)
        except OutsideEnvelope as error:
            outcome, trouble, verdict = Outcome.LEFT_OUT, error.reason, Verdict.NOT_RUN
        except TwinCrashed as error:
            outcome, trouble, verdict = Outcome.TROUBLE, str(error), Verdict.FAIL
        except (TargetError, RigError) as error:
            outcome, trouble = Outcome.TROUBLE, str(error)
        except Exception as error:  # rule 2: a mistake of the suite must not stop the run
            outcome, trouble = Outcome.ERROR, describe(error)
        finally:
            target.gate = None
            ladder.read_as_fits(session.run)
        return outcome, trouble, verdict, disturbance


def describe(error: Exception) -> str:
    """The crash in one line: what, and the place in the suite where it happened."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({frames[-1].name}, line {frames[-1].lineno})" if frames else ""
    text = " ".join(str(error).split())
    return f"error in the suite: {type(error).__name__}: {text}{place}"
