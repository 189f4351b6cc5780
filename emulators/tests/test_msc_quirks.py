"""Every switch of a controller works: for each value, what a host sees (ledger §6.1)."""

from dataclasses import astuple

import pytest
from msc_bench import MscBench
from msc_quirk_cases import CASES

from axistwin.devices.msc.quirks import QUIRKS, MscQuirks, parse_quirks
from axistwin.errors import UsageError


@pytest.mark.parametrize(("name", "value"), CASES.played())
def test_each_value_of_each_quirk_shows_on_the_wire(name: str, value: str) -> None:
    """The scenario of the quirk ends as the reading says."""
    scenario, seen, base = CASES[name]
    settings = {**base, name: value}
    bench = MscBench(*settings.pop("units", ()), **settings)
    assert scenario(bench) == seen[value]


def test_every_quirk_has_a_case_with_all_its_values() -> None:
    """Numbers and texts: at least the default and another one; default first."""
    CASES.check_complete(QUIRKS, "MSC-")


def test_defaults_parse_to_the_default_settings() -> None:
    """What the program lists as default is the default."""
    defaults = {name: quirk.default for name, quirk in QUIRKS.items()}
    assert astuple(parse_quirks(defaults)) == astuple(MscQuirks())


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("comma", "maybe", "allowed: required, optional"),
        ("data_address_stride", "3", "allowed: 4, 2, 1"),
        ("ack_timeout_ms", "0", "allowed: 1..60000"),
        ("data_size", "65537", "allowed: 128..65536"),
        ("flag_map", "input:0-300", "generic, or KIND:FIRST-LAST/..."),
        ("flag_map", "input:0-15/user:15-20", "generic, or KIND:FIRST-LAST/..."),
        ("flag_map", "button:3", "generic, or KIND:FIRST-LAST/..."),
        ("rx_while_busi", "drop", "unknown quirk 'rx_while_busi': did you mean rx_while_busy?"),
    ],
)
def test_a_wrong_setting_is_one_clear_line(name: str, value: str, words: str) -> None:
    """It names the value and what is allowed."""
    with pytest.raises(UsageError) as told:
        parse_quirks({name: value})
    assert words in str(told.value)
    assert name in str(told.value)
    assert "\n" not in str(told.value)
