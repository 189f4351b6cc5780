"""One MN400 on USB as checks handle it.

    OUT   command  parameters     00 ...
    IN    command  value          00 ...
    IN    command  return code    00 ...   or the code alone (MN4-AMB-50)

What is carried out and reads nothing draws no report (MN4-USB-04), so silence is an answer here: it
is waited for as long as a reply may take.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, cast

from axistwin_conformance.core.session import Requirements, Session
from axistwin_conformance.families.mn400.codec import CODES, NUMBER, ReturnCode
from axistwin_conformance.families.mn400.words import command_words
from axistwin_conformance.transport.hid import HidTransport

VENDOR, PRODUCT, REPORT_BYTES = 0x0461, 0x0020, 64  # MN4-USB-01
PARSED_BYTES: Final = 48  # MN4-USB-02
AXES: Final = 4
MEASURE_S: Final[Mapping[str, float]] = {"E1": 0.1, "E2": 1.0}  # MN4-MEA-01


def text_in(data: bytes) -> str:
    """The text of a report: without the nulls at its end."""
    return data.rstrip(b"\0").decode("latin-1")


def report_words(report: bytes | None) -> str:
    """A report of a board in words: ``E 0,0,0,0``, ``X PARA_ERROR``, ``nothing``."""
    if report is None:
        return "nothing"
    if not report:
        return "a report of nulls"
    letter, rest = report[:1].decode("latin-1"), report[1:]
    if len(rest) == 1 and rest[0] in CODES:
        return f"{letter} {ReturnCode(rest[0]).name}"
    if not rest and report[0] in CODES:
        return f"{ReturnCode(report[0]).name} alone"
    shown = report.decode("latin-1")
    return f"{letter} {shown[1:]}".rstrip() if shown.isprintable() else report.hex(" ").upper()


@dataclass(frozen=True, slots=True)
class ReportReply:
    """The first report that came of a command, without the nulls at its end; None: none came."""

    report: bytes | None

    @property
    def is_silence(self) -> bool:
        """True if no report came."""
        return self.report is None

    @property
    def code(self) -> ReturnCode | None:
        """The return code that it tells, in either form of MN4-AMB-50."""
        report = self.report or b""
        is_status = len(report) in (1, 2) and report[-1] in CODES
        return ReturnCode(report[-1]) if is_status else None

    @property
    def has_command(self) -> bool:
        """True if a status report has the command before its code."""
        return self.code is not None and len(self.report or b"") == 2

    def value_of(self, letter: str) -> str | None:
        """What a command with that letter reads; None if this is no value of it."""
        report = self.report or b""
        is_value = report[:1] == letter.encode("latin-1") and self.code is None
        return report[1:].decode("latin-1") if is_value else None

    def __str__(self) -> str:
        return report_words(self.report)


class UsbDriver:
    """A board, and the session in which it is asked."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.transport = cast(HidTransport, session.transport)

    def reading(self, switch: str) -> str:
        """The reading it is held to."""
        return self.session.reading(switch)

    def ask(self, text: str) -> ReportReply:
        """Send a report with that text; the first report that comes of it, if one does in time."""
        self.transport.drain()
        self.transport.send(text.encode("latin-1"))
        limit_s = self.session.reply_timeout_s + MEASURE_S.get(text.upper(), 0.0)
        return ReportReply(self.transport.receive(limit_s))

    def more(self) -> ReportReply:
        """A further report, if one comes in time."""
        return ReportReply(self.transport.receive(self.session.reply_timeout_s))

    # --- going on only with what was asked for ----------------------------------------------------

    def command(self, text: str) -> None:
        """Send a command that draws no report."""
        reply = self.ask(text)
        told = f"no report to {command_words(text)}"
        self.session.step(reply.is_silence, told, reply)

    def value(self, text: str) -> str:
        """What a command reads."""
        reply = self.ask(text)
        value = reply.value_of(text[:1])
        self.session.step(value is not None, f"a value to {command_words(text)}", reply)
        assert value is not None, "the step above has seen to it"
        return value

    def numbers(self, text: str, count: int) -> tuple[int, ...]:
        """The numbers that a command reads, so many of them."""
        value = self.value(text)
        parts = value.split(",")
        is_right = len(parts) == count and all(NUMBER.fullmatch(part) for part in parts)
        self.session.step(is_right, f"{count} numbers to {text}", value)
        return tuple(map(int, parts))

    def position(self) -> tuple[int, ...]:
        """The counters of all axes."""
        return self.numbers("E", AXES)

    # --- judging what comes -----------------------------------------------------------------------

    def draws_nothing(self, text: str, requirement: Requirements) -> None:
        """Judge that no report comes of a command."""
        reply = self.ask(text)
        self.session.expect(reply.is_silence, requirement, "no report", reply, _to(text))

    def draws_value(self, text: str, requirement: Requirements) -> str:
        """Judge that a command draws one report: its letter and what it reads."""
        reply = self.ask(text)
        value = reply.value_of(text[:1])
        told = f"{text[:1]} and a value"
        self.session.expect(value is not None, requirement, told, reply, _to(text))
        assert value is not None
        return value

    def draws_code(self, text: str, code: ReturnCode, requirement: Requirements) -> ReportReply:
        """Judge that a command draws a report with that code, in either form."""
        reply = self.ask(text)
        told = f"{text[:1]} {code.name}"
        is_right = reply.code == code and (not reply.has_command or self._is_own(text, reply))
        self.session.expect(is_right, requirement, told, reply, _to(text))
        return reply

    @staticmethod
    def _is_own(text: str, reply: ReportReply) -> bool:
        return (reply.report or b"")[:1].upper() == text[:1].upper().encode("latin-1")

    def counters_are(self, wanted: tuple[int, ...], requirement: Requirements, why: str) -> None:
        """Judge the counters."""
        position = self.position()
        told = ", ".join(map(str, wanted))
        self.session.expect(position == wanted, requirement, told, position, why)


def _to(text: str) -> str:
    return f"to {command_words(text)}"
