"""What is said to all, on 600h: who obeys it, and who answers (GEN)."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S, AxisExchange
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import (
    STANDS_S,
    segment_parameter,
    velocity,
)
from axistwin_conformance.families.mac.axis.driver.unknown_modules import unknown_module_at
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import Forecast, Segment
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS
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
)
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.settings import SETTINGS, TORQUE

ORDER = 35  # of this module in a run; see `Family.modules`

AT_ONCE: Final = 8  # frames sent in a row before it is listened for a reply
LONG: Final = 100  # increments at the slowest speed: longer than what is sent meanwhile
MOST_LOOKS: Final = 20  # exchanges during a move
BURST: Final = 5  # segments: one more than any module takes
TORQUES: Final = (0x21, 0x22)  # of 200Ch, both inside the range of every model
STOPS: Final = (0x0012_3456, 0x0023_4567)  # of 2009h


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
    query = first.client.to_all(0x22)
    received = replies(first, query.frame())
    if not received or not _has_spokesman(session):
        session.expect(
            judge_general(first, query) is ReplyKind.SILENCE,
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


@check("MACC-GEN-01", "MACC-GEN-02", safety=MOVES)
def what_all_are_told_counts_in_motion_as_well(session: Session) -> None:
    """In endless motion, either way, in segments and in a move a setting on 600h is taken, and
    2017h or 2018h on 600h ends the motion; module 1 accepts each."""
    driver = CanDriver(session)
    nobody_unnamed(driver)
    period = driver.limits.gentle(SLOWEST, 3.0)
    steps = driver.limits.way_outlasting(LONG, SLOWEST, MOST_LOOKS)
    for index, sign, stop in (
        (0x15, 1, 0x18),
        (0x15, -1, 0x17),
        (0x16, 1, 0x18),
        (0x13, 1, 0x17),
    ):
        start = driver.motion.ready(SLOWEST)
        parameters = {0x13: start + steps, 0x15: velocity(sign, period)}
        segment = segment_parameter(steps, SLOWEST)
        begun = driver.judge.accepted(index, parameters.get(index, segment)).taken
        torque = TORQUE.other(driver)
        kinds = [_tell_all(driver, 0x0C, TORQUE.parameter(torque))]
        seen = TORQUE.read(driver)
        amid = f"amid {driver.client.named(index)}"
        wanted_text = f"torque {torque:02X} after 200Ch to all {amid}"
        session.expect(seen == torque, "MACC-GEN-01", wanted_text, f"{seen:02X}")
        kinds.append(_tell_all(driver, stop))
        if index != 0x15:
            over_ns = begun.earliest_ns + steps * SLOWEST * TICK_NS
            driver.motion.taken_in_time(driver.client.ask(0x20), over_ns, "the motion")
        driver.motion.run_out()
        place = driver.client.position()
        driver.client.wait(STANDS_S)
        again = driver.client.position()
        wanted_text = f"at rest at {place} after {driver.client.named(stop)} to all {amid}"
        session.expect(again == place, "MACC-GEN-01", wanted_text, again)
        if driver.client.address == codec.SPOKESMAN:
            is_right = kinds == [ReplyKind.ACCEPTED] * 2
            came = ", ".join(kind.value for kind in kinds)
            session.expect(is_right, "MACC-GEN-02", f"both accepted {amid}", came)
        driver.motion.at_rest()


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
