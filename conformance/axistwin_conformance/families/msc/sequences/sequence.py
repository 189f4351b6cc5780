"""One-draw sequences: a string of bytes is a list of operations, and everything that comes is
judged.

Four bytes make an operation: what, two arguments, and a pause.  Any string is a sequence, so a
failing one shrinks by leaving bytes out.  Nothing can be drawn that writes outside what the
operator has named, and nothing broken but reads (`operations`).

A sequence begins with the same content of the same variables and flags, and ends with the line at
rest.  What a unit does when its time is up is judged within a window about the time it was measured
to have (MSC-AMB-02, -03), or that of the manual's default reading.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final

from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.client import MscExchange
from axistwin_conformance.families.msc.codec import ACK, NAK, Packet
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.scratch import SAFE_BLOCK, SAFE_STRIDE
from axistwin_conformance.families.msc.sequences.model import Surprise, UnitModel
from axistwin_conformance.sequences.runner import Mismatch, Steps

BYTES_PER_OPERATION: Final = 4
PAUSED: Final = 0x80  # a pause byte above it is a wait, ms beyond it
WINDOW: Final = 2 * SAFE_BLOCK  # addresses: few, so that what is written is met again
SPOTS: Final = 24
FLAGS: Final = 8
BEGINNING_VALUE: Final = 0
SILENCE_S: Final = 0.06  # ten times any response
EARLY, LATE = 0.9, 1.1  # of a time-out that has been measured to a few ms
LATE_S: Final = 0.05  # from a time-out to the first byte after it
STRIDES: Final = (4, 2, 1)
_NUMBERS: Final = re.compile(r"\d+(\.\d+)?(?= m?s\b)")  # times: no two are alike

# What an operation that goes wrong speaks about beside the model's own.
SIGN: Final = "MSC-LNK-01"
REPLY: Final = "MSC-PROP-01"
JUDGED: Final = (
    "MSC-PROP-08", "MSC-PROP-09", "MSC-PROP-10", "MSC-PROP-13", SIGN, REPLY, "MSC-PROP-03",
    "MSC-PROP-04", "MSC-PROP-06", "MSC-PROP-07", "MSC-PROP-15", "MSC-LNK-02", "MSC-LNK-03",
    "MSC-LNK-09", "MSC-LNK-10", "MSC-LNK-12", "MSC-LNK-15", "MSC-LNK-16",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class UnitOperation:
    """One line of the table: what it is called in reports, and what it does.

    `is_of_link`: what it says is no plain exchange, and reads at most: where bytes may get lost, it
    can be done again.
    """

    name: str
    act: Callable[[UnitSequence, int, int], None]
    is_of_link: bool = False


@dataclass
class UnitSequence(Steps):
    """One run of one byte string against one unit; see `OperationSequence`.

    `spots`: the addresses of single values; `blocks`: where blocks begin; `flags`: their numbers.
    `waiting_since_ns`: since when the unit has waited for our sign; None: it does not.
    """

    operation_bytes = BYTES_PER_OPERATION

    driver: MscDriver
    model: UnitModel
    spots: tuple[int, ...]
    blocks: tuple[int, ...]
    flags: tuple[int, ...]
    operations: tuple[UnitOperation, ...]
    judged: Counter[str] = field(default_factory=Counter)
    operated: Counter[tuple[str, str]] = field(default_factory=Counter)
    marks: list[int] = field(default_factory=list)
    waiting_since_ns: int | None = None
    is_over: bool = False  # everything it said was admissible, to the end
    _log: list[tuple[bytes, bytes] | int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.client, self.target = self.driver.client, self.driver.target
        self._slack_s = self.target.uncertainty_ns / 1e9

    @property
    def story(self) -> list[str]:
        """What was sent, said and waited, in words."""
        return [
            f"wait {step / 1e6:.0f} ms"
            if isinstance(step, int)
            else f"{codec.explain_request(step[0])} → {codec.explain(step[1]) or 'nothing'}"
            for step in self._log
        ]

    @property
    def is_waiting(self) -> bool:
        """True while the unit waits for our sign."""
        return self.waiting_since_ns is not None

    def follows(self, *switches: str) -> bool:
        """True if the unit follows the default readings of these switches, as far as known."""
        return all(map(self._follows, switches))

    def _follows(self, switch: str) -> bool:
        run = self.driver.session.run
        default = run.ledger.ambiguity_of(switch).default_of(switch)
        if switch in self.driver.session.readings or switch not in run.detections:
            return self.driver.session.readings.get(switch, default) == default
        candidates = run.detections[switch].candidates  # which of them it is nobody could tell
        return not candidates or default in candidates

    # --- doing ------------------------------------------------------------------------------------

    def operate(self, what: int, first: int, second: int, pause: int) -> None:
        """Run one operation.  Raises Mismatch for what is not admissible."""
        self.marks.append(len(self._log))
        operation = self.operations[what % len(self.operations)]
        state = "waiting" if self.is_waiting else "idle"
        with self._with_story():
            if operation.is_of_link and not self.target.is_lossless:
                self._insist(operation, first, second)
            else:
                operation.act(self, first, second)
            if pause > PAUSED:
                self.pause((pause - PAUSED) / 1000)
        self.operated[state, operation.name] += 1

    def _insist(self, operation: UnitOperation, first: int, second: int) -> None:
        """Do it again until noise is not the reason for what came, as `MscClient.ask` does."""
        session, seen = self.driver.session, list[tuple[str, str]]()
        for _ in range(1 if session.is_strict else RETRY.exchange):
            try:
                operation.act(self, first, second)
                return
            except Mismatch as wrong:
                seen.append((wrong.requirement, _NUMBERS.sub("#", wrong.actual)))
                last = seen[-session.run.quality.alike_needed :]
                is_settled = len(last) == session.run.quality.alike_needed
                if session.is_strict or (is_settled and len(set(last)) == 1):
                    raise
                session.record_retry(str(wrong))
                self.waiting_since_ns = None
                self.client.wait_until_quiet()
        session.void_attempt(f"{operation.name}: {seen[-1][1]}")

    def conclude(self) -> None:
        """Read every value and flag that is in play."""
        with self._with_story():
            self.finish_waiting()
            for address in self.blocks or self.spots:
                self.read_block(address) if self.blocks else self.read(address)
            for number in self.flags:
                self.read_flag(number)
        self.is_over = True

    def leave(self) -> None:
        """Leave the line at rest."""
        if self.is_waiting:
            self.target.send(ACK)
            self.waiting_since_ns = None

    def _with_story(self) -> _Storytelling:
        return _Storytelling(self)

    def pause(self, seconds: float) -> None:
        """Let time pass; not so long that the unit sends its reply again."""
        if self.is_waiting:
            self.finish_waiting()
        self._log.append(round(self.target.wait(seconds) * 1e9))

    def judge(self, requirement: str, holds: bool, expected: object, actual: object) -> None:
        """Count what holds; raises Mismatch for what does not."""
        if not holds:
            raise Mismatch(requirement, str(expected), str(actual))
        self.judged[requirement] += 1

    def _judge_model(self, text: tuple[str, Surprise | None]) -> None:
        requirement, wrong = text
        if wrong is not None:
            raise Mismatch(wrong.requirement, wrong.expected, wrong.actual)
        if requirement:
            self.judged[requirement] += 1

    # --- exchanges --------------------------------------------------------------------------------

    def sent(self, raw: bytes, came: bytes) -> None:
        """Take down what was sent and what came of it."""
        self._log.append((raw, came))

    def finish_waiting(self) -> None:
        """Give the unit the sign it waits for."""
        if self.is_waiting:
            self.target.send(ACK)
            self.sent(ACK, b"")
            self.waiting_since_ns = None

    def _interrupts(self) -> bool:
        """End the wait of the unit as the next packet can, before its time is over; True if the
        packet that follows ends it."""
        if self.waiting_since_ns is None:
            return False
        waited_s = (self.target.now_ns - self.waiting_since_ns) / 1e9
        is_soon = waited_s < self.driver.client.ack_timeout_s / 2
        if is_soon and self.follows("stx_while_waiting"):
            self.waiting_since_ns = None
            return True
        self.finish_waiting()
        return False

    def exchange(self, raw: bytes, answer: bytes | None = ACK) -> MscExchange:
        """Send a sound packet; its sign must be an ACK."""
        is_interrupting = self._interrupts()
        exchange = self.client.ask(raw, answer=answer)
        self.sent(raw, exchange.raw)
        requirement = "MSC-LNK-16" if is_interrupting else SIGN
        text = codec.explain_request(raw)
        self.judge(requirement, exchange.sign == ACK, f"ACK to {text}", exchange)
        return exchange

    def reply(self, body: bytes, answer: bytes | None = ACK) -> Packet:
        """Ask one of the reading commands; its reply must be as it has to be."""
        exchange = self.exchange(self.client.request(body), answer)
        reply, name = exchange.reply, body.partition(codec.COMMA)[0].decode()
        size = self.client.reply_bytes(name)
        is_right = self.client.is_right(exchange, name)
        self.judge(REPLY, is_right, f"a {name} reply of {size} bytes", exchange)
        assert reply is not None, "judged above"
        return reply

    # --- what the model knows ---------------------------------------------------------------------

    def read(self, address: int, answer: bytes | None = ACK) -> Packet:
        """DREAD, judged."""
        reply = self.reply(codec.dread(address), answer)
        self._judge_model(self.model.read(address, reply.values[0]))
        return reply

    def read_block(self, address: int, answer: bytes | None = ACK) -> Packet:
        """BREAD, judged."""
        reply = self.reply(codec.bread(address), answer)
        self._judge_model(self.model.read_block(address, reply.values))
        return reply

    def read_flag(self, number: int, answer: bytes | None = ACK) -> Packet:
        """RFLAG, judged."""
        reply = self.reply(codec.rflag(number), answer)
        state = reply.numbers[0]
        self.judge(REPLY, state in (0, 1), "0 or 1", state)
        self._judge_model(self.model.read_flag(number, bool(state)))
        return reply

    def read_flags(self, answer: bytes | None = ACK) -> Packet:
        """RFLAGS, judged as far as flags are in play."""
        reply = self.reply(codec.RFLAGS, answer)
        on = codec.flags_on(reply.payload)
        for number in self.flags:
            self._judge_model(self.model.read_flag(number, number in on))
        return reply

    def write(self, address: int, value: int) -> None:
        """DWRITE."""
        self.exchange(self.client.request(codec.dwrite(address, value)))
        self.model.write(address, value)

    def write_block(self, address: int, values: tuple[int, ...]) -> None:
        """BWRITE."""
        self.exchange(self.client.request(codec.bwrite(address, values)))
        self.model.write_block(address, values)

    def turn(self, number: int, on: bool) -> None:
        """SFLAG or CFLAG."""
        self.exchange(self.client.request((codec.sflag if on else codec.cflag)(number)))
        self.model.turn(number, on)

    # --- the line ---------------------------------------------------------------------------------

    def silence(self, requirement: str, after: bytes, seconds: float = SILENCE_S) -> None:
        """Nothing may come for so long."""
        came = self.client.listen(seconds + self._slack_s)
        self.sent(after, came)
        self.judge(requirement, not came, "nothing", codec.explain(came))

    def refused(self, requirement: str, raw: bytes) -> None:
        """A broken packet that is complete draws one NAK and nothing else."""
        self.finish_waiting()
        exchange = self.client.ask(raw, is_read=False)
        more = self.client.listen(SILENCE_S) if self.target.is_virtual else b""
        self.sent(raw, exchange.raw + more)
        came = codec.explain(exchange.raw + more) or "nothing"
        self.judge(requirement, exchange.raw + more == NAK, "one NAK", came)

    def broken_off(self, raw: bytes) -> None:
        """A packet whose end does not come draws one NAK when its time is over."""
        self.finish_waiting()
        self.target.drain()
        sent_ns = self.client.send(raw)
        left_ns = sent_ns + len(raw) * self.target.byte_ns
        first_s, last_s = self._window(self.driver.client.packet_timeout_s)
        came = self.client.receive(1, last_s + len(raw) * self.target.byte_ns / 1e9)
        now_ns = self.target.now_ns
        self.sent(raw, came)
        at = f"{codec.explain(came) or 'nothing'} after {(now_ns - sent_ns) / 1e6:.0f} ms"
        is_in_time = now_ns >= left_ns and now_ns - sent_ns >= first_s * 1e9
        self.judge("MSC-LNK-03", came == NAK, f"one NAK {first_s:.2f} to {last_s:.2f} s on", at)
        self.judge("MSC-PROP-06", is_in_time, f"one NAK {first_s:.2f} to {last_s:.2f} s on", at)
        self.silence("MSC-PROP-06", b"")

    def _window(self, timeout_s: float) -> tuple[float, float]:
        """From when to when something may come after a time-out of the unit."""
        return timeout_s * EARLY - self._slack_s, timeout_s * LATE + LATE_S + self._slack_s

    def in_pieces(self, body: bytes, place: int, pause_s: float) -> None:
        """A packet with a pause inside it is answered like any other."""
        self.finish_waiting()
        self.target.drain()
        raw, name = self.client.request(body), body.partition(codec.COMMA)[0].decode()
        self.client.send(raw[:place])
        self.target.wait(pause_s)
        exchange = self.client.ask(raw[place:], is_read=True)
        self.sent(raw, exchange.raw)
        size = 1 + self.client.reply_bytes(name)
        is_right = exchange.is_acked and len(exchange.raw) == size
        self.judge("MSC-PROP-03", is_right, f"ACK and a {name} reply", exchange)

    def repeated(self, first: Packet, count: int) -> None:
        """Refuse a reply so many times in all, the first time having been done; each NAK draws the
        same packet as long as there are repeats left, then nothing."""
        limit = 5 if self.follows("retransmit_limit") else 4
        for number in range(1, count + 1):
            again, strays = self.client.receive_packet(None if number <= limit else SILENCE_S)
            came = strays + (again.raw if again else b"")
            self.sent(NAK, came)
            text = codec.explain(came) or "nothing"
            if number > limit:
                self.judge("MSC-LNK-09", not came, f"nothing after {limit} repeats", text)
                self.judged["MSC-PROP-07"] += 1
                return
            self.judge("MSC-LNK-10", came == first.raw, "the same packet, no ACK before it", text)
            self.judged["MSC-PROP-07"] += 1
            self.target.send(NAK if number < count else ACK)

    def unanswered(self, first: Packet) -> None:
        """A reply without our sign comes again when the unit's time is over, as it was."""
        replied_ns = self.target.now_ns
        first_s, last_s = self._window(self.driver.client.ack_timeout_s)
        again, strays = self.client.receive_packet(last_s)
        begun_s = (self.target.now_ns - replied_ns - len(first.raw) * self.target.byte_ns) / 1e9
        came = strays + (again.raw if again else b"")
        self.sent(b"", came)
        is_in_time = begun_s >= first_s - self.target.byte_ns / 1e9
        self.target.send(ACK)
        self.waiting_since_ns = None
        text = f"{codec.explain(came) or 'nothing'} after {begun_s:.2f} s"
        expected = f"the same packet {first_s:.2f} to {last_s:.2f} s on"
        self.judge("MSC-LNK-12", came == first.raw and is_in_time, expected, text)


class _Storytelling:
    """Gives a mismatch the story it ends."""

    def __init__(self, run: UnitSequence) -> None:
        self._run = run

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, Mismatch):
            error.story = tuple(self._run.story)


# --- how one begins -------------------------------------------------------------------------------


def begin(driver: MscDriver, operations: tuple[UnitOperation, ...]) -> UnitSequence:
    """Bring what is in play to a known state, always the same, and give a sequence of these
    operations to play."""
    spots, blocks, cover = places(driver)
    flags = tuple(_spread(list(driver.scratch.flags), FLAGS))
    run = UnitSequence(driver, UnitModel(_strides(driver)), spots, blocks, flags, operations)
    zeros = (BEGINNING_VALUE,) * codec.BLOCK_VALUES
    for address in cover:
        if _is_done(driver, codec.bwrite(address, zeros)):
            run.model.write_block(address, zeros)
    for address in spots if not cover else ():
        if _is_done(driver, codec.dwrite(address, BEGINNING_VALUE)):
            run.model.write(address, BEGINNING_VALUE)
    for number in flags:
        if _is_done(driver, codec.cflag(number)):
            run.model.turn(number, False)
    return run


def _is_done(driver: MscDriver, body: bytes) -> bool:
    """Write; True if the unit says it has.  What it holds otherwise, the first read will tell."""
    return driver.ask(body).sign == ACK


def _strides(driver: MscDriver) -> tuple[int, ...]:
    """The distances of neighbours that are left."""
    known = driver.session.readings.get("data_address_stride")
    if known is not None:
        return (int(known),)
    detection = driver.session.run.detections.get("data_address_stride")
    left = tuple(int(stride) for stride in detection.candidates) if detection else ()
    return left or STRIDES


def places(driver: MscDriver) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    """Where values go, where blocks begin, and the blocks that cover the window of both."""
    named = driver.scratch.variables
    first = -(-named.start // SAFE_STRIDE) * SAFE_STRIDE
    window = range(first, min(named.stop, first + WINDOW), SAFE_STRIDE)

    def has_room(address: int) -> bool:
        return driver.scratch.may_write(address, codec.BLOCK_VALUES)

    cover = tuple(filter(has_room, window[:: SAFE_BLOCK // SAFE_STRIDE]))
    beside = filter(has_room, _spread(list(window), 2 * FLAGS))
    blocks = tuple(dict.fromkeys((*cover, *beside)))
    near = [
        address
        for at in blocks
        for address in (at, at + SAFE_STRIDE, at + SAFE_BLOCK - SAFE_STRIDE)
    ]
    spots = dict.fromkeys(
        (*_spread(list(window), SPOTS), *(address for address in near if address in window))
    )
    return tuple(spots), blocks, cover


def _spread(all_of: list[int], count: int) -> Iterator[int]:
    """So many of them at most, from the first to the last."""
    step = max(1, -(-len(all_of) // count))
    yield from all_of[::step]
