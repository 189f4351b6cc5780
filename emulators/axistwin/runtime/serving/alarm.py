"""One alarm as a file descriptor, exact to microseconds.

An event loop's own timers wake up to a millisecond late, because they round their time-out up to
what ``epoll_wait`` takes.  That is longer than a whole character at 38400 baud.  Linux's timerfd
is a file descriptor that becomes readable at its time, so any loop can wait for it.
"""

import ctypes
import os

from axistwin.kernel.time import NS_PER_S

_CLOCK_MONOTONIC = 1
_FLAGS = os.O_NONBLOCK | os.O_CLOEXEC  # what TFD_NONBLOCK and TFD_CLOEXEC are defined as


class _Setting(ctypes.Structure):
    """``struct itimerspec``: first the interval (0: once), then the delay."""

    _fields_ = (
        ("interval_s", ctypes.c_long),
        ("interval_ns", ctypes.c_long),
        ("delay_s", ctypes.c_long),
        ("delay_ns", ctypes.c_long),
    )


class Alarm:
    """Readable (see ``fileno``) once the delay given to ``set`` has passed, until ``clear``."""

    def __init__(self) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self._settime = libc.timerfd_settime
        self._fd: int = libc.timerfd_create(_CLOCK_MONOTONIC, _FLAGS)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        self._setting = _Setting()
        self._reference = ctypes.byref(self._setting)

    def fileno(self) -> int:
        """The descriptor to wait for."""
        return self._fd

    def set(self, delay_ns: int) -> None:
        """Go off once, ``delay_ns`` from now; replaces what was set before.

        A delay that is over already goes off at once.
        """
        # A delay of 0 would mean "off".
        seconds, nanoseconds = divmod(max(delay_ns, 1), NS_PER_S)
        self._setting.delay_s, self._setting.delay_ns = seconds, nanoseconds
        self._settime(self._fd, 0, self._reference, None)

    def clear(self) -> None:
        """Do not go off; what has gone off and was not noticed is forgotten."""
        self._setting.delay_s = self._setting.delay_ns = 0
        self._settime(self._fd, 0, self._reference, None)

    def close(self) -> None:
        """Give the descriptor back."""
        os.close(self._fd)
