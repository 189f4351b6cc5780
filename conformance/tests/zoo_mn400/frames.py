"""Faults of packets and replies: what is taken for a packet, and what is sent (PHY, PKT, RSP)."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mn400.commands import Interpreter
from axistwin.devices.mn400.device import Mn400Board
from axistwin.devices.mn400.link.packets import ADDRESS_BIT, ReturnCode
from axistwin.devices.mn400.link.ports import Answer
from axistwin.devices.mn400.link.receiver import Flaw, PacketReceiver, Request, _Frame
from axistwin.devices.mn400.link.sender import Reply, ReplySender
from axistwin.devices.mn400.readout import ReadOut
from zoo_mn400.planting import (
    MS,
    Any_,
    MonkeyPatch,
    all_packets,
    around,
    board_mutant,
    data_packets,
    judges,
    repeats,
    resummed,
    status_packets,
)

# --- what is taken for a packet -------------------------------------------------------------------


def _byte_by_byte(patch: MonkeyPatch) -> None:
    """Let no packet be taken at once, so that the faults of its bytes show."""
    patch.setattr(PacketReceiver, "_whole", lambda receiver, data: None)


def _sums(patch: MonkeyPatch, is_right: Any_) -> None:
    """Let `is_right(frame, given)` accept sums beside the right one."""

    def act(go: Any_, receiver: PacketReceiver, now: int, given: int) -> Request:
        request: Request = go()
        is_taken = request.flaw is Flaw.CHECKSUM and is_right(receiver._frame, given)
        return request._replace(flaw=Flaw.NONE) if is_taken else request

    _byte_by_byte(patch)
    around(patch, PacketReceiver, "_complete", act)


@board_mutant("MN4-PKT-05", traps=(14,))
def no_sum_is_looked_at(patch: MonkeyPatch) -> None:
    """A packet is obeyed whatever its checksum is."""
    _sums(patch, lambda frame, given: True)


@board_mutant("MN4-PKT-05")
def no_sum_to_all_is_looked_at(patch: MonkeyPatch) -> None:
    """A packet for all boards is obeyed whatever its checksum is."""
    _sums(patch, lambda frame, given: frame.opening == ADDRESS_BIT)


@board_mutant("MN4-PKT-05")
def a_sum_may_leave_the_second_address_out(patch: MonkeyPatch) -> None:
    """A checksum without the closing address is right as well."""
    _sums(patch, lambda frame, given: (frame.total - frame.opening) & 0x7F == given)


@board_mutant("MN4-PKT-05")
def a_sum_may_be_one_more(patch: MonkeyPatch) -> None:
    """A checksum that is one too high is right as well."""
    _sums(patch, lambda frame, given: (frame.total + 1) & 0x7F == given)


@board_mutant("MN4-PKT-05", traps=(14,))
def what_has_a_wrong_sum_is_refused_and_done(patch: MonkeyPatch) -> None:
    """CHKSUMERROR is sent, but L has loaded the counters by then."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        if request.flaw is Flaw.CHECKSUM and request.payload[:1] in b"Ll":
            from axistwin.devices.mn400.link.ports import Origin

            board.interpreter.obey(request.time_ns, request.payload, Origin.SERIAL)
        go()

    around(patch, Mn400Board, "_serve", act)


@board_mutant("MN4-PKT-05", traps=(14,))
def no_sum_of_quit_is_looked_at(patch: MonkeyPatch) -> None:
    """Q is obeyed whatever its checksum is."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        is_taken = request.flaw is Flaw.CHECKSUM and request.payload == b"Q"
        go(request._replace(flaw=Flaw.NONE) if is_taken else request)

    around(patch, Mn400Board, "_serve", act)


@board_mutant("MN4-PKT-05")
def what_has_a_wrong_sum_ends_hold(patch: MonkeyPatch) -> None:
    """CHKSUMERROR is sent, and hold is off unless a move is pending."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        go()
        if request.flaw is Flaw.CHECKSUM and board.interpreter.pending is None:
            board.interpreter.is_holding = False

    around(patch, Mn400Board, "_serve", act)


def _ends_at(patch: MonkeyPatch, is_end: Any_) -> None:
    def act(go: Any_, frame: _Frame, byte: int) -> int | None:
        if frame.is_closed and is_end(byte):
            frame.open(0)
            return None
        found: int | None = go()
        return found

    _byte_by_byte(patch)
    around(patch, _Frame, "take", act)


@board_mutant("MN4-PKT-04", "MN4-PHY-03", traps=(5, 6))
def flow_control_takes_sums_away(patch: MonkeyPatch) -> None:
    """11h and 13h are XON and XOFF wherever they stand: the packet is lost."""
    _ends_at(patch, lambda byte: byte in (0x11, 0x13))


@board_mutant("MN4-PKT-04", traps=(5,))
def a_sum_of_zero_is_a_null(patch: MonkeyPatch) -> None:
    """A checksum 00 is thrown away like padding."""
    _ends_at(patch, lambda byte: byte == 0)


@board_mutant("MN4-PKT-04", traps=(5,))
def a_sum_of_04h_is_ctrl_d(patch: MonkeyPatch) -> None:
    """A checksum 04 is taken for Ctrl-D, and the packet is lost."""
    _ends_at(patch, lambda byte: byte == 4)


@board_mutant("MN4-PKT-06", "MN4-DROP-01", traps=(13,))
def every_id_is_its_own(patch: MonkeyPatch) -> None:
    """A board answers to the ids above its own as well."""

    def act(go: Any_, receiver: PacketReceiver, opening: int) -> bool:
        return bool(go()) or (opening & 0x7F) > 100

    around(patch, PacketReceiver, "_concerns", act)


@board_mutant("MN4-PKT-02")
def the_second_address_may_be_any(patch: MonkeyPatch) -> None:
    """Any byte with bit 7 closes a packet."""

    def act(go: Any_, frame: _Frame, byte: int) -> int | None:
        is_other = byte >= 0x80 and frame.payload and not frame.is_closed
        if is_other and frame.opening and byte != frame.opening and frame.opening == 0x81:
            frame.is_closed = True
            frame.total += byte
            return None
        found: int | None = go()
        return found

    around(patch, _Frame, "take", act)


@board_mutant("MN4-PKT-13")
def the_buffer_holds_64_characters(patch: MonkeyPatch) -> None:
    """The longest commands are too long for it."""

    def act(go: Any_, receiver: PacketReceiver, *given: Any) -> None:
        go()
        receiver._payload_max = 64

    around(patch, PacketReceiver, "__init__", act)


@board_mutant("MN4-PKT-05")
def what_is_too_long_is_cut_and_obeyed(patch: MonkeyPatch) -> None:
    """Of a packet that is too long the first 80 characters are obeyed, whatever its sum is."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        is_cut = request.flaw is Flaw.TOO_LONG
        go(request._replace(flaw=Flaw.NONE) if is_cut else request)

    around(patch, Mn400Board, "_serve", act)


@board_mutant("MN4-ERR-05")
def a_packet_that_is_too_long_is_not_forgotten(patch: MonkeyPatch) -> None:
    """The second packet behind one that is too long is called too long as well, unless it is
    short."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        behind = getattr(board, "behind", 2) + 1
        board.behind = 0 if request.flaw is Flaw.TOO_LONG else behind  # type: ignore[attr-defined]
        is_called_so = behind == 2 and len(request.payload) > 8
        go(request._replace(flaw=Flaw.TOO_LONG) if is_called_so else request)

    around(patch, Mn400Board, "_serve", act)


# --- what is sent ---------------------------------------------------------------------------------


@board_mutant("MN4-PKT-03", traps=(8,))
def sums_have_eight_bits(patch: MonkeyPatch) -> None:
    """A sum keeps its bit 6 flipped: 127 is the highest address, so it says, and adds 64."""
    all_packets(patch, lambda raw: raw[:-1] + bytes([raw[-1] ^ 0x40]))


@board_mutant("MN4-PKT-03")
def sums_of_values_leave_the_trailer_out(patch: MonkeyPatch) -> None:
    """The checksum of a data packet is made before its trailer is added."""
    data_packets(patch, lambda raw: raw[:-1] + bytes([sum(raw[:-3]) + raw[-2] & 0x7F]))


@board_mutant("MN4-PKT-07", traps=(9,))
def done_comes_from_everybody(patch: MonkeyPatch) -> None:
    """DONE has 80h for its address."""

    def change(raw: bytes) -> bytes:
        return resummed(b"\x80" + raw[1:-2] + b"\x80") if raw[2] == 5 else raw

    status_packets(patch, change)


@board_mutant("MN4-PKT-02")
def the_closing_address_of_a_reply_is_the_host(patch: MonkeyPatch) -> None:
    """The second address of a reply is 80h."""
    status_packets(patch, lambda raw: resummed(raw[:-2] + b"\x80"))


@board_mutant("MN4-RSP-01", traps=(7,))
def start_has_no_null(patch: MonkeyPatch) -> None:
    """START has five bytes."""
    status_packets(patch, lambda raw: resummed(raw[:3] + raw[4:5]) if raw[2] == 3 else raw)


@board_mutant("MN4-RSP-02", traps=(7,))
def done_has_no_null(patch: MonkeyPatch) -> None:
    """DONE has five bytes."""
    status_packets(patch, lambda raw: resummed(raw[:3] + raw[4:5]) if raw[2] == 5 else raw)


@board_mutant("MN4-RSP-11")
def start_echoes_an_asterisk(patch: MonkeyPatch) -> None:
    """START has the command byte of a poll, whatever was asked."""
    status_packets(patch, lambda raw: resummed(raw[:1] + b"*" + raw[2:-1]) if raw[2] == 3 else raw)


@board_mutant("MN4-RSP-12")
def only_the_position_has_a_trailer(patch: MonkeyPatch) -> None:
    """Values other than E's end without one."""
    data_packets(patch, lambda raw: raw if raw[1:2] == b"E" else resummed(raw[:-3] + raw[-2:-1]))


@board_mutant("MN4-RSP-12")
def a_long_value_has_no_trailer(patch: MonkeyPatch) -> None:
    """A value of more than 24 characters ends without one."""
    data_packets(patch, lambda raw: resummed(raw[:-3] + raw[-2:-1]) if len(raw) > 24 + 5 else raw)


@board_mutant("MN4-RSP-11")
def a_refusal_echoes_the_letter_as_sent(patch: MonkeyPatch) -> None:
    """PARA_ERROR to x3 has a small x, START before it a large one."""

    def act(
        go: Any_, one: Interpreter, command: int, code: ReturnCode, payload: bytes, **how: Any
    ) -> Answer:
        answer: Answer = go()
        if code is not ReturnCode.PARA_ERROR:
            return answer
        return answer._replace(parts=[*answer.parts[:-1], one._status(payload[0], code)])

    around(patch, Interpreter, "refusal", act)


@board_mutant("MN4-RSP-10")
def positive_numbers_have_a_sign(patch: MonkeyPatch) -> None:
    """E tells +5."""
    data_packets(
        patch,
        lambda raw: resummed(raw[:2] + b"+" + raw[2:-1]) if raw[1:2] == b"E" else raw,
    )


@board_mutant("MN4-RSP-10")
def numbers_are_separated_by_spaces(patch: MonkeyPatch) -> None:
    """E tells 0 0 0 0."""
    data_packets(patch, lambda raw: resummed(raw[:-1].replace(b",", b" ")))


@board_mutant("MN4-RSP-13")
def one_error_has_no_null(patch: MonkeyPatch) -> None:
    """INVALIDCOMMAND has five bytes, PARA_ERROR six."""

    def change(raw: bytes) -> bytes:
        return resummed(raw[:3] + raw[4:5]) if raw[2] == 0x0C else raw

    status_packets(patch, change)


def _answers(patch: MonkeyPatch, change: Any_) -> None:
    """Let `change(answer, letter)` be the answer to a line."""
    judges(patch, lambda go, one, line, letter: change(go(), letter))


@board_mutant("MN4-RSP-03")
def orders_are_done_twice(patch: MonkeyPatch) -> None:
    """V and X draw a second DONE."""

    def change(answer: Answer, letter: str) -> Answer:
        return (
            answer._replace(parts=[*answer.parts, answer.parts[-1]]) if letter in "VX" else answer
        )

    _answers(patch, change)


@board_mutant("MN4-RSP-03")
def orders_have_no_start(patch: MonkeyPatch) -> None:
    """V and X draw DONE alone."""

    def change(answer: Answer, letter: str) -> Answer:
        return answer._replace(parts=answer.parts[1:]) if letter in "VX" else answer

    _answers(patch, change)


@board_mutant("MN4-RSP-04", traps=(3,))
def a_value_is_followed_by_done(patch: MonkeyPatch) -> None:
    """S and / draw START, the value and DONE."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Answer:
        answer: Answer = go()
        if letter not in "S/":
            return answer
        return answer._replace(parts=[*answer.parts, one._status(line.command, ReturnCode.DONE)])

    judges(patch, act)


@board_mutant("MN4-RSP-08", traps=(3,))
def a_repeat_begins_with_start(patch: MonkeyPatch) -> None:
    """& draws START and the last message."""

    def act(go: Any_, one: Interpreter, line: Any) -> Answer:
        answer: Answer = go()
        start = one._status(line.command, ReturnCode.START)
        return answer._replace(parts=[start, *answer.parts])

    around(patch, Interpreter, "_repeat", act)


@board_mutant("MN4-CMD-RTX-01", traps=(4,))
def a_repeat_keeps_the_sum(patch: MonkeyPatch) -> None:
    """& changes the command byte and sends the checksum of before: off by the difference."""

    def change(raw: bytes) -> bytes:
        if raw[1:2] != b"&":
            return raw
        return raw[:-1] + bytes([raw[-1] + 7 & 0x7F])

    all_packets(patch, change)


@board_mutant("MN4-CMD-RTX-02")
def a_repeat_has_another_code(patch: MonkeyPatch) -> None:
    """What & repeats after an order is NOMOVEPENDING."""

    def change(readout: ReadOut, last: Reply, now: int) -> Reply:
        is_done = last.code == ReturnCode.DONE
        return last._replace(code=ReturnCode.NOMOVEPENDING) if is_done else last

    repeats(patch, change)


def _keeps_of_replies(patch: MonkeyPatch, is_kept: Any_) -> None:
    """Let & repeat the last message for which `is_kept(message)` holds."""

    def act(go: Any_, sender: ReplySender, now: int) -> None:
        before = sender.last
        go()
        if sender.last is not None and not is_kept(sender.last):
            sender.last = before

    around(patch, ReplySender, "run", act)


@board_mutant("MN4-CMD-RTX-01")
def errors_are_not_repeated(patch: MonkeyPatch) -> None:
    """Behind an error & repeats the value or DONE of before."""
    told = (ReturnCode.DONE, ReturnCode.PRESENT, ReturnCode.BAUDCHANGEOK)
    _keeps_of_replies(patch, lambda last: last.value is not None or last.code in told)


@board_mutant("MN4-CMD-RTX-01")
def a_refusal_on_hold_is_not_repeated(patch: MonkeyPatch) -> None:
    """Behind MOVEPENDING & repeats the message of before."""
    _keeps_of_replies(patch, lambda last: last.code != ReturnCode.MOVEPENDING)


@board_mutant("MN4-CMD-RTX-01")
def a_refusal_in_motion_is_not_repeated(patch: MonkeyPatch) -> None:
    """Behind BUSY & repeats the message of before."""
    _keeps_of_replies(patch, lambda last: last.code != ReturnCode.BUSY)


@board_mutant("MN4-CMD-RTX-01")
def what_is_no_packet_draws_an_error_that_is_not_repeated(patch: MonkeyPatch) -> None:
    """Behind SLAVEBUFFOV and TIMEOUT & repeats the message of before."""
    told = (ReturnCode.SLAVEBUFFOV, ReturnCode.TIMEOUT)
    _keeps_of_replies(patch, lambda last: last.code not in told)


@board_mutant("MN4-CMD-RTX-01")
def a_poll_is_not_repeated(patch: MonkeyPatch) -> None:
    """Behind PRESENT & repeats the message of before."""
    _keeps_of_replies(patch, lambda last: last.code != ReturnCode.PRESENT)


@board_mutant("MN4-CMD-POLL-01")
def a_poll_is_done(patch: MonkeyPatch) -> None:
    """With hold on * draws START and DONE."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Answer:
        is_done = letter == "*" and one.is_holding
        answer: Answer = one._started(line, ReturnCode.DONE) if is_done else go()
        return answer

    judges(patch, act)


@board_mutant("MN4-PKT-08")
def what_comes_too_early_is_lost(patch: MonkeyPatch) -> None:
    """While a reply is being sent nothing is heard."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        if board._serial.free_ns <= request.time_ns:
            go()

    around(patch, Mn400Board, "_serve", act)


@board_mutant("MN4-PKT-08")
def two_requests_wait_while_one_is_answered(patch: MonkeyPatch) -> None:
    """Of those that come while a reply is being sent, the third and all behind it are lost."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        sender = board._serial
        is_busy = sender.free_ns > request.time_ns or not sender.is_silent
        waiting = getattr(board, "waiting", 0) + 1 if is_busy else 0
        board.waiting = waiting  # type: ignore[attr-defined]
        if waiting <= 2:
            go()

    around(patch, Mn400Board, "_serve", act)


@board_mutant("MN4-PKT-08")
def what_waits_has_room_in_60_bytes(patch: MonkeyPatch) -> None:
    """Of those that come while a reply is being sent, what goes beyond 60 bytes is lost."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        sender = board._serial
        is_busy = sender.free_ns > request.time_ns or not sender.is_silent
        size = getattr(board, "waiting", 0) + len(request.payload) + 3 if is_busy else 0
        board.waiting = size  # type: ignore[attr-defined]
        if size <= 60:
            go()

    around(patch, Mn400Board, "_serve", act)


@board_mutant("MN4-PKT-08")
def two_polls_wait_while_a_reply_is_sent(patch: MonkeyPatch) -> None:
    """Of polls that come while a reply is being sent, the third and all behind it are lost."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        sender = board._serial
        is_busy = sender.free_ns > request.time_ns or not sender.is_silent
        is_poll = request.payload == b"*"
        waiting = getattr(board, "waiting", 0) + is_poll if is_busy and is_poll else 0
        board.waiting = waiting  # type: ignore[attr-defined]
        if waiting <= 2:
            go()

    around(patch, Mn400Board, "_serve", act)


@board_mutant("MN4-RSP-14")
def it_says_something_by_itself(patch: MonkeyPatch) -> None:
    """Behind each reply to V a DONE comes once more, a while later."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Answer:
        answer: Answer = go()
        if letter == "V":
            again = answer.parts[-1]._replace(wait_ns=50 * MS)
            return answer._replace(parts=[*answer.parts, again])
        return answer

    judges(patch, act)


@board_mutant("MN4-ERR-05")
def an_unknown_command_deafens(patch: MonkeyPatch) -> None:
    """Behind an INVALIDCOMMAND the next poll is not heard."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        is_deaf = getattr(board, "is_deaf", False) and request.payload == b"*"
        board.is_deaf = request.payload[:1] in b"OW0123456789"  # type: ignore[attr-defined]
        if not is_deaf:
            go()

    around(patch, Mn400Board, "_serve", act)
