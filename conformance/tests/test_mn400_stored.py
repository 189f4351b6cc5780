"""What is stored, id, rate and neighbours of the MN400, judged on twins in virtual time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from mn400_board import SmallBoard

from axistwin.devices.mn400.store import ProgramStore
from axistwin_conformance.base import events
from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.session import Run, Session
from axistwin_conformance.core.settings import NO_MOTION
from axistwin_conformance.engine.plan import Options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mn400 import codec, snapshot
from axistwin_conformance.families.mn400.driver import BoardDriver
from axistwin_conformance.families.mn400.family import Mn400
from axistwin_conformance.families.mn400.persistence.address_recovery import (
    brought_back,
    change_rate,
)
from axistwin_conformance.families.mn400.persistence.programs import (
    NOT_READABLE,
    enter_program,
    fill_store,
    listing,
    program_entry,
    put_program_back,
)
from axistwin_conformance.transport.rig import RigChoice
from axistwin_conformance.transport.serial import SerialTransport

FAMILY = Mn400()
MODULES = ("stored", "power", "destructive", "together")
CHECKS = [one for one in FAMILY.checks() if one.module.rpartition(".")[2] in MODULES]
NAMES = tuple(one.name for one in CHECKS)


def run(
    words: tuple[str, ...],
    neighbours: tuple[int, ...] = (),
    quirks: Mapping[str, str] | None = None,
) -> tuple[Result, list[events.Event]]:
    """Judge a twin with everything allowed."""
    ids = ",".join(f"mn400:{board}" for board in (1, *neighbours))
    url = f"axistwin://{ids}?time=virtual"
    url += "".join(f"&quirk.{name}={value}" for name, value in (quirks or {}).items())
    given: dict[str, Any] = {
        "family": FAMILY,
        "model": "mn400",
        "endpoint": url,
        "address": 1,
        "neighbours": neighbours,
        "rate": 9600,
        "allowed": frozenset(SAFETY_CLASSES),
        "level": "full",
        "seed": 5,
        "words": words,
        "rig": RigChoice("twin", capabilities=frozenset(FAMILY.rig_controls)),
    }
    seen: list[events.Event] = []
    return Engine(Options(**given)).run(seen.append), seen


def wrong(result: Result) -> list[tuple[str, str, str]]:
    """What fails or cannot be told, with what came."""
    return [
        (ran.check.name, one.requirement, f"{one.expected} {one.actual} {one.text}")
        for ran in result.checks
        for one in ran.findings
        if one.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)
    ]


@pytest.mark.strength(seconds=20)
@pytest.mark.parametrize("neighbours", [(), (2, 5)], ids=["alone", "together"])
def test_a_sound_twin_conforms(neighbours: tuple[int, ...]) -> None:
    """Every check that can run passes, and nothing is left changed."""
    result, seen = run(NAMES, neighbours)
    assert wrong(result) == []
    assert not result.problems
    notes = [event.text for event in seen if isinstance(event, events.Note)]
    assert notes.count(NOT_READABLE) == (not neighbours or 1)


UNREAD = "readprogram_end"  # no check depends on it, so that a run of these does not ask
READINGS = [
    {"eof_byte": "14", "eof_framing": "raw", "prog_check": "run", "program_replies": "true",
     "readprogram_framing": "single", "nvm_commit": "per_line", "power_on_position": "77"},
    {"retransmit_in_entry": "store", "readprogram_end": "done", "address_settable": "false",
     "feedhold_power_on": "1", "power_on_mode": "absolute", "baud_reply": "plus_done"},
    {"broadcast_setaddr": "refused", "poll_slot_ms": "50", "readprogram_end": "empty_line",
     "eof_byte": "both", "eof_framing": "both", "nvm_size": "4096", "nvm_line_overhead": "2"},
    {"nvm_line_overhead": "16"},  # a program of short lines takes more than one long line
]  # fmt: skip


@pytest.mark.strength(seconds=20)
@pytest.mark.parametrize("readings", READINGS, ids=["one", "two", "three", "four"])
def test_a_twin_of_other_readings_conforms_and_is_found_out(readings: dict[str, str]) -> None:
    """The probes tell the readings, and the checks hold the board to them."""
    result, _ = run(NAMES, quirks=readings)
    assert wrong(result) == []
    told = {switch: one for switch, one in readings.items() if switch != UNREAD}
    assert {switch: result.readings.get(switch) for switch in told} == told


@pytest.mark.strength(seconds=20)
@pytest.mark.parametrize("reading", ["immediate", "poll_only"])
def test_what_is_said_to_all_boards_may_be_answered_otherwise(reading: str) -> None:
    """At once, or not at all but for polls."""
    result, _ = run(NAMES, (2, 5), {"broadcast_reply": reading})
    assert wrong(result) == []
    assert result.readings["broadcast_reply"] == reading


# --- what is put back -----------------------------------------------------------------------------


def session_with(target: SerialTransport) -> Session:
    """A session with whatever is behind a transport."""
    fields: dict[str, Any] = {
        "target": target,
        "family": FAMILY,
        "model": FAMILY.models["mn400"],
        "ledger": load_ledger("mn400"),
        "address": 1,
        "neighbours": (),
        "allowed": frozenset(SAFETY_CLASSES),
        "envelope": NO_MOTION,
        "seed": 0,
    }
    return Session(Run(**fields))


def session_on() -> Session:
    """A session with a twin."""
    return session_with(FAMILY.open("axistwin://mn400?time=virtual", None))


def test_a_program_is_put_back_from_within_an_entry() -> None:
    """It is what it was after a run that ended in the middle of another one."""
    session = session_on()
    driver = BoardDriver(session)
    enter_program(driver, ("V500", "X2"))
    memory = FAMILY.remember(session)
    snapshot.note_sent(session, driver.client.request("Z"))
    driver.command("Z")
    driver.command("Q")
    memory.touched.add("Z")
    FAMILY.stop(session)
    assert FAMILY.restore(session, memory) == ()
    assert listing(driver.client) == ("V500", "X2")


def test_what_a_file_has_kept_is_put_back() -> None:
    """The program of a snapshot goes through a file and back to the board."""
    session = session_on()
    driver = BoardDriver(session)
    enter_program(driver, ("V500", "X2"))
    kept = FAMILY.kept(FAMILY.remember(session))
    enter_program(driver, ())
    assert FAMILY.restore(session, FAMILY.memory_of(kept)) == ()
    assert listing(driver.client) == ("V500", "X2")


def test_a_program_is_put_back_beside_a_full_store(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the old program counts until the new one is complete (MN4-AMB-70)."""
    add = ProgramStore.add

    def added(store: ProgramStore, part: Any, line: bytes) -> Any:
        is_room = store.used + sum(map(len, store._entry)) + len(line) < 8000
        return add(store, part, line) if is_room else None

    monkeypatch.setattr(ProgramStore, "add", added)
    driver = BoardDriver(session_on())
    enter_program(driver, ())
    with program_entry(driver):
        assert not fill_store(driver).is_over
    assert put_program_back(driver, ("V500", "X2"))
    assert listing(driver.client) == ("V500", "X2")


def test_an_interrupt_leaves_id_and_rate_to_the_guard() -> None:
    """What was changed is owed, and brought back from any id and any rate."""
    session = session_on()
    driver = BoardDriver(session)

    def interrupted() -> None:
        with brought_back(driver, 9):
            driver.ask("=77")
            change_rate(BoardDriver(session, 77), 3)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    (cleanup,) = session.run.cleanups
    assert cleanup.what == "id 1, 9600 baud"
    assert cleanup.restore()
    assert session.target.baud == 9600
    assert driver.is_present()


def test_a_board_in_an_entry_is_brought_back() -> None:
    """Whatever it is storing is ended first."""
    for text in ("Z", "."):
        session = session_on()
        driver = BoardDriver(session)
        with brought_back(driver):
            driver.command(text)
            driver.command("E")
        assert driver.is_present()


def test_no_program_is_replaced_that_cannot_be_read() -> None:
    """Nothing that enters one is sent to a board whose R tells nothing."""
    board = SmallBoard()
    board.spoil = lambda packet: b"" if packet[1:2] == b"R" else packet
    session = session_with(SerialTransport(board, "a small MN400"))
    session.run.memory = FAMILY.remember(session)
    assert session.run.memory.program is None
    assert "could not be read" in FAMILY.would_lose(session, codec.request(1, "Z"))
    assert FAMILY.would_lose(session, codec.request(1, "E")) == ""
