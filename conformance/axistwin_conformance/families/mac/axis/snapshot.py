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
from axistwin_conformance.core.session import ATTEMPTS, Session
from axistwin_conformance.families.mac.axis.driver.motion import Bench, bench_of
from axistwin_conformance.families.mac.axis.exchanges import Kind, Reply, signed
from axistwin_conformance.families.mac.axis.return_to_start import LOOK_S, is_runaway

PROBE_ATTEMPTS: Final = (
    6  # with the reply time-out of 0.5 s: longer than the deaf time after power-up
)
KNOWN_GOOD: Final = (0x20, 0x24, 0x22)  # a module answers them in every state but deafness
DISJUNCTIONS: Final = 0x1F  # bits of the first byte of 21h that latch and lock (§5.9)
PLAUSIBLE_CELSIUS: Final = (-20.0, 90.0)  # a MAC at rest; the models' scales differ by 70 degrees
MOST_LOOKS: Final = 1000  # in virtual time, where a way back of days is over in no time
STILL_S: Final = 0.5  # who has not moved for so long, has not heard that it should
TOLD_S: Final = 3.0  # a longer way back is told before it begins


@dataclass(frozen=True, slots=True)
class Facts:
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


def facts_of(session: Session) -> Facts:
    """The facts of the model under test."""
    facts = session.run.model.facts
    assert isinstance(facts, Facts)
    return facts


# --- who is there --------------------------------------------------------------------------------


def climate(session: Session, measures: Reply) -> dict[str, str]:
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
    bench, was_strict = bench_of(session), session.is_strict
    try:
        for index in KNOWN_GOOD:
            reply = bench.ask(index).reply
            if bench.is_answer(index, reply):
                return True
            if reply.kind is Kind.SILENCE and not session.transport.is_lossless:
                return False  # waited for long enough
            session.is_strict = True  # the first one was asked often enough for noise
        return False
    finally:
        session.is_strict = was_strict


def stop(session: Session) -> None:
    """Stop without ramp, again until the module says it has heard it; its neighbours as well."""
    memory: Memory | None = session.memory
    for address in (session.address, *(memory.neighbours if memory else ())):
        _stop(bench_of(session, address))


def _stop(bench: Bench) -> None:
    session = bench.session
    was_strict, session.is_strict = session.is_strict, True  # the attempts are counted here
    for _ in range(_attempts(session)):
        if bench.command(0x18).kind in (Kind.ACCEPTED, Kind.REFUSED):
            break
    session.is_strict = was_strict
    if bench.known("abort_flush"):  # what waits in its FIFO must not run with the next segment
        bench.command(0x1A)


def _attempts(session: Session) -> int:
    """How often to try: a silent module is soon given up, one on a noisy line is not."""
    return ATTEMPTS if session.run.quality.is_noisy else PROBE_ATTEMPTS


# --- what to put back ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Memory:
    """Everything readable that checks may change, as it was found; of the neighbours as well."""

    position: int
    superior: int
    inferior: int
    catch_up: int
    period: int
    coefficient: int
    torque: int
    modes: int
    tolerance: int
    neighbours: Mapping[int, Memory] = field(default_factory=dict)

    def __str__(self) -> str:
        named = (name for name in self.__slots__ if name != "neighbours")
        own = ", ".join(f"{name} {getattr(self, name)}" for name in named)
        return "; ".join([own, *(f"at {at:02X}h {one}" for at, one in self.neighbours.items())])


def remember(session: Session) -> Memory:
    """Read the position and all parameters; on a line that may be noisy until two readings agree.

    Raises TargetError if the device does not answer them.
    """
    memory, neighbours = _remembered(bench_of(session)), {}
    for address in session.neighbours:
        with contextlib.suppress(TargetError):  # who does not answer is not there
            neighbours[address] = _remembered(bench_of(session, address))
    return replace(memory, neighbours=neighbours)


def _remembered(bench: Bench) -> Memory:
    session, memory = bench.session, _read(bench)
    for _ in range(PROBE_ATTEMPTS):
        if session.transport.is_lossless or memory == (again := _read(bench)):
            return memory
        memory = again
    raise TargetError("the parameters read differently each time; is the axis at rest?")


def _read(bench: Bench) -> Memory:
    position = signed(_read_one(bench, 0x20))  # first: of an axis in no known place nothing is kept
    speeds, modes = _read_one(bench, 0x25), _read_one(bench, 0x26)
    return Memory(
        position=position,
        superior=_read_one(bench, 0x22),
        inferior=_read_one(bench, 0x23),
        catch_up=speeds >> 24,
        period=speeds & 0xFFFF,
        coefficient=modes >> 24,
        torque=modes >> 16 & 0xFF,
        modes=modes >> 8 & 0xFF,
        tolerance=modes & 0xFF,
    )


def _read_one(bench: Bench, index: int) -> int:
    reply = bench.ask(index).reply
    data: int | None = reply.data
    # Nothing may be put back as 0: an answer was lost.
    if data is None or not bench.is_answer(index, reply, in_any_reading=True):
        raise TargetError(f"no answer to {bench.named(index)}: {reply}")
    return data


def restore(session: Session, memory: Memory) -> tuple[str, ...]:
    """Put back what differs, and drive back to where the axes were found."""
    stop(session)
    left: list[str] = []
    lost: list[TargetError] = []
    for address, one in {session.address: memory, **memory.neighbours}.items():
        where = "" if address == session.address else f"at {address:02X}h "
        try:
            left += [where + text for text in _put_back(bench_of(session, address), one)]
        except TargetError as error:  # the others may still answer
            lost.append(error)
    if lost:
        raise lost[0]
    return tuple(left)


def _put_back(bench: Bench, memory: Memory) -> tuple[str, ...]:
    session = bench.session
    _clear_fault(bench)
    now = _read(bench)
    if now.position != memory.position:
        _drive_back(bench, memory.position)
        now = _read(bench)
    for _ in range(1 if session.transport.is_lossless else PROBE_ATTEMPTS):
        repairs = _repairs(now, memory)
        if not repairs:
            break
        replies = {bench.command(index, parameter).kind for index, parameter in repairs}
        is_sure = session.transport.is_lossless and replies == {Kind.ACCEPTED}
        now = replace(memory, position=now.position) if is_sure else _read(bench)
    return tuple(
        f"{name} is {getattr(now, name):X}h, was {getattr(memory, name):X}h"
        for name in Memory.__slots__
        if name != "neighbours" and getattr(now, name) != getattr(memory, name)
    )


def _clear_fault(bench: Bench) -> None:
    """With a fault latched the module would refuse to drive back (MACS-STATE-02)."""
    if bench.session.run.rig is None:  # then nothing has made one
        return
    for _ in range(_attempts(bench.session)):  # 00h may be silent: only 21h tells it was obeyed
        faults = bench.ask(0x21).reply.data or 0
        if not faults >> 24 & DISJUNCTIONS:
            return
        bench.command(0x00)
        bench.wait_awake()


def _repairs(now: Memory, memory: Memory) -> list[tuple[int, int]]:
    """The commands that make what is what was; unchanged things are not written again."""
    wanted = {
        0x09: (now.superior, memory.superior),
        0x0A: (now.inferior, memory.inferior),
        0x0C: (now.torque, memory.torque),
        0x0D: (now.period, memory.period),
        0x0E: (now.catch_up << 8, memory.catch_up << 8),
        0x0F: (now.coefficient, memory.coefficient),
        0x02: (now.modes >> 4, memory.modes >> 4),
        0x03: (now.modes & 0xF, memory.modes & 0xF),
        0x1C: (now.tolerance, memory.tolerance),
    }
    return [(index, was) for index, (present, was) in wanted.items() if present != was]


def _drive_back(bench: Bench, position: int) -> None:
    """Go back at the speed and with the ramp of the checks; give up after twice the time, or as
    soon as nobody wants to wait for it: told as not put back."""
    bench.settle()
    origin = bench.position()
    distance = abs(origin - position)
    is_too_far = distance > 2 * bench.session.envelope.max_travel
    if is_too_far or bench.session.run.runaway or interrupts.is_hurried():
        return
    attempts, lasts_s = _attempts(bench.session), bench.lasting_s(distance)
    if lasts_s >= TOLD_S and not bench.target.is_virtual:
        told = f"driving back {distance} increments, {time_left(lasts_s)}"
        bench.session.run.emit(Note(f"{told}; interrupt (Ctrl-C) to leave the axis on its way"))
    limit_s = 2 * lasts_s + (STILL_S + 0.5) * attempts
    deadline_ns = bench.target.now_ns + round(limit_s * 1e9)
    for _ in range(attempts):  # noise may have kept 13h from the module
        try:
            bench.command(0x13, position)
        except OutsideEnvelope:
            return  # told as not put back
        is_back = _comes_back(bench, origin, position, deadline_ns)
        bench.command(0x18)
        is_over = bench.target.now_ns >= deadline_ns or interrupts.is_hurried()
        if is_back or is_over or bench.session.run.runaway:
            return


def _comes_back(bench: Bench, origin: int, position: int, deadline_ns: int) -> bool:
    """Follow an axis on its way back; False as soon as it stands still elsewhere, it is too late,
    or somebody wants it to end."""
    target = bench.target
    last, since_ns, has_moved = None, target.now_ns, False
    least_s = max(LOOK_S, (deadline_ns - since_ns) / 1e9 / MOST_LOOKS)
    while target.now_ns < deadline_ns and not interrupts.is_hurried():
        here = bench.position()
        if here == position:
            return True
        if is_runaway(bench, origin, position, here):
            return False
        if here != last:
            last, since_ns, has_moved = here, target.now_ns, last is not None
        elif target.now_ns - since_ns >= STILL_S * 1e9:
            return False
        left_s = bench.lasting_s(abs(here - position))
        bench.wait(max(least_s, left_s) if target.is_virtual and has_moved else LOOK_S)
    return False
