"""The store of a board: its program, which can be listed, and its configuration, which cannot.

What is entered between Z and Ctrl-D, or between . and Q, is not carried out but kept.  The snapshot
holds the program and puts it back.  Nobody can read a configuration: whoever has one must enter it
again, and is told so before it is replaced.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final
from weakref import WeakSet

from axistwin_conformance.base import events
from axistwin_conformance.families.mn400.client import BoardClient, BoardExchange
from axistwin_conformance.families.mn400.driver import DONE, PRESENT, BoardDriver
from axistwin_conformance.transport.transport import Transport

PROFILE: Final = "F1000,5000,10000"  # as at power-on: above it no speed of these checks ramps
LINE_BREAKS: Final = re.compile(r"[\x00-\x20]+")  # between lines that come in one packet
LONGEST_LINE: Final = 69  # characters, of the longest command (MN4-PKT-13)
MOST_LINES: Final = 2000
END_BYTES: Final = {"04": "\x04", "14": "\x14", "both": "\x04"}  # by reading (MN4-AMB-12)
NOT_READABLE: Final = (
    "the configuration program (.) cannot be read back: what is stored now is lost, and the board"
    " is left with an empty one"
)


_told: WeakSet[Transport] = WeakSet()  # on which it has been said that nobody can read it


def listing(client: BoardClient, told: BoardExchange | None = None) -> tuple[str, ...] | None:
    """The stored program, in whatever form R tells it; None if it does not.

    `told`: what R has drawn; None: it is asked.
    """
    exchange = client.ask("R") if told is None else told
    if exchange.codes[:1] != ("START",) or exchange.strays:
        return None
    if set(exchange.codes[1:]) - {"data", "DONE"}:
        return None
    values = [packet.value for packet in exchange.found if packet.code is None]
    return tuple(line for value in values for line in LINE_BREAKS.split(value) if line)


def relative_mode(driver: BoardDriver) -> str:
    """The line that selects it (MN4-AMB-09)."""
    return f"I{1 - int(driver.reading('abs_mode_value'))}"


# --- the program ----------------------------------------------------------------------------------


def end_program(driver: BoardDriver) -> BoardExchange:
    """End the entry of a program, as this board wants it (MN4-AMB-12, MN4-AMB-13)."""
    end = END_BYTES[driver.reading("eof_byte")]
    is_bare = driver.reading("eof_framing") == "raw"
    return driver.client.ask_raw(end.encode("latin-1")) if is_bare else driver.ask(end)


def leave_entry(client: BoardClient) -> bool:
    """End whatever a board is storing, whichever byte it takes for Ctrl-D; True if it serves again.

    The entry of a configuration ends with Q, which that of a program stores.
    """
    for byte in (b"\x04", b"\x14"):
        for raw in (client.request(byte), byte):
            client.send(raw)
            client.listen(client.session.reply_timeout_s)
            if client.ask("*").says("START", "PRESENT"):
                return True
    client.ask("Q")
    return client.ask("*").says("START", "PRESENT")


@contextmanager
def program_entry(driver: BoardDriver) -> Iterator[None]:
    """Enter a program, and end that whatever happens."""
    driver.command("Z")
    try:
        yield
    finally:
        if not end_program(driver).says(*DONE):
            leave_entry(driver.client)


def enter_program(driver: BoardDriver, lines: Iterable[str]) -> None:
    """Store these lines in the place of the program; each must draw START and DONE."""
    with program_entry(driver):
        for line in lines:
            driver.command(line)


def put_program_back(driver: BoardDriver, lines: Sequence[str]) -> bool:
    """Store a program unless it is what the board lists; False if it does not list it then.

    Beside a full store it may not fit before that is emptied (MN4-AMB-70).
    """
    client = driver.client
    for entries in ((), (lines,), ((), lines)):
        for entered in entries:
            client.ask("Z")
            for line in entered:
                client.ask(line)
            if not end_program(driver).says(*DONE):
                leave_entry(client)
        if listing(client) == tuple(lines):
            return True
    return False


# --- how much fits --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FillResult:
    """The lines that a store has taken, what it has answered to the first one it did not (None: it
    has taken all), and the answer to the poll behind that one, which is a line too."""

    lines: tuple[str, ...]
    refusal: BoardExchange | None
    poll: BoardExchange | None = None

    @property
    def is_over(self) -> bool:
        """Whether the refusal has ended the entry: a poll is served behind it."""
        return self.poll is not None and self.poll.says(*PRESENT)

    @property
    def text_bytes(self) -> int:
        """How long all lines are."""
        return sum(map(len, self.lines))


def fill_store(
    driver: BoardDriver, longest: int = LONGEST_LINE, most_bytes: int | None = None
) -> FillResult:
    """In an entry: store lines so long (characters) until one is refused, then shorter ones, so
    that not even the shortest fits any more.  Once their text is longer than `most_bytes`, or the
    entry is over, no line follows."""
    lines: list[str] = []
    refusal: BoardExchange | None = None
    poll: BoardExchange | None = None
    length = longest
    while length > 0:
        line = "L" + str(len(lines)).rjust(length, "0")[1 - length :] * (length > 1)
        exchange = driver.ask(line)
        if exchange.says(*DONE):
            lines.append(line)
        elif refusal is None:
            refusal, poll = exchange, driver.ask("*")
            lines += ["*"] * poll.says(*DONE)
        else:
            length -= 1
        result = FillResult(tuple(lines), refusal, poll)
        if result.is_over or (most_bytes is not None and result.text_bytes > most_bytes):
            return result
        if len(lines) > MOST_LINES:
            driver.session.skip(f"{len(lines)} lines are stored, and no end of it")
    return result


# --- the configuration ----------------------------------------------------------------------------


def enter_configuration(driver: BoardDriver, lines: Iterable[str]) -> None:
    """Store these lines in the place of the configuration; each must draw START and DONE."""
    driver.command(".")
    try:
        for line in lines:
            driver.command(line)
    finally:
        driver.ask("Q")


@contextmanager
def emptied_afterwards(driver: BoardDriver) -> Iterator[None]:
    """Leave an empty configuration behind, whatever the block stores, and say so before."""
    if driver.target not in _told:
        _told.add(driver.target)
        driver.session.run.emit(events.Note(NOT_READABLE))

    def empty() -> bool:
        driver.ask("Q")  # an entry may be open still
        is_entered = driver.ask(".").says(*DONE)
        return driver.ask("Q").says(*DONE) and is_entered

    with driver.session.restore_on_exit("an empty configuration program", empty):
        yield
