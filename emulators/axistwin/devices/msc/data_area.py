"""The macroprogram's data area: signed 32-bit values under 16-bit addresses (ledger §5.2).

Rules
-----
1. The area is a row of bytes; a value is four of them, high byte first.  Neighbouring values are
   one stride apart: 4 addresses (bytes), 2 (words) or 1 (variables) (MSC-AMB-18).
2. An address inside a value reaches parts of two (MSC-AMB-19), one outside the area is refused
   (MSC-AMB-20), a block over the end is refused whole (MSC-AMB-21), unless a quirk says otherwise.
3. Nothing but its end protects the area: 32 values written to an array of 20 land on what follows.
4. Its battery keeps it.  A cell is a value that was ever written; all others are 0.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from axistwin.devices.msc.quirks import MscQuirks

BLOCK_VALUES: Final = 32
"""Of BREAD and BWRITE."""

VALUE_MIN, VALUE_MAX = -(1 << 31), (1 << 31) - 1
VALUE_BYTES: Final = 4
_MASK: Final = 0xFFFF_FFFF

CELL_PREFIX: Final = "data_"


def signed(value: int) -> int:
    """``value`` as 32 bits in two's complement: arithmetic that wraps around."""
    return (value + 0x8000_0000 & 0xFFFF_FFFF) - 0x8000_0000


class DataArea:
    """The data area of one unit, all zeros."""

    def __init__(self, quirks: MscQuirks) -> None:
        self.stride = quirks.data_address_stride
        self.size = quirks.data_size - quirks.data_size % self.stride
        """Addresses: 0 to one less."""
        self.end = self.size - self.stride
        """The last address at which a whole value lies."""
        self._misaligned = quirks.data_misaligned
        self._outside = quirks.data_out_of_range
        self._overrun = quirks.block_overrun
        self._values: dict[int, int] = {}
        self._changed: dict[int, int] = {}

    # -- by the wire and by programs --

    def has(self, address: int) -> bool:
        """Whether a value at ``address`` can be read and written; else it is to be refused."""
        return self._place(address) is not None

    def read(self, address: int) -> int:
        """The value at ``address``, which it ``has``."""
        place = self._place(address)
        assert place is not None, f"{address} is to be refused"
        return self.peek(place) if place >= 0 else 0

    def write(self, address: int, value: int) -> None:
        """Store ``value``, signed 32 bits, at ``address``, which it ``has``."""
        place = self._place(address)
        assert place is not None, f"{address} is to be refused"
        self.put(place, value)

    def has_block(self, address: int) -> bool:
        """Whether 32 values from ``address`` on can be read and written; else it is refused."""
        first = self._place(address)
        if first is None:
            return False
        last = first + (BLOCK_VALUES - 1) * self.stride
        return first < 0 or last <= self.end or self._overrun != "nak_atomic"

    def read_block(self, address: int) -> list[int]:
        """The 32 values from ``address`` on, of which it ``has_block`` (MSC-BREAD-03)."""
        places = self.block_places(address)
        return [self.peek(place) if place >= 0 else 0 for place in places]

    def block_places(self, address: int, count: int = BLOCK_VALUES) -> Sequence[int]:
        """Where each value of a block belongs, one by one; -1 for nowhere (MSC-BWRITE-02)."""
        first = self._place(address)
        assert first is not None, f"{address} is to be refused"
        if first < 0:
            return [-1] * count
        places = range(first, first + count * self.stride, self.stride)
        if not count or places[-1] <= self.end:
            return places
        if self._overrun == "wrap":
            return [place % self.size for place in places]
        return [place if place <= self.end else -1 for place in places]

    def _place(self, address: int) -> int | None:
        """Where a value addressed as ``address`` lies; -1: nowhere; None: it is refused."""
        if 0 <= address <= self.end and not address % self.stride:  # by far the most common
            return address
        if address % self.stride:
            if self._misaligned == "nak":
                return None
            if self._misaligned == "round_down":
                address -= address % self.stride
        if 0 <= address <= self.end:
            return address
        if self._outside == "wrap":
            return address % self.size
        return None if self._outside == "nak" else -1

    # -- bytes --

    def peek(self, address: int) -> int:
        """The four bytes from ``address`` on, as a value."""
        inside = address % self.stride
        if not inside:
            return self._values.get(address, 0)
        low, high = address - inside, (address - inside + self.stride) % self.size
        both = (self.peek(low) & _MASK) << 32 | self.peek(high) & _MASK
        return signed(both >> 32 - self._bits(inside))

    def put(self, address: int, value: int) -> None:
        """Store ``value`` in the four bytes from ``address`` on; -1 is nowhere."""
        if address < 0:
            return
        inside = address % self.stride
        if not inside:
            self._values[address] = self._changed[address] = value
            return
        low, high = address - inside, (address - inside + self.stride) % self.size
        shift = 32 - self._bits(inside)
        both = (self.peek(low) & _MASK) << 32 | self.peek(high) & _MASK
        both = both & ~(_MASK << shift) | (value & _MASK) << shift
        self._values[low] = self._changed[low] = signed(both >> 32)
        self._values[high] = self._changed[high] = signed(both)

    def _bits(self, addresses: int) -> int:
        """How many bits so many addresses are."""
        return addresses * 8 * VALUE_BYTES // self.stride

    # -- memory --

    def is_written(self, address: int) -> bool:
        """Whether a value was ever stored at ``address``."""
        return address in self._values

    def lose(self) -> None:
        """The battery was flat: everything ever written is 0 now."""
        self._values = dict.fromkeys(self._values, 0)
        self._changed = dict(self._values)

    @property
    def is_changed(self) -> bool:
        """Whether there is something for ``take_changed``."""
        return bool(self._changed)

    def take_changed(self) -> tuple[tuple[str, int], ...]:
        """The cells written since last time."""
        changed, self._changed = self._changed, {}
        return tuple((_cell(address), value) for address, value in changed.items())

    def cells(self) -> dict[str, int]:
        """Every value ever written: ``data_07D8`` and so on."""
        return {_cell(address): value for address, value in self._values.items()}

    def restore(self, cells: Mapping[str, int]) -> None:
        """Take back what ``cells`` gave in an earlier life; what does not fit is left out."""
        for address, value in _stored(cells):
            if 0 <= address <= self.end and not address % self.stride:
                self._values[address] = signed(value)


def _stored(cells: Mapping[str, int]) -> Iterable[tuple[int, int]]:
    """Address and value of each cell of a data area."""
    for name, value in cells.items():
        digits = name.removeprefix(CELL_PREFIX)
        if digits != name and len(digits) == 4 and set(digits) <= set("0123456789ABCDEF"):
            yield int(digits, 16), value


def _cell(address: int) -> str:
    return f"{CELL_PREFIX}{address:04X}"
