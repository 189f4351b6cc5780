"""``axistwin decode``: bytes and frames in words."""

import io
import os
import random
import subprocess
import sys
from pathlib import Path

import can
import pytest
import serial
from click.testing import CliRunner, Result

from axistwin import testing
from axistwin.cli.decode import COMPLAINTS_MAX, READERS, Found, read_bytes, read_frame
from axistwin.cli.program import main
from axistwin.wire.can_frame import CanFrame

ROOT = Path(__file__).parents[2]
READ = CanFrame(0x601, bytes.fromhex("4000200000000000"))
REPORT = "  can0  20000088   [8]  00 00 80 19 00 00 00 00"
QUERY = "02 30 31 34 30 30 32 30 30 30 30 30 30 30 30 30 30 30 41 32 03"


def invoke(*arguments: str, text: str | None = None) -> Result:
    """Run the program in this process on ``text`` as its standard input."""
    return CliRunner().invoke(main, ("decode", *arguments), input=text)


# ---- what a line holds ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "data"),
    [
        ("06 13 1A", "06131A"),
        ("06131a", "06131A"),
        ("  0x06, 0x13, 0x17,", "061317"),
        ("\\x06\\x13\\x17", "061317"),
        ("06:13-17;15", "06131715"),
        ("> 48 45 4C", "48454C"),
        ("< 06 13 1A  accepted", "06131A"),
        ("    1520.312 > 48 45 4C  48 45 4C", "48454C"),
        ("      17.154 ms < 06 13 17  refused", "061317"),
        ("> 02  not understood: sent at 9600, the module listens at 38400", "02"),
    ],
)
def test_bytes_are_found_in_hex_and_in_recordings(line: str, data: str) -> None:
    """However they are separated; what is behind two blanks in a recording is its meaning."""
    found = read_bytes(line)
    assert found is not None
    assert found.content == bytes.fromhex(data)


@pytest.mark.parametrize(
    "line",
    [
        "0",
        "06 1",
        "06 13 1G",
        "00000000: 0230 3134  .014",
        "00000000  02 30 31 34  |.014|",
        "1520.312 02 30",
        "> ",
        "> 02 30 … 40 bytes",
        "601#40",
    ],
)
def test_what_is_no_hex_holds_no_bytes(line: str) -> None:
    """A dump with offsets is not taken for bytes, nor a line that leaves some out."""
    assert read_bytes(line) is None


@pytest.mark.parametrize(
    "line",
    [
        "601#4000200000000000",
        "601#40.00.20.00.00.00.00.00",
        "  601#4000200000000000  2000h position? -> module 1",
        "(1436509052.249713) vcan0 601#4000200000000000",
        "(1436509052.249713) vcan0 601#4000200000000000 R",
        "(1436509052.249713) ./mac23-can 601#4000200000000000 T",
        "      12.345 ms > 601#4000200000000000      2000h position? -> module 1",
        "  vcan0  601   [8]  40 00 20 00 00 00 00 00",
        "  vcan0  601   [8]  40 00 20 00 00 00 00 00   '@. .....'",
        " (000.000123)  vcan0  601   [8]  40 00 20 00 00 00 00 00",
        " (2015-07-10 12:34:56.123456)  can0  RX - -  601   [8]  40 00 20 00 00 00 00 00",
    ],
)
def test_a_frame_is_found_in_every_form(line: str) -> None:
    """cansend's, candump's log and screen, python-can's log, a transcript's."""
    found = read_frame(line)
    assert found is not None
    assert found.content == READ


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        ("080#", CanFrame(0x080)),
        ("601#R", CanFrame(0x601, is_remote=True)),
        ("601#r8", CanFrame(0x601, is_remote=True, length=8)),
        ("  vcan0  080   [0]", CanFrame(0x080)),
        ("  vcan0  601   [8]  remote request", CanFrame(0x601, is_remote=True, length=8)),
        ("00000601#40", CanFrame(0x601, b"\x40", is_extended=True)),
        ("  vcan0  1FFFFFFF   [1]  40", CanFrame(0x1FFFFFFF, b"\x40", is_extended=True)),
        ("20000080#", None),
        ("  can0  20000088   [8]  00 00 80 19 00 00 00 00   ERRORFRAME", None),
    ],
)
def test_every_kind_of_frame_is_found(line: str, frame: CanFrame | None) -> None:
    """Empty, remote, extended; a report of the adapter is no frame."""
    found = read_frame(line)
    assert found is not None
    assert found.content == frame


@pytest.mark.parametrize(
    "line",
    [
        "601",
        "601#4",
        "601#400020000000000000",
        "601##14000",
        "1601#40",
        "801#40",
        "601#R9",
        "  vcan0  601   [7]  40 00 20 00 00 00 00 00",
        "  vcan0  601   [8]  40 00",
        "  vcan0  601  [08]  40 00 20 00 00 00 00 00",
        "06 13 1A",
    ],
)
def test_what_is_no_classical_frame_is_not_taken_for_one(line: str) -> None:
    """FD frames, wrong lengths, identifiers of other widths."""
    assert read_frame(line) is None


def test_no_line_is_too_strange() -> None:
    """Pieces of good lines in any order: found or not, never an error."""
    seeded = random.Random(4)
    pieces = ["601", "#", "40", " ", "  ", "R", "(1.5)", "vcan0", "[8]", "\t", ">", "0x", "é", "…"]
    found = 0
    for _ in range(20_000):
        line = "".join(seeded.choices(pieces, k=seeded.randrange(12)))
        for reader in READERS.values():
            found += isinstance(reader(line), Found)
    assert found > 100


def test_every_frame_comes_back_from_its_own_text() -> None:
    """What transcripts and python-can's logger write is what is read."""
    seeded = random.Random(5)
    log = io.StringIO()
    writer = can.CanutilsLogWriter(log)
    frames = []
    for number in range(500):
        extended, remote = seeded.random() < 0.3, seeded.random() < 0.2
        identifier = seeded.getrandbits(29 if extended else 11)
        data = b"" if remote else seeded.randbytes(seeded.randrange(9))
        length = seeded.randrange(9) if remote else len(data)
        frame = CanFrame(identifier, data, extended, remote, length)
        frames.append(frame)
        found = read_frame(str(frame))
        assert found == Found(str(frame), frame)
        writer(
            can.Message(
                timestamp=float(number),
                arbitration_id=identifier,
                is_extended_id=extended,
                is_remote_frame=remote,
                dlc=length,
                data=data,
            )
        )
    for line, frame in zip(log.getvalue().splitlines(), frames, strict=True):
        found = read_frame(line)
        assert found is not None
        read = found.content
        assert isinstance(read, CanFrame)
        assert (read.identifier, read.data) == (frame.identifier, frame.data)
        assert (read.is_extended, read.is_remote) == (frame.is_extended, frame.is_remote)


# ---- the command ---------------------------------------------------------------------------------


def test_a_bus_in_words() -> None:
    """Line by line, with what stands in front; remarks and empty lines stay."""
    result = invoke(
        "mac23-can",
        text="# at noon\n"
        "\n"
        "(1.500000) vcan0 601#2313200000000000\n"
        "  vcan0  581   [8]  80 13 20 00 00 00 00 00\n"
        "123#00\n"
        f"{REPORT}   ERRORFRAME\n"
        "\tprotocol-violation{{tx-bit-stuffing-error}{}}\n",
    )
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines() == [
        "# at noon",
        "",
        "(1.500000) vcan0 601#2313200000000000  2013h go to position 0 -> module 1",
        "  vcan0  581   [8]  80 13 20 00 00 00 00 00  2013h refused (module 1)",
        "123#00  concerns no mac23-can",
        f"{REPORT}  report of the adapter, no frame of the bus",
        "\tprotocol-violation{{tx-bit-stuffing-error}{}}",
    ]


def test_a_line_in_words(tmp_path: Path) -> None:
    """From a file; several frames in one burst."""
    path = tmp_path / "capture.txt"
    path.write_text(f"    1.000 > {QUERY}  old words\n06 13 17 15\n", encoding="utf-8")
    result = invoke("mac34-1", str(path))
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines() == [
        f"    1.000 > {QUERY}  20h position? -> module 0",
        "06 13 17 15  refused; Nack",
    ]


def test_what_failing_tests_print_can_be_decoded() -> None:
    """A transcript in words gives the same words again."""
    with (
        testing.start("mac23", time="virtual") as twin,
        serial.serial_for_url(twin.port, baudrate=38400, timeout=1) as port,
    ):
        for _ in range(5):
            port.write(bytes.fromhex(QUERY))
            port.read(21)
    text = twin.transcript
    assert "more like this one" in text
    result = invoke("mac23", text=text)
    assert result.exit_code == 0, result.output
    assert result.stdout.rstrip("\n") == text


def test_what_is_not_understood_is_told_with_its_number() -> None:
    """The rest is decoded; status 2; the hint is that another model may understand it."""
    result = invoke("mac23-can", text="601#40\nhello\n06 13 1A\n080#\n")
    assert result.exit_code == 2
    assert [line.partition("  ")[0] for line in result.stdout.splitlines()] == ["601#40", "080#"]
    second, third, last = result.stderr.splitlines()
    assert second == "axistwin: line 2: 'hello' is not understood"
    assert third == "axistwin: line 3: '06 13 1A' is for a model such as mac23"
    assert last.startswith("axistwin: standard input: 2 lines were not understood; write frames")
    result = invoke("mac23", text="601#40\n")
    assert "line 1: '601#40' is for a model such as mac23-can" in result.stderr


@pytest.mark.parametrize(
    ("model", "line", "words"),
    [
        ("mac23", QUERY[:20], "14 of 21 bytes are missing"),
        ("msc-250", "06 02 01 00 07 00 00 52", "6 of 7 bytes of the body are missing, and the"),
    ],
)
def test_what_breaks_off_on_a_line_is_told_with_what_is_missing(
    model: str, line: str, words: str
) -> None:
    """It has been understood: the exit status is 0."""
    result = invoke(model, text=line)
    assert result.exit_code == 0, result.output
    assert f" [incomplete: {words}" in result.stdout


def test_a_frame_on_candumps_screen_that_breaks_off_is_told() -> None:
    """It says itself how long it was; on the bus it was whole."""
    result = invoke("mac23-can", text="  vcan0  601   [8]  40 00 20\n")
    assert result.exit_code == 2
    assert "is incomplete: 5 of 8 bytes are missing" in result.stderr


def test_complaints_are_bounded(tmp_path: Path) -> None:
    """A file of another kind does not flood the screen."""
    path = tmp_path / "noise"
    noise = random.Random(1).randbytes(100_000) + b"\n" * 3
    path.write_bytes(noise)
    result = invoke("mac23", str(path))
    piped = CliRunner().invoke(main, ("decode", "mac23"), input=noise)
    assert piped.exit_code == 2
    assert piped.stderr.replace("standard input", str(path)) == result.stderr
    assert result.exit_code == 2
    lines = result.stderr.splitlines()
    assert len(lines) == COMPLAINTS_MAX + 1
    assert "lines were not understood; write bytes in hex" in lines[-1]
    assert all(len(line) < 400 for line in lines)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["mac24"], "did you mean mac23"),
        ([], "Missing argument 'MODEL'"),
        (
            ["mac23", "/nowhere"],
            "/nowhere: cannot be read (No such file or directory); give an existing",
        ),
        (["mac23", "/"], "/: cannot be read (Is a directory); give an existing file"),
        (["mac23-can", "601#40"], "write: echo '601#40' | axistwin decode mac23-can"),
        (["mac23", "06131A"], "write: echo '06131A' | axistwin decode mac23"),
    ],
)
def test_a_mistake_is_one_clear_line(arguments: list[str], message: str) -> None:
    """Model, file, and a frame in place of a file."""
    result = invoke(*arguments)
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert message in line


def test_the_session_on_the_page_prints_what_it_says() -> None:
    """docs/how-to/decode-bytes.md: the frames there are decoded as printed."""
    page = (ROOT / "docs" / "how-to" / "decode-bytes.md").read_text(encoding="utf-8")
    _, _, block = page.partition("$ axistwin decode mac23-can monday.log\n")
    printed = block.partition("```")[0]
    bare = "".join(line.partition("  ")[0] + "\n" for line in printed.splitlines())
    assert bare.count("#") == 5
    assert invoke("mac23-can", text=bare).stdout == printed


@pytest.mark.system
def test_a_live_bus_is_told_as_it_speaks() -> None:
    """Each frame at once, though input and output are pipes."""
    command = [sys.executable, "-m", "axistwin", "decode", "mac23-can"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for _ in range(3):
            process.stdin.write("080#\n")
            process.stdin.flush()
            assert process.stdout.readline() == "080#  SYNC: synchronise -> all modules\n"
        process.stdin.close()
        assert process.wait(10) == 0


def test_pieces_that_a_tap_passed_on_are_explained_together() -> None:
    """If they went the same way without a pause."""
    rows = (
        "# ./mac23 38400 8N1",
        "1000.000000 > 02 30 31 34 30 30 32 30 30 30",
        "1002.500000 > 30 30 30 30 30 30 30 30 41 32 03",
        "1004.000000 < 06",
        "1005.000000 < 13 1A",
        "1056.000000 < 15",
    )
    result = invoke("mac23", text="\n".join(rows) + "\n")
    assert result.exit_code == 0
    remark, request, *replies = result.stdout.splitlines()
    assert remark == rows[0]
    assert request.startswith("1000.000000 > 02 30")
    assert request.endswith("41 32 03  20h position? -> module 0")
    assert replies == ["1004.000000 < 06 13 1A  accepted", "1056.000000 < 15  Nack"]
    result = invoke("mac23", text="\n".join([*rows, "hello"]) + "\n")
    assert result.exit_code == 2
    assert "line 7: 'hello'" in result.stderr
