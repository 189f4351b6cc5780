"""Runs a command in a small virtual machine whose kernel has CAN, and gives back what it gives.

Inside are the host's own files (read-only, under a memory file system: whatever the command writes
is gone afterwards), the same directory, the same environment, root, can-utils, and two CAN buses
vcan0 and vcan1.  Standard input is empty; there is no network but the loopback; what the command
leaves in the background ends with it.  The machine is User-Mode Linux, a kernel that is an ordinary
process: it needs no KVM, and the command's own code runs at the host's speed.  With --uhid it is
Debian's kernel in QEMU, without KVM too.

What it needs is downloaded once with apt-get and unpacked, never installed, in axistwin-vm below
$XDG_CACHE_HOME or ~/.cache.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import NoReturn

sys.path.insert(0, str(Path(__file__).parents[1]))

from scripts.vm_cache import (
    SHARED_FOLDER,
    VmError,
    build_qemu,
    build_uml,
    cache_folder,
    prepared,
    say,
)

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
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
ANSWER_S = 0.05
BOOT_TIMEOUT_S = 60.0  # a kernel that has not come to the command is stuck; usual are 1 to 4 s

GUEST = Path(__file__).with_name("vm_guest.sh")

# Without speed trials and file systems that nobody here uses: 0.3 s instead of 2 s.
UML_FASTER = ("initcall_blacklist=raid6_select_algo,init_btrfs_fs,init_zswap", "pty.legacy_count=0")
# The kernel measures the processor's own clock at the start, on a busy host wrongly: time then ran
# six times too fast.  HPET follows the host's time by itself.
QEMU_CLOCK = "tsc=unstable clocksource=hpet"
QEMU_FASTER = f"{QEMU_CLOCK} no_timer_check mitigations=off nokaslr apparmor=0 random.trust_cpu=on"

NESTED_MARK = "AXISTWIN_VM"  # set inside, so that tests can tell 'absent here' from 'must be there'

# A kernel's command line and environment, given file descriptors for the two streams.
Launch = Callable[[int, int], tuple[list[str], dict[str, str]]]


@dataclass(frozen=True, slots=True)
class Job:
    """What to run: the command, folders that it may write, its limits."""

    command: Sequence[str]
    writable: Sequence[Path]
    timeout_s: float
    memory_mb: int
    uhid: bool


# ---- The run's folder: what the guest is told ----


def write_command(job: Job, run: Path, programs: Path) -> None:
    """The script that becomes the command, and the list of folders that it may write."""
    environment = {**os.environ, NESTED_MARK: "1"}
    # At the end: what the host or .venv has comes first.
    environment["PATH"] = f"{environment.get('PATH', os.defpath)}:{programs}"
    lines = [
        f"export {name}={shlex.quote(value)}"
        for name, value in sorted(environment.items())
        if re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII)
    ]
    lines.append(f"cd {shlex.quote(str(Path.cwd()))} || exit {STATUS_FAILED}")
    lines.append(f"exec {shlex.join(job.command)}")
    (run / "command").write_bytes(os.fsencode("\n".join(lines) + "\n"))
    folders = [run, *job.writable]
    (run / "shares").write_bytes(b"".join(os.fsencode(folder) + b"\n" for folder in folders))


def write_init(run: Path, settings: Mapping[str, object]) -> Path:
    """What process 1 of the guest runs: its settings, then vm_guest.sh."""
    lines = [f"{name}={shlex.quote(str(value))}" for name, value in settings.items()]
    init = run / "init"
    text = "\n".join(["#!/bin/sh", *lines, f'. "$LOWER"{shlex.quote(str(GUEST))}', ""])
    init.write_text(text, encoding="utf-8")
    init.chmod(0o755)
    return init


def memory_folder(memory_mb: int) -> Path:
    """Where the guest's memory can live: a file that may be executed, with room for all of it."""
    looked_at = []
    for folder in (Path("/dev/shm"), Path(tempfile.gettempdir()), SHARED_FOLDER):
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


# ---- The machine ----


@dataclass
class Machine:
    """A running kernel: its process group, and the copying of its two streams to our own."""

    process: subprocess.Popen[bytes]
    guard: subprocess.Popen[bytes]
    relays: list[threading.Thread] = field(default_factory=list)
    taken_bytes: dict[int, int] = field(default_factory=dict)
    """What has come out of each stream, by the descriptor that it goes to."""
    reader_gone: bool = False
    ended: bool = False

    def end(self) -> None:
        """End the kernel and the processes it uses; nothing of it is left afterwards."""
        if not self.ended:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
            self.guard.kill()
            self.guard.communicate()
            self.ended = True

    def relay(self, source: int, target: int) -> None:
        """Copy everything that comes out of ``source`` to ``target`` in a thread."""

        def copy() -> None:
            try:
                while data := os.read(source, 1 << 16):
                    self.taken_bytes[target] += len(data)
                    while data:
                        data = data[os.write(target, data) :]
            except BrokenPipeError:
                self.reader_gone = True
                self.process.kill()
            finally:
                os.close(source)

        os.set_blocking(target, True)
        self.taken_bytes[target] = 0
        thread = threading.Thread(target=copy, daemon=True)
        thread.start()
        self.relays.append(thread)


@contextlib.contextmanager
def started(launch: Launch, run: Path) -> Iterator[Machine]:
    """Start a kernel, and end it when the block ends."""
    (out_read, out_write), (err_read, err_write) = os.pipe(), os.pipe()
    arguments, environment = launch(out_write, err_write)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)  # no end between start and try
    # A session of its own: Ctrl-C reaches only us, and all that belongs to the kernel is one group.
    with (run / "console").open("wb") as console:
        process = subprocess.Popen(
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=console,
            env={"PATH": os.defpath, **environment},
            pass_fds=(out_write, err_write),
            start_new_session=True,
        )
    # Should we be killed, the guard's input ends, and it ends the group.
    guard = ["/bin/sh", "-c", 'read -r _; kill -KILL "-$0"', str(process.pid)]
    pipe = subprocess.PIPE
    machine = Machine(process, subprocess.Popen(guard, stdin=pipe, start_new_session=True))
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        os.close(out_write)
        os.close(err_write)
        machine.relay(out_read, 1)
        machine.relay(err_read, 2)
        yield machine
    finally:
        machine.end()


def wait_for_end(machine: Machine, run: Path, timeout_s: float) -> None:
    """Until the machine ends, answering its question whether all it has sent is here.

    Raises TimeoutExpired.
    """
    end_s = time.monotonic() + timeout_s
    while True:
        try:
            machine.process.wait(min(ANSWER_S, max(end_s - time.monotonic(), 0.0)))
            return
        except subprocess.TimeoutExpired:
            if time.monotonic() >= end_s:
                raise
        with contextlib.suppress(FileNotFoundError):
            sent = (run / "sent").read_text(encoding="ascii").split()
            if [int(each) for each in sent] == list(machine.taken_bytes.values()):
                (run / "taken").touch()


def uml_launch(job: Job, run: Path, folder: Path) -> Launch:
    """User-Mode Linux, which starts on the host's own files."""
    top = run / "top"
    top.mkdir()
    own = {"BUSYBOX": folder / "busybox", "MODULES": folder / "modules"}
    init = write_init(run, {"FSTYPE": "hostfs", "LOWER": "/", "TOP": top, "RUN": run, **own})
    memory = memory_folder(job.memory_mb)
    return lambda out, err: (
        [
            *(str(folder / "linux"), f"mem={job.memory_mb}M", f"init={init}", f"uml_dir={run}"),
            *("root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro", "quiet", *UML_FASTER),
            *("con=null", "con0=null,fd:2", "con1=null"),
            *("ssl=null", f"ssl0=null,fd:{out}", f"ssl1=null,fd:{err}"),
        ],
        {"TMPDIR": str(memory)},
    )


def qemu_launch(job: Job, run: Path, folder: Path) -> Launch:
    """Debian's kernel in QEMU, emulated: a KVM that is there may still hang."""
    own = {"BUSYBOX": "/bin/busybox", "RUN": run}
    write_init(run, {"FSTYPE": "9p", "LOWER": "/host", "TOP": "/top", **own})
    shared = {"host": (Path("/"), ",readonly=on")}
    shared |= {f"share{n}": (place, "") for n, place in enumerate([run, *job.writable])}
    files = []
    for tag, (place, option) in shared.items():
        facts = f"local,id={tag},path={place},security_model=none,multidevs=remap{option}"
        files += ["-fsdev", facts, "-device", f"virtio-9p-pci,fsdev={tag},mount_tag={tag}"]
    ours = folder / "qemu"
    program = str(ours / "usr/bin/qemu-system-x86_64") if ours.exists() else "qemu-system-x86_64"
    data = ["-L", f"{ours}/usr/share/qemu"] if ours.exists() else []
    libraries = [f"{ours}/{part}/x86_64-linux-gnu" for part in ("lib", "usr/lib")]
    append = f"console=ttyS0 quiet loglevel=3 panic=-1 {QEMU_FASTER} axistwin_run={run}"
    return lambda out, err: (
        [
            *(program, *data, "-accel", "tcg,tb-size=512", "-cpu", "max", "-M", "q35"),
            *("-m", str(job.memory_mb), "-nodefaults", "-no-user-config", "-no-reboot"),
            *("-display", "none", "-nic", "none", "-bios", "qboot.rom", "-serial", "stdio"),
            *("-kernel", str(folder / "vmlinux"), "-initrd", str(folder / "initramfs")),
            *("-append", append, *files, "-device", "virtio-serial-pci"),
            *("-chardev", f"file,id=out,path=/dev/fd/{out}"),
            *("-device", "virtserialport,chardev=out,name=OUT"),
            *("-chardev", f"file,id=err,path=/dev/fd/{err}"),
            *("-device", "virtserialport,chardev=err,name=ERR"),
        ],
        {"LD_LIBRARY_PATH": ":".join(libraries)},
    )


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of machine.  Its folder's number counts up when what is kept there changes."""

    name: str
    folder: str
    build: Callable[[Path, Path], None]
    launch: Callable[[Job, Path, Path], Launch]
    needs: str


UML_NEEDS = "ptrace (in a container: --cap-add SYS_PTRACE --security-opt seccomp=unconfined)"
UML = Kind("User-Mode Linux", "uml-4", build_uml, uml_launch, UML_NEEDS)
QEMU = Kind("QEMU", "qemu-1", build_qemu, qemu_launch, "an x86-64 processor")


def wait_for_status(machine: Machine, job: Job, kind: Kind, run: Path) -> int:
    """Wait until the command or its time ends; the status to hand on."""
    try:
        with contextlib.suppress(subprocess.TimeoutExpired):
            wait_for_end(machine, run, min(job.timeout_s, BOOT_TIMEOUT_S))
        if machine.process.poll() is None:
            if job.timeout_s > BOOT_TIMEOUT_S and not (run / "started").exists():
                raise failure(f"the kernel is not up after {BOOT_TIMEOUT_S:.0f} s", kind, run)
            wait_for_end(machine, run, max(job.timeout_s - BOOT_TIMEOUT_S, 0.0))
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
    status = machine.process.returncode
    raise failure(f"the kernel ended without a result (status {status})", kind, run)


def failure(what: str, kind: Kind, run: Path) -> VmError:
    """An error with the kernel's last words, and the usual remedies."""
    console = (run / "console").read_text(encoding="utf-8", errors="replace")
    words = "".join(f"\n  | {line.rstrip()}" for line in console.splitlines()[-12:])
    needs = f"{kind.name} needs {kind.needs} and the memory of --memory"
    return VmError(f"{what}. {needs}. Its last words:{words}")


def run_job(job: Job) -> int:
    """Prepare what is needed, run the command in a new machine, return its status."""
    kind = QEMU if job.uhid else UML
    folder = prepared(cache_folder(os.environ), kind.folder, kind.build)
    with tempfile.TemporaryDirectory(prefix="axistwin-vm-") as name:
        run = Path(name).resolve()
        for place in (run, *job.writable):
            if re.search(r"[\s,]", str(place)):
                raise VmError(f"a folder's name may not have spaces or commas: {str(place)!r}")
        write_command(job, run, folder / "bin")
        with started(kind.launch(job, run, folder), run) as machine:
            return wait_for_status(machine, job, kind, run)


# ---- The command line ----


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


def number_argument(unit: str, least: float, most: float) -> Callable[[str], float]:
    """A number within limits."""

    def convert(text: str) -> float:
        with contextlib.suppress(ValueError):
            if least <= float(text) <= most:
                return float(text)
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a number of {unit} from {least:g} to {most:g}"
        )

    return convert


def parse(arguments: Sequence[str]) -> Job:
    """The job that the command line asks for."""
    parser = Parser(
        prog="scripts/vm",
        description=__doc__,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--uhid",
        action="store_true",
        help="a kernel with /dev/uhid and /dev/hidraw* too (QEMU: 15 times slower)",
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
        type=number_argument("seconds", 0.1, 1e6),
        default=600.0,
        help="stop the machine after this time, with status 124 (default 600)",
    )
    parser.add_argument(
        "--memory",
        metavar="MB",
        type=number_argument("megabytes", 128, 16384),
        default=1024,
        help="the guest's memory, taken only as far as it is used (default 1024)",
    )
    parser.add_argument("command", metavar="COMMAND...", nargs=argparse.REMAINDER)
    options = parser.parse_args(arguments)
    command = options.command[1:] if options.command[:1] == ["--"] else options.command
    if not command:
        parser.error("a command is needed, such as: scripts/vm ip link show vcan0")
    return Job(command, options.write, options.timeout, int(options.memory), options.uhid)


def leave(number: int, _frame: FrameType | None) -> NoReturn:
    """End by a signal: the machine is ended on the way out."""
    raise SystemExit(128 + number)


def main() -> int:
    """Parse the arguments, run the command, hand on its status."""
    job = parse(sys.argv[1:])
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, leave)
    try:
        if os.environ.get(NESTED_MARK):
            raise VmError("this is the virtual machine already; run the command itself")
        return run_job(job)
    except (VmError, OSError) as error:
        say(str(error))
        return STATUS_FAILED


if __name__ == "__main__":
    raise SystemExit(main())
