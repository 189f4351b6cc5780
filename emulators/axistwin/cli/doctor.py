"""``axistwin doctor``: which parts of axistwin work on this machine, each with its remedy if not.

A check is one function that returns what it found, or raises ``Lack`` with the remedy.
"""

import importlib.util
import json
import os
import re
import select
import socket
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from textwrap import wrap

import click

from axistwin.ports import socketcan
from axistwin.ports.hid import uhid

EXIT_LACKING = 1
SCREEN_COLUMNS = 80
INDENT = " " * 29
_HIDRAW_CLASS = Path("/sys/class/hidraw")


class Lack(Exception):  # noqa: N818 - a finding, not a failure of ours
    """What is missing, and the remedy."""

    def __init__(self, found: str, remedy: str) -> None:
        super().__init__(found)
        self.found = found
        self.remedy = remedy


@dataclass(frozen=True, slots=True)
class Finding:
    """The outcome of one check; ``needed``: without it ``axistwin run`` cannot do its work."""

    name: str
    ok: bool
    needed: bool
    found: str
    remedy: str = ""


def check_pty() -> str:
    """A pseudo terminal can be made, and carries bytes."""
    import pty
    import tty

    try:
        master, slave = pty.openpty()
    except OSError as error:
        raise Lack(
            f"no pseudo terminal to be had ({error.strerror})",
            "mount devpts at /dev/pts, or raise kernel.pty.max; --tcp works without",
        ) from None
    try:
        tty.setraw(slave)
        os.write(master, b"\x13")
        if not select.select([slave], [], [], 1.0)[0] or os.read(slave, 1) != b"\x13":
            raise Lack("a pseudo terminal does not carry bytes", "use --tcp or --rfc2217")
        return f"works ({os.ttyname(slave)})"
    finally:
        os.close(master)
        os.close(slave)


def check_inotify() -> str:
    """A client that opens a pty can be noticed."""
    import ctypes

    libc = ctypes.CDLL(None, use_errno=True)
    fd = libc.inotify_init1(os.O_CLOEXEC)
    if fd < 0:
        raise Lack(
            f"inotify fails ({os.strerror(ctypes.get_errno())})",
            "sysctl fs.inotify.max_user_instances=512",
        )
    os.close(fd)
    return "works"


def check_loopback() -> str:
    """A TCP port on the loopback can be served and reached."""
    try:
        with (
            socket.create_server(("127.0.0.1", 0)) as server,
            socket.create_connection(server.getsockname(), timeout=1.0),
        ):
            return "works (127.0.0.1)"
    except OSError as error:
        raise Lack(f"127.0.0.1 fails ({error.strerror or error})", "ip link set lo up") from None


def check_folder() -> str:
    """A link and a state folder can be made here."""
    here = Path.cwd()
    try:
        with tempfile.TemporaryDirectory(prefix=".axistwin-", dir=here):
            return f"{here} is writable"
    except OSError as error:
        raise Lack(
            f"{here} cannot be written ({error.strerror})",
            "go to a folder of yours, or give --pty and --state paths that are",
        ) from None


def check_real_ports() -> str:
    """Serial ports of this machine, for judging a real device."""
    from serial.tools import list_ports

    ports = [port.device for port in list_ports.comports()]
    if not ports:
        raise Lack("none found", "plug in an adapter; a twin needs none")
    denied = [port for port in ports if not os.access(port, os.R_OK | os.W_OK)]
    if denied:
        raise Lack(
            f"no permission for {', '.join(denied)}",
            "sudo usermod -aG dialout $USER, then log in again",
        )
    return ", ".join(ports)


def check_can() -> str:
    """CAN in the kernel, for the CAN models; without it they are served by an slcan pty."""
    found = {name: socketcan.link_state(name) for name in socketcan.interfaces()}
    if not socketcan.kernel_has_can():
        raise Lack(
            "the kernel has no CAN",
            f"--slcan works without; on a CAN kernel: {socketcan.REMEDY.format('vcan0')}",
        )
    if not found:
        raise Lack("CAN works, but there is no interface", socketcan.remedy("vcan0"))
    shown = ", ".join(f"{name} ({state})" for name, state in sorted(found.items()))
    if "up" not in found.values():
        raise Lack(shown, socketcan.remedy(min(found)))
    return shown


def check_python_can() -> str:
    """Interfaces of python-can that reach a bus without a driver of their own."""
    import can

    shown = f"python-can {can.__version__}: slcan, socketcan, socketcand, virtual"
    if importlib.util.find_spec("msgpack") is None:
        raise Lack(f"{shown}; not udp_multicast", "pip install msgpack")
    return f"{shown}, udp_multicast"


def check_uhid() -> str:
    """HID devices made by programs: what ``axistwin run --hid`` needs, and nothing else does."""
    lack = uhid.missing()
    if lack is not None:
        found, remedy = lack
        raise Lack(
            f"{found}; only 'run --hid' needs it", f"axistwin.hid works without; else: {remedy}"
        )
    return "works"


def check_hidraw() -> str:
    """HID devices that programs can open: for judging a real one."""
    if not _HIDRAW_CLASS.exists():
        raise Lack(
            "the kernel has no hidraw; only 'conform --hid' needs it",
            "use a kernel with CONFIG_HIDRAW; a board on its serial line needs none",
        )
    nodes = [Path("/dev", entry.name) for entry in sorted(_HIDRAW_CLASS.iterdir())]
    if not nodes:
        raise Lack("no HID device found", "plug in a board; a twin needs none")
    denied = [str(node) for node in nodes if not os.access(node, os.R_OK | os.W_OK)]
    if denied:
        raise Lack(
            f"no permission for {', '.join(denied)}",
            f"run as root, or: sudo chown $USER {' '.join(denied)}",
        )
    return ", ".join(map(str, nodes))


def check_suite() -> str:
    """The conformance suite and what it needs."""
    if importlib.util.find_spec("axistwin_conformance") is None:
        raise Lack("axistwin_conformance is missing", "install axistwin again: it brings it along")
    needed = ("hypothesis", "jinja2", "rich")
    missing = [name for name in needed if importlib.util.find_spec(name) is None]
    if missing:
        raise Lack(f"missing: {', '.join(missing)}", f"pip install {' '.join(missing)}")
    return "installed"


# Name, whether "run" needs it, the check.
CHECKS: tuple[tuple[str, bool, Callable[[], str]], ...] = (
    ("pseudo terminals", True, check_pty),
    ("inotify", True, check_inotify),
    ("loopback TCP", True, check_loopback),
    ("current folder", True, check_folder),
    ("serial ports", False, check_real_ports),
    ("CAN interfaces", False, check_can),
    ("CAN without kernel", False, check_python_can),
    ("USB HID (uhid)", False, check_uhid),
    ("USB HID (hidraw)", False, check_hidraw),
    ("conformance suite", False, check_suite),
)


def examine() -> list[Finding]:
    """The findings of all checks."""
    findings = []
    for name, needed, check in CHECKS:
        try:
            findings.append(Finding(name, True, needed, check()))
        except Lack as lack:
            findings.append(Finding(name, False, needed, lack.found, lack.remedy))
    return findings


def _shown(finding: Finding) -> str:
    """A finding on lines of a terminal's width; commands of a remedy are not broken."""
    mark = "ok" if finding.ok else "MISSING" if finding.needed else "optional"
    start = f"{mark:9} {finding.name:18} "
    lines = wrap(finding.found, SCREEN_COLUMNS, initial_indent=start, subsequent_indent=INDENT)
    remedy = re.sub(r"(?<=: )(?=sudo )|(?<= && )", "\n", finding.remedy)
    for part in f"remedy: {remedy}".splitlines() if remedy else ():
        lines += wrap(part, SCREEN_COLUMNS, initial_indent=INDENT, subsequent_indent=INDENT)
    return "\n".join(lines)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per line.")
@click.pass_context
def doctor(ctx: click.Context, as_json: bool) -> None:
    """Check this machine, and show the remedy for what is missing.

    \b
    ok        works
    optional  missing; only what the line names needs it
    MISSING   'axistwin run' needs it

    Exit status 1 if anything is MISSING, else 0.
    """
    findings = examine()
    for finding in findings:
        if as_json:
            click.echo(json.dumps(asdict(finding)))
            continue
        click.echo(_shown(finding))
    ctx.exit(EXIT_LACKING if any(f.needed and not f.ok for f in findings) else 0)
