"""What the engine must know of an axis, whichever face it has: the facts of a model, whether it
answers, how to stop it, what to remember of it and put back."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from axistwin_conformance.base import interrupts
from axistwin_conformance.base.errors import OutsideEnvelope, TargetError, WrongDevice, time_left
from axistwin_conformance.base.events import Note
from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.core.session import Session, strictly
from axistwin_conformance.families.mac.axis.driver.client import hold
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.facts import (
    facts_of,
    implausible,
    is_plausible,
)
from axistwin_conformance.families.mac.axis.exchanges import AxisReply, ReplyKind, signed
from axistwin_conformance.families.mac.axis.parameters import (
    PARAMETERS,
    READ_ORDER,
    settings_of,
    values_of,
)
from axistwin_conformance.families.mac.axis.return_to_start import STILL_S, comes_back
from axistwin_conformance.families.mac.axis.travel_guard import AxisTravelGuard, SentRequest

KNOWN_GOOD: Final = (0x20, 0x24, 0x22)  # a module answers them in every state but deafness
RESTORED: Final = (0x09, 0x0A, 0x0C, 0x0D, 0x0E, 0x0F, 0x02, 0x03, 0x1C)  # in this order
NAMES: Final = (  # of parameters, in the order of reports
    "superior",
    "inferior",
    "catch_up",
    "period",
    "coefficient",
    "torque",
    "modes",
    "tolerance",
)
DISJUNCTIONS: Final = 0x1F  # bits of the first byte of 21h that latch and lock (§5.9)
ANNOUNCED_S: Final = 3.0  # a longer way back is told before it begins


# --- who is there --------------------------------------------------------------------------------


def climate(session: Session, measures: AxisReply) -> dict[str, str]:
    """Temperature and supply as an answer to 27h tells them; they tell the models apart.

    A temperature that no model of the family can have makes no other model of it: it is wrong.
    """
    tt, vv, _, _ = measures.data_bytes()
    facts, run = facts_of(session), session.run
    celsius, volts = facts.celsius(tt), facts.volts(vv)
    if not is_plausible(celsius):
        violation = implausible(run, tt, celsius)
        if any(is_plausible(model.facts.celsius(tt)) for model in run.family.models.values()):
            raise WrongDevice(f"not a {run.model.name}: its {violation[2]}; try another model")
        run.violations.append(violation)
    return {"temperature": f"{celsius:.1f} °C", "supply": f"{volts:.1f} V"}


def sanity(session: Session) -> bool:
    """One good answer; to another query if the module answers the first one wrongly."""
    driver = driver_of(session)
    with strictly(session, is_strict=session.is_strict):
        for index in KNOWN_GOOD:
            reply = driver.client.ask(index).reply
            if driver.client.is_answer(index, reply):
                return True
            if reply.kind is ReplyKind.SILENCE and not session.transport.is_lossless:
                return False  # waited for long enough
            session.is_strict = True  # the first one was asked often enough for noise
    return False


def stop(session: Session) -> None:
    """Stop without ramp, again until the module says it has heard it; its neighbours as well."""
    memory: AxisSnapshot | None = session.run.memory
    for address in (session.address, *(memory.neighbours if memory else ())):
        _stop(driver_of(session, address))


def _stop(driver: AxisDriver) -> None:
    session = driver.session
    if session.run.runaway:
        hold(driver.client)
        return
    with strictly(session):  # the attempts are counted here
        for _ in range(_attempts(session)):
            if driver.client.command(0x18).kind in (ReplyKind.ACCEPTED, ReplyKind.REFUSED):
                break
    if driver.readings.known(
        "abort_flush"
    ):  # what waits in its FIFO must not run with the next segment
        driver.client.command(0x1A)


def _attempts(session: Session) -> int:
    """How often to try: a silent module is soon given up, one on a noisy line is not."""
    return RETRY.exchange if session.run.quality.is_noisy else RETRY.presence


# --- what to put back ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class AxisSnapshot:
    """Everything readable that checks may change, as it was found; of the neighbours as well.

    `parameters`: what the commands with these indices set.
    """

    position: int
    parameters: Mapping[int, int]
    neighbours: Mapping[int, AxisSnapshot] = field(default_factory=dict)

    def named(self) -> dict[str, int]:
        """Everything by name, in the order of reports; the two modes in the byte they share."""
        named = {PARAMETERS[index].name: value for index, value in self.parameters.items()}
        named["modes"] = named["standby"] << 4 | named["stops"]
        return {"position": self.position, **{name: named[name] for name in NAMES}}

    def but_for(self, indices: tuple[int, ...], other: AxisSnapshot) -> AxisSnapshot:
        """The same, with these parameters as another snapshot has them."""
        taken = {index: other.parameters[index] for index in indices}
        return replace(self, parameters={**self.parameters, **taken})

    def as_object(self) -> dict[str, Any]:
        """The same as a file keeps it."""
        return {
            "position": self.position,
            "parameters": {f"{index:02X}": value for index, value in self.parameters.items()},
            "neighbours": {f"{at:02X}": one.as_object() for at, one in self.neighbours.items()},
        }

    @classmethod
    def from_object(cls, held: Mapping[str, Any]) -> AxisSnapshot:
        """Raises ValueError, KeyError or TypeError for what is none."""
        parameters = {int(index, 16): int(value) for index, value in held["parameters"].items()}
        if missing := set(RESTORED) - set(parameters):
            raise ValueError(f"{min(missing):02X}h is missing")
        neighbours = held["neighbours"].items()
        return cls(
            int(held["position"]), parameters,
            {int(at, 16): cls.from_object(one) for at, one in neighbours},
        )  # fmt: skip

    def __str__(self) -> str:
        own = ", ".join(f"{name} {value}" for name, value in self.named().items())
        others = (f"at {at:02X}h {snapshot}" for at, snapshot in self.neighbours.items())
        return "; ".join([own, *others])


def remember(session: Session) -> AxisSnapshot:
    """Read the position and all parameters; on a line that may be noisy until two readings agree.

    Raises TargetError if the device does not answer them.
    """
    memory, neighbours = _remembered(driver_of(session)), {}
    for address in session.neighbours:
        with contextlib.suppress(TargetError):  # who does not answer is not there
            neighbours[address] = _remembered(driver_of(session, address))
    return replace(memory, neighbours=neighbours)


def _remembered(driver: AxisDriver) -> AxisSnapshot:
    session, memory = driver.session, _read(driver)
    for _ in range(RETRY.presence):
        if session.transport.is_lossless or memory == (again := _read(driver)):
            return memory
        memory = again
    raise TargetError("the parameters read differently each time; is the axis at rest?")


def _read(driver: AxisDriver) -> AxisSnapshot:
    position = signed(
        _read_one(driver, 0x20)
    )  # first: of an axis in no known place nothing is kept
    answers = {query: _read_one(driver, query) for query in READ_ORDER}
    return AxisSnapshot(position, values_of(answers))


def _read_one(driver: AxisDriver, index: int) -> int:
    reply = driver.client.ask(index).reply
    data: int | None = reply.data
    # Nothing may be put back as 0: an answer was lost.
    if data is None or not driver.client.is_answer(index, reply, in_any_reading=True):
        raise TargetError(f"no answer to {driver.client.named(index)}: {reply}")
    return data


def restore(session: Session, memory: AxisSnapshot, left: tuple[int, ...] = ()) -> tuple[str, ...]:
    """Put back what differs, and drive back to where the axes were found.

    `left`: the parameters of the module under test that may stay as they are.  That module comes
    last: by its last exchange it is judged if it is lost.
    """
    stop(session)
    different: list[str] = []
    lost: list[TargetError] = []
    for address, snapshot in {**memory.neighbours, session.address: memory}.items():
        is_own = address == session.address
        where, kept = ("", left) if is_own else (f"at {address:02X}h ", ())
        try:
            described = _put_back(driver_of(session, address), snapshot, kept)
        except TargetError as error:  # the others may still answer
            lost.append(error)
        else:
            different += [where + text for text in described]
    if lost:
        raise lost[0]
    return tuple(different)


# --- what is not known after all -----------------------------------------------------------------


class _Doubts:
    """Which parameters are told by queries of which an answer has failed (`Run.doubted`), and what
    was written to each: the travel guard hears all.  The built-in twin that has none is thrown
    away, and nobody need know what it held."""

    def __init__(self, session: Session) -> None:
        travel_guard = session.transport.travel_guard
        self._guard = travel_guard if isinstance(travel_guard, AxisTravelGuard) else None
        requests = session.run.doubted if self._guard else ()
        asked = {one.index for request in requests for one in self.understood(request)}
        self.indices = {index for index, one in PARAMETERS.items() if one.query in asked}

    def understood(self, data: bytes) -> list[SentRequest]:
        """The requests in what is sent."""
        return self._guard.reader.foreseen(data) if self._guard else []

    def written(self, address: int) -> Mapping[int, int]:
        """What was sent last for each parameter."""
        return self._guard.written.get(address, {}) if self._guard else {}

    def is_to_keep(self, address: int, index: int) -> bool:
        """Whether it is doubtful and nothing has been written to it yet."""
        return index in self.indices and index not in self.written(address)


def unsure(session: Session, memory: AxisSnapshot) -> tuple[str, ...]:
    """What was written to, and remembered by answers that have failed since."""
    doubts, told = _Doubts(session), []
    for address, snapshot in {session.address: memory, **memory.neighbours}.items():
        where = "" if address == session.address else f"at {address:02X}h "
        for index in sorted(doubts.indices & doubts.written(address).keys()):
            one, last = PARAMETERS[index], doubts.written(address)[index]
            told.append(
                f"{where}{one.name} was written to, and what it was is not known: it was told as"
                f" {snapshot.parameters[index]:X}h by a query that has failed; last written was"
                f" {one.taken(last) & 0xFFFF_FFFF:X}h"
            )
    return tuple(told)


def would_lose(session: Session, data: bytes) -> str:
    """Why these bytes must not be sent: what they replace is not known, and still there."""
    doubts = _Doubts(session)
    everybody = (session.address, *session.neighbours)
    for asked in doubts.understood(data) if doubts.indices else ():
        for address in everybody if asked.address is None else (asked.address,):
            if doubts.is_to_keep(address, asked.index):
                name = PARAMETERS[asked.index].name
                return f"would write {name}, and what it was is not known: its query has failed"
    return ""


def _put_back(driver: AxisDriver, memory: AxisSnapshot, left: tuple[int, ...]) -> tuple[str, ...]:
    session = driver.session
    _clear_fault(driver)
    _disarm(driver)
    now = _read(driver)
    if now.position != memory.position:
        with contextlib.suppress(OutsideEnvelope):  # told as not put back
            _drive_back(driver, memory.position)
        now = _read(driver)
        _say_what_is_too_far(session, abs(now.position - memory.position))
    for _ in range(1 if session.transport.is_lossless else RETRY.presence):
        repairs = _repairs(driver, now, memory.but_for(left, now))
        if not repairs:
            break
        replies = {_repaired(driver, index, parameter) for index, parameter in repairs}
        is_sure = session.transport.is_lossless and replies == {ReplyKind.ACCEPTED}
        repaired = replace(memory.but_for(left, now), position=now.position)
        now = repaired if is_sure else _read_again(driver)
    found = memory.but_for(left, now).named()
    return tuple(
        f"{name} is {value:X}h, was {found[name]:X}h"
        for name, value in now.named().items()
        if value != found[name]
    )


def _repaired(driver: AxisDriver, index: int, parameter: int) -> ReplyKind | None:
    """Put one parameter back; None if that may move the axis: it stays as it is.  What an axis does
    of which that is not known any more, is looked at each time."""
    try:
        kind = driver.client.command(index, parameter).kind
    except OutsideEnvelope:
        return None
    if driver.session.run.runaway:
        hold(driver.client)
    return kind


def _read_again(driver: AxisDriver) -> AxisSnapshot:
    """Read what has been put back; of an axis that should not have moved meanwhile."""
    was_runaway, now = driver.session.run.runaway, _read(driver)
    guard = driver.motion.travel_guard
    if guard is not None and guard.is_in_doubt:
        driver.client.ask(0x20)
    if driver.session.run.runaway and not was_runaway:
        hold(driver.client, is_seen_moving=True)
        return _read(driver)
    return now


def _clear_fault(driver: AxisDriver) -> None:
    """With a fault latched the module would refuse to drive back (MACS-STATE-02)."""
    if driver.session.run.rig is None:  # then nothing has made one
        return
    for _ in range(_attempts(driver.session)):  # 00h may be silent: only 21h tells it was obeyed
        faults = driver.client.ask(0x21).reply.data or 0
        if not faults >> 24 & DISJUNCTIONS & driver.client.face.faults:
            return
        driver.client.command(0x00)
        driver.motion.wait_awake()


def _disarm(driver: AxisDriver) -> None:
    """What stops have left armed would hold the next motion that anybody asks for (MACS-AMB-36)."""
    if driver.motion.travel_guard is None or driver.motion.is_disarmed:
        return  # the built-in twin is thrown away
    with contextlib.suppress(OutsideEnvelope):
        driver.motion.disarm()


def _repairs(driver: AxisDriver, now: AxisSnapshot, memory: AxisSnapshot) -> list[tuple[int, int]]:
    """The commands that make what is what was; unchanged things are not written again, nor is what
    is doubtful and nobody has written to."""
    doubts, address = _Doubts(driver.session), driver.client.address
    differing = [
        index
        for index in RESTORED
        if now.parameters[index] != memory.parameters[index]
        and not doubts.is_to_keep(address, index)
    ]
    return list(settings_of(memory.parameters, differing).items())


def _say_what_is_too_far(session: Session, distance: int) -> None:
    """An axis that a killed run has left far away needs leave to go so far."""
    most = session.envelope.max_travel
    if distance > most and not session.run.runaway and not interrupts.is_hurried():
        session.run.emit(
            Note(
                f"the axis is not driven back: {distance} increments are more than --max-travel"
                f" {most}; if the way is free, --restore FILE --max-travel {distance} drives it"
            )
        )


def _drive_back(driver: AxisDriver, position: int) -> None:
    """Go back at the speed and with the ramp of the checks; give up after twice the time, or as
    soon as nobody wants to wait for it: told as not put back.  Raises OutsideEnvelope if nothing
    may move the axis any more."""
    distance = abs(driver.client.position() - position)
    if driver.session.run.runaway:  # no more of what may be what moves it
        return
    driver.motion.set_plain(distance=distance)
    is_too_far = distance > 2 * driver.session.envelope.max_travel
    if is_too_far or interrupts.is_hurried():
        return
    attempts, lasts_s = _attempts(driver.session), driver.motion.lasting_s(distance)
    if lasts_s >= ANNOUNCED_S and not driver.client.target.is_virtual:
        described = f"driving back {distance} increments, {time_left(lasts_s)}"
        driver.session.run.emit(
            Note(f"{described}; interrupt (Ctrl-C) to leave the axis on its way")
        )
    limit_s = 2 * lasts_s + (STILL_S + 0.5) * attempts
    deadline_ns = driver.client.target.now_ns + round(limit_s * 1e9)
    for _ in range(attempts):  # noise may have kept 13h from the module
        driver.client.command(0x13, position)
        is_back = comes_back(driver.client, position, driver.motion.lasting_s, deadline_ns)
        driver.client.command(0x18)
        is_over = driver.client.target.now_ns >= deadline_ns or interrupts.is_hurried()
        if is_back or is_over or driver.session.run.runaway:
            return
