"""The nonvolatile store: the user program and the configuration program share it (ledger §3.6).

Rules
-----
1. Both are lines of text; a line takes its characters and one byte more (MN4-AMB-70).  Either
   grows at the other's cost (MN4-NVM-08).
2. An entered program replaces the previous one when its entry ends, all at once, or else line by
   line; what a power failure interrupts leaves the previous one (ledger §4.2).  While it is entered
   the room is that beside the other program.
3. A cell holds a line, as the number whose bytes are its characters behind a 1; 0 is no line.  The
   cells of lines that are no more stay, as zeros: nothing of an earlier program comes back.
"""

from collections.abc import Mapping, Sequence
from typing import Final, Literal, TypeAlias

from axistwin.devices.mn400.quirks import Mn400Quirks

Part: TypeAlias = Literal["program", "config"]

PARTS: Final[tuple[Part, ...]] = ("program", "config")
_NUMBER_DIGITS: Final = 5
_LINE_BYTES_MAX: Final = 9001
Cells: TypeAlias = tuple[tuple[str, int], ...]


class ProgramStore:
    """The two programs of one board, and the one that is being entered."""

    def __init__(self, quirks: Mn400Quirks) -> None:
        self._size = quirks.nvm_size
        self._overhead = quirks.nvm_line_overhead
        self._commits_lines = quirks.nvm_commit == "per_line"
        self._lines: dict[Part, tuple[bytes, ...]] = dict.fromkeys(PARTS, ())
        self._known: dict[Part, int] = dict.fromkeys(PARTS, 0)
        self._entry: list[bytes] = []

    def lines(self, part: Part) -> tuple[bytes, ...]:
        """The lines of a program, as they were sent."""
        return self._lines[part]

    @property
    def used(self) -> int:
        """Bytes that both programs take."""
        return sum(self._length(lines) for lines in self._lines.values())

    def _length(self, lines: Sequence[bytes]) -> int:
        return sum(map(len, lines)) + self._overhead * len(lines)

    # -- entry --

    def begin(self, part: Part) -> Cells:
        """Enter ``part`` anew; the cells to be stored."""
        self._entry = []
        return self._replace(part) if self._commits_lines else ()

    def add(self, part: Part, line: bytes) -> Cells | None:
        """One more line; the cells to be stored, or None if it does not fit (MN4-NVM-09)."""
        other = PARTS[part == "program"]
        taken = self._length(self._lines[other]) + self._length(self._entry)
        if taken + len(line) + self._overhead > self._size:
            return None
        self._entry.append(line)
        return self._replace(part) if self._commits_lines else ()

    def end(self, part: Part) -> Cells:
        """The entry is complete; the cells to be stored."""
        cells = self._replace(part)
        self._entry = []
        return cells

    def put(self, part: Part, lines: Sequence[bytes]) -> None:
        """Have ``lines`` as ``part``, as from the beginning."""
        self._entry = list(lines)
        self.end(part)

    def _replace(self, part: Part) -> Cells:
        """The entry takes the place of the program; the cells that differ (rule 3)."""
        before = self._part_cells(part)
        self._lines[part] = tuple(self._entry)
        self._known[part] = max(self._known[part], len(self._entry))
        after = self._part_cells(part)
        return tuple(cell for cell in after.items() if before.get(cell[0]) != cell[1])

    # -- cells --

    def _part_cells(self, part: Part) -> dict[str, int]:
        lines = self._lines[part]
        return {
            f"{part}_{number:0{_NUMBER_DIGITS}}": (
                int.from_bytes(b"\x01" + lines[number], "big") if number < len(lines) else 0
            )
            for number in range(self._known[part])
        }

    def cells(self) -> dict[str, int]:
        """Every line there ever was: ``program_00000``, ``config_00000`` and so on."""
        return {name: value for part in PARTS for name, value in self._part_cells(part).items()}

    def restore(self, cells: Mapping[str, int]) -> None:
        """Take back what ``cells`` gave in an earlier life; what does not fit is left out."""
        for part in PARTS:
            count = 0
            while f"{part}_{count:0{_NUMBER_DIGITS}}" in cells:
                count += 1
            values = [cells[f"{part}_{number:0{_NUMBER_DIGITS}}"] for number in range(count)]
            texts = [_line(value) for value in values if value]
            if any(text is None for text in texts) or 0 in values[: len(texts)]:
                continue
            self._lines[part] = tuple(text for text in texts if text is not None)
            self._known[part] = count


def _line(value: int) -> bytes | None:
    """The line that a cell holds; None if it holds none."""
    if not 0 < value < 1 << 8 * _LINE_BYTES_MAX:
        return None
    data = value.to_bytes((value.bit_length() + 7) // 8, "big")
    return data[1:] if data[0] == 1 and len(data) > 1 else None
