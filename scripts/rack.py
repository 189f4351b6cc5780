"""Starts four serial lines and a CAN bus, and judges a twin on each over its own pty, all at once.

On two lines are a MAC23 at 0 and a MAC34 at 5; on the first the MAC23 is judged, on the second the
MAC34.  On the bus, a hub with an slcan adapter for a pty, are two MAC23, of which the first is
judged.  What each says about the other stays out of it.  On the third line is an MSC, on the fourth
are two MN400, of which the first is judged.  At the end stand one table with the verdicts of all,
and what failed, in at most 40 lines of 80 columns.  With ``--fault`` one twin has a planted fault,
to see what is printed of a wrong device.  Used by ``scripts/run``; ends with status 0 when every
twin conforms.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import importlib
import json
import signal
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any

TESTS = Path(__file__).resolve().parents[1] / "conformance" / "tests"  # where the faults are
WIDTH, MOST_LINES = 80, 40
LINES_AROUND = 15  # of those: what is printed before the verdicts, and behind them
HEAD_LINES, LEAST_LINES = 2, 2  # of a twin that failed, above its failures; of each failure
ALONE = "leave the ports alone until the table is printed: another client spoils it"
LEGEND = (  # below the table
    "judged: requirements with a verdict, of those chosen; the others need --level full"
    " or more of --allow.  open: inconclusive."
)
ENDING_S = 20.0  # a judgement that is broken off stops the axis and puts everything back first
INTERRUPTED = 130


@dataclass(frozen=True, slots=True)
class Place:
    """A line or a bus: the twins on it, the one that is judged first; where its pty is linked.

    `option` of ``axistwin run`` makes it, `way` of ``axistwin conform`` leads to it.  `ids`: what
    is judged there; none means all of the level.  `served`, `granted`: more words for the one who
    serves, and for the one who judges.  `zoo`: where the faults are that can be planted there;
    `fault`: the one that is.
    """

    link: str
    devices: tuple[tuple[str, int], ...]
    option: str = "--pty"
    way: tuple[str, str] = ("--port", "{}")
    ids: tuple[str, ...] = ()
    served: tuple[str, ...] = ()
    granted: tuple[str, ...] = ("--allow", "motion,stored")
    zoo: str = "zoo"
    fault: str = ""

    @property
    def judged(self) -> str:
        """The model that is judged."""
        return self.devices[0][0]

    def serving(self) -> list[str]:
        """The command that serves it."""
        planted = [str(TESTS / "contracts" / "planted.py"), self.zoo, self.fault]
        devices = [f"{model}:{address}" for model, address in self.devices]
        program = planted if self.fault else ["-m", "axistwin"]
        return [sys.executable, *program, "run", *devices, *self.served, self.option, self.link]

    def judging(self) -> list[str]:
        """The words after ``axistwin`` that judge it."""
        (model, address), *others = self.devices
        option, form = self.way
        words = ["conform", model, option, form.format(self.link), "--address", str(address)]
        words += [*self.granted, "--level", "quick"]
        words += [word for _, one in others for word in ("--neighbour", str(one))]
        return [*words, *self.ids]


# What is left out on the bus takes longer than all that is judged on a line: a lifebeat comes every
# 10 s.
ON_THE_BUS = ("MACC-ID", "MACC-SYNC", "MACC-GEN", "MACC-CMD-1", "MACC-Q", "MACC-STATE")
# At 9600, and with time-outs of a second, an MSC takes three times as long as the others: here its
# bytes take no time, so that all is judged but that they do.
SHORT_TIMES = ("--quirk", "ack_timeout_ms=300", "--quirk", "packet_timeout_ms=300")
OF_THE_MSC = (
    "MSC-PHY-03", "MSC-PHY-05", "MSC-PKT", "MSC-LNK", "MSC-CMD", "MSC-BREAD", "MSC-BWRITE",
    "MSC-CFLAG", "MSC-DREAD", "MSC-DWRITE", "MSC-RFLAG", "MSC-RQSTAT", "MSC-SFLAG", "MSC-STA",
    "MSC-DAT", "MSC-FLG", "MSC-PROP",
)  # fmt: skip
# What moves and what is stored takes longer than all that is judged on the other lines.
OF_THE_MN400 = ("MN4-PKT-0", "MN4-RSP-0", "MN4-ERR", "MN4-CMD-RTX-01", "MN4-CMD-FW", "MN4-DROP-1")
PLACES = (
    Place("./mac", (("mac23", 0), ("mac34-1", 5))),
    Place("./mac34", (("mac34-1", 5), ("mac23", 0))),
    Place(
        "./mac-can",
        (("mac23-can", 1), ("mac23-can", 2)),
        "--slcan",
        ("--can", "slcan:{}"),
        ON_THE_BUS,
        zoo="zoo_can",
    ),
    Place(
        "./msc",
        (("msc-250", 1),),
        ids=OF_THE_MSC,
        served=("--program", "bench", "--no-pacing", *SHORT_TIMES),
        granted=(
            *("--allow", "motion,stored", "--variables", "1024-5119", "--flags", "128-191"),
            *("--bench-program", "240:6144"),
        ),
        zoo="zoo_msc",
    ),
    Place(
        "./mn400",
        (("mn400", 1), ("mn400", 2)),
        ids=OF_THE_MN400,
        granted=("--allow", "passive"),
        zoo="zoo_mn400",
    ),
)


def with_fault(told: str) -> tuple[Place, ...]:
    """The places, with a fault planted in one: TWIN:FAULT.  What it breaks is judged there too.

    Raises ValueError.
    """
    twin, _, fault = told.partition(":")
    twins = [place.judged for place in PLACES]
    if twin not in twins:
        raise ValueError(f"{told}: write TWIN:FAULT; TWIN is one of {', '.join(twins)}")
    place = PLACES[twins.index(twin)]
    if str(TESTS) not in sys.path:
        sys.path.insert(0, str(TESTS))
    claims = {one.name: one.claims for one in importlib.import_module(place.zoo).ZOO}
    if fault not in claims:
        near = ", ".join(difflib.get_close_matches(fault, claims, 3, 0.3))
        raise ValueError(
            f"{fault} is no fault of {twin}; "
            + (f"did you mean {near}?" if near else f"see conformance/tests/{place.zoo}")
        )
    wrong = replace(place, fault=fault, ids=place.ids and (*place.ids, *claims[fault]))
    return tuple(wrong if one is place else one for one in PLACES)


class Ended(BaseException):
    """SIGTERM; no Exception, so that nobody takes it for a mistake."""


@dataclass(slots=True)
class Judgement:
    """A judgement that runs; what it finds goes into a folder, what it says into a file there."""

    place: Place
    process: subprocess.Popen[str]
    folder: Path

    @property
    def report(self) -> dict[str, Any]:
        """What came of it; empty if it came to nothing."""
        path = self.folder / "report.json"
        return json.loads(path.read_text("utf-8")) if path.is_file() else {}

    @property
    def said(self) -> str:
        """All that it has printed."""
        return (self.folder / "said").read_text("utf-8")


@contextlib.contextmanager
def running(place: Place, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a daemon until the block ends; yields when every device has said that it is ready.

    What it remarks goes into a log: while it is judged, clients talk at wrong rates on purpose.
    """
    command = [*place.serving(), "--state", str(folder / "state"), "--json"]
    folder.mkdir()
    log = folder / "log"
    with (
        log.open("w") as remarks,
        # A process group of its own: Ctrl-C must not take the line from under a judgement.
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=remarks, text=True, process_group=0
        ) as daemon,
    ):
        try:
            assert daemon.stdout is not None
            for _ in place.devices:
                event = json.loads(daemon.stdout.readline() or "{}")
                if event.get("event") != "ready":
                    told = f"{log.read_text()}run: the twins at {place.link} did not start"
                    raise SystemExit(told)
            print(
                f"ready: {', '.join(name for name, _ in place.devices)} on {place.link}", flush=True
            )
            yield daemon
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.wait(ENDING_S)


def judge(place: Place, folder: Path) -> Judgement:
    """Start to judge the twin at a place."""
    folder.mkdir()
    command = [sys.executable, "-m", "axistwin", *place.judging(), "--report", str(folder)]
    with (folder / "said").open("w") as said:
        process = subprocess.Popen(
            command, stdout=said, stderr=subprocess.STDOUT, text=True, process_group=0
        )
    return Judgement(place, process, folder)


def judge_all(folder: Path, places: Sequence[Place]) -> int:
    """Judge every twin, all at the same time; the worst exit status."""
    with contextlib.ExitStack() as stack:
        begun = []
        for place in places:
            begun.append(judge(place, folder / f"{place.judged}-report"))
            stack.callback(_end, begun[-1].process)
        print(
            f"judging {', '.join(place.judged for place in places)} at the same time;\n{ALONE}",
            flush=True,
        )
        for one in begun:
            one.process.wait()
            print(f"{one.place.judged} is judged", flush=True)
        found = [(one.place.judging(), one.report or one.said) for one in begun]
        print("\n".join(["", *verdicts(found)]), flush=True)
        return max(one.process.returncode for one in begun)


def verdicts(found: Sequence[tuple[Sequence[str], Mapping[str, Any] | str]]) -> list[str]:
    """The table of what was found, and below it what failed: of each judgement its words, and its
    report, or what it said if there is none."""
    rows = [("twin", "verdict", "judged", "failed", "open", "seconds")]
    failures: list[list[str]] = []
    for words, report in found:
        if isinstance(report, str):
            rows.append((words[1], "no verdict", "", "", "", ""))
            failures.append([words[1], *report.splitlines()[-3:]])
            continue
        finished, counts = report["finished"], report["finished"]["counts"]
        judged = sum(counts[name] for name in ("pass", "fail", "quirk"))
        verdict = {0: "conforms", 1: "does not conform"}.get(finished["exit_status"], "no verdict")
        rows.append(
            (
                words[1], verdict, f"{judged} of {len(report['requirements'])}",
                str(counts["fail"]), str(counts["inconclusive"]), f"{finished['seconds']:.0f}",
            )
        )  # fmt: skip
        if finished["exit_status"]:
            failures.append([words[1], *_sentences(report), f"again: axistwin {' '.join(words)}"])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    table = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    table += ["", *textwrap.wrap(LEGEND, WIDTH)]
    room = MOST_LINES - LINES_AROUND - len(table)
    return [*table, *_fitting(failures, room // max(1, len(failures)))]


def _sentences(report: Mapping[str, Any]) -> list[str]:
    """What failed, check by check; if nothing did, why there is no verdict."""
    told = [
        f"{check['name']}: {finding['sentence'] or finding['text']}"
        for check in report["checks"]
        for finding in check["findings"]
        if finding["verdict"] == "fail"
    ]
    return list(dict.fromkeys(told)) or [report["finished"]["sentence"]]


def _fitting(failures: Sequence[Sequence[str]], most: int) -> list[str]:
    """What failed, as far as it finds room, wrapped; `most`: lines of each twin."""
    lines: list[str] = []
    for name, *told, last in failures:
        end = _wrapped(last)
        if most - HEAD_LINES - len(end) < 1:
            end = []  # what failed matters more than how to see it again
        room = most - HEAD_LINES - len(end)
        if len(told) * LEAST_LINES > room:
            room -= 1  # for the number of the others
        shown = told[: max(room // LEAST_LINES, min(room, 1))]
        lines += ["", f"{name}:"]
        for number, sentence in enumerate(shown):
            share = room // (len(shown) - number)  # what one leaves, the next have
            wrapped = _wrapped(sentence)
            if len(wrapped) > share:
                wrapped = [*wrapped[: share - 1], f"{wrapped[share - 1][: WIDTH - 2]} …"]
            lines += wrapped
            room -= len(wrapped)
        if len(shown) < len(told):
            lines.append(
                f"  and {len(told) - len(shown)} more" if shown else f"  {len(told)} failures"
            )
        lines += end
    return lines


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="  ", subsequent_indent="    ")


def _end(process: subprocess.Popen[str]) -> None:
    """Break off what still runs, as Ctrl-C does: it makes its axis safe and says so."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        process.wait(ENDING_S)


def _terminated(number: int, frame: FrameType | None) -> None:
    raise Ended


def run(places: Sequence[Place], *, is_once: bool) -> int:
    """Start lines and bus, judge, and stay until somebody ends it; the exit status."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="axistwin-")))
        daemons = [stack.enter_context(running(place, folder / place.judged)) for place in places]
        status = judge_all(folder, places)
        told = "all conform" if status == 0 else f"status {status}"
        print(f"\n{len(places)} twins judged: {told}", flush=True)
        if not is_once:
            where = ", ".join(f"{one.link} ({Path(one.link).resolve()})" for one in places)
            print(
                "\n".join(
                    textwrap.wrap(
                        f"The twins stay at {where}, for any client; Ctrl-C ends them.", WIDTH
                    )
                )
            )
            sys.stdout.flush()
            with contextlib.suppress(KeyboardInterrupt, Ended):
                for daemon in daemons:
                    daemon.wait()
        return status


def main() -> int:
    """Parse the arguments and run."""
    parser = argparse.ArgumentParser(
        prog="scripts/run",
        description="Start every twin, judge all of them over their own ports at the same time,"
        " print a table of the verdicts and what failed, and leave the twins running.",
        epilog=f"{ALONE[0].upper()}{ALONE[1:]}.  Exit status: 0 if all conform, else that of the"
        " worst verdict.",
    )
    parser.add_argument("--once", action="store_true", help="exit when the verdicts are printed")
    parser.add_argument(
        "--fault",
        metavar="TWIN:FAULT",
        help="plant a fault of conformance/tests/zoo* in one twin, such as"
        " mac23:the_ramp_is_half_as_long",
    )
    arguments = parser.parse_args()
    try:
        places = with_fault(arguments.fault) if arguments.fault else PLACES
    except ValueError as error:
        parser.error(str(error))
    signal.signal(signal.SIGTERM, _terminated)
    try:
        return run(places, is_once=arguments.once)
    except (KeyboardInterrupt, Ended):
        print("\nended before all verdicts were there", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    raise SystemExit(main())
