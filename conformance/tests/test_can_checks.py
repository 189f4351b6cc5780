"""The checks of CAN's own, each on the built-in twin; and whom a wrong reply accuses."""

from __future__ import annotations

import importlib

import pytest
from lying_bus import (
    LEDGER,
    OWN_MODULES,
    RESET,
    as_it_is,
    changed,
    judge,
    make_run,
    open_liar,
    own_checks,
)

from axistwin_conformance.base.check import Check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.diagnosis import diagnose
from axistwin_conformance.families.mac.can.family import FAMILY
from axistwin_conformance.transport.can_frame import Frame

pytestmark = pytest.mark.strength

# --- the ledger and the checks -------------------------------------------------------------------


def test_every_requirement_has_a_check_or_a_reason_why_not() -> None:
    """Nothing of the ledger is forgotten."""
    named = {key for one in FAMILY.checks() for key in one.requirements}
    missing = [
        one.id
        for one in LEDGER.requirements.values()
        if one.id not in named and not one.not_on_wire
    ]
    assert missing == []


def test_every_check_names_requirements_of_this_ledger() -> None:
    """And what is written for CAN alone names them by their own names."""
    for one in FAMILY.checks():
        assert set(one.requirements) <= set(LEDGER.requirements)
    for name in OWN_MODULES:
        written = vars(importlib.import_module(name)).values()
        mine = [one for one in written if isinstance(one, Check) and one.module == name]
        assert mine, f"{name} holds no check"
        assert all(key.startswith("MACC-") for one in mine for key in one.requirements)


@pytest.mark.parametrize("name", sorted(own_checks()))
def test_the_twin_passes_each_of_them(name: str) -> None:
    """In virtual time with a neighbour, every requirement that it names is judged and holds."""
    found = [(one.requirement, one.verdict.value, one.text) for one in judge(name)]
    assert {verdict for _, verdict, _ in found} <= {"pass", "info"}, found
    assert {key for key, _, _ in found} == set(own_checks()[name].requirements)


def test_what_makes_a_module_unreachable_comes_last_and_alone() -> None:
    """Checks of the address are destructive and need the bus for themselves."""
    for one in FAMILY.checks():
        if ".checks.lmt" in one.module:
            assert "destructive" in one.safety
            assert "alone" in one.needs
    assert ".checks.lmt" in FAMILY.modules[-1]


# --- whom a reply accuses ------------------------------------------------------------------------


def blamed(frame: Frame, *reply: Frame, has_crashed: bool = False) -> str:
    """The requirement that is broken by what came of a frame, or nothing."""
    target = open_liar((2,), as_it_is, as_it_is, lambda one: ())
    try:
        session = Session(make_run(target, (2,)))
        heard = b"".join(one.pack() for one in reply)
        breach = diagnose(session, frame.pack(), None if has_crashed else heard)
        return breach.requirement if breach else ""
    finally:
        target.close()


UPLOAD = codec.request(1, 0x22).frame()
MOVE = codec.request(1, 0x13, 5).frame()
ANSWER = Frame(0x581, bytes.fromhex("4202200000000000"))


@pytest.mark.parametrize(
    ("frame", "reply", "requirement"),
    [
        (UPLOAD, (ANSWER,), ""),
        (UPLOAD, (codec.boot_up(1), ANSWER, Frame(0x082, bytes(8))), ""),
        (UPLOAD, (changed(ANSWER, 0, 0x43),), ""),  # a reading
        (UPLOAD, (), "MACC-SDO-03"),
        (UPLOAD, (codec.boot_up(1),), "MACC-SDO-03"),
        (UPLOAD, (changed(ANSWER, 0, 0x4F),), "MACC-SDO-03"),
        (UPLOAD, (changed(ANSWER, 1, 0x03),), "MACC-SDO-03"),
        (UPLOAD, (changed(ANSWER, 0, 0x80),), "MACC-SDO-03"),
        (UPLOAD, (ANSWER, ANSWER), "MACC-SDO-06"),
        (UPLOAD, (Frame(0x582, ANSWER.data),), "MACC-ID-01"),
        (codec.request(1, 0x22, 0, 5).frame(), (Frame(0x581, b"\x80\x02\x20\x05\0\0\0\0"),), ""),
        (MOVE, (Frame(0x581, b"\x80\x13\x20\0\0\0\0\0"),), ""),
        (MOVE, (Frame(0x581, b"\x80\x13\x20\0\x22\0\0\x08"),), ""),  # a reading
        (MOVE, (ANSWER,), "MACC-SDO-01"),
        (MOVE, (), "MACC-SDO-01"),
        (RESET, (), ""),  # may be obeyed in silence
        (codec.request(1, 0x12).frame(), (), ""),  # nobody knows what it does
        (codec.request(5, 0x20).frame(), (), ""),  # nobody has that address
        (codec.request(0, 0x20).frame(), (), ""),
        (Frame(0x601, b"\x40"), (ANSWER,), ""),
        (codec.sync(), (ANSWER,), ""),
    ],
)
def test_a_reply_accuses_only_by_what_every_reading_leaves_out(
    frame: Frame, reply: tuple[Frame, ...], requirement: str
) -> None:
    """Whatever is open, of nobody here, or no request at all, may be answered by anything."""
    assert blamed(frame, *reply) == requirement


@pytest.mark.parametrize(
    ("frame", "requirement"),
    [
        (UPLOAD, "MACC-SDO-03"),
        (codec.request(0, 0x13).frame(), "MACC-SDO-01"),
        (codec.sync(), "MACC-SYNC-01"),
        (codec.lmt_enter(), "MACC-LMT-01"),
        (codec.nmt(1), "MACC-BOOT-04"),
        (Frame(0x601, is_remote=True), "MACC-ID-03"),
        (Frame(0x601, b"\x40"), "MACC-SDO-12"),
    ],
)
def test_whoever_falls_over_a_frame_is_blamed_for_it(frame: Frame, requirement: str) -> None:
    """Nobody need answer everything, but nobody may fall over anything."""
    assert blamed(frame, has_crashed=True) == requirement


def test_a_module_that_may_be_deaf_is_not_accused_of_its_silence() -> None:
    """After a reset, network management or LMT some reading admits it."""
    for frame in (RESET, codec.nmt(2, 1), codec.lmt_leave()):
        target = open_liar((), as_it_is, as_it_is, lambda one: ())
        try:
            session = Session(make_run(target))
            target.send(frame)
            assert diagnose(session, UPLOAD.pack(), b"") is None
        finally:
            target.close()
