"""What one exchange leaves behind for the next: each command behind each other one, with our sign
between them and without, and what a long silence leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.link import reason_not_served_amid_a_wait
from axistwin_conformance.families.msc.checks.status import AUTO_START, LOADS, RUNNING
from axistwin_conformance.families.msc.codec import ACK, BLOCK_VALUES, RQSTAT
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import Names
from axistwin_conformance.families.msc.scratch import SAFE_BLOCK, scratch_of

ORDER = 95  # of this module in a run; see `Family.modules`

SELF_TEST: Final = 128
STEADY: Final = AUTO_START | SELF_TEST | LOADS  # bits of the status word that no exchange changes
SILENCE_S: Final = 31.0  # longer than what makes go to sleep who counts to 10, 20 or 30 s
FLAGS_IN_PLAY: Final = 4
FLAGS_IN_SILENCE: Final = 6  # outputs may be among them
SPOTS_IN_PLAY: Final = 4
LONG: Final = ("BREAD", "BWRITE")
AMID: Final = ("MSC-LNK-01", "MSC-LNK-16")
ORDERLY: Final = ("MSC-LNK-01",)


def every_pair(names: Sequence[str], random: Random) -> list[str]:
    """A row in which each name stands once behind each of them, itself among them."""
    left = {name: random.sample(names, len(names)) for name in names}
    path, row = [names[0]], list[str]()
    while path:
        if left[path[-1]]:
            path.append(left[path[-1]].pop())
        else:
            row.append(path.pop())
    return row[::-1]


class Succession:
    """Commands carried out one behind the other, and what must be there then.

    `flags`: how many of the named ones are in play; `has_blocks`: whether blocks are, as well.
    """

    def __init__(
        self, session: Session, *, flags: int = FLAGS_IN_PLAY, has_blocks: bool = True
    ) -> None:
        self.session, self.driver = session, MscDriver(session)
        self.is_kept_back = False  # our sign to replies: the next packet ends the wait for it
        self.names: Names = ORDERLY
        scratch = self.driver.scratch
        self.block: int | None = None
        self.values: dict[int, int] = {}  # what was written, by address
        self.told: tuple[int, ...] = ()  # what the block was last written as
        self.unread: list[int] = []  # where that was not read yet
        self.spots = scratch.spots(1 << 16)[::-1]
        ends = [spot + SAFE_BLOCK - 1 for spot in self.spots]
        if has_blocks and any(end in scratch.variables for end in ends):
            self.block = scratch.block_spot()
            behind = self.block + SAFE_BLOCK
            self.spots = [spot for spot in self.spots if spot >= behind or spot < self.block]
        self.spots = self.spots[:SPOTS_IN_PLAY]
        numbers = scratch.some_flags(flags) if scratch.flags else []
        self.flags = dict.fromkeys(numbers, False)
        self.flag = numbers[0] if numbers else 0
        is_known = scratch_of(session).program is not None
        self.steady = STEADY | RUNNING if is_known else STEADY
        self.status = self.driver.status() & self.steady

    @property
    def reads(self) -> list[str]:
        """The reading commands that have something to read here."""
        return [
            "RQSTAT",
            "RFLAG",
            *(["RFLAGS"] if self.driver.has_rflags else []),
            *(["DREAD"] if self.spots else []),
            *(["BREAD"] if self.block is not None else []),
        ]

    @property
    def writings(self) -> list[str]:
        """The writing commands that have a place to write to here."""
        return [
            *(["DWRITE"] if self.spots else []),
            *(["BWRITE"] if self.block is not None else []),
            *(["SFLAG", "CFLAG"] if self.flags else []),
        ]

    def keep_back(self) -> None:
        """Give no sign to replies from now on."""
        self.is_kept_back, self.names = True, AMID

    def prepare(self) -> None:
        """Write what can be read, in the usual order."""
        for name in self.writings:
            if name != "CFLAG":
                self.write(name)
        for number, on in self.flags.items():
            self.driver.turn(number, on=on)

    def write(self, name: str) -> None:
        """Carry a writing command out: a value that is new, to a place that was not the last one,
        a flag that is not so yet."""
        if name == "DWRITE":
            self.spots = [*self.spots[1:], self.spots[0]]
            (value,), spot = self.driver.values(1), self.spots[-1]
            self.values[spot] = value
            self.unread = [*(one for one in self.unread if one != spot), spot]
            body = codec.dwrite(spot, value)
        elif name == "BWRITE":
            assert self.block is not None, "named only where there is one"
            self.told = tuple(self.driver.values(BLOCK_VALUES))
            body = codec.bwrite(self.block, self.told)
        else:
            on = name == "SFLAG"
            others = [number for number in self.flags if number != self.flag] or [self.flag]
            self.flag = next((one for one in others if self.flags[one] != on), others[0])
            self.flags[self.flag] = on
            body = (codec.sflag if on else codec.cflag)(self.flag)
        exchange = self.driver.ask(body)
        text = f"ACK to {codec.explain_request(exchange.request)}"
        self.session.expect(exchange.is_acked, self.names, text, exchange.observed)

    def read(self, name: str) -> None:
        """Carry a reading command out, and judge what it tells."""
        spot = self.unread.pop(0) if name == "DREAD" and self.unread else (self.spots or [0])[-1]
        body = {
            "RQSTAT": RQSTAT,
            "RFLAG": codec.rflag(self.flag),
            "RFLAGS": codec.RFLAGS,
            "DREAD": codec.dread(spot),
            "BREAD": codec.bread(self.block or 0),
        }[name]
        exchange = self.driver.ask(body, answer=None if self.is_kept_back else ACK)
        is_right = self.driver.client.is_right(exchange, name)
        text = f"ACK and a reply to {codec.explain_request(exchange.request)}"
        self.session.expect(is_right, self.names, text, exchange.observed)
        assert exchange.reply is not None
        if name == "RQSTAT":
            self._judge_status(exchange.reply.numbers[0])
        elif name == "RFLAG":
            self._judge_flags({self.flag} if exchange.reply.numbers[0] else set(), {self.flag})
        elif name == "RFLAGS":
            self._judge_flags(set(codec.flags_on(exchange.reply.payload)), set(self.flags))
        elif name == "DREAD":
            self._judge_value(spot, exchange.reply.values[0])
        else:
            self._judge_block(exchange.reply.values)

    def _judge_status(self, status: int) -> None:
        new = (status & self.steady) ^ self.status
        text = f"bits {self.status:04X}h of {self.steady:04X}h, as before"
        self.session.expect(not new, "MSC-STA-02", text, f"RQSTAT = {status:04X}h")

    def _judge_flags(self, on: set[int], among: set[int]) -> None:
        for number in sorted(among & set(self.flags)):
            wanted, seen = self.flags[number], number in on
            names = ("MSC-SFLAG-02" if wanted else "MSC-CFLAG-02", "MSC-RFLAG-02")
            text, came = (f"flag {number} {'on' if one else 'off'}" for one in (wanted, seen))
            self.session.expect(seen == wanted, names, text, came)

    def _judge_value(self, spot: int, seen: int) -> None:
        if spot in self.values:
            names = ("MSC-DREAD-02", "MSC-DWRITE-02")
            self.session.expect(
                seen == self.values[spot], names, f"{self.values[spot]} at {spot}", seen
            )

    def _judge_block(self, seen: tuple[int, ...]) -> None:
        if self.told:
            text, names = codec.listed(self.told), ("MSC-BWRITE-02", "MSC-BREAD-03")
            self.session.expect(seen == self.told, names, text, codec.listed(seen))

    def carry_out(self, row: Sequence[str]) -> None:
        """Carry them out in their order."""
        for name in row:
            self.read(name) if name in codec.READS else self.write(name)

    def conclude(self) -> None:
        """Judge that all is as it was left, and end a wait for our sign."""
        if self.is_kept_back:
            self.driver.target.send(ACK)
        for spot in self.values:
            self._judge_value(spot, self.driver.read(spot))
        if self.block is not None:
            self._judge_block(self.driver.read_block(self.block))
        if self.driver.has_rflags:
            on = set(self.driver.flags_at_once())
        else:
            on = {number for number in self.flags if self.driver.flag(number)}
        self._judge_flags(on, set(self.flags))
        self._judge_status(self.driver.status())


JUDGED: Final = (
    "MSC-LNK-01", "MSC-DREAD-02", "MSC-DWRITE-02", "MSC-BWRITE-02", "MSC-BREAD-03", "MSC-SFLAG-02",
    "MSC-CFLAG-02", "MSC-RFLAG-02", "MSC-STA-02",
)  # fmt: skip


@check("MSC-LNK-16", *JUDGED, safety="stored", level="full", needs=("variables", "flags"))
def each_command_works_behind_each_other(session: Session) -> None:
    """Whichever of the nine commands comes right behind whichever, each does and tells what it does
    and tells alone; also behind a reading command whose reply had no sign of ours, however often in
    a row.  (WAIT 02h)"""
    row = Succession(session)
    row.prepare()
    row.carry_out(every_pair([*row.reads, *row.writings], session.random))
    if reason := reason_not_to_keep_back(row.driver):
        session.not_run("MSC-LNK-16", reason)
    else:
        row.keep_back()
        _amid_waits(row)
    row.conclude()


def _amid_waits(row: Succession) -> None:
    draw = row.session.random
    short = [name for name in row.reads if name not in LONG]
    row.carry_out(every_pair(short, draw))
    for write in row.writings:
        for read in draw.sample(short, 1 if write in LONG else len(short)):
            row.carry_out((read, write))
    if row.block is not None:
        for name in draw.sample([*short, *row.writings], 2):
            row.carry_out(("BREAD", name))


@check("MSC-LNK-16", "MSC-LNK-01")
def a_wait_for_a_sign_may_be_ended_again_and_again(session: Session) -> None:
    """Reads of which none has a sign of ours to its reply are served, one behind the other.
    (WAIT 02h)"""
    driver = MscDriver(session)
    if reason := reason_not_to_keep_back(driver):
        session.skip(reason)
    bodies = [codec.rflag(0), RQSTAT, *([codec.RFLAGS] if driver.has_rflags else [])]
    for body in (*bodies, *bodies[::-1]):
        exchange = driver.ask(body, answer=None)
        is_right = driver.client.is_right(exchange, codec.name_of(body))
        text = f"ACK and a reply to {codec.explain_request(exchange.request)}"
        session.expect(is_right, AMID, text, exchange.observed)
    session.target.send(ACK)
    driver.link.alive(AMID)


def reason_not_to_keep_back(driver: MscDriver) -> str:
    """Why no packet can be sent instead of a sign; empty: it is served, and before T2 runs out."""
    is_repeated = driver.session.reading("ack_timeout_action") == "retransmit"
    if driver.link.is_slow and is_repeated:
        return "T2 is too short: the reply comes again before the next packet"
    return reason_not_served_amid_a_wait(driver)


# --- silence --------------------------------------------------------------------------------------


@check("MSC-LNK-01", "MSC-PHY-03", level="full")
def the_first_packet_after_a_long_silence_is_served(session: Session) -> None:
    """After 31 s in which nobody has said anything the first packet is served as any."""
    has_flags = bool(scratch_of(session).flags)
    if not session.target.is_virtual and has_flags and "stored" in session.run.allowed:
        session.skip("what is left after a long silence shows this as well")
    driver = MscDriver(session)
    driver.link.alive("MSC-LNK-01")
    driver.link.nothing_more("MSC-PHY-03", "the last exchange", SILENCE_S)
    driver.link.alive("MSC-LNK-01")


@check(
    "MSC-PHY-03", "MSC-LNK-01", "MSC-DREAD-02", "MSC-DWRITE-02", "MSC-SFLAG-02", "MSC-RFLAG-02",
    "MSC-STA-02", safety="stored", level="full", needs=("flags",),
)  # fmt: skip
def a_long_silence_changes_nothing(session: Session) -> None:
    """After 31 s in which nobody has said anything the first packet is served, the named flags and
    variables hold what they were left with, and the status tells the same."""
    row = Succession(session, flags=FLAGS_IN_SILENCE, has_blocks=False)
    row.flags = dict.fromkeys(row.flags, True)
    row.prepare()
    row.driver.link.nothing_more("MSC-PHY-03", "the last exchange", SILENCE_S)
    row.read("RFLAG")
    row.conclude()
