"""The time of a host program that lives in virtual time together with its twins.

``patches`` makes ``time.sleep`` and its like ask here.  Rules:

1. Time stands while a thread that takes part runs, and goes on when all of them wait: at once, to
   the moment at which the first of them is due.
2. One thread after the other: in the order in which they are due, those due at one moment in the
   order in which they began to wait.  So a program gives the same exchange every time.
3. A thread takes part when it made the first of these twins, was started by one that takes part, or
   waits for such a twin.  All other threads of the process keep their real time.
4. A thread that is held up by what is not known here (a lock, a socket, another process) for more
   than ``GRACE_S`` of real time is not waited for until it goes on; for that it has ``CHANCE_S``
   of real time each time when all others wait.  One that computes, or would if this machine were
   less busy, is not held up, as far as the operating system tells.
5. Each look at a clock takes ``LOOK_NS``, so that a loop that does nothing else ends.
"""

import sys
from _thread import RLock, allocate_lock, get_ident, get_native_id
from collections.abc import Callable
from pathlib import Path
from time import sleep
from typing import Final

from axistwin.kernel.time import NS_PER_S, NS_PER_US, Nanos
from axistwin.runtime.clock import VirtualClock

GRACE_S: Final = 0.05
CHANCE_S: Final = 0.000_1
LOOK_NS: Final[Nanos] = NS_PER_US


class Participant:
    """A thread that takes part.

    due_ns: when it goes on, None: not by itself.  is_ready: whether something else lets it go on.
    stuck_at: where it stood when it was given up (rule 4).
    """

    def __init__(self, ident: int = 0) -> None:
        self.ident = ident
        self.native_id = 0
        self.turn = allocate_lock()
        self.turn.acquire()
        self.is_waiting = False
        self.due_ns: Nanos | None = None
        self.is_ready: Callable[[], bool] | None = None
        self.order = 0
        self.seen_at: object = object()
        self.stuck_at: object = None

    def has_turn(self) -> bool:
        """Whether it runs, or may."""
        return not self.is_waiting

    def place(self) -> object:
        """Which instruction it is at; None if it has ended, something else each time before it is
        there, and while it computes."""
        if not self.ident or self.is_runnable():
            return object()
        frame = sys._current_frames().get(self.ident)
        return None if frame is None else (id(frame), frame.f_lasti)

    def is_runnable(self) -> bool:
        """Whether the operating system lets it run, or would at once; False where none tells."""
        try:
            stat = Path(f"/proc/self/task/{self.native_id}/stat").read_bytes()
        except OSError:
            return False
        return stat.rpartition(b") ")[2].startswith(b"R")


class HostTime:
    """Virtual nanoseconds that pass when all threads that take part wait (rule 1)."""

    def __init__(self) -> None:
        self.now_ns: Nanos = 0
        self.is_on = False
        # Taken again by the same thread when the garbage collector, while it is held, ends an
        # executor, which wakes that one's threads.
        self._mutex = RLock()
        self._is_passing_on = False
        self._participants: list[Participant] = []
        self._by_ident: dict[int, Participant] = {}
        self._waits = 0

    # -- who takes part ------------------------------------------------------------------------

    @property
    def is_shared(self) -> bool:
        """Whether more than one thread takes part."""
        return self.is_on and len(self._participants) > 1

    def current(self) -> Participant | None:
        """The present thread, if it takes part."""
        return self._by_ident.get(get_ident())

    def take_part(self) -> None:
        """Let the present thread take part, until it ends or the time does."""
        if self.is_on and self.current() is None:
            self.begin(self.expect())

    def expect(self) -> Participant:
        """A thread that is about to start, and waited for already."""
        newcomer = Participant()
        with self._mutex:
            self._participants.append(newcomer)
        return newcomer

    def begin(self, newcomer: Participant) -> None:
        """It runs now: the present thread."""
        newcomer.ident, newcomer.native_id = get_ident(), get_native_id()
        self._by_ident[newcomer.ident] = newcomer

    def leave(self, participant: Participant) -> None:
        """It has ended, or will not start."""
        with self._mutex:
            if participant in self._participants:
                self._participants.remove(participant)
                self._by_ident.pop(participant.ident, None)
                self._pass_on()

    def has_left(self, participant: Participant) -> bool:
        """Whether it has ended."""
        return participant not in self._participants

    def start(self) -> None:
        """The present thread takes part from now on."""
        self.is_on = True
        self.take_part()

    def stop(self) -> None:
        """Nobody takes part any more; whoever waits for a moment goes on within ``GRACE_S``."""
        with self._mutex:
            self.is_on = False
            self._participants.clear()
            self._by_ident.clear()

    # -- time ----------------------------------------------------------------------------------

    def look(self) -> Nanos:
        """The time, for a program that asks (rule 5)."""
        due_ns = self.now_ns + LOOK_NS
        if self.is_shared and self._is_due(due_ns):
            self.wait(due_ns)
        else:
            self.advance_to(due_ns)
        return self.now_ns

    def _is_due(self, by_ns: Nanos) -> bool:
        return any(
            each.is_waiting and each.due_ns is not None and each.due_ns <= by_ns
            for each in tuple(self._participants)
        )

    def advance_to(self, until_ns: Nanos) -> None:
        """Move on, whoever is due before; they go on at their turn."""
        with self._mutex:
            if until_ns > self.now_ns:
                self.now_ns = until_ns

    def span_until(self, seconds: float | None) -> Nanos | None:
        """When ``seconds`` will be over; None: never."""
        return None if seconds is None else self.now_ns + max(0, round(seconds * NS_PER_S))

    def wait(self, due_ns: Nanos | None, is_ready: Callable[[], bool] | None = None) -> None:
        """Wait in the present thread, which takes part, until then, or until ``is_ready``.

        is_ready: asked in any thread, and must not wait.
        """
        me = self.current()
        assert me is not None, "the present thread takes part"
        with self._mutex:
            if len(self._participants) == 1 and due_ns is not None and is_ready is None:
                self.now_ns = max(self.now_ns, due_ns)
                return
            self._waits += 1
            me.due_ns, me.is_ready, me.order = due_ns, is_ready, self._waits
            me.is_waiting = True
            me.stuck_at, me.seen_at = None, object()
            self._pass_on()
        try:
            while not me.turn.acquire(timeout=GRACE_S) and not self._may_go(me):
                pass
        finally:
            with self._mutex:
                if me.is_waiting:
                    me.is_waiting = False
                else:
                    me.turn.acquire(blocking=False)

    def nudge(self) -> None:
        """Something has happened that may make somebody ready."""
        with self._mutex:
            self._pass_on()

    def _may_go(self, me: Participant) -> bool:
        """Whether ``me`` goes on though nobody has given it its turn for ``GRACE_S``."""
        with self._mutex:
            if me.has_turn():  # since this very moment
                return False
            for each in self._participants:
                if not each.is_waiting and each.stuck_at is None:
                    place = each.place()
                    if place == each.seen_at:
                        each.stuck_at = place or each
                    each.seen_at = place
            self._pass_on()
            if me.has_turn():
                return False
            if me.due_ns is not None and me not in self._participants:
                return True  # this time is over
            return self._moment(me) <= self.now_ns

    def _pass_on(self) -> None:
        """If all wait, give the turn to the one that is due first, and let the time come (1, 2).

        The mutex is held.  Called from within itself it leaves that to the next who looks.
        """
        if self._is_passing_on:
            return
        self._is_passing_on = True
        try:
            self._give_turn()
        finally:
            self._is_passing_on = False

    def _give_turn(self) -> None:
        if any(map(self._is_awaited, self._participants)):
            return
        waiting = (each for each in self._participants if each.is_waiting)
        first = min(waiting, key=lambda each: (self._moment(each), each.order), default=None)
        if first is None or (moment := self._moment(first)) == _NEVER:
            return
        self.now_ns = max(self.now_ns, int(moment))
        first.is_waiting = False
        first.turn.release()

    def _is_awaited(self, participant: Participant) -> bool:
        """Whether time stands for it: it runs, and is not held up (rule 4)."""
        if participant.is_waiting:
            return False
        if participant.stuck_at is None:
            return True
        sleep(CHANCE_S)
        place = participant.place()
        if place is None or place == participant.stuck_at:
            return False
        participant.stuck_at = None
        return True

    def _moment(self, participant: Participant) -> float:
        """When it can go on."""
        if participant.is_ready is not None and participant.is_ready():
            return min(self.now_ns, participant.due_ns or self.now_ns)
        return _NEVER if participant.due_ns is None else participant.due_ns


_NEVER = float("inf")


class HostedClock(VirtualClock):
    """The clock of a line or bus in the time of ``host``: 0 when it is made."""

    def __init__(self, host: HostTime) -> None:
        super().__init__()
        self.host = host
        self._start_ns = host.now_ns

    @property
    def is_shared(self) -> bool:
        """Whether other threads move it too."""
        return self.host.is_shared

    def now_ns(self) -> Nanos:
        """The host's time since this clock was made."""
        return self.host.now_ns - self._start_ns

    def advance_to(self, until_ns: Nanos) -> None:
        """Move the host's time on, at once."""
        self.host.advance_to(self._start_ns + until_ns)

    def delay_s(self, until_ns: Nanos) -> float:
        """Seconds of the host's to sleep until it is ``until_ns``."""
        self.host.take_part()
        return max(0, until_ns - self.now_ns()) / NS_PER_S
