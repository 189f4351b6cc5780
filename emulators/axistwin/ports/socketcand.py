"""socketcand: CAN over TCP as the Linux daemon of that name speaks it (its ``doc/protocol.md``).

Spoken by python-can's ``socketcand`` interface, Kayak and other clients of the daemon.  A message
is ``< WORD ARGUMENT... >``; the greeting is ``< hi >``.

    message                              modes          answer, effect
    < open BUS >                         no bus         < ok >, BCM mode; an unknown bus: hangs up
    < rawmode > bcmmode controlmode      all but no bus < ok >
    < echo >                             all but no bus < echo >
    < send ID LENGTH BYTE... >           BCM, raw       a data frame
    < sendrtr ID LENGTH >                BCM, raw       a remote frame
    < add S US ID LENGTH BYTE... >       BCM            a frame now and then every S s + US us
    < update ID LENGTH BYTE... >         BCM            new content, timer untouched
    < delete ID >                        BCM            ends that
    < subscribe S US ID >                BCM            frames of that identifier
    < filter S US ID LENGTH MASK... >    BCM            ..., when masked content changes
    < muxfilter S US ID N 8 BYTES... >   BCM            ..., per value under the first 8 bytes
    < unsubscribe ID >                   BCM            ends any of these
    < statistics MS >                    control        < stat > every MS ms; 0: no more

    < frame ID SECONDS DATA >            a data frame, in raw mode or subscribed to
    < rtr ID SECONDS LENGTH >            a remote frame, in raw mode
    < error CLASS SECONDS >              an error frame, in raw mode
    < stat RX_BYTES RX_FRAMES TX_BYTES TX_FRAMES >

Rules
-----
1. ID, bytes and masks are hexadecimal, all else is decimal.  An ID of eight digits is extended,
   whatever its value; a shorter one is standard.
2. What cannot be parsed is dropped without an answer, as the daemon does; ``take_trouble`` says
   what it was.  An unknown word gets ``< error unknown command >``.  The difference matters:
   python-can cannot parse an error that is not an error frame, and every ``recv`` after it fails.
3. With ``S US`` a subscription is throttled: no more often than that, the latest content last.
4. Jobs and subscriptions end with the BCM mode, the statistics with the control mode.
5. Messages may come cut up or joined.  What stands between them is dropped, as is one that is
   longer than ``MESSAGE_BYTES_MAX``.
6. A job that is late is not made up for: it goes out once and keeps its beat (Linux, ``bcm.c``).
   While ``JOB_BACKLOG_FRAMES`` of the session wait for the bus, jobs skip their turn.
7. What raw mode reports is held back, in order and with its times, for ``RAW_PAUSE_NS`` after the
   mode began or until the client's next message: python-can reads the answer to ``rawmode`` alone,
   and its constructor fails if a frame ends within the same read.

What clients must know
----------------------
- python-can 4.6 drops the remote flag: a remote frame of length 0 goes out as a data frame, a
  longer one as a ``send`` without its bytes, which rule 2 drops.  For remote frames use slcan.
- python-can needs an empty field behind the time of a frame without data: two spaces, as sent.
- ISO-TP mode, CAN FD and the beacon are not offered; nor is ``< BUS B ... >``: the bus has a rate.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, NamedTuple

from axistwin.kernel.time import NS_PER_MS, NS_PER_S, NS_PER_US, Nanos
from axistwin.ports.dialect import BusError, CanDialect, Out
from axistwin.wire.can_frame import DATA_BYTES_MAX, CanFrame

OK: Final = b"< ok >"

BUS_NAME_MAX: Final = 16
"""Characters in the name of a bus."""

_BUS_NAME: Final = re.compile(rf"[^\s<>]{{1,{BUS_NAME_MAX}}}")

MESSAGE_BYTES_MAX: Final = 8192
"""From ``<`` to ``>``; the longest message of use is a ``muxfilter`` of 257 times 8 bytes."""

JOBS_MAX: Final = 1024
"""Frames sent again and again, and as many identifiers subscribed to, per client."""

FILTERS_MAX: Final = 257
"""Groups of eight bytes in a ``muxfilter``, the mask of the multiplexer included."""

JOB_BACKLOG_FRAMES: Final = 10
"""As many as Linux queues for a CAN interface."""


RAW_PAUSE_NS: Final[Nanos] = 100 * NS_PER_MS

HELD_MAX: Final = 1000
"""Reports held back at most (rule 7); more end the pause."""


class Mode(Enum):
    """What the session does with frames."""

    NO_BUS = "no bus"
    BCM = "bcm"
    RAW = "raw"
    CONTROL = "control"


class _MalformedError(Exception):
    """A message that does not parse; within this module."""


class _Key(NamedTuple):
    """What jobs and subscriptions are filed under."""

    identifier: int
    is_extended: bool


@dataclass(slots=True)
class _Job:
    """A frame sent again and again; next_ns None: without a timer."""

    frame: CanFrame
    interval_ns: Nanos
    next_ns: Nanos | None


@dataclass(slots=True)
class _Subscription:
    """Which changes of an identifier's content a client wants to see (Linux, ``bcm.c``).

    filters: none: every frame; one: the bits that matter; more: the multiplexer's mask, then per
    value of the multiplexer that value together with the bits that matter.
    """

    filters: tuple[int, ...]
    throttle_ns: Nanos
    seen: dict[int, int] = field(default_factory=dict)  # by filter: the content last reported
    reported_ns: Nanos | None = None
    held: bytes | None = None

    def is_new(self, content: int) -> bool:
        """Whether a frame with ``content`` is to be reported; then it counts as reported."""
        if not self.filters:
            return True
        index = self._filter_for(content)
        if index is None:
            return False
        before = self.seen.get(index)
        if before is not None and not (before ^ content) & self.filters[index]:
            return False
        self.seen[index] = content
        return True

    def _filter_for(self, content: int) -> int | None:
        first, *others = self.filters
        if not others:
            return 0
        matches = (i for i, one in enumerate(others, 1) if not (one ^ content) & first)
        return next(matches, None)

    def due_ns(self) -> Nanos | None:
        """When what is held back may go out."""
        if self.held is None:
            return None
        assert self.reported_ns is not None
        return self.reported_ns + self.throttle_ns

    def throttled(self, line: bytes, time_ns: Nanos) -> bytes:
        """``line``, or nothing and it is held back."""
        if self.reported_ns is not None and time_ns < self.reported_ns + self.throttle_ns:
            self.held = line
            return b""
        self.reported_ns, self.held = time_ns, None
        return line


@dataclass(slots=True)
class _Tally:
    """How much went one way."""

    data_bytes: int = 0
    frames: int = 0

    def add(self, frame: CanFrame) -> None:
        self.data_bytes += len(frame.data)
        self.frames += 1

    def __str__(self) -> str:
        return f"{self.data_bytes} {self.frames}"


# ---- words ---------------------------------------------------------------------------------------

_DECIMAL: Final = re.compile(r"[0-9]{1,10}")
_IDENTIFIER: Final = re.compile(r"[0-9A-Fa-f]{1,8}")
_BYTE: Final = re.compile(r"[0-9A-Fa-f]{1,2}")
_BARE_SEND: Final = re.compile(r"send +[0-9A-Fa-f]{1,8} +[1-8]")


def _matched(pattern: re.Pattern[str], word: str) -> str:
    if not pattern.fullmatch(word):
        raise _MalformedError
    return word


def _decimal(word: str) -> int:
    return int(_matched(_DECIMAL, word))


def _key(word: str) -> _Key:
    """Eight digits are extended (rule 1)."""
    return _Key(int(_matched(_IDENTIFIER, word), 16), len(word) == 8)


def _bytes(words: Iterable[str]) -> bytes:
    return bytes(int(_matched(_BYTE, word), 16) for word in words)


def _counted(words: Sequence[str]) -> bytes:
    """``LENGTH BYTE...``."""
    data = _bytes(words[1:])
    if _decimal(words[0]) != len(data) or len(data) > DATA_BYTES_MAX:
        raise _MalformedError
    return data


def _frame(key: _Key, data: bytes, length: int = -1, *, is_remote: bool = False) -> CanFrame:
    try:
        return CanFrame(key.identifier, data, key.is_extended, is_remote, length)
    except ValueError as error:
        raise _MalformedError from error


def _interval_ns(words: Sequence[str]) -> Nanos:
    """``S US``."""
    return _decimal(words[0]) * NS_PER_S + _decimal(words[1]) * NS_PER_US


def _content(data: bytes) -> int:
    return int.from_bytes(data.ljust(DATA_BYTES_MAX, b"\0"), "big")


def _shown(frame: CanFrame) -> str:
    return f"{frame.identifier:08X}" if frame.is_extended else f"{frame.identifier:03X}"


def _seconds(time_ns: Nanos) -> str:
    seconds, rest_ns = divmod(time_ns, NS_PER_S)
    return f"{seconds}.{rest_ns // NS_PER_US:06d}"


def raw_line(frame: CanFrame, time_ns: Nanos) -> bytes:
    """``frame`` as raw mode reports it."""
    if frame.is_remote:
        return f"< rtr {_shown(frame)} {_seconds(time_ns)} {frame.length} >".encode()
    return f"< frame {_shown(frame)} {_seconds(time_ns)} {frame.data.hex().upper()} >".encode()


def bcm_line(frame: CanFrame, time_ns: Nanos) -> bytes:
    """``frame`` as BCM mode reports it: as raw mode, but with a space behind each byte."""
    data = "".join(f"{byte:02X} " for byte in frame.data)
    return f"< frame {_shown(frame)} {_seconds(time_ns)} {data} >".encode()


# ---- the session ---------------------------------------------------------------------------------


class SocketcandSession(CanDialect):
    """One client of the daemon.

    buses: the names under which the one bus may be opened, each of 1..``BUS_NAME_MAX`` characters
    without spaces.
    """

    def __init__(self, buses: Sequence[str]) -> None:
        assert buses
        assert all(_BUS_NAME.fullmatch(name) for name in buses), buses
        super().__init__()
        self.mode = Mode.NO_BUS
        self._buses = tuple(buses)
        self._unparsed = b""
        self._jobs: dict[_Key, _Job] = {}
        self._subscriptions: dict[_Key, _Subscription] = {}
        self._received = _Tally()
        self._sent = _Tally()
        self._statistics_ns: Nanos = 0  # the interval; 0: none wanted
        self._statistics_due_ns: Nanos | None = None
        self._pause_ends_ns: Nanos | None = None  # rule 7
        self._held: list[bytes] = []

    def greeting(self) -> bytes:
        """Sent before anything else."""
        return b"< hi >"

    def receive(self, data: bytes, now_ns: Nanos) -> list[Out]:
        """Perform the complete messages in what came so far; timers count from ``now_ns``."""
        *messages, rest = (self._unparsed + data).split(b">")
        outs: list[Out] = []
        for message in messages:
            _, mark, inner = message.partition(b"<")
            if mark and not self.is_closing:
                outs += self._end_pause()
                outs += self._perform(inner, now_ns)
        _, mark, inner = rest.partition(b"<")
        # One byte more than is allowed is enough to know that it is too long.
        self._unparsed = mark + inner[:MESSAGE_BYTES_MAX]
        self._note_sent(outs)
        return outs

    def deliver(self, frame: CanFrame, time_ns: Nanos) -> bytes:
        """The message about a frame on the bus, if the client wants it."""
        self._received.add(frame)
        if self.mode is Mode.RAW:
            return self._report(raw_line(frame, time_ns))
        subscription = self._subscriptions.get(_Key(frame.identifier, frame.is_extended))
        if subscription is None or frame.is_remote or not subscription.is_new(_content(frame.data)):
            return b""
        return subscription.throttled(bcm_line(frame, time_ns), time_ns)

    def deliver_error(self, error: BusError, time_ns: Nanos) -> bytes:
        """The message about an error, in raw mode."""
        if self.mode is not Mode.RAW:
            return b""
        return self._report(f"< error {error:03X} {_seconds(time_ns)} >".encode())

    def _report(self, line: bytes) -> bytes:
        """``line`` in raw mode, now or when the pause is over (rule 7)."""
        if self._pause_ends_ns is None:
            return line
        self._held.append(line)
        return b"".join(self._end_pause()) if len(self._held) > HELD_MAX else b""

    def _end_pause(self) -> list[bytes]:
        """What was held back."""
        self._pause_ends_ns = None
        held, self._held = self._held, []
        return held

    def next_event(self) -> Nanos | None:
        """When a job, what is held back or the statistics are due."""
        times = [job.next_ns for job in self._jobs.values()]
        times += [one.due_ns() for one in self._subscriptions.values()]
        times += [self._statistics_due_ns, self._pause_ends_ns]
        return min((time for time in times if time is not None), default=None)

    def wake(self, now_ns: Nanos) -> list[Out]:
        """What is due by ``now_ns``."""
        outs: list[Out] = []
        for job in self._jobs.values():
            if job.next_ns is not None and job.next_ns <= now_ns:
                if self._on_the_way + len(outs) < JOB_BACKLOG_FRAMES:
                    outs.append(job.frame)
                late = (now_ns - job.next_ns) // job.interval_ns
                job.next_ns += (late + 1) * job.interval_ns
        for one in self._subscriptions.values():
            due_ns = one.due_ns()
            if due_ns is not None and due_ns <= now_ns:
                assert one.held is not None
                outs.append(one.held)
                one.reported_ns, one.held = now_ns, None
        if self._pause_ends_ns is not None and self._pause_ends_ns <= now_ns:
            outs += self._end_pause()
        self._note_sent(outs)
        if self._statistics_due_ns is not None and self._statistics_due_ns <= now_ns:
            outs.append(f"< stat {self._received} {self._sent} >".encode())
            self._statistics_due_ns = now_ns + self._statistics_ns
        return outs

    def _note_sent(self, outs: Iterable[Out]) -> None:
        for out in outs:
            if isinstance(out, CanFrame):
                self._sent.add(out)
                self._on_the_way += 1

    # -- messages --

    def _perform(self, message: bytes, now_ns: Nanos) -> list[Out]:
        words = message.decode("ascii", "replace").split()
        if not words or len(message) >= MESSAGE_BYTES_MAX:
            return self._dropped(message)
        known = MESSAGES.get(words[0])
        if known is None or self.mode not in known.modes:
            return [b"< error unknown command >"]
        if len(words) - 1 not in known.arguments:
            return self._dropped(message)
        try:
            return known.perform(self, words, now_ns)
        except _MalformedError:
            return self._dropped(message)

    def _dropped(self, message: bytes) -> list[Out]:
        shown = message[:60].decode("ascii", "backslashreplace").strip()
        self._trouble = f"dropped what the socketcand client sent: < {shown} > does not parse"
        if _BARE_SEND.fullmatch(shown):
            self._trouble += " (python-can sends remote frames so: use slcan for them)"
        return []

    def _open(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        if words[1] not in self._buses:
            self.is_closing = True
            names = ", ".join(self._buses)
            self._trouble = f"a socketcand client asked for the bus {words[1][:BUS_NAME_MAX]!r}: "
            self._trouble += f"it has to open {names}"
            return [f"< error could not open bus, this server has {names} >".encode()]
        self.mode = Mode.BCM
        return [OK]

    def _switch(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        mode = _MODES[words[0]]
        if mode is not self.mode:
            self._jobs.clear()
            self._subscriptions.clear()
            self._statistics_due_ns = None
            self.mode = mode
        if mode is Mode.RAW:
            self._pause_ends_ns = now_ns + RAW_PAUSE_NS
        return [OK]

    def _echo(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        return [b"< echo >"]

    def _send(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        return [_frame(_key(words[1]), _counted(words[2:]))]

    def _send_remote(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        return [_frame(_key(words[1]), b"", _decimal(words[2]), is_remote=True)]

    def _add(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        interval_ns, key = _interval_ns(words[1:3]), _key(words[3])
        frame = _frame(key, _counted(words[4:]))
        if key not in self._jobs and len(self._jobs) >= JOBS_MAX:
            return self._full("jobs")
        self._jobs[key] = _Job(frame, interval_ns, now_ns + interval_ns if interval_ns else None)
        return [frame]

    def _update(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        key = _key(words[1])
        frame = _frame(key, _counted(words[2:]))
        job = self._jobs.get(key)
        if job is not None:
            job.frame = frame
        return []

    def _delete(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        self._jobs.pop(_key(words[1]), None)
        return []

    def _subscribe(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        return self._want(words, ())

    def _filter(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        return self._want(words, (_content(_counted(words[4:])),))

    def _mux_filter(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        count, data = _decimal(words[4]), _bytes(words[5:])
        if not 2 <= count <= FILTERS_MAX or len(data) != count * DATA_BYTES_MAX:
            raise _MalformedError
        groups = range(0, len(data), DATA_BYTES_MAX)
        return self._want(words, tuple(_content(data[i : i + DATA_BYTES_MAX]) for i in groups))

    def _want(self, words: Sequence[str], filters: tuple[int, ...]) -> list[Out]:
        throttle_ns, key = _interval_ns(words[1:3]), _key(words[3])
        if key not in self._subscriptions and len(self._subscriptions) >= JOBS_MAX:
            return self._full("subscriptions")
        self._subscriptions[key] = _Subscription(filters, throttle_ns)
        return []

    def _full(self, what: str) -> list[Out]:
        self._trouble = (
            f"a socketcand client has {JOBS_MAX} {what}, no more fit: it has to end some"
        )
        return []

    def _unsubscribe(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        self._subscriptions.pop(_key(words[1]), None)
        return []

    def _statistics(self, words: Sequence[str], now_ns: Nanos) -> list[Out]:
        self._statistics_ns = _decimal(words[1]) * NS_PER_MS
        self._statistics_due_ns = now_ns + self._statistics_ns if self._statistics_ns else None
        return []


# ---- the messages --------------------------------------------------------------------------------

_MODES: Final = {"rawmode": Mode.RAW, "bcmmode": Mode.BCM, "controlmode": Mode.CONTROL}

_NO_BUS: Final = frozenset({Mode.NO_BUS})
_ON_BUS: Final = frozenset(Mode) - _NO_BUS
_BCM: Final = frozenset({Mode.BCM})
_SENDING: Final = frozenset({Mode.BCM, Mode.RAW})
_CONTROL: Final = frozenset({Mode.CONTROL})


class _Message(NamedTuple):
    """In which modes, with how many arguments, what happens."""

    modes: frozenset[Mode]
    arguments: range
    perform: Callable[[SocketcandSession, Sequence[str], Nanos], list[Out]]


def _from_to(least: int, most: int | None = None) -> range:
    return range(least, (least if most is None else most) + 1)


_BYTES: Final = DATA_BYTES_MAX
_MUX_MOST: Final = 4 + FILTERS_MAX * DATA_BYTES_MAX

MESSAGES: Final[dict[str, _Message]] = {
    "open": _Message(_NO_BUS, _from_to(1), SocketcandSession._open),
    "rawmode": _Message(_ON_BUS, _from_to(0), SocketcandSession._switch),
    "bcmmode": _Message(_ON_BUS, _from_to(0), SocketcandSession._switch),
    "controlmode": _Message(_ON_BUS, _from_to(0), SocketcandSession._switch),
    "echo": _Message(_ON_BUS, _from_to(0), SocketcandSession._echo),
    "send": _Message(_SENDING, _from_to(2, 2 + _BYTES), SocketcandSession._send),
    "sendrtr": _Message(_SENDING, _from_to(2), SocketcandSession._send_remote),
    "add": _Message(_BCM, _from_to(4, 4 + _BYTES), SocketcandSession._add),
    "update": _Message(_BCM, _from_to(2, 2 + _BYTES), SocketcandSession._update),
    "delete": _Message(_BCM, _from_to(1), SocketcandSession._delete),
    "subscribe": _Message(_BCM, _from_to(3), SocketcandSession._subscribe),
    "filter": _Message(_BCM, _from_to(4, 4 + _BYTES), SocketcandSession._filter),
    "muxfilter": _Message(_BCM, _from_to(4, _MUX_MOST), SocketcandSession._mux_filter),
    "unsubscribe": _Message(_BCM, _from_to(1), SocketcandSession._unsubscribe),
    "statistics": _Message(_CONTROL, _from_to(1), SocketcandSession._statistics),
}
