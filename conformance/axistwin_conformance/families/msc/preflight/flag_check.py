"""Whether the flags the operator has named are his to set: tried before anything is judged by them.

An input that was named by mistake keeps its state whatever SFLAG and CFLAG say, and so may a flag
that the macroprogram uses.  On the wire that looks like a unit that loses what is written, and
nobody can tell them apart; so nothing is judged by such a flag.  Two kinds of units are at fault
beyond doubt, and are left to the checks: one whose flag follows most of the time, and one that
writes to another flag than the one it was told.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Final

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.safety import MOST_FLAGS, Writing
from axistwin_conformance.families.msc.scratch import known_scratch, scratch_of

ROUNDS: Final = 4  # of on and off in which a flag may follow
FEW_ROUNDS: Final = 2  # are enough of one that follows each time
MOST_FOLLOWED: Final = 1  # by chance: the machine may have moved an input
ATTEMPTS: Final = 16  # of a round that noise voids
SWITCHINGS: Final = 10  # drawn; nothing else goes along with all of them by chance
SCAN_S: Final = 0.1  # within which who drives a flag has it back
MOST_NAMED: Final = 8  # flags in a sentence


def try_flags(session: Session) -> str:
    """Why no check can be judged by the flags named; empty: they follow what is written, or the
    unit is what keeps them from it.  What it touches is put back by `restore`."""
    flags = scratch_of(session).flags
    if session.target.is_builtin and flags == known_scratch(session).flags:
        return ""  # of which it is known that nothing drives them
    trial = _FlagCheck(session)
    driven = trial.driven(list(flags))
    if not driven or trial.goes_elsewhere(driven[0]):
        return ""
    follow, them = ("does", "it") if len(driven) == 1 else ("do", "them")
    return (
        f"{_listed(driven)} {follow} not follow SFLAG and CFLAG"
        f" (--flags {flags[0]}-{flags[-1]}): the machine or a program drives {them}, or the"
        " unit loses what is written; name only flags that nothing else drives"
    )


def _listed(numbers: list[int]) -> str:
    if len(numbers) == 1:
        return f"flag {numbers[0]}"
    more = f" and {len(numbers) - MOST_NAMED} more" if len(numbers) > MOST_NAMED else ""
    return f"flags {', '.join(map(str, numbers[:MOST_NAMED]))}{more}"


class _FlagCheck:
    """Turns flags and looks at what becomes of them."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._driver = MscDriver(session)

    def driven(self, numbers: list[int]) -> list[int]:
        """Those of the flags that are the same after SFLAG and after CFLAG, time after time."""
        followed, counted = Counter[int](), Counter[int]()
        left = numbers
        for _ in range(ATTEMPTS):
            if not left:
                break
            signs_on, on = self._turned(left, on=True)
            signs_off, off = self._turned(left, on=False)
            for number in left:
                sign = signs_on[number]
                # Noise may spoil a packet; it does not refuse two in a row.
                if sign in (codec.ACK, codec.NAK) and sign == signs_off[number]:
                    counted[number] += 1
                    followed[number] += number in on and number not in off
            left = [
                number
                for number in left
                if counted[number] < ROUNDS and followed[number] < max(FEW_ROUNDS, counted[number])
            ]
        return [
            number
            for number in numbers
            if counted[number] == ROUNDS and followed[number] <= MOST_FOLLOWED
        ]

    def goes_elsewhere(self, number: int) -> bool:
        """True if another flag goes on and off with what is written to this one."""
        draw = self._session.random
        orders = [draw.random() < 0.5 for _ in range(SWITCHINGS)]
        along, taken = set(self._near(number)) - {number}, 0
        for on in (True, False, *orders):
            signs, states = self._turned([number], on=on, looked_at=along)
            if signs[number] == codec.ACK:
                along = {number for number in along if (number in states) == on}
                taken += 1
        return bool(along) and taken > SWITCHINGS // 2

    def _near(self, number: int) -> Iterable[int]:
        """Where a write may go astray: anywhere, as far as that can be seen at once."""
        if self._driver.has_rflags:
            return range(MOST_FLAGS)
        near = {number - 1, number + 1, *(number ^ 1 << bit for bit in range(8))}
        return {
            *(number for number in near if number in range(MOST_FLAGS)),
            *scratch_of(self._session).flags,
        }

    def _turned(
        self, numbers: list[int], *, on: bool, looked_at: Iterable[int] | None = None
    ) -> tuple[dict[int, bytes], frozenset[int]]:
        """Turn flags: what came of each, and which of them are on a scan later."""
        bench, memory = self._driver, self._session.run.memory
        name, command = ("SFLAG", codec.sflag) if on else ("CFLAG", codec.cflag)
        signs = {}
        for number in numbers:
            memory.touched.add(Writing(name, number))
            signs[number] = bench.ask(command(number)).raw
        self._session.target.wait(SCAN_S)
        states = bench.flags()
        if states is not None:
            return signs, codec.flags_on(states)
        wanted = numbers if looked_at is None else looked_at
        return signs, frozenset(number for number in wanted if bench.flag(number))
