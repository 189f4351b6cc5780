"""What the kernel says of CAN and of its interfaces."""

import fcntl
import os
import socket
import struct
from typing import Final, Literal, TypeAlias

LinkState: TypeAlias = Literal["absent", "down", "up"]

REMEDY: Final = "sudo modprobe vcan && sudo ip link add {0} type vcan && sudo ip link set {0} up"
"""How to get a virtual bus, on a kernel with CAN; the name goes into it."""

# Linux: net/if.h, bits/ioctls.h.
_SIOCGIFFLAGS = 0x8913
_IFF_UP = 0x1
_REQUEST = struct.Struct("16sH22x")
_NAME_MAX = 15


def kernel_has_can() -> bool:
    """Whether there are CAN sockets, which loads the kernel's module where there is one."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (AttributeError, OSError):
        return False
    return True


def interfaces() -> list[str]:
    """The names of those that look like CAN: vcan0, can0, slcan0 ..."""
    return [name for _, name in socket.if_nameindex() if "can" in name]


def link_state(name: str) -> LinkState:
    """Whether there is an interface ``name``, and whether it is up."""
    raw_name = os.fsencode(name)
    if len(raw_name) > _NAME_MAX:
        return "absent"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as any_socket:
        try:
            answer = fcntl.ioctl(any_socket, _SIOCGIFFLAGS, _REQUEST.pack(raw_name, 0))
        except OSError:
            return "absent"
    flags: int = _REQUEST.unpack(answer)[1]
    return "up" if flags & _IFF_UP else "down"


def remedy(name: str) -> str:
    """What makes ``name`` an interface that can be used, as far as that can be said."""
    if not kernel_has_can():
        return f"this kernel has no CAN; on one that has: {REMEDY.format('vcan0')}"
    if link_state(name) == "down":
        return f"sudo ip link set {name} up"
    if name.startswith("vcan"):
        return REMEDY.format(name)
    present = ", ".join(interfaces())
    return f"there are {present}" if present else "plug in an adapter, or use vcan0"
