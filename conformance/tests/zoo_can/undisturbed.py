"""Faults in what must leave motion, arm and preload alone, and in what is said in motion (SDO)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from zoo.mutant import Any_, MonkeyPatch, wrap

from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.can.device import MacCan
from axistwin.kernel.effects import SendFrame
from axistwin.wire.can_frame import CanFrame
from zoo_can.planting import (
    DOWNLOAD,
    REFUSED,
    UPLOAD,
    around,
    can_mutant,
    hears,
    replies,
    requests,
)

COMING_TO_REST_NS = 100_000_000
RAMP_NS = 600_000_000
BOOT_UP = 0x700
BUSY_NS = 1_500_000


def _is_moving(module: MacCan) -> bool:
    return module.axis.drive.kind is not None


def _does_before(
    patch: MonkeyPatch, is_meant: Callable[[bytes], bool], act: Callable[[MacCan], object]
) -> None:
    """Let `act(module)` be done before such a request is served as it should be."""

    def acting(serve: Any_, module: MacCan, request: bytes) -> Any:
        if is_meant(request):
            act(module)
        return serve()

    requests(patch, acting)


def _executed(index: int) -> Callable[[MacCan], object]:
    """The command with that index, carried out by the axis."""
    return lambda module: module.axis.execute(module._now, index, 0, module._now)


@can_mutant("MACC-SDO-02")
def a_refused_segment_repeats_its_parameters(patch: MonkeyPatch) -> None:
    """80h to 2016h and 201Eh is followed by the four bytes that were refused."""

    def change(reply: bytes, request: bytes) -> bytes:
        is_segment = request[0] == DOWNLOAD and request[1] in (0x16, 0x1E)
        return reply[:4] + request[4:] if is_segment and reply[0] == REFUSED else reply

    replies(patch, change)


@can_mutant("MACC-SDO-03")
def answers_in_motion_forget_the_sub_index(patch: MonkeyPatch) -> None:
    """42h in motion repeats the index, and 00 for the sub-index."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        reply = serve()
        is_answer = reply is not None and request[0] == UPLOAD and reply[0] != REFUSED
        return reply[:3] + b"\0" + reply[4:] if is_answer and _is_moving(module) else reply

    requests(patch, act)


@can_mutant("MACC-SDO-14")
def the_inferior_stop_is_refused_on_the_way_down(patch: MonkeyPatch) -> None:
    """2003h is refused in motion of negative direction."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        is_down = _is_moving(module) and module.axis.drive.direction_at(module._now) < 0
        if request[:2] == b"\x40\x03" and is_down:
            return bytes((REFUSED,)) + request[1:4] + bytes(4)
        return serve()

    requests(patch, act)


@can_mutant("MACC-SDO-05")
def reading_2010h_arms(patch: MonkeyPatch) -> None:
    """The upload of 2010h is refused, and does what the download does."""
    _does_before(
        patch,
        lambda request: request[:3] == b"\x40\x10\x20",
        lambda module: setattr(module.axis, "_armed", True),
    )


@can_mutant("MACC-SDO-06")
def a_stop_is_acknowledged_again_at_rest(patch: MonkeyPatch) -> None:
    """2017h in motion is answered at once, and once more when the axis has come to rest."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        is_stop = request[:2] == b"\x23\x17" and _is_moving(module)
        reply = serve()
        if is_stop:
            again = CanFrame(0x580 + module.address, reply)
            module._effects.append(SendFrame(module._now + COMING_TO_REST_NS, again))
        return reply

    requests(patch, act)


@can_mutant("MACC-SDO-06")
def a_request_right_behind_another_is_lost(patch: MonkeyPatch) -> None:
    """There is one buffer: what comes within 1.5 ms of a request is not heard."""
    heard: dict[MacCan, int] = {}

    def act(go: Any_, module: MacCan, _: bytes) -> None:
        is_lost = module in heard and module._now - heard[module] < BUSY_NS
        if not is_lost:
            heard[module] = module._now
            go()

    around(patch, "_own_request", act)


@can_mutant("MACC-SDO-12")
def what_is_refused_disarms(patch: MonkeyPatch) -> None:
    """Any refusal drops what 2010h has armed."""

    def act(serve: Any_, module: MacCan, _: bytes) -> Any:
        reply = serve()
        if reply is not None and reply[0] == REFUSED:
            module.axis._armed = False
        return reply

    requests(patch, act)


@can_mutant("MACC-SDO-12")
def what_is_no_request_drops_the_preload(patch: MonkeyPatch) -> None:
    """A first byte that is none of the manual's is refused, and the preloaded motion forgotten."""
    _does_before(
        patch,
        lambda request: request[0] not in (DOWNLOAD, UPLOAD),
        lambda module: setattr(module.axis, "_preload", None),
    )


@can_mutant("MACC-SDO-12")
def two_unassigned_downloads_stop_the_axis(patch: MonkeyPatch) -> None:
    """201Dh and 201Fh are refused, and do what 2018h does."""
    _does_before(
        patch,
        lambda request: request[0] == DOWNLOAD and request[1] in (0x1D, 0x1F),
        _executed(0x18),
    )


@can_mutant("MACC-SYNC-03")
def what_sync_starts_locks_nothing(patch: MonkeyPatch) -> None:
    """The parameters are free in a motion that the frame 080h has started."""
    by_frame: set[Axis] = set()

    def begin(go: Any_, module: MacCan, _: bytes) -> None:
        was_held = module.axis._preload is not None
        go()
        if was_held:
            by_frame.add(module.axis)

    def make(is_locked: Any_) -> Any_:
        def locked(axis: Axis, index: int, number: int) -> bool:
            if axis.drive.kind is None:
                by_frame.discard(axis)
            return bool(is_locked(axis, index, number)) and axis not in by_frame

        return locked

    around(patch, "_sync", begin)
    wrap(patch, Axis, "is_locked", make)


@can_mutant("MACC-SDO-12")
def command_byte_20h_arms(patch: MonkeyPatch) -> None:
    """20h with index 2010h is refused, and arms as 23h does."""
    _does_before(patch, lambda request: request[:3] == b"\x20\x10\x20", _executed(0x10))


@can_mutant("MACC-SDO-09")
def accepted_segments_forget_the_sub_index(patch: MonkeyPatch) -> None:
    """60h to 2016h and 201Eh has 00 for the sub-index."""

    def change(reply: bytes, request: bytes) -> bytes:
        is_segment = request[0] == DOWNLOAD and request[1] in (0x16, 0x1E)
        return reply[:3] + b"\0" + reply[4:] if is_segment and reply[0] != REFUSED else reply

    replies(patch, change)


@can_mutant("MACC-ID-02", "MACC-CMD-10-01")
def the_start_of_another_module_disarms_it(patch: MonkeyPatch) -> None:
    """A boot-up message under any address drops what 2010h has armed, and the preload."""

    def act(module: MacCan, _: CanFrame) -> None:
        module.axis._armed, module.axis._preload = False, None

    hears(patch, lambda _, frame: BOOT_UP < frame.identifier < BOOT_UP + 0x80, act)


@can_mutant("MACC-SDO-13")
def a_stop_is_acknowledged_at_rest(patch: MonkeyPatch) -> None:
    """The reply to 2017h in motion waits until the axis has come to rest."""

    def act(go: Any_, module: MacCan, identifier: int, data: bytes, start_ns: int) -> Any:
        due_ns = module.axis.next_event() if data[:2] == b"\x60\x17" else None
        return go(identifier, data, max(start_ns, due_ns or 0))

    around(patch, "_send", act)


@can_mutant("MACC-SDO-13")
def a_change_of_speed_is_acknowledged_behind_its_ramp(patch: MonkeyPatch) -> None:
    """The reply to a 2015h in motion comes when the new speed is reached."""
    late: set[MacCan] = set()

    def note(serve: Any_, module: MacCan, request: bytes) -> Any:
        if request[:2] == b"\x23\x15" and _is_moving(module):
            late.add(module)
        return serve()

    def act(go: Any_, module: MacCan, identifier: int, data: bytes, start_ns: int) -> Any:
        delay_ns = RAMP_NS if module in late else 0
        late.discard(module)
        return go(identifier, data, start_ns + delay_ns)

    requests(patch, note)
    around(patch, "_send", act)


@can_mutant("MACC-SDO-03")
def answers_repeat_the_sub_index_of_the_last_download(patch: MonkeyPatch) -> None:
    """An upload with sub-index 00 is answered with that of the last accepted download."""
    last: dict[MacCan, int] = {}

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        reply = serve()
        if reply is None or reply[0] == REFUSED:
            return reply
        if request[0] == DOWNLOAD:
            last[module] = request[3]
        elif not request[3]:
            return reply[:3] + bytes((last.get(module, 0),)) + reply[4:]
        return reply

    requests(patch, act)


@can_mutant("MACC-SDO-12", "MACC-Q-01-01")
def what_is_refused_clears_the_stop_bits(patch: MonkeyPatch) -> None:
    """Any refusal clears byte ff of 2001h."""

    def act(serve: Any_, module: MacCan, _: bytes) -> Any:
        reply = serve()
        if reply is not None and reply[0] == REFUSED:
            module.axis.drive.stops.bits = 0
        return reply

    requests(patch, act)
