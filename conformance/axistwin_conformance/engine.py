"""The engine: runs a plan safely against a target and says what it means.

    open → probe (identity) → sanity → round trip → detection (of the readings) → checks, each
    followed by [stop, put back] and sanity → sanity → stop, put back → close

What detection must do destructively comes right before the first check of that class.

Rules.

1. Nothing but passive checks runs before the device's parameters have been read and remembered.
2. Whatever happens (a crash of a check, a lost port, Ctrl-C), the device is stopped and its
   parameters are put back before the port is closed; further interrupts wait for that.
3. A check that crashes is an error of the suite: reported, counted as inconclusive, the others run.
4. When the device does not answer a sanity exchange, not even after the longest deafness it is
   entitled to, the rest is blocked.  What the last check said is withdrawn, since a lost device
   and a wrong one look the same; in virtual time nothing gets lost by itself, so there it stands.
"""

from __future__ import annotations

import contextlib
import itertools
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib import metadata

from axistwin_conformance import events
from axistwin_conformance.armed import load_armed
from axistwin_conformance.attempts import Attempts, describe
from axistwin_conformance.budget import WriteBudget
from axistwin_conformance.detection import detect, leave_out
from axistwin_conformance.errors import RigError, TargetError, WrongDevice
from axistwin_conformance.events import Listener, Outcome
from axistwin_conformance.judgement import CheckResult, RequirementResult, conclude
from axistwin_conformance.ledger import load_ledger
from axistwin_conformance.plan import Options, Plan, make_plan
from axistwin_conformance.profile import Detection, Probe, deviations
from axistwin_conformance.registry import Check
from axistwin_conformance.session import Envelope, Run, Session
from axistwin_conformance.targets import Target, open_target
from axistwin_conformance.verdicts import Finding, Verdict

__all__ = ["Engine", "Envelope", "Options", "Result", "Session"]

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SANITY_PAUSES_S = (0.0, 1.0, 1.5)  # together longer than the 2 s for which a module may be deaf
ROUND_TRIPS = 20

Opener = Callable[[tuple[int, ...]], Target]  # neighbours on the line → an open target


@dataclass(slots=True)
class Result:
    """All that a run found out."""

    options: Options
    plan: Plan
    checks: list[CheckResult] = field(default_factory=list)
    requirements: tuple[RequirementResult, ...] = ()
    problems: list[str] = field(default_factory=list)
    readings: Mapping[str, str] = field(default_factory=dict)  # switch → the reading seen
    detections: Mapping[str, Detection] = field(default_factory=dict)  # what the probes told
    deviations: list[str] = field(default_factory=list)  # from the profile the user gave
    refusal: str = ""  # why the device was not judged at all: unreachable, or not the model
    is_interrupted: bool = False
    exit_status: int = 0
    sentence: str = ""


class Engine:
    """One run: construct, `plan()` to look, `run()` once."""

    def __init__(self, options: Options, opener: Opener | None = None) -> None:
        self.options = options
        self.family = options.family
        self.ledger = load_ledger(options.family.ledger)
        self._opener = opener or self._open
        self._emit: Listener = lambda event: None
        self._blocked = ""
        self._budget = WriteBudget(options.eeprom_budget)
        self._attempts = Attempts(self._tell, self._budget, self._settle, self._is_sane)
        self._result = Result(options, self.plan())

    def plan(self) -> Plan:
        """Return what will run and what will not; raises UsageError for a word without a match."""
        return make_plan(self.options, self.ledger, self.family.checks(), self.family.probes())

    def run(self, on_event: Listener) -> Result:
        """Run the plan.  Never raises for what the device, the port or a check does."""
        self._emit = on_event
        result = self._result
        started = time.monotonic()
        self._announce()
        if result.plan.to_run or self.options.is_only_detection:
            self._run_on_target()
        if self.options.expected is not None:
            result.deviations = deviations(self.options.expected, result.detections, self.ledger)
        if self._budget.spent:
            self._emit(events.Note(f"stored memory: {self._budget}"))
        conclude(result, self.ledger)
        self._tell_readings()
        armed = load_armed(self.family.ledger)
        for one in result.requirements:
            self._emit(one.as_event(armed))
        counts = dict.fromkeys(Verdict, 0)
        for one in result.requirements:
            counts[one.verdict] += 1
        problems = tuple(result.problems)
        seconds = time.monotonic() - started
        self._emit(
            events.RunFinished(result.exit_status, result.sentence, counts, problems, seconds)
        )
        return result

    def _tell(self, event: events.Event) -> None:
        self._emit(event)

    def _announce(self) -> None:
        options, plan = self.options, self._result.plan
        self._emit(
            events.RunStarted(
                suite_version=metadata.version("axistwin"),
                started_at=datetime.now(UTC).isoformat(timespec="seconds"),
                command=options.command,
                model=options.model,
                target=options.url if options.port else f"built-in twin ({options.url})",
                baud=options.baud,
                address=options.address,
                neighbours=options.neighbours,
                allowed=tuple(sorted(options.allowed)),
                level=options.level,
                seed=options.seed,
                max_travel=options.envelope.max_travel,
                max_speed=options.envelope.max_speed,
                checks=tuple(check.name for check in plan.to_run),
                left_out={check.name: reason for check, reason in plan.left_out},
            )
        )

    def _tell_readings(self) -> None:
        """Emit what the device was seen to make of the manual's open questions."""
        for switch, reading in sorted(self._result.readings.items()):
            one = self.ledger.ambiguity_of(switch)
            detection = self._result.detections.get(switch)
            evidence = detection.evidence if detection and detection.reading else "seen by a check"
            self._emit(
                events.ReadingSeen(
                    switch, reading, one.default_of(switch), one.id, one.question, one.departs,
                    evidence,
                )
            )  # fmt: skip
        for switch, detection in sorted(self._result.detections.items()):
            if switch not in self._result.readings:
                one = self.ledger.ambiguity_of(switch)
                self._emit(events.ReadingUnknown(switch, one.id, one.question, detection.evidence))

    # The target's life.

    def _open(self, neighbours: tuple[int, ...]) -> Target:
        url = replace(self.options, neighbours=neighbours).url
        return open_target(url, self.options.baud, is_builtin=self.options.is_builtin)

    def _run_on_target(self) -> None:
        result = self._result
        try:
            with self._opened(self.options.neighbours) as run:
                self._identify(run)
                for probe, reason in result.plan.unprobed:
                    leave_out(run, probe, reason)
                self._detect(run, is_destructive=False)
                if self.options.is_only_detection:
                    self._detect(run, is_destructive=True)
                self._run_checks(run)
                self._last_words(run)
        except WrongDevice as error:
            result.refusal = str(error)
        except TargetError as error:
            result.refusal = f"device unreachable: {error}"
        except KeyboardInterrupt:
            result.is_interrupted = True
        except Exception as error:  # in a hook of the family; checks are caught one by one
            self._trouble(describe(error))

    @contextlib.contextmanager
    def _opened(self, neighbours: tuple[int, ...]) -> Iterator[Run]:
        """An open target; on the way out it is made safe and closed (rule 2)."""
        run = self._start(neighbours)
        try:
            yield run
        finally:
            with _uninterrupted():
                self._make_safe(run)
                run.target.close()

    def _start(self, neighbours: tuple[int, ...]) -> Run:
        target = self._opener(neighbours)
        options = self.options
        try:
            rig = options.rig.open(target, options.address, self._tell_question)
        except RigError as error:
            target.close()
            raise TargetError(str(error)) from error
        run = Run(
            target=target,
            family=self.family,
            model=self.family.models[options.model],
            ledger=self.ledger,
            address=options.address,
            neighbours=neighbours,
            allowed=options.allowed,
            envelope=options.envelope,
            seed=options.seed,
            rig=rig,
        )
        run.budget = self._budget
        target.meter = lambda data: self._budget.note(self.family.writes(data))
        if self.family.fence is not None and options.envelope.is_fenced:
            target.fence = self.family.fence(run)
        return run

    def _tell_question(self, is_open: bool, text: str) -> None:
        self._emit(events.RigQuestion(is_open, text))

    def _identify(self, run: Run) -> None:
        target, session = run.target, Session(run)
        # What is learnt from here on, kept on any way out.
        self._result.readings, self._result.detections = run.readings, run.detections
        run.identity = self.family.probe(session)
        if not self.family.sanity(session):
            raise TargetError("it answered once and then no more")
        # Virtual time has no jitter: three exchanges show what twenty would.
        samples = 3 if target.is_virtual else ROUND_TRIPS
        trip = target.measure_round_trip(lambda: self.family.sanity(session), samples)
        self._note_retries(session)
        identity = run.identity
        self._emit(
            events.Identified(identity.summary, identity.values, trip.median_ns, trip.max_ns)
        )

    # Detection.

    @property
    def detections(self) -> tuple[Detection, ...]:
        """What is known of every switch after the run, what checks have seen included."""
        result = self._result
        told = []
        for one in result.detections.values():
            seen = result.readings.get(one.switch)
            if one.reading is None and seen is not None:
                one = replace(one, reading=seen, evidence="seen by a check")
            told.append(one)
        return tuple(told)

    def _detect(self, run: Run, *, is_destructive: bool) -> None:
        """Ask the probes that are (not) destructive; those that need the module alone on its line
        get a line of their own where that is possible (built-in twin)."""
        mine = [
            probe
            for probe in self._result.plan.probes
            if ("destructive" in probe.check.safety) is is_destructive
        ]
        if is_destructive and run.quality.is_noisy and not run.target.is_lossless:
            for probe in mine:
                leave_out(run, probe, f"too risky on a noisy line: {run.quality}")
            return
        for is_alone, row in itertools.groupby(mine, lambda one: "alone" in one.check.needs):
            if is_alone and run.neighbours:
                with self._opened(()) as other:
                    self._inherit(other, run)
                    self._ask(other, list(row))
            else:
                self._ask(run, list(row))

    def _detect_late(self, run: Run) -> None:
        """Ask the destructive probes amid the checks: what is lost there, ends no run."""
        try:
            self._detect(run, is_destructive=True)
        except TargetError as error:
            self._block(str(error))

    def _ask(self, run: Run, probes: list[Probe]) -> None:
        if run.memory is None and any(probe.check.danger > 0 for probe in probes):
            run.memory = self.family.remember(Session(run))
        detect(run, probes, self._attempts.guard, self._is_sane, self._trouble)
        if run.memory is not None:
            self._settle(run)

    @staticmethod
    def _inherit(other: Run, run: Run) -> None:
        """Let a run on another line know, and tell, what is known on this one."""
        other.identity, other.target.round_trip = run.identity, run.target.round_trip
        other.quality = run.quality
        other.readings, other.detections = run.readings, run.detections

    def _last_words(self, run: Run) -> None:
        if not self._blocked and not self._is_sane(run):
            self._trouble("the device did not answer the closing sanity exchange")
        if run.quality.spoilt:
            self._emit(events.Note(f"noise on the line: {run.quality}"))

    def _make_safe(self, run: Run) -> None:
        """Stop and put back on the way out, whichever it is, once anything but passive has run."""
        if run.memory is None:
            return
        try:
            self._settle(run)
        except TargetError as error:
            self._trouble(f"could not stop the axis or put its parameters back: {error}")
        except Exception as error:  # nothing may keep the port from being closed
            self._trouble(f"could not stop the axis or put its parameters back: {describe(error)}")

    # Checks.

    def _run_checks(self, run: Run) -> None:
        checks = self._result.plan.to_run
        is_detected = False
        for number, check in enumerate(checks, 1):
            if "destructive" in check.safety and not is_detected and not self._blocked:
                is_detected = True
                self._detect_late(run)
            self._emit(
                events.CheckStarted(
                    number, len(checks), check.name, check.behaviour, check.requirements
                )
            )
            if self._blocked:
                result = self._blocked_result(check)
            else:
                result = self._run_one(run, check)
            self._result.checks.append(result)
            self._emit(result.as_event(number, len(checks), self.options.replay(check)))

    def _run_one(self, run: Run, check: Check) -> CheckResult:
        if "alone" in check.needs and run.neighbours:
            return self._run_alone(run, check)
        if check.danger > 0 and run.memory is None:
            try:
                run.memory = self.family.remember(Session(run))
            except TargetError as error:
                self._block(f"the parameters to put back could not be read: {error}")
                return self._blocked_result(check)
        if "destructive" in check.safety and run.quality.is_noisy and not run.target.is_lossless:
            return self._left_out(check, f"too risky on a noisy line: {run.quality}")
        result = self._attempts.believed(run, check)
        try:
            if check.danger > 0:
                self._settle(run)
            is_sane = self._is_sane(run)
        except TargetError as error:
            is_sane = False
            result = replace(result, trouble=result.trouble or str(error))
        except Exception as error:  # what cannot be put back must not be followed by more
            self._block(describe(error))
            return result
        if not is_sane:
            self._block(f"the device no longer answers after {check.name}")
            result = result if run.target.is_lossless else result.withdrawn(self._blocked)
        return result

    def _run_alone(self, run: Run, check: Check) -> CheckResult:
        """Run a check that needs the module alone on a line of its own (built-in twin only)."""
        with self._opened(()) as other:
            self._inherit(other, run)
            return self._run_one(other, check)

    # Between checks.

    def _settle(self, run: Run) -> None:
        """Stop, then put back, also if stopping went wrong; raises TargetError for a lost port."""
        session = Session(run)
        was_disturbed = run.rig is not None and run.rig.is_disturbed
        self._release_rig(run)
        try:
            self.family.stop(session)
            if was_disturbed and run.target.fence is not None:
                run.target.fence.forget()
        finally:
            for sentence in self.family.restore(session, run.memory):
                self._trouble(f"not put back: {sentence}")
        self._note_retries(session)

    def _release_rig(self, run: Run) -> None:
        """Bring the rig to rest, the axis before it: what is let go must not drive on."""
        if run.rig is None or not run.rig.is_disturbed:
            return
        try:
            with contextlib.suppress(TargetError):
                self.family.stop(Session(run))
        finally:
            try:
                run.rig.reset()
            except RigError as error:
                self._block(str(error))

    def _is_sane(self, run: Run) -> bool:
        session = Session(run)
        for pause_s in SANITY_PAUSES_S:
            run.target.wait(pause_s)
            run.target.drain()
            if self.family.sanity(session):
                self._note_retries(session)
                return True
        return False

    def _block(self, reason: str) -> None:
        self._blocked = reason
        self._trouble(reason)

    def _blocked_result(self, check: Check) -> CheckResult:
        findings = tuple(
            Finding(name, Verdict.INCONCLUSIVE, f"not started: {self._blocked}")
            for name in check.requirements
        )
        return CheckResult(check, Outcome.BLOCKED, findings, (), 0.0, self._blocked)

    def _left_out(self, check: Check, reason: str) -> CheckResult:
        findings = tuple(Finding(name, Verdict.NOT_RUN, reason) for name in check.requirements)
        return CheckResult(check, Outcome.LEFT_OUT, findings, (), 0.0, reason)

    def _trouble(self, text: str) -> None:
        self._result.problems.append(text)
        self._emit(events.Note(text))

    def _note_retries(self, session: Session) -> None:
        for text in session.retries:
            self._emit(events.Note(f"between checks, asked again: {text}"))


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Hold back Ctrl-C and termination while the device is made safe (bounded by time-outs)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in ENDING_SIGNALS}
    for number in before:
        signal.signal(number, signal.SIG_IGN)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
