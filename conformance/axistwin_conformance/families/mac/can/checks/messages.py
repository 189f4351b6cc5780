"""What a module says unasked: boot-up and lifebeat, and when it listens again (BOOT, EMCY, CMD-00).

Times are judged from both ends of what was seen: an instant that a module fixes while it takes over
a request lies in that exchange's window (`AxisExchange.taken`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import cycle, pairwise
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.base.transcript import Direction
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import Observation
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import TimeWindow
from axistwin_conformance.families.mac.axis.probes.sync import is_held
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.boot_up import (
    await_boot_up,
    boot_silence_limit_s,
    judge_form,
    judge_time,
    restart,
    taken_over,
)
from axistwin_conformance.families.mac.can.checks.general import judge_general
from axistwin_conformance.families.mac.can.collect_replies import (
    described,
    everybody,
    replies,
    slack_ns,
    unasked,
    unknown_addresses,
)
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.probes.errors import stopped_beyond
from axistwin_conformance.families.mac.can.probes.messages import (
    LIFEBEAT_S,
    payload_readings,
    spontaneous_messages,
)
from axistwin_conformance.transport.can import Arrival
from axistwin_conformance.transport.can_frame import Frame

ORDER = 60  # of this module in a run; see `Family.modules`

LIFEBEAT_NS: Final = round(LIFEBEAT_S * 1e9)
BEATS: Final = 6  # in virtual time; each takes ten seconds
BEATS_REAL: Final = 2
POLL_S: Final = 0.05
SPOKEN_TO_S: Final = 3.0  # between requests that keep a lifebeat away
SPOKEN_TO_TIMES: Final = 8
ALMOST_S: Final = 9.99  # as late as that a request still puts it off
TRAFFIC_S: Final = 1.0  # between frames that are not for this module
LONG_SEGMENT: Final = segment_parameter(
    1465, 0xFFFF
)  # 12 s: a lifebeat comes in it, and one after it
TOLERANCE: Final = 3  # increments, of an axis that rests
STORED_STEPS: Final = 20  # of a segment behind that one
SELDOM_S: Final = 30.0  # a module that says nothing after ten seconds says nothing in these either
AFTERWARDS_S: Final = 3.0  # what is said twice is said again by then
EDGE_S: Final = 0.02  # before the boot-up message, where a request must be lost
ALL_OR_NONE: Final = "FFFFFFFFh"  # MACC-AMB-29: which bits beside dd trigger, a stop does not tell
NMT_STOP, NMT_PREPARE, NMT_RESET, NMT_RESTART, NMT_START = 0x02, 0x80, 0x81, 0x82, 0x01


# --- restart -------------------------------------------------------------------------------------


@check("MACC-BOOT-01", "MACC-BOOT-02", "MACC-CMD-00-01", "MACC-CMD-00-02", safety=MOVES)
def a_reset_is_answered_and_ends_with_one_boot_up_message(session: Session) -> None:
    """2000h gets 60h, then one boot-up message: 00h under 700h plus the address."""
    driver = CanDriver(session)
    driver.motion.ready()
    restarted = restart(driver)
    reply = restarted.exchange.reply
    outcome: int | str = {ReplyKind.ACCEPTED: 0, ReplyKind.SILENCE: 1}.get(reply.kind, str(reply))
    driver.judge.reading("reset_reply", outcome, "MACC-CMD-00-02")
    strange = [
        str(early.frame) for early in restarted.before if not codec.is_emergency(early.frame)
    ]
    if restarted.boot_up is None and strange:
        session.fail("MACC-BOOT-02", "00h under 700h plus the address", " ".join(strange))
    session.expect(
        restarted.boot_up is not None,
        ("MACC-BOOT-01", "MACC-CMD-00-01"),
        "a boot-up message",
        "none",
    )
    assert restarted.boot_up is not None
    session.expect(
        not restarted.before,
        "MACC-BOOT-01",
        "nothing before the boot-up message",
        " ".join(str(early.frame) for early in restarted.before),
    )
    session.expect(
        restarted.boot_up.time_ns > restarted.since.latest_ns,
        "MACC-CMD-00-02",
        "the reply first",
        "the boot-up message first",
    )
    judge_form(driver, restarted.boot_up)
    again = unasked(driver, AFTERWARDS_S, lambda frame: codec.boot_up_form(frame) is not None)
    others = [other for other in session.neighbours if driver.client.boot_up(0, other) is not None]
    session.expect(not again, "MACC-BOOT-01", "one boot-up message", f"{1 + len(again)} of them")
    session.expect(not others, "MACC-BOOT-01", "no other module restarts", f"{others} as well")
    late = driver.client.target.receive(codec.is_reply, 0)
    session.expect(
        late is None,
        "MACC-CMD-00-02",
        "no reply but the one before the restart",
        "none" if late is None else str(late.frame),
    )
    driver.judge.alive("MACC-CMD-00-01")


@check(
    "MACC-GEN-01", "MACC-GEN-02", "MACC-GEN-03", "MACC-BOOT-01", safety=MOVES, needs=("neighbour",)
)
def a_reset_for_all_restarts_all(session: Session) -> None:
    """2000h on 600h restarts every module, each of which says when it is there again; module 1
    alone acknowledges it."""
    drivers = everybody(session)
    first = drivers[0]
    for driver in drivers:
        driver.motion.at_rest()
    first.client.target.take_spontaneous()
    if session.reading("reset_reply") == "ack":
        kind = judge_general(first, first.client.to_all(0x00))
        is_right = kind in (
            ReplyKind.ACCEPTED,
            ReplyKind.SILENCE,
        )  # without a module 1 there is no reply
        session.expect(is_right, "MACC-GEN-02", "60h", kind.value)
    else:
        replies(first, first.client.to_all(0x00).frame(), is_awaited=False)
        session.not_run("MACC-GEN-02", "this device restarts without a reply")
        session.not_run("MACC-GEN-03", "this device restarts without a reply")
    first.client.wait(boot_silence_limit_s(first))
    frames = [arrival.frame for arrival in first.client.target.take_spontaneous()]
    booted = [
        codec.spontaneous_from(frame) for frame in frames if codec.boot_up_form(frame) is not None
    ]
    for driver in drivers:
        count = booted.count(driver.client.address)
        wanted_text = f"one boot-up message of {driver.client.address}"
        session.expect(count == 1, ("MACC-GEN-01", "MACC-BOOT-01"), wanted_text, f"{count} of them")
        driver.judge.alive("MACC-GEN-01")


@check("MACC-BOOT-04", "MACC-BOOT-01", safety=MOVES)
def the_boot_up_message_comes_two_seconds_after_the_reset(session: Session) -> None:
    """Three restarts take 2 s each, to the frame; or what this device was found to take.  It comes
    after a restart amid a move, too."""
    driver = CanDriver(session)
    driver.motion.ready()
    for _ in range(3):
        restarted = restart(driver)
        if restarted.boot_up is None:
            session.fail(None, "a boot-up message", "none")
        judge_time(driver, restarted.since, restarted.boot_up, "MACC-BOOT-04")
        driver.judge.alive()
    start = driver.motion.ready(SLOWEST)
    driver.motion.go(start + driver.limits.way_outlasting(60, SLOWEST, 4))
    is_told = restart(driver).boot_up is not None
    wanted = "a boot-up message after 2000h in motion"
    session.expect(is_told, "MACC-BOOT-01", wanted, "none")


@check("MACC-BOOT-04", "MACC-CMD-00-01", safety=MOVES)
def until_its_boot_up_message_it_serves_nothing(session: Session) -> None:
    """What is sent between reset and boot-up message gets no reply, then or later: no effect, nor
    does it put that message off."""
    driver = CanDriver(session)
    start = driver.motion.ready()
    driver.client.target.take_spontaneous()
    exchange = driver.client.within(QUIET_S, 0x00)
    requests = ((0x20,), (0x0F, 0x77), (0x12,), (0x20, 0, 0x01), (0x00,))
    frames = [codec.sync(), *(driver.client.request(*each).frame() for each in requests)]
    if not session.envelope.is_guarded:
        frames.append(driver.client.request(0x13, start + 500).frame())
    until_ns = exchange.taken.earliest_ns + round((driver.motion.deaf_surely_s) * 1e9)
    until_ns -= round(2 * QUIET_S * 1e9) + driver.client.target.uncertainty_ns
    for frame in cycle(frames):
        if driver.client.target.now_ns >= until_ns:
            break
        received = replies(driver, frame, is_awaited=False)
        wanted = f"silence to {codec.explain(frame)}"
        session.expect(not received, "MACC-BOOT-04", wanted, described(received))
    boot_up, _ = await_boot_up(driver)
    session.step(boot_up is not None, "a boot-up message", "none")
    assert boot_up is not None
    judge_time(driver, taken_over(driver, exchange), boot_up, "MACC-BOOT-04")
    late = driver.client.target.receive(codec.is_reply, AFTERWARDS_S)
    session.expect(
        late is None,
        "MACC-BOOT-04",
        "nothing answered afterwards",
        "nothing" if late is None else str(late.frame),
    )
    place, coefficient = driver.client.position(), driver.client.parameter(0x0F)
    session.expect(
        (place, coefficient) == (start, 0),
        ("MACC-BOOT-04", "MACC-CMD-00-01"),
        f"position {start}, AA 00: nothing was executed",
        f"position {place}, ramp coefficient {coefficient}",
    )


@check("MACC-BOOT-04", "MACC-CMD-00-01", safety=MOVES)
def with_its_boot_up_message_it_serves_everything(session: Session) -> None:
    """A request is lost up to the boot-up message, and answered right behind it."""
    driver = CanDriver(session)
    driver.motion.ready()
    if session.transport.is_lossless:
        exchange = driver.client.within(QUIET_S, 0x00)
        since_ns = taken_over(driver, exchange).latest_ns
        driver.client.wait_until(since_ns + round((driver.motion.deaf_s - EDGE_S) * 1e9))
        received = replies(driver, driver.client.request(0x20).frame(), is_awaited=False)
        session.expect(not received, "MACC-BOOT-04", "silence just before", described(received))
        driver.motion.wait_awake()
    restarted = restart(driver)
    session.step(restarted.boot_up is not None, "a boot-up message", "none")
    for index in (*codec.ANSWERED, 0x0F):
        kind = driver.client.command(index).kind
        wanted = ReplyKind.ANSWER if index in codec.ANSWERED else ReplyKind.ACCEPTED
        session.expect(kind is wanted, ("MACC-BOOT-04", "MACC-CMD-00-01"), wanted.value, kind.value)


@check("MACC-BOOT-04", safety="motion")
def network_management_neither_hinders_nor_restarts_it(session: Session) -> None:
    """Frames of network management are ignored: requests are served as before, nothing restarts."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    try:
        for command in (NMT_STOP, NMT_PREPARE, NMT_RESET, NMT_RESTART):
            driver.client.target.take_spontaneous()
            driver.client.target.send(codec.nmt(command, driver.client.address))
            is_served = driver.client.within(QUIET_S, 0x20).kind is ReplyKind.ANSWER
            seconds = (
                driver.motion.awake_surely_s if command in (NMT_RESET, NMT_RESTART) else QUIET_S
            )
            is_restarted = driver.client.boot_up(seconds) is not None
            is_ignored = is_served and not is_restarted
            if is_ignored and command == NMT_PREPARE:
                continue  # requests are served in that state in any case
            driver.judge.reading("nmt_supported", int(not is_ignored))
    finally:
        driver.client.target.send(codec.nmt(NMT_START, driver.client.address))
    driver.judge.alive()


# --- lifebeat ------------------------------------------------------------------------------------


def silenced(driver: CanDriver) -> bool:
    """True on a module that was found to send no such message; then none may come."""
    return driver.session.reading("emcy_payload") == "none"


def beat(driver: CanDriver, after_ns: int = LIFEBEAT_NS) -> Arrival | None:
    """The next message of this module, which is left alone so long; None if none comes in time."""
    return driver.client.emergency((after_ns + slack_ns(driver, after_ns)) / 1e9)


def is_free(driver: CanDriver) -> bool:
    """True on a module that was found to speak every ten seconds whatever happens."""
    return driver.session.reading("lifebeat_restart") == "free"


def judge_due(
    driver: CanDriver,
    since: TimeWindow,
    message: Arrival,
    requirement: str,
    what: str = "the request",
) -> None:
    """Judge that a message was sent ten seconds after something in that window."""
    slack = slack_ns(driver, LIFEBEAT_NS)
    sent_ns = message.time_ns - driver.client.target.least_time_ns(message.frame) - LIFEBEAT_NS
    driver.session.expect(
        since.earliest_ns - slack <= sent_ns <= since.latest_ns + slack,
        requirement,
        f"{LIFEBEAT_S:.3f} s after {what}, give or take {slack / 1e6:.1f} ms",
        f"{(sent_ns - since.latest_ns + LIFEBEAT_NS) / 1e9:.4f} s",
    )


def judge_payload(driver: CanDriver, message: Arrival, status: bytes, requirement: str) -> None:
    """Eight bytes under 080h plus the address, in one reading of MACC-AMB-05."""
    frame = message.frame
    driver.session.expect(
        len(frame.data) == codec.EMERGENCY_BYTES, requirement, "eight bytes", str(frame)
    )
    outcome = payload_readings(message, status)
    assert isinstance(outcome, tuple | str)
    driver.judge.reading("emcy_payload", outcome, requirement)


@check("MACC-EMCY-01", "MACC-EMCY-03")
def a_lifebeat_comes_every_ten_seconds_of_silence(session: Session) -> None:
    """Ten seconds after the last request, and every ten seconds after that, the module sends eight
    bytes under 080h plus its address."""
    driver = CanDriver(session)
    driver.client.target.take_spontaneous()
    own = driver.client.ask(0x21)
    driver.judge.must(ReplyKind.ANSWER, own)
    status = own.reply.data.to_bytes(4, "big")
    message = beat(driver)
    if message is None:
        _judge_silence(driver)
    if message is None or silenced(driver):
        came = "a message of a module found to send none"
        driver.judge.reading("emcy_payload", 3 if message is None else came, "MACC-EMCY-01")
        session.not_run("MACC-EMCY-03", "it sends no such message")
        return
    if not is_free(driver):
        judge_due(driver, own.taken, message, "MACC-EMCY-01")
    for number in range(BEATS if session.transport.is_virtual else BEATS_REAL):
        judge_payload(driver, message, status, "MACC-EMCY-03")
        following = beat(driver)
        if following is None:
            session.fail("MACC-EMCY-01", f"another one {LIFEBEAT_S:.0f} s later", "none")
        gap = TimeWindow(message.time_ns, message.time_ns)
        judge_due(driver, gap, following, "MACC-EMCY-01", f"lifebeat {number + 1}")
        session.expect(
            following.frame == message.frame, "MACC-EMCY-03", message.frame, following.frame
        )
        message = following
    driver.judge.alive("MACC-EMCY-01")


def _judge_silence(driver: CanDriver) -> None:
    """Judge that a module without a lifebeat has none later, or under SYNC's identifier, either."""
    late = driver.client.emergency(SELDOM_S)
    stray = driver.client.target.receive(lambda frame: frame.identifier == codec.SYNC, 0)
    came = " ".join(str(arrival.frame) for arrival in (late, stray) if arrival is not None)
    driver.session.expect(
        not came,
        "MACC-EMCY-01" if late is not None else ("MACC-EMCY-01", "MACC-EMCY-03"),
        "a lifebeat after ten seconds of silence, or never one",
        partial(_late_seen, driver, late, came),
    )


def _late_seen(driver: CanDriver, late: Arrival | None, came: str) -> Observation:
    """A lifebeat that came late, in words."""
    value = f"none then, and later {came}"
    spare_ms = slack_ns(driver, LIFEBEAT_NS) / 1e6
    wanted = (
        f"{LIFEBEAT_S:.3f} s (± {spare_ms:.1f} ms, which the suite allows for other frames on the"
        " bus), or no lifebeat ever (the manual lacks the figure that shows it: MACC-AMB-05)"
    )
    if late is None:
        return Observation(f"a message under the identifier of SYNC came: {came}", value, wanted)
    asked = [one for one in driver.session.records() if one.direction is Direction.HOST]
    after_s = (late.time_ns - asked[-1].time_ns) / 1e9
    number = driver.client.address
    return Observation(
        f"module {number} sent its first lifebeat ({late.frame}) {after_s:.3f} s after the last"
        " request to it",
        value,
        wanted,
    )


def messages_amid(driver: CanDriver, own: TimeWindow, *traffic: Frame) -> list[Arrival]:
    """What it says up to ten seconds after an own request, one of these frames each second."""
    over_ns = own.latest_ns + LIFEBEAT_NS + 2 * slack_ns(driver, LIFEBEAT_NS)
    messages: list[Arrival] = []
    frames = cycle(traffic)
    while (left_s := (over_ns - driver.client.target.now_ns) / 1e9) > 0:
        if left_s > TRAFFIC_S:
            driver.client.target.send(next(frames))
        messages += spontaneous_messages(driver, min(TRAFFIC_S, left_s))
    return messages


def _restarted_by(
    driver: CanDriver, own: TimeWindow, messages: Sequence[Arrival], *, is_for_all: bool
) -> int | tuple[int, ...] | str:
    """Which readings of MACC-AMB-06 explain what was said from an own request on, up to ten seconds
    and a little after it, with other traffic meanwhile; `is_for_all`: traffic that `any` counts."""
    slack = slack_ns(driver, LIFEBEAT_NS)
    earliest, latest = own.earliest_ns + LIFEBEAT_NS - slack, own.latest_ns + LIFEBEAT_NS + slack
    if not messages:
        return 1 if is_for_all else "no lifebeat, though nobody spoke to it"
    if len(messages) > 1:
        words = ", ".join(
            f"{(message.time_ns - own.latest_ns) / 1e9:.3f} s" for message in messages
        )
        return f"{len(messages)} messages within ten seconds: after {words}"
    if earliest <= messages[0].time_ns <= latest + slack:
        return (0, 2) if is_for_all else (0, 1, 2)
    return 2


@check("MACC-EMCY-05", "MACC-EMCY-01")
def requests_to_it_put_the_lifebeat_off(session: Session) -> None:
    """A module that is asked something every few seconds keeps silent; ten seconds after the last
    request it speaks, whatever the request was."""
    driver = CanDriver(session)
    if silenced(driver):
        session.skip("it sends no such message")
    driver.client.ask(0x20)
    driver.client.target.take_spontaneous()
    requests = (0x20, 0x12, 0x11, 0x28, 0x26)
    received: list[Arrival] = []
    for number in range(SPOKEN_TO_TIMES):
        driver.client.within(QUIET_S, requests[number % len(requests)])
        received += spontaneous_messages(driver, SPOKEN_TO_S)
    if received:
        gaps = [later.time_ns - earlier.time_ns for earlier, later in pairwise(received)]
        slack = slack_ns(driver, LIFEBEAT_NS)
        is_regular = all(abs(gap - LIFEBEAT_NS) <= slack for gap in gaps)
        is_regular &= len(received) >= int(SPOKEN_TO_S * SPOKEN_TO_TIMES / LIFEBEAT_S)
        came = f"{len(received)} messages amid requests"
        driver.judge.reading("lifebeat_restart", 2 if is_regular else came, "MACC-EMCY-05")
        session.expect(is_regular, "MACC-EMCY-01", "every ten seconds", came)
        return
    driver.judge.reading("lifebeat_restart", (0, 1), "MACC-EMCY-05")
    for index in requests if session.transport.is_virtual else requests[:1]:
        driver.client.wait(SPOKEN_TO_S)  # or it could be the last message that is counted from
        own = driver.client.within(QUIET_S, index)
        message = beat(driver)
        if message is None:
            session.fail("MACC-EMCY-01", "a lifebeat", f"none after {index:02X}h")
        session.expect(True, "MACC-EMCY-01", "a lifebeat", "one")
        judge_due(driver, taken_over(driver, own), message, "MACC-EMCY-05")


@check("MACC-EMCY-01", "MACC-EMCY-05", "MACC-CMD-16-01", safety=MOVES)
def a_lifebeat_comes_amid_a_motion_as_well(session: Session) -> None:
    """Ten seconds after the last request it speaks though a segment lasts; the end of that does not
    put the next lifebeat off, and the segment stored behind it is done."""
    driver = CanDriver(session)
    if silenced(driver) or is_free(driver):
        session.skip("it sends no such message, or sends it in any case")
    start = driver.motion.ready()
    driver.judge.accepted(0x1E, LONG_SEGMENT)
    own = driver.judge.accepted(
        0x16, segment_parameter(STORED_STEPS, driver.limits.slowed(SLOWEST))
    )
    driver.client.target.take_spontaneous()
    message = beat(driver)
    if message is None:
        session.fail("MACC-EMCY-01", "a lifebeat amid a segment", "none")
    judge_due(driver, own.taken, message, "MACC-EMCY-01", "the segment was taken")
    following = beat(driver)
    if following is None:
        names = ("MACC-EMCY-01", "MACC-EMCY-05")
        session.fail(names, "another one ten seconds later", "none")
    since = TimeWindow(message.time_ns, message.time_ns)
    judge_due(driver, since, following, "MACC-EMCY-05", "the lifebeat before")
    place, wanted_place = driver.client.position(), start + STORED_STEPS
    session.expect(place == wanted_place, "MACC-CMD-16-01", f"position {wanted_place}", place)
    driver.motion.at_rest()


@check("MACC-EMCY-05", needs=("virtual",))
def a_request_in_the_last_moment_puts_the_lifebeat_off(session: Session) -> None:
    """Asked 9.99 s after the last request, again and again, the module never speaks."""
    driver = CanDriver(session)
    if silenced(driver) or is_free(driver):
        session.skip("it sends no such message, or sends it in any case")
    own = driver.client.ask(0x20)
    driver.client.target.take_spontaneous()
    for _ in range(BEATS):
        driver.client.wait_until(
            own.taken.earliest_ns + round(ALMOST_S * 1e9) - driver.client.frame_ns
        )
        own = driver.client.ask(0x20)
        received = spontaneous_messages(driver, 0)
        session.expect(
            not received, None, "silence", " ".join(str(arrival.frame) for arrival in received)
        )
    message = beat(driver)
    if message is None:
        session.fail(None, "a lifebeat at last", "none")
    judge_due(driver, own.taken, message, "MACC-EMCY-05")


@check("MACC-EMCY-05")
def what_is_not_for_it_does_not_put_the_lifebeat_off(session: Session) -> None:
    """General requests, SYNC, requests to others and network management once a second: ten seconds
    after the module's own last request it speaks all the same."""
    driver = CanDriver(session)
    if silenced(driver):
        session.skip("it sends no such message")
    other = unknown_addresses(session)[0]
    traffic = (
        (driver.client.to_all(0x20).frame(), True),
        (codec.sync(), True),
        (driver.client.request(0x20, address=other).frame(), False),
        (Frame(codec.EMERGENCY + other, bytes(codec.EMERGENCY_BYTES)), False),
        (codec.nmt(NMT_START, other), False),
    )
    for frame, is_for_all in traffic if session.transport.is_virtual else traffic[:2]:
        own = driver.client.ask(0x20).taken
        driver.client.target.take_spontaneous()
        messages = messages_amid(driver, own, frame)
        outcome = _restarted_by(driver, own, messages, is_for_all=is_for_all)
        if isinstance(outcome, str):
            outcome = f"{outcome}, amid {codec.explain(frame)}"
        driver.judge.reading("lifebeat_restart", outcome)


@check("MACC-EMCY-05", safety=MOVES)
def the_boot_up_message_begins_the_ten_seconds(session: Session) -> None:
    """After a restart the first lifebeat comes ten seconds after the boot-up message."""
    driver = CanDriver(session)
    if silenced(driver) or is_free(driver):
        session.skip("it sends no such message, or sends it in any case")
    driver.motion.ready()
    booted = restart(driver).boot_up
    if booted is None:
        session.fail(None, "a boot-up message", "none")
    message = beat(driver)
    if message is None:
        session.fail(None, "a lifebeat", "none")
    since = TimeWindow(booted.time_ns, booted.time_ns)
    judge_due(driver, since, message, "MACC-EMCY-05", "the boot-up message")


@check(
    "MACC-EMCY-03",
    "MACC-EMCY-04",
    "MACC-EMCY-02",
    "MACC-EMCY-01",
    "MACC-Q-01-01",
    "MACC-CMD-10-01",
    safety=MOVES,
)
def the_lifebeat_repeats_the_status(session: Session) -> None:
    """With a software stop tripped, the lifebeat shows it as 2001h does, with error code 0; the
    stop itself is no error and is not told at once.  The motor is off meanwhile, and the module
    armed: the lifebeat comes, and leaves stop bits and arm as they are."""
    driver = CanDriver(session)
    if silenced(driver):
        session.skip("it sends no such message")
    driver.client.target.take_spontaneous()
    with stopped_beyond(driver):
        at_once = spontaneous_messages(driver, POLL_S)
        own = driver.client.ask(0x21)
        driver.judge.must(ReplyKind.ANSWER, own)
        status = own.reply.data.to_bytes(4, "big")
        session.step(status[1] != 0, "2001h shows the stop", status.hex(" "))
        for index in (0x1A, 0x10):
            driver.judge.accepted(index)
        driver.client.command(0x1C, TOLERANCE)
        status, modes = bytes(driver.client.data_bytes(0x21)), driver.client.value(0x26)
        message = beat(driver)
        now = driver.client.value(0x26)
        session.expect(now == modes, "MACC-EMCY-01", f"2006h still {modes:08X}", f"{now:08X}")
        _judge_left_alone(driver, status)
    if not is_free(driver):
        _judge_trigger(driver, at_once)
    session.expect(message is not None, "MACC-EMCY-01", "a lifebeat, the motor off", "none")
    assert message is not None
    judge_payload(driver, message, status, "MACC-EMCY-03")
    judge_payload(driver, message, status, "MACC-EMCY-04")
    if is_free(driver):
        session.not_run("MACC-EMCY-02", "what comes at once may be a lifebeat")


def _judge_left_alone(driver: CanDriver, status: bytes) -> None:
    """Judge that 2001h reads what it did before a silence, and a move is held back as it was."""
    now = bytes(driver.client.data_bytes(0x21))
    driver.session.expect(now == status, "MACC-Q-01-01", status.hex(" "), now.hex(" "))
    place = driver.client.position()
    driver.judge.accepted(0x13, place - STORED_STEPS)
    wanted = f"held at {place}"
    driver.session.expect(
        is_held(driver, place), "MACC-CMD-10-01", wanted, driver.client.position()
    )


def _judge_trigger(driver: CanDriver, at_once: Sequence[Arrival]) -> None:
    """Whether a stop bit is part of the error code (MACC-AMB-29)."""
    seen = "FF000000h"
    if at_once:
        held = driver.session.readings.get("emcy_trigger_mask", ALL_OR_NONE)
        seen = held if held != seen else ALL_OR_NONE
    driver.session.quirk("MACC-EMCY-02", "emcy_trigger_mask", seen)
