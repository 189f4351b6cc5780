"""Checks of the MSC family run on small units of the tests' own, sound ones and faulty ones."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import Any

from msc_faults import SCRATCH
from msc_twin import TwinPort, session_on

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.core.session import Stop
from axistwin_conformance.families.msc.family import FAMILY
from axistwin_conformance.families.msc.rig_controls import MSC_CONTROLS
from axistwin_conformance.transport.rig import TwinRig

LINK_MODULES = tuple(
    f"axistwin_conformance.families.msc.checks.{name}"
    for name in ("packets", "link", "repeats", "time", "line", "wire", "random", "golden")
)


def link_checks() -> dict[str, Check]:
    """The checks of packets, link, time, line and what is drawn of them, by name."""
    return {one.name: one for one in FAMILY.checks() if one.module in LINK_MODULES}


def judge(name: str, port: TwinPort, **how: Any) -> tuple[Finding, ...]:
    """Run one check on that unit; nothing it may not send is sent."""
    check = next(one for one in FAMILY.checks() if one.name == name)
    usual = {
        "allowed": frozenset(SAFETY_CLASSES),
        "settings": SCRATCH,
        "neighbours": port.others,
    }
    session = session_on(port, check, **(usual | how))
    rig = TwinRig(session.target, port.unit, MSC_CONTROLS)
    session.run.rig, rig.is_exact = rig, True
    if "rig" not in check.safety:  # or the guard would let everything pass
        session.target.description = "axistwin://a-small-one?time=virtual"

    def gate(data: bytes) -> None:
        reason = FAMILY.forbid(session, data)
        assert reason is None, f"{name} sends what its class does not allow: {reason}"

    session.target.gate = gate
    with contextlib.suppress(Stop):
        check(session)
    return session.conclude("")


def failed(findings: Iterable[Finding]) -> set[str]:
    """The requirements that failed."""
    return {one.requirement for one in findings if one.verdict is Verdict.FAIL}


def troubles(findings: Iterable[Finding]) -> list[str]:
    """All that is not a pass or a piece of information, in words."""
    fine = (Verdict.PASS, Verdict.INFO)
    return [
        f"{one.requirement} {one.verdict.name}: {one.text} {one.expected} {one.actual}"
        for one in findings
        if one.verdict not in fine
    ]
