"""The travel guard of the MN400: no packet is sent that asks an axis to leave the envelope.

It reads every byte either way, below checks and hooks alike, and keeps for each board on the line
where its axes may be or may still go (`BoardReach`), in steps from where the run found them.

    packet sent ──▶ what would follow, all readings of a doubt joined ──▶ outside? not sent
    packets heard ─▶ carried out, or refused: nothing followed; neither: both remain possible

Rules.

1. A move is judged by both coordinate modes unless the mode was set and its value is known; an arc
   by its whole circle, whichever way round it goes; a segment of a contour and a move on hold like
   one that runs at once; a stored program by all its lines.  A program that nobody has seen being
   entered is not run.
2. What moves is not sent before the speed and the profile were set: no board tells them.
3. A counter tells where an axis is once nothing can be moving it: after Q, or at the end of a lone
   move.  Backlash compensation is in no counter, so it widens what is possible and never narrows.
4. An input that halts, worked by the rig, leaves the axes anywhere on their way; so does each
   motion asked for while one is on.  What is relative starts from there.
5. A counter seen where nothing leads that was asked for is a doubt; a second one in a row is a
   runaway (`runaway`), and from then on nothing that moves is sent any more.
6. Motion without an end is that of a jog input that the rig works.  `deadline_ns` is when the stop
   must be on its way.
7. Until a reading is detected all that any of them leads to is possible (`_may_read`): how far a Q
   goes (MN4-AMB-62, MN4-AMB-74), whether backlash is counted (MN4-AMB-58).  What a queue that is
   kept leads to begins where a Q has ended the motion before.

Q, { and reads are never held back.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from math import ceil, hypot
from typing import Final, NoReturn

from axistwin_conformance.base.errors import OutsideEnvelope
from axistwin_conformance.core.readings import Readings
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.codec import BoardPacket
from axistwin_conformance.families.mn400.motion.reach import (
    BoardReach,
    Box,
    alternatives,
    axes_elsewhere,
    join,
    joined_boxes,
    places_of,
    planes,
    shift,
)
from axistwin_conformance.families.mn400.motion.rig_controls import HALTING, JOGGING, POWER_NAME
from axistwin_conformance.families.mn400.planner.vector import AXES
from axistwin_conformance.families.mn400.words import command_words

MARGIN_NS: Final = 30_000_000  # a stop takes 5 ms at 9600 baud; the rest is our own reaction
STRAY: Final = 4  # steps by which an arc may leave its circle (MN4-ARC-02, MN4-ARC-04)
SWING: Final = 10  # steps by which a counter may be off without its board counting as a runaway
LONGEST: Final = 512  # bytes of a request in pieces: no board keeps more
PACKET: Final = re.compile(rb"(?=([\x80-\xff])([\x00-\x7f]+)\1([\x00-\x7f]))")
NUMBER: Final = re.compile("-?[0-9]+")
MOVING: Final = "MA+TUK}"
IN_CONTOUR: Final = "MV)Q&"
ENDS: Final = ("\x04", "\x14")  # of a program, in any reading of MN4-AMB-12
REFUSED: Final = frozenset(
    {"CHKSUMERROR", "INVALIDCOMMAND", "INVALIDPROGCOMM", "PARA_ERROR", "NOMOVEPENDING", "BUSY",
     "SLAVEBUFFOV", "MEMORY_FULL"}
)  # fmt: skip
# A MOVE_ABORT tells of the motion before, and nothing of what was sent (MN4-AMB-51).
OBEYED: Final = frozenset({"DONE", "MOVE_ABORT", "data", "PRESENT", "BAUDCHANGEOK"})
# Whose business a board is that goes where it was not told, by what had begun its last motion.
BROKEN: Final = {
    "M": "MN4-CMD-M-01", "A": "MN4-CMD-A-01", "+": "MN4-CMD-HEL-01", "T": "MN4-CMD-T-01",
    "J": "MN4-JOG-01", "(": "MN4-CMD-M-01",
}  # fmt: skip


class BoardTravelGuard:
    """The envelope of one line: `max_travel` steps either way, `max_speed` steps per second.

    `readings`: what is known of the boards, as the run learns it.
    """

    def __init__(self, max_travel: int, max_speed: int, readings: Readings) -> None:
        self.max_travel, self.max_speed, self.readings = max_travel, max_speed, readings
        self.boards: dict[int, BoardReach] = {}
        self.runaway = ""  # why nothing that moves is sent any more
        self.broken = ""  # the requirement it fails by that
        self._is_halting = False  # an input that halts may be on
        self._doubtful: set[int] = set()  # boards last seen where they cannot be
        self._before: dict[int, BoardReach] = {}
        self._after: dict[int, BoardReach] = {}
        self._asked: BoardPacket | None = None  # what a reply answers, if that is one request
        self._sent, self._received = b"", b""

    @property
    def is_in_doubt(self) -> bool:
        """True if a board was last seen where it cannot be: the next reading tells whether that was
        noise."""
        return bool(self._doubtful) and not self.runaway

    # --- what is sent -----------------------------------------------------------------------------

    def sending(self, data: bytes, now_ns: int) -> None:
        """Account for bytes about to be sent; raises OutsideEnvelope if they must not be."""
        before = {board: reach.grown(now_ns) for board, reach in self.boards.items()}
        possible, after = dict(before), dict(before)
        requests = list(self._requests(data))
        for packet in requests:
            self._account(possible, packet, now_ns)
        # What ends here and began in an earlier request is for a board that has lost its place.
        whole = codec.parse(data)
        self._asked = whole if whole in requests else None
        for packet in (self._asked,) if self._asked is not None else requests:
            self._account(after, packet, now_ns)
        self._sent = (self._sent + data)[-LONGEST:]
        self._received = b""
        self._before, self._after = before, after
        # Until the reply comes, the request may have been obeyed or not.
        self.boards = {
            board: before[board].joined(reach).joined(after.get(board, reach))
            if board in before
            else reach
            for board, reach in possible.items()
        }

    def _requests(self, data: bytes) -> Iterator[BoardPacket]:
        """Every sound packet that ends in these bytes, wherever it began."""
        stream, known = self._sent + data, len(self._sent)
        for match in PACKET.finditer(stream):
            raw = stream[match.start() : match.end(3)]
            packet = codec.parse(raw) if match.end(3) > known else None
            if packet is not None and packet.is_sound:
                yield packet

    def _account(self, boards: dict[int, BoardReach], packet: BoardPacket, now_ns: int) -> None:
        letter = packet.command.upper()
        is_moving = letter in MOVING and letter != ""
        if is_moving and (self.runaway or self._doubtful):
            raise OutsideEnvelope(self.runaway or "an axis was last seen where it cannot be")
        everyone = packet.board == codec.ALL_BOARDS
        if is_moving and not everyone and packet.board not in boards:
            why = f"nobody knows where the axes of board {packet.board} are"
            self._refuse(packet.text, why, "--neighbour", packet.board)
        for board in tuple(boards) if everyone else (packet.board,):
            if board in boards:
                before = boards[board]
                boards[board] = self._asked_of(before, packet.text, now_ns)
                self._judge(before, boards[board], packet.text)
                new = _numbers(packet.text)[0]
                if letter == "=" and new is not None and new in codec.IDS:
                    boards[new] = boards[board]  # it may answer there from now on

    def _judge(self, before: BoardReach, after: BoardReach, text: str) -> None:
        """Hold back what leads out of the envelope."""
        for (low, high), (lowest, highest) in zip(after.far, before.far, strict=True):
            if low < min(-self.max_travel, lowest) or high > max(self.max_travel, highest):
                why = f"it could bring an axis to {low:+}..{high:+} from where it was found"
                self._refuse(text, why, "--max-travel", max(-low, high))

    def _judge_speed(self, state: BoardReach, text: str) -> None:
        """Hold back a motion that may be too fast."""
        if text[:1].upper() == "T":
            return
        if state.speed is None or state.end_speed is None:
            raise OutsideEnvelope(
                f"held back {command_words(text)}: nobody knows how fast it would be, V and F were"
                " not set in this run"
            )
        speed = min(state.speed, state.end_speed)
        if speed > self.max_speed:
            self._refuse(text, f"it would run at {speed} steps/s", "--max-speed", speed)

    def _refuse(self, text: str, reason: str, option: str, needed: int) -> NoReturn:
        raise OutsideEnvelope(
            f"held back {command_words(text)}: {reason}; the envelope is {self.max_travel} steps"
            f" either way, {self.max_speed} per second",
            option,
            needed,
        )

    # --- what may be true once it is obeyed -------------------------------------------------------

    def _asked_of(self, state: BoardReach, text: str, now_ns: int) -> BoardReach:
        """What may be true once a board has taken a command, in the entry that is open there."""
        letter = text[:1].upper()
        if state.entry in ("Z", "."):
            return _line(state, text)
        if state.entry == "(" and letter not in IN_CONTOUR:
            policy = self.readings.guess("cc_unsupported", "")
            obeyed = self._obeyed(state, text)
            if policy == "executed":
                return obeyed
            return state if policy else replace(state.joined(obeyed), entry="(")
        after = self._obeyed(state, text)
        if letter in MOVING and letter not in "K}" and after.motions != state.motions:
            self._judge_speed(state, text)
        return after

    def _obeyed(self, state: BoardReach, text: str) -> BoardReach:
        letter, numbers = text[:1].upper(), _numbers(text)
        act = _ACTS.get(letter)
        if act is not None:
            after = self._counted(state, replace(act(self, state, numbers), seen=None))
            is_cut = self._is_halting and after.motions > state.motions
            return after.cut_short() if is_cut else after
        if letter == "U":
            return self._program(state)
        return state if letter in "ENS/?[:&" else replace(state, seen=None)

    def _may_read(self, switch: str, reading: str) -> bool:
        """True if a board may follow this reading: as was detected, or as nobody has asked yet."""
        return self.readings.guess(switch, reading) == reading

    def _counted(self, before: BoardReach, after: BoardReach) -> BoardReach:
        """The same where the counters may tell what is made up for backlash (MN4-AMB-58)."""
        if after.slack == before.slack or not self._may_read("backlash_counts", "true"):
            return after
        counted = after.counting(before)
        return after.joined(counted) if self._may_read("backlash_counts", "false") else counted

    def _modes(self, state: BoardReach) -> tuple[bool, ...]:
        return (False, True) if state.is_absolute is None else (state.is_absolute,)

    def _targets(self, state: BoardReach, numbers: Sequence[int | None]) -> Box:
        """Where a move may lead: each axis, by each mode that may be in force."""
        box = []
        for axis in range(AXES):
            number = numbers[axis] if axis < len(numbers) else None
            if number is None:
                box.append(state.tip[axis])
                continue
            bases = [
                state.offset[axis] if is_absolute else state.tip[axis]
                for is_absolute in self._modes(state)
            ]
            box.append(join(*(shift(base, (number, number)) for base in bases)))
        return tuple(box)

    def _move(self, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
        """M, and T: a displacement or a place for each axis."""
        if all(number in (None, 0) for number in numbers[:AXES]) and state.is_absolute is False:
            return state
        is_kept = self._may_read("quit_flushes_queue", "false")
        return state.sent_to(self._targets(state, numbers), "M", is_kept=is_kept)

    def _thread(self, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
        return replace(self._move(state, numbers), begun_by="T")

    def _circle(self, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
        """A and +: the whole circle, whichever motors are the plane's."""
        values = [number or 0 for number in (*numbers, *[None] * 7)]
        centre_x, centre_y, end_x, end_y, _, traverse, _ = values[:7]
        motors = planes(state.plane)
        boxes = []
        for x, y, z in motors:
            box, tip = list(state.tip), list(state.tip)
            for is_absolute in self._modes(state):
                base_x = state.offset[x] if is_absolute else state.tip[x]
                base_y = state.offset[y] if is_absolute else state.tip[y]
                far_x, far_y = (
                    max(abs(base[0] + number - tip_of[1]), abs(base[1] + number - tip_of[0]))
                    for base, number, tip_of in (
                        (base_x, centre_x, state.tip[x]), (base_y, centre_y, state.tip[y]),
                    )
                )  # fmt: skip
                around = ceil(hypot(far_x, far_y)) + STRAY
                for motor, base, number, end in (
                    (x, base_x, centre_x, end_x), (y, base_y, centre_y, end_y),
                ):  # fmt: skip
                    ends = shift(base, (end, end))
                    tip[motor] = join(tip[motor], ends)
                    circle = shift(base, (number - around, number + around))
                    box[motor] = join(box[motor], circle, ends)
            along = [state.tip[z], shift(state.tip[z], (traverse, traverse))]
            if state.is_absolute is not False:
                along.append(shift(state.offset[z], (traverse, traverse)))
            tip[z] = join(tip[z], *along) if traverse else tip[z]
            box[z] = join(box[z], tip[z])
            boxes.append((tuple(tip), tuple(box)))
        tips = joined_boxes(*(tip for tip, _ in boxes))
        passed = joined_boxes(*(box for _, box in boxes))
        is_kept = self._may_read("quit_flushes_queue", "false")
        return state.sent_to(tips, "A", passed, is_kept=is_kept)

    def _helix(self, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
        return replace(self._circle(state, numbers), begun_by="+")

    def _program(self, state: BoardReach) -> BoardReach:
        """U: all lines, one behind the other."""
        if state.program is None:
            raise OutsideEnvelope("held back U: nobody has seen the program being stored")
        for line in state.program:
            if line[:1].upper() != "U":
                state = self._asked_of(state, line, 0)
        return state

    def _load(self, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
        """L: at rest the axes are where they are; in motion it waits, or not (MN4-AMB-52)."""
        is_queued = self.readings.guess("queue_modal", "") == "true"
        zeroes = self.readings.guess("omitted_param", "keep") != "keep"
        here = state.tip if is_queued or not state.motions else state.reach
        loaded = []
        for box in state.offsets:
            rows = []
            for axis, old in enumerate(box):
                number = numbers[axis] if axis < len(numbers) else None
                if number is None:
                    rows.append(join(old, here[axis]) if zeroes else old)
                else:
                    rows.append(shift(here[axis], (-number, -number)))
            loaded.append(tuple(rows))
        known = (state.offsets,) if state.motions else ()
        return replace(state, offsets=alternatives(*known, tuple(loaded)))

    def _mode(self, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
        value = self.readings.guess("abs_mode_value", "")
        number = numbers[0] if numbers else None
        is_known = value != "" and number in (0, 1)
        return replace(state, is_absolute=(str(number) == value) if is_known else None)

    def _plane(self, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
        base = self.readings.guess("plane_base", "")
        named = [number for number in numbers if number is not None]
        if not base or len(named) < 2:
            return replace(state, plane=None)
        motors = [number - int(base) for number in named]
        if len(motors) == 2 and state.plane is not None:
            motors.append(state.plane[2])
        is_whole = len(motors) == 3 and all(motor in range(AXES) for motor in motors)
        plane = (motors[0], motors[1], motors[2]) if is_whole else None
        return replace(state, plane=plane)

    def _halt(self, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
        """Q: at rest somewhere on the way, with nothing or all but one motion left; behind a ( this
        may end the entry alone."""
        is_entered = state.entry == "("
        closed = replace(state, entry="", motions=state.motions - is_entered)
        if is_entered and not self._may_read("quit_in_entry", "both"):
            return closed
        is_kept = self._may_read("quit_flushes_queue", "false")
        left = max(0, closed.motions - 1) if is_kept else 0
        halted = replace(closed, motions=left, jogs_since_ns=None).cut_short()
        is_open = is_entered and self._may_read("quit_in_entry", "entry_only")
        return closed.joined(halted) if is_open else halted

    def _jog(self, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
        is_on = bool(numbers and numbers[0])
        if is_on and state.jog_speed is None:
            raise OutsideEnvelope("held back J1: nobody knows how fast it would be, Y was not set")
        since_ns = state.jogs_since_ns if is_on else None
        return replace(state, is_jogging=is_on, jogs_since_ns=since_ns, begun_by="J")

    def _lash(self, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
        rows = zip(state.lash, (*numbers, *[None] * AXES), strict=False)
        return replace(state, lash=tuple(was if new is None else abs(new) for was, new in rows))

    def _remembered(self, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
        rows = zip(state.memory, (*numbers, *[None] * AXES), strict=False)
        memory = tuple(was if new is None else new if new in (1, -1) else None for was, new in rows)
        return replace(state, memory=memory)

    # --- the rig ----------------------------------------------------------------------------------

    def worked(
        self,
        name: str,
        window: tuple[int, int],
        disturbed: Collection[str] = (),
        number: int | None = None,
    ) -> None:
        """The rig has worked `name` in this window of the clock, ns; see `TravelLimiter.worked`."""
        self._is_halting = not set(HALTING).isdisjoint(disturbed)
        for board, state in tuple(self.boards.items()):
            if name == POWER_NAME:
                self.boards[board] = self._restarted(state)
            elif name in HALTING:
                self.boards[board] = state.cut_short()
            elif name in JOGGING and (state.is_jogging or name in JOGGING[:1]):
                since_ns = window[0] if state.jogs_since_ns is None else state.jogs_since_ns
                turned = state.turned(range(AXES) if number is None else (number - 1,))
                turned = self._counted(state, turned)
                self.boards[board] = replace(
                    turned.grown(window[1]), jogs_since_ns=since_ns, motions=1, begun_by="J"
                )

    def _restarted(self, state: BoardReach) -> BoardReach:
        """The supply was cut: counters may be 0 or as they were, and all that is volatile is
        forgotten; what the configuration program does is known if the suite has stored it."""
        offsets = alternatives(state.offsets, (state.reach,))
        fresh = BoardReach(
            reach=state.reach, tip=state.reach, offsets=offsets, slack=state.slack,
            slack_reach=state.slack, program=state.program, configuration=state.configuration,
            begun_by=state.begun_by,
        )  # fmt: skip
        for line in state.configuration or ():
            if line[:1].upper() not in "UJ":
                fresh = self._obeyed(fresh, line)
        return fresh

    # --- what is heard ----------------------------------------------------------------------------

    def received(self, data: bytes, now_ns: int) -> None:
        """Learn from the packets that come what became of the request."""
        self._received += data
        while size := codec.packet_end(self._received):
            raw, self._received = self._received[:size], self._received[size:]
            packet = codec.parse(raw)
            if packet is not None and packet.is_sound:
                self._hear(packet, now_ns)
        if self._received and self._received[0] < codec.ADDRESS_MARK:
            self._received = b""

    def _hear(self, packet: BoardPacket, now_ns: int) -> None:
        asked, board, (said,) = self._asked, packet.board, codec.codes_of((packet,))
        here = self.boards.get(board)
        is_bare = asked is None and packet.command in ENDS
        if is_bare and here is not None and (here.entry, said) == ("Z", "DONE"):
            self.boards[board] = _line(here, packet.command)
        if asked is None or packet.command.upper() != asked.command.upper():
            return
        if board not in self._after:
            if said == "data" and asked.command.upper() == "E":
                self._learn(board, asked, packet)
            return
        is_refused = said in REFUSED or (said == "MOVEPENDING" and self._is_kept_out(asked))
        if is_refused and asked.command == ")":
            return  # it may have forgotten its segments: what the board takes next tells
        if is_refused:
            self.boards[board] = self._before.get(board, self._after[board])
        elif said in OBEYED:
            self.boards[board] = self._after[board].grown(now_ns)
            if said == "data" and asked.command.upper() == "E":
                self._learn(board, asked, packet)
            elif said == "data" and asked.command.upper() == "N":
                is_over = packet.fields == (0,) * AXES
                self.boards[board] = (
                    self.boards[board].finished() if is_over else self.boards[board]
                )

    def _is_kept_out(self, asked: BoardPacket) -> bool:
        """True if MOVEPENDING says that nothing was done, whatever this board makes of moves that
        become pending and of their release (MN4-AMB-17, MN4-AMB-19)."""
        letter = asked.command.upper()
        if letter == "K":
            return self.readings.guess("release_reply", "") == "done"
        return letter not in "MA+T)" or self.readings.guess("pending_move_reply", "") == "done"

    def _learn(self, board: int, asked: BoardPacket, packet: BoardPacket) -> None:
        """A reading of the counters; those of a measurement may be old ones (MN4-AMB-40)."""
        counters = (packet.fields or ())[:AXES]
        if len(counters) != AXES:
            return
        if board not in self.boards:
            offset = tuple((-counter, -counter) for counter in counters)
            self.boards[board] = BoardReach(offsets=(offset,), seen=counters)
        elif not self._is_runaway(board, self.boards[board], counters):
            self.boards[board] = self._located(self.boards[board], counters)

    def _located(self, state: BoardReach, counters: tuple[int, ...]) -> BoardReach:
        """Narrow down by a reading, where nothing can be moving (rule 3)."""
        found = [
            places_of(box, counters, state.reach)
            for box in state.offsets
            if not axes_elsewhere(box, counters, state.reach, 0)
        ]
        here = joined_boxes(*found) if found else state.reach
        has_arrived = state.motions == 1 and state.begun_by == "M" and here == state.tip
        is_still = state.seen == counters or not self._may_read("quit_decel", "true")
        if not has_arrived and (state.motions or not is_still):
            return replace(state, seen=counters)
        offsets = [
            tuple((low - one, high - one) for (low, high), one in zip(box, counters, strict=True))
            for box in found
        ]
        return replace(
            state, reach=here, tip=here, offsets=alternatives(tuple(offsets) or state.offsets),
            motions=0, slack_reach=state.slack, seen=counters,
        )  # fmt: skip

    def _is_runaway(self, board: int, state: BoardReach, counters: tuple[int, ...]) -> bool:
        """True if a board is seen where nothing it was asked for leads; told for good when the next
        reading says the same."""
        elsewhere = [axes_elsewhere(box, counters, state.reach, SWING) for box in state.offsets]
        if not all(elsewhere):
            self._doubtful.discard(board)
            return False
        if board in self._doubtful and not self.runaway:
            axis, (low, _) = elsewhere[0][0]
            lowest, highest = state.reach[axis]
            self.broken = BROKEN[state.begun_by]
            self.runaway = (
                f"axis {axis + 1} was asked to stay within {lowest:+}..{highest:+} of where it was"
                f" found, and was seen at {low:+}: it is moved no more"
            )
        self._doubtful.add(board)
        return True

    def way_to_start(self, board: int) -> tuple[int, ...] | None:
        """How far a board's axes are from where they were found; None: not known exactly."""
        state = self.boards.get(board)
        return None if state is None else state.place

    def quits(self, board: int) -> int:
        """How many Q bring a board to rest, whatever it makes of them; one at least."""
        state, quits = self.boards.get(board, BoardReach()), 1
        while (state := self._halt(state, ())).motions:
            quits += 1
        return quits

    # --- jogging ----------------------------------------------------------------------------------

    @property
    def deadline_ns(self) -> int | None:
        """When the stop has to be on its way; None while nothing jogs."""
        jogging = [one for one in self.boards.values() if one.jogs_since_ns is not None]
        return min(map(self._deadline_of, jogging), default=None)

    def _deadline_of(self, state: BoardReach) -> int:
        room = min(self.max_travel - max(-low, high) for low, high in state.far)
        begun_ns = state.jogs_since_ns or 0
        return begun_ns + room * 1_000_000_000 // max(1, state.jog_rate) - MARGIN_NS

    def needed(self, wait_ns: int) -> int:
        """How large the envelope would have to be for jogging to go on for so long."""
        far = [0]
        for state in self.boards.values():
            if state.jogs_since_ns is not None:
                grown = state.grown(self._deadline_of(state) + wait_ns + 2 * MARGIN_NS)
                far += [max(-low, high) for low, high in grown.far]
        return max(far)

    def stop(self) -> tuple[bytes, ...]:
        """What ends jogging, for each board."""
        jogging = [board for board, one in self.boards.items() if one.jogs_since_ns is not None]
        return tuple(codec.request(board, text) for board in jogging for text in ("Q", "J0"))


def _numbers(text: str) -> list[int | None]:
    """The parameters as a careless board might read them; None: left out."""
    found = [NUMBER.search(part) for part in text[1:].split(",")]
    return [None if one is None else codec.number_in(one[0]) for one in found]


def _line(state: BoardReach, text: str) -> BoardReach:
    """A line of a program or of the configuration, or its end."""
    is_end = text in ENDS if state.entry == "Z" else text[:1].upper() == "Q"
    if not is_end:
        return replace(state, lines=(*state.lines, text), seen=None)
    if state.entry == "Z":
        return replace(state, entry="", program=state.lines, lines=())
    return replace(state, entry="", configuration=state.lines, lines=())


Act = Callable[[BoardTravelGuard, BoardReach, Sequence[int | None]], BoardReach]


def _speed(guard: BoardTravelGuard, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
    number = numbers[0] if numbers else None
    return state if number is None else replace(state, speed=number)


def _profile(
    guard: BoardTravelGuard, state: BoardReach, numbers: Sequence[int | None]
) -> BoardReach:
    number = numbers[1] if len(numbers) > 1 else None
    return state if number is None else replace(state, end_speed=number)


def _jog_speed(
    guard: BoardTravelGuard, state: BoardReach, numbers: Sequence[int | None]
) -> BoardReach:
    number = numbers[0] if numbers else None
    return state if number is None else replace(state, jog_speed=abs(number))


def _hold(guard: BoardTravelGuard, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
    return replace(state, holds=numbers[:1] != [0])


def _close(guard: BoardTravelGuard, state: BoardReach, numbers: Sequence[int | None]) -> BoardReach:
    return replace(state, entry="")


def _enter(letter: str) -> Act:
    return lambda guard, state, numbers: state.entered(letter)


_ACTS: Final[Mapping[str, Act]] = {
    "M": BoardTravelGuard._move, "T": BoardTravelGuard._thread, "A": BoardTravelGuard._circle,
    "+": BoardTravelGuard._helix, "L": BoardTravelGuard._load, "I": BoardTravelGuard._mode,
    "P": BoardTravelGuard._plane, "Q": BoardTravelGuard._halt, "J": BoardTravelGuard._jog,
    "B": BoardTravelGuard._lash, "D": BoardTravelGuard._remembered, "V": _speed, "F": _profile,
    "Y": _jog_speed, "H": _hold,
    "(": _enter("("), ")": _close, "Z": _enter("Z"), ".": _enter("."),
}  # fmt: skip
