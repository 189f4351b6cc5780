"""Faults in what is kept over power-off and a restart."""

from __future__ import annotations

from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.parameters import Parameters
from zoo.mutant import Any_, MonkeyPatch, State, mutant, on, wrap


def _volatile(patch: MonkeyPatch, *names: str) -> None:
    """Let these parameters be in use only, never stored."""

    def make(store: Any_) -> Any_:
        def storing(parameters: Parameters, name: str, value: int) -> None:
            if name not in names:
                store(parameters, name, value)

        return storing

    wrap(patch, Parameters, "store", make)


@mutant("MACS-PERS-01")
def the_ramp_is_not_stored(patch: MonkeyPatch) -> None:
    """0Fh is forgotten over power-off."""
    _volatile(patch, "ramp")


@mutant("MACS-PERS-01")
def the_period_is_not_stored(patch: MonkeyPatch) -> None:
    """0Dh is forgotten over power-off."""
    _volatile(patch, "period")


@mutant("MACS-PERS-01")
def the_torque_limit_is_not_stored(patch: MonkeyPatch) -> None:
    """0Ch is forgotten over power-off."""
    _volatile(patch, "torque")


@mutant("MACS-PERS-01")
def the_stops_are_not_stored(patch: MonkeyPatch) -> None:
    """09h and 0Ah are forgotten over power-off."""
    _volatile(patch, "superior_stop", "inferior_stop")


@mutant("MACS-PERS-01")
def what_is_set_amid_segments_is_not_stored(patch: MonkeyPatch) -> None:
    """0Ch, 0Eh and 1Ch are forgotten over a restart if segments ran when they came."""

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        stored = dict(axis.parameters.stored)
        was_running = axis.drive.kind is State.IN
        is_taken = bool(go())
        if was_running:
            for name in ("torque", "catchup", "tolerance"):
                axis.parameters.store(name, stored[name])
        return is_taken

    on(patch, (0x0C, 0x0E, 0x1C), act)


@mutant("MACS-PERS-02", traps=(38,))
def one_mode_is_volatile(patch: MonkeyPatch) -> None:
    """02h is forgotten over power-off, 03h and 1Ch are not."""
    _volatile(patch, "standby")


@mutant("MACS-Q-20-02", "MACS-PERS-01", traps=(34,))
def the_position_is_lost_at_power_off(patch: MonkeyPatch) -> None:
    """The counter starts from 0."""

    def make(power_on: Any_) -> Any_:
        def powering_on(axis: Axis, now: int) -> None:
            power_on(axis, now)
            axis.drive.counter.set(now, 0)

        return powering_on

    wrap(patch, Axis, "power_on", make)


@mutant("MACS-PERS-03", "MACS-CMD-07-02", traps=(22,))
def the_reference_enable_survives(patch: MonkeyPatch) -> None:
    """07h is stored like the others."""

    def make(shut_down: Any_) -> Any_:
        def shutting_down(axis: Axis, now: int) -> None:
            enabled = axis._reference_enabled
            shut_down(axis, now)
            axis._reference_enabled = enabled

        return shutting_down

    wrap(patch, Axis, "shut_down", make)


@mutant("MACS-PERS-03", "MACS-CMD-00-01")
def arm_and_preload_survive_a_restart(patch: MonkeyPatch) -> None:
    """A preloaded motion is still there after 00h and after power-on."""

    def make(shut_down: Any_) -> Any_:
        def shutting_down(axis: Axis, now: int) -> None:
            armed, preload = axis._armed, axis._preload
            shut_down(axis, now)
            axis._armed, axis._preload = armed, preload

        return shutting_down

    wrap(patch, Axis, "shut_down", make)


def _loaded(patch: MonkeyPatch, change: Any_) -> None:
    """Let `change(parameters)` be done to what a start-up has read."""

    def make(read: Any_) -> Any_:
        def reading(parameters: Parameters) -> None:
            read(parameters)
            change(parameters)

        return reading

    wrap(patch, Parameters, "read_stored", make)


@mutant("MACS-PERS-01", "MACS-CMD-00-01")
def the_greater_stop_is_the_superior_at_start_up(patch: MonkeyPatch) -> None:
    """Software stops that are stored the wrong way round are exchanged when they are read."""

    def change(parameters: Parameters) -> None:
        low, high = sorted(parameters.values[name] for name in ("inferior_stop", "superior_stop"))
        parameters.values.update(inferior_stop=low, superior_stop=high)

    _loaded(patch, change)


@mutant("MACS-CMD-00-01")
def a_position_below_0_comes_back_in_24_bits(patch: MonkeyPatch) -> None:
    """What 00h keeps of the position has no sign: -1 comes back as 00FFFFFFh."""

    def make(shut_down: Any_) -> Any_:
        def shutting_down(axis: Axis, now: int) -> None:
            shut_down(axis, now)
            place = axis.drive.counter.at(now)
            if place < 0:
                axis.drive.counter.set(now, place & 0xFFFFFF)

        return shutting_down

    wrap(patch, Axis, "shut_down", make)


@mutant("MACS-PERS-01", "MACS-CMD-00-01")
def all_ones_are_an_erased_cell(patch: MonkeyPatch) -> None:
    """A period, ramp or catch-up speed of all ones comes up as from the factory."""

    def change(parameters: Parameters) -> None:
        for name, ones in (("period", 0xFFFF), ("ramp", 0xFF), ("catchup", 0xFF)):
            if parameters.values[name] == ones:
                parameters.values[name] = parameters._factory[name]

    _loaded(patch, change)


@mutant("MACS-PERS-01", "MACS-CMD-00-01")
def what_differs_above_its_low_byte_is_not_written(patch: MonkeyPatch) -> None:
    """To spare the EEPROM a value is compared with the stored one, by its low byte."""

    def make(store: Any_) -> Any_:
        def storing(parameters: Parameters, name: str, value: int) -> None:
            if (parameters.stored[name] ^ value) & 0xFF:
                store(parameters, name, value)

        return storing

    wrap(patch, Parameters, "store", make)


@mutant("MACS-PERS-01")
def the_torque_limit_set_in_a_move_is_not_stored(patch: MonkeyPatch) -> None:
    """0Ch during 13h counts until the next restart."""

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        stored, was_moving = axis.parameters.stored["torque"], axis.drive.kind is State.PO
        is_taken = bool(go())
        if was_moving:
            axis.parameters.store("torque", stored)
        return is_taken

    on(patch, 0x0C, act)


@mutant("MACS-PERS-01")
def a_second_passes_before_a_parameter_is_written(patch: MonkeyPatch) -> None:
    """What was set less than a second before the supply goes is lost."""
    told: list[tuple[int, dict[str, int]]] = []

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        told[:] = [one for one in told if now - one[0] < 1_000_000_000]
        told.append((now, dict(axis.parameters.stored)))
        return bool(go())

    def make(power_off: Any_) -> Any_:
        def powering_off(axis: Axis, now: int) -> None:
            late = [one for one in told if now - one[0] < 1_000_000_000]
            for name, value in late[0][1].items() if late else ():
                if name != "position":
                    axis.parameters.store(name, value)
            power_off(axis, now)

        return powering_off

    on(patch, (0x09, 0x0A, 0x0C, 0x0D, 0x0E, 0x0F), act)
    wrap(patch, Axis, "power_off", make)


@mutant("MACS-Q-20-02", "MACS-PERS-01")
def the_position_loses_its_sign_at_power_off(patch: MonkeyPatch) -> None:
    """The counter is saved without its sign."""

    def make(power_on: Any_) -> Any_:
        def powering_on(axis: Axis, now: int) -> None:
            power_on(axis, now)
            axis.drive.counter.set(now, abs(axis.drive.counter.at(now)))

        return powering_on

    wrap(patch, Axis, "power_on", make)


@mutant("MACS-CMD-00-01")
def a_restart_brings_back_what_0bh_has_cleared(patch: MonkeyPatch) -> None:
    """0Bh moves the origin, which is forgotten over 00h."""
    origins: dict[int, int] = {}

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        before = axis.drive.counter.at(now)
        is_taken = bool(go())
        origins[id(axis)] = origins.get(id(axis), 0) + before
        return is_taken

    def make(shut_down: Any_) -> Any_:
        def shutting_down(axis: Axis, now: int) -> None:
            shut_down(axis, now)
            origin = origins.pop(id(axis), 0)
            axis.drive.counter.set(now, axis.drive.counter.at(now) + origin)

        return shutting_down

    on(patch, 0x0B, act)
    wrap(patch, Axis, "shut_down", make)


@mutant("MACS-CMD-00-01", "MACS-PERS-01")
def a_refused_torque_limit_is_stored(patch: MonkeyPatch) -> None:
    """0Ch above Imax is refused, and after the next restart it is as if it had been Imax."""

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        is_taken = bool(go())
        if not is_taken:
            axis.parameters.store("torque", 0x80)
        return is_taken

    on(patch, 0x0C, act)
