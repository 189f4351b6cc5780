"""Every switch of an MN400 works: for each value, what a host sees (ledger §7)."""

from dataclasses import astuple

import pytest
from mn400_bench import Mn400Bench
from mn400_motion_quirk_cases import ALL_CASES as CASES

from axistwin.devices.mn400.quirks import QUIRKS, Mn400Quirks, parse_quirks
from axistwin.errors import UsageError


@pytest.mark.parametrize(("name", "value"), CASES.played())
def test_each_value_of_each_quirk_shows_on_the_wire(name: str, value: str) -> None:
    """The scenario of the quirk ends as the reading says."""
    scenario, seen, base = CASES[name]
    settings = {**base, name: value}
    bench = Mn400Bench(*settings.pop("numbers", ()), **settings)
    assert scenario(bench) == seen[value]


def test_every_quirk_has_a_case_with_all_its_values() -> None:
    """Numbers and texts: at least the default and another one; default first."""
    CASES.check_complete(QUIRKS, "MN4-")


def test_defaults_parse_to_the_default_settings() -> None:
    """What the program lists as default is the default."""
    defaults = {name: quirk.default for name, quirk in QUIRKS.items()}
    assert astuple(parse_quirks(defaults)) == astuple(Mn400Quirks())


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("echo_case", "lower", "allowed: upper, as_sent"),
        ("poll_slot_ms", "0", "auto, or milliseconds such as 14.5"),
        ("arc_radius_tol", "-1", "steps such as 2.5"),
        ("arc_radius_tol", "2.5555", "steps such as 2.5"),
        ("abort_exit_code", "256", "keep, or 0..255"),
        ("queue_depth", "-1", "allowed: 0..10000"),
        ("accel_scale", "2", "allowed: 1.0, 0.5"),
        ("quit_decell", "true", "unknown quirk 'quit_decell': did you mean quit_decel?"),
    ],
)
def test_a_wrong_setting_is_one_clear_line(name: str, value: str, words: str) -> None:
    """It names the value and what is allowed."""
    with pytest.raises(UsageError) as told:
        parse_quirks({name: value})
    assert words in str(told.value)
    assert name in str(told.value)
