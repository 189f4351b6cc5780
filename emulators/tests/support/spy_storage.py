"""A storage that remembers what was written to it, and can fail."""

from collections.abc import Mapping

from axistwin.errors import StateError
from axistwin.runtime.storage import MemorySlot, MemoryStorage


class Disk(MemoryStorage):
    """Counts as lasting, so that moving positions are saved."""

    is_volatile = False


class SpySlot(MemorySlot):
    """Remembers every write; ``fail`` makes the next ones fail."""

    def __init__(self) -> None:
        super().__init__()
        self.writes: list[tuple[dict[str, int], bool]] = []
        self.fail = False

    def save(self, cells: Mapping[str, int], *, durable: bool) -> None:
        """Note, or fail."""
        if self.fail:
            raise StateError("state x: cannot be written (disk full); make room")
        self.writes.append((dict(cells), durable))
        super().save(cells, durable=durable)


class SpyStorage(MemoryStorage):
    """Counts how often it was closed; a disk as far as its owner knows."""

    is_volatile = False
    closed = 0

    def close(self) -> None:
        """Count."""
        self.closed += 1
