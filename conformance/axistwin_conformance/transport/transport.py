"""What every way from the suite to a device has, whatever it carries: transcript, clock, measured
round trip, gate, travel guard and meter, and one word for trouble.

Sources.  Behind a `Transport` stands a source: a serial port, a bus.  If it tells a time of its own
(`virtual_time_ns`), that is the clock, exact, and time passes only while we wait; else the clock is
the machine's monotonic one.  What is measured on it is known to `uncertainty_ns`: an instant that
the device fixes while it handles an exchange lies between our first byte and its last, so that the
slowest exchange seen on the idle line bounds it.

Late.  A busy host, or a network, holds one exchange up for longer than any other took.  What then
looks like a device's fault, may be none: such moments are noted (`late`), and whoever judges
repeats what had one (`noise`).

Bytes.  Gate, travel guard, meter and transcript take bytes; the family knows what they mean.

Trouble.  A source that is closed, vanished or stuck raises `TargetError`, nothing else.  A twin in
this process may also fall over a mistake of its own: whatever comes out of its source and is no
trouble of a source is `TwinCrashed`, and from then on nothing goes to it or comes from it.
"""

from __future__ import annotations

import contextlib
import statistics
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, cast

from axistwin_conformance.base.errors import OutsideEnvelope, TargetError, TwinCrashed
from axistwin_conformance.base.transcript import Direction, Record, Transcript
from axistwin_conformance.transport.lateness import Lateness

LATEST = 8  # records: among them is what came during a wait, if anything did
SILENCE_NOTED_S = 0.05  # shorter waits in vain are not worth a line in the transcript
HELD_NS = 100_000_000  # of silence, after which nothing belongs to what has come any more
LONGEST_NS = 500_000_000  # that the rest of what is held back may take beyond a time-out
STOP_HEARD_NS = 50_000_000  # the reply to a stop takes 3 ms at 9600 baud
MOST_PAUSES = 20  # a device that never stops talking is not waited for
USUAL_WAY_NS = 25_000_000  # half of the shortest time for which a silence is listened to
SLOWEST_JUDGED_NS = 200_000_000  # an exchange: the checks know how to wait for one of that length
MOST_IN_VAIN_NS = 120_000_000_000  # for which exchanges that all fail are timed
TWIN_PREFIX = "axistwin:"  # what opens a twin in this process, on a line or on a bus


def is_twin_url(url: str) -> bool:
    """True if what this opens is a twin made for the run: nothing can be harmed."""
    return url.startswith(TWIN_PREFIX)


class TravelLimiter(Protocol):
    """What keeps the axes behind a carrier inside the envelope; it hears everything, either way.

    `runaway`: why nothing that moves is sent any more; `broken`: the requirement that the device
    has failed by that; both empty at first.
    """

    runaway: str
    broken: str

    @property
    def is_in_doubt(self) -> bool:
        """True if the next look at an axis decides on the last one."""

    def sending(self, data: bytes, now_ns: int, /) -> None:
        """Raise OutsideEnvelope if these bytes must not be sent."""

    def received(self, data: bytes, now_ns: int, /) -> None:
        """Learn from what the device says."""

    @property
    def deadline_ns(self) -> int | None:
        """When endless motion has to be stopped at the latest; None while there is none."""

    def stop(self) -> tuple[bytes, ...]:
        """The frames that end it."""

    def needed(self, wait_ns: int, /) -> int:
        """How large the envelope would have to be for endless motion to go on for so long."""

    def worked(
        self,
        name: str,
        window: tuple[int, int],
        disturbed: Collection[str] = (),
        number: int | None = None,
        /,
    ) -> None:
        """Learn what the rig has done, between which instants, which controls are not at rest now,
        and which it was of those of that name, if they have numbers."""


class Mender(Protocol):
    """What hands on the replies of a device as a sound one would have put them."""

    @property
    def is_holding(self) -> bool:
        """True if something has come and was not handed on yet."""

    def begin(self, request: bytes, /) -> None:
        """A request goes out."""

    def hear(self, data: bytes, /) -> bytes:
        """Something has come: return what can be handed on now."""

    def give_up(self) -> bytes:
        """Nothing more comes for now: return what was held back, as it came."""


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """How long exchanges take while nothing else is said, in ns.

    `own_ns`: what their bytes take on the line, where they do.
    """

    samples: int = 0
    median_ns: int = 0
    max_ns: int = 0
    own_ns: int = 0

    @property
    def way_ns(self) -> int:
        """The most that is not the time of the bytes: the device's, and the way there and back."""
        return max(0, self.max_ns - self.own_ns)


class Transport(ABC):
    """A way to a device.  Not thread-safe: one run, one carrier."""

    source_word: ClassVar[str] = "it"  # what the source is called in messages
    word: ClassVar[str] = "line"  # and what the modules behind it share

    def __init__(
        self,
        source: object,
        description: str,
        *,
        is_builtin: bool = False,
        is_lossless: bool | None = None,
        transcript: Transcript | None = None,
    ) -> None:
        self._source = source
        self._clock_ns: int | None = None  # in virtual time, if known while nothing lets it pass
        self.description = description
        self.is_builtin = is_builtin
        self.is_virtual = getattr(source, "virtual_time_ns", None) is not None
        # In virtual time there is no noise, unless somebody puts it there.
        self.is_lossless = self.is_virtual if is_lossless is None else is_lossless
        self.transcript = Transcript() if transcript is None else transcript
        self.round_trip = RoundTrip()
        self.last_sent = b""
        self.gate: Callable[[bytes], None] | None = None  # sees everything before it is sent
        self.travel_guard: TravelLimiter | None = None
        self.meter: Callable[[bytes], None] | None = None  # counts what is really sent
        self.mender: Mender | None = None  # of a device whose replies depart by what is judged
        self._held_ns = 0  # when the last came of what it holds back
        self.crash = ""  # of the twin behind it, once it has fallen over
        self.lateness = Lateness(self.mark, self.word, lambda: self.is_lossless)

    # --- what a kind of carrier adds --------------------------------------------------------------

    @property
    @abstractmethod
    def rate(self) -> int | None:
        """Bits per second at our end; None where that is not ours to know."""

    @abstractmethod
    def drain(self) -> object:
        """Throw away what has arrived unasked and return it, for the record."""

    @abstractmethod
    def wait(self, seconds: float) -> float:
        """Let time pass, keep what arrives; return the seconds that really passed."""

    @abstractmethod
    def close(self) -> None:
        """Give the source back; one that is gone already is fine."""

    @abstractmethod
    def _stop_by(self, data: bytes) -> None:
        """Send what ends endless motion, and listen for `STOP_HEARD_NS` at most."""

    @abstractmethod
    def _has_heard(self, seconds: float) -> bool:
        """Set aside what comes; True if anything came within that time."""

    @abstractmethod
    def _source_trouble(self, doing: str, error: Exception) -> TargetError | None:
        """What the source's own exceptions mean; None for what is none of them."""

    # --- clock ------------------------------------------------------------------------------------

    @property
    def now_ns(self) -> int:
        """The carrier's clock, ns from an arbitrary origin."""
        if not self.is_virtual:
            return time.monotonic_ns()
        if self._clock_ns is not None:
            return self._clock_ns
        try:
            return cast(int, self._source.virtual_time_ns)  # type: ignore[attr-defined]
        except Exception as error:
            raise self._trouble("asking the time", error) from error

    @property
    def is_direct(self) -> bool:
        """True if there is a shorter way of an exchange.  Not on a bus: what it carries besides the
        reply is heard too."""
        return False

    @property
    def uncertainty_ns(self) -> int:
        """How well the instant of something inside one exchange is known (see above)."""
        return self.round_trip.max_ns

    def measure_round_trip(self, exchange: Callable[[], bool], samples: int) -> RoundTrip:
        """Time `exchange` while nothing else is said; only the ones that succeed count.  Where none
        does, that ends after `MOST_IN_VAIN_NS`."""
        taken: list[int] = []
        own: list[int] = []
        begun_ns = self.now_ns
        for _ in range(samples):
            if not taken and self.now_ns - begun_ns > MOST_IN_VAIN_NS:
                break
            self.lateness.forget()
            started_ns, position = self.now_ns, self.transcript.position
            if exchange() and not (self.lateness.recent and taken):
                taken.append(self.now_ns - started_ns)
                own.append(self._own_ns(self.transcript.since(position)))
        if taken:
            median_ns = round(statistics.median(taken))
            self.round_trip = RoundTrip(len(taken), median_ns, max(taken), min(own))
        return self.round_trip

    # --- what is shared by all that is sent and awaited -------------------------------------------

    @property
    def twins(self) -> Sequence[Any]:
        """The handles of the twins behind the source; none behind a real one."""
        return cast(Sequence[Any], getattr(self._source, "twins", ()))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a reader should know of what happened here beside the exchanges."""
        return self.lateness.remarks

    def _own_ns(self, said: Sequence[Record]) -> int:
        """What it takes on the way itself to say that; 0 where that is not known."""
        return 0

    @property
    def line_ns(self) -> int:
        """What has to be added to the time for which nothing or something must come: the way there
        and back, and how long this device takes to reply.  In virtual time everything is exact, and
        only a device counts that takes longer than those times allow for."""
        if not self.is_virtual:
            return self.uncertainty_ns
        return max(0, self.round_trip.way_ns - USUAL_WAY_NS)

    @property
    def line_s(self) -> float:
        """The same in seconds."""
        return self.line_ns / 1e9

    @property
    def too_slow(self) -> str:
        """Why nothing can be held against a device behind this; empty if it can."""
        if self.is_virtual or self.uncertainty_ns <= SLOWEST_JUDGED_NS:
            return ""
        slowest, most = (ns // 1_000_000 for ns in (self.uncertainty_ns, SLOWEST_JUDGED_NS))
        return f"an exchange takes up to {slowest} ms here, too long to tell; {most} ms would do"

    def mark(self, text: str) -> None:
        """Write a line into the transcript."""
        self.transcript.note(self.now_ns, Direction.NOTE, text=text)

    def wait_until_quiet(self, seconds: float) -> None:
        """Set aside what comes until nothing has come for so long: a late reply must not be taken
        for the next one."""
        for _ in range(MOST_PAUSES):
            if not self._has_heard(seconds):
                break

    def _announced(self, data: bytes) -> int:
        """Show gate, travel guard, meter and transcript what is about to be sent; return the time.

        Raises what they raise, and then nothing must be sent.
        """
        if self.gate is not None:
            self.gate(data)
        started_ns = self.now_ns
        if self.travel_guard is not None:
            self.travel_guard.sending(data, started_ns)
        if self.meter is not None:
            self.meter(data)
        if self.mender is not None:
            self.mender.begin(data)
        self.last_sent = data
        self.lateness.sent()
        self._clock_ns = None
        self.transcript.note(started_ns, Direction.HOST, data)
        return started_ns

    def _arrived(self, data: bytes) -> tuple[bytes, int]:
        """Let transcript, mender and travel guard see what has come; return what of it is handed
        on, and the time."""
        now_ns = self.now_ns
        self.transcript.note(now_ns, Direction.DEVICE, data)
        if self.mender is not None:
            data, self._held_ns = self.mender.hear(data), now_ns
        if self.travel_guard is not None and data:
            self.travel_guard.received(data, now_ns)
        return data, now_ns

    @property
    def is_holding(self) -> bool:
        """True if something has come of which the mender waits for the rest."""
        return self.mender is not None and self.mender.is_holding

    def _until_ns(self, deadline_ns: int) -> int:
        """Until when is listened: what is held back is complete by then, or handed on as it is."""
        if not self.is_holding:
            return deadline_ns
        return min(self._held_ns + HELD_NS, deadline_ns + LONGEST_NS)

    def _given_up(self) -> bytes:
        """What the mender holds back, as it came."""
        data = b"" if self.mender is None else self.mender.give_up()
        if self.travel_guard is not None and data:
            self.travel_guard.received(data, self.now_ns)
        return data

    def _note_silence(self, started_ns: int) -> None:
        passed_ms = (self.now_ns - started_ns) / 1e6
        others = self.transcript.since(max(0, self.transcript.position - LATEST))
        is_alone = all(one.time_ns <= started_ns for one in others if one.data)
        waited = f"{passed_ms:.0f} ms"
        text = (
            f"nothing for {waited}"
            if is_alone
            else f"for {waited} from here: what was due did not come"
        )
        self.transcript.note(started_ns, Direction.SILENCE, text=text)

    def _within_travel(self, left_ns: int) -> int:
        """How long may be waited; stops endless motion that nobody has stopped in time."""
        deadline_ns = None if self.travel_guard is None else self.travel_guard.deadline_ns
        if self.travel_guard is None or deadline_ns is None:
            return left_ns
        spare_ns = deadline_ns - self.now_ns
        if spare_ns > 0:
            return min(left_ns, spare_ns)
        self.mark("endless motion has come near the edge of the envelope: stopped")
        needed = self.travel_guard.needed(left_ns)
        gate, self.gate = self.gate, None  # a stop is not held back
        try:
            for data in self.travel_guard.stop():
                self._stop_by(data)
        finally:
            self.gate = gate
        if gate is None:  # between checks there is no one to tell; until heard it is sent again
            return min(left_ns, STOP_HEARD_NS)
        raise OutsideEnvelope(
            "endless motion had come near the edge of the envelope", "--max-travel", needed
        )

    # --- trouble ----------------------------------------------------------------------------------

    def _refuse_the_dead(self) -> None:
        """Raise TwinCrashed if the twin has crashed: nobody knows what is left of it."""
        if self.crash:
            raise TwinCrashed(self.crash)

    @contextlib.contextmanager
    def _told(self, doing: str) -> Iterator[None]:
        """Turn whatever the source raises into a TargetError."""
        self._refuse_the_dead()
        try:
            yield
        except Exception as error:
            raise self._trouble(doing, error) from error

    def _trouble(self, doing: str, error: Exception) -> TargetError:
        """What the source has raised, as a TargetError that says what was being done."""
        known = self._source_trouble(doing, error)
        if known is not None:
            return known
        if self.is_virtual or hasattr(self._source, "twins"):
            self.crash = self.crash or crash_of(error)
            return TwinCrashed(self.crash)
        words = " ".join(str(error).split()) or type(error).__name__
        # pyserial's own ports fall over a file descriptor that somebody else has closed.
        return TargetError(f"{self.source_word} was closed while {doing}: {words}")


def crash_of(error: Exception) -> str:
    """What a twin fell over, in a line: the exception and the place where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    text = " ".join(str(error).split())
    return f"the built-in twin crashed: {type(error).__name__}: {text}{place}"
