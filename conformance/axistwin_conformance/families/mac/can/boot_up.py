"""A module that restarts: its boot-up message, what it says before, and when (BOOT)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from axistwin_conformance.families.mac.axis.driver.client import AxisExchange, quiet_s
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import TimeWindow
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.collect_replies import slack_ns
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.probes.messages import longest_boot_s
from axistwin_conformance.transport.can import Arrival
from axistwin_conformance.transport.can_frame import Frame

# What MACC-BOOT-04 leaves to MACC-AMB-25, unless the device was found to take another time.
BOOT_MS: Final = range(1500, 2501)


@dataclass(frozen=True, slots=True)
class SeenRestart:
    """What came of 2000h: the exchange, when the restart began, the boot-up message, if any, and
    what this module said before it."""

    exchange: AxisExchange
    since: TimeWindow
    boot_up: Arrival | None
    before: tuple[Arrival, ...]


def boot_silence_limit_s(driver: CanDriver) -> float:
    """How long a boot-up message is waited for."""
    if "boot_time_ms" in driver.session.readings:
        return driver.motion.awake_surely_s + driver.client.target.uncertainty_ns / 1e9
    return longest_boot_s(driver)


def restart(driver: CanDriver) -> SeenRestart:
    """Send 2000h and listen up to the boot-up message."""
    driver.client.target.take_spontaneous()
    exchange = driver.client.within(quiet_s(driver.client.target), 0x00)
    boot_up, before = await_boot_up(driver)
    return SeenRestart(exchange, taken_over(driver, exchange), boot_up, before)


def taken_over(driver: CanDriver, exchange: AxisExchange) -> TimeWindow:
    """When a request was taken over to which nothing need come: a wait in vain is no part of it."""
    taken = exchange.taken
    if exchange.kind is not ReplyKind.SILENCE:
        return taken
    return TimeWindow(taken.earliest_ns, taken.earliest_ns + driver.client.frame_ns)


def await_boot_up(
    driver: CanDriver, seconds: float | None = None, address: int | None = None
) -> tuple[Arrival | None, tuple[Arrival, ...]]:
    """The boot-up message of the module, or of that address, and what it said before; None if none
    comes."""
    whom = driver.client.address if address is None else address
    deadline_ns = driver.client.target.now_ns + round(
        (seconds or boot_silence_limit_s(driver)) * 1e9
    )
    before: list[Arrival] = []

    def is_ours(frame: Frame) -> bool:
        return codec.spontaneous_from(frame) == whom

    while (left_ns := deadline_ns - driver.client.target.now_ns) > 0:
        arrival = driver.client.target.receive_spontaneous(is_ours, left_ns / 1e9)
        if arrival is None:
            break
        if codec.boot_up_form(arrival.frame) is not None:
            return arrival, tuple(before)
        before.append(arrival)
    return None, tuple(before)


def judge_form(driver: CanDriver, boot_up: Arrival, requirement: str = "MACC-BOOT-02") -> None:
    """Which reading of MACC-AMB-04 a boot-up message shows."""
    form = codec.boot_up_form(boot_up.frame)
    readings = list(codec.BOOT_UP_FORMS)
    outcome: int | str = readings.index(form) if form else str(boot_up.frame)
    driver.judge.reading("bootup_form", outcome, requirement)


def judge_time(driver: CanDriver, since: TimeWindow, boot_up: Arrival, requirement: str) -> None:
    """The time from a restart to its boot-up message: 2 s, or what the device was found to take."""
    deaf_ns = round(driver.motion.deaf_s * 1e9)
    slack = slack_ns(driver, deaf_ns)
    sent_ns = boot_up.time_ns - driver.client.target.least_time_ns(boot_up.frame)
    is_held = since.earliest_ns - slack <= sent_ns - deaf_ns <= since.latest_ns + slack
    passed_ms = round((sent_ns - since.latest_ns) / 1e6)
    session, found = driver.session, round(deaf_ns / 1e6)
    if not is_held and "boot_time_ms" not in session.readings:
        session.expect(
            passed_ms in BOOT_MS,
            requirement,
            f"boot-up {BOOT_MS[0]}..{BOOT_MS[-1]} ms after the restart",
            f"{passed_ms} ms",
        )
        found = passed_ms
    else:
        session.expect(is_held, requirement, f"boot-up after {found} ms", f"{passed_ms} ms")
    session.quirk(requirement, "boot_time_ms", str(found))
