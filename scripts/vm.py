"""Runs a command in a small virtual machine whose kernel has CAN, and gives back what it gives.

Inside are the host's own files (read-only, under a memory file system: whatever the command writes
is gone afterwards), the same directory, the same environment, root, can-utils, and two CAN buses
vcan0 and vcan1.  Standard input is empty; there is no network but the loopback; what the command
leaves in the background ends with it.  The machine is User-Mode Linux, a kernel that is an ordinary
process: it needs no KVM, and the command's own code runs at the host's speed.

What it needs is downloaded once with apt-get and unpacked, never installed, in axistwin-vm below
$XDG_CACHE_HOME or ~/.cache.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import NoReturn

EXAMPLES = """
exit status: the command's own (128 + n if signal n ended it); 124 when its time is up; 125 when the
machine itself cannot start or fails, with the reason on stderr.

examples:
  scripts/vm ip link show vcan0
  scripts/vm sh -c 'candump -n 1 vcan0 & sleep 0.2; cansend vcan0 601#4000100000000000; wait'
  scripts/vm --write reports python -m pytest -m vcan --junitxml=reports/vcan.xml
"""

STATUS_TIMEOUT = 124
STATUS_FAILED = 125
BOOT_TIMEOUT_S = 60.0
"""A kernel that has not come to the command by then is stuck; usual are 1 to 3 s."""

GUEST = Path(__file__).with_name("vm_guest.sh")
UML_PACKAGES = ("user-mode-linux", "busybox-static", "can-utils")
UML_FOLDER = "uml-3"
"""Its place in the cache.  Count up when the packages or what is kept of them change."""
UML_MODULES = ("overlay", "can-raw", "can-bcm", "vcan", "slcan")

UML_FASTER = (
    # Speed trials and file systems that nobody here uses: 1.5 s of the 2 s that the kernel takes.
    "initcall_blacklist=raid6_select_algo,init_btrfs_fs,init_zswap",
    "pty.legacy_count=0",
)

NESTED_MARK = "AXISTWIN_VM"
"""Set inside, so that tests can tell 'absent here' from 'must be there'."""


Launch = Callable[[int, int], list[str]]
"""A kernel's command line, given the file descriptors for the command's stdout and stderr."""


class VmError(Exception):
    """The machine cannot do what it should; the text says why and what helps."""


@dataclass(frozen=True, slots=True)
class Job:
    """What to run: the command, folders that it may write, its limits."""

    command: Sequence[str]
    writable: Sequence[Path]
    timeout_s: float
    memory_mb: int


# ---------------------------------------------------------------------------------------------
# The cache


def cache_folder(environment: Mapping[str, str]) -> Path:
    """Where downloads are kept; never inside the project, and independent of a missing HOME."""
    for name, below in (("XDG_CACHE_HOME", ""), ("HOME", ".cache")):
        if environment.get(name, "").startswith("/"):
            return Path(environment[name], below, "axistwin-vm")
    return Path(f"/var/tmp/axistwin-vm-{os.getuid()}")


def prepared(cache: Path, name: str, build: Callable[[Path, Path], None]) -> Path:
    """The folder ``name`` of the cache, which ``build(staging, folder)`` fills the first time.

    Of several callers one builds and the others wait.  A folder appears complete or not at all.
    """
    folder = cache / name
    if folder.is_dir():
        return folder
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with (cache / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not folder.is_dir():
                with tempfile.TemporaryDirectory(prefix="new-", dir=cache) as staging:
                    made = Path(staging, "made")
                    made.mkdir()
                    build(Path(staging), made)
                    made.rename(folder)
    except OSError as error:
        raise VmError(
            f"cannot fill the cache {cache}: {error}; name a writable folder in XDG_CACHE_HOME"
        ) from error
    return folder


def unpack_packages(packages: Sequence[str], staging: Path) -> Path:
    """Download Debian packages and unpack them into a folder, without installing anything.

    The host's package lists are tried first.  Where they are missing or out of date, fresh ones are
    fetched into ``staging``: that needs no root and leaves the host as it was.
    """
    for program in ("apt-get", "dpkg-deb"):
        if shutil.which(program) is None:
            raise VmError(
                f"{program} is needed to fetch {', '.join(packages)}: use Debian or Ubuntu"
            )
    say(f"downloading {', '.join(packages)} (first time)")
    debs, root = staging / "debs", staging / "root"
    debs.mkdir()
    # Whoever runs this may write here; the user "_apt" may not.
    apt = ["apt-get", "-q", "-o", "APT::Sandbox::User=root"]
    download = ["download", *packages]
    if run_quietly([*apt, *download], debs) is not None:
        for folder in ("lists/partial", "archives/partial"):
            (staging / folder).mkdir(parents=True)
        apt += ["-o", f"Dir::State::Lists={staging}/lists", "-o", f"Dir::Cache={staging}"]
        for step in (["update"], download):
            reason = run_quietly([*apt, *step], debs)
            if reason is not None:
                raise VmError(
                    f"'apt-get {' '.join(step)}' fails: {reason}; "
                    "check the network and /etc/apt/sources.list (Debian's 'main' is needed)"
                )
    for deb in sorted(debs.glob("*.deb")):
        reason = run_quietly(["dpkg-deb", "-x", str(deb), str(root)], debs)
        if reason is not None:
            raise VmError(f"cannot unpack {deb.name}: {reason}; is there room in {staging.parent}?")
    return root


def run_quietly(command: Sequence[str], directory: Path) -> str | None:
    """Run a helper program; None when it succeeds, else the line of its output that says why."""
    done = subprocess.run(
        command, cwd=directory, capture_output=True, text=True, errors="replace", check=False
    )
    if done.returncode == 0:
        return None
    lines = [line.strip() for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("E:")]
    return (errors or lines or [f"status {done.returncode}"])[-1]


def module_order(names: Sequence[str], files: Mapping[str, Path]) -> list[Path]:
    """Kernel modules and what they depend on, each after what it needs; built-in ones left out."""
    order: list[Path] = []

    def need(name: str) -> None:
        file = files.get(name.replace("-", "_"))
        if file is None or file in order:
            return
        found = re.search(rb"\0depends=([^\0]*)\0", file.read_bytes())
        for dependency in found[1].decode().split(",") if found else []:
            need(dependency)
        order.append(file)

    for name in names:
        need(name)
    return order


def build_uml(staging: Path, made: Path) -> None:
    """Fetch the kernel and the programs, and keep what is used of them (14 MB of 120)."""
    root = unpack_packages(UML_PACKAGES, staging)
    files = {
        file.stem.replace("-", "_"): file for file in (root / "usr/lib/uml/modules").rglob("*.ko")
    }
    (made / "modules").mkdir()
    for number, file in enumerate(module_order(UML_MODULES, files)):
        shutil.copy(file, made / "modules" / f"{number:02}-{file.name}")
    shutil.copy(root / "usr/bin/linux.uml", made / "linux")
    shutil.copy(root / "bin/busybox", made / "busybox")
    shutil.copytree(root / "usr/bin", made / "bin", ignore=shutil.ignore_patterns("*uml*"))
    (made / "bin" / "ip").symlink_to("../busybox")  # small installations have no iproute2


# ---------------------------------------------------------------------------------------------
# The run's folder: what the guest is told


def write_command(job: Job, run: Path, programs: Path) -> None:
    """The script that becomes the command: same environment, same directory."""
    environment = dict(os.environ)
    # At the end: what the host or .venv has comes first.
    environment["PATH"] = f"{environment.get('PATH', os.defpath)}:{programs}"
    environment[NESTED_MARK] = "1"
    lines = [
        f"export {name}={shlex.quote(value)}"
        for name, value in sorted(environment.items())
        if re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII)
    ]
    directory = Path.cwd()
    lines.append(f"cd {shlex.quote(str(directory))} || exit {STATUS_FAILED}")
    lines.append(f"exec {shlex.join(job.command)}")
    (run / "command").write_bytes(os.fsencode("\n".join(lines) + "\n"))


def write_shares(job: Job, run: Path) -> None:
    """The host's folders that the guest may write, the run's own first."""
    folders = [run, *job.writable]
    (run / "shares").write_bytes(b"".join(os.fsencode(folder) + b"\n" for folder in folders))


def write_uml_init(run: Path, folder: Path) -> Path:
    """Process 1 of the User-Mode Linux: it starts on the host's own files."""
    top = run / "top"
    top.mkdir()
    settings = {
        "BUSYBOX": folder / "busybox",
        "RUN": run,
        "LOWER": "/",
        "TOP": top,
        "OUT": "ttyS0",
        "ERR": "ttyS1",
        "FSTYPE": "hostfs",
    }
    init = run / "init"
    lines = ["#!/bin/sh", *(f"{name}={shlex.quote(str(it))}" for name, it in settings.items())]
    lines.append('share_options() { printf %s "$2"; }')
    lines.append('"$BUSYBOX" mount -t proc proc /proc')
    for module in sorted((folder / "modules").iterdir()):
        lines.append(f'"$BUSYBOX" insmod {shlex.quote(str(module))}')
    lines.append(f". {shlex.quote(str(GUEST))}")
    init.write_text("\n".join(lines) + "\n", encoding="utf-8")
    init.chmod(0o755)
    return init


def memory_folder(memory_mb: int) -> Path:
    """Where the guest's memory can live: a file that may be executed, with room for all of it."""
    looked_at = []
    for folder in (Path("/dev/shm"), Path(tempfile.gettempdir()), Path("/var/tmp")):
        with contextlib.suppress(OSError):
            facts = os.statvfs(folder)
            free_mb = facts.f_bavail * facts.f_frsize >> 20
            executable = not facts.f_flag & os.ST_NOEXEC
            if executable and free_mb >= memory_mb and os.access(folder, os.W_OK | os.X_OK):
                return folder
            looked_at.append(f"{folder} has {free_mb} MB" + ("" if executable else ", noexec"))
    raise VmError(
        f"no folder can hold the guest's {memory_mb} MB of memory ({'; '.join(looked_at)}); "
        "ask for less with --memory, or name another folder in TMPDIR"
    )


# ---------------------------------------------------------------------------------------------
# The machine


@dataclass
class Machine:
    """A running kernel: its process group, and the copying of its two streams to our own."""

    process: subprocess.Popen[bytes]
    relays: list[threading.Thread] = field(default_factory=list)
    reader_gone: bool = False

    def end(self) -> None:
        """End the kernel and the processes it uses; nothing of it is left afterwards."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def relay(self, source: int, target: int) -> None:
        """Copy everything that comes out of ``source`` to ``target`` in a thread."""

        def copy() -> None:
            try:
                while data := os.read(source, 1 << 16):
                    while data:
                        data = data[os.write(target, data) :]
            except BrokenPipeError:
                self.reader_gone = True
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self.process.pid, signal.SIGKILL)
            finally:
                os.close(source)

        thread = threading.Thread(target=copy, daemon=True)
        thread.start()
        self.relays.append(thread)


@contextlib.contextmanager
def started(launch: Launch, run: Path, memory: Path) -> Iterator[Machine]:
    """Start a kernel, and end it when the block ends."""
    (out_read, out_write), (err_read, err_write) = os.pipe(), os.pipe()
    # The kernel is a group of processes of its own: Ctrl-C reaches only us, and we end it by that
    # group.  Should we be killed, setpriv's death signal makes it end by itself.
    command = ["setpriv", "--pdeathsig", "TERM", "--", *launch(out_write, err_write)]
    with (run / "console").open("wb") as console:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=console,
            env={"PATH": os.defpath, "TMPDIR": str(memory)},
            pass_fds=(out_write, err_write),
            start_new_session=True,
        )
    machine = Machine(process)
    try:
        os.close(out_write)
        os.close(err_write)
        machine.relay(out_read, 1)
        machine.relay(err_read, 2)
        yield machine
    finally:
        machine.end()


def uml_arguments(job: Job, run: Path, folder: Path) -> Launch:
    """The kernel's command line, for the two file descriptors that its serial lines write to."""
    init = write_uml_init(run, folder)
    return lambda out, err: [
        *(str(folder / "linux"), f"mem={job.memory_mb}M", f"init={init}", f"uml_dir={run}"),
        *("root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro", "quiet", *UML_FASTER),
        *("con=null", "con0=null,fd:2", "con1=null"),
        *("ssl=null", f"ssl0=null,fd:{out}", f"ssl1=null,fd:{err}"),
    ]


def wait_for_status(machine: Machine, job: Job, run: Path) -> int:
    """Wait until the command or its time ends; the status to hand on."""
    try:
        with contextlib.suppress(subprocess.TimeoutExpired):
            machine.process.wait(min(job.timeout_s, BOOT_TIMEOUT_S))
        if machine.process.poll() is None:
            if job.timeout_s > BOOT_TIMEOUT_S and not (run / "started").exists():
                raise failure(f"the kernel is not up after {BOOT_TIMEOUT_S:.0f} s", run)
            machine.process.wait(max(job.timeout_s - BOOT_TIMEOUT_S, 0.0))
    except subprocess.TimeoutExpired:
        machine.end()
        for thread in machine.relays:
            thread.join(1.0)  # longer only where our own reader sleeps
        say(f"no end after {job.timeout_s:g} s: stopped")
        return STATUS_TIMEOUT
    machine.end()
    for thread in machine.relays:
        thread.join()
    if machine.reader_gone:
        return 128 + signal.SIGPIPE
    with contextlib.suppress(OSError, ValueError):
        return int((run / "status").read_text(encoding="ascii"))
    raise failure(f"the kernel ended without a result (status {machine.process.returncode})", run)


def failure(what: str, run: Path) -> VmError:
    """An error with the kernel's last words, and the usual remedies."""
    console = (run / "console").read_text(encoding="utf-8", errors="replace")
    words = "".join(f"\n  | {line.rstrip()}" for line in console.splitlines()[-12:])
    return VmError(
        f"{what}. User-Mode Linux needs ptrace (in a container: --cap-add SYS_PTRACE "
        f"--security-opt seccomp=unconfined) and the memory of --memory. Its last words:{words}"
    )


def run_job(job: Job) -> int:
    """Prepare what is needed, run the command in a new machine, return its status."""
    folder = prepared(cache_folder(os.environ), UML_FOLDER, build_uml)
    memory = memory_folder(job.memory_mb)
    with tempfile.TemporaryDirectory(prefix="axistwin-vm-") as name:
        run = Path(name).resolve()
        for place in (run, *job.writable):
            if re.search(r"[\s,]", str(place)):
                raise VmError(f"a folder's name may not have spaces or commas: {str(place)!r}")
        write_command(job, run, folder / "bin")
        write_shares(job, run)
        with started(uml_arguments(job, run, folder), run, memory) as machine:
            return wait_for_status(machine, job, run)


# ---------------------------------------------------------------------------------------------
# The command line


def say(text: str) -> None:
    """Tell the user, apart from the command's own output."""
    print(f"vm: {text}", file=sys.stderr, flush=True)


class Parser(argparse.ArgumentParser):
    """Ends with the status that means 'not the command's fault'."""

    def error(self, message: str) -> NoReturn:
        """Print one line and leave."""
        say(f"{message} (see scripts/vm --help)")
        raise SystemExit(STATUS_FAILED)


def folder_argument(text: str) -> Path:
    """A folder that exists, as an absolute path."""
    folder = Path(text).resolve()
    if not folder.is_dir():
        raise argparse.ArgumentTypeError(f"there is no folder {text!r}; make it first")
    return folder


def seconds_argument(text: str) -> float:
    """A time above zero."""
    with contextlib.suppress(ValueError):
        if 0 < float(text) < float("inf"):
            return float(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds above 0")


def memory_argument(text: str) -> int:
    """An amount of memory in which the kernel and a small command fit."""
    with contextlib.suppress(ValueError):
        if 128 <= int(text) <= 16384:
            return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a number of megabytes from 128 to 16384")


def parse(arguments: Sequence[str]) -> Job:
    """The job that the command line asks for."""
    parser = Parser(
        prog="scripts/vm",
        description=__doc__,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--write",
        metavar="DIR",
        type=folder_argument,
        action="append",
        default=[],
        help="what the command writes here stays (reports); may be given several times",
    )
    parser.add_argument(
        "--timeout",
        metavar="SECONDS",
        type=seconds_argument,
        default=600.0,
        help="stop the machine after this time, with status 124 (default 600)",
    )
    parser.add_argument(
        "--memory",
        metavar="MB",
        type=memory_argument,
        default=1024,
        help="the guest's memory, taken only as far as it is used (default 1024)",
    )
    parser.add_argument("command", metavar="COMMAND...", nargs=argparse.REMAINDER)
    options = parser.parse_args(arguments)
    command = options.command[1:] if options.command[:1] == ["--"] else options.command
    if not command:
        parser.error("a command is needed, such as: scripts/vm ip link show vcan0")
    return Job(command, options.write, options.timeout, options.memory)


def leave(number: int, _frame: FrameType | None) -> NoReturn:
    """End by a signal: the machine is ended on the way out."""
    raise SystemExit(128 + number)


def main() -> int:
    """Parse the arguments, run the command, hand on its status."""
    job = parse(sys.argv[1:])
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, leave)
    try:
        if os.environ.get(NESTED_MARK):
            raise VmError("this is the virtual machine already; run the command itself")
        return run_job(job)
    except VmError as error:
        say(str(error))
        return STATUS_FAILED


if __name__ == "__main__":
    raise SystemExit(main())
