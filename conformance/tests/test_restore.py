"""What a device held is in a file before anything is written to it, and can be put back later."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import serial
from click.testing import CliRunner
from interfaces import PLAIN, InterfacePort, judge_plainly, real_options, real_time_of
from port_in_front import PortInFront

from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.base.events import Event, Note
from axistwin_conformance.cli import conform, make_options
from axistwin_conformance.engine.device import keeping
from axistwin_conformance.engine.device.restoring import put_back
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.families.mac.axis.snapshot import AxisSnapshot
from axistwin_conformance.families.msc.snapshot import MscSnapshot, UnitContents
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport

PORT = PLAIN.url


class Kept(PortInFront):
    """A port that looks, when a period is to be stored, whether the file is there."""

    def __init__(self, port: Any, folder: Path) -> None:
        super().__init__(port)
        self._folder = folder
        self.stored = 0

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return int(self.port.in_waiting)

    def read(self, size: int = 1) -> bytes:
        """What comes."""
        self.port.timeout = self.timeout
        return bytes(self.port.read(size))

    def write(self, data: bytes) -> int:
        """0Dh and what else is stored goes out only when the file exists."""
        if data[6:8] == b"0D":
            self.stored += 1
            assert list(self._folder.glob("held-mac23-0-*.json"))
        return int(self.port.write(data))

    def close(self) -> None:
        """Give it back."""
        self.port.close()


def test_the_file_is_there_before_the_first_write(tmp_path: Path) -> None:
    """With device, port and values."""
    folder, ports = tmp_path / "state" / "axistwin" / "held", []

    def watched(port: Any) -> Kept:
        ports.append(Kept(port, folder))
        return ports[-1]

    result = judge_plainly(real_options("the_period_reads_back"), before=watched)
    assert result.exit_status == 0
    assert ports[0].stored > 0
    (path,) = folder.iterdir()
    content = json.loads(path.read_text())
    assert (content["model"], content["port"], content["address"]) == ("mac23", PORT, 0)
    assert content["held"]["parameters"]["0D"] == 0x0320


def restored(held: dict[str, Any], **given: Any) -> tuple[int, list[str], Any]:
    """Exit status and notes of restoring that to a new module, and its twin."""
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    options = real_options(**given)
    url = options.family.twin_url("mac23", 0, ())
    port: Any = serial.serial_for_url(url, baudrate=38400)
    twin, told = port.twins[0], list[Event]()
    path = keeping.keep(options, held)
    with real_time_of() as world:
        world.way = way = InterfacePort(port, PLAIN, 0)
        status = put_back(options, path, told.append, lambda _: SerialTransport(way, PORT))
    texts = [event.text.replace(str(path), "FILE") for event in told if isinstance(event, Note)]
    return status, texts[1:], twin


def held_at(position: int) -> dict[str, Any]:
    """What an axis held there."""
    parameters = {2: 0, 3: 0, 9: 2**30 - 1, 10: 0xC0000000, 12: 96, 13: 1600, 14: 5, 15: 3, 28: 7}
    return {
        "position": position,
        "neighbours": {},
        "parameters": {f"{index:02X}": value for index, value in parameters.items()},
    }


def test_a_device_gets_back_what_the_file_says() -> None:
    """Parameters and place; nothing else is done."""
    status, notes, twin = restored(held_at(100))
    assert notes == ["the device holds again what FILE says"]
    assert status == 0
    assert int(twin.position) == 100
    assert twin.cells["period"] == 1600


def test_an_axis_too_far_from_home_is_told_with_what_drives_it_back() -> None:
    """A killed run may leave it anywhere; so long a way needs leave, and the rest is put back."""
    status, notes, twin = restored(held_at(50_000))
    assert status == 1
    assert [note for note in notes if "--restore FILE --max-travel 50000 drives it" in note]
    assert int(twin.position) == 0
    assert twin.cells["period"] == 1600
    status, notes, twin = restored(held_at(50_000), max_travel=50_000)
    assert status == 0
    assert int(twin.position) == 50_000


def test_what_is_kept_of_an_axis_and_of_a_controller_reads_back() -> None:
    """Neighbours and orders to a program as well."""
    axis = AxisSnapshot(-5, {2: 0, 3: 0, 9: 1, 10: -1, 12: 1, 13: 2, 14: 3, 15: 4, 28: 0})
    both = AxisSnapshot(7, axis.parameters, {3: axis})
    mac, msc = find_family("mac23"), find_family("msc-250")
    assert mac.memory_of(json.loads(json.dumps(mac.kept(both)))) == both
    unit = UnitContents({1000: tuple(range(32))}, {1128: -4}, {200: True})
    controller = MscSnapshot({1: unit}, range(192, 195))
    again = msc.memory_of(json.loads(json.dumps(msc.kept(controller))))
    assert (again.units, again.only_off) == (controller.units, controller.only_off)
    assert {(one.name, one.number) for one in again.touched} == {
        ("BWRITE", 1000), ("DWRITE", 1128), ("SFLAG", 200),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it does not say what a device held"),
        ("[]", "it does not say what a device held"),
        ('{"format": 2, "model": "mac23", "port": "x", "address": 0, "rate": 9600, "held": {}}',
         "it is of another version"),
        ('{"format": 1, "model": "msc-250", "port": "x", "address": 0, "rate": null, "held": {}}',
         "it is of a device of model msc-250"),
    ],
)  # fmt: skip
def test_a_file_that_says_nothing_is_wrong_usage(tmp_path: Path, text: str, message: str) -> None:
    """Told in one line, before any port is opened."""
    path = tmp_path / "held.json"
    path.write_text(text)
    with pytest.raises(UsageError, match=message):
        keeping.load(path, "mac23")
    told = CliRunner().invoke(conform, ["mac23", "--restore", str(path)])
    assert told.exit_code == 2
    assert message in told.output


def test_restoring_judges_nothing(tmp_path: Path) -> None:
    """An ID beside it would be lost in silence."""
    path = keeping.keep(make_options(model="mac23", port=PORT), {"position": 0})
    told = CliRunner().invoke(conform, ["mac23", "MACS-LINE", "--restore", str(path)])
    assert told.exit_code == 2
    assert "leave out --replay and every ID" in told.output
