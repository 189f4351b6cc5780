"""Whose frame it is: identifiers, forms of frames, and what is said to all (ID, GEN)."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import velocity
from axistwin_conformance.families.mac.axis.driver.unknown_modules import unknown_module_at
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.parameters import PARAMETER_QUERIES, PARAMETERS
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import CanRequest
from axistwin_conformance.families.mac.can.collect_replies import (
    described,
    everybody,
    replies,
    the_reply,
    unknown_addresses,
)
from axistwin_conformance.families.mac.can.driver import CanDriver
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
REMOTE_LENGTHS: Final = (0, 1, 8)
TORQUES: Final = (0x21, 0x22)  # of 200Ch, both inside the range of every model
STOPS: Final = (0x0012_3456, 0x0023_4567)  # of 2009h
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
    taken = {session.address, *session.neighbours}
    other = next(address for address in FOREIGN if address not in taken)
    hint = unknown_module_at(driver.client, other)  # before it is told anything
    if hint:
        session.fail("MACC-ID-02", f"silence at {other}", "an answer to 2000h", hint)
    cases = [(0x0D, 0x1456), (0x0F, 0x21), (0x0B, 0), (0x0C, 0x11), (0x09, 0x1234)]
    if not session.envelope.is_guarded:  # or a module that nobody has named might be there and move
        cases += [(0x13, start + 300), (0x15, velocity(1, SLOWEST)), (0x00, 0)]
    for index, parameter in cases:
        received = replies(
            driver, driver.client.request(index, parameter, address=other).frame(), is_awaited=False
        )
        session.expect(not received, "MACC-ID-02", f"silence at {other}", described(received))
    after = [driver.client.value(index) for index in HELD]
    session.expect(after == before, "MACC-ID-02", _hex(before), _hex(after))


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
        return [base + driver.client.address for base in OTHER_BASES]
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


# --- to all --------------------------------------------------------------------------------------


def general_wanted(driver: CanDriver) -> str:
    """What a request to all gets on this bus, in words."""
    return "one reply, module 1's" if _has_spokesman(driver.session) else "silence: no module 1"


def _has_spokesman(session: Session) -> bool:
    return codec.SPOKESMAN in (session.address, *session.neighbours)


def judge_general(driver: CanDriver, request: CanRequest) -> ReplyKind:
    """Judge who answers a request to all (MACC-GEN-02), and where (MACC-GEN-03)."""
    session, received = driver.session, replies(driver, request.frame())
    is_upload = request.command == codec.UPLOAD
    hint = (
        unknown_module_at(driver.client, codec.SPOKESMAN)
        if received and not _has_spokesman(session)
        else ""
    )
    if is_upload and not received and _has_spokesman(session):
        driver.judge.reading("general_upload", 1, "MACC-GEN-02")
        return ReplyKind.SILENCE
    is_right = len(received) == _has_spokesman(session)
    session.expect(is_right, "MACC-GEN-02", general_wanted(driver), described(received), hint)
    if not received:
        return ReplyKind.SILENCE
    if is_upload:
        driver.judge.reading("general_upload", 0, "MACC-GEN-02")
    whence = {codec.REPLY + 1: 0, codec.REQUEST + 1: 1}.get(
        received[0].identifier, str(received[0])
    )
    driver.judge.reading("general_reply_id", whence, "MACC-GEN-03")
    flaw = codec.mismatch(request, received[0])
    session.expect(
        not flaw, "MACC-GEN-02", codec.explain(request.frame()), described(received), flaw
    )
    return codec.parse(received[0], driver.client.byte_order).kind


@check("MACC-GEN-02", "MACC-GEN-03")
def module_1_alone_answers_what_all_are_asked(session: Session) -> None:
    """A request on 600h gets one reply, on 581h, if there is a module 1, and none if there is not.

    Uploads and downloads, with what is refused among them.
    """
    driver = CanDriver(session)
    unassigned = (0x12,) if session.reading("unknown_index") == "refuse" else ()
    for index in (*codec.ANSWERED, 0x11, *unassigned):
        kind = judge_general(driver, driver.client.to_all(index))
        if index in codec.ANSWERED and kind is not ReplyKind.SILENCE:
            session.expect(kind is ReplyKind.ANSWER, "MACC-GEN-02", "an answer", kind.value)
    driver.judge.alive("MACC-GEN-02")
    if not _has_spokesman(session):
        session.not_run("MACC-GEN-03", "there is no module 1 on this bus")


@check("MACC-GEN-01", "MACC-GEN-02", "MACC-GEN-03", safety="stored", needs=("neighbour",))
def a_setting_for_all_is_taken_by_all(session: Session) -> None:
    """200Ch and 2009h on 600h change every module; module 1 answers with its own value."""
    drivers = everybody(session)
    first = drivers[0]
    for torque in TORQUES:
        judge_general(first, first.client.to_all(0x0C, torque))
        for driver in drivers:
            seen = driver.client.parameter(0x0C)
            wanted_text = f"torque {torque:02X} at {driver.client.address}"
            session.expect(seen == torque, "MACC-GEN-01", wanted_text, f"{seen:02X}")
    for driver, stop in zip(drivers, STOPS, strict=False):
        driver.judge.accepted(0x09, stop)
    own = {driver.client.address: driver.client.value(0x22) for driver in drivers}
    asked = first.client.to_all(0x22)
    received = replies(first, asked.frame())
    if not received or not _has_spokesman(session):
        session.expect(
            judge_general(first, asked) is ReplyKind.SILENCE,
            "MACC-GEN-02",
            "silence",
            described(received),
        )
        if not _has_spokesman(session):
            session.not_run("MACC-GEN-03", "there is no module 1 on this bus")
        return
    answer = codec.parse(received[0], first.client.byte_order).data
    session.expect(
        answer == own[codec.SPOKESMAN],
        "MACC-GEN-02",
        f"2002h of module 1, {own[codec.SPOKESMAN]:08X}",
        described(received),
    )


@check("MACC-GEN-01", safety=MOVES, needs=("neighbour",))
def a_motion_for_all_moves_all_and_one_stop_ends_it(session: Session) -> None:
    """2015h on 600h sets every module in motion, 2018h on 600h ends it."""
    drivers = everybody(session)
    first = drivers[0]
    starts = [driver.motion.ready(SLOWEST) for driver in drivers]
    period = first.limits.gentle(0x2000, 4.0)  # until each has told that the stop has ended it
    try:
        replies(first, first.client.to_all(0x15, velocity(1, period)).frame())
        first.client.wait(0.3)
        replies(first, first.client.to_all(0x18).frame())
        for driver, start in zip(drivers, starts, strict=True):
            driver.motion.run_out()
            place = driver.client.position()
            session.expect(
                place > start,
                "MACC-GEN-01",
                f"module {driver.client.address} to have moved from {start}",
                f"position {place}",
            )
            driver.client.wait(0.1)
            again = driver.client.position()
            session.expect(again == place, "MACC-GEN-01", f"{driver.client.address} rests", again)
    finally:
        for driver, start in zip(drivers, starts, strict=True):
            driver.motion.at_rest()
            driver.motion.finish(driver.motion.go_plainly(start))


@check("MACC-GEN-01", "MACC-GEN-02", safety=MOVES, needs=("neighbour",))
def module_1_answers_for_itself_only(session: Session) -> None:
    """What module 1 refuses, another module may obey, and the other way round: the reply to 600h is
    module 1's own verdict."""
    drivers = {driver.client.address: driver for driver in everybody(session)}
    if codec.SPOKESMAN not in drivers:
        session.skip("there is no module 1 on this bus")
    spokesman = drivers.pop(codec.SPOKESMAN)
    other = next(iter(drivers.values()))
    for moving, resting, kind in (
        (spokesman, other, ReplyKind.REFUSED),
        (other, spokesman, ReplyKind.ACCEPTED),
    ):
        for driver in (moving, resting):
            driver.motion.ready(SLOWEST)
        start = moving.client.position()
        moving.judge.accepted(0x13, start + 200)
        reply = replies(spokesman, spokesman.client.to_all(0x02, 1).frame())
        moving.motion.at_rest()
        kinds = tuple(codec.parse(frame).kind for frame in reply)
        session.expect(kinds == (kind,), "MACC-GEN-02", f"{kind.value}, once", described(reply))
        for driver, wanted in ((moving, 0), (resting, 1)):
            seen = driver.client.parameter(0x02)
            wanted_text = f"standby {wanted} at {driver.client.address}"
            session.expect(seen == wanted, "MACC-GEN-01", wanted_text, seen)
        moving.motion.finish(moving.motion.go_plainly(start))


@check("MACC-GEN-02", safety="stored")
def a_general_request_must_be_whole_as_well(session: Session) -> None:
    """Too short a request on 600h is ignored by all, module 1 included."""
    driver = CanDriver(session)
    if session.reading("short_frame") != "ignore":
        session.skip("this device pads short frames (MACC-AMB-19)")
    before = driver.client.value(0x26)
    other = PARAMETERS[0x0C].read(before) ^ 0x03
    for length in range(8):
        for request in (driver.client.to_all(0x20), driver.client.to_all(0x0C, other)):
            driver.judge.silent(replace(request, length=length))
    after = driver.client.value(0x26)
    session.expect(after == before, None, f"2006h {before:08X}", f"{after:08X}")
    driver.client.wait(QUIET_S)


def _hex(values: list[int]) -> str:
    return " ".join(f"{value:08X}" for value in values)
