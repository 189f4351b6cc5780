"""The address, and the factory reset (LMT, CMD-01): what can make a module unreachable comes last,
with the module alone on the bus, and is put back whatever happens."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver import factory
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S, quiet_s
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import TimeWindow
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.boot_up import (
    await_boot_up,
    boot_silence_limit_s,
    judge_form,
    judge_time,
    restart,
)
from axistwin_conformance.families.mac.can.checks.messages import (
    AFTERWARDS_S,
)
from axistwin_conformance.families.mac.can.collect_replies import described, replies, slack_ns
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.probes.destructive import (
    ALONE,
    DESTRUCTIVE,
    FACTORY_ADDRESS,
    LMT_STORE,
    address_put_back,
    answers,
    configure,
    give_address,
)
from axistwin_conformance.families.mac.can.probes.messages import LIFEBEAT_S
from axistwin_conformance.transport.can_frame import Frame

ORDER = 290  # of this module in a run; see `Family.modules`

NEW_ADDRESSES: Final = (0x2A, 0x55)
BOUNDS: Final = (0x01, 0x02, 0x3F, 0x40, 0x7E, 0x7F)  # MACC-LMT-04
BAD_ADDRESSES: Final = (0x00, 0x80, 0x81, 0xAA, 0xFE, 0xFF)
FILLER: Final = 0xFF
PAUSES: Final = 4  # in which a wait is cut, with a request behind each
LENGTHS: Final = range(2, 9)  # MACC-AMB-08
# First bytes of the convention's other services.  13h and 15h set and use another bit rate: never
# on a real bus.
SWITCHES: Final = (0x40, 0x41, 0x42, 0x43, 0x46, 0x47, 0x48, 0x49, 0x4A, 0x4B, 0x4C)
WHO: Final = (0x5A, 0x5B, 0x5C, 0x5D, 0x5E)
RATE_SERVICES: Final = (0x13, 0x15)
REPLIED_BY_THE_CONVENTION: Final = frozenset((*WHO, LMT_STORE))


def lmt_replies(driver: CanDriver, frame: Frame, *, is_awaited: bool = False) -> tuple[Frame, ...]:
    """Everything that comes of an LMT frame; of one that is answered, as late as a reply may."""
    return replies(driver, frame, is_awaited=is_awaited)


def silently(driver: CanDriver, frame: Frame, requirement: str) -> TimeWindow:
    """Judge that nobody answers an LMT frame; give when it was heard."""
    sent_ns = driver.client.target.now_ns
    received = lmt_replies(driver, frame)
    driver.session.expect(
        not received, requirement, f"silence to {codec.explain(frame)}", described(received)
    )
    return TimeWindow(sent_ns, sent_ns + slack_ns(driver, 0))


def take_address(driver: CanDriver, frame: Frame, requirement: str = "MACC-LMT-02") -> None:
    """Judge the reply to an address that can be had: 11 00 00 and zeros, of 8 or 7 bytes."""
    received = lmt_replies(driver, frame, is_awaited=True)
    is_one = len(received) == 1 and received[0].identifier == codec.LMT_REPLY
    length = len(received[0].data) if is_one else 0
    lengths = {8: 0, 7: 1}
    wanted = b"\x11".ljust(length, b"\0")
    driver.session.expect(
        is_one and length in lengths and received[0].data == wanted,
        requirement,
        "7E4h 11 00 00 and zeros",
        described(received),
    )
    driver.judge.reading("lmt_dlc", lengths[length], requirement)


def store(driver: CanDriver) -> None:
    """What a module of the whole convention wants beside (MACC-AMB-12)."""
    if driver.readings.known("lmt_other"):
        configure(driver, codec.lmt(LMT_STORE))


def serves_meanwhile(driver: CanDriver) -> bool:
    """False on a module that was found to serve no requests while its address is set."""
    return driver.session.reading("lmt_sdo") == "served"


def no_boot_up(driver: CanDriver, requirement: str) -> None:
    """Judge that the module does not restart after a frame that completes no procedure; in another
    reading it does (MACC-AMB-10)."""
    is_booted = driver.client.boot_up(boot_silence_limit_s(driver)) is not None
    driver.judge.reading("lmt_incomplete", int(is_booted), requirement)


def nobody_at(driver: CanDriver, address: int, requirement: str | tuple[str, ...] | None) -> None:
    """Judge that a request to that address gets no reply, under any identifier."""
    frame = driver.client.request(0x20, address=address).frame()
    received = replies(driver, frame, is_awaited=False)
    driver.judge.holds(not received, requirement, f"silence at {address}", described(received))


def stays(driver: CanDriver, requirement: str, *others: int) -> None:
    """Judge that the module is where it was, and at none of these addresses."""
    driver.session.expect(
        answers(driver, driver.client.address),
        requirement,
        f"still at {driver.client.address}",
        "silence",
    )
    for other in others:
        if other in codec.ADDRESSES and other != driver.client.address:
            nobody_at(driver, other, requirement)


def procedure(driver: CanDriver, new: int, length: int = codec.TRANSFER_BYTES) -> None:
    """Give an address in three frames, judged by where the module is in the end."""
    old = driver.client.address
    for frame in (codec.lmt_enter(length), codec.lmt_address(new, length)):
        configure(driver, frame)
    store(driver)
    driver.client.target.take_spontaneous()
    configure(driver, codec.lmt_leave(length))
    boot_up, _ = await_boot_up(driver, address=new)
    is_there = boot_up is not None and answers(driver, new)
    names = ("MACC-LMT-01", "MACC-LMT-04")
    driver.session.expect(is_there, names, f"that it boots and answers at address {new}", "neither")
    driver.client.address = new
    if old != new:
        nobody_at(driver, old, names)


# --- the procedure -------------------------------------------------------------------------------


@check(
    "MACC-LMT-01",
    "MACC-LMT-02",
    "MACC-LMT-03",
    "MACC-BOOT-01",
    "MACC-BOOT-02",
    "MACC-BOOT-03",
    "MACC-BOOT-04",
    safety=DESTRUCTIVE,
    needs=ALONE,
)
def the_address_is_given_in_three_steps(session: Session) -> None:
    """Entering is not answered, the address is, leaving is not; with leaving the module boots under
    the new address, and keeps it."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    with address_put_back(driver):
        for new in NEW_ADDRESSES:
            if new != driver.client.address:
                _judge_steps(driver, new)


def _judge_steps(driver: CanDriver, new: int) -> None:
    session, old = driver.session, driver.client.address
    silently(driver, codec.lmt_enter(), "MACC-LMT-02")
    take_address(driver, codec.lmt_address(new))
    if serves_meanwhile(driver):
        stays(driver, "MACC-LMT-03", new)
    store(driver)
    driver.client.target.take_spontaneous()
    since = silently(driver, codec.lmt_leave(), "MACC-LMT-02")
    early: tuple[Frame, ...] = ()
    if driver.motion.deaf_s > 1.0:
        for address in (old, new):
            frame = driver.client.request(0x20, address=address).frame()
            early += replies(driver, frame, is_awaited=False)
    boot_up, before = await_boot_up(driver, address=new)
    if boot_up is None and old != new and answers(driver, old):
        names = ("MACC-LMT-01", "MACC-LMT-03", "MACC-BOOT-01", "MACC-BOOT-03")
        session.fail(names, f"a restart, and an answer at address {new}", f"an answer at {old}")
    session.expect(
        boot_up is not None, ("MACC-BOOT-01", "MACC-BOOT-03"), f"an answer at address {new}", "none"
    )
    assert boot_up is not None
    session.expect(not early, "MACC-BOOT-04", "silence until the boot-up", described(early))
    session.expect(not before, "MACC-BOOT-01", "nothing before it", described_all(before))
    again, as_old = driver.client.boot_up(AFTERWARDS_S, new), driver.client.boot_up(0, old)
    session.expect(again is None, "MACC-BOOT-01", "one boot-up message", "two")
    session.expect(as_old is None, "MACC-BOOT-03", f"none as {old}", "one")
    judge_form(driver, boot_up)
    judge_time(driver, since, boot_up, "MACC-BOOT-04")
    session.expect(answers(driver, new), "MACC-LMT-01", f"answers as {new}", "silence")
    nobody_at(driver, old, ("MACC-LMT-01", "MACC-LMT-03"))
    driver.client.address = new
    restarted = restart(driver)
    session.expect(
        restarted.boot_up is not None and answers(driver, new),
        "MACC-LMT-03",
        f"address {new} after a restart as well",
        "silence",
    )


def described_all(messages: tuple[object, ...]) -> str:
    """What came too early, in words."""
    return " ".join(str(message) for message in messages)


@check("MACC-LMT-04", "MACC-LMT-01", safety=DESTRUCTIVE, needs=ALONE)
def addresses_at_the_bounds_can_be_had(session: Session) -> None:
    """01h, 7Fh and what lies beside the powers of two between them can be given."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    with address_put_back(driver):
        for new in BOUNDS:
            procedure(driver, new)


@check("MACC-LMT-04", "MACC-LMT-01", safety=DESTRUCTIVE, needs=("alone", "virtual"), level="full")
def every_address_can_be_had(session: Session) -> None:
    """Each of 01h to 7Fh can be given, and is answered at while no other is."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    with address_put_back(driver):
        for new in reversed(codec.ADDRESSES):
            procedure(driver, new)


@check("MACC-LMT-01", "MACC-LMT-02", "MACC-LMT-03", safety=DESTRUCTIVE, needs=ALONE)
def the_procedure_may_take_its_time(session: Session) -> None:
    """Longer than a lifebeat takes after each step, in silence or amid requests, the next one
    counts all the same."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    with address_put_back(driver):
        for new, is_spoken_to in zip(NEW_ADDRESSES, (False, True), strict=True):
            old = driver.client.address
            silently(driver, codec.lmt_enter(), "MACC-LMT-02")
            _let_pass(driver, is_spoken_to=is_spoken_to)
            take_address(driver, codec.lmt_address(new), "MACC-LMT-01")
            store(driver)
            _let_pass(driver, is_spoken_to=is_spoken_to)
            driver.client.target.take_spontaneous()
            configure(driver, codec.lmt_leave())
            boot_up, _ = await_boot_up(driver, address=new)
            is_there = boot_up is not None and answers(driver, new)
            names = ("MACC-LMT-01", "MACC-LMT-03")
            session.expect(is_there, names, f"that it boots and answers at address {new}", "not so")
            driver.client.address = new
            if old != new:
                nobody_at(driver, old, names)


def _let_pass(driver: CanDriver, *, is_spoken_to: bool) -> None:
    """Wait a little longer than a lifebeat takes, or ask now and then meanwhile."""
    for _ in range(PAUSES):
        driver.client.wait((LIFEBEAT_S + 1) / PAUSES)
        if is_spoken_to and serves_meanwhile(driver):
            driver.client.ask(0x20)


@check("MACC-LMT-01", safety=DESTRUCTIVE, needs=ALONE)
def lmt_frames_may_be_shorter_and_hold_anything(session: Session) -> None:
    """Seven bytes are as good as eight, and fewer too, and what the bytes behind hold is all
    the same; one byte is too few."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    lengths = LENGTHS if session.reading("lmt_dlc") == "8" else (7, 8)
    with address_put_back(driver):
        for number, length in enumerate(lengths):
            new = NEW_ADDRESSES[number % 2]
            steps = (b"\x04\x01", bytes([0x11, new]))
            for step in steps:
                configure(driver, _padded(step, length))
            store(driver)
            configure(driver, _padded(b"\x04\x00", length))
            boot_up, _ = await_boot_up(driver, address=new)
            session.expect(
                boot_up is not None,
                None,
                f"a boot-up message from address {new}",
                f"none, {length} bytes",
            )
            driver.client.address = new
        configure(driver, Frame(codec.LMT_REQUEST, b"\x04"))
        silently(driver, codec.lmt_address(NEW_ADDRESSES[0]), "MACC-LMT-01")
        driver.client.target.take_spontaneous()
        configure(driver, codec.lmt_leave())
        driver.client.boot_up(boot_silence_limit_s(driver))
        stays(driver, "MACC-LMT-01")


def _padded(head: bytes, length: int) -> Frame:
    return Frame(codec.LMT_REQUEST, head.ljust(length, bytes([FILLER])))


# --- what is not complete ------------------------------------------------------------------------


@check("MACC-LMT-03", "MACC-LMT-06", safety=DESTRUCTIVE, needs=ALONE)
def an_abandoned_procedure_leaves_the_old_address(session: Session) -> None:
    """A restart after the address was given, before leaving, keeps the old one; it ends the
    configuration mode, too."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    if not serves_meanwhile(driver):
        session.skip("while its address is set it takes no reset (MACC-AMB-11)")
    new = next(address for address in NEW_ADDRESSES if address != driver.client.address)
    with address_put_back(driver):
        configure(driver, codec.lmt_enter())
        take_address(driver, codec.lmt_address(new), "MACC-LMT-03")
        restarted = restart(driver)
        session.expect(
            restarted.boot_up is not None,
            "MACC-LMT-03",
            f"an answer at address {driver.client.address}",
            "none",
        )
        stays(driver, "MACC-LMT-03", new)
        silently(driver, codec.lmt_address(new), "MACC-LMT-06")
        driver.client.target.take_spontaneous()
        silently(driver, codec.lmt_leave(), "MACC-LMT-03")
        driver.client.boot_up(boot_silence_limit_s(driver))
        stays(driver, "MACC-LMT-03", new)


@check("MACC-LMT-05", "MACC-LMT-07", safety=DESTRUCTIVE, needs=ALONE)
def addresses_out_of_range_are_refused(session: Session) -> None:
    """00h and 80h to FFh get 11 01 00, and the module keeps the address it has."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    every = (0, *range(0x80, 0x100))
    readings = {b"\x11\x01\x00": 0, b"\x11\xff\x00": 1}
    with address_put_back(driver):
        silently(driver, codec.lmt_enter(), "MACC-LMT-05")
        for bad in every if session.transport.is_virtual else BAD_ADDRESSES:
            received = lmt_replies(driver, codec.lmt_address(bad), is_awaited=True)
            outcome: int | str = f"{described(received)} to address {bad:02X}h" if received else 2
            if len(received) == 1 and received[0].identifier == codec.LMT_REPLY:
                rest, length = received[0].data[3:], len(received[0].data)
                if not any(rest) and length in (7, 8):
                    outcome = readings.get(received[0].data[:3], outcome)
            driver.judge.reading("lmt_error_reply", outcome, "MACC-LMT-05")
        driver.client.target.take_spontaneous()
        configure(driver, codec.lmt_leave())
        no_boot_up(driver, "MACC-LMT-07")
        masked = [bad & 0x7F for bad in BAD_ADDRESSES]
        stays(driver, "MACC-LMT-05", *masked)


@check("MACC-LMT-06", "MACC-ID-03", safety=DESTRUCTIVE, needs=ALONE)
def without_entering_no_address_is_taken(session: Session) -> None:
    """An address given outside configuration mode is ignored in silence; extended frames and those
    of another mode do not enter it."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    new = next(address for address in NEW_ADDRESSES if address != driver.client.address)
    body = codec.lmt_enter().data
    entries: list[tuple[Frame | None, str]] = [
        (None, "MACC-LMT-06"),
        (Frame(codec.LMT_REQUEST, body, is_extended=True), "MACC-ID-03"),
        (Frame(codec.LMT_REQUEST << 18, body, is_extended=True), "MACC-ID-03"),
        (Frame(codec.LMT_REQUEST, is_remote=True, asked_length=8), "MACC-ID-03"),
        (Frame(codec.LMT_REPLY, body), "MACC-LMT-06"),
    ]
    with address_put_back(driver):
        for entry, name in entries:
            if entry is not None:
                silently(driver, entry, name)
            silently(driver, codec.lmt_address(new), name)
            driver.client.target.take_spontaneous()
            silently(driver, codec.lmt_leave(), name)
            driver.client.boot_up(boot_silence_limit_s(driver))
            stays(driver, name, new)


@check("MACC-LMT-07", safety=DESTRUCTIVE, needs=ALONE)
def leaving_without_an_address_does_nothing_else(session: Session) -> None:
    """Entering and leaving without an address restarts nothing, and ends the configuration mode."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    new = next(address for address in NEW_ADDRESSES if address != driver.client.address)
    with address_put_back(driver):
        silently(driver, codec.lmt_enter(), "MACC-LMT-07")
        driver.client.target.take_spontaneous()
        silently(driver, codec.lmt_leave(), "MACC-LMT-07")
        no_boot_up(driver, "MACC-LMT-07")
        stays(driver, "MACC-LMT-07")
        silently(driver, codec.lmt_address(new), "MACC-LMT-07")
        stays(driver, "MACC-LMT-07", new)


@check("MACC-LMT-08", safety=DESTRUCTIVE, needs=ALONE)
def requests_are_served_at_the_old_address_meanwhile(session: Session) -> None:
    """In configuration mode, before and after the address is given, uploads and downloads are
    served at the old address; or none is."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    new = next(address for address in NEW_ADDRESSES if address != driver.client.address)
    with address_put_back(driver):
        for frame in (codec.lmt_enter(), codec.lmt_address(new)):
            configure(driver, frame)
            for index in (*codec.ANSWERED, 0x0F, 0x18):
                kind = driver.client.within(quiet_s(driver.client.target), index).kind
                served = ReplyKind.ANSWER if index in codec.ANSWERED else ReplyKind.ACCEPTED
                outcome = {served: 0, ReplyKind.SILENCE: 1}.get(
                    kind, f"{kind.value} to {index:02X}h"
                )
                driver.judge.reading("lmt_sdo", outcome)
        nobody_at(driver, new, None)


@check("MACC-LMT-09", "MACC-LMT-03", safety=DESTRUCTIVE, needs=ALONE)
def other_lmt_services_are_ignored(session: Session) -> None:
    """Selective switching, inquiries, storing and bit timing get no reply and change nothing, in
    configuration mode or not; the procedure around them still holds."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    services = [*SWITCHES, *WHO, LMT_STORE]
    if session.transport.is_virtual:
        services = [*services, RATE_SERVICES[0]]
    new = next(address for address in NEW_ADDRESSES if address != driver.client.address)
    with address_put_back(driver):
        for service in services:
            _judge_service(driver, service, is_configuring=False)
        stays(driver, "MACC-LMT-09")
        configure(driver, codec.lmt_enter())
        for service in services:
            _judge_service(driver, service, is_configuring=True)
        configure(driver, codec.lmt_address(new))
        store(driver)
        configure(driver, codec.lmt_leave())
        boot_up, _ = await_boot_up(driver, address=new)
        session.expect(
            boot_up is not None and answers(driver, new),
            ("MACC-LMT-09", "MACC-LMT-03"),
            f"an answer at address {new}",
            "silence",
        )


def _judge_service(driver: CanDriver, service: int, *, is_configuring: bool) -> None:
    received = lmt_replies(driver, codec.lmt(service))
    if received and all(frame.identifier == codec.LMT_REPLY for frame in received):
        outcome: int | tuple[int, ...] | str = 1
    elif received:
        outcome = f"{described(received)} to service {service:02X}h"
    else:
        is_telling = is_configuring and service in REPLIED_BY_THE_CONVENTION
        outcome = 0 if is_telling and not driver.readings.known("lmt_other") else (0, 1)
    driver.judge.reading("lmt_other", outcome, "MACC-LMT-09")


# --- factory reset -------------------------------------------------------------------------------


@check("MACC-CMD-01-01", "MACC-CMD-01-02", "MACC-CMD-1C-01", safety=DESTRUCTIVE, needs=ALONE)
def a_factory_reset_brings_the_factory_values(session: Session) -> None:
    """2001h writes the factory values over all parameters; the module boots and answers as 1."""
    driver = CanDriver(session)
    place = driver.motion.finish(driver.motion.go(driver.motion.ready() + 25))
    changed = factory.overwrite(driver, 0)
    with address_put_back(driver):
        give_address(driver, NEW_ADDRESSES[0])
        driver.client.address = NEW_ADDRESSES[0]
        session.step(
            answers(driver, driver.client.address),
            f"an answer at address {driver.client.address}",
            "silence",
        )
        is_restarted = _reset_to_factory(driver)
        driver.judge.reading("factory_reset_scope", int(not is_restarted), "MACC-CMD-01-02")
        session.expect(
            answers(driver, FACTORY_ADDRESS),
            ("MACC-CMD-01-01", "MACC-CMD-01-02"),
            "answers on 581h",
            "silence",
        )
        nobody_at(driver, NEW_ADDRESSES[0], "MACC-CMD-01-01")
        factory.judge_values(driver, changed)
        factory.judge_again(driver, lambda: _reset_to_factory(driver))
        kept = driver.client.position()
        session.expect(kept == place, "MACC-CMD-01-01", f"position {place} kept", kept)


def _reset_to_factory(driver: CanDriver) -> bool:
    """Send 2001h, judge the reply.  True if the module restarts as module 1."""
    driver.client.target.take_spontaneous()
    exchange = driver.client.within(QUIET_S * 2, 0x01)
    outcome: int | str = {ReplyKind.ACCEPTED: 0, ReplyKind.SILENCE: 1}.get(
        exchange.kind, str(exchange.reply)
    )
    driver.judge.reading("reset_reply", outcome, "MACC-CMD-01-01")
    boot_up, _ = await_boot_up(driver, boot_silence_limit_s(driver), FACTORY_ADDRESS)
    old, driver.client.address = driver.client.address, FACTORY_ADDRESS
    is_old = old != FACTORY_ADDRESS and driver.client.boot_up(0, old) is not None
    driver.session.expect(not is_old, "MACC-CMD-01-02", f"no boot-up message as {old}", "one")
    return boot_up is not None
