"""Whose frame it is: identifiers, and forms of frames (ID)."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import velocity
from axistwin_conformance.families.mac.axis.driver.unknown_modules import unknown_module_at
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.parameters import PARAMETER_QUERIES, PARAMETERS
from axistwin_conformance.families.mac.axis.probes.sync import is_held
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.checks.messages import NMT_START
from axistwin_conformance.families.mac.can.codec import CanRequest
from axistwin_conformance.families.mac.can.collect_replies import (
    described,
    everybody,
    replies,
    the_reply,
    unknown_addresses,
)
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.settings import TORQUE
from axistwin_conformance.transport.can_frame import Frame

ORDER = 30  # of this module in a run; see `Family.modules`

AT_ONCE: Final = 8  # frames sent in a row before it is listened for a reply
# Identifiers that mean something to a module, or to every CANopen device on a bus.
MEANINGFUL: Final = frozenset({codec.NMT, codec.SYNC, codec.LMT_REQUEST, codec.REQUEST})
# What a module of address adr does not listen to, as bases of the standard's identifiers: none of
# them reaches another device of a real bus.
OTHER_BASES: Final = (
    0x100, 0x180, 0x200, 0x280, 0x300, 0x380, 0x400, 0x480, 0x500, 0x580, 0x680, 0x700, 0x780,
)  # fmt: skip
# Those without an address: 100h, the standard's time, and 080h mean something to others.
OTHER_GENERAL: Final = (
    0x180, 0x200, 0x280, 0x300, 0x380, 0x400, 0x480, 0x500, 0x580, 0x680, 0x700, 0x780,
)  # fmt: skip
STRANGE_COMMANDS: Final = (0x22, 0x60)  # neither download nor upload
LONG: Final = 100  # increments at the slowest speed: longer than what is sent meanwhile
BURST: Final = 5  # segments: one more than any module takes
REMOTE_LENGTHS: Final = (0, 1, 8)
TORQUES: Final = (0x21, 0x22)  # of 200Ch, both inside the range of every model
FOREIGN: Final = (0x33, 0x4C, 0x5A)
HELD: Final = (0x20, *PARAMETER_QUERIES)


# --- individual addresses ------------------------------------------------------------------------


@check("MACC-ID-01", "MACC-SDO-06")
def it_answers_once_on_the_identifier_of_its_address(session: Session) -> None:
    """A request on 600h plus the address gets one reply, on 580h plus the address."""
    driver = CanDriver(session)
    for index in codec.ANSWERED:
        reply = the_reply(driver, driver.client.request(index), ("MACC-ID-01", "MACC-SDO-06"))
        driver.session.step(reply.kind is ReplyKind.ANSWER, "an answer", reply)


@check("MACC-ID-02", "MACC-SDO-06")
def requests_to_other_addresses_get_no_reply(session: Session) -> None:
    """No upload asked of an address that nobody has is answered by anybody."""
    driver = CanDriver(session)
    for address in unknown_addresses(session):
        received = replies(
            driver, driver.client.request(0x20, address=address).frame(), is_awaited=False
        )
        hint = unknown_module_at(driver.client, address) if received else ""
        session.expect(
            not received,
            ("MACC-ID-02", "MACC-SDO-06"),
            f"silence at {address}",
            described(received),
            hint,
        )
    driver.judge.alive("MACC-ID-02")


@check("MACC-ID-02", safety=MOVES)
def downloads_to_other_addresses_do_nothing(session: Session) -> None:
    """Commands for another address neither move this module nor change its parameters."""
    driver = CanDriver(session)
    start = driver.motion.ready()
    before = [driver.client.value(index) for index in HELD]
    other = _nobody(driver)
    cases = [(0x0D, 0x1456), (0x0F, 0x21), (0x0B, 0), (0x0C, 0x11), (0x09, 0x1234)]
    if not session.envelope.is_guarded:  # or a module that nobody has named might be there and move
        cases += [(0x13, start + 300), (0x15, velocity(1, SLOWEST)), (0x00, 0)]
    _told(driver, *(driver.client.request(*case, address=other) for case in cases))
    torque = driver.client.request(0x0C, TORQUE.other(driver), address=other)
    _told(driver, *(replace(torque, command=command) for command in STRANGE_COMMANDS))
    following = session.address % codec.ADDRESSES[-1] + 1
    if following not in session.neighbours and not unknown_module_at(driver.client, following):
        _told(driver, replace(torque, address=following))
    after = [driver.client.value(index) for index in HELD]
    session.expect(after == before, "MACC-ID-02", _hex(before), _hex(after))


def _nobody(driver: CanDriver) -> int:
    """An address where nobody is."""
    session = driver.session
    taken = {session.address, *session.neighbours}
    other = next(address for address in FOREIGN if address not in taken)
    hint = unknown_module_at(driver.client, other)  # before it is told anything
    if hint:
        session.fail("MACC-ID-02", f"silence at {other}", "an answer to 2000h", hint)
    return other


def _told(driver: CanDriver, *requests: CanRequest) -> None:
    """Judge that nobody answers what is said to an address where nobody is."""
    for request in requests:
        received = replies(driver, request.frame(), is_awaited=False)
        driver.session.expect(
            not received,
            "MACC-ID-02",
            f"silence at {request.address} to {request.frame()}",
            described(received),
        )


@check("MACC-ID-02", "MACC-SDO-06", safety="stored")
def beside_its_own_requests_those_for_others_are_ignored(session: Session) -> None:
    """Right before and right behind a request of its own, one for another address is not answered
    and sets nothing; its own gets its reply."""
    driver = CanDriver(session)
    other, before = _nobody(driver), TORQUE.read(driver)
    value = TORQUE.parameter(TORQUE.other(driver))
    own = driver.client.request(0x22).frame()
    reply = (codec.REPLY + driver.client.address, own.data[1:4])
    for foreign in (
        driver.client.request(0x26, address=other).frame(),
        driver.client.request(0x0C, value, address=other).frame(),
    ):
        for row in ((own, foreign), (foreign, own), (own, foreign, own)):
            received = replies(driver, *row)
            seen = [(frame.identifier, frame.data[1:4]) for frame in received]
            session.expect(
                seen == [reply] * row.count(own),
                ("MACC-ID-02", "MACC-SDO-06"),
                f"a reply to each {own}, none else, in the row {'; '.join(map(str, row))}",
                described(received),
            )
    after = TORQUE.read(driver)
    session.expect(after == before, "MACC-ID-02", f"torque {before:02X}", f"{after:02X}")


def _said_by_others(other: int) -> list[Frame]:
    """What another module says, and what network management tells it."""
    replied = (b"\x42\x00", b"\x60\x13", b"\x60\x18", b"\x80\x13")
    bodies = [head + b"\x20\x00" + codec.ZEROS for head in replied]
    errors = (bytes(codec.EMERGENCY_BYTES), b"\x00\x42\x09\x10\x00\x00\x00\x00")
    return [
        *(Frame(codec.REPLY + other, body) for body in bodies),
        *(codec.boot_up(other, form) for form in codec.BOOT_UP_FORMS),
        *(Frame(codec.EMERGENCY + other, error) for error in errors),
        codec.nmt(NMT_START, other),
    ]


@check("MACC-ID-02", "MACC-CMD-10-01", safety=MOVES)
def what_others_are_told_neither_starts_nor_disarms_it(session: Session) -> None:
    """While it is armed, holds a motion or moves, commands for another address and what is said
    from there change nothing."""
    driver = CanDriver(session)
    neighbours = [CanDriver(session, address) for address in session.neighbours[:1]]
    places = [neighbour.motion.ready() for neighbour in neighbours]
    start = driver.motion.ready(SLOWEST)
    other = _nobody(driver)
    far = start + driver.limits.way_outlasting(LONG, SLOWEST, 2 * BURST)

    def told(*cases: tuple[int, int]) -> None:
        _told(driver, *(driver.client.request(*case, address=other) for case in cases))

    def overheard() -> None:
        for frame in _said_by_others(other):
            driver.client.target.send(frame)

    driver.judge.accepted(0x10)
    for neighbour, place in zip(neighbours, places, strict=True):
        neighbour.judge.accepted(0x13, place)
    if not session.envelope.is_guarded:
        told((0x13, far), (0x14, 0), (0x15, 0))
    overheard()
    driver.judge.accepted(0x13, far)
    names = ("MACC-ID-02", "MACC-CMD-10-01")
    wanted_text = f"held at {start} whatever others were sent, and said"
    session.expect(is_held(driver, start), names, wanted_text, driver.client.position())
    for index in (0x11, 0x17, 0x18):
        told((index, 0))
        wanted_text = f"held at {start} after {driver.client.named(index)} to {other}"
        session.expect(is_held(driver, start), "MACC-ID-02", wanted_text, driver.client.position())
    overheard()
    held = is_held(driver, start)
    wanted_text = f"held at {start} whatever another module says"
    session.expect(held, "MACC-ID-02", wanted_text, driver.client.position())
    forecast = driver.motion.to_position(driver.judge.accepted(0x11), start, far)
    driver.client.wait(driver.motion.lasting_s(LONG // 4))  # the counter of who starts at 0 is not
    overheard()
    told((0x0B, 0), (0x17, 0), (0x18, 0))
    driver.motion.finish(forecast, "MACC-ID-02")
    driver.motion.at_rest()
    told((0x10, 0))
    driver.motion.finish(driver.motion.go(start), "MACC-ID-02")


@check("MACC-ID-01", "MACC-ID-02", "MACC-SDO-06", safety="stored", needs=("neighbour",))
def each_module_answers_and_obeys_its_own_identifier(session: Session) -> None:
    """Of several modules each answers for itself, once, and stores what it alone was told."""
    drivers = everybody(session)[:2]
    names = ("MACC-ID-01", "MACC-SDO-06")
    for driver, torque in zip(drivers, TORQUES, strict=True):
        the_reply(driver, driver.client.request(0x24), names)
        reply = the_reply(driver, driver.client.request(0x0C, torque), names)
        session.step(reply.kind is ReplyKind.ACCEPTED, "60h", reply)
    for driver, torque in zip(drivers, TORQUES, strict=True):
        seen = driver.client.parameter(0x0C)
        session.expect(
            seen == torque,
            "MACC-ID-02",
            f"torque {torque:02X} at {driver.client.address}",
            f"{seen:02X}",
        )


def _other_identifiers(driver: CanDriver) -> list[int]:
    if not driver.client.target.is_virtual:
        return [base + driver.client.address for base in OTHER_BASES] + list(OTHER_GENERAL)
    modules = {codec.REQUEST + module.client.address for module in everybody(driver.session)}
    silent = MEANINGFUL | modules | {codec.LMT_REPLY}
    return [number for number in range(0x800) if number not in silent]


@check("MACC-ID-01", "MACC-ID-02", level="full")
def no_other_identifier_reaches_a_module(session: Session) -> None:
    """An upload request under any identifier without a meaning gets no reply."""
    driver = CanDriver(session)
    body = driver.client.request(0x20).frame().data
    identifiers = _other_identifiers(driver)
    for at in range(0, len(identifiers), AT_ONCE):
        some = identifiers[at : at + AT_ONCE]
        received = replies(driver, *(Frame(frame, body) for frame in some), is_awaited=False)
        # Under 600h and an address that is not this module's, somebody else may be meant.
        meant = [
            reply - codec.REQUEST for reply in some if reply - codec.REQUEST in codec.ADDRESSES
        ]
        hints = [unknown_module_at(driver.client, address) for address in meant if received]
        session.expect(
            not received,
            ("MACC-ID-01", "MACC-ID-02"),
            f"silence under {some[0]:03X}h..{some[-1]:03X}h",
            described(received),
            next((hint for hint in hints if hint), ""),
        )
    driver.judge.alive("MACC-ID-01")


# --- forms of frames -----------------------------------------------------------------------------


def _extended(plain: Frame) -> list[Frame]:
    """A frame's identifier as a number of 29 bits, as the first 11 of them, and with others set."""
    own = plain.identifier
    places = (own, own << 18, own << 18 | 0x3FFFF, own | 1 << 28)
    return [Frame(place, plain.data, is_extended=True) for place in places]


@check("MACC-ID-03")
def extended_frames_are_ignored(session: Session) -> None:
    """An upload request in a frame of 29 bits gets no reply, wherever the own identifier stands."""
    driver = CanDriver(session)
    for address in (driver.client.address, codec.GENERAL_ADDRESS):
        plain = driver.client.request(0x20, address=address).frame()
        for frame in _extended(plain):
            driver.judge.silent(frame)


@check("MACC-ID-03")
def remote_frames_are_ignored(session: Session) -> None:
    """A remote frame gets no reply under any identifier that a module receives or sends."""
    driver = CanDriver(session)
    own = [base + driver.client.address for base in (codec.REQUEST, codec.REPLY, codec.EMERGENCY)]
    if session.reading("nmt_supported") == "false":  # by the standard 700h is guarding
        own.append(codec.BOOT_UP + driver.client.address)
    for identifier in (*own, codec.REQUEST, codec.SYNC):
        for length in REMOTE_LENGTHS:
            driver.client.target.take_spontaneous()
            driver.judge.silent(Frame(identifier, is_remote=True, asked_length=length))
            spontaneous_messages = [
                str(arrival.frame)
                for arrival in driver.client.target.take_spontaneous()
                if _guards(arrival.frame)
            ]
            session.expect(
                not spontaneous_messages, None, "not a frame", " ".join(spontaneous_messages)
            )


def _guards(frame: Frame) -> bool:
    """True for what lies under a boot-up's identifier; a lifebeat may come at any time."""
    return frame.identifier - codec.BOOT_UP in codec.ADDRESSES


@check("MACC-ID-03", safety="stored")
def extended_and_remote_frames_change_nothing(session: Session) -> None:
    """A download in a frame of 29 bits is not obeyed, nor is a remote frame."""
    driver = CanDriver(session)
    before = driver.client.value(0x26)
    other = PARAMETERS[0x0C].read(before) ^ 0x03
    download = driver.client.request(0x0C, other).frame()
    for plain in (download, driver.client.to_all(0x0C, other).frame()):
        for frame in _extended(plain):
            driver.judge.silent(frame)
    driver.judge.silent(Frame(download.identifier, is_remote=True, asked_length=8))
    after = driver.client.value(0x26)
    session.expect(after == before, None, f"2006h {before:08X}", f"{after:08X}")


def _hex(values: list[int]) -> str:
    return " ".join(f"{value:08X}" for value in values)
