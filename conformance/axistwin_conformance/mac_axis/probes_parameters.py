"""Which readings a module follows in what it shows and stores (MACS-AMB-09, -10, -46, -47, -59,
-60)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.mac_axis.bench import Bench
from axistwin_conformance.mac_axis.checks_queries import MEASURES_RESERVED, STATUS_RESERVED
from axistwin_conformance.mac_axis.dialogue import Kind
from axistwin_conformance.mac_axis.probing import ACCEPTED_OR_REFUSED, reply_of
from axistwin_conformance.probing import Measured, Outcome, probe
from axistwin_conformance.profile import Probe

ABOVE_IMAX: Final = 0x21  # no multiple of a power of two: clamping and masking differ


@probe()
def reserved_bits(bench: Bench) -> Outcome:
    """Reserved bits of 21h and 27h."""
    bits = bench.value(0x21) & STATUS_RESERVED, bench.value(0x27) & MEASURES_RESERVED
    if bits == (STATUS_RESERVED, MEASURES_RESERVED):
        return Measured("1")
    return Measured("mixed") if any(bits) else 0


@probe(safety="stored")
def cmd_1c_supported(bench: Bench) -> Outcome:
    """1Ch with the tolerance it has."""
    return reply_of(bench.command(0x1C, bench.value(0x26) & 0xFF).kind, ACCEPTED_OR_REFUSED)


@probe(safety="stored")
def torque_range(bench: Bench) -> Outcome:
    """0Ch with 00 and with Imax."""
    imax = bench.imax
    with bench.torque_kept():
        kinds = [bench.command(0x0C, value).kind for value in (0, imax)]
    if kinds[0] is not kinds[1]:
        return f"0Ch 00: {kinds[0].value}, 0Ch {imax:02X}: {kinds[1].value}"
    return reply_of(kinds[0], ACCEPTED_OR_REFUSED)


@probe(safety="stored")
def torque_over(bench: Bench) -> Outcome:
    """0Ch above Imax, then 26h."""
    imax = bench.imax
    if imax + ABOVE_IMAX > 0xFF:
        bench.session.skip(f"Imax {imax:02X}h leaves no value above it")
    with bench.torque_kept():
        bench.command(0x0C, 0x20)
        return excessive_torque(bench, imax, imax + ABOVE_IMAX)


def excessive_torque(bench: Bench, imax: int, value: int) -> int | str:
    """What a torque above Imax does: refused and kept, taken as the highest, or some bits of it."""
    kind = bench.command(0x0C, value).kind
    after = bench.value(0x26) >> 16 & 0xFF
    if kind is Kind.REFUSED and after == 0x20:
        return 0
    highest = imax - (bench.session.reading("torque_range") == "exclusive")
    if kind is Kind.ACCEPTED and after in (imax, highest):
        return 1
    if kind is Kind.ACCEPTED and after in (value & (imax - 1), value & 0x7F):
        return 2
    return f"0Ch {value:02X}: {kind.value}, then 26h shows {after:02X}"


@probe(safety="stored")
def zero_period_0d(bench: Bench) -> Outcome:
    """0Dh 0000, then 25h."""
    slow = bench.slowed(0x0777)
    bench.accepted(0x0D, slow)
    kind = bench.command(0x0D, 0).kind
    after = bench.value(0x25) & 0xFFFF
    bench.accepted(0x0D, slow)  # nothing may move at a period of one tick
    if kind is Kind.REFUSED and after == slow:
        return 0
    if kind is Kind.ACCEPTED and after in (0, 1):
        return 1
    return f"{kind.value}, then 25h shows {after:04X}"


@probe(safety="stored")
def zero_catchup(bench: Bench) -> Outcome:
    """0Eh 0000."""
    return reply_of(bench.command(0x0E, 0).kind, ACCEPTED_OR_REFUSED)


@probe(safety="stored")
def catchup_low_byte(bench: Bench) -> Outcome:
    """0Eh 0755 after 0Eh 1400, then 25h."""
    bench.accepted(0x0E, 0x1400)
    kind = bench.command(0x0E, 0x0755).kind
    after = bench.value(0x25) >> 24
    if kind is Kind.ACCEPTED and after == 0x07:
        return 0
    if kind is Kind.REFUSED and after == 0x14:
        return 1
    return f"0E 0755: {kind.value}, then {after:02X}"


@probe(safety="stored")
def param_range_policy(bench: Bench) -> Outcome:
    """03h 0E, then 26h: refused, masked to 08, or clamped to 09."""
    bench.command(0x03, 0)
    kind = bench.command(0x03, 0x0E).kind
    shown = bench.value(0x26) >> 8 & 0xF
    bench.command(0x03, 0)
    if kind is Kind.REFUSED:
        return 0
    return 1 if shown == 8 else 2 if shown == 9 else f"{kind.value}, then m = {shown:X}"


PROBES: Final = tuple(one for one in vars().values() if isinstance(one, Probe))
