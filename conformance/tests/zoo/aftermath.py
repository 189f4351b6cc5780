"""Faults in what is left behind: by commands that are Nacked, refused, or for others, by a restart,
by a parameter and by a query; and at the very edges of busy."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mac.axis.acceptance import State
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.drive import Drive
from axistwin.devices.mac.axis.memory_map import RATES
from axistwin.devices.mac.serial import device as serial
from axistwin.devices.mac.serial.device import MacSerial
from axistwin.devices.mac.serial.framing import GENERAL_ADDRESS
from axistwin.kernel.effects import Transmit
from zoo.mutant import Any_, MonkeyPatch, answers, frames, mutant, on, target_of, wrap

LAG_NS = 100_000
RUN_ON_NS = 300_000_000
QUERIES = range(0x20, 0x2A)


def _signed(number: int) -> int:
    return number - (1 << 32) if number >> 31 else number


# --- Nacked, or for others -----------------------------------------------------------------------


@mutant("MACS-FRAME-03", "MACS-REPLY-02")
def general_frames_need_no_sum(patch: MonkeyPatch) -> None:
    """What is for all is executed and answered whatever its sum."""

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        is_general = request.address == GENERAL_ADDRESS
        judge(frame, request._replace(is_sum_right=True) if is_general else request)

    frames(patch, act)


def _nacked(patch: MonkeyPatch, index: int, act: Any_) -> None:
    """Let `act(module)` be done by that command under a wrong sum."""

    def acting(judge: Any_, module: MacSerial, _: bytes, request: Any) -> None:
        is_wrong = request.is_framed and not request.is_sum_right
        if request.command == index and is_wrong and request.address == module.address:
            act(module)
        judge()

    frames(patch, acting)


@mutant("MACS-REPLY-04")
def a_nacked_arm_arms(patch: MonkeyPatch) -> None:
    """10h under a wrong sum holds the next motion back."""
    _nacked(patch, 0x10, lambda module: setattr(module.axis, "_armed", True))


@mutant("MACS-REPLY-04")
def a_nacked_clearing_clears(patch: MonkeyPatch) -> None:
    """0Bh under a wrong sum makes the counter 0."""
    _nacked(patch, 0x0B, lambda module: module.axis.drive.counter.set(module._etx_ns, 0))


@mutant("MACS-REPLY-13")
def a_start_for_another_starts(patch: MonkeyPatch) -> None:
    """11h starts what is preloaded, whoever it is for."""
    wrap(patch, MacSerial, "_concerns", lambda concerns: lambda module, request: True)

    def act(judge: Any_, module: MacSerial, _: bytes, request: Any) -> None:
        if request.address in (module.address, GENERAL_ADDRESS):
            judge()
        elif request.is_framed and request.is_sum_right and request.command == 0x11:
            module._command(0x11, 0, general=False)

    frames(patch, act)


@mutant("MACS-REPLY-12")
def a_query_to_all_is_answered_twice(patch: MonkeyPatch) -> None:
    """A query to FF is answered as one to all, and once more as one to module 00."""

    def act(judge: Any_, module: MacSerial, _: bytes, request: Any) -> None:
        judge()
        is_general = request.address == GENERAL_ADDRESS and request.is_sum_right
        if is_general and request.command in QUERIES:
            judge()

    frames(patch, act)


@mutant("MACS-MULTI-02")
def a_start_to_all_is_only_acknowledged(patch: MonkeyPatch) -> None:
    """11h to FF starts nothing in any module."""

    def make(command: Any_) -> Any_:
        def commanding(module: MacSerial, index: int, n: int, *, general: bool) -> Any:
            if index == 0x11 and general:
                return module._accepted
            return command(module, index, n, general=general)

        return commanding

    wrap(patch, MacSerial, "_command", make)


# --- refused -------------------------------------------------------------------------------------


@mutant("MACS-REPLY-05")
def a_refused_move_is_made_later(patch: MonkeyPatch) -> None:
    """13h in endless motion is refused, and made once the axis has come to rest."""
    owed: dict[Drive, int] = {}

    def act(go: Any_, axis: Axis, _: int, number: int) -> bool:
        accepted = bool(go())
        if not accepted and axis.drive.kind is State.VE:
            owed[axis.drive] = _signed(number)
        return accepted

    def make(finish: Any_) -> Any_:
        def finishing(drive: Drive, now: int) -> None:
            finish(drive, now)
            if drive.kind is None and drive in owed:
                drive.go_to(now, owed.pop(drive), now)

        return finishing

    on(patch, 0x13, act)
    wrap(patch, Drive, "_finish", make)


@mutant("MACS-REPLY-05")
def a_refused_mode_switches_the_stops_off(patch: MonkeyPatch) -> None:
    """03h with a value that is not in the manual is refused, and mode 0 then holds."""

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        accepted = bool(go())
        if not accepted and axis.drive.kind is None:
            axis.values["stops"] = 0
        return accepted

    on(patch, 0x03, act)


@mutant("MACS-REPLY-05")
def a_refused_target_disarms(patch: MonkeyPatch) -> None:
    """13h beyond the range of the counter is refused, and uses the arm up."""

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        accepted = bool(go())
        axis._armed = axis._armed and accepted
        return accepted

    on(patch, 0x13, act)


@mutant("MACS-CMD-XX-02", "MACS-REPLY-05")
def a_refused_rate_restarts(patch: MonkeyPatch) -> None:
    """1Bh with a value that is not in the manual is refused, and the module starts anew."""
    set_rate = serial._FACE_COMMANDS[0x1B]

    def setting(module: MacSerial, number: int, general: bool) -> Any:
        reply = set_rate(module, number, general)
        if number & 0xFF not in RATES:
            module._restart(True)
        return reply

    patch.setitem(serial._FACE_COMMANDS, 0x1B, setting)


# --- restarts ------------------------------------------------------------------------------------


@mutant("MACS-CMD-00-01")
def an_arm_survives_a_restart(patch: MonkeyPatch) -> None:
    """What 10h has armed, with no motion preloaded, is still armed after 00h."""

    def make(shut_down: Any_) -> Any_:
        def shutting_down(axis: Axis, now: int) -> None:
            armed = axis._armed and axis._preload is None
            shut_down(axis, now)
            axis._armed = armed

        return shutting_down

    wrap(patch, Axis, "shut_down", make)


@mutant("MACS-CMD-00-01")
def a_motion_runs_on_into_the_start(patch: MonkeyPatch) -> None:
    """After 00h the axis goes on for 0.3 s."""

    def make(shut_down: Any_) -> Any_:
        def shutting_down(axis: Axis, now: int) -> None:
            is_moving = axis.drive.kind is not None
            place = axis.counter_at(now + RUN_ON_NS) if is_moving else None
            shut_down(axis, now)
            if place is not None:
                axis.drive.counter.set(now, place)

        return shutting_down

    wrap(patch, Axis, "shut_down", make)


@mutant("MACS-REPLY-12")
def the_end_of_the_start_is_announced(patch: MonkeyPatch) -> None:
    """When it listens again, the module sends Xon."""

    def make(wake: Any_) -> Any_:
        def waking(module: MacSerial, now: int) -> Any:
            is_over = module._boot_end <= now
            effects = wake(module, now)
            return [*effects, Transmit(now, b"\x1a")] if is_over else effects

        return waking

    wrap(patch, MacSerial, "wake", make)


# --- parameters and queries ----------------------------------------------------------------------


@mutant("MACS-CMD-02-01")
def torque_at_rest_takes_the_stops_along(patch: MonkeyPatch) -> None:
    """02h writes its own half of a byte, and 0 into the other, which is that of 03h."""

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        accepted = bool(go())
        if accepted:
            axis.values["stops"] = 0
        return accepted

    on(patch, 0x02, act)


@mutant("MACS-Q-XX-01")
def reading_a_stop_unlocks(patch: MonkeyPatch) -> None:
    """After 22h in motion 13h is no longer refused."""
    unlocked: set[Axis] = set()

    def read(value: int, axis: Axis, _: int) -> int:
        unlocked.add(axis)
        return value

    def make(is_locked: Any_) -> Any_:
        def locked(axis: Axis, index: int, number: int) -> bool:
            if axis.drive.kind is None:
                unlocked.discard(axis)
            return bool(is_locked(axis, index, number)) and not (index == 0x13 and axis in unlocked)

        return locked

    answers(patch, 0x22, read)
    wrap(patch, Axis, "is_locked", make)


@mutant("MACS-Q-XX-01")
def each_reading_of_the_counter_costs_a_moment(patch: MonkeyPatch) -> None:
    """Each 20h in motion puts it 0.1 ms behind."""
    read: dict[Axis, int] = {}

    def change(value: int, axis: Axis, now: int) -> int:
        read[axis] = read.get(axis, 0) + 1 if axis.drive.kind is not None else 0
        return axis.drive.reading_at(now - LAG_NS * read[axis]) if read[axis] else value

    answers(patch, 0x20, change)


@mutant("MACS-Q-20-01")
def within_the_tolerance_the_target_is_told(patch: MonkeyPatch) -> None:
    """20h answers the target of a move that is no longer busy."""

    def change(value: int, axis: Axis, now: int) -> int:
        target = target_of(axis.drive) if axis.drive.kind is State.PO else None
        return value if target is None or axis.drive.is_busy(now) else target

    answers(patch, 0x20, change)


# --- busy ----------------------------------------------------------------------------------------


def _tolerating(patch: MonkeyPatch, change: Any_) -> None:
    """Let the busy line work with `change(tolerance)`."""

    def make(is_busy: Any_) -> Any_:
        def busy(drive: Drive, now: int) -> bool:
            values: Any = drive._values
            kept = values["tolerance"]
            values["tolerance"] = change(kept)
            try:
                return bool(is_busy(drive, now))
            finally:
                values["tolerance"] = kept

        return busy

    wrap(patch, Drive, "is_busy", make)


@mutant("MACS-BUSY-01", "MACS-CMD-1C-01")
def the_tolerance_counts_on_seven_bits(patch: MonkeyPatch) -> None:
    """A tolerance of 80h or more acts as one that is 80h less; 26h shows it as it was set."""
    _tolerating(patch, lambda tolerance: tolerance & 0x7F)


@mutant("MACS-BUSY-01")
def at_the_tolerance_it_is_busy(patch: MonkeyPatch) -> None:
    """With as many increments to go as the tolerance has, the axis is still busy."""
    _tolerating(patch, lambda tolerance: max(0, tolerance - 1))


@mutant("MACS-BUSY-01")
def busy_begins_with_the_first_increment(patch: MonkeyPatch) -> None:
    """A move is not busy while the axis stands where it began."""
    origins: dict[Drive, int] = {}

    def make_go(go_to: Any_) -> Any_:
        def going(drive: Drive, now: int, number: int, start_ns: int) -> None:
            origins[drive] = drive.counter.at(now)
            go_to(drive, now, number, start_ns)

        return going

    def make_busy(is_busy: Any_) -> Any_:
        def busy(drive: Drive, now: int) -> bool:
            is_at_start = drive.kind is State.PO and drive.counter.at(now) == origins.get(drive)
            return bool(is_busy(drive, now)) and not is_at_start

        return busy

    wrap(patch, Drive, "go_to", make_go)
    wrap(patch, Drive, "is_busy", make_busy)


# --- in motion, and between 10h and 11h ----------------------------------------------------------


@mutant("MACS-CMD-19-01")
def power_stops_an_endless_motion(patch: MonkeyPatch) -> None:
    """19h given in velocity motion stops the axis as 18h does."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        is_turning = axis.drive.kind is State.VE
        return bool(axis.execute(now, 0x18, 0, now)) if is_turning else bool(go())

    on(patch, 0x19, act)


@mutant("MACS-Q-21-01")
def enabling_the_reference_clears_the_stop_bit(patch: MonkeyPatch) -> None:
    """07h leaves 00 where 21h told of a stop."""

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        axis.drive.stops.bits = 0
        return bool(go())

    on(patch, 0x07, act)


@mutant("MACS-CMD-15-01")
def the_low_byte_of_a_speed_has_a_sign(patch: MonkeyPatch) -> None:
    """15h takes the low byte of its period for a signed number."""

    def act(go: Any_, _: Axis, __: int, parameters: int) -> bool:
        has_both = parameters & 0xFF00 and parameters & 0x80
        return bool(go(parameters - 0x100 if has_both else parameters))

    on(patch, 0x15, act)


@mutant("MACS-CMD-19-01")
def power_drops_what_10h_has_begun(patch: MonkeyPatch) -> None:
    """19h disarms, and forgets the motion that is preloaded."""

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        axis._armed, axis._preload = False, None
        return bool(go())

    on(patch, 0x19, act)


@mutant("MACS-CMD-1C-01")
def a_tolerance_on_the_way_ends_the_move(patch: MonkeyPatch) -> None:
    """1Ch during a move that has no more to go than its value stops the axis there."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        accepted = bool(go())
        target = target_of(axis.drive) if axis.drive.kind is State.PO else None
        left = None if target is None else abs(target - axis.counter_at(now))
        if left is not None and left <= axis.values["tolerance"]:
            axis.drive.hard_stop(now, keeps_segments=False)
        return accepted

    on(patch, 0x1C, act)


@mutant("MACS-CMD-0C-03")
def in_motion_the_torque_limit_is_lowered_only(patch: MonkeyPatch) -> None:
    """0Ch in motion is refused if it asks for more than there is."""

    def act(go: Any_, axis: Axis, _: int, number: int) -> bool:
        is_more = number & 0xFF > axis.values["torque"]
        return not (is_more and axis.drive.kind is not None) and bool(go())

    on(patch, 0x0C, act)


@mutant("MACS-STATE-01")
def an_arm_in_motion_lifts_the_lock(patch: MonkeyPatch) -> None:
    """After 10h in motion the parameters are free."""

    def make(is_locked: Any_) -> Any_:
        def locked(axis: Axis, index: int, number: int) -> bool:
            is_free = axis._armed and axis.drive.kind is not None and index < 0x10
            return bool(is_locked(axis, index, number)) and not is_free

        return locked

    wrap(patch, Axis, "is_locked", make)


@mutant("MACS-REPLY-05")
def a_refused_stop_is_in_force_after_a_restart(patch: MonkeyPatch) -> None:
    """0Ah refused in motion is stored, and read at the next start."""

    def act(go: Any_, axis: Axis, _: int, number: int) -> bool:
        accepted = bool(go())
        if not accepted:
            axis.parameters.store("inferior_stop", _signed(number))
        return accepted

    on(patch, 0x0A, act)


@mutant("MACS-STATE-01")
def what_is_for_all_knows_no_lock(patch: MonkeyPatch) -> None:
    """A parameter that motion locks is stored in motion if the frame is for FF."""
    is_general = [False]

    def act(judge: Any_, _: MacSerial, __: bytes, request: Any) -> None:
        is_general[0] = request.address == GENERAL_ADDRESS
        judge()

    def make(is_locked: Any_) -> Any_:
        def locking(axis: Axis, index: int, number: int) -> bool:
            is_free = is_general[0] and index < 0x10
            return bool(is_locked(axis, index, number)) and not is_free

        return locking

    frames(patch, act)
    wrap(patch, Axis, "is_locked", make)


@mutant("MACS-REPLY-05")
def busy_looks_at_a_refused_target(patch: MonkeyPatch) -> None:
    """The target of a 13h that is refused is that of busy until the next motion."""
    refused: list[int] = []

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        was_moving = target_of(axis.drive) is not None
        is_taken = bool(go())
        refused[:] = [_signed(number)] if was_moving and not is_taken else []
        return is_taken

    def make(is_busy: Any_) -> Any_:
        def looking(drive: Drive, now: int) -> bool:
            if refused and target_of(drive) is not None:
                return abs(drive.counter.at(now) - refused[0]) > drive._values["tolerance"]
            return bool(is_busy(drive, now))

        return looking

    on(patch, 0x13, act)
    wrap(patch, Drive, "is_busy", make)


@mutant("MACS-MULTI-02")
def a_restart_for_all_is_not_obeyed(patch: MonkeyPatch) -> None:
    """00h to FF is acknowledged, and does nothing."""

    def act(judge: Any_, module: MacSerial, _: bytes, request: Any) -> None:
        if request.address == GENERAL_ADDRESS and request.command == 0 and request.is_sum_right:
            module._transmit(module._accepted)
        else:
            judge()

    frames(patch, act)


@mutant("MACS-REPLY-08")
def a_frame_for_another_leaves_its_address_in_the_next_answer(patch: MonkeyPatch) -> None:
    """The address of an answer is that of the frame before where that was for somebody else."""
    others: list[bytes] = []

    def act(judge: Any_, module: MacSerial, frame: bytes, request: Any) -> None:
        if request.address not in (module.address, GENERAL_ADDRESS):
            others[:] = [frame[4:6]]
        judge()

    def make_concerns(concerns: Any_) -> Any_:
        def concerning(module: MacSerial, request: Any) -> bool:
            if request.address is not None and request.address not in (
                module.address,
                GENERAL_ADDRESS,
            ):
                others[:] = [b"%02X" % request.address]
            return bool(concerns(module, request))

        return concerning

    def make_transmit(transmit: Any_) -> Any_:
        def transmitting(module: MacSerial, data: bytes) -> None:
            if len(data) == 21 and others:
                data = data[:6] + others.pop() + data[8:]
                data = data[:17] + b"%02X" % (sum(data[6:17]) & 0xFF) + data[19:]
            transmit(module, data)

        return transmitting

    frames(patch, act)
    wrap(patch, MacSerial, "_concerns", make_concerns)
    wrap(patch, MacSerial, "_transmit", make_transmit)
    wrap(patch, MacSerial, "quiet_prefix", lambda _: lambda module, data: max(0, len(data) - 1))
    patch.setattr(MacSerial, "heeded_address", lambda module, now: None)
