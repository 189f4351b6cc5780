"""What a unit holds of the variables and flags that are the suite's own: for every read, what may
come.

Where the distance of neighbours is not known yet (MSC-AMB-18), each one left is a hypothesis with a
memory of its own; a read admits what any of them says, and strikes out those it contradicts.

    write ─▶ every hypothesis          read ─▶ admissible ─▶ came ─▶ hypotheses that remain

Addresses are multiples of 4 and values lie where a hypothesis puts them, so that a memory is a
dictionary of addresses in each.  What nobody has written or read yet may be anything.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from axistwin_conformance.families.msc.codec import BLOCK_VALUES, signed

ROUND_TRIP: Final = "MSC-PROP-08"  # DWRITE, then DREAD
DICTIONARY: Final = "MSC-PROP-09"
FLAG_SET: Final = "MSC-PROP-10"
STILLNESS: Final = "MSC-PROP-13"  # nothing but reads in between


@dataclass(frozen=True, slots=True)
class Cell:
    """A value, how it is known, and after how many writes of any kind.

    `is_read`: seen by a read; else written, `is_alone` by DWRITE.
    """

    value: int
    writes: int
    is_read: bool = False
    is_alone: bool = False


@dataclass(frozen=True, slots=True)
class Surprise:
    """What came where something else had to: whom it speaks about, what had to come, what came."""

    requirement: str
    expected: str
    actual: str


@dataclass(slots=True)
class UnitModel:
    """Variables and flags of one unit.

    `memories`: distance of neighbours → address → cell; `flags`: number → state, and the writes
    before it was known.
    """

    strides: Iterable[int]
    memories: dict[int, dict[int, Cell]] = field(init=False)
    flags: dict[int, tuple[bool, int]] = field(default_factory=dict)
    writes: int = 0

    def __post_init__(self) -> None:
        self.memories = {stride: {} for stride in self.strides}

    # --- variables --------------------------------------------------------------------------------

    def write(self, address: int, value: int) -> None:
        """DWRITE was acknowledged."""
        self.writes += 1
        for memory in self.memories.values():
            memory[address] = Cell(signed(value), self.writes, is_alone=True)

    def write_block(self, address: int, values: Sequence[int]) -> None:
        """BWRITE was acknowledged."""
        self.writes += 1
        for stride, memory in self.memories.items():
            for number, value in enumerate(values):
                memory[address + number * stride] = Cell(signed(value), self.writes)

    def admissible(self, address: int) -> frozenset[int] | None:
        """What DREAD may return; None: anything."""
        cells = [memory.get(address) for memory in self.memories.values()]
        known = frozenset(cell.value for cell in cells if cell is not None)
        return None if None in cells else known

    def read(self, address: int, value: int) -> tuple[str, Surprise | None]:
        """DREAD returned a value; give whom that speaks about (nobody, if anything could have
        come), and what is wrong with it."""
        admissible, text = self.admissible(address), self._requirement_of(address, is_block=False)
        if admissible is not None and value not in admissible:
            expected = " or ".join(str(other) for other in sorted(admissible))
            return text, Surprise(text, f"{expected} at {address}", str(value))
        self._keep(
            [
                stride
                for stride, memory in self.memories.items()
                if self._agrees(memory, address, value)
            ]
        )
        for memory in self.memories.values():
            memory[address] = Cell(value, self.writes, is_read=True)
        return text if admissible is not None and len(admissible) == 1 else "", None

    def read_block(self, address: int, values: Sequence[int]) -> tuple[str, Surprise | None]:
        """BREAD returned its values; as `read`."""
        text, wrong = "", None
        fitting = []
        for stride, memory in self.memories.items():
            places = [address + number * stride for number in range(BLOCK_VALUES)]
            pairs = zip(places, values, strict=True)
            off = [at for at, value in pairs if not self._agrees(memory, at, value)]
            if not off:
                fitting.append(stride)
            elif wrong is None:
                at, number = off[0], places.index(off[0])
                blamed = self._requirement_of(at, is_block=True, stride=stride)
                came = f"{values[number]} in place {number + 1} of the block at {address}"
                wrong = Surprise(blamed, f"{memory[at].value} at {at}", came)
            if any(at in memory for at in places):
                text = DICTIONARY
        if not fitting and wrong is not None:
            return wrong.requirement, wrong
        self._keep(fitting)
        for stride, memory in self.memories.items():
            for number, value in enumerate(values):
                memory[address + number * stride] = Cell(value, self.writes, is_read=True)
        return text, None

    @staticmethod
    def _agrees(memory: dict[int, Cell], address: int, value: int) -> bool:
        return address not in memory or memory[address].value == value

    def _keep(self, strides: Iterable[int]) -> None:
        self.memories = {stride: self.memories[stride] for stride in strides}

    def _requirement_of(self, address: int, *, is_block: bool, stride: int | None = None) -> str:
        """Whom the value at an address speaks about."""
        memory = self.memories[next(iter(self.memories)) if stride is None else stride]
        cell = memory.get(address)
        if cell is None:
            return DICTIONARY
        if cell.is_read:
            return STILLNESS if cell.writes == self.writes else DICTIONARY
        return ROUND_TRIP if cell.is_alone and not is_block else DICTIONARY

    # --- flags ------------------------------------------------------------------------------------

    def turn(self, number: int, on: bool) -> None:
        """SFLAG or CFLAG was acknowledged."""
        self.writes += 1
        self.flags[number] = (on, -1)

    def read_flag(self, number: int, on: bool) -> tuple[str, Surprise | None]:
        """A read told the state of a flag; as `read`."""
        known = self.flags.get(number)
        self.flags[number] = (on, self.writes)
        if known is None:
            return "", None
        was, writes = known
        text = STILLNESS if writes == self.writes else FLAG_SET
        if was is on:
            return text, None
        return text, Surprise(text, f"flag {number} {_state(was)}", _state(on))


def _state(on: bool) -> str:
    return "on" if on else "off"
