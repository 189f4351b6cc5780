"""A stateful machine for a unit: rules that are tried where they mean something.

One-draw sequences take any operation in any state.  The rules here have preconditions, read from
what was done before (`UnitView`), so that chains get built: a value under a block under a value, a
reply refused to its end right after another one was, a packet into the wait for a sign and one cut
short there, flags turned again and again.  What a step does is an operation of four bytes, judged
by the same model.

Invariants read between the steps what stands in no step's way.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from hypothesis import strategies as st
from hypothesis.stateful import invariant, precondition, rule

from axistwin_conformance.families.msc.sequences.operations import EDGES, MOST_REFUSED, WHAT
from axistwin_conformance.families.msc.sequences.sequence import UnitSequence
from axistwin_conformance.sequences.machine import Machine

ASK_EVERY: Final = 7  # steps: an invariant that asked after each would leave no time for chains
BYTES: Final = st.integers(0, 0xFF)
# Few places, the first ones most of all, so that they are met again; the edges and any value.
PLACES: Final = st.one_of(st.integers(0, 3), st.integers(0, 15), BYTES)
VALUES: Final = st.one_of(st.integers(0, len(EDGES) - 1), BYTES)
PAUSES: Final = st.sampled_from((0, 0, 0, 0x82, 0x90, 0xFF))
REFUSALS: Final = st.one_of(st.integers(1, MOST_REFUSED - 1), st.sampled_from((5, 6)))


class UnitView(NamedTuple):
    """What preconditions look at.

    `is_waiting`: the unit waits for our sign; `is_last_a_write`: something was written and not read
    since; `refused`: how often the last reply was refused.
    """

    is_waiting: bool = False
    is_last_a_write: bool = False
    refused: int = 0


WRITES: Final = frozenset(
    number for name, number in WHAT.items() if name.split()[0] in ("write", "set", "clear")
)
REFUSE: Final = WHAT["refuse a reply"]


class ModelledUnit:
    """A unit on the line, held against the model."""

    def __init__(self, sequence: UnitSequence) -> None:
        self.sequence = sequence
        self.view = UnitView()

    def operate(self, what: int, first: int, second: int, pause: int) -> None:
        """Do an operation and see where that leads."""
        self.sequence.operate(what, first, second, pause)
        refused = second % MOST_REFUSED if what == REFUSE else 0
        self.view = UnitView(self.sequence.is_waiting, what in WRITES, refused)

    def conclude(self) -> None:
        """Read everything that is in play."""
        self.sequence.conclude()

    def leave(self) -> None:
        """Leave the line at rest."""
        self.sequence.leave()


class UnitMachine(Machine):
    """The rules of a unit."""

    what = WHAT
    device: ModelledUnit

    # --- variables and flags ----------------------------------------------------------------------

    @rule(place=PLACES, value=VALUES, pause=PAUSES)
    def write(self, place: int, value: int, pause: int) -> None:
        """DWRITE."""
        self.do("write a value", place, value, pause)

    @rule(place=PLACES, value=VALUES)
    def write_and_read(self, place: int, value: int) -> None:
        """DWRITE, then DREAD at once."""
        self.do("write a value and read it", place, value)

    @rule(place=PLACES, value=VALUES, pause=PAUSES)
    def write_block(self, place: int, value: int, pause: int) -> None:
        """BWRITE, over what is there or beside it."""
        self.do("write a block", place, value, pause)

    @rule(place=PLACES)
    def read(self, place: int) -> None:
        """DREAD."""
        self.do("read a value", place)

    @rule(place=PLACES)
    def read_block(self, place: int) -> None:
        """BREAD, also across the edges of what was written."""
        self.do("read a block", place)

    @rule(flag=PLACES, on=st.booleans(), pause=PAUSES)
    def turn(self, flag: int, on: bool, pause: int) -> None:
        """SFLAG or CFLAG, again and again."""
        self.do("set a flag" if on else "clear a flag", flag, 0, pause)

    @precondition(lambda self: self.device.view.is_last_a_write)
    @rule(flag=PLACES)
    def read_flag(self, flag: int) -> None:
        """RFLAG after a write, of a flag or not."""
        self.do("read a flag", flag)

    # --- the link ---------------------------------------------------------------------------------

    @rule(which=BYTES, times=REFUSALS)
    def refuse(self, which: int, times: int) -> None:
        """A reply refused, up to the end and beyond."""
        self.do("refuse a reply", which, times)

    @precondition(lambda self: self.device.view.refused > 0)
    @rule(which=BYTES, times=st.sampled_from((5, 6)))
    def refuse_again(self, which: int, times: int) -> None:
        """The next reply refused to its end: the count begins anew with each."""
        self.do("refuse a reply", which, times)

    @rule(which=BYTES)
    def leave_unanswered(self, which: int) -> None:
        """A reply without a sign, for the next step to meet."""
        self.do("leave a reply unanswered", which)

    @precondition(lambda self: self.device.view.is_waiting)
    @rule(place=PLACES, value=VALUES)
    def write_into_the_wait(self, place: int, value: int) -> None:
        """A write where the unit waits for a sign."""
        self.do("write a value and read it", place, value)

    @precondition(lambda self: self.device.view.is_waiting)
    @rule(which=BYTES, times=REFUSALS)
    def refuse_after_the_wait(self, which: int, times: int) -> None:
        """A read where the unit waits for a sign, and its own reply refused: not the old one."""
        self.do("refuse a reply", which, times)

    @rule(which=BYTES, how=BYTES)
    def spoil(self, which: int, how: int) -> None:
        """A wrong checksum, or a bit turned."""
        self.do("spoil a checksum" if how & 1 else "turn a bit", which, how)

    @rule(which=BYTES, place=BYTES)
    def send_in_pieces(self, which: int, place: int) -> None:
        """A pause inside a packet."""
        self.do("send in pieces", which, place)

    @precondition(lambda self: not self.device.view.is_last_a_write)
    @rule(which=BYTES, place=BYTES)
    def cut_short(self, which: int, place: int) -> None:
        """A packet without its end; seldom, since it takes the unit's time limit."""
        self.do("cut a packet short", which, place)

    @precondition(lambda self: self.device.view.is_waiting or self.device.view.refused > 0)
    @rule(which=BYTES)
    def let_the_reply_come_again(self, which: int) -> None:
        """A reply left alone until it comes again."""
        self.do("let the reply come again", which)

    @precondition(lambda self: not self.device.view.is_waiting)
    @rule(which=BYTES, how=BYTES)
    def disturb(self, which: int, how: int) -> None:
        """Signs and bytes that nobody has asked for."""
        self.do("send a stray sign" if how & 1 else "send junk", which, how)

    # --- what always holds ------------------------------------------------------------------------

    @invariant()
    def the_status_is_told(self) -> None:
        """RQSTAT is answered in every state."""
        self.steps += 1
        if self.steps % ASK_EVERY == 0:
            self.do("read the status")

    @invariant()
    def all_flags_are_as_they_were_turned(self) -> None:
        """RFLAGS, or RFLAG where there is none."""
        if self.steps % ASK_EVERY == ASK_EVERY // 2:
            self.do("read all flags")
