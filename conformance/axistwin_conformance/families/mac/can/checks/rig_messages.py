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
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.driver.rig import OFF_S, WORKED
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import TimeWindow
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.boot_up import (
    await_boot_up,
    judge_form,
    judge_time,
    restart,
)
from axistwin_conformance.families.mac.can.checks.messages import (
    AFTERWARDS_S,
    beat,
    is_free,
    judge_due,
    silenced,
)
from axistwin_conformance.families.mac.can.collect_replies import (
    described,
    replies,
    slack_ns,
    unasked,
)
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.probes.errors import BEGIN, CUT, HOT, OVER, UNDER
from axistwin_conformance.families.mac.can.probes.messages import LIFEBEAT_S, spontaneous_messages
from axistwin_conformance.transport.can import Arrival
from axistwin_conformance.transport.rig import Rig

ORDER = 280  # of this module in a run; see `Family.modules`

SHOWS_S: Final = 0.2
RIG_SILENCE_LIMIT_S: Final = 10.0  # a real temperature rises slowly, and the rig may not tell when
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
    driver = CanDriver(session)
    driver.rig.begin()
    driver.session.rig.work("power", False)
    driver.client.wait(OFF_S)
    driver.client.target.take_spontaneous()
    received = replies(driver, driver.client.request(0x20).frame(), is_awaited=False)
    session.expect(not received, "MACC-BOOT-04", "silence without supply", described(received))
    on = TimeWindow(*driver.session.rig.work("power", True))
    if driver.session.rig.is_exact:
        received = replies(driver, driver.client.request(0x20).frame(), is_awaited=False)
        session.expect(
            not received, "MACC-BOOT-04", "silence before the boot-up", described(received)
        )
    _judge_boot(driver, on)
    driver.judge.alive("MACC-BOOT-04")
    _judge_once(driver)


def _judge_boot(driver: CanDriver, act: TimeWindow) -> None:
    """Judge that a boot-up message follows that act, in its form and time, and nothing before."""
    session = driver.session
    boot_up, before = await_boot_up(driver)
    session.expect(boot_up is not None, "MACC-BOOT-01", "a boot-up message", "none")
    assert boot_up is not None
    session.expect(
        not before, "MACC-BOOT-01", "nothing before it", [str(message.frame) for message in before]
    )
    judge_form(driver, boot_up)
    if driver.session.rig.is_exact:
        judge_time(driver, act, boot_up, "MACC-BOOT-04")


def _judge_once(driver: CanDriver) -> None:
    """Judge that no other boot-up message follows the one that came."""
    again = unasked(driver, AFTERWARDS_S, lambda frame: codec.boot_up_form(frame) is not None)
    driver.session.expect(
        not again, "MACC-BOOT-01", "one boot-up message", f"{1 + len(again)} of them"
    )


@check(
    "MACC-STATE-02",
    "MACC-BOOT-01",
    "MACC-BOOT-02",
    "MACC-BOOT-04",
    safety=WORKED,
    needs=("rig:reset",),
)
def held_in_reset_it_says_nothing(session: Session) -> None:
    """While the reset input is held there is no reply and no lifebeat; released, the module boots
    like after a reset and says so once."""
    driver = CanDriver(session)
    driver.rig.begin()
    driver.client.target.take_spontaneous()
    driver.session.rig.work("reset", True)
    until_ns = driver.client.target.now_ns + round(HELD_S * 1e9)
    while driver.client.target.now_ns < until_ns:
        for frame in (
            driver.client.request(0x20).frame(),
            driver.client.request(0x00).frame(),
            codec.sync(),
        ):
            received = replies(driver, frame, is_awaited=False)
            session.expect(not received, "MACC-STATE-02", "silence while held", described(received))
        driver.client.wait(LIFEBEAT_S / 4)
    spoken = unasked(driver, QUIET_S)
    session.expect(
        not spoken, "MACC-STATE-02", "not a message", [str(arrival.frame) for arrival in spoken]
    )
    _judge_boot(driver, TimeWindow(*driver.session.rig.work("reset", False)))
    if not driver.session.rig.is_exact:
        session.not_run("MACC-BOOT-04", "nobody knows when exactly the input was released")
    driver.judge.alive("MACC-STATE-02")
    _judge_once(driver)


@check(
    "MACC-STATE-02",
    "MACC-BOOT-01",
    "MACC-BOOT-02",
    "MACC-BOOT-04",
    safety=WORKED,
    needs=("rig:reset",),
)
def a_boot_that_the_reset_input_ends_begins_anew(session: Session) -> None:
    """Held in reset amid its start-up a module stays deaf and silent; released it says once, after
    its whole time, that it is there."""
    driver = CanDriver(session)
    if not driver.session.rig.is_exact or driver.motion.deaf_s < 1:
        session.skip("the rig has to act while the module starts")
    driver.rig.begin()
    driver.client.within(QUIET_S, 0x00)
    driver.client.wait(driver.motion.deaf_s / 2)
    driver.client.target.take_spontaneous()
    driver.session.rig.work("reset", True)
    spoken = unasked(driver, OVER_S)
    session.expect(
        not spoken, "MACC-STATE-02", "no message", [str(arrival.frame) for arrival in spoken]
    )
    received = replies(driver, driver.client.request(0x20).frame(), is_awaited=False)
    session.expect(not received, "MACC-STATE-02", "silence while held", described(received))
    _judge_boot(driver, TimeWindow(*driver.session.rig.work("reset", False)))
    driver.judge.alive("MACC-BOOT-04")
    _judge_once(driver)


# --- emergency -----------------------------------------------------------------------------------


def code_table(session: Session) -> tuple[tuple[int, int, int], ...]:
    """Bits of dd, code and register by priority, in the reading of this device (MACC-AMB-05)."""
    held = session.reading("emcy_code_map")
    if held == session.run.ledger.ambiguity_of("emcy_code_map").default_of("emcy_code_map"):
        return codec.ERROR_CODES
    rows = [tuple(int(part, 16) for part in word.split("/")) for word in held.split(",")]
    return tuple((bits, code, register) for bits, code, register in rows)


def payload_of(session: Session, status: bytes) -> tuple[bytes, ...]:
    """What a message may carry that is sent while 2001h reads `status`."""
    error = next((row[1:] for row in code_table(session) if status[0] & row[0]), (0, 0))
    head = error[0].to_bytes(2, "little") + bytes([error[1]])
    shapes = {"cia301_status": head + status, "status_first": status, "code_only": head}
    held = session.readings.get("emcy_payload")
    chosen = shapes if held is None else {held: shapes[held]}
    return tuple(payload.ljust(codec.EMERGENCY_BYTES, b"\0") for payload in chosen.values())


def change(driver: CanDriver, act: Callable[[Rig], object]) -> tuple[list[Arrival], TimeWindow]:
    """Let the rig do something; what the module says of it, and when it was done."""
    driver.client.ask(0x20)  # no lifebeat is due for a while
    driver.client.target.take_spontaneous()
    before_ns = driver.client.target.now_ns
    act(driver.session.rig)
    done = TimeWindow(before_ns, driver.client.target.now_ns)
    messages = spontaneous_messages(driver, SHOWS_S)
    if not messages and not driver.session.rig.is_exact:
        first = driver.client.emergency(RIG_SILENCE_LIMIT_S - SHOWS_S)
        messages = [first] if first is not None else []
    return messages, done


def judge_change(
    driver: CanDriver, wanted: int, messages: list[Arrival], done: TimeWindow, what: str
) -> None:
    """Judge that one message tells of a change of dd, at once, with the status it has led to."""
    session = driver.session
    status = bytes(driver.client.data_bytes(0x21))
    if status[0] & ERRORS != wanted:
        session.inconclusive(
            None, f"{what}: 2001h shows dd {status[0]:02X} instead of {wanted:02X}"
        )
    frames = " ".join(str(message.frame) for message in messages) or "none"
    session.expect(len(messages) == 1, "MACC-EMCY-02", f"one message: {what}", frames)
    payloads = payload_of(session, status)
    session.expect(
        messages[0].frame.data in payloads,
        "MACC-EMCY-04",
        [payload.hex(" ").upper() for payload in payloads],
        frames,
    )
    if wanted:
        session.quirk("MACC-EMCY-04", "emcy_code_map", session.reading("emcy_code_map"))
    if driver.session.rig.is_exact:
        late_ns = messages[0].time_ns - done.latest_ns
        session.expect(
            late_ns <= slack_ns(driver, 0), "MACC-EMCY-02", "at once", f"{late_ns / 1e6:.3f} ms"
        )


def _cleared(driver: CanDriver) -> None:
    """The rig at rest, and what it has left behind acknowledged."""
    driver.session.rig.reset()
    driver.client.wait(SHOWS_S)
    driver.motion.reinitialise()


def _judge_cause(driver: CanDriver, bit: int) -> None:
    """An error that comes is told; the lifebeat repeats it; that it goes is told as well."""
    session, name = driver.session, f"dd.{bit.bit_length() - 1}"
    messages, done = change(driver, BEGIN[bit])
    judge_change(driver, bit, messages, done, f"{name} has come")
    if is_free(driver):
        session.not_run("MACC-EMCY-01", "its lifebeat runs freely")
    else:
        repeated = beat(driver)
        names = ("MACC-EMCY-01", "MACC-EMCY-04")
        session.expect(repeated is not None, names, "the same again after 10 s", "nothing")
        assert repeated is not None
        session.expect(
            repeated.frame == messages[0].frame, "MACC-EMCY-04", messages[0].frame, repeated.frame
        )
    if bit & LATCHED:
        return
    messages, done = change(driver, lambda rig: rig.reset())
    on_clear = 0 if messages else 1
    driver.judge.reading("emcy_on_clear", on_clear, "MACC-EMCY-02")
    if messages:
        judge_change(driver, 0, messages, done, f"{name} has gone")


def _judge_causes(session: Session, *bits: int) -> None:
    """What is said of each of these errors: by a module without a lifebeat, nothing."""
    driver = CanDriver(session)
    driver.rig.begin()
    for bit in bits:
        try:
            if silenced(driver):
                _judge_unspoken(driver, bit)
            else:
                _judge_cause(driver, bit)
        finally:
            _cleared(driver)


def _judge_unspoken(driver: CanDriver, bit: int) -> None:
    """A module that sends the message never (MACC-AMB-05) is silent about an error as well: one
    that speaks of it had to speak every ten seconds, too."""
    messages, _ = change(driver, BEGIN[bit])
    messages += change(driver, lambda rig: rig.reset())[0]
    frames = " ".join(str(message.frame) for message in messages)
    driver.judge.reading(
        "emcy_payload", f"no lifebeat, but {frames}" if messages else 3, "MACC-EMCY-01"
    )
    for name in ("MACC-EMCY-02", "MACC-EMCY-04"):
        driver.session.not_run(name, SILENT)


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
    driver = CanDriver(session)
    _unless_silent(driver)
    if not driver.session.rig.is_exact:
        session.skip("needs a rig that acts at once")
    driver.rig.begin()
    for (first, second), words in PAIRS.items():
        for sender, other in ((first, second), (second, first)):
            try:
                messages, done = change(driver, BEGIN[sender])
                judge_change(driver, sender, messages, done, words)
                messages, done = change(driver, BEGIN[other])
                judge_change(driver, sender | other, messages, done, words)
            finally:
                _cleared(driver)


@check("MACC-EMCY-01", "MACC-EMCY-05", safety=WORKED, needs=("rig:supply",))
def an_emergency_begins_the_ten_seconds_anew(session: Session) -> None:
    """After an emergency message the next one comes ten seconds later, not ten after the last
    request."""
    driver = CanDriver(session)
    _unless_silent(driver)
    if is_free(driver) or not driver.session.rig.is_exact:
        session.skip("its lifebeat runs freely, or the rig does not act at once")
    driver.rig.begin()
    driver.client.ask(0x20)
    driver.client.target.take_spontaneous()
    driver.client.wait(LIFEBEAT_S / 2)
    driver.session.rig.work("supply", 50.0)
    messages = spontaneous_messages(driver, SHOWS_S)
    session.step(len(messages) == 1, "one message of the over-voltage", f"{len(messages)}")
    at = TimeWindow(messages[0].time_ns, messages[0].time_ns)
    following = beat(driver)
    if following is None:
        session.fail("MACC-EMCY-01", "another one ten seconds later", "none")
    session.expect(True, "MACC-EMCY-01", "another one", "one")
    judge_due(driver, at, following, "MACC-EMCY-05", "the emergency message")
    _cleared(driver)


@check("MACC-CMD-00-01", "MACC-Q-01-02", safety=WORKED, needs=("rig:temperature",))
def a_reset_acknowledges_only_what_has_gone(session: Session) -> None:
    """2000h of a module that is still too hot ends with the fault again, or is refused; once it has
    cooled down 2000h acknowledges the fault."""
    driver = CanDriver(session)
    driver.rig.begin()
    try:
        BEGIN[HOT](driver.session.rig)
        driver.client.wait(SHOWS_S if driver.session.rig.is_exact else RIG_SILENCE_LIMIT_S)
        if not driver.status.faults() & HOT:
            session.inconclusive(None, "2001h shows no overheating")
        restarted = restart(driver)
        if restarted.exchange.kind is ReplyKind.REFUSED:
            driver.judge.reading("fault_ack_while_present", 1, "MACC-CMD-00-01")
        else:
            session.expect(
                restarted.boot_up is not None, "MACC-CMD-00-01", "a boot-up message", "none"
            )
            driver.judge.reading("fault_ack_while_present", 0, "MACC-CMD-00-01")
            driver.client.wait(SHOWS_S)
        seen = driver.status.faults()
        session.expect(bool(seen & HOT), "MACC-Q-01-02", "dd.4 still set", f"{seen:02X}")
        driver.judge.must(ReplyKind.REFUSED, driver.client.command(0x19), "MACC-Q-01-02")
    finally:
        driver.session.rig.reset()
    driver.client.wait(SHOWS_S if driver.session.rig.is_exact else RIG_SILENCE_LIMIT_S)
    seen = driver.status.faults()
    session.expect(bool(seen & HOT), "MACC-Q-01-02", "dd.4 kept till 2000h", f"{seen:02X}")
    last = restart(driver)
    session.expect(last.boot_up is not None, "MACC-CMD-00-01", "a boot-up message", "none")
    seen = driver.status.faults()
    session.expect(not seen & HOT, "MACC-CMD-00-01", "acknowledged: dd.4 clear", f"{seen:02X}")
    driver.judge.accepted(0x19, requirement="MACC-CMD-00-01")
    driver.motion.at_rest()


def _unless_silent(driver: CanDriver) -> None:
    if silenced(driver):
        driver.session.skip(SILENT)
