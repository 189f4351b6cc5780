"""Stored programs of an MN400, its power-up, and USB."""

import pytest
from mn400_bench import Mn400Bench, in_short, packets_in

from axistwin.devices.mn400.link.packets import packet
from axistwin.errors import UsageError


def entered(bench: Mn400Bench, *lines: str) -> None:
    """Store a user program."""
    assert {bench.say("Z"), *(bench.say(line) for line in lines), bench.say("\x04")} == {"S D"}


def configured(bench: Mn400Bench, *lines: str) -> None:
    """Store a configuration program."""
    assert {bench.say("."), *(bench.say(line) for line in lines), bench.say("Q")} == {"S D"}


def test_a_program_is_stored_and_listed_line_by_line() -> None:
    """Verbatim, and nothing of it moves (MN4-NVM-01, MN4-NVM-02, MN4-STM-04, MN4-STM-05)."""
    bench = Mn400Bench()
    entered(bench, "M1000", "m-1000", "Q", "*", "E", "V12.5")
    assert bench.peek() == [0, 0, 0, 0]
    heard = packets_in(bench.ask(packet(1, b"R"), 200))
    assert [in_short(raw) for raw in heard] == ["S", "M1000", "m-1000", "Q", "*", "E", "V12.5"]
    assert {raw[1:2] for raw in heard} == {b"R"}


def test_an_entered_program_is_stored_before_its_end_is_acknowledged() -> None:
    """One store, in front of the reply; not before the end of the entry."""
    bench = Mn400Bench()
    bench.say("Z", "M1", "M2")
    assert bench.device.stored == []
    bench.say("\x04")
    assert len(bench.device.stored) == 1
    assert dict(bench.device.stored[0].cells) == dict(bench.device.cells(bench.now))


def test_the_program_outlives_the_supply_and_a_new_one_replaces_it() -> None:
    """A half entered one never was (MN4-NVM-03)."""
    bench = Mn400Bench()
    entered(bench, "M1", "M2")
    bench.say("Z", "M3")
    bench.power_cycle()
    assert bench.say("R") == "S M1 M2"
    entered(bench, "M4")
    assert bench.say("R") == "S M4"
    again = Mn400Bench(cells=bench.device.cells(bench.now))
    assert again.say("R") == "S M4"


def test_a_program_runs_in_silence_its_settings_in_turn_with_its_moves() -> None:
    """The manual's way of writing them (MN4-CMD-U-01, MN4-NVM-10, MN4-NVM-13)."""
    bench = Mn400Bench()
    entered(bench, "V500", "M1000", "V1000", "M-1000")
    assert bench.say("U") == "S D"
    bench.wait(1900)
    assert bench.peek()[0] in range(990, 1000)
    assert bench.wait(500) == b""
    assert 400 < bench.peek()[0] < 700
    bench.wait(1000)
    assert bench.peek()[0] == 0
    assert bench.value("/") == "0"


def test_a_program_can_be_quit_and_paused() -> None:
    """Q ends it for good (MN4-CMD-Q-05), { until } (MN4-CMD-PAU-03)."""
    bench = Mn400Bench()
    entered(bench, "M1000", "M,1000")
    bench.say("U", "{")
    bench.wait(2000)
    stood = bench.peek()
    assert stood[0] < 1000
    bench.say("}")
    bench.wait(2000)
    assert bench.peek() == [1000, 1000, 0, 0]
    bench.say("U", "Q")
    stood = bench.peek()
    bench.wait(2000)
    assert bench.peek() == stood


def test_a_line_that_is_refused_ends_the_program() -> None:
    """Parameters are judged when it runs (MN4-AMB-54)."""
    bench = Mn400Bench()
    entered(bench, "M10", "V1", "M10")
    bench.say("U")
    bench.wait(1000)
    assert bench.peek()[0] == 10
    entered(bench, "M10", "U")
    bench.say("U")
    bench.wait(1000)
    assert bench.peek()[0] == 20


def test_a_program_may_hold_a_contour_and_change_number() -> None:
    """What a live command could not while it runs (ledger §4.1, note 6)."""
    bench = Mn400Bench()
    entered(bench, "(50", "M100", "M100", ")", "=3", "H", "M5", "M7")
    bench.say("U")
    bench.wait(1000)
    assert bench.peek()[0] == 200
    assert bench.say("E", number=3) == "S MP"
    assert bench.say("K", number=3) == "S D"
    bench.wait(500)
    assert bench.peek()[0] == 205
    assert bench.say("K", number=3) == "S D"
    bench.wait(500)
    assert bench.peek()[0] == 212


def test_the_configuration_of_the_manual_answers_at_power_up() -> None:
    """=5 and ~4: each reply at the number and rate then in force (MN4-NVM-07)."""
    bench = Mn400Bench()
    configured(bench, "=5", "~4")
    assert bench.say("*") == "S PR"
    bench.power_cycle()
    heard = bench.wait(40)
    assert heard[:18] == bytes.fromhex("81 3D 03 00 81 42 85 3D 05 00 85 4C 85 7E 03 00 85 0B")
    bench.host_rate(115200)
    bench.power_cycle()
    assert bench.wait(100).endswith(bytes.fromhex("85 7E 12 00 85 1A"))
    assert bench.say("*", number=5) == "S PR"


def test_a_configuration_may_hold_everything_but_programs_and_q() -> None:
    """Also motion and read-outs (MN4-NVM-06); Q ends it and is not stored (MN4-CMD-Q-04)."""
    bench = Mn400Bench()
    bench.say(".")
    assert [bench.say(line) for line in ("Z", ".", "W", "\x04")] == ["S IP"] * 4
    assert [bench.say(line) for line in ("V500", "M50", "E", "Q")] == ["S D"] * 4
    bench.power_cycle()
    heard = bench.wait(500)
    told = [in_short(raw) for raw in packets_in(heard)]
    assert told[:5] == ["S", "D", "S", "D", "S"]
    assert told[5].endswith(",0,0,0")
    assert bench.peek()[0] == 50


def test_the_programs_do_not_touch_one_another() -> None:
    """MN4-NVM-11; live settings never reach the memory (MN4-PWR-03)."""
    bench = Mn400Bench()
    configured(bench, "V500")
    entered(bench, "M1")
    bench.say("B9,9,9,9", "D-1", "P4,1", "X4", "L7")
    cells = bench.device.cells(bench.now)
    assert len(cells) == 2
    configured(bench)
    assert bench.say("R") == "S M1"


def test_a_full_memory_is_told_and_keeps_what_it_has() -> None:
    """MEMORY_FULL behind START (MN4-NVM-09); a configuration takes from the same room."""
    bench = Mn400Bench(nvm_size=30)
    configured(bench, "V500", "V600")
    bench.say("Z")
    assert [bench.say("M1,2,3,4") for _ in range(3)] == ["S D", "S D", "S MF"]
    bench.say("\x04")
    assert bench.say("R") == "S M1,2,3,4 M1,2,3,4"


def test_a_full_store_keeps_what_is_there() -> None:
    """8 KiB, to the last byte that fits; half entered anew, the old one is there after power-up."""
    bench = Mn400Bench(paced=False, response_delay_ms=0)
    configured(bench, "V500", "L1,2,3,4")
    bench.say("Z")
    lines = [f"M{number},{-number}" + ",99999" * (number % 3) for number in range(1000)]
    answers = [bench.say(line, milliseconds=1) for line in lines]
    room = 8192 - len("V500L1,2,3,4") - 2
    kept: list[str] = []
    for line, answer in zip(lines, answers, strict=True):
        fits = sum(map(len, kept)) + len(kept) + len(line) + 1 <= room
        assert answer == ("S D" if fits else "S MF"), line
        kept += [line] * fits
    assert "S MF" in answers
    assert bench.say("\x04") == "S D"
    for _ in range(2):
        assert bench.say("R") == " ".join(["S", *kept])
        assert {bench.say("Z"), bench.say(lines[0])} == {"S D"}
        bench.power_cycle()
        assert bench.wait(100)
        assert bench.value("E") == "1,2,3,4"


def test_a_power_cycle_brings_every_default_back() -> None:
    """MN4-PWR-01, MN4-PWR-02."""
    bench = Mn400Bench()
    lines = ("V300", "F500", "H", "H0", ";1", "C1,0", "I1", "P4,1", "X4", "B9,9,9,9", "L1,2,3,4")
    assert {bench.say(line) for line in lines} == {"S D"}
    bench.say("J1")
    bench.power_cycle()
    assert bench.value("E") == "0,0,0,0"
    assert bench.value(":") == "1,0,0,0,0"
    assert not bench.device.output_at(bench.now, 1)
    assert bench.moving_ms("M-10000") == 5050


def test_without_supply_nothing_moves_counts_or_is_sent() -> None:
    """What was to be said is not said later, inputs and pulses have no effect."""
    bench = Mn400Bench()
    bench.say("M5000", "E2")
    bench.network.power_off(0)
    assert bench.device.describe(bench.now).state_text == "off"
    assert not bench.device.moves_at(bench.now)
    bench.switch("m1_plus")
    bench.perform(bench.device.feed_pulses(bench.now, 5))
    bench.perform(bench.device.send_usb(bench.now, "E"))
    assert bench.ask(packet(1, b"*"), 3000) == b""
    assert bench.peek() == [0, 0, 0, 0]
    bench.network.power_on(0)
    assert bench.wait(3000) == b""
    assert bench.value("S") == "2"
    assert bench.device.take_report(bench.now) == []


# ---- USB ----


def usb(bench: Mn400Bench, text: str) -> list[str]:
    """Send a report; what comes back, in hex."""
    bench.perform(bench.device.send_usb(bench.now, text))
    bench.wait(200)
    reports = bench.device.take_report(bench.now)
    bench.perform(bench.device.drop_reports(bench.now))
    return reports


def said(report: str) -> str:
    """A report as text."""
    return bytes.fromhex(report).decode()


def test_usb_says_values_and_errors_and_nothing_else() -> None:
    """No address, sum, START or DONE (MN4-USB-03, MN4-USB-04, MN4-USB-05, MN4-USB-08)."""
    bench = Mn400Bench()
    assert usb(bench, "L1,2,3,4") == []
    assert [said(each) for each in usb(bench, "E")] == ["E1,2,3,4"]
    assert usb(bench, "*") == ["2A 16"]
    assert usb(bench, "X3") == ["58 0E"]
    assert usb(bench, "W") == ["57 0C"]
    assert usb(bench, "K") == ["4B 10"]
    assert usb(bench, "~0") == []
    assert [said(each) for each in usb(bench, "&")] == ["&\x10"]


def test_48_bytes_of_a_report_are_looked_at() -> None:
    """The example of the ledger (MN4-USB-02)."""
    bench = Mn400Bench()
    assert usb(bench, "L1,2,3," + "0" * 33 + "123456789") == []
    assert [said(each) for each in usb(bench, "E")] == ["E1,2,3,12345678"]
    number = "-2147483647"
    assert len(f"M{number},{number},{number},{number}") == 48
    assert usb(bench, f"L{number},{number},{number},{number}") == []


def test_a_report_holds_one_command() -> None:
    """What is behind a null is not looked at (MN4-USB-06)."""
    bench = Mn400Bench()
    bench.perform(bench.device.receive_report(bench.now, b"E\x00L5,0,0,0".ljust(64, b"\x00")))
    bench.wait(50)
    assert bench.peek()[0] == 0
    assert len(bench.device.reports) == 1


def test_usb_is_answered_whatever_the_number_is_and_beside_the_line() -> None:
    """Each port has its own last message (MN4-USB-07, MN4-PHY-05)."""
    bench = Mn400Bench()
    bench.say("=9")
    assert [said(each) for each in usb(bench, "E")] == ["E0,0,0,0"]
    assert in_short(bench.ask(packet(9, b"&"))) == "D"
    assert bench.wait(100) == b""


def test_a_host_that_does_not_read_loses_the_oldest_reports() -> None:
    """Eight are kept (ledger §2.8)."""
    bench = Mn400Bench()
    for number in range(12):
        bench.perform(bench.device.send_usb(bench.now, f"L{number}"))
        bench.perform(bench.device.send_usb(bench.now, "E"))
        bench.wait(5)
    reports = bench.device.take_report(bench.now)
    assert [said(each) for each in reports] == [f"E{number},0,0,0" for number in range(4, 12)]


def test_a_report_that_is_none_is_a_mistake() -> None:
    """Longer than 64, or not ASCII."""
    bench = Mn400Bench()
    for text in ("x" * 65, "é"):
        with pytest.raises(UsageError, match="64 characters"):
            bench.device.send_usb(bench.now, text)
