"""What a front knows of its workers: who serves which line, and where to ask them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from axistwin.errors import StateError


@dataclass(frozen=True, slots=True)
class Worker:
    """The control API of a worker: its number, HOST:PORT at the loopback, and its token."""

    number: int
    address: str
    token: str

    @property
    def headers(self) -> dict[str, str]:
        """What every request has."""
        return {"Authorization": f"Bearer {self.token}"}


@dataclass(frozen=True, slots=True)
class WorkedLine:
    """A line, its devices and endpoints, and who serves it; ``failure``: why nobody does."""

    name: str
    devices: tuple[str, ...]
    endpoints: tuple[tuple[str, str], ...]
    worker: Worker | None = None
    failure: str | None = None

    def reach(self) -> Worker:
        """Who serves it.  Raises StateError if nobody does."""
        if self.worker is None:
            raise StateError(f"{self.name} is not served any more: {self.failure}")
        return self.worker


class Viewers(Protocol):
    """Who watches; told from any thread."""

    def lines_came(self, lines: Sequence[WorkedLine], *, by_new_worker: bool) -> None:
        """``lines`` were added; ``by_new_worker``: by a worker that they do not hear yet."""

    def line_failed(self, line: WorkedLine) -> None:
        """Its worker has ended."""


class Workforce:
    """The lines of a rack by name, in the order of its file.

    ``lines`` is replaced and never changed, so that any thread may read it.
    """

    def __init__(self) -> None:
        self.lines: Mapping[str, WorkedLine] = {}
        self.viewers: Viewers | None = None

    @property
    def workers(self) -> list[Worker]:
        """All that serve a line."""
        return list(dict.fromkeys(each.worker for each in self.lines.values() if each.worker))

    @property
    def owners(self) -> dict[str, WorkedLine]:
        """The line of each device."""
        return {device: line for line in self.lines.values() for device in line.devices}
