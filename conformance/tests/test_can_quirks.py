"""Every reading a MAC23 on CAN may follow is detected, written down, made again and conforms."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner
from quirk_twins import QuirkTwins, Readings

from axistwin_conformance.cli import conform
from axistwin_conformance.core.profile import load_profile

pytestmark = pytest.mark.strength

TWINS = QuirkTwins(
    model="mac23-can",
    ledger_name="mac_can",
    prefix="axistwin:",
    hidden={
        "power_on_at_boot": "it takes a hand on the shaft",
        "position_overflow": "beyond any sensible envelope",
        "imax_value": "no request tells it",
    },
    values={
        "boot_time_ms": ("1700", "2303"),
        "brake_increments": ("1", "10"),
        "emcy_code_map": (
            "10/4210/09,01/3110/05,40/3210/05,20/3220/05",
            "40/3210/05,20/3220/05,01/3100/05",
        ),
        "emcy_trigger_mask": ("FFFFFFFFh",),
    },
)
OTHERS = TWINS.others
OWN = [
    (name, one) for name, one in OTHERS if TWINS.ledger.ambiguity_of(name).id.startswith("MACC-")
]
SHARED = [one for one in OTHERS if one not in OWN]
URL = "axistwin:mac23-can:1,mac23-can:2?time=virtual"


def ids(pairs: list[tuple[str, str]]) -> list[str]:
    """Readings as names of tests."""
    return [f"{name}={reading}" for name, reading in pairs]


@pytest.mark.parametrize(("switch", "reading"), OWN, ids=ids(OWN))
def test_a_reading_of_its_own_is_detected_written_and_made_again(
    switch: str, reading: str, tmp_path: Path
) -> None:
    """Twin → profile → twin of that profile → the same profile, with just that reading in it."""
    TWINS.goes_round({switch: reading}, tmp_path / "unit.toml")


@pytest.mark.soak
@pytest.mark.parametrize(("switch", "reading"), SHARED, ids=ids(SHARED))
def test_a_reading_of_the_axis_is_detected_written_and_made_again(
    switch: str, reading: str, tmp_path: Path
) -> None:
    """The same for what serial and CAN share."""
    TWINS.goes_round({switch: reading}, tmp_path / "unit.toml")


def test_what_cannot_be_known_is_told_with_its_reason() -> None:
    """The default twin: every switch is known but the hidden ones, all of them the default."""
    TWINS.hides_what_it_hides()


def test_every_switch_of_the_ledger_has_a_probe_or_no_second_reading() -> None:
    """What has no probe is configuration, or has nothing to tell apart."""
    TWINS.asks_of_every_switch()


@pytest.mark.parametrize(
    "quirks", ["", "&quirk.lmt_other=cia305", "&quirk.factory_reset_scope=no_restart",
               "&quirk.lmt_sdo=ignored", "&quirk.lmt_incomplete=bootup"],
)  # fmt: skip
def test_detection_leaves_address_and_parameters_as_they_were(quirks: str, tmp_path: Path) -> None:
    """A module at address 5 is at address 5 afterwards, whatever it makes of LMT and 2001h."""
    path = tmp_path / "unit.toml"
    url = f"axistwin:mac23-can:5?time=virtual{quirks}"
    words = ["mac23-can", "--can", url, "--address", "5", "--rig", "twin", "--detect", str(path)]
    result = CliRunner().invoke(conform, [*words, "--allow", "motion,stored,rig,destructive"])
    assert result.exit_code == 0, result.output
    assert "not put back" not in result.output
    readings = load_profile(path, "mac23-can", TWINS.ledger)
    assert "".join(f"&quirk.{name}={one}" for name, one in readings.items()) == quirks
    assert "module 1 alone answers" in path.read_text("utf-8")


@pytest.mark.parametrize(
    "reading", ["catchup_low_byte=refuse", "zero_catchup=refuse", "dont_care_digits=refuse"]
)
def test_an_example_read_from_its_other_end_may_be_refused(reading: str) -> None:
    """The last byte first, the manual's 200Eh and 2002h are a 0 beside bytes that do not count."""
    words = ["mac23-can", "--can", f"{URL}&quirk.can_byte_order=little&quirk.{reading}"]
    words += ["the_manuals_examples_get_their_replies", "--allow", "motion,stored"]
    result = CliRunner().invoke(conform, words)
    assert result.exit_code == 0, result.output


def test_inertia_is_told_of_an_axis_that_stops_at_once(tmp_path: Path) -> None:
    """Where nothing is overrun the axis is moved with hardly any torque."""
    TWINS.goes_round({"plant": "inertial", "brake_increments": "0"}, tmp_path / "unit.toml")


def test_passive_detection_writes_nothing_and_names_what_it_would_take(tmp_path: Path) -> None:
    """Without --allow only what needs no write is asked; the rest is told with the remedy."""
    path = tmp_path / "unit.toml"
    words = ["mac23-can", "--can", f"{URL}&quirk.upload_scs=43h", "--detect", str(path)]
    result = CliRunner().invoke(conform, words)
    assert result.exit_code == 0, result.output
    text = path.read_text("utf-8")
    assert load_profile(path, "mac23-can", TWINS.ledger) == {"upload_scs": "43h"}
    assert "# can_byte_order: MACC-AMB-01: not allowed: stored (--allow stored)" in text
    assert "# lmt_dlc: MACC-AMB-08: not allowed: motion, stored, destructive" in text


def test_a_detected_profile_makes_a_twin_of_axistwin_run(tmp_path: Path) -> None:
    """What --detect writes, run --profile takes; and what models name, conform --profile takes."""
    readings = {
        "emcy_code_map": "10/4210/09,01/3110/05,40/3210/05,20/3220/05",
        "nmt_supported": "true",
        "boot_time_ms": "2303",
        "lmt_error_reply": "FF",
    }
    path = tmp_path / "unit.toml"
    TWINS.goes_round(readings, path)
    assert tomllib.loads(path.read_text("utf-8"))["quirks"] == readings
    command = [sys.executable, "-m", "axistwin", "run", "mac23-can", "--profile", str(path)]
    with subprocess.Popen(
        [*command, "--slcan", str(tmp_path / "can")],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    ) as served:  # fmt: skip
        assert served.stdout is not None
        try:
            assert "ready mac23-can:1" in served.stdout.readline()
        finally:
            served.terminate()


THREE = {"upload_scs": "43h", "abort_code_form": "code", "emcy_payload": "status_first"}


def test_three_readings_at_once_conform_with_those_three_named() -> None:
    """A device that differs in three ways is told in three names."""
    TWINS.conforms_with(THREE, "quick")


@pytest.mark.soak
@pytest.mark.parametrize(("switch", "reading"), OTHERS, ids=ids(OTHERS))
def test_a_twin_of_each_reading_conforms_with_that_quirk_named(switch: str, reading: str) -> None:
    """Doubt has a name: another reading is neither failed nor overlooked, at level quick."""
    TWINS.conforms_with({switch: reading}, "quick")


@pytest.mark.soak
@pytest.mark.parametrize(("switch", "reading"), OWN, ids=ids(OWN))
def test_a_twin_of_each_reading_of_its_own_conforms_at_full(switch: str, reading: str) -> None:
    """The whole suite on a twin of another reading."""
    TWINS.conforms_with({switch: reading}, "full")


@pytest.mark.soak
@pytest.mark.parametrize("readings", TWINS.sample(5, 3, seed=11), ids=str)
def test_any_three_readings_at_once_conform_with_those_three_named(readings: Readings) -> None:
    """Readings that have to do with each other, or not."""
    TWINS.conforms_with(readings, "quick")
