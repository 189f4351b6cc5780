"""What ``axistwin plot`` draws: the motion of a twin in virtual time, and what it is told."""

from pathlib import Path
from typing import Any

import pytest

from axistwin import catalog
from axistwin.cli.plot import sources
from axistwin.cli.plot.track import MARGIN, MotionTrack, chosen_axes, chosen_planes
from axistwin.cli.plot.twin_motion import SAMPLES, HostMessage, PlayedMotion, moved_twin
from axistwin.cli.replay.capture import read_capture
from axistwin.cli.replay.comparison import differences
from axistwin.cli.replay.host_port import TwinSetup
from axistwin.devices.family import Model
from axistwin.devices.mn400.link.packets import packet
from axistwin.errors import UsageError

MAC, CAN, STEPS = (catalog.find_model(name) for name in ("mac23", "mac23-can", "mn400"))
CONTOUR = ("V3000", "(50", "M500,,500", "M505,,500", "M509,,500", "V3850", "M530,,505", "M520,,510")


def played(
    model: Model,
    *texts: str,
    messages: list[HostMessage] | None = None,
    limit_s: float = 60.0,
    quirks: dict[str, Any] | None = None,
    **controls: Any,
) -> tuple[PlayedMotion, MotionTrack]:
    """What a twin of the model does that is told ``texts``."""
    view = model.family.axis_readout()
    assert view is not None
    address = model.default_address
    setup = TwinSetup(model, address, quirks or {}, controls)
    said = sources.from_words(model, address, texts) if messages is None else messages
    return moved_twin(setup, view, said, limit_s)


def moved(model: Model, *texts: str, **options: Any) -> MotionTrack:
    """The part with motion."""
    return played(model, *texts, **options)[1].trimmed()


# ---- twins ---------------------------------------------------------------------------------------


def test_a_ramp_of_a_module_is_drawn_with_its_pieces() -> None:
    """Position and rate as its shaft has them, on a line and on a bus."""
    for model in (MAC, CAN):
        track = moved(model, "go to 1000")
        assert (track.names, track.unit) == (("axis",), "increments")
        assert (track.positions[0], track.positions[-1]) == ((0,), (1000,))
        assert track.span_s == pytest.approx(0.304, abs=0.001)
        assert max(track.speeds(0)) == pytest.approx(6250)
        assert min(track.speeds(0)) == 0


def test_a_contour_is_drawn_as_the_ledger_reckons_it() -> None:
    """Its time, the speeds at its junctions, and the axes that move."""
    track = moved(STEPS, *CONTOUR, ")")
    assert track.moved == ["M1", "M3"]
    assert track.span_s == pytest.approx(0.957, abs=0.002)
    assert track.positions[-1] == (2564, 0, 2515, 0)
    rates = dict(zip(track.times_s, track.speeds(0), strict=True))
    at = {goal: rates[min(rates, key=lambda time_s: abs(time_s - goal))] for goal in (0.4, 0.66)}
    assert at[0.4] == pytest.approx(3000)
    assert at[0.66] == pytest.approx(3850, rel=0.001)


def test_the_track_begins_with_the_first_step() -> None:
    """With a margin around, whatever was said before."""
    track = moved(STEPS, "V500", "wait 5 s", "M100")
    before = [
        time_s
        for time_s, (place, *_) in zip(track.times_s, track.positions, strict=True)
        if not place
    ]
    assert max(before) == pytest.approx(0.002, abs=0.001)
    assert track.times_s[0] == pytest.approx(-MARGIN * 0.2, abs=0.001)
    assert track.times_s[-1] == pytest.approx(0.2 * (1 + MARGIN), abs=0.002)
    assert SAMPLES * 0.9 < len(track.times_s) <= SAMPLES * 1.1


def test_pauses_and_commands_meanwhile_are_part_of_it() -> None:
    """A move that is paused, and goes on, has a plateau."""
    track = moved(STEPS, "V500", "M500", "wait 200 ms", "{", "wait 1 s", "}")
    assert track.positions[-1][0] == 500
    assert 1.8 < track.span_s < 2.3
    middle = track.positions[len(track.positions) // 2]
    assert 0 < middle[0] < 500
    assert track.speeds(0)[len(track.positions) // 2] == 0


def test_replies_are_told_as_they_came() -> None:
    """Of each command by itself, also of one that is refused; a pause has what came in it."""
    done, _ = played(STEPS, "M10", "X3", "wait 50 ms", "E")
    told = [" / ".join(map(STEPS.explain, reply)) for reply in done.replies]
    assert told[0] == "Mover: START (board 1); Mover: DONE (board 1)"
    assert told[1] == "SetMultiplex: START (board 1); SetMultiplex: PARA_ERROR (board 1)"
    assert told[2:] == ["", "ReadPosition: START (board 1); ReadPosition = 10,0,0,0 (board 1)"]


def test_a_program_waits_for_the_axes_between_its_lines(tmp_path: Path) -> None:
    """Which live commands do not: a module refuses the second one."""
    path = tmp_path / "part.txt"
    path.write_text("go to 500   # there\n\n# and back\ngo to -500\n", "utf-8")
    done, track = played(MAC, messages=sources.from_program(MAC, 0, str(path)))
    assert [MAC.explain(reply[0]) for reply in done.replies] == ["accepted", "accepted"]
    assert track.positions[-1] == (-500,)
    done, track = played(MAC, "go to 500", "go to -500")
    assert [MAC.explain(reply[0]) for reply in done.replies] == ["accepted", "refused"]
    assert track.positions[-1] == (500,)


def test_controls_are_worked_before() -> None:
    """A spindle that threads; without one the axis waits, and that is told."""
    track = moved(STEPS, "T400,-500,,,1000,50", spindle_hz=1000)
    assert track.span_s == pytest.approx(1.0, abs=0.01)
    assert track.positions[-1] == (400, -500, 0, 0)
    done, waiting = played(STEPS, "T400,,,,1000", limit_s=1.0)
    assert done.is_cut
    with pytest.raises(UsageError, match="nothing has moved"):
        waiting.trimmed()


def test_a_motion_without_an_end_is_cut() -> None:
    """After the time that is allowed."""
    done, track = played(MAC, "velocity +, period 1000", limit_s=2.0)
    assert done.is_cut
    assert 2.0 <= track.times_s[-1] - track.times_s[0] < 2.3


def test_quirks_are_those_of_the_twin() -> None:
    """The other reading of the acceleration takes longer."""
    spans = [
        moved(STEPS, "V3000", "M10000", quirks={"accel_scale": scale}).span_s
        for scale in ("1.0", "0.5")
    ]
    # Without the default ramp to 3000 steps/s, which takes 0.2 s or 0.4 s.
    assert spans == [pytest.approx(3.467, abs=0.002), pytest.approx(3.6, abs=0.002)]


def test_a_module_that_stands_cannot_be_drawn() -> None:
    """One line says so."""
    with pytest.raises(UsageError, match="nothing has moved, so there is nothing to draw"):
        moved(MAC, "status?")


# ---- recordings ----------------------------------------------------------------------------------


def recording(*rows: tuple[float, str, str]) -> str:
    """As ``--capture`` writes it."""
    return "# 2026-01-01\n" + "".join(f"{at:12.3f} {way} {data}  words\n" for at, way, data in rows)


def test_a_recording_is_said_again_at_its_times(tmp_path: Path) -> None:
    """Replies that the twin gives otherwise are found."""
    path = tmp_path / "capture.txt"
    move, query, start, done = (
        packet(1, payload).hex(" ") for payload in (b"M200", b"E", b"M\x03\0", b"M\x05\0")
    )
    after = " ".join(packet(1, text).hex(" ") for text in (b"E\x03\0", b"E200,0,0,0\x06"))
    path.write_text(
        recording(
            (1000, ">", move),
            (1020, "<", f"{start} {done}"),
            (3000, ">", query),
            (3010, "<", after),
        ),
        "utf-8",
    )
    exchanges = read_capture(STEPS, str(path))
    messages = sources.from_exchanges(exchanges)
    assert [message.at_ns for message in messages] == [0, 2_000_000_000]
    track = played(STEPS, messages=messages)[1]
    assert not differences(TwinSetup(STEPS, 1, {}), exchanges)
    assert track.trimmed().positions[-1] == (200, 0, 0, 0)
    other = differences(TwinSetup(STEPS, 1, {"data_packet_trailer": "none"}), exchanges)
    assert [each.index for each in other] == [1]


def test_a_recording_of_a_bus_is_said_again(tmp_path: Path) -> None:
    """The frames of the host; those of the module are compared."""
    path = tmp_path / "candump.log"
    path.write_text(
        "(1795284668.800000) vcan0 601#23132000000003E8 T\n"
        "(1795284668.802000) vcan0 581#6013200000000000 R\n",
        "utf-8",
    )
    exchanges = read_capture(CAN, str(path))
    track = played(CAN, messages=sources.from_exchanges(exchanges))[1]
    assert not differences(TwinSetup(CAN, 1, {}), exchanges)
    assert track.trimmed().positions[-1] == (1000,)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("81 45 81 47\n", r"line 1: '81 45 81 47'; a recording of 'axistwin run --capture' has"),
        ("hello\n", "line 1: 'hello'"),
        ("# nothing\n", "it has nothing from a host"),
        ("      12.000 < 81 45\n", "it has nothing from a host"),
    ],
)
def test_what_is_no_recording_is_one_clear_line(tmp_path: Path, text: str, words: str) -> None:
    """It names the file, the line, and the form."""
    path = tmp_path / "capture.txt"
    path.write_text(text, "utf-8")
    with pytest.raises(UsageError, match=words):
        read_capture(STEPS, str(path))


@pytest.mark.parametrize(
    ("text", "words"),
    [("M100\nhopp\n", "line 2: 'hopp' is no command"), ("# nothing\n", "it has no command")],
)
def test_what_is_no_program_is_one_clear_line(tmp_path: Path, text: str, words: str) -> None:
    """With the number of the line."""
    path = tmp_path / "part.txt"
    path.write_text(text, "utf-8")
    with pytest.raises(UsageError, match=words):
        sources.from_program(STEPS, 1, str(path))


# ---- axes and planes -----------------------------------------------------------------------------

TRACK = MotionTrack(
    ("M1", "M2", "M3"), "steps", [0.0, 1.0], [(0, 0, 0), (1, 0, 2)], [(1.0, 0.0, 2.0)] * 2
)


def test_axes_and_planes_are_those_that_move() -> None:
    """Unless others are named."""
    assert chosen_axes(TRACK, None) == [0, 2]
    assert chosen_planes(TRACK, None, [0, 2]) == [(0, 2)]
    assert chosen_planes(TRACK, None, [0, 1, 2]) == [(0, 1), (0, 2), (1, 2)]
    assert chosen_planes(TRACK, None, [1]) == []
    assert chosen_axes(TRACK, "m2, M3") == [1, 2]
    assert chosen_planes(TRACK, "M3-M1", [0]) == [(2, 0)]


def test_axes_that_do_not_exist_are_named_with_those_that_do() -> None:
    """In one line."""
    with pytest.raises(UsageError, match="axis 'X': known: M1, M2, M3"):
        chosen_axes(TRACK, "X")
    with pytest.raises(UsageError, match="plane 'M1': write two axes, such as M1-M3"):
        chosen_planes(TRACK, "M1", [0])
