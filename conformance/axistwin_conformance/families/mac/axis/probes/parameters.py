"""Which readings a module follows in what it shows and stores (MACS-AMB-09, -10, -46, -47, -59,
-60)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mac.axis.checks.queries import MEASURES_RESERVED, STATUS_RESERVED
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED, reply_of

ORDER = 40  # of this module in a run; see `Family.modules`

PLAIN_TORQUE: Final = 0x20
ABOVE_IMAX: Final = 0x21  # no multiple of a power of two: clamping and masking differ


@probe()
def reserved_bits(driver: AxisDriver) -> Outcome:
    """Reserved bits of 21h and 27h."""
    bits = (
        driver.client.value(0x21) & STATUS_RESERVED,
        driver.client.value(0x27) & MEASURES_RESERVED,
    )
    if bits == (STATUS_RESERVED, MEASURES_RESERVED):
        return Measured("1")
    return Measured("mixed") if any(bits) else 0


@probe(safety="stored")
def cmd_1c_supported(driver: AxisDriver) -> Outcome:
    """1Ch with the tolerance it has."""
    return reply_of(
        driver.client.command(0x1C, driver.client.parameter(0x1C)).kind, ACCEPTED_OR_REFUSED
    )


@probe(safety="stored")
def torque_range(driver: AxisDriver) -> Outcome:
    """0Ch with 00 and with Imax, and what 26h then shows."""
    with driver.motion.torque_kept():
        return torques_at_the_edges(driver, driver.client.imax)


@probe(safety="stored")
def torque_over(driver: AxisDriver) -> Outcome:
    """0Ch above Imax, then 26h."""
    imax = driver.client.imax
    if imax + ABOVE_IMAX > 0xFF:
        driver.session.skip(f"Imax {imax:02X}h leaves no value above it")
    with driver.motion.torque_kept():
        return excessive_torque(driver, imax, imax + ABOVE_IMAX)


def torques_at_the_edges(driver: AxisDriver, imax: int) -> int | str:
    """Whether 0Ch takes 00 and Imax as they are: one that clamps accepts what it does not take."""
    described, taken = [], []
    for value in (0, imax):
        kind, after = _torque_after(driver, value)
        described.append(f"0Ch {value:02X}: {kind.value}, then 26h shows {after:02X}")
        taken.append(kind is ReplyKind.ACCEPTED and after == value)
    return "; ".join(described) if taken[0] is not taken[1] else int(not taken[0])


def excessive_torque(driver: AxisDriver, imax: int, value: int) -> int | tuple[int, ...] | str:
    """What a torque above Imax does: refused and kept, taken as the highest, or some bits of it."""
    kind, after = _torque_after(driver, value)
    if kind is ReplyKind.REFUSED and after == PLAIN_TORQUE:
        return 0 if value & 0x7F <= imax else (0, 2)  # what is left of it may be too much as well
    highest = imax - (driver.session.reading("torque_range") == "exclusive")
    taken_as = {1: (highest, imax), 2: (value & (imax - 1), value & 0x7F)}
    fitting = tuple(number for number, values in taken_as.items() if after in values)
    if kind is ReplyKind.ACCEPTED and fitting:
        return fitting
    return f"0Ch {value:02X}: {kind.value}, then 26h shows {after:02X}"


def _torque_after(driver: AxisDriver, value: int) -> tuple[ReplyKind, int]:
    """The reply to 0Ch with that value, and the torque limit it leaves where there was a plain
    one."""
    driver.judge.accepted(0x0C, PLAIN_TORQUE)
    kind = driver.client.command(0x0C, value).kind
    return kind, driver.client.parameter(0x0C)


@probe(safety="stored")
def zero_period_0d(driver: AxisDriver) -> Outcome:
    """0Dh 0000, then 25h."""
    slow = driver.limits.slowed(0x0777)
    driver.judge.accepted(0x0D, slow)
    kind = driver.client.command(0x0D, 0).kind
    after = driver.client.parameter(0x0D)
    driver.judge.accepted(0x0D, slow)  # nothing may move at a period of one tick
    if kind is ReplyKind.REFUSED and after == slow:
        return 0
    if kind is ReplyKind.ACCEPTED and after in (0, 1):
        return 1
    return f"{kind.value}, then 25h shows {after:04X}"


@probe(safety="stored")
def zero_catchup(driver: AxisDriver) -> Outcome:
    """0Eh 0000."""
    return reply_of(driver.client.command(0x0E, 0).kind, ACCEPTED_OR_REFUSED)


@probe(safety="stored")
def catchup_low_byte(driver: AxisDriver) -> Outcome:
    """0Eh 0755 after 0Eh 1400, then 25h."""
    driver.judge.accepted(0x0E, 0x1400)
    kind = driver.client.command(0x0E, 0x0755).kind
    after = driver.client.parameter(0x0E)
    if kind is ReplyKind.ACCEPTED and after == 0x07:
        return 0
    if kind is ReplyKind.REFUSED and after == 0x14:
        return 1
    return f"0E 0755: {kind.value}, then {after:02X}"


@probe(safety="stored")
def param_range_policy(driver: AxisDriver) -> Outcome:
    """03h 0E, then 26h: refused, masked to 08, or clamped to 09."""
    driver.client.command(0x03, 0)
    kind = driver.client.command(0x03, 0x0E).kind
    shown = driver.client.parameter(0x03)
    driver.client.command(0x03, 0)
    if kind is ReplyKind.REFUSED:
        return 0
    return 1 if shown == 8 else 2 if shown == 9 else f"{kind.value}, then m = {shown:X}"
