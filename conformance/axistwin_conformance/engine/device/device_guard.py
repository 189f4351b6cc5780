"""The device guard looks after the device during a run: opens it, holds it to what was allowed,
brings it to rest, restores what was changed, asks whether it is still there, and judges what it
says meanwhile.

Rules.

1. What a run may change is read first; where that fails, nothing but passive is done (`remember`).
   Where it turns out later that it was read wrongly, what was not written yet stays as it is, and
   what was is told (`doubt`).
2. The device is brought to rest and put back on every way out.  An interrupt meanwhile ends what
   takes long, and soon all of it; what was not put back then is told.
3. What the operator has named may not be what he took it for: then nothing is judged by it, and the
   device is not blamed (`of_no_use`).
4. The device is judged by what it answers here as well (`record_violation`): in virtual time, where
   nothing gets lost by itself, by every reply; on a real line by the same wrong bytes time after
   time, from a device that otherwise still answers, or by silence twice, each time for as long as
   ends a run, if it still answers something else; or by being elsewhere, where only a command led
   that nobody sent (`seek`).  Other silence, and garbage that never settles, may be the line.
5. A twin in this process that crashed has failed what it was asked for; a fresh one takes its place
   (`revive`), so that one mistake of a twin does not hide the next.
6. An axis that was seen where nothing leads that it was asked for is moved no more; what is passive
   goes on (`_keep_still`).
7. A run ends that takes longer than a sound device ever makes it: what is being judged then stays
   inconclusive, with the reason (`guard`).  A noisy line is given more time, until something has
   failed: what looks like noise then may be the device's doing.
"""

from __future__ import annotations

import contextlib
import math
import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TypeVar

from axistwin_conformance.base import events, interrupts
from axistwin_conformance.base.check import Check
from axistwin_conformance.base.errors import AttemptVoid, CannotDo, RigError, TargetError
from axistwin_conformance.base.events import Listener, Outcome
from axistwin_conformance.base.ledger import Ledger
from axistwin_conformance.base.line_quality import LineQuality, SilenceLimit
from axistwin_conformance.base.transcript import Direction, last_exchange
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.base.write_budget import WriteBudget
from axistwin_conformance.core.family import Violation
from axistwin_conformance.core.session import (
    QUIET_WAIT_S,
    Run,
    Session,
    Stop,
    failure,
)
from axistwin_conformance.engine.attempts import describe
from axistwin_conformance.engine.device import keeping
from axistwin_conformance.engine.device.ladder import Ladder
from axistwin_conformance.engine.eta import HELD_UP, HELD_UP_BY_NOISE
from axistwin_conformance.engine.plan import Options
from axistwin_conformance.engine.result import CheckResult
from axistwin_conformance.transport.transport import Transport

# The last is longer than the 2 s for which a module may be deaf, if each question begins them anew.
SANITY_PAUSES_S = (0.0, 1.0, 2.5)

T = TypeVar("T")
Opener = Callable[[tuple[int, ...]], Transport]  # neighbours on the line → an open target

# What the engine itself asks a device for, beside the probes, and what a sound device does then.
ACTS = {
    "identity": "It says who it is.",
    "survey": "It has what was named for the run.",
    "sanity": "It answers a known-good question between checks.",
    "remember": "It tells what has to be put back after the run.",
    "trial": "It writes what it is told to, and nothing beside.",
    "travel": "It goes where it is told, and no further.",
    "put_back": "It can be brought to rest, and takes back what was changed.",
}


@dataclass(slots=True)
class DeviceGuard:
    """Looks after the device of one run.

    `emit`: takes events.  `blocked`: why nothing more is asked of the device; `passive_only`: why
    nothing but passive is; both empty at first.  `violations`: what the device has failed beside
    the checks.
    """

    options: Options
    ledger: Ledger
    opener: Opener
    emit: Listener
    budget: WriteBudget
    blocked: str = ""
    passive_only: str = ""
    most_s: float = math.inf  # what the run may take on this line; of a noisy one more
    begun_ns: int = 0
    kept: str = ""  # the file that says what the device held
    problems: list[str] = field(default_factory=list)
    has_failed: bool = False  # in a check, or beside them
    is_interrupted: bool = False  # from then on a twin in this process may be anyhow
    violations: list[CheckResult] = field(default_factory=list)
    ladder: Ladder = field(init=False)
    caused: set[str] = field(default_factory=set)  # reasons of which a violation is the cause
    _seen_violations: set[object] = field(default_factory=set)
    _silent_from: int | None = None  # where in the transcript a sanity exchange began in vain
    _tried: dict[str, str] = field(default_factory=dict)  # need → why it is of no use

    def __post_init__(self) -> None:
        self.ladder = Ladder(self.options.family)

    # --- open and close --------------------------------------------------------------------------

    @contextlib.contextmanager
    def opened(self, neighbours: tuple[int, ...]) -> Iterator[Run]:
        """An open target; on the way out it is made safe and closed (rule 2)."""
        run = self._start(neighbours)
        try:
            yield run
        except KeyboardInterrupt:
            self.is_interrupted = True
            raise
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
            quality=LineQuality(most_noise=options.family.transport_kind.most_noise),
            emit=self.emit,
            unshrunk="" if options.shrinks else "only the verdict is wanted",
        )
        self._equip(run)
        return run

    def _equip(self, run: Run) -> None:
        """Give the target its rig, meter and travel guard; raises TargetError without a rig."""
        family, target = self.options.family, run.target
        try:
            run.rig = self.options.rig.open(
                target, run.address, family.rig_controls, self._tell_question
            )
        except RigError as error:
            target.close()
            raise TargetError(str(error)) from error
        target.meter = lambda data: self.budget.note(family.stored_writes(data))
        if run.envelope.is_guarded:
            target.travel_guard = family.travel_guard(run)
        self.ladder.equip(run)

    def _tell_question(self, is_open: bool, text: str) -> None:
        self.emit(events.RigQuestion(is_open, text))

    def _make_safe(self, run: Run) -> None:
        """Stop and put back on the way out, whichever it is, once anything but passive has run."""
        if run.memory is None or run.target.crash:
            return
        tidying = self.options.family.impact.get("end", "put back what it held")
        try:
            self.restore(run, is_leaving=True)
            for sentence in self.options.family.unsure(Session(run), run.memory):
                self.trouble(sentence)
        except interrupts.CutShort:
            self._leave(run, tidying)
        except TargetError as error:
            self.trouble(f"could not {tidying}: {error}{self._remedy}")
        except Exception as error:  # nothing may keep the port from being closed
            self.trouble(f"could not {tidying}: {describe(error)}{self._remedy}")

    def _leave(self, run: Run, tidying: str) -> None:
        """Stop at once, and tell what may not be as it was: nobody waits any longer."""
        try:
            with contextlib.suppress(Exception):
                self.options.family.stop(Session(run))
        finally:  # this is cut short as well
            held = "; ".join([str(run.memory), *(cleanup.what for cleanup in run.cleanups)])
            self.trouble(f"interrupted again, could not {tidying}; it held: {held}{self._remedy}")

    # --- between checks --------------------------------------------------------------------------

    def guard(self, session: Session, data: bytes) -> None:
        """Raise AssertionError for what the check has not declared, CannotDo without a budget, and
        TargetError once the device has held the run up for too long (rule 7)."""
        self._refuse_when_over(session.run)
        family = self.options.family
        if lost := family.would_lose(session, data):
            raise CannotDo(lost)
        reason = family.forbid(session, data)
        assert reason is None, f"held back {data.hex(' ')}: {reason}"
        self.budget.allow(family.stored_writes(data))

    def _refuse_when_over(self, run: Run) -> None:
        passed_s = (run.target.now_ns - self.begun_ns) / 1e9
        quality = run.quality
        is_noise = quality.is_noisy and quality.late <= quality.corrupted
        is_worth_it = is_noise and not quality.is_hopeless and not self.has_failed
        most_s = self.most_s * HELD_UP * (HELD_UP_BY_NOISE if is_worth_it else 1)
        if run.target.is_virtual or passed_s <= most_s:
            return
        if not self.blocked:
            self.block(
                f"the device holds the run up: after {passed_s:.0f} s it is not over, where"
                f" {self.most_s:.0f} s are plenty ({quality})"
            )
        raise TargetError(self.blocked)

    def remember(self, run: Run) -> bool:
        """Read what has to be put back, once; False if that cannot be (rule 1)."""
        if run.memory is not None or self.passive_only:
            return not self.passive_only
        known = len(self.violations)
        try:
            run.memory = self.climbing(run, "remember", self.options.family.remember)
            self._keep(run)
        except TargetError as error:
            reason = f"what is to be put back could not be read: {error}"
            self.passive_only = self.because(reason, known) if self.violations[known:] else reason
            self.trouble(self.passive_only)
            if run.target.crash and not self.revive(run):
                raise
        return not self.passive_only

    def _keep(self, run: Run) -> None:
        """Have what a real device holds in a file before anything is written to it."""
        held = {} if self.options.is_twin else self.options.family.kept(run.memory)
        if not held or self.kept:
            return
        try:
            self.kept = str(keeping.keep(self.options, held))
        except OSError as error:
            self.emit(events.Note(f"what the device holds could not be kept: {error.strerror}"))
            return
        self.emit(
            events.Note(
                f"what the device holds is in {self.kept};"
                f" axistwin conform {self.options.model} --restore FILE puts it back"
            )
        )

    @property
    def _remedy(self) -> str:
        again = f"axistwin conform {self.options.model} --restore {shlex.quote(self.kept)}"
        return f"; {again} puts it back" if self.kept else ""

    def of_no_use(self, run: Run, check: Check) -> str:
        """Why nothing can be judged by what the operator has named for a check; empty: it can be,
        as far as is known.  Each is tried once, by the first check that may write to it."""
        for need in check.needs if check.danger > 0 else ():
            if need in self.options.family.tried_needs and need not in self._tried:
                self._tried[need] = ""
                with contextlib.suppress(TargetError):  # what is wrong then, the check will meet
                    self._try(Session(run), need)
                    self.restore(run)
                if self._tried[need]:
                    self.trouble(self._tried[need])
        return next((why for need in check.needs if (why := self._tried.get(need, ""))), "")

    def _try(self, session: Session, need: str) -> None:
        told = self.options.family.unusable(session, need)
        if isinstance(told, Violation):
            self._record(session, "trial", ACTS["trial"], told)
        else:
            self._tried[need] = told

    def restore(self, run: Run, *, is_leaving: bool = False, before: Check | None = None) -> None:
        """Stop, then put back, also if stopping went wrong; raises TargetError for a lost port.

        `is_leaving`: an exchange may have been interrupted, and its reply still come.  `before`:
        the check that is run next, if nothing else comes between.
        """
        self._release_rig(run)

        def put_back(session: Session) -> None:
            self.run_cleanups(run)
            self._put_back(run, session, is_leaving=is_leaving)
            self.note_retries(session)

        run.next_check = before
        try:
            self.climbing(run, "put_back", put_back, is_blamed=run.target.is_lossless)
        finally:
            run.next_check = None
        if run.runaway:
            self._keep_still(run)

    def bring_to_rest(self, run: Run) -> None:
        """Stop, and nothing else; raises TargetError for a lost port."""
        is_blamed = run.target.is_lossless
        self.climbing(run, "put_back", self.options.family.stop, is_blamed=is_blamed)

    def _keep_still(self, run: Run) -> None:
        """An axis that goes elsewhere than it is told has failed by that, whatever else a check
        made of it, and is asked for nothing but passive any more (rule 6)."""
        guard = run.target.travel_guard
        assert guard is not None
        if guard.runaway in self._seen_violations:
            return
        self._seen_violations.add(guard.runaway)
        self.passive_only = guard.runaway
        self.trouble(guard.runaway)
        if run.target.too_slow:  # for the readings, of which one may explain it
            return
        (requirement,) = self.ledger.own((guard.broken,))
        violation = Violation(requirement, "an axis that goes where it is told", guard.runaway)
        self._record(Session(run), "travel", ACTS["travel"], violation)

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
        family = self.options.family
        try:
            family.stop(session)
            if is_leaving and not run.target.is_virtual:
                run.target.wait_until_quiet(QUIET_WAIT_S)
        finally:
            if not run.target.crash:
                for sentence in family.restore(session, run.memory):
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
        """Whether the device still answers, after the longest deafness it is entitled to; one that
        has said nothing since it did not is not listened for again."""
        if self._silent_from is not None and not self._has_spoken(run, self._silent_from):
            return False

        def look(session: Session) -> bool:
            run.silence_limit.good()  # what was bad before, is not held against this
            self._silent_from = run.target.transcript.position
            for pause_s in SANITY_PAUSES_S:
                run.target.wait(pause_s)
                run.target.drain()
                if self.options.family.is_alive(session):
                    self.note_retries(session)
                    self._silent_from = None
                    return True
            return False

        return self.climbing(run, "sanity", look, is_blamed=run.target.is_lossless)

    @staticmethod
    def _has_spoken(run: Run, since: int) -> bool:
        records = run.target.transcript.since(since)
        return any(record.direction is Direction.DEVICE for record in records)

    def revive(self, run: Run) -> bool:
        """Put a fresh twin in the place of one that crashed; False where there is none (rule 5)."""
        if not self.options.is_twin:
            return False
        crashed = run.target
        crashed.close()
        run.cleanups.clear()
        self._silent_from = None
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

    def doubt(self, run: Run, result: CheckResult) -> None:
        """What was remembered by the answers that have failed here is not known (rule 1)."""
        run.doubted |= {
            last_exchange(finding.transcript)[0]
            for finding in result.findings
            if finding.verdict is Verdict.FAIL
        }

    # --- the ladder ------------------------------------------------------------------------------

    def climbing(
        self, run: Run, act: str, ask: Callable[[Session], T], *, is_blamed: bool = True
    ) -> T:
        """What `ask` returns, asked again as long as what came shows new departures for which
        replies can be mended; where that is over and it raises, or returns False, the device is
        judged by its last reply (`is_blamed`; that of a twin that crashed always is), or by having
        none again, while it answers other requests."""
        was_silent = False
        while True:
            session, trouble = Session(run), None
            before = replace(run.quality)  # what is judged in it makes the line look noisy
            try:
                found = ask(session)
                # What was good in the end may have been asked again for the same departure.
                is_smooth = run.target.is_lossless or not (session.retries or session.corrupted)
                if found is not False and (is_smooth or not self._climbs(session, act, before)):
                    return found
            except TargetError as error:
                trouble = error
            finally:
                self._judge_violations(session, act)
            if self._climbs(session, act, before):
                continue
            is_lost = trouble is not None and act != "sanity"
            silence = self._silence(session) if is_lost else None
            # Perhaps the line was cut for a while, or the device started anew.
            if is_lost and not was_silent and (silence is not None or self._is_back(session)):
                was_silent = True
                continue
            if silence is not None:
                self._accuse(session, act, ACTS[act], silence)
            elif is_blamed or run.target.crash:
                self.record_violation(session, act)
            if trouble is not None:
                raise trouble
            return found

    def _silence(self, session: Session) -> Violation | None:
        """What a device fails that says nothing to the last request and still answers others; what
        comes unasked meanwhile makes no difference."""
        if session.run.target.is_lossless or self.blocked:
            return None
        request, heard = last_exchange(session.records())
        violation = self.options.family.diagnose(session, request, b"")
        if violation != self.options.family.diagnose(session, request, heard):
            return None  # it has answered
        with contextlib.suppress(TargetError):
            return violation if violation and self.is_sane(session.run) else None
        return None

    def _is_back(self, session: Session) -> bool:
        """Whether a device that was lost has answered rightly since."""
        request, reply = last_exchange(session.records())
        if not reply or session.is_reproduced or session.run.target.is_lossless or self.blocked:
            return False
        return self.options.family.diagnose(session, request, reply) is None

    def _judge_violations(self, session: Session, act: str) -> None:
        """Record what has been seen to fail beside all questions, once each."""
        for found in dict.fromkeys(session.run.violations):
            self._accuse(session, act, ACTS[act], Violation(*found))
        session.run.violations.clear()

    def _climbs(self, session: Session, act: str, quality: LineQuality) -> bool:
        """Judge by what the replies of a session depart time after time; True if the same may be
        asked again, since they are mended for that now.  `quality`: of the line before."""
        run, known = session.run, len(self.ladder.known)
        if run.target.crash:
            return False
        needed = 1 if run.target.is_lossless else quality.alike_needed
        for one, steady in self.ladder.climb(session, needed):
            violation = Violation(one.requirement, one.expected, one.actual)
            text = f"beside the checks: {one.name} of {steady.reply.hex(' ').upper()}"
            self._record(session, act, ACTS[act], violation, text)
        is_mended = len(self.ladder.known) > known
        if is_mended:  # it was no noise
            run.quality.corrupted = quality.corrupted
            run.silence_limit.good()
        return is_mended

    def because(self, reason: str, since: int = 0) -> str:
        """A reason why something is not run, with what the device has failed as its cause.

        `since`: how many violations there were before.
        """
        caused = self.violations[since:]
        names = [finding.requirement for one in caused for finding in one.findings]
        failed = list(dict.fromkeys(names))
        told = f"because {', '.join(failed)} fail{'s' * (len(failed) == 1)}: {reason}"
        self.caused.add(told)
        return told

    # --- what is told ----------------------------------------------------------------------------

    def record_violation(self, session: Session, act: str, behaviour: str = "") -> bool:
        """Judge the last reply of a session beside the checks; True if the device failed by it
        (rule 4).  `act`: what it was asked for, one of `ACTS` or the name of a probe."""
        run = session.run
        request, reply = last_exchange(session.records())
        reply = self.ladder.mended(session, request, reply)
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
        if act not in self._seen_violations:
            self._accuse(session, act, behaviour or ACTS[act], violation)
            self._seen_violations.add(act)
        return True

    def _accuse(self, session: Session, act: str, behaviour: str, violation: Violation) -> None:
        """Record a violation once."""
        if violation not in self._seen_violations:
            self._seen_violations.add(violation)
            self._record(session, act, behaviour, violation)

    def _record(
        self,
        session: Session,
        act: str,
        behaviour: str,
        violation: Violation,
        text: str = "beside the checks",
    ) -> None:
        """Tell it as what a check numbered 0 has found: before, between or after the others.  What
        a twin in this process does that was interrupted amid its work is nobody's failure."""
        if self.is_interrupted and session.run.target.is_lossless:
            return
        check = Check.named(act, behaviour, __name__, requirements=(violation.requirement,))
        finding = replace(
            failure(session, violation.requirement, (violation.expected,), violation.actual),
            text=text,
        )
        result = CheckResult(check, Outcome.DONE, (finding,), tuple(session.retries), 0.0, "")
        self.violations.append(result)
        self.has_failed = True
        self.emit(events.CheckStarted(0, 0, act, behaviour, check.requirements))
        self.emit(result.as_event(0, 0, self.options.command))

    def seek(self, run: Run) -> None:
        """Judge a device that answers no more where it was, but elsewhere (rule 4)."""
        if run.target.crash:
            return
        given_up, run.silence_limit = run.silence_limit, SilenceLimit()
        session = Session(run)
        with contextlib.suppress(TargetError):
            if violation := self.options.family.diagnose(session, b"", b""):
                self._accuse(session, "sanity", ACTS["sanity"], violation)
                self.trouble(violation.actual)
        run.silence_limit = given_up  # where it was, nobody waits for it again

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
