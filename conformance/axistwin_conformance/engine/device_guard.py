"""The device guard looks after the device during a run: opens it, holds it to what was allowed,
brings it to rest, restores what was changed, asks whether it is still there, and judges what it
says meanwhile.

Rules.

1. What a run may change is read first; where that fails, nothing but passive is done (`remember`).
2. The device is brought to rest and put back on every way out.  An interrupt meanwhile ends what
   takes long, and soon all of it; what was not put back then is told.
3. What the operator has named may not be what he took it for: then nothing is judged by it, and the
   device is not blamed (`of_no_use`).
4. The device is judged by what it answers here as well (`record_violation`): in virtual time, where
   nothing gets lost by itself, by every reply; on a real line by the same wrong bytes time after
   time, from a device that otherwise still answers.  Silence, and garbage that never settles, may
   be the line.
5. A twin in this process that crashed has failed what it was asked for; a fresh one takes its place
   (`revive`), so that one mistake of a twin does not hide the next.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

from axistwin_conformance.base import events, interrupts
from axistwin_conformance.base.check import Check
from axistwin_conformance.base.errors import AttemptVoid, RigError, TargetError, TwinCrashed
from axistwin_conformance.base.events import Listener, Outcome
from axistwin_conformance.base.ledger import Ledger
from axistwin_conformance.base.transcript import last_exchange
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.base.write_budget import WriteBudget
from axistwin_conformance.core.family import Violation
from axistwin_conformance.core.session import EXCERPT_RECORDS, QUIET_WAIT_S, Run, Session, Stop
from axistwin_conformance.engine.attempts import describe
from axistwin_conformance.engine.plan import Options
from axistwin_conformance.engine.result import CheckResult
from axistwin_conformance.transport.transport import Transport

SANITY_PAUSES_S = (0.0, 1.0, 1.5)  # together longer than the 2 s for which a module may be deaf

Opener = Callable[[tuple[int, ...]], Transport]  # neighbours on the line → an open target

# What the engine itself asks a device for, beside the probes, and what a sound device does then.
ACTS = {
    "identity": "It says who it is.",
    "sanity": "It answers a known-good question between checks.",
    "remember": "It tells what has to be put back after the run.",
    "put_back": "It can be brought to rest, and takes back what was changed.",
}


@dataclass(slots=True)
class DeviceGuard:
    """Looks after the device of one run.

    `emit`: takes events.  `blocked`: why nothing more is asked of the device; `unremembered`: why
    nothing but passive is; both empty at first.  `violations`: what the device has failed beside
    the checks.
    """

    options: Options
    ledger: Ledger
    opener: Opener
    emit: Listener
    budget: WriteBudget
    blocked: str = ""
    unremembered: str = ""
    problems: list[str] = field(default_factory=list)
    violations: list[CheckResult] = field(default_factory=list)
    _seen_violations: set[object] = field(default_factory=set)
    _tried: dict[str, str] = field(default_factory=dict)  # need → why it is of no use

    # --- open and close --------------------------------------------------------------------------

    @contextlib.contextmanager
    def opened(self, neighbours: tuple[int, ...]) -> Iterator[Run]:
        """An open target; on the way out it is made safe and closed (rule 2)."""
        run = self._start(neighbours)
        try:
            yield run
        finally:
            with interrupts.held_back():
                self._make_safe(run)
                run.target.close()

    def _start(self, neighbours: tuple[int, ...]) -> Run:
        options = self.options
        run = Run(
            target=self.opener(neighbours),
            family=options.family,
            model=options.family.models[options.model],
            ledger=self.ledger,
            address=options.address,
            neighbours=neighbours,
            allowed=options.allowed,
            envelope=options.settings.envelope,
            settings=options.settings,
            seed=options.seed,
            budget=self.budget,
            emit=self.emit,
        )
        self._equip(run)
        return run

    def _equip(self, run: Run) -> None:
        """Give the target its rig, meter and travel guard; raises TargetError without a rig."""
        family, target = self.options.family, run.target
        try:
            run.rig = self.options.rig.open(target, run.address, self._tell_question)
        except RigError as error:
            target.close()
            raise TargetError(str(error)) from error
        target.meter = lambda data: self.budget.note(family.stored_writes(data))
        if run.envelope.is_guarded:
            target.travel_guard = family.travel_guard(run)

    def _tell_question(self, is_open: bool, text: str) -> None:
        self.emit(events.RigQuestion(is_open, text))

    def _make_safe(self, run: Run) -> None:
        """Stop and put back on the way out, whichever it is, once anything but passive has run."""
        if run.memory is None or run.target.crash:
            return
        tidying = self.options.family.tidying
        try:
            self.restore(run, is_leaving=True)
        except interrupts.CutShort:
            self._leave(run, tidying)
        except TargetError as error:
            self.trouble(f"could not {tidying}: {error}")
        except Exception as error:  # nothing may keep the port from being closed
            self.trouble(f"could not {tidying}: {describe(error)}")

    def _leave(self, run: Run, tidying: str) -> None:
        """Stop at once, and tell what may not be as it was: nobody waits any longer."""
        try:
            with contextlib.suppress(Exception):
                self.options.family.stop(Session(run))
        finally:  # this is cut short as well
            held = "; ".join([str(run.memory), *(cleanup.what for cleanup in run.cleanups)])
            self.trouble(f"interrupted again, could not {tidying}; it held: {held}")

    # --- between checks --------------------------------------------------------------------------

    def guard(self, session: Session, data: bytes) -> None:
        """Raise AssertionError for what the check has not declared, CannotDo without a budget."""
        family = self.options.family
        reason = family.forbid(session, data)
        assert reason is None, f"held back {data.hex(' ')}: {reason}"
        self.budget.allow(family.stored_writes(data))

    def remember(self, run: Run) -> bool:
        """Read what has to be put back, once; False if that cannot be (rule 1)."""
        if run.memory is not None or self.unremembered:
            return not self.unremembered
        session = Session(run)
        try:
            run.memory = self.options.family.remember(session)
        except TargetError as error:
            self.unremembered = f"what is to be put back could not be read: {error}"
            self.trouble(self.unremembered)
            self.record_violation(session, "remember")
            if run.target.crash and not self.revive(run):
                raise
        return not self.unremembered

    def of_no_use(self, run: Run, check: Check) -> str:
        """Why nothing can be judged by what the operator has named for a check; empty: it can be,
        as far as is known.  Each is tried once, by the first check that may write to it."""
        for need in check.needs if check.danger > 0 else ():
            if need in self.options.family.tried_needs and need not in self._tried:
                self._tried[need] = ""
                with contextlib.suppress(TargetError):  # what is wrong then, the check will meet
                    self._tried[need] = self.options.family.unusable(Session(run), need)
                    self.restore(run)
                if self._tried[need]:
                    self.trouble(self._tried[need])
        return next((why for need in check.needs if (why := self._tried.get(need, ""))), "")

    def restore(self, run: Run, *, is_leaving: bool = False) -> None:
        """Stop, then put back, also if stopping went wrong; raises TargetError for a lost port.

        `is_leaving`: an exchange may have been interrupted, and its reply still come.
        """
        session = Session(run)
        self._release_rig(run)
        try:
            self.run_cleanups(run)
            self._put_back(run, session, is_leaving=is_leaving)
        except TargetError:
            if run.target.is_lossless:
                self.record_violation(session, "put_back")
            raise
        self.note_retries(session)
        if run.runaway and not self.blocked:
            self.block(run.runaway)

    def run_cleanups(self, run: Run) -> None:
        """Give back what a check or probe still owes: only then the device hears anything else."""
        while run.cleanups and not run.target.crash:
            cleanup, is_back, why = run.cleanups[-1], False, ""
            try:
                is_back = cleanup.restore()
            except (Stop, AttemptVoid) as error:
                why = f": {error}"
            if not is_back:
                self.trouble(f"not put back: {cleanup.what}{why}")
            run.cleanups.remove(cleanup)

    def _put_back(self, run: Run, session: Session, *, is_leaving: bool) -> None:
        try:
            self.options.family.stop(session)
            if is_leaving and not run.target.is_virtual:
                run.target.wait_until_quiet(QUIET_WAIT_S)
        finally:
            if not run.target.crash:
                for sentence in self.options.family.restore(session, run.memory):
                    self.trouble(f"not put back: {sentence}")

    def _release_rig(self, run: Run) -> None:
        """Bring the rig to rest, the axis before it: what is let go must not drive on."""
        if run.rig is None or not run.rig.is_disturbed:
            return
        try:
            with contextlib.suppress(TargetError):
                self.options.family.stop(Session(run))
        finally:
            try:
                run.rig.reset()
            except RigError as error:
                self.block(str(error))

    def is_sane(self, run: Run) -> bool:
        """Whether the device still answers, after the longest deafness it is entitled to."""
        session = Session(run)
        try:
            for pause_s in SANITY_PAUSES_S:
                run.target.wait(pause_s)
                run.target.drain()
                if self.options.family.is_alive(session):
                    self.note_retries(session)
                    return True
        except TwinCrashed:
            self.record_violation(session, "sanity")
            raise
        if run.target.is_lossless:
            self.record_violation(session, "sanity")
        return False

    def revive(self, run: Run) -> bool:
        """Put a fresh twin in the place of one that crashed; False where there is none (rule 5)."""
        if not self.options.is_twin:
            return False
        crashed = run.target
        crashed.close()
        run.cleanups.clear()
        try:
            run.target = self.opener(run.neighbours)
            self._equip(run)
            run.target.round_trip = crashed.round_trip
            if run.memory is not None:
                run.memory = self.options.family.remember(Session(run))
            is_back = self.is_sane(run)
        except TargetError:
            return False
        if is_back:
            self.emit(events.Note(f"{crashed.crash}; a fresh twin takes its place"))
        return is_back

    # --- what is told ----------------------------------------------------------------------------

    def record_violation(self, session: Session, act: str, behaviour: str = "") -> bool:
        """Judge the last reply of a session beside the checks; True if the device failed by it
        (rule 4).  `act`: what it was asked for, one of `ACTS` or the name of a probe."""
        run = session.run
        request, reply = last_exchange(session.records())
        is_surely_its_own = run.target.crash or run.target.is_lossless
        if not is_surely_its_own and not (reply and session.is_reproduced and self.is_sane(run)):
            return False
        violation = self.options.family.diagnose(
            session, request, None if run.target.crash else reply
        )
        if violation is None:
            if run.target.crash:
                self.trouble(run.target.crash)
            return False
        if run.target.crash:
            violation = replace(violation, actual=run.target.crash)
        if violation not in self._seen_violations and act not in self._seen_violations:
            self._seen_violations |= {violation, act}
            self._record(session, act, behaviour or ACTS[act], violation)
        return True

    def _record(self, session: Session, act: str, behaviour: str, violation: Violation) -> None:
        """Tell it as what a check numbered 0 has found: before, between or after the others."""
        check = Check.named(act, behaviour, __name__, requirements=(violation.requirement,))
        finding = Finding(
            violation.requirement, Verdict.FAIL, "beside the checks", (violation.expected,),
            violation.actual, session.records(EXCERPT_RECORDS),
        )  # fmt: skip
        result = CheckResult(check, Outcome.DONE, (finding,), tuple(session.retries), 0.0, "")
        self.violations.append(result)
        self.emit(events.CheckStarted(0, 0, act, behaviour, check.requirements))
        self.emit(result.as_event(0, 0, self.options.command))

    def block(self, reason: str) -> None:
        """Ask nothing more of the device in this run."""
        self.blocked = reason
        self.trouble(reason)

    def trouble(self, text: str) -> None:
        """Take note of a reason not to trust the run that belongs to no requirement; the same one
        after many checks is one problem."""
        if text not in self.problems:
            self.problems.append(text)
        self.emit(events.Note(text))

    def note_retries(self, session: Session) -> None:
        """Tell what had to be asked again beside the checks."""
        for text in session.retries:
            self.emit(events.Note(f"between checks, asked again: {text}"))
