"""A device family: what the engine must know of a kind of device beside its checks.

A family names its models and the few acts that the engine cannot know: how to ask who is there, how
to stop, what to remember and put back.  Its checks and probes are found in its folder.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, TypeVar

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.core.identity import Identity, Model
from axistwin_conformance.core.lenient import Lenient
from axistwin_conformance.core.probing import Probe
from axistwin_conformance.core.session import Run, Session
from axistwin_conformance.core.settings import FamilyOptions
from axistwin_conformance.core.wording import Exchange
from axistwin_conformance.transport.kinds import LINE, TransportKind
from axistwin_conformance.transport.rig import POWER, RigControls, rig_controls
from axistwin_conformance.transport.transport import Transport, TravelLimiter

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Violation:
    """What a reply to a question of the engine's own breaks; see `Family.diagnose`."""

    requirement: str
    expected: str
    actual: str


class Family(ABC):
    """One kind of device.

    `name`: of the family and of its ledger.  `addresses`: those a device can have.
    `default_rate`: of the line or bus; None: as the interface is set.  `rates`: the ones it can
    have; none named: any.  `transport_kind`: how the devices are reached, and what that is called.
    `rig_controls`: what a rig may work of such a device.  `options`: of the command line that are
    its own.
    `impact`: safety class → what its checks do to a device, in words, for `--dry-run`;
    under "end": what is done to one at the end of a run.
    `tried_needs`: those needs of checks that `unusable` tries before a check relies on them.
    `glossary`: what abbreviations of the manual stand for, in the words of a failure.
    `operation_bytes`: of one recorded operation; 0: nothing of it is recorded.
    """

    name: str
    models: ClassVar[Mapping[str, Model]]
    addresses: range
    default_address: int
    default_rate: int | None = None
    rates: tuple[int, ...] = ()
    transport_kind: TransportKind = LINE
    rig_controls: RigControls = rig_controls(POWER)
    options: FamilyOptions = FamilyOptions()
    impact: ClassVar[Mapping[str, str]] = {}
    tried_needs: frozenset[str] = frozenset()
    glossary: ClassVar[Mapping[str, str]] = {}
    _replay_module: str = ""
    operation_bytes: int = 0

    # --- the way to a device ---------------------------------------------------------------------

    @abstractmethod
    def open(self, url: str, rate: int | None, /, *, is_builtin: bool = False) -> Transport:
        """Open the way to a device; raises TargetError with the reason in a line."""

    def twin_url(self, model: str, address: int, neighbours: tuple[int, ...]) -> str:
        """The URL of the built-in twin, with its neighbours on one line or bus."""
        return self.transport_kind.twin_url(model, address, neighbours)

    @abstractmethod
    def explain(self, record: Record) -> str:
        """Put the bytes of a record into words."""

    def in_words(self, request: bytes, reply: bytes) -> Exchange:
        """Put an exchange into the words of a failure; shorter than `explain`, without what goes
        without saying."""
        return Exchange(self.explain(Record(0, Direction.HOST, request)))

    # --- the acts of the engine ------------------------------------------------------------------

    @abstractmethod
    def driver(self, session: Session, address: int | None = None) -> Any:
        """The device, or the one at an address, as the family's checks and probes handle it."""

    @abstractmethod
    def identify(self, session: Session) -> Identity:
        """Ask who is there; raises WrongDevice if it is not the model named, TargetError if nobody
        answers."""

    @abstractmethod
    def is_alive(self, session: Session) -> bool:
        """One known-good exchange; True if the device gave a good answer."""

    @abstractmethod
    def stop(self, session: Session) -> None:
        """Bring any motion to rest; does not raise for an answer that does not come."""

    @abstractmethod
    def remember(self, session: Session) -> Any:
        """Read what `restore` will put back; called before anything but passive."""

    @abstractmethod
    def restore(self, session: Session, memory: Any) -> tuple[str, ...]:
        """Put back what differs; a sentence for each thing that could not be.  What the check that
        follows (`Run.next_check`) sets itself before it begins may stay: each write wears the
        memory, and on every way out this is called without one."""

    def unsure(self, session: Session, memory: Any) -> tuple[str, ...]:
        """A sentence for each thing that was written to although, as it has turned out, nobody
        knows what it was: the memory of it rests on answers that have failed (`Run.doubted`)."""
        return ()

    def would_lose(self, session: Session, data: bytes) -> str:
        """Why these bytes must not be written: nobody knows what they replace; empty: they may."""
        return ""

    def kept(self, memory: Any, /) -> Mapping[str, Any]:
        """What `remember` read, as a file keeps it; empty: nothing is worth a file."""
        return {}

    def memory_of(self, held: Mapping[str, Any], /) -> Any:
        """The same the other way; raises ValueError, KeyError or TypeError for what is none."""
        raise ValueError("nothing is kept of such a device")

    # --- what keeps a device safe ----------------------------------------------------------------

    def forbid(self, session: Session, data: bytes) -> str | None:
        """Why these bytes must not be sent to this device (of a class that the running check did
        not declare), or None."""
        return None

    def travel_guard(self, run: Run) -> TravelLimiter | None:
        """What keeps the axes inside the envelope, whatever is sent; None where nothing moves."""
        return None

    def stored_writes(self, data: bytes) -> int:
        """How many writes to nonvolatile memory these bytes ask for."""
        return 0

    def preflight(self, session: Session) -> None:
        """See whether the device has what the operator has named, once it is known who it is and
        before anything is judged; raises UsageError for what is not there."""
        return

    def unusable(self, session: Session, need: str) -> str | Violation:
        """Why nothing can be judged by what the operator has named for that need of a check, after
        a try; empty if it can.  What the device broke in the try, if that was its fault.  What the
        try touches is put back."""
        return ""

    def disturbs(self, readings: Mapping[str, str]) -> bool:
        """Whether devices of such readings meddle with what is said to others on their line, so
        that the built-in twin is judged alone wherever no check needs the others."""
        return False

    def diagnose(self, session: Session, request: bytes, reply: bytes | None) -> Violation | None:
        """Which requirement a reply to these bytes breaks, if it is one that no device of the
        family gives; `reply` None: there was none, the twin had crashed.  No request: it answers
        nothing any more where it was; it may be found where only a command led that nobody sent."""
        return None

    def lenient(self, session: Session, request: bytes, reply: bytes) -> Lenient | None:
        """The reply to a sound request read under a lenient grammar, with each thing in which it
        departs from the strict one named; None: nothing of this protocol, or silence."""
        return None

    # --- its checks and probes -------------------------------------------------------------------

    @cached_property
    def modules(self) -> tuple[str, ...]:
        """The modules that hold its checks, in the order of a run (see `_modules`)."""
        return _modules("checks", self._packages)

    @cached_property
    def probe_modules(self) -> tuple[str, ...]:
        """The modules that hold its quirk probes, in the order in which they are asked: what later
        probes rest on comes first."""
        return _modules("probes", self._packages)

    @property
    def _packages(self) -> tuple[str, ...]:
        """The packages in which its `checks` and `probes` are; its own, and any it shares."""
        return (type(self).__module__.rpartition(".")[0],)

    def checks(self) -> tuple[Check, ...]:
        """The family's checks, in the order of its modules and of their text.

        Raises TypeError if two checks share a name (a name selects and replays exactly one), or
        if one names a requirement that no ledger has, or needs what no rig works of this family.
        """
        found: dict[str, Check] = {}
        for check in _found(self.modules, Check, lambda check: check.module):
            if (own := self._own(check)) is None:
                continue
            if own.name in found:
                raise TypeError(f"two checks are named {own.name}; rename one")
            found[own.name] = own
        return tuple(found.values())

    def probes(self) -> tuple[Probe, ...]:
        """The family's quirk probes, in the order of their modules and of their text, without those
        that ask what its ledger does not.

        Raises TypeError if two of them share a name, or one needs what no rig works of this family;
        ValueError for a switch that no ledger has.
        """
        book = load_ledger(self.name)
        found: dict[str, Probe] = {}
        for probe in _found(self.probe_modules, Probe, lambda probe: probe.check.module):
            if not book.asks(probe.switch):
                continue
            if probe.check.name in found:
                raise TypeError(f"two probes are named {probe.check.name}; rename one")
            self._check_rig_needs(probe.check)
            found[probe.check.name] = probe
        return tuple(found.values())

    def replay_check(self, recording: Recording) -> Check:
        """The check that runs recorded operations; only where there are any (`operation_bytes`)."""
        made = importlib.import_module(self._replay_module).replay_check(recording)
        assert isinstance(made, Check)
        own = self._own(made)
        assert own is not None, "what is recorded of an axis is judged by what covers it here"
        return own

    def _own(self, check: Check) -> Check | None:
        """A check under this family's names of what it judges; None if it judges nothing here."""
        book = load_ledger(self.name)
        if unknown := [name for name in check.requirements if not book.knows(name)]:
            raise TypeError(f"{check.name}: {unknown[0]} is no requirement of {book.name}")
        self._check_rig_needs(check)
        names = book.own(check.requirements)
        if names == check.requirements or not names:
            return check if names else None
        return replace(check, requirements=names, shared=check.requirements)

    def _check_rig_needs(self, check: Check) -> None:
        for capability in check.rig_needs:
            if capability not in self.rig_controls:
                known = ", ".join(self.rig_controls)
                raise TypeError(f"{check.name}: no rig works {capability!r}; choose from {known}")


def _modules(kind: str, packages: Iterable[str]) -> tuple[str, ...]:
    """The modules in the folder `kind` of the packages, by their `ORDER` (0: it has none), then
    by name."""
    found = []
    for package in packages:
        folder = f"{package}.{kind}"
        if importlib.util.find_spec(folder) is not None:
            names = pkgutil.iter_modules(importlib.import_module(folder).__path__, f"{folder}.")
            found += [importlib.import_module(module.name) for module in names]
    found.sort(key=lambda module: (getattr(module, "ORDER", 0), module.__name__))
    return tuple(module.__name__ for module in found)


def _found(modules: Iterable[str], kind: type[T], home: Callable[[T], str]) -> Iterator[T]:
    """Everything of a kind that stands in these modules, in the order of their text; not what they
    have imported."""
    for name in modules:
        for candidate in vars(importlib.import_module(name)).values():
            if isinstance(candidate, kind) and home(candidate) == name:
                yield candidate
