"""What a module says when something is done to it: supply, temperature, reset input (BOOT, EMCY,
STATE-02).

A rig's act happens in a window, of no width for the twin's.  Where it is wide, nothing can be said
of the milliseconds, and nothing is judged of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.motion import QUIET_S
from axistwin_conformance.families.mac.axis.driver.rig import OFF_S, WORKED
from axistwin_conformance.families.mac.axis.exchanges import Kind
from axistwin_conformance.families.mac.axis.model.forecast import Window
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.checks.messages import (
    AFTERWARDS_S,
    await_boot_up,
    beat,
    is_free,
    judge_due,
    judge_form,
    judge_time,
    restart,
    silenced,
)
from axistwin_conformance.families.mac.can.collect_replies import replies, slack_ns, told, unasked
from axistwin_conformance.families.mac.can.driver import Bench, RigBench
from axistwin_conformance.families.mac.can.probes.errors import BEGIN, CUT, HOT, OVER, UNDER
from axistwin_conformance.families.mac.can.probes.messages import LIFEBEAT_S, said
from axistwin_conformance.transport.can import Arrival
from axistwin_conformance.transport.rig import Rig

ORDER = 280  # of this module in a run; see `Family.modules`

SHOWS_S: Final = 0.2
RIG_PATIENCE_S: Final = 10.0  # a real temperature rises slowly, and the rig may not tell when
HELD_S: Final = 2.5 * LIFEBEAT_S  # long enough for lifebeats, were there any
OVER_S: Final = 5.0  # for a boot that nobody has ended
SILENT: Final = "it sends no such message"
ERRORS: Final = HOT | CUT | OVER | UNDER
LATCHED: Final = HOT | CUT
ALL_FAULTS: Final = ("rig:supply", "rig:temperature", "rig:micro_cut")


# --- boot-up -------------------------------------------------------------------------------------


@check("MACC-BOOT-01", "MACC-BOOT-02", "MACC-BOOT-04", safety=WORKED, needs=("rig:power",))
def at_power_up_it_says_so_once(session: Session) -> None:
    """Without supply there is silence; two seconds after power-up one boot-up message comes, and
    with it service."""
    bench = RigBench(session)
    bench.begin()
    bench.rig.power_off()
    bench.wait(OFF_S)
    bench.target.take_spontaneous()
    heard = replies(bench, bench.request(0x20).frame(), is_awaited=False)
    session.expect(not heard, "MACC-BOOT-04", "silence without supply", told(heard))
    on = Window(*bench.rig.power_on())
    if bench.rig.is_exact:
        heard = replies(bench, bench.request(0x20).frame(), is_awaited=False)
        session.expect(not heard, "MACC-BOOT-04", "silence before the boot-up", told(heard))
    _judge_boot(bench, on)
    bench.alive("MACC-BOOT-04")
    _judge_once(bench)


def _judge_boot(bench: RigBench, act: Window) -> None:
    """Judge that a boot-up message follows that act, in its form and time, and nothing before."""
    session = bench.session
    boot_up, before = await_boot_up(bench)
    session.expect(boot_up is not None, "MACC-BOOT-01", "a boot-up message", "none")
    assert boot_up is not None
    session.expect(
        not before, "MACC-BOOT-01", "nothing before it", [str(one.frame) for one in before]
    )
    judge_form(bench, boot_up)
    if bench.rig.is_exact:
        judge_time(bench, act, boot_up, "MACC-BOOT-04")


def _judge_once(bench: RigBench) -> None:
    """Judge that no other boot-up message follows the one that came."""
    again = unasked(bench, AFTERWARDS_S, lambda frame: codec.boot_up_form(frame) is not None)
    bench.session.expect(
        not again, "MACC-BOOT-01", "one boot-up message", f"{1 + len(again)} of them"
    )


@check("MACC-STATE-02", "MACC-BOOT-01", "MACC-BOOT-02", "MACC-BOOT-04",
       safety=WORKED, needs=("rig:reset",))  # fmt: skip
def held_in_reset_it_says_nothing(session: Session) -> None:
    """While the reset input is held there is no reply and no lifebeat; released, the module boots
    like after a reset and says so once."""
    bench = RigBench(session)
    bench.begin()
    bench.target.take_spontaneous()
    bench.rig.set_input("reset", True)
    until_ns = bench.target.now_ns + round(HELD_S * 1e9)
    while bench.target.now_ns < until_ns:
        for frame in (bench.request(0x20).frame(), bench.request(0x00).frame(), codec.sync()):
            heard = replies(bench, frame, is_awaited=False)
            session.expect(not heard, "MACC-STATE-02", "silence while held", told(heard))
        bench.wait(LIFEBEAT_S / 4)
    spoken = unasked(bench, QUIET_S)
    session.expect(not spoken, "MACC-STATE-02", "not a message", [str(one.frame) for one in spoken])
    _judge_boot(bench, Window(*bench.rig.set_input("reset", False)))
    if not bench.rig.is_exact:
        session.not_run("MACC-BOOT-04", "nobody knows when exactly the input was released")
    bench.alive("MACC-STATE-02")
    _judge_once(bench)


@check("MACC-STATE-02", "MACC-BOOT-01", "MACC-BOOT-02", "MACC-BOOT-04",
       safety=WORKED, needs=("rig:reset",))  # fmt: skip
def a_boot_that_the_reset_input_ends_begins_anew(session: Session) -> None:
    """Held in reset amid its start-up a module stays deaf and silent; released it says once, after
    its whole time, that it is there."""
    bench = RigBench(session)
    if not bench.rig.is_exact or bench.deaf_s < 1:
        session.skip("the rig has to act while the module starts")
    bench.begin()
    bench.within(QUIET_S, 0x00)
    bench.wait(bench.deaf_s / 2)
    bench.target.take_spontaneous()
    bench.rig.set_input("reset", True)
    spoken = unasked(bench, OVER_S)
    session.expect(not spoken, "MACC-STATE-02", "no message", [str(one.frame) for one in spoken])
    heard = replies(bench, bench.request(0x20).frame(), is_awaited=False)
    session.expect(not heard, "MACC-STATE-02", "silence while held", told(heard))
    _judge_boot(bench, Window(*bench.rig.set_input("reset", False)))
    bench.alive("MACC-BOOT-04")
    _judge_once(bench)


# --- emergency -----------------------------------------------------------------------------------


def code_table(session: Session) -> tuple[tuple[int, int, int], ...]:
    """Bits of dd, code and register by priority, in the reading of this device (MACC-AMB-05)."""
    held = session.reading("emcy_code_map")
    if held == session.run.ledger.ambiguity_of("emcy_code_map").default_of("emcy_code_map"):
        return codec.ERROR_CODES
    rows = [tuple(int(part, 16) for part in one.split("/")) for one in held.split(",")]
    return tuple((bits, code, register) for bits, code, register in rows)


def payload_of(session: Session, status: bytes) -> tuple[bytes, ...]:
    """What a message may carry that is sent while 2001h reads `status`."""
    error = next((row[1:] for row in code_table(session) if status[0] & row[0]), (0, 0))
    head = error[0].to_bytes(2, "little") + bytes([error[1]])
    shapes = {
        "cia301_status": head + status,
        "status_first": status,
        "code_only": head,
    }
    held = session.readings.get("emcy_payload")
    chosen = shapes if held is None else {held: shapes[held]}
    return tuple(one.ljust(codec.EMERGENCY_BYTES, b"\0") for one in chosen.values())


def change(bench: RigBench, act: Callable[[Rig], object]) -> tuple[list[Arrival], Window]:
    """Let the rig do something; what the module says of it, and when it was done."""
    bench.ask(0x20)  # no lifebeat is due for a while
    bench.target.take_spontaneous()
    before_ns = bench.target.now_ns
    act(bench.rig)
    done = Window(before_ns, bench.target.now_ns)
    messages = said(bench, SHOWS_S)
    if not messages and not bench.rig.is_exact:
        first = bench.emergency(RIG_PATIENCE_S - SHOWS_S)
        messages = [first] if first is not None else []
    return messages, done


def judge_change(
    bench: RigBench, wanted: int, messages: list[Arrival], done: Window, what: str
) -> None:
    """Judge that one message tells of a change of dd, at once, with the status it has led to."""
    session = bench.session
    status = bytes(bench.data_bytes(0x21))
    if status[0] & ERRORS != wanted:
        session.inconclusive(
            None, f"{what}: 2001h shows dd {status[0]:02X} instead of {wanted:02X}"
        )
    frames = " ".join(str(one.frame) for one in messages) or "none"
    session.expect(len(messages) == 1, "MACC-EMCY-02", f"one message: {what}", frames)
    payloads = payload_of(session, status)
    session.expect(
        messages[0].frame.data in payloads, "MACC-EMCY-04",
        [one.hex(" ").upper() for one in payloads], frames,
    )  # fmt: skip
    if wanted:
        session.quirk("MACC-EMCY-04", "emcy_code_map", session.reading("emcy_code_map"))
    if bench.rig.is_exact:
        late_ns = messages[0].time_ns - done.latest_ns
        session.expect(
            late_ns <= slack_ns(bench, 0), "MACC-EMCY-02", "at once", f"{late_ns / 1e6:.3f} ms"
        )


def _cleared(bench: RigBench) -> None:
    """The rig at rest, and what it has left behind acknowledged."""
    bench.rig.reset()
    bench.wait(SHOWS_S)
    bench.reinitialise()


def _judge_cause(bench: RigBench, bit: int) -> None:
    """An error that comes is told; the lifebeat repeats it; that it goes is told as well."""
    session, name = bench.session, f"dd.{bit.bit_length() - 1}"
    messages, done = change(bench, BEGIN[bit])
    judge_change(bench, bit, messages, done, f"{name} has come")
    if is_free(bench):
        session.not_run("MACC-EMCY-01", "its lifebeat runs freely")
    else:
        repeated = beat(bench)
        names = ("MACC-EMCY-01", "MACC-EMCY-04")
        session.expect(repeated is not None, names, "the same again after 10 s", "nothing")
        assert repeated is not None
        session.expect(
            repeated.frame == messages[0].frame, "MACC-EMCY-04", messages[0].frame, repeated.frame
        )
    if bit & LATCHED:
        return
    messages, done = change(bench, lambda rig: rig.reset())
    on_clear = 0 if messages else 1
    bench.reading("emcy_on_clear", on_clear, "MACC-EMCY-02")
    if messages:
        judge_change(bench, 0, messages, done, f"{name} has gone")


def _judge_causes(session: Session, *bits: int) -> None:
    """What is said of each of these errors: by a module without a lifebeat, nothing."""
    bench = RigBench(session)
    bench.begin()
    for bit in bits:
        try:
            if silenced(bench):
                _judge_unspoken(bench, bit)
            else:
                _judge_cause(bench, bit)
        finally:
            _cleared(bench)


def _judge_unspoken(bench: RigBench, bit: int) -> None:
    """A module that sends the message never (MACC-AMB-05) is silent about an error as well: one
    that speaks of it had to speak every ten seconds, too."""
    messages, _ = change(bench, BEGIN[bit])
    messages += change(bench, lambda rig: rig.reset())[0]
    frames = " ".join(str(one.frame) for one in messages)
    bench.reading("emcy_payload", f"no lifebeat, but {frames}" if messages else 3, "MACC-EMCY-01")
    for name in ("MACC-EMCY-02", "MACC-EMCY-04"):
        bench.session.not_run(name, SILENT)


@check("MACC-EMCY-02", "MACC-EMCY-04", "MACC-EMCY-01", safety=WORKED, needs=("rig:supply",))
def a_supply_warning_is_told_when_it_comes_and_goes(session: Session) -> None:
    """Over- and under-voltage send one message each when they come, with their code, and one of
    code 0 when they go; the lifebeat repeats it meanwhile, and where there is none nothing is
    said."""
    _judge_causes(session, OVER, UNDER)


@check("MACC-EMCY-02", "MACC-EMCY-04", "MACC-EMCY-01", safety=WORKED, needs=("rig:temperature",))
def overheating_is_told(session: Session) -> None:
    """Too hot a module says so at once, and again every ten seconds; one without a lifebeat says
    nothing."""
    _judge_causes(session, HOT)


@check("MACC-EMCY-02", "MACC-EMCY-04", "MACC-EMCY-01", safety=WORKED, needs=("rig:micro_cut",))
def a_micro_cut_is_told(session: Session) -> None:
    """A micro-cut of the supply is told at once, and stays told; by a module without a lifebeat it
    is not told."""
    _judge_causes(session, CUT)


PAIRS: Final[Mapping[tuple[int, int], str]] = {
    (HOT, OVER): "over-voltage of a module too hot",
    (HOT, CUT): "a micro-cut of a module too hot",
    (CUT, UNDER): "under-voltage after a micro-cut",
}


@check("MACC-EMCY-02", "MACC-EMCY-04", safety=WORKED, needs=ALL_FAULTS)
def of_two_errors_the_graver_has_the_code(session: Session) -> None:
    """A second error is told as well, though the code may stay: dd changes, and of several errors
    the code is that of the first in the ledger's order."""
    bench = RigBench(session)
    _unless_silent(bench)
    if not bench.rig.is_exact:
        session.skip("needs a rig that acts at once")
    bench.begin()
    for (first, second), words in PAIRS.items():
        for one, other in ((first, second), (second, first)):
            try:
                messages, done = change(bench, BEGIN[one])
                judge_change(bench, one, messages, done, words)
                messages, done = change(bench, BEGIN[other])
                judge_change(bench, one | other, messages, done, words)
            finally:
                _cleared(bench)


@check("MACC-EMCY-01", "MACC-EMCY-05", safety=WORKED, needs=("rig:supply",))
def an_emergency_begins_the_ten_seconds_anew(session: Session) -> None:
    """After an emergency message the next one comes ten seconds later, not ten after the last
    request."""
    bench = RigBench(session)
    _unless_silent(bench)
    if is_free(bench) or not bench.rig.is_exact:
        session.skip("its lifebeat runs freely, or the rig does not act at once")
    bench.begin()
    bench.ask(0x20)
    bench.target.take_spontaneous()
    bench.wait(LIFEBEAT_S / 2)
    bench.rig.set_supply(50.0)
    messages = said(bench, SHOWS_S)
    session.step(len(messages) == 1, "one message of the over-voltage", f"{len(messages)}")
    at = Window(messages[0].time_ns, messages[0].time_ns)
    following = beat(bench)
    if following is None:
        session.fail("MACC-EMCY-01", "another one ten seconds later", "none")
    session.expect(True, "MACC-EMCY-01", "another one", "one")
    judge_due(bench, at, following, "MACC-EMCY-05", "the emergency message")
    _cleared(bench)


@check("MACC-CMD-00-01", "MACC-Q-01-02", safety=WORKED, needs=("rig:temperature",))
def a_reset_acknowledges_only_what_has_gone(session: Session) -> None:
    """2000h of a module that is still too hot ends with the fault again, or is refused; once it has
    cooled down 2000h acknowledges the fault."""
    bench = RigBench(session)
    bench.begin()
    try:
        BEGIN[HOT](bench.rig)
        bench.wait(SHOWS_S if bench.rig.is_exact else RIG_PATIENCE_S)
        if not bench.faults() & HOT:
            session.inconclusive(None, "2001h shows no overheating")
        one = restart(bench)
        if one.exchange.kind is Kind.REFUSED:
            bench.reading("fault_ack_while_present", 1, "MACC-CMD-00-01")
        else:
            session.expect(one.boot_up is not None, "MACC-CMD-00-01", "a boot-up message", "none")
            bench.reading("fault_ack_while_present", 0, "MACC-CMD-00-01")
            bench.wait(SHOWS_S)
        seen = bench.faults()
        session.expect(bool(seen & HOT), "MACC-Q-01-02", "dd.4 still set", f"{seen:02X}")
        bench.must(Kind.REFUSED, bench.command(0x19), "MACC-Q-01-02")
    finally:
        bench.rig.reset()
    bench.wait(SHOWS_S if bench.rig.is_exact else RIG_PATIENCE_S)
    seen = bench.faults()
    session.expect(bool(seen & HOT), "MACC-Q-01-02", "dd.4 kept till 2000h", f"{seen:02X}")
    last = restart(bench)
    session.expect(last.boot_up is not None, "MACC-CMD-00-01", "a boot-up message", "none")
    seen = bench.faults()
    session.expect(not seen & HOT, "MACC-CMD-00-01", "acknowledged: dd.4 clear", f"{seen:02X}")
    bench.accepted(0x19, requirement="MACC-CMD-00-01")
    bench.at_rest()


def _unless_silent(bench: Bench) -> None:
    if silenced(bench):
        bench.session.skip(SILENT)
