import subprocess
import sys
from pathlib import Path

import pytest
from mac_frames import ACCEPTED, ANSWER_LENGTH, answer_value, request

from axistwin import catalog
from axistwin.catalog import (
    DeviceSpec,
    build_bus,
    build_line,
    parse_device,
    parse_settings,
    read_profile,
)
from axistwin.errors import StateError, UsageError
from axistwin.kernel.time import NS_PER_MS, NS_PER_S
from axistwin.runtime.bus import Bus
from axistwin.runtime.clock import VirtualClock
from axistwin.runtime.line import Line
from axistwin.runtime.storage import MemoryStorage, Storage
from axistwin.wire.can_frame import CanFrame
from axistwin.wire.framing import LineFormat

KNOWN = "mac23, mac34-1, mac34-2, mac23-can, mn400, msc-250, msc-850-32, msc-850, msc-generic"


def line_of(*devices: str, **options: object) -> Line:
    """A line in virtual time."""
    specs = [parse_device(device) for device in devices]
    return build_line(specs, **{"clock": VirtualClock(), **options})  # type: ignore[arg-type]


def ask(line: Line, frame: bytes, count: int = ANSWER_LENGTH) -> bytes:
    """Send, and take what comes within 100 ms."""
    line.send(frame)
    line.wait(line.sync() + 100 * NS_PER_MS, count)
    return line.receive()


def test_the_models_are_listed_with_all_that_a_user_needs() -> None:
    """Names, descriptions, addresses, rate, and quirks with values, default, ID and meaning."""
    models = catalog.models()
    assert list(models) == [
        *("mac23", "mac34-1", "mac34-2", "mac23-can", "mn400"),
        *("msc-250", "msc-850-32", "msc-850", "msc-generic"),
    ]
    for name, model in models.items():
        assert model.name == name
        assert model.description
        for quirk in model.quirks.values():
            assert quirk.doc
            assert quirk.allowed
    serial = [model for model in models.values() if model.carrier == "serial"]
    assert len(serial) == 8
    for model in serial[:3]:
        assert (model.addresses, model.default_address) == (range(0x80), 0)
        assert model.default_baud == 38400
        assert model.quirks["xon_byte"].default == "1Ah"
        assert all(quirk.source.startswith("MACS-") for quirk in model.quirks.values())
    steps = serial[3]
    assert (steps.addresses, steps.default_address) == (range(1, 128), 1)
    assert (steps.default_baud, steps.bauds) == (9600, (9600, 19200, 38400, 57600, 115200))
    assert all(quirk.source.startswith("MN4-") for quirk in steps.quirks.values())
    for model in serial[4:]:
        assert (model.addresses, model.default_address) == (range(1, 16), 1)
        assert (model.default_baud, model.bauds) == (9600, (9600,))
        assert model.quirks["ack_timeout_ms"].default == "1000"
        assert all(quirk.source.startswith("MSC-") for quirk in model.quirks.values())
    on_can = models["mac23-can"]
    assert on_can.carrier == "can"
    assert (on_can.addresses, on_can.default_address) == (range(1, 0x80), 1)
    assert (on_can.default_baud, on_can.bauds) == (125_000, ())
    assert on_can.quirks["upload_scs"].source == "MACC-AMB-18"


@pytest.mark.system
def test_listing_the_models_loads_no_device() -> None:
    """Starting the program costs only what it uses."""
    program = (
        "import sys; from axistwin import catalog; catalog.models()\n"
        "catalog.parse_device('mac23')\n"
        "families = ('axistwin.devices.mac', 'axistwin.devices.msc', 'axistwin.devices.mn400')\n"
        "print([name for name in sys.modules if name.startswith(families)"
        " and not name.endswith('.family') and sys.modules[name].__file__[-11:] != '__init__.py'])"
    )
    shown = subprocess.check_output([sys.executable, "-c", program], text=True)
    assert shown.strip() == "[]"


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("mac23", DeviceSpec("mac23", 0)),
        ("mac23:5", DeviceSpec("mac23", 5)),
        ("mac34-1:127", DeviceSpec("mac34-1", 127)),
        ("mac34-2:7Fh", DeviceSpec("mac34-2", 127)),
        ("mac34-2:7fH", DeviceSpec("mac34-2", 127)),
        ("mac23:0x1F", DeviceSpec("mac23", 31)),
        ("mac23:10h", DeviceSpec("mac23", 16)),
        ("mac23-can", DeviceSpec("mac23-can", 1)),
        ("mac23-can:7Fh", DeviceSpec("mac23-can", 127)),
    ],
)
def test_a_device_is_named_by_model_and_address(text: str, spec: DeviceSpec) -> None:
    """The address is decimal, 7Fh or 0x7F; without one it is the model's default."""
    assert parse_device(text) == spec
    assert parse_device(str(spec)) == spec


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "mac24",
            f"unknown model 'mac24': did you mean mac23? known: {KNOWN}",
        ),
        ("mac34-3", f"unknown model 'mac34-3': did you mean mac34-1 or mac34-2? known: {KNOWN}"),
        ("mac99", f"unknown model 'mac99': known: {KNOWN}"),
        ("msc-900", f"unknown model 'msc-900': known: {KNOWN}"),
        ("msc", f"unknown model 'msc': known: {KNOWN}"),
        (
            "",
            f"unknown model '': known: {KNOWN}",
        ),
        ("mac23:80h", "address 80h (128) is out of range for mac23: 0..7Fh (0..127)"),
        ("mac23:128", "address 128 is out of range for mac23: 0..7Fh (0..127)"),
        ("mac23:0xFF", "address 0xFF (255) is out of range for mac23: 0..7Fh (0..127)"),
        ("mac23-can:0", "address 0 is out of range for mac23-can: 1..7Fh (1..127)"),
        ("mac23:99999999", "address 99999999 is out of range for mac23: 0..7Fh (0..127)"),
        (
            "mac23:99999999999999999999999",
            "address 99999999999999999999999 is out of range for mac23: 0..7Fh (0..127)",
        ),
        (
            "mac23:-1",
            "address '-1' of mac23 is no number: 0..7Fh (0..127), such as mac23:5 or mac23:7Fh",
        ),
        (
            "msc-250:x",
            "address 'x' of msc-250 is no number: 1..Fh (1..15), such as msc-250:5 or msc-250:Fh",
        ),
        (
            "mac23:",
            "address '' of mac23 is no number: 0..7Fh (0..127), such as mac23:5 or mac23:7Fh",
        ),
        (
            "mac23:7F",
            "address '7F' of mac23 is no number: 0..7Fh (0..127), such as mac23:5 or mac23:7Fh",
        ),
    ],
)
def test_a_wrong_device_is_one_clear_line(text: str, message: str) -> None:
    """The value, what is allowed, the remedy."""
    with pytest.raises(UsageError) as caught:
        parse_device(text)
    assert str(caught.value) == message


def test_settings_are_name_and_value() -> None:
    """Blanks around them do not count; of equal names the last holds."""
    assert parse_settings(["a=1", " b = x=y ", "a=2"]) == {"a": "2", "b": "x=y"}
    for text in ("xon_byte", "=3", "xon_byte=", ""):
        with pytest.raises(UsageError, match="write NAME=VALUE"):
            parse_settings([text])


def test_a_quirk_is_obeyed() -> None:
    """The reply ends as the quirk says."""
    line = line_of("mac23", quirks={"xon_byte": "11h"})
    assert ask(line, request(0x0B), 3) == b"\x06\x13\x11"


@pytest.mark.parametrize(
    ("quirks", "message"),
    [
        ({"xon_bite": "11h"}, r"unknown quirk 'xon_bite': did you mean xon_byte\?"),
        (
            {"status_tail": "4"},
            r"unknown quirk 'status_tail': an msc-250 has it, a mac23 does not; see 'axistwin",
        ),
        ({"status_tial": "4"}, r"unknown quirk 'status_tial': see 'axistwin models mac23'"),
        ({"xon_byte": "12h"}, r"quirk xon_byte: '12h' is not allowed; allowed: 1Ah, 11h"),
        ({"boot_time_ms": "soon"}, r"quirk boot_time_ms: 'soon' is not allowed"),
    ],
)
def test_a_wrong_quirk_is_one_clear_line(quirks: dict[str, str], message: str) -> None:
    """With the nearest name, or the values allowed; and the storage is let go of."""
    storage = MemoryStorage()
    closed: list[int] = []
    storage.close = lambda: closed.append(1)  # type: ignore[method-assign]
    with pytest.raises(UsageError, match=message):
        line_of("mac23", quirks=quirks, storage=storage)
    assert closed == [1]


def test_a_profile_is_a_table_of_quirks(tmp_path: Path) -> None:
    """As text, number or truth value."""
    path = tmp_path / "unit.toml"
    path.write_text(
        'model = "mac23"\n[quirks]\nxon_byte = "11h"\nboot_time_ms = 100\nlock_08_1b = true\n'
    )
    quirks = read_profile(path, ["mac23", "mac34-1"])
    assert quirks == {"xon_byte": "11h", "boot_time_ms": 100, "lock_08_1b": True}
    assert ask(line_of("mac23", quirks=quirks), request(0x0B), 3) == b"\x06\x13\x11"
    path.write_text('model = "mac23"\n')
    assert read_profile(path, ["mac23"]) == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('model = "mac34-1"', "key 'model' is 'mac34-1', but the line has mac23; give another"),
        ("model = 3", "key 'model' is 3, but the line has mac23"),
        ("modle = 3", r"unknown key 'modle': did you mean model\?"),
        ("", 'it is empty; it begins with the model that it is of, such as model = "mac23"'),
        ("[quirks]\nxon_byte = 17", "it names no model; it begins with the model that it is of"),
        ('model = "mac23"\nquirks = 3', r"key 'quirks' is no table; write \[quirks\]"),
        (
            'model = "mac23"\n[quirks]\nxon_bite = 3',
            r"unknown quirk 'xon_bite': did you mean xon_byte\?",
        ),
        ('model = "mac23"\n[quirks]\nxon_byte = "x"', "quirk xon_byte: 'x' is not allowed"),
        ('model = "mac23"\n[quirks]\nxon_byte = [3]', r"quirk xon_byte is \[3\]; write a text"),
        ("[quirks\n", "this is no TOML .*line 1"),
        ("\xff", "this is no TOML"),
    ],
)
def test_a_wrong_profile_is_one_clear_line_with_file_and_key(
    tmp_path: Path, text: str, message: str
) -> None:
    """Whatever is wrong with it."""
    path = tmp_path / "unit.toml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(UsageError, match=r"^profile .*unit\.toml: " + message) as caught:
        read_profile(path, ["mac23"])
    assert "\n" not in str(caught.value)


def test_a_profile_that_cannot_be_read_is_one_clear_line(tmp_path: Path) -> None:
    """With the system's reason."""
    with pytest.raises(UsageError, match=r"No such file or directory\); give an existing file"):
        read_profile(tmp_path / "none.toml", ["mac23"])


def test_a_line_needs_a_device() -> None:
    """An empty line is a mistake of the user's."""
    with pytest.raises(UsageError, match="no device was named"):
        build_line([])


def test_devices_on_one_line_are_alone_under_their_addresses() -> None:
    """Each answers for itself; the names are as they were given."""
    line = line_of("mac23:0", "mac34-1:5")
    assert [twin.name for twin in line.twins] == ["mac23:0", "mac34-1:5"]
    assert ask(line, request(0x20))[6:8] == b"00"
    assert ask(line, request(0x20, address=5))[6:8] == b"05"
    assert ask(line, request(0x20, address=6)) == b""


@pytest.mark.parametrize("seed", range(20))
def test_two_devices_at_one_address_answer_on_top_of_one_another(seed: int) -> None:
    """Whatever the seed, the host sees garbage, and the same garbage every time."""
    answers = [ask(line_of("mac23:0", "mac23:0", seed=seed), request(0x20)) for _ in range(2)]
    alone = ask(line_of("mac23:0"), request(0x20))
    assert answers[0] == answers[1]
    assert answers[0]
    assert answers[0] != alone


def test_a_module_knows_whether_it_is_the_only_one_on_its_line() -> None:
    """Which matters to who answers a general frame (MACS-AMB-16, lone)."""
    lone = {"general_reply_policy": "lone"}
    general = request(0x20, address=0xFF)
    assert ask(line_of("mac23:5", quirks=lone), general)
    assert ask(line_of("mac23:5", "mac23:6", quirks=lone), general) == b""


def test_modules_are_found_started_or_switched_on_now() -> None:
    """A cold one is deaf for its first two seconds."""
    assert ask(line_of("mac23"), request(0x20))
    line = line_of("mac23", cold=True)
    assert ask(line, request(0x20)) == b""
    line.advance(2 * NS_PER_S)
    assert ask(line, request(0x20))


def test_a_line_uses_the_rate_of_its_first_device() -> None:
    """Until the host chooses another."""
    line = line_of("mac23", baud=9600)
    assert line.host_format == line.device_format == LineFormat(9600)
    assert ask(line, request(0x20))
    line.host_format = LineFormat(38400)
    assert not ask(line, request(0x20)).startswith(b"\x06\x13\x02")


def test_a_rate_that_the_model_does_not_have_is_one_clear_line() -> None:
    """With those it has."""
    with pytest.raises(UsageError, match="baud 4800 is no rate of mac23: 9600, 19200, 38400"):
        line_of("mac23", baud=4800)


def test_what_a_module_stores_outlives_the_process(tmp_path: Path) -> None:
    """Parameters, address and position are found again under the name it was started with."""
    with line_of("mac23:0", storage=Storage(tmp_path)) as line:
        assert not line.is_volatile
        assert ask(line, request(0x0D, 1234), 3) == ACCEPTED
        assert ask(line, request(0x13, 77), 3) == ACCEPTED
        line.advance(NS_PER_S)
        assert ask(line, request(0x08, 9, address=0xFF), 3) == ACCEPTED
    with line_of("mac23:0", storage=Storage(tmp_path)) as line:
        assert (line.twins[0].name, line.twins[0].address) == ("mac23:0", 9)
        assert answer_value(ask(line, request(0x25, address=9))) & 0xFFFF == 1234
        assert answer_value(ask(line, request(0x20, address=9))) == 77


def test_a_stored_rate_is_stronger_than_the_factorys(tmp_path: Path) -> None:
    """--baud is what a module has that never stored one."""
    line_of("mac23", storage=Storage(tmp_path), baud=9600).close()
    with line_of("mac23", storage=Storage(tmp_path), baud=38400) as line:
        assert line.device_format == LineFormat(9600)


def test_a_cell_that_the_model_cannot_have_is_an_error(tmp_path: Path) -> None:
    """A whole record with an impossible value is refused, and stays as it is."""
    storage = Storage(tmp_path)
    storage.slot("mac23-0", "mac23").save({"address": 200}, durable=True)
    storage.close()
    before = (tmp_path / "mac23-0.state").read_bytes()
    with pytest.raises(StateError, match="state of mac23:0: cell address cannot be 200"):
        line_of("mac23:0", storage=Storage(tmp_path))
    assert (tmp_path / "mac23-0.state").read_bytes() == before


def test_the_transcript_of_a_line_speaks_the_devices_language() -> None:
    """Frames are decoded."""
    line = line_of("mac23")
    ask(line, request(0x20))
    assert "20h" in line.render_transcript()
    assert "position" in line.render_transcript()


def test_a_twin_says_in_words_what_it_does() -> None:
    """From start-up over rest and motion to power-off."""
    line = line_of("mac23", cold=True)
    twin = line.twins[0]
    states = [twin.state]
    line.advance(2 * NS_PER_S)
    states.append(twin.state)
    ask(line, request(0x10), 3)
    states.append(twin.state)
    ask(line, request(0x13, 10_000), 3)
    states.append(twin.state)
    ask(line, request(0x11), 3)
    states.append(twin.state)
    line.advance(10 * NS_PER_S)
    states.append(twin.state)
    twin.power_off()
    states.append(twin.state)
    assert states == [
        "starting up, deaf",
        "at rest, unpowered",
        "at rest, unpowered, synchronous mode armed",
        "at rest, unpowered, motion preloaded",
        "moving to a position",
        "at rest, powered",
        "switched off",
    ]


def test_an_hour_of_motion_takes_no_time() -> None:
    """A slow endless move is asked where it is after an hour, to the increment."""
    line = line_of("mac23")
    assert ask(line, request(0x0F, 0), 3) == ACCEPTED
    assert ask(line, request(0x15, 8000), 3) == ACCEPTED  # 1 ms per increment, no ramp
    line.advance(3600 * NS_PER_S)
    assert 3_600_000 <= answer_value(ask(line, request(0x20))) <= 3_600_000 + 30


# -- buses --------------------------------------------------------------------------------------


def bus_of(*devices: str, **options: object) -> Bus:
    """A bus in virtual time."""
    specs = [parse_device(device) for device in devices]
    return build_bus(specs, **{"clock": VirtualClock(), **options})  # type: ignore[arg-type]


def say(bus: Bus, identifier: int, data: str) -> list[str]:
    """Send a frame; all that is heard within 100 ms."""
    port = bus.attach()
    bus.send(port, CanFrame(identifier, bytes.fromhex(data)))
    bus.advance(100 * NS_PER_MS)
    heard = [str(arrival.frame) for arrival in bus.receive(port)]
    bus.detach(port)
    return heard


def test_devices_on_one_bus_answer_for_themselves() -> None:
    """Under their addresses; the names are as they were given; quirks are obeyed."""
    bus = bus_of("mac23-can", "mac23-can:5", quirks={"upload_scs": "43h"})
    assert [twin.name for twin in bus.twins] == ["mac23-can:1", "mac23-can:5"]
    assert bus.bitrate == 125_000
    assert say(bus, 0x601, "4000200000000000") == ["581#4300200000000000"]
    assert say(bus, 0x605, "4000200000000000") == ["585#4300200000000000"]
    assert say(bus, 0x606, "4000200000000000") == []
    assert "> 601#4000200000000000  2000h position? -> module 1" in bus.render_transcript()


def test_two_modules_at_one_address_both_answer() -> None:
    """No two of them are equally fast; the seed decides by how much."""
    pair = ("mac23-can", "mac23-can")
    answers = [say(bus_of(*pair, seed=3), 0x601, "4000200000000000") for _ in range(2)]
    assert answers[0] == answers[1]
    assert len(answers[0]) == 2


def test_a_cold_bus_boots() -> None:
    """The supply is applied now: boot-up after 2 s."""
    bus = bus_of("mac23-can:3", cold=True)
    assert say(bus, 0x603, "4000200000000000") == []
    port = bus.attach()
    bus.advance_to(2100 * NS_PER_MS)
    assert [str(arrival.frame) for arrival in bus.receive(port)] == ["703#00"]


def test_what_a_module_on_can_stores_outlives_the_process(tmp_path: Path) -> None:
    """Parameters and the address of the procedure on 7E5h."""
    with bus_of("mac23-can", storage=Storage(tmp_path)) as bus:
        assert say(bus, 0x601, "230D200000001234") == ["581#600D200000000000"]
        for data in ("0401", "1109", "0400"):
            say(bus, 0x7E5, data)
    with bus_of("mac23-can", storage=Storage(tmp_path)) as bus:
        assert bus.twins[0].address == 9
        assert say(bus, 0x609, "4005200000000000")[0].endswith("1234")


@pytest.mark.parametrize(
    ("devices", "options", "message"),
    [
        ((), {}, "no device was named; name one"),
        (("mac23-can", "mac23"), {}, "mac23:0 lives on a serial line, not on a CAN bus; "),
        (("mac23-can",), {"bitrate": 0}, r"bitrate 0 is out of range: 1\.\.1000000 bits"),
        (("mac23-can",), {"bitrate": 1_000_001}, "bitrate 1000001 is out of range"),
        (("mac23-can",), {"quirks": {"xon_byte": "11h"}}, "unknown quirk 'xon_byte'"),
    ],
)
def test_a_wrong_bus_is_one_clear_line(
    devices: tuple[str, ...], options: dict[str, object], message: str
) -> None:
    """What is wrong, what is right; and the storage is let go of."""
    storage = MemoryStorage()
    closed: list[int] = []
    storage.close = lambda: closed.append(1)  # type: ignore[method-assign]
    with pytest.raises(UsageError, match=message):
        bus_of(*devices, storage=storage, **options)
    assert closed == [1]


def test_a_device_on_can_is_on_no_serial_line() -> None:
    """With what to write instead."""
    with pytest.raises(UsageError) as caught:
        line_of("mac23", "mac23-can:2")
    assert str(caught.value) == (
        "mac23-can:2 lives on a CAN bus, not on a serial line; "
        'from Python use can.Bus(interface="axistwin", channel="mac23-can:2")'
    )
