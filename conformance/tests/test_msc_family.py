"""What the engine is told of an MSC: who is there, whether it answers, what is put back, and what
no unit says."""

from __future__ import annotations

import re
from typing import Any

import pytest
from click.testing import CliRunner
from msc_twin import TwinPort, check_of, session_on, target_of

from axistwin_conformance.base.errors import TargetError, WrongDevice
from axistwin_conformance.base.transcript import Direction, Record, last_exchange
from axistwin_conformance.cli import conform
from axistwin_conformance.core.family import Violation
from axistwin_conformance.core.session import Run, Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, NAK
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.family import FAMILY
from axistwin_conformance.families.msc.options import ScratchArea
from axistwin_conformance.families.msc.snapshot import layout

GROUNDS = ScratchArea(range(1024, 1400), range(128, 132))


def session_of(port: TwinPort, **how: Any) -> Session:
    """A session between checks."""
    return session_on(port, **{"settings": GROUNDS, **how})


def remembered(session: Session) -> tuple[Run, Session]:
    """Its run, which has read what is to be put back, and a session of it that may write."""
    session.run.memory = FAMILY.remember(session)
    return session.run, Session(session.run, check_of("stored"))


# --- who is there ---------------------------------------------------------------------------------


def test_a_unit_is_known_by_its_status_and_its_model() -> None:
    """In words for people, and as a number."""
    port = TwinPort()
    port.status = 65 | 2
    identity = FAMILY.identify(session_of(port))
    assert identity.summary == (
        "MSC-250, unit 1, status 67: program running, battery low, auto start"
    )
    assert identity.values == {"status": "67"}


@pytest.mark.parametrize("has_rflags", [True, False])
def test_another_model_than_the_one_named_is_the_wrong_device(has_rflags: bool) -> None:
    """RFLAGS tells them apart, either way; the operator is told what to try."""
    port = TwinPort(has_rflags=has_rflags)
    other = FAMILY.models["msc-generic" if has_rflags else "msc-250"]
    session = session_of(port, model=other, allowed=frozenset({"passive", "rig"}))
    words = "has RFLAGS; try msc-250" if has_rflags else "refuses RFLAGS; try msc-850"
    with pytest.raises(WrongDevice, match=words):
        FAMILY.identify(session)


def test_to_a_machine_an_unknown_name_is_not_tried() -> None:
    """Named as a model without RFLAGS, it is not asked for them without a bench."""
    port = TwinPort()
    FAMILY.identify(session_of(port, model=FAMILY.models["msc-generic"]))
    assert b"RFLAGS" not in port.received


def test_nobody_there_is_told_with_the_remedy() -> None:
    """Another unit number is not answered."""
    port = TwinPort(unit=3)
    session = session_of(port, address=4)
    with pytest.raises(TargetError, match="as unit 4 at 9600 baud: nothing comes; try another"):
        FAMILY.identify(session)
    assert session.target.now_ns < 8e9  # soon enough for who has taken the wrong port


@pytest.mark.parametrize("count", [1, 2, 5, 6, 9, 134, 136])
def test_a_unit_that_waits_for_the_rest_of_a_packet_is_there(count: int) -> None:
    """However long it waits, whatever somebody else has begun, and it carries nothing out."""
    port = TwinPort(packet_timeout_ms=60_000)
    session = session_of(port)
    session.target.send(codec.packet(1, codec.bwrite(1024, range(1, 33)))[:count])
    session.target.wait(0.5)
    assert FAMILY.identify(session).values == {"status": "65"}
    assert port.data == {}
    assert session.target.now_ns < 12e9


@pytest.mark.parametrize("late_s", [0.6, 1.5, 2.5, 4.0])
def test_a_unit_that_answers_late_is_not_taken_for_nobody(late_s: float) -> None:
    """What comes, comes from somebody: it is told, or taken for the reply that it is."""
    port = TwinPort()
    port.receiver._delay_ns = round(late_s * 1e9)
    session = session_of(port)
    try:
        told = FAMILY.identify(session).values["status"]
    except TargetError as error:
        told = str(error)
    assert told in ("65", "unknown") or re.search(
        r"ACK.* comes, but later than 0.5 s, or now and then", told
    )


def test_nobody_there_at_another_rate_is_told_the_right_one() -> None:
    """There is but one, and no address helps at any other."""
    session = session_of(TwinPort(unit=3), address=4)
    session.target.baud = 19_200
    with pytest.raises(TargetError, match="at 19200 baud: nothing comes; try --baud 9600, and"):
        FAMILY.identify(session)


def test_a_neighbour_that_is_not_there_is_not_held_against_the_unit() -> None:
    """The run ends before anything is judged, and names it."""
    words = ["--port", "axistwin://msc-250?time=virtual", "--neighbour", "3", "MSC-PKT-05"]
    result = CliRunner().invoke(conform, ["msc-250", *words])
    assert result.exit_code == 3, result.output
    assert "nobody answers at 3, which --neighbour names" in result.output


def test_another_protocol_shows_its_face() -> None:
    """What talks there instead is told as it came."""
    port = TwinPort()
    port.spoil = lambda data: b"ERROR 7\r\n"
    with pytest.raises(TargetError, match=r"something else talks there: 45 52 .*\(ERROR 7"):
        FAMILY.identify(session_of(port))


# --- whether it answers ---------------------------------------------------------------------------


def test_a_unit_is_sane_if_it_answers_any_known_good_question() -> None:
    """Also after a packet was cut short, whose NAK is still to come."""
    port = TwinPort()
    session = session_of(port)
    session.target.send(codec.packet(1, codec.RQSTAT)[:7])
    assert FAMILY.is_alive(session)
    served = port.served
    port.served = lambda one: None if one.name == "RQSTAT" else served(one)
    assert FAMILY.is_alive(session)
    port.spoil = lambda data: b""
    assert not FAMILY.is_alive(session)


def test_a_reply_nobody_has_acknowledged_is_ended_between_checks() -> None:
    """Or it would be taken for the next one."""
    port = TwinPort()
    session = session_of(port)
    MscDriver(session).ask(codec.RQSTAT, answer=None)
    FAMILY.stop(session)
    assert MscDriver(session).client.listen(10.0) == b""
    assert port.received.endswith(ACK)


# --- what is put back -----------------------------------------------------------------------------


@pytest.mark.parametrize("stride", [4, 2, 1])
@pytest.mark.parametrize("ground", [range(1024, 1400), range(1026, 1030), range(7), range(128)])
def test_what_is_remembered_covers_what_may_be_written(ground: range, stride: int) -> None:
    """Every address a value can be written to; blocks end inside at any distance."""
    blocks, values = layout(ground, stride)
    assert all(at in ground and at + 127 in ground for at in blocks)
    covered = {at + place * stride for at in blocks for place in range(32)} | set(values)
    first = -(-ground.start // 4) * 4
    assert set(range(first, ground.stop, 4)) <= covered


@pytest.mark.parametrize("is_lossless", [True, False])
def test_what_was_written_is_put_back_and_nothing_else_is_touched(is_lossless: bool) -> None:
    """Values alone, blocks, flags; of what nobody has written nothing is even read."""
    port = TwinPort()
    port.data = {at: at * 3 for at in range(0, 4096, 4)}
    port.flags = {129, 130}
    before = dict(port.data), set(port.flags)
    session = session_of(port, target=target_of(port, is_lossless=is_lossless))
    run, writing = remembered(session)
    driver = MscDriver(writing)
    for body in (codec.dwrite(1396, 7), codec.dwrite(1028, 8), codec.sflag(131),
                 codec.cflag(129), codec.bwrite(1100, range(32))):  # fmt: skip
        assert FAMILY.forbid(writing, driver.client.request(body)) is None
        driver.command(body)
    assert (port.data, port.flags) != before
    assert FAMILY.restore(session, run.memory) == ()
    assert (port.data, port.flags) == before
    heard = port.received
    assert FAMILY.restore(session, run.memory) == ()
    assert port.received == heard


def test_what_cannot_be_put_back_is_told() -> None:
    """A value that changes by itself, or that the unit does not take any more."""
    port = TwinPort()
    session = session_of(port)
    run, writing = remembered(session)
    for body in (codec.dwrite(1396, 7), codec.sflag(131)):
        assert FAMILY.forbid(writing, codec.packet(1, body)) is None
        MscDriver(writing).command(body)
    assert str(run.memory) == "unit 1 at 1396: 0; unit 1 flag 131: off"  # for who gives up waiting
    served = port.served
    port.served = lambda one: b"" if one.name in codec.WRITES else served(one)
    told = FAMILY.restore(session, run.memory)
    assert told == ("the value at 1396 is 7, was 0", "flag 131 is on, was off")


def test_a_flag_that_is_refused_alone_is_put_back_as_it_is_told_among_all() -> None:
    """The unit is not lost by that, and is accused of it: no reading has a flag among all only."""
    port = TwinPort()
    session = session_of(port)
    run, writing = remembered(session)
    assert FAMILY.forbid(writing, codec.packet(1, codec.sflag(131))) is None
    MscDriver(writing).command(codec.sflag(131))
    served = port.served
    port.served = lambda one: None if one.name == "RFLAG" else served(one)
    assert FAMILY.restore(session, run.memory) == ()
    assert port.flags == set()
    wanted = "ACK and the state of flag 131, as among all"
    assert ("MSC-LNK-01", wanted, "NAK") in run.violations


def test_a_run_does_not_write_to_what_a_program_uses() -> None:
    """The checks that only read are judged, the others are not, and it is said why."""
    words = ["--port", "axistwin://msc-250?time=virtual&program=bench", "--allow", "stored"]
    result = CliRunner().invoke(
        conform,
        ["msc-250", *words, "--variables", "6144-6271", "-v", "MSC-DWRITE-04", "MSC-RQSTAT-01"],
    )
    assert result.exit_code == 4, result.output
    told = "what is to be put back could not be read: a value behind address 6144 changes by itself"
    assert f"problem: {told} (--variables); name only what no program uses" in result.output
    assert "MSC-RQSTAT-01  pass" in result.output


@pytest.mark.parametrize(
    ("ground", "told"),
    [
        (ScratchArea(range(1024, 1400), range(0)), "a value behind address 1024 changes by itself"),
        (ScratchArea(range(1028, 1040), range(0)), "the value at 1028 changes by itself"),
        (ScratchArea(range(0), range(128, 132)), "flag 130 changes by itself"),
    ],
)
def test_what_a_program_uses_is_not_the_suites_to_write(ground: ScratchArea, told: str) -> None:
    """Named by mistake, it keeps a run from writing, and is named."""
    port = TwinPort()
    served = port.served

    def counting(one: codec.Packet) -> bytes | None:
        port.data[1028] = port.data.get(1028, 0) + 1
        port.flags ^= {130}
        return served(one)

    port.served = counting
    with pytest.raises(TargetError, match=told):
        FAMILY.remember(session_of(port, settings=ground))


def _last_of_the_block_before(last: bytes, before: bytes) -> tuple[bytes, bytes]:
    return before, last


def _turned_by_each_read(last: bytes, before: bytes) -> tuple[bytes, bytes]:
    return (last[::-1] if before else last), b"" if before else last


@pytest.mark.parametrize("tell", [_last_of_the_block_before, _turned_by_each_read])
def test_a_block_that_depends_on_what_was_read_before_is_the_units_failure(tell: Any) -> None:
    """The operator is not told that something uses it; nothing is written all the same."""
    port = TwinPort()
    port.data = {1024 + 4 * number: number + 1 for number in range(64)}
    served, before = port.served, bytes(4)

    def telling(one: codec.Packet) -> bytes | None:
        nonlocal before
        told = served(one)
        if one.name != "BREAD" or not told:
            return told
        last, before = tell(told[-4:], before)
        return bytes(told[:-4] + last)

    port.served = telling
    session = session_of(port)
    with pytest.raises(TargetError, match="depends on what is read"):
        FAMILY.remember(session)
    assert [broken for broken, _, _ in session.run.violations] == ["MSC-BREAD-03"]


def test_the_programs_flags_are_put_back_to_off_only() -> None:
    """Turned on, they are orders to it."""
    port = TwinPort()
    port.flags = {240}
    session = session_of(port, settings=ScratchArea(range(0), range(0), (240, 6144)))
    run = session.run
    run.memory = FAMILY.remember(session)
    moving = Session(run, check_of("motion", needs=("program",)))
    for body in (codec.cflag(240), codec.sflag(241)):
        assert FAMILY.forbid(moving, codec.packet(1, body)) is None
        MscDriver(moving).command(body)
    assert FAMILY.restore(session, run.memory) == ()
    assert port.flags == set()


def test_variables_that_cannot_be_read_keep_a_run_from_writing() -> None:
    """Nothing may be put back as 0."""
    with pytest.raises(TargetError, match="a DREAD reply of 18 bytes"):
        FAMILY.remember(session_of(TwinPort(), settings=ScratchArea(range(40000, 40008))))


# --- what no unit says ----------------------------------------------------------------------------


def reply(body: bytes, unit: int = 1) -> bytes:
    """ACK and a sound packet."""
    return ACK + codec.packet(unit, body)


STATUS = codec.body("RQSTAT", bytes(8))


@pytest.mark.parametrize(
    ("asked", "came", "requirement"),
    [
        (codec.RQSTAT, reply(STATUS), None),
        (codec.RQSTAT, reply(STATUS[:-2]), None),
        (codec.RQSTAT, reply(STATUS[:-1]), "MSC-RQSTAT-01"),
        (codec.RQSTAT, b"", "MSC-LNK-01"),
        (codec.RQSTAT, NAK, "MSC-LNK-01"),
        (codec.RQSTAT, ACK, "MSC-CMD-05"),
        (codec.RQSTAT, codec.with_wrong_checksum(reply(STATUS)), "MSC-PKT-12"),
        (codec.RQSTAT, reply(STATUS, 2), "MSC-PKT-18"),
        (codec.RQSTAT, reply(codec.body("RQSTAX", bytes(8))), "MSC-CMD-04"),
        (codec.RQSTAT, ACK + codec.packet(1, STATUS, length=14), "MSC-PKT-06"),
        (codec.dread(0xFFFC), NAK, None),
        (codec.dread(0), reply(codec.body("DREAD", bytes(2))), "MSC-DREAD-02"),
        (codec.rflag(1), reply(codec.body("RFLAG", b"\xff\xff")), "MSC-RFLAG-02"),
        (codec.dwrite(1024, 1), ACK, None),
        (codec.dwrite(1024, 1), b"\x07", "MSC-LNK-01"),
    ],
)
def test_a_reply_that_no_unit_gives_is_blamed_on_what_it_breaks(
    asked: bytes, came: bytes, requirement: str | None
) -> None:
    """To the engine's own questions; what a reading of the manual admits is nobody's fault."""
    breach = FAMILY.diagnose(session_of(TwinPort()), codec.packet(1, asked), came)
    assert (breach.requirement if breach else None) == requirement


def test_what_came_before_our_sign_is_what_is_blamed() -> None:
    """The last thing sent is the ACK to a reply that was wrong."""
    port = TwinPort()
    session = session_of(port)
    port.spoil = lambda data: codec.with_wrong_checksum(data) if len(data) > 1 else data
    MscDriver(session).ask(codec.RQSTAT)
    request, came = last_exchange(session.records())
    assert (request, came) == (ACK, b"")
    breach = FAMILY.diagnose(session, request, came)
    assert isinstance(breach, Violation)
    assert breach.requirement == "MSC-PKT-12"


def test_broken_requests_and_other_units_blame_nobody() -> None:
    """What comes of them is for checks to say."""
    session = session_of(TwinPort())
    for raw in (codec.packet(2, codec.RQSTAT), codec.packet(1, codec.RQSTAT)[:9], b"xx"):
        assert FAMILY.diagnose(session, raw, NAK) is None
    assert FAMILY.diagnose(session, codec.packet(1, codec.RQSTAT), None) is not None


# --- words ----------------------------------------------------------------------------------------


def test_records_are_put_into_words_either_way() -> None:
    """As the transcript of a finding shows them."""
    asked = Record(0, Direction.HOST, codec.packet(1, codec.dread(2008)))
    came = Record(0, Direction.DEVICE, reply(codec.body("DREAD", codec.i32(5))))
    assert FAMILY.explain(asked) == "unit 1: DREAD 2008"
    assert FAMILY.explain(came) == "ACK, unit 1: DREAD = 5"


def test_the_built_in_twin_runs_the_bench_program_in_every_unit() -> None:
    """In virtual time, with its neighbours on one line."""
    url = "axistwin://msc-250:1,msc-250:2?time=virtual&program=bench"
    assert FAMILY.twin_url("msc-250", 1, (2,)) == url
