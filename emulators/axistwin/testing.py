"""Twins for tests: started on a pty or behind a URL, worked from Python, told about on failure.

``start("mac23")`` gives a running twin whose ``port`` any pyserial program can open::

    with testing.start("mac23", time="virtual") as twin:
        driver = MyDriver(twin.port)
        driver.go_to(1000)
        assert twin.position == 1000

pytest's ``axistwin`` fixture is this with the stopping done; use ``start`` itself in fixtures of a
wider scope, in unittest, or in a notebook.

- Real and scaled time: a pty, served by a thread of its own until ``stop``.
- Virtual time: an ``axistwin://`` URL for this process, and no thread at all.
"""

import contextlib
import itertools
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypedDict, Unpack, overload

from axistwin.errors import UsageError, nearest
from axistwin.kernel.time import NS_PER_S
from axistwin.runtime.transcript import Transcript
from axistwin.urlhandler import lines
from axistwin.urlhandler.url import SCHEME, SPEED, LineOptions, addressed, parse_speed

if TYPE_CHECKING:
    from axistwin.runtime.line import Line
    from axistwin.runtime.twin import Twin

TRANSCRIPT_BURSTS = 20_000
"""Bursts of bytes remembered of each line, so that what went wrong early is still there."""

_HEAD_LINES, _TAIL_LINES = 60, 90

_numbers = itertools.count(1)
_running: "dict[int, StartedLine]" = {}


class Options(TypedDict, total=False):
    """How twins live.

    time: ``"real"`` (the default) and a number (that many times as fast) give a pty, ``"virtual"``
    a URL.  address: of the one device, where it is not written behind the model's name.
    quirks: by name.  profile: a file of quirks.  state: a directory for what a real unit keeps.
    baud: the devices' factory rate.  pacing: whether bytes take time.  seed: of all that is random.
    cold: switch the devices on now; they start up first.
    """

    time: str | float
    address: int | str
    quirks: Mapping[str, str | int | bool]
    profile: str | Path | None
    state: str | Path | None
    baud: int | None
    pacing: bool
    seed: int
    cold: bool


@overload
def start(device: str, /, **options: Unpack[Options]) -> "StartedTwin": ...
@overload
def start(
    device: str, second: str, /, *others: str, **options: Unpack[Options]
) -> "StartedLine": ...
def start(*devices: str, **options: Unpack[Options]) -> "StartedLine":
    """Start a line with ``devices`` (``MODEL`` or ``MODEL:ADDRESS``); it can be opened at once.

    Raises UsageError, StateError and PortError.
    """
    settings = _line_options(devices, **options)
    kind = StartedTwin if len(settings.devices) == 1 else StartedLine
    return kind(settings)


def forget_exchanges() -> None:
    """Begin the transcripts of all lines in use anew."""
    for line in _lines_in_use():
        line.transcript.clear()


def exchanges(stopped: Sequence["StartedLine"] = ()) -> list[tuple[str, str]]:
    """Title and decoded transcript of every line that said something.

    Of those in ``stopped`` first, then of those in use: started here, or opened by their URL.
    """
    told = {line.line: line.title for line in (*stopped, *_running.values())}
    for line in _lines_in_use():
        told.setdefault(line, f"{' '.join(twin.name for twin in line.twins)} on {SCHEME}")
    texts = ((title, condensed(line)) for line, title in told.items())
    return [(title, text) for title, text in texts if text]


def _lines_in_use() -> "list[Line]":
    """The lines that were started here, and those behind URLs."""
    in_use = [line.line for line in _running.values()]
    return [*in_use, *(line.line for line in lines.living() if line.line not in in_use)]


class StartedLine:
    """A line of twins that runs until ``stop``, or the end of a ``with`` block.

    ``port`` is what to pass to ``serial.serial_for_url``; a pty's also to ``serial.Serial``.
    ``line[0]`` and ``line["mac34-1:5"]`` are its twins.
    """

    port: str

    def __init__(self, options: LineOptions) -> None:
        self._number = next(_numbers)
        self._stop = contextlib.ExitStack()
        with contextlib.ExitStack() as undo:
            if options.speed is None:
                self.port, self._line = _behind_url(options, self._number, undo)
            else:
                self.port, self._line = _on_pty(options, undo)
            self._stop = undo.pop_all()
        self._line.transcript = Transcript(TRANSCRIPT_BURSTS)
        _running[self._number] = self

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.title}>"

    @property
    def line(self) -> "Line":
        """The line itself."""
        return self._line

    @property
    def twins(self) -> Sequence["Twin"]:
        """The twins, in the order in which they were named."""
        return tuple(self._line.twins)

    @property
    def title(self) -> str:
        """The twins and where they are found."""
        return f"{' '.join(twin.name for twin in self.twins)} on {self.port}"

    def __getitem__(self, key: int | str) -> "Twin":
        if isinstance(key, int):
            return self.twins[key]
        known = {twin.name: twin for twin in self.twins}
        if key not in known:
            raise UsageError(f"no twin {key} on this line: {nearest(key, known)}")
        return known[key]

    def __len__(self) -> int:
        return len(self.twins)

    def __iter__(self) -> Iterator["Twin"]:
        return iter(self.twins)

    @property
    def virtual_time_ns(self) -> int:
        """The twins' present time in nanoseconds, in any kind of time."""
        return self._line.sync()

    def advance(self, seconds: float) -> None:
        """Let ``seconds`` (>= 0) of virtual time pass.  Raises UsageError in any other time."""
        if not self._line.is_virtual:
            raise UsageError(
                'advance: only virtual time can be moved; start the twin with time="virtual", '
                "or wait"
            )
        if not seconds >= 0:
            raise UsageError(f"advance: {seconds} s is not 0 or more")
        self._line.advance(round(seconds * NS_PER_S))

    @property
    def transcript(self) -> str:
        """What was said on the line, decoded; repeated exchanges are shown once and counted."""
        return condensed(self._line)

    def stop(self) -> None:
        """Stop serving, save what twins keep, and close everything; twice is once.

        Raises what made the line fail, if it did.
        """
        _running.pop(self._number, None)
        self._stop.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stop()


if TYPE_CHECKING:

    class _LineAndTwin(StartedLine, Twin):
        """What a started twin offers; it has the twin's part by delegation."""

else:
    _LineAndTwin = StartedLine


class StartedTwin(_LineAndTwin):
    """A line with one twin: whatever can be read from, set on or done to the twin, can on this."""

    @property
    def twin(self) -> "Twin":
        """The twin itself."""
        return self._line.twins[0]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.twin, name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name.startswith("_") or name == "port":
            object.__setattr__(self, name, value)
            return
        known = [each for each in dir(self.twin) if not each.startswith("_")]
        if name not in known:
            raise UsageError(f"a twin has no {name} to set: {nearest(name, known)}")
        setattr(self.twin, name, value)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *dir(self.twin)})


def _line_options(devices: Sequence[str], **options: Unpack[Options]) -> LineOptions:
    """``options`` as the value that lines are made from.  Raises UsageError."""
    if not devices:
        raise UsageError('which devices? name one or more, such as "mac23:0"')
    names = list(devices)
    if "address" in options:
        names = addressed(names, str(options["address"]))
    for name in options:
        if name not in Options.__annotations__:
            remedy = nearest(name, Options.__annotations__)
            if name == SPEED:
                remedy = f"write time={dict(options)[name]}"
            raise UsageError(f"unknown option {name}: {remedy}")
    given: dict[str, Any] = {
        name: value for name, value in options.items() if name not in ("time", "address")
    }
    for name in ("profile", "state"):
        if given.get(name) is not None:
            given[name] = str(given[name])
    speed = parse_speed(options.get("time", "real"))
    return replace(LineOptions(devices=tuple(names), speed=speed), **given)


def _behind_url(
    options: LineOptions, number: int, undo: contextlib.ExitStack
) -> tuple[str, "Line"]:
    """The URL and the line behind it; ``undo`` closes it."""
    name = f"started-{number}"
    shared = lines.share(name, options)
    undo.callback(lines.release, name)
    # Without the devices, so that nobody can make the line anew once it is stopped.
    return f"{SCHEME}?time=virtual&line={name}", shared.line


def _on_pty(options: LineOptions, undo: contextlib.ExitStack) -> tuple[str, "Line"]:
    """The pty's path and the line behind it; ``undo`` closes both."""
    from axistwin.ports.pty import PtyPort
    from axistwin.runtime.server import Server

    line = lines.build_line(options)
    undo.callback(line.close)
    folder = tempfile.mkdtemp(prefix="axistwin-")
    undo.callback(shutil.rmtree, folder, ignore_errors=True)
    link = str(Path(folder, line.twins[0].name.partition(":")[0]))
    server = Server(line, [PtyPort(link, line.device_format)])
    undo.callback(server.stop)
    server.start()
    return link, line


def condensed(line: "Line") -> str:
    """The transcript of ``line``: runs of exchanges with one request shortened, and bounded."""
    spoken: list[list[str]] = []
    for row in line.render_transcript().splitlines():
        if _said(row).startswith(">") or not spoken:
            spoken.append([])
        spoken[-1].append(row)
    kept: list[str] = []
    for _, group in itertools.groupby(spoken, key=lambda exchange: _said(exchange[0])):
        run = list(group)
        kept += run[0]
        if len(run) > 2:
            kept.append(f"{'…':>15} {len(run) - 2} more like this one")
        if len(run) > 1:
            kept += run[-1]
    dropped = len(kept) - _HEAD_LINES - _TAIL_LINES
    if dropped > 1:
        kept[_HEAD_LINES:-_TAIL_LINES] = [f"{'…':>15} {dropped} lines left out"]
    return "\n".join(kept)


def _said(row: str) -> str:
    """A row of a transcript without its time."""
    return row.partition(" ms ")[2]
