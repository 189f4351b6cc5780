"""Which readings a module follows where somebody has to work its inputs, supply or shaft."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.facts import facts_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED, reply_of

ORDER = 110  # of this module in a run; see `Family.modules`

WORKED: Final = ("motion", "stored", "rig")
STEPS: Final = 100
SLOW_PERIOD: Final = 0x2000
TOO_MUCH_VOLTS: Final = 70.0  # above every model's warning
WIDEST: Final = 0xFF


@probe(safety=WORKED, needs=("rig:hold",))
def position_source(driver: AxisDriver) -> Outcome:
    """20h at the end of a move whose shaft is held."""
    moved, _ = _held(driver, 0)
    return 0 if moved <= STEPS // 10 else 1 if moved == STEPS else f"{moved} increments"


@probe(safety=WORKED, needs=("rig:hold",))
def running_until(driver: AxisDriver) -> Outcome:
    """0Dh after a move whose shaft is held: far off with no tolerance, then within a wide one."""
    _, far_off = _held(driver, 0)
    if far_off is ReplyKind.ACCEPTED:
        return 2
    if driver.session.reading("cmd_1c_supported") == "false":
        driver.session.skip("without 1Ch nothing tells the tolerance from the exact position")
    _, within = _held(driver, WIDEST)
    return ACCEPTED_OR_REFUSED.get(within, f"{within.value} to 0Dh")


def _held(driver: AxisDriver, tolerance: int) -> tuple[int, ReplyKind]:
    """Move with the shaft held; how far 20h then says it came, and the reply to 02h, which every
    list locks."""
    start = driver.motion.ready(SLOWEST if not driver.session.rig.is_exact else SLOW_PERIOD)
    driver.client.command(0x1C, tolerance)
    driver.session.rig.work("hold", True)
    driver.judge.accepted(0x13, start + STEPS)
    driver.client.wait(STEPS * driver.motion.period * TICK_NS / 1e9 + 0.1)
    moved = driver.client.position() - start
    kind = driver.client.command(0x02, 0).kind
    driver.motion.at_rest()
    driver.session.rig.work("hold", False)
    driver.client.command(0x1C, 0)
    return moved, kind


@probe(safety=WORKED, needs=("rig:positive_stop",))
def hard_stop_command(driver: AxisDriver) -> Outcome:
    """13h toward an active hardware stop."""
    start = driver.motion.ready()
    driver.judge.accepted(0x03, 1)
    driver.session.rig.work("positive_stop", True)
    kind = driver.client.command(0x13, start + STEPS).kind
    driver.motion.at_rest()
    driver.session.rig.work("positive_stop", False)
    driver.judge.accepted(0x03, 0)
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=WORKED, needs=("rig:reference",))
def ref_edge(driver: AxisDriver) -> Outcome:
    """Which edge of the reference contact clears the counter in a positive move."""
    if not driver.session.rig.is_exact:
        driver.session.skip("needs a rig that acts at once")
    start = driver.motion.ready(SLOWEST)
    with driver_of(driver.session).rig.reference_enabled():
        driver.judge.accepted(0x13, start + 3 * STEPS)
        driver.client.wait(0.3)
        places = [driver.client.position()]
        for active in (True, False):
            driver.session.rig.work("reference", active)
            places.append(driver.client.position())
        driver.motion.at_rest()
    return _which_edge(driver, places)


def _which_edge(driver: AxisDriver, places: list[int]) -> Outcome:
    """A counter that was cleared reads next to 0 a moment later: before, closed, open again."""
    is_low = [abs(place) <= STEPS // 20 for place in places]
    if is_low[0]:
        driver.session.skip("the counter is near 0 anyhow")
    if True not in is_low:
        return f"places {places}: never cleared"
    closing = is_low.index(True) == 1
    _put_origin_back(driver, places[0] if closing else places[1])
    return int(closing)


def _put_origin_back(driver: AxisDriver, here: int) -> None:
    """Clear the counter where it was 0 before; `here`: the place that is 0 now, then."""
    if abs(here) <= driver.limits.room():
        driver.motion.ready()
        driver.motion.finish(driver.motion.go(-here))
        driver.client.command(0x0B)


@probe(safety=WORKED, needs=("rig:reference",))
def ref_retarget(driver: AxisDriver) -> Outcome:
    """The end of a move in which the reference cleared the counter."""
    if not driver.session.rig.is_exact:
        driver.session.skip("needs a rig that acts at once")
    rig, limits = driver.session.rig, driver.limits
    start = driver.motion.ready(limits.unhurried(SLOW_PERIOD))
    # It is still moving when the edge has come behind two exchanges.
    target = start + limits.way_outlasting(2 * STEPS, driver.motion.period, exchanges=4)
    if abs(target) > limits.room():
        driver.session.skip("counter 0 is outside the envelope")
    opening = not driver.readings.known("ref_edge")
    rig.work("reference", opening)
    with driver_of(driver.session).rig.reference_enabled():
        driver.judge.accepted(0x13, target)
        driver.client.wait(0.1)
        before = driver.client.position()
        rig.work("reference", not opening)
        driver.client.position()  # near the edge, or the envelope loses count of where that was
        driver.client.wait(1.0 + driver.motion.lasting_s(abs(target)))
        final = driver.client.position()
        driver.motion.at_rest()
    rig.work("reference", False)
    _put_origin_back(driver, before)
    if final == target:
        return 0
    # The edge comes some increments after `before` was read.
    most = max(STEPS // 2, limits.steps_outlasting(driver.motion.period, exchanges=1))
    return 1 if 0 <= target - before - final <= most else f"at rest at {final}"


@probe(safety=("motion", "rig"), needs=("rig:reset",))
def has_reset_input(driver: AxisDriver) -> Outcome:
    """20h while the reset input is active."""
    driver.session.rig.work("reset", True)
    kind = driver.client.within(QUIET_S, 0x20).kind
    driver.session.rig.work("reset", False)
    driver.motion.wait_awake()
    return reply_of(kind, {ReplyKind.SILENCE: 0, ReplyKind.ANSWER: 1})


@probe(safety=("motion", "rig"), needs=("rig:supply",))
def status_hh_bit(driver: AxisDriver) -> Outcome:
    """hh of 21h before and after an over-voltage."""
    driver.motion.reinitialise()  # or an earlier one may still be remembered
    idle = driver.status.memories()  # bits that mean nothing may be ones
    driver.session.rig.work("supply", TOO_MUCH_VOLTS)
    driver.client.wait(0.1)
    seen = driver.status.memories()
    driver.session.rig.reset()
    driver.motion.reinitialise()
    readings = {0x80: 0, 0x7F: 1}
    return readings.get(seen & ~idle, f"hh {idle:02X}, {seen:02X} after {TOO_MUCH_VOLTS:.0f} V")


@probe(safety=WORKED, needs=("rig:micro_cut",))
def disj_refuse_set(driver: AxisDriver) -> Outcome:
    """17h after a fault."""
    driver.motion.ready()
    driver.session.rig.work("micro_cut", True)
    driver.session.rig.work("micro_cut", False)
    driver.client.wait(0.1)
    is_faulty = bool(driver.client.data_bytes(0x21)[0] & 0x1F)
    kind = driver.client.command(0x17).kind
    driver.motion.reinitialise()
    if not is_faulty:
        driver.session.skip("21h shows no fault after a micro-cut")
    return reply_of(kind, {ReplyKind.REFUSED: 0, ReplyKind.ACCEPTED: 1})


@probe(safety=WORKED, needs=("rig:encoder",))
def encoder_fault_locks(driver: AxisDriver) -> Outcome:
    """13h while the encoder is not found."""
    if facts_of(driver.session).imax is not None:
        driver.session.skip("a MAC23 tells no such fault (dd.1 is a MAC34's)")
    start = driver.motion.ready()
    driver.session.rig.work("encoder", True)
    kind = driver.client.command(0x13, start).kind
    driver.session.rig.work("encoder", False)
    driver.motion.reinitialise()
    return reply_of(kind, {ReplyKind.REFUSED: 0, ReplyKind.ACCEPTED: 1})


@probe()
def power_on_at_boot(driver: AxisDriver) -> Outcome:
    """Whether the motor is powered after start-up."""
    driver.session.skip("nothing on the line tells: it takes a hand on the shaft")


@probe()
def position_overflow(driver: AxisDriver) -> Outcome:
    """What the counter does at its ends."""
    driver.session.skip("they are 1073741824 increments away, beyond any sensible envelope")
