"""The requirement ledger as data: what is asked of a device, and where the manual leaves it open.

The TOML files under `ledger/` are the suite's own reading; this module loads and checks them.

Two families with one axis leave the same things open.  An ambiguity is written down once; the other
ledger has, under the same id, `same_as` with the name of the first one's ledger.  What it says
beside that (question, detect, departs) takes the place of what is said there, and `without` names
switches that the family does not have.  Requirements are each family's own, so `departs` is never
taken over; but checks of the axis name the requirements of the first ledger, and the other one says
of each of its own which of those it `covers`.  Switches of the first ledger that the other one does
not have are questions it does not ask: there the default holds, and nobody looks.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable

from axistwin_conformance.base.classes import SAFETY_CLASSES

CHAPTER = re.compile(r"[IVX]+(\.[0-9]+)?")
ELSEWHERE = "not in this device's own manual"
LEFT_OPEN = "The manual leaves this open"  # begins the rule of an ambiguity
ANY_READING = "*"  # in a list of readings: any other value is admissible too (a measured time)


class RequirementKind(StrEnum):
    """On what ground a requirement stands."""

    MUST = "must"  # stated by a manual
    DERIVED = "derived"  # follows from stated facts
    INTERPRETATION = "interpretation"  # a manual leaves it open; a switch names the readings


@dataclass(frozen=True, slots=True)
class Requirement:
    """One thing asked of the device.

    `safety`: what judging it may do to the device.  `text`: the requirement in our words.
    `where`: the source in words: title and chapter.
    `observable`: by what the wire shows it.  `quirks`: ids of the ambiguities it rests on.
    `not_on_wire`: why the wire cannot show it; empty if it can.  `covers`: what another ledger asks
    of the same axis, so that what is judged by its name is judged here by this one.
    """

    id: str
    kind: RequirementKind
    safety: frozenset[str]
    source: str
    text: str
    observable: str
    quirks: tuple[str, ...] = ()
    not_on_wire: str = ""
    covers: tuple[str, ...] = ()
    where: str = ""


@dataclass(frozen=True, slots=True)
class Sources:
    """What the abbreviations of sources stand for.

    `titles`: of manuals, that of the device first; the one without abbreviation is meant where none
    is named.  `places`: in a manual; one that ends with a dash is followed by a number.
    """

    titles: Mapping[str, str]
    places: Mapping[str, str]

    def in_words(self, source: str) -> str:
        """``S II, 13h``: the manual's title, and where in it."""
        told: list[list[str]] = [[self.titles[""]]] if "" in self.titles else []
        for part in source.split(", "):
            named, _, rest = part.partition(" ")
            if named in self.titles:
                told.append([self.titles[named], *([self._place(rest)] if rest else [])])
            elif told:
                told[-1].append(self._place(part))
            else:
                told.append([part])
        titles, cited = [*self.titles.values()], {one[0] for one in told}
        is_elsewhere = bool(cited.intersection(titles)) and titles[0] not in cited
        remarks = [ELSEWHERE] if is_elsewhere else []
        return "; ".join([*(", ".join(one) for one in told), *remarks])

    def _place(self, place: str) -> str:
        if place in self.places:
            return self.places[place]
        prefix, _, number = place.rpartition("-")
        if f"{prefix}-" in self.places:
            return f"{self.places[f'{prefix}-']} {number}"
        if place.startswith("Q"):
            return f"request {place[1:]}"
        return f"chapter {place}" if CHAPTER.fullmatch(place) else place


@dataclass(frozen=True, slots=True)
class Ambiguity:
    """A place where the manual can be read in several ways.

    `switches`: switch name → its readings, the default first.  No switch: nothing a device could
    do differently.  `departs`: requirements that some of the readings go against.  `words`: switch
    name → what a device of each reading does, in the order of the readings, behind "the device".
    """

    id: str
    question: str
    switches: Mapping[str, tuple[str, ...]]
    detect: str
    departs: tuple[str, ...] = ()
    words: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def in_words(self, switch: str, reading: str) -> str:
        """What a device of that reading does: ``ignored it``."""
        readings, words = self.switches[switch], self.words.get(switch, ())
        if reading in readings[: len(words)]:
            return words[readings.index(reading)]
        if words and readings[-1] == ANY_READING:
            return words[-1].replace(ANY_READING, reading)
        return f"behaved as {switch}={reading}"

    def either(self, switch: str) -> str:
        """What devices of all readings do: ``refused it, ignored it or answered 0``."""
        *others, last = (self.in_words(switch, one) for one in self.switches[switch])
        return f"{', '.join(others)} or {last}" if others else last

    def rule(self, switch: str) -> str:
        """What is asked of a device, since the manual leaves open what it does."""
        return (
            f"{LEFT_OPEN} ({self.id}: {self.question.rstrip('.')}). Admissible is"
            f" a device that {self.either(switch)}, each time the same."
        ).replace(ANY_READING, "N")

    def default_of(self, switch: str) -> str:
        """Return the reading that is taken unless a device shows another."""
        return self.switches[switch][0]

    def check_reading(self, switch: str, reading: str) -> None:
        """Raise ValueError if the reading is not one of the admissible ones."""
        readings = self.switches[switch]
        if reading not in readings and ANY_READING not in readings:
            raise ValueError(f"{switch}={reading!r} is no reading of {self.id}: {readings}")


@dataclass(frozen=True, slots=True)
class Ledger:
    """All requirements and ambiguities of one device family."""

    name: str
    requirements: Mapping[str, Requirement]
    ambiguities: Mapping[str, Ambiguity]
    configuration: frozenset[str] = frozenset()  # what a profile may hold and nobody judges
    covering: Mapping[str, str] = field(default_factory=dict)  # see `Requirement.covers`
    foreign: frozenset[str] = frozenset()  # all requirements of the ledger that it covers from
    # Switches of that ledger whose question this one does not ask, each with its ambiguity there.
    unasked: Mapping[str, Ambiguity] = field(default_factory=dict)

    def knows(self, name: str) -> bool:
        """True for a requirement of this ledger, or of the one that it covers from."""
        return name in self.requirements or name in self.foreign

    def own(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return this ledger's names of requirements, each once; what another ledger asks of the
        axis and this one does not is left out."""
        known = (name if name in self.requirements else self.covering.get(name) for name in names)
        return tuple(dict.fromkeys(name for name in known if name is not None))

    def asks(self, switch: str) -> bool:
        """True if this ledger leaves open what the switch tells, False if only the one that it
        covers from does; raises ValueError for a switch that neither has."""
        self.ambiguity_of(switch)
        return switch not in self.unasked

    def ambiguity_of(self, switch: str) -> Ambiguity:
        """Return the ambiguity a switch belongs to, here or else in the ledger that this one covers
        from; raises ValueError for a switch that neither has."""
        for ambiguity in self.ambiguities.values():
            if switch in ambiguity.switches:
                return ambiguity
        if switch in self.unasked:
            return self.unasked[switch]
        raise ValueError(f"no ambiguity of {self.name} has a switch {switch!r}")


def family_folder(name: str) -> Traversable:
    """Where a family keeps its data: the ledger, the golden exchanges, what is armed."""
    return resources.files(f"axistwin_conformance.families.{name.replace('_', '.')}")


@cache
def load_ledger(name: str) -> Ledger:
    """Load a shipped ledger; raises ValueError naming the entry if it contradicts itself."""
    path = family_folder(name) / "ledger.toml"
    return parse_ledger(name, path.read_text(encoding="utf-8"))


def parse_ledger(name: str, text: str) -> Ledger:
    """Parse a ledger from TOML text; raises ValueError naming the entry that is wrong."""
    data = tomllib.loads(text)
    sources = Sources(data.get("titles", {}), data.get("places", {}))
    requirements = {
        key: _requirement(key, row, sources) for key, row in data["requirement"].items()
    }
    ambiguities = {key: _ambiguity(key, row) for key, row in data["ambiguity"].items()}
    _refuse_shared_switches(ambiguities.values())
    for requirement in requirements.values():
        for quirk in requirement.quirks:
            if quirk not in ambiguities:
                raise ValueError(f"{requirement.id}: unknown ambiguity {quirk}")
    for ambiguity in ambiguities.values():
        for departed in ambiguity.departs:
            if departed not in requirements:
                raise ValueError(f"{ambiguity.id}: unknown requirement {departed}")
    configuration = frozenset(_words(data.get("configuration", [])))
    other = load_ledger(data["covers"]) if "covers" in data else None
    foreign = frozenset(other.requirements if other else ())
    covering = _covering(requirements.values(), foreign)
    asked = _switches(ambiguities.values())
    unasked = {
        switch: ambiguity
        for switch, ambiguity in _switches(other.ambiguities.values() if other else ()).items()
        if switch not in asked
    }
    return Ledger(name, requirements, ambiguities, configuration, covering, foreign, unasked)


def _switches(ambiguities: Iterable[Ambiguity]) -> dict[str, Ambiguity]:
    """Every switch with the ambiguity it belongs to."""
    return {switch: ambiguity for ambiguity in ambiguities for switch in ambiguity.switches}


def _covering(requirements: Iterable[Requirement], foreign: frozenset[str]) -> dict[str, str]:
    """Whose requirement each one of another ledger is here."""
    covering: dict[str, str] = {}
    for requirement in requirements:
        for other in requirement.covers:
            if other not in foreign:
                raise ValueError(f"{requirement.id}: covers {other}, which is no requirement there")
            if (owner := covering.setdefault(other, requirement.id)) != requirement.id:
                raise ValueError(f"{requirement.id}: {other} is covered by {owner} already")
    return covering


def _refuse_shared_switches(ambiguities: Iterable[Ambiguity]) -> None:
    """A switch answers one question: its readings are listed in one place."""
    owners: dict[str, str] = {}
    for ambiguity in ambiguities:
        for switch in ambiguity.switches:
            if (owner := owners.setdefault(switch, ambiguity.id)) != ambiguity.id:
                raise ValueError(f"{ambiguity.id}: the switch {switch} belongs to {owner} already")


def _requirement(key: str, row: Mapping[str, object], sources: Sources) -> Requirement:
    try:
        safety = frozenset(str(row["safety"]).split())
        if not safety <= set(SAFETY_CLASSES):
            raise ValueError(f"safety {sorted(safety)} has a class that is none")
        return Requirement(
            id=key,
            kind=RequirementKind(str(row["kind"])),
            safety=safety,
            source=str(row["source"]),
            text=str(row["text"]),
            observable=str(row.get("observable", "")),
            quirks=_words(row.get("quirks", [])),
            not_on_wire=str(row.get("not_on_wire", "")),
            covers=_words(row.get("covers", [])),
            where=sources.in_words(str(row["source"])),
        )
    except (KeyError, ValueError) as error:
        raise ValueError(f"requirement {key}: {error}") from error


def _ambiguity(key: str, row: Mapping[str, object]) -> Ambiguity:
    if "same_as" in row:
        row = _taken_over(key, row)
    switches = row.get("switches", {})
    words = row.get("words", {})
    if not isinstance(switches, dict) or not all(switches.values()):
        raise ValueError(f"ambiguity {key}: switches is a table of non-empty lists")
    if not isinstance(words, dict) or any(
        len(texts) != len(switches.get(switch, ())) for switch, texts in words.items()
    ):
        raise ValueError(f"ambiguity {key}: words is a table of as many texts as readings")
    try:
        return Ambiguity(
            id=key,
            question=str(row["question"]),
            switches={switch: _words(readings) for switch, readings in switches.items()},
            detect=str(row["detect"]),
            departs=_words(row.get("departs", [])),
            words={switch: _words(texts) for switch, texts in words.items()},
        )
    except KeyError as error:
        raise ValueError(f"ambiguity {key}: {error} is missing") from error


def _taken_over(key: str, row: Mapping[str, object]) -> Mapping[str, object]:
    """The row of an ambiguity that another ledger holds, with what this one says otherwise."""
    name = str(row["same_as"])
    other = load_ledger(name).ambiguities.get(key)
    if other is None:
        raise ValueError(f"ambiguity {key}: {name} has none of that id")
    if "switches" in row:
        raise ValueError(f"ambiguity {key}: its switches are those of {name}; use without")
    without = _words(row.get("without", []))
    if unknown := [switch for switch in without if switch not in other.switches]:
        raise ValueError(f"ambiguity {key}: without {unknown[0]}, which {name} does not have")
    own = {name: value for name, value in row.items() if name not in ("same_as", "without")}
    kept = {
        switch: list(readings)
        for switch, readings in other.switches.items()
        if switch not in without
    }
    words = {switch: list(other.words[switch]) for switch in kept if switch in other.words}
    told = {"question": other.question, "detect": other.detect}
    return {**told, "switches": kept, "words": words, **own}


def _words(value: object) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise ValueError(f"{value!r} is not a list")
    return tuple(str(item) for item in value)
