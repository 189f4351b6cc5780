"""The machine behind the controller, worked by a rig: its flags, its conditions, its supply.

What the rig leaves at rest is what the controller was found in, but for a program that no power-up
starts: that is started again here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.base.errors import CannotDo
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import Observation
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.flags import NO_RFLAGS, judge_agreement
from axistwin_conformance.families.msc.checks.status import AUTO_START, RUNNING
from axistwin_conformance.families.msc.driver import ACKED, NAKED, SERVED, MscDriver
from axistwin_conformance.families.msc.program import REACTION_S
from axistwin_conformance.families.msc.scratch import SAFE_BLOCK

ORDER = 160  # of this module in a run; see `Family.modules`

CONDITIONS: Final = tuple(range(1, 16))  # bit 0 is the program itself
LOADING: Final = 10
SELF_TEST, BATTERY_LOW, UNRELIABLE, CLEARED = 128, 2, 4, 8
ERRORS: Final = 0xFF00
AN_ERROR: Final = 12
# Inputs, timers and motors, as twins number them; what a rig cannot work is left out.
MACHINE_FLAGS: Final = (0, 3, 7, 8, 15, 33, 39, 40, 45, 71)
LAST_FLAGS: Final = (248, 255)  # of the last byte of RFLAGS, whatever they stand for
STORING_S: Final = 0.5  # from the last ACK to the cut: the manual does not say when it is stored
START_S: Final = 10.0  # within which a unit is through with its self-test
SETTLED_S: Final = 0.1  # after which a scan has been
UNKNOWN_FLAGS: Final = "the rig works none of the flags that inputs, timers and motors often have"


def _power_cycle(driver: MscDriver) -> int:
    """Switch the supply off and on; the status once the unit serves and its self-test is over."""
    session = driver.session
    session.rig.work("power", False)
    driver.target.wait(0.5)
    session.rig.work("power", True)
    driver.target.drain()

    def is_up() -> bool:
        exchange = driver.ask(codec.RQSTAT, timeout_s=SETTLED_S * 2 + driver.target.line_s)
        reply = exchange.reply
        return reply is not None and bool(reply.numbers) and not reply.numbers[0] & SELF_TEST

    is_served = driver.until(is_up, START_S)
    session.step(is_served, f"RQSTAT served within {START_S:g} s of power-up", "it is not")
    driver.target.wait(SETTLED_S)
    return driver.status()


def _bit(status: int, bit: int) -> str:
    return f"bit {bit} {'on' if status >> bit & 1 else 'off'} (RQSTAT = {status:04X}h)"


def _restart(session: Session) -> None:
    """Have the program run as it did before, where the rig can start it."""
    if "program" in session.rig.capabilities:
        session.rig.work("program", True)


def _must_serve(driver: MscDriver) -> None:
    """Go on only if data are served: some devices refuse that while no program runs."""
    if driver.session.reading("stopped_access") == "nak" and not driver.status() & RUNNING:
        driver.session.skip("with its program stopped this device serves no data")


# --- the status word ------------------------------------------------------------------------------


@check("MSC-STA-02", "MSC-STA-03", safety="rig", needs=("rig:status",))
def each_condition_has_a_bit_of_its_own(session: Session) -> None:
    """A condition that comes turns its bit of the status word on, one that goes turns it off, and
    the others stay as they are."""
    driver = MscDriver(session)
    shown = 0
    for bit in CONDITIONS:
        try:
            session.rig.work("status", True, number=bit)
        except CannotDo as reason:
            session.note(f"bit {bit}: {reason}")
            continue
        exchange = driver.ask(codec.RQSTAT)
        if bit == LOADING and exchange.is_naked:
            driver.reading("loading_access", "nak", "MSC-STA-02")
        else:
            seen = exchange.reply.numbers[0] if exchange.reply else -1
            is_on = seen >= 0 and bool(seen >> bit & 1)
            text = f"bit {bit} on"
            session.expect(is_on, "MSC-STA-02", text, _bit(seen, bit) if seen >= 0 else exchange)
        session.rig.work("status", False, number=bit)
        driver.status()  # a device that clears what it has told has told it now
        gone = driver.status()
        session.expect(not gone >> bit & 1, "MSC-STA-02", f"bit {bit} off again", _bit(gone, bit))
        shown += 1
    if not shown:
        session.skip("the rig brings about none of the conditions")
    _judge_together(driver)


def _judge_together(driver: MscDriver) -> None:
    """Conditions at the same time show all their bits, and no other."""
    session = driver.session
    single = [bit for bit in CONDITIONS if bit not in (6, LOADING)]
    base = driver.status()
    for _ in range(3):
        wanted, bits = 0, session.random.sample(single, 4)
        for bit in bits:
            try:
                session.rig.work("status", True, number=bit)
                wanted |= 1 << bit
            except CannotDo as reason:
                session.note(f"bit {bit}: {reason}")
        seen = driver.status()
        text = f"{base | wanted:016b}"
        session.expect(seen == base | wanted, "MSC-STA-03", text, f"{seen:016b}")
        for bit in bits:
            if wanted >> bit & 1:
                session.rig.work("status", False, number=bit)


@check("MSC-STA-04", safety="rig", needs=("rig:status",))
def an_error_is_told_until_it_is_over(session: Session) -> None:
    """An error shows at each look, or at the first one alone, as this device reads it."""
    driver = MscDriver(session)
    session.rig.work("status", True, number=AN_ERROR)
    first, second, third = (driver.status() >> AN_ERROR & 1 for _ in range(3))
    session.expect(bool(first), None, f"bit {AN_ERROR} on", "off")
    session.expect(second == third, None, "on and on, or cleared and cleared", (second, third))
    driver.reading("status_latch", "level" if second else "clear_on_read")


@check("MSC-STA-01", "MSC-STA-02", safety="rig", needs=("rig:program",))
def bit_0_is_the_program(session: Session) -> None:
    """Stopping the macroprogram turns bit 0 off, starting it turns bit 0 on: 1, or 65 with auto
    start, which does not change with it."""
    driver = MscDriver(session)
    names = ("MSC-STA-01", "MSC-STA-02")
    is_auto = driver.status() & AUTO_START
    for _ in range(2):
        for is_on in (False, True):
            session.rig.work("program", is_on)
            so = driver.until(lambda: bool(driver.status() & RUNNING) is is_on, REACTION_S)  # noqa: B023 - called here
            text = f"bit 0 {'on' if is_on else 'off'}"
            status = driver.status()
            session.expect(so, names, text, _bit(status, 0))
            is_kept = status & AUTO_START == is_auto
            session.expect(is_kept, names, f"{text}, bit 6 as before", _bit(status, 6))
    if "status" in session.rig.capabilities:
        session.rig.work("status", True, number=6)
        seen = driver.status()
        both = RUNNING | AUTO_START
        came = f"{_bit(seen, 0)}, {_bit(seen, 6)}"
        session.expect(seen & both == both, "MSC-STA-01", "bit 0 on, bit 6 on", came)
        session.rig.work("program", False)
        driver.until(lambda: not driver.status() & RUNNING, REACTION_S)
        seen = driver.status()
        session.expect(bool(seen & AUTO_START), "MSC-STA-02", "bit 6 on as before", _bit(seen, 6))
        session.rig.work("program", True)
        session.rig.work("status", False, number=6)


@check("MSC-STA-01", "MSC-STA-02", safety="rig", needs=("rig:power", "rig:program"))
def auto_start_is_what_power_up_does(session: Session) -> None:
    """After power-up the program runs if bit 6 is on, and does not if it is off; in memory that
    is reliable no error is told then, and no program that runs as cleared."""
    driver = MscDriver(session)
    before = driver.status()
    try:
        for status in _power_ups(driver):
            is_running, is_auto = bool(status & RUNNING), bool(status & AUTO_START)
            text = f"bit 0 {'on' if is_auto else 'off'}, as bit 6 is"
            names, came = ("MSC-STA-01", "MSC-STA-02"), f"{_bit(status, 0)}, {_bit(status, 6)}"
            session.expect(is_running == is_auto, names, text, came)
            new = 0 if status & UNRELIABLE else status & ~before & ERRORS
            text = "no error of a load or of the program that was not there before"
            session.expect(not new, "MSC-STA-02", text, f"RQSTAT = {status:04X}h")
    finally:
        _restart(session)
    driver.until(lambda: bool(driver.status() & RUNNING), REACTION_S)
    after = driver.status()
    is_there = bool(after & RUNNING and not after & UNRELIABLE)
    is_told = is_there and bool(after & ~before & CLEARED)
    text = f"bit {CLEARED.bit_length() - 1} off: the program runs, and was not loaded"
    session.expect(not is_told, "MSC-STA-02", text, f"RQSTAT = {after:04X}h")


def _power_ups(driver: MscDriver) -> Iterator[int]:
    yield _power_cycle(driver)
    if "status" in driver.session.rig.capabilities:
        driver.session.rig.work("status", True, number=6)
        yield _power_cycle(driver)
        driver.session.rig.work("status", False, number=6)


@check("MSC-STA-02", "MSC-DREAD-02", safety=("stored", "rig"), needs=("rig:power", "variables"))
def memory_is_kept_or_said_not_to_be(session: Session) -> None:
    """Values written before a power cycle are there after it, or status bit 2 (RAM MEMORY NOT
    RELIABLE) is 1."""
    driver = MscDriver(session)
    slots = driver.scratch.slots(3)
    values = driver.values(3)
    for place, value in zip(slots, values, strict=True):
        driver.write(place, value)
    block = _block_beside(driver, slots)
    in_block = driver.values(codec.BLOCK_VALUES)
    if block is not None:
        driver.write_block(block, in_block)
    driver.target.wait(STORING_S)
    try:
        status = _power_cycle(driver)
    finally:
        _restart(session)
    _must_serve(driver)
    seen = [driver.read(place) for place in slots]
    is_shown = bool(status & UNRELIABLE)
    names = ("MSC-STA-02", "MSC-DREAD-02")
    places, held, written = (
        codec.listed(numbers).replace(" ", ", ") for numbers in (slots, seen, values)
    )
    told = Observation(
        f"after a power cycle, begun {STORING_S * 1000:.0f} ms after the last ACK (and a start of"
        " the macroprogram, without which some devices answer no DREAD),"
        f" the addresses {places} (DREAD), which are free by --variables, held {held}, and"
        f" status bit 2 (RAM MEMORY NOT RELIABLE) was {int(is_shown)} (RQSTAT = {status:04X}h)",
        value=str(seen),
        wanted=f"the values written before ({written}) or bit 2 = 1",
        rule="Status bit 2 tells that memory is not reliable: while it is 0, memory holds what was"
        " written, over a power cycle as well.",
        causes=(
            *(f"DWRITE {place} = " for place in slots),
            "RQSTAT",
            *(f"DREAD {place}" for place in slots),
        ),
    )
    session.expect(is_shown or seen == values, names, [values, "bit 2 on"], told)
    if block is not None and not is_shown:
        there, text = driver.read_block(block), codec.listed(in_block)
        session.expect(list(there) == in_block, names, [text, "bit 2 on"], codec.listed(there))


def _block_beside(driver: MscDriver, slots: Sequence[int]) -> int | None:
    """Where a whole block of named variables begins in which none of these is; None: nowhere."""
    for first in driver.scratch.spots(1 << 16):
        block = range(first, first + SAFE_BLOCK)
        if block[-1] in driver.scratch.variables and not set(block) & set(slots):
            return first
    return None


@check("MSC-STA-02", safety=("stored", "rig"), needs=("rig:power", "rig:battery", "variables"))
def without_its_battery_memory_is_not_reliable(session: Session) -> None:
    """An empty battery shows as bit 1, after a power cut as well, and then bit 2 is on, or nothing
    was lost; a good one does not show, then or after another cut."""
    driver = MscDriver(session)
    (place,), (value,) = driver.scratch.slots(1), driver.values(1)
    driver.write(place, value)
    try:
        session.rig.work("battery", True)
        is_shown = driver.until(lambda: bool(driver.status() & BATTERY_LOW), REACTION_S)
        session.expect(
            is_shown, None, "bit 1 on: an empty battery is a low one", _bit(driver.status(), 1)
        )
        status = _power_cycle(driver)
        is_shown = driver.until(lambda: bool(driver.status() & BATTERY_LOW), REACTION_S)
        session.expect(is_shown, None, "bit 1 on after power-up as well", _bit(driver.status(), 1))
        _restart(session)
        _must_serve(driver)
        seen = driver.read(place)
        is_shown = bool(status & UNRELIABLE)
        session.expect(is_shown or seen == value, None, ["bit 2 on", f"{value} kept"], seen)
    finally:
        session.rig.work("battery", False)
        if "status" in session.rig.capabilities:
            session.rig.work("status", False, number=2)
        _restart(session)
    gone = driver.status()
    session.expect(not gone & BATTERY_LOW, None, "bit 1 off with a good battery", _bit(gone, 1))
    try:
        gone = _power_cycle(driver)
    finally:
        _restart(session)
    session.expect(not gone & BATTERY_LOW, None, "bit 1 off with it after power-up", _bit(gone, 1))


# --- states ---------------------------------------------------------------------------------------

ACCESS: Final = ("MSC-STA-02", "MSC-DWRITE-02", "MSC-BWRITE-02", "MSC-RFLAG-01")


@check(*ACCESS, safety=("stored", "rig"), needs=("rig:program", "variables"))
def a_stopped_controller_still_serves(session: Session) -> None:
    """With the program stopped data and flags are served as ever, or refused, as this device reads
    it; the status is told in any case."""
    driver = MscDriver(session)
    session.rig.work("program", False)
    _judge_access(driver, "stopped_access")
    session.rig.work("program", True)


@check(
    "MSC-STA-02", "MSC-SFLAG-02", "MSC-CFLAG-02", safety=("stored", "rig"),
    needs=("rig:program", "flags"),
)  # fmt: skip
def a_stopped_controller_still_turns_flags(session: Session) -> None:
    """With the program stopped SFLAG and CFLAG turn flags as ever, or are refused, as this device
    reads it."""
    driver = MscDriver(session)
    session.rig.work("program", False)
    _judge_access(driver, "stopped_access", is_of_flags=True)
    session.rig.work("program", True)


@check(*ACCESS, safety=("stored", "rig"), needs=("rig:status", "variables"))
def a_controller_that_is_loaded_still_serves(session: Session) -> None:
    """While a program is loaded data and flags are served as ever, or refused, as this device reads
    it."""
    driver = MscDriver(session)
    session.rig.work("status", True, number=LOADING)
    _judge_access(driver, "loading_access")
    session.rig.work("status", False, number=LOADING)


def _judge_access(driver: MscDriver, switch: str, *, is_of_flags: bool = False) -> None:
    """Judge that data, or flags, are all served, or all refused."""
    for body, wanted, names in (_of_flags if is_of_flags else _of_variables)(driver):
        kind, exchange = driver.draws(driver.client.request(body))
        if kind == NAKED:
            driver.reading(switch, "nak", "MSC-STA-02")
            continue
        right = ACKED if codec.name_of(body) in codec.WRITES else SERVED
        driver.session.expect(kind == right, names, [right, NAKED], exchange)
        driver.reading(switch, "allow", "MSC-STA-02")
        if wanted:
            seen = exchange.reply.payload if exchange.reply else b""
            driver.session.expect(seen == wanted, names, wanted.hex(" "), exchange)


def _of_variables(driver: MscDriver) -> Iterator[tuple[bytes, bytes, str]]:
    """Commands in turn, each with what its reply must tell (empty: there is none, or anything), and
    what that judges."""
    (place,), (value,) = driver.scratch.slots(1), driver.values(1)
    yield codec.rflag(0), b"", "MSC-RFLAG-01"
    yield codec.dwrite(place, value), b"", "MSC-DWRITE-02"
    yield codec.dread(place), codec.i32(value), "MSC-DWRITE-02"
    if len(driver.scratch.variables) >= 2 * SAFE_BLOCK:
        (block,), values = driver.scratch.blocks(1), driver.values(codec.BLOCK_VALUES)
        yield codec.bwrite(block, values), b"", "MSC-BWRITE-02"
        yield codec.bread(block), b"".join(map(codec.i32, values)), "MSC-BWRITE-02"


def _of_flags(driver: MscDriver) -> Iterator[tuple[bytes, bytes, str]]:
    """The same of a flag."""
    (number,) = driver.scratch.some_flags(1)
    for on, name, command in ((1, "SFLAG", codec.sflag), (0, "CFLAG", codec.cflag)):
        yield command(number), b"", f"MSC-{name}-02"
        yield codec.rflag(number), codec.u16(on), f"MSC-{name}-02"


# --- flags of the machine -------------------------------------------------------------------------


@contextmanager
def _worked(session: Session, numbers: Sequence[int]) -> Iterator[list[int]]:
    """Have the machine turn those flags on that the rig can work; off again afterwards."""
    done = []
    try:
        for number in numbers:
            try:
                session.rig.work("flag", True, number=number)
                done.append(number)
            except CannotDo as reason:
                session.note(f"flag {number}: {reason}")
        yield done
    finally:
        for number in done:
            session.rig.work("flag", False, number=number)


@check("MSC-FLG-03", "MSC-RFLAG-01", "MSC-RFLAG-02", safety="rig", needs=("rig:flag",))
def a_flag_of_the_machine_follows_the_machine(session: Session) -> None:
    """An input, timer or motor flag that the machine turns on reads 1, and 0 once it turns it off;
    no other of them changes with it."""
    driver = MscDriver(session)
    names = ("MSC-FLG-03", "MSC-RFLAG-01", "MSC-RFLAG-02")
    shown = 0
    for number in MACHINE_FLAGS:
        before = {number: driver.flag(number) for number in MACHINE_FLAGS}
        with _worked(session, [number]) as done:
            if not done:
                continue
            driver.target.wait(SETTLED_S)
            seen = {number: driver.flag(number) for number in MACHINE_FLAGS}
            wanted = before | {number: True}
            wrong = [number for number in MACHINE_FLAGS if seen[number] != wanted[number]]
            session.expect(not wrong, names, f"flag {number} on, no other changed", wrong)
        driver.target.wait(SETTLED_S)
        session.expect(not driver.flag(number), names, f"flag {number} off again", "on")
        shown += 1
    if not shown:
        session.skip(UNKNOWN_FLAGS)


@check("MSC-PROP-11", "MSC-RFLAGS-02", "MSC-RFLAGS-03", safety="rig", needs=("rig:flag",))
def flags_of_the_machine_read_alike_both_ways(session: Session) -> None:
    """Flags that the machine turns on show at their place of RFLAGS, and by RFLAG alike."""
    driver = MscDriver(session)
    if not driver.has_rflags:
        session.skip(NO_RFLAGS)
    names = ("MSC-PROP-11", "MSC-RFLAGS-03")
    before = driver.flags_at_once()
    with _worked(session, sorted({*MACHINE_FLAGS, *LAST_FLAGS} - before)) as done:
        if not done:
            session.skip(UNKNOWN_FLAGS)
        driver.target.wait(SETTLED_S)
        seen = driver.flags_at_once()
        text = f"flags {done} on beside what was"
        is_so = set(done) <= seen and not before - seen
        session.expect(is_so, ("MSC-RFLAGS-02", *names), text, sorted(seen))
        judge_agreement(driver, (*range(96), *LAST_FLAGS), names)


@check("MSC-SFLAG-03", "MSC-CFLAG-03", "MSC-FLG-03", safety=("stored", "rig"), needs=("rig:flag",))
def the_host_cannot_turn_a_flag_of_the_machine(session: Session) -> None:
    """SFLAG and CFLAG of an input, timer or motor flag are ACKed without effect, or refused, or
    last until the next scan, as this device reads it; on a twin only."""
    driver = MscDriver(session)
    driver.link.only_on_a_twin()
    with _stopped(session):
        for number in MACHINE_FLAGS:
            _judge_host(driver, number)
        for number in MACHINE_FLAGS:  # once more: whatever it has done, the next scan ends it
            driver.draws(driver.client.request(codec.sflag(number)))
    driver.target.wait(SETTLED_S)
    for number in MACHINE_FLAGS:
        text = f"flag {number} off, as the machine has it"
        session.expect(not driver.flag(number), ("MSC-SFLAG-03", "MSC-FLG-03"), text, "on")


@contextmanager
def _stopped(session: Session) -> Iterator[None]:
    """Without the program, whose scans would end what lasts until the next one, where flags are
    served all the same."""
    is_worked = "program" in session.rig.capabilities
    is_worked = is_worked and session.reading("stopped_access") == "allow"
    if is_worked:
        session.rig.work("program", False)
    try:
        yield
    finally:
        if is_worked:
            session.rig.work("program", True)


def _judge_host(driver: MscDriver, number: int) -> None:
    """What SFLAG makes of a flag that the machine has off, and CFLAG of one that it has on."""
    for is_on, name, command in ((False, "SFLAG", codec.sflag), (True, "CFLAG", codec.cflag)):
        driver.session.rig.work("flag", is_on, number=number)
        kind, exchange = driver.draws(driver.client.request(command(number)))
        is_moved = driver.flag(number) != is_on
        # Where scans go on, one has been by the time RFLAG is served.
        readings = {
            (NAKED, False): ("nak",),
            (ACKED, False): ("ack_ignore", "force"),
            (ACKED, True): ("force",),
        }
        names = (f"MSC-{name}-03", "MSC-FLG-03")
        if (kind, is_moved) not in readings:
            text = [f"{ACKED}, and no effect", f"{NAKED}, and no effect"]
            driver.session.fail(names, text, f"{exchange}, flag {number} changed: {is_moved}")
        driver.reading("flag_write_readonly", readings[kind, is_moved], names)
    driver.session.rig.work("flag", False, number=number)
