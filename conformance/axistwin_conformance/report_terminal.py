"""The face of a run at a terminal: progress while it goes, then verdicts, failures, one sentence.

On a terminal a bar shows where the run is; into a pipe or a log goes one plain line per check.
Everything but a pass is told at once, so that a long run need not be waited for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

from rich.console import Console
from rich.padding import Padding
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from axistwin_conformance import events
from axistwin_conformance.events import Outcome
from axistwin_conformance.judgement import UNREACHABLE
from axistwin_conformance.ledger import Ledger
from axistwin_conformance.plan import Plan
from axistwin_conformance.registry import Check
from axistwin_conformance.transcript import Direction, Record
from axistwin_conformance.verdicts import Finding, Verdict

PLAIN_WIDTH = 120  # columns of a report that goes into a file or a pipe
TOLD_AT_ONCE = (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.QUIRK)

STYLE = {
    Verdict.PASS: "green",
    Verdict.FAIL: "bold red",
    Verdict.QUIRK: "magenta",
    Verdict.INFO: "cyan",
    Verdict.NOT_RUN: "dim",
    Verdict.INCONCLUSIVE: "yellow",
}


def make_console() -> Console:
    """A console on standard output that keeps its width in a pipe."""
    console = Console(highlight=False, soft_wrap=False)
    return console if console.is_terminal else Console(highlight=False, width=PLAIN_WIDTH)


class TerminalReport:
    """Listens to a run and prints it; `explain` puts a wire record into words."""

    def __init__(self, console: Console, ledger: Ledger, explain: Callable[[Record], str]) -> None:
        self._console = console
        self._ledger = ledger
        self._explain = explain
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task("connecting", total=None)
        self._failed: list[events.CheckFinished] = []
        self._judged: list[events.RequirementJudged] = []

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
                self._progress.update(self._task, description=event.name, total=event.total)
            case events.CheckFinished():
                self._check(event)
            case events.Note():
                self._print(f"note: {event.text}", style="yellow")
            case events.RigQuestion():  # a bar must not be drawn over the question
                (self._progress.stop if event.is_open else self._progress.start)()
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
        self._print(f"target   {event.target}, address {event.address}")
        self._print(f"allowed  {', '.join(event.allowed)}")
        self._print(f"plan     {_plan_line(len(event.checks), event.left_out)}")

    def _identify(self, event: events.Identified) -> None:
        median_ms, max_ms = event.round_trip_median_ns / 1e6, event.round_trip_max_ns / 1e6
        self._print(f"device   {event.summary}")
        self._print(f"line     idle round trip {median_ms:.2f} ms, at most {max_ms:.2f} ms")

    def _check(self, event: events.CheckFinished) -> None:
        self._progress.update(self._task, completed=event.number)
        if event.verdict is Verdict.FAIL or event.outcome in (Outcome.ERROR, Outcome.TROUBLE):
            self._failed.append(event)
        word = event.verdict.value if event.outcome is not Outcome.ERROR else "error in the suite"
        if not self._console.is_terminal or event.verdict in TOLD_AT_ONCE:
            width = len(str(event.total))
            retries = f" ({len(event.retries)} retries)" if event.retries else ""
            line = Text(f"[{event.number:{width}}/{event.total}] {event.name}  ")
            self._print(line.append(f"{word}{retries}", style=STYLE[event.verdict]))

    # The end.

    def _close(self, event: events.RunFinished) -> None:
        self._progress.stop()
        if event.exit_status != UNREACHABLE:
            self._verdict_table()
            self._not_run()
        for failed in self._failed:
            self._failure(failed)
        self._print()
        counts = " · ".join(f"{number} {verdict.value}" for verdict, number in event.counts.items())
        self._print(f"{counts} · {event.seconds:.1f} s")
        for problem in event.problems:
            self._print(f"problem: {problem}", style="yellow")
        good = event.exit_status == 0
        self._print(event.sentence, style="bold green" if good else "bold red")

    def _verdict_table(self) -> None:
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
        table.add_column("requirement", no_wrap=True)
        table.add_column("verdict", no_wrap=True)
        table.add_column("what is asked, and what came of it")
        table.add_column("checks", justify="right")
        shown = [one for one in self._judged if one.verdict is not Verdict.NOT_RUN]
        for one in shown:
            words = Text(one.text)
            if one.reason:
                words.append(f"\n→ {one.reason}", style=STYLE[one.verdict])
            table.add_row(
                one.id, Text(one.verdict.value, STYLE[one.verdict]), words, str(len(one.checks))
            )
        if shown:
            self._print()
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
            self._console.print(Padding(" ".join(names), (0, 0, 0, 6)), style="dim")

    def _failure(self, event: events.CheckFinished) -> None:
        self._print()
        self._print(f"── {event.name}", style="bold")
        if event.trouble:
            self._print(f"   {event.trouble}", style="yellow")
        # One sequence usually breaks several requirements: it is printed once, with the last.
        worst = [one for one in event.findings if one.verdict in (Verdict.FAIL, event.verdict)]
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
        for one in records:
            time_ms = (one.time_ns - origin_ns) / 1e6
            words = one.text if not one.data else f"{_hex(one.data)}  {self._explain(one)}"
            who = "" if one.direction is Direction.NOTE else one.direction.value
            self._print(f"   {time_ms:12.3f}  {who:7}  {words}")


def _hex(data: bytes) -> str:
    return data.hex(" ").upper()


def _plan_line(count: int, left_out: Mapping[str, str]) -> str:
    if not left_out:
        return f"{count} checks"
    reasons = Counter(left_out.values())
    details = "; ".join(f"{number} × {reason}" for reason, number in reasons.most_common())
    return f"{count} checks; left out: {details}"


def print_plan(console: Console, plan: Plan) -> None:
    """Show what would run, in order, and what would not."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for title in ("check", "safety", "what it judges"):
        table.add_column(title, no_wrap=title != "what it judges")
    for check in plan.to_run:
        table.add_row(check.name, "+".join(check.safety), check.behaviour)
    console.print(table)
    for check, reason in plan.left_out:
        text = f"left out: {check.name}: {reason}"
        console.print(text, style="dim", markup=False, soft_wrap=True)
    console.print(f"{len(plan.to_run)} checks would run, {len(plan.left_out)} would not.")


def print_ledger(
    console: Console, ledger: Ledger, requirements: Sequence[str], checks: Sequence[Check]
) -> None:
    """List requirements with kind, safety class and the checks that judge them."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for title in ("requirement", "kind", "safety", "what is asked, and by which checks"):
        table.add_column(title, no_wrap=not title.startswith("what"))
    for key in requirements:
        one = ledger.requirements[key]
        words = Text(one.text)
        names = [check.name for check in checks if key in check.requirements]
        reason = f"not on the wire: {one.not_on_wire}" if one.not_on_wire else "no check"
        words.append(f"\n→ {', '.join(names) or reason}", style="dim")
        table.add_row(key, one.kind.value, "+".join(sorted(one.safety)), words)
    console.print(table)
