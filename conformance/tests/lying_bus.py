"""The built-in twin of a module on CAN with somebody in front who lies about some frames."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

import can
from scripted_bus import frame_of, message_of

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.core.session import Envelope, Run, Session, Stop
from axistwin_conformance.families.mac.axis.rig_controls import AXIS_CONTROLS
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.family import FAMILY, TWIN_BITRATE
from axistwin_conformance.transport.can import CanTransport, split_words
from axistwin_conformance.transport.can_frame import Frame
from axistwin_conformance.transport.rig import TwinRig

OWN_MODULES = tuple(name for name in FAMILY.modules if ".mac.can." in name)
LEDGER = load_ledger(FAMILY.name)
Turn = Callable[[Frame], Iterable[Frame]]


def own_checks() -> dict[str, Check]:
    """Every check that is written for CAN alone, by its name."""
    return {one.name: one for one in FAMILY.checks() if one.module in OWN_MODULES}


def as_it_is(frame: Frame) -> Iterable[Frame]:
    """Nothing done to a frame."""
    return (frame,)


class Liar:
    """The built-in twin's bus, but for some frames: told otherwise, or heard otherwise.

    `says(frame)`: what becomes of a frame from the bus.  `hears(frame)`: of one from the host.
    `injects(frame)`: what somebody says at once of a frame from the host.
    """

    def __init__(self, bus: Any, says: Turn, hears: Turn, injects: Turn) -> None:
        self._bus, self._says, self._hears, self._injects = bus, says, hears, injects
        self._waiting: deque[Frame] = deque()

    @property
    def virtual_time_ns(self) -> int:
        """The twin's time."""
        return int(self._bus.virtual_time_ns)

    @property
    def twins(self) -> Any:
        """The twins' handles."""
        return self._bus.twins

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Pass on what is heard of it."""
        frame = frame_of(msg)
        self._waiting.extend(self._injects(frame))
        for one in self._hears(frame):
            self._bus.send(message_of(one), timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """What is made of the next frame; nothing, if nothing is made of it."""
        assert timeout is not None
        until_ns = self.virtual_time_ns + round(timeout * 1e9)
        while not self._waiting:
            left_ns = until_ns - self.virtual_time_ns
            message = self._bus.recv(max(0, left_ns) / 1e9)
            if message is None:
                return None
            self._waiting.extend(self._says(frame_of(message)))
        return message_of(self._waiting.popleft())

    def shutdown(self) -> None:
        """Close."""
        self._bus.shutdown()


def open_liar(neighbours: tuple[int, ...], says: Turn, hears: Turn, injects: Turn) -> CanTransport:
    """The built-in twin of module 1, with these beside it, and what is told of it in front."""
    url = FAMILY.twin_url("mac23-can", 1, neighbours)
    interface, channel, _ = split_words(url)
    bus = can.Bus(channel, interface, ignore_config=True, bitrate=TWIN_BITRATE)
    return CanTransport(
        Liar(bus, says, hears, injects), url, is_spontaneous=codec.is_spontaneous,
        bitrate=TWIN_BITRATE, is_builtin=True,
    )  # fmt: skip


def make_run(target: CanTransport, neighbours: tuple[int, ...] = ()) -> Run:
    """A run of module 1 that may do anything."""
    return Run(
        target=target, family=FAMILY, model=FAMILY.models["mac23-can"], ledger=LEDGER, address=1,
        neighbours=neighbours, allowed=frozenset(SAFETY_CLASSES),
        envelope=Envelope(20_000, 60_000, is_guarded=False), seed=3,
    )  # fmt: skip


def judge(
    name: str, says: Turn = as_it_is, hears: Turn = as_it_is, injects: Turn = lambda frame: ()
) -> tuple[Finding, ...]:
    """Run one check on a twin in virtual time, with a neighbour unless it wants to be alone."""
    check = own_checks()[name]
    neighbours = () if "alone" in check.needs else (2,)
    target = open_liar(neighbours, says, hears, injects)
    try:
        run = make_run(target, neighbours)
        run.rig = TwinRig(target, 1, AXIS_CONTROLS) if check.rig_needs else None
        session = Session(run, check)

        def gate(data: bytes) -> None:
            assert FAMILY.forbid(session, data) is None, "sent what its safety class does not allow"

        target.gate = gate
        with contextlib.suppress(Stop):
            check(session)
        return session.conclude("")
    finally:
        target.gate = None
        target.close()


def failed(findings: Iterable[Finding]) -> set[str]:
    """The requirements that failed."""
    return {one.requirement for one in findings if one.verdict is Verdict.FAIL}


# --- what is made of a frame ---------------------------------------------------------------------


def is_reply_of(frame: Frame, *first: int, address: int = 1) -> bool:
    """True for a reply of that module with one of these first bytes."""
    return frame.identifier == codec.REPLY + address and frame.data[0] in first


def changed(frame: Frame, at: int, byte: int) -> Frame:
    """The same frame with one byte replaced."""
    return Frame(frame.identifier, frame.data[:at] + bytes([byte]) + frame.data[at + 1 :])


def replies_changed(at: int, byte: int, *first: int) -> Turn:
    """A byte of replies with these first bytes replaced."""

    def says(frame: Frame) -> Iterable[Frame]:
        return (changed(frame, at, byte) if is_reply_of(frame, *first) else frame,)

    return says


def twice(is_meant: Callable[[Frame], bool]) -> Turn:
    """Some frames said or heard twice."""
    return lambda frame: (frame, frame) if is_meant(frame) else (frame,)


def never(is_meant: Callable[[Frame], bool]) -> Turn:
    """Some frames lost."""
    return lambda frame: () if is_meant(frame) else (frame,)


def instead(is_meant: Callable[[Frame], bool], make: Callable[[Frame], Frame]) -> Turn:
    """Some frames turned into others."""
    return lambda frame: (make(frame),) if is_meant(frame) else (frame,)


def every_second(is_meant: Callable[[Frame], bool]) -> Turn:
    """Every second one of some frames lost."""
    count = 0

    def turn(frame: Frame) -> Iterable[Frame]:
        nonlocal count
        count += is_meant(frame)
        return () if is_meant(frame) and count % 2 == 0 else (frame,)

    return turn


def is_boot_up(frame: Frame) -> bool:
    """A boot-up message of anybody's."""
    return codec.boot_up_form(frame) is not None


def is_download(frame: Frame, low: int, identifier: int = 0x601) -> bool:
    """A download of that index, to module 1 or under that identifier."""
    return frame.identifier == identifier and frame.data[:2] == bytes([codec.DOWNLOAD, low])


def is_lmt(frame: Frame, *head: int) -> bool:
    """An LMT frame that begins so."""
    return frame.identifier == codec.LMT_REQUEST and frame.data[: len(head)] == bytes(head)


def also(is_meant: Callable[[Frame], bool], *others: Frame) -> Turn:
    """Some frames heard together with others."""
    return lambda frame: (frame, *others) if is_meant(frame) else (frame,)


def to_all_frames(is_meant: Callable[[Frame], bool], *others: Frame) -> Turn:
    """What somebody says at once when some frames are sent."""
    return lambda frame: others if is_meant(frame) else ()


RESET = codec.request(1, 0x00).frame()
