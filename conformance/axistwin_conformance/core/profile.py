"""Profiles: which reading of each of the manual's open questions a device follows.

The detection phase asks them one by one (`Probe`), after the identity and before the checks.  What
came of each is a `Detection`; together they are the device's profile, to which every check holds it
for the rest of the run.  As a file (TOML) a profile makes a twin of that very device, or is what a
later run expects:

    model = "mac23"

    [quirks]
    xon_byte = "11h"          # MACS-AMB-01: an answer to 20h ends with 11h
    # xonerror_byte = "17h"   # MACS-AMB-02: ...   (the default, confirmed)
"""

from __future__ import annotations

import difflib
import os
import tempfile
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from axistwin_conformance.base.errors import UsageError, with_article
from axistwin_conformance.base.events import Departure, ProfileJudged
from axistwin_conformance.base.ledger import Ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.profile_values import Value, value_of

KEYS = ("model", "quirks")


@dataclass(frozen=True, slots=True)
class Detection:
    """What is known of one switch: its reading, or None and in `evidence` why not."""

    switch: str
    reading: str | None
    evidence: str
    candidates: tuple[str, ...] = ()  # not told apart; empty: nothing is excluded


def write_profile(path: Path, text: str) -> None:
    """Write a profile whole or not at all: beside its place first.  Raises OSError."""
    if path.exists() and not path.is_file():  # a pipe, /dev/stdout
        path.write_text(text, "utf-8")
        return
    place = path.resolve()  # of a link, the file it leads to
    handle, name = tempfile.mkstemp(prefix=f".{place.name}.", dir=place.parent)
    beside = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        beside.chmod(place.stat().st_mode & 0o777 if place.exists() else 0o666 & ~_umask())
        beside.replace(place)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def as_toml(model: str, ledger: Ledger, detections: Iterable[Detection], heading: str) -> str:
    """Return the profile of a device as the text of a file; defaults and what is not known are
    comments, so that a twin made from it follows its own defaults there."""
    lines = [f"# {line}" for line in heading.splitlines()]
    lines += [f'model = "{model}"', "", "[quirks]"]
    unknown = []
    for detection in detections:
        ambiguity = ledger.ambiguity_of(detection.switch)
        words = _one_line(f"{ambiguity.id}: {detection.evidence}")
        if detection.reading is None:
            unknown.append(f"# {detection.switch}: {words}")
            continue
        hidden = "# " if detection.reading == ambiguity.default_of(detection.switch) else ""
        lines.append(f'{hidden}{detection.switch} = "{detection.reading}"  # {words}')
    return "\n".join([*lines, *(["", "# Not known:", *unknown] if unknown else []), ""])


def _one_line(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def load_profile(path: Path, model: str, ledger: Ledger) -> dict[str, str]:
    """Read the readings a profile names; raises UsageError in one line for what cannot be meant.

    Configuration (factory values and the like) is passed over: nothing can be expected of it.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"cannot read the profile {path}: {error.strerror}") from error
    except RecursionError:
        raise UsageError(f"the profile {path} is not TOML: nested too deep") from None
    except ValueError as error:  # of TOML, of UTF-8, or a number with too many digits
        raise UsageError(f"the profile {path} is not TOML: {error}") from error
    for key in data:
        if key not in KEYS:
            raise UsageError(
                f"the profile {path} has {key!r}, which no profile has: {_near(key, KEYS)}"
            )
    if "model" not in data:
        is_empty = "is empty" if not data else "names no model"
        raise UsageError(
            f'the profile {path} {is_empty}: it begins with the model it is of, model = "{model}"'
        )
    named = data["model"]
    if named != model:
        whose, asked = with_article(named), with_article(model)
        raise UsageError(f"the profile {path} is of {whose}, not of {asked}")
    quirks = data.get("quirks", {})
    if not isinstance(quirks, dict):
        raise UsageError(f"the profile {path}: quirks must be a table of name = value")
    known = settable(ledger)
    readings = {
        switch: _reading(path, known, model, switch, value) for switch, value in quirks.items()
    }
    asked_of = known_switches(ledger)
    return {
        switch: reading
        for switch, reading in readings.items()
        if switch in asked_of and switch not in ledger.configuration
    }


def known_switches(ledger: Ledger) -> Mapping[str, Sequence[str]]:
    """Every switch of the ledger with its readings, the default first."""
    return {
        switch: readings
        for ambiguity in ledger.ambiguities.values()
        for switch, readings in ambiguity.switches.items()
    }


def settable(ledger: Ledger) -> Mapping[str, Value]:
    """How each name in a profile's table is written.  One with a single reading is no switch."""
    switches = {
        switch: value_of(switch, readings)
        for switch, readings in known_switches(ledger).items()
        if len(readings) > 1
    }
    return switches | {name: value_of(name, None) for name in ledger.configuration}


def _reading(path: Path, known: Mapping[str, Value], model: str, switch: str, value: Any) -> str:
    if switch not in known:
        near = difflib.get_close_matches(switch, known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"'axistwin models {model}' lists them"
        raise UsageError(f"the profile {path} names {switch!r}, which is no switch; {hint}")
    if not isinstance(value, str | int):
        raise UsageError(
            f"the profile {path}: {switch} = {value!r}: write a text, a number, true or false"
        )
    reading = known[switch].read(value)
    if reading is None:
        raise UsageError(
            f"the profile {path}: {switch} = {value!r} is no reading; write {known[switch].words}"
        )
    return reading


def _near(name: str, known: Iterable[str]) -> str:
    """The remedy for a misspelt name of a few."""
    near = difflib.get_close_matches(name.lower(), known, n=1)
    return f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}"


def held_to(
    profile: str,
    expected: Mapping[str, str],
    detections: Mapping[str, Detection],
    ledger: Ledger,
) -> ProfileJudged:
    """Judge what was detected by the readings a profile expects; a switch that it does not name is
    expected to follow the default."""
    departures, unseen, seen_count = [], [], 0
    for switch, one in detections.items():
        ambiguity = ledger.ambiguity_of(switch)
        wanted = expected.get(switch, ambiguity.default_of(switch))
        seen = one.candidates if one.reading is None else (one.reading,)
        seen_count += bool(seen)
        if seen and wanted not in seen:
            departures.append(
                Departure(switch, wanted, seen, ambiguity.id, ambiguity.question, one.evidence)
            )
    for switch in expected:
        if switch not in detections or not (
            detections[switch].reading or detections[switch].candidates
        ):
            unseen.append(switch)
    missing = f"not seen: {', '.join(unseen)}" if unseen else ""
    if departures:
        verdict, reasons = Verdict.FAIL, [departure.text for departure in departures]
    elif seen_count:
        verdict, reasons = Verdict.PASS, [f"{seen_count} readings seen, all as it says"]
    else:
        verdict, reasons = Verdict.NOT_RUN, ["no reading of the device was seen"]
    reason = "; ".join([*reasons, *filter(None, [missing])])
    return ProfileJudged(profile, verdict, reason, tuple(departures), tuple(unseen))
