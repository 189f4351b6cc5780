"""Which readings a module follows in what it says unasked, and in a restart.

The lifebeat is waited for: each look takes some 11 s of the device's time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.driver.motion import DEAF_S
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import TimeWindow
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.transport.can import Arrival

ORDER = 30  # of this module in a run; see `Family.modules`

LIFEBEAT_S: Final = 10.0  # MACC-EMCY-01
LATE_S: Final = 0.4  # nobody says how exact the 10 s are
GENERAL_S: Final = 1.0  # between what all are told
NMT_START: Final = 0x01
NMT_STOP: Final = 0x02
LONGEST_BOOT_S: Final = 61.0
LONGEST_REAL_BOOT_S: Final = 8.0  # where waiting takes a person's time
REAL_STEP_MS: Final = 10  # what two looks in real time agree on
REAL_CLOCK_MS: Final = 20  # closer than that to 2 s is 2 s, on a module with its own quartz
NEVER_SPEAKS: Final = "it says nothing unasked but its boot-up message"


# --- lifebeat ------------------------------------------------------------------------------------


def spontaneous_messages(driver: CanDriver, seconds: float) -> list[Arrival]:
    """The emergency and lifebeat messages of the module within that time."""
    driver.client.wait(seconds)
    return [
        arrival for arrival in driver.client.target.take_spontaneous() if _is_ours(driver, arrival)
    ]


def _is_ours(driver: CanDriver, arrival: Arrival) -> bool:
    address = codec.spontaneous_from(arrival.frame)
    return address == driver.client.address and codec.is_emergency(arrival.frame)


def lifebeat(driver: CanDriver) -> Arrival | None:
    """The next message of that kind, for which the module is left alone; None: none in time."""
    driver.client.target.take_spontaneous()
    return driver.client.emergency(LIFEBEAT_S + LATE_S + driver.client.target.uncertainty_ns / 1e9)


def speaks(driver: CanDriver) -> None:
    """Leave the probe if there is no such message on this device."""
    if driver.session.reading("emcy_payload") == "none":
        driver.session.skip(NEVER_SPEAKS)


@probe()
def emcy_payload(driver: CanDriver) -> Outcome:
    """What comes after 10 s of silence, beside 2001h."""
    status = bytes(driver.client.data_bytes(0x21))
    message = lifebeat(driver)
    return 3 if message is None else payload_readings(message, status)


def payload_readings(message: Arrival, status: bytes) -> Outcome:
    """The readings of MACC-AMB-05 that explain a message of a module whose 2001h reads `status`;
    which code stands for a fault, is another question."""
    data, code = message.frame.data, message.frame.data[:3]
    is_coded = bool(codec.error_of(status[0])[0]) or not any(code)
    shapes = {
        0: is_coded and data == code + status + b"\0",
        1: data == status.ljust(codec.EMERGENCY_BYTES, b"\0"),
        2: is_coded and data == code.ljust(codec.EMERGENCY_BYTES, b"\0"),
    }
    fitting = tuple(number for number, fits in shapes.items() if fits)
    return fitting or f"{message.frame} while 2001h reads {status.hex(' ').upper()}"


@probe()
def lifebeat_restart(driver: CanDriver) -> Outcome:
    """2000h once, then each second on 600h: when the module speaks within 10 s of its own
    request."""
    speaks(driver)
    driver.client.wait(LATE_S)  # so that a message of before is not taken for one of now
    driver.client.target.take_spontaneous()
    before = spontaneous_messages(driver, LATE_S)
    own = driver.client.ask(0x20).taken
    over_ns = own.latest_ns + round((LIFEBEAT_S + LATE_S) * 1e9)
    general = driver.client.to_all(0x20).frame()
    while over_ns - driver.client.target.now_ns > LATE_S * 1e9:
        driver.client.target.send(general)
        driver.client.wait(min(GENERAL_S, (over_ns - driver.client.target.now_ns) / 1e9 - LATE_S))
    messages = [
        *before,
        *spontaneous_messages(driver, (over_ns - driver.client.target.now_ns) / 1e9),
    ]
    return _restarted_by(own, [message.time_ns for message in messages])


def _restarted_by(own: TimeWindow, spoken_ns: Sequence[int]) -> Outcome:
    """The reading of MACC-AMB-06: spoken 10 s after the own request, not at all, or otherwise; a
    free-running module has then spoken 10 s before that, too."""
    if not spoken_ns:
        return 1
    period_ns, late_ns = round(LIFEBEAT_S * 1e9), round(LATE_S * 1e9)
    due_ns = own.earliest_ns + period_ns - late_ns, own.latest_ns + period_ns + late_ns
    if len(spoken_ns) == 1:
        return 0 if due_ns[0] <= spoken_ns[0] <= due_ns[1] else 2
    gaps_ns = [later - sooner for sooner, later in pairwise(spoken_ns)]
    if all(abs(gap - period_ns) <= late_ns for gap in gaps_ns):
        return 2
    return f"{len(spoken_ns)} messages, {', '.join(f'{gap / 1e9:.1f} s' for gap in gaps_ns)} apart"


# --- network management, restart -----------------------------------------------------------------


@probe(safety="motion")
def nmt_supported(driver: CanDriver) -> Outcome:
    """000h 02 and the address, then 2000h; then 000h 01 to make it good."""
    driver.motion.at_rest()
    driver.client.target.send(codec.nmt(NMT_STOP, driver.client.address))
    kind = driver.client.within(QUIET_S, 0x20).kind
    driver.client.target.send(codec.nmt(NMT_START, driver.client.address))
    if kind is ReplyKind.ANSWER:
        return 0
    is_back = driver.client.within(QUIET_S, 0x20).kind is ReplyKind.ANSWER
    return 1 if kind is ReplyKind.SILENCE and is_back else f"{kind.value} after 000h 02"


@dataclass(frozen=True, slots=True)
class Restart:
    """What came of 2000h: the reply, when the restart began, the boot-up message if one came."""

    reply: ReplyKind
    since_ns: int
    boot_up: Arrival | None


def longest_boot_s(driver: CanDriver) -> float:
    """How long a boot-up message is waited for while nobody knows when it comes."""
    return LONGEST_BOOT_S if driver.client.target.is_virtual else LONGEST_REAL_BOOT_S


def restarted(driver: CanDriver) -> Restart:
    """Send 2000h at rest and wait for the boot-up message."""
    driver.motion.at_rest()
    driver.client.target.take_spontaneous()
    exchange = driver.client.within(QUIET_S, 0x00)
    if exchange.kind is ReplyKind.SILENCE:  # it restarts when it would have replied (MACC-AMB-26)
        answered_ns = exchange.taken.earliest_ns + driver.client.target.round_trip.median_ns
        since_ns = answered_ns - driver.client.frame_ns
    else:
        since_ns = exchange.taken.latest_ns
    return Restart(exchange.kind, since_ns, driver.client.boot_up(longest_boot_s(driver)))


@probe(safety="motion", switch="reset_reply")
def reply_to_a_reset(driver: CanDriver) -> Outcome:
    """2000h."""
    restart = restarted(driver)
    readings = {ReplyKind.ACCEPTED: 0, ReplyKind.SILENCE: 1}
    if restart.boot_up is None:
        return f"{restart.reply.value}, and no boot-up message"
    return readings.get(restart.reply, restart.reply.value)


@probe(safety="motion")
def bootup_form(driver: CanDriver) -> Outcome:
    """2000h, then the message that comes."""
    message = restarted(driver).boot_up
    form = None if message is None else codec.boot_up_form(message.frame)
    return Measured(form) if form else f"no boot-up message for {longest_boot_s(driver):.0f} s"


@probe(safety="motion", switch="boot_time_ms")
def time_to_the_boot_up(driver: CanDriver) -> Outcome:
    """2000h, then the time to the boot-up message."""
    restart = restarted(driver)
    if restart.boot_up is None:
        return f"no boot-up message for {longest_boot_s(driver):.0f} s"
    begun_ns = restart.boot_up.time_ns - driver.client.target.least_time_ns(restart.boot_up.frame)
    step_ms = 1 if driver.client.target.is_virtual else REAL_STEP_MS
    passed_ms = step_ms * round((begun_ns - restart.since_ns) / (step_ms * 1e6))
    default_ms = round(DEAF_S * 1e3)
    doubt_ms = 0
    if not driver.client.target.is_virtual:
        doubt_ms = REAL_CLOCK_MS + driver.client.target.uncertainty_ns // 10**6
    if restart.reply is ReplyKind.SILENCE:
        doubt_ms += driver.client.target.round_trip.median_ns // 10**6
    return Measured(str(default_ms if abs(passed_ms - default_ms) <= doubt_ms else passed_ms))
