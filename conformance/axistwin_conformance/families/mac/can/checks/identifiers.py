"""Whose frame it is: identifiers, forms of frames, and what is said to all (ID, GEN)."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S, AxisExchange
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.driver.unknown_modules import unknown_module_at
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import Forecast, Segment
from axistwin_conformance.families.mac.axis.parameters import PARAMETER_QUERIES, PARAMETERS
from axistwin_conformance.families.mac.axis.probes.sync import is_held, wait_steps
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.boot_up import await_boot_up
from axistwin_conformance.families.mac.can.codec import CanRequest
from axistwin_conformance.families.mac.can.collect_replies import (
    described,
    everybody,
    replies,
    the_reply,
    unknown_addresses,
)
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.settings import SETTINGS, TORQUE
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
MOST_LOOKS: Final = 20  # exchanges during a move
BURST: Final = 5  # segments: one more than any module takes
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


@check("MACC-ID-02", "MACC-CMD-10-01", safety=MOVES)
def what_others_are_told_neither_starts_nor_disarms_it(session: Session) -> None:
    """While it is armed, holds a motion or moves, commands for another address change nothing."""
    driver = CanDriver(session)
    neighbours = [CanDriver(session, address) for address in session.neighbours[:1]]
    places = [neighbour.motion.ready() for neighbour in neighbours]
    start = driver.motion.ready(SLOWEST)
    other = _nobody(driver)
    far = start + driver.limits.way_outlasting(LONG, SLOWEST, 2 * BURST)

    def told(*cases: tuple[int, int]) -> None:
        _told(driver, *(driver.client.request(*case, address=other) for case in cases))

    driver.judge.accepted(0x10)
    for neighbour, place in zip(neighbours, places, strict=True):
        neighbour.judge.accepted(0x13, place)
    if not session.envelope.is_guarded:
        told((0x13, far), (0x14, 0), (0x15, 0))
    driver.judge.accepted(0x13, far)
    names = ("MACC-ID-02", "MACC-CMD-10-01")
    wanted_text = f"held at {start} whatever motion others were sent"
    session.expect(is_held(driver, start), names, wanted_text, driver.client.position())
    for index in (0x11, 0x17, 0x18):
        told((index, 0))
        wanted_text = f"held at {start} after {driver.client.named(index)} to {other}"
        session.expect(is_held(driver, start), "MACC-ID-02", wanted_text, driver.client.position())
    forecast = driver.motion.to_position(driver.judge.accepted(0x11), start, far)
    driver.client.wait(driver.motion.lasting_s(LONG // 4))  # the counter of who starts at 0 is not
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


def nobody_unnamed(driver: CanDriver) -> None:
    """Leave the check if somebody is on the bus whom nobody has named: what is said to all would
    be said to him as well."""
    session, client = driver.session, driver.client
    if client.target.is_builtin:
        return
    taken = {session.address, *session.neighbours}
    others = [address for address in codec.ADDRESSES if address not in taken]
    for at in range(0, len(others), AT_ONCE):
        some = others[at : at + AT_ONCE]
        frames = [client.request(0x20, address=address).frame() for address in some]
        received = replies(driver, *frames, is_awaited=False)
        if received:
            hints = [unknown_module_at(client, address) for address in some]
            who = next((hint for hint in hints if hint), f"who sends {described(received)}?")
            session.inconclusive(None, f"what all are told, others may obey: {who}")


def _tell_all(driver: CanDriver, index: int, parameter: int = 0) -> ReplyKind:
    """Send a command to all; what module 1 replies, if there is one: nobody else is waited for."""
    request = driver.client.to_all(index, parameter)
    received = replies(driver, request.frame(), is_awaited=_has_spokesman(driver.session))
    return codec.parse(received[0] if received else None, driver.client.byte_order).kind


@check("MACC-GEN-01", "MACC-PERS-01", "MACC-BOOT-01", safety=MOVES)
def a_setting_for_all_outlasts_a_restart_for_all(session: Session) -> None:
    """200Ch on 600h is stored; 2000h on 600h ends with a boot-up message, and what is then said to
    all first is obeyed."""
    driver = CanDriver(session)
    nobody_unnamed(driver)
    for module in everybody(session):
        module.motion.at_rest()
    torque, catch_up = TORQUE.other(driver), SETTINGS[0x0E].other(driver)

    _tell_all(driver, 0x0C, TORQUE.parameter(torque))
    seen = TORQUE.read(driver)
    wanted_text = f"torque {torque:02X} after 200Ch to all"
    session.expect(seen == torque, "MACC-GEN-01", wanted_text, f"{seen:02X}")
    driver.client.target.take_spontaneous()
    _tell_all(driver, 0x00)
    boot_up, _ = await_boot_up(driver)
    names = ("MACC-BOOT-01", "MACC-GEN-01")
    came = "none" if boot_up is None else boot_up.frame
    session.expect(boot_up is not None, names, "a boot-up message after 2000h to all", came)
    driver.motion.wait_awake()
    _tell_all(driver, 0x0E, SETTINGS[0x0E].parameter(catch_up))
    seen = SETTINGS[0x0E].read(driver)
    wanted_text = f"catch-up speed {catch_up:02X} after 200Eh to all, the first request"
    session.expect(seen == catch_up, "MACC-GEN-01", wanted_text, f"{seen:02X}")
    seen = TORQUE.read(driver)
    wanted_text = f"torque {torque:02X} as set by 200Ch to all, kept by 2000h"
    session.expect(seen == torque, ("MACC-PERS-01", "MACC-GEN-01"), wanted_text, f"{seen:02X}")


@check("MACC-GEN-01", "MACC-CMD-16-01", "MACC-STATE-01", safety=MOVES)
def what_all_are_told_follows_the_same_rules(session: Session) -> None:
    """2010h on 600h holds the next motion back and 2011h starts it; a move locks what 600h carries
    as well, and segments on 600h are refused by a full FIFO."""
    driver = CanDriver(session)
    nobody_unnamed(driver)
    start = driver.motion.ready(SLOWEST)
    far = start + driver.limits.way_outlasting(LONG, SLOWEST, MOST_LOOKS)
    try:
        _tell_all(driver, 0x10)
        driver.judge.accepted(0x13, far)
        wanted_text = f"held at {start} after 2010h to all"
        is_waiting = is_held(driver, start)
        session.expect(is_waiting, "MACC-GEN-01", wanted_text, driver.client.position())
        window = driver.client.broadcast(driver.client.to_all(0x11).frame())
        begun = AxisExchange(b"", codec.SILENCE, window)
        forecast = driver.motion.to_position(begun, start, far)
        _judge_locked_for_all(driver, forecast)
        driver.motion.finish(forecast, "MACC-GEN-01")
        driver.motion.at_rest()
        _judge_burst_for_all(driver)
    finally:
        for module in everybody(session):
            module.motion.at_rest()


def _judge_locked_for_all(driver: CanDriver, forecast: Forecast) -> None:
    """In a move, what is locked is so for what comes on 600h."""
    end, locked = forecast.end, [0x02]
    assert end is not None
    if driver.session.reading("motion_lock_set") == "can_list":
        locked.append(0x0D)
    for index in locked:
        setting = SETTINGS[index]
        before, value = setting.read(driver), setting.other(driver)
        kind = _tell_all(driver, index, setting.parameter(value))
        after = setting.read(driver)
        driver.motion.taken_in_time(driver.client.ask(0x20), end.earliest_ns, "the move")
        is_told = driver.client.address == codec.SPOKESMAN and kind is not ReplyKind.REFUSED
        driver.session.expect(
            after == before and not is_told,
            ("MACC-STATE-01", "MACC-GEN-01"),
            f"{driver.client.named(index)} to all refused in a move, {before:02X} kept",
            f"{kind.value}, {after:02X}",
        )


def _judge_burst_for_all(driver: CanDriver) -> None:
    """Of five long segments on 600h in a burst the first three are accepted, the last is not."""
    if driver.client.address != codec.SPOKESMAN:
        driver.session.not_run("MACC-CMD-16-01", "module 1 alone tells whether it took a segment")
        return
    steps = max(LONG, driver.limits.steps_outlasting(SLOWEST, 2 * BURST))
    segment = Segment(wait_steps(driver) + steps, SLOWEST, moves=False)
    parameter = segment_parameter(segment.steps, segment.period)
    begun_ns = driver.client.target.now_ns
    kinds = [_tell_all(driver, 0x1E, parameter) for _ in range(BURST)]
    driver.motion.taken_in_time(
        driver.client.ask(0x20), begun_ns + segment.duration_ns, "the first segment"
    )
    is_right = kinds[:3] == [ReplyKind.ACCEPTED] * 3 and kinds[-1] is ReplyKind.REFUSED
    driver.session.expect(
        is_right,
        ("MACC-CMD-16-01", "MACC-GEN-01"),
        "three or four segments to all accepted, the fifth refused",
        ", ".join(kind.value for kind in kinds),
    )


@check("MACC-GEN-02", "MACC-Q-06-01", safety="stored")
def module_1_answers_all_with_what_it_holds(session: Session) -> None:
    """Each upload on 600h tells what module 1 tells by itself."""
    drivers = {driver.client.address: driver for driver in everybody(session)}
    if codec.SPOKESMAN not in drivers:
        session.skip("there is no module 1 on this bus")
    if session.reading("general_upload") != "answer":
        session.skip("this device ignores uploads on 600h (MACC-AMB-20)")
    driver = drivers[codec.SPOKESMAN]
    for index, parameter in ((0x02, 1), (0x03, 8)):  # two digits of one byte, which differ
        driver.judge.accepted(index, parameter)
    for index in PARAMETER_QUERIES:
        own = driver.client.value(index)
        received = replies(driver, driver.client.to_all(index).frame())
        data = codec.parse(received[0], driver.client.byte_order).data if received else None
        session.expect(
            len(received) == 1 and data == own,
            ("MACC-GEN-02", "MACC-Q-06-01") if index == 0x26 else "MACC-GEN-02",
            f"{driver.client.named(index)} to all tells {own:08X}, as to module 1",
            described(received),
        )


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
