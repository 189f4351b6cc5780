"""How long a device that says nothing right is waited for: until noise cannot be the reason.

A module is deaf for 2 s after a restart, and nobody asks it anything meanwhile.  Longer than
`PATIENCE_S`, and more bad replies in a row than noise makes on this line, is a device that is gone,
babbles, or has become another one: whoever asks next gets `TargetError` instead of more of it.
"""

from __future__ import annotations

from dataclasses import dataclass

from axistwin_conformance.errors import TargetError

PATIENCE_S = 5.0
LEAST_BAD = 4


@dataclass(slots=True)
class Patience:
    """Counts bad replies in a row; any good one begins anew."""

    bad: int = 0
    silent: int = 0  # of these
    since_ns: int = 0

    def good(self) -> None:
        """A reply was as it should be."""
        self.bad = self.silent = 0

    def tried(self, now_ns: int, needed: int, *, is_silence: bool) -> None:
        """A reply was bad, or there was none; raises TargetError if that has lasted too long.

        `needed`: how many in a row noise does not make on this line.
        """
        if not self.bad:
            self.since_ns = now_ns
        self.bad += 1
        self.silent += is_silence
        lasted_s = (now_ns - self.since_ns) / 1e9
        if self.bad >= max(needed, LEAST_BAD) and lasted_s >= PATIENCE_S:
            what = "nothing" if self.silent == self.bad else "nothing sensible"
            raise TargetError(f"{what} has come for {lasted_s:.0f} s, in {self.bad} attempts")
