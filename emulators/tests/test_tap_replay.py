"""What ``axistwin tap`` records of a daemon, said to a twin again: for every family."""

from pathlib import Path

import pytest
from daemon_process import daemon, invoke, talk

from axistwin import catalog

pytestmark = pytest.mark.system

TALKS = {
    "mac23": ("go to 9000", *["position?"] * 9, "wait 3 s", "position?", "stop", "99h", "status?"),
    "mac23-can": ("go to 9000", *["position?"] * 9, "wait 3 s", "position?", "stop", "status?"),
    "msc-250": ("RQSTAT", "DWRITE 2008 -5", "DREAD 2008", "SFLAG 200", "RFLAG 200", "DREAD 9"),
    "mn400": ("V500", "M800,50", *["E"] * 9, "wait 2 s", "E", "X3"),
}
"""With positions in motion, if it has any."""

CHANGES = {
    "mac23": ("xon_byte", "11h"),
    "mac23-can": ("upload_scs", "43h"),
    "msc-250": ("write_reply", "empty_packet"),
    "mn400": ("data_packet_trailer", "none"),
}
"""One quirk of every family, that its conversation meets."""

WINDOW = ("--window", "20000")  # a busy machine holds a tap up for seconds


def record(folder: Path, name: str, *options: str) -> None:
    """Record the conversation with a twin that has ``options``, by a tap in between."""
    is_can = catalog.find_model(name).carrier == "can"
    place = f"slcan:./{name}?sleep_after_open=0" if is_can else f"./{name}"
    own, side = ("--slcan", "--slcan") if is_can else ("--pty", "--pty")
    with daemon(folder, name, own, f"./{name}", *options) as twin:
        assert twin.line().startswith("ready ")
        with daemon(folder, place, "capture.txt", side, "./tap", command="tap") as tap:
            assert tap.line().startswith("ready tap ")
            said = talk("./tap", name, *TALKS[name])
            assert said.stdout.count("\n< ") >= 4, said.output
            assert tap.end()[0] == 0


@pytest.mark.parametrize("name", TALKS)
def test_what_a_tap_records_a_twin_says_again(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Identically; and decode has words for all of it."""
    monkeypatch.chdir(tmp_path)
    record(tmp_path, name)
    result = invoke("replay", "capture.txt", "--against", name, *WINDOW)
    assert result.exit_code == 0, result.output
    decoded = invoke("decode", name, "capture.txt")
    assert decoded.exit_code == 0, decoded.output


@pytest.mark.parametrize("name", TALKS)
def test_a_quirk_of_what_a_tap_recorded_is_shown_and_found(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The difference in words; the profile with which the twin says the same."""
    monkeypatch.chdir(tmp_path)
    quirk, value = CHANGES[name]
    record(tmp_path, name, "--quirk", f"{quirk}={value}")
    result = invoke("replay", "capture.txt", "--against", name, *WINDOW)
    assert result.exit_code == 1, result.output
    assert {row[:2] for row in result.stdout.splitlines()} >= {"> ", "- ", "+ "}
    result = invoke("replay", "capture.txt", "--against", name, "--infer", *WINDOW)
    assert result.exit_code == 0, result.output
    assert f'{quirk} = "{value}"' in result.stdout
    Path("found.toml").write_text(result.stdout, "utf-8")
    words = ("replay", "capture.txt", "--against", name, "--profile", "found.toml", *WINDOW)
    assert invoke(*words).exit_code == 0
