"""Faults in what a module says unasked (BOOT, EMCY)."""

from __future__ import annotations

from typing import Any

from zoo.mutant import Any_, MonkeyPatch, wrap

from axistwin.devices.mac.axis.faults import Faults
from axistwin.devices.mac.can.device import MacCan
from axistwin.kernel.effects import SendFrame
from axistwin.kernel.schedule import NEVER
from axistwin.wire.can_frame import CanFrame
from zoo_can.planting import DOWNLOAD, UPLOAD, around, can_mutant, hears, sends

BOOT_UP, EMERGENCY, SYNC = 0x700, 0x080, 0x080
S = 1_000_000_000


def _is_emergency(identifier: int, data: bytes) -> bool:
    return EMERGENCY < identifier < 0x100 and bool(data)


# --- boot-up -------------------------------------------------------------------------------------


def _boot_ups(patch: MonkeyPatch, act: Any_) -> None:
    """Let boot-up messages be sent by `act(send, module, identifier, data, now)`."""

    def sending(send: Any_, module: MacCan, identifier: int, data: bytes, now: int) -> Any:
        if BOOT_UP <= identifier < 0x780:
            return act(send, module, identifier, data, now)
        return send(identifier, data, now)

    sends(patch, sending)


@can_mutant("MACC-BOOT-01", "MACC-CMD-00-01", traps=(19,))
def a_reset_ends_silently(patch: MonkeyPatch) -> None:
    """After 2000h the module is there again without a word."""

    def act(send: Any_, module: Any, identifier: int, data: bytes, now: int) -> Any:
        module.resets, was = False, getattr(module, "resets", False)
        return None if was else send(identifier, data, now)

    def note(go: Any_, module: Any, *arguments: Any) -> Any:
        module.resets = True
        return go()

    _boot_ups(patch, act)
    around(patch, "_restart", note)


@can_mutant("MACC-BOOT-01")
def a_module_switched_on_says_nothing(patch: MonkeyPatch) -> None:
    """Only commands make the module say that it is there."""

    def act(send: Any_, module: Any, identifier: int, data: bytes, now: int) -> Any:
        module.is_switched_on, was = False, getattr(module, "is_switched_on", False)
        return None if was else send(identifier, data, now)

    def note(go: Any_, module: Any, *arguments: Any) -> Any:
        module.is_switched_on = True
        return go()

    _boot_ups(patch, act)
    around(patch, "power_on", note)


@can_mutant("MACC-BOOT-01", traps=(19,))
def the_boot_up_message_comes_twice(patch: MonkeyPatch) -> None:
    """A hundredth of a second later it is sent again."""

    def act(send: Any_, _: MacCan, identifier: int, data: bytes, now: int) -> Any:
        send(identifier, data, now + S // 100)
        return send(identifier, data, now)

    _boot_ups(patch, act)


@can_mutant("MACC-BOOT-01")
def a_restart_in_motion_ends_silently(patch: MonkeyPatch) -> None:
    """A module that 2000h has found moving is there again without a word."""

    def act(send: Any_, module: Any, identifier: int, data: bytes, now: int) -> Any:
        module.was_moving, was = False, getattr(module, "was_moving", False)
        return None if was else send(identifier, data, now)

    def note(go: Any_, module: Any, *arguments: Any) -> Any:
        module.was_moving = module.axis.drive.kind is not None
        return go()

    _boot_ups(patch, act)
    around(patch, "_restart", note)


@can_mutant("MACC-BOOT-01")
def it_starts_once_more(patch: MonkeyPatch) -> None:
    """Its watchdog is fed too late: half a second after a restart it starts anew, once."""

    def note(go: Any_, module: Any, *arguments: Any) -> Any:
        module.is_fed = False
        return go()

    def act(go: Any_, module: Any, now: int) -> None:
        go()
        if not getattr(module, "is_fed", True):
            module.is_fed = module._take_over_restarts = True
            module._take_over_at = now + S // 2

    around(patch, "_restart", note)
    around(patch, "_booted", act)


@can_mutant("MACC-STATE-02")
def a_boot_outlives_the_reset_input(patch: MonkeyPatch) -> None:
    """Held in reset amid its start-up it says in the end that it is there."""

    def act(go: Any_, module: Any, now: int, held: bool) -> None:
        end_ns = module._boot_end
        go()
        if held and end_ns != NEVER:
            module._boot_end = end_ns

    around(patch, "_set_reset_input", act)


@can_mutant("MACC-BOOT-02")
def it_is_operational_at_once(patch: MonkeyPatch) -> None:
    """The boot-up message is a heartbeat of a module in operation: 05."""
    _boot_ups(patch, lambda send, module, identifier, data, now: send(identifier, b"\x05", now))


@can_mutant("MACC-BOOT-01")
def the_boot_up_message_has_no_address(patch: MonkeyPatch) -> None:
    """It comes under 700h, whoever sends it."""
    _boot_ups(patch, lambda send, module, identifier, data, now: send(BOOT_UP, data, now))


@can_mutant("MACC-BOOT-02")
def the_boot_up_message_tells_the_address(patch: MonkeyPatch) -> None:
    """Its byte is the address."""
    _boot_ups(
        patch,
        lambda send, module, identifier, data, now: send(identifier, bytes((module.address,)), now),
    )


@can_mutant("MACC-BOOT-04", traps=(19,))
def it_is_there_a_second_after_its_boot_up_message(patch: MonkeyPatch) -> None:
    """The boot-up message comes before the module listens."""

    def act(go: Any_, module: Any, now: int) -> None:
        go()
        module.deaf_until = now + S

    def hear(go: Any_, module: Any, frame: CanFrame, end_ns: int) -> Any:
        return [] if end_ns < getattr(module, "deaf_until", 0) else go()

    around(patch, "_booted", act)
    around(patch, "receive", hear)


def _in_the_boot(patch: MonkeyPatch, act: Any_) -> None:
    """Let `act(module, frame, end_ns)` tell what comes of own requests while the module starts."""

    def hear(go: Any_, module: MacCan, frame: CanFrame, end_ns: int) -> Any:
        is_own = frame.identifier == 0x600 + module.address and len(frame.data) == 8
        if is_own and end_ns < module._boot_end < NEVER:
            return act(module, frame, end_ns)
        return go()

    around(patch, "receive", hear)


@can_mutant("MACC-BOOT-04")
def what_comes_while_it_starts_puts_its_boot_up_message_off(patch: MonkeyPatch) -> None:
    """The module is deaf until nothing has come for 2 s."""

    def act(module: MacCan, _: CanFrame, end_ns: int) -> Any:
        module._boot_end = end_ns + module._boot_ns
        module._hear_nothing(module._boot_end)
        module._reschedule()
        return []

    _in_the_boot(patch, act)


@can_mutant("MACC-BOOT-04")
def it_answers_while_it_starts(patch: MonkeyPatch) -> None:
    """Uploads are answered between reset and boot-up message."""

    def act(module: MacCan, frame: CanFrame, end_ns: int) -> list[Any]:
        module._now = end_ns
        if frame.data[0] == UPLOAD and (reply := module._serve(frame.data)):
            return [SendFrame(end_ns, CanFrame(0x580 + module.address, reply))]
        return []

    _in_the_boot(patch, act)


@can_mutant("MACC-BOOT-04", traps=(20,))
def what_came_while_it_starts_is_served_afterwards(patch: MonkeyPatch) -> None:
    """The controller keeps what it received; the module reads it when it is there."""

    def keep(module: Any, frame: CanFrame, _: int) -> list[Any]:
        module.kept = [*getattr(module, "kept", []), frame.data][-8:]
        return []

    def serve(go: Any_, module: Any, now: int) -> None:
        go()
        kept, module.kept, module._now = getattr(module, "kept", []), [], now
        for data in kept:
            module._own_request(data)

    _in_the_boot(patch, keep)
    around(patch, "_booted", serve)


@can_mutant("MACC-BOOT-04", traps=(20,))
def what_came_while_it_starts_is_executed_mutely(patch: MonkeyPatch) -> None:
    """Downloads sent between reset and boot-up message are stored, without a reply."""

    def act(module: MacCan, frame: CanFrame, end_ns: int) -> list[Any]:
        if frame.data[:3] == b"\x23\x0f\x20":
            module.axis.parameters.set_ramp(frame.data[7])
        return []

    _in_the_boot(patch, act)


@can_mutant("MACC-BOOT-01", traps=(38,))
def a_starting_module_gives_a_lifebeat(patch: MonkeyPatch) -> None:
    """The timer of the lifebeat runs on through the boot: one comes a second after the reset."""

    def act(go: Any_, module: MacCan, now: int) -> None:
        go()
        status = module.axis.query(now, 0x21).to_bytes(4, "big")
        module._send(EMERGENCY + module.address, bytes(3) + status + b"\0", now + S)

    around(patch, "_begin_boot", act)


# --- emergency and lifebeat ----------------------------------------------------------------------


def _emergencies(patch: MonkeyPatch, act: Any_) -> None:
    """Let emergencies and lifebeats be sent by `act(send, module, identifier, data, now)`."""

    def sending(send: Any_, module: MacCan, identifier: int, data: bytes, now: int) -> Any:
        if _is_emergency(identifier, data):
            return act(send, module, identifier, data, now)
        return send(identifier, data, now)

    sends(patch, sending)


def _lifebeats_after(patch: MonkeyPatch, time_ns: int) -> None:
    def act(go: Any_, module: MacCan, now: int) -> None:
        go()
        module._lifebeat_at = now + time_ns

    around(patch, "_restart_lifebeat", act)


@can_mutant("MACC-EMCY-01", "MACC-EMCY-05")
def the_lifebeat_is_a_tenth_of_a_second_early(patch: MonkeyPatch) -> None:
    """The ten seconds are 9.9."""
    _lifebeats_after(patch, 99 * S // 10)


@can_mutant("MACC-EMCY-01")
def the_lifebeat_comes_every_twelve_seconds(patch: MonkeyPatch) -> None:
    """The ten seconds are twelve."""
    _lifebeats_after(patch, 12 * S)


@can_mutant("MACC-EMCY-01")
def there_is_one_lifebeat_only(patch: MonkeyPatch) -> None:
    """After a lifebeat the module waits for a request before it gives another one."""

    def act(go: Any_, module: MacCan, now: int) -> None:
        go()
        module._lifebeat_at = NEVER

    around(patch, "_lifebeat", act)


@can_mutant("MACC-EMCY-05", traps=(14,))
def whoever_is_asked_anything_puts_the_lifebeat_off(patch: MonkeyPatch) -> None:
    """Requests to other modules count as communication."""
    hears(
        patch,
        lambda module, frame: 0x601 <= frame.identifier < 0x680 and not frame.is_extended,
        lambda module, frame: module._restart_lifebeat(module._now),
    )


@can_mutant("MACC-EMCY-05", traps=(14,))
def sync_alone_puts_the_lifebeat_off(patch: MonkeyPatch) -> None:
    """A host that sends SYNC and nothing else never hears a lifebeat; 600h does not count."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        module._restart_lifebeat(module._now)
        go()

    around(patch, "_sync", act)


@can_mutant("MACC-EMCY-05")
def the_address_procedure_puts_the_lifebeat_off(patch: MonkeyPatch) -> None:
    """Frames on 7E5h count as communication."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        module._restart_lifebeat(module._now)
        go()

    around(patch, "_lmt", act)


@can_mutant("MACC-EMCY-05", traps=(14,))
def only_downloads_put_the_lifebeat_off(patch: MonkeyPatch) -> None:
    """An upload is no communication."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        before = module._lifebeat_at
        go()
        if data[:1] != bytes((DOWNLOAD,)):
            module._lifebeat_at = before

    around(patch, "_own_request", act)


@can_mutant("MACC-EMCY-05")
def refusals_do_not_put_the_lifebeat_off(patch: MonkeyPatch) -> None:
    """Only what is accepted is communication."""

    def act(go: Any_, module: MacCan, identifier: int | None, reply: bytes | None) -> None:
        if reply is not None and reply[0] == 0x80:
            module._lifebeat_at = getattr(module, "due_before", module._lifebeat_at)
        go()

    def note(go: Any_, module: Any, data: bytes) -> None:
        module.due_before = module._lifebeat_at
        go()

    around(patch, "_answer", act)
    around(patch, "_own_request", note)


@can_mutant("MACC-EMCY-05")
def the_ten_seconds_begin_with_the_first_request(patch: MonkeyPatch) -> None:
    """After the boot-up message the module waits for a request before it gives lifebeats."""

    def act(go: Any_, module: MacCan, now: int) -> None:
        go()
        module._lifebeat_at = NEVER

    around(patch, "_booted", act)


@can_mutant("MACC-EMCY-03", traps=(13,))
def emergencies_come_under_sync(patch: MonkeyPatch) -> None:
    """Their identifier is 080h, whoever sends them."""
    _emergencies(patch, lambda send, module, identifier, data, now: send(EMERGENCY, data, now))


@can_mutant("MACC-EMCY-03")
def emergencies_have_seven_bytes(patch: MonkeyPatch) -> None:
    """The last zero is missing."""
    _emergencies(patch, lambda send, module, identifier, data, now: send(identifier, data[:7], now))


@can_mutant("MACC-EMCY-03", "MACC-EMCY-04")
def emergencies_tell_the_status_backwards(patch: MonkeyPatch) -> None:
    """The maker's bytes are hh gg ff dd."""
    _emergencies(
        patch,
        lambda send, module, identifier, data, now: send(
            identifier, data[:3] + data[6:2:-1] + data[7:], now
        ),
    )


@can_mutant("MACC-EMCY-04")
def a_lifebeat_tells_the_status_of_the_start(patch: MonkeyPatch) -> None:
    """The content of a lifebeat is that of the last emergency, or of the start."""

    def act(go: Any_, module: MacCan, now: int) -> None:
        module._send_emergency(now, module._told_status)
        module._restart_lifebeat(now)

    around(patch, "_lifebeat", act)


@can_mutant("MACC-EMCY-04")
def a_lifebeat_has_no_code(patch: MonkeyPatch) -> None:
    """The code is told when it changes; a lifebeat has code 0 and the status."""

    def act(go: Any_, module: Any, now: int) -> None:
        module.is_lifebeat = True
        go()
        module.is_lifebeat = False

    def error(go: Any_, module: Any) -> Any:
        return (0, 0) if getattr(module, "is_lifebeat", False) else go()

    around(patch, "_lifebeat", act)
    around(patch, "_error", error)


@can_mutant("MACC-EMCY-04")
def the_first_error_keeps_the_code(patch: MonkeyPatch) -> None:
    """While there is an error, a graver one that comes does not change the code."""

    def act(go: Any_, module: Any) -> Any:
        before = getattr(module, "first_error", (0, 0))
        now = go()
        module.first_error = before if before != (0, 0) and now != (0, 0) else now
        return module.first_error

    around(patch, "_error", act)


def _told_only(patch: MonkeyPatch, is_told: Any_) -> None:
    """Let a change of dd be told only if `is_told(before, now)`."""

    def act(go: Any_, module: MacCan, now: int) -> None:
        status = module.axis.query(now, 0x21)
        before, dd = module._told_status >> 24, status >> 24
        if module._listens and dd != before and not is_told(before, dd):
            module._told_status = status
        go()

    around(patch, "_collect", act)


@can_mutant("MACC-EMCY-02")
def warnings_are_not_told(patch: MonkeyPatch) -> None:
    """Only what locks the motor is an emergency."""
    _told_only(patch, lambda before, now: (before ^ now) & 0x11)


@can_mutant("MACC-EMCY-02")
def disjunctions_are_not_told(patch: MonkeyPatch) -> None:
    """Only the supply's warnings are emergencies."""
    _told_only(patch, lambda before, now: (before ^ now) & 0x60)


@can_mutant("MACC-EMCY-02")
def a_second_error_is_not_told(patch: MonkeyPatch) -> None:
    """While there is an error, another one is no news."""
    _told_only(patch, lambda before, now: not before or not now)


@can_mutant("MACC-EMCY-02")
def an_emergency_comes_with_the_next_lifebeat(patch: MonkeyPatch) -> None:
    """A change of the error code waits until ten seconds are over."""
    _told_only(patch, lambda before, now: False)


@can_mutant("MACC-EMCY-01")
def errors_are_told_and_no_lifebeat(patch: MonkeyPatch) -> None:
    """The message comes with a change of the error code alone."""
    around(patch, "_restart_lifebeat", lambda go, module, now: None)


@can_mutant("MACC-EMCY-01")
def there_is_no_lifebeat_in_motion(patch: MonkeyPatch) -> None:
    """A module that moves, or has segments to do, has no time to say that it lives."""

    def act(go: Any_, module: MacCan, now: int) -> None:
        if module.axis.state_code()[:2] in ("PO", "VE", "IN"):
            module._restart_lifebeat(now)
        else:
            go()

    around(patch, "_lifebeat", act)


@can_mutant("MACC-EMCY-05")
def the_end_of_a_motion_puts_the_lifebeat_off(patch: MonkeyPatch) -> None:
    """The ten seconds run while the axis is at rest."""

    def act(go: Any_, module: Any, now: int) -> None:
        go()
        was, module.was = getattr(module, "was", ""), module.axis.state_code()[:2]
        if was in ("PO", "VE", "IN") and module.was != was and module._lifebeat_at != NEVER:
            module._restart_lifebeat(now)

    around(patch, "_collect", act)


@can_mutant("MACC-EMCY-05")
def leaving_configuration_mode_puts_the_lifebeat_off(patch: MonkeyPatch) -> None:
    """04 00 counts as a request to the module, though nothing was given."""

    def act(go: Any_, module: MacCan) -> None:
        is_nothing = module._given_address is None
        go()
        if is_nothing:
            module._restart_lifebeat(module._now)

    around(patch, "_leave_configuration", act)


@can_mutant("MACC-EMCY-03")
def emergencies_keep_the_first_address(patch: MonkeyPatch) -> None:
    """The identifier of emergency and lifebeat is that of the address at power-up."""

    def note(go: Any_, module: Any, now: int) -> None:
        module.first = getattr(module, "first", module.address)
        go()

    def act(send: Any_, module: Any, identifier: int, data: bytes, now: int) -> Any:
        return send(EMERGENCY + module.first, data, now)

    around(patch, "_booted", note)
    _emergencies(patch, act)


@can_mutant("MACC-EMCY-02")
def an_emergency_is_repeated(patch: MonkeyPatch) -> None:
    """A change is told twice, a tenth of a second apart."""

    def act(send: Any_, module: MacCan, identifier: int, data: bytes, now: int) -> Any:
        if data[:1] != b"\0" or data[1:2] != b"\0":
            send(identifier, data, now + S // 10)
        return send(identifier, data, now)

    _emergencies(patch, act)


@can_mutant("MACC-Q-01-02", traps=(39,))
def it_trips_at_85_degrees(patch: MonkeyPatch) -> None:
    """78h, which is 85.0 degrees exactly, is above 85 degrees."""

    def make(measure: Any_) -> Any_:
        def measuring(faults: Faults) -> None:
            measure(faults)
            if faults.raw_temperature >= 0x78:
                faults.latched |= 0x10

        return measuring

    wrap(patch, Faults, "_measure", make)
