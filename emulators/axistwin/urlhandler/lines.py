"""Lines made from options, and which ports of this process share one.

- A line with a name (``line=NAME``) is the same for all who open that name, and lives until it is
  released or the process ends: closing and opening again finds the same twins, still powered.
- A line with a memory (``state=DIR``) is the same for all who open that folder, as long as one port
  object refers to it.
- Any other line belongs to one port object, which may be closed and opened as often as it likes.
"""

import itertools
import threading
import weakref
from pathlib import Path

from axistwin import catalog
from axistwin.errors import UsageError
from axistwin.runtime.host import patches
from axistwin.runtime.line import Line
from axistwin.urlhandler.url import LineOptions, TwinUrl

_living: "weakref.WeakSet[OpenLine]" = weakref.WeakSet()
_numbers = itertools.count(1)


class OpenLine:
    """A line and the options it was made with.  Raises UsageError and StateError.

    number: in the order in which lines of this process were made.

    The line is closed, its memory saved, when nobody refers to this object any more, or at the end
    of the process.
    """

    def __init__(self, options: LineOptions) -> None:
        self.options = options
        self.number = next(_numbers)
        self.line = build_line(options)
        self.exclusive_owner: weakref.ref[object] | None = None
        self._host_user = object() if options.host_clock else None
        self._finalizer = weakref.finalize(self, _end, self.line, self._host_user)
        _living.add(self)

    @property
    def is_closed(self) -> bool:
        """Whether the twins are switched off for good."""
        return not self._finalizer.alive

    def close(self) -> None:
        """Switch the twins off and keep what they keep; twice is once.  Raises StateError."""
        if self._finalizer.detach() is not None:
            _end(self.line, self._host_user)

    def use_host_time(self) -> None:
        """A port is open: what the host sleeps moves the line's time, if it is to."""
        if self._host_user is not None:
            patches.use(self._host_user)

    def release_host_time(self) -> None:
        """No port is open."""
        if self._host_user is not None:
            patches.release(self._host_user)


def _end(line: Line, host_user: object) -> None:
    patches.release(host_user)
    line.close()


def build_line(options: LineOptions) -> Line:
    """A new line, as ``options`` say.  Raises UsageError and StateError."""
    return catalog.build_line(**options.arguments(), baud=options.baud, programs=options.programs)


_registry_lock = threading.Lock()
_named: dict[str, OpenLine] = {}
_with_state: "weakref.WeakValueDictionary[Path, OpenLine]" = weakref.WeakValueDictionary()


def living() -> list[OpenLine]:
    """All lines of this process that ports refer to, or that have a name."""
    return [line for line in _living if not line.is_closed]


def open_line(url: TwinUrl) -> OpenLine:
    """The line that ``url`` asks for, new or shared.  Raises UsageError and StateError."""
    with _registry_lock:
        if url.line is not None:
            found = _named.get(url.line)
            if found is None:
                _named[url.line] = found = OpenLine(_complete(url))
            name = f"line {url.line}"
        elif url.options.state is not None:
            folder = Path(url.options.state).resolve()
            found = _with_state.get(folder)
            if found is None:
                _with_state[folder] = found = OpenLine(_complete(url))
            name = f"state {url.options.state}"
        else:
            return OpenLine(_complete(url))
        difference = url.disagreement(found.options)
        if difference is not None:
            raise UsageError(f"{name} is open already: {difference}; choose another one")
        return found


def share(name: str, options: LineOptions) -> OpenLine:
    """A new line that ``line=NAME`` finds from now on.  Raises UsageError and StateError."""
    with _registry_lock:
        if name in _named:
            raise UsageError(f"line {name} is open already; choose another name")
        _named[name] = opened = OpenLine(options)
        return opened


def release(name: str) -> None:
    """Close the line of this name, if there is one; ports that have it open cannot use it more."""
    with _registry_lock:
        found = _named.pop(name, None)
    if found is not None:
        found.close()


def _complete(url: TwinUrl) -> LineOptions:
    if not url.options.devices:
        raise UsageError(
            f"there is no line {url.line}, not yet or not any more; name devices to make one, "
            f"such as axistwin://mac23?line={url.line}"
        )
    return url.options
