"""``axistwin send``: the counterpart of ``axistwin decode``."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from axistwin import catalog, testing
from axistwin.cli.program import main
from axistwin.devices.mac.phrases import parse_phrase
from axistwin.devices.mac.serial.framing import request
from axistwin.devices.msc.packets import packet
from axistwin.errors import UsageError
from axistwin.wire.can_frame import CanFrame

VIRTUAL = "axistwin://mac23?time=virtual"


def invoke(*arguments: str) -> Result:
    """Run the program in this process."""
    return CliRunner().invoke(main, ("send", *arguments))


def rows(*arguments: str) -> list[str]:
    """What it prints; it must not fail."""
    result = invoke(*arguments)
    assert result.exit_code == 0, result.output
    return result.output.splitlines()


# ---- words to bytes and back ---------------------------------------------------------------------


def requests() -> Iterator[tuple[str, object]]:
    """Requests of every command and query: the model and the bytes or the frame."""
    values = (0, 1, 8, 9, 0x7D, 0x1234, 0x0A1234, 0xF61234, 0xFFF60123, 0x80000000, 0xFFFFFFFF)
    for index, value, address in itertools.product(range(0x2A), values, (0, 5, 0xFF)):
        yield "mac23", request(address, index, value if index < 0x20 else 0)
    for sub_index in (0, 0x10, 0xFF):
        yield "mac23", request(3, 0x28, 0, sub_index)
    for index, value, address in itertools.product(range(0x1F), values, (0, 5)):
        data = bytes((0x23, index, 0x20, 0)) + value.to_bytes(4, "big")
        yield "mac23-can", CanFrame(0x600 + address, data)
    for index in range(8):
        yield "mac23-can", CanFrame(0x601, bytes((0x40, index, 0x20, 0, 0, 0, 0, 0)))
    for name, count in {"SFLAG": 0, "CFLAG": 0, "RFLAG": 0, "DREAD": 0, "DWRITE": 1}.items():
        for number, value in ((0, 0), (1, -5), (200, 7), (2008, -(2**31))):
            tail = value.to_bytes(4, "big", signed=True) * count
            yield "msc-250", packet(2, name.encode() + b"," + number.to_bytes(2, "big") + tail)
    for name in ("RFLAGS,", "RQSTAT,"):
        yield "msc-250", packet(15, name.encode())


def test_what_decode_tells_send_understands() -> None:
    """Of every command and query: the words give a request that is told with the same words."""
    count = 0
    for name, content in requests():
        model = catalog.find_model(name)
        words = model.explain(content)  # type: ignore[arg-type]
        if "unassigned" in words:
            continue
        count += 1
        again = model.family.compose(words, 1)
        assert model.explain(again) == words
    assert count > 800


@pytest.mark.parametrize(
    ("text", "index", "parameters"),
    [
        ("go to 125", 0x13, 125),
        ("Go To Position -5", 0x13, 0xFFFFFFFB),
        ("20h", 0x20, 0),
        ("13h 7Dh", 0x13, 125),
        ("13h 0x7D", 0x13, 125),
        ("position", 0x20, 0),
        ("status?", 0x21, 0),
        ("stop", 0x17, 0),
        ("torque 50h", 0x0C, 0x50),
        ("velocity -, period 1000", 0x15, 0xF603E8),
        ("segment -10 steps at period 500", 0x16, 0xFFF601F4),
        ("catch-up 3", 0x0E, 0x300),
        ("2000h position?", 0x20, 0),
    ],
)
def test_shorter_words_do(text: str, index: int, parameters: int) -> None:
    """As a person types them."""
    assert parse_phrase(text)[:2] == (index, parameters)


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("gu to 5", "did you mean"),
        ("xyzzy", "write words such as 'go to 125'"),
        ("14h go to 5", "write words such as|did you mean"),
        ("go to 99999999999", "the parameter has 32 bits"),
        ("", "write words such as"),
    ],
)
def test_what_is_no_command_says_the_remedy(text: str, remedy: str) -> None:
    """One line."""
    with pytest.raises(UsageError, match=remedy):
        parse_phrase(text)


# ---- the command ---------------------------------------------------------------------------------


def test_a_module_on_a_line_is_asked_in_words_an_index_and_bytes() -> None:
    """The checksum is added where it lacks; what is there goes as it is."""
    frame = request(0, 0x20).hex(" ")
    told = rows(VIRTUAL, "go to 0", "20h", frame, frame[:-9], "      7.25 ms > " + frame + "  20h")
    assert told[:2] == [
        f"> {request(0, 0x13).hex(' ').upper()}  13h go to position 0 -> module 0",
        "< 06 13 1A  accepted",
    ]
    assert [row.partition("  ")[2] for row in told[2:]] == [
        "20h position? -> module 0",
        "20h position = 0 (module 0)",
    ] * 4


def test_wrong_bytes_are_sent_too() -> None:
    """Which is what a failure wants reproduced."""
    wrong = request(0, 0x20)[:-3].hex() + "303003"
    assert rows(VIRTUAL, wrong)[1] == "< 15  Nack"


def test_a_controller_is_asked_and_its_reply_acknowledged() -> None:
    """Without, it would repeat the reply, and the next command would not be heard."""
    told = rows(
        "axistwin://msc-250?time=virtual", "DWRITE 2008 -5", "DREAD 2008", "RQSTAT", "RFLAGS"
    )
    assert [row.partition("  ")[2] for row in told] == [
        "DWRITE at 2008: -5 (unit 1)",
        "ACK",
        "DREAD at 2008? (unit 1)",
        "ACK; DREAD = -5 (unit 1)",
        "RQSTAT (unit 1)",
        "ACK; RQSTAT = 0 (unit 1)",
        "RFLAGS (unit 1)",
        "ACK; RFLAGS = on: none (unit 1)",
    ]


def test_a_board_is_asked() -> None:
    """As its programs write it, in words, or by its bytes, the sum of which is added."""
    told = rows("axistwin://mn400?time=virtual", "M100", "wait 500 ms", "ReadPosition", "81 2A 81")
    assert [row.partition("  ")[2] for row in told] == [
        "Mover 100 (board 1)",
        "Mover: START (board 1); Mover: DONE (board 1)",
        "",  # the pause
        "ReadPosition (board 1)",
        "ReadPosition: START (board 1); ReadPosition = 100,0,0,0 (board 1)",
        "PollDevices (board 1)",
        "PollDevices: START (board 1); PollDevices: PRESENT (board 1)",
    ]


def test_a_module_on_a_bus_is_asked() -> None:
    """In words, or with a frame as cansend has it; lifebeats are no replies."""
    told = rows("axistwin:mac23-can:3?time=virtual", "status?", "stop", "603#4000200000000000")
    assert [row.partition("  ")[2] for row in told] == [
        "2001h status? -> module 3",
        "2001h status = 00 00 00 00 (module 3)",
        "2017h stop with ramp -> module 3",
        "2017h accepted (module 3)",
        "2000h position? -> module 3",
        "2000h position = 0 (module 3)",
    ]


def test_a_device_that_is_silent_is_told() -> None:
    """By the exit status too; what was said before is printed."""
    result = invoke(VIRTUAL, "20h", "20h -> module 5", "--timeout", "0.25")
    assert result.exit_code == 1
    assert result.output.splitlines()[-1] == "< nothing within 0.25 s"


def test_the_address_is_the_urls_or_given() -> None:
    """Else the model's own."""
    assert "module 7" in rows("axistwin://mac23:7?time=virtual", "20h")[1]
    assert invoke(VIRTUAL, "20h", "--address", "9", "--timeout", "0.1").exit_code == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("/dev/null", "20h"), "which device is there? add --model MODEL"),
        (("/dev/null", "20h"), "of an slcan adapter, write slcan:/dev/null"),
        (("/dev/null", "20h", "--model", "mac23"), "/dev/null: "),
        (("/dev/ttyX9", "20h"), "/dev/ttyX9 does not exist; is the adapter plugged in?"),
        (("x" * 300, "20h"), "does not exist; start a twin there"),
        (("./nothere", "20h"), "start a twin there: axistwin run MODEL --pty ./nothere"),
        ((VIRTUAL, "gu to 5"), "did you mean"),
        ((VIRTUAL, "go to 5", "--model", "msc-250"), "is no command"),
        (("axistwin://msc-250?time=virtual", "DWRITE 5"), "DWRITE has 2 numbers, not 1"),
        (("axistwin://msc-250?time=virtual", "DREAD here"), "here is no number"),
        (("axistwin:mac23-can:1?time=virtual", "new address 5"), "on a serial line"),
        ((VIRTUAL, "20h", "--baud", "-1"), "-1 is not in the range"),
        ((VIRTUAL, "20h", "--baud", "9" * 30), "is not in the range"),
        ((VIRTUAL, f"wait {'9' * 30} s"), "a pause has at most 86400 s"),
        ((VIRTUAL, f"wait {'9' * 400} s"), "a pause has at most 86400 s"),
        ((VIRTUAL,), "Missing argument"),
    ],
)
def test_a_mistake_is_one_line(arguments: tuple[str, ...], words: str) -> None:
    """Exit status 2."""
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert words in result.output
    assert len(result.output.splitlines()) == 1


@pytest.mark.system
@pytest.mark.parametrize(
    ("model", "text", "reply"),
    [
        ("mac34-1", "position?", "20h position = 0 (module 0)"),
        ("mn400", "E", "ReadPosition: START (board 1); ReadPosition = 0,0,0,0 (board 1)"),
        ("msc-250", "RFLAGS", "ACK; RFLAGS = on: none (unit 1)"),
    ],
)
def test_a_device_of_each_family_is_asked_on_a_pty(model: str, text: str, reply: str) -> None:
    """The reply is read to its end."""
    with testing.start(model) as twin:
        told = rows(twin.port, text, "--model", model, "--timeout", "20")
    assert told[1].endswith(f"  {reply}")


@pytest.mark.system
def test_a_pty_is_asked_by_the_name_of_its_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``./mac23`` of ``axistwin run``, and the shorter ``./mac`` of scripts/run."""
    with testing.start("mac23") as twin:
        assert rows(twin.port, "20h")[1].endswith("20h position = 0 (module 0)")
        monkeypatch.chdir(tmp_path)
        Path("mac").symlink_to(Path(twin.port).resolve())
        assert rows("./mac", "20h")[1].endswith("20h position = 0 (module 0)")
