"""The 256 flags: one by one, all at once, turned on and off (RFLAG, RFLAGS, SFLAG, CFLAG, FLG)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import FLAGS
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import Names

ORDER = 80  # of this module in a run; see `Family.modules`

STATES: Final = (b"\x00\x00", b"\x00\x01")
# The ends, both sides of a byte's border, and the signs of the protocol.
TELLING_FLAGS: Final = (0, 1, 2, 6, 7, 8, 15, 17, 19, 21, 44, 127, 128, 248, 254, 255)
LOOKS: Final = 3  # at a flag that may move
NO_RFLAGS: Final = "this model has no RFLAGS (MSC-MOD-02)"
PATTERNS: Final = 4
EVERY: Final = 4
BLOCK: Final = 0x1234


@check("MSC-RFLAG-01", "MSC-RFLAG-02", "MSC-FLG-01")
def a_flag_is_read_as_1_or_0(session: Session) -> None:
    """RFLAG of any number from 0 to 255 is served, by 00 01 or 00 00 and nothing else."""
    driver = MscDriver(session)
    for number in sorted({*TELLING_FLAGS, *session.random.sample(FLAGS, 16)}):
        names = ("MSC-RFLAG-01", "MSC-FLG-01")
        reply = driver.served(codec.rflag(number), names, f"the state of flag {number}")
        states = [state.hex(" ") for state in STATES]
        session.expect(
            reply.payload in STATES,
            "MSC-RFLAG-02",
            states,
            reply.payload.hex(" "),
            f"flag {number}",
        )


@check("MSC-RFLAGS-01", "MSC-FLG-01", "MSC-MOD-01")
def all_flags_come_in_one_reply(session: Session) -> None:
    """RFLAGS is served by 32 bytes, a bit for each flag."""
    driver = MscDriver(session)
    if not driver.has_rflags:
        session.skip(NO_RFLAGS)
    reply = driver.served(codec.RFLAGS, ("MSC-MOD-01", "MSC-RFLAGS-01"), "a reply")
    size = len(reply.payload)
    session.expect(size == 32, ("MSC-RFLAGS-01", "MSC-FLG-01"), "32 bytes", f"{size} bytes")


@check("MSC-PROP-11", "MSC-RFLAGS-03", level="full")
def each_flag_reads_alone_as_among_all(session: Session) -> None:
    """Every flag from 0 to 255 that stands still is the same by RFLAG and by RFLAGS."""
    driver = MscDriver(session)
    if not driver.has_rflags:
        session.skip(NO_RFLAGS)
    judge_agreement(driver, FLAGS, ("MSC-PROP-11", "MSC-RFLAGS-03"))


def judge_agreement(driver: MscDriver, numbers: Iterable[int], names: Names) -> None:
    """Hold single flags against all flags at once (PROP-11); what moves meanwhile is looked at
    again, and passed over if it does not stop."""
    numbers = list(numbers)
    for _ in range(LOOKS):
        before = driver.flags_at_once()
        alone = {number: driver.flag(number) for number in numbers}
        after = driver.flags_at_once()
        moved = [number for number in numbers if (number in before) != (number in after)]
        for number in numbers:
            if number in moved:
                continue
            text = "on" if number in before else "off"
            is_so = alone[number] == (number in before)
            seen = "on" if alone[number] else "off"
            driver.session.expect(is_so, names, f"flag {number} {text}, as RFLAGS says", seen)
        if not (numbers := moved):
            break


@check(
    "MSC-SFLAG-01", "MSC-SFLAG-02", "MSC-CFLAG-01", "MSC-CFLAG-02", "MSC-RFLAG-02",
    safety="stored", needs=("flags",),
)  # fmt: skip
def a_flag_is_on_from_sflag_to_cflag(session: Session) -> None:
    """SFLAG turns a user flag on, CFLAG off, twice the same as once; the flags around it and those
    one bit of the number away stay as they are."""
    driver = MscDriver(session)
    free = set(driver.scratch.flags)
    for number in driver.scratch.some_flags(4):
        near = {number - 1, number + 1, *(number ^ 1 << bit for bit in range(8))}
        others = sorted(near & free - {number})
        for other in others:
            driver.turn(other, on=session.random.random() < 0.5)
        before = {other: driver.flag(other) for other in others}
        for on in (True, True, False, False, True, False):
            command, verb = (codec.sflag, "SFLAG") if on else (codec.cflag, "CFLAG")
            exchange = driver.ask(command(number))
            session.expect(exchange.is_acked, f"MSC-{verb}-01", f"ACK to {verb} {number}", exchange)
            state = driver.query(codec.rflag(number)).payload
            text = STATES[on].hex(" ")
            names = (f"MSC-{verb}-02", "MSC-RFLAG-02")
            session.expect(state == STATES[on], names, f"{text} after {verb}", state.hex(" "))
            wrong = [other for other in others if driver.flag(other) != before[other]]
            text = f"no other flag than {number} changed"
            session.expect(not wrong, f"MSC-{verb}-02", text, f"flags {wrong} changed")
        for on, verb in ((False, "CFLAG"), (True, "SFLAG"), (False, "CFLAG")):
            # No block number marks a repeat.
            exchange = driver.ask(codec.sflag(number) if on else codec.cflag(number), BLOCK)
            session.expect(exchange.is_acked, f"MSC-{verb}-01", f"ACK to {verb} {number}", exchange)
        seen = driver.flag(number)
        session.expect(not seen, "MSC-CFLAG-02", f"flag {number} off, as told last", "on")


@check(
    "MSC-RFLAGS-02", "MSC-RFLAGS-03", "MSC-SFLAG-02", "MSC-CFLAG-02", safety="stored",
    needs=("flags",),
)  # fmt: skip
def flag_f_is_bit_f_mod_8_of_byte_f_div_8(session: Session) -> None:
    """One flag turned on changes that bit of RFLAGS' reply and no other of the named ones."""
    driver = MscDriver(session)
    if not driver.has_rflags:
        session.skip(NO_RFLAGS)
    free = frozenset(driver.scratch.flags)
    for number in sorted(free):
        driver.turn(number, on=False)
    seen = driver.flags_at_once() & free
    session.expect(not seen, "MSC-CFLAG-02", "all named flags off", sorted(seen))
    for number in driver.scratch.some_flags(10):
        driver.set_flag(number)
        states = driver.flags()
        assert states is not None, "asked only where the model has it"
        seen = codec.flags_on(states) & free
        names = ("MSC-RFLAGS-02", "MSC-RFLAGS-03", "MSC-SFLAG-02")
        text = f"bit {number % 8} of byte B{number // 8 + 1}, flag {number}, and no other"
        session.expect(seen == {number}, names, text, f"flags {sorted(seen)}: {states.hex()}")
        driver.clear_flag(number)


@check("MSC-PROP-13", "MSC-RFLAG-02", safety="stored", needs=("flags",))
def reads_change_no_flag(session: Session) -> None:
    """Flags that were turned on, some of each byte, are on however often each of the reading
    commands is carried out."""
    driver = MscDriver(session)
    free = driver.scratch.flags
    numbers = sorted({*free[::EVERY], free[-1]})
    for number in numbers:
        driver.set_flag(number)
    for _ in range(2):
        for body in driver.reads():
            driver.query(body)
    for look in (1, 2):
        off = [number for number in numbers if not driver.flag(number)]
        names = ("MSC-PROP-13", "MSC-RFLAG-02") if look > 1 else ("MSC-PROP-13",)
        session.expect(not off, names, f"on: {numbers}", f"off: {off}")


@check("MSC-PROP-11", "MSC-RFLAGS-02", "MSC-RFLAGS-03", safety="stored", needs=("flags",))
def patterns_of_flags_read_alike_both_ways(session: Session) -> None:
    """Patterns of user flags drawn at random come back by RFLAGS and by RFLAG."""
    driver = MscDriver(session)
    if not driver.has_rflags:
        session.skip(NO_RFLAGS)
    free = list(driver.scratch.flags)
    names = ("MSC-PROP-11", "MSC-RFLAGS-03")
    for _ in range(PATTERNS):
        pattern = {number for number in free if session.random.random() < 0.5}
        for number in free:
            driver.turn(number, on=number in pattern)
        seen = driver.flags_at_once() & set(free)
        text = f"on: {sorted(pattern)}"
        session.expect(seen == pattern, ("MSC-RFLAGS-02", *names), text, sorted(seen))
        judge_agreement(driver, session.random.sample(free, min(16, len(free))), names)
