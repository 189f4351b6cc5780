"""The golden exchanges of the MSC: whole, sound, and the same for readers."""

from __future__ import annotations

import tomllib
from importlib import resources
from itertools import pairwise
from pathlib import Path

import pytest

from axistwin_conformance.families.msc import codec

FIXTURES = Path(__file__).parents[2] / "fixtures" / "msc"
GOLDEN = resources.files("axistwin_conformance.families.msc") / "golden" / "exchanges.toml"
EXCHANGES = tomllib.loads(GOLDEN.read_text(encoding="utf-8"))["exchange"]


def test_the_fixture_is_the_file_that_ships_with_the_suite() -> None:
    """One master, one copy for readers."""
    assert (FIXTURES / "exchanges.toml").read_bytes() == GOLDEN.read_bytes()


def test_every_command_is_among_them() -> None:
    """Each of the nine is sent by the host in some exchange, soundly."""
    sent = [
        codec.parse(bytes.fromhex(line[2:]))
        for one in EXCHANGES
        for line in one["said"]
        if line.startswith("H ")
    ]
    assert {one.name for one in sent if one is not None and one.is_sound} == set(codec.NAMES)


@pytest.mark.parametrize("exchange", EXCHANGES, ids=lambda exchange: exchange["name"])
def test_what_is_said_follows_the_rules_of_the_link(exchange: dict[str, list[str]]) -> None:
    """A sound request draws ACK, any other NAK; replies are sound, and the host signs each."""
    said = [(line[0], bytes.fromhex(line[2:])) for line in exchange["said"]]
    for (speaker, data), (answerer, answer) in pairwise(said):
        packet = codec.parse(data)
        if packet is None:
            assert data in (codec.ACK, codec.NAK)
        elif speaker == "H":
            assert (answerer, answer) == ("D", codec.ACK if packet.is_sound else codec.NAK)
        else:
            assert packet.is_sound
            assert answerer == "H"
            assert answer in (codec.ACK, codec.NAK)
    assert said[-1][1] == codec.ACK
