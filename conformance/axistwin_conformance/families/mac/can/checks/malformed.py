"""What is no request, or none of the manual's: refused or ignored, and without effect (SDO)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import CanRequest
from axistwin_conformance.families.mac.can.collect_replies import (
    described,
    outcome_of,
    replies,
    the_reply,
    unknown_addresses,
    with_a_reason,
)
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.probes.errors import stopped_beyond
from axistwin_conformance.families.mac.can.settings import SETTINGS, TORQUE, held, unchanged

ORDER = 50  # of this module in a run; see `Family.modules`

# Of the standard's 256 first bytes the ones that mean something to a server there.
COMMANDS: Final = (
    0x00, 0x0F, 0x20, 0x21, 0x22, 0x27, 0x2B, 0x2F, 0x41, 0x42, 0x43, 0x60, 0x70, 0x80, 0xA0, 0xA4,
    0xC0, 0xC4, 0xE0, 0xFF,
)  # fmt: skip
HIGH_BYTES: Final = (0x00, 0x10, 0x1F, 0x21, 0x60, 0xA0, 0xFF)
# What every device of the standard has, and what MACC-AMB-14 therefore names; and more of it.
MINIMUM: Final = (0x1000, 0x1001, 0x1018)
STANDARD: Final = (0x1002, 0x1003, 0x1005, 0x1008, 0x1014, 0x1016, 0x1017, 0x1200, 0x1400, 0x1800)
HIGHER_LOW: Final = (0x10, 0x13, 0x20, 0x40, 0x80, 0xC7, 0xFF)  # of uploads, which do nothing
# The same of downloads.  Less their upper bits they are the manual's, so on a real axis only those
# that would then be harmless.
HARMLESS_LOW: Final = (0x2C, 0x8C, 0xEC, 0x47, 0x84, 0xE5)
EXPEDITED: Final = (0x22, 0x27, 0x2B, 0x2F)  # the standard's other first bytes of such a download
OTHER_COMMANDS: Final = {ReplyKind.REFUSED: 0, ReplyKind.ACCEPTED: 1, ReplyKind.SILENCE: 2}


@check("MACC-SDO-10", "MACC-SDO-12", safety="stored")
def any_other_first_byte_is_refused(session: Session) -> None:
    """A request whose first byte is neither 23h nor 40h is refused and sets nothing; other readings
    take it for 23h, or ignore it."""
    driver = CanDriver(session)
    every = [number for number in range(0x100) if number not in (codec.DOWNLOAD, codec.UPLOAD)]
    for command in every if session.transport.is_virtual else COMMANDS:
        before, value = TORQUE.read(driver), TORQUE.other(driver)
        request = replace(driver.client.request(0x0C, value), command=command)
        outcome = outcome_of(driver, request, OTHER_COMMANDS)
        is_open = outcome == 0 and command not in EXPEDITED  # 23h by another name they are not
        driver.judge.reading("sdo_other_ccs", (0, 1) if is_open else outcome, "MACC-SDO-10")
        wanted, seen = (before, value)[outcome == 1], TORQUE.read(driver)
        session.expect(seen == wanted, "MACC-SDO-12", f"torque {wanted:02X}", f"{seen:02X}")
    driver.judge.alive("MACC-SDO-12")


@check("MACC-SDO-10")
def objects_outside_the_area_are_refused(session: Session) -> None:
    """An upload of an index whose high byte is not 20h is refused; other readings have the three
    objects every device of the standard has, or ignore it."""
    driver = CanDriver(session)
    every = [value for value in range(0x100) if value != codec.INDEX_HIGH]
    highs = every if session.transport.is_virtual else HIGH_BYTES
    turned = [low << 8 | codec.INDEX_HIGH for low in range(len(codec.ANSWERED))]
    objects = [*MINIMUM, *STANDARD, *turned, *(high << 8 | 0x02 for high in highs)]
    for number in objects:
        request = replace(
            driver.client.request(0x20), index_low=number & 0xFF, index_high=number >> 8
        )
        driver.judge.reading("od_outside_20", _outside(driver, request, number))


def _outside(driver: CanDriver, request: CanRequest, number: int) -> int | tuple[int, ...] | str:
    received = replies(driver, request.frame())
    if not received:
        return 2
    reply = codec.parse(received[0])
    is_ours = len(received) == 1 and received[0].identifier == codec.REPLY + driver.client.address
    if not is_ours or received[0].data[1:4] != request.frame().data[1:4]:
        return described(received)
    if reply.kind is ReplyKind.REFUSED and not with_a_reason(driver, reply):
        return 0 if number in MINIMUM else (0, 1)
    is_answer = received[0].data[0] & 0xE0 == codec.UPLOAD  # of the standard: any size
    return 1 if number in MINIMUM and is_answer else described(received)


@check("MACC-SDO-10", "MACC-SDO-12", safety="stored")
def downloads_outside_the_area_set_nothing(session: Session) -> None:
    """A download whose high byte is not 20h is refused, with that byte repeated, and sets
    nothing."""
    driver = CanDriver(session)
    before, value = TORQUE.read(driver), TORQUE.other(driver)
    readings = {ReplyKind.REFUSED: 0, ReplyKind.SILENCE: 2}
    every = [number for number in range(0x100) if number != codec.INDEX_HIGH]
    for high in every if session.transport.is_virtual else HIGH_BYTES:
        request = replace(driver.client.request(0x0C, value), index_high=high)
        outcome = outcome_of(driver, request, readings)
        driver.judge.reading("od_outside_20", (0, 1) if outcome == 0 else outcome, "MACC-SDO-10")
        seen = TORQUE.read(driver)
        session.expect(seen == before, "MACC-SDO-12", f"torque {before:02X}", f"{seen:02X}")


def judge_unassigned(driver: CanDriver, asked: Iterable[CanRequest], *names: str) -> None:
    """Judge requests of unassigned low bytes by one reading of MACC-AMB-15."""
    for request in asked:
        readings = {ReplyKind.REFUSED: 0, ReplyKind.SILENCE: 2, ReplyKind.ACCEPTED: 1}
        outcome = outcome_of(driver, request, readings)
        if request.command == codec.UPLOAD and isinstance(outcome, str):
            zeros = replies(driver, request.frame())
            is_zero = len(zeros) == 1 and zeros[0].data[4:] == codec.ZEROS
            is_answer = is_zero and zeros[0].data[0] in codec.ANSWER_SPELLINGS
            outcome = 1 if is_answer else outcome
        driver.judge.reading("unknown_index", outcome, names)


@check("MACC-CMD-XX-01", "MACC-SDO-10", "MACC-SDO-12")
def unassigned_downloads_are_refused(session: Session) -> None:
    """04h, 05h, 06h, 08h, 12h, 1Bh, 1Dh, 1Fh and all from 20h on are refused and do nothing."""
    driver = CanDriver(session)
    before = held(driver)
    for index in codec.UNASSIGNED_DOWNLOADS:
        asked = [driver.client.request(index, parameter) for parameter in (0, 1, 0xFFFFFFFF)]
        judge_unassigned(driver, asked, "MACC-CMD-XX-01", "MACC-SDO-10")
    above = range(0x20, 0x100) if session.transport.is_virtual else HARMLESS_LOW
    for low in above:
        request = replace(driver.client.request(0x04), index_low=low)
        judge_unassigned(driver, [request], "MACC-SDO-10")
    unchanged(driver, before, "MACC-SDO-12")


@check("MACC-Q-XX-01", "MACC-SDO-10")
def unassigned_uploads_are_refused(session: Session) -> None:
    """Uploads of 2008h to 200Fh and of everything above are refused."""
    driver = CanDriver(session)
    for index in codec.UNASSIGNED_UPLOADS:
        asked = [driver.client.request(index, filler) for filler in (0, 0xFFFFFFFF)]
        judge_unassigned(driver, asked, "MACC-Q-XX-01", "MACC-SDO-10")
    above = (
        range(0x10, 0x100) if session.transport.is_virtual else (0x10, 0x13, 0x20, 0x40, 0x80, 255)
    )
    for low in above:
        request = replace(driver.client.request(0x20), index_low=low)
        judge_unassigned(driver, [request], "MACC-SDO-10")


@check("MACC-SDO-11", "MACC-SDO-06")
def a_short_request_gets_no_reply(session: Session) -> None:
    """An upload request of 0 to 7 bytes gets no reply, or the reply to the request padded with
    zeros; the next complete request is answered."""
    driver = CanDriver(session)
    for index in (0x20, 0x22, 0x26):
        for length in range(codec.TRANSFER_BYTES):
            request = replace(driver.client.request(index), length=length)
            received = replies(driver, request.frame(), is_awaited=False)
            outcome: int | tuple[int, ...] | str = described(received)
            if not received:  # padded, fewer than four bytes may be ignored for another reason
                outcome = 0 if length >= 4 else (0, 1)
            elif len(received) == 1:
                outcome = 1
            driver.judge.reading("short_frame", outcome, "MACC-SDO-11")
            the_reply(driver, driver.client.request(index), "MACC-SDO-06")


@check("MACC-SDO-11", "MACC-SDO-12", safety="stored")
def a_short_download_sets_nothing(session: Session) -> None:
    """A download of 0 to 7 bytes is ignored: no reply, nothing set."""
    driver = CanDriver(session)
    if session.reading("short_frame") != "ignore":
        session.skip("this device pads short frames (MACC-AMB-19)")
    before = held(driver)
    for setting in SETTINGS.values():
        whole = driver.client.request(setting.index, setting.parameter(setting.other(driver)))
        for length in range(codec.TRANSFER_BYTES):
            received = replies(driver, replace(whole, length=length).frame(), is_awaited=False)
            session.expect(
                not received, "MACC-SDO-11", f"silence to {length} bytes", described(received)
            )
    unchanged(driver, before, "MACC-SDO-12")


@check("MACC-SDO-12", "MACC-SDO-05", "MACC-Q-01-01", safety=MOVES)
def what_does_nothing_leaves_the_stop_bits(session: Session) -> None:
    """Behind a software stop 2001h tells it until the next motion: what is refused, uploads, frames
    that are no requests, or not for this module, and SYNC leave it."""
    driver = CanDriver(session)
    request, other = driver.client.request, unknown_addresses(session)[0]
    ignored = [replace(request(0x04), command=number).frame() for number in COMMANDS[:3]]
    with stopped_beyond(driver):
        before = driver.client.data_bytes(0x21)[1]
        session.step(before != 0, "2001h shows the stop", f"ff {before:02X}")
        for name, frames in (
            ("MACC-SDO-12", [request(index).frame() for index in codec.UNASSIGNED_DOWNLOADS]),
            ("MACC-SDO-12", [request(index).frame() for index in codec.UNASSIGNED_UPLOADS]),
            ("MACC-SDO-12", [*ignored, replace(request(0x20), length=7).frame()]),
            ("MACC-SDO-05", [request(index).frame() for index in codec.ANSWERED]),
            ("MACC-Q-01-01", [request(index, address=other).frame() for index in (0x12, 0x20)]),
            ("MACC-Q-01-01", [driver.client.to_all(0x20).frame(), codec.sync()]),
        ):
            for frame in frames:
                replies(driver, frame, is_awaited=False)
                after = driver.client.data_bytes(0x21)[1]
                session.expect(
                    after == before,
                    ("MACC-Q-01-01", name) if name != "MACC-Q-01-01" else name,
                    f"2001h still ff {before:02X} after {codec.explain(frame)}",
                    f"{after:02X}",
                )
