"""What the families of one axis share, whichever face it has."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable

from axistwin_conformance.core.family import Family
from axistwin_conformance.core.session import Session
from axistwin_conformance.mac_axis import keeping
from axistwin_conformance.mac_axis.keeping import Memory
from axistwin_conformance.mac_axis.safety import STORING, objection


class AxisFamily(Family):
    """A family of motors with an axis of the MAC's kind."""

    replay_module = "axistwin_conformance.mac_axis.checks_sequences"
    operation_bytes = 4

    @abstractmethod
    def indices(self, data: bytes) -> Iterable[int]:
        """The index of every command in these bytes that some reading would obey."""

    def is_alive(self, session: Session) -> bool:
        """See `keeping.sanity`."""
        return keeping.sanity(session)

    def stop(self, session: Session) -> None:
        """See `keeping.stop`."""
        keeping.stop(session)

    def remember(self, session: Session) -> Memory:
        """See `keeping.remember`."""
        return keeping.remember(session)

    def restore(self, session: Session, memory: Memory) -> tuple[str, ...]:
        """See `keeping.restore`."""
        return keeping.restore(session, memory)

    def forbid(self, session: Session, data: bytes) -> str | None:
        """Why these bytes must not be sent: an index of a class that the check did not declare."""
        return objection(session, self.indices(data))

    def stored_writes(self, data: bytes) -> int:
        """How many commands that write to the EEPROM these bytes hold."""
        return sum(index in STORING for index in self.indices(data))
