"""A small board behind a port of the tests, in virtual time: enough of an MN400 to ask it.

It does not move.  It takes its commands apart with the suite's own grammar, so it proves nothing
about that; it is there so that client, driver, checks and probes are heard to talk.  A fault is
planted by an override.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any, Final

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.core.session import Envelope, Run, Session
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.codec import ReturnCode
from axistwin_conformance.families.mn400.family import Mn400
from axistwin_conformance.families.mn400.grammar import (
    COMMANDS,
    ParsedCommand,
    Refusal,
    ReplyForm,
    arc_radii_differ,
    read_command,
)
from axistwin_conformance.transport.serial import SerialTransport

LEDGER: Final = load_ledger("mn400")
FRAME_TIMEOUT_NS: Final = 500_000_000
MOST_PAYLOAD: Final = 80
ANSWER_NS: Final = 1_000_000
LONG_MS: Final = {1: 100, 2: 1000}
Spoil = Callable[[bytes], bytes]


class SmallBoard:
    """A pyserial port with one board behind it.

    `readings`: those it follows, where that is not the default.  `spoil`: what becomes of each
    packet that it sends.  `received`: all that the host has sent.
    """

    def __init__(self, board: int = 1, **readings: str) -> None:
        self.board, self.readings = board, readings
        self.plane = [1, 3, 2]
        self.timeout: float | None = None
        self.baudrate = 9600
        self.virtual_time_ns = 0
        self.received = b""
        self.spoil: Spoil = lambda packet: packet
        self.counters = [0, 0, 0, 0]
        self.feed_hold = 0
        self.is_entering = False
        self.last: tuple[str, bytes] = ("*", b"\x16\x00")
        self._line: list[tuple[int, int]] = []  # time, byte: what is on its way to the host
        self._frame = b""
        self._heard_ns = 0

    # --- a port -----------------------------------------------------------------------------------

    @property
    def byte_ns(self) -> int:
        """What a byte takes on the line."""
        return 10_000_000_000 // self.baudrate

    @property
    def in_waiting(self) -> int:
        """Bytes that are there."""
        self._give_up()
        return sum(at <= self.virtual_time_ns for at, _ in self._line)

    def write(self, data: bytes) -> int:
        """Put bytes on the line."""
        self.received += data
        for byte in data:
            self._give_up()
            self.virtual_time_ns += self.byte_ns
            self._heard_ns = self.virtual_time_ns
            self._hear(byte)
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """Bytes as they come; time passes until there are so many, or the time-out is over."""
        until = self.virtual_time_ns + round((self.timeout or 0) * 1e9)
        taken = b""
        while len(taken) < size:
            if not self._line and self._frame and self._heard_ns + FRAME_TIMEOUT_NS <= until:
                self.virtual_time_ns = max(self.virtual_time_ns, self._heard_ns + FRAME_TIMEOUT_NS)
                self._give_up()
            if not self._line or self._line[0][0] > until:
                self.virtual_time_ns = until
                break
            at, byte = self._line.pop(0)
            self.virtual_time_ns = max(self.virtual_time_ns, at)
            taken += bytes([byte])
        return taken

    def close(self) -> None:
        """Stay open for questions."""

    # --- frames -----------------------------------------------------------------------------------

    def _give_up(self) -> None:
        is_over = self.virtual_time_ns >= self._heard_ns + FRAME_TIMEOUT_NS
        if not self._frame or not is_over:
            return
        frame, self._frame = self._frame, b""
        if frame[0] == codec.address_byte(self.board) and len(frame) > 1:
            self._say(chr(frame[1]), [ReturnCode.TIMEOUT])

    def _hear(self, byte: int) -> None:
        frame = self._frame
        if byte < codec.ADDRESS_MARK:
            self._frame = frame + bytes([byte]) if frame else b""
            if len(frame) > 2 and frame[-1] >= codec.ADDRESS_MARK:
                packet, self._frame = self._frame, b""
                self._take(packet)
            return
        is_closing = len(frame) > 1 and byte == frame[0] and frame[-1] < codec.ADDRESS_MARK
        self._frame = frame + bytes([byte]) if is_closing else bytes([byte])

    def _take(self, raw: bytes) -> None:
        packet = codec.parse(raw)
        assert packet is not None
        if packet.board not in (self.board, codec.ALL_BOARDS):
            return
        if len(packet.payload) > MOST_PAYLOAD:
            self._say(packet.command, [ReturnCode.SLAVEBUFFOV])
        elif not packet.is_sound and not self.ignores_sum:
            self._say(packet.command, self._error(ReturnCode.CHKSUMERROR, is_recognised=False))
        else:
            self._serve(packet.text)

    ignores_sum = False

    # --- commands ---------------------------------------------------------------------------------

    def reading(self, switch: str) -> str:
        """The reading it follows."""
        return self.readings.get(switch) or LEDGER.ambiguity_of(switch).default_of(switch)

    def _error(self, code: ReturnCode, *, is_recognised: bool = True) -> list[ReturnCode]:
        policy = self.reading("error_start_policy")
        has_start = policy == "always" or (policy == "after_accept" and is_recognised)
        return [ReturnCode.START, code] if has_start else [code]

    def _serve(self, text: str) -> None:
        letter = text[:1].upper()
        if letter == "&":
            self._send("&", self.last[1])
            return
        if letter not in COMMANDS or self._is_missing(letter):
            self._say(letter, self._error(ReturnCode.INVALIDCOMMAND, is_recognised=False))
            return
        if self.is_entering and letter not in "MV)Q":
            refusal = {"busy": [ReturnCode.START, ReturnCode.BUSY],
                       "ignored": [ReturnCode.START, ReturnCode.DONE]}  # fmt: skip
            usual = self._error(ReturnCode.INVALIDCOMMAND, is_recognised=False)
            self._say(letter, refusal.get(self.reading("cc_unsupported"), usual))
            return
        made = self.judged(text)
        if isinstance(made, Refusal):
            self._say(letter, self._error(ReturnCode.PARA_ERROR))
            return
        self._carry_out(made)

    def _is_missing(self, letter: str) -> bool:
        return letter in ";:" and self.reading("has_feedhold_cmds") == "false"

    def judged(self, text: str) -> ParsedCommand | Refusal:
        """What it makes of a text."""
        made = read_command(text, self.reading)
        if isinstance(made, ParsedCommand) and made.letter == "A":
            centre, end = (made.value(0), made.value(1)), (made.value(2), made.value(3))
            return arc_radii_differ(centre, end, Fraction(5, 2)) or made
        if isinstance(made, ParsedCommand) and made.letter == "P":
            x, y, z = self._plane_after(made)
            if self.reading("plane_z_check") == "at_plane" and z in (x, y):
                return Refusal("the traverse motor is in the plane", "MN4-CMD-P-03")
        return made

    def _plane_after(self, command: ParsedCommand) -> list[int]:
        rows = zip(self.plane, command.values, strict=True)
        return [was if one is None else one for was, one in rows]

    def _carry_out(self, command: ParsedCommand) -> None:
        letter = command.letter
        form = COMMANDS[letter].form
        if letter == "L":
            rows = zip(self.counters, command.values, strict=True)
            is_kept = self.reading("omitted_param") == "keep"
            self.counters = [(was if is_kept else 0) if one is None else one for was, one in rows]
        if letter == "P":
            self.plane = self._plane_after(command)
        if letter == ";":
            self.feed_hold = command.value(0)
        if letter in "()Q":
            self.is_entering = letter == "("
        if letter == "K":
            self._say(letter, [ReturnCode.START, ReturnCode.NOMOVEPENDING])
        elif form is ReplyForm.PRESENT:
            self._say(letter, [ReturnCode.START, ReturnCode.PRESENT])
        elif form is ReplyForm.BAUD:
            more = [ReturnCode.DONE] if self.reading("baud_reply") == "plus_done" else []
            self._say(letter, [ReturnCode.START, ReturnCode.BAUDCHANGEOK, *more])
        elif form is ReplyForm.DATA:
            self._say(letter, [ReturnCode.START])
            self._value(letter, self.value(command), LONG_MS.get(command.value(0), 0))
        else:
            self._say(letter, [ReturnCode.START, ReturnCode.DONE])

    def value(self, command: ParsedCommand) -> str:
        """What a command reads."""
        counters = ",".join(map(str, self.counters))
        shield = "0" if self.reading("shield_status_sense") == "switch" else "1"
        return {
            "E": counters + (",0" if command.values[:1] != (None,) else ""),
            "N": "0,0,0,0", "S": "0", "/": "0", "[": shield, ":": f"1,{self.feed_hold},0,0,0",
            "?": "MN400 V 1.08 / 1.04",
        }[command.letter]  # fmt: skip

    # --- replies ----------------------------------------------------------------------------------

    def _say(self, letter: str, codes: list[ReturnCode]) -> None:
        for code in codes:
            has_null = code in (3, 5, 22) or self.reading("outcome_null") == "true"
            self._send(letter, bytes([code]) + (b"\0" if has_null else b""))

    def _value(self, letter: str, value: str, wait_ms: int) -> None:
        trailer = self.reading("data_packet_trailer")
        behind = b"" if trailer == "none" else bytes.fromhex(trailer)
        self._send(letter, value.encode("latin-1") + behind, wait_ms)

    def _send(self, letter: str, body: bytes, wait_ms: int = 0) -> None:
        self.last = (letter, body)
        packet = self.spoil(codec.request(self.board, letter.encode("latin-1") + body))
        begun = max([self.virtual_time_ns + ANSWER_NS, *(at for at, _ in self._line[-1:])])
        begun += wait_ms * 1_000_000
        for index, byte in enumerate(packet):
            self._line.append((begun + (index + 1) * self.byte_ns, byte))


def session_on(port: Any, checked: Check | None = None, **how: Any) -> Session:
    """A session with a board; `how`: fields of the run."""
    family = Mn400()
    fields = {
        "target": SerialTransport(port, "a small MN400"),
        "family": family,
        "model": family.models["mn400"],
        "ledger": LEDGER,
        "address": port.board,
        "neighbours": (),
        "allowed": frozenset({"passive"}),
        "envelope": Envelope(0, 0),
        "seed": 0,
    }
    session = Session(Run(**(fields | how)), checked)
    session.transport.gate = lambda data: _refused(family, session, data)
    return session


def _refused(family: Mn400, session: Session, data: bytes) -> None:
    reason = family.forbid(session, data)
    assert reason is None, reason
