"""Noise on the way: what may be asked again, what is replayed, and when a surprise is believed.

    a bad reply ──┬─ a Nack, or a frame that may be repeated: sent again, recorded
                  └─ any other: the frame may have been obeyed: the attempt is void (`AttemptVoid`)

    an attempt ───┬─ without trouble and without surprise: believed
                  ├─ void: replayed; broken off at the same place again and again, it is replayed
                  │  strictly, that is with every reply handed to the check as it came
                  ├─ surprising (a fail; on a noisy line also a quirk): replayed, and believed when
                  │  enough quiet or strict attempts agree, corrupted replies included
                  └─ passed by asking again: replayed strictly, so that a device whose fault is
                     cured by asking again does not pass for a noisy line

Late is what this host or the line holds up (`Lateness`).  What looks wrong in an attempt in
which anything was late, counts only beside attempts in which the very same was; and once something
has looked wrong, what holds in such an attempt does not do either.

*Often enough* follows from the line itself: with a share p of exchanges corrupted, the same result
k times by noise alone has the chance p to the power of k; k is taken so that it is one in a million
(`LineQuality.alike_needed`), and one in ten thousand that any k of all attempts are alike.  What
needs more replays than there are stays inconclusive, k of n.  Where all attempts fail, each in
another way, and the line corrupts nothing beside (`_is_sound`), it is the device that is wrong in
many ways.  Where so many fail alike, though others hold, and the line has neither corrupted nor
delayed anything in the whole run, it is wrong now and then.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from axistwin_conformance.base.events import Outcome
from axistwin_conformance.base.line_quality import LEAST_ALIKE, LineQuality
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.engine.result import CheckResult
from axistwin_conformance.transport.lateness import TWICE

FALSE_ALARM_AMONG_MANY = 1e-4  # the same, of attempts picked from many
MOST_ATTEMPTS = 10  # of one check, the first one included
MOST_WHILE_ALIKE = 2  # times as many while none has held and some have failed alike
MOST_WHILE_QUIET = 4  # times as many while none has held and two have failed alike without noise
PASSED_WITH_RETRIES = "passed by asking again; what went wrong went wrong here and there: noise"


@dataclass(frozen=True, slots=True)
class Attempt:
    """One run of a check on a line that may be noisy.

    `disturbance`: what was corrupted that must not be repeated; empty if nothing.  `readings`: the
    readings learnt in it that are not the default.  `corrupted`: bad replies that were handed on to
    the check (strictly).  `place`: what was sent last before the first failure, and which
    time it was sent.
    """

    result: CheckResult
    disturbance: str = ""
    readings: Mapping[str, str] = field(default_factory=dict)
    is_strict: bool = False
    corrupted: tuple[str, ...] = ()
    place: tuple[bytes, int] = (b"", 0)
    is_replayed: bool = False  # the check has found out by itself how often its failure comes
    late: tuple[str, ...] = ()  # what this host or the line held up, in its order

    @property
    def is_quiet(self) -> bool:
        """True if nothing at all went wrong on the way, as far as that can be told."""
        return not self.disturbance and not self.result.retries and not self.corrupted

    @property
    def is_void(self) -> bool:
        """True if it tells nothing: broken off, or the check fell over what noise had made."""
        is_crash = self.result.outcome is Outcome.ERROR and not self.is_quiet
        return bool(self.disturbance) or is_crash

    @property
    def is_decisive(self) -> bool:
        """True if all that went wrong on the way is part of what is compared."""
        return self.is_strict or self.is_quiet

    def surprise(self, *, is_noisy: bool) -> tuple[object, ...]:
        """What would be told against the device, comparable between attempts; empty if nothing."""
        is_noisy |= bool(self.late)  # a reading may come of it as well
        told: list[object] = [
            (finding.requirement, _without_numbers(" ".join((finding.text, *finding.expected))))
            for finding in self.result.findings
            if finding.verdict is Verdict.FAIL or (is_noisy and finding.verdict is Verdict.QUIRK)
        ]
        if is_noisy:
            told += sorted(self.readings.items())
        # What is asked all the time is hit by noise now and then; a device is wrong the same time.
        place = self.place if is_noisy else self.place[:1]
        return (*told, place, self.corrupted, self.late) if told else ()


class Replays:
    """Replays a check until its result can be believed.

    `attempt(is_strict)`: runs the check once.  `tidy()`: stops the axis, puts everything back, and
    tells whether the device still answers.  `most`: how many attempts there may be.
    """

    def __init__(
        self,
        attempt: Callable[[bool], Attempt],
        tidy: Callable[[], bool],
        quality: LineQuality,
        most: int = MOST_ATTEMPTS,
    ) -> None:
        self._attempt, self._tidy, self._quality, self._most = attempt, tidy, quality, most
        self._all: list[Attempt] = []
        self._was_sound = not quality.is_noisy
        self._corrupted_between = 0  # exchanges between attempts

    def conclude(self) -> CheckResult:
        """Run, replay as often as needed, and give the result that can be believed."""
        is_strict = False
        while len(self._all) < self._most or self._is_promising():
            if self._all and not self._is_tidied():
                return self._all[-1].result  # the device is lost: the engine finds out and says so
            one = self._attempt(is_strict)
            self._all.append(one)
            if one.is_replayed:
                return one.result
            if not one.is_void and (one.result.outcome is not Outcome.DONE or one.result.trouble):
                return one.result  # left out, a mistake of the suite, the port, the rig
            if self._is_enough(one):
                return self._believed(one)
            if self._passed() and self._has_wandered():
                break
            is_strict = self._next_is_strict(one)
        return self._given_up()

    def _is_tidied(self) -> bool:
        corrupted = self._quality.corrupted
        is_there = self._tidy()
        self._corrupted_between += self._quality.corrupted - corrupted
        return is_there

    @property
    def _is_sound(self) -> bool:
        """True on a line that corrupted next to nothing before the check, and nothing between its
        attempts: what is corrupted in them is the device's doing."""
        return self._was_sound and not self._corrupted_between

    def _is_wrong_in_many_ways(self) -> bool:
        """True if every attempt failed, none while this host or the line was late."""
        return self._is_sound and all(
            self._surprise(one) and not one.is_void and not one.late for one in self._all
        )

    def _wrong_now_and_then(self) -> Attempt | None:
        """An attempt of those that failed alike, more often than noise does it, on a line that has
        never corrupted or delayed anything; None if there are none."""
        quality = self._quality
        if quality.corrupted or quality.late or not all(one.is_quiet for one in self._all):
            return None
        for one in self._all:
            alike = self._alike(surprise) if (surprise := self._surprise(one)) else 0
            if alike >= quality.alike_needed and not self._is_by_chance(alike):
                return one
        return None

    def _is_promising(self) -> bool:
        """True if more attempts may settle it: all fail, some of them alike, not yet enough.

        What comes again in quiet attempts is seldom noise; of a long check few attempts are quiet,
        so it is those that are waited for.
        """
        if self._passed():
            return False
        quiet = Counter(self._surprise(one) for one in self._all if one.is_quiet and not one.late)
        if any(count > 1 for count in quiet.values()):
            return len(self._all) < MOST_WHILE_QUIET * self._most
        is_alike = any(self._alike(self._surprise(one)) >= LEAST_ALIKE for one in self._all)
        return is_alike and len(self._all) < MOST_WHILE_ALIKE * self._most

    def _is_enough(self, one: Attempt) -> bool:
        if one.is_void:
            return False
        if surprise := self._surprise(one):
            alike = self._alike(surprise)
            is_enough = alike >= self._quality.alike_needed and not self._is_by_chance(alike)
            return is_enough and not self._doubts()
        if not one.is_quiet or (one.late and any(self._surprise(other) for other in self._all)):
            return False  # what is late hides a fault as it makes one up
        # On a noisy line a surprise that does not come again was noise; on a quiet one it is the
        # device's, and what comes now and then is no pass.
        passes = sum(other.is_quiet and not self._surprise(other) for other in self._all)
        is_outvoted = self._quality.is_noisy and passes >= self._quality.alike_needed
        return is_outvoted or not self._quiet_surprises()

    def _next_is_strict(self, one: Attempt) -> bool:
        """After a pass by asking again, a failure among retries, and where attempts break off at
        one place only."""
        if one.is_void:
            tail = self._all[-self._quality.alike_needed :]
            same = {earlier.disturbance for earlier in tail} == {one.disturbance}
            return (same or self._is_sound) and len(tail) >= self._quality.alike_needed
        return one.is_strict or not one.is_quiet

    def _surprise(self, one: Attempt) -> tuple[object, ...]:
        return one.surprise(is_noisy=self._quality.is_noisy)

    def _alike(self, surprise: tuple[object, ...]) -> int:
        return sum(one.is_decisive and self._surprise(one) == surprise for one in self._all)

    def _doubts(self) -> bool:
        """True if in a quiet attempt all was right.  One that went wrong in another way, earlier
        perhaps, says nothing for the device."""
        return any(one.is_quiet and not self._surprise(one) for one in self._all)

    def _is_by_chance(self, alike: int) -> bool:
        """True if among so many attempts noise may well have hit one of the places that something
        went wrong at so many times."""
        places = len({self._surprise(one) for one in self._all if one.is_quiet} - {()})
        chance = max(1, places) * math.comb(len(self._all), alike) * self._quality.rate**alike
        return chance > FALSE_ALARM_AMONG_MANY

    def _passed(self) -> list[Attempt]:
        return [one for one in self._all if not one.is_void and not self._surprise(one)]

    def _quiet_surprises(self) -> bool:
        return any(one.is_quiet and not one.late and self._surprise(one) for one in self._all)

    def _has_wandered(self) -> bool:
        """True if strict attempts went wrong each in another way, none of them quietly: noise."""
        strict = [(self._surprise(one), one.disturbance) for one in self._all if one.is_strict]
        return len(set(strict)) >= LEAST_ALIKE and not self._quiet_surprises()

    def _believed(self, one: Attempt) -> CheckResult:
        count = len(self._all)
        if count == 1:
            return one.result
        surprise = self._surprise(one)
        words = (
            f"{self._alike(surprise)} of {count} attempts say so"
            if surprise
            else "the rest was noise"
        )
        return self._with_history(one.result, f"attempt {count} is believed: {words}")

    def _given_up(self) -> CheckResult:
        passed = self._passed()
        # Without what was late: more than a few that complain of the same are not held for noise.
        surprises = [told[:-1] for one in self._all if (told := self._surprise(one))]
        alike = max((surprises.count(surprise) for surprise in surprises), default=0)
        if passed and not self._quiet_surprises() and alike < LEAST_ALIKE:
            return self._with_history(passed[0].result, PASSED_WITH_RETRIES)
        if self._is_wrong_in_many_ways():
            text = f"all {len(self._all)} attempts failed, in many ways, and nothing else did"
            return self._with_history(self._all[-1].result, text)
        if (one := self._wrong_now_and_then()) is not None:
            count = self._alike(self._surprise(one))
            text = f"{count} of {len(self._all)} attempts failed alike: now and then, and no noise"
            return self._with_history(one.result, text)
        return self._inconclusive(passed, surprises)

    def _inconclusive(
        self, passed: list[Attempt], surprises: list[tuple[object, ...]]
    ) -> CheckResult:
        count = len(self._all)
        most = max((surprises.count(surprise) for surprise in surprises), default=0)
        void = sum(one.is_void for one in self._all)
        decisive = next((one for one in self._all if self._surprise(one)), self._all[-1])
        text = (
            f"not settled in {count} attempts: {most} of {count} failed alike, {len(passed)} held,"
            f" {void} were void ({self._quality})"
        )
        if decisive.disturbance:
            text += f"; last: {decisive.disturbance}"
        if late := sum(bool(one.late) for one in self._all):
            doubled = any(what.startswith(TWICE) for one in self._all for what in one.late)
            how = "was late, or replies came twice," if doubled else "was late"
            text += f"; this host or the line {how} in {late} of them"
        result = replace(decisive.result, outcome=Outcome.DONE).withdrawn(text)
        judged = {finding.requirement for finding in result.findings}
        more = tuple(
            Finding(name, Verdict.INCONCLUSIVE, text)
            for name in result.check.requirements
            if name not in judged
        )
        return self._with_history(replace(result, findings=result.findings + more), text)

    def _with_history(self, result: CheckResult, text: str) -> CheckResult:
        """The result, with everything that went wrong in all attempts."""
        lines = [
            f"attempt {number}: {line}"
            for number, one in enumerate(self._all, 1)
            for line in (*one.result.retries, *([one.disturbance] if one.disturbance else ()))
        ]
        return replace(result, retries=(*lines, text))


def _without_numbers(text: str) -> str:
    """Two attempts differ in places and times, not in what they complain about."""
    return re.sub(r"[-+]?\b[0-9A-F]+\b", "#", text)
