"""What serves the simulation of a network to clients: one alarm, ports, and saving.

Rules
-----
1. One simulation, any number of ports, in a loop that others may share (``rack``).  Everything
   happens in the loop's thread.
2. One alarm, set for the next moment at which there is something to do, or an earlier one: what
   moves away leaves it as it is, since most of that moves with every exchange.  Nothing else ticks,
   so what is at rest costs no processor time.  What has come already is something to do: no reply
   waits here, wherever the process is paused.
3. Positions of moving axes are saved every ``SAVE_PERIOD_NS``, as long as one moves.
4. What fails in a callback ends this server: its ports are closed, ``failure`` says why, and
   ``on_failure`` is told.

What clients send and hear is the business of ``Server`` (a serial line) and ``BusServer``.
"""

import contextlib
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, Protocol, TypeAlias, TypeVar

from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.runtime.serving.alarm import Alarm
from axistwin.runtime.serving.loop import Loop, LoopShare
from axistwin.runtime.simulation import Simulation, earliest
from axistwin.wire.faults import FaultAct

LOOK_NS: Nanos = 200 * NS_PER_MS
"""How often a client that is held back is looked after, in the twin's time."""

SAVE_PERIOD_NS: Nanos = 50 * NS_PER_MS
"""How often the position of a moving axis is saved, in the twin's time."""

REPORT_S = 0.05
"""What faults of the wire do in this time is reported together."""

# The alarm may have gone off, and then stays so until it is set or cleared.
_UNKNOWN: Nanos = -1

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
    """Serves ``simulation`` on ``ports`` in ``loop``; ``report`` is told of clients and faults.

    ``line_name``: what its rack calls it.

    ``open``, then ``begin`` where the loop runs, or before it does.  While it serves, the
    simulation may be used from any thread as well.
    """

    def __init__(
        self,
        simulation: SimulationT,
        ports: Sequence[EndpointT],
        loop: Loop,
        report: Report = lambda event: None,
    ) -> None:
        loop.has_server = True
        self.simulation = simulation
        self.ports = tuple(ports)
        self.report = report
        self.line_name = ""
        self.loop = LoopShare(loop, self.fail)
        self.failure: Exception | None = None
        self.on_failure: Callable[[Exception], None] = lambda error: None
        self._alarm = Alarm()
        self._alarm_ns: Nanos | None = None
        self._saves = not simulation.is_volatile
        self._save_ns: Nanos | None = None
        self._change_pending = False
        self._thread_id = 0
        self._closed = False
        self._acts: dict[int, tuple[int, FaultAct]] = {}
        """Of faults of the wire that have acted: how often since it was reported, and the last."""
        self._forget_faults: Callable[[], None] = lambda: None

    # -- life ---------------------------------------------------------------------------------

    def open(self) -> None:
        """Claim all ports, or none.  Raises PortError."""
        try:
            for port in self.ports:
                port.open()
        except BaseException:
            self.close()
            raise

    def begin(self) -> None:
        """Serve clients from now on, in this thread's loop; what goes wrong is ``fail``'s."""
        self._thread_id = threading.get_ident()
        self.simulation.on_change(self._changed)
        self._forget_faults = self.simulation.subscribe_faults(self._fault_acted)
        self.loop.add_reader(self._alarm.fileno(), self._go_off)
        try:
            self._attach_ports()
            self._go_off()
        except Exception as error:
            self.fail(error)

    def fail(self, error: Exception) -> None:
        """Serve no more because of ``error``."""
        if self.failure is not None or self._closed:
            return
        self.failure = error
        with contextlib.suppress(Exception):  # what has failed may well fail again
            self.close()
        self.on_failure(error)

    def close(self) -> None:
        """Serve no more, and release the ports; in the loop's thread, or when it does not run."""
        if self._closed:
            return
        self._closed = True
        with contextlib.ExitStack() as rest:  # all of it, whatever fails
            rest.callback(self._alarm.close)
            if self._thread_id:
                rest.callback(self.loop.remove_reader, self._alarm.fileno())
            for port in reversed(self.ports):
                rest.callback(port.close)
            self.loop.close()
            self.simulation.on_change(None)
            self._forget_faults()

    @abstractmethod
    def _attach_ports(self) -> None:
        """Let every port serve its clients here."""

    # -- faults of the wire -------------------------------------------------------------------

    def _fault_acted(self, act: FaultAct) -> None:
        """Report it, perhaps from another thread: soon, and several of one fault together."""
        if not self._acts:
            self.loop.call_soon(self.loop.call_later, REPORT_S, self._report_acts)
        count = self._acts.get(act.number, (0, act))[0]
        self._acts[act.number] = count + 1, act

    def _report_acts(self) -> None:
        with self.simulation.present():
            acts, self._acts = self._acts, {}
        for number, (count, act) in acts.items():
            details: dict[str, object] = {
                "line": self.line_name,
                "acted": count,
                "time_ns": act.time_ns,
                "text": act.text,
            }
            self.report({"event": "wire_fault", "fault": number, "fault_kind": act.kind, **details})

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
            due = self.simulation.clock.now_ns()
        present = self._alarm_ns
        if due == present or (
            present is not None and present >= 0 and (due is None or present < due)
        ):
            return
        self._alarm_ns = due
        if due is None:
            self._alarm.clear()
        else:
            self._alarm.set(round(self.simulation.clock.delay_s(due) * NS_PER_S))

    # -- what moves ---------------------------------------------------------------------------

    def _expect_motion(self) -> None:
        """Something was done that may set an axis moving: look whether there is one to be saved."""
        if self._saves and self._save_ns is None:
            self._save_ns = self.simulation.clock.now_ns() + SAVE_PERIOD_NS

    def _save(self) -> None:
        """Save the positions of axes that move, and look again after ``SAVE_PERIOD_NS``.

        What the host is told is saved by the simulation itself; this is for the time in between.
        """
        if self._save_ns is None:
            return
        now = self.simulation.clock.now_ns()
        if now < self._save_ns:
            return
        self._save_ns = None
        if self.simulation.is_moving:
            self.simulation.save_moving()
            self._save_ns = now + SAVE_PERIOD_NS
