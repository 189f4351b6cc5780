"""What the engine must know of a controller: who is there, whether it answers, what to remember of
it and put back.

Nothing is ever stopped: the suite starts nothing but the bench program's doings, and whoever
stopped a macroprogram would stop a machine.  What *is* ended is what a check has left on the line:
a packet cut short, a reply nobody has acknowledged.

Variables are remembered in blocks, and a block that has changed is written back whole: that is
right whatever the distance of neighbours is (MSC-AMB-18).  Only what a write has touched is looked
at.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from axistwin_conformance.base.errors import TargetError, WrongDevice
from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.base.transcript import last_exchange
from axistwin_conformance.core.contact import learn_delay
from axistwin_conformance.core.identity import Identity
from axistwin_conformance.core.session import REPLY_TIMEOUT_S, Run, Session, strictly
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.client import QUIET_S, MscExchange
from axistwin_conformance.families.msc.codec import ACK, NAK, Packet
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.options import PROGRAM_FLAGS, ScratchArea
from axistwin_conformance.families.msc.safety import Writing
from axistwin_conformance.families.msc.scratch import (
    PROGRAM_BLOCK,
    SAFE_BLOCK,
    SAFE_STRIDE,
    scratch_of,
)
from axistwin_conformance.transport.transport import is_twin_url

OTHER_QUESTIONS: Final = (codec.rflag(0), codec.dread(0), codec.RQSTAT)
ZEROS: Final = bytes(codec.MAX_PACKET)
MOST_TOLD: Final = 20  # of what a unit held, in a line
# For what comes late.  Who is about to answer is sent no zeros, of which each may draw a NAK, after
# as long again (MSC-AMB-30).
FIRST_LOOK_S: Final = 2.0
FACE_BYTES: Final = 16
UNBROKEN: Final = "ACK and a packet without gaps between its bytes"
MOST_OTHERS: Final = 8  # blocks that are read before one, to see whether it depends on that
UNEVEN_S: Final = 0.13
VALUE_ADDRESSES: Final = 4  # what one value takes up in the widest reading
WITH_RFLAGS: Final = "msc-250 or msc-850-32"
STATUS_WORDS: Final = (
    "program running",
    "battery low",
    "memory not reliable",
    "reset, program cleared",
    "system return met",
    "system fault met",
    "auto start",
    "self-test in progress",
    "error: loaded over a running program",
    "error: checksum",
    "program load in progress",
    "error: load out of sequence",
    "error: bad opcode",
    "error: stack overflow",
    "error: stack underflow",
    "error: interrupt table full",
)


# --- who is there ---------------------------------------------------------------------------------


def identify(session: Session) -> Identity:
    """Ask for the status, and for all flags where the model has them: nothing else on the wire
    tells one model from another."""
    driver = MscDriver(session)
    with strictly(session):  # the attempts are counted here
        since_ns = session.target.now_ns
        exchange = driver.ask(codec.RQSTAT)
        late = driver.client.listen(FIRST_LOOK_S) if exchange.is_silence else b""
        # Then it has heard a whole packet, and waits for the rest of none.
        is_taken = ACK in (exchange.raw, late[:1])
        if exchange.is_silence and not late:
            late = _late(driver)
        is_silent = exchange.is_silence and not late
        if not is_silent and not _is_answered(exchange, codec.RQSTAT):
            if late.strip(NAK) or exchange.raw == ACK:  # NAK: it had heard of somebody's packet
                _learn_delay(driver, since_ns, exchange, is_taken=is_taken)
            driver.client.wait_until_quiet(after=exchange)
            if not is_taken:
                _end_packet(driver)
            exchange = _insisted(driver, codec.RQSTAT)
        if is_silent or (exchange.reply is None and not sanity(session)):
            rates = session.run.family.rates
            rate = "" if session.target.baud in rates else f"--baud {rates[0]}, and "
            raise TargetError(
                f"no controller answers as unit {driver.unit} at {session.target.baud} baud:"
                f" {_describe_received(driver, exchange, late)}; try {rate}another --address"
                " (1 on RS-232, the switch on RS-485)"
            )
        _refuse_another_model(driver)
    words = exchange.reply.numbers if exchange.reply is not None else ()
    text = _status_in_words(words[0]) if words else "status unknown"
    values = {"status": f"{words[0]}" if words else "unknown"}
    return Identity(f"{session.run.model.title}, unit {driver.unit}, {text}", values)


def _status_in_words(status: int) -> str:
    named = [text for bit, text in enumerate(STATUS_WORDS) if status >> bit & 1]
    return f"status {status}: {', '.join(named) or 'no program running'}"


def _late(driver: MscDriver) -> bytes:
    """What comes of other questions where the first one drew nothing; empty: nobody is there."""
    for body in OTHER_QUESTIONS:
        received = _end_packet(driver) or driver.ask(body).raw
        if received:
            return received
    return b""


def _learn_delay(driver: MscDriver, since_ns: int, first: MscExchange, *, is_taken: bool) -> None:
    """See `learn_delay`.  `is_taken`: it has heard all of the first packet."""

    def is_answered() -> bool:
        return _is_answered(driver.ask(codec.RQSTAT), codec.RQSTAT)

    def wait_until_quiet(_: float) -> None:
        driver.client.wait_until_quiet(after=first)
        if not is_taken:
            _end_packet(driver)

    if is_taken:  # then its reply takes long, which nothing has waited for yet
        driver.client.wait_until_quiet()
    learn_delay(driver.session, since_ns, is_answered, wait_until_quiet)


def _end_packet(driver: MscDriver) -> bytes:
    """End what a unit may have heard of somebody's packet, and may wait for the rest of: how long,
    nobody has written.  What comes of it.

    As many zeros as the longest packet has bytes end any, and its sum is wrong: the number of the
    unit alone keeps it from being 0.  (One that lacked but its last byte, a 0, is carried out as
    who began it meant.)
    """
    client = driver.client
    client.send(ZEROS)
    return client.listen(len(ZEROS) * client.target.byte_ns / 1e9 + QUIET_S)


def _is_answered(exchange: MscExchange, body: bytes) -> bool:
    """True for a sound reply to this question, and not to an earlier one."""
    reply = exchange.reply
    return reply is not None and reply.is_sound and reply.name == codec.name_of(body)


def _insisted(driver: MscDriver, body: bytes) -> MscExchange:
    """Ask until there is a sound reply; longer if what comes differs, which is noise.  A reply that
    stops at the same byte each time, and goes on later, is none."""
    seen = set()
    halting = 0
    for number in range(1, RETRY.exchange + 1):
        exchange = driver.ask(body)
        seen.add(exchange.raw)
        if _is_answered(exchange, body):
            break
        if number >= RETRY.alike and len(seen) == 1:
            if halting >= RETRY.alike - 1:
                came = f"{codec.explain(exchange.raw)}, and the rest of it later"
                driver.session.run.violations.append(("MSC-PHY-01", UNBROKEN, came))
            break
        halting += _is_halting(exchange, driver.client.wait_until_quiet(after=exchange))
    return exchange


def _is_halting(exchange: MscExchange, rest: bytes) -> bool:
    """True if these bytes, which came too late for it, make the packet whole that had begun."""
    begun = exchange.extra
    size = codec.HEADER_BYTES + int.from_bytes(begun[2:4], "big") + codec.CHECKSUM_BYTES
    packet = codec.parse((begun + rest)[:size])
    is_begun = codec.HEADER_BYTES <= len(begun) < size and exchange.sign == ACK
    return is_begun and packet is not None and packet.is_sound


def _refuse_another_model(driver: MscDriver) -> None:
    """Raise WrongDevice for a controller that has RFLAGS where the model named has not, or the
    reverse (MSC-MOD-01).  The twin made for the run is what it is: the checks judge that."""
    session = driver.session
    name, run = session.run.model.name, session.run
    if session.target.is_builtin:
        return
    if not driver.has_rflags and "rig" not in run.allowed and not _is_twin(run):
        return  # to that model it is an unknown name, and nothing to try on a machine
    exchange = _insisted(driver, codec.RFLAGS)
    reply = exchange.reply
    has_it = reply is not None and reply.is_sound and len(reply.raw) == codec.REPLY_BYTES["RFLAGS"]
    has_none = exchange.is_naked or exchange.raw == ACK
    if driver.has_rflags and has_none:
        raise WrongDevice(f"not an {name}: it refuses RFLAGS; try msc-850 or msc-generic")
    if not driver.has_rflags and has_it:
        raise WrongDevice(f"not an {name}: it has RFLAGS; try {WITH_RFLAGS}")


def _is_twin(run: Run) -> bool:
    return is_twin_url(run.target.description)


def _describe_received(driver: MscDriver, exchange: MscExchange, late: bytes) -> str:
    """What came instead of an answer, with what follows it: another protocol shows its face."""
    if exchange.is_silence:
        if not late:
            return "nothing comes"
        return f"{codec.explain(late)} comes, but later than {REPLY_TIMEOUT_S} s, or now and then"
    if not exchange.extra:
        return str(exchange)
    raw = exchange.raw + driver.target.receive(FACE_BYTES, QUIET_S)
    text = "".join(chr(byte) if 0x20 <= byte < 0x7F else "." for byte in raw)
    return f"something else talks there: {raw.hex(' ').upper()} ({text})"


# --- between checks -------------------------------------------------------------------------------


def sanity(session: Session) -> bool:
    """One good answer; to another question if the unit answers the first one wrongly.  What it has
    answered wrongly before, it is asked last."""
    driver = MscDriver(session)
    questions, wrong = (codec.RQSTAT, codec.rflag(0), codec.dread(0)), session.run.answered_wrongly
    stop(session)
    with strictly(session, is_strict=session.is_strict):
        for body in sorted(questions, key=wrong.__contains__):
            exchange = driver.ask(body)
            if driver.client.is_right(exchange, codec.name_of(body)):
                wrong.discard(body)
                return True
            wrong.add(body)
            driver.client.wait_until_quiet(after=exchange)
            session.is_strict = True  # the first one was asked often enough for noise
    return False


def stop(session: Session) -> None:
    """End what is still open on the line; nothing of the machine."""
    last = codec.parse(session.target.last_sent)
    is_over = session.target.last_sent in (b"", ACK) or (
        last is not None and last.is_request and last.name in codec.WRITES
    )
    if not is_over:
        request, said = last_exchange(session.records())
        MscDriver(session).client.wait_until_quiet(
            after=MscExchange(request, said) if request else None
        )


# --- what to put back -----------------------------------------------------------------------------


@dataclass(slots=True)
class UnitContents:
    """What one unit held: blocks and single values by their address, flags by their number."""

    blocks: dict[int, tuple[int, ...]] = field(default_factory=dict)
    values: dict[int, int] = field(default_factory=dict)
    flags: dict[int, bool] = field(default_factory=dict)
    refused: set[int] = field(default_factory=set)  # blocks and values that were not told
    refused_flags: set[int] = field(default_factory=set)


@dataclass(slots=True)
class MscSnapshot:
    """What all units of the line held of what checks may change, and what has been written since.

    `only_off`: flags that are put back only to off; turned on, they are orders to the program.
    """

    units: Mapping[int, UnitContents]
    only_off: range
    touched: set[Writing] = field(default_factory=set)

    def as_object(self) -> dict[str, Any]:
        """The same as a file keeps it."""
        units = {
            str(unit): {"blocks": held.blocks, "values": held.values, "flags": held.flags}
            for unit, held in self.units.items()
        }
        return {"units": units, "only_off": [self.only_off.start, self.only_off.stop]}

    @classmethod
    def from_object(cls, kept: Mapping[str, Any]) -> MscSnapshot:
        """All of it to be put back; raises ValueError, KeyError or TypeError for what is none."""
        units, touched = {}, set[Writing]()
        for unit, one in kept["units"].items():
            held = UnitContents(
                {int(at): tuple(map(int, row)) for at, row in one["blocks"].items()},
                {int(at): int(value) for at, value in one["values"].items()},
                {int(number): bool(is_on) for number, is_on in one["flags"].items()},
            )
            touched |= {Writing("BWRITE", at) for at in held.blocks}
            touched |= {Writing("DWRITE", at) for at in held.values}
            touched |= {Writing("SFLAG", number) for number in held.flags}
            units[int(unit)] = held
        first, end = kept["only_off"]
        return cls(units, range(first, end), touched)

    def __str__(self) -> str:
        text = []
        for unit, held in self.units.items():
            blocks, values, flags = _touched_in(self.touched, held)
            where = f"unit {unit}"
            text += [f"{where} at {at}: {', '.join(map(str, held.blocks[at]))}" for at in blocks]
            text += [f"{where} at {at}: {held.values[at]}" for at in values]
            text += [
                f"{where} flag {number}: {'on' if held.flags[number] else 'off'}"
                for number in flags
            ]
        more = f"; and {len(text) - MOST_TOLD} more" if len(text) > MOST_TOLD else ""
        return "; ".join(text[:MOST_TOLD]) + more or "what it holds"


def remember(session: Session) -> MscSnapshot:
    """Read the variables and flags the operator has named, and the bench program's.

    Raises TargetError if the unit does not tell them, or if a program uses them.
    """
    run = session.run
    stride = int(run.readings.get("data_address_stride", 1))
    scratch = scratch_of(session)
    spans, flags, orders = [scratch.variables], [*scratch.flags], range(0)
    if scratch.program is not None:
        flag, address = scratch.program
        spans.append(range(address + PROGRAM_BLOCK.start, address + PROGRAM_BLOCK.stop))
        orders = range(flag, flag + PROGRAM_FLAGS)
    units = {session.address: _held(MscDriver(session), spans, [*flags, *orders], stride)}
    run.settings = _readable(session, units[session.address])
    if not session.target.is_builtin:
        _refuse_what_moves(MscDriver(session), units[session.address], scratch.flags)
    for unit in session.neighbours:
        with contextlib.suppress(TargetError):  # who does not answer is not there
            units[unit] = _held(MscDriver(session, unit), spans, [*flags, *orders], stride)
    return MscSnapshot(units, orders)


def _held(
    driver: MscDriver, spans: Iterable[range], flags: Iterable[int], stride: int
) -> UnitContents:
    held = UnitContents()
    for span in spans:
        blocks, values = layout(span, stride)
        told = {at: _read(driver, codec.bread(at)) for at in blocks}
        held.blocks |= {at: reply.values for at, reply in told.items() if reply is not None}
        single = {at: _read(driver, codec.dread(at)) for at in values}
        held.values |= {at: reply.values[0] for at, reply in single.items() if reply is not None}
        refused = [at for at, reply in (told | single).items() if reply is None]
        if refused and len(refused) == len(blocks) + len(values):
            driver.read(refused[0])  # of a stretch that is not there, nobody is to blame
        held.refused |= {*refused}
    states = _flags(driver, list(flags))
    held.flags = {number: is_on for number, is_on in states.items() if is_on is not None}
    held.refused_flags = states.keys() - held.flags.keys()
    return held


def _read(driver: MscDriver, body: bytes) -> Packet | None:
    """The reply to a read; None if the unit refuses it."""
    exchange = driver.ask(body)
    if exchange.is_naked:
        return None
    is_right = driver.client.is_right(exchange, codec.name_of(body))
    return exchange.reply if is_right else driver.query(body)


def _readable(session: Session, held: UnitContents) -> ScratchArea:
    """What was named, as far as it could be read: what cannot be put back is not to be touched.

    An address that is refused between others that are served is the unit's failure.
    """
    scratch = scratch_of(session)
    wanted = [f"ACK and what is at {at}, between others" for at in sorted(held.refused)]
    wanted += [f"ACK and the state of flag {number}" for number in sorted(held.refused_flags)]
    session.run.violations += [("MSC-LNK-01", one, "NAK") for one in wanted]
    of_program, its_flags = scratch.of_program
    is_broken = held.refused.intersection(of_program) or held.refused_flags.intersection(its_flags)
    unread = [place for at in held.refused for place in range(at, at + SAFE_BLOCK)]
    return replace(
        scratch,
        variables=_longest(scratch.variables, unread),
        flags=_longest(scratch.flags, held.refused_flags),
        program=None if is_broken else scratch.program,
    )


def _longest(span: range, without: Iterable[int]) -> range:
    """The longest part of a span that has none of these."""
    ends = sorted({span.start - 1, *(one for one in without if one in span), span.stop})
    parts = (range(first + 1, last) for first, last in itertools.pairwise(ends))
    return max(parts, key=len, default=span)


def _refuse_what_moves(driver: MscDriver, held: UnitContents, flags: range) -> None:
    """Raise TargetError for what changes while nobody writes it: it is a program's, and what was
    written there might work the machine."""
    said = "; name only what no program uses"
    first = min(held.blocks, default=0)
    for at in (address for address in held.blocks if (address - first) % SAFE_BLOCK == 0):
        pairs = zip(held.blocks[at], driver.read_block(at), strict=True)
        changed = [number for number, (before, now) in enumerate(pairs) if before != now]
        if changed and (broken := _broken_by_blocks(driver, held, at, changed[0])):
            driver.session.run.violations.append(broken)
            raise TargetError(f"which values are behind address {at} depends on what is read")
        if changed:
            raise TargetError(f"a value behind address {at} changes by itself (--variables){said}")
    for at, value in held.values.items():
        if driver.read(at) != value:
            raise TargetError(f"the value at {at} changes by itself (--variables){said}")
    told = [number for number in flags if number in held.flags]
    for number, is_on in _flags(driver, told).items():
        if is_on != held.flags[number]:
            raise TargetError(f"flag {number} changes by itself (--flags){said}")


def _broken_by_blocks(
    driver: MscDriver, held: UnitContents, at: int, number: int
) -> tuple[str, str, str] | None:
    """What the unit fails by a value of a block, counted from 0, that depends on which block was
    read before, time after time; None if it changes by itself."""
    for other in [*held.blocks][:MOST_OTHERS]:
        seen: set[tuple[int, int]] = set()
        for turn in range(driver.session.run.quality.alike_needed):
            driver.target.wait(turn * UNEVEN_S)  # what changes by itself keeps no step with this
            told = [driver.read_block(place)[number] for place in (other, other, at, at)]
            first, second = told[2:]
            seen.add((first, second))
            if len(seen) > 1 or first == second:
                break
        else:
            wanted = f"V{number + 1} = {second} of BREAD {at}, as when it is read once more"
            return "MSC-BREAD-03", wanted, f"{first} right behind BREAD {other}"
    return None


def layout(span: range, stride: int) -> tuple[range, range]:
    """The addresses of blocks, and of single values behind them, that together hold a range.

    Blocks are as close as `stride` asks for, the closest distance that neighbours may have, and
    end inside the range at any distance.
    """
    first = -(-span.start // SAFE_STRIDE) * SAFE_STRIDE
    step = codec.BLOCK_VALUES * stride
    blocks = range(first, span.stop - SAFE_BLOCK + 1, step)
    rest = blocks[-1] + step if blocks else first
    return blocks, range(rest, span.stop, SAFE_STRIDE)


def _flags(driver: MscDriver, numbers: list[int]) -> dict[int, bool | None]:
    """The states of flags, all in one reply where the model has that; None: refused."""
    all_told = _read(driver, codec.RFLAGS) if numbers and driver.has_rflags else None
    if all_told is not None:
        on = codec.flags_on(all_told.payload)
        return {number: number in on for number in numbers}
    if numbers and driver.has_rflags:
        driver.session.run.violations.append(("MSC-MOD-01", "ACK and all flags", "NAK"))
    return {number: _flag(driver, number) for number in numbers}


def _flag(driver: MscDriver, number: int) -> bool | None:
    reply = _read(driver, codec.rflag(number))
    if reply is None:
        return None
    driver.session.step(reply.numbers[0] in (0, 1), "0 or 1", reply.numbers[0])
    return bool(reply.numbers[0])


def _state(driver: MscDriver, number: int) -> bool:
    """The state of a flag that was told before.  Who tells it among all, and refuses it alone, has
    no reading of the manual for that."""
    told = _flag(driver, number)
    if told is not None:
        return told
    all_told = _read(driver, codec.RFLAGS) if driver.has_rflags else None
    if all_told is None:
        return driver.flag(number)
    if driver.unit == driver.session.address:
        wanted = f"ACK and the state of flag {number}, as among all"
        driver.session.run.violations.append(("MSC-LNK-01", wanted, "NAK"))
    return number in codec.flags_on(all_told.payload)


def restore(session: Session, memory: MscSnapshot) -> tuple[str, ...]:
    """Write back what has been written and differs; return a sentence for each that still does."""
    touched = frozenset(memory.touched)
    if not touched:
        return ()
    left: list[str] = []
    lost: list[TargetError] = []
    # The unit under test comes last: who fails at this is blamed for the last thing that was said.
    for unit in sorted(memory.units, key=lambda unit: unit == session.address):
        held = memory.units[unit]
        where = "" if unit == session.address else f"of unit {unit} "
        try:
            left += [where + text for text in _write_back(MscDriver(session, unit), memory, held)]
        except TargetError as error:  # the others may still answer
            lost.append(error)
    if lost:
        raise lost[0]
    memory.touched.clear()
    return tuple(left)


def _write_back(driver: MscDriver, memory: MscSnapshot, held: UnitContents) -> list[str]:
    """Write back until all is as it was, some times at most; tell what is not."""
    blocks, values, flags = _touched_in(memory.touched, held)
    differs: list[str] = []
    for _ in range(RETRY.recovery):
        differs = []
        for at in blocks:
            if (block := driver.read_block(at)) != held.blocks[at]:
                differs += [
                    f"value {number} of the block at {at} is {now}, was {was}"
                    for number, (now, was) in enumerate(zip(block, held.blocks[at], strict=True))
                    if now != was
                ]
                driver.ask(codec.bwrite(at, held.blocks[at]))
        for at in values:
            if (value := driver.read(at)) != held.values[at]:
                differs.append(f"the value at {at} is {value}, was {held.values[at]}")
                driver.ask(codec.dwrite(at, held.values[at]))
        for number in flags:
            was = held.flags[number]
            if _state(driver, number) != was and not (was and number in memory.only_off):
                is_now, before = ("off", "on") if was else ("on", "off")
                differs.append(f"flag {number} is {is_now}, was {before}")
                driver.ask((codec.sflag if was else codec.cflag)(number))
        if not differs:
            break
    return differs


def _touched_in(
    written: Iterable[Writing], held: UnitContents
) -> tuple[list[int], list[int], list[int]]:
    """The blocks, values and flags that these writes can have changed."""
    blocks, values, flags = set(), set(), set()
    for writing in written:
        if writing.is_of_flag:
            flags |= {writing.number} & held.flags.keys()
            continue
        extent = SAFE_BLOCK if writing.name == "BWRITE" else VALUE_ADDRESSES
        first, end = writing.number, writing.number + extent
        blocks |= {at for at in held.blocks if at < end and first < at + SAFE_BLOCK}
        values |= {at for at in held.values if at < end and first < at + VALUE_ADDRESSES}
    return sorted(blocks), sorted(values), sorted(flags)
