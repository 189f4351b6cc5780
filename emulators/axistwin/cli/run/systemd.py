"""Telling systemd how the service is doing: one datagram to the socket named in the environment."""

import os


def notify(state: str) -> bool:
    """Send ``state``, such as ``READY=1``; False if nobody wants to know.

    A socket that cannot be reached is not worth failing for.
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return False
    import socket  # few runs need it, all would wait for it

    if address.startswith("@"):  # Linux's abstract socket space
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.connect(address)
            channel.send(state.encode(), socket.MSG_DONTWAIT)
    except OSError:
        return False
    return True
