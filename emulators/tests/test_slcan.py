"""The slcan dialect line by line, against random input, and with python-can at the other end."""

import itertools
import os
import subprocess
import sys
from pathlib import Path

import pytest
from can.interfaces.slcan import slcanBus
from can_clients import frame_of, frames, message, on_pty, on_tcp
from hypothesis import given
from hypothesis import strategies as st

from axistwin.ports.dialect import BusError, Out
from axistwin.ports.slcan import (
    LINE_BYTES_MAX,
    RECEIVE_QUEUE_FRAMES,
    Channel,
    Settings,
    SlcanPort,
    StatusFlags,
    accepts,
    frame_line,
    parse_frame,
)
from axistwin.wire.can_frame import CanFrame

pytestmark = pytest.mark.system

SENT = CanFrame(0x601, bytes.fromhex("4000200000000000"))
SENT_LINE = b"t60184000200000000000"
ALL_LETTERS = [bytes([letter]) for letter in range(33, 127)]


def say(port: SlcanPort, text: str) -> list[Out]:
    """What comes of ``text``; ``|`` stands for CR."""
    return port.receive(text.replace("|", "\r").encode(), 0)


def opened(before: str = "", bitrate: int | None = 125_000, queue: int = 99) -> SlcanPort:
    """A port that performed ``before`` and was opened; every command was taken."""
    port = SlcanPort(bitrate, transmit_queue_frames=queue)
    assert set(say(port, before + "O|")) == {b"\r"}
    return port


# ---- lines ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        (b"t1230", CanFrame(0x123)),
        (b"t4563112233", CanFrame(0x456, b"\x11\x22\x33")),
        (b"T12ABCDEF2AA55", CanFrame(0x12ABCDEF, b"\xaa\x55", is_extended=True)),
        (b"r1230", CanFrame(0x123, is_remote=True)),
        (b"R000000178", CanFrame(0x17, b"", True, True, 8)),
    ],
)
def test_lines_are_those_of_the_kernel_s_driver(line: bytes, frame: CanFrame) -> None:
    """The examples of Linux's driver, and one more."""
    assert frame_line(frame) == line
    assert parse_frame(line) == frame


@given(frames())
def test_any_frame_survives_being_a_line(frame: CanFrame) -> None:
    """What is written is read back, and no line is longer than allowed."""
    line = frame_line(frame)
    assert parse_frame(line) == frame
    assert parse_frame(line[:1] + line[1:].lower()) == frame
    assert len(line) <= LINE_BYTES_MAX


MALFORMED = """
t t12 t123 t8000 t1239 t12300 t1231 t12311 t123111_ t12.0 t1_30 r12311111 T1234567 T200000000
T123456789 t-120 t+120 tXYZ0 t123B1 t0x10 t1232112 T12ABCDEF2AA5566
"""


@pytest.mark.parametrize("line", [*MALFORMED.split(), "t123111 ", "t12 0"])
def test_a_malformed_frame_is_refused(line: str) -> None:
    """Every way of being wrong is answered BEL, and no frame goes out."""
    assert say(opened(), line + "|") == [b"\a"]


# ---- the channel ---------------------------------------------------------------------------------


def test_frames_are_sent_in_the_open_state_only() -> None:
    """Closed and listen-only ports refuse each kind of frame, an open one answers z or Z."""
    lines = ["t1230|", "T000001230|", "r1230|", "R000001230|"]
    for port in (SlcanPort(125_000), SlcanPort(125_000)):
        assert [say(port, line) for line in lines] == [[b"\a"]] * 4
        say(port, "L|")
    port = opened()
    answers = [say(port, line) for line in lines]
    assert [answer[1] for answer in answers] == [b"z\r", b"Z\r", b"z\r", b"Z\r"]
    assert all(isinstance(answer[0], CanFrame) for answer in answers)


def test_open_listen_and_close_change_the_state_once() -> None:
    """What is open is not opened, what is closed is not closed."""
    port = SlcanPort(125_000)
    done, refused = b"\r", b"\a"
    expected = [refused, done, refused, refused, done, done, refused, done, refused]
    assert say(port, "C|O|O|L|C|L|O|C|C|") == expected
    assert port.channel is Channel.CLOSED


@pytest.mark.parametrize(
    "command", ["S6", "s031C", "X0", "Z1", "W1", "M12345678", "m12345678", "U1"]
)
def test_settings_belong_to_the_closed_state(command: str) -> None:
    """They are taken while closed and refused while open, where they change nothing."""
    port = SlcanPort(None)
    assert say(port, f"{command}|") == [b"\r"]
    port = SlcanPort(None)
    say(port, "O|")
    assert say(port, f"{command}|") == [b"\a"]
    assert port.settings == Settings()


def test_frames_are_heard_while_open() -> None:
    """A closed port delivers nothing, a listening one as much as an open one."""
    port = SlcanPort(125_000)
    assert port.deliver(SENT, 0) == b""
    for opening in ("O|", "C|L|"):
        say(port, opening)
        assert port.deliver(SENT, 0) == SENT_LINE + b"\r"
    say(port, "C|")
    assert port.deliver(SENT, 0) == b""


def test_versions_and_number_are_always_told() -> None:
    """Open or closed."""
    port = SlcanPort(125_000, serial_number="AB12")
    expected: list[Out] = [b"V1013\r", b"v1013\r", b"NAB12\r"]
    assert say(port, "V|v|N|") == expected
    say(port, "O|")
    assert say(port, "V|v|N|") == expected


def test_unknown_and_overlong_lines_are_refused() -> None:
    """Each is answered BEL once, FD frames among them; empty ones and LF are passed over."""
    port = opened()
    for line in ("d1230", "B000001230", "Y2", "?", "Vx", "O1", "t" * 27, "t1230" + "0" * 500):
        assert say(port, line + "|") == [b"\a"], line
    assert say(port, "||\n|V\r\n".replace("|", "\r")) == [b"V1013\r"]


def test_lines_may_come_in_pieces() -> None:
    """Byte by byte or all at once is the same."""
    port, text = opened(), SENT_LINE + b"\rV\r"
    pieces = [port.receive(text[i : i + 1], 0) for i in range(len(text))]
    assert list(itertools.chain(*pieces)) == [SENT, b"z\r", b"V1013\r"]


# ---- rates ---------------------------------------------------------------------------------------


RATES = """
S0 10000 S1 20000 S2 50000 S3 100000 S4 125000 S5 250000 S6 500000 S7 800000 S7 750000 S8 1000000
S9 83300 s031C 125000 s001C 500000 s0014 1000000
"""


@pytest.mark.parametrize(
    ("command", "rate"), list(zip(RATES.split()[::2], RATES.split()[1::2], strict=True))
)
def test_the_right_rate_is_known_by_number_and_by_registers(command: str, rate: str) -> None:
    """With it frames pass; at another bus rate the same command makes the port deaf."""
    bitrate = int(rate)
    port = opened(f"{command}|", bitrate)
    assert port.deliver(SENT, 0)
    assert port.take_trouble() is None
    assert opened(f"{command}|", bitrate * 2).deliver(SENT, 0) == b""


def test_a_wrong_rate_is_noticed_by_everybody() -> None:
    """Nothing passes either way, the flags tell the client and one line tells the operator."""
    port = opened("S5|", queue=2)
    assert port.deliver(SENT, 0) == b""
    assert say(port, "F|F|") == [b"FA4\r", b"F00\r"]
    assert say(port, "t1230|t1230|t1230|") == [b"z\r", b"z\r", b"\a"]
    assert say(port, "F|") == [b"FA6\r"]
    trouble = port.take_trouble()
    assert trouble is not None
    assert "250000" in trouble
    assert "bitrate=125000" in trouble
    assert port.take_trouble() is None
    assert say(port, "C|S4|O|t1230|") == [*[b"\r"] * 3, CanFrame(0x123), b"z\r"]


def test_errors_on_the_bus_are_flagged() -> None:
    """Until the flags are read; a closed adapter sees none."""
    port = SlcanPort(125_000)
    assert port.deliver_error(BusError.BUS_OFF, 0) == b""
    say(port, "O|")
    assert say(port, "F|") == [b"F00\r"]
    assert port.deliver_error(BusError.PROTOCOL | BusError.NO_ACKNOWLEDGE, 0) == b""
    assert say(port, "F|F|") == [b"F80\r", b"F00\r"]
    port.deliver_error(BusError.CONTROLLER, 0)
    assert say(port, "F|") == [b"F24\r"]
    port.deliver_error(BusError.BUS_OFF, 0)
    assert say(port, "F|") == [b"FA4\r"]


def test_a_bus_without_rate_takes_any() -> None:
    """Where frames take no time there is no wrong rate."""
    assert opened("S0|", None).deliver(SENT, 0) == SENT_LINE + b"\r"


# ---- queues and polling --------------------------------------------------------------------------


def test_a_full_transmit_queue_refuses_until_a_frame_was_sent() -> None:
    """The frame is refused with BEL and the flag is set; one that leaves makes room."""
    port = opened(queue=2)
    assert say(port, "t1230|t1240|t1250|")[4:] == [b"\a"]
    assert port.flags == StatusFlags.TRANSMIT_QUEUE_FULL
    port.sent()
    assert say(port, "t1250|F|") == [CanFrame(0x125), b"z\r", b"F02\r"]


def test_polling_takes_frames_one_by_one_or_all() -> None:
    """Frames wait in their order; an empty queue answers CR or A; transmissions answer CR."""
    port = opened("X0|")
    for identifier in (1, 2, 3):
        assert port.deliver(CanFrame(identifier), 0) == b""
    assert say(port, "P|A|P|A|") == [b"t0010\r", b"t0020\rt0030\rA\r", b"\r", b"A\r"]
    assert say(port, "t1230|") == [CanFrame(0x123), b"\r"]


def test_polling_is_refused_while_frames_come_by_themselves() -> None:
    """P and A belong to X0."""
    assert say(opened(), "P|A|") == [b"\a", b"\a"]


def test_what_nobody_polls_is_lost_at_the_end_of_the_queue() -> None:
    """The oldest frames stay, the loss is flagged, and closing forgets them."""
    port = opened("X0|")
    for identifier in range(RECEIVE_QUEUE_FRAMES + 1):
        port.deliver(CanFrame(identifier), 0)
    assert say(port, "F|P|") == [b"F09\r", b"t0000\r"]
    assert say(port, "C|O|A|") == [b"\r", b"\r", b"A\r"]


@pytest.mark.parametrize(
    ("time_ms", "shown"), [(0, b"0000"), (1, b"0001"), (59_999, b"EA5F"), (60_000, b"0000")]
)
def test_time_stands_behind_the_frame(time_ms: int, shown: bytes) -> None:
    """In milliseconds of the minute, behind the data or the length."""
    port = opened("Z1|")
    time_ns = time_ms * 1_000_000 + 999_999
    assert port.deliver(SENT, time_ns) == SENT_LINE + shown + b"\r"
    assert port.deliver(CanFrame(1, is_remote=True), time_ns) == b"r0010" + shown + b"\r"


def test_settings_outlive_the_adapter() -> None:
    """Q makes the next life begin open, with rate, filter and polling as they were set."""
    port = opened("S4|X0|M12345678|")
    assert say(port, "Q2|") == [b"\r"]
    again = SlcanPort(125_000, settings=port.settings)
    assert again.channel is Channel.LISTEN_ONLY
    assert again.settings.bitrates == (125_000,)
    assert not again.settings.auto_poll
    assert again.settings.acceptance_code == 0x12345678
    assert say(again, "Q0|") == [b"\r"]
    assert SlcanPort(125_000, settings=again.settings).channel is Channel.CLOSED


# ---- the acceptance filter -----------------------------------------------------------------------


def sja1000_accepts(settings: Settings, frame: CanFrame) -> bool:
    """The data sheet's tables, bit by bit: which bits of the frame face which bits of the code."""
    width = 29 if frame.is_extended else 11
    bits = [str(frame.identifier >> (width - 1 - i) & 1) for i in range(width)]
    remote = str(int(frame.is_remote))
    data = [f"{byte:08b}" for byte in frame.data]
    if settings.single_filter and frame.is_extended:
        rows = ["".join(bits) + remote + "--"]
    elif settings.single_filter:
        first, second = [*data, "-" * 8, "-" * 8][:2]
        rows = ["".join(bits) + remote + "----" + first + second]
    elif frame.is_extended:
        rows = ["".join(bits[:16]) + "-" * 16, "-" * 16 + "".join(bits[:16])]
    else:
        byte = data[0] if data else "-" * 8
        head = "".join(bits) + remote
        rows = [head + byte[:4] + "-" * 12 + byte[4:], "-" * 16 + head + "----"]
    code = f"{settings.acceptance_code:032b}"
    mask = f"{settings.acceptance_mask:032b}"
    return any(
        all(m == "1" or r in ("-", c) for r, c, m in zip(row, code, mask, strict=True))
        for row in rows
    )


words = st.integers(0, 0xFFFFFFFF)
sparse = st.lists(st.integers(0, 31), max_size=3).map(
    lambda bits: 0xFFFFFFFF & ~sum(1 << bit for bit in set(bits))
)


@given(frames(), words, words | sparse, st.booleans())
def test_the_filter_is_the_sja1000_s(frame: CanFrame, code: int, mask: int, single: bool) -> None:
    """Against the data sheet's own picture of code and frame."""
    settings = Settings(acceptance_code=code, acceptance_mask=mask, single_filter=single)
    assert accepts(settings, frame) == sja1000_accepts(settings, frame)


def test_the_filter_is_set_by_the_client_and_applied() -> None:
    """One node's boot-up and emergencies pass, another's do not; the delivered filter is open."""
    port = opened("W1|M10200000|m001FFFFF|")  # 081h
    assert port.deliver(CanFrame(0x081, bytes(8)), 0)
    assert port.deliver(CanFrame(0x082, bytes(8)), 0) == b""
    assert opened().deliver(CanFrame(0x082, bytes(8)), 0)


# ---- garbage -------------------------------------------------------------------------------------

garbage = st.lists(
    st.binary(max_size=40)
    | st.sampled_from([*ALL_LETTERS, b"\r", b"O\r", b"C\r", b"S4\r", SENT_LINE + b"\r", b"X0\r"])
    | st.builds(
        lambda letter, rest: letter + rest + b"\r", st.sampled_from(ALL_LETTERS), st.binary()
    )
)


@given(garbage, frames())
def test_garbage_is_harmless(pieces: list[bytes], frame: CanFrame) -> None:
    """Nothing raises, nothing grows, and afterwards a client that starts anew is served."""
    port = SlcanPort(125_000, transmit_queue_frames=4)
    for piece in pieces:
        outs = port.receive(piece, 0)
        port.deliver(frame, 0)
        assert all(isinstance(out, CanFrame) or out[-1:] in (b"\r", b"\a") for out in outs)
        for out in outs:
            if isinstance(out, CanFrame):
                port.sent()
        assert len(port._line) <= LINE_BYTES_MAX + 1
        assert len(port._received) <= RECEIVE_QUEUE_FRAMES
    say(port, "|C|S4|X1|O|")
    assert port.receive(SENT_LINE + b"\r", 0) == [SENT, b"z\r"]


def test_a_line_without_end_takes_no_memory() -> None:
    """Megabytes without CR leave a line's worth behind, and the next command works."""
    port = SlcanPort(125_000)
    for _ in range(100):
        assert port.receive(b"x" * 65_536, 0) == []
    assert len(port._line) == LINE_BYTES_MAX + 1
    assert say(port, "|V|") == [b"\a", b"V1013\r"]


# ---- python-can ----------------------------------------------------------------------------------

CONVERSATION = [
    SENT,
    CanFrame(0x123),
    CanFrame(0x12ABCDEF, b"\x01\x02", is_extended=True),
    CanFrame(0x701, is_remote=True),
    CanFrame(0x701, b"", False, True, 8),
    CanFrame(0x1FFFFFFF, b"", True, True, 3),
]


@pytest.mark.parametrize("carrier", ["pty", "tcp"])
def test_python_can_converses(carrier: str) -> None:
    """Its slcan client sends and receives every kind of frame, through a pty and through TCP."""
    port = SlcanPort(125_000)
    with on_pty(port) if carrier == "pty" else on_tcp(port) as (server, place):
        channel = place if isinstance(place, str) else f"socket://127.0.0.1:{place}"
        with slcanBus(channel, bitrate=125_000, sleep_after_open=0) as bus:
            for frame in CONVERSATION:
                bus.send(message(frame))
            served = server[0] if isinstance(server, list) else server
            assert [served.next_frame() for _ in CONVERSATION] == CONVERSATION
            for frame in CONVERSATION:
                served.deliver(frame)
            assert [frame_of(bus.recv(5)) for _ in CONVERSATION] == CONVERSATION
            assert bus.get_version(5) == (10, 13)
            assert bus.get_serial_number(5) == "AT01"


def test_python_can_without_a_rate_gets_that_of_the_bus() -> None:
    """It only opens; that is enough."""
    with (
        on_pty(SlcanPort(125_000)) as (served, path),
        slcanBus(path, sleep_after_open=0) as bus,
    ):
        bus.send(message(SENT))
        assert served.next_frame() == SENT


def test_python_can_with_the_wrong_rate_is_told_apart() -> None:
    """It hears nothing, sends nothing, and whoever runs the bus learns why."""
    port = SlcanPort(125_000)
    with (
        on_pty(port) as (served, path),
        slcanBus(path, bitrate=500_000, sleep_after_open=0) as bus,
    ):
        bus.send(message(SENT))
        assert bus.get_version(5) == (10, 13)  # so the frame has been looked at
        served.deliver(SENT)
        assert bus.recv(0.05) is None
        assert served.frames.empty()
    assert "bitrate=125000" in (port.take_trouble() or "")


def test_python_can_loses_nothing_of_a_burst() -> None:
    """Three hundred frames each way, in their order."""
    burst = [CanFrame(i & 0x7FF, i.to_bytes(8, "big")) for i in range(300)]
    with (
        on_pty(SlcanPort(1_000_000)) as (served, path),
        slcanBus(path, bitrate=1_000_000, sleep_after_open=0) as bus,
    ):
        for frame in burst:
            bus.send(message(frame))
        assert [served.next_frame() for _ in burst] == burst
        for frame in burst:
            served.deliver(frame)
        assert [frame_of(bus.recv(5)) for _ in burst] == burst


def test_slcand_s_lines_are_taken() -> None:
    """Close, rate, flags and open as can-utils' slcand sends them leave the channel open."""
    port = SlcanPort(500_000)
    assert say(port, "C|S6|F|O|") == [b"\a", b"\r", b"\a", b"\r"]
    assert port.channel is Channel.NORMAL


@pytest.mark.skipif("AXISTWIN_VM" in os.environ, reason="inside the virtual machine")
def test_a_kernel_converses() -> None:
    """Linux's slcan driver, attached by slcand, makes a CAN interface of it that loses nothing."""
    support = Path(__file__).with_name("support")
    program = [sys.executable, str(support / "slcan_kernel.py")]
    machine = [sys.executable, str(support.parents[2] / "scripts" / "vm.py"), "--timeout", "60"]
    done = subprocess.run([*machine, *program], capture_output=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr.decode()
    assert done.stdout.endswith(b"conversed\n")
