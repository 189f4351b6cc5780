"""Re-initialisation, and several modules on one line (CMD-00, CMD-0B in a move, MULTI)."""

from __future__ import annotations

import itertools
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S, AxisExchange, quiet_s
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import velocity
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS
from axistwin_conformance.families.mac.axis.probes.stops import restarted_ns
from axistwin_conformance.families.mac.axis.probes.sync import is_held
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.codec import GENERAL_ADDRESS
from axistwin_conformance.families.mac.serial.driver import SerialDriver
from axistwin_conformance.families.mac.serial.probes.line import general_replies

ORDER = 180  # of this module in a run; see `Family.modules`

POLL_S: Final = 0.05
RUNS_OUT_S: Final = 0.1  # what an axis takes at most to stand after 18h at the slowest speed
# What MACS-CMD-00-02 leaves to MACS-AMB-21: a host may talk 2.5 s after 00h, and what it sends
# within 1.5 s must not count.
DEAF_MS: Final = range(1500, 2501)


@check("MACS-CMD-00-03", "MACS-CMD-00-02", "MACS-CMD-00-01", safety=MOVES)
def after_00h_it_is_deaf_for_two_seconds(session: Session) -> None:
    """After 00h, acknowledged or not, every frame is lost for 2 s, without reply or effect."""
    driver = SerialDriver(session)
    start = driver.motion.ready()
    exchange = driver.client.command(0x00)
    outcome: int | str = {ReplyKind.ACCEPTED: 0, ReplyKind.SILENCE: 1}.get(
        exchange.kind, exchange.kind.value
    )
    driver.judge.reading("reset_reply", outcome, "MACS-CMD-00-03")
    from_ns = exchange.taken.earliest_ns
    deaf_until_ns = from_ns + round(driver.motion.deaf_surely_s * 1e9)
    frames = itertools.cycle(
        (
            driver.client.request(0x20),
            *driver.client.nacked_alone(driver.client.request(0x20)),  # not even a Nack
            driver.client.request(0x13, start + 500),
            driver.client.request(0x0F, 0x77),
            driver.client.request(0x00),  # nor does it begin anew
            *([] if session.neighbours else [driver.client.to_all(0x20)]),
        )
    )
    last_ns = deaf_until_ns - 100_000_000 - round((POLL_S + session.target.line_s) * 1e9)
    while session.target.now_ns < last_ns:
        lost = driver.client.send(next(frames), POLL_S)
        driver.motion.taken_in_time(lost, deaf_until_ns, "the deafness")
        driver.judge.must(ReplyKind.SILENCE, lost, "MACS-CMD-00-02")
    awake_ns = _first_answer_ns(driver, from_ns)
    deaf_ms = round((awake_ns - from_ns) / 1e6)
    late_ms = round(session.target.line_s * 1000)  # one query more, of which nothing came
    latest_ms = DEAF_MS[-1] + late_ms
    session.expect(
        DEAF_MS[0] <= deaf_ms <= latest_ms,
        "MACS-CMD-00-02",
        f"no answer for {DEAF_MS[0]}..{DEAF_MS[-1]} ms after 00h",
        _awake_seen(deaf_ms, latest_ms),
    )
    session.info("MACS-CMD-00-02", f"deaf for {deaf_ms} ms, to {POLL_S * 1000:.0f} ms")
    boot_ms = round(driver.motion.deaf_s * 1000)
    is_held = abs(deaf_ms - boot_ms) <= (3 * POLL_S + 2 * session.target.line_s) * 1000
    session.quirk("MACS-CMD-00-02", "boot_time_ms", str(boot_ms if is_held else deaf_ms))
    place, coefficient = driver.client.position(), driver.client.parameter(0x0F)
    session.expect(
        place == start and coefficient != 0x77,
        ("MACS-CMD-00-02", "MACS-CMD-00-01"),
        f"position {start}, ramp coefficient not 119: nothing sent meanwhile is executed",
        f"position {place}, ramp coefficient {coefficient}",
    )


def _awake_seen(deaf_ms: int, latest_ms: int) -> Observation:
    """How long after 00h no query was answered, in words: too short, or too long."""
    if deaf_ms < DEAF_MS[0]:
        clause = f"{REQUEST}, sent {deaf_ms} ms after 00h (module init), was answered"
        wanted = f"no answer to a query sent less than {DEAF_MS[0]} ms after 00h"
    else:
        clause = f"no query sent less than {deaf_ms} ms after 00h (module init) was answered"
        wanted = f"an answer to a query sent {latest_ms} ms after 00h"
    return Observation(
        clause,
        value=f"the first answer after {deaf_ms} ms",
        wanted=f"{wanted} (the manual says 2 s and gives no tolerance; this one is the suite's)",
        causes=("00h",),
    )


def _first_answer_ns(driver: SerialDriver, from_ns: int) -> int:
    """When the module was first heard again; far too late if never."""
    while driver.client.target.now_ns < from_ns + 4_000_000_000:
        exchange = driver.client.send(driver.client.request(0x20), POLL_S)
        if exchange.kind is ReplyKind.ANSWER:
            return exchange.taken.earliest_ns
    from_now_ns = driver.client.target.now_ns
    driver.motion.wait_awake()  # each question may have put it off
    return from_now_ns


@check("MACS-CMD-00-01", "MACS-CMD-00-02", safety=MOVES)
def just_after_two_seconds_it_listens(session: Session) -> None:
    """A frame that ends 2.02 s after 00h's reply is answered, one at 1.98 s is lost."""
    driver = SerialDriver(session)
    if not session.target.is_lossless:
        session.skip("needs exact timing: only virtual time without noise tells 1.98 s from 2.02 s")
    driver.motion.ready()
    for after_s, kind in ((-0.02, ReplyKind.SILENCE), (0.02, ReplyKind.ANSWER)):
        since_ns = restarted_ns(driver)
        driver.client.wait_until(
            since_ns + round((driver.motion.deaf_s + after_s) * 1e9) - driver.client.frame_ns
        )
        exchange = driver.client.send(driver.client.request(0x20), POLL_S)
        session.expect(
            exchange.kind is kind,
            "MACS-CMD-00-02",
            f"{driver.client.wanted(kind)} {driver.motion.deaf_s + after_s:.2f} s after 00h",
            driver.client.observed(exchange),
        )
        driver.motion.wait_awake()
    driver.judge.alive("MACS-CMD-00-01")


@check("MACS-CMD-00-02", "MACS-CMD-00-01", "MACS-REPLY-12", safety=MOVES, level="full")
def what_begins_while_it_is_deaf_is_no_frame(session: Session) -> None:
    """A query that begins while the module is deaf after 00h, and whose rest comes bit by bit when
    it listens again, is lost as well; the next one is answered."""
    driver = SerialDriver(session)
    driver.motion.ready()
    query = driver.client.request(0x20).encode()
    half = len(query) // 2
    since_ns = restarted_ns(driver)
    driver.client.wait_until(since_ns + round(driver.motion.deaf_s / 2 * 1e9))
    begun = driver.client.send(query[:half], POLL_S)
    driver.judge.must(ReplyKind.SILENCE, begun, "MACS-CMD-00-02")
    driver.motion.taken_in_time(
        begun, since_ns + round(driver.motion.deaf_surely_s * 1e9), "the deafness"
    )
    said = session.target.receive(1, driver.motion.awake_surely_s)
    session.expect(not said, "MACS-REPLY-12", "silence until it listens again", said.hex(" "))
    for part, limit_s in ((query[half:-2], POLL_S), (query[-2:], QUIET_S)):
        ended = driver.client.send(part, limit_s)
        driver.judge.must(ReplyKind.SILENCE, ended, "MACS-CMD-00-02")
    driver.judge.alive("MACS-CMD-00-01")


# --- several modules -----------------------------------------------------------------------------


def general(driver: SerialDriver, index: int, parameter: int = 0) -> AxisExchange:
    """Send a frame to the general address; nobody talks any more when it is over."""
    request = driver.client.request(index, parameter, address=GENERAL_ADDRESS)
    exchange = driver.client.send(request, QUIET_S * 2)
    if exchange.kind is ReplyKind.GARBAGE:  # of several replies at once, this is the beginning
        driver.client.wait(QUIET_S)
    return exchange


def _everybody(session: Session) -> list[SerialDriver]:
    return [SerialDriver(session, address) for address in (session.address, *session.neighbours)]


@check(
    "MACS-MULTI-03", "MACS-REPLY-08", "MACS-REPLY-12", "MACS-FRAME-03", "MACS-REPLY-02",
    needs=("alone",),
)  # fmt: skip
def the_general_address_is_answered_by_module_00(session: Session) -> None:
    """A query to FF is answered once, by module 00 with address FF, and under a wrong checksum by
    Nack at most; others keep silent."""
    driver = SerialDriver(session)
    _judge_general_reply(driver, general(driver, 0x20).reply)
    speaks_for_itself(driver)
    surplus = session.target.receive(3, quiet_s(session.target))
    session.expect(not surplus, "MACS-REPLY-12", "one reply from one module", surplus.hex(" "))
    wrong = driver.client.to_all(0x20).with_wrong_checksum()
    exchange = driver.client.send(wrong, QUIET_S * 2)
    session.expect(
        exchange.kind not in (ReplyKind.ANSWER, ReplyKind.ACCEPTED, ReplyKind.REFUSED),
        ("MACS-FRAME-03", "MACS-REPLY-02"),
        "Nack, or silence",
        driver.client.observed(exchange),
    )
    speaks_for_itself(driver)
    session.expect(True, "MACS-MULTI-03", "", "")


def speaks_for_itself(driver: SerialDriver) -> None:
    """Judge that the answer to a query carries the address of the query, whoever the frame before
    was for."""
    reply = driver.judge.must(ReplyKind.ANSWER, driver.client.ask(0x20)).reply
    own = driver.client.address
    driver.session.expect(
        reply.address == own,
        "MACS-REPLY-08",
        f"address {own:02X} in the answer",
        f"address {reply.address:02X}",
    )


# What a motion locks, each with another value than it has then: the first in any reading.
LOCKED: Final = ((0x02, 1), (0x0D, 0x2123), (0x0F, 5), (0x09, 0x4321))


def _locked_for_all(driver: SerialDriver) -> None:
    """What a motion locks it locks in frames to FF as well."""
    is_whole = driver.readings.known("motion_lock_set") == 0
    before = driver.client.parameters()
    for index, parameter in LOCKED if is_whole else LOCKED[:1]:
        general(driver, index, driver.limits.slowed(parameter) if index == 0x0D else parameter)
    after = driver.client.parameters()
    changed = [
        f"{index:02X}h: {after[index]:X}h" for index in before if after[index] != before[index]
    ]
    wanted = "all parameters as before what was sent to FF in motion"
    driver.session.expect(not changed, "MACS-STATE-01", wanted, "; ".join(changed))


@check(
    "MACS-MULTI-02", "MACS-STATE-01", "MACS-REPLY-08", safety=MOVES, needs=("alone",), level="full"
)
def a_module_alone_obeys_the_general_address(session: Session) -> None:
    """10h to FF holds the next move back, 11h to FF starts it, 0Fh to FF is stored, but not in an
    endless motion, which 18h to FF ends, and 00h to FF restarts the module; whether anything is
    replied is another matter."""
    driver = SerialDriver(session)
    start = driver.motion.ready()
    for index, parameter in ((0x0F, 1), (0x10, 0)):
        general(driver, index, parameter)
        speaks_for_itself(driver)
    ramp = driver.client.parameter(0x0F)
    session.expect(ramp == 1, "MACS-MULTI-02", "ramp coefficient 1", f"ramp coefficient {ramp}")
    driver.judge.accepted(0x0F, 0)
    driver.judge.accepted(0x13, start + 40)
    held = is_held(driver, start)
    session.expect(
        held, "MACS-MULTI-02", f"armed by 10h to FF: at {start}", driver.client.position()
    )
    general(driver, 0x11)
    driver.client.wait(0.1 + driver.motion.lasting_s(40))
    place = driver.client.position()
    session.expect(place == start + 40, "MACS-MULTI-02", f"at {start + 40} after 11h to FF", place)
    driver.judge.accepted(0x15, velocity(1, SLOWEST))
    _locked_for_all(driver)
    general(driver, 0x18)
    driver.motion.run_out()
    driver.client.wait(RUNS_OUT_S)
    place = driver.client.position()
    held = is_held(driver, place)
    session.expect(held, "MACS-MULTI-02", f"at {place} after 18h to FF", driver.client.position())
    restart = general(driver, 0x00)
    lost = driver.client.send(driver.client.request(0x20), POLL_S)
    deaf_ns = restart.taken.earliest_ns + round(driver.motion.deaf_surely_s * 1e9)
    driver.motion.taken_in_time(lost, deaf_ns, "the deafness")
    driver.judge.must(ReplyKind.SILENCE, lost, "MACS-MULTI-02")
    driver.motion.wait_awake()
    speaks_for_itself(driver)


def _judge_general_reply(driver: SerialDriver, reply: codec.SerialReply) -> None:
    """Who answered a query to FF (MACS-AMB-16), and as whom (MACS-AMB-17)."""
    session = driver.session
    if reply.kind not in (ReplyKind.ANSWER, ReplyKind.SILENCE, ReplyKind.GARBAGE):
        session.fail("MACS-MULTI-03", "one answer, or silence", reply)
    driver.judge.reading(
        "general_reply_policy", general_replies(driver, reply.kind), "MACS-MULTI-03"
    )
    if reply.kind is ReplyKind.ANSWER:
        own = dict.fromkeys((session.address, *session.neighbours), 1)
        echo = {**own, GENERAL_ADDRESS: 0}.get(reply.address or 0, f"{reply}")
        driver.judge.reading("general_echo", echo, "MACS-REPLY-08")
    else:
        session.not_run("MACS-REPLY-08", "nobody is heard alone, so the address cannot be read")


@check("MACS-MULTI-01", "MACS-REPLY-13", "MACS-FRAME-07", needs=("neighbour",))
def modules_with_distinct_addresses_answer_for_themselves(session: Session) -> None:
    """Each module on the line answers its own address, and only that."""
    session.info("MACS-MULTI-01", "why one has to be 00 shows in frames to all (MACS-MULTI-03)")
    for driver in _everybody(session):
        reply = driver.judge.must(ReplyKind.ANSWER, driver.client.ask(0x24)).reply
        session.expect(
            reply.address == driver.client.address,
            ("MACS-MULTI-01", "MACS-REPLY-13", "MACS-FRAME-07"),
            f"{driver.client.address:02X}",
            f"{reply.address:02X}",
        )


@check("MACS-MULTI-03", "MACS-REPLY-08", "MACS-REPLY-12", needs=("neighbour",))
def one_module_answers_for_all(session: Session) -> None:
    """A query to FF on a shared line gets exactly one answer, module 00's, as address FF."""
    driver = SerialDriver(session)
    reply = general(driver, 0x20).reply
    extra = session.target.receive(1, QUIET_S)
    if extra:  # several speak on top of one another
        reply = codec.SerialReply(ReplyKind.GARBAGE, reply.raw + extra)
    _judge_general_reply(driver, reply)
    driver.client.wait(QUIET_S)
    session.target.drain()
    driver.judge.alive("MACS-REPLY-12")


@check("MACS-MULTI-02", "MACS-MULTI-03", safety=MOVES, needs=("neighbour",))
def general_commands_are_executed_by_all(session: Session) -> None:
    """0Dh, 0Fh and 13h to FF change and move every module on the line; one reply comes."""
    everybody = _everybody(session)
    first = everybody[0]
    before = [
        (driver.motion.ready(0x1000), driver.client.parameter(0x0D), driver.client.parameter(0x0F))
        for driver in everybody
    ]
    try:
        period = first.limits.slowed(0x0ABC)
        _judge_who_replies(everybody, period)
        for index, parameter in ((0x0D, period), (0x0F, 2)):
            _general_reply(first, general(first, index, parameter))
        for driver in everybody:
            seen = (driver.client.parameter(0x0D), driver.client.parameter(0x0F))
            session.expect(
                seen == (period, 2),
                "MACS-MULTI-02",
                f"{(period, 2)} at {driver.client.address:02X}",
                seen,
            )
        general(first, 0x15, velocity(1, 0x2000))
        first.client.wait(0.3)
        general(first, 0x18)
        for driver, (start, _, _) in zip(everybody, before, strict=True):
            moved = driver.client.position() - start
            session.expect(
                moved > 10,
                "MACS-MULTI-02",
                f"module {driver.client.address:02X} to move with all others",
                f"{moved} increments",
            )
    finally:
        for driver, (start, own_period, own_coefficient) in zip(everybody, before, strict=True):
            driver.client.command(0x18)
            driver.client.command(0x0D, own_period)
            driver.client.command(0x0F, own_coefficient)
            driver.motion.finish(driver.motion.go_plainly(start))


def _judge_who_replies(everybody: list[SerialDriver], period: int) -> None:
    """Tell by its contents whose the answer to all is: with FF in it, no address says so."""
    owns = {driver.client.address: driver.client.parameter(0x0D) for driver in everybody}
    if 0 not in owns:
        return
    if owns[0] == period:
        period += 1
    for driver in everybody:
        if driver.client.address:
            driver.client.command(0x0D, period)
            owns[driver.client.address] = period
    reply = general(everybody[0], PARAMETERS[0x0D].query).reply
    if reply.kind is ReplyKind.ANSWER and reply.data is not None:
        told = PARAMETERS[0x0D].read(reply.data)
        whose = next((f"{one:02X}" for one, own in owns.items() if own == told), "nobody")
        everybody[0].session.expect(
            told == owns[0], "MACS-MULTI-03", "the answer of module 00", f"that of {whose}: {reply}"
        )


def _general_reply(driver: SerialDriver, exchange: AxisExchange) -> None:
    kind = ReplyKind.ANSWER if exchange.kind is ReplyKind.ACCEPTED else exchange.kind
    driver.judge.reading("general_reply_policy", general_replies(driver, kind), "MACS-MULTI-03")
