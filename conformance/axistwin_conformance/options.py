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
from axistwin_conformance.base.write_budget import DEFAULT_BUDGET
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.identity import NO_SCRATCH, ScratchArea
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.transport.kinds import choose_endpoint
from axistwin_conformance.transport.transport import is_twin_url

if TYPE_CHECKING:
    from axistwin_conformance.base.recording import Recording
    from axistwin_conformance.core.session import Envelope
    from axistwin_conformance.engine.plan import Options

BENCH_TRAVEL = 2000  # increments: one turn of a MAC23, a fifth of a MAC34
BENCH_SPEED = 10_000  # increments per second: 300 rpm on a MAC23
TWIN_TRAVEL = 1_000_000
TWIN_SPEED = 1_000_000
DEFAULT_SOAK_S = 2 * 3600.0
ADDRESSES = 1 << 16  # of a controller
PROGRAM_STEP = 128  # addresses: where blocks begin that are apart in every reading


def usable_cores() -> int:
    """On how many cores this process may run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def make_options(
    *,
    model: str,
    ids: tuple[str, ...] = (),
    port: str | None = None,
    can: str | None = None,
    address: int | None = None,
    neighbours: tuple[int, ...] = (),
    baud: int | None = None,
    bitrate: int | None = None,
    allow: str | None = None,
    max_travel: int | None = None,
    max_speed: int | None = None,
    variables: range | None = None,
    flags: range | None = None,
    bench_program: tuple[int, int] | None = None,
    eeprom_budget: int | None = None,
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
) -> Options:
    """Turn what was typed into options; raises UsageError in one line for what cannot be meant."""
    from axistwin_conformance.engine.plan import Options

    family = find_family(model)
    endpoint, rate = choose_endpoint(
        family.transport_kind,
        model,
        {"--port": port, "--can": can},
        {"--baud": baud, "--bitrate": bitrate},
    )
    is_builtin, is_twin = endpoint is None, endpoint is None or is_twin_url(endpoint)
    address, neighbours = _addresses(family, address, neighbours, is_builtin=is_builtin)
    if is_builtin and rate is not None:
        _check_rate(family, model, rate)
    _check_duration(duration, level)
    _refuse_bounds(family, model, {"--max-travel": max_travel, "--max-speed": max_speed})
    granted = {"--variables": variables, "--flags": flags, "--bench-program": bench_program}
    others = {"an ID": ids, "--level": level, "--detect": is_detection}
    allowed = parse_allowed(allow, is_builtin=is_builtin)
    options = Options(
        family=family,
        model=model,
        endpoint=endpoint,
        address=address,
        neighbours=neighbours,
        rate=rate or family.default_rate,
        allowed=allowed,
        envelope=_envelope(max_travel, max_speed, is_builtin=is_builtin, is_twin=is_twin),
        scratch=_grounds(family, model, granted, is_builtin=is_builtin),
        level=level or FULL,
        seed=seed,
        words=ids,
        is_detection=is_detection,
        is_only_detection=is_detection and not ids and level is None,
        expected=None if profile is None else _expected(profile, family, model),
        profile="" if profile is None else str(profile),
        is_exitfirst=exitfirst,
        duration_s=(duration or DEFAULT_SOAK_S) if level == SOAK else None,
        recording=None if replay is None else _recording(family, model, replay, others),
        replay_word=replay or "",
        report=report,
        jobs=jobs,
        eeprom_budget=_writes(family, model, eeprom_budget, is_twin=is_twin),
    )
    return _with_rig(options, rig, rig_command)


def _with_rig(options: Options, kind: str | None, command: str | None) -> Options:
    """The options with the rig that was chosen.  A program that nobody has named may be the one
    that works the machine: no rig stops or starts it."""
    from axistwin_conformance.transport.rig import choose_rig

    able = options.family.capabilities
    if options.scratch.program is None:
        able -= {"program"}
    choice = choose_rig(
        kind,
        command,
        options.url,
        is_allowed="rig" in options.allowed,
        transport_kind=options.family.transport_kind,
        capabilities=able,
    )
    return replace(options, rig=choice)


def _check_rate(family: Family, model: str, rate: int) -> None:
    """Raise UsageError for a rate that no device of the family has."""
    if rate not in (family.rates or (rate,)):
        known = ", ".join(map(str, family.rates))
        raise UsageError(
            f"{family.transport_kind.rate_option} {rate}: {with_article(model)} knows {known}"
        )


def _refuse_bounds(family: Family, model: str, bounds: Mapping[str, int | None]) -> None:
    """Raise UsageError for bounds of motion where the suite moves nothing."""
    for option, bound in bounds.items():
        if bound is not None and not family.has_axis:
            raise UsageError(f"{option} {bound}: the suite drives no axis of {with_article(model)}")


def _grounds(
    family: Family, model: str, given: Mapping[str, Any], *, is_builtin: bool
) -> ScratchArea:
    """What of a controller is the suite's to use: as named, else what the built-in twin has."""
    named = {option: ground for option, ground in given.items() if ground is not None}
    if family.scratch is None:
        for option in named:
            raise UsageError(
                f"{option}: {with_article(model)} has no variables and no flags to be named"
            )
        return NO_SCRATCH
    own = family.scratch if is_builtin else NO_SCRATCH
    scratch = ScratchArea(
        named.get("--variables", own.variables),
        named.get("--flags", own.flags),
        named.get("--bench-program", own.program),
    )
    _check_program(scratch)
    return scratch


def _check_program(scratch: ScratchArea) -> None:
    """Raise UsageError for a bench program that cannot be there, or that shares what it has."""
    if scratch.program is None:
        return
    flag, address = scratch.program
    told = f"--bench-program {flag}:{address}"
    if address % PROGRAM_STEP:
        raise UsageError(f"{told}: its ADDRESS is a multiple of {PROGRAM_STEP}")
    variables, flags = scratch.of_program
    if variables[-1] >= ADDRESSES:
        raise UsageError(
            f"{told} has {len(variables)} addresses, the last of them {variables[-1]}: its ADDRESS"
            f" is {ADDRESSES - len(variables)} at most"
        )
    for option, own, named in (
        ("--variables", variables, scratch.variables), ("--flags", flags, scratch.flags)
    ):  # fmt: skip
        if named and own.start < named.stop and named.start < own.stop:
            raise UsageError(
                f"{told} has {own[0]}-{own[-1]} to itself: {option} {named[0]}-{named[-1]} must"
                " not reach into it"
            )


def _writes(family: Family, model: str, budget: int | None, *, is_twin: bool) -> int | None:
    """How many writes to an EEPROM may be asked for; None: any number, or there is none."""
    if budget is not None and not family.has_axis:
        raise UsageError(f"--eeprom-budget {budget}: {model} has no EEPROM that the suite writes")
    return DEFAULT_BUDGET if budget is None and not is_twin and family.has_axis else budget


def _envelope(
    max_travel: int | None, max_speed: int | None, *, is_builtin: bool, is_twin: bool
) -> Envelope:
    """The bounds of motion; enforced unless nobody has asked for any and a twin is moved."""
    from axistwin_conformance.core.session import Envelope

    return Envelope(
        max_travel or (TWIN_TRAVEL if is_builtin else BENCH_TRAVEL),
        max_speed or (TWIN_SPEED if is_builtin else BENCH_SPEED),
        is_guarded=bool(max_travel or max_speed) or not is_twin,
    )


def _recording(family: Family, model: str, word: str, others: Mapping[str, object]) -> Recording:
    """Read what to replay; raises UsageError for that, and for others that do not go with it."""
    from axistwin_conformance.base.recording import load_recording

    for name, other in others.items():
        if other:
            raise UsageError(f"--replay plays its operations and nothing else: leave out {name}")
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
    """The address to judge and those of further modules, of which the built-in twin has one."""
    address = family.default_address if address is None else address
    if is_builtin and not neighbours:
        neighbours = (_other_address(family, address),)
    for one in (address, *neighbours):
        if one not in family.addresses:
            low, high = family.addresses[0], family.addresses[-1]
            raise UsageError(f"address {one} is out of range: choose {low} to {high}")
    if len({address, *neighbours}) <= len(neighbours):
        raise UsageError("--address and every --neighbour must differ from one another")
    return address, neighbours


def _other_address(family: Family, address: int) -> int:
    """An address for the twin's neighbour; wraps at the end of the range."""
    return family.addresses[(address + 1 - family.addresses[0]) % len(family.addresses)]
