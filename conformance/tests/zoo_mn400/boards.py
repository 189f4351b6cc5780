"""Faults of ids, rates and several boards on one line (CMD-ADDR, CMD-BAUD, CMD-POLL, DROP)."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mn400.commands import Interpreter
from axistwin.devices.mn400.device import _VALUE_BYTES, Mn400Board
from axistwin.devices.mn400.link.packets import ReturnCode
from axistwin.devices.mn400.link.ports import Answer
from axistwin.devices.mn400.link.receiver import PacketReceiver, Request
from axistwin.devices.mn400.link.sender import Reply, ReplyPart
from zoo_mn400.planting import Any_, MonkeyPatch, around, board_mutant, commands, repeats

# --- ids ------------------------------------------------------------------------------------------


def _replies(patch: MonkeyPatch, name: str, change: Any_) -> None:
    """Let `change(answer, interpreter, before)` be the answer; `before`: the id until then."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Answer:
        before = one._port.address
        found: Answer = change(go(), one, before)
        return found

    around(patch, Interpreter, name, act)


def _from(part: ReplyPart, address: int) -> ReplyPart:
    assert isinstance(part.message, Reply)
    return part._replace(message=part.message._replace(address=address))


@board_mutant("MN4-CMD-ADDR-01", "MN4-DROP-11", traps=(10,))
def done_comes_from_the_old_id(patch: MonkeyPatch) -> None:
    """Both packets of = have the id before it."""

    def change(answer: Answer, one: Interpreter, before: int) -> Answer:
        return answer._replace(parts=[_from(part, before) for part in answer.parts])

    _replies(patch, "_set_address", change)


@board_mutant("MN4-CMD-ADDR-01", "MN4-DROP-11", traps=(10,))
def start_comes_from_the_new_id(patch: MonkeyPatch) -> None:
    """Both packets of = have the id after it."""

    def change(answer: Answer, one: Interpreter, before: int) -> Answer:
        return answer._replace(parts=[_from(part, one._port.address) for part in answer.parts])

    _replies(patch, "_set_address", change)


@board_mutant("MN4-CMD-RTX-04", traps=(45,))
def a_repeat_has_the_id_of_before(patch: MonkeyPatch) -> None:
    """& repeats under the id of power-on."""
    repeats(patch, lambda readout, last, now: last._replace(address=1))


@board_mutant("MN4-CMD-ADDR-04")
def the_old_id_still_works(patch: MonkeyPatch) -> None:
    """Id 1 is answered whatever = has set."""

    def act(go: Any_, receiver: PacketReceiver, opening: int) -> bool:
        return bool(go()) or (opening == 0x81 and receiver._address() not in (1, 2))

    around(patch, PacketReceiver, "_concerns", act)


@board_mutant("MN4-CMD-ADDR-04", "MN4-DROP-01", "MN4-PKT-07")
def nobody_is_everybody(patch: MonkeyPatch) -> None:
    """Id 0 is answered by no board."""

    def act(go: Any_, receiver: PacketReceiver, opening: int) -> bool:
        return opening != 0x80 and bool(go())

    around(patch, PacketReceiver, "_concerns", act)


@board_mutant("MN4-DROP-12")
def a_lone_board_is_not_asked_by_id_0(patch: MonkeyPatch) -> None:
    """Polls of id 0 are for others."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        if not (request.is_for_all and request.payload[:1] == b"*"):
            go()

    around(patch, Mn400Board, "_serve", act)


# --- rates ----------------------------------------------------------------------------------------


@board_mutant("MN4-CMD-BAUD-01", "MN4-DROP-11", traps=(11,))
def the_new_rate_is_told_at_the_old_one(patch: MonkeyPatch) -> None:
    """BAUDCHANGEOK leaves before the rate changes."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Answer:
        answer: Answer = go()
        start, change = answer.parts[:2]
        told = ReplyPart(Reply(one._port.address, line.command, ReturnCode.BAUDCHANGEOK))

        def then(now: int) -> None:
            assert callable(change.message)
            change.message(now)

        return answer._replace(parts=[start, told, ReplyPart(then)])

    around(patch, Interpreter, "_set_rate", act)


@board_mutant("MN4-CMD-BAUD-01", "MN4-DROP-11", traps=(11,))
def the_rate_changes_before_start(patch: MonkeyPatch) -> None:
    """START is at the new rate, too."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Answer:
        answer: Answer = go()
        start, change = answer.parts[:2]

        def first(now: int) -> Any:
            assert callable(change.message)
            change.message(now)
            return start.message

        last = Reply(one._port.address, line.command, ReturnCode.BAUDCHANGEOK)
        return answer._replace(parts=[ReplyPart(first), ReplyPart(last)])

    around(patch, Interpreter, "_set_rate", act)


@board_mutant("MN4-CMD-BAUD-01", "MN4-PHY-01")
def the_rates_are_in_another_order(patch: MonkeyPatch) -> None:
    """~1 is 115200 baud, ~4 is 19200."""

    def act(go: Any_, board: Mn400Board, number: int) -> None:
        go({1: 4, 4: 1}.get(number, number))

    around(patch, Mn400Board, "set_rate", act)


@board_mutant("MN4-CMD-BAUD-01", "MN4-PHY-01")
def the_highest_rate_is_76800(patch: MonkeyPatch) -> None:
    """~4 is off by a third."""
    from axistwin.devices.mn400 import device
    from axistwin.wire.framing import LineFormat

    patch.setattr(device, "_FORMATS", (*device._FORMATS[:4], LineFormat(76800)))


def _concerns(patch: MonkeyPatch, act: Any_) -> None:
    """Let `act(go, receiver, opening)` tell whether a packet is for the board, by what is in it."""
    around(patch, PacketReceiver, "_concerns", act)
    patch.setattr(PacketReceiver, "quiet_prefix", lambda receiver, data: 0)


# --- several boards -------------------------------------------------------------------------------


@board_mutant("MN4-DROP-02", "MN4-PHY-04")
def all_boards_answer_a_poll_at_once(patch: MonkeyPatch) -> None:
    """No slots: they collide."""
    around(patch, Mn400Board, "_slot_ns", lambda go, board, letter, payload: 0)


@board_mutant("MN4-CMD-POLL-02")
def high_ids_answer_first(patch: MonkeyPatch) -> None:
    """A board waits as long as there are ids above it, up to 5."""

    def act(go: Any_, board: Mn400Board, letter: str, payload: bytes) -> int:
        slot = int(go())
        return slot * (6 - board.address) // (board.address - 1) if board.address > 1 else slot

    around(patch, Mn400Board, "_slot_ns", act)

    def serve(go: Any_, board: Mn400Board, request: Request) -> None:
        before = board._delay_ns
        if board.address == 1 and request.is_for_all:
            board._delay_ns += 5 * board._slot_ns("*", b"*")
        go()
        board._delay_ns = before

    around(patch, Mn400Board, "_serve", serve)


@board_mutant("MN4-DROP-02")
def only_board_1_answers_polls_of_all(patch: MonkeyPatch) -> None:
    """The others keep silent."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        is_poll = request.is_for_all and request.payload[:1] == b"*"
        if not is_poll or board.address == 1:
            go()

    around(patch, Mn400Board, "_serve", act)


def _for_all(patch: MonkeyPatch, change: Any_) -> None:
    """Let `change(part)` be each part of an answer to all boards but to a poll."""

    def act(go: Any_, one: Interpreter, *line: Any) -> Answer | None:
        answer: Answer | None = go()
        _, payload, _, is_for_all = (*line, False)[:4]
        if answer is None or not is_for_all or payload[:1] == b"*":
            return answer
        return answer._replace(parts=[change(part) for part in answer.parts])

    around(patch, Interpreter, "obey", act)


def _by_everybody(part: ReplyPart) -> ReplyPart:
    """The part with id 0 as the address of what it sends."""
    message = part.message
    if isinstance(message, Reply):
        return _from(part, 0)

    def made(now: int) -> Reply | None:
        found = message(now)
        return found and found._replace(address=0)

    return part._replace(message=made)


@board_mutant("MN4-PKT-07", traps=(9,))
def what_all_are_asked_is_answered_by_everybody(patch: MonkeyPatch) -> None:
    """All but a poll that id 0 is asked draws packets of id 0."""
    _for_all(patch, _by_everybody)


@board_mutant("MN4-PKT-07", traps=(9,))
def a_value_that_all_are_asked_for_is_told_by_everybody(patch: MonkeyPatch) -> None:
    """START of a read has the own id, the value id 0."""

    def change(part: ReplyPart) -> ReplyPart:
        return part if isinstance(part.message, Reply) else _by_everybody(part)

    _for_all(patch, change)


@board_mutant("MN4-DROP-04")
def orders_to_all_boards_are_answered_and_not_done(patch: MonkeyPatch) -> None:
    """L to id 0 draws START and DONE."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        return None if line.is_for_all else go()

    commands(patch, "L", act)


@board_mutant("MN4-DROP-04")
def slots_are_too_short_for_long_values(patch: MonkeyPatch) -> None:
    """Counters of more than four digits are told to id 0 while the next board begins."""
    patch.setitem(_VALUE_BYTES, "E", 20)


@board_mutant("MN4-CMD-K-03", "MN4-DROP-05")
def a_release_of_all_is_that_of_the_first(patch: MonkeyPatch) -> None:
    """K to id 0 is obeyed by board 1 alone."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        return None if line.is_for_all and one._port.address > 1 else go()

    commands(patch, "K", act)


@board_mutant("MN4-DROP-05", "MN4-CMD-K-03")
def boards_begin_when_it_is_their_turn_to_answer(patch: MonkeyPatch) -> None:
    """K to id 0 releases each board 100 ms later than the one before it."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        late_ns = (one._port.address - 1) * 100_000_000 if line.is_for_all else 0
        pending = one.pending
        if not late_ns or pending is None:
            return go()

        def later(released: Any) -> None:
            pending(released._replace(now=released.now + late_ns))

        one.pending = later
        return go()

    around(patch, Interpreter, "_release", act)


@board_mutant("MN4-DROP-06", "MN4-ERR-04", traps=(33,))
def a_release_is_always_done(patch: MonkeyPatch) -> None:
    """K with nothing pending draws START and DONE."""

    def act(go: Any_, one: Interpreter, line: Any, code: ReturnCode) -> Answer:
        is_none = code is ReturnCode.NOMOVEPENDING
        answer: Answer = go(line, ReturnCode.DONE if is_none else code)
        return answer

    around(patch, Interpreter, "_started", act)


@board_mutant("MN4-DROP-07", "MN4-RSP-09", traps=(32,))
def reads_are_served_while_a_move_is_pending(patch: MonkeyPatch) -> None:
    """? is answered as ever."""
    from zoo_mn400.planting import BoardState, Treatment, cells

    cells(patch, "?ENS/[:", [BoardState.HPD], Treatment.VALUE)


@board_mutant("MN4-DROP-08")
def an_id_is_taken_by_all(patch: MonkeyPatch) -> None:
    """= is obeyed by whoever hears it."""

    def act(go: Any_, receiver: PacketReceiver, opening: int) -> bool:
        return bool(go()) or receiver._frame.payload[:1] == b"="

    _concerns(patch, act)


@board_mutant("MN4-DROP-09")
def a_rate_is_taken_by_all(patch: MonkeyPatch) -> None:
    """~ is obeyed by whoever hears it."""

    def act(go: Any_, receiver: PacketReceiver, opening: int) -> bool:
        return bool(go()) or receiver._frame.payload[:1] == b"~"

    _concerns(patch, act)


@board_mutant("MN4-DROP-10", "MN4-PKT-06", traps=(13,))
def replies_of_others_are_taken_for_requests(patch: MonkeyPatch) -> None:
    """A packet with a return code is answered whatever its id is."""

    def act(go: Any_, receiver: PacketReceiver, opening: int) -> bool:
        payload = receiver._frame.payload
        is_reply = len(payload) > 1 and payload[1] == 5
        return bool(go()) or (is_reply and opening != 0x80)

    _concerns(patch, act)
    from axistwin.devices.mn400.link import packets

    patch.setattr(packets, "is_reply", lambda payload: False)


@board_mutant("MN4-DROP-04")
def a_measurement_for_all_boards_has_the_slot_of_a_status(patch: MonkeyPatch) -> None:
    """Of E1 to id 0 each board answers as soon as of a setting."""

    def act(go: Any_, board: Mn400Board, letter: str, payload: bytes) -> Any:
        return go("" if payload[1:] else letter, payload)

    around(patch, Mn400Board, "_slot_ns", act)
