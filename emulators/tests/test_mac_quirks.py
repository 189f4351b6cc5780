"""Every switch of the MAC twin works: for each value, what a host sees (ledger §7, §5.11)."""

from dataclasses import astuple

import pytest
from mac_bench import MacBench
from mac_quirk_motion_cases import CASES

from axistwin.devices.mac.axis.quirks import QUIRKS, MacQuirks, parse_quirks
from axistwin.errors import UsageError


@pytest.mark.parametrize(("name", "value"), CASES.played())
def test_each_value_of_each_quirk_shows_on_the_wire(name: str, value: str) -> None:
    """The scenario of the quirk ends as the reading says."""
    scenario, seen, base = CASES[name]
    assert scenario(MacBench(**{**base, name: value})) == seen[value]


def test_every_quirk_has_a_case_with_all_its_values() -> None:
    """Numbers and texts: at least the default and another one; default first."""
    CASES.check_complete(QUIRKS, "MACS-")


def test_defaults_parse_to_the_default_settings() -> None:
    """What the program lists as default is the default."""
    defaults = {name: quirk.default for name, quirk in QUIRKS.items()}
    assert astuple(parse_quirks(defaults)) == astuple(MacQuirks())


@pytest.mark.parametrize(
    ("value", "meant"), [("11h", 0x11), ("0x11", 0x11), ("17", 0x11), (17, 0x11), ("1Ah", 0x1A)]
)
def test_numbers_may_be_spelled_as_hex_or_decimal(value: str | int, meant: int) -> None:
    """On a command line or in TOML."""
    assert parse_quirks({"xon_byte": value}).xon_byte == meant


@pytest.mark.parametrize(("value", "meant"), [("yes", True), (True, True), ("off", False)])
def test_switches_take_the_usual_words(value: str | bool, meant: bool) -> None:
    """And TOML booleans."""
    assert parse_quirks({"fifo_counts_executing": value}).fifo_counts_executing is meant


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("xon_bite", "1", "did you mean xon_byte"),
        ("xon_byte", "12h", "allowed: 1Ah, 11h"),
        ("running_until", "tolerence", "did you mean tolerance"),
        ("boot_time_ms", "-1", r"allowed: 0\.\.60000"),
        ("boot_time_ms", "soon", r"allowed: 0\.\.60000"),
        ("abort_flush", "perhaps", "allowed: true, false"),
        ("mac34_limits", "30/20/40/60", "UNDER/OVER/VMAX/TRIP"),
        ("brake_increments", "70000", r"0\.\.65535"),
        ("factory_superior_stop", "100000000h", "80000000h"),
    ],
)
def test_a_mistake_is_one_line_with_the_allowed_values(name: str, value: str, words: str) -> None:
    """UsageError naming value, allowed range and remedy."""
    with pytest.raises(UsageError, match=words) as told:
        parse_quirks({name: value})
    assert "\n" not in str(told.value)


def test_a_value_that_is_not_allowed_is_told_once_what_is() -> None:
    """The list of all is not given twice."""
    with pytest.raises(UsageError) as told:
        parse_quirks({"fifo_counts_executing": "qqq"})
    assert str(told.value).count("false, true") == 1
    assert "known:" not in str(told.value)


def test_a_number_of_thousands_of_digits_is_a_mistake_like_any_other() -> None:
    """Python refuses to read it; the user is told what is allowed all the same."""
    with pytest.raises(UsageError, match=r"reply_latency_us: .* is not allowed"):
        parse_quirks({"reply_latency_us": "9" * 5000})
