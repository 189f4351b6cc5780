"""What takes a bench: headers of impossible length, characters that are none, power."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.line import absent, judge_followed, judge_skipped
from axistwin_conformance.families.msc.codec import ACK, NAK, RQSTAT, STX
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import FILLER, MOMENT_S, MS

ORDER = 50  # of this module in a run; see `Family.modules`

HALF_RATE: Final = 4800
# At half the rate: five bits of 0 and five of 1.  At 9600: ten bits of 0, one character without a
# stop bit, then the line at rest for as long.
CORRUPTED_CHARACTER: Final = b"\xf0"
CORRUPTED_AT: Final = {"header": 4, "body": 8, "checksum": 13}  # places in RQSTAT
LONG_BODY: Final = 0x100  # bytes: the length of what they are a part of needs both of its bytes
RUNNING: Final = 1  # bit 0 of the status word
START_S: Final = 2.0  # for how long after power-up nothing must be said
HEARD_BYTES: Final = 4  # of a reply, when it is interrupted
# Where a packet or a reply is when the power goes: how much of RQSTAT has been sent, or what of the
# exchange is under way.  The first three are all that hands at a switch are asked for.
CUTS: Final[Mapping[str, int | str]] = {
    "idle": 0, "in a body": 9, "waiting for a sign": "waiting", "in a header": 3,
    "in a checksum": 14, "in another unit's packet": "skipping", "in a reply": "replying",
    "in a repeat": "repeating",
}  # fmt: skip


@check("MSC-LNK-20", "MSC-PKT-10", safety="rig", needs=("bench",))
def a_header_that_announces_too_much_is_refused(session: Session) -> None:
    """A header with a length above 240 leads to one NAK: after all that it announced, or when this
    device reads it.  (BODY, discarding)"""
    driver = MscDriver(session)
    seen = set()
    for length in (241, 255, 256, 0xFFFF) if session.target.is_virtual else (241, 0xFFFF):
        header = codec.packet(driver.unit, b"", length=length)[: codec.HEADER_BYTES]
        received, sent_ns, came_ns = driver.link.break_off(header)
        text = f"a header with length {length}"
        session.expect(
            received == NAK, ("MSC-LNK-20", "MSC-PKT-10"), f"NAK to {text}", received.hex()
        )
        driver.link.nothing_more("MSC-LNK-20", text)
        is_late = came_ns in driver.link.sign_window(sent_ns, codec.HEADER_BYTES)
        is_early = came_ns < driver.link.sign_window(sent_ns, codec.HEADER_BYTES).earliest_ns
        session.expect(
            is_late or is_early,
            "MSC-LNK-20",
            "NAK at once or at T1",
            f"after {(came_ns - sent_ns) / MS:.1f} ms",
        )
        seen.add("at T1" if is_late else "at once")
        driver.link.alive("MSC-LNK-20")
    session.expect(len(seen) == 1, "MSC-LNK-20", "one of the two", " and ".join(sorted(seen)))
    if seen == {"at once"}:
        driver.reading("overlength", "nak_after_header", ("MSC-LNK-20", "MSC-PKT-10"))
        return
    # Of one that ends at T1 or later nobody can tell which of the two has drawn the NAK.
    least_ns = driver.link.latency_ns + 3 * driver.link.byte_ns + driver.link.spare_ns
    least_ns += round(MOMENT_S * 1e9)
    left_ns = driver.link.sign_window(0, codec.HEADER_BYTES).earliest_ns - least_ns
    lengths = [
        one for one in (241, 256) if (one + codec.AROUND_BODY) * driver.link.byte_ns < left_ns
    ]
    if not lengths:
        return
    readings = {_after_all_of_it(driver, length) for length in lengths}
    session.expect(len(readings) == 1, "MSC-LNK-20", "one reading", sorted(readings))
    driver.reading("overlength", readings.pop(), ("MSC-LNK-20", "MSC-PKT-10"))


def _after_all_of_it(driver: MscDriver, length: int) -> tuple[str, ...]:
    """What a whole packet of that length shows, its sum being wrong and its body no command."""
    body = RQSTAT.ljust(length, FILLER)
    raw = codec.packet(driver.unit, body, checksum=0x3030)
    received, sent_ns, came_ns = driver.link.break_off(raw, codec.HEADER_BYTES)
    driver.session.expect(received == NAK, "MSC-LNK-20", "NAK", received.hex(" ") or "nothing")
    driver.link.nothing_more("MSC-LNK-20", "the NAK")
    driver.link.alive("MSC-LNK-20")
    is_late = came_ns >= driver.link.sign_window(sent_ns, codec.HEADER_BYTES).earliest_ns
    driver.session.expect(
        is_late or not driver.link.is_amid(sent_ns, len(raw), came_ns),
        "MSC-LNK-20",
        f"NAK when all {len(raw)} bytes are over, or at T1",
        f"after {(came_ns - sent_ns) / MS:.1f} ms",
    )
    return ("timeout_only",) if is_late else ("nak_after_packet", "accept")


@check("MSC-PKT-15", safety="rig", needs=("bench",))
def an_02h_in_the_place_of_the_unit_is_a_number(session: Session) -> None:
    """A sound RQSTAT behind another 02h is the rest of a packet for unit 2, too long and broken
    off: it draws nothing from others, and the one behind is served.  (HDR 02h, SKIP)"""
    driver = MscDriver(session)
    judge_skipped(driver)
    judge_followed(driver)
    is_there = STX[0] in (session.address, *session.neighbours)
    if is_there:
        driver.link.calm()
    session.target.drain()
    session.target.send(STX + driver.client.request(RQSTAT))
    received = driver.client.listen(driver.client.packet_timeout_s * 1.2 + driver.link.glance_s)
    text = "NAK of unit 2" if is_there else "nothing"
    is_so = received in ((b"", NAK) if is_there else (b"",))
    session.expect(is_so, "MSC-PKT-15", text, codec.explain(received) or "nothing")
    driver.link.alive("MSC-PKT-15")


@check("MSC-LNK-19", safety="rig", needs=("bench",))
def more_than_255_bytes_for_another_unit_are_counted_off(session: Session) -> None:
    """An RQSTAT at the end of a body whose length needs both of its bytes, announced to another
    unit, is part of that, and the one behind it is served.  (SKIP)"""
    driver = MscDriver(session)
    judge_skipped(driver)
    judge_followed(driver)
    body = bytes(LONG_BODY) + driver.client.request(RQSTAT)
    raw = codec.packet(absent(session), body, checksum=0x3030)
    span_ns = len(raw) * driver.link.byte_ns + driver.link.spare_ns
    if span_ns >= driver.link.sign_window(0, codec.HEADER_BYTES).earliest_ns:
        session.skip("T1 runs out while such a packet is being sent")
    session.target.drain()
    session.target.send(raw)
    text = f"{len(raw)} bytes, as another unit's header announced"
    driver.link.nothing_more("MSC-LNK-19", text, span_ns / 1e9 + driver.link.glance_s)
    driver.link.alive("MSC-LNK-19")


@check("MSC-LNK-02", "MSC-LNK-04", safety="rig", needs=("bench",))
def an_empty_body_is_no_command(session: Session) -> None:
    """A packet without a body under a right checksum is treated as an unknown command, or ACKed if
    this device reads it so."""
    driver = MscDriver(session)
    driver.link.calm()
    raw = codec.packet(driver.unit, b"")
    exchange = driver.client.ask(raw, is_read=False)
    driver.link.nothing_more(("MSC-LNK-02", "MSC-LNK-04"), "it")
    like_unknown = {"nak": NAK, "ack_ignore": ACK, "silent": b""}
    readings = ["as_unknown"] * (
        exchange.raw == like_unknown[session.reading("unknown_command")]
    ) + ["ack"] * (exchange.raw == ACK)
    if not readings:
        session.fail(("MSC-LNK-02", "MSC-LNK-04"), ["like an unknown command", "ACK"], exchange)
    driver.reading("empty_body", readings, ("MSC-LNK-02", "MSC-LNK-04"))
    driver.link.alive("MSC-LNK-02")


# --- characters that are none ---------------------------------------------------------------------


def judge_rates(session: Session) -> None:
    """Go on only where our end has a rate."""
    if session.target.description.startswith("socket:"):
        session.skip("a plain socket carries bytes, not a rate")


@check("MSC-LNK-02", "MSC-LNK-03", safety="rig", needs=("bench",))
def a_character_without_its_stop_bit_spoils_its_packet(session: Session) -> None:
    """A framing error in RQSTAT draws NAK at the packet's end; or the byte counts as it is, or is
    lost, if this device reads it so; between packets, and while a sign is awaited, it does nothing.
    (UART error in IDLE, HDR, BODY, CSUM, WAIT)"""
    driver = MscDriver(session)
    judge_rates(session)
    driver.link.calm()
    session.target.drain()
    _send_corrupted(driver)
    driver.link.nothing_more("MSC-LNK-02", "a framing error between packets")
    driver.link.alive("MSC-LNK-02")
    raw = codec.packet(driver.unit, RQSTAT)  # its block number is 0000h, as the corrupted byte is
    at_once_ns = (len(raw) + 1) * driver.link.byte_ns + driver.link.latency_ns
    took_ns = 3 * len(raw) * driver.link.byte_ns + 2 * driver.link.spare_ns
    if took_ns > driver.link.sign_window(0, len(raw)).earliest_ns:
        session.skip("T1 is over while a character without its stop bit is being sent")
    for place in CORRUPTED_AT.values():
        session.target.drain()
        sent_ns = session.target.send(raw[:place])
        _send_corrupted(driver)
        session.target.send(raw[place + 1 :])
        readings = _uart_reading(driver, sent_ns, sent_ns + at_once_ns, place)
        driver.reading("uart_error", readings, "MSC-LNK-02")
        driver.link.alive(("MSC-LNK-02", "MSC-LNK-03"))
    if 2 * took_ns > driver.client.ack_timeout_s * 1e9:
        session.note("T2 is over while a character without its stop bit is being sent")
        return
    first = driver.link.unanswered()
    _send_corrupted(driver)
    again = driver.link.refuse_in("MSC-LNK-02")
    is_same = again is not None and driver.link.is_same(again, first)
    session.expect(is_same, "MSC-LNK-02", "the repeat to a NAK behind it", again)
    session.target.send(ACK)
    driver.link.alive("MSC-LNK-03")


@check("MSC-LNK-19", safety="rig", needs=("bench",))
def a_spoilt_character_for_another_unit_is_counted(session: Session) -> None:
    """A framing error in another unit's packet counts as a byte of it: the packet behind is served.
    (UART error in SKIP)"""
    driver = MscDriver(session)
    judge_rates(session)
    driver.link.calm()
    judge_skipped(driver)
    judge_followed(driver)
    if session.reading("uart_error") == "drop_byte":
        session.skip("this device has uart_error=drop_byte")
    raw = codec.packet(absent(session), RQSTAT, checksum=0x3030)
    session.target.drain()
    session.target.send(raw[:8])
    _send_corrupted(driver)
    session.target.send(raw[9:])
    driver.link.nothing_more("MSC-LNK-19", "another unit's packet", driver.link.glance_s)
    driver.link.alive("MSC-LNK-19")


@check("MSC-LNK-10", "MSC-LNK-08", safety="rig", needs=("bench", "alone"))
def a_spoilt_character_while_it_talks_is_ignored(session: Session) -> None:
    """A framing error during a reply, or a repeat, neither counts as a sign nor changes what is
    sent again.  (UART error in EXEC and RETX)"""
    driver = MscDriver(session)
    judge_rates(session)
    if not driver.link.is_busy_hearing:
        session.skip("on RS-485 the host would talk over the unit")
    first = driver.link.unanswered()
    session.target.send(ACK)
    for repeats in (0, 1):
        session.target.drain()
        session.target.send(driver.client.request(RQSTAT))
        session.step(driver.client.receive(1) == ACK, "ACK", "something else")
        if repeats:
            reply, _ = driver.client.receive_packet()
            session.step(reply is not None, "a reply", "nothing")
            session.target.send(NAK)
        driver.client.receive(HEARD_BYTES)
        _send_corrupted(driver, wait_s=0.0)  # what comes meanwhile our end cannot read
        driver.client.listen(driver.link.glance_amid_wait_s)
        again = driver.link.refuse()
        is_same = (
            again is not None
            and again.is_sound
            and driver.link.specified(again) == driver.link.specified(first)
        )
        session.expect(is_same, ("MSC-LNK-10", "MSC-LNK-08"), first, again)
        session.target.send(ACK)
        driver.link.nothing_more("MSC-LNK-08", "ACK")


def _send_corrupted(driver: MscDriver, wait_s: float | None = None) -> None:
    """Send one character that has no stop bit, once all before it has left.

    `wait_s`: how long that takes; None: as long as a whole RQSTAT.
    """
    target = driver.target
    rate = target.baud
    own_s = codec.REQUEST_BYTES["RQSTAT"] * driver.link.byte_ns / 1e9
    target.wait((own_s if wait_s is None else wait_s) + driver.link.spare_ns / 1e9)
    try:
        target.baud = HALF_RATE
        target.send(CORRUPTED_CHARACTER)
        target.wait(4 * driver.link.byte_ns / 1e9 + driver.link.spare_ns / 1e9)
    finally:
        target.baud = rate


def _uart_reading(driver: MscDriver, sent_ns: int, at_once_ns: int, place: int) -> tuple[str, ...]:
    """What is read from the answer to an RQSTAT with one character corrupted (MSC-AMB-43), which at
    once is then."""
    received = driver.client.receive(1, driver.client.packet_timeout_s * 1.5 + driver.link.glance_s)
    came_ns = driver.target.now_ns
    count = codec.REQUEST_BYTES["RQSTAT"] - 1
    if received == ACK:
        driver.client.receive_packet()
        driver.target.send(ACK)
        return ("use_byte",)
    driver.session.expect(
        received == NAK, "MSC-LNK-02", "NAK or ACK", received.hex(" ") or "nothing"
    )
    driver.link.nothing_more("MSC-LNK-02", "NAK")
    due_ns = driver.link.sign_window(sent_ns, count).earliest_ns
    if at_once_ns + driver.link.spare_ns >= due_ns:  # it takes as long to NAK as T1 is
        return ("bad_packet", "use_byte", "drop_byte")
    if came_ns >= due_ns:
        return ("drop_byte",)
    # Only where 00 stands anyway does the byte as it is make a good packet.
    return ("bad_packet",) if place == CORRUPTED_AT["header"] else ("bad_packet", "use_byte")


# --- power ----------------------------------------------------------------------------------------


@check(
    "MSC-PHY-04", "MSC-PHY-03", "MSC-LNK-01", safety=("rig", "motion"), needs=("rig:power",),
)  # fmt: skip
def power_up_says_nothing(session: Session) -> None:
    """Neither losing its supply nor getting it back makes a unit say anything, whatever it was at;
    then it serves, counting from 0.  (power cycle in every state)"""
    driver = MscDriver(session)
    longer_s = max(driver.client.packet_timeout_s, driver.client.ack_timeout_s) * 1.2 + START_S
    was_running = driver.status() & RUNNING
    for state in list(CUTS) if session.rig.is_exact else list(CUTS)[:3]:
        _bring_to(driver, CUTS[state])
        session.rig.work("power", False)
        session.target.wait(2 * driver.link.byte_ns / 1e9)
        session.target.drain()  # a character that was cut in two
        names = ("MSC-PHY-04", "MSC-PHY-03")
        driver.link.nothing_more(names, f"a power cut while {state}", driver.link.glance_s)
        session.rig.work("power", True)
        driver.link.nothing_more(names, f"power-up after a cut while {state}", longer_s)
        driver.link.alive(("MSC-PHY-04", "MSC-LNK-01"))
        driver.link.unanswered()
        for number in range(driver.link.limit):
            text = f"repeat {number + 1} of {driver.link.limit}"
            session.expect(
                driver.link.refuse_in("MSC-PHY-04") is not None, "MSC-PHY-04", text, "nothing"
            )
        session.target.send(ACK)
        driver.link.nothing_more("MSC-PHY-04", "the last repeat")
    if was_running and not driver.status() & RUNNING and "program" in session.rig.capabilities:
        session.rig.work("program", True)


def _bring_to(driver: MscDriver, state: int | str) -> None:
    """Bring a unit into a state of `CUTS`."""
    target, raw = driver.target, driver.client.request(RQSTAT)
    if isinstance(state, int):
        target.send(raw[:state]) if state else None
        target.wait((state + 2) * driver.link.byte_ns / 1e9)
    elif state == "skipping":
        target.send(codec.packet(absent(driver.session), RQSTAT)[:9])
        target.wait(11 * driver.link.byte_ns / 1e9)
    elif state == "replying":
        target.send(raw)
        driver.client.receive(1 + HEARD_BYTES)
    else:
        driver.link.unanswered()
        if state == "waiting":
            text = driver.link.refuse_in("MSC-PHY-04")
            driver.session.step(text is not None, "a repeat", "nothing")
        else:
            target.send(NAK)
            driver.client.receive(HEARD_BYTES)
