"""Devices whose numbers lie at the edge of what a device may have: nothing that they do fails.

Each was judged wrongly once; `scripts/sweep_quirks --singles` looks for more.
"""

from __future__ import annotations

import pytest
from sweeping.runs import VIRTUAL, Setting
from sweeping.sweeps import QuirkSweep

from axistwin.devices.mac.axis.axis import _PARAMETERS
from axistwin.devices.mac.axis.drive import Drive
from axistwin.devices.mac.axis.parameters import Parameters
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.options import make_options

pytestmark = pytest.mark.strength(seconds=60)

EDGES = [
    ("mac23", "factory_superior_stop", "-2147483648"),  # every place is beyond it
    ("mac23", "factory_superior_stop", "200"),
    ("mac23", "factory_inferior_stop", "2147483647"),
    ("mac23-can", "factory_superior_stop", "-2147483648"),
    ("mac23", "brake_increments", "65535"),
    ("mac23-can", "brake_increments", "65535"),
    ("mac23-can", "reserved_bits", "1"),
    ("msc-250", "response_delay_ms", "0"),
    ("msc-250", "response_delay_ms", "1100"),
    ("msc-250", "response_delay_ms", "3000"),
    ("msc-250", "reply_delay_ms", "3000"),
    ("msc-250", "packet_timeout_ms", "60000"),
    ("msc-250", "ack_timeout_ms", "60000"),
    ("msc-250", "ack_timeout_ms", "100"),
    ("msc-250", "rflags_unsupported", "ack_no_reply"),  # it has RFLAGS
    ("mac23", "reply_latency_us", "450000"),
    ("mac23-can", "reply_latency_us", "300000"),
    ("mn400", "multiplex_cap", "error"),  # it refuses what others clip
    ("mn400", "feedhold_power_on", "1"),
]


@pytest.mark.parametrize(("model", "switch", "value"), EDGES)
def test_a_number_at_its_edge_fails_nothing(model: str, switch: str, value: str) -> None:
    """No failure, no error, nothing told that is not so."""
    sweep = QuirkSweep(Setting(model, VIRTUAL, "quick", 300), seed=1)
    row = sweep.judge_readings({switch: value})
    assert row["outcome"] in ("sound", "unread"), row["why"]


def test_who_takes_too_much_torque_as_the_imax_that_he_refuses_fails_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """0Ch refuses Imax itself, and clamps to it: two readings of MACS-AMB-10 at once."""

    def clamped(parameters: Parameters, number: int) -> bool:
        value, imax = number & 0xFF, parameters._quirks.imax_value
        return parameters._set("torque", min(value, imax) if 0 < value != imax else None)

    monkeypatch.setitem(_PARAMETERS, 0x0C, (clamped, Drive.torque_changed))
    sweep = QuirkSweep(Setting("mac23", VIRTUAL, "quick", 300), seed=1)
    row = sweep.judge_readings({"torque_range": "exclusive", "torque_over": "clamp"})
    assert row["outcome"] == "sound", row["why"]


def test_the_longest_payload_is_found_however_long_it_takes_on_the_line() -> None:
    """A port is given 3 s to take what is written; 9000 characters take 9."""
    sweep = QuirkSweep(Setting("mn400", VIRTUAL, "quick", 300), seed=1)
    row = sweep.judge_readings({"rx_payload_max": "9000"})
    assert row["outcome"] == "sound", row["why"]


def test_a_target_that_slow_replies_let_be_reached_is_not_behind() -> None:
    """0Bh on the way comes when the move is over: the check tells that, and fails nothing."""
    url = "axistwin://mac23:0?time=virtual&quirk.reply_latency_us=450000"
    name = "a_target_left_behind_is_returned_to"
    options = make_options(model="mac23", port=url, ids=(name,), allow="motion,stored")
    (ran,) = Engine(options).run(lambda event: None).checks
    told = {finding.verdict: finding.text for finding in ran.findings}
    assert Verdict.FAIL not in told
    assert told[Verdict.NOT_RUN] == "its replies take too long to tell"
