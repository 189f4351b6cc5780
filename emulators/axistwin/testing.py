"""Twins for tests: on a pty, behind a URL, on a bus; worked from Python, told about on failure.

``start("mac23")`` gives a running twin whose ``port`` any pyserial program can open::

    with testing.start("mac23", time="virtual") as twin:
        driver = MyDriver(twin.port)
        driver.go_to(1000)
        assert twin.position == 1000

A twin on CAN has a ``bus``, which is python-can's::

    with testing.start("mac23-can:1", "mac23-can:2", time="virtual") as twins:
        driver = MyDriver(twins.bus)

pytest's ``axistwin`` fixture is this with the stopping done; use ``start`` itself in fixtures of a
wider scope, in unittest, or in a notebook.

- Serial line, real and scaled time: a pty, served by a thread of its own until ``stop``.
- Serial line, virtual time: an ``axistwin://`` URL for this process, and no thread at all.
- CAN bus, any time: a bus of this process (``axistwin.canbus``), and no thread.
"""

import contextlib
import itertools
import re
import shutil
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeAlias, TypedDict, Unpack, overload

from axistwin import catalog
from axistwin.devices.family import Carrier
from axistwin.errors import AxistwinError, UsageError, nearest
from axistwin.kernel.time import NS_PER_MS, NS_PER_S
from axistwin.runtime.clock import check_advance
from axistwin.runtime.host import patches
from axistwin.runtime.simulation import HAND
from axistwin.runtime.transcript import Transcript
from axistwin.urlhandler import lines
from axistwin.urlhandler.url import SCHEME, SPEED, LineOptions, addressed, parse_speed

if TYPE_CHECKING:
    from axistwin.canbus import AxistwinBus
    from axistwin.canbus.shared import SharedBus
    from axistwin.programs import ProgramSource
    from axistwin.runtime.any_twin import AnyTwin
    from axistwin.runtime.bus import Bus
    from axistwin.runtime.line import Line

Connection: TypeAlias = "Line | Bus"
"""What twins are connected by."""

TRANSCRIPT_BURSTS = 20_000
"""Bursts of bytes, or frames, remembered of each line or bus: what went wrong early is there."""

_HEAD_LINES, _TAIL_LINES = 60, 90

_ADDRESSEE = re.compile(r"(?:-> module|\(unit) (\d+)\b")
"""The one whom a request is for, in the words of a transcript."""

_numbers = itertools.count(1)
_running: "dict[int, StartedLine]" = {}


class Options(TypedDict, total=False):
    """How twins live.

    time: ``"real"`` (the default) and a number (that many times as fast) give a pty, ``"virtual"``
    a URL; on CAN all give a bus.  address: of the one device, where it is not written behind the
    model's name.  quirks: by name.  profile: a file of quirks, or the name of one that comes
    with a model.  state: a directory for what a real
    unit keeps.  baud: the devices' factory rate on a serial line.  bitrate: of a CAN bus.
    pacing: whether bytes and frames take time.  seed: of all that is random.  cold: switch the
    devices on now; they start up first.  host_clock: in virtual time, ``time.sleep``, the clocks of
    ``time`` and asyncio's loop move the twin's time too, until ``stop``.  program: what runs in a
    controller: a class derived from ``axistwin.macroprogram.Macroprogram``, ``FILE.py``,
    ``FILE.py:CLASS``, or the name of one that comes with axistwin; of several controllers also a
    mapping of such by unit.
    """

    time: str | float
    address: int | str
    quirks: Mapping[str, str | int | bool]
    profile: str | Path | None
    state: str | Path | None
    baud: int | None
    bitrate: int
    pacing: bool
    seed: int
    cold: bool
    host_clock: bool
    program: "ProgramSource | Mapping[int, ProgramSource]"


@overload
def start(device: str, /, **options: Unpack[Options]) -> "StartedTwin": ...
@overload
def start(
    device: str, second: str, /, *others: str, **options: Unpack[Options]
) -> "StartedLine": ...
def start(*devices: str, **options: Unpack[Options]) -> "StartedLine":
    """Start a line, or a bus, with ``devices`` (``MODEL`` or ``MODEL:ADDRESS``), ready for use.

    Raises UsageError, StateError and PortError.
    """
    names, settings = _settings(devices, **options)
    kind = StartedTwin if len(names) == 1 else StartedLine
    return kind(names, settings)


def forget_exchanges() -> None:
    """Begin the transcripts of all lines and buses in use anew."""
    for connection, _ in _in_use():
        connection.transcript.clear()
        connection.journal.clear()


def exchanges(stopped: Sequence["StartedLine"] = ()) -> list[tuple[str, str]]:
    """Title and decoded transcript of every line and bus that said something.

    Of those in ``stopped`` first, then of those in use: started here, or opened without.
    """
    told = {started.line: started.title for started in stopped}
    for connection, title in _in_use():
        told.setdefault(connection, title)
    texts = ((title, condensed(connection)) for connection, title in told.items())
    return [(title, text) for title, text in texts if text]


def _in_use() -> Iterator[tuple[Connection, str]]:
    """What was started here, with its title, then what was opened without (perhaps the same)."""
    for started in tuple(_running.values()):
        yield started.line, started.title
    for opened in lines.living():
        yield opened.line, _title(opened.line, SCHEME)
    buses = sys.modules.get("axistwin.canbus.shared")  # python-can is loaded by who wants it
    for shared in buses.known() if buses is not None else ():
        yield shared.bus, _title(shared.bus, f"can.Bus {shared.name}")


def _title(connection: Connection, place: str) -> str:
    return f"{' '.join(twin.name for twin in connection.twins)} on {place}"


class StartedLine:
    """A line, or a bus, of twins that runs until ``stop``, or the end of a ``with`` block.

    ``port`` is what to pass to ``serial.serial_for_url``; a pty's also to ``serial.Serial``.  On
    CAN, ``bus`` is a ``can.Bus``, and ``port`` the channel of it for more of them.
    ``line[0]`` and ``line["mac34-1:5"]`` are its twins.
    """

    port: str

    def __init__(self, devices: Sequence[str], settings: Mapping[str, Any]) -> None:
        self._number = next(_numbers)
        self._stop = contextlib.ExitStack()
        self._bus: AxistwinBus | None = None
        self._advance: Callable[[int], object]
        with contextlib.ExitStack() as undo:
            self._start(devices, settings, undo)
            if settings.get("host_clock"):
                patches.use(self)
                undo.callback(patches.release, self)
            self._stop = undo.pop_all()
        _running[self._number] = self

    def _start(
        self, devices: Sequence[str], settings: Mapping[str, Any], undo: contextlib.ExitStack
    ) -> None:
        """Start what the first device lives on; ``undo`` ends it."""
        name = f"started-{self._number}"
        if _carrier(devices[0]) == "can":
            shared, self._bus = _on_bus(devices, settings, name, undo)
            shared.bus.transcript = deque(maxlen=TRANSCRIPT_BURSTS)
            self.port = f"?bus={name}"
            self._line: Connection = shared.bus
            self._advance = shared.advance
            return
        options = LineOptions(devices=tuple(devices), **settings)
        if options.speed is None:
            self.port, line = _behind_url(options, name, undo)
        else:
            self.port, line = _on_pty(options, undo)
        line.transcript = Transcript(TRANSCRIPT_BURSTS)
        self._line, self._advance = line, line.advance

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.title}>"

    @property
    def line(self) -> Connection:
        """The line, or the bus, itself."""
        return self._line

    @property
    def bus(self) -> "AxistwinBus":
        """A port of the CAN bus, as python-can has it.  Raises UsageError on a serial line."""
        if self._bus is None:
            raise UsageError(f"{self.twins[0].name} lives on a serial line; open its port")
        return self._bus

    @property
    def twins(self) -> Sequence["AnyTwin"]:
        """The twins, in the order in which they were named."""
        return tuple(self._line.twins)

    @property
    def title(self) -> str:
        """The twins and where they are found."""
        return _title(self._line, self.port)

    def __getitem__(self, key: int | str) -> "AnyTwin":
        if isinstance(key, int):
            return self.twins[key]
        known = {twin.name: twin for twin in self.twins}
        if key not in known:
            raise UsageError(f"no twin {key} on this line: {nearest(key, known)}")
        return known[key]

    def __len__(self) -> int:
        return len(self.twins)

    def __iter__(self) -> Iterator["AnyTwin"]:
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
        check_advance(seconds, UsageError)
        self._line.note(f"advance({seconds:g})")
        self._advance(round(seconds * NS_PER_S))

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

    def __exit__(self, *_: object) -> None:
        self.stop()


if TYPE_CHECKING:

    class _LineAndTwin(StartedLine, AnyTwin):
        """What a started twin offers; it has the twin's part by delegation."""

else:
    _LineAndTwin = StartedLine


class StartedTwin(_LineAndTwin):
    """A line with one twin: whatever can be read from, set on or done to the twin, can on this."""

    @property
    def twin(self) -> "AnyTwin":
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
        setattr(self.twin, name, value)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *dir(self.twin)})


def _settings(
    devices: Sequence[str], **options: Unpack[Options]
) -> tuple[list[str], dict[str, Any]]:
    """The devices with their addresses, and how they live as fields.  Raises UsageError."""
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
        name: value for name, value in options.items() if name not in ("time", "address", "program")
    }
    if "program" in options:
        given["programs"] = _programs(names[0], options["program"])
    for name in ("profile", "state"):
        if given.get(name) is not None:
            given[name] = str(given[name])
    rate, other = ("bitrate", "baud") if _carrier(names[0]) == "can" else ("baud", "bitrate")
    if other in given:
        raise UsageError(f"{other}: not for {names[0]}; write {rate}={given[other]}")
    given["speed"] = parse_speed(options.get("time", "real"))
    return names, given


def _programs(
    device: str, program: "ProgramSource | Mapping[int, ProgramSource]"
) -> "Mapping[int | None, ProgramSource]":
    """What runs in each unit, None for all.  Raises UsageError."""
    if _carrier(device) == "can":
        raise UsageError(f"program: {device} runs none; leave it out")
    if isinstance(program, Mapping):
        return {unit: each for unit, each in program.items()}  # noqa: C416  # of a wider type
    return {None: program}


def _carrier(device: str) -> Carrier:
    """What ``device`` is reached over.  Raises UsageError."""
    return catalog.find_model(catalog.parse_device(device).model).carrier


def _behind_url(options: LineOptions, name: str, undo: contextlib.ExitStack) -> tuple[str, "Line"]:
    """The URL and the line of that name behind it; ``undo`` closes it."""
    shared = lines.share(name, options)
    undo.callback(lines.release, name)
    # Without the devices, so that nobody can make the line anew once it is stopped.
    return f"{SCHEME}?time=virtual&line={name}", shared.line


def _on_pty(options: LineOptions, undo: contextlib.ExitStack) -> tuple[str, "Line"]:
    """The pty's path and the line behind it; ``undo`` closes both."""
    from axistwin.ports.pty import PtyPort
    from axistwin.runtime.serving.line_server import Server
    from axistwin.runtime.serving.rack import Rack

    line = lines.build_line(options)
    undo.callback(line.close)
    folder = tempfile.mkdtemp(prefix="axistwin-")
    undo.callback(shutil.rmtree, folder, ignore_errors=True)
    link = str(Path(folder, line.twins[0].name.partition(":")[0]))
    rack = Rack()
    undo.callback(rack.stop)
    rack.add(Server(line, [PtyPort(link, line.device_format)], loop=rack.loop))
    rack.start()
    return link, line


def _on_bus(
    devices: Sequence[str], settings: Mapping[str, Any], name: str, undo: contextlib.ExitStack
) -> "tuple[SharedBus, AxistwinBus]":
    """The bus of that name and a port of it; ``undo`` closes both."""
    from axistwin.canbus import AxistwinBus
    from axistwin.canbus.channel import BusOptions, ChannelRequest
    from axistwin.canbus.shared import close_bus, open_bus

    options = BusOptions(devices=tuple(devices), **settings)
    shared = open_bus(ChannelRequest(name, options, frozenset()))
    undo.callback(close_bus, shared)
    port = AxistwinBus(f"?bus={name}")
    undo.callback(port.shutdown)
    return shared, port


def condensed(connection: Connection) -> str:
    """What was said: runs of exchanges with one request shortened, and bounded."""
    spoken: list[list[str]] = []
    for row in _rows(connection):
        if _said(row).startswith(">") or not spoken:
            spoken.append([])
        spoken[-1].append(row)
    kept: list[str] = []
    for _, group in itertools.groupby(spoken, key=_asked_and_done):
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


def _rows(connection: Connection) -> list[str]:
    """What was said, done by hand, and told by the devices, in the order of time."""
    said = deque(connection.render_transcript().splitlines())
    done = [
        f"{time_ns / NS_PER_MS:12.3f} ms * {who}: {what}"
        for time_ns, who, what in tuple(connection.journal)
    ]
    if not said and not any(who == HAND for _, who, _ in connection.journal):
        return []
    rows: list[str] = []
    for row in done:
        # What was read at this very time was read before, what was written, after.
        while said and (_time_ms(said[0]), _said(said[0])[:1] == ">") <= (_time_ms(row), False):
            rows.append(said.popleft())
        rows.append(row)
    return [*_with_nobody(connection, [*rows, *said])]


def _with_nobody(connection: Connection, rows: list[str]) -> Iterator[str]:
    """``rows``, and behind requests to which nobody answered, that there is nobody to."""
    there: dict[int, str] = {}
    with contextlib.suppress(AxistwinError):  # a line that is stopped tells no address
        there = {twin.address: twin.name for twin in connection.twins}
    for row, following in itertools.zip_longest(rows, rows[1:], fillvalue=""):
        yield row
        to = _ADDRESSEE.search(row) if _said(row).startswith(">") else None
        if to is None or not there or int(to[1]) in there or _said(following).startswith("<"):
            continue
        known = ", ".join(f"{name} has {address}" for address, name in there.items())
        yield f"{row.partition(' ms ')[0]} ms * nobody has address {to[1]}: {known}"


def _time_ms(row: str) -> float:
    return float(row.partition(" ms ")[0])


def _asked_and_done(exchange: list[str]) -> list[str]:
    """What makes an exchange another one: its request, and what was done and told meanwhile."""
    return [_said(row) for row in exchange if row is exchange[0] or _said(row).startswith("*")]


def _said(row: str) -> str:
    """A row of a transcript without its time."""
    return row.partition(" ms ")[2]
