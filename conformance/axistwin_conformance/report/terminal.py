"""The face of a run at a terminal: progress while it goes, then failures, what stayed open, one
sentence.

On a terminal a bar shows where the run is.  Everything but a pass is told at once, so that a long
run need not be waited for; passes, verdicts in a table and whole transcripts are for those who ask.
No line is wider than the terminal.
"""

from __future__ import annotations

import shlex
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

from rich.console import Console
from rich.padding import Padding
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table
from rich.text import Text

from axistwin_conformance.base import events
from axistwin_conformance.base.armed import load_armed
from axistwin_conformance.base.check import Check
from axistwin_conformance.base.errors import counted, time_left
from axistwin_conformance.base.events import Outcome
from axistwin_conformance.base.ledger import Ledger
from axistwin_conformance.base.transcript import Record
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.engine.eta import Eta
from axistwin_conformance.engine.impact import Impact, allowed_in_vain, impacts
from axistwin_conformance.engine.judgement import UNREACHABLE
from axistwin_conformance.engine.plan import Options, Plan
from axistwin_conformance.report.by_hand import Part, instructions
from axistwin_conformance.report.failures import (
    ALSO,
    LAST_PROBLEMS,
    REQUIRED,
    TIMES,
    Failed,
    Statement,
    failed,
)
from axistwin_conformance.report.json import plain
from axistwin_conformance.transport.kinds import in_hex

LEFT_TOLD_EVERY_S = 60
MOST_IN_HEX = 50  # operations told on the terminal: what is longer is about to be shrunk
PLAIN_WIDTH = 120  # columns of a report that goes into a file or a pipe
COMMAND_GOES_ON = " " * 6  # not below its beginning: bytes of a request would find no room
NARROWEST = 20  # columns for words beside a label
TABLE_WIDTH = 70  # columns below which a table of verdicts would leave no room for words
TOLD_AT_ONCE = (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.QUIRK)

STYLE = {
    Verdict.PASS: "green",
    Verdict.FAIL: "bold red",
    Verdict.QUIRK: "magenta",
    Verdict.INFO: "cyan",
    Verdict.NOT_RUN: "dim",
    Verdict.INCONCLUSIVE: "yellow",
}


class _Console(Console):
    """A console that leaves it to the command what a reader who went away means."""

    def on_broken_pipe(self) -> None:
        """Pass the error on; rich would end the program as if the device had failed."""
        raise  # noqa: PLE0704 - rich calls this while it handles the error


def make_console() -> Console:
    """A console on standard output that keeps its width in a pipe."""
    console = _Console(highlight=False, soft_wrap=False)
    return console if console.is_terminal else _Console(highlight=False, width=PLAIN_WIDTH)


class TimeLeftColumn(ProgressColumn):
    """How long the run still takes, as far as anybody can say."""

    def __init__(self, pace: Eta) -> None:
        super().__init__()
        self._pace = pace

    def render(self, task: Task) -> Text:
        """Say it."""
        seconds = self._pace.remaining_s
        return Text("" if seconds is None else time_left(seconds), style="dim")


class TerminalReport:
    """Listens to a run and prints it; `explain` puts a wire record into words, `spell` writes its
    bytes.  `is_verbose`: also what passes, and transcripts as a whole."""

    def __init__(
        self,
        console: Console,
        ledger: Ledger,
        explain: Callable[[Record], str],
        pace: Eta | None = None,
        folder: str = "",
        spell: Callable[[bytes], str] = in_hex,
        *,
        is_verbose: bool = False,
    ) -> None:
        self._console = console
        self._is_verbose = is_verbose
        self._questions = self._asked = 0  # to the device about its readings: in all, so far
        self._pace = pace or Eta({})
        self._is_port_explained = False  # behind the first command that sends something again
        self._are_times_explained = False  # above the first transcript
        self._folder = folder  # of the report, empty if there is none
        self._told_left_at = time.monotonic()
        self._ledger = ledger
        self._explain, self._spell = explain, spell
        self.bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeLeftColumn(self._pace),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self.bar.add_task("connecting", total=None)
        self._carrier = ""  # line or bus
        self._run: events.RunStarted | None = None
        self._finished: list[events.CheckFinished] = []
        self._judged: list[events.RequirementJudged] = []
        self._readings: list[events.ReadingSeen] = []
        self._notes: set[str] = set()
        self._profile: events.ProfileJudged | None = None

    def __enter__(self) -> TerminalReport:
        self.bar.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.bar.stop()

    def __call__(self, event: events.Event) -> None:
        """Take an event."""
        match event:
            case events.RunStarted():
                self._open(event)
            case events.Identified():
                self._identify(event)
            case events.QuestionAsked():
                self._detecting()
            case events.CheckStarted():
                self._pace.begin(event.name)
                if event.total:
                    done = event.number - 1
                    self.bar.update(
                        self._task, description=event.name, completed=done, total=event.total
                    )
            case events.CheckFinished():
                self._check(event)
            case events.FailureStored():
                self._stored(event)
            case events.StatesCovered():
                if self._is_verbose:
                    self._print(event.text, style="dim")
            case events.SoakProgress():
                self._soak(event)
            case events.Note() if event.text not in self._notes:  # each check may say the same
                self._notes.add(event.text)
                self._print(f"note: {event.text}", style="yellow")
            case events.RigQuestion():  # a bar must not be drawn over the question
                (self.bar.stop if event.is_open else self.bar.start)()
            case events.ReadingSeen():
                self._readings.append(event)
            case events.ProfileJudged():
                self._profile = event
            case events.RequirementJudged():
                self._judged.append(event)
            case events.RunFinished():
                self._close(event)

    def _print(self, text: str | Text = "", style: str = "", label: str = "") -> None:
        """Print a paragraph that is wrapped, beside its label if it has one; into a file or a pipe
        a paragraph without label goes as one line, for those who search it."""
        words = Text(text, style) if isinstance(text, str) else text
        if not label and not self._console.is_terminal:
            self._console.print(words, soft_wrap=True)
            return
        room = max(self._console.width - len(label), NARROWEST)
        for line in words.wrap(self._console, room, overflow="fold") or [Text()]:
            line.rstrip()
            self._console.print(Text(label).append_text(line), soft_wrap=True)
            label = " " * len(label)

    def _print_command(self, label: str, command: str) -> None:
        """Print a command to be copied: a line that is broken goes on behind a backslash, and a
        word is never broken."""
        lines = [label]
        for word in map(shlex.quote, shlex.split(command)):
            if len(lines[-1]) + len(word) + len(" \\") > self._console.width:
                lines[-1] += "\\"
                lines.append(COMMAND_GOES_ON)
            lines[-1] += f"{word} "
        for line in lines:
            self._console.print(Text(line.rstrip()), soft_wrap=True)

    def _open(self, event: events.RunStarted) -> None:
        self._print(
            f"axistwin conform {event.model} · suite {event.suite_version}"
            f" · level {event.level} · seed {event.seed}"
        )
        self._run = event
        self._carrier, self._questions = event.carrier, event.questions
        self._print(f"{event.target}, address {event.address}{_rate(event)}", label="target   ")
        self._print(", ".join(event.allowed), label="allowed  ")
        self._print(_plan_line(len(event.checks), event.left_out), label="plan     ")

    def _detecting(self) -> None:
        self._asked += 1
        words = "asking how it reads the manual"
        self.bar.update(self._task, description=words, completed=self._asked, total=self._questions)

    def _identify(self, event: events.Identified) -> None:
        median_ms, max_ms = event.round_trip_median_ns / 1e6, event.round_trip_max_ns / 1e6
        self._print(event.summary, label="device   ")
        self._print(
            f"{self._carrier:8} idle round trip {median_ms:.2f} ms, at most {max_ms:.2f} ms"
        )

    def _check(self, event: events.CheckFinished) -> None:
        self._pace.end(event.name, event.seconds)
        if event.total:
            self.bar.update(self._task, completed=event.number)
        self._finished.append(event)
        word = event.verdict.value if event.outcome is not Outcome.ERROR else "error in the suite"
        if self._is_verbose or event.verdict in TOLD_AT_ONCE or event.outcome is Outcome.ERROR:
            width = len(str(event.total))
            count = len(event.retries)
            retries = f" ({count} {'retry' if count == 1 else 'retries'})" if count else ""
            line = Text(f"[{event.number:{width}}/{event.total}] {event.name}  ")
            self._print(line.append(f"{word}{retries}", style=STYLE[event.verdict]))
        self._time_left()

    def _stored(self, event: events.FailureStored) -> None:
        one = event.recording
        count = counted(len(one.operations), "operation")
        words = f"{one.requirement} failed in {event.check} after {count}"
        is_short = bool(self._folder) or len(one.operations) <= MOST_IN_HEX
        where = one.word(self._folder) if is_short else "kept with --report or --json"
        self._print(f"stored: {words}: {where}", style="yellow")

    def _soak(self, event: events.SoakProgress) -> None:
        left_s = max(0.0, event.duration_s - event.elapsed_s)
        self._pace.soak(left_s)
        words = f"soak round {event.round}, seed {event.seed}"
        self.bar.update(self._task, description=words)
        now = time.monotonic()
        if not self._console.is_terminal and now - self._told_left_at >= LEFT_TOLD_EVERY_S:
            self._told_left_at = now
            self._print(
                f"… {words}, {event.elapsed_s:.0f} s over, {time_left(left_s)}", style="dim"
            )

    def _time_left(self) -> None:
        """Into a log the guess goes now and then; on a terminal it stands beside the bar."""
        seconds, now = self._pace.remaining_s, time.monotonic()
        if self._console.is_terminal or not seconds or now - self._told_left_at < LEFT_TOLD_EVERY_S:
            return
        self._told_left_at = now
        self._print(f"… {time_left(seconds)}", style="dim")

    # The end.

    def _close(self, event: events.RunFinished) -> None:
        self.bar.stop()
        if event.exit_status != UNREACHABLE:
            if self._is_verbose:
                self._verdicts()
            self._failures()
            self._departures()
            self._open_ends()
            self._quirks()
            self._not_run()
        else:
            self._failures()
        self._print()
        counts = " · ".join(f"{number} {verdict.value}" for verdict, number in event.counts.items())
        self._print(f"requirements: {counts} · {event.seconds:.1f} s")
        if event.eeprom_writes:
            limit = event.eeprom_budget
            allowed = "" if limit is None else f", of {limit} allowed"
            self._print(
                f"stored memory: {counted(event.eeprom_writes, 'EEPROM write')} asked for{allowed}"
            )
        if event.exit_status != UNREACHABLE:
            self._coverage()
        shown = event.problems if self._is_verbose else event.problems[-LAST_PROBLEMS:]
        if earlier := len(event.problems) - len(shown):
            more = counted(earlier, "earlier problem")
            self._print(f"problem: {more}: --verbose, --report", style="yellow")
        for problem in shown:
            self._print(f"problem: {problem}", style="yellow")
        good = event.exit_status == 0
        self._print(event.sentence, style="bold green" if good else "bold red")

    def _verdicts(self) -> None:
        """What came of each requirement: a table where it finds room."""
        shown = [one for one in self._judged if one.verdict is not Verdict.NOT_RUN]
        if shown:
            self._print()
        if shown and self._console.width >= TABLE_WIDTH:
            self._verdict_table(shown)
            return
        for one in shown:
            verdict = Text(one.verdict.value, STYLE[one.verdict])
            below = [Text(one.text)]
            if one.reason:
                below.append(Text(f"→ {one.reason}", STYLE[one.verdict]))
            _print_entry(self._console, Text(f"{one.id}  ").append(verdict), *below)

    def _verdict_table(self, shown: Sequence[events.RequirementJudged]) -> None:
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
        table.add_column("requirement", no_wrap=True)
        table.add_column("verdict", no_wrap=True)
        table.add_column("what is asked, and what came of it")
        table.add_column("checks ran", justify="right")
        is_armed_known = all(one.armed is not None for one in self._judged)
        if is_armed_known:
            table.add_column("armed", justify="right")
        for one in shown:
            words = Text(one.text)
            if one.reason:
                words.append(f"\n→ {one.reason}", style=STYLE[one.verdict])
            verdict, count = Text(one.verdict.value, STYLE[one.verdict]), self._ran(one)
            armed = [str(len(one.armed)) if one.armed else "no"] if is_armed_known else []
            table.add_row(one.id, verdict, words, count, *armed)
        self._console.print(table)

    def _not_run(self) -> None:
        """What was not run, by reason: the reasons are few, the requirements many."""
        self._by_reason("Not run", Verdict.NOT_RUN)

    def _quirks(self) -> None:
        """Readings of the manual other than the default; all of them are in the report."""
        others = [reading for reading in self._readings if reading.reading != reading.default]
        if others:
            self._print()
            self._print("Quirks", style="bold")
        for other in others:
            words = f"{other.switch}={other.reading}  {other.ambiguity}: {other.question}"
            self._print(words, label="  ")

    def _departures(self) -> None:
        """What is not as the profile says; of one that holds, a line."""
        judged = self._profile
        if judged is None:
            return
        self._print()
        title = Text("Profile ", "bold").append(f"{judged.profile}  ", "default")
        word = judged.verdict.value
        self._print(title.append(word, STYLE[judged.verdict]))
        if not judged.departures:
            self._print(judged.reason, label="  ")
        for departure in judged.departures:
            found = " or ".join(departure.found)
            words = f"{departure.switch}  expected {departure.expected}, found {found}"
            self._print(words, "red", label="  ")
            self._print(f"{departure.ambiguity}: {departure.question}", "dim", label="      ")

    def _coverage(self) -> None:
        """How much of the ledger the suite can judge at all, and how surely."""
        covered = [one for one in self._judged if one.checks]
        words = f"{len(covered)} of {len(self._judged)} requirements have a check"
        if covered and all(one.armed is not None for one in covered):
            words += f", {sum(bool(one.armed) for one in covered)} of those are armed"
        if self._readings:
            words += f"; {counted(len(self._readings), 'reading')} of the manual seen"
        self._print(words, style="dim")

    def _ran(self, one: events.RequirementJudged) -> str:
        """How many of the checks that name a requirement have run."""
        ran = {event.name for event in self._finished}
        count = sum(name in ran for name in one.checks)
        return f"{count}" if count == len(one.checks) else f"{count} of {len(one.checks)}"

    def _failures(self) -> None:
        """What failed, cause by cause, in words; checks that crashed, too."""
        broken = [
            event
            for event in self._finished
            if event.verdict is Verdict.FAIL or event.outcome in (Outcome.ERROR, Outcome.TROUBLE)
        ]
        told = [plain(event, self._explain, self._spell) for event in broken]
        groups = failed(told)
        found = {id(one.check): one for group in groups for one in (group, *group.also)}
        leading = {id(one.check) for one in groups}
        for check in told:
            one = found.get(id(check))
            if one is None or id(check) in leading or self._is_verbose:
                self._check_in_words(check, one)

    @cached_property
    def _requirements(self) -> Mapping[str, Mapping[str, Any]]:
        return {name: plain(one) for name, one in self._ledger.requirements.items()}

    def _check_in_words(self, check: Mapping[str, Any], one: Failed | None) -> None:
        """A check that failed; or, with nothing found, that could not be run to its end."""
        self._print()
        style = STYLE[Verdict(check["verdict"])]
        self._print(Text(f"{check['verdict'].upper()}  ", style).append(check["name"], "bold"))
        if check["trouble"]:
            self._print(check["trouble"], "yellow", label="   ")
        shown = one.found if one else ()
        for seen in shown:
            if seen.verdict == Verdict.FAIL.value:
                self._print(seen.whose(self._requirements), "bold", label="   rule        ")
            if seen.sentence != check["trouble"]:
                self._print(seen.sentence, label="   ")
            if seen.remark:
                self._print(seen.remark, "dim", label="   remark      ")
            for number, required in enumerate(seen.required(self._requirements)):
                if number and not self._is_verbose:
                    self._print(f"(and {seen.counted_too}: --verbose)", "dim", label=" " * 15)
                    break
                self._print(str(required), label=f"   {'' if number else REQUIRED:12}")
        # One sequence usually breaks several requirements: it is printed once, with the last.
        if shown and shown[-1].transcript:
            self._transcript(shown[-1])
        self._print_command("   replay      ", check["replay"])
        if shown:
            self._by_hand(shown[-1])
        if one and one.also:
            self._also(one.also)

    def _by_hand(self, one: Statement) -> None:
        """How to see it again without the suite."""
        assert self._run is not None
        label, below = "   by hand     ", " " * 15
        for part, text in instructions(plain(self._run), one):
            if part is Part.COMMAND:
                self._print_command(label, text)
            elif part is Part.WORDS:
                self._print(text, label=label)
            elif part is Part.ACT:
                self._print(text, label=f"{below}now: ")
            elif part is Part.REMARK or not self._is_port_explained:
                self._is_port_explained |= part is Part.PORT
                self._print(f"({text})", "dim", label=below)
            label = below

    def _also(self, others: Sequence[Failed]) -> None:
        """The checks that add nothing to the failure above."""
        names = "; ".join(f"{one.check['name']} ({', '.join(one.requirements)})" for one in others)
        self._print(f"{ALSO}: {names}", label="   ")

    def _transcript(self, one: Statement) -> None:
        """The records that led to the verdict; all of them for those who ask."""
        records = one.transcript
        numbers = range(len(records)) if self._is_verbose else one.shown
        rest = len(records) - len(numbers)
        left_out = [f"{counted(rest, 'other line')}: --verbose, --report"] if rest else []
        times = [] if self._are_times_explained else [TIMES]
        self._are_times_explained = True
        words = "; ".join([*times, *left_out])
        self._print(f"({words})" if words else "", "dim", label="   transcript  ")
        origin_ns = records[0]["time_ns"]
        for record in (records[number] for number in numbers):
            time_ms = (record["time_ns"] - origin_ns) / 1e6
            who = "" if record["direction"] == "note" else record["direction"]
            data = f"{record['data']}  " if record["data"] else ""
            words = f"{data}{record['decoded'] or record['text']}"
            self._print(words, label=f"   {time_ms:9.3f}  {who:7}  ")

    def _open_ends(self) -> None:
        """What stayed inconclusive, by reason: one trouble leaves many requirements open."""
        self._by_reason("Inconclusive", Verdict.INCONCLUSIVE)

    def _by_reason(self, title: str, verdict: Verdict) -> None:
        reasons: dict[str, list[str]] = {}
        for one in self._judged:
            if one.verdict is verdict:
                reasons.setdefault(one.reason, []).append(one.id)
        if reasons:
            self._print()
            self._print(title, style="bold")
        for reason, names in reasons.items():
            self._print(reason, label="  ")
            self._print(" ".join(names), "dim", label="      ")


def _rate(event: events.RunStarted) -> str:
    """How fast, as far as that was said."""
    if event.baud is not None:
        return f", {event.baud} baud"
    return "" if event.bitrate is None else f", {event.bitrate} bit/s"


def _plan_line(count: int, left_out: Mapping[str, str]) -> str:
    if not left_out:
        return counted(count, "check")
    reasons = Counter(left_out.values())
    details = "; ".join(f"{number} × {reason}" for reason, number in reasons.most_common())
    return f"{counted(count, 'check')}; left out: {details}"


def print_plan(console: Console, plan: Plan, options: Options) -> None:
    """Show what would run, in order, what would not, and what would be done to the device."""
    for check in plan.to_run:
        heading = Text(check.name).append(f"  {'+'.join(check.safety)}", "dim")
        _print_entry(console, heading, Text(check.behaviour))
    for check, reason in plan.left_out:
        console.print(Text(f"left out: {check.name}: {reason}", "dim"), overflow="fold")
    undetected = dict.fromkeys((probe.switch, reason) for probe, reason in plan.unprobed)
    for switch, reason in undetected:
        console.print(Text(f"not detected: {switch}: {reason}", "dim"), overflow="fold")
    print_deeds(console, impacts(plan, options))
    if in_vain := allowed_in_vain(options):
        console.print(Text(in_vain), overflow="fold")
    questions = counted(len(plan.probes), "question")
    console.print(f"First, {questions} would tell how it reads the manual.")
    checks = counted(len(plan.to_run), "check")
    console.print(f"{checks} would run, {len(plan.left_out)} would not.")


def print_deeds(console: Console, told: Sequence[Impact]) -> None:
    """Show what would be done to the device, class by class; what is destructive by name."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for title in ("class", "by", "what would be done to the device, and within which bounds"):
        table.add_column(title, no_wrap=title == "class", overflow="fold")
    for text in told:
        words = Text(text.what)
        words.append(f"\n→ {text.within}", style="dim")
        if text.safety == "destructive":
            words.append(f"\n→ {', '.join(text.checks) or 'questions only'}", style="yellow")
        table.add_row(text.safety, text.who, words)
    console.print()
    console.print(table)
    console.print()


def print_ledger(
    console: Console, ledger: Ledger, requirements: Sequence[str], checks: Sequence[Check]
) -> None:
    """List requirements with kind, safety class and the checks that judge them."""
    armed = load_armed(ledger.name)
    for key in requirements:
        one = ledger.requirements[key]
        names = [check.name for check in checks if key in check.requirements]
        reason = f"not on the wire: {one.not_on_wire}" if one.not_on_wire else "no check"
        by = Text(f"→ {', '.join(names) or reason}", style="dim")
        if names and armed is not None and key not in armed:
            by.append("  (not armed)", style="yellow")
        heading = Text(key).append(f"  {one.kind.value}  {'+'.join(sorted(one.safety))}", "dim")
        _print_entry(console, heading, Text(one.text), by)


def _print_entry(console: Console, heading: Text, *below: Text) -> None:
    """A line, and what belongs to it indented below: names stay whole on any terminal."""
    console.print(heading, soft_wrap=True)
    for one in below:
        console.print(Padding(one, (0, 0, 0, 4), expand=False))
