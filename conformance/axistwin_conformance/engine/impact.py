"""What a plan would do to the device, class by class: what `--dry-run` tells.

It is told from what checks and probes declare, to which the guard holds them frame by frame, and
from the bounds that the travel guard and the budget enforce.
"""

from __future__ import annotations

from dataclasses import dataclass

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.errors import counted, with_article
from axistwin_conformance.engine.plan import Options, Plan


@dataclass(frozen=True, slots=True)
class Impact:
    """What would be done of one safety class, by these checks and by so many questions before."""

    safety: str
    checks: tuple[str, ...]
    questions: int
    what: str
    within: str

    @property
    def who(self) -> str:
        """How many checks and questions would do it."""
        parts = [(len(self.checks), "check"), (self.questions, "question")]
        return ", ".join(counted(number, word) for number, word in parts if number)


def impacts(plan: Plan, options: Options) -> tuple[Impact, ...]:
    """What would be done to the device, harmless classes first; nothing for a class without use."""
    asking = [probe.check for probe in plan.probes]
    told = []
    for safety in SAFETY_CLASSES:
        checks = tuple(check.name for check in plan.to_run if _does(check, safety))
        questions = sum(_does(check, safety) for check in asking)
        if checks or questions:
            what = options.family.impact.get(safety, "")
            told.append(Impact(safety, checks, questions, what, _within(safety, options)))
    return tuple(told)


def allowed_in_vain(options: Options) -> str:
    """What to tell of classes that were allowed and of which the family has no check; empty if
    there is none.  By default everything is allowed on the built-in twin: nobody has asked then."""
    family = options.family
    if options.is_builtin and options.allowed >= set(SAFETY_CLASSES):
        return ""
    known = {safety for check in family.checks() for safety in check.safety}
    known |= {safety for probe in family.probes() for safety in probe.check.safety}
    idle = [safety for safety in SAFETY_CLASSES if safety in options.allowed - known]
    if not idle:
        return ""
    classes = "that class" if len(idle) == 1 else "those classes"
    whose = with_article(options.model)
    return f"--allow {','.join(idle)} changes nothing: no check of {whose} is of {classes}"


def _does(check: Check, safety: str) -> bool:
    return safety in check.safety


def _within(safety: str, options: Options) -> str:
    """The bounds that are kept to, whatever a check is about."""
    known = {
        "rig": f"by --rig {options.rig.kind}, brought to rest after each check",
        "destructive": "last; not all of it can be put back",
        "passive": "nothing is changed",
        "negative": "of what stored may write to alone, read first and put back",
    }
    return known[safety] if safety in known else options.settings.within(safety)
