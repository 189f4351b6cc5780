"""What the families of one axis share, whichever face it has."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable

from axistwin_conformance.base.errors import TargetError
from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.base.transcript import Direction
from axistwin_conformance.core.contact import learn_delay
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.identity import Identity
from axistwin_conformance.core.lenient import Lenient
from axistwin_conformance.core.session import Session, strictly
from axistwin_conformance.families.mac.axis import snapshot
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.motion import PLAIN
from axistwin_conformance.families.mac.axis.exchanges import AxisReply, ReplyKind
from axistwin_conformance.families.mac.axis.options import OPTIONS
from axistwin_conformance.families.mac.axis.rig_controls import AXIS_CONTROLS
from axistwin_conformance.families.mac.axis.safety import STORING, objection
from axistwin_conformance.families.mac.axis.snapshot import AxisSnapshot
from axistwin_conformance.families.mac.axis.words import GLOSSARY

LATEST_RECORDS = 64  # of a transcript: more than one exchange has


class AxisFamily(Family):
    """A family of motors with an axis of the MAC's kind."""

    _replay_module = "axistwin_conformance.families.mac.axis.checks.sequences"
    operation_bytes = 4
    rig_controls = AXIS_CONTROLS
    options = OPTIONS
    glossary = GLOSSARY

    @property
    def _packages(self) -> tuple[str, ...]:
        """Its own, and that of the axis."""
        return (*super()._packages, __name__.rpartition(".")[0])

    # --- who is there ----------------------------------------------------------------------------

    def identify(self, session: Session) -> Identity:
        """Ask release and measures: the only things on the wire that tell one model from another.

        A module that answers one of these questions wrongly and others well is a module all the
        same; what it broke is for the checks to say.
        """
        driver = driver_of(session)
        self._listen_first(session)
        with strictly(session):  # the attempts are counted here
            last = _insisted(driver, 0x24)
            release = last.data if last.kind is ReplyKind.ANSWER else None
            if release is None and not snapshot.sanity(session):
                raise TargetError(self._nobody_there(driver, last))
        values = {"release": "unknown" if release is None else f"{release:08X}"}
        measures, own_values = driver.client.ask(0x27).reply, self._own_values(driver)
        if measures.data is not None:
            values |= snapshot.climate(session, measures)
        described = [f"release {values['release']}"]
        described += [values[name] for name in ("temperature", "supply") if name in values]
        where = f"{session.run.model.title} at {self._address_text(session.address)}"
        return Identity(f"{where}, {', '.join(described)}", values | own_values)

    @abstractmethod
    def _address_text(self, address: int) -> str:
        """An address as users of this face write it."""

    @abstractmethod
    def _nobody_there(self, driver: AxisDriver, reply: AxisReply) -> str:
        """That nobody answers, what came instead, and what to try."""

    def _listen_first(self, session: Session) -> None:
        """Take note of who talks before anything is asked."""
        return

    def _own_values(self, driver: AxisDriver) -> dict[str, str]:
        """What only this face tells."""
        return {}

    # --- what keeps a device safe ----------------------------------------------------------------

    @abstractmethod
    def _indices(self, data: bytes) -> Iterable[int]:
        """The index of every command in these bytes that some reading would obey."""

    is_alive = staticmethod(snapshot.sanity)
    stop = staticmethod(snapshot.stop)
    remember = staticmethod(snapshot.remember)
    unsure = staticmethod(snapshot.unsure)
    would_lose = staticmethod(snapshot.would_lose)
    kept = staticmethod(AxisSnapshot.as_object)
    memory_of = staticmethod(AxisSnapshot.from_object)

    def restore(self, session: Session, memory: AxisSnapshot) -> tuple[str, ...]:
        """See `snapshot.restore`; before a check that moves the settings of `AxisMotion.ready`
        stay."""
        follows = session.run.next_check
        is_set_up = follows is not None and "motion" in follows.safety
        return snapshot.restore(session, memory, left=PLAIN if is_set_up else ())

    def lenient(self, session: Session, request: bytes, reply: bytes) -> Lenient | None:
        """See `Family.lenient`; a reply that comes late is one that comes in its own time, but for
        commands that move."""
        return self._read_leniently(session, request, reply, _waited_ns(session, request))

    @abstractmethod
    def _read_leniently(
        self, session: Session, request: bytes, reply: bytes, after_ns: int
    ) -> Lenient | None:
        """The same, of a reply that came so long after the request."""

    def forbid(self, session: Session, data: bytes) -> str | None:
        """Why these bytes must not be sent: an index of a class that the check did not declare."""
        return objection(session, self._indices(data))

    def stored_writes(self, data: bytes) -> int:
        """How many commands that write to the EEPROM these bytes hold."""
        return sum(index in STORING for index in self._indices(data))


def _waited_ns(session: Session, request: bytes) -> int:
    """How long after a request, the last one sent, its reply began to come; 0 without one."""
    sent, *later = session.transport.transcript.since_request(LATEST_RECORDS) or (None,)
    if sent is None or sent.data != request:
        return 0
    came_ns = (one.time_ns for one in later if one.direction is Direction.DEVICE)
    waited_ns = next(came_ns, sent.time_ns) - sent.time_ns
    return max(0, waited_ns - session.transport.line_ns)


def _insisted(driver: AxisDriver, index: int) -> AxisReply:
    """Ask until there is an answer; longer if what comes differs, which is noise, or late."""
    seen, since_ns = set[bytes](), driver.client.target.now_ns

    def is_replied() -> bool:
        return driver.client.ask(index).kind is not ReplyKind.SILENCE

    for number in range(1, RETRY.exchange + 1):
        reply: AxisReply = driver.client.ask(index).reply
        if reply.raw and seen == {b""}:
            learn_delay(driver.session, since_ns, is_replied)
            reply = driver.client.ask(index).reply
        seen.add(reply.raw)
        if reply.kind is ReplyKind.ANSWER or (number >= RETRY.presence and len(seen) == 1):
            break
    return reply
