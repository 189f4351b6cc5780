"""Which bytes are a packet to a board, and what its own packets look like (PHY, PKT, RSP).

What is wrong on purpose here is a poll or a read: a board that takes it for right has done nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.client import MEASURES_S, BoardExchange
from axistwin_conformance.families.mn400.driver import (
    DATA,
    DONE,
    LONGEST_VALUE,
    PRESENT,
    BoardDriver,
)
from axistwin_conformance.families.mn400.snapshot import restoring

ORDER = 10  # of this module in a run; see `Family.modules`

LOADED_SUMS: Final = (0x00, 0x03, 0x04, 0x0D, 0x11, 0x13, 0x26, 0x2A, 0x2C, 0x51, 0x7B)
READS: Final = ("E", "N", "S", "/", "?", "[", ":")
PLAIN_ORDERS: Final = ("V2000", "X1", "Q", "|")
# Requests of four bytes, as many as take no more bytes than the longest command has (MN4-PKT-13):
# the whole reply to a poll is ready at once, that to a read when START has left.
IN_A_ROW: Final = ("*", "*", "*", "*", "*", "E", "S", "N", "/", "[") + ("*",) * 4 + ("E", "S", "N")
# What takes its time, or is refused, and a request right behind it.
IN_PAIRS: Final = (("W", "E"), ("X3", "E"), ("K", "*"), ("E1", "S"), ("E2", "*"))
GAP_S: Final = 0.005


@check("MN4-PKT-02", "MN4-PKT-03", "MN4-PKT-07", "MN4-RSP-11", "MN4-RSP-01", "MN4-RSP-02",
       "MN4-PHY-02")  # fmt: skip
@restoring("VX")
def every_reply_is_packets_as_the_manual_draws_them(session: Session) -> None:
    """Replies to reads and orders: own address twice, the command, a right sum, START and DONE in
    six bytes."""
    driver = BoardDriver(session)
    for text in driver.known((*READS, *PLAIN_ORDERS, "*")):
        judge_packets(driver, text, driver.ask(text))


def judge_packets(driver: BoardDriver, text: str, exchange: BoardExchange) -> None:
    """Judge each packet of a reply by its bytes."""
    session, own = driver.session, codec.address_byte(driver.board)
    session.step(bool(exchange.found), f"packets to {text}", exchange.observed)
    session.expect(not exchange.strays, "MN4-PHY-02", "packets alone", exchange.observed)
    for packet in exchange.found:
        first, second = f"{packet.opening:02X}h", f"{packet.closing:02X}h"
        session.expect(packet.opening == own, "MN4-PKT-07", f"{own:02X}h first", first)
        session.expect(packet.closing == packet.opening, "MN4-PKT-02", f"{first} again", second)
        right = codec.checksum(packet.raw[:-1])
        session.expect(
            packet.check == right, "MN4-PKT-03", f"checksum {right:02X}h", f"{packet.check:02X}h"
        )
        session.expect(
            packet.command.upper() == text[:1].upper(), "MN4-RSP-11", text[:1], packet.command
        )
        name = {3: "MN4-RSP-01", 5: "MN4-RSP-02"}.get(packet.code or 0)
        if name is not None:
            size = len(packet.raw)
            session.expect(size == codec.STATUS_BYTES, name, "6 bytes", f"{size} bytes")


@check("MN4-CMD-POLL-01", "MN4-PKT-07")
def a_poll_draws_the_bytes_of_the_manual(session: Session) -> None:
    """START and PRESENT, to the own id and to all boards."""
    driver = BoardDriver(session)
    driver.draws("*", PRESENT, "MN4-CMD-POLL-01")
    if session.neighbours:
        return
    limit_s = driver.poll_slot_s() * driver.board + session.reply_timeout_s
    exchange = driver.client.ask_raw(codec.request(codec.ALL_BOARDS, "*"), limit_s)
    driver.judge(exchange, PRESENT, "MN4-PKT-07")
    ids = {packet.board for packet in exchange.found}
    session.expect(ids == {driver.board}, "MN4-PKT-07", f"id {driver.board}", f"ids {sorted(ids)}")


@check("MN4-PKT-07", "MN4-CMD-RTX-01", needs=("alone",))
@restoring("VX")
def what_all_are_asked_a_board_answers_by_its_own_id(session: Session) -> None:
    """Polls, reads, orders and errors to id 0, and & behind each: what comes has the id of the
    board, as far as it answers (MN4-AMB-07), and & to the board itself repeats it."""
    driver = BoardDriver(session)
    rate = codec.RATES.index(driver.target.baud)
    texts = driver.known(("*", *READS, "E1", *PLAIN_ORDERS, "K", "X3", "W", f"~{rate}"))
    if driver.reading("broadcast_reply") == "poll_only":
        texts = texts[:2]
    everybody = [codec.request(codec.ALL_BOARDS, text) for text in texts]
    again = codec.request(codec.ALL_BOARDS, "&")
    limit_s = driver.slots_s(LONGEST_VALUE) + MEASURES_S[1] * driver.board
    wrong_sum = codec.with_wrong_checksum(codec.request(codec.ALL_BOARDS, "*"))
    own = codec.address_byte(driver.board)
    for asked in (*everybody, wrong_sum):
        for raw in (asked, again):
            exchange = driver.client.ask_raw(raw, limit_s)
            if raw == asked and exchange.is_sound:
                driver.repeats(exchange, "MN4-CMD-RTX-01")
            ids = {one for packet in exchange.found for one in (packet.opening, packet.closing)}
            told = f"{own:02X}h as both addresses of each packet, or nothing"
            session.expect(ids <= {own}, "MN4-PKT-07", told, exchange.observed)


@check("MN4-PKT-05", "MN4-PKT-03")
def every_other_checksum_is_refused(session: Session) -> None:
    """All 127 wrong sums of a poll draw CHKSUMERROR alone, and no poll is answered."""
    driver = BoardDriver(session)
    sound = driver.client.request("*")
    codes = driver.errors("CHKSUMERROR", is_recognised=False)
    for offset in range(1, 128):
        exchange = driver.client.ask_raw(codec.with_wrong_checksum(sound, offset))
        driver.judge(exchange, codes, ("MN4-PKT-05", "MN4-PKT-03"))
    driver.draws("*", PRESENT, "MN4-PKT-03")


@check("MN4-PKT-05", "MN4-ERR-02")
@restoring("L")
def an_order_with_a_wrong_checksum_has_no_effect(session: Session) -> None:
    """L under a wrong sum leaves the counters as they are."""
    driver = BoardDriver(session)
    driver.command("L1,2,3,4")
    driver.ignores("L9,9,9,9")
    position = driver.position()
    session.expect(position == (1, 2, 3, 4), "MN4-PKT-05", "1, 2, 3, 4", position)
    driver.draws("L9,9,9,9x", driver.errors("PARA_ERROR"), "MN4-ERR-02")
    position = driver.position()
    session.expect(position == (1, 2, 3, 4), "MN4-ERR-02", "1, 2, 3, 4", position)


@check("MN4-PKT-05", needs=("alone",))
@restoring("L")
def an_order_to_all_with_a_wrong_checksum_has_no_effect(session: Session) -> None:
    """L to id 0 under a wrong sum leaves the counters as they are."""
    driver = BoardDriver(session)
    driver.command("L1,2,3,4")
    driver.client.send(codec.with_wrong_checksum(codec.request(codec.ALL_BOARDS, "L9,9,9,9")))
    driver.client.forget_frame()
    position = driver.position()
    session.expect(position == (1, 2, 3, 4), "MN4-PKT-05", "1, 2, 3, 4", position)


@check("MN4-PKT-04", "MN4-PHY-03")
@restoring("L")
def a_checksum_may_look_like_anything(session: Session) -> None:
    """L requests whose sums are codes, commands, XON and XOFF are served."""
    driver = BoardDriver(session)
    for wanted in LOADED_SUMS:
        text = codec.with_checksum(driver.board, wanted)
        names = ("MN4-PKT-04", "MN4-PHY-03") if wanted in (0x11, 0x13) else ("MN4-PKT-04",)
        driver.draws(text, DONE, names)


@check("MN4-PKT-06", "MN4-PKT-02", "MN4-DROP-01", needs=("alone",))
def other_ids_are_not_answered(session: Session) -> None:
    """A poll, a good one and one with a wrong sum, to every other id draws nothing."""
    driver = BoardDriver(session)
    others = [board for board in codec.IDS if board != driver.board]
    chosen = others if session.target.is_virtual else session.random.sample(others, 8)
    for board in chosen:
        raw = codec.request(board, "*")
        for data in (raw, codec.with_wrong_checksum(raw)):
            driver.judge(driver.client.ask_raw(data), (), ("MN4-PKT-06", "MN4-DROP-01"))
    raw = codec.request(driver.board, "*", closing=codec.address_byte(others[0]))
    driver.client.send(raw)
    came = driver.client.forget_frame()
    timed_out = codec.codes_of(codec.packets(came)[0])
    session.expect("PRESENT" not in timed_out, "MN4-PKT-02", "no PRESENT", came.hex(" ").upper())


@check("MN4-PKT-08", needs=("alone",))
def packets_in_a_row_are_answered_one_by_one(session: Session) -> None:
    """Requests without a pause between them, as many bytes as the longest command has, draw the
    packets of each in their order, also with pauses amid a request, where the board has them; so
    does a request behind one that is refused, and behind a measurement.  Nobody can tell from here
    whether the line has two wires (RS-485), where requests and replies collide: then the first
    reply is lost."""
    driver = BoardDriver(session)
    for texts in (IN_A_ROW, *IN_PAIRS):
        # Each by itself: a sum in the middle may look like a command.
        _judge_row(driver, texts, [driver.client.request(text) for text in texts])
    poll = driver.client.request("*")
    driver.client.send(poll[:2])
    driver.target.wait(GAP_S)
    alone = driver.client.ask_raw(poll[2:], driver.client.limit_s("*"))
    if alone.says(*PRESENT):  # else: MN4-PKT-09
        _judge_row(driver, "**", [poll[:2], poll[2:] + poll[:2], poll[2:]], GAP_S)


def _judge_row(
    driver: BoardDriver, texts: Sequence[str], pieces: Sequence[bytes], gap_s: float = 0
) -> None:
    """Judge the packets that requests draw whose bytes are sent in these pieces."""
    session = driver.session
    driver.target.drain()
    for piece in pieces:
        driver.client.send(piece)
        driver.target.wait(gap_s)
    wanted = [(text[0], code) for text in texts for code in _codes(driver, text)]
    limit_s = max(driver.client.limit_s(text) for text in texts)
    found, strays = list[codec.BoardPacket](), b""
    while len(found) < len(wanted):
        packet, before = driver.client.receive_packet(limit_s)
        strays += before
        if packet is None:
            break
        found.append(packet)
    came = [*zip((packet.command for packet in found), codec.codes_of(found), strict=True)]
    if texts is IN_A_ROW and came[:2] != wanted[:2]:
        driver.client.forget_frame()
        session.skip("not even the first reply came whole: the line seems to have two wires")
    is_right = came == wanted and not strays
    told = f"in answer to {len(texts)} requests in a row: {_row_in_words(wanted)}"
    session.expect(
        is_right, "MN4-PKT-08", told, _row_in_words(came) or strays.hex(" ") or "nothing"
    )


def _codes(driver: BoardDriver, text: str) -> tuple[str, ...]:
    """What a poll, a read or a refusal draws."""
    refused = {
        "W": driver.errors("INVALIDCOMMAND", is_recognised=False),
        "X3": driver.errors("PARA_ERROR"), "K": ("START", "NOMOVEPENDING"), "*": PRESENT,
    }  # fmt: skip
    return refused.get(text, DATA)


def _row_in_words(row: Sequence[tuple[str, str]]) -> str:
    """Commands and codes of packets, in their order."""
    return ", ".join(f"{command} {code}" for command, code in row)


@check("MN4-PKT-09")
def a_gap_within_a_frame_does_not_break_it(session: Session) -> None:
    """A poll in single bytes, 5 ms apart."""
    driver = BoardDriver(session)
    raw = driver.client.request("*")
    driver.target.drain()
    for index in range(len(raw) - 1):
        driver.client.send(raw[index : index + 1])
        driver.target.wait(GAP_S)
    exchange = driver.client.ask_raw(raw[-1:], driver.client.limit_s("*"))
    driver.tells(exchange.says(*PRESENT), "MN4-PKT-09", "START and PRESENT", exchange)


@check("MN4-PKT-10", "MN4-PKT-11", "MN4-PKT-15", "MN4-CMD-RTX-01")
def a_board_finds_the_next_frame(session: Session) -> None:
    """Behind junk, in another frame, behind a doubled address, behind a frame cut off, whose
    TIMEOUT comes again where there is one (MN4-AMB-51)."""
    driver = BoardDriver(session)
    own, other = codec.address_byte(driver.board), codec.address_byte(driver.board % 127 + 1)
    poll = driver.client.request("*")
    for name, begun in (
        ("MN4-PKT-10", b"\x0d\x0aAT\x7f"),
        ("MN4-PKT-11", bytes([other]) + b"E1"),
        ("MN4-PKT-15", bytes([own])),
    ):
        exchange = driver.client.ask_raw(begun + poll, driver.client.limit_s("*"))
        driver.tells(exchange.says(*PRESENT), name, "a poll's reply", exchange)
    driver.client.send(poll[:2])
    found, strays = codec.packets(driver.client.forget_frame())
    timed_out = BoardExchange(poll[:2], found, strays)
    if timed_out.is_sound and timed_out.codes[-1:] == ("TIMEOUT",):  # no late reply of before
        driver.repeats(timed_out, "MN4-CMD-RTX-01")
    exchange = driver.ask("*")
    driver.tells(exchange.says(*PRESENT), "MN4-PKT-15", "a poll's reply", exchange)


@check("MN4-RSP-03", "MN4-RSP-04", "MN4-RSP-14", "MN4-PHY-04")
@restoring("VX")
def a_command_draws_its_two_packets_and_nothing_more(session: Session) -> None:
    """START and DONE of an order, START and the value of a read; a quiet line behind them."""
    driver = BoardDriver(session)
    for text in driver.known((*READS, *PLAIN_ORDERS)):
        is_read = text in READS
        name = "MN4-RSP-04" if is_read else "MN4-RSP-03"
        driver.draws(text, DATA if is_read else DONE, name)
        driver.nothing_more((name, "MN4-RSP-14", "MN4-PHY-04"), f"the reply to {text}")
