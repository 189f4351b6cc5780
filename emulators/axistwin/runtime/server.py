"""One line served to clients: the shell that owns the event loop and the file descriptors.

Rules
-----
1. One loop, one ``Line``, any number of ports.  Every client hears every byte of the line, as on a
   tee; what clients send is queued in the order in which it was read.
2. One alarm, set for the next moment at which the line has something to do.  Nothing else ticks,
   so a line at rest costs no processor time.
3. Bytes reach a client when they have arrived on the line.  The server wakes for the end of a
   stretch of bytes, not for each byte: a client sees an answer at the instant its last byte is
   complete, and of a long stretch whatever is complete at every ``Line.GRANULARITY_NS``.
4. A client is not read while the line's host end has more than ``BACKLOG_MAX`` bytes to send.
   Others still are: each may add one read, so none can shut out another.
5. The host end of the line uses the rate and framing of the client that sent last; a client that
   has none (raw TCP) gets those of the first device.
"""

import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, TypeAlias

from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.runtime.alarm import Alarm
from axistwin.runtime.line import Line
from axistwin.runtime.loop import Loop
from axistwin.wire.framing import LineFormat

READ_MAX = 1024
"""Bytes taken from a client at once."""

BACKLOG_MAX = 1024
"""Bytes waiting to go out on the line above which a client that sends is no longer read."""

# How many bytes are taken before the line is asked how much it has to send.
_WEIGHED_BYTES = 256

SAVE_PERIOD_NS: Nanos = 50 * NS_PER_MS
"""How often the position of a moving axis is saved, in the twin's time."""

# The alarm may have gone off, and then stays so until it is set or cleared.
_UNKNOWN: Nanos = -1

START_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 10.0

Report: TypeAlias = Callable[[Mapping[str, object]], None]
"""Takes an event: a mapping with the name of the event under ``event``."""


class Client(Protocol):
    """A stream of bytes that takes part in the line."""

    @property
    def place(self) -> Mapping[str, object]:
        """Where it has come in: ``endpoint`` and ``url``, as in events."""

    def line_format(self) -> LineFormat | None:
        """Rate and framing it uses now; None if it has none."""

    def deliver(self, data: bytes) -> None:
        """Take bytes from the line, without waiting."""

    def pause(self) -> None:
        """Send nothing more to ``Server.input``."""

    def resume(self) -> None:
        """Send again."""


class Port(Protocol):
    """A place where clients find the line."""

    @property
    def kind(self) -> str:
        """``pty``, ``tcp`` or ``rfc2217``."""

    @property
    def url(self) -> str:
        """What a client passes to ``serial_for_url``."""

    def describe(self) -> str:
        """The url, and whatever else helps a reader."""

    def open(self) -> None:
        """Claim the place; from now on clients can find it.  Raises PortError."""

    def attach(self, server: "Server") -> None:
        """Serve clients, in the server's loop."""

    def close(self) -> None:
        """Let go of the clients and of the place; also after a failed ``open``."""


class Server:
    """Serves ``line`` on ``ports``; ``report`` is told of clients that come and go.

    ``open`` and then ``run`` to serve in this thread, or ``start`` and ``stop`` for a thread of
    its own.  While it serves, the line may be used from any thread as well.
    """

    def __init__(
        self, line: Line, ports: Sequence[Port], *, report: Report = lambda event: None
    ) -> None:
        self.line = line
        self.ports = tuple(ports)
        self.report = report
        self.loop = Loop()
        self._clients: list[Client] = []
        self._paused: list[Client] = []
        self._talker: Client | None = None
        self._alarm = Alarm()
        self._alarm_ns: Nanos | None = None
        self._saves = not line.is_volatile
        self._save_ns: Nanos | None = None
        self._told_rates: set[tuple[Client, int]] = set()
        self._unweighed = 0
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

    def heed(self, stop_on: Sequence[signal.Signals]) -> None:
        """From now on these signals make ``run`` return, also before it is called."""
        for number in stop_on:
            self.loop.on_signal(number, self.loop.stop)

    def run(
        self,
        *,
        on_ready: Callable[[], None] = lambda: None,
    ) -> None:
        """Serve until ``request_stop`` or a signal that is heeded; close everything.

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
        self.line.on_change(self._changed)
        loop.add_reader(self._alarm.fileno(), self.pump)
        try:
            for port in self.ports:
                port.attach(self)
            self.pump()
            on_ready()
            loop.run()
        finally:
            self.line.on_change(None)
            loop.remove_reader(self._alarm.fileno())
            for port in self.ports:
                port.close()

    # -- clients ------------------------------------------------------------------------------

    def add_client(self, client: Client) -> None:
        """From now on ``client`` hears the line."""
        self._clients.append(client)
        if self._talker is None:
            self._talker = client

    def remove_client(self, client: Client) -> None:
        """``client`` has gone."""
        self._clients.remove(client)
        if client in self._paused:
            self._paused.remove(client)
        if self._talker is client:
            self._talker = None
        self._told_rates = {told for told in self._told_rates if told[0] is not client}

    def input(self, client: Client, data: bytes) -> None:
        """``client`` has sent ``data``."""
        self._talker = client
        self._use_format(client.line_format())
        if self.line.rate_mismatch is not None:
            self._tell_mismatch(client)
        answer = self.line.exchange(data)
        self._unweighed += len(data)
        if self._unweighed >= _WEIGHED_BYTES:
            self._unweighed = 0
            if self.line.host_backlog > BACKLOG_MAX:
                client.pause()
                self._paused.append(client)
        if self._saves:
            self._expect_motion()
        self._set_alarm()
        # Last: what follows a write competes with the client for the processor.
        if answer:
            self._hand_out(answer)

    def _tell_mismatch(self, client: Client) -> None:
        """Report, once for each rate of a client, that no device understands it."""
        mismatch = self.line.rate_mismatch
        if mismatch is None or (client, mismatch[0]) in self._told_rates:
            return
        baud, device_bauds = mismatch
        self._told_rates.add((client, baud))
        self.report(
            {"event": "wrong_rate", **client.place, "baud": baud, "module_bauds": device_bauds}
        )

    def pump(self) -> None:
        """Do what is due on the line now, and set the alarm for what comes next."""
        self._alarm_ns = _UNKNOWN
        if self._talker is not None:
            self._use_format(self._talker.line_format())
        answer = self.line.receive()
        if self._paused and self.line.host_backlog <= BACKLOG_MAX:
            clients, self._paused = self._paused, []
            for client in clients:
                client.resume()
        self._save()
        self._set_alarm()
        if answer:
            self._hand_out(answer)

    def _use_format(self, line_format: LineFormat | None) -> None:
        """The host end uses ``line_format``, or the first device's."""
        line = self.line
        wanted = line_format or line.device_format
        present = line.host_format
        if wanted is not present and wanted != present:
            line.host_format = wanted

    def _hand_out(self, data: bytes) -> None:
        """Every client hears ``data`` from the line."""
        for client in self._clients:
            client.deliver(data)

    def _changed(self) -> None:
        """Something was done to the line, perhaps in another thread: look at it soon."""
        if threading.get_ident() == self._thread_id or self._change_pending:
            return
        self._change_pending = True
        self.loop.call_soon(self._look_again)

    def _look_again(self) -> None:
        self._change_pending = False
        if self._saves:
            self._expect_motion()
        self.pump()

    def _set_alarm(self) -> None:
        """Wake for what the line does next, a paused client's turn, or a save; else not at all."""
        line = self.line
        due = line.next_event_ns()
        if self._paused:
            turn = line.host_sent_ns - line.host_format.span_ns(BACKLOG_MAX)
            due = turn if due is None else min(due, turn)
        if self._save_ns is not None:
            due = self._save_ns if due is None else min(due, self._save_ns)
        if due == self._alarm_ns:
            return
        self._alarm_ns = due
        if due is None:
            self._alarm.clear()
        else:
            self._alarm.set(round(line.clock.delay_s(due) * NS_PER_S))

    def _expect_motion(self) -> None:
        """Something was done that may set an axis moving: look whether there is one to be saved."""
        if self._save_ns is None:
            self._save_ns = self.line.clock.now_ns() + SAVE_PERIOD_NS

    def _save(self) -> None:
        """Save the positions of axes that move, and look again after ``SAVE_PERIOD_NS``.

        What the host is told is saved by the line itself; this is for the time in between.
        """
        now = self.line.clock.now_ns()
        if self._save_ns is None or now < self._save_ns:
            return
        self._save_ns = None
        if self.line.is_moving:
            self.line.save_moving()
            self._save_ns = now + SAVE_PERIOD_NS
