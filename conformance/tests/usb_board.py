"""A small MN400 on USB for the tests of checks, in virtual time: reports, nothing that moves.

It takes its commands apart with the suite's own grammar.  A fault is planted by an override.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, Final

from axistwin_conformance.base.events import Listener
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.engine.plan import Options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mn400.codec import ReturnCode
from axistwin_conformance.families.mn400.family import MODEL
from axistwin_conformance.families.mn400.grammar import Refusal, read_command
from axistwin_conformance.transport.hid import HidIdentity, HidTransport, ReportPort
from axistwin_conformance.transport.kinds import HID

NODE: Final = "/dev/hidraw9"
LEDGER: Final = load_ledger("mn400")
VALUES: Final = {
    "N": "0,0,0,0", "S": "0", "/": "0", "?": "MN400 V 1.08 / 1.04", "[": "1", ":": "1,0,0,0,0",
}  # fmt: skip


class UsbBoard:
    """A `ReportPort` with one board behind it.

    `parsed`: so many bytes of a report it looks at; `form`: of its errors; `has_outcomes`: K with
    nothing pending draws a report; `corrupt`: what becomes of each report that it sends.
    """

    enumerated = HidIdentity(0x0461, 0x0020, 64, 64)
    corrupt: Callable[[bytes], bytes | None] = staticmethod(lambda report: report)
    parsed = 48
    form = "cmd_code"
    has_outcomes = True
    says_done = False
    takes_all = False
    heeds_address = False

    def __init__(self) -> None:
        self.virtual_time_ns = 0
        self.counters = [5, -6, 7, 8]
        self.address = 1
        self.received: list[bytes] = []
        self._reports: deque[bytes] = deque()

    def identity(self) -> HidIdentity:
        """How it enumerates."""
        return self.enumerated

    def write(self, data: bytes, /) -> int:
        """Take an OUT report behind its number."""
        assert data[0] == 0
        self.received.append(data[1:])
        texts = data[1 : 1 + self.parsed].split(b"\0")
        for text in texts if self.takes_all else texts[:1]:
            if text:
                self.obey(text.decode("latin-1"))
        return len(data)

    def read(self, max_length: int, timeout_ms: int, /) -> bytes:
        """The next report, or time passes."""
        assert timeout_ms > 0
        if self._reports:
            return self._reports.popleft()
        self.virtual_time_ns += timeout_ms * 1_000_000
        return b""

    def close(self) -> None:
        """Stay open for questions."""

    def say(self, content: bytes) -> None:
        """Send an IN report."""
        corrupted = self.corrupt(content)
        if corrupted is not None:
            self._reports.append(corrupted.ljust(64, b"\0"))

    def obey(self, text: str) -> None:
        """Carry out a command."""
        letter = text[:1].upper()
        made = read_command(text, self._reading)
        if isinstance(made, Refusal):
            code = ReturnCode.INVALIDCOMMAND if made.is_unknown else ReturnCode.PARA_ERROR
            self.tell(letter, code)
        elif letter == "L":
            rows = zip(self.counters, made.values, strict=True)
            self.counters = [was if one is None else one for was, one in rows]
            self.done(letter)
        elif letter == "=":
            self.address = made.value(0)
            self.done(letter)
        elif letter == "*":
            self.tell(letter, ReturnCode.PRESENT)
        elif letter == "K" and self.has_outcomes:
            self.tell(letter, ReturnCode.NOMOVEPENDING)
        elif letter == "E" or letter in VALUES:
            self.read_out(letter)
        else:
            self.done(letter)

    def read_out(self, letter: str) -> None:
        """Send a value."""
        if self.heeds_address and self.address != 1:
            return
        value = ",".join(map(str, self.counters)) if letter == "E" else VALUES[letter]
        self.say((letter + value).encode("latin-1"))

    def tell(self, letter: str, code: ReturnCode) -> None:
        """Send a return code."""
        is_whole = self.form == "cmd_code" or code == ReturnCode.PRESENT
        self.say((letter.encode("latin-1") if is_whole else b"") + bytes([code]))

    def done(self, letter: str) -> None:
        """Nothing is said of what is done."""
        if self.says_done:
            self.tell(letter, ReturnCode.DONE)

    @staticmethod
    def _reading(switch: str) -> str:
        return LEDGER.ambiguity_of(switch).default_of(switch)


def judged(
    port: ReportPort | None, *words: str, hear: Listener = lambda event: None, **changes: Any
) -> Result:
    """A whole run of the engine on a board on USB; None: on what is at its endpoint."""
    given: dict[str, Any] = {
        "family": MODEL.over[HID], "model": "mn400", "endpoint": NODE, "address": 1,
        "neighbours": (), "rate": None, "allowed": frozenset({"passive", "destructive"}),
        "level": "full", "seed": 5, "words": words or ("MN4-USB", "MN4-USB-07"),
    }  # fmt: skip
    options = Options(**given | changes)
    opener = None if port is None else lambda neighbours: HidTransport(port, options.url)
    return Engine(options, opener).run(hear)
