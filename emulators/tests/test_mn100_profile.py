"""The profile mn100: a board that programs for the predecessor of the MN400 can talk to."""

import tomllib
from pathlib import Path
from typing import Any

import pytest
import serial
from mn400_bench import Mn400Bench, in_short, packets_in

import axistwin as _axistwin  # noqa: F401  registers the URL scheme
from axistwin import discovery
from axistwin.catalog import read_profile
from axistwin.devices.mn400.link.packets import OF_MN100, ReturnCode, packet
from axistwin.devices.mn400.quirks import QUIRKS
from axistwin.errors import UsageError

QUIRKS_OF_MN100: dict[str, Any] = read_profile("mn100", ["mn400"])


@pytest.fixture
def bench() -> Mn400Bench:
    """A board with the profile."""
    return Mn400Bench(**QUIRKS_OF_MN100)


def heard(bench: Mn400Bench, milliseconds: float) -> str:
    """What comes by itself within some time, in short."""
    return " ".join(in_short(raw) for raw in packets_in(bench.wait(milliseconds)))


# ---- the packets ---------------------------------------------------------------------------------


def test_status_packets_have_five_bytes(bench: Mn400Bench) -> None:
    """START and DONE, and what refuses a command."""
    assert bench.ask(packet(1, b"V3000")).hex(" ") == "81 56 03 81 5b 81 56 05 81 5d"
    assert bench.ask(packet(1, b"X3")).hex(" ") == "81 58 03 81 5d 81 58 0e 81 68"
    assert bench.ask(bytes.fromhex("81 2A 81 00")).hex(" ") == "81 2a 07 81 33"


def test_a_value_is_one_number_and_nothing_behind_it(bench: Mn400Bench) -> None:
    """E and N: no further axes, no return code."""
    bench.say("L-120")
    assert bench.ask(packet(1, b"E")).hex(" ") == "81 45 03 81 4a 81 45 2d 31 32 30 81 07"
    assert bench.value("N") == "0"
    assert bench.value("?").startswith("MN100 ")


def test_there_is_one_axis_to_name(bench: Mn400Bench) -> None:
    """A second parameter of M or L is one too many."""
    assert (bench.say("M1,1"), bench.say("L1,1"), bench.say("M5")) == ("S PE", "S PE", "S D")


def test_the_commands_that_came_later_are_unknown(bench: Mn400Bench) -> None:
    """FeedHold and SwitchStatus."""
    assert (bench.say(";1"), bench.say(":")) == ("IC", "IC")


# ---- the end of a motion -------------------------------------------------------------------------


def test_done_comes_when_the_axis_stands(bench: Mn400Bench) -> None:
    """At the very end of the motion, with the command and the address of its START."""
    assert bench.say("M2000") == "S"
    assert bench.value("E") != "2000"
    bench.wait(2000)
    (sent_ns, done) = bench.device.sent[-1]
    assert done.hex(" ") == "81 4d 05 81 54"
    assert bench.value("E") == "2000"
    started_ns = bench.device.sent[0][0] - bench.quirks.response_delay_ms * 1_000_000
    assert (sent_ns - started_ns) / 1e6 == pytest.approx(1050, abs=0.001)


def test_a_motion_without_a_step_is_done_at_once(bench: Mn400Bench) -> None:
    """It is where it should be."""
    assert bench.say("M0") == "S D"


def test_the_parameter_of_a_motion_is_where_to_go(bench: Mn400Bench) -> None:
    """The same twice moves once."""
    assert (bench.say("M100"), heard(bench, 500), bench.say("M100")) == ("S D", "", "S D")
    assert bench.value("E") == "100"


def test_settings_are_done_at_once_and_values_have_no_done(bench: Mn400Bench) -> None:
    """Only motions take time."""
    assert (bench.say("V3000"), bench.say("E"), bench.say("*")) == ("S D", "S 0", "S PR")


def test_a_motion_that_q_ends_is_stopped_with_a_ramp(bench: Mn400Bench) -> None:
    """DONE of Q comes at once, MOVE_STOPPED of the motion when the axis stands."""
    bench.say("F1000,5000,10000", "V5000")
    assert bench.say("M20000", milliseconds=900) == "S"
    assert bench.say("Q", milliseconds=60) == "S D"
    moving = bench.value("E")
    assert heard(bench, 1000) == "STOP"
    assert bench.device.sent[-1][1].hex(" ") == "81 4d 20 81 6f"
    assert int(bench.value("E")) > int(moving)


def test_a_motion_that_a_limit_ends_is_aborted(bench: Mn400Bench) -> None:
    """MOVE_ABORT in place of DONE."""
    bench.say("M20000")
    bench.switch("m1_plus")
    assert heard(bench, 100) == "ABORT"
    assert heard(bench, 20000) == ""


def test_while_it_moves_nothing_but_read_outs_and_q_is_possible(bench: Mn400Bench) -> None:
    """What an MN400 would queue is BUSY."""
    bench.say("M2000")
    assert (bench.say("M1"), bench.say("V500")) == ("S BY", "S BY")
    assert bench.say("N").startswith("S 1")
    assert heard(bench, 2000) == "D"
    assert bench.say("V500") == "S D"


def test_the_release_of_a_held_motion_is_done_at_its_end(bench: Mn400Bench) -> None:
    """The motion itself was taken at once; K set it going."""
    assert (bench.say("H"), bench.say("M500"), bench.say("K")) == ("S D", "S D", "S")
    assert heard(bench, 1000) == "D"
    assert bench.device.sent[-1][1][1:2] == b"K"


def test_each_of_several_motions_is_answered_for_itself() -> None:
    """Where they may wait in a queue; what Q drops from it is stopped as well."""
    bench = Mn400Bench(motion_done="at_end")
    bench.say("V500")
    assert bench.say("M100", "A-20,0,-40,0,1", milliseconds=60) == "S"
    assert heard(bench, 120) == "D"
    assert heard(bench, 300) == "D"
    bench.say("M1000", "M1")
    assert bench.say("Q").split().count("STOP") == 2


def test_a_motion_of_all_boards_is_answered_by_each_in_its_slot() -> None:
    """Their last words do not collide."""
    bench = Mn400Bench(1, 2, 3, motion_done="at_end")
    bench.ask(packet(0, b"M500"), 200)
    done = packets_in(bench.wait(1000))
    assert [raw[:3].hex() for raw in done] == ["814d05", "824d05", "834d05"]


def test_what_a_power_cut_ends_is_not_answered(bench: Mn400Bench) -> None:
    """Nor later."""
    bench.say("M2000")
    bench.power_cycle()
    assert heard(bench, 3000) == ""


# ---- its further codes ---------------------------------------------------------------------------


def test_two_addresses_that_differ_are_an_error(bench: Mn400Bench) -> None:
    """If the sum is right; a packet that follows one that broke off is still obeyed."""
    assert bench.ask(bytes.fromhex("81 2A 85 30")).hex(" ") == "81 2a 08 81 34"
    assert bench.say("*") == "S PR"
    assert packets_in(bench.ask(bytes.fromhex("82 4D 31 81 2A 81 2C")))[1][2] == ReturnCode.PRESENT
    assert bench.ask(bytes.fromhex("85 2A 81 30")) == b""  # of another board


def test_a_packet_without_a_command_is_an_error(bench: Mn400Bench) -> None:
    """A doubled address that a command follows is none."""
    assert bench.ask(bytes.fromhex("81 81 02")).hex(" ") == "81 00 0f 81 11"
    assert packets_in(bench.ask(bytes.fromhex("81 81 2A 81 2C")))[1][2] == ReturnCode.PRESENT


def test_an_output_that_does_not_exist_is_not_available(bench: Mn400Bench) -> None:
    """Its state is another parameter, with the error of any."""
    assert (bench.say("C9,0"), bench.say("C1,2"), bench.say("C8,0")) == ("S NA", "S PE", "S D")


def test_an_mn400_sends_none_of_these_codes() -> None:
    """They belong to the switches of the predecessor."""
    bench = Mn400Bench()
    told = [bench.ask(bytes.fromhex(raw), 700) for raw in ("81 2A 82 2D", "81 81 02", "81")]
    told += [bench.ask(packet(1, line), 50) for line in (b"C9,0", b"M5000", b"Q")]
    codes = {raw[2] for data in told for raw in packets_in(data)}
    assert not codes & set(OF_MN100)


# ---- a program of the predecessor ----------------------------------------------------------------


class Mn100Program:
    """How a program for an MN100 talks: fixed places, and a wait for DONE as long as a move takes.

    ``axis``: its port.  It reads whatever comes within a time, expects START in the first five
    bytes and one more packet behind it, and takes all between the command and the next address of
    that for the value.
    """

    def __init__(self, port: serial.SerialBase, address: int) -> None:
        self._port = port
        self._mark = 0x80 | address

    def _ask(self, text: str, wait_s: float) -> bytes:
        head = bytes((self._mark, *text.encode("ascii"), self._mark))
        self._port.write(head + bytes((sum(head) & 0x7F,)))
        self._port.timeout = wait_s
        data = self._port.read(64)
        assert data[2] == ReturnCode.START
        assert sum(data[:4]) & 0x7F == data[4]
        second = data[5:]
        end = second.index(second[:1], 2)
        assert sum(second[: end + 1]) & 0x7F == second[end + 1]
        return bytes(second[2:end])

    def position(self) -> int:
        """Where the axis is."""
        return int(self._ask("E", 0.5))

    def left(self) -> int:
        """Steps that are not made."""
        return int(self._ask("N", 0.5))

    def name(self) -> str:
        """Name and revision of the device."""
        return self._ask("?", 0.5).decode("ascii")

    def go_to(self, place: int, speed: int = 2000) -> None:
        """Go there; the axis stands when this returns."""
        wait_s = 1.2 * abs(place - self.position()) / speed
        assert self._ask(f"M{place}", wait_s) == bytes((ReturnCode.DONE,))


def test_a_program_for_the_predecessor_runs_unchanged() -> None:
    """It reads values, and waits for the end of a move as it always did."""
    url = "axistwin://mn400:2?time=virtual&profile=mn100"
    with serial.serial_for_url(url, baudrate=9600) as port:
        program = Mn100Program(port, address=2)
        assert (program.position(), program.left()) == (0, 0)
        assert program.name().startswith("MN100 ")
        for place in (25_000, 24_000, -300):
            program.go_to(place)
            assert (program.position(), program.left()) == (place, 0)


def test_such_a_program_does_not_run_with_an_mn400() -> None:
    """Which is why there is a profile."""
    with serial.serial_for_url("axistwin://mn400:2?time=virtual", baudrate=9600) as port:
        program = Mn100Program(port, address=2)
        with pytest.raises(AssertionError):
            program.position()


# ---- the file ------------------------------------------------------------------------------------


def test_the_profile_comes_with_its_family() -> None:
    """Every quirk in it is one of the model, and none has its default."""
    path = discovery.profiles()["mn100"]
    assert path.parent.name == "profiles"
    table: dict[str, Any] = tomllib.loads(path.read_text("utf-8"))
    assert table["model"] == "mn400"
    for name, value in table["quirks"].items():
        assert QUIRKS[name].parse(value) != QUIRKS[name].parse(QUIRKS[name].default), name


def test_a_file_of_that_name_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What lies in the folder was put there by the user."""
    monkeypatch.chdir(tmp_path)
    Path("mn100").write_text('model = "mn400"\n[quirks]\nhold_takes_arg = false\n', "utf-8")
    assert read_profile("mn100", ["mn400"]) == {"hold_takes_arg": False}


def test_a_profile_that_does_not_exist_names_those_that_do() -> None:
    """And one of another model is refused as a file would be."""
    with pytest.raises(UsageError, match=r"profile mn10: cannot be read .* with a model: mn100"):
        read_profile("mn10", ["mn400"])
    with pytest.raises(UsageError, match="profile mn100: key 'model' is 'mn400', but the line has"):
        read_profile("mn100", ["mac23"])
