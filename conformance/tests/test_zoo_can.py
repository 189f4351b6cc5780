"""Every planted firmware fault of the MAC23 on CAN is found by the check that has to find it."""

from __future__ import annotations

import pytest
from zoo import ZOO as SERIAL_ZOO
from zoo import armed_by
from zoo.judge import checks_of, judge_armed, judge_names, kills, wrong
from zoo.mutant import MonkeyPatch, Mutant
from zoo_can import OWN, ZOO
from zoo_can.axis import NOT_CLAIMED, NOT_ON_THE_BUS, alters_the_line

from axistwin_conformance.base.armed import load_armed
from axistwin_conformance.base.ledger import load_ledger

pytestmark = pytest.mark.strength

MODEL = "mac23-can"
LEDGER = load_ledger("mac_can")
# Traps of the ledger's §8 that no twin can fall into: a float clock (37) is none of a firmware's
# and forbidden by the twins' types; 40 is the suite's own.
NOT_THE_TWINS = {37, 40}


@pytest.mark.parametrize("mutant", ZOO, ids=lambda mutant: mutant.name)
def test_every_mutant_is_killed_by_what_it_claims_to_break(mutant: Mutant) -> None:
    """Each claimed requirement fails, by the judgement of a check that names it."""
    killers = kills(mutant)
    assert set(mutant.claims) == set(killers), f"{mutant.description} Seen by: {dict(killers)}"


@pytest.mark.parametrize("address", [None, *sorted({one.address for one in OWN if one.address})])
def test_the_healthy_twin_passes_all_that_kills(address: int | None) -> None:
    """The same checks find nothing wrong with a twin that nobody has tampered with."""
    claims = {claim for mutant in ZOO if mutant.address == address for claim in mutant.claims}
    names = {check.name for claim in claims for check in checks_of(claim, MODEL)}
    assert wrong(names, MODEL, address) == []


def test_mutants_have_names_of_their_own_and_claim_what_the_ledger_asks() -> None:
    """A mutant is told by its name; a claim is a requirement that some check names."""
    judge_names(ZOO, LEDGER)
    assert all(mutant.claims for mutant in ZOO)


def test_faults_of_the_face_are_of_all_families_of_the_ledger() -> None:
    """CAN's own mutants alone claim every requirement that the axis' mutants cannot."""
    own = {claim for mutant in OWN for claim in mutant.claims}
    families = {claim.split("-")[1] for claim in own}
    assert families >= {"ID", "SDO", "BOOT", "EMCY", "SYNC", "LMT", "GEN", "CMD", "Q", "PERS"}
    assert "MACC-STATE-02" in own
    alone = {one.id for one in LEDGER.requirements.values() if not one.covers}
    assert alone <= own, sorted(alone - own)


def test_every_mutant_of_the_axis_is_judged_on_the_bus_too() -> None:
    """Of the serial zoo only those are left out that alter the line, or that no CAN module has."""
    here = {mutant.name for mutant in ZOO} - {mutant.name for mutant in OWN}
    names = {mutant.name: mutant for mutant in SERIAL_ZOO}
    assert set(NOT_ON_THE_BUS) | set(NOT_CLAIMED) <= set(names)
    for name in names.keys() - here:
        mutant = names[name]
        is_uncovered = not LEDGER.own(mutant.claims)
        of_another = mutant.model != "mac23"
        left_out = name in NOT_ON_THE_BUS or of_another or is_uncovered
        assert left_out or alters_the_line(mutant), name


def test_what_a_mutant_alters_tells_of_which_face_it_is() -> None:
    """A change of the serial module is seen in its class, table or name, and undone after that."""
    from axistwin.devices.mac.axis.axis import Axis
    from axistwin.devices.mac.serial import device as serial
    from axistwin.devices.mac.serial import framing

    def of_a_class(patch: MonkeyPatch) -> None:
        patch.setattr(serial.MacSerial, "receive", None)

    def of_a_table(patch: MonkeyPatch) -> None:
        patch.setitem(serial._FACE_COMMANDS, 0x00, None)

    def of_a_name(patch: MonkeyPatch) -> None:
        patch.setattr(framing, "STX", 3)

    def of_the_axis(patch: MonkeyPatch) -> None:
        patch.setattr(Axis, "run", None)

    before = serial.MacSerial.receive, serial._FACE_COMMANDS[0x00], framing.STX, Axis.run
    for alter in (of_a_class, of_a_table, of_a_name):
        assert alters_the_line(Mutant(alter.__name__, (), "", alter)), alter.__name__
    assert not alters_the_line(Mutant("of_the_axis", (), "", of_the_axis))
    after = serial.MacSerial.receive, serial._FACE_COMMANDS[0x00], framing.STX, Axis.run
    assert before == after


def test_every_trap_of_the_twins_has_its_mutant() -> None:
    """Who falls into a trap of the ledger is found out."""
    assert {trap for mutant in ZOO for trap in mutant.traps} == set(range(1, 41)) - NOT_THE_TWINS


def test_what_is_shipped_as_armed_is_what_the_zoo_kills() -> None:
    """armed.toml names the claims of these mutants and no others; scripts/zoo writes it anew."""
    assert load_armed("mac_can") == armed_by(ZOO), "stale: run scripts/zoo mac_can"


def test_nine_in_ten_requirements_of_the_manual_are_armed() -> None:
    """Of what is stated or follows, and can be seen on the wire, little stays unproven."""
    judge_armed(armed_by(ZOO), LEDGER)
