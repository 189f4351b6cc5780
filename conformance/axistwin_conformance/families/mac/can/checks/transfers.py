"""Requests and replies, byte for byte (SDO): what is repeated, what is refused, what does not
matter, and that nothing else is said or done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import cycle
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mac.axis.checks.motion import judge_targets_under_sub_indices
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.driver.unknown_modules import unknown_module_at
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.kinematics import ramp_increments
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import CanRequest
from axistwin_conformance.families.mac.can.collect_replies import (
    described,
    everybody,
    exactly,
    outcome_of,
    replies,
    reply_frame,
    the_reply,
    unasked,
    unknown_addresses,
)
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.settings import SETTINGS, TORQUE, held, unchanged
from axistwin_conformance.sequences.golden import GoldenExchange, golden_exchanges
from axistwin_conformance.transport.can_frame import Frame

ORDER = 40  # of this module in a run; see `Family.modules`

LISTEN_S: Final = 60.0  # a minute of a module's silence; on a real bus a moment of it
LISTEN_REAL_S: Final = 0.5
ACKNOWLEDGED_WITHIN_S: Final = 0.5  # MACS-REPLY-16: what the ledger gives a reply
REFUSED_EXCHANGES: Final = 12  # three replies that are listened behind, and a look after each
LONG: Final = 100  # increments at the slowest speed: longer than that
QUICK: Final = 0x1000  # 512 us an increment
RAMPED: Final = 0x5800  # with AA 1 a ramp takes 0.68 s: longer than a reply may
LATE_S: Final = 0.2
# Commands whose effect lasts, and what is sent before each.
LASTING: Final[tuple[tuple[tuple[int, ...], int], ...]] = (
    ((), 0x13), ((), 0x14), ((), 0x15), ((0x15,), 0x15), ((), 0x16), ((0x16,), 0x16),
    ((0x15,), 0x17), ((0x13,), 0x17), ((0x15,), 0x18), ((0x13,), 0x18), ((0x16,), 0x18),
    ((0x10, 0x13), 0x11),
)  # fmt: skip
PAUSE_STEPS: Final = 0x800  # of 8 ms: longer than a burst of segments takes on any line
MOST_STAGES: Final = 6
RESTART_SHOWS_S: Final = 3.0  # a module that has restarted says so after 2 s

FILLERS: Final = (0xFFFFFFFF, 0x01000000, 0x00010000, 0x00000100, 0x00000001, 0x23002000)
SUB_INDICES: Final = (0x01, 0x02, 0x10, 0x20, 0x7F, 0x80, 0xFF)
# Parameter bytes that have no meaning, by index (ledger §2.2); the fourth one of 200Eh is no x.
DONT_CARE: Final[Mapping[int, int]] = {
    **dict.fromkeys((0x02, 0x03, 0x0C, 0x0F, 0x1C), 0xFFFFFF00),
    0x0D: 0xFFFF0000,
    0x0E: 0xFFFF0000,
}
# Examples which mean, their last byte first, a 0 beside bytes that do not count: a module may
# refuse either (MACC-AMB-01, MACS-AMB-47, MACS-AMB-62).
MAY_BE_REFUSED: Final = (b"\x23\x02", b"\x23\x0e")
WITHOUT_PARAMETER: Final = (0x10, 0x17, 0x19, 0x18, 0x1A)
LOCKED: Final = (0x02, 0x13)
# C's list has these beside; the serial one has lost them (MACS-AMB-08).
LOCKED_BY_THE_LIST: Final = (0x03, 0x09, 0x0A, 0x0D, 0x0F, 0x14)


def judge_accepted(driver: CanDriver, request: CanRequest, requirement: str) -> None:
    """60h, what was named, four zeros; nothing else."""
    exactly(driver, request.frame(), reply_frame(request, codec.ACCEPTED), requirement)


def _refusal_seen(request: CanRequest, received: tuple[Frame, ...], wanted: Frame) -> Observation:
    """What came in place of a refusal, in words."""
    came, expected = described(received), f"the refusal {wanted}, and nothing else"
    clause = f"{REQUEST} was answered with {came}" if received else f"{REQUEST} got no reply"
    if len(received) == 1 and received[0].data[:1] == wanted.data[:1]:
        fields = [one.data[2:3] + one.data[1:2] + one.data[3:4] for one in (received[0], wanted)]
        seen, due = (
            f"{one[:2].hex().upper()}h sub-index {one[2:].hex().upper()}h" for one in fields
        )
        clause = f"the refusal of {REQUEST} named index {seen}: {received[0]}"
        expected = f"index {due}: {wanted}"
    return Observation(clause, came, expected, request=request.frame().pack(), is_whole=False)


def judge_refused(driver: CanDriver, request: CanRequest, requirement: str) -> None:
    """80h, what was named, four zeros, or a reason instead (MACC-AMB-17); nothing else."""
    received, wanted = replies(driver, request.frame()), reply_frame(request, codec.REFUSED)
    is_refusal = len(received) == 1 and received[0].data[:4] == wanted.data[:4]
    is_whole = is_refusal and len(received[0].data) == codec.TRANSFER_BYTES
    driver.session.expect(
        is_whole and received[0].identifier == wanted.identifier,
        requirement,
        f"{wanted} alone",
        partial(_refusal_seen, request, received, wanted),
    )
    if requirement == "MACC-SDO-02":
        driver.judge.reading("abort_code_form", int(received[0] != wanted), requirement)


# --- the manual's examples -----------------------------------------------------------------------


def _frame(text: str) -> Frame:
    identifier, _, data = text.partition(" ")
    return Frame(int(identifier, 16), bytes.fromhex(data))


GOLDEN_IDS: Final = (
    "MACC-SDO-01", "MACC-SDO-03", "MACC-SDO-04", "MACC-CMD-16-01", "MACC-CMD-1E-01",
    "MACC-CMD-02-01", "MACC-CMD-0E-01", "MACC-Q-00-01", "MACC-GEN-01", "MACC-GEN-02", "MACC-GEN-03",
)  # fmt: skip


@check(*GOLDEN_IDS, safety=MOVES)
def the_manuals_examples_get_their_replies(session: Session) -> None:
    """Every worked example, its misprints corrected, gets the reply that belongs to it."""
    drivers = everybody(session)
    for golden in golden_exchanges("mac_can", _frame):
        number = golden.request.identifier - codec.REQUEST
        if number == codec.GENERAL_ADDRESS:
            _judge_golden_to_all(drivers[0], golden)
            continue
        driver = drivers[(number - 1) % len(drivers)]
        driver.motion.ready()
        request = replace(golden.request, identifier=codec.REQUEST + driver.client.address)
        received = replies(driver, request)
        driver.motion.at_rest()
        wanted = replace(golden.reply, identifier=codec.REPLY + driver.client.address)
        if golden.reply.data[0] == 0x42:  # where the axis stands is not the manual's affair
            shown = {b"\x42": 0, b"\x43": 1}.get(
                received[0].data[:1] if received else b"", described(received)
            )
            driver.judge.reading("upload_scs", shown, "MACC-SDO-03")
            received = tuple(
                replace(frame, data=b"\x42" + frame.data[1:4] + bytes(4)) for frame in received
            )
        admissible = [wanted]
        if request.data[:2] in MAY_BE_REFUSED and driver.readings.known("can_byte_order"):
            admissible.append(replace(wanted, data=bytes([codec.REFUSED]) + wanted.data[1:]))
        session.expect(
            received in [(frame,) for frame in admissible],
            golden.requirements,
            f"{' or '.join(map(str, admissible))} to {request}",
            described(received),
        )


def _judge_golden_to_all(driver: CanDriver, golden: GoldenExchange[Frame]) -> None:
    session, received = driver.session, replies(driver, golden.request)
    if codec.SPOKESMAN not in (session.address, *session.neighbours):
        hint = unknown_module_at(driver.client, codec.SPOKESMAN) if received else ""
        session.expect(
            not received, "MACC-GEN-02", "silence: no module 1", described(received), hint
        )
        for name in ("MACC-GEN-01", "MACC-GEN-03"):
            session.not_run(name, "there is no module 1 on this bus")
        return
    data, wanted = tuple(frame.data for frame in received), golden.reply.data
    if driver.readings.known("sync_without_preload"):  # its 2011h starts nothing (MACS-AMB-34)
        data, wanted = tuple(payload[:4] for payload in data), bytes([codec.REFUSED]) + wanted[1:4]
    session.expect(data == (wanted,), golden.requirements, golden.reply, described(received))
    whence = {codec.REPLY + 1: 0, codec.REQUEST + 1: 1}.get(
        received[0].identifier, described(received)
    )
    driver.judge.reading("general_reply_id", whence, "MACC-GEN-03")


# --- the form of replies -------------------------------------------------------------------------


@check("MACC-SDO-01", safety=MOVES)
def accepted_downloads_are_answered_with_60h_and_zeros(session: Session) -> None:
    """Every accepted download gets 60h, its index, its sub-index and four zeros, once."""
    driver = CanDriver(session)
    driver.motion.ready()
    for setting in SETTINGS.values():
        value = setting.parameter(setting.read(driver))
        judge_accepted(driver, driver.client.request(setting.index, value), "MACC-SDO-01")
    judge_accepted(driver, driver.client.request(0x07, 0), "MACC-SDO-01")
    for index in WITHOUT_PARAMETER:
        judge_accepted(driver, driver.client.request(index), "MACC-SDO-01")
    place = driver.client.position()
    judge_accepted(driver, driver.client.request(0x13, place), "MACC-SDO-01")
    driver.motion.at_rest()


@check("MACC-SDO-02", "MACC-SDO-12", safety=MOVES)
def refused_downloads_are_answered_with_80h_and_zeros(session: Session) -> None:
    """Downloads that are locked during a move are refused with 80h, their index and sub-index, and
    four zeros; the move goes on and nothing is stored."""
    driver = CanDriver(session)
    start = driver.motion.ready(SLOWEST, 0)
    before = held(driver)[1:]
    locked = list(LOCKED)
    if session.reading("motion_lock_set") == "can_list":
        locked += LOCKED_BY_THE_LIST
    far = driver.limits.way_outlasting(LONG, SLOWEST, REFUSED_EXCHANGES)
    for number, index in enumerate(locked):  # there and back, each long enough for three replies
        forecast = driver.motion.go(start + (0 if number % 2 else far))
        parameter = start - 300
        if (setting := SETTINGS.get(index)) is not None:
            parameter = setting.parameter(setting.values[0])
        for sub_index in (0x00, 0x01, 0xFF):
            judge_refused(driver, driver.client.request(index, parameter, sub_index), "MACC-SDO-02")
            driver.motion.follow(forecast, "MACC-SDO-12", driver.limits.allowance(SLOWEST))
        driver.motion.watch(forecast, "MACC-SDO-12", samples=2)
    after = held(driver)[1:]
    session.expect(after == before, "MACC-SDO-12", before, after)
    _judge_refused_segments(driver)


def _judge_refused_segments(driver: CanDriver) -> None:
    """A segment for which there is no stage left is refused in the same words."""
    driver.motion.at_rest()
    pause = segment_parameter(PAUSE_STEPS, SLOWEST)
    for _ in range(MOST_STAGES):
        if driver.client.command(0x1E, pause).kind is ReplyKind.REFUSED:
            break
    else:
        return  # checks of the FIFO judge that
    for index, parameter in ((0x1E, pause), (0x16, segment_parameter(5, SLOWEST))):
        judge_refused(driver, driver.client.request(index, parameter), "MACC-SDO-02")
    driver.motion.at_rest()


@check("MACC-SDO-03")
def uploads_are_answered_with_42h_and_four_bytes(session: Session) -> None:
    """Every upload of 2000h to 2007h gets 42h, its index, its sub-index and four bytes, once."""
    driver = CanDriver(session)
    for index in codec.ANSWERED:
        reply = the_reply(driver, driver.client.request(index), "MACC-SDO-03")
        spelling = reply.answer_spelling
        shown: int | str = str(reply) if spelling is None else int(spelling != "42h")
        driver.judge.reading("upload_scs", shown, "MACC-SDO-03")


@check("MACC-SDO-03", "MACC-SDO-14", safety=MOVES)
def uploads_in_motion_are_answered_as_at_rest(session: Session) -> None:
    """In motion of either direction every upload is answered, its sub-index repeated."""
    driver = CanDriver(session)
    for direction in (1, -1):
        driver.motion.ready(SLOWEST)
        driver.motion.turn(direction, SLOWEST)
        for index in codec.ANSWERED:
            for sub_index in (0x00, 0x05):
                request = driver.client.request(index, 0, sub_index)
                reply = the_reply(driver, request, "MACC-SDO-03")
                is_refused = reply.kind is ReplyKind.REFUSED
                if sub_index:
                    driver.judge.reading("subindex_policy", int(is_refused), "MACC-SDO-03")
                if not (sub_index and is_refused):
                    is_answer = reply.kind is ReplyKind.ANSWER
                    session.expect(is_answer, "MACC-SDO-14", "an answer in motion", reply)
        driver.motion.at_rest()


@check("MACC-SDO-07")
def the_filler_of_an_upload_does_not_matter(session: Session) -> None:
    """An upload gets the same reply whatever its last four bytes are."""
    driver = CanDriver(session)
    fillers = (*FILLERS, session.random.getrandbits(32))
    for index in codec.ANSWERED:
        plain = the_reply(driver, driver.client.request(index), None)
        for filler in fillers:
            reply = the_reply(driver, driver.client.request(index, filler), None)
            # Temperature and supply may differ by a count from one reply to the next.
            is_same = reply.kind is plain.kind and (index == 0x27 or reply.data == plain.data)
            session.expect(is_same, None, f"{plain}, filler {filler:08X}", reply)


def _judge_sub_index(driver: CanDriver, index: int, sub_index: int, plain: int) -> None:
    request = driver.client.request(index, 0, sub_index)
    received = replies(driver, request.frame())
    reply = codec.parse(received[0] if len(received) == 1 else None, driver.client.byte_order)
    outcome: int | str = described(received)
    if len(received) == 1 and not codec.mismatch(request, received[0]):
        if reply.kind is ReplyKind.ANSWER and reply.data == plain:
            outcome = 0
        elif reply.kind is ReplyKind.REFUSED:
            outcome = 1
    driver.judge.reading("subindex_policy", outcome)


@check("MACC-SDO-09")
def any_sub_index_is_repeated_and_selects_nothing(session: Session) -> None:
    """An upload with any sub-index repeats it and tells the same, or is refused for it."""
    driver = CanDriver(session)
    for index in (0x20, 0x22, 0x23, 0x24, 0x25, 0x26):
        plain = driver.client.value(index)
        every = index == 0x22 and session.transport.is_virtual
        for sub_index in range(1, 0x100) if every else SUB_INDICES:
            _judge_sub_index(driver, index, sub_index, plain)


@check("MACC-SDO-03", "MACC-SDO-01", "MACC-SDO-02", safety=MOVES)
def each_reply_repeats_what_its_own_request_names(session: Session) -> None:
    """Index and sub-index of a reply are its own request's, whatever other index and sub-index the
    request before has named, accepted or refused, in either direction, of whomever."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    request, other = driver.client.request, unknown_addresses(session)[0]
    own = ((0x07, "MACC-SDO-01"), (0x20, "MACC-SDO-03"), (0x12, "MACC-SDO-02"))
    sub_index, refusals = SUB_INDICES[2], 0
    for before in (
        *(request(index, 0, sub_index) for index in (0x07, 0x18, 0x21, 0x1B, 0x29)),
        request(0x26, 0, sub_index, address=other),
        replace(driver.client.to_all(0x26), sub_index=sub_index),
    ):
        for index, name in own:
            replies(driver, before.frame(), is_awaited=before.address != other)
            if index in codec.DOWNLOADS or index in codec.ANSWERED:
                the_reply(driver, request(index), name)
                continue
            received = replies(driver, request(index).frame())  # none at all in one reading
            flaws = [codec.mismatch(request(index), frame) for frame in received]
            wanted = f"the index and sub-index of {codec.explain(request(index).frame())}"
            session.expect(not any(flaws), name, wanted, described(received))
            refusals += len(received)
    if not refusals:
        session.not_run("MACC-SDO-02", "it does not answer what is unassigned (MACC-AMB-15)")


@check("MACC-SDO-09", safety="stored")
def a_download_with_a_sub_index_sets_the_same(session: Session) -> None:
    """A download with any sub-index sets what it sets without one, or is refused and sets
    nothing."""
    driver = CanDriver(session)
    for setting, sub_index in zip(cycle((TORQUE, SETTINGS[0x09])), SUB_INDICES, strict=False):
        before, value = setting.read(driver), setting.other(driver)
        request = driver.client.request(setting.index, setting.parameter(value), sub_index)
        outcome = outcome_of(driver, request, {ReplyKind.ACCEPTED: 0, ReplyKind.REFUSED: 1})
        driver.judge.reading("subindex_policy", outcome)
        wanted, seen = (value, before)[outcome == 1], setting.read(driver)
        session.expect(seen == wanted, None, f"{setting.stored.name} {wanted:02X}", f"{seen:02X}")


@check("MACC-SDO-09", safety=MOVES)
def a_target_with_a_sub_index_is_the_same(session: Session) -> None:
    """A download of a target with any sub-index leads to the same place, or is refused; a segment's
    is repeated as well."""
    driver = CanDriver(session)
    judge_targets_under_sub_indices(driver)
    for index in (0x1E, 0x16):
        driver.motion.ready(SLOWEST)
        request = driver.client.request(index, segment_parameter(LONG, SLOWEST), SUB_INDICES[0])
        outcome = outcome_of(driver, request, {ReplyKind.ACCEPTED: 0, ReplyKind.REFUSED: 1})
        driver.judge.reading("subindex_policy", outcome)
    driver.motion.at_rest()


# --- parameters ----------------------------------------------------------------------------------


@check("MACC-SDO-04", safety="stored")
def numbers_travel_most_significant_byte_first(session: Session) -> None:
    """A number is written and read with its most significant byte first, or, all of them, the other
    way round."""
    driver = CanDriver(session)
    for index in (0x0C, 0x0E, 0x0F, 0x1C):  # those whose place in download and upload differs
        setting = SETTINGS[index]
        before = driver.client.value(setting.stored.query)
        value = setting.other(driver)
        outcome: int | str = f"{index:02X}h: neither order sets it"
        for number, order in enumerate(("big", "little")):
            asked = codec.request(
                driver.client.address, index, setting.parameter(value), byte_order=order
            )
            replies(driver, asked.frame())
            answer = replies(
                driver, codec.request(driver.client.address, setting.stored.query).frame()
            )
            data = codec.parse(answer[0], order).data if len(answer) == 1 else None
            if data is not None and setting.stored.read(data) == value:
                outcome = number
                break
        driver.judge.reading("can_byte_order", outcome, "MACC-SDO-04")
        driver.client.command(index, setting.parameter(setting.stored.read(before)))


@check("MACC-SDO-04", safety="stored")
def every_byte_of_a_number_keeps_its_place(session: Session) -> None:
    """Four different bytes written by 2009h and 200Ah are read back by 2002h and 2003h, and two
    written by 200Dh by 2005h."""
    driver = CanDriver(session)
    longs = (0x01020304, 0x3FFEFDFC, 0xFEDCBA98, 0x00000001, 0xFFFFFFFF, 0x00010000)
    for index, values in ((0x09, longs), (0x0A, longs), (0x0D, (0xF012, 0x12F0, 0x2000))):
        for value in values:
            driver.client.command(index, value)
            seen = SETTINGS[index].read(driver)
            session.expect(seen == value, None, f"{value:08X}", f"{seen:08X}")


@check("MACC-SDO-08", safety=MOVES)
def bytes_without_a_meaning_may_hold_anything(session: Session) -> None:
    """A download sets the same whatever its don't-care bytes hold, or is refused for them."""
    driver = CanDriver(session)
    driver.motion.ready()
    for index, mask in DONT_CARE.items():
        setting = SETTINGS[index]
        for filler in (mask, mask & 0xAA55AA55, mask & session.random.getrandbits(32)):
            before, value = setting.read(driver), setting.other(driver)
            asked = driver.client.request(index, setting.parameter(value) | filler)
            outcome = outcome_of(
                driver, asked, {ReplyKind.ACCEPTED: 0, ReplyKind.REFUSED: int(filler > 0)}
            )
            driver.judge.reading("dont_care_digits", outcome)
            wanted, seen = (value, before)[outcome == 1], setting.read(driver)
            session.expect(seen == wanted, None, f"{index:02X}h {wanted:X}", f"{seen:X}")
    for index in (0x07, *WITHOUT_PARAMETER):
        asked = driver.client.request(index, 0xFFFFFF00 if index == 0x07 else 0xFFFFFFFF)
        outcome = outcome_of(driver, asked, {ReplyKind.ACCEPTED: 0, ReplyKind.REFUSED: 1})
        driver.judge.reading("dont_care_digits", outcome)
    driver.motion.disarm()


# --- reading is not writing ----------------------------------------------------------------------


@check("MACC-SDO-05")
def reading_an_index_does_not_do_what_writing_it_does(session: Session) -> None:
    """Uploads of 2000h to 200Fh, twice, neither restart the module nor change anything."""
    driver = CanDriver(session)
    before = held(driver)
    driver.client.target.take_spontaneous()
    for index in (*codec.QUERIES, *codec.QUERIES):
        replies(driver, driver.client.request(index, 0xFFFFFFFF).frame())
    booted = unasked(driver, RESTART_SHOWS_S, lambda frame: codec.boot_up_form(frame) is not None)
    session.expect(not booted, None, "no restart", [str(arrival.frame) for arrival in booted])
    unchanged(driver, before, "MACC-SDO-05")


@check("MACC-SDO-05", safety=MOVES)
def download_and_upload_of_an_index_are_two_things(session: Session) -> None:
    """What 20xxh writes shows elsewhere; no upload of 2000h to 200Fh is one of their downloads."""
    driver = CanDriver(session)
    start = driver.motion.ready()
    place = driver.motion.finish(driver.motion.go(start + 7))
    for index, shown, kept in (
        (0x02, 0x26, 0x22),
        (0x03, 0x26, 0x23),
        (0x09, 0x22, 0x23),
        (0x0A, 0x23, 0x22),
    ):
        setting = SETTINGS[index]
        before, value = driver.client.value(kept), setting.other(driver)
        driver.judge.accepted(index, setting.parameter(value))
        session.expect(
            setting.read(driver) == value, None, f"{value:X} in {shown:02X}h", setting.read(driver)
        )
        after = driver.client.value(kept)
        session.expect(after == before, None, f"{kept:02X}h {before:08X}", f"{after:08X}")
    for index in (0x02, 0x03):  # an axis in standby may swing by one increment
        driver.judge.accepted(index, 0)
    before_all = held(driver)
    for index in codec.QUERIES:
        replies(driver, driver.client.request(index).frame(), is_awaited=False)
    unchanged(driver, before_all, "MACC-SDO-05")
    session.expect(
        driver.client.position() == place, None, f"still at {place}", driver.client.position()
    )


# --- when, and how often -------------------------------------------------------------------------


@check("MACC-SDO-13", "MACC-SDO-06", safety=MOVES)
def a_motion_is_answered_when_it_is_taken_over(session: Session) -> None:
    """A long move is acknowledged at once; neither its course nor its end is told."""
    driver = CanDriver(session)
    start = driver.motion.ready(SLOWEST)
    sent_ns = session.transport.now_ns
    exchange = driver.judge.accepted(0x13, start + LONG, requirement="MACC-SDO-13")
    _judge_prompt(driver, sent_ns)
    end = driver.motion.to_position(exchange, start, start + LONG).end
    assert end is not None
    listen_s = LISTEN_S if session.transport.is_virtual else LISTEN_REAL_S
    left_s = (end.latest_ns - session.transport.now_ns) / 1e9
    _judge_silent(driver, left_s + listen_s)
    place = driver.client.position()
    session.expect(place == start + LONG, "MACC-SDO-13", start + LONG, place)
    sent_ns = session.transport.now_ns
    driver.judge.accepted(0x15, velocity(-1, SLOWEST), requirement="MACC-SDO-13")
    _judge_prompt(driver, sent_ns)
    driver.motion.at_rest()
    _judge_silent(driver, listen_s)


@check("MACC-SDO-13", safety=MOVES)
def starts_changes_and_stops_are_answered_when_they_are_taken_over(session: Session) -> None:
    """Whatever begins, changes or ends a motion is acknowledged at once: not when the axis has
    reached its speed, or has come to rest, or when the segment before is over."""
    driver = CanDriver(session)
    driver.limits.needs_room(4 * ramp_increments(1), "a ramp up and one down, and some way more")
    period = driver.limits.gentle(RAMPED, 3.0)
    slower = velocity(1, min(SLOWEST, 2 * period))
    far, segment = 4 * ramp_increments(1), segment_parameter(LONG, SLOWEST)
    for row in (
        ((0x15, velocity(1, period)), (0x15, slower), (0x17, 0)),
        ((0x15, velocity(-1, period)), (0x15, 0)),
        ((0x10, 0), (0x13, far), (0x11, 0), (0x17, 0)),
        ((0x16, segment), (0x1E, segment), (0x16, segment), (0x18, 0)),
        ((0x13, far), (0x1A, 0)),
    ):
        start = driver.motion.ready(period, 1)
        for number, (index, parameter) in enumerate(row):
            parameter += start if index == 0x13 else 0
            taken = driver.judge.accepted(index, parameter, requirement="MACC-SDO-13").taken
            _judge_took(driver, taken.latest_ns - taken.earliest_ns)
            is_climbing = index in (0x11, 0x15) and number + 1 < len(row)
            if is_climbing:
                driver.client.wait(2 * driver.motion.lasting_s(ramp_increments(1)))
        driver.motion.at_rest()


@check("MACC-SDO-06", safety=MOVES)
def what_lasts_is_answered_once(session: Session) -> None:
    """A motion, its start and its stop get one reply each: none comes while they last, nor when
    the axis has come to rest."""
    driver = CanDriver(session)
    period = driver.limits.gentle(QUICK, 2.0)
    for before, index in LASTING:
        start = driver.motion.ready(period, 1)
        if index == 0x14 and abs(start) > driver.limits.room():
            continue
        parameters = {
            0x13: start + LONG,
            0x15: velocity(1, driver.motion.period),
            0x16: segment_parameter(LONG, driver.motion.period),
        }
        for first in before:
            driver.judge.accepted(first, parameters.get(first, 0))
        request = driver.client.request(index, parameters.get(index, 0))
        judge_accepted(driver, request, "MACC-SDO-06")
        way = 2 * ramp_increments(1) + max(LONG, abs(start) if index == 0x14 else 0)
        _judge_silent(driver, driver.motion.lasting_s(way) + LATE_S)
        driver.motion.at_rest()
        _judge_silent(driver, LATE_S)


@check("MACC-SDO-06")
def two_requests_in_a_row_get_two_replies(session: Session) -> None:
    """A request right behind another one is answered as well, both once."""
    driver = CanDriver(session)
    for pair in ((0x22, 0x23), (0x26, 0x25), (0x20, 0x24)):
        frames = [driver.client.request(index).frame() for index in pair]
        received = replies(driver, *frames)
        seen = sorted((frame.identifier, frame.data[1:4]) for frame in received)
        own = codec.REPLY + driver.client.address
        wanted = sorted((own, frame.data[1:4]) for frame in frames)
        text = f"one reply to each of {' and '.join(map(str, frames))}"
        session.expect(seen == wanted, None, text, described(received))


def _judge_silent(driver: CanDriver, seconds: float) -> None:
    extra = driver.client.target.receive(codec.is_reply, seconds)
    driver.session.expect(
        extra is None, "MACC-SDO-06", "silence", "silence" if extra is None else extra.frame
    )


def _judge_prompt(driver: CanDriver, sent_ns: int) -> None:
    _judge_took(driver, driver.session.transport.now_ns - sent_ns)


def _judge_took(driver: CanDriver, took_ns: int) -> None:
    took_s = took_ns / 1e9
    driver.session.expect(
        took_s < ACKNOWLEDGED_WITHIN_S, "MACC-SDO-13", "60h at once", f"{took_s:.3f} s"
    )
