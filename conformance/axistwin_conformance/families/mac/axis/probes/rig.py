"""Which readings a module follows where somebody has to work its inputs, supply or shaft."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.mac.axis.driver.motion import QUIET_S, SLOWEST, Bench
from axistwin_conformance.families.mac.axis.driver.rig import rig_bench_of
from axistwin_conformance.families.mac.axis.exchanges import Kind
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED, reply_of
from axistwin_conformance.families.mac.axis.snapshot import facts_of

ORDER = 110  # of this module in a run; see `Family.modules`

WORKED: Final = ("motion", "stored", "rig")
STEPS: Final = 100
PACE: Final = 0x2000
TOO_MUCH_VOLTS: Final = 70.0  # above every model's warning
WIDEST: Final = 0xFF


@probe(safety=WORKED, needs=("rig:hold",))
def position_source(bench: Bench) -> Outcome:
    """20h at the end of a move whose shaft is held."""
    moved, _ = _held(bench, 0)
    return 0 if moved <= STEPS // 10 else 1 if moved == STEPS else f"{moved} increments"


@probe(safety=WORKED, needs=("rig:hold",))
def running_until(bench: Bench) -> Outcome:
    """0Dh after a move whose shaft is held: far off with no tolerance, then within a wide one."""
    _, far_off = _held(bench, 0)
    if far_off is Kind.ACCEPTED:
        return 2
    if bench.session.reading("cmd_1c_supported") == "false":
        bench.session.skip("without 1Ch nothing tells the tolerance from the exact position")
    _, within = _held(bench, WIDEST)
    return ACCEPTED_OR_REFUSED.get(within, f"{within.value} to 0Dh")


def _held(bench: Bench, tolerance: int) -> tuple[int, Kind]:
    """Move with the shaft held; how far 20h then says it came, and the reply to 02h, which every
    list locks."""
    start = bench.ready(SLOWEST if not bench.session.rig.is_exact else PACE)
    bench.command(0x1C, tolerance)
    bench.session.rig.hold_shaft(True)
    bench.accepted(0x13, start + STEPS)
    bench.wait(STEPS * bench.period * TICK_NS / 1e9 + 0.1)
    moved = bench.position() - start
    kind = bench.command(0x02, 0).kind
    bench.at_rest()
    bench.session.rig.hold_shaft(False)
    bench.command(0x1C, 0)
    return moved, kind


@probe(safety=WORKED, needs=("rig:positive_stop",))
def hard_stop_command(bench: Bench) -> Outcome:
    """13h toward an active hardware stop."""
    start = bench.ready()
    bench.accepted(0x03, 1)
    bench.session.rig.set_input("positive_stop", True)
    kind = bench.command(0x13, start + STEPS).kind
    bench.at_rest()
    bench.session.rig.set_input("positive_stop", False)
    bench.accepted(0x03, 0)
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=WORKED, needs=("rig:reference",))
def ref_edge(bench: Bench) -> Outcome:
    """Which edge of the reference contact clears the counter in a positive move."""
    if not bench.session.rig.is_exact:
        bench.session.skip("needs a rig that acts at once")
    start = bench.ready(SLOWEST)
    with rig_bench_of(bench.session).reference_enabled():
        bench.accepted(0x13, start + 3 * STEPS)
        bench.wait(0.3)
        places = [bench.position()]
        for active in (True, False):
            bench.session.rig.set_input("reference", active)
            places.append(bench.position())
        bench.at_rest()
    return _which_edge(bench, places)


def _which_edge(bench: Bench, places: list[int]) -> Outcome:
    """A counter that was cleared reads next to 0 a moment later: before, closed, open again."""
    is_low = [abs(place) <= STEPS // 20 for place in places]
    if is_low[0]:
        bench.session.skip("the counter is near 0 anyhow")
    if True not in is_low:
        return f"places {places}: never cleared"
    closing = is_low.index(True) == 1
    _put_origin_back(bench, places[0] if closing else places[1])
    return int(closing)


def _put_origin_back(bench: Bench, here: int) -> None:
    """Clear the counter where it was 0 before; `here`: the place that is 0 now, then."""
    if abs(here) <= bench.room():
        bench.ready()
        bench.finish(bench.go(-here))
        bench.command(0x0B)


@probe(safety=WORKED, needs=("rig:reference",))
def ref_retarget(bench: Bench) -> Outcome:
    """The end of a move in which the reference cleared the counter."""
    if not bench.session.rig.is_exact:
        bench.session.skip("needs a rig that acts at once")
    rig = bench.session.rig
    start = bench.ready(PACE)
    target = start + 2 * STEPS
    if abs(target) > bench.room():
        bench.session.skip("counter 0 is outside the envelope")
    opening = not bench.known("ref_edge")
    rig.set_input("reference", opening)
    with rig_bench_of(bench.session).reference_enabled():
        bench.accepted(0x13, target)
        bench.wait(0.1)
        before = bench.position()
        rig.set_input("reference", not opening)
        bench.position()  # near the edge, or the envelope loses count of where that was
        bench.wait(1.0 + bench.lasting_s(abs(target)))
        final = bench.position()
        bench.at_rest()
    rig.set_input("reference", False)
    _put_origin_back(bench, before)
    if final == target:
        return 0
    # The edge comes some increments after `before` was read.
    return 1 if 0 <= target - before - final <= STEPS // 2 else f"at rest at {final}"


@probe(safety=("motion", "rig"), needs=("rig:reset",))
def has_reset_input(bench: Bench) -> Outcome:
    """20h while the reset input is active."""
    bench.session.rig.set_input("reset", True)
    kind = bench.within(QUIET_S, 0x20).kind
    bench.session.rig.set_input("reset", False)
    bench.wait_awake()
    return reply_of(kind, {Kind.SILENCE: 0, Kind.ANSWER: 1})


@probe(safety=("motion", "rig"), needs=("rig:supply",))
def status_hh_bit(bench: Bench) -> Outcome:
    """hh of 21h after an over-voltage."""
    bench.session.rig.set_supply(TOO_MUCH_VOLTS)
    bench.wait(0.1)
    seen = bench.data_bytes(0x21)
    bench.session.rig.reset()
    bench.reinitialise()
    reserved = 0x7F if bench.session.reading("reserved_bits") == "1" else 0
    hh = seen[3]
    if hh & 0x80 and hh & 0x7F in (0, reserved):
        return 0
    return 1 if hh & 0x7F else f"hh {hh:02X} after {TOO_MUCH_VOLTS:.0f} V"


@probe(safety=WORKED, needs=("rig:micro_cut",))
def disj_refuse_set(bench: Bench) -> Outcome:
    """17h after a fault."""
    bench.ready()
    bench.session.rig.fault("micro_cut", True)
    bench.session.rig.fault("micro_cut", False)
    bench.wait(0.1)
    is_faulty = bool(bench.data_bytes(0x21)[0] & 0x1F)
    kind = bench.command(0x17).kind
    bench.reinitialise()
    if not is_faulty:
        bench.session.skip("21h shows no fault after a micro-cut")
    return reply_of(kind, {Kind.REFUSED: 0, Kind.ACCEPTED: 1})


@probe(safety=WORKED, needs=("rig:encoder",))
def encoder_fault_locks(bench: Bench) -> Outcome:
    """13h while the encoder is not found."""
    if facts_of(bench.session).imax is not None:
        bench.session.skip("a MAC23 tells no such fault (dd.1 is a MAC34's)")
    start = bench.ready()
    bench.session.rig.fault("encoder", True)
    kind = bench.command(0x13, start).kind
    bench.session.rig.fault("encoder", False)
    bench.reinitialise()
    return reply_of(kind, {Kind.REFUSED: 0, Kind.ACCEPTED: 1})


@probe()
def power_on_at_boot(bench: Bench) -> Outcome:
    """Whether the motor is powered after start-up."""
    bench.session.skip("nothing on the line tells: it takes a hand on the shaft")


@probe()
def position_overflow(bench: Bench) -> Outcome:
    """What the counter does at its ends."""
    bench.session.skip("they are 1073741824 increments away, beyond any sensible envelope")
