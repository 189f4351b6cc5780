"""The socketcand dialect message by message, against random input, and with python-can."""

import gc

import can
import pytest
from can.interfaces.socketcand.socketcand import convert_ascii_message_to_can_message
from can_clients import frame_of, frames, message, on_tcp
from hypothesis import given
from hypothesis import strategies as st

from axistwin.ports.dialect import BusError, Out
from axistwin.ports.socketcand import (
    HELD_MAX,
    JOB_BACKLOG_FRAMES,
    JOBS_MAX,
    MESSAGE_BYTES_MAX,
    MESSAGES,
    RAW_PAUSE_NS,
    Mode,
    SocketcandSession,
    bcm_line,
    raw_line,
)
from axistwin.wire.can_frame import CanFrame

MS = 1_000_000
SENT = CanFrame(0x601, bytes.fromhex("4000200000000000"))
UNKNOWN = b"< error unknown command >"


def say(session: SocketcandSession, text: str, now_ns: int = 0) -> list[Out]:
    """What comes of ``text``."""
    return session.receive(text.encode(), now_ns)


def in_mode(mode: str) -> SocketcandSession:
    """A session that opened the bus and went to ``mode``."""
    session = SocketcandSession(["vcan0", "can0"])
    assert session.greeting() == b"< hi >"
    assert say(session, f"< open can0 >< {mode} >") == [b"< ok >", b"< ok >"]
    return session


# ---- opening -------------------------------------------------------------------------------------


def test_a_bus_is_opened_by_its_name() -> None:
    """Any of the names; the session is then in BCM mode."""
    for name in ("vcan0", "can0"):
        session = SocketcandSession(["vcan0", "can0"])
        assert say(session, f"< open {name} >") == [b"< ok >"]
        assert session.mode is Mode.BCM


def test_an_unknown_bus_ends_the_conversation() -> None:
    """The answer names the buses there are; nothing is answered after it."""
    session = SocketcandSession(["vcan0", "can0"])
    assert say(session, "< open can7 >< open can0 >") == [
        b"< error could not open bus, this server has vcan0, can0 >"
    ]
    assert session.is_closing
    assert say(session, "< open can0 >") == []
    assert "'can7'" in (session.take_trouble() or "")


def test_nothing_but_open_is_known_before() -> None:
    """Every other word is an error and leaves the session without a bus."""
    session = SocketcandSession(["can0"])
    for word in MESSAGES.keys() - {"open"}:
        assert say(session, f"< {word} >") == [UNKNOWN], word
    assert session.mode is Mode.NO_BUS
    assert session.deliver(SENT, 0) == b""


ALLOWED = {
    "bcmmode": "send sendrtr add update delete subscribe filter muxfilter unsubscribe",
    "rawmode": "send sendrtr",
    "controlmode": "statistics",
}


@pytest.mark.parametrize("mode", ALLOWED)
def test_words_belong_to_modes(mode: str) -> None:
    """A word of another mode is unknown; one of this mode without its arguments is dropped."""
    known = {"rawmode", "bcmmode", "controlmode", "echo", *ALLOWED[mode].split()}
    for word in MESSAGES:
        answered = say(in_mode(mode), f"< {word} >")
        assert (answered == [UNKNOWN]) == (word not in known), word
    assert say(in_mode(mode), "< echo >< isotpmode >") == [b"< echo >", UNKNOWN]


# ---- sending -------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["bcmmode", "rawmode"])
@pytest.mark.parametrize(
    ("text", "frame"),
    [
        ("< send 123 0 >", CanFrame(0x123)),
        ("< send 1AAAAAAA 2 1 F1 >", CanFrame(0x1AAAAAAA, b"\x01\xf1", is_extended=True)),
        ("< send 00000123 1 0a >", CanFrame(0x123, b"\x0a", is_extended=True)),
        ("< sendrtr 123 0 >", CanFrame(0x123, is_remote=True)),
        ("< sendrtr 1AAAAAAA 2 >", CanFrame(0x1AAAAAAA, b"", True, True, 2)),
    ],
)
def test_frames_are_sent(mode: str, text: str, frame: CanFrame) -> None:
    """The examples of the protocol's description, in both modes."""
    assert say(in_mode(mode), text) == [frame]


MALFORMED = """
send 123|send 123 1|send 123 1 1 2|send 123 9 1 2 3 4 5 6 7 8 9|send 800 0|send 20000000 0
send 123456789 0|send 0x12 0|send -12 0|send 123 A|send 123 1 100|send 123 1 +1|send 123 1 1_1
sendrtr 123 9|sendrtr 123|sendrtr 123 0 0|send 123 0 0|send|send xyz 0|open|echo 1|rawmode now
"""


@pytest.mark.parametrize("text", MALFORMED.replace("\n", "|").strip("|").split("|"))
def test_what_does_not_parse_is_dropped_and_told(text: str) -> None:
    """No frame and no answer that python-can could not read, but a line for the operator."""
    session = in_mode("rawmode")
    outs = say(session, f"< {text} >")
    assert outs in ([], [UNKNOWN])
    trouble = session.take_trouble()
    assert outs or (trouble is not None and text[:60] in trouble)
    assert say(session, "< echo >") == [b"< echo >"]


def test_messages_may_come_cut_up_or_joined() -> None:
    """Byte by byte, with garbage and line ends between them."""
    session, text = in_mode("rawmode"), b" \r\nx< send 123 1 AB >garbage<echo>  < echo >"
    outs = [out for i in range(len(text)) for out in session.receive(text[i : i + 1], 0)]
    assert outs == [CanFrame(0x123, b"\xab"), b"< echo >", b"< echo >"]
    assert session.receive(text, 0) == outs


# ---- hearing -------------------------------------------------------------------------------------


def test_raw_mode_tells_of_every_frame() -> None:
    """Data and remote frames with the time in seconds; error frames by their class."""
    session = in_mode("rawmode")
    assert say(session, "< echo >") == [b"< echo >"]
    time_ns = 23_424_242_999
    assert session.deliver(CanFrame(0x123, b"\x11\xaa"), time_ns) == b"< frame 123 23.424242 11AA >"
    assert session.deliver(CanFrame(0x123), time_ns) == b"< frame 123 23.424242  >"
    extended = CanFrame(0x123, b"\x01", is_extended=True)
    assert session.deliver(extended, time_ns) == b"< frame 00000123 23.424242 01 >"
    remote = CanFrame(0x123, b"", False, True, 4)
    assert session.deliver(remote, time_ns) == b"< rtr 123 23.424242 4 >"
    assert session.deliver_error(BusError.NO_ACKNOWLEDGE, time_ns) == b"< error 020 23.424242 >"
    assert say(session, "< bcmmode >") == [b"< ok >"]
    assert session.deliver_error(BusError.NO_ACKNOWLEDGE, time_ns) == b""


def test_the_answer_to_raw_mode_stands_alone() -> None:
    """Reports wait, in order and with their times, for the client's next message or for a while."""
    first, second = CanFrame(0x123), CanFrame(0x124)
    lines = [raw_line(first, 10), raw_line(second, 20)]
    session = in_mode("rawmode")
    assert session.deliver(first, 10) == b""
    assert session.deliver(second, 20) == b""
    assert session.next_event() == RAW_PAUSE_NS
    assert session.wake(RAW_PAUSE_NS - 1) == []
    assert session.wake(RAW_PAUSE_NS) == lines
    assert session.next_event() is None
    assert session.deliver(first, 10) == lines[0]
    session = in_mode("rawmode")
    assert session.deliver(first, 10) == b""
    assert session.deliver_error(BusError.NO_ACKNOWLEDGE, 20) == b""
    assert say(session, "< send 123") == []
    assert say(session, " 0 >") == [lines[0], b"< error 020 0.000000 >", first]


def test_what_waits_for_a_client_of_raw_mode_is_bounded() -> None:
    """A flood of frames ends the pause; nothing is lost."""
    session = in_mode("rawmode")
    told = b"".join(session.deliver(CanFrame(0x123), 0) for _ in range(HELD_MAX + 1))
    assert told == raw_line(CanFrame(0x123), 0) * (HELD_MAX + 1)
    assert session.next_event() is None


@given(frames(), st.integers(0, 10**19))
def test_python_can_reads_every_data_frame(frame: CanFrame, time_ns: int) -> None:
    """What raw mode says is what its parser understands."""
    if frame.is_remote:
        return
    heard = convert_ascii_message_to_can_message(raw_line(frame, time_ns).decode())
    assert frame_of(heard) == frame
    assert heard.timestamp == pytest.approx(time_ns / 1e9, abs=1e-5)


@given(frames())
def test_any_frame_can_be_sent(frame: CanFrame) -> None:
    """A frame in the daemon's words comes out as it went in."""
    identifier = str(frame).partition("#")[0]
    text = f"< sendrtr {identifier} {frame.length} >"
    if not frame.is_remote:
        text = f"< send {identifier} {frame.length} {frame.data.hex(' ')} >"
    assert say(in_mode("rawmode"), text) == [frame]


def test_bcm_mode_tells_of_what_was_subscribed() -> None:
    """By identifier and kind; remote frames are not told; unsubscribing ends it."""
    session = in_mode("bcmmode")
    assert session.deliver(SENT, 0) == b""
    assert say(session, "< subscribe 0 0 601 >") == []
    expected = b"< frame 601 0.000000 40 00 20 00 00 00 00 00  >"
    assert session.deliver(SENT, 0) == bcm_line(SENT, 0) == expected
    assert session.deliver(CanFrame(0x601, is_remote=True), 0) == b""
    assert session.deliver(CanFrame(0x601, SENT.data, is_extended=True), 0) == b""
    assert session.deliver(CanFrame(0x602), 0) == b""
    say(session, "< unsubscribe 601 >")
    assert session.deliver(SENT, 0) == b""


def test_a_filter_tells_of_changes_under_its_mask() -> None:
    """The first frame, then those in which a masked bit differs from the one told last."""
    session = in_mode("bcmmode")
    say(session, "< filter 0 0 123 2 F0 01 >")
    contents = [b"\x10\x00", b"\x1f\x02", b"\x20\x00", b"\x20\x01\xff", b"\x2f", b"\x2e"]
    told = [bool(session.deliver(CanFrame(0x123, content), 0)) for content in contents]
    assert told == [True, False, True, True, True, False]


def test_a_mux_filter_tells_of_changes_per_value() -> None:
    """Values it does not name are not told; each named one has a mask and a memory of its own."""
    session = in_mode("bcmmode")
    groups = "FF 00 00 00 00 00 00 00 33 FF 00 00 00 00 00 00 56 00 FF 00 00 00 00 00"
    assert say(session, f"< muxfilter 0 0 123 3 {groups} >") == []
    told = [
        (b"\x33\x01\x01", True),
        (b"\x56\x01\x01", True),
        (b"\x33\x01\x02", False),
        (b"\x56\x02\x01", False),
        (b"\x33\x02\x02", True),
        (b"\x56\x02\x02", True),
        (b"\x44\x00\x00", False),
    ]
    for content, expected in told:
        assert bool(session.deliver(CanFrame(0x123, content), 0)) == expected, content
    assert session.take_trouble() is None
    say(session, "< muxfilter 0 0 123 1 FF 00 00 00 00 00 00 00 >")
    assert session.take_trouble() is not None


def test_a_throttled_subscription_tells_the_latest_at_its_beat() -> None:
    """What comes too early waits; only the last of it is told, when the time is over."""
    session = in_mode("bcmmode")
    say(session, "< subscribe 0 10000 123 >")
    one, two, three, four = (CanFrame(0x123, bytes([i])) for i in range(4))
    assert session.deliver(one, 0) == bcm_line(one, 0)
    assert session.next_event() is None
    assert session.deliver(two, 4 * MS) == b""
    assert session.deliver(three, 6 * MS) == b""
    assert session.next_event() == 10 * MS
    assert session.wake(10 * MS - 1) == []
    assert session.wake(10 * MS) == [bcm_line(three, 6 * MS)]
    assert session.next_event() is None
    assert session.deliver(four, 20 * MS) == bcm_line(four, 20 * MS)


# ---- jobs ----------------------------------------------------------------------------------------


def test_a_job_sends_at_once_and_at_its_beat() -> None:
    """An update changes what is sent and not when; deleting ends it."""
    session = in_mode("bcmmode")
    old, new = CanFrame(0x123, b"\x42"), CanFrame(0x123, b"\x11\x22")
    assert say(session, "< add 0 20000 123 1 42 >", 5 * MS) == [old]
    assert session.next_event() == 25 * MS
    assert session.wake(25 * MS - 1) == []
    assert session.wake(25 * MS) == [old]
    assert say(session, "< update 123 2 11 22 >", 30 * MS) == []
    assert session.wake(45 * MS) == [new]
    assert say(session, "< delete 00000123 >< delete 124 >") == []
    assert session.next_event() == 65 * MS
    assert say(session, "< delete 123 >") == []
    assert session.next_event() is None


def test_a_late_job_keeps_its_beat() -> None:
    """What was missed is not made up for."""
    session = in_mode("bcmmode")
    say(session, "< add 1 0 123 0 >")
    assert session.wake(3_500 * MS) == [CanFrame(0x123)]
    assert session.next_event() == 4_000 * MS


def test_jobs_do_not_flood_a_bus_that_is_behind() -> None:
    """They skip while too much waits, and go on when frames have been sent."""
    session = in_mode("bcmmode")
    assert say(session, "< add 0 10 123 0 >") == [CanFrame(0x123)]
    sent = [session.wake(i * MS) for i in range(1, 100)]
    assert sum(map(len, sent)) == JOB_BACKLOG_FRAMES - 1
    session.sent()
    assert session.wake(100 * MS) == [CanFrame(0x123)]
    assert session.wake(101 * MS) == []


def test_a_job_without_interval_sends_once() -> None:
    """And has no timer."""
    session = in_mode("bcmmode")
    assert say(session, "< add 0 0 123 0 >") == [CanFrame(0x123)]
    assert session.next_event() is None


def test_leaving_the_mode_ends_jobs_and_subscriptions() -> None:
    """As the daemon closes its socket; staying in the mode ends nothing."""
    session = in_mode("bcmmode")
    say(session, "< add 1 0 123 0 >< subscribe 0 0 601 >< bcmmode >")
    assert session.next_event() is not None
    assert say(session, "< rawmode >< bcmmode >") == [b"< ok >", b"< ok >"]
    assert session.next_event() is None
    assert session.deliver(SENT, 0) == b""


def test_jobs_and_subscriptions_are_bounded() -> None:
    """One more than fit is not taken, and the operator learns it; those that are there stay."""
    session = in_mode("bcmmode")
    for i in range(JOBS_MAX):
        say(session, f"< add 0 0 {i:03X} 0 >< subscribe 0 0 {i:03X} >")
    assert session.take_trouble() is None
    for text in ("< add 0 0 7FF 0 >", "< subscribe 0 0 7FF >"):
        assert say(session, text) == []
        assert f"{JOBS_MAX}" in (session.take_trouble() or "")
    assert session.deliver(CanFrame(0x7FF), 0) == b""
    assert session.deliver(CanFrame(0), 0)
    assert say(session, "< add 0 0 000 1 FF >") == [CanFrame(0, b"\xff")]


def test_statistics_come_at_their_interval() -> None:
    """Bytes and frames each way, until switched off or the mode is left."""
    session = in_mode("rawmode")
    say(session, "< send 123 2 1 2 >< sendrtr 123 8 >")
    session.deliver(SENT, 0)
    say(session, "< controlmode >< statistics 100 >", 50 * MS)
    assert session.next_event() == 150 * MS
    assert session.wake(150 * MS) == [b"< stat 8 1 2 2 >"]
    assert session.next_event() == 250 * MS
    say(session, "< statistics 0 >")
    assert session.next_event() is None
    say(session, "< statistics 100 >< bcmmode >")
    assert session.next_event() is None


# ---- garbage -------------------------------------------------------------------------------------

arguments = st.lists(
    st.sampled_from(["0", "1", "8", "123", "FF", "00000601", "7FFFFFFF", "99999999999", "x", ""]),
    max_size=12,
)
garbage = st.lists(
    st.binary(max_size=30)
    | st.builds(
        lambda word, rest: f"< {word} {' '.join(rest)} >".encode(),
        st.sampled_from([*MESSAGES, "isotpmode"]),
        arguments,
    )
)


@given(garbage, frames())
def test_garbage_is_harmless(pieces: list[bytes], frame: CanFrame) -> None:
    """Nothing raises, nothing grows, the next event lies ahead, and the session goes on."""
    session = SocketcandSession(["can0"])
    say(session, "< open can0 >")
    for now_ns, piece in enumerate(pieces):
        session.receive(piece, now_ns)
        session.deliver(frame, now_ns)
        session.wake(now_ns)
        due_ns = session.next_event()
        assert due_ns is None or due_ns > now_ns
        assert len(session._unparsed) <= MESSAGE_BYTES_MAX + 1
    assert say(session, ">< bcmmode >< rawmode >< send 601 0 >")[-2:] == [
        b"< ok >",
        CanFrame(0x601),
    ]


def test_a_message_without_end_takes_no_memory() -> None:
    """Megabytes leave one message's worth behind; it is dropped when it ends."""
    session = in_mode("rawmode")
    session.receive(b"<", 0)
    for _ in range(50):
        assert session.receive(b" echo" * 10_000, 0) == []
    assert len(session._unparsed) == MESSAGE_BYTES_MAX + 1
    assert say(session, ">< echo >") == [b"< echo >"]
    assert session.receive(b"x" * 1_000_000, 0) == []
    assert session._unparsed == b""


# ---- python-can ----------------------------------------------------------------------------------


def daemon_bus(port: int) -> can.BusABC:
    """python-can's client of the server at ``port``."""
    return can.Bus(interface="socketcand", channel="vcan0", host="127.0.0.1", port=port)


@pytest.mark.system
def test_python_can_converses() -> None:
    """Its client sends and receives data frames of both kinds, in order."""
    conversation = [
        SENT,
        CanFrame(0x123),
        CanFrame(0x12ABCDEF, b"\x01\x02", is_extended=True),
        *(CanFrame(i, i.to_bytes(8, "big")) for i in range(200)),
    ]
    with on_tcp(SocketcandSession(["vcan0"])) as (served, port), daemon_bus(port) as bus:
        for frame in conversation:
            bus.send(message(frame))
        assert [served[0].next_frame() for _ in conversation] == conversation
        for frame in conversation:
            served[0].deliver(frame, 1_500_000_000)
        received = [bus.recv(5) for _ in conversation]
        assert [frame_of(one) for one in received] == conversation
        assert {one.timestamp for one in received if one} == {1.5}


@pytest.mark.system
def test_python_can_drops_the_remote_flag() -> None:
    """An empty remote frame arrives as a data frame, a longer one not at all, and it is told."""
    session = SocketcandSession(["vcan0"])
    with on_tcp(session) as (served, port), daemon_bus(port) as bus:
        bus.send(message(CanFrame(0x701, is_remote=True)))
        assert served[0].next_frame() == CanFrame(0x701)
        bus.send(message(CanFrame(0x701, b"", False, True, 1)))
        bus.send(message(SENT))
        assert served[0].next_frame() == SENT
        served[0].deliver(CanFrame(0x701, is_remote=True))
        served[0].deliver(SENT)
        assert frame_of(bus.recv(5)) == SENT
    assert "use slcan" in (session.take_trouble() or "")


@pytest.mark.system
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_python_can_learns_the_names_of_the_buses() -> None:
    """Opening another one fails with them in its error."""
    with on_tcp(SocketcandSession(["mac23-can"])) as (_, port):
        try:
            daemon_bus(port)
        except can.CanError as error:
            shown = str(error)
        gc.collect()  # python-can does not close its socket: that warning belongs to this test
    assert "this server has mac23-can" in shown
