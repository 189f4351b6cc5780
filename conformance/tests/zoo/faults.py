"""Faults of faults: warnings, disjunctions, the over-voltage memory, the models' scales."""

from __future__ import annotations

from axistwin.devices.mac.axis import models
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.faults import Faults
from axistwin.devices.mac.axis.models import MacModel
from zoo.mutant import Any_, MonkeyPatch, State, answers, cells, mutant, on, wrap

PARAMETERS = (0x02, 0x03, 0x09, 0x0A, 0x0C, 0x0D, 0x0E, 0x0F, 0x1C)


@mutant("MACS-Q-21-02", traps=(31,))
def a_fault_goes_with_its_cause(patch: MonkeyPatch) -> None:
    """The thermal fault clears itself when the module cools down."""

    def make(measure: Any_) -> Any_:
        def measuring(faults: Faults) -> None:
            faults.latched &= ~0x14
            measure(faults)

        return measuring

    wrap(patch, Faults, "_measure", make)


@mutant("MACS-STATE-02", traps=(31,))
def power_on_acknowledges_a_fault(patch: MonkeyPatch) -> None:
    """19h and 1Ah clear a latched fault."""
    cells(patch, (0x19, 0x1A), (State.DJ,), "A")

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        axis.faults.acknowledge()
        return bool(go())

    on(patch, (0x19, 0x1A), act)


@mutant("MACS-STATE-02", model="mac34-1")
def too_much_supply_leaves_the_motion_running(patch: MonkeyPatch) -> None:
    """Far too high a supply latches dd bit 3, but what moves goes on."""

    def setting(axis: Axis, _: int, millivolts: int) -> None:
        axis.faults.set_supply(millivolts)

    patch.setattr(Axis, "set_supply", setting)


@mutant("MACS-Q-21-02")
def warnings_latch(patch: MonkeyPatch) -> None:
    """A warning of the supply stays until 00h."""

    def make(measure: Any_) -> Any_:
        def measuring(faults: Faults) -> None:
            measure(faults)
            faults.latched |= faults.model.warnings(faults.raw_supply)

        return measuring

    wrap(patch, Faults, "_measure", make)


@mutant("MACS-Q-21-02")
def a_micro_cut_goes_unseen(patch: MonkeyPatch) -> None:
    """dd bit 0 is never set."""
    patch.setattr(Faults, "micro_cut", lambda faults: None)


@mutant("MACS-Q-21-03", traps=(31,))
def the_over_voltage_is_forgotten(patch: MonkeyPatch) -> None:
    """hh bit 7 clears when the voltage is back."""

    def make(measure: Any_) -> Any_:
        def measuring(faults: Faults) -> None:
            faults.over_voltage_seen = False
            measure(faults)

        return measuring

    wrap(patch, Faults, "_measure", make)


@mutant("MACS-STATE-02")
def a_fault_does_not_lock_motion(patch: MonkeyPatch) -> None:
    """13h and 15h are accepted, to no effect, although a fault is latched."""
    on(patch, (0x13, 0x15), lambda go, axis, now, n: axis.faults.disjuncted or go())


@mutant("MACS-STATE-02", traps=(32,))
def a_fault_locks_the_parameters_too(patch: MonkeyPatch) -> None:
    """Nothing is accepted while a fault is latched."""
    cells(patch, PARAMETERS, (State.DJ,), "R")


@mutant("MACS-STATE-02")
def a_fault_lets_the_motion_end(patch: MonkeyPatch) -> None:
    """A fault in motion locks the next one only."""

    def make(obey: Any_) -> Any_:
        def obeying(axis: Axis, now: int) -> None:
            if axis.drive.kind is None:
                obey(axis, now)

        return obeying

    wrap(patch, Axis, "_obey_faults", make)


@mutant("MACS-STATE-03")
def a_restart_believes_in_the_best(patch: MonkeyPatch) -> None:
    """00h clears a fault although its cause is still there."""

    def acknowledge(faults: Faults) -> None:
        faults.latched = 0
        faults.over_voltage_seen = False

    patch.setattr(Faults, "acknowledge", acknowledge)


@mutant("MACS-STATE-04", traps=(31,))
def a_warning_refuses_motion(patch: MonkeyPatch) -> None:
    """13h is refused while the supply is too low or too high."""
    on(
        patch,
        (0x13, 0x15, 0x16),
        lambda go, axis, now, n: not axis.faults.model.warnings(axis.faults.raw_supply) and go(),
    )


@mutant("MACS-Q-21-02")
def it_trips_at_80_degrees(patch: MonkeyPatch) -> None:
    """The thermal fault comes five degrees early."""
    wrap(
        patch,
        MacModel,
        "trips",
        lambda trips: lambda model, supply, temperature: trips(model, supply, temperature + 2),
    )


@mutant("MACS-Q-27-01", traps=(41,), model="mac34-1")
def a_mac34_measures_its_supply_like_a_mac23(patch: MonkeyPatch) -> None:
    """vv of a MAC34-1 counts in 1/4.8 V."""
    wrap(
        patch,
        MacModel,
        "raw_supply",
        lambda raw: lambda model, millivolts: models._nearest(millivolts * 1000, 208_333),
    )


@mutant("MACS-Q-27-01", traps=(41,))
def temperatures_rise_at_half_the_rate(patch: MonkeyPatch) -> None:
    """tt moves by half of what it should, from 25 °C on."""
    wrap(
        patch,
        MacModel,
        "raw_temperature",
        lambda raw: lambda model, m: raw(model, 25_000 + (m - 25_000) // 2),
    )


@mutant("MACS-STATE-02")
def a_locked_module_accepts_19h(patch: MonkeyPatch) -> None:
    """19h is accepted, to no effect, although a fault is latched."""
    on(patch, 0x19, lambda go, axis, now, n: axis.faults.disjuncted or go())


@mutant("MACS-Q-21-03")
def the_over_voltage_memory_is_inverted(patch: MonkeyPatch) -> None:
    """hh bit 7 is 1 until there is an over-voltage."""
    answers(patch, 0x21, lambda value, axis, now: value ^ 0x80)
