"""Frames as python-can's messages."""

import can

from axistwin.wire.can_frame import CanFrame


def message_of(
    frame: CanFrame, *, time_s: float = 0.0, channel: str | None = None, is_rx: bool = True
) -> can.Message:
    """``frame`` as python-can has it; ``time_s`` in seconds of whatever clock the reader uses."""
    return can.Message(
        timestamp=time_s,
        arbitration_id=frame.identifier,
        is_extended_id=frame.is_extended,
        is_remote_frame=frame.is_remote,
        channel=channel,
        dlc=frame.length,
        data=frame.data,
        is_rx=is_rx,
    )


def frame_of(message: can.Message) -> CanFrame:
    """``message``, which is no error frame and not FD, as a frame.

    Raises ValueError for what is no frame.
    """
    return CanFrame(
        message.arbitration_id,
        b"" if message.is_remote_frame else bytes(message.data),
        is_extended=message.is_extended_id,
        is_remote=message.is_remote_frame,
        length=message.dlc,
    )
