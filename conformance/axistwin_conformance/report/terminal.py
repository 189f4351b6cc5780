"""The face of a run at a terminal: progress while it goes, then verdicts, failures, one sentence.

On a terminal a bar shows where the run is; into a pipe or a log goes one plain line per check.
Everything but a pass is told at once, so that a long run need not be waited for.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

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
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.engine.eta import Eta
from axistwin_conformance.engine.impact import Impact, allowed_in_vain, impacts
from axistwin_conformance.engine.judgement import UNREACHABLE
from axistwin_conformance.engine.plan import Options, Plan
from axistwin_conformance.transport.kinds import in_hex

LEFT_TOLD_EVERY_S = 60
MOST_IN_HEX = 50  # operations told on the terminal: what is longer is about to be shrunk
PLAIN_WIDTH = 120  # columns of a report that goes into a file or a pipe
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
    bytes."""

    def __init__(
        self,
        console: Console,
        ledger: Ledger,
        explain: Callable[[Record], str],
        pace: Eta | None = None,
        folder: str = "",
        spell: Callable[[bytes], str] = in_hex,
    ) -> None:
        self._console = console
        self._pace = pace or Eta({})
        self._folder = folder  # of the report, empty if there is none
        self._told_left_at = time.monotonic()
        self._ledger = ledger
        self._explain, self._spell = explain, spell
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeLeftColumn(self._pace),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task("connecting", total=None)
        self._carrier = ""  # line or bus
        self._failed: list[events.CheckFinished] = []
        self._judged: list[events.RequirementJudged] = []
        self._readings: list[events.ReadingSeen] = []
        self._profile: events.ProfileJudged | None = None

    def __enter__(self) -> TerminalReport:
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()

    def __call__(self, event: events.Event) -> None:
        """Take an event."""
        match event:
            case events.RunStarted():
                self._open(event)
            case events.Identified():
                self._identify(event)
            case events.CheckStarted():
                self._pace.begin(event.name)
                self._progress.update(self._task, description=event.name, total=event.total)
            case events.CheckFinished():
                self._check(event)
            case events.FailureStored():
                self._stored(event)
            case events.StatesCovered():
                self._print(event.text, style="dim")
            case events.SoakProgress():
                self._soak(event)
            case events.Note():
                self._print(f"note: {event.text}", style="yellow")
            case events.RigQuestion():  # a bar must not be drawn over the question
                (self._progress.stop if event.is_open else self._progress.start)()
            case events.ReadingSeen():
                self._readings.append(event)
            case events.ProfileJudged():
                self._profile = event
            case events.RequirementJudged():
                self._judged.append(event)
            case events.RunFinished():
                self._close(event)

    def _print(self, text: str | Text = "", style: str = "") -> None:
        # Bytes and commands are copied from here: a line is never broken.
        self._console.print(text, style=style, markup=False, soft_wrap=True)

    def _open(self, event: events.RunStarted) -> None:
        self._print(
            f"axistwin conform {event.model} · suite {event.suite_version}"
            f" · level {event.level} · seed {event.seed}"
        )
        self._carrier = event.carrier
        self._print(f"target   {event.target}, address {event.address}{_rate(event)}")
        self._print(f"allowed  {', '.join(event.allowed)}")
        self._print(f"plan     {_plan_line(len(event.checks), event.left_out)}")

    def _identify(self, event: events.Identified) -> None:
        median_ms, max_ms = event.round_trip_median_ns / 1e6, event.round_trip_max_ns / 1e6
        self._print(f"device   {event.summary}")
        self._print(
            f"{self._carrier:8} idle round trip {median_ms:.2f} ms, at most {max_ms:.2f} ms"
        )

    def _check(self, event: events.CheckFinished) -> None:
        self._pace.end(event.name, event.seconds)
        self._progress.update(self._task, completed=event.number)
        if event.verdict is Verdict.FAIL or event.outcome in (Outcome.ERROR, Outcome.TROUBLE):
            self._failed.append(event)
        word = event.verdict.value if event.outcome is not Outcome.ERROR else "error in the suite"
        if not self._console.is_terminal or event.verdict in TOLD_AT_ONCE:
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
        self._progress.update(self._task, description=words)
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
        self._progress.stop()
        if event.exit_status != UNREACHABLE:
            self._verdicts()
            self._not_run()
            self._quirks()
            self._departures()
        for failed in self._failed:
            self._failure(failed)
        self._print()
        counts = " · ".join(f"{number} {verdict.value}" for verdict, number in event.counts.items())
        self._print(f"{counts} · {event.seconds:.1f} s")
        if event.eeprom_writes:
            limit = event.eeprom_budget
            allowed = "" if limit is None else f", of {limit} allowed"
            self._print(
                f"stored memory: {counted(event.eeprom_writes, 'EEPROM write')} asked for{allowed}"
            )
        if event.exit_status != UNREACHABLE:
            self._coverage()
        for problem in event.problems:
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
        table.add_column("checks", justify="right")
        is_armed_known = all(one.armed is not None for one in self._judged)
        if is_armed_known:
            table.add_column("armed", justify="right")
        for one in shown:
            words = Text(one.text)
            if one.reason:
                words.append(f"\n→ {one.reason}", style=STYLE[one.verdict])
            verdict, count = Text(one.verdict.value, STYLE[one.verdict]), str(len(one.checks))
            armed = [str(len(one.armed)) if one.armed else "no"] if is_armed_known else []
            table.add_row(one.id, verdict, words, count, *armed)
        self._console.print(table)

    def _not_run(self) -> None:
        """What was not run, by reason: the reasons are few, the requirements many."""
        reasons: dict[str, list[str]] = {}
        for one in self._judged:
            if one.verdict is Verdict.NOT_RUN:
                reasons.setdefault(one.reason, []).append(one.id)
        if reasons:
            self._print()
            self._print("Not run", style="bold")
        for reason, names in reasons.items():
            self._print(f"  {reason}")
            self._console.print(Padding(" ".join(names), (0, 0, 0, 6), expand=False), style="dim")

    def _quirks(self) -> None:
        """Readings of the manual other than the default; all of them are in the report."""
        others = [reading for reading in self._readings if reading.reading != reading.default]
        if others:
            self._print()
            self._print("Quirks", style="bold")
        for other in others:
            self._print(f"  {other.switch}={other.reading}  {other.ambiguity}: {other.question}")

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
            self._print(f"  {judged.reason}")
        for departure in judged.departures:
            found = " or ".join(departure.found)
            self._print(
                f"  {departure.switch}  expected {departure.expected}, found {found}", style="red"
            )
            self._print(f"      {departure.ambiguity}: {departure.question}", style="dim")

    def _coverage(self) -> None:
        """How much of the ledger the suite can judge at all, and how surely."""
        covered = [one for one in self._judged if one.checks]
        words = f"{len(covered)} of {len(self._judged)} requirements have a check"
        if covered and all(one.armed is not None for one in covered):
            words += f", {sum(bool(one.armed) for one in covered)} of those are armed"
        if self._readings:
            words += f"; {counted(len(self._readings), 'reading')} of the manual seen"
        self._print(words, style="dim")

    def _failure(self, event: events.CheckFinished) -> None:
        self._print()
        self._print(f"── {event.name}", style="bold")
        if event.trouble:
            self._print(f"   {event.trouble}", style="yellow")
        # One sequence usually breaks several requirements: it is printed once, with the last.
        worst = [
            finding
            for finding in event.findings
            if finding.verdict in (Verdict.FAIL, event.verdict)
        ]
        for one in worst:
            self._finding(one, event.trouble)
        if worst and worst[-1].transcript:
            self._transcript(worst[-1].transcript)
        self._print(f"   replay      {event.replay}")

    def _finding(self, one: Finding, told: str) -> None:
        asked = self._ledger.requirements[one.requirement].text
        self._print(f"   {one.requirement}  {one.verdict.value}", style=STYLE[one.verdict])
        self._print(f"   asked       {asked}")
        if one.text and one.text != told:
            self._print(f"   remark      {one.text}")
        if one.expected:
            self._print(f"   admissible  {' | '.join(one.expected)}")
        if one.actual is not None:
            self._print(f"   came        {one.actual}")

    def _transcript(self, records: Sequence[Record]) -> None:
        self._print("   transcript  (ms from its beginning)")
        origin_ns = records[0].time_ns
        for record in records:
            time_ms = (record.time_ns - origin_ns) / 1e6
            words = (
                record.text
                if not record.data
                else f"{self._spell(record.data)}  {self._explain(record)}"
            )
            who = "" if record.direction is Direction.NOTE else record.direction.value
            self._print(f"   {time_ms:12.3f}  {who:7}  {words}")


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
        text = f"left out: {check.name}: {reason}"
        console.print(text, style="dim", markup=False, soft_wrap=True)
    undetected = dict.fromkeys((probe.switch, reason) for probe, reason in plan.unprobed)
    for switch, reason in undetected:
        text = f"not detected: {switch}: {reason}"
        console.print(text, style="dim", markup=False, soft_wrap=True)
    print_deeds(console, impacts(plan, options))
    if in_vain := allowed_in_vain(options):
        console.print(in_vain, markup=False, soft_wrap=True)
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
