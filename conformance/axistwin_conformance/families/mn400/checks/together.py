"""Several boards on one line: what is said to all or to one of them, and by the others (DROP)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec, words
from axistwin_conformance.families.mn400.client import BoardExchange
from axistwin_conformance.families.mn400.driver import (
    DATA,
    DONE,
    LONGEST_VALUE,
    PRESENT,
    BoardDriver,
)
from axistwin_conformance.families.mn400.persistence.programs import PROFILE, relative_mode
from axistwin_conformance.families.mn400.snapshot import put_back

ORDER = 190  # of this module in a run; see `Family.modules`

SEVERAL: Final = ("neighbour",)
SPEED: Final = 200  # steps/s, below the start speed: no ramps
STEPS: Final = 60
MOVE_S: Final = STEPS / SPEED
SLACK_S: Final = 0.02  # within which boards that hear one K begin
LONG: Final = -2_000_000_000  # a counter that takes as many characters as any
MEASURE_S: Final = 0.1  # what E1 takes
TALKS: Final = 12  # exchanges with one board that the others hear


def everybody(session: Session) -> list[BoardDriver]:
    """The board under test and its neighbours."""
    return [BoardDriver(session, board) for board in (session.address, *session.neighbours)]


@contextmanager
def all_put_back(boards: Sequence[BoardDriver], letters: str) -> Iterator[None]:
    """Put back at the end what commands of these letters set in any board; see `put_back`."""
    with ExitStack() as stack:
        for driver in boards:
            stack.enter_context(put_back(driver.session, letters, driver.board))
        yield


def told_apart(exchange: BoardExchange) -> dict[int, tuple[str, ...]]:
    """What the packets of each board say."""
    ids = dict.fromkeys(packet.board for packet in exchange.found)
    return {
        board: codec.codes_of([packet for packet in exchange.found if packet.board == board])
        for board in ids
    }


# --- who is there ---------------------------------------------------------------------------------


@check("MN4-DROP-02", "MN4-PKT-07", "MN4-CMD-POLL-02", "MN4-DROP-03", "MN4-PHY-04", needs=SEVERAL)
def a_poll_of_all_boards_is_answered_in_turn(session: Session) -> None:
    """START and PRESENT of each board, under its own id, whole, one after another by their ids."""
    boards = everybody(session)
    exchange = boards[0].client.ask_all("*", boards[0].slots_s())
    wanted = {driver.board: PRESENT for driver in boards}
    came = told_apart(exchange)
    names = ("MN4-DROP-02", "MN4-PKT-07", "MN4-PHY-04")
    is_right = came == wanted and exchange.is_sound
    told = "START and PRESENT of each of " + ", ".join(map(str, sorted(wanted)))
    session.expect(is_right, names, told, str(exchange), "to a poll of all boards")
    order = [packet.board for packet in exchange.found]
    in_turn = [board for board in sorted(wanted) for _ in PRESENT]
    session.expect(order == in_turn, "MN4-CMD-POLL-02", in_turn, order)
    _judge_slots(boards[0], exchange)


def _judge_slots(driver: BoardDriver, exchange: BoardExchange) -> None:
    """By how much each board is later than the one before it."""
    due_s = driver.poll_slot_s()
    slack_s = max(SLACK_S / 10, driver.target.uncertainty_ns / 1e9)
    firsts = list(zip(exchange.found, exchange.came_ns, strict=True))[::2]
    for (one, before_ns), (other, after_ns) in itertools.pairwise(firsts):
        slot_s = (after_ns - before_ns) / 1e9 / (other.board - one.board)
        told = f"{due_s * 1e3:.1f} ms for each id from {one.board} to {other.board}"
        is_usual = abs(slot_s - due_s) <= slack_s
        driver.tells(is_usual, "MN4-DROP-03", told, f"{slot_s * 1e3:.1f} ms")


@check("MN4-DROP-10", "MN4-PHY-04", "MN4-PKT-06", needs=SEVERAL)
def boards_take_nothing_from_one_another(session: Session) -> None:
    """What is said to one board, and what it says, moves no other: it is silent, keeps its counters
    and serves at once."""
    boards = everybody(session)
    with all_put_back(boards, "L"):
        for number, driver in enumerate(boards):
            driver.command(f"L{number},1,2,3")
        for number, driver in enumerate(boards):
            for text in ("E", "*", f"L{number},1,2,3", "?", "W") * (TALKS // 4):
                exchange = driver.ask(text)
                ids = {packet.board for packet in exchange.found}
                names = ("MN4-DROP-10", "MN4-PKT-06")
                session.expect(
                    ids <= {driver.board}, names, f"id {driver.board}", exchange.observed
                )
                session.expect(not exchange.strays, names, "packets alone", exchange.observed)
            driver.nothing_more(("MN4-DROP-10", "MN4-PHY-04"), f"the replies of {driver.board}")
        for number, driver in enumerate(boards):
            position = driver.position()
            wanted = (number, 1, 2, 3)
            session.expect(position == wanted, "MN4-DROP-10", wanted, position)


@check("MN4-DROP-10", "MN4-PKT-06", needs=("alone",))
def what_another_board_says_is_none_of_its_business(session: Session) -> None:
    """START, DONE, a value and an error of another id, as they would be heard on a line of two
    wires, draw nothing, and the next request is served."""
    driver = BoardDriver(session)
    other = driver.board % 127 + 1
    for said in (
        (codec.status(other, "E", 3), codec.data(other, "E", "1,2,3,4")),
        (codec.status(other, "V", 3), codec.status(other, "V", 5)),
        (codec.status(other, "*", 3), codec.status(other, "*", 22)),
        (codec.status(other, "W", 12),),
    ):
        driver.target.drain()
        for packet in said:  # each by itself: a sum in the middle may look like a command
            driver.client.send(packet)
        came = driver.client.strays_now()
        told = f"to {words.explain_reply(b''.join(said))}"
        shown = words.explain_reply(came) or "nothing"
        session.expect(not came, ("MN4-DROP-10", "MN4-PKT-06"), "nothing", shown, told)
        driver.draws("*", PRESENT, "MN4-DROP-10")


@check("MN4-DROP-12", needs=("alone",))
def a_board_is_found_by_a_poll_of_all_at_its_rate(session: Session) -> None:
    """A poll of id 0 is answered at the rate of the board."""
    driver = BoardDriver(session)
    exchange = driver.client.ask_all("*", driver.slots_s())
    driver.judge(exchange, PRESENT, "MN4-DROP-12")


# --- what is done by all --------------------------------------------------------------------------


@check("MN4-DROP-04", "MN4-PKT-07", needs=SEVERAL)
def an_order_to_all_boards_is_carried_out_by_each(session: Session) -> None:
    """L to id 0 loads the counters of every board; whether and when they answer is as this line has
    it (MN4-AMB-07), and E to id 0 has every board tell its own, however long they are."""
    boards = everybody(session)
    client, reading = boards[0].client, boards[0].reading("broadcast_reply")
    with all_put_back(boards, "L"):
        exchange = client.ask_all("L11,-12,13,-14", boards[0].slots_s())
        for driver in boards:
            position = driver.position()
            is_right = position == (11, -12, 13, -14)
            session.expect(is_right, "MN4-DROP-04", "11, -12, 13, -14", position)
        _judge_replies(boards, exchange, reading, DONE)
        for number, driver in enumerate(boards):
            driver.command(f"L{LONG + number},{LONG},{LONG},{LONG}")
        exchange = client.ask_all("E", boards[0].slots_s(LONGEST_VALUE))
        _judge_replies(boards, exchange, reading, DATA)
        if reading == "staggered":
            values = [(one.board, one.fields) for one in exchange.found if one.code is None]
            wanted = sorted(
                (driver.board, (LONG + n, LONG, LONG, LONG)) for n, driver in enumerate(boards)
            )
            names = ("MN4-DROP-04", "MN4-PKT-07")
            session.expect(sorted(values) == wanted, names, wanted, values)
        _judge_measurement(boards, exchange, reading)


def _judge_measurement(boards: Sequence[BoardDriver], plain: BoardExchange, reading: str) -> None:
    """E1 to all boards: what each draws is longer than of E, so that no board begins sooner."""
    first, last = boards[0], max(driver.board for driver in boards)
    limit_s = first.slots_s(LONGEST_VALUE) + MEASURE_S * last
    measured = first.client.ask_all("E1", limit_s)
    _judge_replies(boards, measured, reading, DATA)
    if reading == "staggered":
        slack_ns = SLACK_S / 10 * 1e9 + first.target.uncertainty_ns
        before, after = _began_ns(plain), _began_ns(measured)
        early = [board for board in before if after.get(board, 0) < before[board] - slack_ns]
        told = f"no reply before those to E, by board: {before} ns"
        first.session.expect(not early, "MN4-DROP-04", told, f"{after} ns")


def _began_ns(exchange: BoardExchange) -> dict[int, int]:
    """How long after the request the first packet of each board was there."""
    came = zip(exchange.found, exchange.came_ns, strict=True)
    return {packet.board: at_ns - exchange.asked_ns for packet, at_ns in [*came][::-1]}


def _judge_replies(
    boards: Sequence[BoardDriver], exchange: BoardExchange, reading: str, codes: tuple[str, ...]
) -> None:
    """Judge what boards say to an order for all: each in its turn, all at once, or nothing."""
    session, came = boards[0].session, told_apart(exchange)
    in_turn = exchange.is_sound and came == {driver.board: codes for driver in boards}
    seen = "staggered" if in_turn else "poll_only" if exchange.is_silence else "immediate"
    if seen == "immediate" and reading == "staggered":
        told = f"{' and '.join(codes)} of each board in its turn"
        session.expect(False, "MN4-DROP-04", told, str(exchange))
    boards[0].follows("broadcast_reply", seen, "MN4-DROP-04")


@contextmanager
def _held(boards: Sequence[BoardDriver]) -> Iterator[None]:
    """All boards on hold, at counters of 0; afterwards nothing is pending, and they are back."""
    first = boards[0]
    if first.reading("hold_takes_arg") == "false":
        first.session.skip("H of this board has no parameter to turn hold off for certain")
    with all_put_back(boards, "LVFIH"):
        for driver in boards:
            for text in ("L0,0,0,0", PROFILE, f"V{SPEED}", relative_mode(first)):
                driver.command(text)
        try:
            first.client.ask_all("H", first.slots_s())
            yield
        finally:
            for driver in boards:
                driver.ask("K")
            first.target.wait(MOVE_S)
            for driver in boards:
                driver.ask("H0")
                driver.ask(f"M{-_moved(driver)}")
            first.target.wait(MOVE_S)


def _moved(driver: BoardDriver) -> int:
    """How far the first axis is from where it was held."""
    return driver.position()[0]


@check("MN4-DROP-05", "MN4-CMD-K-03", "MN4-DROP-04", "MN4-DROP-07", safety="motion", needs=SEVERAL)
def held_moves_start_together(session: Session) -> None:
    """H to all boards, a move to each, K to all: none moves before K, all begin with it; a board
    with a pending move answers MOVEPENDING, one without serves."""
    boards = everybody(session)
    first = boards[0]
    with _held(boards):
        first.ask(f"M{STEPS}")
        for driver in boards:
            codes = ("START", "MOVEPENDING") if driver is first else DATA
            driver.draws("?", codes, "MN4-DROP-07")
        for driver in boards[1:]:
            driver.ask(f"M{STEPS}")
            driver.draws("?", ("START", "MOVEPENDING"), ("MN4-DROP-04", "MN4-DROP-07"))
        first.target.wait(MOVE_S)
        asked_ns = first.client.send(codec.request(codec.ALL_BOARDS, "K"))
        first.client.listen(first.poll_slot_s() * max(driver.board for driver in boards))
        starts = [_start(driver, asked_ns) for driver in boards]
        latest, earliest = max(low for low, _ in starts), min(high for _, high in starts)
        names = ("MN4-DROP-05", "MN4-CMD-K-03")
        shown = ", ".join(f"{low:.3f} to {high:.3f} s" for low, high in starts)
        is_one = earliest > 0 and latest <= earliest + SLACK_S
        session.expect(is_one, names, "one start", shown, "of each board, after K to all")
        first.target.wait(MOVE_S)
        for driver in boards:
            steps = _moved(driver)
            session.expect(steps == STEPS, names, f"{STEPS} steps", steps)


def _start(driver: BoardDriver, asked_ns: int) -> tuple[float, float]:
    """Between which times (s, from the K) a board must have begun, by what E tells of its move."""
    exchange = driver.ask("E")
    fields = exchange.value.fields if exchange.value else None
    steps = fields[0] if fields else 0
    least_s = (exchange.asked_ns - asked_ns) / 1e9
    most_s = (exchange.done_ns - asked_ns) / 1e9
    if steps == 0:
        return least_s - 1 / SPEED, float("inf")
    low_s = least_s - (steps + 1) / SPEED if steps < STEPS else float("-inf")
    return low_s, most_s - (steps - 1) / SPEED


@check("MN4-DROP-06", "MN4-CMD-K-03", safety="motion", needs=SEVERAL)
def boards_without_a_held_move_say_so(session: Session) -> None:
    """K to all boards: those with nothing pending answer NOMOVEPENDING, the others run."""
    boards = everybody(session)
    first = boards[0]
    with _held(boards):
        first.ask(f"M{STEPS}")
        exchange = first.client.ask_all("K", first.slots_s())
        if first.reading("broadcast_reply") == "staggered":
            came = told_apart(exchange)
            for driver in boards[1:]:
                codes = came.get(driver.board, ())
                is_told = codes == ("START", "NOMOVEPENDING")
                session.expect(is_told, "MN4-DROP-06", "START and NOMOVEPENDING", codes)
        else:
            session.not_run("MN4-DROP-06", "boards of this line do not answer to id 0 in turn")
        first.target.wait(MOVE_S)
        for driver in boards:
            wanted, steps = STEPS if driver is first else 0, _moved(driver)
            session.expect(steps == wanted, "MN4-CMD-K-03", f"{wanted} steps", steps)
