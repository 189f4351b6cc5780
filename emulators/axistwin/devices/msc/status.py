"""The 16-bit status word of the macroprogram (ledger §5.4).

Rules
-----
1. Bits are independent: 65 is "running" and "auto start enabled" (MSC-STA-01, MSC-STA-03).
2. Each bit is a condition that somebody sets and clears: program, memory, back door.  Reading it
   changes nothing (MSC-STA-04), unless the quirk says that reading clears errors (MSC-AMB-26).
"""

from enum import IntFlag
from typing import Final

from axistwin.errors import UsageError


class StatusBit(IntFlag):
    """What each bit tells while it is set."""

    RUNNING = 1 << 0
    BATTERY_LOW = 1 << 1
    RAM_UNRELIABLE = 1 << 2
    PROGRAM_CLEARED = 1 << 3
    SYSTEM_RETURN = 1 << 4
    SYSTEM_FAULT = 1 << 5
    AUTO_START = 1 << 6
    SELF_TEST = 1 << 7
    LOAD_OVER_RUNNING = 1 << 8
    LOAD_CHECKSUM = 1 << 9
    LOADING = 1 << 10
    LOAD_SEQUENCE = 1 << 11
    BAD_OPCODE = 1 << 12
    STACK_OVERFLOW = 1 << 13
    STACK_UNDERFLOW = 1 << 14
    INTERRUPT_TABLE_FULL = 1 << 15


ERRORS: Final = (
    StatusBit.LOAD_OVER_RUNNING
    | StatusBit.LOAD_CHECKSUM
    | StatusBit.LOAD_SEQUENCE
    | StatusBit.BAD_OPCODE
    | StatusBit.STACK_OVERFLOW
    | StatusBit.STACK_UNDERFLOW
    | StatusBit.INTERRUPT_TABLE_FULL
)
"""The bits that the manual words as errors."""

STATUS_BITS: Final = 16


class Status:
    """The status word of one unit.  clears_on_read: reading clears the errors."""

    def __init__(self, *, clears_on_read: bool = False) -> None:
        self._word = StatusBit(0)
        self._clears_on_read = clears_on_read

    @property
    def word(self) -> StatusBit:
        """As it is; looking at it changes nothing."""
        return self._word

    def has(self, bits: StatusBit) -> bool:
        """Whether any of ``bits`` is set."""
        return bool(self._word & bits)

    def set(self, bits: StatusBit, on: bool = True) -> None:
        """Set or clear ``bits``."""
        if on:
            self._word |= bits
        else:
            self._word &= ~bits

    def read(self) -> int:
        """The word as RQSTAT reads it (MSC-AMB-26)."""
        word = int(self._word)
        if self._clears_on_read:
            self._word &= ~ERRORS
        return word


def status_bit(number: int) -> StatusBit:
    """The bit with ``number``, 0..15.  Raises UsageError for another number."""
    if not 0 <= number < STATUS_BITS:
        raise UsageError(f"status bit {number!r} does not exist: 0..15")
    return StatusBit(1 << number)
