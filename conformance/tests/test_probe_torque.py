"""The probes leave the axis the torque it had: those that follow have to move it."""

from __future__ import annotations

from typing import Any

import pytest

from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.device import detection
from axistwin_conformance.engine.run import Engine

pytestmark = pytest.mark.strength


@pytest.mark.parametrize("model", ["mac23", "mac23-can"])
def test_no_probe_leaves_another_torque_limit(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither between the probes nor after them; resets and factory values apart."""
    ask, kept = detection._ask, []

    def asking(run: Any, probe: Any, device_guard: Any) -> Any:
        twin = run.target.twins[0]
        before = twin.cells["torque"]
        answer = ask(run, probe, device_guard)
        if "destructive" not in probe.check.safety:
            kept.append((probe.switch, before == twin.cells["torque"]))
        return answer

    monkeypatch.setattr(detection, "_ask", asking)
    options = make_options(model=model, is_detection=True)
    Engine(options).run(lambda event: None)
    assert len(kept) > 40
    assert [switch for switch, is_kept in kept if not is_kept] == []
