"""``axistwin decode``: what bytes of a line, or frames of a bus, mean.

A line of input is one of these, or is told as not understood:

    serial    02 30 31 34 ...                            bytes in hex, with or without separators
                  1520.312 > 02 30 31 34 ...  20h ...    of ``--capture``, of a failing test
    CAN       601#4000200000000000                       as cansend has it; 601#R is a remote frame
              (1436509052.249713) vcan0 601#4000... R    candump's log, python-can's
               (000.000000)  vcan0  601   [8]  40 00 ... candump's screen
    either    # ...                                      a remark; so is an empty line, and ``…``

What stands in front of a frame, such as its time, is printed with it.
"""

import io
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TextIO, TypeAlias

import click

from axistwin import catalog
from axistwin.devices.family import Carrier, Model
from axistwin.devices.words import missing
from axistwin.errors import UsageError
from axistwin.wire.can_frame import CanFrame

COMPLAINTS_MAX: Final = 10
"""Lines that are not understood and told one by one; of the rest only how many there are."""

_SHOWN_MAX = 60

_BYTE = r"(?:0x|\\x)?[0-9A-Fa-f]{2}"
_BARE_BYTES = re.compile(rf"(?P<shown>\s*(?P<data>{_BYTE}(?:[\s,;:-]*{_BYTE})*))[\s,;]*")
# Two blanks begin the meaning, which may be hex itself.
_BURST = re.compile(
    rf"(?P<shown>\s*(?:[\d.]+\s+(?:ms\s+)?)?[<>]\s+(?P<data>{_BYTE}(?: {_BYTE})*))(?:\s{{2,}}.*)?"
)
_PIECE = re.compile(rf"(?P<time>\d+\.\d{{6}}) (?P<way>[<>]) (?P<data>{_BYTE}(?: {_BYTE})*)")
"""As 'axistwin tap' writes it."""

PAUSE_MS: Final = 50
"""A longer silence ends what is explained together."""

_STAMP = r"\s*(?:\([^)]*\)\s+|[\d.]+\s+ms\s+[<>]\s+)?"
_IDENTIFIER = r"(?P<identifier>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})"
_LOGGED = re.compile(
    rf"(?P<shown>{_STAMP}(?:\S+\s+)?{_IDENTIFIER}#"
    r"(?:(?P<remote>[Rr])(?P<length>[0-8])?|(?P<data>(?:[0-9A-Fa-f]{2}\.?){0,8}))"
    r"(?:\s[RT])?)(?:\s{2,}.*)?\s*"
)
_ON_SCREEN = re.compile(
    rf"(?P<shown>{_STAMP}\S+\s+(?:[RT]X\s+\S\s+\S\s+)?{_IDENTIFIER}\s+\[(?P<length>[0-8])\]"
    r"(?:\s+(?:(?P<remote>remote request)|(?P<data>[0-9A-Fa-f]{2}(?: [0-9A-Fa-f]{2})*)))?)"
    r"(?:\s{2,}.*)?\s*"
)
_OF_ADAPTER = 0x20000000
"""The bit by which SocketCAN marks what an adapter tells of itself."""


@dataclass(frozen=True, slots=True)
class Found:
    """What a line of input holds: the part worth showing, and the bytes or the frame.

    content: None for a report of an adapter, which was never on the bus.
    """

    shown: str
    content: bytes | CanFrame | None


Reader: TypeAlias = Callable[[str], Found | None]
"""Finds what a line without its end holds; None if it is not understood."""


@click.command()
@click.argument("name", metavar="MODEL")
@click.argument("path", metavar="[FILE]", required=False, default="-")
def decode(name: str, path: str) -> None:
    """Show bytes of a line, or frames of a bus, in words.

    FILE is a recording of 'axistwin tap' or 'axistwin run --capture', what candump wrote, or lines
    typed by hand; standard input if it is - or left out.  For a model on a serial line every line
    has bytes in hex; for one on a CAN bus, a frame as candump or cansend write it.

    \b
    axistwin decode mac23 capture.txt
    axistwin decode mac23-can candump-2026-11-21_140211.log
    candump -L vcan0 | axistwin decode mac23-can
    echo '601#4000200000000000' | axistwin decode mac23-can
    echo '06 13 17' | axistwin decode mac23

    Lines that are not understood are reported on stderr with their numbers; the exit status is then
    2.
    """
    model = catalog.find_model(name)
    if path == "-":
        if sys.stdin.isatty():
            click.echo("axistwin: reading what you type; end with Ctrl-D", err=True)
        if isinstance(sys.stdin, io.TextIOWrapper):
            sys.stdin.reconfigure(errors="replace")
        _Decoder(model, sys.stdin, "standard input", click.echo).run()
        return
    with _opened(path, model) as file:
        _Decoder(model, file, path, print).run()


def _opened(path: str, model: Model) -> TextIO:
    """The file at ``path``.  Raises UsageError."""
    try:
        return open(path, encoding="utf-8", errors="replace")  # noqa: PTH123
    except OSError as error:
        remedy = "give an existing file"
        if READERS[model.carrier](path) is not None:
            remedy = f"to decode a frame, write: echo '{path}' | axistwin decode {model.name}"
        raise UsageError(f"{path}: cannot be read ({error.strerror}); {remedy}") from None


class _Decoder:
    """Says what the ``lines`` from ``source`` mean to ``model``, one after the other."""

    def __init__(
        self, model: Model, lines: Iterable[str], source: str, say: Callable[[str], object]
    ) -> None:
        self._model = model
        self._lines = lines
        self._source = source
        self._say = say
        self._read = READERS[model.carrier]
        self._unknown = 0
        self._is_explained = False

    def run(self) -> None:
        """Until the end of the lines.  Raises UsageError if some were not understood."""
        for number, line in _joined(self._lines):
            self._take(number, line)
        if self._unknown:
            share = "1 line was" if self._unknown == 1 else f"{self._unknown} lines were"
            raise UsageError(
                f"{self._source}: {share} not understood; {_EXPECTED[self._model.carrier]}"
            )

    def _take(self, number: int, line: str) -> None:
        if not line.strip() or line.lstrip().startswith(("#", "…")):
            self._say(line)
            return
        if self._is_explained and line.startswith("\t"):  # candump on an error frame
            self._say(line)
            return
        found = self._read(line)
        if found is None:
            self._complain(number, line)
            return
        self._is_explained = found.content is None
        self._say(f"{found.shown.rstrip()}  {self._meaning(found.content)}")

    def _meaning(self, content: bytes | CanFrame | None) -> str:
        if content is None:
            return "report of the adapter, no frame of the bus"
        return self._model.explain(content) or f"concerns no {self._model.name}"

    def _complain(self, number: int, line: str) -> None:
        self._unknown += 1
        if self._unknown > COMPLAINTS_MAX:
            return
        shown = line if len(line) <= _SHOWN_MAX else f"{line[:_SHOWN_MAX]}…"
        click.echo(f"axistwin: line {number}: {shown!r}{self._hint(line)}", err=True)

    def _hint(self, line: str) -> str:
        """Why ``line`` is not understood: what it lacks, or which device would understand it."""
        if self._model.carrier == "can" and (cut := _ON_SCREEN.fullmatch(line)) is not None:
            count, told = len((cut["data"] or "").split()), int(cut["length"])
            if count < told and not cut["remote"]:
                return f" is incomplete: {missing(told - count, told)}"
        for model in catalog.models().values():
            if model.carrier != self._model.carrier and READERS[model.carrier](line):
                return f" is for a model such as {model.name}"
        return " is not understood"


def _joined(lines: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Each line without its end, and its number; what a tap has passed on in pieces is one."""
    held: tuple[int, str] | None = None
    last_ms, way = 0.0, ""
    for number, line in enumerate(lines, 1):
        text = line.rstrip("\r\n")
        piece = _PIECE.fullmatch(text)
        if held is not None and (
            piece is None or piece["way"] != way or float(piece["time"]) - last_ms > PAUSE_MS
        ):
            yield held
            held = None
        if piece is None:
            yield number, text
            continue
        last_ms, way = float(piece["time"]), piece["way"]
        held = (number, text) if held is None else (held[0], f"{held[1]} {piece['data']}")
    if held is not None:
        yield held


def read_bytes(line: str) -> Found | None:
    """The bytes of a line of hex, or of a recording of a serial line."""
    match = _BURST.fullmatch(line) or _BARE_BYTES.fullmatch(line)
    if match is None:
        return None
    digits = re.sub(r"0x|\\x|[^0-9A-Fa-f]", "", match["data"])
    return Found(match["shown"], bytes.fromhex(digits))


def read_frame(line: str) -> Found | None:
    """The frame of a line of candump's log or screen, or as cansend takes it."""
    match = _LOGGED.fullmatch(line) or _ON_SCREEN.fullmatch(line)
    if match is None:
        return None
    identifier, is_extended = int(match["identifier"], 16), len(match["identifier"]) > 3
    if is_extended and identifier & _OF_ADAPTER:
        return Found(match["shown"], None)
    is_remote = match["remote"] is not None
    data = b"" if is_remote else bytes.fromhex((match["data"] or "").replace(".", ""))
    length = int(match["length"] or 0) if is_remote or match["length"] else len(data)
    try:
        frame = CanFrame(identifier, data, is_extended, is_remote, length)
    except ValueError:  # an identifier too large, or another length than it says
        return None
    return Found(match["shown"], frame)


READERS: Final[Mapping[Carrier, Reader]] = {"serial": read_bytes, "can": read_frame}

_EXPECTED: Final[Mapping[Carrier, str]] = {
    "serial": "write bytes in hex, such as 06 13 1A, or give a recording of --capture",
    "can": "write frames as candump does, such as 601#4000200000000000",
}
