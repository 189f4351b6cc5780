"""A stable name for a pty: a symbolic link that only one living process may serve.

Rules
-----
1. A link is served by whoever holds its lock, a name in Linux's abstract socket space that is made
   of the link's path.  The kernel drops it with the process, however that ends, and it leaves
   nothing in the folder.
2. Only what a dead process has left is ever replaced: a link to a pty that is gone, or to one that
   was made after the link, for its number is given again.  It is replaced atomically, so that the
   name is never missing and a file of the user's is never lost.
3. It is removed by its owner alone, and only while it still points to the owner's pty.
"""

import contextlib
import errno
import glob
import hashlib
import os
import socket
from pathlib import Path

from axistwin.errors import PortError

_PTY_FOLDER = "/dev/pts/"

# The kernel's device numbers of Unix98 ptys, client's side.
_PTY_MAJORS = range(136, 144)


class Link:
    """The symbolic link at ``path``; ``claim`` it, ``point`` it somewhere, ``remove`` it.

    option: that of the command line which chose the path, for the remedy in messages.
    """

    def __init__(self, path: str, option: str = "--pty") -> None:
        self.path = Path(path)
        self._option = option
        self._lock: socket.socket | None = None
        self._target: str | None = None

    def claim(self) -> None:
        """Make sure that the path is ours to use.  Raises PortError."""
        if not self.path.name:
            raise PortError("pty link: needs a name, such as ./mac23")
        folder = self.path.parent
        if not folder.is_dir():
            raise PortError(f"pty link {self.path}: there is no folder {folder}; create it first")
        place = folder.resolve() / self.path.name
        lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            # A digest, because such a name has room for 107 bytes only.
            digest = hashlib.sha256(os.fsencode(place)).hexdigest()
            lock.bind(f"\0axistwin-link:{digest}")
        except OSError as error:
            lock.close()
            if error.errno != errno.EADDRINUSE:
                raise
            raise PortError(
                f"pty link {self.path}: in use, another axistwin serves it; "
                f"choose another {self._option}"
            ) from None
        self._lock = lock
        try:
            what = self._in_the_way()
        except OSError as error:
            raise PortError(
                f"pty link {self.path}: cannot be created ({error.strerror}); "
                f"choose another {self._option}"
            ) from None
        if what is not None:
            raise PortError(
                f"pty link {self.path}: {what} is there, which will not be replaced; "
                f"choose another {self._option} or remove it"
            )
        for leftover in folder.glob(f".{glob.escape(self.path.name)}.[0-9]*"):
            if leftover.is_symlink():  # of one that was killed in the middle of ``point``
                leftover.unlink(missing_ok=True)

    def _in_the_way(self) -> str | None:
        """What is at the path and must stay; None for nothing, or what a dead process has left."""
        if not self.path.is_symlink():
            if not self.path.exists():
                return None
            return "a folder" if self.path.is_dir() else "a file"
        target = str(self.path.readlink())
        if not target.startswith(_PTY_FOLDER):
            return f"a link to {target}"
        with contextlib.suppress(OSError):  # the pty, or by now the link, is gone
            made_ns = self.path.lstat().st_mtime_ns
            pty = Path(target).stat()
            if os.major(pty.st_rdev) in _PTY_MAJORS and pty.st_ctime_ns <= made_ns:
                return f"another program's link to {target}, which is in use,"
        return None

    def point(self, target: str) -> None:
        """Make the link point to ``target``.  Raises PortError."""
        new = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        try:
            new.unlink(missing_ok=True)
            new.symlink_to(target)
            new.replace(self.path)
        except OSError as error:
            raise PortError(
                f"pty link {self.path}: cannot be created ({error.strerror}); "
                f"choose another {self._option}"
            ) from None
        self._target = target

    def remove(self) -> None:
        """Remove the link if it is still ours, and let go of the name."""
        if self._target is not None:
            with contextlib.suppress(OSError):
                if str(self.path.readlink()) == self._target:
                    self.path.unlink()
            self._target = None
        if self._lock is not None:
            self._lock.close()
            self._lock = None
