"""How far a line can be trusted: what share of its exchanges noise corrupts, and how long a
device is waited for that says nothing right.

*Often enough* follows from the line itself: with a share p of exchanges corrupted, the same result
k times by noise alone has the chance p to the power of k; k is taken so that it is one in a million
(`LineQuality.alike_needed`).

Three things may be the matter with a reply, and each is counted by itself.  *Corrupted*: another
one comes when it is asked for again; that is noise.  *Late*: this host or the line was slow; that
makes a surprise less sure, and no line noisy.  *Wrong*: the same comes again, as often as noise
does not do it; that is the device.

A module is deaf for 2 s after a restart, and is asked nothing meanwhile.  A device that is silent
or wrong for longer than `SILENCE_LIMIT_S`, with more bad replies in a row than noise makes on this
line, is gone, babbles, or has become another one: the next exchange raises `TargetError`.  So it
does after `LONGEST_LIMIT_S` and as many bad replies in a row as one exchange is tried, however
noisy the line.  A device of which something has come meanwhile may be slow, and is waited for
before it is given up (`Session.is_believed`).  One that is silent was never left alone until then:
each question may have put off the answer to the next, so one more goes out behind a silence.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

from axistwin_conformance.base.errors import TargetError
from axistwin_conformance.base.retry import RETRY

FALSE_ALARM = 1e-6  # the chance left to noise of looking like the device
FALSE_LOSS = 1e-9  # of looking like a device that is gone: that is asked after every exchange
LEAST_ALIKE = 3
NOISY = 1e-3  # share of corrupted exchanges from which a line counts as noisy
MOST_NOISE = 0.9  # share of corrupted exchanges on a line on which anything comes through at all
HOPELESS = 0.25  # from which nothing settles on it, however long a run takes
PRIOR_EXCHANGES = 20  # before anything is known, a line is taken to spoil one exchange in these
SILENCE_LIMIT_S = 5.0
LONGEST_LIMIT_S = 60.0  # on the noisiest line
LEAST_BAD = 4
PATIENT_TRIES = 3  # of a device that may be slow; noise may take one of them


@dataclass(slots=True)
class LineQuality:
    """How many exchanges of a run went wrong on the way, as far as that can be told.

    `summed`: of what was taken for corrupted, how many replies whose sum was right all the same.
    `most_noise`: the largest share that this kind of way corrupts.
    """

    exchanges: int = 0
    corrupted: int = 0
    late: int = 0
    wrong: int = 0
    summed: int = 0
    most_noise: float = MOST_NOISE
    votes: Counter[tuple[str, str]] = field(default_factory=Counter)  # how something is spelt
    # Command that may not be sent again at once → its bad replies since the last good one.
    unrepeated: dict[int, list[bytes]] = field(default_factory=dict)

    def note(self, *, is_corrupted: bool, is_late: bool = False) -> None:
        """Count one exchange; what is late is not told from what it should be by that."""
        self.exchanges += 1
        self.late += is_late
        self.corrupted += is_corrupted and not is_late

    def note_wrong(self) -> None:
        """What was just taken for corrupted, came alike too often for that."""
        self.wrong += 1
        self.corrupted = max(0, self.corrupted - 1)

    def is_meant(self, sums: int) -> bool:
        """Count what was taken for corrupted, though its sum, one of so many, is right; True if
        that was so too often for chance."""
        self.summed += 1
        ways = math.comb(max(self.corrupted, self.summed), self.summed)
        other_sums: int = sums**self.summed
        return ways * round(1 / FALSE_ALARM) < other_sums

    @property
    def rate(self) -> float:
        """The share of exchanges that the way may have changed, estimated carefully while few are
        known."""
        return (self.corrupted + self.late + 1) / (self.exchanges + PRIOR_EXCHANGES)

    @property
    def is_noisy(self) -> bool:
        """True if what is done on this line cannot be relied on."""
        return self.corrupted > NOISY * max(self.exchanges, 1)

    @property
    def is_hopeless(self) -> bool:
        """True if so much is corrupted that patience does not help."""
        return self.corrupted > HOPELESS * max(self.exchanges, 1)

    @property
    def alike_needed(self) -> int:
        """How many times the same bad thing must come before it is the device's."""
        return max(LEAST_ALIKE, self._in_a_row(FALSE_ALARM, self.most_noise))

    @property
    def bad_when_lost(self) -> int:
        """How many bad replies in a row mean that nobody answers any more."""
        return self._in_a_row(FALSE_LOSS, MOST_NOISE)

    def _in_a_row(self, chance: float, most_noise: float) -> int:
        """How many corrupted exchanges in a row are as unlikely as that."""
        return math.ceil(math.log(chance) / math.log(min(self.rate, most_noise)))

    def is_reproduced(self, replies: list[bytes]) -> bool:
        """True if the last replies to one request are alike and too many for noise."""
        needed = self.alike_needed
        return len(replies) >= needed and len(set(replies[-needed:])) == 1

    def __str__(self) -> str:
        told = [f"{self.corrupted} of {self.exchanges} exchanges corrupted"]
        told += [f"{self.late} late"] * bool(self.late) + [f"{self.wrong} wrong"] * bool(self.wrong)
        return ", ".join(told)


@dataclass(slots=True)
class SilenceLimit:
    """Counts bad replies in a row; any good one begins anew."""

    bad: int = 0
    silent: int = 0  # of these
    since_ns: int = 0
    patient_tries: int = PATIENT_TRIES  # left; a device that was given up has none
    is_left_alone: bool = False  # it was, for `SILENCE_LIMIT_S`, and is silent all the same

    @property
    def may_be_slow(self) -> bool:
        """True for a device that is worth being waited for longer: mostly there was silence."""
        return self.patient_tries > 0 and self.is_mostly_silent

    @property
    def is_mostly_silent(self) -> bool:
        """True if more often nothing came than something wrong."""
        return 2 * self.silent > self.bad

    def leaves_alone(self) -> bool:
        """True once, for a silent device, before it is given up."""
        if self.is_left_alone or not self.is_mostly_silent:
            return False
        self.is_left_alone = True
        return True

    @property
    def is_patient(self) -> bool:
        """True while a device that may be slow is waited for."""
        return self.patient_tries < PATIENT_TRIES

    def good(self) -> None:
        """A reply was as it should be."""
        self.bad = self.silent = 0
        self.patient_tries = PATIENT_TRIES
        self.is_left_alone = False

    def tried(self, now_ns: int, needed: int, *, is_silence: bool) -> None:
        """A reply was bad, or there was none; raises TargetError if that has lasted too long.

        `needed`: how many in a row noise does not make on this line.
        """
        if not self.bad:
            self.since_ns = now_ns
        self.bad += 1
        self.silent += is_silence
        lasted_s = (now_ns - self.since_ns) / 1e9
        is_long = self.bad >= max(needed, LEAST_BAD) and lasted_s >= SILENCE_LIMIT_S
        if is_long or (self.bad >= RETRY.exchange and lasted_s >= LONGEST_LIMIT_S):
            what = "nothing" if self.silent == self.bad else "nothing sensible"
            raise TargetError(f"{what} has come for {lasted_s:.0f} s, in {self.bad} attempts")
