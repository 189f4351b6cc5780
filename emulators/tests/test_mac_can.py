"""The MAC23 on CAN, request by request (ledger §2, §3.1, §3.3, §3.4, §8)."""

import pytest
from can_bench import CanBench
from hypothesis import given
from hypothesis import strategies as st
from mac_bench import MS, TICK_NS, S

from axistwin.devices.mac.can.device import MacCan
from axistwin.devices.traces import StateChanged
from axistwin.errors import UsageError
from axistwin.kernel.effects import SendFrame, Store, Trace
from axistwin.wire.can_frame import CanFrame


@pytest.fixture
def bench() -> CanBench:
    """A module at rest, with the defaults."""
    return CanBench()


# ---- identifiers ----


def test_a_module_answers_its_own_identifier_and_no_other() -> None:
    """Address 1 from the factory; the low seven bits of the identifier (MACC-ID-01, -02)."""
    assert CanBench().say(0x601, "40 00 20 00 00 00 00 00") == ["581#4200200000000000"]
    bench = CanBench(address=0x7F)
    assert bench.say(0x67F, "40 00 20 00 00 00 00 00") == ["5FF#4200200000000000"]
    for identifier in (0x601, 0x67E, 0x680, 0x5FF, 0x7FF, 0x000, 0x081, 0x0FF, 0x701, 0x77F):
        assert bench.say(identifier, "23 0C 20 00 00 00 00 10") == []
    assert bench.read(0x26) >> 16 & 0xFF == 0x60


def test_681h_is_nobody() -> None:
    """The manual's example identifiers are misprints (MACC-AMB-02, trap 8)."""
    assert CanBench().say(0x681, "23 16 20 00 03 E8 10 00") == []


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x601, is_remote=True, length=8),
        CanFrame(0x601, bytes.fromhex("2300200000000000"), is_extended=True),
        CanFrame(0x601 << 18, bytes.fromhex("2300200000000000"), is_extended=True),
        CanFrame(0x080, is_remote=True),
        CanFrame(0x080, is_extended=True),
        CanFrame(0x7E5, bytes.fromhex("0401"), is_extended=True),
    ],
)
def test_remote_and_extended_frames_are_ignored(bench: CanBench, frame: CanFrame) -> None:
    """MACC-ID-03."""
    bench.do(0x10)
    bench.do(0x13, 500)
    count = len(bench.frames)
    bench.put(frame)
    bench.advance(3 * S)
    assert bench.told(count) == []
    assert bench.state() == "OF+PL"


@pytest.mark.parametrize("address", [0, 128, -1])
def test_an_address_that_no_module_has_is_a_mistake(address: int) -> None:
    """One line with the range."""
    with pytest.raises(UsageError, match=r"1\.\.127"):
        MacCan(address)


# ---- frames of the ledger ----


@pytest.mark.parametrize(
    ("request_", "reply"),
    [
        ("23 0C 20 00 00 00 00 40", "60 0C 20 00 00 00 00 00"),
        ("23 0C 20 07 00 00 00 40", "60 0C 20 07 00 00 00 00"),  # MACC-SDO-09
        ("23 0C 20 00 FF FF FF 40", "60 0C 20 00 00 00 00 00"),  # MACC-SDO-08
        ("23 0C 20 00 00 00 00 81", "80 0C 20 00 00 00 00 00"),
        ("23 02 20 00 00 00 00 0D", "80 02 20 00 00 00 00 00"),  # trap 21
        ("23 12 20 00 00 00 00 00", "80 12 20 00 00 00 00 00"),  # MACC-CMD-XX-01
        ("23 08 20 00 00 00 00 05", "80 08 20 00 00 00 00 00"),  # serial only
        ("23 1B 20 00 00 00 00 03", "80 1B 20 00 00 00 00 00"),
        ("23 20 20 00 00 00 00 00", "80 20 20 00 00 00 00 00"),
        ("40 05 20 00 00 00 00 00", "42 05 20 00 05 00 03 20"),
        ("40 06 20 00 00 00 00 00", "42 06 20 00 0A 60 10 00"),
        ("40 02 20 00 AA BB CC DD", "42 02 20 00 3F FF FF FF"),  # MACC-SDO-07
        ("40 03 20 FF 00 00 00 00", "42 03 20 FF C0 00 00 00"),
        ("40 04 20 00 00 00 00 00", "42 04 20 00 00 00 07 04"),
        ("40 07 20 00 00 00 00 00", "42 07 20 00 60 73 08 00"),
        ("40 08 20 00 00 00 00 00", "80 08 20 00 00 00 00 00"),  # MACC-Q-XX-01
        ("40 20 20 00 00 00 00 00", "80 20 20 00 00 00 00 00"),
        ("40 00 10 00 00 00 00 00", "80 00 10 00 00 00 00 00"),  # MACC-SDO-10
        ("23 20 0C 00 00 00 00 40", "80 20 0C 00 00 00 00 00"),  # trap 2
        ("22 0C 20 00 00 00 00 40", "80 0C 20 00 00 00 00 00"),
        ("2F 0C 20 00 40 00 00 00", "80 0C 20 00 00 00 00 00"),
        ("60 00 00 00 00 00 00 00", "80 00 00 00 00 00 00 00"),
        ("80 0C 20 00 00 00 00 00", "80 0C 20 00 00 00 00 00"),
        ("00 00 00 00 00 00 00 00", "80 00 00 00 00 00 00 00"),
    ],
)
def test_requests_and_their_replies(request_: str, reply: str) -> None:
    """Byte for byte."""
    assert CanBench().ask_raw(request_) == bytes.fromhex(reply)


@pytest.mark.parametrize("length", range(8))
def test_short_requests_are_ignored(bench: CanBench, length: int) -> None:
    """MACC-SDO-11, own and general."""
    for identifier in (0x601, 0x600):
        assert bench.say(identifier, bytes.fromhex("2300200000000000")[:length]) == []
    assert bench.state() == "OF"


def test_parameters_travel_most_significant_byte_first(bench: CanBench) -> None:
    """The manual's example: 1000 steps of 4096 ticks take 512 ms (MACC-SDO-04, trap 1)."""
    assert bench.ask_raw("23 16 20 00 03 E8 10 00")[0] == 0x60
    start = bench.etx_ns
    assert bench.position_at(start + 1000 * 4096 * TICK_NS - 1) == 999
    assert bench.position_at(start + 1000 * 4096 * TICK_NS) == 1000
    assert bench.state() == "HD"
    assert bench.read(0x20) == 1000


def test_a_motion_starts_at_the_end_of_its_frame(bench: CanBench) -> None:
    """Ledger §5 item 10: the reply's latency has nothing to do with it."""
    bench.put(CanFrame(0x601, bytes.fromhex("2316200000016000")))
    assert bench.position_at(bench.etx_ns + 0x6000 * TICK_NS - 1) == 0
    assert bench.position_at(bench.etx_ns + 0x6000 * TICK_NS) == 1


def test_replies_come_a_fixed_latency_after_their_requests(bench: CanBench) -> None:
    """One per request, in their order (MACC-SDO-06, -13)."""
    bench.put(CanFrame(0x601, bytes.fromhex("2313200000100000")))
    first = bench.etx_ns
    bench.put(CanFrame(0x601, bytes.fromhex("4000200000000000")))
    bench.advance(5 * MS)
    assert [start for start, _ in bench.frames] == [first + MS, bench.etx_ns + MS]
    assert bench.told()[0] == "581#6013200000000000"
    assert bench.told()[1].startswith("581#42002000")


def test_the_two_meanings_of_an_index_do_not_touch_one_another(bench: CanBench) -> None:
    """Reading 2001h resets nothing; writing 2002h leaves the stop alone (MACC-SDO-05, trap 5)."""
    bench.do(0x09, 0x1234)
    bench.do(0x0A, 0xFFFFEDCC)
    bench.do(0x0D, 0x1000)
    bench.do(0x02, 0)
    bench.do(0x03, 9)
    assert bench.read(0x21) == 0
    assert bench.read(0x20) == 0
    assert bench.read(0x22) == 0x1234
    assert bench.read(0x23) == 0xFFFFEDCC
    assert bench.read(0x25) == 0x05001000
    assert bench.read(0x26) == 0x0A600900
    assert bench.state() == "OF"


def test_what_is_stored_is_on_disk_before_the_reply_leaves(bench: CanBench) -> None:
    """The store stands in front of the frame among the effects."""
    bench.do(0x0C, 0x33)
    kinds = [type(effect) for effect in bench.effects]
    assert kinds.index(Store) < kinds.index(SendFrame)
    assert bench.stores == {"torque": 0x33}


@pytest.mark.strength
@given(
    st.lists(
        st.tuples(
            st.sampled_from([0x09, 0x0A, 0x0C, 0x0D, 0x0E, 0x0F, 0x1C, 0x02, 0x03, 0x12, 0x08]),
            st.integers(0, 0xFFFFFFFF),
        ),
        max_size=8,
    )
)
def test_what_is_refused_changes_nothing(downloads: list[tuple[int, int]]) -> None:
    """Read back after every download (MACC-SDO-12)."""
    bench = CanBench()
    reads = (0x22, 0x23, 0x25, 0x26)
    before = [bench.read(index) for index in reads]
    for index, parameters in downloads:
        stores = len([each for each in bench.effects if isinstance(each, Store)])
        reply = bench.ask(index, parameters)
        after = [bench.read(index) for index in reads]
        if reply == b"\x06\x13\x17":
            assert after == before
            assert len([each for each in bench.effects if isinstance(each, Store)]) == stores
        before = after


# ---- restart, factory reset, power ----


def test_2000h_is_answered_then_the_module_is_deaf_for_two_seconds_then_boots(
    bench: CanBench,
) -> None:
    """60h, silence, 701h 00 exactly 2 s after the reply has left (MACC-CMD-00-01, -02)."""
    bench.do(0x0D, 0x1000)
    bench.do(0x10)
    bench.do(0x15, 0x320)
    count = len(bench.frames)
    bench.do(0x00)
    left = bench.now
    for _ in range(180):
        assert bench.ask(0x0C, 0x11) == b""
        bench.advance(10 * MS)
    bench.run_until(left + 2 * S)
    assert bench.told(count) == ["581#6000200000000000", "701#00"]
    assert bench.frames[-1][0] == left + 2 * S
    assert bench.read(0x26) >> 16 & 0xFF == 0x60
    assert bench.read(0x25) == 0x05001000
    assert bench.state() == "OF"


def test_requests_between_2000h_and_its_reply_are_lost(bench: CanBench) -> None:
    """From the accepted restart on nothing is heard (trap 20)."""
    bench.put(CanFrame(0x601, bytes.fromhex("2300200000000000")))
    bench.put(CanFrame(0x601, bytes.fromhex("230C200000000011")))
    bench.put(CanFrame(0x080))
    bench.put(CanFrame(0x7E5, b"\4\1"))
    bench.advance(3 * S)
    assert bench.told() == ["581#6000200000000000", "701#00"]
    assert bench.read(0x26) >> 16 & 0xFF == 0x60


def test_a_request_is_served_right_after_the_boot_up() -> None:
    """The module serves before anybody could have seen that message (MACC-BOOT-04, trap 19)."""
    for early, expected in ((1, []), (0, ["701#00", "581#4200200000000000"])):
        bench = CanBench(started=False)
        bench.run_until(2 * S - early)
        bench.take(
            bench.device.receive(CanFrame(0x601, bytes.fromhex("4000200000000000")), bench.now)
        )
        assert bench.told() == expected


def test_the_position_survives_a_restart_and_an_armed_mode_does_not(bench: CanBench) -> None:
    """MACC-CMD-00-01, MACC-PERS-01, trap 33."""
    bench.do(0x15, 0x320)
    bench.advance(S)
    bench.reset()
    position = bench.position()
    assert position > 1000
    bench.do(0x10)
    bench.reset()
    assert bench.state() == "OF"
    assert bench.position() == position


def test_2001h_makes_it_module_1_as_from_the_factory() -> None:
    """Address 1, all parameters, restart, boot-up on 701h; the position stays (MACC-CMD-01-01)."""
    bench = CanBench(address=5, cells={"position": 123})
    for index, value in ((0x0C, 0x10), (0x0D, 0x1000), (0x0F, 1), (0x09, 55), (0x1C, 9)):
        bench.do(index, value)
    count = len(bench.frames)
    bench.do(0x01)
    bench.advance(2 * S)
    assert bench.told(count) == ["585#6001200000000000", "701#00"]
    assert bench.say(0x605, "40 00 20 00 00 00 00 00") == []
    assert bench.say(0x601, "40 00 20 00 00 00 00 00") == ["581#420020000000007B"]
    bench.address = 1
    assert (bench.read(0x25), bench.read(0x26), bench.read(0x22)) == (
        0x05000320,
        0x0A601000,
        0x3FFFFFFF,
    )
    assert bench.stores["address"] == 1


def test_what_outlives_the_supply() -> None:
    """Parameters, modes, position, address; not 2007h, arm, preload, FIFO (MACC-PERS-01, -02)."""
    bench = CanBench(address=9)
    for index, value in ((2, 0), (3, 9), (9, 77), (0xC, 0x22), (0xE, 0x900), (0x1C, 3), (7, 1)):
        bench.do(index, value)
    bench.do(0x13, 500)
    bench.settle()
    position = bench.position()
    bench.do(0x10)
    bench.power_cycle()
    assert bench.told()[-1] == "709#00"
    assert bench.read(0x26) == 0x0A220903
    assert bench.read(0x25) == 0x09000320
    assert bench.read(0x22) == 77
    assert bench.position() == position == 78  # ended by the stop at 77
    assert bench.state() == "OF"
    assert bench.device.describe(bench.now)["reference_enabled"] is False


def test_the_cells_of_a_module_on_can_hold_no_rate() -> None:
    """They are what a second life begins with; an impossible address is not taken."""
    cells = CanBench(address=7, cells={"torque": 5}).device.cells(0)
    assert "baud" not in cells
    assert (cells["address"], cells["torque"]) == (7, 5)
    assert MacCan(3, cells={"address": 44}).address == 44
    assert MacCan(3, cells={"address": 0}).address == 1


def test_the_reset_input_silences_and_its_release_boots(bench: CanBench) -> None:
    """No dialogue while low, boot-up 2 s after the release (MACC-STATE-02, MACC-AMB-30)."""
    bench.do(0x15, 0x320)
    count = len(bench.frames)
    bench.input("reset", True)
    assert bench.state() == "RI"
    assert bench.ask(0x20) == b""
    bench.advance(60 * S)
    assert bench.told(count) == []
    bench.input("reset", False)
    assert bench.state() == "BT"
    released = bench.now
    bench.advance(2 * S)
    assert bench.frames[count:] == [(released + 2 * S, CanFrame(0x701, b"\0"))]


def test_a_reset_input_between_a_request_and_its_reply_forgets_the_restart(bench: CanBench) -> None:
    """Held, the module sends nothing, and starts once when it is released."""
    bench.put(CanFrame(0x601, bytes.fromhex("2300200000000000")))
    bench.input("reset", True)
    bench.advance(5 * S)
    bench.input("reset", False)
    released = bench.now
    bench.advance(5 * S)
    assert bench.state() == "OF"
    assert bench.frames[1:] == [(released + 2 * S, CanFrame(0x701, b"\0"))]


def test_states_are_told() -> None:
    """As traces, like those of the serial face."""
    bench = CanBench(started=False)
    bench.advance(2 * S)
    bench.do(0x13, 5)
    bench.settle()
    bench.do(0x1A)
    states = [each.state for each in bench.effects if isinstance(each, StateChanged)]
    assert states == ["OF", "PO", "HD", "OF"]


def test_a_module_that_is_off_hears_and_sends_nothing(bench: CanBench) -> None:
    """Until it has power and has started."""
    bench.take(bench.device.power_off(bench.now))
    assert bench.ask(0x20) == b""
    bench.advance(100 * S)
    assert bench.told() == []
    assert bench.state() == "off"
    bench.take(bench.device.power_on(bench.now))
    bench.advance(3 * S)
    assert bench.told() == ["701#00"]


def test_a_module_may_begin_without_power() -> None:
    """Then it is deaf until it is switched on, and boots."""
    module = MacCan(2, powered=False)
    assert module.next_event() is None
    assert module.describe(0)["address"] == 2
    read = CanFrame(0x602, bytes.fromhex("4000200000000000"))
    assert module.receive(read, S) == []
    module.power_on(S)
    assert module.next_event() == 3 * S
    (boot_up,) = [each for each in module.wake(3 * S) if isinstance(each, SendFrame)]
    assert boot_up == (3 * S, CanFrame(0x702, b"\0"))


def test_what_is_due_happens_before_a_frame_is_looked_at() -> None:
    """A module that nobody woke is brought to the frame's time first."""
    module = MacCan(1)
    module.receive(CanFrame(0x601, bytes.fromhex("2316200000030320")), S)  # 300 µs
    refused = CanFrame(0x601, bytes.fromhex("230D200000000400"))
    for at, command in ((S + 300_000 - 1, 0x80), (S + 300_000, 0x60)):
        (reply,) = [each for each in module.receive(refused, at) if isinstance(each, SendFrame)]
        assert reply.frame.data[0] == command


def test_what_is_due_happens_before_a_restart() -> None:
    """The motion goes on until the reply has left, however long it waits for the bus."""
    module = MacCan(1)
    effects = module.receive(CanFrame(0x601, bytes.fromhex("2315200000000320")), S)
    (reset,) = [
        each
        for each in module.receive(CanFrame(0x601, bytes.fromhex("2300200000000000")), 2 * S)
        if isinstance(each, SendFrame)
    ]
    (boot,) = [each for each in module.sent(reset.frame, 3 * S) if isinstance(each, Trace)]
    assert effects
    assert boot == StateChanged(3 * S, "BT")
    assert module.next_event() == 5 * S
    assert module.position_at(3 * S) == module.position_at(4 * S) > 500
