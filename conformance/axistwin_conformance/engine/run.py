"""The engine: runs a plan safely against a target and says what it means.

    open → probe (identity) → sanity → round trip → survey (of what was named)
         → detection (of the readings) → checks, each followed by [stop, put back] and sanity
         → sanity → stop, put back → close

What detection must do destructively comes right before the first check of that class.

Rules.

1. Nothing but passive checks runs before the device's parameters have been read and remembered.
2. Whatever happens (a crash of a check, a lost port, Ctrl-C), the device is stopped and its
   parameters are put back before the port is closed; a further interrupt hurries that.
3. A check that crashes is an error of the suite: reported, counted as inconclusive, the others run.
   A twin of this process that crashes fails what was asked of it; the run goes on with a fresh one.
4. A device that answers wrongly while nobody judges (who are you, which reading, what is to be put
   back) fails the requirement it breaks, and the run goes on as far as it can (`device_guard`).
5. When the device does not answer a sanity exchange, not even after the longest deafness it is
   entitled to, the rest is blocked.  What the last check said is withdrawn, since a lost device
   and a wrong one look the same; in virtual time nothing gets lost by itself, so there it stands.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from importlib import metadata

from axistwin_conformance.base import events, interrupts
from axistwin_conformance.base.armed import load_armed
from axistwin_conformance.base.check import Check
from axistwin_conformance.base.errors import TargetError, TwinCrashed, UsageError, WrongDevice
from axistwin_conformance.base.events import Listener, Outcome
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.base.write_budget import WriteBudget
from axistwin_conformance.core.probing import Probe
from axistwin_conformance.core.profile import Detection, held_to
from axistwin_conformance.core.session import Envelope, Run, Session
from axistwin_conformance.engine.attempts import Attempts, describe
from axistwin_conformance.engine.device.detection import detect, leave_out
from axistwin_conformance.engine.device.device_guard import DeviceGuard, Opener
from axistwin_conformance.engine.eta import most_s
from axistwin_conformance.engine.impact import allowed_in_vain
from axistwin_conformance.engine.jobs import Jobs
from axistwin_conformance.engine.judgement import conclude, profile_sentence
from axistwin_conformance.engine.plan import Options, Plan, make_plan
from axistwin_conformance.engine.result import CheckResult, Result
from axistwin_conformance.engine.soak import Soak
from axistwin_conformance.transport.kinds import BUS, LINE
from axistwin_conformance.transport.transport import RoundTrip, Transport

__all__ = ["Engine", "Envelope", "Options", "Session"]

ROUND_TRIPS = 20
ECHO = "what is sent comes back as it was: switch off the local echo of the adapter"
MEANWHILE = 20  # checks: fewer are over before another process has even started


class Engine:
    """One run: construct, `plan()` to look, `run()` once.

    `soak_clock`: seconds by which a soak lasts.
    """

    def __init__(
        self,
        options: Options,
        opener: Opener | None = None,
        soak_clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.options = options
        self._soak_clock = soak_clock
        self.family = options.family
        self.ledger = load_ledger(options.family.name)
        self._emit: Listener = lambda event: None
        self._budget = WriteBudget(options.settings.eeprom_budget)
        self._guard = DeviceGuard(
            options, self.ledger, opener or self._open, self._tell, self._budget
        )
        self._is_identified = False
        self._attempts = Attempts(self._tell, self._guard)
        # A worker opens what this run opens, and has its word for the writes it may ask for.
        is_shared = opener is None and options.is_builtin and options.settings.eeprom_budget is None
        self._cores = options.jobs if is_shared else 1
        self._jobs = Jobs(self._cores - 1, self._note)  # on one of them, this process is busy
        self._result = Result(options, self.plan(), problems=self._guard.problems)
        self._unasked = list(self._result.plan.unneeded)

    def plan(self) -> Plan:
        """Return what will run and what will not; raises UsageError for a word without a match."""
        return make_plan(self.options, self.ledger, self.family.checks(), self.family.probes())

    def run(self, on_event: Listener) -> Result:
        """Run the plan.  Never raises for what the device, the port or a check does."""
        self._emit = on_event
        result = self._result
        started = time.monotonic()
        try:
            self._announce()
            if result.plan.to_run or (self.options.is_only_detection and result.plan.probes):
                self._run_on_target()
        except KeyboardInterrupt:  # before there was a target, or one more while one was answered
            result.is_interrupted = True
        interrupts.run_is_over()
        if self.options.expected is not None:
            result.profile = held_to(
                self.options.profile, self.options.expected, result.detections, self.ledger
            )
        result.checks[:0] = self._guard.violations
        result.lost = self._guard.blocked
        conclude(result, self.ledger)
        self._tell_readings()
        if result.profile is not None:
            self._emit(result.profile)
        armed = load_armed(self.family.name)
        for requirement in result.requirements:
            self._emit(requirement.as_event(armed))
        self._finish(time.monotonic() - started)
        return result

    def _finish(self, seconds: float) -> None:
        result, counts = self._result, dict.fromkeys(Verdict, 0)
        for requirement in result.requirements:
            counts[requirement.verdict] += 1
        if result.profile is not None:
            counts[result.profile.verdict] += 1
        finished = events.RunFinished(
            result.exit_status, result.sentence, counts, tuple(result.problems), seconds,
            self._budget.spent, self._budget.limit,
        )  # fmt: skip
        self._emit(finished)

    def _tell(self, event: events.Event) -> None:
        self._emit(event)

    def _note(self, text: str) -> None:
        self._emit(events.Note(text))

    def _announce(self) -> None:
        options, plan = self.options, self._result.plan
        bounds = options.settings.envelope
        self._emit(
            events.RunStarted(
                suite_version=metadata.version("axistwin"),
                started_at=datetime.now(UTC).isoformat(timespec="seconds"),
                command=options.command,
                model=options.model,
                target=f"built-in twin ({options.url})" if options.is_builtin else options.url,
                carrier=options.family.transport_kind.word,
                baud=options.rate if options.family.transport_kind is LINE else None,
                bitrate=options.rate if options.family.transport_kind is BUS else None,
                address=options.address,
                neighbours=options.neighbours,
                allowed=tuple(sorted(options.allowed)),
                level=options.level,
                seed=options.seed,
                max_travel=bounds.max_travel or None,
                max_speed=bounds.max_speed or None,
                checks=tuple(check.name for check in plan.to_run),
                left_out={check.name: reason for check, reason in plan.left_out},
                grounds=options.settings.named,
                questions=len(plan.probes),
            )
        )
        if in_vain := allowed_in_vain(options):
            self._note(in_vain)

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

    def _open(self, neighbours: tuple[int, ...]) -> Transport:
        url = replace(self.options, neighbours=neighbours).url
        return self.family.open(url, self.options.rate, is_builtin=self.options.is_builtin)

    def _run_on_target(self) -> None:
        result = self._result
        try:
            with self._guard.opened(self.options.neighbours) as run:
                self._prepare(run)
                self._run_checks(run)
                self._soak(run)
                self._last_words(run)
        except WrongDevice as error:
            result.refusal = str(error)
        except UsageError as error:  # what was named for the run, is not there
            result.refusal, result.is_misused = str(error), True
        except TargetError as error:
            told = "lost before anything was judged" if self._is_identified else "unreachable"
            result.refusal = f"device {told}: {error}"
        except KeyboardInterrupt:
            result.is_interrupted = True
        except Exception as error:  # in a hook of the family; checks are caught one by one
            self._guard.trouble(describe(error))
        finally:
            self._jobs.close()

    def _prepare(self, run: Run) -> None:
        """Identity and readings; a device that fails and is lost by it, is judged all the same."""
        try:
            self._identify_unless_echoed(run)
            self._survey(run)
            for probe, reason in self._result.plan.unprobed:
                leave_out(run, probe, reason)
            checks = self._result.plan.to_run
            self._detect(run, self._probes(is_destructive=False), checks[0] if checks else None)
            if self.options.is_only_detection:
                self._detect(run, self._probes(is_destructive=True))
        except (TargetError, UsageError) as error:  # what it has failed is not hidden by either
            if self._is_identified and isinstance(error, TargetError):
                self._guard.seek(run)
            if not (self._guard.violations or self._guard.blocked):
                raise
            if not self._guard.blocked:
                self._guard.block(self._guard.because(str(error)))

    def _survey(self, run: Run) -> None:
        """Look at what was named; a device that does not answer that, but answers else, is judged
        as it would be with nothing named."""
        try:
            self._guard.climbing(run, "survey", self.family.preflight)
        except TargetError:
            if run.target.crash or not self._guard.is_sane(run):
                raise

    def _identify_unless_echoed(self, run: Run) -> None:
        """Say so if nobody can be identified because we hear ourselves."""
        try:
            self._identify(run)
        except TwinCrashed:
            raise
        except (TargetError, WrongDevice) as error:
            if self.family.transport_kind is LINE and run.target.transcript.has_echo:
                raise TargetError(ECHO) from error
            raise

    def _identify(self, run: Run) -> None:
        target = run.target
        # What is learnt from here on, kept on any way out.
        self._result.readings, self._result.detections = run.readings, run.detections
        run.identity = self._guard.climbing(run, "identity", self.family.identify, is_blamed=False)
        if not self._guard.is_sane(run):
            raise TargetError("it answered once and then no more")
        self._meet_neighbours(run)
        # Virtual time has no jitter: three exchanges show what twenty would.
        samples = 3 if target.is_virtual else ROUND_TRIPS

        def measured(session: Session) -> RoundTrip:
            trip = target.measure_round_trip(lambda: self._is_sound(session), samples)
            self._guard.note_retries(session)
            return trip

        trip = self._guard.climbing(run, "identity", measured, is_blamed=False)
        self._bound(target, trip.median_ns)
        if not target.is_virtual:
            known_ms = target.uncertainty_ns / 1e6
            self._note(
                f"instants are known to within {known_ms:.0f} ms: a shorter delay is not seen"
            )
        identity, self._is_identified = run.identity, True
        self._emit(
            events.Identified(identity.summary, identity.values, trip.median_ns, trip.max_ns)
        )

    def _bound(self, target: Transport, trip_ns: int) -> None:
        """Say how long the run may take from now on, unless somebody else works its rig."""
        if self.options.rig.kind in ("prompt", "command"):
            return
        bounds = self.options.settings.envelope
        weight_s = self.family.models[self.options.model].weight_s
        most = most_s(self._result.plan, bounds, trip_ns, weight_s)
        most += self.options.duration_s or 0
        self._guard.begun_ns, self._guard.most_s = target.now_ns, most

    def _is_sound(self, session: Session) -> bool:
        """One good exchange; what had to be asked again tells nothing of how long one takes."""
        asked_again = len(session.retries)
        return self.family.is_alive(session) and len(session.retries) == asked_again

    def _meet_neighbours(self, run: Run) -> None:
        """Raise TargetError for a neighbour that does not answer: what is asked of it would be
        held against the device."""
        for address in () if self.options.is_builtin else run.neighbours:
            beside = Session(replace(run, address=address))
            try:
                is_there = any(self.family.is_alive(beside) for _ in range(RETRY.recovery))
            except TargetError:  # given up for its silence; the device has answered before
                is_there = False
            if not is_there:
                raise TargetError(
                    f"nobody answers at {address}, which --neighbour names; leave that out, or name"
                    " the address of another one on the line or bus"
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

    @property
    def found(self) -> str:
        """What detection found out, in a sentence."""
        return profile_sentence(self._result, self.ledger)

    def _probes(self, *, is_destructive: bool) -> list[Probe]:
        """Those of the plan that are (not) destructive."""
        return [one for one in self._result.plan.probes if one.is_destructive is is_destructive]

    def _detect(self, run: Run, probes: list[Probe], before: Check | None = None) -> None:
        """Ask these probes, right `before` a check; those that need the module alone on its line
        get a line or bus of their own where that is possible (built-in twin)."""
        if run.quality.is_noisy and not run.target.is_lossless:
            for probe in (one for one in probes if one.is_destructive):
                leave_out(run, probe, f"too risky on a noisy {run.target.word}: {run.quality}")
            probes = [one for one in probes if not one.is_destructive]
        for is_alone, row in itertools.groupby(probes, lambda one: "alone" in one.check.needs):
            if is_alone and run.neighbours:
                with self._guard.opened(()) as other:
                    self._inherit(other, run)
                    self._ask(other, list(row))
            else:
                self._ask(run, list(row), before)

    def _detect_late(self, run: Run, probes: list[Probe], before: Check | None = None) -> None:
        """Ask these amid the checks: what is lost there, ends no run."""
        try:
            if run.memory is not None:
                self._guard.restore(run, before=before)
            self._detect(run, probes, before)
        except TargetError as error:
            self._guard.block(str(error))

    def _has_learnt(self, run: Run, result: CheckResult) -> bool:
        """Ask what a check has looked up and nobody was to ask, and, if it has failed, what it has
        guessed; True if it has taken the device for another than it is."""
        switches = set(run.readings.looked_up)
        # What has been recorded was not recorded on a device of which the guess is wrong.
        if result.verdict is Verdict.FAIL and self.options.recording is None:
            switches |= run.readings.guessed
        missing = [one for one in self._unasked if one.switch in switches]
        if not missing or run.is_interrupted or run.target.crash or self._guard.blocked:
            return False
        assumed = dict(run.readings)
        self._unasked = [one for one in self._unasked if one not in missing]
        # What only the check has seen is no answer to the question, and is held against it.
        seen = {one.switch: assumed[one.switch] for one in missing if one.switch in assumed}
        for switch in seen:
            del run.readings[switch]
        self._detect_late(run, missing, result.check)
        for switch, reading in seen.items():
            run.readings.setdefault(switch, reading)
        learnt = {
            switch
            for switch, reading in run.readings.items()
            if reading != assumed.get(switch, self.ledger.ambiguity_of(switch).default_of(switch))
        }
        return bool(learnt) and not self._guard.blocked

    def _ask(self, run: Run, probes: list[Probe], before: Check | None = None) -> None:
        if any(probe.check.danger > 0 for probe in probes) and not self._guard.remember(run):
            for probe in probes:
                if probe.check.danger > 0:
                    leave_out(run, probe, self._guard.passive_only)
            probes = [probe for probe in probes if probe.check.danger == 0]
        detect(run, probes, self._guard)
        if run.memory is None:
            return
        try:
            self._guard.restore(run, before=before)
        except TwinCrashed:
            if not self._guard.revive(run):
                raise

    @staticmethod
    def _inherit(other: Run, run: Run) -> None:
        """Let a run on another line or bus know, and tell, what is known on this one."""
        other.identity, other.target.round_trip = run.identity, run.target.round_trip
        other.quality = run.quality
        other.readings, other.detections = run.readings, run.detections
        if other.target.travel_guard is not None:
            other.target.travel_guard = other.family.travel_guard(
                other
            )  # nothing has been said there yet

    def _last_words(self, run: Run) -> None:
        for text in run.target.remarks:
            self._emit(events.Note(text))
        if not self._guard.blocked and not self._guard.is_sane(run):
            self._guard.trouble("the device did not answer the closing sanity exchange")
        if run.quality.corrupted:
            self._emit(events.Note(f"noise on the {run.target.word}: {run.quality}"))

    # Checks.

    def _run_checks(self, run: Run) -> None:
        checks = self._result.plan.to_run
        for drawing in checks[MEANWHILE:]:
            if drawing.soaks:
                self._jobs.begin(run, drawing, run.seed)
        is_detected = False
        for number, check in enumerate(checks, 1):
            if "destructive" in check.safety and not is_detected and not self._guard.blocked:
                is_detected = True
                self._detect_late(run, self._probes(is_destructive=True))
            self._emit(
                events.CheckStarted(
                    number, len(checks), check.name, check.behaviour, check.requirements
                )
            )
            if self._guard.blocked:
                result = self._blocked_result(check, self._guard.blocked)
            else:
                result = self._run_one(run, check)
            self._keep(result, number, self.options.replay(check, result.recording))
            if run.is_interrupted:
                raise KeyboardInterrupt
            if self._result.has_ended_early:
                break
        if checks and not is_detected and not self._is_over():  # they were named, no such check
            self._detect_late(run, self._probes(is_destructive=True))

    def _keep(self, result: CheckResult, number: int, replay: str) -> None:
        self._result.checks.append(result)
        self._guard.has_failed |= result.verdict is Verdict.FAIL
        self._emit(result.as_event(number, len(self._result.plan.to_run), replay))

    def _is_over(self) -> bool:
        return bool(self._guard.blocked) or self._result.has_ended_early

    def _soak(self, run: Run) -> None:
        """Repeat what draws at random; ended by an interrupt, it tells what it has found."""
        options, checks = self.options, self._result.plan.to_run
        if options.duration_s is None or self._is_over():
            return
        repeated = [check for check in checks if check.soaks]
        soak = Soak(repeated, options.seed, options.duration_s, self._tell, self._soak_clock)
        run.emit = soak.hear
        self._jobs.close()
        # Here this process only waits for the others.
        jobs = self._jobs = Jobs(self._cores if self._cores > 1 else 0, self._note)
        try:
            for check, seed in soak.rounds(partial(jobs.begin, run), jobs.ahead):
                run.seed, total = seed, len(checks)
                self._emit(
                    events.CheckStarted(
                        total, total, check.name, check.behaviour, check.requirements
                    )
                )
                result = self._run_one(run, check)
                seeded = replace(options, seed=run.seed)
                if kept := soak.add(result, run.seed):
                    self._keep(kept, total, seeded.replay(check, result.recording))
                if run.is_interrupted:
                    raise KeyboardInterrupt
                if self._is_over():
                    break
        finally:
            run.emit, run.seed = self._tell, options.seed
            for result in soak.summary():
                self._keep(result, len(checks), options.command)

    def _run_one(self, run: Run, check: Check) -> CheckResult:
        if run.neighbours and self._is_alone(run, check):
            return self._run_alone(run, check)
        if check.danger > 0 and not self._guard.remember(run):
            return self._blocked_result(check, self._guard.passive_only)
        if "destructive" in check.safety and run.quality.is_noisy and not run.target.is_lossless:
            reason = f"too risky on a noisy {run.target.word}: {run.quality}"
            return self._left_out(check, reason)
        if reason := self._guard.of_no_use(run, check):
            return self._blocked_result(check, reason)
        result = self._jobs.judged(run, check, self._judged)
        self._guard.doubt(run, result)
        # Interrupted, the run ends here: the device is made safe on its way out.
        return result if run.is_interrupted else self._after(run, check, result)

    def _judged(self, run: Run, check: Check) -> CheckResult:
        """Run a check; again when it has turned out that it depends on more than was asked for."""
        while True:
            run.readings.looked_up.clear()
            run.readings.guessed.clear()
            result = self._attempts.believed(run, check)
            if not self._has_learnt(run, result):
                return result

    def _after(self, run: Run, check: Check, result: CheckResult) -> CheckResult:
        """Bring the device to rest after a check and see whether it is still there (rule 5)."""
        device_guard, why = self._guard, f": {result.trouble}" if result.trouble else ""
        try:
            is_sane = self._is_back(run, check)
        except TargetError as error:
            is_sane, why = False, f": {error}"
            result = replace(result, trouble=result.trouble or str(error))
        except Exception as error:  # what cannot be put back must not be followed by more
            device_guard.block(describe(error))
            return result
        if run.target.crash:
            crash = run.target.crash
            if not device_guard.revive(run):
                device_guard.block(f"{crash}; no fresh one could take its place")
        elif not is_sane:
            device_guard.seek(run)
            device_guard.block(f"the device no longer answers after {check.name}{why}")
            result = result if run.target.is_lossless else result.withdrawn(device_guard.blocked)
        return result

    def _is_back(self, run: Run, check: Check) -> bool:
        """Bring the device to rest; whether it then answers."""
        if run.target.crash:
            return False
        if check.danger > 0:
            try:
                self._guard.restore(run)
            except TargetError:  # who has restarted meanwhile is deaf for a while
                if self._guard.blocked or not self._guard.is_sane(run):
                    raise
                self._guard.restore(run)
        return self._guard.is_sane(run)

    def _is_alone(self, run: Run, check: Check) -> bool:
        """True for a check that needs the module alone, or better has it so (see `disturbs`)."""
        if "alone" in check.needs:
            return True
        is_free = self.options.is_builtin and "neighbour" not in check.needs
        return is_free and self.family.disturbs(run.readings)

    def _run_alone(self, run: Run, check: Check) -> CheckResult:
        """Run a check with the module alone on a line or bus of its own (built-in twin)."""
        with self._guard.opened(()) as other:
            self._inherit(other, run)
            result = self._run_one(other, check)
            run.is_interrupted |= other.is_interrupted
            return result

    def _blocked_result(self, check: Check, reason: str) -> CheckResult:
        verdict, text = Verdict.INCONCLUSIVE, f"not started: {reason}"
        if reason in self._guard.caused:
            verdict, text = Verdict.NOT_RUN, reason
        findings = tuple(Finding(name, verdict, text) for name in check.requirements)
        return CheckResult(check, Outcome.BLOCKED, findings, (), 0.0, reason)

    def _left_out(self, check: Check, reason: str) -> CheckResult:
        findings = tuple(Finding(name, Verdict.NOT_RUN, reason) for name in check.requirements)
        return CheckResult(check, Outcome.LEFT_OUT, findings, (), 0.0, reason)
