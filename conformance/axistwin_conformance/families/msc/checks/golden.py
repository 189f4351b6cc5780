"""Every exchange that the ledger writes out, byte for byte (§2.5)."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, Packet
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.transport.transport import is_twin_url

ORDER = 110  # of this module in a run; see `Family.modules`

STATUS_AT: Final = slice(7, 9)  # of a reply's body: what RQSTAT tells; the rest is not specified


@dataclass(frozen=True, slots=True)
class Golden:
    """One written exchange.

    `said`: who says what ("H" the host, "D" the unit), in order, for unit `unit`.  `uses`: the
    first and the last variable, or the flag, that it works on.  `variables`, `flags`, `status`:
    what must be so before; None: it does not matter.
    """

    name: str
    unit: int
    said: tuple[tuple[str, bytes], ...]
    uses: tuple[int, ...]
    variables: tuple[tuple[int, int], ...] = ()
    flags: frozenset[int] | None = None
    status: int | None = None

    @property
    def command(self) -> str:
        """The name of the command."""
        packet = codec.parse(self.said[0][1])
        assert packet is not None
        return packet.name

    @property
    def is_about_variables(self) -> bool:
        """True if variables alone have to be named for it."""
        return self.command in ("BREAD", "BWRITE", "DREAD", "DWRITE")

    def readdressed(self, unit: int) -> tuple[tuple[str, bytes], ...]:
        """The same exchange with another unit."""
        return tuple((who, _readdressed(data, self.unit, unit)) for who, data in self.said)


def _readdressed(data: bytes, from_unit: int, unit: int) -> bytes:
    packet = codec.parse(data)
    if packet is None or unit == from_unit:
        return data
    moved = packet.checksum + unit - from_unit  # what was wrong about it stays so
    return codec.packet(unit, packet.body, packet.block, length=packet.length, checksum=moved)


@cache
def golden_exchanges() -> tuple[Golden, ...]:
    """Load the exchanges, shipped beside this module."""
    path = resources.files("axistwin_conformance.families.msc") / "golden" / "exchanges.toml"
    rows = tomllib.loads(path.read_text(encoding="utf-8"))["exchange"]
    return tuple(_golden(row) for row in rows)


def _golden(row: Mapping[str, Any]) -> Golden:
    said = tuple((line[0], bytes.fromhex(line[1:])) for line in row["said"])
    variables = tuple((address, value) for address, value in row.get("variables", ()))
    flags = frozenset(row["flags"]) if "flags" in row else None
    return Golden(
        row["name"],
        row.get("unit", 1),
        said,
        tuple(row["uses"]),
        variables,
        flags,
        row.get("status"),
    )


JUDGED: Final = ("MSC-PKT-21", "MSC-PKT-12", "MSC-LNK-01", "MSC-LNK-02", "MSC-LNK-10", "MSC-LNK-14")


@check(*JUDGED, safety="stored", needs=("variables",))
def the_written_exchanges_of_variables_come_byte_for_byte(session: Session) -> None:
    """DWRITE, DREAD, BWRITE and BREAD of the ledger, the refused packet and the refused reply among
    them, are answered as written."""
    driver = MscDriver(session)
    driver.link.calm()
    said = 0
    for golden in golden_exchanges():
        if not golden.is_about_variables:
            continue
        if not {golden.uses[0], golden.uses[-1]} <= set(driver.scratch.variables):
            session.not_run(None, f"{golden.name}: {golden.uses} may not be written (--variables)")
            continue
        for address, value in golden.variables:
            driver.write(address, value)
        _play(driver, golden)
        said += 1
    if said:
        session.expect(True, JUDGED, "as written", "as written")


@check(
    "MSC-PKT-12", "MSC-LNK-01", "MSC-LNK-07", "MSC-LNK-14", safety=("stored", "motion", "rig"),
    needs=("rig:flag", "rig:status"),
)  # fmt: skip
def the_written_exchanges_of_flags_and_status_come_byte_for_byte(session: Session) -> None:
    """SFLAG, RFLAG, RFLAGS, CFLAG and RQSTAT of the ledger are answered as written."""
    driver = MscDriver(session)
    driver.link.calm("other_unit_framing")
    for golden in golden_exchanges():
        if golden.is_about_variables:
            continue
        if golden.command == "RFLAGS" and not driver.has_rflags:
            continue
        if golden.uses and not _may_set(driver, golden.uses[0]):
            session.not_run(None, f"{golden.name}: not a flag that may be set (--flags)")
            continue
        if golden.flags is not None:
            _turn_on(driver, golden.flags)
        if golden.status is not None:
            _bring_about(driver, golden.status)
        _play(driver, golden)
    names = ("MSC-PKT-12", "MSC-LNK-01", "MSC-LNK-07", "MSC-LNK-14")
    session.expect(True, names, "as written", "as written")


def _may_set(driver: MscDriver, flag: int) -> bool:
    return flag in driver.scratch.flags or is_twin_url(driver.target.description)


def _turn_on(driver: MscDriver, wanted: frozenset[int]) -> None:
    """Have these flags on and no other, by the machine."""
    states = driver.flags()
    assert states is not None, "only where the model has RFLAGS"
    on = codec.flags_on(states)
    for number in sorted(wanted ^ on):
        driver.session.rig.work("flag", number in wanted, number=number)


def _bring_about(driver: MscDriver, wanted: int) -> None:
    status = driver.status()
    for bit in range(16):
        if (status ^ wanted) >> bit & 1:
            driver.session.rig.work("status", bool(wanted >> bit & 1), number=bit)


def _play(driver: MscDriver, golden: Golden) -> None:
    """Say what the host says and judge what the unit says; then nothing more may come."""
    driver.target.drain()
    for who, data in golden.readdressed(driver.unit):
        if who == "H":
            driver.target.send(data)
            continue
        if len(data) > 1:  # as long as it says: a repeat is not to be taken for a part of it
            received = codec.bytes_of(*driver.client.receive_packet())
            received, data = _as_read(driver, received, data)
        else:
            received = driver.client.receive(len(data))
        _judge(driver, golden, data, received)
    if golden.command in codec.WRITES and driver.session.reading("write_reply") == "empty_packet":
        driver.client.receive_packet()  # against MSC-LNK-14; a check of its own names it
        driver.target.send(ACK)
    extra = driver.client.listen(driver.link.glance_s)
    _judge(driver, golden, b"", extra)


def _judge(driver: MscDriver, golden: Golden, expected: bytes, received: bytes) -> None:
    text = codec.explain(expected) or "nothing more"
    driver.session.step(
        received == expected,
        f"{text} ({golden.name}): {expected.hex(' ')}",
        f"{codec.explain(received) or 'nothing'}: {received.hex(' ')}",
    )


def _as_read(driver: MscDriver, received: bytes, written: bytes) -> tuple[bytes, bytes]:
    """A reply and what was written of it, both without what this device's readings leave open: the
    block number, and what RQSTAT sends behind the status."""
    reply, other = codec.parse(received), codec.parse(written)
    assert other is not None
    if reply is None or not reply.is_sound:
        return received, written
    return _without(driver, reply), _without(driver, other)


def _without(driver: MscDriver, reply: Packet) -> bytes:
    block = 0 if driver.session.reading("reply_block") == "counter" else reply.block
    body = reply.body[: STATUS_AT.stop] if reply.name == "RQSTAT" else reply.body
    return codec.packet(reply.unit, body, block)
