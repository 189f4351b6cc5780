"""From findings of checks to one verdict per requirement, one exit status and one sentence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.errors import counted
from axistwin_conformance.base.events import Outcome
from axistwin_conformance.base.ledger import Ledger, Requirement
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.base.verdicts import Finding, Verdict, join_texts, merge
from axistwin_conformance.engine.result import RequirementResult, Result
from axistwin_conformance.transport.kinds import HID

CONFORMS, FAILS, USAGE, UNREACHABLE, UNSETTLED, INTERRUPTED = 0, 1, 2, 3, 4, 130

NO_RIG = "needs a rig that works inputs, supply or load"
NOT_COVERED = "not covered: no check judges it yet"
ELSEWHERE = "judged over its serial line (--port URL)"


def conclude(result: Result, ledger: Ledger) -> None:
    """Fill in the verdicts per requirement, the exit status and the closing sentence."""
    unstarted = _unstarted(result)
    elsewhere = ELSEWHERE if result.options.family.transport_kind is HID else ""
    spoken: dict[str, list[tuple[str, Finding]]] = {}
    for ran in result.checks:
        for finding in ran.findings:
            spoken.setdefault(finding.requirement, []).append((ran.check.name, finding))
    judged = []
    for key, requirement in ledger.requirements.items():
        one = _judge(requirement, spoken.get(key, []), unstarted, elsewhere)
        # A breach seen by the way is told, also if nobody asked about that requirement.
        if key in result.plan.requirements or one.verdict is Verdict.FAIL:
            judged.append(one)
    result.requirements = tuple(judged)
    result.exit_status = _exit_status(result)
    result.sentence = _sentence(result, ledger)


def _unstarted(result: Result) -> dict[Check, str]:
    """Checks of the selection that did not start, with the reason."""
    started = {one.check for one in result.checks}
    reason = result.refusal or "; ".join(result.problems)
    if result.is_interrupted:
        reason = "the run was interrupted"
    elif result.has_ended_early:
        reason = "not started: ended after the first failure"
    reasons = dict(result.plan.left_out)
    reasons.update({check: reason for check in result.plan.to_run if check not in started})
    return reasons


def _judge(
    requirement: Requirement,
    spoken: list[tuple[str, Finding]],
    unstarted: Mapping[Check, str],
    elsewhere: str,
) -> RequirementResult:
    missing = {c.name: why for c, why in unstarted.items() if requirement.id in c.requirements}
    verdict = merge(finding.verdict for _, finding in spoken)
    names = tuple(dict.fromkeys([name for name, _ in spoken] + list(missing)))
    reason = _reason(requirement, verdict, [f for _, f in spoken], missing, len(names))
    if elsewhere and not names and not requirement.not_on_wire:
        reason = elsewhere
    return RequirementResult(requirement, verdict, reason, names, tuple(spoken))


def _reason(
    requirement: Requirement,
    verdict: Verdict,
    findings: list[Finding],
    missing: Mapping[str, str],
    total: int,
) -> str:
    """Why this verdict, in a line; `missing`: checks that did not start, each with its reason."""
    if not findings and not missing:
        if requirement.not_on_wire:
            return f"not on the wire: {requirement.not_on_wire}"
        return NO_RIG if "rig" in requirement.safety else NOT_COVERED
    texts = [] if verdict is Verdict.PASS else [_told(f) for f in findings if f.verdict is verdict]
    if missing and verdict is not Verdict.FAIL:
        for why, count in Counter(missing.values()).items():
            texts.append(why if count == total else f"{count} of {total} checks not run: {why}")
    return join_texts(*dict.fromkeys(texts))


def _told(finding: Finding) -> str:
    return finding.sentence or finding.text


def _exit_status(result: Result) -> int:
    verdicts = [requirement.verdict for requirement in result.requirements]
    if result.refusal:
        return USAGE if result.is_misused else UNREACHABLE
    if Verdict.FAIL in verdicts or _departs(result):
        return FAILS
    if result.is_interrupted:
        return INTERRUPTED
    has_error = any(check.outcome is Outcome.ERROR for check in result.checks)
    if Verdict.INCONCLUSIVE in verdicts or result.problems or has_error:
        return UNSETTLED
    if result.options.is_only_detection and result.readings:
        return CONFORMS
    return CONFORMS if any(verdict.is_judgement for verdict in verdicts) else USAGE


def _departs(result: Result) -> str:
    """In which readings the device is not what the profile says that the user gave; empty: none."""
    return (
        "; ".join(departure.text for departure in result.profile.departures)
        if result.profile
        else ""
    )


def profile_sentence(result: Result, ledger: Ledger) -> str:
    """What detection found out."""
    others = [
        f"{switch}={reading}"
        for switch, reading in sorted(result.readings.items())
        if reading != ledger.ambiguity_of(switch).default_of(switch)
    ]
    unknown = sum(switch not in result.readings for switch in result.detections)
    differ = "differs" if len(others) == 1 else "differ"
    named = f"{len(others)} {differ} from the default: {', '.join(others)}" if others else ""
    answered = counted(len(result.readings), "question")
    return f"{answered} answered, {named or 'none differs from the default'}; {unknown} not known."


def _replay_sentence(result: Result, recording: Recording) -> str:
    """Whether recorded operations fail again."""
    many = counted(len(recording.operations), "recorded operation")
    failed = [
        judged.requirement.id for judged in result.requirements if judged.verdict is Verdict.FAIL
    ]
    if not failed:
        return f"Not reproduced: after {many} every reply is admissible."
    named = recording.requirement
    also = f" (recorded: {named})" if named and named not in failed else ""
    return f"Reproduced: {many} fail {', '.join(failed)}{also}."


def _nothing_sentence(result: Result) -> str:
    """Why a run that judged nothing did not."""
    if result.options.is_only_detection:
        asked = len(result.plan.probes)
        told_nothing = f"{counted(asked, 'question')} told nothing"
        why = told_nothing if asked else "every question was left out"
        return f"Nothing was detected: {why} (--dry-run shows the reasons)."
    if not result.checks:
        return "Nothing was judged: every check was left out (see the reasons above)."
    return "Nothing was judged: no check came to a judgement (see the reasons above)."


def _sentence(result: Result, ledger: Ledger) -> str:
    """The closing sentence, fit to be quoted alone."""
    model, total = result.options.model, len(result.requirements)
    count = dict.fromkeys(Verdict, 0)
    for requirement in result.requirements:
        count[requirement.verdict] += 1
    judged = sum(number for verdict, number in count.items() if verdict.is_judgement)
    scope = f"{judged} of {total} requirements judged"
    if result.refusal:
        return f"Not judged: {result.refusal}."
    if result.options.recording is not None and result.exit_status in (CONFORMS, FAILS):
        return _replay_sentence(result, result.options.recording)
    if _departs(result) and not count[Verdict.FAIL]:
        return f"The device is not what its profile says: {_departs(result)}."
    if result.exit_status == FAILS:
        lost = f"; then it was lost: {result.lost}" if result.lost else ""
        departs = f"; nor is it what its profile says: {_departs(result)}" * bool(_departs(result))
        ended = "; then it was interrupted" if result.is_interrupted else ""
        failed = f"{count[Verdict.FAIL]} failed, {scope}{lost}{departs}{ended}"
        return f"The device does not conform to {model}: {failed}."
    if result.exit_status == INTERRUPTED:
        open_ends = count[Verdict.INCONCLUSIVE]
        unsettled = f" but {open_ends} stayed inconclusive" if open_ends else ""
        return f"Interrupted; nothing failed so far{unsettled}, {scope}."
    if result.exit_status == UNSETTLED:
        open_ends = count[Verdict.INCONCLUSIVE]
        if result.lost:
            return f"No verdict on {model}: {result.lost}; nothing failed before, {scope}."
        why = f"{open_ends} stayed inconclusive" if open_ends else "; ".join(result.problems)
        return f"No verdict on {model}: nothing failed, but {why or 'a check crashed'}; {scope}."
    if result.options.is_only_detection and result.exit_status == CONFORMS:
        return profile_sentence(result, ledger)
    if result.exit_status == USAGE:
        return _nothing_sentence(result)
    quirks = f", {count[Verdict.QUIRK]} of them with a quirk" if count[Verdict.QUIRK] else ""
    return f"The device conforms to {model} in all that was judged: {scope}{quirks}."
