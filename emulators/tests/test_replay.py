"""``axistwin replay``: a recording compared with what a twin says, and quirks that explain it."""

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from daemon_process import assert_one_clear_line, invoke
from recordings import CONVERSATIONS, record

from axistwin import catalog
from axistwin.cli.replay.capture import Exchange, read_capture
from axistwin.cli.replay.comparison import Difference, differences
from axistwin.cli.replay.host_port import TwinSetup
from axistwin.kernel.time import NS_PER_MS

CHANGES: dict[str, tuple[str, Any]] = {
    "mac23": ("xon_byte", 0x11),
    "mac23-can": ("upload_scs", 0x43),
    "msc-250": ("write_reply", "empty_packet"),
    "mn400": ("data_packet_trailer", "none"),
}
"""One quirk of every family, that its conversation meets."""


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def found(
    name: str, exchanges: list[Exchange], window_ns: int = 50 * NS_PER_MS, **quirks: Any
) -> list[Difference]:
    """Where a twin with ``quirks`` differs."""
    model = catalog.find_model(name)
    return differences(TwinSetup(model, model.default_address, quirks), exchanges, window_ns)


def recorded(name: str, **quirks: Any) -> list[Exchange]:
    """A conversation with a twin that has ``quirks``."""
    record(Path("capture.txt"), name, CONVERSATIONS[name], quirks)
    return read_capture(catalog.find_model(name), "capture.txt")


@pytest.mark.parametrize("name", CONVERSATIONS)
def test_a_twin_says_what_it_said(name: str) -> None:
    """To the millisecond, for every family."""
    exchanges = recorded(name)
    assert len(exchanges) >= 5
    assert any(each.reply for each in exchanges)
    result = invoke("replay", "capture.txt", "--against", name, "--window", "50")
    assert result.exit_code == 0, result.output
    assert result.stdout == f"capture.txt: {len(exchanges)} exchanges, {name} says the same\n"


@pytest.mark.parametrize("name", CONVERSATIONS)
def test_another_quirk_is_shown_and_found(name: str) -> None:
    """The difference in words, and the profile with which the twin says the same."""
    quirk, value = CHANGES[name]
    exchanges = recorded(name, **{quirk: value})
    result = invoke("replay", "capture.txt", "--against", name)
    assert result.exit_code == 1
    blocks = result.stdout.split("\n\n")
    assert len(blocks) > 1
    for block in blocks[:-1]:
        head, request, *rows = block.splitlines()
        assert head.startswith("exchange ")
        assert request.startswith("> ")
        assert {"-", "+"} <= {row[0] for row in rows}
    differing = len(blocks) - 1
    assert blocks[-1] == (
        f"capture.txt: {len(exchanges)} exchanges, {name} says something else in {differing}\n"
    )
    result = invoke("replay", "capture.txt", "--against", name, "--infer")
    assert result.exit_code == 0, result.output
    assert f"explains {differing} of {differing}" in result.stdout
    Path("found.toml").write_text(result.stdout, "utf-8")
    (setting,) = catalog.read_profile("found.toml", [name]).items()
    assert (setting[0], catalog.find_model(name).quirks[quirk].parse(setting[1])) == (quirk, value)
    result = invoke("replay", "capture.txt", "--against", name, "--profile", "found.toml")
    assert result.exit_code == 0, result.output


def test_two_quirks_are_found_together() -> None:
    """One after the other."""
    recorded("mac23", xon_byte=0x11, status_reply_digit="2")
    result = invoke("replay", "capture.txt", "--against", "mac23", "--infer")
    assert result.exit_code == 0, result.output
    Path("found.toml").write_text(result.stdout, "utf-8")
    assert set(catalog.read_profile("found.toml", ["mac23"])) == {"xon_byte", "status_reply_digit"}


def test_quirks_that_explain_as_much_are_named() -> None:
    """The first of them is proposed."""
    recorded("mac23", unknown_index="silence")
    path = Path("capture.txt")
    kept = [line for line in path.read_text("utf-8").splitlines() if "stop with" not in line]
    path.write_text("\n".join(kept), "utf-8")
    result = invoke("replay", "capture.txt", "--against", "mac23", "--infer")
    assert 'unknown_index = "silence"' in result.stdout


def test_differences_that_no_quirk_explains_are_said_to_be_so() -> None:
    """No profile is printed; the twin does not say the same."""
    recorded("mac23")
    result = invoke("replay", "capture.txt", "--against", "msc-250", "--infer")
    assert (result.exit_code, result.stdout) == (1, "")
    assert "no quirk of msc-250 explains any of 6 differences" in result.stderr


def test_a_reply_out_of_time_is_shown() -> None:
    """If it is so by more than the window; a wider one accepts it."""
    exchanges = recorded("mac23", reply_latency_us=61_000)
    (first, *_) = found("mac23", exchanges)
    assert not first.is_content
    assert first.late_ns == pytest.approx(-60 * NS_PER_MS, abs=1000)
    assert not found("mac23", exchanges, 61 * NS_PER_MS)
    result = invoke("replay", "capture.txt", "--against", "mac23")
    assert result.exit_code == 1
    assert "the twin: 60.000 ms earlier than recorded" in result.stdout


@pytest.mark.parametrize("latency_us", [1000, 41_000])
def test_a_twin_that_is_slower_within_the_window_says_the_same(latency_us: int) -> None:
    """The next message waits for it, though it was recorded right behind the faster reply."""
    rows, at_ms = [], 0.0
    recorded("mac23")
    for line in Path("capture.txt").read_text("utf-8").splitlines()[1:]:
        at_ms += 10
        rows.append(f"{at_ms:12.3f}{line[12:]}")
    queries = [row for row in rows if "position" in row and "go to" not in row]
    Path("fast.txt").write_text("\n".join(queries), "utf-8")
    exchanges = read_capture(catalog.find_model("mac23"), "fast.txt")
    assert not found("mac23", exchanges, reply_latency_us=latency_us)


POLLS: dict[str, tuple[str, ...]] = {
    "mac23": ("go to 20000", *["position?"] * 40, "status?"),
    "mac23-can": ("go to 20000", *["position?"] * 40, "status?"),
    "mn400": ("V2000", "M5000,-700", *["E"] * 20, "N", "wait 500 ms", "E"),
}
"""Of every family with axes: asked again and again while they move."""

OTHER_MOTION: dict[str, tuple[str, Any]] = {
    "mac23": ("factory_ramp", 255),
    "mac23-can": ("factory_ramp", 255),
    "mn400": ("accel_scale", "0.5"),
}
"""A quirk by which they move otherwise."""


def polled(name: str, **quirks: Any) -> list[Exchange]:
    """Recorded by somebody whose times are up to 2 ms off."""
    rng = random.Random(name)
    record(Path("capture.txt"), name, POLLS[name], quirks)
    return [
        replace(each, request=replace(each.request, at_ns=each.request.at_ns + off_ns))
        for each in read_capture(catalog.find_model(name), "capture.txt")
        for off_ns in [rng.randrange(-2 * NS_PER_MS, 2 * NS_PER_MS)]
    ]


@pytest.mark.parametrize("name", POLLS)
def test_a_position_in_motion_is_the_same_if_the_twin_has_it_soon(name: str) -> None:
    """The recorded times of messages are not quite those of the device."""
    exchanges = polled(name)
    strict = found(name, exchanges, 0)
    assert len([each for each in strict if each.is_content]) >= 10
    assert found(name, exchanges, 50 * NS_PER_MS) == []
    assert len([each for each in found(name, exchanges, 5 * NS_PER_MS) if each.is_content]) >= 3


@pytest.mark.parametrize("name", OTHER_MOTION)
def test_another_motion_is_a_difference_all_the_same(name: str) -> None:
    """No instant within the window has these positions."""
    quirk, value = OTHER_MOTION[name]
    exchanges = polled(name, **{quirk: value})
    differing = found(name, exchanges, 50 * NS_PER_MS)
    assert len(differing) >= 5
    assert found(name, exchanges, 50 * NS_PER_MS, **{quirk: value}) == []


def test_a_recording_that_breaks_off_is_no_difference() -> None:
    """Its last message has no reply, or the first part of one."""
    recorded("mac23")
    path = Path("capture.txt")
    lines = path.read_text("utf-8").splitlines()
    for end in (lines[:-1], [*lines[:-1], lines[-1][:23]]):
        path.write_text("\n".join(end) + "\n", "utf-8")
        result = invoke("replay", "capture.txt", "--against", "mac23")
        assert result.exit_code == 0, result.output
    path.write_text("\n".join([*lines[:2], *lines[3:]]), "utf-8")
    result = invoke("replay", "capture.txt", "--against", "mac23")
    assert "- nothing\n+ 06" in result.stdout


def test_controls_are_worked_before() -> None:
    """Without its supply a twin says nothing."""
    recorded("mn400")
    words = ("replay", "capture.txt", "--against", "mn400")
    result = invoke(*words, "--set", "power=off")
    assert result.exit_code == 1
    assert result.stdout.count("\n+ nothing\n") == 5


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("none.txt", "--against", "mac23"), ("none.txt", "give an existing file")),
        (("empty.txt", "--against", "mac23"), ("empty.txt", "nothing from a host")),
        (("empty.txt", "--against", "mac24"), ("unknown model 'mac24'", "mac23")),
        (("empty.txt",), ("--against",)),
        (("capture.txt", "--against", "mac23-can"), ("line 2", "vcan0")),
        (("capture.txt", "--against", "mac23", "--quirk", "xon"), ("NAME=VALUE",)),
        (("capture.txt", "--against", "mac23", "--set", "speed"), ("NAME=VALUE",)),
    ],
)
def test_a_mistake_is_one_clear_line(words: tuple[str, ...], parts: tuple[str, ...]) -> None:
    """With exit status 2."""
    recorded("mac23")
    Path("empty.txt").write_text("# nothing\n", "utf-8")
    assert_one_clear_line(invoke("replay", *words), *parts)
