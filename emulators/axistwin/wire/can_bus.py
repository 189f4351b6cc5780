"""A CAN bus: several stations, one order for all, errors and their counters, in closed form.

    station 0  |601#40..|IFS|                        601#..    offered meanwhile, waits
    station 1               |581#42..|IFS|
    bus        |<- frame -->|<- frame --->|
               start        end: every other station hears it, the sender learns that it was sent

Rules
-----
1. A station sends what it was offered in that order.  A frame begins when the bus has been idle for
   the intermission (or at its own ready time, if that is later); all frames ready by then compete,
   the lowest arbitration field wins, the others stay and become listeners.
2. A frame is heard by all other stations that were there when it began, at the end of its EOF.
3. Equal arbitration fields go on together.  Equal frames succeed together and are heard once.  At
   the first bit that differs, the stations that send recessive have a bit error.  If one of them is
   error-active its flag destroys the frame for all; if they are all error-passive they only drop
   out, and the rest goes on.
4. Without anybody to acknowledge it a frame is an error, and tried again without end.  An
   error-passive sender does not count that error: alone, a station never goes bus-off.  Nor does a
   station acknowledge that only listens (``set_acknowledging``).
5. Errors add 8 to the transmit counter, success takes 1 off; listeners count 1 either way.  Above
   127 a station is error-passive: its flags are recessive, and after sending it waits 8 bits
   longer.  Above 255 it is off until it has seen 128 times 11 recessive bits; then it starts anew.
6. What repeats itself without change is not stepped through: a bus on which nobody acknowledges
   sleeps until somebody comes, goes or begins to acknowledge, and the time of the attempt then
   under way is computed.
7. A station whose passive flag ends after the others' counts as back when the next frame begins.
8. Without a bit rate frames take no time; rules 1 to 7 hold all the same, in the order of bits.
9. A disturbance may destroy a frame behind its control field, which all count as an error; or hold
   the bus dominant: a frame under way fails once, and nobody begins before it is over.

Bit positions of a destroyed frame: the flag of the station that sees the error at bit p covers
p+1..p+6.  If k dominant bits stood on the bus up to and including p, listeners see the sixth at
p+6-k and their flags end at p+12-k; a sender whose next recessive bit is q ends its own at q+6.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, Literal, NamedTuple, TypeAlias

from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.wire.can_frame import (
    INTERMISSION_BITS,
    CanFrame,
    arbitration_key,
    stuffed_bits,
    wire_bits,
)

FLAG_BITS: Final = 6
DELIMITER_BITS: Final = 8
SUSPEND_BITS: Final = 8
"""What an error-passive station waits beyond the intermission after it has sent."""

DESTROYED_BITS: Final = 20 + 2 * FLAG_BITS + DELIMITER_BITS
"""Of a frame that a disturbance destroys behind its control field, its error frame included."""

DESTROYED_NS: Final[Nanos] = 100_000
"""What it takes on a bus without a bit rate, where its repetitions would else never end."""

BITS_AFTER_ACK: Final = 8
"""ACK delimiter and end of frame."""

IDLE_BITS: Final = 11
OFF_SEQUENCES: Final = 128
"""Times 11 recessive bits that a station has to see to leave bus-off."""

ERROR_STEP: Final = 8
PASSIVE_ABOVE: Final = 127
OFF_ABOVE: Final = 255
RECEIVED_AGAIN: Final = 119
"""Receive counter of a passive station after a good frame."""

_PASSIVE_TAIL_BITS: Final = 2 + FLAG_BITS + DELIMITER_BITS
"""Recessive end of a frame that nobody acknowledged to a passive station: from the CRC's end on."""

_PASSIVE_SEQUENCES: Final = (_PASSIVE_TAIL_BITS + INTERMISSION_BITS + SUSPEND_BITS) // IDLE_BITS

ControllerState: TypeAlias = Literal["active", "passive", "off"]


class Heard(NamedTuple):
    """``frame`` was complete at ``end_ns``: sent by ``senders``, heard by ``listeners``."""

    end_ns: Nanos
    frame: CanFrame
    senders: tuple[int, ...]
    listeners: tuple[int, ...]


class Fault(NamedTuple):
    """A frame of ``senders`` failed; the error frame was over at ``end_ns``.

    kind: ``bit`` (another station sent the same arbitration field, or there was a disturbance),
    ``ack`` (nobody acknowledged), ``stuff`` (its sender left the bus).
    """

    end_ns: Nanos
    kind: Literal["bit", "ack", "stuff"]
    senders: tuple[int, ...]


class Change(NamedTuple):
    """The controller of ``station`` is in another ``state`` from ``time_ns`` on."""

    time_ns: Nanos
    station: int
    state: ControllerState


Happening: TypeAlias = Heard | Fault | Change


class _Station:
    """One controller: what it still has to send, and its error counters."""

    __slots__ = (
        *("aborts", "acknowledges", "hold_bits", "number", "off_left"),
        *("queue", "rec", "since_ns", "tec"),
    )

    def __init__(self, number: int, since_ns: Nanos) -> None:
        self.number = number
        self.since_ns = since_ns  # it sends nothing before
        self.queue: deque[tuple[CanFrame, Nanos, int]] = deque()  # its key the last
        self.tec = self.rec = 0
        self.hold_bits = 0  # after the intermission (rule 5)
        self.off_left = 0  # sequences of recessive bits to go, 0 when not off
        self.aborts = False  # what it is sending is not tried again
        self.acknowledges = True

    @property
    def state(self) -> ControllerState:
        if self.off_left:
            return "off"
        is_passive = self.tec > PASSIVE_ABOVE or self.rec > PASSIVE_ABOVE
        return "passive" if is_passive else "active"


class _Attempt:
    """A frame under way, and how it will end."""

    __slots__ = ("dropped", "end_ns", "fault", "frame", "group", "listeners", "start_ns")

    def __init__(self, start_ns: Nanos, group: list[_Station]) -> None:
        self.start_ns = self.end_ns = start_ns
        self.group = group
        self.frame = group[0].queue[0][0]
        self.dropped: list[_Station] = []
        self.listeners: list[_Station] = []
        self.fault: Literal["bit", "ack", "stuff"] | None = None

    @property
    def is_acknowledged(self) -> bool:
        """Whether one of the listeners acknowledges."""
        return any(station.acknowledges for station in self.listeners)


class CanBus:
    """The wire and the controllers of all its stations.

    bitrate: bits per second, > 0, or None for frames that take no time.
    is_destroyed: asked of each frame that would succeed, with its start and its first sender: true
    has an error frame destroy it (rule 9).
    """

    def __init__(
        self,
        bitrate: int | None,
        now_ns: Nanos = 0,
        *,
        is_destroyed: Callable[[Nanos, CanFrame, int], bool] = lambda now, frame, sender: False,
    ) -> None:
        assert bitrate is None or bitrate > 0
        self._is_destroyed = is_destroyed
        self.bitrate = bitrate
        self.now_ns = now_ns
        self._stations: dict[int, _Station] = {}
        self._pending: dict[int, _Station] = {}  # those with something to send
        self._held: list[_Station] = []  # those with hold_bits
        self._off: list[_Station] = []
        self._changes: list[Change] = []
        self._next_number = 0
        self._attempt: _Attempt | None = None
        self._idle_ns = now_ns  # when the intermission is over
        self._recessive_ns = now_ns  # since when the bus is recessive, while nobody sends
        # When the first station may begin, while nothing has happened that could change it.
        self._start: tuple[Nanos, int] | None = None
        self._knows_start = True
        # Rule 6: an attempt that repeats itself, and after how long.
        self._endless: _Attempt | None = None
        self._period_ns: Nanos = 0

    def span_ns(self, bits: int) -> Nanos:
        """Time that ``bits`` take, rounded down to a nanosecond."""
        return 0 if self.bitrate is None else bits * NS_PER_S // self.bitrate

    # ---- stations --------------------------------------------------------------------------------

    def attach(self, now: Nanos) -> int:
        """Put a station on the bus; its number.  It hears frames that begin from ``now`` on."""
        number = self._next_number
        self._next_number += 1
        self.join(number, now)
        return number

    def join(self, number: int, now: Nanos) -> None:
        """Put the station that has left back on the bus, its controller as new."""
        assert number not in self._stations, f"station {number} is on the bus"
        assert number < self._next_number, f"there is no station {number}"
        self._wake_up(now)
        self._stations[number] = _Station(number, now)

    def leave(self, number: int, now: Nanos) -> None:
        """Take a station off the bus: it loses its power or its port.  What it sends breaks off."""
        self._wake_up(now)
        station = self._stations.pop(number)
        self._pending.pop(number, None)
        if station in self._off:
            self._off.remove(station)
        attempt = self._attempt
        if attempt is None:
            return
        for stations in (attempt.listeners, attempt.dropped):
            if station in stations:
                stations.remove(station)
        if station in attempt.group:
            attempt.group.remove(station)
            if not attempt.group:
                attempt.fault = "stuff"
                attempt.end_ns = now + self.span_ns(2 * FLAG_BITS + DELIMITER_BITS)
        self._look_for_acknowledgement(attempt)

    def set_acknowledging(self, number: int, now: Nanos, *, acknowledges: bool) -> None:
        """Whether the station acknowledges the frames of others, as all do at first (rule 4)."""
        self._wake_up(now)
        self._stations[number].acknowledges = acknowledges
        if self._attempt is not None:
            self._look_for_acknowledgement(self._attempt)

    def _look_for_acknowledgement(self, attempt: _Attempt) -> None:
        """The last one that would have acknowledged the frame under way may be gone."""
        if attempt.fault is None and not attempt.is_acknowledged:
            attempt.fault = "ack"
            attempt.end_ns += self.span_ns(FLAG_BITS + DELIMITER_BITS - BITS_AFTER_ACK)

    def is_attached(self, number: int) -> bool:
        """Whether the station is on the bus."""
        return number in self._stations

    def offer(self, number: int, frame: CanFrame, ready_ns: Nanos) -> None:
        """Let a station send ``frame``, at ``ready_ns`` (not in the past) at the earliest."""
        station = self._pending[number] = self._stations[number]
        station.queue.append((frame, ready_ns, arbitration_key(frame)))
        self._knows_start = False

    def withdraw(self, number: int, now: Nanos) -> None:
        """Forget what a station still has to send; a frame under way is not tried again."""
        self._wake_up(now)
        station = self._stations[number]
        is_sending = self._attempt is not None and station in self._attempt.group
        station.aborts = is_sending
        while len(station.queue) > is_sending:
            station.queue.pop()
        self._drop_if_done(station)

    def _drop_if_done(self, station: _Station) -> None:
        if not station.queue:
            self._pending.pop(station.number, None)

    def backlog(self, number: int) -> int:
        """How many frames a station still has to send, one under way included."""
        return len(self._stations[number].queue)

    def state(self, number: int) -> ControllerState:
        """Error-active, error-passive, or off."""
        return self._stations[number].state

    def counters(self, number: int) -> tuple[int, int]:
        """Transmit and receive error counter."""
        station = self._stations[number]
        return station.tec, station.rec

    def hold_dominant(self, now: Nanos, until_ns: Nanos) -> None:
        """Hold the bus dominant from ``now`` on (rule 9)."""
        self._wake_up(now)
        self._recessive_ns = max(self._recessive_ns, until_ns)
        over_ns = self._recessive_ns + self.span_ns(DELIMITER_BITS)
        attempt = self._attempt
        if attempt is None:
            self._idle_ns = max(self._idle_ns, over_ns + self.span_ns(INTERMISSION_BITS))
        else:
            attempt.fault = attempt.fault if attempt.fault == "stuff" else "bit"
            attempt.end_ns = max(attempt.end_ns, over_ns)

    # ---- time ------------------------------------------------------------------------------------

    def next_event(self) -> Nanos | None:
        """When something happens next, or None while nothing will by itself."""
        if self._attempt is not None:
            return self._attempt.end_ns
        start = None if self._endless is not None else self._next_start()
        recovery = self._next_recovery() if self._off else None
        if start is None:
            return None if recovery is None else recovery[0]
        return start[0] if recovery is None else min(start[0], recovery[0])

    def run_next(self, limit: Nanos) -> list[Happening]:
        """Run until something is to be told that is due by ``limit``; nothing: all is done.

        Whoever drives the bus lets its stations react before the next call.
        """
        while (due := self.next_event()) is not None and due <= limit:
            self.now_ns = max(self.now_ns, due)
            if self._attempt is not None:
                return self._finish(self._attempt)
            if self._off:
                recovery = self._next_recovery()
                if recovery is not None and recovery[0] == due:
                    return [self._recover(*recovery)]
            self._begin(due)
        return []

    def run_until(self, now: Nanos) -> list[Happening]:
        """Run everything due by ``now``, with stations that do not react."""
        happened: list[Happening] = []
        while new := self.run_next(now):
            happened += new
        self.now_ns = max(self.now_ns, now)
        return happened

    # ---- a frame begins --------------------------------------------------------------------------

    def _earliest(self, station: _Station) -> tuple[Nanos, int]:
        """When a station may begin its next frame; the bits order what takes no time (rule 8)."""
        bits, ready_ns = station.hold_bits, station.queue[0][1]
        free_ns = self._idle_ns + self.span_ns(bits) if bits else self._idle_ns
        free_ns = max(free_ns, station.since_ns)
        if ready_ns > free_ns or self.bitrate is not None:
            return max(ready_ns, free_ns), 0
        return free_ns, bits

    def _next_start(self) -> tuple[Nanos, int] | None:
        """When the first of all stations may begin."""
        if self._knows_start:
            return self._start
        first = None
        for station in self._pending.values():
            if not station.off_left:
                start = self._earliest(station)
                if first is None or start < first:
                    first = start
        self._start, self._knows_start = first, True
        return first

    def _begin(self, start_ns: Nanos) -> None:
        """Arbitrate (rule 1), and find out how the frame will end."""
        first = self._next_start()
        assert first is not None
        group = list(self._pending.values())
        if len(group) > 1:
            ready = [
                station
                for station in group
                if not station.off_left and self._earliest(station) <= first
            ]
            key = min([station.queue[0][2] for station in ready])
            group = [station for station in ready if station.queue[0][2] == key]
        self._count_recessive(start_ns)
        attempt = _Attempt(start_ns, group)
        for station in self._held:
            station.hold_bits = 0
        self._held.clear()
        bits = self._go_on_together(attempt)
        attempt.listeners = self._listeners(attempt)
        attempt.frame = attempt.group[0].queue[0][0]
        is_disturbed = False
        if bits is not None:
            attempt.fault = "bit"
            bits = self._destroyed_bits(attempt, bits)
        elif is_disturbed := self._is_destroyed(start_ns, attempt.frame, attempt.group[0].number):
            attempt.fault, bits = "bit", DESTROYED_BITS
        elif attempt.is_acknowledged:
            bits = wire_bits(attempt.frame)
        else:
            attempt.fault = "ack"
            bits = wire_bits(attempt.frame) - BITS_AFTER_ACK + FLAG_BITS + DELIMITER_BITS
        attempt.end_ns = start_ns + self.span_ns(bits)
        if is_disturbed and self.bitrate is None:
            attempt.end_ns += DESTROYED_NS
        self._attempt = attempt

    def _listeners(self, attempt: _Attempt) -> list[_Station]:
        """All others that are there when the frame begins (rule 2)."""
        listeners = list(self._stations.values())
        for station in attempt.group + attempt.dropped:
            listeners.remove(station)
        if self._off:
            return [station for station in listeners if not station.off_left]
        return listeners

    def _go_on_together(self, attempt: _Attempt) -> int | None:
        """Rule 3: passive stations drop out of the group; the bit at which all fail, or None."""
        while len(attempt.group) > 1 and any(
            station.queue[0][0] != attempt.group[0].queue[0][0] for station in attempt.group
        ):
            streams = [stuffed_bits(station.queue[0][0]) for station in attempt.group]
            at = _first_difference(streams)
            losers = [
                station
                for station, stream in zip(attempt.group, streams, strict=True)
                if stream[at] == "1"
            ]
            if any(station.state == "active" for station in losers):
                return at
            attempt.dropped += losers
            attempt.group = [station for station in attempt.group if station not in losers]
        return None

    def _destroyed_bits(self, attempt: _Attempt, at: int) -> int:
        """From SOF to the end of the error delimiter, for a frame destroyed at bit ``at``."""
        last = at + FLAG_BITS  # of the flag of those who saw it first
        for station in attempt.group:
            stream = stuffed_bits(station.queue[0][0]) + "1"
            if stream[at] == "0":
                dominant = at + 1 - (stream.rfind("1", 0, at) + 1)
                if station.state == "active":
                    last = max(last, stream.index("1", at) + FLAG_BITS)
        if any(station.state == "active" for station in attempt.listeners):
            last = max(last, at + 2 * FLAG_BITS - dominant)
        return last + 1 + DELIMITER_BITS

    # ---- a frame ends ----------------------------------------------------------------------------

    def _finish(self, attempt: _Attempt) -> list[Happening]:
        """Count, tell, and try again what failed."""
        self._attempt = None
        self._knows_start = False
        end_ns = attempt.end_ns
        self._idle_ns = end_ns + self.span_ns(INTERMISSION_BITS)
        self._recessive_ns = end_ns - self.span_ns(DELIMITER_BITS)
        senders = tuple(station.number for station in attempt.group)
        happened: list[Happening] = []
        if attempt.fault is None:
            self._succeed(attempt)
            listeners = tuple([station.number for station in attempt.listeners])
            happened.append(Heard(end_ns, attempt.frame, senders, listeners))
        else:
            repeats = self._repeats_itself(attempt)
            self._fail(attempt)
            happened.append(Fault(end_ns, attempt.fault, senders))
            if repeats:
                self._endless = attempt
        happened += self._changes
        self._changes.clear()
        return happened

    def _succeed(self, attempt: _Attempt) -> None:
        end_ns = attempt.end_ns
        for station in attempt.group:
            station.queue.popleft()
            station.aborts = False
            self._drop_if_done(station)
            self._hold(station, SUSPEND_BITS if station.state == "passive" else 0)
            if station.tec:
                self._count(station, end_ns, station.tec - 1, station.rec)
        for station in attempt.listeners:
            if station.rec:
                is_passive = station.rec > PASSIVE_ABOVE
                rec = RECEIVED_AGAIN if is_passive else station.rec - 1
                self._count(station, end_ns, station.tec, rec)
        # Their flag ends two bits before EOF does; 8 bits of delimiter, 3 and 8 more follow it.
        self._drop_out(attempt, DELIMITER_BITS - 2 + SUSPEND_BITS)

    def _fail(self, attempt: _Attempt) -> None:
        end_ns = attempt.end_ns
        # A recessive flag of those who dropped out began two bits earlier.
        all_passive = all(station.state == "passive" for station in attempt.group)
        self._drop_out(attempt, SUSPEND_BITS - 2 if all_passive else SUSPEND_BITS)
        for station in attempt.group:
            if attempt.fault != "ack" or station.state == "active":
                self._count(station, end_ns, station.tec + ERROR_STEP, station.rec)
            self._hold(station, SUSPEND_BITS if station.state == "passive" else 0)
            if station.aborts:
                station.queue.popleft()
                station.aborts = False
                self._drop_if_done(station)
        for station in attempt.listeners:
            self._count(station, end_ns, station.tec, min(station.rec + 1, OFF_ABOVE))

    def _drop_out(self, attempt: _Attempt, hold_bits: int) -> None:
        for station in attempt.dropped:
            self._count(station, attempt.end_ns, station.tec + ERROR_STEP, station.rec)
            self._hold(station, hold_bits)

    def _hold(self, station: _Station, bits: int) -> None:
        station.hold_bits = bits
        if bits:
            self._held.append(station)

    def _count(self, station: _Station, now: Nanos, tec: int, rec: int) -> None:
        """Set the counters (rule 5), and tell what becomes of it."""
        before = station.state
        station.tec, station.rec = tec, rec
        if tec > OFF_ABOVE:
            station.off_left = OFF_SEQUENCES
            self._off.append(station)
        if station.state != before:
            self._changes.append(Change(now, station.number, station.state))

    # ---- what takes long -------------------------------------------------------------------------

    def _repeats_itself(self, attempt: _Attempt) -> bool:
        """Rule 6: whether from now on every attempt will be like the last one."""
        if attempt.fault != "ack" or any(station.state != "passive" for station in attempt.group):
            return False
        self._recessive_ns = attempt.end_ns - self.span_ns(_PASSIVE_TAIL_BITS)
        pause_bits = INTERMISSION_BITS + SUSPEND_BITS
        self._period_ns = attempt.end_ns - attempt.start_ns + self.span_ns(pause_bits)
        has_company = any(
            station.acknowledges and not station.off_left and station not in attempt.group
            for station in self._stations.values()
        )
        return not has_company and not any(station.aborts for station in attempt.group)

    def _wake_up(self, now: Nanos) -> None:
        """Somebody comes or goes: place the attempt that is under way at ``now``."""
        self._knows_start = False
        endless, self._endless = self._endless, None
        if endless is None:
            return
        period_ns, start_ns = self._period_ns, endless.start_ns
        count = (now - start_ns) // period_ns if period_ns else 0
        for station in self._off:
            station.off_left = max(1, station.off_left - _PASSIVE_SEQUENCES * count)
        start_ns += count * period_ns
        end_ns = start_ns + endless.end_ns - endless.start_ns
        self._idle_ns = end_ns + self.span_ns(INTERMISSION_BITS)
        self._recessive_ns = end_ns - self.span_ns(_PASSIVE_TAIL_BITS)
        if now < end_ns or period_ns == 0:
            endless.start_ns, endless.end_ns = start_ns, max(end_ns, now)
            self._attempt = endless

    def _count_recessive(self, now: Nanos) -> None:
        """Those who are off have seen the bus recessive until ``now``."""
        for station in self._off:
            station.off_left = max(1, station.off_left - self._sequences(now))

    def _sequences(self, now: Nanos) -> int:
        """Times 11 recessive bits in the present stretch; one at least follows every frame."""
        if self.bitrate is None:
            return 1
        return (now - self._recessive_ns) * self.bitrate // (IDLE_BITS * NS_PER_S)

    def _next_recovery(self) -> tuple[Nanos, _Station] | None:
        """Who is the first to come back, and when, if nobody begins to send before."""
        if not self._off:
            return None
        station = min(self._off, key=lambda each: (each.off_left, each.number))
        if self._endless is None:
            return self._recessive_ns + self.span_ns(station.off_left * IDLE_BITS), station
        attempts, rest = divmod(station.off_left - 1, _PASSIVE_SEQUENCES)
        first_ns = self._endless.end_ns - self.span_ns(_PASSIVE_TAIL_BITS)
        due = first_ns + attempts * self._period_ns + self.span_ns((rest + 1) * IDLE_BITS)
        return max(due, self.now_ns), station

    def _recover(self, now: Nanos, station: _Station) -> Change:
        """Rule 5: a new beginning."""
        self._wake_up(now)
        self._off.remove(station)
        station.off_left = station.tec = station.rec = station.hold_bits = 0
        station.since_ns = now
        return Change(now, station.number, "active")


def _first_difference(streams: Sequence[str]) -> int:
    """The first bit at which not all are equal."""
    return next(
        at for at, bits in enumerate(zip(*streams, strict=False)) if len(frozenset(bits)) > 1
    )
