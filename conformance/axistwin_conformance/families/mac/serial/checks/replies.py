"""What the module says, and that it says nothing else (REPLY)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S, AxisExchange, quiet_s
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.driver.unknown_modules import unknown_module_at
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.parameters import settings_of
from axistwin_conformance.families.mac.axis.probes.sync import is_held
from axistwin_conformance.families.mac.axis.words import TICK
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.driver import NACKED_BY_MANY, SerialDriver
from axistwin_conformance.families.mac.serial.probes.line import nack_readings, rx_during_xoff
from axistwin_conformance.sequences.golden import golden_exchanges

ORDER = 20  # of this module in a run; see `Family.modules`

LISTEN_S: Final = 61.0  # the ledger's minute; on a real line the waits of all other checks add up
LISTEN_REAL_S: Final = 0.5
ACKNOWLEDGED_WITHIN_S: Final = 0.5
UNASSIGNED: Final = (0x12, 0x1F, 0x2A, 0x04)
WRONG_ALIKE: Final = 3  # wrong answers, all the same, that noise does not make
LONG: Final = 100  # increments at the slowest speed: longer than that


def readdressed(frame: bytes, address: int) -> bytes:
    """The same example for another module: address and checksum replaced."""
    summed = codec.two_digits(address) + frame[6:18]
    return frame[:4] + summed + codec.two_digits(codec.checksum(summed)) + frame[20:]


@check(
    "MACS-FRAME-01",
    "MACS-FRAME-03",
    "MACS-REPLY-01",
    "MACS-CMD-15-01",
    "MACS-CMD-16-01",
    "MACS-CMD-1E-01",
    safety=("motion", "stored"),
)
def the_manuals_examples_get_their_printed_replies(session: Session) -> None:
    """Every worked example of the manual, its misprints corrected, gets 06 13 1A."""
    driver = SerialDriver(session)
    for golden in golden_exchanges("mac_serial", bytes.fromhex):
        if golden.request[6:7] == b"2":
            continue  # the query depends on where the axis stands; it has a check of its own
        driver.motion.ready()
        exchange = driver.client.send(readdressed(golden.request, driver.client.address))
        driver.motion.at_rest()
        driver.judge.must(ReplyKind.ACCEPTED, exchange, golden.requirements)
        spelled = exchange.reply.xon_spelling
        assert spelled is not None
        session.quirk("MACS-REPLY-01", "xon_byte", spelled)


@check("MACS-REPLY-07", "MACS-REPLY-08", "MACS-REPLY-09", "MACS-REPLY-10", "MACS-REPLY-12")
def every_answer_has_the_form_of_the_manual(session: Session) -> None:
    """20h to 29h are answered in 21 bytes: length field 011, own address, second index digit; and
    nothing follows."""
    driver = SerialDriver(session)
    for index in range(0x20, 0x2A):
        exchange = driver.client.ask(index)
        if exchange.reply.length not in (b"", *codec.ANSWER_LENGTH_FIELDS):
            _judge_length(driver, index, exchange.reply)
        reply = driver.judge.must(ReplyKind.ANSWER, exchange, "MACS-REPLY-07").reply
        session.expect(
            reply.address == driver.client.address,
            "MACS-REPLY-08",
            f"address {driver.client.address:02X} in the answer",
            Observation(
                f"module {driver.client.address:02X}h answered {REQUEST} with address"
                f" {reply.address:02X}h",
                value=f"address {reply.address:02X}",
                wanted=f"its own address, {driver.client.address:02X}h",
            ),
        )
        _judge_digit(driver, index, reply)
        _judge_length(driver, index, reply)
        _nothing_follows(driver, exchange)
    for index in UNASSIGNED:
        _judge_behind(driver, index)


def _judge_behind(driver: SerialDriver, index: int) -> None:
    """An answer has its own digit whatever was refused before it.  It is asked for without the
    second try that noise gets, which would hide a first one; noise is not twice the same."""
    query = driver.client.request(0x20).encode()
    digits = set[int | None]()
    for _ in range(WRONG_ALIKE):
        if driver.client.within(QUIET_S, index).kind is not ReplyKind.REFUSED:
            return  # other readings of what means nothing (MACS-AMB-58)
        reply = driver.client.send(query).reply
        if reply.kind is not ReplyKind.ANSWER:
            return  # of that nothing is known
        digits.add(reply.digit)
        if reply.digit == 0:
            break
    wanted = f"index digit 0 in the answer to 20h behind {index:02X}h, which was refused"
    seen = f"digit {max(digits, key=lambda digit: digit or 0):X}"
    driver.session.expect(0 in digits or len(digits) > 1, "MACS-REPLY-09", wanted, seen)


def _nothing_follows(driver: SerialDriver, exchange: AxisExchange) -> None:
    """Judge that the reply to a request was all that it got."""
    surplus = driver.client.target.receive(3, quiet_s(driver.client.target))
    behind = f"{exchange.reply}, and then {surplus.hex(' ').upper()}"
    seen = Observation(f"{REQUEST} got {behind}", behind, request=exchange.request)
    driver.session.expect(not surplus, "MACS-REPLY-12", "nothing behind the reply", seen)


@check("MACS-REPLY-12", safety=("motion", "stored"), level="full")
def nothing_follows_an_acceptance(session: Session) -> None:
    """Every command is accepted in three bytes, whichever it is; written is what is stored."""
    driver = SerialDriver(session)
    driver.motion.ready()

    def accepted(index: int, parameter: int = 0) -> None:
        _nothing_follows(driver, driver.judge.accepted(index, parameter))

    for index, parameter in settings_of(driver.client.parameters()).items():
        if index != 0x1C or driver.rig.has_tolerance():
            accepted(index, parameter)
    for index in (0x0B, 0x14, 0x19, 0x1A, 0x17, 0x18):
        accepted(index)
    place = driver.client.position()
    for index, parameter in ((0x13, place), (0x10, 0), (0x13, place), (0x11, 0)):
        accepted(index, parameter)
    step = segment_parameter(1, driver.motion.period)
    for index in (0x1E, 0x16):
        accepted(index, step)
        accepted(0x18)  # what leads out of an error of a store that has run empty (MACS-AMB-40)
    accepted(0x15, velocity(1, driver.motion.period))


def _judge_digit(driver: SerialDriver, index: int, reply: codec.SerialReply) -> None:
    printed = {0x21: "status_reply_digit", 0x23: "reply23_digit"}
    wanted = index & 0x0F
    if index in printed:  # both pages print digit 2, copied from the page of 22h
        outcome = {wanted: 0, 2: 1}.get(reply.digit or 0, f"digit {reply.digit}")
        driver.judge.reading(printed[index], outcome, "MACS-REPLY-09")
        return
    driver.session.expect(
        reply.digit == wanted,
        "MACS-REPLY-09",
        f"index digit {wanted} in the answer",
        f"digit {reply.digit:X}",
    )


def _judge_length(driver: SerialDriver, index: int, reply: codec.SerialReply) -> None:
    if index == 0x28:
        outcome = {b"011": 0, b"014": 1}.get(reply.length, f"length {reply.length!r}")
        driver.judge.reading("reply28_length", outcome, "MACS-REPLY-10")
        return
    driver.session.expect(
        reply.length == b"011",
        "MACS-REPLY-10",
        "length field 011 in the answer",
        f"length field {reply.length.decode()}",
    )


@check("MACS-REPLY-02", "MACS-REPLY-06", "MACS-REPLY-11", "MACS-REPLY-12")
def a_nack_is_one_byte_and_nothing_follows(session: Session) -> None:
    """A wrong checksum gets the single byte 15h, for queries and commands, no Xoff, no Xon."""
    driver = SerialDriver(session)
    if driver.client.is_nacked_by_many:
        session.skip(NACKED_BY_MANY)
    for index in (0x20, 0x29, 0x2A, 0x04, 0x12):
        exchange = driver.client.send(driver.client.request(index).with_wrong_checksum())
        is_query = 0x20 <= index < 0x2A
        names = ("MACS-REPLY-02", "MACS-REPLY-11" if is_query else "MACS-REPLY-06")
        driver.judge.must(ReplyKind.NACK, exchange, names)
        extra = session.target.receive(3, QUIET_S)
        session.expect(
            not extra, ("MACS-REPLY-02", "MACS-REPLY-12"), "silence after 15h", extra.hex(" ")
        )


@check("MACS-REPLY-02", "MACS-FRAME-07")
def a_wrong_checksum_for_somebody_else_is_not_nacked(session: Session) -> None:
    """Only the module that the address field shows Nacks a wrong checksum."""
    driver = SerialDriver(session)
    taken = {session.address, *session.neighbours}
    other = next(address for address in (0x55, 0x2A, 0x15) if address not in taken)
    unknown_module_at(driver.client, other)  # it would Nack, as it has to
    outcome = nack_readings(driver, other)
    driver.judge.reading("nack_scope", outcome, "MACS-REPLY-02")
    driver.judge.alive("MACS-FRAME-07")


@check(
    "MACS-REPLY-03",
    "MACS-REPLY-05",
    "MACS-REPLY-06",
    "MACS-CMD-13-02",
    "MACS-CMD-0D-02",
    safety=("motion", "stored"),
)
def refusals_change_nothing(session: Session) -> None:
    """During a move 13h and 0Dh are refused (06 13 17), a wrong checksum gets Nack (15h), and the
    move goes on unchanged."""
    driver = SerialDriver(session)
    start = driver.motion.ready(SLOWEST)
    target = start + driver.limits.way_outlasting(60, SLOWEST, 8)
    forecast = driver.motion.go(target)
    wrong = driver.client.send(driver.client.request(0x13, start - 500).with_wrong_checksum())
    driver.judge.must(ReplyKind.NACK, wrong, "MACS-REPLY-06")
    names = ("MACS-REPLY-03", "MACS-REPLY-05", "MACS-CMD-13-02")
    refusal = driver.judge.refused(0x13, start - 500, requirement=names)
    spelled = refusal.reply.xonerror_spelling
    assert spelled is not None
    session.quirk("MACS-REPLY-03", "xonerror_byte", spelled)
    driver.client.wait(0.1)
    driver.motion.follow(
        forecast, ("MACS-REPLY-05", "MACS-CMD-13-02"), driver.limits.allowance(SLOWEST)
    )
    asked = driver.limits.slowed(0x2123)
    lock = driver.client.command(0x0D, asked)
    if lock.kind is ReplyKind.ACCEPTED:
        driver.judge.reading("motion_lock_set", 1, "MACS-CMD-0D-02")
        driver.motion.at_rest()
        return
    driver.judge.must(ReplyKind.REFUSED, lock, "MACS-CMD-0D-02")
    driver.motion.watch(forecast, ("MACS-REPLY-05", "MACS-CMD-13-02"), samples=3)
    kept = driver.client.parameter(0x0D)
    session.expect(
        kept == SLOWEST,
        ("MACS-REPLY-05", "MACS-CMD-0D-02"),
        "period FFFF as before",
        Observation(
            f"0Dh (maximum-speed period {asked} {TICK}) was {lock.reply} during a move (13h, go to"
            f" position {target}), yet {REQUEST} then showed {kept} {TICK}",
            value=f"period {kept:04X}",
            wanted=f"{SLOWEST} {TICK}, the value before it",
            causes=(f"13h (go to position {target})", "0Dh"),
        ),
    )
    _refused_while_armed(driver)


def _refused_while_armed(driver: SerialDriver) -> None:
    """What is refused at rest leaves the module armed."""
    place = driver.client.position()
    driver.judge.accepted(0x10)
    kinds = {
        driver.client.command(index, parameter).kind
        for index, parameter in ((0x12, 0), (0x02, 2), (0x03, 2))
    }
    if ReplyKind.REFUSED not in kinds:
        return  # other readings of what means nothing (MACS-AMB-58, -60)
    driver.judge.accepted(0x13, place + 40)
    driver.session.expect(
        is_held(driver, place),
        "MACS-REPLY-05",
        f"armed: at {place} until 11h",
        driver.client.position(),
    )


# What would show at rest if it were executed: a place, a parameter, a restart, an arm, a lock.
TELLING: Final = (
    (0x14, 0),
    (0x16, 0x00640640),
    (0x0B, 0),
    (0x09, 0x1234),
    (0x0A, 0x1234),
    (0x0C, 0x11),
    (0x0D, 0x0777),
    (0x0E, 0x4400),
    (0x0F, 0x33),
    (0x1C, 0x22),
    (0x02, 1),
    (0x03, 9),
    (0x10, 0),
)
TOLD_ALL: Final = ((0x13, 0), (0x0B, 0), (0x0C, 0x11), (0x0F, 0x33), (0x10, 0))


@check("MACS-REPLY-04", safety=("motion", "stored"))
def a_nacked_frame_does_nothing(session: Session) -> None:
    """Commands under a wrong checksum neither move, store, arm nor re-initialise anything."""
    driver = SerialDriver(session)
    start = driver.motion.ready()  # 0Bh is shown in motion, below
    before = _shown(driver)
    for index, parameter in (
        (0x13, start + 200),
        (0x15, velocity(1, 0x1000)),
        *TELLING,
        (0x1E, segment_parameter(0x100, SLOWEST)),
        (0x00, 0),  # last: a module that obeys it is deaf for a while
    ):
        _nacked(driver, driver.client.request(index, parameter).with_wrong_checksum(3))
    session.target.wait(QUIET_S)
    _judge_unchanged(driver, before)
    driver.judge.accepted(0x03, 0)  # no segment runs that would lock it
    forecast = driver.motion.turn(1, SLOWEST)  # nor is anything armed
    driver.client.wait(0.2)
    driver.motion.follow(forecast, None, driver.limits.allowance(SLOWEST))


@check("MACS-REPLY-04", safety=("motion", "stored"), needs=("alone",))
def a_wrong_frame_to_all_does_nothing(session: Session) -> None:
    """Commands to FF under a wrong checksum neither move, store nor arm anything."""
    driver = SerialDriver(session)
    start = _beside_zero(driver)
    before = _shown(driver)
    for index, parameter in TOLD_ALL:
        _lost_on_all(driver, index, start + 200 if index == 0x13 else parameter)
    session.target.wait(QUIET_S)
    _judge_unchanged(driver, before)
    forecast = driver.motion.turn(1, SLOWEST)  # nor is anything armed
    driver.client.wait(0.2)
    driver.motion.follow(forecast, None, driver.limits.allowance(SLOWEST))


@check("MACS-REPLY-04", safety=("motion", "stored"))
def a_nacked_frame_ends_no_motion(session: Session) -> None:
    """Commands under a wrong checksum stop nothing, and leave what is armed as it is."""
    driver = SerialDriver(session)
    driver.motion.ready()
    forecast = driver.motion.turn(1, SLOWEST)
    for index in (0x18, 0x17, 0x1A, 0x0B, 0x15, 0x00):
        _nacked(driver, driver.client.request(index).with_wrong_checksum())
    driver.client.wait(0.2)
    driver.motion.follow(forecast, None, driver.limits.allowance(SLOWEST))
    driver.motion.at_rest()
    _nacked_while_armed(driver)


def _nacked_while_armed(driver: SerialDriver) -> None:
    """Nor do they disarm, start or drop what 10h holds back."""
    start = driver.motion.ready()
    driver.judge.accepted(0x10)
    for index in (0x20, 0x11, 0x17, 0x18, 0x1A):
        _nacked(driver, driver.client.request(index).with_wrong_checksum())
    driver.judge.accepted(0x13, start + 40)
    for index in (0x11, 0x17, 0x18, 0x1A, 0x00):
        _nacked(driver, driver.client.request(index).with_wrong_checksum())
    held = is_held(driver, start)
    driver.session.expect(held, None, f"armed: at {start} until 11h", driver.client.position())
    driver.motion.finish(
        driver.motion.to_position(driver.judge.accepted(0x11), start, start + 40), None
    )


def _beside_zero(driver: SerialDriver) -> int:
    """Bring the module to rest where clearing the counter shows; give the place."""
    start = driver.motion.ready()
    return start or driver.motion.finish(driver.motion.go(37))


def _shown(driver: SerialDriver) -> dict[int, int]:
    """The place and all parameters, by query."""
    return {index: driver.client.value(index) for index in (0x20, 0x22, 0x23, 0x25, 0x26)}


def _judge_unchanged(driver: SerialDriver, before: Mapping[int, int]) -> None:
    """Judge that place and parameters are as they were.  Another place is told without a number: it
    is that of a moment, and no two attempts would look alike."""
    changed = [
        "another place" if index == 0x20 else f"{index:02X}h {value:08X}, was {before[index]:08X}"
        for index, value in _shown(driver).items()
        if value != before[index]
    ]
    wanted = "the place and all parameters as before"
    driver.session.expect(not changed, None, wanted, "; ".join(changed))


def _nacked(driver: SerialDriver, request: codec.SerialRequest) -> None:
    """Send a frame that is Nacked; where every module does that, what comes is no single Nack
    (MACS-AMB-19)."""
    exchange = driver.client.send(request)
    if not driver.client.is_nacked_by_many:
        driver.judge.must(ReplyKind.NACK, exchange)


def _lost_on_all(driver: SerialDriver, index: int, parameter: int) -> None:
    """Send a frame with a wrong sum to FF, which module 00 may Nack (MACS-AMB-19)."""
    exchange = driver.client.send(
        driver.client.to_all(index, parameter).with_wrong_checksum(3), QUIET_S
    )
    driver.session.expect(
        exchange.kind not in (ReplyKind.ANSWER, ReplyKind.ACCEPTED, ReplyKind.REFUSED),
        None,
        "Nack, or silence",
        driver.client.observed(exchange),
    )


@check("MACS-REPLY-12", "MACS-REPLY-14", "MACS-CMD-13-01", safety=("motion", "stored"))
def nothing_is_said_that_was_not_asked(session: Session) -> None:
    """A long move is acknowledged at once, and neither its course nor its end sends a byte."""
    driver = SerialDriver(session)
    start = driver.motion.ready(SLOWEST)
    sent_ns = session.target.now_ns
    exchange = driver.judge.accepted(
        0x13, start + LONG, requirement=("MACS-REPLY-14", "MACS-CMD-13-01")
    )
    _judge_prompt(driver, sent_ns)
    end = driver.motion.to_position(exchange, start, start + LONG).end
    assert end is not None
    listen_s = LISTEN_S if session.target.is_virtual else LISTEN_REAL_S
    extra = session.target.receive(1, (end.latest_ns - session.target.now_ns) / 1e9 + listen_s)
    session.expect(not extra, "MACS-REPLY-12", "silence", extra.hex(" "))
    sent_ns = session.target.now_ns
    driver.judge.accepted(0x15, velocity(-1, SLOWEST), requirement="MACS-REPLY-14")
    _judge_prompt(driver, sent_ns)
    driver.motion.at_rest()
    extra = session.target.receive(1, listen_s)
    session.expect(not extra, "MACS-REPLY-12", "silence", extra.hex(" "))
    driver.judge.alive("MACS-REPLY-12")


def _judge_prompt(driver: SerialDriver, sent_ns: int) -> None:
    took_s = (driver.session.target.now_ns - sent_ns) / 1e9
    driver.session.expect(
        took_s < ACKNOWLEDGED_WITHIN_S, "MACS-REPLY-14", "06 13 1A at once", f"{took_s:.3f} s"
    )


@check("MACS-REPLY-12")
def at_rest_it_keeps_silent(session: Session) -> None:
    """A module at rest says nothing on its own."""
    driver = SerialDriver(session)
    extra = session.target.receive(1, LISTEN_S if session.target.is_virtual else LISTEN_REAL_S)
    session.expect(not extra, None, "silence", extra.hex(" "))
    driver.judge.alive()


@check("MACS-REPLY-13", safety=("motion", "stored"))
def frames_for_another_module_do_nothing(session: Session) -> None:
    """Commands for another address neither move this module nor change its parameters."""
    driver = SerialDriver(session)
    start = _beside_zero(driver)
    before = _shown(driver)
    taken = {session.address, *session.neighbours}
    other = next(address for address in (0x33, 0x4C, 0x5A) if address not in taken)
    hint = unknown_module_at(driver.client, other)  # before it is told anything
    if hint:
        session.fail("MACS-REPLY-13", f"silence at {other:02X}h", "an answer to 20h", hint)
    cases = [*((index, parameter) for index, parameter in TELLING if index not in (0x14, 0x16))]
    if not session.envelope.is_guarded:  # or a module that nobody has named might be there and move
        cases.insert(0, (0x13, start + 300))
    for index, parameter in cases:
        _for_another(driver, other, index, parameter)
    _judge_unchanged(driver, before)
    forecast = driver.motion.turn(1, SLOWEST)  # nor is anything armed
    for index in (0x18, 0x1A, 0x17):
        _for_another(driver, other, index)
    driver.motion.follow(forecast, None, driver.limits.allowance(SLOWEST))
    driver.motion.at_rest()
    start = driver.motion.ready()
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x13, start + 40)
    _for_another(driver, other, 0x11)
    held = is_held(driver, start)
    session.expect(held, None, f"armed: at {start} until 11h", driver.client.position())


def _for_another(driver: SerialDriver, address: int, index: int, parameter: int = 0) -> None:
    """Send a frame for a module that is not there."""
    request = driver.client.request(index, parameter, address=address)
    driver.judge.must(ReplyKind.SILENCE, driver.client.send(request, QUIET_S))


@check("MACS-REPLY-15")
def what_comes_during_a_reply_is_kept_or_lost(session: Session) -> None:
    """A second query sent on top of the first one's answer is answered too, or lost; no harm."""
    driver = SerialDriver(session)
    if not session.target.is_virtual:
        session.skip("needs exact timing: only virtual time puts a byte between Etx and a reply")
    driver.judge.again(rx_during_xoff)
    driver.judge.alive()


@check("MACS-REPLY-16")
def reply_times_are_recorded(session: Session) -> None:
    """The time from the last byte of a request to the first of its reply is reported."""
    driver = SerialDriver(session)
    frame = driver.client.request(0x20)
    waits_ms = []
    for _ in range(10):
        window = driver.client.send(frame).taken
        waits_ms.append((window.latest_ns - window.earliest_ns) / 1e6)
    session.expect(max(waits_ms) < 500, None, "below 500 ms", f"{max(waits_ms):.3f} ms")
    session.info(None, f"reply latency {min(waits_ms):.3f}..{max(waits_ms):.3f} ms")
