"""Checks and device families: how a property is declared, and how the engine finds it.

A check is a function that takes a `Session` and judges; the decorator says which requirements it
judges and what it does to the device:

    @check("MACS-CMD-13-01", "MACS-REPLY-14", safety=("motion", "stored"), needs=("neighbour",))
    def a_move_ends_at_its_target(session: Session) -> None:
        '''20h reads the target once the profile is over.'''

The function's name is the property's name, its docstring the behaviour in a sentence.  A wrong
declaration is refused at import, with the remedy in the message.

A device family lists its models, the modules that hold its checks, and the few acts that the engine
cannot know: how to ask who is there, how to stop, what to remember and put back.
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

from axistwin_conformance.errors import UsageError, with_article
from axistwin_conformance.rig import CAPABILITIES, OF_AN_AXIS
from axistwin_conformance.transcript import Record
from axistwin_conformance.ways import LINE, Way

if TYPE_CHECKING:
    from axistwin_conformance.carrier import Carrier, Fence
    from axistwin_conformance.profile import Probe
    from axistwin_conformance.recording import Recording
    from axistwin_conformance.session import Run, Session

SAFETY_CLASSES = ("passive", "motion", "stored", "rig", "destructive")  # in the order they run
LEVELS = ("quick", "full", "soak")
FULL, SOAK = LEVELS[1:]  # full: what is run unless the user says otherwise
RIG = "rig:"  # what a need of a rig's capability begins with
BENCH = "bench"  # the need of what may go wrong where hands on the wiring have to be near

# What a check may need beside the device itself, and what to tell who does not have it.
NEEDS: Mapping[str, str] = {
    "neighbour": "needs a second module beside it (--neighbour ADDRESS)",
    "alone": "needs the module alone (no --neighbour)",
    "virtual": "needs virtual time: only the built-in twin can show it",
    "variables": "needs variables to use as it likes (--variables FIRST-LAST)",
    "flags": "needs user flags to use as it likes (--flags FIRST-LAST)",
    "program": "needs the bench program in the controller (--bench-program FLAG:ADDRESS)",
    "bench": "may disturb a controller that is in use: only on a bench (--allow rig)",
    **{f"{RIG}{name}": f"needs a rig that {words} (--rig)" for name, words in CAPABILITIES.items()},
}

CheckFunction = Callable[["Session"], None]


class Opener(Protocol):
    """How the way to a device is opened."""

    def __call__(self, url: str, rate: int | None, /, *, is_builtin: bool = False) -> Carrier:
        """Open it; raises TargetError with the reason in a line."""


@dataclass(frozen=True, slots=True)
class Check:
    """A declared property: what it judges, what it does to the device, what it needs."""

    name: str
    function: CheckFunction
    requirements: tuple[str, ...]
    safety: tuple[str, ...]
    level: str
    needs: tuple[str, ...]
    behaviour: str
    module: str
    soaks: bool = False
    shared: tuple[str, ...] = ()  # taken over by another family: as it names what it judges itself

    @property
    def declared(self) -> tuple[str, ...]:
        """The requirements as the check itself names them, whichever family runs it."""
        return self.shared or self.requirements

    def __call__(self, session: Session) -> None:
        """Run the check."""
        self.function(session)

    @property
    def rig_needs(self) -> tuple[str, ...]:
        """The capabilities of a rig that it needs."""
        return tuple(need.removeprefix(RIG) for need in self.needs if need.startswith(RIG))

    @property
    def danger(self) -> int:
        """The rank of its worst safety class; checks run in this order."""
        return max(SAFETY_CLASSES.index(name) for name in self.safety)


def check(
    *requirements: str,
    safety: str | Sequence[str] = "passive",
    level: str = "quick",
    needs: Sequence[str] = (),
    soaks: bool = False,
) -> Callable[[CheckFunction], Check]:
    """Declare the function below as the check of these requirements.

    `safety`: one class or several of `SAFETY_CLASSES`; all of them must be allowed for the check to
    run.  `level`: "quick" runs always, "full" only in full runs.  `needs`: names of `NEEDS`.
    `soaks`: it draws from its seed, and a soak repeats it with fresh ones until the time is over.
    Raises TypeError for a declaration that cannot be meant.
    """
    classes = (safety,) if isinstance(safety, str) else tuple(safety)

    def declare(function: CheckFunction) -> Check:
        name = function.__name__
        behaviour = " ".join((function.__doc__ or "").split())
        if not requirements or len(set(requirements)) != len(requirements):
            raise TypeError(f"{name}: name the requirements it judges in @check(...), each once")
        if not behaviour:
            raise TypeError(f"{name}: give it a docstring, the behaviour in one sentence")
        if not classes:
            raise TypeError(f"{name}: safety= needs a class; choose from {SAFETY_CLASSES}")
        _refuse_unknown(name, "safety", classes, SAFETY_CLASSES)
        _refuse_unknown(name, "level", (level,), LEVELS)
        _refuse_unknown(name, "needs", needs, tuple(NEEDS))
        if ("rig" in classes) is not any(one == BENCH or one.startswith(RIG) for one in needs):
            raise TypeError(f"{name}: safety 'rig' and a need of 'rig:...' or 'bench' go together")
        return Check(
            name, function, requirements, classes, level, tuple(needs), behaviour,
            function.__module__, soaks,
        )  # fmt: skip

    return declare


def _refuse_unknown(name: str, what: str, given: Sequence[str], known: Sequence[str]) -> None:
    for word in given:
        if word not in known:
            raise TypeError(f"{name}: {what}={word!r} is unknown; choose from {', '.join(known)}")


@dataclass(frozen=True, slots=True)
class Identity:
    """Who is there, as the probe found it: a line for people, named values for reports."""

    summary: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Model:
    """One model of a family; `facts` are what its checks must know of it (scalings, ranges)."""

    name: str
    title: str
    facts: Any = None


PROGRAM_EXTENT = 256  # addresses of the bench program: its counters, and its block from 128 on
PROGRAM_FLAGS = 4  # in a row


@dataclass(frozen=True, slots=True)
class Grounds:
    """What of a controller is the suite's to use: addresses of variables, numbers of user flags,
    and where the bench program is (its first flag, its first address); None: it is not there."""

    variables: range = range(0)
    flags: range = range(0)
    program: tuple[int, int] | None = None

    @property
    def met(self) -> frozenset[str]:
        """The needs (of `NEEDS`) that they meet."""
        has = {"variables": self.variables, "flags": self.flags, "program": self.program}
        return frozenset(name for name, ground in has.items() if ground)

    @property
    def named(self) -> dict[str, str]:
        """Each by the name of its option, as it is typed there."""
        spans = {"variables": self.variables, "flags": self.flags}
        named = {name: f"{span[0]}-{span[-1]}" for name, span in spans.items() if span}
        if self.program is not None:
            named["bench-program"] = "{}:{}".format(*self.program)
        return named

    @property
    def of_program(self) -> tuple[range, range]:
        """The variables and the flags that are the bench program's; none without it."""
        if self.program is None:
            return range(0), range(0)
        flag, address = self.program
        return range(address, address + PROGRAM_EXTENT), range(flag, flag + PROGRAM_FLAGS)


NO_GROUNDS = Grounds()


@dataclass(frozen=True, slots=True)
class Breach:
    """What a reply to a question of the engine's own breaks; see `Family.blame`."""

    requirement: str
    expected: str
    actual: str


@dataclass(frozen=True, slots=True)
class Family:
    """What the engine must know about a kind of device beside its checks.

    `probe(session)`: who is there; raises `WrongDevice` if it is not the model named, `TargetError`
        if nobody answers.
    `sanity(session)`: one known-good exchange; True if the device gave a good answer.
    `stop(session)`: bring any motion to rest; must not raise for an answer that does not come.
    `remember(session)`: read what `restore` will put back; called before anything but passive.
    `restore(session, memory)`: put back what differs; returns a sentence per thing it could not.
    `survey(session)`: whether the device has what the operator has named, once it is known who it
        is and before anything is judged; raises UsageError for what is not there.
    `trials`: need of a check → `trial(session)`, which tries what the operator has named for it:
        why nothing can be judged by that, empty if it can.  What a trial touches is put back.
    `explain(record)`: the bytes of a record in words.
    `twin_url(model, address, neighbours)`: the URL of the built-in twin.
    `open(url, rate, is_builtin=...)`: the way to the device; raises TargetError.
    `way`: how the devices are reached, and what that is called.
    `default_rate`: of the line or bus; None: as the interface is set.
    `rates`: the ones it can have; none named: any.
    `fence(run)`: what keeps the axes inside the envelope, whatever is sent.
    `writes(data)`: how many writes to nonvolatile memory these bytes ask for.
    `guard(session, data)`: why these bytes must not be sent to this device (outside the envelope,
        of a class the running check did not declare), or None.
    `capabilities`: what of a rig serves such a device.
    `grounds`: of the built-in twin; None: the family has no variables or flags to be named.
    `has_axis`: an envelope of motion means something to it.
    `disturbs(readings)`: whether devices of such readings meddle with what is said to others on
        their line, so that the built-in twin is judged alone wherever no check needs the others.
    `deeds`: safety class → what its checks do to a device, in words, for `--dry-run`.
    `blame(session, request, reply)`: which requirement a reply to these bytes breaks, if it is one
        that no device of the family gives; `reply` None: there was none, the twin had crashed.
    `probe_modules`: the modules that hold its quirk probes; they run in the order of these modules
        and of their text, so what later probes rest on comes first.
    `bench(session, address)`: a module as checks handle it that several families share, and
        `rig_bench` the same with the rig around it.
    `replay_module`: the module whose `replay_check(recording)` is the check that plays recorded
        operations, each of `operation_bytes` bytes; empty: the family has none.
    """

    name: str
    ledger: str
    models: Mapping[str, Model]
    modules: tuple[str, ...]
    addresses: range
    default_address: int
    default_rate: int | None
    probe: Callable[[Session], Identity]
    sanity: Callable[[Session], bool]
    stop: Callable[[Session], None]
    remember: Callable[[Session], Any]
    restore: Callable[[Session, Any], tuple[str, ...]]
    explain: Callable[[Record], str]
    twin_url: Callable[[str, int, tuple[int, ...]], str]
    open: Opener
    way: Way = LINE
    guard: Callable[[Session, bytes], str | None] = lambda session, data: None
    rates: tuple[int, ...] = ()
    fence: Callable[[Run], Fence] | None = None
    writes: Callable[[bytes], int] = lambda data: 0
    probe_modules: tuple[str, ...] = ()
    bench: Callable[[Session, int | None], Any] | None = None
    rig_bench: Callable[[Session, int | None], Any] | None = None
    replay_module: str = ""
    operation_bytes: int = 0
    capabilities: frozenset[str] = OF_AN_AXIS
    grounds: Grounds | None = None
    has_axis: bool = True
    disturbs: Callable[[Mapping[str, str]], bool] = lambda readings: False
    survey: Callable[[Session], None] = lambda session: None
    trials: Mapping[str, Callable[[Session], str]] = field(default_factory=dict)
    deeds: Mapping[str, str] = field(default_factory=dict)
    blame: Callable[[Session, bytes, bytes | None], Breach | None] = (
        lambda session, request, reply: None
    )

    def probes(self) -> tuple[Probe, ...]:
        """Return the family's quirk probes, in the order in which they have to run, without those
        that ask what its ledger does not.

        Raises TypeError if two of them share a name, ValueError for a switch that no ledger has.
        """
        from axistwin_conformance.ledger import load_ledger  # which needs this module

        book = load_ledger(self.ledger)
        found: dict[str, Probe] = {}
        for name in self.probe_modules:
            for probe in importlib.import_module(name).PROBES:
                if not book.asks(probe.switch):
                    continue
                if found.setdefault(probe.check.name, probe) is not probe:
                    raise TypeError(f"two probes are named {probe.check.name}; rename one")
        return tuple(found.values())

    def replay_check(self, recording: Recording) -> Check:
        """Return the check that plays recorded operations; raises UsageError without any."""
        if not self.replay_module:
            raise UsageError(
                f"--replay: nothing records operations of {with_article(recording.model)}"
            )
        made = importlib.import_module(self.replay_module).replay_check(recording)
        assert isinstance(made, Check)
        own = self._own(made)
        assert own is not None, "what is recorded of an axis is judged by what covers it here"
        return own

    def checks(self) -> tuple[Check, ...]:
        """Return the family's checks, in the order of its modules and of their text.

        Raises TypeError if two checks share a name (a name selects and replays exactly one), or
        if one names a requirement that no ledger has.
        """
        found: dict[str, Check] = {}
        for module_name in self.modules:
            module = importlib.import_module(module_name)
            for candidate in vars(module).values():
                if not isinstance(candidate, Check) or candidate.module != module_name:
                    continue
                if (own := self._own(candidate)) is None:
                    continue
                if own.name in found:
                    raise TypeError(f"two checks are named {own.name}; rename one")
                found[own.name] = own
        return tuple(found.values())

    def _own(self, check: Check) -> Check | None:
        """A check under this family's names of what it judges; None if it judges nothing here."""
        from axistwin_conformance.ledger import load_ledger  # which needs this module

        book = load_ledger(self.ledger)
        if unknown := [name for name in check.requirements if not book.knows(name)]:
            raise TypeError(f"{check.name}: {unknown[0]} is no requirement of {book.name}")
        names = book.own(check.requirements)
        if names == check.requirements or not names:
            return check if names else None
        return replace(check, requirements=names, shared=check.requirements)


FAMILY_PACKAGES = (
    "axistwin_conformance.mac_serial",
    "axistwin_conformance.mac_can",
    "axistwin_conformance.msc",
)


def families() -> tuple[Family, ...]:
    """Return every family the suite knows, each the `FAMILY` of its package."""
    return tuple(importlib.import_module(name).FAMILY for name in FAMILY_PACKAGES)


def find_family(model: str) -> Family:
    """Return the family of a model; raises UsageError with the nearest name for an unknown one."""
    known: dict[str, Family] = {name: family for family in families() for name in family.models}
    if model in known:
        return known[model]
    name, colon, address = model.partition(":")
    if colon and name in known:
        raise UsageError(f"{model}: the address is an option here: {name} --address {address}")
    near = difflib.get_close_matches(model, known, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise UsageError(f"unknown model {model!r}: {hint}Known: {', '.join(sorted(known))}.")
