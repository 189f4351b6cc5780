"""The two sweeps: what is drawn, how it is judged, and what its outcome is called."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import ClassVar, Final

from quirk_twins import quirks_query

from sweeping.faults import Fault, draw_fault
from sweeping.formats import FORMATS
from sweeping.readings import drawn, misread, pooled, singles, unread
from sweeping.real_runs import PTY, judge_over_pty
from sweeping.runs import TRAVEL, Row, Setting, judge
from sweeping.wrong_device import Tally, planted

MODELS: Final = (*FORMATS, "mn400")  # faults are drawn for those with a format
CRASHED: Final = "the built-in twin crashed"
SILENT: Final = 5  # requests in a row at the end, none of which got an answer
JUDGED_PART = 0.95  # of what is judged of the default twin


class Sweep(ABC):
    """One kind of sweep.

    `outcomes`: every outcome, the worst first, with what it means.  `wrong`: those that are to be
    mended.
    """

    outcomes: ClassVar[Mapping[str, str]]
    wrong: ClassVar[tuple[str, ...]]

    def __init__(self, setting: Setting, seed: int) -> None:
        self.setting, self.seed = setting, seed

    @abstractmethod
    def judge(self, number: int) -> Row:
        """Judge that device; `outcome`, `device` and `why` are in the row."""

    def table(self, rows: Iterable[Row]) -> str:
        """How many devices ended how."""
        counts = Counter(row["outcome"] for row in rows)
        total = sum(counts.values())
        lines = [f"{total} devices of {self.setting.model}"]
        lines += [
            f"  {counts[name]:5} {name:13} {meaning}"
            for name, meaning in self.outcomes.items() if counts[name]
        ]  # fmt: skip
        return "\n".join(lines)

    def escapes(self, rows: Iterable[Row]) -> str:
        """What is to be mended, the worst first."""
        order = list(self.outcomes)
        bad = [row for row in rows if row["outcome"] in self.wrong]
        bad.sort(key=lambda row: (order.index(row["outcome"]), row["number"]))
        return "\n".join(
            f"{row['number']:5} {row['outcome']:13} {row['device']}\n{'':20}{row['why']}"
            for row in bad
        )


class QuirkSweep(Sweep):
    """Admissible devices: other readings."""

    outcomes: ClassVar[Mapping[str, str]] = {
        "hang": "took too long", "error": "error in the suite", "failed": "failed, though sound",
        "refused": "not judged at all", "problem": "left or put back wrongly",
        "misread": "a reading told that is not so", "judged less": "less than 95 % judged",
        "inconclusive": "nothing failed, something stayed open", "unread": "a reading not told",
        "sound": "as it should be",
    }  # fmt: skip
    wrong = ("hang", "error", "failed", "refused", "problem", "misread", "judged less",
             "inconclusive")  # fmt: skip

    def __init__(
        self, setting: Setting, seed: int, *, is_single: bool = False, at_once: int = 0
    ) -> None:
        super().__init__(setting, seed)
        self.is_single, self.at_once = is_single, at_once
        self.usual: frozenset[str] = frozenset()  # what is judged of the default twin

    def readings(self, number: int) -> dict[str, str]:
        """Of the device of that number; none of number 0."""
        if number == 0:
            return {}
        word = f"{self.seed}/{self.setting.model}"
        if self.is_single:
            known = singles(self.setting.model, word)
            return known[(number - 1) % len(known)]
        if self.at_once:
            draws = pooled(self.setting.model, word, self.at_once)
        else:
            draws = drawn(self.setting.model, word)
        return next(itertools.islice(draws, number - 1, None))

    def judge(self, number: int) -> Row:
        """Judge the twin of the readings of that number."""
        return self.judge_readings(self.readings(number))

    def judge_readings(self, readings: Mapping[str, str]) -> Row:
        """Judge a twin of these readings."""
        query = quirks_query(readings)
        row = judge(self.setting, self.seed, query, detects=True)
        device = " ".join(f"{name}={one}" for name, one in readings.items()) or "all defaults"
        outcome, why = self._outcome(readings, row)
        return row | {
            "readings": dict(readings), "device": device, "outcome": outcome, "why": why
        }  # fmt: skip

    def table(self, rows: Iterable[Row]) -> str:
        """How many devices ended how, and how many readings and pairs of them these clear."""
        rows = list(rows)
        cleared = [
            sorted(row.get("readings", {}).items())
            for row in rows if row["outcome"] not in self.wrong
        ]  # fmt: skip
        readings = {one for each in cleared for one in each}
        pairs = {pair for each in cleared for pair in itertools.combinations(each, 2)}
        switches = {(one, other) for (one, _), (other, _) in pairs}
        return (
            f"{super().table(rows)}\n  rightly judged: {len(readings)} readings,"
            f" {len(pairs)} pairs of readings, {len(switches)} pairs of switches"
        )

    def _outcome(self, readings: Mapping[str, str], row: Row) -> tuple[str, str]:
        if row["hang"]:
            return "hang", row["hang"]
        if row["errors"]:
            return "error", row["errors"][0]
        if row["failed"]:
            return "failed", "; ".join(row["evidence"] or row["failed"])
        if row["status"] not in (0, 4):
            return "refused", row["sentence"]
        if row["problems"]:
            return "problem", "; ".join(row["problems"])
        if wrong := misread(self.setting.model, readings, row):
            return "misread", "; ".join(f"{name}: {told}" for name, told in wrong.items())
        lost = self.usual - set(row["judged"])
        if len(lost) > (1 - JUDGED_PART) * len(self.usual):
            left = f"; {row['left_out']}" if row["left_out"] else ""
            return "judged less", f"{len(lost)} of {len(self.usual)}: {sorted(lost)}{left}"
        if row["open"]:
            return "inconclusive", "; ".join(f"{one}: {why}" for one, why in row["open"].items())
        if names := unread(self.setting.model, readings, row):
            return "unread", "; ".join(f"{name}: {row['untold'][name]}" for name in names)
        return "sound", ""


OPEN: Final = ("escaped", "named", "inconclusive")


class FaultSweep(Sweep):
    """Devices that are wrong in one thing."""

    outcomes: ClassVar[Mapping[str, str]] = {
        "hang": "took too long", "outside": "left the envelope", "error": "error in the suite",
        "refused": "exit 3, though it answers", "escaped": "conforms, it was said",
        "named": "taken for other readings", "inconclusive": "nothing failed, something open",
        "caught": "exit 1", "strayed": "exit 1; one motion led out, was ended, and was the last",
        "silent": "exit 3, says nothing, or nothing any more",
        "unseen": "never showed: as a sound one, to the byte and the nanosecond",
        "no device": "the twin fell over the fault",
    }  # fmt: skip
    wrong = ("hang", "outside", "error", "refused", "escaped", "named", "inconclusive")

    def __init__(self, setting: Setting, seed: int) -> None:
        super().__init__(setting, seed)
        self._sound_wires: dict[Setting, int] = {}

    def judge(self, number: int) -> Row:
        """Judge a twin with the fault of that number."""
        model = self.setting.model
        fault = draw_fault(FORMATS[model], f"{self.seed}/{model}/{number}")
        setting = self.setting
        row = self.judge_fault(fault, setting)
        if row["outcome"] in OPEN and setting.level == "quick":  # what it leaves out may show it
            setting = replace(setting, level="full")
            row = self.judge_fault(fault, setting)
        is_open = row["outcome"] in OPEN and bool(row["wire"])
        if is_open and row["wire"] == self._sound_wire(setting):
            row["outcome"] = "unseen"
        return row

    def _sound_wire(self, setting: Setting) -> int:
        """The sum over what a twin without a fault says."""
        if setting not in self._sound_wires:
            tally = Tally()
            with planted(Fault("none", ""), setting.model, tally):
                judge(setting, self.seed)
            self._sound_wires[setting] = tally.wire
        return self._sound_wires[setting]

    def judge_fault(self, fault: Fault, setting: Setting) -> Row:
        """Judge a twin with that fault."""
        model = setting.model
        tally = Tally()
        with planted(fault, model, tally) as place:
            over_pty = setting.interface == PTY
            judged = judge_over_pty(setting, self.seed, tally) if over_pty else None
            row = judged or judge(setting, self.seed)
        row |= {
            "level": setting.level,
            "device": f"{fault}{place and f' in {place}'}", "part": fault.part,
            "asked": tally.asked, "hits": tally.hits, "said": tally.said,
            "furthest": tally.furthest, "crash": tally.crash,
            "wire": 0 if over_pty else tally.wire,  # there no two runs are alike
        }  # fmt: skip
        outcome, why = self._outcome(row, tally)
        return row | {"outcome": outcome, "why": why}

    @staticmethod
    def _outcome(row: Row, tally: Tally) -> tuple[str, str]:
        words = (row.get("sentence", ""), *row.get("evidence", ()))
        crash = tally.crash or next((one for one in words if CRASHED in one), "")
        # It may fall over, or turn on the spot, while it is made.
        unmade = "" if tally.said else (*row.get("errors", ()), row.get("hang", ""))[0]
        if crash or unmade:
            return "no device", crash or unmade
        if row["hang"]:
            return "hang", row["hang"]
        if tally.furthest > TRAVEL and not tally.is_held:
            return "outside", f"{tally.furthest} increments"
        if row["errors"]:
            return "error", row["errors"][0]
        if row["status"] == 1:
            outcome = "strayed" if tally.furthest > TRAVEL else "caught"
            return outcome, "; ".join(row["evidence"] or row["failed"])
        if not tally.hits:
            return "unseen", ""
        if row["status"] == 3:
            is_silent = not tally.said or tally.unanswered >= SILENT
            return ("silent" if is_silent else "refused"), row["sentence"]
        if row["named"]:
            return "named", " ".join(f"{name}={one}" for name, one in row["named"].items())
        told = "; ".join(f"{one}: {why}" for one, why in row["open"].items()) or row["sentence"]
        return ("inconclusive" if row["status"] == 4 else "escaped"), told
