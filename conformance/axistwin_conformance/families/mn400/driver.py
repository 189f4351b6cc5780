"""One MN400 as checks handle it: typed questions and orders, and what its answers must be.

`client` asks as checks of the answer itself do.  The typed questions go on only with the answer
they ask for; the judging ones say whose business an answer is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from fractions import Fraction
from typing import Final

from axistwin_conformance.core.session import Requirements, Session
from axistwin_conformance.families.mn400 import codec, words
from axistwin_conformance.families.mn400.client import BoardClient, BoardExchange
from axistwin_conformance.families.mn400.codec import BoardPacket
from axistwin_conformance.families.mn400.grammar import Refusal, read_command
from axistwin_conformance.families.mn400.model.board import BoardModel, Expectation
from axistwin_conformance.families.mn400.model.motions import Span

DONE: Final = ("START", "DONE")
DATA: Final = ("START", "data")
PRESENT: Final = ("START", "PRESENT")
AXES: Final = 4
LONGEST_VALUE: Final = 60  # bytes of the longest packet that E draws
FLAGS: Final = ("ShieldFlag", "FeedHold", "PauseFlag", "PauseState", "AbortFlag")


class BoardDriver:
    """A board, and the session in which it is asked."""

    def __init__(self, session: Session, board: int | None = None) -> None:
        self.session = session
        self.client = BoardClient(session, board)
        self.board = self.client.board
        self.target = session.target

    # --- what is known of it ----------------------------------------------------------------------

    def reading(self, switch: str) -> str:
        """The reading it is held to."""
        return self.session.reading(switch)

    def known(self, texts: Iterable[str]) -> tuple[str, ...]:
        """Those of the texts whose command this board has (MN4-AMB-38)."""
        has_all = self.reading("has_feedhold_cmds") == "true"
        return tuple(text for text in texts if has_all or text[:1] not in (";", ":"))

    def follows(
        self, switch: str, seen: str | Sequence[str], requirement: Requirements = None
    ) -> None:
        """Judge which reading of an ambiguity it follows here; see `Session.quirk`."""
        self.session.quirk(requirement, switch, seen)

    def model(self) -> BoardModel:
        """What must come of it, from power-on settings at its present counters."""
        model = BoardModel(self.reading)
        model.load(self.position())
        return model

    def span(self, exchange: BoardExchange) -> Span:
        """Between which times (s) the board has carried out what was asked."""
        return Fraction(exchange.asked_ns, 10**9), Fraction(exchange.done_ns, 10**9)

    # --- asking -----------------------------------------------------------------------------------

    def ask(self, text: str | bytes, **how: float) -> BoardExchange:
        """Send a sound request; `how` is as `BoardClient.ask_raw` takes it."""
        return self.client.ask(text, **how)

    def command(self, text: str) -> BoardExchange:
        """Send a command and go on with its START and DONE."""
        exchange = self.ask(text)
        told = f"START and DONE to {words.command_words(text)}"
        self.session.step(exchange.says(*DONE), told, exchange.observed)
        return exchange

    def value(self, text: str) -> BoardPacket:
        """Send a command that reads and go on with its data packet."""
        exchange = self.ask(text)
        told = f"START and a value to {words.command_words(text)}"
        self.session.step(exchange.says(*DATA), told, exchange.observed)
        packet = exchange.value
        assert packet is not None, "the step above has seen to it"
        return packet

    def numbers(self, text: str, count: int) -> tuple[int, ...]:
        """The numbers that a command reads, so many of them."""
        packet = self.value(text)
        fields = packet.fields
        is_right = fields is not None and len(fields) == count
        self.session.step(is_right, f"{count} numbers to {text}", packet.value)
        assert fields is not None
        return fields

    def position(self) -> tuple[int, ...]:
        """The counters of all axes."""
        return self.numbers("E", AXES)

    def steps_left(self) -> tuple[int, ...]:
        """What is left of the current move."""
        return self.numbers("N", AXES)

    def counted(self, steps: Iterable[int]) -> tuple[int, ...]:
        """Steps that are left, as this board counts them (MN4-AMB-39)."""
        is_signed = self.reading("readcount_sign") == "signed"
        return tuple(steps) if is_signed else tuple(map(abs, steps))

    def flags(self) -> Mapping[str, int]:
        """The five flags of : by their names."""
        return dict(zip(FLAGS, self.numbers(":", len(FLAGS)), strict=True))

    def inputs(self) -> int:
        """The sum of all inputs that are on."""
        return self.numbers("S", 1)[0]

    def exit_code(self) -> int:
        """How the last move ended."""
        return self.numbers("/", 1)[0]

    def shield(self) -> int:
        """The state of the shield."""
        return self.numbers("[", 1)[0]

    def is_present(self) -> bool:
        """True if it answers a poll as it should."""
        return self.ask("*").says(*PRESENT)

    def is_found(self, most: int | None = None) -> bool:
        """The same of a board that need not be there; see `BoardClient.seek`."""
        return self.client.seek(most).says(*PRESENT)

    # --- judging what comes -----------------------------------------------------------------------

    def draws(
        self, text: str | bytes, codes: Sequence[str], requirement: Requirements
    ) -> BoardExchange:
        """Judge that a sound request draws sound packets that say exactly this."""
        exchange = self.ask(text)
        self.judge(exchange, codes, requirement)
        return exchange

    def judge(
        self, exchange: BoardExchange, codes: Sequence[str], requirement: Requirements
    ) -> None:
        """Judge what came of a request."""
        told = " and ".join(codes) or "nothing"
        is_right = exchange.says(*codes) if codes else exchange.is_silence
        self.session.expect(is_right, requirement, told, exchange.observed)

    def ignores(self, text: str) -> None:
        """Judge that a command under a wrong sum draws CHKSUMERROR; that it does nothing is left to
        what comes behind it."""
        raw = codec.with_wrong_checksum(self.client.request(text))
        codes = self.errors("CHKSUMERROR", is_recognised=False)
        self.judge(self.client.ask_raw(raw), codes, "MN4-PKT-05")

    def repeats(
        self, said: BoardExchange, requirement: Requirements, start: Requirements = None
    ) -> None:
        """Judge that & draws one packet, the last one of a reply, as before but for its command and
        sum (MN4-AMB-42); `start`: whose business a START before it is, None: the same."""
        is_verbatim = self.reading("retransmit_cmd") == "verbatim"
        after = words.explain_request(said.request)
        self.session.step(said.is_sound, f"packets to {after}", said)
        payload = said.found[-1].payload
        wanted = codec.request(self.board, payload if is_verbatim else b"&" + payload[1:])
        again = self.client.ask_again(wanted)
        came = words.explain_reply(again.raw) or "nothing"
        if start is not None:
            self.session.expect("START" not in again.codes, start, "no START", came)
        told, when = words.explain_reply(wanted), f"to & behind {after}"
        self.session.expect(again.raw == wanted, requirement, told, came, when)

    def draws_one_of(self, text: str | bytes, readings: Mapping[tuple[str, ...], str]) -> int | str:
        """For a probe: the number of the reading whose reply a request draws, in the order of the
        mapping; what came in words, if it is none."""
        exchange = self.ask(text)
        found = list(readings)
        if exchange.codes in found and not exchange.strays:
            return found.index(exchange.codes)
        return str(exchange)

    def meets(self, text: str, expectation: Expectation) -> BoardExchange:
        """Judge that a request draws what a model expects; see `fits`."""
        exchange = self.ask(text)
        self.fits(text, exchange, expectation)
        return exchange

    def fits(self, text: str, exchange: BoardExchange, expectation: Expectation) -> bool:
        """Judge that what came is what a model expects; where the manual is silent another answer
        is told and not judged.  True if it is what was expected."""
        told = [" and ".join(reply) or "a repeated message" for reply in expectation.replies]
        is_right = exchange.is_sound and exchange.codes in expectation.replies
        asked = words.command_words(text)
        if not is_right and expectation.is_open and exchange.is_sound:
            self.session.info(expectation.requirement, f"{asked} draws {exchange}")
            return False
        self.session.expect(is_right, expectation.requirement, sorted(told), exchange.observed)
        return True

    def tells(self, is_usual: bool, requirement: str, expected: str, actual: object) -> None:
        """Judge where the manual is silent and one behaviour makes sense: another one is told and
        fails nobody."""
        if is_usual:
            self.session.expect(True, requirement, expected, actual)
        else:
            self.session.info(requirement, f"expected {expected}, came {actual}")

    def refusal_of(self, text: str) -> Refusal | None:
        """Why this board must refuse a text, as far as no state decides; None: it must not."""
        made = read_command(text, self.reading)
        return made if isinstance(made, Refusal) else None

    def errors(self, code: str, *, is_recognised: bool = True) -> tuple[str, ...]:
        """An error with the START that this board sends before it (MN4-AMB-04)."""
        policy = self.reading("error_start_policy")
        has_start = policy == "always" or (policy == "after_accept" and is_recognised)
        return ("START", code) if has_start else (code,)

    def nothing_more(self, requirement: Requirements, behind: str) -> None:
        """Judge that nothing comes any more."""
        strays = self.client.strays_now()
        came = words.explain_reply(strays) or "nothing"
        self.session.expect(not strays, requirement, f"nothing behind {behind}", came)

    @contextmanager
    def entered(self, text: str, leaving: str = "Q") -> Iterator[None]:
        """Enter a contour, and leave it whatever happens."""
        try:
            self.command(text)
            yield
        finally:
            self.client.send(self.client.request(leaving))
            self.client.listen(self.session.reply_timeout_s)

    def slots_s(self, value_bytes: int = codec.STATUS_BYTES) -> float:
        """How long the replies of this board and its neighbours to all may take."""
        slot_s = max(self.client.poll_slot_s(), self.client.usual_slot_s(value_bytes))
        return slot_s * max(self.board, *self.session.neighbours, 1) + self.session.reply_timeout_s

    def poll_slot_s(self) -> float:
        """See `BoardClient.poll_slot_s`."""
        return self.client.poll_slot_s()
