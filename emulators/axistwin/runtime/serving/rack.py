"""Lines and buses of one process, and the devices on them by name: served by one loop.

Rules
-----
1. A line (or bus) that fails ends alone: its ports are closed, it reports ``line_failed``, and the
   others go on.  When none is left, ``run`` raises why the last one has ended.
2. Names are unique.  On a line with a name of its own a device has that too: ``mac23:0@press``.  A
   device that is called as an earlier one gets a number behind its name: ``mac23:0~2``.
3. ``do`` has something done to a device in the loop's thread, where programs are watched and
   nothing else happens meanwhile; whoever asks, in another thread, gets a future.
4. Lines may come and go while it runs, in the loop's thread.  ``lines`` and ``devices`` are
   replaced then and never changed, so that any thread may read them.
"""

import contextlib
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

from axistwin.errors import StateError, UnknownNameError, UsageError, nearest
from axistwin.runtime.any_twin import AnyTwin
from axistwin.runtime.serving.base_server import BaseServer
from axistwin.runtime.serving.loop import Loop

if TYPE_CHECKING:
    from concurrent.futures import Future

START_TIMEOUT_S = 10.0
STOP_TIMEOUT_S = 10.0

AnyServer: TypeAlias = BaseServer[Any, Any]
ServerT = TypeVar("ServerT", bound=AnyServer)
ResultT = TypeVar("ResultT")


class RackDevice(NamedTuple):
    """A device of a rack: its ``name`` there, its ``line``'s, and its handle."""

    name: str
    line: str
    twin: AnyTwin
    server: AnyServer


class Rack:
    """See above.

    ``add`` servers made for its ``loop``; ``open``, and then ``run`` to serve in this thread, or
    ``start`` and ``stop`` for a thread of its own.  Either closes everything at its end.
    """

    def __init__(self) -> None:
        self.loop = Loop()
        self.lines: dict[str, AnyServer] = {}
        self.devices: dict[str, RackDevice] = {}
        self._subscribers: list[Callable[[str, Mapping[str, object]], None]] = []
        self._failure: BaseException | None = None
        self._thread: threading.Thread | None = None
        self._is_closed = False
        self.ends_with_last = True
        """Whether ``run`` ends when the last line has failed."""

    def add(self, server: ServerT, line: str = "") -> ServerT:
        """Take ``server``, which is made for this rack's loop, and its devices; it is returned.

        line: what it is called, like no other; else as the first device on it.  While the rack
        runs, whoever adds a server opens it and lets it begin.
        """
        devices = dict(self.devices)
        behind = f"@{line}" if line else ""
        for twin in server.simulation.twins:
            name = _unique(f"{twin.name}{behind}", devices)
            line = line or name
            devices[name] = RackDevice(name, line, twin, server)
        assert line not in self.lines, f"there is a line {line}"
        self.devices, self.lines = devices, {**self.lines, line: server}
        server.line_name = line
        own_report = server.report

        def report(event: Mapping[str, object]) -> None:
            own_report(event)
            for subscriber in self._subscribers:
                subscriber(line, event)

        server.report = report
        server.on_failure = lambda error: self._line_failed(line, error)
        return server

    def begin(self, line: str) -> None:
        """Serve ``line``, which came while the rack runs and is open; subscribers hear
        ``line_added``.
        """
        self.lines[line].begin()
        names = [each.name for each in self.on_line(line)]
        for subscriber in self._subscribers:
            subscriber(line, {"event": "line_added", "devices": names})

    def remove(self, line: str) -> None:
        """Serve ``line`` no more, and forget its devices; subscribers hear ``line_removed``."""
        server = self.lines[line]
        names = [each.name for each in self.on_line(line)]
        self.lines = {name: each for name, each in self.lines.items() if name != line}
        self.devices = {
            name: each for name, each in self.devices.items() if each.server is not server
        }
        server.close()
        for subscriber in self._subscribers:
            subscriber(line, {"event": "line_removed", "devices": names})

    def on_line(self, line: str) -> list[RackDevice]:
        """The devices on ``line``, in their order."""
        return [each for each in self.devices.values() if each.line == line]

    def subscribe(self, subscriber: Callable[[str, Mapping[str, object]], None]) -> None:
        """Tell ``subscriber`` what any server reports, with its line; in the loop's thread."""
        self._subscribers.append(subscriber)

    def find(self, wanted: str) -> RackDevice:
        """The device that ``wanted`` names: by its name, by its model and the address that it has
        now, or by its model alone if there is only one.  Raises UnknownNameError.
        """
        found = self.devices.get(wanted)
        if found is not None:
            return found
        served = [(each.name, each.twin.model, each.twin.address) for each in self.served]
        return self.devices[find_name(wanted, self.devices, served)]

    def find_line(self, wanted: str) -> str:
        """The line called ``wanted``, or that of the device called so.  Raises UnknownNameError."""
        if wanted in self.lines:
            return wanted
        try:
            return self.find(wanted).line
        except UnknownNameError:
            raise UnknownNameError(f"no line {wanted!r}: {nearest(wanted, self.lines)}") from None

    @property
    def served(self) -> list[RackDevice]:
        """The devices of lines that have not failed."""
        return [each for each in self.devices.values() if each.server.failure is None]

    def do(self, wanted: str, action: Callable[[RackDevice], ResultT]) -> "Future[ResultT]":
        """Have ``action`` done to the device that ``wanted`` names, soon, by the loop.

        From any thread.  The future has its result, or its UsageError; any other error is the
        line's too, and ends it.  A line that has failed does nothing: StateError.
        """

        def done() -> ResultT:
            device = self.find(wanted)
            result = self._done(device, action)
            # What was done may bring something that is due sooner than all else.
            device.server.loop.call_soon(device.server.look_again)
            return result

        return self._soon(done)

    def do_all(self, action: Callable[[RackDevice], ResultT]) -> "Future[list[ResultT]]":
        """As ``do``, to each device that is served; those of a line that fails are left out."""

        def each() -> list[ResultT]:
            results = []
            for device in self.served:
                with contextlib.suppress(StateError):
                    results.append(self._done(device, action))
            return results

        return self._soon(each)

    def _soon(self, call: Callable[[], ResultT]) -> "Future[ResultT]":
        from concurrent.futures import Future  # with logging and more, which few runs need

        future: Future[ResultT] = Future()

        def answer() -> None:
            if not future.set_running_or_notify_cancel():
                return
            try:
                future.set_result(call())
            except Exception as error:  # of whoever asks
                future.set_exception(error)

        self.loop.call_soon(answer)
        return future

    def _done(self, device: RackDevice, action: Callable[[RackDevice], ResultT]) -> ResultT:
        if device.server.failure is None:
            try:
                return action(device)
            except UsageError:
                raise
            except Exception as error:
                device.server.fail(error)
        raise StateError(f"{device.line} is not served any more: {device.server.failure}")

    # -- life ---------------------------------------------------------------------------------

    def open(self) -> None:
        """Claim all ports, or none.  Raises PortError."""
        try:
            for server in self.lines.values():
                server.open()
        except BaseException:
            self.close()
            raise

    def run(self, *, on_ready: Callable[[], None] = lambda: None) -> None:
        """Serve until ``request_stop``, a signal, or the failure of the last line.

        on_ready: called once clients are served.  Closes everything; raises that failure.
        """
        try:
            for server in self.lines.values():
                server.begin()
            if self._failure is None:
                on_ready()
                self.loop.run()
        finally:
            self.close()
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure

    def start(self) -> None:
        """Open, then serve in a thread of its own.  Raises PortError."""
        self.open()
        ready = threading.Event()
        self._thread = threading.Thread(
            target=self._run_quietly, args=(ready,), name="axistwin", daemon=True
        )
        self._thread.start()
        assert ready.wait(START_TIMEOUT_S), "the rack's thread did not start"
        if self._failure is not None:
            self.stop()  # which raises it

    def stop(self) -> None:
        """Stop the thread and close everything.  Raises what made the last line fail, if it did."""
        if self._thread is None:
            self.close()
            return
        self.request_stop()
        self._thread.join(STOP_TIMEOUT_S)
        assert not self._thread.is_alive(), "the rack's thread did not stop"
        self._thread = None
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure

    def request_stop(self) -> None:
        """Make ``run`` return soon; from any thread."""
        self.loop.stop()

    def close(self) -> None:
        """Close the lines and the loop.  Only when it does not run."""
        if self._is_closed:
            return
        self._is_closed = True
        for server in self.lines.values():
            server.close()
        self.loop.close()

    def _run_quietly(self, ready: threading.Event) -> None:
        """``run`` for the thread; the failure is kept for ``stop``."""
        try:
            self.run(on_ready=ready.set)
        except BaseException as error:  # told to whoever stops the rack
            self._failure = error
        finally:
            ready.set()

    def _line_failed(self, line: str, error: Exception) -> None:
        devices = [each.name for each in self.on_line(line)]
        is_last = all(server.failure is not None for server in self.lines.values())
        if is_last and self.ends_with_last:
            self._failure = error
            self.loop.stop()
            return
        self.lines[line].report(
            {"event": "line_failed", "line": line, "devices": devices, "error": str(error)}
        )


def find_name(wanted: str, known: Collection[str], served: Sequence[tuple[str, str, int]]) -> str:
    """The name of the device that ``wanted`` names.  Raises UnknownNameError.

    known: the names of all.  served: name, model, and present address of those that are served.
    """
    if wanted in known:
        return wanted
    model, colon, _ = wanted.partition(":")
    alike = [
        name
        for name, its_model, address in served
        if its_model == model and (not colon or f"{model}:{address}" == wanted)
    ]
    if len(alike) == 1:
        return alike[0]
    remedy = f"it is one of {', '.join(alike)}" if alike else nearest(wanted, known)
    raise UnknownNameError(f"no device {wanted!r}: {remedy}")


def _unique(name: str, taken: Mapping[str, object]) -> str:
    """``name``, with a number behind it if it is taken."""
    number, unique = 1, name
    while unique in taken:
        number += 1
        unique = f"{name}~{number}"
    return unique
