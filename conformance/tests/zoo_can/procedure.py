"""Faults in the address procedure and in restarts (LMT, CMD-00, CMD-01, PERS, STATE-02)."""

from __future__ import annotations

from typing import Any

from zoo.mutant import Any_, MonkeyPatch, mutant, wrap

from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.can.device import MacCan
from axistwin.wire.can_frame import CanFrame
from zoo_can.planting import MODEL, UPLOAD, around, can_mutant, hears, sends

REQUEST, BOOT_UP, LMT_REPLY = 0x600, 0x700, 0x7E4
MODE, ADDRESS, STORE, BIT_TIMING, NODE = 0x04, 0x11, 0x17, 0x13, 0x5E
S = 1_000_000_000


def _lmt(patch: MonkeyPatch, act: Any_) -> None:
    """Let the module take a frame of 7E5h by `act(go, module, command, value)`."""
    around(
        patch,
        "_lmt",
        lambda go, module, data: act(go, module, *data[:2]) if len(data) > 1 else go(),
    )


# --- address procedure ---------------------------------------------------------------------------


@can_mutant("MACC-LMT-03", traps=(15,))
def an_address_takes_effect_when_it_is_given(patch: MonkeyPatch) -> None:
    """The frame 11 adr changes the address; 04 00 only stores it and restarts."""

    def act(go: Any_, module: MacCan, address: int) -> None:
        go()
        if module._given_address is not None:
            module._unstored_address = address
            module._take_over_stored()

    around(patch, "_give_address", act)


@can_mutant("MACC-LMT-03", traps=(15,))
def an_address_is_stored_when_it_is_given(patch: MonkeyPatch) -> None:
    """After an abandoned procedure the next start has the new address."""

    def act(go: Any_, module: MacCan, address: int) -> None:
        go()
        if module._given_address is not None:
            module.axis.parameters.store("address", address)

    around(patch, "_give_address", act)


def _leaving(patch: MonkeyPatch, act: Any_) -> None:
    around(patch, "_leave_configuration", act)


@can_mutant("MACC-LMT-03", "MACC-PERS-01")
def a_new_address_is_not_stored(patch: MonkeyPatch) -> None:
    """The address of the procedure holds until the next start."""

    def act(go: Any_, module: MacCan) -> None:
        stored, given = module.axis.stored["address"], module._given_address
        go()
        if given is not None:
            module.axis.parameters.store("address", stored)
            module._unstored_address = given

    _leaving(patch, act)


@can_mutant("MACC-LMT-03", "MACC-LMT-09")
def the_service_17h_stores_the_address(patch: MonkeyPatch) -> None:
    """What was given is stored by 17h as well, and holds after the next start."""

    def act(go: Any_, module: MacCan, command: int, value: int) -> None:
        go()
        if command == STORE and module._configures and module._given_address is not None:
            module.axis.parameters.store("address", module._given_address)

    _lmt(patch, act)


@can_mutant("MACC-PERS-02")
def a_new_address_overwrites_the_tolerance(patch: MonkeyPatch) -> None:
    """The cell of the tolerance gets the address too."""

    def act(go: Any_, module: MacCan) -> None:
        given = module._given_address
        if given is not None:
            module.axis.parameters.store("tolerance", given)
        go()

    _leaving(patch, act)


@can_mutant("MACC-Q-00-01")
def a_new_address_clears_the_position(patch: MonkeyPatch) -> None:
    """The procedure leaves the module as it comes from the factory: at 0."""

    def act(go: Any_, module: MacCan) -> None:
        if module._given_address is not None:
            module.axis.drive.zero(module._now, keeps_remaining=False)
        go()

    _leaving(patch, act)


@can_mutant("MACC-BOOT-01", traps=(19,))
def a_new_address_is_announced_twice(patch: MonkeyPatch) -> None:
    """Half a second after the boot-up message that ends the procedure another one comes."""

    def act(go: Any_, module: Any) -> None:
        module.is_given = module._given_address is not None
        go()

    def sending(send: Any_, module: Any, identifier: int, data: bytes, now: int) -> Any:
        if BOOT_UP < identifier < 0x780 and getattr(module, "is_given", False):
            module.is_given = False
            send(identifier, data, now + S // 2)
        return send(identifier, data, now)

    _leaving(patch, act)
    sends(patch, sending)


@can_mutant("MACC-LMT-01")
def a_new_address_waits_for_the_next_power_up(patch: MonkeyPatch) -> None:
    """The procedure stores the address and changes nothing yet."""

    def act(go: Any_, module: Any) -> None:
        before = module.address
        given = module._given_address
        go()
        if given is not None:
            module._unstored_address = before

    _leaving(patch, act)


@can_mutant("MACC-LMT-01")
def the_procedure_is_acknowledged_and_forgotten(patch: MonkeyPatch) -> None:
    """04 00 restarts at the address that the module had."""

    def act(go: Any_, module: MacCan) -> None:
        stored, given = module.axis.stored["address"], module._given_address
        go()
        if given is not None:
            module.axis.parameters.store("address", stored)

    _leaving(patch, act)


@can_mutant("MACC-LMT-01", "MACC-LMT-03")
def the_old_address_is_heard_until_the_next_restart(patch: MonkeyPatch) -> None:
    """A second filter keeps the address before the procedure; replies come from the new one."""
    old: dict[MacCan, int] = {}

    def leave(go: Any_, module: MacCan) -> None:
        if module._given_address is not None:
            old[module] = module.address
        go()

    def renew(go: Any_, module: MacCan, request: bytes) -> Any:
        old.pop(module, None)
        return go()

    around(patch, "_leave_configuration", leave)
    around(patch, "_initialise", renew)
    hears(
        patch,
        lambda module, frame: module in old and frame.identifier == REQUEST + old[module],
        lambda module, frame: module._own_request(frame.data),
    )


@can_mutant("MACC-LMT-01")
def the_configuration_mode_ends_after_5_s(patch: MonkeyPatch) -> None:
    """Left alone for five seconds, the module is in nominal mode again."""
    entered: dict[MacCan, int] = {}

    def act(go: Any_, module: MacCan, command: int, value: int) -> None:
        if module._now - entered.get(module, module._now) > 5 * S:
            module._configures, module._given_address = False, None
        if (command, value) == (MODE, 1):
            entered[module] = module._now
        go()

    _lmt(patch, act)


@can_mutant("MACC-LMT-01", "MACC-LMT-03")
def a_second_procedure_is_only_acknowledged(patch: MonkeyPatch) -> None:
    """Once a procedure has been brought to its end, the next one changes nothing."""
    done: set[MacCan] = set()

    def act(go: Any_, module: MacCan) -> None:
        if module._given_address is None or module not in done:
            if module._given_address is not None:
                done.add(module)
            go()
        else:
            module._configures, module._given_address = False, None

    _leaving(patch, act)


@can_mutant("MACC-LMT-07", "MACC-CMD-10-01")
def the_configuration_mode_disarms(patch: MonkeyPatch) -> None:
    """04 01 drops what 2010h has begun."""

    def act(go: Any_, module: MacCan, command: int, value: int) -> None:
        if (command, value) == (MODE, 1):
            module.axis._armed, module.axis._preload = False, None
        go()

    _lmt(patch, act)


@can_mutant("MACC-BOOT-03", traps=(15,))
def the_boot_up_message_has_the_old_address(patch: MonkeyPatch) -> None:
    """After the address procedure the module announces itself once more by the old address."""

    def act(go: Any_, module: Any) -> None:
        module.announced = module.address if module._given_address is not None else None
        go()

    def sending(send: Any_, module: Any, identifier: int, data: bytes, now: int) -> Any:
        old = getattr(module, "announced", None)
        if BOOT_UP < identifier < 0x780 and old is not None:
            module.announced = None
            return send(BOOT_UP + old, data, now)
        return send(identifier, data, now)

    _leaving(patch, act)
    sends(patch, sending)


@can_mutant("MACC-BOOT-01", "MACC-BOOT-03", traps=(19,))
def a_new_address_is_not_announced(patch: MonkeyPatch) -> None:
    """After the address procedure there is no boot-up message."""

    def act(go: Any_, module: Any) -> None:
        module.is_silent = module._given_address is not None
        go()

    def sending(send: Any_, module: Any, identifier: int, data: bytes, now: int) -> Any:
        if BOOT_UP < identifier < 0x780 and getattr(module, "is_silent", False):
            module.is_silent = False
            return None
        return send(identifier, data, now)

    _leaving(patch, act)
    sends(patch, sending)


@can_mutant("MACC-LMT-02", traps=(16,))
def the_configuration_mode_is_acknowledged(patch: MonkeyPatch) -> None:
    """04 01 is answered on 7E4h."""

    def act(go: Any_, module: MacCan, command: int, value: int) -> None:
        go()
        if (command, value) == (MODE, 1):
            module._lmt_reply(MODE, 0)

    _lmt(patch, act)


@can_mutant("MACC-LMT-02")
def the_return_to_nominal_is_acknowledged(patch: MonkeyPatch) -> None:
    """04 00 is answered on 7E4h before the restart."""

    def act(go: Any_, module: MacCan, command: int, value: int) -> None:
        if (command, value) == (MODE, 0) and module._given_address is not None:
            module._lmt_reply(MODE, 0)
        go()

    _lmt(patch, act)


@can_mutant("MACC-LMT-02")
def the_reply_repeats_the_address(patch: MonkeyPatch) -> None:
    """11 adr is answered with 11 00 adr."""

    def act(go: Any_, module: MacCan, *data: int) -> None:
        given = module._given_address if data == (ADDRESS, 0) else None
        go(*data, *(() if given is None else (given,)))

    around(patch, "_lmt_reply", act)


@can_mutant("MACC-LMT-04")
def the_last_address_is_refused(patch: MonkeyPatch) -> None:
    """7Fh is no address."""
    around(patch, "_give_address", lambda go, module, address: go(0 if address == 127 else address))


@can_mutant("MACC-LMT-04")
def addresses_end_at_32(patch: MonkeyPatch) -> None:
    """Addresses above 20h are out of range."""
    around(patch, "_give_address", lambda go, module, address: go(0 if address > 32 else address))


@can_mutant("MACC-LMT-05", traps=(17,))
def the_address_is_taken_in_seven_bits(patch: MonkeyPatch) -> None:
    """81h to FFh are taken as 01h to 7Fh."""
    around(patch, "_give_address", lambda go, module, address: go(address & 0x7F))


@can_mutant("MACC-LMT-05", traps=(17,))
def address_0_is_acknowledged(patch: MonkeyPatch) -> None:
    """00h is acknowledged like an address, and the old one kept."""

    def act(go: Any_, module: MacCan, address: int) -> None:
        if address:
            go()
        else:
            module._lmt_reply(ADDRESS, 0)

    around(patch, "_give_address", act)


@can_mutant("MACC-LMT-05")
def a_bad_address_counts_as_99(patch: MonkeyPatch) -> None:
    """An impossible address is answered with 11 01 00, and 99 taken instead of it."""

    def act(go: Any_, module: MacCan, address: int) -> None:
        go()
        if address not in module.model.addresses:
            module._given_address = 99

    around(patch, "_give_address", act)


@can_mutant("MACC-LMT-01", traps=(18,))
def frames_of_seven_bytes_are_none(patch: MonkeyPatch) -> None:
    """The address procedure wants frames of eight bytes, although the manual prints seven."""
    around(patch, "_lmt", lambda go, module, data: go() if len(data) == 8 else None)


@can_mutant("MACC-LMT-06")
def an_address_out_of_mode_is_answered(patch: MonkeyPatch) -> None:
    """11 adr is answered in any mode; outside configuration it has no effect."""

    def act(go: Any_, module: MacCan, command: int, value: int) -> None:
        if command == ADDRESS and not module._configures:
            module._lmt_reply(ADDRESS, 0)
        go()

    _lmt(patch, act)


@can_mutant("MACC-LMT-06")
def an_address_needs_no_mode(patch: MonkeyPatch) -> None:
    """11 adr counts in any mode, without a reply outside configuration."""

    def act(go: Any_, module: MacCan, command: int, value: int) -> None:
        go()
        if command == ADDRESS and not module._configures and value in module.model.addresses:
            module._given_address = value

    _lmt(patch, act)


@can_mutant("MACC-LMT-07")
def without_an_address_it_stays_in_the_mode(patch: MonkeyPatch) -> None:
    """04 00 without an address given does not leave configuration mode."""

    def act(go: Any_, module: MacCan) -> None:
        if module._given_address is not None:
            go()

    _leaving(patch, act)


@can_mutant("MACC-LMT-08")
def downloads_wait_for_the_end_of_the_procedure(patch: MonkeyPatch) -> None:
    """In configuration mode downloads are ignored, uploads are served."""
    _unserved(patch, lambda data: data[:1] != bytes((UPLOAD,)))


@can_mutant("MACC-LMT-08")
def requests_in_the_mode_are_refused(patch: MonkeyPatch) -> None:
    """In configuration mode every request is refused with 80h."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        return module._refused(request, 0) if module._configures else serve()

    around(patch, "_serve", act)


def _unserved(patch: MonkeyPatch, is_ignored: Any_) -> None:
    def act(go: Any_, module: MacCan, data: bytes) -> None:
        if not (module._configures and is_ignored(data)):
            go()

    around(patch, "_own_request", act)


@can_mutant("MACC-LMT-09")
def bit_timing_is_acknowledged(patch: MonkeyPatch) -> None:
    """13h in configuration mode is answered and changes nothing."""
    _answered(patch, BIT_TIMING)


@can_mutant("MACC-LMT-09")
def storing_is_acknowledged(patch: MonkeyPatch) -> None:
    """17h in configuration mode is answered, the inquiries of the convention are not."""
    _answered(patch, STORE)


def _answered(patch: MonkeyPatch, which: int) -> None:
    def act(go: Any_, module: MacCan, command: int, value: int) -> None:
        if command == which and module._configures:
            module._lmt_reply(which, 0)
        go()

    _lmt(patch, act)


@can_mutant("MACC-LMT-09")
def the_other_services_end_the_mode(patch: MonkeyPatch) -> None:
    """A service that the module does not know makes it leave configuration mode."""

    def act(go: Any_, module: MacCan, command: int, value: int) -> None:
        if command not in (MODE, ADDRESS):
            module._configures, module._given_address = False, None
        go()

    _lmt(patch, act)


# --- restarts ------------------------------------------------------------------------------------


@can_mutant("MACC-CMD-00-02")
def a_reset_is_acknowledged_when_it_is_over(patch: MonkeyPatch) -> None:
    """The 60h of 2000h comes right behind the boot-up message."""

    def act(go: Any_, module: Any, identifier: int | None, reply: bytes | None) -> None:
        if module._wants_restart and identifier is not None and reply is not None:
            module.owed = identifier, reply
            go(None, None)
        else:
            go()

    def booted(go: Any_, module: Any, now: int) -> None:
        go()
        owed, module.owed = getattr(module, "owed", None), None
        if owed is not None:
            module._send(*owed, now)

    around(patch, "_answer", act)
    around(patch, "_booted", booted)


@can_mutant("MACC-CMD-00-02")
def a_reset_is_refused_and_done(patch: MonkeyPatch) -> None:
    """2000h gets 80h, and the module restarts."""

    def act(serve: Any_, module: MacCan, request: bytes) -> Any:
        reply = serve()
        is_reset = request[:3] == b"\x23\x00\x20" and reply is not None
        return b"\x80" + reply[1:] if is_reset else reply

    around(patch, "_serve", act)


@mutant("MACC-CMD-00-01", "MACC-Q-01-02", model=MODEL)
def a_reset_acknowledges_nothing(patch: MonkeyPatch) -> None:
    """A latched fault survives 2000h, though its cause has gone; only the supply clears it."""

    def act(go: Any_, module: Any, now: int) -> None:
        latched = module.axis.faults.latched
        go()
        module.kept_fault = latched if module._powered else 0

    def start(go: Any_, module: Any, now: int) -> None:
        module.axis.faults.latched |= getattr(module, "kept_fault", 0)
        go()

    around(patch, "_begin_boot", act)
    around(patch, "_booted", start)


@can_mutant("MACC-CMD-01-02")
def factory_values_are_announced_by_the_old_address(patch: MonkeyPatch) -> None:
    """After 2001h the boot-up message has the address that the module had before."""

    def act(serve: Any_, module: Any, request: bytes) -> Any:
        module.announced = module.address if request[:3] == b"\x23\x01\x20" else None
        return serve()

    def sending(send: Any_, module: Any, identifier: int, data: bytes, now: int) -> Any:
        old = getattr(module, "announced", None)
        if BOOT_UP < identifier < 0x780 and old is not None:
            module.announced = None
            return send(BOOT_UP + old, data, now)
        return send(identifier, data, now)

    around(patch, "_serve", act)
    sends(patch, sending)


@can_mutant("MACC-CMD-01-01")
def factory_values_leave_ramp_and_torque(patch: MonkeyPatch) -> None:
    """2001h leaves ramp and torque limit as they were."""

    def make(restore: Any_) -> Any_:
        def restoring(axis: Axis, now: int) -> None:
            kept = {name: axis.stored[name] for name in ("ramp", "torque")}
            restore(axis, now)
            for name, value in kept.items():
                axis.parameters.store(name, value)
                axis.parameters.values[name] = value

        return restoring

    wrap(patch, Axis, "restore_factory_values", make)


# --- power, reset input --------------------------------------------------------------------------


@can_mutant("MACC-PERS-01")
def the_address_is_kept_in_ram(patch: MonkeyPatch) -> None:
    """After power-off the module has the address from the factory."""

    def make(power_off: Any_) -> Any_:
        def powering_off(axis: Axis, now: int) -> None:
            power_off(axis, now)
            if axis.stored["address"] != 2:  # the neighbour's
                axis.parameters.store("address", 1)

        return powering_off

    wrap(patch, Axis, "power_off", make)


@can_mutant("MACC-BOOT-01")
def released_from_reset_it_says_nothing(patch: MonkeyPatch) -> None:
    """When the reset input opens, the module starts without a boot-up message."""

    def act(go: Any_, module: Any, now: int, held: bool) -> None:
        module.is_released = not held
        go()

    def sending(send: Any_, module: Any, identifier: int, data: bytes, now: int) -> Any:
        if BOOT_UP < identifier < 0x780 and getattr(module, "is_released", False):
            module.is_released = False
            return None
        return send(identifier, data, now)

    around(patch, "_set_reset_input", act)
    sends(patch, sending)


@can_mutant("MACC-STATE-02")
def held_in_reset_it_answers(patch: MonkeyPatch) -> None:
    """While the reset input is low uploads are answered."""

    def act(go: Any_, module: MacCan, frame: CanFrame, end_ns: int) -> Any:
        is_own = frame.identifier == 0x600 + module.address and frame.data[:1] == b"\x40"
        if not (module._reset_held and is_own and len(frame.data) == 8):
            return go()
        module._now = end_ns
        module._answer(0x580 + module.address, module._serve(frame.data))
        return module._taken_effects()

    around(patch, "receive", act)


@can_mutant("MACC-STATE-02")
def held_in_reset_it_gives_lifebeats(patch: MonkeyPatch) -> None:
    """The reset input silences replies only: lifebeats go on."""

    def act(go: Any_, module: MacCan, now: int, held: bool) -> None:
        go()
        if held and module._powered:
            module._lifebeat_at = now + S

    around(patch, "_set_reset_input", act)
