"""What the engine must know of an axis, whichever face it has: the facts of a model, whether it
answers, how to stop it, what to remember of it and put back."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from axistwin_conformance.base import interrupts
from axistwin_conformance.base.errors import OutsideEnvelope, TargetError, WrongDevice, time_left
from axistwin_conformance.base.events import Note
from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.exchanges import AxisReply, ReplyKind, signed
from axistwin_conformance.families.mac.axis.parameters import (
    PARAMETERS,
    READ_ORDER,
    settings_of,
    values_of,
)
from axistwin_conformance.families.mac.axis.return_to_start import LOOK_S, is_runaway

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
PLAUSIBLE_CELSIUS: Final = (-20.0, 90.0)  # a MAC at rest; the models' scales differ by 70 degrees
MOST_LOOKS: Final = 1000  # in virtual time, where a way back of days is over in no time
STILL_S: Final = 0.5  # who has not moved for so long, has not heard that it should
ANNOUNCED_S: Final = 3.0  # a longer way back is told before it begins


@dataclass(frozen=True, slots=True)
class MacFacts:
    """What differs between the models on the wire (§5.9): temperature = gain·tt + offset, supply =
    vv·volts_per_count, the shaft's resolution, and Imax where the manual lets it be derived."""

    increments_per_turn: int
    celsius_gain: float
    celsius_offset: float
    volts_per_count: float
    imax: int | None

    @property
    def is_mac23(self) -> bool:
        """True for the motor with 2000 increments per turn, on whichever face."""
        return self.increments_per_turn == 2000

    def celsius(self, tt: int) -> float:
        """Read byte tt of answer 27h."""
        return self.celsius_gain * tt + self.celsius_offset

    def volts(self, vv: int) -> float:
        """Read byte vv of answer 27h."""
        return vv * self.volts_per_count


def facts_of(session: Session) -> MacFacts:
    """The facts of the model under test."""
    facts = session.run.model.facts
    assert isinstance(facts, MacFacts)
    return facts


# --- who is there --------------------------------------------------------------------------------


def climate(session: Session, measures: AxisReply) -> dict[str, str]:
    """Temperature and supply as an answer to 27h tells them; they tell the models apart."""
    tt, vv, _, _ = measures.data_bytes()
    facts = facts_of(session)
    celsius, volts = facts.celsius(tt), facts.volts(vv)
    if not PLAUSIBLE_CELSIUS[0] <= celsius <= PLAUSIBLE_CELSIUS[1]:
        raise WrongDevice(
            f"not a {session.run.model.name}: its temperature byte {tt:02X}h would mean"
            f" {celsius:.0f} °C; try another model"
        )
    return {"temperature": f"{celsius:.1f} °C", "supply": f"{volts:.1f} V"}


def sanity(session: Session) -> bool:
    """One good answer; to another query if the module answers the first one wrongly."""
    driver, was_strict = driver_of(session), session.is_strict
    try:
        for index in KNOWN_GOOD:
            reply = driver.client.ask(index).reply
            if driver.client.is_answer(index, reply):
                return True
            if reply.kind is ReplyKind.SILENCE and not session.transport.is_lossless:
                return False  # waited for long enough
            session.is_strict = True  # the first one was asked often enough for noise
        return False
    finally:
        session.is_strict = was_strict


def stop(session: Session) -> None:
    """Stop without ramp, again until the module says it has heard it; its neighbours as well."""
    memory: AxisSnapshot | None = session.memory
    for address in (session.address, *(memory.neighbours if memory else ())):
        _stop(driver_of(session, address))


def _stop(driver: AxisDriver) -> None:
    session = driver.session
    was_strict, session.is_strict = session.is_strict, True  # the attempts are counted here
    for _ in range(_attempts(session)):
        if driver.client.command(0x18).kind in (ReplyKind.ACCEPTED, ReplyKind.REFUSED):
            break
    session.is_strict = was_strict
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


def restore(session: Session, memory: AxisSnapshot) -> tuple[str, ...]:
    """Put back what differs, and drive back to where the axes were found."""
    stop(session)
    left: list[str] = []
    lost: list[TargetError] = []
    for address, snapshot in {session.address: memory, **memory.neighbours}.items():
        where = "" if address == session.address else f"at {address:02X}h "
        try:
            left += [where + text for text in _put_back(driver_of(session, address), snapshot)]
        except TargetError as error:  # the others may still answer
            lost.append(error)
    if lost:
        raise lost[0]
    return tuple(left)


def _put_back(driver: AxisDriver, memory: AxisSnapshot) -> tuple[str, ...]:
    session = driver.session
    _clear_fault(driver)
    now = _read(driver)
    if now.position != memory.position:
        _drive_back(driver, memory.position)
        now = _read(driver)
    for _ in range(1 if session.transport.is_lossless else RETRY.presence):
        repairs = _repairs(now, memory)
        if not repairs:
            break
        replies = {driver.client.command(index, parameter).kind for index, parameter in repairs}
        is_sure = session.transport.is_lossless and replies == {ReplyKind.ACCEPTED}
        now = replace(memory, position=now.position) if is_sure else _read(driver)
    found = memory.named()
    return tuple(
        f"{name} is {value:X}h, was {found[name]:X}h"
        for name, value in now.named().items()
        if value != found[name]
    )


def _clear_fault(driver: AxisDriver) -> None:
    """With a fault latched the module would refuse to drive back (MACS-STATE-02)."""
    if driver.session.run.rig is None:  # then nothing has made one
        return
    for _ in range(_attempts(driver.session)):  # 00h may be silent: only 21h tells it was obeyed
        faults = driver.client.ask(0x21).reply.data or 0
        if not faults >> 24 & DISJUNCTIONS:
            return
        driver.client.command(0x00)
        driver.motion.wait_awake()


def _repairs(now: AxisSnapshot, memory: AxisSnapshot) -> list[tuple[int, int]]:
    """The commands that make what is what was; unchanged things are not written again."""
    differing = [index for index in RESTORED if now.parameters[index] != memory.parameters[index]]
    return list(settings_of(memory.parameters, differing).items())


def _drive_back(driver: AxisDriver, position: int) -> None:
    """Go back at the speed and with the ramp of the checks; give up after twice the time, or as
    soon as nobody wants to wait for it: told as not put back."""
    driver.motion.set_plain()
    origin = driver.client.position()
    distance = abs(origin - position)
    is_too_far = distance > 2 * driver.session.envelope.max_travel
    if is_too_far or driver.session.run.runaway or interrupts.is_hurried():
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
        try:
            driver.client.command(0x13, position)
        except OutsideEnvelope:
            return  # told as not put back
        is_back = _comes_back(driver, origin, position, deadline_ns)
        driver.client.command(0x18)
        is_over = driver.client.target.now_ns >= deadline_ns or interrupts.is_hurried()
        if is_back or is_over or driver.session.run.runaway:
            return


def _comes_back(driver: AxisDriver, origin: int, position: int, deadline_ns: int) -> bool:
    """Follow an axis on its way back; False as soon as it stands still elsewhere, it is too late,
    or somebody wants it to end."""
    target = driver.client.target
    last, since_ns, has_moved = None, target.now_ns, False
    least_s = max(LOOK_S, (deadline_ns - since_ns) / 1e9 / MOST_LOOKS)
    while target.now_ns < deadline_ns and not interrupts.is_hurried():
        here = driver.client.position()
        if here == position:
            return True
        if is_runaway(driver.client, origin, position, here):
            return False
        if here != last:
            last, since_ns, has_moved = here, target.now_ns, last is not None
        elif target.now_ns - since_ns >= STILL_S * 1e9:
            return False
        left_s = driver.motion.lasting_s(abs(here - position))
        driver.client.wait(max(least_s, left_s) if target.is_virtual and has_moved else LOOK_S)
    return False
