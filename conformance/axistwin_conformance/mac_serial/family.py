"""What the engine must know of the MAC family beside its checks: who is there, how to stop, what to
put back, and which frame may do what to the axis."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

from axistwin_conformance.errors import OutsideEnvelope, TargetError, WrongDevice
from axistwin_conformance.mac_serial import codec
from axistwin_conformance.mac_serial.bench import QUIET_S, Bench
from axistwin_conformance.mac_serial.blame import OTHER_DIGITS, blame
from axistwin_conformance.mac_serial.codec import Kind, Reply
from axistwin_conformance.mac_serial.fence import Fence
from axistwin_conformance.mac_serial.motion import TICK_NS
from axistwin_conformance.registry import SAFETY_CLASSES, Family, Identity, Model
from axistwin_conformance.session import ATTEMPTS, Run, Session
from axistwin_conformance.transcript import Direction, Record

IMAX_ADDRESS: Final = 0xAF  # MACS-Q-28-01
BAUDS: Final = (9600, 19200, 38400)  # MACS-CMD-1B-01
PROBE_ATTEMPTS: Final = (
    6  # with the reply time-out of 0.5 s: longer than the deaf time after power-up
)
FACE_BYTES: Final = 16
KNOWN_GOOD: Final = (0x20, 0x24, 0x22)  # a module answers them in every state but deafness
DISJUNCTIONS: Final = 0x1F  # bits of the first byte of 21h that latch and lock (§5.9)
PLAUSIBLE_CELSIUS: Final = (-20.0, 90.0)  # a MAC at rest; the models' scales differ by 70 degrees


@dataclass(frozen=True, slots=True)
class Facts:
    """What differs between the models on the wire (§5.9): temperature = gain·tt + offset, supply =
    vv·volts_per_count, the shaft's resolution, and Imax where the manual lets it be derived."""

    increments_per_turn: int
    celsius_gain: float
    celsius_offset: float
    volts_per_count: float
    imax: int | None

    def celsius(self, tt: int) -> float:
        """Read byte tt of answer 27h."""
        return self.celsius_gain * tt + self.celsius_offset

    def volts(self, vv: int) -> float:
        """Read byte vv of answer 27h."""
        return vv * self.volts_per_count


MODELS: Final = {
    model.name: model
    for model in (
        Model("mac23", "MAC23 (serial)", Facts(2000, 2.5, -215.0, 1 / 4.8, 0x80)),
        Model("mac34-1", "MAC34-1 (serial)", Facts(10000, 2.45, -140.0, 0.4, None)),
        Model("mac34-2", "MAC34-2 (serial)", Facts(10000, 2.45, -140.0, 0.8, None)),
    )
}


def facts_of(session: Session) -> Facts:
    """The facts of the model under test."""
    facts = session.model.facts
    assert isinstance(facts, Facts)
    return facts


# --- who is there --------------------------------------------------------------------------------


def probe(session: Session) -> Identity:
    """Ask release and measures: the only things on the wire that tell one model from another.

    A module that answers one of these questions wrongly and others well is a module all the same;
    what it broke is for the checks to say.
    """
    bench = Bench(session)
    session.is_strict = True  # the attempts are counted here
    last = _insisted(bench, 0x24)
    release = last.data if last.kind is Kind.ANSWER else None
    if release is None and not sanity(session):
        others = [str(rate) for rate in BAUDS if rate != session.target.baud]
        raise TargetError(
            f"no module answers at address {bench.address:02X}h and {session.target.baud} baud:"
            f" {_heard(bench, last)}; try --baud {' or '.join(others)}, or another --address"
        )
    session.is_strict = session.target.is_lossless
    values = {"release": "unknown" if release is None else f"{release:08X}"}
    measures, imax = bench.ask(0x27).reply, bench.ask(0x28, IMAX_ADDRESS).reply
    if measures.data is not None:
        values |= _climate(session, measures)
    if imax.data is not None:
        values["imax"] = f"{imax.data_bytes()[0]:02X}h"
    told = [f"release {values['release']}"]
    told += [values[name] for name in ("temperature", "supply") if name in values]
    return Identity(f"{session.model.title} at {bench.address:02X}h, {', '.join(told)}", values)


def _insisted(bench: Bench, index: int) -> Reply:
    """Ask until there is an answer; longer if what comes differs, which is noise."""
    seen = set()
    for number in range(1, ATTEMPTS + 1):
        reply = bench.command(index).reply
        seen.add(reply.raw)
        if reply.kind is Kind.ANSWER or (number >= PROBE_ATTEMPTS and len(seen) == 1):
            break
    return reply


def _heard(bench: Bench, reply: Reply) -> str:
    """What came instead of an answer, with what follows it: another protocol shows its face."""
    if reply.kind is not Kind.GARBAGE:
        return str(reply)
    raw = reply.raw + bench.target.receive(FACE_BYTES, QUIET_S)
    text = "".join(chr(one) if 0x20 <= one < 0x7F else "." for one in raw)
    return f"something else talks there: {raw.hex(' ').upper()} ({text})"


def _climate(session: Session, measures: Reply) -> dict[str, str]:
    """Temperature and supply as an answer to 27h tells them; they tell the models apart."""
    tt, vv, _, _ = measures.data_bytes()
    facts = facts_of(session)
    celsius, volts = facts.celsius(tt), facts.volts(vv)
    if not PLAUSIBLE_CELSIUS[0] <= celsius <= PLAUSIBLE_CELSIUS[1]:
        raise WrongDevice(
            f"not a {session.model.name}: its temperature byte {tt:02X}h would mean"
            f" {celsius:.0f} °C; try another model"
        )
    return {"temperature": f"{celsius:.1f} °C", "supply": f"{volts:.1f} V"}


def sanity(session: Session) -> bool:
    """One good answer; to another query if the module answers the first one wrongly."""
    bench, was_strict = Bench(session), session.is_strict
    try:
        for index in KNOWN_GOOD:
            reply = bench.ask(index).reply
            if reply.digit == index & 0xF:
                return True
            if reply.kind is Kind.SILENCE and not session.target.is_lossless:
                return False  # waited for long enough
            session.is_strict = True  # the first one was asked often enough for noise
        return False
    finally:
        session.is_strict = was_strict


def stop(session: Session) -> None:
    """Stop without ramp, again until the module says it has heard it; its neighbours as well."""
    memory: Memory | None = session.memory
    for address in (session.address, *(memory.neighbours if memory else ())):
        _stop(Bench(session, address))


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


def remember(session: Session) -> Memory:
    """Read the position and all parameters; on a line that may be noisy until two readings agree.

    Raises TargetError if the device does not answer them.
    """
    memory, neighbours = _remembered(Bench(session)), {}
    for address in session.neighbours:
        with contextlib.suppress(TargetError):  # who does not answer is not there
            neighbours[address] = _remembered(Bench(session, address))
    return replace(memory, neighbours=neighbours)


def _remembered(bench: Bench) -> Memory:
    session, memory = bench.session, _read(bench)
    for _ in range(PROBE_ATTEMPTS):
        if session.target.is_lossless or memory == (again := _read(bench)):
            return memory
        memory = again
    raise TargetError("the parameters read differently each time; is the axis at rest?")


def _read(bench: Bench) -> Memory:
    speeds, modes = _read_one(bench, 0x25), _read_one(bench, 0x26)
    return Memory(
        position=codec.signed(_read_one(bench, 0x20)),
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
    digits = (index & 0xF, OTHER_DIGITS.get(index))
    is_ours = reply.address == bench.address and reply.digit in digits
    if reply.data is None or not is_ours:  # nothing may be put back as 0: an answer was lost
        raise TargetError(f"no answer to query {index:02X}h: {reply}")
    return reply.data


def restore(session: Session, memory: Memory) -> tuple[str, ...]:
    """Put back what differs, and drive back to where the axes were found."""
    stop(session)
    left: list[str] = []
    lost: list[TargetError] = []
    for address, one in {session.address: memory, **memory.neighbours}.items():
        where = "" if address == session.address else f"at {address:02X}h "
        try:
            left += [where + text for text in _put_back(Bench(session, address), one)]
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
    for _ in range(1 if session.target.is_lossless else PROBE_ATTEMPTS):
        repairs = _repairs(now, memory)
        if not repairs:
            break
        replies = {bench.command(index, parameter).kind for index, parameter in repairs}
        is_sure = session.target.is_lossless and replies == {Kind.ACCEPTED}
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
    """Go back at the speed and with the ramp of the checks; give up after twice the time."""
    bench.settle()
    distance = abs(bench.position() - position)
    if distance > 2 * bench.session.envelope.max_travel:
        return
    seconds = 2 * distance * bench.period * TICK_NS / 1e9
    for _ in range(_attempts(bench.session)):  # noise may have kept 13h from the module
        try:
            bench.command(0x13, position)
        except OutsideEnvelope:
            return  # told as not put back
        deadline_ns = bench.target.now_ns + round((seconds + 0.5) * 1e9)
        while bench.target.now_ns < deadline_ns:
            if bench.position() == position:
                bench.command(0x18)
                return
            bench.wait(0.1)
        bench.command(0x18)


# --- which frame may do what ---------------------------------------------------------------------

_CLASS_OF: Final[Mapping[str, tuple[int, ...]]] = {
    "stored": (0x02, 0x03, 0x09, 0x0A, 0x0C, 0x0D, 0x0E, 0x0F, 0x1C),
    "motion": (0x00, 0x10, 0x13, 0x14, 0x15, 0x16, 0x17, 0x18, 0x19, 0x1A, 0x1E),
    "destructive": (0x01, 0x08, 0x1B),
}


def _named(indices: tuple[int, ...]) -> str:
    return ", ".join(f"{codec.COMMAND_NAMES[index]} ({index:02X}h)" for index in indices)


STORING: Final = frozenset(_CLASS_OF["stored"] + _CLASS_OF["destructive"])
SAFETY_OF: Final = {index: name for name, indices in _CLASS_OF.items() for index in indices}


_DEED_OF: Final[Mapping[str, str]] = {
    "passive": "queries, and frames that a module refuses, Nacks or takes no notice of",
    "motion": "moves, stops, powers and re-initialises",
    "stored": "writes",
    "destructive": "factory values over all parameters, address, rate",
}
DEEDS: Final = {
    "rig": "inputs, supply, temperature and shaft are worked, the supply is cut",
    **{
        name: f"{words}: {told}" if (told := _named(_CLASS_OF.get(name, ()))) else words
        for name, words in _DEED_OF.items()
    },
}


def guard(session: Session, data: bytes) -> str | None:
    """Why these bytes must not be sent: an index of a class that the check did not declare."""
    if session.check is None:
        return None
    for index in _indices(data):
        needed = SAFETY_OF.get(index, "passive")
        if needed == "passive" or needed in session.check.safety:
            continue
        if needed != "destructive" and "destructive" in session.check.safety:
            continue
        assert needed in SAFETY_CLASSES
        return f"{index:02X}h is {needed}, which this check does not declare"
    return None


def fence(run: Run) -> Fence:
    """What keeps the axes of a line inside the envelope."""
    return Fence(run.envelope.max_travel, run.envelope.max_speed, run.address, run.readings)


@lru_cache(maxsize=1024)
def writes(data: bytes) -> int:
    """How many commands that write to the EEPROM these bytes hold."""
    return sum(index in STORING for index in _indices(data))


@lru_cache(maxsize=1024)  # the same frame is asked about three times on its way out
def _indices(data: bytes) -> tuple[int, ...]:
    """The index of every whole frame in these bytes, whatever its checksum."""
    found = []
    for at in range(len(data) - codec.REQUEST_BYTES + 1):
        if data[at : at + 4] != b"\x02014" or data[at + codec.REQUEST_BYTES - 1] != codec.ETX:
            continue
        digits = data[at + 6 : at + 8]
        if not digits.translate(None, b"0123456789ABCDEFabcdef"):
            found.append(int(digits, 16))
    return tuple(found)


def explain(record: Record) -> str:
    """Put what was said into words."""
    if record.direction is Direction.HOST:
        return codec.explain_request(record.data)
    return codec.explain(record.data)


def twin_url(model: str, address: int, neighbours: tuple[int, ...]) -> str:
    """The built-in twin, in virtual time, with its neighbours on one line."""
    devices = ",".join(f"{model}:{one}" for one in (address, *neighbours))
    return f"axistwin://{devices}?time=virtual"


FAMILY: Final = Family(
    name="mac_serial",
    ledger="mac_serial",
    models=MODELS,
    modules=tuple(
        f"axistwin_conformance.mac_serial.{name}"
        for name in (
            "checks_frames",
            "checks_replies",
            "checks_queries",
            "checks_parameters",
            "checks_acceptance",
            "checks_motion",
            "checks_velocity",
            "checks_interpolation",
            "checks_sync",
            "checks_stops",
            "checks_line",
            "checks_sequences",
            "checks_machines",
            "checks_rig_inputs",
            "checks_rig_faults",
            "checks_rig_load",
            "checks_rig_power",
            "checks_destructive",
        )
    ),
    addresses=range(0x80),
    default_address=0,
    default_baud=38400,
    bauds=BAUDS,
    probe=probe,
    sanity=sanity,
    stop=stop,
    remember=remember,
    restore=restore,
    explain=explain,
    twin_url=twin_url,
    guard=guard,
    fence=fence,
    writes=writes,
    replay_module="axistwin_conformance.mac_serial.checks_sequences",
    operation_bytes=4,
    deeds=DEEDS,
    blame=blame,
    probe_modules=tuple(
        f"axistwin_conformance.mac_serial.{name}"
        for name in (
            "probes",
            "probes_parameters",
            "probes_motion",
            "probes_sync",
            "probes_stops",
            "probes_rig",
            "probes_destructive",
        )
    ),
)
