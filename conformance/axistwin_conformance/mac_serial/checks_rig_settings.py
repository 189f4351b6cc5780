"""What re-addressing and another rate leave behind without a supply (PERS-01, PERS-02)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from axistwin_conformance.mac_axis.checks_rig_power import POWER
from axistwin_conformance.mac_axis.dialogue import Kind
from axistwin_conformance.mac_axis.talk import QUIET_S
from axistwin_conformance.mac_serial.bench import RigBench
from axistwin_conformance.mac_serial.codec import GENERAL_ADDRESS
from axistwin_conformance.mac_serial.probes_destructive import DESTRUCTIVE, FACTORY_BAUD, RATES
from axistwin_conformance.registry import check
from axistwin_conformance.session import Session


@contextmanager
def _rate_put_back(bench: RigBench) -> Iterator[None]:
    """Whatever happens, the module talks our rate again; which one it talks now is tried out."""
    own = bench.target.baud
    value = next(one for one, rate in RATES.items() if rate == own)
    try:
        yield
    finally:
        for rate in RATES.values():
            bench.target.baud = rate
            if bench.send(bench.request(0x20), QUIET_S * 2).kind is Kind.ANSWER:
                if rate != own:
                    bench.send(bench.request(0x1B, value), QUIET_S * 2)
                    bench.wait_awake()
                break
        bench.target.baud = own


@check("MACS-PERS-01", "MACS-CMD-1B-01", safety=(*DESTRUCTIVE, "rig"), needs=("alone", *POWER))
def the_rate_outlives_the_supply(session: Session) -> None:
    """The rate of 1Bh is kept over power-off."""
    if session.carrier.description.startswith("socket:"):
        session.skip("a plain socket carries bytes, not a rate")
    bench = RigBench(session)
    bench.begin()
    rate, value = (9600, 0x01) if bench.target.baud == FACTORY_BAUD else (FACTORY_BAUD, 0x03)
    with _rate_put_back(bench):
        if bench.send(bench.request(0x1B, value), QUIET_S * 2).kind is Kind.REFUSED:
            bench.reading("cmd_1b_supported", 1, "MACS-CMD-1B-01")
            session.not_run("MACS-PERS-01", "the rate cannot be changed on this device")
            return
        bench.target.baud = rate
        bench.wait_awake()
        bench.alive("MACS-CMD-1B-01")
        bench.power_cycle()
        session.expect(
            bench.ask(0x20).kind is Kind.ANSWER, "MACS-PERS-01", f"an answer at {rate}", "silence"
        )


@check("MACS-PERS-02", "MACS-CMD-08-02", safety=(*DESTRUCTIVE, "rig"), needs=("alone", *POWER))
def the_address_outlives_the_supply(session: Session) -> None:
    """The address of 08h is kept over power-off."""
    bench = RigBench(session)
    bench.begin()
    own, new = bench.address, 0x2A if bench.address != 0x2A else 0x2B
    try:
        bench.send(bench.request(0x08, new, address=GENERAL_ADDRESS), QUIET_S * 2)
        bench.rig.power_off()
        bench.wait(1.0)
        bench.rig.power_on()
        bench.wait_awake()
        bench.address = new
        bench.alive(("MACS-PERS-02", "MACS-CMD-08-02"))
    finally:
        bench.address = new
        if bench.send(bench.request(0x20), QUIET_S * 2).kind is Kind.ANSWER:
            bench.send(bench.request(0x08, own, address=GENERAL_ADDRESS), QUIET_S * 2)
            bench.within(QUIET_S, 0x00)  # if it takes a restart
            bench.send(bench.request(0x00, address=own), QUIET_S)
            bench.wait_awake()
        bench.address = own
