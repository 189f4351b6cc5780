"""What comes late, or twice, without the device's doing: this host's or the line's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

LATE_NS: Final = 30_000_000  # beyond the slowest exchange or the time asked for: no line's habit
TWICE: Final = "twice: "  # before what came a second time, where what was late is listed


class Lateness:
    """Counts it for a way to a device.

    `mark`: writes a line into the transcript.  `word`: of what the devices share.  `is_lossless`:
    where nothing gets lost, nothing is late either.
    `recent`: what was held up, or came twice, since somebody cleared this.  `count`: of all in the
    run.  `repeated_count`: of these, what came twice.
    """

    def __init__(
        self, mark: Callable[[str], None], word: str, is_lossless: Callable[[], bool]
    ) -> None:
        self._mark, self._word, self._is_lossless = mark, word, is_lossless
        self.recent: list[str] = []
        self.count = self.repeated_count = 0
        self._longest_ns = 0
        self._doubled_count = 0  # what came twice, the device's habit or not
        self._sent_count, self._sent_before = 0, 0  # requests, and those before `forget`

    def sent(self) -> None:
        """A request goes out."""
        self._sent_count += 1

    def note(self, what: str, late_ns: int, *, is_device_free: bool = False) -> None:
        """Remember that something took so much longer than it should, if that is more than a habit
        of this line.

        `is_device_free`: the device had no part in it, so that no two of these are the same.
        """
        if self._is_lossless() or late_ns <= LATE_NS:
            return
        self.count += 1
        self.recent.append(f"{what}, number {self.count}" if is_device_free else what)
        self._longest_ns = max(self._longest_ns, late_ns)
        self._mark(f"late by {late_ns / 1e6:.0f} ms: {what}")

    def note_doubled(self, what: str) -> None:
        """Remember that a reply came twice, as a frame does of which the last bit is hit.  Of a
        device that says most of them twice it is the habit, and none of the way's doing."""
        self._doubled_count += 1
        if self._is_lossless() or 2 * self._doubled_count > self._sent_count:
            return
        self.count += 1
        self.repeated_count += 1
        number = self._sent_count - self._sent_before
        self.recent.append(f"{TWICE}{what}, after request {number}")
        self._mark(f"twice, to one request: {what}")

    def forget(self) -> None:
        """Begin anew: what was late before does not count."""
        self.recent.clear()
        self._sent_before = self._sent_count

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a reader should know of it."""
        told = []
        if count := self.count - self.repeated_count:
            times = f"{count} times this host or the {self._word} was late"
            most_ms = round(self._longest_ns / 1e6)
            told.append(f"{times}, by up to {most_ms} ms; what looked wrong then was tried again")
        if self.repeated_count:
            times = f"{self.repeated_count} times a reply came twice"
            told.append(f"{times}; what looked wrong then was tried again")
        return tuple(told)
