"""Notices of files being opened: one inotify instance for all of them.

A user may have few instances (128 on many machines), but many thousands of watches.

Notices say that something happened, not how often: two opens may be merged into one.  If the kernel
had to drop some, everybody is called.
"""

import contextlib
import ctypes
import os
import struct
from collections.abc import Callable

_IN_OPEN = 0x20
_FLAGS = os.O_NONBLOCK | os.O_CLOEXEC  # what IN_NONBLOCK and IN_CLOEXEC are defined as
_DROPPED = -1
# struct inotify_event of a watched file: the watch, what, a cookie, and the length of a name (0).
_NOTICE = struct.Struct("=iIII")
_NOTICES_MAX = 256


class OpenWatches:
    """Readable (see ``fileno``) when a file has been opened; ``tell`` then calls who wants that."""

    def __init__(self) -> None:
        """Raises OSError when the kernel has no instance left."""
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._fd: int = _checked(self._libc.inotify_init1(_FLAGS))
        self._callbacks: dict[int, Callable[[], object]] = {}

    def fileno(self) -> int:
        """The descriptor to wait for."""
        return self._fd

    def add(self, path: str, callback: Callable[[], object]) -> int:
        """Call ``callback`` when ``path`` is opened; returns what to ``remove``.  Raises OSError.

        A file can be watched once.
        """
        number = _checked(self._libc.inotify_add_watch(self._fd, os.fsencode(path), _IN_OPEN))
        assert number not in self._callbacks, f"{path} is watched already"
        self._callbacks[number] = callback
        return number

    def remove(self, number: int) -> None:
        """Call nothing for that any more, whether the file is still there or not."""
        del self._callbacks[number]
        self._libc.inotify_rm_watch(self._fd, number)

    def tell(self) -> None:
        """Call all whose files have been opened since last time, each once."""
        notices = b""
        with contextlib.suppress(BlockingIOError):
            notices = os.read(self._fd, _NOTICES_MAX * _NOTICE.size)
        opened = dict.fromkeys(number for number, *_ in _NOTICE.iter_unpack(notices))
        for number in tuple(self._callbacks) if _DROPPED in opened else opened:
            callback = self._callbacks.get(number)  # an earlier one may have removed this one
            if callback is not None:
                callback()

    def close(self) -> None:
        """Give the instance back."""
        os.close(self._fd)


def _checked(result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result
