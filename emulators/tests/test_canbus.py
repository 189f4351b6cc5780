"""Twins behind a python-can interface, in virtual and in real time."""

import itertools
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest

from axistwin.canbus import AxistwinBus
from axistwin.canbus.interface import SEND_QUEUE_FRAMES
from axistwin.canbus.shared import open_names
from axistwin.wire.can_frame import CanFrame, wire_bits

READ = bytes.fromhex("4000200000000000")
Opener = Callable[..., AxistwinBus]


@pytest.fixture
def opened() -> Iterator[Opener]:
    """Opens by the entry point, in virtual time unless told otherwise; all is shut down after."""
    buses: list[AxistwinBus] = []

    def open_bus(channel: str = "mac23-can:1", **arguments: Any) -> AxistwinBus:
        if "time" not in arguments and "?" not in channel:
            arguments["time"] = "virtual"
        bus = can.Bus(interface="axistwin", channel=channel, ignore_config=True, **arguments)
        assert isinstance(bus, AxistwinBus)
        buses.append(bus)
        return bus

    yield open_bus
    for bus in buses:
        bus.shutdown()
    assert open_names() == []


def frame(identifier: int, data: bytes | str = b"", **options: Any) -> can.Message:
    """A message with an 11-bit identifier."""
    if isinstance(data, str):
        data = bytes.fromhex(data)
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False, **options)


def download(index: int, value: int = 0, address: int = 1) -> can.Message:
    """A request to execute a command."""
    head = bytes((0x23, index, 0x20, 0))
    return frame(0x600 + address, head + value.to_bytes(4, "big", signed=value < 0))


def ids_of(bus: AxistwinBus, seconds: float = 0.1) -> list[int]:
    """All identifiers heard until nothing comes for so long."""
    heard = []
    while (message := bus.recv(seconds)) is not None:
        heard.append(message.arbitration_id)
    return heard


def send_for_ever(bus: AxistwinBus) -> None:
    """Until that fails."""
    while True:
        bus.send(frame(0x123))


# ---- virtual time --------------------------------------------------------------------------------


def test_a_request_is_answered(opened: Opener) -> None:
    """With everything a message has, and the exact time."""
    bus = opened("mac23-can:1,2")
    bus.send(frame(0x602, READ))
    message = bus.recv(1.0)
    assert message is not None
    assert message.arbitration_id == 0x582
    assert message.data == bytes.fromhex("4200200000000000")
    assert (message.dlc, message.channel, message.is_rx) == (8, "mac23-can:1,2", True)
    assert not message.is_extended_id
    assert not message.is_remote_frame
    assert not message.is_error_frame
    assert message.timestamp == bus.virtual_time_ns / 1e9
    request, reply = CanFrame(0x602, READ), CanFrame(0x582, bytes(message.data))
    latency_ns = bus.virtual_time_ns - (wire_bits(request) + wire_bits(reply)) * 8000
    assert 1_030_000 <= latency_ns < 1_200_000  # 1 ms, and what the second module is slower


def test_time_passes_only_while_somebody_waits(opened: Opener) -> None:
    """A time-out takes as long as it says; sending takes nothing."""
    bus = opened()
    bus.send(frame(0x123))
    assert bus.virtual_time_ns == 0
    assert bus.recv(0.25) is None
    assert bus.virtual_time_ns == 250_000_000
    bus.advance(2.5)
    assert bus.virtual_time_ns == 2_750_000_000


def test_polling_ends(opened: Opener) -> None:
    """A look takes the least length of a frame, or nothing if something is there."""
    bus = opened(bitrate=500_000)
    assert bus.recv(0) is None
    assert bus.virtual_time_ns == 47 * 2000
    bus.send(frame(0x601, READ))
    looks = next(count for count in itertools.count() if bus.recv(0) is not None)
    assert 1 < looks < 100
    bus.send(frame(0x601, READ))
    bus.advance(1.0)
    assert bus.recv(0) is not None
    assert bus.recv(-1) is None


def test_waiting_for_ever_ends_in_an_error_if_nothing_can_come(opened: Opener) -> None:
    """But not before everything that comes by itself has come."""
    bus = opened()
    message = bus.recv(None)
    assert message is not None
    assert message.arbitration_id == 0x081  # the lifebeat
    bus.twins[0].power_off()
    with pytest.raises(can.CanOperationError, match="nothing can ever arrive"):
        bus.recv(None)


def test_filters_hold_back_what_does_not_match(opened: Opener) -> None:
    """At opening and later; what waits already is judged by the newest."""
    only_581 = [{"can_id": 0x581, "can_mask": 0x7FF, "extended": False}]
    bus = opened("mac23-can:1,2", can_filters=only_581)
    for address in (1, 2):
        bus.send(frame(0x600 + address, READ))
    assert ids_of(bus) == [0x581]
    for address in (1, 2):
        bus.send(frame(0x600 + address, READ))
    bus.advance(0.1)
    bus.set_filters([{"can_id": 0x582, "can_mask": 0x7FF}])
    assert ids_of(bus) == [0x582]
    bus.set_filters(None)
    bus.send(frame(0x600, READ))
    assert ids_of(bus) == [0x581]


def test_a_wait_goes_on_behind_what_a_filter_holds_back(opened: Opener) -> None:
    """The time-out counts from the beginning."""
    bus = opened(can_filters=[{"can_id": 0x7, "can_mask": 0x7FF}])
    bus.send(frame(0x601, READ))
    assert bus.recv(0.5) is None
    assert bus.virtual_time_ns == 500_000_000


def test_ports_on_one_channel_share_one_bus(opened: Opener) -> None:
    """They hear one another and the twins at the same times; they may omit what is agreed."""
    first, second = opened("mac23-can:1,2", seed=5), opened("mac23-can:1,mac23-can:2", seed=5)
    assert first.twins is second.twins
    first.send(frame(0x601, READ))
    first.advance(0.1)
    heard, overheard = [first.recv(0)], [second.recv(0), second.recv(0)]
    assert [each.arbitration_id for each in overheard if each] == [0x601, 0x581]
    assert heard[0] is not None
    assert overheard[1] is not None
    assert heard[0].timestamp == overheard[1].timestamp
    third = opened("?bus=mac23-can:1,mac23-can:2")
    assert third.twins is first.twins
    second.shutdown()
    first.send(frame(0x601, READ))
    assert ids_of(third) == [0x601, 0x581]


def test_other_channels_are_other_buses(opened: Opener) -> None:
    """By their devices or by a name of their own."""
    buses = [opened("mac23-can:1"), opened("mac23-can:2"), opened(bus="spare")]
    assert len({id(bus.twins) for bus in buses}) == 3
    buses[0].send(frame(0x601, READ))
    assert [len(ids_of(bus)) for bus in buses] == [1, 0, 0]


def test_own_messages_are_received_if_wanted(opened: Opener) -> None:
    """When they have left, and marked."""
    bus = opened(receive_own_messages=True)
    bus.send(frame(0x601, READ))
    own, reply = bus.recv(1), bus.recv(1)
    assert own is not None
    assert reply is not None
    assert (own.arbitration_id, own.is_rx) == (0x601, False)
    assert (reply.arbitration_id, reply.is_rx) == (0x581, True)
    assert own.timestamp == wire_bits(CanFrame(0x601, READ)) * 8000 / 1e9


def test_every_kind_of_frame_travels(opened: Opener) -> None:
    """Extended, remote, empty."""
    sends, hears = opened(), opened()
    messages = [
        can.Message(arbitration_id=0x1ABCDEF0, data=b"abc"),
        can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=5),
        frame(0x7FF),
    ]
    for message in messages:
        sends.send(message)
    heard = [hears.recv(1) for _ in messages]
    for message in messages:
        assert any(
            got is not None
            and got.equals(
                message, timestamp_delta=None, check_channel=False, check_direction=False
            )
            for got in heard
        )


def test_what_cannot_be_sent_is_refused(opened: Opener) -> None:
    """FD and error frames, lengths that no frame has."""
    bus = opened()
    with pytest.raises(can.CanOperationError, match="FD frames cannot be sent"):
        bus.send(can.Message(is_fd=True, data=bytes(12)))
    with pytest.raises(can.CanOperationError, match="error frames cannot be sent"):
        bus.send(can.Message(is_error_frame=True))
    with pytest.raises(ValueError, match="11 bits"):
        bus.send(frame(0x800))
    with pytest.raises(can.CanInitializationError, match="classical CAN"):
        opened("mac23-can:9", fd=True)


def test_a_full_send_queue_is_waited_for(opened: Opener) -> None:
    """Which moves virtual time by what is needed; not at all with time-out 0."""
    bus = opened()
    for _ in range(SEND_QUEUE_FRAMES):
        bus.send(frame(0x123), timeout=0)
    with pytest.raises(can.CanTimeoutError, match="still full"):
        bus.send(frame(0x123), timeout=0)
    assert bus.virtual_time_ns == 0
    bus.send(frame(0x123))
    assert 0 < bus.virtual_time_ns < 3_000_000
    bus.flush_tx_buffer()
    bus.send(frame(0x601, READ))
    assert ids_of(bus) == [0x581]


def test_a_send_without_anybody_to_acknowledge_fails_when_the_queue_is_full(
    opened: Opener,
) -> None:
    """The state tells why, error frames told how it came about; power brings it back."""
    bus = opened()
    bus.twins[0].power_off()
    with pytest.raises(can.CanOperationError, match="nobody on the bus acknowledges"):
        send_for_ever(bus)
    assert bus.state == can.BusState.PASSIVE
    errors = [message for message in iter(lambda: bus.recv(0), None) if message.is_error_frame]
    assert {each.arbitration_id for each in errors} == {0x0A0, 0x004}
    (passive,) = [each for each in errors if each.arbitration_id == 0x004]
    assert passive.data[1] == 0x20
    assert not passive.is_extended_id
    bus.twins[0].power_on()
    bus.advance(1.0)
    assert bus.state.name == "ACTIVE"


def test_error_frames_can_be_left_out(opened: Opener) -> None:
    """As with SocketCAN."""
    bus = opened(ignore_rx_error_frames=True)
    bus.twins[0].power_off()
    bus.send(frame(0x123))
    assert bus.recv(1.0) is None
    assert bus.state is can.BusState.PASSIVE


def test_ports_that_disturb_one_another_hear_of_it(opened: Opener) -> None:
    """Bit errors when both wait for the bus with one identifier and different data."""
    first, second = opened(), opened()
    second.send(frame(0x001))
    first.send(frame(0x123, "00"))
    second.send(frame(0x123, "FF"))
    assert first.recv(1.0) is not None
    message = first.recv(1.0)
    assert message is not None
    assert message.is_error_frame
    assert (message.arbitration_id, message.data[2]) == (0x088, 0x81)


def test_the_state_is_no_ones_to_set(opened: Opener) -> None:
    """It follows from what happens."""
    with pytest.raises(NotImplementedError):
        opened().state = can.BusState.PASSIVE


# ---- periodic tasks ------------------------------------------------------------------------------


def test_a_periodic_task_sends_at_exact_times(opened: Opener) -> None:
    """Whoever lets time pass; until it is stopped; it can be changed and started again."""
    sends, hears = opened(), opened()
    task: Any = sends.send_periodic(frame(0x123, "01"), 0.1)
    span = wire_bits(CanFrame(0x123, b"\1")) * 8000 / 1e9
    stamps = [message.timestamp for _ in range(4) if (message := hears.recv(1.0))]
    assert stamps == pytest.approx([0.1 * n + span for n in range(4)], abs=1e-12)
    task.modify_data(frame(0x123, "02"))
    message = hears.recv(1.0)
    assert message is not None
    assert message.data == b"\2"
    task.stop()
    assert hears.recv(1.0) is None
    task.start()
    assert hears.recv(1.0) is not None
    task.stop()
    assert hears.recv(1.0) is None
    sends.send_periodic(frame(0x124), 0.1)
    assert hears.recv(1.0) is not None
    sends.stop_all_periodic_tasks()
    assert hears.recv(1.0) is None


def test_a_periodic_task_ends_after_its_duration(opened: Opener) -> None:
    """Several messages go out in turn, each as its modifier makes it."""
    bus = opened(receive_own_messages=True)

    def count(message: can.Message) -> None:
        message.data[0] += 1

    messages = [frame(0x123, "10"), frame(0x123, "20")]
    bus.send_periodic(messages, 0.01, duration=0.05, modifier_callback=count)
    heard = [message.data[0] for _ in range(9) if (message := bus.recv(0.1))]
    assert heard == [0x11, 0x21, 0x12, 0x22, 0x13]


def test_shutting_down_stops_the_tasks(opened: Opener) -> None:
    """Others go on."""
    sends, hears = opened(), opened()
    sends.send_periodic(frame(0x123), 0.1)
    sends.shutdown()
    hears.advance(0.1)
    while hears.recv(0) is not None:
        pass
    assert hears.recv(1.0) is None


# ---- threads -------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["virtual", "real"])
def test_a_notifier_serves_listeners(opened: Opener, kind: str) -> None:
    """Its thread reads, the program's sends."""
    bus = opened(time=kind)
    reader = can.BufferedReader()
    notifier = can.Notifier(bus, [reader], timeout=0.05)
    try:
        for _ in range(5):
            bus.send(frame(0x601, READ))
            deadline = time.monotonic() + 10
            while (message := reader.get_message(1.0)) is None or message.arbitration_id != 0x581:
                assert time.monotonic() < deadline
    finally:
        notifier.stop()


def test_shutting_down_ends_a_wait_in_another_thread(opened: Opener) -> None:
    """With an error that says so."""
    bus = opened(time="real")
    errors: list[BaseException] = []

    def read() -> None:
        try:
            bus.recv(60)
        except can.CanError as error:
            errors.append(error)

    thread = threading.Thread(target=read)
    thread.start()
    while not bus._bus._sleepers:
        time.sleep(0.001)
    bus.shutdown()
    thread.join(10)
    assert not thread.is_alive()
    assert "shut down" in str(errors[0])


# ---- real time -----------------------------------------------------------------------------------


def test_real_time_passes_by_itself(opened: Opener) -> None:
    """Stamps are those of the system's clock; a time-out takes its time."""
    bus = opened(time="real")
    began = time.time()
    bus.send(frame(0x601, READ))
    message = bus.recv(5.0)
    assert message is not None
    assert message.arbitration_id == 0x581
    assert began <= message.timestamp <= time.time()
    began = time.monotonic()
    assert bus.recv(0.05) is None
    assert 0.05 <= time.monotonic() - began < 5
    assert bus.recv(0) is None


def test_time_may_be_many_times_as_fast(opened: Opener) -> None:
    """Time-outs stay the host's own seconds."""
    bus = opened(time=50)
    # On a busy machine the bus is joined after the first lifebeat, which nobody has acknowledged.
    messages = iter(lambda: bus.recv(5.0), None)
    message = next(each for each in messages if not each.is_error_frame)
    assert message.arbitration_id == 0x081  # the lifebeat of 10 s


def test_a_periodic_task_runs_in_real_time(opened: Opener) -> None:
    """In a thread of its own, as python-can has it."""
    bus, hears = opened(time="real"), opened(time="real")
    task = bus.send_periodic(frame(0x123), 0.01)
    heard = [hears.recv(5.0) for _ in range(3)]
    task.stop()
    assert [each.arbitration_id for each in heard if each] == [0x123] * 3


# ---- twins and their surroundings ----------------------------------------------------------------


def test_twins_can_be_worked(opened: Opener) -> None:
    """An hour of motion in no time; the supply; the transcript."""
    bus = opened()
    bus.send(download(0x13, 1000))
    bus.advance(3600)
    assert bus.twins[0].position == 1000
    while bus.recv(0) is not None:
        pass
    bus.twins[0].supply_volts = 47
    message = bus.recv(1)
    assert message is not None
    assert message.arbitration_id == 0x081
    assert "emergency 3210h" in bus.render_transcript()
    bus.twins[0].power_cycle()
    assert 0x701 in ids_of(bus, 3)


def test_what_is_stored_outlives_the_bus(opened: Opener, tmp_path: Any) -> None:
    """In the folder given, under either spelling."""
    bus = opened(state_dir=tmp_path)
    bus.send(download(0x0D, 0x1234))
    assert ids_of(bus) == [0x581]
    bus.shutdown()
    again = opened(f"mac23-can:1?state={tmp_path}&time=virtual")
    again.send(frame(0x601, "4005200000000000"))
    message = again.recv(1)
    assert message is not None
    assert message.data[6:] == b"\x12\x34"


def test_quirks_are_given_in_three_ways(opened: Opener, tmp_path: Any) -> None:
    """In the channel, as an argument, in a profile."""
    profile = tmp_path / "unit.toml"
    profile.write_text('model = "mac23-can"\n[quirks]\nupload_scs = "43h"\n')
    for channel, arguments in (
        ("mac23-can:1?time=virtual&quirk.upload_scs=43h", {}),
        ("mac23-can:1", {"quirks": {"upload_scs": "43h"}}),
        ("mac23-can:1", {"quirk.upload_scs": "43h"}),
        ("mac23-can:1", {"profile": profile}),
    ):
        bus = opened(channel, **arguments)
        bus.send(frame(0x601, READ))
        message = bus.recv(1)
        assert message is not None
        assert message.data[0] == 0x43
        bus.shutdown()


def test_other_ways_of_life(opened: Opener) -> None:
    """A cold start, and frames that take no time."""
    bus = opened(cold=True, pacing=False)
    message = bus.recv(5)
    assert message is not None
    assert (message.arbitration_id, message.timestamp) == (0x701, 2.0)


@pytest.mark.parametrize(
    ("channel", "arguments", "message"),
    [
        ("mac24-can", {}, "unknown model 'mac24-can': did you mean mac23-can"),
        ("mac23-can:0", {}, "address 0 is out of range for mac23-can: 1..7Fh"),
        ("mac23-can:1,200", {}, "address 200 is out of range"),
        ("mac23:1", {}, "mac23:1 lives on a serial line, not on a CAN bus"),
        ("", {}, "channel '' names no device; write mac23-can:1"),
        ("?bus=none", {}, "there is no bus none"),
        ("mac23-can", {"tiem": "virtual"}, "unknown argument tiem: did you mean time?"),
        ("mac23-can", {"time": "soon"}, "time=soon: use virtual, real, or a speed"),
        ("mac23-can", {"time": "real", "bitrate": 2_000_000}, "bitrate 2000000 is out of range"),
        ("mac23-can", {"quirks": {"upload_scs": "44h"}}, "quirk upload_scs: '44h' is not allowed"),
        ("mac23-can?speed=3", {}, "unknown parameter speed: write time=3"),
        ("mac23-can?baud=3", {}, "unknown parameter baud"),
        ("mac23-can?seed=1", {"seed": 2}, "seed: given twice (1 and 2)"),
    ],
)
def test_a_mistake_is_one_clear_line(
    opened: Opener, channel: str, arguments: dict[str, Any], message: str
) -> None:
    """With the remedy, as the error python-can's users expect; nothing stays open."""
    with pytest.raises(can.CanInitializationError) as caught:
        opened(channel, **arguments)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_meant_for_other_interfaces_is_passed_over(opened: Opener) -> None:
    """Words that python-can's programs give to all, and what was not set."""
    bus = opened(single_handle=True, data_bitrate=2_000_000, seed=None, fd=False, timing=None)
    assert bus.twins[0].address == 1
    timing = can.BitTiming(f_clock=8_000_000, brp=1, tseg1=13, tseg2=2, sjw=1)
    assert opened(bus="timed", timing=timing)._bus.bitrate == timing.bitrate == 500_000


def test_a_state_for_python_can_is_no_folder() -> None:
    """The word is taken; the message says what to write."""
    with pytest.raises(can.CanInitializationError, match="write state_dir=DIR"):
        AxistwinBus("mac23-can", state="./memory")


def test_a_bus_that_is_open_is_not_another_one(opened: Opener) -> None:
    """Options that disagree are told; those left out agree."""
    opened(bitrate=250_000)
    with pytest.raises(can.CanInitializationError, match="bitrate is 250000, not 125000"):
        opened(bitrate=125_000)
    opened()


def test_after_the_end_everything_is_an_error_that_says_so(opened: Opener) -> None:
    """Twice is once; the module is there again at the next opening."""
    bus = opened()
    bus.shutdown()
    bus.shutdown()
    for use in (
        lambda: bus.recv(0),
        lambda: bus.send(frame(0x123)),
        lambda: bus.state,
        lambda: bus.virtual_time_ns,
        lambda: bus.advance(1),
        bus.flush_tx_buffer,
    ):
        with pytest.raises(can.CanOperationError, match="is shut down"):
            use()


def test_shutting_down_just_before_a_look_is_an_error_that_says_so(
    opened: Opener, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another thread may do so at any moment, while others still use the bus."""
    bus, _ = opened(), opened()
    acts = iter((bus.shutdown, bus._next_message))
    monkeypatch.setattr(bus, "_next_message", lambda: [act() for act in acts])
    with pytest.raises(can.CanOperationError, match="is shut down"):
        bus.recv(1)


def test_a_bus_that_has_failed_is_not_joined_and_not_kept() -> None:
    """One clear line; the last who leaves ends it all the same."""
    bus = AxistwinBus("mac23-can:1", time="virtual")
    bus._bus.close()
    with pytest.raises(can.CanInitializationError, match="the bus is closed"):
        AxistwinBus("mac23-can:1")
    with pytest.raises(can.CanOperationError, match="the bus is closed"):
        bus.shutdown()
    assert open_names() == []


def test_what_was_queued_is_sent_before_the_end(opened: Opener) -> None:
    """As a kernel does with a closed socket; where nobody acknowledges, it ends all the same."""
    sends, hears = opened(), opened()
    for number in range(5):
        sends.send(frame(0x100 + number))
    sends.shutdown()
    assert ids_of(hears) == [0x100, 0x101, 0x102, 0x103, 0x104]
    hears.twins[0].power_off()
    hears.send(frame(0x123))
    before, clock = hears.virtual_time_ns, hears._bus.clock
    hears.shutdown()
    assert 0 < clock.now_ns() - before < 2_000_000


def test_what_there_is_can_be_detected(opened: Opener) -> None:
    """The models, and the buses that are open, each good for opening."""
    opened(bus="bench")
    found = can.detect_available_configs("axistwin")
    assert [each["channel"] for each in found] == ["mac23-can", "?bus=bench"]
    for config in found:
        opened(str(config["channel"]), time="virtual")


@pytest.mark.system
def test_python_cans_own_programs_reach_a_twin(tmp_path: Any) -> None:
    """``python -m can.player`` in a process of its own finds the interface by its entry point."""
    log = tmp_path / "requests.log"
    log.write_text("(0.000000) can0 601#4000200000000000\n(0.010000) can0 601#230D200000001234\n")
    memory = tmp_path / "memory"
    channel = f"mac23-can:1?state={memory}"
    command = ["-m", "can.player", "-i", "axistwin", "-c", channel, str(log)]
    done = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert (memory / "mac23-can-1.state").exists()
    again = AxistwinBus(channel, time="virtual")
    again.send(frame(0x601, "4005200000000000"))
    message = again.recv(1)
    again.shutdown()
    assert message is not None
    assert message.data[6:] == b"\x12\x34"
