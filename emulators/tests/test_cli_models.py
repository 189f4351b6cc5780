"""``axistwin models``: what there is."""

import json

import pytest
from click.testing import CliRunner, Result

from axistwin import catalog
from axistwin.cli.program import main


def invoke(*arguments: str) -> Result:
    """Run the program in this process; it must succeed."""
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    return result


def test_models_lists_every_model() -> None:
    """Each begins a line; a terminal of 80 columns cuts nothing."""
    lines = invoke("models").stdout.splitlines()
    begun = [line.split()[0] for line in lines if not line.startswith(" ")]
    assert begun == ["MODEL", *catalog.models()]
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("model", catalog.models())
def test_models_of_one_fits_on_a_screen(model: str) -> None:
    """Every quirk by name, in groups, nothing cut."""
    lines = invoke("models", model).stdout.splitlines()
    assert len(lines) <= 45
    assert max(map(len, lines)) <= 80
    assert set(catalog.models()[model].quirks) <= set(" ".join(lines).split())
    assert all(quirk.group for quirk in catalog.models()[model].quirks.values())


def test_quirks_are_found_by_a_word() -> None:
    """Of the name, the ID, the group or the meaning."""
    for word in ("xon_byte", "MACS-AMB-01", "Frames and", "last byte of the reply to an ACCEPTED"):
        text = invoke("models", "mac23", word).stdout
        assert text.startswith("Frames and replies\n")
        assert "  xon_byte = 1Ah    [MACS-AMB-01]" in text
    assert len(invoke("models", "mac23", "MACS-AMB-01").stdout.splitlines()) == 5
    result = CliRunner().invoke(main, ("models", "mac23", "xon_bite"))
    assert (result.exit_code, "did you mean xon_byte?" in result.output) == (2, True)
    assert CliRunner().invoke(main, ("models", "mac23", "qqqqq")).exit_code == 2


def test_models_of_one_lists_every_quirk_with_its_id() -> None:
    """Name, default, ID, meaning, values."""
    text = invoke("models", "mac23", "all").stdout
    for quirk in catalog.models()["mac23"].quirks.values():
        assert f"  {quirk.name} = {quirk.default}    [{quirk.source}]" in text
        assert quirk.doc in text


def test_models_tells_what_a_model_is_reached_over() -> None:
    """With the default rate of a serial line, and the bus' own on CAN."""
    lines = [line.split()[:4] for line in invoke("models").stdout.splitlines()]
    assert lines[0] == ["MODEL", "TRANSPORT", "ADDRESSES", "BIT/S"]
    assert ["mac23", "serial", "0..127", "38400"] in lines
    assert ["mac23-can", "can", "1..127", "125000"] in lines
    assert "default rate: 38400 baud" in invoke("models", "mac23").stdout
    assert "bit rate of the bus: 125000 bit/s" in invoke("models", "mac23-can").stdout


def test_models_speaks_json() -> None:
    """The same facts for programs."""
    summaries = json.loads(invoke("models", "--json").stdout)
    assert [each["name"] for each in summaries] == list(catalog.models())
    details = json.loads(invoke("models", "mac34-1", "--json").stdout)
    assert details["addresses"] == [0, 127]
    assert [quirk["name"] for quirk in details["quirks"]] == list(
        catalog.models()["mac34-1"].quirks
    )
