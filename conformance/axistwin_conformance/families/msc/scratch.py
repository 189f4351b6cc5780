"""What of a unit is the suite's to use: the variables, the flags and the bench program that the
operator has named.

Addresses are handed out four apart and blocks 128, so that they are different variables in every
reading (§5.2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc.codec import BLOCK_VALUES
from axistwin_conformance.families.msc.options import (
    NO_SCRATCH,
    PROGRAM_FLAGS,
    TWIN_SCRATCH,
    ScratchArea,
)

SAFE_STRIDE: Final = 4  # addresses so far apart are different variables in every reading (§5.2)
SAFE_BLOCK: Final = 128  # and so are blocks
PROGRAM_BLOCK: Final = range(128, 256)  # the bench program's block, from its first variable on
NEEDS_A_VARIABLE: Final = (
    f"needs 1 variable whose address is a multiple of {SAFE_STRIDE} (--variables FIRST-LAST)"
)


def scratch_of(session: Session) -> ScratchArea:
    """What the operator has named for this run."""
    scratch: ScratchArea = session.run.settings
    return scratch


def known_scratch(session: Session) -> ScratchArea:
    """What is known to be free, because the built-in twin has it of its own; nothing elsewhere."""
    return TWIN_SCRATCH if session.target.is_builtin else NO_SCRATCH


def may_write(session: Session, address: int, values: int = 1) -> bool:
    """True if so many values from an address on may be written in the running check, whatever the
    stride is as long as it is not known.

    A check that needs the bench program may write its block too.
    """
    extent = (values - 1) * int(session.readings.get("data_address_stride", SAFE_STRIDE))
    scratch = scratch_of(session)
    spans = [scratch.variables]
    if _needs_program(session) and scratch.program is not None:
        first = scratch.program[1]
        spans.append(range(first + PROGRAM_BLOCK.start, first + PROGRAM_BLOCK.stop))
    return any(address in span and address + extent in span for span in spans)


def may_set(session: Session, flag: int) -> bool:
    """True if a flag may be set and cleared in the running check; one that needs the bench program
    may turn its flags too."""
    scratch = scratch_of(session)
    if _needs_program(session) and scratch.program is not None:
        first = scratch.program[0]
        if flag in range(first, first + PROGRAM_FLAGS):
            return True
    return flag in scratch.flags


def _needs_program(session: Session) -> bool:
    return session.check is not None and "program" in session.check.needs


class ScratchPlaces:
    """The places that a check may use, as a part of its driver."""

    def __init__(self, session: Session) -> None:
        self.session = session

    @property
    def variables(self) -> range:
        """The addresses the operator has named as free; none named: empty."""
        return scratch_of(self.session).variables

    @property
    def flags(self) -> range:
        """The flags the operator has named as free; none named: empty."""
        return scratch_of(self.session).flags

    def may_write(self, address: int, values: int = 1) -> bool:
        """True if so many values from an address on may be written in this check."""
        return may_write(self.session, address, values)

    # --- the first ones ---------------------------------------------------------------------------

    def spots(self, count: int) -> list[int]:
        """So many addresses of named variables, each safely apart; fewer if fewer are named."""
        return [address for address in self.variables if address % SAFE_STRIDE == 0][:count]

    def spot(self) -> int:
        """The address of a named variable, whatever the stride is; skips without one."""
        for address in self.spots(1):
            return address
        return self.session.skip(NEEDS_A_VARIABLE)

    def block_spot(self) -> int:
        """Where a whole block of named variables begins, in every reading; skips without one."""
        for address in self.variables:
            if address % SAFE_STRIDE == 0 and address + SAFE_BLOCK - 1 in self.variables:
                return address
        return self.session.skip(f"needs {SAFE_BLOCK} variables in a row (--variables FIRST-LAST)")

    # --- random ones ------------------------------------------------------------------------------

    def slots(self, count: int) -> list[int]:
        """So many addresses of named variables, in order: the first, the last, others drawn from
        between; skips if fewer are named."""
        every = range(_up(self.variables.start, SAFE_STRIDE), self.variables.stop - 3, SAFE_STRIDE)
        return self._drawn(every, count, f"{count} variables {SAFE_STRIDE} addresses apart")

    def blocks(self, count: int) -> list[int]:
        """Where so many whole blocks of named variables begin, drawn likewise."""
        return self._drawn(self._rooms, count, f"{count * SAFE_BLOCK} addresses in a row")

    def some_blocks(self, most: int) -> list[int]:
        """The same of as many as there is room for, so many at most; skips if there is none."""
        return self.blocks(max(1, min(most, len(self._rooms))))

    def some_flags(self, count: int) -> list[int]:
        """So many of the named flags, drawn likewise."""
        return self._drawn(self.flags, min(count, len(self.flags)), "a flag")

    @property
    def _rooms(self) -> range:
        first = _up(self.variables.start, SAFE_STRIDE)
        return range(first, self.variables.stop - SAFE_BLOCK + 1, SAFE_BLOCK)

    def _drawn(self, every: Sequence[int], count: int, what: str) -> list[int]:
        if len(every) < count:
            self.session.skip(f"needs {what} (--variables FIRST-LAST)")
        ends = [every[0], every[-1]][:count]
        rest = [place for place in every if place not in ends]
        return sorted([*ends, *self.session.random.sample(rest, count - len(ends))])

    # --- within a block ---------------------------------------------------------------------------

    @property
    def stride(self) -> int:
        """How far apart the values of a block are, in this device's reading (MSC-AMB-18)."""
        return int(self.session.reading("data_address_stride"))

    def within_block(self, address: int) -> Iterator[tuple[int, int]]:
        """Each value of a block by its number and its address, in this device's reading of
        MSC-AMB-18; odd addresses, which may be no place to read from, are left out."""
        for number in range(BLOCK_VALUES):
            place = address + number * self.stride
            if place % 2 == 0:
                yield number, place

    def may_be_moved(self, address: int) -> None:
        """Give up where a program may have written between two reads: only of the built-in twin it
        is known that none uses what is named."""
        if not self.session.target.is_builtin:
            self.session.inconclusive(
                None,
                f"what is read at {address} changes: a program uses it, or reading changes it; name"
                " addresses that no program uses (--variables), or have them written too"
                " (--allow stored)",
            )


def first_outside(is_outside: Callable[[int], bool], low: int, high: int, stride: int) -> int:
    """Where a data area ends, to a variable: the lowest address outside, between one that is not,
    from which variables lie at that stride, and one that is."""
    while high - low > stride:
        middle = low + max(1, (high - low) // (2 * stride)) * stride
        if is_outside(middle):
            high = middle
        else:
            low = middle
    return low + stride


def _up(number: int, step: int) -> int:
    return -(-number // step) * step
