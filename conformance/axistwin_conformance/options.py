"""From the words of the command line to the options of a run; every mistake is one line."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from axistwin_conformance.base.classes import FULL, SAFETY_CLASSES, SOAK
from axistwin_conformance.base.errors import UsageError, with_article
from axistwin_conformance.core.family import Family
from axistwin_conformance.families.catalog import family_options, find_family
from axistwin_conformance.transport.kinds import choose_endpoint
from axistwin_conformance.transport.transport import is_twin_url

if TYPE_CHECKING:
    from axistwin_conformance.base.recording import Recording
    from axistwin_conformance.engine.plan import Options

DEFAULT_SOAK_S = 2 * 3600.0


def usable_cores() -> int:
    """On how many cores this process may run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def make_options(
    *,
    model: str,
    ids: tuple[str, ...] = (),
    port: str | None = None,
    can: str | None = None,
    hid: str | None = None,
    address: int | None = None,
    neighbours: tuple[int, ...] = (),
    baud: int | None = None,
    bitrate: int | None = None,
    allow: str | None = None,
    rig: str | None = None,
    rig_command: str | None = None,
    level: str | None = None,
    seed: int = 0,
    is_detection: bool = False,
    profile: Path | None = None,
    exitfirst: bool = False,
    duration: float | None = None,
    replay: str | None = None,
    report: str = "",
    jobs: int = 1,
    **of_families: Any,
) -> Options:
    """Turn what was typed into options; raises UsageError in one line for what cannot be meant.

    `of_families`: the options that families have declared, by `FamilyOption.parameter`.
    """
    from axistwin_conformance.engine.plan import Options

    endpoints = {"--port": port, "--can": can, "--hid": hid}
    rates = {"--baud": baud, "--bitrate": bitrate}
    family, endpoint, rate = _reached(model, endpoints, rates)
    is_builtin, is_twin = endpoint is None, endpoint is None or is_twin_url(endpoint)
    address, neighbours = _addresses(family, address, neighbours, is_builtin=is_builtin)
    _check_rate(family, model, rate if is_builtin else None)
    _check_duration(duration, level)
    _refuse_foreign(family, model, of_families)
    others = {"an ID": ids, "--level": level, "--detect": is_detection}
    options = Options(
        family=family,
        model=model,
        endpoint=endpoint,
        address=address,
        neighbours=neighbours,
        rate=rate or family.default_rate,
        allowed=parse_allowed(allow, is_builtin=is_builtin),
        settings=family.options.settings(of_families, is_builtin=is_builtin, is_twin=is_twin),
        level=level or FULL,
        seed=seed,
        words=ids,
        is_detection=is_detection,
        is_only_detection=_is_only_detection(family, ids, is_detection and level is None),
        expected=None if profile is None else _expected(profile, family, model),
        profile="" if profile is None else str(profile),
        is_exitfirst=exitfirst,
        duration_s=(duration or DEFAULT_SOAK_S) if level == SOAK else None,
        recording=None if replay is None else _recording(family, model, replay, others),
        replay_word=replay or "",
        report=report,
        jobs=jobs,
    )
    return _with_rig(options, rig, rig_command)


def _reached(
    model: str, endpoints: Mapping[str, str | None], rates: Mapping[str, int | None]
) -> tuple[Family, str | None, int | None]:
    """The family that judges the model the way that was given, where, and how fast."""
    family = find_family(model)
    over = family.models[model].over
    kinds = (family.transport_kind, *over)
    kind, endpoint, rate = choose_endpoint(kinds, model, endpoints, rates)
    return over.get(kind, family), endpoint, rate


def _is_only_detection(family: Family, ids: tuple[str, ...], is_wanted: bool) -> bool:
    """True if there is nothing to judge: every word is a switch, or there is none."""
    switches = {probe.switch for probe in family.probes()} if ids else set()
    return switches.issuperset(ids) if ids else is_wanted


def _with_rig(options: Options, kind: str | None, command: str | None) -> Options:
    """The options with the rig that was chosen."""
    from axistwin_conformance.transport.rig import choose_rig

    choice = choose_rig(
        kind,
        command,
        options.url,
        is_allowed="rig" in options.allowed,
        transport_kind=options.family.transport_kind,
        capabilities=options.family.rig_controls.keys() - options.settings.withheld.keys(),
    )
    return replace(options, rig=choice)


def _check_rate(family: Family, model: str, rate: int | None) -> None:
    """Raise UsageError for a rate that no device of the family has."""
    if rate is not None and rate not in (family.rates or (rate,)):
        known = ", ".join(map(str, family.rates))
        raise UsageError(
            f"{family.transport_kind.rate_option} {rate}: {with_article(model)} knows {known}"
        )


def _refuse_foreign(family: Family, model: str, given: Mapping[str, Any]) -> None:
    """Raise UsageError for an option of another family, TypeError for one of no family."""
    known = {option.parameter: option for option in family_options()}
    for name, value in given.items():
        option = known.get(name)
        if option is None:
            raise TypeError(f"no family has an option {name}")
        if value is not None and option not in family.options.declared:
            why = option.refusal.format(value=value, model=model, a_model=with_article(model))
            raise UsageError(f"--{option.name}{why}")


def _recording(family: Family, model: str, word: str, others: Mapping[str, object]) -> Recording:
    """Read what to replay; raises UsageError for that, and for others that do not go with it."""
    from axistwin_conformance.base.recording import load_recording

    for name, other in others.items():
        if other:
            raise UsageError(f"--replay plays its operations and nothing else: leave out {name}")
    if not family.operation_bytes:
        raise UsageError(f"--replay: nothing records operations of {with_article(model)}")
    return load_recording(word, model, family.operation_bytes)


def _expected(path: Path, family: Family, model: str) -> dict[str, str]:
    from axistwin_conformance.base.ledger import load_ledger
    from axistwin_conformance.core.profile import load_profile

    return load_profile(path, model, load_ledger(family.name))


def parse_allowed(text: str | None, *, is_builtin: bool) -> frozenset[str]:
    """Read the list of `--allow`; raises UsageError for a class that is none."""
    if text is None:
        return frozenset(SAFETY_CLASSES) if is_builtin else frozenset({"passive"})
    words = [word.strip() for word in text.split(",") if word.strip()]
    for word in words:
        if word not in SAFETY_CLASSES:
            near = difflib.get_close_matches(word, SAFETY_CLASSES, n=1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise UsageError(
                f"--allow {word}: there is no such class; {hint}choose of"
                f" {', '.join(SAFETY_CLASSES)}, separated by commas"
            )
    return frozenset({"passive", *words})


def _check_duration(duration: float | None, level: str | None) -> None:
    if duration is not None and level != SOAK:
        raise UsageError(f"--duration is how long a soak takes: add --level {SOAK}")


def _addresses(
    family: Family, address: int | None, neighbours: tuple[int, ...], *, is_builtin: bool
) -> tuple[int, tuple[int, ...]]:
    """The address to judge and those of further modules, of which the built-in twin has one where
    there is an address for it."""
    address = family.default_address if address is None else address
    if is_builtin and not neighbours and len(family.addresses) > 1:
        neighbours = (_other_address(family, address),)
    for number in (address, *neighbours):
        if number not in family.addresses:
            low, high = family.addresses[0], family.addresses[-1]
            raise UsageError(f"address {number} is out of range: choose {low} to {high}")
    if len({address, *neighbours}) <= len(neighbours):
        raise UsageError("--address and every --neighbour must differ from one another")
    return address, neighbours


def _other_address(family: Family, address: int) -> int:
    """An address for the twin's neighbour; wraps at the end of the range."""
    return family.addresses[(address + 1 - family.addresses[0]) % len(family.addresses)]
