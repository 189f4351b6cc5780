"""The suite must fail a device that is wrong: a sound twin is heard through a lying ear."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import pytest
from click.testing import CliRunner

from axistwin_conformance.cli import conform
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.codec import SerialReply

Lie = Callable[[SerialReply], SerialReply]


def refusals_as_acceptance(reply: SerialReply) -> SerialReply:
    """A module that locks nothing."""
    return replace(reply, kind=ReplyKind.ACCEPTED) if reply.kind is ReplyKind.REFUSED else reply


def acceptance_as_refusal(reply: SerialReply) -> SerialReply:
    """A module that refuses everything, and does it all the same."""
    return replace(reply, kind=ReplyKind.REFUSED) if reply.kind is ReplyKind.ACCEPTED else reply


def positions_doubled(reply: SerialReply) -> SerialReply:
    """A module that counts two for one."""
    if reply.digit != 0 or reply.data is None:
        return reply
    return replace(reply, data=reply.data * 2 & 0xFFFFFFFF)


def busy_not_inverted(reply: SerialReply) -> SerialReply:
    """A module whose busy bit is 1 while busy."""
    if reply.digit != 7 or reply.data is None:
        return reply
    return replace(reply, data=reply.data ^ 0x0800)


def stops_one_bit_off_in_26h(reply: SerialReply) -> SerialReply:
    """A module that shows the wrong tolerance."""
    if reply.digit != 6 or reply.data is None:
        return reply
    return replace(reply, data=reply.data ^ 0x01)


def little_endian_stops(reply: SerialReply) -> SerialReply:
    """A module that sends its superior stop the wrong way round."""
    if reply.digit != 2 or reply.data is None:
        return reply
    return replace(reply, data=int.from_bytes(reply.data.to_bytes(4, "big"), "little"))


def ramp_kept_by_a_factory_reset() -> Lie:
    """A module whose 01h writes everything but the ramp: 26h goes on showing the one before."""
    kept = [0x0A]

    def lie(reply: SerialReply) -> SerialReply:
        if reply.digit != 6 or reply.data is None:
            return reply
        if reply.data >> 24 != 0x0A:  # the twin's factory value
            kept[0] = reply.data >> 24
        return replace(reply, data=reply.data & 0x00FFFFFF | kept[0] << 24)

    return lie


@pytest.mark.parametrize(
    ("lie", "check", "requirement"),
    [
        (refusals_as_acceptance, "a_move_is_refused_in_motion", "MACS-CMD-13-02"),
        (acceptance_as_refusal, "the_period_reads_back", "MACS-CMD-0D-01"),
        (positions_doubled, "moves_take_the_time_of_the_closed_form", "MACS-CMD-13-01"),
        (busy_not_inverted, "busy_ends_within_the_tolerance", "MACS-BUSY-01"),
        (stops_one_bit_off_in_26h, "the_tolerance_reads_back", "MACS-CMD-1C-01"),
        (
            ramp_kept_by_a_factory_reset(),
            "a_factory_reset_brings_the_factory_values",
            "MACS-CMD-01-01",
        ),
        (little_endian_stops, "the_superior_stop_reads_back", "MACS-CMD-09-01"),
    ],
)
def test_a_wrong_device_fails(
    monkeypatch: pytest.MonkeyPatch, lie: Lie, check: str, requirement: str
) -> None:
    """Each lie about the replies fails the requirement it breaks."""
    parse = codec.parse
    monkeypatch.setattr(codec, "parse", lambda received: lie(parse(received)))
    result = CliRunner().invoke(conform, ["mac23", check, "--json"])
    failed = {
        finding["requirement"]
        for line in result.stdout.splitlines()
        if (event := json.loads(line))["event"] == "check_finished"
        for finding in event["findings"]
        if finding["verdict"] == "fail"
    }
    assert result.exit_code == 1
    assert requirement in failed
