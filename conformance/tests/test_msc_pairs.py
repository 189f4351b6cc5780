"""MSC units whose readings hide or imitate one another: none of them fails, each is told rightly.

Each was judged wrongly once; `scripts/sweep_quirks --at-once 8 msc-250` looks for more.
"""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from sweeping.runs import VIRTUAL, Setting
from sweeping.sweeps import QuirkSweep

pytestmark = pytest.mark.strength(seconds=60)

PAIRS: Mapping[str, str] = {
    "it loses signs, and no probe on two wires shows it":
        "response_delay_ms=0 turnaround_ms=0 rx_while_busy=drop ack_timeout_ms=110"
        " reply_delay_ms=132",
    "it loses signs, and T1 is over before it answers":
        "packet_timeout_ms=262 rx_while_busy=drop ack_timeout_ms=179",
    "it loses signs, and answers later than T2": "response_delay_ms=1864 rx_while_busy=drop",
    "it refuses a sign, and a neighbour what it takes for a packet":
        "packet_timeout_ms=416 ack_timeout_ms=179 stx_while_waiting=as_nak",
    "junk draws a repeat later than T2": "response_delay_ms=2291 junk_while_waiting=as_nak",
    "a broken packet is nobody's, and the reply waits as before":
        "response_delay_ms=2674 pending_reply_on_stx=keep_if_foreign",
    "it refuses every zero, seconds later":
        "response_delay_ms=3000 reply_delay_ms=3000 noise_in_idle=nak",
    "it refuses what it finds in a packet for nobody":
        "packet_timeout_ms=262 rs232_unit_check=nak other_unit_framing=hunt_stx transport=rs232",
    "it refuses what it finds in a packet for another":
        "other_unit_framing=hunt_stx invalid_unit=nak",
    "it refuses as noise each byte behind a header for another":
        "other_unit_framing=hunt_stx noise_in_idle=nak transport=rs232",
    "it refuses noise while the host still sends it": "noise_in_idle=nak transport=rs485",
    "it refuses such noise, and numbers that are not its own":
        "rs232_unit_check=nak other_unit_framing=hunt_stx noise_in_idle=nak transport=rs232",
    "the neighbours refuse with it what names no unit":
        "invalid_unit=nak packet_timeout_mode=interbyte",
    "its data area ends between two multiples of four":
        "data_address_stride=1 data_size=32770 block_overrun=wrap",
    "its data area ends elsewhere, and reads 0 behind that":
        "data_size=32766 data_out_of_range=zero",
    "its scans are counted by exchanges of six seconds": "reply_delay_ms=9 response_delay_ms=3000",
    "its scan is longer than an exchange, and its reply comes a second later":
        "scan_ms=39 reply_delay_ms=3000",
    "four wires of RS-485 are not told from RS-232": "transport=rs485 rs485_mode=four_wire",
}  # fmt: skip


@pytest.mark.parametrize("readings", PAIRS.values(), ids=PAIRS)
def test_readings_that_touch_each_other_fail_nothing(readings: str) -> None:
    """No failure, no error, nothing told that is not so."""
    sweep = QuirkSweep(Setting("msc-250", VIRTUAL, "quick", 300), seed=1)
    row = sweep.judge_readings(dict(one.split("=") for one in readings.split()))
    assert row["outcome"] in ("sound", "unread"), row["why"]
