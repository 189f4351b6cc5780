"""What ``scripts/vm`` starts its machines from: downloaded once, unpacked, kept.

Debian's packages, fetched with apt-get and never installed, below $XDG_CACHE_HOME or ~/.cache.
"""

from __future__ import annotations

import fcntl
import lzma
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

QEMU_INIT = Path(__file__).with_name("vm_qemu_init.sh")
PROGRAM_PACKAGES = ("busybox-static", "can-utils")
UML_PACKAGES = ("user-mode-linux", *PROGRAM_PACKAGES)
MODULES = ("overlay", "can-raw", "can-bcm", "vcan", "slcan")
HID_MODULES = ("hid-generic", "uhid")
QEMU_MODULES = ("virtio_pci", "virtio_console", "9pnet_virtio", "9p", *MODULES, *HID_MODULES)
QEMU_FOLDERS = ("bin", "dev", "proc", "sys", "host", "top", "modules")
QEMU_KERNEL = "linux-image-amd64"  # the kernel "cloud" has no CAN
SHARED_FOLDER = Path("/var/tmp")


class VmError(Exception):
    """The machine cannot do what it should; the text says why and what helps."""


def say(text: str) -> None:
    """Tell the user, apart from the command's own output."""
    print(f"vm: {text}", file=sys.stderr, flush=True)


def cache_folder(environment: Mapping[str, str]) -> Path:
    """Where downloads are kept; never inside the project, and independent of a missing HOME."""
    for name, below in (("XDG_CACHE_HOME", ""), ("HOME", ".cache")):
        if environment.get(name, "").startswith("/"):
            return Path(environment[name], below, "axistwin-vm")
    return SHARED_FOLDER / f"axistwin-vm-{os.getuid()}"


def prepared(cache: Path, name: str, build: Callable[[Path, Path], None]) -> Path:
    """The folder ``name`` of the cache, which ``build(staging, folder)`` fills the first time.

    Of several callers one builds and the others wait.  A folder appears complete or not at all.
    """
    folder = cache / name
    try:
        if cache.parent == SHARED_FOLDER and cache.exists() and cache.stat().st_uid != os.getuid():
            raise PermissionError("somebody else has made it")
        if folder.is_dir():
            return folder
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
        remedy = "name a writable folder in XDG_CACHE_HOME"
        raise VmError(f"cannot fill the cache {cache}: {error}; {remedy}") from error
    return folder


def unpack_packages(packages: Sequence[str], staging: Path, *, depends: bool = False) -> Path:
    """Download Debian packages and unpack them into a folder, without installing anything.

    With ``depends`` come the packages that they need and the host has not.  The host's package
    lists are tried first.  Where they are missing or out of date, fresh ones are fetched into
    ``staging``: that needs no root and leaves the host as it was.
    """
    for program in ("apt-get", "dpkg-deb"):
        if shutil.which(program) is None:
            raise VmError(f"{program} is needed to fetch {packages[0]}: use Debian or Ubuntu")
    say(f"downloading {', '.join(packages)} (first time)")
    debs = Path(tempfile.mkdtemp(prefix="debs-", dir=staging))
    for folder in (debs / "partial", staging / "lists" / "partial"):
        folder.mkdir(parents=True, exist_ok=True)
    # Whoever runs this may write here; the user "_apt" may not.
    apt = ["apt-get", "-q", "-y", "-o", "APT::Sandbox::User=root", "-o", "Debug::NoLocking=1"]
    apt += ["-o", f"Dir::Cache={staging}", "-o", f"Dir::Cache::Archives={debs}"]
    download = (
        ["install", "--download-only", "--no-install-recommends"] if depends else ["download"]
    )
    download += packages
    if run_quietly([*apt, *download], debs):
        apt += ["-o", f"Dir::State::Lists={staging}/lists"]
        for step in (["update"], download):
            if reason := run_quietly([*apt, *step], debs):
                raise VmError(
                    f"'apt-get {' '.join(step)}' fails: {reason}; "
                    "check the network and /etc/apt/sources.list (Debian's 'main' is needed)"
                )
    for deb in sorted(debs.glob("*.deb")):
        if reason := run_quietly(["dpkg-deb", "-x", str(deb), str(staging / "root")], debs):
            raise VmError(f"cannot unpack {deb.name}: {reason}; is there room in {staging.parent}?")
    return staging / "root"


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
        content = file.read_bytes()
        found = re.search(rb"\0depends=([^\0]*)\0", content)
        before = re.findall(rb"\0softdep=pre: ([^\0]*)\0", content)
        for dependency in re.split(
            "[, ]", b" ".join([*before, *(found.groups() if found else [])]).decode()
        ):
            need(dependency)
        order.append(file)

    for name in names:
        need(name)
    return order


def keep_programs(root: Path, made: Path) -> None:
    """The programs for the guest: busybox, can-utils, and an ip where the host has no iproute2."""
    shutil.copy(root / "bin/busybox", made / "busybox")
    shutil.copytree(root / "usr/bin", made / "bin", ignore=shutil.ignore_patterns("linux.uml"))
    (made / "bin" / "ip").symlink_to("../busybox")


def keep_modules(root: Path, made: Path, names: Sequence[str]) -> None:
    """The modules ``names`` and what they need, numbered in the order of loading."""
    files = {file.stem.replace("-", "_"): file for file in root.rglob("*.ko")}
    (made / "modules").mkdir()
    for number, file in enumerate(module_order(names, files)):
        shutil.copy(file, made / "modules" / f"{number:02}-{file.name}")


def build_uml(staging: Path, made: Path) -> None:
    """Fetch the kernel and the programs, and keep what is used of them (14 MB of 120)."""
    root = unpack_packages(UML_PACKAGES, staging)
    keep_programs(root, made)
    keep_modules(root, made, MODULES)
    shutil.copy(root / "usr/bin/linux.uml", made / "linux")


def build_qemu(staging: Path, made: Path) -> None:
    """Fetch Debian's kernel, and QEMU where the host has none; make what QEMU starts from."""
    root = unpack_packages([QEMU_KERNEL, *PROGRAM_PACKAGES], staging)
    (latest,) = staging.glob(f"debs-*/{QEMU_KERNEL}_*.deb")
    needs = subprocess.check_output(["dpkg-deb", "-f", str(latest), "Depends"], text=True)
    unpack_packages([needs.split()[0]], staging)
    keep_programs(root, made)
    keep_modules(root, made, QEMU_MODULES)
    (image,) = (root / "boot").glob("vmlinuz-*")
    (made / "vmlinux").write_bytes(bare_kernel(image.read_bytes()))
    entries: dict[str, bytes | None] = dict.fromkeys(QEMU_FOLDERS)
    entries |= {"init": QEMU_INIT.read_bytes(), "bin/busybox": (made / "busybox").read_bytes()}
    for module in sorted((made / "modules").iterdir()):
        entries[f"modules/{module.name}"] = module.read_bytes()
    (made / "initramfs").write_bytes(cpio_archive(entries))
    if shutil.which("qemu-system-x86_64") is None:
        (staging / "qemu").mkdir()
        unpack_packages(["qemu-system-x86"], staging / "qemu", depends=True).rename(made / "qemu")


def bare_kernel(image: bytes) -> bytes:
    """The ELF kernel inside a bzImage; emulated, its own unpacking would take most of the boot."""
    setup_bytes = ((image[0x1F1] or 4) + 1) * 512
    offset, length = struct.unpack_from("<II", image, 0x248)
    start = setup_bytes + offset
    kernel = lzma.LZMADecompressor(lzma.FORMAT_XZ).decompress(image[start : start + length])
    assert kernel.startswith(b"\x7fELF")
    return kernel


def cpio_archive(entries: Mapping[str, bytes | None]) -> bytes:
    """An archive in the form that the kernel reads ("newc"): programs, and folders (None)."""
    archive = bytearray()
    for number, (name, content) in enumerate([*entries.items(), ("TRAILER!!!", b"")], start=1):
        mode, body = (0o40755, b"") if content is None else (0o100755, content)
        fields = (number, mode, 0, 0, 1, 0, len(body), 0, 0, 0, 0, len(name) + 1, 0)
        archive += b"070701" + b"".join(b"%08X" % value for value in fields)
        for part in (name.encode() + b"\0", body):
            archive += part
            archive += bytes(-len(archive) % 4)
    return bytes(archive)
