"""What shows only from inside: blocks, flags and timers as the bench program sees them.

All of it is counted by the program (see the page on it); a unit in which it does not run is not
judged here.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.status import AUTO_START, LOADS
from axistwin_conformance.families.msc.checks.succession import LONG, SELF_TEST, Succession
from axistwin_conformance.families.msc.codec import ACK, BLOCK_VALUES, NAK
from axistwin_conformance.families.msc.program import REACTION_S, BenchProgram

ORDER = 140  # of this module in a run; see `Family.modules`

BLOCKS_SENT: Final = 24
PULSES: Final = 8
TIMER: Final = 32  # the one that `timed` starts
TIMER_S: Final = 0.25
SCANS_S: Final = 0.03  # after which the program has seen a flag
LATE_S: Final = 0.2  # what a real program and a real line may add to it


@check(
    "MSC-SFLAG-02", "MSC-DREAD-02", "MSC-PKT-14", "MSC-LNK-14", safety=("stored", "motion"),
    needs=("program",),
)  # fmt: skip
def the_program_sees_a_flag_and_the_host_its_count(session: Session) -> None:
    """A flag set once makes the program count once, however long nobody asks, and whatever sign of
    ours comes behind it; the host reads the count and finds the flag cleared."""
    program = BenchProgram(session)
    program.must_run()
    is_heeded = session.reading("stray_nak") != "ignore" or session.neighbours
    for sign in (b"", ACK, ACK if is_heeded else NAK):
        before = program.counter()
        program.driver.set_flag(program.count)
        program.driver.target.wait(TIMER_S)  # until the program has used the flag up
        if sign:
            program.driver.target.send(sign)
        program.taken(program.count, "MSC-SFLAG-02")
        program.driver.target.wait(5 * TIMER_S)
        seen = program.counter() - before
        names = ("MSC-SFLAG-02", "MSC-DREAD-02", "MSC-PKT-14")
        if sign:
            text = f"counted once, {codec.explain(sign)} of ours behind it"
            session.expect(seen <= 1, "MSC-LNK-14", text, f"{seen} times")
        session.expect(seen == 1, names, "counted once", f"{seen} times")


@check("MSC-BWRITE-06", safety=("stored", "motion"), needs=("program",))
def the_program_sees_a_block_whole(session: Session) -> None:
    """Blocks of 32 equal values, a new one each time: in no scan do the program's first and last
    value differ, unless this device stores them one by one."""
    program = BenchProgram(session)
    program.must_run()
    program.driver.write_block(program.block, [0] * BLOCK_VALUES)
    program.driver.target.wait(TIMER_S)
    before = program.torn()
    for number in range(1, BLOCKS_SENT + 1):
        program.driver.write_block(program.block, [number * 0x01010101] * BLOCK_VALUES)
        program.driver.target.wait(session.random.random() * 0.02)  # anywhere in a scan
    torn = program.torn() - before
    session.expect(torn >= 0, "MSC-BWRITE-06", "a count that does not fall", torn)
    seen = program.driver.read_block(program.block)
    is_last = set(seen) == {codec.signed(BLOCKS_SENT * 0x01010101)}
    session.expect(is_last, "MSC-BWRITE-06", "the last block as sent", seen)
    program.driver.reading("bwrite_atomic", "false" if torn else "true", "MSC-BWRITE-06")


@check("MSC-SFLAG-02", "MSC-CFLAG-02", safety=("stored", "motion"), needs=("program",))
def a_flag_set_and_cleared_at_once_is_seen_or_not(session: Session) -> None:
    """A flag turned on, and off right behind its ACK, counts once if the program looks meanwhile;
    never more often than that."""
    program = BenchProgram(session)
    program.must_run()
    program.driver.clear_flag(program.pulse)
    is_off = not program.driver.flag(program.pulse)
    session.expect(is_off, "MSC-CFLAG-02", f"flag {program.pulse} off", "on")
    program.driver.target.wait(TIMER_S)
    before, ticks, began_ns = program.pulses(), program.ticks(), program.driver.target.now_ns
    widths = []
    for _ in range(PULSES):
        on = program.driver.set_flag(program.pulse)
        off = program.driver.clear_flag(program.pulse)
        widths.append(off.signed_ns - on.signed_ns)
        program.driver.target.wait(TIMER_S * (1 + session.random.random()))  # anywhere in a scan
    seen = program.pulses() - before
    text = f"{PULSES} times at most"
    session.expect(0 <= seen <= PULSES, ("MSC-SFLAG-02", "MSC-CFLAG-02"), text, f"{seen} times")
    scans = max(program.ticks() - ticks, 1)
    is_rare = (program.driver.target.now_ns - began_ns) / scans > 2 * max(widths)
    # Where scans are short, each of them is seen in either reading.
    all_seen = ("immediate",) if is_rare else ("next_scan", "immediate")
    program.driver.reading(
        "write_visibility", all_seen if seen == PULSES else "next_scan", "MSC-SFLAG-02"
    )
    program.driver.set_flag(program.pulse)
    is_seen = program.until(lambda: program.pulses() - before == seen + 1)
    session.expect(
        is_seen,
        "MSC-SFLAG-02",
        f"a flag that stays on is seen within {REACTION_S:g} s",
        "it is not",
    )
    program.driver.clear_flag(program.pulse)
    session.expect(
        not program.driver.flag(program.pulse), "MSC-CFLAG-02", f"flag {program.pulse} off", "on"
    )


@check("MSC-LNK-21", "MSC-LNK-10", safety=("stored", "motion"), needs=("program",))
def a_repeat_carries_the_flags_of_the_first_reply(session: Session) -> None:
    """The replies to RFLAG and RFLAGS, refused when a timer has run out since, are repeated byte
    for byte, or with the states of now if this device reads it so."""
    program = BenchProgram(session)
    driver = program.driver
    if driver.client.ack_timeout_s < 2 * (TIMER_S + LATE_S):
        session.skip("T2 is too short: the reply comes again before the timer has run out")
    program.must_run()
    for body in (codec.rflag(TIMER), *([codec.RFLAGS] if driver.has_rflags else [])):
        driver.set_flag(program.timed)
        driver.target.wait(SCANS_S)
        first = driver.link.unanswered(body)
        driver.target.wait(TIMER_S + LATE_S)
        again = driver.link.refuse()
        driver.target.send(ACK)
        is_one = again is not None and again.is_sound and again.name == first.name
        session.expect(is_one, "MSC-LNK-10", f"{first} again", again or "nothing")
        if driver.query(body).body == first.body:
            session.not_run("MSC-LNK-21", "this line is too slow to see the timer run")
            return
        is_fresh = again is not None and again.raw != first.raw
        driver.reading("retransmit_content", "fresh" if is_fresh else "snapshot", "MSC-LNK-21")


@check("MSC-FLG-03", safety=("stored", "motion"), needs=("program",))
def a_timer_flag_follows_its_timer(session: Session) -> None:
    """The timer that the program starts for 250 ms is on for that long and off afterwards; or the
    other way round, as this device reads it."""
    program = BenchProgram(session)
    program.must_run()
    longest_s = 3 * session.target.uncertainty_ns / 1e9
    if session.target.is_virtual and longest_s > TIMER_S:  # elsewhere the line may get quicker
        session.skip(f"three exchanges take {longest_s:.1f} s here, the timer {TIMER_S:g} s")
    for _ in range(2):
        set_ns = program.driver.set_flag(program.timed).asked_ns
        program.taken(program.timed, "MSC-FLG-03")
        during = program.driver.flag(TIMER)
        program.driver.in_time(set_ns, TIMER_S, "the timer")
        program.driver.target.wait(TIMER_S + LATE_S)
        after = program.driver.flag(TIMER)
        text = ["on while it runs, then off", "off while it runs, then on"]
        seen = f"{_state(during)} while it runs, then {_state(after)}"
        session.expect(during != after, "MSC-FLG-03", text, seen)
        program.driver.reading("timer_flag", "running" if during else "expired", "MSC-FLG-03")


def _state(on: bool) -> str:
    return "on" if on else "off"


@check(
    "MSC-FLG-03", "MSC-LNK-01", "MSC-DREAD-02", "MSC-DWRITE-02", "MSC-BWRITE-02", "MSC-BREAD-03",
    "MSC-SFLAG-02", "MSC-CFLAG-02", "MSC-RFLAG-02", "MSC-STA-02", safety=("stored", "motion"),
    needs=("program", "flags"),
)  # fmt: skip
def each_command_works_while_a_timer_runs(session: Session) -> None:
    """While the timer runs that the program has started each of the nine commands does and tells
    what it does and tells at rest; and the timer runs on to its end."""
    program = BenchProgram(session)
    program.must_run()
    row = Succession(session)
    row.prepare()
    for name in (*row.reads, *row.writings, *row.writings):
        set_ns = program.driver.set_flag(program.timed).asked_ns
        session.target.wait(0 if name in LONG else SCANS_S)
        row.carry_out((name,))
        _judge_timer(program, set_ns, name)
    row.conclude()


def _judge_timer(program: BenchProgram, set_ns: int, name: str) -> None:
    """Judge that the timer runs that was started by a flag set then, and comes to its end."""
    driver = program.driver
    session, on = driver.session, driver.session.reading("timer_flag") == "running"

    def is_running() -> bool:
        return driver.flag(TIMER) == on

    # A program that takes its time has not begun it yet.
    is_so = (
        is_running() or driver.target.now_ns - set_ns > TIMER_S * 1e9 or program.until(is_running)
    )
    session.expect(is_so, "MSC-FLG-03", f"timer {TIMER} runs beside {name}", "it does not")
    is_over = program.until(lambda: not is_running())
    text = f"timer {TIMER} over within {REACTION_S:g} s"
    session.expect(is_over, "MSC-FLG-03", text, "it is not")


@check(
    "MSC-STA-01", "MSC-STA-02", safety=("stored", "motion", "rig"), needs=("program", "rig:program")
)
def a_program_that_ends_turns_bit_0_off(session: Session) -> None:
    """When the bench program stops itself bit 0 goes off and no bit beside it that tells of auto
    start, self-test or loads, nothing counts any more, and data and flags stay readable; started
    again, it counts on."""
    program = BenchProgram(session)
    program.must_run()
    before = program.driver.status()
    try:
        program.driver.set_flag(program.halt)
        names = ("MSC-STA-01", "MSC-STA-02")
        is_off = program.until(lambda: not program.driver.status() & 1)
        session.expect(is_off, names, f"bit 0 off within {REACTION_S:g} s of its end", "on")
        status = program.driver.status()
        is_kept = not (status ^ before) & (AUTO_START | SELF_TEST | LOADS)
        text = f"no other bit changed: {before & ~1:04X}h"
        session.expect(is_kept, "MSC-STA-02", text, f"RQSTAT = {status:04X}h")
        if session.reading("stopped_access") == "allow":
            session.expect(not program.is_running(), "MSC-STA-02", "nothing counts", "ticks go on")
    finally:
        session.rig.work("program", True)
    is_on = program.until(lambda: bool(program.driver.status() & 1))
    session.expect(is_on, "MSC-STA-01", "bit 0 on again", "off")
    session.expect(program.is_running(), "MSC-STA-01", "ticks go on", "nothing counts")
