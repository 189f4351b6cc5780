"""The line of a failure that sends its last requests again."""

import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from contracts import planted
from contracts.golden import FOLDER

from axistwin.cli.program import main
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.report.by_hand import again, in_lines, timeout_s
from axistwin_conformance.report.failures import Statement
from axistwin_conformance.report.json import plain

MS = 1_000_000
PASTED = {  # a failure of each family: the zoo of its planted fault, and the fault
    "framing-checksum": ("zoo", "the_sum_over_the_length_field_passes"),
    "refusals-form": ("zoo_can", "refusals_forget_what_they_refuse"),
    "framing-packet": ("zoo_msc", "a_sum_may_leave_the_unit_out"),
    "board-checksum": ("zoo_mn400", "a_sum_may_be_one_more"),
}
TWIN = "axistwin://mac23:0,mac23:1?time=virtual"
RECORDED = sorted((Path(__file__).parent / "contracts" / "golden").glob("*-faulty*/told.txt"))


@pytest.mark.parametrize("path", RECORDED, ids=lambda path: path.parent.name)
def test_a_line_that_is_pasted_reproduces_the_exchange(path: Path) -> None:
    """Each failure of each record has one, and the requests that stand in its transcript."""
    text = path.read_text(encoding="utf-8")
    failures = re.split(r"^FAIL  ", text.replace(" \\\n", ""), flags=re.MULTILINE)[1:]
    assert failures
    for failure in failures:
        line = re.search(r"^   by hand     (.*)$", failure, re.MULTILINE)
        assert line is not None, failure
        if line[1].startswith("not "):
            continue
        program, *words = shlex.split(line[1])
        assert program == "axistwin"
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 0, result.output
        sent = re.findall(r"^> (?!wait)(\S+(?: \S+)*)", result.output, re.MULTILINE)
        said = re.findall(r"^ +[\d.]+  host     (.{3,}?)  ", failure, re.MULTILINE)
        assert said[-1] == sent[-1]  # the request that was judged
        assert result.output.count("\n< ") == len(sent)


@pytest.mark.system
@pytest.mark.parametrize("name", PASTED)
def test_a_line_that_is_pasted_for_a_port_reproduces_the_exchange(
    name: str, tmp_path: Path
) -> None:
    """The port in the place of the URL, as the text says: a pty, and slcan on one for CAN."""
    text = (FOLDER / "failures" / f"{name}.txt").read_text(encoding="utf-8")
    line = re.search("^by hand: axistwin (.*)$", text, re.MULTILINE)
    assert line is not None
    verb, url, *words = shlex.split(line[1])
    devices = re.findall(r"[\w-]+:\d+", url.removeprefix("axistwin:"))
    link, is_on_can = str(tmp_path / "port"), "-can" in url
    served = ["run", *devices, "--slcan" if is_on_can else "--pty", link]
    served += ["--program", "bench"] if "program=bench" in url else []
    command = [sys.executable, planted.__file__, *PASTED[name], *served]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdout is not None
        assert daemon.stdout.readline().startswith("ready ")
        port = f"slcan:{link}" if is_on_can else link
        result = CliRunner().invoke(main, [verb, port, *words, "--timeout", "20"])
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(60) == 0
    assert result.exit_code == 0, result.output
    answers = re.findall(r" ← device ((?:[0-9A-F]{2} )+|[0-9A-F]+#[0-9A-F]*)", text)
    said = re.findall("^< (.*?)  ", result.output, re.MULTILINE)
    assert said[-1].startswith(answers[-1].strip())


def test_between_the_requests_is_waited_as_long_as_it_was() -> None:
    """From the answer to the next request; what the host acknowledges is no request."""
    records = [
        Record(0, Direction.HOST, b"\x02\x01"),
        Record(100 * MS, Direction.DEVICE, b"\x06\x02"),
        Record(100 * MS, Direction.HOST, b"\x06"),
        Record(450 * MS, Direction.HOST, b"\x02\x02"),
        Record(460 * MS, Direction.HOST, b"\x02\x03"),
    ]
    assert again(plain(records), (0, 3, 4)) == [
        "02 01",
        "wait 350 ms",
        "02 02",
        "wait 10 ms",
        "02 03",
    ]
    assert again(plain(records), ()) == []


def test_an_idle_wait_is_kept_though_short() -> None:
    """An axis may have moved in it, and in the time of a request that is left out as well."""
    said = ((0, "host"), (19, "host"), (20, "host"), (39, "device"), (40, "host"), (60, "host"))
    records = [Record(at * MS, Direction(who), bytes((2, at))) for at, who in said]
    assert again(plain(records), (0, 1)) == ["02 00", "wait 19 ms", "02 13"]
    assert again(plain(records), (1, 4)) == ["02 13", "wait 21 ms", "02 28"]
    assert again(plain(records), (1, 5)) == ["02 13", "wait 41 ms", "02 3C"]


def test_after_an_earlier_exchange_is_not_waited_for_all_that_came_between() -> None:
    """No pause, however long, says that a device may have another reading of a matter."""
    records = [
        Record(0, Direction.HOST, b"\x02\x01"),
        Record(MS, Direction.NOTE, text="in this check:"),
        Record(90_000 * MS, Direction.HOST, b"\x02\x02"),
    ]
    assert again(plain(records), (0, 2)) == ["02 01", "wait 2500 ms", "02 02"]


def test_what_is_done_to_the_device_stands_between_the_requests() -> None:
    """With no pause: whoever does it takes their time; unless a device is long in coming back."""
    records = [
        Record(0, Direction.HOST, b"\x02\x01"),
        Record(500 * MS, Direction.NOTE, text="rig: the power was switched on"),
        Record(1300 * MS, Direction.HOST, b"\x02\x02"),
    ]
    acts = ["02 01", "rig: the power was switched on", "02 02"]
    assert again(plain(records), (0, 1, 2)) == acts
    records[2:] = [
        Record(2790 * MS, Direction.DEVICE, b"\x06"),  # it says that it is back
        Record(2800 * MS, Direction.HOST, b"\x02\x02"),
    ]
    assert again(plain(records), (0, 1, 3)) == [*acts[:2], "wait 2300 ms", acts[2]]


TARGET = f"built-in twin ({TWIN})"
RUN = {"model": "mac23", "baud": 38400, "bitrate": None, "address": 0}
POWERED = ("rig: the power was switched off", "rig: the power was switched on")


def worked(target: str, *records: Record) -> list[str]:
    """The steps by hand of a failure in which all these records have to be done again."""
    numbers = [n for n, one in enumerate(records) if one.direction is not Direction.DEVICE]
    told = [{**one, "decoded": ""} for one in plain(records)]
    one = Statement("fail", "It did not.", "", told, (), numbers, "by hand as well")
    return list(in_lines({**RUN, "target": target}, one))


def test_how_to_work_a_device_stands_beside_the_command_for_a_twin() -> None:
    """The order to a person comes first; a device at a port has no such command."""
    records = [
        *(Record(n * MS, Direction.NOTE, text=text) for n, text in enumerate(POWERED)),
        Record(5 * MS, Direction.HOST, b"\x02\x02"),
    ]
    assert worked(TARGET, *records)[1:-2] == [
        "to see it on a twin, in another terminal:",
        "axistwin run mac23:0 mac23:1 --control 127.0.0.1:8080",
        "now: Switch the supply off.",
        "axistwin ctl mac23:0 power off",
        "now: Switch the supply on.",
        "axistwin ctl mac23:0 power on",
        "axistwin send ./mac23 --model mac23 --baud 38400 '02 02'",
    ]
    assert worked("/dev/ttyUSB0", *records)[1:-1] == [
        "now: Switch the supply off.",
        "now: Switch the supply on.",
        "axistwin send /dev/ttyUSB0 --model mac23 --baud 38400 '02 02'",
    ]


def test_a_module_that_was_judged_alone_is_alone_by_hand() -> None:
    """A neighbour would take part in what has no address."""
    name = "only_its_own_address_and_ff_reach_it"
    checks = find_family("mac23").checks()
    alone = next(one.name for one in checks if "alone" in one.needs)
    told = [{**one, "decoded": ""} for one in plain([Record(0, Direction.HOST, b"\x02\x02")])]
    for check, url in ((name, TWIN), (alone, TWIN.replace(",mac23:1", ""))):
        one = Statement("fail", "It did not.", "", told, (), [0], check=check)
        assert next(in_lines({**RUN, "target": TARGET}, one)).split()[4] == shlex.quote(url)


def test_what_comes_unasked_is_listened_for_before_the_device_is_worked() -> None:
    """For as long as it took, and as a hand takes, with a margin."""
    records = [
        Record(0, Direction.NOTE, text=POWERED[1]),
        Record(2001 * MS, Direction.DEVICE, b"\x06"),
    ]
    assert worked("/dev/ttyUSB0", *records)[1:] == [
        "start this first, and go on while it listens (20 s):",
        "axistwin send /dev/ttyUSB0 --model mac23 --baud 38400 'wait 22600 ms'",
        "now: Switch the supply on.",
    ]


def test_a_module_elsewhere_is_named_to_what_is_typed_in_words() -> None:
    """Bytes hold their address."""
    go, look = Record(0, Direction.NOTE, text="go to 0"), Record(0, Direction.HOST, b"\x02\x02")
    told = [{**one, "decoded": ""} for one in plain([look])]
    run = {**RUN, "target": "/dev/ttyUSB0", "address": 5}
    for before, more in (((), ""), (plain([go]), " --address 5 'go to 0'")):
        one = Statement("fail", "It did not.", "", told, (), [0], before=before)
        [line] = in_lines(run, one)
        assert line.endswith(f"--baud 38400{more} '02 02'")


def test_a_slow_reply_is_waited_for() -> None:
    """Longer than a reply usually takes, if it has to be."""
    records = [Record(0, Direction.HOST, b"\x02\x01"), Record(1002 * MS, Direction.DEVICE, b"\x15")]
    assert timeout_s(plain(records), (0,)) == 3
    assert timeout_s(plain([records[0], Record(MS, Direction.DEVICE, b"\x06")]), (0,)) == 0
