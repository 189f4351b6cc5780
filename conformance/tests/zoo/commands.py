"""Faults in parameters, re-initialisation, address and rate, and in what is locked in motion."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.drive import Drive
from axistwin.devices.mac.axis.memory_map import RATES
from axistwin.devices.mac.axis.module import MacModule
from axistwin.devices.mac.axis.parameters import Parameters
from axistwin.devices.mac.serial.device import MacSerial
from zoo.mutant import MOVING, Any_, MonkeyPatch, State, cells, frames, mutant, on, setter, wrap

EVERY = tuple(State)


# --- 00h, 01h ------------------------------------------------------------------------------------


@mutant("MACS-CMD-00-01", traps=(34,))
def initialisation_clears_the_position(patch: MonkeyPatch) -> None:
    """After 00h the counter is 0."""

    def make(shut_down: Any_) -> Any_:
        def shutting_down(axis: Axis, now: int) -> None:
            shut_down(axis, now)
            axis.drive.counter.set(now, 0)

        return shutting_down

    wrap(patch, Axis, "shut_down", make)


@mutant("MACS-CMD-00-01")
def initialisation_keeps_the_stop_bits(patch: MonkeyPatch) -> None:
    """ff of 21h survives 00h."""

    def make(shut_down: Any_) -> Any_:
        def shutting_down(axis: Axis, now: int) -> None:
            bits = axis.drive.stops.bits
            shut_down(axis, now)
            axis.drive.stops.bits = bits

        return shutting_down

    wrap(patch, Axis, "shut_down", make)


@mutant("MACS-CMD-00-01", "MACS-PERS-01")
def the_catch_up_speed_is_not_stored(patch: MonkeyPatch) -> None:
    """0Eh changes the value in use only."""

    def set_catch_up(parameters: Parameters, number: int) -> bool:
        parameters.values["catchup"] = number >> 8 & 0xFF
        return True

    from axistwin.devices.mac.axis import axis

    patch.setitem(axis._PARAMETERS, 0x0E, (set_catch_up, axis._PARAMETERS[0x0E][1]))


@mutant("MACS-CMD-00-02")
def it_listens_while_it_starts(patch: MonkeyPatch) -> None:
    """After 00h the module is there again at once."""
    _boots_in(patch, 0)


@mutant("MACS-CMD-00-02")
def every_second_start_takes_longer(patch: MonkeyPatch) -> None:
    """After 00h the module is deaf for 2 s or for 4 s in turn, which is no reading of the 2 s."""

    def make(begin: Any_) -> Any_:
        def beginning(module: MacModule, now: int) -> None:
            module._boot_ns = 6_000_000_000 - module._boot_ns
            begin(module, now)

        return beginning

    wrap(patch, MacModule, "_begin_boot", make)


def _boots_in(patch: MonkeyPatch, boot_ns: int) -> None:
    def make(init: Any_) -> Any_:
        def initialising(module: MacSerial, *args: Any, **options: Any) -> None:
            init(module, *args, **options)
            module._boot_ns = boot_ns

        return initialising

    wrap(patch, MacSerial, "__init__", make)


@mutant("MACS-CMD-00-02", traps=(33,))
def a_starting_module_nacks(patch: MonkeyPatch) -> None:
    """While deaf the module still Nacks wrong sums."""
    from axistwin.devices.mac.serial.framing import take_apart
    from axistwin.kernel.effects import Transmit

    def act(module: MacSerial, chunk: Any, receive: Any_) -> Any:
        request = take_apart(bytes(chunk.data), any_case=False)
        if request.address == module.address and not request.is_sum_right:
            return [Transmit(chunk.arrival_ns(20) + 1_000_000, b"\x15")]
        return receive(module, chunk)

    wrap(patch, MacSerial, "quiet_prefix", lambda _: lambda module, data: max(0, len(data) - 1))
    _hears_frames(patch, act)


@mutant("MACS-CMD-00-02", traps=(33,))
def frames_sent_while_it_starts_are_executed_later(patch: MonkeyPatch) -> None:
    """Commands that come while the module is deaf are executed when it wakes."""
    from axistwin.devices.mac.serial.framing import number, take_apart

    def act(module: Any, chunk: Any, receive: Any_) -> Any:
        request = take_apart(bytes(chunk.data), any_case=False)
        index = request.command or 0
        if request.address == module.address and request.is_sum_right and 0 < index < 0x20:
            parameters = number(bytes(chunk.data[10:18]), any_case=False) or 0
            module.kept = [*getattr(module, "kept", []), (index, parameters)]
        return receive(module, chunk)

    def make(start: Any_) -> Any_:
        def starting(axis: Any, now: int) -> None:
            start(axis, now)
            for index, parameters in getattr(axis.owner, "kept", []):
                axis.execute(now, index, parameters, now)
            axis.owner.kept = []

        return starting

    def make_init(init: Any_) -> Any_:
        def initialising(module: Any, *args: Any, **options: Any) -> None:
            make_owner(module)
            init(module, *args, **options)
            module.axis.owner = module

        return initialising

    def make_owner(module: Any) -> None:
        patch.setattr(Axis, "owner", module, raising=False)

    wrap(patch, MacSerial, "__init__", make_init)
    wrap(patch, Axis, "start", make)
    wrap(patch, MacSerial, "quiet_prefix", lambda _: lambda module, data: max(0, len(data) - 1))
    _hears_frames(patch, act)


@mutant("MACS-CMD-00-02", traps=(33,))
def a_frame_may_begin_while_it_starts(patch: MonkeyPatch) -> None:
    """What comes last while the module is deaf may be the beginning of a frame."""

    def make(first_heard: Any_) -> Any_:
        def hearing(module: MacSerial, chunk: Any, first: int) -> int:
            heard = int(first_heard(module, chunk, first))
            _, stx, begun = bytes(chunk.data[first:heard]).rpartition(b"\x02")
            if module._boot_end < 1 << 61 and stx and len(begun) < 20:  # not all of it
                module.reception.partial = stx + begun
            return heard

        return hearing

    wrap(patch, MacSerial, "_first_heard", make)


def _hears_frames(patch: MonkeyPatch, act: Any_) -> None:
    """Put whole frames together while the module is deaf, and show them to `act`."""

    def make(receive: Any_) -> Any_:
        def receiving(module: Any, chunk: Any) -> Any:
            if module._boot_end >= 1 << 61 or chunk.start_ns >= module._boot_end:
                module.missed = b""
                return receive(module, chunk)
            module.missed = (getattr(module, "missed", b"") + chunk.data)[-21:]
            if len(module.missed) == 21 and module.missed[:1] == b"\x02":
                whole = _Whole(module.missed, chunk)
                module.missed = b""
                return act(module, whole, lambda one, _: receive(one, chunk))
            return receive(module, chunk)

        return receiving

    wrap(patch, MacSerial, "receive", make)


class _Whole:
    """A frame that came in several chunks, the last of which is known."""

    def __init__(self, data: bytes, last: Any) -> None:
        self.data, self._last = data, last

    def arrival_ns(self, _: int) -> int:
        """When the last byte had come."""
        return int(self._last.arrival_ns(len(self._last.data) - 1))


def _factory_reset(patch: MonkeyPatch, act: Any_) -> None:
    def make(restore: Any_) -> Any_:
        return lambda axis, now: act(axis, now, lambda: restore(axis, now))

    wrap(patch, Axis, "restore_factory_values", make)


def _keeps(name: str) -> Any_:
    def act(axis: Axis, _: int, go: Any_) -> None:
        kept = axis.stored[name]
        go()
        axis.parameters.store(name, kept)
        if name in axis.values:
            axis.parameters.values[name] = kept

    return act


@mutant("MACS-CMD-01-01")
def a_factory_reset_forgets_the_inferior_stop(patch: MonkeyPatch) -> None:
    """01h leaves the inferior stop as it was."""
    _factory_reset(patch, _keeps("inferior_stop"))


@mutant("MACS-CMD-01-01", traps=(34,))
def a_factory_reset_clears_the_position(patch: MonkeyPatch) -> None:
    """01h clears the counter, which is no parameter."""

    def act(axis: Axis, now: int, go: Any_) -> None:
        go()
        axis.drive.counter.set(now, 0)

    _factory_reset(patch, act)


@mutant("MACS-CMD-01-02")
def a_factory_reset_keeps_the_address(patch: MonkeyPatch) -> None:
    """01h leaves the address as it was."""
    _factory_reset(patch, _keeps("address"))


@mutant("MACS-CMD-01-02")
def a_factory_reset_keeps_the_rate(patch: MonkeyPatch) -> None:
    """01h leaves the baud rate as it was."""
    _factory_reset(patch, _keeps("baud"))


@mutant("MACS-CMD-01-01")
def a_factory_reset_is_not_acknowledged(patch: MonkeyPatch) -> None:
    """01h is obeyed in silence, though 00h is acknowledged."""
    from axistwin.devices.mac.serial import device as serial

    restore = serial._FACE_COMMANDS[0x01]

    def act(module: MacSerial, n: int, general: bool) -> None:
        restore(module, n, general)

    patch.setitem(serial._FACE_COMMANDS, 0x01, act)


@mutant("MACS-CMD-01-03")
def after_a_factory_reset_it_is_deaf_for_half_a_second(patch: MonkeyPatch) -> None:
    """01h restarts four times as fast as 00h."""

    def make(restore: Any_) -> Any_:
        def restoring(axis: Any, now: int) -> None:
            axis.hurries = True
            restore(axis, now)

        return restoring

    def make_boot(begin: Any_) -> Any_:
        def beginning(module: MacModule, now: int) -> None:
            begin(module, now)
            if getattr(module.axis, "hurries", False):
                module._boot_end = now + 500_000_000
                module._hear_nothing(module._boot_end)
            module.axis.hurries = False  # type: ignore[attr-defined]

        return beginning

    wrap(patch, Axis, "restore_factory_values", make)
    wrap(patch, MacModule, "_begin_boot", make_boot)


@mutant("MACS-CMD-01-02")
def the_factory_address_is_02(patch: MonkeyPatch) -> None:
    """01h gives the address 02."""

    def act(axis: Axis, _: int, go: Any_) -> None:
        go()
        axis.parameters.store("address", 2)

    _factory_reset(patch, act)


# --- parameters ----------------------------------------------------------------------------------


@mutant("MACS-CMD-02-01")
def nominal_and_half_torque_are_exchanged(patch: MonkeyPatch) -> None:
    """02h with 0 means half torque."""
    setter(patch, 0x02, lambda n: n ^ 1)


@mutant("MACS-CMD-03-01")
def both_stops_are_software_stops_only(patch: MonkeyPatch) -> None:
    """03h with 9 enables the software stops only."""
    setter(patch, 0x03, lambda n: 8 if n & 0xFF == 9 else n)


@mutant("MACS-CMD-08-01")
def a_new_address_is_only_acknowledged(patch: MonkeyPatch) -> None:
    """08h is accepted and never takes effect."""
    from axistwin.devices.mac.serial import device as serial

    patch.setitem(serial._FACE_COMMANDS, 0x08, lambda module, n, general: module._accepted)


@mutant("MACS-CMD-08-02")
def a_new_address_is_not_stored(patch: MonkeyPatch) -> None:
    """The address of 08h holds until the next start only."""
    from axistwin.devices.mac.serial import device as serial

    program = serial._FACE_COMMANDS[0x08]

    def act(module: MacSerial, n: int, general: bool) -> bytes | None:
        stored = module.axis.stored["address"]
        reply = program(module, n, general)
        module.axis.parameters.store("address", stored)
        return reply

    patch.setitem(serial._FACE_COMMANDS, 0x08, act)


@mutant("MACS-CMD-08-03")
def addresses_from_80_up_are_55(patch: MonkeyPatch) -> None:
    """08h with 80h or more is accepted and gives an address nobody asked for."""
    from axistwin.devices.mac.serial import device as serial

    program = serial._FACE_COMMANDS[0x08]
    patch.setitem(
        serial._FACE_COMMANDS,
        0x08,
        lambda module, n, general: program(module, 0x55 if n & 0x80 else n, general),
    )


@mutant("MACS-CMD-09-01", "MACS-Q-22-01")
def a_stop_has_24_bits(patch: MonkeyPatch) -> None:
    """09h keeps the lower 24 bits of its number."""
    setter(patch, 0x09, lambda n: n & 0xFFFFFF)


@mutant("MACS-CMD-0A-01", "MACS-Q-23-01")
def the_inferior_stop_sets_the_superior_one(patch: MonkeyPatch) -> None:
    """0Ah writes where 09h writes."""
    from axistwin.devices.mac.axis import axis

    patch.setitem(axis._PARAMETERS, 0x0A, axis._PARAMETERS[0x09])


@mutant("MACS-CMD-0B-01")
def clearing_the_counter_does_nothing(patch: MonkeyPatch) -> None:
    """0Bh is accepted without effect."""
    on(patch, 0x0B, lambda go, axis, now, n: True)


@mutant("MACS-CMD-0B-01")
def clearing_the_counter_leaves_one(patch: MonkeyPatch) -> None:
    """0Bh makes the counter 1."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        accepted = bool(go())
        axis.drive.counter.set(now, axis.counter_at(now) + 1)
        return accepted

    on(patch, 0x0B, act)


@mutant("MACS-CMD-0B-02", traps=(16,))
def clearing_the_counter_is_locked_in_motion(patch: MonkeyPatch) -> None:
    """0Bh is refused while running."""
    cells(patch, 0x0B, MOVING, "R")


@mutant("MACS-CMD-0C-01")
def the_torque_limit_is_halved(patch: MonkeyPatch) -> None:
    """0Ch keeps half of what it was given."""
    setter(patch, 0x0C, lambda n: (n & 0xFF) // 2)


@mutant("MACS-CMD-0C-02")
def torque_limits_have_no_end(patch: MonkeyPatch) -> None:
    """0Ch takes every byte."""

    def set_torque(parameters: Parameters, number: int) -> bool:
        return parameters._set("torque", number & 0xFF)

    from axistwin.devices.mac.axis import axis

    patch.setitem(axis._PARAMETERS, 0x0C, (set_torque, axis._PARAMETERS[0x0C][1]))


@mutant("MACS-CMD-0C-03", "MACS-CMD-0E-02", traps=(16,))
def torque_and_catch_up_are_locked_in_motion(patch: MonkeyPatch) -> None:
    """0Ch and 0Eh are refused while running."""
    cells(patch, (0x0C, 0x0E), MOVING, "R")


@mutant("MACS-CMD-07-01", "MACS-CMD-1C-01", traps=(16,))
def reference_and_tolerance_are_locked_in_motion(patch: MonkeyPatch) -> None:
    """07h and 1Ch are refused while running."""
    cells(patch, (0x07, 0x1C), MOVING, "R")


@mutant("MACS-CMD-0D-01", "MACS-Q-25-01")
def the_period_has_eight_bits(patch: MonkeyPatch) -> None:
    """0Dh keeps the last byte only."""
    setter(patch, 0x0D, lambda n: n & 0xFF or 1)


@mutant("MACS-CMD-0D-01", traps=(11,))
def the_period_is_a_frequency(patch: MonkeyPatch) -> None:
    """A larger VVVV moves faster."""
    wrap(patch, Drive, "_ramp", lambda ramp: lambda drive, p: ramp(drive, max(1, 0x400000 // p)))


@mutant("MACS-CMD-0D-03")
def a_period_of_zero_is_the_slowest(patch: MonkeyPatch) -> None:
    """0Dh with 0000 is accepted and means FFFF."""
    setter(patch, 0x0D, lambda n: n if n & 0xFFFF else 0xFFFF)


@mutant("MACS-CMD-0E-01", traps=(8,))
def the_catch_up_speed_is_the_last_byte(patch: MonkeyPatch) -> None:
    """0Eh takes the fourth byte for VV."""
    setter(patch, 0x0E, lambda n: (n & 0xFF) << 8)


@mutant("MACS-CMD-0F-01", "MACS-Q-26-01")
def the_ramp_coefficient_has_seven_bits(patch: MonkeyPatch) -> None:
    """0Fh keeps seven bits."""
    setter(patch, 0x0F, lambda n: n & 0x7F)


@mutant("MACS-CMD-1B-01", traps=(37,))
def a_new_rate_needs_no_restart(patch: MonkeyPatch) -> None:
    """1Bh changes the rate after its reply and goes on at once."""
    from axistwin.devices.mac.serial import device as serial

    def set_rate(module: MacSerial, n: int, _: bool) -> Any:
        code = module.axis.parameters.in_printed_set(n & 0xFF, tuple(RATES), 0x03)
        if code is None:
            return module._refused
        module.axis.parameters.store("baud", RATES[code])
        return module._restart(True, restarts=False)

    patch.setitem(serial._FACE_COMMANDS, 0x1B, set_rate)


@mutant("MACS-CMD-1B-01")
def no_rate_is_ever_changed(patch: MonkeyPatch) -> None:
    """1Bh restarts the module at the rate it had."""
    from axistwin.devices.mac.serial import device as serial

    def set_rate(module: MacSerial, n: int, _: bool) -> Any:
        code = module.axis.parameters.in_printed_set(n & 0xFF, tuple(RATES), 0x03)
        return module._refused if code is None else module._restart(True)

    patch.setitem(serial._FACE_COMMANDS, 0x1B, set_rate)


@mutant("MACS-CMD-1B-01")
def two_rates_are_exchanged(patch: MonkeyPatch) -> None:
    """1Bh takes 01 for 19200 and 02 for 9600 baud."""
    from axistwin.devices.mac.serial import device as serial

    choose = serial._FACE_COMMANDS[0x1B]
    patch.setitem(
        serial._FACE_COMMANDS,
        0x1B,
        lambda module, n, general: choose(module, {1: 2, 2: 1}.get(n & 0xFF, n), general),
    )


@mutant("MACS-CMD-1C-01", "MACS-Q-26-01")
def the_tolerance_is_signed(patch: MonkeyPatch) -> None:
    """1Ch with 80h or more gives the magnitude of a signed byte."""
    setter(patch, 0x1C, lambda n: 0x100 - (n & 0xFF) if n & 0x80 else n)


@mutant("MACS-CMD-XX-01")
def one_unassigned_command_is_accepted(patch: MonkeyPatch) -> None:
    """12h is accepted without effect, its neighbours in the table are refused."""

    def act(judge: Any_, module: MacSerial, _: bytes, request: Any) -> None:
        if request.command == 0x12 and request.is_sum_right and request.address == module.address:
            module._transmit(module._accepted)
            return
        judge()

    frames(patch, act)


@mutant("MACS-CMD-XX-02")
def stops_modes_are_bits(patch: MonkeyPatch) -> None:
    """03h keeps the lower half of any value."""

    def set_stops(parameters: Parameters, number: int) -> bool:
        return parameters._set("stops", number & 0xF)

    from axistwin.devices.mac.axis import axis

    patch.setitem(axis._PARAMETERS, 0x03, (set_stops, axis._PARAMETERS[0x03][1]))


# --- locks ---------------------------------------------------------------------------------------


@mutant("MACS-CMD-02-02", "MACS-STATE-01", traps=(16,))
def torque_at_rest_is_free_in_motion(patch: MonkeyPatch) -> None:
    """02h is accepted while running."""
    cells(patch, 0x02, MOVING, "A")


@mutant("MACS-CMD-03-02", traps=(16,))
def the_stops_mode_is_free_in_motion(patch: MonkeyPatch) -> None:
    """03h is accepted while running, with every value."""
    cells(patch, 0x03, MOVING, "A")


@mutant("MACS-CMD-090A-03", traps=(16,))
def the_software_stops_are_free_in_motion(patch: MonkeyPatch) -> None:
    """09h and 0Ah are accepted while running, unlike the others that the CAN list locks."""
    cells(patch, (0x09, 0x0A), MOVING, "A")


@mutant("MACS-CMD-0D-02")
def the_period_is_free_in_motion(patch: MonkeyPatch) -> None:
    """0Dh is accepted while running, unlike the others that the CAN list locks."""
    cells(patch, 0x0D, MOVING, "A")


@mutant("MACS-CMD-0F-02")
def the_ramp_is_free_in_motion(patch: MonkeyPatch) -> None:
    """0Fh is accepted while running, unlike the others that the CAN list locks."""
    cells(patch, 0x0F, MOVING, "A")


@mutant("MACS-CMD-14-02")
def going_to_0_is_free_in_motion(patch: MonkeyPatch) -> None:
    """14h is accepted while running, unlike the others that the CAN list locks."""
    cells(patch, 0x14, MOVING, "A")


@mutant("MACS-CMD-0F-02", "MACS-CMD-0D-02", "MACS-STATE-01")
def nothing_is_locked_in_velocity_motion(patch: MonkeyPatch) -> None:
    """The lock does not know of motions of 15h."""
    cells(patch, (0x02, 0x03, 0x09, 0x0A, 0x0D, 0x0F), (State.VE,), "A")


@mutant("MACS-STATE-01", "MACS-CMD-0F-02")
def the_ramp_is_locked_at_rest(patch: MonkeyPatch) -> None:
    """0Fh wants the motor unpowered."""
    cells(patch, 0x0F, (State.HD,), "R")


@mutant("MACS-CMD-00-02")
def what_comes_while_it_starts_begins_the_time_anew(patch: MonkeyPatch) -> None:
    """The module is deaf until nothing has come for 2 s."""

    def make(receive: Any_) -> Any_:
        def receiving(module: MacSerial, chunk: Any) -> Any:
            if chunk.start_ns < module._boot_end < 1 << 61:
                module._boot_end = chunk.start_ns + module._boot_ns
                module._hear_nothing(module._boot_end)
                module._reschedule()
            return receive(module, chunk)

        return receiving

    wrap(patch, MacSerial, "receive", make)
    wrap(patch, MacSerial, "quiet_prefix", lambda _: lambda module, data: max(0, len(data) - 1))
