"""The line and the frame: which bytes are a request at all (LINE, FRAME)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST
from axistwin_conformance.families.mac.axis.checks.motion import judge_targets_under_sub_indices
from axistwin_conformance.families.mac.axis.driver.client import (
    QUIET_S,
    AxisExchange,
    Part,
    quiet_s,
)
from axistwin_conformance.families.mac.axis.driver.motion import SAFE_PERIOD, segment_parameter
from axistwin_conformance.families.mac.axis.driver.unknown_modules import unknown_module_at
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.parameters import settings_of, values_of
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.checks.line import speaks_for_itself
from axistwin_conformance.families.mac.serial.codec import ETX, STX, SerialRequest
from axistwin_conformance.families.mac.serial.driver import NACKED_BY_MANY, SerialDriver

ORDER = 10  # of this module in a run; see `Family.modules`

OTHER_RATES: Final = (9600, 19200, 57600)
IMAX_ADDRESS: Final = 0xAF  # MACS-Q-28-01: the one byte of RAM that is known not to change
SLOW_TYPING_GAP_S: Final = 0.03
BEHIND_THE_LAST: Final = ", though the queries of the manual end at 29h"
VERY_SLOW_TYPING_GAP_S: Final = 20.0  # costs nothing in virtual time

WRONG_LENGTH_FIELDS: Final = (b"011", b"013", b"015", b"00E", b"114", b"140", b"000", b"01A")
WRONG_ENDS: Final = (b"\x00", b"\x02", b"\x04", b"0", b"\r", b"\xff")
NOISE: Final = (b"\x00", b"\xff", bytes([ETX]), b"\r\n", b"0140020", bytes(range(0x20, 0x60)))

# Which of a command's eight digits matter (§3.3); the others are printed x, or are always 00.
SIGNIFICANT_DIGITS: Final[Mapping[int, range]] = {
    **dict.fromkeys((0x09, 0x0A, 0x13, 0x16, 0x1E), range(8)),
    **dict.fromkeys((0x02, 0x03, 0x07, 0x0C, 0x0F, 0x1C), range(6, 8)),
    0x0D: range(4, 8),
    0x0E: range(4, 6),
    0x15: range(2, 8),
}
# Characters that a lenient number parser takes for part of a number, and a module must not.
NOT_HEX: Final = (b"2G", b"G0", b" 2", b"2 ", b"+2", b"-2", b"2_", b"x2", b"2\x00", b"\xb20")


@check("MACS-LINE-01", "MACS-REPLY-16")
def it_talks_38400_baud_and_no_other_rate(session: Session) -> None:
    """A query is answered at 38400 baud within the time-out, and gets no answer at other rates."""
    driver = SerialDriver(session)
    before_ns = session.target.now_ns
    driver.judge.alive()
    took_ms = (session.target.now_ns - before_ns) / 1e6
    session.expect(took_ms < 500, "MACS-REPLY-16", "a reply within 500 ms", f"{took_ms:.1f} ms")
    session.info("MACS-REPLY-16", f"a query and its answer take {took_ms:.2f} ms")
    if session.target.description.startswith("socket:"):
        return  # a plain socket carries bytes, not a rate
    own_rate = session.target.baud
    if own_rate in OTHER_RATES:
        session.not_run("MACS-LINE-01", f"this module has been set to {own_rate} baud")
        return
    try:
        for rate in OTHER_RATES:
            session.target.baud = rate
            reply = driver.client.send(driver.client.request(0x20), QUIET_S).reply
            is_answered = reply.kind in (ReplyKind.ANSWER, ReplyKind.ACCEPTED)
            if is_answered and session.target.is_pty:
                session.not_run("MACS-LINE-01", "what is behind this pty hears us at any rate")
                return
            session.expect(not is_answered, "MACS-LINE-01", f"no answer at {rate} baud", reply)
            session.target.wait(QUIET_S)
    finally:
        session.target.baud = own_rate
        session.target.wait(QUIET_S)
    driver.judge.alive("MACS-LINE-01")


@check("MACS-LINE-02", "MACS-REPLY-07")
def xoff_and_xon_arrive_as_bytes_of_the_reply(session: Session) -> None:
    """Every answer and every refusal carries 13h as its second byte, an answer Xon as its last."""
    driver = SerialDriver(session)
    refusal = driver.client.send(driver.client.request(0x12), QUIET_S).reply.raw
    session.expect(
        refusal[1:2] in (b"", b"\x13"), "MACS-LINE-02", "06 13 17", refusal.hex(" ")
    )  # silence is a reading of MACS-AMB-58
    reply = driver.judge.must(ReplyKind.ANSWER, driver.client.ask(0x20)).reply
    session.expect(
        reply.raw[:3] == b"\x06\x13\x02",
        ("MACS-LINE-02", "MACS-REPLY-07"),
        "06 13 02",
        reply.raw[:3].hex(" "),
    )
    spelled = reply.xon_spelling
    assert spelled is not None, "an answer ends with one of the two"
    session.quirk("MACS-LINE-02", "xon_byte", spelled)


@check("MACS-FRAME-01", "MACS-FRAME-02")
def shorter_frames_get_no_reply(session: Session) -> None:
    """A frame with any one byte left out is not answered, were the sum right over the rest of it;
    the next whole one is, once."""
    driver = SerialDriver(session)
    whole = driver.client.request(0x20, 0x12345678).encode()
    every = 1 if session.target.is_virtual else 4
    for missing in range(0, len(whole), every):
        exchange = driver.client.send(whole[:missing] + whole[missing + 1 :], QUIET_S)
        _no_success(session, exchange.reply, f"20 bytes, byte {missing} left out", "MACS-FRAME-01")
        driver.judge.alive("MACS-FRAME-01")
    every = 1 if session.target.is_virtual else 5
    for missing in range(4, 18, every):
        exchange = driver.client.send(_summed(whole[:missing] + whole[missing + 1 : 18]), QUIET_S)
        what = f"20 bytes, byte {missing} left out, and the sum of the other 13 characters"
        _no_success(session, exchange.reply, what, "MACS-FRAME-01")
        driver.judge.alive("MACS-FRAME-01")
    for length in (1, 4, 11, 20):
        exchange = driver.client.send(whole[:length], QUIET_S)
        _no_success(session, exchange.reply, f"{length} bytes", "MACS-FRAME-01")
        driver.judge.alive("MACS-FRAME-01")
    driver.judge.alive("MACS-FRAME-02")


@check("MACS-FRAME-01")
def longer_frames_get_no_reply(session: Session) -> None:
    """A frame with one byte too many between Stx and Etx is not answered, whatever it sums up; the
    next whole one is."""
    driver = SerialDriver(session)
    whole = driver.client.request(0x20).encode()
    for place in (4, 6, 8, 10, 17, 18, 19, 20):
        longer = whole[:place] + b"0" + whole[place:]
        exchange = driver.client.send(longer, QUIET_S)
        _no_success(session, exchange.reply, f"22 bytes, a 0 before byte {place}", None)
        driver.judge.alive()
    for place in (10, 17):
        longer = _summed(whole[:place] + b"0" + whole[place:18])
        what = f"22 bytes, a 0 before byte {place}, and the sum of the 15 characters"
        _no_success(session, driver.client.send(longer, QUIET_S).reply, what, None)
        driver.judge.alive()


def _summed(unsummed: bytes) -> bytes:
    """A frame up to its parameters, with the sum of all behind its length field, and Etx."""
    return unsummed + codec.two_digits(codec.checksum(unsummed[4:])) + bytes([ETX])


def _no_success(
    session: Session, reply: codec.SerialReply, what: str, requirement: str | None
) -> None:
    is_success = reply.kind in (ReplyKind.ACCEPTED, ReplyKind.ANSWER)
    session.expect(not is_success, requirement, f"no success for {what}", reply)


@check("MACS-FRAME-02", "MACS-FRAME-12")
def another_length_field_drops_the_frame(session: Session) -> None:
    """A frame whose length field is not 014 is dropped without a reply."""
    driver = SerialDriver(session)
    for length in WRONG_LENGTH_FIELDS:
        frame = replace(driver.client.request(0x20), length=length)
        _is_dropped(driver, frame, ("MACS-FRAME-02", "MACS-FRAME-12"))


@check("MACS-FRAME-12")
def another_byte_for_etx_drops_the_frame(session: Session) -> None:
    """A frame whose last byte is not Etx is dropped without a reply."""
    driver = SerialDriver(session)
    for end in WRONG_ENDS:
        if end == bytes([STX]):
            # Stx there begins a new frame, which the next query then restarts (MACS-FRAME-11).
            driver.client.send(replace(driver.client.request(0x20), end=end), QUIET_S)
            driver.judge.alive()
            continue
        _is_dropped(driver, replace(driver.client.request(0x20), end=end))


def _is_dropped(
    driver: SerialDriver, frame: SerialRequest, names: tuple[str, ...] = ("MACS-FRAME-12",)
) -> None:
    kind = driver.client.send(frame, quiet_s(driver.client.target)).kind
    readings = {ReplyKind.SILENCE: 0, ReplyKind.NACK: 1}
    driver.judge.reading(
        "bad_frame_reply", readings.get(kind, f"{kind.value} to a malformed frame"), names
    )
    driver.judge.alive("MACS-FRAME-12")


USUAL_MISTAKES: Final = {  # by how much they make the sum too large
    0x95: " (the length field 014 added to the sum)",
    0x97: " (Stx and the length field 014 added to the sum)",
}


@check("MACS-FRAME-03", "MACS-REPLY-02", "MACS-REPLY-11")
def every_other_checksum_is_nacked(session: Session) -> None:
    """A query with the right checksum is answered; with any other it gets the single byte 15h."""
    driver = SerialDriver(session)
    frame = driver.client.request(0x28, 0, 0xAF)
    driver.judge.must(ReplyKind.ANSWER, driver.client.send(frame), "MACS-FRAME-03")
    if driver.client.is_nacked_by_many:
        session.skip(NACKED_BY_MANY)
    offsets: Iterable[int] = range(1, 0x100)
    if not session.target.is_virtual:
        right = codec.checksum(frame.summed)
        flipped = ((right ^ 1 << bit) - right & 0xFF for bit in range(8))
        offsets = dict.fromkeys((1, 0x0F, 0x10, *USUAL_MISTAKES, 0xFF, *flipped))
    for offset in offsets:
        exchange = driver.client.send(frame.with_wrong_checksum(offset))
        seen, mistake = driver.client.observed(exchange), USUAL_MISTAKES.get(offset, "")
        session.expect(
            exchange.kind is ReplyKind.NACK,
            ("MACS-REPLY-02", "MACS-REPLY-11", "MACS-FRAME-03"),
            driver.client.wanted(ReplyKind.NACK),
            replace(seen, clause=seen.clause.replace(REQUEST, f"{REQUEST}{mistake}")),
        )
    extra = session.target.receive(1, QUIET_S)
    session.expect(not extra, "MACS-REPLY-02", "nothing after 15h", extra.hex(" "))


@check("MACS-FRAME-03", "MACS-FRAME-04")
def digits_are_read_in_upper_case(session: Session) -> None:
    """Letters of a frame in lower case are refused as no digits, or read like upper case."""
    driver = SerialDriver(session)
    _in_lower_case(
        driver,
        driver.client.request(0x28, 0, 0xAF),
        ReplyKind.ANSWER,
        ("MACS-FRAME-03", "MACS-FRAME-04"),
    )
    driver.judge.alive("MACS-FRAME-03")


@check("MACS-FRAME-04", safety="stored")
def digits_of_commands_are_read_in_upper_case(session: Session) -> None:
    """Nor is an index, or a parameter, read otherwise; written is what is stored already."""
    driver = SerialDriver(session)
    _in_lower_case(
        driver, driver.client.request(0x0C, driver.client.parameter(0x0C)), ReplyKind.ACCEPTED
    )
    for index, query in ((0x09, 0x22), (0x0A, 0x23)):
        _in_lower_case(
            driver, driver.client.request(index, driver.client.value(query)), ReplyKind.ACCEPTED
        )


def _in_lower_case(
    driver: SerialDriver,
    upper: SerialRequest,
    success: ReplyKind,
    requirement: Part = "MACS-FRAME-04",
) -> None:
    """Send a frame as it should be spelt, then in lower case, if that is another one."""
    if upper.in_lower_case() == upper:
        return
    expected = driver.judge.must(success, driver.client.send(upper), requirement).reply.data
    reply = driver.client.send(upper.in_lower_case(), QUIET_S).reply
    if reply.kind is success:
        outcome: int | str = 1 if reply.data == expected else f"another answer: {reply}"
    elif reply.kind in (ReplyKind.REFUSED, ReplyKind.SILENCE, ReplyKind.NACK):
        outcome = 0
    else:
        outcome = str(reply)
    driver.judge.reading("lowercase_hex", outcome, "MACS-FRAME-04")


@check("MACS-FRAME-06")
def digits_printed_x_have_no_effect_in_queries(session: Session) -> None:
    """A query gives the same answer whatever its parameter digits are, all under the checksum."""
    driver = SerialDriver(session)
    for index in (0x22, 0x24, 0x28):
        plain = driver.client.value(index)
        for parameter in (1, 0xABCDEF01, 0xFFFFFFFF, session.random.getrandbits(32)):
            exchange = driver.client.send(driver.client.request(index, parameter))
            outcome: int | str = 1
            if exchange.kind is ReplyKind.ANSWER:
                same = exchange.reply.data == plain
                outcome = 0 if same else f"{exchange.reply} instead of {plain:08X}"
            elif exchange.kind is not ReplyKind.REFUSED:
                outcome = str(exchange.reply)
            driver.judge.reading("dont_care_digits", outcome)


@check("MACS-FRAME-07", "MACS-REPLY-13", "MACS-REPLY-08")
def only_its_own_address_and_ff_reach_it(session: Session) -> None:
    """No frame for another individual address, nor for 80h..FEh, gets a reply, and the next answer
    carries the own one."""
    driver = SerialDriver(session)
    taken = {session.address, *session.neighbours}
    others = [address for address in range(0xFF) if address not in taken]
    if not session.target.is_virtual:
        near = [session.address ^ 1, session.address + 1, session.address ^ 0x40, 0x7F, 0x80, 0xFE]
        others = [address for address in dict.fromkeys(near) if address in others]
    for address in others:
        exchange = driver.client.send(driver.client.request(0x20, address=address), QUIET_S)
        names = ("MACS-FRAME-07", "MACS-REPLY-13") if address < 0x80 else ("MACS-FRAME-07",)
        is_silent = exchange.kind is ReplyKind.SILENCE
        hint = "" if is_silent or address >= 0x80 else unknown_module_at(driver.client, address)
        wanted, came = driver.client.wanted(ReplyKind.SILENCE), driver.client.observed(exchange)
        session.expect(is_silent, names, wanted, came, hint)
        speaks_for_itself(driver)


@check("MACS-FRAME-08", "MACS-Q-XX-02")
def queries_end_at_29h(session: Session) -> None:
    """20h to 29h are answered with data; 2Ah to 2Fh and all above are treated as not used."""
    driver = SerialDriver(session)
    for index in range(0x20, 0x2A):
        driver.judge.must(ReplyKind.ANSWER, driver.client.ask(index), "MACS-FRAME-08")
    above = range(0x30, 0x100) if session.target.is_virtual else (0x30, 0x40, 0x80, 0xFF)
    for index in (*range(0x2A, 0x30), *above):
        names = ("MACS-Q-XX-02", "MACS-FRAME-08")
        exchange = driver.client.send(driver.client.request(index), QUIET_S)
        outcome = reading_of_unassigned(driver, index, exchange)
        shown = driver.client.observed(exchange)
        shown = replace(shown, clause=f"{shown.clause}{BEHIND_THE_LAST}")
        driver.judge.reading("unknown_index", outcome, names, shown)


@check("MACS-CMD-XX-01", "MACS-FRAME-08")
def unassigned_commands_are_refused(session: Session) -> None:
    """04h, 05h, 06h, 12h, 1Dh and 1Fh are refused, whatever their parameters."""
    driver = SerialDriver(session)
    names = "MACS-CMD-XX-01", "MACS-FRAME-08"
    for index in (0x04, 0x05, 0x06, 0x12, 0x1D, 0x1F):
        for parameter in (0, 1, 0xFFFFFFFF):
            outcome = unassigned(driver, index, parameter)
            if parameter and outcome == 0 and driver.readings.known("unknown_index"):
                driver.judge.reading(
                    "dont_care_digits", 1, names
                )  # for its digits, not for its index
            else:
                driver.judge.reading("unknown_index", outcome, names)


def unassigned(driver: SerialDriver, index: int, parameter: int = 0) -> int | str:
    """Which reading of MACS-AMB-58 an unassigned index shows."""
    exchange = driver.client.send(driver.client.request(index, parameter), QUIET_S)
    return reading_of_unassigned(driver, index, exchange)


def reading_of_unassigned(driver: SerialDriver, index: int, exchange: AxisExchange) -> int | str:
    """The same of an exchange."""
    reply = exchange.reply
    if reply.kind is ReplyKind.ANSWER:
        return 2 if reply.data == 0 else f"{index:02X}h: {reply}"  # no reading explains it
    if (
        reply.kind is ReplyKind.ACCEPTED
        and index < 0x20
        and driver.readings.known("unknown_index") == 2
    ):
        return 2  # commands have no answer to put zeros into
    readings = {ReplyKind.REFUSED: 0, ReplyKind.ACCEPTED: 1, ReplyKind.SILENCE: 3}
    return readings.get(reply.kind, f"{index:02X}h: {reply}")


@check("MACS-FRAME-09")
def the_sub_index_matters_only_to_memory_queries(session: Session) -> None:
    """A sub-index other than 00 is ignored, or refused, wherever it is not a byte address."""
    driver = SerialDriver(session)
    for index in (0x20, 0x22, 0x26):
        plain = driver.client.value(index)
        for sub_index in (0x01, 0x10, 0xFF):
            reply = driver.client.send(driver.client.request(index, 0, sub_index)).reply
            outcome: int | str = str(reply)
            if reply.kind is ReplyKind.REFUSED:
                outcome = 1
            elif reply.kind is ReplyKind.ANSWER and reply.data == plain:
                outcome = 0
            driver.judge.reading("subindex_policy", outcome)
    before, at = (
        driver.client.data_bytes(0x28, IMAX_ADDRESS - 1),
        driver.client.data_bytes(0x28, IMAX_ADDRESS),
    )
    session.expect(
        before[1:] == at[:3],
        None,
        f"28h AF to begin with {bytes(before[1:]).hex()}",
        bytes(at).hex(),
    )


@check("MACS-FRAME-09", safety="stored")
def the_sub_index_is_no_part_of_a_number(session: Session) -> None:
    """A sub-index other than 00 before a setting changes nothing of what is set, or is refused."""
    driver = SerialDriver(session)
    for number, sub_index in ((0x01234567, 0x01), (-0x01234567, 0xFF), (0x01234567, 0xF0)):
        before = driver.client.value(0x22)
        kind = driver.client.command(0x09, number, sub_index).kind
        stored = driver.client.value(0x22)
        outcome: int | str = f"09h {sub_index:02X}h: {kind.value}, then 22h reads {stored:08X}h"
        if kind is ReplyKind.ACCEPTED and stored == number & 0xFFFFFFFF:
            outcome = 0
        elif kind is ReplyKind.REFUSED and stored == before:
            outcome = 1
        driver.judge.reading("subindex_policy", outcome)


@check("MACS-FRAME-09", safety=MOVES)
def the_sub_index_is_no_part_of_a_target(session: Session) -> None:
    """A sub-index other than 00 before a target leads to the same place, or is refused."""
    judge_targets_under_sub_indices(SerialDriver(session))


@check("MACS-FRAME-10")
def noise_between_frames_is_ignored(session: Session) -> None:
    """Bytes before Stx and behind Etx do not disturb the frame beside them."""
    driver = SerialDriver(session)
    frame = driver.client.request(0x20).encode()
    for noise in NOISE:
        driver.judge.must(ReplyKind.ANSWER, driver.client.send(noise + frame))
        session.expect(
            not session.target.receive(1, QUIET_S), None, "one reply", "more than one reply"
        )
    driver.client.send(noise, QUIET_S)
    driver.judge.alive()


@check("MACS-FRAME-11")
def stx_begins_anew(session: Session) -> None:
    """Stx inside an unfinished frame restarts it: half a frame and a whole one get one answer."""
    driver = SerialDriver(session)
    frame = driver.client.request(0x20).encode()
    for cut in range(1, len(frame)) if session.target.is_virtual else (1, 4, 10, 20):
        exchange = driver.client.send(frame[:cut] + frame)
        seen = driver.client.observed(exchange)
        part = frame[:cut].hex(" ").upper()
        clause = seen.clause.replace(
            REQUEST, f"a whole 20h query, sent after a frame broken off after {part},"
        )
        session.expect(
            exchange.kind is ReplyKind.ANSWER,
            None,
            "an answer",
            replace(
                seen,
                clause=clause,
                wanted="an answer, because each Stx (02h) begins a new frame",
                is_whole=True,
            ),
        )
        extra = session.target.receive(1, QUIET_S)
        session.expect(not extra, None, "one reply", f"then {extra.hex(' ')}")


@check("MACS-FRAME-13")
def characters_that_are_no_digits_are_refused(session: Session) -> None:
    """Something else than a hex digit in index or sub-index, under a right checksum, is refused."""
    driver = SerialDriver(session)
    for characters in NOT_HEX:
        for frame in (
            replace(driver.client.request(0x20), index=characters),
            replace(driver.client.request(0x28), sub_index=characters),
        ):
            _is_refused_as_malformed(driver, frame)


@check("MACS-FRAME-13", safety="stored")
def parameters_that_are_no_digits_are_refused(session: Session) -> None:
    """09h with a character that is no hex digit is refused, and the stored value stays."""
    driver = SerialDriver(session)
    before = driver.client.value(0x22)
    for characters in NOT_HEX:
        frame = replace(driver.client.request(0x09), parameters=b"000000" + characters)
        _is_refused_as_malformed(driver, frame)
        after = driver.client.value(0x22)
        session.expect(after == before, None, f"22h still {before:08X}", f"{after:08X}")


@check("MACS-FRAME-13", safety=("motion", "stored"), level="full")
def no_command_takes_another_character_for_a_digit(session: Session) -> None:
    """A character that is no hex digit in any place that matters, of any command, is refused."""
    driver = SerialDriver(session)
    driver.motion.ready()
    speeds, modes, place = (
        driver.client.value(0x25),
        driver.client.value(0x26),
        driver.client.position(),
    )
    stops = {query: driver.client.value(query) for query in (0x22, 0x23)}
    one_step = segment_parameter(1, SAFE_PERIOD)
    harmless = {
        **settings_of(values_of({0x25: speeds, 0x26: modes, **stops})),
        0x07: 0,
        0x13: place,
        0x15: 0,
        0x16: one_step,
        0x1E: one_step,
    }
    for index, parameter in sorted(harmless.items()):
        digits = codec.eight_digits(parameter)
        for number in SIGNIFICANT_DIGITS[index]:
            corrupted = digits[:number] + b"G" + digits[number + 1 :]
            _is_refused_as_malformed(
                driver, replace(driver.client.request(index), parameters=corrupted)
            )
    found = driver.client.value(0x25), driver.client.value(0x26), driver.client.position()
    described = f"25h, 26h, 20h still {speeds:08X}, {modes:08X}, {place}"
    session.expect(found == (speeds, modes, place), None, described, found)


def _is_refused_as_malformed(driver: SerialDriver, frame: SerialRequest) -> None:
    exchange = driver.client.send(frame, QUIET_S)
    if exchange.kind is ReplyKind.NACK:
        driver.judge.reading("bad_frame_reply", 1)
        return
    wrong = next(byte for byte in frame.summed if byte not in codec.DIGITS)
    name = "a blank" if wrong == 0x20 else f'"{chr(wrong)}"'
    seen = driver.client.observed(exchange)
    clause = seen.clause.replace(REQUEST, f"{REQUEST} with {name} ({wrong:02X}h) as a hex digit")
    driver.session.expect(
        exchange.kind is ReplyKind.REFUSED,
        None,
        driver.client.wanted(ReplyKind.REFUSED),
        replace(seen, clause=clause, is_whole=True),
    )


@check("MACS-FRAME-10", level="full")
def noise_through_a_reply_does_not_deafen_it(session: Session) -> None:
    """A query right behind noise that begins during a reply and ends after it is answered."""
    driver = SerialDriver(session)
    if not session.target.is_virtual:
        session.skip("needs a line on which nothing is lost: noise runs into the reply")
    frame, target = driver.client.request(0x20).encode(), session.target
    # The reply begins when this device likes, and the noise has to last beyond it.
    noise = b"\xff" * (4 * codec.ANSWER_BYTES + target.uncertainty_ns // target.byte_ns)
    target.send(frame + noise + frame)
    target.wait(
        ((len(noise) + 6 * codec.ANSWER_BYTES) * target.byte_ns + target.uncertainty_ns) / 1e9
    )
    arrived = target.drain()
    last = codec.parse(arrived[-codec.ANSWER_BYTES :])
    session.expect(last.kind is ReplyKind.ANSWER, None, "an answer at last", arrived.hex(" "))
    driver.judge.alive()


@check("MACS-FRAME-14")
def typing_may_be_slow(session: Session) -> None:
    """A frame whose characters come with long pauses is answered like any other."""
    driver = SerialDriver(session)
    gap_s = VERY_SLOW_TYPING_GAP_S if session.target.is_virtual else SLOW_TYPING_GAP_S
    frame = driver.client.request(0x20).encode()
    for byte in frame[:-1]:
        session.target.send(bytes([byte]))
        session.target.wait(gap_s)
    driver.judge.must(ReplyKind.ANSWER, driver.client.send(frame[-1:]))
