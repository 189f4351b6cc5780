"""Exchanges with a module on CAN."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest
from scripted_bus import VirtualBus

from axistwin_conformance.base.check import check
from axistwin_conformance.base.errors import AttemptVoid
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.session import Run, Session, Stop
from axistwin_conformance.core.wording import RIG
from axistwin_conformance.families.mac.axis.driver.judge import AxisJudge
from axistwin_conformance.families.mac.axis.driver.status import AxisStatus
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.client import CanClient
from axistwin_conformance.families.mac.can.codec import ReplyKind
from axistwin_conformance.families.mac.can.family import MODELS
from axistwin_conformance.transport.can import CanTransport
from axistwin_conformance.transport.can_frame import Frame

REPLY_NS = 1_000_000
UPLOADED = {0x20: -7, 0x21: 0x0002_0000, 0x27: 0x6073_0800}


class Module:
    """Answers like a module at rest; `before` and `instead` say what else comes on the bus."""

    def __init__(self) -> None:
        self.before: tuple[Frame, ...] = ()
        self.instead: list[tuple[Frame, ...]] = []
        self.byte_order = "big"
        self.general_reply = 0x581
        self.bus = VirtualBus(self.answer, REPLY_NS)

    def answer(self, frame: Frame) -> Iterable[Frame]:
        """What comes of a frame."""
        if self.instead:
            return self.instead.pop(0)
        if frame.identifier not in (0x600, 0x601) or len(frame.data) != 8:
            return ()
        command, low, high, sub_index = frame.data[:4]
        whence = 0x581 if frame.identifier == 0x601 else self.general_reply
        head = bytes([low, high, sub_index])
        if command == codec.UPLOAD:
            number = UPLOADED.get(0x20 + low, 0)
            data = codec.parameter_bytes(0x20 + low, number, self.byte_order)
            return (*self.before, Frame(whence, b"\x42" + head + data))
        if command == codec.DOWNLOAD and low in codec.DOWNLOADS:
            if low == 0x00:
                self.bus.schedule(self.bus.virtual_time_ns + 2_000_000_000, codec.boot_up(1))
            return (*self.before, Frame(whence, b"\x60" + head + bytes(4)))
        return (*self.before, Frame(whence, b"\x80" + head + bytes(4)))


def sample_check(session: Session) -> None:
    """It behaves."""


def make_client(module: Module, toy: Any, *, is_lossless: bool = True, **words: Any) -> CanClient:
    """A client of it, in a session that judges two requirements."""
    target = CanTransport(
        module.bus, "toy", is_spontaneous=codec.is_spontaneous, is_lossless=is_lossless, **words
    )
    options = toy.options()
    run = Run(
        target=target, family=toy.family, model=MODELS["mac23-can"],
        ledger=load_ledger("mac_can"), address=1, neighbours=(), allowed=options.allowed,
        envelope=options.settings.envelope, seed=5,
    )  # fmt: skip
    return CanClient(Session(run, check("MACC-SDO-03", "MACC-SDO-06")(sample_check)))


@pytest.fixture
def module() -> Module:
    """A module."""
    return Module()


@pytest.fixture
def client(module: Module, toy: Any) -> CanClient:
    """The client of it, in virtual time and without noise."""
    return make_client(module, toy)


def reply(text: str) -> Frame:
    """A frame from module 1."""
    return Frame(0x581, bytes.fromhex(text))


# --- replies --------------------------------------------------------------------------------------


def test_queries_are_uploads_and_commands_downloads(client: CanClient, module: Module) -> None:
    """By the numbers they have on the serial line."""
    assert client.position() == -7
    assert client.command(0x0B).kind is ReplyKind.ACCEPTED
    assert client.command(0x12).kind is ReplyKind.REFUSED
    assert [str(one) for one in module.bus.sent] == [
        "601h [8] 40 00 20 00 00 00 00 00",
        "601h [8] 23 0B 20 00 00 00 00 00",
        "601h [8] 23 12 20 00 00 00 00 00",
    ]


def test_what_is_said_unasked_is_never_taken_for_the_reply(
    client: CanClient, module: Module
) -> None:
    """Boot-up and lifebeat between request and reply are skipped, and kept."""
    module.before = (codec.boot_up(1), Frame(0x081, bytes(8)))
    assert client.position() == -7
    assert len(client.target.take_spontaneous()) == 2


@pytest.mark.parametrize(
    "stray",
    ["42 01 20 00 00 00 00 01", "60 00 20 00 00 00 00 00", "42 00 20 01 00 00 00 01"],
)
def test_a_reply_to_something_else_is_waited_past(
    client: CanClient, module: Module, stray: str
) -> None:
    """Another index, direction or sub-index."""
    module.before = (reply(stray),)
    assert client.position() == -7


def test_another_modules_reply_is_none_of_ours(client: CanClient, module: Module) -> None:
    """Its identifier is."""
    module.instead = [(Frame(0x582, bytes.fromhex("42 00 20 00 00 00 00 01")),)]
    assert client.ask(0x20).kind is ReplyKind.SILENCE


@pytest.mark.parametrize(
    ("wrong", "flaw"),
    [
        ("42 00 21 00 00 00 00 01", "it is for 2100h sub-index 00"),
        ("60 00 20 00 00 00 00 00", "it accepts a download, not an upload"),
        ("42 00 20 00", "4 bytes instead of 8"),
        ("4F 00 20 00 00 00 00 00", "first byte 4F"),
    ],
)
def test_a_reply_that_is_wrong_and_alone_is_garbage_with_its_flaw(
    client: CanClient, module: Module, wrong: str, flaw: str
) -> None:
    """The module has to be blamed, not the wire."""
    module.instead = [(reply(wrong),)]
    exchange = client.ask(0x20)
    assert exchange.kind is ReplyKind.GARBAGE
    assert flaw in str(exchange.reply)


def test_silence_lasts_as_long_as_a_reply_is_waited_for(client: CanClient, module: Module) -> None:
    """And is no answer."""
    module.instead = [()]
    exchange = client.ask(0x20)
    assert exchange.kind is ReplyKind.SILENCE
    assert client.target.now_ns == 500_000_000
    module.instead = [()]
    with pytest.raises(Stop, match="an answer to upload 2000h"):
        client.position()


def test_a_late_reply_is_not_taken_for_the_next_one(client: CanClient, module: Module) -> None:
    """What has come meanwhile is set aside before anything is asked."""
    module.bus.schedule(600_000_000, reply("42 00 20 00 00 00 00 63"))
    module.instead = [()]
    assert client.ask(0x20).kind is ReplyKind.SILENCE
    client.target.wait(0.2)
    assert client.position() == -7


def test_a_request_to_all_is_answered_where_module_1_answers(
    client: CanClient, module: Module
) -> None:
    """581h, or what the device has shown."""
    assert client.send(client.to_all(0x0B)).kind is ReplyKind.ACCEPTED
    module.general_reply = 0x601
    assert client.send(client.to_all(0x0B)).kind is ReplyKind.SILENCE
    client.session.run.readings["general_reply_id"] = "601h"
    assert client.send(client.to_all(0x0B)).kind is ReplyKind.ACCEPTED


def test_parameters_travel_in_the_order_the_device_has_shown(
    client: CanClient, module: Module
) -> None:
    """Both ways."""
    module.byte_order = "little"
    client.session.run.readings["can_byte_order"] = "little"
    assert client.position() == -7
    client.command(0x16, 0x03E8_1000)
    assert module.bus.sent[-1].data == bytes.fromhex("23 16 20 00 E8 03 00 10")


def test_values_are_read_from_their_bytes(client: CanClient) -> None:
    """Busy is inverted, ff is the second byte of the status."""
    assert not AxisStatus(client).is_busy()
    assert AxisStatus(client).stopped_on() == 0x02
    assert client.data_bytes(0x27) == (0x60, 0x73, 0x08, 0x00)


# --- when ----------------------------------------------------------------------------------------


def test_a_request_is_taken_over_between_its_sending_and_its_reply(client: CanClient) -> None:
    """Nothing narrower is known without the bit rate."""
    client.target.wait(1.0)
    assert client.sample().taken == (1_000_000_000, 1_000_000_000 + REPLY_NS)


def test_the_bit_rate_narrows_when_it_was_taken_over(module: Module, toy: Any) -> None:
    """By the shortest times of the request and of the reply; a restart comes after its reply."""
    client = make_client(module, toy, bitrate=1_000_000)
    frame_ns = (44 + 64) * 1000
    assert client.sample().taken == (frame_ns, REPLY_NS - frame_ns)
    begun_ns = client.target.now_ns
    assert client.command(0x19).taken == (begun_ns + frame_ns, begun_ns + REPLY_NS - frame_ns)
    begun_ns = client.target.now_ns
    assert client.command(0x00).taken == (begun_ns + frame_ns, begun_ns + REPLY_NS)
    slow = make_client(Module(), toy, bitrate=10_000)  # frames as long as that were never sent
    assert slow.sample().taken == (0, REPLY_NS)


def test_a_frame_without_a_reply_is_bounded_by_the_upload_behind_it(client: CanClient) -> None:
    """The bus has one order."""
    assert client.broadcast(codec.sync()) == (0, REPLY_NS)
    assert client.target.now_ns == REPLY_NS


# --- unasked --------------------------------------------------------------------------------------


def test_a_reset_is_waited_for_until_the_boot_up_message(client: CanClient) -> None:
    """Its time is exact."""
    assert client.command(0x00).kind is ReplyKind.ACCEPTED
    arrival = client.boot_up(3.0)
    assert arrival == (codec.boot_up(1), 2_000_000_000)


def test_a_boot_up_message_that_does_not_come_is_not_waited_for_for_ever(client: CanClient) -> None:
    """The rest may be judged all the same."""
    assert client.boot_up(3.0) is None
    assert client.target.now_ns == 3_000_000_000


STARTED = "module 1: boot-up, and nothing had made it start anew"
EXCUSES: dict[str, Callable[[CanClient], object]] = {
    "2000h": lambda client: client.command(0x00),
    "2000h to all": lambda client: client.send(client.to_all(0x00)),
    "LMT": lambda client: client.target.send(Frame(codec.LMT_REQUEST, b"\x04\x00")),
    "network management": lambda client: client.target.send(codec.nmt(0x81, 1)),
    "too short": lambda client: client.target.send(Frame(0x601, b"\x23\x00\x20")),
    "a rig": lambda client: client.target.mark(f"{RIG}the power was switched on"),
}


def started_anew(client: CanClient, module: Module, after_s: float = 9.0) -> list[Any]:
    """What is held against a module that answers, says so long after that that it has started, and
    answers again."""
    client.position()
    module.bus.schedule(client.target.now_ns + round(after_s * 1e9), codec.boot_up(1))
    client.wait(after_s)
    client.position()
    return client.session.run.violations


def test_a_module_that_starts_anew_by_itself_has_failed(client: CanClient, module: Module) -> None:
    """MACC-BOOT-01 says after what a boot-up message comes."""
    ((requirement, _, came),) = started_anew(client, module)
    assert (requirement, came) == ("MACC-BOOT-01", STARTED)


@pytest.mark.parametrize("excuse", EXCUSES)
def test_a_start_that_something_may_have_made_is_none_by_itself(
    client: CanClient, module: Module, excuse: str
) -> None:
    """Also a while before it: the module may have answered in between and put it off."""
    client.position()
    client.wait(9.0)
    EXCUSES[excuse](client)
    assert started_anew(client, module, 1.0) == []


def test_what_somebody_else_sends_may_have_made_a_module_start(
    client: CanClient, module: Module
) -> None:
    """Another host on the bus."""
    client.position()
    module.bus.schedule(10_000_000_000, Frame(0x601, bytes.fromhex("2300200000000000")))
    client.wait(10.0)
    assert started_anew(client, module, 2.0) == []


def test_a_module_just_switched_on_does_not_start_by_itself(
    client: CanClient, module: Module
) -> None:
    """Neither does one that has not answered yet."""
    assert started_anew(client, module, 5.0) == []


def test_a_start_that_was_heard_long_ago_is_judged_by_what_was_before_it(
    client: CanClient, module: Module
) -> None:
    """A check may listen for itself before it asks anything; some modules start slowly."""
    client.position()
    EXCUSES["LMT"](client)
    module.bus.schedule(20_000_000_000, codec.boot_up(1))
    assert client.boot_up(30.0) is not None
    client.target.send(client.request(0x20).frame())
    assert client.target.receive(codec.is_reply, 1.0) is not None
    client.position()
    assert client.session.run.violations == []


def test_where_a_supply_may_be_cut_a_module_may_start_once(module: Module, toy: Any) -> None:
    """It is told to the operator; twice is the module's own."""
    client = make_client(module, toy, is_lossless=False)
    told: list[Any] = []
    client.session.run.emit = told.append
    assert started_anew(client, module) == []
    assert [one.text for one in told] == [f"{STARTED}; was its supply cut for a moment?"]
    ((requirement, _, came),) = started_anew(client, module)
    assert (requirement, came) == ("MACC-BOOT-01", STARTED)


def test_another_modules_boot_up_is_not_ours(client: CanClient, module: Module) -> None:
    """Unless its address is asked for."""
    module.bus.schedule(1_000_000, codec.boot_up(5))
    assert client.boot_up(0.1) is None
    assert client.boot_up(0.0, address=5) is not None


def test_the_lifebeat_can_be_waited_for(client: CanClient, module: Module) -> None:
    """A boot-up message in the form of old is none."""
    module.bus.schedule(1_000_000, codec.boot_up(1, "emergency_empty"))
    module.bus.schedule(10_000_000_000, Frame(0x081, bytes(8)))
    assert client.emergency(11.0) == (Frame(0x081, bytes(8)), 10_000_000_000)


# --- judging --------------------------------------------------------------------------------------


def test_a_reply_of_another_kind_fails_what_is_judged(client: CanClient) -> None:
    """With the request in words."""
    AxisJudge(client).accepted(0x0B, requirement="MACC-SDO-06")
    with pytest.raises(Stop):
        AxisJudge(client).refused(0x0B, requirement="MACC-SDO-03")
    failed = [one for one in client.session.findings if one.verdict is Verdict.FAIL]
    assert failed[0].requirement == "MACC-SDO-03"
    assert failed[0].expected == ("a refusal (80h)",)
    assert failed[0].sentence.endswith(" was accepted (60h); expected a refusal (80h).")


def test_silence_is_judged_and_the_module_still_has_to_answer(
    client: CanClient, module: Module
) -> None:
    """A reply to anything but a request to us would be one too many."""
    AxisJudge(client).silent(Frame(0x601, b"\x40"), "MACC-SDO-06")
    module.instead = [(Frame(0x7E4, b"\x11\0\0"),)]
    with pytest.raises(Stop, match="expected no reply, got LMT reply: 11 00 00"):
        AxisJudge(client).silent(codec.lmt_enter(), "MACC-SDO-06")


# --- noise ----------------------------------------------------------------------------------------


def test_what_got_lost_is_asked_again(module: Module, toy: Any) -> None:
    """An upload, or a setting; what was asked again is recorded."""
    client = make_client(module, toy, is_lossless=False)
    module.instead = [()]
    assert client.position() == -7
    assert len(client.session.retries) == 1
    module.instead = [()]
    before_ns = client.target.now_ns
    taken = client.command(0x0C, 0x40).taken
    assert taken.earliest_ns == before_ns, "the lost one may have been obeyed"
    assert taken.latest_ns == client.target.now_ns


def test_what_must_not_be_said_twice_voids_the_attempt(module: Module, toy: Any) -> None:
    """The module may have obeyed."""
    client = make_client(module, toy, is_lossless=False)
    module.instead = [()]
    with pytest.raises(AttemptVoid, match="download 2016h"):
        client.command(0x16, 0x0001_1000)


def test_the_same_wrong_reply_every_time_is_the_modules_own(module: Module, toy: Any) -> None:
    """It is handed on to be judged, and makes no bus look noisy."""
    client = make_client(module, toy, is_lossless=False)
    quality = client.session.run.quality
    module.instead = [(reply("4F 00 20 00 00 00 00 00"),)] * RETRY.exchange
    assert client.ask(0x20).kind is ReplyKind.GARBAGE
    assert (quality.wrong, quality.corrupted, quality.is_noisy) == (1, 0, False)


def test_a_wrong_reply_that_does_not_come_again_was_corrupted(module: Module, toy: Any) -> None:
    """That is noise."""
    client = make_client(module, toy, is_lossless=False)
    quality = client.session.run.quality
    module.instead = [(reply("4F 00 20 00 00 00 00 00"),)]
    assert client.ask(0x20).kind is ReplyKind.ANSWER
    assert (quality.wrong, quality.corrupted, quality.is_noisy) == (0, 1, True)


def test_a_reply_that_comes_late_is_late_and_not_corrupted(module: Module, toy: Any) -> None:
    """It makes what is seen less sure, and no bus noisy: what is destructive is still asked."""
    client = make_client(module, toy, is_lossless=False)
    quality = client.session.run.quality
    client.target.measure_round_trip(lambda: client.position() == -7, 3)
    before, rate = quality.corrupted, quality.rate
    module.bus.delay_ns = 50_000_000
    client.position()
    module.bus.delay_ns = REPLY_NS
    client.position()
    assert (quality.late, quality.corrupted, quality.is_noisy) == (1, before, False)
    assert quality.rate > rate
    assert str(quality).endswith("exchanges corrupted, 1 late")
    assert len(client.target.lateness.recent) == 1


def test_a_malformed_request_is_sent_once(module: Module, toy: Any) -> None:
    """Its silence says nothing about noise."""
    client = make_client(module, toy, is_lossless=False)
    odd = codec.CanRequest(1, 0x40, 0x00, length=4)
    assert client.send(odd).kind is ReplyKind.SILENCE
    assert module.bus.sent == [odd.frame()]
