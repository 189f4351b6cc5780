"""Which readings a module follows, asked on the bus alone: spelling of replies, frames, indices.

Each function asks the device one question of chapter 7 of the ledger (`probing`).

The probes run in the order of `Family.probe_modules` and of their text: the order of bytes and the
spelling of replies first, since everything is heard through them; then what needs no write.

Not asked.  MACC-AMB-02, -21 and -30 have one reading only.  MACC-AMB-23: bit rate, sample point and
what follows bus-off are the bus's, which is configured and not judged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.probing import reply_of
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import CanReply, CanRequest
from axistwin_conformance.families.mac.can.driver import CanDriver

ORDER = 20  # of this module in a run; see `Family.modules`

BIG, LITTLE = 0, 1  # readings of MACC-AMB-01
TORQUE_AT: Final = 1  # byte of 2006h
TORQUES: Final = (0x40, 0x20, 0x10)
TORQUE, OTHER_TORQUE, _ = TORQUES
OTHER_COMMAND: Final = 0x22  # a download of the standard without a size
DEVICE_TYPE: Final = (0x00, 0x10)  # index 1000h of the standard, low byte first
SHORT_BYTES: Final = 4
FROM_MODULE_1: Final = (codec.REPLY + codec.SPOKESMAN, codec.REQUEST + codec.SPOKESMAN)


# --- order of bytes, spelling --------------------------------------------------------------------


def _raw(driver: CanDriver, index: int) -> bytes:
    """The four bytes of an answer as they came; zeros without one."""
    reply: CanReply = driver.client.ask(index).reply
    is_answer = reply.frame is not None and reply.kind is ReplyKind.ANSWER
    return bytes(reply.frame.data[4:]) if reply.frame and is_answer else codec.ZEROS


@probe(safety="stored")
def can_byte_order(driver: CanDriver) -> Outcome:
    """200Ch with the value in its last byte, else in its first, and the torque in 2006h."""
    own = _raw(driver, 0x26)[TORQUE_AT]
    value, other = [torque for torque in TORQUES if torque != own][:2]
    # An answer that comes one late shows the first value after the second: what is taken for little
    # by that alone sends every move to a wrong place.
    tried = ((BIG, (value,)), (LITTLE, (value, other)))
    shown = []
    for order, values in tried:
        shown.append([_torque_shown(driver, order, torque, own) for torque in values])
        if shown[-1] == list(values):
            return _learnt(driver, order)
    _write_torque(driver, BIG, own)
    told = " then ".join(f"{one:02X}" for seen in shown for one in seen)
    return f"{value:02X} in the last byte, then it and {other:02X} in the first: {told}"


def _torque_shown(driver: CanDriver, order: int, torque: int, own: int) -> int:
    """What 2006h shows of a torque written in that order of bytes.  What the wrong order has put
    there must not stay either: the probes that follow move."""
    _write_torque(driver, order, torque)
    shown = _raw(driver, 0x26)[TORQUE_AT]
    _write_torque(driver, order, own)
    return shown


def _write_torque(driver: CanDriver, order: int, value: int) -> None:
    """200Ch, in that order of bytes whatever is known of it."""
    data = bytes([0, 0, 0, value]) if order == BIG else bytes([value, 0, 0, 0])
    driver.client.send(replace(driver.client.request(0x0C), data=data))


def _learnt(driver: CanDriver, order: int) -> int:
    """The snapshot is read again in the byte order now known, and the travel guard learns it.  Only
    the torque may have changed, where noise has kept it from being put back: it is a byte, and was
    read rightly before."""
    run = driver.session.run
    if run.memory is not None:
        run.readings["can_byte_order"] = ("big", "little")[order]
        again = run.family.remember(driver.session)
        parameters = {**again.parameters, 0x0C: run.memory.parameters[0x0C]}
        run.memory = replace(again, parameters=parameters)
    return order


@probe()
def upload_scs(driver: CanDriver) -> Outcome:
    """The first byte of the answer to 2000h."""
    reply: CanReply = driver.client.ask(0x20).reply
    spelling = reply.answer_spelling
    return str(reply) if spelling is None else Measured(spelling)


def refusals(driver: CanDriver) -> Iterator[CanRequest]:
    """Requests that a module refuses at rest, by one requirement or another, and that do
    nothing."""
    yield driver.client.request(0x12)
    yield driver.client.request(0x28)
    yield replace(driver.client.request(0x20), index_low=DEVICE_TYPE[0], index_high=DEVICE_TYPE[1])
    yield replace(driver.client.request(0x12), command=OTHER_COMMAND)


@probe()
def abort_code_form(driver: CanDriver) -> Outcome:
    """The last four bytes of a refusal at rest."""
    for refusal in refusals(driver):
        reply: CanReply = driver.client.send(refusal, QUIET_S).reply
        if reply.kind is ReplyKind.REFUSED:
            return 1 if reply.abort_code else 0
    return driver.session.skip("nothing that does no harm is refused")


# --- who answers what all are told ----------------------------------------------------------------


def answer_to_all(driver: CanDriver, request: CanRequest) -> CanReply | None:
    """What module 1 says to a request on 600h, on either identifier; None for nothing."""
    driver.client.target.drain()
    driver.client.target.send(request.frame())
    seconds = QUIET_S * 2 + driver.client.target.uncertainty_ns / 1e9
    arrival = driver.client.target.receive(lambda frame: frame.identifier in FROM_MODULE_1, seconds)
    return None if arrival is None else codec.parse(arrival.frame, driver.client.byte_order)


def has_module_1(driver: CanDriver) -> bool:
    """True if the module that answers is known to be there."""
    return codec.SPOKESMAN in (driver.session.address, *driver.session.neighbours)


@probe()
def general_reply_id(driver: CanDriver) -> Outcome:
    """The identifier of what comes to 2000h, or to what is refused, on 600h."""
    for request in (driver.client.request(0x20), *refusals(driver)):
        reply = answer_to_all(driver, replace(request, address=codec.GENERAL_ADDRESS))
        if reply is not None and reply.frame is not None:
            return FROM_MODULE_1.index(reply.frame.identifier)
    if has_module_1(driver):
        return "silence, whatever all are told"
    return driver.session.skip("module 1 alone answers, and it is not on this bus")


@probe()
def general_upload(driver: CanDriver) -> Outcome:
    """2000h on 600h."""
    reply = answer_to_all(driver, driver.client.to_all(0x20))
    if reply is None and not has_module_1(driver):
        driver.session.skip("module 1 alone answers, and it is not on this bus")
    if reply is None:
        return 1
    return reply_of(reply.kind, {ReplyKind.ANSWER: 0})


# --- frames and indices --------------------------------------------------------------------------


@probe()
def short_frame(driver: CanDriver) -> Outcome:
    """2000h in a frame of four bytes."""
    short = replace(driver.client.request(0x20), length=SHORT_BYTES)
    return reply_of(
        driver.client.send(short, QUIET_S).kind, {ReplyKind.SILENCE: 0, ReplyKind.ANSWER: 1}
    )


@probe()
def subindex_policy(driver: CanDriver) -> Outcome:
    """2000h with sub-index 01."""
    return reply_of(driver.client.ask(0x20, 0x01).kind, {ReplyKind.ANSWER: 0, ReplyKind.REFUSED: 1})


@probe()
def unknown_index(driver: CanDriver) -> Outcome:
    """A download of 2012h and an upload of 2008h at rest."""
    down, up = (
        driver.client.send(driver.client.request(index), QUIET_S).reply for index in (0x12, 0x28)
    )
    described = f"{down} to the download of 2012h, {up} to the upload of 2008h"
    if up.kind is ReplyKind.ANSWER and up.data:
        return described
    pairs = {
        (ReplyKind.REFUSED, ReplyKind.REFUSED): 0,
        (ReplyKind.ACCEPTED, ReplyKind.ANSWER): 1,
        (ReplyKind.SILENCE, ReplyKind.SILENCE): 2,
    }
    return pairs.get((down.kind, up.kind), described)


@probe()
def od_outside_20(driver: CanDriver) -> Outcome:
    """An upload of 1000h."""
    low, high = DEVICE_TYPE
    kind = driver.client.send(
        replace(driver.client.request(0x20), index_low=low, index_high=high), QUIET_S
    ).kind
    return reply_of(kind, {ReplyKind.REFUSED: 0, ReplyKind.ANSWER: 1, ReplyKind.SILENCE: 2})


@probe()
def imax_value(driver: CanDriver) -> Outcome:
    """The torque that the limit 80h stands for."""
    driver.session.skip("no request tells it")


# --- what takes a write ---------------------------------------------------------------------------


def torque(driver: CanDriver) -> int:
    """The torque limit that 2006h shows."""
    return driver.client.parameter(0x0C)


@probe(safety="stored")
def dont_care_digits(driver: CanDriver) -> Outcome:
    """200Ch with FF FF FF before the value, then 2006h."""
    with driver.motion.torque_kept():
        driver.client.command(0x0C, OTHER_TORQUE)
        kind = driver.client.command(0x0C, 0xFFFFFF00 | TORQUE).kind
        after = torque(driver)
    if (kind, after) in ((ReplyKind.ACCEPTED, TORQUE), (ReplyKind.REFUSED, OTHER_TORQUE)):
        return int(kind is ReplyKind.REFUSED)
    return f"{kind.value}, then 2006h shows {after:02X}"


@probe(safety="stored")
def sdo_other_ccs(driver: CanDriver) -> Outcome:
    """200Ch by 22h instead of 23h, then 2006h."""
    with driver.motion.torque_kept():
        driver.client.command(0x0C, OTHER_TORQUE)
        request = replace(driver.client.request(0x0C, TORQUE), command=OTHER_COMMAND)
        kind = driver.client.send(request, QUIET_S).kind
        after = torque(driver)
    fitting = {
        (ReplyKind.REFUSED, OTHER_TORQUE): 0,
        (ReplyKind.ACCEPTED, TORQUE): 1,
        (ReplyKind.SILENCE, OTHER_TORQUE): 2,
    }
    return fitting.get((kind, after), f"{kind.value}, then 2006h shows {after:02X}")


@probe(safety=("motion", "stored"), switch="abort_code_form")
def abort_code_form_in_motion(driver: CanDriver) -> Outcome:
    """The last four bytes of the refusal of 2013h during a move."""
    start = driver.motion.ready()
    driver.judge.accepted(0x13, start + 100)
    reply: CanReply = driver.client.command(0x13, start).reply
    driver.client.command(0x18)
    return int(bool(reply.abort_code)) if reply.kind is ReplyKind.REFUSED else f"{reply} in motion"
