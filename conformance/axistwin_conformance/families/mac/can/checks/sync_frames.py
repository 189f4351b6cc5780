"""What the frame 080h starts and what it does not (SYNC)."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.checks.sync import judge_refused_amid
from axistwin_conformance.families.mac.axis.driver.client import AxisExchange
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.model.forecast import Forecast, Segment, TimeWindow
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS
from axistwin_conformance.families.mac.axis.probes.sync import back, is_held
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.checks.messages import NMT_START
from axistwin_conformance.families.mac.can.collect_replies import (
    described,
    everybody,
    replies,
    unknown_addresses,
)
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.transport.can_frame import Frame

ORDER = 70  # of this module in a run; see `Family.modules`

PERIOD: Final = 0x1000  # 512 us an increment
STEPS: Final = 60
SLOW: Final = 0x8000  # 4 ms an increment: frames on the bus are told apart from steps
SEVERAL: Final = 3
ON_THE_WAY_S: Final = 0.05
OTHERS: Final = (0x700, 0x80)  # beside those that differ by one bit: what is added to 080h
NO_COMMANDS: Final = (0x20, 0x21, 0x60, 0x80)  # first bytes of what is no request


def preload(driver: CanDriver, index: int, parameter: int = 0) -> None:
    """Arm, and hold a motion back."""
    driver.judge.accepted(0x10)
    driver.judge.accepted(index, parameter)


def started(driver: CanDriver, frame: Frame) -> AxisExchange:
    """What begins with a frame that is not answered, for forecasts."""
    return _begun(driver.client.broadcast(frame))


def _begun(window: TimeWindow) -> AxisExchange:
    return AxisExchange(b"", codec.SILENCE, window)


def sync_silently(driver: CanDriver, frame: Frame, requirement: str) -> None:
    """Judge that nobody answers."""
    received = replies(driver, frame, is_awaited=False)
    driver.session.expect(not received, requirement, f"silence to {frame}", described(received))


@check("MACC-SYNC-01", "MACC-SYNC-03", safety=MOVES)
def sync_starts_a_preloaded_move(session: Session) -> None:
    """A move preloaded after 2010h starts on SYNC (080h), and is the same as on 2011h."""
    driver = CanDriver(session)
    start = driver.motion.ready(PERIOD, 1)
    for begin in ("SYNC", "2011h"):
        preload(driver, 0x13, start + STEPS)
        session.expect(
            is_held(driver, start), "MACC-SYNC-01", f"at {start}", driver.client.position()
        )
        by_frame = begin == "SYNC"
        exchange = started(driver, codec.sync()) if by_frame else driver.judge.accepted(0x11)
        forecast = driver.motion.to_position(exchange, start, start + STEPS)
        name = "MACC-SYNC-01" if by_frame else "MACC-SYNC-03"
        locked = driver.client.command(0x02, 0)  # by every reading of the list
        driver.motion.watch(forecast, name)
        judge_refused_amid(driver, forecast, locked, "MACC-SYNC-03")
        session.expect(True, "MACC-SYNC-03", "the same motion", "the same")
        driver.motion.at_rest()
        driver.motion.finish(driver.motion.go(start))


@check("MACC-SDO-12", "MACC-SDO-05", safety=MOVES)
def what_does_nothing_leaves_what_2010h_has_begun(session: Session) -> None:
    """What is refused, or is no request, and the uploads of the commands' indices neither arm nor
    disarm, and leave the motion that is preloaded."""
    driver = CanDriver(session)
    request = driver.client.request
    for name, requests in (
        ("MACC-SDO-12", [request(index) for index in (0x04, 0x12, 0x1F)]),
        ("MACC-SDO-12", [replace(request(0x10), command=number) for number in NO_COMMANDS]),
        ("MACC-SDO-05", [replace(request(0x20), index_low=low) for low in range(0x08, 0x20)]),
    ):
        if requests[0].command in NO_COMMANDS and driver.readings.known("sdo_other_ccs") == 1:
            continue  # it takes them for 23h (MACC-AMB-13)
        frames = [one.frame() for one in requests]
        start = driver.motion.ready(PERIOD)
        if session.reading("sync_arm_lifetime") != "permanent":  # else it may be armed as it is
            _send_each(driver, frames)
            start = driver.motion.finish(driver.motion.go(start + STEPS), name)
        driver.judge.accepted(0x10)
        _send_each(driver, frames)
        driver.judge.accepted(0x13, start - STEPS)
        _send_each(driver, frames)
        held = is_held(driver, start)
        session.expect(held, name, f"held at {start}", driver.client.position())
        exchange = started(driver, codec.sync())
        driver.motion.finish(driver.motion.to_position(exchange, start, start - STEPS), name)
        driver.motion.at_rest()


def _send_each(driver: CanDriver, frames: list[Frame]) -> None:
    """Whatever comes of them, if anything does, other checks judge."""
    for frame in frames:
        replies(driver, frame, is_awaited=False)


@check("MACC-SYNC-01", "MACC-SYNC-03", safety=MOVES)
def sync_starts_velocity_and_homing_too(session: Session) -> None:
    """2015h and 2014h held back by 2010h begin with the frame 080h as well."""
    driver = CanDriver(session)
    names = ("MACC-SYNC-01", "MACC-SYNC-03")
    for direction in (1, -1):
        start = driver.motion.ready(PERIOD)
        period = driver.limits.gentle(0x2000, 1.0)
        preload(driver, 0x15, velocity(direction, period))
        place = f"at {start}"
        session.expect(is_held(driver, start), "MACC-SYNC-01", place, driver.client.position())
        exchange = started(driver, codec.sync())
        forecast = driver.motion.to_velocity(exchange, start, direction, period)
        for _ in range(4):
            driver.client.wait(0.05)
            driver.motion.follow(forecast, names, driver.limits.allowance(period))
        driver.motion.at_rest()
        driver.motion.finish(driver.motion.go_plainly(start))
    if abs(start) > driver.limits.room():
        return
    end = driver.motion.finish(driver.motion.go(start + STEPS if start >= 0 else start - STEPS))
    preload(driver, 0x14)
    exchange = started(driver, codec.sync())
    driver.motion.watch(driver.motion.to_position(exchange, end, 0), names)


@check("MACC-SYNC-03", safety=MOVES, level="full")
def in_motion_sync_does_what_2011h_does(session: Session) -> None:
    """A speed preloaded in an endless motion is taken over on SYNC, if it is on 2011h."""
    driver = CanDriver(session)
    period = driver.limits.gentle(0x2000, 2.0)
    if 2 * period > SLOWEST:
        session.skip("the envelope leaves no two speeds that can be told apart")
    if not _is_taken_over(driver, period, "2011h"):
        session.skip("2011h in motion does not take a speed over on this device")
    is_taken = _is_taken_over(driver, period, "SYNC")
    session.expect(is_taken, None, "the preloaded speed from SYNC on", "the speed before")


def _is_taken_over(driver: CanDriver, period: int, begin: str) -> bool:
    """Whether a speed preloaded in motion is that of the axis from then on; on SYNC, whether the
    axis goes on otherwise than before."""
    driver.motion.ready(PERIOD)
    slow = min(SLOWEST, 4 * period)
    forecast = driver.motion.turn(1, slow)
    driver.client.command(0x10)
    driver.client.command(0x15, velocity(1, period))
    by_frame = begin == "SYNC"
    exchange = started(driver, codec.sync()) if by_frame else driver.client.command(0x11)
    samples = driver.motion.sampled(0.4, 6)
    driver.motion.disarm()
    changed = forecast.changed(exchange.taken, period)
    fitting = driver.motion.fit(samples, (forecast, changed))
    return 0 not in fitting if by_frame else fitting == [1]


@check("MACC-SYNC-01", safety=MOVES)
def one_sync_starts_one_motion_once(session: Session) -> None:
    """A second SYNC starts nothing again, and the next move begins without any."""
    driver = CanDriver(session)
    start = driver.motion.ready(PERIOD)
    preload(driver, 0x13, start + STEPS)
    exchange = started(driver, codec.sync())
    place = driver.motion.finish(driver.motion.to_position(exchange, start, start + STEPS))
    for _ in range(SEVERAL):
        driver.client.broadcast(codec.sync())
    session.expect(is_held(driver, place), None, f"at {place}", driver.client.position())
    driver.judge.accepted(0x13, start)
    if session.reading("sync_arm_lifetime") == "permanent":
        session.expect(
            is_held(driver, place), None, f"held back at {place}", driver.client.position()
        )
        driver.judge.reading("sync_arm_lifetime", 2)
        exchange = started(driver, codec.sync())
        driver.motion.finish(driver.motion.to_position(exchange, place, start))
        driver.motion.at_rest()
        return
    driver.client.wait(STEPS * PERIOD * TICK_NS / 1e9 + 0.1)
    end = driver.client.position()
    if end == place:
        driver.judge.reading("sync_arm_lifetime", 2)
    session.expect(end == start, None, f"back at {start} by itself", end)


@check("MACC-SYNC-02", "MACC-SYNC-04", safety="passive")
def sync_is_not_answered(session: Session) -> None:
    """Nobody answers SYNC, and where nothing is preloaded nothing moves."""
    driver = CanDriver(session)
    place = driver.client.position()
    for data in (b"", b"", b"\0", bytes(8)):
        sync_silently(driver, codec.sync(data), "MACC-SYNC-02")
        driver.judge.alive("MACC-SYNC-02")
    session.expect(
        is_held(driver, place), "MACC-SYNC-04", f"2000h still {place}", driver.client.position()
    )


@check("MACC-SYNC-02", "MACC-SYNC-04", safety=MOVES)
def sync_is_not_answered_by_who_obeys_it_either(session: Session) -> None:
    """SYNC that starts a motion is not answered; one during segments changes nothing."""
    driver = CanDriver(session)
    start = driver.motion.ready(SLOW)
    preload(driver, 0x13, start + 20)
    sync_silently(driver, codec.sync(), "MACC-SYNC-02")
    driver.client.wait(20 * SLOW * TICK_NS / 1e9 + 0.1)
    place = driver.client.position()
    session.expect(place == start + 20, "MACC-SYNC-02", f"{start + 20}, started", place)
    steps = back(driver, 20)
    exchange = driver.judge.accepted(0x16, segment_parameter(steps, SLOW))
    sync_silently(driver, codec.sync(), "MACC-SYNC-04")
    driver.client.wait_until(exchange.taken.latest_ns + 20 * SLOW * TICK_NS + 100_000_000)
    place += steps
    session.expect(
        driver.client.position() == place, "MACC-SYNC-04", place, driver.client.position()
    )


@check("MACC-SYNC-04", "MACC-SYNC-01", safety=MOVES)
def sync_neither_arms_nor_spends_what_is_armed(session: Session) -> None:
    """SYNC with nothing preloaded moves nothing and arms nothing: the next move begins at once."""
    driver = CanDriver(session)
    start = driver.motion.ready(PERIOD)
    driver.motion.finish(driver.motion.go(start + 5))
    for _ in range(SEVERAL):
        driver.client.broadcast(codec.sync())
    session.expect(is_held(driver, start + 5), "MACC-SYNC-04", start + 5, driver.client.position())
    forecast = driver.motion.go(start + STEPS)
    driver.motion.watch(forecast, "MACC-SYNC-04", samples=3)
    driver.motion.at_rest()
    place = driver.client.position()
    driver.judge.accepted(0x10)
    driver.client.broadcast(codec.sync())
    driver.judge.accepted(0x13, start)
    session.expect(
        is_held(driver, place), "MACC-SYNC-04", f"held at {place}", driver.client.position()
    )
    exchange = started(driver, codec.sync())
    driver.motion.finish(driver.motion.to_position(exchange, place, start), "MACC-SYNC-01")


@check("MACC-SYNC-04", "MACC-SYNC-03", safety=MOVES)
def without_a_preload_sync_leaves_every_motion_alone(session: Session) -> None:
    """SYNC and 2011h with nothing preloaded, after a preload that is spent, leave an endless motion
    of either direction, a move and a segment as they are."""
    driver = CanDriver(session)
    start = driver.motion.ready(SLOW, 1)
    preload(driver, 0x13, start + 5)
    exchange = started(driver, codec.sync())
    driver.motion.finish(driver.motion.to_position(exchange, start, start + 5))
    for index, sign in ((0x15, 1), (0x15, -1), (0x13, 1), (0x16, 1)):
        driver.motion.at_rest()
        start = driver.motion.ready(SLOW, int(index != 0x16))
        forecast = _begin(driver, index, sign, start)
        for number in range(SEVERAL):
            driver.client.wait(ON_THE_WAY_S)
            if number < SEVERAL - 1:
                driver.client.broadcast(codec.sync())
            else:
                driver.client.command(0x11)
            name = "MACC-SYNC-04" if number < SEVERAL - 1 else "MACC-SYNC-03"
            driver.client.wait(ON_THE_WAY_S)
            driver.motion.follow(forecast, name, driver.limits.allowance(driver.motion.period))
    driver.motion.at_rest()


def _begin(driver: CanDriver, index: int, sign: int, start: int) -> Forecast:
    """A motion that outlasts what `without_a_preload_sync_leaves_every_motion_alone` sends."""
    period = driver.limits.gentle(SLOW, 2.0)
    if index == 0x15:
        return driver.motion.turn(sign, period)
    steps = driver.limits.way_outlasting(2 * STEPS, SLOW, 4 * SEVERAL)
    if index == 0x13:
        return driver.motion.go(start + sign * steps)
    segment = Segment(sign * steps, SLOW)
    return driver.motion.to_segments(driver.motion.put(segment), start, segment)


@check("MACC-SYNC-05", safety=MOVES)
def data_of_a_sync_frame_are_ignored(session: Session) -> None:
    """SYNC with one to eight bytes starts what is preloaded like one without; or none of them
    does."""
    driver = CanDriver(session)
    start = driver.motion.ready(PERIOD)
    lengths = range(1, 9) if session.transport.is_virtual else (1, 8)
    for length in lengths:
        preload(driver, 0x13, start + STEPS)
        exchange = started(driver, codec.sync(bytes([0x80] * length)))
        if is_held(driver, start):
            driver.judge.reading("sync_dlc", 1)
            exchange = started(driver, codec.sync())
        else:
            driver.judge.reading("sync_dlc", 0)
        driver.motion.finish(driver.motion.to_position(exchange, start, start + STEPS))
        driver.motion.at_rest()
        driver.motion.finish(driver.motion.go(start))


@check("MACC-SYNC-01", "MACC-ID-03", safety=MOVES)
def no_other_frame_is_taken_for_sync(session: Session) -> None:
    """Neither an emergency message or start of another module, nor network management, nor an
    identifier that differs from 080h by one bit, nor an extended or remote frame 080h starts or
    drops what is preloaded."""
    driver = CanDriver(session)
    start = driver.motion.ready(PERIOD)
    preload(driver, 0x13, start + STEPS)
    lifebeat = bytes(codec.EMERGENCY_BYTES)
    others = unknown_addresses(session)
    frames = [(Frame(codec.EMERGENCY + other, lifebeat), "MACC-SYNC-01") for other in others]
    known = [codec.EMERGENCY + number for number in session.neighbours]
    near = [codec.SYNC ^ 1 << bit for bit in range(11)] + [codec.SYNC + base for base in OTHERS]
    frames += [(Frame(number), "MACC-SYNC-01") for number in near if number not in known]
    frames += [
        (frame, "MACC-SYNC-01")
        for frame in (codec.nmt(NMT_START, driver.client.address), codec.boot_up(others[0]))
    ]
    frames += [
        (Frame(codec.SYNC, is_extended=True), "MACC-ID-03"),
        (Frame(codec.SYNC << 18, is_extended=True), "MACC-ID-03"),
        (Frame(codec.SYNC, is_remote=True), "MACC-ID-03"),
    ]
    for frame, name in frames:
        driver.client.target.send(frame)
        place = driver.client.position()
        session.expect(place == start, name, f"held at {start} after {frame}", place)
    session.expect(is_held(driver, start), "MACC-SYNC-01", start, driver.client.position())
    exchange = started(driver, codec.sync())
    driver.motion.finish(driver.motion.to_position(exchange, start, start + STEPS), "MACC-SYNC-01")


# --- several modules -----------------------------------------------------------------------------


def _courses(
    drivers: list[CanDriver], exchange: AxisExchange, starts: list[int], steps: int
) -> list[Forecast]:
    return [
        driver.motion.to_position(exchange, start, start + steps)
        for driver, start in zip(drivers, starts, strict=True)
    ]


@check("MACC-SYNC-01", "MACC-GEN-01", safety=MOVES, needs=("neighbour",))
def one_sync_starts_all_modules_together(session: Session) -> None:
    """What is preloaded in several modules begins with one SYNC, or one 2011h to all, in all of
    them in the same window, and they stay in step."""
    drivers = everybody(session)
    first = drivers[0]
    starts = [driver.motion.ready(SLOW) for driver in drivers]
    try:
        for name, arm, begin in (
            ("MACC-SYNC-01", None, codec.sync()),
            ("MACC-GEN-01", first.client.to_all(0x10).frame(), first.client.to_all(0x11).frame()),
        ):
            if arm is not None:
                replies(first, arm)
            for driver, start in zip(drivers, starts, strict=True):
                if arm is None:
                    driver.judge.accepted(0x10)
                driver.judge.accepted(0x13, start + STEPS)
            held = all(
                is_held(module, start) for module, start in zip(drivers, starts, strict=True)
            )
            session.expect(held, name, "all held back", "not all")
            exchange = started(first, begin)
            forecasts = _courses(drivers, exchange, starts, STEPS)
            for _ in range(4):
                for driver, forecast in zip(drivers, forecasts, strict=True):
                    driver.motion.follow(forecast, name, driver.limits.allowance(SLOW))
            for driver, forecast in zip(drivers, forecasts, strict=True):
                driver.motion.finish(forecast, name)
            _all_back(drivers, starts)
    finally:
        _all_back(drivers, starts)


@check("MACC-SYNC-01", "MACC-SYNC-04", safety=MOVES, needs=("neighbour",))
def sync_leaves_a_module_that_is_not_armed_alone(session: Session) -> None:
    """Of two modules only the one that was told to wait begins with SYNC."""
    armed, other = everybody(session)[:2]
    starts = [driver.motion.ready(PERIOD) for driver in (armed, other)]
    preload(armed, 0x13, starts[0] + STEPS)
    exchange = started(armed, codec.sync())
    armed.motion.finish(
        armed.motion.to_position(exchange, starts[0], starts[0] + STEPS), "MACC-SYNC-01"
    )
    place = other.client.position()
    session.expect(place == starts[1], "MACC-SYNC-04", f"still at {starts[1]}", place)
    armed.motion.finish(armed.motion.go_plainly(starts[0]))


def _all_back(drivers: list[CanDriver], starts: list[int]) -> None:
    for driver, start in zip(drivers, starts, strict=True):
        driver.motion.at_rest()
        driver.motion.go_plainly(start)
    for driver, start in zip(drivers, starts, strict=True):
        driver.client.wait(
            abs(driver.client.position() - start) * driver.motion.period * TICK_NS / 1e9 + 0.1
        )
        driver.session.step(driver.client.position() == start, start, driver.client.position())
