import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from scripts import vm, vm_cache

ROOT = Path(__file__).parents[2]
PROGRAM = ROOT / "scripts" / "vm.py"

pytestmark = [
    pytest.mark.strength,
    pytest.mark.skipif(
        "AXISTWIN_VM" in os.environ, reason="inside the virtual machine there is no other one"
    ),
]


@pytest.fixture(scope="module")
def _downloads_done() -> None:
    """The cache is filled, so that its message is in no test's stderr."""
    done = run_vm("true")
    assert done.returncode == 0, done.stderr.decode()


@pytest.fixture(scope="module")
def _uhid_downloads_done() -> None:
    """As above, for the machine with uhid."""
    done = run_vm("--uhid", "true")
    assert done.returncode == 0, done.stderr.decode()


def with_machine(test: Callable[..., None]) -> Callable[..., None]:
    """Marks a test that starts machines: seconds each."""
    marked: Callable[..., None] = pytest.mark.usefixtures("_downloads_done")(test)
    return marked


def run_vm(
    *arguments: str, environment: Mapping[str, str] | None = None, cwd: Path = ROOT
) -> subprocess.CompletedProcess[bytes]:
    """Run the program to its end and collect what it hands back."""
    return subprocess.run(
        [sys.executable, str(PROGRAM), *arguments],
        cwd=cwd,
        env=None if environment is None else dict(environment),
        capture_output=True,
        timeout=300,
        check=False,
    )


def run_python(program: str) -> str:
    """What a Python program prints in the machine; it must succeed."""
    done = run_vm("--timeout", "120", sys.executable, "-c", program)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout.decode()


def processes_of_session(session: int) -> list[int]:
    """The live processes of a session (the ones that wait to be reaped are dead)."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, its_session = entry.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(its_session) == session and state != "Z":
            found.append(int(entry.parent.name))
    return found


def kernel_of(process: subprocess.Popen[bytes]) -> int:
    """The kernel that a running scripts/vm has started, once its command runs."""
    assert process.stdout is not None
    assert process.stdout.readline() == b"running\n"
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    kernel, _guard = map(int, children)
    return kernel


def wait_until_ended(session: int) -> None:
    """The kernel and all that belongs to it end within 10 s."""
    deadline = time.monotonic() + 10
    while processes_of_session(session):
        assert time.monotonic() < deadline, processes_of_session(session)
        time.sleep(0.05)


# What is handed back


@with_machine
def test_streams_and_exit_status_of_the_command_are_handed_back() -> None:
    """Stdout, stderr and the status come out apart and as they are."""
    done = run_vm("sh", "-c", r"printf 'out\0\r\n\377'; printf 'err\r\n' >&2; exit 37")
    assert (done.returncode, done.stdout, done.stderr) == (37, b"out\0\r\n\xff", b"err\r\n")


@with_machine
def test_megabytes_of_output_arrive_whole_at_a_sleepy_reader(tmp_path: Path) -> None:
    """Nothing is lost, changed or added when the output is large and its reader slow."""
    data = os.urandom(3_000_000)
    (tmp_path / "data").write_bytes(data)
    command = [sys.executable, str(PROGRAM), "cat", str(tmp_path / "data")]
    received = bytearray()
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        time.sleep(3)  # real time: the pipes on the way fill up
        while piece := os.read(process.stdout.fileno(), 200_000):
            received += piece
            time.sleep(0.01)
    assert process.returncode == 0
    assert received == data


@with_machine
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGTERM])
def test_a_command_that_dies_by_a_signal_gives_128_and_its_number(number: int) -> None:
    """The status is the one that a shell would show."""
    done = run_vm("sh", "-c", f"kill -{int(number)} $$")
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, b"", b"")


@with_machine
def test_a_command_that_does_not_exist_gives_127() -> None:
    """And says so on stderr."""
    done = run_vm("no-such-command")
    assert done.returncode == 127
    assert b"no-such-command: not found" in done.stderr


@with_machine
def test_the_time_out_stops_the_machine_and_gives_124() -> None:
    """What was printed before is kept; the message names the time."""
    done = run_vm("--timeout", "8", "sh", "-c", "echo early; sleep 100")
    assert (done.returncode, done.stdout) == (124, b"early\n")
    assert done.stderr == b"vm: no end after 8 s: stopped\n"


@with_machine
def test_what_the_command_leaves_in_the_background_holds_nothing_up() -> None:
    """A child that still has the streams open ends with the command."""
    begin = time.monotonic()
    done = run_vm("sh", "-c", "sleep 100 & echo done")
    assert (done.returncode, done.stdout) == (0, b"done\n")
    assert time.monotonic() - begin < 60


# What the command finds


@with_machine
def test_the_command_runs_as_root_in_the_same_directory_and_environment(tmp_path: Path) -> None:
    """Directory, variables with any content, arguments with any content; stdin is empty."""
    odd = 'a\'b "c" $d\n\\'
    script = 'pwd; id -u; printf "%s|%s|" "$ODD" "$1"; cat; test -t 1 || echo pipe'
    environment = {**os.environ, "ODD": odd}
    done = run_vm("sh", "-c", script, "sh", odd, environment=environment, cwd=tmp_path)
    assert done.stdout.decode() == f"{tmp_path}\n0\n{odd}|{odd}|pipe\n"


@with_machine
@pytest.mark.skipif(Path(sys.prefix) != ROOT / ".venv", reason="tests run by another Python")
def test_the_script_runs_the_projects_own_python_from_anywhere(tmp_path: Path) -> None:
    """scripts/vm puts .venv first in PATH and stays in the caller's directory."""
    program = "import os, sys, axistwin; print(sys.prefix, os.getcwd())"
    done = subprocess.run(
        [str(ROOT / "scripts" / "vm"), "python", "-c", program],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.stdout == f"{sys.prefix} {tmp_path}\n", done.stderr


@with_machine
def test_only_writable_folders_keep_what_the_command_writes(tmp_path: Path) -> None:
    """The host's files look writable inside, and only --write makes it true."""
    (tmp_path / "kept").mkdir()
    for name in ("old", "kept/old"):
        (tmp_path / name).write_text("before")
    script = "echo after >old; echo after >kept/old; echo new >new; echo new >kept/new; cat old new"
    done = run_vm("--write", str(tmp_path / "kept"), "sh", "-c", script, cwd=tmp_path)
    assert done.stdout == b"after\nnew\n", done.stderr
    assert (tmp_path / "old").read_text() == "before"
    assert not (tmp_path / "new").exists()
    assert (tmp_path / "kept" / "old").read_text() == "after\n"
    assert (tmp_path / "kept" / "new").read_text() == "new\n"


# CAN


@with_machine
def test_both_buses_are_up_and_take_frames_of_64_bytes() -> None:
    """vcan0 and vcan1 exist with mtu 72, lo is up."""
    program = """
import pathlib
for name in ("vcan0", "vcan1", "lo"):
    facts = pathlib.Path("/sys/class/net", name)
    print(name, (facts / "mtu").read_text().strip(), int((facts / "flags").read_text(), 16) & 1)
"""
    assert run_python(program) == "vcan0 72 1\nvcan1 72 1\nlo 65536 1\n"


@with_machine
def test_cansend_reaches_candump() -> None:
    """can-utils are there and use the kernel's bus."""
    script = """
candump -L -n 2 vcan0 >/tmp/seen &
until grep -q "^ *vcan0 " /proc/net/can/rcvlist_all; do sleep 0.05; done
cansend vcan1 7FF#00; cansend vcan0 601#4000100000000000; cansend vcan0 00000123#R; wait $!
sed 's/^[^ ]* //' /tmp/seen
"""
    done = run_vm("--timeout", "60", "sh", "-c", script)
    assert done.stdout == b"vcan0 601#4000100000000000\nvcan0 00000123#R\n", done.stderr


@with_machine
def test_python_can_talks_between_two_processes() -> None:
    """A frame on vcan0 is answered by another process."""
    pytest.importorskip("can")
    program = """
import subprocess, sys
import can
ECHO = '''
import can
with can.Bus(interface="socketcan", channel="vcan0") as bus:
    print("ready", flush=True)
    frame = bus.recv(20)
    bus.send(can.Message(arbitration_id=0x581, is_extended_id=False, data=frame.data[::-1]))
'''
echo = subprocess.Popen([sys.executable, "-c", ECHO], stdout=subprocess.PIPE)
echo.stdout.readline()
with can.Bus(interface="socketcan", channel="vcan0") as bus:
    bus.send(can.Message(arbitration_id=0x601, is_extended_id=False, data=b"axistwin"))
    answer = bus.recv(20)
print(hex(answer.arbitration_id), bytes(answer.data).decode(), echo.wait())
"""
    assert run_python(program) == "0x581 niwtsixa 0\n"


@with_machine
def test_slcand_makes_a_can_interface_of_a_pty() -> None:
    """Frames pass both ways between the kernel's can0 and an slcan adapter behind a pty."""
    program = """
import os, pty, socket, struct, subprocess, time, tty
master, slave = pty.openpty()
tty.setraw(slave)
def heard(end):
    data = b""
    while not data.endswith(end):
        data += os.read(master, 100)
    return data
daemon = subprocess.Popen(
    ["slcand", "-F", "-o", "-c", "-s6", os.ttyname(slave), "can0"], stdout=subprocess.DEVNULL
)
print(heard(b"O\\r").decode().split("\\r")[-3:])
while not os.path.exists("/sys/class/net/can0"):
    time.sleep(0.01)
subprocess.run(["ip", "link", "set", "can0", "up"], check=True)
bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
bus.settimeout(20)
bus.bind(("can0",))
subprocess.run(["cansend", "can0", "601#40001001"], check=True)
print(heard(b"\\r").decode().split())
bus.recv(16)  # the frame just sent, as every socket of the interface sees it
os.write(master, b"t5814420010AB\\r")
identifier, length, data = struct.unpack("<IB3x8s", bus.recv(16))
print(hex(identifier), data[:length].hex())
daemon.terminate()
"""
    printed = run_python(program).splitlines()
    assert printed == ["['S6', 'O', '']", "['t601440001001']", "0x581 420010ab"]


# Many at once, and the end of it


@with_machine
def test_machines_beside_each_other_have_buses_of_their_own() -> None:
    """Three at once: each sees its own frames only, and gives back its own output."""
    script = """
candump -L -n 5 vcan0 >/tmp/seen &
until grep -q "^ *vcan0 " /proc/net/can/rcvlist_all; do sleep 0.05; done
for i in 1 2 3 4 5; do cansend vcan0 $1#0$i; sleep 0.1; done; wait $!
cut -d ' ' -f 3 /tmp/seen
"""
    names = ["101", "202", "303"]
    processes = [
        subprocess.Popen(
            [sys.executable, str(PROGRAM), "--timeout", "100", "sh", "-c", script, "sh", name],
            stdout=subprocess.PIPE,
            text=True,
        )
        for name in names
    ]
    for name, process in zip(names, processes, strict=True):
        output, _ = process.communicate(timeout=200)
        assert output.split() == [f"{name}#0{i}" for i in range(1, 6)]


@with_machine
@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)],
    ids=str,
)
def test_no_kernel_outlives_the_script(number: signal.Signals, status: int, tmp_path: Path) -> None:
    """Ctrl-C, SIGTERM and even SIGKILL of the script end the kernel and all its processes."""
    command = [sys.executable, str(PROGRAM), "sh", "-c", "echo running; sleep 100"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as process:
        kernel = kernel_of(process)
        assert kernel in processes_of_session(kernel)
        process.send_signal(number)
        assert process.wait(20) == status
    wait_until_ended(kernel)
    if number != signal.SIGKILL:
        assert not list(tmp_path.iterdir())


@with_machine
def test_a_reader_that_goes_away_ends_the_machine() -> None:
    """As in 'scripts/vm yes | head -1'."""
    command = [sys.executable, str(PROGRAM), "sh", "-c", "echo running; exec yes"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        kernel = kernel_of(process)
        assert process.stdout is not None
        process.stdout.close()
        assert process.wait(30) == 128 + signal.SIGPIPE
    wait_until_ended(kernel)


# Where it cannot start


def refused(done: subprocess.CompletedProcess[bytes]) -> str:
    """The message of a machine that did not start: nothing on stdout, no traceback."""
    assert done.returncode == 125
    assert done.stdout == b""
    message = done.stderr.decode()
    assert "Traceback" not in message
    assert message.splitlines()[-1].startswith(("vm: ", "  | "))
    return message


def fake_programs(folder: Path, **scripts: str) -> str:
    """A PATH with nothing but these programs."""
    folder.mkdir()
    for name, script in scripts.items():
        program = folder / name.replace("_", "-")
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
    return str(folder)


def test_without_apt_the_message_says_what_is_needed(tmp_path: Path) -> None:
    """A system that is not Debian gets one line with the remedy."""
    environment = {"PATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    message = refused(run_vm("true", environment=environment))
    assert message.startswith("vm: apt-get is needed")
    assert "use Debian or Ubuntu" in message


def test_a_download_that_fails_is_reported_with_its_reason(tmp_path: Path) -> None:
    """Apt's own reason and the remedy are told, and nothing half-made stays in the cache."""
    failing = "echo 'E: Could not resolve the mirror' >&2; exit 100"
    path = fake_programs(tmp_path / "bin", apt_get=failing, dpkg_deb="exit 1")
    environment = {"PATH": path, "XDG_CACHE_HOME": str(tmp_path / "cache")}
    message = refused(run_vm("true", environment=environment))
    assert "'apt-get update' fails: E: Could not resolve the mirror" in message
    assert "check the network" in message
    assert [entry.name for entry in (tmp_path / "cache/axistwin-vm").iterdir()] == ["lock"]


def test_a_cache_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    """The message names the folder and the variable that chooses another."""
    (tmp_path / "file").write_text("not a folder")
    message = refused(
        run_vm("true", environment={**os.environ, "XDG_CACHE_HOME": str(tmp_path / "file")})
    )
    assert message.startswith(f"vm: cannot fill the cache {tmp_path}/file/axistwin-vm: ")
    assert "XDG_CACHE_HOME" in message


@with_machine
def test_without_ptrace_the_message_names_the_remedy() -> None:
    """In a container that forbids ptrace the kernel's own words and the options are shown."""
    # A filter that lets every system call through but 101, ptrace, which gets EPERM.
    program = """
import ctypes, os, struct, sys
code = [(0x20, 0, 0, 0), (0x15, 0, 1, 101), (0x06, 0, 0, 0x00050001), (0x06, 0, 0, 0x7FFF0000)]
filters = ctypes.create_string_buffer(b"".join(struct.pack("<HBBI", *line) for line in code))
rules = struct.pack("<HxxxxxxQ", len(code), ctypes.addressof(filters))
libc = ctypes.CDLL(None, use_errno=True)
assert libc.prctl(38, 1, 0, 0, 0) == 0, "no new privileges"
assert libc.prctl(22, 2, rules, 0, 0) == 0, "seccomp"
os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
"""
    done = subprocess.run(
        [sys.executable, "-c", program, str(PROGRAM), "true"],
        capture_output=True,
        timeout=200,
        check=False,
    )
    message = refused(done)
    assert "needs ptrace" in message
    assert "--cap-add SYS_PTRACE" in message
    assert message.splitlines()[-1].startswith("  | ")


def test_memory_that_no_folder_can_hold_is_refused() -> None:
    """The folders looked at and the option to ask for less are named."""
    with pytest.raises(vm_cache.VmError, match=r"MB of memory .*/dev/shm has .*--memory"):
        vm.memory_folder(1 << 40)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "a command is needed"),
        (["--timeout", "0", "true"], "'0' is not a number of seconds from 0.1 to 1e+06"),
        (["--timeout", "nan", "true"], "'nan' is not a number of seconds from 0.1 to 1e+06"),
        (["--memory", "1", "true"], "'1' is not a number of megabytes from 128 to 16384"),
        (["--write", "no/such/folder", "true"], "there is no folder 'no/such/folder'"),
        (["--colour", "true"], "--colour"),
    ],
)
def test_mistakes_on_the_command_line_are_one_line(arguments: list[str], words: str) -> None:
    """The value, the range and the way to the help."""
    message = refused(run_vm(*arguments))
    assert words in message
    assert message.endswith("(see scripts/vm --help)\n")
    assert message.count("\n") == 1


def test_the_help_tells_buses_options_and_statuses() -> None:
    """Everything that one needs to use it fits on a page."""
    done = run_vm("--help")
    assert done.returncode == 0
    for words in ("vcan0", "--write DIR", "--timeout SECONDS", "128 + n", "124", "125", "KVM"):
        assert words in done.stdout.decode(), words


def test_inside_there_is_no_second_machine() -> None:
    """The message says where one is."""
    message = refused(run_vm("true", environment={**os.environ, "AXISTWIN_VM": "1"}))
    assert "this is the virtual machine already" in message


# The cache


@pytest.mark.parametrize(
    ("environment", "folder"),
    [
        ({"XDG_CACHE_HOME": "/c", "HOME": "/h"}, "/c/axistwin-vm"),
        ({"XDG_CACHE_HOME": "relative", "HOME": "/h"}, "/h/.cache/axistwin-vm"),
        ({"HOME": "/h"}, "/h/.cache/axistwin-vm"),
        ({"HOME": ""}, f"/var/tmp/axistwin-vm-{os.getuid()}"),
        ({}, f"/var/tmp/axistwin-vm-{os.getuid()}"),
    ],
)
def test_the_cache_is_where_caches_are(environment: dict[str, str], folder: str) -> None:
    """XDG_CACHE_HOME, else HOME, else a folder of this user."""
    assert vm_cache.cache_folder(environment) == Path(folder)


def test_of_many_callers_one_fills_the_cache(tmp_path: Path) -> None:
    """The others wait for it and find it complete."""
    building, go_on = threading.Event(), threading.Event()
    builds: list[int] = []
    found: list[bool] = []

    def build(_staging: Path, made: Path) -> None:
        builds.append(1)
        building.set()
        assert go_on.wait(20)
        (made / "file").touch()

    def call() -> None:
        found.append((vm_cache.prepared(tmp_path / "cache", "one", build) / "file").exists())

    callers = [threading.Thread(target=call) for _ in range(4)]
    callers[0].start()
    assert building.wait(20)
    for caller in callers[1:]:
        caller.start()
    assert not (tmp_path / "cache" / "one").exists()
    go_on.set()
    for caller in callers:
        caller.join(20)
    assert (builds, found) == ([1], [True] * 4)


def test_modules_are_loaded_after_what_they_need(tmp_path: Path) -> None:
    """Dependencies first, each once; built-in ones and unknown names left out."""
    depends = {"can": "", "can-raw": "can", "slcan": "can-dev,built-in", "can-dev": "can"}
    files = {}
    for name, needs in depends.items():
        file = tmp_path / f"{name}.ko"
        file.write_bytes(b"ELF\0license=GPL\0depends=" + needs.encode() + b"\0name=x\0")
        files[name.replace("-", "_")] = file
    order = vm_cache.module_order(["slcan", "can-raw", "can", "overlay"], files)
    assert [file.stem for file in order] == ["can", "can-dev", "slcan", "can-raw"]


# HID


@pytest.mark.usefixtures("_uhid_downloads_done")
def test_with_uhid_a_program_can_be_a_hid_device() -> None:
    """In QEMU a device made through /dev/uhid is a /dev/hidraw, reports pass both ways, CAN too."""
    program = r"""
import os, pathlib, select, socket, struct, sys, threading, time
descriptor = bytes.fromhex("0600ff0901a101150026ff007508954009028102954009039102c0")
device = os.open("/dev/uhid", os.O_RDWR)
names = [b"twin".ljust(128, b"\0"), bytes(64), bytes(64)]
facts = struct.pack("<HHIIII", len(descriptor), 3, 0x0461, 0x0020, 0x0100, 0)
os.write(device, struct.pack("<I", 11) + b"".join(names) + facts + descriptor.ljust(4096, b"\0"))
def answer():
    while True:
        event = os.read(device, 4376)
        if event[:4] == b"\6\0\0\0":  # an output report: 64 bytes after its number
            os.write(device, struct.pack("<IH", 12, 64) + event[5:69][::-1])
threading.Thread(target=answer, daemon=True).start()
while not (nodes := list(pathlib.Path("/dev").glob("hidraw*"))):
    time.sleep(0.05)
client = os.open(nodes[0], os.O_RDWR)
os.write(client, bytes(range(65)))
# The node is there before the kernel has set the device up, and until then it drops what that says.
while not select.select([client], [], [], 1)[0]:
    os.write(client, bytes(range(65)))
print(os.read(client, 100).hex())
print(len(socket.if_nameindex()), socket.socket(socket.AF_CAN, socket.SOCK_RAW, 1).family.name)
sys.stdout.flush()
os._exit(9)
"""
    done = run_vm("--uhid", "--timeout", "200", sys.executable, "-c", program)
    assert done.returncode == 9, done.stderr.decode()
    assert done.stdout.decode() == f"{bytes(range(64, 0, -1)).hex()}\n3 AF_CAN\n"


@pytest.mark.usefixtures("_uhid_downloads_done")
def test_with_uhid_streams_folders_and_limits_are_the_same(tmp_path: Path) -> None:
    """Output is byte-exact, --write keeps, a signal is 128 and its number, a time-out 124."""
    data = bytes(range(256)) * 4000
    (tmp_path / "data").write_bytes(data)
    script = "cat data; echo new >new; echo err >&2; kill -KILL $$"
    done = run_vm("--uhid", "--write", str(tmp_path), "sh", "-c", script, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (137, b"err\n")
    assert done.stdout == data
    assert (tmp_path / "new").read_text() == "new\n"
    assert run_vm("--uhid", "--timeout", "20", "sleep", "100").returncode == 124


@pytest.mark.usefixtures("_uhid_downloads_done")
def test_with_uhid_nothing_is_lost_when_the_reader_comes_after_the_command_has_ended(
    tmp_path: Path,
) -> None:
    """The machine stays on until all is out; its ports would forget what waits in them."""
    script = f"head -c 1000000 /dev/zero; head -c 1000 /dev/zero >&2; echo >{tmp_path}/ended"
    command = [sys.executable, str(PROGRAM), "--uhid", "--write", str(tmp_path), "sh", "-c", script]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe) as process:
        while process.poll() is None and not (tmp_path / "ended").exists():
            time.sleep(0.1)
        time.sleep(3)  # real time, in which it would go off
        out, err = process.communicate()
    assert (process.returncode, len(out), err) == (0, 1_000_000, bytes(1000))
