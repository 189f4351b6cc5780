"""Whether the flags the operator has named are his to set: tried before anything is judged by them.

An input that was named by mistake keeps its state whatever SFLAG and CFLAG say, and so may a flag
that the macroprogram uses.  On the wire that looks like a unit that loses what is written, and
nobody can tell them apart; so nothing is judged by such a flag.  Three kinds of units are at fault
beyond doubt, and are left to the checks: one whose flag follows most of the time, one that writes
to another flag than the one it was told, and one whose flags follow when each is turned and read by
itself, and not among many, or not as RFLAGS tells them: a machine does not count what is written.
Two fail here: one that turns the flag and others with it, since no check looks at flags that nobody
has named; and one that acknowledges each SFLAG while more flags stay off than a machine drives in
step, or each CFLAG while they stay on.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable
from typing import Final

from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.core.family import Violation
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.safety import MOST_FLAGS, Writing
from axistwin_conformance.families.msc.scratch import known_scratch, scratch_of

ROUNDS: Final = 4  # of on and off in which a flag may follow
FEW_ROUNDS: Final = 2  # are enough of one that follows each time
MOST_FOLLOWED: Final = 1  # by chance: the machine may have moved an input
SWITCHINGS: Final = 10  # drawn; nothing else goes along with all of them by chance
MOST_AS_TOLD: Final = 0.7  # of the changes of a flag: one that blinks by itself has half of them
SCAN_S: Final = 0.1  # within which who drives a flag has it back
MOST_IN_STEP: Final = 32  # flags that a machine at rest may hold in one state, all named by mistake
MOST_NAMED: Final = 8  # flags in a sentence


def try_flags(session: Session) -> str | Violation:
    """Why no check can be judged by the flags named; empty: they follow what is written, or the
    unit is what keeps them from it.  A violation: what is written to one turns others as well.
    What it touches is put back by `restore`."""
    flags = scratch_of(session).flags
    if session.target.is_builtin and flags == known_scratch(session).flags:
        return ""  # of which it is known that nothing drives them
    trial = _FlagCheck(session)
    driven = trial.driven(list(flags))
    if not driven:
        return trial.meddling(dict.fromkeys((flags[0], flags[-1])))
    if trial.along(driven[0]) or trial.instead(driven[0]):
        return ""
    if lost := trial.lost(driven):
        return lost
    if trial.follow_alone(driven):
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
        self._held: dict[int, set[tuple[bytes, bool]]] = defaultdict(set)  # sign, state, of each

    def driven(self, numbers: list[int]) -> list[int]:
        """Those of the flags that are the same after SFLAG and after CFLAG, time after time."""
        followed, counted = Counter[int](), Counter[int]()
        left = numbers
        for _ in range(RETRY.exchange):
            if not left:
                break
            signs_on, on = self._turned(left, on=True)
            signs_off, off = self._turned(left, on=False)
            for number in left:
                sign = signs_on[number]
                # Noise may spoil a packet; it does not refuse two in a row.
                if sign in (codec.ACK, codec.NAK) and sign == signs_off[number]:
                    counted[number] += 1
                    self._held[number] |= {(sign, number in on), (sign, number in off)}
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

    def lost(self, driven: list[int]) -> Violation | None:
        """What the unit acknowledges and does not do, if that can be nobody else's doing."""
        held = set().union(*(self._held[number] for number in driven))
        if len(driven) <= MOST_IN_STEP or len(held) > 1:
            return None
        ((sign, is_on),) = held
        if sign != codec.ACK:
            return None
        name, wanted, stay = ("CFLAG", "off", "on") if is_on else ("SFLAG", "on", "off")
        told = f"ACK, and {_listed(driven)} stay {stay}"
        return Violation(f"MSC-{name}-02", f"{name} turns a flag {wanted}", told)

    def follow_alone(self, driven: list[int]) -> bool:
        """Whether these flags change as they are told, as RFLAG tells them, as soon as nothing else
        is written meanwhile, by far more often than by chance; False if one of those tried keeps
        its state."""
        tried = self._session.random.sample(driven, min(MOST_NAMED, len(driven)))
        changes: list[bool] = []
        for number in tried * (MOST_NAMED // len(tried)):
            seen = self._changes(number)
            if not seen:
                return False
            changes += seen
        return sum(changes) >= MOST_AS_TOLD * len(changes)

    def _changes(self, number: int) -> list[bool]:
        """Of each change of a flag that is turned alone, whether it went where it was told."""
        changes: list[bool] = []
        was_on: bool | None = None
        for on in self._orders():
            signs = self._turn([number], on=on)
            is_on = self._driver.flag(number)
            if signs[number] != codec.ACK:
                continue
            if was_on not in (None, is_on):
                changes.append(is_on == on)
            was_on = is_on
        return changes

    def _orders(self) -> tuple[bool, ...]:
        """On, off, and so on as it is drawn: nobody else keeps to that."""
        draw = self._session.random
        return (True, False, *(draw.random() < 0.5 for _ in range(SWITCHINGS)))

    def meddling(self, numbers: Iterable[int]) -> str | Violation:
        """What turns together with one of these flags: flags beside it, or whose number differs in
        one bit, are the unit's doing; others may be a program's."""
        for number in numbers:
            if not (along := self.along(number)):
                continue
            told = f"{_listed(sorted(along))} as well"
            if along & self._beside(number):
                return Violation("MSC-SFLAG-02", f"SFLAG and CFLAG turn flag {number}", told)
            return (
                f"SFLAG and CFLAG {number} turn {told}: a program uses it; name only flags that"
                " nothing else uses (--flags)"
            )
        return ""

    def along(self, number: int) -> set[int]:
        """The other flags that go on and off with what is written to this one."""
        along, taken = set(self._near(number)) - {number}, 0
        for on in self._orders():
            signs, states = self._turned([number], on=on, looked_at=along)
            if signs[number] == codec.ACK:
                along = {number for number in along if (number in states) == on}
                taken += 1
        return along if taken > SWITCHINGS // 2 else set()

    def instead(self, number: int) -> set[int]:
        """The other named flags that go with each SFLAG of this one, or with each CFLAG, if they
        were told the opposite before: one of the two may reach the right flag."""
        beside = (self._beside(number) & {*scratch_of(self._session).flags}) - {number}
        for on in (True, False):
            going = set(beside)
            for _ in range(ROUNDS):
                _, before = self._turned(sorted(beside), on=not on)
                _, after = self._turned([number], on=on, looked_at=beside)
                going = {one for one in going if (one in before, one in after) == (not on, on)}
            if going:
                return going
        return set()

    def _beside(self, number: int) -> set[int]:
        return {number - 1, number + 1, *(number ^ 1 << bit for bit in range(8))} | {
            *scratch_of(self._session).flags
        }

    def _near(self, number: int) -> Iterable[int]:
        """Where a write may land by mistake: anywhere, as far as that can be seen at once."""
        if self._driver.has_rflags:
            return range(MOST_FLAGS)
        return self._beside(number) & {*range(MOST_FLAGS)}

    def _turned(
        self, numbers: list[int], *, on: bool, looked_at: Iterable[int] | None = None
    ) -> tuple[dict[int, bytes], frozenset[int]]:
        """Turn flags: what came of each, and which of them are on a scan later."""
        signs = self._turn(numbers, on=on)
        states = self._driver.flags()
        if states is not None:
            return signs, codec.flags_on(states)
        wanted = numbers if looked_at is None else looked_at
        return signs, frozenset(number for number in wanted if self._driver.flag(number))

    def _turn(self, numbers: list[int], *, on: bool) -> dict[int, bytes]:
        """Turn flags, and wait a scan: what came of each."""
        name, command = ("SFLAG", codec.sflag) if on else ("CFLAG", codec.cflag)
        signs = {}
        for number in numbers:
            self._session.run.memory.touched.add(Writing(name, number))
            signs[number] = self._driver.ask(command(number)).raw
        self._session.target.wait(SCAN_S)
        return signs
