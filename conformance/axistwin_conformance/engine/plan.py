"""The plan: which checks will run, in which order, and why the others will not.

Order: passive, motion, stored, rig, destructive; within a class as the family lists them.
"""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from axistwin_conformance.base.armed import load_reads
from axistwin_conformance.base.check import BENCH, NEEDS, RIG, Check
from axistwin_conformance.base.classes import FULL, LEVELS, SAFETY_CLASSES, SOAK
from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.base.ledger import Ledger
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.probing import Probe
from axistwin_conformance.core.settings import Settings
from axistwin_conformance.transport.rig import RigChoice
from axistwin_conformance.transport.transport import is_twin_url

NOT_ALLOWED, ONLY_AT = "not allowed: ", "only at --level "
NOT_NEEDED = "no check of this run depends on it"


@dataclass(frozen=True, slots=True)
class Options:
    """What the user asked for.

    `endpoint`: a pyserial URL or device, or INTERFACE:CHANNEL of python-can; None for the
    built-in twin.  `rate`: of our end, None where the interface has its own.  `words`:
    requirement ids, prefixes of them, names of checks or of switches; none means everything.
    `is_detection`: ask for the profile with all that is allowed; `is_only_detection`: and judge
    nothing else.  `expected`: the readings of a profile file, None without one.  `duration_s`: of
    a soak.  `recording`: play just that, given as `replay_word`.  `report`: the folder of the
    report, empty without one.  `jobs`: processes that run random sequences on built-in twins.
    `settings`: what the options of the family have been set to.  `shrinks`: False where only the
    verdicts are wanted, which are the same.
    """

    family: Family
    model: str
    endpoint: str | None
    address: int
    neighbours: tuple[int, ...]
    rate: int | None
    allowed: frozenset[str]
    level: str
    seed: int
    words: tuple[str, ...] = ()
    rig: RigChoice = field(default_factory=RigChoice)
    is_detection: bool = False
    is_only_detection: bool = False
    expected: Mapping[str, str] | None = None
    profile: str = ""  # the file they come from
    is_exitfirst: bool = False
    duration_s: float | None = None
    recording: Recording | None = None
    replay_word: str = ""
    report: str = ""
    jobs: int = 1
    settings: Settings = field(default_factory=Settings)
    shrinks: bool = True

    @property
    def is_builtin(self) -> bool:
        """True if the built-in twin is to be judged."""
        return self.endpoint is None

    @property
    def is_twin(self) -> bool:
        """True if what is judged cannot be harmed: a twin made for this run."""
        return self.is_builtin or is_twin_url(self.url)

    @property
    def url(self) -> str:
        """What to open."""
        if self.endpoint is not None:
            return self.endpoint
        url = self.family.twin_url(self.model, self.address, self.neighbours)
        if self.rate == self.family.default_rate:
            return url
        return f"{url}&{self.family.transport_kind.rate_parameter}={self.rate}"

    @property
    def provided(self) -> frozenset[str]:
        """The needs (of `NEEDS`) that this run can meet."""
        met = {"neighbour"} if self.neighbours else {"alone"}
        if self.is_builtin:
            met.add("alone")  # a second line, with one module, costs nothing there
        if is_twin_url(self.url) and "time=virtual" in self.url:
            met.add("virtual")
        if self.is_twin or "rig" in self.allowed:
            met.add(BENCH)
        met.update(self.settings.met)
        met.update(f"{RIG}{name}" for name in self.rig.capabilities)
        return frozenset(met)

    @property
    def command(self) -> str:
        """The command that does this run again."""
        if self.recording is not None:
            return self._command((), replay=self.replay_word)
        return self._command(self.words, self.level)

    def replay(self, check: Check, recording: Recording | None = None) -> str:
        """Return the command that plays again the operations that failed in a check; that runs the
        check as this run did where there are none."""
        if self.recording is not None:
            return self.command
        if recording is not None:
            return self._command((), replay=recording.word(self.report))
        # The rounds of a soak are runs of the full level, each with a seed of its own.
        return self._command((check.name,), FULL if self.level == SOAK else self.level)

    def _command(self, selected: Sequence[str], level: str = FULL, replay: str = "") -> str:
        words = ["axistwin", "conform", self.model]
        transport_kind = self.family.transport_kind
        if self.endpoint is not None:
            words += [transport_kind.option, self.endpoint]
        if self.rate != (self.family.default_rate if self.is_builtin else None):
            words += [transport_kind.rate_option, str(self.rate)]
        if self.endpoint is not None:
            granted = sorted(self.allowed - {"passive"})
            words += ["--allow", ",".join(granted)] if granted else []
        words += self.settings.words(is_builtin=self.is_builtin)
        if self.endpoint is not None:
            words += [text for other in self.neighbours for text in ("--neighbour", str(other))]
        words += self.rig.words(is_default=is_twin_url(self.url))
        if self.address != self.family.default_address:
            words += ["--address", str(self.address)]
        words += ["--profile", self.profile] if self.profile else []
        words += ["--level", level] if level != FULL else []
        if level == SOAK and self.duration_s is not None:
            words += ["--duration", duration_word(self.duration_s)]
        words += ["--replay", replay] if replay else []
        return shlex.join([*words, "--seed", str(self.seed), *selected])


@dataclass(frozen=True, slots=True)
class Plan:
    """What will be run, in order, what will not and why; and the requirements asked about.

    `probes`: what the detection phase will ask; `unprobed`: what it will not, and why; `unneeded`:
    what of that is asked if a check depends on it after all.
    """

    requirements: tuple[str, ...]
    to_run: tuple[Check, ...]
    left_out: tuple[tuple[Check, str], ...]
    probes: tuple[Probe, ...] = ()
    unprobed: tuple[tuple[Probe, str], ...] = ()

    @property
    def unneeded(self) -> tuple[Probe, ...]:
        """See above."""
        return tuple(probe for probe, reason in self.unprobed if reason == NOT_NEEDED)


def make_plan(
    options: Options, ledger: Ledger, checks: Sequence[Check], probes: Sequence[Probe] = ()
) -> Plan:
    """Plan a run; raises UsageError for a word that selects nothing."""
    switches = [probe.switch for probe in probes]
    requirements, chosen = _select(options.words, ledger, checks, switches)
    if options.is_only_detection:
        requirements, chosen = (), ()
    if options.recording is not None:
        one = options.family.replay_check(options.recording)
        requirements = tuple(key for key in ledger.requirements if key in one.requirements)
        chosen = (one,)
    ordered = sorted(chosen, key=lambda check: check.danger)  # stable: the family's order stays
    reasons = [(check, _obstacle_of_check(check, options)) for check in ordered]
    to_run = tuple(check for check, reason in reasons if not reason)
    if options.level == SOAK and not any(check.soaks for check in to_run):
        raise UsageError(_nothing_to_soak(reasons))
    wanted = _wanted(options, ledger, to_run, probes)
    asked = [(probe, _obstacle_of_probe(probe, options, to_run, wanted)) for probe in probes]
    return Plan(
        requirements,
        to_run,
        tuple((check, reason) for check, reason in reasons if reason),
        tuple(probe for probe, reason in asked if not reason),
        tuple((probe, reason) for probe, reason in asked if reason),
    )


def _nothing_to_soak(reasons: Sequence[tuple[Check, str]]) -> str:
    why = {reason for check, reason in reasons if check.soaks}
    told = "; ".join(sorted(why)) or "the IDs select no random sequences"
    return f"--level {SOAK} repeats the random sequences, and none will run: {told}"


UNITS = {"h": 3600.0, "m": 60.0, "s": 1.0}


def duration_word(seconds: float) -> str:
    """A duration as it is typed: in the largest unit of which it is a whole number."""
    unit = next((name for name, one in UNITS.items() if seconds >= one and not seconds % one), "s")
    return f"{seconds / UNITS[unit]:g}{unit}"


@dataclass(frozen=True, slots=True)
class _Wanted:
    """Switches: `named` by the user, with what their own questions rest on; `needed` by the checks
    to be run, None: all of them."""

    named: frozenset[str]
    needed: frozenset[str] | None


def _wanted(
    options: Options, ledger: Ledger, to_run: Sequence[Check], probes: Sequence[Probe]
) -> _Wanted:
    """What is asked for.  A whole run asks everything, so does one of checks of which nobody has
    recorded on what they depend."""
    reads = load_reads(ledger.name)
    chosen = [probe for probe in probes if probe.switch in options.words]
    rest = _depended_on([probe.check.name for probe in chosen], reads, probes)
    named = rest.union(probe.switch for probe in chosen)
    names = [check.name for check in to_run]
    is_whole = not options.words and options.recording is None
    if is_whole or not reads.keys() >= set(names):
        return _Wanted(named, None)
    return _Wanted(named, _depended_on(names, reads, probes))


def _depended_on(
    names: Iterable[str], reads: Mapping[str, Sequence[str]], probes: Sequence[Probe]
) -> frozenset[str]:
    """The switches that checks and probes of these names look up, and all that the questions for
    those look up in their turn."""
    found: set[str] = set()
    left = list(names)
    while left:
        fresh = set(reads.get(left.pop(), ())) - found
        found |= fresh
        left += [probe.check.name for probe in probes if probe.switch in fresh]
    return frozenset(found)


def _obstacle_of_probe(
    probe: Probe, options: Options, to_run: Sequence[Check], wanted: _Wanted
) -> str:
    """Say why a switch is not asked for.  Unless the user names it, or wants the profile itself,
    detection does nothing to the device that the checks to be run do not do as well."""
    obstacle = _obstacle(probe.check, options)
    if obstacle or probe.switch in wanted.named or (options.is_detection and not wanted.named):
        return obstacle
    done = {"passive"}.union(*(check.safety for check in to_run))
    beyond = [name for name in SAFETY_CLASSES if name in probe.check.safety and name not in done]
    if beyond:
        return f"no check of this run is of class {', '.join(beyond)}"
    is_needed = wanted.needed is None or probe.switch in wanted.needed
    return "" if is_needed else NOT_NEEDED


def _obstacle(check: Check, options: Options) -> str:
    """Say why a check will not run; empty if it will."""
    beyond = set(check.safety) - options.allowed
    forbidden = [name for name in SAFETY_CLASSES if name in beyond]  # told in one order
    if forbidden:
        return f"{NOT_ALLOWED}{', '.join(forbidden)} (--allow {','.join(forbidden)})"
    if LEVELS.index(check.level) > LEVELS.index(options.level):
        return f"{ONLY_AT}{check.level}"
    missing = [name for name in check.needs if name not in options.provided]
    for capability, need in options.settings.withheld.items():
        if (of_rig := f"{RIG}{capability}") in missing:
            missing = [need, *(name for name in missing if name not in (of_rig, need))]
    reasons = [NEEDS[name] for name in missing if not name.startswith(RIG)]
    controls = options.family.rig_controls
    rig = [controls[name.removeprefix(RIG)].words for name in missing if name.startswith(RIG)]
    if rig:
        reasons.append(f"needs a rig that {' and '.join(rig)} (--rig)")
    return "; ".join(reasons)


def _obstacle_of_check(check: Check, options: Options) -> str:
    """The same; address and rate of a real device are left alone unless the user has named the
    check."""
    obstacle = _obstacle(check, options)
    is_risked = options.is_twin or "destructive" not in check.safety or _is_named(check, options)
    if is_risked or obstacle.startswith((NOT_ALLOWED, ONLY_AT)):
        return obstacle
    return "destructive: only if named, by its name or by the whole ID of a requirement"


def _is_named(check: Check, options: Options) -> bool:
    """True if the user asked for this very check, not for a group of them."""
    return not {check.name, *check.requirements}.isdisjoint(
        {*options.words, *(word.upper() for word in options.words)}
    )


def _select(
    words: Sequence[str], ledger: Ledger, checks: Sequence[Check], switches: Sequence[str]
) -> tuple[tuple[str, ...], tuple[Check, ...]]:
    if not words:
        return tuple(ledger.requirements), tuple(checks)
    requirements: set[str] = set()
    named: set[str] = set()
    for word in words:
        matching = {key for key in ledger.requirements if key.startswith(word.upper())}
        exact = {check.name for check in checks if check.name == word}
        if not matching and not exact and word not in switches:
            names = [*(check.name for check in checks), *switches]
            raise UsageError(_no_match(word, tuple(ledger.requirements), names))
        requirements |= matching
        named |= exact
    chosen = tuple(
        check
        for check in checks
        if check.name in named or not requirements.isdisjoint(check.requirements)
    )
    asked = requirements.union(*(check.requirements for check in checks if check.name in named))
    return tuple(key for key in ledger.requirements if key in asked), chosen


def _no_match(word: str, ids: Sequence[str], checks: Sequence[str]) -> str:
    """Say that a word selects nothing, and what it may have been meant to be.

    Ids are compared without the part that is right, or all of them would look alike.
    """
    *parts, last = word.upper().split("-")
    while parts and not any(key.startswith("-".join([*parts, ""])) for key in ids):
        last = f"{parts.pop()}-{last}"
    known = "-".join([*parts, ""]) if parts else ""
    tails = [key.removeprefix(known) for key in ids if key.startswith(known)]
    below = list(dict.fromkeys(tail.partition("-")[0] for tail in tails))
    near = difflib.get_close_matches(word, checks, n=1)
    near += [
        known + near_name for near_name in difflib.get_close_matches(last, [*below, *tails], n=1)
    ]
    if near:
        hint = f"; did you mean {near[0]}?"
    else:
        hint = f"; they begin with {', '.join(known + one for one in below)}" if known else ""
    return f"{word!r} matches no requirement, prefix or check{hint} (--list shows them all)"
