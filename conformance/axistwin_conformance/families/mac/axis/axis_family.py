"""What the families of one axis share, whichever face it has."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable

from axistwin_conformance.core.family import Family
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis import snapshot
from axistwin_conformance.families.mac.axis.options import OPTIONS
from axistwin_conformance.families.mac.axis.safety import STORING, objection
from axistwin_conformance.families.mac.axis.snapshot import Memory


class AxisFamily(Family):
    """A family of motors with an axis of the MAC's kind."""

    replay_module = "axistwin_conformance.families.mac.axis.checks.sequences"
    operation_bytes = 4
    options = OPTIONS
    tidying = "stop the axis or put its parameters back"

    @property
    def packages(self) -> tuple[str, ...]:
        """Its own, and that of the axis."""
        return (*super().packages, __name__.rpartition(".")[0])

    @abstractmethod
    def indices(self, data: bytes) -> Iterable[int]:
        """The index of every command in these bytes that some reading would obey."""

    def is_alive(self, session: Session) -> bool:
        """See `snapshot.sanity`."""
        return snapshot.sanity(session)

    def stop(self, session: Session) -> None:
        """See `snapshot.stop`."""
        snapshot.stop(session)

    def remember(self, session: Session) -> Memory:
        """See `snapshot.remember`."""
        return snapshot.remember(session)

    def restore(self, session: Session, memory: Memory) -> tuple[str, ...]:
        """See `snapshot.restore`."""
        return snapshot.restore(session, memory)

    def forbid(self, session: Session, data: bytes) -> str | None:
        """Why these bytes must not be sent: an index of a class that the check did not declare."""
        return objection(session, self.indices(data))

    def stored_writes(self, data: bytes) -> int:
        """How many commands that write to the EEPROM these bytes hold."""
        return sum(index in STORING for index in self.indices(data))
