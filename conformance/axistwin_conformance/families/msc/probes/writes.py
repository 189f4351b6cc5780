"""Which readings a unit follows, as far as it takes a write to one of the named variables; the
family puts back what it was."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.probing import (
    ReplyKind,
    block_of_variables,
    glance_s,
    reply_kind_of,
    variable,
)
from axistwin_conformance.families.msc.scratch import SAFE_STRIDE

ORDER = 20  # of this module in a run; see `Family.modules`

NAMED: Final = ("variables",)
PLACES: Final = {1: 0, 2: 1, 4: 2}  # where in a block the value four addresses on is → the reading
MARK: Final = 0x1D3C5A96  # in all four bytes something else
OTHER: Final = 0x2B4D6F87


@probe(safety="stored", needs=NAMED)
def write_reply(driver: MscDriver) -> Outcome:
    """DWRITE of the value that is there, and what follows its ACK."""
    address = variable(driver)
    same = codec.dwrite(address, driver.read(address))
    exchange = driver.ask(same)
    if exchange.sign != ACK:
        return str(exchange)
    reply, strays = driver.client.receive_packet(glance_s(driver))
    if reply is None and not strays:
        return 0
    driver.client.send(ACK)
    driver.client.wait_until_quiet()
    return 1 if reply is not None and not strays else codec.explain(strays)


@probe(safety="stored", needs=NAMED, switch="data_address_stride")
def data_address_stride_of_a_mark(driver: MscDriver) -> Outcome:
    """Where in BREAD of A a value is that DWRITE has put at A+4."""
    address = block_of_variables(driver)
    other = address + SAFE_STRIDE
    before = driver.read_block(address)
    mark = next(value for value in (MARK, OTHER, MARK ^ OTHER) if value not in before)
    driver.write(other, mark)
    after = driver.read_block(address)
    if after.count(mark) != 1:
        return f"{mark} {after.count(mark)} times in the block"
    place = after.index(mark)
    return PLACES.get(place, f"it is value {place + 1}")


@probe(safety="stored", needs=NAMED, switch="invalid_unit")
def invalid_unit_obeyed(driver: MscDriver) -> Outcome:
    """DWRITE with unit 0, and what is then read there."""
    others = [MscDriver(driver.session, unit) for unit in driver.session.neighbours]
    if others and not driver.target.is_builtin:
        driver.session.skip("a write to all would reach the neighbours too")
    address = variable(driver)
    before = driver.read(address)
    kept = [other.read(address) for other in others]
    mark = MARK if before != MARK else OTHER
    drawn = reply_kind_of(driver, codec.packet(0, codec.dwrite(address, mark)))
    is_written = driver.read(address) == mark
    for other, value in zip(others, kept, strict=True):
        other.write(address, value)
    if others:  # one that hunts for packets in others' (MSC-AMB-14) may have begun to read one
        driver.client.wait_until_quiet()
    if drawn is not ReplyKind.SILENCE:
        driver.session.skip(f"on this line unit 0 draws {drawn.value}")
    return 2 if is_written else 0
