"""What serves the simulation of a network to clients: the event loop, one alarm, ports, and saving.

Rules
-----
1. One loop, one simulation, any number of ports.  Everything happens in the loop's thread.
2. One alarm, set for the next moment at which there is something to do.  Nothing else ticks, so
   what is at rest costs no processor time.  What has come already is something to do: no reply
   waits here, wherever the process is paused.
3. Positions of moving axes are saved every ``SAVE_PERIOD_NS``, as long as one moves.

What clients send and hear is the business of ``Server`` (a serial line) and ``BusServer``.
"""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, Protocol, TypeAlias, TypeVar

from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.runtime.serving.alarm import Alarm
from axistwin.runtime.serving.loop import Loop
from axistwin.runtime.simulation import Simulation, earliest

LOOK_NS: Nanos = 200 * NS_PER_MS
"""How often a client that is held back is looked after, in the twin's time."""

SAVE_PERIOD_NS: Nanos = 50 * NS_PER_MS
"""How often the position of a moving axis is saved, in the twin's time."""

# The alarm may have gone off, and then stays so until it is set or cleared.
_UNKNOWN: Nanos = -1

START_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 10.0

Report: TypeAlias = Callable[[Mapping[str, object]], None]
"""Takes an event: a mapping with the name of the event under ``event``."""


class Endpoint(Protocol):
    """Where clients find what is served; a port without the kind of server it works for.

    What it may have beside (looked at by ``getattr``): ``host``, if others on the network can reach
    it; ``device_index``, if clients find only that device there.
    """

    @property
    def kind(self) -> str:
        """What it is called in events and ready lines: ``pty``, ``tcp``, ``slcan`` ..."""

    @property
    def url(self) -> str:
        """What a client opens."""

    def describe(self) -> str:
        """The url, and whatever else helps a reader."""

    def open(self) -> None:
        """Claim the place; from now on clients can find it.  Raises PortError."""

    def close(self) -> None:
        """Let go of the clients and of the place; also after a failed ``open``."""


EndpointT = TypeVar("EndpointT", bound=Endpoint)
SimulationT = TypeVar("SimulationT", bound=Simulation[Any])


class BaseServer(ABC, Generic[SimulationT, EndpointT]):
    """Serves ``simulation`` on ``ports``; ``report`` is told of clients that come and go.

    loop: what it runs in; one of its own, closed at its end, unless given.

    ``open`` and then ``run`` to serve in this thread, or ``start`` and ``stop`` for a thread of
    its own.  While it serves, the simulation may be used from any thread as well.
    """

    def __init__(
        self,
        simulation: SimulationT,
        ports: Sequence[EndpointT],
        report: Report = lambda event: None,
        loop: Loop | None = None,
    ) -> None:
        self.ports = tuple(ports)
        self.report = report
        self.loop = loop or Loop()
        self.loop.has_server = True
        self._has_own_loop = loop is None
        self._simulation = simulation
        self._alarm = Alarm()
        self._alarm_ns: Nanos | None = None
        self._saves = not simulation.is_volatile
        self._save_ns: Nanos | None = None
        self._change_pending = False
        self._failure: BaseException | None = None
        self._thread: threading.Thread | None = None
        self._thread_id = 0
        self._closed = False

    # -- life ---------------------------------------------------------------------------------

    def open(self) -> None:
        """Claim all ports, or none.  Raises PortError."""
        try:
            for port in self.ports:
                port.open()
        except BaseException:
            self.close()
            raise

    def run(
        self,
        *,
        on_ready: Callable[[], None] = lambda: None,
    ) -> None:
        """Serve until ``request_stop`` or an installed signal; close everything.

        on_ready: called once clients are served.
        Raises what made it stop, if that was an error.
        """
        try:
            self._serve(on_ready)
        finally:
            self.close()

    def start(self) -> None:
        """Open, then serve in a thread of its own.  Raises PortError."""
        self.open()
        ready = threading.Event()
        self._thread = threading.Thread(
            target=self._run_quietly, args=(ready,), name="axistwin", daemon=True
        )
        self._thread.start()
        assert ready.wait(START_TIMEOUT_S), "the server's thread did not start"

    def stop(self) -> None:
        """Stop the thread and close everything.  Raises what made the server fail, if it did."""
        if self._thread is None:
            self.close()
            return
        self.request_stop()
        self._thread.join(STOP_TIMEOUT_S)
        assert not self._thread.is_alive(), "the server's thread did not stop"
        self._thread = None
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure

    def request_stop(self) -> None:
        """Make ``run`` return soon; from any thread."""
        self.loop.stop()

    def close(self) -> None:
        """Release the ports and the loop.  Only when it does not run."""
        if self._closed:
            return
        self._closed = True
        for port in self.ports:
            port.close()
        self._alarm.close()
        if self._has_own_loop:
            self.loop.close()

    def _run_quietly(self, ready: threading.Event) -> None:
        """``run`` for the thread; the failure is kept for ``stop``."""
        try:
            self.run(on_ready=ready.set)
        except BaseException as error:  # told to whoever stops the server
            self._failure = error
            ready.set()

    def _serve(self, on_ready: Callable[[], None]) -> None:
        loop = self.loop
        self._thread_id = threading.get_ident()
        self._simulation.on_change(self._changed)
        loop.add_reader(self._alarm.fileno(), self._go_off)
        try:
            self._attach_ports()
            self._go_off()
            on_ready()
            loop.run()
        finally:
            self._simulation.on_change(None)
            loop.remove_reader(self._alarm.fileno())
            for port in self.ports:
                port.close()

    @abstractmethod
    def _attach_ports(self) -> None:
        """Let every port serve its clients here."""

    # -- the alarm ----------------------------------------------------------------------------

    @abstractmethod
    def pump(self) -> None:
        """Do what is due now, save what moves, and set the alarm for what comes next."""

    @abstractmethod
    def _due_ns(self) -> Nanos | None:
        """When ``pump`` has something to do, positions to save apart; None: not by itself."""

    @property
    @abstractmethod
    def _has_news(self) -> bool:
        """Whether something has come for clients that ``pump`` would hand them."""

    def _go_off(self) -> None:
        self._alarm_ns = _UNKNOWN
        self.pump()

    def _changed(self) -> None:
        """Something was done to the simulation, perhaps in another thread: look at it soon."""
        if threading.get_ident() == self._thread_id or self._change_pending:
            return
        self._change_pending = True
        self.loop.call_soon(self.look_again)

    def look_again(self) -> None:
        """Something was done to the simulation, in the loop's thread too: do what is due now."""
        self._change_pending = False
        self._expect_motion()
        self._go_off()

    def _set_alarm(self) -> None:
        """Wake for what is due next, or a save; else not at all."""
        due = earliest(self._due_ns(), self._save_ns)
        # Asked last: whoever has looked at the simulation until now, here or in another thread, may
        # have pushed time past the event that was due, and what came then waits for nothing.
        if self._has_news:
            due = self._simulation.clock.now_ns()
        if due == self._alarm_ns:
            return
        self._alarm_ns = due
        if due is None:
            self._alarm.clear()
        else:
            self._alarm.set(round(self._simulation.clock.delay_s(due) * NS_PER_S))

    # -- what moves ---------------------------------------------------------------------------

    def _expect_motion(self) -> None:
        """Something was done that may set an axis moving: look whether there is one to be saved."""
        if self._saves and self._save_ns is None:
            self._save_ns = self._simulation.clock.now_ns() + SAVE_PERIOD_NS

    def _save(self) -> None:
        """Save the positions of axes that move, and look again after ``SAVE_PERIOD_NS``.

        What the host is told is saved by the simulation itself; this is for the time in between.
        """
        now = self._simulation.clock.now_ns()
        if self._save_ns is None or now < self._save_ns:
            return
        self._save_ns = None
        if self._simulation.is_moving:
            self._simulation.save_moving()
            self._save_ns = now + SAVE_PERIOD_NS
