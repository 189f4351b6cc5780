"""What the manual says of USB: how a board enumerates, and what reports come of what (MN4-USB)."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from axistwin_conformance.base.check import CheckFunction, check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.codec import CODES, REVISION, ReturnCode
from axistwin_conformance.families.mn400.usb.driver import (
    PARSED_BYTES,
    PRODUCT,
    REPORT_BYTES,
    VENDOR,
    UsbDriver,
)

READS: Final = ("E", "N", "S", "/", "?", "[", ":")
ORDERS: Final = ("L9,-8,7,-6", "V2000", "X1", "H0", "Q", "|", "M", "L1,2,3,4")
REFUSED: Final = ("X3", "X", "V1", "L1,2,3,4,5", "Lx", "H2")
LOADED: Final = (1, 2, 3, 4)


def keeping_counters(function: CheckFunction) -> CheckFunction:
    """Have a check put back the counters."""

    @functools.wraps(function)
    def kept(session: Session) -> None:
        with counters_put_back(session):
            function(session)

    return kept


@contextmanager
def counters_put_back(session: Session) -> Iterator[None]:
    """Put back the counters at the end, whatever becomes of the block."""
    family, memory = session.run.family, session.run.family.remember(session)
    told = f"counters {', '.join(map(str, memory))}"
    with session.restore_on_exit(told, lambda: not family.restore(session, memory)):
        yield


@check("MN4-USB-01")
def it_enumerates_as_the_manual_says(session: Session) -> None:
    """HID, vendor 0461h, product 0020h, one report of 64 bytes each way."""
    found = UsbDriver(session).transport.identity
    told = f"{found.vendor:04X}h:{found.product:04X}h"
    is_right = (found.vendor, found.product) == (VENDOR, PRODUCT)
    session.expect(is_right, "MN4-USB-01", f"{VENDOR:04X}h:{PRODUCT:04X}h", told)
    sizes = (found.in_bytes, found.out_bytes)
    session.expect(sizes == (REPORT_BYTES,) * 2, "MN4-USB-01", f"{REPORT_BYTES} bytes", sizes)


@check("MN4-USB-03", "MN4-USB-08")
def a_report_is_its_command_and_a_value(session: Session) -> None:
    """Each read draws one report, without address, sum, START and DONE; * draws 2Ah 16h."""
    driver = UsbDriver(session)
    has_flags = session.reading("has_feedhold_cmds") == "true"
    for text in READS if has_flags else READS[:-1]:
        value = driver.draws_value(text, "MN4-USB-03")
        is_plain = value.isascii() and not {*value.encode("latin-1")} & CODES
        session.expect(is_plain, "MN4-USB-03", "characters alone", repr(value), f"to {text}")
        is_right = REVISION.fullmatch(value) if text == "?" else value[:1] != ""
        session.expect(bool(is_right), "MN4-USB-03", "the whole value", value, f"to {text}")
    more = driver.more()
    session.expect(more.is_silence, "MN4-USB-03", "one report", more, f"to {READS[-1]}")
    reply = driver.ask("*")
    came = reply.report == b"*\x16"
    session.expect(came, ("MN4-USB-08", "MN4-USB-03"), "2A 16", reply, "to a poll")


@check("MN4-USB-04")
@keeping_counters
def what_reads_nothing_draws_no_report(session: Session) -> None:
    """Orders are carried out in silence."""
    driver = UsbDriver(session)
    for text in ORDERS:
        driver.draws_nothing(text, "MN4-USB-04")
    driver.counters_are(LOADED, "MN4-USB-04", "after L1,2,3,4")


@check("MN4-USB-05")
@keeping_counters
def what_is_refused_draws_a_report(session: Session) -> None:
    """Parameters that are wrong draw PARA_ERROR, in one form, and have no effect."""
    driver = UsbDriver(session)
    driver.command("L1,2,3,4")
    for text in REFUSED:
        reply = driver.draws_code(text, ReturnCode.PARA_ERROR, "MN4-USB-05")
        form = "cmd_code" if reply.has_command else "code"
        session.quirk("MN4-USB-05", "usb_error_form", form)
    driver.counters_are(LOADED, "MN4-USB-05", "after what was refused")


@check("MN4-USB-02")
@keeping_counters
def only_the_first_bytes_of_a_report_count(session: Session) -> None:
    """Of 49 characters the last one is lost; 48 are taken."""
    driver = UsbDriver(session)
    head = "L1,2,3," + "0" * 33
    for digits, loaded in (
        ("123456789", 12_345_678),
        ("12345678", 12_345_678),
        ("1234567", 1234567),
    ):
        text = head + digits
        driver.draws_nothing(text, "MN4-USB-02")
        count = f"{len(text)} characters, of which {PARSED_BYTES} count"
        driver.counters_are((1, 2, 3, loaded), "MN4-USB-02", f"after L of {count}")


@check("MN4-USB-06")
@keeping_counters
def a_report_holds_one_command(session: Session) -> None:
    """What stands behind the null of the first command does nothing and draws nothing."""
    driver = UsbDriver(session)
    driver.draws_nothing("L1,2,3,4\0L9,9,9,9", "MN4-USB-06")
    driver.counters_are(LOADED, "MN4-USB-06", "after two L in one report")
    driver.draws_nothing("V2000\0E", "MN4-USB-06")
    driver.draws_value("E\0?", "MN4-USB-06")
    more = driver.more()
    session.expect(more.is_silence, "MN4-USB-06", "one report", more, "to E and ? in one report")


@check("MN4-USB-07", safety="destructive")
def it_answers_whatever_its_address(session: Session) -> None:
    """After = with another address E is answered; then the address is as it was."""
    driver, own = UsbDriver(session), session.address
    other = own % 127 + 1

    def restored() -> bool:
        return driver.ask(f"={own}").is_silence

    with session.restore_on_exit(f"address {own}", restored):
        driver.command(f"={other}")
        driver.draws_value("E", "MN4-USB-07")
