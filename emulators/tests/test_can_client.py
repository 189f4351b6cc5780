"""A client of a bus: frames both ways against real twins, queues, errors, in virtual time."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin.catalog import build_bus, parse_device
from axistwin.ports.can_client import BACKLOG_FRAMES, OUTPUT_MAX, CanClient
from axistwin.ports.dialect import BusError
from axistwin.ports.slcan import SlcanPort
from axistwin.ports.socketcand import SocketcandSession
from axistwin.runtime.bus import Bus
from axistwin.runtime.clock import VirtualClock
from axistwin.wire.can_bus import Change, ControllerState
from axistwin.wire.can_frame import CanFrame

BITRATE = 125_000
MS = 1_000_000
EPOCH_NS = 1_700_000_000_000_000_000


def a_bus(*devices: str, paced: bool = True) -> Bus:
    """A bus in virtual time."""
    specs = [parse_device(device) for device in devices or ("mac23-can:1",)]
    return build_bus(specs, clock=VirtualClock(0), bitrate=BITRATE, paced=paced)


def an_slcan_client(bus: Bus) -> CanClient:
    """With an open channel."""
    client = CanClient(bus, SlcanPort(BITRATE))
    client.start()
    client.input(b"S4\rO\r")
    assert read(client) == b"\r\r"
    return client


def read(client: CanClient) -> bytes:
    """All that the client has waiting."""
    data: list[bytes] = []

    def take(offered: bytes) -> int:
        data.append(offered)
        return len(offered)

    client.write_to(take)
    assert not client.has_output
    return b"".join(data)


EMERGENCY = b"t0818003105010000"
"""Of the device at node 1, as an adapter writes it: 3100h."""


def cut_for_a_moment(bus: Bus) -> None:
    """Its supply; the device says so in an emergency."""
    bus.twins[0].controls["faults.micro_cut"].set(True)


def is_behind(client: CanClient) -> bool:
    """As the client says just now."""
    return client.is_behind


def settle(bus: Bus, *clients: CanClient, time_ns: int = 20 * MS) -> None:
    """Let time pass, and the clients take what came."""
    bus.wait(bus.clock.now_ns() + time_ns)
    for client in clients:
        client.pump()


def test_a_client_converses_with_a_twin() -> None:
    """An upload goes through text, bus and twin, and its answer comes back as text."""
    bus = a_bus()
    client = an_slcan_client(bus)
    client.input(b"t60184000100000000000\r")
    assert read(client) == b"z\r"
    settle(bus, client)
    answer = read(client)
    assert answer.startswith(b"t5818")
    assert answer.endswith(b"\r")


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("before", [b"", b"C\rS4\r", b"L\r", b"S3\rO\r"])
def test_a_client_that_is_not_open_takes_no_frame_from_the_one_that_opens(
    before: bytes, paced: bool
) -> None:
    """What a lone device says waits, however long a program takes from its first byte to ``O``."""
    bus = a_bus(paced=paced)
    client = CanClient(bus, SlcanPort(BITRATE))
    client.start()
    client.input(before)
    cut_for_a_moment(bus)
    settle(bus, client, time_ns=300 * MS)
    assert b"t081" not in read(client)
    client.input(b"C\rS4\rO\r")
    settle(bus, client)
    assert read(client).count(EMERGENCY) == 1


def test_what_a_device_says_after_a_client_has_closed_waits_for_the_next() -> None:
    """The client that has closed its channel is still connected."""
    bus = a_bus()
    client = an_slcan_client(bus)
    client.input(b"C\r")
    cut_for_a_moment(bus)
    settle(bus, client)
    client.stop()
    following = an_slcan_client(bus)
    settle(bus, following)
    assert read(following).count(EMERGENCY) == 1


def test_clients_hear_one_another_in_one_order() -> None:
    """Each hears the others and not itself; all hear the same order, whatever their dialect."""
    bus = a_bus()
    one, other, listener = (an_slcan_client(bus) for _ in range(3))
    session = CanClient(bus, SocketcandSession(["can0"]), epoch_ns=EPOCH_NS)
    session.start()
    session.input(b"< open can0 >< rawmode >")
    assert read(session) == b"< hi >< ok >< ok >"
    for i in range(10):
        one.input(b"t2%02X0\r" % i)
        other.input(b"t1%02X0\r" % i)
    settle(bus, one, other, listener, session, time_ns=200 * MS)
    own = b"z\r" * 10
    heard = read(listener).split(b"\r")[:-1]
    assert read(one) == own + b"".join(line + b"\r" for line in heard if line[:2] == b"t1")
    assert read(other) == own + b"".join(line + b"\r" for line in heard if line[:2] == b"t2")
    assert sorted(heard) == [b"t%d%02X0" % (n, i) for n in (1, 2) for i in range(10)]
    messages = read(session).split(b">")[:-1]
    assert [message.split()[2] for message in messages] == [line[1:4] for line in heard]
    assert all(message.split()[3].startswith(b"1700000000.0") for message in messages)


def test_a_full_bus_holds_its_client_back_and_loses_nothing() -> None:
    """The client is behind until the bus has carried its frames; all of them arrive."""
    bus = a_bus()
    sender, listener = an_slcan_client(bus), an_slcan_client(bus)
    sent = 0
    while not is_behind(sender):
        sender.input(b"t2000\r")
        sent += 1
    assert sent == BACKLOG_FRAMES + 1
    settle(bus, sender, listener, time_ns=1000 * MS)
    assert not is_behind(sender)
    assert read(listener) == b"t2000\r" * sent
    assert read(sender) == b"z\r" * sent


def test_a_bus_without_time_is_never_behind() -> None:
    """More frames than any queue holds go through at once."""
    bus = a_bus(paced=False)
    sender, listener = an_slcan_client(bus), an_slcan_client(bus)
    for _ in range(30):
        sender.input(b"t2000\r" * 100)
        assert not sender.is_behind
        listener.pump()
        assert read(listener) == b"t2000\r" * 100
        assert read(sender) == b"z\r" * 100


@pytest.mark.strength
def test_a_sleeping_client_harms_nobody() -> None:
    """It loses whole messages beyond its bound, counted; another one loses none."""
    bus = a_bus(paced=False)
    sender, sleeper, awake = (an_slcan_client(bus) for _ in range(3))
    line = b"t2008" + b"00" * 8 + b"\r"
    rounds, per_round = 40, 100
    for _ in range(rounds):
        sender.input(line * per_round)
        read(sender)
        bus.sync()
        sleeper.pump()
        awake.pump()
        assert read(awake) == line * per_round
    kept = OUTPUT_MAX // len(line)
    assert read(sleeper) == line * kept
    assert sleeper.take_dropped() == rounds * per_round - kept
    assert sleeper.take_dropped() == 0
    assert awake.take_dropped() == 0


@pytest.mark.strength
@given(st.lists(st.integers(0, 40), max_size=30), st.integers(1, 12))
def test_messages_leave_in_pieces_of_any_size(sizes: list[int], frames: int) -> None:
    """What the descriptor takes piece by piece is what there was, with more coming meanwhile."""
    bus = a_bus(paced=False)
    sender, listener = an_slcan_client(bus), an_slcan_client(bus)
    written = b""

    def write_some(size: int) -> None:
        def take(offered: bytes) -> int:
            nonlocal written
            written += offered[:size]
            return min(size, len(offered))

        listener.write_to(take)

    for size in sizes:
        sender.input(b"t2003112233\r" * frames)
        bus.sync()
        listener.pump()
        write_some(size)
    written += read(listener)
    assert written == b"t2003112233\r" * frames * len(sizes)


def test_jobs_of_the_dialect_are_sent_at_their_time() -> None:
    """A periodic frame of a BCM client is on the bus at its beat, and the bus is asked when."""
    bus = a_bus()
    listener = an_slcan_client(bus)
    client = CanClient(bus, SocketcandSession(["can0"]), epoch_ns=EPOCH_NS)
    client.start()
    client.input(b"< open can0 >< add 0 10000 200 0 >")
    for _ in range(3):
        due_ns = client.next_event_ns()
        assert due_ns is not None
        bus.wait(due_ns)
        client.pump()
    settle(bus, listener, time_ns=5 * MS)
    assert read(listener) == b"t2000\r" * 4
    assert client.next_event_ns() == 40 * MS


def test_errors_reach_the_client() -> None:
    """Two senders of one identifier with different data: both clients learn of it."""
    bus = a_bus()
    one, other = an_slcan_client(bus), an_slcan_client(bus)
    session = CanClient(bus, SocketcandSession(["can0"]))
    session.start()
    session.input(b"< open can0 >< rawmode >")
    read(session)
    session.input(b"< send 001 0 >")  # while it is under way the others get ready
    one.input(b"t200100\r")
    other.input(b"t200101\r")
    settle(bus, one, other, session, time_ns=200 * MS)
    assert b"< error 088 " in read(session)
    one.input(b"F\r")
    flags = int(read(one).split(b"F")[1][:2], 16)
    assert flags & 0x80


def test_frames_and_errors_are_told_in_the_order_of_time() -> None:
    """A frame that went before two senders destroyed theirs is told before the errors."""
    bus = a_bus()
    first, one, other = (an_slcan_client(bus) for _ in range(3))
    session = CanClient(bus, SocketcandSession(["can0"]))
    session.start()
    session.input(b"< open can0 >< rawmode >< send 001 0 >")
    read(session)
    first.input(b"t1000\r")
    one.input(b"t200100\r")
    other.input(b"t200101\r")
    settle(bus, session, time_ns=200 * MS)
    told = [words.split() for words in read(session).split(b"<")[1:]]
    assert [told[0][:2], told[1][:2]] == [[b"frame", b"100"], [b"error", b"088"]]
    times = [words[2] for words in told]
    assert times == sorted(times)


def test_a_controller_that_becomes_passive_is_told() -> None:
    """Once, while two stations fight over an identifier; its passive flags then end the fight."""
    bus = a_bus()
    fighter = an_slcan_client(bus)
    session = CanClient(bus, SocketcandSession(["can0"]))
    session.start()
    session.input(b"< open can0 >< rawmode >< send 000 0 >")
    read(session)
    fighter.input(b"t200100\r")
    session.input(b"< send 200 1 01 >")
    classes: list[bytes] = []
    for _ in range(100):
        settle(bus, session)
        classes += [m.split()[2] for m in read(session).split(b">") if b"error" in m]
    states = [each for each in classes if each != b"088"]
    assert states == [b"004"]


@pytest.mark.parametrize(
    ("states", "errors"),
    [
        (["passive", "off", "active"], [BusError.CONTROLLER, BusError.BUS_OFF, BusError.RESTARTED]),
        (["passive", "active", "passive"], [BusError.CONTROLLER, None, BusError.CONTROLLER]),
    ],
)
def test_each_state_of_the_controller_has_its_error(
    states: list[ControllerState], errors: list[BusError | None]
) -> None:
    """Back from bus-off is a restart; back from passive is no error."""
    client = an_slcan_client(a_bus())
    assert [client._error_of(Change(0, 1, state)) for state in states] == errors


def test_a_client_that_left_is_off_the_bus() -> None:
    """What it had not sent and not read is forgotten; a new one starts afresh."""
    bus = a_bus()
    client, listener = an_slcan_client(bus), an_slcan_client(bus)
    client.input(b"t2000\r" * 20)
    client.stop()
    assert not client.has_output
    settle(bus, listener, time_ns=500 * MS)
    assert b"t2000" not in read(listener)
    again = an_slcan_client(bus)
    listener.input(b"t3000\r")
    settle(bus, again, listener)
    assert read(again) == b"t3000\r"
    client.stop()


def test_frames_are_as_on_the_bus() -> None:
    """What a client sends is what the record of the bus shows."""
    bus = a_bus()
    client = an_slcan_client(bus)
    client.input(b"T12ABCDEF2AA55\rr7010\r")
    settle(bus, client)
    shown = [passed.frame for passed in bus.transcript if passed.from_host]
    expected = {
        CanFrame(0x12ABCDEF, b"\xaa\x55", is_extended=True),
        CanFrame(0x701, is_remote=True),
    }
    assert set(shown) == expected
