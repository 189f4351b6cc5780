"""A profile is read alike by `axistwin run` and `axistwin conform`: two readers, one contract."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from axistwin import errors as twin_errors
from axistwin.catalog import models, read_profile
from axistwin_conformance.base import errors as suite_errors
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.core.profile import load_profile, settable

LEDGERS = {"mac23": "mac_serial", "mac23-can": "mac_can", "msc-250": "msc", "mn400": "mn400"}
# What a device was seen to do and no twin does: a reading of the suite alone.
SEEN_ONLY = {("reserved_bits", "mixed"), ("mem_wrap", "other")}
VALUES: tuple[str | int, ...] = (
    *(
        "",
        " ",
        "banana",
        "0",
        "1",
        "2",
        "3",
        "4",
        "6",
        "8",
        "9",
        "01",
        "011",
        "014",
        "11h",
        " 11H ",
    ),
    *("0x11", "17", "17h", "18h", "26", "1ah", "40h", "42h", "67", "0x581", "1409", "1409.0", "-1"),
    *("FF", "FFh", "255", "256", "2000", "60000", "60001", "65536", "1000001", "FFFFFFFFh"),
    *("100000000h", "80000000h", "-2147483648", "-2147483649", "9" * 40, "0" * 40, "0" * 9000, "١"),
    *("true", "True", "YES", "off", "no", "none", "silence", "Silence", "refuse ", "refuse"),
    *("mixed", "other", "zero", "wrap", "plant", "7", "007", "65535", "plant "),
    *("model", "24/60/64/85", "60/24/64/85", "24/60/64", "24/81/64/85", "24/80/64/256"),
    *("cia301", "10/4200/09", "10/4200/09,01/3100/05", "10/4200/09,", "ab/cdef/01", "1/2/3"),
    *("generic", "input:0-15/user:128-255", "input:0-15/user:9", "input:9-3", "user:256", "x:1"),
    *(0, 1, 2, 8, 11, 17, 18, 64, 255, 256, 1409, 2000, 65535, 65536, -1, -(1 << 31), 1 << 31),
    *(1 << 32, 10**40, True, False),
)
WHOLE_FILES = {
    "": "empty",
    "# nothing but this\n": "empty",
    "[quirks]\nxon_byte = '11h'\n": "model",
    'model = "mac23"\n': "",
    'model = "mac23"\n[quirks]\n': "",
    'model = "mac23"\n[quirks]\nxon_byte = 17\n': "",
    'model = "mac23"\n[quirk]\nxon_byte = 17\n': "did you mean quirks?",
    'model = "mac23"\n[extra]\na = 1\n': "known: model, quirks",
    'Model = "mac23"\n': "did you mean model?",
    'model = "mac23"\nxon_byte = "11h"\n': "known: model, quirks",
    'model = "mac23"\nquirks = 3\n': "table",
    'model = "mac23"\n[[quirks]]\nxon_byte = 17\n': "table",
    'model = "mac23"\n[quirks.xon_byte]\na = 1\n': "write a text",
    'model = "mac23"\n[quirks]\nxon_byte = 17.0\n': "write a text",
    'model = "mac23"\n[quirks]\nxon_byte = [17]\n': "write a text",
    'model = "mac23"\n[quirks]\nxon_byte = 1979-05-27\n': "write a text",
    'model = "mac23"\n[quirks]\nxon_bite = "11h"\n': "did you mean xon_byte?",
    'model = "mac23"\n[quirks]\nbanana = 1\n': "axistwin models mac23",
    'model = "mac23"\n[quirks]\ncomma = "optional"\n': "comma",
    'model = "mac23"\n[quirks]\nvirtual_segment_index = "1Eh"\n': "virtual_segment_index",
    'model = "mac23"\n[quirks]\ncan_bitrate = 1\n': "can_bitrate",
    'model = "mac34-1"\n': "mac34-1",
    'model = "mac99"\n': "mac99",
    "model = 3\n": "3",
    "model = [1]\n": "[1]",
    'model = ""\n': "",
    "[quirks\n": "TOML",
    "\ufeffmodel = 1\n": "TOML",
}


def read_by_twin(path: Path, model: str) -> str:
    """What `run` says to it; empty if it takes it."""
    try:
        read_profile(path, [model])
    except twin_errors.UsageError as error:
        return str(error)
    return ""


def read_by_suite(path: Path, model: str) -> str:
    """What `conform` says to it; empty if it takes it."""
    try:
        load_profile(path, model, load_ledger(LEDGERS[model]))
    except suite_errors.UsageError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("text", WHOLE_FILES, ids=repr)
def test_both_take_or_both_refuse_a_file_in_one_line(text: str, tmp_path: Path) -> None:
    """The line names the file and what is wrong or near."""
    path = tmp_path / "unit.toml"
    path.write_text(text, "utf-8")
    told = [read_by_twin(path, "mac23"), read_by_suite(path, "mac23")]
    assert bool(told[0]) == bool(told[1]), told
    is_good = text.startswith('model = "mac23"') and not WHOLE_FILES[text]
    assert bool(told[0]) != is_good, told
    for line in told:
        assert WHOLE_FILES[text] in line
        assert is_good or str(path) in line
        assert "\n" not in line


@pytest.mark.parametrize("model", LEDGERS)
def test_both_take_or_both_refuse_every_spelling_of_every_switch(model: str) -> None:
    """All names that either knows, with all values of the table, and those that each lists."""
    of_twin, of_suite = models()[model].quirks, settable(load_ledger(LEDGERS[model]))
    assert set(of_twin) == set(of_suite)
    differing, taken = [], 0
    for name, own in of_twin.items():
        for value in (*VALUES, *own.allowed, own.default, *of_suite[name].words.split(" or ")):
            try:
                own.parse(value)
                is_taken = True
            except twin_errors.UsageError:
                is_taken = False
            taken += is_taken
            is_differing = is_taken is not (of_suite[name].read(value) is not None)
            if is_differing and (name, value) not in SEEN_ONLY:
                differing.append((name, value))
    assert not differing
    assert taken > len(of_twin)


@pytest.mark.parametrize(
    ("name", "values", "reading"),
    [
        ("xon_byte", ("11h", "11H", "0x11", "17", 17), "11h"),
        ("abort_flush", (False, "false", "no", "OFF", 0, "0"), "false"),
        ("status_reply_digit", (2, "2", "0x2"), "2"),
        ("boot_time_ms", (2300, "2300", "8FCh"), "2300"),
        ("imax_value", (64, "40h", "0x40", "64"), "40h"),
        ("version_word", (0x703, "703h", "00000703h"), "00000703h"),
        ("brake_increments", (7, "7", "007"), "7"),
        ("segment_zero_period", (65536, "65536", "10000h"), "65536"),
    ],
)
def test_two_spellings_of_a_value_are_one_reading(
    name: str, values: tuple[object, ...], reading: str, tmp_path: Path
) -> None:
    """As the suite spells what it sees, so that a device is never blamed for a way to write it."""
    path = tmp_path / "unit.toml"
    for value in values:
        path.write_text(f'model = "mac23"\n[quirks]\n{name} = {json.dumps(value)}\n', "utf-8")
        assert load_profile(path, "mac23", load_ledger("mac_serial")) == {name: reading}
        assert not read_by_twin(path, "mac23")
