"""The status word, as far as it shows without a hand at the machine (RQSTAT, STA)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import RQSTAT
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.program import BenchProgram

ORDER = 90  # of this module in a run; see `Family.modules`

RUNNING, AUTO_START = 1, 64
STATUS_BYTES: Final = {8: "6", 6: "4"}  # of the payload → what follows SS (MSC-AMB-38)
BOTH: Final = ("MSC-STA-01", "MSC-RQSTAT-02")
ERRORS: Final = 0xFB30  # the bits of the status word that tell an error (§5.4)
LOADS: Final = 0x0F08  # what comes of a load: nothing that is sent here is one
READS: Final = 3


@check("MSC-RQSTAT-01")
def the_status_is_followed_by_what_carries_nothing(session: Session) -> None:
    """RQSTAT is served by a status word and six bytes more, or four as this device reads the
    manual; what those hold is told and judges nobody."""
    driver = MscDriver(session)
    for _ in range(READS):
        reply = driver.served(RQSTAT, None, "a reply")
        size = len(reply.payload)
        if size not in STATUS_BYTES:
            session.fail(None, ["8 bytes behind the comma", "6 bytes"], f"{size} bytes")
        driver.reading("status_tail", STATUS_BYTES[size])
        driver.reading("status_spare", "internal" if any(reply.payload[2:]) else "zeros")


@check("MSC-STA-04")
def reading_the_status_leaves_its_errors_as_they_are(session: Session) -> None:
    """RQSTAT again tells the same errors; or fewer, on a device that clears what it has told."""
    driver = MscDriver(session)
    first = driver.status() & ERRORS
    for _ in range(READS):
        again = driver.status() & ERRORS
        # Where there is no error, none can be cleared.
        readings = ("level",) if first else ("level", "clear_on_read")
        driver.reading("status_latch", readings if again & first == first else "clear_on_read")
        first = again


def _first_status(driver: MscDriver) -> int:
    """The status word when the run began; now, if that is not known."""
    identity = driver.session.run.identity
    told = identity.values.get("status", "") if identity is not None else ""
    return int(told) if told.isdecimal() else driver.status()


@check("MSC-STA-02")
def nothing_that_was_sent_is_a_load(session: Session) -> None:
    """Neither a read, nor one under a wrong checksum, nor all that was sent before puts a load of a
    program, or an error of a load, into the status word."""
    driver = MscDriver(session)
    first = _first_status(driver)
    for body in driver.reads():
        driver.query(body)
    wrong = codec.with_wrong_checksum(driver.client.request(RQSTAT))
    driver.link.sign(wrong, codec.NAK, "MSC-STA-02", "a wrong checksum")
    new = driver.status() & ~first & LOADS
    text = "no load and no error of one that was not there when the run began"
    session.expect(not new, None, text, f"{new:04X}h more")


@check("MSC-STA-02", safety="stored", needs=("variables", "flags"))
def what_it_carries_out_is_no_error(session: Session) -> None:
    """Neither DWRITE, BWRITE, SFLAG nor CFLAG puts an error into the status word, nor a load of a
    program."""
    driver = MscDriver(session)
    (block,), flag = driver.scratch.blocks(1), driver.scratch.some_flags(1)[0]
    first = _first_status(driver)
    for body in (
        codec.dwrite(block, 5),
        codec.bwrite(block, driver.values(codec.BLOCK_VALUES)),
        codec.sflag(flag),
        codec.cflag(flag),
    ):
        before = driver.status()
        exchange = driver.command(body)
        new = driver.status() & (~first & LOADS | ~before & ERRORS)
        what = codec.explain_request(exchange.request)
        text = f"no error in the status word after {what} that was not there when the run began"
        session.expect(not new, None, text, f"{new:04X}h more")


@check("MSC-STA-01", "MSC-RQSTAT-02", needs=("program",))
def bit_0_tells_whether_the_program_runs(session: Session) -> None:
    """While the bench program counts its scans the status word is odd: 1, or 65 with auto start;
    while nothing counts it is even."""
    program = BenchProgram(session)
    counts = program.is_running()
    word = program.driver.query(RQSTAT).payload[:2]
    text = f"{RUNNING}, or {RUNNING | AUTO_START} with auto start" if counts else "an even number"
    is_shown = bool(int.from_bytes(word, "big") & RUNNING) == counts
    session.expect(is_shown, BOTH, f"{text}, whatever else is on", word.hex(" "))
